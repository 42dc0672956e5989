"""Syntax of a target language: its numbers, arrays, signals, deflections and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modeling.codegen.expression_text import Assignment, assignments_of, identifiers
from modeling.codegen.fitted_model import FittedModel
from modeling.expressions.straight_line_program import StraightLineProgram
from modeling.space import signals

Array = NDArray[np.float64]


class FunctionBody(NamedTuple):
    """Body of a generated function: its assignments, and the text of each result."""

    lines: list[Assignment]
    texts: list[str]


@dataclass(frozen=True, kw_only=True)
class CodeStyle:
    """Syntax of a language: formats of functions by name, of signals, deflections and parameters by index."""

    functions: Mapping[str, str]
    signal: str
    deflection: str
    parameter: str
    brackets: tuple[str, str]
    infinity: str

    def number(self, value: float) -> str:
        """The shortest decimal text that reads back as the same number."""
        if isnan(value):
            raise ValueError("not a number")
        return repr(float(value)) if abs(value) < inf else ("-" if value < 0 else "") + self.infinity

    def array(self, values: Array) -> str:
        """An array literal, nested by dimension."""
        if np.ndim(values) == 0:
            return self.number(float(values))
        opening, closing = self.brackets
        return opening + ", ".join(self.array(part) for part in values) + closing

    def body(self, program: StraightLineProgram, fitted: FittedModel) -> FunctionBody:
        """The body of a program: first the signals, parameters and deflections it uses, then its assignments."""
        used = program.free_symbols
        inputs = zip(signals(*fitted.inputs), identifiers(fitted.inputs, "u_"), strict=True)
        names = identifiers((p.name for p in fitted.parameters), "p_")
        parameters = zip((p.symbol for p in fitted.parameters), names, strict=True)
        deflections = () if fitted.model.chain.deflection is None else fitted.model.chain.deflection.signals
        read = [(s, Assignment(name, self.signal.format(i))) for i, (s, name) in enumerate(inputs) if s in used]
        read += [(s, Assignment(name, self.parameter.format(i))) for i, (s, name) in enumerate(parameters) if s in used]
        read += [
            (s, Assignment(f"b_{s.name}", self.deflection.format(i))) for i, s in enumerate(deflections) if s in used
        ]
        lines, texts = assignments_of(program, {symbol: line.name for symbol, line in read}, self.functions)
        return FunctionBody([*(line for _, line in read), *lines], texts)
