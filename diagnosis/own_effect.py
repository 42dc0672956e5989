"""Own effect: what passed over one held-out recording alone, a drift or a push, found there and nowhere else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.held_out import HeldOut
from diagnosis.price import SIGNIFICANCE, price
from diagnosis.screening import Screening, beginning, screen
from diagnosis.selection import holm
from diagnosis.workers import Workers
from diagnosis.workspace import Workspace
from estimation.fit import Estimate, Fit
from estimation.recording import Recording
from estimation.response import predicted
from modeling.effect import Effect
from modeling.effects import catalogue
from modeling.space import Space

WORDS = {
    "bias_drift": "drifts",
    "contact_event": "is pushed",
    "payload_change": "takes up or loses a mass",
    "line_interference": "hums",
}
"""What a recording with such an effect does, in words."""


@dataclass(frozen=True, eq=False)
class OwnEffect:
    """An effect that one held-out recording has by itself.

    parameters  by the effect's own names
    swing       from peak to peak what it adds to each channel, in its unit
    """

    recording: Recording
    effect: Effect
    parameters: Mapping[str, Estimate]
    swing: Mapping[str, float]

    def __str__(self) -> str:
        does = WORDS.get(self.effect.id, f"has an effect of its own ({self.effect.title})")
        space = Space(self.recording.dimension)
        sizes = [f"{c} by {s:.2g} {u}" for (c, s), u in zip(self.swing.items(), space.units, strict=True)]
        nuisances = [p.name for p in self.effect.parameters(space) if p.nuisance]
        where = [f"{n} {self.parameters[n].value:.4g} {self.parameters[n].unit}" for n in nuisances]
        return f"{self.recording.name} {does} by itself: {', '.join([*where, *sizes])} from peak to peak"


def with_own(held_out: HeldOut, fit: Fit, candidates: Sequence[Effect] = (), workers: Workers | None = None) -> HeldOut:
    """The recording with those effects of its own that are significant given a fit carried over to it (Holm, 1 %).

    Sought are the effects of the catalogue, and those among the candidates, that belong to one recording. They are
    judged where nothing that repeats is seen, so that they cannot stand in for what the fit lacks. Without repeats
    there is no such place: a push is then sought where the noise has noticed one, and nothing else. What they do is
    no noise; with each one found the noise is estimated anew.
    """
    space = fit.model.space
    listed = [e for e in {e.id: e for e in (*catalogue(space), *candidates)}.values() if e.per_recording]
    found = replace(held_out, own=(), start={})
    workers = workers or Workers()
    while found.decides and (grown := _grown(found, fit, [e for e in listed if e not in found.own], workers)):
        found = _placed_again(grown, fit, workers)
    for effect in found.own[:-1]:
        rest = replace(found, own=tuple(e for e in found.own if e != effect))
        if not _significant(rest.passing(fit), [effect], Workspace(workers)):
            found = rest.refreshed(fit)
    return found


def _grown(held_out: HeldOut, fit: Fit, effects: Sequence[Effect], workers: Workers) -> HeldOut | None:
    """With one more effect, that of the significant ones with which most is explained; None when there is none."""
    grown = _with_each(held_out, fit, effects, workers)
    return _best(grown, fit, len(effects)).refreshed(fit) if grown else None


def _placed_again(held_out: HeldOut, fit: Fit, workers: Workers) -> HeldOut:
    """The last effect sought again in the noise that it leaves: before, it was itself a part of that noise."""
    before = replace(held_out, own=held_out.own[:-1])
    again = _with_each(before, fit, held_out.own[-1:], workers)
    return _best([held_out, *again], fit, 1).refreshed(fit)


def _with_each(held_out: HeldOut, fit: Fit, effects: Sequence[Effect], workers: Workers) -> list[HeldOut]:
    """With each of the effects that are significant, from where its screening points."""
    passing, workspace = held_out.passing(fit), Workspace(workers)
    found = []
    for screening in _significant(passing, effects, workspace):
        start = {**held_out.start, **beginning(passing, screening, workspace)}
        found.append(replace(held_out, own=(*held_out.own, screening.effect), start=start))
    workspace.forget()
    return found


def _best(choices: Sequence[HeldOut], fit: Fit, candidates: int) -> HeldOut:
    return min(choices, key=lambda h: _criterion(h.passing(fit), candidates))


def _significant(passing: Fit, effects: Sequence[Effect], workspace: Workspace) -> list[Screening]:
    screenings = screen(passing, effects, workspace=workspace)
    adjusted = holm(screenings)
    return [s for s in screenings if s.excited and adjusted[s.effect.id] < SIGNIFICANCE]


def _criterion(passing: Fit, candidates: int) -> float:
    return passing.linearised().cost + price(passing.model, candidates)


def own_effects(held_out: HeldOut, fit: Fit) -> tuple[OwnEffect, ...]:
    """What a held-out recording has by itself, with its size."""
    carried = held_out.carried(fit)
    return tuple(_sized(carried, effect) for effect in held_out.own)


def _sized(carried: Fit, effect: Effect) -> OwnEffect:
    model, recording = carried.model, carried.recordings[0]
    own = {p.name: p for p in effect.qualified(model.space)}
    absent = np.array(
        [
            own[p.name].nominal if p.name in own and not own[p.name].nuisance else value
            for p, value in zip(carried.layout.parameters, carried.theta, strict=True)
        ]
    )
    added = predicted(model, recording, carried.theta) - predicted(model, recording, absent)
    swing = {c: float(s) for c, s in zip(recording.channels, np.ptp(added, axis=0), strict=True)}
    parameters = {n.split(".", 1)[1]: carried.parameters[n] for n in own}
    return OwnEffect(recording, effect, parameters, swing)
