"""Result of model discrimination."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.discrimination.design_setting import DesignSetting
from design.discrimination.exchange_algorithm import ExchangeRound
from design.discrimination.model_pair import ModelPair, Separability
from design.limits.limit_use import LimitUse
from design.trajectories.trajectory import Trajectory
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value

DISCRIMINATION_COLUMNS = (
    Column("true"),
    Column("rival"),
    *(Column(name, format=".4g") for name in ("lambda before", "lambda after")),
    *(Column(name, format=".2g") for name in ("error before", "error after")),
    *(Column(name, format="d") for name in ("runs for 5 %", "runs for 1 %")),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscriminationDesign(Tabular):
    """A discriminating trajectory with the separation of each pair of models.

    motion     within the limits at every instant; None when no trajectory discriminates any of them
    pairs      the given model with each of its rivals
    runs       of the trajectory, for which the lambdas hold
    reference  description of the trajectories of `before`
    rounds     of the exchange algorithm; the trajectory is that of the best one
    """

    setting: DesignSetting
    motion: Trajectory | None
    pairs: tuple[ModelPair, ...]
    runs: int
    reference: str
    rounds: tuple[ExchangeRound, ...]

    @property
    def verdict(self) -> Separability:
        """The verdict of the least separated pair."""
        return max((pair.verdict for pair in self.pairs), key=list(Separability).index)

    @property
    def limit_use(self) -> LimitUse | None:
        """Use of each limit by the trajectory."""
        return None if self.motion is None else self.setting.use(self.motion)

    def to_data(self) -> dict[str, Any]:
        """Plain data: numbers are finite, or None."""
        motion, use = self.motion, self.limit_use
        return {
            "verdict": self.verdict.name.lower(),
            "pairs": [pair.to_data() for pair in self.pairs],
            "runs": self.runs,
            "samples": self.setting.samples,
            "period": self.setting.series.duration,
            "before": self.reference,
            "coefficients": None if motion is None else motion.coefficients.tolist(),
            "worst_limit_use": None if use is None else use.to_data(),
            "rounds": [found.smallest for found in self.rounds],
        }

    @property
    def table(self) -> Table:
        """Truth, rival, lambda and error probability before and after, runs for 5 % and 1 % errors."""
        rows: list[tuple[Value, ...]] = []
        for pair in self.pairs:
            errors = [pair.error_probability(x) for x in (pair.before, pair.after)]
            runs = [pair.runs_for(x) for x in (LEVELS.confusable, LEVELS.separated)]
            for d in pair.directions:
                known = [None] * 4 if d.indistinguishable else [*errors, *runs]
                rows.append(
                    (d.truth, d.rival, d.before, "indistinguishable" if d.indistinguishable else d.after, *known)
                )
        return Table.of(DISCRIMINATION_COLUMNS, rows)

    def remarks(self) -> list[str]:
        """Verdict of each pair, the runs and the reference, and the use of the limits."""
        lines = [f"{pair.names[0]} or {pair.names[1]}: {_verdict(pair)}" for pair in self.pairs]
        lines.append(f"lambda in {self.runs} run{'s' * (self.runs > 1)} of the trajectory; before: {self.reference}")
        if self.limit_use is not None:
            lines.append(self.limit_use.sentence())
        return lines


def _verdict(pair: ModelPair) -> str:
    if pair.verdict is Separability.NEVER:
        return f"{pair.verdict.value}; the simpler one is preferred"
    text = pair.verdict.value + ("; nested models: the simpler one is preferred unless it is rejected" * pair.nested)
    runs = pair.runs_for(LEVELS.separated)
    return (
        text if pair.verdict is Separability.SEPARATED else f"{text} ({'-' if runs is None else runs} for 1 % errors)"
    )
