"""Fit: the parameters of a model from recordings, by whitened least squares and exact nonlinear refit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.convention import decided
from estimation.layout import Layout, layout
from estimation.noise import Noise, NoiseSource, step_of
from estimation.noise_source import noise_of
from estimation.push import find_pushes
from estimation.recording import Recording
from estimation.response import Response, respond
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.rig import Convention

Array = NDArray[np.float64]

STEP_TOLERANCE = 1e-6
"""Drop of chi-square below which a refit has converged: a thousandth of a standard deviation away from its minimum."""
MOST_STEPS = 40
UNSHOWN = 1e-9
"""Singular value, of columns of unit length, below which a direction of the unknowns is only rounding."""


@dataclass(frozen=True)
class Estimate:
    """One estimated parameter: value and standard deviation in `unit`."""

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class Fit:
    """A model with its parameters estimated from recordings.

    theta       (k,) unknowns in the order of `layout.parameters`
    covariance  (k, k) from the whitened derivative, valid for the noise it was whitened with
    converged   whether the last refit came to rest
    shown       (k,) whether the recordings tell an unknown apart from all others
    noise       per recording
    """

    model: WrenchModel
    recordings: tuple[Recording, ...]
    noise: tuple[Noise, ...]
    layout: Layout
    theta: Array
    covariance: Array
    shown: NDArray[np.bool_]
    converged: bool = True

    @cached_property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every unknown by name, with std and unit; the std is infinite where the recordings do not show it."""
        std = np.where(self.shown, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)
        return {
            p.name: Estimate(p.name, float(value), float(s), p.unit)
            for p, value, s in zip(self.layout.parameters, self.theta, std, strict=True)
        }

    @property
    def values(self) -> dict[str, float]:
        """The value of every unknown by name."""
        return {name: estimate.value for name, estimate in self.parameters.items()}

    def response(self, number: int = 0) -> Response:
        """Prediction of one of the recordings."""
        own = self.layout.models[number]
        return respond(own, self.recordings[number], self.theta[self.layout.index[number]])

    @cached_property
    def residuals(self) -> tuple[Array, ...]:
        """Measured minus predicted of each recording, (n, p) in the channels' units."""
        return tuple(r.wrench - self.response(i).value for i, r in enumerate(self.recordings))

    def rows(self) -> list[tuple[str, ...]]:
        """Name, value, std and unit of every unknown, as text."""
        return [
            (e.name, f"{e.value:.6g}", f"{e.std:.2g}", e.unit)
            if np.isfinite(e.std)
            else (e.name, "-", "not shown", e.unit)
            for e in self.parameters.values()
        ]

    def __str__(self) -> str:
        found = table(("parameter", "value", "std", "unit"), self.rows())
        return found if self.converged else f"{found}\nnot converged after {MOST_STEPS} steps: the values may move on"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Text columns under a header."""
    lines = [tuple(header), *map(tuple, rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


@dataclass(frozen=True, eq=False)
class Problem:
    """The whitened least-squares problem of one model, its recordings and their noise."""

    layout: Layout
    recordings: tuple[Recording, ...]
    noise: tuple[Noise, ...]

    @cached_property
    def measured(self) -> tuple[Array, ...]:
        """Whitened readings of each recording, (rows,)."""
        return tuple(n.whitener.series(r.wrench) for n, r in zip(self.noise, self.recordings, strict=True))

    def evaluate(self, theta: Array) -> tuple[Array, Array]:
        """Whitened residual (rows,), measured minus predicted, and derivative of the prediction (rows, k)."""
        residuals, derivatives = [], []
        for number, (recording, noise) in enumerate(zip(self.recordings, self.noise, strict=True)):
            index = self.layout.index[number]
            value, own = noise.whitener.response(respond(self.layout.models[number], recording, theta[index]))
            derivative = np.zeros((len(value), self.layout.size))
            derivative[:, index] = own
            residuals.append(self.measured[number] - value)
            derivatives.append(derivative)
        return np.concatenate(residuals), np.concatenate(derivatives)

    def minimise(self, start: Array) -> Minimum:
        """The least-squares minimum within the physical bounds.

        Gauss-Newton steps with Levenberg's damping on columns of unit length; a step that would leave the bounds is
        cut at them. Derivatives are exact (CasADi), so a linear model takes one step.
        """
        low, high = (np.array([p.bounds[i] for p in self.layout.parameters]) for i in (0, 1))
        theta, damping = np.clip(start, low, high), 0.0
        residual, derivative = self.evaluate(theta)
        cost = float(residual @ residual)
        for _ in range(MOST_STEPS):
            step = damped_step(residual, derivative, theta, (low, high), damping)
            trial = np.clip(theta + step, low, high)
            moved, tangent = self.evaluate(trial)
            gain = cost - float(moved @ moved)
            if gain > 0:
                theta, residual, derivative, cost = trial, moved, tangent, cost - gain
                damping = damping / 10 if damping > 1e-9 else 0.0
            else:
                damping = max(10 * damping, 1e-6)
            if abs(gain) < STEP_TOLERANCE or damping > 1e6:
                return Minimum(theta, *covariance_of(derivative), cost, True)
        return Minimum(theta, *covariance_of(derivative), cost, False)


def damped_step(residual: Array, derivative: Array, theta: Array, bounds: tuple[Array, Array], damping: float) -> Array:
    """A Levenberg step on columns of unit length, with unknowns that press against a bound held."""
    scale = np.linalg.norm(derivative, axis=0)
    scale[scale == 0] = 1.0
    gradient = derivative.T @ residual
    free = ~(((theta <= bounds[0]) & (gradient < 0)) | ((theta >= bounds[1]) & (gradient > 0)))
    columns = derivative[:, free] / scale[free]
    reached = columns.any(axis=1)
    root = np.asarray(np.linalg.qr(np.column_stack([columns[reached], residual[reached]]), mode="r"))
    size = columns.shape[1]
    system = np.concatenate([root[:size, :size], np.sqrt(damping) * np.eye(size)])
    target = np.concatenate([root[:size, size], np.zeros(size)])
    step = np.zeros_like(theta)
    step[free] = np.linalg.lstsq(system, target, rcond=1e-12)[0] / scale[free]
    return step


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (k,) at a minimum, their covariance (k, k), which of them the data show (k,), and the chi-square.

    `converged` is False when the steps ran out before the chi-square stood still.
    """

    theta: Array
    covariance: Array
    shown: NDArray[np.bool_]
    cost: float
    converged: bool


