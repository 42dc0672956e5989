"""Opening: the verdict in words, and the picture beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict import RecordVerdict
from estimation.noise import NoiseSource
from modeling.rig import Convention
from truewrench.plots.image import Image, image_of
from truewrench.plots.number import figures, probability, unit_text
from truewrench.plots.opening_plot import STANDS_OUT, loudest, opening_figure
from truewrench.plots.side import Side
from truewrench.plots.staircase_plot import size_of, size_text
from truewrench.report.effect_row import EffectRow
from truewrench.report.sides import loudest_recording, sides_of

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


def opening_of(diagnosis: Diagnosis, rows: Sequence[EffectRow]) -> Opening:
    """The verdict in plain words, with the channel in which the rigid tool fails most."""
    added = tuple(r for r in rows if r.verdict == "supported")
    sides = sides_of(diagnosis, loudest_recording(diagnosis))
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
    number = loudest_recording(diagnosis)
    _, channel = loudest(sides_of(diagnosis, number)[0])
    found = [_fall([s.training[number] for s in diagnosis.steps], channel, "")]
    if diagnosis.steps[0].validation:
        held_out = [s.validation[0] for s in diagnosis.steps]
        found.append(_fall(held_out, channel, f"On {held_out[0].recording.name}, which was never fitted: "))
    return found + [f"{own}; that is left out of the judgement." for own in diagnosis.own]


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
