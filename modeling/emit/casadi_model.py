"""CasADi model: a fitted model as a CasADi function of one sample."""

from __future__ import annotations

from typing import Any, TypeAlias

from modeling import symbolic as sp
from modeling.emit.casadi_state import CasadiState
from modeling.emit.fitted import FittedModel
from modeling.emit.graph import graphs_of
from modeling.emit.program import Program
from modeling.emit.text import identifiers
from modeling.running_bend import NEWTON_STEPS, SampledBend
from modeling.space import signals

RESERVED = ("reading", "change", "state")
Values: TypeAlias = "dict[sp.Symbol, Any]"


def casadi_model(fitted: FittedModel) -> Any:
    """Function `model` of one sample.

    Inputs: each signal by its name; `reading` (p,); `change` (k,), added to the numbers of the fit; `state`, at the
    start nothing but zeros, then what came out before. What is left out is zero. Outputs: `prediction` and `contact`
    (p,) of that sample, or of `wait` samples ago where readings lead; `next_state`; and, where it can be had
    (`FittedModel.sensitivity`), the derivative of load and zero by the parameters (p, k), `regressor` or `sensitivity`.
    """
    import casadi as ca

    names, state = input_names(fitted), CasadiState.of(fitted)
    inputs = [ca.SX.sym(name) for name in names]
    reading, change = ca.SX.sym("reading", fitted.size), ca.SX.sym("change", len(fitted.parameters))
    values: Values = dict(zip(signals(*fitted.inputs), inputs, strict=True))
    for place, parameter in enumerate(fitted.parameters):
        values[parameter.symbol] = fitted.values[parameter.name] + change[place]
    if fitted.bend is not None:
        _bend(fitted, fitted.bend, values, state)
    parts = ca.vertsplit(ca.vertcat(*graphs_of(fitted.program.shared, values)), fitted.size)
    prediction, measured = state.advanced(dict(zip(fitted.parts, parts, strict=True)), reading)
    contact = _contact(fitted, values, measured - prediction)
    results = {"prediction": prediction, "contact": contact, "next_state": state.following}
    if fitted.sensitivity is not None:
        elements = ca.vertcat(*graphs_of(fitted.sensitivity.shared, values))
        results[fitted.derivative_name] = ca.reshape(elements, len(fitted.parameters), fitted.size).T
    graphs = [ca.densify(graph) for graph in results.values()]
    return ca.Function("model", [*inputs, reading, change, state.column], graphs, [*names, *RESERVED], list(results))


def _contact(fitted: FittedModel, values: Values, difference: Any) -> Any:
    """Inverse contact gain times the difference."""
    import casadi as ca

    if fitted.inverse_gain is not None:
        return ca.DM(fitted.inverse_gain) @ difference
    gain = ca.vertcat(*graphs_of(Program.of(list(fitted.gain)).shared, values))
    return ca.solve(ca.reshape(gain, fitted.size, fitted.size).T, difference)


def _bend(fitted: FittedModel, sampled: SampledBend, values: Values, state: CasadiState) -> None:
    """Put the bend of this sample among the values: by itself, and by the drive with which it obeys its spring."""
    import casadi as ca

    chain = fitted.model.chain
    symbols = () if chain.bend is None else chain.bend.signals
    program = Program((), ()) if fitted.equilibrium is None else fitted.equilibrium.shared
    by_itself = ca.DM(sampled.carry) @ state.held["swing"] + ca.DM(sampled.past) @ state.held["drive"]
    column = ca.if_else(state.started, ca.DM(sampled.now), ca.DM(sampled.rest))
    drive, size = state.held["drive"], sampled.size
    bend = by_itself + column @ drive
    for _ in range(NEWTON_STEPS):
        found = graphs_of(program, values | dict(zip(symbols, ca.vertsplit(bend), strict=True)))
        slopes = ca.reshape(ca.vertcat(*found[size:]), 3 * size, size).T
        drive = drive - ca.solve(slopes @ column, ca.vertcat(*found[:size]))
        bend = by_itself + column @ drive
    values |= dict(zip(symbols, ca.vertsplit(bend), strict=True))
    state.next |= {"swing": bend[: 2 * size], "drive": drive}


def input_names(fitted: FittedModel) -> list[str]:
    """The signals' names, with u_ before those that CasADi cannot have."""
    import casadi as ca

    def free(name: str) -> bool:
        return bool(ca.Function.check_name(name)) and name not in RESERVED

    prefixed = identifiers(fitted.inputs, "u_")
    return [name if free(name) else other for name, other in zip(fitted.inputs, prefixed, strict=True)]
