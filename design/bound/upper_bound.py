"""Upper bound by duality: assembly, column generation and proof."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from enum import Enum
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from design.bound.branch_and_bound import BranchAndBoundResult, WeakDuality, branch_and_bound
from design.bound.column_generation import ColumnGeneration, ColumnGenerationResult, GenerationProgress, GenerationRound
from design.bound.dual_function import (
    DualFunction,
    DualVariables,
    PeriodicityConditions,
    PolynomialDegrees,
    Symmetry,
    ViableStates,
    symmetries,
    symmetrised_measure,
)
from design.bound.multistart_ascent import DualMaximum
from design.information import Experiment
from design.information.experiment import ParameterValues
from design.trajectories.trajectory import Trajectory
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import NoiseModel
from modeling.rig import Limits
from modeling.table import Table, Tabular

Array = NDArray[np.float64]
STATE_NAMES = ("q", "dq", "ddq")


class BoundKind(Enum):
    """Basis of the bound: a rigorous enclosure of F over all viable states, or a search for its largest value."""

    PROVEN = "proven"
    CHECKED = "checked"


@dataclass(frozen=True, eq=False, kw_only=True)
class DualityBound(Tabular):
    """An upper bound on ln det of N times the time mean of Phi'Phi, of any periodic trajectory within the limits.

    For D positive definite, ln det M <= -ln det D + tr(D M) - k. Along a periodic trajectory the mean of L h vanishes,
    so that with M = mean Phi'Phi, tr(D M) = mean F <= max F over the viable states. The best multiple of (D, c) makes
    this ln det M <= -ln det D + k ln(max F / k), and N M adds k ln N. Position, velocity and acceleration limits are
    used; a workspace, limits of jerk, the period and the bandwidth are not, which leaves the bound valid. It also holds
    for trajectories that start and end at rest in one posture: they meet all periodicity conditions too.

    It bounds the mean over time. N equally spaced samples are a quadrature of it: `weak_duality(motion)` gives its
    error.

    logdet        the bound; `kind`: proven or checked
    checked       the bound from the largest F found
    proven        the bound from the rigorous enclosure of F; None where none was made
    primal_value  the least bound that any dual for these conditions can give, to within rounding
    function      F, with the conditions' names; dual: its variables, so scaled that the largest F found is k
    states        (m, 3n) and weights (m,): support of the optimal design measure under these conditions
    """

    logdet: float
    kind: BoundKind
    checked: float
    proven: float | None
    primal_value: float
    samples: int
    function: DualFunction
    dual: DualVariables
    largest: DualMaximum
    proof: BranchAndBoundResult | None
    states: Array
    weights: Array
    rounds: tuple[GenerationRound, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the k parameters."""
        return tuple(p.name for p in self.function.experiment.parameters)

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the functions h."""
        return self.function.conditions.names

    def efficiency(self, logdet: float) -> float:
        """(det M / det M_bound)^(1/k): the share of the samples that the bound would need."""
        return exp((logdet - self.logdet) / len(self.parameters))

    def weak_duality(self, motion: Trajectory) -> WeakDuality:
        """Weak duality checked along one trajectory, and the quadrature error of its samples."""
        return WeakDuality.of(self.function, self.dual, motion, self.samples)

    @property
    def table(self) -> Table:
        """The bound, its conditions, and what is checked and proven."""
        return Table.of(("", ""), self.rows)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Names and values of the table."""
        return [
            ("upper bound of ln det", f"{self.logdet:.3f} ({self.kind.value}), {self.samples} samples"),
            ("primal value under these conditions", f"{self.primal_value:.3f}"),
            ("parameters", ", ".join(self.parameters)),
            ("periodicity conditions", f"{len(self.conditions)}, in {len(self.rounds)} rounds"),
            ("optimal design measure", self._measure()),
            ("checked", self._checked()),
            ("proven", self._proven()),
        ]

    def _measure(self) -> str:
        limits = self.function.viable.limits
        pairs = np.vstack([limits.position, limits.velocity, limits.acceleration])
        middle, half = pairs.mean(axis=1), np.ptp(pairs, axis=1) / 2
        shares = np.sqrt(self.weights @ ((self.states - middle) / half) ** 2).reshape(3, -1)
        texts = (f"{name} {', '.join(f'{s:.2f}' for s in row)}" for name, row in zip(STATE_NAMES, shares, strict=True))
        return f"{len(self.weights)} states; rms in shares of the limits: {'; '.join(texts)}"

    def _checked(self) -> str:
        search = f"{self.largest.ascents} ascents from the best of {self.largest.starts} random starts"
        return f"{self.checked:.3f}, if no viable state has a larger F than those found by {search}"

    def _proven(self) -> str:
        theory = "weak duality, and the viable set"
        if self.proof is None or self.proven is None:
            return f"{theory}; the largest F is not"
        return f"{self.proven:.3f}, {self.proof}; {theory}"


