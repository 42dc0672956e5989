"""The catalogue of effects: physics that the rigid-tool model omits, by id, in the order in which they are tested."""

from __future__ import annotations

from typing import NoReturn

from modeling.chain.effect import Effect
from modeling.effects import disturbances, geometry, loads, sensor
from modeling.errors import InputError, quoted, suggestion
from modeling.plugins import EFFECTS, plugins
from modeling.space import Space

__all__ = ["CATALOGUE", "Effect", "catalogue", "named"]

com_offset = geometry.CentreOfMassOffset
gravity_tilt = geometry.GravityTilt
joint_offset = geometry.JointOffset
joint_elasticity = geometry.JointElasticity
joint_backlash = geometry.JointBacklash
link_length_error = geometry.LinkLengthError
sensor_rotation = sensor.SensorRotation
viscous_drag = loads.ViscousDrag
quadratic_drag = loads.QuadraticDrag
coulomb_friction = loads.CoulombFriction
translational_friction = loads.TranslationalFriction
cable_spring = loads.CableSpring
base_force = loads.BaseForce
spinning_rotor = loads.SpinningRotor
tip_flexibility = geometry.TipFlexibility
payload_change = disturbances.PayloadChange
contact_event = disturbances.ContactEvent
sensor_gain = sensor.SensorGain
sensor_crosstalk = sensor.SensorCrosstalk
gain_nonlinearity = sensor.GainNonlinearity
sensor_hysteresis = sensor.SensorHysteresis
sensor_lag = sensor.SensorLag
time_delay = sensor.TimeDelay
saturation = sensor.Saturation
bias_drift = disturbances.BiasDrift
thermal_drift = disturbances.ThermalDrift
line_interference = disturbances.LineInterference

CATALOGUE: tuple[type[Effect], ...] = tuple(
    kind for name, kind in globals().items() if isinstance(kind, type) and name == getattr(kind, "id", None)
)
"""Every class above under its id, in that order."""
STATED: tuple[type[Effect], ...] = (
    geometry.GravityMagnitude, sensor.ChannelGain, sensor.CommonGain, sensor.ThermalGain, disturbances.ZeroDrift,
)  # fmt: skip
"""Effects that a budget of uncertainty states and no recording of one weight tells from the tool."""
WEIGHED: tuple[type[Effect], ...] = (sensor.ChannelGain, sensor.CommonGain, sensor.ThermalGain)
"""Those of them that known loads tell, or other temperatures, and that a model may have."""


def __getattr__(name: str) -> NoReturn:
    """AttributeError with the effect that was meant."""
    raise AttributeError(f"no effect is called {quoted(name)}; {suggestion(name, __dir__())}", name=name)


def __dir__() -> list[str]:
    """What one takes from here, for completion: the ids of the effects, and what finds them."""
    return sorted([*(effect.id for effect in CATALOGUE), "CATALOGUE", "Effect", "catalogue", "named"])


def _of_package(kind: type[Effect]) -> type[Effect]:
    """A class of effects that another package brings; TypeError or ValueError where it is none, or its id is taken."""
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise TypeError("no class of effects")
    if kind.id in {effect.id for effect in CATALOGUE}:
        raise ValueError(f"the id {kind.id} is the catalogue's")
    for space in kind.spaces:
        kind().parameters(space)
    return kind


def every_kind() -> tuple[type[Effect], ...]:
    """The classes of the catalogue, then those of packages that are installed beside."""
    return (*CATALOGUE, *(plugin.loaded for plugin in plugins(EFFECTS, _of_package) if plugin.loaded is not None))


def catalogue(space: Space | None = None, *, weighed: bool = False, warmed: bool = False) -> tuple[Effect, ...]:
    """One instance of every effect, also of packages installed beside, or of those defined in the given space.

    Of recordings `weighed` with known loads the gain of every channel is one, in place of the gains relative to the
    first; of recordings `warmed` to different temperatures its change with that is one too.
    """
    kinds = [sensor.ChannelGain if weighed and kind is sensor.SensorGain else kind for kind in every_kind()]
    kinds += [sensor.ThermalGain] * warmed
    return tuple(effect() for effect in kinds if space is None or space in effect.spaces)


def named(effect_id: str) -> Effect:
    """The effect of that id.

    Raises InputError for an unknown id.
    """
    for effect in (*every_kind(), *WEIGHED):
        if effect.id == effect_id:
            return effect()
    remedy = suggestion(effect_id, [effect.id for effect in every_kind()], most=len(CATALOGUE))
    raise InputError(what=f"no effect is called {quoted(effect_id)}", where="effect id", remedy=remedy)
