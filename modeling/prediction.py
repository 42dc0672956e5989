"""A wrench model as compiled functions of arrays, with the derivatives that screening, refit and design share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain import laplace
from modeling.column import Column
from modeling.compiled_column import CompiledColumn
from modeling.emitted import Array, Emitted, Signals
from modeling.evaluation import Evaluation
from modeling.model import WrenchModel
from modeling.operators.balance import SETTLED

if TYPE_CHECKING:
    from modeling.operators.clock import Clock
    from modeling.operators.equilibrium import Equilibrium

Slopes = tuple[Array, Array]

__all__ = ["Array", "BentLoad", "Emitted", "Prediction", "Signals", "compiled"]


@dataclass(frozen=True, eq=False)
class BentLoad:
    """The load of a tool that bends, and the equilibrium of the bend, both in signals and (theta (k,), bend (3 d,))."""

    load: Emitted
    equilibrium: Emitted
    size: int

    @property
    def inputs(self) -> tuple[str, ...]:
        """The signals that either takes."""
        return self.load.inputs

    @cached_property
    def equation(self) -> Equilibrium:
        """What the bend obeys, for `modeling.operators.bending.solve`."""
        from modeling.operators.equilibrium import Equilibrium

        return Equilibrium(self.equilibrium, self.size)

    def tangent(
        self,
        signals: Signals,
        theta: Array,
        samples: int,
        clock: Clock,
        *,
        derivative: bool,
        tolerance: float = SETTLED,
    ) -> Slopes:
        """Value (samples, p) and derivative (samples, p, k), that of the bend included; (samples, p, 0) when not asked.

        With b(theta) the bend over the series, d load = dload/dtheta + dload/db db/dtheta. `tolerance` is the size
        of the bend's last correction, against its own.
        """
        from modeling.operators.bending import solve

        rows = self.load.samples(signals, samples)
        bent = solve(self.equation, rows, theta, clock, derivative=derivative, tolerance=tolerance)
        changing = [*np.ascontiguousarray(rows.T), *np.ascontiguousarray(bent.values.T)]
        value = np.zeros((samples, self.load.rows))
        outputs = [value[:, row, None] for row in range(self.load.rows)]
        if not derivative:
            self._value.run(changing, theta[None], outputs)
            return value, np.zeros((*value.shape, 0))
        slopes = np.zeros((samples, self.load.rows, self.load.count))
        outputs += [slopes[:, row, i, None] for i in self.load.active for row in range(self.load.rows)]
        self._tangent.run(changing, theta[None], outputs)
        return value, slopes[:, :, : self.size] + slopes[:, :, self.size :] @ bent.slopes

    @cached_property
    def _value(self) -> Evaluation:
        """The load of signals and bend, for parameters theta."""
        tape = self.load.compiled.tape.only(range(self.load.rows))
        return Evaluation(tape.with_inputs(range(self.size, self.load.count)))

    @cached_property
    def _tangent(self) -> Evaluation:
        """The same, then its derivative in the active parameters and in the bend, column after column."""
        return Evaluation(self.load.compiled.tape.with_inputs(range(self.size, self.load.count)))


@dataclass(frozen=True, eq=False)
class Prediction:
    """The compiled parts of a model: `load` before memory, `zero` after it, and the transfer function between."""

    model: WrenchModel

    @cached_property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """The parameters' symbols in the model's order."""
        return tuple(p.symbol for p in self.model.parameters)

    @cached_property
    def load(self) -> Emitted:
        """The instantaneous part before play and memory."""
        return self._emitted("load")

    @cached_property
    def zero(self) -> Emitted:
        """What is added after memory."""
        return self._emitted("zero")

    @cached_property
    def play(self) -> Emitted | None:
        """Half-widths (p,) of the play between load and memory, functions of parameters alone; None without."""
        return self._emitted("play") if "play" in self.model.outline.parts else None

    @cached_property
    def level(self) -> Emitted | None:
        """Levels (p,) at which readings are clipped, functions of parameters alone; None without."""
        return self._emitted("level") if "level" in self.model.outline.parts else None

    @cached_property
    def bend(self) -> BentLoad | None:
        """The load of a tool on a spring, and what its bend obeys; None where it does not bend."""
        if "equilibrium" not in self.model.outline.parts:
            return None
        return BentLoad(self._emitted("bent load"), self._emitted("equilibrium"), len(self.model.parameters))

    def _emitted(self, name: str) -> Emitted:
        """A part of the model, compiled once for all processes."""
        model, part = self.model, self.model.outline.parts[name]

        def compiled_part() -> CompiledColumn:
            return model.stored(
                name, lambda: CompiledColumn.of(model.columns[name]).to_data(), CompiledColumn.from_data
            )

        return Emitted(part.inputs, part.names, part.active, lambda: model.columns[name], compiled_part)

    @property
    def remembers(self) -> bool:
        """Whether there is a transfer function."""
        return self.model.outline.remembers

    @property
    def instantaneous(self) -> bool:
        """Whether a reading is load + zero of its own instant."""
        return not self.remembers and self.play is None and self.bend is None and self.level is None

    @property
    def memory_parameters(self) -> tuple[int, ...]:
        """Which parameters the transfer function depends on."""
        return self._transfer.active

    @cached_property
    def _transfer(self) -> CompiledColumn:
        """H over s, and its derivative in the parameters."""

        def derived() -> CompiledColumn:
            memory = self.model.memory.xreplace({laplace(): sp.Symbol("s", real=True)})
            return CompiledColumn.of(Column(sp.Matrix([memory]), ("s",), self.symbols))

        return self.model.stored("memory", lambda: derived().to_data(), CompiledColumn.from_data)

    @cached_property
    def _transfer_evaluation(self) -> Evaluation:
        """What gives H and its derivatives."""
        return Evaluation(self._transfer.tape, dtype=complex)

    def transfer(self, omega: Array, theta: Array) -> tuple[NDArray[np.complex128], list[NDArray[np.complex128]]]:
        """H(j omega) and its derivatives in `memory_parameters`; omega in rad/s."""
        found = np.zeros((1 + len(self.memory_parameters), len(omega), 1), dtype=complex)
        inputs = [np.asarray(1j * omega, dtype=np.complex128)]
        self._transfer_evaluation.run(inputs, np.asarray(theta, dtype=float)[None], list(found))
        return found[0, :, 0], list(found[1:, :, 0])


@lru_cache(maxsize=1024)
def compiled(model: WrenchModel) -> Prediction:
    """The compiled prediction of a model, once per model."""
    return Prediction(model)
