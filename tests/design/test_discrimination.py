"""Telling effects apart: exact imitation, its linear stand-in, aliases, chances, and designed motions in the end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray
from scipy.stats import norm

from design.criteria import Subset
from design.discrimination import (
    DesignSetting,
    DirectedPair,
    DiscriminationDesign,
    Hypothesis,
    ModelPair,
    Separability,
    Separation,
    WhitenedPrediction,
    discriminate,
    rival_models,
    with_effect_replaced,
)
from design.discrimination.discriminating_trajectory import ExchangeRound
from design.discrimination.model_pair import (
    LinearisedRival,
    RivalAlongTrajectories,
    maximin_experiment,
    parameter_bounds,
    rival_starts,
    whitened_predictions,
)
from design.exciting_trajectory import DesignInterrupted
from design.information import Experiment, prediction_terms, sensitivity_terms
from design.trajectories.fourier import FreeSeries, random_periodic_trajectory
from design.trajectories.trajectory import Trajectory
from diagnosis.diagnosis import diagnose
from diagnosis.next_experiment import next_experiment, sensor_noise_of
from estimation.fit import fit
from estimation.model_response import predicted_readings
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.chain import Chain
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.effects.geometry import JointOffset
from modeling.errors import InputError
from modeling.noise import ColouredNoise, NoiseModel, StationaryNoise
from modeling.parameter import Parameter
from modeling.rig import Limits, Rig
from modeling.rival_fit import fit_rival
from modeling.space import Space
from tests.shared.recordings import recording_of
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

ROBOT = simulated.PlanarRig()
PAIRS = np.array([[-1.0, 1.0]])
RIG = Rig(
    link_lengths=ROBOT.link_lengths,
    tip_length=0.2,
    limits=Limits(
        position=np.array([[1.05], [1.22], [1.40]]) * PAIRS,
        velocity=np.array([[2.0], [2.2], [3.5]]) * PAIRS,
        acceleration=np.array([[10.0], [10.0], [15.0]]) * PAIRS,
    ),
)
NOISE = NoiseModel.white(ROBOT.noise)
PERIOD, SAMPLES = 5.0, 60
SERIES = FreeSeries(joints=3, harmonics=(1, 2, 3), period=PERIOD)
SETTING = DesignSetting.of(RIG, series=SERIES, samples=SAMPLES, noise=NOISE)
TOOL = {"bias_fx": 15.0, "bias_fy": 0.25, "bias_tau": -1.33, "m": 0.9, "mlg": 0.063, "I": 0.0129}
SIZES: dict[str, dict[str, float]] = {
    "com_offset": {"mlx": 0.004},
    "gravity_tilt": {"angle": 0.02},
    "sensor_rotation": {"angle": 0.02},
    "sensor_crosstalk": {"fy_fx": 0.02},
    "viscous_drag": {"c": 0.05, "d": 0.12},
    "quadratic_drag": {"c": 0.02, "d": 0.12},
    "cable_spring": {"k": 1.0, "anchor_x": 2.0, "anchor_y": 2.0, "length": 1.0, "d": 0.1},
    "sensor_lag": {"time_constant": 0.012},
    "time_delay": {"delay": 0.012},
    "first_joint_offset": {"offset": 0.02},
}
SPECTRUM = ColouredNoise.of_spectra(
    np.array([0.0, 1.0, 10.0]), np.array([[1.0, 2.0, 0.01], [0.1, 0.2, 0.001], [0.02, 0.06, 0.0002]])
)


@dataclass(frozen=True)
class FirstJointOffset(JointOffset):
    """The first joint stands `offset` (rad) clockwise of its angle: the whole motion is turned about the base."""

    id = "first_joint_offset"
    spaces = (Space.PLANE,)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return (Parameter(name="offset", unit="rad", bounds=(-pi / 4, pi / 4)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        return replace(chain, arm=replace(self.arm_of(chain), offsets=(p["offset"], sp.S.Zero, sp.S.Zero)))


def values(*ids: str) -> dict[str, float]:
    return TOOL | {f"{i}.{name}": value for i in ids for name, value in SIZES[i].items()}


def direction(true: Effect, rival: Effect) -> DirectedPair:
    truth = planar(RIG) + true
    return DirectedPair(Hypothesis.of(truth, values(true.id)), with_effect_replaced(truth, true.id, rival))


def view(seed: int, noise: StationaryNoise = NOISE) -> WhitenedPrediction:
    return replace(SETTING, noise=noise).view(SETTING.random((9, seed)))


@lru_cache(maxsize=1)
def probes() -> tuple[WhitenedPrediction, ...]:
    return tuple(view(seed) for seed in range(3))


LAG, DELAY = effects.sensor_lag(), effects.time_delay()
VISCOUS, QUADRATIC = effects.viscous_drag(), effects.quadratic_drag()
TILT, ROTATION, CROSSTALK = effects.gravity_tilt(), effects.sensor_rotation(), effects.sensor_crosstalk()
RIVALS = [(VISCOUS, QUADRATIC), (LAG, DELAY), (DELAY, VISCOUS), (TILT, ROTATION), (TILT, effects.cable_spring())]
EACH = pytest.mark.parametrize(("true", "rival"), RIVALS, ids=lambda effect: effect.id)


# --------------------------------------------------------------------------------------------- imitation


@pytest.mark.parametrize("noise", [NOISE, SPECTRUM], ids=["white", "coloured"])
@pytest.mark.parametrize("effect", [LAG, DELAY, VISCOUS], ids=lambda effect: effect.id)
def test_readings_are_the_columns_of_the_experiment(effect: Effect, noise: StationaryNoise) -> None:
    """Two routes: functions of theta that are compiled once, and terms with theta put in."""
    model, motion = planar() + effect, SETTING.random((9, 0))
    theta = Hypothesis.of(model, values(effect.id)).theta
    value, slopes = view(0, noise).tangent(model, theta)
    terms = (*sensitivity_terms(model, theta, 1), *prediction_terms(model, theta, 0))
    read = Parameter(name="reading", unit="1")
    experiment = Experiment(
        terms=terms, parameters=(read, *model.parameters), channels=model.channels, arm=RIG.arm, noise=noise
    )
    columns = experiment.columns(*motion.evaluate(SERIES.instants(SAMPLES)), PERIOD).reshape(len(value), -1)
    np.testing.assert_allclose(np.column_stack([value, slopes]), columns, rtol=0, atol=1e-10 * np.abs(columns).max())


@EACH
def test_imitation_is_a_minimum_within_the_bounds(true: Effect, rival: Effect) -> None:
    """Kuhn and Tucker: no free parameter has a slope, and one at its bound would only go beyond it."""
    d = direction(true, rival)
    found = d.rival_fit([view(0)], SETTING.reach)
    target, _ = whitened_predictions([view(0)], d.truth.model, d.truth.theta)
    value, slopes = whitened_predictions([view(0)], d.rival, found.theta)
    left = target - value
    assert float(left @ left) == pytest.approx(found.noncentrality, rel=1e-9, abs=1e-9)
    low, high = parameter_bounds(d.rival)
    length = np.linalg.norm(slopes, axis=0)
    pull = np.divide(slopes.T @ left, length, out=np.zeros_like(length), where=length > 0) / np.linalg.norm(left)
    room = np.minimum(found.theta - low, high - found.theta)
    outwards = np.where(found.theta - low < high - found.theta, -pull, pull)
    # Cosine of residual and column: a search that stops at 1e-12 of lambda leaves about the root of it; near a bound
    # it approaches from inside, where the slope times the room has to vanish.
    free = np.minimum(room, 1.0) > 1e-3
    assert np.abs(pull[free]).max() < 1e-4
    assert (outwards[~free] > -1e-4).all()


def test_model_imitates_itself_and_what_it_contains() -> None:
    d = direction(VISCOUS, QUADRATIC)
    own = DirectedPair(d.truth, d.truth.model)
    assert own.nested_in_rival
    assert own.rival_fit([view(0)], SETTING.reach).noncentrality < 1e-15 * d.power([view(0)])  # rounding, squared
    both = DirectedPair(d.truth, d.truth.model + LAG)
    assert both.rival_fit([view(0)], SETTING.reach).noncentrality < 1e-15 * d.power([view(0)])


def test_grid_finds_a_tether() -> None:
    """From the rigid tool alone: anchor, length and point of attack of a tether that is taut in part."""
    tether, seen = effects.cable_spring(), view(1)
    truth = Hypothesis.of(planar() + tether, values("cable_spring") | {"cable_spring.length": 1.6})
    target, _ = whitened_predictions([seen], truth.model, truth.theta)
    rigid = DirectedPair(truth, planar()).rival_fit([seen], SETTING.reach)
    assert rigid.noncentrality > 100
    blind = np.concatenate([rigid.theta, np.zeros(len(truth.theta) - len(rigid.theta))])
    begin = rival_starts(target, truth.model, ("cable_spring",), blind, seen, SETTING.reach)
    assert (
        fit_rival(RivalAlongTrajectories(target, truth.model, [seen]), begin).noncentrality < 1e-3 * rigid.noncentrality
    )


def test_distance_over_two_runs_is_twice_that_of_one() -> None:
    d = direction(LAG, DELAY)
    one = d.rival_fit([view(0)], SETTING.reach).noncentrality
    two = d.rival_fit([view(0), view(0)], SETTING.reach).noncentrality
    assert two == pytest.approx(2 * one, rel=1e-9)  # rounding of the search


def test_a_parameter_that_no_reading_shows_does_not_break_the_search() -> None:
    """A motion of the second joint alone shows neither inertia nor arm apart; the distance is still a least one."""
    still = Trajectory(SERIES, np.zeros(SERIES.size))
    poses = [SETTING.view(still)]
    d = direction(TILT, ROTATION)
    assert d.rival_fit(poses, SETTING.reach).noncentrality < 1e-18 * d.power(
        poses
    )  # three biases explain three numbers


# ------------------------------------------------------------------------------------ the linear stand-in


@EACH
@pytest.mark.parametrize("noise", [NOISE, SPECTRUM], ids=["white", "coloured"])
def test_block_is_the_exact_distance_at_the_best_imitation(true: Effect, rival: Effect, noise: StationaryNoise) -> None:
    """There the residual is orthogonal to the columns, so that linear least squares cannot take more from it."""
    d, seen = direction(true, rival), view(0, noise)
    found = d.rival_fit([seen], SETTING.reach)
    block = LinearisedRival.of(d, found.theta, probes())
    experiment, criterion = maximin_experiment([block, block], SETTING.arm, noise)
    information = experiment.information(SETTING.random((9, 0)), SAMPLES)
    single = Subset((block.size - 1,)).value(information[: block.size, : block.size])
    assert np.exp(single) == pytest.approx(
        found.noncentrality, rel=1e-5
    )  # columns are information, squared: 1e-16 / 1e-12
    assert criterion.value(information) == pytest.approx(single - np.log(2) / criterion.power, rel=1e-9)
    assert len(experiment.parameters) == experiment.size == 2 * block.size


def test_columns_that_are_combinations_of_others_are_left_out() -> None:
    """A drag of no strength has no point of attack; crosstalk and inertial parameters share directions."""
    d = direction(LAG, VISCOUS)
    theta = Hypothesis.of(d.rival, TOOL | {"viscous_drag.c": 0.01, "viscous_drag.d": 0.1}).theta
    names = [p.name for p in d.rival.parameters]
    assert len(LinearisedRival.of(d, theta, probes()).columns) == len(names)
    theta[names.index("viscous_drag.c")] = 0.0
    kept = {names[i] for i in LinearisedRival.of(d, theta, probes()).columns}
    assert kept == set(names) - {"viscous_drag.c", "viscous_drag.d"}  # c stands at its bound
    mixed = direction(LAG, CROSSTALK)
    theta = Hypothesis.of(mixed.rival, TOOL).theta
    _, slopes = whitened_predictions(probes(), mixed.rival, theta)
    scaled = slopes / np.linalg.norm(slopes, axis=0)
    assert len(LinearisedRival.of(mixed, theta, probes()).columns) == np.linalg.matrix_rank(scaled, tol=1e-6)


# -------------------------------------------------------------------------------------------- aliases


def told(true: Effect, rival: Effect, given: Mapping[str, float] | None = None, **options: int) -> DiscriminationDesign:
    truth, other = rival_models(planar() + true, true, rival)
    known = values(true.id) if given is None else given
    return discriminate(RIG, truth, known, [other], series=SERIES, samples=SAMPLES, noise=NOISE, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("true", "rival"), [(TILT, FirstJointOffset()), (ROTATION, CROSSTALK)], ids=["tilt", "turn"])
def test_what_no_motion_separates_is_said(true: Effect, rival: Effect) -> None:
    """Turning gravity and turning the motion are one; a rotation is a crosstalk with other masses."""
    found = told(true, rival)
    assert found.verdict is Separability.NEVER
    assert found.motion is None
    assert not found.rounds
    assert all(d.indistinguishable for d in found.pairs[0].directions)
    assert "no trajectory of this arm discriminates them" in str(found)
    data = json.loads(json.dumps(found.to_data(), allow_nan=False))
    assert data["pairs"][0]["runs_for_1_percent"] is None
    assert data["verdict"] == "never"


def test_the_larger_of_two_nested_models_has_to_show() -> None:
    found = told(CROSSTALK, ROTATION, starts=1)
    (pair,) = found.pairs
    assert [d.indistinguishable for d in pair.directions] == [False, True]
    assert pair.nested
    assert pair.error_probability(pair.after) is None
    assert pair.after == pair.directions[0].after > pair.before > 0


def test_a_model_against_one_effect_less_or_more() -> None:
    """Less: whether the effect shows, in one direction. More: nothing ever says that the further effect is absent."""
    tilted = planar() + TILT
    options = {"series": SERIES, "samples": SAMPLES, "noise": NOISE, "starts": 1}
    less = discriminate(RIG, tilted, values("gravity_tilt"), [planar()], **options)  # type: ignore[arg-type]
    assert [d.indistinguishable for d in less.pairs[0].directions] == [False, True]
    assert less.pairs[0].nested
    assert less.pairs[0].directions[0].detection == pytest.approx(less.pairs[0].after, rel=1e-6)  # two searches of one
    more = discriminate(RIG, tilted, values("gravity_tilt"), [tilted + LAG], **options)  # type: ignore[arg-type]
    assert more.verdict is Separability.NEVER


# ------------------------------------------------------------------------------------ chances and repeats


def pair(one: float, other: float, runs: int = 2) -> ModelPair:
    shared = {"before": 1.0, "detection": 40.0, "indistinguishable": False}
    directions = (
        Separation(truth="a", rival="b", after=one, **shared),  # type: ignore[arg-type]
        Separation(truth="b", rival="a", after=other, **shared),  # type: ignore[arg-type]
    )
    return ModelPair(directions=directions, runs=runs)


def test_pair_is_judged_by_its_smaller_distance() -> None:
    assert pair(30.0, 25.0).after == 25.0
    assert pair(30.0, 25.0).verdict is Separability.SEPARATED
    assert pair(30.0, 20.0).verdict is Separability.REPEATS
    unnoticed = replace(pair(30.0, 25.0).directions[1], after=1.0, detection=2.0)
    assert replace(pair(30.0, 25.0), directions=(pair(30.0, 25.0).directions[0], unnoticed)).after == 30.0
    assert pair(30.0, 5.4).runs_for(10.8) == 4  # lambda doubles with twice the runs
    assert pair(30.0, 5.4).runs_for(21.6) == 8
    assert pair(30.0, 0.0).runs_for(21.6) is None
    assert pair(30.0, 10.8).error_probability(10.8) == pytest.approx(0.05, abs=2e-4)  # DIAGNOSIS
    assert pair(30.0, 10.8).error_probability(21.6) == pytest.approx(0.01, abs=2e-4)


def test_chance_of_a_mistake_is_how_often_the_rival_fits_better() -> None:
    """Both models refitted exactly to 100 noisy readings of a lag."""
    d = direction(LAG, DELAY)
    seen = view(3)
    separation = d.rival_fit([seen], SETTING.reach).noncentrality
    scale = float(np.sqrt(4.0 / separation))  # noise at which lambda is 4
    louder = replace(seen, noise=NoiseModel(NOISE.covariance / scale**2))
    clean = louder.reading(d.truth.model, d.truth.theta)
    rng, mistakes, draws = np.random.default_rng(4), 0, 100
    near = d.rival_fit([louder], SETTING.reach).theta
    for _ in range(draws):
        noisy = clean + rng.standard_normal(len(clean))
        own = fit_rival(RivalAlongTrajectories(noisy, d.truth.model, [louder]), [d.truth.theta]).noncentrality
        mistakes += fit_rival(RivalAlongTrajectories(noisy, d.rival, [louder]), [near]).noncentrality < own
    expected = norm.cdf(-1.0)
    # Binomial, four standard deviations: fails once in 16 000 times.
    assert mistakes / draws == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / draws))


# ------------------------------------------------------------------------------------------ the design


@lru_cache(maxsize=1)
def designed() -> DiscriminationDesign:
    return told(TILT, ROTATION, starts=1)


@pytest.mark.long
def test_designed_motion_separates_more_than_random_ones_within_its_limits() -> None:
    found = designed()
    assert found.motion is not None
    assert found.limit_use is not None
    assert found.limit_use.worst.use <= 1
    (tilt,) = found.pairs
    assert tilt.after > 2 * tilt.before
    views = [SETTING.view(SETTING.random((8, seed))) for seed in range(5)]
    true = direction(TILT, ROTATION)
    assert tilt.after > max(true.rival_fit([v], SETTING.reach).noncentrality for v in views)
    exact = true.rival_fit([SETTING.view(found.motion)], SETTING.reach).noncentrality
    assert tilt.directions[0].after == pytest.approx(exact, rel=1e-6)  # another search, from other starts
    assert tilt.after == pytest.approx(max(r.smallest for r in found.rounds), rel=1e-6)  # of as many readings


def test_no_small_change_of_the_designed_motion_separates_more() -> None:
    """A local optimum but for the limits: random directions, both ways, contracted into the limits again."""
    found = designed()
    assert found.motion is not None
    directions = [direction(TILT, ROTATION)]
    rival = Hypothesis(directions[0].rival, directions[0].rival_fit(_typical(), SETTING.reach).theta)
    directions.append(DirectedPair(rival, directions[0].truth.model))
    best, rng = found.pairs[0].after, np.random.default_rng(5)
    scale = np.abs(found.motion.coefficients).max()
    for _ in range(10):
        step = 0.02 * scale * rng.standard_normal(SERIES.size)
        for sign in (1.0, -1.0):
            moved = Trajectory(SERIES, found.motion.coefficients + sign * step)
            inside = moved.scaled(min(1.0, 1.0 / SETTING.use(moved).worst.use))  # the limits are symmetric
            views = [SETTING.view(inside)]
            # The search stops when a round brings less than a hundredth.
            assert min(d.rival_fit(views, SETTING.reach).noncentrality for d in directions) < 1.01 * best


def _typical() -> list[WhitenedPrediction]:
    """The random motions that a size is taken from where no motion is given: those of seed 0."""
    return [SETTING.view(SETTING.random((0, 0, number))) for number in range(9)]


def test_distinction_prints_itself_and_is_plain_data() -> None:
    found, text = designed(), str(designed())
    assert "gravity_tilt" in text.splitlines()[1]
    assert "median of 9 random trajectories" in text
    data = json.loads(json.dumps(found.to_data(), allow_nan=False))
    assert data["pairs"][0]["separation_after"] == found.pairs[0].after
    assert len(data["coefficients"]) == SERIES.size


def test_a_rare_mistake_is_not_stated_beyond_what_noise_is_known_for() -> None:
    """lambda of 95 is Phi(-4.87) = 5.5e-7, of 85 Phi(-4.61) = 2.0e-6."""
    plan = replace(designed(), pairs=(replace(pair(85.0, 95.0)), replace(pair(95.0, 97.0))), exciting=None)
    errors = [line[-3] for line in plan.table.rows]
    assert errors[2:] == ["< 1e-06"] * 2
    assert errors[0] == pytest.approx(2.02e-6, rel=0.01)


@pytest.mark.long
def test_an_interrupted_search_has_the_exchanges_so_far() -> None:
    """After the first exchange: its trajectory, with lambda as of any result."""
    rounds: list[ExchangeRound] = []

    def interrupt(done: ExchangeRound) -> None:
        rounds.append(done)
        raise KeyboardInterrupt

    truth = planar() + TILT
    few = replace(SERIES, harmonics=(1, 2))
    with pytest.raises(DesignInterrupted) as raised:
        discriminate(
            RIG,
            truth,
            values("gravity_tilt"),
            [planar()],
            series=few,
            samples=60,
            noise=NOISE,
            starts=1,
            progress=interrupt,
        )
    found = raised.value.best
    assert found.rounds == tuple(rounds)
    assert found.motion is rounds[0].motion
    assert found.pairs[0].after > 0


def test_runs_multiply_and_the_given_motion_is_what_was_before() -> None:
    slow = random_periodic_trajectory(joints=3, position=0.3, velocity=0.6, acceleration=2.0, period=PERIOD, seed=1)
    truth = direction(TILT, ROTATION)
    found = discriminate(
        RIG,
        truth.truth.model,
        truth.truth.values,
        [truth.rival],
        series=SERIES,
        samples=SAMPLES,
        noise=NOISE,
        reference=slow,
        runs=5,
        starts=1,
    )
    alone = truth.rival_fit([SETTING.view(slow)], SETTING.reach).noncentrality
    assert found.pairs[0].directions[0].before == pytest.approx(5 * alone, rel=1e-6)
    assert found.reference == "the given trajectory"
    assert found.pairs[0].after > found.pairs[0].before


# -------------------------------------------------------------------------- on a rig that shares no equation


def recorded(motion: Trajectory, seed: int, repeats: int = 4) -> Recording:
    frame = simulated.simulate(
        ROBOT, motion, hidden=[simulated.GravityTilt(tilt_y=0.02)], repeats=repeats,
        samples_per_period=SAMPLES, seed=seed,
    )  # fmt: skip
    left_out = {"temperature"}
    return recording_of(frame, without=left_out, rig=RIG)


def chi_square(recording: Recording, effect: Effect) -> float:
    """Of the exact fit by `estimation`, which derives the motion from the recorded angles, in the known noise."""
    model = planar() + effect
    theta = fit(model, recording, noise=NoiseModel.white(ROBOT.noise), start=values(effect.id)).theta
    left = (recording.wrench - predicted_readings(model, recording, theta)) / np.array(ROBOT.noise)
    return float((left**2).sum())


def test_designed_motion_tells_what_a_slow_one_could_not() -> None:
    """A tilted base in MuJoCo: a turned sensor fits a slow recording nearly as well, and not the designed one."""
    slow = random_periodic_trajectory(joints=3, position=0.35, velocity=0.7, acceleration=3.0, period=PERIOD, seed=2)
    fast = designed().motion
    assert fast is not None
    promised = 4 * designed().pairs[0].directions[0].after
    before = 4 * direction(TILT, ROTATION).rival_fit([SETTING.view(slow)], SETTING.reach).noncentrality
    assert before < 10.8  # confusable
    assert promised > 21.6  # separated
    gains = {}
    for name, motion in (("slow", slow), ("fast", fast)):
        recordings = [recorded(motion, seed) for seed in range(4)]
        gains[name] = [chi_square(r, ROTATION) - chi_square(r, TILT) for r in recordings]
    # Normal with mean lambda and std 2 sqrt(lambda): four standard deviations of the mean of four.
    for name, expected in (("slow", before), ("fast", promised)):
        assert np.mean(gains[name]) == pytest.approx(expected, abs=4 * np.sqrt(expected)), name
    assert min(gains["fast"]) > 0  # wrong once in 100 000 times at the lambda promised


def test_diagnosis_asks_for_the_experiment_that_decides() -> None:
    slow = random_periodic_trajectory(joints=3, position=0.35, velocity=0.7, acceleration=3.0, period=PERIOD, seed=2)
    recording = recorded(slow, 0, repeats=8)
    found = diagnose(planar(RIG), recording, effects=[TILT, ROTATION])
    assert len(found.added) == 1
    assert found.findings[0].confusable_with
    asked = next_experiment(found, starts=1, noise=NOISE, series=SERIES)
    (pair,) = asked.pairs
    assert {*pair.names} == {"gravity_tilt", "sensor_rotation"}
    assert asked.runs == 8
    assert pair.before < 10.8 < 21.6 < pair.after
    assert asked.verdict is Separability.SEPARATED
    seen = sensor_noise_of(found)
    assert isinstance(seen, ColouredNoise)
    power = np.diagonal(seen.at(np.array([3.0, 5.0])), axis1=1, axis2=2).real
    # White; a smooth curve through 240 ordinates, each of std 1, is right to 10 % or so in its middle.
    np.testing.assert_allclose(power, np.tile(np.array(ROBOT.noise) ** 2, (2, 1)), rtol=0.4)
    with pytest.raises(InputError, match="--tell"):
        next_experiment(replace(found, findings=found.findings[1:]))


# ------------------------------------------------------------------------------------ what is refused, or set aside


@pytest.mark.long
def test_hopeless_pair_does_not_spoil_the_design_for_another() -> None:
    """A lag of 0.3 ms is a delay of 0.3 ms for all that anybody will ever see; it still is no drag."""
    truth = planar() + LAG
    known = values("sensor_lag") | {"sensor_lag.time_constant": 3e-4}
    rivals = [with_effect_replaced(truth, "sensor_lag", e) for e in (DELAY, VISCOUS)]
    few = replace(SERIES, harmonics=(1, 2))
    found = discriminate(RIG, truth, known, rivals, series=few, samples=60, noise=NOISE, starts=1)
    alike, other = found.pairs
    assert alike.verdict is Separability.REPEATS
    assert (alike.runs_for(21.6) or 0) > 1000
    assert other.after > 1.5 * other.before
    assert all(len(r.rival_fits) == 2 for r in found.rounds)  # only the drag's two directions were designed for


@pytest.mark.parametrize(
    ("true", "rival", "said"),
    [
        (VISCOUS, effects.bias_drift(), "bias_drift is recording-specific"),
        (VISCOUS, effects.thermal_drift(), "'temperature'"),
    ],
    ids=["one recording", "no signal"],
)
def test_effects_that_no_motion_brings_are_refused(true: Effect, rival: Effect, said: str) -> None:
    with pytest.raises(InputError, match=said):
        told(true, rival)


def test_sizes_have_to_be_known() -> None:
    with pytest.raises(InputError, match="has no quadratic_drag or viscous_drag"):
        rival_models(planar(), VISCOUS, QUADRATIC)
    with pytest.raises(InputError, match="changes no reading"):
        told(VISCOUS, QUADRATIC, TOOL)
    with pytest.raises(InputError, match="states none"):
        DesignSetting.of(replace(RIG, limits=None), series=SERIES, samples=SAMPLES, noise=NOISE)
    with pytest.raises(InputError, match="has none"):
        DesignSetting.of(Rig(limits=RIG.limits), series=SERIES, samples=SAMPLES, noise=NOISE)


def test_opponents_take_the_effect_that_the_model_has() -> None:
    model = planar() + TILT + QUADRATIC
    assert _ids(rival_models(model, VISCOUS, QUADRATIC)) == [
        ("gravity_tilt", "quadratic_drag"),
        ("gravity_tilt", "viscous_drag"),
    ]
    both = rival_models(model + VISCOUS, VISCOUS, QUADRATIC)
    assert _ids(both) == [("gravity_tilt", "viscous_drag"), ("gravity_tilt", "quadratic_drag")]


def _ids(models: tuple[WrenchModel, ...]) -> list[tuple[str, ...]]:
    return [tuple(e.id for e in model.effects) for model in models]
