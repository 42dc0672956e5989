"""Templates of the reports, as HTML and as Markdown."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from modeling.number_format import format_percentage, typeset_text
from modeling.table import Table
from truewrench.effect_description import SKETCH_STYLE
from truewrench.effect_description.formula_mathml import formula_mathml
from truewrench.plots.interactive_figure import can_zoom, library
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MEASURED, MISFIT_COLOUR, NOISE, QUIET_NOISE

# Markdown of a report: escaped text, and tables.


_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~!$&])")
_LINE_BREAKS = re.compile(r"[\s\x00-\x1f\x85\u2028\u2029]+")


def markdown_text(value: Any) -> Any:
    """A value as Markdown that shows it as it is: special characters are escaped, line breaks are spaces.

    What is Markdown already, a `Markup`, stays.
    """
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return _SPECIAL.sub(r"\\\1", _LINE_BREAKS.sub(" ", value))


def markdown_table(table: Table) -> Markup:
    """The table in Markdown, with an empty heading where it has none."""
    columns = table.filled.columns
    headings = [markdown_text(c.typeset_heading) for c in columns]
    rules = ["---:" if c.format else "---" for c in columns]
    rows = [[markdown_text(c.typeset(v)) for c, v in zip(columns, row, strict=True)] for row in table.filled.rows]
    return Markup("\n".join(f"| {' | '.join(cells)} |" for cells in [headings, rules, *rows]))  # escaped


# Pages of a report.


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
    environment.filters |= {"percentage": format_percentage, "typeset": typeset_text, "formula": typeset}
    environment.globals |= {"legend": LEGEND, "sketch_style": Markup(SKETCH_STYLE), "can_zoom": can_zoom}
    return environment


def typeset(text: str) -> Markup:
    """A formula of the catalogue or of a user, typeset."""
    return Markup(formula_mathml(text))  # escaped there


def html_page(template: str, values: Mapping[str, Any]) -> str:
    """A page of these values, with what draws its interactive figures; static pictures where Bokeh is not installed."""
    shown = library() if can_zoom() else {}
    return page_templates().get_template(template).render(**values, **shown)


def markdown_page(template: str, values: Mapping[str, Any]) -> str:
    """A Markdown text of these values, in which the text of users is escaped."""
    environment = page_templates().overlay(autoescape=False, finalize=markdown_text)
    environment.filters["table"] = markdown_table
    text = environment.get_template(template).render(**values)
    lines = text.splitlines()
    kept = [line for i, line in enumerate(lines) if line.strip() or (i and lines[i - 1].strip())]
    return "\n".join(kept).strip() + "\n"
