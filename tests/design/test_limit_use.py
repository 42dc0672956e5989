"""The use of limits: by hand, between samples, in the workspace; and random motions that use them up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from design.limits import LimitUse, lever_arms, tip_acceleration_bound, tip_enclosure, tip_path
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries, PaperSeries, fourier_trajectory
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import Array, Trajectory, TrajectorySeries
from modeling.errors import InputError
from modeling.kinematics.arm import Arm, PlanarArm, SpatialArm
from modeling.kinematics.placement import JointKind
from modeling.rig import Limits, Workspace
from tests.shared.rigs import ARM, spatial_arm

TIP = 0.2
LIMITS = Limits(
    position=np.array([[-1.0, 0.8], [-0.5, 1.2], [-1.4, 1.4]]),
    velocity=np.array([[-2.0, 2.0], [-2.2, 1.5], [-3.0, 3.5]]),
    acceleration=np.array([[-10.0, 10.0], [-8.0, 10.0], [-15.0, 15.0]]),
)
BOX = Workspace(x=(-1.5, 2.0), y=(0.1, 2.53))
FREE = FreeSeries(joints=3, harmonics=(1, 2, 3, 4), period=5.0)
SERIES: tuple[TrajectorySeries, ...] = (
    FREE,
    PaperSeries(period=5.0),
    SplineSeries(joints=3, knots=12, period=5.0),
    RestToRest(inner=FREE, ramp=0.8),
)
SPATIAL = ("elbow", "seven", "slide")
ARMS: tuple[Arm, ...] = (ARM, *map(spatial_arm, SPATIAL))
every_series = pytest.mark.parametrize("series", SERIES, ids=lambda series: type(series).__name__)


def wave(amplitude: float = 2.0, middle: float = 0.5, period: float = 2 * np.pi) -> Trajectory:
    """q = middle + amplitude sin(2 t) when the period is 2 pi."""
    return fourier_trajectory(offset=[middle], sine=[[0.0, amplitude]], cosine=[[0.0, 0.0]], period=period)


def limits(
    position: tuple[float, float], velocity: float, acceleration: float, jerk: tuple[float, float] | None = None
) -> Limits:
    both = np.array([-1.0, 1.0])
    return Limits(
        position=np.array([position]),
        velocity=velocity * both[None],
        acceleration=acceleration * both[None],
        jerk=None if jerk is None else np.array([jerk]),
    )


def tip_by_hand(q: Array) -> Array:
    """Equation 22.2, written out."""
    a, b, c = np.cumsum(q, axis=1).T
    return np.stack(
        [np.sin(a) + 0.97 * np.sin(b) + 0.6 * np.sin(c), np.cos(a) + 0.97 * np.cos(b) + 0.6 * np.cos(c)], axis=1
    )


def test_use_of_a_wave_by_hand() -> None:
    use = LimitUse.of(wave(), limits((-4.5, 3.5), 5.0, 10.0, jerk=(-20.0, 12.0)))
    reach = use.by_quantity
    # q from -1.5 to 2.5 in limits of middle -0.5 and half width 4; dq 4 of 5; ddq 8 of 10; jerk 16, middle -4, half 16
    expected = {"position": 3 / 4, "velocity": 4 / 5, "acceleration": 8 / 10, "jerk": 20 / 16}
    assert use.to_data() == pytest.approx(expected, rel=1e-4)  # the enclosure's width
    assert (reach["position"].side, reach["jerk"].side) == ("high", "high")
    assert use.worst is reach["jerk"]
    assert "beyond the limits: jerk of q1 uses 125.01 % of its high limit" in str(use)


def test_limits_between_the_samples_count() -> None:
    """Sixteen samples meet every zero of a wave of eight periods: they see a motion that rests."""
    motion = fourier_trajectory(offset=[0.0], sine=[[0.0] * 7 + [1.0]], cosine=[[0.0] * 8], period=1.0)
    assert np.abs(motion.derivative(motion.series.instants(16), 0)).max() < 1e-14
    use = LimitUse.of(motion, limits((-1.0, 1.0), 1e3, 1e5))
    assert 1.0 <= use.to_data()["position"] < 1.0001


def test_limits_of_another_arm_are_refused() -> None:
    with pytest.raises(InputError, match="limits of 1 joints were expected, and of 3 came"):
        LimitUse.of(wave(), LIMITS)


# ---------------------------------------------------------------------------------------- workspace


@every_series
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_tip_never_leaves_its_enclosure(series: TrajectorySeries, seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = Trajectory(series, 0.3 * rng.standard_normal(series.size))
    low, high = tip_enclosure(motion, ARM, TIP)
    tip = tip_by_hand(motion.derivative(rng.uniform(0, motion.period, 1000), 0))
    assert (tip >= low).all()
    assert (tip <= high).all()


@every_series
def test_enclosure_of_the_tip_is_tight(series: TrajectorySeries) -> None:
    motion = Trajectory(series, 0.3 * np.random.default_rng(4).standard_normal(series.size))
    low, high = tip_enclosure(motion, ARM, TIP)
    tip = tip_by_hand(motion.derivative(np.linspace(0, motion.period, 20_001), 0))
    # the margin is 2e-5 of the half range, the dense grid misses as much
    wide = np.maximum(tip.min(axis=0) - low, high - tip.max(axis=0))
    assert (wide <= 5e-5 * np.ptp(tip, axis=0) / 2).all()


@pytest.mark.parametrize("arm", ARMS, ids=["planar", *SPATIAL])
@pytest.mark.parametrize("seed", range(3))
def test_tip_never_accelerates_beyond_its_bound(arm: Arm, seed: int) -> None:
    series = FreeSeries(joints=arm.joints, harmonics=(1, 2, 3), period=5.0)
    motion = Trajectory(series, 0.3 * np.random.default_rng(seed).standard_normal(series.size))
    time, step = np.linspace(0, 5, 2001), 1e-4
    before, now, after = (tip_path(motion, arm, TIP, time + shift) for shift in (-step, 0, step))
    # the second difference is a mean of the second derivative; rounding 4 x 2e-16 m / (1e-4 s)² = 1e-7 m/s²
    acceleration = np.linalg.norm((after - 2 * now + before) / step**2, axis=1)
    bound = tip_acceleration_bound(motion, arm, TIP)
    assert acceleration.max() <= bound
    assert acceleration.max() >= bound / 50  # of use: as many metres per second squared, not thousands
    low, high = tip_enclosure(motion, arm, TIP)
    assert (now >= low).all()
    assert (now <= high).all()


@pytest.mark.parametrize("arm", ARMS, ids=["planar", *SPATIAL])
def test_levers_are_as_long_as_the_tip_can_get_from_each_joint(arm: Arm) -> None:
    """|dP/dq_j| is the tip's distance from the axis, or 1 of a slide: by differences, in 500 random postures."""
    series = FreeSeries(joints=arm.joints, harmonics=(1, 2), period=5.0)
    motion = Trajectory(series, 2.0 * np.random.default_rng(6).standard_normal(series.size))
    g, tip, step = lever_arms(motion, arm, TIP), arm.tip(TIP), 1e-6
    q = motion.derivative(np.linspace(0, 5, 500), 0).T
    moves = [np.eye(arm.joints)[:, [j]] * step for j in range(arm.joints)]
    slopes = np.array([(np.array(tip.map(500)(q + m)) - np.array(tip.map(500)(q - m))) / (2 * step) for m in moves])
    distance = np.linalg.norm(slopes, axis=1).max(axis=1)
    assert (distance <= g + 1e-8).all()  # rounding 2e-16 m / 1e-6
    assert distance[0] >= g[0] / 2  # of use for the joint that carries all


