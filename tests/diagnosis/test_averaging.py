"""Estimates with the doubt between effects that a recording does not tell apart."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import binom
from scipy.stats import t as student

from diagnosis import averaging
from diagnosis.averaging import AveragedEstimate, Member, ModelAverage, _log_odds, _weighed
from diagnosis.diagnosis import Diagnosis, diagnose
from estimation.fit import Fit, fit, solved
from estimation.least_squares.problem import Problem
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.effects import named
from modeling.errors import InputError
from modeling.rigid_body import Load
from modeling.space import Space
from tests.shared.recordings import base, recorded, recording_of
from tests.shared.rigs import RIG
from truewrench.files.model_file import ModelFile, as_model_file
from truewrench.simulated_rig import (
    HiddenEffect,
    PlanarRig,
    SensorCrosstalk,
    SensorGain,
    SensorRotation,
    SpatialRig,
    ViscousDrag,
    simulate,
)
from truewrench.text.diagnosis_text import diagnosis_text
from truewrench.workbench.study_words import verdict_words

pytest.importorskip("mujoco")

GAIN, LEAK = ("sensor_gain", "sensor_crosstalk")
EFFECTS = tuple(named(i) for i in (GAIN, LEAK, "viscous_drag", "gain_nonlinearity"))
"""A gain of fy is imitated by a leak of the torque into fx, and a mass that is wrong by as much as the gain."""
TRUTH = {"m": PlanarRig().mass, "mlg": PlanarRig().mlg, "I": PlanarRig().inertia}


def gain(size: float) -> HiddenEffect:
    return SensorGain(errors=(("fy", 0.03 * size),))


def leak(size: float) -> HiddenEffect:
    """Of the torque into fx, 1/m."""
    return SensorCrosstalk(leaks=(("fx", "tau", 0.3 * size),))


def measured(*hidden: HiddenEffect, motion: int, seed: int) -> Recording:
    """Four repeats of three seconds."""
    rig = PlanarRig()
    moved = rig.random_motion(seed=motion, period=3.0, harmonics=3)
    frame = simulate(rig, moved, hidden=hidden, repeats=4, samples_per_period=150, seed=seed)
    return recording_of(frame, without=("temperature",), rig=RIG, name=f"motion {motion}")


@cache
def gain_or_leak(*, held_out: bool = False) -> Diagnosis:
    others = measured(gain(1.0), motion=4, seed=14) if held_out else None
    return diagnose(planar(RIG), measured(gain(1.0), motion=1, seed=11), effects=EFFECTS, validate=others)


def mixture(weights: list[float], values: list[float], stds: list[float], freedoms: list[float]) -> AveragedEstimate:
    """With the members' own 95 % intervals."""
    half = student.ppf(0.975, freedoms) * np.array(stds)
    value, low, high = np.array(values), np.array(values) - half, np.array(values) + half
    return AveragedEstimate("m", "kg", np.array(weights), value, np.array(stds), np.array(freedoms), low, high)


# ---------------------------------------------------------------------------------------- one estimate


def test_std_and_interval_are_those_of_a_mixture() -> None:
    """Against draws (a million: std to 0.2 %, 5 std of its error) and the mixture's distribution by SciPy."""
    weights, values, stds, freedoms = [0.5, 0.3, 0.2], [1.0, 1.3, 0.7], [0.05, 0.1, 0.02], [1e4, 30.0, 6.0]
    estimate, rng = mixture(weights, values, stds, freedoms), np.random.default_rng(1)
    member = rng.choice(3, 1_000_000, p=weights)
    draws = np.array(values)[member] + np.array(stds)[member] * rng.standard_normal(len(member))
    assert estimate.value == pytest.approx(draws.mean(), abs=1e-3)
    assert estimate.std == pytest.approx(draws.std(), rel=2e-3)
    assert estimate.std**2 == pytest.approx(estimate.within**2 + estimate.between**2, rel=1e-12)

    def beyond(end: float, share: float) -> float:
        return float(np.dot(weights, student.cdf(end, freedoms, values, stds)) - share)

    exact = [brentq(beyond, -5, 5, args=(share,), xtol=1e-14) for share in (0.025, 0.975)]
    assert estimate.interval == pytest.approx(exact, abs=1e-12)
    inside = student.cdf(estimate.high[0], freedoms, values, stds) - student.cdf(
        estimate.low[0], freedoms, values, stds
    )
    assert estimate.outside == pytest.approx(1 - np.dot(weights, inside), abs=1e-12)


