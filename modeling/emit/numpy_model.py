"""NumPy model: a module that predicts and compensates with a fitted model, sample by sample, and needs NumPy alone."""

from __future__ import annotations

from collections.abc import Iterable

from modeling.emit.about import paragraphs
from modeling.emit.about_fitted import about_derivative, about_fitted, about_sample
from modeling.emit.fitted import FittedModel
from modeling.emit.numpy_regressor import NUMPY_FUNCTIONS, tuple_of
from modeling.emit.style import Style
from modeling.emit.template import filled, rendered
from modeling.emit.text import comment

NUMPY = Style(
    functions=NUMPY_FUNCTIONS,
    signal="u[..., {}]",
    bend="bend[..., {}]",
    parameter="parameters[{}]",
    brackets=("[", "]"),
    infinity="np.inf",
)


def numpy_model(fitted: FittedModel, source: str) -> str:
    """The text of the module; `source` names the project and its version."""
    values = filled(fitted, NUMPY)
    names: dict[str, Iterable[str]] = {
        "inputs": fitted.inputs,
        "channels": fitted.model.channels,
        "components": fitted.components,
        "parameters": [p.name for p in fitted.parameters],
    }
    values["names"] = {kind: tuple_of(map(comment, own)) for kind, own in names.items()}
    values["about"] = "\n".join(paragraphs(about_fitted(fitted)))
    values["source"] = comment(source)
    values["sample"]["about"] = "\n    ".join(paragraphs([about_sample(fitted)]))
    layout = f"(.., {fitted.size}, {len(fitted.parameters)}), of u (.., {len(fitted.inputs)})"
    if values["derivative"] is not None:
        values["derivative"]["about"] = "\n    ".join(paragraphs([about_derivative(fitted, layout)]))
    return rendered("model.py.jinja", values)