def test_bound_of_the_tip_is_reached_by_a_straight_arm_that_turns_fast() -> None:
    """One joint, whose two terms are a tenth and nine tenths of it: omega² is all there is where omega is largest."""
    motion = fourier_trajectory(offset=[0.0], sine=[[10.0]], cosine=[[0.0]], period=2 * np.pi)
    assert tip_acceleration_bound(motion, PlanarArm((1.0,)), 0.5) == pytest.approx(1.5 * (10 + 100), rel=2e-4)


def test_a_slide_is_measured_in_metres() -> None:
    slide = ARMS[1 + SPATIAL.index("slide")]
    n = slide.joints
    both = np.tile([-1.0, 1.0], (n, 1))
    series = FreeSeries(joints=n, harmonics=(1,), period=1.0)
    use = LimitUse.of(
        Trajectory(series, np.zeros(series.size)), Limits(position=both, velocity=both, acceleration=both), None, slide
    )
    assert isinstance(slide, SpatialArm)
    expected = ["m" if joint.kind is JointKind.PRISMATIC else "rad" for joint in slide.chain]
    assert [r.unit for r in use.limited_quantities if r.quantity == "position"] == expected
    assert "m/s²" in str(use)


def test_workspace_counts_the_sides_that_are_stated() -> None:
    still = Trajectory(FREE, FREE.rest([0.0, 0.0, np.pi / 2]))  # upright, the tip level: at (0.6, 1.97)
    floor = LimitUse.of(still, LIMITS, Workspace(y=(0.97, 4.97)), ARM, TIP)
    assert [r.name for r in floor.limited_quantities if r.quantity == "workspace"] == ["y"]
    assert floor.by_quantity["workspace"].use == pytest.approx(0.5, abs=1e-9)
    assert floor.by_quantity["workspace"].side == "low"
    both = LimitUse.of(still, LIMITS, Workspace(x=(-0.4, 0.5), y=(0.97, 4.97)), ARM, TIP)
    assert both.by_quantity["workspace"].name == "x"
    assert both.by_quantity["workspace"].use == pytest.approx(0.55 / 0.45, abs=1e-9)
    assert "workspace" not in LimitUse.of(still, LIMITS, Workspace()).by_quantity


def test_a_planar_arm_has_no_z() -> None:
    with pytest.raises(InputError, match="limit y, which points up"):
        LimitUse.of(Trajectory(FREE, np.zeros(FREE.size)), LIMITS, Workspace(z=(0.0, 1.0)), ARM, TIP)


