"""States from which an arm can keep its limits for ever (viability kernel)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.limits.rig_limits import require_zero_inside
from modeling.rig.rig import Limits

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ViableStates:
    """States (q, dq, ddq), (3n,), of trajectories that have kept their limits before and can keep them ever after.

    Joint by joint, with the limits q_low <= q <= q_high and -b <= ddq <= a, both a and b positive. At the time t let
    v = dq > 0. Afterwards dq(t + s) >= v - b s, so that the joint moves v²/(2b) at least until it stops; before,
    dq(t - s) >= v - a s, so that it has moved v²/(2a) at least since it was last at rest. Both ends are within the
    limits: q + v²/(2b) <= q_high and q - v²/(2a) >= q_low. With v < 0 braking is by a and speeding up was by b:
    q - v²/(2a) >= q_low and q + v²/(2b) <= q_high. These are the same two conditions, so for either sign of dq

        q_low + dq²/(2a)  <=  q  <=  q_high - dq²/(2b).

    A periodic trajectory with continuous dq and ddq within its limits almost everywhere meets them at every instant,
    since dq has mean zero and so vanishes before and after. The two ends meet at the largest speed, `speeds`.

    Raises InputError unless velocity and acceleration of each joint may have both signs.
    """

    limits: Limits

    def __post_init__(self) -> None:
        require_zero_inside(self.limits)

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return self.limits.joints

    @cached_property
    def braking(self) -> tuple[Array, Array]:
        """1/(2a) and 1/(2b), each (n,): braking distance at the low and the high end of q over dq²."""
        low, high = self.limits.acceleration.T
        return 1 / (2 * high), -1 / (2 * low)

    @cached_property
    def speeds(self) -> Array:
        """(n, 2): the velocity limits, or the speed at which the two ends of q meet where that is less."""
        stop = np.sqrt(np.ptp(self.limits.position, axis=1) / sum(self.braking))
        low, high = self.limits.velocity.T
        return np.stack([np.maximum(low, -stop), np.minimum(high, stop)], axis=1)

    @cached_property
    def vertices(self) -> Array:
        """(2^n, n): the extreme accelerations."""
        return np.array(list(product(*self.limits.acceleration)))

    def ends(self, dq: Any) -> tuple[Any, Any]:
        """Low and high end of viable q at velocities dq: arrays (N, n), or CasADi columns (n,)."""
        below, above = self.braking
        low, high = self.limits.position.T
        return low + below * dq**2, high - above * dq**2

    def phase(self, point: Any) -> tuple[Any, Any]:
        """q and dq of a point of the cube [-1, 1]^2n, which is mapped onto all viable (q, dq).

        The second half of the point scales dq between `speeds`, the first q between `ends`; arrays (N, 2n), or a
        CasADi column (2n,).
        """
        n = self.joints
        position, rate = (point[:, :n], point[:, n:]) if isinstance(point, np.ndarray) else (point[:n], point[n:])
        middle, half = self.speeds.mean(axis=1), np.ptp(self.speeds, axis=1) / 2
        dq = middle + half * rate
        low, high = self.ends(dq)
        return low + (high - low) * (position + 1) / 2, dq

    def excess(self, q: Array, dq: Array, ddq: Array) -> Array:
        """(N,): largest violation by states, in shares of the limits' half widths; negative inside."""
        low, high = self.ends(dq)
        position = np.maximum(low - q, q - high) / (np.ptp(self.limits.position, axis=1) / 2)
        others = [_violation(dq, self.limits.velocity), _violation(ddq, self.limits.acceleration)]
        return np.asarray(np.max([position, *others], axis=(0, 2)), dtype=float)


def _violation(values: Array, pairs: Array) -> Array:
    """Excess (N, n) of values over [low, high] (n, 2), in half widths; negative inside."""
    low, high = pairs.T
    return np.asarray(np.maximum(low - values, values - high) / ((high - low) / 2))
