"""Design of an exciting trajectory from a rig and a model: multistart optimisation, then the upper bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from time import perf_counter

from design.bound import DualityBound, GenerationRound, upper_bound
from design.criteria import BayesianCriterion, Criterion, DOptimal
from design.exciting_trajectory import DesignInterrupted, ExcitingTrajectory
from design.information import DiscretePrior, Experiment, unidentifiable_combinations
from design.information.experiment import ParameterValues
from design.limits import arm_and_limits, between_poses, require_enough_samples, require_motion_within_period
from design.optimiser.design_task import LOW_HARMONICS, DesignTask
from design.optimiser.interior_point import TerminationStatus
from design.optimiser.local_optimum import (
    LocalOptimum,
    LocalSearch,
    continue_start,
    contracted_optimum,
    optimise,
    refine_optimum,
    screen_start,
)
from design.optimiser.objective import Objective
from design.trajectories.fourier import FourierSeries, FreeSeries, PaperSeries
from design.trajectories.spline import LOWEST_DEGREE, RestToRest, SplineSeries
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import StationaryNoise
from modeling.rig import Limits, Rig
from modeling.space import Space

DEFAULT_PERIOD = 5.0
"""s: the reference problem's."""
DEFAULT_SAMPLES = 200
"""The reference problem's: 40 a second."""
DEFAULT_HARMONICS = tuple(range(1, 13))
"""Of the series when none is given: up to 2.4 Hz in 5 s, which controllers of large arms follow."""
DEFAULT_STARTS = 24
"""Random starts of a series with few and many harmonics."""
FEW_HARMONIC_STARTS = 48
"""Random starts of a series of few harmonics, all in one stage. Of equation 22.10 (`PaperSeries`; 30 seeds, 72 starts
each) 17 % of odd starts and 8 % of others lead to the highest optimum: 48 of which five in six are odd miss it for one
seed in 2700, 24 of which two in three are for one in 34."""
STARTS_WHEN_SLOW = 6
"""Random starts where six axes, dynamic effects or a large series make each take several times as long."""
LARGE_SERIES = 100
"""Coefficients of a large series: the time of a step grows with their square."""
NOT_ODD = 3
"""One start in so many is not odd in time: from odd ones the highest optima are found more often."""
FEW_HARMONIC_NOT_ODD = 6
"""The same for a series of few harmonics: the optimum need not be odd, but an odd start takes a quarter less time."""
LOW_HARMONIC_STARTS = 3
"""One start in so many has few harmonics, whose few optima any seed finds."""
MIXED_STARTS = 6
"""One start in so many mixes the best of these optima with other random trajectories: they reliably lead to good optima
of the whole series; random trajectories of it, the other half of the starts, sometimes lead to better ones."""
RANDOM_SHARE = 0.2
"""Share of the random trajectory in a mixture."""
REFINED_OPTIMA = 3
"""The best distinct optima that are refined."""
LOW_HARMONIC_OPTIMA = 2
"""The best distinct optima of few harmonics that are continued with all."""
CONTINUED_OPTIMA = 4
"""The same where each start takes long: of six axes any of few harmonics leads to within a few tenths of the best."""
MOST_WAVES_AT_ONCE = 6
"""Highest harmonic with which a search without second derivatives starts at once: of five harmonics (seven joints) the
optima are then 0.4 higher than by four first, of twelve (six joints) 1.1 lower."""
COARSE_SPLINE, MIDDLE_SPLINE = 4, 2
"""A planar spline of degree 2 with many knots is searched with a quarter of them from random starts, 0.15 s each, then
with half: 0.1 nats higher than from Fourier series of few harmonics. Of degree 3 it would be 0.2 to 0.3 nats, in two to
four times as long."""
SPLINE_STARTS, MIDDLE_OPTIMA, REFINED_SPLINES = 36, 12, 6
"""The starts, and the best distinct optima that are refined with half of the knots and with all: which ends highest is
open. With 24, 8 and 3 it takes 10 s instead of 19, and ends 0.02 to 0.03 nats lower."""
REFINED_WHEN_SLOW = 2
"""The best distinct optima that are refined then."""
DISTINCT_OPTIMA = 2e-3
"""Nats: optima with closer values count as one, up to a symmetry or a shift in time."""


NOT_REQUESTED = (None, "not requested")


@dataclass(frozen=True, eq=False)
class DesignStage:
    """Progress of a design: its stage, the best value so far, the starts done and the time to go.

    value    the best so far; None before there is any. Until the refinement of the best starts it is of trajectories
             that keep their limits at some instants only
    best     the best trajectory that keeps them at every instant; None before there is any
    done     of `total` starts; both zero where that is not known
    seconds  estimated time to the end of this stage; None before the first start is done
    """

    stage: str
    value: float | None = None
    best: LocalOptimum | None = None
    done: int = 0
    total: int = 0
    seconds: float | None = None

    def __str__(self) -> str:
        parts = [f"{self.stage}: {self.done} of {self.total} starts" if self.total else self.stage]
        if self.value is not None:
            parts.append(f"{self.value:.2f} reached")
        if self.seconds is not None:
            parts.append(f"about {self.seconds:.0f} s left")
        return ", ".join(parts)


