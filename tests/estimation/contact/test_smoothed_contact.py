"""Contact wrenches at a lag: least noise among all weights that pass a contact, and a noise that is as stated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import truewrench as tw
from estimation.contact.smoothed_contact import MOST_WEIGHTS, SmoothedSeries, inertial_accelerations, smoothed_series
from modeling.errors import InputError
from tests.shared.places import AIS2202, needs

Array = NDArray[np.float64]

DT = 1e-3
LINE = 2 * np.pi * 60 * DT
"""rad a sample: a vibration at 60 Hz."""


def vibration(rng: np.random.Generator, count: int, *, radius: float = 0.98) -> Array:
    """A narrow-band process about `LINE`, autoregressive of order two, of unit innovations."""
    poles = [1.0, -2 * radius * np.cos(LINE), radius**2]
    return np.asarray(lfilter([1.0], poles, rng.standard_normal(count + 2000))[2000:])


def smoothed(
    series: Array, lag: float, *, unit: Array | None = None, free: NDArray[np.bool_] | None = None, runs: int = 1
) -> SmoothedSeries:
    count = len(series)
    quiet = np.ones(count, dtype=bool) if free is None else free
    accelerations = np.zeros((count, 0)) if unit is None else unit
    return smoothed_series(series, accelerations, quiet, dt=DT, runs=runs, lag=lag, name="test")


def std_in_the_middle(result: SmoothedSeries) -> float:
    """Of the noise of the first component, where the whole window fits."""
    return float(np.sqrt(result.noise[len(result.noise) // 2, 0, 0]))


def test_the_noise_is_the_least_that_any_weights_leave() -> None:
    """Against the minimum variance by the process's exact autocovariance: within a tenth, which 40 000 samples of 41
    weights miss by 2 % at a std of about 2 %; and far below a moving average."""
    rng = np.random.default_rng(1)
    count, half = 40_000, 20
    series = vibration(rng, count) + rng.standard_normal(count)
    response = lfilter([1.0], [1.0, -2 * 0.98 * np.cos(LINE), 0.98**2], np.eye(1, 4000)[0])
    exact = np.array([response[: 4000 - k] @ response[k:] for k in range(2 * half + 1)])
    exact[0] += 1.0
    covariance = toeplitz(exact)
    kept = np.column_stack([np.ones(2 * half + 1), np.arange(-half, half + 1)])
    least = np.linalg.inv(kept.T @ np.linalg.solve(covariance, kept))[0, 0]
    result = smoothed(series[:, None], half * DT)
    assert result.lag == pytest.approx(half * DT)
    assert result.wrench.var() == pytest.approx(least, rel=0.1)
    assert std_in_the_middle(result) ** 2 == pytest.approx(least, rel=0.1)
    average = np.convolve(series, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
    assert result.wrench.var() < 0.7 * average.var()


def test_a_contact_is_through_after_the_lag_and_not_felt_before_it() -> None:
    """The weights' own response: the same noise with and without a step and a ramp, of samples known as contact."""
    rng = np.random.default_rng(2)
    noise = vibration(rng, 8000)
    time = np.arange(8000)
    step = 5.0 * ((time >= 3000) & (time < 3500)) + 0.01 * np.clip(time - 5000, 0, None) * (time < 6000)
    free = (time < 3000) | ((time >= 3500) & (time < 5000)) | (time >= 6000)
    half = 20
    without = smoothed((noise * free)[:, None], half * DT, free=free).wrench[:, 0]
    passed = smoothed((noise * free + step)[:, None], half * DT, free=free).wrench[:, 0] - without
    inside = [slice(half, 3000 - half), slice(3000 + half, 3500 - half), slice(3500 + half, 5000 - half)]
    for part in [*inside, slice(5000 + half, 6000 - half), slice(6000 + half, 8000 - half)]:
        np.testing.assert_allclose(passed[part], step[part], atol=1e-9)
    edge = passed[3000 - half : 3000 + half]
    assert edge[0] < 1.0 < 4.0 < edge[-1]


def test_the_stated_noise_holds_for_another_recording_of_the_same_noise() -> None:
    """RMS of what is left in a part that is taken for contact, over the stated std, in 40 series of 4000 samples: its
    mean has a std of about 0.6 %, and weights of 4 % of the samples add about 1 %."""
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(40):
        series = (vibration(rng, 5000) + 2 * rng.standard_normal(5000))[:, None]
        free = np.arange(5000) < 4000
        result = smoothed(series, 0.03, free=free)
        left = result.wrench[4000 + 30 : -30, 0]
        ratios.append(np.sqrt((left**2).mean() / std_in_the_middle(result) ** 2))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.04)


