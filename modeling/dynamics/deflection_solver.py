"""Deflection over a record by Anderson mixing and Newton-GMRES, with parameter derivatives.

The equation of motion F(signals, b, b', b''; theta) = 0 of each sample (`deflection.py`) is nearly a
linear oscillator with constant coefficients, as the tool's inertia in tool axes is constant. The unknown is the
oscillator's input g: with (b, b', b'') = R g its response, F(R g) = 0. As F' R is close to the identity, the iteration
g <- g - F(R g) is accelerated by Anderson mixing (J. ACM 12, 1965), without derivatives.
Where it converges slowly, near a resonance, Newton's method continues from its last iterate: each step, F' R dg = -F,
is solved by GMRES (Saad and Schultz 1986). The derivative in a parameter satisfies F' (R dg + dR g) = -dF/dtheta: one
factorisation solves it for all parameters, of the matrix F' R of a short period or of the banded equations of a
transient (`TransientEquations`), or else GMRES.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modeling.dynamics.equation_of_motion import DEFLECTION_TOLERANCE, EquationOfMotion, MotionResidual
from modeling.dynamics.motion_record import TimeBase
from modeling.dynamics.oscillator import Oscillator, OscillatorCoefficients, TransientEquations, interpolated
from modeling.errors import InputError

Array = NDArray[np.float64]

ANDERSON_DEPTH = 32
"""Default number of previous steps that are combined."""

GRAM_TOLERANCE = 1e-14
"""Relative tolerance of the singular values of the scaled Gram matrix: smaller ones are linearly dependent steps."""


class AndersonMixing:
    """Accelerated steps of x <- x + f(x), x (n,); near a solution equivalent to GMRES (Walker and Ni 2011).

    With dx the previous steps and df the changes of f, the next step is f minus the linear combination of dx + df whose
    df is closest to f (least squares). The Gram matrix of the df, scaled to a unit diagonal, gains a row per step.
    """

    def __init__(self, size: int, depth: int = ANDERSON_DEPTH) -> None:
        self._changes = np.empty((depth, size))
        self._sums = np.empty((depth, size))
        self._gram = np.zeros((depth, depth))
        self._last: tuple[Array, Array] | None = None
        self._count = 0

    def step(self, residual: Array) -> Array:
        """The step (n,) for f = `residual` (n,), provided that all previous steps were applied."""
        if self._last is not None:
            self._store(*self._last, residual)
        step = residual - self._correction(residual)
        self._last = step, residual
        return step

    def _store(self, step: Array, before: Array, residual: Array) -> None:
        place, stored = self._count % len(self._gram), min(self._count + 1, len(self._gram))
        np.subtract(residual, before, out=self._changes[place])
        np.add(step, self._changes[place], out=self._sums[place])
        self._gram[place, :stored] = self._gram[:stored, place] = self._changes[:stored] @ self._changes[place]
        self._count += 1

    def _correction(self, residual: Array) -> Array | float:
        stored = min(self._count, len(self._gram))
        scale = np.sqrt(np.diag(self._gram)[:stored])
        if not stored or not scale.all():
            return 0.0
        gram = self._gram[:stored, :stored] / np.outer(scale, scale)
        weights = np.linalg.lstsq(gram, self._changes[:stored] @ residual / scale, rcond=GRAM_TOLERANCE)[0] / scale
        return np.asarray(weights @ self._sums[:stored])


ANDERSON_STEPS = 60
"""Maximum number of Anderson steps; about twelve are needed away from a resonance."""

ANDERSON_TRIAL_STEPS = 30
"""Anderson steps before the contraction is checked."""

ANDERSON_CONTRACTION = 0.75
"""Average ratio of successive residuals above which Newton's method is faster."""

DIVERGENCE_FACTOR = 10.0
"""Growth of the residual, against the first Anderson step or by one Newton step, that counts as divergence."""

