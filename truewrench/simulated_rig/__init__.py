"""Simulated rig: robot, tool and force/torque sensor in MuJoCo, with hidden physical effects.

It is the reference of the tests and shares no equation with `modeling`. A motion is prescribed; MuJoCo's
inverse dynamics give the wrench at the wrist sensor. Loads on the tool (drag, tether, magnet) are computed
from MuJoCo's position and velocity of the point of application, and applied to the tool's body as an external
wrench, because MuJoCo's joint-space forces do not act on a force sensor. Elastic joints deflect under the
tool's weight as MuJoCo computes it, and a flexible tip oscillates so that the sensor's torque is the spring's.

World: z up, the plane is x right and z up. The tool's frame is the sensor's: in the plane e1 = x', e2 = -y',
e3 = e1 x e2, into the page, so that positive rotation is clockwise and the tip points along -e2; in six axes
the tip points along +e3. SI units throughout. MuJoCo is imported only when something is simulated.
"""

from __future__ import annotations

from collections.abc import Mapping

from truewrench.simulated_rig import geometric_effects, sensor_effects, tool_loads
from truewrench.simulated_rig.commanded_motion import CommandedMotion, PeriodicMotion
from truewrench.simulated_rig.geometric_effects import (
    CentreOfMassOffset,
    GravityTilt,
    JointBacklash,
    JointDeflection,
    JointElasticity,
    JointOffset,
    LinkLengthError,
    PayloadChange,
    SensorRotation,
    TipFlexibility,
    weight_torques,
)
from truewrench.simulated_rig.hidden_effect import (
    BiasEffect,
    HiddenEffect,
    SampleConditions,
    SceneChange,
    SensorEffect,
    SensorSignal,
    ToolLoad,
    TransientEffect,
)
from truewrench.simulated_rig.mujoco_scene import Array, Scene, Track
from truewrench.simulated_rig.rigs import PlanarRig, SimulatedRig, SpatialRig
from truewrench.simulated_rig.sensor_effects import (
    NOISE_MODELS,
    AutoregressiveNoise,
    BiasDrift,
    GainNonlinearity,
    LineInterference,
    NoiseModel,
    PinkNoise,
    Saturation,
    SensorCrosstalk,
    SensorGain,
    SensorHysteresis,
    SensorLag,
    StudentNoise,
    ThermalDrift,
    TimeDelay,
    WarmUpTemperature,
    WhiteNoise,
)
from truewrench.simulated_rig.simulation import (
    resolve_effects,
    rigid_tool_wrench,
    simulate,
    static_poses,
    true_wrench,
    write_recording,
)
from truewrench.simulated_rig.tool_loads import (
    CONTACT_EDGE,
    BaseForce,
    Buoyancy,
    CableSpring,
    ContactEvent,
    CoulombFriction,
    Magnet,
    MagnusForce,
    QuadraticDrag,
    SpinningRotor,
    TranslationalFriction,
    ViscousDrag,
)

__all__ = [
    "CONTACT_EDGE",
    "HIDDEN_EFFECTS",
    "NOISE_MODELS",
    "Array",
    "AutoregressiveNoise",
    "BaseForce",
    "BiasDrift",
    "BiasEffect",
    "Buoyancy",
    "CableSpring",
    "CentreOfMassOffset",
    "CommandedMotion",
    "ContactEvent",
    "CoulombFriction",
    "GainNonlinearity",
    "GravityTilt",
    "HiddenEffect",
    "JointBacklash",
    "JointDeflection",
    "JointElasticity",
    "JointOffset",
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
    "SampleConditions",
    "Saturation",
    "Scene",
    "SceneChange",
    "SensorCrosstalk",
    "SensorEffect",
    "SensorGain",
    "SensorHysteresis",
    "SensorLag",
    "SensorRotation",
    "SensorSignal",
    "SimulatedRig",
    "SpatialRig",
    "SpinningRotor",
    "StudentNoise",
    "ThermalDrift",
    "TimeDelay",
    "TipFlexibility",
    "ToolLoad",
    "Track",
    "TransientEffect",
    "TranslationalFriction",
    "ViscousDrag",
    "WarmUpTemperature",
    "WhiteNoise",
    "resolve_effects",
    "rigid_tool_wrench",
    "simulate",
    "static_poses",
    "true_wrench",
    "weight_torques",
    "write_recording",
]

HIDDEN_EFFECTS: Mapping[str, HiddenEffect] = {
    kind.id: kind()
    for family in (geometric_effects, tool_loads, sensor_effects)
    for kind in vars(family).values()
    if isinstance(kind, type) and issubclass(kind, HiddenEffect) and hasattr(kind, "id")
}
"""Every hidden effect of these files by id, at a size detectable in a record of eight repeats."""
