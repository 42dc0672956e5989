"""Fit: the parameters of a model from recordings, by whitened least squares and exact nonlinear refit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import NDArray

from estimation.constrained import ConstrainedMinimum, Constraints
from estimation.constrained import minimise as constrained
from estimation.convention import decided
from estimation.layout import Layout, layout
from estimation.linear.estimate import Estimate, Estimates, table
from estimation.linear.least_squares import Solution
from estimation.linear.square_root import SquareRoot
from estimation.noise import Noise, NoiseSource, step_of
from estimation.noise_source import noise_of
from estimation.problem import Linearised, Problem
from estimation.push import find_pushes
from estimation.recording import Recording
from estimation.response import Response, respond
from estimation.stream.chunk import Chunk
from estimation.stream.noise_model import NoiseModel
from estimation.stream.statistics import Part
from estimation.stream.streaming import StreamedFit, fit_parts
from estimation.weight import require_positive
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.parameter import Parameter

if TYPE_CHECKING:
    from estimation.interval import Intervals

__all__ = [
    "Estimate",
    "Fit",
    "Problem",
    "check_channels",
    "first_noise",
    "fit",
    "refit",
    "refreshed",
    "require_weight",
    "shared_by",
    "start_of",
    "table",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fit(Estimates):
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
    constrained: ConstrainedMinimum | None = None

    @property
    def unknowns(self) -> tuple[Parameter, ...]:
        """The model's parameters, then the biases of the further recordings."""
        return self.layout.parameters

    @property
    def problem(self) -> Problem:
        """The whitened least-squares problem that was solved."""
        return Problem(self.layout, self.recordings, self.noise)

    def linearised(self) -> Linearised:
        """Its whitened rows at the estimate."""
        return self.problem.linearised(self.theta)

    @cached_property
    def information(self) -> SquareRoot:
        """All that the whitened rows at theta say of it, in one triangle."""
        return self.linearised().information.moved(-self.theta)

    def intervals(self, level: float = 0.95) -> Intervals:
        """Intervals of every unknown, with the degrees of freedom of the noise that was estimated."""
        from estimation.interval import intervals  # which is made of fits

        return intervals(self, level=level)

    def response(self, number: int = 0) -> Response:
        """Prediction of one of the recordings."""
        own = self.layout.models[number]
        return respond(own, self.recordings[number], self.theta[self.layout.index[number]])

    @cached_property
    def residuals(self) -> tuple[Array, ...]:
        """Measured minus predicted of each recording, (n, p) in the channels' units."""
        parts = zip(self.layout.models, self.recordings, self.layout.index, strict=True)
        return tuple(r.wrench - respond(own, r, self.theta[i], derivative=False).value for own, r, i in parts)


def shared_by(fit: Fit) -> list[object]:
    """What results of work on a fit have in common with it, so that nobody needs a copy."""
    recordings = [part for r in fit.recordings for part in (r, r.rig)]
    return [fit, fit.recordings, fit.noise, *fit.noise, *recordings, fit.model.arm]


def start_of(unknowns: Layout, start: Mapping[str, float]) -> Array:
    """Starting values: those given by name, else the parameter's own start, else its nominal value.

    Raises InputError for a parameter that has none of them: the level of a clipped channel.
    """
    values = np.array([start.get(p.name, p.nominal if p.start is None else p.start) for p in unknowns.parameters])
    if not np.isfinite(values).all():
        name = unknowns.parameters[int(np.argmin(np.isfinite(values)))].name
        remedy = f"give start={{'{name}': ...}}, or let `diagnose` find it"
        raise InputError(what=f"{name} has no value to start from", where="fit", remedy=remedy)
    return values


@overload
def fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    noise: Sequence[Noise] | None = None,
    start: Mapping[str, float] | None = None,
    constraints: Constraints | None = None,
) -> Fit: ...


@overload
def fit(
    model: WrenchModel,
    recordings: Part | Iterable[Part],
    *,
    noise: NoiseModel,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
) -> StreamedFit: ...


def fit(
    model: WrenchModel,
    recordings: Part | Iterable[Part],
    *,
    noise: Sequence[Noise] | NoiseModel | None = None,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    constraints: Constraints | None = None,
) -> Fit | StreamedFit:
    """Estimate a model's parameters from one recording or several of the same rig and tool.

    Every parameter is shared but the biases, which each recording has for itself (`bias_fx@name`). The noise is
    estimated from the recordings unless given; where it comes from the residual, fit and noise are iterated. A
    convention AUTO is decided from the recordings.

    With a `NoiseModel`, recordings or chunks are gone through one by one and not kept, however many they are, and
    `executor` (`concurrent.futures.Executor` or its like) works on them elsewhere: see `estimation.stream.streaming`.
    `constraints` hold the estimate within bounds, or to tools that exist: see `estimation.constrained`.
    Raises InputError when a recording lacks a signal that the model needs, the convention cannot be decided, the
    mass comes out negative under the convention stated, or chunks or an executor come without a `NoiseModel`.
    """
    if isinstance(noise, NoiseModel):
        return fit_parts(model, recordings, noise, start=start, executor=executor, constraints=constraints)
    parts = (recordings,) if isinstance(recordings, Recording | Chunk) else recordings
    several = _whole(parts, executor)
    check_channels(model, several)
    estimated = refit(decided(model, several), several, noise=noise, start=start, constraints=constraints)
    require_weight(estimated)
    return estimated


def _whole(parts: Iterable[Part], executor: Executor | None) -> tuple[Recording, ...]:
    """The parts when they are recordings, to be fitted all at once; InputError otherwise."""
    remedy = "give noise=NoiseModel.white(std), or NoiseModel.of the noise of a fit to one recording"
    if executor is not None:
        what = "an executor works on parts by themselves, and the noise is not known beforehand"
        raise InputError(what=what, where="executor", remedy=remedy)
    several = []
    for part in parts:
        if isinstance(part, Chunk):
            raise InputError(what="noise cannot be estimated from chunks", where=part.run, remedy=remedy)
        several.append(part)
    return tuple(several)


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
    constraints: Constraints | None = None,
) -> Fit:
    """`fit` of a model whose convention is decided, its mass whatever the data say: a step of a search."""
    unknowns = layout(model, several)
    theta = start_of(unknowns, start or {})
    if constraints is not None:
        constraints.region(unknowns)  # what is wrong with them is said before any work
    known = tuple(noise) if noise is not None else first_noise(model, several)
    for _ in range(1 if noise is not None else 4):
        problem = Problem(unknowns, several, known)
        held = None if constraints is None else constrained(problem, theta, constraints)
        found = problem.minimise(theta) if held is None else held
        theta = found.theta
        estimated = Fit(model, several, known, unknowns, theta, found.covariance, found.shown, found.converged, held)
        if noise is not None or all(n.source is not NoiseSource.RESIDUAL for n in known):
            break
        known = refreshed(estimated)
    return estimated


def require_weight(fitted: Fit) -> None:
    """Refuse a fit whose mass is negative beyond doubt.

    Raises InputError: the readings have the other sign than was stated.
    """
    names = ", ".join(r.name for r in fitted.recordings)
    require_positive(fitted.parameters["m"], fitted.model.convention, names)


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
    target = ((recording.wrench - response.value) / spread)[kept].ravel()
    solution = Solution.of(SquareRoot.of(rows, target), rounding=1e-6).theta
    return np.asarray(recording.wrench - response.value - response.derivative @ solution)
