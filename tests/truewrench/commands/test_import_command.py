"""`truewrench import`, and from raw files to the right verdict in two commands, or two Python calls."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import truewrench as tw
from estimation.reading import delimited_text
from modeling.effects import named
from modeling.rig import Convention, Rig
from tests.shared.log_files import (
    CHANNELS,
    DRAG,
    FORMATS,
    POSITION,
    QUATERNION,
    Writer,
    headerless,
    original,
    plotjuggler,
    two_clocks,
)
from truewrench.command_line import main
from truewrench.commands import import_recording
from truewrench.simulated_rig import HiddenEffect, SpatialRig, ViscousDrag, simulate

pytest.importorskip("mujoco")


def part() -> pd.DataFrame:
    """The first 4 s of the run: where no motion is fitted and no offset estimated, they are enough."""
    return original().iloc[:1000]


def run(capsys: pytest.CaptureFixture[str], *argv: str | Path) -> tuple[int, str, str]:
    code = main([str(argument) for argument in argv])
    return code, *capsys.readouterr()


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_recording_that_it_writes_is_read(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = part()
    out = tmp_path / f"run{suffix}"
    code, text, _ = run(capsys, "import", *FORMATS["ur_rtde"](frame, tmp_path), "--out", out)
    assert code == 0
    assert text.startswith("Recording: 1000 samples, 4 s at 250 Hz")
    assert text.endswith(f"Written: {out}\nNext: truewrench diagnose {out}\n")
    recording = tw.read(out)
    assert recording.reading is None  # a recording as it stands
    np.testing.assert_allclose(recording.wrench, frame[CHANNELS], atol=1e-9)


def test_without_pyarrow_no_parquet_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = FORMATS["semicolons"](part(), tmp_path)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    code, text, error = run(capsys, "import", *files, "--out", tmp_path / "run.parquet")
    assert (code, text, error.count("\n")) == (2, "", 1)
    assert 'pip install "truewrench[logs]"' in error


def test_json_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, text, _ = run(capsys, "import", *two_clocks(original(), tmp_path), "--json")
    data = json.loads(text)
    assert code == 0
    assert data["offset"]["applied"]
    assert data["offset"]["interval"][0] < 0.037 < data["offset"]["interval"][1]
    assert {"kind": "mended", "count": 3, "total": 2500}.items() <= data["steps"][3].items() or any(
        step["kind"] == "mended" and step["count"] == 3 for step in data["steps"]
    )


def test_strict_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.csv"
    sources = two_clocks(original(), tmp_path)
    code, text, error = run(capsys, "import", *sources, "--strict", "--out", out)
    assert (code, text) == (2, "")
    assert "missing samples interpolated (3 of 2500)" in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_options_and_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = FORMATS["semicolons"](part(), tmp_path)[0]
    for argv, message in (
        (["--preset", "kuka"], "use one of ur_rtde"),
        (["--map", tmp_path / "none.toml"], "No such file"),
        (["--period", "-1"], "invalid positive value"),
        (["--period", "0"], "invalid positive value"),
        (["--period", "nan"], "invalid positive value"),
        (["--clock-offset", "nan"], "invalid finite value"),
        (["--period", "3", "--no-period"], "not allowed with"),
        (["--period", "70"], "give the period of a motion that ran at least twice"),
        (["--rig", tmp_path / "none.toml"], "No such file"),
        (["--out", source / "x.csv"], "is not a folder"),
        (["--out", tmp_path / "run.xyz"], "not written as '.xyz'; give --out a name with one of .csv, .parquet, .pq"),
        (["--out", tmp_path / "run"], "its suffix names no format"),
        (["--preset", "franka"], "the preset franka"),
        (["--out", tmp_path / "." / source.name], "would replace"),
    ):
        code, text, error = run(capsys, "import", source, *argv)
        assert (code, text) == (2, "")
        assert message in error
        assert error.count("\n") == 1


def test_a_period_that_the_motion_does_not_have_is_suspicious(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One period of a random motion, cut into three; two periods of it, cut in the middle, are no suspicion."""
    frame = original().iloc[::5]
    twice = pd.concat([frame, frame], ignore_index=True)
    twice["time"] = np.arange(len(twice)) * 0.02
    for name, logged, period, is_suspicious in (("one", frame, "3.33", True), ("two", twice, "10", False)):
        source = tmp_path / f"{name}.csv"
        logged.to_csv(source, index=False)
        code, text, _ = run(capsys, "import", source, "--period", period)
        assert code == 0
        assert (f"the motion does not repeat with a period of {period} s" in text) == is_suspicious


