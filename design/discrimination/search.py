"""Search: the motion whose smallest lambda is largest, by turns of motion and imitation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

from design.discrimination.direction import Block, Direction, side_by_side
from design.discrimination.imitation import Imitation
from design.discrimination.setting import Setting
from design.discrimination.view import View
from design.motion.series import Motion
from design.optimiser.optimiser import Attempt, Task, optimise

ROUNDS = 8
"""Turns of motion and imitation; three or four are the rule."""
GROWTH = 0.01
"""Share by which the smallest lambda has to grow for another round: a tenth of what one more run in ten gives."""
REMEMBERED = 3
"""Imitations of each direction that a motion is designed against when they come back in turn."""


@dataclass(frozen=True, eq=False)
class Round:
    """The best motion of one turn, and the exact imitation along it in every direction."""

    number: int
    motion: Motion
    imitations: tuple[Imitation, ...]

    @property
    def smallest(self) -> float:
        """The smallest lambda in one run with the readings that it is optimised with."""
        return min(imitation.separation for imitation in self.imitations)

    def __str__(self) -> str:
        return f"round {self.number}, smallest lambda {self.smallest:.4g}"


Progress = Callable[[Round], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """max over motions of min over directions and theta of |y_truth - y_rival(theta)|².

    In turns: with theta held, and lambda linear about it (`Block`), the motion is optimised; along the new motion theta
    is found again, exactly. A linear lambda is what is optimised and never what is judged. When lambda falls
    the imitations come back in turn: then the motion has to do against the last few of each direction together, until
    that does not help either. This is the exchange of a max-min problem (Blankenship and Falk 1976) in which each
    block already stands for all theta near its own.
    """

    setting: Setting
    directions: tuple[Direction, ...]
    probes: tuple[View, ...]
    executor: Executor | None = None

    def run(self, first: Sequence[Imitation], *, starts: int, seed: int, progress: Progress | None) -> list[Round]:
        """The rounds, from random starts and the imitation of each direction to begin with."""
        rounds: list[Round] = []
        histories = [[imitation] for imitation in first]
        remembered = 1
        for number in range(1, ROUNDS + 1):
            task = self._task(histories, remembered)
            begin = [max(rounds, key=lambda r: r.smallest).motion] if rounds else []
            begin = begin or [task.random((seed, 1, place)) for place in range(starts)]
            found = self._best(number, optimise(task, begin, executor=self.executor), histories)
            best = max((r.smallest for r in rounds), default=0.0)
            rounds.append(found)
            if progress is not None:
                progress(found)
            grown, fallen = found.smallest > (1 + GROWTH) * best, found.smallest < (1 - GROWTH) * best
            if not grown and (remembered > 1 or not fallen):
                break
            remembered = 1 if grown else REMEMBERED
            for history, imitation in zip(histories, found.imitations, strict=True):
                history.append(imitation)
        return rounds

    def _task(self, histories: Sequence[list[Imitation]], remembered: int) -> Task:
        """A motion against the last imitations."""
        blocks = [
            Block.of(direction, imitation.theta, self.probes)
            for direction, history in zip(self.directions, histories, strict=True)
            for imitation in history[-remembered:]
        ]
        return self.setting.task(*side_by_side(blocks, self.setting.arm, self.setting.noise))

    def _best(self, number: int, attempts: Sequence[Attempt], histories: Sequence[list[Imitation]]) -> Round:
        """The best motion by its exact smallest lambda."""
        rounds = [Round(number, a.motion, self.imitations(a.motion, histories)) for a in attempts]
        return max(rounds, key=lambda found: found.smallest)

    def imitations(self, motion: Motion, histories: Sequence[list[Imitation]]) -> tuple[Imitation, ...]:
        """The exact imitation in every direction, started from all that are known too."""
        views = [self.setting.view(motion, self.setting.coarse)]
        return tuple(
            direction.imitation(views, self.setting.reach, [imitation.theta for imitation in history])
            for direction, history in zip(self.directions, histories, strict=True)
        )
