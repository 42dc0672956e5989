"""C target: a C99 file with the regressor of the rigid tool, or with a fitted model."""

from __future__ import annotations

from modeling import symbolic as sp
from modeling.codegen.expression_text import identifiers
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.codegen.template import CodeStyle, TemplateTarget
from modeling.space import signals


class CTarget(TemplateTarget):
    """C99 without allocation. Functions that math.h lacks are written out."""

    name = "c"
    suffix = ".c"
    style = CodeStyle(
        functions={
            "sign": "((double)(({0}) > 0.0) - (double)(({0}) < 0.0))",
            "step": "(0.5 * (1.0 + (double)(({0}) > 0.0) - (double)(({0}) < 0.0)))",
            "fmax": "truewrench_max({0}, {1})",
            "fmin": "truewrench_min({0}, {1})",
        },
        signal="u[{}]",
        parameter="truewrench_parameters[{}]",
        kept="state->kept[{}]",
        infinity="HUGE_VAL",
    )

    @staticmethod
    def input_names(base: RigidToolRegressor) -> dict[sp.Symbol, str]:
        """A constant for each component."""
        return dict(zip(signals(*base.inputs), identifiers(base.inputs, "u_"), strict=True))
