"""NumPy regressor: a module with the regressor of the rigid tool, that needs NumPy alone."""

from __future__ import annotations

from collections.abc import Iterable

from modeling.emit.about import about_regressor, paragraphs
from modeling.emit.base import BaseRegressor
from modeling.emit.text import lines_of
from modeling.space import Space, signals

NUMPY_FUNCTIONS = {
    name: f"np.{numpy}({{0}})"
    for name, numpy in {
        **{same: same for same in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "sign", "fabs")},
        **{"asin": "arcsin", "acos": "arccos", "atan": "arctan"},
    }.items()
} | {
    "atan2": "np.arctan2({0}, {1})",
    "fmax": "np.fmax({0}, {1})",
    "fmin": "np.fmin({0}, {1})",
    "pow": "np.power({0}, {1})",
    "step": "np.heaviside({0}, 0.5)",
}
"""How NumPy calls the functions of emitted code."""

PLANAR_INPUTS = """\
    given = [np.atleast_1d(np.asarray(value, dtype=float)) for value in ({names})]
    {names} = np.broadcast_arrays(*given)
    Phi = np.zeros((*ax.shape, {rows}, {columns}))"""

SPATIAL_INPUTS = """\
    given = [np.atleast_2d(np.asarray(value, dtype=float)) for value in ({names})]
    if any(value.shape[-1] != 3 for value in given):
        raise ValueError("{names} have three components each: arrays (N, 3)")
    {names} = np.broadcast_arrays(*given)
    Phi = np.zeros((*a.shape[:-1], {rows}, {columns}))"""

SHAPES = {
    Space.PLANE: "Phi (N, {rows}, {columns}) of arrays (N,) or numbers, which are broadcast against one another.",
    Space.SPACE: "Phi (N, {rows}, {columns}) of arrays (N, 3) or (3,), which are broadcast against one another.",
}


def numpy_regressor(base: BaseRegressor, source: str) -> str:
    """The text of the module; `source` names the project and its version."""
    rows, columns = base.matrix.shape
    names = ", ".join(base.arguments)
    opening = PLANAR_INPUTS if base.space is Space.PLANE else SPATIAL_INPUTS
    shapes = SHAPES[base.space].format(rows=rows, columns=columns)
    return "\n".join(
        [
            '"""' + "\n".join(paragraphs(about_regressor(base))),
            '"""',
            "",
            f"# Written by {source}.",
            "",
            "import numpy as np",
            "",
            f"CHANNELS = {tuple_of(base.space.channels)}",
            f"PARAMETERS = {tuple_of(p.name for p in base.parameters)}",
            "",
            "",
            f"def regressor({names}):",
            f'    """{shapes}"""',
            opening.format(names=names, rows=rows, columns=columns),
            *(f"    {line}" for line in _body(base)),
            "    return Phi",
            "",
            "",
            f"def prediction(theta, {names}):",
            f'    """Readings (N, {rows}) of the parameters theta ({columns},)."""',
            f"    return regressor({names}) @ np.asarray(theta, dtype=float)",
            "",
        ]
    )


def tuple_of(names: Iterable[str]) -> str:
    """A tuple of strings; they hold no quotation marks."""
    return "(" + ", ".join(f'"{name}"' for name in names) + ")"


def _body(base: BaseRegressor) -> list[str]:
    """The steps, and the elements of Phi that are not zero."""
    names = {
        symbol: f"{argument}[..., {place}]" if len(components) > 1 else argument
        for argument, components in base.arguments.items()
        for place, symbol in enumerate(signals(*components))
    }
    steps, results = lines_of(base.program.shared, names, NUMPY_FUNCTIONS)
    columns = base.matrix.shape[1]
    filled = [(*divmod(place, columns), text) for place, text in enumerate(results) if text != "0.0"]
    return [f"{name} = {text}" for name, text in steps] + [f"Phi[..., {i}, {j}] = {text}" for i, j, text in filled]
