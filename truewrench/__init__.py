"""truewrench: what a wrist force/torque sensor reads, what the model of its tool misses, and what that is called."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diagnosis.comparison import compare
    from diagnosis.diagnosis import diagnose
    from estimation.constrained import Bounds, Constraints, Prior
    from estimation.contact.contact import compensate
    from estimation.contact.contact_filter import ContactFilter
    from estimation.contact.contact_point import contact_point
    from estimation.contact.local_polynomial import LocalPolynomial
    from estimation.contact.surface import Capsule, Plane, Sphere
    from estimation.fit import fit
    from estimation.interval import intervals
    from estimation.noisy_motion.errors_in_variables import errors_in_variables_fit
    from estimation.noisy_motion.input_noise import InputNoise
    from estimation.reading import read
    from estimation.recording import Recording
    from estimation.repeats.bootstrap import bootstrap
    from estimation.repeats.repeat_table import RepeatTable
    from estimation.rest.centre_of_mass import CentreOfMass
    from estimation.rest.pose_advice import PoseAdvice
    from estimation.robust.loss import Huber, StudentT
    from estimation.robust.robust_fit import robust_fit
    from estimation.stream.chunk import Chunk, chunks
    from estimation.stream.long_log import read_chunks
    from estimation.stream.noise_model import NoiseModel
    from modeling import effects
    from modeling.errors import InputError, TruewrenchError
    from modeling.model import WrenchModel, planar, spatial
    from modeling.rig import Rig

_HOMES = {
    "Bounds": "estimation.constrained",
    "Capsule": "estimation.contact.surface",
    "CentreOfMass": "estimation.rest.centre_of_mass",
    "Chunk": "estimation.stream.chunk",
    "Constraints": "estimation.constrained",
    "ContactFilter": "estimation.contact.contact_filter",
    "Huber": "estimation.robust.loss",
    "InputError": "modeling.errors",
    "InputNoise": "estimation.noisy_motion.input_noise",
    "LocalPolynomial": "estimation.contact.local_polynomial",
    "NoiseModel": "estimation.stream.noise_model",
    "Plane": "estimation.contact.surface",
    "PoseAdvice": "estimation.rest.pose_advice",
    "Prior": "estimation.constrained",
    "Recording": "estimation.recording",
    "RepeatTable": "estimation.repeats.repeat_table",
    "Rig": "modeling.rig",
    "Sphere": "estimation.contact.surface",
    "StudentT": "estimation.robust.loss",
    "TruewrenchError": "modeling.errors",
    "WrenchModel": "modeling.model",
    "bootstrap": "estimation.repeats.bootstrap",
    "chunks": "estimation.stream.chunk",
    "compare": "diagnosis.comparison",
    "compensate": "estimation.contact.contact",
    "contact_point": "estimation.contact.contact_point",
    "diagnose": "diagnosis.diagnosis",
    "errors_in_variables_fit": "estimation.noisy_motion.errors_in_variables",
    "fit": "estimation.fit",
    "intervals": "estimation.interval",
    "planar": "modeling.model",
    "read": "estimation.reading",
    "read_chunks": "estimation.stream.long_log",
    "robust_fit": "estimation.robust.robust_fit",
    "spatial": "modeling.model",
}

__all__ = [
    "Bounds",
    "Capsule",
    "CentreOfMass",
    "Chunk",
    "Constraints",
    "ContactFilter",
    "Huber",
    "InputError",
    "InputNoise",
    "LocalPolynomial",
    "NoiseModel",
    "Plane",
    "PoseAdvice",
    "Prior",
    "Recording",
    "RepeatTable",
    "Rig",
    "Sphere",
    "StudentT",
    "TruewrenchError",
    "WrenchModel",
    "bootstrap",
    "chunks",
    "compare",
    "compensate",
    "contact_point",
    "diagnose",
    "effects",
    "errors_in_variables_fit",
    "fit",
    "intervals",
    "planar",
    "read",
    "read_chunks",
    "robust_fit",
    "spatial",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing truewrench stays fast."""
    if name == "effects":
        return import_module("modeling.effects")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'truewrench' has no attribute '{name}'")
