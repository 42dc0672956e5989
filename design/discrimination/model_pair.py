"""Separation of two models in both directions, error probability, runs needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from itertools import product
from math import ceil, inf, isfinite
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import least_squares

from design.criteria import MaximinCriterion, Subset
from design.information.experiment import Experiment, ParameterValues, parameter_vector
from design.information.sensitivities import (
    CLOCK_SIGNALS,
    ModelTransferFunction,
    Sampling,
    SensitivityTerm,
    prediction_terms,
    sensitivity_terms,
    signals_along,
)
from design.trajectories.trajectory import Trajectory
from modeling.chain.effect import Effect, SearchDomain
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import StationaryNoise
from modeling.parameter import Parameter
from modeling.rival_fit import RivalFit, error_probability, fit_rival
from modeling.significance import LEVELS

Array = NDArray[np.float64]

# Whitened prediction and sensitivities of any model along one trajectory.


@dataclass(frozen=True, eq=False, kw_only=True)
class WhitenedPrediction:
    """The signals (N,) of one trajectory by name, their sampling, and the noise of the readings."""

    signals: Mapping[str, Array]
    sampling: Sampling
    noise: StationaryNoise

    @classmethod
    def along(cls, motion: Trajectory, arm: Arm, *, samples: int, noise: StationaryNoise) -> WhitenedPrediction:
        """One run of a trajectory (one period of a periodic one)."""
        series = motion.series
        signals = signals_along(arm, *motion.evaluate(series.instants(samples)))
        sampling = Sampling(duration=series.duration, samples=samples, periodic=series.periodic)
        return cls(signals=signals, sampling=sampling, noise=noise)

    @cached_property
    def all_signals(self) -> dict[str, Array]:
        """The signals and those of the clock."""
        return {**dict(zip(CLOCK_SIGNALS, self.sampling.clock, strict=True)), **self.signals}

    def tangent(self, model: WrenchModel, theta: Array) -> tuple[Array, Array]:
        """The whitened reading (R,) at theta (k,), and its sensitivities (R, k): R rows of unit variance.

        reading = H(s) load + zero, d reading = H d load + dH load + d zero; the same as the columns of an `Experiment`
        at theta, from functions that are compiled once for all theta. Raises InputError for a signal that is missing.
        """
        return whitened_predictions([self], model, theta)

    def reading(self, model: WrenchModel, theta: Array) -> Array:
        """The whitened reading (R,) at theta (k,)."""
        return self.tangent(model, theta)[0]

    def rows(self, model: WrenchModel, theta: Array, load: tuple[Array, Array], zero: tuple[Array, Array]) -> Array:
        """The whitened reading and its sensitivities (R, 1 + k) of load and zero (N, p), each with its slopes."""
        filtered = compiled_prediction(model).has_transfer_function
        value, slopes = self._filtered(model, theta, *load) if filtered else load
        stacked = np.concatenate([(value + zero[0])[:, :, None], slopes + zero[1]], axis=2)
        return self.noise.whitened(stacked, self.sampling.step).reshape(-1, 1 + len(theta))

    def _filtered(self, model: WrenchModel, theta: Array, value: Array, slopes: Array) -> tuple[Array, Array]:
        """The load and its sensitivities through H(s), with the sensitivities to the parameters of H added."""
        transfer = ModelTransferFunction(model=model, theta=tuple(theta))
        stacked = self.sampling.through(transfer, np.concatenate([value[:, :, None], slopes], axis=2))
        filtered, slopes = stacked[:, :, 0], stacked[:, :, 1:]
        for number, index in enumerate(compiled_prediction(model).transfer_parameters):
            derivative = ModelTransferFunction(model=model, theta=tuple(theta), slope=number)
            slopes[:, :, index] += self.sampling.through(derivative, value)
        return filtered, slopes


# A rival model along trajectories: the least-squares problem of its fit to a true model, and initial values.


FIT_TOLERANCE = 1e-12
"""Of lambda, relative: the minimum is found to rounding, so that an indistinguishable rival is recognised."""
INTERIOR_EVALUATIONS = 40
"""Gauss-Newton needs about ten. More come where parameters approach their bounds, by a factor a step from inside."""
FIT_EVALUATIONS = 200
"""With those parameters at their bounds, a few tens; many only where a nuisance parameter drifts."""
GRID_STARTS = 3
"""Points of a nuisance grid from which the exact search starts."""


def whitened_predictions(views: Sequence[WhitenedPrediction], model: WrenchModel, theta: Array) -> tuple[Array, Array]:
    """Whitened readings (R,) and sensitivities (R, k) along several trajectories, stacked, evaluated all at once."""
    prediction = compiled_prediction(model)
    counts = [view.sampling.samples for view in views]
    ends = np.cumsum(counts)
    places = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
    common = set.intersection(*(set(view.all_signals) for view in views))
    signals = {name: np.concatenate([view.all_signals[name] for view in views]) for name in common}
    load, zero = (part.tangent(signals, theta, int(ends[-1])) for part in (prediction.load, prediction.bias))
    rows = np.concatenate(
        [
            view.rows(model, theta, (load[0][place], load[1][place]), (zero[0][place], zero[1][place]))
            for view, place in zip(views, places, strict=True)
        ]
    )
    return rows[:, 0], rows[:, 1:]


@dataclass(frozen=True, eq=False)
class RivalAlongTrajectories:
    """A rival model along some trajectories (`views`), and the whitened prediction there of a true one (R,)."""

    target: Array
    model: WrenchModel
    views: Sequence[WhitenedPrediction]

    def fitted(self, start: Array) -> RivalFit:
        """The fit within physical bounds by nonlinear least squares with the analytic sensitivities.

        By an interior search, from which amplitudes leave zero; where that creeps along bounds, then by one with the
        parameters at them. Trust regions are scaled by the columns' norms, so that an unidentifiable parameter does not
        move.
        """
        low, high = parameter_bounds(self.model)
        last: tuple[Array, Array] = np.empty(0), np.empty(0)  # the slopes are asked for where the residual was

        def residual(theta: Array) -> Array:
            nonlocal last
            reading, slopes = whitened_predictions(self.views, self.model, theta)
            last = theta.copy(), slopes
            return reading - self.target

        def slopes(theta: Array) -> Array:
            if not np.array_equal(last[0], theta):
                residual(theta)
            return last[1]

        def search(first: Array, method: Literal["trf", "dogbox"], evaluations: int) -> Any:
            return least_squares(
                residual, first, slopes, (low, high), x_scale="jac", method=method,
                ftol=FIT_TOLERANCE, xtol=FIT_TOLERANCE, gtol=None, max_nfev=evaluations,
            )  # fmt: skip

        fit = search(np.clip(start, low, high), "trf", INTERIOR_EVALUATIONS)
        if not fit.success:
            at_bounds = np.where(fit.active_mask < 0, low, np.where(fit.active_mask > 0, high, fit.x))
            fit = min(fit, search(at_bounds, "dogbox", FIT_EVALUATIONS), key=lambda each: float(each.cost))
        return RivalFit(np.asarray(fit.x, dtype=float), 2 * float(fit.cost), bool(fit.success))


def parameter_bounds(model: WrenchModel) -> tuple[Array, Array]:
    """Physical bounds low (k,) and high (k,) of a model's parameters."""
    low, high = zip(*(p.bounds for p in model.parameters), strict=True)
    return np.array(low), np.array(high)


