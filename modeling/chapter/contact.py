"""Contact: how the chapter solves what is left of a reading for the force at the tip (22.13 to 22.16)."""

from __future__ import annotations

import sympy as sp

from modeling.chain import point_on_tip
from modeling.chapter.equation import Equation
from modeling.chapter.path import PHI
from modeling.chapter.table import Equations
from modeling.contact import applied
from modeling.model import planar
from modeling.space import Space

SIZE, D = sp.symbols("R d", positive=True)
"""Size of the force (N), and how far along the tip from the sensor it acts (m)."""
ANGLE = sp.Symbol("b", real=True)
"""Its direction, from y' and clockwise."""
FCX, FCY, TAUC = sp.symbols("fcx fcy tauc", real=True)
CONTACT = sp.Matrix([FCX, FCY, TAUC])

ARM_22_14 = sp.Matrix([[-1, 0], [0, -1], [-D, 0]])
"""22.14 is linear in (R sin, R cos): (-R sin, -R cos, -R d sin)."""
DIRECTION = SIZE * sp.Matrix([sp.sin(ANGLE), sp.cos(ANGLE)])
PRINTED_22_14 = ARM_22_14 * DIRECTION
PRINTED_22_16 = (FCX - TAUC * D) / (FCY * (1 + D**2))
"""The tangent that 22.16 takes the arctan of."""


def derived_channels() -> sp.Matrix:
    """What a force R (sin b, cos b) along (x', y') at d along the tip changes in the planar model's channels."""
    chain = planar().chain
    force, _ = applied(Space.PLANE, (*DIRECTION, sp.S.Zero))
    return chain.reading(-force, -point_on_tip(chain, D).cross(force))


def least_squares(arm: sp.Matrix, weights: sp.Matrix | None = None) -> sp.Matrix:
    """(R sin, R cos) of the contact `arm` (R sin, R cos) nearest to (fcx, fcy, tauc), by the normal equations."""
    weighted = arm.T if weights is None else arm.T * weights
    return ((weighted * arm).inv() * weighted * CONTACT).applyfunc(sp.factor)


def tangent(arm: sp.Matrix) -> sp.Expr:
    """tan of the direction that least squares finds."""
    sine, cosine = least_squares(arm)
    return sp.factor(sine / cosine)


def subtracted() -> tuple[sp.Matrix, tuple[sp.Matrix, ...]]:
    """fc by 22.7, f - Phi theta, and by 22.13, with R(-phi) turning the forces one way or the other."""
    reading, own = (sp.Matrix(sp.symbols(names, real=True)) for names in ("fx fy tau", "w_x w_y w_tau"))
    turns = (sp.diag(sp.Matrix([[sp.cos(PHI), s * sp.sin(PHI)], [-s * sp.sin(PHI), sp.cos(PHI)]]), 1) for s in (1, -1))
    return reading - own, tuple(reading - turn * own for turn in turns)


def contact_equations() -> Equations:
    """22.13 and 22.14 against the planar model's channels, 22.16 against least squares on 22.14 itself."""
    fc, printed = subtracted()
    sine, cosine = least_squares(ARM_22_14)
    return Equations(
        (
            Equation(number="22.13", states="fc", readings=printed, derived=fc),
            Equation(
                number="22.14",
                states="fc of R, b",
                readings=(PRINTED_22_14,),
                derived=derived_channels(),
                erratum=7,
                quoted=False,
            ),
            Equation(number="22.15", states="R", derived=sp.Matrix([sp.sqrt(sine**2 + cosine**2)])),
            Equation(
                number="22.16",
                states="tan b",
                readings=(sp.Matrix([PRINTED_22_16]),),
                derived=sp.Matrix([tangent(ARM_22_14)]),
                erratum=3,
                quoted=False,
            ),
        )
    )
