"""Model file: JSON of a fitted model with covariance and noise, for prediction, design and compensation."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import reduce
from math import isclose
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from estimation.budget import OF_LOAD, Budget, Source, named_or_stated, uncertain_loads
from estimation.budget import budget as budget_of
from estimation.budget_table import TYPE_A, Contribution, Size, Statement
from estimation.centre_of_mass import centre_of_mass_data
from estimation.contact.contact_wrench import Alternative, CalibratedModel
from estimation.fit import Fit, predicted_frame, require_recording
from estimation.least_squares.estimates import (
    Estimate,
    NamedEstimates,
    correlation_frame,
    parameter_frame,
    parameter_table,
)
from estimation.readings.doubted_reading import DoubtedReading
from estimation.recordings.recording import readings_digest
from estimation.streaming.streamed_fit import StreamedFit
from modeling.chain.effect import Effect
from modeling.chain.model import QUARTER_TURNS, QuarterTurnRotation, WrenchModel
from modeling.chain.sensor_axes import axes_data
from modeling.effects import named
from modeling.effects.loads import OFFSETS, DryFriction
from modeling.effects.sensor import SensorCrosstalk
from modeling.errors import InputError, file_text, kind_of
from modeling.formulas.custom_effect import CustomEffect
from modeling.noise import NoiseSource
from modeling.number_format import finite, probability_text
from modeling.rig import Convention, Rig
from modeling.rig_schema import StrictTable, validated
from modeling.space import Space
from modeling.table import Table, Tabular
from truewrench.files.output import atomic_write

if TYPE_CHECKING:
    import pandas as pd

    from diagnosis.averaging import ModelAverage
    from estimation.recordings.recording import Recording

Array = NDArray[np.float64]

FORMAT = "truewrench model"
VERSION = 1
BASES = {"planar": Space.PLANE, "spatial": Space.SPACE}
ROUNDING = 1e-6
"""Relative tolerance of redundant numbers in one file, which may have been rounded by hand."""
RECORDINGS = (".csv", ".parquet", ".bag", ".mcap", ".db3", ".mat", ".npz", ".h5", ".xlsx")
"""Endings of files that hold recordings, not models."""
REMEDY = "write the file again with `truewrench fit --out`, or correct it there"


@dataclass(frozen=True, eq=False)
class ModelFile(NamedEstimates, Tabular):
    """A fitted model: estimates, covariance, noise and systematic residual.

    parameters    in the model's order; biases are those of the first recording
    covariance    (k, k) in the same order, in products of their units; a parameter that is not identifiable has
                  an infinite variance and zero covariances
    noise_floor   std of one sample per channel of the first recording, and its source
    remainder     RMS per channel of the systematic residual of the fit
    fitted_on     SHA-256 of the readings of each recording of the fit; None where it is not known
    misfitting    recordings that the model does not fit, held-out ones named as such; None where it was not tested
    tool_unknown  why the recordings do not say what the tool weighs; empty where they do, or it was not tested
    mended_as     what the readings mean by which the recordings were mended before the fit (`--read`), as clauses
    budget        of uncertainty, of the model's parameters; None without one
    alternatives  models that a diagnosis could not tell apart from this one, each with its name and its weight
    """

    model: WrenchModel
    rig: Rig | None
    parameters: Mapping[str, Estimate]
    covariance: Array
    noise_floor: Mapping[str, float]
    noise_source: NoiseSource
    remainder: Mapping[str, float]
    fitted_on: tuple[str, ...] | None = None
    misfitting: tuple[str, ...] | None = None
    tool_unknown: str = ""
    mended_as: tuple[str, ...] = ()
    budget: Budget | None = None
    alternatives: tuple[tuple[str, float, ModelFile], ...] = ()

    @classmethod
    def of(
        cls,
        fitted: Fit | StreamedFit,
        misfitting: Iterable[str] | None = None,
        tool_unknown: str = "",
        readings: Iterable[DoubtedReading] = (),
        budget: Budget | None = None,
    ) -> Self:
        """Model file of a fit, with the biases of its first recording, and the others where they were tested.

        `readings` are those of the recordings, the `budget` is the fit's.
        """
        noise = fitted.noise if isinstance(fitted, StreamedFit) else fitted.noise[0]
        names = [p.name for p in fitted.model.parameters]
        estimates, calibration = fitted.parameters, CalibratedModel.of(fitted)
        return cls(
            model=fitted.model,
            rig=fitted.rig if isinstance(fitted, StreamedFit) else fitted.recordings[0].rig,
            parameters={name: estimates[name] for name in names},
            covariance=calibration.covariance,
            noise_floor=_by_channel(fitted.model, noise.floor),
            noise_source=noise.source,
            remainder=_by_channel(fitted.model, calibration.remainder),
            fitted_on=None if isinstance(fitted, StreamedFit) else tuple(map(readings_digest, fitted.recordings)),
            misfitting=None if misfitting is None else tuple(misfitting),
            tool_unknown=tool_unknown,
            mended_as=tuple(reading.meaning for reading in readings if reading.is_mending),
            budget=None if budget is None else budget.of_model,
        )

    @property
    def mending_warning(self) -> str:
        """That the model is of readings that were mended, and others have to be; empty where they were not."""
        if not self.mended_as:
            return ""
        read = "; ".join(self.mended_as)
        return f"the model was fitted to readings that were mended, as {read}: mend others alike first"

    @property
    def table(self) -> Table:
        """Name, value, std and unit of every parameter."""
        return parameter_table(self.parameters)

    def printed(self) -> list[Table | str]:
        """The model, then its parameters, and which models the recordings did not tell apart from it."""
        others = self._others
        return [repr(self.model), self.table, *([f"Not told apart from {others}."] if others else [])]

    @property
    def doubt_warning(self) -> str:
        """That other models were not told apart from this one, whose std are its own; empty where none is known."""
        if not self.alternatives:
            return ""
        return f"the model was not told apart from {self._others}: its std are as if it were known to be the right one"

    @property
    def _others(self) -> str:
        return ", ".join(f"{name} (probability {probability_text(weight)})" for name, weight, _ in self.alternatives)

    def misfit_warning(self, consequence: str) -> str:
        """That the model does not fit its recordings, and what follows; empty where it does, or was not tested.

        Where the tool is unknown, that it is.
        """
        if self.tool_unknown:
            return f"the tool is not known, as {self.tool_unknown}: {consequence}"
        if not self.misfitting:
            return ""
        remedy = "`truewrench diagnose` or `tw.diagnose` searches for what is missing"
        return f"the model does not fit {', '.join(self.misfitting)}: {consequence}; {remedy}"

    @property
    def params(self) -> pd.DataFrame:
        """Value, std and unit of every parameter, by name, as a data frame; a fit knows intervals too."""
        return parameter_frame(self.parameters)

    @property
    def theta(self) -> Array:
        """The values (k,) of all parameters, in the model's order."""
        return np.array([e.value for e in self.parameters.values()])

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """Whether a parameter (k,) is identifiable."""
        return self.calibration.known

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlation coefficients (k, k) of the estimates; missing for an unidentifiable parameter."""
        return correlation_frame(list(self.parameters), self.covariance, self.calibration.known)

    def predict(self, recording: Recording) -> pd.DataFrame:
        """Predicted readings of a recording, N and N m, by time (s; of static poses their number) and channel.

        The biases are those of the first recording of the fit, and recording-specific effects are left out.
        """
        require_recording(recording, "predict")
        return predicted_frame(self.model, self.values, recording)

    @property
    def calibration(self) -> CalibratedModel:
        """Calibrated model for compensation of other recordings."""
        return CalibratedModel(
            model=self.model,
            theta=self.theta,
            covariance=self.covariance,
            floor=np.array([self.noise_floor[c] for c in self.model.channels]),
            remainder=np.array([self.remainder[c] for c in self.model.channels]),
            alternatives=tuple(Alternative(name, weight, one.calibration) for name, weight, one in self.alternatives),
        )

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The model in a JSON file.

        Raises InputError, in one line, for an invalid file.
        """
        try:
            return cls.from_text(file_text(path, kind="a model file", syntax="JSON"), where=str(path))
        except InputError:
            if Path(path).suffix.lower() not in RECORDINGS or not Path(path).exists():
                raise
            raise _recording_instead(str(path)) from None

    @classmethod
    def from_text(cls, text: str, *, where: str = "model") -> Self:
        """The model in a JSON text; `where` names it in an InputError."""
        try:
            data = json.loads(text, parse_int=_whole, parse_constant=_no_number, object_pairs_hook=_each_once)
        except (ValueError, RecursionError) as error:
            _refuse_recording(text, where)
            raise InputError(what=f"not a JSON file: {error}", where=where, remedy=REMEDY) from None
        return cls.from_data(data, where=where)

    @classmethod
    def from_data(cls, data: object, *, where: str = "model") -> Self:
        """The model of plain dictionaries, lists, numbers and strings, as `to_data` gives them."""
        table = validated(_Model, data, where, remedy=REMEDY)
        rig = None if table.rig is None else Rig.from_data(table.rig, where=f"{where}: rig")
        model = _model(table, where, rig)
        parameters, covariance = _numbers(table, model, where)
        read = cls(
            model=model,
            rig=rig,
            parameters=parameters,
            covariance=covariance,
            noise_floor=table.noise_floor,
            noise_source=NoiseSource(table.noise_source),
            remainder=table.remainder,
            fitted_on=None if table.fitted_on is None else tuple(table.fitted_on),
            misfitting=None if table.misfitting is None else tuple(table.misfitting),
            tool_unknown=table.tool_unknown,
            mended_as=tuple(table.mended_as or ()),
        )
        alternatives = () if table.alternatives is None else _alternatives(table, read, where)
        budget = None if table.budget is None else _budget(table.budget, table, read, where)
        return replace(read, budget=budget, alternatives=alternatives)

    def to_data(self) -> dict[str, Any]:
        """The model as plain data: numbers are finite, or None for a parameter that is not identifiable."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "base": next(base for base, space in BASES.items() if space is self.model.space),
            "gravity": self.model.gravity,
            "convention": self.model.convention.value,
            "mirror_y": self.model.mirror_y,
            "mounting": [list(row) for row in self.model.mounting],
            "axes": axes_data(self.model, self.theta),
            "centre_of_mass": centre_of_mass_data(self, unknown=self.tool_unknown),
            "channels": list(self.model.channels),
            "effects": [_effect_data(effect) for effect in self.model.effects],
            "parameters": {
                e.name: {"value": e.value, "std": finite(e.std), "unit": e.unit} for e in self.parameters.values()
            },
            "covariance": {
                "parameters": list(self.parameters),
                "matrix": [[finite(v) for v in row] for row in self.covariance.tolist()],
            },
            "noise_floor": dict(self.noise_floor),
            "noise_source": self.noise_source.value,
            "remainder": dict(self.remainder),
            **({} if self.fitted_on is None else {"fitted_on": list(self.fitted_on)}),
            **({} if self.misfitting is None else {"misfitting": list(self.misfitting)}),
            **({"tool_unknown": self.tool_unknown} if self.tool_unknown else {}),
            **({"mended_as": list(self.mended_as)} if self.mended_as else {}),
            **({} if self.budget is None else {"budget": _budget_data(self.budget)}),
            **({"alternatives": [_alternative_data(*one) for one in self.alternatives]} if self.alternatives else {}),
            "rig": None if self.rig is None else self.rig.to_data(),
        }

    def to_text(self) -> str:
        """The JSON text of the file."""
        return json.dumps(self.to_data(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


class HasFit(Protocol):
    """A study or a diagnosis: its last fit, the recordings that this does not fit, and why the tool is unknown."""

    @property
    def fit(self) -> Fit: ...
    @property
    def misfitting(self) -> Iterable[str]: ...
    @property
    def tool_unknown(self) -> str: ...
    @property
    def readings(self) -> Iterable[DoubtedReading]: ...


Fitted = Fit | StreamedFit | ModelFile | HasFit
"""What a model file can be made of."""


def as_model_file(given: Fitted, where: str) -> ModelFile:
    """What a model file holds of it; InputError, in a sentence, for what has no fitted model.

    Of recordings with loads whose mass or place is uncertain the budget of these is with it, as `fit` writes it.
    """
    if isinstance(given, ModelFile):
        return given
    if isinstance(given, Fit | StreamedFit):
        return ModelFile.of(given, budget=_budget_of_loads(given))
    fitted: object = getattr(given, "fit", None)
    if not isinstance(fitted, Fit):
        remedy = f"give a fit: tw.{where}(tw.fit(model, recording), ..); or a study, a diagnosis or a loaded model"
        raise InputError(what=f"{kind_of(given)} is no fitted model", where=where, remedy=remedy)
    budget = None if given.tool_unknown else _budget_of_loads(fitted)
    file = ModelFile.of(fitted, given.misfitting, given.tool_unknown, given.readings, budget)
    average: ModelAverage | None = getattr(given, "averaged", None)  # a study has none
    others = () if average is None else average.members[1:]
    return replace(file, alternatives=tuple((one.name, one.weight, ModelFile.of(one.fit)) for one in others))


def _budget_of_loads(fitted: Fit | StreamedFit) -> Budget | None:
    return budget_of(fitted) if isinstance(fitted, Fit) and uncertain_loads(fitted) else None


def save(fit: Fitted, path: str | Path) -> Path:
    """Write a fitted model as a model file, atomically.

    Parameters
    ----------
    fit : Fit, StreamedFit, ModelFile, Study or Diagnosis
        The model with its parameters, covariance and noise; of a study or a diagnosis its last fit.
    path : str or Path
        The JSON file, which is replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        When it cannot be written.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> path = tw.save(tw.fit(tw.planar(rig), tw.read("train.csv", rig=rig)), "model.json")
    >>> tw.load(path)["m"].unit
    'kg'
    """
    file: object = path
    saved = as_model_file(fit, "save")
    if not isinstance(file, str | Path):
        remedy = 'give the path of the file, such as "model.json"'
        raise InputError(what=f"{kind_of(file)} is no path", where="save", remedy=remedy)
    target = Path(path)
    with atomic_write(target) as temporary:
        temporary.write_text(saved.to_text(), encoding="utf-8")
    return target


def load(path: str | Path | Mapping[str, Any]) -> ModelFile:
    """The fitted model in a model file, for prediction, comparison, compensation, design and code.

    Parameters
    ----------
    path : str, Path or mapping
        JSON file of `save`, `truewrench fit --out` or `truewrench diagnose --out`; or the data that
        `fit.to_dict()` gives.

    Returns
    -------
    ModelFile
        Model, parameters by name with std and unit, covariance, noise and rig.

    Raises
    ------
    InputError
        In one line, for an invalid file.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> recording = tw.read("train.csv", rig=rig)
    >>> path = tw.save(tw.fit(tw.planar(rig) + tw.effects.viscous_drag(), recording), "model.json")
    >>> known = tw.load(path)
    >>> f"{known['viscous_drag.c'].value:.2f} {known['viscous_drag.c'].unit}"
    '0.15 N s/m'
    """
    given: object = path
    if isinstance(given, Mapping):
        return ModelFile.from_data(given)
    if not isinstance(given, str | Path):
        remedy = "give the path of a model file, or what fit.to_dict() gave"
        raise InputError(what=f"{kind_of(given)} is no model file", where="load", remedy=remedy)
    return ModelFile.read(given)


def _by_channel(model: WrenchModel, values: Array) -> dict[str, float]:
    return {c: float(v) for c, v in zip(model.channels, values, strict=True)}


# ------------------------------------------------------------------------------ schema of the file


def _refuse_recording(text: str, where: str) -> None:
    """InputError for the text of a recording: a header of several columns, among them those of a wrench."""
    header = {name.strip(" \"'").lower() for name in re.split(r"[,;\t]", text.partition("\n")[0])}
    if {"fx", "fy"} <= header:
        raise _recording_instead(where)


def _recording_instead(where: str) -> InputError:
    remedy = (
        "give the JSON that `truewrench fit --out` wrote: `compensate MODEL.json REC`, `compare MODEL.json --on REC`"
    )
    return InputError(what="a recording where a model file belongs", where=where, remedy=remedy)


def _no_number(token: str) -> float:
    raise ValueError(f"{token} is not a number in JSON")


def _whole(digits: str) -> int:
    if len(digits) > 18:  # 64 bits
        raise ValueError(f"{digits[:12]}... is too large an integer")
    return int(digits)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        twice = next(key for key in table if sum(k == key for k, _ in pairs) > 1)
        raise ValueError(f"the key '{twice[:40]}' is used twice")
    return table


Positive = Annotated[float, Field(gt=0)]
Variance = float | None


class _Effect(StrictTable):
    id: str
    options: dict[str, bool | int] = Field(default_factory=dict)
    definition: dict[str, Any] | None = None


class _Estimate(StrictTable):
    value: float
    std: Annotated[float, Field(ge=0)] | None
    unit: str


class _Covariance(StrictTable):
    parameters: list[str]
    matrix: list[list[Variance]]


Line = Annotated[str, Field(max_length=1000, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
"""Text of one line, as it is quoted in comments of code."""


class _Contribution(StrictTable):
    name: Line
    quantity: Line
    std: Size
    unit: Line
    uniform: bool
    freedom: Positive | None
    each_recording: bool


Shift = Annotated[float, Field(ge=-1e12, le=1e12)]
"""Of an estimate, for a unit of a contribution: its square is a number yet."""


class _Source(StrictTable):
    contribution: str
    parameter: str
    std: Size
    shifts: Annotated[list[list[Shift]], Field(min_length=1)]


class _Budget(StrictTable):
    coverage: Annotated[float, Field(gt=0, lt=1)]
    parameters: list[str]
    freedom: list[Positive]
    held: list[str]
    effects: list[_Effect]
    contributions: list[_Contribution]
    sources: list[_Source]


class _Alternative(StrictTable):
    name: Line
    weight: Annotated[float, Field(gt=0, lt=1)]
    model: dict[str, Any]


class _Model(StrictTable):
    format: Literal["truewrench model"]
    version: Literal[1]
    base: Literal["planar", "spatial"]
    gravity: Positive
    convention: Literal["on_tool", "on_sensor"]
    mirror_y: bool
    mounting: list[list[int]]
    axes: dict[str, Any] | None = None  # they follow from the others, for who reads the file
    centre_of_mass: dict[str, Any] | None = None
    channels: list[str]
    effects: list[_Effect]
    parameters: dict[str, _Estimate]
    covariance: _Covariance
    noise_floor: dict[str, Annotated[float, Field(ge=0)]]
    noise_source: Literal["repeats", "rig", "residual", "dwells"]
    remainder: dict[str, Annotated[float, Field(ge=0)]]
    fitted_on: list[str] | None = None
    misfitting: list[str] | None = None
    tool_unknown: Line = ""
    mended_as: list[Line] | None = None
    budget: _Budget | None = None
    alternatives: Annotated[list[_Alternative], Field(min_length=1)] | None = None
    rig: dict[str, Any] | None


# --------------------------------------------------------------------------- model from the tables


def _mounting(rows: list[list[int]], where: str) -> QuarterTurnRotation:
    for turn in QUARTER_TURNS:
        if rows == [list(row) for row in turn]:
            return turn
    raise InputError(what="mounting is not a rotation by quarter turns", where=where, remedy=REMEDY)


def _model(table: _Model, where: str, rig: Rig | None) -> WrenchModel:
    space, arm = BASES[table.base], None if rig is None else rig.arm
    _require_names(table.channels, space.channels, "channels", where)
    _require_names(table.noise_floor, space.channels, "noise_floor", where)
    _require_names(table.remainder, space.channels, "remainder", where)
    bare = WrenchModel(
        space=space,
        gravity=table.gravity,
        gravity_direction=None if rig is None else rig.gravity_direction,
        convention=Convention(table.convention),
        mirror_y=table.mirror_y,
        mounting=_mounting(table.mounting, where),
    ).with_arm(arm)
    try:
        model = reduce(add, (_effect(effect, table, space) for effect in table.effects), bare)
    except InputError as error:
        place = "" if error.where in ("effects", "effect id") else f"{error.where}: "
        raise InputError(what=f"effects: {place}{error.what}", where=where, remedy=error.remedy) from None
    if arm is None and any(effect.needs_joints for effect in model.effects):
        raise InputError(what="effects: one of them needs joints, and rig has no arm", where=where, remedy=REMEDY)
    parameters = {**_omitted(table, model), **table.parameters}
    _require_names(parameters, [p.name for p in model.parameters], "parameters", where)
    return model


def _omitted(table: _Model, model: WrenchModel) -> dict[str, _Estimate]:
    """The fixed parameters that are not in a file: it was written before effects had them."""
    fixed = [p for p in model.parameters if p.fixed and p.name not in table.parameters]
    return {p.name: _Estimate(value=p.nominal, std=0.0, unit=p.unit) for p in fixed}


def _effect(table: _Effect, model: _Model, space: Space, of_id: Callable[[str], Effect] = named) -> Effect:
    """Effect of that id with its options, each true or an integer from 1 to the number of parameters of the file.

    A custom effect has its definition, whose formulas are parsed like those of an effects file. An effect
    whose x and y, or width, are not in the file has them fixed: it was written before these were estimated. A crosstalk
    leaks by the elements that are in the file.
    """
    if table.definition is not None:
        custom = CustomEffect.from_data(table.definition, where=table.id[:40])
        if custom.id != table.id or table.options:
            raise InputError(what=f"{table.id[:40]} is defined as '{custom.id}'", where="effects", remedy=REMEDY)
        return custom
    effect = of_id(table.id)
    options = _options(effect)
    for name, value in table.options.items():
        if name not in options:
            raise InputError(what=f"{table.id} has no option '{name[:40]}'", where="effects", remedy=REMEDY)
        if not 0 < value <= len(model.parameters) or type(value) is not type(options[name]):
            raise InputError(what=f"{table.id} cannot have {name} = {value}"[:80], where="effects", remedy=REMEDY)
    configured = type(effect)(**table.options)
    if isinstance(configured, SensorCrosstalk):
        own = tuple(p.name for p in configured.parameters(space) if f"{table.id}.{p.name}" in model.parameters)
        return configured if len(own) == len(configured.parameters(space)) else replace(configured, leaks=own)
    point = {f"{table.id}.{p.name}" for p in OFFSETS} & model.parameters.keys()
    read = configured if point else configured.restricted(space)
    if isinstance(configured, DryFriction) and isinstance(read, DryFriction):
        return replace(read, narrow=configured.narrow or f"{table.id}.width" not in model.parameters)
    return read


def _effect_data(effect: Effect) -> dict[str, Any]:
    """Id with options, or with the definition of a custom effect."""
    if isinstance(effect, CustomEffect):
        return {"id": effect.id, "definition": effect.to_data()}
    return {"id": effect.id, "options": {name: value for name, value in _options(effect).items() if value}}


def _options(effect: Effect) -> dict[str, bool | int]:
    """Its options, integers and flags; the other fields follow from the arm."""
    return {name: value for name, value in asdict(effect).items() if isinstance(value, int)}


def _budget(table: _Budget, model: _Model, read: ModelFile, where: str) -> Budget:
    """The budget of what was read: its effects are none of the model's, and its shifts are in the order it names."""
    place = f"{where}: budget"
    _require_names(table.parameters, list(read.parameters), "parameters", place)
    order = [table.parameters.index(name) for name in read.parameters]
    rows = [table.freedom, *(row for source in table.sources for row in source.shifts)]
    if any(len(row) != len(order) for row in rows):
        raise InputError(what=f"expected {len(order)} numbers a row", where=place, remedy=REMEDY)
    try:
        effects = tuple(_effect(effect, model, read.model.space, named_or_stated) for effect in table.effects)
        known = [p.name for p in reduce(add, effects, read.model).parameters]
    except InputError as error:
        raise InputError(what=f"effects: {error.what}", where=place, remedy=error.remedy) from None
    stated = {
        c.name: Contribution(**c.model_dump() | {"freedom": np.inf if c.freedom is None else c.freedom})
        for c in table.contributions
    }
    if len(stated) < len(table.contributions) or stated.keys() & TYPE_A.keys():
        raise InputError(what="contributions: a name is used twice", where=place, remedy=REMEDY)
    for source in table.sources:
        if source.contribution not in stated or source.parameter not in (*known, OF_LOAD):
            what = f"no contribution or parameter is called {source.contribution[:40]}, {source.parameter[:40]}"
            raise InputError(what=what, where=place, remedy=REMEDY)
    sources = tuple(
        Source(stated[s.contribution], s.parameter, s.std, np.array(s.shifts)[:, order]) for s in table.sources
    )
    freedom = np.array(table.freedom)[order]
    statement = Statement(tuple(stated.values()), table.coverage)
    return Budget.of(read.calibration, read.parameters, freedom, tuple(table.held), effects, sources, statement)


