"""Discovery: forms that no catalogue has, hidden in simulated recordings: found, in the printed set, false in noise?

`python -m benchmarks.discovery [--draws N] [--nulls N] [--power P ...] [--noise NAME ...] [--repeats N ...]`

Each form is computed on the simulated rig by code that shares no equation with the models, and scaled to a whitened
power: the chi-square by which it is beyond the rigid tool on the fitted motion. On the motion held out it may be small.

exact   the term proposed is the true form
in set  it, or one of those listed beside it, is
none    no term was proposed
wrong   another form was, without the true one beside it; of nothing hidden any form is
third   share of what is hidden that the terms predict on a third motion, without noise, nothing fitted there (median
        of the draws with terms)
2 std   constants of exact forms within two of their std, of all
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.discovery_forms import COLUMNS, FORMS, LAWS, OF_LOADS, READINGS, Leak, Load
from diagnosis.discovery.discovery import Discovery, discover
from estimation.model_response import model_response, predicted_readings
from estimation.multiplicity import binomial_interval
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.simulated_rig import (
    NOISE_MODELS,
    HiddenEffect,
    NoiseModel,
    PlanarRig,
    SpatialRig,
    simulate,
)

Array = NDArray[np.float64]
PERIOD, SAMPLES = 5.0, 300
"""Of the motion, s, and per period."""
MOTIONS = (1, 2, 3)
"""Seeds of the fitted motion, of the one held out, and of a third on which terms are judged."""


class Silence(NoiseModel):
    """No noise."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Zeros."""
        return np.zeros((samples, channels))


def model_and_rig(space: Space) -> tuple[WrenchModel, PlanarRig | SpatialRig, Rig | None]:
    """The rigid tool, the simulated rig, and its description for joint angles."""
    sensor = SensorDescription(convention=Convention.ON_TOOL)
    if space is Space.PLANE:
        rig = PlanarRig()
        return planar(Rig(sensor=sensor)), rig, Rig(link_lengths=rig.link_lengths, tip_length=0.2)
    return spatial(Rig(sensor=sensor)), SpatialRig(), None


def frame(form: str | None, space: Space, size: float, motion: int, repeats: int) -> pd.DataFrame:
    """A recording without noise."""
    _, rig, _ = model_and_rig(space)
    hidden: list[HiddenEffect] = [Load(law=form, size=size)] if form is not None and form in LAWS and size else []
    hidden += [Leak(law=form, size=size)] if form is not None and form in OF_LOADS and size else []
    simulated = simulate(
        rig, rig.random_motion(seed=motion, period=PERIOD), hidden=hidden, repeats=repeats,
        samples_per_period=SAMPLES, noise=Silence(), seed=motion,
    )  # fmt: skip
    time = simulated["time"].to_numpy()
    for column, law in COLUMNS.items():
        simulated[column] = law(time)
    if form is not None and form in READINGS:
        channel, law_of = READINGS[form]
        simulated[channel] += size * law_of(simulated)
    return simulated.drop(columns=[c for c in COLUMNS if form not in OTHER_COLUMNS[c]])


OTHER_COLUMNS = {"temperature": (None, "warm zero"), "pressure": (None, "air pressure")}
"""Forms whose recordings have a column; those with nothing hidden have all."""