LINEARISATION_SAMPLES = 500
"""Samples over which the oscillator's coefficients are averaged: an approximation of the tool is enough."""

COARSENING_FACTOR = 8
"""Decimation factor of the coarse solution that initialises a long record; it needs `LINEARISATION_SAMPLES`."""

COARSE_TOLERANCE = 1e-5
"""Tolerance of the coarse solution: interpolation between its samples is not more accurate."""

MAXIMUM_NEWTON_STEPS = 30
"""Maximum number of Newton steps: three to five after Anderson mixing, six for static deflections of 0.5 rad."""

TIGHTEST_FORCING_TERM = 1e-3
"""Least relative residual (forcing term) to which a Newton step is solved; above it, the current residual.

Eisenstat and Walker (SIAM J. Scientific Computing 17, 1996): no step is solved more accurately than its linearisation.
"""
LOOSEST_FORCING_TERM = 0.1
"""Largest forcing term: so far from the solution, too, a step gains one decimal."""

DERIVATIVE_TOLERANCE = 1e-10
"""Relative residual of the linear equations of the parameter derivatives."""

FACTORISED_EQUATIONS = 500
"""Equations of a steady state up to which the matrix of the parameter derivatives is factorised: for a dozen parameters
faster than GMRES, near a resonance five times. That of a transient is banded, and limited by `STORED_NUMBERS`."""

KRYLOV_DIMENSION = 150
"""Krylov dimension before GMRES restarts: ten suffice away from a resonance, sixty near one; limited by:"""

STORED_NUMBERS = 2**24
"""Floats (128 MB) stored for all Krylov vectors or Anderson steps, or for a banded matrix; a longer record has fewer of
the former, and no matrix."""

MINIMUM_KRYLOV_DIMENSION = 16
"""Minimum number of stored Krylov vectors or Anderson steps."""

MAXIMUM_PRODUCTS = 600
"""Maximum number of operator products of GMRES."""


@dataclass(frozen=True, eq=False)
class DeflectionSeries:
    """Angles, rates and accelerations of the deflection, values (n, 3 d), and parameter derivatives (n, 3 d, k)."""

    values: Array
    slopes: Array


def solve_deflection(
    equations: EquationOfMotion,
    signals: Array,
    theta: Array,
    clock: TimeBase,
    *,
    derivative: bool = True,
    tolerance: float = DEFLECTION_TOLERANCE,
) -> DeflectionSeries:
    """The deflection for signals (n, m) and parameters theta (k,); with `derivative` False, slopes (n, 3 d, 0).

    Periodic: the steady state. Otherwise it starts from the static equilibrium of the first sample, at zero velocity.
    Static poses (no dt): the static equilibrium of every sample. It has converged when the last correction, relative to
    the deflection, is below `tolerance`.

    Raises InputError when it does not converge: a spring too soft to carry the tool, or an undamped oscillation.
    """
    regime = _StaticPoses() if clock.dt is None else _OscillatingTool.of(equations, signals, theta, clock)
    balance = equations.over(signals, theta)
    deflection = regime.initial_deflection(equations, balance, signals, theta)
    if not regime.anderson_converges(balance, deflection, tolerance):
        deflection = _by_newton(equations, regime, signals, deflection, theta, tolerance)
    if not derivative:
        return DeflectionSeries(deflection.T, np.zeros((*deflection.T.shape, 0)))
    return DeflectionSeries(deflection.T, _deflection_derivatives(equations, regime, signals, deflection, theta))