DesignProgress = Callable[[DesignStage], None]


def design(
    rig: Rig,
    *,
    model: WrenchModel | None = None,
    values: ParameterValues | None = None,
    prior: DiscretePrior | None = None,
    criterion: Criterion | None = None,
    series: TrajectorySeries | None = None,
    samples: int = DEFAULT_SAMPLES,
    noise: StationaryNoise | None = None,
    starts: int | None = None,
    seed: int = 0,
    bounded: bool = True,
    executor: Executor | None = None,
    progress: DesignProgress | None = None,
) -> ExcitingTrajectory:
    """The most informative trajectory of a series for the model's parameters, within the limits of the rig.

    Parameters
    ----------
    rig : Rig
        The arm and its limits.
    model : WrenchModel, optional
        By default the rig's rigid tool; recording-specific disturbances, backlash, deflection and saturation are left
        out.
    values : mapping of str to float, optional
        Parameters by name, where the sensitivities depend on them; by default nominal.
    prior : DiscretePrior, optional
        Sets of values for a Bayesian criterion (`DiscretePrior.around` a fit's covariance); by default at `values`.
    criterion : Criterion, optional
        By default D-optimal.
    series : TrajectorySeries, optional
        By default independent series of the joints with 12 harmonics in 5 s.
    samples : int, optional
        Equally spaced readings of one run.
    noise : NoiseModel or ColouredNoise, optional
        Weight of the readings; by default unweighted SI.
    starts : int, optional
        Random starts, of which the best optima are refined; by default 24, 48 of a series of few harmonics, 36
        of a planar spline of degree 2 with many knots, or 6 where each takes long.
    seed : int, optional
        Of the random starts, by default 0.
    bounded : bool, optional
        Whether the upper bound is computed too, some ten seconds for three joints; by default True.
    executor : Executor, optional
        Runs the starts and the bound's searches (any like `concurrent.futures.Executor`); the result is the same.
    progress : callable, optional
        Called while it works.

    Returns
    -------
    ExcitingTrajectory
        The trajectory, its value, bound, and use of the limits between the samples too.

    Raises
    ------
    InputError
        For a rig without arm or limits, too few samples, too short a period, a model with parameters that are
        unidentifiable along every trajectory of this arm, and limits that no trajectory keeps.
    DesignInterrupted
        A KeyboardInterrupt (Ctrl-C) with the result so far, within its limits at every instant, as `best`.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> series = tw.FreeSeries(joints=3, harmonics=(1, 2), period=5.0)
    >>> plan = tw.design(rig, series=series, samples=40, starts=1, bounded=False)
    >>> plan.logdet > 30
    True
    """
    arm, limits = arm_and_limits(rig)
    designable = (model or (planar if arm.space is Space.PLANE else spatial)(rig)).designable
    design_values = (
        None if values is None else {p.name: values[p.name] for p in designable.parameters if p.name in values}
    )
    experiment = Experiment.of(designable, arm, design_values, noise=noise)
    _require_identifiable(experiment, limits)
    chosen = series or FreeSeries(joints=arm.joints, harmonics=DEFAULT_HARMONICS, period=DEFAULT_PERIOD)
    chosen = between_poses(chosen, rig)
    require_enough_samples(chosen, samples)
    require_motion_within_period(chosen, limits)
    optimised, score = experiment, criterion or DOptimal()
    if prior is not None:
        optimised, score = (
            Experiment.prior(designable, arm, prior.sets, noise=noise),
            BayesianCriterion(score, prior.weights),
        )
    task = DesignTask(
        objective=Objective(experiment=optimised, criterion=score, series=chosen, samples=samples),
        limits=limits,
        arm=arm,
        workspace=rig.workspace,
        tip_length=rig.tip_length,
    )
    reached: list[LocalOptimum] = []
    searched: list[tuple[str, tuple[float, ...]]] = []

    def result(local_optima: tuple[LocalOptimum, ...], bound: DualityBound | None, reason: str) -> ExcitingTrajectory:
        return ExcitingTrajectory(
            task=task,
            experiment=experiment,
            local_optima=local_optima,
            evaluations=sum(optimum.evaluations for optimum in reached),
            bound=bound,
            no_bound_reason=reason,
            searched=tuple(searched),
        )

    optima: tuple[LocalOptimum, ...] = ()
    try:
        optima = _search(task, starts, seed, executor, progress, reached, searched)
        bound, reason = NOT_REQUESTED
        if bounded and isinstance(chosen, RestToRest) and chosen.travel is not None:
            reason = "the motion ends elsewhere than it starts, and the bound is on periodic ones"
        elif bounded:
            bound, reason = _bound(designable, arm, limits, samples, design_values, seed, executor, progress)
    except KeyboardInterrupt:
        best = optima or _best_so_far(task, reached)
        raise DesignInterrupted(result(best, None, "interrupted") if best else None) from None
    return result(optima, bound, reason)


