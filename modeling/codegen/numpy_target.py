"""NumPy target: a module, dependent on NumPy alone, with the rigid tool's regressor or a fitted model."""

from __future__ import annotations

from collections.abc import Iterable

from modeling.codegen.code_style import CodeStyle
from modeling.codegen.documentation import (
    derivative_documentation,
    model_documentation,
    paragraphs,
    regressor_documentation,
    sample_documentation,
)
from modeling.codegen.expression_text import assignments_of, comment_text
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.codegen.template import render_template, template_values
from modeling.space import Space, signals

NUMPY_FUNCTIONS = {
    name: f"np.{numpy}({{0}})"
    for name, numpy in {
        **{same: same for same in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "sign", "fabs")},
        **{"asin": "arcsin", "acos": "arccos", "atan": "arctan"},
    }.items()
} | {
    "atan2": "np.arctan2({0}, {1})",
    "fmax": "np.fmax({0}, {1})",
    "fmin": "np.fmin({0}, {1})",
    "pow": "np.power({0}, {1})",
    "step": "np.heaviside({0}, 0.5)",
}
"""NumPy's functions by their names in generated code."""

PLANAR_INPUTS = """\
    given = [np.atleast_1d(np.asarray(value, dtype=float)) for value in ({names})]
    {names} = np.broadcast_arrays(*given)
    Phi = np.zeros((*ax.shape, {rows}, {columns}))"""

SPATIAL_INPUTS = """\
    given = [np.atleast_2d(np.asarray(value, dtype=float)) for value in ({names})]
    if any(value.shape[-1] != 3 for value in given):
        raise ValueError("{names} have three components each: arrays (N, 3)")
    {names} = np.broadcast_arrays(*given)
    Phi = np.zeros((*a.shape[:-1], {rows}, {columns}))"""

SHAPE_TEXTS = {
    Space.PLANE: "Phi (N, {rows}, {columns}) of arrays (N,) or numbers, which are broadcast against one another.",
    Space.SPACE: "Phi (N, {rows}, {columns}) of arrays (N, 3) or (3,), which are broadcast against one another.",
}


def numpy_regressor(base: RigidToolRegressor, source: str) -> str:
    """The module of the regressor; `source` names the project and its version."""
    rows, columns = base.matrix.shape
    names = ", ".join(base.arguments)
    opening = PLANAR_INPUTS if base.space is Space.PLANE else SPATIAL_INPUTS
    shapes = SHAPE_TEXTS[base.space].format(rows=rows, columns=columns)
    return "\n".join(
        [
            '"""' + "\n".join(paragraphs(regressor_documentation(base))),
            '"""',
            "",
            f"# Written by {source}.",
            "",
            "import numpy as np",
            "",
            f"CHANNELS = {tuple_literal(base.space.channels)}",
            f"PARAMETERS = {tuple_literal(p.name for p in base.parameters)}",
            "",
            "",
            f"def regressor({names}):",
            f'    """{shapes}"""',
            opening.format(names=names, rows=rows, columns=columns),
            *(f"    {line}" for line in _body(base)),
            "    return Phi",
            "",
            "",
            f"def prediction(theta, {names}):",
            f'    """Readings (N, {rows}) of the parameters theta ({columns},)."""',
            f"    return regressor({names}) @ np.asarray(theta, dtype=float)",
            "",
        ]
    )


def tuple_literal(names: Iterable[str]) -> str:
    """A tuple of strings without quotation marks, as a literal."""
    return "(" + ", ".join(f'"{name}"' for name in names) + ")"


def _body(base: RigidToolRegressor) -> list[str]:
    """The assignments, and the nonzero elements of Phi."""
    names = {
        symbol: f"{argument}[..., {place}]" if len(components) > 1 else argument
        for argument, components in base.arguments.items()
        for place, symbol in enumerate(signals(*components))
    }
    steps, results = assignments_of(base.program.shared, names, NUMPY_FUNCTIONS)
    columns = base.matrix.shape[1]
    filled = [(*divmod(place, columns), text) for place, text in enumerate(results) if text != "0.0"]
    return [f"{name} = {text}" for name, text in steps] + [f"Phi[..., {i}, {j}] = {text}" for i, j, text in filled]


NUMPY_STYLE = CodeStyle(
    functions=NUMPY_FUNCTIONS,
    signal="u[..., {}]",
    deflection="deflection[..., {}]",
    parameter="parameters[{}]",
    brackets=("[", "]"),
    infinity="np.inf",
)


def numpy_model(fitted: FittedModel, source: str) -> str:
    """The module of a fitted model; `source` names the project and its version."""
    values = template_values(fitted, NUMPY_STYLE)
    names: dict[str, Iterable[str]] = {
        "inputs": fitted.inputs,
        "channels": fitted.model.channels,
        "components": fitted.components,
        "parameters": [p.name for p in fitted.parameters],
    }
    values["names"] = {kind: tuple_literal(map(comment_text, texts)) for kind, texts in names.items()}
    values["about"] = "\n".join(paragraphs(model_documentation(fitted)))
    values["source"] = comment_text(source)
    values["sample"]["about"] = "\n    ".join(paragraphs([sample_documentation(fitted)]))
    layout = f"(.., {fitted.size}, {len(fitted.parameters)}), of u (.., {len(fitted.inputs)})"
    if values["derivative"] is not None:
        values["derivative"]["about"] = "\n    ".join(paragraphs([derivative_documentation(fitted, layout)]))
    return render_template("model.py.jinja", values)
