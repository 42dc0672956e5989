"""Effects of a model that a tool's mass, centre of mass and inertia cannot express."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel

TILT = "gravity_tilt"


def left_out(model: WrenchModel, theta: NDArray[np.float64]) -> str:
    """A line that names the effects that are not in the tool's inertia, at parameters theta (k,); empty without any.

    Of a tilted base it says what to state instead: gravity along the axes of the recorded motion, m/s².
    """
    ids = [effect.id for effect in model.effects]
    if not ids:
        return ""
    line = f"not included, effects of the model beside the rigid tool: {', '.join(ids)}"
    return f"{line}; {_tilt_advice(model, theta)}" if TILT in ids else line


def _tilt_advice(model: WrenchModel, theta: NDArray[np.float64]) -> str:
    """Where the tilt of the base is stated. UR's `set_gravity` takes the opposite of gravity: [0, 0, 9.82] if level."""
    how = "state the tilt in the pose of the robot's base in the URDF, or as gravity in the controller"
    if model.gravity_direction is not None:  # the axes of the motion are not those of the base
        return how
    values = {p.name: value for p, value in zip(model.parameters, theta, strict=True)}
    gravity = model.chain.gravity
    numbers = gravity.subs({symbol: values[symbol.name] for symbol in gravity.free_symbols})
    vector = ", ".join(f"{float(v):.4g}" for v in numbers)
    return f"{how} (set_gravity of UR takes the negative): it is [{vector}] m/s² along the base's axes"