def unit_power(form: str, space: Space, repeats: int) -> float:
    """Chi-square of a form of size one beyond the rigid tool on the fitted motion, in white noise of the rig's size."""
    _, rig, _ = model_and_rig(space)
    small = 1e-3  # loads of a leak are those of the tool
    plain, hidden = (frame(form, space, size, MOTIONS[0], repeats) for size in (0.0, small))
    channels = list(rig.channels)
    added = (hidden[channels] - plain[channels]).to_numpy() / np.array(rig.noise) / small
    rows = rigid_columns(space, plain) / np.array(rig.noise)[:, None]
    flat = np.tile(rows, (len(added) // len(rows), 1, 1)).reshape(-1, rows.shape[-1])
    left = added.ravel() - flat @ np.linalg.lstsq(flat, added.ravel(), rcond=1e-9)[0]
    return float(left @ left)


def rigid_columns(space: Space, plain: pd.DataFrame) -> Array:
    """Derivatives (n, p, k) of the rigid tool's readings, by the model that is fitted."""
    model, _, _ = model_and_rig(space)
    recording = recorded(plain, space, "plain")
    return model_response(model, recording, np.zeros(len(model.parameters))).derivative


def recorded(simulated: pd.DataFrame, space: Space, name: str) -> Recording:
    """As a recording; a single run without a count of repeats."""
    columns = {str(c): simulated[c].to_numpy(dtype=float) for c in simulated}
    if columns["repeat"].max() == 0:
        del columns["repeat"]
    return from_columns(columns, name=name, rig=model_and_rig(space)[2])


@dataclass(frozen=True)
class Trial:
    """One discovery: what was hidden, in which noise, and what came out."""

    form: str | None
    space: Space
    power: float
    noise: str
    repeats: int
    seed: int
    complexity: int = 6

    def recordings(self) -> tuple[list[Recording], float]:
        """The fitted motion and the one held out, with noise; and the size of what is hidden."""
        _, rig, _ = model_and_rig(self.space)
        size = 0.0 if self.form is None else (self.power / unit_power(self.form, self.space, self.repeats)) ** 0.5
        several = []
        for motion in MOTIONS[:2]:
            simulated = frame(self.form, self.space, size, motion, self.repeats)
            rng = np.random.default_rng([self.seed, motion, self.repeats, len(self.noise)])
            draws = NOISE_MODELS[self.noise].draw(rng, len(simulated), len(rig.channels))
            simulated[list(rig.channels)] += draws * np.array(rig.noise)
            several.append(recorded(simulated, self.space, f"motion {motion}"))
        return several, size

    def run(self) -> Outcome:
        """Draw the noise and discover."""
        several, size = self.recordings()
        started = time.process_time()
        model = model_and_rig(self.space)[0]
        found = discover(model, several[0], validate=several[1], complexity=self.complexity)
        seconds = time.process_time() - started
        third = recorded(frame(self.form, self.space, size, MOTIONS[2], self.repeats), self.space, "third")
        return Outcome.of(self, found, third_share(found, third), seconds)


def third_share(found: Discovery, third: Recording) -> float:
    """Share of what is beyond the rigid tool on a third motion without noise that the terms predict, as fitted."""
    _, rig, _ = model_and_rig(found.first.model.space)
    noise, left = np.array(rig.noise), []
    for fitted in (found.first, found.last):
        values = {name.partition("@")[0]: value for name, value in fitted.values.items()}
        theta = np.array([values[p.name] for p in fitted.model.parameters])
        left.append(float((((third.wrench - predicted_readings(fitted.model, third, theta)) / noise) ** 2).sum()))
    return 1 - left[1] / left[0]


@dataclass(frozen=True)
class Outcome:
    """What a trial found: the formulas proposed, whether the true one is among those, or among the listed ones.

    third    share on a third motion
    within   constants of the first term within two of their std, of all; counted where it is exact
    """

    trial: Trial
    formulas: tuple[str, ...]
    exact: bool
    in_set: bool
    third: float
    within: tuple[int, int]
    seconds: float

    @classmethod
    def of(cls, trial: Trial, found: Discovery, third: float, seconds: float) -> Outcome:
        """Of a discovery."""
        true = FORMS[trial.form][1] if trial.form else ()
        formulas = tuple(equation.formula for equation in found.equations)
        space = found.first.model.space
        listed = {o.term.printed(space) for e in found.equations for o, _ in e.found.alternatives}
        exact = bool(formulas) and formulas[0] in true
        within = (0, 0)
        if exact and trial.form is not None and trial.form in LAWS:
            size = (trial.power / unit_power(trial.form, trial.space, trial.repeats)) ** 0.5
            known = {"c": size, "d": Load.d}
            pairs = [(abs(v), std, known[n]) for n, (v, std, _) in found.equations[0].parameters.items() if n in known]
            within = (sum(abs(v - true) < 2 * std for v, std, true in pairs), len(pairs))
        in_set = exact or bool(set(true) & {*formulas, *listed})
        return cls(trial, formulas, exact, in_set, third, within, seconds)


def results_table(outcomes: Sequence[Outcome]) -> Table:
    """A row for each form, power, noise and number of repeats, and for all of them but what has nothing hidden."""
    cells = [(o.trial.form or "nothing", o.trial.power, o.trial.noise, o.trial.repeats) for o in outcomes]
    several = {
        cell: [o for o, own in zip(outcomes, cells, strict=True) if own == cell] for cell in dict.fromkeys(cells)
    }
    for power, noise, repeats in dict.fromkeys(cell[1:] for cell in cells):
        of_all = [
            o for cell, own in several.items() if cell[1:] == (power, noise, repeats) for o in own if o.trial.form
        ]
        several |= {("all", power, noise, repeats): of_all} if of_all else {}
    rows = []
    for cell, own in several.items():
        none = sum(not o.formulas for o in own)
        wrong = sum(bool(o.formulas) and not o.in_set for o in own)
        low, high = binomial_interval(wrong, len(own), 0.95)
        thirds = [o.third for o in own if o.formulas and o.trial.form]
        within = np.sum([o.within for o in own], axis=0)
        counts = (sum(o.exact for o in own), sum(o.in_set for o in own), none, wrong)
        of_third = f"{np.median(thirds):.1%}" if thirds else ""
        seconds = float(np.median([o.seconds for o in own]))
        in_two_std = f"{within[0]} of {within[1]}"
        rows.append((*cell, len(own), *counts, f"{low:.1%} to {high:.1%}", of_third, in_two_std, seconds))
    counted = ("hidden", "power", "noise", "repeats", "draws", "exact", "in set", "none", "wrong", "wrong, 95 %")
    return Table.of((*counted, "third", "2 std", Column("CPU s", format=".1f")), rows)


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--forms", nargs="*", default=list(FORMS), choices=list(FORMS))
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--power", type=float, nargs="*", default=[200.0])
    parser.add_argument("--noise", nargs="*", default=["white"], choices=list(NOISE_MODELS))
    parser.add_argument("--repeats", type=int, nargs="*", default=[4])
    parser.add_argument("--spaces", nargs="*", default=[s.name for s in Space], help="of those with nothing hidden")
    parser.add_argument("--complexity", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.draws)
    cells = list(product(options.noise, options.repeats))
    trials = [
        Trial(form, FORMS[form][0], power, noise, repeats, seed, options.complexity)
        for form, power, (noise, repeats), seed in product(options.forms, options.power, cells, seeds)
    ]
    spaces = [Space[name] for name in options.spaces]
    trials += [
        Trial(None, spaces[seed % len(spaces)], 0.0, noise, repeats, seed, options.complexity)
        for (noise, repeats), seed in product(cells, range(options.seed, options.seed + options.nulls))
    ]
    outcomes = []
    with ProcessPoolExecutor(options.workers) as pool:
        for outcome in pool.map(Trial.run, trials):
            outcomes.append(outcome)
            t = outcome.trial
            said = f"{t.form} {t.power:g} {t.noise} x{t.repeats} #{t.seed}: {'; '.join(outcome.formulas) or 'none'}"
            said += f" | {outcome.third:.1%}" if outcome.formulas else ""
            mark = "=" if outcome.exact else "~" if outcome.in_set else "-" if not outcome.formulas else "WRONG"
            print(f"{len(outcomes)}/{len(trials)} {mark} {said} {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
    print(results_table(outcomes))


if __name__ == "__main__":
    main()
