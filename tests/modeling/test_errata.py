"""The errata of the chapter (PHYSICS.md), each against a derivation.

The equations are those of `modeling.reference`, as they are printed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from design.trajectories.fourier import CHAPTER_OPTIMUM_DEGREES, PaperSeries
from design.trajectories.trajectory import Trajectory
from modeling import effects
from modeling.chain.model import planar
from modeling.chain.regressor import regressor, regressor_functions
from modeling.kinematics.arm import PlanarArm
from modeling.reference import contact_statics as printed_contact
from modeling.reference.body_wrench import BODY_ABOUT_CENTRE, I_G, INERTIA, MASS, MLG, PRINTED_22_5
from modeling.reference.body_wrench import G as GRAVITY
from modeling.reference.path_kinematics import AX, AY, DDPHI, DPHI, L_G, PHI

Array = NDArray[np.float64]

MODEL = planar()
G = sp.Float(9.806)
ROW_1, ROW_2, ROW_3 = (row.subs(GRAVITY, G) for row in PRINTED_22_5)
# a_G of 22.4 along x' and y'
A_GX = AX * sp.cos(PHI) - AY * sp.sin(PHI) + L_G * DDPHI
A_GY = AX * sp.sin(PHI) + AY * sp.cos(PHI) - L_G * DPHI**2

directions = st.floats(-3.1, 3.1)
sizes = st.floats(0.1, 100.0)
arms = st.floats(0.05, 2.0)


def zero(expression: sp.Expr) -> bool:
    return bool(sp.simplify(sp.expand(expression)) == 0)


# ----------------------------------------------------------------------------- 1 and 2: the wrench


def test_derived_wrench_is_newtons_and_eulers_about_the_centre_of_mass() -> None:
    """F = m (a_G - g), in 22.8 as (F_x', -F_y'), and about Ps the torque I_G ddphi + l_g F_x'."""
    fx, fy, tau = (row.subs(BODY_ABOUT_CENTRE) for row in MODEL.load)
    along_x, along_y = MASS * (A_GX - G * sp.sin(PHI)), MASS * (A_GY + G * sp.cos(PHI))
    assert zero(fx - along_x)
    assert zero(fy + along_y)
    assert zero(tau - (I_G * DDPHI + L_G * along_x))


@pytest.mark.parametrize(("sign", "left"), [(1, -2 * MASS * A_GX), (-1, 2 * MASS * G * sp.sin(PHI))])
def test_row_1_of_22_5_has_the_sign_of_acceleration_reversed_against_gravity(sign: int, left: sp.Expr) -> None:
    printed, derived = sign * ROW_1, MODEL.load[0].subs(BODY_ABOUT_CENTRE)
    assert zero(printed - sign * MASS * (-A_GX - G * sp.sin(PHI)))
    assert not zero(printed - derived)
    # What differs is twice the acceleration, or twice the weight, and nothing else.
    assert zero(printed - derived - left)


def test_row_2_of_22_5_is_that_of_22_8() -> None:
    printed, row = ROW_2, (regressor(MODEL)[1, 3:] * sp.Matrix([MASS, MLG, INERTIA]))[0]
    assert zero(printed + MASS * (A_GY + G * sp.cos(PHI)))
    assert zero(printed - row.subs(BODY_ABOUT_CENTRE))


def test_row_3_of_22_5_cannot_be_derived() -> None:
    """No constants make I ddphi, m l_g a_Gx' sin phi and m l_g g sin phi into the torque: least squares leaves some."""
    rng = np.random.default_rng(0)
    terms = (DDPHI, A_GX * sp.sin(PHI), sp.sin(PHI))
    assert zero(ROW_3 - sum(c * term for c, term in zip((-INERTIA, MASS * L_G, MASS * L_G * G), terms, strict=True)))
    columns = sp.Matrix([[*terms, MODEL.load[2].subs(BODY_ABOUT_CENTRE)]])
    columns = columns.subs({MASS: 0.9, L_G: 0.07, I_G: 0.0085})
    values = sp.lambdify([PHI, DPHI, DDPHI, AX, AY], columns, "numpy")
    rows = np.array([values(*rng.uniform(-3, 3, 5))[0] for _ in range(200)])
    printed, torque = rows[:, :3], rows[:, 3]
    left = torque - printed @ np.linalg.lstsq(printed, torque, rcond=None)[0]
    # Most of m l_g a_Gx' stays; with the sin phi taken away as it should be, only rounding does.
    assert left.std() > 0.2 * torque.std()
    mended = np.column_stack([rows[:, 0], rows[:, 1] / rows[:, 2], rows[:, 2]])
    assert np.abs(torque - mended @ np.linalg.lstsq(mended, torque, rcond=None)[0]).max() < 1e-12