def test_an_inertial_unit_that_feels_the_vibration_takes_it_out() -> None:
    """Force = vibration through a short response, seen by the unit with little noise: what is left is the sensor's own
    noise, averaged; a unit that feels something else is not used and costs nothing."""
    rng = np.random.default_rng(4)
    count, half = 20_000, 5
    shaken = vibration(rng, count)
    force = np.convolve(shaken, [0.2, 0.9, -0.4], "same") + 0.3 * rng.standard_normal(count)
    felt = np.column_stack([shaken + 0.02 * rng.standard_normal(count), rng.standard_normal(count)])
    alone, helped = (smoothed(force[:, None], half * DT, unit=unit) for unit in (None, felt))
    assert helped.with_unit == (0,)
    assert std_in_the_middle(helped) ** 2 < 0.1 * std_in_the_middle(alone) ** 2
    assert std_in_the_middle(helped) ** 2 == pytest.approx(0.3**2 / (2 * half + 1), rel=0.35)
    other = vibration(np.random.default_rng(5), count)[:, None]
    unhelped = smoothed(force[:, None], half * DT, unit=other)
    assert std_in_the_middle(unhelped) ** 2 <= std_in_the_middle(alone) ** 2


def test_a_unit_that_feels_nothing_enters_by_no_chance() -> None:
    """Of 40 series of 2000 samples with three accelerations of other noise, and one that is constant but for rounding.

    Without a least gain three of them enter.
    """
    rng = np.random.default_rng(8)
    for _ in range(40):
        series, unit = rng.standard_normal((2000, 1)), rng.standard_normal((2000, 3))
        assert smoothed(series, 0.003, unit=unit).with_unit == ()
    constant = {"imu_ax": 1 + 1e-15 * rng.standard_normal(500), "imu_ay": np.full(500, np.nan)}
    assert inertial_accelerations(constant, rng.standard_normal((500, 3))).shape == (500, 0)


def test_at_the_ends_of_a_run_a_ramp_is_passed_and_the_noise_is_as_stated() -> None:
    """Of 25 runs that end in a contact that grows: RMS of what is left in each of seven rows near the ends over its
    std, in three components; its std is 8 %."""
    rng = np.random.default_rng(9)
    ramp = 0.3 * np.maximum(np.arange(2000.0) - 1940, 0)[:, None]
    left = []
    for _ in range(25):
        series = rng.standard_normal((2000, 3))
        result = smoothed(series + ramp, 0.02, free=np.arange(2000) < 1940)
        assert result.wrench[-1] == pytest.approx((series + ramp)[-1])
        std = np.sqrt(np.diagonal(result.noise, axis1=1, axis2=2))
        left.append(((result.wrench - ramp) / std)[[0, 4, 11, -15, -6, -2, -1]])
    assert np.sqrt(np.mean(np.square(left), axis=(0, 2))) == pytest.approx(1.0, abs=0.35)


def test_runs_do_not_reach_into_each_other() -> None:
    """Each of two runs with its zero far from the other's is as it is by itself."""
    rng = np.random.default_rng(6)
    series = rng.standard_normal((4000, 1))
    shifted = series + np.repeat([0.0, 100.0], 2000)[:, None]
    apart = smoothed(shifted, 0.01, runs=2).wrench
    assert np.abs(apart[:2000]).max() < 5.0
    assert np.abs(apart[2000:] - 100.0).max() < 5.0


@pytest.mark.parametrize(
    ("lag", "free", "words"),
    [
        (np.nan, 1.0, "'nan' is no lag"),
        (np.inf, 1.0, "'inf' is no lag"),
        (1e-4, 1.0, "give one of 1 to 250 ms"),
        (MOST_WEIGHTS * DT, 1.0, "give one of 1 to 250 ms"),
        (0.05, 0.2, "have no contact within 50 ms"),
    ],
)
def test_a_lag_that_cannot_be_is_refused_with_those_that_can(lag: float, free: float, words: str) -> None:
    series = np.random.default_rng(7).standard_normal((4000, 3))
    with pytest.raises(InputError, match=words):
        smoothed(series, lag, free=np.arange(4000) < 4000 * free)


def test_poses_at_rest_have_no_lag() -> None:
    series = np.zeros((100, 3))
    with pytest.raises(InputError, match="static poses have no lag"):
        smoothed_series(series, series[:, :0], np.ones(100, dtype=bool), dt=None, runs=1, lag=0.01, name="test")


@needs(AIS2202)
def test_the_measured_run_is_quieter_than_published_filters_leave_it() -> None:
    """The run without contact of Skrede's recordings: Kalman filters that were published with them leave 0.22, 0.13 and
    0.20 N (RMS) of the forces where they smooth much, 1.32, 0.60 and 0.37 N where they follow."""
    rig = tw.Rig.read(AIS2202 / "rig.toml")
    fitted = tw.fit(tw.spatial(rig), tw.read(AIS2202 / "calibration_poses.csv", rig=rig))
    run = tw.read(AIS2202 / "baseline.csv", rig=rig)
    little, much = (tw.compensate(fitted, run, lag=lag) for lag in (0.003, 0.05))
    assert (little.wrench[:, :3].std(axis=0) < (1.32, 0.60, 0.37)).all()
    assert (much.wrench[:, :3].std(axis=0) < (0.22, 0.13, 0.20)).all()
    assert not little.means
    assert "fcx" in much.inertial
