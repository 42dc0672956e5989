"""A fitted model as the code generators take it: estimated parameters, programs and discretised dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.contact_gain import contact_gain
from modeling.chain.model import WrenchModel
from modeling.codegen.discrete_time_model import (
    deflection_integrator,
    discrete_transfer_function,
    has_memory,
    sample_inputs,
)
from modeling.dynamics.discrete_deflection import DiscreteDeflection
from modeling.dynamics.discrete_transfer_function import DiscreteTransferFunction
from modeling.expressions.operation_count import OperationCount
from modeling.expressions.straight_line_program import StraightLineProgram, forward_derivative
from modeling.parameter import Parameter
from modeling.tool.wrench_components import contact_components

Array = NDArray[np.float64]

LARGEST_DERIVATIVE = 100_000
"""Operations of a sample times parameters above which no derivative is generated: megabytes of code."""


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model, its parameters theta (k,) in its order, and the sampling interval dt (s) where it has memory.

    Recording-specific disturbances are left out; `dropped` are their ids.
    """

    model: WrenchModel
    theta: Array
    dt: float | None
    dropped: tuple[str, ...]

    @classmethod
    def of(cls, model: WrenchModel, theta: Array, dt: float | None = None) -> FittedModel:
        """A fitted model without its recording-specific disturbances; dt (s) is needed where it has memory."""
        values = dict(zip((p.name for p in model.parameters), map(float, theta), strict=True))
        lasting = np.array([values[p.name] for p in model.lasting.parameters])
        return cls(model.lasting, lasting, dt, tuple(e.id for e in model.effects if e.per_recording))

    @cached_property
    def discrete(self) -> DiscreteTransferFunction | None:
        """The transfer function discretised at dt, None for a model without one.

        Raises InputError without a dt, or when it has no stable proper rational realisation with a delay.
        """
        return discrete_transfer_function(self.model, self.theta, self.dt)

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """The signals of a sample, sorted by name."""
        return sample_inputs(self.model)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the contact wrench's components."""
        return contact_components(self.model.space)

    @property
    def size(self) -> int:
        """The number of channels p."""
        return len(self.model.channels)

    # ------------------------------------------------------------------------------ programs of a sample

    @cached_property
    def parts(self) -> dict[str, sp.Matrix]:
        """Vectors (p,) evaluated per sample, by name: load, zero (bias), and where they exist width and level.

        width are the half-widths of the play operator, level the saturation levels of the readings.
        """
        chain = self.model.chain
        found = {"load": self.model.load, "zero": self.model.zero, "width": chain.play, "level": chain.level}
        return {name: part for name, part in found.items() if part is not None}

    @cached_property
    def gain(self) -> sp.Matrix:
        """The contact gain (p, p), a function of the parameters."""
        return contact_gain(self.model)

    @cached_property
    def program(self) -> StraightLineProgram:
        """The elements of the parts, concatenated."""
        return StraightLineProgram.of([e for part in self.parts.values() for e in part], self.model.definitions)

    @cached_property
    def deflection(self) -> DiscreteDeflection | None:
        """The tool's deflection discretised at dt, None for a rigid tool.

        Raises InputError without a dt, or when the tool's inertia is not positive definite.
        """
        integrator = deflection_integrator(self.model, self.theta, self.dt)
        return None if integrator is None else integrator.sampled

    @cached_property
    def equilibrium(self) -> StraightLineProgram | None:
        """Residual (d,) of the deflection's equation of motion, then its Jacobian (d, 3 d) in the deflection."""
        deflection = self.model.chain.deflection
        if deflection is None:
            return None
        residual = StraightLineProgram.of(list(self.model.chain.equilibrium()), self.model.definitions).shared
        jacobian = forward_derivative(residual, deflection.signals)
        return StraightLineProgram.of([*residual.results, *jacobian.results], jacobian.steps)

    @cached_property
    def inverse_gain(self) -> Array | None:
        """Inverse (p, p) of the contact gain where that is constant, else None."""
        if self.gain.free_symbols:
            return None
        return np.asarray(np.linalg.inv(np.array(self.gain.tolist(), dtype=float)))

    @property
    def output_operations(self) -> OperationCount:
        """Operations per sample after its parts: play, transfer function, bias, contact with a constant gain."""
        p, discrete = self.size, self.discrete
        each = OperationCount(sums=1)
        if "width" in self.parts:
            each += OperationCount(sums=2)
        if discrete is not None:
            r, taps = discrete.order, len(discrete.weights)
            each += OperationCount(sums=r + r * r, products=1 + r + r * (1 + r))
            each += OperationCount(sums=taps - 1, products=taps if discrete.held > 1 else 0)
        each += OperationCount(sums=1 + p - 1, products=p)
        return OperationCount.sum([each] * p)

    # ------------------------------------------------------------------------------------ its parameters

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that the generated code takes, in the model's order."""
        used = self.program.free_symbols | self.gain.free_symbols
        used |= set() if self.equilibrium is None else self.equilibrium.free_symbols
        return tuple(p for p in self.model.parameters if p.symbol in used)

    @cached_property
    def values(self) -> dict[str, float]:
        """Estimates of all parameters of the model, by name."""
        return dict(zip((p.name for p in self.model.parameters), map(float, self.theta), strict=True))

    @cached_property
    def transfer_parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the transfer function: their values are fixed in its discretisation."""
        used = self.model.memory.free_symbols
        return tuple(p for p in self.model.parameters if p.symbol in used)

    # ------------------------------------------------------------------------------------ its derivative

    @cached_property
    def sensitivity(self) -> StraightLineProgram | None:
        """Derivative (p, len(parameters)) of load + bias, row by row.

        None where the tool deflects, since the deflection has memory, and above LARGEST_DERIVATIVE.
        """
        too_long = self.program.shared.operations.total * len(self.parameters) > LARGEST_DERIVATIVE
        if self.equilibrium is not None or too_long:
            return None
        reading = StraightLineProgram.of(list(self.model.load + self.model.zero), self.model.definitions)
        return forward_derivative(reading.shared, [p.symbol for p in self.parameters])

    @cached_property
    def linear(self) -> bool:
        """Whether a reading is the derivative times the parameters: linear, without memory, play or saturation."""
        symbols = {p.symbol for p in self.model.parameters}
        if self.sensitivity is None or has_memory(self.model) or len(self.parts) > 2:
            return False
        if self.sensitivity.free_symbols & symbols:
            return False
        return not any(e.xreplace(dict.fromkeys(symbols, sp.S.Zero)) for e in self.model.load + self.model.zero)

    @property
    def derivative_name(self) -> str:
        """The derivative's name in generated code: regressor where the model is linear in the parameters."""
        return "regressor" if self.linear else "sensitivity"
