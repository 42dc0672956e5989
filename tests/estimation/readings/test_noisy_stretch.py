"""Stretches of larger noise within repeats: found, told from pushes and from noise of the motion, and weighted."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.noise.events_in_repeats import find_events_in_repeats, find_stretches_in_repeats
from estimation.noise.events_in_single_runs import find_events_in_single_runs
from estimation.readings.noisy_stretch import SteadiedRecording
from estimation.readings.stretch_reading import without_bad_stretches
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
PERIOD = 250
STD = np.array([0.15, 0.25, 0.012])


def moved(repeats: int) -> Recording:
    motion = PlanarRig().random_motion(seed=3)
    table = simulate(PlanarRig(), motion, repeats=repeats, samples_per_period=PERIOD, seed=3)
    return recording_of(table, rig=RIG)


MOVED = {repeats: moved(repeats) for repeats in (2, 3, 4, 6)}
"""Whose own readings are not used: only their motion."""


def recorded(repeats: int, seed: int, burst: tuple[int, int, float] = (0, 0, 1.0), push: float = 0.0) -> Recording:
    """A smooth periodic wrench in white noise that is larger for a while, with a push (std) of half a second."""
    rng = np.random.default_rng([seed, repeats])
    phase = 2 * np.pi * np.arange(repeats * PERIOD) / PERIOD
    wrench = np.stack([5 * np.sin(phase), 3 * np.cos(2 * phase), 0.2 * np.sin(3 * phase)], axis=1)
    noise = rng.normal(size=wrench.shape)
    noise[burst[0] : burst[1]] *= burst[2]
    noise[300:325] += push
    return MOVED[repeats].with_readings(wrench + STD * noise)


@pytest.mark.parametrize("repeats", [2, 3, 4, 6])
def test_a_burst_is_found_where_it_is(repeats: int) -> None:
    """Five times the noise for a second; each end within eight samples."""
    for seed in range(5):
        steadied = SteadiedRecording.of(recorded(repeats, seed, (290, 340, 5.0)))
        ((first, last),) = steadied.stretches
        assert abs(first - 290) <= 8
        assert abs(last - 340) <= 8
        assert 3 < np.exp(np.log(steadied.ratio[first]).mean()) < 8


@pytest.mark.parametrize("repeats", [2, 3, 4, 6])
def test_noise_pushes_and_what_grows_with_the_motion_are_none(repeats: int) -> None:
    """The level is one in a thousand records."""
    growing = 0.5 + np.abs(np.sin(np.pi * np.arange(repeats * PERIOD) / PERIOD)) * 2
    for seed in range(8):
        for recording in (recorded(repeats, seed), recorded(repeats, seed, push=40.0)):
            assert not SteadiedRecording.of(recording).stretches
        plain = recorded(repeats, seed)
        mean = plain.averaged(plain.wrench)
        larger = plain.with_readings(mean + (plain.wrench - mean) * growing[:, None])
        assert not SteadiedRecording.of(larger).stretches


def test_the_mean_over_repeats_is_the_weighted_one_with_the_std_that_the_repeats_show() -> None:
    """40 draws: the std of the mean within the burst is that of five of six repeats, and of the whole what is shown."""
    inside, shown, true = [], [], []
    for seed in range(40):
        recording = recorded(6, seed, (290, 340, 8.0))
        white = (SteadiedRecording.of(recording).steadied.wrench - recorded(6, seed).wrench) / STD
        blocks = ((recorded(6, seed).wrench - smooth()) / STD + white).reshape(6, PERIOD, 3)
        mean = blocks.mean(axis=0)
        inside.append(mean[44:86].var())
        true.append((mean**2).mean())
        shown.append(((blocks - mean) ** 2).sum(axis=0).mean() / 5 / 6)
    assert np.mean(inside) == pytest.approx(1 / 5, rel=0.15)
    assert np.mean(true) == pytest.approx(np.mean(shown), rel=0.05)


def smooth() -> Array:
    """The periodic wrench of `recorded`."""
    phase = 2 * np.pi * np.arange(6 * PERIOD) / PERIOD
    return np.stack([5 * np.sin(phase), 3 * np.cos(2 * phase), 0.2 * np.sin(3 * phase)], axis=1)


def test_a_push_within_a_burst_is_kept() -> None:
    recording = recorded(6, 1, (290, 340, 4.0), push=20.0)
    steadied = SteadiedRecording.of(recording).steadied.wrench
    pushed = (steadied - smooth())[300:325].mean(axis=0) / STD
    assert np.all(pushed > 10)


def test_it_is_said() -> None:
    (pieces,), (reading,) = without_bad_stretches([recorded(6, 2, (290, 340, 5.0))], planar(RIG))
    assert len(pieces) == 1
    assert (reading.id, reading.adopted) == ("noisy_stretch", True)
    ((begin, end),) = reading.value[pieces[0].name]
    assert begin == pytest.approx(290 / PERIOD * 5, abs=0.2)
    assert end == pytest.approx(340 / PERIOD * 5, abs=0.2)
    assert "the noise is larger for a while" in reading.sentence


def test_of_two_repeats_an_event_is_found_in_either() -> None:
    """A push of three std for half a second; noise alone in none of four, at one in a thousand each."""
    for seed in range(4):
        quiet, pushed = recorded(2, seed), recorded(2, seed, push=5.0)
        assert not find_events_in_repeats(quiet, quiet.wrench)
        (event, *_) = find_events_in_repeats(pushed, pushed.wrench)
        place = np.array([300, 325]) % PERIOD / PERIOD * 5
        assert np.abs(np.array(event) % 5 - place).max() < 0.1


def test_what_goes_to_and_fro_is_found() -> None:
    """A hand that shakes the tool at 3 Hz for two seconds: no pulse explains it, nor does noise look so."""
    for seed in range(5):
        recording = recorded(6, seed)
        time = np.arange(recording.samples) * 0.02
        shaken = np.where((time > 11) & (time < 13), np.sin(2 * np.pi * 3 * (time - 11)), 0.0)[:, None] * 20 * STD
        assert not find_stretches_in_repeats(recording, recording.wrench)
        spans = find_stretches_in_repeats(recording, recording.wrench + shaken)
        assert spans
        assert all(10.5 < begin < end < 13.5 for begin, end in spans)


def test_an_event_of_a_single_run_has_the_times_of_its_blocks() -> None:
    """Of 1400 samples, that 120 blocks do not divide: the edges of blocks, within one of the push."""
    motion = PlanarRig().random_motion(seed=3)
    table = simulate(PlanarRig(), motion, repeats=1, samples_per_period=1400, seed=3).drop(columns="repeat")
    recording = recording_of(table, rig=RIG)
    assert recording.dt is not None
    pushed = recording.wrench + np.outer((np.arange(1400) >= 700) & (np.arange(1400) < 800), 30 * STD)
    (((begin, end),),) = find_events_in_single_runs(planar(RIG), [recording.with_readings(pushed)])
    block = 12 * recording.dt
    assert 700 * recording.dt - block <= begin <= 700 * recording.dt
    assert 800 * recording.dt <= end + 1e-9 <= 800 * recording.dt + block