def rival_starts(
    target: Array,
    model: WrenchModel,
    distinguishing: tuple[str, ...],
    theta: Array,
    view: WhitenedPrediction,
    reach: float,
) -> list[Array]:
    """Starting values of a fit to a target (R,): the best points of the effects' nuisance grids.

    At each point of the grids of the `distinguishing` effects, their amplitudes at nominal, all other parameters are
    estimated by linear least squares from theta (k,) and clipped to their bounds; the points of least residual are
    returned.
    """
    low, high = parameter_bounds(model)
    candidates = []
    for values in _grid(model, distinguishing, _search_domain(view, model, reach)):
        start = np.array([values.get(p.name, v) for p, v in zip(model.parameters, theta, strict=True)])
        value, slopes = view.tangent(model, start)
        norm = np.linalg.norm(slopes, axis=0)
        scale = np.where(norm > 0, norm, 1.0)
        step = np.linalg.lstsq(slopes / scale, target - value, rcond=None)[0] / scale
        inside = np.clip(start + step, low, high)
        candidates.append((float(((target - value - slopes @ (inside - start)) ** 2).sum()), inside))
    return [start for _, start in sorted(candidates, key=lambda pair: pair[0])[:GRID_STARTS]]


def _grid(model: WrenchModel, distinguishing: tuple[str, ...], domain: SearchDomain) -> list[dict[str, float]]:
    effects = [e for e in model.effects if e.id in distinguishing]
    grids = [[{f"{e.id}.{k}": v for k, v in point.items()} for point in e.nuisance_grid(domain)] for e in effects]
    return [{k: v for point in points for k, v in point.items()} for points in product(*grids)]


