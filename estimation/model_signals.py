"""The signals that a model of a recording may take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.derivatives.differentiation import spline_derivatives
from estimation.recordings.recording import Recording

Array = NDArray[np.float64]


class ModelSignals(Mapping[str, Array]):
    """A recording's signals (n,) by name, auxiliary ones smoothed, each with its first use.

    Most models take no temperature or current, and smoothing one takes as long as differentiating a joint's angle.
    """

    def __init__(self, recording: Recording) -> None:
        progress = np.linspace(-1.0, 1.0, recording.samples)
        self._unsmoothed = {**recording.signals, "progress": progress}
        self._smoothed: dict[str, Array] = {}
        self._dt = recording.dt

        def changes(name: str) -> bool:
            return bool(np.ptp(recording.signals[name]) > 0)

        self._auxiliary = frozenset() if self._dt is None else frozenset(filter(changes, recording.auxiliary))

    def __getitem__(self, name: str) -> Array:
        series = self._unsmoothed[name]
        if name not in self._auxiliary or self._dt is None:
            return series
        if name not in self._smoothed:
            self._smoothed[name] = spline_derivatives(series[:, None], self._dt).value[:, 0]
        return self._smoothed[name]

    def __contains__(self, name: object) -> bool:
        return name in self._unsmoothed

    def __iter__(self) -> Iterator[str]:
        return iter(self._unsmoothed)

    def __len__(self) -> int:
        return len(self._unsmoothed)


_SIGNALS: WeakKeyDictionary[Recording, ModelSignals] = WeakKeyDictionary()
"""Of each recording as long as it lives."""


def model_signals(recording: Recording) -> Mapping[str, Array]:
    """The recording's signals, auxiliary ones smoothed, and `progress`, -1 to 1 over the record."""
    if recording not in _SIGNALS:
        _SIGNALS[recording] = ModelSignals(recording)
    return _SIGNALS[recording]
