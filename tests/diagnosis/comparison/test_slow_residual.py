"""The slow residual of a single run: no finding in noise of four kinds, a finding where the zero wanders."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.fft import dct
from scipy.signal import butter, lfilter
from scipy.stats import binom

from diagnosis.comparison.slow_residual import SlowResidual
from diagnosis.comparison.steadiness import FIRST_LINE, ResidualSpectrum, motion_band
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict_rule import RecordVerdict
from modeling.chain.model import planar
from modeling.significance import LEVELS
from tests.shared.noises import NOISES, SEEDS, TAIL, Array, Noise
from tests.shared.recordings import FEW, single_run
from truewrench.simulated_rig import ViscousDrag

UNITS = {"fx": "N", "fy": "N", "tau": "N m"}


def of(seed: int, noise: Noise, slow: float = 0.0, samples: int = 1000) -> SlowResidual:
    """Residual of a rigid tool; in fx the zero wanders by `slow` times the noise."""
    rng = np.random.default_rng(seed)
    residual = np.stack([noise(rng, samples) for _ in range(3)], axis=1) * [0.2, 0.3, 0.02]
    residual[:, 0] += slow * 0.2 * walk(rng, samples)
    return SlowResidual.of_residual("run", residual, UNITS)


def walk(rng: np.random.Generator, samples: int) -> Array:
    steps = np.cumsum(rng.normal(size=samples))
    return np.asarray((steps - steps.mean()) / steps.std())


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("samples", [630, 3000])
def test_noise_is_no_finding(noise: str, samples: int) -> None:
    found = [of(seed, NOISES[noise], samples=samples) for seed in range(SEEDS)]
    assert sum(bool(s.above_noise) for s in found) <= binom.isf(TAIL, SEEDS, LEVELS.effect)
    assert sum(bool(s.significant) for s in found) <= binom.isf(TAIL, SEEDS, LEVELS.effect)


def test_wandering_zero_is_a_finding() -> None:
    """Two and a half times the noise, as public logs have it; a walk in seven is none that is slow."""
    found = [of(seed, NOISES["white"], slow=2.5, samples=3000) for seed in range(SEEDS)]
    named = [s for s in found if s.above_noise == ("fx",)]
    assert len(named) > 0.8 * SEEDS
    assert all(s.wanders for s in named)
    assert all("drift of the zero or slow physics" in s.sentence for s in named)
    assert all(s.rms["fx"] == pytest.approx(0.5, rel=0.3) for s in named)


def test_slow_and_fast_parts_are_the_whole() -> None:
    """Parseval, and a slow cosine is slow."""
    t = (np.arange(2000) + 0.5) / 2000
    residual = np.stack([0.3 * np.cos(3 * np.pi * t), 0.1 * np.cos(500 * np.pi * t), 0 * t], axis=1)
    found = SlowResidual.of_residual("run", residual, UNITS)
    assert found.rms["fx"] == pytest.approx(0.3 / np.sqrt(2))
    assert found.floor["fx"] == pytest.approx(0.0, abs=1e-7)
    assert found.rms["fy"] == pytest.approx(0.0, abs=1e-9)
    assert found.floor["fy"] == pytest.approx(0.1 / np.sqrt(2))


@cache
def diagnosed(drag: float) -> Diagnosis:
    """A single run with a drag, or none, whose zero warms up."""
    clean = single_run(3000, *([ViscousDrag(c=drag, d=0.12)] if drag else []))
    warming = 1 - np.exp(-5 * np.arange(clean.samples) / clean.samples)
    wrench = clean.wrench + np.outer(2.0 * warming, [1, 0, 0])
    return diagnose(planar(clean.rig), clean.with_readings(wrench), effects=FEW)


def low_pass(rng: np.random.Generator, n: int) -> Array:
    """Noise behind a sensor's filter of second order, at a fifth of the sample rate."""
    b, a = butter(2, 0.4)
    return np.asarray(lfilter(b, a, rng.normal(size=n + 100))[100:])


@pytest.mark.parametrize("noise", [*NOISES.values(), low_pass])
@pytest.mark.parametrize("band", [15, 125])
def test_noise_is_no_steep_spectrum(noise: Noise, band: int) -> None:
    rng = np.random.default_rng(band)
    residual = np.stack([noise(rng, 1000) for _ in range(SEEDS)], axis=1)
    p_values = ResidualSpectrum(dct(residual, axis=0, norm="ortho") ** 2, band).steepness_p_values
    assert (p_values < LEVELS.effect).sum() <= binom.isf(TAIL, SEEDS, LEVELS.effect)


