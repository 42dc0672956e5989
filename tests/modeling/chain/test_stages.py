"""Every stage of the chain, in every form in which it describes itself, and a stage from outside the tree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from design.information.sensitivities import sensitivity_terms
from estimation.contact.contact_filter import ContactFilter, LocalPolynomial
from estimation.contact.contact_wrench import CalibratedModel
from estimation.fit import fit
from estimation.model_response import model_response
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.chain.stages import (
    Bias,
    ChainStage,
    Clipping,
    Gain,
    LinearDynamics,
    Mounting,
    Play,
    PolynomialGain,
    StageFormula,
    SymbolicMap,
)
from modeling.codegen.code_target import CodeTarget, code_target, register_target, target_names
from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor
from modeling.dynamics.motion_record import MotionRecord, ResponsePart
from modeling.dynamics.sample_program import SampleProgramBuilder, Symbols
from modeling.effects import named
from modeling.errors import InputError
from modeling.parameter import Parameter
from modeling.space import Space
from tests.shared.emitted import CasadiFilter, CFilter, DiscreteTimeModel, Library, module

Array = NDArray[np.float64]

SAMPLES, PERIOD = 400, 4.0
DT = PERIOD / SAMPLES
HIGHEST = 2 * np.pi * 3 / PERIOD
"""Highest angular frequency of the motion, rad/s."""
TOOL = {"bias_fx": 0.3, "bias_fy": -0.2, "bias_tau": 0.1, "m": 1.2, "mlg": 0.15, "I": 0.03}
ROUNDING = 1e-12
HOLD = (HIGHEST * DT) ** 2 / 12
"""What straight lines between samples lose of a sine."""


@cache
def motion(repeats: int = 2) -> Recording:
    """A periodic motion of three harmonics, and a temperature that goes on rising."""
    time = np.arange(repeats * SAMPLES) * DT
    w, rng = 2 * np.pi / PERIOD, np.random.default_rng(3)
    columns = {"time": time, "repeat": np.repeat(np.arange(float(repeats)), SAMPLES), "temperature": 20 + 0.1 * time}
    for name, size in (("phi", 0.5), ("dphi", 1.0), ("ddphi", 3.0), ("ax", 2.0), ("ay", 2.0)):
        phases = rng.uniform(0, 6.3, 3)
        columns[name] = size * sum((np.sin(k * w * time + phases[k - 1]) / k for k in (1, 2, 3)), np.zeros(()))
    columns |= dict.fromkeys(("fx", "fy", "tau"), np.zeros_like(time))
    return from_columns(columns)


@dataclass(frozen=True, eq=False)
class StageCase:
    """A stage in a model of the rigid tool; `tolerance` is what the sampling loses, relative to the largest reading."""

    effect: Effect
    own: Mapping[str, float]
    tolerance: float = ROUNDING

    @cached_property
    def model(self) -> WrenchModel:
        return planar() + self.effect

    @cached_property
    def theta(self) -> Array:
        values = TOOL | {f"{self.effect.id}.{name}": value for name, value in self.own.items()}
        return np.array([values.get(p.name, p.nominal) for p in self.model.parameters])

    @cached_property
    def fitted(self) -> FittedModel:
        return FittedModel.of(self.model, self.theta, DT)

    def steps(self, rows: Array) -> Array:
        """The readings (n, 3), sample by sample."""
        running = DiscreteTimeModel(self.model, self.theta, dt=DT)
        return np.stack([running.predict(row) for row in rows])


PLAY = {"fx": 1.0, "fy": 0.5, "tau": 0.05}
CASES: Mapping[type, StageCase] = {
    Mounting: StageCase(named("sensor_rotation"), {"angle": 0.3}),
    Gain: StageCase(named("sensor_crosstalk"), {"fy_fx": 0.1, "tau_fx": 0.02}),
    PolynomialGain: StageCase(named("gain_nonlinearity"), {"fx_2": 0.003, "fy_3": 1e-4}),
    Play: StageCase(named("sensor_hysteresis"), PLAY, (HIGHEST * DT) ** 2 / 8),  # a turn within half a sample
    LinearDynamics: StageCase(effects.sensor_lag(), {"time_constant": 0.03}, HOLD),
    Bias: StageCase(effects.thermal_drift(), {"fx": 0.1, "tau": 0.01}),
    Clipping: StageCase(named("saturation"), {"fx": 5.0, "fy": 10.0, "tau": 1.0}),
    Effect: StageCase(named("tip_flexibility"), {"stiffness": 40.0, "damping": 0.3}, HOLD),  # the deflection
}
every_stage = pytest.mark.parametrize("case", CASES.values(), ids=lambda c: str(c.effect.id))


def kinds(kind: type) -> set[type]:
    below: list[type] = kind.__subclasses__()
    return {kind}.union(*map(kinds, below))


def test_every_stage_has_a_case() -> None:
    own = {kind for kind in kinds(ChainStage) if kind.__module__.startswith("modeling.")}
    assert own - {ChainStage, SymbolicMap} == set(CASES) - {Effect}
    for kind, case in CASES.items():
        assert case.model.chain.deflection is not None if kind is Effect else case.model.chain[kind]


def rows_of(case: StageCase, recording: Recording) -> Array:
    known = recording.motion.model_signals
    return np.stack([known[name] for name in case.fitted.inputs], axis=1)


@every_stage
def test_a_record_reads_as_its_samples_do(case: StageCase) -> None:
    """In the last of six repeats, where every start is forgotten; the record is in its steady state."""
    recording = motion(6)
    whole = model_response(case.model, recording, case.theta).value[-SAMPLES:]
    found = case.steps(rows_of(case, recording))[-SAMPLES:]
    size = np.abs(whole).max(axis=0)
    assert (np.abs(found - whole).max(axis=0) <= 2 * case.tolerance * size).all()  # three harmonics


@every_stage
def test_derivatives_are_finite_differences(case: StageCase) -> None:
    recording, theta = motion(), case.theta
    slopes = model_response(case.model, recording, theta).derivative
    for i in range(len(theta)):
        step = np.zeros(len(theta))
        step[i] = 1e-6 * max(1.0, abs(theta[i])) if np.isfinite(theta[i]) else 0.0
        ends = [model_response(case.model, recording, theta + s * step, derivative=False).value for s in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step[i]) if step[i] else np.zeros_like(ends[0])
        wrong = np.abs(slopes[:, :, i] - expected) > 1e-6 * max(1.0, float(np.abs(expected).max()))
        assert wrong.mean() < 0.01  # a sample next to a corner of play or saturation may pass it


@every_stage
def test_casadi_c_and_python_are_one(case: StageCase) -> None:
    fitted = case.fitted
    c, python = (
        CFilter(Library(code_target("c").model(fitted, "x")), 3),
        module(code_target("numpy").model(fitted, "x")),
    )
    graph = CasadiFilter(ca.Function.deserialize(code_target("casadi").model(fitted, "x")), fitted)
    running, state = DiscreteTimeModel(case.model, case.theta, dt=DT), python.State()
    readings = np.random.default_rng(5).normal(0, 10, (60, 3))
    for u, reading in zip(rows_of(case, motion()), readings, strict=False):
        expected = running.compensate(u, reading)
        for other in (c.compensate(u, reading), python.compensate(state, u, reading), graph.compensate(u, reading)):
            np.testing.assert_allclose(other, expected, rtol=0, atol=ROUNDING * 100)  # contacts of some 10 N


@every_stage
def test_a_constant_motion_is_steady_from_the_first_sample_on(case: StageCase) -> None:
    """The initial state is the steady state: the reading is that of a pose at rest."""
    row = rows_of(case, motion())[7]
    for name in ("ax", "ay", "dphi", "ddphi"):
        row[case.fitted.inputs.index(name)] = 0.0
    found = case.steps(np.tile(row, (50, 1)))
    np.testing.assert_allclose(found, np.tile(found[0], (50, 1)), rtol=0, atol=1e-10)  # of a spring of 40 N m/rad
    poses = {name: np.full(3, value) for name, value in zip(case.fitted.inputs, row, strict=True)}
    still = from_columns(dict.fromkeys(("fx", "fy", "tau"), np.zeros(3)) | {"temperature": np.full(3, 20.0)} | poses)
    np.testing.assert_allclose(found[0], model_response(case.model, still, case.theta).value[0], atol=1e-9)


def filtered(case: StageCase, recording: Recording) -> Array:
    """What the contact filter leaves of a recording, row by row."""
    size = len(case.theta)
    known = CalibratedModel(case.model, case.theta, np.zeros((size, size)), np.full(3, 0.01), np.zeros(3))
    names = ("phi", "ax", "ay", "dphi", "ddphi", "temperature")
    contact = ContactFilter(known, columns=names, window=LocalPolynomial(half=2, dt=DT))
    rows = np.column_stack([recording.motion.recorded.stack(names), recording.wrench])
    return np.stack([r for r in map(contact.update, rows) if r is not None])


@every_stage
def test_the_contact_filter_leaves_nothing_of_a_stage(case: StageCase) -> None:
    """Its program is run on smoothed signals; next to a corner of play or saturation that shows, in few samples."""
    recording = motion(4)
    left = filtered(case, recording.with_readings(case.steps(rows_of(case, recording))))
    assert len(left) > 1000
    assert np.quantile(np.abs(left), 0.9) < 1e-3


# --------------------------------------------------------------------------------- a stage from outside the tree


@dataclass(frozen=True)
class Echo(ChainStage):
    """Two samples mixed by the sensor's electronics: y_n = (x_n + share x_{n-1}) / (1 + share)."""

    share: sp.Matrix

    place = Stage.PLAY

    def vectors(self) -> Mapping[str, sp.Matrix]:
        return {"echo": self.share}

    def step(self, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
        last = sample.state("last", reading)
        sample.keep(last, reading)
        terms = zip(reading, last, self.share, strict=True)
        return sample.assigned("echo", [(x + w * y) / (1 + w) for x, y, w in terms])

    @classmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        load = record.sum(parts)
        share, slope = record.constant("echo")
        value, derivative = (
            np.concatenate([cls._mixed(run, share, record.clock.periodic) for run in record.runs(series)])
            for series in (load.value, load.derivative)
        )
        last = ((1 + share) * value - load.value) / np.where(share == 0, 1.0, share)
        if derivative.shape[2]:
            derivative += ((last - value) / (1 + share))[:, :, None] * slope
        return [replace(load, value=value, derivative=derivative)]

    @staticmethod
    def _mixed(series: Array, share: Array, periodic: bool) -> Array:
        before = np.concatenate([series[-1:] if periodic else series[:1], series[:-1]])
        own = share.reshape(-1, *([1] * (series.ndim - 2)))
        return np.asarray((series + own * before) / (1 + own))

    def formula(self, reading: str) -> StageFormula:
        return StageFormula("Echo", f"E {reading}", (("E", r"\text{two samples}"),))


@dataclass(frozen=True)
class SensorEcho(Effect):
    """An echo of every channel."""

    id = "sensor_echo"
    title = "echo in the electronics"
    stage = Stage.PLAY
    equation = "y_n = (x_n + share x_{n-1}) / (1 + share)"
    advice = ""

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return (Parameter(name="share", unit="1", bounds=(0.0, 10.0), start=0.5),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        return chain.with_stage(Echo(sp.Matrix([p["share"]] * len(chain.space.channels))))


ECHO = StageCase(SensorEcho(), {"share": 0.7})


@pytest.mark.parametrize(
    "check",
    [
        test_a_record_reads_as_its_samples_do,
        test_derivatives_are_finite_differences,
        test_casadi_c_and_python_are_one,
        test_a_constant_motion_is_steady_from_the_first_sample_on,
    ],
)
def test_a_stage_from_outside_conforms(check) -> None:  # type: ignore[no-untyped-def]
    check(ECHO)


def test_a_stage_from_outside_is_fitted_filtered_and_written_down() -> None:
    """Readings made by its samples; the fit finds their share, the filter leaves nothing of them."""
    recording = motion(4)
    silent = recording.with_readings(ECHO.steps(rows_of(ECHO, recording)))
    noisy = silent.with_readings(silent.wrench + 0.01 * np.random.default_rng(6).standard_normal(silent.wrench.shape))
    found = fit(ECHO.model, noisy)
    assert abs(found.theta[-1] - 0.7) < 5 * np.sqrt(found.covariance[-1, -1])
    left = filtered(ECHO, silent)
    assert len(left) > 1000
    # Five samples smooth a sine by (w dt)⁴ or so, the echo's corner at the start aside.
    assert np.abs(left[5:]).max() < 1e-3
    assert "Echo" in code_target("latex").model(ECHO.fitted, "x")


def test_a_design_refuses_a_stage_that_its_sensitivities_lack() -> None:
    with pytest.raises(InputError, match="Echo"):
        sensitivity_terms(ECHO.model, ECHO.theta)
    with pytest.raises(InputError, match="echo"):
        ECHO.model.require_direct("regressor")


# ---------------------------------------------------------------------------------- targets, and one from outside


@pytest.mark.parametrize("name", target_names())
def test_every_target_writes_regressors_and_every_stage(name: str) -> None:
    target = code_target(name)
    assert (target.name, target.suffix[0]) == (name, ".")
    for space in Space:
        assert target.regressor(RigidToolRegressor(space), "x")
    for case in CASES.values():
        fitted = case.fitted if target.sampled else replace(case.fitted, dt=None)
        assert target.model(fitted, "x") == target.model(FittedModel.of(case.model, case.theta, fitted.dt), "x")


class Inventory(CodeTarget):
    """A list of what a model needs."""

    name = "inventory"
    suffix = ".txt"

    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        return "\n".join([source, *base.inputs])

    def model(self, fitted: FittedModel, source: str) -> str:
        return "\n".join([source, *fitted.inputs, str(len(fitted.program.states))])


def test_a_target_from_outside_is_a_choice_of_emit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from modeling.codegen import code_target as registry
    from truewrench.command_line import main

    monkeypatch.setattr(registry, "_TARGETS", dict(registry._TARGETS))
    register_target(Inventory())
    assert main(["emit", "planar", "--to", "inventory"]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["ax", "ay", "phi", "dphi", "ddphi"]
