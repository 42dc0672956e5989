"""Search of one term: all of the grammar are scored, the best refined, and judged on another motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from diagnosis.comparison.slow_residual import SlowResidual
from diagnosis.discovery.grammar import Term
from diagnosis.discovery.leaves import EDGE, Leaf
from diagnosis.discovery.shape_grid import ShapeGrid, edge_axis
from diagnosis.discovery.term_columns import TermColumns
from diagnosis.progress import CountCallback, counted
from diagnosis.screening.null_model import NullModel
from diagnosis.screening.projection import RANK_TOLERANCE, PointTest, ProjectedColumns
from estimation.fit import Fit
from estimation.multiplicity import chi2_sf, normal_isf
from estimation.noise.noise_estimation import estimate_noise
from modeling.noise import NoiseSource
from modeling.significance import LEVELS

Array = NDArray[np.float64]

TERMS_AT_ONCE = 64
"""Terms whitened together: in six axes and 8000 samples of a single run, 75 MB for three amplitudes each."""
NODE = float(np.log(12))
"""Nats for each leaf or operation of a term, and for each amplitude of a channel but one: what it takes to choose one
of about twelve."""
FINALISTS = 40
WITHIN = 0.5
"""Most terms that are refined, and their least share of the best score before that: on a grid of a few places the score
of a force towards one is half of what it is at its own."""
REFINEMENTS = 120
"""Evaluations, by which four parameters are found to a hundredth of their range."""
ODDS = 100.0
"""Odds within which a term is in the set of those that cannot be told apart; and likelihoods beyond which one is that
fits better than the best: only its length is against it."""
HELD_OUT_LEVEL = 1e-3
"""Of the one-sided test that what a term predicts for the other motion is in its residual: stricter than a test that
decides alone, as the term was chosen among thousands, and up to three are asked."""
LEAST_CARRIED = 0.5
"""Share of what refitted amplitudes would explain on the other motion that the carried ones have to."""


def in_noise_beside_columns(fitted: Fit) -> Fit:
    """The fit in the noise that quadratics of the recordings' other columns leave of the residual.

    What follows a column that does not repeat with the motion, as a temperature, differs between repeats, and is slow
    noise of a run: in the noise with it, it does not show. The fit itself where what they leave is slower than noise: a
    zero that wanders takes the shape of any temperature in part.
    """
    noise, units = [], fitted.model.space.channel_units
    for recording, residual, before in zip(fitted.recordings, fitted.residuals, fitted.noise, strict=True):
        columns = [recording.motion.model_signals[name] for name in recording.auxiliary]
        columns = [(x - x.mean()) / x.std() for x in columns if np.ptp(x) > 0]
        if not columns or recording.at_rest or before.source not in (NoiseSource.REPEATS, NoiseSource.RESIDUAL):
            noise.append(before)
            continue
        basis = np.column_stack([np.ones(len(residual)), *columns, *(x**2 for x in columns)])
        left = residual - basis @ np.linalg.lstsq(basis, residual, rcond=None)[0]
        if SlowResidual.of_residual(recording.name, left, units).significant:
            return fitted
        noise.append(estimate_noise(recording, left, int(fitted.identifiable.sum()), before.events, before.motion))
    return fitted if all(new is old for new, old in zip(noise, fitted.noise, strict=True)) else fitted.in_noise(noise)


SAME_CONSTANTS = 0.01
"""P-value of one set of constants on all motions above which they carry over, however little of what the others show
they explain: where these show much more, the errors of the constants do."""
NEAR_ENOUGH = 40.0
"""Twice the log of the odds within which terms are refined on all motions: those of the fitted one may be wrong by as
much where the others show more."""


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
        return self.score / self.level - self._length(len(self.amounts), rows)

    def _length(self, amplitudes: int, rows: int) -> float:
        chosen = self.term.complexity + (amplitudes - 1 if self.term.by_channel else 0)
        return float(2 * NODE * chosen + (amplitudes + len(self.shapes)) * np.log(rows))

    def promise(self, rows: int) -> float:
        """Its evidence, or that of the amplitudes of one channel or direction, where it is larger: most are of one."""
        size = len(self.term.quantity.amplitudes) if self.term.by_channel else 1
        best = self.evidence(rows)
        for first in range(0, len(self.amounts), size):
            own = slice(first, first + size)
            alone = self.amounts[own] @ np.linalg.pinv(self.covariance[own, own], hermitian=True) @ self.amounts[own]
            best = max(best, float(alone) / self.level - self._length(len(self.amounts[own]), rows))
        return best


@dataclass(frozen=True, eq=False)
class HeldOutTerm:
    """A scored term on the motions held out, its amplitudes carried over.

    carried    drop of chi-square there by the carried amplitudes, `refitted` that by the best ones
    together   drop of chi-square on all motions by constants fitted to all of them
    z          its correlation with the residual there over its std: normal without the term
    """

    scored: ScoredTerm
    carried: float
    refitted: float
    together: float
    z: float

    @property
    def holds(self) -> bool:
        """Whether the term with its constants is in the other motion, but for their errors."""
        lost = (self.scored.score + self.refitted - self.together) / self.scored.level
        same = chi2_sf(max(lost, 0.0), len(self.scored.amounts) + len(self.scored.shapes)) > SAME_CONSTANTS
        return self.z > float(normal_isf(HELD_OUT_LEVEL)) and (same or self.carried > LEAST_CARRIED * self.refitted)

    def evidence(self, rows: int) -> float:
        """Twice the log of its odds against nothing, on all motions."""
        return self.scored.evidence(rows) + (self.together - self.scored.score) / self.scored.level


class TermSearch:
    """Scores of terms given a fit.

    `ranges` are those (low, high) in which the parameters that terms are not linear in are sought, by name; that of an
    edge is by its axis.
    """

    def __init__(self, fit: Fit, leaves: Mapping[str, Leaf], ranges: Mapping[str, tuple[float, float]]) -> None:
        self.fit, self.null_model, self._leaves = fit, NullModel(fit), leaves
        self.grid = ShapeGrid(fit, leaves, ranges)

    @cached_property
    def rows(self) -> int:
        """Number of whitened rows in which terms show."""
        return sum(noise.whitener.periodic_rows for noise in self.fit.noise)

    def of_motion(self, term: Term) -> bool:
        """Whether a term follows the motion: of the few others, each half of the false alarms is allowed."""
        names = term.quantity.leaves & set(self._leaves)
        signals = frozenset[str]().union(*(self._leaves[name].signals for name in names))
        return not signals & {"time", *(name for r in self.fit.recordings for name in r.auxiliary)}

    def scored(
        self, terms: Sequence[Term], announce: CountCallback | None = None
    ) -> tuple[list[ScoredTerm], dict[bool, float]]:
        """The terms at their best shapes, where they show; and the effective number of tests, of those with and without
        motion each as many as count when both are asked."""
        best: dict[Term, ScoredTerm] = {}
        smallest: dict[bool, Array] = {}
        for shapes, batch in counted(self._batches(terms), announce):
            projected = TermColumns(self.null_model, self._leaves, shapes).projected(batch)
            noise, ranks = projected.noise_scores_by_point(), projected.ranks
            moving = self.of_motion(batch[0])
            for rank in np.unique(ranks[ranks > 0]):
                p_values = chi2_sf(noise[ranks == rank].max(axis=0), float(rank))
                smallest[moving] = np.minimum(smallest.get(moving, 1.0), p_values)
            for place, term in enumerate(batch):
                scored = _scored(projected, place, term, shapes)
                if scored is not None and (term not in best or scored.score > best[term].score):
                    best[term] = scored
        tests = {
            moving: len(smallest) * max(1.0, 0.1 / max(float(np.quantile(p_values, 0.1)), 1e-12))
            for moving, p_values in smallest.items()
        }
        return list(best.values()), tests

    def _batches(self, terms: Sequence[Term]) -> list[tuple[Mapping[str, float], list[Term]]]:
        """Terms that are computed together, with the values of the parameters that they are not linear in."""
        space, columns = self.fit.model.space, TermColumns(self.null_model, self._leaves, {})

        def alike(term: Term) -> tuple[str, bool, int, tuple[str, ...], str, tuple[bool, ...]]:
            periodic = tuple(columns.is_periodic(term, number) for number in range(len(self.fit.recordings)))
            shapes = term.shapes(self._leaves)
            stage = term.kind if term.by_channel else "load"
            return (
                stage,
                self.of_motion(term),
                len(term.amplitudes(space)),
                shapes,
                edge_axis(term) if EDGE in shapes else "",
                periodic,
            )

        batches: list[tuple[Mapping[str, float], list[Term]]] = []
        for _, group in groupby(sorted(terms, key=alike), key=alike):
            together = list(group)
            names = together[0].shapes(self._leaves)
            for shapes in self.grid.points(names, together[0]):
                starts = range(0, len(together), TERMS_AT_ONCE)
                batches += [(shapes, together[first : first + TERMS_AT_ONCE]) for first in starts]
        return batches

    def refined(self, scored: ScoredTerm) -> ScoredTerm:
        """A term with its shapes refined, without amplitudes that are not worth their description."""
        best, names = scored, tuple(scored.shapes)
        if names:
            start = np.array([scored.shapes[name] for name in names])
            simplex = np.vstack([start, start + np.diag(self.grid.steps(scored.term, scored.shapes))])

            def cost(values: Array) -> float:
                nearby = self._at(scored.term, dict(zip(names, values.tolist(), strict=True)))
                return 0.0 if nearby is None else -nearby.score

            options: Any = {"initial_simplex": simplex, "maxfev": REFINEMENTS, "xatol": 1e-4, "fatol": 1e-2}
            at_best = minimize(
                cost, start, method="Nelder-Mead", bounds=self.grid.bounds(scored.shapes), options=options
            ).x
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
        information, along_each, projected = self.information(scored)
        power, along = float(scored.amounts @ information @ scored.amounts), float(along_each @ scored.amounts)
        if power <= 0:
            return 0.0, float(projected.scores[0]), 0.0
        level = max(projected.test(0).together.noise.mean, 1.0)  # of a single run the noise may be larger there
        return 2 * along - power, float(projected.scores[0]), along / (power * level) ** 0.5

    def information(self, scored: ScoredTerm) -> tuple[Array, Array, ProjectedColumns]:
        """Inner products (a, a) of a term's columns beside the fit, and (a,) with the residual; and the columns."""
        projected = TermColumns(self.null_model, self._leaves, scored.shapes).projected([scored.term])
        columns = self.null_model.project_out(self.null_model.spread(projected.columns(0), projected.whitened.choice))
        return columns.T @ columns, columns.T @ self.null_model.residual, projected


