"""Rows polled faster than there are new values: each value counts once, by whatever door, and no delay is seen."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from diagnosis.diagnosis import diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from estimation.reading.log_reader import Array
from estimation.reading.log_reading import from_dataframe, imported, read
from modeling.chain.model import planar, spatial
from modeling.effects import named
from tests.shared.log_files import CHANNELS
from tests.shared.recordings import FEW
from tests.shared.rigs import ARM_RIG
from truewrench.simulated_rig import PlanarRig, SimulatedRig, SpatialRig, TimeDelay, ViscousDrag, simulate

pytest.importorskip("mujoco")

RIG = SpatialRig()


@cache
def run(repeats: int = 1, delay: float = 0.0) -> pd.DataFrame:
    motion = RIG.random_motion(seed=3, period=10.0)
    hidden = [TimeDelay(delay=delay)] if delay else []
    return simulate(RIG, motion, hidden=hidden, repeats=repeats, samples_per_period=3000, seed=5)


def held(frame: pd.DataFrame, rows: int, wrench: int = 0, motion: int = 0) -> pd.DataFrame:
    """Each value for so many rows, new in those that leave the remainder `wrench` or `motion`."""
    number = np.arange(len(frame))

    def kept(name: str) -> Array:
        first = wrench if name in CHANNELS else motion
        return frame[name].to_numpy()[np.maximum((number - first) // rows * rows + first, 0)]

    return frame.assign(**{name: kept(name) for name in map(str, frame) if name not in ("time", "repeat")})


@pytest.mark.parametrize("repeats", [1, 2])
@pytest.mark.parametrize(("rows", "wrench", "motion"), [(2, 0, 0), (2, 0, 1), (2, 1, 0), (3, 0, 0), (4, 0, 2)])
def test_each_value_counts_once(rows: int, wrench: int, motion: int, repeats: int, tmp_path: Path) -> None:
    frame, path = held(run(repeats), rows, wrench, motion), tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    for recording in (read(path), from_dataframe(frame, name="log"), imported(path).recording()):
        assert recording.dt == pytest.approx(rows / 300, rel=1e-5)
        assert len(np.unique(recording.wrench[:, 0])) == recording.samples
        assert recording.samples >= len(frame) // rows // repeats - 1
        (doubted,) = Case.of(spatial(), [recording]).readings
        assert doubted.id == "polled_twice"
        assert doubted.adopted
        assert doubted.value["wrench"] == rows


@pytest.mark.long
@pytest.mark.parametrize(("wrench", "motion"), [(0, 0), (0, 1), (1, 0)])
def test_no_delay_is_seen_and_a_true_one_is(wrench: int, motion: int) -> None:
    effects = [named(i) for i in ("time_delay", "sensor_lag", "viscous_drag")]
    clean, late = (
        diagnose(spatial(), from_dataframe(held(run(1, delay), 2, wrench, motion)), effects=effects)
        for delay in (0.0, 0.012)
    )
    assert clean.verdict is RecordVerdict.NOTHING_MISSING
    assert late.model.effects[0].id == "time_delay"
    assert late.steps[-1].fit.values["time_delay.delay"] == pytest.approx(0.012, abs=2e-4)


@pytest.mark.parametrize("drag", [(), (ViscousDrag(c=0.4),)], ids=["alone", "beside a drag"])
@pytest.mark.parametrize(
    ("rig", "samples"),
    [
        (PlanarRig(), 1200),
        *(pytest.param(r, n, marks=pytest.mark.long) for r, n in ((PlanarRig(), 8000), (RIG, 1200), (RIG, 8000))),
    ],
)
def test_it_is_named_on_every_kind_and_a_drag_beside_it_too(
    rig: SimulatedRig, samples: int, drag: tuple[ViscousDrag, ...]
) -> None:
    """Poses at rest are not polled: each is a row of its own."""
    frame = simulate(rig, rig.random_motion(seed=3), hidden=drag, repeats=1, samples_per_period=samples, seed=5)
    in_plane = isinstance(rig, PlanarRig)
    recording = from_dataframe(held(frame, 2), rig=ARM_RIG if in_plane else None)
    diagnosis = diagnose(planar(ARM_RIG) if in_plane else spatial(), recording, effects=FEW)
    assert [(reading.id, reading.value["wrench"]) for reading in diagnosis.readings] == [("polled_twice", 2)]
    assert diagnosis.added == (("viscous_drag",) if drag else ())
    assert diagnosis.verdict is (RecordVerdict.EXPLAINED if drag else RecordVerdict.NOTHING_MISSING)
    assert diagnosis.fit.values["m"] == pytest.approx(rig.mass, rel=0.003)


@cache
def fine() -> pd.DataFrame:
    """The run at 4 kHz, of which others take samples."""
    frame = simulate(RIG, RIG.random_motion(seed=3, period=10.0), repeats=1, samples_per_period=40_000, seed=5)
    return frame.drop(columns=["repeat", "temperature"])


@pytest.mark.long
@pytest.mark.parametrize(
    ("rows", "wrench", "pose", "late"),
    [
        (385, 192.5, 192.5, 0.0013),
        (385, 190, 190, 0.003),
        (500, 500, 120, 0.0),
        (1000, 480, 130, 0.001),
        (250, 125, 100, 0.004),
    ],
)
def test_no_delay_is_seen_of_clocks_that_run_by_themselves(
    rows: float, wrench: float, pose: float, late: float
) -> None:
    """Rows with the latest values of wrench and pose, at rates in Hz, the pose `late` by so many s."""
    instants = np.arange(0.05, 9.9, 1 / rows)
    columns = {"time": instants}
    for name in fine().columns[1:]:
        rate, start = (wrench, 0.0) if name in CHANNELS else (pose, late)
        taken = np.floor((instants - start) * rate) / rate + start
        columns[name] = fine()[name].to_numpy()[np.round(4000 * taken).astype(int)]
    recording = from_dataframe(pd.DataFrame(columns))
    effects = [named(i) for i in ("time_delay", "sensor_lag", "viscous_drag")]
    assert diagnose(spatial(), recording, effects=effects).verdict is RecordVerdict.NOTHING_MISSING


@pytest.mark.parametrize("size", [0.02, 0.1, 0.5, 2.0])
def test_a_coarse_resolution_is_not_polled(size: float) -> None:
    """Of all channels alike, N and N m, so that one of 2 changes a few times only."""
    frame = run()
    coarse = frame.assign(**{channel: np.round(frame[channel] / size) * size for channel in CHANNELS})
    assert from_dataframe(coarse, one_run=True).samples == len(frame)


def test_rows_that_were_written_twice_are_left_out(tmp_path: Path) -> None:
    frame, path = run(), tmp_path / "log.csv"
    pd.concat([frame, frame.iloc[::50]]).sort_values("time").to_csv(path, index=False)
    recording = read(path)
    assert recording.samples == len(frame)
    assert recording.reading is not None
    assert any("doubled rows left out" in step.what for step in recording.reading.steps)


def test_a_motion_that_is_slower_alone_is_no_reading() -> None:
    frame = run()
    slow = frame.assign(**{n: frame[n].to_numpy()[np.arange(len(frame)) // 4 * 4] for n in ("qx", "qy", "qz", "qw")})
    recording = from_dataframe(slow)
    assert recording.samples == len(frame)
    assert not Case.of(spatial(), [recording]).readings


@pytest.mark.parametrize("share", [0.35, 0.5, 0.65])
@pytest.mark.parametrize("seed", range(5))
def test_values_that_are_equal_by_chance_are_not_polled(share: float, seed: int) -> None:
    """A resolution so coarse that in each row all channels keep their values with the same probability."""
    frame, rng = run(), np.random.default_rng(seed)
    new = rng.random(len(frame)) < share
    new[0] = True
    last = np.maximum.accumulate(np.where(new, np.arange(len(frame)), 0))
    coarse = frame.assign(**{channel: frame[channel].to_numpy()[last] for channel in CHANNELS})
    assert from_dataframe(coarse).samples == len(frame)
