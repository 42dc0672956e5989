"""Time discretisation of the deflection, solved sample by sample with Newton's method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import Definitions
from modeling.dynamics.deflection import Deflection
from modeling.dynamics.equation_of_motion import EquationOfMotion
from modeling.dynamics.sample_program import INITIAL_STATE_SHARE, SampleProgramBuilder, Symbols
from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DiscreteDeflection:
    """First-order-hold discretisation with step dt of mass b'' + lag b' + b = input, for d angles b.

    (b, b', b'') = carry (3 d, 2 d) (b, b')_last + past (3 d, d) input_last + now (3 d, d) input; in static equilibrium
    (b, b', b'') = rest (3 d, d) input.
    """

    carry: Array
    past: Array
    now: Array

    @classmethod
    def of(cls, equation: EquationOfMotion, signals: int, theta: Array, dt: float) -> Self:
        """With the tool's inertia and damping at zero deflection; dt in s.

        Raises InputError when the inertia is not positive definite.
        """
        size = equation.size
        _, slopes = equation.at(np.zeros((1, signals)), np.zeros((1, 3 * size)), theta)
        lag, mass = slopes[0, :, size : 2 * size], slopes[0, :, 2 * size :]
        if not (np.isfinite(mass).all() and np.linalg.eigvalsh((mass + mass.T) / 2).min() > 0):
            what = "the tool's inertia is not positive: the deflection is unstable"
            raise InputError(what=what, where="tip_flexibility", remedy="fit it with --physical, or leave it out")
        return cls(*_first_order_hold(mass, lag, dt))

    @property
    def size(self) -> int:
        """The number of angles d."""
        return int(self.past.shape[1])

    @property
    def settling(self) -> int:
        """Samples after which less than `INITIAL_STATE_SHARE` of a wrong initial state is left; 0 without damping."""
        slowest = float(np.abs(np.linalg.eigvals(self.carry[: 2 * self.size])).max())
        return int(np.ceil(np.log(INITIAL_STATE_SHARE) / np.log(slowest))) if 0 < slowest < 1 else 0

    @property
    def rest(self) -> Array:
        """(1, 0, 0): in static equilibrium the input is the angle itself."""
        return np.eye(3 * self.size, self.size)


def _first_order_hold(mass: Array, lag: Array, dt: float) -> tuple[Array, Array, Array]:
    """Carry, past and now, by the exponential of the system augmented by input and input slope; rates times dt."""
    size = len(mass)
    inverse = np.asarray(np.linalg.inv(mass), dtype=float)
    one: Array = np.eye(size)
    zero: Array = np.zeros((size, size))
    rows: list[list[Array]] = [
        [zero, one, zero, zero],
        [-(dt**2) * inverse, -dt * inverse @ lag, dt**2 * inverse, zero],
        [zero, zero, zero, one],
        [zero, zero, zero, zero],
    ]
    step = expm(np.block(rows))[: 2 * size]
    units = np.concatenate([np.ones(size), np.full(size, 1 / dt)])
    free = units[:, None] * step[:, : 2 * size] / units
    slope = units[:, None] * step[:, 3 * size :]
    held = units[:, None] * step[:, 2 * size : 3 * size] - slope
    second = -inverse @ np.hstack([one, lag])
    return (
        np.vstack([free, second @ free]),
        np.vstack([held, second @ held]),
        np.vstack([slope, second @ slope + inverse]),
    )


def deflected(
    discrete: DiscreteDeflection, sample: SampleProgramBuilder, deflection: Deflection, equation: sp.Matrix
) -> None:
    """One sample of the deflection (3 d,): Newton's method for the input with which the equation of motion holds.

    It starts from the static equilibrium of the first sample. At the angular frequency w the relative error of the
    first-order hold is (w dt)² / 12.
    """
    size = discrete.size
    zeros = [sp.S.Zero] * (2 * size)
    motion, last = sample.state("deflection", zeros), sample.state("drive", zeros[:size])
    carry, past, now, rest = (
        sp.Matrix(m.tolist()) for m in (discrete.carry, discrete.past, discrete.now, discrete.rest)
    )
    free = sp.Matrix(sample.assigned("free", list(carry * sp.Matrix(motion) + past * sp.Matrix(last))))
    gain = sp.Matrix(3 * size, size, sample.initialised("gain", list(rest), list(now)))

    def angles(drive: Symbols) -> Definitions:
        return tuple(zip(deflection.signals, free + gain * sp.Matrix(drive), strict=True))

    about = "deflection of the tool: Newton's method for the forcing with which the equation of motion holds"
    drive = sample.solved("forcing", last, list(equation), angles, about=about)
    sample.define(deflection.signals, [value for _, value in angles(drive)])
    sample.keep(motion, deflection.signals[: 2 * size])
    sample.keep(last, drive)
    sample.settling += discrete.settling
