"""T-optimal trajectory that discriminates a model from its rivals, and its assessment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from design.criteria import Criterion
from design.discrimination.model_pair import (
    DirectedPair,
    Hypothesis,
    LinearisedRival,
    ModelPair,
    Separability,
    Separation,
    WhitenedPrediction,
    maximin_experiment,
)
from design.exciting_trajectory import DesignInterrupted
from design.information.experiment import Experiment, ParameterValues
from design.information.sensitivities import CLOCK_SIGNALS, signal_names
from design.limits import LimitUse, arm_and_limits, between_poses, require_enough_samples, require_motion_within_period
from design.optimiser.design_task import DesignTask
from design.optimiser.local_optimum import LocalOptimum, optimise
from design.optimiser.objective import Objective
from design.random_feasible import random_feasible_trajectory
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import StationaryNoise
from modeling.rig import Limits, Rig, Workspace
from modeling.rival_fit import RivalFit
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value

# Arm, limits, series, samples and noise of a discrimination design.


OPTIMISATION_SAMPLES = 128
"""Samples of a run in the optimisation: ten to the shortest wave of twelve harmonics, whose sums are then integrals to
a few per cent. Results are of all samples."""
DEFAULT_TIP_LENGTH = 0.2
"""m: tip length of a rig that states none; forces may act up to twice as far."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignSetting:
    """An arm, its limits, the trajectory series, samples of one run and their noise."""

    arm: Arm
    limits: Limits
    series: TrajectorySeries
    samples: int
    noise: StationaryNoise
    workspace: Workspace | None = None
    tip_length: float | None = None

    @classmethod
    def of(cls, rig: Rig, *, series: TrajectorySeries, samples: int, noise: StationaryNoise) -> Self:
        """Of a rig; InputError when it has no arm or no limits, the samples are too few or the period is too short."""
        arm, limits = arm_and_limits(rig)
        series = between_poses(series, rig)
        require_enough_samples(series, samples)
        require_motion_within_period(series, limits)
        return cls(
            arm=arm,
            limits=limits,
            series=series,
            samples=samples,
            noise=noise,
            workspace=rig.workspace,
            tip_length=rig.tip_length,
        )

    @property
    def reach(self) -> float:
        """Largest distance along the tip at which a force may act, m."""
        return 2 * (self.tip_length or DEFAULT_TIP_LENGTH)

    @property
    def coarse(self) -> int:
        """Samples of one run in the optimisation."""
        return min(self.samples, OPTIMISATION_SAMPLES)

    def view(self, motion: Trajectory, samples: int | None = None) -> WhitenedPrediction:
        """Whitened predictions along one run of a trajectory."""
        return WhitenedPrediction.along(motion, self.arm, samples=samples or self.samples, noise=self.noise)

    def random(self, seed: tuple[int, ...]) -> Trajectory:
        """A random feasible trajectory, as large as the limits allow."""
        return random_feasible_trajectory(
            self.series,
            self.limits,
            workspace=self.workspace,
            arm=self.arm,
            tip_length=self.tip_length,
            seed=seed,
        )

    def task(self, experiment: Experiment, criterion: Criterion) -> DesignTask:
        """The optimisation of a criterion of an experiment."""
        return DesignTask(
            objective=Objective(experiment=experiment, criterion=criterion, series=self.series, samples=self.coarse),
            limits=self.limits,
            arm=self.arm,
            workspace=self.workspace,
            tip_length=self.tip_length,
        )

    def use(self, motion: Trajectory) -> LimitUse:
        """Use of the limits by a trajectory, at every instant."""
        return LimitUse.of(motion, self.limits, self.workspace, self.arm, self.tip_length)

    def require(self, models: Iterable[WrenchModel]) -> None:
        """InputError for recording-specific effects, and for signals that do not follow from this arm's joints."""
        available = {*signal_names(self.arm), *CLOCK_SIGNALS}
        for model in models:
            recording_specific = [e.id for e in model.effects if e.per_recording]
            unsuitable = [e.id for e in model.effects if not e.designable]
            missing = [name for name in model.inputs if name not in available]
            if recording_specific:
                what = f"{recording_specific[0]} is recording-specific, and no trajectory reproduces it"
                raise InputError(what=what, where="effects to be discriminated", remedy="leave it out")
            if unsuitable:
                what = f"{unsuitable[0]} is neither static nor linear dynamic, and no trajectory can be designed for it"
                raise InputError(what=what, where="effects to be discriminated", remedy="leave it out")
            if missing:
                what = f"'{missing[0]}' is needed by {' + '.join(e.id for e in model.effects)}"
                what += ", and does not follow from the joint states"
                raise InputError(what=what, where="effects to be discriminated", remedy="leave that effect out")


