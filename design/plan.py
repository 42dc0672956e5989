"""Plan: a designed motion, what it will tell, and how far it is from the best that any motion could."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.bound import AlongMotion, Bound, Kind
from design.criterion import Criterion, DOptimal
from design.information import Experiment
from design.limit_use import LimitUse
from design.motion.series import Motion
from design.optimiser.optimiser import Attempt, Task
from design.sample_information import SampleInformation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """The best motion found, with all that it was judged by.

    task         what was optimised, within which limits
    experiment   the readings at the values of the parameters, weighted by the noise where there is one
    attempts     local optima of the series, best first
    evaluations  of the criterion, over all starts
    bound        on ln det of any periodic motion; None where there is none, and then `unbounded` says why
    """

    task: Task
    experiment: Experiment
    attempts: tuple[Attempt, ...]
    evaluations: int
    bound: Bound | None
    unbounded: str = ""

    @property
    def motion(self) -> Motion:
        """The motion, within its limits at every instant."""
        return self.attempts[0].motion

    @property
    def criterion(self) -> Criterion:
        """What it is the best in."""
        return self.task.objective.criterion

    @property
    def samples(self) -> int:
        """Samples of one run."""
        return self.task.objective.samples

    @cached_property
    def logdet(self) -> float:
        """ln det(Phi' Phi) over the samples, unweighted SI (22.11)."""
        unweighted = replace(self.experiment, noise=None)
        return DOptimal().value(unweighted.information(self.motion, self.samples))

    @property
    def efficiency(self) -> float | None:
        """exp((ln det - bound) / k): with this share of the samples the bound would tell as much."""
        return None if self.bound is None or not isfinite(self.logdet) else self.bound.efficiency(self.logdet)

    @cached_property
    def limit_use(self) -> LimitUse:
        """How much of each limit it uses, between the samples too."""
        return self.task.use(self.motion)

    @cached_property
    def along(self) -> AlongMotion | None:
        """What the bound's dual says along the motion, and how far its samples are from its mean over time."""
        return None if self.bound is None else self.bound.along(self.motion)

    @cached_property
    def sample_information(self) -> SampleInformation:
        """Which samples tell how much."""
        time = self.motion.series.instants(self.samples)
        periodic = self.motion.series.periodic
        columns = self.experiment.columns(*self.motion.evaluate(time), self.motion.period, periodic=periodic)
        return SampleInformation.of(columns, [p.name for p in self.experiment.parameters])

    @cached_property
    def covariance(self) -> Array:
        """(k, k): what the noise makes of the parameters' estimates; where none is stated, noise of 1 in SI."""
        information = self.experiment.information(self.motion, self.samples)
        return np.asarray(np.linalg.pinv(information, hermitian=True), dtype=float)

    def to_data(self) -> dict[str, Any]:
        """The JSON of `truewrench design` (FORMATS)."""
        bound = self.bound
        return {
            "logdet": _finite(self.logdet),
            "samples": self.samples,
            "period": self.motion.period,
            "bound_logdet": None if bound is None else bound.logdet,
            "bound_kind": None if bound is None else bound.kind.value,
            "efficiency": self.efficiency,
            "worst_limit_use": self.limit_use.to_data(),
            "evaluations": self.evaluations,
            "criterion": str(self.criterion),
            "criterion_value": _finite(self.attempts[0].value),
            "outcome": self.attempts[0].outcome.name.lower(),
            "reached": [_finite(attempt.value) for attempt in self.attempts],
            "std": self._std(),
            "unbounded": self.unbounded or None,
        }

    def _std(self) -> dict[str, float | None]:
        names = [p.name for p in self.experiment.parameters]
        if not isfinite(self.logdet):
            return dict.fromkeys(names)
        return dict(zip(names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def rows(self) -> list[tuple[str, str]]:
        """The table: what, and its value."""
        best, others = self.attempts[0], self.attempts[1:]
        reached = ", ".join(f"{attempt.value:.2f}" for attempt in others)
        return [
            ("motion", f"{self.motion.series}, {self.samples} samples in {self.motion.period:g} s"),
            ("ln det(Phi' Phi)", f"{self.logdet:.3f}, unweighted SI"),
            *self._criterion(),
            *self._bound(),
            ("limits", self.limit_use.sentence()),
            ("optimiser", f"{best.outcome.value}; {self.evaluations} evaluations"),
            *([("contraction", f"into the limits, at a cost of {best.lost:.4f}")] if best.lost else []),
            *([("other starts", f"reached {reached}")] if others else []),
        ]

    def _criterion(self) -> list[tuple[str, str]]:
        weight = "unweighted SI" if self.experiment.noise is None else "weighted by the noise"
        if isinstance(self.criterion, DOptimal) and self.experiment.noise is None:
            return []
        return [("criterion", f"{self.criterion} = {self.attempts[0].value:.3f}, {weight}")]

    def _bound(self) -> list[tuple[str, str]]:
        bound, along = self.bound, self.along
        if bound is None or along is None or self.efficiency is None:
            return [("upper bound", f"none: {self.unbounded or 'the motion does not show every parameter'}")]
        told, sure = dict(bound.rows()), " if the check holds" if bound.kind is Kind.CHECKED else ""
        return [
            ("upper bound", f"{bound.logdet:.3f} for any periodic motion within these limits ({bound.kind.value})"),
            ("efficiency", f"{self.efficiency:.3f}{sure}: the share of the samples that the bound would need"),
            ("checked", told["checked"]),
            ("proven", told["proven"]),
            ("samples", f"{along.quadrature:+.4f} in ln det against the mean over time, which the bound is for"),
        ]

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name.ljust(width)}  {value}" for name, value in rows)


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None