OF_THE_FILE = ("format", "version", "fitted_on", "rig")
"""Keys of a model file that its alternatives share."""


def _alternatives(table: _Model, read: ModelFile, where: str) -> tuple[tuple[str, float, ModelFile], ...]:
    """The alternatives to what was read: models of the same readings, whose weights leave some to it."""
    place, stated = f"{where}: alternatives", table.alternatives or []
    if sum(one.weight for one in stated) >= 1:
        raise InputError(what="their weights leave none to the model", where=place, remedy=REMEDY)
    shared = {"format": FORMAT, "version": VERSION, "rig": table.rig}
    models = [ModelFile.from_data(one.model | shared, where=f"{place}: {one.name[:40]}") for one in stated]
    frame = _frame(read.model)
    if any(_frame(model.model) != frame or model.alternatives or model.budget is not None for model in models):
        what = "they have other axes or signs than the model, or alternatives of their own"
        raise InputError(what=what, where=place, remedy=REMEDY)
    return tuple((one.name, one.weight, model) for one, model in zip(stated, models, strict=True))


def _frame(model: WrenchModel) -> tuple[object, ...]:
    """What readings mean to a model."""
    return model.space, model.convention, model.mirror_y, model.mounting, model.gravity


def _alternative_data(name: str, weight: float, model: ModelFile) -> dict[str, Any]:
    """An alternative as plain data, without what the whole file says."""
    own = {key: value for key, value in model.to_data().items() if key not in OF_THE_FILE}
    return {"name": name, "weight": weight, "model": own}


