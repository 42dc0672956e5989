"""Selection: which effects, together, leave nothing to explain; searched conditionally, each refitted exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from diagnosis.background import Background
from diagnosis.comparison import comparison_of, residual_judges_itself
from diagnosis.price import SIGNIFICANCE, price, worth
from diagnosis.progress import Announce, Progress, counted, silent
from diagnosis.screening import Screening, beginning, lacking, screen, searched
from diagnosis.workers import Workers
from diagnosis.workspace import Workspace
from estimation.fit import Fit, refit, refreshed, shared_by
from modeling.effect import Effect
from modeling.errors import InputError

WIDTH = 2
"""Sets of effects kept side by side at each size."""
REFITS = 3
"""Significant effects refitted exactly for each of them."""
MOST_EFFECTS = 4


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model with some effects, refitted exactly; `among` so many that could have been chosen.

    workspace  what screenings of fits in the same noise share
    """

    fit: Fit
    among: int
    workspace: Workspace = field(default_factory=Workspace)
    _less: dict[str, Candidate] = field(default_factory=dict, init=False, repr=False)

    @property
    def ids(self) -> frozenset[str]:
        """The ids of its effects."""
        return frozenset(e.id for e in self.fit.model.effects)

    @property
    def background(self) -> Background:
        """Its residual and directions, whitened."""
        return Background.of(self.fit, self.workspace)

    @cached_property
    def cost(self) -> float:
        """Whitened chi-square."""
        return self.background.cost

    def less(self, effect_id: str) -> Candidate:
        """The candidate less one of its effects, refitted once."""
        if effect_id not in self._less:
            self._less[effect_id] = refitted(self, [e for e in self.fit.model.effects if e.id != effect_id])
        return self._less[effect_id]

    def less_each(self, tried: Sequence[Candidate] = ()) -> dict[str, Candidate]:
        """The candidate less each of its effects, by the effect's id, refitted by all workers unless it was `tried`."""
        own, known = self.fit.model.effects, {c.ids: c for c in tried if c.fit.noise is self.fit.noise}
        found = {e.id: known.get(self.ids - {e.id}, self._less.get(e.id)) for e in own}
        new = [e for e in own if found[e.id] is None]
        smaller = self.workspace.workers.map(
            lambda effect: self.less(effect.id),
            new,
            label=lambda effect: effect.id,
            shared=[self, *shared_by(self.fit), self.workspace],
        )
        self._less.update(zip((e.id for e in new), smaller, strict=True))
        return {e.id: found[e.id] or self._less[e.id] for e in own}

    def screened(self, effects: Sequence[Effect], announce: Announce | None = None) -> list[Screening]:
        """The effects that it lacks, screened."""
        return screen(self.fit, effects, workspace=self.workspace, announce=announce)

    @cached_property
    def lack_of_fit(self) -> float:
        """P-value that nothing is left in any recording, paid for by their number."""
        number = len(self.fit.recordings)
        return min(1.0, number * min(comparison_of(self.fit, i).lack_of_fit for i in range(number)))

    @property
    def adequate(self) -> bool:
        """Whether nothing significant is left."""
        return self.lack_of_fit >= SIGNIFICANCE

    @property
    def excess(self) -> float:
        """Whitened chi-square above what noise alone leaves, at least 1."""
        return max(1.0, self.cost - sum(n.whitener.rows for n in self.fit.noise) + len(self.fit.theta))

    @property
    def criterion(self) -> float:
        """Whitened chi-square plus what each effect's parameters have to bring to be significant."""
        return self.cost + price(self.fit.model, self.among)


@dataclass(frozen=True, eq=False)
class Selection:
    """The search's outcome: the base, the set chosen, and all that were refitted on the way."""

    base: Candidate
    chosen: Candidate
    tried: tuple[Candidate, ...] = field(default=())

    def refitted(self, candidate: Candidate, effects: Sequence[Effect]) -> Candidate:
        """The candidate with another set of effects: the one that was tried in the same noise, else refitted."""
        return _known({c.ids: c for c in (self.base, *self.tried)}, candidate, effects)


