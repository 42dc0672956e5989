"""Screening: every effect of the catalogue at once, beside what the model does already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from diagnosis.background import Background
from diagnosis.comparison import tail
from diagnosis.extent import extent_of
from diagnosis.price import detectable_separation, level
from diagnosis.progress import Announce
from diagnosis.search import Search, sharpened
from diagnosis.secants import Point
from diagnosis.workspace import Workspace
from estimation.fit import Fit, shared_by
from estimation.noise import Noise, NoiseSource
from estimation.recording import Recording
from estimation.response import missing_inputs
from estimation.whitening import LineWhitener
from modeling.chain import Stage
from modeling.effect import Effect, Values
from modeling.model import WrenchModel
from modeling.prediction import compiled


@dataclass(frozen=True, eq=False)
class Screening:
    """One effect's chance to explain what is left.

    statistic   drop of the whitened chi-square that its best linear amount would bring (0 when not excited)
    p_value     paid for by the number of values tried, not yet by the number of effects
    start       parameter values from which to refit exactly
    amounts     estimated amplitudes from their nominal value, with their std
    detectable  amounts that the recordings would show with 80 % power
    point       where in the effect's grid it is at its best, None when not excited
    reason      why it is not excited, empty when it is
    """

    effect: Effect
    statistic: float
    p_value: float
    start: Values
    amounts: Mapping[str, tuple[float, float]]
    detectable: Mapping[str, float]
    point: Point | None = None
    reason: str = ""

    @property
    def excited(self) -> bool:
        """Whether this recording can show the effect at all."""
        return not self.reason


def screen(
    fit: Fit,
    effects: Sequence[Effect],
    *,
    candidates: int | None = None,
    workspace: Workspace | None = None,
    announce: Announce | None = None,
) -> list[Screening]:
    """Every effect that the model lacks, screened against the fit's residual; the most significant first.

    `candidates` is the number of effects that could have been found, by default of those given. What screenings of
    fits in the same noise share is taken from the `workspace`; no effect is searched twice given the same fit.
    """
    count = len(effects) if candidates is None else candidates
    searches = searched(lacking(fit, effects), Workspace() if workspace is None else workspace, announce)
    found = [_judged(s, count) if isinstance(s, Search) else s for s in searches]
    return sorted(found, key=lambda s: (s.p_value, -s.statistic))


def lacking(fit: Fit, effects: Sequence[Effect]) -> list[tuple[Fit, Effect]]:
    """The fit with each of the effects that its model does not have."""
    present = {e.id for e in fit.model.effects}
    return [(fit, e) for e in effects if e.id not in present]


def searched(
    wanted: Sequence[tuple[Fit, Effect]], workspace: Workspace, announce: Announce | None = None
) -> list[Search | Screening]:
    """The searches for effects, each beside a fit, all shared out together; they are kept in the workspace."""
    fits = list({fit: None for fit, _ in wanted})
    for fit in {fit: None for fit, effect in wanted if not workspace.knows((fit, effect))}:
        Background.of(fit, workspace).prepare()
    return workspace.each(
        wanted,
        lambda key: _searched(Background.of(key[0], workspace), key[1]),
        label=lambda key: key[1].id,
        shared=[thing for fit in fits for thing in shared_by(fit)],
        announce=announce,
    )


def beginning(fit: Fit, screening: Screening, workspace: Workspace | None = None) -> Values:
    """Where the exact refit with a screened effect begins: its start, with its times sharpened."""
    background = Background.of(fit, Workspace() if workspace is None else workspace)
    return sharpened(background, screening.effect, screening.start)


def _searched(background: Background, new: Effect) -> Search | Screening:
    """The search for an effect, or why there is none."""
    fit = background.fit
    model = fit.model + new
    effect = model.effects[-1]
    alone = compiled(model.base + effect).model
    missing = [_missing(alone, effect, r, n) for r, n in zip(fit.recordings, fit.noise, strict=True)]
    numbers = [i for i, lacking in enumerate(missing) if not lacking]
    spared = [effect.stage is Stage.MEMORY and r.at_rest for r in fit.recordings]
    everywhere = effect.per_recording or all(s or not m for s, m in zip(spared, missing, strict=True))
    if not numbers or not everywhere:
        first = next(i for i, lacking in enumerate(missing) if lacking)
        return _not_excited(effect, f"{fit.recordings[first].name} has no {', '.join(missing[first])}")
    grid = effect.nuisance_grid(extent_of(background, numbers[0], effect))
    if not grid:
        return _not_excited(effect, "the recording has no position")
    return Search.over(background, model, effect, grid)


def _missing(alone: WrenchModel, effect: Effect, recording: Recording, noise: Noise) -> tuple[str, ...]:
    """What a recording lacks for an effect: signals, or repeats for what slow physics or the motion would imitate."""
    missing = missing_inputs(alone, recording)
    searched = {p.unit for p in effect.parameters(alone.space) if p.nuisance}
    whitener = noise.whitener
    if "Hz" in searched and not (isinstance(whitener, LineWhitener) and len(whitener.between)):
        return (*missing, "repeats in one go, between whose lines a tone would show")
    if recording.repeats > 1 or recording.at_rest:
        return missing
    if effect.needs_repeats:
        return (*missing, "repeats, without which slow physics would look the same")
    if "s" in searched and noise.source is NoiseSource.RESIDUAL and not noise.events:
        return (*missing, "interval in which anything stands out, nor repeats that would show a small one")
    return missing


def _not_excited(effect: Effect, reason: str) -> Screening:
    return Screening(effect, 0.0, 1.0, {}, {}, {}, reason=reason)


def _judged(search: Search, candidates: int) -> Screening:
    trial, effect = search.best, search.effect
    if trial.rank == 0:
        return _not_excited(effect, search.why_not)
    return Screening(
        effect=effect,
        statistic=trial.score,
        p_value=min(1.0, search.cost * tail(trial.score, trial.rank, search.doubt)),
        start=search.start,
        amounts=search.amounts(),
        detectable=search.detectable(detectable_separation(trial.rank, level(candidates) / search.cost)),
        point=search.point,
    )
