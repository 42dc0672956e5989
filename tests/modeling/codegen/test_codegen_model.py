"""The emitted code of fitted models: sample by sample what Python does, over a whole recording, whatever it is fed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from estimation.contact.contact_wrench import compensate
from estimation.recordings.reading import read
from modeling import effects
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.chain.prediction import compiled_prediction
from modeling.chain.stages import Bias, LinearDynamics
from modeling.codegen.casadi_target import casadi_model
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.latex_target import LatexTarget
from modeling.codegen.template import CTarget, NumpyTarget
from modeling.compiled.straight_line_program import laplace
from modeling.dynamics.motion_record import TimeBase
from modeling.dynamics.play import PlayResponse
from modeling.effects import catalogue, named
from modeling.formulas.python_definition import own_effect
from modeling.parameter import Parameter
from modeling.rig import Convention, Rig
from modeling.space import Space, signals
from tests.shared.emitted import CasadiFilter, CFilter, DiscreteTimeModel, Library, balanced, module
from truewrench.command_line import main
from truewrench.files.model_file import ModelFile

Array = NDArray[np.float64]

DT = 0.01
ARM = Rig(link_lengths=(0.8,))
LAST_BITS = 1e-12
"""Of the sum of what every parameter contributes: some hundred operations in another order."""


def everything() -> WrenchModel:
    """The planar model with every effect at once that can be run sample by sample and needs no arm."""
    base = WrenchModel(space=Space.PLANE, convention=Convention.ON_SENSOR)
    left_out = (Stage.DEFLECTION, Stage.JOINTS, Stage.KINEMATICS)
    return base + [e for e in catalogue(Space.PLANE) if not e.per_recording and e.stage not in left_out]


SPATIAL_EFFECTS = (effects.sensor_rotation(), effects.gravity_tilt(), effects.quadratic_drag(), effects.time_delay())

CASES: Mapping[str, WrenchModel] = {
    "planar": everything(),
    "spatial": WrenchModel(space=Space.SPACE) + SPATIAL_EFFECTS,
    "joints": planar(ARM) + [e for e in catalogue(Space.PLANE) if e.needs_joints],
    "spring": planar() + named("tip_flexibility") + effects.viscous_drag() + effects.sensor_lag(),
    "drag and lag": planar() + effects.viscous_drag() + effects.sensor_lag(),
    "rigid": replace(planar(), mirror_y=True, gravity=9.81),
}
every_case = pytest.mark.parametrize("name", CASES)
every_rigid_case = pytest.mark.parametrize("name", [name for name in CASES if name != "spring"])


def theta_of(model: WrenchModel) -> Array:
    """Positive numbers of a robot's size within the bounds; readings that lead by 1.3 samples; levels out of reach."""
    rng = np.random.default_rng(0)
    low, high = (np.array([p.bounds[i] for p in model.parameters]) for i in (0, 1))
    theta = np.clip(rng.uniform(0.05, 0.3, len(low)), low, high)
    special = {"time_delay.delay": -1.3 * DT, "sensor_lag.time_constant": 0.03, "tip_flexibility.stiffness": 50.0}
    for i, parameter in enumerate(model.parameters):
        theta[i] = special.get(parameter.name, theta[i])
        if parameter.name.startswith("saturation"):
            theta[i] = 40.0
    return theta


@dataclass(frozen=True, eq=False)
class Case:
    """A fitted model, and all that was emitted of it."""

    fitted: FittedModel
    c: Library
    numpy: Any
    casadi: Any

    @property
    def running(self) -> DiscreteTimeModel:
        return DiscreteTimeModel(self.fitted.model, self.fitted.theta, dt=self.fitted.dt)


@cache
def case(name: str) -> Case:
    return emitted(FittedModel.of(CASES[name], theta_of(CASES[name]), DT))


def emitted(fitted: FittedModel) -> Case:
    function = ca.Function.deserialize(casadi_model(fitted).serialize())
    return Case(fitted, Library(CTarget().model(fitted, "test")), module(NumpyTarget().model(fitted, "test")), function)


