"""First-order-hold discretisation of a transfer function, and one sample of its recursive filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, tf2ss

from modeling import symbolic as sp
from modeling.dynamics.sample_program import INITIAL_STATE_SHARE, SampleProgramBuilder, Symbols
from modeling.dynamics.transfer_function import TransferFunction

Array = NDArray[np.float64]

WHOLE_DELAY_TOLERANCE = 1e-9
"""Tolerance (samples) within which a delay is a whole number of samples: the rounding of delay / dt."""
FASTEST_POLE = 1e9
"""Pole times dt beyond which a lag is neglected: it decays within one step to below rounding."""


@dataclass(frozen=True, eq=False)
class DiscreteTransferFunction:
    """Numeric discretisation of H(s) with step dt. For an input u linear between samples, its rational part is

    x' = A x + B u, y = C x + D u, with the steady state x = `rest` u for constant u. The delay is an interpolation: the
    outputs from the `first` on (0 is the current one) times `weights` give the output of `wait` samples ago.

    A (r, r), B (r,), C (r,), D, rest (r,), weights (1,) or (4,); of a wrong initial state less than
    `INITIAL_STATE_SHARE` is left after `settling` outputs.
    """

    A: Array
    B: Array
    C: Array
    D: float
    rest: Array
    wait: int
    first: int
    weights: Array
    settling: int

    @classmethod
    def of(cls, transfer: TransferFunction, dt: float) -> Self:
        """The discretisation with step dt (s)."""
        a, b, c, d = _discretised(transfer, dt)
        wait, first, weights = _delay_line(transfer.delay / dt)
        decay = int(np.ceil(-np.log(INITIAL_STATE_SHARE) * transfer.slowest_time_constant / dt))
        return cls(
            A=a,
            B=b[:, 0],
            C=c[0],
            D=float(d[0, 0]),
            rest=np.asarray(np.linalg.solve(np.eye(len(a)) - a, b[:, 0]), dtype=float),
            wait=wait,
            first=first,
            weights=weights,
            settling=first + len(weights) - 1 + decay,
        )

    @property
    def order(self) -> int:
        """The number of states r."""
        return len(self.B)

    @property
    def held(self) -> int:
        """Length of the delay line: stored outputs of the rational part, the current one included."""
        return self.first + len(self.weights)


def filtered(discrete: DiscreteTransferFunction, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
    """One sample of the recursive filter: the output (p,) of `discrete.wait` samples ago for the input (p,).

    The rational part is exact for inputs joined by straight lines (first-order hold); for a sine at the angular
    frequency w the relative error is (w dt)² / 12. The delay follows: whole samples, and in between cubic interpolation
    of the four nearest outputs, two on either side, with an error below (w dt)⁴ / 42 for a sine. For a lead, or a delay
    below one sample, some of these are in the future: the output is then that of `wait` samples ago. The first
    `settling` outputs depend on the initial state, the steady state of the first input.
    """
    output = _low_pass(discrete, sample, reading)
    sample.latency += discrete.wait
    sample.settling += discrete.settling
    if discrete.held == 1:
        return output
    ages = range(discrete.first, discrete.held)
    taps = zip(*sample.delayed("outputs", output, ages), strict=True)
    weighted = [
        sum(sp.Float(w) * y for w, y in zip(discrete.weights.tolist(), earlier, strict=True)) for earlier in taps
    ]
    return sample.assigned("delayed", weighted, about="delay: weighted sum of earlier outputs of the low-pass")


def _low_pass(discrete: DiscreteTransferFunction, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
    """x' = A x + B u, y = C x + D u in each channel."""
    order, channels = discrete.order, len(reading)
    a, b, c, d = (sp.Matrix(np.atleast_2d(m).tolist()) for m in (discrete.A, discrete.B, discrete.C, discrete.D))
    if not order:
        return reading if discrete.D == 1.0 else sample.assigned("scaled", [d[0] * r for r in reading])
    steady = [sp.Float(x) * r for r in reading for x in discrete.rest.tolist()]
    state = sample.state("low_pass", steady)
    x = [sp.Matrix(state[order * i : order * (i + 1)]) for i in range(channels)]
    output = [(c * channel_state)[0] + d[0] * r for channel_state, r in zip(x, reading, strict=True)]
    sample.keep(state, [e for channel_state, r in zip(x, reading, strict=True) for e in a * channel_state + b.T * r])
    return sample.assigned("filtered", output, about="low-pass: x' = A x + B load, out = C x + D load")


def _discretised(transfer: TransferFunction, dt: float) -> tuple[Array, Array, Array, Array]:
    """A (r, r), B (r, 1), C (1, r), D (1, 1) of x' = A x + B u, y = C x + D u by first-order hold."""
    numerator, denominator = transfer.numerator, transfer.denominator
    while len(denominator) > max(len(numerator), 1) and abs(denominator[0]) * FASTEST_POLE < abs(denominator[1]) * dt:
        denominator = denominator[1:]
    if len(denominator) == 1:
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[numerator[0] / denominator[0]]])
    a, b, c, d, _ = cont2discrete(tf2ss(numerator, denominator), dt, method="foh")
    return a, b, c, d


def _delay_line(delay: float) -> tuple[int, int, Array]:
    """For a delay in samples: latency, index of the first output used (0 is the current one), and weights."""
    whole = round(delay)
    if abs(delay - whole) < WHOLE_DELAY_TOLERANCE:
        return max(0, -whole), max(0, whole), np.ones(1)
    wait = max(0, 1 - int(np.floor(delay)))
    first = int(np.floor(delay + wait)) - 1
    place = delay + wait - first
    return wait, first, np.array([np.prod([(place - i) / (j - i) for i in range(4) if i != j]) for j in range(4)])
