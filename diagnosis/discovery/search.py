"""Search of one term: all of the grammar are scored, the best refined, and judged on another motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from diagnosis.discovery.grammar import Term
from diagnosis.discovery.quantities import DISTANCE, EDGE, PLACE, WIDTH, Leaf
from diagnosis.discovery.term_columns import TermColumns
from diagnosis.progress import CountCallback, counted
from diagnosis.screening.null_model import NullModel
from diagnosis.screening.projection import PointTest, ProjectedColumns
from estimation.fit import Fit
from estimation.multiplicity import chi2_sf, normal_isf
from modeling.significance import LEVELS

Array = NDArray[np.float64]

TERMS_AT_ONCE = 64
"""Terms whitened together: in six axes and 8000 samples of a single run, 75 MB for three amplitudes each."""
NODE = float(np.log(12))
"""Nats for each leaf or operation of a term: what it takes to choose one of about twelve."""
FINALISTS = 40
WITHIN = 0.5
"""Most terms that are refined, and their least share of the best score before that: on a grid of a few places the score
of a force towards one is half of what it is at its own."""
SEARCHED = {DISTANCE: 3, EDGE: 7, WIDTH: 2, **dict.fromkeys(PLACE, 5)}
"""Values of each parameter that a term is not linear in, at which it is scored before it is refined."""
NARROWEST = 1e-4
"""Of a width, m: a step in a tenth of a millimetre is one between any two samples."""
BEYOND = 0.5
"""How far a place may be outside the box of the motion, in its size."""
REFINEMENTS = 120
"""Evaluations, by which four parameters are found to a hundredth of their range."""
ODDS = 100.0
"""Odds within which a term is in the set of those that cannot be told apart."""
HELD_OUT_LEVEL = 1e-3
"""Of the one-sided test that what a term predicts for the other motion is in its residual: stricter than a test that
decides alone, as the term was chosen among thousands, and up to three are asked."""
LEAST_CARRIED = 0.5
"""Share of what refitted amplitudes would explain on the other motion that the carried ones have to."""


@dataclass(frozen=True, eq=False)
class ScoredTerm:
    """A term with its scores on the fitted motion.

    shapes      values of the parameters that it is not linear in
    amounts     estimated amplitudes (a,), covariance (a, a) in the noise as estimated
    score       drop of the whitened chi-square
    level       of the noise where its score comes from, relative to that which whitened
    """

    term: Term
    shapes: Mapping[str, float]
    amounts: Array
    covariance: Array
    score: float
    level: float = 1.0

    def evidence(self, rows: int) -> float:
        """Twice the log of its odds against nothing, description length counted (BIC), in `rows` lines."""
        length = 2 * NODE * self.term.complexity + (len(self.amounts) + len(self.shapes)) * np.log(rows)
        return float(self.score / self.level - length)


@dataclass(frozen=True, eq=False)
class HeldOutTerm:
    """A scored term on the motions held out, its amplitudes carried over.

    carried    drop of chi-square there by the carried amplitudes, `refitted` that by the best ones
    z          its correlation with the residual there over its std: normal without the term
    """

    scored: ScoredTerm
    carried: float
    refitted: float
    z: float

    @property
    def holds(self) -> bool:
        """Whether the term with its constant is in the other motion."""
        return self.z > float(normal_isf(HELD_OUT_LEVEL)) and self.carried > LEAST_CARRIED * self.refitted

    def evidence(self, rows: int) -> float:
        """Twice the log of its odds against nothing, on both motions."""
        return self.scored.evidence(rows) + self.carried / self.scored.level


class TermSearch:
    """Scores of terms given a fit.

    `ranges` are those (low, high) in which the parameters that terms are not linear in are sought, by name; that of an
    edge is by its axis.
    """

    def __init__(self, fit: Fit, leaves: Mapping[str, Leaf], ranges: Mapping[str, tuple[float, float]]) -> None:
        self.fit, self.null_model, self._leaves, self._ranges = fit, NullModel(fit), leaves, ranges

    @cached_property
    def rows(self) -> int:
        """Number of whitened rows in which terms show."""
        return sum(noise.whitener.periodic_rows for noise in self.fit.noise)

    def scored(self, terms: Sequence[Term], announce: CountCallback | None = None) -> tuple[list[ScoredTerm], float]:
        """The terms at their best shapes, where they show, and the effective number of tests of them all."""
        best: dict[Term, ScoredTerm] = {}
        smallest = np.ones(1)
        for shapes, batch in counted(self._batches(terms), announce):
            projected = TermColumns(self.null_model, self._leaves, shapes).projected(batch)
            noise, ranks = projected.noise_scores_by_point(), projected.ranks
            for rank in np.unique(ranks[ranks > 0]):
                smallest = np.minimum(smallest, chi2_sf(noise[ranks == rank].max(axis=0), float(rank)))
            for place, term in enumerate(batch):
                scored = _scored(projected, place, term, shapes)
                if scored is not None and (term not in best or scored.score > best[term].score):
                    best[term] = scored
        tests = max(1.0, 0.1 / max(float(np.quantile(smallest, 0.1)), 1e-12))
        return list(best.values()), tests

    def _batches(self, terms: Sequence[Term]) -> list[tuple[Mapping[str, float], list[Term]]]:
        """Terms that are computed together, with the values of the parameters that they are not linear in."""
        space, columns = self.fit.model.space, TermColumns(self.null_model, self._leaves, {})

        def alike(term: Term) -> tuple[str, int, tuple[str, ...], str, tuple[bool, ...]]:
            periodic = tuple(columns.is_periodic(term, number) for number in range(len(self.fit.recordings)))
            shapes = term.shapes(self._leaves)
            stage = term.kind if term.by_channel else "load"
            return stage, len(term.amplitudes(space)), shapes, _edge(term) if EDGE in shapes else "", periodic

        batches: list[tuple[Mapping[str, float], list[Term]]] = []
        for _, group in groupby(sorted(terms, key=alike), key=alike):
            together = list(group)
            names = together[0].shapes(self._leaves)
            grids = [self._values(name, together[0]) for name in names]
            for values in product(*grids):
                starts = range(0, len(together), TERMS_AT_ONCE)
                shapes = dict(zip(names, map(float, values), strict=True))
                batches += [(shapes, together[first : first + TERMS_AT_ONCE]) for first in starts]
        return batches

    def _values(self, name: str, term: Term) -> Array:
        """Values of a parameter at which a term is scored: to the ends of a range, of an edge within it."""
        low, high = self._range(name, term)
        if name in (DISTANCE, WIDTH):
            return np.linspace(low, high, SEARCHED[name] + 1)[1:]
        return (
            np.linspace(low, high, SEARCHED[name] + 2)[1:-1] if name == EDGE else np.linspace(low, high, SEARCHED[name])
        )

    def _limits(self, name: str) -> tuple[float, float]:
        """Of a parameter in its refinement. A force far beyond the tool would be a torque."""
        if name == DISTANCE:
            return self._ranges[name]
        return (NARROWEST if name == WIDTH else -np.inf), np.inf

    def _range(self, name: str, term: Term) -> tuple[float, float]:
        return self._ranges[_edge(term) if name == EDGE else name]

    def refined(self, scored: ScoredTerm) -> ScoredTerm:
        """A term with its shapes refined, without amplitudes that are not worth their description."""
        best, names = scored, tuple(scored.shapes)
        if names:
            low, high = np.array([self._range(name, scored.term) for name in names]).T
            start = np.array([scored.shapes[name] for name in names])
            step = (high - low) / np.array([SEARCHED[name] for name in names]) / 2
            simplex = np.vstack(
                [start, *(start + side * np.diag(step)[i] for i, side in enumerate(_inward(start, low, high)))]
            )

            def cost(values: Array) -> float:
                nearby = self._at(scored.term, dict(zip(names, values.tolist(), strict=True)))
                return 0.0 if nearby is None else -nearby.score

            bounds = [self._limits(name) for name in names]
            options: Any = {"initial_simplex": simplex, "maxfev": REFINEMENTS, "xatol": 1e-4, "fatol": 1e-2}
            at_best = minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options).x
            best = self._at(scored.term, dict(zip(names, at_best.tolist(), strict=True))) or scored
        while len(best.amounts) > 1:
            fewer = self._without_one(best)
            if fewer is None or fewer.evidence(self.rows) <= best.evidence(self.rows):
                break
            best = fewer
        return best

    def _at(self, term: Term, shapes: Mapping[str, float]) -> ScoredTerm | None:
        return _scored(TermColumns(self.null_model, self._leaves, shapes).projected([term]), 0, term, shapes)

    def _without_one(self, scored: ScoredTerm) -> ScoredTerm | None:
        """Without the amplitude that is nearest to nothing for its std."""
        ratio = np.abs(scored.amounts) / np.sqrt(np.diag(scored.covariance))
        weakest = int(np.argmin(ratio))
        kept = scored.term.kept or tuple(range(len(scored.amounts)))
        left = tuple(place for number, place in enumerate(kept) if number != weakest)
        return self._at(replace(scored.term, kept=left), scored.shapes)

    def test(self, scored: ScoredTerm) -> PointTest:
        """Its score test, in the noise where its score comes from."""
        return TermColumns(self.null_model, self._leaves, scored.shapes).projected([scored.term]).test(0)

    def held_out(self, scored: ScoredTerm) -> tuple[float, float, float]:
        """Drop of chi-square by the amplitudes carried over to this fit's motion, by the best ones, and z."""
        projected = TermColumns(self.null_model, self._leaves, scored.shapes).projected([scored.term])
        columns = self.null_model.project_out(self.null_model.spread(projected.columns(0), projected.whitened.choice))
        predicted = columns @ scored.amounts
        power, along = float(predicted @ predicted), float(predicted @ self.null_model.residual)
        if power == 0:
            return 0.0, float(projected.scores[0]), 0.0
        level = max(projected.test(0).together.noise.mean, 1.0)  # of a single run the noise may be larger there
        return 2 * along - power, float(projected.scores[0]), along / (power * level) ** 0.5


