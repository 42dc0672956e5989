"""Corrected-score least squares (Nakamura): chi-square less the contribution of input noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.errors_in_variables.error_propagation import ErrorPropagation
from estimation.errors_in_variables.input_noise import InputNoise
from estimation.fit import Fit, WhitenedProblem
from estimation.model_response import ModelResponse, signals_are_periodic
from estimation.model_signals import model_signals
from estimation.noise.leakage import without_leakage
from estimation.noise.recording_noise import NoiseSource, RecordingNoise, sample_step
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, Whitener
from estimation.recordings.recording import Recording
from modeling.chain.prediction import VectorFunction
from modeling.identifiability import UNIDENTIFIABLE_SHARE, ScaledSVD
from modeling.noise.channel_whitening import inverse_cholesky_factor

Array = NDArray[np.float64]

HUTCHINSON_PROBES = 60
"""Random sign vectors per expectation. The error is due to correlation of samples by the weights alone: with n samples
correlated over a few, about sqrt(2 · few / (60 n)) of the correction, far below the std of any parameter."""
PROBES_AT_ONCE = 10
"""Sign vectors whitened at once: a compromise between speed and storage for a long record."""
MIN_RELIABILITY = 0.1
"""Reliability (share of true signal) below which a direction is unidentifiable: an input noise stated 5 % wrong would
change the value by half."""
CORRECTED_STEP_TOLERANCE = 1e-6
"""Decrease of chi-square below which the fit has converged, as in `levenberg_marquardt`."""
MAX_CORRECTED_STEPS = 40


@dataclass(frozen=True, eq=False)
class CorrectedScoreExpansion:
    """The corrected chi-square about a point, to second order.

    cost      whitened chi-square less the contribution of the input noise
    gradient  (k,) minus half its derivative
    plain     (k, k) R factor of the whitened derivative, R'R the information of ordinary least squares
    excess    (k, k) contribution of the input noise to that information
    """

    cost: float
    gradient: Array
    plain: Array
    excess: Array

    @cached_property
    def scaled_svd(self) -> ScaledSVD:
        """Scaled SVD of the information of the noisy signals."""
        return ScaledSVD.of(self.plain)

    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Reliability (m,) and axes (k, m): axes' N axes = diag(reliability), axes' R'R axes = 1 if identifiable."""
        regular = self.scaled_svd.regular
        whitening = self.scaled_svd.right[regular].T / self.scaled_svd.singular[regular]
        whitening = whitening / self.scaled_svd.scale[:, None]
        noise_share, axes = np.linalg.eigh(whitening.T @ self.excess @ whitening)
        return 1.0 - noise_share, whitening @ axes

    @property
    def reliability(self) -> float:
        """Smallest reliability over the directions: share of the information due to true motion; 1 without noise."""
        return float(self._axes[0].min(initial=1.0))

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """Identifiable parameters (k,): no component in the null space or in a direction below `MIN_RELIABILITY`."""
        reliability, axes = self._axes
        lost = (self.scaled_svd.scale[:, None] * axes)[:, reliability < MIN_RELIABILITY]
        lost = lost / np.linalg.norm(lost, axis=0)
        return np.asarray(self.scaled_svd.identifiable & (np.linalg.norm(lost, axis=1) < UNIDENTIFIABLE_SHARE))

    def step(self, damping: float) -> Array:
        """Levenberg step on axes in which ordinary least squares has unit information."""
        reliability, axes = self._axes
        kept = reliability >= MIN_RELIABILITY
        return np.asarray(axes[:, kept] @ ((axes[:, kept].T @ self.gradient) / (reliability[kept] + damping)))

    @property
    def covariance(self) -> Array:
        """N^-1 R'R N^-1, N the information of the true signals and R'R the variance of the gradient."""
        reliability, axes = self._axes
        kept = reliability >= MIN_RELIABILITY
        inverse = (axes[:, kept] / reliability[kept]) @ axes[:, kept].T
        return np.asarray(inverse @ self.plain.T @ self.plain @ inverse)


