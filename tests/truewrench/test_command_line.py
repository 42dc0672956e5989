"""The command line: what it prints and writes, and one line with exit code 2 for whatever it cannot use."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pandas as pd
import pytest

from design.trajectories.trajectory import Trajectory
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from modeling.effects import CATALOGUE, catalogue
from modeling.rig import Convention
from modeling.space import Space
from truewrench.command_line import COMMANDS, main, parser
from truewrench.commands import diagnose as diagnose_command
from truewrench.commands import effects
from truewrench.files import demonstration, output
from truewrench.files.model_file import ModelFile
from truewrench.files.output import ERASE_LINE, ProgressStyle, atomic_write, progress_line, progress_style
from truewrench.options import READ, ids_apart
from truewrench.simulated_rig import HIDDEN_EFFECTS, PlanarRig, SpatialRig, simulate, static_poses, write_recording
from truewrench.text.diagnosis_text import diagnosis_text, error_reduction_text, verdict_sentence

pytest.importorskip("mujoco")

RIG_TEXT = """
[robot]
link_lengths = [1.0, 0.97, 0.4]
[limits]
position = [1.2, 1.2, 1.2]
velocity = [2.5, 2.5, 2.5]
acceleration = [12.0, 12.0, 12.0]
"""
HEAVY = ("numpy", "scipy", "pandas", "sympy", "casadi", "cvxpy", "matplotlib", "pydantic", "jinja2", "mujoco")
IDS = tuple(effect.id for effect in CATALOGUE)


def motion(seed: int) -> Trajectory:
    """A short random motion of the planar arm."""
    return PlanarRig().random_motion(seed=seed, harmonics=3)


def recorded(seed: int, *hidden: str, repeats: int = 4) -> pd.DataFrame:
    """A short recording of the planar arm."""
    effects = [HIDDEN_EFFECTS[effect_id] for effect_id in hidden]
    return simulate(PlanarRig(), motion(seed), hidden=effects, repeats=repeats, samples_per_period=200, seed=seed)


@dataclass(frozen=True)
class Bench:
    """Files to work with: a rig, a recording with a drag in it, and another motion of the same."""

    folder: Path
    rig: str
    training: str
    validation: str
    frame: pd.DataFrame


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("bench")
    rig, training, validation = (folder / name for name in ("rig.toml", "train.csv", "validate.csv"))
    rig.write_text(RIG_TEXT)
    frame = recorded(1, "viscous_drag")
    write_recording(frame, training)
    write_recording(recorded(2, "viscous_drag", repeats=3), validation)
    return Bench(folder, str(rig), str(training), str(validation), frame)


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str


Runner = Callable[..., Outcome]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Runner:
    """Run a command in this process."""

    def command(*argv: str | Path) -> Outcome:
        code = main([str(a) for a in argv])
        return Outcome(code, *capsys.readouterr())

    return command


# ------------------------------------------------------------------------------------------ diagnose


@dataclass(frozen=True)
class Diagnosed:
    """One diagnosis by the command, kept for several tests."""

    code: int
    printed: str
    folder: Path
    found: Diagnosis


@pytest.fixture(scope="module")
def diagnosed(bench: Bench) -> Diagnosed:
    folder = bench.folder / "new" / "report"
    printed, kept = io.StringIO(), []
    original = diagnose_command.diagnosed

    def keep(case: Any, own: Any) -> Diagnosis:
        kept.append(original(case, own))
        return kept[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diagnose_command, "diagnosed", keep)
        patch.setattr(sys, "stdout", printed)
        argv = [bench.training, "--rig", bench.rig, "--validate", bench.validation, "--out", str(folder), "--json"]
        code = main(["diagnose", *argv])
    return Diagnosed(code, printed.getvalue(), folder, kept[0])


def numbers(data: Any) -> Iterator[float]:
    """Every number in nested data."""
    if isinstance(data, dict | list):
        for value in data.values() if isinstance(data, dict) else data:
            yield from numbers(value)
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield data


def test_diagnose_writes_report_result_and_model_and_nothing_else(diagnosed: Diagnosed) -> None:
    assert diagnosed.code == 0
    assert sorted(p.name for p in diagnosed.folder.iterdir()) == ["model.json", "report.html", "result.json"]
    assert "<html" in (diagnosed.folder / "report.html").read_text(encoding="utf-8")[:500]


def test_json_is_the_result_alone(diagnosed: Diagnosed) -> None:
    written = (diagnosed.folder / "result.json").read_text(encoding="utf-8")
    assert json.loads(diagnosed.printed) == json.loads(written) == diagnosed.found.to_data()


def test_the_result_has_the_keys_of_the_contract_and_finite_numbers(diagnosed: Diagnosed) -> None:
    result = json.loads(diagnosed.printed)
    assert result["channels"] == ["fx", "fy", "tau"]
    assert result["verdict"] in {v.value for v in RecordVerdict}
    assert result["noise_source"] == "repeats"
    assert set(result["noise_floor"]) == set(result["zero_shift"]) == set(result["channels"])
    assert [step["effect"] for step in result["steps"]] == [None, *result["added"]]
    for step in result["steps"]:
        assert isinstance(step["misfit"], float)
        for key in ("rms", "explainable_rms", "validation_rms", "validation_explainable_rms"):
            assert set(step[key]) == set(result["channels"])
    assert {e["id"] for e in result["effects"]} == {e.id for e in catalogue(Space.PLANE)}
    for effect in result["effects"]:
        assert effect["verdict"] in {v.value for v in EffectVerdict}
        assert {"p_value", "error_removed", "detectable", "confusable_with", "reason", "parameters"} <= set(effect)
    assert set(result["parameters"]["m"]) == {"value", "std", "unit"}
    assert "unexplained" in result
    assert all(map(isfinite, numbers(result)))


def test_the_drag_is_named_with_its_size(diagnosed: Diagnosed) -> None:
    result = json.loads(diagnosed.printed)
    assert (result["verdict"], result["added"]) == ("explained", ["viscous_drag"])
    drag = next(e for e in result["effects"] if e["id"] == "viscous_drag")["parameters"]["c"]
    assert drag["unit"] == "N s/m"
    assert abs(drag["value"] - HIDDEN_EFFECTS["viscous_drag"].c) < 5 * drag["std"]  # type: ignore[attr-defined]


def test_the_model_file_is_the_last_fit(diagnosed: Diagnosed) -> None:
    model = ModelFile.read(diagnosed.folder / "model.json")
    assert model.model == diagnosed.found.model
    assert {n: e.value for n, e in model.parameters.items()} == diagnosed.found.fit.values


def test_the_text_starts_with_the_verdict_and_says_what_to_check(diagnosed: Diagnosed) -> None:
    text = diagnosis_text(diagnosed.found)
    assert text.startswith("Explained: ")
    assert "[explained]" in text.splitlines()[0]
    assert "c = 0.1" in text
    assert " ± " in text
    assert "Check on the rig: " in text
    assert "validate.csv (held out)" in error_reduction_text(diagnosed.found)


def test_the_command_prints_the_summary(
    bench: Bench, diagnosed: Diagnosed, run: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnose_command, "diagnosed", lambda _case, _own: diagnosed.found)
    outcome = run("diagnose", bench.training, "--rig", bench.rig)
    assert outcome == Outcome(0, diagnosis_text(diagnosed.found) + "\n", "")


@pytest.mark.parametrize("verdict", RecordVerdict)
def test_every_verdict_has_words(diagnosed: Diagnosed, verdict: RecordVerdict) -> None:
    text = verdict_sentence(replace(diagnosed.found, verdict=verdict))
    assert text.endswith(f"[{verdict.value}]")
    assert "{" not in text


# ----------------------------------------------------------------------------------- fit and effects


def test_fit_prints_parameters_and_writes_the_model(bench: Bench, run: Runner, tmp_path: Path) -> None:
    path = tmp_path / "new" / "model.json"
    add = ["--add", "viscous_drag", "--add", "com_offset", "--drop", "com_offset"]
    outcome = run("fit", bench.training, "--rig", bench.rig, *add, "--out", path)
    assert (outcome.code, outcome.err) == (0, "")
    assert re.search(r"viscous_drag\.c +0\.1\d+ ± 0\.\d+ N s/m +0\.\d+ to 0\.\d+", outcome.out)
    assert [e.id for e in ModelFile.read(path).model.effects] == ["viscous_drag"]
    assert list(path.parent.iterdir()) == [path]


def test_fit_json_is_the_model_and_how_well_it_fits(bench: Bench, run: Runner) -> None:
    outcome = run("fit", bench.training, bench.validation, "--rig", bench.rig, "--json")
    data = json.loads(outcome.out)
    assert [r["name"] for r in data["recordings"]] == ["train.csv", "validate.csv"]
    assert [t["recording"] for t in data["repeats"]] == ["train.csv", "validate.csv"]
    low, high = data["intervals"]["m"]
    assert low < data["parameters"]["m"]["value"] < high
    beside = {
        "fits",
        "recordings",
        "validation",
        "repeats",
        "intervals",
        "readings",
        "tool_unknown",
        "converged",
        "condition",
        "unseen",
    }
    assert ModelFile.from_data({k: v for k, v in data.items() if k not in beside}).parameters["m"].unit == "kg"


def test_recordings_of_one_file_name_do_not_clash(bench: Bench, run: Runner, tmp_path: Path) -> None:
    places = [tmp_path / day / "run.csv" for day in ("monday", "tuesday")]
    for place, source in zip(places, (bench.training, bench.validation), strict=True):
        place.parent.mkdir()
        place.write_bytes(Path(source).read_bytes())
    outcome = run("fit", *places, "--rig", bench.rig)
    assert "bias_fx@tuesday/run.csv" in outcome.out
    assert "monday/run.csv:" in outcome.out


@pytest.mark.parametrize("convention", [Convention.ON_TOOL, Convention.ON_SENSOR])
def test_the_sign_of_six_axes_is_decided_and_reported(convention: Convention, run: Runner, tmp_path: Path) -> None:
    rig = SpatialRig(convention=convention.value)
    path = write_recording(static_poses(rig, 24, seed=1), tmp_path / "poses.csv")
    outcome = run("fit", path, "--json")
    data = json.loads(outcome.out)
    assert data["convention"] == data["sign"]["convention"] == convention.value
    assert data["sign"]["mass"] == pytest.approx(rig.mass, rel=0.02)
    assert data["sign"]["mounting_angle_deg"] < 2
    assert data["parameters"]["m"]["value"] > 0
    assert data["parameters"]["Ixx"]["std"] is None
    text = run("fit", path).out
    assert f"({convention.value})." in text  # nothing of the mounting, which is none
    assert ("subtracts more than the tool weighs" in text) == (convention is Convention.ON_TOOL)
    detailed = run("fit", path, "--verbose").out
    assert "First estimates, from the weight alone: mass" in detailed
    assert "against the axes of the logged pose" in detailed
    assert "not identifiable" in text


def test_effects_lists_the_catalogue_and_describes_each(run: Runner) -> None:
    listing = run("effects")
    assert listing.code == 0
    for effect in CATALOGUE:
        assert f"\n{effect.id} " in listing.out
        described = run("effects", effect.id)
        assert described.code == 0
        assert effect.equation in described.out
        assert effect.advice in described.out


# ---------------------------------------------------------------------------------------------- demo


@pytest.mark.long
def test_demo_tells_what_was_hidden_and_what_was_named(
    run: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demonstration, "SAMPLES", 200)
    monkeypatch.setattr(demonstration, "TRAINING", replace(demonstration.TRAINING, repeats=4))
    outcome = run("demo", "--effect", "viscous_drag", "--out", tmp_path / "demo")
    assert (outcome.code, outcome.err) == (0, "")
    assert "Hidden: viscous_drag. Identified: viscous_drag. Correct." in outcome.out
    assert str(tmp_path / "demo" / "report.html") in outcome.out
    names = {"rig.toml", "train.csv", "validate.csv", "report.html", "result.json", "model.json"}
    assert {p.name for p in (tmp_path / "demo").iterdir()} == names | {"contact.csv", "contact.png"}
    assert json.loads((tmp_path / "demo" / "result.json").read_text())["verdict"] == "explained"


@pytest.mark.long
def test_demo_of_what_does_not_show_in_the_plane_has_six_axes(
    run: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demonstration, "SAMPLES", 200)
    monkeypatch.setattr(demonstration, "TRAINING", replace(demonstration.TRAINING, repeats=4))
    outcome = run("demo", "--effect", "spinning_rotor", "--out", tmp_path / "demo")
    assert (outcome.code, outcome.err) == (0, "")
    assert "Simulated six-axis carriage with hidden effect: spinning_rotor" in outcome.out
    assert "Hidden: spinning_rotor. Identified: spinning_rotor. Correct." in outcome.out
    assert not (tmp_path / "demo" / "contact.csv").exists()


def test_demo_without_mujoco_says_how_to_get_it(run: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demonstration, "find_spec", lambda name: None)
    refused(run("demo", "--out", tmp_path / "demo"), 'pip install "truewrench[simulation]"')
    assert not (tmp_path / "demo").exists()


# ----------------------------------------------------------------------------------------- bad input


def refused(outcome: Outcome, *said: str) -> None:
    """Check exit code 2, nothing on stdout, and one line on stderr that says so."""
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith("\n")
    assert "Traceback" not in outcome.err
    for part in said:
        assert part in outcome.err


def without(name: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.drop(columns=name)


def with_cell(name: str, row: int, value: Any) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        column = frame[name].astype(object)
        column.iloc[row] = value
        return frame.assign(**{name: column})

    return change


def scaled(factor: float, *names: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.assign(**{name: frame[name] * factor for name in names})


BAD_RECORDINGS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], tuple[str, ...]]] = {
    "missing channel": (without("tau"), ("tau",)),
    "missing joint": (without("q2"), ("q2",)),
    "missing wrench": (lambda f: f.drop(columns=["fx", "fy", "tau"]), ("no wrench",)),
    "not a number": (with_cell("fx", 10, "high"), ("fx", "row 12", "high")),
    "nan": (with_cell("fy", 20, np.nan), ("fy", "row 22")),
    "infinite": (with_cell("fy", 20, np.inf), ("fy", "row 22")),
    "time falls": (with_cell("time", 30, 0.0), ("time", "row 32")),
    "time stands": (lambda f: f.assign(time=0.0), ("time",)),
    "unequal repeats": (lambda f: f.iloc[:-7], ("repeat",)),
    "one sample": (lambda f: f.iloc[:1], ("train.csv",)),
    "too few samples": (lambda f: f.iloc[:12], ("train.csv",)),
    "no samples": (lambda f: f.iloc[:0], ("no samples",)),
    "degrees": (scaled(180 / np.pi, "q1", "q2", "q3"), ("q1", "degrees?", "truewrench import")),
    "other sign": (scaled(-1, "fx", "fy", "tau"), ("the mass comes out as -0.9", "on_sensor")),
}


@pytest.mark.parametrize(
    ("name", "command"),
    [
        pytest.param(name, command, marks=[pytest.mark.long] * ((name, command) == ("other sign", "diagnose")))
        for name in BAD_RECORDINGS
        for command in ("diagnose", "fit")
    ],
)
def test_a_bad_recording_is_refused(name: str, command: str, bench: Bench, run: Runner, tmp_path: Path) -> None:
    change, said = BAD_RECORDINGS[name]
    path = tmp_path / "train.csv"
    change(bench.frame).to_csv(path, index=False)
    out = tmp_path / "out"
    refused(run(command, path, "--rig", bench.rig, "--out", out), *said)
    assert not out.exists()


BAD_FILES = {
    "empty": b"",
    "header only": b"time,q1,q2,q3,fx,fy,tau\n",
    "binary": bytes(range(256)),
    "semicolons": b"time;fx;fy;tau\n0;1;2;3\n",
    "ragged": b"time,phi,fx,fy,tau\n0,1,2,3,4\n1,2\n",
    "column twice": b"time,phi,fx,fx,fy,tau\n0,1,2,3,4,5\n",
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_refused(name: str, bench: Bench, run: Runner, tmp_path: Path) -> None:
    path = tmp_path / "rec.csv"
    path.write_bytes(BAD_FILES[name])
    refused(run("diagnose", path, "--rig", bench.rig, "--out", tmp_path / "out"), "rec.csv")
    assert not (tmp_path / "out").exists()


BAD_RIGS = {
    "not TOML": "[robot",
    "unknown key": "[robot]\nlink_length = [1.0, 0.97, 0.4]",
    "text for a number": '[robot]\nlink_lengths = ["1 m", "2 m"]',
    "negative length": "[robot]\nlink_lengths = [1.0, -0.97, 0.4]",
    "no links": "[robot]\nname = 'x'",
    "other joints": "[robot]\nlink_lengths = [1.0, 0.97]",
    "undecidable convention": RIG_TEXT + '[sensor]\nconvention = "auto"',
    "unknown convention": RIG_TEXT + '[sensor]\nconvention = "upwards"',
}


@pytest.mark.parametrize("name", BAD_RIGS)
def test_a_bad_rig_is_refused(name: str, bench: Bench, run: Runner, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(BAD_RIGS[name])
    refused(run("diagnose", bench.training, "--rig", path, "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


BAD_USAGE: dict[str, tuple[str, str]] = {
    "no command": ("", "COMMAND"),
    "unknown command": ("guess", "guess"),
    "no recording": ("diagnose", "REC"),
    "unknown option": ("diagnose {train} --rig {rig} --loud", "--loud; see `truewrench diagnose --help`"),
    "option without value": ("diagnose {train} --rig", "--rig"),
    "no such recording": ("diagnose {folder}/none.csv --rig {rig}", "none.csv"),
    "a folder as recording": ("fit {folder} --rig {rig}", "{folder}"),
    "no such rig": ("diagnose {train} --rig {folder}/none.toml", "none.toml"),
    "no rig": ("diagnose {train}", "no rig was given"),
    "no such validation": ("diagnose {train} --rig {rig} --validate {folder}/none.csv", "none.csv"),
    "the same recording twice": ("fit {train} {train} --rig {rig}", "given twice"),
    "validation by the training": ("diagnose {train} --rig {rig} --validate {train}", "given twice"),
    "unknown effect to add": ("fit {train} --rig {rig} --add ghost", "'ghost'"),
    "effect added twice": ("fit {train} --rig {rig} --add com_offset --add com_offset", "in the model already"),
    "unknown effect to drop": ("fit {train} --rig {rig} --drop ghost", "'ghost'"),
    "dropped, not added": ("fit {train} --rig {rig} --drop com_offset", "not in the model"),
    "unknown effect": ("effects ghost", "'ghost'"),
    "unknown effect to hide": ("demo --effect ghost --out {folder}/demo", "'ghost'"),
    "a file as folder": ("diagnose {train} --rig {rig} --out {train}", "is not a folder"),
    "a folder as file": ("fit {train} --rig {rig} --out {folder}", "is a folder"),
    "a folder within a file": ("fit {train} --rig {rig} --out {train}/model.json", "{train}"),
}


@pytest.mark.parametrize("name", BAD_USAGE)
def test_bad_usage_is_refused(name: str, bench: Bench, run: Runner) -> None:
    places = {"train": bench.training, "rig": bench.rig, "folder": str(bench.folder)}
    line, said = (text.format(**places) for text in BAD_USAGE[name])
    before = sorted(bench.folder.iterdir())
    refused(run(*line.split()), said)
    assert sorted(bench.folder.iterdir()) == before


@pytest.mark.parametrize(
    "line", ["fit {train} --validate {copy}", "diagnose {train} --validate {copy}", "fit {train} {copy}"]
)
def test_a_recording_under_another_name_is_one_given_twice(
    line: str, bench: Bench, run: Runner, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.csv"
    copy.write_bytes(Path(bench.training).read_bytes())
    argv = line.format(train=bench.training, copy=copy).split()
    refused(run(*argv, "--rig", bench.rig), "copy.csv has the same readings as train.csv")


def test_recordings_of_two_sensors_are_refused(bench: Bench, run: Runner, tmp_path: Path) -> None:
    path = write_recording(static_poses(SpatialRig(), 24), tmp_path / "poses.csv")
    refused(run("fit", bench.training, path, "--rig", bench.rig), "poses.csv: its channels are fx, fy, fz")


def test_gravity_in_one_direction_does_not_decide_the_sign(run: Runner, tmp_path: Path) -> None:
    poses = np.zeros((12, 6))
    poses[:, 0] = np.linspace(0, 0.3, 12)
    path = write_recording(static_poses(SpatialRig(), poses), tmp_path / "poses.csv")
    refused(run("diagnose", path, "--out", tmp_path / "out"), "cannot be decided", "convention =")
    assert not (tmp_path / "out").exists()


def test_a_name_with_a_line_break_stays_in_one_line(run: Runner) -> None:
    refused(run("fit", "two\nlines.csv"), "two lines.csv")


# ---------------------------------------------------------------------------------- the program itself

PROGRAM = "import sys; from truewrench.command_line import main; sys.exit(main())"


def program(*argv: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command as a program of its own."""
    return subprocess.run([sys.executable, "-m", "truewrench", *argv], text=True, capture_output=True, **options)