def _scored(projected: ProjectedColumns, place: int, term: Term, shapes: Mapping[str, float]) -> ScoredTerm | None:
    """One of the terms of projected columns; without amplitudes that have no effect, None where others are aliased."""
    shows = np.isfinite(projected.scale[place])
    if not projected.ranks[place] or projected.ranks[place] < shows.sum():
        return None
    if not shows.all():
        kept = np.arange(len(shows)) if term.kept is None else np.array(term.kept)
        term = replace(term, kept=tuple(kept[shows].tolist()))
    roots = (projected.roots[place] / projected.scale[place][:, None])[shows]
    return ScoredTerm(term, shapes, projected.amounts[place][shows], roots @ roots.T, float(projected.scores[place]))


def _edge(term: Term) -> str:
    """The coordinate of a term that begins at an edge."""
    return next(
        name.split("_")[1] for name in term.quantity.leaves if name.startswith(("over_", "under_", "onto_", "into_"))
    )


def _inward(start: Array, low: Array, high: Array) -> Array:
    """Towards the middle of a range, +1 or -1."""
    return np.where(start > (low + high) / 2, -1.0, 1.0)


@dataclass(frozen=True, eq=False)
class FoundTerm:
    """The best term of a search, and those that cannot be told from it.

    p_value      of its score on the fitted motion, corrected for all terms tested
    alternatives  other terms within `ODDS`, with the odds of the best against them, the nearest first
    """

    best: HeldOutTerm
    p_value: float
    alternatives: tuple[tuple[ScoredTerm, float], ...]


