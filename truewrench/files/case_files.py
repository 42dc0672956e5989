"""Files of recordings as a case, and what the data decided of their frames in words."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import replace
from math import atan2, degrees
from pathlib import Path
from typing import Any

import numpy as np

from estimation.case import Case
from estimation.fit import doubted_loads
from estimation.reading.log_reading import read_with_rig
from estimation.reading.motion_evidence import motion_evidence
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.of_log import readings_of_logs
from estimation.recordings.motion import MotionForm
from estimation.recordings.recording import Recording, require_different_readings
from estimation.recordings.sign_convention import (
    SignDecision,
    nearest_quarter_turns,
)
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel, planar, spatial
from modeling.chain.sensor_axes import turn_words
from modeling.errors import InputError, quoted, suggestion
from modeling.rig import Convention, Rig
from modeling.rigid_body import Load


def read_case(
    training: Sequence[str],
    *,
    validation: Sequence[str] = (),
    rig: Rig | str | None = None,
    period: float | None = None,
    one_run: bool = False,
    read: Collection[str] = (),
    as_read: bool = False,
    loads: Sequence[tuple[str, Load]] = (),
) -> Case:
    """The case of these files, with the rigid tool for a model; `rig` is a rig, or the path of its file.

    `loads` are of files by their names, beside those that the rig states.
    `period`, s, is that of the training recordings' motion: others have their own. With `one_run` no repeats are looked
    for. Raises InputError for whatever cannot be used: a file, a recording given twice, recordings of different
    sensors, a convention that the data cannot decide.
    """
    description = rig if rig is None or isinstance(rig, Rig) else Rig.read(rig)
    if loads:
        description = _with_loads(description or Rig(), loads, (*training, *validation))
    periods = (*(period for _ in training), *(None for _ in validation))
    recordings = read_recordings((*training, *validation), rig=description, periods=periods, one_run=one_run)
    return rigid_tool_case(
        recordings[: len(training)], recordings[len(training) :], description, read=read, as_read=as_read
    )


def _with_loads(rig: Rig, loads: Sequence[tuple[str, Load]], files: Sequence[str]) -> Rig:
    """The rig with further loads; InputError for one of none of the files."""
    stated = replace(rig, loads=tuple(loads))
    for name, load in loads:
        if not any(load in stated.loads_of(file) for file in files):
            remedy = suggestion(name, [Path(file).name for file in files])
            raise InputError(what=f"no recording is called {quoted(name)}", where="--load", remedy=remedy)
    return replace(rig, loads=(*rig.loads, *loads))


def load_sentences(several: Sequence[Recording], model: WrenchModel | None = None) -> list[str]:
    """What recordings carried, what the rig states of none of them, and with a model what they do not weigh so."""
    sentences = [r.carried for r in several if r.loads]
    used = {load for recording in several for load in recording.loads}
    rigs = {name: load for r in several for name, load in (r.rig.loads if r.rig is not None else ())}
    idle = [name for name, load in rigs.items() if load not in used]
    if idle:
        sentences.append(f"The rig states loads of {', '.join(idle)}, of which no recording is given.")
    return sentences if model is None else [*sentences, *doubted_loads(model, several)]


def rigid_tool_case(
    training: Sequence[Recording],
    validation: Sequence[Recording],
    rig: Rig | None,
    *,
    read: Collection[str] = (),
    as_read: bool = False,
) -> Case:
    """The case of recordings of one sensor with the rigid tool of a rig; InputError as `Case.of`.

    InputError, too, for the id of a reading among `read` that the data do not show.
    """
    _require_one_sensor([*training, *validation])
    model = (planar if training[0].dimension == 2 else spatial)(rig)
    case = Case.of(model, training, validation, read=read, as_read=as_read)
    for reading in read:
        shown = {doubted.id: doubted for doubted in case.readings}
        if reading not in shown:
            what = f"the recordings do not show the reading {quoted(reading)}"
            raise InputError(
                what=what, where="--read", remedy=f"they show {', '.join(shown)}" if shown else "leave it out"
            )
        if not shown[reading].adopted:
            remedy = f"state {shown[reading].statement}"
            raise InputError(what=f"nothing says how {reading} is to be read", where="--read", remedy=remedy)
    return case


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


# ------------------------------------------------------------------ sign convention and gravity, in words

MEANINGS = {
    Convention.ON_TOOL: "the wrench that the sensor exerts on the tool (on_tool)",
    Convention.ON_SENSOR: "the wrench that the tool exerts on the sensor (on_sensor)",
}
"""What the readings are by their convention."""


OF_ROWS = ("static_dwells", "channel_frozen", "rezeroed", "noisy_stretch")
"""Ids of readings of which rows a run is: they leave gravity and the sign to be decided."""


def mounting_angle(sign: SignDecision) -> float:
    """Angle of the mounting rotation R, rad: R - R' is 2 sin(angle) of its axis, the trace 1 + 2 cos(angle)."""
    skew = sign.mounting - sign.mounting.T
    return atan2(float(np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]])), float(np.trace(sign.mounting)) - 1)


SUBTRACTED = (
    "Readings on_sensor from which a controller subtracts more than the tool weighs look the same, and a contact has"
    " the other sign then: state convention under [sensor] where that may be."
)
"""Most sensors read on_sensor, so that the other sign of a weight is worth a thought."""


