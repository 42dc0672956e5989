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
from modeling.rig import Limits, Workspace
from tests.shared.rigs import ARM, spatial_arm
from truewrench.plots.trajectory_plot import active_instants, farthest_points, link_positions, trajectory_figure

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
    panels = (3 if jerk is None else 4) + 3 + (arm is not None)  # limits; information, its strip and scale; the path
    assert len(figure.axes) == panels
    assert {"position", "velocity", "acceleration", "m", "mlg", "I"} <= set(words(figure))
    assert ("jerk" in words(figure)) == (jerk is not None)
    assert len(trajectory_figure(motion, bounds).axes) == panels - 3 - (arm is not None)


def test_figure_says_how_much_is_used() -> None:
    """q up to 0.5 of [-1, 0.8] (0.6 / 0.9), dq 1 of [-2, 1.6] (1.2 / 1.8), ddq 2 of [-10, 8] (3 / 9)."""
    motion = fourier_trajectory(offset=[0.0], sine=[[0.0, 0.5]], cosine=[[0.0, 0.0]], period=2 * np.pi)
    said = words(trajectory_figure(motion, limits(1)))
    assert [text for text in said if text.endswith(" %")] == ["66.7 %", "66.7 %", "33.3 %"]
    assert [text for text in said if text.startswith("of ")] == [
        "of −1.00 to 0.800 rad", "of −2.00 to 1.60 rad/s", "of −10.0 to 8.00 rad/s²",
    ]  # fmt: skip


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


def test_postures_are_far_apart() -> None:
    line = np.stack([np.linspace(0, 1, 101), np.zeros(101)], axis=1)
    assert farthest_points(line, 4) == [0, 100, 50, 25]
