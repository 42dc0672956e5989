"""Jinja templates of generated code, and the values of a fitted model that fill them."""

from __future__ import annotations

from typing import Any

import numpy as np

from modeling.codegen.code_style import CodeStyle
from modeling.codegen.documentation import parameter_comment
from modeling.codegen.expression_text import comment_text
from modeling.codegen.fitted_model import FittedModel
from modeling.dynamics.discrete_deflection import NEWTON_STEPS
from modeling.dynamics.discrete_transfer_function import DiscreteTransferFunction
from modeling.expressions.straight_line_program import StraightLineProgram


def render_template(name: str, values: dict[str, Any]) -> str:
    """The template rendered with the values; a missing value is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("modeling.codegen"),
        undefined=StrictUndefined,
        autoescape=False,  # source code, not HTML: users' names pass through comment_text before
        keep_trailing_newline=True,
    )
    return environment.get_template(name).render(values)


def template_values(fitted: FittedModel, style: CodeStyle) -> dict[str, Any]:
    """The values that the templates of every language take."""
    discrete, names, size = fitted.discrete, list(fitted.parts), fitted.size
    sample = style.body(fitted.program.shared, fitted)
    parts = [{"name": n, "texts": sample.texts[i * size : (i + 1) * size]} for i, n in enumerate(names)]
    gain = StraightLineProgram.of(list(fitted.gain))
    return {
        "size": size,
        **{kind: [comment_text(name) for name in members] for kind, members in _names(fitted).items()},
        "parameters": [
            {"value": style.number(fitted.values[p.name]), "text": parameter_comment(p)} for p in fitted.parameters
        ],
        "sample": {"lines": sample.lines},
        "parts": parts,
        "play": "width" in names,
        "saturated": "level" in names,
        "transfer_function": None if discrete is None else _transfer_function(discrete, style),
        "gain": style.body(gain.shared, fitted)._asdict(),
        "inverse_gain": None if fitted.inverse_gain is None else style.array(fitted.inverse_gain),
        "derivative": _derivative(fitted, style),
        "deflection": _deflection(fitted, style),
    }


def _names(fitted: FittedModel) -> dict[str, tuple[str, ...]]:
    return {"inputs": fitted.inputs, "channels": fitted.model.channels, "components": fitted.components}


def _derivative(fitted: FittedModel, style: CodeStyle) -> dict[str, Any] | None:
    """Name and body of the derivative in the parameters."""
    if fitted.sensitivity is None:
        return None
    return {"name": fitted.derivative_name, **style.body(fitted.sensitivity.shared, fitted)._asdict()}


def _deflection(fitted: FittedModel, style: CodeStyle) -> dict[str, Any] | None:
    """The deflection's equation of motion and its discretisation."""
    discrete, equilibrium = fitted.deflection, fitted.equilibrium
    if discrete is None or equilibrium is None:
        return None
    body, size = style.body(equilibrium.shared, fitted), discrete.size
    numbers = {name: style.array(getattr(discrete, name)) for name in ("carry", "past", "now", "rest")}
    parts = {"lines": body.lines, "residual": body.texts[:size], "jacobian": body.texts[size:]}
    return {"size": size, "steps": NEWTON_STEPS, **parts, **numbers}


def _transfer_function(discrete: DiscreteTransferFunction, style: CodeStyle) -> dict[str, Any]:
    """The matrices of a discretised transfer function as text, its sizes as numbers."""
    return {
        "order": discrete.order,
        "held": discrete.held,
        "wait": discrete.wait,
        "first": discrete.first,
        **{name: style.array(np.asarray(getattr(discrete, name))) for name in ("A", "B", "C", "D", "rest", "weights")},
        "count": len(discrete.weights),
        "delayed": discrete.held > 1 or discrete.wait > 0,
    }
