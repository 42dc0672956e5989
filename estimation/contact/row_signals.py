"""Model signals as expressions of one row's columns and their time derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.column_table import ColumnTable
from estimation.recordings.motion_form import motion_form
from estimation.recordings.recording import QUATERNION, MotionForm, motion_columns, numbered_names
from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.codegen.fitted_model import sample_inputs
from modeling.errors import InputError
from modeling.expressions.compilation import casadi_expressions
from modeling.kinematics.arm import Arm
from modeling.kinematics.base_mounting import motion_in_world
from modeling.kinematics.quaternion import angular_motion
from modeling.rig.rig import Rig
from modeling.space import signals

Array = NDArray[np.float64]
SignalExpressions: TypeAlias = "dict[str, sp.Expr]"

FULL_TURN = 2 * np.pi


class ColumnDerivative(NamedTuple):
    """A time derivative of a column; order 0 is the column itself."""

    column: str
    order: int

    @property
    def symbol(self) -> sp.Symbol:
        """Its symbol in a signal's expression."""
        return sp.Symbol(self.column + "'" * self.order, real=True)


@dataclass(frozen=True, eq=False)
class RowSignals:
    """The signals of a recording (`Recording.signals`), each an expression of derivatives of a row's columns.

    Rates and accelerations are those recorded, else derivatives of the highest recorded order below; without any of
    the sensor origin its acceleration is zero. Columns that are not part of the motion are signals by their own name.
    With an `arm` the signals of its kinematics are symbols until `graphs` computes them from the joints.
    """

    columns: tuple[str, ...]
    form: MotionForm
    signals: SignalExpressions
    arm: Arm | None = None

    @classmethod
    def of(cls, columns: Sequence[str], channels: tuple[str, ...], rig: Rig | None) -> RowSignals:
        """From the names of a row's columns, as in FORMATS.

        Raises InputError when the motion is incomplete, or when joint angles come without kinematics.
        """
        one = ColumnTable(columns={name: np.zeros(1) for name in columns}, where="contact filter", first_row=1)
        form = motion_form(one, channels, rig)
        arm = rig.arm if rig is not None and form is MotionForm.JOINTS else None
        motion = motion_columns(form, 0 if arm is None else arm.joints)
        signals = {name: ColumnDerivative(name, 0).symbol for name in columns if name not in motion}
        if arm is not None:
            signals |= _joint_signals(columns, arm)
        elif form is MotionForm.PLANAR_POSE:
            signals |= _derived(columns, ("phi",), ("dphi",), ("ddphi",)) | _translation(columns, "p", "v", "a", "xy")
        else:
            signals |= _rotation(columns) | _translation(columns, "p", "vp", "ap", "xyz")
        if rig is not None and rig.gravity_direction is not None and arm is None:
            signals = motion_in_world(signals, rig.gravity_direction)
        return cls(tuple(columns), form, signals, arm)

    def graphs(self, model: WrenchModel) -> tuple[tuple[ColumnDerivative, ...], Any, list[Any]]:
        """Column derivatives that a sample of the model needs, their CasADi vector, and the graphs of its signals.

        Raises InputError when it needs signals that a row does not give.
        """
        import casadi as ca

        names = sample_inputs(model)
        self._require(names, model)
        needs_kinematics = self.arm is not None and not set(self.arm.names).isdisjoint(names)
        needed = {symbol.name for name in names for symbol in self.signals[name].free_symbols}
        needed |= set(self._joint_state if needs_kinematics else ())
        candidates = (ColumnDerivative(column, order) for column in self.columns for order in range(3))
        derivatives = tuple(d for d in candidates if d.symbol.name in needed)
        values = ca.SX.sym("derivatives", len(derivatives))
        known = {d.symbol: values[i] for i, d in enumerate(derivatives)}
        if self.arm is not None and needs_kinematics:
            state = ca.vertcat(*(known[sp.Symbol(name, real=True)] for name in self._joint_state))
            motion = self.arm.function(*ca.vertsplit(state, self.arm.joints))
            known |= dict(zip(signals(*self.arm.names), ca.vertsplit(motion), strict=True))
        return derivatives, values, casadi_expressions(known, [self.signals[name] for name in names])

    def _require(self, names: Sequence[str], model: WrenchModel) -> None:
        missing = [name for name in names if name not in self.signals]
        if missing:
            affected = [e.id for e in model.effects if set(missing) & set((model.base + e).inputs)]
            by = f" (for {', '.join(affected)})" if affected else ""
            raise InputError(
                what=f"the model needs {', '.join(missing)}{by}, which rows of {', '.join(self.columns)} do not give",
                where="contact filter",
                remedy="give these columns too, or leave the effect out",
            )

    @property
    def _joint_state(self) -> list[str]:
        """Symbol names of q1.., dq1.., ddq1.., in this order."""
        count = 0 if self.arm is None else self.arm.joints
        return [self.signals[name].name for prefix in ("q", "dq", "ddq") for name in numbered_names(prefix, count)]

    def unwrapped(self, row: Array, before: Array) -> Array:
        """A row with the angle unwrapped, or the quaternion's sign aligned, to the row before (already unwrapped).

        The quaternion is also normalised.
        """
        row = row.copy()
        if self.form is MotionForm.PLANAR_POSE:
            i = self.columns.index("phi")
            row[i] -= FULL_TURN * np.round((row[i] - before[i]) / FULL_TURN)
        elif self.form is MotionForm.POSE:
            indices = [self.columns.index(name) for name in QUATERNION]
            size = np.linalg.norm(row[indices])
            row[indices] /= -size if row[indices] @ before[indices] < 0 else size
        return row


def _derived(columns: Sequence[str], *groups: Sequence[str]) -> dict[str, sp.Expr]:
    """Value, rate and acceleration named in the groups: as recorded, or derived from the highest recorded order."""
    found: dict[str, sp.Expr] = {}
    source: tuple[int, Sequence[str]] | None = None
    for order, names in enumerate(groups):
        if all(name in columns for name in names):
            source = order, names
        if source is not None:
            found |= {n: ColumnDerivative(c, order - source[0]).symbol for n, c in zip(names, source[1], strict=True)}
    return found


def _joint_signals(columns: Sequence[str], arm: Arm) -> SignalExpressions:
    """Expressions of the joints' motion, and symbols for the signals of the arm's kinematics."""
    names = zip(*(numbered_names(prefix, arm.joints) for prefix in ("q", "dq", "ddq")), strict=True)
    joints = {
        name: expression for q, dq, ddq in names for name, expression in _derived(columns, (q,), (dq,), (ddq,)).items()
    }
    return {name: sp.Symbol(name, real=True) for name in arm.names} | joints


def _translation(
    columns: Sequence[str], position: str, velocity: str, acceleration: str, axes: str
) -> SignalExpressions:
    """Motion of the sensor origin; its acceleration is zero when none of it is recorded."""
    groups = [[prefix + axis for axis in axes] for prefix in (position, velocity, acceleration)]
    return dict.fromkeys(groups[2], sp.S.Zero) | _derived(columns, *groups)


def _rotation(columns: Sequence[str]) -> SignalExpressions:
    """Orientation, angular velocity and acceleration; the last two as recorded, else derived."""
    rates, accelerations = ([prefix + axis for axis in "xyz"] for prefix in ("w", "al"))
    components = [[ColumnDerivative(name, order).symbol for name in QUATERNION] for order in range(3)]
    return dict(angular_motion(components)) | _derived(columns, rates, accelerations)
