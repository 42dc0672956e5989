"""Effects of one's own: the catalogue's physics when they say the same, and refused where they say nonsense."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import truewrench as tw
from estimation.recordings.reading import from_columns
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect, SearchDomain
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import compiled_prediction
from modeling.compiled.symbolic_vector import numpy_function
from modeling.effects import CATALOGUE, named
from modeling.errors import InputError
from modeling.formulas.custom_effect import CustomEffect
from modeling.formulas.definition import LARGEST_GRID
from modeling.parameter import Role
from modeling.rig import Convention
from modeling.space import Space
from truewrench.command_line import main
from truewrench.files.effects_file import MAX_BYTES, MAX_EFFECTS, read_effects
from truewrench.files.model_file import ModelFile

Array = NDArray[np.float64]

MAGNET = """
[[effect]]
id = "magnet"
title = "magnet near the fixture"
parameters = { strength = "N m^3", x = { unit = "m", search = [1, 2] }, y = { unit = "m", search = [0, 1, 2] } }
let = { ux = "x - tip_x", uy = "y - tip_y", r = "sqrt(ux^2 + uy^2)" }
tip_body = { at = "0", force_x = "strength*ux/r^4", force_y = "strength*uy/r^4" }
"""


def effect(**changes: Any) -> CustomEffect:
    """A spring to the world's y axis, with something else said of it; None leaves a key out."""
    table = {"id": "spring", "title": "a spring", "parameters": {"k": "N/m"}, "tip_body": {"force_x": "-k*tip_x"}}
    return CustomEffect.from_data({key: v for key, v in (table | changes).items() if v is not None}, where="file")


# ----------------------------------------------------------------- the same physics as the catalogue's

D = {"unit": "m", "search": [0.0, 0.1]}
WRITTEN: Mapping[str, dict[str, Any]] = {
    "viscous_drag-PLANE": {
        "parameters": {"c": {"unit": "N s/m", "bounds": [0, None]}, "d": D},
        "tip_body": {"at": "d", "force_x": "-c*tip_vx", "force_y": "-c*tip_vy"},
    },
    "viscous_drag-SPACE": {
        "parameters": {"c": {"unit": "N s/m", "bounds": [0, None]}, "d": D},
        "tip_body": {"at": "d", "force_x": "-c*tip_vx", "force_y": "-c*tip_vy", "force_z": "-c*tip_vz"},
    },
    "quadratic_drag-PLANE": {
        "parameters": {"c": "N s²/m²", "d": D},
        "constants": {"slowest": "1e-6 m/s"},
        "let": {"speed": "sqrt(tip_vx^2 + tip_vy^2 + slowest^2)"},
        "tip_body": {"at": "d", "force_x": "-c*speed*tip_vx", "force_y": "-c*speed*tip_vy"},
    },
    "cable_spring-PLANE": {
        "parameters": {"k": "N/m", "anchor_x": D, "anchor_y": D, "length": D, "d": D},
        "constants": {"least": "1e-6 m"},
        "let": {
            "ux": "anchor_x - tip_x",
            "uy": "anchor_y - tip_y",
            "r": "sqrt(ux^2 + uy^2 + least^2)",
            "pull": "k*max(0, r - length)/r",
        },
        "tip_body": {"at": "d", "force_x": "pull*ux", "force_y": "pull*uy"},
    },
    "thermal_drift-PLANE": {
        "parameters": {"fx": "N/K", "fy": "N/K", "tau": "N m/K"},
        "inputs": {"temperature": "°C"},
        "constants": {"t0": "20 °C"},
        "zero": {c: f"{c}*(temperature - t0)" for c in ("fx", "fy", "tau")},
    },
    "sensor_crosstalk-PLANE": {
        "parameters": {"fx_fy": "1", "fx_tau": "1/m", "fy_fx": "1", "fy_tau": "1/m", "tau_fx": "m", "tau_fy": "m"},
        "gain": {n: n for n in ("fx_fy", "fx_tau", "fy_fx", "fy_tau", "tau_fx", "tau_fy")},
    },
    "gain_nonlinearity-PLANE": {
        "parameters": {
            **{"fx_2": "1/N", "fy_2": "1/N", "tau_2": "1/(N m)"},
            **{"fx_3": "1/N²", "fy_3": "1/N²", "tau_3": "1/(N² m²)"},
        },
        "gain": {f"{c}_{c}": f"{c}_2*{c} + {c}_3*{c}^2" for c in ("fx", "fy", "tau")},
    },
}