def test_of_one_member_it_is_that_member() -> None:
    estimate = mixture([1.0], [0.9123], [0.0031], [17.0])
    assert (estimate.value, estimate.std, estimate.between) == (0.9123, 0.0031, 0.0)
    assert estimate.interval == (estimate.low[0], estimate.high[0])
    assert estimate.outside == pytest.approx(0.05)
    assert not estimate.doubtful


@pytest.mark.parametrize(("distance", "weight", "doubtful"), [(9.0, 0.04, False), (9.0, 0.07, True), (0.5, 0.5, False)])
def test_doubtful_is_an_interval_that_is_wrong_twice_as_often_as_it_says(
    distance: float, weight: float, doubtful: bool
) -> None:
    """Of a member nine std away the weight counts, beside the 5 % that are left out, of a near one nothing."""
    assert mixture([1 - weight, weight], [0.0, distance], [1.0, 1.0], [1e4, 1e4]).doubtful is doubtful


def test_a_value_that_a_member_fixes_is_a_step() -> None:
    """Half of the probability is at zero: that is the lower end, and outside the interval of the other."""
    estimate = mixture([0.5, 0.5], [3.0, 0.0], [0.1, 0.0], [1e4, 1e4])
    assert estimate.interval[0] == 0.0
    assert estimate.interval[1] == pytest.approx(3.0 + 0.1 * student.ppf(0.95, 1e4), abs=1e-9)
    assert estimate.outside == pytest.approx(0.525)
    fixed_first = mixture([0.5, 0.5], [0.0, 3.0], [0.0, 0.1], [1e4, 1e4])
    assert fixed_first.outside == pytest.approx(0.5)


def test_what_a_member_does_not_identify_is_not_known() -> None:
    estimate = replace(mixture([0.5, 0.5], [1.0, 2.0], [0.1, 1.0], [9.0, 9.0]), stds=np.array([0.1, np.inf]))
    assert not estimate.known
    assert estimate.doubtful
    assert estimate.outside == pytest.approx(0.525)  # by that member it may be anywhere
    assert not replace(estimate, stds=np.array([np.inf, 0.1])).doubtful  # which the model chosen does not claim to know
    assert estimate.to_data()["value"] is None


# ------------------------------------------------------------------------------------ members and weights


def test_a_model_of_uncertain_loads_is_read_with_its_budget_and_its_alternatives() -> None:
    recording = replace(measured(gain(1.0), motion=1, seed=11).carrying(Load.of("0.001+-0.0005@0.05+-0.001")), name="a")
    found = diagnose(planar(RIG), recording, effects=EFFECTS)
    written = as_model_file(found, "save")
    read = ModelFile.from_text(written.to_text())
    assert read.to_text() == written.to_text()
    assert read.budget is not None
    assert [name for name, _, _ in read.alternatives] == [LEAK]


def test_nothing_is_averaged_where_nothing_is_confusable() -> None:
    found = diagnose(planar(RIG), recorded(Space.PLANE, ViscousDrag(c=0.15), seed=3), effects=EFFECTS)
    average, ends = found.averaged, found.fit.intervals()
    assert found.added == ("viscous_drag",)
    assert [m.weight for m in average.members] == [1.0]
    assert average.members[0].fit is found.fit
    for number, name in enumerate(found.fit):
        estimate = average[name]
        assert (estimate.value, estimate.std, estimate.between) == (found.fit[name].value, found.fit[name].std, 0.0)
        assert estimate.interval == (ends.low[number], ends.high[number])
    assert average.sentences == []
    assert "All weight is on the model chosen" in str(average)
    assert "averaged" not in found.to_data()
    assert "alternatives" not in as_model_file(found, "save").to_data()


def test_members_are_fits_of_the_readings_in_the_same_noise() -> None:
    """Each is what `fit` says of that model in that noise, and the weights follow from chi-squares and projections."""
    found = gain_or_leak()
    average, chosen = found.averaged, found.fit
    assert [m.name for m in average.members] == [GAIN, LEAK]
    mean_deviance, projections = [], []
    for member in average.members:
        again = fit(planar(RIG) + named(member.name), chosen.recordings, noise=chosen.noise)
        np.testing.assert_allclose(member.fit.theta, again.theta, rtol=1e-5, atol=1e-6)
        residual = again.whitened_residual()
        mean_deviance.append(residual @ residual + len(again.theta))
        assert member.deviance == pytest.approx(mean_deviance[-1], abs=1e-3)
        derivative = again.linearised().whole
        left, _, _ = np.linalg.svd(derivative / np.linalg.norm(derivative, axis=0), full_matrices=False)
        projections.append(left @ left.T)
    gain, apart = mean_deviance[0] - mean_deviance[1], np.linalg.norm(projections[0] - projections[1]) ** 2
    odds = np.exp(gain * abs(gain) / (2 * abs(gain) + apart))
    assert average.members[1].weight / average.members[0].weight == pytest.approx(odds, rel=1e-3)
    assert sum(m.weight for m in average.members) == pytest.approx(1, abs=1e-12)


