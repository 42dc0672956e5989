"""Simulation-based calibration: do stated intervals and probabilities come true?

`python -m benchmarks.calibration [--nightly] [--noise NAME ...] [--repeats N ...] [--out FOLDER]`: five minutes on two
idle cores, nightly two hours. Recordings are drawn from a prior (`calibration_draws.py`) for each kind of noise and
number of repeats, in the plane and in six axes, of two lengths, with an effect in them; each is fitted with that
effect, others are diagnosed without it.

ranks      of the truth among draws of the stated posterior: estimate, covariance, Student's t with the stated freedom.
           They are uniform if the intervals hold, whatever truth is drawn (S. Talts, M. Betancourt, D. Simpson,
           A. Vehtari and A. Gelman, arXiv:1804.06788, 2018). Of a recording one parameter of a kind counts, taken at
           random, so that what is counted is independent; `together` is the distance from the estimate over all
           parameters, in the stated covariance. p is of uniform ranks, Holm over the table
inside     share of 95 % intervals that hold the truth; `narrow`: how many times wider 95 % would need them
stated     lack of fit of the right model at 5 %, which is to be 5 % or less; a false effect and false lack of fit where
           nothing is hidden (1 % each); whether what a diagnosis names holds the hidden effect, with what it calls
           confusable (95 %); whether an effect of the stated detectable size at the stated place is significant in its
           score test, and whether it is named (75 to 85 %)

Intervals and bands are of 99 % and of the number of recordings that they say (C. J. Clopper and E. S. Pearson,
Biometrika 26 (1934) 404). What a diagnosis got wrong is listed with the recording's number:
`diagnosed(Draw.of("white", 4, 17))` makes it again. Progress goes to stderr.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.stats import binom, chi2

from benchmarks.calibration_draws import DRAWS, KINDS_OF_NOISE, Draw, Fitted, Rank, Said, diagnosed, fitted
from benchmarks.race_plot import COLOURS
from diagnosis.calibrate import results_of
from diagnosis.calibration import Rate
from diagnosis.progress import count_progress
from estimation.multiplicity import binomial_interval, holm_adjusted
from modeling.errors import InputError
from modeling.significance import LEVELS
from modeling.table import Table
from truewrench.plots.chart import Band, Chart, Level, Line, Mark, Panel, Points
from truewrench.plots.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR, MUTED

Result = TypeVar("Result")

BINS = 10
"""Of a histogram, each of equally many ranks."""
BAND = 0.99
"""Of bands, over all bins of a histogram together, and of the interval of each share."""
REPEATS, ANY = (1, 2, 4, 8), "any noise"
SIZES = {"five minutes": (24, 9), "nightly": (600, 225)}
"""Recordings fitted and diagnosed, of each kind of noise and number of repeats."""
KINDS = {
    "bias": "zero of a channel",
    "tool": "parameter of the tool",
    "effect": "parameter of the effect",
    "together": "distance over all parameters",
}
"""Of parameters, and what a rank is of."""
WIDTH, LEAST_SHARE = 1700, 1e-3
"""Of a picture, CSS pixels; a share that is drawn where there is none, on a logarithmic axis."""
STATED = {
    "lack of fit at 5 %": (0.0, 0.05),
    "false effect": (0.0, LEVELS.effect),
    "false lack of fit": (0.0, LEVELS.effect),
    "set named holds it": (0.95, 1.0),
    "found by score": (0.75, 0.85),
    "found by name": (0.75, 0.85),
}
"""Probabilities as they are stated, from and to."""


@dataclass(frozen=True)
class Histogram:
    """Counts of ranks in bins, of so many recordings."""

    counts: tuple[int, ...]

    @classmethod
    def of(cls, ranks: Iterable[int]) -> Histogram:
        """In bins of equally many ranks."""
        places = np.array(list(ranks), dtype=int) * BINS // (DRAWS + 1)
        return cls(tuple(np.bincount(places, minlength=BINS).tolist()))

    @property
    def band(self) -> tuple[float, float]:
        """Least and largest count of any bin in `BAND` or more of all histograms of uniform ranks (Bonferroni)."""
        tail, count = (1 - BAND) / 2 / BINS, sum(self.counts)
        return float(binom.ppf(tail, count, 1 / BINS)), float(binom.isf(tail, count, 1 / BINS))

    @property
    def p_value(self) -> float:
        """Of uniform ranks, by chi-square; with fewer than five recordings a bin it is known to a factor of two."""
        expected = sum(self.counts) / BINS
        return float(chi2.sf(((np.array(self.counts) - expected) ** 2).sum() / expected, BINS - 1)) if expected else 1.0


# ------------------------------------------------------------------------------------------------- results


def interval(rate: Rate) -> tuple[float, float]:
    """Of its probability, at `BAND`."""
    return binomial_interval(rate.count, rate.total, BAND)


@dataclass(frozen=True)
class Cell:
    """What came of the recordings of one kind of noise and number of repeats (0: of any), and how many were refused."""

    noise: str
    repeats: int
    fits: Sequence[Fitted]
    told: Mapping[int, Said]
    refused: int = 0

    @property
    def name(self) -> str:
        """Noise and repeats."""
        return f"{self.noise}, {self.repeats or 'any'} repeat{'s' * (self.repeats != 1)}"

    def ranks(self, kind: str) -> list[Rank]:
        """Of one kind of parameter."""
        return [rank for result in self.fits for rank in result.ranks if rank.kind == kind]

    def histogram(self, kind: str) -> Histogram:
        """Of its ranks."""
        return Histogram.of(rank.rank for rank in self.ranks(kind))

    def inside(self, kind: str) -> Rate:
        """Of the 95 % intervals of a kind, those that hold the truth."""
        return _rate(rank.distance <= 1 for rank in self.ranks(kind))

    def narrow(self, kind: str) -> float:
        """How many times wider the intervals of a kind would have to be for 95 % of them to hold the truth."""
        return float(np.quantile([rank.distance for rank in self.ranks(kind)] or [np.nan], LEVELS.confidence))

    @property
    def stated(self) -> dict[str, Rate]:
        """How often what is stated came true, as `STATED`."""
        nulls = [s for s in self.told.values() if not s.hidden]
        at_limit = [s for s in self.told.values() if s.size == 1]
        rates = (
            _rate(f.lack_of_fit < 0.05 for f in self.fits),
            _rate(bool(s.added) for s in nulls),
            _rate(s.false and not s.added for s in nulls),
            _rate(s.holds for s in self.told.values() if s.hidden and s.added),
            _rate(s.significant for s in at_limit),
            _rate(s.holds for s in at_limit),
        )
        return dict(zip(STATED, rates, strict=True))

    @property
    def failures(self) -> list[str]:
        """What was said wrongly, with the number of the recording."""
        return [
            f"{self.noise}, {self.repeats}, {number}: {said.verdict.value} ({', '.join(said.added)}), hidden "
            + (f"{said.hidden}, {said.size:g} times the detectable size" if said.hidden else "nothing")
            for number, said in self.told.items() if said.false
        ]  # fmt: skip

    def to_data(self) -> dict[str, Any]:
        """Everything as plain data."""
        kinds = {
            kind: {"counts": (own := self.histogram(kind)).counts, "band": own.band, "p": own.p_value}
            | ({} if kind == "together" else {"inside": self.inside(kind).to_data(), "narrow": self.narrow(kind)})
            for kind in KINDS
        }
        stated = {name: rate.to_data() | {"stated": STATED[name]} for name, rate in self.stated.items()}
        head = {"noise": self.noise, "repeats": self.repeats, "refused": self.refused}
        return {**head, "kinds": kinds, "stated": stated, "failures": self.failures}


def _rate(hits: Iterable[bool]) -> Rate:
    each = list(hits)
    return Rate(sum(each), len(each))


def run(cells: Sequence[tuple[str, int]], fits: int, diagnoses: int, workers: int) -> list[Cell]:
    """So many recordings of each kind of noise and number of repeats; what is refused is said on stderr."""

    def shared_out(count: int, doing: str, work: Callable[[Draw], Result]) -> list[dict[int, Result]]:
        progress = count_progress(partial(print, file=sys.stderr, flush=True), doing)

        def result(place: int) -> Result | None:
            number, cell = divmod(place, len(cells))
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    return work(Draw.of(*cells[cell], number))
            except InputError as error:
                print(f"{cells[cell]}, {number}: {error}", file=sys.stderr)
                return None

        def announce(done: int, of: int) -> None:
            if done % max(1, of // 20) == 0:
                progress(done, of)

        each = results_of(result, range(count * len(cells)), workers, announce)
        numbered = [enumerate(each[place :: len(cells)]) for place in range(len(cells))]
        return [{number: own for number, own in results if own is not None} for results in numbered]

    every = zip(cells, shared_out(fits, "fit", fitted), shared_out(diagnoses, "diagnose", diagnosed), strict=True)
    return [Cell(*cell, list(own.values()), said, fits + diagnoses - len(own) - len(said)) for cell, own, said in every]


def with_margins(cells: Sequence[Cell]) -> list[Cell]:
    """The cells, and those of each kind of noise, of each number of repeats, and of everything together."""
    noises, repeats = dict.fromkeys(cell.noise for cell in cells), dict.fromkeys(cell.repeats for cell in cells)
    margins = [*((noise, 0) for noise in noises), *((ANY, r) for r in repeats), (ANY, 0)]
    return [*cells, *(_together(cells, noise, r) for noise, r in margins)]


def _together(cells: Sequence[Cell], noise: str, repeats: int) -> Cell:
    """Of one kind of noise, or any, and one number of repeats, or any."""
    own = [c for c in cells if noise in (ANY, c.noise) and repeats in (0, c.repeats)]
    told = enumerate(said for cell in own for said in cell.told.values())
    return Cell(noise, repeats, [f for c in own for f in c.fits], dict(told), sum(c.refused for c in own))


def adjusted(cells: Sequence[Cell]) -> dict[tuple[str, str], float]:
    """P-values of all histograms, Holm over them, by the cell's name and kind."""
    p_values = {(cell.name, kind): cell.histogram(kind).p_value for cell in cells for kind in KINDS}
    return dict(zip(p_values, holm_adjusted(list(p_values.values())), strict=True))


