"""Model files: what is written comes back, and what is damaged is refused in one line."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from estimation.fit import fit
from estimation.least_squares.estimates import Estimate
from estimation.recordings.reading import from_columns
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.effects import catalogue
from modeling.effects.disturbances import BiasDrift
from modeling.effects.loads import ViscousDrag
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.rig import Convention, Rig
from modeling.space import Space
from tests.shared.places import URDF
from truewrench.files.model_file import ModelFile

RIG = Rig.from_data(
    {
        "robot": {"name": "Prüfstand", "link_lengths": [1.0, 0.97, 0.4], "gravity": 9.81},
        "limits": {"position": [1, 1, [-0.5, 1.2]], "velocity": [2, 2, 3], "acceleration": [9, 9, 9]},
        "sensor": {"noise": {"fx": 0.1, "fy": 0.2, "tau": 0.01}, "convention": "on_tool"},
    }
)
ELBOW = URDF / "elbow.urdf"
RIGS = {
    Space.PLANE: RIG,
    Space.SPACE: Rig.from_data({"robot": {"urdf": str(ELBOW), "sensor_frame": "tool0"}}),
}


def every_effect(space: Space) -> tuple[Effect, ...]:
    """The catalogue, with an option that is not the default."""
    return tuple(BiasDrift(degree=3) if e.id == "bias_drift" else e for e in catalogue(space))


def model_file(space: Space, *, effects: tuple[Effect, ...] | None = None, unseen: int | None = None) -> ModelFile:
    """A file with these effects (all of that space) in it, random values and a random covariance."""
    effects = every_effect(space) if effects is None else effects
    model = WrenchModel(space=space, convention=Convention.ON_SENSOR, arm=RIGS[space].arm) + effects
    size, rng = len(model.parameters), np.random.default_rng(1)
    root = rng.standard_normal((size, 2 * size))
    covariance = root @ root.T
    if unseen is not None:
        covariance[unseen], covariance[:, unseen] = 0.0, 0.0
        covariance[unseen, unseen] = np.inf
    std = np.sqrt(np.diag(covariance))
    return ModelFile(
        model=model,
        rig=RIGS[space],
        parameters={
            p.name: Estimate(p.name, float(v), float(s), p.unit)
            for p, v, s in zip(model.parameters, rng.standard_normal(size), std, strict=True)
        },
        covariance=covariance,
        noise_floor=dict.fromkeys(model.channels, 0.1),
        noise_source=NoiseSource.REPEATS,
        remainder=dict.fromkeys(model.channels, 0.01),
    )


@pytest.mark.parametrize("space", Space)
@pytest.mark.parametrize("unseen", [None, 4])
def test_what_is_written_comes_back(space: Space, unseen: int | None, tmp_path: Path) -> None:
    written = model_file(space, unseen=unseen)
    path = tmp_path / "model.json"
    path.write_text(written.to_text(), encoding="utf-8")
    found = ModelFile.read(path)
    assert found.model == written.model
    assert found.parameters == written.parameters
    np.testing.assert_array_equal(found.covariance, written.covariance)
    assert (found.noise_floor, found.noise_source) == (written.noise_floor, written.noise_source)
    assert found.remainder == written.remainder
    assert found.to_text() == written.to_text()


def test_the_order_of_keys_and_of_the_covariance_is_free() -> None:
    written = model_file(Space.PLANE)
    data = written.to_data()
    data["parameters"] = dict(reversed(data["parameters"].items()))
    matrix = np.array(data["covariance"]["matrix"])[::-1, ::-1].tolist()
    data["covariance"] = {"parameters": data["covariance"]["parameters"][::-1], "matrix": matrix}
    assert ModelFile.from_data(data).to_text() == written.to_text()


def test_a_fit_becomes_a_file_and_its_unseen_parameter_has_no_std() -> None:
    """At rest nothing shows the inertia; phi in many directions shows mass and first moment."""
    phi = np.linspace(-3, 3, 40)
    rng = np.random.default_rng(1)
    wrench = {
        "fx": 1 - 0.9 * 9.806 * np.sin(phi),
        "fy": 2 - 0.9 * 9.806 * np.cos(phi),
        "tau": 0.06 * 9.806 * np.sin(phi),
    }
    noisy = {name: values + 0.01 * rng.standard_normal(40) for name, values in wrench.items()}
    fitted = fit(planar() + BiasDrift(degree=1), from_columns({"phi": phi, **noisy}))
    saved = ModelFile.of(fitted)
    assert list(saved.parameters) == [p.name for p in fitted.model.parameters]
    assert saved.to_data()["parameters"]["I"]["std"] is None
    assert saved.parameters["m"] == fitted.parameters["m"]
    assert saved.parameters["m"].std == pytest.approx(np.sqrt(saved.covariance[3, 3]))
    assert ModelFile.from_text(saved.to_text()).to_text() == saved.to_text()


def doubted() -> ModelFile:
    """A file with an alternative in it."""
    other = model_file(Space.PLANE, effects=(BiasDrift(degree=1),))
    return replace(model_file(Space.PLANE, effects=(ViscousDrag(),)), alternatives=(("bias_drift", 0.3, other),))


def test_alternatives_come_back_with_their_weight() -> None:
    written = doubted()
    read = ModelFile.from_text(written.to_text())
    assert read.to_text() == written.to_text()
    ((name, weight, other),) = read.alternatives
    assert (name, weight) == ("bias_drift", 0.3)
    assert other.rig is not None
    assert read.rig is not None
    assert other.rig.to_data() == read.rig.to_data()
    assert [effect.id for effect in other.model.effects] == ["bias_drift"]
    (alternative,) = read.calibration.alternatives
    np.testing.assert_array_equal(alternative.calibration.covariance, other.covariance)
    assert (alternative.name, alternative.weight) == ("bias_drift", 0.3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"weight": 1.0}, "alternatives[0].weight"),
        ({"weight": None}, "alternatives[0].weight"),
        ({"name": "two\nlines"}, "alternatives[0].name"),
        ({"model": {}}, "alternatives: bias_drift: base"),
        ({"model": {"convention": "on_tool"}}, "alternatives: they have other axes or signs"),
        ({"model": {"alternatives": doubted().to_data()["alternatives"]}}, "or alternatives of their own"),
    ],
)
def test_an_alternative_that_cannot_be_is_named_in_one_line(change: dict[str, Any], said: str) -> None:
    data = doubted().to_data()
    (stated,) = data["alternatives"]
    model = change.get("model")
    stated |= change if not model else {"model": stated["model"] | model}
    with pytest.raises(InputError) as caught:
        ModelFile.from_data(data, where="model.json")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_weights_leave_some_to_the_model() -> None:
    data = doubted().to_data()
    data["alternatives"] = data["alternatives"] * 4
    with pytest.raises(InputError, match="their weights leave none to the model"):
        ModelFile.from_data(data)


def changed(path: tuple[str | int, ...], value: Any) -> Any:
    """The data of a file with one of its places changed."""
    data: Any = model_file(Space.PLANE).to_data()
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return data


DEFECTS = {
    "format": (("format",), "another", "format"),
    "version": (("version",), 2, "version"),
    "convention": (("convention",), "auto", "convention"),
    "gravity": (("gravity",), -9.8, "gravity"),
    "key": (("colour",), "red", "colour"),
    "channels": (("channels",), ["fx", "fy", "tz"], "channels: tau is missing"),
    "space": (("base",), "spatial", "channels: fz is missing"),
    "effect": (("effects", 0), {"id": "ghost"}, "no effect is called 'ghost'"),
    "effect twice": (("effects", 1), {"id": "com_offset"}, "'com_offset' is in the model already"),
    "option": (("effects", 0), {"id": "com_offset", "options": {"size": 1}}, "no option 'size'"),
    "huge option": (("effects", -3), {"id": "bias_drift", "options": {"degree": 10**9}}, "degree"),
    "value": (("parameters", "m", "value"), "heavy", "parameters.m.value"),
    "unit": (("parameters", "m", "unit"), "lb", "expected the unit kg; got 'lb'"),
    "std": (("parameters", "m", "std"), 1e3, "parameters.m: std"),
    "strange parameter": (
        ("parameters", "width"),
        {"value": 1.0, "std": None, "unit": "m"},
        "parameters: width is not expected",
    ),
    "size": (("covariance", "matrix"), [[1.0]], "covariance: a matrix of"),
    "symmetry": (("covariance", "matrix", 0, 1), 1e9, "not symmetric"),
    "noise": (("noise_floor",), {"fx": 0.1, "fy": 0.1}, "noise_floor: tau is missing"),
    "remainder": (("remainder", "fx"), -1.0, "remainder.fx"),
    "rig": (("rig", "robot"), {"arms": 2}, "rig: robot.arms"),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_is_named_in_one_line(name: str) -> None:
    path, value, said = DEFECTS[name]
    with pytest.raises(InputError) as caught:
        ModelFile.from_data(changed(path, value), where="model.json")
    assert said in str(caught.value)
    assert str(caught.value).startswith("model.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe", b"[]", b"null", b'"model"', b"{", b'{"format": NaN}', b'{"a": 1, "a": 2}', b"[" * 100_000],
    ids=["empty", "binary", "list", "null", "text", "cut", "nan", "twice", "deep"],
)
def test_what_is_no_model_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"model\.json"):
        ModelFile.read(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        ModelFile.read(tmp_path / "model.json")


# ------------------------------------------------------------------------------------- any damage

WHOLE = replace(
    model_file(Space.PLANE, effects=(BiasDrift(degree=1), ViscousDrag())), alternatives=doubted().alternatives
).to_data()


def places(data: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The path to every value in nested data."""
    if path:
        yield path
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in children:
        yield from places(value, (*path, key))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@st.composite
