"""The catalogue of effects: physics that the rigid-tool model omits, by id."""

from __future__ import annotations

from typing import NoReturn

from modeling.chain.effect import Effect
from modeling.effects.bias import BiasDrift, LineInterference, ThermalDrift
from modeling.effects.flexibility import TipFlexibility
from modeling.effects.geometry import (
    CentreOfMassOffset,
    GravityTilt,
    JointBacklash,
    JointElasticity,
    JointOffset,
    LinkLengthError,
)
from modeling.effects.loads import CableSpring, ContactEvent, CoulombFriction, PayloadChange, QuadraticDrag, ViscousDrag
from modeling.effects.sensor import (
    GainNonlinearity,
    Saturation,
    SensorCrosstalk,
    SensorGain,
    SensorHysteresis,
    SensorLag,
    SensorRotation,
    TimeDelay,
)
from modeling.errors import InputError, quoted, suggestion
from modeling.space import Space

__all__ = ["CATALOGUE", "BiasDrift", "Effect", "catalogue", "named"]

com_offset = CentreOfMassOffset
gravity_tilt = GravityTilt
joint_offset = JointOffset
joint_elasticity = JointElasticity
joint_backlash = JointBacklash
link_length_error = LinkLengthError
sensor_rotation = SensorRotation
viscous_drag = ViscousDrag
quadratic_drag = QuadraticDrag
coulomb_friction = CoulombFriction
cable_spring = CableSpring
tip_flexibility = TipFlexibility
payload_change = PayloadChange
contact_event = ContactEvent
sensor_gain = SensorGain
sensor_crosstalk = SensorCrosstalk
gain_nonlinearity = GainNonlinearity
sensor_hysteresis = SensorHysteresis
sensor_lag = SensorLag
time_delay = TimeDelay
saturation = Saturation
bias_drift = BiasDrift
thermal_drift = ThermalDrift
line_interference = LineInterference

CATALOGUE: tuple[type[Effect], ...] = (
    CentreOfMassOffset,
    GravityTilt,
    JointOffset,
    JointElasticity,
    JointBacklash,
    LinkLengthError,
    SensorRotation,
    ViscousDrag,
    QuadraticDrag,
    CoulombFriction,
    CableSpring,
    TipFlexibility,
    PayloadChange,
    ContactEvent,
    SensorGain,
    SensorCrosstalk,
    GainNonlinearity,
    SensorHysteresis,
    SensorLag,
    TimeDelay,
    Saturation,
    BiasDrift,
    ThermalDrift,
    LineInterference,
)


def __getattr__(name: str) -> NoReturn:
    """AttributeError with the effect that was meant."""
    raise AttributeError(f"no effect is called {quoted(name)}; {suggestion(name, __dir__())}", name=name)


def __dir__() -> list[str]:
    """What one takes from here, for completion: the ids of the effects, and what finds them."""
    return sorted([*(effect.id for effect in CATALOGUE), "CATALOGUE", "Effect", "catalogue", "named"])


def catalogue(space: Space | None = None) -> tuple[Effect, ...]:
    """One instance of every effect, or of those defined in the given space."""
    return tuple(effect() for effect in CATALOGUE if space is None or space in effect.spaces)


def named(effect_id: str) -> Effect:
    """The effect of that id.

    Raises InputError for an unknown id.
    """
    for effect in CATALOGUE:
        if effect.id == effect_id:
            return effect()
    remedy = suggestion(effect_id, [effect.id for effect in CATALOGUE], most=len(CATALOGUE))
    raise InputError(what=f"no effect is called {quoted(effect_id)}", where="effect id", remedy=remedy)
