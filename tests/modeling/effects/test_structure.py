"""How every effect is built: its parameters, its words, its place in a model, and where a search for it starts."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import sympy as sp

from modeling import effects
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect, SearchDomain
from modeling.chain.prediction import compiled_prediction
from modeling.effects import catalogue
from modeling.errors import InputError
from modeling.formulas.units import dimension
from modeling.parameter import Role
from modeling.space import Space
from tests.modeling.effects.cases import CASES, RIGS, Case
from tests.modeling.effects.parts import random_signals

every_case = pytest.mark.parametrize("case", CASES, ids=str)
every_effect = pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.id)


# --------------------------------------------------------------------------------------- parameters


@every_case
def test_parameters_are_named_bounded_and_have_units(case: Case) -> None:
    own, qualified = case.effect.parameters(case.space), case.effect.qualified(case.space)
    assert len({p.name for p in own}) == len(own)
    for parameter, full in zip(own, qualified, strict=True):
        assert re.fullmatch(r"[a-z]\w*", parameter.name)
        assert full == dataclasses.replace(parameter, name=f"{case.effect.id}.{parameter.name}")
        assert dimension(parameter.unit) is not None
        low, high = parameter.bounds
        assert low <= parameter.nominal <= high
        assert low < high
        assert parameter.start is None or low <= parameter.start <= high
    assert any(not p.nuisance for p in own)
    assert all(p.meaning for p in own)
    assert len({p.meaning for p in own}) == len(own)


ONSETS = ("time", "start", "end")
"""What an effect calls a time at which something begins or ends; other parameters in seconds are how long it takes."""


@every_case
def test_searched_times_and_frequencies_have_their_roles(case: Case) -> None:
    """Search, noise re-estimation and missing inputs read the role: a time called a shape would never be refined."""
    for parameter in case.effect.parameters(case.space):
        if parameter.nuisance:
            expected = Role.FREQUENCY if parameter.unit == "Hz" else Role.SHAPE
            assert parameter.role is (Role.ONSET if parameter.name in ONSETS else expected)
        assert case.effect.has_role(parameter.role, case.space)


@every_case
def test_base_parameters_stay_first_and_in_order(case: Case) -> None:
    (effect,) = case.model.effects
    assert case.model.parameters == case.plain.parameters + effect.qualified(case.space)
    assert case.model.base_size == len(case.plain.parameters)
    assert case.model.base == case.model.without(case.effect.id) == case.plain


@every_case
def test_every_parameter_matters(case: Case) -> None:
    chain = case.model.chain
    vectors = [vector for stage in chain.dynamics for vector in stage.vectors().values()]
    parts = (case.model.load, chain.equilibrium(), chain.transfer_function, *vectors)
    found = set().union(*(part.free_symbols for part in parts))
    for _, step in case.model.definitions:
        found |= step.free_symbols
    assert {p.symbol for p in case.own} <= found


@pytest.mark.parametrize("case", [c for c in CASES if any(p.nuisance for p in c.own) and c.model.direct], ids=str)
def test_at_nominal_amplitudes_nuisance_parameters_drop_out(case: Case) -> None:
    """Symbolic, so that no value of theirs can matter, where load and zero are all that there is to look at."""
    nominal = {p.symbol: sp.Float(p.nominal) if p.nominal else 0 for p in case.own if not p.nuisance}
    for ours, theirs in ((case.model.load, case.plain.load), (case.model.bias, case.plain.bias)):
        left = ours.subs(nominal)
        assert left == theirs or sp.expand(left - theirs) == sp.zeros(*theirs.shape)


def test_joint_effects_have_a_parameter_for_each_joint_in_its_unit() -> None:
    model = Case(Space.SPACE, effects.joint_elasticity()).model
    units = [p.unit for p in model.parameters[model.base_size :]]
    assert units == ["m/N", "rad/(N m)", "rad/(N m)"]
    with pytest.raises(InputError, match="needs the arm"):
        _ = (dataclasses.replace(model.base, arm=None) + effects.joint_elasticity()).load


# --------------------------------------------------------------------------------------------- words

SIGNS = re.compile(
    r"positive|negative|clockwise|right-handed|towards|against|adds|longer|while the load rises"
    r"|\+=|[=(] ?1 ?[/(+]|sum_k|b_i \(|-stiffness"
)
"""Words and formulas that say which way an effect acts."""


@every_effect
def test_effect_says_what_it_is(effect: Effect) -> None:
    """Title, advice, an equation with two sides, and a docstring with signs and with the parameters' units.

    And what the manual shows of it: a sketch, how it is seen and provoked, in sentences.
    """
    assert effect.title
    assert effect.sketch
    assert min(map(len, (effect.advice, effect.shows, effect.provoked_by))) > 20
    assert effect.shows.endswith(".")
    assert effect.provoked_by.endswith(".")
    assert bool(effect.disturbance) is effect.per_recording
    assert re.search(r"\S+ *(=|->) *\S+", effect.equation)
    text = f"{type(effect).__doc__} {type(effect).parameters.__doc__}"
    space = effect.spaces[0]
    for unit in {p.unit for p in effect.parameters(space)}:
        stated = re.search(rf"(?<![\w/]){re.escape(unit)}(?!\w)", text)
        assert stated or re.search(r"in units of|channel's unit|in its unit|gains", text), f"{unit} in {text}"
    assert re.search(SIGNS, f"{type(effect).__doc__} {effect.equation}")
    assert isinstance(effect.stage, Stage)


# -------------------------------------------------------------------------------------------- values


@every_effect
def test_effects_are_values(effect: Effect) -> None:
    twin = type(effect)()
    assert effect == twin
    assert hash(effect) == hash(twin)
    assert [other for other in catalogue() if other == effect] == [effect]
    with pytest.raises(dataclasses.FrozenInstanceError):
        effect.title = "other"  # type: ignore[misc]


def test_effects_with_other_settings_are_others() -> None:
    assert effects.bias_drift(2) != effects.bias_drift(3)
    assert len(effects.bias_drift(2).parameters(Space.PLANE)) == 6


@every_case
def test_an_effect_is_added_once_and_where_it_exists(case: Case) -> None:
    with pytest.raises(InputError, match="already"):
        case.model.__add__(type(case.effect)())
    for other in set(Space) - set(case.effect.spaces):
        with pytest.raises(InputError, match="is not defined for"):
            Case(other, case.effect).plain.__add__(case.effect)


def test_order_of_adding_moves_the_parameters_and_not_the_prediction() -> None:
    """All that is neither a bend nor a joint's, whose steps would make of a minute what takes a second."""
    cases = [
        c for c in CASES if c.space is Space.PLANE and not c.effect.needs_joints and c.model.chain.deflection is None
    ]
    several, rng = tuple(case.effect for case in cases), np.random.default_rng(0)
    forth, back = (cases[0].plain + each for each in (several, several[::-1]))
    signals = random_signals(cases[0], forth.inputs, 8, rng)
    values = {p.name: float(rng.normal(0, 0.3)) for p in forth.parameters}
    results = []
    for model in (forth, back):
        theta = np.array([values[p.name] for p in model.parameters])
        parts = (
            compiled_prediction(model).load,
            compiled_prediction(model).bias,
            compiled_prediction(model).play,
            compiled_prediction(model).saturation,
        )
        results.append([part.value(signals, theta, 8) for part in parts if part is not None])
    assert [p.name for p in forth.parameters] != [p.name for p in back.parameters]
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)  # rounding of sums in another order
    assert sp.simplify(forth.transfer_function - back.transfer_function) == 0