EDGES = np.array([0.0, -0.0, 5e-324, np.pi, -np.pi, 50 * np.pi, np.pi / 2, 1e8, -1e8])


def samples(fitted: FittedModel, count: int = 60) -> Array:
    """Random signals, then edge values in random company, (N, m); none where a spring has to bear 1e8 m/s²."""
    rng, width = np.random.default_rng(1), len(fitted.inputs)
    if fitted.model.chain.deflection is not None:
        return rng.normal(0, 1, (2 * count, width))
    return np.concatenate([rng.normal(0, 1, (count, width)), rng.choice(EDGES, (count, width))])


def size_of(fitted: FittedModel, u: Array) -> Array:
    """Sum (N,) of what every parameter contributes to the largest reading, and 1 N; of a bent tool's, 100 N."""
    if fitted.model.chain.deflection is not None:
        return np.full(len(u), 100.0)
    series = dict(zip(fitted.inputs, u.T, strict=True))
    prediction = compiled_prediction(fitted.model)
    _, slope = prediction.load.tangent(series, fitted.theta, len(u))
    return np.asarray(1 + (np.abs(slope) * np.abs(fitted.theta)).sum(axis=2).max(axis=1))


def test_every_planar_effect_is_in_some_case() -> None:
    there = {e.id for m in CASES.values() for e in m.effects if m.space is Space.PLANE}
    assert {e.id for e in catalogue(Space.PLANE) if not e.per_recording} <= there


@every_case
def test_c_numpy_casadi_and_python_agree_sample_by_sample(name: str) -> None:
    """A state that was fed 1e8 keeps its rounding: the tolerance is of the largest sample so far."""
    found, fitted = case(name), case(name).fitted
    u, readings = samples(fitted), np.random.default_rng(2).normal(0, 20, (120, fitted.size))
    size = np.maximum.accumulate(size_of(fitted, u))
    running, c, state = found.running, CFilter(found.c, fitted.size), found.numpy.State()
    graph = CasadiFilter(found.casadi, fitted)
    for row, reading, scale in zip(u, readings, size, strict=True):
        expected = running.compensate(row, reading)
        assert np.isfinite(expected).all()
        others = (
            c.compensate(row, reading),
            found.numpy.compensate(state, row, reading),
            graph.compensate(row, reading),
        )
        for other in others:
            assert np.abs(other - expected).max() <= LAST_BITS * 20 * scale  # an inverse contact gain of up to 20


@every_case
def test_prediction_is_what_compensation_subtracts(name: str) -> None:
    found, fitted = case(name), case(name).fitted
    running, c, state = found.running, CFilter(found.c, fitted.size), found.numpy.State()
    u = samples(fitted)[:60]
    for row, scale in zip(u, np.maximum.accumulate(size_of(fitted, u)), strict=True):
        expected = running.predict(row)
        for other in (c.predict(row), found.numpy.predict(state, row)):
            assert np.abs(other - expected).max() <= LAST_BITS * scale


@every_rigid_case
def test_derivative_is_casadis_own(name: str) -> None:
    """Symbolic, step by step, against algorithmic differentiation of the whole."""
    found, fitted = case(name), case(name).fitted
    u = samples(fitted)[:60]
    series, prediction = dict(zip(fitted.inputs, u.T, strict=True)), compiled_prediction(fitted.model)
    slopes = [part.tangent(series, fitted.theta, len(u))[1] for part in (prediction.load, prediction.bias)]
    place = [list(fitted.model.parameters).index(p) for p in fitted.parameters]
    expected = (slopes[0] + slopes[1])[:, :, place]
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    by_numpy = getattr(found.numpy, fitted.derivative_name)(u)
    shape = (fitted.size, len(fitted.parameters))
    by_c = np.stack([found.c.matrix(fitted.derivative_name, row, shape) for row in u])
    for phi in (by_numpy, by_c):
        assert (np.abs(phi - expected) <= 1e2 * LAST_BITS * size).all()  # up to two thousand operations


