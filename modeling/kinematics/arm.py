"""Abstract arm: forward kinematics of the force sensor from the joint coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import hypot
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.compiled.cache import cached, canonical_data
from modeling.compiled.straight_line_program import IntermediateVariables
from modeling.compiled.symbolic_vector import casadi_expressions
from modeling.compiled.tape import Tape
from modeling.compiled.tape_evaluation import TapeEvaluation
from modeling.kinematics.placement import (
    COMPONENTS,
    IDENTITY_PLACEMENT,
    Direction,
    Joint,
    JointKind,
    Placement,
    base_angle,
    base_placement,
    quaternion_conjugate,
    quaternion_product,
    rotated_vector,
    translated,
)
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
        first = [steps.rate(coordinate) for coordinate in pose]
        return self.signals(pose, first, [steps.rate(coordinate) for coordinate in first])

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The signals by name as CasADi expressions of symbols q (n,) and of any dq, ddq (n,).

        With x(q) the pose, J = dx/dq and v = J dq: dx/dt = v and d²x/dt² = J ddq + (dv/dq) dq, both by CasADi's
        automatic differentiation.
        """
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
        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        return Tape.of(ca.vertcat(q, dq, ddq), ca.SX(0, 1), ca.vertcat(*self.graph(q, dq, ddq).values()))

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: they are rebuilt quickly in another process.
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    @cached_property
    def function(self) -> Any:
        """CasADi function of q, dq, ddq (n,) each: the signals (len(names),), in the order of `names`."""
        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        return ca.Function("arm", [q, dq, ddq], [ca.cse(ca.vertcat(*self.graph(q, dq, ddq).values()))])

    def tip(self, length: float) -> Any:
        """CasADi function of q (n,): the point `length` (m) along the tip from the sensor origin, in the world.

        (x, y) in the plane, along y'; (x, y, z) in space, along the sensor's z axis. m.
        """
        q, zero = ca.SX.sym("q", self.joints), ca.SX.zeros(self.joints)
        graphs = {sp.Symbol(name, real=True): value for name, value in self.graph(q, zero, zero).items()}
        motion = self.space.motion
        point = motion.position + motion.rotation * (sp.Float(length) * self.space.tip_axis)
        return ca.Function("tip", [q], [ca.vertcat(*casadi_expressions(graphs, list(point)[: self.space.value]))])


# Planar arm of revolute joints: pose, velocity and acceleration of the force sensor from the joint angles.
#
# Equation numbers are those of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
# Manipulators" (Bassi et al.).


POSE_SIGNALS = ("phi", "dphi", "ddphi", "px", "py", "vx", "vy", "ax", "ay")


def joint_symbols(joints: int, prefix: str) -> tuple[sp.Symbol, ...]:
    """Symbols `<prefix>1 .. <prefix>n`, the joint signals of a recording (rad, rad/s, rad/s²)."""
    return tuple(sp.Symbol(f"{prefix}{j}", real=True) for j in range(1, joints + 1))