def best_term(
    search: TermSearch,
    held_out: Sequence[TermSearch],
    terms: Sequence[Term],
    announce: CountCallback | None = None,
) -> FoundTerm | None:
    """The term that is the most likely on all motions, and significant among all; None where none is.

    Whether it `holds` on the motions held out is still to be asked.
    """
    scored, tests = search.scored(terms, announce)
    rows = search.rows
    ordered = sorted(scored, key=lambda each: -each.evidence(rows))
    if not ordered:
        return None
    finalists = [each for each in ordered[:FINALISTS] if each.score > WITHIN * ordered[0].score]
    refined = _distinct([search.refined(each) for each in finalists], rows)
    first = refined[0]
    test = search.test(first)
    level = max(test.together.noise.mean, 1.0)
    p_value = min(1.0, tests * test.p_value())
    if p_value >= LEVELS.effect:
        return None
    judged = []
    for each in refined:
        parts = np.array([other.held_out(each) for other in held_out])
        carried, best = parts[:, :2].sum(axis=0)
        judged.append(
            HeldOutTerm(replace(each, level=level), carried, best, float(parts[:, 2].sum() / len(parts) ** 0.5))
        )
    judged.sort(key=lambda each: -each.evidence(rows))
    winner = judged[0]
    behind = [(each.scored, (winner.evidence(rows) - each.evidence(rows)) / 2) for each in judged[1:]]
    near = tuple((scored, float(np.exp(nats))) for scored, nats in behind if nats <= np.log(ODDS))
    return FoundTerm(winner, p_value, near)


SAME = 1e-6
"""Relative difference of two terms' scores below which they are one and the same, written differently."""


def _distinct(scored: Sequence[ScoredTerm], rows: int) -> list[ScoredTerm]:
    """Terms without those that give the same as a simpler one, the best first."""
    chosen: list[ScoredTerm] = []
    for each in sorted(scored, key=lambda one: -one.evidence(rows)):
        same = any(
            len(o.amounts) == len(each.amounts) and abs(o.score - each.score) < SAME * each.score for o in chosen
        )
        if not same:
            chosen.append(each)
    return chosen