def _budget_data(budget: Budget) -> dict[str, Any]:
    """A budget as plain data: the stated contributions, and what the estimates move by for each unit of them."""
    return {
        "coverage": budget.coverage,
        "parameters": list(budget.estimates),
        "freedom": budget.freedom.tolist(),
        "held": [name for name in budget.held if name in budget.estimates],
        "effects": [_effect_data(effect) for effect in budget.effects],
        "contributions": [vars(one) | {"freedom": finite(one.freedom)} for one in budget.contributions],
        "sources": [
            {
                "contribution": source.contribution.name,
                "parameter": source.parameter,
                "std": source.std,
                "shifts": source.shifts.tolist(),
            }
            for source in budget.sources
        ],
    }


def _require_names(names: Iterable[str], expected: Iterable[str], key: str, where: str) -> None:
    names, expected = list(names), list(expected)
    missing = [name for name in expected if name not in names]
    unknown = [name for name in names if name not in expected]
    if missing:
        raise InputError(what=f"{key}: {missing[0]} is missing", where=where, remedy=REMEDY)
    if unknown:
        raise InputError(what=f"{key}: {unknown[0][:40]} is not expected", where=where, remedy=REMEDY)
    if len(names) != len(expected):
        raise InputError(what=f"{key}: a name is used twice", where=where, remedy=REMEDY)


