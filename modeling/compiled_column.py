"""Compiled column: a part of a model and its derivatives as a tape, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from modeling.column import Column
from modeling.tape import Tape


@dataclass(frozen=True, eq=False)
class CompiledColumn:
    """A column (p,) over `inputs` and parameters (k,), and its derivative in the `active` ones, column after column."""

    inputs: tuple[str, ...]
    active: tuple[int, ...]
    tape: Tape

    @property
    def rows(self) -> int:
        """The number p."""
        return len(self.tape.results) // (1 + len(self.active))

    @classmethod
    def of(cls, column: Column) -> Self:
        """Of a symbolic column."""
        import casadi as ca

        u, theta = ca.SX.sym("u", len(column.inputs)), ca.SX.sym("theta", len(column.parameters))
        graph = column.graph(u, theta)
        slopes = ca.densify(ca.jacobian(graph, theta)[:, list(column.active)])
        return cls(column.inputs, column.active, Tape.of(u, theta, ca.vertcat(graph, ca.vec(slopes))))

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """What `to_data` gave; ValueError, KeyError or TypeError where it did not."""
        tape, active, inputs = Tape.from_data(data["tape"]), tuple(data["active"]), tuple(data["inputs"])
        fits = len(inputs) == tape.inputs and all(type(i) is int and 0 <= i < tape.parameters for i in active)
        if not fits or len(tape.results) % (1 + len(active)):
            raise ValueError("a tape of something else")
        return cls(inputs, active, tape)

    def to_data(self) -> dict[str, Any]:
        """It as plain data."""
        return {"inputs": list(self.inputs), "active": list(self.active), "tape": self.tape.to_data()}
