"""Static dwells: what was logged as a run, and is of poses at rest, is read as these, and what is a run is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from diagnosis.diagnosis import diagnose_case
from estimation.case import Case
from estimation.contact.contact_wrench import compensate
from estimation.fit import Fit, fit_case
from estimation.reading.log_reading import from_dataframe, imported, read
from estimation.recordings.recording import Recording
from modeling.chain.model import planar, spatial
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.rig import Convention
from tests.shared.dwell_logs import DwellLog
from tests.shared.places import DATA, needs
from truewrench.command_line import main

DWELLS = DATA / "reading_cases" / "dwell_with_gaps"


def recording_of(log: DwellLog, name: str = "log") -> Recording:
    frame = pd.DataFrame(log.columns()).drop(columns="resting")
    return from_dataframe(frame, name=name, one_run=True)


def ids(case: Case) -> list[str]:
    return [doubted.id for doubted in case.readings]


def tool(fitted: Fit) -> list[float]:
    """Mass, kg, and centre of mass, mm."""
    mass = fitted.values["m"]
    return [mass, *(1e3 * fitted.values[name] / mass for name in ("mx", "my", "mz"))]


@pytest.mark.parametrize("log", [{"gap": 2.0}, {}, {"gap": 2.0, "pose_noise": 0.003}], ids=str)
def test_poses_that_were_logged_one_after_the_other_are_read_as_poses(log: dict[str, Any]) -> None:
    case = Case.of(spatial(), [recording_of(DwellLog(seed=2, **log))])
    assert ids(case) == ["static_dwells"]
    assert case.readings[0].adopted
    assert case.recordings[0].samples == case.readings[0].value == 12
    fitted = fit_case(case)
    assert fitted.noise[0].source is NoiseSource.DWELLS
    estimates = [fitted.parameters[name] for name in ("m", "mx", "my", "mz")]
    truths = 0.9 * np.array([1.0, 0.005, -0.010, 0.060])
    # Four estimates within four std: by chance one of 4000 is not.
    assert all(abs(e.value - truth) < 4 * e.std for e, truth in zip(estimates, truths, strict=True))
    assert tool(fitted) == pytest.approx([0.9, 5, -10, 60], rel=0.02, abs=0.2)
    assert not np.isfinite(fitted.parameters["Ixx"].std)


def test_as_read_takes_the_run() -> None:
    recording = recording_of(DwellLog(seed=2))
    case = Case.of(replace(spatial(), convention=Convention.ON_TOOL), [recording], as_read=True)
    assert not case.readings
    assert case.recordings[0].samples == recording.samples


@pytest.mark.parametrize("log", [{}, {"drag": 0.05}, {"pose_noise": 0.002}, {"lag": 0.03}], ids=str)
def test_a_run_whose_transitions_a_tool_or_physics_of_motion_fits_stays_a_run(log: dict[str, Any]) -> None:
    case = Case.of(spatial(), [recording_of(DwellLog(seed=2, transition=1.0, rate=100.0, **log))])
    assert "static_dwells" not in ids(case)


@pytest.mark.parametrize(
    "log", [{"push": 5.0, "transition": 2.0, "rate": 50.0}, {"drift": 4.0, "transition": 1.0}], ids=str
)
def test_transitions_that_a_hand_spoils_and_a_zero_that_drifts_leave_poses(log: dict[str, Any]) -> None:
    case = Case.of(spatial(), [recording_of(DwellLog(seed=2, **log))])
    assert ids(case) == ["static_dwells"]
    assert "left out" in case.readings[0].sentence


def test_a_zero_that_warms_up_over_the_poses_is_a_bias_drift() -> None:
    case = Case.of(spatial(), [recording_of(DwellLog(seed=6, rate=10.0, dwell=10.0, drift=4.1))])
    diagnosis = diagnose_case(case)
    assert [effect.id for effect in diagnosis.fit.model.effects] == ["bias_drift"]
    assert diagnosis.fit.values["m"] == pytest.approx(0.9, abs=0.01)
    assert diagnosis.to_data()["readings"][0]["id"] == "static_dwells"


def planar_columns(gap: float) -> pd.DataFrame:
    rng = np.random.default_rng(8)
    angles = np.repeat(rng.uniform(-np.pi, np.pi, 10), 100)
    down = np.stack([np.sin(angles), -np.cos(angles)], axis=1)
    force = 1.2 * -9.80665 * down
    readings = np.column_stack([force, 0.07 * force[:, 0]]) * [1, -1, 1] + [0.5, -0.2, 0.01]
    readings = readings + rng.standard_normal(readings.shape) * [0.1, 0.1, 0.005]
    time = np.arange(1000) / 50 + np.repeat(gap * np.arange(10), 100)
    return pd.DataFrame({"time": time, "phi": angles} | dict(zip(("fx", "fy", "tau"), readings.T, strict=True)))


@pytest.mark.parametrize("gap", [0.0, 3.0])
def test_poses_in_the_plane_are_read_alike(gap: float) -> None:
    recording = from_dataframe(planar_columns(gap), one_run=True)
    case = Case.of(planar(), [recording])
    assert ids(case) == ["static_dwells"]
    assert fit_case(case).values["m"] == pytest.approx(1.2, abs=0.01)


def test_a_run_with_a_gap_is_refused_as_before() -> None:
    time = np.arange(2000) / 50
    frame = planar_columns(0.0).iloc[:1000].reset_index(drop=True)
    frame = pd.concat([frame, frame], ignore_index=True)
    frame["phi"], frame["time"] = 0.8 * np.sin(time), np.where(time < 20, time, time + 3)
    with pytest.raises(InputError, match="gap in time"):
        from_dataframe(frame, one_run=True)


@needs(DWELLS)
@pytest.mark.parametrize("name", ["dwell_gaps.csv", "dwell_joined.csv"])
def test_every_command_reads_a_log_of_poses_alike(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, model, imported_log = str(DWELLS / name), str(tmp_path / "model.json"), str(tmp_path / "imported.csv")

    def printed(*command: str) -> str:
        assert main(list(command)) == 0
        return capsys.readouterr().out

    data = json.loads(printed("fit", log, "--json", "--out", model))
    assert [reading["id"] for reading in data["readings"]] == ["static_dwells"]
    assert data["parameters"]["m"]["value"] == pytest.approx(0.9, abs=0.002)
    assert "12 poses at rest" in printed("import", log, "--out", imported_log)
    assert read(imported_log).wrench.shape == read(log).wrench.shape
    assert "12 poses at rest" in printed("compensate", model, log)
    assert "12 poses at rest" in printed("compare", model, "--on", log)


@needs(DWELLS)
def test_a_log_with_gaps_is_imported_whole() -> None:
    log = imported(DWELLS / "dwell_gaps.csv")
    assert log.report.samples == 1803
    assert log.recording().samples == 12


def test_a_run_of_poses_without_motion_between_has_no_contact_where_it_jumps() -> None:
    recording = recording_of(DwellLog(seed=2))
    fitted = fit_case(Case.of(spatial(), [recording]))
    contact = compensate(fitted, recording)
    assert not contact.intervals
    assert contact.recording.samples == 12


def test_a_mistake_in_the_log_is_proposed_beside_its_dwells() -> None:
    frame = pd.DataFrame(DwellLog(seed=2).columns()).drop(columns="resting")
    frame["fy"] *= -1.0
    recording = from_dataframe(frame, name="log", one_run=True)
    assert ids(Case.of(spatial(), [recording])) == ["static_dwells", "force_axis_mirrored"]
    case = Case.of(spatial(), [recording], read=["force_axis_mirrored"])
    assert not case.misread
    assert tool(fit_case(case)) == pytest.approx([0.9, 5, -10, 60], rel=0.02, abs=0.2)