def test_a_linear_model_has_a_regressor() -> None:
    found = case("rigid")
    u = samples(found.fitted)[:60]
    assert [case(name).fitted.derivative_name for name in CASES] == ["sensitivity"] * 5 + ["regressor"]
    readings = found.numpy.regressor(u) @ found.numpy.parameters
    expected = np.stack([found.running.predict(row) for row in u])
    np.testing.assert_allclose(readings, expected, rtol=0, atol=1e-12)  # rounding of sums of 10 N


@every_case
def test_c_allocates_nothing(name: str) -> None:
    text = re.sub(r"/\*.*?\*/", "", case(name).c.text, flags=re.DOTALL)
    assert not re.search(r"malloc|calloc|realloc|\bfree\b|alloca|\bdouble \w+\[[a-z]", text)
    assert case(name).c.undefined <= {"sin", "cos", "sincos", "sqrt", "tanh", "exp", "fmax", "fmin", "atan2", "pow"}


@every_case
def test_formulas_are_balanced_and_name_every_effect(name: str) -> None:
    fitted = case(name).fitted
    text = LatexTarget().model(replace(fitted, dt=None), "test")
    assert balanced(text)
    for effect in fitted.model.effects:
        assert effect.id.replace("_", r"\_") in text
    for parameter in fitted.model.parameters:
        assert rf"\texttt{{{parameter.name.replace('_', chr(92) + '_')}}}" in text


@every_case
def test_sharing_saves_operations(name: str) -> None:
    fitted = case(name).fitted
    assert 0 < fitted.program.operations(shared=True).total <= fitted.program.operations(shared=False).total
    if fitted.sensitivity is not None:
        assert 0 < fitted.sensitivity.shared.operations.total <= fitted.sensitivity.operations_unshared.total


# ------------------------------------------------------------------------------------------------ the state


def test_a_filter_that_is_initialised_again_begins_anew() -> None:
    found = case("planar")
    c, u = CFilter(found.c, 3), samples(found.fitted)[:20]
    first = np.array([c.predict(row) for row in u])
    c.predict(np.full(u.shape[1], np.nan))
    assert np.isnan(c.predict(u[0])).any()  # what is not finite is not hidden
    c.restart()
    np.testing.assert_array_equal(np.array([c.predict(row) for row in u]), first)


def test_a_sample_that_has_always_been_there_changes_nothing() -> None:
    """A constant input: the prediction is that of the model without memory, from the first sample on."""
    found = case("drag and lag")
    c, u = CFilter(found.c, 3), samples(found.fitted)[0]
    still = DiscreteTimeModel(found.fitted.model.without("sensor_lag"), found.fitted.theta[:-1])
    for _ in range(50):
        np.testing.assert_allclose(c.predict(u), still.predict(u), rtol=0, atol=1e-13)  # rounding of 50 steps


def test_readings_that_lead_are_waited_for() -> None:
    """A lead of 1.3 samples: with a push the contact that comes out is that of `wait` samples ago.

    The cubic is wrong by (w dt)⁴ / 42 of the load of 2 N: 1e-7 at w dt = 0.03.
    """
    model = planar() + effects.time_delay()
    theta = np.array([0.1, -0.2, 0.05, 0.2, 0.05, 0.01, -1.3 * DT])
    fitted = FittedModel.of(model, theta, DT)
    found, running = emitted(fitted), DiscreteTimeModel(model, theta, dt=DT)
    still = DiscreteTimeModel(planar(), theta[:-1])
    push = np.array([3.0, 1.0, 0.2])
    gain = np.diag([-1.0, 1.0, -1.0])

    def motion(time: float) -> Array:
        return np.array([0.0, 0.0, 0.0, 0.0, np.sin(3 * time)])

    c, assertions = CFilter(found.c, 3), 0
    assert running.wait == 3
    for k in range(100):
        touched = push * (k % 7 == 0)
        reading = still.predict(motion((k + 1.3) * DT)) + gain @ touched
        contact = c.compensate(motion(k * DT), reading)
        if k >= 10:
            then = push * ((k - running.wait) % 7 == 0)
            np.testing.assert_allclose(contact, then, atol=1e-6)
            assertions += 1
    assert assertions == 90


