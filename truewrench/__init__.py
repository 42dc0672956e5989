"""Force/torque sensor models: identification, residual diagnosis and experiment design (public names).

Each name is imported at its first use, so that importing truewrench stays fast; type checkers read the imports below.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_NAMES: dict[str, tuple[str, ...]] = {
    "design.bound": ("upper_bound",),
    "design.criteria": ("AOptimal", "DOptimal", "EOptimal", "Subset"),
    "design.discrimination": ("discriminate",),
    "design.information.experiment": ("Experiment",),
    "design.limits": ("LimitUse",),
    "design.trajectories.fourier": ("FreeSeries", "PaperSeries"),
    "design.trajectories.spline": ("RestToRest", "SplineSeries"),
    "design.trajectories.trajectory": ("Trajectory",),
    "design.trajectory_design": ("design",),
    "diagnosis.calibrate": ("calibrate",),
    "diagnosis.comparison.model_comparison": ("compare",),
    "diagnosis.diagnosis": ("diagnose",),
    "diagnosis.discovery.discovery": ("discover",),
    "diagnosis.study": ("Study", "study"),
    "estimation.bootstrap": ("bootstrap",),
    "estimation.budget": ("budget",),
    "estimation.centre_of_mass": ("CentreOfMass",),
    "estimation.confidence_intervals": ("intervals",),
    "estimation.contact.contact_filter": ("ContactFilter", "LocalPolynomial"),
    "estimation.contact.contact_point": ("Capsule", "Plane", "Sphere", "contact_point"),
    "estimation.contact.contact_wrench": ("compensate",),
    "estimation.errors_in_variables": ("errors_in_variables_fit",),
    "estimation.fit": ("fit",),
    "estimation.input_noise": ("InputNoise",),
    "estimation.least_squares.bounds": ("Bounds",),
    "estimation.least_squares.constraints": ("Constraints",),
    "estimation.least_squares.prior": ("Prior",),
    "estimation.monitor": ("Monitor",),
    "estimation.load_advice": ("LoadAdvice",),
    "estimation.pose_advice": ("PoseAdvice",),
    "estimation.reading.log_reading": ("from_arrays", "from_dataframe", "read"),
    "estimation.recordings.recording": ("Recording",),
    "estimation.repeat_table": ("RepeatTable",),
    "estimation.robust_fit": ("robust_fit",),
    "estimation.robust_loss": ("Huber", "StudentT"),
    "estimation.set_bounds": ("set_bounds",),
    "estimation.streaming.chunk": ("Chunk", "chunks"),
    "estimation.streaming.long_log": ("read_chunks",),
    "modeling.chain.model": ("WrenchModel", "planar", "spatial"),
    "modeling.chain.pseudo_inertia": ("Volume",),
    "modeling.errors": ("InputError", "TruewrenchError"),
    "modeling.formulas.python_definition": ("own_effect",),
    "modeling.noise": ("ColouredNoise", "NoiseModel"),
    "modeling.rig": ("Rig",),
    "modeling.rigid_body": ("Load",),
    "modeling.space": ("signals",),
    "truewrench.emitted": ("emit", "sensor_matrix"),
    "truewrench.files.effects_file": ("read_effects",),
    "truewrench.files.model_file": ("load", "save"),
    "truewrench.plots.reading_plot": ("plot_reading",),
    "truewrench.reports.reported": ("report",),
    "truewrench.simulated_rig": ("simulate",),
    "truewrench.surveying.survey": ("survey",),
}
"""Public names, by the module that defines them."""
_SUBMODULES = {
    "effects": "modeling.effects",
    "reference": "modeling.reference",
    "simulated_rig": "truewrench.simulated_rig",
}
"""Public modules."""
_MODULES = {name: module for module, names in _NAMES.items() for name in names}

if TYPE_CHECKING:
    from design.bound import upper_bound as upper_bound
    from design.criteria import AOptimal as AOptimal
    from design.criteria import DOptimal as DOptimal
    from design.criteria import EOptimal as EOptimal
    from design.criteria import Subset as Subset
    from design.discrimination import discriminate as discriminate
    from design.information.experiment import Experiment as Experiment
    from design.limits import LimitUse as LimitUse
    from design.trajectories.fourier import FreeSeries as FreeSeries
    from design.trajectories.fourier import PaperSeries as PaperSeries
    from design.trajectories.spline import RestToRest as RestToRest
    from design.trajectories.spline import SplineSeries as SplineSeries
    from design.trajectories.trajectory import Trajectory as Trajectory
    from design.trajectory_design import design as design
    from diagnosis.calibrate import calibrate as calibrate
    from diagnosis.comparison.model_comparison import compare as compare
    from diagnosis.diagnosis import diagnose as diagnose
    from diagnosis.discovery.discovery import discover as discover
    from diagnosis.study import Study as Study
    from diagnosis.study import study as study
    from estimation.bootstrap import bootstrap as bootstrap
    from estimation.budget import budget as budget
    from estimation.centre_of_mass import CentreOfMass as CentreOfMass
    from estimation.confidence_intervals import intervals as intervals
    from estimation.contact.contact_filter import ContactFilter as ContactFilter
    from estimation.contact.contact_filter import LocalPolynomial as LocalPolynomial
    from estimation.contact.contact_point import Capsule as Capsule
    from estimation.contact.contact_point import Plane as Plane
    from estimation.contact.contact_point import Sphere as Sphere
    from estimation.contact.contact_point import contact_point as contact_point
    from estimation.contact.contact_wrench import compensate as compensate
    from estimation.errors_in_variables import errors_in_variables_fit as errors_in_variables_fit
    from estimation.fit import fit as fit
    from estimation.input_noise import InputNoise as InputNoise
    from estimation.least_squares.bounds import Bounds as Bounds
    from estimation.least_squares.constraints import Constraints as Constraints
    from estimation.least_squares.prior import Prior as Prior
    from estimation.load_advice import LoadAdvice as LoadAdvice
    from estimation.monitor import Monitor as Monitor
    from estimation.pose_advice import PoseAdvice as PoseAdvice
    from estimation.reading.log_reading import from_arrays as from_arrays
    from estimation.reading.log_reading import from_dataframe as from_dataframe
    from estimation.reading.log_reading import read as read
    from estimation.recordings.recording import Recording as Recording
    from estimation.repeat_table import RepeatTable as RepeatTable
    from estimation.robust_fit import robust_fit as robust_fit
    from estimation.robust_loss import Huber as Huber
    from estimation.robust_loss import StudentT as StudentT
    from estimation.set_bounds import set_bounds as set_bounds
    from estimation.streaming.chunk import Chunk as Chunk
    from estimation.streaming.chunk import chunks as chunks
    from estimation.streaming.long_log import read_chunks as read_chunks
    from modeling import effects as effects
    from modeling import reference as reference
    from modeling.chain.model import WrenchModel as WrenchModel
    from modeling.chain.model import planar as planar
    from modeling.chain.model import spatial as spatial
    from modeling.chain.pseudo_inertia import Volume as Volume
    from modeling.errors import InputError as InputError
    from modeling.errors import TruewrenchError as TruewrenchError
    from modeling.formulas.python_definition import own_effect as own_effect
    from modeling.noise import ColouredNoise as ColouredNoise
    from modeling.noise import NoiseModel as NoiseModel
    from modeling.rig import Rig as Rig
    from modeling.rigid_body import Load as Load
    from modeling.space import signals as signals
    from truewrench import simulated_rig as simulated_rig
    from truewrench.emitted import emit as emit
    from truewrench.emitted import sensor_matrix as sensor_matrix
    from truewrench.files.effects_file import read_effects as read_effects
    from truewrench.files.model_file import load as load
    from truewrench.files.model_file import save as save
    from truewrench.plots.reading_plot import plot_reading as plot_reading
    from truewrench.reports.reported import report as report
    from truewrench.simulated_rig import simulate as simulate
    from truewrench.surveying.survey import survey as survey

    __version__: str
else:

    def __getattr__(name: str) -> Any:
        """The public name, from its module."""
        if name == "__version__":
            return import_module("importlib.metadata").version("truewrench")
        if name == "__all__":
            return sorted([*_MODULES, *_SUBMODULES])
        if name not in _MODULES and name not in _SUBMODULES:
            raise AttributeError(f"module 'truewrench' has no attribute '{name}'")
        # who presents results: `fit.summary()` asks the module named here
        import_module("modeling.table").register_presenter("truewrench.presentation")
        try:
            module = import_module(_SUBMODULES.get(name) or _MODULES[name])
        except ModuleNotFoundError as error:
            raise import_module("modeling.errors").missing_package(error) or error from None
        return module if name in _SUBMODULES else getattr(module, name)


def __dir__() -> list[str]:
    """Everything that `__getattr__` gives, for completion in a notebook."""
    own = [name for name in globals() if name.startswith("__")]
    return sorted([*own, *_MODULES, *_SUBMODULES, "__version__"])
