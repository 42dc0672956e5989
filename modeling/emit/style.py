"""Style: how a language writes numbers, arrays, signals and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modeling.emit.fitted import FittedModel
from modeling.emit.program import Program
from modeling.emit.text import Line, identifiers, lines_of
from modeling.space import signals

Array = NDArray[np.float64]


class Body(NamedTuple):
    """The steps of a function, and the texts of its results."""

    lines: list[Line]
    texts: list[str]


@dataclass(frozen=True, kw_only=True)
class Style:
    """A language: formats of functions by name, of signals, bends and parameters by number, brackets, infinity."""

    functions: Mapping[str, str]
    signal: str
    bend: str
    parameter: str
    brackets: tuple[str, str]
    infinity: str

    def number(self, value: float) -> str:
        """The shortest decimals that are this number again."""
        if isnan(value):
            raise ValueError("not a number")
        return repr(float(value)) if abs(value) < inf else ("-" if value < 0 else "") + self.infinity

    def array(self, values: Array) -> str:
        """Numbers in brackets, rows of them in brackets again."""
        if np.ndim(values) == 0:
            return self.number(float(values))
        opening, closing = self.brackets
        return opening + ", ".join(self.array(part) for part in values) + closing

    def body(self, program: Program, fitted: FittedModel) -> Body:
        """The function of a program: first the signals and parameters that it takes, then its steps."""
        used = program.free_symbols
        inputs = zip(signals(*fitted.inputs), identifiers(fitted.inputs, "u_"), strict=True)
        known = identifiers((p.name for p in fitted.parameters), "p_")
        own = zip((p.symbol for p in fitted.parameters), known, strict=True)
        bends = () if fitted.model.chain.bend is None else fitted.model.chain.bend.signals
        taken = [(s, Line(name, self.signal.format(i))) for i, (s, name) in enumerate(inputs) if s in used]
        taken += [(s, Line(name, self.parameter.format(i))) for i, (s, name) in enumerate(own) if s in used]
        taken += [(s, Line(f"b_{s.name}", self.bend.format(i))) for i, s in enumerate(bends) if s in used]
        lines, texts = lines_of(program, {symbol: line.name for symbol, line in taken}, self.functions)
        return Body([*(line for _, line in taken), *lines], texts)
