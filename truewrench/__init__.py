"""truewrench: what a wrist force/torque sensor reads, what the model of its tool misses, and what that is called."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from design.bound import upper_bound
    from design.criterion import AOptimal, DOptimal, EOptimal, Subset
    from design.discrimination import tell_apart
    from design.information import ColouredNoise, WhiteNoise
    from design.motion.fourier import FreeSeries, PaperSeries
    from design.motion.rest_to_rest import RestToRest
    from design.motion.spline import SplineSeries
    from design.planning import design
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
    from modeling.own.writing import own_effect
    from modeling.rig import Rig
    from modeling.space import signals
    from truewrench.effects_file import read_effects
    from truewrench.surveying.survey import survey

_HOMES = {
    "AOptimal": "design.criterion",
    "Bounds": "estimation.constrained",
    "Capsule": "estimation.contact.surface",
    "CentreOfMass": "estimation.rest.centre_of_mass",
    "Chunk": "estimation.stream.chunk",
    "ColouredNoise": "design.information",
    "Constraints": "estimation.constrained",
    "ContactFilter": "estimation.contact.contact_filter",
    "DOptimal": "design.criterion",
    "EOptimal": "design.criterion",
    "FreeSeries": "design.motion.fourier",
    "Huber": "estimation.robust.loss",
    "InputError": "modeling.errors",
    "InputNoise": "estimation.noisy_motion.input_noise",
    "LocalPolynomial": "estimation.contact.local_polynomial",
    "NoiseModel": "estimation.stream.noise_model",
    "PaperSeries": "design.motion.fourier",
    "Plane": "estimation.contact.surface",
    "PoseAdvice": "estimation.rest.pose_advice",
    "Prior": "estimation.constrained",
    "Recording": "estimation.recording",
    "RepeatTable": "estimation.repeats.repeat_table",
    "RestToRest": "design.motion.rest_to_rest",
    "Rig": "modeling.rig",
    "Sphere": "estimation.contact.surface",
    "SplineSeries": "design.motion.spline",
    "StudentT": "estimation.robust.loss",
    "Subset": "design.criterion",
    "TruewrenchError": "modeling.errors",
    "WhiteNoise": "design.information",
    "WrenchModel": "modeling.model",
    "bootstrap": "estimation.repeats.bootstrap",
    "chunks": "estimation.stream.chunk",
    "compare": "diagnosis.comparison",
    "compensate": "estimation.contact.contact",
    "contact_point": "estimation.contact.contact_point",
    "design": "design.planning",
    "diagnose": "diagnosis.diagnosis",
    "errors_in_variables_fit": "estimation.noisy_motion.errors_in_variables",
    "fit": "estimation.fitting",
    "intervals": "estimation.interval",
    "own_effect": "modeling.own.writing",
    "planar": "modeling.model",
    "read": "estimation.reading",
    "read_chunks": "estimation.stream.long_log",
    "read_effects": "truewrench.effects_file",
    "robust_fit": "estimation.robust.robust_fit",
    "signals": "modeling.space",
    "spatial": "modeling.model",
    "survey": "truewrench.surveying.survey",
    "tell_apart": "design.discrimination",
    "upper_bound": "design.bound",
}

__all__ = [
    "AOptimal",
    "Bounds",
    "Capsule",
    "CentreOfMass",
    "Chunk",
    "ColouredNoise",
    "Constraints",
    "ContactFilter",
    "DOptimal",
    "EOptimal",
    "FreeSeries",
    "Huber",
    "InputError",
    "InputNoise",
    "LocalPolynomial",
    "NoiseModel",
    "PaperSeries",
    "Plane",
    "PoseAdvice",
    "Prior",
    "Recording",
    "RepeatTable",
    "RestToRest",
    "Rig",
    "Sphere",
    "SplineSeries",
    "StudentT",
    "Subset",
    "TruewrenchError",
    "WhiteNoise",
    "WrenchModel",
    "bootstrap",
    "chunks",
    "compare",
    "compensate",
    "contact_point",
    "design",
    "diagnose",
    "effects",
    "errors_in_variables_fit",
    "fit",
    "intervals",
    "own_effect",
    "planar",
    "read",
    "read_chunks",
    "read_effects",
    "robust_fit",
    "signals",
    "spatial",
    "survey",
    "tell_apart",
    "upper_bound",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing truewrench stays fast."""
    if name == "__version__":
        return import_module("importlib.metadata").version("truewrench")
    if name == "effects":
        return import_module("modeling.effects")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'truewrench' has no attribute '{name}'")
