"""Wrench: what the chapter says that the sensor reads of the tip (22.5 to 22.9)."""

from __future__ import annotations

from functools import cache

import sympy as sp

from modeling.chapter.equation import Equation
from modeling.chapter.path import ALONG_X, ALONG_Y, AX, AY, DDPHI, DPHI, L_G, PHI, centre_of_mass
from modeling.chapter.table import Equations
from modeling.model import WrenchModel, planar
from modeling.regressor import motions, regressor

MASS, MLG, INERTIA = sp.symbols("m mlg I", real=True)
I_G = sp.Symbol("I_G", positive=True)
"""Inertia about the centre of mass, kg m²."""
IN_PARTS = {MLG: MASS * L_G, INERTIA: I_G + MASS * L_G**2}
"""22.6's first moment and inertia, the latter about Ps, of a body with its centre at l_g."""
G = sp.Symbol("g", positive=True)
BIASES = sp.symbols("bias_fx bias_fy bias_tau", real=True)
THETA = sp.Matrix([*BIASES, MASS, MLG, INERTIA])
"""22.6."""
M = sp.symbols("M1:5", real=True)

A_GX, A_GY = (sp.simplify(sp.expand(centre_of_mass(2).dot(axis))) for axis in (ALONG_X, ALONG_Y))
"""a_G along x' and along y'."""

PRINTED_22_8 = sp.Matrix(
    [[1, 0, 0, M[0], M[1], 0], [0, 1, 0, M[2], M[3], 0], [0, 0, 1, 0, M[0], M[1]]],
)
PRINTED_22_9 = sp.Matrix(
    [
        AX * sp.cos(PHI) - (AY + G) * sp.sin(PHI),
        DDPHI,
        -(AX * sp.sin(PHI) + (AY + G) * sp.cos(PHI)),
        DPHI**2,
    ]
)
CONSTANTS = sp.symbols("c1 c2 c3", real=True)
PRINTED_22_5 = (
    # (row 1, both overall signs), row 2, (row 3 with any three constants)
    tuple(sign * MASS * (-A_GX - G * sp.sin(PHI)) for sign in (1, -1)),
    (-MASS * (A_GY + G * sp.cos(PHI)),),
    (CONSTANTS[0] * DDPHI + CONSTANTS[1] * A_GX * sp.sin(PHI) + CONSTANTS[2] * sp.sin(PHI),),
)
"""22.5 less its biases. PHYSICS.md says of row 1 that acceleration and gravity have opposite signs, of row 2 that it is
22.8's, and of row 3 that it multiplies a_G along x' by sin phi; what it leaves open is left open here."""


@cache
def derived_load() -> sp.Matrix:
    """The project's planar model before its biases, in m, mlg, I and g: Newton-Euler summed over the body."""
    model = planar()
    return with_g(model.load, model)


@cache
def about_the_centre() -> sp.Matrix:
    """The same by another route: Newton's law for the centre of mass, Euler's about it, moved to Ps.

    F = m (a_G - gravity) is what the sensor exerts. On its channels that is F along x', F along -y', and about Ps the
    clockwise torque I_G ddphi + l_g F_x'.
    """
    up = sp.Matrix([0, G])
    across, along = MASS * (A_GX + up.dot(ALONG_X)), MASS * (A_GY + up.dot(ALONG_Y))
    return sp.Matrix([across, -along, I_G * DDPHI + L_G * across])


def with_g(expression: sp.Matrix, model: WrenchModel) -> sp.Matrix:
    """The expression with the letter g for the model's gravity."""
    return expression.subs(sp.Float(model.gravity), G)


def derived_regressor() -> tuple[sp.Matrix, sp.Matrix]:
    """Phi of the planar model with M1 .. M4 for its entries, and these (4, 1)."""
    model = planar()
    found = motions(model)
    functions = [found.M1, found.M2, found.M3, found.M4]
    names = dict(zip(functions, M, strict=True))
    phi = regressor(model).applyfunc(lambda entry: names.get(entry, entry))
    return phi, with_g(sp.Matrix(functions), model)


def wrench_equations() -> Equations:
    """22.5 and 22.6 against Newton and Euler about the centre of mass, 22.7 to 22.9 against the planar model."""
    derived = about_the_centre()
    phi, functions = derived_regressor()
    theta = sp.Matrix([p.symbol for p in planar().parameters])
    reading = derived_load() + planar().zero
    rows = [
        Equation(
            number="22.5",
            states=f"{channel} - bias",
            readings=tuple(sp.Matrix([reading]) for reading in readings),
            derived=sp.Matrix([derived[i]]),
            constants=CONSTANTS if i == 2 else (),
            erratum=None if i == 1 else 1,
            quoted=False,
        )
        for i, (channel, readings) in enumerate(zip(("fx", "fy", "tau"), PRINTED_22_5, strict=True))
    ]
    about_ps = sp.Matrix([derived_load()[2].subs(MLG, MASS * L_G).coeff(DDPHI)])
    return Equations(
        (
            *rows,
            Equation(number="22.6", states="theta", readings=(THETA,), derived=theta),
            Equation(
                number="22.6",
                states="I",
                readings=(sp.Matrix([sp.Symbol("l")]), sp.Matrix([I_G])),
                derived=about_ps.subs(IN_PARTS),
                erratum=2,
                quoted=False,
            ),
            Equation(
                number="22.7",
                states="Y - V",
                readings=((PRINTED_22_8 * THETA).subs(dict(zip(M, PRINTED_22_9, strict=True))),),
                derived=reading,
            ),
            Equation(number="22.8", states="Phi", readings=(PRINTED_22_8,), derived=phi),
            Equation(number="22.9", states="M1 .. M4", readings=(PRINTED_22_9,), derived=functions),
        )
    )
