"""Rate: a number of events among so many surrogates, with its exact interval and test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimation.distributions import binomial_interval, binomial_sf
from modeling.significance import LEVELS


@dataclass(frozen=True)
class Rate:
    """A number of events among so many surrogates."""

    count: int
    total: int

    @property
    def share(self) -> float:
        """The estimated probability."""
        return self.count / max(self.total, 1)

    @property
    def interval(self) -> tuple[float, float]:
        """Its exact 95 % confidence interval (Clopper and Pearson, 1934)."""
        return binomial_interval(self.count, self.total, LEVELS.confidence)

    def exceeds(self, probability: float) -> bool:
        """Whether so many events are too many for that probability (one-sided, `LEVELS.miscalibrated`)."""
        return binomial_sf(self.count, self.total, probability) < LEVELS.miscalibrated

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.count} of {self.total} (95 % interval {100 * low:.2g} to {100 * high:.2g} %)"

    def to_data(self) -> dict[str, Any]:
        """Count, total, share and interval."""
        return {"count": self.count, "total": self.total, "rate": self.share, "interval": list(self.interval)}
