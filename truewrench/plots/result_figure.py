"""The figure of a result: what `result.plot()` draws, by the kind of result and the kind of figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from design.exciting_trajectory import ExcitingTrajectory
from diagnosis.comparison.compared_step import ComparedFit
from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.model_comparison import ModelComparison, compare
from diagnosis.comparison.residual_map import residual_maps
from diagnosis.diagnosis import Diagnosis
from diagnosis.screening.suspects import Suspects
from diagnosis.study import Location, Stairs, Study
from estimation.confidence_intervals import Intervals
from estimation.contact.contact_wrench import ContactWrench
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimates
from estimation.recordings.reading_report import ReadingReport
from estimation.recordings.recording import Recording
from estimation.robust_fit import RobustFit
from modeling.errors import InputError, kind_of, quoted, suggestion
from modeling.significance import LEVELS
from modeling.table import Table, Tabular
from truewrench.files.model_file import ModelFile
from truewrench.plots.chart import Chart
from truewrench.plots.contact_plot import LabelledContact, contact_chart
from truewrench.plots.interactive_figure import InteractiveFigure, drawing
from truewrench.plots.motion_plot import fit_motion_chart, recording_chart, trajectory_motion_chart
from truewrench.plots.parameters_plot import (
    LabelledParameters,
    correlation_chart,
    error_reduction_chart,
    parameters_chart,
    suspects_chart,
    table_chart,
)
from truewrench.plots.residual_plots import residual_map_chart, residual_spectrum_chart
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MISFIT_COLOUR
from truewrench.plots.svg_image import Drawing
from truewrench.plots.time_series_plot import LabelledComparison, measured_chart, time_series_chart, worst_channel
from truewrench.text.diagnosis_text import step_names

MAX_MAPS = 4
"""Residual maps side by side."""
COLOURS = (MISFIT_COLOUR, ADEQUATE_COLOUR, HELD_OUT)
"""Of models side by side, over again after the last."""

Draw = Callable[[Any, str | None], Any]
"""What a kind of figure shows of a result, for a channel or None: a chart; a figure that matplotlib alone draws."""


def result_figure(
    result: Any,
    *,
    kind: str | None = None,
    channel: str | None = None,
    backend: str = "matplotlib",
    ax: Any = None,
) -> Any:
    """The figure of a result; `channel` for those of one channel, by default the worst.

    Of matplotlib, else an `InteractiveFigure`, whatever other name `backend` is.

    Raises InputError for a result without a figure, a kind, channel or axes that it has not, and without Bokeh.
    """
    if backend == "matplotlib" and ax is None:
        shown = _shown(result)
        return _drawn(_chosen(_figures(shown), kind)(shown, channel))
    chart = result_chart(result, kind=kind, channel=channel)
    if backend != "matplotlib":
        if ax is not None:
            remedy = 'leave ax out, or backend="matplotlib"'
            raise InputError(what="an interactive figure has no axes of matplotlib", where="plot", remedy=remedy)
        drawing()  # or say what is missing
        return InteractiveFigure(chart)
    from truewrench.plots.matplotlib_chart import draw_on

    return draw_on(ax, chart)


def figure_html(result: Any) -> str:
    """The figure of a result as an image in HTML, on white paper whatever the page's; empty where it has none."""
    if not isinstance(_shown(result), tuple(FIGURES)):
        return ""
    try:
        image = Drawing.of(result_figure(result))
    except InputError:  # of this one there is nothing to draw
        return ""
    style = f"width: {image.width}px; max-width: 100%; background: #fff"
    return f'<p><img src="{escape(image.source)}" alt="{type(result).__name__}" style="{style}"/></p>'


def result_chart(result: Any, *, kind: str | None = None, channel: str | None = None) -> Chart:
    """What a figure of a result shows, whoever draws it.

    Raises InputError as `result_figure`, and for a kind that matplotlib alone draws.
    """
    shown = _shown(result)
    charts = {name: draw for name, draw in _figures(shown).items() if name not in PAGES}
    if kind in PAGES:
        remedy = f"leave backend and ax out, or draw {' or '.join(charts)}"
        raise InputError(what=f"{kind} is a page of matplotlib's own", where="plot", remedy=remedy)
    chart: Chart = _chosen(charts, kind)(shown, channel)
    return chart


