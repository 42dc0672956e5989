"""Data set: training and validation recordings of one rig and tool, rigid-tool model, sign convention."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan2, degrees
from pathlib import Path
from typing import Any

import numpy as np

from estimation.fit import Fit
from estimation.gravity.gravity_direction import with_fitted_tilt, with_gravity_direction
from estimation.gravity.gravity_estimate import GravityEstimate
from estimation.reading.log_reading import read_with_rig
from estimation.recordings.recording import MotionForm, Recording, require_different_readings
from estimation.recordings.sign_convention import (
    SignDecision,
    nearest_quarter_turns,
    with_convention,
)
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel, planar, spatial
from modeling.effects.loads import CableSpring
from modeling.errors import InputError
from modeling.rig import Convention, Rig


@dataclass(frozen=True, eq=False)
class DataSet:
    """Training and validation recordings, and the rigid-tool model with its sign convention.

    training    recordings to fit
    validation  recordings of other motions, not fitted
    sign        decision on the sign convention from the data; None where the rig file states it
    gravity     direction of gravity in base axes where the data decided it; None where it is stated, or points down
    doubted     another direction than down that the data suggest, and that is not applied; None where they do not
    """

    model: WrenchModel
    training: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    sign: SignDecision | None
    gravity: GravityEstimate | None
    doubted: GravityEstimate | None = None

    @classmethod
    def read(
        cls,
        training: Sequence[str],
        *,
        validation: Sequence[str] = (),
        rig: Rig | str | None = None,
        period: float | None = None,
        one_run: bool = False,
    ) -> DataSet:
        """Data set of these files; `rig` is a rig, or the path of its file; with `one_run` no repeats are looked for.

        `period`, s, is that of the training recordings' motion: others have their own.

        Raises InputError for whatever cannot be used: a file, a recording given twice, recordings of different
        sensors, a convention that the data cannot decide.
        """
        description = rig if rig is None or isinstance(rig, Rig) else Rig.read(rig)
        periods = (*(period for _ in training), *(None for _ in validation))
        files = (*training, *validation)
        recordings = read_recordings(files, rig=description, periods=periods, one_run=one_run)
        return cls.of(recordings[: len(training)], recordings[len(training) :], description)

    @classmethod
    def of(cls, training: Sequence[Recording], validation: Sequence[Recording], description: Rig | None) -> DataSet:
        """Data set of recordings of one sensor; InputError for a convention that the data cannot decide."""
        recordings = [*training, *validation]
        _require_one_sensor(recordings)
        model = (planar if recordings[0].dimension == 2 else spatial)(description)
        case, count = with_gravity_direction(model, recordings), len(training)
        model, sign = with_convention(case.model, case.recordings)
        return cls(model, case.recordings[:count], case.recordings[count:], sign, case.found, case.doubted)


def read_recordings(
    files: Sequence[str],
    *,
    rig: Rig | None,
    periods: Sequence[float | None] | None = None,
    one_run: bool = False,
) -> list[Recording]:
    """Recordings of one sensor, each under its file's label; with `one_run` no repeats are looked for.

    `periods` (s) of the files' motion cut them into repeats; by default, and where None, as `read` does.

    Raises InputError for a file that cannot be used, one given twice, and recordings of different sensors.
    """
    paths = [Path(file) for file in files]
    require_different(paths, "the recording is given twice")
    recordings = [
        replace(read_with_rig(path, rig=rig, period=period, one_run=one_run), name=name)
        for path, name, period in zip(paths, file_labels(paths), periods or [None] * len(paths), strict=True)
    ]
    require_different_readings(recordings, "REC")
    return recordings


def file_labels(paths: Sequence[Path]) -> list[str]:
    """Unique label of each file: its name, preceded by as many parent folders as needed."""
    full = [_real(p).parts for p in paths]
    names = []
    for parts in full:
        others = [o for o in full if o != parts]
        length = next(n for n in range(1, len(parts) + 1) if all(o[-n:] != parts[-n:] for o in others))
        names.append("/".join(parts[-length:]))
    return names


def _real(path: Path) -> Path:
    """The path with symbolic links resolved; a circular link stays, and reading it is an error."""
    return Path(os.path.realpath(path))


def require_different(paths: Sequence[Path], what: str) -> None:
    """Raise InputError, with `what` is wrong, for a file given twice."""
    seen = set()
    for path in paths:
        if _real(path) in seen:
            raise InputError(what=what, where=str(path), remedy="give each once; validate with another motion")
        seen.add(_real(path))


def _require_one_sensor(recordings: Sequence[Recording]) -> None:
    first = recordings[0]
    for other in recordings[1:]:
        if other.channels != first.channels:
            raise InputError(
                what=f"its channels are {', '.join(other.channels)}, those of {first.name} {', '.join(first.channels)}",
                where=other.name,
                remedy="give recordings of one sensor",
            )


# ------------------------------------------------------------------------------- sign convention

MEANINGS = {
    Convention.ON_TOOL: "the wrench that the sensor exerts on the tool (on_tool)",
    Convention.ON_SENSOR: "the wrench that the tool exerts on the sensor (on_sensor)",
}
"""What the readings are by their convention."""


def mounting_angle(sign: SignDecision) -> float:
    """Angle of the mounting rotation R, rad: R - R' is 2 sin(angle) of its axis, the trace 1 + 2 cos(angle)."""
    skew = sign.mounting - sign.mounting.T
    return atan2(float(np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]])), float(np.trace(sign.mounting)) - 1)


