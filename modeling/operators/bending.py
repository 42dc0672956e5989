"""The bend of a tool on a spring over a series: its equation of motion solved exactly, and the solution's derivatives.

The equilibrium F(signals, b, b', b''; theta) = 0 of each sample (`modeling.bend`) is nearly an oscillator with constant
coefficients, as the tool's inertia in its own axes is constant. The unknown is that oscillator's drive g: with
(b, b', b'') = R g its response, F(R g) = 0. As F' R is close to the identity, g - F(R g) is close to the solution, and
Anderson's method (`modeling.operators.mixing`) makes of these steps a fast iteration without derivatives. Where that
takes long, near a resonance, Newton's method goes on from where it came to: each step, F' R dg = -F, is solved by GMRES
(Saad and Schultz 1986). The derivative in a parameter obeys F' (R dg + dR g) = -dF/dtheta.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.operators.balance import SETTLED, Balance
from modeling.operators.clock import Clock
from modeling.operators.equilibrium import Equilibrium
from modeling.operators.mixing import MEMORY, Mixing
from modeling.operators.oscillator import Coefficients, Oscillator

Array = NDArray[np.float64]

QUICK = 60
"""Steps of Anderson's method; a dozen will do away from a resonance."""

PATIENCE = 30
"""Steps of it that may gain little."""

SLOWEST = 0.75
"""What is missing after a step over what was before it, on average; where less is gained Newton's method is faster."""

WORSE = 10.0
"""Times that more may be missing than at first, when Newton's method begins, and by a step of it."""

ENOUGH = 500
"""Samples whose mean says what the oscillator is like: any will do that is near to the tool."""

COARSER = 8
"""Samples of a long run, one of which is in the series that it begins with; that has to have `ENOUGH`."""

BEGUN = 1e-5
"""Tolerance of the bend that a long run begins with: what is between the samples is not known any better."""

STEPS = 30
"""Newton steps; from where Anderson's method came to, three to five, and of poses that bend by half a radian six."""

INNER, ROUGH = 1e-3, 0.1
"""Relative residual of a Newton step's own equation, at the least and at the most; between, what the step begins with.

As in Eisenstat and Walker (SIAM J. Scientific Computing 17, 1996): no step is solved better than it can be good.
"""

EXACT = 1e-10
"""Relative residual of the equations of the derivatives."""

KEPT = 150
"""Directions that GMRES keeps; ten are enough away from a resonance, sixty near one, of numbers as long as these:"""

HELD = 2**24
"""Numbers, 128 MB, that all directions or steps have at most; a longer series has fewer of them."""

FEWEST = 16
"""Directions or steps that are kept at the least."""

MOST = 600
"""Products with the operator, after which GMRES gives the swing up."""


@dataclass(frozen=True, eq=False)
class BendSeries:
    """Angles, rates and accelerations of the bend side by side, values (n, 3 d), and derivatives slopes (n, 3 d, k)."""

    values: Array
    slopes: Array


def solve(
    equations: Equilibrium,
    signals: Array,
    theta: Array,
    clock: Clock,
    *,
    derivative: bool = True,
    tolerance: float = SETTLED,
) -> BendSeries:
    """The bend under the signals (n, m) at the parameters theta (k,); with `derivative` False, slopes (n, 3 d, 0).

    Periodic: the steady state of a series that repeats. Otherwise it starts from the static equilibrium of the first
    sample, without velocity. At rest (no dt): every sample in its static equilibrium. `tolerance` is the size of the
    last correction, against the bend's own, at which it is found.

    Raises InputError when no bend is found: a spring too soft to carry the tool, or a swing that nothing damps.
    """
    course = _Poses() if clock.dt is None else _Swing.of(equations, signals, theta, clock)
    balance = equations.over(signals, theta)
    bend = course.begun(equations, balance, signals, theta)
    if not course.approach(balance, bend, tolerance):
        bend = _by_newton(equations, course, signals, bend, theta, tolerance)
    if not derivative:
        return BendSeries(bend.T, np.zeros((*bend.T.shape, 0)))
    return BendSeries(bend.T, _slopes(equations, course, signals, bend, theta))


def _by_newton(
    equations: Equilibrium, course: _Course, signals: Array, bend: Array, theta: Array, tolerance: float
) -> Array:
    """The bend (3 d, n) by Newton's method from another; InputError where there is none."""
    value, by_bend = equations.at(signals, bend.T, theta)
    missing = np.inf
    for _ in range(STEPS):
        before, missing = missing, np.max(np.abs(value))
        if not missing <= WORSE * before or not np.isfinite(missing):
            raise _unsettled()
        inner = min(max(missing, INNER), ROUGH)
        change = course.solved(by_bend, -value.T, inner)
        bend = bend + change
        relative = _relative(change, bend)
        if relative * (relative + inner) <= tolerance:  # what a step misses by its own curvature and residual
            return bend
        value, by_bend = equations.at(signals, bend.T, theta)
    raise _unsettled()


def _relative(change: Array, bend: Array) -> float:
    """Size of the angles of a change (3 d, n) over that of the bend's; 0 where nothing changes."""
    angles = len(bend) // 3
    size = np.max(np.abs(change[:angles]))
    return float(size / np.max(np.abs(bend[:angles]))) if size else 0.0


