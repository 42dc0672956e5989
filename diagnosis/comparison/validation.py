"""Validation fit: parameters kept from training, biases and recording-specific disturbances re-estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from estimation.case import initial_noise, prepared
from estimation.fit import Fit, initial_values
from estimation.least_squares.estimates import EstimatedModel, Estimates, fixed_parameters
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum
from estimation.least_squares.problem import Problem
from estimation.least_squares.square_root_information import ColumnSpace
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, PoseWhitener, Whitener
from estimation.parameter_layout import ParameterLayout
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.parameter import Parameter

# Splits of the whitened rows: halves for cross-validation, and the non-excited lines.


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RowSubsetWhitener(Whitener):
    """A subset of another whitener's rows, of these `indices`; its first `excited_row_count` rows are excited."""

    whole: Whitener
    indices: NDArray[np.intp]
    excited_row_count: int

    @property
    def rows(self) -> int:  # type: ignore[override]
        """Number of rows in the subset."""
        return len(self.indices)

    @property
    def periodic_rows(self) -> int:  # type: ignore[override]
        """Number of them on excited lines."""
        return self.excited_row_count

    def series(self, values: Array) -> Array:
        """The subset's rows of a series over the whole record."""
        return np.asarray(self.whole.series(values)[self.indices])

    def steady_state(self, values: Array) -> Array:
        """The subset's rows of a series over one repeat."""
        return np.asarray(self.whole.steady_state(values)[self.indices[: self.excited_row_count]])


def half_splits(fitted: Fit) -> list[tuple[RecordingNoise, ...]]:
    """Noise restricted to even and to odd harmonics (both with the non-excited lines), to every second pose, or to the
    halves of a run."""
    return [tuple(_half_split(noise, side) for noise in fitted.noise) for side in (0, 1)]


