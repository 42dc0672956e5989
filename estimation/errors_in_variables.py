"""Errors-in-variables fit: a model whose motion signals are measured with noise, by the corrected score."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit, fit
from estimation.input_noise import InputNoise
from estimation.least_squares.estimates import PARAMETER_COLUMNS
from estimation.least_squares.problem import Problem
from estimation.model_response import ModelResponse, signals_are_periodic, with_loads
from estimation.noise.power_spectrum import without_leakage
from estimation.noise.recording_noise import RecordingNoise, sample_step
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, PoseWhitener, Whitener
from estimation.recordings.column_table import ORIENTATION_ERRORS
from estimation.recordings.motion import QUATERNION
from estimation.recordings.recording import Recording
from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import VectorFunction, compiled_prediction
from modeling.errors import InputError
from modeling.identifiability import UNIDENTIFIABLE_SHARE, ScaledSVD
from modeling.kinematics.arm import POSE_SIGNALS, PlanarArm
from modeling.noise import NoiseSource, inverse_cholesky_factor
from modeling.table import Column, Table, Tabular, Value

Array = NDArray[np.float64]

JOINT_SIGNAL = r"d{0,2}q\d+"


@dataclass(frozen=True, kw_only=True)
class BiasCorrectedModel(WrenchModel):
    """A model whose prediction from noisy signals is unbiased to second order in the noise.

    E f(u + e) = f(u) + curvature, with curvature = 1/2 sum_ij cov_ij d²f / du_i du_j to second order in e (and
    exactly where f is quadratic: dphi²); it is subtracted from the load.
    """

    curvature: sp.ImmutableMatrix

    @cached_property
    def load(self) -> sp.Matrix:
        """The load less its bias due to the noise of the signals."""
        return super().load - self.curvature


@dataclass(frozen=True)
class ErrorPropagation:
    """Load of a model as a function of the errors e (s,) of its input signals.

    `lengths` are the link lengths (m) when the motion is recorded as joint angles, else empty; `base` is the angle of
    the arm's base (rad).
    """

    model: WrenchModel
    names: tuple[str, ...]
    lengths: tuple[float, ...] = ()
    base: float = 0.0

    @classmethod
    def of(cls, model: WrenchModel, recording: Recording, noise: InputNoise) -> ErrorPropagation:
        """The load of a model for a recording whose signals have this noise.

        Raises InputError when the recording has no signal of such a name, or the model uses none of them.
        """
        arm = recording.arm if isinstance(recording.arm, PlanarArm) else PlanarArm(())
        lengths = arm.link_lengths
        usable = {*recording.signals, *(ORIENTATION_ERRORS if "qw" in recording.signals else ())}
        for name in noise.names:
            if re.fullmatch(JOINT_SIGNAL, name) and not lengths and name in usable:
                raise InputError(
                    what=f"the noise of '{name}' can be propagated through a planar arm only",
                    where=recording.name,
                    remedy=f"state the noise of the sensor's motion ({', '.join(ORIENTATION_ERRORS)}, wx ..) instead",
                )
            if name not in usable:
                raise InputError(
                    what=f"there is no signal '{name}'",
                    where=recording.name,
                    remedy="state the noise of signals that the recording has",
                )
        propagation = _cached(cls(model, noise.names, tuple(lengths), arm.base))
        if not propagation._symbols:
            raise InputError(
                what=f"the model uses none of {', '.join(noise.names)}",
                where=recording.name,
                remedy="state the noise of signals on which its prediction depends",
            )
        return propagation

    @cached_property
    def errors(self) -> tuple[sp.Symbol, ...]:
        """Symbols of the errors."""
        return tuple(sp.Symbol(f"error_{name}", real=True) for name in self.names)

    @cached_property
    def _perturbed(self) -> Mapping[sp.Symbol, sp.Expr]:
        """Signals with their errors; poses of an arm with joint signals by its kinematics."""
        error = dict(zip(self.names, self.errors, strict=True))
        perturbed = {sp.Symbol(name, real=True): sp.Symbol(name, real=True) + e for name, e in error.items()}
        if set(ORIENTATION_ERRORS) & set(self.names):
            perturbed |= _rotated_quaternion(*(error.get(name, sp.S.Zero) for name in ORIENTATION_ERRORS))
        if not any(re.fullmatch(JOINT_SIGNAL, name) for name in self.names):
            return perturbed
        kinematics = PlanarArm(self.lengths, self.base).kinematics
        shift = {sp.Symbol(n, real=True): error.get(n, sp.S.Zero) for n in POSE_SIGNALS}
        return perturbed | {s: kinematics[s.name].xreplace(perturbed) + extra for s, extra in shift.items()}

    @cached_property
    def _symbols(self) -> list[sp.Symbol]:
        """The signals (a) of the load that have errors."""
        return [symbol for symbol in self._perturbed if symbol in self.model.load.free_symbols]

    @cached_property
    def _signals(self) -> sp.Matrix:
        """These signals with their errors, (a, 1)."""
        return sp.Matrix(len(self._symbols), 1, [self._perturbed[symbol] for symbol in self._symbols])

    @cached_property
    def _gradient(self) -> sp.Matrix:
        """d load / d signal, (p, a)."""
        return self.model.load.jacobian(self._symbols)

    @cached_property
    def _signal_jacobian(self) -> sp.Matrix:
        """d signal / d error at zero error, (a, s)."""
        return self._at_zero_error(self._signals.jacobian(self.errors))

    @cached_property
    def slopes(self) -> sp.Matrix:
        """d load / d error at zero error, (p, s)."""
        return self._gradient * self._signal_jacobian

    def curvature(self, covariance: sp.Matrix) -> sp.Matrix:
        """Second-order bias 1/2 sum_ij cov_ij d² load / d error_i d error_j at zero error, (p, 1).

        By the chain rule: the Hessian in the signals with their covariance, and the gradient in the signals with their
        own second-order bias.
        """
        covariances, bias = (
            self._signal_jacobian * covariance * self._signal_jacobian.T,
            sp.zeros(self._gradient.rows, 1),
        )
        for a, (slope, hessian) in enumerate(zip(self._gradient_slopes, self._signal_hessians, strict=True)):
            bias += slope * covariances[:, a]
            bias += self._gradient[:, a] * (hessian.T * covariance).trace()
        return bias / 2

    @cached_property
    def _gradient_slopes(self) -> list[sp.Matrix]:
        """Derivative of the gradient, (p, a), by each signal."""
        return [self._gradient.diff(symbol) for symbol in self._symbols]

    @cached_property
    def _signal_hessians(self) -> list[sp.Matrix]:
        """d² signal / d error², (s, s), of each signal at zero error."""
        return [self._at_zero_error(sp.hessian(signal, self.errors)) for signal in self._signals]

    def _at_zero_error(self, expression: sp.Matrix) -> sp.Matrix:
        return expression.xreplace(dict.fromkeys(self.errors, sp.S.Zero))

    def unbiased(self, noise: InputNoise, repeats: int) -> WrenchModel:
        """The bias-corrected model for signals with this noise, averaged over `repeats`."""
        return _bias_corrected(self, tuple(map(tuple, (noise.covariance / repeats).tolist())))

    @cached_property
    def emitted(self) -> VectorFunction:
        """`slopes` (p s,), channel by channel, as a function of signals and parameters."""
        expression = self.slopes.reshape(self.slopes.rows * self.slopes.cols, 1)
        return VectorFunction.of(expression, self.model.inputs_of(expression), compiled_prediction(self.model).symbols)


@lru_cache(maxsize=32)
def _cached(load: ErrorPropagation) -> ErrorPropagation:
    """The first equal object, with its cached derivatives."""
    return load


@lru_cache(maxsize=32)
def _bias_corrected(load: ErrorPropagation, covariance: tuple[tuple[float, ...], ...]) -> WrenchModel:
    """The bias-corrected model for errors of this covariance (s, s): recordings of one noise share its compilation."""
    attributes = {f.name: getattr(load.model, f.name) for f in fields(load.model)}
    return BiasCorrectedModel(**attributes, curvature=sp.ImmutableMatrix(load.curvature(sp.Matrix(covariance))))


def _rotated_quaternion(x: sp.Expr, y: sp.Expr, z: sp.Expr) -> dict[sp.Symbol, sp.Expr]:
    """The quaternion q ⊗ (e/2, 1 - |e|²/8): rotated in the sensor frame by e (rad), to second order."""
    qx, qy, qz, w = (sp.Symbol(name, real=True) for name in QUATERNION)
    v, half = sp.Matrix([qx, qy, qz]), sp.Matrix([x, y, z]) / 2
    cosine = 1 - half.dot(half) / 2
    vector = w * half + cosine * v + v.cross(half)
    return dict(zip((qx, qy, qz, w), (*vector, w * cosine - v.dot(half)), strict=True))


# Corrected-score least squares (Nakamura): chi-square less the contribution of input noise.


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
"""At most, as in `levenberg_marquardt`; a fit that takes more is marked as not converged."""


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

    problem: Problem
    slopes: tuple[VectorFunction, ...]
    roots: tuple[Array, ...]

    @classmethod
    def of(cls, fitted: Fit, inputs: InputNoise) -> CorrectedScoreProblem:
        """The corrected problem of an ordinary fit whose signals have the noise `inputs`."""
        several = fitted.recordings
        loads = [ErrorPropagation.of(model, r, inputs) for model, r in zip(fitted.layout.models, several, strict=True)]
        models = tuple(load.unbiased(inputs, r.repeats) for load, r in zip(loads, several, strict=True))
        roots = tuple(_root(inputs.covariance / r.repeats) for r in several)
        problem = replace(fitted.problem, layout=replace(fitted.layout, models=models))
        return cls(problem, tuple(load.emitted for load in loads), roots)

    def weighted(self, theta: Array, noise: Sequence[RecordingNoise]) -> CorrectedScoreProblem:
        """The problem whitened by the effective noise at theta (k,): `noise` of the readings plus input noise."""
        added = (self._added(number, theta) for number in range(len(noise)))
        whole = tuple(effective_noise(n, r, a) for n, r, a in zip(noise, self.problem.recordings, added, strict=True))
        return replace(self, problem=self.problem.in_noise(whole))

    def _added(self, number: int, theta: Array) -> Array:
        """Mean covariance (p, p) of the prediction of one sample of one repeat due to the input noise."""
        recording = self.problem.recordings[number]
        slope = self._slope(number, theta, recording.samples_per_repeat)[0] @ self.roots[number]
        return np.asarray(np.einsum("npi,nqi->pq", slope, slope) * recording.repeats / len(slope))

    def _slope(self, number: int, theta: Array, samples: int) -> tuple[Array, Array]:
        """f_u (samples, p, s) of a recording, and its derivative (samples, p, s, k) in the recording's parameters."""
        recording = self.problem.recordings[number]
        values = with_loads(
            self.problem.layout.models[number], recording.loads, theta[self.problem.layout.index[number]]
        )
        value, derivative = self.slopes[number].tangent(recording.motion.model_signals, values, samples)
        shape = (samples, len(recording.channels), len(self.roots[number]))
        return value.reshape(shape), derivative.reshape(*shape, len(values))

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
        periodic = signals_are_periodic(self.slopes[number].inputs, recording.motion)
        once = recording.samples_per_repeat
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
    zero = [np.zeros((recording.samples_per_repeat, *array.shape[1:])) for array in parts]
    return ModelResponse((zero[0], zero[1]), parts, recording.repeats)


