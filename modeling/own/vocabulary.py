"""Vocabulary: what a formula may name and what it may add to, each with its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping

from modeling import symbolic as sp
from modeling.chain import Chain, Stage, point_on_tip, velocity_on_tip
from modeling.contact import components
from modeling.space import FORCE_UNIT, TORQUE_UNIT, Space
from modeling.tip import body_parameters

MOST_JOINTS = 12
"""Joints whose signals have names; arms have seven, and a rail or a turntable some more."""

STAGES: Mapping[str, Stage] = {"tip_body": Stage.TIP_BODY, "gain": Stage.GAIN, "zero": Stage.ZERO}
"""The tables that formulas stand in: what they say of one sample is put in there. Joints turn every signal that a
formula could name, and memory is no function of one sample; those stages are left to the catalogue."""

_PLANE = {
    **{"phi": "rad", "dphi": "rad/s", "ddphi": "rad/s²"},
    **{"px": "m", "py": "m", "vx": "m/s", "vy": "m/s", "ax": "m/s²", "ay": "m/s²"},
}
_SIX_AXES = {
    **dict.fromkeys(("qx", "qy", "qz", "qw"), "1"),
    **dict.fromkeys(("wx", "wy", "wz"), "rad/s"),
    **dict.fromkeys(("alx", "aly", "alz"), "rad/s²"),
    **dict.fromkeys(("px", "py", "pz"), "m"),
    **dict.fromkeys(("vpx", "vpy", "vpz"), "m/s"),
    **dict.fromkeys(("apx", "apy", "apz"), "m/s²"),
}
_ANY = {
    **{"time": "s", "progress": "1"},
    **{f"q{n}": "rad" for n in range(1, MOST_JOINTS + 1)},
    **{f"dq{n}": "rad/s" for n in range(1, MOST_JOINTS + 1)},
    **{f"ddq{n}": "rad/s²" for n in range(1, MOST_JOINTS + 1)},
}


def signal_units(space: Space) -> Mapping[str, str]:
    """The signals of a recording that a formula may name: those of the sensor's motion, of the joints, and time."""
    return (_PLANE if space is Space.PLANE else _SIX_AXES) | _ANY


def tip_units(space: Space) -> Mapping[str, str]:
    """Place and velocity, in the world, of the point `at` on the tip: tip_x .. and tip_vx .."""
    return {f"tip_{a}": "m" for a in space.axes} | {f"tip_v{a}": "m/s" for a in space.axes}


def tip_values(chain: Chain, at: sp.Expr) -> dict[str, sp.Expr]:
    """The expressions of those names for the point at the distance `at` (m) along the tip."""
    motion = chain.motion
    place = motion.position + motion.rotation * point_on_tip(chain, at)
    velocity = motion.rotation * velocity_on_tip(chain, at)
    axes = chain.space.axes
    return {f"tip_{a}": place[i] for i, a in enumerate(axes)} | {f"tip_v{a}": velocity[i] for i, a in enumerate(axes)}


def target_units(stage: Stage, space: Space) -> Mapping[str, str]:
    """What formulas may be given for at a stage.

    tip body  force_x .. (N): the environment's force on the tool at the point `at`, along the axes of the world;
              fcx, fcy, tauc or fcx .. tcz: its wrench in the tool's axes, about the sensor origin
    gain      `<row>_<column>`: what the true channel `column`, times the formula, adds to the reading `row`
    zero      the channels: what is added to the readings at last
    """
    channels = dict(zip(space.channels, space.units, strict=True))
    if stage is Stage.TIP_BODY:
        forces = {f"force_{a}": FORCE_UNIT for a in space.axes}
        return forces | dict(zip(components(space), space.units, strict=True))
    if stage is Stage.GAIN:
        return {f"{row}_{column}": _gain(u, v) for row, u in channels.items() for column, v in channels.items()}
    return channels


def _gain(row: str, column: str) -> str:
    if row == column:
        return "1"
    return "m" if row == TORQUE_UNIT else "1/m"


RESERVED = frozenset(
    name
    for space in Space
    for name in (*(p.name for p in body_parameters(space)), *(f"bias_{c}" for c in space.channels), *space.channels)
) | {"order", "pi", "reading", "contact", "state", "next_state", "prediction", "change", "derivative"}
"""Names that mean something else in a model or in what is emitted of it: the rigid tool's parameters, the readings."""
_INNER = re.compile(r"(step|shared|turned)_[0-9]+|d{0,2}bend(_[xyz])?")


def is_reserved(name: str) -> bool:
    """Whether a model has a symbol of that name for something of its own."""
    return name in RESERVED or _INNER.fullmatch(name) is not None
