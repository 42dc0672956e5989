"""Reading a URDF, the rig that names it, and one line for each way in which either can be wrong."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from modeling.errors import InputError
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import Joint, JointKind, Placement
from modeling.kinematics.urdf import read_urdf
from modeling.rig import Rig
from tests.shared.places import URDF

ELBOW = (URDF / "elbow.urdf").read_text()
RIG = '[robot]\nurdf = "elbow.urdf"\nsensor_frame = "tool0"\n'
SIX = "[10, 10, 10, 10, 10, 10]"


def urdf(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def robot(*joints: str, links: str = "base a b tip") -> str:
    body = "".join(f'<link name="{name}"/>' for name in links.split())
    return f'<robot name="r">{body}{"".join(joints)}</robot>'


def joint(name: str, parent: str, child: str, inside: str = "", kind: str = "revolute") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


CHAIN = (joint("j1", "base", "a"), joint("j2", "a", "b"), joint("j3", "b", "tip", kind="fixed"))


def message(path: Path, frame: str | None = "tip") -> str:
    with pytest.raises(InputError) as caught:
        read_urdf(path, frame)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


# ------------------------------------------------------------------------------------- what is read


def test_only_the_way_to_the_sensor_is_read() -> None:
    """The mimicking finger and the meshes that exist nowhere are beyond it."""
    arm = read_urdf(URDF / "elbow.urdf", "tool0")
    assert [j.name for j in arm.chain] == ["pan", "lift", "elbow", "roll", "bend", "turn"]
    assert [j.name for j in read_urdf(URDF / "elbow.urdf", "fore").chain] == ["pan", "lift", "elbow"]


def test_what_is_left_out_is_what_the_specification_says(tmp_path: Path) -> None:
    """Origin at zero, axis x, no limits."""
    arm = read_urdf(urdf(tmp_path, robot(*CHAIN)), "tip")
    plain = Joint(name="j1", kind=JointKind.REVOLUTE, placement=Placement(), axis=(1.0, 0.0, 0.0))
    assert arm.chain[0] == plain
    assert arm.sensor == Placement()
    assert arm.position_limits.tolist() == [[-np.inf, np.inf]] * 2


def test_an_axis_need_not_be_of_length_one(tmp_path: Path) -> None:
    text = robot(joint("j1", "base", "tip", '<axis xyz="0 -3 4"/>'))
    assert read_urdf(urdf(tmp_path, text), "tip").chain[0].axis == (0.0, -0.6, 0.8)


def test_transmissions_and_comments_do_no_harm(tmp_path: Path) -> None:
    other = '<transmission><joint name="j1"><hardwareInterface>x</hardwareInterface></joint></transmission><!-- c -->'
    assert read_urdf(urdf(tmp_path, robot(*CHAIN, other)), "tip").joints == 2


# ----------------------------------------------------------------------------------- what is refused

LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 20))
BAD_AXIS = '<axis xyz="0 0 0"/>'
WRONG = {
    "no xml": ("[robot]", ["not a URDF file", "xacro"]),
    "empty": ("", ["not a URDF file"]),
    "html": ("<html/>", ["not a URDF but <html>"]),
    "cut off": (ELBOW[:300], ["not a URDF file"]),
    "xacro": ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>', ["xacro macros"]),
    "encoding": ('<?xml version="1.0" encoding="klingon"?><robot/>', ["not a URDF file"]),
    "laughs": (f'<!DOCTYPE robot [<!ENTITY l0 "ha">{LAUGHS}]><robot name="&l19;"/>', ["document type declaration"]),
    "other file": ('<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot>&e;</robot>', ["document type"]),
    "outside dtd": ('<!DOCTYPE robot SYSTEM "http://127.0.0.1/r.dtd"><robot/>', ["document type declaration"]),
    "floating": (robot(joint("j1", "base", "tip", kind="floating")), ["joint 'j1'", "'floating'", "revolute"]),
    "planar": (robot(joint("j1", "base", "tip", kind="planar")), ["joint 'j1'", "'planar'"]),
    "no type": (robot(joint("j1", "base", "tip", kind="")), ["joint 'j1'", "type is ''"]),
    "mimic": (robot(CHAIN[0], joint("j2", "a", "tip", '<mimic joint="j1"/>')), ["joint 'j2'", "mimics"]),
    "word": (robot(joint("j1", "base", "tip", '<origin xyz="0 0 up"/>')), ["joint 'j1'", "origin xyz", "'0 0 up'"]),
    "two numbers": (robot(joint("j1", "base", "tip", '<origin rpy="0 0"/>')), ["origin rpy", "3 finite numbers"]),
    "nan": (robot(joint("j1", "base", "tip", '<origin xyz="0 0 nan"/>')), ["3 finite numbers"]),
    "infinite limit": (robot(joint("j1", "base", "tip", '<limit lower="-inf"/>')), ["limit lower", "a finite number"]),
    "no axis": (robot(joint("j1", "base", "tip", BAD_AXIS)), ["joint 'j1'", "axis has no direction"]),
    "huge": (robot(joint("j1", "base", "tip", '<origin xyz="0 0 1e300"/>')), ["3 finite numbers"]),
    "huge axis": (robot(joint("j1", "base", "tip", '<axis xyz="0 0 1e200"/>')), ["axis xyz"]),
    "fixed only": (robot(joint("j1", "base", "tip", kind="fixed")), ["no movable joint", "'tip'"]),
    "root": (robot(links="tip"), ["no movable joint"]),
    "cycle": (robot(joint("j1", "tip", "a"), joint("j2", "a", "b"), joint("j3", "b", "tip")), ["own parent", "tree"]),
    "own parent": (robot(joint("j1", "tip", "tip")), ["link 'tip' is its own parent"]),
    "two parents": (robot(*CHAIN, joint("j4", "base", "b")), ["link 'b'", "'j2'", "'j4'"]),
    "no such parent": (robot(joint("j1", "elsewhere", "tip")), ["link 'elsewhere'", "'j1' but not defined"]),
    "no parent": (robot('<joint name="j1" type="revolute"><child link="tip"/></joint>'), ["link ''", "'j1'"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_urdf_is_one_line(tmp_path: Path, case: str) -> None:
    text, parts = WRONG[case]
    path, start = urdf(tmp_path, text), time.perf_counter()
    said = message(path)
    assert time.perf_counter() - start < 1.0  # nothing is expanded, nothing waits for a network
    for part in parts:
        assert part in said


def test_frames_there_are_named(tmp_path: Path) -> None:
    said = message(URDF / "elbow.urdf", "tool1")
    assert "no frame 'tool1'" in said
    assert "base, shoulder, upper, fore, wrist, hand, flange, tool0, finger, thumb" in said
    assert "robot.sensor_frame is missing" in message(URDF / "elbow.urdf", None)
    many = robot(*CHAIN, links=" ".join(f"link{i}" for i in range(50)))
    assert len(message(urdf(tmp_path, many), "tool0")) < 400


def test_missing_files_are_named(tmp_path: Path) -> None:
    assert "No such file" in message(tmp_path / "nowhere.urdf")
    assert "directory" in message(tmp_path)


def test_a_damaged_file_is_an_arm_or_one_line(tmp_path: Path) -> None:
    """300 times one stretch of the file taken out, doubled, or replaced by what hurts."""
    rng = np.random.default_rng(0)
    hurtful = ["", "<", "&lol;", "]]>", "\x00", "1e400", "-", "nan", '"', "é", "<!DOCTYPE x>", "<joint/>", "<link/>"]
    refusals = []
    for _ in range(300):
        start, stop = np.sort(rng.integers(0, len(ELBOW), 2))
        stop = min(stop, start + int(rng.integers(1, 60)))
        damaged = ELBOW[:start] + str(rng.choice([*hurtful, 2 * ELBOW[start:stop]])) + ELBOW[stop:]
        try:
            assert read_urdf(urdf(tmp_path, damaged), "tool0").joints > 0
        except InputError as error:
            refusals.append(str(error))
    assert not any("\n" in refusal for refusal in refusals)
    assert 100 < len(refusals) < 300  # many are damaged where it matters, some where nobody looks


# ---------------------------------------------------------------------------------------- in a rig


def rig(folder: Path, text: str) -> Rig:
    (folder / "elbow.urdf").write_text(ELBOW)
    (folder / "rig.toml").write_text(text)
    return Rig.read(folder / "rig.toml")


def rig_message(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        rig(folder, text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_rig_reads_the_urdf_beside_it(tmp_path: Path) -> None:
    found = rig(tmp_path, RIG)
    assert found.arm == read_urdf(URDF / "elbow.urdf", "tool0")
    assert found.limits is None
    assert found.position_limits is not None
    assert found.position_limits[1].tolist() == [-1.9, 1.2]


def test_a_stored_rig_keeps_the_arm_and_needs_no_file(tmp_path: Path) -> None:
    data = rig(tmp_path, RIG + f"[limits]\nacceleration = {SIX}\n[workspace]\nz = [0.1, 2.0]\n").to_data()
    (tmp_path / "elbow.urdf").unlink()
    again = Rig.from_data(data)
    assert again.arm == read_urdf(URDF / "elbow.urdf", "tool0")
    assert isinstance(again.arm, SpatialArm)
    assert again.to_data() == data
    assert (again.urdf, again.sensor_frame) == ("elbow.urdf", "tool0")
    assert again.workspace is not None
    assert again.workspace.z == (0.1, 2.0)


def test_a_stored_arm_that_was_changed_is_refused(tmp_path: Path) -> None:
    data = rig(tmp_path, RIG).to_data()
    for spoil in ({"axis": [0, 0, 2]}, {"axis": [0, 0]}, {"kind": "floating"}, {"position": [0, float("nan")]}):
        spoiled = {**data, "robot": {**data["robot"], "spatial_arm": {**data["robot"]["spatial_arm"]}}}
        chain = spoiled["robot"]["spatial_arm"]["chain"]
        spoiled["robot"]["spatial_arm"]["chain"] = [{**chain[0], **spoil}, *chain[1:]]
        with pytest.raises(InputError, match="spatial_arm"):
            Rig.from_data(spoiled)


def test_limits_that_the_rig_leaves_out_are_the_urdfs(tmp_path: Path) -> None:
    limits = rig(tmp_path, RIG + f"[limits]\nacceleration = {SIX}\n").limits
    assert limits is not None
    assert limits.position[:3].tolist() == [[-2.9, 2.9], [-1.9, 1.2], [-2.4, 2.4]]
    assert limits.velocity[0].tolist() == [-2.2, 2.2]
    assert limits.acceleration[5].tolist() == [-10, 10]
    stated = rig(tmp_path, RIG + f"[limits]\nvelocity = [1, 1, 1, 1, 1, 1]\nacceleration = {SIX}\n").limits
    assert stated is not None
    assert stated.velocity[0].tolist() == [-1, 1]


def test_limits_that_nobody_states_are_asked_for(tmp_path: Path) -> None:
    assert "limits.acceleration: missing" in rig_message(tmp_path, RIG + "[limits]\n")
    said = rig_message(tmp_path, RIG + "[limits]\nacceleration = [1, 1]")
    assert "expected 6 joints, got 2 limits" in said
    assert "pan, lift, elbow, roll, bend, turn" in said
    (tmp_path / "arm.urdf").write_text(robot(*CHAIN))
    bare = '[robot]\nurdf = "arm.urdf"\nsensor_frame = "tip"\n[limits]\nacceleration = [1, 1]\n'
    assert "limits.position: missing, and the URDF has none for 'j1'" in rig_message(tmp_path, bare)


def test_a_rig_whose_urdf_is_wrong_is_one_line(tmp_path: Path) -> None:
    assert "robot.sensor_frame is missing" in rig_message(tmp_path, '[robot]\nurdf = "elbow.urdf"\n')
    assert f"there is no file other.urdf in {tmp_path}" in rig_message(tmp_path, RIG.replace("elbow", "other"))
    assert "got both" in rig_message(tmp_path, RIG + "link_lengths = [1.0]\n")
