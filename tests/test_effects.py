"""What every effect of the catalogue keeps, in both spaces, and what each says of the same physics as MuJoCo."""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Mapping

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from estimation.reading import from_columns
from estimation.recording import Recording
from estimation.response import predicted
from modeling import effects
from modeling.chain import Stage
from modeling.effect import Effect, Extent
from modeling.effects import CATALOGUE, catalogue, named
from modeling.errors import InputError
from modeling.model import WrenchModel, planar, spatial
from modeling.prediction import compiled
from modeling.rig import Rig
from modeling.space import Space
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

CASES = [(space, effect) for space in Space for effect in catalogue(space)]
every_case = pytest.mark.parametrize(("space", "effect"), CASES, ids=[f"{e.id}-{s.name}" for s, e in CASES])
every_effect = pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.id)

AGREED: Mapping[str, Mapping[str, str]] = {
    "com_offset": {"mlx": "kg m"},
    "gravity_tilt": {"angle": "rad"},
    "joint_offset": {"offset_1": "rad"},
    "joint_elasticity": {"compliance_1": "rad/(N m)"},
    "joint_backlash": {"width_1": "rad"},
    "link_length_error": {"error_1": "m"},
    "sensor_rotation": {"angle": "rad"},
    "viscous_drag": {"c": "N s/m", "d": "m"},
    "quadratic_drag": {"c": "N s²/m²", "d": "m"},
    "coulomb_friction": {"level": "N m"},
    "cable_spring": {"k": "N/m", "anchor_x": "m", "anchor_y": "m", "length": "m", "d": "m"},
    "tip_flexibility": {"stiffness": "N m/rad", "damping": "N m s/rad"},
    "payload_change": {"mass": "kg", "d": "m", "time": "s"},
    "contact_event": {"start": "s", "end": "s", "fcx": "N", "fcy": "N", "tauc": "N m"},
    "sensor_gain": {},
    "sensor_crosstalk": {"fx_fy": "1", "tau_fx": "m", "fx_tau": "1/m"},
    "gain_nonlinearity": {},
    "sensor_hysteresis": {"fx": "N", "tau": "N m"},
    "sensor_lag": {"time_constant": "s"},
    "time_delay": {"delay": "s"},
    "saturation": {"fx": "N", "tau": "N m"},
    "bias_drift": {"fx_1": "N", "tau_1": "N m"},
    "thermal_drift": {"fx": "N/K", "tau": "N m/K"},
    "line_interference": {"frequency": "Hz"},
}
"""The ids of FORMATS.md, with the planar parameters and units that it names (one of each kind)."""


def base(space: Space) -> WrenchModel:
    return planar() if space is Space.PLANE else spatial()


# -------------------------------------------------------------------------------------- conformance


def test_catalogue_has_every_effect_there_is() -> None:
    def descendants(kind: type[object]) -> set[type[object]]:
        return {kind}.union(*(descendants(child) for child in kind.__subclasses__()))

    ours = {kind for kind in descendants(Effect) if kind.__module__.startswith("modeling.effects.")}
    assert ours == set(CATALOGUE)
    assert len({kind.id for kind in CATALOGUE}) == len(CATALOGUE)


@every_effect
def test_id_is_agreed_and_finds_the_effect(effect: Effect) -> None:
    assert effect.id in AGREED
    assert named(effect.id) == effect
    assert getattr(effects, effect.id)() == effect


def test_unknown_id_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="viscous_drag"):
        named("gremlins")


@every_effect
def test_parameters_are_those_agreed(effect: Effect) -> None:
    units = {p.name: p.unit for p in effect.parameters(Space.PLANE)}
    agreed = AGREED[effect.id]
    assert agreed.items() <= units.items()
    if effect.id not in ("sensor_crosstalk", "bias_drift", "thermal_drift"):  # one of each kind only, above
        assert agreed.keys() == units.keys()


@every_effect
def test_all_but_the_planar_ones_exist_in_both_spaces(effect: Effect) -> None:
    planar_only = {"com_offset", "joint_offset", "joint_elasticity", "joint_backlash", "link_length_error"}
    assert effect.spaces == ((Space.PLANE,) if effect.id in planar_only else tuple(Space))


@every_case
def test_parameters_are_named_bounded_and_have_units(space: Space, effect: Effect) -> None:
    own, qualified = effect.parameters(space), effect.qualified(space)
    assert own
    assert len({p.name for p in own}) == len(own)
    for parameter, full in zip(own, qualified, strict=True):
        assert re.fullmatch(r"[a-z]\w*", parameter.name)
        assert full == dataclasses.replace(parameter, name=f"{effect.id}.{parameter.name}")
        assert parameter.unit
        assert dimension(parameter.unit) is not None
        low, high = parameter.bounds
        assert low <= parameter.nominal <= high
        assert low < high
    assert any(not p.nuisance for p in own)


