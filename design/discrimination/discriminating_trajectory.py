"""T-optimal trajectory that discriminates a model from its rivals, and its assessment."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from design.discrimination.design_setting import DesignSetting
from design.discrimination.directed_pair import DirectedPair
from design.discrimination.discrimination_design import DiscriminationDesign
from design.discrimination.exchange_algorithm import ExchangeAlgorithm, ExchangeProgress, ExchangeRound
from design.discrimination.hypothesis import Hypothesis
from design.discrimination.model_pair import ModelPair, Separation
from design.discrimination.whitened_prediction import WhitenedPrediction
from design.exciting_trajectory import DesignInterrupted
from design.information.parameter_values import ParameterValues
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.noise.stationary_noise import StationaryNoise
from modeling.rig.rig import Rig
from modeling.rival_fit import RivalFit
from modeling.significance import LEVELS

DISCRIMINATION_STARTS = 4
"""Random trajectories from which the optimisation starts."""
PROBE_TRAJECTORIES = 4
"""Random trajectories with the rank of all (almost surely), where readings are analytic in the trajectory."""
MOST_RUNS = 1000
"""A pair that would need more than this multiple of the runs along random trajectories is not designed for while others
need less: a designed trajectory saves a factor of about ten (3 to 20, once 70: `benchmarks.discrimination`), and nobody
makes the remaining factor in runs."""
REFERENCE_COUNT = 9
"""Random trajectories whose median lambda represents a trajectory that was not designed."""
EXACT_FIT = 1e-8
"""A rival is indistinguishable when its residual is below this share of the effect's whitened norm. Rounding leaves
1e-14, a search that ends at 1e-12 of the parameters a little more; the nearest distinguishable rivals of the catalogue,
a lag and a delay, differ by half their time times the trajectory's rad/s: 1e-2 at 8 ms."""


@dataclass(frozen=True, eq=False)
class ReferenceTrajectories:
    """Trajectories to compare with: a given one, or random ones that represent any."""

    views: tuple[WhitenedPrediction, ...]
    description: str

    @classmethod
    def of(
        cls, setting: DesignSetting, reference: Trajectory | WhitenedPrediction | None, randoms: Sequence[Trajectory]
    ) -> ReferenceTrajectories:
        """The reference, or the random trajectories where there is none."""
        if reference is None:
            return cls(tuple(map(setting.view, randoms)), f"median of {len(randoms)} random trajectories")
        view = setting.view(reference) if isinstance(reference, Trajectory) else reference
        return cls((view,), "the given trajectory")


@dataclass(frozen=True, eq=False)
class RivalComparison:
    """A directed pair and its rival fit along all reference trajectories.

    first_fit          the rival fit along all of them together
    before             lambda along one of them, their median
    typical            lambda along a random trajectory, with the samples of the optimisation
    indistinguishable  whether the rival is indistinguishable along any trajectory
    """

    direction: DirectedPair
    first_fit: RivalFit
    before: float
    typical: float
    indistinguishable: bool

    @classmethod
    def of(
        cls, direction: DirectedPair, before: ReferenceTrajectories, probes: Sequence[WhitenedPrediction], reach: float
    ) -> RivalComparison:
        """With lambda the median of the reference trajectories; indistinguishable by the fit along the probes."""
        first_fit = direction.rival_fit(before.views, reach)
        single = [direction.rival_fit([view], reach, [first_fit.theta]).noncentrality for view in before.views]
        power = direction.power(probes)
        noncentrality = direction.rival_fit(probes, reach, [first_fit.theta]).noncentrality
        exact = direction.nested_in_rival or noncentrality <= EXACT_FIT**2 * power
        return cls(direction, first_fit, float(np.median(single)), noncentrality / len(probes), exact)


