"""Acceptance: an effect that fits is believed only if it holds on data that were not used to fit it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import comparison_of, residual_judges_itself
from diagnosis.held_out import HeldOut
from diagnosis.own_effect import with_own
from diagnosis.part import halved
from diagnosis.price import SIGNIFICANCE
from diagnosis.selection import Candidate
from estimation.directions import orthonormal
from estimation.distributions import chi2_sf
from estimation.fit import Fit, Problem, refit, shared_by
from estimation.noise import Noise
from estimation.response import respond
from modeling.effect import Effect
from modeling.errors import InputError
from modeling.tip import body_parameters

Array = NDArray[np.float64]

HELD_OUT_SIGNIFICANCE = SIGNIFICANCE / 10
"""Lack of fit on held-out data counts from here: it also holds the training's own errors."""
KEPT = 0.1
"""Share of an effect's own prediction by which it may change from one motion to another and still be the same effect:
all but the square of it, 1 % of its power, is then explained on both."""


@dataclass(frozen=True, eq=False)
class Acceptance:
    """Which effects of a candidate hold, why the others do not, and what the held-out recordings have of their own."""

    candidate: Candidate
    reasons: dict[str, str]
    held_out: tuple[HeldOut, ...]


def accepted(
    candidate: Candidate, base: Candidate, held_out: Sequence[HeldOut], effects: Sequence[Effect]
) -> Acceptance:
    """Drop effects from a candidate until what is left holds on other data.

    No effect may have a parameter on a physical bound other than its nominal value, or leave undetermined what the
    base model determines of the tool. Without held-out recordings a set has to explain the other half of the data.
    A set holds when the error that can be explained falls on every held-out recording, and either the exact refit
    leaves no significant lack of fit (there and in training), or each effect keeps its coefficients: between the
    training and the held-out motion, or between two halves of the training data when there is no other. What passed
    over a held-out recording alone, a drift or a push or another of the `effects` that belong to one recording, is
    estimated there each time, and the same for the base.
    """
    reasons: dict[str, str] = {}
    while True:
        try:
            known = tuple(with_own(h, candidate.fit, effects, candidate.workspace.workers) for h in held_out)
            failed = _failed(candidate, base, known) if candidate.ids else None
        except InputError:
            failed = _least_needed(candidate), "predicts nothing of another motion"  # its spring is too soft for that
        if failed is None:
            return Acceptance(candidate, reasons, known)
        effect_id, reason = failed
        reasons[effect_id] = reason
        candidate = candidate.less(effect_id)


def _failed(candidate: Candidate, base: Candidate, held_out: Sequence[HeldOut]) -> tuple[str, str] | None:
    """The effect that fails most clearly, and why; None when the set holds."""
    effects = candidate.fit.model.lasting.effects
    pressed = _at_bound(candidate)
    if pressed is not None:
        return pressed
    lost = _confounded(candidate, base)
    if lost is not None and effects:
        return _least_needed(candidate), f"cannot be told from the tool's {lost} by these data"
    fits = candidate.adequate
    for other in held_out if effects else ():
        carried = other.carried(candidate.fit)
        if _steady_cost(carried) >= _steady_cost(other.carried(base.fit)):
            return _least_needed(candidate), f"does not lower the error on {other.recording.name}"
        fits = fits and comparison_of(carried, 0).lack_of_fit >= HELD_OUT_SIGNIFICANCE
    if fits and not residual_judges_itself(candidate.fit):
        return None
    if not held_out and not _falls_across_halves(candidate, base):
        return _least_needed(candidate), "does not explain the other half of the data"
    return _inconstant(candidate, held_out)


def _falls_across_halves(candidate: Candidate, base: Candidate) -> bool:
    """Whether effects estimated on one half of the training data explain the other, both ways together.

    What they lower the error by there has to be at least half of what they lower it by where they were fitted: an
    effect that is there keeps nearly all of it, one that follows noise loses as much as it had won.
    """
    halves = halved(candidate.fit)
    ways: list[tuple[Fit, Sequence[Noise], Sequence[Noise]]]
    ways = [(whole, a, b) for whole in (base.fit, candidate.fit) for a, b in (halves, halves[::-1])]

    def costs(way: tuple[Fit, Sequence[Noise], Sequence[Noise]]) -> tuple[float, float]:
        whole, trained_on, judged_on = way
        half = refit(whole.model, whole.recordings, noise=trained_on, start=whole.values)
        return _cost(half, trained_on), _cost(half, judged_on)

    both_ways = np.array(candidate.workspace.workers.map(costs, ways)).reshape(2, 2, 2).sum(axis=1)
    fitted_drop, judged_drop = both_ways[0] - both_ways[1]
    return bool(judged_drop > fitted_drop / 2)


def _cost(fitted: Fit, noise: Sequence[Noise]) -> float:
    """Whitened chi-square of a fit on the rows of that noise."""
    residual, _ = Problem(fitted.layout, fitted.recordings, tuple(noise)).evaluate(fitted.theta)
    return float(residual @ residual)


def _at_bound(candidate: Candidate) -> tuple[str, str] | None:
    """An effect with a parameter that the data drive to a physical bound which is not its nominal value."""
    fitted = candidate.fit
    for effect in fitted.model.effects:
        for p in effect.qualified(fitted.model.space):
            seen = p.nuisance or isfinite(fitted.parameters[p.name].std)
            if seen and fitted.values[p.name] in p.bounds and fitted.values[p.name] != p.nominal:
                return effect.id, f"its {p.name.split('.', 1)[1]} leaves the physical range"
    return None


