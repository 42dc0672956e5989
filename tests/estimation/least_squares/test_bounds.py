"""Bounds and priors as people write them, what is wrong with them in one line, and sets of them that contradict."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.least_squares.bounds import Bounds
from estimation.least_squares.constraints import BoundSide, Constraints, FeasibleRegion, irreducible_infeasible_subset
from estimation.least_squares.prior import Prior
from estimation.parameter_layout import ParameterLayout
from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.pseudo_inertia import pseudo_inertia
from modeling.errors import InputError

DRAGGED = planar() + effects.viscous_drag()


def unknowns(model: WrenchModel) -> ParameterLayout:
    return ParameterLayout(model, model.parameters, (model,), (np.arange(len(model.parameters)),))


def region(model: WrenchModel, bounds: dict[str, object], *, physical: bool = False) -> FeasibleRegion:
    return Constraints(bounds=Bounds.from_data(bounds), physical=physical).region(unknowns(model))


# ------------------------------------------------------------------------------------------- bounds


def test_a_file_of_bounds(tmp_path: Path) -> None:
    """Quoted, dotted and tabled names are the same name; `inf` leaves a side open."""
    path = tmp_path / "bounds.toml"
    path.write_text('m = [0.1, 3]\nmlg = [-inf, 1]\n"viscous_drag.c" = [0, 2]\nviscous_drag.d = [0, 0.5]\n')
    expected = {"m": (0.1, 3.0), "mlg": (-inf, 1.0), "viscous_drag.c": (0.0, 2.0), "viscous_drag.d": (0.0, 0.5)}
    found = Bounds.read(path)
    assert found.intervals == expected
    numbers = Constraints(bounds=found).region(unknowns(DRAGGED))
    names = [p.name for p in DRAGGED.parameters]
    assert [(numbers.low[names.index(n)], numbers.high[names.index(n)]) for n in expected] == list(expected.values())
    assert numbers.low[names.index("I")] == -inf


def test_a_number_fixes_a_parameter(tmp_path: Path) -> None:
    path = tmp_path / "bounds.toml"
    path.write_text("m = 0.9")
    expected = {"m": (0.9, 0.9)}
    assert Bounds.read(path).ends == Bounds({"m": 0.9}).ends == Bounds({"m": (0.9, 0.9)}).ends == expected
    assert Constraints.of({"m": 0.9}).region(unknowns(DRAGGED)).fixed.sum() == 1
    assert Constraints.of(Bounds({"m": 0.9})) == Constraints(bounds=Bounds({"m": 0.9}))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["m"], "constraints: a list is no set of constraints; give bounds by parameter"),
        ("bounds.toml", "constraints: a str is no set of constraints"),
        ({"m": "heavy"}, "bounds: m: one or two numbers were expected, and 'heavy' came"),
        ({"m": (2, 1)}, r"bounds: m: \[2, 1\] contains no finite value"),
    ],
)
def test_what_constrains_nothing_is_said_in_one_line(given: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Constraints.of(given)
    with pytest.raises(InputError, match="a list has no intervals by parameter name"):
        Bounds([("m", 1.0)])  # type: ignore[arg-type]


def test_an_effects_own_range_stays(tmp_path: Path) -> None:
    names = [p.name for p in DRAGGED.parameters]
    drag = names.index("viscous_drag.c")
    assert region(DRAGGED, {}).low[drag] == 0
    wider = region(DRAGGED, {"viscous_drag.c": [-5, 5]})
    assert (wider.low[drag], wider.high[drag]) == (0, 5)
    with pytest.raises(
        InputError, match=r"bounds: viscous_drag.c >= 0 N s/m \(its effect's range\) and viscous_drag.c"
    ):
        region(DRAGGED, {"viscous_drag.c": [-5, -1]})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("m = [1.0]", "m: one or two numbers were expected"),
        ("m = [0, 1, 2]", "m: one or two numbers were expected"),
        ("m = [2, 1]", r"m: \[2, 1\] contains no finite value"),
        ("m = [inf, inf]", "m: .* contains no finite value"),
        ("m = [nan, 1]", "m: one or two numbers were expected"),
        ("m = [true, 2]", "m: one or two numbers were expected"),
        ('m = ["0", "1"]', "m: one or two numbers were expected"),
        ("m = [0, 1", "not a TOML file"),
        ("a.b = [0, 1]\n'a.b' = [0, 2]", "'a.b' appears twice"),
    ],
)
def test_what_is_no_bound_is_said_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bounds.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        Bounds.read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("reader", [Bounds.read, Prior.read])
def test_a_file_that_is_not_there(reader: type, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        reader(tmp_path / "none.toml")
    with pytest.raises(InputError, match="null byte"):
        reader("bad\0name")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not a TOML file"):
        reader(tmp_path / "binary.toml")


def test_an_unknown_name_gets_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'viscous_darg.c'; did you mean viscous_drag.c"):
        region(DRAGGED, {"viscous_darg.c": [0, 1]})
    with pytest.raises(InputError, match="use one of bias_fx, bias_fy, bias_tau, m, mlg, I"):
        region(planar(), {"zzzzzz": [0, 1]})


# ------------------------------------------------------------------------------------------- priors

CAD = {"weight": 200.0, "m": 0.9, "mlg": 0.063, "I": 0.0129}


def test_a_file_of_a_prior(tmp_path: Path) -> None:
    path = tmp_path / "cad.toml"
    path.write_text("".join(f"{name} = {value}\n" for name, value in CAD.items()))
    found = Prior.read(path)
    assert found.weight == 200
    assert found.values == {name: value for name, value in CAD.items() if name != "weight"}
    assert Constraints(prior=found).region(unknowns(planar())).prior is not None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"weight": None}, "weight is missing"),
        ({"weight": -1.0}, "weight: -1 is negative"),
        ({"weight": inf}, "weight: a number was expected"),
        ({"m": "heavy"}, "m: a number was expected, and 'heavy' came"),
        ({"I": None}, "I is missing"),
        ({"bias_fx": 1.0}, "no parameter is called 'bias_fx'"),
        ({"I": 0.0044}, "no tool has these moments: m I >= mlg² does not hold strictly"),
        ({"m": -0.9, "I": -0.0129}, "no tool has these moments"),
    ],
)
def test_what_is_no_prior_is_said_in_one_line(changes: dict[str, object], said: str) -> None:
    """0.9 · 0.0044 < 0.063²."""
    data = {name: value for name, value in (CAD | changes).items() if value is not None}
    with pytest.raises(InputError, match=said):
        Constraints(prior=Prior.from_data(data, where="cad.toml")).region(unknowns(planar()))


# ---------------------------------------------------------------------------------- contradictions


def test_the_contradiction_is_named() -> None:
    """0.5 · 0.1 < 1²; the bounds of the bias and the other ends have nothing to do with it."""
    bounds: dict[str, object] = {"bias_fx": [0, 1], "m": [0, 0.5], "mlg": [1, 2], "I": [0, 0.1]}
    said = (
        r"m <= 0.5 kg, mlg >= 1 kg m and I <= 0.1 kg m² are infeasible together with physical consistency, m I >= mlg²"
    )
    with pytest.raises(InputError, match=said):
        region(planar(), bounds, physical=True)
    region(planar(), bounds)
    region(planar(), bounds | {"I": [0, 2.1]}, physical=True)


def test_one_bound_can_contradict_alone() -> None:
    """Nothing has a mass of zero and a position; with a prior as without."""
    with pytest.raises(InputError, match=r"bounds: m <= -1 kg is infeasible with physical consistency"):
        region(planar(), {"m": [-2, -1]}, physical=True)
    constraints = Constraints(bounds=Bounds.from_data({"m": [-2, 0]}), prior=Prior.from_data(CAD))
    with pytest.raises(InputError, match="m <= 0 kg is infeasible"):
        constraints.region(unknowns(planar()))


def test_six_axes_know_the_triangle() -> None:
    """Ixx <= Iyy + Izz, and of a bound on an unrelated moment nothing is said."""
    bounds: dict[str, object] = {"Ixx": [0.31, 1], "Iyy": [0, 0.1], "Izz": [0, 0.2], "Ixy": [-1, 1], "m": [1, 2]}
    with pytest.raises(InputError, match=r"Ixx >= 0.31 kg m², Iyy <= 0.1 kg m² and Izz <= 0.2 kg m² are infeasible"):
        region(spatial(), bounds, physical=True)
    region(spatial(), bounds | {"Ixx": [0.29, 1]}, physical=True)


def possible(sides: list[BoundSide], names: list[str]) -> bool:
    """Whether m I > mlg², m > 0 has a solution between the ends: an oracle without any solver.

    m and I as large as they may be, mlg as near to 0 as it may be.
    """
    ends = {(names[s.index], s.lower): s.value for s in sides}
    m, inertia = ends.get(("m", False), inf), ends.get(("I", False), inf)
    mlg = max(0.0, ends.get(("mlg", True), -inf), -ends.get(("mlg", False), inf))
    return m > 0 and inertia > 0 and (m * inertia > mlg**2)


def test_random_contradictions_are_minimal() -> None:
    """All ends together contradict exactly when the oracle says so, and of those named none can be spared.

    Boxes of random size over three decades; nearly touching ones (within 1 %) are left out.
    """
    rng, names = np.random.default_rng(6), [p.name for p in planar().parameters]
    inertia, refused = pseudo_inertia(planar()).over(names), 0
    for _ in range(12):
        low = {name: rng.normal() * 10 ** rng.uniform(-2, 1) for name in ("m", "mlg", "I")}
        bounds = {name: [value, value + 10 ** rng.uniform(-2, 1)] for name, value in low.items()}
        sides = list(Constraints(bounds=Bounds.from_data(dict(bounds))).region(unknowns(planar())).sides)
        margins = [possible([_eased(s, factor) for s in sides], names) for factor in (-0.01, 0.01)]
        if margins[0] != margins[1]:
            continue
        if margins[0]:
            region(planar(), dict(bounds), physical=True)
            continue
        refused += 1
        with pytest.raises(InputError, match="infeasible"):
            region(planar(), dict(bounds), physical=True)
        named = irreducible_infeasible_subset(inertia, sides)
        assert not possible(named, names)
        assert all(possible([s for s in named if s is not left], names) for left in named)
    assert 3 < refused < 9


def _eased(side: BoundSide, share: float) -> BoundSide:
    moved = side.value + (-1 if side.lower else 1) * share * abs(side.value)
    return BoundSide(side.index, side.lower, moved, side.text)
