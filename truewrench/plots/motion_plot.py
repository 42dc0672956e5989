"""The motion of a recording or a design, and the information in each of its samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from design.exciting_trajectory import ExcitingTrajectory
from design.information.sample_information import SampleInformation
from design.trajectories.trajectory import Trajectory
from estimation.fit import Fit
from estimation.noise.recording_noise import sample_step
from estimation.recordings.motion import numbered_names
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.number_format import axis_label
from truewrench.plots.chart import Chart, Heat, Level, Line, Panel, Points
from truewrench.plots.style import MEASURED
from truewrench.plots.trajectory_plot import joint_colour

Array = NDArray[np.float64]

INFORMATION_COLOURS = ("#ECEEF2", "#C3B1E1", "#8250B8", "#3B0F6F")
DARKEST = 3.0
"""Relative information (mean sample = 1) of the darkest colour."""
UNIT_HEIGHT = 112
"""Of a panel of lines, CSS pixels: as high as its label is long."""
MOST_SAMPLES = 1000
"""Columns of the map of information by parameter: longer motions are averaged over intervals."""
GROUPS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "angle": (("phi",), "rad"),
    "orientation": (("qx", "qy", "qz", "qw"), "1"),
    "position": (("px", "py", "pz"), "m"),
    "turning speed": (("dphi", "wx", "wy", "wz"), "rad/s"),
    "acceleration": (("ax", "ay", "apx", "apy", "apz"), "m/s²"),
}
"""Signals of the sensor frame that are drawn together."""


def recording_chart(recording: Recording) -> Chart:
    """Measured wrench above the motion, averaged over the repeats."""
    once, across = recording.samples_per_repeat, _across(recording)
    label = "pose, in the order of recording" if recording.at_rest else "time in one repeat (s)"
    units = {"f": "N", "t": "N m"}
    wrench = recording.averaged(recording.wrench)[:once]
    panels = []
    for kind, unit in units.items():
        series = {c: wrench[:, i] for i, c in enumerate(recording.channels) if c[0] == kind}
        panels.append(_series_panel({"f": "force", "t": "torque"}[kind], unit, series, across, poses=recording.at_rest))
    panels += motion_panels(recording)
    rows = tuple((_labelled(p, label, p is panels[-1]),) for p in panels)
    return Chart(rows=rows, row_height=UNIT_HEIGHT, shared_x=True, between_rows=24, width=1080, panel_legends=True)


def motion_panels(recording: Recording) -> list[Panel]:
    """Joint coordinates, else pose of the sensor; then its speed and acceleration."""
    once, across, signals = recording.samples_per_repeat, _across(recording), recording.signals
    groups = dict(GROUPS)
    if recording.joints:
        groups = {"joints": (numbered_names("q", recording.joints), joined_units(recording.arm))} | {
            k: v for k, v in GROUPS.items() if k in ("turning speed", "acceleration")
        }
    panels = []
    for name, (names, unit) in groups.items():
        moving = {n: signals[n][:once] for n in names if n in signals and np.ptp(signals[n][:once]) > 0}
        if moving:
            panels.append(_series_panel(name, unit, moving, across, poses=recording.at_rest))
    return panels


def fit_motion_chart(fit: Fit) -> Chart:
    """Motion of the first recording of a fit, and the information of its samples on what is identifiable."""
    recording, response = fit.recordings[0], fit.response(0)
    once, index = recording.samples_per_repeat, fit.layout.index[0]
    kept = [i for i, n in enumerate(index) if fit.identifiable[n] and not fit.unknowns[n].fixed]
    columns = response.derivative[:once, :, kept] / fit.noise[0].floor[:, None]
    names = [fit.unknowns[index[i]].name for i in kept]
    panels = [*motion_panels(recording), *information_panels(_across(recording), columns, names)]
    label = "pose, in the order of recording" if recording.at_rest else "time in one repeat (s)"
    return _chart(panels, label)


def trajectory_motion_chart(plan: ExcitingTrajectory) -> Chart:
    """Position, velocity and acceleration of the joints of a design, and the information of its samples."""
    time = plan.motion.series.instants(plan.samples)
    panels = trajectory_panels(plan.motion, plan.samples, plan.task.arm)
    panels += _information_panels_of(time, plan.sample_information)
    return _chart(panels, "time (s)")


def trajectory_panels(motion: Trajectory, samples: int, arm: Arm | None) -> list[Panel]:
    """Position, velocity and acceleration of the joints at so many samples."""
    time = motion.series.instants(samples)
    names, unit = numbered_names("q", motion.series.joints), joined_units(arm)
    return [
        _series_panel(name, unit + per, dict(zip(names, motion.derivative(time, order).T, strict=True)), time)
        for order, (name, per) in enumerate((("position", ""), ("velocity", "/s"), ("acceleration", "/s²")))
    ]


def information_panels(across: Array, columns: Array, names: list[str]) -> list[Panel]:
    """Of whitened sensitivities (N, p, k); none where they are singular."""
    try:
        return _information_panels_of(across, SampleInformation.of(columns, names))
    except InputError:
        return []


def _information_panels_of(across: Array, information: SampleInformation) -> list[Panel]:
    """Information of each sample over that of the mean sample, in total, and by parameter."""
    total = Line(x=across, y=information.total / information.total.mean(), colour="#8250B8", width=1.0, steps=True)
    shares = information.by_parameter * len(information.total)
    place, middle = averaged_columns(shares, across)
    heat = Heat(
        values=place.T, rows=information.names, x=middle, limits=(0.0, DARKEST), colours=INFORMATION_COLOURS,
        scale="mean sample = 1",
    )  # fmt: skip
    return [
        Panel(marks=(Level(y=1.0, dashed=True, note="mean sample"), total), y_label="information / mean"),
        Panel(marks=(heat,), title="Fisher information of each sample on each parameter, relative to the mean sample"),
    ]


def averaged_columns(shares: Array, across: Array) -> tuple[Array, Array]:
    """Means of `shares` (N, k) and of `across` (N,) over at most `MOST_SAMPLES` intervals of samples."""
    parts = np.array_split(np.arange(len(across)), min(MOST_SAMPLES, len(across)))
    return np.stack([shares[p].mean(axis=0) for p in parts]), np.array([across[p].mean() for p in parts])


def joined_units(arm: Arm | None) -> str:
    """The units of an arm's joints, each once: rad, or m of prismatic ones."""
    return "rad" if arm is None else " or ".join(dict.fromkeys(arm.units))