@dataclass(frozen=True, eq=False)
class CorrectedScoreProblem:
    """Whitened least squares less the expected contribution of the input noise.

    With the signals u + e in place of the true u, to second order in the noise e,

        E |W (y - f(u + e, θ))|² = |W (y - f(u, θ))|² + E |W f_u e|²      (f unbiased: `BiasCorrectedModel`)

    for every θ, so that |W (y - f(u + e))|² - E |W f_u(θ) e|² has the chi-square of the true signals as its mean, and
    its minimum is consistent (Nakamura, Biometrika 77, 1990; for linear models it is the corrected normal
    equations of Fuller, Measurement Error Models, 1987, chapter 2). Unlike orthogonal regression it needs the noise of
    the inputs only: coloured noise of the readings and effects missing from the model are not attributed to the motion.
    The expectation is over random signs, E |W x|² = mean |W x_b|² with x_b = f_u root(Σ) signs_b
    (Hutchinson, 1990): exact for white readings, else to a thousandth.

    slopes  per recording f_u, the derivative of the load in the errors of its signals
    roots   per recording root(Σ) (s, s) of the signals, averaged over the repeats
    """

    problem: WhitenedProblem
    slopes: tuple[VectorFunction, ...]
    roots: tuple[Array, ...]

    @classmethod
    def of(cls, fitted: Fit, inputs: InputNoise) -> CorrectedScoreProblem:
        """The corrected problem of an ordinary fit whose signals have the noise `inputs`."""
        several = fitted.recordings
        loads = [ErrorPropagation.of(own, r, inputs) for own, r in zip(fitted.layout.models, several, strict=True)]
        models = tuple(load.unbiased(inputs, r.repeats) for load, r in zip(loads, several, strict=True))
        roots = tuple(_root(inputs.covariance / r.repeats) for r in several)
        problem = WhitenedProblem(replace(fitted.layout, models=models), several, fitted.noise)
        return cls(problem, tuple(load.emitted for load in loads), roots)

    def weighted(self, theta: Array, noise: Sequence[RecordingNoise]) -> CorrectedScoreProblem:
        """The problem whitened by the effective noise at theta (k,): `noise` of the readings plus input noise."""
        added = (self._added(number, theta) for number in range(len(noise)))
        whole = tuple(effective_noise(n, r, a) for n, r, a in zip(noise, self.problem.recordings, added, strict=True))
        return replace(self, problem=replace(self.problem, noise=whole))

    def _added(self, number: int, theta: Array) -> Array:
        """Mean covariance (p, p) of the prediction of one sample of one repeat due to the input noise."""
        recording = self.problem.recordings[number]
        slope = self._slope(number, theta, recording.samples_per_repeat)[0] @ self.roots[number]
        return np.asarray(np.einsum("npi,nqi->pq", slope, slope) * recording.repeats / len(slope))

    def _slope(self, number: int, theta: Array, samples: int) -> tuple[Array, Array]:
        """f_u (samples, p, s) of a recording, and its derivative (samples, p, s, k) in the recording's parameters."""
        recording = self.problem.recordings[number]
        own = theta[self.problem.layout.index[number]]
        value, derivative = self.slopes[number].tangent(model_signals(recording), own, samples)
        shape = (samples, len(recording.channels), len(self.roots[number]))
        return value.reshape(shape), derivative.reshape(*shape, len(own))

    def expand(self, theta: Array) -> CorrectedScoreExpansion:
        """The corrected chi-square about theta (k,)."""
        residual, derivative = self.problem.evaluate(theta)
        cost, gradient = float(residual @ residual), derivative.T @ residual
        excess = np.zeros((len(theta), len(theta)))
        for number, index in enumerate(self.problem.layout.index):
            for error, slope in self._errors(number, theta):
                cost -= float(error @ error) / HUTCHINSON_PROBES
                gradient[index] += slope.T @ error / HUTCHINSON_PROBES
                excess[np.ix_(index, index)] += slope.T @ slope / HUTCHINSON_PROBES
        return CorrectedScoreExpansion(cost, gradient, np.asarray(np.linalg.qr(derivative, mode="r")), excess)

    def _errors(self, number: int, theta: Array) -> Iterator[tuple[Array, Array]]:
        """Whitened prediction errors x_b of a recording, (rows b,), and their derivatives (rows b, k) in its own
        parameters, in batches of b."""
        recording, whitener = self.problem.recordings[number], self.problem.noise[number].whitener
        periodic, once = signals_are_periodic(self.slopes[number].inputs, recording), recording.samples_per_repeat
        repeats = 1 if periodic else recording.repeats
        value, derivative = self._slope(number, theta, once * repeats)
        generator = np.random.default_rng(number)
        for _ in range(HUTCHINSON_PROBES // PROBES_AT_ONCE):
            signs = generator.choice([-1.0, 1.0], (once, PROBES_AT_ONCE, value.shape[2]))
            errors = np.tile(signs @ self.roots[number].T, (repeats, 1, 1))
            parts = value @ errors.swapaxes(1, 2), np.einsum("npik,nbi->npbk", derivative, errors, optimize=True)
            error, slope = whitener.response(_response(parts, recording, periodic))
            yield error.ravel(), slope.reshape(-1, slope.shape[-1])

    def minimise(self, start: Array) -> tuple[Array, CorrectedScoreExpansion, bool]:
        """Parameters (k,) within their bounds, the expansion there, and whether the iteration converged."""
        low, high = (np.array([p.bounds[i] for p in self.problem.layout.parameters]) for i in (0, 1))
        theta, damping = np.clip(start, low, high), 0.0
        here = self.expand(theta)
        for _ in range(MAX_CORRECTED_STEPS):
            step = here.step(damping)
            if here.gradient @ step < CORRECTED_STEP_TOLERANCE:
                return theta, here, True
            trial = np.clip(theta + step, low, high)
            there = self.expand(trial)
            gain = here.cost - there.cost
            if gain > 0:
                theta, here, damping = trial, there, damping / 10
            else:
                damping = max(10 * damping, 1e-6)
            if abs(gain) < CORRECTED_STEP_TOLERANCE or damping > 1e6:
                return theta, here, True
        return theta, here, False


def _root(covariance: Array) -> Array:
    """A square root (s, s) of a covariance that may be singular."""
    variance, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variance, 0.0)))


