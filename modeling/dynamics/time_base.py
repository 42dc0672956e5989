"""Sampling interval and periodicity of a record."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TimeBase:
    """Sampling interval `dt` (s), None for static poses; `periodic` for a record of whole periods in steady state.

    A record that is not periodic starts at zero velocity, in the static equilibrium of its first sample.
    """

    dt: float | None
    periodic: bool