def _numbers(table: _Model, model: WrenchModel, where: str) -> tuple[dict[str, Estimate], Array]:
    """Estimates and covariance in the model's order."""
    estimates = {}
    entries = {**_omitted(table, model), **table.parameters}
    for parameter in model.parameters:
        entry = entries[parameter.name]
        if entry.unit != parameter.unit:
            what = f"parameters.{parameter.name}: expected the unit {parameter.unit}; got {entry.unit[:40]!r}"
            raise InputError(what=what, where=where, remedy=REMEDY)
        std = np.inf if entry.std is None else entry.std
        estimates[parameter.name] = Estimate(parameter.name, entry.value, std, parameter.unit)
    covariance = _covariance(table.covariance, list(table.parameters), list(estimates), where)
    for name, variance in zip(estimates, np.diag(covariance), strict=True):
        if not isclose(estimates[name].std, np.sqrt(variance), rel_tol=ROUNDING):
            what = f"parameters.{name}: std is not the square root of its variance in covariance"
            raise InputError(what=what, where=where, remedy=REMEDY)
    return estimates, covariance


def _covariance(table: _Covariance, stated: list[str], names: list[str], where: str) -> Array:
    """The matrix in the order of `names`, with zeros for those that are not `stated` in the file.

    None is an infinite variance on the diagonal, and zero off it.
    """
    _require_names(table.parameters, stated, "covariance", where)
    if [len(row) for row in table.matrix] != [len(stated)] * len(stated):
        what = f"covariance: a matrix of {len(stated)} x {len(stated)} numbers was expected"
        raise InputError(what=what, where=where, remedy=REMEDY)
    order = [names.index(name) for name in table.parameters]
    matrix = np.zeros((len(names), len(names)))
    matrix[np.ix_(order, order)] = np.array(table.matrix, dtype=np.float64)
    unknown = np.isnan(matrix)
    matrix[unknown] = np.where(np.eye(len(names), dtype=bool), np.inf, 0.0)[unknown]
    variance = np.diag(matrix)
    scale = np.sqrt(np.where(np.isfinite(variance) & (variance > 0), variance, 1.0))
    finite = np.where(np.isfinite(matrix), matrix, 1.0) / scale[:, None] / scale
    if (
        (variance < 0).any()
        or not np.allclose(finite, finite.T, rtol=0, atol=ROUNDING)
        or np.linalg.eigvalsh(finite).min() < -ROUNDING * len(names)
    ):
        what = "covariance: the matrix is not symmetric and positive semidefinite"
        raise InputError(what=what, where=where, remedy=REMEDY)
    return matrix
