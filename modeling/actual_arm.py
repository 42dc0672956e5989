"""ActualArm: an arm with what makes it differ from its description, and the motion of the sensor that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from modeling import symbolic as sp
from modeling.arm import joint_rates, joint_symbols
from modeling.kinematics import Arm, Calculus, Frames
from modeling.space import Motion, Space, vector
from modeling.steps import Definitions, Steps
from modeling.tip import Body

PASSES = 4
"""Times that the load is sought again where the joint has gone to: of a deflection d by which the load changes by a
share r of itself, r⁴ d is then missing."""
TAKEN_UP = 0.02
"""Static torque (N m) around which a joint passes from one end of its play to the other."""


@dataclass(frozen=True, kw_only=True)
class ActualArm:
    """Per joint: what its coordinate, its stiffness, its play and its link really are, as expressions.

    offsets      true less recorded coordinate, rad (m where it slides)
    compliances  by how much it gives way to the static load of the tool, in the load's direction, rad/(N m)
    widths       of its play, rad: it lies at the end towards which the tool's weight pulls it
    errors       true less described length from the joint to the next, the last one to the sensor origin, m
    """

    arm: Arm
    offsets: tuple[sp.Expr, ...]
    compliances: tuple[sp.Expr, ...]
    widths: tuple[sp.Expr, ...]
    errors: tuple[sp.Expr, ...]

    @classmethod
    def as_described(cls, arm: Arm) -> ActualArm:
        """Nothing differs."""
        none = (sp.S.Zero,) * arm.joints
        return cls(arm=arm, offsets=none, compliances=none, widths=none, errors=none)

    def definitions(self, body: Body, gravity: sp.Matrix) -> Definitions:
        """The signals of the sensor's motion in steps from q1.., dq1.., ddq1.., for a tool under gravity (world, m/s²).

        A joint turns by offset + width/2 sign(T) + compliance T, with T the static torque of the tool's weight about
        it: where the joint stands without either for the play, where it really stands for the deflection, T being
        sought again at the deflected angles `PASSES` times. The rates of offset and deflection are taken exactly. The
        play's is not: the knock with which it is taken up lasts milliseconds and depends on what nobody records, so
        that the joint stands at one end or the other; sign is tanh(T / 0.02 N m).
        """
        joints = self.arm.joints
        steps = Steps(joint_rates(joints))
        calculus = Calculus(sin=sp.sin, cos=sp.cos, let=steps.let)
        shifted = [steps.let(q + offset) for q, offset in zip(joint_symbols(joints, "q"), self.offsets, strict=True)]

        def loads(angles: Sequence[sp.Expr]) -> list[sp.Expr]:
            return self._static_loads(self.arm.frames(angles, self.errors, calculus), body, gravity, steps)

        if any(self.widths):
            sides = [
                steps.held(w / 2 * sp.tanh(t / TAKEN_UP)) for w, t in zip(self.widths, loads(shifted), strict=True)
            ]
            shifted = [steps.let(q + side) for q, side in zip(shifted, sides, strict=True)]
        actual = shifted
        for _ in range(PASSES if any(self.compliances) else 0):
            given = zip(shifted, self.compliances, loads(actual), strict=True)
            actual = [steps.let(q + compliance * load) for q, compliance, load in given]
        frames = self.arm.frames(actual, self.errors, calculus)
        signals = self.arm.derived(frames.pose, steps)
        return (*steps.definitions, *((sp.Symbol(name, real=True), value) for name, value in signals.items()))

    def _static_loads(self, frames: Frames, body: Body, gravity: sp.Matrix, steps: Steps) -> list[sp.Expr]:
        """What the tool's weight does to each joint: a torque about its axis (N m), or a force along it (N)."""
        rotation, position = placed(self.arm.space, frames.pose)
        weight = (body.mass * gravity).applyfunc(steps.let)
        about_sensor = (rotation * body.first_moment).applyfunc(steps.let).cross(gravity)
        loads = []
        for origin, axis, unit in zip(frames.origins, frames.axes, self.arm.units, strict=True):
            torque = (position - vector(*origin)).cross(weight) + about_sensor
            loads.append(steps.let(vector(*axis).dot(weight if unit == "m" else torque)))
        return loads


def placed(space: Space, pose: Sequence[sp.Expr]) -> tuple[sp.Matrix, sp.Matrix]:
    """Rotation from sensor to world axes, and position (m), of a pose as `Frames` give it."""
    motion: Motion = space.motion
    names = ("phi", "px", "py") if space is Space.PLANE else ("qx", "qy", "qz", "qw", "px", "py", "pz")
    known = dict(zip((sp.Symbol(name, real=True) for name in names), pose, strict=True))
    return motion.rotation.xreplace(known), motion.position.xreplace(known)
