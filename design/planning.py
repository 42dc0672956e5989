"""Planning: from a rig and a model to the motion that tells most of the model's parameters."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from design.bound import Bound, Round, upper_bound
from design.criterion import Averaged, Criterion, DOptimal
from design.information import Experiment, Prior, SensorNoise, unseen
from design.information.values import Values
from design.motion.fourier import FourierSeries, FreeSeries, PaperSeries
from design.motion.rest_to_rest import RestToRest
from design.motion.series import Series
from design.optimiser.objective import Objective
from design.optimiser.optimiser import SLOW, Attempt, Task, optimise
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
STARTS, REFINED = 6, 2
"""Random starts with few harmonics, and how many of their optima go on to the whole series."""


NOT_ASKED = (None, "not asked for")


@dataclass(frozen=True, eq=False)
class Step:
    """How far the planning is: what it does, and the best motion that keeps the limits so far."""

    stage: str
    best: Attempt | None = None

    def __str__(self) -> str:
        return self.stage if self.best is None else f"{self.stage}, {self.best.value:.2f} reached"


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
    starts: int = STARTS,
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
    starts     random starts, from `seed`; their best optima with few harmonics are refined with all
    bounded    whether the upper bound is computed too, a minute or so
    executor   works on the starts elsewhere (processes; see `optimise`)

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
    found, coarse = _search(task, starts, seed, executor, progress)
    bound, reason = _bound(designable, arm, limits, samples, known, seed, executor, progress) if bounded else NOT_ASKED
    return Plan(
        task=task,
        experiment=experiment,
        attempts=found,
        evaluations=sum(attempt.evaluations for attempt in (*found, *coarse)),
        bound=bound,
        unbounded=reason,
    )


def _search(
    task: Task, starts: int, seed: int, executor: Executor | None, progress: Progress | None
) -> tuple[tuple[Attempt, ...], tuple[Attempt, ...]]:
    """Local optima of the task's series, best first, and those of the slow one that it started from."""
    randoms = [task.random((seed, number)) for number in range(starts)]
    slow = slower(task.objective.series)
    if slow is None:
        return optimise(task, randoms, executor=executor, progress=_watch("starts", progress)), ()
    first = replace(task, objective=replace(task.objective, series=slow))
    coarse = optimise(
        first, [r.projected(slow) for r in randoms], executor=executor, progress=_watch("few harmonics", progress)
    )
    nearest = [attempt.motion.projected(task.objective.series) for attempt in coarse[:REFINED]]
    return optimise(task, nearest, executor=executor, progress=_watch("all harmonics", progress)), coarse


def slower(series: Series) -> Series | None:
    """The series with the few harmonics of the random starts in its place; None when it has few itself."""
    if isinstance(series, RestToRest):
        inner = slower(series.inner)
        return None if inner is None else replace(series, inner=inner)
    if isinstance(series, PaperSeries) or (isinstance(series, FourierSeries) and max(series.waves) <= max(SLOW)):
        return None
    return FreeSeries(joints=series.joints, harmonics=SLOW, period=series.duration)


def _watch(stage: str, progress: Progress | None) -> Callable[[Attempt], None]:
    best: list[Attempt] = []

    def watch(attempt: Attempt) -> None:
        best[:] = sorted([*best, attempt], key=lambda a: -a.value)[:1]
        if progress is not None:
            progress(Step(stage, best[0]))

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
            progress(Step(f"bound, round {step.number}"))

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
