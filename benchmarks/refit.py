"""The exact refit of a tool on a tether, against the same least squares by SciPy.

A simulated arm is tied to a `cable_spring`; `planar() + cable_spring()`, 11 parameters of which 4 enter nonlinearly, is
fitted to its recording from several starts: the tool's parameters at zero, the tether's near the minimum.

refit                      `estimation.fit.Problem.minimise`: derivatives from CasADi through the whitened chain, bounds
scipy trf, differences     `scipy.optimize.least_squares` with its default method and finite differences, bounds
scipy lm, differences      the same by MINPACK's Levenberg-Marquardt, which knows no bounds and is its quickest here
scipy lm, our derivatives  the same with the refit's derivatives: what is left is due to the steps, not to derivatives

It is fair because all minimise one chi-square with the same noise from the same start, each by its own stopping rule,
and a start counts only where all arrive at one minimum. SciPy gets columns scaled by their derivatives (without that
its default ends elsewhere), and a residual from the same compiled model, evaluated without derivatives and without the
rows that no parameter reaches. An evaluation is one pass of the model over the recording, with derivatives or without;
the covariance, which the refit computes at its end and SciPy does not, is in the time of the refit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from benchmarks.measure import rounds
from benchmarks.row import Row, table
from estimation.fit import Fit, fit
from estimation.least_squares.problem import LinearisedRows, Problem
from estimation.recordings.reading import read
from modeling import effects
from modeling.chain.model import planar
from modeling.chain.prediction import compiled_prediction
from modeling.rig import Rig
from truewrench.simulated_rig import CableSpring, PlanarRig, resolve_effects, simulate, write_recording

Array = npt.NDArray[np.float64]
Evaluation = Callable[[Array], Array]
Solution = tuple[Array, int]

STARTS = 7
SPREAD = 0.15
"""How far a start is from the minimum: standard deviation of the logarithm of each parameter of the effect."""
ROUNDS = 3
SAME = 1e-2
"""Difference in chi-square of two ends at one minimum: a tenth of a standard deviation of a parameter."""


@dataclass(eq=False)
class Counted:
    """A function of the parameters that counts how often it is called."""

    function: Evaluation
    calls: int = 0

    def __call__(self, theta: Array) -> Array:
        self.calls += 1
        return self.function(theta)


@dataclass(frozen=True, eq=False)
class CountedProblem(Problem):
    """A problem whose evaluations are counted."""

    calls: list[Array] = field(default_factory=list)

    def linearised(self, theta: Array) -> LinearisedRows:
        """The whitened rows about theta, counted."""
        self.calls.append(theta)
        return super().linearised(theta)


@dataclass(frozen=True, eq=False)
class Task:
    """The least-squares problem of a fit, as every solver sees it."""

    fitted: Fit

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest value of every parameter."""
        low, high = np.array([p.bounds for p in self.fitted.layout.parameters]).T
        return low, high

    @cached_property
    def problem(self) -> Problem:
        """With derivatives."""
        return self.fitted.problem

    def starts(self) -> list[Array]:
        """Parameters (k,) near the minimum in the effect's, zero in the tool's and the biases."""
        rng = np.random.default_rng(0)
        own = len(self.fitted.theta) - self.fitted.model.base_size
        factors = np.exp(SPREAD * rng.standard_normal((STARTS, own)))
        return [np.concatenate([np.zeros(self.fitted.model.base_size), self.fitted.theta[-own:] * f]) for f in factors]

    def residual(self, theta: Array) -> Array:
        """Whitened residual of the motion's lines, without derivatives (a tether and a zero have no memory)."""
        (recording,), (noise,) = self.fitted.recordings, self.fitted.noise
        once, signals, model = (
            recording.samples_per_repeat,
            recording.motion.model_signals,
            compiled_prediction(self.fitted.model),
        )
        value = model.load.value(signals, theta, once) + model.bias.value(signals, theta, once)
        steady = noise.whitener.periodic_rows
        return np.asarray(self.problem.measured[0][:steady] - noise.whitener.steady_state(value))

    def jacobian(self, theta: Array) -> Array:
        """Exact derivative of `residual`."""
        steady = self.fitted.noise[0].whitener.periodic_rows
        return np.asarray(-self.problem.evaluate(theta)[1][:steady])

    def chi_square(self, theta: Array) -> float:
        """What is minimised."""
        residual = self.residual(theta)
        return float(residual @ residual)


def refitted(task: Task, start: Array) -> Solution:
    """End and evaluations of the refit."""
    problem = CountedProblem(task.fitted.layout, task.fitted.problem.data)
    return problem.minimise(start).theta, len(problem.calls)


def by_trf(task: Task, start: Array) -> Solution:
    """End and evaluations of SciPy's default method with finite differences."""
    residual = Counted(task.residual)
    found = least_squares(residual, start, bounds=task.bounds, x_scale="jac")
    return np.asarray(found.x), residual.calls


def by_lm(task: Task, start: Array) -> Solution:
    """End and evaluations of MINPACK with finite differences."""
    residual = Counted(task.residual)
    found = least_squares(residual, start, method="lm", x_scale="jac")
    return np.asarray(found.x), residual.calls


def by_lm_derived(task: Task, start: Array) -> Solution:
    """End and evaluations of MINPACK with the refit's derivatives."""
    residual, jacobian = Counted(task.residual), Counted(task.jacobian)
    found = least_squares(residual, start, jac=jacobian, method="lm", x_scale="jac")
    return np.asarray(found.x), residual.calls + jacobian.calls


SOLVERS = {
    "refit": refitted,
    "scipy trf, differences": by_trf,
    "scipy lm, differences": by_lm,
    "scipy lm, our derivatives": by_lm_derived,
}


def tethered() -> Task:
    """The recording of a tied arm and its fit."""
    arm, model = PlanarRig(), planar() + effects.cable_spring()
    motion = arm.random_motion(seed=1)
    hidden = resolve_effects(arm, motion, [CableSpring()])
    frame = simulate(arm, motion, hidden=hidden, repeats=8, samples_per_period=500, seed=1)
    with TemporaryDirectory() as folder:
        recording = read(write_recording(frame, f"{folder}/tied.csv"), rig=Rig(link_lengths=arm.link_lengths))
    return Task(fit(model, recording))


def run() -> list[Row]:
    """Ratios of time and of evaluations, one for each start that all solvers bring to one minimum."""
    task = tethered()
    kept = [start for start in task.starts() if one_minimum(task, start)]
    evaluations = [{name: solve(task, start)[1] for name, solve in SOLVERS.items()} for start in kept]
    time = [seconds(task, start) for start in kept]
    return [
        Row(
            task=f"refit of a tether, {len(kept)} of {STARTS} starts",
            ours="refit",
            instead=instead,
            quantity=quantity,
            ratios=tuple(cost[instead] / cost["refit"] for cost in costs),
        )
        for instead in list(SOLVERS)[1:]
        for quantity, costs in (("time", time), ("evaluations", evaluations))
    ]


def one_minimum(task: Task, start: Array) -> bool:
    """Whether all solvers come to one chi-square from there."""
    ends = [task.chi_square(solve(task, start)[0]) for solve in SOLVERS.values()]
    return max(ends) - min(ends) < SAME


def seconds(task: Task, start: Array) -> dict[str, float]:
    """Median time of each solver from there."""
    measured = rounds({name: partial(solve, task, start) for name, solve in SOLVERS.items()}, ROUNDS)
    return {name: median(values) for name, values in measured.items()}


if __name__ == "__main__":
    print(table(run()))
