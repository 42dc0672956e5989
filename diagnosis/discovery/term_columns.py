"""Score columns of terms beside a fit: what an amplitude of one adds to the readings, whitened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.discovery.grammar import FORCE, GAIN, ZERO, Term, contact_values
from diagnosis.discovery.leaves import DISTANCE, SCALES, SHAPES, Leaf
from diagnosis.discovery.quantities import ONE, TINY, TOOL_CONSTANT, WORLD_CONSTANT, Components, Leaves
from diagnosis.screening.null_model import NullModel, RowChoice, RowSet, WhitenedColumns
from diagnosis.screening.projection import ProjectedColumns
from diagnosis.screening.whitened_sensitivity import ReadingSummand, sensitivity_series, without_deflection
from estimation.fit import Fit
from estimation.model_response import predicted_readings, signals_are_periodic
from estimation.parameter_layout import parameter_layout
from modeling.chain.effect import GridSuperposition
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import Signals, compiled_prediction
from modeling.chain.stages import Stage
from modeling.formulas.custom_effect import CustomEffect
from modeling.formulas.python_definition import FormulaTable
from modeling.formulas.units import Dimension
from modeling.formulas.vocabulary import target_units
from modeling.rigid_body import contact_components
from modeling.space import Space, vector

Array = NDArray[np.float64]


class TermColumns:
    """Columns of terms at the recordings of a fit, at values of their `SHAPES`.

    What a wrench on the tool adds to the readings is the derivative of the model's own prediction in one: sign,
    mounting, gains and the sensor's lag are as fitted.
    """

    def __init__(self, null_model: NullModel, leaves: Mapping[str, Leaf], shapes: Mapping[str, float]) -> None:
        self.null_model, self._leaves, self._shapes = null_model, leaves, shapes
        self._fit: Fit = null_model.fit
        self._sampled: dict[tuple[int, bool], SampledLeaves] = {}

    def projected(self, terms: Sequence[Term]) -> ProjectedColumns:
        """Projected columns of terms with as many amplitudes, and all periodic with the motion or none."""
        periodic = [self.is_periodic(terms[0], number) for number in range(len(self._fit.recordings))]
        choice: RowChoice = tuple(RowSet.EXCITED if each else RowSet.WHOLE for each in periodic)
        rows = [self._rows(terms, number, choice[number], periodic=each) for number, each in enumerate(periodic)]
        whitened = WhitenedColumns(rows[0] if len(rows) == 1 else np.concatenate(rows), choice)
        return ProjectedColumns(self.null_model, whitened, GridSuperposition.plain([{}] * len(terms)), -np.inf)

    def is_periodic(self, term: Term, number: int) -> bool:
        """Whether a term is the same in every repeat of a recording."""
        names = {"turn" if name == "k" else name for name in term.quantity.leaves} & set(self._leaves)
        signals = frozenset[str]().union(*(self._leaves[name].signals for name in names))
        if term.kind == GAIN:  # loads are as periodic as what the model takes
            signals |= set(compiled_prediction(_before_gains(self._fit.model)).load.inputs)
        return signals_are_periodic(signals, self._fit.recordings[number].motion)

    def _rows(self, terms: Sequence[Term], number: int, rows: RowSet, *, periodic: bool) -> Array:
        """Whitened columns (r, g, a) of g terms at one recording."""
        whitener, kind = self._fit.noise[number].whitener, terms[0].kind
        columns = np.stack([self._readings(term, number, periodic=periodic) for term in terms], axis=2)
        if kind == ZERO:
            return rows.whitened(whitener, columns, periodic=periodic)
        response = _responses(self._fit, of_gains=kind == GAIN)[number]
        slopes = response.series[:, :, 0, :]
        if not periodic and len(slopes) < len(columns):
            slopes = np.tile(slopes, (len(columns) // len(slopes), 1, 1))
        slopes = slopes[: len(columns)]
        if kind == GAIN:  # of each channel in the gain from each load
            channels = self._fit.model.channels
            each = np.einsum("nppl->npl", slopes.reshape(*slopes.shape[:2], len(channels), len(channels)))
            columns = columns * each[:, :, [channels.index(term.load) for term in terms], None]
        else:
            columns = (slopes @ columns.reshape(len(columns), slopes.shape[2], -1)).reshape(columns.shape)
        return ReadingSummand(columns, periodic, response.unfiltered).whitened(rows, whitener)

    def _readings(self, term: Term, number: int, *, periodic: bool) -> Array:
        """What is added to readings or times a load (n, p, a), or a contact wrench (n, p, a) in its components."""
        recording, space = self._fit.recordings[number], self._fit.model.space
        samples = recording.samples_per_repeat if periodic else recording.samples
        key = (number, periodic)
        if key not in self._sampled:
            values = dict(recording.motion.model_signals) | _loads(self._fit)[number]
            self._sampled[key] = SampledLeaves(self._leaves, values, samples, self._shapes)
        parts = np.broadcast_arrays(*term.quantity.evaluated(self._sampled[key]))
        if term.by_channel:
            each = np.kron(np.eye(len(space.channels))[None], parts[0][:, None, :])
            return each if term.kept is None else each[:, :, list(term.kept)]
        force = np.stack([np.broadcast_to(part, (samples, part.shape[1])) for part in parts], axis=1)
        turned = _contact_matrix(space) @ _wrench_matrix(space, term.kind, self._shapes.get(DISTANCE, 0.0))
        wrench = np.asarray(turned @ force)
        return wrench if term.kept is None else wrench[:, :, list(term.kept)]


@lru_cache(maxsize=8)
def _responses(fit: Fit, *, of_gains: bool) -> list[ReadingSummand]:
    """Of each recording the derivatives (n, p, 1, k) of the readings in a contact wrench, or in gains (row, column)."""
    model = without_deflection(fit.model) + _probes(fit.model.space, of_gains=of_gains)
    unknowns, responses = parameter_layout(model, fit.recordings), []
    for number, recording in enumerate(fit.recordings):
        own = unknowns.models[number]
        which = tuple(i for i, p in enumerate(own.parameters) if p.name.startswith(PROBE))
        theta = np.array([unknowns.values_of(number, fit.values)])
        responses.append(next(iter(sensitivity_series(own, recording, theta, which))))
    return responses


PROBE = "probe_"
"""Beginning of the ids of what the readings are differentiated in."""


@lru_cache(maxsize=4)
def _probes(space: Space, *, of_gains: bool) -> tuple[CustomEffect, ...]:
    """A constant contact wrench; or constant gains, an effect for each channel, from every one to it."""

    def probe(name: str, units: Mapping[str, str], **stage: FormulaTable) -> CustomEffect:
        parameters = {f"on_{target}": unit for target, unit in units.items()}
        return CustomEffect.from_data({"id": PROBE + name, "title": "a constant", "parameters": parameters, **stage})

    if not of_gains:
        units = dict(zip(contact_components(space), space.units, strict=True))
        return (probe("wrench", units, tip_body={target: f"on_{target}" for target in units}),)
    gains, channels = target_units(Stage.GAIN, space), space.channels
    rows = {row: {f"{row}_{column}": gains[f"{row}_{column}"] for column in channels} for row in channels}
    return tuple(probe(row, units, gain={t: f"on_{t}" for t in units}) for row, units in rows.items())


@lru_cache(maxsize=4)
def _loads(fit: Fit) -> list[dict[str, Array]]:
    """Of each recording the loads (n,) before any gain, by channel."""
    model, several = _before_gains(fit.model), []
    unknowns = parameter_layout(fit.model, fit.recordings)
    for number, recording in enumerate(fit.recordings):
        names = [p.name for p in unknowns.models[number].parameters]
        values = dict(zip(names, unknowns.values_of(number, fit.values), strict=True))
        theta = np.array([0.0 if p in model.biases else values[p.name] for p in model.parameters])
        rows = predicted_readings(model, recording, theta)
        rows = np.tile(rows, (recording.samples // len(rows), 1))
        several.append(dict(zip(model.channels, rows.T, strict=True)))
    return several


@lru_cache(maxsize=4)
def _before_gains(model: WrenchModel) -> WrenchModel:
    """The model without effects of gains, and of what follows."""
    fewer = (e for e in without_deflection(model).effects if e.stage.number < Stage.GAIN.number)
    return replace(model, effects=tuple(fewer))


@lru_cache(maxsize=2)
def _contact_matrix(space: Space) -> Array:
    """Contact components (p, 6) of a force and a torque in tool axes."""
    columns = [list(contact_values(space, vector(*row[:3]), vector(*row[3:])).values()) for row in np.eye(6).tolist()]
    return np.array(columns, dtype=float).T


@lru_cache(maxsize=64)
def _wrench_matrix(space: Space, kind: str, distance: float) -> Array:
    """Force and torque about the sensor (6, 3) of a vector: a force at a distance (m) along the tip, or a torque."""
    if kind != FORCE:
        return np.vstack([np.zeros((3, 3)), np.eye(3)])
    arm = distance * np.array(space.tip_axis, dtype=float).ravel()
    return np.vstack([np.eye(3), np.cross(arm, np.eye(3)).T])


class SampledLeaves(Leaves):
    """Over the first samples of a recording, at values of `SHAPES` (0 where not given): arrays (n, a).

    a is the number of amplitudes of a constant vector, or of an operation with two, of which each has the other ones
    zero; else 1.
    """

    functions = np

    def __init__(self, leaves: Mapping[str, Leaf], values: Signals, samples: int, shapes: Mapping[str, float]) -> None:
        super().__init__()
        self.leaves = leaves
        self._values, self._samples = values, samples
        self._theta = np.array([shapes.get(name, float(name in SCALES)) for name in SHAPES])

    def components(self, name: str) -> Components:
        """Arrays over the samples; of a constant vector those of its unit vectors."""
        if name == ONE.operation:
            return (np.ones((self._samples, 1)),)
        if name == TOOL_CONSTANT:
            return tuple(np.eye(3)[:, None, :])
        rows = self.leaves["turn" if name == WORLD_CONSTANT else name].function.value(
            self._values, self._theta, self._samples
        )
        if name == WORLD_CONSTANT:
            return tuple(rows.reshape(len(rows), 3, 3).transpose(1, 0, 2))
        return tuple(rows.T[:, :, None])

    def sum_of(self, operation: str, one: Array, other: Array) -> Array:
        """Both (n, 2)."""
        return np.hstack([one, other])

    def tiny(self, of: Dimension) -> float:
        """The number."""
        return TINY
