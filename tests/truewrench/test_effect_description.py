"""Sketches, meanings and equations of every effect: complete, well-formed, and true to the model's load."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
import sympy as sp
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.effects import catalogue, named
from modeling.rig import Rig
from modeling.space import Space
from truewrench.effect_description import effect_sketch
from truewrench.effect_description.effect_equations import effect_equations
from truewrench.effect_description.effect_sketch import HEIGHT, WIDTH
from truewrench.effect_description.equation_texts import EquationTexts, equation_texts
from truewrench.effect_description.formula_mathml import GREEK, formula_mathml
from truewrench.effect_description.mathml import mathml

MODELS = {
    Space.PLANE: planar(Rig(name="arm", link_lengths=(0.4, 0.3, 0.2), gravity=9.8)),
    Space.SPACE: spatial(),
}
CASES = [(effect, space) for space in Space for effect in catalogue(space)]
DESCRIBED = [(e, s) for e, s in CASES if s is Space.PLANE or not e.needs_joints]
ADDED = [
    ("viscous_drag", Space.PLANE),
    ("quadratic_drag", Space.PLANE),
    ("coulomb_friction", Space.PLANE),
    ("viscous_drag", Space.SPACE),
    ("coulomb_friction", Space.SPACE),
    pytest.param("quadratic_drag", Space.SPACE, marks=pytest.mark.long),
]


def case_name(value: object) -> str:
    return value.id if isinstance(value, Effect) else str(getattr(value, "name", value)).lower()


@pytest.mark.parametrize("effect", catalogue(), ids=case_name)
def test_sketch_is_well_formed_and_within_its_frame(effect: Effect) -> None:
    drawn = ElementTree.fromstring(effect_sketch(effect))
    assert drawn.attrib["aria-label"] == f"Sketch: {effect.title}"
    assert any(e.attrib.get("class") == "parameter" for e in drawn.iter("text"))
    for path in drawn.iter("path"):
        points = np.array([p.split() for p in path.attrib["d"].strip("MZ ").split(" L")], dtype=float)
        assert (points >= 0).all()
        assert (points <= (WIDTH, HEIGHT)).all()


@pytest.mark.parametrize("effect", catalogue(), ids=case_name)
def test_no_word_of_a_sketch_is_cut_off(effect: Effect) -> None:
    """By the widths of DejaVu Sans, the widest of the common fonts."""
    drawn = ElementTree.fromstring(effect_sketch(effect))
    left, top, width, height = map(float, drawn.attrib["viewBox"].split())
    for text in drawn.iter("text"):
        bold = "semibold" if text.attrib.get("class") == "parameter" else "normal"
        size = TextPath(
            (0, 0), text.text or "", size=11, prop=FontProperties(family="DejaVu Sans", weight=bold)
        ).get_extents()
        x, y = float(text.attrib["x"]), float(text.attrib["y"])
        start = x - size.width * {"end": 1.0, "middle": 0.5}.get(text.attrib.get("text-anchor", ""), 0.0)
        assert left <= start, text.text
        assert start + size.width <= left + width, text.text
        assert top <= y - size.y1, text.text
        assert y - size.y0 <= top + height, text.text


def parameters_of(equation: ElementTree.Element) -> set[str]:
    """Names of the parameters in an equation; of a letter with an index the index."""
    marked = {e.text or "" for e in equation.iter("mi") if "class" in e.attrib}
    letters = {e[0].text or "" for e in equation.iter("msub") if "class" in e.attrib}
    return {"tau" if name == "τ" else name for name in marked - letters}


@pytest.mark.parametrize(("effect", "space"), DESCRIBED, ids=case_name)
def test_equations_are_well_formed_and_have_the_parameters(effect: Effect, space: Space) -> None:
    found = effect_equations(effect, MODELS[space])
    texts = EquationTexts() if found is None else EquationTexts(tuple(found.mathml), found.symbols)
    assert equation_texts(effect, MODELS[space]) == texts
    if found is None:  # its equations are too long, or between tool and world: the stated one is shown
        return
    shown = set().union(*(parameters_of(ElementTree.fromstring(text)) for text in found.mathml))
    free = {p.name for p in effect.parameters(space) if not p.fixed}
    assert shown <= free
    # What is only in the times of an event, or in channels that are not listed, is not in an equation.
    assert shown or effect.id == "payload_change"
    assert found.symbols


def motion_in_sensor_axes(model: WrenchModel, seed: int) -> tuple[dict[sp.Symbol, float], dict[sp.Symbol, float]]:
    """Random signals, and the same motion by its components in sensor axes."""
    drawn = np.random.default_rng(seed)
    motion = model.space.motion
    signals = sorted(set().union(*(m.free_symbols for m in vars(motion).values())), key=str)
    values = dict(zip(signals, drawn.uniform(-1, 1, len(signals)), strict=True))
    if model.space is Space.SPACE:
        turn = [s for s in signals if str(s) in ("qx", "qy", "qz", "qw")]
        size = np.sqrt(sum(values[s] ** 2 for s in turn))
        values |= {s: values[s] / size for s in turn}
    rotation = np.array(motion.rotation.subs(values), dtype=float)
    lift = np.array((motion.acceleration + 9.8 * model.space.up).subs(values), dtype=float)
    vectors = {
        "v": rotation.T @ np.array(motion.velocity.subs(values), dtype=float),
        "a": rotation.T @ lift,
        "omega": np.array(motion.omega.subs(values), dtype=float),
        "alpha": np.array(motion.alpha.subs(values), dtype=float),
    }
    return values, _components(model.space, {k: v.ravel() for k, v in vectors.items()})


def _components(
    space: Space, vectors: dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]
) -> dict[sp.Symbol, float]:
    """By axis; in the plane y' is opposite to the second axis, and a rotation has one component."""
    named_values = {f"{k}_{axis}": v for k, vector in vectors.items() for axis, v in zip("xyz", vector, strict=True)}
    if space is Space.PLANE:
        named_values |= {"v_y": -named_values["v_y"], "a_y": -named_values["a_y"]}
        named_values |= {k: named_values[f"{k}_z"] for k in ("omega", "alpha")}
    return {sp.Symbol(name, real=True): float(value) for name, value in named_values.items()}


