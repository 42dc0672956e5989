"""Abstract arm: forward kinematics of the force sensor from the joint coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.evaluation.cache import cached, canonical_data
from modeling.evaluation.tape import Tape
from modeling.evaluation.tape_evaluation import TapeEvaluation
from modeling.expressions.compilation import casadi_expressions
from modeling.expressions.intermediate_variables import IntermediateVariables
from modeling.kinematics.base_mounting import Direction
from modeling.kinematics.joint import JointKind
from modeling.space import Space

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MathBackend:
    """Functions of SymPy, CasADi or floats; `let` names an intermediate expression where the backend needs it."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    let: Callable[[Any], Any] = lambda expression: expression


@dataclass(frozen=True)
class ArmFrames:
    """Joint axes and sensor pose of an arm, in the world.

    origins, axes   per joint a point on its axis (m) and the unit vector of rotation or translation
    pose            of the sensor: phi, px, py in the plane, qx, qy, qz, qw, px, py, pz in space
    """

    origins: tuple[Sequence[Any], ...]
    axes: tuple[Sequence[Any], ...]
    pose: tuple[Any, ...]


class Arm(ABC):
    """Serial arm from the world to the sensor. `names` are the signals of the sensor's motion in `space`, in order."""

    space: ClassVar[Space]
    names: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def joints(self) -> int:
        """The number of joints n."""

    @property
    def kinds(self) -> tuple[JointKind, ...]:
        """The kind of each joint."""
        return (JointKind.REVOLUTE,) * self.joints

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each joint's coordinate: rad, or m of a prismatic joint."""
        return tuple("m" if kind is JointKind.PRISMATIC else "rad" for kind in self.kinds)

    @abstractmethod
    def mounted(self, direction: Direction) -> Self:
        """The arm on a base mounted so that gravity points along `direction`, a unit vector in base axes."""

    @abstractmethod
    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: MathBackend) -> ArmFrames:
        """Joint axes and sensor pose at the coordinates q (n), with link length errors `errors` (n), m."""

    @abstractmethod
    def signals(self, pose: Sequence[Any], first: Sequence[Any], second: Sequence[Any]) -> dict[str, Any]:
        """The signals by name, in the order of `names`, from a pose and its first and second time derivatives."""

    def derived(self, pose: Sequence[sp.Expr], steps: IntermediateVariables) -> dict[str, sp.Expr]:
        """The signals of a symbolic pose, in the order of `names`."""
        first = [steps.rate(part) for part in pose]
        return self.signals(pose, first, [steps.rate(part) for part in first])

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The signals by name as CasADi expressions of symbols q (n,) and of any dq, ddq (n,).

        With x(q) the pose, J = dx/dq and v = J dq: dx/dt = v and d²x/dt² = J ddq + (dv/dq) dq, both by CasADi's
        automatic differentiation.
        """
        import casadi as ca

        given = [q[j] for j in range(self.joints)]
        x = ca.vertcat(*self.frames(given, [0.0] * self.joints, MathBackend(sin=ca.sin, cos=ca.cos)).pose)
        v = ca.jtimes(x, q, dq)
        a = ca.jtimes(x, q, ddq) + ca.jtimes(v, q, dq)
        return self.signals(*map(ca.vertsplit, (x, v, a)))

    def pose(self, q: Array, dq: Array, ddq: Array) -> dict[str, Array]:
        """The signals by name, each (N,), of joint motions (N, n): rad, rad/s, rad/s² (m of prismatic joints)."""
        return dict(zip(self.names, self._evaluation.values([*q.T, *dq.T, *ddq.T]), strict=True))

    @cached_property
    def _evaluation(self) -> TapeEvaluation:
        return TapeEvaluation(self.tape)

    @cached_property
    def tape(self) -> Tape:
        """The signals in the order of `names`, over q, dq, ddq (3 n), cached on disk."""
        return cached({"part": "pose", "arm": canonical_data(self)}, lambda: self._derived().to_data(), Tape.from_data)

    def _derived(self) -> Tape:
        import casadi as ca

        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        return Tape.of(ca.vertcat(q, dq, ddq), ca.SX(0, 1), ca.vertcat(*self.graph(q, dq, ddq).values()))

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: they are rebuilt quickly in another process.
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    @cached_property
    def function(self) -> Any:
        """CasADi function of q, dq, ddq (n,) each: the signals (len(names),), in the order of `names`."""
        import casadi as ca

        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        return ca.Function("arm", [q, dq, ddq], [ca.cse(ca.vertcat(*self.graph(q, dq, ddq).values()))])

    def tip(self, length: float) -> Any:
        """CasADi function of q (n,): the point `length` (m) along the tip from the sensor origin, in the world.

        (x, y) in the plane, along y'; (x, y, z) in space, along the sensor's z axis. m.
        """
        import casadi as ca

        q, zero = ca.SX.sym("q", self.joints), ca.SX.zeros(self.joints)
        known = {sp.Symbol(name, real=True): value for name, value in self.graph(q, zero, zero).items()}
        motion = self.space.motion
        point = motion.position + motion.rotation * (sp.Float(length) * self.space.tip_axis)
        return ca.Function("tip", [q], [ca.vertcat(*casadi_expressions(known, list(point)[: self.space.value]))])