def convention_sentence(sign: SignDecision, *, detailed: bool = False) -> str:
    """The decision as a sentence; a mounting nearer to a quarter turn than to none is said, too.

    `detailed`: with the mass and the mounting that the decision was made with.
    """
    decided = f"Sign convention decided from the data: the sensor reads {MEANINGS[sign.convention]}"
    turned = f"turned by {degrees(mounting_angle(sign)):.1f}° against the axes of the motion"
    if detailed:
        return f"{decided}. First estimates, from the weight alone: mass {sign.mass:.4g} kg, sensor {turned}."
    if nearest_quarter_turns(sign.mounting) != ALIGNED_MOUNTING:
        return f"{decided}, {turned}."
    return f"{decided}."


def convention_data(sign: SignDecision) -> dict[str, Any]:
    """The decision as data: kg, degrees, and the rotation (3, 3) from the frame of the motion to the readings'."""
    return {
        "convention": sign.convention.value,
        "mass": sign.mass,
        "mounting_angle_deg": degrees(mounting_angle(sign)),
        "mounting": sign.mounting.tolist(),
    }


def with_fitted_gravity(case: DataSet, fitted: Fit) -> DataSet:
    """The case with the direction of gravity that the data decided turned by the tilt fitted beside the tool.

    A direction that is doubted for a cable on the tool is dropped where the fit has that cable.
    """
    if case.doubted is not None and any(effect.id == CableSpring.id for effect in fitted.model.effects):
        return replace(case, doubted=None)
    if case.gravity is None:
        return case
    return replace(case, gravity=with_fitted_tilt(case.gravity, fitted.model, fitted.values))


def frame_sentences(case: DataSet, *, detailed: bool = False) -> list[str]:
    """What the data decided of frames: gravity's direction, the sign convention; `detailed`, with its estimates."""
    sentences = [] if case.sign is None else [convention_sentence(case.sign, detailed=detailed)]
    if case.doubted is not None:
        return [case.doubted.not_applied, *sentences]
    if case.gravity is None:
        return sentences
    return [f"{case.gravity.sentence} To state it, write {case.gravity.stated} under [robot] in the rig.", *sentences]


def frames_data(case: DataSet) -> dict[str, Any]:
    """The same as data."""
    gravity = {} if case.gravity is None else {"gravity": case.gravity.to_data()}
    return gravity | ({} if case.sign is None else {"sign": convention_data(case.sign)})


def imported_frames(recording: Recording) -> list[str]:
    """Frames of an imported recording's columns, and the sign convention of its readings, as `fit` will take it."""
    if recording.dimension == 2:
        axes = "Wrench: in the plane, in the sensor frame, about the sensor's origin."
        stated = None if recording.rig is None else recording.rig.sensor.convention
        convention = stated or Convention.ON_TOOL
        how = "as the rig states" if stated else "unless the rig states otherwise"
        return [axes, f"Sign convention: {MEANINGS[convention]}, {how}."]
    motion = (
        "joint coordinates lead to the sensor frame"
        if recording.form is MotionForm.JOINTS
        else "qx, qy, qz, qw is the rotation of the sensor frame in the base, v_base = R v_sensor"
    )
    return [
        f"Frames: force and torque along the sensor frame's axes, about its origin; {motion}.",
        *_sign_of(recording),
    ]


def _sign_of(recording: Recording) -> list[str]:
    """The sign convention that the rig states, or that the weight in the data decides."""
    rig = recording.rig
    if rig is not None and rig.sensor.convention in MEANINGS:
        return [f"Sign convention: {MEANINGS[rig.sensor.convention]}, as the rig states."]
    try:
        found = with_gravity_direction(spatial(rig), [recording])
        _, sign = with_convention(found.model, found.recordings)
    except InputError as error:
        return [f"Sign convention: undecided ({error.what}); {error.remedy}."]
    gravity = [] if found.found is None else [found.found.sentence]
    return [*gravity, *([] if sign is None else [convention_sentence(sign, detailed=True)])]