@every_case
def test_base_parameters_stay_first_and_in_order(space: Space, effect: Effect) -> None:
    plain, model = base(space), base(space) + effect
    assert model.parameters == plain.parameters + effect.qualified(space)
    assert model.base_size == len(plain.parameters)
    assert model.base == model.without(effect.id) == plain


@every_case
def test_nothing_changes_at_nominal_amplitudes_whatever_the_nuisance(space: Space, effect: Effect) -> None:
    """Symbolic: the nuisance parameters drop out, so that no value of theirs can matter."""
    plain, model = base(space), base(space) + effect
    nominal = {p.symbol: sp.Float(p.nominal) if p.nominal else 0 for p in effect.qualified(space) if not p.nuisance}
    for ours, theirs in ((model.load, plain.load), (model.zero, plain.zero)):
        left = ours.subs(nominal)
        assert left == theirs or sp.expand(left - theirs) == sp.zeros(*theirs.shape)
    assert model.memory.subs(nominal) == 1


@every_case
def test_every_parameter_matters(space: Space, effect: Effect) -> None:
    model = base(space) + effect
    found = model.load.free_symbols | model.zero.free_symbols | model.memory.free_symbols
    assert {p.symbol for p in effect.qualified(space)} <= found


@every_effect
def test_effect_says_what_it_is(effect: Effect) -> None:
    """Title, advice, an equation with two sides, and a docstring with signs and with the parameters' units."""
    assert effect.title
    assert len(effect.advice) > 20
    assert re.search(r"\S+ *(=|->) *\S+", effect.equation)
    text = f"{type(effect).__doc__} {type(effect).parameters.__doc__}"
    space = effect.spaces[0]
    for unit in {p.unit for p in effect.parameters(space)}:
        stated = re.search(rf"(?<![\w/]){re.escape(unit)}(?!\w)", text)
        assert stated or re.search(r"in units of|channel's unit|gains", text), f"{unit} in {text}"
    signs = r"positive|negative|clockwise|right-handed|towards|against|adds|\+=|[=(] ?1 ?[/(+]|sum_k|b_i \("
    assert re.search(signs, f"{type(effect).__doc__} {effect.equation}")
    assert isinstance(effect.stage, Stage)


@every_effect
def test_effects_are_values(effect: Effect) -> None:
    twin = type(effect)()
    assert effect == twin
    assert hash(effect) == hash(twin)
    assert len({effect, twin}) == 1
    assert [other for other in catalogue() if other == effect] == [effect]
    with pytest.raises(dataclasses.FrozenInstanceError):
        effect.title = "other"  # type: ignore[misc]


@every_case
def test_effect_and_model_travel_as_their_fields_alone(space: Space, effect: Effect) -> None:
    """What a pool sends is what was written down: nothing that was derived on the way sticks to an effect."""
    model = base(space) + effect
    assert compiled(model).load.active
    assert vars(effect) == {f.name: getattr(effect, f.name) for f in dataclasses.fields(effect)}
    assert copy.deepcopy(effect) == effect
    fresh = WrenchModel(space=space, convention=model.convention, effects=(copy.deepcopy(effect),))
    assert fresh == model
    assert hash(fresh) == hash(model)
    assert compiled(fresh) is compiled(model)


def test_effects_with_other_settings_are_others() -> None:
    assert effects.bias_drift(2) != effects.bias_drift(3)
    assert len(effects.bias_drift(2).parameters(Space.PLANE)) == 6


@every_case
def test_an_effect_is_added_once_and_where_it_exists(space: Space, effect: Effect) -> None:
    with pytest.raises(InputError, match="already"):
        (base(space) + effect).__add__(type(effect)())
    for other in set(Space) - set(effect.spaces):
        with pytest.raises(InputError, match="does not exist"):
            base(other).__add__(effect)


@pytest.mark.parametrize("space", list(Space))
def test_order_of_adding_moves_the_parameters_and_not_the_prediction(space: Space) -> None:
    rng, several = np.random.default_rng(0), catalogue(space)
    forth, back = base(space) + several, base(space) + several[::-1]
    signals = random_signals(forth, 8, rng)
    values = {p.name: float(rng.normal(0, 0.3)) for p in forth.parameters}
    results = []
    for model in (forth, back):
        theta = np.array([values[p.name] for p in model.parameters])
        prediction = compiled(model)
        results.append((prediction.load.value(signals, theta, 8), prediction.zero.value(signals, theta, 8)))
    assert [p.name for p in forth.parameters] != [p.name for p in back.parameters]
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)  # rounding of sums in another order
    assert sp.simplify(forth.memory - back.memory) == 0


