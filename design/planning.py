"""Planning: from a rig and a model to the motion that tells most of the model's parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from time import perf_counter

from design.bound import Bound, Round, upper_bound
from design.criterion import Averaged, Criterion, DOptimal
from design.information import Experiment, Prior, SensorNoise, unseen
from design.information.values import Values
from design.motion.fourier import FourierSeries, FreeSeries, PaperSeries
from design.motion.rest_to_rest import RestToRest
from design.motion.series import Motion, Series
from design.optimiser.objective import Objective
from design.optimiser.optimiser import SLOW, Attempt, Task, Work, improve, optimise, polish, screen
from design.place import place_of, require_samples
from design.plan import Plan
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.model import WrenchModel, planar, spatial
from modeling.rig import Limits, Rig
from modeling.space import Space

PERIOD, SAMPLES = 5.0, 200
"""The reference problem's: 5 s, 40 samples a second."""
HARMONICS = tuple(range(1, 13))
"""Of the series when none is given: up to 2.4 Hz in 5 s, which controllers of large arms follow."""
STARTS, FEWER = 24, 6
"""Random starts, and how many where limits that are not linear, readings that remember or a large series make each
ten times as long."""
LARGE = 100
"""Coefficients of a series that is large: a step takes as long as their square."""
ODD = 2, 3
"""Two of three starts are odd in time, where the highest optima are found more often."""
SLOWER, MIXED = 3, 6
"""A third of the starts has few harmonics, whose few optima any seed finds. The best of them lead, mixed with other
random motions, to good optima of the whole series for sure (a sixth as many starts); random motions of the whole
series, the other half of the starts, lead to better ones now and then."""
SHARE = 0.2
"""Of the random motion in a mixture."""
REFINED, BASES = 3, 2
"""The best different optima that are followed to the end, and those of few harmonics that go on to all."""
DIFFERENT = 2e-3
"""Nats: optima of closer values are taken for one, up to a symmetry or a shift in time."""


NOT_ASKED = (None, "not asked for")


@dataclass(frozen=True, eq=False)
class Step:
    """How far the planning is: what it does, the best value so far, how much of it is done and how long it takes.

    value    the best so far; None before there is any. Until the best starts are followed to the end it is of motions
             that keep their limits at some instants only
    best     the best motion that keeps them at every instant; None before there is any
    done     of `total` starts; both zero where that is not known
    seconds  that the rest of this stage may take, by those done; None before the first
    """

    stage: str
    value: float | None = None
    best: Attempt | None = None
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


Progress = Callable[[Step], None]


