"""Tones beside the motion's lines: found where they are, nowhere else, and paid for over all frequencies.

Every draw has a fixed seed, so that a test fails always or never.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from estimation.fit import fit
from estimation.multiplicity import effective_number_of_frequencies
from estimation.noise.tones import NonperiodicResidual, find_tones, sinusoids, without_sinusoids
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import LineInterference, PlanarRig, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]

SAMPLES = 1000


@cache
def recorded(force: float = 0.0, repeats: int = 4, period: int = SAMPLES // 4) -> Recording:
    hidden = (LineInterference(force=force, torque=force / 20),) if force else ()
    motion = PlanarRig().random_motion(seed=1)
    frame = simulate(PlanarRig(), motion, hidden=hidden, repeats=repeats, samples_per_period=period, seed=1)
    return recording_of(frame, rig=RIG)


def noise(seed: int, samples: int = SAMPLES) -> Array:
    return np.random.default_rng(seed).standard_normal((samples, 3))


@pytest.mark.parametrize(("frequency", "amplitude"), [(17.317, 1.0), (3.03, 0.5), (9.99, 2.0)])
def test_tone_is_found_to_a_part_of_the_spacing_of_lines(frequency: float, amplitude: float) -> None:
    """Its frequency has the std sqrt(6 / n) / (pi A T) in white noise of unit variance (Rife and Boorstyn 1974).

    Four of them, and twice that for a motion whose lines are left out; three channels only make it better.
    """
    recording = recorded()
    duration = SAMPLES * (recording.dt or 1.0)
    wave = amplitude * sinusoids(recording, [frequency])[:, :1]
    found = find_tones(recording, noise(3) + wave)
    std = np.sqrt(6 / SAMPLES) / (np.pi * amplitude * duration)
    assert found[0] == pytest.approx(frequency, abs=8 * std)
    assert len(found) == 1


PERIODS = [(4, 250), (3, 250), (5, 200), (7, 143), (4, 125), (6, 125)]
"""Repeats and samples of each: powers of two and not, with the Nyquist line excited, between the lines, or no line."""


@pytest.mark.parametrize(("repeats", "period"), PERIODS)
@pytest.mark.parametrize("place", [0.001, 0.0093, 0.12345, 0.4993, 0.5])
def test_power_explained_by_a_sinusoid_is_that_of_least_squares(place: float, repeats: int, period: int) -> None:
    """On sampled waves less their mean over the repeats, which shares nothing with the sums in closed form.

    In cycles per sample, from a non-excited line up to the Nyquist frequency, where only the cosine is left.
    """
    recording = recorded(repeats=repeats, period=period)
    n, dt = repeats * period, recording.dt or 1.0
    lines = np.minimum(np.rint(place * n) + np.array([0.0, 0.21, 0.5, 1.0]), n / 2)
    frequencies = lines[lines % repeats != 0] / (n * dt)
    between = NonperiodicResidual(recording, noise(5, n))
    found = between.explained_power(frequencies)
    for frequency, power in zip(frequencies, found, strict=True):
        waves = sinusoids(recording, [frequency])
        waves = waves - recording.averaged(waves)
        residual = between.nonperiodic - waves @ np.linalg.lstsq(waves, between.nonperiodic, rcond=1e-6)[0]
        drop = (between.nonperiodic**2).sum(axis=0) - (residual**2).sum(axis=0)
        np.testing.assert_allclose(power, drop, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("repeats", "period"), PERIODS)
def test_a_sinusoid_at_an_excited_line_explains_nothing_between_the_lines(repeats: int, period: int) -> None:
    """All of it is periodic; what rounding leaves must not be taken for a direction."""
    recording = recorded(repeats=repeats, period=period)
    n = repeats * period
    excited = np.arange(1, period // 2 + 1) / (period * (recording.dt or 1.0))
    assert not NonperiodicResidual(recording, noise(5, n)).explained_power(excited).any()


def test_noise_push_and_drift_are_no_tones() -> None:
    """At 1 in 1000 a record of noise has one; in 20 with probability 2 %."""
    recording = recorded()
    push = np.zeros((SAMPLES, 1))
    push[420:560] = 5.0
    drift = 5 * np.linspace(-1, 1, SAMPLES)[:, None] ** 3
    assert not [seed for seed in range(20) if find_tones(recording, noise(seed))]
    assert find_tones(recording, noise(0) + push) == ()
    assert find_tones(recording, noise(0) + drift) == ()


def test_tones_taken_out_leave_the_noise() -> None:
    recording = recorded()
    tones = [5.13, 17.3]
    loud = noise(1) + 3 * sinusoids(recording, tones).sum(axis=1, keepdims=True)
    left = without_sinusoids(loud, recording, tones)
    # Four sinusoids of 1000 samples take 0.4 % of the noise's power, give or take as much.
    assert left.var(axis=0) == pytest.approx(noise(1).var(axis=0), rel=0.02)


def test_noise_is_the_same_beside_a_tone() -> None:
    """Whose leakage into the neighbouring lines would otherwise be taken for noise, a thousand times as loud."""
    loud, quiet = (fit(planar(RIG), recorded(force)).noise[0] for force in (2.0, 0.0))
    assert len(loud.tones) == 1
    for spectrum, reference in zip(loud.spectra, quiet.spectra, strict=True):
        ratio = spectrum(quiet.frequency) / reference(quiet.frequency)
        # Of a dozen free coefficients each follows some 80 ordinates: a few lines less move it by some per cent.
        assert np.abs(np.log(ratio)).max() < 0.2


def test_search_over_all_frequencies_is_paid_for() -> None:
    """The supremum over frequency of white noise's power exceeds its 5 % limit in 5 % of records, or somewhat less.

    The bound counts crossings from below; the limits are the 0.1 % points of the binomial, for 5 % and for 2 %.
    """
    n, records = 256, 1000
    rows = np.random.default_rng(5).standard_normal((records, n))
    rows -= rows.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(rows, n=16 * n, axis=1)[:, 16:-16]) ** 2 * 2 / n
    supremum = power.max(axis=1)
    p_values = np.array([effective_number_of_frequencies(float(u), n) * chi2.sf(u, 2) for u in supremum])
    alarms = int((p_values < 0.05).sum())
    assert binom.ppf(0.001, records, 0.02) <= alarms <= binom.ppf(0.999, records, 0.05)
