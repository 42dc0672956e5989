"""Fits to recordings of the simulated rig: MuJoCo's forces, noise whose size is known, and the truth beside it.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from estimation.robust_fit import robust_fit
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import planar
from modeling.errors import InputError
from modeling.noise import NoiseModel, NoiseSource
from modeling.rig import Rig, SensorDescription
from modeling.space import Space
from tests.shared.recordings import SAMPLES, base, noiseless_columns, recorded
from tests.shared.rigs import SIMULATED
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")


def truth_of(space: Space) -> dict[str, float]:
    """Bias and body of the rig, by the models' names."""
    rig = SIMULATED[space]
    biases = {f"bias_{channel}": value for channel, value in zip(rig.channels, rig.bias, strict=True)}
    if isinstance(rig, simulated.PlanarRig):
        return biases | {"m": rig.mass, "mlg": rig.mlg, "I": rig.inertia}
    assert isinstance(rig, simulated.SpatialRig)
    return biases | dict(zip(NAMES, (rig.mass, *rig.first_moment, *rig.inertia), strict=True))


def scores(estimated: Fit, truth: Mapping[str, float]) -> dict[str, float]:
    """Error of each parameter in units of its std."""
    return {name: (estimated.values[name] - value) / estimated.parameters[name].std for name, value in truth.items()}


# ------------------------------------------------------------------------------------ the rigid tip


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("noise", ["white", "autoregressive"])
def test_body_and_bias_are_recovered(space: Space, noise: str) -> None:
    """Within 4.5 std: 1 in 1e4 for all of 22 parameters; and the std say something: each is far below the truth's
    size in its kind."""
    estimated = fit(base(space), recorded(space, seed=1, noise=noise))
    truth = truth_of(space)
    assert estimated.values.keys() == truth.keys()
    assert max(map(abs, scores(estimated, truth).values())) < 4.5
    assert estimated.parameters["m"].std < 0.02 * truth["m"]
    kinds = {p.name: p.unit for p in base(space).parameters}
    for unit in ("kg m", "kg m²"):
        largest = max(abs(truth[n]) for n, u in kinds.items() if u == unit)
        assert all(e.std < 0.1 * largest for e in estimated.parameters.values() if e.unit == unit)


@pytest.mark.parametrize("space", list(Space))
def test_a_recording_without_noise_gives_the_truth(space: Space) -> None:
    """Up to what the resolvers' steps of 7.4e-6 rad, differentiated, leave; they repeat with the motion."""
    found = dict(noiseless_columns(space, (), 4, 5))
    rig = SIMULATED[space]
    del found["temperature"]
    links = rig.link_lengths if isinstance(rig, simulated.PlanarRig) else None
    stated = dict(zip(rig.channels, rig.noise, strict=True))
    described = Rig(link_lengths=links, sensor=SensorDescription(noise=stated))
    single = {name: values[:SAMPLES] for name, values in found.items() if name != "repeat"}
    estimated = fit(base(space), from_columns(single, rig=described))
    assert estimated.noise[0].source is NoiseSource.RIG
    assert max(map(abs, scores(estimated, truth_of(space)).values())) < 0.1


def test_units_and_table() -> None:
    estimated = fit(planar(), recorded(Space.PLANE, seed=2))
    assert {name: e.unit for name, e in estimated.parameters.items()} == {p.name: p.unit for p in planar().parameters}
    lines = str(estimated).splitlines()
    assert [line.split()[0] for line in lines[1:-1]] == list(estimated.parameters)
    assert lines[-1].startswith("reduced chi-square ")


REALISATIONS = 60


@cache
def realisations(noise: str, repeats: int) -> tuple[Fit, ...]:
    return tuple(
        fit(planar(), recorded(Space.PLANE, seed=seed, noise=noise, repeats=repeats)) for seed in range(REALISATIONS)
    )


