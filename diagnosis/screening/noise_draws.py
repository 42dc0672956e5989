"""White noise that score tests share: seeded, so that p-values are reproducible."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from mmap import mmap

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.recording import Recording

Array = NDArray[np.float32]

NOISE_DRAWS = 100
NOISE_SEED = 0
"""Draws (and their seed) that give a search its effective number of tests."""
ROWS_AT_ONCE = 1000
"""Rows drawn together, few enough to be rounded while they are in the cache."""


@dataclass(eq=False)
class NoiseDraws:
    """Draws (rows, NOISE_DRAWS) of white noise of unit variance; the first rows are the same however many are drawn.

    In single precision: their quantiles are known to a part in ten, and their inner products take half the time.
    Those `shared_for` recordings are in memory that processes forked afterwards share: what one of them draws, all
    have; should two draw at once, they write the same numbers.
    """

    _values: Array = field(default_factory=lambda: np.zeros((0, NOISE_DRAWS), np.float32))
    _drawn: int = 0

    @classmethod
    def shared_for(cls, recordings: Iterable[Recording]) -> NoiseDraws:
        """With room for the whitened rows of recordings, not drawn yet.

        Without room where only a fit tells how many rows there are, or where memory for all of them is refused.
        The rows are two for each channel and Fourier line of a recording whose repeats follow one another.
        """
        several = tuple(recordings)
        if not several or any(r.repeats == 1 or not r.continuous for r in several):
            return cls()
        rows = sum((r.samples + 2) * len(r.channels) for r in several)
        try:
            memory = mmap(-1, rows * NOISE_DRAWS * np.dtype(np.float32).itemsize)
        except OSError:
            return cls()
        return cls(np.frombuffer(memory, np.float32, rows * NOISE_DRAWS).reshape(rows, NOISE_DRAWS))

    def draw(self) -> int:
        """Draw all rows there is room for; return how many, for `mark_drawn` of other processes."""
        rng = np.random.default_rng(NOISE_SEED)
        for first in range(0, len(self._values), ROWS_AT_ONCE):
            part = self._values[first : first + ROWS_AT_ONCE]
            part[:] = rng.standard_normal(part.shape)
        self.mark_drawn(len(self._values))
        return len(self._values)

    def mark_drawn(self, rows: int) -> None:
        """Take the first rows, which another process has drawn, for drawn."""
        self._drawn = rows

    def first(self, rows: int) -> Array:
        """The first rows, drawn where they are not yet; not to be written to."""
        if rows > self._drawn:
            if rows > len(self._values):
                self._values = np.empty((rows, NOISE_DRAWS), np.float32)
            self.draw()
        return self._values[:rows]

    def forget(self) -> None:
        """Release the memory."""
        self._values, self._drawn = np.zeros((0, NOISE_DRAWS), np.float32), 0
