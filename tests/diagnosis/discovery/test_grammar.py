"""Terms of the grammar: what is scored is the derivative of the custom effect that comes out."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from diagnosis.discovery.discovery import effect_toml
from diagnosis.discovery.grammar import Term, terms
from diagnosis.discovery.leaves import DISTANCE, EDGE, LENGTH, PLACE, RATE, SPEED, TIME, WIDTH, recorded_leaves
from diagnosis.discovery.term_columns import TermColumns
from diagnosis.screening.null_model import NullModel, RowSet, WhitenedColumns
from diagnosis.screening.whitened_sensitivity import GridPoint, score_columns
from estimation.fit import Fit, fit
from modeling.space import Space
from tests.shared.recordings import base, recorded
from truewrench.files.effects_file import read_effects

pytest.importorskip("mujoco")

SHAPES = {DISTANCE: 0.13, **dict(zip(PLACE, (2.1, 1.7, 0.4), strict=True)), EDGE: 0.05, WIDTH: 0.3}
SHAPES |= {SPEED: 0.4, RATE: 1.2, TIME: 3.0, LENGTH: 0.4}
SAMPLE = 12
"""Terms of each space, drawn with a seed, besides one of every kind."""


@cache
def fitted(space: Space) -> Fit:
    return fit(base(space), recorded(space, seed=1, motion=1, repeats=2))


def sampled_terms(space: Space, fit_of: Fit) -> list[Term]:
    """One term of every combination of leaves that a short one may have, and some of all."""
    leaves, angles, inputs = recorded_leaves(fit_of, fit_of.recordings)
    everything = terms(leaves, angles, list(inputs), space.channels, 6)
    chosen = [everything[place] for place in np.random.default_rng(3).choice(len(everything), SAMPLE, replace=False)]
    wanted = [
        *("F = c v x w at d", "F = c |n|^-3 n at d", "F = c into_y up at d", "T = h x w", "F = |v| k"),
        *("F = c |v|^1.5 v at d", "F = c v_sat at d", "T = c w_drop", "F = c falling_y up at d"),
        *("zero = c fx", "zero = c fx fy", "zero = c fy^3", "zero = harmonic(q1) fx", "zero = c |w| fx"),
        "zero = c fading",
        *("F = c |rho| rho at d", "F = c w x (w x e)"),
    ]
    quadratics = [term for term in everything if "quadratic" in term.formula]
    return chosen + quadratics[:2] + [term for term in everything if term.formula in wanted]


@pytest.mark.parametrize("space", Space)
def test_columns_are_those_of_the_custom_effect(space: Space) -> None:
    of = fitted(space)
    leaves, _, inputs = recorded_leaves(of, of.recordings)
    compared = 0
    for term in sampled_terms(space, of):
        shapes = {name: SHAPES[name] for name in term.shapes(leaves)}
        columns = TermColumns(NullModel(of), leaves, shapes).projected([term]).whitened
        assert isinstance(columns, WhitenedColumns)
        if not columns.columns.any():
            continue
        effect = term.effect(space, "found_1", leaves, inputs, {name: [value] for name, value in shapes.items()})
        model = of.model + effect
        amplitudes = tuple(p for p in model.effects[-1].qualified(space) if not p.nuisance)
        own = {p.name for p in effect.parameters(space)}  # a force along the tip is the same at every point of it
        point = GridPoint({f"found_1.{name}": value for name, value in shapes.items() if name in own}, amplitudes)
        derived = score_columns(of, model, [point], columns.choice)[:, 0]
        names = [p.name.removeprefix("found_1.") for p in amplitudes]
        shown = [name in names for name in term.amplitudes(space)]
        assert [name for name in term.amplitudes(space) if name in names] == names, term.formula
        scale = np.abs(derived).max()
        np.testing.assert_allclose(columns.columns[:, 0, shown], derived, atol=1e-9 * scale, err_msg=term.formula)
        assert not columns.columns[:, 0, np.logical_not(shown)].any(), term.formula
        compared += 1
    assert compared > SAMPLE / 2


@pytest.mark.parametrize("space", Space)
def test_all_terms_up_to_a_complexity(space: Space) -> None:
    of = fitted(space)
    leaves, angles, inputs = recorded_leaves(of, of.recordings)
    shorter, longer = (terms(leaves, angles, list(inputs), space.channels, size) for size in (4, 5))
    assert len(set(longer)) == len(longer)
    assert set(shorter) <= set(longer)
    assert {term.complexity for term in shorter if term.complexity > 4} <= {5}  # of a place, or from an edge on


@pytest.mark.parametrize("space", Space)
def test_an_effects_file_gives_the_effect_again(space: Space, tmp_path: Path) -> None:
    of = fitted(space)
    leaves, _, inputs = recorded_leaves(of, of.recordings)
    for term in sampled_terms(space, of)[-5:]:
        shapes = {name: [SHAPES[name]] for name in term.shapes(leaves)}
        effect = term.effect(space, "found_1", leaves, inputs, shapes)
        path = tmp_path / "effect.toml"
        path.write_text(effect_toml(effect), encoding="utf-8")
        assert read_effects(path) == (effect,), term.formula


def test_rows_of_a_periodic_term_are_those_of_the_motion() -> None:
    of = fitted(Space.PLANE)
    leaves, angles, inputs = recorded_leaves(of, of.recordings)
    (drag,) = (
        term for term in terms(leaves, angles, list(inputs), Space.PLANE.channels, 3) if term.formula == "F = c v"
    )
    assert TermColumns(NullModel(of), leaves, {}).projected([drag]).whitened.choice == (RowSet.EXCITED,)
