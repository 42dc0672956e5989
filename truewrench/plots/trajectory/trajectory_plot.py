"""Exciting trajectory: joint limits, tip path, Fisher information per sample."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from design.information.sample_information import SampleInformation
from design.limits.limit_use import LIMITED_DERIVATIVES, LimitUse
from design.trajectories.trajectory import Trajectory
from modeling.kinematics.arm import Arm
from modeling.kinematics.planar_arm import PlanarArm
from modeling.rig.rig import Limits, Workspace
from truewrench.plots.style import WIDTH, PixelLayout, panel_title
from truewrench.plots.trajectory.information_plot import (
    ROW_HEIGHT,
    draw_colour_bar,
    draw_information,
    draw_parameter_information,
    information_colours,
)
from truewrench.plots.trajectory.joint_limit_plot import (
    LINE_HEIGHT,
    draw_limit_use,
    limits_of_quantity,
    write_limit_use,
)
from truewrench.plots.trajectory.posture_plot import draw_postures, draw_workspace, write_workspace_limits

LEFT, TIME, USES, RIGHT = 78, 374, 266, 10
"""CSS pixels: axis labels, panels over time, text to their right, right margin."""
TOP, SHARES, TOTAL, BETWEEN, HEAD, BOTTOM = 26, 104, 78, 14, 34, 40
"""CSS pixels: margins, panel heights, the space between panels and above a heading."""


def trajectory_figure(
    motion: Trajectory,
    limits: Limits,
    *,
    arm: Arm | None = None,
    tip_length: float | None = None,
    workspace: Workspace | None = None,
    information: SampleInformation | None = None,
) -> Figure:
    """Joints relative to their limits, information per sample, and tip path (with postures of a planar arm).

    Without an arm there is no path, without `information` no panels of it; tip_length in m, 0 when None.
    """
    use = LimitUse.of(motion, limits, workspace, arm, tip_length)
    quantities = [quantity for quantity in LIMITED_DERIVATIVES if limits_of_quantity(use, quantity)]
    share = max(SHARES, LINE_HEIGHT * (motion.joints + 1))
    middle = TOP + len(quantities) * (share + BETWEEN) - BETWEEN
    information_height = 0.0 if information is None else HEAD + TOTAL + BETWEEN + ROW_HEIGHT * len(information.names)
    page = PixelLayout.of(middle + information_height + BOTTOM)

    panels = [page.panel(LEFT, TOP + i * (share + BETWEEN), TIME, share) for i in range(len(quantities))]
    for axes, quantity in zip(panels, quantities, strict=True):
        draw_limit_use(axes, motion, list(LIMITED_DERIVATIVES).index(quantity), limits_of_quantity(use, quantity))
        write_limit_use(axes, limits_of_quantity(use, quantity), TIME, share)
    panel_title(panels[0], "joint limits and their largest use")
    if information is not None:
        panels += _information_panels(page, motion, information, middle + HEAD)
    if arm is not None:
        _tip_path_panel(page, motion, arm, tip_length or 0.0, use, information, middle)
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")
    return page.figure


def _information_panels(
    page: PixelLayout, motion: Trajectory, information: SampleInformation, top: float
) -> list[Axes]:
    total = page.panel(LEFT, top, TIME, TOTAL)
    rows = ROW_HEIGHT * len(information.names)
    strip = page.panel(LEFT, top + TOTAL + BETWEEN, TIME, rows)
    draw_information(total, motion, information)
    draw_parameter_information(strip, motion, information)
    draw_colour_bar(page.panel(LEFT + TIME + 16, top + TOTAL + BETWEEN, 8, rows))
    return [total, strip]


def _tip_path_panel(
    page: PixelLayout,
    motion: Trajectory,
    arm: Arm,
    tip_length: float,
    use: LimitUse,
    information: SampleInformation | None,
    bottom: float,
) -> None:
    left, limited_quantities = LEFT + TIME + USES, limits_of_quantity(use, "workspace")
    axes = page.panel(left, TOP, WIDTH - left - RIGHT, bottom - TOP)
    draw_postures(axes, motion, arm, tip_length, None if information is None else information_colours(information))
    draw_workspace(axes, limited_quantities, "y" if isinstance(arm, PlanarArm) else "z")
    write_workspace_limits(axes, limited_quantities)
