"""The picture of a plan: what it says is true, and it stands for all series and arms."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from design.information.sample_information import SampleInformation
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries, fourier_trajectory
from design.trajectories.spline import RestToRest
from design.trajectories.trajectory import Trajectory
from modeling.kinematics.arm import Arm
from modeling.rig import Capsule, HalfSpace, Limits, Workspace
from tests.shared.rigs import ARM, spatial_arm
from truewrench.plots.arm_plot import ArmInMotion, farthest_points, link_positions, outline
from truewrench.plots.trajectory_plot import active_instants, trajectory_figure

ELBOW = spatial_arm("elbow")


def limits(joints: int, jerk: float | None = None) -> Limits:
    pairs = [None if size is None else np.tile([-size, 0.8 * size], (joints, 1)) for size in (1.0, 2.0, 10.0, jerk)]
    position, velocity, acceleration, last = pairs
    assert position is not None
    assert velocity is not None
    assert acceleration is not None
    return Limits(position=position, velocity=velocity, acceleration=acceleration, jerk=last)


def information(motion: Trajectory, names: tuple[str, ...] = ("m", "mlg", "I")) -> SampleInformation:
    """Of a made-up experiment, whose columns are the motion's own signals."""
    q, dq, ddq = motion.evaluate(motion.series.instants(60))
    return SampleInformation.of(np.stack([q, dq, ddq], axis=2), names)


def words(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text)]


@pytest.mark.parametrize(
    ("arm", "workspace", "jerk"),
    [
        (ARM, Workspace(x=(-1.5, 1.5), y=(0.2, 2.6)), None),
        (ARM, None, 100.0),
        (ELBOW, Workspace(z=(-1.0, 1.7)), 100.0),
        (None, None, None),
    ],
    ids=["planar", "jerk", "spatial", "no arm"],
)
def test_figure_stands_for_every_arm(arm: Arm | None, workspace: Workspace | None, jerk: float | None) -> None:
    joints = 3 if arm is None else arm.joints
    series = RestToRest(inner=FreeSeries(joints=joints, harmonics=(1, 2, 3), period=4.0), ramp=0.5)
    bounds = limits(joints, jerk)
    motion = random_feasible_trajectory(series, bounds, workspace=workspace, arm=arm, tip_length=0.2, seed=1)
    figure = trajectory_figure(
        motion, bounds, arm=arm, tip_length=0.2, workspace=workspace, information=information(motion)
    )
    figure.canvas.draw()
    views = 0 if arm is None else 1 if arm is ARM else 2
    panels = (3 if jerk is None else 4) + (workspace is not None)
    assert len(figure.axes) == panels + 5 + views  # information, its strip and scale, accumulated with two scales
    assert {"position", "velocity", "acceleration", "m", "mlg", "I"} <= set(words(figure))
    assert ("jerk" in words(figure)) == (jerk is not None)
    assert ("tip" in words(figure)) == (workspace is not None)
    assert len(trajectory_figure(motion, bounds).axes) == panels - (workspace is not None)


def test_figure_says_how_much_is_used() -> None:
    """q up to 0.5 of [-1, 0.8] (0.6 / 0.9), dq 1 of [-2, 1.6] (1.2 / 1.8), ddq 2 of [-10, 8] (3 / 9)."""
    motion = fourier_trajectory(offset=[0.0], sine=[[0.0, 0.5]], cosine=[[0.0, 0.0]], period=2 * np.pi)
    said = words(trajectory_figure(motion, limits(1)))
    assert [text for text in said if text.endswith(" %")] == ["66.7 %", "66.7 %", "33.3 %"]
    assert [text for text in said if text.startswith("of ")] == [
        "of −1.00 to 0.800 rad", "of −2.00 to 1.60 rad/s", "of −10.0 to 8.00 rad/s²",
    ]  # fmt: skip


def test_information_that_is_barely_there_is_drawn() -> None:
    """Columns that a float of double precision tells apart, and their products do not."""
    motion = fourier_trajectory(offset=[0.0], sine=[[0.0, 0.5]], cosine=[[0.0, 0.0]], period=2 * np.pi)
    columns = np.random.default_rng(0).standard_normal((40, 1, 2))
    columns[:, :, 1] = columns[:, :, 0] + 1e-10 * columns[:, :, 1]
    figure = trajectory_figure(motion, limits(1), information=SampleInformation.of(columns, ("one", "other")))
    figure.canvas.draw()
    assert "information accumulated" in words(figure)


def test_dots_stand_where_a_limit_is_touched() -> None:
    time = np.linspace(0, 1, 2000)
    share = np.sin(2 * np.pi * time) + 0.001 * np.cos(2 * np.pi * time)
    assert time[active_instants(share)] == pytest.approx([0.25, 0.75], abs=1e-3)  # a point of the grid
    assert len(active_instants(0.99 * share)) == 0


