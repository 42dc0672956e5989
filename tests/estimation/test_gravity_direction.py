"""A base mounted in any orientation: found from poses and runs, stated in the rig, and kept by all that follows.

The recordings are MuJoCo's, with its gravity turned against the axes in which the motion is recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.diagnosis import diagnose
from diagnosis.screening.score_test import model_initial_values
from diagnosis.study import study
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case, prepared
from estimation.contact.contact_wrench import compensate
from estimation.fit import Fit, fit
from estimation.gravity.gravity_direction import with_fitted_tilt
from estimation.gravity.gravity_estimate import WeightMoments
from estimation.pose_advice import CandidatePoses
from estimation.reading.log_reading import imported
from estimation.reading.motion_evidence import motion_evidence
from estimation.recordings.reading_report import StepKind
from estimation.recordings.recording import Recording
from estimation.streaming.long_log import read_chunks
from modeling.chain.model import ALIGNED_MOUNTING, planar, spatial
from modeling.effects import cable_spring, gravity_tilt, viscous_drag
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm
from modeling.kinematics.placement import Direction, base_angle, base_placement, motion_in_world
from modeling.rig import Convention, Rig, SensorDescription
from tests.shared.places import URDF
from tests.shared.recordings import recording_of
from truewrench.files.case_files import frame_sentences, imported_frames, rigid_tool_case
from truewrench.files.model_file import ModelFile
from truewrench.simulated_rig import (
    HIDDEN_EFFECTS,
    BaseForce,
    CableSpring,
    PlanarRig,
    SpatialRig,
    simulate,
    static_poses,
)
from truewrench.simulated_rig.mujoco_scene import Scene
from truewrench.text.diagnosis_text import diagnosis_text

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
LINKS = PlanarRig().link_lengths


@dataclass(frozen=True, kw_only=True)
class MountedTool(SpatialRig):
    """The tool in base axes, with gravity along `down` of them."""

    down: Direction = (0.0, 0.0, -1.0)

    @cached_property
    def scene(self) -> Scene:
        """The scene with its gravity turned."""
        return replace(SpatialRig(noise=self.noise).scene, gravity=self.gravity * np.array(self.down))


@dataclass(frozen=True, kw_only=True)
class MountedArm(PlanarRig):
    """The planar arm in base axes, with gravity along `down` of them."""

    down: Direction = (0.0, -1.0)

    @cached_property
    def scene(self) -> Scene:
        """The scene with its gravity turned."""
        x, y = self.down
        return replace(PlanarRig().scene, gravity=self.gravity * np.array([x, 0.0, y]))


def random_direction(seed: int, axes: int = 3) -> Direction:
    """At least 20 degrees from upright: nearer it is an effect."""
    rng = np.random.default_rng([seed, axes])
    while True:
        drawn = rng.normal(size=axes)
        drawn /= np.linalg.norm(drawn)
        if -drawn[-1] < np.cos(np.deg2rad(20)):
            return tuple(map(float, drawn))


def poses(down: Direction, seed: int = 3, rig: Rig | None = None) -> Recording:
    frame = static_poses(MountedTool(down=down), 24, seed=seed)
    return recording_of(frame, rig=rig)


def run(tool: MountedTool | MountedArm, seed: int, hidden: Sequence[str] = (), repeats: int = 4) -> Recording:
    effects = [HIDDEN_EFFECTS[name] for name in hidden]
    motion = tool.random_motion(seed=seed)
    frame = simulate(tool, motion, hidden=effects, repeats=repeats, samples_per_period=300, seed=seed)
    rig = Rig(link_lengths=LINKS) if isinstance(tool, MountedArm) else None
    return recording_of(frame, rig=rig)


def within(fitted: Fit, name: str, true: float, stds: float = 4.0) -> bool:
    """Whether a parameter is within that many std of its true value (6e-5 not, for noise alone)."""
    found = fitted.parameters[name]
    return abs(found.value - true) < stds * found.std


def angle(first: Sequence[float], second: Sequence[float]) -> float:
    return float(np.rad2deg(np.arccos(np.clip(np.dot(first, second), -1, 1))))


def decided(case: Case) -> Direction:
    assert case.gravity is not None
    return case.gravity.direction


# ------------------------------------------------------------------------------------ by the data


@pytest.mark.parametrize("seed", range(6))
def test_poses_weigh_a_tool_on_any_base(seed: int) -> None:
    """With either sign, for poses cannot tell; the direction to half a degree: 60 mN of 12 N, over 24 poses."""
    down = random_direction(seed)
    fitted = fit(spatial(), poses(down, seed))
    found = fitted.model.gravity_direction
    assert found is not None
    assert min(angle(found, down), 180 - angle(found, down)) < 0.5
    assert fitted.model.convention is (Convention.ON_TOOL if angle(found, down) < 90 else Convention.ON_SENSOR)
    assert within(fitted, "m", MountedTool().mass)
    assert all(within(fitted, n, v) for n, v in zip(("mx", "my", "mz"), MountedTool().first_moment, strict=True))


def test_a_stated_sign_decides_what_poses_cannot() -> None:
    for convention, sign in ((Convention.ON_TOOL, 1), (Convention.ON_SENSOR, -1)):
        rig = Rig(sensor=SensorDescription(convention=convention))
        case = Case.of(spatial(rig), [poses((0.0, 1.0, 0.0), rig=rig)])
        assert decided(case) == (0.0, float(sign), 0.0)
        assert case.gravity is not None
        assert not case.gravity.decided


@pytest.mark.parametrize("hidden", [(), ("viscous_drag",)], ids=["alone", "drag"])
@pytest.mark.parametrize("seed", range(3))
def test_runs_decide_direction_and_sign(seed: int, hidden: tuple[str, ...]) -> None:
    """The drag, 0.3 N of 12, moves it by its share of the weight."""
    down = random_direction(seed + 20)
    recording = run(MountedTool(down=down), seed, hidden, repeats=1 + 3 * (seed % 2))
    fitted = fit(spatial(), recording)
    assert fitted.model.gravity_direction is not None
    assert angle(fitted.model.gravity_direction, down) < (2.0 if hidden else 0.5)
    assert fitted.model.convention is Convention.ON_TOOL
    if not hidden:
        assert within(fitted, "m", MountedTool().mass)


@pytest.mark.parametrize("seed", range(3))
def test_effects_of_the_model_correct_the_direction(seed: int) -> None:
    """A drag of 0.3 N of 12 turns the first estimate by a degree; stated as corrected, no tilt is left."""
    down = random_direction(seed + 20)
    recording = run(MountedTool(down=down), seed, ("viscous_drag",))
    case = Case.of(spatial(), [recording])
    assert case.gravity is not None
    fitted = fit(case.model + viscous_drag(), case.recordings)
    corrected = with_fitted_tilt(case.gravity, fitted.model, fitted.values).direction
    assert angle(corrected, down) < min(0.1, angle(decided(case), down))
    again = fit(spatial(Rig(gravity_direction=corrected)) + viscous_drag() + gravity_tilt(), recording)
    assert all(within(again, f"gravity_tilt.{name}", 0.0) for name in ("tilt_x", "tilt_y"))


def test_a_planar_direction_is_corrected_as_well() -> None:
    down = random_direction(23, axes=2)
    case = Case.of(planar(Rig(link_lengths=LINKS)), [run(MountedArm(down=down), 2)])
    assert case.gravity is not None
    fitted = fit(case.model, case.recordings)
    assert angle(with_fitted_tilt(case.gravity, fitted.model, fitted.values).direction, down) < 0.2


def test_a_base_along_an_axis_is_taken_as_that_axis() -> None:
    down = (1.0, 0.0, 0.0)
    case = Case.of(spatial(), [run(MountedTool(down=down), 1)])
    assert decided(case) == down
    assert not case.model.effects
    assert case.gravity is not None
    assert case.gravity.sentence.startswith(
        "Gravity points along x of the base: with its direction free the mass is 1.2"
    )


@pytest.mark.parametrize("name", ["cable_spring", "gravity_tilt", "sensor_crosstalk", "joint_offset", "contact_event"])
@pytest.mark.parametrize("seed", range(2))
def test_none_is_found_where_the_base_stands_upright(name: str, seed: int) -> None:
    for tool in (MountedArm(), *(() if name == "joint_offset" else (MountedTool(),))):
        recording = run(tool, seed, [name], repeats=1)
        model = planar(recording.rig) if isinstance(tool, MountedArm) else spatial()
        assert Case.of(model, [recording]).gravity is None


def pulled(tool: MountedTool | MountedArm, seed: int, k: float, anchor: tuple[float, float, float]) -> Recording:
    """A run with a cable of k N/m to an anchor in MuJoCo's world."""
    cable = CableSpring(k=k, anchor=anchor, length=0.6, d=0.15)
    motion = tool.random_motion(seed=seed)
    frame = simulate(tool, motion, hidden=[cable], repeats=4, samples_per_period=300, seed=seed)
    rig = Rig(link_lengths=LINKS) if isinstance(tool, MountedArm) else None
    return recording_of(frame, rig=rig)


