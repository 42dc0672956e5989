"""Calibration of one recording: surrogates have its noise, rates are exact, what is hidden at ten times is found."""

from __future__ import annotations

import json
import os
import signal
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import binom, binomtest

from diagnosis.calibrate import calibrate, results_of, surrogate_noise
from diagnosis.calibration import Calibration, Rate
from diagnosis.diagnosis import diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.effects import named
from modeling.errors import InputError
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.command_line import main
from truewrench.files.calibration_file import read_calibration, write_calibration
from truewrench.simulated_rig import PlanarRig, ViscousDrag, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
CANDIDATES = [named("viscous_drag"), named("sensor_lag"), named("gravity_tilt")]
MIXED = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [-0.3, 0.1, 0.2]])


def coloured(n: int, seed: int) -> Array:
    """Autoregressive noise (n, 3) with coherent channels."""
    white = np.random.default_rng(seed).normal(size=(n, 3)) @ MIXED.T
    return np.asarray(lfilter([1.0], [1, -0.8], white, axis=0))


@cache
def recording(repeats: int) -> Recording:
    hidden = (ViscousDrag(c=0.15, d=0.12),)
    motion = PlanarRig().random_motion(seed=5)
    frame = simulate(PlanarRig(), motion, hidden=hidden, repeats=repeats, samples_per_period=500, seed=5)
    return recording_of(frame, without=() if repeats > 1 else ("repeat",), name="run.csv", rig=RIG)


# ------------------------------------------------------------------------------------------ surrogates


@pytest.mark.parametrize("repeats", [1, 4])
def test_surrogates_have_the_covariance_of_the_noise_at_every_lag(repeats: int) -> None:
    """Over 200 surrogates the average of a lagged covariance is within a tenth of the noise's own scale."""
    whole = recording(repeats)
    noise = coloured(whole.samples, 3)
    rng = np.random.default_rng(4)
    for lag in (0, 1, 5):
        wanted = noise[: len(noise) - lag].T @ noise[lag:] / len(noise)
        found = np.zeros((3, 3))
        for _ in range(200):
            drawn = surrogate_noise(whole, noise, rng)
            found += drawn[: len(drawn) - lag].T @ drawn[lag:] / len(drawn) / 200
        scale = noise.std(axis=0)
        np.testing.assert_allclose(found / np.outer(scale, scale), wanted / np.outer(scale, scale), atol=0.1)


@pytest.mark.parametrize("continuous", [True, False])
def test_what_repeats_with_the_motion_is_not_noise(continuous: bool) -> None:
    whole = recording(4).moved(continuous=continuous)
    period = np.sin(2 * np.pi * np.arange(whole.samples_per_repeat) / 40)
    repeated = 1e3 * np.tile(period, whole.repeats)[:, None] * np.ones(3)
    noise = coloured(whole.samples, 3)
    drawn = surrogate_noise(whole, repeated + noise, np.random.default_rng(1))
    assert drawn.std() < 2 * noise.std()


@given(st.integers(2, 400), st.integers(0, 2**32 - 1))
def test_a_surrogate_is_finite_and_has_no_mean(samples: int, seed: int) -> None:
    """A mean is a bias, which a fit takes away."""
    residual = np.random.default_rng(seed).normal(size=(samples, 3))
    drawn = surrogate_noise(recording(1), residual, np.random.default_rng(seed))
    assert np.isfinite(drawn).all()
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=1e-12)


# ------------------------------------------------------------------------------------------ rates


@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_intervals_are_those_of_clopper_and_pearson(drawn: tuple[int, int]) -> None:
    count, total = drawn
    wanted = binomtest(count, total).proportion_ci(confidence_level=0.95, method="exact")
    np.testing.assert_allclose(Rate(count, total).interval, (wanted.low, wanted.high), atol=1e-9)


@pytest.mark.parametrize(("count", "exceeds"), [(0, False), (5, False), (6, True), (30, True)])
def test_more_alarms_than_twice_the_level_are_shown_by_the_binomial_test(count: int, exceeds: bool) -> None:
    assert Rate(count, 100).exceeds(0.02) == exceeds == (binom.sf(count - 1, 100, 0.02) < 0.05)


