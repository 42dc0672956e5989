"""Force/torque sensor models: identification, residual diagnosis and experiment design (public names)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from design.bound import upper_bound
    from design.criteria import AOptimal, DOptimal, EOptimal, Subset
    from design.discrimination import tell_apart
    from design.information import ColouredNoise, WhiteNoise
    from design.trajectories.fourier import FreeSeries, PaperSeries
    from design.trajectories.rest_to_rest import RestToRest
    from design.trajectories.spline import SplineSeries
    from design.trajectory_design import design
    from diagnosis.comparison.comparison import compare
    from diagnosis.diagnosis import diagnose
    from estimation.confidence_intervals import intervals
    from estimation.contact.contact_filter import ContactFilter
    from estimation.contact.contact_point import contact_point
    from estimation.contact.contact_wrench import compensate
    from estimation.contact.local_polynomial import LocalPolynomial
    from estimation.contact.surface import Capsule, Plane, Sphere
    from estimation.errors_in_variables.errors_in_variables_fit import errors_in_variables_fit
    from estimation.errors_in_variables.input_noise import InputNoise
    from estimation.fit import fit
    from estimation.least_squares.constrained import Bounds, Constraints, Prior
    from estimation.noise.autoregression import NoiseModel
    from estimation.recordings.reading import read
    from estimation.recordings.recording import Recording
    from estimation.repeatability.bootstrap import bootstrap
    from estimation.repeatability.repeat_table import RepeatTable
    from estimation.robust.robust_fit import robust_fit
    from estimation.robust.robust_loss import Huber, StudentT
    from estimation.static.centre_of_mass import CentreOfMass
    from estimation.static.pose_advice import PoseAdvice
    from estimation.streaming.chunk import Chunk, chunks
    from estimation.streaming.long_log import read_chunks
    from modeling import effects
    from modeling.chain.model import WrenchModel, planar, spatial
    from modeling.errors import InputError, TruewrenchError
    from modeling.formulas.custom_effects.python_definition import own_effect
    from modeling.rig.rig import Rig
    from modeling.space import signals
    from truewrench.files.effects_file import read_effects
    from truewrench.surveying.survey import survey

_MODULE_OF = {
    "AOptimal": "design.criteria",
    "Bounds": "estimation.least_squares.constrained",
    "Capsule": "estimation.contact.surface",
    "CentreOfMass": "estimation.static.centre_of_mass",
    "Chunk": "estimation.streaming.chunk",
    "ColouredNoise": "design.information",
    "Constraints": "estimation.least_squares.constrained",
    "ContactFilter": "estimation.contact.contact_filter",
    "DOptimal": "design.criteria",
    "EOptimal": "design.criteria",
    "FreeSeries": "design.trajectories.fourier",
    "Huber": "estimation.robust.robust_loss",
    "InputError": "modeling.errors",
    "InputNoise": "estimation.errors_in_variables.input_noise",
    "LocalPolynomial": "estimation.contact.local_polynomial",
    "NoiseModel": "estimation.noise.autoregression",
    "PaperSeries": "design.trajectories.fourier",
    "Plane": "estimation.contact.surface",
    "PoseAdvice": "estimation.static.pose_advice",
    "Prior": "estimation.least_squares.constrained",
    "Recording": "estimation.recordings.recording",
    "RepeatTable": "estimation.repeatability.repeat_table",
    "RestToRest": "design.trajectories.rest_to_rest",
    "Rig": "modeling.rig.rig",
    "Sphere": "estimation.contact.surface",
    "SplineSeries": "design.trajectories.spline",
    "StudentT": "estimation.robust.robust_loss",
    "Subset": "design.criteria",
    "TruewrenchError": "modeling.errors",
    "WhiteNoise": "design.information",
    "WrenchModel": "modeling.chain.model",
    "bootstrap": "estimation.repeatability.bootstrap",
    "chunks": "estimation.streaming.chunk",
    "compare": "diagnosis.comparison.comparison",
    "compensate": "estimation.contact.contact_wrench",
    "contact_point": "estimation.contact.contact_point",
    "design": "design.trajectory_design",
    "diagnose": "diagnosis.diagnosis",
    "errors_in_variables_fit": "estimation.errors_in_variables.errors_in_variables_fit",
    "fit": "estimation.fit_dispatch",
    "intervals": "estimation.confidence_intervals",
    "own_effect": "modeling.formulas.custom_effects.python_definition",
    "planar": "modeling.chain.model",
    "read": "estimation.recordings.reading",
    "read_chunks": "estimation.streaming.long_log",
    "read_effects": "truewrench.files.effects_file",
    "robust_fit": "estimation.robust.robust_fit",
    "signals": "modeling.space",
    "spatial": "modeling.chain.model",
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
    """Import the module of a public name at its first use, so that importing truewrench stays fast."""
    if name == "__version__":
        return import_module("importlib.metadata").version("truewrench")
    if name == "effects":
        return import_module("modeling.effects")
    if name in _MODULE_OF:
        return getattr(import_module(_MODULE_OF[name]), name)
    raise AttributeError(f"module 'truewrench' has no attribute '{name}'")