def random_signals(model: WrenchModel, samples: int, rng: np.random.Generator) -> dict[str, Array]:
    found = {name: rng.normal(0, 2, samples) for name in model.inputs}
    turn = rng.normal(size=(4, samples))
    return found | dict(zip(("qx", "qy", "qz", "qw"), turn / np.linalg.norm(turn, axis=0), strict=True))


@pytest.mark.parametrize("case", WRITTEN)
def test_an_effect_of_the_catalogue_written_down_is_that_effect(case: str) -> None:
    """The same reading and the same derivatives in every parameter, from formulas that name nothing of its code.

    A formula's point `at` is on the tip axis.
    """
    effect_id, _, space_name = case.partition("-")
    space = Space[space_name]
    base = planar() if space is Space.PLANE else spatial()
    written = CustomEffect.from_data({"id": "written", "title": "as in the catalogue"} | WRITTEN[case])
    ours, theirs = base + written, base + named(effect_id).restricted(space)
    rng, samples = np.random.default_rng(1), 40
    values = dict(zip([p.name for p in theirs.parameters], rng.uniform(0.1, 0.6, len(theirs.parameters)), strict=True))
    signals = random_signals(theirs, samples, rng)
    assert set(ours.inputs) <= set(signals)
    order = [p.name.replace("written.", f"{effect_id}.") for p in ours.parameters]
    places = [list(values).index(name) for name in order]
    for part in ("load", "bias"):
        value, slopes = getattr(compiled_prediction(ours), part).tangent(
            signals, np.array([values[n] for n in order]), samples
        )
        expected, columns = getattr(compiled_prediction(theirs), part).tangent(
            signals, np.array(list(values.values())), samples
        )
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(value, expected, rtol=1e-10, atol=1e-12 * scale)  # rounding, in another order
        np.testing.assert_allclose(slopes, columns[:, :, places], rtol=1e-9, atol=1e-10 * scale)


def test_a_gain_may_name_loads_of_other_channels_and_no_zero_may() -> None:
    """fx += c fy tau of the rigid tool's loads, whatever the bias and the signs of the readings are."""
    leak = CustomEffect.from_data(
        {"id": "leak", "title": "a product", "parameters": {"c": "1/(N m)"}, "gain": {"fx_fy": "c*tau"}}
    )
    assert leak.spaces == (Space.PLANE,)
    rng, model = np.random.default_rng(4), WrenchModel(space=Space.PLANE, convention=Convention.ON_SENSOR)
    signals, body = random_signals(model, 30, rng), rng.uniform(0.5, 1.5, 6)
    loads = compiled_prediction(model).load.value(signals, body, 30)
    read = compiled_prediction(model + leak).load.value(signals, np.array([*body, 0.3]), 30)
    np.testing.assert_allclose(read[:, 0], loads[:, 0] + 0.3 * loads[:, 1] * loads[:, 2], rtol=1e-12)
    np.testing.assert_array_equal(read[:, 1:], loads[:, 1:])
    with pytest.raises(InputError, match="'tau' is not a known name"):
        effect(tip_body=None, zero={"fx": "k*tau"})


def test_a_wrench_in_the_tools_axes_is_a_contact_wrench() -> None:
    """As `contact_event` has it in the middle of its interval: the environment's on the tool, tau clockwise."""
    formulas = {"fcx": "a", "fcy": "b", "tauc": "c"}
    pushed = effect(id="push", parameters={"a": "N", "b": "N", "c": "N m"}, tip_body=formulas)
    assert pushed.spaces == (Space.PLANE,)
    rng, samples = np.random.default_rng(2), 12
    theirs = planar() + named("contact_event")
    signals = random_signals(theirs, samples, rng) | {"time": np.full(samples, 5.0)}
    body, wrench = rng.uniform(0.5, 1.5, 6), [3.0, -2.0, 0.4]
    interval = [4.0, 6.0]
    ours = compiled_prediction(planar() + pushed).load.value(signals, np.array([*body, *wrench]), samples)
    names = [p.name.partition(".")[2] for p in theirs.parameters if "." in p.name]
    event = dict(zip(("start", "end", "fcx", "fcy", "tauc"), [*interval, *wrench], strict=True))
    expected = compiled_prediction(theirs).load.value(signals, np.array([*body, *(event[n] for n in names)]), samples)
    np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-12)  # rounding