def test_spectrum_that_falls_with_the_square_of_frequency_is_at_the_level() -> None:
    """A random walk, the steepest noise: at most the stated share of false alarms, though tested in many octaves."""
    rng = np.random.default_rng(3)
    line = np.maximum(np.arange(2000), 1)[:, None]
    spectrum = ResidualSpectrum(rng.chisquare(1, size=(2000, SEEDS)) / line**2, 250)
    assert (spectrum.steepness_p_values < LEVELS.effect).sum() <= binom.isf(TAIL, SEEDS, LEVELS.effect)


def physics(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """What follows a motion, half a newton over a noise of a fifth, and the readings, both (n, 1)."""
    t = np.arange(n)[:, None] / n
    motion = sum(np.sin(2 * np.pi * k * t + rng.uniform(0, 6)) for k in rng.integers(5, 40, 12))
    return 0.2 * rng.normal(size=(n, 1)) + 1.2 * np.tanh(motion / 4), 9 * np.asarray(motion)


def test_what_follows_the_motion_is_found() -> None:
    rng = np.random.default_rng(4)
    spectra = [ResidualSpectrum.of(*physics(rng, 2000)) for _ in range(20)]
    found = [SlowResidual.of_motion_band("run", s, {"fx": "N"}) for s in spectra]
    named = [f for f in found if f.above_noise == ("fx",)]
    assert len(named) > 10  # a motion of few sines looks like the tones that noise may have
    assert all("in the band of the motion" in f.sentence for f in named)
    assert all(f.floor["fx"] == pytest.approx(0.2, rel=0.15) for f in found)


@pytest.mark.parametrize("noise", NOISES)
def test_noise_of_a_channel_without_a_wrench_is_not_foreign(noise: str) -> None:
    """A channel that reads nothing but noise, however coloured, is no contact."""
    rng = np.random.default_rng(5)
    residual = np.stack([NOISES[noise](rng, 2000) for _ in range(50)], axis=1)
    spectrum = ResidualSpectrum.of(residual, residual)
    found = SlowResidual.of_foreign("run", spectrum, residual.var(axis=0), {str(i): "N" for i in range(50)})
    assert not found.significant


def test_hand_on_the_tool_is_foreign() -> None:
    """A push of 15 N over most of the run, in a channel that otherwise reads a weight of 5 N that turns."""
    rng, t = np.random.default_rng(6), np.arange(2000)[:, None]
    weight, push = 5 * np.sin(t / 60), 15.0 * (np.sin(2 * np.pi * t / 700) > -0.6)
    residual = push - push.mean() + 0.1 * rng.normal(size=t.shape)
    found = SlowResidual.of_foreign(
        "run", ResidualSpectrum.of(residual, weight), (weight + residual).var(axis=0), {"fz": "N"}
    )
    assert found.above_noise == ("fz",)
    assert not found.wanders
    assert "contact, another load, a disturbance" in found.sentence


def test_band_of_the_motion() -> None:
    """Of sines, their frequencies; of a motion that fills all lines, the part that leaves enough for the noise."""
    t = (np.arange(4000) + 0.5) / 4000
    assert motion_band(np.stack([np.cos(40 * np.pi * t), 3 * np.cos(7 * np.pi * t)], axis=1)) == 40
    assert motion_band(np.random.default_rng(0).normal(size=(4000, 2))) == 500


def test_more_certain_part_of_each_channel() -> None:
    slowest = of(0, NOISES["white"], slow=5.0)
    spectrum = ResidualSpectrum(np.full((1000, 3), 0.01), 100)
    both = slowest.or_else(SlowResidual.of_motion_band("run", spectrum, UNITS))
    assert both.rms["fx"] == slowest.rms["fx"]
    assert both.p_value["fx"] == min(1.0, 2 * slowest.p_value["fx"])
    assert "drift of the zero or slow physics" in both.sentence
    assert FIRST_LINE > 4  # the lowest lines are those of the slowest part


def test_it_is_never_nothing_missing() -> None:
    found = diagnosed(0.0)
    assert found.verdict is RecordVerdict.UNEXPLAINED
    assert found.unexplained is not None
    assert "a slow change remains on run.csv: fx" in found.unexplained.where
    assert found.to_data()["slow_residual"][0]["misfit"]


def test_what_is_sure_beside_it_is_partly_explained() -> None:
    found = diagnosed(0.3)
    assert found.verdict is RecordVerdict.PARTLY_EXPLAINED
    assert found.added == ("viscous_drag",)