def discriminate(
    rig: Rig,
    truth: WrenchModel,
    values: ParameterValues,
    rivals: Sequence[WrenchModel],
    *,
    series: TrajectorySeries,
    samples: int,
    noise: StationaryNoise,
    reference: Trajectory | WhitenedPrediction | None = None,
    runs: int = 1,
    starts: int = DISCRIMINATION_STARTS,
    seed: int = 0,
    executor: Executor | None = None,
    progress: ExchangeProgress | None = None,
) -> DiscriminationDesign:
    """The T-optimal trajectory of a series, within the limits of the rig, to discriminate a model from its rivals.

    Both directions count: the rival's fit to the truth and, with the rival true, the truth's fit to it. A pair that no
    trajectory discriminates in a realistic number of runs does not influence the trajectory for the others.

    Parameters
    ----------
    rig : Rig
        The arm and its limits.
    truth : WrenchModel
        The model taken as true.
    values : mapping of str to float
        Its parameters by name: from a model file or a fit.
    rivals : sequence of WrenchModel
        Alternative models; their parameters are those of their fit to the truth along the reference.
    series : TrajectorySeries
        The family of trajectories.
    samples : int
        Equally spaced readings of one run.
    noise : NoiseModel or ColouredNoise
        Noise of the readings.
    reference : Trajectory, optional
        The trajectory along which they were not discriminated, or a `WhitenedPrediction` of its signals; by default
        rivals are fitted along some random trajectories together, and lambda before is the median over these.
    runs : int, optional
        Number of runs of the trajectory, by default 1.
    starts : int, optional
        Random starts.
    seed : int, optional
        Of the random starts, by default 0.
    executor : Executor, optional
        Runs the starts in parallel (any like `concurrent.futures.Executor`); the result is the same.
    progress : callable, optional
        Called after every exchange.

    Returns
    -------
    DiscriminationDesign
        The trajectory, and the noncentrality and detection probability of every pair along it.

    Raises
    ------
    InputError
        For a rig without arm or limits, a recording-specific effect, a signal that does not follow from the joints, and
        values at which the truth's prediction equals a rival's.
    DesignInterrupted
        A KeyboardInterrupt (Ctrl-C) with the result of the exchanges so far as `best`; None before the first.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> truth, rival = tw.planar(rig) + tw.effects.viscous_drag(), tw.planar(rig) + tw.effects.quadratic_drag()
    >>> values = {"m": 0.8, "mlg": 0.08, "I": 0.013, "viscous_drag.c": 1.0, "viscous_drag.d": 0.15}
    >>> found = tw.discriminate(
    ...     rig,
    ...     truth,
    ...     values,
    ...     [rival],
    ...     series=tw.FreeSeries(joints=3, harmonics=(1, 2), period=5.0),
    ...     samples=40,
    ...     noise=tw.NoiseModel.white([0.1, 0.1, 0.01]),
    ...     starts=1,
    ... )
    >>> len(found.pairs)
    1
    """
    setting = DesignSetting.of(rig, series=series, samples=samples, noise=noise)
    truth, *rivals = (model.with_arm(setting.arm) for model in (truth, *rivals))
    setting.require([truth, *rivals])
    randoms = [setting.random((seed, 0, number)) for number in range(REFERENCE_COUNT)]
    probes = tuple(setting.view(motion, setting.coarse) for motion in randoms[:PROBE_TRAJECTORIES])
    before = ReferenceTrajectories.of(setting, reference, randoms)
    hypothesis = Hypothesis.of(truth, values)
    pairs = [_comparisons(DirectedPair(hypothesis, rival), before, probes, setting.reach) for rival in rivals]
    distinct = [comparison for pair in pairs for comparison in pair if not comparison.indistinguishable]
    rounds: list[ExchangeRound] = []
    interrupted = False

    def note(done: ExchangeRound) -> None:
        rounds.append(done)
        if progress is not None:
            progress(done)

    if distinct:
        targets = _feasible(distinct, runs * samples / setting.coarse)
        search = ExchangeAlgorithm(
            setting=setting, directions=tuple(c.direction for c in targets), probes=probes, executor=executor
        )
        try:
            search.run([c.first_fit for c in targets], starts=starts, seed=seed, progress=note)
        except KeyboardInterrupt:
            interrupted = True
            if not rounds:
                raise DesignInterrupted from None
    best = max(rounds, key=lambda found: found.smallest, default=None)
    after = {} if best is None else dict(zip(distinct, _separations_along(setting, best.motion, distinct), strict=True))
    found = DiscriminationDesign(
        setting=setting,
        motion=None if best is None else best.motion,
        pairs=tuple(ModelPair(directions=_separations(pair, after, runs), runs=runs) for pair in pairs),
        runs=runs,
        reference=before.description,
        rounds=tuple(rounds),
    )
    if interrupted:
        raise DesignInterrupted(found)
    return found


def _comparisons(
    forward: DirectedPair, before: ReferenceTrajectories, probes: Sequence[WhitenedPrediction], reach: float
) -> tuple[RivalComparison, RivalComparison]:
    """A directed pair and its reverse, in which the rival is true at its fitted values."""
    if not forward.power(probes) and not forward.nested_in_rival:
        what = f"at the values given, {forward.names[0]} changes no reading"
        raise InputError(what=what, where="effects to be discriminated", remedy="give its values, from a fit")
    comparison = RivalComparison.of(forward, before, probes, reach)
    reverse = DirectedPair(Hypothesis(forward.rival, comparison.first_fit.theta), forward.truth.model)
    other = RivalComparison.of(reverse, before, probes, reach)
    # A rival fitted to a truth that is nested in it equals the truth: the reverse is indistinguishable, too.
    return comparison, replace(other, indistinguishable=True) if forward.nested_in_rival else other


def _feasible(distinct: Sequence[RivalComparison], readings: float) -> list[RivalComparison]:
    """Those that a designed trajectory may discriminate, all if none; `readings` is the factor of lambda."""
    feasible = [c for c in distinct if MOST_RUNS * readings * c.typical > LEVELS.confusable]
    return feasible or list(distinct)


def _separations_along(
    setting: DesignSetting, motion: Trajectory, distinct: Sequence[RivalComparison]
) -> list[tuple[float, float]]:
    """lambda of each truth from its rival, and from itself without its effects, along all samples of one run."""
    views, reach = [setting.view(motion)], setting.reach
    return [
        (
            comparison.direction.rival_fit(views, reach, [comparison.first_fit.theta]).noncentrality,
            comparison.direction.without_own_effects.rival_fit(views, reach).noncentrality,
        )
        for comparison in distinct
    ]


def _separations(
    pair: tuple[RivalComparison, RivalComparison], after: dict[RivalComparison, tuple[float, float]], runs: int
) -> tuple[Separation, Separation]:
    one, other = (
        Separation(
            truth=comparison.direction.names[0],
            rival=comparison.direction.names[1],
            before=runs * comparison.before,
            after=runs * after.get(comparison, (0.0, 0.0))[0],
            detection=runs * after.get(comparison, (0.0, 0.0))[1],
            indistinguishable=comparison.indistinguishable,
        )
        for comparison in pair
    )
    return one, other