def _across(recording: Recording) -> Array:
    count = np.arange(recording.samples_per_repeat, dtype=np.float64)
    return count + 1 if recording.at_rest else count * sample_step(recording)


def _series_panel(name: str, unit: str, series: Mapping[str, Array], across: Array, *, poses: bool = False) -> Panel:
    several = len(series) > 1
    name = name if several else next(iter(series))
    draw = partial(Points, size=4.0) if poses else partial(Line, width=1.0)
    marks = tuple(
        draw(x=across, y=np.asarray(y), colour=joint_colour(i), label=label if several else "")
        for i, (label, y) in enumerate(series.items())
    )
    return Panel(marks=(Level(y=0.0, colour=MEASURED), *marks), y_label=axis_label(name, unit))


def _chart(panels: list[Panel], label: str) -> Chart:
    rows = tuple((_labelled(p, label, p is panels[-1]),) for p in panels)
    heights = tuple(_height(p) for p in panels)
    names = [len(n) for p in panels for m in p.marks if isinstance(m, Heat) for n in m.rows]
    mean = UNIT_HEIGHT * sum(heights) / len(heights)
    left = max([66.0, *(22 + 4.9 * n for n in names)])
    return Chart(rows=rows, heights=heights, row_height=mean, shared_x=True, between_rows=24, width=1080, left=left,
                 panel_legends=True)  # fmt: skip


def _height(panel: Panel) -> float:
    rows = [len(mark.rows) for mark in panel.marks if isinstance(mark, Heat)]
    return max(1.0, rows[0] / 8) if rows else 1.0


def _labelled(panel: Panel, label: str, last: bool) -> Panel:
    return replace(panel, x_label=label) if last else panel
