"""What the page asks for is answered as the study answers in Python, and refused in one line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import truewrench as tw
from design.limits import arm_and_limits
from modeling.errors import InputError
from modeling.rig import Rig
from tests.truewrench.workbench.requests import opening
from truewrench.workbench.page_update import PageUpdate
from truewrench.workbench.reading import ORIENTATIONS
from truewrench.workbench.study_actions import StudyActions

pytest.importorskip("mujoco")

FORM = {"id": "hose", "stage": "tip_body", "parameters": "c: N*s/m", "formulas": "force_x = -c*tip_vx", "at": "0.1"}


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> StudyActions:
    """A study, opened once."""
    found = StudyActions(lambda _text: None)
    found.answer(opening(tmp_path_factory.mktemp("recording")))
    return found


@pytest.fixture
def actions(begun: StudyActions) -> Iterator[StudyActions]:
    """The study at its first step, and back there after the test."""
    yield begun
    while len(begun.study.steps) > 1:
        begun.answer({"do": "undo"})


def asked(actions: StudyActions, do: str, **values: Any) -> PageUpdate:
    return actions.answer({"do": do, **values})


PICKED = {
    "fx": "k1", "fy": "k2", "fz": "k3", "tx": "k4", "ty": "k5", "tz": "k6", "time": "t", "o1": "g1", "o2": "g2",
    "o3": "g3", "unit_angle": "deg", "orientation": "euler ZYX",
}  # fmt: skip


@pytest.fixture(scope="module")
def odd_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mass of 1.3 kg at the sensor's origin, turned about it; by names that say nothing, angles in degrees."""
    t, rng = np.arange(1500) / 100, np.random.default_rng(4)
    angles = np.column_stack([0.9 * np.sin(0.7 * t + 1), 0.8 * np.sin(1.1 * t), 0.9 * np.sin(0.9 * t + 2)])
    weight = Rotation.from_euler("ZYX", angles).inv().apply([0.0, 0.0, -1.3 * 9.806])
    wrench = np.column_stack([weight, np.zeros((len(t), 3))])
    wrench += rng.standard_normal((len(t), 6)) * np.repeat([0.05, 3e-3], 3)
    path = tmp_path_factory.mktemp("odd") / "odd.csv"
    header = "t,k1,k2,k3,k4,k5,k6,g1,g2,g3"
    np.savetxt(path, np.column_stack([t, wrench, np.degrees(angles)]), delimiter=",", header=header, comments="")
    return path


def test_columns_that_are_not_recognised_are_chosen(odd_log: Path) -> None:
    """What was chosen is kept as a map, by which Python reads the same recording."""
    actions = StudyActions(lambda _text: None)
    words = asked(actions, "open", recordings=[str(odd_log)]).words
    assert [*words] == ["columns"]
    assert '<option value="k1">k1 (' in words["columns"]
    assert "no wrench is recognised" in words["columns"]
    saved = asked(actions, "download", file="map", **PICKED).download
    assert saved is not None
    assert asked(actions, "pick", **PICKED).words["columns"] == ""
    (recording,) = actions.study.fit.recordings
    path = odd_log.with_name(saved.name)
    path.write_bytes(saved.content)
    np.testing.assert_array_equal(tw.read(odd_log, map=path).wrench, recording.wrench)
    mass = actions.study.fit.parameters["m"]
    assert abs(mass.value - 1.3) < 5 * mass.std  # one in a million


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"fy": "k1"}, "'k1' is both"),
        ({"o3": ""}, "'orientation_columns' has 2 columns"),
        ({"orientation": "xyzw"}, "3 columns of orientation are no quaternion"),
        ({"fx": "none"}, "there is no column 'none'"),
        ({"unit_angle": "mm"}, "is not known"),
        (dict.fromkeys(PICKED, ""), "no wrench is recognised"),
    ],
    ids=str,
)
def test_columns_that_cannot_be_are_refused(odd_log: Path, changed: dict[str, str], said: str) -> None:
    actions = StudyActions(lambda _text: None)
    asked(actions, "open", recordings=[str(odd_log)])
    with pytest.raises(InputError, match=re.escape(said)):
        asked(actions, "pick", **(PICKED | changed))


def test_columns_are_asked_for_only_where_there_are_any(tmp_path: Path) -> None:
    """Nothing is to be chosen of what is no table, nor before a file was refused."""
    (tmp_path / "text.csv").write_text("hello\n", encoding="utf-8")
    actions = StudyActions(lambda _text: None)
    with pytest.raises(InputError):
        asked(actions, "open", recordings=[str(tmp_path / "text.csv")])
    with pytest.raises(InputError, match="no recording is open"):
        asked(actions, "pick", **PICKED)


