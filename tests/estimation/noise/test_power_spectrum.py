"""The smooth spectrum against spectra that are known, its own doubt, and tones.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from estimation.noise.power_spectrum import CURVATURE_PRIORS, PowerSpectrum, smooth_power_spectra

Array = NDArray[np.float64]

SAMPLES, DRAWS, RHO = 4000, 12, 0.95
FREQUENCY: Array = np.arange(1, SAMPLES // 2) / np.float64(SAMPLES)  # Hz of samples 1 s apart


def smooth_power_spectrum(
    frequency: Array, ordinates: Array, *, shape: float = 1.0, start: float | None = None
) -> PowerSpectrum:
    """Of one series, ordinates (m,)."""
    return smooth_power_spectra(frequency, ordinates[:, None], shape=shape, start=start)[0]


def white(frequency: Array) -> Array:
    return np.ones_like(frequency)


def autoregressive(frequency: Array) -> Array:
    """Of x_k = RHO x_(k-1) + e_k, of unit variance."""
    return np.asarray((1 - RHO**2) / np.abs(1 - RHO * np.exp(-2j * np.pi * frequency)) ** 2)


def pink(frequency: Array) -> Array:
    return 1 + 0.02 / frequency


LAWS: dict[str, Callable[[Array], Array]] = {"white": white, "autoregressive": autoregressive, "pink": pink}


@dataclass(frozen=True)
class Draws:
    law: Callable[[Array], Array]
    shape: float
    curves: tuple[PowerSpectrum, ...]

    def errors(self) -> Array:
        """log of estimated over true spectrum, (draws, lines)."""
        return np.stack([np.log(curve(FREQUENCY) / self.law(FREQUENCY)) for curve in self.curves])

    def scores(self) -> Array:
        """The errors in units of their own doubt."""
        return self.errors() / np.sqrt(np.stack([curve.log_variance(FREQUENCY) for curve in self.curves]))


@pytest.fixture(scope="module", params=[(law, shape) for law in LAWS for shape in (1.0, 7.0)], ids=str)
def draws(request: pytest.FixtureRequest) -> Draws:
    """Fits to independent ordinates, Gamma of that shape about the law."""
    name, shape = request.param
    law, rng = LAWS[name], np.random.default_rng(list(name.encode()))
    ordinates = law(FREQUENCY) * rng.gamma(shape, 1 / shape, (DRAWS, len(FREQUENCY)))
    return Draws(law, shape, tuple(smooth_power_spectrum(FREQUENCY, row, shape=shape) for row in ordinates))


def test_spectrum_has_no_bias(draws: Draws) -> None:
    """The mean of m logarithms known to 1 / sqrt(m shape), over the draws: 4.5 sigma, 1 in 1e5."""
    expected = 1 / np.sqrt(len(FREQUENCY) * draws.shape * DRAWS)
    assert abs(draws.errors().mean()) < 4.5 * expected


def test_spectrum_is_smooth_and_close(draws: Draws) -> None:
    """k parameters of m lines leave a variance of k / (m shape); the curve may spend as many as it says, and its
    square error is a chi-square of about k degrees in each draw: three times its mean in the mean of 12 is 1 in 1e9."""
    freedom = np.mean([curve.freedom for curve in draws.curves])
    assert 2 <= freedom <= 25
    assert (draws.errors() ** 2).mean() < 3 * freedom / (len(FREQUENCY) * draws.shape)


def test_doubt_covers_the_error(draws: Draws) -> None:
    """Scores have a root mean square of one; with some 60 independent ones in 12 curves it errs by 0.09, so that
    these limits are 5 sigma away (1 in 1e6), and beyond 4 there are 6 in 1e5 of them."""
    assert 0.55 < np.sqrt((draws.scores() ** 2).mean()) < 1.45
    assert (np.abs(draws.scores()) > 4).mean() < 0.005


def test_doubt_covers_the_error_at_the_lowest_lines(draws: Draws) -> None:
    """Where drift is judged. The lowest ten share about one parameter: 12 of them, whose rms errs by 0.2."""
    low = draws.scores()[:, :10]
    assert np.sqrt((low**2).mean()) < 2.0
    assert np.sqrt((draws.errors()[:, :10] ** 2).mean()) > 0.3 / np.sqrt(10 * draws.shape)  # and it is doubtful there


def test_untroubled_records_keep_their_lines(draws: Draws) -> None:
    """One in a hundred loses a line: three of 12 would be 1 in 5000."""
    assert sum(curve.tones.any() for curve in draws.curves) <= 2


def test_doubt_does_not_shrink_below_the_ordinates() -> None:
    """The curve is continued there: never below its end, and ever more doubtful."""
    rng = np.random.default_rng(3)
    curve = smooth_power_spectrum(FREQUENCY[20:], rng.exponential(size=len(FREQUENCY) - 20), start=float(FREQUENCY[0]))
    below = FREQUENCY[:21][::-1]
    assert (curve(below) >= curve(below[:1]) * (1 - 1e-12)).all()  # rounding
    assert (np.diff(curve.log_variance(below)) >= -1e-12).all()
    assert curve.log_variance(below[-1:]) > 2 * curve.log_variance(FREQUENCY[200:201])


@pytest.mark.parametrize("law", LAWS)
def test_spectrum_does_not_depend_on_the_unit(law: str) -> None:
    """1000 times the signal in another unit, 50 times faster sampled: the same curve, elsewhere."""
    rng = np.random.default_rng(0)
    ordinates = LAWS[law](FREQUENCY) * rng.exponential(size=len(FREQUENCY))
    one, other = smooth_power_spectrum(FREQUENCY, ordinates), smooth_power_spectrum(50 * FREQUENCY, 1e6 * ordinates)
    # The scoring stops at steps below 1e-8 of log S.
    np.testing.assert_allclose(other(50 * FREQUENCY), 1e6 * one(FREQUENCY), rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_spectrum_of_an_autoregressive_series(seed: int) -> None:
    """A true series: its periodogram leaks where the spectrum falls by 1500, 0.1 of log S; the mean error of 2000 lines
    is 0.02."""
    rng = np.random.default_rng(seed)
    shocks = rng.standard_normal(SAMPLES + 500) * np.sqrt(1 - RHO**2)
    series = lfilter([1.0], [1.0, -RHO], shocks)[500:]
    curve = smooth_power_spectrum(FREQUENCY, np.abs(np.fft.rfft(series))[1:-1] ** 2 / SAMPLES)
    error = np.log(curve(FREQUENCY) / autoregressive(FREQUENCY))
    assert abs(error.mean()) < 0.1  # 4.5 sigma, 1 in 1e5
    assert np.sqrt((error**2).mean()) < 0.25


def test_corner_of_a_steep_filter_is_followed() -> None:
    """Of order 8: a part of the lines about its corner has the power that the curve says.

    The mean of 80 exponential ordinates errs by 0.11, and with the curve's own doubt by 0.16: 5 sigma, 1 in 1e6. A
    curve no freer than a first-order corner is wrong by two there.
    """
    rng, corner = np.random.default_rng(4), 0.05
    u = np.tan(np.pi * FREQUENCY) / np.tan(np.pi * corner)
    ordinates = rng.exponential(size=(len(FREQUENCY), 3)) / (1 + u**16)[:, None]
    curves = smooth_power_spectra(FREQUENCY, ordinates, nyquist=0.5, curvatures=CURVATURE_PRIORS[1:])
    for column, curve in zip(ordinates.T, curves, strict=True):
        for low in (0.8, 0.95, 1.1):
            lines = (corner * low < FREQUENCY) & (corner * (low + 0.4) > FREQUENCY)
            assert abs((column[lines] / curve(FREQUENCY[lines])).mean() - 1) < 0.8


# ------------------------------------------------------------------------------------------------ tones


def test_tones_are_found_and_left_out(draws: Draws) -> None:
    """Two lines 60 times their surroundings; with a shape of 1 chance makes ln(2000 / 0.01) = 12 at the most."""
    rng = np.random.default_rng(5)
    lines = np.array([300, 1500])
    plain = draws.law(FREQUENCY) * rng.gamma(draws.shape, 1 / draws.shape, len(FREQUENCY))
    loud = plain.copy()
    loud[lines] = 60 * draws.law(FREQUENCY)[lines]
    curve, undisturbed = (smooth_power_spectrum(FREQUENCY, o, shape=draws.shape) for o in (loud, plain))
    found = np.flatnonzero(curve.tones)
    np.testing.assert_array_equal(found, np.sort(np.concatenate([lines - 1, lines, lines + 1])))
    # Six lines fewer than the undisturbed fit had: their share of what is known there.
    change = np.log(curve(FREQUENCY) / undisturbed(FREQUENCY))
    assert (np.abs(change) < 0.5 * np.sqrt(undisturbed.log_variance(FREQUENCY))).all()


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_ordinates_that_are_none_are_left_out(bad: float) -> None:
    rng = np.random.default_rng(6)
    ordinates = rng.exponential(size=len(FREQUENCY))
    ordinates[700] = bad
    curve = smooth_power_spectrum(FREQUENCY, ordinates)
    assert curve.tones[700]
    assert abs(np.log(curve(FREQUENCY)).mean()) < 0.1  # 4.5 sigma of 1 / sqrt(2000)


@pytest.mark.parametrize("lines", [10, 40, 300])
def test_few_lines_are_enough_for_a_level(lines: int) -> None:
    """The mean of the log error, whose std is 1 / sqrt(lines) for the best of estimators: 4.5 sigma."""
    rng = np.random.default_rng(lines)
    frequency = np.arange(1, lines + 1) / np.float64(2 * lines)
    curve = smooth_power_spectrum(frequency, rng.exponential(size=lines))
    assert abs(np.log(curve(frequency)).mean()) < 4.5 / np.sqrt(lines)