def _by_newton(
    equations: EquationOfMotion, regime: _Regime, signals: Array, deflection: Array, theta: Array, tolerance: float
) -> Array:
    """The deflection (3 d, n) by Newton's method from an initial one; InputError without convergence."""
    value, by_deflection = equations.at(signals, deflection.T, theta)
    residual = np.inf
    for _ in range(MAXIMUM_NEWTON_STEPS):
        before, residual = residual, np.max(np.abs(value))
        if not residual <= DIVERGENCE_FACTOR * before or not np.isfinite(residual):
            raise _not_converged()
        forcing = min(max(residual, TIGHTEST_FORCING_TERM), LOOSEST_FORCING_TERM)
        change = regime.solution(by_deflection, -value.T, forcing)
        deflection = deflection + change
        relative = _relative(change, deflection)
        if relative * (relative + forcing) <= tolerance:  # error of a step by curvature and forcing term
            return deflection
        value, by_deflection = equations.at(signals, deflection.T, theta)
    raise _not_converged()


def _relative(change: Array, deflection: Array) -> float:
    """Largest change of the angles (3 d, n) relative to the largest angle; 0 without change."""
    angles = len(deflection) // 3
    size = np.max(np.abs(change[:angles]))
    return float(size / np.max(np.abs(deflection[:angles]))) if size else 0.0


class _Regime(Protocol):
    """Linear model of the deflection over a record: static poses or an oscillator."""

    def partial_derivative(self, equations: EquationOfMotion, signals: Array, deflection: Array, theta: Array) -> Array:
        """Partial derivative (k, 3 d, n) of the deflection in theta at constant input: dR g."""

    def solution(self, by_deflection: Array, right: Array, tolerance: float) -> Array:
        """Solution R dg (3 d, n) of by_deflection (n, d, 3 d) R dg = right (d, n)."""

    def derivatives(self, by_deflection: Array, rights: Array) -> Array:
        """Solutions R dg (k, 3 d, n) for right sides (k, d, n), to `DERIVATIVE_TOLERANCE`."""

    def initial_deflection(
        self, equations: EquationOfMotion, balance: MotionResidual, signals: Array, theta: Array
    ) -> Array:
        """Initial deflection (3 d, n)."""

    def anderson_converges(self, balance: MotionResidual, deflection: Array, tolerance: float) -> bool:
        """Improve a deflection (3 d, n) in place by Anderson mixing; True if it has converged."""


@dataclass(frozen=True)
class _StaticPoses:
    """Static equilibrium of each sample, zero rates."""

    def partial_derivative(self, equations: EquationOfMotion, signals: Array, deflection: Array, theta: Array) -> Array:
        return np.zeros((len(theta), *deflection.shape))

    def solution(self, by_deflection: Array, right: Array, tolerance: float) -> Array:
        size = len(right)
        change = np.zeros((3 * size, right.shape[1]))
        change[:size] = np.linalg.solve(by_deflection[:, :, :size], right.T[:, :, None])[:, :, 0].T
        return change

    def derivatives(self, by_deflection: Array, rights: Array) -> Array:
        return np.stack([self.solution(by_deflection, right, DERIVATIVE_TOLERANCE) for right in rights])

    def initial_deflection(
        self, equations: EquationOfMotion, balance: MotionResidual, signals: Array, theta: Array
    ) -> Array:
        return np.zeros((3 * equations.size, len(signals)))

    def anderson_converges(self, balance: MotionResidual, deflection: Array, tolerance: float) -> bool:
        return False


