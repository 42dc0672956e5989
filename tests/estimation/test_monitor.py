"""The monitor: its densities by dense algebra, its false alarms, what it finds, and the same in C."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.contact.contact_wrench import CalibratedModel
from estimation.fit import Fit, fit
from estimation.monitor import UNKNOWN, Monitor, _Filters
from estimation.recordings.reading import read
from estimation.recordings.recording import Recording
from modeling.codegen.template import CTarget
from modeling.effects import named
from modeling.errors import InputError
from modeling.space import Space
from tests.shared.emitted import FLAGS
from tests.shared.recordings import Silence, base, recording_of
from tests.shared.rigs import SIMULATED, described
from truewrench.command_line import main
from truewrench.emitted import emit
from truewrench.files.model_file import ModelFile, load, save
from truewrench.simulated_rig import (
    NOISE_MODELS,
    CableSpring,
    HiddenEffect,
    PayloadChange,
    ViscousDrag,
    resolve_effects,
    simulate,
)

Array = NDArray[np.float64]

CONTACT = 5.0
"""s, the longest contact of most tests: blocks of half a second, 25 samples."""
SAMPLES = 250
"""Of a period of 5 s."""
DRAG = (ViscousDrag(c=0.15, d=0.12),)
TETHER = (CableSpring(k=8.0),)
DEVIATIONS = 4.5
"""Std that an estimate may be off by: seven in a million, each."""


def deviations(space: Space) -> Array:
    """Noise of one sample (p,)."""
    return np.array(SIMULATED[space].noise)


@cache
def quiet(space: Space, hidden: tuple[HiddenEffect, ...], motion: int, repeats: int) -> Recording:
    """A recording without noise; effects are where the first motion puts them."""
    rig = SIMULATED[space]
    placed = resolve_effects(rig, rig.random_motion(seed=1), [e for e in hidden if not isinstance(e, PayloadChange)])
    effects = [*placed, *(e for e in hidden if isinstance(e, PayloadChange))]
    frame = simulate(
        rig,
        rig.random_motion(seed=motion),
        hidden=effects,
        repeats=repeats,
        samples_per_period=SAMPLES,
        noise=Silence(),
    )
    return recording_of(frame, rig=described(rig))


def noisy(recording: Recording, seed: int, noise: str = "white") -> Recording:
    """The same with noise of the rig's std."""
    size = deviations(Space.PLANE if recording.dimension == 2 else Space.SPACE)
    drawn = NOISE_MODELS[noise].draw(np.random.default_rng(seed), *recording.wrench.shape)
    return recording.with_readings(recording.wrench + drawn * size)


@cache
def fitted(space: Space, effect: str = "viscous_drag", noise: str = "white") -> Fit:
    """A fit of what is hidden."""
    hidden = TETHER if effect == "cable_spring" else DRAG
    model = base(space) + named("cable_spring" if effect == "cable_spring" else "viscous_drag")
    if effect == "sensor_lag":
        model = model + named(effect)
    return fit(model, noisy(quiet(space, hidden, 1, 6), 1, noise))


@cache
def _monitor(space: Space, effect: str, noise: str) -> Monitor:
    return Monitor(fitted(space, effect, noise), longest_contact=CONTACT)


def monitor_of(space: Space, effect: str = "viscous_drag", noise: str = "white") -> Monitor:
    """One that has seen no sample."""
    monitor = copy(_monitor(space, effect, noise))
    monitor.restart()
    return monitor


# ------------------------------------------------------------------------------------------ densities