def design(
    rig: Rig,
    *,
    model: WrenchModel | None = None,
    values: Values | None = None,
    prior: Prior | None = None,
    criterion: Criterion | None = None,
    series: Series | None = None,
    samples: int = SAMPLES,
    noise: SensorNoise | None = None,
    starts: int | None = None,
    seed: int = 0,
    bounded: bool = True,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Plan:
    """The motion of a series, within the limits of the rig, that tells most of the model's parameters.

    model      the rigid tool of the rig when None; effects of one recording, play, bend and clipping are left out
    values     of the parameters by name, where the sensitivities depend on them
    prior      sets of values over which the criterion is averaged (`Prior.around` a fit's covariance); None: at values
    criterion  D-optimal when None
    series     independent series of the joints with 12 harmonics in 5 s when None
    samples    equally spaced readings of one run
    noise      weight of the readings; None for unweighted SI
    starts     random starts, from `seed`; None for 24, or 6 where each takes long. The best optima are refined
    bounded    whether the upper bound is computed too, some ten seconds for three joints
    executor   works on the starts and the bound's searches elsewhere (any like `concurrent.futures.Executor`, see
               `optimise`); the result is the same

    Raises InputError for a rig without arm or limits, too few samples, a model with parameters that no motion of
    this arm shows, and limits that no motion keeps.
    """
    arm, limits = place_of(rig)
    designable = (model or (planar if arm.space is Space.PLANE else spatial)(rig)).designable
    known = None if values is None else {p.name: values[p.name] for p in designable.parameters if p.name in values}
    experiment = Experiment.of(designable, arm, known, noise=noise)
    _require_seen(experiment, limits)
    own = series or FreeSeries(joints=arm.joints, harmonics=HARMONICS, period=PERIOD)
    require_samples(own, samples)
    asked, score = experiment, criterion or DOptimal()
    if prior is not None:
        asked, score = Experiment.prior(designable, arm, prior.sets, noise=noise), Averaged(score, prior.weights)
    task = Task(
        objective=Objective(experiment=asked, criterion=score, series=own, samples=samples),
        limits=limits,
        arm=arm,
        workspace=rig.workspace,
        tip_length=rig.tip_length,
    )
    found, others = _search(task, starts, seed, executor, progress)
    bound, reason = _bound(designable, arm, limits, samples, known, seed, executor, progress) if bounded else NOT_ASKED
    return Plan(
        task=task,
        experiment=experiment,
        attempts=found,
        evaluations=sum(attempt.evaluations for attempt in (*found, *others)),
        bound=bound,
        unbounded=reason,
    )


def _search(
    task: Task, starts: int | None, seed: int, executor: Executor | None, progress: Progress | None
) -> tuple[tuple[Attempt, ...], tuple[Attempt, ...]]:
    """Local optima of the task's series, best first, and what else was tried."""
    quick = task.direct and task.objective.series.size <= LARGE
    count = starts or (STARTS if quick else FEWER)

    def run(stage: str, of: Task, begin: Sequence[Motion], work: Work) -> tuple[Attempt, ...]:
        watch = None if progress is None else _watch(stage, len(begin), progress, kept=work is not screen)
        return optimise(of, begin, work=work, executor=executor, progress=watch)

    slow = slower(task.objective.series)
    first = None if slow is None else replace(task, objective=replace(task.objective, series=slow))
    if not task.direct:
        return _exchanged(task, first, [(seed, number) for number in range(count)], run)
    if first is None:
        screened = run("starts", task, [_start(task, seed, number) for number in range(count)], screen)
        return run("best starts to the end", task, _best(screened, REFINED), polish), screened
    coarse = run("few harmonics", first, [_start(first, seed, number) for number in range(-(-count // SLOWER))], screen)
    bases = [motion.projected(task.objective.series) for motion in _best(coarse, BASES)]
    mixtures = [
        _mixed(bases[number % len(bases)], task.random((seed, count + number))) for number in range(-(-count // MIXED))
    ]
    others = [_start(task, seed, number) for number in range(count - count // 2, count)]
    screened = run("all harmonics", task, [*mixtures, *others], screen)
    return run("best starts to the end", task, _best(screened, REFINED), polish), (*coarse, *screened)


Run = Callable[[str, Task, Sequence[Motion], Work], tuple[Attempt, ...]]


def _exchanged(
    task: Task, first: Task | None, seeds: Sequence[tuple[int, int]], run: Run
) -> tuple[tuple[Attempt, ...], tuple[Attempt, ...]]:
    """Every start to the end, with few harmonics where that is something else; then the best two with all."""
    randoms = [task.random(seed) for seed in seeds]
    if first is None:
        return run("starts", task, randoms, improve), ()
    coarse = run("few harmonics", first, [r.projected(first.objective.series) for r in randoms], improve)
    nearest = [attempt.motion.projected(task.objective.series) for attempt in coarse[:BASES]]
    return run("all harmonics", task, nearest, improve), coarse


def _start(task: Task, seed: int, number: int) -> Motion:
    return task.varied((seed, number), odd=number % ODD[1] < ODD[0])


def _mixed(base: Motion, other: Motion) -> Motion:
    """Between two motions: the limits of the joints that both keep are kept by it."""
    return replace(base, coefficients=(1 - SHARE) * base.coefficients + SHARE * other.coefficients)


def _best(attempts: Sequence[Attempt], count: int) -> list[Motion]:
    """The motions of the best attempts that differ in value, best first."""
    chosen = list[Attempt]()
    for attempt in attempts:
        if not chosen or chosen[-1].value - attempt.value > DIFFERENT:
            chosen.append(attempt)
    return [attempt.motion for attempt in chosen[:count]]


def slower(series: Series) -> Series | None:
    """The series with the few harmonics of the random starts in its place; None when it has few itself."""
    if isinstance(series, RestToRest):
        inner = slower(series.inner)
        return None if inner is None else replace(series, inner=inner)
    if isinstance(series, PaperSeries) or (isinstance(series, FourierSeries) and max(series.waves) <= max(SLOW)):
        return None
    return FreeSeries(joints=series.joints, harmonics=SLOW, period=series.duration)


def _watch(stage: str, total: int, progress: Progress, *, kept: bool) -> Callable[[Attempt], None]:
    """Tells what is done, and how long the rest may take at the rate so far; `kept` are the limits at every instant."""
    begun, attempts = perf_counter(), list[Attempt]()
    progress(Step(stage, total=total))

    def watch(attempt: Attempt) -> None:
        attempts.append(attempt)
        best, done = max(attempts, key=lambda a: a.value), len(attempts)
        left = (perf_counter() - begun) * (total - done) / done
        progress(Step(stage, best.value, best if kept else None, done, total, left))

    return watch


def _bound(
    model: WrenchModel,
    arm: Arm,
    limits: Limits,
    samples: int,
    values: Values | None,
    seed: int,
    executor: Executor | None,
    progress: Progress | None,
) -> tuple[Bound | None, str]:
    """The bound, or why there is none."""

    def watch(step: Round) -> None:
        if progress is not None:
            progress(Step(f"bound, round {step.number}: within {step.best - step.lower:.2f} of what it can reach"))

    try:
        found = upper_bound(
            model, arm, limits, samples=samples, values=values, seed=seed, executor=executor, progress=watch
        )
        return found, ""
    except InputError as error:
        return None, error.what


def _require_seen(experiment: Experiment, limits: Limits) -> None:
    combinations = unseen(experiment, limits)
    if combinations:
        remedy = "leave one of them out of the model (`fit --drop`)"
        raise InputError(what=str(combinations[0]), where="model", remedy=remedy)