@pytest.mark.parametrize(
    ("noise", "repeats"),
    [("white", 4), pytest.param("autoregressive", 4, marks=pytest.mark.long(seconds=3)),
     pytest.param("white", 1, marks=pytest.mark.long(seconds=2))],
)  # fmt: skip
def test_intervals_cover_the_truth(noise: str, repeats: int) -> None:
    """95 % intervals of 6 parameters in 60 realisations of the noise.

    A parameter misses 60 times 5 %, 3 of 60: more than 11 is 1 in 1e4, and 1 in 1700 for any of six. All together
    miss 18 of 360; in groups of up to two (m with mlg, mlg with I, that one error moves together), std of 5.9: more
    than 44 or fewer than one are 4.5 and 3 sigma away.
    """
    truth = truth_of(Space.PLANE)
    found = np.array([list(scores(f, truth).values()) for f in realisations(noise, repeats)])
    missed = np.abs(found) > 1.96
    assert missed.sum(axis=0).max() <= 11
    assert 1 <= missed.sum() <= 44
    # The mean of 60 scores errs by 0.13 (0.6 is 4.6 sigma), their spread by 9 %.
    assert np.abs(found.mean(axis=0)).max() < 0.6
    # In noise that is flat below the motion's lines the std of the zeros, of few lines, are up to twice too large.
    assert found.std(axis=0)[:3].min() > 0.4
    assert found.std(axis=0)[3:].min() > 0.6
    assert found.std(axis=0).max() < 1.4


@pytest.mark.parametrize(("noise", "repeats"), [("white", 4), ("autoregressive", 4)])
def test_covariance_is_the_errors_whole_distribution(noise: str, repeats: int) -> None:
    """e' C^-1 e is a chi-square of 6; 60 of them add up to 360 with a std of 27: limits of 4.5 sigma, and 15 % for the
    noise, which is estimated from 1000 samples."""
    truth = np.array(list(truth_of(Space.PLANE).values()))
    total = 0.0
    for estimated in realisations(noise, repeats):
        error = estimated.theta - truth
        scale = np.sqrt(np.diag(estimated.covariance))
        total += float(error / scale @ np.linalg.solve(estimated.covariance / np.outer(scale, scale), error / scale))
    assert 0.85 * 360 - 4.5 * 27 < total < 1.15 * 360 + 4.5 * 27


def test_chi_square_of_the_fit_is_that_of_noise() -> None:
    """Whitened residuals of the motion's lines and between: mean square 1; 60 times 3000 rows err by 0.3 %; 3 % are
    left for the curve through 1000 samples' spectrum."""
    squares = [float((f.noise[0].whitener.series(f.residuals[0]) ** 2).mean()) for f in realisations("white", 4)]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.04)


# ------------------------------------------------------------------------------- several recordings


def test_each_recording_has_its_own_bias_and_all_share_the_body() -> None:
    zeros = ([0.0, 0.0, 0.0], [3.0, -2.0, 0.4], [-5.0, 1.0, -0.1])
    several = [
        recorded(Space.PLANE, seed=10 + i, motion=5 + i, zero=zero, name=f"run{i}") for i, zero in enumerate(zeros)
    ]
    estimated, truth = fit(planar(), several), truth_of(Space.PLANE)
    expected = dict(truth)
    for i, zero in enumerate(zeros):
        for channel, shift in zip(planar().channels, zero, strict=True):
            expected[f"bias_{channel}" + (f"@run{i}" if i else "")] = truth[f"bias_{channel}"] + shift
    assert estimated.values.keys() == expected.keys()
    assert max(map(abs, scores(estimated, expected).values())) < 4.5  # 1 in 1e4 for twelve
    alone = fit(planar(), several[0])
    for name in ("m", "mlg", "I"):
        assert estimated.parameters[name].std < 0.8 * alone.parameters[name].std  # about 1 / sqrt(3)


def test_order_of_the_recordings_does_not_matter() -> None:
    one, other = (recorded(Space.PLANE, seed=20 + i, motion=5 + i, name=f"run{i}") for i in range(2))
    forth, back = fit(planar(), [one, other]), fit(planar(), [other, one])
    for name in ("m", "mlg", "I"):
        # The same least-squares problem: rounding times its condition.
        assert forth.values[name] == pytest.approx(back.values[name], rel=1e-7)
    assert forth.values["bias_fx@run1"] == pytest.approx(back.values["bias_fx"], rel=1e-7)


def test_known_noise_is_used() -> None:
    recording = recorded(Space.PLANE, seed=3)
    first = fit(planar(), recording)
    again = fit(planar(), recording, noise=first.noise)
    assert again.noise is first.noise or again.noise == first.noise
    np.testing.assert_allclose(again.theta, first.theta, rtol=1e-9)  # one linear step both times


# ------------------------------------------------------------------------------------- hidden effects