def test_the_evidence_of_a_block_is_the_ratio_of_gaussian_densities() -> None:
    """Of three blocks in covariances: priors walk, forget and learn; the density of a block by its own covariance."""
    monitor, rng = monitor_of(Space.PLANE), np.random.default_rng(0)
    program = replace(monitor.program, gate=np.inf, refuted=-np.inf)
    filters, size, k = _Filters(program), len(program.walk), len(program.units)
    covariances = [np.linalg.inv(prior.T @ prior)[np.ix_(*[np.argsort(order)] * 2)]
                   for prior, order in zip(program.priors, program.orders, strict=True)]  # fmt: skip
    means = [np.zeros(k) for _ in covariances]
    walk = np.diag(np.concatenate([program.walk**2, np.zeros(k - size)]))
    for number in range(3):
        rows, readings = rng.normal(size=(40, k)), rng.normal(size=40)
        triangle = np.asarray(np.linalg.qr(np.column_stack([rows, readings]), mode="r"))[:-1]
        before = filters.odds.copy()
        filters.absorb(triangle, number)
        logs = []
        for j, order in enumerate(program.orders):
            # the rows of R forget, the group's, which come first, more than the others; then the zero walks, and what
            # the fit knows comes back as a further reading
            root = np.linalg.cholesky(np.linalg.inv(covariances[j][np.ix_(order, order)])).T
            root *= program.factors[j][:, None]
            forgotten = np.linalg.inv(np.linalg.inv(root.T @ root) + walk[np.ix_(order, order)])
            inverse = np.linalg.inv(forgotten + program.pull**2 * program.priors[j].T @ program.priors[j])
            mean = inverse @ forgotten @ means[j][order]
            spread = rows[:, order] @ inverse @ rows[:, order].T + np.eye(40)
            error = readings - rows[:, order] @ mean
            logs.append(-0.5 * error @ np.linalg.solve(spread, error) - 0.5 * np.linalg.slogdet(spread)[1])
            learned = np.linalg.inv(np.linalg.inv(inverse) + rows[:, order].T @ rows[:, order])
            means[j][order] = mean + learned @ rows[:, order].T @ error
            covariances[j][np.ix_(order, order)] = learned
        expected = np.array(logs[1:]) - logs[0]
        np.testing.assert_allclose(filters.odds - np.maximum(before, 0.0), expected, rtol=0, atol=1e-6)
    assert UNKNOWN**2 * np.finfo(float).eps < 1e-6  # what a covariance of unknown parameters loses


# --------------------------------------------------------------------------------------- false alarms


def levels(monitor: Monitor, recording: Recording) -> Iterator[float]:
    """Log evidence after every block; what reads on restarts the evidence by itself."""
    u = np.stack([recording.signals[name] for name in monitor.inputs])
    for first in range(0, recording.samples, monitor.program.block):
        rows = slice(first, first + monitor.program.block)
        monitor._take(*monitor._model.run(u[:, rows], recording.wrench.T[:, rows]))
        yield monitor._filters.level


def alarms(noise: str, motions: int, drift: float, expected: float) -> tuple[int, int]:
    """Blocks, and how often the evidence of a change reached that of one false alarm in `expected` blocks."""
    blocks = count = 0
    for motion in range(motions):
        monitor, run = (
            monitor_of(Space.PLANE, noise=noise),
            noisy(quiet(Space.PLANE, DRAG, 10 + motion, 12), motion, noise),
        )
        steps = np.random.default_rng(motion).normal(size=run.wrench.shape) * np.sqrt(monitor.dt / 3600)
        run = run.with_readings(run.wrench + drift * np.cumsum(steps, axis=0) * deviations(Space.PLANE))
        for level in levels(monitor, run):
            blocks += 1
            if level >= np.log(expected):
                count += 1
                monitor._filters.evidence[:] = 0.0
        assert monitor.change is None
    return blocks, count


@pytest.mark.parametrize("noise", ["white", "autoregressive"])
def test_unchanged_work_raises_no_more_alarms_than_stated(noise: str) -> None:
    """At the level of one alarm in 40 blocks, 120 blocks a motion: at most 3 a motion are expected."""
    blocks, count = alarms(noise, motions=2, drift=1.0, expected=40)
    assert blocks == 240
    assert count <= 16  # P(more) = 1e-4 of a mean of 6


@pytest.mark.long
@pytest.mark.parametrize(("noise", "drift"), [("white", 1.0), ("autoregressive", 1.0), ("pink_and_lines", 0.0)])
def test_long_unchanged_work_raises_no_more_alarms_than_stated(noise: str, drift: float) -> None:
    """With the drift of the zero that the monitor states, and noise of 1/f kind that it has to find out.

    Twelve minutes of twelve motions, at the level of one alarm in 200 blocks.
    """
    blocks, count = alarms(noise, motions=12, drift=drift, expected=200)
    assert blocks == 1440
    assert count <= 18  # P(more) = 4e-4 of a mean of 7.2


# ------------------------------------------------------------------------------------------ what it finds


