"""The planar model against 22.8 and 22.9, against Lagrange, against MuJoCo, and as a cut through the spatial one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import compiled_prediction
from modeling.chain.regressor import regressor, regressor_functions
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Convention, Rig, SensorDescription
from truewrench.simulated_rig import PlanarRig, rigid_tool_wrench

Array = NDArray[np.float64]

GRAVITY = 9.806
PHI, DPHI, DDPHI, AX, AY = sp.symbols("phi dphi ddphi ax ay", real=True)
G = sp.Float(GRAVITY)
M1 = AX * sp.cos(PHI) - (AY + G) * sp.sin(PHI)
M2 = DDPHI
M3 = -(AX * sp.sin(PHI) + (AY + G) * sp.cos(PHI))
M4 = DPHI**2
PRINTED = sp.Matrix([[1, 0, 0, M1, M2, 0], [0, 1, 0, M3, M4, 0], [0, 0, 1, 0, M1, M2]])  # 22.8 with 22.9


def vanishes(expressions: sp.Matrix) -> bool:
    return bool(expressions.applyfunc(lambda e: sp.simplify(sp.expand(e))) == sp.zeros(*expressions.shape))


def test_regressor_is_22_8() -> None:
    model = planar()
    assert [p.name for p in model.parameters] == ["bias_fx", "bias_fy", "bias_tau", "m", "mlg", "I"]  # 22.6
    assert vanishes(regressor(model) - PRINTED)


def test_motions_are_22_9() -> None:
    found = regressor_functions(planar())
    assert vanishes(sp.Matrix([found.M1 - M1, found.M2 - M2, found.M3 - M3, found.M4 - M4]))
    with pytest.raises(InputError, match="planar"):
        regressor_functions(spatial())


@pytest.mark.parametrize("effect", [effects.gravity_tilt(), effects.sensor_lag()])
def test_a_model_that_is_not_linear_has_no_regressor(effect: Effect) -> None:
    with pytest.raises(InputError, match="linear"):
        regressor(planar() + effect)


def test_signs_of_the_readings() -> None:
    """On the sensor acts the negative of the wrench on the tool; a mirrored y changes fy alone; the bias stays."""
    plain, size = regressor(planar()), 3

    def signed(convention: Convention, mirror_y: bool) -> sp.Matrix:
        sensor = SensorDescription(convention=convention, mirror_y=mirror_y)
        return regressor(planar(Rig(sensor=sensor)))

    for convention, sign in ((Convention.ON_TOOL, 1), (Convention.ON_SENSOR, -1)):
        for mirror_y, y in ((False, 1), (True, -1)):
            phi = signed(convention, mirror_y)
            assert vanishes(phi[:, :size] - sp.eye(size))
            assert vanishes(phi[:, size:] - sp.diag(sign, sign * y, sign) * plain[:, size:])


def test_gravity_is_the_rigs() -> None:
    phi = regressor(planar(Rig(gravity=1.62)))
    still = {AX: 0, AY: 0, DPHI: 0, DDPHI: 0, PHI: 0}
    assert float(phi.subs(still)[1, 3]) == -1.62


def test_wrench_is_lagranges() -> None:
    """The forces along x and y at Ps, and the torque, that Lagrange's equations of the free tool ask for.

    T = m v²/2 + mlg dphi (vx cos phi - vy sin phi) + I dphi²/2 and V = m g y + mlg g cos phi; then the world's
    forces in the axes (x', -y').
    """
    t = sp.Symbol("t")
    m, mlg, inertia = sp.symbols("m mlg I", real=True)
    x, y, phi = (sp.Function(name)(t) for name in ("x", "y", "phi"))
    dx, dy, dphi = x.diff(t), y.diff(t), phi.diff(t)
    kinetic = m * (dx**2 + dy**2) / 2 + mlg * dphi * (dx * sp.cos(phi) - dy * sp.sin(phi)) + inertia * dphi**2 / 2
    potential = m * G * y + mlg * G * sp.cos(phi)
    forces = [
        (kinetic.diff(v).diff(t) - (kinetic - potential).diff(c)).subs(
            {x.diff(t, 2): AX, y.diff(t, 2): AY, phi.diff(t, 2): DDPHI}
        )
        for c, v in ((x, dx), (y, dy), (phi, dphi))
    ]
    along_x, along_y, torque = (force.subs({dphi: DPHI}).subs({phi: PHI}) for force in forces)
    expected = sp.Matrix(
        [
            along_x * sp.cos(PHI) - along_y * sp.sin(PHI),
            -(along_x * sp.sin(PHI) + along_y * sp.cos(PHI)),
            torque,
        ]
    )
    assert vanishes(planar().load - expected)


# ------------------------------------------------------------------------------------------ MuJoCo


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_wrench_is_mujocos(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass, centre, about_centre = map(float, rng.uniform([0.1, -0.2, 1e-3], [5.0, 0.2, 0.1]))
    mlg, inertia = mass * centre, about_centre + mass * centre**2
    rig = PlanarRig(mass=mass, mlg=mlg, inertia=inertia)
    q, dq, ddq = (rng.uniform(-limit, limit, (20, 3)) for limit in (np.pi, 3.0, 15.0))
    felt = rigid_tool_wrench(rig.scene, (), np.zeros(20), (q, dq, ddq))[:, rig.rows]
    pose = PlanarArm(rig.link_lengths).pose(q, dq, ddq)
    theta = np.array([*rng.uniform(-10, 10, 3), mass, mlg, inertia])
    prediction = compiled_prediction(planar())
    bias = prediction.bias.value(pose, theta, 20)
    np.testing.assert_array_equal(bias, np.tile(theta[:3], (20, 1)))
    # rounding of MuJoCo's recursion on forces of order 1000 N
    np.testing.assert_allclose(prediction.load.value(pose, theta, 20), felt, rtol=1e-10, atol=1e-10)


# ------------------------------------------------------------------------------- the spatial model


def in_the_plane(model: WrenchModel) -> sp.Matrix:
    """The spatial wrench of a planar motion: world x right, z up, e1 = x', e2 = -y', e3 = into the page.

    At phi = 0 a turn by -90 degrees about x takes e2 down and e3 along y; then the tool turns by phi about e3.
    """
    half = sp.sqrt(2) / 2
    turn = {"qx": -half, "qw": half, "qy": 0, "qz": 0}
    x, y, z, w = turn["qx"], 0, 0, turn["qw"]
    s, c = sp.sin(PHI / 2), sp.cos(PHI / 2)
    quaternion = {"qx": x * c + y * s, "qy": y * c - x * s, "qz": w * s + z * c, "qw": w * c - z * s}
    spin = {"wx": 0, "wy": 0, "wz": DPHI, "alx": 0, "aly": 0, "alz": DDPHI, "apx": AX, "apy": 0, "apz": AY}
    m, mlg, inertia, mlx = sp.symbols("m mlg I com_offset.mlx", real=True)
    body = {"m": m, "mx": mlx, "my": -mlg, "mz": 0, "Izz": inertia}
    values = {sp.Symbol(name, real=True): value for name, value in (quaternion | spin | body).items()}
    load: sp.Matrix = model.load.subs(values, simultaneous=True)
    return load


def test_planar_model_is_a_cut_through_the_spatial_one() -> None:
    """Symbolic; whatever the inertias about the axes in the plane and the products of inertia among them are."""
    model = spatial()
    assert model.convention is Convention.AUTO
    cut = in_the_plane(replace(model, convention=Convention.ON_TOOL))
    rows = sp.Matrix([cut[0], cut[1], cut[5]])
    assert vanishes(rows - (planar() + effects.com_offset()).load)
    assert vanishes(sp.Matrix([cut[2]]))


# --------------------------------------------------------------------------------------- particles


def spectral_rate(series: Array, period: float) -> Array:
    """Time derivative of a smooth periodic series (N, ...), to rounding."""
    rate = 2j * np.pi * np.fft.fftfreq(len(series), period / len(series))
    return np.real(np.fft.ifft(np.fft.fft(series, axis=0) * rate.reshape(-1, *([1] * (series.ndim - 1))), axis=0))


@pytest.mark.parametrize("seed", range(5))
def test_wrench_is_the_sum_over_particles(seed: int) -> None:
    """A cloud of point masses on a moving tool: each one's path differentiated in the world, m (p'' - g) summed."""
    rng = np.random.default_rng(seed)
    period, samples = 2.0, 256
    t = np.arange(samples) * period / samples
    waves = np.stack([f(2 * np.pi * h * t / period) for h in (1, 2) for f in (np.sin, np.cos)], axis=1)
    phi, x, y = (waves @ rng.normal(0, 0.3, (4, 3))).T
    mass, place = rng.uniform(0.05, 0.5, 6), rng.uniform(-0.2, 0.2, (6, 2))  # along x' and y'
    sin, cos = np.sin(phi)[:, None], np.cos(phi)[:, None]
    x_axis, y_axis = np.hstack([cos, -sin]), np.hstack([sin, cos])
    origin = np.stack([x, y], axis=1)
    path = origin[:, None] + place[:, :1] * x_axis[:, None] + place[:, 1:] * y_axis[:, None]
    forces = mass[:, None] * (spectral_rate(spectral_rate(path, period), period) + np.array([0.0, GRAVITY]))
    arm = path - origin[:, None]
    clockwise = arm[..., 1] * forces[..., 0] - arm[..., 0] * forces[..., 1]
    total = forces.sum(axis=1)
    expected = np.stack([(total * x_axis).sum(1), -(total * y_axis).sum(1), clockwise.sum(1)], axis=1)

    dphi, acceleration = spectral_rate(phi, period), spectral_rate(spectral_rate(origin, period), period)
    signals = {"phi": phi, "dphi": dphi, "ddphi": spectral_rate(dphi, period)}
    signals |= {"ax": acceleration[:, 0], "ay": acceleration[:, 1]}
    moments = [mass.sum(), mass @ place[:, 1], mass @ (place**2).sum(1), mass @ place[:, 0]]
    model = planar() + effects.com_offset()
    felt = compiled_prediction(model).load.value(signals, np.array([0.0, 0.0, 0.0, *moments]), samples)
    # rounding 1e-15 times w² at half the sampling rate (1.6e5 /s²), on forces of order 10 N
    np.testing.assert_allclose(felt, expected, atol=1e-8)