def _response(parts: tuple[Array, Array], recording: Recording, periodic: bool) -> ModelResponse:
    """Response from value and derivative of one repeat (`periodic`) or of the whole record."""
    if periodic:
        return ModelResponse(parts, None, recording.repeats)
    zero = [np.zeros((recording.samples_per_repeat, *part.shape[1:])) for part in parts]
    return ModelResponse((zero[0], zero[1]), parts, recording.repeats)


def effective_noise(noise: RecordingNoise, recording: Recording, added: Array) -> RecordingNoise:
    """Noise of the residual of a recording whose prediction is noisy as well.

    `added` (p, p) is the covariance of the prediction of one sample of one repeat due to the input noise, averaged
    over the motion: white, so that it adds to the spectrum at the excited lines (the prediction has only those).
    Weights constant in time lose almost no efficiency against (S + f_u Σ f_u')^-1 sample by sample, and cannot be
    correlated with the noise of a sample. Noise estimated from a residual already includes the input noise.
    """
    own = noise.whitener
    if noise.source is NoiseSource.RESIDUAL:
        return noise
    if isinstance(own, AutoregressiveWhitener):
        whitener: Whitener = replace(own, noise=replace(own.noise, covariance=own.noise.covariance + added))
    else:
        assert isinstance(own, FourierLineWhitener)
        excited, non_excited = np.split(own.root, [len(own.excited_lines)])
        colouring = np.linalg.inv(excited)
        covariance = (colouring @ colouring.conj().swapaxes(-1, -2) + added).astype(np.complex128)
        root = np.concatenate([inverse_cholesky_factor(covariance), non_excited])
        plain = FourierLineWhitener(own.samples, own.repeats, own.excited_lines, own.non_excited_lines, root)
        whitener = without_leakage(plain, noise.spectra, sample_step(recording))
    return replace(noise, floor=np.sqrt(noise.floor**2 + np.diag(added)), whitener=whitener)
