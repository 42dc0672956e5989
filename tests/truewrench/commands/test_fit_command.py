"""`truewrench fit` with constraints, a robust loss, repeats and poses: its words, its JSON, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import truewrench as tw
from estimation.streaming.chunk_information import linear_regressor_map
from modeling.chain.model import planar, spatial
from modeling.rig import Convention
from truewrench.command_line import main
from truewrench.files.model_file import ModelFile
from truewrench.simulated_rig import PlanarRig, SensorLag, simulate, static_poses, write_recording

pytest.importorskip("mujoco")

ARM = PlanarRig()
RIG_TEXT = "[robot]\nlink_lengths = [1.0, 0.97, 0.4]\n"


@dataclass(frozen=True)
class Bench:
    folder: Path
    rig: str
    run: str
    capsys: pytest.CaptureFixture[str]

    def fit(self, *options: str, recording: str | None = None) -> tuple[int, str]:
        """Exit code, and what was printed where that belongs."""
        self.capsys.readouterr()
        code = main(["fit", recording or self.run, "--rig", self.rig, *options])
        printed = self.capsys.readouterr()
        return code, printed.out if code == 0 else printed.err

    def toml(self, text: str) -> str:
        path = self.folder / "given.toml"
        path.write_text(text)
        return str(path)


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    return simulate(ARM, ARM.random_motion(seed=1), repeats=4, samples_per_period=200, seed=1)


@pytest.fixture
def bench(frame: pd.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Bench:
    (tmp_path / "rig.toml").write_text(RIG_TEXT)
    return Bench(tmp_path, str(tmp_path / "rig.toml"), str(write_recording(frame, tmp_path / "run.csv")), capsys)


def test_a_bound_that_the_data_contradict_is_a_finding(bench: Bench) -> None:
    out = str(bench.folder / "model.json")
    code, text = bench.fit("--bounds", bench.toml("m = [1.0, 2.0]"), "--out", out)
    assert code == 0
    assert "m is held at 1 kg by m >= 1 kg: unconstrained estimate 0." in text
    assert ModelFile.read(out).parameters["m"].value == 1.0
    data = json.loads(bench.fit("--bounds", bench.toml("m = [1.0, 2.0]"), "--json")[1])
    (active,) = data["constraints"]["active"]
    assert active["pressure"] == "contradicted"
    assert data["constraints"]["chi_square"] > data["constraints"]["chi_square_free"]


def test_a_bound_that_does_not_press_changes_nothing(bench: Bench) -> None:
    free = json.loads(bench.fit("--json")[1])
    held = json.loads(bench.fit("--bounds", bench.toml("m = [0.1, 3.0]"), "--physical", "--json")[1])
    assert held["constraints"]["active"] == []
    for name, of_free in free[
        "parameters"
    ].items():  # linear algebra of two threads rounds the last digits in its own way
        for key in ("value", "std"):
            assert held["parameters"][name][key] == pytest.approx(of_free[key], rel=1e-9)  # rounded by threads


def test_readings_of_the_other_sign_are_a_finding_when_the_tool_has_to_be_one(
    bench: Bench, frame: pd.DataFrame
) -> None:
    """Without the constraint it is an error message."""
    flipped = frame.assign(fx=-frame.fx, fy=-frame.fy, tau=-frame.tau)
    recording = str(write_recording(flipped, bench.folder / "flipped.csv"))
    code, error = bench.fit(recording=recording)
    assert code == 2
    assert "the mass comes out as -0.9" in error
    code, text = bench.fit("--physical", recording=recording)
    assert code == 0
    assert "the readings have the sign convention opposite to the stated one" in text


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("m = [0, 0.05]\nmlg = [1, 2]\nI = [0, 0.1]", "infeasible together with physical consistency"),
        ("mas = [0, 1]", "mas"),
        ("m = [2, 1]", "m"),
        ("m = 'heavy'", "m"),
        ("m = [nan, 1]", "m"),
        ("m = [0, 1", "TOML"),
    ],
)
def test_bad_bounds_are_one_line(text: str, named: str, bench: Bench) -> None:
    code, error = bench.fit("--bounds", bench.toml(text), "--physical")
    assert code == 2
    assert named in error
    assert len(error.splitlines()) == 1


def test_a_prior_pulls_towards_its_tool(bench: Bench) -> None:
    prior = "weight = 1e14\nm = 2.0\nmlg = 0.1\nI = 0.02\n"
    data = json.loads(bench.fit("--prior", bench.toml(prior), "--json")[1])
    assert data["parameters"]["m"]["value"] == pytest.approx(2.0, rel=1e-3)
    assert data["constraints"]["prior_cost"] is not None


def test_a_robust_fit_is_not_moved_by_outliers(bench: Bench, frame: pd.DataFrame) -> None:
    """One reading in a hundred off by 30 noises: the mass stays within its interval, and they are counted."""
    spikes = np.random.default_rng(1).random(len(frame)) < 0.01
    spiked = frame.assign(fx=frame.fx + 30 * ARM.noise[0] * spikes)
    recording = str(write_recording(spiked, bench.folder / "spiked.csv"))
    code, text = bench.fit("--robust", recording=recording)
    assert code == 0
    assert "Outliers, by" in text
    low, high = json.loads(bench.fit("--robust", "--json", recording=recording)[1])["intervals"]["m"]
    assert low < ARM.mass < high
    assert bench.fit("--robust", "--physical")[0] == 2
    plain, clean = bench.fit(recording=recording)[1], bench.fit()[1]
    assert f"spiked.csv: {spikes.sum()} of {len(frame)} samples of fx are outliers" in plain
    assert "`truewrench fit --robust`" in plain
    assert "outliers" not in text.split("Outliers, by")[0] + clean


def test_repeats_give_table_22_1(bench: Bench) -> None:
    brief, whole = bench.fit("--verbose")[1], bench.fit("--runs")[1]
    assert "noise gain" in brief
    assert "run 4" not in brief
    assert "run 4" in whole
    assert "average of 4" in whole


def test_poses_say_what_is_missing(bench: Bench) -> None:
    """One pose in the plane does not part mass from zero: it says so, and which pose to add."""
    columns = static_poses(ARM, np.array([[0.3, 0.2, 0.1], [0.3, 0.2, 0.1], [0.3, 0.2, 0.1]]), seed=1)
    code, text = bench.fit(recording=str(write_recording(columns, bench.folder / "poses.csv")))
    assert code == 0
    assert "Not identifiable from static poses, only from motion: I" in text
    assert "are collinear on this motion" in text
    assert "q1 = " in text


# ------------------------------------------------------------------------------------------------ a log that passes by

STATED = '[sensor]\nconvention = "on_tool"\nnoise = { fx = 0.5, fy = 0.5, tau = 0.05 }\n'


def a_log(path: Path, samples: int = 3000) -> Path:
    """Random motion with its derivatives, and exact readings of a tool of 1.5 kg but for white noise as stated."""
    rng = np.random.default_rng(0)
    motion = pd.DataFrame({name: rng.standard_normal(samples) for name in ("phi", "dphi", "ddphi", "ax", "ay")})
    model = planar()
    rows = linear_regressor_map(model)({name: motion[name].to_numpy() for name in motion}, samples)  # type: ignore[misc]
    wrench = np.tensordot([1.0, 2.0, 0.3, 1.5, 0.1, 0.02], rows[:-1], 1)
    wrench += rng.standard_normal((3, samples)) * np.array([[0.5], [0.5], [0.05]])
    log = motion.assign(time=0.001 * np.arange(samples), **dict(zip(model.channels, wrench, strict=True)))
    log.to_parquet(path)
    return path


def test_a_log_that_passes_by(bench: Bench) -> None:
    """The numbers of `tw.fit` of its chunks, in words, as JSON and in a model file that can be read again."""
    log, rig, out = a_log(bench.folder / "log.parquet"), bench.folder / "stated.toml", bench.folder / "model.json"
    rig.write_text(STATED)
    stated = Bench(bench.folder, str(rig), str(log), bench.capsys)
    expected = tw.fit(tw.planar(), tw.read_chunks(log), noise=tw.NoiseModel.white([0.5, 0.5, 0.05]))
    code, text = stated.fit("--stream", "--out", str(out))
    assert code == 0
    assert str(expected) in text
    assert "log.parquet: 3000 samples, reduced chi-square" in text
    assert ModelFile.read(out).parameters["m"].value == pytest.approx(expected.parameters["m"].value, rel=1e-12)
    data = json.loads(stated.fit("--stream", "--json")[1])
    assert data["samples"] == 3000
    assert data["misfit"] == pytest.approx(1.0, abs=0.06)  # 4 sigma of 9000 rows
    assert list(data["parameters"])[3:] == ["m", "mlg", "I"]
    assert data["unseen"] == []
    assert "com_offset.mlx" in stated.fit("--stream", "--add", "com_offset")[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--robust"], "--robust: not available for a streamed log"),
        (["--physical"], "--physical: not available for a streamed log"),
    ],
)
def test_what_a_log_that_passes_by_cannot_have(bench: Bench, options: list[str], message: str) -> None:
    log = a_log(bench.folder / "log.parquet")
    code, text = bench.fit(*options, "--stream", recording=str(log))
    assert code == 2
    assert message in text
    assert text.count("\n") == 1
    assert main(["fit", str(log), str(log), "--stream"]) == 2
    assert "several logs were given" in bench.capsys.readouterr().err


def test_a_long_log_is_streamed_by_itself(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it is by --stream, its noise taken from itself; but read whole where an option or the readings ask for it."""
    log = a_log(bench.folder / "log.parquet", samples=3000)
    whole = json.loads(bench.fit("--json", recording=str(log))[1])
    monkeypatch.setattr("truewrench.commands.fit.STREAMED_ROWS", 2500)
    monkeypatch.setattr("estimation.streaming.log_sketch.SKETCHED_ROWS", 1500)
    streamed = json.loads(bench.fit("--json", recording=str(log))[1])
    assert streamed == json.loads(bench.fit("--json", "--stream", recording=str(log))[1])
    assert (streamed["samples"], streamed["sketched"]) == (3000, 1500)
    assert streamed["fits"]
    assert "sketched" not in whole
    text = bench.fit("--report", str(bench.folder / "report"), recording=str(log))[1]
    assert "Read in chunks as one run" in text
    assert "1500 rows of 3000, evenly spaced" in (bench.folder / "report" / "report.md").read_text()
    assert "noise is estimated from the residual" in text
    truth = dict(zip(streamed["parameters"], (1.0, 2.0, 0.3, 1.5, 0.1, 0.02), strict=True))
    for name, estimate in streamed["parameters"].items():
        assert abs(estimate["value"] - truth[name]) < 5 * estimate["std"]  # p = 3e-6 for all six
    pushed = pd.read_parquet(log)
    pushed.loc[1500:, "fx"] += 60.0
    pushed.to_parquet(bench.folder / "pushed.parquet")
    text = bench.fit(recording=str(bench.folder / "pushed.parquet"))[1]
    assert "The tool is not known, as most of what fx read is not the tool's" in text
    assert "Read in chunks" in text
    warm = bench.folder / "warm.parquet"
    pd.read_parquet(log).assign(temperature=20 + np.linspace(0, 5, 3000)).to_parquet(warm)
    text = bench.fit("--add", "thermal_drift", recording=str(warm))[1]
    assert "Read in chunks" in text
    assert "thermal_drift.tau" in text
    for options in (["--period", "1"], ["--add", "sensor_lag"]):
        assert "Read in chunks" not in bench.fit(*options, recording=str(log))[1]


