"""Sign convention and mounting of six-axis readings from F = B (a - g), B a free 3 x 3 matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import polar

from estimation.recordings.recording import Recording
from modeling.chain.model import QUARTER_TURNS, QuarterTurnRotation, WrenchModel
from modeling.errors import InputError
from modeling.rig.rig import Convention
from modeling.space import Space

Array = NDArray[np.float64]

SIGN_REMEDY = 'state convention = "on_tool" or "on_sensor" under [sensor] in the rig, or add poses in more orientations'


@dataclass(frozen=True, eq=False)
class SignDecision:
    """Sign convention, mass and mounting from the least-squares fit F = B (a - g) + bias, B a free 3 x 3 matrix.

    convention  from the sign of det B, whatever the mounting
    mass        |det B|^(1/3), kg, and `significance`, the smallest singular value of B over its standard error
    mounting    (3, 3) rotation from the frame of the motion to the sensor's readings, the polar factor of ±B
    """

    convention: Convention
    mass: float
    significance: float
    mounting: Array


def decide_convention(recordings: Sequence[Recording], gravity: float) -> SignDecision:
    """Decide the sign of six-axis readings from forces alone.

    Raises InputError when gravity in the sensor frame does not span three directions, or B is not significant.
    """
    specific_force = np.concatenate([_centred(_specific_force(r, gravity)) for r in recordings])
    force = np.concatenate([_centred(r.wrench[:, :3]) for r in recordings])
    where = ", ".join(r.name for r in recordings)
    spread = np.linalg.svd(specific_force, compute_uv=False)
    if len(specific_force) < 5 or spread[-1] < 0.05 * gravity:
        raise InputError(
            what="the sign convention cannot be decided: gravity in the sensor frame does not span three directions",
            where=where,
            remedy=SIGN_REMEDY,
        )
    solution, *_ = np.linalg.lstsq(specific_force, force, rcond=None)
    matrix = solution.T
    variance = ((force - specific_force @ solution) ** 2).sum(axis=0) / max(1, _independent_samples(recordings) - 4)
    error = np.sqrt(variance.max()) / spread[-1]
    singular = np.linalg.svd(matrix, compute_uv=False)
    significance = float(singular[-1] / max(error, 1e-300))
    if significance < 5:
        raise InputError(
            what="the sign convention cannot be decided: the forces are not significantly correlated with gravity",
            where=where,
            remedy=SIGN_REMEDY,
        )
    sign = 1.0 if np.linalg.det(matrix) > 0 else -1.0
    rotation, _ = polar(sign * matrix)
    convention = Convention.ON_TOOL if sign > 0 else Convention.ON_SENSOR
    return SignDecision(convention, float(abs(np.linalg.det(matrix)) ** (1 / 3)), significance, np.asarray(rotation))


def with_decided_convention(model: WrenchModel, recordings: Sequence[Recording]) -> WrenchModel:
    """The model with its convention, and the quarter turns of its mounting, decided from the recordings where AUTO.

    Without an arm it takes that of the recordings.
    Raises InputError when the data cannot decide, and for planar models, whose two forces never can.
    """
    model = model.with_arm(next((r.arm for r in recordings if r.arm is not None), None))
    if model.convention is not Convention.AUTO:
        return model
    if model.space is Space.PLANE:
        raise InputError(
            what="two forces cannot distinguish the sign convention from a sensor mounted turned by half a turn",
            where="convention auto",
            remedy='state convention = "on_tool" or "on_sensor" under [sensor] in the rig',
        )
    decision = decide_convention(recordings, model.gravity)
    return replace(model, convention=decision.convention, mounting=nearest_quarter_turns(decision.mounting))


def nearest_quarter_turns(rotation: Array) -> QuarterTurnRotation:
    """The rotation by quarter turns about the axes that comes nearest to a rotation (3, 3)."""
    return max(QUARTER_TURNS, key=lambda turn: float((np.array(turn) * rotation).sum()))


def _specific_force(recording: Recording, gravity: float) -> Array:
    """Acceleration minus gravity in the sensor frame (n, 3): R(q)' (a + g z)."""
    from scipy.spatial.transform import Rotation

    signals = recording.signals
    world = np.stack([signals["apx"], signals["apy"], signals["apz"] + gravity], axis=1)
    orientation = Rotation.from_quat(np.stack([signals[n] for n in ("qx", "qy", "qz", "qw")], axis=1))
    return np.asarray(orientation.apply(world, inverse=True))


def _centred(rows: Array) -> Array:
    """Rows (n, 3) about their mean, each recording weighted as one row, so that long runs do not dominate poses."""
    return np.asarray((rows - rows.mean(axis=0)) / np.sqrt(len(rows)))


def _independent_samples(recordings: Sequence[Recording]) -> int:
    """Number of independent samples: all poses, and a thousandth of a run (its residual is strongly correlated)."""
    return sum(r.samples if r.at_rest else max(5, r.samples // 1000) for r in recordings)
