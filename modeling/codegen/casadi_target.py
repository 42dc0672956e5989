"""CasADi target: the rigid tool's regressor, or a fitted model, as a CasADi function of one sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self, TypeAlias

import numpy as np

from modeling import symbolic as sp
from modeling.codegen.expression_text import identifiers
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.dynamics.discrete_deflection import NEWTON_STEPS, DiscreteDeflection
from modeling.dynamics.discrete_transfer_function import DiscreteTransferFunction
from modeling.expressions.compilation import casadi_results
from modeling.expressions.straight_line_program import StraightLineProgram
from modeling.space import signals


@dataclass(eq=False)
class CasadiState:
    """State vector of the generated function: 1 after the first sample, then the stages' states; zero at the start.

    sizes   lengths, by name: angles_rates and drive (deflection), play, lag (rational part of the transfer function),
            outputs (of that part, newest first, for the delay), biases and readings (oldest first, to align with it)
    next    the same states after this sample
    """

    channels: int
    discrete: DiscreteTransferFunction | None
    sizes: dict[str, int]
    next: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, fitted: FittedModel) -> Self:
        """The state of a model before its first sample."""
        p, discrete, deflection = fitted.size, fitted.discrete, fitted.deflection
        sizes = {} if deflection is None else {"angles_rates": 2 * deflection.size, "drive": deflection.size}
        sizes |= {"play": p} if "width" in fitted.parts else {}
        if discrete is not None:
            delay = {"outputs": discrete.held - 1, "biases": discrete.wait, "readings": discrete.wait}
            sizes |= {name: p * count for name, count in ({"lag": discrete.order} | delay).items()}
        return cls(p, discrete, sizes)

    @cached_property
    def vector(self) -> Any:
        """The state vector before this sample; empty for a model without memory."""
        import casadi as ca

        return ca.SX.sym("state", 1 + sum(self.sizes.values()) if self.sizes else 0)

    @property
    def started(self) -> Any:
        """Whether an earlier sample exists."""
        return self.vector[0]

    @cached_property
    def previous(self) -> dict[str, Any]:
        """The stages' states before this sample."""
        import casadi as ca

        ends = np.cumsum([1, *self.sizes.values()]).tolist()
        return dict(zip(self.sizes, ca.vertsplit(self.vector, [0, *ends])[1:], strict=True)) if self.sizes else {}

    @property
    def following(self) -> Any:
        """The state vector after this sample."""
        import casadi as ca

        return ca.vertcat(ca.SX.ones(1 if self.sizes else 0), *(self.next[name] for name in self.sizes))

    def advanced(self, parts: dict[str, Any], reading: Any) -> tuple[Any, Any]:
        """Prediction (p,), and the reading (p,) of the same sample."""
        import casadi as ca

        load, bias = parts["load"], parts["zero"]
        if "width" in parts:
            load = ca.fmin(ca.fmax(self._initialised("play", load), load - parts["width"]), load + parts["width"])
            self.next["play"] = load
        if self.discrete is not None:
            load = self._delayed(self.discrete, self._lagged(self.discrete, load))
            bias, reading = self._aligned("biases", bias), self._aligned("readings", reading)
        prediction = load + bias
        if "level" in parts:
            prediction = ca.fmin(ca.fmax(prediction, -parts["level"]), parts["level"])
        return prediction, reading

    def _initialised(self, name: str, first: Any) -> Any:
        """A stage's state before this sample; `first` at the first sample."""
        import casadi as ca

        return ca.if_else(self.started, self.previous[name], first)

    def _lagged(self, discrete: DiscreteTransferFunction, load: Any) -> Any:
        """Output of the rational part of the transfer function: x' = A x + B load, out = C x + D load."""
        import casadi as ca

        if not discrete.order:
            self.next["lag"] = self.previous["lag"]
            return discrete.D * load
        x = ca.reshape(self._initialised("lag", ca.vec(ca.DM(discrete.rest) @ load.T)), discrete.order, self.channels)
        self.next["lag"] = ca.vec(ca.DM(discrete.A) @ x + ca.DM(discrete.B) @ load.T)
        return (ca.DM(discrete.C).T @ x).T + discrete.D * load

    def _delayed(self, discrete: DiscreteTransferFunction, output: Any) -> Any:
        """The delayed output: a weighted sum of present and earlier outputs."""
        import casadi as ca

        earlier = (
            self._initialised("outputs", ca.repmat(output, discrete.held - 1, 1)) if discrete.held > 1 else ca.SX(0, 1)
        )
        outputs = ca.vertcat(output, earlier)
        self.next["outputs"] = outputs[: self.sizes["outputs"]]
        delayed = ca.vertsplit(outputs, self.channels)[discrete.first :]
        return sum(float(weight) * y for weight, y in zip(discrete.weights, delayed, strict=True))

    def _aligned(self, name: str, newest: Any) -> Any:
        """The value of `wait` samples ago, from a first-in first-out buffer."""
        import casadi as ca

        if not self.sizes[name]:
            self.next[name] = self.previous[name]
            return newest
        count = self.sizes[name] // self.channels
        buffer = ca.vertcat(self._initialised(name, ca.repmat(newest, count, 1)), newest)
        self.next[name] = buffer[self.channels :]
        return buffer[: self.channels]