def _confounded(candidate: Candidate, base: Candidate) -> str | None:
    """A property of the tool that the base model determines and the candidate no longer does.

    An effect that takes over what the data say of the tool cannot be told from the tool by these data.
    """
    inertial = [p.name for p in body_parameters(candidate.fit.model.space)]
    for name in inertial:
        before, after = base.fit.parameters[name], candidate.fit.parameters[name]
        if before.std < abs(before.value) / 10 and after.std > abs(before.value):
            return name
    return None


def _steady_cost(fitted: Fit) -> float:
    """Whitened chi-square of the rows that repeat with the motion."""
    residual, _ = Problem(fitted.layout, fitted.recordings, fitted.noise).evaluate(fitted.theta)
    rows = residual[: fitted.noise[0].whitener.steady_rows]
    return float(rows @ rows)


def _least_needed(candidate: Candidate) -> str:
    """The effect without which the training error rises least; lasting ones first, which claim more."""
    effects = candidate.fit.model.effects
    ids = [e.id for e in candidate.fit.model.lasting.effects] or [e.id for e in effects]
    if len(ids) == 1:
        return ids[0]
    costs = {i: smaller.cost for i, smaller in candidate.less_each().items() if i in ids}
    return min(costs, key=lambda effect_id: costs[effect_id])


def _inconstant(candidate: Candidate, held_out: Sequence[HeldOut]) -> tuple[str, str] | None:
    """The effect whose coefficients change most clearly from one part of the data to another."""
    pairs = _pairs(candidate, held_out)
    worst: tuple[float, str, str] | None = None
    for effect in candidate.fit.model.effects:
        for first, second, where in pairs:
            if effect.per_recording:
                continue
            p_value, change = coefficient_change(effect, first, second)
            if p_value < SIGNIFICANCE and change > KEPT and (worst is None or change > worst[0]):
                worst = (change, effect.id, f"its coefficients change by {_share(change)} of its effect {where}")
    return None if worst is None else worst[1:]


def _share(change: float) -> str:
    return f"{change:.0%}" if change < 10 else "more than ten times"


def _pairs(candidate: Candidate, held_out: Sequence[HeldOut]) -> list[tuple[Fit, Fit, str]]:
    """Fits of the same effects to different data: held-out motions, else halves of the training data."""
    trained = candidate.fit
    model = trained.model.lasting
    pairs = []
    for other in held_out:
        start = {**trained.values, **other.start}
        alone = refit(model + other.own, (other.recording,), noise=(other.noise,), start=start)
        pairs.append((trained, alone, f"on {other.recording.name}"))
    if not pairs or residual_judges_itself(trained):
        halves = candidate.workspace.workers.map(
            lambda noise: refit(trained.model, trained.recordings, noise=noise, start=trained.values),
            halved(trained),
            shared=shared_by(trained),
        )
        pairs.append((halves[0], halves[1], "between two halves of the data"))
    return pairs


def coefficient_change(effect: Effect, first: Fit, second: Fit) -> tuple[float, float]:
    """P-value that an effect has the same coefficients in two fits, and by what share of it they differ.

    The p-value is Wald's, in the directions that the data show. The share compares, on the second recording and
    less what its base model soaks up, the whitened predictions with the two sets of coefficients.
    """
    names = [p.name for p in effect.qualified(first.model.space)]
    differences = np.array([first.values[n] - second.values[n] for n in names])
    covariance = sum(_covariance(f, names) for f in (first, second))
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    shown = values > 1e-10 * values.max()
    along = vectors[:, shown].T @ (differences / scale) / np.sqrt(values[shown])
    p_value = float(chi2_sf(float(along @ along), int(shown.sum())))
    return p_value, _relative_change(effect, first, second)


def _covariance(fitted: Fit, names: Sequence[str]) -> Array:
    place = [list(fitted.parameters).index(n) for n in names]
    return np.asarray(fitted.covariance[np.ix_(place, place)])


def _relative_change(effect: Effect, first: Fit, second: Fit) -> float:
    number = next((i for i, m in enumerate(second.layout.models) if effect.id in [e.id for e in m.effects]), 0)
    model, recording, noise = second.layout.models[number], second.recordings[number], second.noise[number]
    names = [second.layout.parameters[i].name for i in second.layout.index[number]]
    own = {p.name for p in effect.qualified(model.space)}
    kept = np.array([second.values[n] for n in names])
    swapped = np.array([first.values[n] if n in own else second.values[n] for n in names])
    absent = np.array(
        [
            p.nominal if p.name in own and not p.nuisance else second.values[n]
            for n, p in zip(names, model.parameters, strict=True)
        ]
    )
    rows = [noise.whitener.response(respond(model, recording, theta)) for theta in (kept, swapped, absent)]
    size = model.base_size
    basis = orthonormal(rows[2][1][:, :size])
    with_it, with_other, without = (r[0] - basis @ (basis.T @ r[0]) for r in rows)
    size_of_effect = float(np.linalg.norm(with_it - without))
    return float(np.linalg.norm(with_it - with_other)) / max(size_of_effect, 1e-300)