def test_held_out_readings_count_as_fitted_ones() -> None:
    """The difference of chi-squares is that of a fit to both recordings together.

    To 15 %: the estimates' reported variance, by which those of the held-out one may change, is wider than the rows say
    by as much as the noise of four repeats is uncertain.
    """
    found = gain_or_leak(held_out=True)
    training, held_out = found.steps[-1].tested, found.steps[-1].validation[0]
    recordings, noise = (*training.recordings, held_out.recording), (*training.noise, held_out.noise)
    together = []
    for member in found.averaged.members[:2]:
        zero = {
            f"bias_{c}@{held_out.recording.name}": member.fit[f"bias_{c}"].value for c in held_out.recording.channels
        }
        joint = solved(Problem.of(member.fit.model, recordings, noise), member.fit.values | zero)
        together.append(joint.problem.chi_square(joint.theta) + len(joint.theta))
    stated = [member.deviance for member in found.averaged.members[:2]]
    assert stated[1] - stated[0] == pytest.approx(together[1] - together[0], rel=0.15, abs=0.15)


def test_weights_are_relative_and_never_overflow() -> None:
    chosen = gain_or_leak().fit
    members = [Member(name, chosen, 0.0, odds) for name, odds in (("a", 0.0), ("b", -np.log(3)), ("c", -9e9))]
    assert [m.weight for m in _weighed(members)] == pytest.approx([0.75, 0.25, 0.0], abs=1e-12)
    better = [Member("a", chosen, 0.0), Member("b", chosen, 0.0, 9e9)]
    assert [m.weight for m in _weighed(better)] == [0.0, 1.0]


@pytest.mark.parametrize("other", [0, 1])
def test_odds_are_the_likelihood_ratio_where_chance_makes_no_difference(other: int) -> None:
    """Of models that can fit the same; of one with a direction more a small difference is hardly any evidence."""
    basis = np.eye(6)[:, :3]
    same = _log_odds(5.0, basis, np.roll(basis, 0, axis=1))
    assert same == pytest.approx(2.5)
    assert _log_odds(-5.0, basis, basis) == pytest.approx(-2.5)
    assert _log_odds(0.0, basis, basis) == 0.0
    assert 1 - 1 / (1 + np.exp(-_log_odds(900.0, basis, basis))) > 0  # a model file keeps some for the other
    more = np.eye(6)[:, : 4 + other]
    apart = 1 + other
    assert _log_odds(2.0, basis, more) == pytest.approx(4 / (4 + apart))
    assert _log_odds(2.0, basis, more) < 1.0


def test_odds_are_calibrated() -> None:
    """Of two models that are as likely beforehand: of the draws that are given odds so many are the other model.

    Their chi-squares differ by l = 8 or -8, with the variance 4 l + 2 s. 4000 draws; bins of 300 or more, each to 0.08:
    three std, and what estimating l makes of the odds.
    """
    separation, basis, more = 8.0, np.eye(9)[:, :2], np.eye(9)[:, :6]
    rng = np.random.default_rng(2)
    is_other = rng.random(4000) < 0.5
    gain = np.where(is_other, 1, -1) * separation + np.sqrt(4 * separation + 2 * 4) * rng.standard_normal(4000)
    stated = np.array([1 / (1 + np.exp(-_log_odds(float(g), basis, more))) for g in gain])
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.0)):
        within = (stated >= low) & (stated < high)
        assert within.sum() > 300
        assert is_other[within].mean() == pytest.approx(stated[within].mean(), abs=0.08)


def test_a_member_without_weight_is_left_out_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    found = gain_or_leak()
    monkeypatch.setattr(averaging, "LEAST_WEIGHT", 0.9)
    average = ModelAverage.of(found.steps[-1], found.findings)
    assert [(m.name, m.weight) for m in average.members] == [(GAIN, 1.0)]
    assert any("sensor_crosstalk is left out: its weight is 0." in sentence for sentence in average.left_out)
    assert average["m"].std == found.fit["m"].std


