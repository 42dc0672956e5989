"""The figure of a result: what `result.plot()` draws, by the kind of result and the kind of figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from design.exciting_trajectory import ExcitingTrajectory
from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.model_comparison import ModelComparison, compare
from diagnosis.comparison.residual_map import residual_maps
from diagnosis.diagnosis import Diagnosis
from diagnosis.screening.suspects import Suspects
from diagnosis.study import Study
from estimation.contact.contact_wrench import ContactWrench
from estimation.fit import Fit
from modeling.errors import InputError, quoted, suggestion
from modeling.significance import LEVELS
from truewrench.plots.contact_plot import LabelledContact, contact_figure
from truewrench.plots.error_reduction_plot import error_reduction_figure
from truewrench.plots.residuals.labelled_comparison import LabelledComparison
from truewrench.plots.residuals.residual_map_plot import residual_map_figure
from truewrench.plots.residuals.residual_spectrum_plot import residual_spectrum_figure
from truewrench.plots.residuals.time_series_plot import time_series_figure
from truewrench.plots.residuals.worst_channel_plot import worst_channel
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MISFIT_COLOUR
from truewrench.plots.suspects_plot import suspects_figure
from truewrench.plots.trajectory.trajectory_plot import trajectory_figure
from truewrench.text.step_names import step_names

MAX_MAPS = 4
"""Residual maps side by side."""
COLOURS = (MISFIT_COLOUR, ADEQUATE_COLOUR, HELD_OUT)
"""Of models side by side, over again after the last."""


def result_figure(result: Any, *, kind: str | None = None, channel: str | None = None) -> Figure:
    """The figure of a result; `channel` for those of one channel, by default the worst.

    Raises InputError for a result without a figure, and a kind or channel that it has not.
    """
    for known, figures in FIGURES.items():
        if isinstance(result, known):
            return _chosen(figures, kind)(result, channel)
    remedy = f"plot one of {', '.join(known.__name__ for known in FIGURES)}"
    raise InputError(what=f"a {type(result).__name__} has no figure", where="plot", remedy=remedy)


Draw = Callable[[Any, str | None], Figure]


def _chosen(figures: Mapping[str, Draw], kind: str | None) -> Draw:
    if kind is None:
        return next(iter(figures.values()))
    if kind not in figures:
        raise InputError(what=f"no kind of figure is {quoted(kind)}", where="plot", remedy=suggestion(kind, figures))
    return figures[kind]


# ---------------------------------------------------------------------------- comparisons side by side


def _sides(result: Fit | Comparison | ModelComparison | Diagnosis | Study) -> list[LabelledComparison]:
    """What is drawn side by side: models on the first recording."""
    if isinstance(result, Fit | Comparison):
        found = compare(result) if isinstance(result, Fit) else result
        adequate = found.lack_of_fit >= LEVELS.effect
        return [LabelledComparison(found.recording.name, ADEQUATE_COLOUR if adequate else MISFIT_COLOUR, found)]
    if isinstance(result, ModelComparison):
        named = [(model.name, model.predictions[0].comparison) for model in result.models]
    elif isinstance(result, Study):
        named = [(step.change, step.training[0]) for step in _ends(result.steps)]
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


def _residual(result: Any, channel: str | None) -> Figure:
    sides = _sides(result)
    return time_series_figure(sides, _channel(sides, channel))


def _spectrum(result: Any, _channel: str | None) -> Figure:
    return residual_spectrum_figure(_sides(result))


def _map(result: Any, channel: str | None) -> Figure:
    """Residual maps of a channel against the variables that explain most of the first model's residual."""
    sides = _sides(result)
    name = sides[0].recording.channels[_channel(sides, channel)]
    tolerance = {c: floor / 10 for c, floor in sides[0].comparison.noise_floor.items()}
    maps = [[m for m in residual_maps(s.comparison, tolerance) if m.channel == name] for s in sides]
    variables = [m.variable for m in maps[0]][:MAX_MAPS]
    rows = [[next(m for m in found if m.variable == v) for v in variables] for found in maps]
    return residual_map_figure([(side.label, row) for side, row in zip(sides, rows, strict=True)])


def _stairs(result: Study | Diagnosis, _channel: str | None) -> Figure:
    names = [step.change for step in result.steps] if isinstance(result, Study) else step_names(result)
    return error_reduction_figure(result.steps, names, result.tolerance)


def _trajectory(plan: ExcitingTrajectory, _channel: str | None) -> Figure:
    task = plan.task
    return trajectory_figure(
        plan.motion,
        task.limits,
        arm=task.arm,
        tip_length=task.tip_length,
        workspace=task.workspace,
        information=plan.sample_information,
    )


RESIDUALS: dict[str, Draw] = {"residual": _residual, "map": _map, "spectrum": _spectrum}
FIGURES: dict[type, dict[str, Draw]] = {
    Fit: RESIDUALS,
    Comparison: RESIDUALS,
    ModelComparison: RESIDUALS,
    Diagnosis: {"stairs": _stairs, **RESIDUALS},
    Study: {"stairs": _stairs, **RESIDUALS},
    Suspects: {"suspects": lambda found, _: suspects_figure(found)},
    ContactWrench: {"contact": lambda found, _: contact_figure([LabelledContact("contact", ADEQUATE_COLOUR, found)])},
    ExcitingTrajectory: {"trajectory": _trajectory},
}
"""Of each kind of result its kinds of figures, the default first."""