def holm(screenings: Sequence[Screening]) -> dict[str, float]:
    """Holm-adjusted p-values by effect id."""
    ordered = sorted((s for s in screenings if s.excited), key=lambda s: s.p_value)
    adjusted, highest = {}, 0.0
    for rank, screening in enumerate(ordered):
        highest = max(highest, min(1.0, (len(ordered) - rank) * screening.p_value))
        adjusted[screening.effect.id] = highest
    return adjusted


def select(
    base: Fit, effects: Sequence[Effect], progress: Progress = silent, workers: Workers | None = None
) -> Selection:
    """Search sets of effects, a few side by side, until nothing significant is left to add.

    Each set grows by the effects that screening finds significant given what is in it (Holm, 1 %), refitted exactly;
    the best set by the criterion is kept, less the effects that it no longer needs.
    """
    start = Candidate(base, len(effects), Workspace(workers or Workers()))
    level, tried = [start], {start.ids: start}
    for _ in range(MOST_EFFECTS):
        grown = _grown(level, effects, tried, progress)
        if not grown:
            break
        level = sorted(grown, key=lambda c: c.criterion)[: 1 if residual_judges_itself(base) else WIDTH]
        best = min(tried.values(), key=lambda c: c.criterion)
        if best.adequate:
            if best not in level:
                break
            level = [best]
    best = level[0] if residual_judges_itself(base) else min(tried.values(), key=lambda c: c.criterion)
    if len(best.ids) > 1 and not residual_judges_itself(base):
        best = _swapped(best, effects, tried, progress)
    return Selection(start, _simplest(_pruned(best, tried, progress), tuple(tried.values())), tuple(tried.values()))


def _swapped(
    best: Candidate, effects: Sequence[Effect], tried: dict[frozenset[str], Candidate], progress: Progress
) -> Candidate:
    """The best after each effect's place was offered to the others, given the rest."""
    _grown(list(best.less_each(list(tried.values())).values()), effects, tried, progress)
    return min(tried.values(), key=lambda c: c.criterion)


def _ids(effects: Sequence[Effect]) -> str:
    return " + ".join(sorted(e.id for e in effects))


def _known(tried: Mapping[frozenset[str], Candidate], candidate: Candidate, effects: Sequence[Effect]) -> Candidate:
    """The candidate with another set of effects: the one that was tried in the same noise, else refitted."""
    known = tried.get(frozenset(e.id for e in effects))
    return known if known is not None and known.fit.noise is candidate.fit.noise else refitted(candidate, effects)


def _simplest(best: Candidate, tried: Sequence[Candidate]) -> Candidate:
    """The set with the fewest parameters that is adequate, and no worse than the best by what the others are worth."""
    if residual_judges_itself(best.fit):
        return _best_in_one_noise(best, tried)
    rivals = [best]
    for other in tried:
        saved = len(best.fit.theta) - len(other.fit.theta)
        worse = other.cost - best.cost
        if saved > 0 and worse < worth(saved, best.among) and other.adequate:
            rivals.append(other)
    return min(rivals, key=lambda c: (len(c.fit.theta), c.criterion))


def _best_in_one_noise(best: Candidate, tried: Sequence[Candidate]) -> Candidate:
    """The best set by the criterion when all are refitted in the noise of one.

    Sets that each have their own residual for noise are all of size one in that unit, and none looks better.
    """
    others = [c for c in tried if c.ids != best.ids and c.adequate]
    shared = [*shared_by(best.fit), best.workspace]
    alike = best.workspace.workers.map(
        lambda c: refitted(best, c.fit.model.effects, c.fit.values),
        others,
        label=lambda c: _ids(c.fit.model.effects),
        shared=shared,
    )
    return min([best, *alike], key=lambda c: c.criterion)


