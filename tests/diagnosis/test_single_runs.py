"""A small effect is found in a single run, where the noise has to come from the residual, and nothing in noise alone.

Each recording has a seed of its own, so that a test fails always or never.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from benchmarks.single_run import SingleRun
from diagnosis import subset_search
from diagnosis.acceptance import AcceptanceEvidence
from diagnosis.comparison import comparison
from diagnosis.comparison.comparison import CrossValidatedGain, cross_validated_gain
from diagnosis.comparison.model_comparison import compare
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.screening.score_test import ScoreTest, screen
from diagnosis.subset_search import CandidateModel, SubsetSearch, refit_effects, refit_with_effect, search_subsets
from diagnosis.verdict.selection_step import SelectionStep, explainable_power_by_step, selection_steps
from diagnosis.verdict_rule import RecordVerdict
from estimation.fit import Fit, fit
from estimation.model_response import predicted_readings
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import planar, spatial
from modeling.effects import named, viscous_drag
from modeling.rig import Convention, Rig
from modeling.significance import LEVELS
from tests.shared.recordings import FEW, recording_of, single_run
from tests.shared.rigs import RIG
from truewrench.simulated_rig import (
    AutoregressiveNoise,
    BiasDrift,
    GravityTilt,
    NoiseModel,
    PinkNoise,
    PlanarRig,
    SensorHysteresis,
    SensorLag,
    SpatialRig,
    ViscousDrag,
    simulate,
)

pytest.importorskip("mujoco")

NOISE = dict(zip(("fx", "fy", "tau"), PlanarRig().noise, strict=True))
ROBOT = {"link_lengths": list(PlanarRig().link_lengths), "tip_length": 0.2}
STATED = Rig.from_data({"robot": ROBOT, "sensor": {"noise": NOISE}})
SMALL = ViscousDrag(c=0.02, d=0.12)
TINY = ViscousDrag(c=0.01, d=0.12)
"""Some per cent of the RMS, which noise makes up; the strength is about 180 in whitened terms."""


@cache
def diagnosed(seed: int) -> Diagnosis:
    return diagnose(planar(RIG), single_run(seed, SMALL), effects=FEW)


def with_drag(recording: Recording) -> tuple[CandidateModel, CandidateModel]:
    """The rigid tip, and the same with the drag that was hidden."""
    base = CandidateModel(fit(planar(recording.rig), recording), candidates=len(FEW))
    return base, refit_with_effect(base, screen(base.fit, [viscous_drag()])[0])


def test_the_smallest_p_value_of_sign_flips_is_said_to_be_a_bound() -> None:
    """13 blocks have 4096 patterns of signs; the p-value of one of them is doubled for the two tests made.

    With fewer than 12 blocks the test could not reject at the level of held-out recordings.
    """
    recording = single_run(3009, ViscousDrag(c=0.6, d=0.12))
    found = compare(fit(planar(recording.rig), recording))
    assert 2 / 4096 == found.smallest_lack_of_fit <= found.lack_of_fit < 0.01
    assert found.smallest_lack_of_fit < LEVELS.held_out
    limit, rigid = replace(found, lack_of_fit=2 / 4096), with_drag(recording)[0].fit
    assert "lack of fit p ≤ 0.00049, the smallest that this test can give" in str(limit)
    assert "≤ 0.00049" in str(SelectionStep(None, rigid, rigid, (limit,), ()))
    right = compare(with_drag(recording)[1].fit)
    assert right.lack_of_fit > right.smallest_lack_of_fit
    assert "≤" not in str(right)


@pytest.mark.parametrize("seed", [3000, 3001, 3002])
def test_small_effect_is_named(seed: int) -> None:
    result = diagnosed(seed)
    assert result.added == ("viscous_drag",), str(result)
    assert result.verdict is RecordVerdict.EXPLAINED
    drag = result.fit.parameters["viscous_drag.c"]
    # 4 standard deviations, and half again for a noise that the residual itself had to give.
    assert abs(drag.value - SMALL.c) < 6 * drag.std


@pytest.mark.long(seconds=8)
@pytest.mark.parametrize("seed", [3200, 3201])
def test_a_large_play_begins_anywhere(seed: int) -> None:
    """Most of it would be taken for noise, in which other widths fit as well; the noise floor is then the sensor's."""
    play = SensorHysteresis(force=1.5, torque=0.06, start=(-0.8, 0.6)[seed - 3200])
    result = diagnose(planar(RIG), single_run(seed, play))
    assert result.added == ("sensor_hysteresis",), str(result)
    assert result.verdict is RecordVerdict.EXPLAINED
    for channel, width in {"fx": 1.5, "fy": 1.5, "tau": 0.06}.items():
        estimate = result.fit.parameters[f"sensor_hysteresis.{channel}"]
        assert abs(estimate.value - width) < 6 * estimate.std, channel
    np.testing.assert_allclose(result.fit.noise[0].floor, list(NOISE.values()), rtol=0.2)


