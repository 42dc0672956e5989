"""Arguments of another type: a sentence that says what to give, or what was meant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import truewrench as tw
from modeling.number_format import estimate_text
from truewrench.simulated_rig import PlanarRig, simulate, write_recording

RIG = PlanarRig()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("arguments")
    frame = simulate(RIG, RIG.random_motion(seed=1), repeats=2, samples_per_period=250, seed=1)
    write_recording(frame, where / "train.csv")
    arm = f"[robot]\nlink_lengths = {list(RIG.link_lengths)}\n"
    (where / "rig.toml").write_text(f"{arm}[sensor]\nnoise = {{ fx = 0.1, fy = 0.1, tau = 0.01 }}\n")
    return where


@pytest.fixture(scope="module")
def recording(folder: Path) -> tw.Recording:
    return tw.read(folder / "train.csv", rig=folder / "rig.toml")


def six_axes(recording: tw.Recording) -> tw.Recording:
    """A recording of the other kind of sensor."""
    channels = ("fx", "fy", "fz", "tx", "ty", "tz")
    return replace(recording, channels=channels, wrench=np.zeros((recording.samples, 6)))


FRAME = pd.DataFrame({"fx": [0.0]})
ANY: Any = tw
MISTAKES: dict[str, tuple[Callable[[Any], object], str]] = {
    "fit of a data frame": (lambda r: ANY.fit(tw.planar(), FRAME), "a recording is needed, not a DataFrame"),
    "fit of a path": (lambda r: ANY.fit(tw.planar(), "train.csv"), "a recording is needed, not a str"),
    "fit of a number": (lambda r: ANY.fit(tw.planar(), 3), "a recording is needed, not an int"),
    "diagnose a data frame": (lambda r: ANY.diagnose(tw.planar(), FRAME), "a recording is needed, not a DataFrame"),
    "diagnose with a rig": (lambda r: ANY.diagnose(tw.Rig.from_data({}), r), "a Rig is no model"),
    "validate with a path": (
        lambda r: ANY.diagnose(tw.planar(), r, validate="v.csv"),
        "validate: a recording is needed",
    ),
    "study of a data frame": (lambda r: ANY.study(None, FRAME), "a recording is needed, not a DataFrame"),
    "a model of a path": (lambda r: ANY.planar("rig.toml"), "a str is no rig; read it"),
    "an unknown id for an effect": (
        lambda r: tw.planar() + "viscous",
        "no effect is called 'viscous'; did you mean visc",
    ),
    "an effect taken off": (lambda r: tw.planar() - "viscous_drag", "model.without('viscous_drag')"),
    "without what is not there": (lambda r: tw.planar().without("time_delay"), "the model is the rigid tool alone"),
    "without what is misspelt": (
        lambda r: (tw.planar() + "time_delay" + "com_offset").without("com_ofset"),
        "'com_ofset' is not in the model; did you mean com_offset?",
    ),
    "a class for an effect": (lambda r: ANY.planar() + dict, "a type is no effect"),
    "a recording compensated by a fit": (lambda r: ANY.compensate(r, tw.fit(tw.planar(), r)), "are swapped"),
    "a recording compensated by a path": (lambda r: ANY.compensate("model.json", r), "a str is no fitted model"),
    "compensation of a path": (lambda r: ANY.compensate(tw.fit(tw.planar(), r), "r.csv"), "recording is needed, not a"),
    "a study of a rig": (lambda r: ANY.study(r, r.rig), "the rig and the recordings are swapped; swap them"),
    "a study of a rig's path": (lambda r: tw.study("cal.csv", "robot.toml"), "are swapped; swap them"),
    "a step compared with itself": (lambda r: tw.study(None, r).compare(0, 0), "one step has nothing to be compared"),
    "unknown ids for candidates": (lambda r: tw.diagnose(tw.planar(), r, effects=["sensor_lg"]), "mean sensor_lag"),
    "read of a data frame": (lambda r: ANY.read(FRAME), "a DataFrame is no path"),
    "save of a model": (lambda r: ANY.save(tw.planar(), "model.json"), "a WrenchModel is no fitted model"),
    "emit of a recording": (lambda r: ANY.emit(r, "numpy"), "a Recording is no fitted model"),
    "no recording": (lambda r: ANY.fit(tw.planar(), None), "no recording was given"),
    "nothing among recordings": (lambda r: ANY.fit(tw.planar(), [r, None]), "a recording is needed, not None"),
    "too few noises": (lambda r: tw.fit(tw.planar(), r, noise=[]), "0 noises of 1 recordings"),
    "robust fit of a path": (lambda r: ANY.robust_fit(tw.planar(), "r.csv"), "a recording is needed, not a str"),
    "robust fit swapped": (lambda r: ANY.robust_fit(r, tw.planar()), "a Recording is no model"),
    "robust fit of chunks": (lambda r: ANY.robust_fit(tw.planar(), tw.chunks(r, 100)), "is needed, not a Chunk"),
    "compensation of nothing": (lambda r: ANY.compensate(tw.fit(tw.planar(), r), None), "is needed, not None"),
    "calibration swapped": (lambda r: ANY.calibrate(r, tw.planar()), "a Recording is no model"),
    "calibration of several": (lambda r: ANY.calibrate(tw.planar(), [r]), "a recording is needed, not a list"),
    "unknown id to calibrate": (lambda r: tw.calibrate(tw.planar(), r, effects=["sensor_lg"]), "mean sensor_lag"),
    "validation of another sensor": (
        lambda r: tw.diagnose(tw.planar(), r, validate=six_axes(r)),
        "its channels are fx, fy, fz",
    ),
    "part of an id": (lambda r: tw.effects.named("drag"), "viscous_drag"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_gets_a_sentence(recording: tw.Recording, mistake: str) -> None:
    made, said = MISTAKES[mistake]
    with pytest.raises(tw.InputError) as caught:
        made(recording)
    assert said in str(caught.value)


def test_a_recording_is_no_model_file(folder: Path) -> None:
    with pytest.raises(tw.InputError, match="a recording where a model file belongs; give the JSON"):
        tw.load(folder / "train.csv")
    with pytest.raises(tw.InputError) as caught:
        tw.load(folder / "missing.csv")
    assert "where a model" not in str(caught.value)


def test_effects_by_their_ids() -> None:
    given: list[str | tw.effects.Effect] = ["viscous_drag", tw.effects.time_delay()]
    several = tw.planar() + given
    assert several == tw.planar() + "viscous_drag" + "time_delay"
    assert several.without("viscous_drag") == several.without(tw.effects.viscous_drag()) == tw.planar() + "time_delay"


def test_effects_are_completed_by_their_ids() -> None:
    """And nothing else; what is imported from the package stays importable."""
    shown = dir(tw.effects)
    assert {e.id for e in tw.effects.catalogue()} == set(shown) - {"CATALOGUE", "Effect", "catalogue", "named"}
    assert all(hasattr(tw.effects, name) for name in shown)
    with pytest.raises(AttributeError, match="no effect is called 'com_ofset'; did you mean com_offset"):
        _ = tw.effects.com_ofset
    everything: dict[str, object] = {}
    exec("from modeling.effects import *; from modeling.effects import loads", everything)  # noqa: S102
    assert {"named", "catalogue", "loads"} <= set(everything)


def test_rig_by_its_path(folder: Path) -> None:
    found = tw.read(folder / "train.csv", rig=folder / "rig.toml")
    assert found.rig is not None
    assert found.rig.sensor is not None
    assert found.rig.sensor.noise == {"fx": 0.1, "fy": 0.1, "tau": 0.01}


def test_study_refuses_a_recording_given_twice(recording: tw.Recording) -> None:
    with pytest.raises(tw.InputError, match="has the same readings as"):
        tw.study(None, recording, validate=recording)


def test_loaded_model_is_as_good_as_its_fit(recording: tw.Recording, folder: Path) -> None:
    study = tw.study(None, recording)
    path = tw.save(study, folder / "model.json")
    loaded = tw.load(path)
    assert tw.emit(loaded, "numpy") == tw.emit(path, "numpy") == tw.emit(study, "numpy")
    of_fit, of_file = tw.CentreOfMass.of(study.fit), tw.CentreOfMass.of(loaded)
    np.testing.assert_allclose(of_file.value, of_fit.value)
    np.testing.assert_allclose(of_file.std, of_fit.std)


def test_compensated_readings_have_no_tool(recording: tw.Recording) -> None:
    noise = np.random.default_rng(1).normal(size=recording.wrench.shape) * RIG.noise
    found = tw.fit(tw.planar(), replace(recording, wrench=noise))
    assert "Tool: none, m " in str(found.summary())


def test_compensated_poses_have_no_tool_however_few() -> None:
    """Eight orientations at random, of noise alone: the std of the mass leaves room for the forces' own size."""
    for seed in range(6):
        rng, turns = np.random.default_rng(seed), Rotation.random(8, random_state=seed).as_quat()
        readings = rng.normal(size=(8, 6)) * [0.07, 0.08, 0.09, 0.005, 0.005, 0.003]
        names = ["qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz"]
        frame = pd.DataFrame(np.hstack([turns, readings]), columns=names)
        rig = tw.Rig.from_data({"sensor": {"convention": "on_tool"}})
        said = str(tw.fit(tw.spatial(rig), tw.from_dataframe(frame, rig=rig)).summary())
        assert "Tool: none, m " in said