# ------------------------------------------------------------------------------------------ calibrations


@cache
def calibrated(repeats: int, workers: int = 1) -> Calibration:
    return calibrate(
        planar(RIG), recording(repeats), effects=CANDIDATES, draws=12, power_draws=3, workers=workers, seed=1
    )


@pytest.mark.parametrize("repeats", [pytest.param(1, marks=pytest.mark.long), 4])
def test_no_more_alarms_than_stated(repeats: int) -> None:
    """Three or more of 12 at 1 % have a probability of 2e-4."""
    found = calibrated(repeats)
    assert found.model == ("viscous_drag",)
    assert found.alarms.total == 12
    assert found.alarms.count < 3
    assert found.holds
    assert {p.effect for p in found.power} == {"sensor_lag", "gravity_tilt"}


def test_the_number_of_workers_changes_nothing() -> None:
    assert calibrated(4, workers=2).to_data() == calibrated(4).to_data()


@pytest.mark.parametrize("workers", [1, 2, 30])
def test_processes_give_what_one_gives_in_its_order(workers: int) -> None:
    """Of work that cannot be pickled, too: an effect may be a class within a function."""
    begun: list[tuple[int, int]] = []
    found = results_of(lambda number: number**2, range(20), workers, lambda *count: begun.append(count))
    assert found == [number**2 for number in range(20)]
    assert begun == [(number, 20) for number in range(20)]


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked under Linux alone")
def test_a_killed_worker_is_said() -> None:
    with pytest.raises(InputError, match="a worker was killed"):
        results_of(lambda number: os.kill(os.getpid(), signal.SIGKILL), range(2), 2, lambda *_count: None)


def test_p_values_are_withheld_where_false_alarms_are_too_many() -> None:
    whole = recording(4)
    found = diagnose(planar(RIG), whole, effects=CANDIDATES)
    bad = replace(calibrated(4), alarms=Rate(6, 100), named={"sensor_lag": 6})
    withheld = found.calibrated(bad)
    assert not bad.holds
    assert withheld.to_data()["lack_of_fit_p"] is None
    assert all(f.p_value is None for f in withheld.findings)
    same = found.calibrated(calibrated(4))
    assert same.findings == found.findings
    assert same.calibration_sentences == calibrated(4).sentences
    wider = found.calibrated(replace(calibrated(4), candidates=("viscous_drag", "sensor_lag", "sensor_gain")))
    assert "made with 3 candidate effects, and this diagnosis has" in wider.calibration_sentences[-1]
    with pytest.raises(InputError, match="other readings"):
        diagnose(planar(RIG), whole.with_readings(whole.wrench + 1e-3), effects=CANDIDATES).calibrated(bad)


@pytest.mark.parametrize("counts", [(0, 0), (-1, 0), (4, -1)])
def test_surrogates_are_counted_from_one(counts: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="no calibration"):
        calibrate(planar(RIG), recording(1), draws=counts[0], power_draws=counts[1])


# ------------------------------------------------------------------------------------------ files


def test_a_calibration_comes_back_from_its_file(tmp_path: Path) -> None:
    found, path = calibrated(4), tmp_path / "calibration.json"
    write_calibration(found, path)
    assert read_calibration(path).to_data() == found.to_data()
    assert read_calibration(path).verdict is RecordVerdict.EXPLAINED


@pytest.mark.parametrize("text", ["", "[]", "{", '{"recording": 3}', "NaN"])
def test_another_file_is_refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "calibration.json", tmp_path / "out"
    path.write_text(text)
    data = Path(__file__).parent / "no.csv"
    with pytest.raises(InputError, match="calibrate"):
        read_calibration(path)
    assert main(["diagnose", str(data), "--calibration", str(path), "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not out.exists()


def test_the_data_are_json() -> None:
    assert json.loads(json.dumps(calibrated(4).to_data(), allow_nan=False))["holds"] is True