def test_inertia_is_about_the_sensor_origin() -> None:
    coefficient = sp.expand(MODEL.load[2]).coeff(DDPHI)
    assert coefficient == INERTIA
    # About Ps, with Euler's torque about G and the arm l_g of the force: the parallel axis theorem.
    torque = I_G * DDPHI + L_G * MASS * A_GX
    assert zero(torque.diff(DDPHI) - (I_G + MASS * L_G**2))


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(0.01, 5), st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=6))
def test_every_body_is_physically_consistent(particles: list[tuple[float, float, float]]) -> None:
    """[[m, 0, mlx], [0, m, mlg], [mlx, mlg, I]] >= 0 for any cloud, and with it [[m, mlg], [mlg, I]]."""
    mass, x, y = np.array(particles).T
    m, mlx, mlg, inertia = mass.sum(), mass @ x, mass @ y, mass @ (x**2 + y**2)
    full = np.array([[m, 0, mlx], [0, m, mlg], [mlx, mlg, inertia]])
    rounding = 1e-14 * m
    assert np.linalg.eigvalsh(full)[0] >= -rounding
    assert np.linalg.eigvalsh(full[1:, 1:])[0] >= -rounding
    # One particle has no inertia about itself: the bound is reached, and less inertia is refused by it.
    if len(particles) == 1:
        assert np.linalg.eigvalsh(full - np.diag([0, 0, 0.01 * inertia + 1e-6]))[0] < 0


# ------------------------------------------------------------------------- 3, 4 and 7: the contact


SIZE, ANGLE, D = printed_contact.FORCE_SIZE, printed_contact.ANGLE, printed_contact.D
CHANNELS = sp.lambdify([SIZE, ANGLE, D], list(printed_contact.PRINTED_22_14), "numpy")
FRACTION = sp.lambdify([*printed_contact.CONTACT_WRENCH, D], sp.fraction(printed_contact.PRINTED_22_16), "numpy")
"""Numerator and denominator of 22.16's tangent, so that a quarter turn is no special case."""


def channels_of_22_14(size: float, angle: float, d: float) -> Array:
    """22.14: (-R sin, -R cos, -R d sin), the only signs under which errata 3 and 7 both hold."""
    channels = np.array(CHANNELS(size, angle, d), dtype=float)
    typed = -size * np.array([np.sin(angle), np.cos(angle), d * np.sin(angle)])
    np.testing.assert_allclose(channels, typed, rtol=1e-14, atol=1e-300)  # rounding, and that of the smallest floats
    return channels


def solved_22_14(wrench: Array, d: float) -> tuple[float, float]:
    """R and the angle of 22.14 by linear least squares in (R sin, R cos)."""
    matrix = np.array(printed_contact.MATRIX_22_14.subs(D, d), dtype=float)
    sine, cosine = np.linalg.lstsq(matrix, wrench, rcond=None)[0]
    return float(np.hypot(sine, cosine)), float(np.arctan2(sine, cosine))


def on_channels_of_22_8(size: float, angle: float, d: float) -> Array:
    """What a force size (sin b, cos b) of the environment, in (x', y') at d along the tip, changes in 22.8's channels,
    by the model's own contact effect."""
    along_x, along_y = size * np.sin(angle), size * np.cos(angle)
    return np.array(contact()(along_x, along_y, d * along_x), dtype=float)[:, 0]


@cache
def contact() -> Callable[..., Array]:
    """Change of the channels in the midst of a contact with fcx, fcy, tauc, as a function of these."""
    event = effects.contact_event()
    own = {p.name.removeprefix(f"{event.id}."): p.symbol for p in event.qualified(MODEL.space)}
    fcx, fcy, tauc, start, end = (own[name] for name in ("fcx", "fcy", "tauc", "start", "end"))
    change = ((MODEL + event).load - MODEL.load).subs({start: 0, end: 2, sp.Symbol("time", real=True): 1})
    function: Callable[..., Array] = sp.lambdify([fcx, fcy, tauc], change, "numpy")
    return function


def difference(angle: float, other: float) -> float:
    """Of two directions, less whole turns."""
    return float(abs((angle - other + np.pi) % (2 * np.pi) - np.pi))


