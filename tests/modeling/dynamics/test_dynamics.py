"""Play and the bend: against fine grids, hysteresis loops, integrators and a balance of angular momentum."""

from __future__ import annotations

from functools import cache
from math import inf

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from modeling.chain.model import planar
from modeling.chain.prediction import DeflectedLoad
from modeling.dynamics.deflection_solver import solve_deflection
from modeling.dynamics.discrete_deflection import DiscreteDeflection, deflected
from modeling.dynamics.motion_record import TimeBase
from modeling.dynamics.play import PlayResponse
from modeling.dynamics.sample_program import SampleProgramBuilder
from modeling.effects.geometry import TipFlexibility
from modeling.errors import InputError
from modeling.space import signals
from tests.shared.deflection_cases import (
    INERTIA,
    MOMENT,
    PERIOD,
    SPATIAL,
    TOOL,
    Array,
    bent,
    grid,
    integrated,
    rated,
    solved,
    spin,
    three_axes,
    torque,
    turn,
    vector,
)
from tests.shared.emitted import sampled

WIDTHS = np.array([0.6, 1.5, 3.0])


# ------------------------------------------------------------------------------------------------------------- play


def load(samples: int) -> Array:
    """Three channels of eight harmonics each."""
    amplitudes = np.random.default_rng(0).normal(size=(2, 8, 3))
    angles = 2 * np.pi * np.outer(np.arange(samples) / samples, np.arange(1, 9))
    return np.asarray(np.cos(angles) @ amplitudes[0] + np.sin(angles) @ amplitudes[1], dtype=np.float64)


def pushed(series: Array, width: Array, start: Array) -> Array:
    """Play as it is told to a child: the reading stays, unless the load would be farther away than the width."""
    reading, readings = start, []
    for sample in series:
        reading = np.clip(reading, sample - width, sample + width)
        readings.append(reading)
    return np.array(readings)


@cache
def followed(periodic: bool) -> Array:
    """The play on a grid so fine that nothing turns between its points."""
    fine = load(20_000)
    start = pushed(fine, WIDTHS, fine[0])[-1] if periodic else fine[0]
    return pushed(fine, WIDTHS, start)