CHANGES = {
    "mass": ("viscous_drag", (*DRAG, PayloadChange(mass=0.045, d=0.07, time=-1.0)), 2, {"m": 0.045, "mlg": 0.00315}),
    "bias": ("viscous_drag", DRAG, 2, {"bias_fx": 0.0, "bias_fy": 0.0, "bias_tau": 0.06}),
    "cable_spring": ("cable_spring", (), 1, {"cable_spring.k": -8.0}),
}
"""A tool that is 5 % heavier (0.9 kg), a zero that steps by 5 std, a cable that comes loose: model, what there is then,
motion, and by how much the parameters change."""


@pytest.mark.parametrize("group", CHANGES)
def test_a_change_is_found_named_and_sized(group: str) -> None:
    """No earlier than the longest contact after it, no later than four times that; the interval holds its time.

    The tether is taut in half of each period. The estimates deviate by 4.5 std at most, and the sizes by 10 %, or what
    is nothing by 0.1 N.
    """
    effect, hidden, motion, amounts = CHANGES[group]
    known = TETHER if effect == "cable_spring" else DRAG
    monitor = monitor_of(Space.PLANE, effect)
    monitor.watch(noisy(quiet(Space.PLANE, known, motion, 6), 2))
    changed = monitor.time
    assert monitor.change is None
    after = noisy(quiet(Space.PLANE, hidden, motion, 5), 3)
    if group == "bias":
        after = after.with_readings(after.wrench + 5 * deviations(Space.PLANE) * [0, 0, 1])
    change = monitor.watch(after).change
    assert change is not None
    assert (change.group, change.others) == (group, ())
    assert change.start <= changed <= change.end
    assert changed + CONTACT <= change.stated <= changed + 4 * CONTACT
    for name, amount in amounts.items():
        found = change.by[name]
        assert abs(found.value - amount) <= DEVIATIONS * found.std
        assert abs(found.value - amount) <= 0.1 * abs(amount) + (0.1 if amount == 0 else 0.0)
    assert str(monitor).startswith("changed between")
    assert f"looks like {group}, " in str(monitor)
    assert str(monitor).endswith("; or a contact of more than 5 s")


def pushed(recording: Recording, first: int, seconds: float) -> Recording:
    """A contact of 20 std, which is not constant."""
    wrench, rows = recording.wrench.copy(), round(seconds / (recording.dt or 1.0))
    size = deviations(Space.PLANE if recording.dimension == 2 else Space.SPACE)
    force = 20 * size * (1 + 0.3 * np.sin(np.arange(rows) / 30))[:, None]
    wrench[first : first + rows] += force
    return recording.with_readings(wrench)


def test_contacts_are_no_change_and_leave_the_zero_alone() -> None:
    """Of 90 % of the longest, one after another with as much time between them; one of three times that is a change."""
    monitor, run = monitor_of(Space.PLANE), noisy(quiet(Space.PLANE, DRAG, 2, 12), 4)
    contacts = run
    for first in (500, 1000, 1500, 2000, 2500):
        contacts = pushed(contacts, first, 0.9 * CONTACT)
    monitor.watch(contacts)
    assert monitor.change is None
    truth = np.array(SIMULATED[Space.PLANE].bias)
    for estimate, bias in zip(monitor.bias.values(), truth, strict=True):
        assert abs(estimate.value - bias) <= DEVIATIONS * estimate.std
    assert monitor.watch(pushed(run, 500, 3 * CONTACT)).change is not None
    monitor.restart()
    assert monitor.change is None
    assert monitor.time == 0.0


def test_a_drifting_zero_is_followed() -> None:
    """By 0.4 std in a minute, 24 times what it walks in an hour: within 4.5 std of the mean of its last seconds."""
    monitor, run = monitor_of(Space.PLANE), noisy(quiet(Space.PLANE, DRAG, 2, 12), 5)
    ramp = np.linspace(0.0, 0.4, run.samples)[:, None] * deviations(Space.PLANE)
    monitor.watch(run.with_readings(run.wrench + ramp))
    assert monitor.change is None
    for estimate, size in zip(monitor.drift.values(), deviations(Space.PLANE), strict=True):
        assert abs(estimate.value - 0.4 * size) <= DEVIATIONS * estimate.std
        assert estimate.value >= 0.2 * size
    assert abs(monitor.tool["m"].value - 0.9) <= DEVIATIONS * monitor.tool["m"].std


# --------------------------------------------------------------------------------------- sample by sample