def _shown(result: Any) -> Any:
    """The result; of a step its fit."""
    return result.fit if isinstance(result, ComparedFit) else result


def _drawn(drawing: Any) -> Any:
    from truewrench.plots.matplotlib_chart import matplotlib_figure

    return matplotlib_figure(drawing) if isinstance(drawing, Chart) else drawing


def _figures(result: Any) -> Mapping[str, Draw]:
    """The kinds of figures of a result, the default first: its own, or those of its table."""
    for kind_of_result, figures in FIGURES.items():
        if isinstance(result, kind_of_result):
            return figures
    if isinstance(result, Tabular | Table):
        return {"table": lambda shown, _: table_chart(shown if isinstance(shown, Table) else shown.table)}
    remedy = f"plot one of {', '.join(kind_of_result.__name__ for kind_of_result in FIGURES)}"
    raise InputError(what=f"{kind_of(result)} has no figure", where="plot", remedy=remedy)


def _chosen(figures: Mapping[str, Draw], kind: str | None) -> Draw:
    if kind is None:
        return next(iter(figures.values()))
    if kind not in figures:
        raise InputError(what=f"no kind of figure is {quoted(kind)}", where="plot", remedy=suggestion(kind, figures))
    return figures[kind]


# ---------------------------------------------------------------------------- comparisons side by side


def _sides(result: Fit | Comparison | Location | ModelComparison | Diagnosis | Study) -> list[LabelledComparison]:
    """What is drawn side by side: models on the first recording."""
    if isinstance(result, Location):
        result = result.comparison
    if isinstance(result, Fit | Comparison):
        comparison = compare(result) if isinstance(result, Fit) else result
        adequate = comparison.lack_of_fit >= LEVELS.effect
        return [
            LabelledComparison(comparison.recording.name, ADEQUATE_COLOUR if adequate else MISFIT_COLOUR, comparison)
        ]
    if isinstance(result, ModelComparison):
        named = [(model.name, model.predictions[0].comparison) for model in result.models]
    elif isinstance(result, Study):
        named = [(step.label, step.training[0]) for step in _ends(result.steps)]
    else:
        steps = list(zip(step_names(result), result.steps, strict=True))
        named = [(name, step.training[0]) for name, step in _ends(steps)]
    colours = [COLOURS[i % len(COLOURS)] for i in range(len(named))]
    return [LabelledComparison(name, colour, c) for (name, c), colour in zip(named, colours, strict=True)]


def _ends(steps: Sequence[Any]) -> list[Any]:
    """The first and the last of several steps."""
    return [steps[0], steps[-1]] if len(steps) > 1 else [steps[0]]


def _channel(sides: Sequence[LabelledComparison], channel: str | None) -> int:
    channels = sides[0].recording.channels
    if channel is None:
        return worst_channel(sides[0])[1]
    if channel not in channels:
        raise InputError(what=f"no channel is {quoted(channel)}", where="plot", remedy=suggestion(channel, channels))
    return channels.index(channel)


def _residual(result: Any, channel: str | None) -> Chart:
    sides = _sides(result)
    return time_series_chart(sides, _channel(sides, channel))


def _measured(result: Any, channel: str | None) -> Chart:
    sides = _sides(result)
    return measured_chart(sides, _channel(sides, channel))


def _spectrum(result: Any, channel: str | None) -> Chart:
    sides = _sides(result)
    if sides[0].recording.at_rest:
        remedy = 'use kind="residual"'
        raise InputError(what="static poses have no spectrum", where="plot", remedy=remedy)
    return residual_spectrum_chart(sides, None if channel is None else _channel(sides, channel))


def _map(result: Any, channel: str | None) -> Chart:
    """Residual maps of a channel against the variables that explain most of the first model's residual."""
    sides = _sides(result)
    name = sides[0].recording.channels[_channel(sides, channel)]
    tolerance = {c: floor / 10 for c, floor in sides[0].comparison.noise_floor.items()}
    maps = [[m for m in residual_maps(s.comparison, tolerance) if m.channel == name] for s in sides]
    common = [m.variable for m in maps[0] if all(m.variable in {o.variable for o in other} for other in maps)]
    if not common:
        remedy = 'use kind="residual"'
        raise InputError(what="no variable is visited often enough for a map", where="plot", remedy=remedy)
    rows = [[next(m for m in maps_of_side if m.variable == v) for v in common[:MAX_MAPS]] for maps_of_side in maps]
    return residual_map_chart([(side.label, row) for side, row in zip(sides, rows, strict=True)])