RESERVED_INPUTS = ("reading", "change", "state")
SymbolValues: TypeAlias = "dict[sp.Symbol, Any]"


def casadi_model(fitted: FittedModel) -> Any:
    """A fitted model as the CasADi function `model` of one sample.

    Inputs: each signal by its name; `reading` (p,); `change` (k,), added to the estimated parameters; `state`: zeros
    at the start, then the last `next_state`. An input that is not given is zero. Outputs: `prediction` and `contact`
    (p,) of that sample, or of `wait` samples ago where readings lead the motion; `next_state`; and, where it exists
    (`FittedModel.sensitivity`), the derivative of load + bias in the parameters (p, k), `regressor` or `sensitivity`.
    """
    import casadi as ca

    names, state = input_names(fitted), CasadiState.of(fitted)
    inputs = [ca.SX.sym(name) for name in names]
    reading, change = ca.SX.sym("reading", fitted.size), ca.SX.sym("change", len(fitted.parameters))
    values: SymbolValues = dict(zip(signals(*fitted.inputs), inputs, strict=True))
    for i, parameter in enumerate(fitted.parameters):
        values[parameter.symbol] = fitted.values[parameter.name] + change[i]
    if fitted.deflection is not None:
        _deflect(fitted, fitted.deflection, values, state)
    parts = ca.vertsplit(ca.vertcat(*casadi_results(fitted.program.shared, values)), fitted.size)
    prediction, measured = state.advanced(dict(zip(fitted.parts, parts, strict=True)), reading)
    contact = _contact(fitted, values, measured - prediction)
    results = {"prediction": prediction, "contact": contact, "next_state": state.following}
    if fitted.sensitivity is not None:
        elements = ca.vertcat(*casadi_results(fitted.sensitivity.shared, values))
        results[fitted.derivative_name] = ca.reshape(elements, len(fitted.parameters), fitted.size).T
    graphs = [ca.densify(graph) for graph in results.values()]
    return ca.Function(
        "model", [*inputs, reading, change, state.vector], graphs, [*names, *RESERVED_INPUTS], list(results)
    )


def _contact(fitted: FittedModel, values: SymbolValues, residual: Any) -> Any:
    """Contact wrench: inverse contact gain times the residual."""
    import casadi as ca

    if fitted.inverse_gain is not None:
        return ca.DM(fitted.inverse_gain) @ residual
    gain = ca.vertcat(*casadi_results(StraightLineProgram.of(list(fitted.gain)).shared, values))
    return ca.solve(ca.reshape(gain, fitted.size, fitted.size).T, residual)


def _deflect(fitted: FittedModel, discrete: DiscreteDeflection, values: SymbolValues, state: CasadiState) -> None:
    """Add the deflection of this sample to the values: Newton's method for the drive that balances the spring."""
    import casadi as ca

    chain = fitted.model.chain
    symbols = () if chain.deflection is None else chain.deflection.signals
    program = StraightLineProgram((), ()) if fitted.equilibrium is None else fitted.equilibrium.shared
    drive, size = state.previous["drive"], discrete.size
    free_response = ca.DM(discrete.carry) @ state.previous["angles_rates"] + ca.DM(discrete.past) @ drive
    gain = ca.if_else(state.started, ca.DM(discrete.now), ca.DM(discrete.rest))
    deflection = free_response + gain @ drive
    for _ in range(NEWTON_STEPS):
        evaluated = casadi_results(program, values | dict(zip(symbols, ca.vertsplit(deflection), strict=True)))
        jacobian = ca.reshape(ca.vertcat(*evaluated[size:]), 3 * size, size).T
        drive = drive - ca.solve(jacobian @ gain, ca.vertcat(*evaluated[:size]))
        deflection = free_response + gain @ drive
    values |= dict(zip(symbols, ca.vertsplit(deflection), strict=True))
    state.next |= {"angles_rates": deflection[: 2 * size], "drive": drive}


def input_names(fitted: FittedModel) -> list[str]:
    """The signals' names, prefixed with u_ where CasADi does not allow the name or it is reserved."""
    import casadi as ca

    def allowed(name: str) -> bool:
        return bool(ca.Function.check_name(name)) and name not in RESERVED_INPUTS

    prefixed = identifiers(fitted.inputs, "u_")
    return [name if allowed(name) else other for name, other in zip(fitted.inputs, prefixed, strict=True)]


def casadi_regressor(base: RigidToolRegressor) -> Any:
    """The CasADi function `regressor` of one sample: inputs by name as in FORMATS, output `Phi` (p, k)."""
    import casadi as ca

    arguments = {name: ca.SX.sym(name, len(components)) for name, components in base.arguments.items()}
    parts = [part for argument in arguments.values() for part in ca.vertsplit(argument)]
    elements = casadi_results(base.program.shared, dict(zip(signals(*base.inputs), parts, strict=True)))
    columns = base.matrix.shape[1]
    Phi = ca.reshape(ca.vertcat(*elements), columns, -1).T
    return ca.Function("regressor", list(arguments.values()), [ca.densify(Phi)], list(arguments), ["Phi"])
