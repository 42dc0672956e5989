"""A wrench model as compiled functions of arrays, with the derivatives that screening, refit and design share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from modeling.chain import LAPLACE
from modeling.emission import casadi_expressions, numpy_function
from modeling.errors import InputError
from modeling.model import WrenchModel

Array = NDArray[np.float64]
Signals = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Emitted:
    """One symbolic column as a CasADi function of (signals, parameters), mapped over samples."""

    expression: sp.Matrix
    inputs: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]

    @cached_property
    def symbols(self) -> tuple[Any, Any]:
        """CasADi symbols of the inputs and of the parameters."""
        import casadi as ca

        return ca.SX.sym("u", len(self.inputs)), ca.SX.sym("theta", len(self.parameters))

    @cached_property
    def graph(self) -> Any:
        """The expression (p,) as a CasADi graph over `symbols`."""
        import casadi as ca

        u, theta = self.symbols
        known: dict[sp.Symbol, Any] = {sp.Symbol(n, real=True): u[i] for i, n in enumerate(self.inputs)}
        known |= {symbol: theta[i] for i, symbol in enumerate(self.parameters)}
        return ca.densify(ca.vertcat(*casadi_expressions(known, list(self.expression))))

    @cached_property
    def active(self) -> tuple[int, ...]:
        """Which parameters the expression depends on."""
        free = self.expression.free_symbols
        return tuple(i for i, symbol in enumerate(self.parameters) if symbol in free)

    def _samples(self, signals: Signals, samples: int) -> Array:
        for name in self.inputs:
            if name not in signals:
                raise InputError(
                    what=f"the model needs the signal '{name}'",
                    where="recording",
                    remedy="record it, or leave the effect out",
                )
        columns = [np.asarray(signals[name], dtype=float)[:samples] for name in self.inputs]
        return np.stack(columns, axis=1) if columns else np.zeros((samples, 0))

    def value(self, signals: Signals, theta: Array, samples: int) -> Array:
        """Value (samples, p)."""
        (value,) = _mapped(self, None, samples)(self._samples(signals, samples), theta)
        return value

    def tangent(self, signals: Signals, theta: Array, samples: int) -> tuple[Array, Array]:
        """Value (samples, p) and derivative (samples, p, k) in all k parameters."""
        p, k, active = len(self.expression), len(self.parameters), self.active
        value, flat = _mapped(self, active, samples)(self._samples(signals, samples), theta)
        derivative = np.zeros((samples, p, k))
        derivative[:, :, list(active)] = flat.reshape(samples, len(active), p).transpose(0, 2, 1)
        return value, derivative

    def slopes(self, signals: Signals, theta: Array, which: tuple[int, ...], samples: int) -> Array:
        """Derivative (samples, p, g, len(which)) in some parameters only, at each of g parameter sets theta (g, k)."""
        function, inputs = _mapped(self, which, samples), self._samples(signals, samples)
        p, count = len(self.expression), len(which)
        columns = [function(inputs, row)[1].reshape(samples, count, p) for row in theta]
        return np.stack(columns, axis=1).transpose(0, 3, 1, 2)


@lru_cache(maxsize=512)
def _function(emitted: Emitted, which: tuple[int, ...] | None) -> Any:
    """CasADi function of (u, theta): the value, and its derivative in the parameters `which`, column by column."""
    import casadi as ca

    results = [emitted.graph]
    if which is not None:
        jacobian = ca.jacobian(emitted.graph, emitted.symbols[1])[:, list(which)]
        results.append(ca.densify(ca.vec(jacobian)))
    return ca.Function("emitted", list(emitted.symbols), results)


@lru_cache(maxsize=512)
def _mapped(emitted: Emitted, which: tuple[int, ...] | None, samples: int) -> Callable[[Array, Array], list[Array]]:
    """The function mapped over samples, without a copy: inputs (samples, m), theta (k,), results (samples, .)."""
    function = _function(emitted, which).map(samples)
    widths = [function.size1_out(i) for i in range(function.n_out())]

    def run(inputs: Array, theta: Array) -> list[Array]:
        if np.shape(theta) != (len(emitted.parameters),):
            raise ValueError(f"{len(emitted.parameters)} parameters were expected, not an array {np.shape(theta)}")
        buffer, evaluate = function.buffer()
        repeated = np.tile(np.asarray(theta, dtype=float), (samples, 1))
        results = [np.zeros((samples, width)) for width in widths]
        for place, values in enumerate((np.ascontiguousarray(inputs), repeated)):
            if values.size:
                buffer.set_arg(place, memoryview(values))  # type: ignore[arg-type]
        for place, values in enumerate(results):
            if values.size:
                buffer.set_res(place, memoryview(values))  # type: ignore[arg-type]
        evaluate()
        return results

    return run


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
        """The instantaneous part before memory."""
        return Emitted(self.model.load, self.model.inputs_of(self.model.load), self.symbols)

    @cached_property
    def zero(self) -> Emitted:
        """What is added after memory."""
        return Emitted(self.model.zero, self.model.inputs_of(self.model.zero), self.symbols)

    @property
    def remembers(self) -> bool:
        """Whether a sample's reading depends on earlier samples."""
        return bool(self.model.memory != 1)

    @cached_property
    def memory_parameters(self) -> tuple[int, ...]:
        """Which parameters the transfer function depends on."""
        free = self.model.memory.free_symbols
        return tuple(i for i, symbol in enumerate(self.symbols) if symbol in free)

    @cached_property
    def _transfer(self) -> Any:
        own = [self.symbols[i] for i in self.memory_parameters]
        expressions = [self.model.memory, *(sp.diff(self.model.memory, symbol) for symbol in own)]
        return numpy_function([LAPLACE, *own], expressions)

    def transfer(self, omega: Array, theta: Array) -> tuple[NDArray[np.complex128], list[NDArray[np.complex128]]]:
        """H(j omega) and its derivatives in `memory_parameters`; omega in rad/s."""
        values = self._transfer(1j * omega, *(theta[i] for i in self.memory_parameters))
        wide = [np.broadcast_to(np.asarray(v, dtype=complex), omega.shape) for v in values]
        return wide[0], wide[1:]


@lru_cache(maxsize=128)
def compiled(model: WrenchModel) -> Prediction:
    """The compiled prediction of a model, once per model."""
    return Prediction(model)
