"""Every format, written by its own library from one simulated run, is that run again when it is imported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import estimation.reading.log_sources  # noqa: F401  # registers every reader
from estimation.reading.log_reader import LogReader
from estimation.reading.log_reading import imported, read
from estimation.recordings.reading_report import StepKind
from tests.shared.log_files import CHANNELS, FORMATS, POSITION, QUATERNION, Frame, original, plotjuggler, poses_at

pytest.importorskip("mujoco")

ROWS = {"excel": 300, "xz": 300}
"""Fewer rows of formats that are slow to write."""
MENDED = {"bota": "doubled rows"}
"""What has to be mended in a format as it is met."""


def frame_for(name: str) -> Frame:
    return original().iloc[: ROWS.get(name, 1000)]


@pytest.mark.parametrize("name", FORMATS)
def test_the_recording_comes_back(name: str, tmp_path: Path) -> None:
    frame = frame_for(name)
    sources = FORMATS[name](frame, tmp_path)
    found = imported(*sources)
    assert found.report.samples == len(frame)
    # Twelve printed digits at worst, and stamps of 0.24 µs since 1970 in a column of seconds.
    for column in (*CHANNELS, *POSITION):
        np.testing.assert_allclose(found.columns[column], frame[column], rtol=0, atol=1e-6)
    turned = np.stack([found.columns[column] for column in QUATERNION], axis=1)
    cosine = np.abs(np.sum(turned * frame[QUATERNION].to_numpy(), axis=1))
    np.testing.assert_allclose(cosine, 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.columns["time"], frame["time"], rtol=0, atol=1e-6)
    mended = [step.what for step in found.report.of(StepKind.MENDED)]
    assert len(mended) == (name in MENDED)
    assert all(MENDED[name] in what for what in mended)


@pytest.mark.parametrize("name", ["semicolons", "ur_rtde", "franka hdf5", "rostopic echo -p"])
def test_the_python_call_reads_the_same(name: str, tmp_path: Path) -> None:
    sources = FORMATS[name](frame_for(name), tmp_path)
    recording, table = read(*sources), imported(*sources)
    assert recording.reading is not None
    assert recording.reading.to_data() == table.report.to_data()
    np.testing.assert_array_equal(recording.wrench[:, 2], table.columns["fz"])
    data = json.dumps(recording.reading.to_data(), allow_nan=False)
    assert json.loads(data)["recording"]["samples"] == 1000
    assert sources[0].name in str(recording.reading)


def test_topics_of_one_table_are_put_on_one_clock(tmp_path: Path) -> None:
    """PlotJuggler's rows alternate between topics; the pose was sampled 1 ms after the wrench."""
    frame = original()
    found = imported(*plotjuggler(frame, tmp_path))
    start = round(found.columns["time"][0])
    rows = slice(start + 1, start + 1 + found.report.samples)  # the first wrench is before the first pose
    np.testing.assert_allclose(found.columns["fx"], frame["fx"][rows], rtol=0, atol=1e-12)
    expected = poses_at(frame, frame["time"].to_numpy()[rows])
    # Positions in steps of 1 µm, of which a cubic spline makes at most 1.5; the last samples are beyond its last knot.
    np.testing.assert_allclose(found.columns["px"][:-1], expected["px"][:-1], rtol=0, atol=2e-6)


def test_compensated_and_base_axes_are_said(tmp_path: Path) -> None:
    report = imported(*FORMATS["ur_rtde"](frame_for("ur_rtde"), tmp_path)).report
    assert any("payload" in step.what for step in report.of(StepKind.SUSPICIOUS))
    assert "base axes" in str(report)
    assert any("duplicated" in step.what for step in report.steps)


def test_receive_stamps_of_bags_are_reported(tmp_path: Path) -> None:
    report = imported(*FORMATS["ros 2 bag mcap"](original().iloc[:500], tmp_path)).report
    assert any("received 4 ms later" in step.what for step in report.steps)
    assert any("received 9 ms later" in step.what for step in report.steps)


def test_every_reader_has_a_format_here() -> None:
    """A new reader comes with a case in `FORMATS`, and its name here."""
    kinds = {type(reader).__name__ for reader in (member() for member in LogReader.members)}
    assert kinds == {"DelimitedText", "Excel", "Hdf5", "Matlab", "NumpyArrays", "Parquet", "RosBag"}
