"""Every effect against MuJoCo's physics."""

from __future__ import annotations

import pytest

from tests.modeling.effects.cases import CASES, Case
from tests.modeling.effects.same_physics import OWN_SHAPE, same_physics_as_mujoco, simulated_too

pytest.importorskip("mujoco")


@pytest.mark.parametrize("case", [case for case in CASES if simulated_too(case)], ids=str)
def test_effect_is_that_of_the_simulated_rig(case: Case) -> None:
    same_physics_as_mujoco(case)


def test_every_effect_is_simulated_but_those_that_are_named() -> None:
    of_joints = {case.effect.id for case in CASES if case.effect.needs_joints}
    assert {case.effect.id for case in CASES if not simulated_too(case)} == {*OWN_SHAPE, *of_joints}