def tables(cells: Sequence[Cell]) -> tuple[Table, Table]:
    """Ranks and intervals; what was stated."""
    p_values, ranks = adjusted(cells), []
    for cell in cells:
        own = [(_text(cell.inside(k)), f"{cell.narrow(k):.2f}", f"{p_values[cell.name, k]:.1g}") for k in KINDS]
        ranks.append((cell.name, str(len(cell.fits)), *own[0], *own[1], *own[2], own[3][2]))
    header = [name for kind in list(KINDS)[:3] for name in (f"{kind} inside", "narrow", "p")]
    stated = [(cell.name, *map(_text, cell.stated.values())) for cell in cells]
    return Table.of(("noise", "fitted", *header, "together p"), ranks), Table.of(("noise", *STATED), stated)


def _text(rate: Rate) -> str:
    low, high = interval(rate)
    return f"{rate.count}/{rate.total} ({100 * low:.0f}-{100 * high:.0f} %)" if rate.total else "-"


# ------------------------------------------------------------------------------------------------ pictures


def rank_chart(cells: Sequence[Cell], kind: str) -> Chart:
    """A histogram for each kind of noise and number of repeats, over the uniform one; what is not uniform is red."""
    p_values, x = adjusted(cells), (np.arange(BINS) + 0.5) * (DRAWS + 1) / BINS
    heights = [end * BINS / sum(h.counts) for c in cells if sum((h := c.histogram(kind)).counts)
               for end in (*h.counts, h.band[1])]  # fmt: skip

    def panel(cell: Cell) -> Panel:
        histogram, p = cell.histogram(kind), p_values[cell.name, kind]
        count = sum(histogram.counts)
        low, high, *y = (end * BINS / max(count, 1) for end in (*histogram.band, *histogram.counts))
        colour = MISFIT_COLOUR if p < LEVELS.effect else ADEQUATE_COLOUR
        band = Band(low=low, high=high, label=f"holds {BAND:.0%} of the histograms of n uniform ranks")
        marks = (band, Level(y=1.0, dashed=True), Line(x=x, y=np.array(y), colour=colour, steps=True, width=1.6))
        return Panel(
            marks=marks, title=f"{cell.name}, n {count}, p {p:.1g}", title_colour=colour, y_label="count / uniform",
            x_label=f"rank of the truth among {DRAWS} draws", x_limits=(0, DRAWS + 1),
            y_limits=(0, 1.05 * max(heights, default=1.0)),
        )  # fmt: skip

    title = f"Ranks of the truth: {KINDS[kind]}. Red: p of uniform ranks (Holm over all pictures) below 1 %"
    rows = [tuple(panel(c) for c in cells if c.noise == noise) for noise in dict.fromkeys(c.noise for c in cells)]
    return Chart(rows=tuple(rows), title=title, row_height=95, width=WIDTH, shared_x=True, shared_y=True)


