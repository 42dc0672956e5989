"""Every format, written by its own library from one simulated run, is that run again when it is imported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import estimation.reading.log_sources  # noqa: F401  # registers every reader
from estimation.reading.log_reader import LogReader, SourceFile, tables_of
from estimation.reading.log_reading import imported, read, read_with_rig
from estimation.recordings.reading_report import StepKind
from modeling.errors import InputError
from tests.shared.log_files import (
    CHANNELS,
    FORMATS,
    POSITION,
    QUATERNION,
    Frame,
    lerobot_data_set,
    original,
    plotjuggler,
    poses_at,
)

pytest.importorskip("mujoco")

ROWS = {"excel": 300, "xz": 300}
"""Fewer rows of formats that are slow to write."""
MENDED = {"bota": ["doubled rows"]} | {
    controller: ["taken as degrees", "as millimetres"] for controller in ("kuka", "fanuc", "xarm")
}
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
    expected = MENDED.get(name, [])
    assert len(mended) == len(expected)
    assert all(said in what for said, what in zip(expected, mended, strict=True))


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
    assert kinds == {"DelimitedText", "Excel", "Hdf5", "LeRobot", "Matlab", "NumpyArrays", "Parquet", "RosBag"}


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_an_episode_of_a_data_set_is_named(version: str, tmp_path: Path) -> None:
    """A data set of one is that recording; of several one is asked for, by names that can be given."""
    frame = frame_for("lerobot")
    alone = lerobot_data_set(frame, tmp_path / "alone", version)
    assert read_with_rig(alone, rig=None).reading is not None
    several = lerobot_data_set(frame, tmp_path / "several", version, episodes=3)
    with pytest.raises(InputError, match=r"3 episodes, each a recording; give one: .*several/episode_000000, "):
        imported(several)
    with pytest.raises(InputError, match="there is no episode 7; give one: "):
        imported(several / "episode_000007")
    np.testing.assert_allclose(read_with_rig(several / "episode_000001", rig=None).wrench, frame[CHANNELS], atol=1e-12)


def test_lists_without_names_are_given_by_a_map(tmp_path: Path) -> None:
    frame = frame_for("lerobot")
    folder = lerobot_data_set(frame, tmp_path / "data_set", "v3.0", named=False)
    with pytest.raises(InputError, match=r"among observation.state\[0\], .*name its columns in a map"):
        imported(folder)
    stated = {name: f"observation.state[{place}]" for place, name in enumerate([*POSITION, *QUATERNION])}
    path = tmp_path / "map.toml"
    path.write_text("".join(f'{name} = "{column}"\n' for name, column in stated.items()), encoding="utf-8")
    found = imported(folder, map=path)
    for column in (*CHANNELS, *POSITION):
        np.testing.assert_allclose(found.columns[column], frame[column], rtol=0, atol=1e-12)


def test_a_column_of_lists_of_unequal_lengths_is_no_numbers(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"v": [[1.0, 2.0], None, [3.0, 4.0]], "ragged": [[1.0], [2.0, 3.0], []]}), path)
    (table,) = tables_of(SourceFile(path))
    np.testing.assert_array_equal(table.columns["v[1]"], [2.0, np.nan, 4.0])
    assert list(table.texts) == ["ragged"]


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"features": {"v": 3}}'])
def test_a_broken_description_is_one_line(text: str, tmp_path: Path) -> None:
    folder = lerobot_data_set(frame_for("lerobot"), tmp_path / "data_set", "v3.0")
    (folder / "meta" / "info.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read as LeRobot data set"):
        imported(folder)
