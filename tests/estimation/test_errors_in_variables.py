"""Errors in variables: an objective that does not know of the noise on average, closed forms, bounds and simulation.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.noisy_motion import CASES, LOGGED, Case, planar_poses, planar_run, spatial_poses
from estimation.errors_in_variables import (
    CorrectedScoreProblem,
    ErrorPropagation,
    ErrorsInVariables,
    effective_noise,
    errors_in_variables_fit,
)
from estimation.fit import fit
from estimation.input_noise import InputNoise
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.column_table import ORIENTATION_ERRORS
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.chain.regressor import regressor
from modeling.compiled.symbolic_vector import numpy_function
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.parameter import Parameter
from modeling.rig import Rig
from modeling.space import Space, signals

Array = NDArray[np.float64]

DRAWS = 30
RUN, FOUR, _, ARM_POSES, SPACE_POSES = CASES
ACCELERATION = {"ax": 1.0, "ay": 1.0}


@cache
def corrected(case: Case, seed: int) -> ErrorsInVariables:
    return errors_in_variables_fit(case.model, case.recording(seed), input_noise=case.input_noise)


def theta_of(case: Case) -> Array:
    return np.array([case.truth[p.name] for p in case.model.parameters])


# ------------------------------------------------------------------------------------ the objective


@pytest.mark.parametrize("away", [0.0, 0.03])
def test_the_corrected_chi_square_has_the_mean_of_the_true_motion(away: float) -> None:
    """At the truth and many std from it: 30 draws of the motion's noise against one chi-square without. The mean's own
    error is measured; 4 of it are 1 in 1.6e4. The plain chi-square is many of them away."""
    clean = replace(RUN, std=dict.fromkeys(LOGGED, 1e-12))
    readings = clean.recording(0)
    fitted = fit(RUN.model, readings)
    theta, noise = theta_of(RUN) * (1 + away), InputNoise.stated(LOGGED)
    one = CorrectedScoreProblem.of(fitted, noise)
    several = [one.problem.of_recordings([_moved(readings, seed)]) for seed in range(DRAWS)]
    costs = np.array([replace(one, problem=problem).expand(theta).cost for problem in several])
    plain = np.array([np.sum(problem.evaluate(theta)[0] ** 2) for problem in several])
    residual = one.problem.measured[0] - fitted.noise[0].whitener.series(_prediction(RUN.model, readings, theta))
    true = float(residual @ residual)
    error = costs.std(ddof=1) / np.sqrt(len(costs))
    assert abs(costs.mean() - true) < 4 * error
    assert plain.mean() - true > 8 * error


def _moved(recording: Recording, seed: int) -> Recording:
    rng = np.random.default_rng([seed, 5])
    moved = {n: c + LOGGED.get(n, 0.0) * rng.standard_normal(len(c)) for n, c in recording.columns.items()}
    return recording.moved(columns=moved)


def _prediction(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    parts = compiled_prediction(model)
    known, n = recording.motion.model_signals, recording.samples
    return parts.load.value(known, theta, n) + parts.bias.value(known, theta, n)


def _regressor(model: WrenchModel, known: Mapping[str, Array]) -> Array:
    """Phi (n, p, k) of 22.8."""
    phi = regressor(model)
    symbols = sorted(phi.free_symbols, key=str)
    count = len(known["phi"])
    values = numpy_function(symbols, list(phi))(*(known[str(s)] for s in symbols))
    return np.stack([np.broadcast_to(v, (count,)) for v in values], axis=1).reshape(count, *phi.shape)


def test_linear_model_solves_the_corrected_normal_equations() -> None:
    """With accelerations alone noisy Phi is linear in the errors, and the minimum is Fuller's:
    (sum Phi' W Phi - sum_i std_i² dPhi_i' W dPhi_i) theta = sum Phi' W y, with the effective W at theta. In closed form
    but for the rounds of the weights, which leave less than a hundredth of a std."""
    case = replace(RUN, std=ACCELERATION)
    recording = case.recording(1)
    found = errors_in_variables_fit(case.model, recording, input_noise=case.input_noise).corrected
    logged, names = dict(recording.signals), list(ACCELERATION)
    phi = _regressor(case.model, logged)
    slopes = np.stack([_regressor(case.model, logged | {n: logged[n] + 1}) - phi for n in names])
    theta, weight, plain, excess = found.theta, np.eye(3), np.eye(len(found.theta)), np.eye(len(found.theta))
    for _ in range(5):
        added = np.einsum("inpk,inqj,k,j->pq", slopes, slopes, theta, theta) / len(phi)
        weight = np.asarray(np.linalg.inv(np.diag(np.square(case.rig.noise)) + added))
        plain = np.einsum("npk,pq,nqj->kj", phi, weight, phi)
        excess = np.einsum("inpk,pq,inqj->kj", slopes, weight, slopes)
        theta = np.linalg.solve(plain - excess, np.einsum("npk,pq,nq->k", phi, weight, recording.wrench))
    std = np.sqrt(np.diag(found.covariance))
    assert np.abs((found.theta - theta) / std).max() < 0.01
    inverse = np.linalg.inv(plain - excess)
    unit = np.outer(std, std)
    np.testing.assert_allclose(inverse @ plain @ inverse / unit, found.covariance / unit, atol=0.01)


def test_no_noise_corrects_nothing() -> None:
    recording = FOUR.recording(0)
    tiny = InputNoise.stated(dict.fromkeys(LOGGED, 1e-9))
    found = errors_in_variables_fit(FOUR.model, recording, input_noise=tiny)
    plain = fit(FOUR.model, recording)
    std = np.sqrt(np.diag(plain.covariance))
    assert np.abs((found.corrected.theta - plain.theta) / std).max() < 1e-6
    of_plain = found.plain.covariance  # that of `fit` counts the error of the weights, too
    np.testing.assert_allclose(found.corrected.covariance, of_plain, atol=1e-6 * np.outer(std, std).max())
    assert found.reliability == pytest.approx(1.0, abs=1e-9)


# ---------------------------------------------------------------------------------------- simulation


def test_the_bias_of_plain_least_squares_goes() -> None:
    """20 draws: a mean error in std has a standard error of 0.22, so that 4.5 of it, 1.0, is 1 in 2.5e4 for six; the
    spread of 20 errors is known to 16 %. The plain bias is two or more of these std."""
    found = [corrected(RUN, seed) for seed in range(20)]
    truth = theta_of(RUN)
    std = np.array([np.sqrt(np.diag(f.corrected.covariance)) for f in found])
    errors = np.array([f.corrected.theta - truth for f in found]) / std
    assert np.abs(errors.mean(axis=0)).max() < 1.0
    assert errors.std(axis=0).min() > 0.4
    assert errors.std(axis=0).max() < 1.8
    plain = np.array([f.plain.theta - truth for f in found]) / std
    biased = [list(RUN.truth).index(name) for name in ("m", "mlg", "I")]
    assert np.abs(plain.mean(axis=0))[biased].min() > 1.0


def test_averaging_takes_the_bias_down_with_the_repeats() -> None:
    """Four repeats: a quarter of the bias, at half the std (22.12); within 30 %, the scatter of the noise measured."""
    once, four = (np.mean([corrected(case, s).bias["I"] for s in range(8)]) for case in (RUN, FOUR))
    assert four / once == pytest.approx(0.25, rel=0.3)


def test_as_exact_as_orthogonal_regression_can_be() -> None:
    """The bound of every estimator that takes S + f_u Sigma f_u' for the noise of a sample, at the true motion."""
    found = corrected(RUN, 0)
    recording = from_columns(dict(planar_run()), rig=Rig())
    slopes = ErrorPropagation.of(RUN.model, recording, InputNoise.stated(LOGGED)).emitted
    slope = slopes.value(planar_run(), theta_of(RUN), recording.samples).reshape(recording.samples, 3, -1)
    shock = slope * np.array(list(LOGGED.values()))
    variance = np.diag(np.square(RUN.rig.noise)) + np.einsum("npi,nqi->npq", shock, shock)
    phi = _regressor(RUN.model, planar_run())
    information = np.einsum("npk,npq,nqj->kj", phi, np.linalg.inv(variance), phi)
    bound = np.sqrt(np.diag(np.linalg.inv(information)))
    ratio = np.sqrt(np.diag(found.corrected.covariance)) / bound
    # Noise of a regressor costs more than the bound knows: up to 1 / reliability, and its own doubt.
    assert ratio.max() < 1.05 / found.reliability
    assert ratio.min() > 0.9