def _search_domain(view: WhitenedPrediction, model: WrenchModel, reach: float) -> SearchDomain:
    axes = [view.signals[f"p{a}"] for a in model.space.axes if f"p{a}" in view.signals]
    low, high = (tuple(float(f(axis)) for axis in axes) for f in (np.min, np.max))
    return SearchDomain(low=low, high=high, end=view.sampling.duration, reach=reach)


# Hypothesis: model with parameter values, and what distinguishes two models.


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model at theta (k,), in its order and units."""

    model: WrenchModel
    theta: Array

    @classmethod
    def of(cls, model: WrenchModel, values: ParameterValues) -> Self:
        """The model at values by name; names of other models are ignored, and values are nominal where not named."""
        of_model = {p.name: values[p.name] for p in model.parameters if p.name in values}
        return cls(model.unrestricted, parameter_vector(model, of_model))

    @property
    def values(self) -> dict[str, float]:
        """theta by name."""
        return {p.name: float(v) for p, v in zip(self.model.parameters, self.theta, strict=True)}

    def without_effects(self, ids: tuple[str, ...]) -> Self:
        """The same with the amplitudes of these effects at their nominal values, at which they change no reading."""
        nominal = [
            p.nominal if p.name.partition(".")[0] in ids and not p.nuisance else v
            for p, v in zip(self.model.parameters, self.theta, strict=True)
        ]
        return type(self)(self.model, np.array(nominal))


def effects_only_in(model: WrenchModel, other: WrenchModel) -> tuple[str, ...]:
    """Ids of the effects that a model has and the other has not."""
    return tuple(e.id for e in model.effects if e.id not in {o.id for o in other.effects})


def distinguishing_effects(model: WrenchModel, other: WrenchModel) -> str:
    """Name of a model by the effects that distinguish it from another one."""
    return " + ".join(effects_only_in(model, other)) or "no further effect"


def with_effect_replaced(model: WrenchModel, effect_id: str, rival: Effect) -> WrenchModel:
    """The model with one of its effects replaced by another; InputError when it does not have it."""
    _require(model, (effect_id,))
    return model.without(effect_id) + rival


def rival_models(model: WrenchModel, one: Effect, other: Effect) -> tuple[WrenchModel, WrenchModel]:
    """The model with that one of two effects which it has, and with the other one in its place.

    The first is taken where it has both. Raises InputError when it has neither, or both are the same.
    """
    if one.id == other.id:
        what = f"{one.id} came twice"
        raise InputError(what=what, where="effects to be discriminated", remedy="name two effects")
    present, rival = (one, other) if one.id in {e.id for e in model.effects} else (other, one)
    _require(model, (present.id, rival.id))
    alone = model.without(rival.id) if rival.id in {e.id for e in model.effects} else model
    return alone, alone.without(present.id) + rival


def _require(model: WrenchModel, ids: tuple[str, ...]) -> None:
    if not set(ids) & {e.id for e in model.effects}:
        raise InputError(
            what=f"the model has no {' or '.join(ids)}, and its values are unknown",
            where="effects to be discriminated",
            remedy=f"give a model with one of them: `truewrench fit REC --add {ids[0]} --out MODEL.json`",
        )


# One model taken as true and its rival; noncentrality linearised in the rival's parameters.


COLLINEAR = 1e-6
"""Share of a sensitivity's norm below which it is collinear with others: squared, as information, 1e-12 is above the
rounding of 1e-15."""
BOUND_TOLERANCE = 1e-6
"""Distance of a parameter from its bound, as a share of its size, at which the bound is active."""
DIFFERENCE = Parameter(name="difference", unit="1")


@dataclass(frozen=True, eq=False)
class DirectedPair:
    """`truth` is the model taken as true, at its values; `rival` the model that is fitted to its prediction."""

    truth: Hypothesis
    rival: WrenchModel

    @property
    def names(self) -> tuple[str, str]:
        """Names of the two by their distinguishing effects."""
        return distinguishing_effects(self.truth.model, self.rival), distinguishing_effects(
            self.rival, self.truth.model
        )

    @property
    def nested_in_rival(self) -> bool:
        """Whether the rival has all effects of the truth, so that the truth is nested in it."""
        return not effects_only_in(self.truth.model, self.rival)

    @property
    def without_own_effects(self) -> DirectedPair:
        """The same truth, and as its rival the truth's model without the effects that distinguish it."""
        without = self.truth.model
        for effect_id in effects_only_in(self.truth.model, self.rival):
            without = without.without(effect_id)
        return DirectedPair(self.truth, without)

    def power(self, views: Sequence[WhitenedPrediction]) -> float:
        """Whitened power of the contribution of the truth's distinguishing effects to its prediction."""
        without = self.truth.without_effects(effects_only_in(self.truth.model, self.rival))
        full, reduced = (whitened_predictions(views, h.model, h.theta)[0] for h in (self.truth, without))
        return float(((full - reduced) ** 2).sum())

    def rival_fit(self, views: Sequence[WhitenedPrediction], reach: float, further: Sequence[Array] = ()) -> RivalFit:
        """The rival's fit, along one trajectory or several together; `further` are values (k,) of more starts."""
        target, _ = whitened_predictions(views, self.truth.model, self.truth.theta)
        common = Hypothesis.of(self.rival, self.truth.values).theta
        first = target[: len(target) // len(views)]
        distinguishing = effects_only_in(self.rival, self.truth.model)
        starts = rival_starts(first, self.rival, distinguishing, common, views[0], reach)
        return fit_rival(RivalAlongTrajectories(target, self.rival, views), [*further, *starts])


@dataclass(frozen=True, eq=False)
class LinearisedRival:
    """The noncentrality lambda of a directed pair, linearised at the rival's theta (k,).

    With delta = y_truth - y_rival(theta) and S the rival's sensitivities there,
    lambda = min over d of |delta - S d|² is the Schur complement of delta' delta in the information of the columns
    [S, delta]: `Subset` of the last one. `columns` are the indices of the identifiable columns of S.
    """

    direction: DirectedPair
    theta: Array
    columns: tuple[int, ...]

    @classmethod
    def of(cls, direction: DirectedPair, theta: Array, views: Sequence[WhitenedPrediction]) -> LinearisedRival:
        """With the columns that are free and not collinear with others along some trajectories.

        Leaving out a collinear column changes no Schur complement. A parameter with an active bound is fixed.
        """
        _, slopes = whitened_predictions(views, direction.rival, theta)
        norm = np.linalg.norm(slopes, axis=0)
        low, high = parameter_bounds(direction.rival)
        tolerance = BOUND_TOLERANCE * np.maximum(np.abs(theta), BOUND_TOLERANCE)
        free = np.flatnonzero((norm > 0) & (theta - low > tolerance) & (high - theta > tolerance))
        factor, order = qr(slopes[:, free] / norm[free], mode="r", pivoting=True)
        independent = order[: int((np.abs(np.diag(factor)) > COLLINEAR).sum())]
        return cls(direction, theta, tuple(sorted(int(i) for i in free[independent])))

    @property
    def size(self) -> int:
        """Number of columns, the difference included."""
        return len(self.columns) + 1

    def terms(self, first: int) -> tuple[SensitivityTerm, ...]:
        """The terms of its columns, the first one in column `first` of an experiment."""
        position = {old: first + new for new, old in enumerate(self.columns)}
        moved = [_moved(term, position) for term in sensitivity_terms(self.direction.rival, self.theta)]
        last, truth = first + self.size - 1, self.direction.truth
        return (
            *(term for term in moved if term.columns),
            *prediction_terms(truth.model, truth.theta, last),
            *prediction_terms(self.direction.rival, self.theta, last, -1.0),
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of its columns, and the difference."""
        return (*(self.direction.rival.parameters[i] for i in self.columns), DIFFERENCE)


def maximin_experiment(
    blocks: Sequence[LinearisedRival], arm: Arm, noise: StationaryNoise
) -> tuple[Experiment, MaximinCriterion]:
    """The experiment of several blocks, and the maximin criterion of their ln lambda."""
    sizes = [block.size for block in blocks]
    firsts = np.cumsum([0, *sizes[:-1]])
    experiment = Experiment(
        terms=tuple(t for block, first in zip(blocks, firsts, strict=True) for t in block.terms(int(first))),
        parameters=tuple(p for block in blocks for p in block.parameters),
        channels=blocks[0].direction.rival.channels,
        arm=arm,
        noise=noise,
    )
    return experiment, MaximinCriterion(tuple(Subset((size - 1,)) for size in sizes), tuple(sizes))


def _moved(term: SensitivityTerm, position: dict[int, int]) -> SensitivityTerm:
    """A term reduced to the columns that have a position, moved there."""
    columns = [i for i, column in enumerate(term.columns) if column in position]
    by = None if term.by is None else tuple(term.by[i] for i in columns)
    return replace(term, by=by, columns=tuple(position[term.columns[i]] for i in columns))


class Separability(Enum):
    """Whether two models can be discriminated; the value describes it."""

    SEPARATED = "separated"
    REPEATS = "confusable at these sizes, separated by more runs"
    NEVER = "no trajectory of this arm discriminates them"


@dataclass(frozen=True, kw_only=True)
class Separation:
    """Noncentrality lambda of a truth with respect to the fitted rival, in all runs of a trajectory together.

    before             along the reference trajectory
    exciting           along the D-optimal one; None where none is given
    after              along the designed one
    detection          lambda of the truth from itself without its distinguishing effects, along the designed one
    indistinguishable  whether the rival is indistinguishable from the truth, along any trajectory
    """

    truth: str
    rival: str
    before: float
    after: float
    detection: float
    indistinguishable: bool
    exciting: float | None = None

    def to_data(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "truth": self.truth,
            "rival": self.rival,
            "before": self.before,
            "exciting": self.exciting,
            "after": self.after,
            "noticed": self.detection,
            "imitated": self.indistinguishable,
        }


@dataclass(frozen=True, kw_only=True)
class ModelPair:
    """Two models, each taken as true with the other as rival; their separation is the smaller lambda.

    Where only one of them is indistinguishable from the other, they are nested: the smaller model is preferred until
    it is rejected (parsimony), so that only the larger one's lambda counts, and the error probability is that of the
    test. Nor does a truth count that is undetectable: a rival of quite another kind is fitted with almost no amplitude.
    """

    directions: tuple[Separation, Separation]
    runs: int

    @property
    def names(self) -> tuple[str, str]:
        """Names of the given model and of the rival."""
        return self.directions[0].truth, self.directions[0].rival

    @property
    def nested(self) -> bool:
        """Whether one model is nested in the other."""
        return self.directions[0].indistinguishable != self.directions[1].indistinguishable

    @property
    def before(self) -> float:
        """The lambda that counts, along the reference trajectory."""
        return min((d.before for d in self._counted), default=0.0)

    @property
    def exciting(self) -> float | None:
        """The lambda that counts, along the D-optimal trajectory; None where none is given."""
        return min((d.exciting for d in self._counted if d.exciting is not None), default=None)

    @property
    def after(self) -> float:
        """The lambda that counts, along the designed trajectory."""
        return min((d.after for d in self._counted), default=0.0)

    @property
    def verdict(self) -> Separability:
        """Separated: an error probability of 1 % at most, in the planned runs."""
        if not self._counted:
            return Separability.NEVER
        return Separability.SEPARATED if self.after >= LEVELS.separated else Separability.REPEATS

    def error_probability(self, noncentrality: float | None) -> float | None:
        """Error probability of choosing between the two at a lambda; None without one, and when they are nested."""
        return None if self.nested or noncentrality is None else error_probability(noncentrality)

    def runs_for(self, noncentrality: float) -> int | None:
        """Runs of the designed trajectory for a lambda of `noncentrality`; None when no number is enough.

        Noise is independent between runs, so that their lambdas add.
        """
        runs = self.runs * noncentrality / self.after if self.after > 0 else inf
        return ceil(runs) if isfinite(runs) else None

    def to_data(self) -> dict[str, Any]:
        """Plain data: numbers are finite, or None."""
        return {
            "truth": self.names[0],
            "rival": self.names[1],
            "verdict": self.verdict.name.lower(),
            "nested": self.nested,
            "separation_before": self.before,
            "separation_exciting": self.exciting,
            "separation_after": self.after,
            "chance_before": self.error_probability(self.before),
            "chance_exciting": self.error_probability(self.exciting),
            "chance_after": self.error_probability(self.after),
            "runs_for_5_percent": self.runs_for(LEVELS.confusable),
            "runs_for_1_percent": self.runs_for(LEVELS.separated),
            "directions": [direction.to_data() for direction in self.directions],
        }

    @property
    def _counted(self) -> list[Separation]:
        distinct = [d for d in self.directions if not d.indistinguishable]
        return [d for d in distinct if d.detection >= LEVELS.confusable] or distinct