def p_value_chart(cells: Sequence[Cell]) -> Chart:
    """P-values of right models: a panel for each number of repeats, a line for each kind of noise."""

    def panel(own: Sequence[Cell]) -> Panel:
        levels, counts = np.geomspace(2e-3, 1.0, 60), [len(cell.fits) for cell in own]
        low, high = (np.maximum(end / min(counts), LEAST_SHARE) for end in binom.interval(BAND, min(counts), levels))
        shares = [[np.mean([f.lack_of_fit <= level for f in cell.fits]) for level in levels] for cell in own]
        lines = [Line(x=levels, y=np.maximum(share, LEAST_SHARE), colour=colour, label=cell.noise)
                 for cell, share, colour in zip(own, shares, COLOURS, strict=False)]  # fmt: skip
        band = Band(x=levels, low=low, high=high, label=f"{BAND:.0%} of uniform p-values, at each level")
        return Panel(
            marks=(band, Line(x=levels, y=levels, colour=MUTED, dashed=True), *lines), x_log=True, y_log=True,
            title=f"{_repeats(own)}, n {_span(counts)} each", x_label="level", y_label="share of p-values below",
            x_limits=(2e-3, 1), y_limits=(LEAST_SHARE, 1.2),
        )  # fmt: skip

    title = "Lack of fit of right models"
    return Chart(rows=(tuple(map(panel, _columns(cells))),), title=title, row_height=230, width=WIDTH)


