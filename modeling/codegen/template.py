"""Targets that are written by Jinja templates, and the texts that fill them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from math import inf, isnan
from typing import TYPE_CHECKING, Any, ClassVar

from modeling import symbolic as sp
from modeling.codegen.code_target import CodeTarget
from modeling.codegen.expression_text import (
    Assignment,
    assignments_of,
    comment_text,
    derivative_documentation,
    identifiers,
    model_documentation,
    paragraphs,
    parameter_comment,
    regressor_documentation,
)
from modeling.codegen.fitted_model import FittedModel, MonitorProgram, RigidToolRegressor
from modeling.compiled.straight_line_program import StraightLineProgram
from modeling.dynamics.sample_program import SampleProgram
from modeling.space import signals

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True, kw_only=True)
class CodeStyle:
    """Syntax of a language: formats of functions by name, of signals, parameters and kept states by index."""

    functions: Mapping[str, str]
    signal: str
    parameter: str
    kept: str
    infinity: str

    def number(self, value: float) -> str:
        """The shortest decimal text that reads back as the same number."""
        if isnan(value):
            raise ValueError("not a number")
        return repr(float(value)) if abs(value) < inf else ("-" if value < 0 else "") + self.infinity


@dataclass(frozen=True, eq=False)
class CodeText:
    """Names and texts of a fitted model's programs in a language, as its template asks for them.

    places  of signals, parameters and residuals: (symbol, name, where it is)
    """

    style: CodeStyle
    names: Mapping[sp.Symbol, str]
    places: tuple[tuple[sp.Symbol, str, str], ...]

    @classmethod
    def of(cls, fitted: FittedModel, style: CodeStyle) -> CodeText:
        """Names of everything in the programs of a fitted model."""
        parameters = [p.symbol for p in fitted.parameters]
        given = zip(signals(*fitted.inputs), identifiers(fitted.inputs, "u_"), strict=True)
        parameter_names = zip(parameters, identifiers([s.name for s in parameters], "p_"), strict=True)
        places = [
            *((*pair, style.signal.format(i)) for i, pair in enumerate(given)),
            *((*pair, style.parameter.format(i)) for i, pair in enumerate(parameter_names)),
            *((s, f"residual_{i}", f"measured[{i}] - predicted[{i}]") for i, s in enumerate(fitted.residual)),
        ]
        lines = fitted.program.delay_lines
        statements = (*fitted.program.statements, *lines, *fitted.contact.statements)
        computed = list(dict.fromkeys(symbol for statement in statements for symbol in statement.symbols))
        names = {symbol: name for symbol, name, _ in places}
        names |= dict(zip(computed, identifiers([s.name.removeprefix("sample:") for s in computed], "x_"), strict=True))
        names |= {symbol: style.kept.format(i) for i, symbol in enumerate(fitted.program.states)}
        return cls(style, names, tuple(places))

    def inputs(self, program: SampleProgram | StraightLineProgram) -> list[tuple[str, str]]:
        """Name and place of what a program takes."""
        used = (program.shared if isinstance(program, StraightLineProgram) else program).free_symbols
        return [(name, place) for symbol, name, place in self.places if symbol in used]

    def text(self, expression: sp.Expr) -> str:
        """An expression of values."""
        return assignments_of(StraightLineProgram.of([expression]), self.names, self.style.functions)[1][0]

    def body(self, program: StraightLineProgram) -> tuple[list[Assignment], list[str]]:
        """The assignments of common subexpressions, and the texts of the results."""
        return assignments_of(program.shared, self.names, self.style.functions)


class TemplateTarget(CodeTarget):
    """A language that is written by two templates, of the regressor and of a model, named by its suffix.

    monitor  of the model that is written; None for none, and in languages that have no template of it
    """

    style: ClassVar[CodeStyle]
    monitor: MonitorProgram | None = None

    @staticmethod
    @abstractmethod
    def input_names(base: RigidToolRegressor) -> dict[sp.Symbol, str]:
        """The text of each input in the function of the regressor."""

    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        """A file with the function of the regressor."""
        names = self.input_names(base)
        lines, texts = assignments_of(base.program.shared, names, self.style.functions)
        about = {"about": regressor_documentation(base), "source": comment_text(source)}
        size = dict(zip(("rows", "columns"), base.matrix.shape, strict=True))
        return self._rendered(
            "regressor", {"base": base, "names": names.values(), "lines": lines, "texts": texts, **about, **size}
        )

    def model(self, fitted: FittedModel, source: str) -> str:
        """A file with the functions of a fitted model, and of its monitor."""
        kinds = {"inputs": fitted.inputs, "channels": fitted.model.channels, "components": fitted.components}
        parameters = [
            {
                "name": comment_text(p.name),
                "value": self.style.number(fitted.values[p.name]),
                "text": parameter_comment(p),
            }
            for p in fitted.parameters
        ]
        values = {
            "about": model_documentation(fitted),
            "source": comment_text(source),
            "size": fitted.size,
            **{kind: [comment_text(name) for name in names] for kind, names in kinds.items()},
            "parameters": parameters,
            "program": fitted.program,
            "contact": fitted.contact,
            "code": CodeText.of(fitted, self.style),
            "derivative": fitted.sensitivity,
            "derivative_name": fitted.derivative_name,
            "derivative_about": partial(derivative_documentation, fitted),
            "fitted": fitted,
            "monitor": self.monitor,
            "comment": comment_text,
        }
        return self._rendered("model", values)

    def _rendered(self, kind: str, values: dict[str, Any]) -> str:
        """The template of that kind, filled."""
        template = _environment().get_template(f"{kind}{self.suffix}.jinja")
        return str(template.render(values | {"paragraphs": paragraphs}))


@cache
def _environment() -> Environment:
    """The templates, each compiled once; a missing value is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("modeling.codegen"),
        undefined=StrictUndefined,
        autoescape=False,  # source code, not HTML: users' names pass through comment_text before
        keep_trailing_newline=True,
    )


class CTarget(TemplateTarget):
    """C99 without allocation, with a monitor of the model if it is given. What math.h lacks is written out."""

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

    def __init__(self, monitor: MonitorProgram | None = None) -> None:
        """The target, with a monitor of the model that is to be written."""
        self.monitor = monitor

    @staticmethod
    def input_names(base: RigidToolRegressor) -> dict[sp.Symbol, str]:
        """A constant for each component."""
        return dict(zip(signals(*base.inputs), identifiers(base.inputs, "u_"), strict=True))


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