def score_together(searches: Sequence[TermSearch], scored: ScoredTerm, *, refined: bool) -> float:
    """Drop of chi-square on all motions with the same amplitudes, the best ones; the same shapes `refined`, or kept."""

    def score(shapes: Mapping[str, float]) -> float:
        each = [search.information(replace(scored, shapes=shapes))[:2] for search in searches]
        information, along = (sum(parts) for parts in zip(*each, strict=True))
        return float(along @ np.linalg.pinv(information, rcond=RANK_TOLERANCE**2, hermitian=True) @ along)

    names, start = list(scored.shapes), np.array(list(scored.shapes.values()))
    if not refined or not names:
        return score(scored.shapes)
    simplex = np.vstack([start, start + np.diag(searches[0].grid.steps(scored.term, scored.shapes) / AGAIN)])
    bounds, most = searches[0].grid.bounds(scored.shapes), REFINEMENTS // 6 * len(names)
    options: Any = {"initial_simplex": simplex, "maxfev": most, "xatol": 1e-4, "fatol": 1e-2}

    def cost(values: Array) -> float:
        return -score(dict(zip(names, values.tolist(), strict=True)))

    return -float(minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options).fun)


AGAIN = 10.0
"""Of the steps in which terms are refined on one motion, those of all motions begin with a part."""


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


