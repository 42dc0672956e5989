"""The page of a discovery: the equation typeset, its constants, error on both motions, and what else fits."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path
from xml.etree import ElementTree

import pytest

import truewrench as tw
from diagnosis.discovery.discovery import Discovery, recorded_leaves, shape_ranges
from diagnosis.discovery.grammar import terms
from diagnosis.discovery.search import TermSearch
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


@pytest.mark.long
def test_an_equation_has_its_constants_its_errors_on_both_motions_and_its_rivals(tmp_path: Path) -> None:
    found = discovered(SPIN, complexity=4)
    leaves, angles, inputs = recorded_leaves(found.first, found.held_out)
    scored, _ = TermSearch(found.first, leaves, shape_ranges(found.first)).scored(
        terms(leaves, angles, list(inputs), 3)
    )
    (equation,) = found.equations
    assert not equation.found.alternatives
    best, rival = equation.found.best.scored, next(s for s in scored if s.term.formula == "F = c v x w")
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
        assert "at the sensor's origin; it explains" in text
        assert "nan" not in text.lower().split()
    assert told_apart(rival, best).endswith("with complexity 4 for 3")


@pytest.mark.long
def test_where_there_is_none_it_says_so_and_what_the_rest_depends_on(tmp_path: Path) -> None:
    none = replace(discovered(complexity=2), depends_on={"q3": 0.4})
    html, markdown = texts(none, tmp_path)
    for text in (words(html), markdown):
        assert "No equation up to complexity 2" in text
        assert re.search(r"q3 \|? ?40(\.0)?.%", text)
    assert 'class="verdict unexplained"' in html
    assert "effects file" not in html


def test_every_term_is_typeset() -> None:
    """A coordinate is called x: the sign of a vector product is another."""
    leaves, angles, inputs = recorded_leaves(discovered(complexity=2).first, discovered(complexity=2).held_out)
    for term in terms(leaves, angles, list(inputs), 5):
        text = typeset_formula(term, Space.PLANE)
        ElementTree.fromstring(f"<div>{formula_mathml(text)}</div>")
        assert text.count("×") == term.formula.count(" x ") - sum(
            name == "x" for name in re.findall(r"(?<= )x(?= )", text)
        )
        assert symbols_sentence(term).endswith(".")
        assert not re.search(r"\^-(?!\d)", text)
