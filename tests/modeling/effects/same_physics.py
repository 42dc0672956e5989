"""The same physics as MuJoCo's: what a simulated rig hides, in the catalogue's parameters, and how it is predicted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from estimation.model_response import model_response
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.kinematics.perturbed_arm import COMPLIANCE_ITERATIONS
from modeling.rig import Rig
from modeling.space import Space
from tests.modeling.effects.cases import RIGS, Case
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]
Amounts = dict[str, float]

PLANAR_RIG = simulated.PlanarRig(
    noise=(0.0, 0.0, 0.0), resolver_step=1e-12, warm_up=simulated.WarmUpTemperature(noise=0.0)
)
SPATIAL_RIG = simulated.SpatialRig(
    noise=(0.0,) * 6, resolver_step=1e-12, position_step=1e-12, warm_up=simulated.WarmUpTemperature(noise=0.0)
)
SIMULATED: Mapping[Space, simulated.SimulatedRig] = {Space.PLANE: PLANAR_RIG, Space.SPACE: SPATIAL_RIG}
REPEATS, SAMPLES = 2, 500

STRONG: Mapping[str, simulated.HiddenEffect] = {
    "gravity_tilt": simulated.GravityTilt(tilt_x=0.0, tilt_y=0.3),
    "joint_offset": simulated.JointOffset(joint=2, offset=0.3),
    "link_length_error": simulated.LinkLengthError(link=2, error=0.3),
    "sensor_rotation": simulated.SensorRotation(yaw=0.4),
    "sensor_gain": simulated.SensorGain(errors=(("fy", 0.3),)),
    "sensor_crosstalk": simulated.SensorCrosstalk(leaks=(("fy", "fx", 0.2), ("fx", "fy", -0.1))),
    "gain_nonlinearity": simulated.GainNonlinearity(quadratic=0.01, cubic=1e-3),
    "coulomb_friction": simulated.CoulombFriction(level=0.1, width=0.2),
    "translational_friction": simulated.TranslationalFriction(level=0.8, width=0.2),
    "sensor_hysteresis": simulated.SensorHysteresis(force=1.5, torque=0.06, start=0.7),
    "sensor_lag": simulated.SensorLag(time_constant=0.1),
    "time_delay": simulated.TimeDelay(delay=0.083),
    "tip_flexibility": simulated.TipFlexibility(stiffness=10.0, damping=0.1),
}
"""Larger than what a rig hides, so that what is of second order in them shows."""

OFF_AXIS: Mapping[str, simulated.HiddenEffect] = {
    "viscous_drag": simulated.ViscousDrag(x=0.03, y=-0.02),
    "quadratic_drag": simulated.QuadraticDrag(x=0.03, y=-0.02),
    "cable_spring": simulated.CableSpring(x=0.03, y=-0.02),
    "translational_friction": simulated.TranslationalFriction(x=0.03, y=-0.02),
    "base_force": simulated.BaseForce(force=(0.9, 0.5, -1.2), torque=(0.05, -0.03, 0.08), x=0.03, y=-0.02),
    "payload_change": simulated.PayloadChange(x=0.03, y=-0.02),
    "contact_event": simulated.ContactEvent(x=0.03, y=-0.02, d=0.12),
}
"""In six axes, beside the tip axis."""

EXACTLY = 1e-10
"""Of the largest reading. Accelerations come from recorded positions, rounded to 1e-12 rad: 1e-12 times the square of
the highest of 5 harmonics, 6 rad/s, and less."""
PREDICTED_TO: Mapping[str, float] = {
    "joint_elasticity": 0.06 * 0.06**COMPLIANCE_ITERATIONS,
    "sensor_hysteresis": 1e-5,
    "sensor_lag": 1e-5,
}
"""Where one side approximates.
joint_elasticity   the model seeks the deflection a stated number of times, each wrong by some 0.06 of the one before
sensor_hysteresis  the simulator takes tops of the load at points 1 ms apart: (w h)²/8 of a load of 10 rad/s
sensor_lag         it takes a lag's input as straight between them: (w h)²/12"""
PASSED_OVER = 0.3
"""N m of static torque: above, tanh(T / 0.02 N m) is 1 on both sides of the play, which moves T by 0.2 N m."""
OWN_SHAPE = ("bias_drift",)
"""Effects that the simulator gives another curve on purpose."""


