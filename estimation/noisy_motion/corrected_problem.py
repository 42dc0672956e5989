"""CorrectedProblem: whitened least squares less what the noise of the motion adds to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit, Problem
from estimation.linear.least_squares import Sight
from estimation.noise import Noise
from estimation.noisy_motion.effective_noise import effective
from estimation.noisy_motion.input_noise import InputNoise
from estimation.noisy_motion.noisy_load import NoisyLoad
from estimation.recording import Recording
from estimation.response import Response, repeats_with_motion, signals_of
from modeling.prediction import Emitted

Array = NDArray[np.float64]

PROBES = 60
"""Random signs per expectation. They err only as far as the weights tie samples together: with n samples and a
correlation of a few of them by about sqrt(2 · few / (60 n)) of the correction, far below the std of any unknown."""
AT_ONCE = 10
"""Random signs whitened together: enough to be quick, few enough for the memory of a long record."""
RELIABLE = 0.1
"""Share of true motion in a direction below which it is not shown: an input noise stated 5 % wrong would move the
value by half of itself."""
STEP_TOLERANCE = 1e-6
"""Drop of chi-square below which the fit has come to rest, as in `estimation.fit`."""
MOST_STEPS = 40
ROUNDING = 1e-9
"""Share of the largest singular value at which a direction is only rounding."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """The corrected chi-square about a point, to second order.

    cost      whitened chi-square less what the noise of the inputs adds to it
    gradient  (k,) minus half its derivative
    plain     (k, k) triangle of the whitened derivative, R'R the information as plain least squares sees it
    excess    (k, k) what the noise of the inputs adds to that information
    """

    cost: float
    gradient: Array
    plain: Array
    excess: Array

    @cached_property
    def sight(self) -> Sight:
        """What the signals show, noise and all."""
        return Sight.of(self.plain, ROUNDING)

    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Reliability (m,) and axes (k, m): axes' N axes = diag(reliability), axes' R'R axes = 1 on what is seen."""
        kept = self.sight.seen
        seen = self.sight.right[kept].T / self.sight.singular[kept] / self.sight.scale[:, None]
        share, turned = np.linalg.eigh(seen.T @ self.excess @ seen)
        return 1.0 - share, seen @ turned

    @property
    def reliability(self) -> float:
        """The least share of true motion in what a direction of the unknowns is seen by; 1 without noise."""
        return float(self._axes[0].min(initial=1.0))

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Which unknowns (k,) have no part in a direction that is unseen, or not `RELIABLE`."""
        reliability, axes = self._axes
        lost = (self.sight.scale[:, None] * axes)[:, reliability < RELIABLE]
        lost = lost / np.linalg.norm(lost, axis=0)
        return np.asarray(self.sight.shown & (np.linalg.norm(lost, axis=1) < 1e-3))

    def step(self, damping: float) -> Array:
        """Levenberg's step on axes in which plain least squares has unit information."""
        reliability, axes = self._axes
        kept = reliability >= RELIABLE
        return np.asarray(axes[:, kept] @ ((axes[:, kept].T @ self.gradient) / (reliability[kept] + damping)))

    @property
    def covariance(self) -> Array:
        """N^-1 R'R N^-1, N the information of the true signals and R'R the variance of the gradient."""
        reliability, axes = self._axes
        kept = reliability >= RELIABLE
        inverse = (axes[:, kept] / reliability[kept]) @ axes[:, kept].T
        return np.asarray(inverse @ self.plain.T @ self.plain @ inverse)


