"""A wrench model as compiled functions of arrays, with the derivatives that screening, refit and design share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain import laplace
from modeling.emission import casadi_expression, casadi_expressions, numpy_function
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.steps import Definitions, needed

if TYPE_CHECKING:
    from modeling.operators.clock import Clock
    from modeling.operators.equilibrium import Equilibrium

Array = NDArray[np.float64]
Signals = Mapping[str, Array]
Slopes = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Emitted:
    """One symbolic column as a CasADi function of (signals, parameters), mapped over samples.

    `definitions` are the steps, in order, that say what symbols of the expression are in terms of the inputs.
    """

    expression: sp.Matrix
    inputs: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]
    definitions: Definitions = ()

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
        for symbol, step in needed(self.definitions, self.expression):
            known[symbol] = casadi_expression(known, step)
        return ca.densify(ca.vertcat(*casadi_expressions(known, list(self.expression))))

    @cached_property
    def active(self) -> tuple[int, ...]:
        """Which parameters the expression depends on."""
        free = set(self.expression.free_symbols)
        for _, step in needed(self.definitions, self.expression):
            free |= step.free_symbols
        return tuple(i for i, symbol in enumerate(self.parameters) if symbol in free)

    def samples(self, signals: Signals, samples: int) -> Array:
        """The inputs of the first samples, (samples, m)."""
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
        """Value (samples, p), at the parameters (k,) or at others for each sample (samples, k)."""
        (value,) = _mapped(self, None, samples)(self.samples(signals, samples), theta)
        return value

    def tangent(self, signals: Signals, theta: Array, samples: int) -> tuple[Array, Array]:
        """Value (samples, p) and derivative (samples, p, k) in all k parameters."""
        p, k, active = len(self.expression), len(self.parameters), self.active
        value, flat = _mapped(self, active, samples)(self.samples(signals, samples), theta)
        derivative = np.zeros((samples, p, k))
        derivative[:, :, list(active)] = flat.reshape(samples, len(active), p).transpose(0, 2, 1)
        return value, derivative

    def slopes(self, signals: Signals, theta: Array, which: tuple[int, ...], samples: int) -> Array:
        """Derivative (samples, p, g, len(which)) in some parameters only, at each of g parameter sets theta (g, k)."""
        function, inputs = _mapped(self, which, samples), self.samples(signals, samples)
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
    """The function mapped over samples: inputs (samples, m), theta (k,) or (samples, k), results (samples, .)."""
    function = _function(emitted, which).map(samples)
    widths = [function.size1_out(i) for i in range(function.n_out())]

    def run(inputs: Array, theta: Array) -> list[Array]:
        count = len(emitted.parameters)
        if np.shape(theta) not in ((count,), (samples, count)):
            raise ValueError(f"{count} parameters were expected, not an array {np.shape(theta)}")
        buffer, evaluate = function.buffer()
        repeated = np.tile(theta, (samples, 1)) if np.ndim(theta) == 1 else theta
        repeated = np.ascontiguousarray(repeated, dtype=float)
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

        u, both = self.equilibrium.symbols
        return Equilibrium(graph=self.equilibrium.graph, u=u, bend=both[self.size :], theta=both[: self.size])

    def tangent(self, signals: Signals, theta: Array, samples: int, clock: Clock, *, derivative: bool) -> Slopes:
        """Value (samples, p) and derivative (samples, p, k), that of the bend included; (samples, p, 0) when not asked.

        With b(theta) the bend over the series, d load = dload/dtheta + dload/db db/dtheta.
        """
        from modeling.operators.bending import solve

        bent = solve(self.equation, self.load.samples(signals, samples), theta, clock, derivative=derivative)
        both = np.hstack([np.tile(theta, (samples, 1)), bent.values])
        if not derivative:
            value = self.load.value(signals, both, samples)
            return value, np.zeros((*value.shape, 0))
        value, slopes = self.load.tangent(signals, both, samples)
        return value, slopes[:, :, : self.size] + slopes[:, :, self.size :] @ bent.slopes


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
        return self._emitted(self.model.load)

    @cached_property
    def zero(self) -> Emitted:
        """What is added after memory."""
        return self._emitted(self.model.zero)

    @cached_property
    def play(self) -> Emitted | None:
        """Half-widths (p,) of the play between load and memory, functions of parameters alone; None without."""
        return None if self.model.chain.play is None else self._emitted(self.model.chain.play)

    @cached_property
    def level(self) -> Emitted | None:
        """Levels (p,) at which readings are clipped, functions of parameters alone; None without."""
        return None if self.model.chain.level is None else self._emitted(self.model.chain.level)

    @cached_property
    def bend(self) -> BentLoad | None:
        """The load of a tool on a spring, and what its bend obeys; None where it does not bend."""
        bend = self.model.chain.bend
        if bend is None:
            return None
        parts = (self.model.load, self.model.chain.equilibrium())
        inputs = self.model.inputs_of(sp.Matrix.vstack(*parts))
        load, equilibrium = (self._emitted(part, inputs, bend.signals) for part in parts)
        return BentLoad(load, equilibrium, len(self.symbols))

    def _emitted(
        self, expression: sp.Matrix, inputs: tuple[str, ...] | None = None, bend: tuple[sp.Symbol, ...] = ()
    ) -> Emitted:
        own = self.model.inputs_of(expression) if inputs is None else inputs
        return Emitted(expression, own, self.symbols + bend, self.model.definitions)

    @property
    def remembers(self) -> bool:
        """Whether there is a transfer function."""
        return bool(self.model.memory != 1)

    @property
    def instantaneous(self) -> bool:
        """Whether a reading is load + zero of its own instant."""
        return not self.remembers and self.play is None and self.bend is None and self.level is None

    @cached_property
    def memory_parameters(self) -> tuple[int, ...]:
        """Which parameters the transfer function depends on."""
        free = self.model.memory.free_symbols
        return tuple(i for i, symbol in enumerate(self.symbols) if symbol in free)

    @cached_property
    def _transfer(self) -> Any:
        own = [self.symbols[i] for i in self.memory_parameters]
        expressions = [self.model.memory, *(sp.diff(self.model.memory, symbol) for symbol in own)]
        return numpy_function([laplace(), *own], expressions)

    def transfer(self, omega: Array, theta: Array) -> tuple[NDArray[np.complex128], list[NDArray[np.complex128]]]:
        """H(j omega) and its derivatives in `memory_parameters`; omega in rad/s."""
        values = self._transfer(1j * omega, *(theta[i] for i in self.memory_parameters))
        wide = [np.broadcast_to(np.asarray(v, dtype=complex), omega.shape) for v in values]
        return wide[0], wide[1:]


@lru_cache(maxsize=1024)
def compiled(model: WrenchModel) -> Prediction:
    """The compiled prediction of a model, once per model."""
    return Prediction(model)
