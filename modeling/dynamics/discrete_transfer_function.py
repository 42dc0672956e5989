"""First-order-hold discretisation of a transfer function, and its recursive filter."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, tf2ss

from modeling.dynamics.transfer_function import TransferFunction

Array = NDArray[np.float64]

INITIAL_STATE_SHARE = 1e-3
"""Fraction of a wrong initial state left when the transient counts as settled: 0.1 N of a load of 100 N."""
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
        decay = int(np.ceil(-np.log(INITIAL_STATE_SHARE) * transfer.lasting / dt))
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


class TransferFunctionFilter:
    """Recursive filter H(s) with step dt, for input samples (p,) joined by straight lines.

    The rational part is exact for such input (first-order hold); for a sine at the angular frequency w the relative
    error is (w dt)² / 12. The delay follows: whole samples, and in between cubic interpolation of the four nearest
    outputs, two on either side, with an error below (w dt)⁴ / 42 for a sine. For a lead, or a delay below one sample,
    some of these are in the future: the filter then returns the output of `wait` samples ago.
    The initial state is the steady state of the first input; the first `settling` outputs depend on it.
    """

    def __init__(self, transfer: TransferFunction, dt: float) -> None:
        self.sampled = DiscreteTransferFunction.of(transfer, dt)
        self._state: Array | None = None
        self._outputs: deque[Array] = deque(maxlen=self.sampled.held)

    @property
    def wait(self) -> int:
        """Latency of the output, samples."""
        return self.sampled.wait

    @property
    def settling(self) -> int:
        """Number of first outputs that depend on the initial state."""
        return self.sampled.settling

    def step(self, value: Array) -> Array:
        """The output (p,) of `wait` samples ago, given the current input (p,)."""
        step = self.sampled
        if self._state is None:
            self._state = np.outer(step.rest, value)
            self._outputs.extend([step.C @ self._state + step.D * value] * step.held)
        self._outputs.appendleft(step.C @ self._state + step.D * value)
        self._state = step.A @ self._state + np.outer(step.B, value)
        delayed = [self._outputs[step.first + i] for i in range(len(step.weights))]
        return np.asarray(step.weights @ np.stack(delayed))


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