def test_a_stated_and_a_measured_noise_agree() -> None:
    """750 degrees of freedom: the std within 4.5 · 2.6 %."""
    recording = FOUR.recording(2)
    measured = InputNoise.measured(recording)
    assert set(measured.names) == set(LOGGED)
    for name, found in measured.std.items():
        assert found == pytest.approx(LOGGED[name], rel=0.12)
    told = errors_in_variables_fit(FOUR.model, recording, input_noise=InputNoise.stated(LOGGED))
    asked = corrected(FOUR, 2)
    std = np.sqrt(np.diag(asked.corrected.covariance))
    assert np.abs((told.corrected.theta - asked.corrected.theta) / std).max() < 0.5


@pytest.mark.parametrize("case", [ARM_POSES, SPACE_POSES], ids=["arm", "space"])
def test_poses_whose_angles_are_noisy(case: Case) -> None:
    """Within 4.5 std: 1 in 1e4. The noise of angles turns gravity; repeats of the poses tell how much."""
    measured = InputNoise.measured(replace(case, repeats=6).recording(3))
    assert set(measured.names) == set(case.std)
    for name, std in measured.std.items():
        assert std == pytest.approx(case.std[name], rel=4.5 / np.sqrt(2 * 24 * 5))
    found = corrected(case, 3).corrected
    seen = {name: e for name, e in found.parameters.items() if np.isfinite(e.std)}
    assert len(seen) == (5 if case is ARM_POSES else 10)
    assert max(abs(e.value - case.truth[name]) / e.std for name, e in seen.items()) < 4.5