EXTENTS = {
    Space.PLANE: Extent(low=(-0.5, 0.8), high=(0.7, 1.9), start=0.0, end=40.0, reach=0.3, events=((3.0, 4.5),)),
    Space.SPACE: Extent(low=(-0.5, 0.8, 0.1), high=(0.7, 1.9, 0.6), start=0.0, end=40.0, reach=0.3),
}


@every_case
def test_search_starts_within_bounds_and_names_every_nuisance(space: Space, effect: Effect) -> None:
    nuisance = {p.name: p.bounds for p in effect.parameters(space) if p.nuisance}
    grid = effect.nuisance_grid(EXTENTS[space])
    assert grid
    for values in grid:
        assert values.keys() == nuisance.keys()
        assert all(nuisance[name][0] <= value <= nuisance[name][1] for name, value in values.items())


def test_search_for_a_push_starts_with_what_was_noticed() -> None:
    assert effects.contact_event().nuisance_grid(EXTENTS[Space.PLANE])[0] == {"start": 3.0, "end": 4.5}


def test_search_for_an_anchor_needs_positions() -> None:
    assert effects.cable_spring().nuisance_grid(Extent()) == ()


# ------------------------------------------------------------------------------------------- slopes


def random_signals(model: WrenchModel, samples: int, rng: np.random.Generator) -> dict[str, Array]:
    found = {name: rng.normal(0, 2, samples) for name in model.inputs}
    turn = rng.normal(size=(4, samples))
    found |= dict(zip(("qx", "qy", "qz", "qw"), turn / np.linalg.norm(turn, axis=0), strict=True))
    return found | {"time": rng.uniform(0, 10, samples), "progress": rng.uniform(-1, 1, samples)}


@every_case
def test_slopes_of_the_amplitudes_are_columns_of_the_tangent(space: Space, effect: Effect) -> None:
    rng, model, samples = np.random.default_rng(3), base(space) + effect, 20
    signals = random_signals(model, samples, rng)
    sets = np.abs(rng.normal(0.5, 0.2, (3, len(model.parameters))))
    amplitudes = tuple(i for i, p in enumerate(model.parameters) if i >= model.base_size and not p.nuisance)
    for emitted in (compiled(model).load, compiled(model).zero):
        slopes = emitted.slopes(signals, sets, amplitudes, samples)
        assert slopes.shape == (samples, len(model.channels), len(sets), len(amplitudes))
        for g, theta in enumerate(sets):
            columns = emitted.tangent(signals, theta, samples)[1][:, :, list(amplitudes)]
            # The same derivative through another graph: rounding.
            np.testing.assert_allclose(slopes[:, :, g], columns, rtol=1e-12, atol=1e-12 * np.abs(columns).max())


# -------------------------------------------------------------------------------------------- units

BASE_UNITS: Mapping[str, tuple[int, int, int, int]] = {  # kg, m, s, K
    "1": (0, 0, 0, 0),
    "rad": (0, 0, 0, 0),
    "kg": (1, 0, 0, 0),
    "m": (0, 1, 0, 0),
    "s": (0, 0, 1, 0),
    "K": (0, 0, 0, 1),
    "N": (1, 1, -2, 0),
    "Hz": (0, 0, -1, 0),
}
POWERS = {"": 1, "²": 2, "³": 3}


def dimension(unit: str) -> Array:
    """Exponents of kg, m, s, K of a unit such as `N s²/m²` or `rad/(N m)`."""
    above, _, below = unit.partition("/")
    total = np.zeros(4)
    for part, sign in ((above, 1), (below.strip("()"), -1)):
        for factor in part.split():
            match = re.fullmatch(r"(\w*?)([²³]?)", factor)
            assert match, unit
            total += sign * POWERS[match[2]] * np.array(BASE_UNITS[match[1]])
    return total


SIGNAL_UNITS: Mapping[str, str] = (
    dict.fromkeys(("phi", "qx", "qy", "qz", "qw", "progress"), "1")
    | dict.fromkeys(("dphi", "wx", "wy", "wz"), "rad/s")
    | dict.fromkeys(("ddphi", "alx", "aly", "alz"), "rad/s²")
    | dict.fromkeys(("px", "py", "pz"), "m")
    | dict.fromkeys(("vx", "vy", "vpx", "vpy", "vpz"), "m/s")
    | dict.fromkeys(("ax", "ay", "apx", "apy", "apz"), "m/s²")
    | {"time": "s", "temperature": "K"}
)


