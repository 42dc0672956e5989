"""Robust fits: the M-estimate's equations, an independent solver, spikes on the simulated rig, and what it costs.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

from benchmarks.coverage import NOISES, RIGS, Setting, Spiked
from estimation.fit import fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from estimation.robust_fit import InverseCovarianceFilter, Outliers, RobustFit, robust_fit, separate_outliers
from estimation.robust_loss import Huber, Loss, StudentT
from modeling.chain.model import planar
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.rig import Rig, SensorDescription
from modeling.space import Space
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

LOSSES = [Huber(), Huber(2.0), StudentT(), StudentT(8.0)]
SHORT, FAST = Setting(repeats=4, samples=100), Setting(repeats=4, samples=60)
SCALE = np.array(RIGS[Space.PLANE].noise)


# -------------------------------------------------------------------------------------------- losses


@pytest.mark.parametrize("loss", LOSSES, ids=str)
def test_psi_slope_and_weight_belong_together(loss: Loss) -> None:
    u = np.linspace(-7, 7, 1001) + 1e-4  # no corner of Huber's on the grid
    step = 1e-6
    numeric = (loss.psi(u + step) - loss.psi(u - step)) / (2 * step)
    np.testing.assert_allclose(loss.slope(u), numeric, atol=1e-8)  # rounding over the step, and its square
    np.testing.assert_allclose(loss.weight(u) * u, loss.psi(u), atol=1e-14)
    np.testing.assert_allclose(loss.psi(-u), -loss.psi(u), atol=1e-14)
    assert loss.slope(np.zeros(1)) == 1


@pytest.mark.parametrize("k", [0.5, 1.345, 3.0])
def test_hubers_efficiency_is_that_of_his_closed_form(k: float) -> None:
    inside = 2 * norm.cdf(k) - 1
    power = inside - 2 * k * norm.pdf(k) + 2 * k**2 * norm.sf(k)
    assert Huber(k).efficiency == pytest.approx(inside**2 / power, rel=1e-9)  # Gauss' rule to rounding
    # E |u| beyond k is 2 phi(k): what is taken there is 1 - k / |u|, by Monte Carlo within 4.5 of its sigma.
    draws = np.abs(np.random.default_rng(0).standard_normal(10**6))
    taken = 1 - np.minimum(1, k / draws)
    assert Huber(k).downweighted == pytest.approx(taken.mean(), abs=4.5 * taken.std() / 1e3)


def test_the_known_95_percent() -> None:
    assert Huber().efficiency == pytest.approx(0.95, abs=1e-4)  # k = 1.345 is printed with four digits


@pytest.mark.parametrize("make", [Huber, StudentT])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_losses_refuse_what_is_not_positive(make: type[Huber] | type[StudentT], value: float) -> None:
    with pytest.raises(InputError, match="positive"):
        make(value)


# ------------------------------------------------------------------- white noise: an independent solver


@cache
def stated_run() -> Recording:
    """A single run with spikes, its noise stated by the rig."""
    spiked = SHORT.drawn(Spiked(NOISES["white"], rate=0.05), 3)
    columns = {name: spiked.columns[name][:200] for name in spiked.columns}
    columns |= dict(zip(spiked.channels, spiked.wrench[:200].T, strict=True)) | {"time": np.arange(200) * 0.05}
    sensor = SensorDescription(noise=dict(zip(spiked.channels, SCALE.tolist(), strict=True)))
    return from_columns(columns, rig=Rig(link_lengths=(1.0, 0.97, 0.4), sensor=sensor))


def stated_design(found: RobustFit) -> tuple[Array, Array]:
    """Regressor and readings in units of the stated noise, flattened."""
    response = found.plain.response()
    constant = response.value - response.derivative @ found.plain.theta
    regressor = response.derivative / SCALE[:, None]
    return regressor.reshape(-1, 6), ((stated_run().wrench - constant) / SCALE).ravel()


@pytest.mark.parametrize(("loss", "name", "scale"), [(Huber(), "huber", 1.345), (StudentT(), "cauchy", 2.0)])
def test_white_noise_of_known_size_gives_scipys_m_estimate(
    loss: Loss, name: Literal["huber", "cauchy"], scale: float
) -> None:
    """SciPy's `huber` is Huber's loss at f_scale k, its `cauchy` that of t with f_scale² degrees of freedom."""
    found = robust_fit(planar(), stated_run(), loss=loss)
    assert found.converged
    assert found.plain.noise[0].source is NoiseSource.RIG
    regressor, readings = stated_design(found)
    size = np.linalg.norm(regressor, axis=0)

    def left(x: Array) -> Array:
        return np.asarray(readings - regressor @ (x / size))

    reference = least_squares(
        left, found.plain.theta * size, loss=name, f_scale=scale,
        x_scale=1.0, xtol=1e-14, ftol=1e-14, gtol=1e-12,
    )  # fmt: skip
    std = np.array([found.parameters[p.name].std for p in found.fit.unknowns])
    # The last move was below 0.01 std; the fixed point contracts by less than a half, so as much again may be left.
    assert np.max(np.abs(found.fit.theta - reference.x / size) / std) < 0.01


@pytest.mark.parametrize("loss", LOSSES[::2], ids=str)
def test_covariance_of_white_noise_is_hubers(loss: Loss) -> None:
    """H^-1 M H^-1 with H = X' diag(psi') X and M of each channel's mean psi²."""
    found = robust_fit(planar(), stated_run(), loss=loss)
    regressor, _ = stated_design(found)
    u = found.outliers[0].distance
    h = regressor.T @ (loss.slope(u).reshape(-1, 1) * regressor)
    power = np.tile((loss.psi(u) ** 2).mean(axis=0), len(u))
    inverse = np.linalg.inv(h)
    expected = inverse @ (regressor.T @ (power[:, None] * regressor)) @ inverse
    np.testing.assert_allclose(found.fit.covariance, expected, rtol=1e-6, atol=1e-12)  # condition 1e4 times rounding


