"""The catalogue's effects in words: parameters, how each shows itself, what provokes it, its size in a recording."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from estimation.fit import Fit
from estimation.model_response import predicted_readings
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.number_format import format_number

# How each effect of the catalogue shows itself in a residual, and which motion makes it large: for the manual.


@dataclass(frozen=True)
class Provocation:
    """Two sentences on an effect.

    shows    what of it is seen in the residual of the rigid tool
    motion   which motion or test makes it large, or separates it from what resembles it
    """

    shows: str
    motion: str


PROVOCATIONS: dict[str, Provocation] = {
    "com_offset": Provocation(
        "A torque in proportion to gravity's component along the tip, at rest as in motion, and nothing in the forces "
        "as long as the motion is slow.",
        "Static poses all around the circle: the torque is a sine of the angle, and its phase is off by the direction "
        "of the offset. Fast rotation adds a force that separates it from crosstalk.",
    ),
    "gravity_tilt": Provocation(
        "Sine and cosine of the orientation in the force channels, independent of speed.",
        "Many orientations at one position, held still: a tether changes with position, a tilted gravity does not.",
    ),
    "joint_offset": Provocation(
        "A small turn of the whole weight and of the acceleration, constant over time and different for each joint.",
        "Move one joint at a time, with the others in several poses; fast motion separates the joints, "
        "because each offset turns another acceleration.",
    ),
    "joint_elasticity": Provocation(
        "Like a joint offset that follows the load: largest where the arm is stretched out horizontally.",
        "The same poses with and without a known extra weight: the difference grows with the weight, that of an offset "
        "does not.",
    ),
    "joint_backlash": Provocation(
        "A step where the torque of the weight about the joint changes its sign, constant on either side.",
        "Swing each joint slowly through the pose in which its load changes sign, from both sides.",
    ),
    "link_length_error": Provocation(
        "In proportion to the acceleration of the link's end: nothing at rest, quadratic in the speed of the motion.",
        "Fast rotation of the joint before the link, with the joints behind it held in different poses.",
    ),
    "sensor_rotation": Provocation(
        "Each force channel has a part of the other's load, with opposite signs.",
        "Static poses turned about the tool axis: crosstalk of one channel does not keep the length of the force.",
    ),
    "viscous_drag": Provocation(
        "A force against the velocity, in proportion to it, with a torque by its distance from the sensor.",
        "The same path at half, normal and double speed: the residual doubles with the speed.",
    ),
    "quadratic_drag": Provocation(
        "A force against the velocity that is nearly zero in slow parts and large in fast ones.",
        "The same path at half, normal and double speed: the residual grows fourfold when the speed doubles.",
    ),
    "coulomb_friction": Provocation(
        "A step in the torque wherever the rotation reverses, of the same height at any speed.",
        "Reverse slowly and fast in the same pose: a viscous torque changes with the speed, this one does not.",
    ),
    "cable_spring": Provocation(
        "A force that depends on the position alone, zero where the cable is slack.",
        "Approach the place where it goes taut from several sides, at one orientation and slowly.",
    ),
    "tip_flexibility": Provocation(
        "In proportion to the second derivative of the wrench: grows with the square of the frequency, and rings after "
        "a knock.",
        "A motion with frequencies as high as the robot allows, or a knock on the tool while it is recorded.",
    ),
    "payload_change": Provocation(
        "The residual of the later repeats is that of another weight: a step between repeats, not within the mean of "
        "them.",
        "Nothing to provoke: look at what the gripper did at the time found, and record before and after separately.",
    ),
    "contact_event": Provocation(
        "A pulse in one repeat that the others do not have.",
        "Nothing to provoke: look at what touched the tool at the time found.",
    ),
    "sensor_gain": Provocation(
        "The residual of a channel has the shape of its own load, fast and slow parts alike.",
        "Known weights along each axis; in motion, loads that are large in every channel compared with one another.",
    ),
    "sensor_crosstalk": Provocation(
        "One channel's residual has the shape of another channel's load, at any frequency.",
        "Poses or motions in which one channel is loaded and the others are not.",
    ),
    "gain_nonlinearity": Provocation(
        "Harmonics of a channel's own load; the residual against the load is a parabola or a cubic.",
        "The same motion at several amplitudes, and with several known weights, up to the largest load.",
    ),
    "sensor_hysteresis": Provocation(
        "A loop against the channel's own load, which does not widen with the speed.",
        "Load and unload slowly, in large loops and in small ones within them.",
    ),
    "sensor_lag": Provocation(
        "In proportion to the rate of the load, with a phase that grows with frequency and an amplitude that falls.",
        "Fast motion: at low frequencies a lag is a delay; the amplitude at high ones separates them.",
    ),
    "time_delay": Provocation(
        "In proportion to the rate of the load, with a phase that grows with the frequency and an unchanged amplitude.",
        "Fast motion, and one sharp event that both the robot and the sensor record.",
    ),
    "saturation": Provocation(
        "Zero up to a level, then one-sided: the peaks of the reading are flat.",
        "Larger loads: more of the peaks is cut. Smaller ones: it disappears.",
    ),
    "bias_drift": Provocation(
        "Slow, different in each repeat and in each channel, whatever the motion does.",
        "Hold one pose for as long as the recording lasts, before and after it.",
    ),
    "thermal_drift": Provocation(
        "Slow, in proportion to the logged temperature, whatever the motion does.",
        "Record the warm-up from a cold start with the temperature logged, and a second time when warm.",
    ),
    "line_interference": Provocation(
        "One line in the spectrum that lies between the multiples of the motion's frequency.",
        "Another period of the motion, or another sampling rate: an alias moves, a resonance of the tool does not.",
    ),
}
"""By the id of the effect."""


# Size of an effect in a recording: by how much it changes the predicted readings at most.


def largest_change(fit: Fit, effect_id: str) -> tuple[float, float] | None:
    """Largest force (N) and torque (N m) by which an effect changes the prediction of a recording of the fit.

    It is the difference of the model and the model without the effect, at the same values of all other parameters: of
    a load on the tool, that load. None for a recording-specific effect.
    """
    model = fit.model.without_recording_specific
    if effect_id not in (e.id for e in model.effects):
        return None
    changes = [_change(model, effect_id, fit, recording) for recording in fit.recordings]
    forces = 2 if fit.recordings[0].dimension == 2 else 3
    parts = (np.concatenate([np.linalg.norm(c[:, part], axis=1) for c in changes]) for part in _parts(forces))
    force, torque = (float(part.max()) for part in parts)
    return force, torque


def _parts(forces: int) -> tuple[slice, slice]:
    return slice(0, forces), slice(forces, None)


def _change(model: WrenchModel, effect_id: str, fit: Fit, recording: Recording) -> np.ndarray:
    readings = []
    for one in (model, model.without(effect_id)):
        theta = np.array([fit.values[p.name] for p in one.parameters])
        readings.append(predicted_readings(one, recording, theta))
    return np.asarray(readings[0] - readings[1])


def size_sentence(fit: Fit, effect_id: str) -> str:
    """The largest change as a sentence; empty for a recording-specific effect."""
    found = largest_change(fit, effect_id)
    if found is None:
        return ""
    size = " and ".join(f"{format_number(v)} {unit}" for v, unit in zip(found, ("N", "N m"), strict=True))
    stage = next(e.stage for e in fit.model.effects if e.id == effect_id)
    if stage is Stage.TIP_BODY:
        sentence = f"Where it is largest in the fitted recordings, it loads the sensor with {size}"
    else:
        sentence = f"In the fitted recordings it changes the readings by at most {size}"
    return f"{sentence} (norms over the components)."


# What each parameter of the catalogue's effects is, in words.


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
