"""Experiment: sensitivities and Fisher information of a model's parameters along a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from design.information.sensitivities import (
    CLOCK_SIGNALS,
    Sampling,
    SensitivityTerm,
    sensitivity_function,
    sensitivity_graph,
    sensitivity_terms,
    signal_names,
    signals_along,
    whitened_graph,
)
from design.trajectories.fourier import random_periodic_trajectory
from design.trajectories.trajectory import Trajectory
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.identifiability import ScaledSVD, UnidentifiableDirection, unidentifiable_directions
from modeling.kinematics.arm import Arm
from modeling.noise import NoiseModel, StationaryNoise
from modeling.parameter import Parameter
from modeling.rig import Limits
from modeling.space import Space

Array = NDArray[np.float64]
ParameterValues = Mapping[str, float]

# Parameter values at which an experiment is designed, and the parameters in which it is nonlinear.


def parameter_vector(model: WrenchModel, theta: ParameterValues | Array | None) -> Array:
    """Values of the model's parameters (k,), given by name, in order, or not at all where it is linear in them.

    Raises InputError for an unknown name, a wrong number of values, or no values where the sensitivities depend on
    them.
    """
    names = [p.name for p in model.parameters]
    if theta is None and nonlinear_parameters(model):
        raise InputError(
            what="its information depends on the values of its parameters",
            where=" + ".join(["rigid tool", *(e.id for e in model.effects)]),
            remedy="give their values, expected or from a fit (a model file)",
        )
    if theta is None or isinstance(theta, Mapping):
        given = dict(theta or {})
        unknown = sorted(set(given) - set(names))
        if unknown:
            raise InputError(what=f"the model has no parameter {unknown[0]}", where="theta", remedy=f"use {names}")
        return np.array([given.get(p.name, p.nominal) for p in model.parameters], dtype=float)
    values = np.asarray(theta, dtype=float)
    if values.shape != (len(names),):
        what = f"{len(names)} values were expected, and an array of shape {values.shape} came"
        raise InputError(what=what, where="theta", remedy="give one value for each parameter of the model")
    return values


def nonlinear_parameters(model: WrenchModel) -> tuple[int, ...]:
    """Indices of the parameters that the sensitivities depend on; none of a model that is linear in them.

    With d reading = H d load + dH load, those are the ones that d load or d zero depend on, and with dynamics those of
    H and of the load.
    """
    prediction = compiled_prediction(model)
    indices = set(prediction.transfer_parameters)
    for vector in (prediction.load, prediction.bias):
        parameters = vector.symbols[1]
        slopes = ca.vec(ca.jacobian(vector.graph, parameters))
        indices |= {i for i, depends in enumerate(ca.which_depends(slopes, parameters, 1, False)) if depends}
    return tuple(sorted(indices | (set(prediction.load.active) if prediction.has_transfer_function else set())))


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment:
    """Readings of p channels along a trajectory of n joints, by their sensitivities S_t (p, k) to k parameters.

    Parameters
    ----------
    terms : tuple of SensitivityTerm
        Summands of S_t, each a matrix of signals through a transfer function.
    parameters : tuple of Parameter
        Of the columns of S_t, in their order.
    channels : tuple of str
        Names of the channels.
    arm : Arm, optional
        Kinematics from the joints to the sensor, None where the sensor's signals are given.
    noise : StationaryNoise, optional
        Weight of the readings, None for unweighted SI.

    Notes
    -----
    The information of N samples is M = sum_t S_t' W S_t (k, k): the Fisher information for Gaussian noise, with the
    covariance of the efficient estimate its inverse. With no noise it is Phi' Phi of 22.11. `Experiment.of` makes one
    of a model and an arm.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> motion = tw.PaperSeries(period=5.0).chapter_optimum
    >>> tw.Experiment.of(tw.planar(rig), rig.arm).information(motion, 200).shape
    (6, 6)
    """

    terms: tuple[SensitivityTerm, ...]
    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    arm: Arm | None = None
    noise: StationaryNoise | None = None

    def __post_init__(self) -> None:
        if self.arm is not None:
            _require_signals(self.inputs, (*signal_names(self.arm), *CLOCK_SIGNALS), "this arm's joints")

    @classmethod
    def of(
        cls,
        model: WrenchModel,
        arm: Arm | None,
        theta: ParameterValues | Array | None = None,
        *,
        noise: StationaryNoise | None = None,
    ) -> Experiment:
        """The parameters of a model at theta, by name (nominal where not named) or in the model's order.

        Raises InputError when a signal that the model needs does not follow from the joints of the arm, or the
        information depends on parameters and theta is not given.
        """
        return cls.prior(model, arm, [theta], noise=noise)

    @classmethod
    def prior(
        cls,
        model: WrenchModel,
        arm: Arm | None,
        thetas: Sequence[ParameterValues | Array | None],
        *,
        noise: StationaryNoise | None = None,
    ) -> Experiment:
        """The parameters at each of m sets of values, side by side: S_t = [S_t(theta_1) .. S_t(theta_m)].

        The information has m diagonal blocks, over which `BayesianCriterion` takes the expectation.
        """
        if arm is not None and arm.space is not model.space:
            raise InputError(
                what=f"a {_word(model.space)} model came with a {_word(arm.space)} arm",
                where="experiment",
                remedy="take a planar model with a planar arm, a spatial one with a spatial arm",
            )
        model = model.with_arm(arm).unrestricted
        unsuitable = [e.id for e in model.effects if not e.stage.adds]
        if unsuitable:
            what = f"{unsuitable[0]} is neither static nor linear dynamic"
            raise InputError(what=what, where="experiment", remedy="leave that effect out of the design")
        size, terms = len(model.parameters), list[SensitivityTerm]()
        for number, theta in enumerate(thetas):
            terms += sensitivity_terms(model, parameter_vector(model, theta), number * size)
        return cls(
            terms=tuple(terms),
            parameters=model.parameters * len(thetas),
            channels=model.channels,
            arm=arm,
            noise=noise,
        )

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: workers of a pool compile their own.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def joints(self) -> int:
        """The number of joints n; 0 without an arm."""
        return 0 if self.arm is None else self.arm.joints

    @property
    def size(self) -> int:
        """The number of columns k."""
        return len(self.parameters)

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names of all signals needed."""
        return tuple(sorted({name for term in self.terms for name in term.inputs}))

    @property
    def has_memory(self) -> bool:
        """Whether the columns of a sample depend on other samples, by dynamic effects or by coloured noise."""
        return any(term.response is not None for term in self.terms) or not (self.noise is None or self.noise.is_white)

    @property
    def timed(self) -> bool:
        """Whether the columns of a sample depend on when it is taken."""
        return bool(set(self.inputs) & set(CLOCK_SIGNALS))

    # ------------------------------------------------------------------------------------- numerically

    def columns(self, q: Array, dq: Array, ddq: Array, period: float, *, periodic: bool = True) -> Array:
        """Weighted sensitivities (N, p, k) at joint states (N, n) of one trajectory of duration `period` (s).

        Their products sum to the information: M = sum_t columns_t' columns_t.
        """
        sampling = Sampling(duration=period, samples=len(q), periodic=periodic)
        return self.signal_columns(signals_along(self._arm, q, dq, ddq), sampling)

    def signal_columns(self, signals: Mapping[str, Array], sampling: Sampling) -> Array:
        """The same (N, p, k) from the model's signals (N,) by name."""
        all_signals = {**dict(zip(CLOCK_SIGNALS, sampling.clock, strict=True)), **signals}
        _require_signals(self.inputs, tuple(all_signals), "these signals")
        columns = np.zeros((sampling.samples, len(self.channels), self.size))
        for term in self.terms:
            values = term.values(all_signals, sampling.samples)
            columns[:, :, list(term.columns)] += (
                values if term.response is None else sampling.through(term.response, values)
            )
        return columns if self.noise is None else self.noise.whitened(columns, sampling.step)

    def information(self, motion: Trajectory, samples: int) -> Array:
        """M (k, k) of N samples of one run of the trajectory (one period of a periodic one)."""
        time = motion.series.instants(samples)
        columns = self.columns(*motion.evaluate(time), motion.period, periodic=motion.series.periodic)
        return gram(columns)

    # ------------------------------------------------------------------------------------ as CasADi graphs

    def sample(self) -> Any:
        """CasADi function (SX) from one state (q, dq, ddq), (3n,), to its weighted columns (p k,), column by column.

        Raises InputError when the columns depend on other samples or on time, and not on the state alone.
        """
        if self.has_memory or self.timed:
            raise InputError(
                what="the information of a sample does not follow from its state alone",
                where="experiment",
                remedy="leave out dynamic effects, time and coloured noise, or take the information of trajectories",
            )
        state = ca.SX.sym("x", 3 * self.joints)
        total = sensitivity_function(self._arm, self.terms, (len(self.channels), self.size))(
            state, [0.0] * len(CLOCK_SIGNALS)
        )
        columns = ca.DM(self.noise.root) @ total if isinstance(self.noise, NoiseModel) else total
        return ca.Function("sample", [state], [ca.vec(columns)])

    def graph(self, states: Any, period: float, *, periodic: bool = True) -> Any:
        """M (k, k) as a CasADi graph over the states (3n, N) of one trajectory, dynamics and noise included."""
        sampling = Sampling(duration=period, samples=states.shape[1], periodic=periodic)
        shape = (len(self.channels), self.size)
        rows = whitened_graph(sensitivity_graph(self._arm, self.terms, shape, states, sampling), self.noise, sampling)
        return sum(row @ row.T for row in rows)

    @property
    def _arm(self) -> Arm:
        if self.arm is None:
            raise InputError(what="no arm was given for the joint signals", where="experiment", remedy="give an arm")
        return self.arm


