"""A frozen channel and a re-zero in mid-log are named with their times and left out; what only looks so is neither."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.diagnosis import diagnose_case
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from estimation.fit import fit_case
from estimation.readings.stretch_reading import without_bad_stretches
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.effects import named
from modeling.space import Space
from tests.shared.recordings import base
from tests.shared.rigs import SIMULATED, described
from truewrench.files.case_files import frame_sentences
from truewrench.simulated_rig import HiddenEffect, PayloadChange, ViscousDrag, simulate

Array = NDArray[np.float64]
Change = Callable[[Array, Array], Array]
"""Of readings (n, p), given the std of their noise (p,)."""

DT = 0.02
KINDS = [(space, repeats) for space in Space for repeats in (8, 1)]
MASS = {Space.PLANE: 0.9, Space.SPACE: 1.2}


def recorded(
    space: Space, repeats: int, change: Change | None = None, *, seed: int = 1, hidden: tuple[HiddenEffect, ...] = ()
) -> Recording:
    """40 s of eight repeats, or one run, at 50 Hz, with readings that are changed."""
    rig = SIMULATED[space]
    period, harmonics = (5.0, 8) if repeats > 1 else (40.0, 24)
    motion = rig.random_motion(seed=seed, period=period, harmonics=harmonics)
    frame = simulate(rig, motion, hidden=hidden, repeats=repeats, samples_per_period=int(period / DT), seed=seed)
    frame = frame.drop(columns=["temperature", *(["repeat"] if repeats == 1 else [])])
    columns = {str(name): frame[name].to_numpy(dtype=float) for name in frame}
    if change is not None:
        readings = change(np.stack([columns[c] for c in rig.channels], axis=1), np.array(rig.noise))
        columns |= dict(zip(rig.channels, readings.T, strict=True))
    return from_columns(columns, name="log", rig=described(rig))


def frozen(first: int, last: int, channel: int = 1, value: float | None = None) -> Change:
    def change(readings: Array, _: Array) -> Array:
        readings[first:last, channel] = readings[first, channel] if value is None else value
        return readings

    return change


def rezeroed(*rows: int, mean: int = 1) -> Change:
    def change(readings: Array, _: Array) -> Array:
        for row in rows:
            readings[row:] -= readings[row + 1 - mean : row + 1].mean(axis=0)
        return readings

    return change


@pytest.mark.parametrize(("space", "repeats"), KINDS)
def test_frozen_channel_is_left_out_and_named(space: Space, repeats: int) -> None:
    """Mass within 4 std of the truth: one seeded fit fails so by chance in 1 of 15 000."""
    channel = SIMULATED[space].channels[1]
    case = Case.of(base(space), [recorded(space, repeats, frozen(840, 1240))])
    (reading,) = case.readings
    assert (reading.id, reading.adopted, case.misread) == ("channel_frozen", True, False)
    assert reading.value == {"log": {channel: [[pytest.approx(16.8), pytest.approx(24.8)]]}}
    assert [r.repeats for r in case.recordings] == ([3, 3] if repeats > 1 else [1, 1])
    mass = fit_case(case)["m"]
    assert abs(mass.value - MASS[space]) < 4 * mass.std
    assert frame_sentences(case)[0].startswith(f"Read so that {channel} of log is frozen from 16.8 to 24.8 s")


@pytest.mark.parametrize(("space", "repeats"), KINDS)
def test_rezeroed_log_has_a_bias_of_its_own_from_then_on(space: Space, repeats: int) -> None:
    """Mass within 4 std, and the biases differ by what was subtracted, within 5 std of any of at most six of them."""
    recording, plain = recorded(space, repeats, rezeroed(1060)), recorded(space, repeats)
    case = Case.of(base(space), [recording])
    (reading,) = case.readings
    assert (reading.id, reading.adopted, reading.value) == ("rezeroed", True, {"log": [pytest.approx(21.2)]})
    assert [r.repeats for r in case.recordings] == ([4, 3] if repeats > 1 else [1, 1])
    fitted = fit_case(case)
    assert abs(fitted["m"].value - MASS[space]) < 4 * fitted["m"].std
    for number, channel in enumerate(recording.channels):
        before, after = fitted[f"bias_{channel}"], fitted[f"bias_{channel}@{case.recordings[1].name}"]
        subtracted = plain.wrench[1060, number]
        assert abs(before.value - after.value - subtracted) < 5 * np.hypot(before.std, after.std)


def test_pieces_are_the_rows_that_are_left() -> None:
    """Whole repeats that follow each other; of one run, everything but the frozen rows."""
    repeats = recorded(Space.PLANE, 8, frozen(840, 1240))
    ((first, second),), _ = without_bad_stretches([repeats], base(Space.PLANE))
    np.testing.assert_array_equal(first.wrench, repeats.wrench[:750])
    np.testing.assert_array_equal(second.wrench, repeats.wrench[1250:])
    assert second.continuous
    assert second.name == "log 25 to 40 s"
    run = recorded(Space.PLANE, 1, frozen(1240, 2000))
    ((piece,),), _ = without_bad_stretches([run], base(Space.PLANE))
    np.testing.assert_array_equal(piece.wrench, run.wrench[:1240])
    assert piece.name == "log"
    np.testing.assert_array_equal(piece.columns["q1"], run.columns["q1"][:1240])


@pytest.mark.parametrize(
    ("change", "ids"),
    [
        (frozen(600, 720, 0, value=0.0), ["channel_frozen"]),
        (lambda r, s: frozen(1200, 1400)(frozen(400, 600)(r, s), s), ["channel_frozen"]),
        (lambda r, s: frozen(1200, 1600)(rezeroed(600)(r, s), s), ["channel_frozen", "rezeroed"]),
        (rezeroed(600, 1400), ["rezeroed"]),
        (rezeroed(1060, mean=5), ["rezeroed"]),
        (lambda r, s: np.round(rezeroed(1060)(r, s) / s) * s, ["rezeroed"]),
    ],
    ids=["dropout", "frozen twice", "frozen and re-zeroed", "re-zeroed twice", "zero of a mean", "quantised"],
)
@pytest.mark.parametrize("repeats", [8, 1])
def test_siblings_are_named_too(change: Change, ids: list[str], repeats: int) -> None:
    _, readings = without_bad_stretches([recorded(Space.PLANE, repeats, change, seed=11)], base(Space.PLANE))
    assert [reading.id for reading in readings] == ids


def held(samples: int) -> Change:
    return lambda readings, _: readings[np.arange(len(readings)) // samples * samples]


def pushed(first: int, last: int) -> Change:
    def change(readings: Array, noise: Array) -> Array:
        readings[first:last] += 40 * noise * (-1.0) ** np.arange(len(noise))
        return readings

    return change


def to_zero(readings: Array, _: Array) -> Array:
    readings[800:1200] -= readings[800]
    return readings


def clipped(readings: Array, _: Array) -> Array:
    readings[:, 1] = np.minimum(readings[:, 1], np.quantile(readings[:, 1], 0.8))
    return readings


def in_dead_band(readings: Array, _: Array) -> Array:
    readings[:, 1] = np.where(np.abs(readings[:, 1]) < 0.1 * np.ptp(readings[:, 1]), 0.0, readings[:, 1])
    return readings


@pytest.mark.parametrize(
    "change",
    [
        None, lambda r, s: np.round(r / s) * s, lambda r, s: np.round(r / s / 20) * s * 20, held(3), held(25),
        pushed(800, 1000), pushed(1200, 2000), to_zero, clipped, in_dead_band,
        lambda r, s: r + 30 * s * np.linspace(0.0, 1.0, len(r))[:, None],
    ],
    ids=[
        "plain", "quantised", "coarse", "polled", "slow", "push", "push to the end", "push to zero", "saturated",
        "dead band", "drift",
    ],
)  # fmt: skip
@pytest.mark.parametrize("repeats", [8, 1])
def test_what_only_looks_so_is_neither(change: Change | None, repeats: int) -> None:
    for space in Space:
        recording = recorded(space, repeats, change, seed=11)
        pieces, readings = without_bad_stretches([recording], base(space))
        assert readings == ()
        assert pieces == ((recording,),)


def test_payload_is_no_zero() -> None:
    """A load that is put down where the sensor was zeroed before: it turns with the tool while it is held."""
    run = recorded(Space.SPACE, 1, hidden=(PayloadChange(time=14.0, mass=0.4),))
    held_from = run.with_readings(run.wrench - run.wrench[1000])
    assert without_bad_stretches([run, held_from], base(Space.SPACE))[1] == ()


def test_as_read_takes_the_log_as_it_is() -> None:
    recording = recorded(Space.PLANE, 8, frozen(840, 1240))
    case = Case.of(base(Space.PLANE), [recording], as_read=True)
    assert (case.readings, len(case.recordings)) == ((), 1)


def test_frozen_channel_that_is_taken_as_it_is_is_not_explained() -> None:
    """What deviates in two of eight repeats is no gain, though the lines that repeat fit."""
    case = Case.of(base(Space.PLANE), [recorded(Space.PLANE, 8, frozen(840, 1240))], as_read=True)
    diagnosis = diagnose_case(case, effects=[named("sensor_gain")])
    assert diagnosis.verdict is RecordVerdict.UNEXPLAINED
    assert diagnosis.unexplained is not None
    assert "deviates from the others" in diagnosis.unexplained.where


@pytest.mark.parametrize("change", [frozen(840, 1240), rezeroed(1060)], ids=["frozen", "re-zeroed"])
def test_effect_beside_it_is_diagnosed(change: Change) -> None:
    recording = recorded(Space.PLANE, 8, change, hidden=(ViscousDrag(c=0.5, d=0.12),))
    diagnosis = diagnose_case(Case.of(base(Space.PLANE), [recording]))
    assert (diagnosis.verdict, diagnosis.added) == (RecordVerdict.EXPLAINED, ("viscous_drag",))
