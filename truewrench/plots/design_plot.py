"""Design plot: a planned motion within its limits, the arm along it, and when its information is earned."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from design.limit_use import QUANTITIES, LimitUse
from design.motion.series import Motion
from design.sample_information import SampleInformation
from modeling.arm import PlanarArm
from modeling.kinematics import Arm
from modeling.rig import Limits, Workspace
from truewrench.plots.earning_plot import ROW_HEIGHT, draw_earnings, draw_scale, draw_total, path_colours
from truewrench.plots.posture_plot import draw_postures, draw_workspace, write_workspace
from truewrench.plots.share_plot import LINE, draw_shares, of_quantity, write_uses
from truewrench.plots.style import PIXELS_PER_INCH, WIDTH, dress, heading

LEFT, TIME, USES, RIGHT = 78, 374, 266, 10
"""CSS pixels: the axis labels, the panels over time, what stands beside them, and the right margin."""
TOP, SHARES, TOTAL, BETWEEN, HEAD, BOTTOM = 26, 104, 78, 14, 34, 40
"""CSS pixels: margins, heights of the panels, the space between two of them and above a new heading."""


@dataclass(frozen=True)
class Page:
    """An empty figure whose panels are placed in CSS pixels from its top left corner."""

    height: float
    figure: Figure

    @classmethod
    def of(cls, height: float) -> Page:
        """A page as wide as all figures."""
        figure = Figure(figsize=(WIDTH / PIXELS_PER_INCH, height / PIXELS_PER_INCH))
        figure.patch.set_alpha(0.0)
        return cls(height, figure)

    def panel(self, left: float, top: float, width: float, height: float) -> Axes:
        """Dressed axes."""
        place = (left / WIDTH, 1 - (top + height) / self.height, width / WIDTH, height / self.height)
        return dress(self.figure.add_axes(place))


def design_figure(
    motion: Motion,
    limits: Limits,
    *,
    arm: Arm | None = None,
    tip_length: float | None = None,
    workspace: Workspace | None = None,
    information: SampleInformation | None = None,
) -> Figure:
    """Joints within their limits, when the information is earned, and the tip's path (of a planar arm, the arm too).

    Without an arm there is no path, without `information` nothing of the samples; tip_length in m, 0 when None.
    """
    use = LimitUse.of(motion, limits, workspace, arm, tip_length)
    quantities = [quantity for quantity in QUANTITIES if of_quantity(use, quantity)]
    share = max(SHARES, LINE * (motion.joints + 1))
    middle = TOP + len(quantities) * (share + BETWEEN) - BETWEEN
    earned = 0.0 if information is None else HEAD + TOTAL + BETWEEN + ROW_HEIGHT * len(information.names)
    page = Page.of(middle + earned + BOTTOM)

    panels = [page.panel(LEFT, TOP + i * (share + BETWEEN), TIME, share) for i in range(len(quantities))]
    for axes, quantity in zip(panels, quantities, strict=True):
        draw_shares(axes, motion, list(QUANTITIES).index(quantity), of_quantity(use, quantity))
        write_uses(axes, of_quantity(use, quantity), TIME, share)
    heading(panels[0], "each joint between its limits, and the most it uses of them")
    if information is not None:
        panels += _earnings(page, motion, information, middle + HEAD)
    if arm is not None:
        _path(page, motion, arm, tip_length or 0.0, use, information, middle)
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")
    return page.figure


def _earnings(page: Page, motion: Motion, information: SampleInformation, top: float) -> list[Axes]:
    total = page.panel(LEFT, top, TIME, TOTAL)
    rows = ROW_HEIGHT * len(information.names)
    strip = page.panel(LEFT, top + TOTAL + BETWEEN, TIME, rows)
    draw_total(total, motion, information)
    draw_earnings(strip, motion, information)
    draw_scale(page.panel(LEFT + TIME + 16, top + TOTAL + BETWEEN, 8, rows))
    return [total, strip]


def _path(
    page: Page,
    motion: Motion,
    arm: Arm,
    tip_length: float,
    use: LimitUse,
    information: SampleInformation | None,
    bottom: float,
) -> None:
    left, reaches = LEFT + TIME + USES, of_quantity(use, "workspace")
    axes = page.panel(left, TOP, WIDTH - left - RIGHT, bottom - TOP)
    draw_postures(axes, motion, arm, tip_length, None if information is None else path_colours(information))
    draw_workspace(axes, reaches, "y" if isinstance(arm, PlanarArm) else "z")
    write_workspace(axes, reaches)
