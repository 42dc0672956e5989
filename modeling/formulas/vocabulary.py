"""Names that a formula may use and targets that it may add to, each with its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, point_on_tip, velocity_of_point
from modeling.effects.sensor import gain_unit
from modeling.rigid_body import contact_components, inertial_parameters
from modeling.space import FORCE_UNIT, Space

MOST_NAMED_JOINTS = 12
"""Joints whose signals have names: arms have seven, a rail or a turntable adds some."""

FORMULA_STAGES: Mapping[str, Stage] = {"tip_body": Stage.TIP_BODY, "gain": Stage.GAIN, "zero": Stage.BIAS}
"""Stage by the key of its formulas' table. Joint errors change every signal that a formula could use, and linear
dynamics are not a function of one sample: those stages are left to the catalogue."""

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
    **{f"q{n}": "rad" for n in range(1, MOST_NAMED_JOINTS + 1)},
    **{f"dq{n}": "rad/s" for n in range(1, MOST_NAMED_JOINTS + 1)},
    **{f"ddq{n}": "rad/s²" for n in range(1, MOST_NAMED_JOINTS + 1)},
}


def signal_units(space: Space) -> Mapping[str, str]:
    """Unit by name of the signals that a formula may use: the sensor's motion, the joints, and time."""
    return (_PLANE if space is Space.PLANE else _SIX_AXES) | _ANY


def tip_units(space: Space) -> Mapping[str, str]:
    """Units of position and velocity, in the world, of the point `at` on the tip: tip_x .. and tip_vx .."""
    return {f"tip_{a}": "m" for a in space.axes} | {f"tip_v{a}": "m/s" for a in space.axes}


def load_units(stage: Stage, space: Space) -> Mapping[str, str]:
    """Unit by name of the loads, before any gain, that a formula of a gain may use: those of the channels."""
    return space.channel_units if stage is Stage.GAIN else {}


def tip_values(chain: Chain, at: sp.Expr) -> dict[str, sp.Expr]:
    """Their expressions for the point at the distance `at` (m) along the tip."""
    motion, point = chain.motion, point_on_tip(chain, at)
    position = motion.position + motion.rotation * point
    velocity = motion.rotation * velocity_of_point(chain, point)
    axes = chain.space.axes
    return {f"tip_{a}": position[i] for i, a in enumerate(axes)} | {
        f"tip_v{a}": velocity[i] for i, a in enumerate(axes)
    }


def target_units(stage: Stage, space: Space) -> Mapping[str, str]:
    """Unit by name of a stage's targets.

    tip body  force_x .. (N): the environment's force on the tool at the point `at`, along the axes of the world;
              fcx, fcy, tauc or fcx .. tcz: its wrench in the tool's axes, about the sensor origin
    gain      `<row>_<column>`: the reading `row` += formula times the true channel `column`
    zero      the channels: bias, added to the readings last
    """
    channels = space.channel_units
    if stage is Stage.TIP_BODY:
        forces = {f"force_{a}": FORCE_UNIT for a in space.axes}
        return forces | dict(zip(contact_components(space), space.units, strict=True))
    if stage is Stage.GAIN:
        return {f"{row}_{column}": gain_unit(u, v) for row, u in channels.items() for column, v in channels.items()}
    return channels


RESERVED_NAMES = frozenset(
    name
    for space in Space
    for name in (*(p.name for p in inertial_parameters(space)), *(f"bias_{c}" for c in space.channels), *space.channels)
) | {"order", "pi", "reading", "contact", "state", "next_state", "prediction", "change", "derivative"}
"""Names reserved in a model or in generated code: the rigid tool's parameters, the readings."""
_INTERNAL_SYMBOLS = re.compile(r"(step|shared|turned)_[0-9]+|d{0,2}bend(_[xyz])?")


def is_reserved(name: str) -> bool:
    """Whether the name is reserved, or that of an internal symbol of a model."""
    return name in RESERVED_NAMES or _INTERNAL_SYMBOLS.fullmatch(name) is not None