def _grown(
    level: Sequence[Candidate],
    effects: Sequence[Effect],
    tried: dict[frozenset[str], Candidate],
    progress: Progress,
) -> list[Candidate]:
    """Each set with one more effect, for the significant ones that were not tried; they are added to `tried`."""
    beside = "; ".join(_ids(c.fit.model.effects) or "the rigid tip" for c in level)
    explored(level, effects, counted(progress, f"screen beside {beside}"))
    wanted = [growth for c in level for growth in _growths(c, c.screened(effects))]
    grown = []
    while wanted := [growth for growth in wanted if growth.ids not in tried]:
        first = list({growth.ids: growth for growth in reversed(wanted)}.values())[::-1]
        doing = "refit with " + "; ".join(" + ".join(sorted(growth.ids)) for growth in first)
        shared = [thing for c in level for thing in (*shared_by(c.fit), c.workspace)]
        workers, announce = level[0].workspace.workers, counted(progress, doing)
        found = workers.map(
            _refitted_with, first, label=lambda g: g.screening.effect.id, shared=shared, announce=announce
        )
        for growth, new in zip(first, found, strict=True):
            if new is not None:
                tried[growth.ids] = new
                grown.append(new)
        wanted = [growth for growth in wanted if growth not in first]
    return grown


@dataclass(frozen=True, eq=False)
class Growth:
    """A candidate and the effect that it shall have besides."""

    candidate: Candidate
    screening: Screening

    @property
    def ids(self) -> frozenset[str]:
        """The ids of the larger set."""
        return self.candidate.ids | {self.screening.effect.id}


def explored(level: Sequence[Candidate], effects: Sequence[Effect], announce: Announce | None = None) -> None:
    """Search the effects that each candidate lacks, all shared out together where they have one workspace."""
    for workspace in {c.workspace: None for c in level}:
        wanted = [key for c in level if c.workspace is workspace for key in lacking(c.fit, effects)]
        searched(wanted, workspace, announce)


def _growths(candidate: Candidate, screenings: Sequence[Screening]) -> list[Growth]:
    """The growths that a screening calls for, the most promising first."""
    adjusted = holm(screenings)
    significant = [s for s in screenings if s.excited and adjusted[s.effect.id] < SIGNIFICANCE]
    significant.sort(key=lambda s: -s.statistic)
    return [Growth(candidate, s) for s in significant[:REFITS]]


def _refitted_with(growth: Growth) -> Candidate | None:
    """The larger set, refitted and judged; None where the screening points to what has no solution."""
    try:
        new = extended(growth.candidate, growth.screening)
        _ = new.cost, new.lack_of_fit
    except InputError:
        return None
    return new


def extended(candidate: Candidate, screening: Screening) -> Candidate:
    """The candidate with one more effect, refitted exactly from where the screening points."""
    before = candidate.fit
    start = {**before.values, **beginning(before, screening, candidate.workspace)}
    after = refit(before.model + screening.effect, before.recordings, noise=before.noise, start=start)
    if residual_judges_itself(before):
        after = refit(after.model, after.recordings, noise=refreshed(after), start=after.values)
    return Candidate(after, candidate.among, candidate.workspace)


def refitted(candidate: Candidate, effects: Sequence[Effect], start: Mapping[str, float] | None = None) -> Candidate:
    """The candidate's recordings and noise with another set of effects, refitted exactly."""
    before = candidate.fit
    model = before.model.base + effects
    start = {**before.values, **(start or {})}
    after = refit(model, before.recordings, noise=before.noise, start=start)
    return Candidate(after, candidate.among, candidate.workspace)


def _pruned(candidate: Candidate, tried: Mapping[frozenset[str], Candidate], progress: Progress) -> Candidate:
    """Drop effects one by one while the set without them is better by the criterion."""
    if candidate.ids:
        progress(f"refit without each of {_ids(candidate.fit.model.effects)}")
    for smaller in candidate.less_each(list(tried.values())).values():
        if smaller.criterion < candidate.criterion:
            return _pruned(smaller, tried, progress)
    return candidate