@dataclass(frozen=True, eq=False)
class _OscillatingTool:
    """Oscillator that approximates the tool; its coefficients are a mean over every `thinned`-th sample."""

    oscillator: Oscillator
    thinned: int

    @classmethod
    def of(cls, equations: EquationOfMotion, signals: Array, theta: Array, clock: TimeBase) -> _OscillatingTool:
        """With the mean derivatives of the equation of motion at zero deflection as coefficients."""
        thinned = max(1, len(signals) // LINEARISATION_SAMPLES)
        some = signals[::thinned]
        _, by_deflection = equations.at(some, np.zeros((len(some), 3 * equations.size)), theta)
        mean = _coefficients(np.mean(by_deflection, axis=0))
        if np.min(np.linalg.eigvalsh(mean.stiffness)) <= 0:
            raise _not_converged()
        return cls(Oscillator.of(mean, clock), thinned)

    def partial_derivative(self, equations: EquationOfMotion, signals: Array, deflection: Array, theta: Array) -> Array:
        if self.oscillator.clock.periodic:
            return np.zeros((len(theta), *deflection.shape))
        changes = np.moveaxis(equations.mean_change(signals[:: self.thinned], theta), 2, 0)
        derivatives = np.zeros((len(theta), *deflection.shape))
        for derivative, change in zip(derivatives, changes, strict=True):
            if change.any():
                derivative += self.oscillator.change(deflection, _coefficients(change))
        return derivatives

    def solution(self, by_deflection: Array, right: Array, tolerance: float) -> Array:
        from scipy.sparse.linalg import LinearOperator, gmres

        if not np.any(right):
            return np.zeros((by_deflection.shape[2], right.shape[1]))

        def applied(drive: Array) -> Array:
            response = self.oscillator.response(drive.reshape(right.shape))
            return _product(by_deflection, response).ravel()

        operator = LinearOperator((right.size, right.size), matvec=applied, dtype=np.float64)
        restart = min(KRYLOV_DIMENSION, max(STORED_NUMBERS // right.size, MINIMUM_KRYLOV_DIMENSION), right.size)
        drive, unsolved = gmres(
            operator, right.ravel(), rtol=tolerance, restart=restart, maxiter=-(-MAXIMUM_PRODUCTS // restart)
        )
        if unsolved or not np.all(np.isfinite(drive)):
            raise _not_converged()
        return self.oscillator.response(drive.reshape(right.shape))

    def derivatives(self, by_deflection: Array, rights: Array) -> Array:
        derivatives = np.zeros((len(rights), by_deflection.shape[2], rights.shape[2]))
        moved = np.flatnonzero(rights.any(axis=(1, 2)))
        drives = self._direct_drives(by_deflection, rights[moved]) if len(moved) else None
        for number, place in enumerate(moved):
            right = rights[place]
            if drives is not None:
                derivatives[place] = self.oscillator.response(drives[number])
            if drives is None or not _is_solution(by_deflection, derivatives[place], right):
                derivatives[place] = self.solution(by_deflection, right, DERIVATIVE_TOLERANCE)
        return derivatives

    def _direct_drives(self, by_deflection: Array, rights: Array) -> Array | None:
        """Drives (k, d, n) for right sides (k, d, n) by one factorisation; None where it is too large or singular."""
        periodic, (count, size, _) = self.oscillator.clock.periodic, by_deflection.shape
        if periodic and count * size > FACTORISED_EQUATIONS:
            return None
        if not periodic and TransientEquations.stored_numbers(count, size) > STORED_NUMBERS:
            return None
        try:
            if periodic:
                flat = rights.reshape(len(rights), -1)
                drives = np.asarray(np.linalg.solve(self._matrix(by_deflection), flat.T).T).reshape(rights.shape)
            else:
                drives = self.oscillator.transient_inputs(by_deflection, rights)
        except np.linalg.LinAlgError:
            return None
        return drives if np.all(np.isfinite(drives)) else None

    def _matrix(self, by_deflection: Array) -> Array:
        """F' R (d n, d n) of a steady state: R is a convolution with the responses to an impulse at each angle."""
        count, size, _ = by_deflection.shape
        impulses = np.zeros((size, size, count))
        impulses[:, :, 0] = np.eye(size)
        responses = np.stack([self.oscillator.response(impulse) for impulse in impulses])
        lag = np.subtract.outer(np.arange(count), np.arange(count)) % count
        matrix = np.einsum("til,jlts->itjs", by_deflection, responses[:, :, lag])
        return np.asarray(matrix.reshape(size * count, size * count))

    def initial_deflection(
        self, equations: EquationOfMotion, balance: MotionResidual, signals: Array, theta: Array
    ) -> Array:
        """For a long record, the interpolated solution of a decimated one (nested iteration); otherwise 0.

        With C the oscillator's coefficients, g = C b - F(b) restores jumps of the load, which interpolation smooths.
        """
        count, clock = len(signals), self.oscillator.clock
        zero = np.zeros((3 * equations.size, count))
        if clock.periodic or clock.dt is None or count < COARSENING_FACTOR * LINEARISATION_SAMPLES:
            return zero
        decimated = TimeBase(clock.dt * COARSENING_FACTOR, periodic=False)
        try:
            coarse = solve_deflection(
                equations, signals[::COARSENING_FACTOR], theta, decimated, derivative=False, tolerance=COARSE_TOLERANCE
            )
        except InputError:
            return zero
        deflection = interpolated(np.ascontiguousarray(coarse.values.T), COARSENING_FACTOR, count)
        return self.oscillator.response(self.oscillator.drive(deflection) - balance.of(deflection))

    def anderson_converges(self, balance: MotionResidual, deflection: Array, tolerance: float) -> bool:
        """Anderson mixing of g <- g + f with f = -F(R g)."""
        shape = (len(deflection) // 3, deflection.shape[1])
        size = shape[0] * shape[1]
        mixing, first = (
            AndersonMixing(size, min(ANDERSON_DEPTH, max(STORED_NUMBERS // (2 * size), MINIMUM_KRYLOV_DIMENSION))),
            0.0,
        )
        for number in range(ANDERSON_STEPS):
            residual = -balance.of(deflection).ravel()
            largest = np.abs(residual).max()
            first = largest if number == 0 else first
            if not largest <= DIVERGENCE_FACTOR * first:  # or not finite
                deflection[:] = 0.0  # Newton converges better from zero than from a diverged iterate
                return False
            if number >= ANDERSON_TRIAL_STEPS and largest > first * ANDERSON_CONTRACTION**number:
                return False
            change = self.oscillator.response(mixing.step(residual).reshape(shape))
            deflection += change
            if _relative(change, deflection) <= tolerance:
                return True
        return False


def _is_solution(by_deflection: Array, response: Array, right: Array) -> bool:
    """Whether by_deflection (n, d, 3 d) response (3 d, n) is right (d, n), to `DERIVATIVE_TOLERANCE`."""
    error = np.linalg.norm(_product(by_deflection, response) - right)
    return bool(error <= DERIVATIVE_TOLERANCE * np.linalg.norm(right))


def _product(by_deflection: Array, change: Array) -> Array:
    """by_deflection (n, d, 3 d) times a change (3 d, n) at each sample, (d, n)."""
    return np.asarray(np.einsum("nij,jn->in", by_deflection, change))


def _deflection_derivatives(
    equations: EquationOfMotion, regime: _Regime, signals: Array, deflection: Array, theta: Array
) -> Array:
    _, by_deflection = equations.at(signals, deflection.T, theta)
    by_theta = equations.by_parameters(signals, deflection.T, theta)
    slopes = regime.partial_derivative(equations, signals, deflection, theta)
    rights = np.stack([-by_theta[:, :, j].T - _product(by_deflection, slope) for j, slope in enumerate(slopes)])
    return (slopes + regime.derivatives(by_deflection, rights)).transpose(2, 1, 0)


def _coefficients(by_deflection: Array) -> OscillatorCoefficients:
    """Oscillator coefficients from derivatives (d, 3 d) of F in angles, rates and accelerations, or their changes."""
    stiffness, damping, mass = np.split(by_deflection, 3, axis=1)
    return OscillatorCoefficients(
        (mass + mass.T) / 2, float(np.trace(damping)) / len(damping), (stiffness + stiffness.T) / 2
    )


def _not_converged() -> InputError:
    return InputError(
        what="the deflection did not converge: the spring does not carry the tool",
        where="tip_flexibility",
        remedy="bound its stiffness from below and its damping above zero, or leave it out",
    )
