"""SI unit of a signal of the motion by its name."""

from __future__ import annotations

import re

ORIENTATION_ERRORS = ("turn_x", "turn_y", "turn_z")
"""Small rotations of the sensor about its own axes, rad, in which the noise of a quaternion is stated."""

_UNITS = {
    "rad": r"q\d+|phi|turn_[xyz]",
    "rad/s": r"dq\d+|dphi|w[xyz]",
    "rad/s²": r"ddq\d+|ddphi|al[xyz]",
    "m": r"p[xyz]",
    "m/s": r"v[xy]|vp[xyz]",
    "m/s²": r"a[xy]|ap[xyz]",
}


def signal_unit(signal: str) -> str:
    """The SI unit of a motion signal, of a revolute joint where it is a joint's; empty when it is none."""
    return next((unit for unit, names in _UNITS.items() if re.fullmatch(names, signal)), "")
