"""What each parameter of the catalogue's effects is, in words."""

from __future__ import annotations

import re

from modeling.chain.effect import Effect

POINT = {
    "x": "place of the point across the tip, along the sensor's x axis",
    "y": "place of the point across the tip, along the sensor's y axis",
    "d": "distance of the point from the sensor, along the tip",
}

MEANINGS: dict[str, dict[str, str]] = {
    "com_offset": {"mlx": "mass times the distance of the centre of mass from the tip axis"},
    "gravity_tilt": {
        "angle": "angle by which gravity is turned clockwise: positive, the base's -x side is lower",
        "tilt_x": "angle by which gravity is turned about the world's x: positive, the base's +y side is lower",
        "tilt_y": "angle by which gravity is turned about the world's y: positive, the base's -x side is lower",
    },
    "joint_offset": {r"offset_(\d+)": "true minus recorded coordinate of joint {1}"},
    "joint_elasticity": {r"compliance_(\d+)": "deflection of joint {1} for each unit of load"},
    "joint_backlash": {r"width_(\d+)": "free travel of joint {1}"},
    "link_length_error": {r"error_(\d+)": "true minus described length of link {1}"},
    "sensor_rotation": {
        "angle": "angle of the sensor's axes to those assumed",
        "roll|pitch|yaw": "{0} of the sensor's axes against those assumed",
    },
    "viscous_drag": {"c": "force for each unit of speed", **POINT},
    "quadratic_drag": {"c": "force for each unit of speed squared", **POINT},
    "coulomb_friction": {"level": "size of the torque, whatever the angular velocity"},
    "cable_spring": {
        "k": "stiffness",
        r"anchor_([xyz])": "place of the fixed end along the world's {1} axis, from its origin (the base)",
        "length": "length below which the cable is slack",
        **POINT,
    },
    "tip_flexibility": {
        "stiffness": "torque for each unit of deflection",
        "damping": "torque for each unit of its rate",
    },
    "payload_change": {"mass": "mass picked up; negative: released", "time": "when", **POINT},
    "contact_event": {
        "start": "when the contact begins",
        "end": "when it ends",
        r"fc([xyz])": "its force, sensor's {1} axis",
        "tauc": "its torque",
        r"tc([xyz])": "its torque, sensor's {1} axis",
    },
    "sensor_gain": {r"\w+": "gain of channel {0}, relative to the first"},
    "sensor_crosstalk": {r"([a-z]+)_([a-z]+)": "share of the load {2} in the reading {1}"},
    "gain_nonlinearity": {
        r"([a-z]+)_2": "coefficient of the squared load in channel {1}",
        r"([a-z]+)_3": "coefficient of the cubed load in channel {1}",
    },
    "sensor_hysteresis": {r"\w+": "half width of the play of channel {0}"},
    "sensor_lag": {"time_constant": "time in which 63 % of a step is shown"},
    "time_delay": {"delay": "time by which the reading follows the motion"},
    "saturation": {r"\w+": "largest reading of channel {0}, either sign"},
    "bias_drift": {r"([a-z]+)_(\d+)": "coefficient of the Legendre polynomial {2} in channel {1}"},
    "thermal_drift": {r"\w+": "change of the bias of channel {0} for each kelvin"},
    "line_interference": {
        "frequency": "frequency of the interference",
        r"([a-z]+)_(sin|cos)": "amplitude of its {2}e part in channel {1}",
    },
}
"""By effect and pattern of the parameter's name; {0} is the name, {1} and {2} are the pattern's groups."""


def parameter_meaning(effect: Effect, name: str) -> str:
    """What the parameter `name` (without the effect's id) is; empty for an effect that a user wrote."""
    for pattern, words in MEANINGS.get(effect.id, {}).items():
        if found := re.fullmatch(pattern, name):
            return words.format(found[0], *(group or "" for group in found.groups()))
    return ""