# --------------------------------------------------------------------------------- loads with errors


def _load(model: WrenchModel, columns: Mapping[str, Array], theta: Array, rig: Rig | None = None) -> Array:
    recording = from_columns(dict(columns), rig=rig)
    return compiled_prediction(model).load.value(recording.signals, theta, recording.samples)


@pytest.mark.parametrize("name", ["q1", "q3", "turn_x", "turn_y", "turn_z"])
def test_errors_of_a_pose_reach_the_load_as_they_do_in_the_recording(name: str) -> None:
    """Slope and curvature against central differences with h = 1e-3: h² times a fourth derivative, loads of 10 N."""
    case = SPACE_POSES if name in ORIENTATION_ERRORS else ARM_POSES
    clean = spatial_poses() if name in ORIENTATION_ERRORS else planar_poses()
    rig, theta, h = Rig(link_lengths=(1.0, 0.97, 0.4)), theta_of(case), 1e-3
    model = case.model if name in ORIENTATION_ERRORS else case.model + effects.com_offset()
    theta = theta if name in ORIENTATION_ERRORS else np.append(theta, 0.02)
    rig_of = None if name in ORIENTATION_ERRORS else rig

    def at(step: float) -> Array:
        if name not in ORIENTATION_ERRORS:
            return _load(model, {**clean, name: clean[name] + step}, theta, rig_of)
        names = ("qx", "qy", "qz", "qw")
        turn = Rotation.from_rotvec(step * np.eye(3)[ORIENTATION_ERRORS.index(name)])
        quaternions = (Rotation.from_quat(np.stack([clean[n] for n in names], axis=1)) * turn).as_quat()
        return _load(model, {**clean, **dict(zip(names, quaternions.T, strict=True))}, theta)

    recording = from_columns(dict(clean), rig=rig_of)
    load = ErrorPropagation.of(model, recording, InputNoise.stated({name: 0.5}))
    values = dict(zip(compiled_prediction(model).symbols, theta.tolist(), strict=True))
    slope, bent = load.slopes.xreplace(values), load.curvature(sp.Matrix([[2.0]])).xreplace(values)
    for expression, expected in ((slope, (at(h) - at(-h)) / (2 * h)), (bent, (at(h) - 2 * at(0) + at(-h)) / h**2)):
        symbols = sorted(expression.free_symbols, key=str)
        found = numpy_function(symbols, list(expression))(*(recording.signals[str(s)] for s in symbols))
        stacked = np.stack([np.broadcast_to(v, (recording.samples,)) for v in found], axis=1)
        np.testing.assert_allclose(stacked, expected, atol=1e-4)


