"""C model: one C99 file that predicts and compensates with a fitted model, sample by sample."""

from __future__ import annotations

from modeling.emit.about_fitted import about_derivative, about_fitted
from modeling.emit.c_regressor import C_FUNCTIONS, block_comment
from modeling.emit.fitted import FittedModel
from modeling.emit.style import Style
from modeling.emit.template import filled, rendered

C = Style(
    functions=C_FUNCTIONS,
    signal="u[{}]",
    bend="bend[{}]",
    parameter="truewrench_parameters[{}]",
    brackets=("{", "}"),
    infinity="HUGE_VAL",
)


def c_model(fitted: FittedModel, source: str) -> str:
    """The text of the file; `source` names the project and its version."""
    values = filled(fitted, C)
    values["about"] = "\n".join(block_comment([*about_fitted(fitted), f"Written by {source}."]))
    layout = "phi[TRUEWRENCH_PARAMETERS * row + column], which may overlap u"
    if values["derivative"] is not None:
        values["derivative"]["about"] = "\n".join(block_comment([about_derivative(fitted, layout)]))
    return rendered("model.c.jinja", values)
