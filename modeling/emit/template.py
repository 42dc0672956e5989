"""Template: source code with places for what a fitted model fills in."""

from __future__ import annotations

from typing import Any

import numpy as np

from modeling.emit.about import described
from modeling.emit.fitted import FittedModel
from modeling.emit.program import Program
from modeling.emit.style import Style
from modeling.emit.text import comment
from modeling.running_bend import NEWTON_STEPS
from modeling.running_memory import SampledMemory


def rendered(name: str, values: dict[str, Any]) -> str:
    """The template of that name with the values in it; one that is missing is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("modeling.emit"),
        undefined=StrictUndefined,
        autoescape=False,  # source code and not HTML: names of users are made plain before they come here
        keep_trailing_newline=True,
    )
    return environment.get_template(name).render(values)


def filled(fitted: FittedModel, style: Style) -> dict[str, Any]:
    """What the templates of every language take."""
    memory, names, size = fitted.memory, list(fitted.parts), fitted.size
    sample = style.body(fitted.program.shared, fitted)
    parts = [{"name": n, "texts": sample.texts[i * size : (i + 1) * size]} for i, n in enumerate(names)]
    gain = Program.of(list(fitted.gain))
    return {
        "size": size,
        **{name: [comment(own) for own in names_of] for name, names_of in _names(fitted).items()},
        "parameters": [{"value": style.number(fitted.values[p.name]), "text": described(p)} for p in fitted.parameters],
        "sample": {"lines": sample.lines},
        "parts": parts,
        "play": "width" in names,
        "clipped": "level" in names,
        "memory": None if memory is None else _memory(memory, style),
        "gain": style.body(gain.shared, fitted)._asdict(),
        "inverse_gain": None if fitted.inverse_gain is None else style.array(fitted.inverse_gain),
        "derivative": _derivative(fitted, style),
        "bend": _bend(fitted, style),
    }


def _names(fitted: FittedModel) -> dict[str, tuple[str, ...]]:
    return {"inputs": fitted.inputs, "channels": fitted.model.channels, "components": fitted.components}


def _derivative(fitted: FittedModel, style: Style) -> dict[str, Any] | None:
    """The derivative's name and body."""
    if fitted.sensitivity is None:
        return None
    return {"name": fitted.derivative_name, **style.body(fitted.sensitivity.shared, fitted)._asdict()}


def _bend(fitted: FittedModel, style: Style) -> dict[str, Any] | None:
    """The equilibrium of the bend and how it goes on from sample to sample."""
    sampled, equilibrium = fitted.bend, fitted.equilibrium
    if sampled is None or equilibrium is None:
        return None
    body, size = style.body(equilibrium.shared, fitted), sampled.size
    numbers = {name: style.array(getattr(sampled, name)) for name in ("carry", "past", "now", "rest")}
    parts = {"lines": body.lines, "balance": body.texts[:size], "slopes": body.texts[size:]}
    return {"size": size, "steps": NEWTON_STEPS, **parts, **numbers}


def _memory(memory: SampledMemory, style: Style) -> dict[str, Any]:
    """The numbers of a memory as text, its sizes as numbers."""
    return {
        "order": memory.order,
        "held": memory.held,
        "wait": memory.wait,
        "first": memory.first,
        **{name: style.array(np.asarray(getattr(memory, name))) for name in ("A", "B", "C", "D", "rest", "weights")},
        "count": len(memory.weights),
        "delayed": memory.held > 1 or memory.wait > 0,
    }
