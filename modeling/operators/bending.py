"""The bend of a tool on a spring over a series: its equation of motion solved exactly, and the solution's derivatives.

The equilibrium F(signals, b, b', b''; theta) = 0 of each sample (`modeling.bend`) is nearly an oscillator with constant
coefficients, as the tool's inertia in its own axes is constant. The unknown is that oscillator's drive g: with
(b, b', b'') = R g its response, F(R g) = 0. As F' R is close to the identity, g - F(R g) is close to the solution, and
Anderson's method (J. ACM 12, 1965) makes of these steps a fast iteration without derivatives. Where it does not settle,
Newton's method takes over: each step, F' R dg = -F, is solved by GMRES (Saad and Schultz 1986). The derivative in a
parameter obeys F' (R dg + dR g) = -dF/dtheta.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.operators.clock import Clock
from modeling.operators.equilibrium import Equilibrium
from modeling.operators.oscillator import Coefficients, Oscillator

Array = NDArray[np.float64]

SETTLED = 1e-11
"""Size of the last correction, against the bend's own, at which it is found: rounding leaves less, but not much."""

MEMORY = 16
"""Steps that Anderson's method combines."""

QUICK = 60
"""Steps of it; a dozen will do away from a resonance."""

SLOWEST = 0.75
"""What is missing after a step over what was before it; where less is gained Newton's method is faster."""

WORSE = 10.0
"""Times that more may be missing than at first while few steps are there to be combined."""

ENOUGH = 500
"""Samples whose mean says what the oscillator is like: any will do that is near to the tool."""

STEPS = 30
"""Newton steps; a bend of less than half a radian takes four to six."""

INNER = 1e-4
"""Relative residual of a Newton step's own equation: each step gains four digits, and the last needs no more."""

EXACT = 1e-11
"""Relative residual of the equations of the derivatives."""

KEPT = 60
"""Directions that GMRES keeps; ten are enough away from a resonance."""

RESTARTS = 20
"""Times that GMRES begins again before the swing is given up."""


@dataclass(frozen=True, eq=False)
class BendSeries:
    """Angles, rates and accelerations of the bend side by side, values (n, 3 d), and derivatives slopes (n, 3 d, k)."""

    values: Array
    slopes: Array


def solve(equations: Equilibrium, signals: Array, theta: Array, clock: Clock, *, derivative: bool = True) -> BendSeries:
    """The bend under the signals (n, m) at the parameters theta (k,); with `derivative` False, slopes (n, 3 d, 0).

    Periodic: the steady state of a series that repeats. Otherwise it starts from the static equilibrium of the first
    sample, without velocity. At rest (no dt): every sample in its static equilibrium.

    Raises InputError when no bend is found: a spring too soft to carry the tool, or a swing that nothing damps.
    """
    course = _Poses() if clock.dt is None else _Swing.of(equations, signals, theta, clock)
    bend = course.settled(equations, signals, theta)
    if bend is None:
        bend = _by_newton(equations, course, signals, theta)
    if not derivative:
        return BendSeries(bend, np.zeros((*bend.shape, 0)))
    return BendSeries(bend, _slopes(equations, course, signals, bend, theta))


def _by_newton(equations: Equilibrium, course: _Course, signals: Array, theta: Array) -> Array:
    """The bend (n, 3 d) by Newton's method; InputError where there is none."""
    bend = np.zeros((len(signals), 3 * equations.size))
    value, by_bend = equations.at(signals, bend, theta)
    for _ in range(STEPS):
        change = course.solved(by_bend, -value, INNER)
        bend = bend + change
        value, by_bend = equations.at(signals, bend, theta)
        if not np.all(np.isfinite(value)):
            raise _unsettled()
        if np.max(np.abs(_angles(change))) <= SETTLED * np.max(np.abs(_angles(bend))):
            return bend
    raise _unsettled()


class _Course(Protocol):
    """How the bend can go on from sample to sample."""

    def moved(self, equations: Equilibrium, signals: Array, bend: Array, theta: Array) -> Array:
        """What it becomes, (n, 3 d, k), with theta by itself, before the equilibrium is restored."""

    def solved(self, by_bend: Array, right: Array, tolerance: float) -> Array:
        """The possible change (n, 3 d) of the bend with by_bend (n, d, 3 d) change = right (n, d)."""

    def settled(self, equations: Equilibrium, signals: Array, theta: Array) -> Array | None:
        """The bend (n, 3 d) by quick steps; None where they do not settle."""


@dataclass(frozen=True)
class _Poses:
    """Every sample by itself, without rates."""

    def moved(self, equations: Equilibrium, signals: Array, bend: Array, theta: Array) -> Array:
        return np.zeros((*bend.shape, len(theta)))

    def solved(self, by_bend: Array, right: Array, tolerance: float) -> Array:
        count, size = right.shape
        change = np.zeros((count, 3 * size))
        change[:, :size] = np.linalg.solve(by_bend[:, :, :size], right[:, :, None])[:, :, 0]
        return change

    def settled(self, equations: Equilibrium, signals: Array, theta: Array) -> Array | None:
        return None