@pytest.mark.parametrize("space", Space)
def test_numpy_and_casadi_agree_on_an_effect_of_every_function(space: Space) -> None:
    shape = "exp(-abs(sin(progress)))*tanh(cos(progress))*max(0, min(progress, 1))*sign(time, w)*step(w, time)"
    every = effect(
        parameters={"k": "N"},
        constants={"w": "2 s"},
        tip_body={"force_x": f"k*({shape} + tan(progress)*atan2(w, time))"},
    )
    model = (planar() if space is Space.PLANE else spatial()) + every
    rng, samples = np.random.default_rng(3), 16
    signals = random_signals(model, samples, rng)
    theta = rng.uniform(0.5, 1.5, len(model.parameters))
    symbols = [sp.Symbol(name, real=True) for name in model.inputs] + [p.symbol for p in model.parameters]
    by_numpy = numpy_function(symbols, list(model.load))(*(signals[n] for n in model.inputs), *theta)
    by_casadi = compiled_prediction(model).load.value(signals, theta, samples)
    np.testing.assert_allclose(np.stack(np.broadcast_arrays(*by_numpy), axis=1), by_casadi, rtol=1e-11, atol=1e-11)


# ---------------------------------------------------------------------------- what every effect keeps


def test_it_is_an_effect_like_any_other() -> None:
    (magnet,) = read_from(MAGNET)
    assert isinstance(magnet, Effect)
    assert (magnet.id, magnet.title, magnet.stage) == ("magnet", "magnet near the fixture", Stage.TIP_BODY)
    assert magnet.spaces == tuple(Space)
    assert not magnet.per_recording
    assert not magnet.needs_repeats
    assert magnet.equation == (
        "force_x += strength*ux/r^4, force_y += strength*uy/r^4, "
        "where ux = x - tip_x, uy = y - tip_y, r = sqrt(ux^2 + uy^2), at = 0"
    )
    assert {p.name: (p.unit, p.nuisance) for p in magnet.parameters(Space.PLANE)} == {
        "strength": ("N m^3", False),
        "x": ("m", True),
        "y": ("m", True),
    }
    assert len(magnet.nuisance_grid(SearchDomain())) == 6
    assert magnet.nuisance_grid(SearchDomain())[0] == {"x": 1.0, "y": 0.0}


def read_from(text: str) -> tuple[CustomEffect, ...]:
    return tuple(CustomEffect.from_data(table, where="file") for table in tomllib.loads(text)["effect"])


def test_it_is_a_value_that_travels_as_its_fields_alone() -> None:
    (magnet,), (twin,) = read_from(MAGNET), read_from(MAGNET)
    assert magnet == twin
    assert hash(magnet) == hash(twin)
    assert magnet != effect()
    model = planar() + magnet
    assert compiled_prediction(model).load.active
    assert vars(magnet) == {f.name: getattr(magnet, f.name) for f in dataclasses.fields(magnet)}
    assert b"sympy" not in pickle.dumps(magnet)
    for other in (copy.deepcopy(magnet), pickle.loads(pickle.dumps(magnet))):  # noqa: S301 - our own bytes
        assert other == magnet
        assert compiled_prediction(planar() + other) is compiled_prediction(model)
    with pytest.raises(dataclasses.FrozenInstanceError):
        magnet.definition = twin.definition  # type: ignore[misc]


def test_it_vanishes_at_nominal_amplitudes_symbolically() -> None:
    (magnet,) = read_from(MAGNET)
    model = planar() + magnet
    assert model.load.subs({p.symbol: 0 for p in model.parameters if p.name == "magnet.strength"}) == planar().load


