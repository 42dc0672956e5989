"""What is hidden and in no catalogue comes out as an equation that holds on another motion; of noise none does."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import truewrench as tw
from diagnosis.discovery import discovery
from diagnosis.discovery.discovery import Discovery, discover
from diagnosis.discovery.grammar import Term, terms
from diagnosis.discovery.leaves import recorded_leaves
from estimation.fit import fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.recordings import base, noiseless_columns, recorded
from truewrench.command_line import main
from truewrench.reports import discovery_report
from truewrench.reports.report_files import ReportTexts
from truewrench.simulated_rig import (
    HiddenEffect,
    MagnusForce,
    PlanarRig,
    SensorEffect,
    SensorSignal,
    ToolLoad,
    Track,
    simulate,
    write_recording,
)

pytest.importorskip("mujoco")

SPIN = MagnusForce(c=0.06, d=0.12)


@dataclass(frozen=True, kw_only=True)
class Product(SensorEffect):
    """Channel fx reads more by c (1/(N m)) times the loads fy and tau."""

    id = "product_of_loads"
    catalogued = False
    order = 1
    c: float

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Before any lag."""
        first = np.array([1.0, 0.0, 0.0])
        return signal.mapped(lambda loads: loads + self.c * loads[:, 1:2] * loads[:, 2:] * first)


@dataclass(frozen=True, kw_only=True)
class Magnet(ToolLoad):
    """c n / |n|^4 (N) towards a place in the plane that all motions pass in 0.2 m."""

    id = "near_magnet"
    catalogued = False
    c: float
    d: float = 0.12
    place: tuple[float, float, float] = (1.4, 0.0, 2.3)

    def push(self, track: Track) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """In the world, at the point."""
        away = np.array(self.place) - track.point
        force = self.c * away / np.linalg.norm(away, axis=1, keepdims=True) ** 4
        return force, np.zeros_like(force)


Columns = dict[str, NDArray[np.float64]]


def altered(channel: str, added: Callable[[Columns], Any], *, repeats: int) -> list[Recording]:
    """Two motions in white noise, a channel of which reads more by a function of their columns."""
    several, rig = [], PlanarRig()
    for motion in (1, 2):
        columns = dict(noiseless_columns(Space.PLANE, (), repeats, motion))
        columns["temperature"] = 20 + 8 * (1 - np.exp(-2 * columns["time"] / columns["time"].max()))
        draws = np.random.default_rng([motion, repeats]).standard_normal((len(columns["time"]), 3))
        for i, name in enumerate(rig.channels):
            columns[name] = columns[name] + rig.noise[i] * draws[:, i]
        columns[channel] = columns[channel] + added(columns)
        several.append(from_columns(columns, name=f"motion {motion}", rig=Rig(link_lengths=rig.link_lengths)))
    return several


@cache
def discovered(space: Space, hidden: tuple[HiddenEffect, ...], complexity: int, noise: str, seed: int) -> Discovery:
    training, other = (
        recorded(space, *hidden, seed=10 * seed + motion, motion=motion, noise=noise, name=f"motion {motion}")
        for motion in (1, 2)
    )
    return discover(base(space), training, validate=other, complexity=complexity)


def test_a_force_without_a_name_is_found() -> None:
    found = discovered(Space.PLANE, (SPIN,), 4, "white", 0)
    (equation,) = found.equations
    assert equation.formula == "F = c v x w at d"
    for name, true in (("c", -SPIN.c), ("d", SPIN.d)):
        value, std, _ = equation.parameters[name]
        assert abs(value - true) < 4 * std  # 1 in 15 000 each
    assert equation.held_out > 0.9
    assert found.compared().to_data()  # both models on the other motion
    mass = found.last.parameters["m"]
    assert abs(mass.value - 0.9) < 4 * mass.std


def test_what_was_found_is_an_effect_like_any_other(tmp_path: Path) -> None:
    found = discovered(Space.PLANE, (SPIN,), 4, "white", 0)
    path = tmp_path / "effect.toml"
    path.write_text(found.effects_toml, encoding="utf-8")
    (effect,) = tw.read_effects(path)
    third = recorded(Space.PLANE, SPIN, seed=3, motion=3, name="motion 3")
    before, after = (
        tw.compare(tw.fit(model, third), third).lack_of_fit for model in (base(Space.PLANE), base(Space.PLANE) + effect)
    )
    assert before < 1e-9 < 0.01 < after