@dataclass(frozen=True, eq=False)
class _Swing:
    """What an oscillator like the tool can do; its coefficients are a mean over every so many samples (`thinned`)."""

    oscillator: Oscillator
    thinned: int

    @classmethod
    def of(cls, equations: Equilibrium, signals: Array, theta: Array, clock: Clock) -> _Swing:
        """With the mean coefficients of the equilibrium's derivatives where nothing is bent."""
        thinned = max(1, len(signals) // ENOUGH)
        some = signals[::thinned]
        _, by_bend = equations.at(some, np.zeros((len(some), 3 * equations.size)), theta)
        mean = _coefficients(np.mean(by_bend, axis=0))
        if np.min(np.linalg.eigvalsh(mean.stiffness)) <= 0:
            raise _unsettled()
        return cls(Oscillator.of(mean, clock), thinned)

    def moved(self, equations: Equilibrium, signals: Array, bend: Array, theta: Array) -> Array:
        if self.oscillator.clock.periodic:
            return np.zeros((*bend.shape, len(theta)))
        changes = np.moveaxis(equations.mean_change(signals[:: self.thinned], theta), 2, 0)
        return np.stack([self.oscillator.change(bend, _coefficients(c)) for c in changes], axis=2)

    def solved(self, by_bend: Array, right: Array, tolerance: float) -> Array:
        from scipy.sparse.linalg import LinearOperator, gmres

        if not np.any(right):
            return np.zeros((len(right), by_bend.shape[2]))

        def applied(drive: Array) -> Array:
            response = self.oscillator.response(drive.reshape(right.shape))
            return np.asarray(np.einsum("nij,nj->ni", by_bend, response).ravel())

        operator = LinearOperator((right.size, right.size), matvec=applied, dtype=np.float64)
        restart = min(KEPT, right.size)
        drive, unsolved = gmres(operator, right.ravel(), rtol=tolerance, restart=restart, maxiter=RESTARTS)
        if unsolved or not np.all(np.isfinite(drive)):
            raise _unsettled()
        return self.oscillator.response(drive.reshape(right.shape))

    def settled(self, equations: Equilibrium, signals: Array, theta: Array) -> Array | None:
        """With f = -F(R g), the next g is g + f less the combination of the last steps that f is closest to."""
        bend = np.zeros((len(signals), 3 * equations.size))
        steps: list[tuple[Array, Array]] = []
        step = before = largest = None
        for number in range(QUICK):
            missing = -equations.value(signals, bend, theta)
            largest = np.abs(missing).max() if largest is None else largest
            if not np.abs(missing).max() <= largest * WORSE * SLOWEST ** max(0, number - MEMORY):  # or not finite
                return None
            if step is not None and before is not None:
                steps = [*steps[1 - MEMORY :], (step, missing - before)]
            step, before = missing.copy(), missing
            if steps:
                changes = np.stack([change.ravel() for _, change in steps])
                gram = changes @ changes.T
                weights = np.linalg.lstsq(gram, changes @ missing.ravel(), rcond=1e-14)[0]
                for weight, (moved, changed) in zip(weights, steps, strict=True):
                    step -= weight * (moved + changed)
            change = self.oscillator.response(step)
            bend = bend + change
            if np.max(np.abs(_angles(change))) <= SETTLED * np.max(np.abs(_angles(bend))):
                return bend
        return None


def _slopes(equations: Equilibrium, course: _Course, signals: Array, bend: Array, theta: Array) -> Array:
    _, by_bend = equations.at(signals, bend, theta)
    right = -equations.by_parameters(signals, bend, theta)
    moved = course.moved(equations, signals, bend, theta)
    right = right - np.einsum("nij,njk->nik", by_bend, moved)
    return moved + np.stack([course.solved(by_bend, right[:, :, j], EXACT) for j in range(len(theta))], axis=2)


def _coefficients(by_bend: Array) -> Coefficients:
    """Those in the derivatives (d, 3 d) of the equilibrium in angles, rates and accelerations, or changes of them."""
    stiffness, damping, mass = np.split(by_bend, 3, axis=1)
    return Coefficients((mass + mass.T) / 2, float(np.trace(damping)) / len(damping), (stiffness + stiffness.T) / 2)


def _angles(bend: Array) -> Array:
    return bend[:, : bend.shape[1] // 3]


def _unsettled() -> InputError:
    return InputError(
        what="no bend was found at which the spring carries the tool",
        where="tip_flexibility",
        remedy="bound its stiffness from below and its damping above zero, or leave it out",
    )