# Max-min exchange between trajectory and rival fits (Blankenship and Falk).


EXCHANGE_ROUNDS = 8
"""Most rounds of trajectory and rival fits; three or four are typical."""
LEAST_GROWTH = 0.01
"""Relative growth of the smallest lambda needed for another round: a tenth of the gain by one more run in ten."""
RETAINED_FITS = 3
"""Rival fits of each direction against which a trajectory is optimised when the fits recur."""


@dataclass(frozen=True, eq=False)
class ExchangeRound:
    """The best trajectory of one round, and the exact rival fit along it in every direction."""

    number: int
    motion: Trajectory
    rival_fits: tuple[RivalFit, ...]

    @property
    def smallest(self) -> float:
        """The smallest lambda in one run with the samples of the optimisation."""
        return min(rival_fit.noncentrality for rival_fit in self.rival_fits)

    def __str__(self) -> str:
        return f"round {self.number}, smallest lambda {self.smallest:.4g}"


ExchangeProgress = Callable[[ExchangeRound], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class ExchangeAlgorithm:
    """max over trajectories of min over directions and theta of |y_truth - y_rival(theta)|².

    In turns: the trajectory is optimised for the lambda linearised at theta (`LinearisedRival`); along the new
    trajectory the rivals are fitted again, exactly. The linearised lambda is optimised only; results are exact. When
    lambda falls, rival fits recur in turn: then the trajectory is optimised against the last few of each direction
    together, until that no longer helps. This is the exchange of a max-min problem (Blankenship and Falk 1976) in which
    each block covers all theta near its own.
    """

    setting: DesignSetting
    directions: tuple[DirectedPair, ...]
    probes: tuple[WhitenedPrediction, ...]
    executor: Executor | None = None

    def run(
        self,
        first: Sequence[RivalFit],
        *,
        starts: int,
        further: Sequence[Trajectory],
        seed: int,
        progress: ExchangeProgress | None,
    ) -> list[ExchangeRound]:
        """The rounds, from random and `further` starts and the first rival fit of each direction."""
        rounds: list[ExchangeRound] = []
        histories = [[rival_fit] for rival_fit in first]
        retained = 1
        for number in range(1, EXCHANGE_ROUNDS + 1):
            task = self._task(histories, retained)
            initial = [max(rounds, key=lambda r: r.smallest).motion] if rounds else []
            initial = initial or [*further, *(task.random((seed, 1, start)) for start in range(starts))]
            exchange = self._best(number, optimise(task, initial, executor=self.executor), histories)
            best = max((r.smallest for r in rounds), default=0.0)
            rounds.append(exchange)
            if progress is not None:
                progress(exchange)
            grown, fallen = exchange.smallest > (1 + LEAST_GROWTH) * best, exchange.smallest < (1 - LEAST_GROWTH) * best
            if not grown and (retained > 1 or not fallen):
                break
            retained = 1 if grown else RETAINED_FITS
            for history, rival_fit in zip(histories, exchange.rival_fits, strict=True):
                history.append(rival_fit)
        return rounds

    def _task(self, histories: Sequence[list[RivalFit]], retained: int) -> DesignTask:
        """The optimisation against the last rival fits."""
        blocks = [
            LinearisedRival.of(direction, rival_fit.theta, self.probes)
            for direction, history in zip(self.directions, histories, strict=True)
            for rival_fit in history[-retained:]
        ]
        return self.setting.task(*maximin_experiment(blocks, self.setting.arm, self.setting.noise))

    def _best(
        self, number: int, local_optima: Sequence[LocalOptimum], histories: Sequence[list[RivalFit]]
    ) -> ExchangeRound:
        """The best trajectory by its exact smallest lambda."""
        rounds = [ExchangeRound(number, a.motion, self.rival_fits(a.motion, histories)) for a in local_optima]
        return max(rounds, key=lambda exchange: exchange.smallest)

    def rival_fits(self, motion: Trajectory, histories: Sequence[list[RivalFit]]) -> tuple[RivalFit, ...]:
        """The exact rival fit in every direction, started from all known fits too."""
        views = [self.setting.view(motion, self.setting.coarse)]
        return tuple(
            direction.rival_fit(views, self.setting.reach, [rival_fit.theta for rival_fit in history])
            for direction, history in zip(self.directions, histories, strict=True)
        )


# Result of model discrimination.


RARE = 1e-6
"""The least probability that is stated: noise is not so normal, and models are not so exact, that less were known."""
MOTIONS = ("before", "D-optimal", "after")
"""Along which lambda and error probability are given; the second one where there is such a trajectory."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscriminationDesign(Tabular):
    """A discriminating trajectory with the separation of each pair of models.

    motion     within the limits at every instant; None when no trajectory discriminates any of them
    exciting   the D-optimal trajectory that it is compared with, itself where that separates more; None if not given
    pairs      the given model with each of its rivals
    runs       of the trajectory, for which the lambdas hold
    reference  description of the trajectories of `before`
    rounds     of the exchange algorithm; the trajectory is that of the best one
    """

    setting: DesignSetting
    motion: Trajectory | None
    pairs: tuple[ModelPair, ...]
    runs: int
    reference: str
    rounds: tuple[ExchangeRound, ...]
    exciting: Trajectory | None = None

    @property
    def verdict(self) -> Separability:
        """The verdict of the least separated pair."""
        return max((pair.verdict for pair in self.pairs), key=list(Separability).index)

    @property
    def limit_use(self) -> LimitUse | None:
        """Use of each limit by the trajectory."""
        return None if self.motion is None else self.setting.use(self.motion)

    def to_data(self) -> dict[str, Any]:
        """Plain data: numbers are finite, or None."""
        motion, use = self.motion, self.limit_use
        return {
            "verdict": self.verdict.name.lower(),
            "pairs": [pair.to_data() for pair in self.pairs],
            "runs": self.runs,
            "samples": self.setting.samples,
            "period": self.setting.series.duration,
            "before": self.reference,
            "coefficients": None if motion is None else motion.coefficients.tolist(),
            "worst_limit_use": None if use is None else use.to_data(),
            "rounds": [exchange.smallest for exchange in self.rounds],
        }

    @property
    def table(self) -> Table:
        """Truth, rival, lambda and error probability along each trajectory, runs for 5 % and 1 % errors."""
        motions = [name for name in MOTIONS if name != "D-optimal" or self.exciting is not None]
        columns = (
            Column("true"),
            Column("rival"),
            *(Column(f"lambda {name}", format=".4g") for name in motions),
            *(Column(f"error {name}", format=".2g") for name in motions),
            *(Column(name, format="d") for name in ("runs for 5 %", "runs for 1 %")),
        )
        rows: list[tuple[Value, ...]] = []
        for pair in self.pairs:
            figures = dict(zip(MOTIONS, (pair.before, pair.exciting, pair.after), strict=True))
            errors: list[Value] = [pair.error_probability(figures[name]) for name in motions]
            errors = [f"< {RARE:g}" if isinstance(e, float) and e < RARE else e for e in errors]
            runs = [pair.runs_for(x) for x in (LEVELS.confusable, LEVELS.separated)]
            for d in pair.directions:
                after = "indistinguishable" if d.indistinguishable else d.after
                along: dict[str, Value] = {"before": d.before, "D-optimal": d.exciting, "after": after}
                others = [None] * (len(errors) + len(runs)) if d.indistinguishable else [*errors, *runs]
                rows.append((d.truth, d.rival, *(along[name] for name in motions), *others))
        return Table.of(columns, rows)

    def remarks(self) -> list[str]:
        """Verdict of each pair, the runs and the reference, and the use of the limits."""
        lines = [f"{pair.names[0]} or {pair.names[1]}: {_verdict(pair)}" for pair in self.pairs]
        lines.append(f"lambda in {self.runs} run{'s' * (self.runs > 1)} of the trajectory; before: {self.reference}")
        if gains := _gains(self.pairs):
            times = f"{min(gains):.3g} times the runs" if min(gains) > 1 else "the same runs: it is this one"
            lines.append(f"the D-optimal trajectory of the same model, series and noise would need {times}")
        if self.limit_use is not None:
            lines.append(self.limit_use.sentence())
        return lines


def _gains(pairs: Sequence[ModelPair]) -> list[float]:
    """Factors of lambda against the D-optimal trajectory, of the pairs with one."""
    return [pair.after / pair.exciting for pair in pairs if pair.exciting]


def _verdict(pair: ModelPair) -> str:
    if pair.verdict is Separability.NEVER:
        return f"{pair.verdict.value}; the simpler one is preferred"
    text = pair.verdict.value + ("; nested models: the simpler one is preferred unless it is rejected" * pair.nested)
    runs = pair.runs_for(LEVELS.separated)
    return (
        text if pair.verdict is Separability.SEPARATED else f"{text} ({'-' if runs is None else runs} for 1 % errors)"
    )


DISCRIMINATION_STARTS = 4
"""Random trajectories from which the optimisation starts."""
PROBE_TRAJECTORIES = 4
"""Random trajectories with the rank of all (almost surely), where readings are analytic in the trajectory."""
MOST_RUNS = 1000
"""A pair that would need more than this multiple of the runs along random trajectories is not designed for while others
need less: a designed trajectory saves a factor of about ten (3 to 20, once 70: `benchmarks.discrimination`), and nobody
makes the remaining factor in runs."""
DESIGNED_GAIN = 10.0
"""That factor of about ten: a truth that even a designed trajectory does not show beside the rigid tool is not designed
for where the other direction of its pair shows, as it does not count there (`ModelPair`)."""
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
    noticed            the same of the truth from itself without its distinguishing effects
    indistinguishable  whether the rival is indistinguishable along any trajectory
    """

    direction: DirectedPair
    first_fit: RivalFit
    before: float
    typical: float
    noticed: float
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
        noticed = direction.without_own_effects.rival_fit(probes, reach).noncentrality
        return cls(
            direction, first_fit, float(np.median(single)), noncentrality / len(probes), noticed / len(probes), exact
        )


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
    exciting: Trajectory | None = None,
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
    exciting : Trajectory, optional
        A D-optimal trajectory of the series to compare with, from which the optimisation starts too.
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
        targets = _feasible(pairs, runs * samples / setting.coarse)
        search = ExchangeAlgorithm(
            setting=setting, directions=tuple(c.direction for c in targets), probes=probes, executor=executor
        )
        try:
            further = [] if exciting is None else [exciting]
            search.run([c.first_fit for c in targets], starts=starts, further=further, seed=seed, progress=note)
        except KeyboardInterrupt:
            interrupted = True
            if not rounds:
                raise DesignInterrupted from None
    best = max(rounds, key=lambda exchange: exchange.smallest, default=None)
    motion = None if best is None else best.motion
    after = {} if motion is None else _separations_along(setting, motion, distinct)
    compared = {} if exciting is None else _separations_along(setting, exciting, distinct)
    judged = _judged(pairs, after, compared, runs)
    if motion is not None and exciting is not None and min(_gains(judged)) < 1:
        motion, judged = exciting, _judged(pairs, compared, compared, runs)
    plan = DiscriminationDesign(
        setting=setting,
        motion=motion,
        pairs=judged,
        runs=runs,
        reference=before.description,
        rounds=tuple(rounds),
        exciting=exciting,
    )
    if interrupted:
        raise DesignInterrupted(plan)
    return plan


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


def _feasible(pairs: Sequence[tuple[RivalComparison, RivalComparison]], readings: float) -> list[RivalComparison]:
    """The distinct ones that a designed trajectory may discriminate, and whose truth it may show, all if none.

    `readings` is the factor of lambda from one run with the samples of the optimisation to all runs.
    """
    distinct = [[c for c in pair if not c.indistinguishable] for pair in pairs]
    shown = [[c for c in pair if DESIGNED_GAIN * readings * c.noticed > LEVELS.confusable] or pair for pair in distinct]
    feasible = [c for pair in shown for c in pair if MOST_RUNS * readings * c.typical > LEVELS.confusable]
    return feasible or [c for pair in distinct for c in pair]


def _separations_along(
    setting: DesignSetting, motion: Trajectory, distinct: Sequence[RivalComparison]
) -> dict[RivalComparison, tuple[float, float]]:
    """lambda of each truth from its rival, and from itself without its effects, along all samples of one run."""
    views, reach = [setting.view(motion)], setting.reach
    return {
        comparison: (
            comparison.direction.rival_fit(views, reach, [comparison.first_fit.theta]).noncentrality,
            comparison.direction.without_own_effects.rival_fit(views, reach).noncentrality,
        )
        for comparison in distinct
    }


def _judged(
    pairs: Sequence[tuple[RivalComparison, RivalComparison]],
    after: Mapping[RivalComparison, tuple[float, float]],
    compared: Mapping[RivalComparison, tuple[float, float]],
    runs: int,
) -> tuple[ModelPair, ...]:
    """The pairs with lambda and detection along the designed and the D-optimal trajectory, in all runs."""

    def separation(comparison: RivalComparison) -> Separation:
        noncentrality, detection = after.get(comparison, (0.0, 0.0))
        return Separation(
            truth=comparison.direction.names[0],
            rival=comparison.direction.names[1],
            before=runs * comparison.before,
            after=runs * noncentrality,
            detection=runs * detection,
            indistinguishable=comparison.indistinguishable,
            exciting=runs * compared[comparison][0] if comparison in compared else None,
        )

    return tuple(ModelPair(directions=(separation(one), separation(other)), runs=runs) for one, other in pairs)
