"""`truewrench demo`: the whole loop on a simulated rig that hides something."""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands

if TYPE_CHECKING:
    from diagnosis.comparison import Comparison
    from diagnosis.diagnosis import Diagnosis
    from estimation.contact.contact import Contact
    from truewrench.simulated_rig import Array, ContactEvent, HiddenEffect, PlanarRig

NOTHING = "nothing"
HARMONICS = 5
SAMPLES = 500
"""To a period of 5 s: 100 Hz."""

RIG = """\
[robot]
name = "simulated planar arm"
link_lengths = {lengths}   # m
gravity = {gravity}   # m/s²

[limits]
position = {position}   # rad
velocity = {velocity}   # rad/s
acceleration = {acceleration}   # rad/s²

[sensor]
convention = "{convention}"
"""


@dataclass(frozen=True)
class Run:
    """One recording to simulate: the seed of its motion and noise, and how often the motion repeats."""

    name: str
    seed: int
    repeats: int


TRAINING = Run("train.csv", seed=1, repeats=8)
VALIDATION = Run("validate.csv", seed=2, repeats=4)
CONTACT = Run("contact.csv", seed=3, repeats=4)
PUSH = (1.5, 2.5)
"""From when to when (s) somebody pushes the tool in every repeat of the contact recording."""
PICTURE = "contact.png"


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = "Simulate a rig that hides a physical effect, record it, diagnose the recordings, and compare."
    command = commands.add_parser("demo", help="the whole loop on a simulated rig", description=text)
    text = f"effect to hide, or `{NOTHING}` (default: %(default)s)"
    command.add_argument("--effect", metavar="ID", default="cable_spring", help=text)
    text = "folder for the rig, the recordings, the report (default: %(default)s)"
    command.add_argument("--out", type=Path, metavar="DIR", default=Path("demo_report"), help=text)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Simulate, diagnose what was written, print the story."""
    from truewrench.case import Case
    from truewrench.commands.diagnose import FILES, diagnosed, write
    from truewrench.output import folder
    from truewrench.summary import summary

    effect = hidden_effect(arguments.effect)
    out = folder(arguments.out)
    print(f"A simulated planar arm hides from its model: {_described(record(effect, out))}")
    names = ("rig.toml", TRAINING.name, VALIDATION.name, CONTACT.name)
    print("Recorded: " + ", ".join(str(out / name) for name in names), end="\n\n", flush=True)
    training, validation = str(out / TRAINING.name), str(out / VALIDATION.name)
    found = diagnosed(Case.read([training], validation=[validation], rig=str(out / "rig.toml")))
    write(found, found.to_data(), out)
    print(summary(found), end="\n\n")
    print(outcome(found, arguments.effect), end="\n\n")
    print(contact_story(found, out), end="\n\n")
    print(f"Report: {out / FILES[0]}")
    print(f"Contact, as the rigid tool and as the model found see it: {out / PICTURE}")


def hidden_effect(effect_id: str) -> HiddenEffect | None:
    """The simulated effect of that id, None for `nothing`.

    Raises InputError for an unknown id, and where MuJoCo is not installed.
    """
    from importlib.util import find_spec

    from modeling.errors import InputError
    from truewrench.simulated_rig import HIDDEN_EFFECTS

    if effect_id != NOTHING and effect_id not in HIDDEN_EFFECTS:
        remedy = f"use one of {', '.join((NOTHING, *HIDDEN_EFFECTS))}"
        raise InputError(what=f"no effect is called '{effect_id}'", where="--effect", remedy=remedy)
    if find_spec("mujoco") is None:
        remedy = 'pip install "truewrench[simulation]"'
        raise InputError(what="MuJoCo, which simulates the rig, is not installed", where="demo", remedy=remedy)
    return HIDDEN_EFFECTS.get(effect_id)


def _described(effect: HiddenEffect | None) -> str:
    if effect is None:
        return NOTHING
    sizes = ", ".join(f"{name} = {value}" for name, value in asdict(effect).items() if value is not None)  # type: ignore[call-overload]
    return f"{effect.id} ({sizes})"


def record(effect: HiddenEffect | None, out: Path) -> HiddenEffect | None:
    """Write the rig and the recordings: training, another motion, and one with a push; return the effect in place."""
    from truewrench.output import replacing
    from truewrench.simulated_rig import BiasDrift, Event, PlanarRig, placed, simulate, write_recording

    rig = PlanarRig()
    with replacing(out / "rig.toml") as path:
        path.write_text(rig_text(rig), encoding="utf-8")
    hidden = () if effect is None else (effect,)
    motions = {r: rig.random_motion(seed=r.seed, harmonics=HARMONICS) for r in (TRAINING, VALIDATION, CONTACT)}
    in_place = placed(rig, motions[TRAINING], hidden, repeats=TRAINING.repeats)
    for r, motion in motions.items():
        # A push, a new payload and a wandering zero belong to their own recording; the rest stays on the rig.
        present = [e for e in in_place if r is TRAINING or not isinstance(e, Event | BiasDrift)]
        present += pushes(motion.period) if r is CONTACT else []
        frame = simulate(rig, motion, hidden=present, repeats=r.repeats, samples_per_period=SAMPLES, seed=r.seed)
        write_recording(frame, out / r.name)
    return in_place[0] if in_place else None


def pushes(period: float) -> list[ContactEvent]:
    """The push in every repeat of the contact recording."""
    from truewrench.simulated_rig import ContactEvent

    return [ContactEvent(start=r * period + PUSH[0], end=r * period + PUSH[1]) for r in range(CONTACT.repeats)]


def rig_text(rig: PlanarRig) -> str:
    """The rig file of a simulated arm."""
    joints = rig.coordinates
    limits = {"position": rig.position_limit, "velocity": rig.velocity_limit, "acceleration": rig.acceleration_limit}
    lists = {name: list(v) if isinstance(v, tuple) else [v] * joints for name, v in limits.items()}
    return RIG.format(lengths=list(rig.link_lengths), gravity=rig.gravity, convention=rig.convention, **lists)


# ----------------------------------------------------------------------------------------- the story


def outcome(found: Diagnosis, hidden: str) -> str:
    """What was hidden, what was named, and what is left on the motion that was never fitted."""
    named = ", ".join(found.added) or NOTHING
    lines = [f"Hidden: {hidden}. Named: {named}. {_judgement(found, hidden)}", ""]
    before, after = (step.validation[0] for step in (found.steps[0], found.steps[-1]))
    lines.append(f"What can be explained of the error on {VALIDATION.name}, a motion that was never fitted:")
    lines.append(error_table(before, after))
    return "\n".join(lines)


def _judgement(found: Diagnosis, hidden: str) -> str:
    from diagnosis.verdict import RecordVerdict
    from modeling.effects import catalogue

    rivals = {r for f in found.findings if f.effect.id in found.added for r in f.confusable_with}
    if hidden == NOTHING:
        return "That is right." if not found.added else "That is a false alarm."
    if found.added == (hidden,):
        return "That is right."
    if hidden in rivals:
        return f"{hidden} is among the rivals that these recordings cannot tell from it."
    if hidden not in {e.id for e in catalogue()}:
        honest = found.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED)
        lacking = f"The catalogue has no {hidden}"
        return lacking + (": that something unknown is left is the right answer." if honest else ".")
    return "That is not what was hidden."


def error_table(before: Comparison, after: Comparison) -> str:
    """Per channel the explainable RMS with the rigid tool and with what was named, against what may be left.

    That is a tenth of the noise floor and two standard errors: power (floor / 10)² + 2 std of the power.
    """
    from estimation.fit import table

    rows = []
    errors = zip(before.explainable_rms or {}, before.space.units, strict=True)
    for channel, unit in errors:
        floor = after.noise_floor[channel]
        first, last = (dict(c.explainable_rms or {})[channel] for c in (before, after))
        allowed = ((floor / 10) ** 2 + 2 * dict(after.explainable_std or {})[channel]) ** 0.5
        reached = "reached" if last <= allowed else "not reached"
        rows.append((channel, unit, *(f"{size:.3g}" for size in (floor, first, last, allowed)), reached))
    head = ("channel", "unit", "noise floor", "rigid tool", "with what was named", "a tenth of the floor + 2 s.e.", "")
    return table(head, rows)


# --------------------------------------------------------------------------------------- the contact


def contact_story(found: Diagnosis, out: Path) -> str:
    """What both models make of a known push, as a table and a picture."""
    from estimation.contact.contact import compensate
    from estimation.reading import read
    from truewrench.output import replacing
    from truewrench.plots.contact_plot import ContactSide, contact_figure
    from truewrench.plots.style import FAILING, HOLDING
    from truewrench.summary import RIGID

    fits = {RIGID: found.steps[0].fit}
    if found.added:
        fits["with " + " and ".join(found.added)] = found.steps[-1].fit
    recording = read(out / CONTACT.name, rig=found.steps[0].fit.recordings[0].rig)
    contacts = {label: compensate(fitted, recording) for label, fitted in fits.items()}
    last = list(contacts)[-1]
    sides = [ContactSide(label, HOLDING if label == last else FAILING, c) for label, c in contacts.items()]
    true = true_contact(contacts[last])
    figure = contact_figure(sides, true)
    figure.patch.set_alpha(1.0)
    with replacing(out / PICTURE) as path:
        figure.savefig(path, format="png", dpi=144)
    lines = [
        f"Somebody pushes the tool in {CONTACT.name}. The part of the contact's error that repeats with the motion:"
    ]
    return "\n".join([*lines, contact_errors(contacts, true)])


def true_contact(contact: Contact) -> Array:
    """The push of every repeat (n, 3) along x', y' and clockwise, at the contact's samples."""
    import numpy as np

    recording = contact.recording
    assert recording.time is not None
    period = recording.samples_per_repeat * (recording.dt or 0.0)
    on_tool = np.sum([push.wrench(recording.time) for push in pushes(period)], axis=0)
    return np.asarray(on_tool[:, [0, 1, 5]] * [1, -1, 1])  # the tool's axes are x', -y'


def contact_errors(contacts: dict[str, Contact], true: Array) -> str:
    """Per component the noise, each model's repeating error (`<` what noise hides), and the contacts that it found."""
    import numpy as np

    from estimation.fit import table

    first = next(iter(contacts.values()))
    errors = [np.maximum(contact.repeating_error(true), contact.repeating_limit) for contact in contacts.values()]
    rows = []
    for i, (name, unit) in enumerate(zip(first.names, first.space.units, strict=True)):
        noise = first.floor[i]
        shown = ("< " * bool(e[i] == first.repeating_limit[i]) + f"{e[i]:.2g}" for e in errors)
        rows.append((name, unit, f"{noise:.3g}", f"{noise / 10:.2g}", *shown))
    found = ("contacts found", "", f"of {CONTACT.repeats}", "", *(str(len(c.intervals)) for c in contacts.values()))
    return table(("component", "unit", "noise", "a tenth of it", *contacts), [*rows, found])
