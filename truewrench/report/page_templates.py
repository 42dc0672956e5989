"""Templates of the HTML pages."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined

from modeling.number_format import format_percentage


def page_templates() -> Environment:
    """Templates of `truewrench/templates`; values are escaped, a missing one is an error."""
    environment = Environment(
        loader=PackageLoader("truewrench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["percentage"] = format_percentage
    return environment
