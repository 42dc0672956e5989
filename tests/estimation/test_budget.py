"""Budget of uncertainty: shifts by planted errors of the simulated rig, the guide's example, check by Monte Carlo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import pi
from typing import Any

import numpy as np
import pytest

import truewrench as tw
from estimation.budget import Budget, budget
from estimation.budget_table import BudgetLine, Contribution, tolerance_of
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.space import Space
from tests.shared.recordings import SAMPLES, base, recording_of
from tests.shared.rigs import RIG, SIMULATED, described
from truewrench import simulated_rig as hidden
from truewrench.files.model_file import ModelFile

pytest.importorskip("mujoco")


def stated(quantity: str, std: float, unit: str, **more: Any) -> dict[str, Any]:
    return {"name": quantity, "quantity": quantity, "std": std, "unit": unit, **more}


@cache
def recorded(space: Space, motion: int, effects: tuple[Any, ...] = (), gravity: float = 9.806) -> Recording:
    """With noise that does not depend on what is hidden."""
    rig = replace(SIMULATED[space], gravity=gravity)
    moved = rig.random_motion(seed=motion)
    frame = hidden.simulate(rig, moved, hidden=effects, repeats=3, samples_per_period=SAMPLES, seed=motion)
    return recording_of(frame, without=("temperature",), rig=described(rig))


def fitted(space: Space, effects: tuple[Any, ...] = (), gravity: float = 9.806) -> Fit:
    model = tw.planar(RIG) if space is Space.PLANE else base(space)
    return tw.fit(model, recorded(space, 1, effects, gravity))


PLANTED: dict[str, tuple[Space, str, float, str, tuple[Any, ...]]] = {
    "gravity": (Space.SPACE, "gravity", 0.03, "m/s²", ()),
    "mounting": (Space.SPACE, "sensor_rotation.roll", 4.0, "mrad", (hidden.SensorRotation(roll=0.004, yaw=0.0),)),
    "clock": (Space.SPACE, "time_delay", 2.0, "ms", (hidden.TimeDelay(delay=0.002),)),
    "tilt": (Space.PLANE, "gravity_tilt", 0.2, "deg", (hidden.GravityTilt(tilt_y=0.2 * pi / 180),)),
    "encoder": (Space.PLANE, "joint_offset.offset_2", 3.0, "mrad", (hidden.JointOffset(joint=2, offset=0.003),)),
    "link": (Space.PLANE, "link_length_error.error_1", 5.0, "mm", (hidden.LinkLengthError(link=1, error=0.005),)),
    "matrix": (Space.PLANE, "sensor_crosstalk.fy_fx", 1.0, "%", (hidden.SensorCrosstalk(leaks=(("fy", "fx", 0.01),)),)),
}
"""Space, quantity and size in a unit, and the same in the simulator, which shares no equation with the model."""


@pytest.mark.parametrize("name", PLANTED)
def test_estimates_and_contact_move_by_what_is_propagated(name: str) -> None:
    """The same noise in both: the differences are the contribution alone, to the second order of its size."""
    space, quantity, size, unit, effects = PLANTED[name]
    gravity = 9.836 if name == "gravity" else 9.806
    plain, moved = fitted(space), fitted(space, effects, gravity)
    result = budget(plain, {"contribution": [stated(quantity, size, unit)]})
    (source,) = result.sources
    change, std = moved.theta - plain.theta, np.sqrt(np.diag(plain.covariance))
    np.testing.assert_allclose(
        source.std * source.shifts[0] / std, change / std, atol=0.02 * np.abs(change / std).max()
    )
    # In use the quantity is as wrong as it was in the fit.
    other, wrong = recorded(space, 2), recorded(space, 2, effects, gravity)
    contact = tw.compensate(result.calibration, other, keep_zero=True)
    error = tw.compensate(moved, wrong, keep_zero=True).wrench - tw.compensate(plain, other, keep_zero=True).wrench
    predicted = np.sqrt(contact.contributions[quantity])
    np.testing.assert_allclose(predicted, np.abs(error), atol=0.05 * np.abs(error).max())


def test_a_dominating_contribution_is_named_and_covered() -> None:
    """Gravity is off by 0.05 m/s² in truth: the noise alone excludes the true mass, the budget has it."""
    fit = fitted(Space.SPACE, gravity=9.856)
    entries = [stated("gravity", 0.03, "m/s²"), stated("time_delay", 0.2, "ms"), stated("gravity_tilt", 0.5, "mrad")]
    line = budget(fit, {"contribution": entries})["m"]
    mass = SIMULATED[Space.SPACE].mass
    assert line.interval is not None
    assert abs(fit["m"].value - mass) > 5 * fit["m"].std
    assert line.interval[0] < mass < line.interval[1]
    assert line.largest == "gravity"
    assert line.share > 0.9
    assert line.halving_ratio is not None
    halved = budget(fit, {"contribution": [stated("gravity", 0.03 * line.halving_ratio, "m/s²"), *entries[1:]]})["m"]
    assert halved.std == pytest.approx(line.std / 2)


SIX_AXES = [
    stated("gravity", 0.01, "m/s²"),
    stated("sensor_rotation", 0.2, "deg"),
    {"name": "sheet", "quantity": "gain", "half_width": 0.5, "unit": "%"},
    stated("sensor_crosstalk", 0.3, "%"),
    stated("time_delay", 1, "ms"),
    stated("zero_drift", 0.05, "N"),
]


def test_law_of_propagation_and_monte_carlo_agree_in_six_axes() -> None:
    result = budget(fitted(Space.SPACE), {"contribution": SIX_AXES}, monte_carlo=60)
    assert result.remarks()[0].startswith("Monte Carlo and law of propagation agree for every parameter")
    for line in result.lines:
        assert line.interval is not None
        assert line.check is not None
        assert np.abs(np.subtract(line.check.ends, line.interval)).max() <= tolerance_of(line.std, 1)


def test_where_one_uniform_quantity_is_all_its_interval_is_shorter() -> None:
    """95 % of a uniform quantity are within 0.95 root 3 std, of a normal one within 1.96."""
    entry = {"name": "g", "quantity": "gravity", "half_width": 0.5, "unit": "m/s²"}
    result = budget(fitted(Space.PLANE), {"digits": 2, "contribution": [entry]}, monte_carlo=50)
    line = result["m"]
    assert line.check is not None
    assert np.ptp(line.check.ends) / 2 == pytest.approx(0.95 * 3**0.5 * line.std, rel=0.02)
    assert line.agrees is False
    assert "gives another interval than Monte Carlo for" in result.remarks()[0]


def test_the_guides_example_of_end_gauges() -> None:
    """JCGM 100:2008, H.1.6: 32 nm with 16 degrees of freedom, and 93 nm at 99 %."""
    parts = {"calibration": 25.0, "difference": 9.7, "expansion": 2.9, "temperature": 16.6}
    freedom = {"calibration": 18.0, "difference": 25.6, "expansion": 50.0, "temperature": 2.0}
    line = BudgetLine("length", 50.000838e6, "nm", parts, freedom, 0.99)
    assert line.std == pytest.approx(31.7, abs=0.05)
    assert int(line.effective_freedom) == 16
    assert line.factor * line.std == pytest.approx(93, abs=1.5)


def test_a_common_gain_is_in_the_mass_but_not_in_the_load() -> None:
    """What is left of it in a contact is its share of that contact, here of its noise."""
    result = budget(fitted(Space.SPACE), {"contribution": [stated("common_gain", 1, "%")]})
    contact = tw.compensate(result.calibration, recorded(Space.SPACE, 2), keep_zero=True)
    mass = result["m"]
    assert mass.value is not None
    assert mass.parts["common_gain"] == pytest.approx(0.01 * mass.value, rel=1e-6)
    np.testing.assert_allclose(np.sqrt(contact.contributions["common_gain"]), 0.01 * np.abs(contact.wrench), atol=1e-4)


def test_what_is_another_one_in_each_recording_adds_in_squares() -> None:
    recordings = [replace(recorded(Space.PLANE, motion), name=f"run {motion}") for motion in (1, 2)]
    fit = tw.fit(tw.planar(RIG), recordings)
    same, each = (
        budget(fit, {"contribution": [stated("zero_drift.fx", 0.2, "N", each_recording=each)]})
        for each in (False, True)
    )
    assert same.sources[0].shifts.shape[0] == 1
    np.testing.assert_allclose(each.sources[0].shifts.sum(axis=0), same.sources[0].shifts[0])
    assert each["m"].std != pytest.approx(same["m"].std)
    other = recorded(Space.PLANE, 3)
    with_use = tw.compensate(each.calibration, other).contributions["zero_drift.fx"]
    at_ends = np.sqrt(with_use[[0, -1], 0])  # of a line through zero in the middle: half of the drift at either end
    np.testing.assert_allclose(at_ends, 0.1, rtol=0.1)


def test_a_mass_that_a_bound_fixes_has_the_std_of_its_balance() -> None:
    entries = [stated("m", 1, "g"), stated("gravity", 0.01, "m/s²")]
    fit = tw.fit(tw.planar(RIG), recorded(Space.PLANE, 1), constraints={"m": 0.9})
    result = budget(fit, {"contribution": entries}, monte_carlo=50)
    line = result["m"]
    assert line.std == pytest.approx(0.001)
    assert line.value == 0.9
    assert result["mlg"].parts["m"] > 0
    with pytest.raises(InputError, match="the fit estimates m"):
        budget(fitted(Space.PLANE), {"contribution": entries})


def result_of(fit: Fit) -> Budget:
    return budget(fit, {"contribution": [*SIX_AXES[1:], SIX_AXES[0] | {"freedom": 8.0}]})


def test_a_model_file_keeps_it() -> None:
    fit, other = fitted(Space.SPACE), recorded(Space.SPACE, 2)
    result = result_of(fit)
    saved = ModelFile.of(fit, budget=result)
    again = ModelFile.from_text(saved.to_text())
    assert again.budget is not None
    assert again.to_data() == saved.to_data()
    assert str(again.budget) == str(result)
    np.testing.assert_array_equal(again.covariance, saved.covariance)
    ours, theirs = (tw.compensate(one.calibration, other) for one in (result, again.budget))
    np.testing.assert_allclose(theirs.std, ours.std)
    assert str(again.budget.of_contact(theirs)) == str(result.of_contact(ours))
    total = result.of_contact(ours)["fcx, one row"].std
    assert total == pytest.approx(np.sqrt((ours.std[:, 0] ** 2).mean()))
    with pytest.raises(InputError, match="without a budget"):
        result.of_contact(tw.compensate(fit, other))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda data: data["sources"][0].update(std=1e300), "budget.sources[0].std"),
        (lambda data: data["sources"][0]["shifts"][0].pop(), "expected 6 numbers a row"),
        (lambda data: data["sources"][0].update(parameter="gravity.size"), "no contribution or parameter is called"),
        (lambda data: data["contributions"][0].update(name="noise"), "a name is used twice"),
        (lambda data: data["effects"][0].update(id="gremlins"), "no effect is called 'gremlins'"),
        (lambda data: data["parameters"].reverse(), ""),
    ],
)
def test_a_damaged_budget_in_a_model_file_is_one_line(damage: Callable[[Any], None], said: str) -> None:
    fit = fitted(Space.PLANE)
    data = ModelFile.of(fit, budget=budget(fit, {"contribution": [stated("gravity", 0.01, "m/s²")]})).to_data()
    damage(data["budget"])
    if not said:  # in another order, they are read by their names
        data["budget"]["freedom"].reverse()
        data["budget"]["sources"][0]["shifts"][0].reverse()
        assert ModelFile.from_data(data).budget is not None
        return
    with pytest.raises(InputError) as refused:
        ModelFile.from_data(data)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({}, "contribution: missing"),
    "no std": ({"contribution": [{"name": "g", "quantity": "gravity", "unit": "m/s²"}]}, "one of std and half_width"),
    "both": ({"contribution": [stated("gravity", 1, "m/s²", half_width=1)]}, "one of std and half_width"),
    "negative": ({"contribution": [stated("gravity", -1, "m/s²")]}, "greater than or equal"),
    "unit": ({"contribution": [stated("gravity", 1, "deg")]}, "the unit of gravity is not 'deg'; use m/s²"),
    "no unit": ({"contribution": [{"name": "g", "quantity": "gravity", "std": 1}]}, "contribution[0].unit: missing"),
    "twice": ({"contribution": [stated("gravity", 1, "m/s²")] * 2}, "the name is used twice"),
    "noise": ({"contribution": [stated("gravity", 1, "m/s²", name="noise")]}, "the name is that of a scatter"),
    "id": ({"contribution": [stated("gravty", 1, "m/s²")]}, "no effect is called 'gravty'"),
    "dot": ({"contribution": [stated("gravity.", 1, "m/s²")]}, "gravity has no parameter ''"),
    "parameter": ({"contribution": [stated("gravity.size", 1, "m/s²")]}, "gravity has no parameter 'size'"),
    "one run": ({"contribution": [stated("bias_drift", 1, "N")]}, "is of one recording alone; state zero_drift"),
    "open": ({"contribution": [stated("viscous_drag", 1, "N s/m")]}, "no derivative where it vanishes"),
    "one side": ({"contribution": [stated("sensor_lag", 1, "ms")]}, "is on one side of 0 alone"),
    "infinite": ({"contribution": [stated("tip_flexibility.stiffness", 1, "N m/rad")]}, "no derivative"),
    "space": ({"contribution": [stated("com_offset", 1, "kg m")]}, "not defined for 6 channels"),
    "input": ({"contribution": [stated("thermal_drift", 1, "N/K")]}, "thermal_drift needs temperature"),
    "joints": ({"contribution": [stated("joint_offset", 1, "rad")]}, "joint_offset needs q1"),
    "estimated": ({"contribution": [stated("bias_fx", 1, "N")]}, "the fit estimates bias_fx"),
    "coverage": ({"coverage": 95, "contribution": [stated("gravity", 1, "m/s²")]}, "coverage"),
    "key": ({"contribution": [stated("gravity", 1, "m/s²", size=1)]}, "no such key"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_a_contribution_is_said_in_one_line(name: str) -> None:
    data, fragment = WRONG[name]
    with pytest.raises(InputError) as refused:
        budget(fitted(Space.SPACE), data)
    assert fragment in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_no_refit_can_check_is_refused() -> None:
    push, entries = hidden.ContactEvent(start=6.0, end=8.0), {"contribution": [stated("gravity", 0.02, "m/s²")]}
    start = {"contact_event.start": 6.0, "contact_event.end": 8.0}
    fit = tw.fit(tw.planar(RIG) + "contact_event", recorded(Space.PLANE, 1, (push,)), start=start)
    assert budget(fit, entries)["m"].interval is not None
    with pytest.raises(InputError, match=r"contact_event.start is the time of an event"):
        budget(fit, entries, monte_carlo=50)
    with pytest.raises(InputError, match="'5' is no number of refits"):
        budget(fit, entries, monte_carlo=5)


def test_an_effect_that_the_model_has_is_estimated() -> None:
    fit = tw.fit(tw.planar(RIG) + "gravity_tilt", recorded(Space.PLANE, 1))
    with pytest.raises(InputError, match="the model has gravity_tilt, and estimates it"):
        budget(fit, {"contribution": [stated("gravity_tilt", 1, "deg")]})


def test_tolerances_are_half_of_the_last_digit() -> None:
    """JCGM 101:2008, 7.9.2.1, example 1: 0.35 g to two digits, 0.005 g; the ninth tenth rounds up."""
    assert tolerance_of(0.35, 2) == pytest.approx(0.005)
    assert tolerance_of(0.35, 1) == pytest.approx(0.05)
    assert tolerance_of(0.0996, 2) == pytest.approx(0.005)


def test_halving_says_so_where_one_contribution_cannot() -> None:
    line = BudgetLine("m", 1.0, "kg", {"noise": 1.0, "gain": 1.1}, {"noise": 10.0}, 0.95)
    assert line.halving_ratio is None
    assert line.remedy({"gain": Contribution("gain", "gain", 1.0, "%")}).startswith("not gain alone: without it 67% of")


@pytest.mark.long
def test_intervals_cover_where_the_contributions_are_drawn() -> None:
    """In 40 rigs with gravity and mounting drawn: 32 or fewer of 40 at 95 % have a chance of 0.3 %, of each parameter.

    All of them from the simulator; noise, gravity and mounting anew in each.
    """
    rng = np.random.default_rng(5)
    entries = [stated("gravity", 0.05, "m/s²"), stated("sensor_rotation", 0.2, "deg")]
    rig, inside = SIMULATED[Space.PLANE], np.zeros(3, dtype=int)
    assert isinstance(rig, hidden.PlanarRig)
    for seed in range(40):
        turned = (hidden.SensorRotation(yaw=0.2 * pi / 180 * rng.standard_normal()),)
        placed = replace(rig, gravity=9.806 + 0.05 * rng.standard_normal())
        frame = hidden.simulate(
            placed, rig.random_motion(seed=1), hidden=turned, repeats=3, samples_per_period=100, seed=seed
        )
        result = budget(tw.fit(tw.planar(RIG), recording_of(frame, rig=RIG)), {"contribution": entries})
        for place, (name, true) in enumerate({"m": rig.mass, "mlg": rig.mlg, "bias_fx": rig.bias[0]}.items()):
            low, high = result[name].interval or (0.0, 0.0)
            inside[place] += low < true < high
    assert inside.min() > 32