def effective_noise(noise: RecordingNoise, recording: Recording, added: Array) -> RecordingNoise:
    """Noise of the residual of a recording whose prediction is noisy as well.

    `added` (p, p) is the covariance of the prediction of one sample of one repeat due to the input noise, averaged
    over the motion: white, so that it adds to the spectrum at the excited lines (the prediction has only those).
    Weights constant in time lose almost no efficiency against (S + f_u Σ f_u')^-1 sample by sample, and cannot be
    correlated with the noise of a sample. Noise estimated from a residual already includes the input noise.
    """
    old = noise.whitener
    if noise.source is NoiseSource.RESIDUAL:
        return noise
    if isinstance(old, AutoregressiveWhitener):
        whitener: Whitener = replace(old, noise=replace(old.noise, covariance=old.noise.covariance + added))
    elif isinstance(old, PoseWhitener):
        roots = np.linalg.inv(old.roots)
        more = np.multiply.outer(np.diag(added), np.eye(recording.samples))
        whitener = PoseWhitener(inverse_cholesky_factor(roots @ roots.swapaxes(-1, -2) + more))
    else:
        assert isinstance(old, FourierLineWhitener)
        excited, non_excited = np.split(old.root, [len(old.excited_lines)])
        colouring = np.linalg.inv(excited)
        covariance = (colouring @ colouring.conj().swapaxes(-1, -2) + added).astype(np.complex128)
        root = np.concatenate([inverse_cholesky_factor(covariance), non_excited])
        plain = FourierLineWhitener(old.samples, old.repeats, old.excited_lines, old.non_excited_lines, root)
        whitener = without_leakage(plain, noise.spectra, sample_step(recording))
    return replace(noise, floor=np.sqrt(noise.floor**2 + np.diag(added)), whitener=whitener)