@dataclass(frozen=True, eq=False)
class FoundTerm:
    """The best term of a search, and those that cannot be told from it.

    p_value      of its score on the fitted motion, corrected for all terms tested
    alternatives  other terms within `ODDS`, or that the data alone do not tell from it by as much, nor their length by
                  as much again, or better but for their length; with the odds of the best against them, nearest first
    """

    best: HeldOutTerm
    p_value: float
    alternatives: tuple[tuple[ScoredTerm, float], ...]


@dataclass(frozen=True, eq=False)
class Candidates:
    """The terms with the best scores on the fitted motion, refined, the best first.

    tests    effective number of tests, by whether a term follows the motion
    test     score test of the best
    p_value  of its score, corrected for all terms tested
    """

    terms: tuple[ScoredTerm, ...]
    tests: Mapping[bool, float]
    test: PointTest
    p_value: float

    @property
    def is_suggestive(self) -> bool:
        """Whether the best is not significant, and may be in a noise that has nothing of it."""
        return self.p_value >= LEVELS.effect and self.test.p_value() < SUGGESTIVE


SUGGESTIVE = 1e-3
"""P-value of the best term by itself below which the noise of a run's residual is estimated beside it: taken for noise,
a term hides itself. In noise the best of thousands is below in one of two searches, which costs a second one."""