PULLS = (
    (MountedTool(), 2, 5.2, (0.7, 1.4, 0.2)),
    (MountedTool(), 5, 4.3, (-1.3, 1.0, -0.1)),
    (MountedArm(), 2, 8.0, (2.2, 0.0, 2.0)),
)
"""Cables that pull a tool on a level base with 3 to 15 N, on one side."""


@pytest.mark.parametrize(("tool", "seed", "k", "anchor"), PULLS)
def test_a_cable_on_a_level_base_is_not_taken_for_gravity(
    tool: MountedTool | MountedArm, seed: int, k: float, anchor: tuple[float, float, float]
) -> None:
    """The direction that the forces suggest is said, not applied; with the cable in the model all is right."""
    recording = pulled(tool, seed, k, anchor)
    data = rigid_tool_case([recording], [], recording.rig or Rig())
    assert data.gravity is None
    assert data.model.gravity_direction is None
    assert frame_sentences(data)[0].startswith("Gravity is taken as down, though it may point along (")
    better = data.model + cable_spring()
    fitted = fit(better, recording, start=model_initial_values(Case.of(better, [recording])))
    assert [effect.id for effect in fitted.model.effects] == ["cable_spring"]
    assert within(fitted, "m", tool.mass)
    assert within(fitted, "cable_spring.k", k)