@pytest.mark.parametrize("noise", ["white", "pink_and_lines"])
def test_noise_has_no_equation(noise: str) -> None:
    """Wrong in one of a hundred at most, and in far fewer, as the term has to hold on the other motion."""
    found = discovered(Space.PLANE, (), 3, noise, 4)
    assert not found.found
    assert not found.depends_on
    assert "none is significant" in str(found)


@pytest.mark.long
def test_what_fits_depends_on_nothing() -> None:
    """Of this noise six points of a function of ddq1 predict 28 % of the excess, by chance: there is hardly any."""
    arm = PlanarRig()
    frames = [
        simulate(arm, arm.random_motion(seed=seed), repeats=4, samples_per_period=400, seed=seed) for seed in (11, 12)
    ]
    rig = Rig(link_lengths=arm.link_lengths)
    training, other = (tw.from_dataframe(frame.drop(columns="temperature"), rig=rig) for frame in frames)
    found = discover(tw.planar(rig), training, validate=other, complexity=2)
    assert discovery.depends_on(found.first)["ddq1"] > 0.2
    assert (found.found, found.depends_on) == (False, {})


@pytest.mark.long
@pytest.mark.parametrize(("noise", "seed"), [("white", 5), ("autoregressive", 6), ("pink_and_lines", 5)])
def test_no_noise_of_six_axes_has_an_equation(noise: str, seed: int) -> None:
    """Nor is what fits said to depend on a signal."""
    found = discovered(Space.SPACE, (), 4, noise, seed)
    assert (found.found, found.depends_on) == (False, {})


@pytest.mark.long
def test_a_force_without_a_name_is_found_in_six_axes() -> None:
    found = discovered(Space.SPACE, (SPIN,), 4, "white", 0)
    assert [equation.formula for equation in found.equations] == ["F = c v x w at d"]


@pytest.mark.long
def test_a_product_of_loads_is_a_gain_that_formulas_say() -> None:
    """In the plane tau is nearly proportional to fx, so that fx fy may be listed before it."""
    found = discovered(Space.PLANE, (Product(c=0.02),), 5, "white", 0)
    (equation,) = found.equations
    assert equation.kind == "gain"
    assert "fx = c fy tau" in {equation.formula, *(o.term.printed(Space.PLANE) for o, _ in equation.found.alternatives)}
    assert equation.held_out > 0.9


@pytest.mark.long
def test_a_magnet_near_the_path_is_found_with_its_place() -> None:
    found = discovered(Space.PLANE, (Magnet(c=0.01),), 5, "white", 0)
    (equation,) = found.equations
    assert equation.formula == "F = c |n|^-4 n at d"
    for name, true in (("c", 0.01), ("d", 0.12), ("x_0", 1.4), ("y_0", 2.3)):
        value, std, _ = equation.parameters[name]
        assert abs(value - true) < 4 * std  # 1 in 15 000 each


@pytest.mark.long
@pytest.mark.parametrize("repeats", [1, 4])
def test_a_zero_that_follows_the_square_of_a_temperature(repeats: int) -> None:
    """A slow column does not repeat, and is in the noise of repeats and of a run: it is found in that beside it."""
    training, other = altered("fy", lambda c: 0.025 * (c["temperature"] - 20) ** 2, repeats=repeats)
    found = discover(base(Space.PLANE), training, validate=other, complexity=4)
    (equation,) = found.equations
    formulas = {equation.formula, *(o.term.printed(Space.PLANE) for o, _ in equation.found.alternatives)}
    assert any(re.fullmatch(r"fy = c_1 \(temperature - 2\d\) .*\^2", formula) for formula in formulas)


@pytest.mark.long
def test_a_sinusoid_of_a_joint_in_a_single_run() -> None:
    """The noise of a run's residual has it in it."""
    training, other = altered("fx", lambda c: 0.25 * np.sin(7 * c["q2"]), repeats=1)
    found = discover(base(Space.PLANE), training, validate=other, complexity=4)
    (equation,) = found.equations
    assert equation.formula == "fx = c sin(7 q2)"
    value, std, _ = equation.parameters["c_sin_fx"]
    assert abs(value - 0.25) < 4 * std


