"""CasADi target: the rigid tool's regressor, or a fitted model, as a CasADi function of one sample."""

from __future__ import annotations

from typing import Any, TypeAlias

from modeling import symbolic as sp
from modeling.codegen.casadi_sample import CasadiSample, state_size
from modeling.codegen.code_target import CodeTarget
from modeling.codegen.expression_text import identifiers
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.expressions.compilation import casadi_results
from modeling.space import signals


class CasadiTarget(CodeTarget):
    """CasADi functions, serialised: `casadi.Function.deserialize(text)`."""

    name = "casadi"
    suffix = ".casadi"

    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        """The function of `casadi_regressor`."""
        return str(casadi_regressor(base).serialize())

    def model(self, fitted: FittedModel, source: str) -> str:
        """The function of `casadi_model`."""
        return str(casadi_model(fitted).serialize())


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

    names, state = input_names(fitted), ca.SX.sym("state", state_size(fitted.program))
    inputs = [ca.SX.sym(name) for name in names]
    reading, change = ca.SX.sym("reading", fitted.size), ca.SX.sym("change", len(fitted.parameters))
    values: SymbolValues = dict(zip(signals(*fitted.inputs), inputs, strict=True))
    for i, parameter in enumerate(fitted.parameters):
        values[parameter.symbol] = fitted.values[parameter.name] + change[i]
    sample = CasadiSample.of(fitted.program, values, reading, state)
    values |= dict(zip(fitted.residual, ca.vertsplit(sample.measured - sample.prediction), strict=True))
    contact = CasadiSample.of(fitted.contact, values, reading, ca.SX(0, 1))
    results = {"prediction": sample.prediction, "contact": contact.prediction, "next_state": sample.next_state}
    if fitted.sensitivity is not None:
        elements = ca.vertcat(*casadi_results(fitted.sensitivity.shared, values))
        results[fitted.derivative_name] = ca.reshape(elements, len(fitted.parameters), fitted.size).T
    graphs = [ca.densify(graph) for graph in results.values()]
    return ca.Function("model", [*inputs, reading, change, state], graphs, [*names, *RESERVED_INPUTS], list(results))


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
