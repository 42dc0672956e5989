"""Axes beside every vector that is printed or written, where the sensor is turned against the logged pose and not."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import truewrench as tw
from modeling.chain.model import spatial
from tests.shared.places import DATA, needs
from tests.shared.turned_sensor import CENTRE, CONTACT, TurnedSensor
from truewrench.command_line import main
from truewrench.reports.report_html import report_page
from truewrench.workbench.study_words import steps_words

HALF, ALIGNED = TurnedSensor(Rotation.from_rotvec([np.pi, 0, 0])), TurnedSensor(Rotation.identity())
CASE = DATA / "reading_cases" / "turned_mount_axes"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of both sensors, and a model file of each."""
    folder = tmp_path_factory.mktemp("axes")
    for name, sensor in (("half", HALF), ("aligned", ALIGNED)):
        for run, pushed in (("run", False), ("pushed", True)):
            pd.DataFrame(sensor.columns(pushed=pushed, seed=pushed)).to_csv(folder / f"{name}_{run}.csv", index=False)
        assert main(["fit", str(folder / f"{name}_run.csv"), "--out", str(folder / f"{name}.json")]) == 0
    return folder


def out(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert main([str(a) for a in arguments]) == 0
    return capsys.readouterr().out


def test_fit_states_the_centre_of_mass_in_both(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = out(capsys, "fit", folder / "half_run.csv")
    number = r"(-?[\d.]+) ± [\d.]+ mm"
    coordinates = f"x {number}, y {number}, z {number}"
    found = re.search(f"{coordinates} in sensor axes and {coordinates} in the axes of the logged pose", text)
    assert found is not None
    stated = np.array(found.groups(), dtype=float).reshape(2, 3)
    assert stated == pytest.approx(1e3 * np.array([CENTRE, CENTRE * [1, -1, -1]]), abs=0.1)
    assert "The sensor is turned by 180° about x against the logged pose: biases, readings and noise are in" in text
    assert "sensor axes)" not in text
    aligned = out(capsys, "fit", folder / "aligned_run.csv")
    assert "about the sensor's origin; sensor axes)" in aligned
    assert "mm in sensor axes" in aligned
    assert "logged pose" not in aligned


def test_the_json_of_every_command_has_the_axes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = json.loads((folder / "half.json").read_text())
    found = json.loads(out(capsys, "fit", folder / "half_run.csv", "--json"))
    result = json.loads(out(capsys, "diagnose", folder / "half_run.csv", "--only", "viscous_drag", "--json"))
    for data in (model, found, result):
        assert data["axes"]["readings"] == "sensor"
        assert data["axes"]["tool"] == "pose"
        turn = np.array(data["axes"]["sensor_to_pose"])
        assert turn == pytest.approx(np.diag([1, -1, -1]))
        centre = {k: np.array([v[i]["value"] for i in "xyz"]) for k, v in data["centre_of_mass"].items()}
        assert centre["sensor axes"] == pytest.approx(CENTRE, abs=1e-4)
        assert centre["axes of the logged pose"] == pytest.approx(turn @ CENTRE, abs=1e-4)
        first = [data["parameters"][n]["value"] / data["parameters"]["m"]["value"] for n in ("mx", "my", "mz")]
        assert first == pytest.approx(turn @ CENTRE, abs=1e-4)
    aligned = json.loads((folder / "aligned.json").read_text())
    assert aligned["axes"]["tool"] == "sensor"
    assert list(aligned["centre_of_mass"]) == ["sensor axes"]


@pytest.mark.parametrize(("axes", "turn"), [(None, [1, 1, 1]), ("sensor", [1, 1, 1]), ("pose", [1, -1, -1])])
def test_compensate_gives_the_axes_that_it_names(
    axes: str | None, turn: list[int], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [] if axes is None else ["--axes", axes]
    command = ["compensate", folder / "half.json", folder / "half_pushed.csv", *options]
    text = out(capsys, *command, "--out", tmp_path / "contact.csv")
    words = "the axes of the logged pose" if axes == "pose" else "sensor axes"
    assert f"torques tcx .. tcz in {words} (the sensor is turned by 180° about x against the logged pose)" in text
    assert f"Noise of one sample, in {words}:" in text
    assert "in sensor axes: fx" in text  # the zero, of the readings
    data = json.loads(out(capsys, *command, "--json"))
    assert data["axes"] == (axes or "sensor")
    expected = np.array([*turn, *turn]) * CONTACT
    for contact in data["contacts"]:
        assert list(contact["wrench"].values()) == pytest.approx(expected, abs=0.05)
    table = pd.read_csv(tmp_path / "contact.csv")
    names = ["fcx", "fcy", "fcz", "tcx", "tcy", "tcz"]
    assert list(table) == ["time", *names, "magnitude", "magnitude_std"]
    inside = (table.time > data["contacts"][0]["start"]) & (table.time < data["contacts"][0]["end"])
    assert table[inside][names].mean().to_numpy() == pytest.approx(expected, abs=0.05)


def test_base_axes_are_named_and_others_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["compensate", folder / "half.json", folder / "half_pushed.csv"]
    assert "in base axes as the pose was logged, about the sensor's origin" in out(capsys, *command, "--axes", "base")
    aligned = out(capsys, "compensate", folder / "aligned.json", folder / "aligned_pushed.csv")
    assert "torques tcx .. tcz in sensor axes, about the sensor's origin" in aligned
    with pytest.raises(tw.InputError, match="'flange' are no axes"):
        tw.compensate(tw.load(folder / "half.json"), tw.read(folder / "half_pushed.csv"), axes="flange")


@pytest.mark.parametrize("to", ["ur", "franka", "urdf", "sdf", "mjcf", "ros2"])
def test_every_export_names_its_frame_and_turns_once(to: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pose = ("--sensor-pose", 0, 0, 0, np.pi, 0, 0)
    for options in ((), pose):
        text = out(capsys, "emit", folder / "half.json", "--to", to, *options)
        assert "the sensor is turned by 180° about x against the axes of the logged pose" in text
        x, y, z = (float(v) for v in re.findall(r"\(m\) x (\S+) ±.*?, y (\S+) ±.*?, z (\S+) ±", text)[0])
        assert (x, y, z) == pytest.approx(CENTRE * [1, -1, -1], abs=1e-4)
        frame = "is at 0 0 0 3.14159 0 0" if options else "along the axes of the logged pose"
        assert frame in text
    assert "turned" not in out(capsys, "emit", folder / "aligned.json", "--to", to)


def test_a_stated_pose_that_turns_otherwise_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["emit", str(folder / "half.json"), "--to", "ur", "--sensor-pose", "0", "0", "0.03"]
    for roll, said in (("0", True), (f"{np.pi - 0.02}", False)):
        assert main([*command, roll, "0", "0"]) == 0
        assert ("right only if that frame has other axes than the logged pose" in capsys.readouterr().err) is said


@pytest.mark.long(10)
def test_report_and_workbench_say_the_same(tmp_path: Path) -> None:
    recording = HALF.recording()
    tw.report(tw.fit(spatial(), recording), tmp_path)
    page = report_page(tw.diagnose(spatial(), recording, effects=["viscous_drag"]))
    words = steps_words(tw.study(spatial(), recording), puzzle=False)
    for text in (words, page, (tmp_path / "report.md").read_text(encoding="utf-8")):
        assert "in sensor axes and x " in text
        assert "first moment and inertia, and points and wrenches of effects, in the axes of the logged pose" in text


@needs(CASE)
def test_the_turned_sensor_that_was_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "model.json"
    text = out(capsys, "fit", CASE / "turned180x.csv", "--out", model)
    assert re.search(r"y -(19\.9|20\.0)\d* ± .*z (69\.9|70\.0)\d* ± .*in sensor axes and x", text)
    (first, *_) = json.loads(out(capsys, "compensate", model, CASE / "pushed.csv", "--json"))["contacts"]
    assert [first["wrench"][n] for n in ("fcx", "fcy", "fcz")] == pytest.approx([-6, 0, 10], abs=0.1)
    for options in ([], ["--sensor-pose", 0, 0, 0, np.pi, 0, 0]):
        payload = out(capsys, "emit", model, "--to", "ur", *options)
        centre = json.loads(re.search(r"set_payload\([\d.]+, (\[.*?\])\)", payload)[1])  # type: ignore[index]
        assert centre == pytest.approx([0.012, 0.020, -0.070], abs=5e-4)