MOST_BOUNDED_JOINTS = 7
"""2n dimensions are searched at 2^n vertices; beyond, random starts are too sparse to check a bound."""
FEW_JOINTS = 4
"""To which the default degrees and starts apply. Of more joints polynomials of low degrees are as many: 66 of six."""
DEGREES_OF_MANY_JOINTS = PolynomialDegrees(each=4, pair=2, more=0)
"""Half a minute for six joints and sixteen parameters."""
STARTS_OF_MANY_JOINTS = 4000
"""Each is tried at 2^n vertices: sixteen times as many of six joints as of two."""
PROOF_SECONDS = 20.0
"""Ten times the duration of the proof for one joint; for more joints it does not close in such a time."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Computational effort for a bound.

    tolerance      optimality gap in ln det
    rounds         of column generation, at most; the reference problem takes some 20
    starts         random starts of the search for the largest F of a promising dual
    proof_margin   share by which the proven largest F may exceed the one found: 0.002 costs 0.002 k in ln det
    proof_seconds  of branch and bound, 0 for no proof; None for `PROOF_SECONDS` with one joint, none with more
    """

    tolerance: float = 0.025
    rounds: int = 60
    starts: int = 40_000
    proof_margin: float = 0.002
    proof_seconds: float | None = None

    def __post_init__(self) -> None:
        if self.rounds < 1 or self.starts < 1 or not self.tolerance > 0:
            what = f"{self.rounds} rounds, {self.starts} starts and a tolerance of {self.tolerance} came"
            raise InputError(what=what, where="effort", remedy="give positive numbers")


def upper_bound(
    model: WrenchModel,
    arm: Arm,
    limits: Limits,
    *,
    samples: int,
    values: ParameterValues | None = None,
    noise: NoiseModel | None = None,
    degrees: PolynomialDegrees | None = None,
    effort: Effort | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: GenerationProgress | None = None,
) -> DualityBound:
    """An upper bound on ln det of the information of any periodic trajectory within the limits.

    Parameters
    ----------
    model : WrenchModel
        The model whose parameters are to be estimated.
    arm : Arm
        Planar or spatial, of at most 7 joints.
    limits : Limits
        Of joint position, velocity and acceleration; rad, rad/s, rad/s².
    samples : int
        Readings of one run.
    values : mapping of str to float, optional
        Parameters by name, for effects whose columns depend on them; nominal where not named.
    noise : NoiseModel, optional
        Weights of the readings; by default unweighted SI.
    degrees : PolynomialDegrees, optional
        Of the conditions: higher ones are tighter and take longer. By default lower ones above 4 joints.
    effort : Effort, optional
        Tolerances, starts and time of the search and the proof. By default fewer starts above 4 joints.
    seed : int, optional
        Of the random starts, by default 0.
    executor : Executor, optional
        Runs the searches in parallel; the result is the same.
    progress : callable, optional
        Called after every round.

    Returns
    -------
    DualityBound
        The bound, proven or checked, with the measure on states that attains the dual's optimum.

    Raises
    ------
    InputError
        For an arm of more than 7 joints, limits of another number of joints or without zero inside, and models whose
        columns are not affine in ddq or do not follow from the state alone.

    Notes
    -----
    The D-optimal measure on the viable states, under conditions that every periodic trajectory meets
    (`PeriodicityConditions`), by column generation on its dual; then a search for the largest F from fresh starts, and
    a proof if requested.

    Examples
    --------
    >>> import truewrench as tw
    >>> from pathlib import Path
    >>> limits = "[limits]\\nposition = [1.2]\\nvelocity = [2.5]\\nacceleration = [12.0]\\n"
    >>> _ = Path("one.toml").write_text(f"[robot]\\nlink_lengths = [0.4]\\n{limits}")
    >>> one = tw.Rig.read("one.toml")
    >>> bound = tw.upper_bound(tw.planar(one), one.arm, one.limits, samples=40)
    >>> bound.logdet > 0
    True
    """
    _require_joints(arm, limits)
    if arm.joints > FEW_JOINTS:
        degrees, effort = degrees or DEGREES_OF_MANY_JOINTS, effort or Effort(starts=STARTS_OF_MANY_JOINTS)
    effort, rng = effort or Effort(), np.random.default_rng(seed)
    experiment = Experiment.of(model, arm, values, noise=noise)
    function, sign_symmetries = dual_function(experiment, ViableStates(limits), degrees or PolynomialDegrees(), seed)
    generation = ColumnGeneration(function, sign_symmetries, rng, effort.tolerance, effort.starts, executor, progress)
    return _bound(function, generation.run(effort.rounds), sign_symmetries, effort, samples)


