"""A vector of expressions and its Jacobian in the parameters on one tape, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from modeling.evaluation.tape import Tape
from modeling.expressions.symbolic_vector import SymbolicVector


@dataclass(frozen=True, eq=False)
class CompiledVector:
    """A vector (p,) over `inputs` and parameters (k,), then its Jacobian in the `active` ones, column by column."""

    inputs: tuple[str, ...]
    active: tuple[int, ...]
    tape: Tape

    @property
    def rows(self) -> int:
        """The number p."""
        return len(self.tape.results) // (1 + len(self.active))

    @classmethod
    def of(cls, vector: SymbolicVector) -> Self:
        """Compile a symbolic vector."""
        import casadi as ca

        u, theta = ca.SX.sym("u", len(vector.inputs)), ca.SX.sym("theta", len(vector.parameters))
        graph = vector.graph(u, theta)
        jacobian = ca.densify(ca.jacobian(graph, theta)[:, list(vector.active)])
        return cls(vector.inputs, vector.active, Tape.of(u, theta, ca.vertcat(graph, ca.vec(jacobian))))

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """From the result of `to_data`; ValueError, KeyError or TypeError for invalid data."""
        tape, active, inputs = Tape.from_data(data["tape"]), tuple(data["active"]), tuple(data["inputs"])
        consistent = len(inputs) == tape.inputs and all(type(i) is int and 0 <= i < tape.parameters for i in active)
        if not consistent or len(tape.results) % (1 + len(active)):
            raise ValueError("the tape does not match its inputs and parameters")
        return cls(inputs, active, tape)

    def to_data(self) -> dict[str, Any]:
        """As plain data."""
        return {"inputs": list(self.inputs), "active": list(self.active), "tape": self.tape.to_data()}
