"""Acceptance of effects: held-out error, coefficient consistency, physical bounds, confounding with tool parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.acceptance.held_out import HeldOut
from diagnosis.acceptance.recording_disturbance import with_disturbances
from diagnosis.comparison.comparison import comparison_of, noise_from_residual
from diagnosis.comparison.data_split import half_splits
from diagnosis.screening.multiplicity import SIGNIFICANCE
from diagnosis.selection.subset_search import CandidateModel
from estimation.distributions import chi2_sf
from estimation.fit import Fit, WhitenedProblem, refit, shared_objects
from estimation.least_squares.column_space import orthonormal_basis
from estimation.model_response import model_response
from estimation.noise.recording_noise import RecordingNoise
from modeling.chain.effect import Effect
from modeling.errors import InputError
from modeling.tool.rigid_body import inertial_parameters

Array = NDArray[np.float64]

HELD_OUT_SIGNIFICANCE = SIGNIFICANCE / 10
"""Level of the lack-of-fit test on held-out data; stricter, as the residual there includes the errors of the training
estimates."""
MAX_COEFFICIENT_CHANGE = 0.1
"""Largest relative change of an effect's prediction between two data sets that counts as consistent: at most its
square, 1 % of the effect's power, is then unexplained."""


@dataclass(frozen=True, eq=False)
class Acceptance:
    """The accepted candidate, reasons for rejecting other effects, and held-out recordings with their disturbances."""

    candidate: CandidateModel
    reasons: dict[str, str]
    held_out: tuple[HeldOut, ...]


def accept(
    candidate: CandidateModel, base: CandidateModel, held_out: Sequence[HeldOut], effects: Sequence[Effect]
) -> Acceptance:
    """Reject effects of a candidate, one by one, until the remaining set is valid on held-out data.

    No effect may have a parameter on a physical bound other than its nominal value, or be confounded with a tool
    parameter that the base model determines. A set is valid when the excited chi-square falls on every held-out
    recording (without any: when the drop holds on the other half of the training data), and either there is no
    significant lack of fit in training and held-out data, or each effect's coefficients are consistent between
    training and held-out data (without any: between halves of the training data). Recording-specific disturbances
    (drift, contact, those among `effects`) of held-out recordings are re-estimated for each model, also for the base.
    """
    reasons: dict[str, str] = {}
    while True:
        try:
            known = tuple(with_disturbances(h, candidate.fit, effects, candidate.workspace.workers) for h in held_out)
            failed = _rejected_effect(candidate, base, known) if candidate.ids else None
        except InputError:
            # the tip's spring is too soft for the held-out motion
            failed = _least_significant(candidate), "its prediction for the held-out motion has no solution"
        if failed is None:
            return Acceptance(candidate, reasons, known)
        effect_id, reason = failed
        reasons[effect_id] = reason
        candidate = candidate.without(effect_id)


def _rejected_effect(
    candidate: CandidateModel, base: CandidateModel, held_out: Sequence[HeldOut]
) -> tuple[str, str] | None:
    """The effect to reject, and why; None when the set is valid."""
    effects = candidate.fit.model.lasting.effects
    at_bound = _at_bound(candidate)
    if at_bound is not None:
        return at_bound
    confounded = _confounded(candidate, base)
    if confounded is not None and effects:
        return _least_significant(candidate), f"it is collinear with the tool's {confounded} in these data"
    fits = candidate.adequate
    for other in held_out if effects else ():
        carried = other.carried(candidate.fit)
        if _excited_cost(carried) >= _excited_cost(other.carried(base.fit)):
            return _least_significant(candidate), f"it does not lower the error on held-out {other.recording.name}"
        fits = fits and comparison_of(carried, 0).lack_of_fit >= HELD_OUT_SIGNIFICANCE
    if fits and not noise_from_residual(candidate.fit):
        return None
    if not held_out and not _holds_across_halves(candidate, base):
        return _least_significant(candidate), "it does not explain the other half of the data"
    return _inconsistent_effect(candidate, held_out)


def _holds_across_halves(candidate: CandidateModel, base: CandidateModel) -> bool:
    """Twofold cross-validation: whether effects estimated on one half of the training data explain the other.

    Their chi-square drop on the test halves has to exceed half of that on the fitted halves: a true effect keeps
    nearly all of it, one that fits noise raises the error by as much as it had lowered it.
    """
    halves = half_splits(candidate.fit)
    ways: list[tuple[Fit, Sequence[RecordingNoise], Sequence[RecordingNoise]]]
    ways = [(whole, a, b) for whole in (base.fit, candidate.fit) for a, b in (halves, halves[::-1])]

    def costs(way: tuple[Fit, Sequence[RecordingNoise], Sequence[RecordingNoise]]) -> tuple[float, float]:
        whole, trained_on, tested_on = way
        half = refit(whole.model, whole.recordings, noise=trained_on, start=whole.values)
        return _cost(half, trained_on), _cost(half, tested_on)

    both_ways = np.array(candidate.workspace.workers.map(costs, ways)).reshape(2, 2, 2).sum(axis=1)
    fitted_drop, tested_drop = both_ways[0] - both_ways[1]
    return bool(tested_drop > fitted_drop / 2)


def _cost(fitted: Fit, noise: Sequence[RecordingNoise]) -> float:
    """Whitened chi-square of a fit in the rows of a noise."""
    residual, _ = WhitenedProblem(fitted.layout, fitted.recordings, tuple(noise)).evaluate(fitted.theta)
    return float(residual @ residual)


