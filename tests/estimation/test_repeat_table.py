"""Table 22.1 of any repeated recording: the chapter's own figures, noise whose truth is known, and the simulated rig.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.coverage import NOISES, RIGS, Setting, silent_recording
from estimation.fit import fit
from estimation.model_response import predicted_readings
from estimation.noise.power_spectrum import PowerSpectrum
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.column_table import signal_unit
from estimation.recordings.reading import from_columns
from estimation.repeat_table import RepeatTable, VarianceComponents, averaging_noise_gains
from modeling.chain.model import planar
from modeling.errors import InputError
from modeling.noise import NoiseModel, NoiseSource
from modeling.space import Space
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]


# -------------------------------------------------------------------------------------- the chapter's


@pytest.mark.parametrize(
    ("single", "average", "noise", "remainder", "error"),
    [(0.6705, 0.037, 0.655, 0.123, 0.005), (2.654, 0.110, 2.632, 0.149, 0.018)],
)
def test_erratum_6_from_the_printed_variances(
    single: float, average: float, noise: float, remainder: float, error: float
) -> None:
    """Noise and remainder to the digits printed. Their errors ask for the number of samples, which is not given: of
    some hundred to some thousand samples (a period of seconds) they come out as printed within a factor of two."""
    found = VarianceComponents.printed(single, average, 30, samples=1000)
    assert round(found.noise**2, 3) == noise
    assert round(found.remainder, 3) == remainder
    assert error / 2 < found.remainder_std < 2 * error
    low, high = found.interval()
    assert 0 < low < remainder < high
    # Thirty runs of independent noise alone would have gained 30.
    assert found.gain == pytest.approx(single / average)
    assert found.gain < 25


def test_variances_that_no_runs_have_are_refused() -> None:
    with pytest.raises(InputError, match="do not have an average"):
        VarianceComponents.printed(0.1, 0.2, 30, samples=100)
    with pytest.raises(InputError):
        VarianceComponents.printed(0.2, 0.1, 1, samples=100)


# ------------------------------------------------------------------------------ known noise and remainder


def drawn(rng: np.random.Generator, noise: simulated.NoiseModel, runs: int, samples: int, remainder: Array) -> Array:
    """Errors (R, N) of separate runs."""
    return remainder + np.stack([noise.draw(rng, samples, 1)[:, 0] for _ in range(runs)])


@pytest.mark.parametrize(("runs", "samples"), [(5, 40), (2, 41)])
def test_the_remainders_square_is_the_mean_product_of_different_runs(runs: int, samples: int) -> None:
    errors = np.random.default_rng(0).standard_normal((runs, samples))
    found = VarianceComponents.of(errors)
    inner = errors - errors.mean(axis=1, keepdims=True)
    products = [(inner[a] * inner[b]).mean() for a in range(runs) for b in range(runs) if a != b]
    assert found.square == pytest.approx(np.mean(products), rel=1e-10)
    assert found.noise**2 == pytest.approx(inner.var(axis=0, ddof=1).mean(), rel=1e-10)


@pytest.mark.parametrize("name", ["white", "AR 0.95"])
@pytest.mark.parametrize("size", [0.0, 0.3])
def test_square_and_its_error_are_unbiased_whatever_the_colour(name: str, size: float) -> None:
    """Of 400 tables: the mean within 4.5 of its sigma; a variance of 400 is known to 7 to 20 % (heavy tails of squares
    of slow noise), and the lines of a run that does not close on itself are not quite independent."""
    rng, n = np.random.default_rng(1), 60
    remainder = size * np.sqrt(2) * np.sin(2 * np.pi * 2 * np.arange(n) / n)
    found = [VarianceComponents.of(drawn(rng, NOISES[name], 4, n, remainder)) for _ in range(400)]
    squares = np.array([f.square for f in found])
    assert abs(squares.mean() - size**2) < 4.5 * squares.std() / 20
    stated = np.mean([f.square_variance for f in found])
    assert 0.65 < stated / squares.var() < 1.5
    covered = np.mean([f.interval()[0] <= size <= f.interval()[1] for f in found])
    # 380 of 400 and a sixtieth: 95 % needs a normal square; of slow noise in 60 samples it is a skew one.
    assert 0.87 < covered <= 1.0


def test_runs_that_are_all_the_same_gain_nothing() -> None:
    run = np.random.default_rng(0).standard_normal(50)
    found = VarianceComponents.of(np.stack([run] * 6))
    assert found.gain == pytest.approx(1.0)
    assert found.noise == pytest.approx(0.0, abs=1e-7)  # root of rounding
    assert found.remainder == pytest.approx(run.std())
    silent = VarianceComponents.of(np.zeros((3, 20)))
    assert (silent.gain, silent.remainder) == (1.0, 0.0)
    assert silent.remainder_std == pytest.approx(0.0, abs=1e-100)


@dataclass(frozen=True, eq=False)
class KnownSpectrum(PowerSpectrum):
    """Of x_t = rho x_(t-1) + e_t with unit variance, sampled every `dt` s."""

    rho: float = 0.0
    dt: float = 1.0

    def __call__(self, frequency: Array) -> Array:
        turn = np.exp(-2j * np.pi * frequency * self.dt)
        return np.asarray((1 - self.rho**2) / np.abs(1 - self.rho * turn) ** 2)


@pytest.mark.parametrize("rho", [0.0, 0.98])
def test_noise_gain_is_what_averaging_brings_to_noise_of_that_spectrum(rho: float) -> None:
    """400 records of 4 repeats; means of V1 and VR err by some 3 % for slow noise, 12 % are four sigma of the ratio."""
    recording = silent_recording(Setting(repeats=4, samples=60))
    assert recording.dt is not None
    empty = np.zeros(0)
    spectrum = KnownSpectrum(empty, empty, empty, np.zeros(0, dtype=bool), 0.0, 0.0, rho=rho, dt=recording.dt)
    whitener = AutoregressiveWhitener(240, NoiseModel.white(np.ones(3)))
    noise = RecordingNoise(np.ones(3), whitener, NoiseSource.REPEATS, empty, (spectrum,) * 3)
    gains = averaging_noise_gains(recording, noise)
    rng, model = np.random.default_rng(2), simulated.AutoregressiveNoise(rho=rho)
    found = [VarianceComponents.of(model.draw(rng, 240, 1).reshape(4, 60)) for _ in range(400)]
    expected = np.mean([f.single for f in found]) / np.mean([f.average for f in found])
    assert gains == [pytest.approx(expected, rel=0.12)] * 3
    if rho == 0:
        assert gains[0] == pytest.approx(4.0, rel=0.02)  # a run's own mean takes a 60th of one, a 60th of the other


# ------------------------------------------------------------------------------------- simulated rig


TIED = Setting(samples=100, hidden=(simulated.CableSpring(k=20.0, anchor=(1.0, 0.0, 3.0), length=1.2),))
FREE = Setting(samples=100)


def test_the_remainder_of_a_hidden_tether_is_what_the_model_really_misses() -> None:
    """The truth is the noise-free recording less the prediction; within 4.5 standard errors, 1 in 5e4 for three."""
    estimated = fit(planar(), TIED.drawn(NOISES["white"], 1))
    silent = silent_recording(TIED)
    missed = (silent.wrench - predicted_readings(estimated.model, silent, estimated.theta)).std(axis=0)
    for row, truth in zip(RepeatTable.of(estimated).readings, missed, strict=True):
        assert abs(row.averaging.remainder - truth) < 4.5 * row.averaging.remainder_std
        assert row.averaging.remainder > 20 * row.averaging.remainder_std
        assert row.averaging.gain < 2
    noises = [row.averaging.noise for row in RepeatTable.of(estimated).readings]
    np.testing.assert_allclose(noises, RIGS[Space.PLANE].noise, rtol=0.12)  # 700 degrees of freedom: 4.5 times 2.7 %


def test_nothing_hidden_leaves_nothing_and_gains_the_repeats() -> None:
    found = RepeatTable.of(fit(planar(), FREE.drawn(NOISES["white"], 3)))
    for row in found.readings:
        assert abs(row.averaging.square) < 4.5 * np.sqrt(row.averaging.square_variance)
        # 100 samples of the average: its variance errs by 14 %, and the fit takes 2 % of it.
        assert row.averaging.gain == pytest.approx(8.0, rel=4.5 * 0.14)
        assert row.noise_gain == pytest.approx(8.0, rel=0.05)
    assert not found.remarks()


def test_coloured_noise_is_said_to_average_otherwise() -> None:
    found = RepeatTable.of(fit(planar(), FREE.drawn(NOISES["AR 0.98"], 1)))
    assert any("coloured" in remark for remark in found.remarks())
    assert found.remarks()[-1] in str(found)


def test_resolver_steps_do_not_average_out_and_noise_of_the_motion_does() -> None:
    """Steps repeat with the motion: gain 1. Noise of the angle differs: its gain is that of 8 runs, less the part of
    the average that the smooth motion takes up as its own (at most one in four lines of 100)."""
    rig = simulated.PlanarRig(resolver_step=1e-3)
    frame = simulated.simulate(rig, rig.random_motion(seed=5), repeats=8, samples_per_period=100, seed=1)
    columns = {str(n): frame[n].to_numpy(dtype=float) for n in frame if n != "temperature"}
    jitter = 1e-2 * np.random.default_rng(0).standard_normal(800)
    recording = from_columns(columns | {"q3": columns["q3"] + jitter}, rig=silent_recording(FREE).rig)
    motion = {row.name: row for row in RepeatTable.of(fit(planar(), recording)).motion}
    assert set(motion) == {"q1", "q2", "q3"}
    assert motion["q1"].unit == "rad"
    assert motion["q1"].averaging.gain == pytest.approx(1.0, abs=1e-6)
    # A step's std is 1e-3 / sqrt(12); a third is left for what smoothing takes.
    assert motion["q1"].averaging.remainder == pytest.approx(1e-3 / np.sqrt(12), rel=0.35)
    assert 5.5 < motion["q3"].averaging.gain < 13
    assert motion["q3"].averaging.noise == pytest.approx(1e-2, rel=0.12)  # 700 degrees of freedom


def test_validation_shows_a_zero_that_moved() -> None:
    estimated = fit(planar(), FREE.drawn(NOISES["white"], 1))
    other = FREE.drawn(NOISES["white"], 2)
    shifted = replace(other.with_readings(other.wrench + np.array([0.5, 0.0, 0.0])), name="next day")
    found = RepeatTable.of(estimated, validation=[shifted])
    fx = found.validation[0]
    assert (fx.recording, fx.channel, fx.unit) == ("next day", "fx", "N")
    # 800 samples of 0.15 N: 0.005, and the training's zero once more.
    assert fx.mean == pytest.approx(0.5, abs=4.5 * 0.0075)
    assert fx.variance == pytest.approx(0.15**2, rel=4.5 * 0.05)
    assert any(line.startswith("next day") for line in str(found).splitlines())


def test_data_of_the_table_are_json() -> None:
    found = RepeatTable.of(fit(planar(), FREE.drawn(NOISES["white"], 1)), validation=[FREE.drawn(NOISES["white"], 2)])
    data = json.loads(json.dumps(found.to_data(), allow_nan=False))
    assert [row["name"] for row in data["readings"]] == ["fx", "fy", "tau"]
    assert len(data["readings"][0]["variance_of_run"]) == 8
    assert np.mean(data["readings"][0]["variance_of_run"]) == pytest.approx(data["readings"][0]["variance_of_runs"])
    assert len(data["validation"]) == 3


def test_a_single_run_has_no_table() -> None:
    with pytest.raises(InputError, match="ran once"):
        RepeatTable.of(fit(planar(), Setting(repeats=1, samples=100).drawn(NOISES["white"], 1)))


@pytest.mark.parametrize(
    ("column", "unit"),
    [("q1", "rad"), ("dq2", "rad/s"), ("ddq1", "rad/s²"), ("phi", "rad"), ("dphi", "rad/s"), ("ddphi", "rad/s²"),
     ("px", "m"), ("vx", "m/s"), ("vpx", "m/s"), ("ax", "m/s²"), ("apz", "m/s²"), ("wx", "rad/s"), ("alz", "rad/s²"),
     ("qw", "1")],
)  # fmt: skip
def test_columns_of_a_motion_have_units(column: str, unit: str) -> None:
    assert (signal_unit(column) or "1") == unit