def test_samples_one_by_one_are_a_recording_and_give_the_contact() -> None:
    """By name or in order; gaps restart the whitening, and are said by a contact of NaN."""
    run, one, whole = noisy(quiet(Space.PLANE, DRAG, 2, 3), 6), monitor_of(Space.PLANE), monitor_of(Space.PLANE)
    size = deviations(Space.PLANE)
    wrench = run.wrench.copy()
    wrench[-1] += 50 * size
    run = run.with_readings(wrench)
    u = np.stack([run.signals[name] for name in one.inputs], axis=1)
    contacts = [one.update(row, reading) for row, reading in zip(u, run.wrench, strict=True)]
    whole.watch(run)
    np.testing.assert_allclose(one._filters.states, whole._filters.states, rtol=0, atol=1e-12)
    assert one.time == whole.time == run.samples * one.dt
    expected = np.array([-1, 1, -1]) * 50 * size  # readings on_tool in the plane: (-1, +1, -1) times the residual
    assert np.abs(contacts[-1] - expected).max() <= 7 * size.max()
    assert np.isnan(one.update(dict(zip(one.inputs, u[0], strict=True)), [np.nan, 0.0, 0.0])).all()
    assert np.isfinite(one.update(u[0], run.wrench[0])).all()


def test_bad_input_is_one_sentence() -> None:
    known = fitted(Space.PLANE)
    monitor = monitor_of(Space.PLANE)
    short = quiet(Space.PLANE, DRAG, 2, 1)
    assert str(monitor) == "no whole block of readings yet"
    for attempt, said in (
        (lambda: Monitor(ModelFile.of(known)), "give a recording of ordinary work"),
        (lambda: Monitor(known, noisy(short, 1)), "too short for the noise"),
        (lambda: Monitor(known, longest_contact=0.0), "positive"),
        (lambda: Monitor(replace(CalibratedModel.of(known), floor=np.zeros(3)), short), "without noise"),
        (lambda: Monitor(known, drift={"fz": 1.0}), "no drift of 'fz'"),
        (lambda: Monitor(known, drift={"fx": "much"}), "no drift of 'fx'"),  # type: ignore[dict-item]
        (lambda: Monitor(known, drift=0.1), "a float is no drift by channel"),  # type: ignore[arg-type]
        (lambda: Monitor(known, longest_contact="10 s"), "'10 s'; give a positive number"),  # type: ignore[arg-type]
        (lambda: Monitor(known, quiet(Space.SPACE, DRAG, 1, 2)), "channels"),
        (lambda: Monitor("model.json"), "no fitted model"),
        (lambda: monitor.update({"phi": 0.0}, [0, 0, 0]), "without ax"),
        (lambda: monitor.update([0.0], [0, 0, 0]), "1 signals"),
        (lambda: monitor.watch(known), "Fit"),  # type: ignore[arg-type]
        (lambda: emit(fitted(Space.PLANE, noise="autoregressive"), "c", monitor=monitor), "another model"),
        (lambda: emit(known, "c", rate=1000.0, monitor=monitor), "50 samples a second"),
        (lambda: emit(known, "numpy", monitor=monitor), "not written as numpy"),
        (lambda: emit("planar", "c", monitor=monitor), "base model"),
    ):
        with pytest.raises(InputError, match=said):
            attempt()


# ------------------------------------------------------------------------------------------------- in C


MAIN = """
#include "monitor.c"
#include <stdio.h>

int main(void)
{
    static truewrench_monitor monitor;
    double u[TRUEWRENCH_INPUTS], reading[TRUEWRENCH_CHANNELS];
    double value[TRUEWRENCH_PARAMETERS], std[TRUEWRENCH_PARAMETERS];
    int f;
    truewrench_monitor_init(&monitor);
    while (fread(u, sizeof u, 1, stdin) == 1 && fread(reading, sizeof reading, 1, stdin) == 1) {
        const double changed = truewrench_monitor_update(&monitor, u, reading, reading);
        fwrite(reading, sizeof reading, 1, stdout);
        fwrite(&changed, sizeof changed, 1, stdout);
        fwrite(&monitor.level, sizeof monitor.level, 1, stdout);
        fwrite(monitor.bias, sizeof monitor.bias, 1, stdout);
    }
    for (f = 0; f <= TRUEWRENCH_GROUPS; ++f) {
        truewrench_monitor_estimate(&monitor, f, value, std);
        fwrite(value, sizeof value, 1, stdout);
        fwrite(std, sizeof std, 1, stdout);
    }
    fwrite(&monitor.start, sizeof(double), 2, stdout);
    return 0;
}
"""


