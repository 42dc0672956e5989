"""Arguments of another type: a sentence that says what to give, or what was meant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

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


FRAME = pd.DataFrame({"fx": [0.0]})
ANY: Any = tw
MISTAKES: dict[str, tuple[Callable[[Any], object], str]] = {
    "fit of a data frame": (lambda r: ANY.fit(tw.planar(), FRAME), "a recording is needed, not a DataFrame"),
    "fit of a path": (lambda r: ANY.fit(tw.planar(), "train.csv"), "a recording is needed, not a str"),
    "fit of a number": (lambda r: ANY.fit(tw.planar(), 3), "a recording is needed, not a int"),
    "diagnose a data frame": (lambda r: ANY.diagnose(tw.planar(), FRAME), "a recording is needed, not a DataFrame"),
    "diagnose with a rig": (lambda r: ANY.diagnose(tw.Rig.from_data({}), r), "a Rig is no model"),
    "validate with a path": (
        lambda r: ANY.diagnose(tw.planar(), r, validate="v.csv"),
        "validate: a recording is needed",
    ),
    "study of a data frame": (lambda r: ANY.study(None, FRAME), "a recording is needed, not a DataFrame"),
    "a model of a path": (lambda r: ANY.planar("rig.toml"), "a str is no rig; read it"),
    "an id for an effect": (lambda r: ANY.planar() + "viscous_drag", "tw.effects.named('viscous_drag')"),
    "a class for an effect": (lambda r: ANY.planar() + dict, "a type is no effect"),
    "ids for candidates": (lambda r: ANY.diagnose(tw.planar(), r, effects=["sensor_lag"]), "named('sensor_lag')"),
    "read of a data frame": (lambda r: ANY.read(FRAME), "a DataFrame is no path"),
    "save of a model": (lambda r: ANY.save(tw.planar(), "model.json"), "a WrenchModel is no fitted model"),
    "emit of a recording": (lambda r: ANY.emit(r, "numpy"), "a Recording is no fitted model"),
    "part of an id": (lambda r: tw.effects.named("drag"), "viscous_drag"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_gets_a_sentence(recording: tw.Recording, mistake: str) -> None:
    made, said = MISTAKES[mistake]
    with pytest.raises(tw.InputError) as caught:
        made(recording)
    assert said in str(caught.value)


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


def test_tool_is_a_line_of_the_fit(recording: tw.Recording) -> None:
    fitted = tw.fit(tw.planar(), recording)
    mass, centre = fitted["m"], tw.CentreOfMass.of(fitted)
    (tool,) = [line for line in str(fitted.summary()).splitlines() if line.startswith("Tool: ")]
    assert estimate_text(mass.value, mass.std, "kg") in tool
    assert estimate_text(1e3 * centre.value[0], 1e3 * centre.std[0], "mm") in tool
