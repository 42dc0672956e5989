"""Trajectory that separates two suspects: designed, drawn, and as a table to download."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pandas as pd

from design.discrimination import DiscriminationDesign, discriminate, rival_models
from design.limits import arm_and_limits
from design.trajectories.fourier import FreeSeries
from design.trajectory_design import STARTS_WHEN_SLOW
from diagnosis.study import Study
from modeling.effects import named
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import NoiseModel
from modeling.space import Space
from truewrench.plots.chart import Chart
from truewrench.plots.motion_plot import trajectory_panels
from truewrench.workbench.effect_estimates import effect_sizes

PLANE_RIG = """\
[robot]
link_lengths = [0.4, 0.3, 0.2]   # m

[limits]                         # of each joint, either way
position = [2.6, 2.4, 2.4]       # rad
velocity = [1.5, 1.5, 2.0]       # rad/s
acceleration = [4.0, 4.0, 6.0]   # rad/s²
"""
SPACE_RIG = """\
[robot]
urdf = "/home/me/arm.urdf"       # full path of the arm's description
sensor_frame = "ft_sensor"       # its link with the sensor's axes

[limits]                         # of each joint, either way
position = [3.1, 3.1, 3.1, 3.1, 3.1, 3.1]       # rad
velocity = [1.5, 1.5, 1.5, 2.0, 2.0, 2.0]       # rad/s
acceleration = [4.0, 4.0, 4.0, 6.0, 6.0, 6.0]   # rad/s²
"""
"""Rig files to start from: what a trajectory is designed for."""

HARMONICS, PERIOD, SAMPLES = 5, 5.0, 200
"""Of the trajectory: a Fourier series, s, and samples to a period."""


@dataclass(frozen=True, eq=False)
class Separation:
    """A discriminating trajectory between two effects; `assumed` is the size of the first, in words."""

    first: str
    second: str
    arm: Arm
    design: DiscriminationDesign
    assumed: str

    @property
    def chart(self) -> Chart | None:
        """Position, velocity and acceleration of the joints; None where no trajectory separates them."""
        motion = self.design.motion
        if motion is None:
            return None
        panels = trajectory_panels(motion, SAMPLES, self.arm)
        rows = tuple((replace(p, x_label="time (s)") if p is panels[-1] else p,) for p in panels)
        return Chart(rows=rows, row_height=150, shared_x=True)

    def table(self) -> str:
        """The trajectory as CSV, one row a sample; empty where there is none."""
        motion = self.design.motion
        if motion is None:
            return ""
        return str(pd.DataFrame(motion.to_columns(SAMPLES)).to_csv(index=False, float_format="%.12g"))


def undesignable(study: Study) -> str:
    """Why no trajectory can be designed for these recordings; empty where one can."""
    rig = study.fit.recordings[0].rig
    if rig is None:
        return "needs a rig file, with the arm and the limits of its joints: open the recording together with it"
    try:
        arm_and_limits(rig)
    except InputError as error:
        return f"{error.what}; {error.remedy}"
    return ""


def rig_template(space: Space) -> str:
    """A rig file to start from, for a sensor of this kind."""
    return PLANE_RIG if space is Space.PLANE else SPACE_RIG


def separation_of(study: Study, first: str, second: str, progress: Callable[[str], None]) -> Separation:
    """The trajectory within the rig's limits along which two effects differ most, given the current model.

    The first is taken as true, with the size that the recordings give it.

    Raises InputError for a recording without a rig, a rig without limits, and effects that cannot be designed for.
    """
    rig = study.fit.recordings[0].rig
    if rig is None:
        remedy = "open the recording together with its rig file"
        raise InputError(what="a trajectory is designed for a rig, and none is given", where="rig", remedy=remedy)
    arm, _ = arm_and_limits(rig)
    if first == second:
        raise InputError(what="both effects are the same", where="separate", remedy="choose two different ones")
    if first not in study.effects:
        progress(f"fit with {first}")
    trial = study.fit if first in study.effects else study.tried(first)
    effects = {effect.id: effect for effect in trial.model.effects}
    one, other = effects[first], effects.get(second) or named(second)
    truth, rival = rival_models(trial.model.designable, one, other)
    floor = trial.noise[0].floor
    progress(f"design the trajectory that separates {first} and {second}, half a minute or more")
    design = discriminate(
        rig, truth, trial.values, [rival],
        series=FreeSeries(joints=arm.joints, harmonics=tuple(range(1, HARMONICS + 1)), period=PERIOD),
        samples=SAMPLES, noise=NoiseModel.white([float(f) for f in floor]), starts=STARTS_WHEN_SLOW,
        progress=lambda stage: progress(f"trajectory that separates {first} and {second}: {stage}"),
    )  # fmt: skip
    return Separation(first, second, arm, design, effect_sizes(one, trial))
