"""Arm with joint offsets, compliance, backlash and link length errors, and the resulting sensor motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import Definitions, IntermediateVariables
from modeling.kinematics.arm import Arm, ArmFrames, MathBackend, joint_rates, joint_symbols
from modeling.kinematics.placement import JointKind
from modeling.rigid_body import RigidBody
from modeling.space import SensorMotion, Space, vector

COMPLIANCE_ITERATIONS = 4
"""Fixed-point iterations of load and deflection: where a deflection d changes the load by a fraction r of itself, the
remaining error is r⁴ d."""
BACKLASH_TORQUE = 0.02
"""Smoothing width (N m) of sign(static torque), at which a joint crosses its backlash."""


@dataclass(frozen=True, kw_only=True)
class PerturbedArm:
    """Arm with symbolic kinematic errors of each joint and link.

    offsets      true minus recorded coordinate, rad (m of a prismatic joint)
    compliances  deflection per static load of the tool, in the direction of the load, rad/(N m)
    widths       of the backlash, rad; the joint rests at the end towards which the tool's weight pulls it
    errors       true minus described length from the joint to the next, the last one to the sensor origin, m
    """

    arm: Arm
    offsets: tuple[sp.Expr, ...]
    compliances: tuple[sp.Expr, ...]
    widths: tuple[sp.Expr, ...]
    errors: tuple[sp.Expr, ...]

    @classmethod
    def as_described(cls, arm: Arm) -> PerturbedArm:
        """The arm without errors."""
        none = (sp.S.Zero,) * arm.joints
        return cls(arm=arm, offsets=none, compliances=none, widths=none, errors=none)

    def definitions(self, body: RigidBody, gravity: sp.Matrix) -> Definitions:
        """The sensor's motion signals as intermediate variables of q1.., dq1.., ddq1..; gravity in the world, m/s².

        A joint deviates by offset + width/2 sign(T) + compliance T, with T the static torque of the tool's weight about
        it: at the undeflected angles for the backlash, at the deflected angles for the compliance, by
        `COMPLIANCE_ITERATIONS` fixed-point iterations. Offset and deflection are differentiated in time exactly. The
        backlash is not: the impact at its crossing lasts milliseconds and depends on unrecorded quantities, so that the
        joint is at one end or the other; sign is tanh(T / 0.02 N m).
        """
        return _definitions(self, body.mass, tuple(body.first_moment), tuple(gravity))

    def _derived(self, body: RigidBody, gravity: sp.Matrix) -> Definitions:
        joints = self.arm.joints
        steps = IntermediateVariables(joint_rates(joints))
        calculus = MathBackend(sin=sp.sin, cos=sp.cos, let=steps.let)
        shifted = [steps.let(q + offset) for q, offset in zip(joint_symbols(joints, "q"), self.offsets, strict=True)]

        def loads(angles: Sequence[sp.Expr]) -> list[sp.Expr]:
            return self._static_loads(self.arm.frames(angles, self.errors, calculus), body, gravity, steps)

        if any(self.widths):
            sides = [
                steps.held(w / 2 * sp.tanh(t / BACKLASH_TORQUE))
                for w, t in zip(self.widths, loads(shifted), strict=True)
            ]
            shifted = [steps.let(q + side) for q, side in zip(shifted, sides, strict=True)]
        actual = shifted
        for _ in range(COMPLIANCE_ITERATIONS if any(self.compliances) else 0):
            given = zip(shifted, self.compliances, loads(actual), strict=True)
            actual = [steps.let(q + compliance * load) for q, compliance, load in given]
        frames = self.arm.frames(actual, self.errors, calculus)
        signals = self.arm.derived(frames.pose, steps)
        return (*steps.definitions, *((sp.Symbol(name, real=True), value) for name, value in signals.items()))

    def _static_loads(
        self, frames: ArmFrames, body: RigidBody, gravity: sp.Matrix, steps: IntermediateVariables
    ) -> list[sp.Expr]:
        """Static load of the tool's weight on each joint: torque about its axis (N m), or force along it (N)."""
        rotation, position = pose_transform(self.arm.space, frames.pose)
        weight = (body.mass * gravity).applyfunc(steps.let)
        about_sensor = (rotation * body.first_moment).applyfunc(steps.let).cross(gravity)
        loads = []
        for origin, axis, kind in zip(frames.origins, frames.axes, self.arm.kinds, strict=True):
            torque = (position - vector(*origin)).cross(weight) + about_sensor
            loads.append(steps.let(vector(*axis).dot(weight if kind is JointKind.PRISMATIC else torque)))
        return loads


@lru_cache(maxsize=64)
def _definitions(
    arm: PerturbedArm, mass: sp.Expr, first_moment: tuple[Any, ...], gravity: tuple[Any, ...]
) -> Definitions:
    """`PerturbedArm.definitions` of tuples, cached: most effects change neither the arm nor the tool's weight."""
    return arm._derived(RigidBody(mass, sp.Matrix(first_moment), sp.zeros(3, 3)), sp.Matrix(gravity))


def pose_transform(space: Space, pose: Sequence[sp.Expr]) -> tuple[sp.Matrix, sp.Matrix]:
    """Rotation from sensor to world axes, and position (m), of a pose as in `ArmFrames`."""
    motion: SensorMotion = space.motion
    names = ("phi", "px", "py") if space is Space.PLANE else ("qx", "qy", "qz", "qw", "px", "py", "pz")
    by_symbol = dict(zip((sp.Symbol(name, real=True) for name in names), pose, strict=True))
    return motion.rotation.xreplace(by_symbol), motion.position.xreplace(by_symbol)