ZERO = BaseForce(force=(3.0, -2.0, 6.0), torque=(0.3, -0.4, 0.1), d=0.0)
"""Taken in base axes, with half of the tool's weight in it: its forces are those of a base that is 30 degrees off."""


@pytest.mark.parametrize("at_rest", [True, False], ids=["poses", "run"])
def test_a_zero_taken_in_base_axes_is_not_taken_for_gravity(at_rest: bool) -> None:
    """At rest the torques tell it, which are not those of one pull; in a run gravity would have another size."""
    tool = MountedTool()
    if at_rest:
        recording = recording_of(static_poses(tool, 24, hidden=[ZERO], seed=3))
    else:
        recording = recording_of(
            simulate(tool, tool.random_motion(seed=1), hidden=[ZERO], repeats=1, samples_per_period=300, seed=1)
        )
    case = Case.of(spatial(), [recording])
    assert case.gravity is None
    assert "a force that is constant in base axes explains the readings better" in frame_sentences(case)[0]
    found = diagnose(spatial(), recording)
    assert found.added == ("base_force",)
    names = [f"torque_{axis}" for axis in "xyz"] + ["force_x", "force_y"] + ([] if at_rest else ["force_z"])
    truth = dict(zip([f"torque_{axis}" for axis in "xyz"], ZERO.torque, strict=True))
    truth |= dict(zip([f"force_{axis}" for axis in "xyz"], ZERO.force, strict=True))
    assert all(within(found.fit, f"base_force.{name}", truth[name]) for name in names)
    assert all(within(found.fit, n, v) for n, v in zip(("mx", "my", "mz"), tool.first_moment, strict=True))
    weighed = tool.mass - ZERO.force[2] / tool.gravity if at_rest else tool.mass
    assert within(found.fit, "m", weighed)
    said = diagnosis_text(found)
    assert ("poses at rest do not tell a vertical force from weight" in said) is at_rest
    assert "torque of its own" not in said