def convention_sentence(sign: SignDecision, *, detailed: bool = False) -> str:
    """The decision as a sentence; a mounting nearer to a quarter turn than to none is said, too.

    `detailed`: with the mass and the mounting that the decision was made with.
    """
    decided = f"Sign convention decided from the data: the sensor reads {MEANINGS[sign.convention]}."
    turned = nearest_quarter_turns(sign.mounting) != ALIGNED_MOUNTING
    angle = turn_words(sign.mounting.T) if turned else f"{degrees(mounting_angle(sign)):.1f}°"
    estimate = f"turned by {angle} against the axes of the logged pose"
    if detailed:
        return f"{decided} First estimates, from the weight alone: mass {sign.mass:.4g} kg, sensor {estimate}."
    decided = f"{decided} By the weight alone the sensor is {estimate}." if turned else decided
    return f"{decided} {SUBTRACTED}" if sign.convention is Convention.ON_TOOL else decided


def convention_data(sign: SignDecision) -> dict[str, Any]:
    """The decision as data: kg, degrees, and the rotation (3, 3) from the axes of the logged pose to the sensor's."""
    return {
        "convention": sign.convention.value,
        "mass": sign.mass,
        "mounting_angle_deg": degrees(mounting_angle(sign)),
        "mounting": sign.mounting.tolist(),
    }


def frame_sentences(case: Case, *, detailed: bool = False) -> list[str]:
    """What the data decided of frames: gravity's direction, the sign convention; `detailed`, with its estimates."""
    sentences = [] if case.sign is None else [convention_sentence(case.sign, detailed=detailed)]
    sentences = [*load_sentences((*case.recordings, *case.held_out), case.model), *sentences]
    readings = [doubted.sentence for doubted in case.readings]
    if not all(doubted.adopted and (doubted.of_log or doubted.id in OF_ROWS) for doubted in case.readings):
        return [*readings, *([] if case.misread else sentences)]
    if case.doubted is not None:
        return [*readings, case.doubted.not_applied, *sentences]
    if case.gravity is None:
        return [*readings, *sentences]
    return [
        *readings,
        f"{case.gravity.sentence} To state it, write {case.gravity.stated} under [robot] in the rig.",
        *sentences,
    ]


def frames_data(case: Case) -> dict[str, Any]:
    """The same as data."""
    gravity = {} if case.gravity is None else {"gravity": case.gravity.to_data()}
    sign = {} if case.sign is None else {"sign": convention_data(case.sign)}
    several = (*case.recordings, *case.held_out)
    loads = {recording.name: [load.to_data() for load in recording.loads] for recording in several if recording.loads}
    return gravity | sign | {"readings": readings_data(case)} | ({"loads": loads} if loads else {})


def readings_data(case: Case) -> list[dict[str, Any]]:
    """Everything that the recordings are read by other than as usual, as data: gravity and mounting, too."""
    readings = [doubted.to_data() for doubted in case.readings]
    named = {doubted.id for doubted in case.readings}
    if case.misread:  # what the weight shows of frames then is of the mistake
        return readings
    if case.gravity is not None and "gravity_direction" not in named:
        gravity, statement = case.gravity, f"{case.gravity.stated} under [robot] of the rig"
        readings.append(_decided("gravity_direction", [*gravity.direction], gravity.sentence, statement))
    turned = case.sign is not None and case.model.mounting != ALIGNED_MOUNTING
    if case.sign is not None and turned and "sensor_turned" not in named:
        mounting = [[*row] for row in case.model.mounting]
        sentence, statement = convention_sentence(case.sign), "turn the wrench into the axes of the pose"
        readings.append(_decided("sensor_turned", mounting, sentence, statement))
    return readings


def _decided(identity: str, value: Any, sentence: str, statement: str) -> dict[str, Any]:
    """A reading that the weight decided before others were compared, as data."""
    adopted = DoubtedReading(id=identity, value=value, meaning=sentence, statement=statement, adopted=True)
    return adopted.to_data() | {"sentence": sentence}


def imported_frames(recording: Recording, *, detailed: bool = True) -> tuple[dict[str, Any], Case | None]:
    """Frames of an imported recording's columns, the readings that are shown, and the sign convention, as data.

    They are as `fit` will take the recording, in the case that is the other element; None where nothing decides.
    `detailed` adds what the weight alone shows.
    """
    rig = recording.rig or Rig()
    stated = rig.sensor.convention if rig.sensor.convention in MEANINGS else None
    how = "as the rig states" if stated else "unless the rig states otherwise"
    if recording.dimension == 2:
        axes = "Wrench: in the plane, in the sensor frame, about the sensor's origin."
        stated = stated or Convention.ON_TOOL
    else:
        motion = (
            "joint coordinates lead to the sensor frame"
            if recording.form is MotionForm.JOINTS
            else "qx, qy, qz, qw is the rotation of the logged pose in the base, v_base = R v_pose"
        )
        axes = f"Frames: force and torque in sensor axes, about the sensor's origin; {motion}."
    sign = [] if stated is None else [f"Sign convention: {MEANINGS[stated]}, {how}."]
    try:
        case = Case.of((planar if recording.dimension == 2 else spatial)(recording.rig), [recording])
    except InputError as error:
        undecided = f"Sign convention: undecided ({error.what}); {error.remedy}."
        evidence, of_log = motion_evidence(recording), readings_of_logs([recording])
        doubts = [] if evidence is None or not evidence.is_better else [f"{evidence.sentence}; {evidence.best.advice}."]
        return {
            "frames": [axes, *(doubted.sentence for doubted in of_log), *(sign or [undecided]), *doubts],
            "readings": [doubted.to_data() for doubted in of_log],
        }, None
    frames = [axes, *frame_sentences(case, detailed=detailed), *sign]
    return {"frames": frames, "readings": readings_data(case)}, case
