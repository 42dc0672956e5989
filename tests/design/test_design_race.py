"""The rivals of the design are given the true problem: objective, penalty, and what their traces say they found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks import design_race, design_six_axes
from benchmarks.race_plot import race_figure
from benchmarks.rivals import evolution, finite_differences, nelder_mead, unoptimised
from benchmarks.rivals.objective import Objective
from benchmarks.rivals.reference import ARM, CHAPTER, FREE, LARGEST, LIMITS, PERIOD, SAMPLES
from benchmarks.rivals.trace import TOLERANCE, OutOfTimeError, Recorder, Trace
from design.criteria import DOptimal
from design.information import Experiment
from design.limits import LimitUse
from design.optimiser.design_task import DesignTask
from design.optimiser.objective import Objective as DesignObjective
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.chain.model import planar, spatial
from modeling.chain.prediction import compiled_prediction
from modeling.rig import STANDARD_GRAVITY, Limits, Workspace
from tests.shared.rigs import spatial_arm

SHORT: dict[str, Callable[[int], Trace]] = {
    "simplex": lambda seed: nelder_mead.penalised(seed, 600),
    "as the chapter": nelder_mead.as_the_chapter,
    "differences": lambda seed: finite_differences.penalised(seed, 4000),
    "evolution": lambda seed: evolution.penalised(seed, 600),
    "x_opt": lambda seed: unoptimised.scaled_optimum(),
    "random": lambda seed: unoptimised.random_motions(seed, 20),
}


def logdet(motion: Trajectory) -> float:
    """ln det(Phi'Phi) by another route: pose signals of the arm, then the compiled derivative of the prediction."""
    model = planar()
    signals = ARM.pose(*motion.evaluate(np.arange(SAMPLES) * PERIOD / SAMPLES))
    prediction = compiled_prediction(model)
    phi = sum(part.tangent(signals, np.zeros(6), SAMPLES)[1] for part in (prediction.load, prediction.bias))
    rows = np.asarray(phi).reshape(-1, 6)
    return 2 * float(np.log(np.abs(np.diag(np.linalg.qr(rows)[1]))).sum())


def random_candidates(objective: Objective, count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Scaled coefficients (count, k) of motions that use between a tenth and three times their limits."""
    starts = np.array([objective.start([number, 9]) for number in range(count)])
    return np.asarray(starts / 0.8 * np.geomspace(0.1, 3.0, count)[:, None])


@pytest.mark.parametrize("series", [CHAPTER, FREE], ids=["chapter", "free"])
def test_objective_is_that_of_the_derived_regressor(series: TrajectorySeries) -> None:
    objective = Objective(series)
    x = random_candidates(objective, 8)
    expected = [logdet(Trajectory(series, each * objective.unit)) for each in x]
    # rounding of M, times its condition number of up to 1e6 at a tenth of the limits
    np.testing.assert_allclose(objective.score(x).logdet, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("series", [CHAPTER, FREE], ids=["chapter", "free"])
def test_candidates_do_not_know_of_one_another(series: TrajectorySeries) -> None:
    objective = Objective(series)
    x = random_candidates(objective, 5)
    together, alone = objective.score(x), [objective.score(each[None]) for each in x]
    for name in ("logdet", "use", "penalty"):
        # rounding, of sums in another order
        np.testing.assert_allclose(getattr(together, name), [getattr(s, name)[0] for s in alone], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("series", [CHAPTER, FREE], ids=["chapter", "free"])
def test_penalty_is_zero_just_when_the_samples_keep_the_limits(series: TrajectorySeries) -> None:
    objective = Objective(series)
    x = random_candidates(objective, 40)
    score = objective.score(x)
    for each, use, penalty in zip(x, score.use, score.penalty, strict=True):
        states = Trajectory(series, each * objective.unit).evaluate(series.instants(SAMPLES))
        shares = np.abs(states) / LARGEST[:, None, :]
        assert use == pytest.approx(shares.max(), rel=1e-12)  # rounding
        assert (penalty == 0) == bool((shares <= 1).all())
        assert penalty == pytest.approx(1e3 * (np.maximum(shares - 1, 0) ** 2).sum(), rel=1e-9)
    assert 0 < (score.penalty == 0).sum() < len(x)


def test_each_scaled_coefficient_reaches_a_limit_by_itself() -> None:
    objective = Objective(FREE)
    np.testing.assert_allclose(objective.score(np.eye(FREE.size)).use, 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", SHORT)
def test_traces_rise_and_their_motion_is_what_they_say(name: str) -> None:
    trace = SHORT[name](1)
    assert len(trace.logdet) > 0
    for values in (trace.seconds, trace.evaluations, trace.logdet):
        assert (np.diff(values) >= 0).all()
    assert (np.diff(trace.logdet) > 0).all()
    assert trace.total_seconds >= trace.seconds[-1]
    assert trace.total_evaluations >= trace.evaluations[-1]
    assert trace.motion is not None
    assert logdet(trace.motion) == pytest.approx(trace.best, abs=1e-8)
    states = trace.motion.evaluate(np.arange(SAMPLES) * PERIOD / SAMPLES)
    assert (np.abs(states) / LARGEST[:, None, :]).max() <= 1 + TOLERANCE + 1e-12


def test_x_opt_scaled_is_the_figure_of_the_reference_problem() -> None:
    motion = unoptimised.chapter_optimum()
    assert LimitUse.of(motion, LIMITS).worst.use == pytest.approx(1, abs=1e-12)
    assert logdet(motion) == pytest.approx(45.66, abs=0.01)  # stated to two decimals, scaled on another grid


def test_searches_of_an_arm_get_the_problem_of_the_plain_script() -> None:
    """Whose columns come from the recursion of bodies along the chain, and ours from the derived regressor."""
    arm, count = spatial_arm("elbow"), SAMPLES
    pairs = np.multiply.outer(np.ones(arm.joints), [-1.0, 1.0])
    series = FreeSeries(joints=arm.joints, harmonics=(1, 2), period=PERIOD)
    experiment = Experiment.of(spatial(), arm)
    task = DesignTask(
        objective=DesignObjective(experiment=experiment, criterion=DOptimal(), series=series, samples=count),
        limits=Limits(position=pairs + 0.3, velocity=2 * pairs, acceleration=10 * pairs),
        arm=arm,
        workspace=Workspace(z=(-0.5, 1.0)),
        tip_length=0.2,
    )
    objective = design_six_axes.ArmObjective(series, task.limits, task=task)
    each, height = design_six_axes.sample(arm, STANDARD_GRAVITY, 0.2)
    x = np.array([objective.start([number, 9]) for number in range(3)])
    score = objective.score(x)
    for z, value, use in zip(x, score.logdet, score.use, strict=True):
        q, dq, ddq = objective.motion(z).evaluate(series.instants(count))
        phi = np.array(each.map(count)(np.hstack([q, dq, ddq]).T)).sum(axis=1).reshape(16, 16)
        tip = np.abs(np.array(height.map(count)(q.T)) - 0.25) / 0.75
        assert value == pytest.approx(np.linalg.slogdet(phi)[1], abs=1e-7)  # rounding, of another order of sums
        assert use == pytest.approx(max(np.abs(q - 0.3).max(), tip.max(), np.abs(dq).max() / 2, np.abs(ddq).max() / 10))


def test_a_search_ends_with_its_time() -> None:
    recorder = Recorder(Objective(FREE), "short", seconds=0.1)
    with pytest.raises(OutOfTimeError):
        nelder_mead.restarted(recorder, 0, 10**9)
    assert 0.1 <= recorder.trace().total_seconds < 5.0


def test_infeasible_motions_are_not_noted() -> None:
    recorder = Recorder(Objective(FREE), "none")
    recorder.costs(3 * recorder.objective.start(0)[None])
    trace = recorder.trace()
    assert trace.best == -np.inf
    assert trace.motion is None
    assert trace.total_evaluations == 1


def a_trace(seconds: list[float], values: list[float], total: float, evaluations: int) -> Trace:
    count = np.arange(1.0, len(values) + 1)
    return Trace(
        name="", seconds=np.array(seconds), evaluations=count, logdet=np.array(values), motion=None,
        total_seconds=total, total_evaluations=evaluations,
    )  # fmt: skip


def test_runs_one_after_the_other_keep_only_improvements() -> None:
    both = a_trace([1, 2], [5, 7], 4, 10).followed_by(a_trace([1, 2, 3], [6, 7.5, 8], 3, 20))
    assert both.seconds.tolist() == [1, 2, 6, 7]
    assert both.evaluations.tolist() == [1, 2, 12, 13]
    assert both.logdet.tolist() == [5, 7, 7.5, 8]
    assert (both.total_seconds, both.total_evaluations) == (7, 30)


def test_rows_hold_our_first_better_motion_against_the_rivals_whole_run() -> None:
    ours, rival = a_trace([1, 3], [6, 12], 5, 9), a_trace([1, 4], [5, 9], 30, 90)
    rows = {row.quantity: row.ratios[0] for row in design_race.rows([{design_race.OURS: ours, "rival": rival}])}
    assert list(rows) == ["repeats needed", "time, whole run", "time to its best"]
    assert list(rows.values()) == pytest.approx([np.exp(3 / 6), 30 / 3, 4 / 3], rel=1e-12)
    never = design_race.rows([{design_race.OURS: rival, "rival": ours}])
    assert {row.quantity: row.ratios for row in never}["time, whole run"] == (0.0,)


def test_picture_names_every_entrant() -> None:
    race = {design_race.OURS: a_trace([1, 3], [48, 51], 5, 9), "low": a_trace([1], [40], 30, 90)}
    axes = race_figure([race, race]).axes[0]
    words = [text.get_text() for text in axes.texts] + axes.get_legend_handles_labels()[1]
    assert words == ["below: low 40.00", design_race.OURS]
