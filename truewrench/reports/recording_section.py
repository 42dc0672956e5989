"""Section of one recording: time series, residual maps, spectrum, non-periodic residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from diagnosis.comparison.residual_map import ResidualMap, residual_maps
from diagnosis.diagnosis import Diagnosis
from estimation.recordings.recording import Recording
from modeling.number_format import format_number
from truewrench.plots.residuals.labelled_comparison import LabelledComparison
from truewrench.plots.residuals.nonperiodic_residual_plot import (
    nonperiodic_residual,
    nonperiodic_residual_figure,
    std_of_interval_means,
)
from truewrench.plots.residuals.residual_map_plot import residual_map_figure
from truewrench.plots.residuals.residual_spectrum_plot import residual_spectrum_figure
from truewrench.plots.residuals.time_series_plot import time_series_figure
from truewrench.plots.svg_image import SvgImage
from truewrench.reports.compared_models import compared_models
from truewrench.reports.zoom.zoomable_figure import (
    ZoomableFigure,
    points_of_line,
    zoomable_series,
    zoomable_spectrum,
)

MAX_MAP_VARIABLES = 6
"""Variables of the residual maps of a channel: those that explain most of its residual."""


@dataclass(frozen=True)
class RecordingSection:
    """Figures of one recording; `disturbances` are sentences on its recording-specific disturbances.

    zoomable, zoomable_spectra   drawn at a reader's request: a figure for each of `series`, a spectrum by channel
    """

    name: str
    facts: str
    fitted: bool
    repeats: bool
    series: tuple[SvgImage, ...]
    zoomable: tuple[ZoomableFigure, ...] = ()
    zoomable_spectra: tuple[tuple[str, ZoomableFigure], ...] = ()
    nonperiodic: SvgImage | None = None
    maps: tuple[SvgImage, ...] = ()
    spectrum: SvgImage | None = None
    disturbances: tuple[str, ...] = ()


Sides = Sequence[LabelledComparison]


def line_count(recordings: Sequence[Sides]) -> int:
    """Lines of all zoomable series, which share the numbers of a report."""
    return sum(len(sides[0].recording.channels) * (2 + 2 * len(sides)) for sides in recordings)


def full_section(sides: Sides, tolerance: Mapping[str, float], points: int) -> RecordingSection:
    """Time series, residual maps and spectrum of one recording; `points` of each zoomable line."""
    recording = sides[0].recording
    periodic = recording.repeats > 1 and recording.continuous and not recording.at_rest
    alt = "Amplitude spectrum of the residual, per channel."
    return replace(
        short_section(sides, points, fitted=True),
        maps=_map_images(sides, tolerance),
        spectrum=None if recording.at_rest else SvgImage(lambda: residual_spectrum_figure(sides), alt),
        zoomable_spectra=()
        if recording.at_rest
        else tuple((name, zoomable_spectrum(sides, i)) for i, name in enumerate(recording.channels)),
        nonperiodic=_nonperiodic_residual_image(sides) if periodic else None,
    )


def short_section(sides: Sides, points: int, *, fitted: bool) -> RecordingSection:
    """Facts and time series of a recording."""
    recording = sides[0].recording
    repeats, series = recording.repeats > 1, _series_images(sides)
    zoomable = tuple(zoomable_series(sides, i, points) for i in range(len(recording.channels)))
    return RecordingSection(recording.name, recording_facts(recording), fitted, repeats, series, zoomable)


def _nonperiodic_residual_image(sides: Sequence[LabelledComparison]) -> SvgImage:
    """Non-periodic residual; of the final model alone where the effects added do not change it."""
    first, last = nonperiodic_residual(sides[0])[1], nonperiodic_residual(sides[-1])[1]
    unchanged = np.all(np.abs(first - last).max(axis=0) < 0.2 * std_of_interval_means(sides[0]))
    shown = sides[-1:] if unchanged else sides
    return SvgImage(lambda: nonperiodic_residual_figure(shown), "Non-periodic residual over the record.")


def diagnosis_sections(diagnosis: Diagnosis) -> list[RecordingSection]:
    """A section for each fitted recording, then for each validation one, with its recording-specific disturbances."""
    fitted = [compared_models(diagnosis, i) for i in range(len(diagnosis.steps[0].training))]
    held_out = [compared_models(diagnosis, i, held_out=True) for i in range(len(diagnosis.steps[0].validation))]
    points = points_of_line(line_count([*fitted, *held_out]))
    own = [tuple(str(o) for o in diagnosis.disturbances if o.recording is sides[0].recording) for sides in held_out]
    return [
        *(full_section(sides, diagnosis.tolerance, points) for sides in fitted),
        *(
            replace(short_section(sides, points, fitted=False), disturbances=disturbances)
            for sides, disturbances in zip(held_out, own, strict=True)
        ),
    ]


def _series_images(sides: Sequence[LabelledComparison]) -> tuple[SvgImage, ...]:
    return tuple(
        SvgImage(partial(time_series_figure, sides, i), f"{c}: measured and predicted; below, the residual.")
        for i, c in enumerate(sides[0].recording.channels)
    )


def _map_images(sides: Sequence[LabelledComparison], tolerance: Mapping[str, float]) -> tuple[SvgImage, ...]:
    """Residual maps of each channel against the variables that explain most of the rigid tool's residual."""
    maps = [residual_maps(s.comparison, tolerance) for s in sides]
    images = []
    for channel in sides[0].recording.channels:
        variables = [m.variable for m in maps[0] if m.channel == channel][:MAX_MAP_VARIABLES]
        chosen = [[_map_of(found, channel, v) for v in variables] for found in maps]
        labelled = [(s.label, row) for s, row in zip(sides, chosen, strict=True)]
        count = sum(int(m.practically_significant.sum()) for m in chosen[0])
        alt = f"{channel} against {', '.join(variables)}, rigid tool: {count} significant cells above tolerance."
        images.append(SvgImage(partial(residual_map_figure, labelled), alt))
    return tuple(images)


def _map_of(maps: Sequence[ResidualMap], channel: str, variable: str) -> ResidualMap:
    return next(m for m in maps if m.channel == channel and m.variable == variable)


def recording_facts(recording: Recording) -> str:
    """Length, repeats and sampling rate of a recording."""
    once = recording.samples_per_repeat
    if recording.at_rest or recording.dt is None:
        poses = f"{once} static poses"
        return poses if recording.repeats == 1 else f"{poses}, {recording.repeats} times"
    rate, span = format_number(1 / recording.dt), format_number(once * recording.dt)
    if recording.repeats == 1:
        return f"a single run of {recording.samples} samples, {span} s at {rate} Hz"
    kind = "without pause" if recording.continuous else "as separate runs"
    return f"{recording.repeats} repeats {kind}, {once} samples each, {span} s at {rate} Hz"
