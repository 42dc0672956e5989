"""Cache shared by score tests in the same noise: noise draws, whitened sensitivities, search results."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.progress import CountCallback, counted
from diagnosis.screening.noise_draws import NoiseDraws
from estimation.fit_column_space import fit_column_space
from estimation.noise.recording_noise import RecordingNoise

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")


class SizedColumns(Protocol):
    """An object that knows its size in memory."""

    @property
    def bytes(self) -> int: ...


Columns = TypeVar("Columns", bound=SizedColumns)

MAX_BYTES = 120e6
"""Memory (bytes) for cached whitened sensitivities."""
MAX_FITS = 4
"""Null models cached: those screened together, at most one for each effect of a set."""


@dataclass(frozen=True, eq=False)
class ScreeningCache:
    """Noise draws, whitened sensitivities that do not depend on the fit, null models, and finished searches.

    Its contents do not depend on the order of requests.
    """

    noise_draws: NoiseDraws = field(default_factory=NoiseDraws)
    _sensitivities: OrderedDict[Hashable, Any] = field(default_factory=OrderedDict)
    _null_models: OrderedDict[Hashable, Any] = field(default_factory=OrderedDict)
    _found: dict[Hashable, object] = field(default_factory=dict)
    _drawn_motions: dict[Hashable, Any] = field(default_factory=dict)
    _motions: dict[Hashable, Any] = field(default_factory=dict)

    def forget(self) -> None:
        """Empty the cache but for the noise draws: null models and their cache refer to each other, and are large."""
        for cache in (self._sensitivities, self._null_models, self._found, self._drawn_motions, self._motions):
            cache.clear()
        fit_column_space.cache_clear()

    def in_other_noise(self) -> ScreeningCache:
        """An empty cache for score tests in another noise, with the same noise draws and drawn motions."""
        return ScreeningCache(self.noise_draws, _motions=self._motions)

    def null_model(self, fit: Hashable, make: Callable[[], Result]) -> Result:
        """The null model of a fit; the MAX_FITS used last are cached."""
        if fit not in self._null_models:
            self._null_models[fit] = make()
            while len(self._null_models) > MAX_FITS:
                self._null_models.popitem(last=False)
        self._null_models.move_to_end(fit)
        found: Result = self._null_models[fit]
        return found

    def drawn_motion(self, fit: Hashable, make: Callable[[], Result]) -> Result:
        """What was drawn of the motion of a fit; that of the last fit is cached."""
        return _last_made(self._drawn_motions, fit, make)

    def motions(self, recordings: Hashable, make: Callable[[], Result]) -> Result:
        """Motions drawn for recordings, whatever is fitted to them; those drawn last are cached."""
        return _last_made(self._motions, recordings, make)

    def draws(self, noise: Sequence[RecordingNoise]) -> NDArray[np.float32]:
        """White noise (rows, NOISE_DRAWS) over all rows."""
        return self.noise_draws.first(sum(n.whitener.rows for n in noise))

    def whitened(self, key: Hashable | None, make: Callable[[], Columns]) -> Columns:
        """Whitened sensitivities by key; the least recently used are dropped beyond MAX_BYTES. None is not cached."""
        if key is None:
            return make()
        if key not in self._sensitivities:
            made = make()
            if made.bytes > MAX_BYTES / 2:
                return made
            self._sensitivities[key] = made
            while sum(w.bytes for w in self._sensitivities.values()) > MAX_BYTES:
                self._sensitivities.popitem(last=False)
        self._sensitivities.move_to_end(key)
        found: Columns = self._sensitivities[key]
        return found

    def results(
        self, keys: Sequence[Key], make: Callable[[Key], Result], announce: CountCallback | None = None
    ) -> list[Result]:
        """The result of each key, computed once."""
        for key in counted([key for key in keys if key not in self._found], announce):
            self._found[key] = make(key)
        return [self._found[key] for key in keys]  # type: ignore[misc]


def _last_made(kept: dict[Hashable, Any], key: Hashable, make: Callable[[], Result]) -> Result:
    """The result of a key, made unless it was the last one; only the last is kept."""
    if key not in kept:
        kept.clear()
        kept[key] = make()
    found: Result = kept[key]
    return found
