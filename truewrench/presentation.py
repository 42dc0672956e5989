"""How results of all packages are presented: `fit.summary()` and the like ask here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from design.exciting_trajectory import ExcitingTrajectory
from diagnosis.comparison.compared_step import ComparedFit
from diagnosis.comparison.comparison import Comparison, comparison_of
from diagnosis.diagnosis import Diagnosis
from diagnosis.study import Location, Study
from estimation.contact.contact_wrench import ContactWrench
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimate, Estimates
from estimation.noise.recording_noise import sample_step
from estimation.recordings.motion import numbered_names
from estimation.recordings.recording import Recording
from estimation.streaming.streamed_fit import StreamedFit
from modeling.errors import InputError, kind_of, missing_package
from modeling.number_format import finite
from modeling.table import Cell, Table, Tabular, Value
from truewrench.files.model_file import ModelFile

if TYPE_CHECKING:
    import xarray as xr

    from truewrench.workbench.notebook import ShownStudy

Array = NDArray[np.float64]


# Results as plain data, which JSON can write.


def data(result: Any) -> dict[str, Any]:
    """A fit as the data of its model file, another result as that of its own file, else its table and remarks."""
    if isinstance(result, Fit | StreamedFit):
        return ModelFile.of(result).to_data()
    if isinstance(result, Table):
        return table_data(result)
    to_data = getattr(result, "to_data", None)
    plain: dict[str, Any] = _plain(_tabular_data(result) if to_data is None else to_data())
    return plain


def table_data(table: Table) -> dict[str, Any]:
    """Columns with their units, and rows."""
    columns = [{"name": column.name, "unit": column.unit} for column in table.columns]
    plain: dict[str, Any] = _plain({"columns": columns, "rows": [[_value(v) for v in row] for row in table.rows]})
    return plain


def _tabular_data(result: Tabular) -> dict[str, Any]:
    return {"result": type(result).__name__, "table": table_data(result.table), "remarks": result.remarks()}


def _value(value: Value) -> float | str | None:
    return value.value if isinstance(value, Cell) else value


def _plain(value: Any) -> Any:
    """Mappings, lists, numbers, text and None alone."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return finite(value.item() if isinstance(value, np.generic) else value)


# Results as labelled arrays: the dimensions of xarray are repeat, time (or pose), channel, parameter, joint.


Variables = dict[str, Any]
"""Of a dataset: (dimensions, values, attributes) by name."""


def dataset(result: Any) -> xr.Dataset:
    """The arrays of a result as a dataset of xarray.

    Raises InputError for a result without dimensions, and where xarray is not installed.
    """
    try:
        import xarray as xr
    except ModuleNotFoundError as error:
        raise missing_package(error) or error from None
    result = result.fit if isinstance(result, ComparedFit) else result
    for kind, arrays in ARRAYS.items():
        if isinstance(result, kind):
            variables, coordinates = arrays(result)
            return xr.Dataset(variables, coords=coordinates, attrs={"result": type(result).__name__})
    names = ", ".join(kind.__name__ for kind in ARRAYS)
    remedy = f"use to_frame(); {names} have dimensions"
    raise InputError(what=f"{kind_of(result)} has no dimensions", where="to_xarray", remedy=remedy)


Arrays = tuple[Variables, Variables]


def _of_recording(recording: Recording) -> Arrays:
    """Wrench (repeat, time, channel), and every other column (repeat, time)."""
    dims, coordinates = _samples(recording)
    variables: Variables = {"wrench": ((*dims, "channel"), _by_repeat(recording, recording.wrench))}
    for name, column in recording.columns.items():
        variables[name] = (dims, _by_repeat(recording, np.asarray(column)))
    return variables, coordinates | _channels(recording)


def _of_comparison(comparison: Comparison) -> Arrays:
    """Measured, predicted and residual (repeat, time, channel); noise floor and RMS (channel)."""
    recording = comparison.recording
    dims, coordinates = _samples(recording)
    series = {
        "measured": recording.wrench,
        "predicted": recording.wrench - comparison.residual,
        "residual": comparison.residual,
    }
    variables: Variables = {n: ((*dims, "channel"), _by_repeat(recording, y)) for n, y in series.items()}
    sizes: dict[str, Mapping[str, float] | None] = {
        "noise_floor": comparison.noise_floor,
        "rms": comparison.rms,
        "systematic_rms": comparison.explainable_rms,
    }
    variables |= {n: ("channel", [v[c] for c in recording.channels]) for n, v in sizes.items() if v is not None}
    return variables, coordinates | _channels(recording)


def _of_fit(fit: Fit) -> Arrays:
    """The comparison with the first recording, and the parameters."""
    variables, coordinates = _of_comparison(comparison_of(fit, 0))
    parameters, names = _of_estimates(fit)
    return variables | parameters, coordinates | names


