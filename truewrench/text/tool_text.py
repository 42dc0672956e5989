"""The tool in one line: mass and centre of mass, which an engineer compares with scales and drawing."""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np

from diagnosis.verdict.unexplained_residual import unknown_tool_sentences
from estimation.centre_of_mass import SIGNIFICANT, CentreOfMass, centres_of_mass
from estimation.fit import Fit
from estimation.least_squares.estimates import NOT_CONVERGED, EstimatedModel
from estimation.noise.recording_noise import constant_channels
from estimation.parameter_layout import main_tool
from modeling.chain.sensor_axes import Axes, is_turned, sensor_to_pose, turn_words
from modeling.chain.stages import Stage
from modeling.effects.sensor import SensorGain
from modeling.number_format import estimate_text
from modeling.space import Space

# Whether the tool is as large as its inertia and centre of mass say: if not, the torque may be in other units.


FARTHEST = 2.0
"""Distance, m, of a tool's mass from the sensor that nobody carries on a wrist: tools reach some 0.5 m, and a torque in
N mm makes a centre of mass of 10 mm one of 10 m. It is a remark alone; no verdict rests on it."""
CLEAR = 5.0
"""Std by which the distances exceed `FARTHEST`: an inertia that the motion hardly excites may have any value."""
INERTIA = {Space.PLANE: (("I", 1.0),), Space.SPACE: (("Ixx", 0.5), ("Iyy", 0.5), ("Izz", 0.5))}
"""Parameters that sum to the mass times its mean square distance from the sensor origin, with their factors."""


def tool_extent_text(fitted: Fit) -> str:
    """One line where inertia or centre of mass lie farther from the sensor than any tool; otherwise empty.

    Inertia about the sensor origin over m is the mean square distance of the mass from it: I / m in the plane, half of
    the trace over m in six axes.
    """
    mass = fitted.parameters["m"]
    if not isfinite(mass.std) or mass.value < SIGNIFICANT * mass.std or mass.value <= 0:
        return ""
    distances = []
    inertia, inertia_std = _inertia(fitted)
    if inertia - CLEAR * inertia_std > mass.value * FARTHEST**2:
        distances.append(f"the mass is {sqrt(inertia / mass.value):.2g} m (radius of gyration)")
    distance, std = _centre(fitted)
    if distance - CLEAR * std > FARTHEST:
        distances.append(f"the centre of mass {distance:.2g} m")
    if not distances:
        return ""
    return (
        f"As fitted, {' and '.join(distances)} from the sensor: no tool is so large, the torque may be in other units."
    )


def _inertia(fitted: Fit) -> tuple[float, float]:
    """Mass times its mean square distance, kg m², with a bound of its std; not a number where it is unidentifiable."""
    moments = [(fitted.parameters[name], factor) for name, factor in INERTIA[fitted.model.space]]
    return sum(e.value * f for e, f in moments), sum(e.std * f for e, f in moments)


def _centre(fitted: Fit) -> tuple[float, float]:
    """Distance of the centre of mass from the sensor origin along the identifiable axes, m, with a bound of its std."""
    centre = CentreOfMass.of(fitted)
    coordinates = [(float(v), float(s)) for v, s in zip(centre.value, centre.std, strict=True) if isfinite(s)]
    return sqrt(sum(v * v for v, _ in coordinates)), sum(s for _, s in coordinates)


LEGEND = {
    Space.PLANE: "m mass, mlg mass times the distance of its centre along the tip, I inertia about the sensor's origin",
    Space.SPACE: "m mass, mx my mz mass times its centre's coordinates, Ixx .. Iyz inertia about the sensor's origin",
}
"""What the parameters of a rigid tool are."""


BIASED = "the model does not fit, and what it lacks biases these"
"""Of the numbers of a model with something missing."""

NOT_KNOWN = "not known"
"""In place of an interval where the readings do not say what the tool weighs."""
FORCES = ("fx", "fy", "fz")
FAR_ABOVE = 10.0
"""Times the noise: forces that are more are no noise."""
WEIGHTLESS = "these readings hold no weight; was the tool compensated already?"
TOO_STILL = (
    "the sensor's zero may hide its weight, which is hardly turned here; record motion or poses that turn the tool."
)


def left_out_channels(fitted: Fit) -> tuple[str, ...]:
    """Channels that never change in one of the recordings: they measure nothing, and are left out of its fit."""
    names, several = fitted.recordings[0].channels, (constant_channels(recording) for recording in fitted.recordings)
    return tuple(names[i] for i in sorted({i for numbers in several for i in numbers}))


