"""Nothing is found where nothing is hidden, in white and in coloured noise.

Every recording is simulated with a seed of its own, so a test fails always or never; the probability stated is that of
its failing for another choice of seeds if exactly 1 % of recordings raised an alarm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.coverage import LowPassedNoise
from diagnosis.comparison.comparison import comparison_of
from diagnosis.diagnosis import diagnose
from diagnosis.screening.score_test import adjusted_p_values, screen
from diagnosis.verdict_rule import RecordVerdict
from estimation.fit import fit
from estimation.recordings.reading import read
from modeling.chain.model import planar, spatial
from modeling.effects import catalogue
from modeling.significance import LEVELS
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import (
    AutoregressiveNoise,
    ContactEvent,
    HiddenEffect,
    NoiseModel,
    PayloadChange,
    PlanarRig,
    SimulatedRig,
    SpatialRig,
    StudentNoise,
    ViscousDrag,
    WhiteNoise,
    simulate,
    write_recording,
)

pytest.importorskip("mujoco")

RECORDINGS = 12
ALLOWED = int(binom.ppf(0.99, RECORDINGS, LEVELS.effect))
"""One of 12; more come with probability 0.6 % where the rate is 1 %."""


@dataclass(frozen=True)
class Alarms:
    """Over all recordings: effects found significant, how often a lack of fit was, and each reduced chi-square."""

    named: list[str]
    misfits: int
    reduced: list[float]


def alarms(noise: NoiseModel, recordings: int = RECORDINGS, repeats: int = 4) -> Alarms:
    """Screening at 1 % over the catalogue, and the lack of fit, on recordings of repeats of 250 samples."""
    named, misfits, reduced = [], 0, []
    for seed in range(recordings):
        motion = PlanarRig().random_motion(seed=seed)
        frame = simulate(PlanarRig(), motion, repeats=repeats, samples_per_period=250, noise=noise, seed=1000 + seed)
        rigid = fit(planar(RIG), recording_of(frame, rig=RIG))
        adjusted = adjusted_p_values(screen(rigid, catalogue(rigid.model.space)))
        found = min(adjusted, key=lambda effect_id: adjusted[effect_id])
        named += [found] if adjusted[found] < LEVELS.effect else []
        compared = comparison_of(rigid, 0)
        misfits += compared.lack_of_fit < LEVELS.effect
        reduced += [float(compared.misfit or np.nan)]
    return Alarms(named, misfits, reduced)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(WhiteNoise(), id="white"),
        pytest.param(AutoregressiveNoise(rho=0.95), id="ar95", marks=pytest.mark.long),
    ],
)
def nothing_hidden(request: pytest.FixtureRequest) -> Alarms:
    return alarms(request.param)


def test_no_effect_is_named_more_often_than_one_time_in_a_hundred(nothing_hidden: Alarms) -> None:
    assert len(nothing_hidden.named) <= ALLOWED, nothing_hidden.named


def test_no_lack_of_fit_is_seen_more_often_than_one_time_in_a_hundred(nothing_hidden: Alarms) -> None:
    assert nothing_hidden.misfits <= ALLOWED


@pytest.mark.parametrize("noise", [AutoregressiveNoise(rho=0.98), StudentNoise()], ids=["ar98", "student"])
def test_noise_that_wanders_or_jumps_is_no_drift_and_no_push(noise: NoiseModel) -> None:
    """Textbook whitening by lines takes the seam of slow noise for a drift in nine recordings of ten.

    One alarm in 4 is allowed; at a rate of 1 % more come with probability 0.06 %.
    """
    found = alarms(noise, recordings=4)
    assert len(found.named) <= binom.ppf(0.99, 4, LEVELS.effect), found.named


# ------------------------------------------------------------------------------------ filtered sensors


@pytest.mark.parametrize(
    ("noise", "repeats"),
    [
        pytest.param(LowPassedNoise(corner=0.1), 4, id="0.1"),
        pytest.param(LowPassedNoise(corner=0.146), 4, id="0.146"),
        pytest.param(LowPassedNoise(corner=0.05, order=8), 3, id="order 8"),
    ],
)
def test_noise_of_a_filtered_sensor_is_no_drift_and_no_push(noise: NoiseModel, repeats: int) -> None:
    """Its leakage at the record's ends is a jump that no such noise has: without it, each of these raises an alarm.

    None in 3 is allowed; at a rate of 1 % one comes with probability 3 %. Their reduced chi-square is near one: that of
    one with 60 degrees of freedom and more in a noise as uncertain varies by 0.2, the mean of three by 0.12.
    """
    found = alarms(noise, recordings=3, repeats=repeats)
    assert not found.named
    assert not found.misfits
    assert abs(np.mean(found.reduced) - 1) < 0.5


def test_a_push_is_an_event_in_the_noise_of_a_steep_filter() -> None:
    """A spectrum that may follow a steep filter would follow the push, too."""
    frame = simulate(
        PlanarRig(), PlanarRig().random_motion(seed=3001), hidden=(ContactEvent(),), repeats=8, samples_per_period=250,
        noise=LowPassedNoise(corner=0.05, order=8), seed=1,
    )  # fmt: skip
    events = fit(planar(RIG), recording_of(frame, rig=RIG)).noise[0].events
    assert any(begin < 24.5 < end for begin, end in events)


@dataclass(frozen=True, kw_only=True)
class Filtered:
    """A recording of a filtered sensor: its rig, rate (Hz), corner (Hz) and white floor."""

    rig: SimulatedRig
    rate: int
    corner: float
    floor: float = 0.0

    def written(self, folder: Path, *, repeats: int, seed: int, hidden: tuple[HiddenEffect, ...] = ()) -> Path:
        """Its file, of so many repeats of 5 s."""
        frame = simulate(
            self.rig,
            self.rig.random_motion(seed=seed),
            hidden=hidden,
            repeats=repeats,
            samples_per_period=5 * self.rate,
            noise=LowPassedNoise(corner=self.corner / self.rate, floor=self.floor),
            seed=5000 + seed,
        )
        return write_recording(frame, folder / "train.csv")


FILTERED = [
    Filtered(rig=rig, rate=rate, corner=corner, floor=floor)
    for rig in (PlanarRig(), SpatialRig())
    for floor in (0.0, 0.01)
    for rate, corner in ((100, 10), (100, 20), (500, 73))
]


@pytest.mark.long(3)
@pytest.mark.parametrize("number", range(len(FILTERED)))
def test_nothing_is_missing_in_the_noise_of_a_filtered_sensor(number: int, tmp_path: Path) -> None:
    """One of the twelve files raises an alarm with probability 11 % if 1 % do."""
    case = FILTERED[number]
    path = case.written(tmp_path, repeats=(4, 6, 8, 10)[number % 4], seed=300 + number)
    plane = isinstance(case.rig, PlanarRig)
    found = diagnose(planar(RIG) if plane else spatial(), read(path, rig=RIG if plane else None))
    assert found.verdict is RecordVerdict.NOTHING_MISSING
    assert not found.added


@pytest.mark.long(3)
@pytest.mark.parametrize(
    ("hidden", "sizes"),
    [
        (ContactEvent(), {"contact_event.fcx": 4.0, "contact_event.fcy": 2.0, "contact_event.tauc": 0.3}),
        (PayloadChange(), {"payload_change.mass": 0.05}),
        (ViscousDrag(), {"viscous_drag.c": 0.15}),
    ],
    ids=lambda value: getattr(value, "id", ""),
)
def test_what_is_hidden_in_the_noise_of_a_filtered_sensor_is_found(
    hidden: HiddenEffect, sizes: dict[str, float], tmp_path: Path
) -> None:
    """It alone, within 5 std and a twentieth."""
    case = Filtered(rig=PlanarRig(), rate=100, corner=20, floor=0.01)
    found = diagnose(planar(RIG), read(case.written(tmp_path, repeats=8, seed=103, hidden=(hidden,)), rig=RIG))
    assert found.added == (hidden.id,)
    for name, size in sizes.items():
        estimate = found.fit.parameters[name]
        assert abs(estimate.value - size) < 5 * estimate.std
        assert abs(estimate.value - size) < size / 20
