"""Sign convention and mounting of six-axis readings from F = m Q (a - g), Q an orthogonal matrix.

Of a proper Q they are the sensor's wrench on the tool, of an improper one the tool's on the sensor. Whatever else acts
is in the residual of both, so that they are compared by which is nearer to the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from estimation.recordings.motion import QUATERNION
from estimation.recordings.reading_report import StepKind
from estimation.recordings.recording import Recording
from estimation.recordings.weight_fit import PulledTool, WeightFit, joined, weight_fit
from modeling.chain.model import ALIGNED_MOUNTING, QUARTER_TURNS, QuarterTurnRotation, WrenchModel
from modeling.errors import InputError
from modeling.kinematics.placement import COMPONENTS, quaternion_conjugate, rotated_vector
from modeling.rig import Convention
from modeling.space import Space

Array = NDArray[np.float64]


def in_sensor_frame(signals: Mapping[str, Array], vector: Sequence[Any]) -> Array:
    """A world vector of three components, numbers or (n,), in the sensor frame, (n, 3): R(q / |q|)' v.

    `scipy.spatial.transform` has it too, but its import takes longer than reading a recording.
    """
    quaternions = np.stack([signals[name] for name in COMPONENTS])
    unit = quaternions / np.linalg.norm(quaternions, axis=0)
    return np.stack(rotated_vector(quaternion_conjugate(unit), vector), axis=1)


def to_sensor_frame(quaternions: Array) -> Array:
    """Rotation matrices R(q / |q|)' (n, 3, 3) to the sensor frame from quaternions (n, 4), x y z w."""
    signals = dict(zip(COMPONENTS, quaternions.T, strict=True))
    return np.stack([in_sensor_frame(signals, axis) for axis in np.eye(3).tolist()], axis=2)


SIGN_REMEDY = 'state convention = "on_tool" or "on_sensor" under [sensor] in the rig, or add poses in more orientations'
POSITION = ("px", "py", "pz")
FLATTEST = 0.05
"""Smallest spread of gravity's directions in the sensor, of which three have to be seen, over gravity."""


@dataclass(frozen=True, eq=False)
class SignDecision:
    """Sign convention, and mass and mounting from the least-squares fit F = B (a - g) + bias, B a free 3 x 3 matrix.

    convention  from the better of the fits by a proper and an improper rotation, whatever the mounting
    mass        |det B|^(1/3), kg
    mounting    (3, 3) rotation from the frame of the motion to the sensor's readings, the polar factor of ±B
    """

    convention: Convention
    mass: float
    mounting: Array


def decide_convention(recordings: Sequence[Recording], gravity: float) -> SignDecision:
    """Decide the sign of six-axis readings from forces alone.

    Raises InputError when gravity in the sensor frame does not span three directions, or neither sign is shown.
    """
    specific_force = np.concatenate([_centred(_specific_force(r, gravity)) for r in recordings])
    force = np.concatenate([_centred(r.wrench[:, :3]) for r in recordings])
    spread = np.linalg.svd(specific_force, compute_uv=False)
    if len(specific_force) < 5 or spread[-1] < FLATTEST * gravity:
        raise _undecided("gravity in the sensor frame does not span three directions", recordings)
    fits = {sign: weight_fit(specific_force, force, sign=sign) for sign in (1, -1)}
    sign = max(fits, key=lambda sign: fits[sign].explained)
    if not fits[sign].is_nearer_than(fits[-sign]):
        raise _undecided(_reason(fits[1], fits[-1]), recordings)
    matrix = np.linalg.lstsq(specific_force, force, rcond=None)[0].T
    rotation, _ = scipy.linalg.polar(sign * matrix)
    rotation = rotation if np.linalg.det(rotation) > 0 else sign * fits[sign].mounting
    if nearest_quarter_turns(rotation) != ALIGNED_MOUNTING:
        sign, rotation = _aligned_beside_cable(recordings, gravity) or (sign, rotation)
    convention = Convention.ON_TOOL if sign > 0 else Convention.ON_SENSOR
    return SignDecision(convention, float(abs(np.linalg.det(matrix)) ** (1 / 3)), np.asarray(rotation))


