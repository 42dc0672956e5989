"""Score columns of terms beside a fit: what an amplitude of one adds to the readings, whitened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.discovery.grammar import FORCE, ZERO, Term, contact_values
from diagnosis.discovery.quantities import DISTANCE, Leaf, SampledLeaves
from diagnosis.screening.null_model import NullModel, RowChoice, RowSet, WhitenedColumns
from diagnosis.screening.projection import ProjectedColumns
from diagnosis.screening.whitened_sensitivity import ReadingSummand, sensitivity_series, without_deflection
from estimation.fit import Fit
from estimation.model_response import signals_are_periodic
from estimation.parameter_layout import parameter_layout
from modeling.chain.effect import GridSuperposition
from modeling.formulas.custom_effect import CustomEffect
from modeling.formulas.python_definition import own_effect
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
        return signals_are_periodic(signals, self._fit.recordings[number].motion)

    def _rows(self, terms: Sequence[Term], number: int, rows: RowSet, *, periodic: bool) -> Array:
        """Whitened columns (r, g, a) of g terms at one recording."""
        whitener, response = self._fit.noise[number].whitener, self._wrench_responses[number]
        columns = np.stack([self._readings(term, number, periodic=periodic) for term in terms], axis=2)
        if terms[0].kind == ZERO:
            return rows.whitened(whitener, columns, periodic=periodic)
        gain = response.series[:, :, 0, :]
        if not periodic and len(gain) < len(columns):
            gain = np.tile(gain, (len(columns) // len(gain), 1, 1))
        columns = np.einsum("npc,ncga->npga", gain[: len(columns)], columns)
        return ReadingSummand(columns, periodic, response.unfiltered).whitened(rows, whitener)

    def _readings(self, term: Term, number: int, *, periodic: bool) -> Array:
        """A zero's addition to the readings (n, p, a), or a contact wrench (n, p, a) in its components."""
        recording, space = self._fit.recordings[number], self._fit.model.space
        samples = recording.samples_per_repeat if periodic else recording.samples
        key = (number, periodic)
        if key not in self._sampled:
            values = recording.motion.model_signals
            self._sampled[key] = SampledLeaves(self._leaves, values, samples, self._shapes)
        parts = np.broadcast_arrays(*term.quantity.evaluated(self._sampled[key]))
        if term.kind == ZERO:
            each = np.kron(np.eye(len(space.channels))[None], parts[0][:, None, :])
            return each if term.kept is None else each[:, :, list(term.kept)]
        force = np.stack([np.broadcast_to(part, (samples, part.shape[1])) for part in parts], axis=1)
        turned = _contact_matrix(space) @ _wrench_matrix(space, term.kind, self._shapes.get(DISTANCE, 0.0))
        wrench = np.asarray(turned @ force)
        return wrench if term.kept is None else wrench[:, :, list(term.kept)]

    @cached_property
    def _wrench_responses(self) -> list[ReadingSummand]:
        """Of each recording the derivative (n, p, 1, p) of the readings in a contact wrench."""
        return _wrench_responses(self._fit)


@lru_cache(maxsize=4)
def _wrench_responses(fit: Fit) -> list[ReadingSummand]:
    probe = _probe(fit.model.space)
    model = without_deflection(fit.model) + probe
    unknowns, responses = parameter_layout(model, fit.recordings), []
    for number, recording in enumerate(fit.recordings):
        own = unknowns.models[number]
        names = [p.name for p in own.parameters]
        which = tuple(i for i, name in enumerate(names) if name.startswith(f"{probe.id}."))
        theta = np.array([unknowns.values_of(number, fit.values)])
        responses.append(next(iter(sensitivity_series(own, recording, theta, which))))
    return responses


@lru_cache(maxsize=2)
def _probe(space: Space) -> CustomEffect:
    """A constant contact wrench."""
    names = contact_components(space)
    parameters = {f"on_{name}": unit for name, unit in zip(names, space.units, strict=True)}
    return own_effect(
        id="probe", title="a constant wrench", parameters=parameters, tip_body={name: f"on_{name}" for name in names}
    )


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