@pytest.mark.parametrize(
    ("calls", "says"),
    [
        ([["--help"]], ["\n    demo ", "\n    diagnose ", "\n    fit ", "\n    effects "]),
        ([["diagnose", "--help"]], ["--validate"]),
        ([["--version"]], [f"truewrench {version('truewrench')}\n"]),
        ([["effects"]], list(IDS)),
        ([["effects", effect] for effect in IDS], [f"{effect}: " for effect in IDS]),
    ],
    ids=("help", "help-of-a-command", "version", "effects", "effects-id"),
)
def test_what_only_describes_imports_nothing_heavy(calls: list[list[str]], says: list[str]) -> None:
    code = (
        "import sys\nfrom truewrench.command_line import main\n"
        f"for argv in {calls}:\n    try:\n        main(argv)\n"
        "    except SystemExit as end:\n        assert not end.code\n"
        f"print('loaded:', [name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert "loaded: []" in done.stdout
    assert not [text for text in says if text not in done.stdout]


def test_a_diagnosis_of_plain_files_imports_only_what_it_uses(bench: Bench, run: Runner) -> None:
    """Of what was derived before: the first run of the two derives. A report needs nothing but its own libraries."""
    argv = ["diagnose", bench.training, "--rig", bench.rig, "--only", "viscous_drag", "--workers", "1"]
    assert run(*argv).code == 0
    unused = (
        *(set(HEAVY) - {"numpy", "scipy", "casadi"}),
        "pyarrow",
        *(f"scipy.{name}" for name in ("interpolate", "optimize", "spatial", "stats")),
    )
    code = (
        f"import sys\nfrom truewrench.command_line import main\nmain({argv})\n"
        f"print('loaded:', [name for name in {unused} if name in sys.modules])\n"
        "import truewrench.files.model_file, truewrench.reports.report_html\n"
        "print('for a report:', [name for name in ('pandas', 'sympy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert "Tool: m " in done.stdout
    assert done.stdout.endswith("loaded: []\nfor a report: []\n")


def test_the_public_names_are_loaded_one_by_one() -> None:
    code = (
        "import sys, truewrench as tw\nassert 'modeling' not in sys.modules\n"
        f"tw.effects.viscous_drag\nprint('loaded:', [name for name in {HEAVY} if name in sys.modules], tw.__version__)"
    )
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert done.stdout == f"loaded: [] {version('truewrench')}\n"


def test_exit_codes_reach_the_shell() -> None:
    assert (program("--help").returncode, program("diagnose", "--help").returncode) == (0, 0)
    bad = program("diagnose", "none.csv")
    assert (bad.returncode, bad.stdout, bad.stderr.count("\n")) == (2, "", 1)


def test_a_closed_pipe_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "effects"], stdout=write, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


CLOSED = {
    "catalogue": ("effects >&-", 0),
    "help": ("--help >&-", 0),
    "all-closed": ("effects <&- >&- 2>&-", 0),
    "error-unheard": ("fit none.csv 2>&-", 2),
    "help-unread": ("--help | true", 0),
    "version-unread": ("--version | true", 0),
}
"""Arguments as a shell takes them, with the exit code of the program."""


@pytest.mark.skipif(os.name != "posix", reason="by a POSIX shell")
@pytest.mark.parametrize("case", CLOSED)
def test_nobody_has_to_listen(case: str, tmp_path: Path) -> None:
    arguments, code = CLOSED[case]
    command, *reader = f'"$0" -m truewrench {arguments}'.split("|")
    unread = f"{{ sleep 0.2; {command}; echo $? > code; }}" + "".join(f"| {r}" for r in reader)  # the reader ends first
    done = subprocess.run(
        ["sh", "-c", unread, sys.executable], cwd=tmp_path, text=True, capture_output=True, check=True
    )
    assert (done.stdout, done.stderr, (tmp_path / "code").read_text()) == ("", "", f"{code}\n")


@pytest.mark.skipif(os.name != "posix", reason="by a POSIX shell")
@pytest.mark.parametrize("streams", ["--progress <&- >&- 2>&-", "--progress 2>&1 >&- | true", "--progress | true"])
def test_work_is_done_when_nobody_listens(streams: str, bench: Bench, tmp_path: Path) -> None:
    """The file is written, and nothing is printed into it, though it could take the number of a closed stream."""
    command, *reader = streams.split("|")
    argv = [bench.training, "--rig", bench.rig, "--out", str(tmp_path / "model.json")]
    shell = f'{{ sleep 0.2; "$0" -m truewrench fit "$@" {command}; }}' + "".join(f"| {r}" for r in reader)
    subprocess.run(["sh", "-c", shell, sys.executable, *argv], capture_output=True, check=True)
    assert ModelFile.read(tmp_path / "model.json").parameters["m"].value > 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_full_disk_is_one_line() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, "effects"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


ON_FULL_DISK = {
    "fit": "fit {training} --rig {rig} --out /dev/full",
    "fit report": "fit {training} --rig {rig} --report {full}",
    "diagnose": "diagnose {training} --rig {rig} --only viscous_drag --out {full}",
    "import": "import {training} --rig {rig} --out /dev/full",
}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("options", [[], ["--json"]])
@pytest.mark.parametrize("name", ON_FULL_DISK)
def test_a_result_that_cannot_be_written_is_printed_before_the_error(
    name: str, options: list[str], bench: Bench, run: Runner, tmp_path: Path
) -> None:
    for file in ("report.html", "result.json", "model.json"):
        (tmp_path / file).symlink_to("/dev/full")
    line = ON_FULL_DISK[name].format(training=bench.training, rig=bench.rig, full=tmp_path)
    full, kept = run(*line.split(), *options), run(*line.split()[:-2], *options)
    assert (full.code, kept.code) == (2, 0)
    assert full.out.splitlines()[:5] == kept.out.splitlines()[:5]
    assert "Written" not in full.out
    assert (full.err.count("\n"), "No space left on device" in full.err) == (1, True)


def test_a_fault_is_one_line_for_a_user_and_an_exception_in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    spoilt = "import truewrench.commands.effects as e; e.listing = lambda _: 1 // 0; " + PROGRAM
    done = subprocess.run([sys.executable, "-c", spoilt, "effects"], text=True, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "ZeroDivisionError" in done.stderr
    monkeypatch.setattr(effects, "listing", lambda _: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        main(["effects"])


def test_an_ascii_terminal_gets_text() -> None:
    ascii_only = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = program("effects", "viscous_drag", env=ascii_only)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_interrupt_is_quiet(run: Runner, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_args: Any, **_options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("truewrench.commands.fit.read_case", interrupted)
    assert run("fit", bench.training) == Outcome(130, "", "")


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def test_a_terminal_sees_progress_and_a_clean_line_after_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert main(["fit", bench.training, "--rig", bench.rig]) == 0
    assert "fit ..." in terminal.getvalue()
    assert "\n" not in terminal.getvalue()
    assert terminal.getvalue().endswith(ERASE_LINE)


def test_a_log_sees_progress_as_lines(run: Runner, bench: Bench) -> None:
    done = run("fit", bench.training, "--rig", bench.rig, "--progress")
    assert done.code == 0
    (line,) = done.err.splitlines()
    assert re.fullmatch(r" +\d+\.\d s  fit", line)
    assert run("fit", bench.training, "--rig", bench.rig).err == ""


def test_long_work_says_in_a_log_that_it_goes_on(
    run: Runner, bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "FIRST_LINE", 0.01)
    monkeypatch.setattr(output, "NEXT_LINES", 0.02)
    with progress_style(ProgressStyle.TERMINAL), progress_line() as progress:
        progress("score tests: 2 of 3")
        sleep(0.2)
    first, second, *_ = capsys.readouterr().err.splitlines()
    assert first.split(maxsplit=2)[1:] == second.split(maxsplit=2)[1:] == ["s", "score tests: 2 of 3"]
    assert run("fit", bench.training, "--rig", bench.rig, "--quiet").err == ""
    assert "  fit" in run("fit", bench.training, "--rig", bench.rig).err


def test_all_stages_of_a_command_are_timed_by_one_clock(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    instants = iter([0.0, 1.0, 2.0, 3.0, 9.0, 20.0, 21.0])
    monkeypatch.setattr(output, "monotonic", lambda: next(instants))
    with progress_style(ProgressStyle.LINES):
        with progress_line() as progress:
            for message in ("score tests: 1 of 3", "score tests: 2 of 3", "score tests: 3 of 3"):
                progress(message)
        with progress_line() as progress:
            progress("write the report")
    said = [line.split(maxsplit=2) for line in capsys.readouterr().err.splitlines()]
    assert said == [
        ["2.0", "s", "score tests: 1 of 3"], ["9.0", "s", "score tests: 3 of 3"], ["21.0", "s", "write the report"],
    ]  # fmt: skip


def test_quiet_writes_files_and_prints_nothing_but_json(run: Runner, bench: Bench, tmp_path: Path) -> None:
    out = tmp_path / "model.json"
    assert run("fit", bench.training, "--rig", bench.rig, "--quiet", "--out", out) == Outcome(0, "", "")
    assert out.is_file()
    assert json.loads(run("fit", bench.training, "--rig", bench.rig, "--quiet", "--json").out)
    refused = run("fit", "missing.csv", "--quiet")
    assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
    assert run("effects").out  # and of later commands nothing is withheld


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_every_help_states_the_exit_codes(command: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*command, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "Exit code: 0 done, 2 bad input (one line on stderr, nothing half-written), 130 interrupted." in text


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["--add", "a", "b", "--json"], ["--add", "a", "--add", "b", "--json"]),
        (["--add", "a", "run.csv"], ["--add", "a", "run.csv"]),
        (["--add", "a,b", "--json"], ["--add", "a", "--add", "b", "--json"]),
        (["--add", "a,", "b,c", "run.csv"], ["--add", "a", "--add", "b", "--add", "c", "run.csv"]),
        (["--add", ",", "run.csv"], ["--add", ",", "run.csv"]),
        (
            ["x.csv", "--add", "a", "b", "--drop", "c", "d"],
            ["x.csv", "--add", "a", "--add", "b", "--drop", "c", "--drop", "d"],
        ),
        (["--out", "a", "b"], ["--out", "a", "b"]),
        (["--add", "--json", "b"], ["--add", "--json", "b"]),
    ],
)
def test_an_option_takes_several_effects(given: list[str], meant: list[str]) -> None:
    assert ids_apart(given, {"--add", "--drop"}) == meant


def test_a_file_named_like_an_effect_is_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").touch()
    assert ids_apart(["--add", "a", "run"], {"--add"}) == ["--add", "a", "run"]


def test_several_effects_are_fitted(run: Runner, bench: Bench) -> None:
    both = run("fit", "--add", "viscous_drag", "sensor_lag", bench.training, "--rig", bench.rig, "--json")
    assert [effect["id"] for effect in json.loads(both.out)["effects"]] == ["viscous_drag", "sensor_lag"]


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("truewrench fi", "fit"),
        ("truewrench fit --add vis", "viscous_drag"),
        ("truewrench diagnose --val", "--validate"),
    ],
)
def test_a_shell_completes_commands_options_and_effects(typed: str, offered: str, tmp_path: Path) -> None:
    answer = tmp_path / "answer"
    shell = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "_ARGCOMPLETE_IFS": "\n"}
    program(env=os.environ | shell | {"COMP_LINE": typed, "COMP_POINT": str(len(typed))})
    assert offered in answer.read_text().split()