# Errors-in-variables fit: a model whose motion signals are measured with noise, by the corrected score.


REWEIGHTING_ROUNDS = 2
"""Of weights: at ordinary least squares, then at the corrected values; more change no value by 0.01 std."""


@dataclass(frozen=True, eq=False)
class ErrorsInVariables(Tabular):
    """Two fits of one model to the same recordings: `plain` least squares, and `corrected` for the input noise.

    Both have the same weights, so that they differ by the bias alone.

    noise        of the inputs, of one sample
    reliability  smallest share of true motion in the information of any direction of the parameters
    """

    plain: Fit
    corrected: Fit
    noise: InputNoise
    reliability: float

    @cached_property
    def bias(self) -> Mapping[str, float]:
        """Estimated bias of ordinary least squares, plain minus corrected, of each identifiable parameter."""
        estimates = self.corrected.parameters.items()
        return {name: self.plain.values[name] - e.value for name, e in estimates if np.isfinite(e.std)}

    @property
    def table(self) -> Table:
        """Name, plain value, corrected value with std, bias of the plain one, and that in std."""
        name, value, std, unit = PARAMETER_COLUMNS
        bias = (Column("bias of plain", format=".2g"), Column("in std", format=".1f"))
        columns = (name, replace(value, name="plain"), replace(value, name="corrected"), std, *bias, unit)
        return Table.of(columns, [self._row(name) for name in self.corrected.parameters])

    def _row(self, name: str) -> tuple[Value, ...]:
        estimate, bias = self.corrected.parameters[name], self.bias.get(name)
        ratio = bias / estimate.std if bias is not None and estimate.std else None
        return name, self.plain.values[name], estimate.known, estimate.std, bias, ratio, estimate.unit

    def remarks(self) -> list[str]:
        """The noise of the inputs."""
        return [f"noise of one sample of the motion: {self.noise}"]