CASES = {
    "planar": (Space.PLANE, "viscous_drag", "autoregressive"),
    "lag": (Space.PLANE, "sensor_lag", "white"),
    "six axes": (Space.SPACE, "viscous_drag", "autoregressive"),
}


@pytest.mark.parametrize(
    "case", ["planar", *(pytest.param(name, marks=pytest.mark.long) for name in CASES if name != "planar")]
)
def test_c_does_the_same_and_its_sanitizers_say_nothing(case: str, tmp_path: Path) -> None:
    """Over ordinary work, a gap, a contact and a change: to 1e-12 of the largest reading, estimate and evidence."""
    space, effect, noise = CASES[case]
    monitor, size = monitor_of(space, effect, noise), deviations(space)
    run = pushed(noisy(quiet(space, DRAG, 2, 6), 7, noise), 400, 0.8 * CONTACT)
    wrench = run.wrench.copy()
    wrench[800:] += 12 * size * np.eye(len(size))[0]
    wrench[300] = np.nan
    u = np.stack([run.signals[name] for name in monitor.inputs], axis=1)
    (tmp_path / "monitor.c").write_text(
        CTarget(monitor.program).model(monitor.program.fitted, "test"), encoding="ascii"
    )
    (tmp_path / "main.c").write_text(MAIN, encoding="ascii")
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O1"]
    subprocess.run(["cc", *FLAGS, *sanitizers, "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run(
        [tmp_path / "main"], input=np.column_stack([u, wrench]).tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    numbers, p = np.frombuffer(done.stdout), len(size)
    samples = numbers[: run.samples * (2 * p + 2)].reshape(run.samples, -1)
    expected = np.empty_like(samples)
    for i, (row, reading) in enumerate(zip(u, wrench, strict=True)):
        contact = monitor.update(row, reading)
        changed = 0 if monitor.change is None else 1 + monitor.program.groups.index(monitor.change.group)
        expected[i] = [*contact, changed, monitor._filters.level, *monitor._filters.bias[0]]
    scale = np.array(
        [*[np.nanmax(np.abs(wrench))] * p, 1.0, np.abs(expected[:, p + 1]).max(), *[np.nanmax(np.abs(wrench))] * p]
    )
    np.testing.assert_allclose(samples / scale, expected / scale, rtol=0, atol=1e-12)
    assert monitor.change is not None
    assert monitor.change.group == "bias"
    rest = numbers[samples.size :]
    for number, (value, std) in enumerate(rest[:-2].reshape(-1, 2, len(monitor.program.units))):
        by_python, spread = monitor._filters.estimate(number)
        np.testing.assert_allclose(std, spread, rtol=1e-12)
        assert (np.abs(value - by_python) <= 1e-12 * (np.abs(by_python) + spread)).all()
    assert rest[-2] <= monitor.change.end
    assert rest[-1] == monitor.change.stated


def test_the_command_writes_what_python_does(tmp_path: Path) -> None:
    run = noisy(quiet(Space.PLANE, DRAG, 1, 6), 1)
    names = [str(tmp_path / name) for name in ("work.csv", "model.json", "code.c")]
    run.to_frame().to_csv(names[0], index=False)
    save(fitted(Space.PLANE), names[1])
    assert main(["emit", names[1], "--to", "c", "--monitor", names[0], "--out", names[2]]) == 0
    by_python = emit(
        load(names[1]), "c", monitor=Monitor(load(names[1]), read(names[0], rig=described(SIMULATED[Space.PLANE])))
    )
    assert Path(names[2]).read_text() == by_python
    assert main(["emit", names[1], "--to", "urdf", "--monitor", names[0]]) == 2
    assert main(["emit", names[1], "--to", "c", "--monitor", names[1]]) == 2


def test_c_with_a_monitor_allocates_nothing_and_keeps_nothing() -> None:
    text = CTarget(monitor_of(Space.PLANE).program).model(monitor_of(Space.PLANE).program.fitted, "test")
    assert not any(word in text for word in ("malloc", "calloc", "alloca", "free("))
    assert all("const" in line or "(" in line for line in text.splitlines() if line.lstrip().startswith("static "))
