"""Derivatives of the series that were smoothed last: what is read, checked, mounted and fitted is smoothed once."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.derivatives.series_derivatives import Derivatives
from estimation.recordings.derivatives.smoothing_spline import SmoothingSpline

KEPT_BYTES = 64_000_000
"""Of all that is kept, by this process: about ten motions with position of ten minutes at 100 Hz."""


class RecentDerivatives:
    """Derivatives by the content of what they come from; the ones not used for longest go first.

    A recording is copied with another rig, other readings or a report, and reading reports and the evidence of frames
    look at its motion before a fit does. The content, not the object, says that nothing has changed.
    """

    def __init__(self, limit: int = KEPT_BYTES) -> None:
        self.limit = limit
        self._kept: OrderedDict[bytes, tuple[Derivatives, SmoothingSpline]] = OrderedDict()
        self._lock = Lock()

    def get(
        self, source: tuple[NDArray[Any], ...], derive: Callable[[], tuple[Derivatives, SmoothingSpline]]
    ) -> tuple[Derivatives, SmoothingSpline]:
        """Derivatives and their spline that follow from the arrays `source`, by `derive` where they are not kept."""
        key = _digest(source)
        with self._lock:
            known = self._kept.get(key)
            if known is not None:
                self._kept.move_to_end(key)
                return known
        found = derive()
        for array in (found[0].value, found[0].score, found[1].spline.coefficients, found[1].factor):
            array.flags.writeable = False  # others get the same ones
        if _bytes(found) > self.limit:  # it would drive out all others
            return found
        with self._lock:
            self._kept[key] = found
            while self.size > self.limit:
                self._kept.popitem(last=False)
        return found

    @property
    def size(self) -> int:
        """Bytes of all that is kept."""
        return sum(map(_bytes, self._kept.values()))


def _digest(arrays: tuple[NDArray[Any], ...]) -> bytes:
    digest = hashlib.blake2b(digest_size=32)
    for array in arrays:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def _bytes(kept: tuple[Derivatives, SmoothingSpline]) -> int:
    found, spline = kept
    arrays = (found.value, found.first, found.second, spline.spline.coefficients, spline.factor)
    return sum(array.nbytes for array in arrays)
