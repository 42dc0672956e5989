"""Bootstrap over repeats: exact refits, unbiased stds, and what it says when repeats are not what the fit assumes.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.coverage import LAG, NOISES, Setting
from estimation.bootstrap import Agreement, Bootstrap, bootstrap
from estimation.fit import Fit, fit
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.errors import InputError

Array = NDArray[np.float64]

EIGHT = Setting(samples=60)
FIVE_SIGMA = 4.5
"""1 in 1.5e5 for one normal comparison."""


def fitted(seed: int = 1, *, repeats: int = 8, noise: str = "white") -> Fit:
    return fit(planar(), Setting(repeats=repeats, samples=60).drawn(NOISES[noise], seed))


def per_repeat(found: Bootstrap) -> Array:
    """The estimate (R, k) from each repeat alone: theta plus R times its influence on the mean."""
    (influences,) = found.pushes
    return np.asarray(found.fit.theta + len(influences) * influences)


@pytest.mark.parametrize("noise", ["white", "AR 0.98"])
def test_an_estimate_per_repeat_is_that_of_a_recording_of_this_repeat_alone(noise: str) -> None:
    """Eight copies of repeat r, refitted with the same noise: one step is exact for a linear model."""
    estimated = fitted(noise=noise)
    (recording,) = estimated.recordings
    found = bootstrap(estimated)
    std = np.sqrt(np.diag(estimated.covariance))
    for r in (0, 3, 7):
        run = recording.wrench.reshape(8, 60, 3)[r]
        alone = estimated.problem.of_recordings([recording.with_readings(np.tile(run, (8, 1)))])
        refitted = alone.minimise(np.zeros(6)).theta
        np.testing.assert_allclose((per_repeat(found)[r] - refitted) / std, 0, atol=1e-6)  # rounding times condition
    np.testing.assert_allclose((per_repeat(found).mean(axis=0) - estimated.theta) / std, 0, atol=1e-6)


def test_draws_scatter_by_the_std_in_closed_form() -> None:
    found = bootstrap(fitted(), draws=4000)
    # 4000 draws know a std to 1.1 %, six of them within 4.5 sigma; R - 1 degrees of freedom of one recording.
    np.testing.assert_allclose(found.draws.std(axis=0), found.std, rtol=FIVE_SIGMA * 0.0112)
    np.testing.assert_allclose(found.freedom, 7)
    expected = per_repeat(found).std(axis=0, ddof=1) / np.sqrt(8)
    np.testing.assert_allclose(found.std, expected, rtol=1e-9)  # the textbook's std of a mean


def test_bootstrap_variance_is_unbiased() -> None:
    """Over 25 recordings its mean is the variance of the estimates; chi-square of 7 over 7 varies by 0.53, and 25 by
    0.11; the analytic one is known to 5 %. Without R / (R - 1) the mean would be 0.875."""
    ratios = []
    for seed in range(25):
        estimated = fitted(seed)
        ratios.append((bootstrap(estimated, draws=2).std ** 2 / np.diag(estimated.covariance))[3:])
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.5)


def test_percentiles_of_many_repeats_agree_with_t() -> None:
    found = bootstrap(fitted(repeats=30), draws=8000)
    t_width = np.subtract(*found.t_interval()[::-1])
    width = np.subtract(*found.percentile_interval()[::-1])
    # Percentiles near 2 % of 8000 draws err by 2 % of the width; the scatter of 30 repeats is not quite normal (10 %).
    np.testing.assert_allclose(width, t_width, rtol=0.2)


def test_analytic_and_bootstrap_agree_where_they_should() -> None:
    """Holm's procedure at 1 % a record: two of three records that disagree would be 3 in 1e4."""
    disagreeing = [
        any(a is not Agreement.AGREES for a in bootstrap(fitted(seed, noise=noise)).agreement[3:])
        for seed, noise in enumerate(("white", "AR 0.95", "1/f and lines"))
    ]
    assert sum(disagreeing) <= 1