def test_reading_names_the_cable_beside_the_direction() -> None:
    evidence = motion_evidence(pulled(*PULLS[0]))
    assert evidence is not None
    assert evidence.is_better
    assert evidence.best.meaning.startswith("a cable pulls the tool (1.15 kg")
    assert "or gravity points along" in evidence.best.meaning
    assert evidence.best.advice.startswith("gravity is taken as down; if the base is mounted so, state gravity_dir")


def test_a_cable_is_not_taken_for_a_sensor_mounted_turned() -> None:
    """Where it pulls more than the tool weighs: gravity stated, the forces alone suggest a turn by 140 degrees."""
    recording = pulled(MountedTool(), 1, 10.0, (0.6, 0.3, 1.5))
    model = Case.of(spatial(Rig(gravity_direction=(0.0, 0.0, -1.0))), [recording]).model
    assert model.mounting == ALIGNED_MOUNTING
    assert model.convention is Convention.ON_TOOL


@pytest.mark.parametrize("seed", range(3))
def test_a_cable_hides_no_base_that_stands_otherwise(seed: int) -> None:
    """Though a cable explains a part of it: that of the tether moves the direction by its share of the weight."""
    down = random_direction(seed + 20)
    case = Case.of(spatial(), [run(MountedTool(down=down), seed, ("cable_spring",))])
    assert angle(decided(case), down) < 5


@pytest.mark.parametrize("down", [(0.0, 1.0), (1.0, 0.0), random_direction(4, 2)])
def test_a_planar_arm_on_the_ceiling_or_a_wall(down: Direction) -> None:
    recording = run(MountedArm(down=down), 2)
    fitted = fit(planar(recording.rig), recording)
    assert fitted.model.gravity_direction is not None
    assert angle(fitted.model.gravity_direction, down) < 0.5
    assert within(fitted, "m", MountedArm().mass)
    evidence = motion_evidence(recording)
    assert evidence is not None
    assert evidence.is_better
    assert evidence.best.meaning.startswith("gravity points along")


def test_what_is_stated_is_not_decided() -> None:
    sensor = SensorDescription(convention=Convention.ON_TOOL)
    rig = Rig(gravity_direction=(0.0, 0.0, -1.0), sensor=sensor)
    case = Case.of(spatial(rig), [poses((1.0, 0.0, 0.0), rig=rig)])
    assert case.gravity is None
    assert case.sign is None
    assert case.model.gravity_direction == rig.gravity_direction


def test_import_names_it_and_the_line_that_states_it(tmp_path: Path) -> None:
    frame = static_poses(MountedTool(down=(1.0, 0.0, 0.0)), 24, seed=1).rename(columns={"fx": "force_x"})
    path = tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    (said,) = (s for s in imported_frames(imported(path).recording())[0]["frames"] if "ravity" in s)
    assert "write gravity_direction = [1, 0, 0]" in said or "write gravity_direction = [-1, 0, 0]" in said
    stated = said.split("gravity_direction = ")[1].split("]")[0].strip("[").split(", ")
    rig = Rig.from_data({"robot": {"gravity_direction": [float(number) for number in stated]}})
    log = imported(path, rig=rig)
    assert not log.report.of(StepKind.SUSPICIOUS)
    assert not any("ravity" in sentence for sentence in imported_frames(log.recording(rig))[0]["frames"])


