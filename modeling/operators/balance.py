"""Balance: the equilibrium of a series as a function of the bend alone, all that does not depend on it counted once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation import Evaluation
from modeling.tape import NONE, Tape

Array = NDArray[np.float64]

SETTLED = 1e-11
"""Size of the last correction of a bend, against its own, at which it is found: rounding leaves little less."""


@dataclass(frozen=True, eq=False)
class Balancing:
    """F (d,) of signals (m,) and theta (k,) in two tapes, parted by what depends on the bend (3 d,).

    before   of signals, theta and a bend that nothing of it depends on; its first `changing` results are series, the
             others differ from sample to sample no more than theta
    after    F of the bend and of the series, with the others as its parameters
    """

    before: Evaluation
    after: Evaluation
    changing: int
    bends: int

    @classmethod
    def of(cls, tape: Tape, bends: int) -> Self:
        """Of a tape of signals (m,) and of parameters (theta, bend), the last `bends` of which are the bend."""
        m, theta = tape.inputs, tape.parameters - bends
        bend = range(m + theta, m + theta + bends)
        moved = tape.depending_on(bend)
        late = [number for number in range(tape.first, tape.size) if number in moved]
        operations = [tape.operations[number - tape.first] for number in late]
        taken = {operand for _, *operands in operations for operand in operands} | {*tape.results}
        given = sorted(taken - moved - {NONE})
        varying = tape.depending_on(range(m))
        constants = range(m + theta + bends, tape.first)
        series = [number for number in given if number in varying]
        fixed = [number for number in given if number not in varying and number not in constants]
        order = [*bend, *series, *fixed, *constants, *late]
        places = {number: place for place, number in enumerate(order)} | {NONE: NONE}
        after = Tape(
            inputs=bends + len(series),
            parameters=len(fixed),
            constants=tape.constants,
            operations=tuple((name, places[a], places[b]) for name, a, b in operations),
            results=tuple(places[number] for number in tape.results),
        )
        everything = Tape(m, tape.parameters, tape.constants, tape.operations, (*series, *fixed))
        before = everything.only(range(len(series) + len(fixed)))
        return cls(Evaluation(before), Evaluation(after), len(series), bends)

    def at(self, signals: Array, theta: Array) -> Balance:
        """At the signals (m, n) of n samples and at theta (k,)."""
        series = np.zeros((self.changing, signals.shape[1]))
        fixed = np.zeros(len(self.before.tape.results) - self.changing)
        outputs = [*series[:, :, None], *fixed[:, None, None]]
        straight = np.concatenate([np.asarray(theta, dtype=float), np.zeros(self.bends)])
        self.before.run(list(signals), straight[None], outputs)
        return Balance(self.after, series, fixed)


@dataclass(frozen=True, eq=False)
class Balance:
    """What is left of `Balancing` to be evaluated, for the series (c, n) and the parameters (f,) that it takes."""

    evaluation: Evaluation
    series: Array
    fixed: Array

    def of(self, bend: Array) -> Array:
        """F (d, n) under a bend (3 d, n)."""
        value = np.zeros((len(self.evaluation.tape.results), bend.shape[1]))
        self.evaluation.run([*bend, *self.series], self.fixed[None], list(value[:, :, None]))
        return value
