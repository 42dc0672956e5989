"""A rig that is simulated: a robot, a tool and a force/torque sensor in MuJoCo, with physics hidden in it.

It is the oracle of this project and shares no equation with `modeling`. A motion is prescribed; MuJoCo's
inverse dynamics give what a force and a torque sensor at the wrist feel. Loads on the tool (drag, tether,
magnet) are computed from MuJoCo's own position and velocity of the point that they attack, and put on the
tool's body as an external wrench, because MuJoCo's forces in joint space never reach a force sensor.
Joints that give way are moved by what MuJoCo says of the tool's weight, and a tip on a spring swings so that
the torque that the sensor feels is the spring's.

World: z up, the plane is x right and z up. The tool's frame is the sensor's: in the plane e1 = x', e2 = -y',
e3 = e1 x e2, into the page, so that positive rotation is clockwise and the tip points along -e2; in six axes
the tip points along +e3. SI units throughout. MuJoCo is imported when something is simulated, not before.
"""

from __future__ import annotations

from collections.abc import Mapping

from truewrench.simulated_rig.drive import Drive, PeriodicMotion
from truewrench.simulated_rig.experiment import placed, rest_poses, simulate, write_recording
from truewrench.simulated_rig.flexible_tip import TipFlexibility
from truewrench.simulated_rig.hidden import (
    Clock,
    Event,
    HiddenEffect,
    SceneChange,
    SensorEffect,
    Signal,
    ToolLoad,
    ZeroShift,
)
from truewrench.simulated_rig.joint_shifts import JointBacklash, JointElasticity, JointShift, weight_torques
from truewrench.simulated_rig.loads import (
    CONTACT_EDGE,
    Buoyancy,
    CableSpring,
    ContactEvent,
    CoulombFriction,
    Magnet,
    MagnusForce,
    QuadraticDrag,
    ViscousDrag,
)
from truewrench.simulated_rig.noise import (
    NOISE_MODELS,
    AutoregressiveNoise,
    NoiseModel,
    PinkNoise,
    StudentNoise,
    WarmUp,
    WhiteNoise,
)
from truewrench.simulated_rig.rigs import PlanarRig, Rig, SpatialRig
from truewrench.simulated_rig.scene import Array, Scene, Track
from truewrench.simulated_rig.scene_changes import (
    CentreOfMassOffset,
    GravityTilt,
    JointOffset,
    LinkLengthError,
    PayloadChange,
    SensorRotation,
)
from truewrench.simulated_rig.sensor_effects import (
    BiasDrift,
    GainNonlinearity,
    LineInterference,
    Saturation,
    SensorCrosstalk,
    SensorGain,
    SensorHysteresis,
    SensorLag,
    ThermalDrift,
    TimeDelay,
)
from truewrench.simulated_rig.true_wrench import felt_wrench, true_wrench

__all__ = [
    "CONTACT_EDGE",
    "HIDDEN_EFFECTS",
    "NOISE_MODELS",
    "Array",
    "AutoregressiveNoise",
    "BiasDrift",
    "Buoyancy",
    "CableSpring",
    "CentreOfMassOffset",
    "Clock",
    "ContactEvent",
    "CoulombFriction",
    "Drive",
    "Event",
    "GainNonlinearity",
    "GravityTilt",
    "HiddenEffect",
    "JointBacklash",
    "JointElasticity",
    "JointOffset",
    "JointShift",
    "LineInterference",
    "LinkLengthError",
    "Magnet",
    "MagnusForce",
    "NoiseModel",
    "PayloadChange",
    "PeriodicMotion",
    "PinkNoise",
    "PlanarRig",
    "QuadraticDrag",
    "Rig",
    "Saturation",
    "Scene",
    "SceneChange",
    "SensorCrosstalk",
    "SensorEffect",
    "SensorGain",
    "SensorHysteresis",
    "SensorLag",
    "SensorRotation",
    "Signal",
    "SpatialRig",
    "StudentNoise",
    "ThermalDrift",
    "TimeDelay",
    "TipFlexibility",
    "ToolLoad",
    "Track",
    "ViscousDrag",
    "WarmUp",
    "WhiteNoise",
    "ZeroShift",
    "felt_wrench",
    "placed",
    "rest_poses",
    "simulate",
    "true_wrench",
    "weight_torques",
    "write_recording",
]

HIDDEN_EFFECTS: Mapping[str, HiddenEffect] = {
    effect.id: effect
    for effect in (
        JointOffset(),
        JointElasticity(),
        JointBacklash(),
        LinkLengthError(),
        CentreOfMassOffset(),
        GravityTilt(),
        SensorRotation(),
        PayloadChange(),
        ViscousDrag(),
        QuadraticDrag(),
        CoulombFriction(),
        CableSpring(),
        TipFlexibility(),
        ContactEvent(),
        SensorGain(),
        SensorCrosstalk(),
        GainNonlinearity(),
        SensorHysteresis(),
        SensorLag(),
        TimeDelay(),
        BiasDrift(),
        ThermalDrift(),
        LineInterference(),
        Saturation(),
        Buoyancy(),
        Magnet(),
        MagnusForce(),
    )
}
"""Every effect that a rig can hide, by id, at a size that a record of eight repeats shows."""
