"""C regressor: one C99 file with the regressor of the rigid tool."""

from __future__ import annotations

from modeling.emit.about import about_regressor, paragraphs
from modeling.emit.base import BaseRegressor
from modeling.emit.text import identifiers, lines_of
from modeling.space import signals

C_FUNCTIONS = {
    "sign": "((double)(({0}) > 0.0) - (double)(({0}) < 0.0))",
    "step": "(0.5 * (1.0 + (double)(({0}) > 0.0) - (double)(({0}) < 0.0)))",
}
"""What math.h has no function for."""


def c_regressor(base: BaseRegressor, source: str) -> str:
    """The text of the file; `source` names the project and its version."""
    columns = base.matrix.shape[1]
    own = identifiers(base.inputs, "u_")
    program = base.program.shared
    steps, results = lines_of(program, dict(zip(signals(*base.inputs), own, strict=True)), C_FUNCTIONS)
    return "\n".join(
        [
            *block_comment([*about_regressor(base), f"Written by {source}."]),
            "",
            *(["#include <math.h>", ""] if program.operations.calls else []),
            *block_comment(
                [
                    f"phi[{columns} * row + column] of u[{len(base.inputs)}]. Everything is read before anything is"
                    " written, so that u and phi may overlap; no memory is allocated and no state is kept."
                ]
            ),
            "void truewrench_regressor(const double *u, double *phi);",
            "",
            "void truewrench_regressor(const double *u, double *phi)",
            "{",
            *(f"    const double {name} = u[{i}];" for i, name in enumerate(own)),
            *(f"    const double {name} = {text};" for name, text in steps),
            *(f"    phi[{i}] = {text};" for i, text in enumerate(results)),
            "}",
            "",
        ]
    )


def block_comment(texts: list[str]) -> list[str]:
    """Paragraphs as a comment of C89 and later."""
    lines = paragraphs(texts)
    return ["/* " + lines[0], *(f" * {line}".rstrip() for line in lines[1:]), " */"]
