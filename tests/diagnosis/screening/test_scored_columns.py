"""Score columns in the rows that they reach say of the noise there what they say in all rows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.screening.grid_search import affected_rows, grid_points, search_domain
from diagnosis.screening.null_model import NullModel, row_index
from diagnosis.screening.projection import columns_beside, noise_levels
from diagnosis.screening.whitened_sensitivity import score_columns
from estimation.fit import Fit, fit
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.effects import named
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]


def recorded(seed: int, repeats: int) -> Recording:
    frame = simulate(PlanarRig(), PlanarRig().random_motion(seed=seed), repeats=max(repeats, 2), samples_per_period=100)
    return recording_of(frame, without=() if repeats > 1 else ("repeat",), name=f"{seed}", rig=RIG)


@cache
def fitted(*repeats: int) -> Fit:
    """To recordings with so many repeats each, 1 of a single run."""
    return fit(planar(RIG), [recorded(seed, count) for seed, count in enumerate(repeats)])


@pytest.mark.parametrize("repeats", [(4,), (4, 3), (1,), (1, 4), (4, 1)], ids=str)
@pytest.mark.parametrize("effect", ["viscous_drag", "bias_drift", "contact_event", "thermal_drift", "sensor_lag"])
def test_all_rows_say_the_same(effect: str, repeats: tuple[int, ...]) -> None:
    null_model = NullModel(fitted(*repeats))
    noise, model = null_model.fit.noise, null_model.fit.model + named(effect)
    grid = named(effect).nuisance_grid(search_domain(null_model, 0, model.effects[-1]))
    points = grid_points(model, model.effects[-1], grid[:1])
    choice = affected_rows(null_model.fit, model, points[0])
    columns = score_columns(null_model.fit, model, points, choice)[:, 0]
    free, ranges = columns_beside(null_model, columns, choice)
    whole = null_model.project_out(null_model.spread(columns, choice))
    index = row_index(ranges, noise)
    size = float(np.linalg.norm(whole))
    np.testing.assert_allclose(free, whole[index], atol=1e-10 * size)
    others = whole.copy()
    others[index] = 0.0
    assert np.linalg.norm(others) < 1e-10 * size
    shares = whole**2 / (whole**2).sum(axis=0)
    ends = np.cumsum([0, *(n.whitener.rows for n in noise)])
    parts = zip(noise, ends[:-1], ends[1:], strict=True)
    variance = np.sum([n.log_power_variance_of(shares[start:end]) for n, start, end in parts], axis=0)
    known = [leverage is None for leverage in null_model.line_leverage]
    levels = noise_levels(null_model, ranges, free, free)
    own = []  # with the error of the weights, by which a variance is larger
    for recording_noise, start, end, is_known in zip(noise, ends[:-1], ends[1:], known, strict=True):
        share = shares[start:end].sum(axis=0)
        if is_known and share.any():
            own.append(share * recording_noise.error_of_weights(shares[start:end] / share))
    if all(known):
        np.testing.assert_allclose([level.log_variance for level in levels], variance, rtol=1e-8)
    np.testing.assert_allclose([level.known for level in levels], sum(own, np.zeros(shares.shape[1])), atol=1e-12)
    assert all(len(level.parts) == 3 * known.count(False) for level in levels)