def slow_run(seed: int) -> Recording:
    """Six axes, half as fast as the other tests, a drag and a tilted base: each hides in the noise beside the other."""
    tool, hidden = SpatialRig(), (ViscousDrag(c=0.8), GravityTilt(tilt_x=0.02, tilt_y=-0.03))
    motion = tool.random_motion(seed=seed, period=20.0)
    frame = simulate(tool, motion, hidden=hidden, repeats=1, samples_per_period=2500, seed=seed)
    return recording_of(frame, without=("repeat",), name="run.csv", rig=Rig())


@pytest.mark.parametrize("seed", [pytest.param(3100, marks=pytest.mark.long), 3101])
def test_of_two_effects_that_hide_each_other_both_are_named(seed: int) -> None:
    """Each alone leaves a residual that the noise model takes in; then the other is significant in it."""
    result = diagnose(replace(spatial(), convention=Convention.ON_TOOL), slow_run(seed), effects=FEW)
    assert set(result.added) == {"gravity_tilt", "viscous_drag"}, str(result)
    assert result.verdict is RecordVerdict.EXPLAINED
    assert result.to_data()["noise_floor"]["fx"] < 1.1 * SpatialRig().noise[0]


def test_one_of_two_effects_explains_a_part() -> None:
    """The drag that remains is steeper in frequency than noise, and above the noise in the band of the motion."""
    model = replace(spatial(), convention=Convention.ON_TOOL)
    result = diagnose(model, slow_run(3100), effects=[named("gravity_tilt")])
    assert result.added == ("gravity_tilt",)
    assert result.verdict is RecordVerdict.PARTLY_EXPLAINED


@pytest.mark.parametrize("noise", ["white", AutoregressiveNoise(rho=0.95)], ids=["white", "ar95"])
def test_noise_alone_lacks_nothing(noise: NoiseModel | str) -> None:
    """At 1 % for an effect and 1 % for lack of fit, one of the two tests fails for 1 choice of seeds in 25."""
    result = diagnose(planar(RIG), single_run(3000, noise=noise), effects=FEW)
    assert result.added == ()
    assert result.verdict is RecordVerdict.NOTHING_MISSING


@pytest.mark.long(seconds=40)
def test_slow_noise_is_no_lack_of_fit() -> None:
    """1/f noise goes on from block to block; six axes. Before rows were flattened, 40 % were alarms at 5 %.

    This fails for one choice of seeds in 1000.
    """
    tool, seeds, alarms = SpatialRig(), range(4000, 4040), 0
    model = replace(spatial(), convention=Convention.ON_TOOL)
    for seed in seeds:
        motion = tool.random_motion(seed=seed, period=15.0)
        frame = simulate(tool, motion, repeats=1, samples_per_period=1500, noise=PinkNoise(tones=()), seed=seed)
        fitted = fit(model, recording_of(frame, without=("repeat",), name="run", rig=Rig.from_data({})))
        alarms += compare(fitted).lack_of_fit < 0.05
    assert alarms <= binom.isf(1e-3, len(seeds), 0.05)