def test_no_period_makes_one_run_of_what_a_column_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "counted.csv"
    part().assign(repeat=np.repeat([0, 1], 500)).to_csv(source, index=False)
    _, counted, _ = run(capsys, "import", source)
    _, one_run, _ = run(capsys, "import", source, "--no-period")
    assert "repeat" in counted.splitlines()[0]
    assert "repeat" not in one_run.splitlines()[0]
    assert "column repeat is left out: one run, as stated" in one_run


def test_nothing_is_written_without_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = FORMATS["semicolons"](part(), tmp_path)[0]
    code, text, _ = run(capsys, "import", source)
    assert code == 0
    assert "Nothing is written without --out" in text
    assert [path.name for path in tmp_path.iterdir()] == [source.name]


def test_a_recording_of_formats_is_held_to_it(tmp_path: Path) -> None:
    """`tw.read` of FORMATS' columns does not mend; the import of the same file does."""
    path = tmp_path / "run.csv"
    part().drop(index=[100]).to_csv(path, index=False)
    with pytest.raises(tw.InputError, match="1 samples are missing"):
        tw.read(path)
    assert tw.read(path, map=_empty_map(tmp_path)).samples == 1000


def _empty_map(folder: Path) -> Path:
    (folder / "map.toml").write_text("")
    return folder / "map.toml"


def test_rows_go_through_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of other sizes for reading and writing than the table has."""
    monkeypatch.setattr(delimited_text, "CHUNK_CELLS", 1000)
    monkeypatch.setattr(import_recording, "ROWS_AT_ONCE", 700)
    frame = original()
    source, out = tmp_path / "long.csv", tmp_path / "out.csv"
    frame.to_csv(source, index=False, sep=";")
    assert main(["import", str(source), "--out", str(out)]) == 0
    written = pd.read_csv(out)
    for name in frame.columns:
        np.testing.assert_allclose(written[name], frame[name], rtol=1e-15, atol=1e-12)


# ------------------------------------------------------------------------------- from raw files to a verdict

SOURCES: dict[str, Writer] = {name: FORMATS[name] for name in ("ros 1 bag", "ros 2 bag sqlite3", "franka")}
RESAMPLED: dict[str, Writer] = {"two clocks": two_clocks, "plotjuggler": plotjuggler}
SOURCES |= RESAMPLED


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in ("franka", "two clocks") else pytest.mark.long) for n in SOURCES]
)
def test_a_hidden_drag_is_found_in_what_was_imported(name: str, tmp_path: Path) -> None:
    """By the Python call; among two candidates, as the whole catalogue takes longer (`make long`)."""
    rig = Rig.from_data({"sensor": {"convention": "on_tool"}})
    recording = tw.read(*SOURCES[name](original(2500 if name in RESAMPLED else 1000), tmp_path), rig=rig)
    fitted = tw.fit(tw.spatial(rig) + named("viscous_drag"), recording)
    for parameter, true in (("viscous_drag.c", DRAG.c), ("viscous_drag.d", DRAG.d)):
        assert abs(fitted.values[parameter] - true) < 4 * fitted.parameters[parameter].std + 0.02 * true


LOGGED = 1250
"""Samples of the logs that are diagnosed: 10 s at 125 Hz."""


@pytest.mark.long
@pytest.mark.parametrize("name", ["two clocks", "ur_rtde"])
def test_two_commands_to_the_verdict(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a recording that is estimated from the log, and of one that is the simulated one, as those below are."""
    out = tmp_path / "run.csv"
    code, text, _ = run(capsys, "import", *written_by(name)(original(LOGGED), tmp_path), "--out", out, "--json")
    assert code == 0
    if name == "two clocks":  # 37 ms between them, and 3 samples lost
        offset = json.loads(text)["offset"]
        assert offset["interval"][0] < 0.037 < offset["interval"][1]
        assert abs(np.mean(offset["interval"]) - 0.037) < 0.002
    else:
        assert_written(out, original(LOGGED))
    code, text, _ = run(capsys, "diagnose", out, "--workers", "1", "--json")
    found = json.loads(text)
    assert code == 0
    assert found["verdict"] == "explained"
    assert found["added"] == ["viscous_drag"]
    assert found["sign"]["convention"] == Convention.ON_TOOL.value
    parameters = next(effect for effect in found["effects"] if effect["id"] == "viscous_drag")["parameters"]
    assert abs(parameters["c"]["value"] - DRAG.c) < 4 * parameters["c"]["std"]


