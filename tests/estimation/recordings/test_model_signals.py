"""Signals of a model: auxiliary ones are smoothed, only those that are used, and once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.recordings import motion as module
from estimation.recordings.differentiation import Derivatives, spline_derivatives
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording

Array = NDArray[np.float64]

SAMPLES, STEP = 400, 0.01


def warming() -> Recording:
    """A planar motion, a noisy temperature and a voltage that stays as it is."""
    rng = np.random.default_rng(0)
    time = STEP * np.arange(SAMPLES, dtype=np.float64)
    columns = {name: np.sin(3 * time) for name in ("phi", "dphi", "ddphi", "ax", "ay", "fx", "fy", "tau")}
    temperature = 20 + time / 4 + 0.01 * rng.standard_normal(SAMPLES)
    return from_columns(columns | {"time": time, "temperature": temperature, "voltage": np.full(SAMPLES, 24.0)})


@pytest.fixture
def smoothed(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """The series that were smoothed."""
    found: list[Array] = []

    def smooth(series: Array, *options: Any) -> Derivatives:
        found.append(series[:, 0])
        return spline_derivatives(series, *options)

    monkeypatch.setattr(module, "spline_derivatives", smooth)
    return found


def test_an_auxiliary_signal_is_smoothed_once_and_with_its_first_use(smoothed: list[Array]) -> None:
    recording = warming()
    signals = recording.motion.model_signals
    smoothed.clear()  # of the motion itself
    assert [*signals] == [*recording.signals, "progress"]
    assert len(signals) == len(recording.signals) + 1
    assert "temperature" in signals
    assert "humidity" not in signals
    np.testing.assert_array_equal(signals["phi"], recording.signals["phi"])
    np.testing.assert_array_equal(signals["voltage"], 24.0)
    np.testing.assert_array_equal(signals["progress"], np.linspace(-1, 1, SAMPLES))
    assert not smoothed
    first, again = signals["temperature"], recording.motion.model_signals["temperature"]
    assert again is first
    (series,) = smoothed
    np.testing.assert_array_equal(series, recording.columns["temperature"])
    np.testing.assert_array_equal(first, spline_derivatives(series[:, None], STEP).value[:, 0])
    with pytest.raises(KeyError, match="humidity"):
        signals["humidity"]


def test_static_poses_have_nothing_to_smooth(smoothed: list[Array]) -> None:
    poses = warming().moved(time=None)
    assert poses.dt is None
    np.testing.assert_array_equal(poses.motion.model_signals["temperature"], poses.columns["temperature"])
    assert not smoothed
