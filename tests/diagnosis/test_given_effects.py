"""Diagnosis that goes on from a model with effects: they stay, are not judged, and what else is missing is found."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from modeling.chain.model import planar
from modeling.effects import named
from tests.shared.recordings import CANDIDATES, DRAG, drag_and_leak
from tests.shared.rigs import RIG
from truewrench.command_line import main
from truewrench.commands.effect_choice import candidate_effects
from truewrench.text.diagnosis_text import diagnosis_text

pytest.importorskip("mujoco")

STANDARD_DEVIATIONS = 4.0
"""Of an estimate from the truth: one in 16 000 is farther."""


@cache
def diagnosed(*given: str) -> Diagnosis:
    model = planar(RIG) + [named(i) for i in given]
    return diagnose(model, drag_and_leak(1), validate=drag_and_leak(501), effects=[named(i) for i in CANDIDATES])


def test_the_rest_is_found_beside_what_is_given() -> None:
    found, whole = diagnosed("viscous_drag"), diagnosed()
    assert found.verdict is whole.verdict is RecordVerdict.EXPLAINED
    assert (found.given, found.added) == (("viscous_drag",), ("sensor_crosstalk",))
    assert set(whole.added) == {"viscous_drag", "sensor_crosstalk"}
    estimate = found.fit.parameters["viscous_drag.c"]
    assert abs(estimate.value - DRAG.c) < STANDARD_DEVIATIONS * estimate.std
    for name, value in whole.fit.values.items():
        assert abs(found.fit.values[name] - value) < 0.1 * whole.fit.parameters[name].std, name


def test_a_given_effect_is_not_judged_nor_dropped() -> None:
    found = diagnosed("com_offset")
    assert found.given == ("com_offset",)
    assert {f.effect.id for f in found.findings} == {"viscous_drag", "sensor_crosstalk"}
    assert "com_offset" in [e.id for e in found.model.effects]
    assert set(found.added) == {"viscous_drag", "sensor_crosstalk"}


def test_nothing_more_is_missing() -> None:
    found = diagnosed("viscous_drag", "sensor_crosstalk")
    assert found.verdict is RecordVerdict.NOTHING_MISSING
    assert found.added == ()
    text = diagnosis_text(found)
    assert text.startswith("Nothing more is missing: the residual of the rigid tool + viscous_drag + sensor_crosstalk")
    assert "Given viscous_drag" in text
    assert json.loads(json.dumps(found.to_data()))["given"] == ["viscous_drag", "sensor_crosstalk"]


def test_what_is_rightly_given_has_no_alternative() -> None:
    assert diagnosed("viscous_drag", "sensor_crosstalk").given_alternatives == ()


def test_candidates_are_chosen_by_id() -> None:
    everything = [e.id for e in candidate_effects(Case(planar(RIG), ()), [], [])]
    assert len(everything) > 20
    assert [e.id for e in candidate_effects(Case(planar(RIG), ()), ["sensor_lag", "com_offset"], [])] == [
        "sensor_lag",
        "com_offset",
    ]
    assert [e.id for e in candidate_effects(Case(planar(RIG), ()), [], ["sensor_lag"])] == [
        i for i in everything if i != "sensor_lag"
    ]


REFUSED = {
    "no effect is called 'sensor_lagg'; did you mean": ["--without", "sensor_lagg"],
    "no candidate effect is left": ["--only", "sensor_lag", "--given", "sensor_lag"],
    "'sensor_lag' is in the model already": ["--given", "sensor_lag", "--given", "sensor_lag"],
}


@pytest.mark.parametrize("message", REFUSED)
def test_a_wrong_choice_is_one_line(message: str, tmp_path: Path, capsys) -> None:  # type: ignore[no-untyped-def]
    rig, log = tmp_path / "rig.toml", tmp_path / "run.csv"
    rig.write_text("[robot]\ntip_length = 0.2\n")
    rows = "\n".join(f"{i / 100},{0.001 * i},0.1,0,1,2,0.3" for i in range(400))
    log.write_text(f"time,phi,ax,ay,fx,fy,tau\n{rows}\n")
    assert main(["diagnose", str(log), "--rig", str(rig), *REFUSED[message]]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
