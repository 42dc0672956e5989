"""Designing on the reference problem against what a user would take instead: `python -m benchmarks.design_race`.

All maximise ln det(Phi'Phi) of 200 samples in 5 s within the limits, one after the other in one process, so that a
ratio of times belongs to one run; every seed is a run. Compared are

Nelder-Mead, penalty              best of three searches of 30 000 evaluations over the 15 coefficients of 22.10
L-BFGS-B, differences, penalty    several starts of a free series, in as many evaluations; differences count
nevergrad CMA, penalty            a free series, 30 000 evaluations
Nelder-Mead, as the chapter       115 evaluations without limits, scaled to fit them afterwards
x_opt of 22.17, scaled            and the best of many random motions

It is fair because the rivals are tuned: coefficients scaled to the limits, the kind and weight of the penalty and every
optimiser's options were chosen for them on this problem, evaluations are vectorised and a gradient's differences are
evaluated together; and their motions need keep the limits at the samples only, to 0.1 %, where ours keeps them at every
instant. Deriving the regressor is outside the clock for all; building our optimiser's graphs is inside.

`--quick` runs one seed, with one start of ours and a third of nevergrad's evaluations; `--plot race.png` draws quality
against time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import our_design
from benchmarks.rivals import evolution, finite_differences, nelder_mead, unoptimised
from benchmarks.rivals.reference import PARAMETERS
from benchmarks.rivals.trace import Trace, one_after_the_other
from benchmarks.row import Row, table

SEEDS, SEARCHES = 5, 3
Run = Callable[[int], Trace]
Race = Mapping[str, Trace]
"""The trace of every entrant by name."""
OURS = "truewrench"
SIMPLEX = "Nelder-Mead, best of 3"
UNOPTIMISED = ("x_opt of 22.17, scaled", "1000 random motions")


def simplex(seed: int) -> Trace:
    """Three searches one after the other."""
    return one_after_the_other([nelder_mead.penalised(SEARCHES * seed + number) for number in range(SEARCHES)])


def entrants(*, quick: bool) -> Mapping[str, Run]:
    """What runs, by name, in the order of the table."""
    budget, starts = (evolution.EVALUATIONS // 3, 1) if quick else (evolution.EVALUATIONS, None)
    return {
        OURS: partial(our_design.traced, starts=starts),
        SIMPLEX: simplex,
        "L-BFGS-B, differences": finite_differences.penalised,
        "nevergrad CMA": partial(evolution.penalised, evaluations=budget),
        "Nelder-Mead, 115": nelder_mead.as_the_chapter,
        UNOPTIMISED[0]: lambda seed: unoptimised.scaled_optimum(),
        UNOPTIMISED[1]: unoptimised.random_motions,
    }


def races(seeds: int, *, quick: bool) -> list[Race]:
    """A race for each seed; progress goes to a terminal's stderr."""
    found: list[Race] = []
    for seed in range(seeds):
        race: dict[str, Trace] = {}
        for name, run in entrants(quick=quick).items():
            if sys.stderr.isatty():
                print(f"  seed {seed}: {name} ...", file=sys.stderr, flush=True)
            race[name] = run(seed)
        found.append(race)
    return found


def rows(raced: Sequence[Race]) -> list[Row]:
    """Ratios of every race, for each rival: of times, and of the repeats that its best motion needs to be as good.

    Both times are over ours until the first motion that is better than the rival's best: that of its whole run, which
    is what it costs a user who does not know beforehand when to stop, and that after which it found no better one.
    Zero when we never came there. N repeats multiply det M of k parameters by N^k.
    """
    found = []
    for rival in list(raced[0])[1:]:
        pairs = [(race[OURS].first_better(race[rival].best), race[OURS], race[rival]) for race in raced]
        quantities = {"repeats needed": [float(np.exp((o.best - r.best) / PARAMETERS)) for _, o, r in pairs]}
        if rival not in UNOPTIMISED:
            quantities["time, whole run"] = [r.total_seconds / ours for ours, _, r in pairs]
            quantities["time to its best"] = [float(r.seconds[-1]) / ours for ours, _, r in pairs]
        found += [
            Row(task="reference problem", ours="design", instead=rival, quantity=quantity, ratios=tuple(ratios))
            for quantity, ratios in quantities.items()
        ]
    return found


def summary(raced: Sequence[Race]) -> str:
    """ln det, evaluations and seconds of every entrant: medians over the seeds, of ln det also the extremes."""
    heads = ("", "ln det", "from", "to", "use", "evaluations", "seconds")
    lines = [heads, *(_line(name, [race[name] for race in raced]) for name in raced[0])]
    widths = [max(len(line[i]) for line in lines) for i in range(len(heads))]
    shown = [
        "  ".join(c.rjust(w) if i else c.ljust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True))).rstrip()
        for line in lines
    ]
    note = f"use: the largest share of a limit at any instant; medians of {len(raced)} seeds, ln det from and to"
    return "\n".join([*shown, "", note])


def _line(name: str, traces: Sequence[Trace]) -> tuple[str, ...]:
    best = [trace.best for trace in traces]
    rest = (np.median([getattr(t, key) for t in traces]) for key in ("use", "total_evaluations", "total_seconds"))
    use, evaluations, seconds = rest
    numbers = (f"{v:.2f}" for v in (np.median(best), min(best), max(best)))
    return (name, *numbers, f"{use:.4f}", f"{evaluations:.0f}", f"{seconds:.2f}")


def run() -> list[Row]:
    """The short version."""
    return rows(races(1, quick=True))


def main() -> None:
    """Race, print both tables, and draw."""
    parser = argparse.ArgumentParser(description="design on the reference problem against common optimisers")
    parser.add_argument("--seeds", type=int, help=f"runs of each (default: {SEEDS}, quick 1)")
    parser.add_argument("--quick", action="store_true", help="a few minutes instead of a quarter of an hour")
    parser.add_argument("--plot", type=Path, help="where to write the picture, e.g. race.png")
    options = parser.parse_args()
    raced = races(options.seeds or (1 if options.quick else SEEDS), quick=options.quick)
    print(summary(raced), table(rows(raced)), sep="\n\n")
    if options.plot is not None:
        from benchmarks.race_plot import race_figure

        race_figure(raced).savefig(options.plot, dpi=200, facecolor="white")


if __name__ == "__main__":
    main()