def test_the_same_in_python_and_in_text() -> None:
    x, y, strength, tip_x, tip_y, r = tw.signals("x", "y", "strength", "tip_x", "tip_y", "r")
    (magnet,) = read_from(MAGNET)
    written = tw.own_effect(
        id="magnet",
        title="magnet near the fixture",
        parameters={"strength": "N m^3", "x": {"unit": "m", "search": [1, 2]}, "y": {"unit": "m", "search": [0, 1, 2]}},
        let={"r": sp.sqrt((x - tip_x) ** 2 + (y - tip_y) ** 2)},
        tip_body={"force_x": strength * (x - tip_x) / r**4, "force_y": strength * (y - tip_y) / r**4},
    )
    ours, theirs = planar() + written, planar() + magnet
    assert ours.parameters == theirs.parameters
    rng, samples = np.random.default_rng(4), 10
    signals, theta = random_signals(theirs, samples, rng), rng.uniform(0.5, 1.5, len(theirs.parameters))
    one, other = (compiled_prediction(m).load.value(signals, theta, samples) for m in (ours, theirs))
    np.testing.assert_allclose(one, other, rtol=1e-12)  # rounding


@pytest.mark.parametrize(
    "formula", [sp.Heaviside(sp.Symbol("tip_x")), sp.Symbol("a; b"), sp.oo, sp.I, sp.log(2), object()]
)
def test_python_expressions_are_held_to_the_same_grammar(formula: Any) -> None:
    with pytest.raises(InputError):
        tw.own_effect(id="spring", title="a spring", parameters={"k": "N"}, tip_body={"force_x": formula})


# ------------------------------------------------------------------------------------- what is refused

REFUSED: Mapping[str, tuple[dict[str, Any], str]] = {
    "id of the catalogue": ({"id": "viscous_drag"}, "the catalogue has an effect 'viscous_drag'"),
    "id": ({"id": "Spring 1"}, "id: 'Spring 1' is not a valid id"),
    "title": ({"title": "\x1b[2J"}, "title: expected one line"),
    "key": ({"colour": "red"}, "colour: no such key"),
    "close key": ({"paramters": {}}, "did you mean parameters?"),
    "stage": (
        {"linear_dynamics": {"fx": "k"}},
        "give formulas in tip_body, gain, zero; other stages are not functions of one sample",
    ),
    "joints": ({"joints": {"q1": "k"}}, "other stages are not functions of one sample"),
    "two stages": ({"zero": {"fx": "k*px"}}, "formulas were given in tip_body and zero"),
    "no stage": ({"tip_body": None}, "there are no formulas"),
    "no formulas": ({"tip_body": {"at": "0"}}, "there are no formulas"),
    "target": ({"tip_body": {"force_q": "k"}}, "'force_q' is not a target of this stage; did you mean force_z"),
    "unit of a parameter": ({"parameters": {"k": "N/mm"}}, "parameters.k: 'mm' is not a known unit (column 3"),
    "unit of a formula": (
        {"parameters": {"k": "N"}},
        "tip_body.force_x, column 1: its unit is N m, expected N",
    ),
    "unit of a term": (
        {"tip_body": {"force_x": "-k*(tip_x + 1)"}},
        "force_x, column 13: incompatible units 1 (dimensionless) and m",
    ),
    "unit of a torque": ({"tip_body": {"tauc": "-k*tip_x"}}, "its unit is N, expected N m"),
    "unit of at": ({"tip_body": {"at": "1", "force_x": "-k*tip_x"}}, "tip_body.at, column 1: its unit is"),
    "a moving point": (
        {"tip_body": {"at": "px", "force_x": "-k*tip_x"}},
        "tip_body.at, column 1: 'px' is not a known name",
    ),
    "name": (
        {"tip_body": {"force_x": "-k*tipx"}},
        "column 4: 'tipx' is not a known name; did you mean tip_x",
    ),
    "column not declared": ({"tip_body": {"force_x": "-k*tip_x*volts"}}, "'volts' is not a known name"),
    "name taken": ({"parameters": {"px": "N/m"}}, "parameters: 'px' is already a signal"),
    "name of a function": ({"parameters": {"sin": "N/m"}}, "'sin' is already a function"),
    "name of the tool": ({"inputs": {"m": "kg"}}, "inputs: 'm' is already reserved"),
    "name used twice": ({"constants": {"k": "1 N"}}, "constants: 'k' is already one of parameters"),
    "strange name": ({"parameters": {"k; import os": "N/m"}}, "'k; import os' is not a valid name"),
    "parameter not used": ({"parameters": {"k": "N/m", "j": "m"}}, "parameters.j: 'j' is not used in any formula"),
    "constant not used": ({"constants": {"j": "1 m"}}, "constants.j: 'j' is not used in any formula"),
    "constant": ({"constants": {"j": "long"}}, "constants.j: 'long' is not a quantity"),
    "bounds": ({"parameters": {"k": {"unit": "N/m", "bounds": [1, 0]}}}, "parameters.k.bounds: expected [low, high]"),
    "nominal": ({"parameters": {"k": {"unit": "N/m", "bounds": [1, 2]}}}, "nominal value is outside"),
    "search": ({"parameters": {"k": {"unit": "N/m", "search": 5}}}, "a grid search needs finite bounds"),
    "search of too much": (
        {
            "parameters": {"k": "N/m"} | {f"a{i}": {"unit": "1", "bounds": [0, 1], "search": 20} for i in range(3)},
            "tip_body": {"force_x": "-k*tip_x*(a0 + a1 + a2)"},
        },
        f"the search grid has 8000 points; use {LARGEST_GRID} at most",
    ),
    "all searched": ({"parameters": {"k": {"unit": "N/m", "search": [1]}}}, "all parameters are nuisance parameters"),
    "both sensors": (
        {"tip_body": {"force_x": "-k*tip_x*phi", "fcz": "k*px"}},
        "no fcz and a six-axis sensor has no phi",
    ),
    "not vanishing": ({"parameters": {"k": {"unit": "N/m", "nominal": 2}}}, "it does not vanish"),
    "squared amplitude": (
        {"parameters": {"k": "1"}, "constants": {"s": "1 N/m"}, "tip_body": {"force_x": "k^2*s*tip_x"}},
        "parameters.k: it is not identifiable to first order",
    ),
    "shape not searched": (
        {"parameters": {"k": "N/m", "a": "1"}, "tip_body": {"force_x": "-k*tip_x*exp(a)*a"}},
        "parameters.k: it is not identifiable to first order",
    ),
    "finite nowhere": (
        {"tip_body": {"force_x": "-k*tip_x*sqrt(-1 - progress^2)"}},
        "it is not finite at any random point",
    ),
    "steps that multiply": (
        {
            "let": {"a0": "tip_x"} | {f"a{i}": f"a{i - 1} + a{i - 1}" for i in range(1, 20)},
            "tip_body": {"force_x": "-k*a19"},
        },
        "with its steps expanded it has",
    ),
    "too many": ({"constants": {f"c{i}": 1.0 for i in range(30)}}, "constants: "),
    "number for text": ({"tip_body": {"force_x": 3}}, "tip_body.force_x: "),
    "nan": ({"constants": {"c": float("nan")}}, "constants.c"),
    "table": ({"parameters": []}, "parameters: "),
}


