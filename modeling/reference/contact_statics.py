"""Equations 22.13 to 22.16, the contact force at the tip from the residual, as printed and as derived.

Of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et al.).
"""

from __future__ import annotations

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from modeling.chain.chain import point_on_tip
from modeling.chain.model import planar
from modeling.compiled.symbolic_vector import numpy_function
from modeling.reference.equation import Equation, Equations
from modeling.reference.path_kinematics import PHI
from modeling.rigid_body import contact_force_torque
from modeling.space import Space

Array = NDArray[np.float64]

FORCE_SIZE, D = sp.symbols("R d", positive=True)
"""Magnitude of the force (N), and its distance along the tip from the sensor (m)."""
ANGLE = sp.Symbol("b", real=True)
"""Its direction, clockwise from y' (rad)."""
FCX, FCY, TAUC = sp.symbols("fcx fcy tauc", real=True)
CONTACT_WRENCH = sp.Matrix([FCX, FCY, TAUC])

MATRIX_22_14 = sp.Matrix([[-1, 0], [0, -1], [-D, 0]])
"""Matrix of 22.14, linear in (R sin b, R cos b): (-R sin b, -R cos b, -R d sin b)."""
FORCE_COMPONENTS = FORCE_SIZE * sp.Matrix([sp.sin(ANGLE), sp.cos(ANGLE)])
PRINTED_22_14 = MATRIX_22_14 * FORCE_COMPONENTS
PRINTED_22_16 = (FCX - TAUC * D) / (FCY * (1 + D**2))
"""The argument of the arctan in 22.16."""
PRINTED_SIZE = ((TAUC * D - FCX) * sp.sin(ANGLE) - FCY * sp.cos(ANGLE)) / (1 + D**2 * sp.sin(ANGLE) ** 2)
"""R of 22.16, of which the print takes the absolute value."""


def derived_channels() -> sp.Matrix:
    """Change of the planar model's channels by a force R (sin b, cos b) along (x', y') at d along the tip."""
    chain = planar().chain
    force, _ = contact_force_torque(Space.PLANE, (*FORCE_COMPONENTS, sp.S.Zero))
    return chain.reading(-force, -point_on_tip(chain, D).cross(force))


def least_squares(arm: sp.Matrix, weights: sp.Matrix | None = None) -> sp.Matrix:
    """(R sin b, R cos b) that minimise |arm (R sin b, R cos b) - (fcx, fcy, tauc)|², by the normal equations."""
    weighted = arm.T if weights is None else arm.T * weights
    return ((weighted * arm).inv() * weighted * CONTACT_WRENCH).applyfunc(sp.factor)


def size_along(arm: sp.Matrix) -> sp.Expr:
    """R that minimises |arm (R sin b, R cos b) - (fcx, fcy, tauc)|² at a direction b, of either sign."""
    column = arm * FORCE_COMPONENTS / FORCE_SIZE
    return column.dot(CONTACT_WRENCH) / sp.trigsimp(column.dot(column))


def tangent(arm: sp.Matrix) -> sp.Expr:
    """tan b of the least-squares solution."""
    sine, cosine = least_squares(arm)
    return sp.factor(sine / cosine)


def contact_residuals() -> tuple[sp.Matrix, tuple[sp.Matrix, ...]]:
    """fc by 22.7, f - Phi theta, and by 22.13, with either sense of the rotation R(-phi)."""
    reading, predicted = (sp.Matrix(sp.symbols(names, real=True)) for names in ("fx fy tau", "w_x w_y w_tau"))
    rotations = (
        sp.diag(sp.Matrix([[sp.cos(PHI), s * sp.sin(PHI)], [-s * sp.sin(PHI), sp.cos(PHI)]]), 1) for s in (1, -1)
    )
    return reading - predicted, tuple(reading - rotation * predicted for rotation in rotations)


def contact_equations() -> Equations:
    """22.13 and 22.14 against the planar model's channels, 22.16 against 22.15, least squares on 22.14 itself."""
    fc, printed = contact_residuals()
    return Equations(
        (
            Equation(number="22.13", states="fc", readings=printed, derived=fc),
            Equation(
                number="22.14",
                states="fc of R, b",
                readings=(PRINTED_22_14,),
                derived=derived_channels(),
                erratum=7,
            ),
            Equation(
                number="22.16",
                states="tan b",
                readings=(sp.Matrix([PRINTED_22_16]),),
                derived=sp.Matrix([tangent(MATRIX_22_14)]),
                erratum=3,
            ),
            Equation(
                number="22.16",
                states="R of b",
                readings=(sp.Matrix([PRINTED_SIZE]),),
                derived=sp.Matrix([size_along(MATRIX_22_14)]),
                erratum=3,
            ),
        )
    )


def printed_direction(wrench: Array, distance: float) -> Array:
    """22.16 as it is printed, for comparison: arctan((fcx - tauc d) / (fcy (1 + d²))), (n,), rad in (-pi/2, pi/2).

    It solves tauc = +R d sin(.) against 22.14's sign (erratum 3), loses the quadrant and weights N and N m equally
    (erratum 4).
    """
    tangent = numpy_function((FCX, FCY, TAUC, D), [PRINTED_22_16])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.arctan(tangent(*wrench.T, distance)[0]))
