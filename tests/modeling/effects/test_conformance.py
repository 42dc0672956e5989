"""Every check on every effect of the catalogue, by itself; and that the checks find what is wrong."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import pytest
import sympy as sp

from modeling.chain.chain import Chain
from modeling.effects import catalogue
from modeling.effects.disturbances import BiasDrift
from modeling.effects.loads import ViscousDrag
from modeling.parameter import Parameter
from modeling.space import Space
from tests.modeling.effects import checks
from tests.modeling.effects.cases import CASES, Case
from tests.modeling.effects.units import OWN_CONSTANTS, departure, foreign_theta

every_case = pytest.mark.parametrize("case", CASES, ids=str)

UNSEEN: Mapping[str, tuple[str, ...]] = {
    f"{effect}-SPACE": (f"{effect}.{name}_1",)
    for effect, name in (
        ("joint_offset", "offset"),
        ("joint_elasticity", "compliance"),
        ("joint_backlash", "width"),
        ("link_length_error", "error"),
    )
}
"""What no reading shows in the case's motion: where a slide stands that carries all, and how long the link is on it."""


def test_every_effect_has_a_case_in_every_space() -> None:
    assert {(case.space, case.effect) for case in CASES} == {(s, e) for s in Space for e in catalogue(s)}


@every_case
@pytest.mark.parametrize("check", [name for name in checks.CHECKS if name not in ("recovered", "C = Python")])
def test_effect_keeps(check: str, case: Case) -> None:
    checks.CHECKS[check](case)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.long if case.space is Space.SPACE else [])
        for case in CASES
        if checks.emitted_quickly(case)
    ],
    ids=str,
)
def test_emitted_c_is_what_python_says(case: Case) -> None:
    checks.c_agrees(case)


@every_case
def test_amount_is_recovered_but_for_what_no_motion_shows(case: Case) -> None:
    found = checks.amount_is_recovered(case)
    assert tuple(name for direction in found.unidentifiable for name in direction.names) == UNSEEN.get(str(case), ())


@every_case
def test_every_unit_is_put_to_the_test(case: Case) -> None:
    """A parameter of the effect with a third more than its stated unit makes it is found out."""
    theta, unseen = foreign_theta(case), UNSEEN.get(str(case), ())
    for number, parameter in enumerate(case.own, start=case.model.base_size):
        wrong = theta.copy()
        wrong[number] *= 1.33
        assert parameter.name in unseen or departure(case, wrong) > 10 * OWN_CONSTANTS, parameter.name


# ------------------------------------------------------------------------------ what the checks find


@dataclass(frozen=True)
class WrongUnit(ViscousDrag):
    """Drag whose coefficient is said to be that of a square law."""

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in the wrong unit."""
        c, *point = super().parameters(space)
        return (replace(c, unit="N s²/m²"), *point)


@dataclass(frozen=True)
class WrongEquation(ViscousDrag):
    """Drag with a metre too much in its equation."""

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push by c (v + d v)."""
        return super().perturb(chain, {**p, "c": p["c"] * (1 + p["d"])})


@dataclass(frozen=True)
class NeverGone(BiasDrift):
    """A drift that has begun before it is there."""

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add 0.1 N for nothing."""
        return super().perturb(chain, {**p, "fx_1": p["fx_1"] + 0.1})


@dataclass(frozen=True)
class Kinked(BiasDrift):
    """A drift without a derivative worth the name: it turns right beside where it is."""

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Rise twice as fast from half a step beyond the amount."""
        edge = self.amounts["N"] + checks.STEP / 2
        return super().perturb(chain, {**p, "fx_1": p["fx_1"] + sp.Max(0, p["fx_1"] - edge)})


@dataclass(frozen=True)
class Ambiguous(BiasDrift):
    """A drift that many amounts explain."""

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Go round in circles."""
        return super().perturb(chain, {**p, "fx_1": sp.sin(100 * p["fx_1"])})


@pytest.mark.parametrize(
    ("check", "effect"),
    [
        ("units", WrongUnit()),
        ("units", WrongEquation()),
        ("vanishes", NeverGone()),
        ("derivative", Kinked()),
        ("recovered", Ambiguous()),
    ],
    ids=["wrong unit", "wrong equation", "does not vanish", "no derivative", "not recovered"],
)
@pytest.mark.parametrize("space", list(Space), ids=lambda space: space.name)
def test_check_finds_what_is_wrong(check: str, effect: ViscousDrag | BiasDrift, space: Space) -> None:
    with pytest.raises(AssertionError):
        checks.CHECKS[check](Case(space, effect))


def test_checks_say_what_they_are() -> None:
    assert all(re.search(r"\w+ \w+", str(check.__doc__)) for check in checks.CHECKS.values())