@pytest.mark.parametrize("name", REFUSED)
def test_nonsense_is_refused_in_one_line_that_names_it(name: str) -> None:
    changes, what = REFUSED[name]
    with pytest.raises(InputError) as caught:
        effect(**changes)
    assert what in str(caught.value)
    assert str(caught.value).isprintable()


def test_units_of_a_recorded_column_may_be_anything_and_are_held_to() -> None:
    gauge = {"inputs": {"gauge": "counts"}, "tip_body": None}
    assert effect(**gauge, parameters={"k": "1/counts"}, gain={"fx_fx": "k*gauge"}).stage is Stage.GAIN
    with pytest.raises(InputError, match="incompatible units s and counts"):
        effect(**gauge, parameters={"k": "1/counts"}, gain={"fx_fx": "k*(gauge + time)"})
    with pytest.raises(InputError, match="did you mean counts"):
        effect(**gauge, parameters={"k": "1/count"}, gain={"fx_fx": "k*gauge"})


@pytest.mark.parametrize(("unit", "role"), [("s", Role.ONSET), ("Hz", Role.FREQUENCY), ("m", Role.SHAPE)])
def test_a_searched_parameter_has_the_role_of_its_unit(unit: str, role: Role) -> None:
    parameters = {"b": "N", "c": {"unit": unit, "search": [1.0, 2.0]}}
    scale = {"constants": {"c0": f"1 {unit}"}, "tip_body": None, "zero": {"fx": "b*progress*tanh(c/c0)"}}
    amplitude, searched = effect(parameters=parameters, **scale).parameters(Space.PLANE)
    assert (amplitude.role, searched.role) == (Role.AMPLITUDE, role)
    assert searched.nuisance
    assert not amplitude.nuisance


