"""The loop by hand: what is hidden in a simulated rig is suspected, added, seen to explain, taken away and undone."""

from __future__ import annotations

import re
from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import truewrench as tw
from diagnosis.comparison.residual_map import map_variables, samples_of_cell
from diagnosis.diagnosis import diagnose
from diagnosis.study import Study, study
from diagnosis.verdict_rule import RecordVerdict
from estimation.fit import fit
from modeling.chain.model import planar
from modeling.effects import named
from modeling.errors import InputError
from modeling.formulas.python_definition import own_effect
from modeling.significance import LEVELS
from tests.shared.recordings import CANDIDATES, drag_and_leak
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, ViscousDrag, simulate, write_recording

pytest.importorskip("mujoco")

MOISTURE = own_effect(
    id="moisture",
    title="zero follows a column",
    parameters={"slope": "N"},
    inputs={"moisture": "1"},
    zero={"fx": "slope * moisture"},
)
EFFECTS = [named(i) for i in (*CANDIDATES, "link_length_error")]


@cache
def first_step() -> Study:
    """Data with a drag and a leak between channels."""
    return study(planar(RIG), drag_and_leak(1), validate=drag_and_leak(501), effects=EFFECTS)


@pytest.fixture
def begun() -> Study:
    """A study to go on with: a study replaces its steps and changes none, so that the first one stays as it is."""
    return copy(first_step())


def worst(begun: Study) -> list[float]:
    return [float(v) for v in begun.table.to_frame()["error / noise floor"]]


def test_the_error_falls_with_what_is_missing_and_rises_without_it(begun: Study) -> None:
    assert set(begun.suspects().ids) >= {"viscous_drag", "sensor_crosstalk"}
    begun.add("viscous_drag")
    begun.add("sensor_crosstalk")
    first, second, third = worst(begun)
    assert first > second > third
    assert begun.steps[-1].training[0].lack_of_fit >= LEVELS.effect
    assert begun.suspects().ids == ()
    begun.drop("viscous_drag")
    assert worst(begun)[-1] > second
    begun.undo()
    assert [s.change for s in begun.steps] == ["rigid tool", "+ viscous_drag", "+ sensor_crosstalk"]
    assert begun.effects == ("viscous_drag", "sensor_crosstalk")


def test_what_was_undone_is_done_again(begun: Study) -> None:
    first = begun.add("viscous_drag")
    begun.undo()
    assert begun.undone == 1
    assert begun.redo() is first
    begun.undo()
    begun.add("com_offset")
    with pytest.raises(InputError, match="nothing to redo"):
        begun.redo()


def test_by_hand_is_as_by_itself(begun: Study) -> None:
    """The same estimates as of a fit of the model, and as of a diagnosis that found both."""
    begun.add("viscous_drag")
    begun.add("sensor_crosstalk")
    model = planar(RIG) + named("viscous_drag") + named("sensor_crosstalk")
    whole = fit(model, drag_and_leak(1))
    found = diagnose(planar(RIG), drag_and_leak(1), validate=drag_and_leak(501), effects=EFFECTS)
    for name, estimate in begun.fit.parameters.items():
        assert abs(whole.values[name] - estimate.value) < 0.01 * estimate.std
        assert abs(found.fit.values[name] - estimate.value) < 0.1 * estimate.std


def test_a_dropped_effect_leaves_the_fit_that_was(begun: Study) -> None:
    before = begun.fit.values
    begun.add("com_offset")
    begun.drop("com_offset")
    for name, value in before.items():
        assert begun.fit.values[name] == pytest.approx(value, rel=1e-6, abs=1e-9)


def test_diagnosis_goes_on_from_where_one_is(begun: Study) -> None:
    begun.add("viscous_drag")
    found = begun.diagnose()
    assert found.verdict is RecordVerdict.EXPLAINED
    assert (found.given, found.added) == (("viscous_drag",), ("sensor_crosstalk",))
    assert [s.change for s in begun.steps] == ["rigid tool", "+ viscous_drag", "+ sensor_crosstalk"]
    assert len(begun.stairs().table.rows) == 1 + 2 * (1 + 3)


def test_diagnosis_starts_from_no_worse_a_fit(begun: Study) -> None:
    for effect in ("cable_spring", "gain_nonlinearity"):
        begun.add(effect)
    by_hand = begun.steps[-1].training[0].misfit
    found = diagnose(begun.model, begun.fit.recordings, effects=[])
    again = found.steps[0].training[0].misfit
    assert by_hand is not None
    assert again is not None
    assert again < 1.05 * by_hand


def test_where_it_fails_is_told_until_it_does_not(begun: Study) -> None:
    assert begun.where().comparison.lack_of_fit < 1e-6
    assert "resembles" in str(begun.where())
    assert "motion 501" in str(begun.where(1))
    assert str(begun.where("motion 501")) == str(begun.where(1))
    begun.add("viscous_drag")
    begun.add("sensor_crosstalk")
    assert "resembles" not in str(begun.where())
    with pytest.raises(InputError, match="no recording 2"):
        begun.where(2)


def test_a_variable_of_the_motion_is_named_before_a_column_that_repeats_it() -> None:
    recording = drag_and_leak(1)
    speed = recording.motion.model_signals["vx"]
    noise = 0.005 * speed.std() * np.random.default_rng(0).normal(size=len(speed))
    logged = recording.moved(columns={**recording.signals, "tcp_speed_0": speed + noise})
    where = study(planar(RIG), logged).where()
    places = [m.variable for m in where.maps if m.channel == "fx"]
    assert "tcp_speed_0" in places
    assert places.index("velocity x") < places.index("tcp_speed_0")


