"""C target: a C99 file with the regressor of the rigid tool, or with a fitted model."""

from __future__ import annotations

from modeling.codegen.code_style import CodeStyle
from modeling.codegen.documentation import (
    derivative_documentation,
    model_documentation,
    paragraphs,
    regressor_documentation,
)
from modeling.codegen.expression_text import assignments_of, identifiers
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.codegen.template import render_template, template_values
from modeling.space import signals

C_FUNCTIONS = {
    "sign": "((double)(({0}) > 0.0) - (double)(({0}) < 0.0))",
    "step": "(0.5 * (1.0 + (double)(({0}) > 0.0) - (double)(({0}) < 0.0)))",
}
"""Functions that math.h lacks."""


def c_regressor(base: RigidToolRegressor, source: str) -> str:
    """The C file of the regressor; `source` names the project and its version."""
    columns = base.matrix.shape[1]
    names = identifiers(base.inputs, "u_")
    program = base.program.shared
    steps, results = assignments_of(program, dict(zip(signals(*base.inputs), names, strict=True)), C_FUNCTIONS)
    return "\n".join(
        [
            *block_comment([*regressor_documentation(base), f"Written by {source}."]),
            "",
            *(["#include <math.h>", ""] if program.operations.calls else []),
            *block_comment(
                [
                    f"phi[{columns} * row + column] of u[{len(base.inputs)}]. All inputs are read before any output is"
                    " written: u and phi may overlap. No memory is allocated, and there is no state."
                ]
            ),
            "void truewrench_regressor(const double *u, double *phi);",
            "",
            "void truewrench_regressor(const double *u, double *phi)",
            "{",
            *(f"    const double {name} = u[{i}];" for i, name in enumerate(names)),
            *(f"    const double {name} = {text};" for name, text in steps),
            *(f"    phi[{i}] = {text};" for i, text in enumerate(results)),
            "}",
            "",
        ]
    )


def block_comment(texts: list[str]) -> list[str]:
    """Paragraphs as a block comment, valid from C89 on."""
    lines = paragraphs(texts)
    return ["/* " + lines[0], *(f" * {line}".rstrip() for line in lines[1:]), " */"]


C_STYLE = CodeStyle(
    functions=C_FUNCTIONS,
    signal="u[{}]",
    deflection="deflection[{}]",
    parameter="truewrench_parameters[{}]",
    brackets=("{", "}"),
    infinity="HUGE_VAL",
)


def c_model(fitted: FittedModel, source: str) -> str:
    """The C file of a fitted model; `source` names the project and its version."""
    values = template_values(fitted, C_STYLE)
    values["about"] = "\n".join(block_comment([*model_documentation(fitted), f"Written by {source}."]))
    layout = "phi[TRUEWRENCH_PARAMETERS * row + column], which may overlap u"
    if values["derivative"] is not None:
        values["derivative"]["about"] = "\n".join(block_comment([derivative_documentation(fitted, layout)]))
    return render_template("model.c.jinja", values)
