"""The ids, parameters and units that people's data and scripts depend on (FORMATS), and how effects are found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from modeling import effects
from modeling.chain.effect import Effect
from modeling.effects import CATALOGUE, STATED, catalogue, named
from modeling.errors import InputError
from modeling.space import Space

every_effect = pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.id)

AGREED: Mapping[str, Mapping[str, str]] = {
    "com_offset": {"mlx": "kg m"},
    "gravity_tilt": {"angle": "rad"},
    "joint_offset": {"offset_1": "rad", "offset_2": "rad", "offset_3": "rad"},
    "joint_elasticity": {f"compliance_{j}": "rad/(N m)" for j in (1, 2, 3)},
    "joint_backlash": {"width_1": "rad", "width_2": "rad", "width_3": "rad"},
    "link_length_error": {"error_1": "m", "error_2": "m", "error_3": "m"},
    "sensor_rotation": {"angle": "rad"},
    "viscous_drag": {"c": "N s/m", "d": "m"},
    "quadratic_drag": {"c": "N s²/m²", "d": "m"},
    "coulomb_friction": {"level": "N m", "width": "rad/s"},
    "cable_spring": {"k": "N/m", "anchor_x": "m", "anchor_y": "m", "length": "m", "d": "m"},
    "tip_flexibility": {"stiffness": "N m/rad", "damping": "N m s/rad"},
    "payload_change": {"mass": "kg", "d": "m", "time": "s"},
    "contact_event": {"start": "s", "end": "s", "fcx": "N", "fcy": "N", "tauc": "N m"},
    "sensor_gain": {"fy": "1", "tau": "1"},
    "sensor_crosstalk": {"fx_fy": "1", "tau_fx": "m", "fx_tau": "1/m"},
    "gain_nonlinearity": {"fx_2": "1/N", "fx_3": "1/N²", "tau_2": "1/(N m)"},
    "sensor_hysteresis": {"fx": "N", "fy": "N", "tau": "N m"},
    "sensor_lag": {"time_constant": "s"},
    "time_delay": {"delay": "s"},
    "saturation": {"fx": "N", "fy": "N", "tau": "N m"},
    "bias_drift": {"fx_1": "N", "tau_1": "N m"},
    "thermal_drift": {"fx": "N/K", "fy": "N/K", "tau": "N m/K"},
    "line_interference": {"frequency": "Hz", "fx_sin": "N", "tau_cos": "N m"},
}
"""The ids of FORMATS.md, with the planar parameters and units; of the large families one of each kind.

An effect joins them when it is released: its id and parameters are then in people's files.
"""
agreed_effect = pytest.mark.parametrize(
    "effect", [effect for effect in catalogue() if effect.id in AGREED], ids=lambda effect: effect.id
)
FAMILIES = {"sensor_crosstalk", "gain_nonlinearity", "bias_drift", "line_interference"}


def test_catalogue_is_what_was_agreed_and_has_every_effect_there_is() -> None:
    def descendants(kind: Any) -> set[Any]:
        return {kind}.union(*(descendants(child) for child in kind.__subclasses__()))

    ours = {kind for kind in descendants(Effect) if kind.__module__.startswith("modeling.effects.")}
    assert {kind for kind in ours if not kind.__abstractmethods__} == {*CATALOGUE, *STATED}
    assert [kind.id for kind in CATALOGUE if kind.id in AGREED] == list(AGREED)


@every_effect
def test_effect_is_found_by_its_id(effect: Effect) -> None:
    assert named(effect.id) == effect
    assert getattr(effects, effect.id)() == effect


def test_unknown_id_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="viscous_drag"):
        named("gremlins")


@agreed_effect
def test_parameters_are_those_agreed(effect: Effect) -> None:
    units = {p.name: p.unit for p in effect.parameters(Space.PLANE)}
    agreed = AGREED[effect.id]
    assert agreed.items() <= units.items()
    assert effect.id in FAMILIES or agreed.keys() == units.keys()


@agreed_effect
def test_all_but_the_offset_centre_exist_in_both_spaces(effect: Effect) -> None:
    assert effect.spaces == ((Space.PLANE,) if effect.id == "com_offset" else tuple(Space))