PLANE, SPACE = Space.PLANE, Space.SPACE
CONTACT = simulated.ContactEvent(start=7.0, end=9.0)
LEAK = simulated.SensorCrosstalk(leaks=(("fy", "fx", 0.04), ("fx", "fy", 0.03)))
CABLE = simulated.CableSpring(k=20.0, anchor=(1.0, 0.0, 3.0), length=1.2)
SPATIAL_CABLE = simulated.CableSpring(k=20.0, anchor=(0.9, 0.5, 0.7), length=1.0)
Case = tuple[Space, Effect, simulated.HiddenEffect, dict[str, float], dict[str, float]]
CASES: list[Case] = [  # space, effect, what is hidden, its true amounts, where the search starts
    (PLANE, effects.com_offset(), simulated.CentreOfMassOffset(), {"mlx": 0.008}, {}),
    (PLANE, effects.gravity_tilt(), simulated.GravityTilt(), {"angle": 0.03}, {}),
    (PLANE, effects.sensor_rotation(), simulated.SensorRotation(), {"angle": 0.03}, {}),
    (PLANE, effects.sensor_crosstalk(), LEAK, {"fy_fx": 0.04, "fx_fy": 0.03, "tau_fx": 0.0}, {}),
    (PLANE, effects.viscous_drag(), simulated.ViscousDrag(c=0.5), {"c": 0.5, "d": 0.12}, {"c": 0.1}),
    (PLANE, effects.quadratic_drag(), simulated.QuadraticDrag(c=0.3), {"c": 0.3, "d": 0.12}, {"c": 0.1}),
    (
        PLANE,
        effects.cable_spring(),
        CABLE,
        {"k": 20.0, "anchor_x": 1.0, "anchor_y": 3.0, "length": 1.2, "d": 0.12},
        {"k": 10.0, "anchor_x": 1.1, "anchor_y": 2.9, "length": 1.1},
    ),
    (PLANE, effects.sensor_lag(), simulated.SensorLag(), {"time_constant": 0.02}, {}),
    (PLANE, effects.time_delay(), simulated.TimeDelay(), {"delay": 0.012}, {}),
    (PLANE, effects.thermal_drift(), simulated.ThermalDrift(), {"fx": 0.2, "fy": 0.2, "tau": 0.01}, {}),
    (
        PLANE,
        effects.contact_event(),
        CONTACT,
        {"start": 7.0, "end": 9.0, "fcx": 4.0, "fcy": 2.0, "tauc": 0.3},
        {"start": 6.999, "end": 9.002},  # a sample on each edge, 10 ms long; the next ones are 20 ms away
    ),
    (PLANE, effects.joint_offset(), simulated.JointOffset(offset=0.2), {"offset_2": 0.2, "offset_3": 0.0}, {}),
    (
        PLANE,
        effects.joint_elasticity(),
        simulated.JointElasticity(),
        {"compliance_1": 1e-3, "compliance_2": 1.5e-3, "compliance_3": 2e-3},
        {},
    ),
    (
        PLANE,
        effects.joint_backlash(),
        simulated.JointBacklash(width=(0.05, 0.05, 0.05)),
        {"width_1": 0.05, "width_2": 0.05},
        {},
    ),
    (PLANE, effects.link_length_error(), simulated.LinkLengthError(), {"error_1": 0.0, "error_2": 0.03}, {}),
    (PLANE, effects.coulomb_friction(), simulated.CoulombFriction(), {"level": 0.03}, {}),
    (
        PLANE,
        effects.tip_flexibility(),
        simulated.TipFlexibility(),
        {"stiffness": 50.0, "damping": 0.1},
        {"stiffness": 80.0, "damping": 0.3},
    ),
    (
        PLANE,
        effects.payload_change(),
        simulated.PayloadChange(mass=0.2, time=7.0),
        {"mass": 0.2, "d": 0.12},
        {"time": 6.998, "d": 0.1},
    ),
    (PLANE, effects.sensor_gain(), simulated.SensorGain(), {"fy": 1.03}, {}),
    (
        PLANE,
        effects.gain_nonlinearity(),
        simulated.GainNonlinearity(cubic=1e-4),
        {"fx_2": 1.5e-3, "fx_3": 1e-4, "fy_2": 1.5e-3, "tau_2": 0.0},
        {},
    ),
    (PLANE, effects.sensor_hysteresis(), simulated.SensorHysteresis(), {"fx": 0.25, "tau": 0.01}, {"fx": 0.1}),
    (
        PLANE,
        effects.line_interference(),
        simulated.LineInterference(),
        {"frequency": 17.317},
        {"frequency": 17.31},
    ),
    (SPACE, effects.coulomb_friction(), simulated.CoulombFriction(), {"level": 0.03}, {}),
    (SPACE, effects.sensor_gain(), simulated.SensorGain(), {"fy": 1.03, "tz": 1.0}, {}),
    (SPACE, effects.gravity_tilt(), simulated.GravityTilt(tilt_x=-0.02), {"tilt_x": -0.02, "tilt_y": 0.03}, {}),
    (
        SPACE,
        effects.sensor_rotation(),
        simulated.SensorRotation(roll=0.02, pitch=-0.01),
        {"roll": 0.02, "pitch": -0.01, "yaw": 0.03},
        {},
    ),
    (SPACE, effects.viscous_drag(), simulated.ViscousDrag(c=0.5), {"c": 0.5, "d": 0.12}, {"c": 0.1}),
    (SPACE, effects.quadratic_drag(), simulated.QuadraticDrag(c=0.8), {"c": 0.8, "d": 0.12}, {"c": 0.1}),
    (
        SPACE,
        effects.cable_spring(),
        SPATIAL_CABLE,
        {"k": 20.0, "anchor_x": 0.9, "anchor_y": 0.5, "anchor_z": 0.7, "length": 1.0, "d": 0.12},
        {"k": 10.0, "anchor_x": 1.0, "anchor_y": 0.4, "anchor_z": 0.8, "length": 0.9},
    ),
    (SPACE, effects.sensor_lag(), simulated.SensorLag(), {"time_constant": 0.02}, {}),
    (SPACE, effects.time_delay(), simulated.TimeDelay(), {"delay": 0.012}, {}),
]


