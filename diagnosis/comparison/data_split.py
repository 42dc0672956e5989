"""Splits of the whitened rows: halves for cross-validation, and the non-excited lines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, Whitener

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RowSubsetWhitener(Whitener):
    """A subset of another whitener's rows, `part`; its first `excited_row_count` rows are excited."""

    whole: Whitener
    part: NDArray[np.intp]
    excited_row_count: int

    @property
    def rows(self) -> int:  # type: ignore[override]
        """Number of rows in the subset."""
        return len(self.part)

    @property
    def periodic_rows(self) -> int:  # type: ignore[override]
        """Number of them on excited lines."""
        return self.excited_row_count

    def series(self, values: Array) -> Array:
        """The subset's rows of a series over the whole record."""
        return np.asarray(self.whole.series(values)[self.part])

    def steady_state(self, values: Array) -> Array:
        """The subset's rows of a series over one repeat."""
        return np.asarray(self.whole.steady_state(values)[self.part[: self.excited_row_count]])


def half_splits(fitted: Fit) -> list[tuple[RecordingNoise, ...]]:
    """Noise restricted to even and to odd harmonics (both with the non-excited lines), to every second pose, or to the
    halves of a run."""
    return [tuple(_half_split(noise, side) for noise in fitted.noise) for side in (0, 1)]


def _half_split(noise: RecordingNoise, side: int) -> RecordingNoise:
    whole = noise.whitener
    index = np.arange(whole.rows)
    if isinstance(whole, FourierLineWhitener):
        per_line = whole.periodic_rows // len(whole.excited_lines)
        harmonic = np.repeat(whole.excited_lines // whole.repeats, per_line)
        kept = np.concatenate([harmonic % 2 == side, np.ones(whole.rows - whole.periodic_rows, dtype=bool)])
        kept[:per_line] = True
    elif isinstance(whole, AutoregressiveWhitener) and whole.noise.is_white:
        kept = index // len(whole.noise.covariance) % 2 == side
    else:
        kept = (index < whole.rows // 2) == (side == 0)
    excited = int(kept[: whole.periodic_rows].sum())
    part = RowSubsetWhitener(whole, np.flatnonzero(kept), excited)
    return replace(noise, whitener=part, log_power_variance=noise.log_power_variance[kept])


def non_excited_noise(noise: RecordingNoise) -> RecordingNoise | None:
    """Noise restricted to the non-excited lines, on which nothing periodic acts; None where there are none."""
    whole = noise.whitener
    if not isinstance(whole, FourierLineWhitener) or not len(whole.non_excited_lines):
        return None
    rows = np.arange(whole.periodic_rows, whole.rows)
    lines = noise.frequency[len(whole.excited_lines) :]
    return replace(
        noise,
        whitener=RowSubsetWhitener(whole, rows, 0),
        log_power_variance=noise.log_power_variance[rows],
        frequency=lines,
    )
