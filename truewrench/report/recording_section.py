"""Recording section: what one recording shows, in pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.diagnosis import Diagnosis
from diagnosis.maps import ResidualMap, residual_maps
from estimation.recording import Recording
from truewrench.plots.image import Image, image_of
from truewrench.plots.map_plot import map_figure
from truewrench.plots.number import figures
from truewrench.plots.passing_plot import passing, passing_figure, spread_of_means
from truewrench.plots.series_plot import series_figure
from truewrench.plots.side import Side
from truewrench.plots.spectrum_plot import spectrum_figure
from truewrench.report.sides import sides_of

VARIABLES = 6
"""Variables that a channel is mapped against: those that explain most of its residual."""


@dataclass(frozen=True)
class RecordingSection:
    """What one recording shows; `own` are sentences on what it alone has, such as a drift."""

    name: str
    facts: str
    fitted: bool
    repeats: bool
    series: tuple[Image, ...]
    passing: Image | None = None
    maps: tuple[Image, ...] = ()
    spectrum: Image | None = None
    own: tuple[str, ...] = ()


def trained_sections(diagnosis: Diagnosis) -> list[RecordingSection]:
    """A section for each fitted recording."""
    return [trained_section(diagnosis, i) for i in range(len(diagnosis.steps[0].training))]


def trained_section(diagnosis: Diagnosis, number: int) -> RecordingSection:
    """Series, maps and spectrum of one fitted recording."""
    sides = sides_of(diagnosis, number)
    recording = sides[0].recording
    series, maps = _series_images(sides), _map_images(sides, diagnosis.tolerance)
    if recording.at_rest:
        return RecordingSection(recording.name, facts(recording), True, recording.repeats > 1, series, maps=maps)
    spectrum = image_of(spectrum_figure(sides), "Amplitude spectrum of what is left, per channel.")
    return RecordingSection(
        name=recording.name,
        facts=facts(recording),
        fitted=True,
        repeats=recording.repeats > 1,
        series=series,
        maps=maps,
        spectrum=spectrum,
        passing=_passing_image(sides) if recording.repeats > 1 and recording.continuous else None,
    )


def _passing_image(sides: Sequence[Side]) -> Image:
    """What does not repeat; of the last model alone where no added effect changes it."""
    first, last = passing(sides[0])[1], passing(sides[-1])[1]
    alike = np.all(np.abs(first - last).max(axis=0) < 0.2 * spread_of_means(sides[0]))
    return image_of(passing_figure(sides[-1:] if alike else sides), "What does not repeat, over the whole record.")


def held_out_sections(diagnosis: Diagnosis) -> list[RecordingSection]:
    """A section for each recording that was never fitted, with what it has of its own."""
    return [_held_out_section(diagnosis, i) for i in range(len(diagnosis.steps[0].validation))]


def _held_out_section(diagnosis: Diagnosis, number: int) -> RecordingSection:
    sides = sides_of(diagnosis, number, held_out=True)
    recording = sides[0].recording
    return RecordingSection(
        name=recording.name,
        facts=facts(recording),
        fitted=False,
        repeats=recording.repeats > 1,
        series=_series_images(sides),
        own=tuple(str(o) for o in diagnosis.own if o.recording is recording),
    )


def _series_images(sides: Sequence[Side]) -> tuple[Image, ...]:
    return tuple(
        image_of(series_figure(sides, i), f"{c}: measured and predicted, and below it what is left.")
        for i, c in enumerate(sides[0].recording.channels)
    )


def _map_images(sides: Sequence[Side], tolerance: Mapping[str, float]) -> tuple[Image, ...]:
    """For each channel the variables that explain most of what the first model leaves, for both models."""
    maps = [residual_maps(s.comparison, tolerance) for s in sides]
    images = []
    for channel in sides[0].recording.channels:
        told = [m.variable for m in maps[0] if m.channel == channel][:VARIABLES]
        chosen = [[_map_of(found, channel, v) for v in told] for found in maps]
        figure = map_figure([(s.label, row) for s, row in zip(sides, chosen, strict=True)])
        striking = sum(int(m.striking.sum()) for m in chosen[0])
        images.append(image_of(figure, f"{channel} against {', '.join(told)}: {striking} striking cells at first."))
    return tuple(images)


def _map_of(maps: Sequence[ResidualMap], channel: str, variable: str) -> ResidualMap:
    return next(m for m in maps if m.channel == channel and m.variable == variable)


def facts(recording: Recording) -> str:
    """Length, repeats and rate of a recording, in words."""
    once = recording.samples_per_repeat
    if recording.at_rest or recording.dt is None:
        poses = f"{once} poses at rest"
        return poses if recording.repeats == 1 else f"{poses}, {recording.repeats} times"
    rate, span = figures(1 / recording.dt), figures(once * recording.dt)
    if recording.repeats == 1:
        return f"a single run of {recording.samples} samples, {span} s at {rate} Hz"
    kind = "without pause" if recording.continuous else "as separate runs"
    return f"{recording.repeats} repeats {kind}, {once} samples each, {span} s at {rate} Hz"