# --------------------------------------------------------------------------- coloured noise: optimality


def test_surprise_of_an_autoregression_is_its_interpolation_error() -> None:
    """Of x_t = rho x_(t-1) + e_t the best guess from both sides is rho / (1 + rho²) times the neighbours' sum."""
    rho, n = 0.9, 64
    weights = 1 + rho**2 - 2 * rho * np.cos(np.pi * np.arange(n) / n)
    series = np.random.default_rng(0).standard_normal((1, n, 1))
    prediction_error = InverseCovarianceFilter(weights[:, None]).prediction_error(series)[0, :, 0]
    x = series[0, :, 0]
    expected = x[1:-1] - rho / (1 + rho**2) * (x[:-2] + x[2:])
    # The weights' mean is that of cosines over half a turn, 1 + rho² but for 2 rho / n.
    np.testing.assert_allclose(prediction_error[1:-1] * weights.mean() / (1 + rho**2), expected, atol=1e-12)


@cache
def coloured(loss: Loss) -> Outliers:
    recording = SHORT.drawn(Spiked(NOISES["AR 0.98"]), 1)
    return separate_outliers(recording, recording.wrench - SHORT.drawn(simulated.WhiteNoise(), 1).wrench, loss)


def test_huber_outliers_of_coloured_noise_are_the_convex_minimum() -> None:
    """KKT of (e - o)' C^-1 (e - o) / 2 + k sum |o|: the surprise is k s where o is not zero, and below it elsewhere."""
    loss = Huber()
    found = coloured(loss)
    left = (found.residual - found.part)[None]
    prediction_error = found.precision.prediction_error(left)[0] / found.scale
    touched = np.abs(found.distance) > loss.k
    assert 0.05 < touched.mean() < 0.5
    np.testing.assert_allclose(
        prediction_error[touched], loss.k * np.sign(found.part[touched]), atol=1e-3
    )  # ten times where the iteration stops
    assert np.abs(prediction_error[~touched]).max() <= loss.k + 1e-3
    assert (np.abs(found.part / found.scale)[~touched] < 1e-3).all()
    np.testing.assert_array_equal(np.sign(found.part[touched]), np.sign(found.distance[touched]))


def test_linearised_cleaning_knows_untouched_samples_only() -> None:
    """Of Huber's loss a touched sample follows what its neighbours predict: no surprise there, no part elsewhere."""
    found = coloured(Huber())
    change = np.random.default_rng(2).standard_normal((len(found.part), 3, 2)).cumsum(axis=0)
    left = found.linearised(change)
    touched = np.abs(found.distance) > Huber().k
    np.testing.assert_array_equal(left[~touched], change[~touched])
    rest = found.precision.prediction_error(left[None])[0]
    assert np.abs(rest[touched]).max() < 1e-2 * np.abs(rest[~touched]).max()  # a hundred times where it stops


# ------------------------------------------------------------------------------------ simulated spikes


