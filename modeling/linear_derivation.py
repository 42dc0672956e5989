"""Linear derivation: from a linear model's symbolic prediction to functions of the motion that are independent."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import sympy as sp

from modeling.emit.array_arithmetic import array_program
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.regressor import regressor
from modeling.regressor_form import RegressorForm

Polynomial = dict[sp.Expr, Fraction]
"""An expanded expression: coefficients by term."""
SUPERPOSED = 1e-9
"""Share of a prediction that may be rounding."""


def derived(model: WrenchModel) -> RegressorForm | None:
    """The form of the model, derived; None when it is not linear in its parameters, or has memory.

    Of the elements of Phi' and of the prediction at theta = 0, taken in the order of their length, those are kept that
    are no linear combination of the ones before them: an input is taken before a product in which it stands.
    """
    if not model.direct or model.memory != 1 or not _superposes(model):
        return None
    try:
        expanded = regressor(model)
    except InputError:
        return None
    elements = _elements(model)
    dense = [*expanded.T, *_at_zero(model).applyfunc(sp.expand)]
    forms = {e: _polynomial(long) for e, long in zip(elements, dense, strict=True)}
    kept, combinations = independent(forms)
    weights = np.array([[float(combinations[e].get(j, 0)) for j in range(len(kept))] for e in elements])
    try:
        functions = array_program([sp.Symbol(name, real=True) for name in model.inputs], kept)
    except InputError:
        return None
    return RegressorForm(functions, weights.reshape(len(model.parameters) + 1, len(model.channels), len(kept)))


def _superposes(model: WrenchModel) -> bool:
    """Whether P(a) + P(b) = P(a + b) + P(0) at one motion: seconds before `regressor` refuses what does not.

    A prediction that is linear does so to rounding; one that is not may by chance, and is told by `regressor`.
    """
    prediction, rng = model.load + model.zero, np.random.default_rng(0)
    own = {p.symbol for p in model.parameters}
    motion = {s: sp.Float(rng.uniform(0.5, 1.5)) for s in sorted(prediction.free_symbols - own, key=str)}
    drawn = [rng.uniform(0.5, 1.5, len(model.parameters)) for _ in range(2)]
    thetas = (drawn[0], drawn[1], drawn[0] + drawn[1], 0 * drawn[0])
    numbers = [dict(zip((p.symbol for p in model.parameters), map(sp.Float, theta), strict=True)) for theta in thetas]
    try:
        one, other, both, none = (np.array(prediction.xreplace(motion | n), dtype=np.float64) for n in numbers)
    except TypeError:  # no number: infinite, complex, or a function that stays as it is
        return True
    scale = max(np.abs(values).max() for values in (one, other, both, none))
    return bool(np.allclose(one + other, both + none, rtol=0, atol=SUPERPOSED * scale))


def _elements(model: WrenchModel) -> list[sp.Expr]:
    """The elements of Phi' (k, p), then the prediction at theta = 0, as short as the model writes them.

    Of a linear prediction P, column i is P(e_i) - P(0), which leaves products standing where a derivative of the
    expanded P has a sum of many.
    """
    symbols = [p.symbol for p in model.parameters]
    prediction, rest = model.load + model.zero, _at_zero(model)
    columns = [prediction.xreplace({s: sp.Integer(s == own) for s in symbols}) - rest for own in symbols]
    return [element for column in (*columns, rest) for element in column]


def _at_zero(model: WrenchModel) -> sp.Matrix:
    return (model.load + model.zero).xreplace({p.symbol: sp.Integer(0) for p in model.parameters})


def _polynomial(expanded: sp.Expr) -> Polynomial:
    terms: Polynomial = {}
    for term in sp.Add.make_args(expanded):
        coefficient, rest = term.as_coeff_Mul()
        exact = sp.Rational(coefficient)
        terms[rest] = terms.get(rest, Fraction(0)) + Fraction(int(exact.p), int(exact.q))
    return {term: value for term, value in terms.items() if value}


def independent(forms: dict[sp.Expr, Polynomial]) -> tuple[list[sp.Expr], dict[sp.Expr, dict[int, Fraction]]]:
    """The shortest expressions of which all others are combinations, and these: element = sum_j coefficient_j kept_j.

    Gaussian elimination in rational numbers. Each row of the echelon has a leading term that no other row has, and
    says of which expressions it is made.
    """
    echelon: dict[sp.Expr, tuple[Polynomial, dict[int, Fraction]]] = {}
    kept: list[sp.Expr] = []
    combinations: dict[sp.Expr, dict[int, Fraction]] = {}
    for element in _by_length(list(forms)):
        rest, made = dict(forms[element]), dict[int, Fraction]()
        for lead, (row, own) in echelon.items():
            factor = rest.get(lead)
            if factor:
                rest, made = _less(rest, factor, row), _less(made, -factor, own)
        if not rest:
            combinations[element] = made
            continue
        number = len(kept)
        kept.append(element)
        combinations[element] = {number: Fraction(1)}
        lead = min(rest, key=sp.default_sort_key)
        scale = 1 / rest[lead]
        own = _less({number: Fraction(1)}, Fraction(1), made)
        echelon[lead] = ({t: v * scale for t, v in rest.items()}, {j: v * scale for j, v in own.items()})
    return kept, combinations


def _less(left: dict, factor: Fraction, right: dict) -> dict:  # type: ignore[type-arg]
    """left - factor right, without zeros."""
    found = dict(left)
    for key, value in right.items():
        found[key] = found.get(key, Fraction(0)) - factor * value
    return {key: value for key, value in found.items() if value}


def _by_length(elements: Sequence[sp.Expr]) -> list[sp.Expr]:
    return sorted(elements, key=lambda e: (sp.count_ops(e), sp.default_sort_key(e)))