@pytest.mark.long
@pytest.mark.parametrize("name", ["ros 1 bag", "ros 2 bag mcap", "ros 2 bag sqlite3", "franka", "plotjuggler"])
def test_the_recording_that_is_diagnosed_is_written(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file from which the verdict above follows, whatever the format: what is diagnosed is the file alone."""
    out = tmp_path / "run.csv"
    assert run(capsys, "import", *written_by(name)(original(LOGGED), tmp_path), "--out", out)[0] == 0
    # PlotJuggler's poses come 1 ms after the wrench's samples: the first wrench is left out, and the last pose is
    # beyond the last knot of the spline, which makes at most 1.5 of their resolution, 1 µm and 6e-6 rad.
    resampled = name == "plotjuggler"
    assert_written(out, original(LOGGED).iloc[int(resampled) :], *((2.5e-6, 1e-5) if resampled else ()))


def written_by(name: str) -> Writer:
    return SOURCES.get(name) or FORMATS[name]


def assert_written(path: Path, frame: pd.DataFrame, of_positions: float = 1e-9, of_quaternions: float = 1e-9) -> None:
    """A file of the same samples, and none but named columns of the log: to 1e-9 N and N m of noise of 0.08 N."""
    written = pd.read_csv(path)
    further = set(written.columns) - {"time", *CHANNELS, *POSITION, *QUATERNION}
    assert all(name.startswith(("q[", "actual_")) for name in further)
    assert len(written) == len(frame)
    np.testing.assert_allclose(written["time"], frame["time"] - frame["time"].iloc[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(written[CHANNELS], frame[CHANNELS], rtol=0, atol=1e-9)
    np.testing.assert_allclose(written[POSITION], frame[POSITION], rtol=0, atol=of_positions)
    signs = np.sign((written[QUATERNION].to_numpy() * frame[QUATERNION].to_numpy()).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(signs * written[QUATERNION], frame[QUATERNION], rtol=0, atol=of_quaternions)


# ------------------------------------------------------------------------------- frames, and what is no recording


@pytest.mark.parametrize("name", ["ros 1 bag", "rostopic echo -p"])
def test_frame_convention_and_rotation_are_said(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sources = FORMATS[name](original(500), tmp_path)
    code, text, _ = run(capsys, "import", *sources)
    assert code == 0
    assert "sensor axes, frame 'tool0' as its header states" in text
    assert "the rotation of the logged pose in the base, v_base = R v_pose" in text
    assert "the sensor reads the wrench that the sensor exerts on the tool (on_tool)" in text
    rig = tmp_path / "rig.toml"
    rig.write_text('[sensor]\nconvention = "on_sensor"\n')
    data = json.loads(run(capsys, "import", *sources, "--rig", rig, "--json")[1])
    assert data["frames"][1].endswith("the wrench that the tool exerts on the sensor (on_sensor), as the rig states.")


@pytest.mark.parametrize(
    ("command", "name"), [("diagnose", "ros 2 bag mcap"), ("fit", "franka"), ("diagnose", "headerless")]
)
def test_a_log_that_is_no_recording_is_to_be_imported_first(
    command: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The one line has the command to type, which works."""
    folder = tmp_path / "the logs"
    folder.mkdir()
    frame = original().iloc[:500]
    (log,) = headerless(frame, folder) if name == "headerless" else FORMATS[name](frame, folder)
    code, text, error = run(capsys, command, log)
    assert (code, text, error.count("\n")) == (2, "", 1)
    typed = shlex.split(error.split("`truewrench ")[1].split("`")[0])
    assert typed == ["import", str(log), "--out", "recording.csv"]
    if name != "headerless":  # which needs a preset
        assert run(capsys, *typed[:3], tmp_path / "recording.csv")[0] == 0


@pytest.mark.parametrize(
    ("name", "options"),
    [(name, options) for name in FORMATS for options in ((), ("--stream",)) if options or "lerobot" not in name],
)
def test_every_log_names_its_import(
    name: str, options: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line that a terminal can show, whatever the separator, the names and the text in the columns."""
    for log in FORMATS[name](original().iloc[:60], tmp_path):
        code, text, error = run(capsys, "fit", log, *options)
        assert (code, text, error.count("\n")) == (2, "", 1)
        assert shlex.join(["truewrench", "import", str(log)]) in error
        assert len(error.replace(str(log), "")) < 400


@pytest.mark.parametrize("hidden", [(), (ViscousDrag(c=1.0, d=0.12),)], ids=["a rigid tool", "a drag"])
def test_first_estimates_are_those_of_a_rigid_tool(
    hidden: tuple[HiddenEffect, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Within 4.5 std of the truth of a rigid tool (each of 10 numbers fails 7e-6); another one is said to be none."""
    rig, path = SpatialRig(), tmp_path / "log.csv"
    frame = simulate(rig, rig.random_motion(seed=2), hidden=hidden, repeats=3, samples_per_period=250, seed=2)
    columns = [f"Force {a.upper()} (N)" for a in "xyz"] + [f"Torque {a.upper()} (N m)" for a in "xyz"]
    frame.rename(columns=dict(zip(CHANNELS, columns, strict=True))).to_csv(path, index=False)
    data = json.loads(run(capsys, "import", path, "--json")[1])["first_estimates"]
    text = " ".join(run(capsys, "import", path)[1].split())
    mass = data["parameters"]["m"]
    assert "First estimates, of a rigid tool. Tool: m 1." in text
    assert data["fits"] == (not hidden)
    assert ("the model does not fit, and what it lacks biases these" in text) == bool(hidden)
    if not hidden:
        truth = dict(zip(("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"), rig.inertia, strict=True))
        truth |= dict(zip(("mx", "my", "mz"), rig.first_moment, strict=True)) | {"m": rig.mass}
        for name, value in truth.items():
            estimate = data["parameters"][name]
            assert abs(estimate["value"] - value) < 4.5 * estimate["std"], name
    assert mass["unit"] == "kg"


def test_a_log_that_is_read_wrongly_has_no_first_estimates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, path = SpatialRig(), tmp_path / "log.csv"
    frame = simulate(rig, rig.random_motion(seed=2), repeats=3, samples_per_period=250, seed=2)
    frame[["tx", "ty", "tz"]] *= -1
    frame.to_csv(path, index=False)
    data = json.loads(run(capsys, "import", path, "--json")[1])
    assert [reading["id"] for reading in data["readings"]] == ["torque_sign"]
    assert data["first_estimates"] is None
