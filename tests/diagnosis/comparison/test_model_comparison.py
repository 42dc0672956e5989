"""Comparison of several models: the test of their difference is calibrated, and bands add up to the whole error."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

import truewrench as tw
from diagnosis.comparison.model_comparison import BandError, ModelComparison, compare
from diagnosis.comparison.slow_residual import SlowResidual
from estimation.fit import Fit, fit
from estimation.model_response import predicted_readings
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording, readings_digest
from modeling.chain.model import WrenchModel, planar
from modeling.effects import named
from modeling.rig import Rig
from truewrench.command_line import main
from truewrench.files.model_file import ModelFile

Array = NDArray[np.float64]

STD = np.array([0.2, 0.3, 0.02])
RIG_TEXT = """[robot]
tip_length = 0.2
[sensor]
noise = { fx = 0.2, fy = 0.3, tau = 0.02 }
"""
RIG = Rig.from_data(
    {"robot": {"tip_length": 0.2}, "sensor": {"noise": dict(zip(("fx", "fy", "tau"), STD, strict=True))}}
)
SEEDS = 30
LEVEL = 0.05
TAIL = 1e-3
"""Probability of a calibration test to fail although the level holds: at most so many of the seeds may be below it."""


def motion(phase: float, samples: int = 400) -> dict[str, Array]:
    t = np.arange(samples) / 100
    turn = 2 * np.pi * t / 4
    phi = np.sin(turn + phase) + 0.6 * np.sin(2 * turn) + 0.3 * np.cos(5 * turn)
    x, y = 0.8 * np.sin(turn + 1), 0.5 * np.cos(3 * turn + phase)
    rates = {"dphi": np.gradient(phi, t), "vx": np.gradient(x, t), "vy": np.gradient(y, t)}
    second = {name: np.gradient(rates[rate], t) for name, rate in (("ddphi", "dphi"), ("ax", "vx"), ("ay", "vy"))}
    return {"time": t, "phi": phi, "px": x, "py": y, **rates, **second}


def with_readings(columns: dict[str, Array], wrench: Array) -> Recording:
    readings = dict(zip(("fx", "fy", "tau"), wrench.T, strict=True))
    return from_columns({**columns, **readings}, name="run", rig=RIG)


def theta(model: WrenchModel, **values: float) -> Array:
    known = {"m": 1.2, "mlg": 0.1, "I": 0.02} | {k.replace("__", "."): v for k, v in values.items()}
    return np.array([known.get(p.name, p.nominal) for p in model.parameters])


@cache
def fitted(effect_id: str) -> Fit:
    """A model with one effect, fitted to readings of a rig with a drag between the two drags of the catalogue."""
    return fit(planar(RIG) + named(effect_id), drawn("both", 0.3, 1))


@cache
def blank_of(phase: float) -> Recording:
    """The motion without readings; what is drawn of it shares its signals."""
    return with_readings(motion(phase), np.zeros((400, 3)))


def drawn(truth: str, phase: float, seed: int) -> Recording:
    blank = blank_of(phase)
    model = planar(RIG) + named("viscous_drag") + named("quadratic_drag")
    size = {"viscous_drag__c": 0.3, "viscous_drag__d": 0.1} | {"quadratic_drag__c": 0.2, "quadratic_drag__d": 0.1}
    clean = predicted_readings(model, blank, theta(model, **(size if truth == "both" else {})))
    return blank.with_readings(clean + np.random.default_rng(seed).normal(0, STD, (400, 3)))


def halfway(seed: int) -> Recording:
    """Readings halfway between the predictions of two models: both err equally."""
    blank = blank_of(1.1)
    pair = [fitted("viscous_drag"), fitted("quadratic_drag")]
    sums = [predicted_readings(f.model, blank, f.theta) for f in pair]
    noise = np.random.default_rng(seed).normal(0, STD, (400, 3))
    return blank.with_readings((sums[0] + sums[1]) / 2 + noise)


def rejected(p_values: list[float]) -> int:
    return sum(p < LEVEL for p in p_values)


@pytest.mark.long
def test_models_that_err_equally_differ_at_the_stated_rate() -> None:
    pair = [fitted("viscous_drag"), fitted("quadratic_drag")]
    p_values = [compare(pair, halfway(seed)).differences[0].p_value for seed in range(SEEDS)]
    assert rejected(p_values) <= binom.isf(TAIL, SEEDS, LEVEL)
    assert rejected(p_values) >= binom.isf(1 - TAIL, SEEDS, LEVEL)


def test_an_effect_that_is_not_there_is_no_better_at_the_stated_rate() -> None:
    """Nested models, both fitted to the recordings compared: the likelihood ratio."""
    p_values = []
    for seed in range(SEEDS):
        recording = drawn("nothing", 0.3, seed)
        several = [fit(model, recording) for model in (planar(RIG), planar(RIG) + named("com_offset"))]
        p_values.append(compare(several, recording).differences[0].p_value)
    assert rejected(p_values) <= binom.isf(TAIL, SEEDS, LEVEL)
    assert rejected(p_values) >= binom.isf(1 - TAIL, SEEDS, LEVEL)


def true_and_rigid() -> list[Fit]:
    return [fit(planar(RIG), drawn("both", 0.3, 1)), fitted("viscous_drag")]


def test_the_better_model_is_better_where_neither_was_fitted() -> None:
    found = compare(true_and_rigid(), drawn("both", 1.1, 2))
    (difference,) = found.differences
    assert difference.better == "rigid tool + viscous_drag"
    assert difference.p_value < 1e-10
    assert "predicts better than rigid tool (p " in str(found)
    assert [p.fitted for m in found.models for p in m.predictions] == [False, False]


def test_a_model_does_not_differ_from_itself() -> None:
    one = fitted("viscous_drag")
    found = compare([one, one], drawn("both", 1.1, 2))
    assert [m.name for m in found.models] == ["rigid tool + viscous_drag", "rigid tool + viscous_drag #2"]
    assert found.differences[0].p_value == 1.0
    assert compare({"a": one}, drawn("both", 1.1, 2)).differences == ()


def test_parameters_that_moved_are_counted_in_std() -> None:
    rigid, better = true_and_rigid()
    frame = compare([rigid, better], drawn("both", 1.1, 2)).parameter_table.to_frame().set_index("parameter")
    moved = (better.values["m"] - rigid.values["m"]) / rigid.parameters["m"].std
    assert frame.loc["m", "change / std"] == pytest.approx(moved)


def repeating(tone: float) -> Recording:
    """Four repeats, with a tone (Hz) in fx that repeats with the motion."""
    columns = motion(0.3)
    once = predicted_readings(planar(RIG), with_readings(columns, np.zeros((400, 3))), theta(planar(RIG)))
    once[:, 0] += 0.5 * np.sin(2 * np.pi * tone * columns["time"])
    noise = np.random.default_rng(3).normal(0, STD, (1600, 3))
    frame = {name: np.tile(values, 4) for name, values in columns.items()}
    frame |= {"time": np.arange(1600) / 100, "repeat": np.repeat(np.arange(4.0), 400)}
    return with_readings(frame, np.tile(once, (4, 1)) + noise)


def test_bands_hold_the_error_that_is_in_them() -> None:
    comparison = compare(fit(planar(RIG), repeating(5.0)))
    bands = BandError.of(comparison)
    assert bands.systematic
    inside = (bands.edges[:-1] <= 5.0) & (bands.edges[1:] > 5.0)
    assert bands.rms[inside, 0] == pytest.approx(0.5 / np.sqrt(2), rel=0.1)
    assert (bands.rms[~inside, 0] < 0.1).all()


def test_bands_of_a_single_run_add_up() -> None:
    """Parseval: the powers of all bands are the variance of the residual."""
    comparison = compare(fitted("viscous_drag"))
    bands = BandError.of(comparison)
    assert not bands.systematic
    np.testing.assert_allclose((bands.rms**2).sum(axis=0), comparison.residual.var(axis=0), rtol=1e-9)


@pytest.fixture
def files(tmp_path: Path) -> tuple[list[str], str]:
    rigid, better = true_and_rigid()
    recording = drawn("both", 1.1, 2)
    (tmp_path / "rig.toml").write_text(RIG_TEXT)
    frame = pd.DataFrame(motion(1.1))
    frame[["fx", "fy", "tau"]] = recording.wrench
    frame.to_csv(tmp_path / "run.csv", index=False)
    for name, known in (("rigid", rigid), ("better", better)):
        (tmp_path / f"{name}.json").write_text(ModelFile.of(known).to_text())
    return [str(tmp_path / "rigid.json"), str(tmp_path / "better.json")], str(tmp_path / "run.csv")


def test_command_compares_model_files(files: tuple[list[str], str], capsys: pytest.CaptureFixture[str]) -> None:
    models, run = files
    assert main(["compare", *models, "--on", run, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    expected: ModelComparison = compare(true_and_rigid(), drawn("both", 1.1, 2))
    assert [d["better"] for d in data["differences"]] == ["better.json"]
    assert data["models"][1]["effects"] == ["viscous_drag"]
    for found, known in zip(data["models"], expected.models, strict=True):
        assert found["recordings"][0]["rms"] == pytest.approx(dict(known.predictions[0].comparison.rms), rel=1e-6)
    assert main(["compare", *models, "--on", run]) == 0
    assert "better.json predicts better than rigid.json" in capsys.readouterr().out


USES = {"held out": False, "fitted on": True, "biases alone fitted": None}


@pytest.mark.parametrize("use", USES)
def test_a_column_says_whether_the_model_was_fitted_on_it(
    use: str, files: tuple[list[str], str], capsys: pytest.CaptureFixture[str]
) -> None:
    """By the readings in the model file; one that is older has none."""
    models, run = files
    if use != "held out":
        for model in models:
            saved = ModelFile.read(model)
            of_run = (readings_digest(tw.read(run, rig=saved.rig)),)
            changed = replace(saved, fitted_on=of_run if use == "fitted on" else None)
            Path(model).write_text(changed.to_text())
    assert main(["compare", *models, "--on", run]) == 0
    text = capsys.readouterr().out
    assert f"run.csv ({use})" in text
    assert ("describes these recordings, which were fitted" in text) == (use == "fitted on")
    assert main(["compare", *models, "--on", run, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["models"][0]["recordings"][0]
    assert found["fitted_on"] is USES[use]
    assert not found["fitted"]


@pytest.mark.parametrize("fault", ["twice", "missing", "no model"])
def test_what_cannot_be_compared_is_one_line(
    fault: str, files: tuple[list[str], str], capsys: pytest.CaptureFixture[str]
) -> None:
    models, run = files
    given = {"twice": [models[0], models[0]], "missing": ["nosuch.json"], "no model": [run]}[fault]
    assert main(["compare", *given, "--on", run]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_repeats_show_a_slow_residual_by_themselves() -> None:
    assert SlowResidual.of(compare(fit(planar(RIG), repeating(5.0)))) is None
