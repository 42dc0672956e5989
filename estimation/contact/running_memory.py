"""Running memory: a transfer function applied sample by sample."""

from __future__ import annotations

from collections import deque

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


class RunningMemory:
    """H(s) in steps of dt, of input samples (p,) that are joined by straight lines.

    The ratio of polynomials is exact for such input (first-order hold): of a smooth one at the angular frequency w the
    part (w dt)² / 12 is lost. The delay comes after it: whole samples, and between them the cubic through the four
    nearest outputs, two on either side, wrong by less than (w dt)⁴ / 42 of a sine. For a lead, or a fraction of the
    first sample, some of these are still to come: then what comes out is the output of `wait` samples ago.
    It starts as if its first input had always been there; `settling` outputs at the start depend on that.
    """

    def __init__(self, transfer: Transfer, dt: float) -> None:
        self._step = _discretised(transfer, dt)
        self.wait, self._first, self._weights = _line(transfer.delay / dt)
        self.settling = self._first + len(self._weights) - 1 + int(np.ceil(-np.log(FORGOTTEN) * transfer.lasting / dt))
        self._state: Array | None = None
        self._outputs: deque[Array] = deque(maxlen=self._first + len(self._weights))

    def step(self, value: Array) -> Array:
        """The output (p,) of `wait` samples ago, given the input (p,) of now."""
        a, b, c, d = self._step
        if self._state is None:
            self._state = np.asarray(np.linalg.solve(np.eye(len(a)) - a, b * value), dtype=float)
            self._outputs.extend([(c @ self._state + d * value)[0]] * (self._first + len(self._weights)))
        self._outputs.appendleft((c @ self._state + d * value)[0])
        self._state = np.asarray(a @ self._state + b * value)
        late = [self._outputs[self._first + i] for i in range(len(self._weights))]
        return np.asarray(self._weights @ np.stack(late))


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