# --------------------------------------------------------------------------------------------- output


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")

    def broken() -> None:
        with atomic_write(path) as beside:
            beside.write_text("half of the ne")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        broken()
    assert path.read_text() == "old"
    with atomic_write(path) as beside:
        beside.write_text("new")
        assert path.read_text() == "old"
        assert beside.name.startswith(".file.txt.")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link_and_a_device_a_device(tmp_path: Path) -> None:
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    link.symlink_to(target)
    with atomic_write(link) as beside:
        beside.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    with atomic_write(Path(os.devnull)) as beside:
        assert beside == Path(os.devnull)
    assert Path(os.devnull).exists()


@dataclass(frozen=True)
class Inputs:
    """A folder with one file of each kind that commands read."""

    folder: Path

    def __call__(self, name: str) -> str:
        return str(self.folder / name)

    def contents(self) -> dict[str, bytes]:
        """What is in the folder, by name."""
        return {path.name: path.read_bytes() for path in sorted(self.folder.rglob("*")) if path.is_file()}


@pytest.fixture
def inputs(bench: Bench, tmp_path: Path) -> Inputs:
    """Files that need not be good ones: results are refused before any of them is read, but the rig."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    (folder / "rec.csv").write_bytes(Path(bench.training).read_bytes())
    (folder / "rig.toml").write_text('[robot]\nurdf = "arm.urdf"\nsensor_frame = "tool0"\n')
    for name in ("arm.urdf", "other.csv", "model.json", "result.json", "report.html", "report.md", "extra.toml"):
        (folder / name).write_text(name)
    (folder / "survey.parquet").write_text("a recording")
    (folder / "link.csv").symlink_to("rec.csv")
    (folder / "hard.csv").hardlink_to(folder / "rec.csv")
    return Inputs(folder)


REPLACING = {
    "fit-recording": ("fit rec.csv --rig rig.toml --out rec.csv", "rec.csv"),
    "fit-symbolic-link": ("fit rec.csv --rig rig.toml --out link.csv", "rec.csv"),
    "fit-of-a-link": ("fit link.csv --rig rig.toml --out rec.csv", "link.csv"),
    "fit-hard-link": ("fit rec.csv --rig rig.toml --out hard.csv", "rec.csv"),
    "fit-other-path": ("fit rec.csv --rig rig.toml --out ../inputs/./rec.csv", "rec.csv"),
    "fit-second-recording": ("fit rec.csv other.csv --rig rig.toml --out other.csv", "other.csv"),
    "fit-validation": ("fit rec.csv --validate other.csv --out other.csv", "other.csv"),
    "fit-rig": ("fit rec.csv --rig rig.toml --out rig.toml", "rig.toml"),
    "fit-urdf": ("fit rec.csv --rig rig.toml --out arm.urdf", "arm.urdf"),
    "fit-effects": ("fit rec.csv --effects extra.toml --out extra.toml", "extra.toml"),
    "fit-bounds": ("fit rec.csv --bounds extra.toml --out extra.toml", "extra.toml"),
    "fit-prior": ("fit rec.csv --prior extra.toml --out extra.toml", "extra.toml"),
    "fit-budget": ("fit rec.csv --budget extra.toml --out extra.toml", "extra.toml"),
    "fit-stream": ("fit rec.csv --stream --out rec.csv", "rec.csv"),
    "fit-report": ("fit report.md --report .", "report.md"),
    "compensate-recording": ("compensate model.json rec.csv --out rec.csv", "rec.csv"),
    "compensate-model": ("compensate model.json rec.csv --out model.json", "model.json"),
    "calibrate": ("calibrate rec.csv --rig rig.toml --out rec.csv", "rec.csv"),
    "emit": ("emit model.json --to c --out model.json", "model.json"),
    "compare": ("compare model.json --on report.html --report .", "report.html"),
    "diagnose-folder": ("diagnose model.json --rig rig.toml --out .", "model.json"),
    "diagnose-calibration": ("diagnose rec.csv --calibration result.json --out .", "result.json"),
    "diagnose-report": ("diagnose rec.csv --effects report.html --report .", "report.html"),
    "survey": ("survey rec.csv survey.parquet --rig rig.toml --out .", "survey.parquet"),
    "design-rig": ("design rig.toml --out rig.toml", "rig.toml"),
    "design-urdf": ("design rig.toml --out arm.urdf", "arm.urdf"),
    "design-model": ("design rig.toml --model model.json --out model.json", "model.json"),
    "design-next": ("design rig.toml --next result.json --out model.json", "model.json"),
    "import-log": ("import other.csv rec.csv --out rec.csv", "rec.csv"),
    "import-map": ("import rec.csv --map other.csv --out other.csv", "other.csv"),
    "import-rig": ("import rec.csv --rig other.csv --out other.csv", "other.csv"),
    "import-urdf": ("import rec.csv --rig rig.toml --plot arm.urdf", "arm.urdf"),
}
"""Arguments in the folder of the inputs, and the input that a result would replace."""


@pytest.mark.parametrize("case", REPLACING)
def test_no_result_replaces_what_is_read(
    case: str, inputs: Inputs, run: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, replaced = REPLACING[case]
    monkeypatch.chdir(inputs.folder)
    before = inputs.contents()
    refused(run(*arguments.split()), f"the result would replace {replaced}, which is read; give the result another")
    assert inputs.contents() == before


@pytest.mark.parametrize("second", ["--play plan.csv", "--play a.yaml --play ./a.yaml"])
def test_no_result_replaces_another(second: str, inputs: Inputs, run: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(inputs.folder)
    before = inputs.contents()
    refused(run(*f"design rig.toml --series rest --out plan.csv {second}".split()), "two results would have this name")
    assert inputs.contents() == before


def test_every_file_of_a_command_is_known_as_read_or_written() -> None:
    """What names a file says so: REC, RIG, FILE, a name with a suffix; so that a new option is not forgotten."""
    names = re.compile(r"REC\d?|RIG|SOURCE|FILE|DIR|FOLDER|.*\.(?:json|csv|toml)\b.*")
    commands = next(iter(parser()._subparsers._group_actions)).choices  # type: ignore[union-attr]
    files = {
        action.dest
        for command in commands.values()  # type: ignore[union-attr]
        for action in command._actions
        if names.fullmatch(str(action.metavar))
    }
    assert files == {*READ, "out", "play", "plot", "report"}


def test_a_result_in_a_folder_that_cannot_be_is_refused_before_any_work(inputs: Inputs, run: Runner) -> None:
    """Of a design too, whose work takes minutes."""
    inside = inputs("rec.csv/plan.csv")
    refused(run("design", inputs("rig.toml"), "--out", inside), "rec.csv", "is not a folder")
    refused(run("fit", inputs("rec.csv"), "--out", str(inputs.folder)), "is a folder", "give --out the name of a file")