@pytest.mark.parametrize("case", [c for c in CASES if c.space is Space.PLANE], ids=str)
def test_slopes_of_the_amplitudes_are_columns_of_the_tangent(case: Case) -> None:
    rng, samples = np.random.default_rng(3), 20
    sets = case.theta * rng.uniform(0.8, 1.2, (3, len(case.theta)))
    amplitudes = tuple(i for i, p in enumerate(case.own, start=case.model.base_size) if not p.nuisance)
    for emitted in (compiled_prediction(case.model).load, compiled_prediction(case.model).bias):
        signals = random_signals(case, emitted.inputs, samples, rng)
        if case.model.chain.deflection is not None:
            continue
        slopes = emitted.jacobians(signals, sets, amplitudes, samples)
        assert slopes.shape == (samples, len(case.space.channels), len(sets), len(amplitudes))
        for g, theta in enumerate(sets):
            columns = emitted.tangent(signals, theta, samples)[1][:, :, list(amplitudes)]
            # The same derivative through another graph: rounding.
            np.testing.assert_allclose(slopes[:, :, g], columns, rtol=1e-12, atol=1e-12 * np.abs(columns).max())


# ------------------------------------------------------------------------------------------- searches

SWING = {Space.PLANE: (8.0, 6.0, 0.4), Space.SPACE: (8.0, 6.0, 9.0, 0.4, 0.3, 0.2)}
BOX = {Space.PLANE: ((-0.5, 0.8), (0.7, 1.9)), Space.SPACE: ((-0.5, 0.8, 0.1), (0.7, 1.9, 0.6))}


def extent_of(space: Space) -> SearchDomain:
    low, high = BOX[space]
    return SearchDomain(
        low=low,
        high=high,
        start=0.0,
        end=40.0,
        reach=0.3,
        events=((3.0, 4.5),),
        tones=(17.3,),
        largest=SWING[space],
        swing=SWING[space],
        inertia=0.012,
    )


@every_case
def test_search_starts_within_bounds_and_names_every_nuisance(case: Case) -> None:
    """What else it names are amplitudes, the same ones in every start. A point is searched on the tip axis."""
    searched = [p for p in case.effect.restricted(case.space).parameters(case.space) if not p.fixed]
    bounds = {p.name: p.bounds for p in searched}
    nuisance = {p.name for p in searched if p.nuisance}
    grid = case.effect.nuisance_grid(extent_of(case.space))
    assert grid
    for values in grid:
        assert nuisance <= values.keys() == grid[0].keys() <= bounds.keys()
        assert all(bounds[name][0] <= value <= bounds[name][1] for name, value in values.items())


def test_search_for_a_push_starts_with_what_was_noticed() -> None:
    assert effects.contact_event().nuisance_grid(extent_of(Space.PLANE))[0] == {"start": 3.0, "end": 4.5}


@pytest.mark.parametrize("effect_id", ["cable_spring", "line_interference", "saturation", "sensor_hysteresis"])
def test_search_without_anything_to_go_by_has_no_start(effect_id: str) -> None:
    assert effects.named(effect_id).nuisance_grid(SearchDomain()) == ()


def test_rigs_of_the_cases_are_described_as_they_are() -> None:
    assert {space: rig.arm.joints for space, rig in RIGS.items() if rig.arm is not None} == {
        Space.PLANE: 3,
        Space.SPACE: 3,
    }
