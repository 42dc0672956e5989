"""What code generators write: a fitted model with its programs, and the regressor of the rigid tool.

Equations 22.x: chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et
al.).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel, planar
from modeling.chain.prediction import compiled_prediction
from modeling.chain.regressor import regressor
from modeling.chain.sensor_axes import contact_gain
from modeling.compiled.straight_line_program import StraightLineProgram, forward_derivative, required_definitions
from modeling.dynamics.discrete_deflection import DiscreteDeflection, deflected
from modeling.dynamics.sample_program import SampleProgram, SampleProgramBuilder
from modeling.errors import InputError
from modeling.noise import NoiseModel
from modeling.parameter import Parameter
from modeling.rigid_body import contact_components, newton_euler, rigid_body
from modeling.space import Space, signals, vector

Array = NDArray[np.float64]

LARGEST_DERIVATIVE = 100_000
"""Operations of a sample times parameters above which no derivative is generated: megabytes of code."""


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model, its parameters theta (k,) in its order, and the sampling interval dt (s) where it has memory.

    Recording-specific disturbances are left out; `dropped` are their ids.
    """

    model: WrenchModel
    theta: Array
    dt: float | None
    dropped: tuple[str, ...]

    @classmethod
    def of(cls, model: WrenchModel, theta: Array, dt: float | None = None) -> FittedModel:
        """A fitted model without its recording-specific disturbances; dt (s) is needed where it has memory."""
        values = dict(zip((p.name for p in model.parameters), map(float, theta), strict=True))
        kept = model.without_recording_specific
        theta = np.array([values[p.name] for p in kept.parameters])
        return cls(kept, theta, dt, tuple(e.id for e in model.effects if e.per_recording))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """The signals of a sample, sorted by name."""
        return sample_inputs(self.model)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the contact wrench's components."""
        return contact_components(self.model.space)

    @property
    def size(self) -> int:
        """The number of channels p."""
        return len(self.model.channels)

    # -------------------------------------------------------------------------------------- its programs

    @cached_property
    def program(self) -> SampleProgram:
        """One sample; InputError as from `sample_program`."""
        return sample_program(self.model, self.theta, self.dt)

    @property
    def residual(self) -> tuple[sp.Symbol, ...]:
        """Symbols of the reading minus the prediction (p,)."""
        return tuple(sp.Symbol(f"sample:residual_{i}", real=True) for i in range(self.size))

    @cached_property
    def contact(self) -> SampleProgram:
        """The contact wrench (p,) of a `residual`: inverse contact gain times residual."""
        gain, residual, sample = contact_gain(self.model), sp.Matrix(self.residual), SampleProgramBuilder({}, 0.0)
        if not gain.free_symbols:
            return sample.finished(sample.assigned("contact", list(gain.inv() * residual)))
        zero, wrench = [sp.S.Zero] * self.size, signals(*self.components)
        equation = list(gain * sp.Matrix(wrench) - residual)
        about = "contact gain * contact = residual: linear, one step of Newton's method solves it"
        solve = sample.solved(
            "contact", zero, equation, lambda unknowns: tuple(zip(wrench, unknowns, strict=True)), steps=1, about=about
        )
        return sample.finished(solve)

    # ------------------------------------------------------------------------------------ its parameters

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that the generated code takes, in the model's order."""
        used = self.program.free_symbols | self.contact.free_symbols
        return tuple(p for p in self.model.parameters if p.symbol in used)

    @property
    def fixed_parameters(self) -> tuple[Parameter, ...]:
        """The parameters whose values are fixed in a discretisation, or in the model."""
        return tuple(p for p in self.model.parameters if p not in self.parameters)

    @cached_property
    def values(self) -> dict[str, float]:
        """Estimates of all parameters of the model, by name."""
        return dict(zip((p.name for p in self.model.parameters), map(float, self.theta), strict=True))

    # ------------------------------------------------------------------------------------ its derivative

    @cached_property
    def sensitivity(self) -> StraightLineProgram | None:
        """Derivative (p, len(parameters)) of load + bias, row by row.

        None where the tool deflects, since the deflection has memory, and above LARGEST_DERIVATIVE.
        """
        too_long = self.reading.shared.operations.total * len(self.parameters) > LARGEST_DERIVATIVE
        if self.model.chain.deflection is not None or too_long:
            return None
        return forward_derivative(self.reading.shared, [p.symbol for p in self.parameters])

    @cached_property
    def reading(self) -> StraightLineProgram:
        """load + bias (p,)."""
        whole = self.model.load + self.model.bias
        return StraightLineProgram.of(list(whole), required_definitions(self.model.definitions, whole))

    @cached_property
    def linear(self) -> bool:
        """Whether a reading is the derivative times the parameters: linear, without memory, play or saturation."""
        symbols = {p.symbol for p in self.model.parameters}
        if not compiled_prediction(self.model).instantaneous or self.sensitivity is None:
            return False
        if self.sensitivity.free_symbols & symbols:
            return False
        return not any(e.xreplace(dict.fromkeys(symbols, sp.S.Zero)) for e in self.reading.results)

    @property
    def derivative_name(self) -> str:
        """The derivative's name in generated code: regressor where the model is linear in the parameters."""
        return "regressor" if self.linear else "sensitivity"