def test_noise_floor_of_repeats_is_without_what_the_fit_explains() -> None:
    """A push in one of four repeats is in the floor of the tool alone; the std of 750 samples errs by 2.6 % of itself,
    so that 15 % are more than 5 sigma (1 in 1e6)."""
    recording, noise = recorded(PLANE, CONTACT, seed=1), np.array(SIMULATED[PLANE].noise)
    assert (fit(base(PLANE), recording).noise_floor() > 2 * noise).all()
    start = {"contact_event.start": 6.999, "contact_event.end": 9.002}
    floor = fit(base(PLANE) + effects.named("contact_event"), recording, start=start).noise_floor()
    np.testing.assert_allclose(floor, noise, rtol=0.15)


@pytest.mark.parametrize("case", CASES, ids=[f"{case[1].id}-{case[0].name}" for case in CASES])
def test_refit_returns_what_was_hidden(case: Case) -> None:
    """Within 4 std, for some 60 amounts in all 1 in 250 of another seed."""
    space, effect, hidden, amounts, near = case
    recording = recorded(space, hidden, seed=7, temperature=effect.id == "thermal_drift")
    start = {f"{effect.id}.{name}": value for name, value in near.items()}
    estimated = fit(base(space) + effect, recording, start=start)
    truth = {f"{effect.id}.{name}": value for name, value in amounts.items()}
    found = scores(estimated, truth)
    assert max(map(abs, found.values())) < 4
    assert max(map(abs, scores(estimated, truth_of(space)).values())) < 4.5  # 1 in 1e4 for 16
    assert all(np.isfinite(estimated.parameters[name].std) for name in truth)
    # What was hidden is seen, and not only covered by large std.
    assert any(estimated.parameters[n].std < 0.15 * abs(value) for n, value in truth.items())


def test_initial_value_of_no_parameter_is_refused() -> None:
    """By every estimator, with the name that was probably meant; a bias of another recording's fit is no mistake."""
    recording, white = recorded(Space.PLANE, seed=1), NoiseModel.white(np.ones(3))
    for estimate in (fit, robust_fit, partial(fit, noise=white)):
        with pytest.raises(InputError, match=r"no parameter is called 'viscous_drag\.k'.*did you mean viscous_drag\."):
            estimate(
                base(Space.PLANE) + effects.named("viscous_drag"), recording, start={"m": 1.0, "viscous_drag.k": 0.1}
            )
    values = fit(base(Space.PLANE), recording, start={"m": 1.0, "bias_fx@other.csv": 0.1}).values
    assert values == pytest.approx(fit(base(Space.PLANE), recording).values)