@pytest.mark.parametrize("periodic", [True, False])
def test_play_between_samples(periodic: bool) -> None:
    errors = []
    for samples in (200, 400):
        played = PlayResponse.of(load(samples), WIDTHS, periodic=periodic)
        errors.append(np.max(np.abs(played.reading - followed(periodic)[:: 20_000 // samples])))
    # The fine grid is wrong by the eighth of a second difference, (8 · 2 pi / 20000)² · 10 / 8 = 8e-6, at most.
    assert errors[1] < 1e-5
    # Five samples through each turning point: 2^5, less what the fine grid itself is wrong.
    assert errors[0] < 1e-4
    by_sample = PlayResponse.of(load(400), WIDTHS, periodic=periodic, smooth=False).reading
    assert np.max(np.abs(by_sample - followed(periodic)[::50])) > 100 * errors[1]


def test_play_of_poses_is_that_of_a_loop() -> None:
    poses = np.random.default_rng(1).normal(size=(200, 3))
    played = PlayResponse.of(poses, WIDTHS / 2, periodic=False, smooth=False)
    np.testing.assert_allclose(played.reading, pushed(poses, WIDTHS / 2, poses[0]), atol=1e-14)


def test_a_loop_is_a_parallelogram() -> None:
    swing, width = 2.0, np.array([0.5])
    cycle = swing * np.cos(2 * np.pi * np.arange(2000) / 2000)[:, None]
    x, y = cycle[:, 0], PlayResponse.of(cycle, width, periodic=True).reading[:, 0]
    area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
    # 2 w wide and 2 (swing - w) high; the polygon cuts its arcs and corners by O(h), 2 pi swing / 2000.
    assert abs(area) == pytest.approx(4 * width[0] * (swing - width[0]), rel=0.01)
    assert np.max(y) == pytest.approx(swing - width[0], abs=1e-12)


def test_a_minor_loop_closes_and_is_forgotten() -> None:
    there = [np.linspace(a, b, 40, endpoint=False) for a, b in [(0, 4), (4, 1), (1, 3), (3, 1), (1, -3)]]
    series = np.concatenate(there)[:, None]
    direct = np.concatenate([there[0], there[1], there[4]])[:, None]
    width = np.array([0.7])
    with_loop, without = (
        PlayResponse.of(s, width, periodic=False, smooth=False).reading[:, 0] for s in (series, direct)
    )
    assert with_loop[80] == pytest.approx(with_loop[160], abs=1e-12)
    np.testing.assert_allclose(with_loop[160:], without[80:], atol=1e-12)


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("smooth", [True, False])
def test_derivatives_of_play(periodic: bool, smooth: bool) -> None:
    series, step = load(150), 1e-6
    change = np.random.default_rng(2).normal(size=(150, 3))

    def read(share: float, wider: float) -> Array:
        return PlayResponse.of(series + share * change, WIDTHS + wider, periodic=periodic, smooth=smooth).reading

    played = PlayResponse.of(series, WIDTHS, periodic=periodic, smooth=smooth)
    both = played.through(np.stack([change, series], axis=2))
    # Central differences: rounding 1e-16 · 10 / 1e-6, and no sample of this series is at a kink.
    np.testing.assert_allclose(both[:, :, 0], (read(step, 0) - read(-step, 0)) / (2 * step), atol=2e-8)
    np.testing.assert_allclose(played.by_width, (read(0, step) - read(0, -step)) / (2 * step), atol=2e-8)
    # Play is homogeneous of degree one in load and width together (Euler).
    np.testing.assert_allclose(both[:, :, 1] + played.by_width * WIDTHS, played.reading, atol=1e-12)


@pytest.mark.parametrize("smooth", [True, False])
def test_play_begins_with_what_was_measured(smooth: bool) -> None:
    """Anywhere within the play; the load has no say in it until it pushes. Readings beyond the play are none of it."""
    series = load(400)
    start = series[0] + WIDTHS * [0.5, -0.7, 0.2]
    measured = pushed(series, WIDTHS, start)
    played = PlayResponse.of(series, WIDTHS, periodic=False, smooth=smooth, measured=measured)
    held = np.logical_and.accumulate(np.abs(series - start) <= WIDTHS)
    np.testing.assert_allclose(played.reading[held], measured[held], atol=1e-14)
    np.testing.assert_allclose(played.reading, measured, atol=0.01)  # turning points are between samples
    assert not played.through(series)[held].any()
    np.testing.assert_array_equal(played.measured, held)
    beyond = PlayResponse.of(series, WIDTHS, periodic=False, smooth=False, measured=series + 2 * WIDTHS)
    np.testing.assert_allclose(beyond.reading, pushed(series, WIDTHS, series[0] + WIDTHS), atol=1e-14)
    assert not beyond.measured.any()


def test_no_width_is_no_play() -> None:
    series = load(300)
    played = PlayResponse.of(series, np.zeros(3), periodic=True)
    np.testing.assert_array_equal(played.reading, series)
    np.testing.assert_array_equal(played.through(series), series)
    falls = np.sign(np.roll(series, 1, axis=0) - series)
    # A sample next to a turning point is reached from the turning point, and so may lie on its other side.
    assert np.mean(played.by_width == falls) > 0.9
    narrow = PlayResponse.of(series, np.full(3, 1e-9), periodic=True)
    np.testing.assert_array_equal(played.by_width, narrow.by_width)


@pytest.mark.parametrize("width", [0.0, 0.4, 2.0, 50.0])
def test_of_noise_each_sample_is_followed(width: float) -> None:
    """Between turning points that all push, that partly do, and none of which does."""
    noise = np.random.default_rng(5).normal(size=(500, 2))
    widths = np.array([width, 0.0])
    played = PlayResponse.of(noise, widths, periodic=False, smooth=False)
    np.testing.assert_allclose(played.reading, pushed(noise, widths, noise[0]), atol=1e-14)


def test_what_is_never_pushed_stays_where_it_began() -> None:
    series = load(100)
    played = PlayResponse.of(series, np.full(3, 1e3), periodic=False)
    np.testing.assert_array_equal(played.reading, np.tile(series[0], (100, 1)))
    np.testing.assert_array_equal(played.through(series), played.reading)
    assert not played.by_width.any()


def test_a_standstill_does_not_overshoot() -> None:
    series = np.concatenate([np.arange(10.0), np.full(5, 9.0), np.arange(9.0, -10.0, -1.0)])[:, None]
    played = PlayResponse.of(series, np.array([1.0]), periodic=False)
    assert np.max(played.reading) == 8.0


def test_a_negative_width_is_refused() -> None:
    with pytest.raises(InputError, match=r"half-width -0\.1 is negative"):
        PlayResponse.of(load(20), np.array([0.1, -0.1, 0.0]), periodic=True)


# ------------------------------------------------------------------------------------------------- the bend, planar


def orbit(stiffness: float, damping: float, times: Array) -> Array:
    """The motion that repeats, by shooting: the chord method for the state that comes back after a period."""

    def after(x: Array) -> Array:
        return np.asarray(integrated(stiffness, damping, x, np.array([PERIOD]))[-1], dtype=np.float64)

    start = np.zeros(2)
    slope = np.stack([(after(1e-3 * e) - after(start)) / 1e-3 for e in np.eye(2)], axis=1)
    change = np.ones(2)
    while np.max(np.abs(change)) > 1e-9:
        change[:] = np.linalg.solve(np.eye(2) - slope, after(start) - start)
        start = start + change
    return integrated(stiffness, damping, start, times)


# Damping ratios 0.02, 0.46 and none, at a fourteenth of the frequency of the first; then a tool that sags by 0.15 rad.
SPRINGS = [(60.0, 0.05), (60.0, 1.0), (60.0, 0.0), (10.0, 0.05)]


@pytest.mark.parametrize(("stiffness", "damping"), SPRINGS)
def test_a_motion_that_repeats(stiffness: float, damping: float) -> None:
    times, dt = grid(128)
    found = solved(TOOL | {"stiffness": stiffness, "damping": damping}, times, TimeBase(dt, True)).values
    expected = orbit(stiffness, damping, times)
    # The integrator's tolerance over a period, a hundred times at a resonance; the series is band limited.
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-8 * np.abs(expected).max())


def at_first(stiffness: float) -> float:
    return float(brentq(lambda b: stiffness * b + torque(0.0, b), -1.0, 1.0, xtol=1e-14))


@pytest.mark.parametrize(("stiffness", "damping"), SPRINGS[1:])
def test_from_rest(stiffness: float, damping: float) -> None:
    values = TOOL | {"stiffness": stiffness, "damping": damping}
    expected = integrated(stiffness, damping, np.array([at_first(stiffness), 0.0]), grid(800, PERIOD / 2)[0])
    errors = []
    for every in (4, 2):
        found = solved(values, grid(800, PERIOD / 2)[0][::every], TimeBase(every * PERIOD / 1600, False)).values
        errors.append(np.max(np.abs(found[:, :2] - expected[::every]) / np.abs(expected).max(axis=0)))
    # A cubic spline through the drive: fourth order in the angle, third in the rate at the ends.
    assert errors[0] < 1e-5
    assert errors[1] < errors[0] / 6


@pytest.mark.parametrize(
    "clock", [TimeBase(PERIOD / 96, True), TimeBase(PERIOD / 96, False), TimeBase(None, False)], ids=str
)
@pytest.mark.parametrize("stiffness", [60.0, 600.0])  # the second rings faster than the samples come
def test_sensitivities_of_the_bend(clock: TimeBase, stiffness: float) -> None:
    times, _ = grid(96)
    values = TOOL | {"stiffness": stiffness, "damping": 0.3}
    slopes = solved(values, times, clock, derivative=True).slopes
    names = [symbol.name.removeprefix("tip_flexibility.") for symbol in bent("plane").load.parameters]
    for name, value in values.items():
        step = 1e-4 * value
        ends = [solved(values | {name: value + side * step}, times, clock).values for side in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        # Curvature over a step of 1e-4 of the value, a hundred times at a resonance, and rounding 1e-12 / 1e-4.
        np.testing.assert_allclose(slopes[:, :, names.index(name)], expected, atol=1e-6 * np.abs(expected).max() + 1e-9)


def test_a_stiff_mount_is_a_rigid_one() -> None:
    times, dt = grid(64)
    rigid = np.array([torque(t, 0.0) for t in times])
    for clock in (TimeBase(dt, True), TimeBase(dt, False), TimeBase(None, False)):
        turned = solved(TOOL | {"stiffness": 1e7, "damping": 1.0}, times, clock).values[:, 0]
        # What is left is the share (f/f0)² of the own frequency, and torque/stiffness of the load's turn: below 1e-5.
        np.testing.assert_allclose(turned, -rigid / 1e7, atol=1e-4 * np.abs(rigid).max() / 1e7)
        none = solved(TOOL | {"stiffness": inf, "damping": 0.0}, times, clock, derivative=True)
        assert not none.values.any()
        assert not none.slopes.any()


def test_poses_at_rest() -> None:
    times, _ = grid(20)
    found = solved(TOOL | {"stiffness": 10.0, "damping": 0.3}, times, TimeBase(None, False)).values
    expected = [brentq(lambda b, t=t: 10.0 * b + torque(t, b), -1.0, 1.0, xtol=1e-14) for t in times]
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-12)
    assert not found[:, 1:].any()


def test_a_spring_too_soft_is_refused() -> None:
    times, dt = grid(64)
    with pytest.raises(InputError, match="did not converge"):
        solved(TOOL | {"stiffness": 0.3, "damping": 0.0}, times, TimeBase(dt, True))


def test_a_negative_inertia_does_not_start_from_rest() -> None:
    times, dt = grid(64)
    with pytest.raises(InputError, match="inertia is not positive"):
        solved(TOOL | {"I": -0.02, "stiffness": 60.0}, times, TimeBase(dt, False))


def stepped(tool: DeflectedLoad, theta: Array, rows: Array, dt: float) -> Array:
    """The deflection (n, 3 d) by its program of one sample."""
    model = planar() + TipFlexibility()
    deflection = model.chain.deflection
    assert deflection is not None
    values = dict(zip((p.symbol for p in model.parameters), theta, strict=True))
    sample = SampleProgramBuilder(values, dt, model.definitions)
    discrete = DiscreteDeflection.of(tool.equation, rows.shape[1], theta, dt)
    deflected(discrete, sample, deflection, model.chain.equilibrium())
    return sampled(sample.finished(deflection.signals), signals(*tool.inputs), rows, values)


def test_one_sample_at_a_time() -> None:
    values = TOOL | {"stiffness": 60.0, "damping": 0.3}
    tool, errors = bent("plane"), []
    for samples in (200, 400):
        times, dt = grid(samples, 1.0)
        rows = tool.load.samples(turn(times), samples)
        found = stepped(tool, vector("plane", values), rows, dt)
        expected = integrated(60.0, 0.3, np.array([at_first(60.0), 0.0]), times)
        errors.append(np.max(np.abs(found[:, 0] - expected[:, 0])))
    # Second order: four times better with half the step, up to the next order.
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


# ---------------------------------------------------------------------------------------------- the bend, six axes


def test_the_angular_momentum_of_a_bent_tool() -> None:
    """About the sensor's origin, in the world: d(I W)/dt + c x (a - g) = spring and damper. By spectral derivatives."""
    times, dt = grid(129)  # odd, so that the spectrum has no line without a derivative
    signals, sensor = three_axes(times)
    tool = bent("space")
    found = solve_deflection(
        tool.equation, tool.load.samples(signals, 129), vector("space", SPATIAL), TimeBase(dt, True)
    )
    half = found.values[:, :3] / 2
    axis = half / np.linalg.norm(half, axis=1, keepdims=True)
    relative = Rotation.from_rotvec(2 * np.arctan(np.linalg.norm(half, axis=1, keepdims=True)) * axis)
    body = sensor * relative
    spinning = body.apply(spin(body))
    momentum = body.apply(body.inv().apply(spinning) @ INERTIA)
    lift = np.stack([signals["apx"], signals["apy"], signals["apz"] + 9.806], axis=1)
    needed = rated(momentum) + np.cross(body.apply(MOMENT), lift)
    held = -20.0 * sensor.apply(relative.as_rotvec()) - 0.3 * (spinning - sensor.apply(spin(sensor)))
    assert np.abs(relative.as_rotvec()).max() > 0.05
    # Spectral derivatives of rounding at 64 lines twice: 1e-16 · (100 rad/s)², of a torque of 1.
    np.testing.assert_allclose(needed, held, atol=1e-8)


def test_the_plane_in_space() -> None:
    """A tool turning about the world's y axis, with the sensor's axes x', -y' of the plane as x and y."""
    times, dt = grid(96)
    plane = turn(times)
    phi, nothing = plane["phi"], np.zeros(96)
    x_axis = np.stack([np.cos(phi), nothing, -np.sin(phi)], axis=1)
    y_axis = np.stack([-np.sin(phi), nothing, -np.cos(phi)], axis=1)
    matrices = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)], axis=2)
    quaternions = Rotation.from_matrix(matrices).as_quat()
    signals = dict.fromkeys(("wx", "wy", "alx", "aly", "apy"), nothing) | {"wz": plane["dphi"], "alz": plane["ddphi"]}
    signals |= {"apx": plane["ax"], "apz": plane["ay"]} | dict(
        zip(("qx", "qy", "qz", "qw"), quaternions.T, strict=True)
    )
    spring = {"stiffness": 10.0, "damping": 0.05}
    body = {"m": 1.5, "my": -0.15, "Ixx": 0.03, "Iyy": 0.02, "Izz": 0.02}
    tool = bent("space")
    for clock in (TimeBase(dt, True), TimeBase(dt, False), TimeBase(None, False)):
        flat = solved(TOOL | spring, times, clock).values
        found = solve_deflection(
            tool.equation, tool.load.samples(signals, 96), vector("space", body | spring), clock, derivative=False
        )
        # Up to the splines that differ by the coordinate: 2 tan(b/2) in six axes, b in the plane.
        close = 1e-9 if clock.periodic or clock.dt is None else 1e-4
        np.testing.assert_allclose(2 * np.arctan(found.values[:, 2] / 2), flat[:, 0], atol=close * 0.2)
        assert np.abs(found.values[:, :2]).max() < 1e-12


@pytest.mark.parametrize("periodic", [True, False])
def test_sensitivities_in_six_axes(periodic: bool) -> None:
    times, dt = grid(33)
    tool, clock = bent("space"), TimeBase(dt, periodic)
    rows, theta = tool.load.samples(three_axes(times)[0], 33), vector("space", SPATIAL)
    slopes = solve_deflection(tool.equation, rows, theta, clock).slopes
    direction = np.random.default_rng(3).normal(size=len(theta)) * theta

    def moved(step: float) -> Array:
        return solve_deflection(tool.equation, rows, theta + step * direction, clock, derivative=False).values

    expected = (moved(1e-5) - moved(-1e-5)) / 2e-5
    np.testing.assert_allclose(slopes @ direction, expected, atol=1e-6 * np.abs(expected).max())