@pytest.mark.long
def test_a_form_that_only_resembles_the_true_one_is_not_proposed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the magnet's own power of the distance, and its neighbours, in the grammar."""

    def fewer(*arguments: Any) -> list[Term]:
        return [term for term in terms(*arguments) if "|n|^-" not in term.formula]

    monkeypatch.setattr(discovery, "terms", fewer)
    training, other = (
        recorded(Space.PLANE, Magnet(c=0.03), seed=motion, motion=motion, name=f"motion {motion}") for motion in (1, 2)
    )
    found = discover(base(Space.PLANE), training, validate=other, complexity=5)
    assert not found.found or (found.left is not None and found.left < 1e-3 and "may stand in" in str(found))


def test_columns_of_any_name_are_in_formulas_or_left_out() -> None:
    """Names of the grammar, of functions and of a model's parameters are no columns of a formula."""
    columns = dict(noiseless_columns(Space.PLANE, (), 1, 1))
    names = ["motor_current_1", "Pressure", "v", "sin", "pi", "m", "c_1", "q1_dev", "tiny_1", "a-b"]
    columns |= {name: np.random.default_rng(i).standard_normal(len(columns["time"])) for i, name in enumerate(names)}
    recording = from_columns(columns, name="columns", rig=Rig(link_lengths=PlanarRig().link_lengths))
    fitted = fit(base(Space.PLANE), recording)
    leaves, angles, inputs = recorded_leaves(fitted, [recording])
    assert set(inputs) == {"temperature", *names[:2]}
    grammar = terms(leaves, angles, list(inputs), fitted.model.channels, 4)
    of_columns = [t for t in grammar if t.by_channel and any(name in t.formula for name in inputs)]
    for number, term in enumerate(of_columns):
        effect = term.effect(Space.PLANE, f"found_{number}", leaves, inputs, {})
        assert (fitted.model + effect).parameters


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its report is drawn in a test of its own."""
    monkeypatch.setattr(discovery_report, "discovery_report", lambda found, _: ReportTexts("page", found.effects_toml))
    rig = PlanarRig()
    files = []
    for seed in (1, 2):
        frame = simulate(
            rig, rig.random_motion(seed=seed), hidden=(SPIN,), repeats=3, samples_per_period=200, seed=seed
        )
        files.append(str(tmp_path / f"motion{seed}.csv"))
        write_recording(frame.drop(columns="temperature"), files[-1])
    links = ", ".join(map(str, rig.link_lengths))
    (tmp_path / "rig.toml").write_text(f"[robot]\nlink_lengths = [{links}]\n", encoding="utf-8")
    command = ["discover", files[0], "--rig", str(tmp_path / "rig.toml"), "--validate", files[1], "--complexity", "4"]
    files += [str(tmp_path / "effect.toml"), str(tmp_path / "report")]
    assert main([*command, "--out", files[2], "--report", files[3], "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["found"]
    (term,) = data["terms"]
    assert {"id", "formula", "kind", "p_value", "share", "parameters", "held_out", "alternatives"} <= set(term)
    assert (term["id"], term["kind"], term["held_out"]["carried"]) == ("found_1", "tip_body", True)
    for written in ("effect.toml", "report/report.md"):
        assert (tmp_path / written).read_text(encoding="utf-8") == data["effects_toml"]
    assert np.isclose(term["parameters"]["d"]["value"], SPIN.d, atol=0.02)
    alternatives = tmp_path / "effect_alternatives.toml"
    assert alternatives.exists() == bool(term["alternatives"])


def test_a_study_looks_for_an_equation_beside_its_model() -> None:
    training, other = (
        recorded(Space.PLANE, SPIN, seed=motion, motion=motion, name=f"motion {motion}") for motion in (1, 2)
    )
    loop = tw.study(training.rig, training, validate=other, effects=[])
    assert loop.discover(complexity=2).tested > 50
    with pytest.raises(InputError, match="no other motion"):
        tw.study(training.rig, training, effects=[]).discover()


def test_bad_input() -> None:
    recording = recorded(Space.PLANE, seed=1, motion=1)
    with pytest.raises(InputError, match="no other motion was given"):
        discover(base(Space.PLANE), recording, validate=[])
    with pytest.raises(InputError, match="given twice"):
        discover(base(Space.PLANE), recording, validate=recording)
    with pytest.raises(InputError, match="complexity"):
        discover(base(Space.PLANE), recording, validate=recorded(Space.PLANE, seed=2, motion=2), complexity=99)