def test_a_tool_that_hardly_turns_is_not_called_weightless(recording: tw.Recording) -> None:
    """Forces of 100 N that do not change: any weight may be in the zero."""
    noise = np.random.default_rng(1).normal(size=recording.wrench.shape) * 30 * np.array(RIG.noise)
    constant = np.broadcast_to([100.0, 0.0, 0.0], noise.shape)
    columns = {name: column * (1.0 if name == "time" else 1e-3) for name, column in recording.columns.items()}
    still = recording.moved(columns=columns).with_readings(constant + noise)
    assert "Tool: not known, m " in str(tw.fit(tw.planar(), still).summary())


def test_tool_is_a_line_of_the_fit(recording: tw.Recording) -> None:
    fitted = tw.fit(tw.planar(), recording)
    mass, centre = fitted["m"], tw.CentreOfMass.of(fitted)
    (tool,) = [line for line in str(fitted.summary()).splitlines() if line.startswith("Tool: ")]
    assert estimate_text(mass.value, mass.std, "kg") in tool
    assert estimate_text(1e3 * centre.value[0], 1e3 * centre.std[0], "mm") in tool


def test_the_readings_of_another_motion_are_another_recording(recording: tw.Recording) -> None:
    """A fit predicts its own recording as it read it, and what differs in more than the name by the model."""
    fit = tw.fit(tw.planar(), recording)
    own, angles = fit.predict(), dict(recording.columns)
    angles["q1"] = 1.3 * angles["q1"]
    assert recording.rig is not None
    longer = replace(recording.rig, link_lengths=(1.0, 0.97, 0.8))
    for other in (recording.moved(columns=angles), recording.moved(rig=longer)):
        assert fit.number_of(other) is None
        assert ((fit.predict(other) - own).abs() > 0.1).any(axis=None)
        assert tw.compare(fit, other).recording.motion is not fit.recordings[0].motion
    renamed = replace(recording, name="another name")
    assert fit.number_of(recording) == fit.number_of(renamed) == 0
    decided = replace(fit.recordings[0], moved_as_measured=True)
    assert decided.moved(columns=angles).moved_as_measured is None


def test_a_fit_refuses_the_first_chunk(recording: tw.Recording) -> None:
    """Before a log that is longer than memory is read on."""
    chunks = tw.chunks(recording, 100)
    with pytest.raises(tw.InputError, match="noise cannot be estimated from chunks"):
        ANY.fit(tw.planar(), chunks)
    assert len([*chunks]) == recording.samples // 100 - 1
