"""Experiment: what readings along a motion say of the parameters of a model at given values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.information.graph import columns_graph, total_of_state, weighted
from design.information.noise import SensorNoise, WhiteNoise
from design.information.sampling import CLOCK, Sampling
from design.information.state import signal_names, signals_along
from design.information.term import Term, sensitivity_terms
from design.information.values import Values, values_of
from design.motion.series import Motion
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.model import WrenchModel
from modeling.parameter import Parameter
from modeling.space import Space

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment:
    """Readings of p channels along a motion of n joints, by their derivatives S_t (p, k) in k unknowns.

    terms       what S_t is the sum of, each a matrix of signals through a transfer function
    parameters  what the columns of S_t are derivatives by
    channels    names of the channels
    arm         says what the joints do to the sensor, None where its signals themselves are given
    noise       weight of the readings, None for unweighted SI

    The information of N samples is M = sum_t S_t' W S_t (k, k): the Fisher information for Gaussian noise, with the
    covariance of the efficient estimate its inverse. With no noise it is Phi' Phi of 22.11.
    """

    terms: tuple[Term, ...]
    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    arm: Arm | None = None
    noise: SensorNoise | None = None

    def __post_init__(self) -> None:
        if self.arm is not None:
            _require(self.inputs, (*signal_names(self.arm), *CLOCK), "this arm's joints")

    @classmethod
    def of(
        cls,
        model: WrenchModel,
        arm: Arm | None,
        theta: Values | Array | None = None,
        *,
        noise: SensorNoise | None = None,
    ) -> Experiment:
        """The parameters of a model at theta, by name (nominal where not named) or in the model's order.

        Raises InputError when the joints of the arm do not give a signal that the model needs, or the information
        depends on parameters and theta is not given.
        """
        return cls.prior(model, arm, [theta], noise=noise)

    @classmethod
    def prior(
        cls,
        model: WrenchModel,
        arm: Arm | None,
        thetas: Sequence[Values | Array | None],
        *,
        noise: SensorNoise | None = None,
    ) -> Experiment:
        """The parameters at each of m sets of values, side by side: S_t = [S_t(theta_1) .. S_t(theta_m)].

        The information has m diagonal blocks, which `criterion.Averaged` averages over.
        """
        if arm is not None and arm.space is not model.space:
            raise InputError(
                what=f"a {_word(model.space)} model came with a {_word(arm.space)} arm",
                where="experiment",
                remedy="take a planar model with a planar arm, a spatial one with a spatial arm",
            )
        model = model.of_arm(arm)
        strange = [e.id for e in model.effects if not e.stage.adds]
        if strange:
            what = f"{strange[0]} is neither of one instant nor linear in the past"
            raise InputError(what=what, where="experiment", remedy="leave that effect out of the design")
        size, terms = len(model.parameters), list[Term]()
        for place, theta in enumerate(thetas):
            terms += sensitivity_terms(model, values_of(model, theta), place * size)
        return cls(
            terms=tuple(terms),
            parameters=model.parameters * len(thetas),
            channels=model.channels,
            arm=arm,
            noise=noise,
        )

    def __getstate__(self) -> dict[str, Any]:
        # Functions stay behind: workers of a pool make their own.
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
    def remembers(self) -> bool:
        """Whether the columns of a sample depend on other samples, by the model's memory or by the noise's."""
        return any(term.response is not None for term in self.terms) or not isinstance(self.noise, WhiteNoise | None)

    @property
    def timed(self) -> bool:
        """Whether the columns of a sample depend on when it is taken."""
        return bool(set(self.inputs) & set(CLOCK))

    # ------------------------------------------------------------------------------------- in numbers

    def columns(self, q: Array, dq: Array, ddq: Array, period: float, *, periodic: bool = True) -> Array:
        """Weighted sensitivities (N, p, k) at joint states (N, n) of one motion that takes `period` (s).

        Their products sum to the information: M = sum_t columns_t' columns_t.
        """
        sampling = Sampling(duration=period, samples=len(q), periodic=periodic)
        return self.signal_columns(signals_along(self._arm, q, dq, ddq), sampling)

    def signal_columns(self, signals: Mapping[str, Array], sampling: Sampling) -> Array:
        """The same (N, p, k) from the model's signals (N,), whatever they come from."""
        known = {**dict(zip(CLOCK, sampling.clock, strict=True)), **signals}
        _require(self.inputs, tuple(known), "these signals")
        columns = np.zeros((sampling.samples, len(self.channels), self.size))
        for term in self.terms:
            values = term.values(known, sampling.samples)
            columns[:, :, list(term.columns)] += (
                values if term.response is None else sampling.through(term.response, values)
            )
        return columns if self.noise is None else self.noise.whitened(columns, sampling.step)

    def information(self, motion: Motion, samples: int) -> Array:
        """M (k, k) of N samples of one run of the motion (one period of a periodic one)."""
        time = motion.series.instants(samples)
        columns = self.columns(*motion.evaluate(time), motion.period, periodic=motion.series.periodic)
        return gram(columns)

    # ------------------------------------------------------------------------------------ as CasADi graphs

    def sample(self) -> Any:
        """CasADi function (SX) from one state (q, dq, ddq), (3n,), to its weighted columns (p k,), column by column.

        Raises InputError when something remembers or depends on the time, so that a state alone does not say.
        """
        import casadi as ca

        if self.remembers or self.timed:
            raise InputError(
                what="what a sample says does not follow from its state alone",
                where="experiment",
                remedy="leave memory, time and coloured noise out, or take the information of whole motions",
            )
        state = ca.SX.sym("x", 3 * self.joints)
        total = total_of_state(self._arm, self.terms, (len(self.channels), self.size))(state, [0.0] * len(CLOCK))
        columns = ca.DM(self.noise.root) @ total if isinstance(self.noise, WhiteNoise) else total
        return ca.Function("sample", [state], [ca.vec(columns)])

    def graph(self, states: Any, period: float, *, periodic: bool = True) -> Any:
        """M (k, k) as a CasADi graph over the states (3n, N) of one motion, memory and noise included."""
        sampling = Sampling(duration=period, samples=states.shape[1], periodic=periodic)
        shape = (len(self.channels), self.size)
        rows = weighted(columns_graph(self._arm, self.terms, shape, states, sampling), self.noise, sampling)
        return sum(row @ row.T for row in rows)

    @property
    def _arm(self) -> Arm:
        if self.arm is None:
            raise InputError(what="no arm gives the signals of its joints", where="experiment", remedy="give an arm")
        return self.arm


def gram(columns: Array) -> Array:
    """sum_t S_t' S_t (k, k) of S (N, p, k)."""
    rows = columns.reshape(-1, columns.shape[2])
    return np.asarray(rows.T @ rows)


def _word(space: Space) -> str:
    return "planar" if space is Space.PLANE else "spatial"


def _require(inputs: Sequence[str], known: Sequence[str], source: str) -> None:
    missing = [name for name in inputs if name not in known]
    if missing:
        raise InputError(
            what=f"the model needs the signal '{missing[0]}', which {source} do not give",
            where="experiment",
            remedy="leave the effect that needs it out of the design",
        )
