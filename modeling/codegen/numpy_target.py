"""NumPy target: a module, dependent on NumPy alone, with the rigid tool's regressor or a fitted model."""

from __future__ import annotations

from modeling import symbolic as sp
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.codegen.template import CodeStyle, TemplateTarget
from modeling.space import signals

NUMPY_FUNCTIONS = {
    name: f"np.{numpy}({{0}})"
    for name, numpy in {
        **{same: same for same in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "sign", "fabs")},
        **{"asin": "arcsin", "acos": "arccos", "atan": "arctan"},
    }.items()
} | {
    "atan2": "np.arctan2({0}, {1})",
    "fmax": "np.maximum({0}, {1})",
    "fmin": "np.minimum({0}, {1})",
    "pow": "np.power({0}, {1})",
    "step": "np.heaviside({0}, 0.5)",
}
"""NumPy's functions by their names in generated code."""


class NumpyTarget(TemplateTarget):
    """A Python module that needs NumPy alone."""

    name = "numpy"
    suffix = ".py"
    style = CodeStyle(
        functions=NUMPY_FUNCTIONS,
        signal="u[..., {}]",
        parameter="parameters[{}]",
        kept="state.kept[{}]",
        infinity="np.inf",
    )

    @staticmethod
    def input_names(base: RigidToolRegressor) -> dict[sp.Symbol, str]:
        """The argument itself, or its component along the last axis."""
        return {
            symbol: f"{argument}[..., {place}]" if len(components) > 1 else argument
            for argument, components in base.arguments.items()
            for place, symbol in enumerate(signals(*components))
        }