def simulated_too(case: Case) -> bool:
    """Whether the simulated rig has the effect: those of joints in the plane only; in six axes it is led by hand."""
    return case.effect.id not in OWN_SHAPE and not (case.effect.needs_joints and case.space is Space.SPACE)


@dataclass(frozen=True, eq=False)
class Simulated:
    """A recording without noise of a rig with one effect in it, and the effect with its places filled in."""

    case: Case
    recording: Recording
    hidden: simulated.HiddenEffect


@cache
def recorded(space: Space, *hidden: simulated.HiddenEffect) -> tuple[Recording, tuple[simulated.HiddenEffect, ...]]:
    """A recording without noise, and the hidden effects with their places filled in."""
    rig = SIMULATED[space]
    motion = rig.random_motion(seed=11)
    frame = simulated.simulate(rig, motion, hidden=hidden, repeats=REPEATS, samples_per_period=SAMPLES)
    described = RIGS[space] if space is Space.PLANE else Rig()
    recording = from_columns({str(name): frame[name].to_numpy() for name in frame}, rig=described)
    return recording, simulated.resolve_effects(rig, motion, hidden, repeats=REPEATS)


def simulation(case: Case) -> Simulated:
    """The simulated rig with the case's effect."""
    usual = STRONG.get(case.effect.id, simulated.HIDDEN_EFFECTS[case.effect.id])
    effect = OFF_AXIS.get(case.effect.id, usual) if case.space is Space.SPACE else usual
    recording, (hidden,) = recorded(case.space, effect)
    return Simulated(case, recording, hidden)


# -------------------------------------------------------------------------- in the catalogue's terms


def body_of(space: Space) -> Amounts:
    """The tool of the simulated rig."""
    rig = SIMULATED[space]
    biases = {f"bias_{c}": value for c, value in zip(space.channels, rig.bias, strict=True)}
    if isinstance(rig, simulated.PlanarRig):
        return biases | {"m": rig.mass, "mlg": rig.mlg, "I": rig.inertia}
    assert isinstance(rig, simulated.SpatialRig)
    names = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    return biases | dict(zip(names, (rig.mass, *rig.first_moment, *rig.inertia), strict=True))


def per_channel(space: Space, force: float, torque: float, ending: str = "") -> Amounts:
    """One amount for forces and one for torques."""
    return {c + ending: force if c.startswith("f") else torque for c in space.channels}


def numbered(name: str, values: tuple[float, ...]) -> Amounts:
    """One amount for each joint."""
    return {f"{name}_{j}": value for j, value in enumerate(values, start=1)}


def truth_of(case: Case, hidden: simulated.HiddenEffect) -> Amounts:
    """The catalogue's parameters of a hidden effect: its fields of their names, and what has others in the rig.

    A `force` and a `torque` are those of every channel, where the parameters are named as these.
    """
    settings: dict[str, object] = {}
    for name, value in vars(hidden).items():
        settings |= dict(numbered(name, value)) if isinstance(value, tuple) else {name: value}
    names = {p.name.rpartition(".")[2] for p in case.own}
    alike = {name: value for name, value in settings.items() if name in names and isinstance(value, float)}
    force, torque = settings.get("force"), settings.get("torque")
    if set(case.space.channels) <= names and isinstance(force, float) and isinstance(torque, float):
        alike |= per_channel(case.space, force, torque)
    return alike | renamed(hidden, case.space)


def renamed(hidden: simulated.HiddenEffect, space: Space) -> Amounts:
    """The parameters of a hidden effect that go by other names in the rig, or that depend on its motion."""
    planar = space is Space.PLANE
    match hidden:
        case simulated.GravityTilt():
            return {"angle": hidden.tilt_y} if planar else {}
        case simulated.SensorRotation():
            return {"angle": hidden.yaw} if planar else {}
        case simulated.JointOffset():
            return {f"offset_{hidden.joint}": hidden.offset}
        case simulated.LinkLengthError():
            return {f"error_{hidden.link}": hidden.error}
        case simulated.CableSpring(anchor=(x, y, z)):
            return {"anchor_x": x, "anchor_y": z} if planar else {"anchor_x": x, "anchor_y": y, "anchor_z": z}
        case simulated.BaseForce():
            (x, y, z), turning = hidden.force, dict(zip("xyz", hidden.torque, strict=True))
            if planar:
                return {"force_x": x, "force_y": z}
            return {"force_x": x, "force_y": y, "force_z": z} | {f"torque_{a}": t for a, t in turning.items()}
        case simulated.SpinningRotor():
            return {f"h_{axis}": momentum for axis, momentum in zip("xyz", hidden.momentum, strict=True)}
        case simulated.ContactEvent():
            force, point = hidden.force, SIMULATED[space].scene.point(hidden.x, hidden.y, hidden.d)
            torque = hidden.torque + np.cross(point, force)
            wrench = (force[0], -force[1], torque[2]) if planar else (*force, *torque)
            names = ("fcx", "fcy", "tauc") if planar else ("fcx", "fcy", "fcz", "tcx", "tcy", "tcz")
            return dict(zip(names, wrench, strict=True))
        case _:
            return renamed_of_sensor(hidden, space)


