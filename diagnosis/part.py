"""Part: some rows of a recording's whitened readings: half of them, or those that nothing which repeats can reach."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.noise import Noise
from estimation.whitening import LineWhitener, RegressionWhitener, Whitener

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PartWhitener(Whitener):
    """Some rows of another whitener."""

    whole: Whitener
    part: NDArray[np.intp]
    steady_part: int

    @property
    def rows(self) -> int:  # type: ignore[override]
        """The rows kept."""
        return len(self.part)

    @property
    def steady_rows(self) -> int:  # type: ignore[override]
        """Those of them that the motion reaches."""
        return self.steady_part

    def series(self, values: Array) -> Array:
        """Kept rows of a series over the whole record."""
        return np.asarray(self.whole.series(values)[self.part])

    def steady(self, values: Array) -> Array:
        """Kept rows of one repeat."""
        return np.asarray(self.whole.steady(values)[self.part[: self.steady_part]])


def halved(fitted: Fit) -> list[tuple[Noise, ...]]:
    """The noise of odd and even harmonics (both keep what lies between), of every second pose, or of a run's halves."""
    return [tuple(_half(noise, side) for noise in fitted.noise) for side in (0, 1)]


def _half(noise: Noise, side: int) -> Noise:
    whole = noise.whitener
    index = np.arange(whole.rows)
    if isinstance(whole, LineWhitener):
        per_line = whole.steady_rows // len(whole.motion)
        harmonic = np.repeat(whole.motion // whole.repeats, per_line)
        kept = np.concatenate([harmonic % 2 == side, np.ones(whole.rows - whole.steady_rows, dtype=bool)])
        kept[:per_line] = True
    elif isinstance(whole, RegressionWhitener) and not len(whole.coefficients) and whole.block == 1:
        kept = index // len(whole.root) % 2 == side
    else:
        kept = (index < whole.rows // 2) == (side == 0)
    steady = int(kept[: whole.steady_rows].sum())
    part = PartWhitener(whole, np.flatnonzero(kept), steady)
    return replace(noise, whitener=part, doubt=noise.doubt[kept])


def between(noise: Noise) -> Noise | None:
    """The noise of the lines between the motion's, which hold only what does not repeat; None where there are none."""
    whole = noise.whitener
    if not isinstance(whole, LineWhitener) or not len(whole.between):
        return None
    rows = np.arange(whole.steady_rows, whole.rows)
    lines = noise.frequency[len(whole.motion) :]
    return replace(noise, whitener=PartWhitener(whole, rows, 0), doubt=noise.doubt[rows], frequency=lines)
