"""Centre-of-mass offset and tilted base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.parameter import Parameter
from modeling.space import Space, rotation_matrix, vector
from modeling.tool.rigid_body import RigidBody


@dataclass(frozen=True)
class CentreOfMassOffset(Effect):
    """The tool's centre of mass is off the tip axis.

    The first moment becomes (mlx, -mlg, 0) in the axes (x', -y'): positive mlx (kg m) is along +x'. It adds
    mlx·ddphi to the force along -y', mlx·dphi² along -x', and mlx times the specific force along -y' to the torque.
    """

    id = "com_offset"
    title = "centre of mass off the tip axis"
    stage = Stage.TIP_BODY
    equation = "c = mlg y' + mlx x'"
    advice = "record static poses: the torque follows the direction of gravity; look for a gripper mounted off axis"
    confused_with = "the offset of the last joint and crosstalk from fy to tau, in slow motion"
    spaces = (Space.PLANE,)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mlx in kg m."""
        return (Parameter(name="mlx", unit="kg m"),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Shift the first moment along x'."""
        body = chain.body
        return replace(chain, body=RigidBody(body.mass, body.first_moment + vector(p["mlx"], 0, 0), body.inertia))


@dataclass(frozen=True)
class GravityTilt(Effect):
    """The base is not level: gravity is rotated relative to the world frame of the motion.

    In the plane g becomes g (-sin angle, -cos angle): positive angle (rad) rotates it clockwise, as on a base whose -x
    side is lower. In six axes it is rotated about the world's x, then y, by tilt_x, tilt_y (rad), right-handed:
    positive tilt_x leans gravity towards +y, as on a base whose +y side is lower, positive tilt_y towards -x. The base
    itself is turned by the negative of these angles against the horizontal.
    """

    id = "gravity_tilt"
    title = "base not level"
    stage = Stage.TIP_BODY
    equation = "g -> R(angle) g"
    advice = "put a level on the robot's base; compare with the mounting that the controller assumes"
    confused_with = "the first joint's offset, identical for the tool of a planar arm; a cable with a distant anchor"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, two in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("tilt_x", "tilt_y")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi / 4, pi / 4)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Rotate the gravity vector."""
        if chain.space is Space.PLANE:
            rotation = rotation_matrix(chain.space, (-p["angle"],))
        else:
            rotation = rotation_matrix(chain.space, (p["tilt_x"], p["tilt_y"], sp.S.Zero))
        return replace(chain, gravity=rotation * chain.gravity)
