"""Templates of the reports, as HTML and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from modeling.number_format import format_percentage, typeset_text
from truewrench.effect_description import SKETCH_STYLE
from truewrench.effect_description.formula_mathml import formula_mathml
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MEASURED, MISFIT_COLOUR, NOISE, QUIET_NOISE
from truewrench.reports.markdown import markdown_table, markdown_text
from truewrench.reports.zoom.plotly_script import loader_script, packed_plotly, script_hash

LEGEND = (
    (MEASURED, "measured"),
    (MISFIT_COLOUR, "a model that does not fit; cells of a residual map above tolerance"),
    (ADEQUATE_COLOUR, "a model that fits, or the better one; errors of fitted recordings"),
    (HELD_OUT, "errors of held-out recordings; a transient event"),
    (NOISE, "noise of one sample; tolerance"),
    (QUIET_NOISE, "noise of the mean over the repeats"),
)
"""Colours of all pictures and what they stand for."""


def page_templates() -> Environment:
    """Templates of `truewrench/templates`; values are escaped, a missing one is an error."""
    environment = Environment(
        loader=PackageLoader("truewrench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"percentage": format_percentage, "typeset": typeset_text, "formula": _formula}
    environment.globals |= {"legend": LEGEND, "sketch_style": Markup(SKETCH_STYLE), "packed_plotly": packed_plotly}
    return environment


def _formula(text: str) -> Markup:
    """A formula of the catalogue or of a user, typeset."""
    return Markup(formula_mathml(text))  # escaped there


def html_page(template: str, values: Mapping[str, Any]) -> str:
    """A page of these values, with the script that zooms its figures where it has any."""
    script = loader_script()
    found = page_templates().get_template(template)
    return found.render(**values, zooms=True, script=script, script_hash=script_hash(script))


def markdown_page(template: str, values: Mapping[str, Any]) -> str:
    """A Markdown text of these values, in which the text of users is escaped."""
    environment = page_templates().overlay(autoescape=False, finalize=markdown_text)
    environment.filters["table"] = markdown_table
    text = environment.get_template(template).render(**values)
    lines = text.splitlines()
    kept = [line for i, line in enumerate(lines) if line.strip() or (i and lines[i - 1].strip())]
    return "\n".join(kept).strip() + "\n"