def test_a_long_log_that_is_read_wrongly_is_streamed_as_read(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Torques of the other sign than the forces: the fit says so first, as of the whole log, and gives the same."""
    rng, samples, model = np.random.default_rng(1), 1200, spatial()
    time = 0.02 * np.arange(samples)
    phases = rng.uniform(0, 2 * np.pi, (12, 3))
    sines = np.sin(2 * np.pi * np.multiply.outer(time, [0.13, 0.37, 0.71])[:, None] + phases).sum(axis=2)
    turn = Rotation.from_euler("xyz", 0.6 * sines[:, :3]).as_quat()
    motion = dict(zip(("qx", "qy", "qz", "qw"), turn.T, strict=True))
    names = [prefix + axis for prefix in ("w", "al", "ap") for axis in "xyz"]
    motion |= dict(zip(names, sines[:, 3:].T, strict=True))
    tool = [3, -2, 5, 0.1, 0.2, -0.1, 1.6, 0.01, -0.02, 0.12, 0.02, 0.0, 0.0, 0.02, 0.0, 0.008]
    rows = linear_regressor_map(replace(model, convention=Convention.ON_TOOL))(motion, samples)  # type: ignore[misc]
    wrench = np.tensordot(tool, rows[:-1], 1) + rng.standard_normal((6, samples)) * np.repeat([[0.2], [0.01]], 3, 0)
    wrench[3:] *= -1
    path = bench.folder / "turned.parquet"
    pd.DataFrame({"time": time, **motion, **dict(zip(model.channels, wrench, strict=True))}).to_parquet(path)
    whole = json.loads(bench.fit("--json", recording=str(path))[1])
    monkeypatch.setattr("truewrench.commands.fit.STREAMED_ROWS", 1000)
    for options in ([], ["--stream"]):
        text = bench.fit(*options, recording=str(path))[1]
        assert text.startswith("The recording seems to be read wrongly: the torques have the other sign than the")
        assert "Read in chunks" in text
    streamed = json.loads(bench.fit("--json", recording=str(path))[1])
    assert [reading["id"] for reading in streamed["readings"]] == [reading["id"] for reading in whole["readings"]]
    for name, estimate in streamed["parameters"].items():
        assert abs(estimate["value"] - whole["parameters"][name]["value"]) < estimate["std"]
    assert "read wrongly" not in bench.fit("--stream", "--as-read", recording=str(path))[1]


def test_fit_says_first_whether_the_model_fits(bench: Bench) -> None:
    """On the data of another rig whose sensor lags; a held-out recording without the lag fits neither way."""
    lagging = simulate(
        ARM, ARM.random_motion(seed=2), hidden=(SensorLag(time_constant=0.02),), repeats=4, samples_per_period=200
    )
    other = str(write_recording(lagging, bench.folder / "lagging.csv"))
    _, good = bench.fit()
    assert good.startswith("The model fits: the residual is consistent with the noise.")
    _, bad = bench.fit(recording=other)
    assert bad.startswith("The model does not fit lagging.csv")
    assert "Where the model fails" not in good
    assert "\nWhere the model fails:\n  lagging.csv: " in bad
    _, held_out = bench.fit("--validate", other)
    assert held_out.startswith("The model does not fit lagging.csv")
    assert "lagging.csv (held out, its biases estimated there):" in held_out
    data = json.loads(bench.fit("--validate", other, "--json")[1])
    assert not data["fits"]
    assert data["misfitting"] == ["lagging.csv (held out)"]  # as of a diagnosis
    assert [r["name"] for r in data["validation"]] == ["lagging.csv"]
    fixed = json.loads(bench.fit("--add", "sensor_lag", "--json", recording=other)[1])
    assert fixed["fits"]


def test_repeats_are_printed_when_asked_for(bench: Bench) -> None:
    """Whether it fits comes first, then the parameters, then the errors; the same in the JSON anyway."""
    short, verbose, runs = (bench.fit(*options)[1] for options in ((), ("--verbose",), ("--runs",)))
    assert short.index("fit") < short.index("parameter ") < short.index("reduced chi-square")
    assert "over its repeats" not in short
    assert "over its repeats" in verbose
    assert len(runs.splitlines()) > len(verbose.splitlines()) > len(short.splitlines())
    assert json.loads(bench.fit("--json")[1])["repeats"]