def errors_in_variables_fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    input_noise: InputNoise | None = None,
    noise: Sequence[RecordingNoise] | None = None,
    start: Mapping[str, float] | None = None,
) -> ErrorsInVariables:
    """Estimate a model's parameters from recordings with noisy motion, and the bias of ordinary least squares.

    Parameters
    ----------
    model : WrenchModel
        Model without dynamics, in which the noise of one sample would affect many.
    recordings : Recording or iterable of Recording
        Recordings of one rig and tool.
    input_noise : InputNoise, optional
        Noise of one sample of one repeat of the motion, the same in all recordings; by default it is measured from the
        first recording that has repeats.
    noise : sequence of RecordingNoise, optional
        Noise of the readings per recording; by default it is estimated as in `fit`.
    start : mapping of str to float, optional
        Initial values of parameters by name, in their units; by default the parameters' own.

    Returns
    -------
    ErrorsInVariables
        The ordinary and the corrected fit with the same weights, the bias of the ordinary one by parameter, and the
        smallest share of true motion in the information of any direction of the parameters (`reliability`).

    Raises
    ------
    InputError
        As `fit` does; when no input noise can be measured, or it belongs to no signal of the recordings; and for models
        with dynamics.

    Notes
    -----
    Averaging over R repeats (22.12 in chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
    Manipulators", Bassi et al.) leaves 1/R of the input noise's covariance. The weights are those of the effective
    noise of readings and inputs; nothing is then lost against orthogonal regression (`CorrectedScoreProblem` has the
    comparison). The covariance is the sandwich N^-1 V N^-1: the inverse information N of the true signals is not the
    variance, since the gradient has the variance V, which includes the noise of the regressor.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> noise = tw.InputNoise.stated({"ddphi": 2.0})
    >>> corrected = tw.errors_in_variables_fit(tw.planar(rig), tw.read("train.csv", rig=rig), input_noise=noise)
    >>> corrected.bias["I"] < 0 < corrected.reliability < 1  # noise attenuates the inertia
    True
    """
    first = fit(model, recordings, noise=noise, start=start)
    _require_no_dynamics(first)
    inputs = input_noise if input_noise is not None else InputNoise.measured(_first_repeated(first.recordings))
    problem = CorrectedScoreProblem.of(first, inputs).weighted(first.theta, first.noise)
    theta, information, converged = problem.minimise(first.theta)
    for _ in range(REWEIGHTING_ROUNDS - 1):
        problem = problem.weighted(theta, first.noise)
        theta, information, converged = problem.minimise(theta)
    plain = first.in_noise(problem.problem.noise)
    corrected = replace(
        plain,
        theta=theta,
        covariance=information.covariance,
        identifiable=information.identifiable,
        converged=converged and plain.converged,
    )
    return ErrorsInVariables(plain, corrected, inputs, information.reliability)


def _first_repeated(recordings: Sequence[Recording]) -> Recording:
    return next((r for r in recordings if r.repeats > 1), recordings[0])


def _require_no_dynamics(fitted: Fit) -> None:
    for model in fitted.layout.models:
        model.require_direct("errors_in_variables_fit")
    if any(compiled_prediction(model).has_transfer_function for model in fitted.layout.models):
        raise InputError(
            what="input noise cannot be propagated through a lag or a delay",
            where="errors_in_variables_fit",
            remedy="leave sensor_lag and time_delay out, or average over more repeats and use fit",
        )