def damaged(draw: st.DrawFn) -> Any:
    """The data of a good file with one to three of its places replaced or removed."""
    data = copy.deepcopy(WHOLE)
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(list(places(data))))
        place: Any = data
        for key in way:
            place = place[key]
        if draw(st.booleans()):
            place[last] = draw(JSON)
        else:
            del place[last]
        if not data:
            break
    return data


def read_or_refuse(text: str) -> None:
    """A damaged file is read, when the damage does not matter, or refused in one line; nothing else happens."""
    refused: InputError | None = None
    try:
        ModelFile.from_text(text).to_text()
    except InputError as error:
        refused = error
    assert "\n" not in str(refused)


@settings(max_examples=300, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(data=damaged())
def test_damaged_data_is_refused_in_one_line(data: Any) -> None:
    read_or_refuse(json.dumps(data))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(start=st.floats(0, 1), length=st.integers(0, 40), instead=st.text(max_size=6))
def test_damaged_text_is_refused_in_one_line(start: float, length: int, instead: str) -> None:
    whole = json.dumps(WHOLE)
    cut = int(start * len(whole))
    read_or_refuse(whole[:cut] + instead + whole[cut + length :])


@pytest.mark.parametrize("number", ["1e999", "-1e999", "1" * 400, "1" * 5000, "1e308", "5e-324"])
def test_extreme_numbers_are_read_or_refused(number: str) -> None:
    for path in places(WHOLE):
        data = copy.deepcopy(WHOLE)
        place: Any = data
        for key in path[:-1]:
            place = place[key]
        if isinstance(place[path[-1]], float):
            place[path[-1]] = "NUMBER"
            read_or_refuse(json.dumps(data).replace('"NUMBER"', number))
