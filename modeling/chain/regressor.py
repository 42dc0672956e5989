"""Regressor of a model that is linear in its parameters: Y = Phi theta.

Equations 22.7 to 22.9 of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.compiled.cache import cached, canonical_data
from modeling.compiled.tape import Tape
from modeling.compiled.tape_evaluation import TapeEvaluation
from modeling.errors import InputError
from modeling.space import Space

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RegressorBasis:
    """reading_c = sum_i theta_i sum_j weights[i, c, j] f_j(signals), with theta_k = 1 for the constant term.

    The regressor Phi (p, k) is sparse, and its elements recur: the planar one (22.9, Bassi et al.) has 18 elements,
    made of f = 1, M1, M2, M3, M4. Sums over samples are taken of the d functions f; the weights are applied afterwards.

    inputs     the input signals
    functions  tape of f_1 .. f_d, linearly independent functions of the signals
    weights    (k + 1, p, d); the last row is the prediction at theta = 0
    """

    inputs: tuple[str, ...]
    functions: Tape
    weights: Array

    def evaluate(self, signals: Sequence[Array], out: Array) -> None:
        """Write f (d, n) of n samples, from the inputs (n,) each, in order."""
        self._evaluation.run(signals, np.zeros((1, 0)), list(out[:, :, None]))

    @cached_property
    def _evaluation(self) -> TapeEvaluation:
        return TapeEvaluation(self.functions)

    def to_data(self) -> dict[str, Any]:
        """The basis as plain data."""
        return {
            "inputs": list(self.inputs),
            "functions": self.functions.to_data(),
            "weights": self.weights.tolist(),
        }

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_data`. Raises ValueError for inconsistent data."""
        inputs, functions = tuple(data["inputs"]), Tape.from_data(data["functions"])
        weights = np.array(data["weights"], dtype=np.float64)
        if weights.ndim != 3 or weights.shape[2] != len(functions.results) or not np.isfinite(weights).all():
            raise ValueError(f"weights {weights.shape} do not match {len(functions.results)} functions")
        if functions.inputs != len(inputs) or functions.parameters:
            raise ValueError(f"functions of {functions.inputs} signals do not match {len(inputs)} inputs")
        return cls(inputs, functions, weights)


def regressor(model: WrenchModel) -> sp.Matrix:
    """Phi (channels, parameters), the derivative of the static prediction with respect to the parameters.

    Raises InputError when the model is not linear in its parameters, or has memory.
    """
    model.require_direct("regressor")
    symbols = [p.symbol for p in model.parameters]
    prediction = (model.load + model.bias).applyfunc(sp.expand)
    phi = prediction.jacobian(symbols)
    if model.transfer_function != 1 or phi.free_symbols & set(symbols):
        raise InputError(
            what="the model is not linear in its parameters",
            where=" + ".join(["rigid tip", *(e.id for e in model.effects)]),
            remedy="use the regressor of the base model",
        )
    return phi


@dataclass(frozen=True)
class RegressorFunctions:
    """The four functions of the motion in the planar regressor (22.9).

    With (ax, ay) the acceleration of the sensor origin: M1 multiplies m in fx and mlg in tau, M2 = ddphi,
    M3 multiplies m in fy, M4 = dphi².
    """

    M1: sp.Expr
    M2: sp.Expr
    M3: sp.Expr
    M4: sp.Expr


def regressor_functions(model: WrenchModel) -> RegressorFunctions:
    """M1..M4, elements of the derived planar regressor.

    Raises InputError for a model that is not planar.
    """
    if model.space is not Space.PLANE:
        raise InputError(what="M1..M4 are defined for the planar model", where="model", remedy="use planar()")
    phi = regressor(model.base)
    return RegressorFunctions(M1=phi[0, 3], M2=phi[0, 4], M3=phi[1, 3], M4=phi[1, 4])


# Derivation of the regressor basis: linearly independent functions of the motion from a linear model's prediction.


Polynomial: TypeAlias = "dict[sp.Expr, Fraction]"
"""Coefficients by term of an expanded expression."""
SUPERPOSITION_TOLERANCE = 1e-9
"""Rounding error allowed in the superposition test, relative to the prediction."""


def regressor_basis(model: WrenchModel) -> RegressorBasis | None:
    """The basis of a model that is linear in its parameters and has no memory, None of any other.

    A fit of a linear model needs nothing else of the derivation; it is cached on disk.
    """
    try:
        key = {"regressor form": canonical_data(model)}
    except TypeError:  # an effect of another module
        return _read(_derived(model))
    return cached(key, lambda: _derived(model), _read)


def _derived(model: WrenchModel) -> Mapping[str, Any]:
    basis = derive_regressor_basis(model)
    return {"form": None if basis is None else basis.to_data()}


def _read(data: Mapping[str, Any]) -> RegressorBasis | None:
    return None if data["form"] is None else RegressorBasis.from_data(data["form"])