@pytest.mark.parametrize(("name", "repeats"), [("white", 4), ("AR 0.98", 4), ("AR 0.98", 1)])
def test_spikes_are_found_where_they_are(name: str, repeats: int) -> None:
    setting = Setting(repeats=repeats, samples=100 if repeats > 1 else 400)
    clean, spiked = setting.drawn(NOISES[name], 1), setting.drawn(Spiked(NOISES[name]), 1)
    # The spikes are drawn after the noise, from one stream: the difference is the spikes alone.
    planted = np.abs(spiked.wrench - clean.wrench) > 0
    found = robust_fit(planar(), spiked)
    assert found.converged
    assert planted.sum() > 5
    np.testing.assert_array_equal(found.outliers[0].found & planted, planted)
    # Of Gaussian readings 1 in 100 channels shows a false one; the scale errs by 10 %, and three would be 1 in 500.
    assert (found.outliers[0].found & ~planted).sum() <= 2
    step = spiked.dt
    assert step is not None
    np.testing.assert_allclose(found.outliers[0].times(0), np.flatnonzero(found.outliers[0].found[:, 0]) * step)
    error = found.fit.theta - np.array(list(setting.truth.values()))
    half = found.intervals(level=1 - 1e-5).half_width
    assert (np.abs(error) < half).all()  # 1 in 1e4 for six of them


@pytest.mark.parametrize("name", ["white", "AR 0.98"])
def test_gaussian_noise_costs_little(name: str) -> None:
    """Variance a twentieth more: the M-estimate differs from least squares by sqrt(0.053) = 0.23 std; 4.5 times that
    is 1 in 1e4 for six. Coloured noise costs less, its slow part being known from both sides."""
    found = robust_fit(planar(), SHORT.drawn(NOISES[name], 2))
    std = np.sqrt(np.diag(found.plain.covariance))
    assert np.max(np.abs(found.fit.theta - found.plain.theta) / std) < 4.5 * 0.23
    # The stds of mass, first moment and inertia are 2.6 % apart, and the spectra of both noises by a few per cent.
    ratio = np.sqrt(np.diag(found.fit.covariance))[3:] / std[3:]
    assert (ratio > 0.9).all()
    assert (ratio < 1.15).all()
    # Taken: 4 % ± 0.5 % of 400 samples in each channel.
    np.testing.assert_allclose(found.outliers[0].share, found.loss.downweighted, atol=0.023)
    assert not found.outliers[0].found.any()  # 1 in 33


def test_errors_under_spikes_are_those_of_clean_noise() -> None:
    """Sum of squared scores of mass, first moment and inertia in 4 records, each scored by the std without spikes.

    One percent of 20 std adds four times the noise's power to least squares. A robust record's three scores add up to
    3 with a std of 3.5 or less (they go together), four to 12 ± 7: 45 is 4.7 sigma; least squares have 60 ± 35.
    """
    truth = np.array(list(FAST.truth.values()))[3:]
    robust, plain = 0.0, 0.0
    for seed in range(4):
        std = np.sqrt(np.diag(fit(planar(), FAST.drawn(NOISES["white"], seed)).covariance))[3:]
        found = robust_fit(planar(), FAST.drawn(Spiked(NOISES["white"]), seed))
        robust += float((((found.fit.theta[3:] - truth) / std) ** 2).sum())
        plain += float((((found.plain.theta[3:] - truth) / std) ** 2).sum())
    assert robust < 45
    assert plain > 1.5 * robust


def test_a_wild_pose_at_rest_does_not_move_the_zero() -> None:
    setting = Setting(repeats=1, samples=24, rest=True)
    clean = setting.drawn(NOISES["white"], 1)
    wild = clean.wrench.copy()
    wild[7, 1] += 40 * SCALE[1]
    found = robust_fit(planar(), clean.with_readings(wild))
    assert found.outliers[0].found[7, 1]
    undisturbed = fit(planar(), clean).parameters["bias_fy"]
    # Huber's loss lets 1.345 std of one pose of 24 through, least squares all 40: a 24th of it over std / sqrt(24).
    assert abs(found.values["bias_fy"] - undisturbed.value) < 1.0 * undisturbed.std
    assert abs(found.plain.values["bias_fy"] - undisturbed.value) > 4.0 * undisturbed.std
    assert found.parameters["bias_fy"].std < 0.5 * found.plain.parameters["bias_fy"].std


def test_the_table_names_recording_channel_and_time() -> None:
    text = str(robust_fit(planar(), stated_run(), loss=StudentT()))
    assert "StudentT(freedom=4.0)" in text
    assert all(f"recording  {channel}" in text for channel in ("fx", "fy", "tau"))
