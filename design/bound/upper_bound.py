"""Upper bound by duality: assembly, column generation and proof."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from math import log

import numpy as np

from design.bound.branch_and_bound import BranchAndBoundResult, branch_and_bound
from design.bound.column_generation import ColumnGeneration, ColumnGenerationResult, GenerationProgress
from design.bound.dual_function import DualFunction, DualVariables
from design.bound.duality_bound import BoundKind, DualityBound
from design.bound.periodicity_conditions import PeriodicityConditions, PolynomialDegrees
from design.bound.symmetry import Symmetry, symmetries, symmetrised_measure
from design.bound.viable_states import ViableStates
from design.information import Experiment
from design.information.parameter_values import ParameterValues
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise.autoregressive_noise import NoiseModel
from modeling.rig.rig import Limits
from modeling.space import Space

MOST_BOUNDED_JOINTS = 4
"""2n dimensions are searched at 2^n vertices; beyond, random starts are too sparse to check a bound."""
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
        A planar arm of at most 4 joints.
    limits : Limits
        Of joint position, velocity and acceleration; rad, rad/s, rad/s².
    samples : int
        Readings of one run.
    values : mapping of str to float, optional
        Parameters by name, for effects whose columns depend on them; nominal where not named.
    noise : NoiseModel, optional
        Weights of the readings; by default unweighted SI.
    degrees : PolynomialDegrees, optional
        Of the conditions: higher ones are tighter and take longer.
    effort : Effort, optional
        Tolerances, starts and time of the search and the proof.
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
        For an arm that is not planar or has more than 4 joints, limits of another number of joints or without zero
        inside, and models whose columns are not affine in ddq or do not follow from the state alone.

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
    _require_planar(arm, limits)
    effort, rng = effort or Effort(), np.random.default_rng(seed)
    experiment = Experiment.of(model, arm, values, noise=noise)
    function, found = dual_function(experiment, ViableStates(limits), degrees or PolynomialDegrees(), seed)
    generation = ColumnGeneration(function, found, rng, effort.tolerance, effort.starts, executor, progress)
    return _bound(function, generation.run(effort.rounds), found, effort, samples)


def dual_function(
    experiment: Experiment, viable: ViableStates, degrees: PolynomialDegrees, seed: int
) -> tuple[DualFunction, tuple[Symmetry, ...]]:
    """F with the periodicity conditions that are useful under the symmetries, and the symmetries."""
    plain = DualFunction(
        experiment, PeriodicityConditions(viable=viable, degrees=PolynomialDegrees(each=0, pair=0, more=0))
    )
    found = symmetries(lambda states: plain.moments(states)[0], viable, seed)
    changes = tuple(symmetry.change for symmetry in found)
    return DualFunction(experiment, PeriodicityConditions(viable=viable, degrees=degrees, changes=changes)), found


def _bound(
    function: DualFunction, generated: ColumnGenerationResult, found: tuple[Symmetry, ...], effort: Effort, samples: int
) -> DualityBound:
    """The bound of the best dual, proven where requested."""
    k, many, dual = function.size, function.size * log(samples), generated.dual
    proven = _proven(function, dual, effort)
    checked = dual.value + many
    enclosed = None if proven is None else checked + k * log(proven.upper / k)
    closed = proven is not None and proven.closed
    states, weights = symmetrised_measure(*generated.measure.support(function), found)
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


def _require_planar(arm: Arm, limits: Limits) -> None:
    if arm.space is not Space.PLANE or arm.joints > MOST_BOUNDED_JOINTS:
        what = f"the bound is for planar arms of at most {MOST_BOUNDED_JOINTS} joints"
        raise InputError(what=what, where="bound", remedy="design without it (`--no-bound`): no efficiency is given")
    if limits.joints != arm.joints:
        what = f"limits of {arm.joints} joints were expected, and of {limits.joints} came"
        raise InputError(what=what, where="limits", remedy="give the limits of this arm")
