"""What every family of motions keeps: linear, its own derivatives, its period, its rest, and bounds between samples."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import design.trajectories
from design.trajectories.fourier import FreeSeries, PaperSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import Array, Trajectory, TrajectorySeries
from modeling.errors import InputError

FREE = FreeSeries(joints=3, harmonics=(1, 2, 5), period=4.0)
CENTRED = FreeSeries(joints=2, harmonics=(2, 3), period=0.7, offset=False)
PAPER = PaperSeries(joints=2, period=5.0)
SPLINE = SplineSeries(joints=3, knots=12, period=4.0)
STEPS = SplineSeries(joints=2, knots=8, degree=2, period=2.0)
CUBIC = SplineSeries(joints=2, knots=7, degree=3, period=2.0)
ROUGH = SplineSeries(joints=1, knots=9, degree=4, period=2.0)
CASES: tuple[TrajectorySeries, ...] = (
    FREE,
    CENTRED,
    PAPER,
    SPLINE,
    ROUGH,
    CUBIC,
    STEPS,
    RestToRest(inner=FREE, ramp=0.5),
    RestToRest(inner=PAPER, ramp=2.5),
    RestToRest(inner=ROUGH, ramp=0.3),
    RestToRest(inner=CUBIC, ramp=0.9),
    RestToRest(inner=STEPS, ramp=0.9),
)
OFFSETS = tuple(case for case in CASES if case not in (CENTRED, PAPER))
every_case = pytest.mark.parametrize("series", CASES, ids=repr)
orders = pytest.mark.parametrize("order", range(4))


def descendants(kind: type[object]) -> set[type[object]]:
    return {kind}.union(*(descendants(child) for child in kind.__subclasses__()))


def coefficients(series: TrajectorySeries, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal(series.size)


def times(series: TrajectorySeries, count: int = 97) -> Array:
    """Instants that are no multiple of anything, seeded."""
    return np.sort(np.random.default_rng(1).uniform(0, series.duration, count))


def dense(series: TrajectorySeries) -> Array:
    """Fine, with all breaks, where a derivative may have a corner or a jump, and both sides of them."""
    sides = np.concatenate([series.breaks + side for side in (-1e-9, 0, 1e-9)])
    return np.union1d(np.linspace(0, series.duration, 20_001), sides)


def test_every_series_has_a_case() -> None:
    for module in pkgutil.iter_modules(design.trajectories.__path__, "design.trajectories."):
        importlib.import_module(module.name)
    concrete = {kind for kind in descendants(TrajectorySeries) if not inspect.isabstract(kind)}
    assert concrete == {type(case) for case in CASES}


@every_case
@orders
def test_basis_is_what_evaluate_multiplies(series: TrajectorySeries, order: int) -> None:
    time, z = times(series), coefficients(series)
    basis = series.basis(time, order)
    assert basis.shape == (97, series.joints, series.size)
    # two orders of summation: rounding only, relative to the largest term
    np.testing.assert_allclose(series.evaluate(z, time, order), basis @ z, atol=1e-12 * np.abs(basis).max())


@every_case
def test_no_coefficient_is_idle(series: TrajectorySeries) -> None:
    basis = series.basis(series.instants(8 * series.size), 0).reshape(-1, series.size)
    assert np.linalg.matrix_rank(basis) == series.size


@every_case
@pytest.mark.parametrize("order", range(3))
def test_each_order_is_the_derivative_of_the_one_before(series: TrajectorySeries, order: int) -> None:
    z, step = coefficients(series), 1e-5 * series.duration
    time = times(series)
    time = time[np.abs(time[:, None] - series.breaks).min(axis=1) > step]  # a corner has no slope
    ahead, behind = (series.evaluate(z, time + side * step, order) for side in (1, -1))
    exact = series.evaluate(z, time, order + 1)
    # relative to the largest: truncation (w h)²/6 < 1e-6 for w < 60 / s and h = 4e-5 s, rounding 2e-16 / (w h) < 1e-10
    np.testing.assert_allclose((ahead - behind) / (2 * step), exact, atol=2e-6 * np.abs(exact).max())


@every_case
@orders
def test_motion_comes_again_after_its_duration(series: TrajectorySeries, order: int) -> None:
    z, time = coefficients(series), times(series)
    now, later = (series.evaluate(z, time + n * series.duration, order) for n in (0, 1))
    np.testing.assert_allclose(now, later, atol=1e-10 * np.abs(now).max())  # rounding of the time, h³ w³ larger


@pytest.mark.parametrize("series", OFFSETS, ids=repr)
def test_rest_stands_still_at_the_posture(series: TrajectorySeries) -> None:
    posture = np.arange(1.0, 1.0 + series.joints)
    still, time = series.rest(posture), times(series)
    np.testing.assert_allclose(series.evaluate(still, time, 0), np.tile(posture, (97, 1)), atol=1e-12)
    for order in (1, 2, 3):
        scale = np.abs(series.basis(time, order)).max()
        np.testing.assert_allclose(series.evaluate(still, time, order), 0, atol=1e-13 * scale)  # rounding of 1 in 3


@pytest.mark.parametrize("series", [CENTRED, PAPER], ids=repr)
def test_without_an_offset_rest_is_at_zero(series: TrajectorySeries) -> None:
    assert np.array_equal(series.rest(np.ones(series.joints)), np.zeros(series.size))


@every_case
def test_instants_are_one_period_or_from_end_to_end(series: TrajectorySeries) -> None:
    time = series.instants(10)
    assert len(time) == 10
    np.testing.assert_allclose(np.diff(time), series.duration / (10 if series.periodic else 9))
    assert time[0] == 0


# ------------------------------------------------------------------------------- bounds between samples


@every_case
@orders
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 1e3))
def test_no_instant_leaves_the_enclosure(series: TrajectorySeries, order: int, seed: int, scale: float) -> None:
    z = scale * coefficients(series, seed)
    low, high = series.enclosure(z, order)
    time = np.random.default_rng(seed).uniform(0, series.duration, 500)
    values = series.evaluate(z, np.union1d(time, np.concatenate([series.breaks + s for s in (-1e-9, 0, 1e-9)])), order)
    rounding = 1e-12 * np.abs(values).max()
    assert (values >= low - rounding).all()
    assert (values <= high + rounding).all()


@every_case
@orders
def test_enclosure_is_tight(series: TrajectorySeries, order: int) -> None:
    z = coefficients(series, 5)
    low, high = series.enclosure(z, order)
    values = series.evaluate(z, dense(series), order)
    least, most = values.min(axis=0), values.max(axis=0)
    # 1e-4 promised; the dense grid itself misses (w h)²/8 = 2e-5 at most
    assert (np.maximum(least - low, high - most) <= 1.2e-4 * (most - least) / 2).all()


@every_case
def test_enclosure_of_rest_is_the_posture(series: TrajectorySeries) -> None:
    still = series.rest(np.full(series.joints, 0.7))
    reached = series.evaluate(still, np.zeros(1), 0)[0]
    np.testing.assert_allclose(series.enclosure(still, 0), np.tile(reached, (2, 1)), atol=1e-12)  # rounding


# ------------------------------------------------------------------------------------------ members


def test_spline_is_the_periodic_interpolant_of_scipy() -> None:
    from scipy.interpolate import make_interp_spline

    values = np.random.default_rng(2).standard_normal(SPLINE.knots)
    theirs = make_interp_spline(SPLINE.breaks, [*values, values[0]], k=SPLINE.degree, bc_type="periodic")
    series = SplineSeries(joints=1, knots=SPLINE.knots, period=SPLINE.period)
    ours = np.asarray(np.linalg.solve(series.basis(SPLINE.breaks[:-1], 0)[:, 0], values), dtype=float)
    time = times(series)
    for order in range(4):
        reference = np.asarray(theirs(time, nu=order), dtype=float)
        rounding = 1e-9 * np.abs(reference).max()  # two linear systems with a condition number below 1e3
        np.testing.assert_allclose(series.evaluate(ours, time, order)[:, 0], reference, atol=rounding)


@orders
def test_spline_enclosure_holds_the_exact_extremes(order: int) -> None:
    from scipy.interpolate import PPoly

    z = coefficients(ROUGH, 3)
    low, high = ROUGH.enclosure(z, order)
    spacing = ROUGH.period / ROUGH.knots
    along = np.asarray(np.arange(-ROUGH.degree, ROUGH.knots + ROUGH.degree + 1) * spacing, dtype=float)
    pieces = PPoly.from_spline((along, np.tile(z, 2)[: ROUGH.knots + ROUGH.degree], ROUGH.degree))
    wanted = pieces.derivative(order)
    stationary = wanted.derivative().roots(extrapolate=False)
    inside = stationary[(stationary > 0) & (stationary < ROUGH.period)]
    reached = wanted(np.concatenate([inside, ROUGH.breaks[:-1]]))
    half = np.ptp(reached) / 2
    assert -1e-9 * half <= reached.min() - low[0] <= 1e-4 * half
    assert -1e-9 * half <= high[0] - reached.max() <= 1e-4 * half


@pytest.mark.parametrize("inner", [FREE, PAPER, ROUGH, CUBIC], ids=repr)
def test_rest_to_rest_is_still_at_both_ends_and_the_inner_motion_between(inner: TrajectorySeries) -> None:
    series = RestToRest(inner=inner, ramp=0.3)
    z, ends = coefficients(series), np.array([0.0, series.duration])
    posture, own = z[: inner.joints], z[inner.joints :]
    np.testing.assert_array_equal(series.evaluate(z, ends, 0), np.tile(posture, (2, 1)))
    for order in (1, 2, 3):
        np.testing.assert_array_equal(series.evaluate(z, ends, order), 0.0)
    between = np.linspace(0.3, series.duration - 0.3, 50)
    for order in range(4):
        expected = inner.evaluate(own, between, order) + (posture if order == 0 else 0.0)
        np.testing.assert_allclose(series.evaluate(z, between, order), expected, atol=1e-10 * np.abs(expected).max())


def test_projection_keeps_a_motion_that_the_other_series_has_too() -> None:
    motion = Trajectory(PAPER, coefficients(PAPER))
    rich = FreeSeries(joints=2, harmonics=(1, 2, 3, 4, 5, 6, 7), period=5.0)
    time = times(PAPER)
    np.testing.assert_allclose(motion.projected(rich).evaluate(time)[0], motion.evaluate(time)[0], atol=1e-12)
    back = motion.projected(rich).projected(PAPER)
    np.testing.assert_allclose(back.coefficients, motion.coefficients, atol=1e-12)
    with pytest.raises(InputError, match="a series of 2 joints was expected, and of 3 came"):
        motion.projected(FREE)


def test_motion_checks_its_coefficients_and_keeps_them() -> None:
    z = np.ones(FREE.size)
    motion = Trajectory(FREE, z)
    z[:] = 2.0
    assert (motion.coefficients == 1.0).all()
    assert not motion.coefficients.flags.writeable
    with pytest.raises(InputError, match="21 coefficients were expected"):
        Trajectory(FREE, np.ones(20))


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, np.inf])
def test_period_has_to_be_positive(period: float) -> None:
    for kind in (PaperSeries, lambda period: SplineSeries(joints=1, knots=9, period=period)):
        with pytest.raises(InputError, match="positive period"):
            kind(period=period)
    with pytest.raises(InputError, match="positive period"):
        FreeSeries(joints=1, harmonics=(1,), period=period)


def test_impossible_series_are_refused() -> None:
    for harmonics in ((), (0, 1), (1, 1)):
        with pytest.raises(InputError, match="harmonics"):
            FreeSeries(joints=1, harmonics=harmonics, period=1.0)
    with pytest.raises(InputError, match="degree"):
        SplineSeries(joints=1, knots=12, degree=1, period=1.0)
    with pytest.raises(InputError, match="knots"):
        SplineSeries(joints=1, knots=5, period=1.0)
    with pytest.raises(InputError, match="ramp"):
        RestToRest(inner=FREE, ramp=2.1)
    with pytest.raises(InputError, match="periodic"):
        RestToRest(inner=RestToRest(inner=FREE, ramp=1.0), ramp=1.0)