def test_what_has_not_converged_is_not_extended(monkeypatch: pytest.MonkeyPatch) -> None:
    """A score test needs a minimum. All that is significant in round one is tried, and none of it in round two."""
    recording = single_run(3000, ViscousDrag(c=0.3, d=0.12), SensorLag(time_constant=0.02))
    base = fit(planar(RIG), recording)
    pairs = [len(ids) for ids in search_subsets(base, FEW).tried]
    exact = subset_search.refit_with_effect

    def without_convergence(candidate: CandidateModel, screening: ScoreTest) -> CandidateModel:
        found = exact(candidate, screening)
        return replace(found, fit=replace(found.fit, converged=False))

    monkeypatch.setattr(subset_search, "refit_with_effect", without_convergence)
    alone = [len(ids) for ids in search_subsets(base, FEW).tried]
    assert alone == [size for size in pairs if size < 2]
    assert 1 in alone
    assert 2 in pairs


@pytest.mark.long
def test_second_effect_is_found_where_the_rigid_tool_passes_the_test_of_fit() -> None:
    """Lag and drag: chi-squares of sets in their own noises, all near the number of rows, may not end the search.

    The rigid tool's lack of fit is 0.0117, which a noise that holds both effects hides; a delay, in its own noise, has
    the smaller chi-square, though in a common one the lag is better by 11.
    """
    recording = SingleRun(noise="white", motion="sines", seed=7001, hidden=(ViscousDrag(), SensorLag())).recording()
    base = fit(spatial(), recording)
    assert base.converged
    found = search_subsets(base, FEW)
    assert found.chosen.ids == {"viscous_drag", "sensor_lag"}
    lag = found.chosen.fit.parameters["sensor_lag.time_constant"]
    assert abs(lag.value - 0.02) < 4 * lag.std


@pytest.mark.parametrize("seed", [7101, pytest.param(7102, marks=pytest.mark.long)])
def test_a_drag_beside_a_drift_explains_a_part(seed: int) -> None:
    """A change slower than the motion speaks neither for nor against the drag, and is said to remain."""
    recording = SingleRun(noise="white", motion="sines", seed=seed, hidden=(ViscousDrag(), BiasDrift())).recording()
    found = diagnose(spatial(), recording, effects=FEW)
    assert found.added == ("viscous_drag",)
    assert found.verdict is RecordVerdict.PARTLY_EXPLAINED
    assert any(slow.above_noise for slow in found.slow_residuals)
    (drag,) = (f for f in found.findings if f.effect.id in found.added)
    within = drag.parameters["c"].value < 2 * drag.parameters["c"].std  # by what the drift adds to it
    assert drag.reason.startswith("kept though its amount is within 2") == within


def test_noise_is_no_part_of_what_can_be_explained() -> None:
    """A right effect takes most of what can be explained, though hardly any of the raw RMS."""
    base, best = with_drag(single_run(3000, TINY))
    steps = selection_steps(SubsetSearch(base, best), best, ())
    before, after = (s.training[0].rms for s in (steps[0], steps[-1]))
    assert all(after[c] > 0.9 * before[c] for c in before)
    left = explainable_power_by_step(steps, best)
    assert left[-1] < left[0] / 2