def gram(columns: Array) -> Array:
    """sum_t S_t' S_t (k, k) of S (N, p, k)."""
    rows = columns.reshape(-1, columns.shape[2])
    return np.asarray(rows.T @ rows)


def _word(space: Space) -> str:
    return "planar" if space is Space.PLANE else "spatial"


def _require_signals(inputs: Sequence[str], available: Sequence[str], source: str) -> None:
    missing = [name for name in inputs if name not in available]
    if missing:
        raise InputError(
            what=f"the model needs the signal '{missing[0]}', which {source} do not give",
            where="experiment",
            remedy="leave the effect that needs it out of the design",
        )


# Sensitivities along random trajectories: identifiability on any trajectory, noise-equivalent parameter sizes.


RANDOM_TRAJECTORIES = 4
"""With `RANDOM_SAMPLES` each they are 768 readings of three channels: many times the parameters of a model."""
RANDOM_SAMPLES = 64
"""Samples of a random trajectory."""
RANDOM_PERIOD = 5.0
"""Seconds: with velocities of some rad/s an arm traverses its range in it."""
DEFAULT_LIMITS = (2.0, 2.0, 10.0)
"""rad, rad/s and rad/s², large enough to excite every parameter, for an arm whose limits are not known."""


def random_sensitivities(experiment: Experiment, limits: Limits | None, seed: int) -> Array:
    """Weighted sensitivities (R, k) along some random trajectories of all joints, within the limits where known."""
    motions = [_motion(experiment.joints, limits, (seed, number)) for number in range(RANDOM_TRAJECTORIES)]
    time = motions[0].series.instants(RANDOM_SAMPLES)
    return np.concatenate(
        [experiment.columns(*m.evaluate(time), RANDOM_PERIOD).reshape(-1, experiment.size) for m in motions]
    )