def _of_estimates(fitted: Estimates | ModelFile) -> Arrays:
    """Value and std (parameter), covariance (parameter, other)."""
    return _parameters(fitted.parameters, fitted.covariance)


def _parameters(estimates: Mapping[str, Estimate], covariance: Array) -> Arrays:
    names = list(estimates)
    variables: Variables = {
        "value": ("parameter", [e.value for e in estimates.values()]),
        "std": ("parameter", [e.std for e in estimates.values()]),
        "covariance": (("parameter", "other"), covariance),
    }
    units = [e.unit for e in estimates.values()]
    return variables, {"parameter": names, "other": names, "parameter_unit": ("parameter", units)}


def _of_contact(contact: ContactWrench) -> Arrays:
    """Contact wrench and its std (repeat, time, component), force at the tip (repeat, time)."""
    recording = contact.recording
    dims, coordinates = _samples(recording)
    variables: Variables = {
        "wrench": ((*dims, "component"), _by_repeat(recording, contact.wrench)),
        "std": ((*dims, "component"), _by_repeat(recording, contact.std)),
        "magnitude": (dims, _by_repeat(recording, contact.magnitude), {"units": "N"}),
        "magnitude_std": (dims, _by_repeat(recording, contact.magnitude_std), {"units": "N"}),
    }
    units = list(contact.space.units)
    return variables, coordinates | {"component": list(contact.names), "component_unit": ("component", units)}


def _of_trajectory(plan: ExcitingTrajectory) -> Arrays:
    """Position, velocity and acceleration (time, joint); information of each sample, and by parameter."""
    time = plan.motion.series.instants(plan.samples)
    names = ("position", "velocity", "acceleration")
    variables: Variables = {n: (("time", "joint"), plan.motion.derivative(time, i)) for i, n in enumerate(names)}
    information = plan.sample_information
    variables["information"] = ("time", information.total)
    variables["information_share"] = (("time", "parameter"), information.by_parameter)
    joints = list(numbered_names("q", plan.motion.series.joints))
    seconds = ("time", time, {"units": "s"})
    return variables, {"time": seconds, "joint": joints, "parameter": list(information.names)}


def _samples(recording: Recording) -> tuple[tuple[str, str], Variables]:
    """Dimensions and coordinates of the samples: repeat, and time in it (s) or number of the pose from 0."""
    count = np.arange(recording.samples_per_repeat)
    repeats: Variables = {"repeat": np.arange(recording.repeats)}
    if recording.at_rest:
        return ("repeat", "pose"), repeats | {"pose": count}
    return ("repeat", "time"), repeats | {"time": ("time", count * sample_step(recording), {"units": "s"})}


def _channels(recording: Recording) -> Variables:
    units = ["N" if channel.startswith("f") else "N m" for channel in recording.channels]
    return {"channel": list(recording.channels), "channel_unit": ("channel", units)}


def _by_repeat(recording: Recording, series: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(series.reshape(recording.repeats, recording.samples_per_repeat, *series.shape[1:]))


ARRAYS: dict[type, Callable[[Any], Arrays]] = {
    Recording: _of_recording,
    Comparison: _of_comparison,
    Location: lambda location: _of_comparison(location.comparison),
    Fit: _of_fit,
    Diagnosis: lambda diagnosis: _of_fit(diagnosis.fit),
    Study: lambda study: _of_fit(study.fit),
    Estimates: _of_estimates,
    ModelFile: _of_estimates,
    ContactWrench: _of_contact,
    ExcitingTrajectory: _of_trajectory,
}
"""Of each kind of result its variables and coordinates."""


def plot(
    result: Any,
    kind: str | None = None,
    *,
    channel: str | None = None,
    backend: str = "matplotlib",
    ax: Any = None,
) -> Any:
    """The result as a figure of matplotlib, or of Bokeh."""
    from truewrench.plots.result_figure import result_figure  # loads matplotlib

    return result_figure(result, kind=kind, channel=channel, backend=backend, ax=ax)


def picture(result: Any) -> str:
    """The figure of a result as HTML, empty where it has none."""
    from truewrench.plots.result_figure import figure_html  # loads matplotlib

    return figure_html(result)


def show(study: Study, height: int) -> ShownStudy:
    """The study in the page of the workbench."""
    try:
        from truewrench.workbench.notebook import ShownStudy  # loads Bokeh
    except ModuleNotFoundError as error:
        raise missing_package(error) or error from None
    return ShownStudy(study, height)


def summary(result: Any) -> str:
    """The result as text: of a fit whether the model fits, of a diagnosis the verdict with its evidence."""
    if isinstance(result, Diagnosis):
        from truewrench.text.diagnosis_text import diagnosis_text

        return diagnosis_text(result)
    if isinstance(result, Fit):
        from truewrench.text.fit_summary import FitSummary

        return FitSummary(result, result.intervals()).text(None)
    return str(result)