@pytest.mark.parametrize(("arm", "missing"), [(None, "link_lengths or urdf"), (ARM, "tip_length")])
def test_workspace_needs_the_arm_and_its_tip(arm: PlanarArm | None, missing: str) -> None:
    with pytest.raises(InputError, match=f"state robot.{missing}"):
        LimitUse.of(Trajectory(FREE, np.zeros(FREE.size)), LIMITS, BOX, arm)


# ---------------------------------------------------------------------------- random motions that fit


@every_series
@pytest.mark.parametrize("seed", range(3))
def test_random_feasible_keeps_every_limit_and_touches_one(series: TrajectorySeries, seed: int) -> None:
    motion = random_feasible_trajectory(series, LIMITS, seed=seed)
    dense = motion.evaluate(np.linspace(0, motion.period, 5001))
    for values, pairs in zip(dense, (LIMITS.position, LIMITS.velocity, LIMITS.acceleration), strict=True):
        assert (values >= pairs[:, 0]).all()
        assert (values <= pairs[:, 1]).all()
    use = LimitUse.of(motion, LIMITS)
    assert use.worst.use == pytest.approx(1.0, abs=1e-8)
    own = [max(r.use for r in use.limited_quantities if r.name == f"q{j}") for j in (1, 2, 3)]
    if not isinstance(series, PaperSeries):
        assert own == pytest.approx([1.0] * 3, abs=1e-8)  # joints of their own are scaled each by itself


@pytest.mark.parametrize(
    "series", [SERIES[0], pytest.param(SERIES[3], marks=pytest.mark.long)], ids=["free", "rest to rest"]
)
def test_random_feasible_stays_in_the_workspace(series: TrajectorySeries) -> None:
    box = Workspace(x=(-0.5, 1.2), y=(0.1, 2.5))
    motion = random_feasible_trajectory(series, LIMITS, workspace=box, arm=ARM, tip_length=TIP, seed=2)
    x, y = tip_by_hand(motion.derivative(np.linspace(0, motion.period, 5001), 0)).T
    assert -0.5 <= x.min() < x.max() <= 1.2
    assert 0.1 <= y.min() < y.max() <= 2.5
    # 12 halvings of the scale: 2.4e-4 of a motion whose tip moves by its box, twice as much for its curves
    assert LimitUse.of(motion, LIMITS, box, ARM, TIP).worst.use == pytest.approx(1.0, abs=1e-3)


def test_random_feasible_is_reproducible() -> None:
    first, again, other = (random_feasible_trajectory(FREE, LIMITS, seed=seed).coefficients for seed in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_velocity_of_a_random_motion_has_a_flat_spectrum() -> None:
    """Over 200 seeds the power of h · coefficient is the same for all h within 6 of its own standard deviations."""
    series = FreeSeries(joints=1, harmonics=(1, 2, 3, 4), period=5.0)
    wide = limits((-1e6, 1e6), 1.0, 1e6)  # velocity alone limits, the same for all h
    z = np.array([random_feasible_trajectory(series, wide, seed=seed).coefficients[1:] for seed in range(200)])
    power = (z.reshape(200, 2, 4) * np.arange(1, 5)) ** 2
    share = power.mean(axis=(0, 1)) / power.mean()
    # normal coefficients of a fixed power: each share varies by sqrt(2 / 400) = 0.07; 6 of them fail once in 1e8
    np.testing.assert_allclose(share, 1.0, atol=0.42)


def test_series_without_an_offset_needs_limits_about_zero() -> None:
    away = Limits(position=LIMITS.position + 2.0, velocity=LIMITS.velocity, acceleration=LIMITS.acceleration)
    with pytest.raises(InputError, match="no posture was found"):
        random_feasible_trajectory(PaperSeries(period=5.0), away)


@pytest.mark.parametrize(
    ("name", "pairs"),
    [
        ("position", [[0.01, -0.01]] * 3),
        ("acceleration", [[-0.001, np.inf]] * 3),
        ("velocity", [[-1.0, 1.0]] * 2),
        ("position", [[1.0, 1.0]] * 3),
    ],
)
def test_limits_that_are_no_intervals_are_refused(name: str, pairs: list[list[float]]) -> None:
    motion = fourier_trajectory(offset=np.zeros(3), sine=np.ones((3, 1)), cosine=np.zeros((3, 1)), period=1.0)
    limits = Limits(**{**vars(LIMITS), name: np.array(pairs)})
    with pytest.raises(InputError, match="low below high were expected of " + name):
        LimitUse.of(motion, limits)


def test_a_floor_without_a_ceiling_is_refused() -> None:
    motion = fourier_trajectory(offset=np.zeros(3), sine=np.ones((3, 1)), cosine=np.zeros((3, 1)), period=1.0)
    arm = PlanarArm((1.0, 0.9, 0.4))
    with pytest.raises(InputError, match="far limit"):
        LimitUse.of(motion, LIMITS, Workspace(y=(0.1, np.inf)), arm, 0.2)
    with pytest.raises(InputError, match="tip length"):
        LimitUse.of(motion, LIMITS, Workspace(y=(0.1, 3.0)), arm, -0.2)
