"""The README: its commands and its code run as they stand there, and what it names exists."""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
from pathlib import Path

import pandas as pd
import pytest

from diagnosis.verdict_rule import RecordVerdict
from modeling.rig import Rig
from tests.shared.places import ROOT
from truewrench.command_line import main
from truewrench.commands import diagnose
from truewrench.files import demonstration
from truewrench.simulated_rig import HIDDEN_EFFECTS, ContactEvent, PlanarRig, simulate, write_recording

pytest.importorskip("mujoco")

README = ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")
COMMANDS = {"calibrate", "compare", "compensate", "design", "diagnose", "discover", "effects", "emit", "fit", "survey"}
PUSH = ContactEvent(start=6.0, end=8.0)


def blocks(language: str) -> list[str]:
    """The code blocks of a language, in their order."""
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture
def rig_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with the README's rig and recordings that go with it."""
    for name, text in zip(("rig.toml", "effects.toml"), blocks("toml"), strict=True):
        (tmp_path / name).write_text(text, encoding="utf-8")
    rig = PlanarRig()
    assert Rig.read(tmp_path / "rig.toml").link_lengths == rig.link_lengths
    drag = HIDDEN_EFFECTS["viscous_drag"]
    first, motion = (rig.random_motion(seed=seed, harmonics=3) for seed in (1, 2))
    for name, moved, seed, repeats in (("train.csv", first, 1, 4), ("validate.csv", motion, 2, 3)):
        frame = simulate(rig, moved, hidden=[drag], repeats=repeats, samples_per_period=150, seed=seed)
        write_recording(frame, tmp_path / name)
    frame = simulate(rig, motion, hidden=[drag, PUSH], repeats=3, samples_per_period=150, seed=3)
    write_recording(frame, tmp_path / "pushed.csv")
    rates = zip(("dq", "ddq"), motion.evaluate(frame["time"].to_numpy())[1:], strict=True)
    derivatives = {f"{name}{j}": series[:, j - 1] for name, series in rates for j in (1, 2, 3)}
    pd.concat([frame, pd.DataFrame(derivatives)], axis=1).drop(columns="repeat").to_parquet(tmp_path / "log.parquet")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long(seconds=60)
def test_the_commands_run(
    rig_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On one core: results do not depend on their number, and each process that is started imports everything anew."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    assert {shlex.split(line)[1] for line in lines} == COMMANDS
    for line in lines:
        program, *arguments = shlex.split(line)
        assert program == "truewrench"
        assert main(arguments) == 0, line
        printed = capsys.readouterr().out
        if "--out report" in line:
            assert f"[{RecordVerdict.EXPLAINED.value}]" in printed.splitlines()[0]
        if "compensate" in line:
            assert printed.startswith("1 contact")
        if "--json" in line:
            assert "detectable" in json.loads(printed)["effects"][0]
    for name in diagnose.FILES:
        assert (rig_folder / "report" / name).exists()
        assert f"report/{name}" in TEXT
    assert (rig_folder / "model.json").exists()


@pytest.mark.long
def test_the_code_runs(rig_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = rig_folder / "example.py"
    script.write_text("\n".join(blocks("python")), encoding="utf-8")
    names = runpy.run_path(str(script))
    assert names["found"].added == ("viscous_drag",)
    assert len(names["contact"].intervals) == 1
    assert "lack of fit" in capsys.readouterr().out


def test_every_verdict_is_explained() -> None:
    for verdict in RecordVerdict:
        assert f"| `{verdict.value}` |" in TEXT


def test_what_is_named_exists() -> None:
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make (\w+)", TEXT, flags=re.MULTILINE):
        assert f"\n{target}:" in makefile
    for effect_id in re.findall(r"demo --effect (\w+)", TEXT):
        assert effect_id in (demonstration.NOTHING, *HIDDEN_EFFECTS)