def test_skeleton_is_equation_22_2() -> None:
    q = np.random.default_rng(1).uniform(-1, 1, (4, 3))
    angle = np.cumsum(q, axis=1)
    steps = np.stack([np.sin(angle), np.cos(angle)], axis=2) * np.array([1.0, 0.97, 0.4])[:, None]
    joints = np.concatenate([np.zeros((4, 1, 2)), steps.cumsum(axis=1)], axis=1)
    tip = joints[:, -1] + 0.2 * np.stack([np.sin(angle[:, -1]), np.cos(angle[:, -1])], axis=1)
    np.testing.assert_allclose(link_positions(ARM, 0.2, q), np.concatenate([joints, tip[:, None]], axis=1), atol=1e-14)


def carrying_capsules() -> tuple[ArmInMotion, Limits]:
    """The elbow's hand and fore arm over a floor, beside a mast."""
    places = [("hand", 6, (0.0, 0.0, 0.1)), ("fore", 3, (0.1, 0.5, 0.0)), ("mast", 0, (0.5, 0.5, 1.0))]
    capsules = tuple(
        Capsule(name=name, joint=joint, start=(0.0, 0.0, 0.0) if joint else (0.5, 0.5, 0.0), end=end, radius=0.05)
        for name, joint, end in places
    )
    floor = HalfSpace(normal=(0.0, 0.0, 1.0), offset=1.0, clearance=0.03)
    workspace = Workspace(capsules=capsules, half_spaces=(floor,), clearance=0.02)
    bounds = limits(ELBOW.joints)
    series = FreeSeries(joints=ELBOW.joints, harmonics=(1, 2, 3), period=4.0)
    motion = random_feasible_trajectory(series, bounds, arm=ELBOW, tip_length=0.2, seed=1)
    moved = ArmInMotion(motion=motion, arm=ELBOW, tip_length=0.2, limits=bounds, workspace=workspace)
    return moved, bounds


def test_closest_approach_is_the_least_clearance_between_the_points_that_are_drawn() -> None:
    moved, bounds = carrying_capsules()
    approach, asked = moved.approach, moved.clearances
    assert approach is not None
    assert asked is not None
    values = asked.values(moved.motion.derivative(np.linspace(0, 4.0, 4001), 0))
    assert approach.left == pytest.approx(values.min(), abs=5e-5)  # of a grid five times as fine
    assert approach.name == asked.names[int(values.min(axis=0).argmin())]
    q = moved.motion.derivative(np.array([approach.time]), 0)[0]
    for which, (name, value) in enumerate(zip(asked.names, asked.values(q[None])[0], strict=True)):
        one, other = asked.nearest(q, which)
        taken = 0.05 + 0.03 if "half-space" in name else 0.05 + 0.05 + 0.02
        assert np.linalg.norm(one - other) - taken == pytest.approx(value, abs=1e-12)  # rounding
    figure = trajectory_figure(
        moved.motion, bounds, arm=ELBOW, tip_length=0.2, workspace=moved.workspace, notes=["Another note."]
    )
    figure.canvas.draw()
    said = words(figure)
    assert any(approach.name in text and text.startswith("Closest approach") for text in said)
    assert "Another note." in said
    assert f"{1000 * approach.left:.1f} mm" in said


def test_clearances_that_no_motion_changes_are_drawn_without_an_approach() -> None:
    moved, bounds = carrying_capsules()
    shoulder = Capsule(name="shoulder", joint=1, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0), radius=0.05)
    floor = HalfSpace(normal=(0.0, 0.0, 1.0), offset=1.0)
    still = Workspace(capsules=(shoulder,), half_spaces=(floor,))
    figure = trajectory_figure(moved.motion, bounds, arm=ELBOW, tip_length=0.2, workspace=still)
    assert "1, unchanging" in words(figure)
    assert not any("Closest approach" in text for text in words(figure))


def test_outline_of_a_capsule_is_a_radius_from_its_segment() -> None:
    start, end = np.array([0.2, -0.1]), np.array([0.5, 0.7])
    edge = outline(start, end, 0.15)
    share = np.clip((edge - start) @ (end - start) / np.sum((end - start) ** 2), 0, 1)
    distance = np.linalg.norm(edge - start - share[:, None] * (end - start), axis=1)
    np.testing.assert_allclose(distance, 0.15, rtol=1e-12)  # rounding
    np.testing.assert_allclose(np.linalg.norm(outline(start, start, 0.15) - start, axis=1), 0.15, rtol=1e-12)


def test_chain_of_an_arm_ends_at_its_tip() -> None:
    moved, _ = carrying_capsules()
    links = moved.links(moved.time[:3])
    np.testing.assert_allclose(links[:, -1], moved.tip[:3], atol=1e-12)  # rounding, by another route
    assert not links[:, 0].any()
    lengths = np.linalg.norm(np.diff(links, axis=1), axis=2)
    np.testing.assert_allclose(lengths, lengths[[0, 0, 0]], atol=1e-12)  # rigid links
    assert lengths[0, -1] == pytest.approx(0.2, abs=1e-12)


def test_postures_are_far_apart() -> None:
    line = np.stack([np.linspace(0, 1, 101), np.zeros(101)], axis=1)
    assert farthest_points(line, 4) == [0, 100, 50, 25]
