"""Single runs in six axes: false alarms, power, recordings of many faults, unlisted physics, bias of the tool.

`python -m benchmarks.single_runs [--part PART ...] [--draws N]`. MuJoCo simulates runs of 15 s at 100 Hz of three kinds
of motion in noise of four kinds, one seed each for motion and noise, and the whole catalogue is searched. Parts:

nulls     nothing is hidden: verdicts other than nothing_missing, for an unknown noise and for a stated std of one
          sample. Stated are 1 % for a wrong effect and 1 % for lack of fit.
power     an effect of the catalogue at the simulated rig's default size and at a quarter of it
rows      one table of recordings that used to ruin a diagnosis, with what it should say
unlisted  physics outside the catalogue, which may not be called explained
bias      the tool's parameters with something hidden, as `fit` and `diagnose` tell them, against the rigid tool's by
          least squares weighted by the true noise

Each record that failed is listed under its table, with the seed that makes it again:
`SingleRun(noise="1/f", motion="raster", seed=1203).outcome()`. Intervals are of 95 %. Progress goes to stderr.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from benchmarks.coverage import share_interval
from benchmarks.single_run import (
    BASE,
    FAR,
    KINDS,
    RIG,
    Outcome,
    SingleRun,
    ordinary_least_squares,
    share,
)
from benchmarks.single_run_rows import rows
from benchmarks.unlisted_physics import UNLISTED
from diagnosis.diagnosis import diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.fit import Fit, fit
from modeling.chain.model import spatial
from modeling.errors import InputError
from modeling.table import Table
from truewrench.simulated_rig import (
    CableSpring,
    GravityTilt,
    HiddenEffect,
    SensorCrosstalk,
    SensorLag,
    TimeDelay,
    ViscousDrag,
)

Array = NDArray[np.float64]
Part = tuple[Table, list[str]]

NOTHING, EXPLAINED = RecordVerdict.NOTHING_MISSING.value, RecordVerdict.EXPLAINED.value
POWERED: Mapping[str, tuple[HiddenEffect, HiddenEffect]] = {
    "drag": (ViscousDrag(), ViscousDrag(c=0.15 / 4)),
    "lag": (SensorLag(), SensorLag(time_constant=0.02 / 4)),
    "tether": (CableSpring(), CableSpring(k=3.0 / 4)),
    "crosstalk": (SensorCrosstalk(), SensorCrosstalk(leaks=(("fy", "fx", 0.04 / 4),))),
    "tilt": (GravityTilt(), GravityTilt(tilt_y=0.03 / 4)),
    "delay": (TimeDelay(), TimeDelay(delay=0.012 / 4)),
}
"""Each at the simulated rig's default size, and at a quarter of it."""
SIZES = ("default", "quarter")
BODY = slice(6, None)
"""Of the base parameters: the tool without the biases."""


def nulls(draws: int = 17) -> Part:
    """So many records for each kind of noise and motion; each with and without a stated std."""
    found: dict[tuple[bool, int], list[Outcome]] = {}
    for stated in (False, True):
        for kind, (noise, motion) in enumerate(KINDS):
            runs = [
                SingleRun(noise=noise, motion=motion, seed=1000 + 100 * kind + i, stated=stated) for i in range(draws)
            ]
            found[stated, kind] = _diagnosed(runs)
    header = (
        "noise",
        "motion",
        *(f"{what}{way}" for way in ("", ", std stated") for what in ("effect", "lack of fit")),
    )
    table = [
        (noise, motion, *(str(n) for stated in (False, True) for n in _alarms(found[stated, kind])))
        for kind, (noise, motion) in enumerate(KINDS)
    ]
    whole = [[o for kind in range(len(KINDS)) for o in found[stated, kind]] for stated in (False, True)]
    totals = [share(n, len(outcomes)) for outcomes in whole for n in _alarms(outcomes)]
    failures = [o.sentence() for outcomes in whole for o in outcomes if o.verdict != NOTHING]
    seconds = [f"mean CPU {np.mean([o.seconds for o in outcomes]):.2f} s" for outcomes in whole]
    table += [("all", f"{draws} each", *totals), ("", "", seconds[0], "", seconds[1], "")]
    return Table.of(header, table), failures


def _diagnosed(runs: Iterable[SingleRun]) -> list[Outcome]:
    """Their outcomes, each told on stderr as it is known."""
    outcomes = []
    for run in runs:
        outcomes.append(run.outcome())
        print(" ".join(effect.id for effect in run.hidden), outcomes[-1].sentence(), file=sys.stderr, flush=True)
    return outcomes


def _alarms(outcomes: Sequence[Outcome]) -> tuple[int, int]:
    """Records with a wrong effect, and other records that are not nothing_missing."""
    named = sum(bool(o.added) for o in outcomes)
    return named, sum(o.verdict != NOTHING for o in outcomes) - named