class _Course(Protocol):
    """How the bend can go on from sample to sample."""

    def moved(self, equations: Equilibrium, signals: Array, bend: Array, theta: Array) -> Array:
        """What the bend (3 d, n) becomes, (k, 3 d, n), with theta by itself, before the equilibrium is restored."""

    def solved(self, by_bend: Array, right: Array, tolerance: float) -> Array:
        """The possible change (3 d, n) of the bend with by_bend (n, d, 3 d) change = right (d, n)."""

    def begun(self, equations: Equilibrium, balance: Balance, signals: Array, theta: Array) -> Array:
        """A bend (3 d, n) to begin with."""

    def approach(self, balance: Balance, bend: Array, tolerance: float) -> bool:
        """Improve a bend (3 d, n) in place by quick steps, and say whether it has settled."""


@dataclass(frozen=True)
class _Poses:
    """Every sample by itself, without rates."""

    def moved(self, equations: Equilibrium, signals: Array, bend: Array, theta: Array) -> Array:
        return np.zeros((len(theta), *bend.shape))

    def solved(self, by_bend: Array, right: Array, tolerance: float) -> Array:
        size = len(right)
        change = np.zeros((3 * size, right.shape[1]))
        change[:size] = np.linalg.solve(by_bend[:, :, :size], right.T[:, :, None])[:, :, 0].T
        return change

    def begun(self, equations: Equilibrium, balance: Balance, signals: Array, theta: Array) -> Array:
        return np.zeros((3 * equations.size, len(signals)))

    def approach(self, balance: Balance, bend: Array, tolerance: float) -> bool:
        return False


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
            return np.zeros((len(theta), *bend.shape))
        changes = np.moveaxis(equations.mean_change(signals[:: self.thinned], theta), 2, 0)
        found = np.zeros((len(theta), *bend.shape))
        for own, change in zip(found, changes, strict=True):
            if change.any():
                own += self.oscillator.change(bend, _coefficients(change))
        return found

    def solved(self, by_bend: Array, right: Array, tolerance: float) -> Array:
        from scipy.sparse.linalg import LinearOperator, gmres

        if not np.any(right):
            return np.zeros((by_bend.shape[2], right.shape[1]))

        def applied(drive: Array) -> Array:
            response = self.oscillator.response(drive.reshape(right.shape))
            return _product(by_bend, response).ravel()

        operator = LinearOperator((right.size, right.size), matvec=applied, dtype=np.float64)
        kept = min(KEPT, max(HELD // right.size, FEWEST), right.size)
        drive, unsolved = gmres(operator, right.ravel(), rtol=tolerance, restart=kept, maxiter=-(-MOST // kept))
        if unsolved or not np.all(np.isfinite(drive)):
            raise _unsettled()
        return self.oscillator.response(drive.reshape(right.shape))

    def begun(self, equations: Equilibrium, balance: Balance, signals: Array, theta: Array) -> Array:
        """Of a long run, the bend of every few samples, drawn through them (nested iteration); 0 of others.

        With C the oscillator's coefficients, g = C b - F(b) takes jumps of the load, which no curve follows, from the
        equation itself.
        """
        count, clock = len(signals), self.oscillator.clock
        straight = np.zeros((3 * equations.size, count))
        if clock.periodic or clock.dt is None or count < COARSER * ENOUGH:
            return straight
        from scipy.interpolate import CubicSpline

        coarse = Clock(clock.dt * COARSER, periodic=False)
        try:
            bent = solve(equations, signals[::COARSER], theta, coarse, derivative=False, tolerance=BEGUN)
        except InputError:
            return straight
        bend = CubicSpline(np.arange(0, count, COARSER), bent.values.T, axis=1)(np.arange(count))
        return self.oscillator.response(self.oscillator.drive(bend) - balance.of(bend))

    def approach(self, balance: Balance, bend: Array, tolerance: float) -> bool:
        """With f = -F(R g), the next g is g + f less the combination of the last steps that f is closest to."""
        shape = (len(bend) // 3, bend.shape[1])
        size = shape[0] * shape[1]
        mixing, first = Mixing(size, min(MEMORY, max(HELD // (2 * size), FEWEST))), 0.0
        for number in range(QUICK):
            missing = -balance.of(bend).ravel()
            largest = np.abs(missing).max()
            first = largest if number == 0 else first
            if not largest <= WORSE * first:  # or not finite
                bend[:] = 0.0  # Newton does better from nothing than from where this ran away to
                return False
            if number >= PATIENCE and largest > first * SLOWEST**number:
                return False
            change = self.oscillator.response(mixing.step(missing).reshape(shape))
            bend += change
            if _relative(change, bend) <= tolerance:
                return True
        return False


def _product(by_bend: Array, change: Array) -> Array:
    """by_bend (n, d, 3 d) times a change (3 d, n) at each sample, (d, n)."""
    return np.asarray(np.einsum("nij,jn->in", by_bend, change))


def _slopes(equations: Equilibrium, course: _Course, signals: Array, bend: Array, theta: Array) -> Array:
    _, by_bend = equations.at(signals, bend.T, theta)
    by_theta = equations.by_parameters(signals, bend.T, theta)
    slopes = course.moved(equations, signals, bend, theta)
    for j, moved in enumerate(slopes):
        moved += course.solved(by_bend, -by_theta[:, :, j].T - _product(by_bend, moved), EXACT)
    return slopes.transpose(2, 1, 0)


def _coefficients(by_bend: Array) -> Coefficients:
    """Those in the derivatives (d, 3 d) of the equilibrium in angles, rates and accelerations, or changes of them."""
    stiffness, damping, mass = np.split(by_bend, 3, axis=1)
    return Coefficients((mass + mass.T) / 2, float(np.trace(damping)) / len(damping), (stiffness + stiffness.T) / 2)


def _unsettled() -> InputError:
    return InputError(
        what="no bend was found at which the spring carries the tool",
        where="tip_flexibility",
        remedy="bound its stiffness from below and its damping above zero, or leave it out",
    )
