"""Recording: measured wrench and motion, and the motion signals that are inputs of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.motion import CLOCK_OFFSET, Motion, MotionColumns, MotionForm, motion_columns
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.rig import PLANAR_CHANNELS, Rig
from modeling.rigid_body import Load
from modeling.space import Space
from modeling.table import Column, Table, Tabular, Value

if TYPE_CHECKING:
    import pandas as pd

    from estimation.recordings.dwells import Dwells
    from estimation.recordings.reading_report import ReadingReport
    from modeling.chain.model import WrenchModel


Array = NDArray[np.float64]

CHANNELS_REMEDY = "use planar() for fx, fy, tau and spatial() for six axes"


@dataclass(frozen=True, eq=False)
class WholeLog:
    """All rows of a log of which a recording has whole repeats: `recording`, one run, and the rows first <= i < last of
    the repeats in it."""

    recording: Recording
    first: int
    last: int

    @property
    def left_out(self) -> tuple[tuple[int, int], ...]:
        """Rows that are none of the repeats, as first <= i < last."""
        ends = ((0, self.first), (self.last, self.recording.samples))
        return tuple((begin, end) for begin, end in ends if end > begin)

    @property
    def share(self) -> float:
        """Share of the rows that the repeats are."""
        return (self.last - self.first) / self.recording.samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording(Tabular):
    """Samples of a wrench and of the motion, as recorded; `read` gives it.

    Parameters
    ----------
    name : str
        Name of the file, for messages and recording-specific parameters (`bias_fx@name`).
    channels : tuple of str
        fx, fy, tau in the plane; fx, fy, fz, tx, ty, tz in six axes.
    wrench : array (n, p)
        Readings in N and N m, in the order of the channels, with the sensor's signs.
    motion : Motion
        Everything else that was recorded: joint angles, planar pose or pose, with the signals derived from it.
    reading : ReadingReport, optional
        How a log became this recording; by default none, as for a file with the columns of a recording.
    whole : WholeLog, optional
        The log with the rows outside the repeats that were cut; by default none, as where all rows are used.
    moved_as_measured : bool, optional
        Whether the readings show that each repeat moved in its own way, where the repeats differ beyond noise; by
        default None, as before that is decided (`estimation.case.prepared`). If not, a model takes the mean motion.
    dwells : Dwells, optional
        The dwells of a log whose means the static poses are; by default none, as where each row is a pose.

    Examples
    --------
    >>> import truewrench as tw
    >>> recording = tw.read("train.csv", rig=tw.Rig.read("rig.toml"))
    >>> recording.samples, recording.repeats, round(recording.dt, 6)
    (4000, 8, 0.01)
    >>> sorted(recording.signals)[:4], recording.signals["ddphi"].shape
    (['ax', 'ay', 'ddphi', 'ddq1'], (4000,))
    """

    name: str
    channels: tuple[str, ...]
    wrench: Array
    motion: Motion
    reading: ReadingReport | None = None
    whole: WholeLog | None = None
    moved_as_measured: bool | None = None
    dwells: Dwells | None = None

    def __repr__(self) -> str:
        length = "poses at rest" if self.dt is None else f"samples at {1 / self.dt:.6g} Hz"
        runs = f"{self.repeats} x " if self.repeats > 1 else ""
        used = motion_columns(self.form, self.joints)
        names = "motion " + " ".join(name for name in used if name in self.columns)
        if self.auxiliary:
            names += f"; auxiliary signals {' '.join(self.auxiliary)}"
        if self.loads:
            names += f"; carries {' and '.join(map(str, self.loads))}"
        return f"Recording {self.name!r}: {runs}{self.samples_per_repeat} {length}, {' '.join(self.channels)}; {names}"

    def __str__(self) -> str:
        return repr(self)

    @property
    def table(self) -> Table:
        """Smallest value, mean, largest value and std of each channel and column, SI."""
        numbers = (Column(name, format=".4g") for name in ("smallest", "mean", "largest", "std"))
        series = dict(zip(self.channels, self.wrench.T, strict=True)) | dict(self.columns)
        rows: list[tuple[Value, ...]] = [
            (name, *(float(f(y)) for f in (np.min, np.mean, np.max, np.std))) for name, y in series.items()
        ]
        return Table.of(("column", *numbers), rows)

    def printed(self) -> list[Table | str]:
        """What it is, then its columns."""
        return [repr(self), self.table]

    def to_frame(self) -> pd.DataFrame:
        """Time, repeat, wrench and every other column as a data frame, which `from_dataframe` takes."""
        import pandas as pd

        frame = {} if self.time is None else {"time": np.arange(self.samples) * (self.dt or 1.0)}
        if self.repeats > 1:
            frame["repeat"] = np.repeat(np.arange(self.repeats), self.samples_per_repeat)
        return pd.DataFrame(frame | dict(zip(self.channels, self.wrench.T, strict=True)) | dict(self.columns))

    def to_data(self) -> dict[str, Any]:
        """Name and columns as plain data; `from_dataframe` takes a data frame of the columns."""
        columns = {name: column.tolist() for name, column in self.to_frame().items()}
        return {"name": self.name, "continuous": self.continuous, "columns": columns}

    @property
    def samples(self) -> int:
        """The number of rows n."""
        return len(self.wrench)

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in six axes."""
        return 2 if self.channels == PLANAR_CHANNELS else 3

    @property
    def columns(self) -> Mapping[str, Array]:
        """Everything but wrench, time and repeat that was recorded, (n,) each, SI, as read."""
        return self.motion.recorded.columns

    @property
    def time(self) -> Array | None:
        """Uniform times (n,) in s, from 0 on, in every repeat when they are separate runs; None for static poses."""
        return self.motion.recorded.time

    @property
    def dt(self) -> float | None:
        """Sampling interval in s; None for static poses."""
        return self.motion.recorded.dt

    @property
    def at_rest(self) -> bool:
        """Whether every row is a static pose."""
        return self.motion.recorded.at_rest

    @property
    def repeats(self) -> int:
        """How often the motion was run, with n / repeats samples each."""
        return self.motion.recorded.repeats

    @property
    def samples_per_repeat(self) -> int:
        """Rows in one repeat, n when there is only one."""
        return self.motion.recorded.samples_per_repeat

    @property
    def continuous(self) -> bool:
        """Whether the repeats follow each other without a pause."""
        return self.motion.recorded.continuous

    @property
    def form(self) -> MotionForm:
        """How the motion was recorded: joint angles, planar pose or pose."""
        return self.motion.form

    @property
    def rig(self) -> Rig | None:
        """The rig with its kinematics and its base; None without one."""
        return self.motion.rig

    @property
    def arm(self) -> Arm | None:
        """Kinematics from the joints to the sensor; None when the motion was recorded as poses."""
        return self.motion.arm

    @property
    def joints(self) -> int:
        """Number of recorded joints, 0 when the motion was recorded as poses."""
        return self.motion.joints

    @property
    def clock_offset(self) -> float | None:
        """Offset of the wrench's clock, s, that was estimated when the log was imported; None without one."""
        offset = self.columns.get(CLOCK_OFFSET)
        return None if offset is None else float(offset[0])

    @property
    def auxiliary(self) -> tuple[str, ...]:
        """Columns that are not part of the motion, such as a temperature."""
        return self.motion.auxiliary

    @property
    def signals(self) -> Mapping[str, Array]:
        """Inputs of a model by name, each (n,), in the world: `Motion.signals`."""
        return self.motion.signals

    @property
    def own_motion(self) -> Motion | None:
        """The motion of each repeat; None where the repeats are equal within noise, or not shown to have moved so."""
        return None if self.moved_as_measured is False else self.motion.of_each_repeat

    def is_reading_of(self, other: Recording) -> bool:
        """Whether it is another recording as a case reads it: the same but for what was not decided of the other.

        That is gravity's direction, whether the repeats moved in their own way, and the dwells of a run as poses. Same
        readings of another motion, or on another rig, are another recording, of which a model predicts something else.
        """
        if self.dwells is not None and other.dwells is None:
            return self.dwells.wrench is other.wrench
        if self.wrench is not other.wrench or self.motion.recorded is not other.motion.recorded:
            return False
        own, rig = self.rig or Rig(), other.rig or Rig()
        mounted = rig if rig.gravity_direction is not None else replace(rig, gravity_direction=own.gravity_direction)
        same_base = mounted.arm == own.arm and mounted.gravity_direction == own.gravity_direction
        same_motion = same_base and self.form is other.form and self.loads == other.loads
        return same_motion and other.moved_as_measured in (None, self.moved_as_measured)

    @property
    def loads(self) -> tuple[Load, ...]:
        """What the sensor carried beside the tool; an unknown body makes it another tool."""
        return self.motion.loads

    @property
    def tool(self) -> str:
        """Name of the tool: of the unknown bodies that the sensor carried, empty for the tool alone."""
        return "+".join(load.name for load in self.loads if not load.known)

    @property
    def carried(self) -> str:
        """A sentence of what the sensor carried, empty for the tool alone."""
        return f"{self.name} carries {' and '.join(map(str, self.loads))} beside the tool." if self.loads else ""

    def carrying(self, *loads: Load | str) -> Recording:
        """The recording of a sensor that carried these beside the tool.

        A load is a `Load`, a text such as "2.000+-0.001@0,0,0.05" (MASS@X,Y,Z, kg and m in the sensor frame), or the
        name of an unknown body. Raises InputError for anything else.
        """
        carried = tuple(map(Load.of, loads))
        for number, load in enumerate(carried):
            if load in carried[:number]:
                remedy = "state it once; two of a kind as one of their mass, or each by a name"
                raise InputError(what=f"the load {load} is stated twice", where=self.name, remedy=remedy)
            if load.known:
                load.moments(Space(self.dimension))  # raises for coordinates of another space
        return self.moved(loads=carried)

    def averaged(self, series: Array) -> Array:
        """Series (n, k) averaged over the repeats, the average repeated to n samples."""
        return self.motion.recorded.averaged(series)

    def with_readings(self, wrench: Array) -> Recording:
        """The same motion with other readings (n, p); there are none outside the repeats of a log that was cut."""
        return replace(self, wrench=wrench, whole=None)

    def at_dwells(self, dwells: Dwells) -> Recording:
        """The dwells of its rows as static poses: readings and motion averaged, with the noise of the means."""
        recorded = MotionColumns(dwells.mean_columns(self.columns), None, instants=dwells.instants)
        return replace(
            self, wrench=dwells.means(dwells.wrench), motion=replace(self.motion, recorded=recorded), whole=None,
            moved_as_measured=None, dwells=dwells,
        )  # fmt: skip

    def moved(self, **parts: Any) -> Recording:
        """The same readings with these parts of the motion replaced: columns, time, repeats, continuous, form, rig.

        Whether repeats of other columns moved in their own way is undecided again.
        """
        recorded = {f.name: parts.pop(f.name) for f in fields(MotionColumns) if f.name in parts}
        if recorded:
            now = self.motion.recorded
            parts["recorded"] = replace(now, **{"derivatives": {}, "held": {}, **recorded})
        decided = None if recorded else self.moved_as_measured
        return replace(self, motion=replace(self.motion, **parts), moved_as_measured=decided)

    def drawn_motions(self, rng: np.random.Generator, count: int) -> Recording:
        """`count` runs with motions at random from what the samples leave open, one after another in one recording.

        Auxiliary columns are in every run as they were recorded. The motion jumps between the runs, so that of several
        only what depends on single samples can be predicted.
        """
        motion = replace(self.motion, recorded=self.motion.recorded.drawn(rng, count))
        return replace(self, wrench=np.tile(self.wrench, (count, 1)), motion=motion)


def readings_digest(recording: Recording) -> str:
    """SHA-256 of a recording's readings, by which a calibration or a model file recognises its own."""
    return sha256(np.ascontiguousarray(recording.wrench, dtype="<f8").tobytes()).hexdigest()


def require_different_readings(recordings: Sequence[Recording], where: str) -> None:
    """InputError for readings that were given twice: their agreement with themselves would count as evidence."""
    names: dict[str, str] = {}
    for recording in recordings:
        digest = readings_digest(recording)
        if digest in names:
            what = f"{recording.name} has the same readings as {names[digest]}: one recording given twice"
            raise InputError(what=what, where=where, remedy="give each recording once; validate with another motion")
        names[digest] = recording.name


def require_channels(recording: Recording, model: WrenchModel) -> None:
    """Raise InputError when a recording's channels are not those of the model."""
    if recording.channels != model.channels:
        raise InputError(
            what=f"its channels are {', '.join(recording.channels)}, the model's {', '.join(model.channels)}",
            where=recording.name,
            remedy=CHANNELS_REMEDY,
        )