@dataclass(frozen=True, eq=False)
class CorrectedProblem:
    """Whitened least squares less what the noise of the inputs adds to it.

    With the signals u + e in place of the true u, to second order in the noise e,

        E |W (y - f(u + e, θ))|² = |W (y - f(u, θ))|² + E |W f_u e|²      (f unbiased: `UnbiasedModel`)

    for every θ, so that |W (y - f(u + e))|² - E |W f_u(θ) e|² has the chi-square of the true signals as its mean, and
    what minimises it is consistent (Nakamura, Biometrika 77, 1990; for linear models it is the corrected normal
    equations of Fuller, Measurement Error Models, 1987, chapter 2). Unlike orthogonal regression it needs the noise of
    the inputs only: the readings' noise, coloured as it may be, and effects that the model misses are not put down to
    the motion. The expectation is over random signs, E |W x|² = mean |W x_b|² with x_b = f_u root(Σ) signs_b
    (Hutchinson, 1990): exact for white readings, else to a thousandth.

    slopes  per recording f_u, the derivative of the load in the errors of its signals
    roots   per recording root(Σ) (s, s) of the signals, averaged over the repeats
    """

    problem: Problem
    slopes: tuple[Emitted, ...]
    roots: tuple[Array, ...]

    @classmethod
    def of(cls, fitted: Fit, inputs: InputNoise) -> CorrectedProblem:
        """The problem of a plain fit when its signals have the noise `inputs`."""
        several = fitted.recordings
        loads = [NoisyLoad.of(own, r, inputs) for own, r in zip(fitted.layout.models, several, strict=True)]
        models = tuple(load.unbiased(inputs, r.repeats) for load, r in zip(loads, several, strict=True))
        roots = tuple(_root(inputs.covariance / r.repeats) for r in several)
        problem = Problem(replace(fitted.layout, models=models), several, fitted.noise)
        return cls(problem, tuple(load.emitted for load in loads), roots)

    def weighted(self, theta: Array, noise: Sequence[Noise]) -> CorrectedProblem:
        """The problem weighted with the effective noise at theta (k,): `noise` of the readings, and of the inputs."""
        added = (self._added(number, theta) for number in range(len(noise)))
        whole = tuple(effective(n, r, a) for n, r, a in zip(noise, self.problem.recordings, added, strict=True))
        return replace(self, problem=replace(self.problem, noise=whole))

    def _added(self, number: int, theta: Array) -> Array:
        """Covariance (p, p) that the inputs' noise gives the prediction of one sample of one repeat, on average."""
        recording = self.problem.recordings[number]
        slope = self._slope(number, theta, recording.samples_per_repeat)[0] @ self.roots[number]
        return np.asarray(np.einsum("npi,nqi->pq", slope, slope) * recording.repeats / len(slope))

    def _slope(self, number: int, theta: Array, samples: int) -> tuple[Array, Array]:
        """f_u (samples, p, s) of a recording, and its derivative (samples, p, s, k) in the recording's parameters."""
        recording = self.problem.recordings[number]
        own = theta[self.problem.layout.index[number]]
        value, derivative = self.slopes[number].tangent(signals_of(recording), own, samples)
        shape = (samples, len(recording.channels), len(self.roots[number]))
        return value.reshape(shape), derivative.reshape(*shape, len(own))

    def expand(self, theta: Array) -> Expansion:
        """The corrected chi-square about theta (k,)."""
        residual, derivative = self.problem.evaluate(theta)
        cost, gradient = float(residual @ residual), derivative.T @ residual
        excess = np.zeros((len(theta), len(theta)))
        for number, index in enumerate(self.problem.layout.index):
            for error, slope in self._errors(number, theta):
                cost -= float(error @ error) / PROBES
                gradient[index] += slope.T @ error / PROBES
                excess[np.ix_(index, index)] += slope.T @ slope / PROBES
        return Expansion(cost, gradient, np.asarray(np.linalg.qr(derivative, mode="r")), excess)

    def _errors(self, number: int, theta: Array) -> Iterator[tuple[Array, Array]]:
        """Whitened errors x_b of the prediction of a recording, (rows b,), and derivatives (rows b, k) in its own
        parameters, a few b at a time."""
        recording, whitener = self.problem.recordings[number], self.problem.noise[number].whitener
        steady, once = repeats_with_motion(self.slopes[number].inputs, recording), recording.samples_per_repeat
        repeats = 1 if steady else recording.repeats
        value, derivative = self._slope(number, theta, once * repeats)
        generator = np.random.default_rng(number)
        for _ in range(PROBES // AT_ONCE):
            signs = generator.choice([-1.0, 1.0], (once, AT_ONCE, value.shape[2]))
            errors = np.tile(signs @ self.roots[number].T, (repeats, 1, 1))
            parts = value @ errors.swapaxes(1, 2), np.einsum("npik,nbi->npbk", derivative, errors, optimize=True)
            error, slope = whitener.response(_response(parts, recording, steady))
            yield error.ravel(), slope.reshape(-1, slope.shape[-1])

    def minimise(self, start: Array) -> tuple[Array, Expansion, bool]:
        """Unknowns (k,) within their bounds, the expansion there, and whether the steps came to rest."""
        low, high = (np.array([p.bounds[i] for p in self.problem.layout.parameters]) for i in (0, 1))
        theta, damping = np.clip(start, low, high), 0.0
        here = self.expand(theta)
        for _ in range(MOST_STEPS):
            step = here.step(damping)
            if here.gradient @ step < STEP_TOLERANCE:
                return theta, here, True
            trial = np.clip(theta + step, low, high)
            there = self.expand(trial)
            gain = here.cost - there.cost
            if gain > 0:
                theta, here, damping = trial, there, damping / 10
            else:
                damping = max(10 * damping, 1e-6)
            if abs(gain) < STEP_TOLERANCE or damping > 1e6:
                return theta, here, True
        return theta, here, False


def _root(covariance: Array) -> Array:
    """A square root (s, s), which need not be regular."""
    variance, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variance, 0.0)))


def _response(parts: tuple[Array, Array], recording: Recording, steady: bool) -> Response:
    """Value and derivative of one repeat that comes again in all, or of a whole record."""
    if steady:
        return Response(parts, None, recording.repeats)
    still = [np.zeros((recording.samples_per_repeat, *part.shape[1:])) for part in parts]
    return Response((still[0], still[1]), parts, recording.repeats)
