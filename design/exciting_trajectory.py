"""Result of a design: the exciting trajectory with its information, limit use, upper bound and efficiency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from design.bound import BoundKind, DualityBound, WeakDuality
from design.criteria import Criterion, DOptimal
from design.information import Experiment
from design.information.sample_information import SampleInformation
from design.limits import LimitUse
from design.optimiser.design_task import DesignTask
from design.optimiser.local_optimum import LocalOptimum
from design.trajectories.trajectory import Trajectory
from modeling.number_format import finite
from modeling.table import Table, Tabular

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


class DesignInterrupted(KeyboardInterrupt):
    """A design that was interrupted, with its result so far: `best`, None before any trajectory within the limits."""

    def __init__(self, best: Any = None) -> None:
        super().__init__()
        self.best = best


@dataclass(frozen=True, eq=False, kw_only=True)
class ExcitingTrajectory(Tabular):
    """The best trajectory found, with its optimisation problem, local optima and upper bound.

    task          objective and limits of the optimisation
    experiment    sensitivities at the values of the parameters, weighted by the noise where there is one
    local_optima  of the series, best first
    searched      the stages of the search before the refinement, each with the values of its starts, best first
    evaluations   of the criterion, over all starts
    bound         on ln det of any periodic trajectory; None where there is none, for the `no_bound_reason`
    """

    task: DesignTask
    experiment: Experiment
    local_optima: tuple[LocalOptimum, ...]
    evaluations: int
    bound: DualityBound | None
    no_bound_reason: str = ""
    searched: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @property
    def motion(self) -> Trajectory:
        """The trajectory, within its limits at every instant."""
        return self.local_optima[0].motion

    @property
    def criterion(self) -> Criterion:
        """The optimality criterion."""
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
        """exp((ln det - bound) / k): the share of the samples with which the bound would be as informative."""
        return None if self.bound is None or not isfinite(self.logdet) else self.bound.efficiency(self.logdet)

    @cached_property
    def limit_use(self) -> LimitUse:
        """Use of each limit, between the samples too."""
        return self.task.use(self.motion)

    @cached_property
    def weak_duality(self) -> WeakDuality | None:
        """Weak duality checked along the trajectory, and the quadrature error of its samples."""
        return None if self.bound is None else self.bound.weak_duality(self.motion)

    @cached_property
    def sample_information(self) -> SampleInformation:
        """Contribution of each sample to the information."""
        time = self.motion.series.instants(self.samples)
        periodic = self.motion.series.periodic
        columns = self.experiment.columns(*self.motion.evaluate(time), self.motion.period, periodic=periodic)
        return SampleInformation.of(columns, [p.name for p in self.experiment.parameters])

    @cached_property
    def covariance(self) -> Array:
        """(k, k): covariance of the efficient estimates; noise of 1 in SI where none is stated."""
        information = self.experiment.information(self.motion, self.samples)
        return np.asarray(np.linalg.pinv(information, hermitian=True), dtype=float)

    def to_data(self) -> dict[str, Any]:
        """The JSON of `truewrench design` (FORMATS)."""
        bound = self.bound
        return {
            "logdet": finite(self.logdet),
            "samples": self.samples,
            "period": self.motion.period,
            "bound_logdet": None if bound is None else bound.logdet,
            "bound_kind": None if bound is None else bound.kind.value,
            "efficiency": self.efficiency,
            "worst_limit_use": self.limit_use.to_data(),
            "evaluations": self.evaluations,
            "criterion": str(self.criterion),
            "criterion_value": finite(self.local_optima[0].value),
            "outcome": self.local_optima[0].outcome.name.lower(),
            "searched": {stage: [finite(value) for value in values] for stage, values in self.searched},
            "reached": [finite(optimum.value) for optimum in self.local_optima],
            "std": self._std(),
            "unbounded": self.no_bound_reason or None,
        }

    def to_frame(self) -> pd.DataFrame:
        """The trajectory at its samples, as in PLAN.csv: time (s), q1.., dq1.., ddq1.. (rad or m, and per s, s²)."""
        import pandas as pd

        return pd.DataFrame(self.motion.to_columns(self.samples))

    def _std(self) -> dict[str, float | None]:
        names = [p.name for p in self.experiment.parameters]
        if not isfinite(self.logdet):
            return dict.fromkeys(names)
        return dict(zip(names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def table(self) -> Table:
        """Figures of merit, bound and use of the limits."""
        best, others = self.local_optima[0], self.local_optima[1:]
        values = ", ".join(f"{optimum.value:.2f}" for optimum in others)
        rows = [
            ("trajectory", f"{self.motion.series}, {self.samples} samples in {self.motion.period:g} s"),
            ("ln det(Phi' Phi)", f"{self.logdet:.3f}, unweighted SI"),
            *self._criterion(),
            *self._bound(),
            ("limits", self.limit_use.sentence()),
            ("optimiser", f"{best.outcome.value}; {self.evaluations} evaluations"),
            *(
                [("contraction", f"into the limits, at a cost of {best.contraction_loss:.4f}")]
                if best.contraction_loss
                else []
            ),
            *([("other local optima", values)] if others else []),
        ]
        return Table.of(("", ""), rows)

    def _comparison(self) -> list[tuple[str, str]]:
        """In place of a bound, how far below the best of the starts the others ended, of each stage."""
        parts = []
        for stage, values in self.searched:
            ended = np.array([value for value in values if isfinite(value)])
            if len(ended) > 1:
                second, median = ended[0] - ended[1], ended[0] - np.median(ended)
                parts.append(f"best of {len(ended)} ({stage}): second best {second:.2f} below it, median {median:.2f}")
        return [("starts", "; ".join(parts))] if parts else []

    def _criterion(self) -> list[tuple[str, str]]:
        weight = "unweighted SI" if self.experiment.noise is None else "weighted by the noise"
        if isinstance(self.criterion, DOptimal) and self.experiment.noise is None:
            return []
        return [("criterion", f"{self.criterion} = {self.local_optima[0].value:.3f}, {weight}")]

    def _bound(self) -> list[tuple[str, str]]:
        bound, weak_duality = self.bound, self.weak_duality
        if bound is None or weak_duality is None or self.efficiency is None:
            reason = self.no_bound_reason or "not all parameters are identifiable along the trajectory"
            return [("upper bound", f"none: {reason}"), *self._comparison()]
        rows, condition = dict(bound.rows), " if the check holds" if bound.kind is BoundKind.CHECKED else ""
        error = weak_duality.quadrature
        return [
            ("upper bound", f"{bound.logdet:.3f} for any periodic trajectory within these limits ({bound.kind.value})"),
            ("efficiency", f"{self.efficiency:.3f}{condition}: the share of the samples that the bound would need"),
            ("checked", rows["checked"]),
            ("proven", rows["proven"]),
            ("samples", f"{error:+.4f} in ln det against the mean over time, to which the bound applies"),
        ]