def tool_text(fitted: Fit, *, misfitting: bool, unknown: str = "") -> str:
    """Mass and centre of mass with std, as far as they are identifiable; empty where the mass is not.

    Of readings without weight it says that there is none, unless its std leaves room for one of all that they read;
    where the tool is `unknown`, for which reason. Of a `misfitting` model it says that the std are too small, and of a
    fit that has not converged that.
    """
    mass = fitted.parameters["m"]
    if not isfinite(mass.std):
        return ""
    if unknown:
        return unknown_tool_sentences(unknown)[0]
    constant = [f"{c} never changes" for c in left_out_channels(fitted)]
    if abs(mass.value) < SIGNIFICANT * mass.std:
        weight, why = ("not known", TOO_STILL) if _may_be_heavy(fitted) else ("none", WEIGHTLESS)
        weight, why = ("not known", f"{'; '.join(constant)}.") if constant else (weight, why)
        return f"Tool: {weight}, m {estimate_text(mass.value, mass.std, mass.unit)}: {why}"
    centres = [text for centre in centres_of_mass(fitted) if (text := _coordinates(centre))]
    where = f"; centre of mass from the sensor's origin {' and '.join(centres)}" if centres else ""
    gains = any(effect.id == SensorGain.id for effect in fitted.model.effects)
    weighed = [f"as {fitted.recordings[0].channels[0]} weighs it, to which the gains are relative"] * gains
    doubts = [*constant, *weighed] + [NOT_CONVERGED] * (not fitted.converged) + [BIASED] * misfitting
    doubt = f" ({'; '.join(doubts)})" if doubts else ""
    return f"Tool: m {estimate_text(mass.value, mass.std, mass.unit)}{where}{doubt}."


def _coordinates(centre: CentreOfMass) -> str:
    """The identifiable coordinates of a centre of mass with std, and along what axes; empty without any."""
    numbers = zip(centre.axes, 1e3 * centre.value, 1e3 * centre.std, strict=True)
    texts = [f"{axis} {estimate_text(value, std, 'mm')}" for axis, value, std in numbers if isfinite(std)]
    return f"{', '.join(texts)} in {centre.frame}" if texts else ""


def tool_lines(fitted: Fit, *, misfitting: bool, unknown: str = "") -> list[str]:
    """The tool, which axes its parameters are along where there are several, and whether it is as large as no tool is.

    Of readings that are not its own, that it is not known.
    """
    turned = axes_sentence(fitted, misfitting=misfitting) if is_turned(fitted.model) else ""
    extent = "" if unknown else tool_extent_text(fitted)
    others = [] if unknown else [other_tool_text(fitted, name) for name in fitted.layout.other_tools]
    tool = tool_text(fitted, misfitting=misfitting, unknown=unknown)
    return [line for line in (turned, tool, *others, extent) if line]


def other_tool_text(fitted: Fit, name: str) -> str:
    """Mass and centre of mass of the tool with an unknown load, and the mass that it has more than the tool without.

    Empty where the mass is not identifiable.
    """
    tool = fitted.of_tool(name)
    mass, alone = tool["m"], fitted.parameters["m"]
    if not isfinite(mass.std):
        return ""
    places = [list(fitted.parameters).index(p) for p in (f"m@{name}", "m")]
    variance = np.array([1.0, -1.0]) @ fitted.covariance[np.ix_(places, places)] @ np.array([1.0, -1.0])
    more = f", {estimate_text(mass.value - alone.value, sqrt(variance), mass.unit)} more than without"
    more = more if isfinite(alone.std) and main_tool(fitted.recordings) == "" else ""
    centres = [text for centre in centres_of_mass(tool) if (text := _coordinates(centre))]
    where = f"; centre of mass {' and '.join(centres)}" if centres and mass.value > SIGNIFICANT * mass.std else ""
    return f"With {name}: m {estimate_text(mass.value, mass.std, mass.unit)}{more}{where}."


def tool_notes(fitted: Fit, *, misfitting: bool) -> list[str]:
    """Beside a table of parameters: which axes they are along, and the tool in a line."""
    tool = tool_lines(fitted, misfitting=misfitting)
    return tool if is_turned(fitted.model) else [axes_sentence(fitted), *tool]


def axes_sentence(fitted: EstimatedModel, *, misfitting: bool = False) -> str:
    """Which parameters are along which axes; of a `misfitting` model its turn of the sensor is no measurement."""
    if not is_turned(fitted.model):
        plane = fitted.model.space is Space.PLANE
        return (
            "Readings and biases are in sensor axes, the tool in tip axes." if plane else "Vectors are in sensor axes."
        )
    by, pose = turn_words(sensor_to_pose(fitted.model, fitted.theta)), Axes.POSE.words(fitted.model.space)
    names = [e.qualified(fitted.model.space) for e in fitted.model.effects if e.stage is Stage.MOUNTING]
    unknown = any(not isfinite(fitted.parameters[p.name].std) for parameters in names for p in parameters)
    by = f"{by}, as far as that is identifiable," if unknown else by
    pose = f"{pose}, to which the joints lead" if fitted.model.arm is not None else pose
    who = "The model, which does not fit, has the sensor" if misfitting else "The sensor is"
    return (
        f"{who} turned by {by} against the logged pose: biases, readings and noise are in sensor axes; first moment and"
        f" inertia, and points and wrenches of effects, in {pose}."
    )


def _may_be_heavy(fitted: Fit) -> bool:
    """Whether forces far above the noise may be those of a weight that the sensor's zero hides.

    The std of the mass leaves room for a weight of their size then. Readings that are nothing but noise hold none.
    """
    mass, force = fitted.parameters["m"], [c in FORCES for c in fitted.recordings[0].channels]
    read = np.concatenate([recording.wrench[:, force] for recording in fitted.recordings])
    size = float(np.sqrt((read**2).sum(axis=1).mean()))
    noise = min(float(np.sqrt((noise.floor[force] ** 2).sum())) for noise in fitted.noise)
    weight = fitted.model.gravity * (abs(mass.value) + SIGNIFICANT * mass.std)
    return weight > size > FAR_ABOVE * noise
