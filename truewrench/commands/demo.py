"""`truewrench demo`: simulate a rig with a hidden effect, diagnose its recordings, compare with the truth."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

import numpy as np

from diagnosis.comparison.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict_rule import RecordVerdict
from estimation.contact.contact_wrench import ContactWrench, compensate
from estimation.recordings.reading import read
from modeling.effects import catalogue
from modeling.table import Cell, Column, Table, Value
from truewrench.commands.diagnose import FILES, diagnosed, report_texts, write
from truewrench.commands.results import provenance_of
from truewrench.files.case_files import read_case
from truewrench.files.demonstration import (
    CONTACT,
    NOTHING,
    TRAINING,
    VALIDATION,
    contact_events,
    hidden_effect_by_id,
    in_six_axes,
    record,
    runs_of,
)
from truewrench.files.output import atomic_write, make_folder
from truewrench.plots.contact_plot import LabelledContact, contact_figure
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR
from truewrench.simulated_rig import Array, HiddenEffect
from truewrench.text.diagnosis_text import RIGID_TOOL, diagnosis_text

PICTURE = "contact.png"


def result_files(_: argparse.Namespace) -> list[Path]:
    """None to keep apart from what is read: it reads nothing."""
    return []


def run(arguments: argparse.Namespace) -> None:
    """Simulate, diagnose the recordings written, compare with the truth."""
    effect = hidden_effect_by_id(arguments.effect)
    out = make_folder(arguments.out)
    simulated = "six-axis carriage" if in_six_axes(effect) else "planar arm"
    print(f"Simulated {simulated} with hidden effect: {_described(record(effect, out))}")
    runs = runs_of(effect)
    names = ("rig.toml", *(r.name for r in runs))
    print("Recorded: " + ", ".join(str(out / name) for name in names), end="\n\n", flush=True)
    training, validation = str(out / TRAINING.name), str(out / VALIDATION.name)
    diagnosis = diagnosed(read_case([training], validation=[validation], rig=str(out / "rig.toml")))
    texts = report_texts(diagnosis, provenance_of(arguments, *(out / name for name in names[:3])))
    print(diagnosis_text(diagnosis), end="\n\n")
    print(outcome(diagnosis, arguments.effect), end="\n\n", flush=True)
    write(diagnosis, diagnosis.to_data(), texts, out)
    if CONTACT in runs:
        print(contact_summary(diagnosis, out), end="\n\n")
    print(f"Report: {out / FILES[0]}")
    if CONTACT in runs:
        print(f"Contact wrench estimated with the rigid tool and with the final model: {out / PICTURE}")


def _described(effect: HiddenEffect | None) -> str:
    if effect is None:
        return NOTHING
    sizes = ", ".join(f"{name} = {value}" for name, value in asdict(effect).items() if value is not None)  # type: ignore[call-overload]
    return f"{effect.id} ({sizes})"


# ----------------------------------------------------------------------------------------- comparison with the truth


def outcome(diagnosis: Diagnosis, hidden: str) -> str:
    """Hidden and identified effects, and the systematic error on the validation recording."""
    named = ", ".join(diagnosis.added) or NOTHING
    lines = [f"Hidden: {hidden}. Identified: {named}. {_judgement(diagnosis, hidden)}", ""]
    before, after = (step.validation[0] for step in (diagnosis.steps[0], diagnosis.steps[-1]))
    lines.append(f"Systematic error on {VALIDATION.name}, a validation motion that was not fitted:")
    lines.append(str(error_table(before, after)))
    return "\n".join(lines)


def _judgement(diagnosis: Diagnosis, hidden: str) -> str:
    aliases = {r for f in diagnosis.findings if f.effect.id in diagnosis.added for r in f.confusable_with}
    if hidden == NOTHING:
        return "Correct." if not diagnosis.added else "False alarm."
    if diagnosis.added == (hidden,):
        return "Correct."
    if hidden in aliases:
        return f"In these recordings it is indistinguishable from {hidden}."
    if hidden not in {e.id for e in catalogue()}:
        unexplained = diagnosis.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED)
        lacking = f"The catalogue has no {hidden}"
        return lacking + (": an unexplained systematic residual is the correct answer." if unexplained else ".")
    return "Not the hidden effect."


def error_table(before: Comparison, after: Comparison) -> Table:
    """Systematic RMS per channel with the rigid tool and with the final model, against the limit for success.

    The limit is a tenth of the noise floor and two standard errors: power (floor / 10)² + 2 std of the power.
    """
    rows = []
    errors = zip(before.explainable_rms or {}, before.space.units, strict=True)
    for channel, unit in errors:
        floor = after.noise_floor[channel]
        last = dict(after.explainable_rms or {})[channel]
        allowed = ((floor / 10) ** 2 + 2 * dict(after.explainable_std or {})[channel]) ** 0.5
        reached = "reached" if last <= allowed else "not reached"
        sizes = (c.systematic_cell(channel) for c in (before, after))
        rows.append((channel, unit, floor, *sizes, allowed, reached))
    names = ("noise floor", "rigid tool", "final model", "limit (floor / 10, 2 s.e.)")
    return Table.of(("channel", "unit", *(Column(name, format=".3g") for name in names), "success"), rows)


# --------------------------------------------------------------------------------------- contact wrench


def contact_summary(diagnosis: Diagnosis, out: Path) -> str:
    """Contact wrench of a known contact estimated with both models, as a table and a figure."""
    fits = {RIGID_TOOL: diagnosis.steps[0].fit}
    if diagnosis.added:
        fits["with " + " and ".join(diagnosis.added)] = diagnosis.steps[-1].fit
    recording = read(out / CONTACT.name, rig=diagnosis.steps[0].fit.recordings[0].rig)
    contacts = {label: compensate(fitted, recording) for label, fitted in fits.items()}
    last = list(contacts)[-1]
    sides = [
        LabelledContact(label, ADEQUATE_COLOUR if label == last else MISFIT_COLOUR, c) for label, c in contacts.items()
    ]
    true = true_contact(contacts[last])
    figure = contact_figure(sides, true)
    figure.patch.set_alpha(1.0)
    with atomic_write(out / PICTURE) as path:
        figure.savefig(path, format="png", dpi=144)
    lines = [f"A known force acts on the tool in {CONTACT.name}. Systematic error of the estimated contact wrench:"]
    return "\n".join([*lines, str(contact_errors(contacts, true))])


def true_contact(contact: ContactWrench) -> Array:
    """True contact wrench (n, 3) of every repeat along x', y' and clockwise, at the samples of the recording."""
    recording = contact.recording
    assert recording.time is not None
    period = recording.samples_per_repeat * (recording.dt or 0.0)
    on_tool = np.sum([push.wrench(recording.time) for push in contact_events(period)], axis=0)
    return np.asarray(on_tool[:, [0, 1, 5]] * [1, -1, 1])  # the tool's axes are x', -y'


def contact_errors(contacts: dict[str, ContactWrench], true: Array) -> Table:
    """Per component the noise and each model's systematic error (`<`: below its noise limit), and contacts detected."""
    first = next(iter(contacts.values()))
    errors = [
        np.maximum(contact.systematic_contact_error(true), contact.systematic_contact_error_limit)
        for contact in contacts.values()
    ]
    rows: list[tuple[Value, ...]] = []
    for i, (name, unit) in enumerate(zip(first.names, first.space.units, strict=True)):
        noise, limit = float(first.floor[i]), first.systematic_contact_error_limit[i]
        shown = (Cell(float(e[i]), mark="< " if e[i] == limit else "") for e in errors)
        rows.append((name, unit, noise, noise / 10, *shown))
    counts = ("contacts detected", "", f"of {CONTACT.repeats}", "", *(str(len(c.intervals)) for c in contacts.values()))
    sizes = (Column(label, format=".2g") for label in ("noise / 10", *contacts))
    return Table.of(("component", "unit", Column("noise", format=".3g"), *sizes), [*rows, counts])