@dataclass(frozen=True)
class PlanarArm(Arm):
    """Planar arm of n revolute joints, lengths in m from joint to joint, the last one to the sensor origin.

    Angles are clockwise positive, the first from the base's y, the others relative; x points right, y up. The base is
    turned by `base` (rad, clockwise) in the world.
    """

    link_lengths: tuple[float, ...]
    base: float = 0.0

    space: ClassVar[Space] = Space.PLANE
    names: ClassVar[tuple[str, ...]] = POSE_SIGNALS

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.link_lengths)

    @cached_property
    def kinematics(self) -> Mapping[str, sp.Expr]:
        """Pose signals as expressions in `q1.., dq1.., ddq1..`: 22.2 and its time derivatives by SymPy."""
        return forward_kinematics(tuple(sp.Float(length) for length in self.link_lengths), self.base)

    def mounted(self, direction: Direction) -> Self:
        """The base turned."""
        return replace(self, base=base_angle(direction))

    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: MathBackend) -> ArmFrames:
        """The sensor origin Ps = sum_k l_k (sin, cos)(q1 + .. + qk) (22.2), the tip's angle phi = q1 + .. + qn."""
        angle, x, y = self.base or 0, 0, 0
        origins = []
        for length, error, turn in zip(self.link_lengths, errors, q, strict=True):
            origins.append((x, y, 0))
            angle = calculus.let(angle + turn)
            along = ((x, calculus.sin), (y, calculus.cos))
            x, y = (calculus.let(at + (length + error) * component(angle)) for at, component in along)
        return ArmFrames(tuple(origins), ((0, 0, -1),) * len(origins), (angle, x, y))

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The signals as CasADi expressions of any q, dq, ddq (n,)."""
        values = self.tape.graph(ca.vertcat(q, dq, ddq), ca.SX(0, 1))
        return {name: values[i] for i, name in enumerate(self.names)}

    def _derived(self) -> Tape:
        symbols = [symbol for prefix in ("q", "dq", "ddq") for symbol in joint_symbols(self.joints, prefix)]
        return Tape.of_expressions(symbols, [self.kinematics[name] for name in self.names])

    def signals(self, pose: Sequence[Any], first: Sequence[Any], second: Sequence[Any]) -> dict[str, Any]:
        """phi (rad), px, py (m, world) with their velocities and accelerations (the Ps'' of 22.4)."""
        (phi, x, y), (dphi, vx, vy), (ddphi, ax, ay) = pose, first, second
        return dict(zip(self.names, (phi, dphi, ddphi, x, y, vx, vy, ax, ay), strict=True))


def joint_rates(joints: int) -> dict[sp.Symbol, sp.Symbol]:
    """The time derivative of each joint signal: q1 -> dq1, dq1 -> ddq1 and so on."""
    q, dq, ddq = (joint_symbols(joints, prefix) for prefix in ("q", "dq", "ddq"))
    return dict(zip((*q, *dq), (*dq, *ddq), strict=True))


def forward_kinematics(lengths: tuple[sp.Expr, ...], base: float = 0.0) -> dict[str, sp.Expr]:
    """Pose signals of an arm with symbolic or numeric link lengths (22.2 and its time derivatives)."""
    arm, joints = PlanarArm(lengths, base), len(lengths)
    frames = arm.frames(joint_symbols(joints, "q"), [sp.S.Zero] * joints, MathBackend(sin=sp.sin, cos=sp.cos))
    return arm.derived(frames.pose, IntermediateVariables(joint_rates(joints), named=False))


# Spatial arm of revolute and prismatic joints: motion of the force sensor from the joint coordinates.


VECTORS = tuple(prefix + axis for prefix in ("w", "al", "p", "vp", "ap") for axis in "xyz")


@dataclass(frozen=True)
class SpatialArm(Arm):
    """Serial arm of revolute and prismatic joints from the world, z up, to the sensor frame.

    `sensor` is the placement of the sensor in the frame moved by the last joint.
    """

    chain: tuple[Joint, ...]
    sensor: Placement = IDENTITY_PLACEMENT

    space: ClassVar[Space] = Space.SPACE
    names: ClassVar[tuple[str, ...]] = COMPONENTS + VECTORS

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.chain)

    @property
    def kinds(self) -> tuple[JointKind, ...]:
        """The kind of each joint of the chain."""
        return tuple(joint.kind for joint in self.chain)

    def mounted(self, direction: Direction) -> Self:
        """The first joint's placement, or of an arm without joints the sensor's, turned with the base."""
        base = base_placement(direction)
        if not self.chain:
            return replace(self, sensor=base.then(self.sensor))
        first = replace(self.chain[0], placement=base.then(self.chain[0].placement))
        return replace(self, chain=(first, *self.chain[1:]))

    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: MathBackend) -> ArmFrames:
        """Forward kinematics along the chain.

        The error of a joint lengthens the offset from it to the next joint, or to the sensor, in its own direction.
        """
        s, p = IDENTITY_PLACEMENT.quaternion, IDENTITY_PLACEMENT.position
        origins, axes = [], []
        longer: list[Any] = [0.0, *errors]
        for joint, coordinate, error in zip(self.chain, q, longer[:-1], strict=True):
            p = _named(calculus, translated(p, rotated_vector(s, _lengthened(joint.placement.position, error))))
            s = _named(calculus, quaternion_product(s, joint.placement.quaternion))
            axis = _named(calculus, rotated_vector(s, joint.axis))
            origins.append(p)
            axes.append(axis)
            if joint.kind is JointKind.PRISMATIC:
                p = _named(calculus, translated(p, [coordinate * c for c in axis]))
            else:
                half = calculus.let(coordinate / 2)
                turn = (*(c * calculus.sin(half) for c in joint.axis), calculus.cos(half))
                s = _named(calculus, quaternion_product(s, _named(calculus, turn)))
        p = _named(calculus, translated(p, rotated_vector(s, _lengthened(self.sensor.position, longer[-1]))))
        s = _named(calculus, quaternion_product(s, self.sensor.quaternion))
        return ArmFrames(tuple(origins), tuple(axes), (*s, *p))

    def signals(self, pose: Sequence[Any], first: Sequence[Any], second: Sequence[Any]) -> dict[str, Any]:
        """qx .. qw (sensor in the world), wx .. and alx .. (rad/s, rad/s², sensor frame), px .., vpx .., apx ..

        p is the sensor origin in the world (m; kinematic accelerations). From the unit quaternion s, in the sensor
        frame, omega = 2 vec(conj(s) ⊗ ds/dt); its derivative in time is alpha = 2 vec(conj(s) ⊗ d²s/dt²), since
        conj(ds/dt) ⊗ ds/dt is a scalar. All signals are continuous in q: s is a polynomial in sines and cosines of half
        angles.
        """
        s, ds, dds = pose[:4], first[:4], second[:4]
        omega, alpha = ([2 * c for c in quaternion_product(quaternion_conjugate(s), rate)[:3]] for rate in (ds, dds))
        return dict(zip(self.names, (*s, *omega, *alpha, *pose[4:], *first[4:], *second[4:]), strict=True))

    @property
    def position_limits(self) -> Array:
        """Lowest and highest coordinate of each joint (n, 2), rad or m; infinite when unbounded."""
        return np.array([j.position or (-np.inf, np.inf) for j in self.chain])


def _lengthened(offset: Sequence[float], error: Any) -> tuple[Any, ...]:
    """An offset vector (m), longer by `error` (m) in its own direction; a zero vector is unchanged."""
    length = hypot(*offset)
    return tuple(offset) if length == 0 else tuple(component + error * (component / length) for component in offset)


def _named(calculus: MathBackend, components: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(calculus.let(component) for component in components)
