"""Centre of mass of the tool with covariance, from its mass and first moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.estimates import EstimatedModel
from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.chain.sensor_axes import Axes, is_turned
from modeling.chain.stages import Mounting
from modeling.compiled.cache import source_digest
from modeling.compiled.tape import Tape
from modeling.compiled.tape_evaluation import TapeEvaluation
from modeling.number_format import NOT_IDENTIFIABLE, finite
from modeling.space import Space
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]


SIGNIFICANT = 5.0
"""Std of a mass from which on the centre of mass is defined: it is the first moment over the mass."""


@dataclass(frozen=True, eq=False)
class CentreOfMass(Tabular):
    """The tool's centre of mass, from the sensor origin, along the axes of the sensor or of the logged pose.

    `of` gives that of a fit or of a loaded model, with the model's effects on the body.

    Parameters
    ----------
    axes : tuple of str
        Axes of the d components: x, y, z; in the plane `tip` along the tip, and x' if the model has that component.
    value : array (d,)
        Components, m.
    covariance : array (d, d)
        m², by the delta method: J C J' with J the derivative of first moment / mass.
    shown : array (d,) of bool
        Whether a component is identifiable.
    frame : str
        What the axes are: "sensor axes", "the axes of the logged pose", in the plane "tip axes".

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), tw.read("train.csv", rig=rig))
    >>> centre = tw.CentreOfMass.of(fit)
    >>> centre.axes, centre.value.round(3).tolist()
    (('tip',), [0.07])
    """

    axes: tuple[str, ...]
    value: Array
    covariance: Array
    shown: NDArray[np.bool_]
    frame: str

    @classmethod
    def of(cls, fitted: EstimatedModel, along: Axes = Axes.SENSOR) -> CentreOfMass:
        """Of the model's body, changed by its effects, at the values estimated; without a load that it took up.

        It is `along` the sensor's axes, or those of the logged pose; in the plane along the tip's, whatever is said.
        """
        model = fitted.model
        size = len(model.parameters)  # the model's parameters come first
        along = Axes.POSE if model.space is Space.PLANE else along
        turned = along is Axes.SENSOR and is_turned(model)
        form = model.stored(
            f"centre of mass{' in sensor axes' * turned} by {SOURCE}",
            lambda: _CentreForm.of(model, turned=turned).to_data(),
            _CentreForm.from_data,
        )
        value, jacobian = form.at(fitted.theta[:size])
        covariance = np.nan_to_num(fitted.covariance[:size, :size], posinf=0.0)
        identifiable = np.array([fitted.identifiable[list(used)].all() for used in form.used])
        return cls(form.axes, value, jacobian @ covariance @ jacobian.T, identifiable, along.words(model.space))

    @property
    def std(self) -> Array:
        """Standard deviation (d,) m; infinite where it is not identifiable."""
        return np.asarray(np.where(self.shown, np.sqrt(np.diag(self.covariance)), np.inf))

    def to_data(self) -> dict[str, Any]:
        """Each component with its std, None where it is not identifiable, m."""
        numbers = zip(self.axes, self.value.tolist(), self.std.tolist(), strict=True)
        return {axis: {"value": value, "std": finite(std), "unit": "m"} for axis, value, std in numbers}

    @property
    def table(self) -> Table:
        """Axis, value and std in mm."""
        value, std = Column("value", format=".2f"), Column("std", format=".2g", unknown=NOT_IDENTIFIABLE)
        numbers = zip(self.axes, (1e3 * self.value).tolist(), (1e3 * self.std).tolist(), strict=True)
        rows = [
            (f"centre of mass, {axis}, in {self.frame}", v if np.isfinite(s) else None, s, "mm")
            for axis, v, s in numbers
        ]
        return Table.of(("quantity", value, std, "unit"), rows)


def centres_of_mass(fitted: EstimatedModel) -> tuple[CentreOfMass, ...]:
    """In sensor axes, and of a sensor that is turned against the logged pose in those of the pose, too."""
    both = fitted.model.space is Space.SPACE and is_turned(fitted.model)
    return tuple(CentreOfMass.of(fitted, along) for along in ((Axes.SENSOR, Axes.POSE) if both else (Axes.SENSOR,)))


def centre_of_mass_data(fitted: EstimatedModel, *, unknown: str = "") -> dict[str, Any] | None:
    """The same by the axes' words, as plain data, m; None where the mass is not significant, or `unknown`."""
    mass = fitted.parameters["m"]
    if unknown or not mass.std < abs(mass.value) / SIGNIFICANT:
        return None
    return {centre.frame.removeprefix("the "): centre.to_data() for centre in centres_of_mass(fitted)}


@dataclass(frozen=True, eq=False)
class _CentreForm:
    """The centre of mass of a model as a function of its k parameters.

    axes  of the d components
    used  of each, the numbers of the parameters that it depends on
    tape  the components, then their derivatives (d, k) row by row, over the parameters
    """

    axes: tuple[str, ...]
    used: tuple[tuple[int, ...], ...]
    tape: Tape

    @classmethod
    def of(cls, model: WrenchModel, *, turned: bool) -> Self:
        """Derived from the model's body; `turned` into the sensor's axes where the model has these turned."""
        chain, space = model.without_recording_specific.chain, model.space
        body, rotation = chain.body, chain[Mounting].rotation if turned else sp.eye(3)
        unit = {"x'": sp.Matrix([1, 0, 0]), "tip": space.tip_axis} if space is Space.PLANE else _unit_vectors()
        centre = {name: axis.dot(rotation * body.first_moment) / body.mass for name, axis in unit.items()}
        centre = {name: expression for name, expression in centre.items() if expression != 0}
        symbols = [p.symbol for p in model.parameters]
        column = sp.Matrix(list(centre.values()))
        slopes = column.jacobian(symbols)
        used = tuple(tuple(j for j in range(len(symbols)) if slopes[i, j] != 0) for i in range(len(centre)))
        return cls(tuple(centre), used, Tape.of_expressions(symbols, [*column, *slopes]))

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """From the result of `to_data`."""
        used = tuple(tuple(map(int, row)) for row in data["used"])
        return cls(tuple(map(str, data["axes"])), used, Tape.from_data(data["tape"]))

    def to_data(self) -> dict[str, Any]:
        """As plain data."""
        return {"axes": self.axes, "used": self.used, "tape": self.tape.to_data()}

    def at(self, theta: Array) -> tuple[Array, Array]:
        """Components (d,) m, and their derivatives (d, k) at these parameters."""
        values = TapeEvaluation(self.tape).values(list(theta[:, None])).ravel()
        count = len(self.axes)
        return values[:count], values[count:].reshape(count, len(theta))


SOURCE = source_digest(Path(__file__).parent)
"""Of the modules that derive it."""


def _unit_vectors() -> dict[str, sp.Matrix]:
    return {name: sp.eye(3).col(i) for i, name in enumerate("xyz")}
