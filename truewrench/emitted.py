"""What `emit` writes of a model: code, the tool for robots and controllers, or the sensor's calibration for drivers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.monitor import RATE_TOLERANCE, Monitor
from modeling.chain.model import WrenchModel
from modeling.chain.sensor_axes import Axes, is_turned, sensor_to_pose, turn_words
from modeling.codegen.code_target import CALIBRATIONS, FORMATS, CodeTarget, code_target, payload_format, target_names
from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor
from modeling.codegen.sensor_matrix import SensorMatrix, csv_table, ros_parameters
from modeling.codegen.template import CTarget
from modeling.codegen.tool_inertia import ToolInertia
from modeling.compiled.straight_line_program import OperationCount, StraightLineProgram
from modeling.errors import InputError, quoted, suggestion
from modeling.number_format import as_sentence
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.files.case_files import MEANINGS
from truewrench.files.makers_sheet import MakersSheet, SheetComparison
from truewrench.files.model_file import ModelFile, as_model_file

if TYPE_CHECKING:
    from modeling.table import Table
    from truewrench.files.model_file import Fitted

Array = NDArray[np.float64]

BASES = ("planar", "spatial")
BIASED = "its values are biased by what it lacks, and their standard deviations are too small"
"""What follows for whoever uses the values of a model that does not fit."""

DIFFERENT_TURN = 0.1
"""rad, 6°, by which a stated turn of the sensor differs from the decided one, so that it is no error of mounting."""


@dataclass(frozen=True)
class Emitted:
    """A text, and the operations per sample where it is code.

    beside   of a calibration the matrix beside the maker's, where there is a sheet, else the matrix itself
    frames   the frame and the sign convention of what was written, a sentence; empty of a base model
    warning  that the model did not fit its recordings, or that these were mended; empty where neither is known
    """

    text: str
    operations: Table | None
    frames: str = ""
    warning: str = ""
    beside: SensorMatrix | SheetComparison | None = None


def emit(
    model: Fitted | str | Path,
    to: str,
    *,
    rate: float | None = None,
    sensor_pose: Sequence[float] | None = None,
    monitor: Monitor | None = None,
    sheet: str | Path | None = None,
) -> str:
    """Write a model as code, or its tool as robot descriptions and controllers take it.

    Parameters
    ----------
    model : Fit, StreamedFit, ModelFile, Study, Diagnosis, str or Path
        A fit, or a study or a diagnosis, whose last fit it is; a model file or its path; or a base model: "planar",
        "spatial".
    to : str
        Code: "numpy", "casadi", "c", "latex". The tool: "urdf", "sdf", "mjcf", "ur", "franka", "ros2". The sensor:
        "calibration" (YAML), "calibration_csv", "calibration_ati" (the `sheet`, corrected).
    rate : float, optional
        Sampling rate of the code in Hz; needed for a model with memory.
    sensor_pose : sequence of float, optional
        Pose of the sensor frame in the frame of the robot's description or controller (a flange): x, y, z in m, roll,
        pitch, yaw in rad about the fixed axes x, y, z; by default the tool is written in the sensor frame, and of a
        sensor that is turned against the logged pose along the axes of that pose.
    monitor : Monitor, optional
        A monitor of this model, which the code in C then has beside it.
    sheet : str or Path, optional
        What the maker states of the sensor, a CSV or a calibration file of ATI, for "calibration_ati".

    Returns
    -------
    str
        The text of the file: of a tool mass (kg), centre of mass (m) and inertia about it (kg m²), along the axes of
        that frame.

    Raises
    ------
    InputError
        For an unknown name in `to`, a tool that no distribution of mass has or that is not identifiable, a planar tool
        in a format of space, a monitor of another model or in another language, and as from the code targets.

    Examples
    --------
    >>> import truewrench as tw
    >>> code = tw.emit("planar", "numpy")
    >>> "def regressor(ax, ay, phi, dphi, ddphi)" in code
    True
    """
    return emitted(model, to, rate=rate, sensor_pose=sensor_pose, monitor=monitor, sheet=sheet).text


def emitted(
    model: Fitted | str | Path,
    to: str,
    *,
    rate: float | None = None,
    sensor_pose: Sequence[float] | None = None,
    monitor: Monitor | None = None,
    sheet: str | Path | None = None,
) -> Emitted:
    """`emit`, with the operation counts of code."""
    if monitor is not None:
        require_monitored(model, to)
    if to in CALIBRATIONS and sensor_pose is None:
        return _calibration(model, to, sheet)
    if sheet is not None:
        remedy = f"emit the sensor: {', '.join(CALIBRATIONS)}"
        raise InputError(what=f"{quoted(to)} has nothing of the sensor's sheet", where="sheet", remedy=remedy)
    if to in FORMATS:
        return _tool(model, to, sensor_pose)
    if to not in (*target_names(), *CALIBRATIONS):
        remedy = suggestion(to, (*target_names(), *FORMATS, *CALIBRATIONS))
        raise InputError(what=f"'{to[:40]}' is no language or format", where="to", remedy=remedy)
    if sensor_pose is not None:
        remedy = f"leave it out, or emit the tool: {', '.join(FORMATS)}"
        raise InputError(what="code and calibration have no frame but the sensor's", where="sensor pose", remedy=remedy)
    return _code(model, to, rate, monitor)


def require_monitored(model: Fitted | str | Path, to: str) -> None:
    """InputError unless a monitor can be written beside the model in that language."""
    if to != CTarget.name or str(model) in BASES:
        what = "a base model has no monitor" if to == CTarget.name else f"a monitor is not written as {to[:40]}"
        raise InputError(what=what, where="monitor", remedy="give a fitted model, and --to c")


UNKNOWN = "NOT KNOWN: the readings do not say what it weighs, and the standard deviations are those of noise alone"


def _source(*, weighed: bool = True) -> str:
    """What made it, and of a tool not weighed that it was not: no text of a file, which would be code there."""
    from importlib.metadata import version

    return f"truewrench {version('truewrench')}" + ("" if weighed else f" ({UNKNOWN})")


def sensor_matrix(model: Fitted | str | Path) -> SensorMatrix:
    """The calibration of a sensor: the matrix from true wrench to reading, its inverse, and their covariance.

    Parameters
    ----------
    model : Fit, StreamedFit, ModelFile, Study, Diagnosis, str or Path
        A fitted model that has the gains of the channels or crosstalk, or its file.

    Returns
    -------
    SensorMatrix
        `matrix`, `correction` and `zero` in the axes and signs of the readings, N and N m, `std` and `covariance_of`
        of their elements, with the budget of the model where it has one; `corrected(readings)` are wrenches.

    Raises
    ------
    InputError
        For a model without gain and crosstalk, and for gains whose scale the recordings do not tell.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + "sensor_gain", tw.read("train.csv", rig=rig))
    >>> tw.sensor_matrix(fit).scale_determined
    False
    """
    saved = _fitted_file(model)
    size = len(saved.theta)
    covariance = saved.covariance if saved.budget is None else saved.budget.calibration.covariance[:size, :size]
    return SensorMatrix.of(saved.model, saved.theta, covariance)


def _calibration(model: Fitted | str | Path, to: str, sheet: str | Path | None) -> Emitted:
    """The sensor's calibration as a file; InputError as `sensor_matrix`, and for a bad or missing sheet."""
    saved = _fitted_file(model)
    spread = "std of noise alone" if saved.budget is None else "std with the contributions of the budget"
    sensor, source = sensor_matrix(saved), f"{_source()}, {spread}"
    stated = None if saved.rig is None or saved.rig.sensor is None else saved.rig.sensor.range
    makers = None if sheet is None else MakersSheet.read(sheet, sensor.channels, stated)
    file = None if makers is None else makers.file
    if to != "calibration_ati":
        text = csv_table(sensor, source) if to == "calibration_csv" else ros_parameters(sensor, source)
    elif file is not None:
        remarks = [f"corrected by {_source()}: the maker does not vouch for this matrix", *sensor.remarks()[1:]]
        text = file.corrected(sensor.correction, "; ".join(remarks))
    else:
        remedy = "give the maker's calibration file by --sheet, or emit calibration"
        raise InputError(what="it is the maker's file with the correction, and none is given", where=to, remedy=remedy)
    warning = "; ".join(filter(None, (saved.misfit_warning(BIASED), saved.mending_warning, saved.doubt_warning)))
    return Emitted(
        text, None, as_sentence(spread), warning, sensor if makers is None else SheetComparison(sensor, makers)
    )


