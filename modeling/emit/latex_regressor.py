"""LaTeX regressor: the regressor of the rigid tool as formulas."""

from __future__ import annotations

from dataclasses import fields

from modeling.emit.about import about_regressor
from modeling.emit.base import BaseRegressor
from modeling.emit.formula import document, equations, escaped, formula, matrix, matrix_of, name
from modeling.regressor import motions
from modeling.space import Space


def latex_regressor(base: BaseRegressor, source: str) -> str:
    """The text of a document; `source` names the project and its version."""
    text = [escaped(paragraph) + "\n" for paragraph in about_regressor(base)]
    theta = [name(p.name) for p in base.parameters]
    parameters = equations([(r"\theta", matrix([theta]) + r"^\top")])
    body = planar_equations(base) if base.space is Space.PLANE else spatial_equations(base)
    return document(source, [*text, parameters, body])


def planar_equations(base: BaseRegressor) -> str:
    """M1..M4 (22.9), and the regressor made of them (22.8)."""
    found = motions(base.model)
    named = {getattr(found, field.name): f"M_{field.name[1:]}" for field in fields(found)}
    pairs = [(symbol, formula(expression)) for expression, symbol in named.items()]
    rows = [[named.get(entry, formula(entry)) for entry in base.matrix.row(i)] for i in range(base.matrix.rows)]
    return equations([*pairs, (r"\Phi", matrix(rows))])


def spatial_equations(base: BaseRegressor) -> str:
    """The regressor in blocks: biases, mass and first moment, inertia."""
    biases, moments = len(base.model.biases), 4
    blocks = {
        "E": base.matrix[:, :biases],
        r"\Phi_1": base.matrix[:, biases : biases + moments],
        r"\Phi_2": base.matrix[:, biases + moments :],
    }
    whole = matrix([list(blocks)])
    return equations([(r"\Phi", whole), *((left, matrix_of(block)) for left, block in blocks.items())])