def test_a_zero_that_moves_with_time_needs_repeats() -> None:
    drifting = {"parameters": {"b": "N/s"}, "tip_body": None, "zero": {"fx": "b*time"}}
    assert effect(**drifting).needs_repeats
    assert effect(**drifting, per_recording=True).per_recording


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_any_table_is_an_effect_or_refused(data: st.DataObject) -> None:
    """A sound table with one of its places replaced by anything that TOML can hold."""
    anything = st.recursive(
        st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
        lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
        max_leaves=4,
    )
    key = data.draw(
        st.sampled_from(["id", "title", "parameters", "inputs", "constants", "let", "tip_body", "gain", "zero"])
    )
    inside = data.draw(st.booleans())
    drawn = {data.draw(st.text(max_size=4)): data.draw(anything)} if inside else data.draw(anything)
    table = {"id": "spring", "title": "a", "parameters": {"k": "N/m"}, "tip_body": {"force_x": "-k*tip_x"}}
    try:
        CustomEffect.from_data(table | {key: drawn})
    except InputError as error:
        lines = str(error).splitlines()
        assert len(lines) == 1  # some draws are sound


# ---------------------------------------------------------------------------------------------- files


def test_a_magnet_takes_six_lines(tmp_path: Path) -> None:
    assert len(MAGNET.strip().splitlines()) == 6
    path = tmp_path / "magnet.toml"
    path.write_text("\ufeff" + MAGNET, encoding="utf-8")
    assert tw.read_effects(path) == read_from(MAGNET)


SPRING = '[[effect]]\nid = "spring"\ntitle = "t"\nparameters = { k = "N/m" }\ntip_body = { force_x = "-k*tip_x" }\n'
BROKEN: Mapping[str, tuple[bytes, str]] = {
    "empty": (b"", "it contains no effect"),
    "not TOML": (b"[[effect]\n", "not a TOML file"),
    "not UTF-8": (b"\xff\xfe", "not a TOML file"),
    "null": (b"\0", "not a TOML file"),
    "deep": (b"a = " + b"[" * 50_000, "not a TOML file: tables are nested too deep"),
    "large": (b"#" * (MAX_BYTES + 1), f"has more than {MAX_BYTES} bytes"),
    "other table": (b"[rig]\n", "'rig' is not a key of an effects file"),
    "not an array": (b"effect = 3", "it contains no effect"),
    "not tables": (b"effect = [3]", "effect 1"),
    "twice": ((SPRING * 2).encode(), "the id 'spring' is used twice"),
    "many": ((SPRING * (MAX_EFFECTS + 1)).encode(), f"the file has {MAX_EFFECTS + 1} effects"),
    "formula": (SPRING.replace("-k*tip_x", "-k*tip.x").encode(), "effect 1 (spring): tip_body.force_x, column 7: '.'"),
    "code": (SPRING.replace("-k*tip_x", "__import__('os')").encode(), "tip_body.force_x, column 1: '_'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, what = BROKEN[name]
    path = tmp_path / "own.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_effects(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert what in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path, "a\0b"):
        with pytest.raises(InputError):
            read_effects(path)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(SPRING)), st.integers(0, 6), st.binary(max_size=6))
def test_a_damaged_file_is_an_effects_file_or_refused(place: int, cut: int, put: bytes) -> None:
    content = SPRING.encode()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "own.toml")
        path.write_bytes(content[:place] + put + content[place + cut :])
        try:
            read_effects(path)
        except InputError as error:
            lines = str(error).splitlines()
            assert len(lines) == 1  # some damage is none


# --------------------------------------------------------------------------------- models and commands


def still(samples: int = 40) -> dict[str, Array]:
    """Poses at rest of a tool that a spring of 5 N/m pulls towards x = 0, with noise of 10 mN."""
    rng = np.random.default_rng(7)
    phi, px = np.linspace(-3, 3, samples), rng.uniform(-0.5, 0.5, samples)
    pull = -5.0 * px  # on the tool, along the world's x; x' = (cos phi, -sin phi), -y' = (sin phi, cos phi)
    wrench = {
        "fx": 1 - 0.9 * 9.806 * np.sin(phi) - pull * np.cos(phi),
        "fy": 2 - 0.9 * 9.806 * np.cos(phi) + pull * np.sin(phi),
        "tau": 0.06 * 9.806 * np.sin(phi),
    }
    noisy = {name: values + 0.01 * rng.standard_normal(samples) for name, values in wrench.items()}
    return {"phi": phi, "px": px, "py": rng.uniform(-0.5, 0.5, samples)} | noisy


