"""What is hidden and in no catalogue comes out as an equation that holds on another motion; of noise none does."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import truewrench as tw
from diagnosis.discovery.discovery import Discovery, discover
from modeling.errors import InputError
from modeling.space import Space
from tests.shared.recordings import base, recorded
from truewrench.command_line import main
from truewrench.reports import discovery_report
from truewrench.reports.report_files import ReportTexts
from truewrench.simulated_rig import HiddenEffect, MagnusForce, PlanarRig, simulate, write_recording

pytest.importorskip("mujoco")

SPIN = MagnusForce(c=0.06, d=0.12)


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
@pytest.mark.parametrize(("noise", "seed"), [("white", 5), ("autoregressive", 6), ("pink_and_lines", 5)])
def test_no_noise_of_six_axes_has_an_equation(noise: str, seed: int) -> None:
    assert not discovered(Space.SPACE, (), 4, noise, seed).found


@pytest.mark.long
def test_a_force_without_a_name_is_found_in_six_axes() -> None:
    found = discovered(Space.SPACE, (SPIN,), 4, "white", 0)
    assert [equation.formula for equation in found.equations] == ["F = c v x w at d"]


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