@given(sizes, directions, arms)
def test_22_16_has_the_wrong_sign_and_the_corrected_one_inverts_22_14(size: float, angle: float, d: float) -> None:
    fcx, fcy, tau = channels_of_22_14(size, angle, d)
    rounding = 1e-9
    assert solved_22_14(np.array([fcx, fcy, tau]), d) == pytest.approx((size, angle), rel=rounding, abs=rounding)
    corrected = (fcx + tau * d) * np.cos(angle)
    numerator, denominator = FRACTION(fcx, fcy, tau, d)
    assert denominator == pytest.approx(fcy * (1 + d**2))
    printed = numerator * np.cos(angle)
    assert corrected == pytest.approx(fcy * (1 + d**2) * np.sin(angle), abs=rounding * size)
    wrong_by = abs(printed - fcy * (1 + d**2) * np.sin(angle))
    assert wrong_by == pytest.approx(2 * d**2 * size * abs(np.sin(angle) * np.cos(angle)), abs=rounding * size)


@given(sizes, directions, arms)
def test_22_16_solves_the_torque_with_the_opposite_sign(size: float, angle: float, d: float) -> None:
    fcx, fcy, _ = channels_of_22_14(size, angle, d)
    tau = size * d * np.sin(angle)
    numerator, denominator = FRACTION(fcx, fcy, tau, d)
    assert numerator * np.cos(angle) == pytest.approx(denominator * np.sin(angle), abs=1e-9 * size)  # rounding


@given(sizes, directions.filter(lambda b: abs(np.cos(b)) > 0.01), arms)
def test_arctan_loses_the_quadrant(size: float, angle: float, d: float) -> None:
    fcx, fcy, tau = channels_of_22_14(size, angle, d)
    found = float(np.arctan((fcx + tau * d) / (fcy * (1 + d**2))))
    expected = 0.0 if np.cos(angle) > 0 else np.pi  # half a turn off whenever the force points back
    assert difference(found, angle) == pytest.approx(expected, abs=1e-9)


@settings(deadline=None)
@given(sizes, directions, arms)
def test_22_14_returns_pi_minus_b_on_the_channels_of_22_8(size: float, b: float, d: float) -> None:
    wrench = on_channels_of_22_8(size, b, d)
    expected = size * np.array([-np.sin(b), np.cos(b), -d * np.sin(b)])
    np.testing.assert_allclose(wrench, expected, atol=1e-12 * size)  # rounding
    assert difference(solved_22_14(wrench, d)[1], np.pi - b) < 1e-9
    fcx, fcy, tau = wrench
    assert difference(float(np.arctan2(-(fcx + tau * d) / (1 + d**2), fcy)), b) < 1e-9


def test_thirty_hundredths_become_2_84() -> None:
    assert solved_22_14(on_channels_of_22_8(5.0, 0.30, 0.2), 0.2)[1] == pytest.approx(2.84, abs=5e-3)  # two decimals


def test_equal_weights_depend_on_the_unit_of_length_and_the_noises_do_not() -> None:
    """1 + d² adds a number to m². A reading that fits no force has another direction in N mm than in N m; weighted
    with the noise's covariance it has one."""
    d, noise = 0.2, np.array([0.15, 0.25, 0.012])
    wrench = on_channels_of_22_8(5.0, 0.9, d) + np.array([0.4, -0.3, 0.05])

    def direction(unit: float, weights: Array) -> float:
        """unit: how many there are in a metre."""
        scale, arm = np.array([1, 1, unit]), d * unit
        matrix = np.array([[-1, 0], [0, 1], [-arm, 0]]) * weights[:, None]
        sine, cosine = np.linalg.lstsq(matrix, wrench * scale * weights, rcond=None)[0]
        return float(np.arctan2(sine, cosine))

    metres, millimetres = (direction(unit, np.ones(3)) for unit in (1, 1000))
    fcx, fcy, tau = wrench
    assert metres == pytest.approx(np.arctan2(-(fcx + tau * d) / (1 + d**2), fcy), abs=1e-12)  # rounding
    assert abs(metres - millimetres) > 0.01
    weighted = [direction(unit, 1 / (noise * [1, 1, unit])) for unit in (1, 1000)]
    assert weighted[0] == pytest.approx(weighted[1], abs=1e-12)  # rounding


# ------------------------------------------------------------------- 5 and 8: x_opt and its figures


def test_peaks_of_x_opt_say_degrees() -> None:
    in_degrees, in_radians = (
        np.degrees(np.abs(Trajectory(PaperSeries(period=5.0), x).enclosure(0)).max(axis=0))
        for x in (np.radians(CHAPTER_OPTIMUM_DEGREES), np.array(CHAPTER_OPTIMUM_DEGREES))
    )
    assert in_degrees.round().tolist() == [42, 44, 35]
    assert (in_radians > 2000).all()  # 35 rad and more


