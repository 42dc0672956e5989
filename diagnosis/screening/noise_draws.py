"""White noise that score tests share: seeded, so that p-values are reproducible."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from mmap import mmap

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.recording import Recording

Array = NDArray[np.float64]

NOISE_DRAWS = 100
NOISE_SEED = 0
"""Draws (and their seed) that give a search its effective number of tests."""


@dataclass(eq=False)
class NoiseDraws:
    """Draws (rows, NOISE_DRAWS) of white noise of unit variance; the first rows are the same however many are drawn.

    Those `shared_for` recordings are in memory that processes forked afterwards share: one of them draws for all.
    """

    _values: Array = field(default_factory=lambda: np.zeros((0, NOISE_DRAWS)))
    _drawn: int = 0

    @classmethod
    def shared_for(cls, recordings: Iterable[Recording]) -> NoiseDraws:
        """With room for the whitened rows of recordings, not drawn yet; none where only a fit tells how many there are.

        Those are two for each channel and Fourier line of a recording whose repeats follow one another.
        """
        several = tuple(recordings)
        if any(r.repeats == 1 or not r.continuous for r in several):
            return cls()
        room = sum((r.samples + 2) * len(r.channels) for r in several) * NOISE_DRAWS
        return cls(np.frombuffer(mmap(-1, room * np.dtype(np.float64).itemsize), count=room).reshape(-1, NOISE_DRAWS))

    def draw(self) -> int:
        """Draw all rows there is room for; return how many, for `mark_drawn` of other processes."""
        np.random.default_rng(NOISE_SEED).standard_normal(out=self._values)
        self.mark_drawn(len(self._values))
        return len(self._values)

    def mark_drawn(self, rows: int) -> None:
        """Take the first rows, which another process has drawn, for drawn."""
        self._drawn = rows

    def first(self, rows: int) -> Array:
        """The first rows, drawn where they are not yet; not to be written to."""
        if rows > self._drawn:
            if rows > len(self._values):
                self._values = np.empty((rows, NOISE_DRAWS))
            self.draw()
        return self._values[:rows]

    def forget(self) -> None:
        """Release the memory."""
        self._values, self._drawn = np.zeros((0, NOISE_DRAWS)), 0