def reliability_chart(cells: Sequence[Cell]) -> Chart:
    """A row for each stated probability, a column for each number of repeats: how often it came true by noise."""
    rows = [(f"95 % of {kind}", (0.95, 0.95), [[c.inside(kind) for c in own] for own in _columns(cells)])
            for kind in list(KINDS)[:3]]  # fmt: skip
    rows += [(name, ends, [[c.stated[name] for c in own] for own in _columns(cells)]) for name, ends in STATED.items()]
    return Chart(
        rows=tuple(_rate_row(name, ends, _columns(cells), rates) for name, ends, rates in rows), shared_x=True,
        title=f"Stated (grey) and observed; red where the interval of {BAND:.0%} does not reach what is stated",
        shared_y=True, row_height=110, width=WIDTH, legend=False,
    )  # fmt: skip


def _rate_row(
    name: str, ends: tuple[float, float], columns: Sequence[Sequence[Cell]], rates: Sequence[Sequence[Rate]]
) -> tuple[Panel, ...]:
    """Shares with their intervals by kind of noise, a panel for each number of repeats."""
    seen = [end for own in rates for rate in own if rate.total for end in interval(rate)]
    limits = (min([*ends, *seen]) - 0.03, max([*ends, *seen]) + 0.03)

    def panel(cells: Sequence[Cell], own: Sequence[Rate]) -> Panel:
        counted = [(i, rate.share, *interval(rate)) for i, rate in enumerate(own) if rate.total]
        marks: list[Mark] = [Band(low=ends[0], high=ends[1]) if ends[1] > ends[0] else Level(y=ends[0], dashed=True)]
        for colour, is_off in ((ADEQUATE_COLOUR, False), (MISFIT_COLOUR, True)):
            those = [c for c in counted if (c[2] > ends[1] or c[3] < ends[0]) is is_off]
            x, share, low, high = np.array(those, dtype=float).reshape(-1, 4).T
            marks.append(Points(x=x, y=share, low=low, high=high, colour=colour, interval=f"{BAND:.0%}"))
        return Panel(
            marks=tuple(marks), title=f"{name}; {_repeats(cells)}, n {_span([rate.total for rate in own])}",
            y_label="share", y_limits=limits, x_limits=(-0.5, len(cells) - 0.5),
            x_ticks=tuple(cell.noise for cell in cells),
        )  # fmt: skip

    return tuple(map(panel, columns, rates))


def _columns(cells: Sequence[Cell]) -> list[list[Cell]]:
    """By number of repeats."""
    return [[cell for cell in cells if cell.repeats == r] for r in dict.fromkeys(cell.repeats for cell in cells)]


def _repeats(cells: Sequence[Cell]) -> str:
    return cells[0].name.rpartition(", ")[2]


def _span(counts: Sequence[int]) -> str:
    return f"{min(counts)}" + (f" to {max(counts)}" if max(counts) > min(counts) else "")


def main() -> None:
    """Run; tables to stdout, pictures and figures.json to the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nightly", action="store_true", help="twenty-five times as many recordings")
    parser.add_argument("--noise", nargs="+", choices=list(KINDS_OF_NOISE), default=list(KINDS_OF_NOISE))
    parser.add_argument("--repeats", nargs="+", type=int, choices=REPEATS, default=list(REPEATS))
    parser.add_argument("--out", type=Path, default=Path("calibration"), help="folder (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default: %(default)s)")
    options = parser.parse_args()
    size = SIZES["nightly" if options.nightly else "five minutes"]
    cells = run([(n, r) for n in options.noise for r in options.repeats], *size, options.workers)
    written(cells, options.out)
    print(*tables(with_margins(cells)), "\n".join(line for cell in cells for line in cell.failures), sep="\n\n")


def written(cells: Sequence[Cell], folder: Path) -> None:
    """Write pictures, PNG and SVG, and figures.json into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    every = with_margins(cells)
    charts = {f"ranks_{kind}": rank_chart(every, kind) for kind in KINDS}
    charts |= {"p_values": p_value_chart(cells), "reliability": reliability_chart(every)}
    for name, chart in charts.items():
        figure = matplotlib_figure(chart)
        for ending in ("png", "svg"):
            figure.savefig(folder / f"{name}.{ending}", dpi=110, facecolor="white")
    (folder / "figures.json").write_text(json.dumps([c.to_data() for c in every], indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
