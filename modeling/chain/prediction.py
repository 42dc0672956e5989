"""Compiled prediction of a wrench model, with parameter derivatives shared by screening, fit and design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.chain.stages import Bias, ChainStage, Clipping, LinearDynamics, Play
from modeling.compiled.straight_line_program import laplace
from modeling.compiled.symbolic_vector import SymbolicVector
from modeling.compiled.tape_evaluation import TapeEvaluation
from modeling.compiled.vector_function import Array, CompiledVector, Signals, VectorFunction
from modeling.dynamics.equation_of_motion import DEFLECTION_TOLERANCE, EquationOfMotion
from modeling.dynamics.motion_record import MotionRecord, ResponsePart

if TYPE_CHECKING:
    from modeling.dynamics.motion_record import TimeBase

ValueAndDerivative = tuple[Array, Array]

STAGES: Mapping[str, type[ChainStage]] = {s.__name__: s for s in (Play, LinearDynamics, Bias, Clipping)}
"""The stages from load to reading, by name."""

__all__ = ["Array", "DeflectedLoad", "Prediction", "Signals", "VectorFunction", "compiled_prediction"]


@dataclass(frozen=True, eq=False)
class DeflectedLoad:
    """Load and equation of motion of a deflected tool, in signals and (theta (k,), deflection (3 d,))."""

    load: VectorFunction
    equilibrium: VectorFunction
    size: int

    @property
    def inputs(self) -> tuple[str, ...]:
        """The input signals of both."""
        return self.load.inputs

    @cached_property
    def equation(self) -> EquationOfMotion:
        """The equation of motion, for `modeling.dynamics.deflection_solver.solve_deflection`."""
        return EquationOfMotion(self.equilibrium, self.size)

    def tangent(
        self,
        signals: Signals,
        theta: Array,
        samples: int,
        clock: TimeBase,
        *,
        derivative: bool,
        tolerance: float = DEFLECTION_TOLERANCE,
    ) -> ValueAndDerivative:
        """Value (samples, p) and total derivative (samples, p, k); (samples, p, 0) without `derivative`.

        With b(theta) the deflection over the record, d load = dload/dtheta + dload/db db/dtheta. `tolerance` is the
        last correction of the deflection relative to its size.
        """
        from modeling.dynamics.deflection_solver import solve_deflection

        rows = self.load.samples(signals, samples)
        deflected = solve_deflection(self.equation, rows, theta, clock, derivative=derivative, tolerance=tolerance)
        changing = [*np.ascontiguousarray(rows.T), *np.ascontiguousarray(deflected.values.T)]
        value = np.zeros((samples, self.load.rows))
        outputs = [value[:, row, None] for row in range(self.load.rows)]
        if not derivative:
            self._value.run(changing, theta[None], outputs)
            return value, np.zeros((*value.shape, 0))
        slopes = np.zeros((samples, self.load.rows, self.load.count))
        outputs += [slopes[:, row, i, None] for i in self.load.active for row in range(self.load.rows)]
        self._tangent.run(changing, theta[None], outputs)
        return value, slopes[:, :, : self.size] + slopes[:, :, self.size :] @ deflected.slopes

    def response(self, record: MotionRecord, tolerance: float = DEFLECTION_TOLERANCE) -> ResponsePart:
        """The load along a record: periodic steady state for a periodic motion, from rest in every single run."""
        periodic = record.repeating(self.inputs)
        samples = record.samples(periodic=periodic)
        columns = self.load.columns(record.signals, samples)
        runs = {name: record.runs(values) for name, values in zip(self.inputs, columns, strict=True)}
        several = [dict(zip(runs, run, strict=True)) for run in zip(*runs.values(), strict=True)]
        each, wanted = samples // len(several), record.derivative
        parts = [
            self.tangent(run, record.theta, each, record.clock, derivative=wanted, tolerance=tolerance)
            for run in several
        ]
        value, slopes = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
        return ResponsePart(value, slopes, periodic)

    @cached_property
    def _value(self) -> TapeEvaluation:
        """The load as a function of signals and deflection, for parameters theta."""
        tape = self.load.compiled.tape.only(range(self.load.rows))
        return TapeEvaluation(tape.with_inputs(range(self.size, self.load.count)))

    @cached_property
    def _tangent(self) -> TapeEvaluation:
        """The load, then its derivative in the active parameters and in the deflection, parameter by parameter."""
        return TapeEvaluation(self.load.compiled.tape.with_inputs(range(self.size, self.load.count)))


@dataclass(frozen=True, eq=False)
class Prediction:
    """The compiled parts of a model: the load, and the stages from load to reading."""

    model: WrenchModel

    @cached_property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """The parameter symbols in the model's order."""
        return tuple(p.symbol for p in self.model.parameters)

    @cached_property
    def stages(self) -> tuple[type[ChainStage], ...]:
        """The classes of the stages from load to reading; those of other packages from the derived chain."""
        names = self.model.outline.stages
        if all(name in STAGES for name in names):
            return tuple(STAGES[name] for name in names)
        return tuple(type(stage) for stage in self.model.chain.dynamics)

    @property
    def load(self) -> VectorFunction:
        """The static part before play and transfer function."""
        return self.vector("load")

    @property
    def bias(self) -> VectorFunction:
        """Biases and drift, added after the transfer function."""
        return self.vector("bias")

    @property
    def play(self) -> VectorFunction | None:
        """Half-widths (p,) of the play operator, functions of parameters alone; None without."""
        return self.vector("play") if Play in self.stages else None

    @property
    def saturation(self) -> VectorFunction | None:
        """Saturation levels (p,), functions of parameters alone; None without."""
        return self.vector("saturation") if Clipping in self.stages else None

    @cached_property
    def deflection(self) -> DeflectedLoad | None:
        """Load and equation of motion of a tool on a spring; None for a rigid mounting."""
        if "equilibrium" not in self.model.outline.parts:
            return None
        return DeflectedLoad(self.vector("deflected load"), self.vector("equilibrium"), len(self.model.parameters))

    @cached_property
    def _vectors(self) -> dict[str, VectorFunction]:
        return {}

    def vector(self, name: str) -> VectorFunction:
        """A part of the model by its name (`WrenchModel.columns`), compiled once."""
        if name not in self._vectors:
            self._vectors[name] = self._compiled(name)
        return self._vectors[name]

    def _compiled(self, name: str) -> VectorFunction:
        """A part of the model, its compilation cached on disk."""
        model, part = self.model, self.model.outline.parts[name]

        def compiled_part() -> CompiledVector:
            reduced = model.reduced_to(name)
            if reduced != model:
                shared = compiled_prediction(reduced).vector(name)
                return shared.compiled.among_parameters([part.names.index(n) for n in shared.names], len(part.names))
            return model.stored(
                name, lambda: CompiledVector.of(model.columns[name]).to_data(), CompiledVector.from_data
            )

        return VectorFunction(part.inputs, part.names, part.active, lambda: model.columns[name], compiled_part)

    @property
    def has_transfer_function(self) -> bool:
        """Whether the sensor has linear dynamics."""
        return LinearDynamics in self.stages

    @property
    def instantaneous(self) -> bool:
        """Whether the model is static: reading = load + bias of the same sample."""
        return self.deflection is None and self.stages == (Bias,)

    @property
    def linearised(self) -> bool:
        """Whether screening may propagate variations of the load: no deflection, and only stages that it knows."""
        return self.deflection is None and all(stage in STAGES.values() for stage in self.stages)

    @property
    def transfer_parameters(self) -> tuple[int, ...]:
        """Indices of the parameters of the transfer function."""
        return self._transfer.active

    @cached_property
    def _transfer(self) -> CompiledVector:
        """H(s) and its derivative in the parameters."""
        reduced = self.model.of_sensor
        if reduced != self.model:
            names = [p.name for p in self.model.parameters]
            places = [names.index(p.name) for p in reduced.parameters]
            return compiled_prediction(reduced)._transfer.among_parameters(places, len(names))

        def derived() -> CompiledVector:
            transfer = self.model.transfer_function.xreplace({laplace(): sp.Symbol("s", real=True)})
            return CompiledVector.of(SymbolicVector(sp.Matrix([transfer]), ("s",), self.symbols))

        return self.model.stored("transfer function", lambda: derived().to_data(), CompiledVector.from_data)

    @cached_property
    def _transfer_evaluation(self) -> TapeEvaluation:
        """Complex evaluation of H and its derivatives."""
        return TapeEvaluation(self._transfer.tape, dtype=complex)

    def transfer(self, omega: Array, theta: Array) -> tuple[NDArray[np.complex128], list[NDArray[np.complex128]]]:
        """H(j omega) and its derivatives in `transfer_parameters`; omega in rad/s."""
        values = np.zeros((1 + len(self.transfer_parameters), len(omega), 1), dtype=complex)
        inputs = [np.asarray(1j * omega, dtype=np.complex128)]
        self._transfer_evaluation.run(inputs, np.asarray(theta, dtype=float)[None], list(values))
        return values[0, :, 0], list(values[1:, :, 0])


@lru_cache(maxsize=1024)
def compiled_prediction(model: WrenchModel) -> Prediction:
    """The compiled prediction of a model, once per model."""
    return Prediction(model)
