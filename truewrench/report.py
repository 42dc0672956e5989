"""Report: a diagnosis as one page that shows where the model fails before it says so, and needs no network."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from diagnosis.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from diagnosis.finding import Finding
from diagnosis.maps import ResidualMap, residual_maps
from diagnosis.verdict import RecordVerdict
from estimation.fit import Estimate
from estimation.noise import NoiseSource
from estimation.recording import Recording
from modeling.rig import Convention
from modeling.space import Space
from truewrench.plots.image import Image, image_of
from truewrench.plots.map_plot import map_figure
from truewrench.plots.number import figures, labelled, percentage, probability, unit_text, with_std
from truewrench.plots.opening_plot import STANDS_OUT, loudest, opening_figure
from truewrench.plots.passing_plot import passing, passing_figure, spread_of_means
from truewrench.plots.series_plot import series_figure
from truewrench.plots.side import Side
from truewrench.plots.spectrum_plot import spectrum_figure
from truewrench.plots.staircase_plot import Flight, flights, size_of, size_text, staircase_figure, step_names
from truewrench.plots.style import FAILING, HOLDING

VARIABLES = 6
"""Variables that a channel is mapped against: those that explain most of its residual."""
SIZES = 6
"""Parameters of an effect shown at once; the rest unfolds."""

LABELS = {
    RecordVerdict.NOTHING_MISSING: "Nothing missing",
    RecordVerdict.EXPLAINED: "Explained",
    RecordVerdict.PARTLY_EXPLAINED: "Partly explained",
    RecordVerdict.UNEXPLAINED: "Unexplained",
}
SYMBOLS = {
    RecordVerdict.NOTHING_MISSING: "=",
    RecordVerdict.EXPLAINED: "✓",
    RecordVerdict.PARTLY_EXPLAINED: "◐",
    RecordVerdict.UNEXPLAINED: "?",
}
CONVENTIONS = {
    Convention.ON_TOOL: "Readings are the wrench of the sensor on the tool: F = m (a − g).",
    Convention.ON_SENSOR: "Readings are the wrench of the tool on the sensor: a hanging weight reads + m g.",
    Convention.AUTO: "The sign of the readings was left open.",
}


# ------------------------------------------------------------------------------------------ what the page is made of


@dataclass(frozen=True)
class Quantity:
    """A named number as text, with its unit."""

    name: str
    value: str
    unit: str


@dataclass(frozen=True)
class EffectRow:
    """One effect of the catalogue, as the table shows it; `share` is a width in per cent."""

    id: str
    title: str
    equation: str
    advice: str
    verdict: str
    words: str
    p_value: str
    removed: str
    share: float
    sizes: tuple[Quantity, ...]
    more_sizes: tuple[Quantity, ...]
    detectable: tuple[Quantity, ...]
    more_detectable: tuple[Quantity, ...]
    confusable_with: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class Cell:
    """An error as text: what can be explained of it, the whole, and how it stands to floor and tolerance."""

    explainable: str
    whole: str
    kind: str


@dataclass(frozen=True)
class StairRow:
    """One step of one recording, a cell for each channel."""

    name: str
    cells: tuple[Cell, ...]
    misfit: str
    lack_of_fit: str


@dataclass(frozen=True)
class StairTable:
    """All steps of one recording."""

    name: str
    fitted: bool
    floor: tuple[str, ...]
    rows: tuple[StairRow, ...]


@dataclass(frozen=True)
class RecordingSection:
    """What one recording shows."""

    name: str
    facts: str
    fitted: bool
    repeats: bool
    series: tuple[Image, ...]
    passing: Image | None = None
    maps: tuple[Image, ...] = ()
    spectrum: Image | None = None


@dataclass(frozen=True)
class Left:
    """What no effect explains, in words."""

    where: str
    looks_like: tuple[str, ...]
    share: str
    sizes: tuple[Quantity, ...]


@dataclass(frozen=True)
class Opening:
    """The verdict in words, and the picture beside it."""

    kind: str
    label: str
    symbol: str
    headline: str
    effects: tuple[EffectRow, ...]
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    warning: str
    picture: Image


# ---------------------------------------------------------------------------------------------------------- the page


def write_report(diagnosis: Diagnosis, path: str | Path) -> Path:
    """Write the diagnosis as one HTML file, beside its place first and then renamed into it; its path.

    Pictures, style and text are all inside; nothing is fetched when it is opened. Raises OSError when the
    place cannot be written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        beside.write_text(report_page(diagnosis), encoding="utf-8")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return target