# --------------------------------------------------------------------------- where they should not


def scaled(recording: Recording, factors: Array) -> Recording:
    """Every repeat's readings times a factor of its own: a gain that is not the same from repeat to repeat."""
    runs = recording.wrench.reshape(recording.repeats, -1, 3) * factors[:, None, None]
    return recording.with_readings(runs.reshape(-1, 3))


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        (np.linspace(-1, 1, 8), Agreement.DRIFTS),
        (np.array([1, -1, -1, 1, 1, -1, -1, 1.0]), Agreement.SCATTERS),
    ],
)
def test_a_gain_that_varies_between_repeats_is_seen(factors: Array, expected: Agreement) -> None:
    """By 1 %, which is some ten stds of the mass from one repeat."""
    recording = scaled(EIGHT.drawn(NOISES["white"], 1), 1 + 0.01 * factors)
    found = bootstrap(fit(planar(), recording))
    mass = [p.name for p in found.fit.unknowns].index("m")
    assert found.agreement[mass] is expected
    assert expected.value in str(found)
    # The mass of every repeat alone follows its gain: half a per cent of slope for its other parameters' share.
    slope = np.polyfit(factors, per_repeat(found)[:, mass], 1)[0]
    assert slope == pytest.approx(0.01 * 0.9, rel=0.1)


def test_few_repeats_say_what_they_are_worth() -> None:
    text = str(bootstrap(fitted(repeats=3)))
    assert "3 repeats: a std from their scatter errs by 50 %" in text
    assert "4.3" in text  # the t quantile of two degrees of freedom
    assert "repeats:" not in str(bootstrap(fitted()))


def test_a_single_run_is_refused() -> None:
    with pytest.raises(InputError, match="ran once"):
        bootstrap(fit(planar(), Setting(repeats=1, samples=100).drawn(NOISES["white"], 1)))


# ------------------------------------------------------------------------ several recordings, refits


def test_recordings_are_resampled_each_within_itself() -> None:
    one, other = EIGHT.drawn(NOISES["white"], 1), Setting(repeats=4, samples=60).drawn(NOISES["white"], 2)
    several = fit(planar(), [replace(one, name="one"), replace(other, name="other")])
    found = bootstrap(several)
    assert [len(a) for a in found.pushes] == [8, 4]
    names = [p.name for p in several.unknowns]
    # A bias belongs to one recording: the other one's repeats do not move it, but through what is shared.
    assert found.parts[1, names.index("bias_fx@other")] > 10 * found.parts[0, names.index("bias_fx@other")]
    mass = names.index("m")
    assert 3 < found.freedom[mass] <= 10
    # Twelve repeats in all: a std within 4.5 of its relative errors, 1 / sqrt(2 f).
    ratio = found.std[mass] / np.sqrt(several.covariance[mass, mass])
    assert abs(ratio - 1) < FIVE_SIGMA / np.sqrt(2 * found.freedom[mass])


def lagging() -> Fit:
    setting = replace(LAG, samples=60)
    return fit(setting.model, setting.drawn(NOISES["white"], 1))


def test_refits_of_a_nonlinear_model_scatter_as_one_step_does() -> None:
    estimated = lagging()
    step, full = bootstrap(estimated), bootstrap(estimated, refits=True, draws=50)
    # 50 draws know a std to 10 %, for seven of them within 4.5 sigma; the lag's curvature over one std is below that.
    np.testing.assert_allclose(full.std, step.std, rtol=0.45)
    assert (full.relative_error > step.relative_error).all()


def test_an_executor_gives_the_same_draws() -> None:
    estimated = lagging()

    def run(executor: ThreadPoolExecutor | None) -> Bootstrap:
        return bootstrap(estimated, refits=True, draws=6, seed=3, executor=executor)

    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_array_equal(run(pool).draws, run(None).draws)
