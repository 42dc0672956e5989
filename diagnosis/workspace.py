"""Workspace: what all screenings of the same recordings in the same noise share, computed once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.progress import Announce
from diagnosis.workers import Workers
from estimation.directions import spanned
from estimation.noise import Noise

if TYPE_CHECKING:
    from diagnosis.background import Background
    from diagnosis.projection import Whitened
    from estimation.fit import Fit

Array = NDArray[np.float64]
Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")

DRAWS = 100
SEED = 0
"""Draws of pure noise from which a supremum over nuisance values takes its number of trials."""
MOST_BYTES = 120e6
"""Memory for whitened sensitivities that are kept from one screening to the next."""
MOST_FITS = 4
"""Fits whose directions are kept: those that are screened together, at most one for each effect of a set."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Draws of noise, whitened sensitivities that no fit changes, and what was screened already.

    Nothing in it depends on the order in which it is asked, nor on the number of `workers`.
    """

    workers: Workers = field(default_factory=Workers)
    _draws: dict[tuple[int, ...], Array] = field(default_factory=dict)
    _kept: OrderedDict[Hashable, Whitened] = field(default_factory=OrderedDict)
    _backgrounds: OrderedDict[Fit, Background] = field(default_factory=OrderedDict)
    _found: dict[Hashable, object] = field(default_factory=dict)

    def forget(self) -> None:
        """Let go of all that is kept: backgrounds and their workspace hold each other, and are large."""
        for kept in (self._draws, self._kept, self._backgrounds, self._found):
            kept.clear()
        spanned.cache_clear()

    def knows(self, key: Hashable) -> bool:
        """Whether something was made of a key already."""
        return key in self._found

    def recent(self, fit: Fit, make: Callable[[], Background]) -> Background:
        """A fit as a new effect sees it; the few last asked for are kept."""
        if fit not in self._backgrounds:
            self._backgrounds[fit] = make()
            while len(self._backgrounds) > MOST_FITS:
                self._backgrounds.popitem(last=False)
        self._backgrounds.move_to_end(fit)
        return self._backgrounds[fit]

    def draws(self, noise: Sequence[Noise]) -> Array:
        """Pure noise (rows, DRAWS) over all rows; always the same, so that a p-value repeats."""
        key = tuple(n.whitener.rows for n in noise)
        if key not in self._draws:
            self._draws.clear()
            self._draws[key] = np.random.default_rng(SEED).standard_normal((sum(key), DRAWS))
        return self._draws[key]

    def whitened(self, key: Hashable | None, make: Callable[[], Whitened]) -> Whitened:
        """Whitened sensitivities by what they depend on, the oldest dropped when memory runs out; None is not kept."""
        if key is None:
            return make()
        if key not in self._kept:
            made = make()
            if made.bytes > MOST_BYTES / 2:
                return made
            self._kept[key] = made
            while sum(w.bytes for w in self._kept.values()) > MOST_BYTES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def each(
        self,
        keys: Sequence[Key],
        make: Callable[[Key], Result],
        *,
        label: Callable[[Key], str] | None = None,
        shared: Sequence[object] = (),
        announce: Announce | None = None,
    ) -> list[Result]:
        """What is made of each key, by all workers, and of none twice."""
        new = [key for key in keys if key not in self._found]
        made = self.workers.map(make, new, label=label, shared=shared, announce=announce)
        self._found.update(zip(new, made, strict=True))
        return [self._found[key] for key in keys]  # type: ignore[misc]
