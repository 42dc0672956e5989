"""Designed motions as robots play them: ROS 2 JointTrajectory, URScript, positions at 1 kHz; read back and checked."""

from __future__ import annotations

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from design.joint_torque import joint_torques
from design.limits import joint_units, use_at_rest
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError
from modeling.rig import Limits, Rig
from truewrench.files.output import atomic_write

Array = NDArray[np.float64]

AT_REST = 1e-6
"""rad/s: a motion that is slower at both ends starts and ends at rest."""
CHECKED = 10
"""Instants between two points of a file at which what a controller makes of it is compared with the design."""
DIGITS = 12
"""Decimals of an angle, rad: third differences at 1 kHz, which a controller compares with its limits of jerk, are then
off by 0.004 rad/s³ at most, by nine decimals by 4."""


@dataclass(frozen=True, eq=False)
class Points:
    """What a file says: times (n,) in s, positions (n, j), and velocities and accelerations where it has them."""

    time: Array
    positions: Array
    velocities: Array | None = None
    accelerations: Array | None = None

    def between(self, time: Array) -> Array:
        """Positions (m, j) at other times: quintic where velocities and accelerations are given, linear else."""
        place = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        span = (self.time[place + 1] - self.time[place])[:, None]
        s = (time - self.time[place])[:, None] / span
        start, end = self.positions[place], self.positions[place + 1]
        if self.velocities is None or self.accelerations is None:
            return start + s * (end - start)
        v0, v1 = self.velocities[place] * span, self.velocities[place + 1] * span
        a0, a1 = self.accelerations[place] * span**2, self.accelerations[place + 1] * span**2
        gap = end - start
        cubic = 10 * gap - 6 * v0 - 4 * v1 - (3 * a0 - a1) / 2
        quartic = -15 * gap + 8 * v0 + 7 * v1 + (3 * a0 - 2 * a1) / 2
        quintic = 6 * gap - 3 * (v0 + v1) - (a0 - a1) / 2
        return start + s * (v0 + s * (a0 / 2 + s * (cubic + s * (quartic + s * quintic))))


class PlayedFormat(ABC):
    """A file that a robot's controller plays, by its suffix.

    rate    Hz, of the controller that reads it; None where it interpolates between points at any times
    joints  that its robots have; None where they may have any number
    """

    suffix: ClassVar[str]
    title: ClassVar[str]
    rate: ClassVar[float | None] = None
    joints: ClassVar[int | None] = None

    @abstractmethod
    def text(self, points: Points, names: Sequence[str]) -> str:
        """The file, of joints with these names."""

    @abstractmethod
    def points(self, text: str) -> Points:
        """What the file says."""


class JointTrajectory(PlayedFormat):
    """ROS 2 trajectory_msgs/JointTrajectory in YAML, as `ros2 topic pub` takes it; quintic between its points."""

    suffix, title = ".yaml", "ROS 2 JointTrajectory"

    def text(self, points: Points, names: Sequence[str]) -> str:
        """The message."""
        assert points.velocities is not None
        assert points.accelerations is not None
        lines = [f"joint_names: {json.dumps(list(names))}", "points:"]
        series = zip(points.time, points.positions, points.velocities, points.accelerations, strict=True)
        for time, position, velocity, acceleration in series:
            nanoseconds = round(float(time) * 1e9)
            lines += [
                f"- positions: {_listed(position)}",
                f"  velocities: {_listed(velocity)}",
                f"  accelerations: {_listed(acceleration)}",
                f"  time_from_start: {{sec: {nanoseconds // 10**9}, nanosec: {nanoseconds % 10**9}}}",
            ]
        return "\n".join(lines) + "\n"

    def points(self, text: str) -> Points:
        """Of the four lines of each point."""

        def series(key: str) -> Array:
            return np.array([_numbers(row) for row in re.findall(rf"{key}: \[(.*)\]", text)])

        stamps = re.findall(r"sec: (\d+), nanosec: (\d+)", text)
        time = np.array([int(sec) + 1e-9 * int(nanosec) for sec, nanosec in stamps])
        return Points(time, series("positions"), series("velocities"), series("accelerations"))


class UrScript(PlayedFormat):
    """URScript: a joint move to the start, then `servoj` in every cycle of an e-Series controller."""

    suffix, title, rate, joints = ".script", "URScript, servoj at 500 Hz", 500.0, 6

    def text(self, points: Points, names: Sequence[str]) -> str:
        """The program."""
        lines = ["def truewrench_motion():", f"  movej({_listed(points.positions[0])})"]
        lines += [f"  servoj({_listed(row)}, t={1 / UrScript.rate:g})" for row in points.positions[1:]]
        return "\n".join([*lines, "  stopj(2)", "end", ""])

    def points(self, text: str) -> Points:
        """Of its joint positions, one a cycle."""
        rows = np.array([_numbers(row) for row in re.findall(r"(?:movej|servoj)\(\[(.*?)\]", text)])
        return Points(np.arange(len(rows)) / UrScript.rate, rows)


