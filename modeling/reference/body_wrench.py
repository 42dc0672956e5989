"""Equations 22.5 to 22.9, the sensor's reading of the tip's dynamics, as printed and as derived.

Of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from functools import cache

import sympy as sp

from modeling.chain.model import WrenchModel, planar
from modeling.chain.regressor import regressor, regressor_functions
from modeling.reference.equation import Equation, Equations
from modeling.reference.path_kinematics import ALONG_X, ALONG_Y, AX, AY, DDPHI, DPHI, L_G, PHI, centre_of_mass

MASS, MLG, INERTIA = sp.symbols("m mlg I", real=True)
I_G = sp.Symbol("I_G", positive=True)
"""Inertia about the centre of mass, kg m²."""
BODY_ABOUT_CENTRE = {MLG: MASS * L_G, INERTIA: I_G + MASS * L_G**2}
"""First moment and inertia about Ps in 22.6, of a body with its centre of mass at l_g."""
G = sp.Symbol("g", positive=True)
BIASES = sp.symbols("bias_fx bias_fy bias_tau", real=True)
THETA = sp.Matrix([*BIASES, MASS, MLG, INERTIA])
"""Parameter vector of 22.6."""
MOTION_FUNCTIONS = sp.symbols("M1:5", real=True)

A_GX, A_GY = (
    sp.expand(sp.expand(centre_of_mass(2).dot(axis)).subs(sp.sin(PHI) ** 2, 1 - sp.cos(PHI) ** 2))
    for axis in (ALONG_X, ALONG_Y)
)
"""Components of a_G along x' and y', without squares of sines: SymPy's simplify finds the same in a second."""

PRINTED_22_8 = sp.Matrix(
    [
        [1, 0, 0, MOTION_FUNCTIONS[0], MOTION_FUNCTIONS[1], 0],
        [0, 1, 0, MOTION_FUNCTIONS[2], MOTION_FUNCTIONS[3], 0],
        [0, 0, 1, 0, MOTION_FUNCTIONS[0], MOTION_FUNCTIONS[1]],
    ],
)
PRINTED_22_9 = sp.Matrix(
    [
        AX * sp.cos(PHI) - (AY + G) * sp.sin(PHI),
        DDPHI,
        -(AX * sp.sin(PHI) + (AY + G) * sp.cos(PHI)),
        DPHI**2,
    ]
)
PRINTED_22_5 = (
    -MASS * A_GX - MASS * G * sp.sin(PHI),
    -MASS * A_GY - MASS * G * sp.cos(PHI),
    -INERTIA * DDPHI + MASS * L_G * (A_GX + G) * sp.sin(PHI),
)
"""22.5 without its biases."""


@cache
def derived_load() -> sp.Matrix:
    """The planar model without biases, in m, mlg, I and g: Newton-Euler about the sensor origin."""
    model = planar()
    return with_g(model.load, model)


@cache
def wrench_about_centre() -> sp.Matrix:
    """The same derived independently: Newton's law for the centre of mass, Euler's about it, transferred to Ps.

    The sensor exerts F = m (a_G - gravity). Its channels are F along x', F along -y', and the clockwise torque about
    Ps, I_G ddphi + l_g F_x'.
    """
    up = sp.Matrix([0, G])
    across, along = MASS * (A_GX + up.dot(ALONG_X)), MASS * (A_GY + up.dot(ALONG_Y))
    return sp.Matrix([across, -along, I_G * DDPHI + L_G * across])


def with_g(expression: sp.Matrix, model: WrenchModel) -> sp.Matrix:
    """The expression with the symbol g for the model's gravity."""
    return expression.subs(sp.Float(model.gravity), G)


def derived_regressor() -> tuple[sp.Matrix, sp.Matrix]:
    """Phi of the planar model with its entries named M1 .. M4, and these functions (4, 1)."""
    model = planar()
    derived = regressor_functions(model)
    functions = [derived.M1, derived.M2, derived.M3, derived.M4]
    names = dict(zip(functions, MOTION_FUNCTIONS, strict=True))
    phi = regressor(model).applyfunc(lambda entry: names.get(entry, entry))
    return phi, with_g(sp.Matrix(functions), model)


def wrench_equations() -> Equations:
    """22.5 and 22.6 against Newton and Euler about the centre of mass, 22.7 to 22.9 against the planar model."""
    derived = wrench_about_centre()
    phi, functions = derived_regressor()
    theta = sp.Matrix([p.symbol for p in planar().parameters])
    reading = derived_load() + planar().bias
    rows = [
        Equation(
            number="22.5",
            states=f"{channel} - bias",
            readings=(sp.Matrix([printed]),),
            derived=sp.Matrix([derived[i]]),
            constants=(INERTIA,) if i == 2 else (),  # about which point, is not said
            erratum=None if i == 1 else 1,
        )
        for i, (channel, printed) in enumerate(zip(("fx", "fy", "tau"), PRINTED_22_5, strict=True))
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
                derived=about_ps.subs(BODY_ABOUT_CENTRE),
                erratum=2,
            ),
            Equation(
                number="22.7",
                states="Y - V",
                readings=((PRINTED_22_8 * THETA).subs(dict(zip(MOTION_FUNCTIONS, PRINTED_22_9, strict=True))),),
                derived=reading,
            ),
            Equation(number="22.8", states="Phi", readings=(PRINTED_22_8,), derived=phi),
            Equation(number="22.9", states="M1 .. M4", readings=(PRINTED_22_9,), derived=functions),
        )
    )