def derive_regressor_basis(model: WrenchModel) -> RegressorBasis | None:
    """The basis, derived; None when the model is not linear in its parameters, or has memory.

    Of the elements of Phi' and of the prediction at theta = 0, in order of length, those are selected that are linearly
    independent of the preceding ones: a signal precedes the products that contain it.
    """
    if not model.direct or model.transfer_function != 1 or not _satisfies_superposition(model):
        return None
    try:
        expanded = regressor(model)
    except InputError:
        return None
    elements = _elements(model)
    dense = [*expanded.T, *_at_zero(model).applyfunc(sp.expand)]
    forms = {e: _polynomial(long) for e, long in zip(elements, dense, strict=True)}
    selected, combinations = independent_functions(forms)
    weights = np.array([[float(combinations[e].get(j, 0)) for j in range(len(selected))] for e in elements])
    try:
        functions = Tape.of_expressions([sp.Symbol(name, real=True) for name in model.inputs], selected)
    except InputError:
        return None
    shape = (len(model.parameters) + 1, len(model.channels), len(selected))
    return RegressorBasis(model.inputs, functions, weights.reshape(shape))


def _satisfies_superposition(model: WrenchModel) -> bool:
    """Superposition test P(a) + P(b) = P(a + b) + P(0) at one random motion, much faster than `regressor`.

    A linear prediction passes to rounding; a nonlinear one that passes by chance is rejected by `regressor`.
    """
    prediction, rng = model.load + model.bias, np.random.default_rng(0)
    signals = prediction.free_symbols - {p.symbol for p in model.parameters}
    motion = {s: sp.Float(rng.uniform(0.5, 1.5)) for s in sorted(signals, key=str)}
    drawn = [rng.uniform(0.5, 1.5, len(model.parameters)) for _ in range(2)]
    thetas = (drawn[0], drawn[1], drawn[0] + drawn[1], 0 * drawn[0])
    numbers = [dict(zip((p.symbol for p in model.parameters), map(sp.Float, theta), strict=True)) for theta in thetas]
    try:
        one, other, both, none = (np.array(prediction.xreplace(motion | n), dtype=np.float64) for n in numbers)
    except TypeError:  # not a real number: infinite, complex, or an unevaluated function
        return True
    scale = max(np.abs(values).max() for values in (one, other, both, none))
    return bool(np.allclose(one + other, both + none, rtol=0, atol=SUPERPOSITION_TOLERANCE * scale))


def _elements(model: WrenchModel) -> list[sp.Expr]:
    """The elements of Phi' (k, p), then the prediction at theta = 0, unexpanded.

    Column i of the regressor of a linear prediction P is P(e_i) - P(0), which keeps products that a derivative of the
    expanded P would expand.
    """
    symbols = [p.symbol for p in model.parameters]
    prediction, constant = model.load + model.bias, _at_zero(model)
    columns = [prediction.xreplace({s: sp.Integer(s == unit) for s in symbols}) - constant for unit in symbols]
    return [element for column in (*columns, constant) for element in column]


def _at_zero(model: WrenchModel) -> sp.Matrix:
    return (model.load + model.bias).xreplace({p.symbol: sp.Integer(0) for p in model.parameters})


def _polynomial(expanded: sp.Expr) -> Polynomial:
    terms: Polynomial = {}
    for term in sp.Add.make_args(expanded):
        coefficient, factor = term.as_coeff_Mul()
        exact = sp.Rational(coefficient)
        terms[factor] = terms.get(factor, Fraction(0)) + Fraction(int(exact.p), int(exact.q))
    return {term: value for term, value in terms.items() if value}


def independent_functions(forms: dict[sp.Expr, Polynomial]) -> tuple[list[sp.Expr], dict[sp.Expr, dict[int, Fraction]]]:
    """The shortest linearly independent expressions and, for every element = sum_j coefficient_j basis_j, coefficients.

    Gaussian elimination in rational numbers. Each row of the echelon has a pivot term, unique to it, and its own
    combination of basis expressions.
    """
    echelon: dict[sp.Expr, tuple[Polynomial, dict[int, Fraction]]] = {}
    basis: list[sp.Expr] = []
    combinations: dict[sp.Expr, dict[int, Fraction]] = {}
    for element in _by_length(list(forms)):
        remainder, combination = dict(forms[element]), dict[int, Fraction]()
        for pivot, (row, row_combination) in echelon.items():
            factor = remainder.get(pivot)
            if factor:
                remainder = _subtract(remainder, factor, row)
                combination = _subtract(combination, -factor, row_combination)
        if not remainder:
            combinations[element] = combination
            continue
        number = len(basis)
        basis.append(element)
        combinations[element] = {number: Fraction(1)}
        pivot = min(remainder, key=sp.default_sort_key)
        scale = 1 / remainder[pivot]
        pivoted = _subtract({number: Fraction(1)}, Fraction(1), combination)
        echelon[pivot] = ({t: v * scale for t, v in remainder.items()}, {j: v * scale for j, v in pivoted.items()})
    return basis, combinations


def _subtract(left: dict, factor: Fraction, right: dict) -> dict:  # type: ignore[type-arg]
    """left - factor right, without zeros."""
    difference = dict(left)
    for key, value in right.items():
        difference[key] = difference.get(key, Fraction(0)) - factor * value
    return {key: value for key, value in difference.items() if value}


def _by_length(elements: Sequence[sp.Expr]) -> list[sp.Expr]:
    return sorted(elements, key=lambda e: (sp.count_ops(e), sp.default_sort_key(e)))