def test_a_spring_of_ones_own_is_fitted() -> None:
    """k to within five of its std: one in two million beyond."""
    fitted = tw.fit(planar() + effect(), from_columns(still()))
    estimate = fitted.parameters["spring.k"]
    assert abs(estimate.value - 5.0) < 5 * estimate.std
    assert estimate.std < 0.05


def test_a_model_with_it_is_stored_as_data_and_comes_back(tmp_path: Path) -> None:
    (magnet,) = read_from(MAGNET)
    fitted = tw.fit(planar() + named("com_offset") + effect(), from_columns(still()))
    saved = ModelFile.of(fitted)
    text = saved.to_text()
    found = ModelFile.from_text(text)
    assert found.model == fitted.model
    assert found.to_text() == text
    stored = json.loads(text)["effects"]
    assert stored[1]["definition"]["tip_body"] == {"force_x": "-k*tip_x"}
    assert CustomEffect.from_data(magnet.to_data()) == magnet


@pytest.mark.parametrize(
    ("key", "value", "what"),
    [
        ("tip_body", {"force_x": "__import__('os').system('true')"}, "tip_body.force_x, column 1"),
        ("tip_body", {"force_x": "-k*tip_x*9^9^9"}, "the exponent 9 is out of range"),
        ("parameters", {"k": "N"}, "its unit is N m"),
        ("id", "other", "'other'"),
        ("colour", "red", "colour: no such key"),
    ],
)
def test_a_stored_definition_is_held_to_the_same_grammar(key: str, value: Any, what: str) -> None:
    data = ModelFile.of(tw.fit(planar() + effect(), from_columns(still()))).to_data()
    data["effects"][0]["definition"][key] = value
    with pytest.raises(InputError) as caught:
        ModelFile.from_data(data, where="model.json")
    assert str(caught.value).startswith("model.json: effects: ")
    assert what in str(caught.value)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of poses at rest and effects files."""
    folder = tmp_path_factory.mktemp("own")
    columns = still()
    rows = zip(*columns.values(), strict=True)
    text = "\n".join([",".join(columns), *(",".join(f"{float(v)!r}" for v in row) for row in rows)])
    (folder / "still.csv").write_text(text + "\n")
    (folder / "own.toml").write_text(SPRING)
    (folder / "broken.toml").write_text(SPRING.replace("-k*tip_x", "-k*tipx"))
    (folder / "six.toml").write_text(SPRING.replace("-k*tip_x", "-k*tip_z"))
    (folder / "root.toml").write_text(SPRING.replace("-k*tip_x", "-k*tip_x*sqrt(sin(phi))"))
    return folder


def run(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def test_fit_adds_an_effect_of_a_file_and_stores_it(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = bench / "model.json"
    options = ("--effects", bench / "own.toml", "--add", "spring", "--out", model)
    assert run("fit", bench / "still.csv", *options) == 0
    assert "spring.k" in capsys.readouterr().out
    assert abs(ModelFile.read(model).parameters["spring.k"].value - 5.0) < 0.1
    assert run("fit", bench / "still.csv", *options, "--drop", "spring") == 0
    assert "spring.k" not in capsys.readouterr().out


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize(
    ("file", "what"),
    [
        ("broken.toml", "tip_body.force_x, column 4: 'tipx' is not a known name; did you mean tip_x"),
        ("six.toml", "no effect in it is for a sensor of the channels fx, fy, tau"),
        ("root.toml", "spring: tip_body.force_x is not finite at sample"),
        ("none.toml", "No such file"),
    ],
)
def test_a_broken_effects_file_ends_a_command_with_one_line(
    bench: Path, command: str, file: str, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command, bench / "still.csv", "--effects", bench / file) == 2
    out, err = capsys.readouterr()
    assert not out
    assert what in err
    assert len(err.splitlines()) == 1


def test_an_id_that_is_nowhere_names_those_of_the_file(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("fit", bench / "still.csv", "--effects", bench / "own.toml", "--add", "sprig") == 2
    assert "or a custom effect: spring" in capsys.readouterr().err


def test_every_id_of_the_catalogue_is_taken() -> None:
    for kind in CATALOGUE:
        with pytest.raises(InputError, match="choose another id"):
            effect(id=kind.id)