def test_steps_are_compared(begun: Study) -> None:
    begun.add("viscous_drag")
    begun.add("com_offset")
    names = [(d.better, d.worse) for d in begun.compare().differences]
    assert names == [("2: rigid tool + viscous_drag + com_offset", "0: rigid tool")]
    assert len(begun.compare(0, 1, 2).differences) == 3
    assert str(begun.compare("rigid tool", "+ com_offset")) == str(begun.compare())


REFUSED = {
    "no effect is called 'viscous_dragg'; did you mean": lambda s: s.add("viscous_dragg"),
    "moisture: it is not identifiable from these recordings": lambda s: s.add(MOISTURE),
    "'sensor_lag' is not in the model; the model is the rigid tool alone": lambda s: s.drop("sensor_lag"),
    "nothing to undo": lambda s: s.undo(),
    "there is no step 9; use 0 to 0": lambda s: s.compare(0, 9),
    "there is no step -1; use 0 to 0": lambda s: s.compare(-1),
    "there is no step '+ dragg'; use one of rigid tool": lambda s: s.compare("+ dragg"),
    "there is no recording 'motion'; did you mean motion 1": lambda s: s.where("motion"),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_done_is_a_sentence_and_no_step(message: str, begun: Study) -> None:
    with pytest.raises(InputError) as error:
        REFUSED[message](begun)
    assert message in str(error.value)
    assert len(begun.steps) == 1


def test_paths_serve_as_recordings_and_rig(tmp_path: Path) -> None:
    rig = PlanarRig()
    drag = (ViscousDrag(c=0.15, d=0.12),)
    frame = simulate(rig, rig.random_motion(seed=1), hidden=drag, repeats=4, samples_per_period=200)
    log = write_recording(frame, tmp_path / "run.csv")
    (tmp_path / "rig.toml").write_text("[robot]\nlink_lengths = [1.0, 0.97, 0.4]\ntip_length = 0.2\n")
    begun = tw.study(tmp_path / "rig.toml", log, effects=EFFECTS)
    begun.add("viscous_drag")
    assert abs(begun.fit.values["viscous_drag.c"] - 0.15) < 4 * begun.fit.parameters["viscous_drag.c"].std
    assert np.isfinite(worst(begun)).all()


def test_it_prints_in_a_few_lines(begun: Study) -> None:
    for shown in (begun, begun.suspects(), begun.where(), begun.stairs()):
        assert len(str(shown).splitlines()) < 40
        assert shown._repr_html_()
    assert repr(begun) == str(begun)


@pytest.mark.long(seconds=30)
def test_everything_has_a_report(begun: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truewrench.reports.report_html.MAX_MAP_VARIABLES", 2)  # all are in test_report.py
    begun.add("viscous_drag")
    begun.drop("viscous_drag")
    begun.add("viscous_drag")
    results: list[Any] = [begun.fit, begun.compare(), begun.diagnose(), begun]
    for number, result in enumerate(results):
        page, markdown = tw.report(result, tmp_path / str(number))
        assert page.read_text().startswith("<!doctype html>")
        assert "viscous" in markdown.read_text()
    for text in (path.read_text() for path in (tmp_path / "3").iterdir()):  # of the study
        assert "Steps of the study" in text
        rows = re.split(r"<tr>|\n", text.split("Steps of the study")[1])
        assert sum(any(f"{sign} viscous" in row for sign in "+-") for row in rows) >= 2
        assert "tolerance" in text
    results = [begun.fit.recordings[0]]
    with pytest.raises(InputError, match="a Recording has no report"):
        tw.report(results[0], tmp_path)


def test_a_step_says_which_recording_condemns_it(begun: Study) -> None:
    """Also when it is the held-out one alone."""
    first = begun.steps[0]
    assert first.misfitting == tuple(
        [c.recording.name for c in first.training] + [f"{c.recording.name} (held out)" for c in first.validation]
    )
    assert f"does not fit {', '.join(first.misfitting)}" in str(begun)
    consistent = tuple(replace(c, lack_of_fit=0.5) for c in first.training)
    condemned = replace(first, training=consistent)
    assert "does not fit" in repr(condemned)
    assert condemned.misfitting == tuple(f"{c.recording.name} (held out)" for c in first.validation)
    assert "no lack of fit" in repr(replace(condemned, validation=()))


def test_what_is_tried_is_no_step(begun: Study) -> None:
    tried = begun.tried("viscous_drag")
    assert "viscous_drag" in {effect.id for effect in tried.model.effects}
    assert len(begun.steps) == 1
    assert tried.values == begun.add("viscous_drag").fit.values


def test_the_samples_of_a_cell_are_those_that_its_map_counted(begun: Study) -> None:
    """Their mean is the centre of the cell; the cells of a map share out the samples."""
    where = begun.where()
    recording = where.comparison.recording
    known = map_variables(recording, recording.wrench - where.comparison.residual)
    for shown in where.maps[:4]:
        masks = [samples_of_cell(where.comparison, shown.variable, centre) for centre in shown.centre]
        means = [known[shown.variable][0][mask].mean() for mask in masks]
        np.testing.assert_allclose(means, shown.centre)
        assert np.sum(masks, axis=0).max() == 1
    with pytest.raises(InputError, match="no variable"):
        samples_of_cell(where.comparison, "passwd", 0.0)


def test_of_a_whole_catalogue_the_effects_of_the_plane_are_tried() -> None:
    """`effects=[*tw.effects.catalogue(), mine]` serves in the plane, too, where a spinning rotor does not show."""
    begun = study(planar(RIG), drag_and_leak(1), effects=tw.effects.catalogue())
    tried = {test.effect.id for test in begun.suspects().tests}
    assert "spinning_rotor" not in tried
    assert {"viscous_drag", "com_offset"} <= tried
