"""A tool on a spring, motions that swing it, and its bend by an integrator."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from modeling.chain.model import planar, spatial
from modeling.chain.prediction import DeflectedLoad, compiled_prediction
from modeling.dynamics.deflection_solver import DeflectionSeries, solve_deflection
from modeling.dynamics.motion_record import TimeBase
from modeling.effects.geometry import TipFlexibility

Array = NDArray[np.float64]
Values = dict[str, float]
PERIOD = 4.0
TOOL = {"m": 1.5, "mlg": 0.15, "I": 0.02}


def turn(t: Array) -> dict[str, Array]:
    """A motion that repeats, of joints and sensor origin."""
    w = 2 * np.pi / PERIOD
    return {
        "phi": 0.2 + 0.6 * np.sin(w * t) + 0.3 * np.cos(3 * w * t),
        "dphi": w * (0.6 * np.cos(w * t) - 0.9 * np.sin(3 * w * t)),
        "ddphi": -(w**2) * (0.6 * np.sin(w * t) + 2.7 * np.cos(3 * w * t)),
        "ax": 3 * np.sin(2 * w * t),
        "ay": 2 * np.cos(w * t),
    }


def torque(t: float, bend: float) -> float:
    """What weight and acceleration ask of the spring, by hand from 22.8 with phi + bend in the place of phi."""
    w = 2 * pi / PERIOD
    angle = 0.2 + 0.6 * sin(w * t) + 0.3 * cos(3 * w * t) + bend
    ddphi = -(w**2) * (0.6 * sin(w * t) + 2.7 * cos(3 * w * t))
    lift = 3 * sin(2 * w * t) * cos(angle) - (2 * cos(w * t) + 9.806) * sin(angle)
    return TOOL["I"] * ddphi + TOOL["mlg"] * lift


def swing(stiffness: float, damping: float) -> Callable[[float, Array], list[float]]:
    def rate(t: float, x: Array) -> list[float]:
        return [x[1], -(stiffness * x[0] + damping * x[1] + torque(t, x[0])) / TOOL["I"]]

    return rate


def integrated(stiffness: float, damping: float, start: Array, times: Array) -> Array:
    """Angle and rate (n, 2) from the state `start` at time 0."""
    end = (0.0, max(float(times[-1]), 1e-9))
    found = solve_ivp(swing(stiffness, damping), end, start, "DOP853", times, rtol=1e-9, atol=1e-11)
    return np.asarray(found.y.T)


@cache
def bent(space: str) -> DeflectedLoad:
    model = (planar() if space == "plane" else spatial()) + TipFlexibility()
    load = compiled_prediction(model).deflection
    assert load is not None
    return load


def vector(space: str, values: Values) -> Array:
    """The parameters in the model's order, others zero."""
    names = [symbol.name.removeprefix("tip_flexibility.") for symbol in bent(space).load.parameters]
    return np.array([values.get(name, 0.0) for name in names[: bent(space).size]])


def solved(values: Values, times: Array, clock: TimeBase, *, derivative: bool = False) -> DeflectionSeries:
    tool = bent("plane")
    rows = tool.load.samples(turn(times), len(times))
    return solve_deflection(tool.equation, rows, vector("plane", values), clock, derivative=derivative)


def grid(samples: int, duration: float = PERIOD) -> tuple[Array, float]:
    dt = duration / samples
    return np.arange(samples, dtype=np.float64) * dt, dt


def three_axes(times: Array) -> tuple[dict[str, Array], Rotation]:
    """A motion that repeats, turning about all axes; rates by the spectrum of the rotation matrices."""
    w = 2 * np.pi / PERIOD
    angles = [0.5 * np.sin(w * times), 0.4 * np.cos(w * times), 0.3 * np.sin(2 * w * times + 0.3)]
    rotation = Rotation.from_rotvec(np.stack(angles, axis=1))
    omega = spin(rotation)
    acceleration = np.stack([3 * np.sin(2 * w * times), 2 * np.cos(w * times), 1.5 * np.sin(w * times + 1)], axis=1)
    columns = np.hstack([rotation.as_quat(), omega, rated(omega), acceleration])
    names = ("qx", "qy", "qz", "qw", "wx", "wy", "wz", "alx", "aly", "alz", "apx", "apy", "apz")
    return dict(zip(names, columns.T, strict=True)), rotation


def rated(series: Array) -> Array:
    """Derivative in time of a series over one period, by its spectrum."""
    lines = np.fft.rfft(series, axis=0)
    omega = 2j * np.pi * np.arange(len(lines)) / PERIOD
    rates = np.fft.irfft(lines * omega.reshape(-1, *([1] * (series.ndim - 1))), n=len(series), axis=0)
    return np.asarray(rates, dtype=np.float64)


def spin(rotation: Rotation) -> Array:
    """Angular velocity in the body's axes, from R' dR."""
    matrix = rotation.as_matrix()
    skew = matrix.transpose(0, 2, 1) @ rated(matrix)
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


MOMENT = np.array([0.024, -0.036, 0.144])
INERTIA = np.array([[0.03, 0.002, -0.001], [0.002, 0.028, 0.003], [-0.001, 0.003, 0.012]])
SPATIAL = {
    "m": 1.2,
    **{f"m{a}": float(MOMENT[i]) for i, a in enumerate("xyz")},
    **{f"I{'xyz'[i]}{'xyz'[j]}": float(INERTIA[i, j]) for i in range(3) for j in range(i, 3)},
    "stiffness": 20.0,
    "damping": 0.3,
}
