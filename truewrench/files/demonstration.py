"""Recordings of a simulated rig with a hidden effect: training, validation and contact, with the rig's file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from modeling.errors import InputError
from truewrench.files.output import atomic_write
from truewrench.simulated_rig import (
    HIDDEN_EFFECTS,
    BiasDrift,
    ContactEvent,
    PlanarRig,
    SpatialRig,
    TipFlexibility,
    TransientEffect,
    resolve_effects,
    simulate,
    write_recording,
)

if TYPE_CHECKING:
    from truewrench.simulated_rig import HiddenEffect, SimulatedRig

NOTHING = "nothing"
HARMONICS = 5
"""Of the motion: up to 1 Hz in a period of 5 s."""
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
SIX_AXES = """\
[robot]
name = "simulated six-axis carriage"
gravity = {gravity}   # m/s²

[sensor]
convention = "{convention}"
"""
"""For effects that do not show in the plane."""


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
"""Start and end (s) of the contact force in every repeat of the contact recording."""


def hidden_effect_by_id(effect_id: str) -> HiddenEffect | None:
    """The simulated effect of that id, None for `nothing`.

    Raises InputError for an unknown id, and where MuJoCo is not installed.
    """
    if effect_id != NOTHING and effect_id not in HIDDEN_EFFECTS:
        remedy = f"use one of {', '.join((NOTHING, *HIDDEN_EFFECTS))}"
        raise InputError(what=f"no effect is called '{effect_id}'", where="--effect", remedy=remedy)
    if find_spec("mujoco") is None:
        remedy = 'pip install "truewrench[simulation]"'
        raise InputError(what="MuJoCo, which simulates the rig, is not installed", where="demo", remedy=remedy)
    return HIDDEN_EFFECTS.get(effect_id)


def runs_of(effect: HiddenEffect | None) -> tuple[Run, ...]:
    """Recordings of the demo: none of a contact with a flexible tip, whose periodic state alone is simulated.

    Nor in six axes, whose contact has no picture of one direction.
    """
    alone = isinstance(effect, TipFlexibility) or in_six_axes(effect)
    return (TRAINING, VALIDATION) if alone else (TRAINING, VALIDATION, CONTACT)


def in_six_axes(effect: HiddenEffect | None) -> bool:
    """Whether the demo is of a six-axis rig, as the effect does not show in the plane."""
    return effect is not None and effect.spatial_only


def record(effect: HiddenEffect | None, out: Path, runs: Sequence[Run] | None = None) -> HiddenEffect | None:
    """Write rig file and recordings, by default all; return the effect as resolved for the rig."""
    rig: SimulatedRig = SpatialRig() if in_six_axes(effect) else PlanarRig()
    with atomic_write(out / "rig.toml") as path:
        path.write_text(rig_text(rig), encoding="utf-8")
    hidden = () if effect is None else (effect,)
    motions = {r: rig.random_motion(seed=r.seed, harmonics=HARMONICS) for r in runs or runs_of(effect)}
    resolved = resolve_effects(rig, motions[TRAINING], hidden, repeats=TRAINING.repeats)
    for r, motion in motions.items():
        # Transient events and drift are recording-specific; other effects stay on the rig.
        present = [e for e in resolved if r is TRAINING or not isinstance(e, TransientEffect | BiasDrift)]
        present += contact_events(motion.period) if r is CONTACT else []
        frame = simulate(rig, motion, hidden=present, repeats=r.repeats, samples_per_period=SAMPLES, seed=r.seed)
        write_recording(frame, out / r.name)
    return resolved[0] if resolved else None


def contact_events(period: float) -> list[ContactEvent]:
    """The contact force in every repeat of the contact recording."""
    return [ContactEvent(start=r * period + PUSH[0], end=r * period + PUSH[1]) for r in range(CONTACT.repeats)]


def rig_text(rig: SimulatedRig) -> str:
    """The rig file of a simulated arm, or of a six-axis carriage."""
    if not isinstance(rig, PlanarRig):
        return SIX_AXES.format(gravity=rig.gravity, convention=rig.convention)
    joints = rig.coordinates
    limits = {"position": rig.position_limit, "velocity": rig.velocity_limit, "acceleration": rig.acceleration_limit}
    lists = {name: list(v) if isinstance(v, tuple) else [v] * joints for name, v in limits.items()}
    return RIG.format(lengths=list(rig.link_lengths), gravity=rig.gravity, convention=rig.convention, **lists)
