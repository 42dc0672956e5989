"""Running memory: a transfer function applied sample by sample."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, tf2ss

from modeling.memory import Transfer

Array = NDArray[np.float64]

FORGOTTEN = 1e-3
"""Share of a wrong start that may still be there when the first output counts: of a load of 100 N, a tenth of one."""
WHOLE = 1e-9
"""Samples by which a delay may miss a whole number of them: the rounding of its ratio to the step."""
FASTEST = 1e9
"""Poles times the step beyond which a lag is none: it dies away in the step by more than numbers can tell."""


@dataclass(frozen=True, eq=False)
class SampledMemory:
    """H(s) in steps of dt, in numbers: of an input u that is straight between samples, its ratio of polynomials is

    x' = A x + B u, y = C x + D u, with x = `rest` u where u has always been. The delay then takes the outputs from the
    `first` on (0 is now) times `weights`, which gives the output of `wait` samples ago.

    A (r, r), B (r,), C (r,), D, rest (r,), weights (1,) or (4,); of a wrong start less than FORGOTTEN is left after
    `settling` outputs.
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
    def of(cls, transfer: Transfer, dt: float) -> Self:
        """The transfer function in steps of dt (s)."""
        a, b, c, d = _discretised(transfer, dt)
        wait, first, weights = _line(transfer.delay / dt)
        fading = int(np.ceil(-np.log(FORGOTTEN) * transfer.lasting / dt))
        return cls(
            A=a,
            B=b[:, 0],
            C=c[0],
            D=float(d[0, 0]),
            rest=np.asarray(np.linalg.solve(np.eye(len(a)) - a, b[:, 0]), dtype=float),
            wait=wait,
            first=first,
            weights=weights,
            settling=first + len(weights) - 1 + fading,
        )

    @property
    def order(self) -> int:
        """The number of states r."""
        return len(self.B)

    @property
    def held(self) -> int:
        """How many outputs of the ratio have to be kept for the delay, the one of now included."""
        return self.first + len(self.weights)


class RunningMemory:
    """H(s) in steps of dt, of input samples (p,) that are joined by straight lines.

    The ratio of polynomials is exact for such input (first-order hold): of a smooth one at the angular frequency w the
    part (w dt)² / 12 is lost. The delay comes after it: whole samples, and between them the cubic through the four
    nearest outputs, two on either side, wrong by less than (w dt)⁴ / 42 of a sine. For a lead, or a fraction of the
    first sample, some of these are still to come: then what comes out is the output of `wait` samples ago.
    It starts as if its first input had always been there; `settling` outputs at the start depend on that.
    """

    def __init__(self, transfer: Transfer, dt: float) -> None:
        self.sampled = SampledMemory.of(transfer, dt)
        self._state: Array | None = None
        self._outputs: deque[Array] = deque(maxlen=self.sampled.held)

    @property
    def wait(self) -> int:
        """Samples by which the output is older than the input."""
        return self.sampled.wait

    @property
    def settling(self) -> int:
        """How many outputs depend on what was before the first input."""
        return self.sampled.settling

    def step(self, value: Array) -> Array:
        """The output (p,) of `wait` samples ago, given the input (p,) of now."""
        step = self.sampled
        if self._state is None:
            self._state = np.outer(step.rest, value)
            self._outputs.extend([step.C @ self._state + step.D * value] * step.held)
        self._outputs.appendleft(step.C @ self._state + step.D * value)
        self._state = step.A @ self._state + np.outer(step.B, value)
        late = [self._outputs[step.first + i] for i in range(len(step.weights))]
        return np.asarray(step.weights @ np.stack(late))


def _discretised(transfer: Transfer, dt: float) -> tuple[Array, Array, Array, Array]:
    """A (r, r), B (r, 1), C (1, r), D (1, 1) of x' = A x + B u, y = C x + D u for input u straight between samples."""
    above, below = transfer.numerator, transfer.denominator
    while len(below) > max(len(above), 1) and abs(below[0]) * FASTEST < abs(below[1]) * dt:
        below = below[1:]
    if len(below) == 1:
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[above[0] / below[0]]])
    a, b, c, d, _ = cont2discrete(tf2ss(above, below), dt, method="foh")
    return a, b, c, d


def _line(delay: float) -> tuple[int, int, Array]:
    """For a delay in samples: samples to wait, the first of the outputs that count (0 is now), and their weights."""
    whole = round(delay)
    if abs(delay - whole) < WHOLE:
        return max(0, -whole), max(0, whole), np.ones(1)
    wait = max(0, 1 - int(np.floor(delay)))
    first = int(np.floor(delay + wait)) - 1
    place = delay + wait - first
    return wait, first, np.array([np.prod([(place - i) / (j - i) for i in range(4) if i != j]) for j in range(4)])