def test_a_member_that_cannot_be_fitted_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither one without a solution nor one whose refits do not converge passes for one that is not there."""
    found = gain_or_leak()

    def refused(*_: object) -> Fit:
        raise InputError(what="no solution", where="fit", remedy="")

    def unfinished(chosen: Fit, *_: object) -> Fit:
        return replace(chosen, converged=False)

    for refitted, said in ((refused, "no solution"), (unfinished, "whose refit has not converged")):
        monkeypatch.setattr(averaging, "_refitted", refitted)
        average = ModelAverage.of(found.steps[-1], found.findings)
        assert [m.weight for m in average.members] == [1.0]
        (sentence,) = average.sentences
        assert sentence.startswith("Not told apart, but left out: sensor_crosstalk")
        assert said in sentence
        assert said in average.to_data()["left_out"][0]


@pytest.mark.long(4)
def test_a_refit_goes_on_until_it_has_converged() -> None:
    """Six axes turned by little: thirty leaks imitate it, and take more steps than one refit has."""
    rig = SpatialRig(position_limit=(0.2, 0.3), velocity_limit=(0.4, 0.6), acceleration_limit=(2.0, 3.0))
    motion = rig.random_motion(seed=1, period=4.0, harmonics=4)
    frame = simulate(rig, motion, hidden=(SensorRotation(yaw=0.03),), repeats=4, samples_per_period=200, seed=11)
    candidates = [named(i) for i in ("sensor_rotation", LEAK)]
    average = diagnose(base(Space.SPACE), recording_of(frame, without=("temperature",)), effects=candidates).averaged
    assert [m.name for m in average.members] == ["sensor_rotation", LEAK]
    assert not average.unfitted
    assert average["m"].std > 10 * average["m"].stds[0]


def test_the_doubt_is_said_beside_the_verdict() -> None:
    found = gain_or_leak()
    lead, *lines = found.averaged.sentences
    assert "sensor_gain 0." in lead
    assert "sensor_crosstalk 0." in lead
    assert any(line.startswith("m is 0.9") and "averaged" in line and line.endswith(" kg.") for line in lines)
    assert not any(line.startswith("bias") for line in lines)
    assert all(line in diagnosis_text(found) for line in (lead, *lines))
    assert all(line in verdict_words(found) for line in (lead, *lines))  # of the workbench
    data = found.to_data()["averaged"]
    assert [m["name"] for m in data["members"]] == [GAIN, LEAK]
    assert data["parameters"]["m"]["doubtful"]
    low, high = data["parameters"]["m"]["low"], data["parameters"]["m"]["high"]
    assert low < TRUTH["m"] < high


def test_a_parameter_of_one_member_alone_is_not_averaged() -> None:
    average = gain_or_leak().averaged
    assert not any(estimate.name.startswith(("sensor_gain", "sensor_crosstalk")) for estimate in average.estimates)
    with pytest.raises(InputError, match=r"no parameter of every member is called 'sensor_gain\.fy'; use one of"):
        average["sensor_gain.fy"]


# ------------------------------------------------------------------------------------------------ coverage


@pytest.mark.long
def test_intervals_cover_whichever_effect_it_was() -> None:
    """Of 40 recordings with a gain or a leak, not told apart: so few inside happen in one of 1000 series at 95 %, for
    each of three parameters. By the model chosen alone the mass is right where it was the gain: in half of them."""
    covered, alone, sets = dict.fromkeys(TRUTH, 0), dict.fromkeys(TRUTH, 0), 0
    for number in range(40):
        rng = np.random.default_rng([7, number])
        size = rng.uniform(0.5, 1.5) * rng.choice([-1, 1])
        recording = measured((gain, leak)[number % 2](size), motion=1000 + number, seed=5000 + number)
        average = diagnose(planar(RIG), recording, effects=EFFECTS).averaged
        if len(average.members) == 1:
            continue
        sets += 1
        for name, truth in TRUTH.items():
            estimate = average[name]
            covered[name] += estimate.interval[0] <= truth <= estimate.interval[1]
            alone[name] += estimate.low[0] <= truth <= estimate.high[0]
    assert sets > 35
    assert all(binom.cdf(count, sets, 0.95) > 1e-3 for count in covered.values()), covered
    assert alone["m"] < 0.7 * sets