def test_play_is_that_of_the_whole_series() -> None:
    """Sample by sample, a load turns at samples: `PlayResponse` without smoothness, found in another way."""
    model = planar() + named("sensor_hysteresis")
    theta = np.array([0.1, 0.2, 0.3, 0.5, 0.1, 0.02, 2.0, 1.0, 0.0])
    running, still = DiscreteTimeModel(model, theta, dt=DT), DiscreteTimeModel(planar(), theta[:6])
    u = np.random.default_rng(4).normal(0, 3, (200, 5))
    load = np.stack([still.predict(row) for row in u]) - theta[:3]
    whole = PlayResponse.of(load, theta[6:], periodic=False, smooth=False).reading + theta[:3]
    found = np.stack([running.predict(row) for row in u])
    assert np.abs(found - load - theta[:3]).max() > 1
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e-12)  # rounding of some 10 N


@dataclass(frozen=True)
class Filter(Effect):
    """A memory of the test's own."""

    transfer: sp.Expr = sp.S.One

    id = "filter"
    title = "any filter"
    stage = Stage.LINEAR_DYNAMICS
    equation = "H(s)"
    advice = ""

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return ()

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        return chain.with_stage(LinearDynamics(self.transfer))


S = laplace()


@pytest.mark.parametrize(
    "transfer",
    [
        sp.exp(-3 * S / 100),  # whole samples
        sp.exp(-S / 250) / (1 + S / 20 + (S / 30) ** 2),  # two states, and a fraction of the first sample
        1 / (1 + S / 10**13),  # a lag that is none
        2 * sp.exp(-S / 30),  # a gain is left of the low-pass
    ],
    ids=str,
)
def test_any_memory_is_run_as_python_runs_it(transfer: sp.Expr) -> None:
    model = planar() + Filter(transfer)
    found = emitted(FittedModel.of(model, theta_of(model), DT))
    running, c, state = found.running, CFilter(found.c, 3), found.numpy.State()
    graph = CasadiFilter(found.casadi, found.fitted)
    for row in samples(found.fitted, 30)[:30]:
        expected = running.compensate(row, row[:3])
        for other in (c.compensate(row, row[:3]), found.numpy.compensate(state, row, row[:3])):
            np.testing.assert_allclose(other, expected, rtol=0, atol=1e-13)  # rounding of sums of 10 N
        np.testing.assert_allclose(graph.compensate(row, row[:3]), expected, rtol=0, atol=1e-13)


def test_parameters_may_be_changed_while_it_runs() -> None:
    """Those of the contact gain too: it is solved anew with them."""
    found = emitted(case("planar").fitted)
    names, theta = [p.name for p in found.fitted.parameters], found.fitted.theta.copy()
    for name, value in (("m", 1.7), ("sensor_crosstalk.fy_fx", 0.2), ("sensor_hysteresis.tau", 0.0)):
        found.c.parameters[names.index(name)] = value
        theta[[p.name for p in found.fitted.model.parameters].index(name)] = value
    running, c = DiscreteTimeModel(found.fitted.model, theta, dt=DT), CFilter(found.c, 3)
    for row in samples(found.fitted)[:30]:
        reading = np.array([4.0, -2.0, 0.3])
        np.testing.assert_allclose(c.compensate(row, reading), running.compensate(row, reading), rtol=0, atol=1e-10)


# -------------------------------------------------------------------------------------- a whole recording