def _aligned_beside_cable(recordings: Sequence[Recording], gravity: float) -> tuple[int, Array] | None:
    """Sign and mounting (3, 3) of a sensor that is aligned, where a cable on the tool beside it explains the forces
    better than a sensor that is mounted turned; else None."""
    if any(name not in r.signals for r in recordings for name in POSITION):
        return None
    tool = joined([_pulled_tool(recording, gravity) for recording in recordings])
    sign = 1 if np.linalg.det(tool.pulled.mounting) > 0 else -1
    mounting = np.asarray(sign * tool.pulled.mounting)
    aligned = nearest_quarter_turns(mounting) == ALIGNED_MOUNTING
    return (sign, mounting) if aligned and tool.pulled.is_nearer_than(tool.weight) else None


def _pulled_tool(recording: Recording, gravity: float) -> PulledTool:
    signals = recording.signals
    quaternions, position, acceleration = (
        np.stack([signals[name] for name in names], axis=1) for names in (QUATERNION, POSITION, ("apx", "apy", "apz"))
    )
    specific = acceleration + gravity * np.array([0.0, 0.0, 1.0])
    return PulledTool.of(to_sensor_frame(quaternions), position, specific, recording.wrench[:, :3])


def _reason(on_tool: WeightFit, on_sensor: WeightFit) -> str:
    """Why neither sign is shown."""
    best = max(on_tool, on_sensor, key=lambda fit: fit.explained)
    if best.shows_no_weight:
        share = f"{max(100 * best.explained, 0.0):.2g} % of the forces' power"
        return f"at most {share} is a weight that turns with the sensor: compensated already, or hidden by contact"
    text = "a weight on the sensor explains the forces as well as one with the other sign"
    return f"{text} ({100 * on_tool.explained:.3g} and {100 * on_sensor.explained:.3g} % of their power)"


def _undecided(reason: str, recordings: Sequence[Recording]) -> InputError:
    """The error, with what is suspicious in the readings, which may be why."""
    doubts = [step.what for r in recordings if r.reading is not None for step in r.reading.of(StepKind.SUSPICIOUS)]
    what = f"the sign convention cannot be decided: {reason}" + "".join(f"; {doubt}" for doubt in doubts[:1])
    return InputError(what=what, where=", ".join(r.name for r in recordings), remedy=SIGN_REMEDY)


def with_convention(model: WrenchModel, recordings: Sequence[Recording]) -> tuple[WrenchModel, SignDecision | None]:
    """The model with its convention, and the quarter turns of its mounting, decided from the recordings where AUTO.

    Without an arm it takes that of the recordings. The decision is None where the model states its convention. Raises
    InputError when the data cannot decide, and for planar models, whose two forces never can.
    """
    model = model.with_arm(next((r.arm for r in recordings if r.arm is not None), None))
    if model.convention is not Convention.AUTO:
        return model, None
    if model.space is Space.PLANE:
        raise InputError(
            what="two forces cannot distinguish the sign convention from a sensor mounted turned by half a turn",
            where="convention auto",
            remedy='state convention = "on_tool" or "on_sensor" under [sensor] in the rig',
        )
    decision = decide_convention(recordings, model.gravity)
    decided = replace(model, convention=decision.convention, mounting=nearest_quarter_turns(decision.mounting))
    return decided, decision


def nearest_quarter_turns(rotation: Array) -> QuarterTurnRotation:
    """The rotation by quarter turns about the axes that comes nearest to a rotation (3, 3)."""
    return max(QUARTER_TURNS, key=lambda turn: float((np.array(turn) * rotation).sum()))


def _specific_force(recording: Recording, gravity: float) -> Array:
    """Acceleration minus gravity in the sensor frame (n, 3): R(q)' (a + g z)."""
    signals = recording.signals
    return in_sensor_frame(signals, (signals["apx"], signals["apy"], signals["apz"] + gravity))


def _centred(rows: Array) -> Array:
    """Rows (n, 3) about their mean, each recording weighted as one row, so that long runs do not dominate poses."""
    return np.asarray((rows - rows.mean(axis=0)) / np.sqrt(len(rows)))
