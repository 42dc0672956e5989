"""What somebody who reads the emitted code of a fitted model has to know, in paragraphs of plain text."""

from __future__ import annotations

from modeling.emit.about import with_units
from modeling.emit.fitted import FittedModel
from modeling.model import ALIGNED
from modeling.rig import Convention
from modeling.running import remembers
from modeling.space import Space

PLANAR_SIGNALS = (
    "Motion: world x right, y up; phi (rad) the angle of the tip, clockwise from +y, dphi, ddphi its rates; (px, py),"
    " (vx, vy), (ax, ay) position, velocity and acceleration of the sensor origin in the world (m, m/s, m/s2), gravity"
    " excluded. Wrench: axes x' = (cos phi, -sin phi), -y' against y' = (sin phi, cos phi) along the tip, torque"
    " clockwise about the sensor origin."
)
SPATIAL_SIGNALS = (
    "Motion: world z up; (qx, qy, qz, qw) the unit quaternion of the sensor in the world, v_world = R(q) v_sensor;"
    " (wx, wy, wz), (alx, aly, alz) angular velocity and acceleration in the sensor frame (rad/s, rad/s2);"
    " (px, py, pz), (vpx, vpy, vpz), (apx, apy, apz) position, velocity and acceleration of the sensor origin"
    " in the world (m, m/s, m/s2), gravity excluded. Wrench: forces and torques about the sensor origin in its frame."
)
JOINTS = "q1 .., dq1 .., ddq1 .. are joint angles and their rates (rad, rad/s, rad/s2; m where a joint slides)."


def about_fitted(fitted: FittedModel) -> list[str]:
    """What the model is, its signals and signs, and how it remembers."""
    without = "There is no derivative by the parameters: the tool bends, or it would be far longer than all the rest."
    return about_model(fitted) + about_memory(fitted) + ([without] if fitted.sensitivity is None else [])


def about_model(fitted: FittedModel) -> list[str]:
    """What the model is, its signals and signs."""
    model = fitted.model
    title = "planar" if model.space is Space.PLANE else "six-axis"
    what = ", ".join(f"{e.id} ({e.title})" for e in model.effects) or "none"
    found = [
        f"Fitted model of the tool on a {title} wrist force/torque sensor. Effects beyond the rigid tool: {what}.",
        PLANAR_SIGNALS if model.space is Space.PLANE else SPATIAL_SIGNALS,
        *([JOINTS] if "q1" in fitted.inputs else []),
        f"Signals u in order: {', '.join(fitted.inputs)}. Other signals than these are not needed.",
        f"Readings: {with_units(zip(model.channels, model.space.units, strict=True))}. {_signs(fitted)}",
        _contact(fitted),
    ]
    if fitted.dropped:
        found.append(f"Left out, since they belong to the recording of the fit: {', '.join(fitted.dropped)}.")
    return found


def _signs(fitted: FittedModel) -> str:
    model = fitted.model
    on_tool = model.convention is not Convention.ON_SENSOR
    sign = (
        "on_tool: the wrench of the sensor on the tool"
        if on_tool
        else "on_sensor: the wrench of the tool on the sensor"
    )
    turned = [f"gravity {model.gravity} m/s2", f"convention {sign}"]
    if model.mirror_y:
        turned.append("fy with the other sign (mirror_y)")
    if model.mounting != ALIGNED:
        rows = "; ".join(" ".join(map(str, row)) for row in model.mounting)
        turned.append(f"axes of the readings turned by the matrix [{rows}]")
    return f"Baked in: {', '.join(turned)}."


def _contact(fitted: FittedModel) -> str:
    where = (
        "along x' and y' and clockwise about the sensor, whatever the readings' signs"
        if fitted.model.space is Space.PLANE
        else "in the sensor frame, about the sensor origin, whatever the readings' signs"
    )
    return (
        f"Contact: the wrench of the environment on the tool, {', '.join(fitted.components)}, {where}:"
        " inverse contact gain * (reading - prediction). The zero of the readings is that of the fit."
    )


def about_memory(fitted: FittedModel) -> list[str]:
    """How the model remembers; nothing when it does not."""
    found = []
    if fitted.dt is not None and remembers(fitted.model):
        found.append(
            f"The model remembers. The code is for {1 / fitted.dt:.9g} samples per second, without a gap; it starts as"
            " if its first sample had always been there."
        )
    if fitted.bend is not None:
        found.append(
            "The tool hangs on a spring. Its bend is found at every sample by as many steps of Newton's method; between"
            " samples what drives it is a straight line. It starts from the static equilibrium of the first sample."
        )
    if fitted.memory is not None:
        values = ", ".join(f"{p.name} = {fitted.values[p.name]!r} {p.unit}" for p in fitted.fixed)
        found.append(f"Baked into its numbers: {values}. The memory delays a contact as it delays the load.")
        if fitted.memory.wait:
            found.append(
                f"Readings lead the motion, or lag it by less than a sample: what comes out belongs to the sample of"
                f" {fitted.memory.wait} samples ago."
            )
    if "level" in fitted.parts:
        found.append("Readings are clipped: while one stands at its level, the contact is a bound on what is there.")
    return found


def about_derivative(fitted: FittedModel, layout: str) -> str:
    """What the derivative is, and how it lies in memory."""
    if fitted.linear:
        return f"Regressor {layout}: reading = regressor * parameters, in their order."
    return f"Derivative {layout}, of what `load + zero` gives for one sample by the parameters, in their order."


def about_sample(fitted: FittedModel) -> str:
    """The parts of a sample, in order."""
    texts = {
        "load": "load: the reading before memory and zero",
        "zero": "zero: what is added last",
        "width": "width: half of the play between load and reading",
        "level": "level: where readings are clipped",
    }
    return "; ".join(texts[name] for name in fitted.parts) + "."