def has_memory(model: WrenchModel) -> bool:
    """Whether a reading depends on earlier samples (linear dynamics, play or deflection)."""
    return model.chain.deflection is not None or any(stage.memory for stage in model.chain.dynamics)


def sample_inputs(model: WrenchModel) -> tuple[str, ...]:
    """The signals that the prediction of one sample needs, sorted by name; time only if an effect depends on it."""
    stages = (vector for stage in model.chain.dynamics for vector in stage.vectors().values())
    vectors = (model.load, model.chain.equilibrium(), *stages)
    return tuple(sorted({name for vector in vectors for name in model.inputs_of(vector)}))


def sample_program(model: WrenchModel, theta: Array, dt: float | None) -> SampleProgram:
    """One sample of a model with the parameters theta (k,), at the sampling interval dt (s).

    The initial state is the steady state under the first sample. Signals and parameters are free symbols, but for those
    parameters that a discretisation fixes. Raises InputError when the model has memory and no dt is given, when its
    transfer function has no stable proper rational realisation with a delay, or when the inertia of a deflecting tool
    is not positive definite.
    """
    return _sample_program(model, tuple(map(float, theta)), dt)


@lru_cache(maxsize=16)
def _sample_program(model: WrenchModel, theta: tuple[float, ...], dt: float | None) -> SampleProgram:
    values = dict(zip((p.symbol for p in model.parameters), theta, strict=True))
    chain, step = model.chain, _sampling_interval(model, dt)
    sample = SampleProgramBuilder(values, step, model.definitions)
    tool = compiled_prediction(model).deflection
    if chain.deflection is not None and tool is not None:
        discrete = DiscreteDeflection.of(tool.equation, len(tool.inputs), np.array(theta), step)
        deflected(discrete, sample, chain.deflection, chain.equilibrium())
    reading = sample.assigned("load", list(model.load), about="load: the reading before the sensor's dynamics and bias")
    for stage in chain.dynamics:
        reading = stage.step(sample, reading)
    return sample.finished(reading)


def _sampling_interval(model: WrenchModel, dt: float | None) -> float:
    """dt (s); 0 for a model without memory when it is not given. InputError, naming the effects, for one with."""
    if dt is None and has_memory(model):
        dynamic = ", ".join(e.id for e in model.effects if has_memory(model.base + e))
        what = f"the model has memory ({dynamic}), and the sampling interval is not known"
        raise InputError(what=what, where="rate", remedy="give --rate HZ, the sampling rate at which the code will run")
    return 0.0 if dt is None else dt


# ----------------------------------------------------------------------------------------- its monitor