def renamed_of_sensor(hidden: simulated.HiddenEffect, space: Space) -> Amounts:
    """The same of effects of the sensor and its zero."""
    match hidden:
        case simulated.SensorGain():
            return {channel: 1 + error for channel, error in hidden.errors}
        case simulated.SensorCrosstalk():
            return {f"{into}_{out_of}": gain for into, out_of, gain in hidden.leaks}
        case simulated.GainNonlinearity():
            return per_channel(space, hidden.quadratic, 0.0, "_2") | per_channel(space, hidden.cubic, 0.0, "_3")
        case simulated.Saturation():
            largest = np.abs(recorded(space)[0].wrench).max(axis=0)
            levels = zip(space.channels, hidden.share * largest, strict=True)
            return {channel: float(level) for channel, level in levels if channel.startswith("f")}
        case _:
            return {}


# ------------------------------------------------------------------------------------------- check


def same_physics_as_mujoco(case: Case) -> None:
    """The readings of MuJoCo with the effect in it are predicted at the true parameters, signs and units included."""
    found = simulation(case)
    theta = true_parameters(found)
    scale = np.abs(found.recording.wrench).max(axis=0)
    without = model_response(case.plain, found.recording, theta[: case.model.base_size], derivative=False).value
    assert np.abs((found.recording.wrench - without) / scale).max() > 3e-3  # what is hidden shows
    difference = (
        found.recording.wrench - model_response(case.model, found.recording, theta, derivative=False).value
    ) / scale
    worst = np.abs(difference[comparable(found)]).max()
    assert worst < PREDICTED_TO.get(case.effect.id, EXACTLY), f"{case}: {worst:.1e} of the largest reading"


def true_parameters(found: Simulated) -> Array:
    """The model's parameters; the amplitudes of a tone, whose phase the rig drew, by least squares."""
    case, prefix = found.case, f"{found.case.effect.id}."
    amounts = truth_of(case, found.hidden)
    assert amounts, f"{case}: say in `renamed` what the simulated effect is in the catalogue's parameters"
    truth = body_of(case.space) | {prefix + name: value for name, value in amounts.items()}
    assert truth.keys() <= {p.name for p in case.model.parameters}
    theta = np.array([truth.get(p.name, p.nominal) for p in case.model.parameters])
    if isinstance(found.hidden, simulated.LineInterference):
        response = model_response(case.model, found.recording, theta)
        waves = [i for i, p in enumerate(case.model.parameters) if p.name.startswith(prefix) and not p.nuisance]
        left = (found.recording.wrench - response.value).ravel()
        theta[waves] = np.linalg.lstsq(response.derivative[:, :, waves].reshape(len(left), -1), left)[0]
    return theta


def comparable(found: Simulated) -> NDArray[np.bool_]:
    """The samples (n,) at which the rig and the model mean the same: off the edges of events and of play."""
    recording, hidden = found.recording, found.hidden
    assert recording.time is not None
    edges: tuple[float | None, ...] = ()
    if isinstance(hidden, simulated.ContactEvent):
        edges = (hidden.start, hidden.end)
    if isinstance(hidden, simulated.PayloadChange):
        edges = (hidden.time,)
    away = np.abs(recording.time[:, None] - np.array(edges, dtype=float)) > simulated.CONTACT_EDGE
    kept = away.all(axis=1)
    if isinstance(hidden, simulated.JointBacklash):
        states = tuple(np.stack([recording.signals[f"{d}q{j}"] for j in (1, 2, 3)], axis=1) for d in ("", "d", "dd"))
        torques = simulated.weight_torques(PLANAR_RIG.scene, (states[0], states[1], states[2]))[0]
        kept &= (np.abs(torques) > PASSED_OVER).all(axis=1)
    assert kept.mean() > 0.7
    return np.asarray(kept)
