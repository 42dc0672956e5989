"""Planning: what it tells on its way, and that neither workers nor the order of their work decide."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from design.exciting_trajectory import DesignInterrupted
from design.limits import require_motion_within_period
from design.optimiser.interior_point import TerminationStatus
from design.trajectories.fourier import FreeSeries, PaperSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import TrajectorySeries
from design.trajectory_design import DesignStage, design
from modeling.errors import InputError
from modeling.rig import Rig
from tests.shared.design_cases import LIMITS
from tests.shared.rigs import ARM
from truewrench.reports.reported import report

RIG = Rig(name="reference", link_lengths=ARM.link_lengths, tip_length=0.2, limits=LIMITS)
FEW = FreeSeries(joints=3, harmonics=(1, 2), period=5.0)


def test_a_step_says_how_much_is_done_and_how_long_it_may_take() -> None:
    said = str(DesignStage("few harmonics", 51.256, None, 7, 32, 3.2))
    assert said == "few harmonics: 7 of 32 starts, 51.26 reached, about 3 s left"
    assert str(DesignStage("bound, round 3")) == "bound, round 3"


@pytest.mark.parametrize(
    "series",
    [PaperSeries(period=5.0), FreeSeries(joints=3, harmonics=(1, 2, 3, 4, 5, 6), period=5.0)],
    ids=["few harmonics only", "all after few"],
)
def test_every_start_is_told_of_and_the_best_motion_is_within_its_limits(series: TrajectorySeries) -> None:
    told: list[DesignStage] = []
    plan = design(RIG, series=series, starts=4, samples=60, bounded=False, progress=told.append)
    frame = plan.to_frame()
    assert list(frame.columns) == ["time", *(f"{p}{j}" for p in ("q", "dq", "ddq") for j in (1, 2, 3))]
    np.testing.assert_array_equal(frame["q2"], plan.motion.evaluate(frame["time"])[0][:, 1])
    with pytest.raises(InputError, match="an ExcitingTrajectory has no report"):
        report(plan, "unwritten")  # type: ignore[arg-type]
    stages = {step.stage: [s for s in told if s.stage == step.stage] for step in told}
    for steps in stages.values():
        assert [step.done for step in steps] == list(range(steps[0].total + 1))
        assert steps[-1].seconds == 0
    kept = [step.best for step in told if step.best is not None]
    assert kept
    assert all(plan.task.use(attempt.motion).worst.use <= 1 for attempt in kept)
    assert plan.local_optima[0].value == max(attempt.value for attempt in kept)
    assert plan.limit_use.worst.use <= 1
    values = [attempt.value for attempt in plan.local_optima]
    assert values == sorted(values, reverse=True)


@pytest.mark.parametrize(
    ("stage", "done", "reaches"),
    [
        ("few harmonics", 0, False),
        ("few harmonics", 1, True),
        ("all harmonics", 2, True),
        pytest.param("refinement", 1, True, marks=pytest.mark.long(5)),
        pytest.param("bound", 0, True, marks=pytest.mark.long(12)),
    ],
)
def test_an_interrupted_design_has_the_best_so_far(stage: str, done: int, reaches: bool) -> None:
    """In the series asked for, and within its limits at 20000 instants; of the trajectories that screening left outside
    a little, too. Twelve digits of the limits: rounding of the contraction."""
    series = FreeSeries(joints=3, harmonics=(1, 2, 3, 4, 5, 6), period=5.0)

    def interrupt(step: DesignStage) -> None:
        if step.stage.startswith(stage) and step.done == done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as raised:
        design(RIG, series=series, starts=4, samples=60, progress=interrupt)
    assert isinstance(raised.value, DesignInterrupted)
    plan = raised.value.best
    assert (plan is not None) is reaches
    if plan is None:
        return
    assert plan.motion.series == series
    assert plan.logdet > 30
    assert (plan.local_optima[0].outcome is TerminationStatus.INTERRUPTED) is (stage != "bound")  # whole but for it
    assert plan.to_data()["bound_logdet"] is None
    assert plan.to_data()["unbounded"] == "interrupted"
    for order, limit in enumerate((LIMITS.position, LIMITS.velocity, LIMITS.acceleration)):
        values = plan.motion.derivative(np.linspace(0, 5, 20_001), order)
        size = np.abs(limit).max() * 1e-12
        assert np.all(values >= limit[:, 0] - size)
        assert np.all(values <= limit[:, 1] + size)


@pytest.mark.parametrize(
    "series", [FEW, pytest.param(RestToRest(inner=FEW, ramp=0.5), marks=pytest.mark.long)], ids=["periodic", "rest"]
)
def test_the_number_of_workers_does_not_decide(series: TrajectorySeries) -> None:
    alone = design(RIG, series=series, starts=4, samples=60, bounded=False)
    with ThreadPoolExecutor(3) as pool:
        together = design(RIG, series=series, starts=4, samples=60, bounded=False, executor=pool)
    assert together.logdet == alone.logdet
    assert together.evaluations == alone.evaluations
    np.testing.assert_array_equal(together.motion.coefficients, alone.motion.coefficients)


@pytest.mark.parametrize(("period", "refused"), [(1e-9, True), (1e-3, True), (0.1, False)])
def test_period_too_short_for_any_motion_is_refused(period: float, refused: bool) -> None:
    """At 15 rad/s², the largest limit, a joint travels 0.9 urad in 1 ms and 9 mrad in 0.1 s, of a range of 1.8 rad."""
    series = FreeSeries(joints=3, harmonics=(1, 2), period=period)
    if not refused:
        require_motion_within_period(series, LIMITS)
        return
    with pytest.raises(InputError, match=r"no joint can move by a millionth of its range.*longer period"):
        design(RIG, series=series, starts=1, samples=60, bounded=False)


@pytest.mark.long(6)
def test_a_spline_of_many_knots_ends_above_its_search_with_few() -> None:
    """Refined from splines of half of the knots and from one of few harmonics continued with all: it can only gain."""
    told: dict[str, float] = {}

    def progress(step: DesignStage) -> None:
        if step.value is not None:
            told[step.stage] = max(step.value, told.get(step.stage, step.value))

    series = SplineSeries(joints=3, knots=48, degree=2, period=5.0)
    plan = design(RIG, series=series, starts=4, bounded=False, progress=progress)
    assert list(told) == ["few harmonics", "all knots", "few knots", "half the knots", "refinement of the best"]
    assert told["half the knots"] > told["few knots"] - 0.05  # ranked before all limits are kept
    assert told["all knots"] > told["few harmonics"]
    assert plan.logdet > max(told["half the knots"], told["all knots"])
    assert plan.limit_use.worst.use <= 1
