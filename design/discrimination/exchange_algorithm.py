"""Max-min exchange between trajectory and rival fits (Blankenship and Falk)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

from design.discrimination.design_setting import DesignSetting
from design.discrimination.directed_pair import DirectedPair, LinearisedRival, maximin_experiment
from design.discrimination.whitened_prediction import WhitenedPrediction
from design.optimiser.design_task import DesignTask
from design.optimiser.local_optimum import LocalOptimum
from design.optimiser.multistart import optimise
from design.trajectories.trajectory import Trajectory
from modeling.rival_fit import RivalFit

EXCHANGE_ROUNDS = 8
"""Most rounds of trajectory and rival fits; three or four are typical."""
LEAST_GROWTH = 0.01
"""Relative growth of the smallest lambda needed for another round: a tenth of the gain by one more run in ten."""
RETAINED_FITS = 3
"""Rival fits of each direction against which a trajectory is optimised when the fits recur."""


@dataclass(frozen=True, eq=False)
class ExchangeRound:
    """The best trajectory of one round, and the exact rival fit along it in every direction."""

    number: int
    motion: Trajectory
    rival_fits: tuple[RivalFit, ...]

    @property
    def smallest(self) -> float:
        """The smallest lambda in one run with the samples of the optimisation."""
        return min(rival_fit.noncentrality for rival_fit in self.rival_fits)

    def __str__(self) -> str:
        return f"round {self.number}, smallest lambda {self.smallest:.4g}"


ExchangeProgress = Callable[[ExchangeRound], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class ExchangeAlgorithm:
    """max over trajectories of min over directions and theta of |y_truth - y_rival(theta)|².

    In turns: the trajectory is optimised for the lambda linearised at theta (`LinearisedRival`); along the new
    trajectory the rivals are fitted again, exactly. The linearised lambda is optimised only; results are exact. When
    lambda falls, rival fits recur in turn: then the trajectory is optimised against the last few of each direction
    together, until that no longer helps. This is the exchange of a max-min problem (Blankenship and Falk 1976) in which
    each block covers all theta near its own.
    """

    setting: DesignSetting
    directions: tuple[DirectedPair, ...]
    probes: tuple[WhitenedPrediction, ...]
    executor: Executor | None = None

    def run(
        self, first: Sequence[RivalFit], *, starts: int, seed: int, progress: ExchangeProgress | None
    ) -> list[ExchangeRound]:
        """The rounds, from random starts and the first rival fit of each direction."""
        rounds: list[ExchangeRound] = []
        histories = [[rival_fit] for rival_fit in first]
        retained = 1
        for number in range(1, EXCHANGE_ROUNDS + 1):
            task = self._task(histories, retained)
            initial = [max(rounds, key=lambda r: r.smallest).motion] if rounds else []
            initial = initial or [task.random((seed, 1, start)) for start in range(starts)]
            found = self._best(number, optimise(task, initial, executor=self.executor), histories)
            best = max((r.smallest for r in rounds), default=0.0)
            rounds.append(found)
            if progress is not None:
                progress(found)
            grown, fallen = found.smallest > (1 + LEAST_GROWTH) * best, found.smallest < (1 - LEAST_GROWTH) * best
            if not grown and (retained > 1 or not fallen):
                break
            retained = 1 if grown else RETAINED_FITS
            for history, rival_fit in zip(histories, found.rival_fits, strict=True):
                history.append(rival_fit)
        return rounds

    def _task(self, histories: Sequence[list[RivalFit]], retained: int) -> DesignTask:
        """The optimisation against the last rival fits."""
        blocks = [
            LinearisedRival.of(direction, rival_fit.theta, self.probes)
            for direction, history in zip(self.directions, histories, strict=True)
            for rival_fit in history[-retained:]
        ]
        return self.setting.task(*maximin_experiment(blocks, self.setting.arm, self.setting.noise))

    def _best(
        self, number: int, local_optima: Sequence[LocalOptimum], histories: Sequence[list[RivalFit]]
    ) -> ExchangeRound:
        """The best trajectory by its exact smallest lambda."""
        rounds = [ExchangeRound(number, a.motion, self.rival_fits(a.motion, histories)) for a in local_optima]
        return max(rounds, key=lambda found: found.smallest)

    def rival_fits(self, motion: Trajectory, histories: Sequence[list[RivalFit]]) -> tuple[RivalFit, ...]:
        """The exact rival fit in every direction, started from all known fits too."""
        views = [self.setting.view(motion, self.setting.coarse)]
        return tuple(
            direction.rival_fit(views, self.setting.reach, [rival_fit.theta for rival_fit in history])
            for direction, history in zip(self.directions, histories, strict=True)
        )
