"""Consistency of an effect's coefficients between data sets: training and held-out data, or halves of training data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.acceptance.held_out import HeldOut
from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.comparison.data_split import half_splits
from diagnosis.selection.subset_search import CandidateModel
from estimation.distributions import chi2_sf
from estimation.fit import Fit, refit
from estimation.least_squares.column_space import orthonormal_basis
from estimation.model_response import model_response
from modeling.chain.effect import Effect
from modeling.significance import LEVELS

Array = NDArray[np.float64]

MAX_COEFFICIENT_CHANGE = 0.1
"""Largest relative change of an effect's prediction between two data sets that counts as consistent: at most its
square, 1 % of the effect's power, is then unexplained."""


def inconsistent_effect(candidate: CandidateModel, held_out: Sequence[HeldOut]) -> tuple[str, str] | None:
    """The lasting effect whose coefficients change most between data sets, if significantly and by more than 10 %, and
    the reason to reject it."""
    found, pairs = [], _fit_pairs(candidate, held_out)
    for effect in (e for e in candidate.added if not e.per_recording):
        for first, second, where in pairs:
            p_value, change = coefficient_change(effect, first, second)
            if p_value < LEVELS.effect and change > MAX_COEFFICIENT_CHANGE:
                found.append((change, effect.id, where))
    if not found:
        return None
    change, effect_id, where = max(found, key=lambda f: f[0])
    share = f"{change:.0%}" if change < 10 else "more than ten times"
    return effect_id, f"its coefficients are inconsistent: its prediction changes by {share} {where}"


def _fit_pairs(candidate: CandidateModel, held_out: Sequence[HeldOut]) -> list[tuple[Fit, Fit, str]]:
    """Pairs of fits of the same effects to different data: training and held-out, or halves of the training data."""
    trained = candidate.fit
    model = trained.model.without_recording_specific
    pairs = []
    for other in held_out:
        start = {**trained.values, **other.start}
        alone = refit(model + other.disturbances, (other.recording,), noise=(other.noise,), start=start)
        pairs.append((trained, alone, f"on {other.recording.name}"))
    if not pairs or noise_from_residual(trained):
        first, second = (
            refit(trained.model, trained.recordings, noise=noise, start=trained.values)
            for noise in half_splits(trained)
        )
        pairs.append((first, second, "between two halves of the data"))
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
    own = effect.qualified(model.space)
    changed = [{}, {p.name: first.values[p.name] for p in own}, {p.name: p.nominal for p in own if not p.nuisance}]
    unchanged, swapped, absent = (second.layout.values_of(number, {**second.values, **new}) for new in changed)
    without, derivative = noise.whitener.response(model_response(model, recording, absent))
    responses = [model_response(model, recording, theta, derivative=False) for theta in (unchanged, swapped)]
    basis = orthonormal_basis(derivative[:, : model.base_size])
    rows = [*(noise.whitener.response(response)[0] for response in responses), without]
    with_it, with_other, without = (own - basis @ (basis.T @ own) for own in rows)
    size_of_effect = float(np.linalg.norm(with_it - without))
    return float(np.linalg.norm(with_it - with_other)) / max(size_of_effect, 1e-300)