def _at_bound(candidate: CandidateModel) -> tuple[str, str] | None:
    """An effect with an estimate on a physical bound that is not its nominal value, and the reason to reject it."""
    fitted = candidate.fit
    for effect in fitted.model.effects:
        for p in effect.qualified(fitted.model.space):
            estimated = p.nuisance or isfinite(fitted.parameters[p.name].std)
            if estimated and fitted.values[p.name] in p.bounds and fitted.values[p.name] != p.nominal:
                return effect.id, f"its {p.name.split('.', 1)[1]} is estimated at the bound of its physical range"
    return None


def _confounded(candidate: CandidateModel, base: CandidateModel) -> str | None:
    """An inertial parameter of the tool that the base model determines and the candidate no longer does.

    Its std is below a tenth of its value in the base model, and above its value in the candidate.
    """
    inertial = [p.name for p in inertial_parameters(candidate.fit.model.space)]
    for name in inertial:
        before, after = base.fit.parameters[name], candidate.fit.parameters[name]
        if before.std < abs(before.value) / 10 and after.std > abs(before.value):
            return name
    return None


def _excited_cost(fitted: Fit) -> float:
    """Whitened chi-square of the first recording's excited lines."""
    residual, _ = WhitenedProblem(fitted.layout, fitted.recordings, fitted.noise).evaluate(fitted.theta)
    rows = residual[: fitted.noise[0].whitener.periodic_rows]
    return float(rows @ rows)


def _least_significant(candidate: CandidateModel) -> str:
    """The effect whose removal raises the training chi-square least; among lasting effects if there are any."""
    effects = candidate.fit.model.effects
    ids = [e.id for e in candidate.fit.model.lasting.effects] or [e.id for e in effects]
    if len(ids) == 1:
        return ids[0]
    costs = {i: smaller.cost for i, smaller in candidate.without_each().items() if i in ids}
    return min(costs, key=lambda effect_id: costs[effect_id])


def _inconsistent_effect(candidate: CandidateModel, held_out: Sequence[HeldOut]) -> tuple[str, str] | None:
    """The lasting effect whose coefficients change most between data sets, if significantly and by more than 10 %."""
    pairs = _fit_pairs(candidate, held_out)
    worst: tuple[float, str, str] | None = None
    for effect in candidate.fit.model.effects:
        for first, second, where in pairs:
            if effect.per_recording:
                continue
            p_value, change = coefficient_change(effect, first, second)
            if p_value < SIGNIFICANCE and change > MAX_COEFFICIENT_CHANGE and (worst is None or change > worst[0]):
                worst = (
                    change,
                    effect.id,
                    f"its coefficients are inconsistent: its prediction changes by {_share(change)} {where}",
                )
    return None if worst is None else worst[1:]


def _share(change: float) -> str:
    return f"{change:.0%}" if change < 10 else "more than ten times"


def _fit_pairs(candidate: CandidateModel, held_out: Sequence[HeldOut]) -> list[tuple[Fit, Fit, str]]:
    """Pairs of fits of the same effects to different data: training and held-out, or halves of the training data."""
    trained = candidate.fit
    model = trained.model.lasting
    pairs = []
    for other in held_out:
        start = {**trained.values, **other.start}
        alone = refit(model + other.own, (other.recording,), noise=(other.noise,), start=start)
        pairs.append((trained, alone, f"on {other.recording.name}"))
    if not pairs or noise_from_residual(trained):
        halves = candidate.workspace.workers.map(
            lambda noise: refit(trained.model, trained.recordings, noise=noise, start=trained.values),
            half_splits(trained),
            shared=shared_objects(trained),
        )
        pairs.append((halves[0], halves[1], "between two halves of the data"))
    return pairs


def coefficient_change(effect: Effect, first: Fit, second: Fit) -> tuple[float, float]:
    """P-value of a Wald test for equal coefficients of an effect in two fits, and their relative change.

    The test is in the identifiable directions. The relative change is that of the effect's whitened prediction on the
    second recording, with the base model's column space projected out.
    """
    names = [p.name for p in effect.qualified(first.model.space)]
    differences = np.array([first.values[n] - second.values[n] for n in names])
    covariance = sum(_covariance(f, names) for f in (first, second))
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    estimable = values > 1e-10 * values.max()
    along = vectors[:, estimable].T @ (differences / scale) / np.sqrt(values[estimable])
    p_value = float(chi2_sf(float(along @ along), int(estimable.sum())))
    return p_value, _relative_change(effect, first, second)


def _covariance(fitted: Fit, names: Sequence[str]) -> Array:
    place = [list(fitted.parameters).index(n) for n in names]
    return np.asarray(fitted.covariance[np.ix_(place, place)])


def _relative_change(effect: Effect, first: Fit, second: Fit) -> float:
    number = next((i for i, m in enumerate(second.layout.models) if effect.id in [e.id for e in m.effects]), 0)
    model, recording, noise = second.layout.models[number], second.recordings[number], second.noise[number]
    names = [second.layout.parameters[i].name for i in second.layout.index[number]]
    own = {p.name for p in effect.qualified(model.space)}
    unchanged = np.array([second.values[n] for n in names])
    swapped = np.array([first.values[n] if n in own else second.values[n] for n in names])
    absent = np.array(
        [
            p.nominal if p.name in own and not p.nuisance else second.values[n]
            for n, p in zip(names, model.parameters, strict=True)
        ]
    )
    rows = [noise.whitener.response(model_response(model, recording, theta)) for theta in (unchanged, swapped, absent)]
    size = model.base_size
    basis = orthonormal_basis(rows[2][1][:, :size])
    with_it, with_other, without = (r[0] - basis @ (basis.T @ r[0]) for r in rows)
    size_of_effect = float(np.linalg.norm(with_it - without))
    return float(np.linalg.norm(with_it - with_other)) / max(size_of_effect, 1e-300)
