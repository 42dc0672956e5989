"""Equations 22.2 to 22.4, kinematics of sensor, tip end and centre of mass, as printed and as derived.

Of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from modeling.reference.equation import Equation, Equations
from modeling.space import signals

PHI, DPHI, DDPHI, VX, VY, AX, AY = signals("phi", "dphi", "ddphi", "vx", "vy", "ax", "ay")
ANGLES = signals("q1", "q2", "q3")
LINKS = sp.symbols("l1 l2 l3", positive=True)
TIP_LENGTH, L_G = sp.symbols("l_t l_g", positive=True)
"""Distances along the tip (m) of its end and of its centre of mass from the sensor origin Ps."""

ALONG_X = sp.Matrix([sp.cos(PHI), -sp.sin(PHI)])
"""x' in the world, across the tip."""
ALONG_Y = sp.Matrix([sp.sin(PHI), sp.cos(PHI)])
"""y' in the world, along the tip."""

PRINTED_V_G = sp.Matrix([VX + L_G * DPHI * sp.cos(PHI), VY - L_G * DPHI * sp.sin(PHI)])
"""22.3's second part, with Ps' = (vx, vy)."""
PRINTED_A_G = sp.Matrix(
    [
        AX + L_G * (-(DPHI**2) * sp.sin(PHI) + DDPHI * sp.cos(PHI)),
        AY + L_G * (-(DPHI**2) * sp.cos(PHI) - DDPHI * sp.sin(PHI)),
    ]
)
"""22.4, with Ps'' = (ax, ay)."""


def printed_ps() -> sp.Matrix:
    """22.2: Ps = sum_k l_k (sin, cos)(q1 + .. + qk)."""
    sums = [sum(ANGLES[: k + 1], sp.S.Zero) for k in range(len(ANGLES))]
    return sp.Matrix([sum(length * f(a) for length, a in zip(LINKS, sums, strict=True)) for f in (sp.sin, sp.cos)])


def printed_point_on_tip(length: sp.Expr) -> sp.Matrix:
    """22.2 and 22.3: the point at a length along the tip, Ps + length (sin phi, cos phi)."""
    phi = sum(ANGLES, sp.S.Zero)
    return printed_ps() + length * sp.Matrix([sp.sin(phi), sp.cos(phi)])


def chained_links(lengths: Sequence[sp.Expr]) -> sp.Matrix:
    """The end of a chain of links, each along +y of a frame rotated clockwise by the joint before it.

    As y + i x a clockwise rotation by q is a factor exp(i q): exp(i q1) (l1 + exp(i q2) (l2 + ..)), from the outermost
    link inwards. Lengths beyond the last joint are added to the last link.
    """
    count = len(ANGLES)
    links = [*lengths[: count - 1], sum(lengths[count - 1 :], sp.S.Zero)]
    end = sp.S.Zero
    for angle, length in reversed(list(zip(ANGLES, links, strict=True))):
        end = sp.powsimp(sp.expand(sp.exp(sp.I * angle) * (length + end)))
    y, x = end.as_real_imag()
    return sp.Matrix([x, y])


def centre_of_mass(order: int) -> sp.Matrix:
    """Time derivative of 22.3's G of that order (1 velocity, 2 acceleration), in the signals of the tip's motion."""
    time = sp.Symbol("t")
    x, y, phi = (sp.Function(name)(time) for name in ("x", "y", "phi"))
    position = (sp.Matrix([x, y]) + L_G * sp.Matrix([sp.sin(phi), sp.cos(phi)])).diff(time, order)
    second = {x.diff(time, 2): AX, y.diff(time, 2): AY, phi.diff(time, 2): DDPHI}
    first = {x.diff(time): VX, y.diff(time): VY, phi.diff(time): DPHI}
    derived: sp.Matrix = position.subs(second).subs(first).subs({phi: PHI})
    return derived.applyfunc(sp.expand)


def path_equations() -> Equations:
    """22.2 by rotating link after link, 22.3 and 22.4 by differentiation."""
    acceleration = centre_of_mass(2)
    return Equations(
        (
            Equation(number="22.2", states="Ps", readings=(printed_ps(),), derived=chained_links(LINKS)),
            Equation(
                number="22.2",
                states="P",
                readings=(printed_point_on_tip(TIP_LENGTH),),
                derived=chained_links([*LINKS, TIP_LENGTH]),
            ),
            Equation(
                number="22.3", states="G", readings=(printed_point_on_tip(L_G),), derived=chained_links([*LINKS, L_G])
            ),
            Equation(number="22.3", states="v_G", readings=(PRINTED_V_G,), derived=centre_of_mass(1)),
            Equation(number="22.4", states="a_G", readings=(PRINTED_A_G,), derived=acceleration),
        )
    )