def test_columns_of_a_held_out_log_alone_are_not_chosen(odd_log: Path, tmp_path: Path) -> None:
    """One map is of all files: what it says of the held-out one, the others have not."""
    named = {"t": "time", **{f"k{i}": name for i, name in enumerate(("fx", "fy", "fz", "tx", "ty", "tz"), 1)}}
    text = odd_log.read_text(encoding="utf-8")
    for old, new in {**named, "g1": "yaw_deg", "g2": "pitch_deg", "g3": "roll_deg"}.items():
        text = re.sub(rf"\b{old}\b", new, text, count=1)
    (tmp_path / "train.csv").write_text(text, encoding="utf-8")
    actions = StudyActions(lambda _text: None)
    with pytest.raises(InputError, match=r"odd.csv: no wrench is recognised"):
        asked(actions, "open", recordings=[str(tmp_path / "train.csv")], validate=[str(odd_log)])


def test_one_column_of_orientation_is_the_angle_of_a_planar_log(tmp_path: Path) -> None:
    """A mass of 1 kg 0.1 m from the sensor that swings."""
    t, rng = np.arange(500) / 100, np.random.default_rng(7)
    angle = 1.2 * np.sin(2 * t) + 0.3 * np.sin(5 * t)
    wrench = np.column_stack([-9.81 * np.sin(angle), -9.81 * np.cos(angle), -0.981 * np.sin(angle)])
    columns = np.column_stack([t, wrench + rng.standard_normal((500, 3)) * [0.05, 0.05, 0.01], angle])
    path = tmp_path / "planar.csv"
    np.savetxt(path, columns, delimiter=",", header="t,k1,k2,k3,g1", comments="")
    actions = StudyActions(lambda _text: None)
    asked(actions, "open", recordings=[str(path)])
    asked(actions, "pick", time="t", fx="k1", fy="k2", tau="k3", o1="g1")
    assert actions.study.fit.recordings[0].channels == ("fx", "fy", "tau")


@pytest.mark.long(seconds=6)
def test_first_estimates_tell_the_forms_of_an_orientation_apart(odd_log: Path) -> None:
    """XYZ is the same to the weight of a base on its side, and comes second."""
    actions = StudyActions(lambda _text: None)
    asked(actions, "open", recordings=[str(odd_log)])
    text = asked(actions, "pick", only="1", **(PICKED | {"orientation": "rotation_vector"})).words["estimates"]
    forms = re.findall("<strong>(.*?)</strong>", text)
    assert forms[:2] == ["euler ZYX", "euler XYZ"]
    assert ["gravity_direction" in line for line in text.split("</li>")[:2]] == [False, True]
    assert set(forms) == {form for form in ORIENTATIONS if "wxyz" not in form and "xyzw" not in form}
    assert "m = 1.3" in text.split("</li>")[0]


def test_the_loop_by_hand(actions: StudyActions) -> None:
    asked(actions, "suspects")
    added = asked(actions, "add", effect="viscous_drag")
    assert "The model fits" in added.words["steps"]
    assert actions.study.effects == ("viscous_drag",)
    assert "does not fit" in asked(actions, "drop", effect="viscous_drag").words["steps"]
    assert "The model fits" in asked(actions, "undo").words["steps"]


@pytest.mark.parametrize("view", ["time", "map", "stairs", "spectrum"])
def test_every_view_is_drawn(actions: StudyActions, view: str) -> None:
    from truewrench.plots.bokeh_chart import bokeh_chart, figures_of, legend_html
    from truewrench.plots.style import DARK

    chart = asked(actions, "view", view=view).charts["plots"]
    assert len(figures_of(bokeh_chart(chart, DARK))) == len(chart.panels)
    assert legend_html(chart).startswith("<ul")