def _fitted_file(model: Fitted | str | Path) -> ModelFile:
    """What a model file holds of it; InputError for a base model."""
    if str(model) in BASES:
        remedy = "give a fit or a model file: `truewrench fit --out model.json`"
        raise InputError(what="a base model has no values", where=str(model), remedy=remedy)
    return _model_file(model)


def _tool(model: Fitted | str | Path, to: str, sensor_pose: Sequence[float] | None) -> Emitted:
    saved = _fitted_file(model)
    calibration = saved.calibration
    fitted, along = (calibration.model, calibration.theta), Axes.POSE if sensor_pose is None else Axes.SENSOR
    tool = ToolInertia.of(*fitted, calibration.covariance, _sensor_link(saved), along)
    frame = [f"Written in the {tool.frame}."]
    if sensor_pose is not None:
        tool = tool.seen_from(sensor_pose)
        frame = [f"Written in the {tool.frame}.", _other_turn(*fitted, sensor_pose)]
    said = " ".join(
        filter(None, [*frame, as_sentence(tool.turn), _convention_sentence(saved), as_sentence(tool.left_out)])
    )
    warning = "; ".join(filter(None, (saved.misfit_warning(BIASED), saved.doubt_warning)))
    return Emitted(payload_format(to).text(tool, _source(weighed=not saved.tool_unknown)), None, said, warning)