@dataclass(frozen=True)
class Bench:
    folder: Path
    other: str

    @property
    def model(self) -> str:
        return str(self.folder / "model.json")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A rig with a drag and a lag, recorded, fitted and saved, and another recording of it."""
    pytest.importorskip("mujoco")
    from truewrench import simulated_rig as simulated

    folder, arm = tmp_path_factory.mktemp("emit"), simulated.PlanarRig()
    (folder / "rig.toml").write_text("[robot]\nlink_lengths = [1.0, 0.97, 0.4]\n")
    hidden = [simulated.ViscousDrag(), simulated.SensorLag()]
    for name, seed, samples in (("train", 1, 200), ("other", 2, 500)):
        motion = arm.random_motion(seed=seed)
        frame = simulated.simulate(arm, motion, hidden=hidden, repeats=2, samples_per_period=samples, seed=seed)
        simulated.write_recording(frame, folder / f"{name}.csv")
    command = ["fit", str(folder / "train.csv"), "--rig", str(folder / "rig.toml"), "--out", str(folder / "model.json")]
    assert main([*command, "--add", "viscous_drag", "--add", "sensor_lag"]) == 0
    return Bench(folder, str(folder / "other.csv"))


def test_emitted_c_compensates_a_whole_recording_as_python_does(bench: Bench) -> None:
    """Must show: two effects, one with memory, within 1e-9 of Python over every sample.

    Against `compensate`, whose spectrum knows the steady state, the filter's start and the lines between its samples
    are left: (w dt)² / 12 of the load, which is 46 N at 2 Hz and less at up to 10 Hz.
    """
    known = ModelFile.read(bench.model).calibration
    recording = read(bench.other, rig=ModelFile.read(bench.model).rig)
    assert recording.dt is not None
    path = bench.folder / "model.c"
    assert main(["emit", bench.model, "--to", "c", "--rate", repr(1 / recording.dt), "--out", str(path)]) == 0
    running = DiscreteTimeModel(known.model, known.theta, dt=recording.dt)
    c = CFilter(Library(path.read_text()), 3)
    u = np.stack([recording.motion.model_signals[name] for name in running.inputs], axis=1)
    by_c = np.stack([c.compensate(*row) for row in zip(u, recording.wrench, strict=True)])
    by_python = np.stack([running.compensate(*row) for row in zip(u, recording.wrench, strict=True)])
    np.testing.assert_allclose(by_c, by_python, rtol=0, atol=1e-9)
    steady = compensate(known, recording, keep_zero=True).wrench
    apart = np.abs(by_c - steady)[50:].max(axis=0)
    assert (apart < [0.02, 0.02, 0.002]).all()
    assert np.abs(by_c).max() > 0.1  # there is noise to be left


def test_a_model_that_remembers_asks_for_the_rate(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    for language in ("c", "numpy", "casadi"):
        assert main(["emit", bench.model, "--to", language]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "sensor_lag" in error
        assert "--rate HZ" in error
    assert main(["emit", bench.model, "--to", "latex"]) == 0
    assert balanced(capsys.readouterr().out)


def test_effects_of_one_recording_stay_behind() -> None:
    model = planar() + effects.bias_drift(degree=2) + effects.viscous_drag()
    fitted = FittedModel.of(model, np.arange(len(model.parameters), dtype=float))
    assert [p.name for p in fitted.model.parameters][6:] == ["viscous_drag.c", "viscous_drag.d"]
    assert fitted.theta[6:].tolist() == [12.0, 13.0]
    assert "bias_drift" in CTarget().model(fitted, "test")
    assert "progress" not in fitted.inputs


@pytest.mark.parametrize(
    "space", [Space.PLANE, pytest.param(Space.SPACE, marks=pytest.mark.long)], ids=lambda s: str(s.name)
)
def test_a_tip_on_a_spring_swings_as_the_whole_series_says(space: Space) -> None:
    """Straight lines between samples lose (w dt)² / 12 of the spring's drive: a quarter of it at half the step."""
    apart = []
    for dt in (0.02, 0.01):
        signals, running = swinging(space, dt)
        bent = compiled_prediction(running.model).deflection
        assert bent is not None
        clock = TimeBase(dt, periodic=False)
        whole, _ = bent.tangent(signals, running.theta, len(signals["time"]), clock, derivative=False)
        u = np.stack([signals[name] for name in running.inputs], axis=1)
        apart.append(np.abs(np.stack([running.predict(row) for row in u]) - whole).max() / np.abs(whole).max())
    assert apart[1] < 1e-3
    assert apart[0] / apart[1] == pytest.approx(4, rel=0.2)  # higher powers of w dt = 0.06 for the tool's own swing