@pytest.mark.parametrize(
    ("radians_per_unit", "samples", "decades"), [(np.pi / 180, 1000, 25.5), (np.pi / 180, 10_000, 31.5), (1, 1000, 42)]
)
def test_determinant_of_x_opt_stays_open(radians_per_unit: float, samples: int, decades: float) -> None:
    """det(Phi' Phi) > 1e41 is not reached in degrees, with the lengths assumed and T = 5 s."""
    motion = Trajectory(PaperSeries(period=5.0), np.array(CHAPTER_OPTIMUM_DEGREES) * radians_per_unit)
    states = motion.evaluate(np.arange(samples) * 5.0 / samples)
    pose = PlanarArm((1.0, 0.97, 0.4)).pose(*states)
    found = regressor_functions(MODEL)
    values = sp.lambdify([PHI, DPHI, DDPHI, AX, AY], [found.M1, found.M2, found.M3, found.M4], "numpy")
    m1, m2, m3, m4 = values(*(pose[name] for name in ("phi", "dphi", "ddphi", "ax", "ay")))
    one, none = np.ones(samples), np.zeros(samples)
    phi = np.concatenate(
        [
            np.stack([one, none, none, m1, m2, none], axis=1),
            np.stack([none, one, none, m3, m4, none], axis=1),
            np.stack([none, none, one, none, m1, m2], axis=1),
        ]
    )
    rounded = 0.5 if decades == 42 else 0.05  # to the digits that PHYSICS.md gives
    assert np.linalg.slogdet(phi.T @ phi)[1] / np.log(10) == pytest.approx(decades, abs=rounded)


def test_the_best_determinant_does_not_minimise_every_variance() -> None:
    """The straight line a + b t, four samples between t = -1 and 2: at the ends det is largest; about t = 0 it is
    smaller, and the variance of a too."""
    designs = [np.column_stack([np.ones(4), t]) for t in ([2.0, 2.0, -1.0, -1.0], [1.0, 1.0, -1.0, -1.0])]
    information = [phi.T @ phi for phi in designs]
    assert np.linalg.det(information[0]) > np.linalg.det(information[1])
    assert np.linalg.inv(information[0])[0, 0] > np.linalg.inv(information[1])[0, 0]


def test_bias_of_the_torque_is_a_torque() -> None:
    units = {p.name: p.unit for p in MODEL.parameters}
    assert (units["bias_fx"], units["bias_fy"], units["bias_tau"]) == ("N", "N", "N m")


# ------------------------------------------------------------------------------- 6: Table 22.1


def test_table_22_1_shows_a_remainder_that_averaging_does_not_remove() -> None:
    """One run has variance noise + remainder², the mean of 30 runs noise/30 + remainder²."""
    runs, single, averaged = 30, np.array([0.6705, 2.654]), np.array([0.037, 0.110])
    noise, squared = np.linalg.solve(np.array([[1, 1], [1 / runs, 1]]), np.array([single, averaged]))
    assert noise == pytest.approx([0.655, 2.632], abs=5e-4)  # to the digits given
    assert np.sqrt(squared) == pytest.approx([0.123, 0.149], abs=5e-4)


@pytest.mark.parametrize("channel", range(2))
def test_table_22_1_without_a_remainder_would_read_otherwise(channel: int) -> None:
    """The same solution finds a remainder that was put in, and none where there is none (1 in 1e5 by chance).

    Of 2000 samples a variance errs by 2 sqrt(2 / 2000) = 3 %; averaged over 30 runs the first by less; the zero
    remainder errs by 4.4 sigma of 3 % of noise / 30.
    """
    rng = np.random.default_rng(channel)
    noise, runs, samples = (0.655, 2.632)[channel], 30, 2000
    for remainder in (0.0, 0.3):
        locked = remainder * np.sqrt(2) * np.sin(2 * np.pi * np.arange(samples) / 100)
        readings = locked + rng.normal(0, np.sqrt(noise), (runs, samples))
        single, averaged = readings.var(axis=1).mean(), readings.mean(axis=0).var()
        squared = np.linalg.solve(np.array([[1, 1], [1 / runs, 1]]), np.array([single, averaged]))[1]
        spread = np.sqrt(2 / samples) * (noise / runs) + 2 * remainder * np.sqrt(noise / runs / samples)
        assert abs(squared - remainder**2) < 4.4 * spread