def covariance_of(derivative: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Inverse of the Fisher information of whitened rows, and which unknowns it holds for.

    Directions that the data do not show get no variance; an unknown with a part in them is not shown.
    """
    scale = np.linalg.norm(derivative, axis=0)
    scale[scale == 0] = 1.0
    root = np.linalg.qr(derivative[derivative.any(axis=1)] / scale, mode="r")
    _, singular, right = np.linalg.svd(root, full_matrices=False)
    kept = singular > UNSHOWN * max(float(singular.max(initial=0.0)), 1e-300)
    inverse = right[kept].T / singular[kept]
    shown = (right[kept] ** 2).sum(axis=0) > 1 - 1e-6
    return np.asarray(inverse @ inverse.T / np.outer(scale, scale)), shown


def start_of(unknowns: Layout, start: Mapping[str, float]) -> Array:
    """Starting values: those given by name, else the nominal ones."""
    return np.array([start.get(p.name, p.nominal) for p in unknowns.parameters])


def fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    noise: Sequence[Noise] | None = None,
    start: Mapping[str, float] | None = None,
) -> Fit:
    """Estimate a model's parameters from one recording or several of the same rig and tool.

    Every parameter is shared but the biases, which each recording has for itself (`bias_fx@name`). The noise is
    estimated from the recordings unless given; where it comes from the residual, fit and noise are iterated. A
    convention AUTO is decided from the recordings.
    Raises InputError when a recording lacks a signal that the model needs, the convention cannot be decided, or the
    mass comes out negative under the convention stated.
    """
    several = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    check_channels(model, several)
    estimated = refit(decided(model, several), several, noise=noise, start=start)
    require_weight(estimated)
    return estimated


def check_channels(model: WrenchModel, several: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """The recordings, when there are any and their channels are the model's; InputError otherwise."""
    if not several:
        raise InputError(what="no recording was given", where="recordings", remedy="give at least one")
    for recording in several:
        if recording.channels != model.channels:
            raise InputError(
                what=f"its channels are {', '.join(recording.channels)}, the model's {', '.join(model.channels)}",
                where=recording.name,
                remedy="use planar() for fx, fy, tau and spatial() for six axes",
            )
    return several


def refit(
    model: WrenchModel,
    several: tuple[Recording, ...],
    *,
    noise: Sequence[Noise] | None = None,
    start: Mapping[str, float] | None = None,
) -> Fit:
    """`fit` of a model whose convention is decided, its mass whatever the data say: a step of a search."""
    unknowns = layout(model, several)
    theta = start_of(unknowns, start or {})
    known = tuple(noise) if noise is not None else first_noise(model, several)
    for _ in range(1 if noise is not None else 4):
        problem = Problem(unknowns, several, known)
        found = problem.minimise(theta)
        theta = found.theta
        estimated = Fit(model, several, known, unknowns, theta, found.covariance, found.shown, found.converged)
        if noise is not None or all(n.source is not NoiseSource.RESIDUAL for n in known):
            break
        known = refreshed(estimated)
    return estimated


def require_weight(fitted: Fit) -> None:
    """Refuse a fit whose mass is negative beyond doubt.

    Raises InputError: the readings have the other sign than was stated.
    """
    mass = fitted.parameters["m"]
    if mass.value >= -3 * mass.std:
        return
    stated = fitted.model.convention
    other = Convention.ON_SENSOR if stated is Convention.ON_TOOL else Convention.ON_TOOL
    raise InputError(
        what=f"the mass comes out as {mass.value:.3g} ± {mass.std:.2g} kg with readings {stated.value}",
        where=", ".join(r.name for r in fitted.recordings),
        remedy=f'state convention = "{other.value}" under [sensor] in the rig, or check the axes of the readings',
    )


def first_noise(model: WrenchModel, recordings: Sequence[Recording]) -> tuple[Noise, ...]:
    """Noise before any fit: from the repeats, the rig, or the residual of a plain least-squares fit of the base.

    Pushes that stand out of a single run are left out of that fit, and have a noise of their own.
    """
    pushes = find_pushes(model, recordings)
    plain = [_unweighted(model.base, r, events) for r, events in zip(recordings, pushes, strict=True)]
    return tuple(noise_of(r, e, events=v) for r, e, v in zip(recordings, plain, pushes, strict=True))


def refreshed(estimated: Fit) -> tuple[Noise, ...]:
    """The noise of a fit's recordings, those that come from the residual estimated from it again."""
    fitted = int(estimated.shown.sum())
    return tuple(
        noise_of(r, e, fitted, n.events) if n.source is NoiseSource.RESIDUAL else n
        for r, e, n in zip(estimated.recordings, estimated.residuals, estimated.noise, strict=True)
    )


def _unweighted(base: WrenchModel, recording: Recording, events: tuple[tuple[float, float], ...]) -> Array:
    """Residual (n, p) of a least-squares fit of the rigid tip outside events, channels weighted by their spread."""
    time = np.arange(recording.samples) * step_of(recording)
    kept = ~np.any([(time >= start) & (time <= end) for start, end in events] or [time < 0], axis=0)
    size = len(base.parameters)
    response = respond(base, recording, np.zeros(size))
    spread = recording.wrench.std(axis=0)
    spread[spread == 0] = 1.0
    rows = (response.derivative / spread[:, None])[kept].reshape(-1, size)
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    target = ((recording.wrench - response.value) / spread)[kept].ravel()
    solution = np.linalg.lstsq(rows / scale, target, rcond=1e-6)[0] / scale
    return np.asarray(recording.wrench - response.value - response.derivative @ solution)