@every_case
def test_prediction_does_not_depend_on_the_system_of_units(space: Space, effect: Effect) -> None:
    """Everything in other units of mass, length, time and temperature, each by its stated unit: the reading follows.

    A parameter whose stated unit is wrong does not scale as it should. Constants of the project's own stay out of it:
    gravity is converted, temperatures count from 20 °C, and times stay off the 10 ms edges of a push.
    """
    rng, samples = np.random.default_rng(5), 6
    factors = np.array([1.3, 0.7, 1.6, 0.4])

    def convert(unit: str) -> float:
        return float(np.prod(factors ** dimension(unit)))

    model = base(space) + effect
    foreign = dataclasses.replace(model, gravity=model.gravity * convert("m/s²"))
    signals = random_signals(model, samples, rng)
    signals["time"] = np.array([1.0, 2.0, 3.0, 5.0, 7.0, 9.0])
    theta = np.abs(rng.normal(0.5, 0.2, len(model.parameters)))
    names = [p.name.partition(".")[2] for p in model.parameters]
    for name, value in (("start", 2.5), ("end", 6.0)):
        if name in names:
            theta[names.index(name)] = value
    zero = {"temperature": 20.0}
    other = {n: (s - zero.get(n, 0)) * convert(SIGNAL_UNITS[n]) + zero.get(n, 0) for n, s in signals.items()}
    other_theta = theta * [convert(p.unit) for p in model.parameters]
    channels = np.array([convert(unit) for unit in space.units])
    for part in ("load", "zero"):
        ours = getattr(compiled(model), part).value(signals, theta, samples)
        theirs = getattr(compiled(foreign), part).value(other, other_theta, samples)
        # 1e-6 m/s and 1e-6 m, where speed and distance are rounded off: their squares over those of 0.1 at least
        np.testing.assert_allclose(theirs, ours * channels, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    if compiled(model).remembers:
        omega = np.array([1.0, 5.0, 30.0])
        ours = compiled(model).transfer(omega, theta)[0]
        theirs = compiled(foreign).transfer(omega / convert("s"), other_theta)[0]
        np.testing.assert_allclose(theirs, ours, rtol=1e-12)  # rounding


# --------------------------------------------------------------------- the same physics as MuJoCo's

PLANAR_RIG = simulated.PlanarRig(noise=(0.0, 0.0, 0.0), resolver_step=1e-12, warm_up=simulated.WarmUp(noise=0.0))
SPATIAL_RIG = simulated.SpatialRig(
    noise=(0.0,) * 6, resolver_step=1e-12, position_step=1e-12, warm_up=simulated.WarmUp(noise=0.0)
)
RIGS: Mapping[Space, simulated.Rig] = {Space.PLANE: PLANAR_RIG, Space.SPACE: SPATIAL_RIG}
REPEATS, SAMPLES = 2, 500


def truth_of(hidden: simulated.HiddenEffect, space: Space) -> dict[str, float]:
    """The catalogue's parameters of a hidden effect, without its id."""
    match hidden:
        case simulated.CentreOfMassOffset():
            return {"mlx": hidden.mlx}
        case simulated.GravityTilt():
            spatial_angles = {"tilt_x": hidden.tilt_x, "tilt_y": hidden.tilt_y}
            return {"angle": hidden.tilt_y} if space is Space.PLANE else spatial_angles
        case simulated.SensorRotation():
            spatial_angles = {"roll": hidden.roll, "pitch": hidden.pitch, "yaw": hidden.yaw}
            return {"angle": hidden.yaw} if space is Space.PLANE else spatial_angles
        case simulated.SensorCrosstalk():
            return {f"{into}_{out_of}": gain for into, out_of, gain in hidden.leaks}
        case simulated.ViscousDrag() | simulated.QuadraticDrag():
            return {"c": hidden.c, "d": hidden.d}
        case simulated.CableSpring():
            assert hidden.anchor is not None
            assert hidden.length is not None
            x, y, z = hidden.anchor
            anchor = {"x": x, "y": z} if space is Space.PLANE else {"x": x, "y": y, "z": z}
            places = {f"anchor_{axis}": value for axis, value in anchor.items()}
            return {"k": hidden.k, "length": hidden.length, "d": hidden.d, **places}
        case simulated.SensorLag():
            return {"time_constant": hidden.time_constant}
        case simulated.TimeDelay():
            return {"delay": hidden.delay}
        case simulated.ThermalDrift():
            return {c: hidden.force if c.startswith("f") else hidden.torque for c in space.channels}
        case simulated.ContactEvent():
            assert hidden.start is not None
            assert hidden.end is not None
            force, torque = hidden.force, hidden.torque
            wrench = (force[0], -force[1], torque[2]) if space is Space.PLANE else (*force, *torque)
            names = ("fcx", "fcy", "tauc") if space is Space.PLANE else ("fcx", "fcy", "fcz", "tcx", "tcy", "tcz")
            return {"start": hidden.start, "end": hidden.end, **dict(zip(names, wrench, strict=True))}
        case _:
            pytest.fail(f"{hidden.id}: say here what the simulated effect is in the catalogue's parameters")


def recorded(space: Space, *hidden: simulated.HiddenEffect) -> tuple[Recording, tuple[simulated.HiddenEffect, ...]]:
    """A recording without noise, and the hidden effects with their places filled in."""
    rig = RIGS[space]
    motion = rig.random_motion(seed=11)
    frame = simulated.simulate(rig, motion, hidden=hidden, repeats=REPEATS, samples_per_period=SAMPLES)
    described = Rig(link_lengths=PLANAR_RIG.link_lengths) if space is Space.PLANE else Rig()
    recording = from_columns({str(name): frame[name].to_numpy() for name in frame}, rig=described)
    return recording, simulated.placed(rig, motion, hidden, repeats=REPEATS)


def body_of(space: Space) -> dict[str, float]:
    rig = RIGS[space]
    biases = {f"bias_{c}": value for c, value in zip(space.channels, rig.bias, strict=True)}
    if isinstance(rig, simulated.PlanarRig):
        return biases | {"m": rig.mass, "mlg": rig.mlg, "I": rig.inertia}
    assert isinstance(rig, simulated.SpatialRig)
    names = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    return biases | dict(zip(names, (rig.mass, *rig.first_moment, *rig.inertia), strict=True))


STRONG: Mapping[str, simulated.HiddenEffect] = {
    "gravity_tilt": simulated.GravityTilt(tilt_x=0.0, tilt_y=0.3),
    "sensor_rotation": simulated.SensorRotation(yaw=0.4),
    "sensor_crosstalk": simulated.SensorCrosstalk(leaks=(("fy", "fx", 0.2), ("fx", "fy", -0.1))),
    "sensor_lag": simulated.SensorLag(time_constant=0.1),
    "time_delay": simulated.TimeDelay(delay=0.083),
}
"""Larger than what a rig hides, so that what is of second order in them shows."""
PREDICTED_TO: Mapping[str, float] = {"sensor_lag": 1e-5}
"""Relative to the largest reading. The accelerations come from recorded positions, rounded to 1e-12 rad: 1e-12 times
the square of the highest of 5 harmonics, some 1e-10. The simulator takes a lag's input as straight between points 1 ms
apart: (w h)²/12 of the harmonics of the wrench, w up to some 30 rad/s with any weight, thinned by the lag itself."""
OWN_SHAPE = {"bias_drift"}
"""Effects that the simulator gives another curve on purpose."""


@pytest.mark.parametrize(
    ("space", "effect"),
    [case for case in CASES if case[1].id not in OWN_SHAPE],
    ids=[f"{e.id}-{s.name}" for s, e in CASES if e.id not in OWN_SHAPE],
)
def test_effect_is_that_of_the_simulated_rig(space: Space, effect: Effect) -> None:
    """The readings of MuJoCo with the effect in it are predicted at the true parameters, signs and units included."""
    recording, (hidden,) = recorded(space, STRONG.get(effect.id, simulated.HIDDEN_EFFECTS[effect.id]))
    model = base(space) + effect
    truth = body_of(space) | {f"{effect.id}.{n}": v for n, v in truth_of(hidden, space).items()}
    assert truth.keys() <= {p.name for p in model.parameters}
    theta = np.array([truth.get(p.name, p.nominal) for p in model.parameters])
    difference = recording.wrench - predicted(model, recording, theta)
    without = recording.wrench - predicted(model.base, recording, theta[: model.base_size])
    if isinstance(hidden, simulated.ContactEvent) and recording.time is not None:
        edges = np.array([hidden.start, hidden.end])[:, None]
        difference = difference[(np.abs(recording.time - edges) > simulated.CONTACT_EDGE).all(axis=0)]
    scale = np.abs(recording.wrench).max(axis=0)
    assert np.abs(without / scale).max() > 0.01  # what is hidden shows
    assert np.abs(difference / scale).max() < PREDICTED_TO.get(effect.id, 1e-10)
