"""Rows of a log outside the repeats that are cut: counted, and compared with what the fit of the repeats predicts.

The logs are MuJoCo's: a periodic motion, then the same path at a rate that falls to a stop, or goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from design.trajectories.trajectory import Trajectory
from diagnosis.diagnosis import diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.contact.rows_left_out import RowsLeftOut, rows_left_out
from estimation.fit import fit
from estimation.reading.log_reading import read
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.effects import viscous_drag
from modeling.rig import Rig
from truewrench.command_line import main
from truewrench.files.case_files import rigid_tool_case
from truewrench.simulated_rig import NOISE_MODELS, ContactEvent, PlanarRig, simulate
from truewrench.text.diagnosis_text import diagnosis_text
from truewrench.text.fit_summary import FitSummary

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
RIG = PlanarRig()
REPEATS, RATE = 4, 100.0
PUSH = ContactEvent(start=28.0, end=35.0, force=(20.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0))
"""7 s of 20 N, while the arm stands still."""


@dataclass(frozen=True)
class EndedMotion:
    """A periodic motion that comes to a stop within two seconds after its repeats, or goes on."""

    motion: Trajectory
    rest: float
    stops: bool

    @property
    def period(self) -> float:
        """Of the log: its length, s."""
        return self.motion.period * REPEATS + self.rest

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """The path at tau(t), whose rate falls from 1 to 0 with two continuous derivatives."""
        end = self.motion.period * REPEATS
        s = np.clip((time - end) / 2, 0.0, 1.0) if self.stops else np.zeros_like(time)
        tau = np.where(self.stops, np.minimum(time, end) + 2 * (s - 2.5 * s**4 + 3 * s**5 - s**6), time)
        rate, slope = 1 - (10 * s**3 - 15 * s**4 + 6 * s**5), -15 * s**2 * (1 - s) ** 2
        q, dq, ddq = self.motion.evaluate(tau)
        return q, dq * rate[:, None], ddq * rate[:, None] ** 2 + dq * slope[:, None]


def log(
    folder: Path, seed: int, *, rest: float = 20.0, stops: bool = True, push: bool = False, noise: str = "white"
) -> Recording:
    """Four repeats of 5 s, and `rest` s more, read from a file."""
    motion = EndedMotion(RIG.random_motion(seed=seed), rest, stops)
    frame = simulate(
        RIG,
        motion,
        hidden=[PUSH] if push else [],
        repeats=1,
        samples_per_period=round(motion.period * RATE),
        noise=NOISE_MODELS[noise],
        seed=seed,
    )
    path = folder / "log.csv"
    frame.drop(columns=["repeat", "temperature"], errors="ignore").to_csv(path, index=False)
    return read(path, rig=Rig(link_lengths=RIG.link_lengths))


def outside(recording: Recording) -> RowsLeftOut:
    (found,) = rows_left_out(fit(planar(recording.rig), recording))
    return found


def test_the_rows_outside_the_repeats_are_counted(tmp_path: Path) -> None:
    recording = log(tmp_path, 1)
    assert recording.repeats == REPEATS
    assert recording.whole is not None
    assert recording.whole.recording.samples == 4000
    assert recording.whole.left_out == ((2000, 4000),)
    assert recording.whole.share == 0.5
    assert recording.with_readings(recording.wrench).whole is None
    data = outside(recording).to_data()
    assert data == {
        "recording": "log.csv", "used": 2000, "of": 4000, "left_out": [[20.0, 40.0]], "tested": True, "deviations": [],
    }  # fmt: skip


@pytest.mark.parametrize("noise", sorted(NOISE_MODELS))
@pytest.mark.parametrize(("rest", "stops"), [(20.0, True), (2.7, False)], ids=["stop", "part of a repeat"])
def test_readings_of_the_same_tool_agree(rest: float, stops: bool, noise: str, tmp_path: Path) -> None:
    """At most one log in a thousand differs by chance; of 60 others, with other seeds, none did."""
    found = outside(log(tmp_path, 3, rest=rest, stops=stops, noise=noise))
    assert found.tested
    assert not found.deviations
    assert found.sentence.endswith("the readings agree with the model.")


def test_a_push_after_the_repeats_is_found(tmp_path: Path) -> None:
    """To a twentieth of a second and of the force; noise 0.15 N, over 700 samples."""
    found = outside(log(tmp_path, 1, push=True))
    ((begin, end, force),) = found.deviations
    assert (begin, end) == pytest.approx((PUSH.start, PUSH.end), abs=0.05)
    assert force == pytest.approx(20, rel=0.05)
    assert "by 20 N from 28 to 35 s" in found.sentence
    assert "2000 of 4000 rows (50 %) are whole repeats" in found.sentence


def test_a_few_rows_are_counted_and_not_compared(tmp_path: Path) -> None:
    found = outside(log(tmp_path, 2, rest=0.1, stops=False))
    assert found.used == 2000
    assert found.rows == 2010
    assert not found.tested
    assert found.sentence.endswith("too few to be compared with the model.")


def test_a_verdict_over_a_push_is_not_that_nothing_is_missing(tmp_path: Path) -> None:
    recording = log(tmp_path, 1, push=True)
    found = diagnose(planar(recording.rig), recording, effects=[viscous_drag()])
    assert found.verdict is RecordVerdict.UNEXPLAINED
    assert found.unexplained is not None
    assert found.unexplained.where.startswith(
        "outside the whole repeats of log.csv, the readings differ from the model"
    )
    assert found.to_data()["rows"][0]["deviations"][0]["force"] == pytest.approx(20, rel=0.05)
    text = diagnosis_text(found)
    assert "residual outside the whole repeats of log.csv, while these show none" in text
    assert "Resembles" not in text
    quiet = log(tmp_path, 1)
    assert diagnose(planar(quiet.rig), quiet, effects=[viscous_drag()]).verdict is RecordVerdict.NOTHING_MISSING


def test_a_fit_says_what_it_is_not_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = log(tmp_path, 1, push=True)
    data = rigid_tool_case([recording], [], recording.rig)
    fitted = fit(data.model, recording)
    summary = FitSummary(fitted, fitted.intervals())
    assert summary.headline().startswith(
        "The model fits the whole repeats of log.csv, but not the readings outside them"
    )
    assert summary.to_data(data)["fits"] is False
    rig = tmp_path / "rig.toml"
    rig.write_text(f"[robot]\nlink_lengths = {list(RIG.link_lengths)}\n", encoding="utf-8")
    assert main(["fit", str(tmp_path / "log.csv"), "--rig", str(rig)]) == 0
    assert "outside them, from 20 to 40 s, the readings differ from the model" in capsys.readouterr().out