@dataclass(frozen=True)
class GrowingMass(Effect):
    """A mass that changes over the record, so that no two repeats are predicted alike."""

    id: ClassVar[str] = "growing_mass"
    title: ClassVar[str] = "growing mass"
    stage: ClassVar[Stage] = Stage.TIP_BODY
    equation: ClassVar[str] = "m + rate progress"
    advice: ClassVar[str] = ""

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return (Parameter(name="rate", unit="kg"),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        (progress,) = signals("progress")
        return replace(chain, body=replace(chain.body, mass=chain.body.mass + p["rate"] * progress))


def test_a_load_that_does_not_repeat_is_corrected_alike() -> None:
    """While the rate is zero every repeat is predicted alike, but as one long record; the excess information on the
    tool stays the same, to what the random signs tell: 2 % of the entries' size."""
    recording, noise = FOUR.recording(1), InputNoise.stated(LOGGED)
    first = fit(FOUR.model, recording)
    growing = fit(FOUR.model + GrowingMass(), recording, noise=first.noise)
    whole = CorrectedScoreProblem.of(growing, noise)
    assert "progress" in whole.slopes[0].inputs
    one = CorrectedScoreProblem.of(first, noise).expand(first.theta).excess
    all_of_it = whole.expand(np.append(first.theta, 0.0)).excess
    scale = np.sqrt(np.diag(all_of_it))
    assert scale[-1] > 0.01 * scale[3]
    unit = np.outer(scale, scale)[3:6, 3:6]  # no error reaches a bias
    np.testing.assert_allclose(all_of_it[3:6, 3:6] / unit, one[3:6, 3:6] / unit, atol=0.02)


def test_effective_noise_is_the_sum_at_the_lines_of_the_motion() -> None:
    """Rows of both noises together have unit variance, line by line: the averages of 3000 squares err by 2.6 %."""
    recording = FOUR.recording(4)
    own = fit(FOUR.model, recording).noise[0]
    added = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 1e-4]])
    wide = effective_noise(own, recording, added).whitener
    assert isinstance(wide, FourierLineWhitener)
    assert isinstance(own.whitener, FourierLineWhitener)
    motion = len(own.whitener.excited_lines)
    for old, new in zip(own.whitener.root[:motion], wide.root[:motion], strict=True):
        expected = np.linalg.inv(old.conj().T @ old) + added
        np.testing.assert_allclose(new @ expected @ new.conj().T, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(wide.root[motion:], own.whitener.root[motion:])


def test_noise_from_a_residual_has_the_inputs_in_it() -> None:
    recording = RUN.recording(0)
    stated = fit(RUN.model, recording.moved(rig=Rig())).noise[0]
    assert stated.source is NoiseSource.RESIDUAL
    again: RecordingNoise = effective_noise(stated, recording, np.eye(3))
    assert again is stated


# -------------------------------------------------------------------------------------------- people


def test_what_drowns_in_the_noise_is_not_shown() -> None:
    """ddphi with five times the noise of its own size: I is not told."""
    loud = replace(RUN, std={"ddphi": 60.0})
    found = errors_in_variables_fit(RUN.model, loud.recording(0), input_noise=loud.input_noise)
    assert np.isinf(found.corrected.parameters["I"].std)
    assert "not identifiable" in str(found)
    assert "I" not in found.bias
    assert found.reliability < 0.1


def test_two_recordings_share_the_tool() -> None:
    several = [replace(RUN.recording(s), name=f"run{s}") for s in range(2)]
    found = errors_in_variables_fit(RUN.model, several, input_noise=RUN.input_noise).corrected
    alone = corrected(RUN, 0).corrected
    assert found.parameters["m"].std == pytest.approx(alone.parameters["m"].std / np.sqrt(2), rel=0.1)
    assert "bias_fx@run1" in found.values


def test_table_says_value_std_and_bias() -> None:
    found = corrected(RUN, 0)
    lines = str(found).splitlines()
    assert lines[0].split("  ")[0] == "parameter"
    assert [line.split()[0] for line in lines[1:7]] == list(RUN.truth)
    assert found.bias["I"] == pytest.approx(found.plain.values["I"] - found.corrected.values["I"])
    assert "ax 1 m/s²" in lines[-1]


@pytest.mark.parametrize(
    ("std", "message"),
    [({"fx": 1.0}, "not a motion signal"), ({"ax": -1.0}, "is not a standard deviation"), ({}, "no signal is given")],
)
def test_noise_is_stated_by_signal(std: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        InputNoise.stated(std)


def test_refusals() -> None:
    run = RUN.recording(0)
    with pytest.raises(InputError, match="there is no signal 'wx'"):
        errors_in_variables_fit(RUN.model, run, input_noise=InputNoise.stated({"wx": 0.1}))
    velocity = RUN.clean() | {"vx": np.zeros(250), "vy": np.zeros(250)}
    with pytest.raises(InputError, match="uses none of vx"):
        errors_in_variables_fit(RUN.model, from_columns(velocity), input_noise=InputNoise.stated({"vx": 0.1}))
    with pytest.raises(InputError, match="no repeats to estimate"):
        errors_in_variables_fit(RUN.model, run)
    smooth = {n: c for n, c in FOUR.recording(0).columns.items() if n == "phi"}
    with pytest.raises(InputError, match="used as it was measured"):
        InputNoise.measured(FOUR.recording(0).moved(columns=smooth))
    with pytest.raises(InputError, match="lag or a delay"):
        errors_in_variables_fit(RUN.model + effects.sensor_lag(), run, input_noise=RUN.input_noise)