class Positions(PlayedFormat):
    """CSV of joint positions at 1 kHz, the rate at which libfranka's control loop asks for one."""

    suffix, title, rate = ".csv", "positions at 1 kHz", 1000.0

    def text(self, points: Points, names: Sequence[str]) -> str:
        """The table."""
        rows = np.column_stack([points.time, points.positions])
        head = ",".join(["time", *(f"q{i + 1}" for i in range(points.positions.shape[1]))])
        return "\n".join([head, *(",".join(f"{v:.{DIGITS}f}" for v in row) for row in rows), ""])

    def points(self, text: str) -> Points:
        """Of its rows."""
        rows = np.array([_numbers(row) for row in text.splitlines()[1:]])
        return Points(rows[:, 0], rows[:, 1:])


FORMATS: tuple[PlayedFormat, ...] = (JointTrajectory(), UrScript(), Positions())


def played_format(path: Path) -> PlayedFormat:
    """The format of a file's suffix; InputError for none."""
    chosen = next((kind for kind in FORMATS if kind.suffix == path.suffix.lower()), None)
    if chosen is None:
        known = ", ".join(f"{kind.suffix} ({kind.title})" for kind in FORMATS)
        what = f"no robot plays a file that is called {path.suffix or 'without suffix'}"
        raise InputError(what=what, where=str(path), remedy=f"give --play a name with {known}")
    return chosen


def require_rest(motion: Trajectory, path: Path) -> None:
    """InputError for a motion that is not at rest at both ends: a robot starts and ends so."""
    ends = np.abs(motion.evaluate([0.0, motion.series.duration])[1])
    if ends.max() > AT_REST:
        what = f"the motion starts or ends at {ends.max():.2g} rad/s, and a robot at rest"
        raise InputError(what=what, where=str(path), remedy="design it with --series rest")


def write_played(
    motion: Trajectory, path: Path, limits: Limits, names: Sequence[str], samples: int, rig: Rig | None = None
) -> str:
    """Write a motion for a robot; a sentence with the deviation and the use of limits of what was written, read back.

    A controller of a fixed rate gets a position in each of its cycles, another one `samples` points with velocities and
    accelerations. With the rig its workspace and clearances, and limits of torque, are checked too. Raises InputError
    for a motion that is not at rest at its ends, or whose file exceeds a limit.
    """
    kind = played_format(path)
    require_rest(motion, path)
    duration = motion.series.duration
    cycles = samples - 1 if kind.rate is None else round(duration * kind.rate)
    time = np.arange(cycles + 1) * (duration / cycles if kind.rate is None else 1 / kind.rate)
    time = np.minimum(time, duration)
    text = kind.text(Points(time, *motion.evaluate(time)), names)
    written = kind.points(text)
    fine = np.linspace(0.0, written.time[-1], cycles * CHECKED + 1)
    deviation = float(np.abs(written.between(fine) - motion.evaluate(fine)[0]).max())
    use = _limit_use(written, fine, limits, rig, coarse=kind.rate is not None)
    worst = max(use, key=lambda quantity: use[quantity])
    if use[worst] > 1 + LARGEST_EXCESS:
        what = f"what is written would use {use[worst]:.1%} of the {worst} limits"
        raise InputError(what=what, where=str(path), remedy="give more --samples, or tighten the limits of the rig")
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    unit = " or ".join(dict.fromkeys(joint_units(None if rig is None else rig.arm, motion.joints)))
    return (
        f"{path.name}: {kind.title}, {len(written.time)} points; between them it is at most {deviation:.2g} {unit} from"
        f" the design, and uses {use[worst]:.1%} of the {worst} limits at most."
    )


LARGEST_EXCESS = 1e-3
"""Of a limit, by which rounding and differences of a file may exceed it; the design keeps it exactly."""
JERK_STEP = 0.01
"""s: of the differences from which a jerk is told where a controller interpolates; the nanoseconds of the stamps make
those of a millisecond wrong by several rad/s³, these by hundredths."""


def _limit_use(points: Points, fine: Array, limits: Limits, rig: Rig | None, *, coarse: bool) -> dict[str, float]:
    """Largest share of each limit, by positions between the points and their differences.

    Of a controller of a fixed rate (`coarse`) by differences of its own cycles, as it differentiates them.
    """
    time = points.time if coarse else fine
    positions = points.positions if coarse else points.between(fine)
    step, arm = float(time[1] - time[0]), None if rig is None else rig.arm
    every = [1, 1, 1, 1 if coarse else max(1, ceil(JERK_STEP / step))]
    rates = [
        np.diff(positions[::apart], n=order, axis=0) / (apart * step) ** order
        for order, apart in enumerate(every[: len(limits.pairs)])
    ]
    use = {name: _share(rate, pairs) for rate, (name, pairs) in zip(rates, limits.pairs.items(), strict=True)}
    if arm is not None and (torques := joint_torques(limits, arm)) is not None:
        middle = (rates[1][1:] + rates[1][:-1]) / 2
        use["torque"] = _share(torques.values(positions[1:-1], middle, rates[2]), torques.room)
    if rig is not None and rig.workspace is not None:
        still = replace(limits, torque=None)
        use["workspace"] = float(use_at_rest(positions, still, rig.workspace, arm, rig.tip_length).max())
    return use


def _share(values: Array, limit: Array) -> float:
    """Largest distance from the middle of each range, over half of it."""
    middle, half = limit.mean(axis=1), np.ptp(limit, axis=1) / 2
    return float((np.abs(values - middle) / half).max())


def _listed(row: Array) -> str:
    return "[" + ", ".join(f"{value:.{DIGITS}f}" for value in row) + "]"


def _numbers(text: str) -> list[float]:
    return [float(cell) for cell in text.split(",")]