def report_page(diagnosis: Diagnosis) -> str:
    """The report as HTML text. Names that users gave are escaped."""
    environment = Environment(
        loader=PackageLoader("truewrench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    rows = [effect_row(f, diagnosis.model.space) for f in diagnosis.findings]
    has_repeats = all(c.explainable_rms is not None for c in diagnosis.steps[0].training)
    leading = [r for r in rows if r.verdict in ("supported", "confusable")]
    return environment.get_template("report.html").render(
        title=_title(diagnosis),
        rig=_rig_name(diagnosis),
        opening=opening_of(diagnosis, rows),
        channels=_channel_headings(diagnosis),
        tolerance=[figures(v, 2) for v in diagnosis.tolerance.values()],
        staircase=_staircase_image(diagnosis) if diagnosis.added or has_repeats else None,
        stairs=[stair_table(diagnosis, flight) for flight in flights(diagnosis)],
        has_repeats=has_repeats,
        steps_heading="How the error falls" if diagnosis.added else "How large the error is",
        recordings=[*_trained_sections(diagnosis), *_held_out_sections(diagnosis)],
        leading=leading,
        others=[r for r in rows if r not in leading],
        unfolded=diagnosis.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED),
        parameters=parameter_groups(diagnosis),
        zero_shift=_zero_shift(diagnosis),
        left=left_of(diagnosis),
    )


def _title(diagnosis: Diagnosis) -> str:
    names = ", ".join(c.recording.name for c in diagnosis.steps[0].training)
    return f"{LABELS[diagnosis.verdict]}: {names}"


def _rig_name(diagnosis: Diagnosis) -> str:
    rig = diagnosis.steps[0].training[0].recording.rig
    return rig.name if rig is not None else ""


def _channel_headings(diagnosis: Diagnosis) -> list[str]:
    space = diagnosis.model.space
    return [labelled(c, u) for c, u in zip(space.channels, space.units, strict=True)]


def _zero_shift(diagnosis: Diagnosis) -> list[Quantity]:
    units = dict(zip(diagnosis.model.space.channels, diagnosis.model.space.units, strict=True))
    return [Quantity(c, figures(v), unit_text(units[c])) for c, v in (diagnosis.zero_shift or {}).items()]


# ------------------------------------------------------------------------------------------------------- the verdict


def opening_of(diagnosis: Diagnosis, rows: Sequence[EffectRow]) -> Opening:
    """The verdict in plain words, with the channel in which the rigid tool fails most."""
    added = tuple(r for r in rows if r.verdict == "supported")
    sides = sides_of(diagnosis, _loudest_recording(diagnosis))
    alt = "What is left in the channel that fails most, before and after."
    picture = image_of(opening_figure(sides), alt, _opening_caption(sides[0]))
    return Opening(
        kind=diagnosis.verdict.value,
        label=LABELS[diagnosis.verdict],
        symbol=SYMBOLS[diagnosis.verdict],
        headline=headline(diagnosis.verdict, [r.title for r in added]),
        effects=added,
        sentences=tuple(_sentences(diagnosis)),
        notes=tuple(_notes(diagnosis)),
        warning=_warning(diagnosis),
        picture=picture,
    )


def _opening_caption(side: Side) -> str:
    """What the picture beside the verdict shows."""
    passes, channel = loudest(side)
    recording = side.recording
    name = f"{recording.name}, {recording.channels[channel]}"
    if passes:
        return f"{name}: what does not repeat, over the whole record. Grey: ± 2 standard deviations of the noise."
    if recording.repeats == 1:
        event = " Yellow: an event, kept out of the noise." if side.comparison.noise.events else ""
        return f"{name}. Grey: ± {side.noise_words}.{event}"
    return f"{name}: mean over {recording.repeats} repeats. Grey: ± noise of one sample; darker: ± noise of that mean."


def headline(verdict: RecordVerdict, titles: Sequence[str]) -> str:
    """The verdict as one sentence."""
    missing = "; ".join(titles)
    if verdict is RecordVerdict.NOTHING_MISSING:
        return "Nothing is missing: the rigid tool explains these readings"
    if verdict is RecordVerdict.EXPLAINED:
        return f"Missing in the model: {missing}"
    if verdict is RecordVerdict.PARTLY_EXPLAINED:
        return f"Missing in the model: {missing}. And something else remains"
    if titles:
        return f"Something is missing; {missing} takes less than half of it"
    return "Something is missing, and no effect of the catalogue explains it"


def _sentences(diagnosis: Diagnosis) -> list[str]:
    number = _loudest_recording(diagnosis)
    _, channel = loudest(sides_of(diagnosis, number)[0])
    found = [_fall([s.training[number] for s in diagnosis.steps], channel, "")]
    if diagnosis.steps[0].validation:
        held_out = [s.validation[0] for s in diagnosis.steps]
        found.append(_fall(held_out, channel, f"On {held_out[0].recording.name}, which was never fitted: "))
    return found


def _fall(comparisons: Sequence[Comparison], channel: int, where: str) -> str:
    """How far the error of a channel falls, in its unit."""
    first, last = comparisons[0], comparisons[-1]
    name, unit = first.recording.channels[channel], unit_text(first.space.units[channel])
    before, after = (size_text(c, name, 2).replace("< ", "below ") for c in (first, last))
    kind = "error that can be explained" if first.explainable_rms is not None else "error (RMS)"
    floor = f"one sample's noise is {figures(first.noise_floor[name], 2)} {unit}"
    lead = f"{where}{'in' if where else 'In'} {name}, the {kind}"
    if size_of(first)[name] < STANDS_OUT * first.noise_floor[name] and first.noise.source is NoiseSource.RESIDUAL:
        floor = "how much of that is noise, nothing tells"
    if len(comparisons) == 1:
        return f"{lead} is {before} {unit}; {floor}."
    return f"{lead} goes from {before} to {after} {unit}; {floor}."


def _notes(diagnosis: Diagnosis) -> list[str]:
    first = diagnosis.steps[0].training[0]
    rig = first.recording.rig
    stated = rig is not None and rig.sensor.tolerance is not None
    p_value = probability(diagnosis.lack_of_fit)
    return [
        *dict.fromkeys(_noise_note(c) for c in diagnosis.steps[0].training),
        CONVENTIONS[diagnosis.model.convention] + (" Its y runs along the tip." if diagnosis.model.mirror_y else ""),
        f"Tolerance: {'as the rig states it' if stated else 'a tenth of the noise floor'}.",
        f"Lack of fit of the last model: p = {p_value}".replace("p = <", "p <") + " (below 0.01 something is left).",
    ]


def _noise_note(comparison: Comparison) -> str:
    repeats, name = comparison.recording.repeats, comparison.recording.name
    if comparison.noise.source is NoiseSource.REPEATS:
        return f"Noise is known from {repeats} repeats of {name}."
    if comparison.noise.source is NoiseSource.RIG:
        return f"Noise of {name} is taken as the rig states it; there are no repeats."
    return f"Noise of {name} was estimated from what the model leaves; there are no repeats."


def _warning(diagnosis: Diagnosis) -> str:
    """That the verdict is weaker than it could be; empty when it is not."""
    sources = {c.noise.source for c in diagnosis.steps[0].training}
    if NoiseSource.RESIDUAL in sources:
        return (
            "Without repeats this verdict is weaker: the noise had to be taken from the residual itself, so part of "
            "what is missing may pass for noise. Four or more repeats of the same motion, or poses, would settle it."
        )
    if NoiseSource.RIG in sources:
        return (
            "Without repeats this verdict is weaker: it is as good as the noise that the rig file states. Four or more "
            "repeats of the same motion, or poses, would settle it."
        )
    return ""


def left_of(diagnosis: Diagnosis) -> Left | None:
    """Where the remainder lives, and what it looks like."""
    remainder = diagnosis.remainder
    if remainder is None:
        return None
    units = dict(zip(diagnosis.model.space.channels, diagnosis.model.space.units, strict=True))
    known = {c: v for c, v in remainder.explainable_rms.items() if v is not None}
    sizes = [Quantity(c, figures(v), unit_text(units[c])) for c, v in known.items()]
    return Left(remainder.where, remainder.looks_like, percentage(remainder.share), tuple(sizes))


# ------------------------------------------------------------------------------------------------------ the pictures


def sides_of(diagnosis: Diagnosis, number: int, *, held_out: bool = False) -> list[Side]:
    """The rigid tool and, when anything was added, the final model, on one recording."""
    steps = [diagnosis.steps[0], diagnosis.steps[-1]][: len(diagnosis.added) + 1]
    comparisons = [(s.validation if held_out else s.training)[number] for s in steps]
    holds = diagnosis.verdict is not RecordVerdict.UNEXPLAINED
    nothing = diagnosis.verdict is RecordVerdict.NOTHING_MISSING
    colours = [HOLDING if nothing else FAILING, HOLDING if holds else FAILING]
    labels = ["rigid tool", "with " + " + ".join(i.replace("_", " ") for i in diagnosis.added)]
    return [Side(*parts) for parts in zip(labels, colours, comparisons, strict=False)]


def _loudest_recording(diagnosis: Diagnosis) -> int:
    """The training recording in which a channel of the rigid tool stands out most from its noise."""
    first = diagnosis.steps[0].training
    powers = [max(size_of(c)[k] / max(c.noise_floor[k], 1e-300) for k in c.noise_floor) for c in first]
    if max(powers) < STANDS_OUT and all(c.noise.source is NoiseSource.RESIDUAL for c in first):
        # Each is its own noise, and no size tells.
        return int(np.argmin([c.lack_of_fit for c in first]))
    return int(np.argmax(powers))


def _staircase_image(diagnosis: Diagnosis) -> Image:
    sizes = [f"{n} {figures(_worst(diagnosis, i), 2)}" for i, n in enumerate(step_names(diagnosis))]
    alt = f"Error over noise floor after each step, worst channel: {', '.join(sizes)}."
    return image_of(staircase_figure(diagnosis), alt)


def _worst(diagnosis: Diagnosis, step: int) -> float:
    comparison = diagnosis.steps[step].training[0]
    return max(v / max(comparison.noise_floor[c], 1e-300) for c, v in size_of(comparison).items())


def _trained_sections(diagnosis: Diagnosis) -> list[RecordingSection]:
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


def _held_out_sections(diagnosis: Diagnosis) -> list[RecordingSection]:
    count = len(diagnosis.steps[0].validation)
    columns = [sides_of(diagnosis, i, held_out=True) for i in range(count)]
    return [
        RecordingSection(
            s[0].recording.name, facts(s[0].recording), False, s[0].recording.repeats > 1, _series_images(s)
        )
        for s in columns
    ]


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


# -------------------------------------------------------------------------------------------------------- the tables


def stair_table(diagnosis: Diagnosis, flight: Flight) -> StairTable:
    """Explainable and whole RMS of one recording after each step, per channel."""
    floor = flight.comparisons[0].noise_floor
    rows = [
        StairRow(
            name=name,
            cells=tuple(_cell(c, k, diagnosis.tolerance[k]) for k in floor),
            misfit=figures(c.misfit),
            lack_of_fit=probability(c.lack_of_fit),
        )
        for name, c in zip(step_names(diagnosis), flight.comparisons, strict=True)
    ]
    return StairTable(flight.name, flight.fitted, tuple(figures(v) for v in floor.values()), tuple(rows))


def _cell(comparison: Comparison, channel: str, tolerance: float) -> Cell:
    whole = comparison.rms[channel]
    if comparison.explainable_rms is None:
        return Cell(figures(None), figures(whole), "unknown")
    size = comparison.explainable_rms[channel]
    kind = "within" if size <= tolerance else "loud" if size > comparison.noise_floor[channel] else "above"
    return Cell(size_text(comparison, channel), figures(whole), kind)


def effect_row(finding: Finding, space: Space) -> EffectRow:
    """What is said of one effect, as text."""
    effect = finding.effect
    units = {p.name: p.unit for p in effect.parameters(space)}
    sizes = _most_certain(finding.parameters)
    limits = [Quantity(n, figures(v, 2), unit_text(units.get(n, ""))) for n, v in finding.detectable.items()]
    return EffectRow(
        id=effect.id,
        title=effect.title,
        equation=effect.equation,
        advice=effect.advice,
        verdict=finding.verdict.value,
        words=finding.verdict.value.replace("_", " "),
        p_value=probability(finding.p_value),
        removed=percentage(finding.error_removed),
        share=round(100 * min(1.0, max(0.0, finding.error_removed or 0.0)), 1),
        sizes=tuple(sizes[:SIZES]),
        more_sizes=tuple(sizes[SIZES:]),
        detectable=tuple(limits[:SIZES]),
        more_detectable=tuple(limits[SIZES:]),
        confusable_with=finding.confusable_with,
        reason=finding.reason,
    )


def _most_certain(parameters: Mapping[str, Estimate]) -> list[Quantity]:
    """Parameters as text; of many, those that stand out most from their std first."""
    found = list(parameters.items())
    if len(found) > SIZES:
        found.sort(key=lambda pair: -_certainty(pair[1]))
    return [Quantity(name, with_std(e.value, e.std), unit_text(e.unit)) for name, e in found]


def _certainty(estimate: Estimate) -> float:
    return abs(estimate.value) / estimate.std if isfinite(estimate.std) and estimate.std > 0 else 0.0


def parameter_groups(diagnosis: Diagnosis) -> list[tuple[str, list[Quantity]]]:
    """Parameters of the last fit: the tool's, each effect's, and the zeros of further recordings."""
    estimates = diagnosis.fit.parameters
    titles = {e.id: e.title for e in diagnosis.model.effects}
    groups: dict[str, list[Quantity]] = {}
    for name, e in estimates.items():
        effect, dot, own = name.partition(".")
        zero, at, recording = name.partition("@")
        group = f"Zero in {recording}" if at else titles.get(effect, effect) if dot else "Tool and zero"
        shown = zero if at else own if dot else name
        groups.setdefault(group, []).append(Quantity(shown, with_std(e.value, e.std), unit_text(e.unit)))
    return list(groups.items())