def _half_split(noise: RecordingNoise, side: int) -> RecordingNoise:
    whole = noise.whitener
    index = np.arange(whole.rows)
    if isinstance(whole, FourierLineWhitener):
        per_line = whole.periodic_rows // len(whole.excited_lines)
        harmonic = np.repeat(whole.excited_lines // whole.repeats, per_line)
        kept = np.concatenate([harmonic % 2 == side, np.ones(whole.rows - whole.periodic_rows, dtype=bool)])
        kept[:per_line] = True
    elif isinstance(whole, AutoregressiveWhitener) and whole.noise.is_white:
        kept = index // len(whole.noise.covariance) % 2 == side
    elif isinstance(whole, PoseWhitener):
        kept = index // len(whole.roots) % 2 == side
    else:
        kept = (index < whole.rows // 2) == (side == 0)
    excited = int(kept[: whole.periodic_rows].sum())
    half = RowSubsetWhitener(whole, np.flatnonzero(kept), excited)
    return replace(noise, whitener=half, log_power_variance=noise.log_power_variance[kept])


def non_excited_noise(noise: RecordingNoise) -> RecordingNoise | None:
    """Noise restricted to the non-excited lines, on which nothing periodic acts; None where there are none."""
    whole = noise.whitener
    if not isinstance(whole, FourierLineWhitener) or not len(whole.non_excited_lines):
        return None
    rows = np.arange(whole.periodic_rows, whole.rows)
    lines = noise.frequency[len(whole.excited_lines) :]
    return replace(
        noise,
        whitener=RowSubsetWhitener(whole, rows, 0),
        log_power_variance=noise.log_power_variance[rows],
        frequency=lines,
    )


@dataclass(frozen=True, eq=False)
class PartiallyFixedProblem(Problem):
    """A least-squares problem in the unknowns marked `free` (k,); the others are fixed at their initial values."""

    free: NDArray[np.bool_]

    @classmethod
    def of_unknowns(cls, problem: Problem, free: NDArray[np.bool_]) -> PartiallyFixedProblem:
        """A problem in these of its unknowns alone."""
        return cls(problem.layout, problem.data, free)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """All unknowns but those that are free."""
        return ~self.free

    def minimise(self, start: Array, far: float = np.inf) -> LeastSquaresMinimum:
        """The least-squares minimum in the free unknowns; the fixed ones are returned unchanged, bit by bit."""
        minimum = super().minimise(start, far)
        return replace(minimum, theta=np.where(self.free, minimum.theta, start))


@dataclass(frozen=True, eq=False)
class StandardisedResidual:
    """Residual of one recording against all that is uncertain of it, as its lack of fit is tested.

    rows      (rows,) whitened, of unit variance under the model, and their `leverage`
    readings  (n, p) in the channels' units, without what errors of the estimates explain
    """

    rows: Array
    leverage: Array
    readings: Array


@dataclass(frozen=True, eq=False)
class ValidationFit(Fit):
    """A fit's parameters kept on another recording, where they are as uncertain as that fit left them.

    Measured minus predicted is noise and, to first order, J d: sensitivities J times errors d of the parameters kept,
    of the fit's covariance P. A whitened residual therefore has the covariance 1 + J P J'.

    errors  (k, s) errors of unit variance, independent of each other: P = errors errors'
    free    (k, f) directions of unlimited variance: what is estimated here (biases, disturbances), and what the fit's
            own recordings do not identify
    """

    errors: Array = field(default_factory=lambda: np.zeros((0, 0)))
    free: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def standardised_residual(self) -> StandardisedResidual:
        """The residual whitened by 1 + J P J', and what remains of it with the most likely errors.

        The rows are (1 + J P J')^(-1/2) r by the symmetric root, which leaves power in the rows where it is as far as
        any root does; the free directions are projected out, and are all of the leverage. The sum of their squares is
        the least of |r - J d|² + d' P^-1 d, which the most likely errors d reach.
        """
        linearised = self.linearised()
        free = ColumnSpace.of(linearised.derivative @ self.free)
        reached = linearised.reached_residual - free.basis @ (free.basis.T @ linearised.reached_residual)
        columns = linearised.derivative @ self.errors
        columns -= free.basis @ (free.basis.T @ columns)
        variances, axes = np.linalg.eigh(columns.T @ columns)
        root, along = np.sqrt(1 + np.maximum(variances, 0.0)), axes.T @ (columns.T @ reached)
        rows, leverage = linearised.residual.copy(), np.zeros(len(linearised.residual))
        rows[linearised.reached] = reached - columns @ (axes @ (along / (root * (root + 1))))
        leverage[linearised.reached] = (free.basis**2).sum(axis=1)
        likely = self.errors @ (axes @ (along / root**2))
        beside = linearised.reached_residual - linearised.derivative @ likely
        likely += self.free @ free.amounts(beside[:, None])[:, 0]
        return StandardisedResidual(rows, leverage, self.residuals[0] - self.response().derivative @ likely)


def validation_fit(
    fit: EstimatedModel,
    recording: Recording,
    noise: RecordingNoise | None = None,
    disturbances: Sequence[Effect] = (),
    start: Mapping[str, float] | None = None,
) -> ValidationFit:
    """The fit's parameters on another recording; only its biases and its disturbances are estimated there.

    Recording-specific effects of the fit's own recordings are dropped. The disturbances are estimated from the initial
    values `start` on the non-excited lines, where there are any: on the excited lines they would absorb systematic
    error of the fit.
    """
    recording = prepared(recording, fit.model)
    shared = fit.model.without_recording_specific
    model = shared + disturbances
    noise = noise if noise is not None else initial_noise(shared, (recording,))[0]
    problem = Problem.of(model, [recording], [noise])
    unknowns = problem.layout
    values = {p.name: fit.parameters[p.name].value for p in shared.parameters}
    theta = initial_values(unknowns, {**values, **(start or {})})
    biases = _mask_of(unknowns, model.biases)
    added = _mask_of(unknowns, [p for e in disturbances for p in e.qualified(model.space)])
    covariance, estimable = np.zeros((len(theta), len(theta))), np.zeros(len(theta), dtype=bool)
    if disturbances:
        rest = (non_excited_noise(noise) or noise,)
        disturbed = PartiallyFixedProblem.of_unknowns(problem.in_noise(rest), biases | added).minimise(theta)
        theta, estimable = disturbed.theta, disturbed.identifiable & added
        covariance = disturbed.covariance * np.outer(added, added)
    biased = PartiallyFixedProblem.of_unknowns(problem, biases).minimise(theta)
    covariance, estimable = covariance + biased.covariance, estimable | biased.identifiable
    errors, unknown = _errors(fit, unknowns, ~(biases | added))
    return ValidationFit(
        problem, biased.theta, covariance, estimable,
        errors=errors, free=np.column_stack([np.eye(len(theta))[:, biases | added], unknown]),
    )  # fmt: skip


def _errors(fit: EstimatedModel, unknowns: ParameterLayout, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Errors (k, s) of unit variance that the kept unknowns (k,) have from their fit, and its unknown directions.

    A parameter at a bound keeps its variance: the truth is on one side of it, no further off than without the bound.
    """
    names = list(fit.parameters)
    place = [names.index(p.name) for p, keep in zip(unknowns.parameters, kept, strict=True) if keep]
    fixed = fixed_parameters([p for p, keep in zip(unknowns.parameters, kept, strict=True) if keep])
    unknown = ~fit.identifiable[place] & ~fixed
    if isinstance(fit, Estimates) and unknown.any():
        directions = (fit.scaled_svd.null_space / fit.scaled_svd.scale[:, None])[place] * unknown[:, None]
    else:  # a model file has no directions, only their parameters
        directions = np.eye(len(place))[:, unknown]
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)[np.ix_(place, place)]
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    errors = scale[:, None] * axes * np.sqrt(np.maximum(variances, 0.0))
    return _at(kept, errors), _at(kept, directions)


def _at(kept: NDArray[np.bool_], columns: Array) -> Array:
    """Columns in the kept unknowns as columns in all of them, zero in the others."""
    whole = np.zeros((len(kept), columns.shape[1]))
    whole[kept] = columns
    return whole


def _mask_of(unknowns: ParameterLayout, parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    names = {p.name for p in parameters}
    return np.array([p.name in names for p in unknowns.parameters])


def zero_shift(fit: Fit, carried: Fit) -> Mapping[str, float]:
    """Change of each channel's bias from the fit's first recording to the validation recording."""
    return {c: carried.values[f"bias_{c}"] - fit.values[f"bias_{c}"] for c in fit.recordings[0].channels}