def _stairs(result: Study | Stairs | Diagnosis, channel: str | None) -> Chart:
    names = step_names(result) if isinstance(result, Diagnosis) else [step.change for step in result.steps]
    first = result.steps[0].training[0].recording
    if channel is not None and channel not in first.channels:
        remedy = suggestion(channel, first.channels)
        raise InputError(what=f"no channel is {quoted(channel)}", where="plot", remedy=remedy)
    return error_reduction_chart(result.steps, names, result.tolerance, channel)


# ---------------------------------------------------------------------------------------- parameters


def _parameters(result: Any, _channel: str | None) -> Chart:
    """Before and after, where there is a before."""
    return parameters_chart(_labelled_parameters(result))


def _labelled_parameters(result: Any) -> list[LabelledParameters]:
    if isinstance(result, Study):
        return [LabelledParameters.known(step.label, step.fit) for step in _ends(result.steps)]
    if isinstance(result, Diagnosis):
        steps = list(zip(step_names(result), result.steps, strict=True))
        return [LabelledParameters.known(name, step.fit) for name, step in _ends(steps)]
    if isinstance(result, ModelComparison):
        return [LabelledParameters.known(m.name, m.estimated) for m in result.models]
    if isinstance(result, RobustFit):
        robust = LabelledParameters.of("robust", result.intervals())
        return [LabelledParameters.known("least squares", result.plain), robust]
    if isinstance(result, Intervals):
        return [LabelledParameters.of("fit", result)]
    return [LabelledParameters.known("fit", result)]


def _correlation(result: Any, _channel: str | None) -> Chart:
    return correlation_chart(result.fit if isinstance(result, Diagnosis | Study | RobustFit) else result)


def _motion(result: Any, _channel: str | None) -> Chart:
    return fit_motion_chart(result.fit if isinstance(result, Diagnosis | Study) else result)


# ------------------------------------------------------------------------------------------- others


def _contact(contact: ContactWrench, channel: str | None) -> Chart:
    return contact_chart([LabelledContact("contact", ADEQUATE_COLOUR, contact)], component=channel)


def _trajectory(plan: ExcitingTrajectory, _channel: str | None) -> Any:
    from truewrench.plots.trajectory_plot import trajectory_figure

    task = plan.task
    return trajectory_figure(
        plan.motion,
        task.limits,
        arm=task.arm,
        tip_length=task.tip_length,
        workspace=task.workspace,
        information=plan.sample_information,
    )


def _reading(report: ReadingReport, _channel: str | None) -> Any:
    from truewrench.plots.reading_plot import plot_reading

    return plot_reading(report)


PAGES = ("trajectory", "reading")
"""Kinds that are a page of their own, drawn by matplotlib alone."""
RESIDUALS: dict[str, Draw] = {"residual": _residual, "measured": _measured, "map": _map, "spectrum": _spectrum}
PARAMETERS: dict[str, Draw] = {"parameters": _parameters, "correlation": _correlation}
FIGURES: dict[type, dict[str, Draw]] = {
    Fit: {**RESIDUALS, **PARAMETERS, "motion": _motion},
    Comparison: RESIDUALS,
    Location: {"map": _map, **RESIDUALS},
    ModelComparison: {**RESIDUALS, "parameters": _parameters},
    Diagnosis: {"stairs": _stairs, **RESIDUALS, **PARAMETERS, "motion": _motion},
    Stairs: {"stairs": _stairs},
    Study: {"stairs": _stairs, **RESIDUALS, **PARAMETERS, "motion": _motion},
    RobustFit: PARAMETERS,
    Estimates: PARAMETERS,
    ModelFile: PARAMETERS,
    Intervals: {"parameters": _parameters},
    Suspects: {"suspects": lambda found, _: suspects_chart(found)},
    ContactWrench: {"contact": _contact},
    Recording: {"recording": lambda found, _: recording_chart(found)},
    ExcitingTrajectory: {"trajectory": _trajectory, "motion": lambda plan, _: trajectory_motion_chart(plan)},
    ReadingReport: {"reading": _reading, "table": lambda report, _: table_chart(report.table)},
}
"""Of each kind of result its kinds of figures, the default first."""
