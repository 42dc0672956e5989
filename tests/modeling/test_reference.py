"""The chapter's printed equations: the verdicts follow the differences, and change when a printed equation does."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import sympy as sp

from modeling.kinematics.arm import forward_kinematics
from modeling.reference import (
    Equations,
    EquationVerdict,
    Errata,
    Erratum,
    ErratumProof,
    contact_equations,
    path_equations,
    vanishes,
    wrench_equations,
)
from modeling.reference.body_wrench import A_GX, INERTIA, MASS, G
from modeling.reference.path_kinematics import ANGLES, DDPHI, L_G, LINKS, PHI


@cache
def equations() -> Equations:
    return Equations((*path_equations(), *wrench_equations(), *contact_equations()))


def test_kinematics_of_the_arm_are_22_2() -> None:
    """The arm's own forward kinematics, with letters for the lengths."""
    pose = forward_kinematics(LINKS)
    assert vanishes(sp.Matrix([pose["px"], pose["py"]]) - equations()["22.2 Ps"].derived)


def test_acceleration_of_the_centre_is_that_of_a_longer_last_link() -> None:
    """22.4 with Ps'', phi' and phi'' of the joints: the second derivative of an arm whose last link is l3 + l_g."""
    pose, longer = (forward_kinematics((*LINKS[:2], LINKS[2] + extra)) for extra in (sp.S.Zero, L_G))
    signals = {sp.Symbol(key, real=True): pose[key] for key in ("phi", "dphi", "ddphi", "ax", "ay")}
    acceleration = equations()["22.4 a_G"].derived.subs(signals, simultaneous=True)
    # At a point in numbers: both sides are trigonometric polynomials of nine signals.
    values = {s: sp.Rational(i + 2, 7) for i, s in enumerate(sorted(acceleration.free_symbols, key=str))}
    assert set(ANGLES) <= set(values)
    difference = (acceleration - sp.Matrix([longer["ax"], longer["ay"]])).subs(values)
    assert all(abs(entry.evalf()) < 1e-12 for entry in difference)  # rounding


def test_what_agrees_would_not_if_a_sign_were_wrong() -> None:
    """Each entry that is not zero, turned round by itself."""
    for equation in equations().of(EquationVerdict.AGREES):
        printed = equation.readings[0]
        for place in (i for i, entry in enumerate(printed) if entry != 0):
            wrong = printed.copy()
            wrong[place] = -wrong[place]
            assert replace(equation, readings=(wrong,), erratum=None).verdict is EquationVerdict.OPEN
            assert replace(equation, readings=(wrong,), erratum=9).verdict is EquationVerdict.ERRATUM


def test_an_erratum_is_none_where_print_and_derivation_agree() -> None:
    errata = equations().of(EquationVerdict.ERRATUM)
    assert {e.erratum for e in errata} == {1, 2, 3, 7}
    for equation in errata:
        mended = replace(equation, readings=(*equation.readings, equation.derived))
        assert mended.verdict is EquationVerdict.AGREES
        assert mended.mark == "agrees"


def test_row_3_is_refuted_and_its_mended_form_is_not() -> None:
    """With sin phi taken from the a_Gx' term some I fits: then nothing is left without it at phi = 0."""
    row = equations()["22.5 tau - bias"]
    assert row.verdict is EquationVerdict.NOT_DERIVABLE
    mended = replace(row, readings=(sp.Matrix([-INERTIA * DDPHI + MASS * L_G * (A_GX + G * sp.sin(PHI))]),))
    assert not mended.unmatched(mended.differences[0])
    assert mended.verdict is EquationVerdict.OPEN


def test_a_claim_that_is_not_so_is_not_shown() -> None:
    x = sp.Symbol("x")
    right, wrong = ErratumProof.same("a square", (x + 1) ** 2, x**2 + 2 * x + 1), ErratumProof.same("none", x, x + 1)
    assert right.holds
    assert not wrong.holds
    assert "NOT PROVED" in str(wrong)
    assert ErratumProof.other("not one", x, x + 1).holds
    assert not Erratum(1, "says", (right, wrong)).proven
    assert not Erratum(1, "says", ()).proven
    assert not Errata((Erratum(1, "says", (right,)), Erratum(2, "says", (wrong,)))).proven


def test_tables_print_every_cell() -> None:
    table = str(equations())
    assert max(map(len, table.splitlines())) <= 120
    rows = [row for e in equations() for row in (e.number, e.mark.split(",")[0])]
    assert all(cell in table for cell in rows)
    assert "agrees, 5 erratum, 1 not derivable, 1 open" in table.splitlines()[-1]
    assert equations()._repr_html_().count("<tr>") == 1 + len(equations().members)


def test_latex_is_balanced() -> None:
    erratum = Erratum(1, "of x_1", (ErratumProof.same("none", sp.Symbol("x"), sp.Symbol("x")),))
    for latex in (*(e._repr_latex_() for e in equations()), erratum._repr_latex_()):
        assert latex.count("{") == latex.count("}")
        assert latex.count(r"\left") == latex.count(r"\right")
        assert latex.count(r"\begin") == latex.count(r"\end")
        assert latex.startswith("$")
        assert latex.endswith("$")
