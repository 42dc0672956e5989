"""Clock: how the samples of a series lie in time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """`dt` (s) from sample to sample, None for poses at rest; `periodic` when the series repeats without pause.

    A series that does not repeat starts from rest, in the equilibrium of its first sample.
    """

    dt: float | None
    periodic: bool
