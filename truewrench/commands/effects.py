"""`truewrench effects`: catalogue of physical effects, or one effect in full."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from inspect import cleandoc
from itertools import groupby
from math import inf

from modeling.chain.effect import Effect
from modeling.effects import catalogue, named
from modeling.errors import InputError
from modeling.parameter import Parameter
from modeling.plugins import EFFECTS, FOUND
from modeling.space import Space
from modeling.table import Table


def run(arguments: argparse.Namespace) -> None:
    """Print the catalogue, or the description of one effect."""
    custom = () if arguments.effects is None else _custom_effects(arguments.effects)
    if arguments.id is None:
        print(listing((*catalogue(), *custom)))
        if brought := [plugin for plugin in FOUND if plugin.group == EFFECTS]:
            print(f"\nBy other packages: {'; '.join(map(str, brought))}.")
        return
    print(description(effect_by_id(arguments.id, custom)))


def _custom_effects(path: str) -> tuple[Effect, ...]:
    """Custom effects of a file; the formula parser is imported only here."""
    from truewrench.files.effects_file import read_effects

    return read_effects(path)


def effect_by_id(effect_id: str, custom: tuple[Effect, ...] = ()) -> Effect:
    """Effect of that id, a custom one or of the catalogue.

    Raises InputError for an unknown id.
    """
    for effect in custom:
        if effect.id == effect_id:
            return effect
    try:
        return named(effect_id)
    except InputError as error:
        also = f", or a custom effect: {', '.join(effect.id for effect in custom)}" if custom else ""
        raise InputError(what=error.what, where=error.where, remedy=error.remedy + also) from None


def listing(effects: Iterable[Effect]) -> str:
    """Id, title, stage of the chain and the sensors that each effect applies to."""
    rows = [(e.id, e.title, e.stage.value, _sensors(e.spaces)) for e in effects]
    return str(Table.of(("id", "effect", "stage", "sensor"), rows))


def description(effect: Effect) -> str:
    """Full description of an effect, with its parameters for planar and six-axis sensors."""
    lines = [f"{effect.id}: {effect.title}", "", effect.equation, "", cleandoc(type(effect).__doc__ or ""), ""]
    lines += [f"Stage of the chain: {effect.stage.value}. Sensor: {_sensors(effect.spaces)}."]
    if effect.per_recording:
        lines.append("Recording-specific: not carried over to another recording.")
    for space in effect.spaces:
        lines += ["", f"Parameters, {_sensors((space,))}:", *parameter_lines(effect.parameters(space))]
        fixed = (p for p in effect.restricted(space).parameters(space) if p.fixed)
        for value, group in groupby(fixed, key=lambda p: p.nominal):
            names = ", ".join(p.name for p in group)
            lines.append(f"  A diagnosis fixes {names} at {value:g}, unless another value is significant.")
    lines += ["", f"Check on the rig: {effect.advice}."]
    if effect.confused_with:
        lines.append(f"Often confused with: {effect.confused_with}.")
    return "\n".join(lines)


def parameter_lines(parameters: Iterable[Parameter]) -> list[str]:
    """Names with unit and bounds; consecutive ones that share both on one line."""
    groups = groupby(parameters, key=lambda p: (p.unit, p.bounds))
    return [f"  {', '.join(p.name for p in group)} ({_range(*key)})" for key, group in groups]


def _range(unit: str, bounds: tuple[float, float]) -> str:
    low, high = bounds
    named = "dimensionless" if unit == "1" else unit
    return named if low == -high == -inf else f"{named}, {low:.4g} to {high:.4g}"


def _sensors(spaces: tuple[Space, ...]) -> str:
    return ", ".join("planar" if space.value == 2 else "six axes" for space in spaces)