@pytest.mark.parametrize(("effect_id", "space"), ADDED, ids=case_name)
def test_equations_are_the_change_of_the_models_load(effect_id: str, space: Space) -> None:
    """Against the model's own load in world axes, at a random motion and random parameters."""
    model = MODELS[space].with_arm(None)
    effect = named(effect_id)
    found = effect_equations(effect, model)
    assert found is not None
    parameters = {p.symbol: 0.3 + 0.1 * i for i, p in enumerate((model + effect).parameters)}
    signals, components = motion_in_sensor_axes(model, seed=1)
    change = ((model + effect).load - model.load).subs(parameters | signals).evalf()
    derived = {str(left): float(right.subs(parameters | components)) for left, right in found.pairs}
    expected = {f"Delta_{c}": float(v) for c, v in zip(space.channels, change, strict=True)}
    for name, value in expected.items():
        # rounding, and 1e-12 under the root of the quadratic drag
        np.testing.assert_allclose(derived.get(name, 0.0), value, atol=1e-9)


def test_mathml_escapes_and_writes_no_named_entity() -> None:
    x = sp.Symbol("<b>&x", real=True)
    text = f"<math>{mathml(2 * x * sp.exp(-x) + sp.Derivative(sp.Symbol('theta'), sp.Symbol('t')))}</math>"
    assert "<b>&x" in "".join(ElementTree.fromstring(text).itertext())
    assert "θ" in "".join(ElementTree.fromstring(text).itertext())


@pytest.mark.parametrize("effect", catalogue(), ids=case_name)
def test_stated_formulas_are_typeset_with_nothing_lost(effect: Effect) -> None:
    """Every name and number of the formula is in the MathML, which is well-formed."""
    found = ElementTree.fromstring(f"<div>{formula_mathml(effect.equation)}</div>")
    shown = "".join(found.itertext())
    for word in re.findall(r"[^\W_]+", re.sub("[²³]", " ", effect.equation)):
        assert GREEK.get(word, word) in shown, word
    assert "_" not in shown or "time_constant" in shown


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("k u_1²=0", "<mi>k</mi>|<msup><msub><mi>u</mi><mi>1</mi></msub><mn>2</mn></msup><mo>=</mo><mn>0</mn>"),
        ("a**2", "<msup><mi>a</mi><mn>2</mn></msup>"),
        ("-x<y", "<mo>−</mo><mi>x</mi><mo>&lt;</mo><mi>y</mi>"),
        ("<script>&", "<mo>&lt;</mo><mi>script</mi><mo>&gt;</mo><mtext>&amp;</mtext>"),
    ],
)
def test_formula_piece_by_piece(text: str, expected: str) -> None:
    space = '<mspace width="0.2em"/>'
    assert formula_mathml(text) == f"<math><mrow>{expected.replace('|', space)}</mrow></math>"


def test_a_parameter_with_the_name_of_a_channel_has_a_letter() -> None:
    found = effect_equations(named("sensor_hysteresis"), MODELS[Space.PLANE])
    assert found is not None
    assert '<msub class="parameter"><mi class="parameter">h</mi><mi class="parameter">fx</mi></msub>' in found.mathml[0]
    assert "h is the parameter of the channel in its index" in found.symbols