def dual_function(
    experiment: Experiment, viable: ViableStates, degrees: PolynomialDegrees, seed: int
) -> tuple[DualFunction, tuple[Symmetry, ...]]:
    """F with the periodicity conditions that are useful under the symmetries, and the symmetries."""
    plain = DualFunction(
        experiment, PeriodicityConditions(viable=viable, degrees=PolynomialDegrees(each=0, pair=0, more=0))
    )
    sign_symmetries = symmetries(lambda states: plain.moments(states)[0], viable, seed)
    changes = tuple(symmetry.change for symmetry in sign_symmetries)
    return DualFunction(
        experiment, PeriodicityConditions(viable=viable, degrees=degrees, changes=changes)
    ), sign_symmetries


def _bound(
    function: DualFunction,
    generated: ColumnGenerationResult,
    sign_symmetries: tuple[Symmetry, ...],
    effort: Effort,
    samples: int,
) -> DualityBound:
    """The bound of the best dual, proven where requested."""
    k, many, dual = function.size, function.size * log(samples), generated.dual
    proven = _proven(function, dual, effort)
    checked = dual.value + many
    enclosed = None if proven is None else checked + k * log(proven.upper / k)
    closed = proven is not None and proven.closed
    states, weights = symmetrised_measure(*generated.measure.support(function), sign_symmetries)
    return DualityBound(
        logdet=checked if enclosed is None or not closed else enclosed,
        kind=BoundKind.PROVEN if closed else BoundKind.CHECKED,
        checked=checked,
        proven=enclosed,
        primal_value=generated.measure.lower + many,
        samples=samples,
        function=function,
        dual=dual,
        largest=generated.largest,
        proof=proven,
        states=states,
        weights=weights,
        rounds=generated.rounds,
    )


def _proven(function: DualFunction, dual: DualVariables, effort: Effort) -> BranchAndBoundResult | None:
    default = PROOF_SECONDS if function.joints == 1 else 0.0
    seconds = default if effort.proof_seconds is None else effort.proof_seconds
    if seconds <= 0:
        return None
    return branch_and_bound(function, dual, target=function.size * (1 + effort.proof_margin), seconds=seconds)


def _require_joints(arm: Arm, limits: Limits) -> None:
    if arm.joints > MOST_BOUNDED_JOINTS:
        what = f"the bound is for arms of at most {MOST_BOUNDED_JOINTS} joints"
        raise InputError(what=what, where="bound", remedy="design without it (`--no-bound`): no efficiency is given")
    if limits.joints != arm.joints:
        what = f"limits of {arm.joints} joints were expected, and of {limits.joints} came"
        raise InputError(what=what, where="limits", remedy="give the limits of this arm")