def unidentifiable_combinations(
    experiment: Experiment, limits: Limits | None = None, *, seed: int = 0
) -> tuple[UnidentifiableDirection, ...]:
    """A sparse basis of the null space of the sensitivities over all trajectories of the arm.

    Where the sensitivities are analytic in the trajectory, random trajectories have the largest rank of all (almost
    surely).
    """
    root = np.asarray(np.linalg.qr(random_sensitivities(experiment, limits, seed), mode="r"))
    return unidentifiable_directions(ScaledSVD.of(root), experiment.parameters, "any trajectory of this arm")


def noise_equivalent_sizes(experiment: Experiment, limits: Limits | None = None, *, seed: int = 0) -> Array:
    """The size (k,) of each parameter, in its unit, whose contribution to the readings equals their noise.

    In RMS over samples and channels along random trajectories of the arm; without noise, 1 in SI. As scale of the
    criteria A and E it makes them independent of the units of the parameters. Raises InputError for an unidentifiable
    parameter.
    """
    size = np.sqrt((random_sensitivities(experiment, limits, seed) ** 2).mean(axis=0))
    if not size.all():
        raise InputError(
            what=f"{experiment.parameters[int(np.argmin(size))].name} changes no reading",
            where="experiment",
            remedy="leave it out of the model, or give its effect an amplitude above zero",
        )
    return np.asarray(1 / size, dtype=float)


def _motion(joints: int, limits: Limits | None, seed: tuple[int, int]) -> Trajectory:
    if limits is None:
        position, velocity, acceleration = (np.full(joints, value) for value in DEFAULT_LIMITS)
    else:
        position = limits.position
        velocity, acceleration = (np.abs(pairs).min(axis=1) for pairs in (limits.velocity, limits.acceleration))
    return random_periodic_trajectory(
        joints=joints, position=position, velocity=velocity, acceleration=acceleration, period=RANDOM_PERIOD, seed=seed
    )