def power(draws: int = 12) -> Part:
    """So many records of each effect and size, over the noises and motions in turn."""
    table, failures = [], []
    for number, (title, effects) in enumerate(POWERED.items()):
        for size, hidden in zip(SIZES, effects, strict=True):
            outcomes = _diagnosed(_run(i, 3000 + 100 * number + i, hidden) for i in range(draws))
            table.append((title, size, *_detected(outcomes), _seconds(outcomes)))
            failures += [
                f"{title}, {size}: {o.sentence()}"
                for o in outcomes
                if o.wrong or o.far or (not o.added and size == SIZES[0])
            ]
    header = (
        "hidden",
        "size",
        "alone",
        "with wrong ones",
        "only wrong",
        "nothing",
        "verdicts",
        "within 4 std",
        "CPU s",
    )
    return Table.of(header, table), failures


def _run(i: int, seed: int, *hidden: HiddenEffect) -> SingleRun:
    """Number i of runs that take noises and motions in turn."""
    noise, motion = KINDS[i % len(KINDS)]
    return SingleRun(noise=noise, motion=motion, seed=seed, hidden=hidden)


def _detected(outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    """How many found it alone, with wrong ones, only wrong ones, nothing; verdicts; parameters that are right."""
    n = len(outcomes)
    right = [o for o in outcomes if o.found]
    alone = sum(not o.wrong for o in right)
    only = sum(bool(o.wrong) and not o.found for o in outcomes)
    nothing = sum(not o.added for o in outcomes)
    within = sum(not o.far for o in right)
    counts = (share(alone, n), str(len(right) - alone), str(only), str(nothing))
    return (*counts, _verdicts(outcomes), f"{within}/{len(right)}")


def _verdicts(outcomes: Iterable[Outcome]) -> str:
    return ", ".join(f"{count} {verdict}" for verdict, count in Counter(o.verdict for o in outcomes).most_common())


def _seconds(outcomes: Sequence[Outcome]) -> str:
    return f"{np.mean([o.seconds for o in outcomes]):.2f}"


def faults(draws: int = 2) -> Part:
    """So many records of each row."""
    table, failures = [], []
    for row in rows():
        for seed in range(7001, 7001 + draws):
            o = Outcome.of(row.title, row.recording(seed), row.hidden, row.truth)
            mass, std = o.mass
            ratios = " ".join(f"{ratio:.3g}" for ratio in o.rms)
            verdict = o.verdict + (f" ({', '.join(o.added)})" if o.added else "")
            table.append(
                (row.title, str(seed), row.should, verdict, ratios, f"{mass:.4g} ± {std:.2g}", f"{o.seconds:.1f}")
            )
            failures += [f"{row.title}, {seed}: {text}" for text in (*o.remarks, *o.far)]
    header = (
        "recording",
        "seed",
        "should be",
        "verdict",
        "rms / noise, fx .. tz",
        f"mass, true {RIG.mass} kg",
        "CPU s",
    )
    return Table.of(header, table), failures


def unlisted(draws: int = 6) -> Part:
    """So many records of each, with and without a stated std; every fifth kind in turn, so that all noises come."""
    table, failures = [], []
    for number, hidden in enumerate(UNLISTED):
        runs = [_run(5 * i, 5000 + 100 * number + i, hidden) for i in range(draws)]
        size = np.median([_hidden_sizes(run).max() for run in runs])
        for stated in (False, True):
            outcomes = _diagnosed(replace(run, stated=stated) for run in runs)
            explained = sum(o.verdict == EXPLAINED for o in outcomes)
            way = "yes" if stated else "no"
            table.append(
                (hidden.id, f"{size:.2g}", way, share(explained, draws), _verdicts(outcomes), _seconds(outcomes))
            )
            failures += [f"{hidden.id}, {o.sentence()}; removed {o.removed:.2f}" for o in outcomes if _claims(o)]
    header = ("hidden", "rms / noise", "std stated", "explained", "verdicts", "CPU s")
    return Table.of(header, table), failures


def _claims(outcome: Outcome) -> bool:
    """Whether it says more than that something is missing."""
    return bool(outcome.added) or outcome.verdict == NOTHING


def _hidden_sizes(run: SingleRun) -> Array:
    """RMS (p,) of what is hidden, less what the rigid tool takes of it, over the noise."""
    with_it, without = run.recording(), replace(run, hidden=()).recording()
    rigid = fit(spatial(), without)
    columns = (rigid.response().derivative / np.array(RIG.noise)[:, None]).reshape(-1, len(rigid.theta))
    added = ((with_it.wrench - without.wrench) / np.array(RIG.noise)).ravel()
    left = added - columns @ np.linalg.lstsq(columns, added, rcond=None)[0]
    return np.asarray(np.sqrt(np.mean(left.reshape(-1, len(RIG.channels)) ** 2, axis=0)))


def bias(draws: int = 12) -> Part:
    """So many records with each effect hidden, over the noises and motions in turn; of `fit` and of `diagnose`."""
    hidden_by_name = {"nothing": (), **{name: effects[:1] for name, effects in POWERED.items()}}
    hidden_by_name |= {effect.id: (effect,) for effect in UNLISTED}
    table = [(name, *_bias_of(number, hidden, draws)) for number, (name, hidden) in enumerate(hidden_by_name.items())]
    told = ("rms ratio", "worst", "mass", "coverage")
    ways = [f"{what}, {way}" for way in ("fit", "fit with std stated", "diagnose") for what in told]
    return Table.of(("hidden", *ways, "no tool told", "CPU s"), table), []


def _bias_of(number: int, hidden: tuple[HiddenEffect, ...], draws: int) -> tuple[str, ...]:
    """Ratios of rms errors and coverage of the body, of `fit` and of the tool that `diagnose` tells; CPU seconds.

    A diagnosis that tells no tool is counted, and has no error.
    """
    begin = process_time()
    fitted: dict[bool, list[tuple[Fit, Array]]] = {False: [], True: []}
    told: list[tuple[Fit, Array]] = []
    for i in range(draws):
        run = _run(i, 9000 + 100 * number + i, *hidden)
        found = {stated: _fitted(replace(run, stated=stated)) for stated in fitted}
        plain = ordinary_least_squares(found[False], np.array(RIG.noise))
        for stated, own in found.items():
            fitted[stated].append((own, plain))
        told += [(tool, plain) for tool in _told_tool(run)]
        print(f"{run.name} {' '.join(e.id for e in hidden)}", file=sys.stderr, flush=True)
    seconds = (process_time() - begin) / draws
    texts = [text for fits in (*fitted.values(), told) for text in _errors_of(fits)]
    return (*texts, share(draws - len(told), draws), f"{seconds:.2f}")


def _fitted(run: SingleRun) -> Fit:
    recording = run.recording()
    return fit(spatial(recording.rig), recording)


def _told_tool(run: SingleRun) -> list[Fit]:
    """The final fit of a diagnosis, unless it says that the tool is not known or refuses."""
    recording = run.recording()
    try:
        found = diagnose(spatial(recording.rig), recording)
    except InputError:
        return []
    return [] if found.tool_unknown else [found.fit]


def _errors_of(fits: Sequence[tuple[Fit, Array]]) -> tuple[str, ...]:
    """Geometric mean of the body's rms errors over those of least squares (k,), largest, mass; coverage."""
    if not fits:
        return ("",) * 4
    truth, names = np.array(list(BASE.values())), list(BASE)[BODY]
    tables = [f.params.loc[list(BASE)] for f, _ in fits]
    own, low, high = (np.array([table[column] for table in tables]) for column in ("value", "low", "high"))
    plain = np.array([estimates for _, estimates in fits])
    square = [np.mean((estimates - truth) ** 2, axis=0) for estimates in (own, plain)]
    ratio = np.sqrt(square[0] / square[1])[BODY]
    inside = ((low <= truth) & (truth <= high))[:, BODY]
    least, most = share_interval(inside)
    mean, worst = np.exp(np.mean(np.log(ratio))), int(np.argmax(ratio))
    coverage = f"{inside.mean():.2f} ({least:.2f}-{most:.2f})"
    return f"{mean:.3f}", f"{ratio[worst]:.2f} {names[worst]}", f"{ratio[0]:.2f}", coverage


PARTS: Mapping[str, Callable[[int], Part]] = {
    "nulls": nulls,
    "power": power,
    "rows": faults,
    "unlisted": unlisted,
    "bias": bias,
}
DRAWS = {"nulls": 17, "power": 12, "rows": 2, "unlisted": 6, "bias": 12}
"""Records of a kind, unless stated."""


def lines(part: str, draws: int) -> Iterator[str]:
    """The table of a part, and its failures."""
    table, failures = PARTS[part](draws)
    yield f"{part}, {draws} records of a kind; deviations above {FAR:g} std count as wrong\n{table}"
    yield from failures
    yield ""


def main() -> None:
    """Run the parts and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=list(PARTS), help="default: all")
    parser.add_argument("--draws", type=int, help="records of a kind")
    arguments = parser.parse_args()
    for part in arguments.part or PARTS:
        for line in lines(part, arguments.draws or DRAWS[part]):
            print(line, flush=True)


if __name__ == "__main__":
    main()