def _best_so_far(task: DesignTask, reached: Sequence[LocalOptimum]) -> tuple[LocalOptimum, ...]:
    """The best of what was reached, in the task's series and contracted into its limits at every instant; if any."""
    series = task.objective.series
    motions = (optimum.motion for optimum in reached)
    projected = (motion if motion.series == series else motion.projected(series) for motion in motions)
    contracted = [contracted_optimum(task, motion, TerminationStatus.INTERRUPTED) for motion in projected]
    inside = [optimum for optimum in contracted if optimum is not None]
    return tuple(sorted(inside, key=lambda optimum: -optimum.value))[:1]


def _search(
    task: DesignTask,
    starts: int | None,
    seed: int,
    executor: Executor | None,
    progress: DesignProgress | None,
    reached: list[LocalOptimum],
    searched: list[tuple[str, tuple[float, ...]]],
) -> tuple[LocalOptimum, ...]:
    """Local optima of the task's series, best first; all that is reached is added to `reached` at once.

    The stages before the refinement are added to `searched`, with the values that their starts reached.
    """
    low = low_harmonic_series(task.objective.series)
    quick = task.second_order and task.objective.series.size <= LARGE_SERIES
    default = DEFAULT_STARTS if low is not None else FEW_HARMONIC_STARTS
    series = task.objective.series
    by_knots = task.second_order and isinstance(series, SplineSeries) and series.degree == LOWEST_DEGREE and not quick
    count = starts or (SPLINE_STARTS if by_knots else default if quick else STARTS_WHEN_SLOW)

    def run(stage: str, of: DesignTask, begin: Sequence[Trajectory], work: LocalSearch) -> tuple[LocalOptimum, ...]:
        watch = None if progress is None else _watch(stage, len(begin), progress, feasible=work is refine_optimum)

        def note(optimum: LocalOptimum) -> None:
            reached.append(optimum)
            if watch is not None:
                watch(optimum)

        local_optima = optimise(of, begin, work=work, executor=executor, progress=note)
        if work is not refine_optimum:
            searched.append((stage, tuple(optimum.value for optimum in local_optima)))
        return local_optima

    low_task = None if low is None else replace(task, objective=replace(task.objective, series=low))
    if by_knots:
        return _searched_by_knots(task, low_task, count, seed, run)
    if not quick:
        return _searched_slowly(task, low_task, [(seed, number) for number in range(count)], run)
    if low_task is None:
        begin = [_start(task, seed, number, FEW_HARMONIC_NOT_ODD) for number in range(count)]
        screened = run("starts", task, begin, screen_start)
        return run("refinement of the best", task, _best(screened, REFINED_OPTIMA), refine_optimum)
    begin = [_start(low_task, seed, number) for number in range(-(-count // LOW_HARMONIC_STARTS))]
    coarse = run("few harmonics", low_task, begin, screen_start)
    bases = [motion.projected(task.objective.series) for motion in _best(coarse, LOW_HARMONIC_OPTIMA)]
    mixtures = [
        _mixed(bases[number % len(bases)], task.random((seed, count + number)))
        for number in range(-(-count // MIXED_STARTS))
    ]
    others = [_start(task, seed, number) for number in range(count - count // 2, count)]
    screened = run("all harmonics", task, [*mixtures, *others], screen_start)
    return run("refinement of the best", task, _best(screened, REFINED_OPTIMA), refine_optimum)


StageRunner = Callable[[str, DesignTask, Sequence[Trajectory], LocalSearch], tuple[LocalOptimum, ...]]


def _searched_slowly(
    task: DesignTask, low_task: DesignTask | None, seeds: Sequence[tuple[int, int]], run: StageRunner
) -> tuple[LocalOptimum, ...]:
    """Local optima of all starts, with few harmonics where the series has many; then of the best with all."""
    series = task.objective.series
    if low_task is None or (isinstance(series, FourierSeries) and max(series.waves) <= MOST_WAVES_AT_ONCE):
        screened = run("starts", task, [task.random(seed) for seed in seeds], screen_start)
    else:
        coarse = run("few harmonics", low_task, [low_task.random(seed) for seed in seeds], screen_start)
        begin = [motion.projected(series) for motion in _best(coarse, CONTINUED_OPTIMA)]
        screened = run("all harmonics", task, begin, continue_start)
    return run("refinement of the best", task, _best(screened, REFINED_WHEN_SLOW), refine_optimum)


def _searched_by_knots(
    task: DesignTask, low_task: DesignTask | None, count: int, seed: int, run: StageRunner
) -> tuple[LocalOptimum, ...]:
    """Local optima of a spline: of all starts with few knots, of the best with more, then with all.

    The best of few harmonics is refined beside them: it is good already where there are few starts.
    """

    def fewer(share: int) -> DesignTask:
        series = task.objective.series
        assert isinstance(series, SplineSeries)
        knots = max(series.knots // share, series.degree + 1)
        return replace(task, objective=replace(task.objective, series=replace(series, knots=knots)))

    smooth: list[Trajectory] = []
    if low_task is not None:
        begin = [_start(low_task, seed, number) for number in range(-(-count // LOW_HARMONIC_STARTS))]
        low = _best(run("few harmonics", low_task, begin, screen_start), 1)
        continued = [motion.projected(task.objective.series) for motion in low]
        smooth = _best(run("all knots", task, continued, continue_start), 1)
    coarse, middle = fewer(COARSE_SPLINE), fewer(MIDDLE_SPLINE)
    optima = run("few knots", coarse, [_start(coarse, seed, number) for number in range(count)], continue_start)
    for stage, of, kept in (
        ("half the knots", middle, MIDDLE_OPTIMA),
        ("refinement of the best", task, REFINED_SPLINES),
    ):
        motions = [motion.projected(of.objective.series) for motion in _best(optima, kept)]
        optima = run(stage, of, [*motions, *(smooth if of is task else [])], refine_optimum)
    return optima


def _start(task: DesignTask, seed: int, number: int, not_odd: int = NOT_ODD) -> Trajectory:
    return task.varied((seed, number), odd=number % not_odd < not_odd - 1)


def _mixed(base: Trajectory, other: Trajectory) -> Trajectory:
    """A convex combination of two trajectories: it keeps the joint limits that both keep."""
    return replace(base, coefficients=(1 - RANDOM_SHARE) * base.coefficients + RANDOM_SHARE * other.coefficients)


def _best(local_optima: Sequence[LocalOptimum], count: int) -> list[Trajectory]:
    """The trajectories of the best local optima that differ in value, best first."""
    chosen = list[LocalOptimum]()
    for optimum in local_optima:
        if not chosen or chosen[-1].value - optimum.value > DISTINCT_OPTIMA:
            chosen.append(optimum)
    return [optimum.motion for optimum in chosen[:count]]


def low_harmonic_series(series: TrajectorySeries) -> TrajectorySeries | None:
    """The low-harmonic series that replaces a series in the first search; None when it has few harmonics itself."""
    if isinstance(series, RestToRest):
        inner = low_harmonic_series(series.inner)
        return None if inner is None else replace(series, inner=inner)
    if isinstance(series, PaperSeries) or (
        isinstance(series, FourierSeries) and max(series.waves) <= max(LOW_HARMONICS)
    ):
        return None
    return FreeSeries(joints=series.joints, harmonics=LOW_HARMONICS, period=series.duration)


def _watch(stage: str, total: int, progress: DesignProgress, *, feasible: bool) -> Callable[[LocalOptimum], None]:
    """Reports the starts done and the time to go; `feasible`: the optima keep the limits at every instant."""
    begun, local_optima = perf_counter(), list[LocalOptimum]()
    progress(DesignStage(stage, total=total))

    def watch(optimum: LocalOptimum) -> None:
        local_optima.append(optimum)
        best, done = max(local_optima, key=lambda a: a.value), len(local_optima)
        seconds = (perf_counter() - begun) * (total - done) / done
        progress(DesignStage(stage, best.value, best if feasible else None, done, total, seconds))

    return watch


def _bound(
    model: WrenchModel,
    arm: Arm,
    limits: Limits,
    samples: int,
    values: ParameterValues | None,
    seed: int,
    executor: Executor | None,
    progress: DesignProgress | None,
) -> tuple[DualityBound | None, str]:
    """The bound, or why there is none."""

    def watch(step: GenerationRound) -> None:
        if progress is not None:
            progress(DesignStage(f"bound, round {step.number}: optimality gap {step.best - step.lower:.2f}"))

    try:
        bound = upper_bound(
            model, arm, limits, samples=samples, values=values, seed=seed, executor=executor, progress=watch
        )
        return bound, ""
    except InputError as error:
        return None, error.what


def _require_identifiable(experiment: Experiment, limits: Limits) -> None:
    combinations = unidentifiable_combinations(experiment, limits)
    if combinations:
        remedy = "leave one of them out of the model (`fit --drop`)"
        raise InputError(what=str(combinations[0]), where="model", remedy=remedy)