def swinging(space: Space, dt: float) -> tuple[dict[str, Array], DiscreteTimeModel]:
    """A tool of 1 kg that swings at 5 to 10 Hz, moved at 0.5 Hz for a second and a half."""
    model = WrenchModel(space=space) + named("tip_flexibility")
    known = {"m": 1.0, "mlg": 0.09, "I": 0.02, "mz": 0.09, "Ixx": 0.02, "Iyy": 0.025, "Izz": 0.01}
    known |= {"tip_flexibility.stiffness": 40.0, "tip_flexibility.damping": 0.2}
    theta = np.array([known.get(p.name, 0.0) for p in model.parameters])
    running, time = DiscreteTimeModel(model, theta, dt=dt), np.arange(0.0, 1.5, dt)
    found = {name: np.sin(np.pi * time + number) for number, name in enumerate(running.inputs)}
    norm = np.sqrt(sum((found[name] ** 2 for name in ("qx", "qy", "qz", "qw") if name in found), np.zeros_like(time)))
    found |= {name: found[name] / norm for name in ("qx", "qy", "qz", "qw") if name in found}
    return found | {"time": time}, running


# ------------------------------------------------------------------------------------------------- hostility


@dataclass(frozen=True)
class Magnet(Effect):
    """Names that a language has for itself, and a title that would like to be code."""

    id = "int"
    title = "\"\"\"*/ int evil(void) { return 0; } /* \\*/ ??/ ''' }} {{ 7*7 }} %> é ²"
    stage = Stage.BIAS
    equation = "*/"
    advice = "*/"
    spaces = (Space.PLANE,)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return tuple(Parameter(name=name, unit='*/ "') for name in ("double", "while", "I", "lambda", "t0", "state"))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        inputs = signals("for", "u", "phi", "np", "t0", "return", "reading", "null")
        total = sum((a * b for a, b in zip(p.values(), inputs, strict=False)), inputs[6] * inputs[7])
        return chain.with_stage(Bias(chain.bias + sp.Matrix([total, 0, 0])))


def test_names_and_titles_cannot_become_code() -> None:
    model = planar() + Magnet()
    found = emitted(FittedModel.of(model, theta_of(model)))
    assert "evil(void)" not in re.sub(r"/\*.*?\*/", "", found.c.text, flags=re.DOTALL)
    assert not hasattr(found.numpy, "evil")
    assert "{{ 7*7 }}" in found.c.text
    running, c, state = found.running, CFilter(found.c, 3), found.numpy.State()
    for row in samples(found.fitted)[:10]:
        expected = running.predict(row)
        np.testing.assert_allclose(c.predict(row), expected, rtol=1e-12)
        np.testing.assert_allclose(found.numpy.predict(state, row), expected, rtol=1e-12)
    assert balanced(LatexTarget().model(found.fitted, "test"))


def test_a_force_at_a_place_of_ones_own_is_emitted() -> None:
    """Steps of the derivative keep their names when what they share gets names too."""
    pull = own_effect(id="pull", title="spring to a wall", parameters={"k": "N/m"}, tip_body={"force_x": "-k*tip_x"})
    model = planar() + pull
    fitted = FittedModel.of(model, np.array([0.1, 0.2, 0.3, 1.0, 0.1, 0.02, 5.0]))
    library, running = Library(CTarget().model(fitted, "test")), DiscreteTimeModel(model, fitted.theta)
    u = samples(fitted, 3)[:3]
    for row in u:
        np.testing.assert_allclose(CFilter(library, 3).predict(row), running.predict(row), rtol=1e-12, atol=1e-12)
    jacobian = library.matrix("sensitivity", u[0], (3, 7))
    np.testing.assert_allclose(jacobian @ fitted.theta, running.predict(u[0]), rtol=1e-12, atol=1e-12)
