"""Case: the recordings of one rig and tool that a command is given, and the rigid model that they start from."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path
from typing import Any

from estimation.convention import SignDecision, decide_convention, decided
from estimation.reading import read
from estimation.recording import Recording
from modeling.errors import InputError
from modeling.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig


@dataclass(frozen=True, eq=False)
class Case:
    """Recordings and the model of the rigid tool, its convention decided.

    training    recordings to fit
    validation  recordings of other motions, never fitted
    sign        how the convention was decided from the data; None where it was stated
    """

    model: WrenchModel
    training: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    sign: SignDecision | None

    @classmethod
    def read(cls, training: Sequence[str], *, validation: Sequence[str] = (), rig: Rig | str | None = None) -> Case:
        """The case in these files; `rig` is one, or the path of its file.

        Raises InputError for whatever cannot be used: a file, a recording given twice, recordings of different
        sensors, a convention that the data cannot decide.
        """
        description = rig if rig is None or isinstance(rig, Rig) else Rig.read(rig)
        paths = [Path(p) for p in (*training, *validation)]
        _require_different(paths)
        recordings = [replace(read(p, rig=description), name=n) for p, n in zip(paths, labels(paths), strict=True)]
        _require_one_sensor(recordings)
        model = (planar if recordings[0].dimension == 2 else spatial)(description)
        sign = None
        if model.convention is Convention.AUTO:
            model, sign = _decided(model, recordings)
        count = len(training)
        return cls(model, tuple(recordings[:count]), tuple(recordings[count:]), sign)


def labels(paths: Sequence[Path]) -> list[str]:
    """A name for each file: its own, with as many of the folders before it as tell it from the others."""
    full = [_real(p).parts for p in paths]
    names = []
    for parts in full:
        others = [o for o in full if o != parts]
        length = next(n for n in range(1, len(parts) + 1) if all(o[-n:] != parts[-n:] for o in others))
        names.append("/".join(parts[-length:]))
    return names


def _real(path: Path) -> Path:
    """The path without links; one that leads in a circle stays, and is refused when it is read."""
    return Path(os.path.realpath(path))


def _require_different(paths: Sequence[Path]) -> None:
    seen = set()
    for path in paths:
        if _real(path) in seen:
            what = "the recording is given twice"
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


def _decided(model: WrenchModel, recordings: Sequence[Recording]) -> tuple[WrenchModel, SignDecision]:
    model = decided(model, recordings)  # refuses the plane, where two forces cannot decide
    return model, decide_convention(recordings, model.gravity)


# ------------------------------------------------------------------------------- a decision about signs


def mounting_angle(sign: SignDecision) -> float:
    """By how much the sensor is mounted turned, rad."""
    from scipy.spatial.transform import Rotation

    return float(Rotation.from_matrix(sign.mounting).magnitude())


def sign_sentence(sign: SignDecision) -> str:
    """The decision in words."""
    meaning = {
        Convention.ON_TOOL: "the wrench that the sensor exerts on the tool (on_tool)",
        Convention.ON_SENSOR: "the wrench that the tool exerts on the sensor (on_sensor)",
    }[sign.convention]
    return (
        f"The forces say that the sensor reads {meaning}, "
        f"of a mass of {sign.mass:.4g} kg, mounted turned by {degrees(mounting_angle(sign)):.1f}°."
    )


def sign_data(sign: SignDecision) -> dict[str, Any]:
    """The decision as numbers: kg, degrees, and the rotation (3, 3) from the motion's frame to the readings'."""
    return {
        "convention": sign.convention.value,
        "mass": sign.mass,
        "mounting_angle_deg": degrees(mounting_angle(sign)),
        "mounting": sign.mounting.tolist(),
    }
