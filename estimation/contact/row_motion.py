"""RowMotion: a model's signals in terms of the columns of one row and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.motion_form import motion_form
from estimation.recording import QUATERNION, MotionForm, motion_columns, numbered
from estimation.table import Table
from modeling import symbolic as sp
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.model import WrenchModel
from modeling.prediction import Emitted
from modeling.quaternion import turning
from modeling.rig import Rig

Array = NDArray[np.float64]
Signals: TypeAlias = "dict[str, sp.Expr]"

TURN = 2 * np.pi


class Tap(NamedTuple):
    """A column's derivative of some order."""

    column: str
    order: int

    @property
    def symbol(self) -> sp.Symbol:
        """What stands for it in a signal's expression."""
        return sp.Symbol(self.column + "'" * self.order, real=True)


@dataclass(frozen=True, eq=False)
class RowMotion:
    """The signals of a recording (`Recording.signals`), each an expression of `taps` of the columns of a row.

    Rates and accelerations are those recorded, else derived from the nearest that is; without any of the sensor
    origin's it counts as slow. Columns that are no part of the motion are signals by their own name. `arm` has the
    joints, where there are any; its signals stand for themselves until `function` derives them.
    """

    columns: tuple[str, ...]
    form: MotionForm
    signals: Signals
    arm: Arm | None = None

    @classmethod
    def of(cls, columns: Sequence[str], channels: tuple[str, ...], rig: Rig | None) -> RowMotion:
        """From the names of a row's columns, as in FORMATS.

        Raises InputError when they are no complete motion, or when joint angles come without kinematics.
        """
        one = Table(columns={name: np.zeros(1) for name in columns}, where="contact filter", first_row=1)
        form = motion_form(one, channels, rig)
        arm = rig.arm if rig is not None and form is MotionForm.JOINTS else None
        motion = motion_columns(form, 0 if arm is None else arm.joints)
        signals = {name: Tap(name, 0).symbol for name in columns if name not in motion}
        if arm is not None:
            signals |= _joint_signals(columns, arm)
        elif form is MotionForm.PLANAR_POSE:
            signals |= _derived(columns, ("phi",), ("dphi",), ("ddphi",)) | _translation(columns, "p", "v", "a", "xy")
        else:
            signals |= _rotation(columns) | _translation(columns, "p", "vp", "ap", "xyz")
        return cls(tuple(columns), form, signals, arm)

    def put_into(self, expression: sp.Matrix, model: WrenchModel) -> sp.Matrix:
        """An expression of the model in terms of taps and parameters.

        Raises InputError when it takes signals that a row does not give.
        """
        missing = [name for name in model.inputs_of(expression) if name not in self.signals]
        if missing:
            guilty = [e.id for e in model.effects if set(missing) & set((model.base + e).inputs)]
            by = f" (for {', '.join(guilty)})" if guilty else ""
            raise InputError(
                what=f"the model needs {', '.join(missing)}{by}, which rows of {', '.join(self.columns)} do not give",
                where="contact filter",
                remedy="give these columns too, or leave the effect out",
            )
        return expression.xreplace({sp.Symbol(name, real=True): value for name, value in self.signals.items()})

    def function(self, expression: sp.Matrix, parameters: Sequence[sp.Symbol]) -> tuple[tuple[Tap, ...], Any]:
        """The taps that an expression of the model takes, and the CasADi function of them and the parameters to it."""
        import casadi as ca

        inputs = tuple(sorted(symbol.name for symbol in expression.free_symbols - set(parameters)))
        posed = self.arm is not None and not set(self.arm.names).isdisjoint(inputs)
        needed = {*inputs, *(self._state if posed else ())}
        every = (Tap(column, order) for column in self.columns for order in range(3))
        taps = tuple(tap for tap in every if tap.symbol.name in needed)
        values = ca.SX.sym("taps", len(taps))
        known = {tap.symbol.name: values[i] for i, tap in enumerate(taps)}
        if self.arm is not None and posed:
            state = ca.vertcat(*(known[name] for name in self._state))
            motion = self.arm.function(*ca.vertsplit(state, self.arm.joints))
            known |= dict(zip(self.arm.names, ca.vertsplit(motion), strict=True))
        emitted = Emitted.of(expression, inputs, tuple(parameters))
        function = ca.Function("row", list(emitted.symbols), [emitted.graph])
        theta = emitted.symbols[1]
        return taps, ca.Function("row", [values, theta], [function(ca.vertcat(*(known[n] for n in inputs)), theta)])

    @property
    def _state(self) -> list[str]:
        """The taps of q1.., dq1.., ddq1.., in this order, by name."""
        count = 0 if self.arm is None else self.arm.joints
        return [self.signals[name].name for prefix in ("q", "dq", "ddq") for name in numbered(prefix, count)]

    def continued(self, row: Array, before: Array) -> Array:
        """A row without the jumps of an angle by whole turns, or of a quaternion to its negative, from the row before.

        The quaternion is also normalised. `before` is a row that was continued.
        """
        row = row.copy()
        if self.form is MotionForm.PLANAR_POSE:
            i = self.columns.index("phi")
            row[i] -= TURN * np.round((row[i] - before[i]) / TURN)
        elif self.form is MotionForm.POSE:
            four = [self.columns.index(name) for name in QUATERNION]
            size = np.linalg.norm(row[four])
            row[four] /= -size if row[four] @ before[four] < 0 else size
        return row


def _derived(columns: Sequence[str], *groups: Sequence[str]) -> dict[str, sp.Expr]:
    """Signals of the value, rate and acceleration named in the groups: recorded, or derived from the last recorded."""
    found: dict[str, sp.Expr] = {}
    source: tuple[int, Sequence[str]] | None = None
    for order, names in enumerate(groups):
        if all(name in columns for name in names):
            source = order, names
        if source is not None:
            found |= {n: Tap(c, order - source[0]).symbol for n, c in zip(names, source[1], strict=True)}
    return found


def _joint_signals(columns: Sequence[str], arm: Arm) -> Signals:
    """The joints' taps, and the signals that the arm's kinematics will make of them."""
    names = zip(*(numbered(prefix, arm.joints) for prefix in ("q", "dq", "ddq")), strict=True)
    joints = {name: tap for q, dq, ddq in names for name, tap in _derived(columns, (q,), (dq,), (ddq,)).items()}
    return {name: sp.Symbol(name, real=True) for name in arm.names} | joints


def _translation(columns: Sequence[str], position: str, velocity: str, acceleration: str, axes: str) -> Signals:
    """Motion of the sensor origin; slow when nothing of it is there."""
    groups = [[prefix + axis for axis in axes] for prefix in (position, velocity, acceleration)]
    return dict.fromkeys(groups[2], sp.S.Zero) | _derived(columns, *groups)


def _rotation(columns: Sequence[str]) -> Signals:
    """Orientation, angular velocity and acceleration; the last two as recorded, or the last one from the first."""
    rates, accelerations = ([prefix + axis for axis in "xyz"] for prefix in ("w", "al"))
    components = [[Tap(name, order).symbol for name in QUATERNION] for order in range(3)]
    return dict(turning(components)) | _derived(columns, rates, accelerations)