def test_the_gain_of_each_fit_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a whole diagnosis: the test of fit and the power left are of the same one."""
    asked: list[Fit] = []

    def counted(whole: Fit, number: int, residual: NDArray[np.float64]) -> CrossValidatedGain:
        asked.append(whole)
        return cross_validated_gain(whole, number, residual)

    monkeypatch.setattr(comparison, "cross_validated_gain", counted)
    recording = single_run(3000, ViscousDrag(c=0.6, d=0.12), noise=PinkNoise(tones=()))
    found = diagnose(planar(RIG), recording, effects=FEW)
    assert found.added == ("viscous_drag",)
    assert len({id(whole) for whole in asked}) == len(asked) > 1


def test_explainable_power_is_that_of_the_effect() -> None:
    """By the other route: the drag's prediction at its true size, less what the rigid tip soaks up of it.

    The chi-square has the standard deviation sqrt(2 rows + 4 lambda); 4 of them.
    """
    hidden = ViscousDrag(c=0.3, d=0.12)
    recording = single_run(3000, hidden, rig=STATED)
    base, best = with_drag(recording)
    fitted = best.fit
    truth = fitted.theta.copy()
    names = [p.name for p in fitted.layout.parameters]
    truth[[names.index("viscous_drag.c"), names.index("viscous_drag.d")]] = hidden.c, hidden.d
    absent = truth.copy()
    absent[names.index("viscous_drag.c")] = 0.0
    prediction = predicted_readings(fitted.model, recording, truth) - predicted_readings(
        fitted.model, recording, absent
    )
    column = fitted.noise[0].whitener.series(prediction)
    _, taken = base.fit.problem.evaluate(base.fit.theta)
    basis = np.linalg.qr(taken / np.linalg.norm(taken, axis=0))[0]
    strength = float(np.sum((column - basis @ (basis.T @ column)) ** 2))
    rows = len(column)
    steps = selection_steps(SubsetSearch(base, best), best, ())
    measured = explainable_power_by_step(steps, best)[0] * rows / 3
    assert abs(measured - strength) < 4 * np.sqrt(2 * rows + 4 * strength)


def test_sets_are_compared_in_one_noise() -> None:
    """Each in its own, the rigid tip would look as good as the right set: a residual is of size one in its own unit."""
    base, best = with_drag(single_run(3000, TINY))
    rows = len(best.null_model.residual)
    alike = refit_effects(best, ())
    assert abs(base.null_model.cost - best.null_model.cost) < 4 * np.sqrt(2 * rows)  # the spread of a chi-square
    # The base's residual under the right set's noise holds the whole strength, known here to its square root.
    assert alike.null_model.cost - best.null_model.cost == pytest.approx(180, abs=4 * 2 * np.sqrt(180))


@pytest.mark.parametrize("seed", [3000, 3002, 3004])
def test_a_refit_that_stops_early_would_have_been_worse_at_its_minimum(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one noise a set is refitted only as far as it may be better than another: so it is, or is not, in the end."""
    exact, pairs = subset_search.refit_effects, []

    def both(
        candidate: CandidateModel, effects: Sequence[Effect], start: Mapping[str, float] | None = None, far: float = inf
    ) -> CandidateModel:
        found = exact(candidate, effects, start, far)
        if far < inf:
            pairs.append((found, exact(candidate, effects, start), far))
        return found

    monkeypatch.setattr(subset_search, "refit_effects", both)
    recording = single_run(seed, ViscousDrag(c=0.3, d=0.12), SensorLag(time_constant=0.02))
    search_subsets(fit(planar(RIG), recording), FEW)
    assert any(found.cost > whole.cost + 1 for found, whole, _ in pairs)
    for found, whole, far in pairs:
        assert (found.criterion < far) == (whole.criterion < far)


@pytest.mark.parametrize(("size", "rejected"), [(0.0, None), (2.0, "viscous_drag")])
def test_an_effect_that_hardly_removes_anything_is_no_finding_beside_other_physics(
    size: float, rejected: str | None
) -> None:
    """A drag of some per cent of the noise, alone and beside a slow force of another body."""
    recording = single_run(3000, TINY)
    push = size * np.sin(np.linspace(0.0, 6 * np.pi, recording.samples))
    pushed = replace(recording, wrench=recording.wrench + np.outer(push, [0.0, 1.0, 0.0]))
    base, best = with_drag(pushed)
    assert AcceptanceEvidence(best, base).hardly_removes == rejected


def test_share_removed_grows_with_the_effect() -> None:
    """In slow noise, which counts as what may be physics; in white noise all is removed."""
    noise = AutoregressiveNoise(rho=0.97)
    drags = [
        diagnose(planar(RIG), single_run(3000, ViscousDrag(c=c, d=0.12), noise=noise), effects=FEW) for c in (0.03, 0.1)
    ]
    small, large = (found.removed_share for found in drags)
    assert small < 0.7 < 0.9 < large
    assert diagnosed(3000).removed_share > 0.95
