"""The page of a discovery: the equation typeset, its constants, error on both motions, and what else fits."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import truewrench as tw
from diagnosis.discovery.discovery import Discovery
from diagnosis.discovery.grammar import Term
from diagnosis.discovery.quantities import Quantity
from diagnosis.discovery.search import ScoredTerm
from modeling.formulas.units import DIMENSIONLESS
from modeling.space import Space
from tests.shared.recordings import base, recorded
from truewrench.effect_description.formula_mathml import formula_mathml
from truewrench.reports.discovery_report import symbols_sentence, told_apart, typeset_formula
from truewrench.simulated_rig import HiddenEffect, MagnusForce

pytest.importorskip("mujoco")

SPIN = MagnusForce(c=0.06, d=0.12)


@cache
def discovered(*hidden: HiddenEffect, complexity: int) -> Discovery:
    training, other = (recorded(Space.PLANE, *hidden, seed=m, motion=m, name=f"motion {m}") for m in (1, 2))
    return tw.discover(base(Space.PLANE), training, validate=other, complexity=complexity)


def texts(found: Discovery, folder: Path) -> tuple[str, str]:
    """The page and the Markdown of a report."""
    page, markdown = tw.report(found, folder)
    return page.read_text(encoding="utf-8"), markdown.read_text(encoding="utf-8")


def words(html: str) -> str:
    """What a reader sees, without pictures, blanks as one."""
    body = re.sub(r"<(script|style).*?</\1>|<img[^>]*>", "", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", body)))


def leaf(name: str) -> Quantity:
    """A vector of the chain, or a coordinate; units are not shown."""
    return Quantity(name, (), name, name != "x", DIMENSIONLESS)


@pytest.mark.long
def test_an_equation_has_its_constants_its_errors_on_both_motions_and_its_rivals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rival is made, as there is none; what a discovery says of rivals by itself is not on trial."""
    monkeypatch.setattr(Discovery, "remarks", lambda _: [])
    found = discovered(SPIN, complexity=4)
    (equation,) = found.equations
    assert not equation.found.alternatives
    best = equation.found.best.scored
    rival = replace(best, term=replace(best.term, at_point=False), score=0.7 * best.score)
    near = replace(equation, found=replace(equation.found, alternatives=((rival, 12.0),)))
    html, markdown = texts(replace(found, equations=(near,)), tmp_path)
    assert '<mi>v</mi><mspace width="0.2em"/><mtext>×</mtext><mspace width="0.2em"/><mi>w</mi>' in html
    assert 'class="verdict explained"' in html
    value, std, _ = equation.parameters["c"]
    for text in (words(html), markdown.replace("\\", "")):
        assert "F = c v × w at d" in text
        assert "on motion 2, where its constants were not fitted" in text
        assert "v velocity of the point where it acts (m/s)" in text
        assert all(name in text for name in ("motion 1 (fitted)", "motion 2 (held out)", "noise floor", "N·m"))
        assert f"{value:.4f} ± {std:.4f}".replace("-", "−") in text
        assert "1 : 12" in text
        assert "at the sensor's origin; it explains 70.0 % of what the best one does, with complexity 3 for 4" in text
        assert "nan" not in text.lower().split()


@pytest.mark.long
def test_where_there_is_none_it_says_so_and_what_the_rest_depends_on(tmp_path: Path) -> None:
    none = replace(discovered(complexity=2), depends_on={"q3": 0.4})
    html, markdown = texts(none, tmp_path)
    for text in (words(html), markdown):
        assert "No equation up to complexity 2" in text
        assert re.search(r"q3 \|? ?40(\.0)?.%", text)
    assert 'class="verdict unexplained"' in html
    assert "effects file" not in html


def test_a_coordinate_is_no_sign_of_a_product() -> None:
    v, w, r, x, up = (leaf(name) for name in ("v", "w", "r", "x", "up"))
    for quantity, shown in (
        (x.times(v.cross(w)), "F = c x (v × w)"),
        (v.cross(w).dot(up).power(2).times(r), "F = c ((v × w)·up)^2 r"),
        (x.times(w.norm().power(-1)).times(v), "F = c x |w|^-1 v"),
        (x.times(v.norm()).power(2).times(v), "F = c (x |v|)^2 v"),
        (v.dot(up).sign().times(w), "F = c sign(v·up) w"),
    ):
        term = Term("force", quantity, at_point=True)
        assert typeset_formula(term, Space.PLANE) == f"{shown} at d"
        typeset = ElementTree.fromstring(f"<div>{formula_mathml(shown)}</div>")
        assert re.sub(r"\s", "", "".join(typeset.itertext())) == re.sub(r"[\s^]", "", shown).replace("-", "−")
        said = symbols_sentence(term)
        assert all(f"{name} " in said for name in quantity.leaves)
        assert "d distance of the point" in said


def test_what_differs_is_named() -> None:
    v, w, r = (leaf(name) for name in ("v", "w", "r"))
    best, other, shorter = (
        ScoredTerm(Term("force", q), {}, np.ones(1), np.eye(1), s)
        for q, s in ((v.cross(w), 90.0), (v.cross(r), 45.0), (v, 90.0))
    )
    assert told_apart(best, other) == "r instead of w; it explains 50.0 % of what the best one does"
    assert told_apart(best, shorter) == "without w; it explains all of what the best one does, with complexity 1 for 3"
    assert told_apart(shorter, best).startswith("also w; ")
    assert "another form" in told_apart(best, replace(best, term=Term("force", w.norm().times(v))))
