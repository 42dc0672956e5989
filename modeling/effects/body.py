"""Effects on the weight of the tool: where its mass is, and which way is down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi

from modeling import symbolic as sp
from modeling.chain import Chain, Stage
from modeling.effect import Effect
from modeling.parameter import Parameter
from modeling.space import Space, turned, vector
from modeling.tip import Body


@dataclass(frozen=True)
class CentreOfMassOffset(Effect):
    """The tool's centre of mass lies off the tip axis.

    The first moment becomes (mlx, -mlg, 0) in the axes (x', -y'): positive mlx (kg m) lies along +x'. It adds
    mlx·ddphi to the force along -y', mlx·dphi² along -x', and mlx times the lift along -y' to the torque.
    """

    id = "com_offset"
    title = "centre of mass off the tip axis"
    stage = Stage.TIP_BODY
    equation = "c = mlg y' + mlx x'"
    advice = "take poses at rest: the torque follows the direction of gravity; look for a gripper mounted off axis"
    confused_with = "the offset of the last joint and a leak of fy into tau, in slow motion"
    spaces = (Space.PLANE,)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mlx in kg m."""
        return (Parameter(name="mlx", unit="kg m"),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Shift the first moment along x'."""
        body = chain.body
        return replace(chain, body=Body(body.mass, body.first_moment + vector(p["mlx"], 0, 0), body.inertia))


@dataclass(frozen=True)
class GravityTilt(Effect):
    """The base is not level: gravity is turned against the world that the motion is given in.

    In the plane g becomes g (-sin angle, -cos angle): positive angle (rad) turns it clockwise. In six axes it is
    turned about the world's x and y by tilt_x, tilt_y (rad), right-handed.
    """

    id = "gravity_tilt"
    title = "base not level"
    stage = Stage.TIP_BODY
    equation = "g -> R(angle) g"
    advice = "put a level on the robot's base; compare with the mounting that the controller assumes"
    confused_with = "the first joint's offset, which is the same to the tool of a planar arm; a tether tied far away"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, two in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("tilt_x", "tilt_y")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi / 4, pi / 4)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Turn the gravity vector."""
        if chain.space is Space.PLANE:
            turn = turned(chain.space, (-p["angle"],))
        else:
            turn = turned(chain.space, (p["tilt_x"], p["tilt_y"], sp.S.Zero))
        return replace(chain, gravity=turn * chain.gravity)
