"""Columns that could be either of two things: the tool asks, in one line, and says what each would mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimation.reading.column_map import ColumnMap
from estimation.reading.log_reading import imported
from modeling.errors import InputError
from tests.shared.log_files import CHANNELS, QUATERNION, Frame, original

pytest.importorskip("mujoco")


def written(frame: Frame, folder: Path) -> Path:
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return path


def asked(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        imported(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_two_clocks_in_one_log_that_tell_different_times(tmp_path: Path) -> None:
    """Two stamps that agree to a hundredth are one time."""
    frame = original()
    path = written(frame.assign(timestamp=1.25 * frame["time"]), tmp_path)
    said = asked(path)
    assert "the time could be time (9.996 s, 250 Hz) or timestamp (12.5 s, 200 Hz)" in said
    assert 'time = "time", or "timestamp"' in said
    stated = imported(path, map=ColumnMap.of({"time": "timestamp"})).report
    assert stated.rate == pytest.approx(200.0)
    agreeing = imported(written(frame.assign(timestamp=1.001 * frame["time"] + 7.0), tmp_path)).report
    assert agreeing.rate == pytest.approx(250.0)
    counted = imported(written(frame.assign(t=np.arange(len(frame))), tmp_path)).report
    assert counted.rate == pytest.approx(250.0)


def test_an_order_that_neither_names_nor_weight_decide(tmp_path: Path) -> None:
    """A wrench without weight says nothing of the order; one with it does."""
    frame = original().rename(columns={name: f"quat[{i}]" for i, name in enumerate(QUATERNION)})
    assert imported(written(frame, tmp_path)).report.samples == len(frame)
    noise = np.random.default_rng(0).normal(0, 0.1, (len(frame), 6))
    weightless = frame.assign(**dict(zip(CHANNELS, noise.T, strict=True)))
    path = written(weightless, tmp_path)
    said = asked(path)
    assert "the quaternion quat[0] .. quat[3] could be x y z w (mass 0.0" in said
    assert "or w x y z (mass 0.0" in said
    assert said.count("residual of the weight 0.0") == 2
    assert imported(path, map=ColumnMap.of({"orientation": "xyzw"})).report.samples == len(frame)


def test_small_angles_in_degrees_would_be_fast_radians(tmp_path: Path) -> None:
    """Twelve to either side: below two revolutions, so that their size alone does not tell degrees."""
    time = np.arange(2000) * 0.004
    angles = {f"q{j}": 12 * np.sin(2 * np.pi * 0.37 * time * (1 + 0.3 * j)) for j in (1, 2, 3)}
    wrench = dict(zip(("fx", "fy", "tau"), np.random.default_rng(1).normal(0, 0.1, (3, 2000)), strict=True))
    frame = Frame({"stamp": time, **angles, **wrench})
    path = written(frame, tmp_path)
    said = asked(path)
    assert "could be radians (24" in said
    assert "or degrees (" in said
    found = imported(path, map=ColumnMap.of({"units": {"angle": "deg"}}))
    np.testing.assert_allclose(found.columns["q1"], np.radians(angles["q1"]))