def test_a_cell_of_a_map_is_seen_in_time(actions: StudyActions) -> None:
    asked(actions, "view", view="map")
    update = asked(actions, "cell", panel=0, x=0.0)
    assert "Marked: samples where" in update.words["view"]
    assert any(getattr(m, "label", "") == "samples of the cell" for p in update.charts["plots"].panels for m in p.marks)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, "Grammar and units are right"),
        ({"formulas": "force_x = -c*tip_vx*tip_vx"}, "expected N"),
        ({"formulas": "force_x = -c*tip_vx +"}, "column"),
        ({"formulas": "force_x"}, "cannot be read"),
        ({"formulas": 'force_x = __import__("os").system("id")'}, "not allowed"),
        ({"formulas": "force_x = c.__class__"}, "force_x"),
        ({"id": "<b>bold</b>"}, "&lt;b&gt;"),
        ({"parameters": "c: N*s/m" * 1000}, "longer than"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_custom_effect_is_checked_while_it_is_written(
    actions: StudyActions, changed: Mapping[str, str], said: str
) -> None:
    text = asked(actions, "check", **(FORM | dict(changed))).words["custom-result"]
    assert said in text
    assert "<b>" not in text


def test_a_custom_effect_is_added(actions: StudyActions) -> None:
    asked(actions, "custom", **FORM)
    assert actions.study.effects == ("hose",)


@pytest.mark.parametrize(
    "request_",
    [
        {"do": "answer"}, {"do": "__class__"}, {"do": None}, {}, {"do": "view", "view": "passwd"},
        {"do": "view", "recording": 7}, {"do": "view", "channel": 99}, {"do": "add", "effect": "<script>"},
        {"do": "drop", "effect": "../x"}, {"do": "undo"}, {"do": "download", "file": "/etc/passwd"},
        {"do": "download", "file": "trajectory"}, {"do": "compare", "first": 0, "second": 5},
        {"do": "reveal"}, {"do": "discover"}, {"do": "adopt"}, {"do": "download", "file": "effects"},
        {"do": "open", "recordings": []}, {"do": "open", "recordings": ["x"], "period": "no"},
        {"do": "puzzle", "effect": "os.system"}, {"do": "cell", "panel": 77, "x": 0},
        {"do": "separate", "first": "viscous_drag", "second": "viscous_drag"},
    ],
    ids=str,
)  # fmt: skip
def test_what_cannot_be_done_is_refused_in_one_line(actions: StudyActions, request_: Mapping[str, Any]) -> None:
    with pytest.raises(InputError) as refusal:
        actions.answer(request_)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("file", ["model", "numpy", "latex"])
def test_files_are_taken_away(actions: StudyActions, file: str) -> None:
    found = asked(actions, "download", file=file).download
    assert found is not None
    assert len(found.content) > 500


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"parameters": ""}, "there is no parameter to estimate"),
        ({"parameters": "c: N·s/m"}, "Grammar and units are right"),
        ({"id": ""}, "the effect has no name"),
        ({"formulas": "forcex = -c*tip_vx"}, "did you mean force_x"),
        ({"stage": "gain", "formulas": "fx_fz = c"}, "is not what a gain of a channel adds to"),
        ({"formulas": "force_x = -c*tip_vx + 1"}, "under Constants, x0: 0.1 m"),
        ({"constants": "k 2"}, "x0: 0.1 m"),
        ({"formulas": "force_x = -c*tip_vx*tip_vx"}, "c should be in N·s²/m²"),
        ({"formulas": "force_x = -c*vpx"}, "did you mean vx or px?"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_what_is_wrong_is_said_in_words_of_the_form(
    actions: StudyActions, changed: Mapping[str, str], said: str
) -> None:
    text = asked(actions, "check", **(FORM | dict(changed))).words["custom-result"]
    assert said in text
    assert "tip_body" not in text


def test_a_rig_file_to_start_from_can_be_read(actions: StudyActions, tmp_path: Path) -> None:
    found = asked(actions, "download", file="rig_template").download
    assert found is not None
    (tmp_path / found.name).write_bytes(found.content)
    arm, limits = arm_and_limits(Rig.read(tmp_path / found.name))
    assert arm.joints == len(limits.position)


def test_a_payload_is_written_for_the_flange(actions: StudyActions) -> None:
    """The rig is planar: its tool has no place in space, and a pose is checked before."""
    with pytest.raises(InputError, match="is no pose"):
        asked(actions, "download", file="ur", sensor_pose="0 0 1")


def test_a_closest_effect_is_offered_for_separation(actions: StudyActions) -> None:
    diagnosed = asked(actions, "diagnose")
    asked(actions, "suspects")
    words = asked(actions, "suspects").words["suspects"]
    assert "<option selected>viscous_drag</option>" in words
    assert "these recordings" in diagnosed.words["verdict"]


def test_names_of_users_are_escaped(tmp_path: Path) -> None:
    """A column with HTML in its name is a variable of the maps, and its name is text."""
    actions = StudyActions(lambda _text: None)
    begun = actions.answer(opening(tmp_path, "<img src=x onerror=alert(1)>"))
    words = "".join([*begun.words.values(), *asked(actions, "view", view="map").words.values()])
    assert "<img" not in words


def test_a_table_of_nothing_is_one_clear_line(tmp_path: Path) -> None:
    request = opening(tmp_path)
    table = Path(request["recordings"][0])
    head, *rows = table.read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join([head, *(",".join("nan" for _ in row.split(",")) for row in rows)]), encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        StudyActions(lambda _text: None).answer(request)
    assert "train.csv" in str(refusal.value)
