"""truewrench: what a wrist force/torque sensor reads, what the model of its tool misses, and what that is called."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diagnosis.comparison import compare
    from diagnosis.diagnosis import diagnose
    from estimation.fit import fit
    from estimation.reading import read
    from estimation.recording import Recording
    from modeling import effects
    from modeling.errors import InputError, TruewrenchError
    from modeling.model import WrenchModel, planar, spatial
    from modeling.rig import Rig

_HOMES = {
    "InputError": "modeling.errors",
    "Recording": "estimation.recording",
    "Rig": "modeling.rig",
    "TruewrenchError": "modeling.errors",
    "WrenchModel": "modeling.model",
    "compare": "diagnosis.comparison",
    "diagnose": "diagnosis.diagnosis",
    "fit": "estimation.fit",
    "planar": "modeling.model",
    "read": "estimation.reading",
    "spatial": "modeling.model",
}

__all__ = [
    "InputError",
    "Recording",
    "Rig",
    "TruewrenchError",
    "WrenchModel",
    "compare",
    "diagnose",
    "effects",
    "fit",
    "planar",
    "read",
    "spatial",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing truewrench stays fast."""
    if name == "effects":
        return import_module("modeling.effects")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'truewrench' has no attribute '{name}'")