@dataclass(frozen=True, eq=False)
class MonitorProgram:
    """The numbers of a monitor of a fitted model: all that its recursion takes beside the model and its derivative.

    The k parameters are those of the derivative, biases first, as deviations from the fit in `units` (k,), 0 for one
    that is fixed. Filter 0 says that nothing changed; filter j > 0 that the parameters of group j did, which come first
    in its `orders[j]` (k,). A filter is the square-root information (R z) of the parameters, (k, k + 1).

    noise      of the residual, with its order and root
    lag        samples by which the derivative is delayed before it is compared with the residual
    block      samples in a block
    groups     names of the groups, in the order of the filters from 1 on; `members` are the places of their parameters
    priors     (J + 1, k, k) what the fit knows, upper triangular; `pull` is the share of it that returns every block
    factors    (J + 1, k) what every row of R is multiplied by before the next block: the forgetting
    walk       (p,) std of the walk of the biases from block to block, in units
    gate       chi-square of a step of the bias above which a block teaches filter 0 nothing
    unknown    std, in units, of a parameter of which nothing is known
    cap        largest growth of the log evidence in a block
    refuted    log evidence of a block below which a filter starts anew from filter 0
    doubt      log likelihood ratio up to which times and groups are not told apart
    least_fall  of the log likelihood of a group, after which its change is later
    threshold  log evidence at which a change is stated: the log of the blocks in which one false alarm is expected at
               most, and `contact_blocks` caps
    first_blocks  in which a filter learns the zero
    """

    fitted: FittedModel
    units: Array
    noise: NoiseModel
    lag: int
    block: int
    groups: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]
    orders: NDArray[np.intp]
    priors: Array
    factors: Array
    pull: float
    walk: Array
    gate: float
    unknown: float
    cap: float
    refuted: float
    doubt: float
    least_fall: float
    threshold: float
    contact_blocks: int
    first_blocks: int

    @property
    def taps(self) -> Array:
        """From a residual to its innovations, (p, order + 1): 1, and the coefficients with the other sign."""
        return np.column_stack([np.ones(self.noise.coefficients.shape[1]), -self.noise.coefficients.T])

    @property
    def places(self) -> NDArray[np.intp]:
        """Places of the biases in the order of each filter, (J + 1, p)."""
        return np.argsort(self.orders, axis=1)[:, : len(self.walk)]

    @property
    def expected_blocks(self) -> float:
        """Blocks in which one false alarm is expected at most."""
        return float(np.exp(self.threshold - self.contact_blocks * self.cap))


@dataclass(frozen=True)
class RigidToolRegressor:
    """Phi (p, k) with reading = Phi theta, convention `on_tool`: 22.8 in the plane, 6 x 16 in six axes.

    Inputs in the plane: ax, ay, phi, dphi, ddphi, and g = 9.806 m/s². In six axes a, omega, alpha of the sensor
    origin in the sensor frame, with a its acceleration minus gravity: the load depends on the orientation only
    through it.
    """

    space: Space

    @property
    def arguments(self) -> dict[str, tuple[str, ...]]:
        """The arguments with their components, in order."""
        if self.space is Space.PLANE:
            return {name: (name,) for name in ("ax", "ay", "phi", "dphi", "ddphi")}
        return {name: tuple(f"{name}_{axis}" for axis in "xyz") for name in ("a", "omega", "alpha")}

    @property
    def inputs(self) -> tuple[str, ...]:
        """The components of all arguments, in order."""
        return tuple(name for components in self.arguments.values() for name in components)

    @cached_property
    def model(self) -> WrenchModel:
        """The rigid-tool model."""
        return planar() if self.space is Space.PLANE else WrenchModel(space=self.space)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order of the columns."""
        return self.model.parameters

    @cached_property
    def matrix(self) -> sp.Matrix:
        """Phi (p, k), symbolic."""
        if self.space is Space.PLANE:
            return regressor(self.model)
        lift, omega, alpha = (vector(*signals(*components)) for components in self.arguments.values())
        wrench = sp.Matrix.vstack(*newton_euler(rigid_body(self.space), lift, omega, alpha))
        return (wrench + self.model.bias).applyfunc(sp.expand).jacobian([p.symbol for p in self.parameters])

    @cached_property
    def program(self) -> StraightLineProgram:
        """The elements of Phi, row by row."""
        return StraightLineProgram.of(list(self.matrix))