@pytest.mark.long
@pytest.mark.parametrize(
    ("hidden", "repeats", "verdict"),
    [((), 1, RecordVerdict.NOTHING_MISSING), (("viscous_drag",), 8, RecordVerdict.EXPLAINED)],
    ids=["alone", "drag"],
)
def test_a_run_on_any_base_is_diagnosed(hidden: tuple[str, ...], repeats: int, verdict: RecordVerdict) -> None:
    """To the end: the direction's two angles are fitted beside the tool, and nothing else is added."""
    tool = MountedTool(down=random_direction(31))
    found = diagnose(spatial(), run(tool, 2, hidden, repeats=repeats))
    assert found.verdict is verdict
    assert found.added == hidden
    assert found.gravity is not None
    assert found.to_data()["gravity"]["mass"] == pytest.approx(tool.mass, rel=0.03)
    assert within(found.fit, "m", tool.mass)


@pytest.mark.long
def test_poses_on_any_base_miss_nothing() -> None:
    found = diagnose(spatial(), poses(random_direction(8), 8))
    assert found.verdict is RecordVerdict.NOTHING_MISSING
    assert found.gravity is not None
    assert found.gravity.sentence in "\n".join(map(str, found.remarks()))
    assert (found.given, found.to_data()["given"]) == ((), [])
    assert "the rigid tool + direction of gravity is" in diagnosis_text(found)
    assert "Fitted with the direction of gravity, gravity_tilt:" in diagnosis_text(found)


# ------------------------------------------------------------------------------ by the rig, and afterwards


def test_a_tilt_is_given_only_where_a_user_gave_it() -> None:
    recording = poses(random_direction(1))
    few = [viscous_drag()]
    assert diagnose(spatial(), recording, effects=few).given == ()
    assert study(spatial(), recording, effects=few).diagnose().given == ()
    assert diagnose(spatial() + gravity_tilt(), recording, effects=few).given == ("gravity_tilt",)


def test_a_fit_keeps_it_for_other_recordings_and_in_its_file() -> None:
    down = (0.0, 0.6, -0.8)
    fitted = fit(spatial(), run(MountedTool(down=down), 1))
    other = run(MountedTool(down=down), 5)
    saved = ModelFile.from_data(ModelFile.of(fitted).to_data())
    assert saved.model.gravity_direction == pytest.approx(fitted.model.gravity_direction, abs=1e-12)
    for known in (fitted, saved.calibration):
        contact = compensate(known, other)
        assert not contact.intervals
        assert np.abs(contact.wrench[:, :3]).max() < 0.6  # noise of 80 mN, of 7200 samples; the weight is 12 N


def test_joint_logs_of_a_sideways_arm() -> None:
    """Against the same arm upright, whose pose, velocity and acceleration are turned with its base."""
    down = (0.0, -0.8, 0.6)
    data = {"urdf": str(URDF / "elbow.urdf"), "sensor_frame": "tool0"}
    upright, turned = Rig.from_data({"robot": data}), Rig.from_data({"robot": data | {"gravity_direction": list(down)}})
    assert upright.arm is not None
    assert turned.arm is not None
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 10, 6))
    expected = motion_in_world(upright.arm.pose(q, dq, ddq), down)
    found = turned.arm.pose(q, dq, ddq)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=1e-12 * max(1.0, float(np.abs(values).max())))
    again = Rig.from_data(turned.to_data())
    assert again.gravity_direction == turned.gravity_direction


def test_the_world_is_the_base_with_gravity_down() -> None:
    for seed in range(20):
        down = random_direction(seed)
        turn = Rotation.from_quat(base_placement(down).quaternion)
        np.testing.assert_allclose(turn.apply(down), [0.0, 0.0, -1.0], atol=1e-12)
        assert np.rad2deg(turn.magnitude()) == pytest.approx(angle(down, (0.0, 0.0, -1.0)), abs=1e-6)
        flat = random_direction(seed, 2)
        x, y = PlanarArm((1.0,)).mounted(flat).tip(0.0)([0.0]).toarray().ravel()  # the base's y in the world
        b = base_angle(flat)
        np.testing.assert_allclose([x, y], [np.sin(b), np.cos(b)], atol=1e-12)
        np.testing.assert_allclose(
            [np.cos(b) * flat[0] + np.sin(b) * flat[1], -np.sin(b) * flat[0] + np.cos(b) * flat[1]], [0, -1], atol=1e-12
        )