def _other_turn(model: WrenchModel, theta: Array, pose: Sequence[float]) -> str:
    """That a stated pose turns a sensor otherwise than the model has it against the logged pose; empty if it does not.

    Then the frame has other axes than the logged pose, or the pose was stated by mistake.
    """
    stated, fitted = Rotation.from_euler("xyz", pose[3:]), sensor_to_pose(model, theta)
    apart = (stated * Rotation.from_matrix(fitted).inv()).magnitude()
    if not is_turned(model) or apart < DIFFERENT_TURN:
        return ""
    return (
        f"The pose stated turns the sensor by {turn_words(stated.as_matrix())}, and the recordings by"
        f" {turn_words(fitted)} against the logged pose: right only if that frame has other axes than the logged pose."
    )


def _sensor_link(saved: ModelFile) -> str:
    """The link of the URDF whose frame is the sensor's; empty for a rig without one."""
    return "" if saved.rig is None or saved.rig.urdf is None else saved.rig.sensor_frame or ""


def _convention_sentence(saved: ModelFile) -> str:
    return f"The readings that it was identified from are {MEANINGS[saved.model.convention]}."


def _code(model: Fitted | str | Path, to: str, rate: float | None, monitor: Monitor | None) -> Emitted:
    target = code_target(to)
    if str(model) in BASES:
        space = Space.PLANE if str(model) == "planar" else Space.SPACE
        code = GeneratedCode.of_base(RigidToolRegressor(space), target, _source())
        return Emitted(code.text, code.table)
    saved = _model_file(model)
    calibration = saved.calibration
    fitted = FittedModel.of(calibration.model, calibration.theta, None if rate is None else 1 / rate)
    if monitor is not None:
        fitted, target = _watched(monitor, fitted), CTarget(monitor.program)
    code = GeneratedCode.of_fitted(fitted, target, _source())
    link = _sensor_link(saved)
    said = f"Wrench in the sensor frame{f', link {link}' if link else ''}. {_convention_sentence(saved)}"
    warning = "; ".join(filter(None, (saved.misfit_warning(BIASED), saved.mending_warning, saved.doubt_warning)))
    return Emitted(code.text, code.table, said, warning)


def _watched(monitor: Monitor, fitted: FittedModel) -> FittedModel:
    """The model that a monitor watches; InputError where it is another one, or at another rate."""
    watched = monitor.program.fitted
    if fitted.model != watched.model or not np.array_equal(fitted.theta, watched.theta):
        raise InputError(
            what="it watches another model", where="monitor", remedy="make it of the model that is emitted"
        )
    if fitted.dt is not None and abs(monitor.dt / fitted.dt - 1) > RATE_TOLERANCE:
        what = f"its noise is that of {1 / monitor.dt:.6g} samples a second, and the code is for {1 / fitted.dt:.6g}"
        raise InputError(what=what, where="monitor", remedy="give a recording of that rate, or leave --rate out")
    return watched


def _model_file(model: Fitted | str | Path) -> ModelFile:
    """What a model file holds, of a fit, of what has one, or of the file."""
    if not isinstance(model, (str, Path)):
        return as_model_file(model, "emit")
    if not Path(model).is_file():
        remedy = "give planar, spatial, or the path of a model file"
        raise InputError(what="neither a base model nor a model file", where=str(model) or "MODEL", remedy=remedy)
    return ModelFile.read(model)


@dataclass(frozen=True)
class GeneratedCode:
    """The text, and operations per sample: by name, with common subexpressions shared and without."""

    text: str
    costs: tuple[tuple[str, OperationCount, OperationCount], ...]

    @classmethod
    def of_base(cls, base: RigidToolRegressor, target: CodeTarget, source: str) -> GeneratedCode:
        """The regressor of the rigid tool; `source` names the project and its version."""
        return cls(target.regressor(base, source), (operation_cost("regressor", base.program),))

    @classmethod
    def of_fitted(cls, fitted: FittedModel, target: CodeTarget, source: str) -> GeneratedCode:
        """Prediction, compensation and derivative of a fitted model; InputError as from `CodeTarget.model`."""
        text = target.model(fitted, source)
        if not target.sampled:
            return cls(text, (operation_cost("load and bias", fitted.reading),))
        shared, unshared = (fitted.program.operations(shared=shared) for shared in (True, False))
        derivative = fitted.sensitivity
        costs = [] if derivative is None else [operation_cost(fitted.derivative_name, derivative)]
        return cls(text, (("prediction", shared, unshared), *costs))

    @property
    def table(self) -> Table:
        """Operations per sample, with common subexpressions shared and without."""
        counts = []
        for name, shared, unshared in self.costs:
            counts += [(name, shared)] + [(f"{name}, without shared subexpressions", unshared)] * (unshared != shared)
        rows = [(name, c.total, c.sums, c.products, c.quotients, c.calls) for name, c in counts]
        numbers = (Column(name, format="d") for name in ("all", "+ -", "*", "/", "functions"))
        return Table.of(("operations per sample", *numbers), rows)


def operation_cost(name: str, program: StraightLineProgram) -> tuple[str, OperationCount, OperationCount]:
    """A program's operations under a name: shared, unshared."""
    return name, program.shared.operations, program.operations_unshared
