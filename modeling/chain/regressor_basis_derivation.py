"""Derivation of the regressor basis: linearly independent functions of the motion from a linear model's prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.chain.regressor import regressor
from modeling.chain.regressor_basis import RegressorBasis
from modeling.errors import InputError
from modeling.evaluation.cache import cached, canonical_data
from modeling.evaluation.tape import Tape

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
    found = derive_regressor_basis(model)
    return {"form": None if found is None else found.to_data()}


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
    own = {p.symbol for p in model.parameters}
    motion = {s: sp.Float(rng.uniform(0.5, 1.5)) for s in sorted(prediction.free_symbols - own, key=str)}
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
    columns = [prediction.xreplace({s: sp.Integer(s == own) for s in symbols}) - constant for own in symbols]
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
        own = _subtract({number: Fraction(1)}, Fraction(1), combination)
        echelon[pivot] = ({t: v * scale for t, v in remainder.items()}, {j: v * scale for j, v in own.items()})
    return basis, combinations


def _subtract(left: dict, factor: Fraction, right: dict) -> dict:  # type: ignore[type-arg]
    """left - factor right, without zeros."""
    difference = dict(left)
    for key, value in right.items():
        difference[key] = difference.get(key, Fraction(0)) - factor * value
    return {key: value for key, value in difference.items() if value}


def _by_length(elements: Sequence[sp.Expr]) -> list[sp.Expr]:
    return sorted(elements, key=lambda e: (sp.count_ops(e), sp.default_sort_key(e)))