def test_a_mounted_recording_is_not_differentiated_again() -> None:
    down = (0.6, 0.0, 0.8)
    recording = run(MountedTool(down=down), 3, (), repeats=1)
    assert recording.signals
    mounted = prepared(recording, spatial(Rig(gravity_direction=down)))
    assert mounted.motion.recorded is recording.motion.recorded
    assert mounted.motion.recorded.derivatives
    stated = run(MountedTool(down=down), 3, (), repeats=1).moved(rig=Rig(gravity_direction=down))
    for name, expected in stated.signals.items():
        np.testing.assert_array_equal(mounted.signals[name], expected)
    assert np.abs(mounted.signals["apx"] - recording.signals["apx"]).max() > 0.1


def test_advised_poses_are_commands_in_base_axes() -> None:
    rig = Rig(gravity_direction=(0.0, 1.0, 0.0))
    advised = CandidatePoses.of(poses((0.0, 1.0, 0.0), rig=rig))
    world = motion_in_world(advised.columns, (0.0, 1.0, 0.0))
    for name in ("qx", "qy", "qz", "qw"):
        np.testing.assert_allclose(world[name], advised.signals[name], atol=1e-12)


@pytest.mark.parametrize(
    ("stated", "said"),
    [([0, 0, 0], "direction of gravity"), ([1], "direction of gravity"), (["x", 0, 0], "gravity_direction")],
)
def test_a_direction_that_is_none_is_refused(stated: list[object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Rig.from_data({"robot": {"gravity_direction": stated}})


def test_a_direction_of_another_space_is_refused() -> None:
    with pytest.raises(InputError, match="along 2 axes"):
        Rig.from_data({"robot": {"link_lengths": [1.0], "gravity_direction": [0, 0, -1]}})
    with pytest.raises(InputError, match="has 2 components"):
        poses((0.0, 0.0, -1.0), rig=Rig(gravity_direction=(0.0, -1.0)))


def test_moments_fit_what_least_squares_fits() -> None:
    """B and the residual of one direction, against numpy's fit of the stacked rows."""
    rng = np.random.default_rng(2)
    turns = Rotation.random(40, rng=rng)
    a, force = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    down = np.array(random_direction(1))
    found = WeightMoments.of(turns.inv().as_matrix(), a, force, 9.806).fit(down)
    regressors = np.hstack([turns.apply(a - 9.806 * down, inverse=True), np.ones((40, 1))])
    solution = np.linalg.lstsq(regressors, force, rcond=None)[0]
    np.testing.assert_allclose(found.matrix, solution[:3].T, atol=1e-10)
    assert found.rms == pytest.approx(float(np.sqrt(np.mean((force - regressors @ solution) ** 2))), rel=1e-10)


def test_chunks_of_a_log_are_in_the_world(tmp_path: Path) -> None:
    """A stated direction turns the chunks of a long log as it turns the recording."""
    down = (0.0, 0.6, -0.8)
    rig = Rig(gravity_direction=down)
    recording = run(MountedTool(down=down), 1, repeats=1)
    columns = dict(zip(recording.channels, recording.wrench.T, strict=True)) | dict(recording.signals)
    path = tmp_path / "log.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    (chunk,) = read_chunks(path, size=300, rig=rig)
    expected = motion_in_world(recording.signals, down)
    for name in ("qx", "qw", "px", "apx", "apy", "apz", "wx"):
        np.testing.assert_allclose(chunk.signals[name], expected[name], atol=1e-12 * 30)
