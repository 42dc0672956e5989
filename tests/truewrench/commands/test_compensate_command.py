"""`truewrench compensate`: its file, its text, its JSON, and what it refuses."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import truewrench as tw
from estimation.reading.data_files import CONTACT, CONTACT_STD, PREDICTION
from modeling.rig import Convention
from tests.shared.log_files import DRAG, lerobot_data_set, lerobot_statistics, original
from truewrench.command_line import main
from truewrench.files.wrench_bag import wrench_topics
from truewrench.simulated_rig import (
    ContactEvent,
    PlanarRig,
    SensorGain,
    SpatialRig,
    ViscousDrag,
    simulate,
    write_recording,
)

pytest.importorskip("mujoco")

TIP = 0.25
RIG_TEXT = f"""
[robot]
link_lengths = [1.0, 0.97, 0.4]
tip_length = {TIP}
"""
PUSH = np.array([3.0, 4.0])
"""Along x' and y', at the end of the tip: 5 N, 0.6435 rad clockwise from y'."""


@dataclass(frozen=True)
class Bench:
    model: str
    pushed: str
    quiet: str


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A rig, a model fitted to it, a recording of another motion with a push and one without; the zero has moved."""
    folder = tmp_path_factory.mktemp("contact")
    (folder / "rig.toml").write_text(RIG_TEXT)
    arm = PlanarRig()
    push = ContactEvent(force=(PUSH[0], -PUSH[1], 0.0), torque=(0.0, 0.0, TIP * PUSH[0]), start=2.0, end=4.0)
    for name, hidden, repeats, seed in (("train", [], 4, 1), ("pushed", [push], 2, 2), ("quiet", [], 2, 3)):
        motion = arm.random_motion(seed=seed)
        frame = simulate(arm, motion, hidden=hidden, repeats=repeats, samples_per_period=250, seed=seed)
        frame["fx"] += 0.0 if name == "train" else 0.8
        write_recording(frame, folder / f"{name}.csv")
    model = str(folder / "model.json")
    assert main(["fit", str(folder / "train.csv"), "--rig", str(folder / "rig.toml"), "--out", model]) == 0
    return Bench(model, str(folder / "pushed.csv"), str(folder / "quiet.csv"))


def test_the_file_has_the_columns_of_the_contract(bench: Bench, tmp_path: Path) -> None:
    out = tmp_path / "contact.csv"
    assert main(["compensate", bench.model, bench.pushed, "--out", str(out)]) == 0
    table = pd.read_csv(out)
    assert list(table) == ["time", "fcx", "fcy", "tauc", "magnitude", "direction", "magnitude_std", "direction_std"]
    assert len(table) == len(pd.read_csv(bench.pushed))
    during = table[(table.time > 2.1) & (table.time < 3.9)]
    assert during.magnitude.mean() == pytest.approx(5.0, abs=0.1)  # 90 samples with 0.13 N of noise: seven errors
    assert during.direction.mean() == pytest.approx(np.arctan2(*PUSH), abs=0.02)
    assert (during.magnitude_std > 0).all()
    weak = table.magnitude < 2 * table.magnitude_std
    assert weak.any()
    assert (table.direction.isna() == weak).all()
    assert (table.direction_std.isna() == weak).all()


def test_json_and_text_say_the_same(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["compensate", bench.model, bench.pushed, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    (contact,) = data["contacts"]
    assert contact["start"] == pytest.approx(2.0, abs=0.05)
    assert contact["end"] == pytest.approx(4.0, abs=0.05)
    assert data["zero_shift"]["fx"] == pytest.approx(0.8, abs=0.1)
    assert main(["compensate", bench.model, bench.pushed]) == 0
    text = capsys.readouterr().out
    assert text.startswith("1 contact ")
    assert f"{contact['start']:.3f}" in text
    assert f"fx {data['zero_shift']['fx']:.3g}" in text


@pytest.mark.parametrize(("couple", "remarks"), [(0.0, 2), (0.3, 3)])
def test_the_table_says_when_a_force_at_the_tip_is_none(
    couple: float, remarks: int, bench: Bench, tmp_path: Path
) -> None:
    """A push of 5 N at the tip; with 0.3 N m in the reading on top, |F| stays and the force at the tip does not."""
    saved = tw.load(bench.model)
    frame = pd.read_csv(bench.pushed)
    frame.loc[(frame.time > 2) & (frame.time < 4), "tau"] -= couple
    frame.to_csv(tmp_path / "rec.csv", index=False)
    contact = tw.compensate(saved, tw.read(tmp_path / "rec.csv", rig=saved.rig))
    (mean,) = contact.means
    assert mean.force == pytest.approx(5.0, abs=0.15)
    assert (mean.tip_force == pytest.approx(5.0, abs=0.15)) == (couple == 0)
    assert bool(contact.unexplained_by_tip_force) == (couple > 0)
    assert len(contact.remarks()) == remarks
    headings = [c.heading for c in contact.table.columns]
    assert headings == [
        "from [s]", "to [s]", "fcx [N]", "fcy [N]", "tauc [N m]", "|F| [N]", "largest |F| [N]", "force at the tip [N]",
        "p",
    ]  # fmt: skip
    assert ">tauc (N·m)</th>" in contact._repr_html_()
    assert contact.std == pytest.approx(np.sqrt(np.diagonal(contact.covariance, axis1=1, axis2=2)))


def test_nothing_touches_the_tool(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["compensate", bench.model, bench.quiet]) == 0
    assert capsys.readouterr().out.startswith("No contact")
    assert main(["compensate", bench.model, bench.quiet, "--keep-zero"]) == 0
    assert "contact" in capsys.readouterr().out.splitlines()[0]


def test_a_lag_lowers_the_noise_and_leaves_contacts_and_zero(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    files = [tmp_path / "plain.csv", tmp_path / "smoothed.csv"]
    read = []
    for out, lag in zip(files, ([], ["--lag", "60ms"]), strict=True):
        assert main(["compensate", bench.model, bench.pushed, *lag, "--json", "--out", str(out)]) == 0
        read.append(json.loads(capsys.readouterr().out))
    plain, smoothed = read
    assert (plain["lag"], smoothed["lag"]) == (0.0, pytest.approx(0.06))
    assert smoothed["contacts"] == plain["contacts"]
    assert smoothed["zero_shift"] == plain["zero_shift"]
    assert all(smoothed["noise"][name] < 0.6 * plain["noise"][name] for name in plain["noise"])
    frame = pd.read_csv(files[1])
    quiet = frame[(frame.time < 1.8) | (frame.time > 4.2)]
    assert quiet.fcx.std() == pytest.approx(smoothed["noise"]["fcx"], rel=0.2)
    during = frame[(frame.time > 2.1) & (frame.time < 3.9)]
    assert during.magnitude.mean() == pytest.approx(5.0, abs=0.1)
    for axes in ("pose", "base"):
        assert main(["compensate", bench.model, bench.pushed, "--lag", "0.06", "--axes", axes, "--json"]) == 0
        turned = json.loads(capsys.readouterr().out)
        assert main(["compensate", bench.model, bench.pushed, "--axes", axes, "--json"]) == 0
        assert turned["contacts"] == json.loads(capsys.readouterr().out)["contacts"]
    assert main(["compensate", bench.model, bench.pushed, "--lag", "60ms"]) == 0
    text = capsys.readouterr().out
    assert "a row takes readings until 60 ms later" in text
    assert "near the beginning and end of a contact" in text
    for wrong in ("0ms", "soon", "-1s", "1us", "9s"):
        assert main(["compensate", bench.model, bench.pushed, f"--lag={wrong}"]) == 2
        assert "lag" in capsys.readouterr().err


def test_six_axes_have_their_own_columns(tmp_path: Path) -> None:
    arm = SpatialRig()
    frame = simulate(arm, arm.random_motion(seed=1), repeats=3, samples_per_period=200, seed=1)
    recording = write_recording(frame, tmp_path / "run.csv")
    model, out = str(tmp_path / "model.json"), tmp_path / "contact.csv"
    (tmp_path / "rig.toml").write_text('[sensor]\nconvention = "on_tool"\n')
    assert main(["fit", str(recording), "--rig", str(tmp_path / "rig.toml"), "--out", model]) == 0
    assert main(["compensate", model, str(recording), "--out", str(out)]) == 0
    names = ["time", "fcx", "fcy", "fcz", "tcx", "tcy", "tcz", "magnitude", "magnitude_std"]
    table = pd.read_csv(out)
    assert list(table) == names
    size = np.linalg.norm(table[["fcx", "fcy", "fcz"]].to_numpy(), axis=1)
    assert table.magnitude.to_numpy() == pytest.approx(size, rel=1e-6)
    assert table.notna().all(axis=None)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--tip-length", "-1"], "tip-length"),
        (["--tip-length", "nan"], "tip-length"),
        (["--false-alarms", "2"], "false-alarms"),
        (["--false-alarms", "often"], "false-alarms"),
    ],
)
def test_bad_options_are_one_line(
    options: list[str], named: str, bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["compensate", bench.model, bench.pushed, *options]) == 2
    error = capsys.readouterr().err
    assert named in error
    assert len(error.splitlines()) == 1


def test_a_bad_recording_leaves_the_old_file(bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, broken = tmp_path / "contact.csv", tmp_path / "broken.csv"
    out.write_text("old")
    broken.write_text("time,q1,q2,q3,fx,fy,tau\n0,0,0,0,1,2,x\n")
    capsys.readouterr()
    assert main(["compensate", bench.model, str(broken), "--out", str(out)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert out.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


@pytest.mark.parametrize("line", ["compensate {rec} {model}", "compare {rec} --on {model}", "emit {rec} --to c"])
def test_a_recording_in_the_place_of_the_model_file(
    line: str, bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.format(rec=bench.quiet, model=bench.model).split()) == 2
    said = capsys.readouterr().err
    assert "quiet.csv: a recording where a model file belongs; give the JSON" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("command", ["compensate {model} {log}", "compare {model} --on {log}", "calibrate {log}"])
def test_a_log_in_the_place_of_a_recording_names_its_import(
    command: str, bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "robot_data.csv"
    log.write_text("timestamp actual_TCP_pose_0 actual_TCP_force_0\n" + "0.002 0.1 5.0\n" * 50)
    assert main(command.format(model=bench.model, log=log).split()) == 2
    error = capsys.readouterr().err
    assert "the columns are not separated by commas; write a CSV with commas" in error
    assert f"`truewrench import {log} --out recording.csv`" in error


def test_a_model_that_does_not_fit_is_a_warning(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = json.loads(Path(bench.model).read_text())
    path = tmp_path / "rigid.json"
    path.write_text(json.dumps(saved | {"misfitting": ["train.csv"]}))
    assert main(["compensate", str(path), bench.quiet]) == 0
    assert capsys.readouterr().err.startswith("warning: the model does not fit train.csv: what it lacks is in the")
    assert main(["compensate", bench.model, bench.quiet]) == 0
    assert capsys.readouterr().err == ""


def test_a_bag_has_what_was_measured_and_what_explains_it(tmp_path: Path) -> None:
    """Read back by the bags' library; what is left of the readings without prediction is the contact, on the tool."""
    from rosbags.highlevel import AnyReader

    rig, motion = SpatialRig(), SpatialRig().random_motion(seed=4)
    frame = simulate(rig, motion, hidden=[ViscousDrag(c=0.4, d=0.1)], repeats=2, samples_per_period=250, seed=4)
    frame["fx"] += 0.5
    recording = tw.from_dataframe(frame)
    fitted = tw.fit(tw.spatial() + tw.effects.viscous_drag(), recording)
    model, run, bag, table = (tmp_path / name for name in ("model.json", "run.csv", "contact.mcap", "contact.csv"))
    tw.save(fitted, model)
    write_recording(frame, run)
    assert main(["compensate", str(model), str(run), "--out", str(table), "--mcap", str(bag)]) == 0
    series: dict[str, list[list[float]]] = {}
    with AnyReader([bag]) as reader:
        for connection, stamp, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            assert stamp == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            force, torque = message.wrench.force, message.wrench.torque
            rows = series.setdefault(connection.topic.removeprefix("/truewrench/"), [])
            rows.append([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    assert set(series) == {"measured", "predicted", "contact", "contact_std", "effects/viscous_drag"}
    arrays = {topic: np.array(rows) for topic, rows in series.items()}
    names = list(recording.channels)
    np.testing.assert_allclose(arrays["measured"], frame[names], rtol=0, atol=1e-8)  # as the file has them
    contact = pd.read_csv(table)[[f"{name[0]}c{name[1]}" for name in names]]
    np.testing.assert_allclose(arrays["contact"], contact, rtol=1e-8, atol=1e-7)  # nine digits
    sign = 1.0 if fitted.model.convention is Convention.ON_SENSOR else -1.0
    np.testing.assert_allclose(sign * (arrays["measured"] - arrays["predicted"]), arrays["contact"], rtol=0, atol=1e-9)
    twin = simulate(rig, motion, repeats=2, samples_per_period=250, seed=4)
    twin["fx"] += 0.5
    difference = (frame[names] - twin[names]).to_numpy()
    assert np.abs(arrays["effects/viscous_drag"] - difference).max() < 0.05 * np.abs(difference).max()


BUDGET = """
[[contribution]]
name = "gravity at the place"
quantity = "gravity"
half_width = 0.5
unit = "m/s²"

[[contribution]]
name = "zero"
quantity = "zero_drift"
std = 0.1
unit = "N"
"""


def test_without_the_library_of_bags_nothing_is_written(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "truewrench.files.wrench_bag", raising=False)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    out, bag = tmp_path / "contact.csv", tmp_path / "contact.mcap"
    assert main(["compensate", bench.model, bench.pushed, "--out", str(out), "--mcap", str(bag)]) == 2
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().err.count("\n") == 1


def test_a_budget_goes_from_the_fit_to_the_contact(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train, rig = (str(Path(bench.model).parent / name) for name in ("train.csv", "rig.toml"))
    stated, model = tmp_path / "budget.toml", str(tmp_path / "budgeted.json")
    stated.write_text(BUDGET.replace('name = "zero"', 'name = "drift"'), encoding="utf-8")
    command = ["fit", train, "--rig", rig, "--budget", str(stated), "--monte-carlo", "50"]
    assert main([*command, "--out", model, "--json"]) == 0
    mass = json.loads(capsys.readouterr().out)["budget"]["parameters"]["m"]
    assert mass["largest"] == "gravity at the place"
    assert mass["halved_at_std"] == pytest.approx(0.5 / 3**0.5 / 2, rel=0.02)
    assert main(["compensate", model, bench.pushed, "--json"]) == 0
    without = json.loads(capsys.readouterr().out)
    assert main(["compensate", model, bench.pushed, "--budget", "--json"]) == 0
    contact = json.loads(capsys.readouterr().out)
    assert "budget" not in without
    components = contact["budget"]["components"]
    assert list(components) == [f"{n}, {of}" for of in ("one row", "contact 1") for n in ("fcx", "fcy", "tauc")]
    (pushed,), (plain,) = contact["contacts"], without["contacts"]
    assert components["fcx, contact 1"]["std"] == pytest.approx(pushed["wrench_std"]["fcx"])
    assert pushed["wrench_std"]["fcx"] > plain["wrench_std"]["fcx"]
    # As wrong in use as in the fit: less than the weight alone would be.
    assert components["fcx, one row"]["contributions"]["gravity at the place"] < 0.9 * 0.5 / 3**0.5
    further = ["--axes", "base", "--lag", "20ms", "--out", str(tmp_path / "contact.csv")]
    assert main(["compensate", model, bench.pushed, "--budget", *further]) == 0
    assert "Budget:" in capsys.readouterr().out
    # What a budget has at its nominal value is no part of the readings.
    saved = tw.load(model)
    assert saved.budget is not None
    contact_wrench = tw.compensate(saved.budget, tw.read(bench.pushed, rig=saved.rig))
    assert not [topic for topic in wrench_topics(contact_wrench) if "effects" in topic]


def test_the_doubt_of_a_diagnosis_goes_to_the_contact(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From the diagnosis that finds a gain, or a leak that reads alike, over the model file; alone where asked for."""
    arm, train, rig = PlanarRig(), str(tmp_path / "train.csv"), str(Path(bench.model).parent / "rig.toml")
    motion = arm.random_motion(seed=1, period=3.0, harmonics=3)
    gain = SensorGain(errors=(("fy", 0.03),))
    frame = simulate(arm, motion, hidden=(gain,), repeats=4, samples_per_period=150, seed=11)
    write_recording(frame, tmp_path / "train.csv")
    only = ("sensor_gain", "sensor_crosstalk")
    assert main(["diagnose", train, "--rig", rig, "--only", ",".join(only), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    chosen, other = result["averaged"]["members"]
    assert result["averaged"]["parameters"]["m"]["std"] > 5 * result["parameters"]["m"]["std"]
    stated = tw.Rig.read(rig)
    diagnosis = tw.diagnose(tw.planar(stated), tw.read(train, rig=stated), effects=only)
    model = str(tw.save(diagnosis, tmp_path / "model.json"))
    contacts = []
    for further in ([], ["--without-alternatives"]):
        assert main(["compensate", model, bench.pushed, "--json", *further]) == 0
        contacts.append(json.loads(capsys.readouterr().out))
    doubtful, alone = contacts
    assert doubtful["alternatives"] == [{"name": other["name"], "weight": pytest.approx(other["weight"])}]
    assert chosen["weight"] + other["weight"] == pytest.approx(1)
    assert doubtful["between"]["fcy"] > 0
    assert doubtful["contacts"][0]["wrench_std"]["fcy"] > alone["contacts"][0]["wrench_std"]["fcy"]
    assert not {"alternatives", "between"} & set(alone)
    assert main(["compensate", model, bench.pushed]) == 0
    assert f"probability of the others: sensor_crosstalk {other['weight']:.2g}" in capsys.readouterr().out
    assert main(["emit", model, "--to", "numpy"]) == 0
    warned = f"warning: the model was not told apart from sensor_crosstalk (probability {other['weight']:.2g}): its std"
    assert warned in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["compensate", "model.json", "pushed.csv", "--budget"], "model.json: the model file has no budget"),
        (["fit", "train.csv", "--monte-carlo", "9"], "there is no budget to check"),
        (
            ["fit", "train.csv", "--error-bound", "fx=1", "--error-bound", "fx=2"],
            "--error-bound: a channel is stated twice",
        ),
        (["fit", "train.csv", "--error-bound", "fx"], "'fx' is no name with a size above zero, such as fx=0.5"),
        (["fit", "train.csv", "--error-bound", "fx=1", "--stream"], "--error-bound: not available for a streamed"),
        (["compensate", "model.json", "pushed.csv", "--lag", "20us"], "'20us' is no time above zero, such as 20ms"),
        (["fit", "train.csv", "--budget", "budget.toml"], "budget.toml: zero: the name is that of a scatter"),
        (["fit", "train.csv", "--budget", "good.toml", "--monte-carlo", "9"], "give 50 to 100000"),
        (["fit", "train.csv", "--budget", "none.toml"], "none.toml: No such file"),
        (["fit", "train.csv", "--budget", "rig.toml"], "rig.toml: "),
        (["fit", "train.csv", "--budget", "budget.toml", "--robust"], "leave out --robust"),
        (["fit", "train.csv", "--budget", "budget.toml", "--stream"], "not available for a streamed log"),
    ],
)
def test_a_budget_that_cannot_be_is_one_line(
    arguments: list[str], said: str, bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(Path(bench.model).parent)
    Path("budget.toml").write_text(BUDGET, encoding="utf-8")
    Path("good.toml").write_text(BUDGET.replace('"zero"', '"drift"'), encoding="utf-8")
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert err.count("\n") == 1


@pytest.fixture(scope="module")
def drag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of the run of `original`, with its drag."""
    path = tmp_path_factory.mktemp("drag") / "model.json"
    recording = tw.from_dataframe(original().iloc[:1000], one_run=True)
    tw.save(tw.fit(tw.spatial() + tw.effects.viscous_drag(), recording), path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows_of(folder: Path) -> pd.DataFrame:
    """All rows of a data set, by pandas."""
    return pd.concat([pd.read_parquet(path) for path in sorted(folder.glob("data/**/*.parquet"))], ignore_index=True)


def statistics_of(folder: Path, episode: int) -> dict[str, Any]:
    """What a data set states of the contact wrench in an episode, in either version; empty for nothing."""
    lines = folder / "meta" / "episodes_stats.jsonl"
    if lines.is_file():
        stated = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
        found: dict[str, Any] = stated[episode]["stats"].get(CONTACT, {})
        return found
    row = pd.read_parquet(folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet").iloc[episode]
    names = {name.rsplit("/", 1)[1]: row[name] for name in row.index if name.startswith(f"stats/{CONTACT}/")}
    return {name: list(value) for name, value in names.items() if value is not None}


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_data_set_gets_the_contact_wrench_as_features(
    version: str, drag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the second of three episodes, whose others have no force; read back by pandas and PyArrow."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    frame = original().iloc[:1000]
    data_set = lerobot_data_set(frame, tmp_path / "in", version, episodes=3)
    out, table = tmp_path / "out", tmp_path / "contact.csv"
    before = contents(data_set)
    assert main(["compensate", str(drag), str(data_set), "--lerobot", str(out)]) == 0
    printed = capsys.readouterr()
    assert printed.err.count("warning: left without a contact wrench: ") == 2
    assert f"Episodes of {out} without a contact wrench, NaN there: 2." in " ".join(printed.out.split())
    assert contents(data_set) == before
    assert main(["compensate", str(drag), str(data_set / "episode_000001"), "--out", str(table)]) == 0
    contact = pd.read_csv(table)[["fcx", "fcy", "fcz", "tcx", "tcy", "tcz"]].to_numpy()
    rows, plain = rows_of(out), rows_of(data_set)
    pd.testing.assert_frame_equal(rows[plain.columns.tolist()], plain)
    values = np.stack(rows[CONTACT].to_list())
    assert np.isnan(values[:1000]).all()
    assert np.isnan(values[2000:]).all()
    np.testing.assert_allclose(values[1000:2000], contact, rtol=2e-7, atol=1e-7)  # single precision, nine digits
    std, prediction = (np.stack(rows[name].to_list())[1000:2000] for name in (CONTACT_STD, PREDICTION))
    assert (std > 0).all()
    model = tw.load(drag).model
    sign = 1.0 if model.convention is Convention.ON_SENSOR else -1.0
    np.testing.assert_allclose(sign * (frame[list(model.channels)] - prediction), contact, rtol=0, atol=2e-5)
    for path in out.glob("data/**/*.parquet"):
        assert pq.read_schema(path).field(CONTACT).type == pa.list_(pa.float32(), 6)
    info = json.loads((out / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["features"][CONTACT] == {
        "dtype": "float32", "shape": [6], "names": ["fcx", "fcy", "fcz", "tcx", "tcy", "tcz"]
    }  # fmt: skip
    assert info["features"][PREDICTION]["names"] == list(model.channels)
    expected = lerobot_statistics(values[1000:2000].astype(float))
    stated = [statistics_of(out, 1), *([] if version == "v2.1" else [whole_statistics(out)])]
    for statistics in stated:
        assert set(statistics) == set(expected)
        for name, numbers in expected.items():
            np.testing.assert_allclose(statistics[name], numbers, rtol=1e-12)
    assert statistics_of(out, 0) == {}
    # in its own place: the same again, and what reads it takes none of it for the sensor's
    after = contents(out)
    assert main(["compensate", str(drag), str(out / "episode_000001"), "--lerobot", str(out)]) == 0
    assert contents(out) == after
    np.testing.assert_allclose(tw.read(out / "episode_000001").wrench, frame[list(model.channels)], atol=1e-12)


def whole_statistics(folder: Path) -> dict[str, Any]:
    stats: dict[str, Any] = json.loads((folder / "meta" / "stats.json").read_text(encoding="utf-8"))[CONTACT]
    return stats


def test_rows_that_were_left_out_have_no_contact_wrench(drag: Path, tmp_path: Path) -> None:
    """Each sample goes back to the row that it was, though rows before it are missing."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    frame = original().iloc[:1000]
    data_set, out = lerobot_data_set(frame, tmp_path / "in", "v2.1"), tmp_path / "out"
    (path,) = data_set.glob("data/**/*.parquet")
    whole = pq.read_table(path)
    wrench: list[Any] = whole["observation.wrench"].to_pylist()
    wrench[100:140] = [None] * 40  # a gap that is too long to be filled: what is before it is left out
    place = whole.column_names.index("observation.wrench")
    # of no stated length: the oldest PyArrow writes no missing list of a fixed one
    pq.write_table(whole.set_column(place, "observation.wrench", pa.array(wrench, pa.list_(pa.float64()))), path)
    assert main(["compensate", str(drag), str(data_set), "--lerobot", str(out)]) == 0
    values = np.stack(rows_of(out)[CONTACT].to_list())
    assert np.isnan(values[:140]).all()
    prediction = np.stack(rows_of(out)[PREDICTION].to_list())
    model = tw.load(drag).model
    sign = 1.0 if model.convention is Convention.ON_SENSOR else -1.0
    measured = frame[list(model.channels)].to_numpy()
    np.testing.assert_allclose(sign * (measured - prediction)[140:], values[140:], rtol=0, atol=2e-5)


@pytest.mark.parametrize(
    ("recording", "out", "said"),
    [
        ("in/episode_000000", "in/data", "is inside the data set"),
        ("in/episode_000000", "there", "is there already; give a new folder, or the data set itself"),
        ("run.csv", "out", "no LeRobot data set"),
        ("in/episode_000007", "out", "there is no episode 7"),
    ],
)
def test_a_data_set_that_cannot_be_written_is_one_line(
    recording: str, out: str, said: str, drag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data_set = lerobot_data_set(original().iloc[:200], tmp_path / "in", "v3.0")
    (tmp_path / "there").mkdir()
    original().iloc[:200].to_csv(tmp_path / "run.csv", index=False)
    before = contents(data_set)
    assert main(["compensate", str(drag), str(tmp_path / recording), "--lerobot", str(tmp_path / out)]) == 2
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert contents(data_set) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "run.csv", "there"]


def test_a_result_never_replaces_a_file_of_the_data_set(
    drag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data_set = lerobot_data_set(original().iloc[:200], tmp_path / "in", "v3.0")
    (rows,) = data_set.glob("data/**/*.parquet")
    before = contents(data_set)
    info, episode = data_set / "meta" / "info.json", data_set / "episode_000000"
    for command in (
        ["compensate", drag, episode, "--out", rows],
        ["compensate", drag, episode, "--lerobot", tmp_path / "out", "--mcap", data_set / "new.mcap"],
        ["import", data_set, "--out", rows],
        ["fit", episode, "--out", info],
        ["diagnose", data_set, "--out", data_set],
    ):
        assert main([str(word) for word in command]) == 2
        assert "is inside the data set; give" in capsys.readouterr().err
        assert contents(data_set) == before


def test_a_feature_of_another_shape_is_not_written_over(
    drag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    data_set = lerobot_data_set(original().iloc[:1000], tmp_path / "in", "v3.0")
    (path,) = data_set.glob("data/**/*.parquet")
    table = pq.read_table(path)
    pq.write_table(table.append_column(CONTACT, pa.array([[0.0] * 3] * len(table), pa.list_(pa.float32()))), path)
    before = contents(data_set)
    assert main(["compensate", str(drag), str(data_set), "--lerobot", str(data_set)]) == 2
    assert f"the feature {CONTACT} is there with another shape than (6,)" in capsys.readouterr().err
    assert contents(data_set) == before


def rewritten(folder: Path, kind: str) -> None:
    """Spoil how the file of rows says whose they are."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (path,) = folder.glob("data/**/*.parquet")
    table = pq.read_table(path)
    numbers = table.column("episode_index").to_pylist()
    place = table.column_names.index("episode_index")
    if kind == "two files":
        pq.write_table(table.slice(1500), path.with_name("file-001.parquet"))
        table = table.slice(0, 1500)
    elif kind == "cut off":
        path.write_bytes(path.read_bytes()[:5000])
        return
    else:
        other = pa.array([None, *numbers[1:]] if kind == "null" else [str(number) for number in numbers])
        table = (
            table.drop_columns("episode_index") if kind == "none" else table.set_column(place, "episode_index", other)
        )
    pq.write_table(table, path)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("two files", "file-001.parquet: episode 1 is in file-000.parquet too"),
        ("cut off", "file-000.parquet: cannot be read as Parquet"),
        *((kind, "episode_index is not a whole number in each row") for kind in ("null", "text", "none")),
    ],
)
def test_rows_that_are_of_no_certain_episode_are_one_line(
    kind: str, said: str, drag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data_set = lerobot_data_set(original().iloc[:1000], tmp_path / "in", "v3.0", episodes=3)
    rewritten(data_set, kind)
    for given in (data_set, data_set / "episode_000001"):
        assert main(["compensate", str(drag), str(given), "--lerobot", str(tmp_path / "out")]) == 2
        printed = capsys.readouterr()
        assert said in printed.err
        assert printed.err.count("\n") == 1
        assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_rows_among_those_of_other_episodes_are_told_apart(drag: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    frame, out = original().iloc[:1000], tmp_path / "out"
    data_set = lerobot_data_set(frame, tmp_path / "in", "v3.0", episodes=3)
    (path,) = data_set.glob("data/**/*.parquet")
    pq.write_table(pq.read_table(path).sort_by("frame_index"), path)
    np.testing.assert_allclose(tw.read(data_set / "episode_000001").wrench[:, 0], frame["fx"], atol=1e-12)
    assert main(["compensate", str(drag), str(data_set / "episode_000001"), "--lerobot", str(out)]) == 0
    values, episodes = np.stack(rows_of(out)[CONTACT].to_list()), rows_of(out)["episode_index"]
    np.testing.assert_array_equal(np.isfinite(values).all(axis=1), episodes == 1)


def test_a_copy_of_a_read_only_data_set_can_be_changed(drag: Path, tmp_path: Path) -> None:
    data_set, out = lerobot_data_set(original().iloc[:1000], tmp_path / "in", "v2.1"), tmp_path / "out"
    folders = [data_set, *(path for path in data_set.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    try:
        assert main(["compensate", str(drag), str(data_set), "--lerobot", str(out)]) == 0
    finally:
        for folder in folders:
            folder.chmod(0o755)
    assert {path.stat().st_mode & 0o777 for path in [out, *out.rglob("*")] if path.is_dir()} == {0o755}
    assert CONTACT in rows_of(out)


def test_a_change_that_is_interrupted_is_whole(drag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted while its files take their places: all do."""
    data_set = lerobot_data_set(original().iloc[:1000], tmp_path / "in", "v3.0")
    out = tmp_path / "out"
    assert main(["compensate", str(drag), str(data_set), "--lerobot", str(out)]) == 0
    replace, calls = os.replace, []

    def interrupted(new: Path, old: Path) -> None:
        calls.append(old)
        if len(calls) == 2:
            raise KeyboardInterrupt
        replace(new, old)

    monkeypatch.setattr(os, "replace", interrupted)
    assert main(["compensate", str(drag), str(data_set), "--lerobot", str(data_set)]) == 130
    assert len(calls) == 5
    assert contents(data_set) == contents(out)


@pytest.mark.parametrize("text", ["{", "[]\n", '{"episode_index": 0}\n', '{"episode_index": 0, "stats": {"a": 3}}\n'])
def test_broken_statistics_are_one_line(
    text: str, drag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data_set = lerobot_data_set(original().iloc[:1000], tmp_path / "in", "v2.1")
    (data_set / "meta" / "episodes_stats.jsonl").write_text(text, encoding="utf-8")
    before = contents(data_set)
    table = ["--out", str(tmp_path / "contact.csv")]
    for out in (data_set, tmp_path / "out"):
        assert main(["compensate", str(drag), str(data_set), "--lerobot", str(out), *table]) == 2
        assert f"{data_set / 'meta' / 'episodes_stats.jsonl'}: is not as a LeRobot" in capsys.readouterr().err
        assert contents(data_set) == before
        assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize(
    "options", [("--only", "viscous_drag"), pytest.param((), marks=pytest.mark.long)], ids=["one effect", "all"]
)
def test_an_episode_leads_to_a_verdict_in_one_command(
    options: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data_set = lerobot_data_set(original().iloc[:1000], tmp_path / "in", "v3.0", episodes=3)
    assert main(["diagnose", str(data_set / "episode_000001"), *options, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], found["added"]) == ("explained", ["viscous_drag"])
    size = found["effects"][0]["parameters"]["c"]
    assert abs(size["value"] - DRAG.c) < 4 * size["std"]