def best_candidates(
    search: TermSearch, terms: Sequence[Term], announce: CountCallback | None = None
) -> Candidates | None:
    """The terms that may be what the fitted motion shows; None where no term has an effect."""
    scored, tests = search.scored(terms, announce)
    ordered = sorted(scored, key=lambda each: -each.promise(search.rows))
    if not ordered:
        return None
    finalists = [each for each in ordered[:FINALISTS] if each.score > WITHIN * ordered[0].score]
    refined = _distinct([search.refined(each) for each in finalists], search.rows)
    test = search.test(refined[0])
    p_value = min(1.0, tests[search.of_motion(refined[0].term)] * test.p_value())
    return Candidates(tuple(refined), tests, test, p_value)


def best_term(search: TermSearch, held_out: Sequence[TermSearch], candidates: Candidates) -> FoundTerm:
    """The candidate that is the most likely on all motions; whether it `holds` there is still to be asked."""
    rows, level, judged = search.rows, max(candidates.test.together.noise.mean, 1.0), []
    for each in candidates.terms:
        parts = np.array([other.held_out(each) for other in held_out])
        together = score_together([search, *held_out], each, refined=False)
        carried, best = parts[:, :2].sum(axis=0)
        z = float(parts[:, 2].sum() / len(parts) ** 0.5)
        judged.append(HeldOutTerm(replace(each, level=level), carried, best, together, z))
    least = max(each.evidence(rows) for each in judged) - NEAR_ENOUGH
    for place, near_best in enumerate(judged):
        if near_best.evidence(rows) > least:
            together = score_together([search, *held_out], near_best.scored, refined=True)
            judged[place] = replace(near_best, together=max(near_best.together, together))
    judged.sort(key=lambda each: -each.evidence(rows))
    winner = judged[0]
    p_value = min(1.0, candidates.tests[search.of_motion(winner.scored.term)] * search.test(winner.scored).p_value())
    near = []
    for other in judged[1:]:
        nats = (winner.evidence(rows) - other.evidence(rows)) / 2
        by_data = (winner.together - other.together) / 2 / level  # without the length of the terms
        told_by_length = by_data <= np.log(ODDS) and nats <= 2 * np.log(ODDS)
        if nats <= np.log(ODDS) or told_by_length or by_data <= -np.log(ODDS):
            near.append((other.scored, float(np.exp(nats))))
    return FoundTerm(winner, p_value, tuple(near))


SAME = 1e-4
"""Relative difference of two terms' scores below which they are one and the same, written differently: of a vertical
constant vector and gravity's direction, each refined to `fatol`."""


def _distinct(scored: Sequence[ScoredTerm], rows: int) -> list[ScoredTerm]:
    """Terms without those that give the same as one without amplitudes of its own, or a better one; the best first."""
    chosen: list[ScoredTerm] = []
    for each in sorted(scored, key=lambda one: (one.term.quantity.has_constant, -one.evidence(rows))):
        same = any(
            len(o.amounts) == len(each.amounts) and abs(o.score - each.score) < SAME * each.score for o in chosen
        )
        if not same:
            chosen.append(each)
    return sorted(chosen, key=lambda one: -one.evidence(rows))
