"""The catalogue of effects: each id of a missing piece of physics with the class that describes it."""

from __future__ import annotations

from modeling.effect import Effect
from modeling.effects.body import CableSpring, CentreOfMassOffset, GravityTilt, QuadraticDrag, ViscousDrag
from modeling.effects.sensor import SensorCrosstalk, SensorLag, SensorRotation, TimeDelay
from modeling.effects.time import BiasDrift, ContactEvent, ThermalDrift
from modeling.errors import InputError
from modeling.space import Space

__all__ = ["CATALOGUE", "BiasDrift", "Effect", "catalogue", "named"]

com_offset = CentreOfMassOffset
gravity_tilt = GravityTilt
viscous_drag = ViscousDrag
quadratic_drag = QuadraticDrag
cable_spring = CableSpring
sensor_rotation = SensorRotation
sensor_crosstalk = SensorCrosstalk
sensor_lag = SensorLag
time_delay = TimeDelay
bias_drift = BiasDrift
thermal_drift = ThermalDrift
contact_event = ContactEvent

CATALOGUE: tuple[type[Effect], ...] = (
    CentreOfMassOffset,
    GravityTilt,
    SensorRotation,
    SensorCrosstalk,
    ViscousDrag,
    QuadraticDrag,
    CableSpring,
    SensorLag,
    TimeDelay,
    BiasDrift,
    ThermalDrift,
    ContactEvent,
)


def catalogue(space: Space | None = None) -> tuple[Effect, ...]:
    """One instance of every effect, or of those that exist in the given space."""
    return tuple(effect() for effect in CATALOGUE if space is None or space in effect.spaces)


def named(effect_id: str) -> Effect:
    """The effect of that id.

    Raises InputError when the catalogue has none.
    """
    for effect in CATALOGUE:
        if effect.id == effect_id:
            return effect()
    known = ", ".join(e.id for e in CATALOGUE)
    raise InputError(what=f"no effect is called '{effect_id}'", where="effect id", remedy=f"use one of {known}")
