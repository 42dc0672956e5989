"""Evolution: the CMA evolution strategy (Hansen and Ostermeier, Evol. Comput. 9 (2001) 159-195) by nevergrad."""

from __future__ import annotations

import warnings

import nevergrad as ng
import numpy as np

from benchmarks.rivals.objective import Objective
from benchmarks.rivals.reference import FREE
from benchmarks.rivals.trace import Recorder, Trace

EVALUATIONS = 30_000
WORST = 1e5
"""Costs are cut here: nevergrad does so itself at 5e20, and warns; a start costs less."""


def penalised(seed: int, evaluations: int = EVALUATIONS) -> Trace:
    """A free series with the penalty, nevergrad's CMA with its budget."""
    recorder = Recorder(Objective(FREE), "nevergrad CMA, penalty")
    evolved(recorder, seed, evaluations)
    return recorder.trace()


def evolved(recorder: Recorder, seed: int, evaluations: int) -> None:
    """The strategy on any recorder's objective, with steps as long as a random start's coefficients.

    Its documentation recommends NGOpt, which takes CMA for a problem and budget such as this; NGOpt itself ends with a
    TypeError in its meta-model under NumPy 2.4 (nevergrad 1.0.12). Of CMA, TwoPointsDE and TBPSA, CMA came furthest.
    """
    start = recorder.objective.start([seed, 0])
    space = ng.p.Array(init=np.zeros(len(start))).set_mutation(sigma=float(start.std()))
    space.random_state.seed(seed)
    search = ng.optimizers.CMA(parametrization=space, budget=evaluations)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pycma, on ending early, and of nevergrad, on costs that were cut
        search.minimize(lambda x: min(recorder.cost(x), WORST))
