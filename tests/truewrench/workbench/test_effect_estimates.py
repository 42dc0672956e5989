"""Effects that are collinear in the recordings are not both to be dropped, and what is fixed is said to be."""

from __future__ import annotations

from pathlib import Path

import pytest

import truewrench as tw
from diagnosis.study import Study
from modeling.formulas.custom_effect import CustomEffect
from tests.truewrench.workbench.requests import opening
from truewrench.workbench.effect_estimates import effect_sizes, weakness
from truewrench.workbench.study_words import StepLine

pytest.importorskip("mujoco")


@pytest.fixture
def study(tmp_path: Path) -> Study:
    """A rig with a drag, which is added."""
    request = opening(tmp_path)
    begun = tw.study(request["rig"], request["recordings"])
    begun.add("viscous_drag")
    return begun


def test_of_two_collinear_effects_one_is_dropped(study: Study) -> None:
    study.add(copy_of_the_drag())
    drag, copy = study.model.effects
    said = [weakness(drag, study), weakness(copy, study)]
    assert all("viscous_drag and drag_again share one effect here: drop one, not both" in text for text in said), said
    study.drop("drag_again")
    assert weakness(study.model.effects[0], study) == ""


def copy_of_the_drag() -> CustomEffect:
    """The same drag, but for a difference that is too small to matter."""
    table = {
        "id": "drag_again", "title": "the drag again", "parameters": {"c": "N*s/m"},
        "tip_body": {"force_x": "-c*tip_vx", "force_y": "-c*tip_vy*(1 + 0.001*sin(phi))", "at": "place"},
        "constants": {"place": "0.12 m"},
    }  # fmt: skip
    return CustomEffect.from_data(table, where="test")


def test_the_line_of_the_last_step_has_the_error_before_and_after(study: Study) -> None:
    line = StepLine().then("rigid tool", study)
    assert "→" not in line.words()
    study.undo()
    changed = line.then("undone", study).words()
    assert changed.startswith("undone: error / noise floor ")
    assert "→" in changed


def test_what_is_fixed_is_said_to_be(study: Study) -> None:
    assert "fixed" not in effect_sizes(study.model.effects[0], study.fit)
