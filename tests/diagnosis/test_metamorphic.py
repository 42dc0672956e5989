"""One recording told in another way: other axes, clocks, units, orders and cuts give the same verdict and parameters.

Ways that change no reading's noise are exact up to rounding, `ROUNDING`. Others give the noise estimate other rows of
the same process, which moves an estimate by a share of its std that the estimate of the noise itself states.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.signal import resample
from scipy.spatial.transform import Rotation

from diagnosis.diagnosis import Diagnosis, diagnose
from estimation.fit import Fit, fit
from estimation.reading.log_reading import read
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig, SensorDescription
from tests.shared.places import AIS2202, needs
from tests.shared.recordings import FEW
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, SimulatedRig, SpatialRig, ViscousDrag, simulate, static_poses

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
Columns = dict[str, Array]
Values = dict[str, float]

FORCE, TORQUE = ("fx", "fy", "fz"), ("tx", "ty", "tz")
PLANE = ("fx", "fy", "tau")
POSITION, QUATERNION = ("px", "py", "pz"), ("qx", "qy", "qz", "qw")
FIRST, SECOND = ("mx", "my", "mz"), ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
SIDEWAYS = ("mlx", "gravity_tilt.angle", "sensor_rotation.angle")
"""Planar parameters that change sign in a mirror, beside the zeros of fx and tau."""
ROUNDING = 0.01
"""Of a std: stamps of 1.7e9 s are rounded to 2e-7 s (5e-4 std), and where the lines of noiseless quaternions end in
their rounding depends on the axes that they are told in (2e-3 std). What rounds numbers alone moves less than 1e-5."""


# ----------------------------------------------------------------------------------------------------- recordings


@dataclass(frozen=True, eq=False)
class Told:
    """A recording's columns and rig, and what becomes of the parameters of the recording that it was made of."""

    columns: Columns
    rig: Rig
    parameters: Callable[[Values], Values] = field(default=dict)

    @property
    def plane(self) -> bool:
        return "tau" in self.columns

    @property
    def channels(self) -> tuple[str, ...]:
        return PLANE if self.plane else FORCE + TORQUE

    @property
    def model(self) -> WrenchModel:
        return planar(self.rig) if self.plane else spatial(self.rig)

    @property
    def recording(self) -> Recording:
        return from_columns(self.columns, name="told", rig=self.rig)

    @property
    def repeats(self) -> int:
        return len(np.unique(self.columns["repeat"])) if "repeat" in self.columns else 1

    def stack(self, names: tuple[str, ...]) -> Array:
        return np.stack([self.columns[name] for name in names], axis=1)

    def of(self, names: tuple[str, ...], values: Array, **changes: object) -> Told:
        """With other columns (n, k)."""
        columns = self.columns | {name: values[:, i] for i, name in enumerate(names)}
        return replace(self, columns=columns, **changes)  # type: ignore[arg-type]

    def each(self, change: Callable[[str, Array], Array], **changes: object) -> Told:
        return replace(self, columns={name: change(name, v) for name, v in self.columns.items()}, **changes)  # type: ignore[arg-type]


Way = Callable[[Told], Told]
ON_TOOL = SensorDescription(convention=Convention.ON_TOOL)


@cache
def simulated(rig: SimulatedRig, repeats: int, drag: float, samples: int = 250) -> Told:
    hidden = (ViscousDrag(c=drag, d=0.12),) if drag else ()
    frame = simulate(rig, rig.random_motion(seed=4), hidden=hidden, repeats=repeats, samples_per_period=samples, seed=3)
    frame = frame.drop(columns=["temperature"] if repeats > 1 else ["temperature", "repeat"])
    described = RIG if isinstance(rig, PlanarRig) else Rig()
    return Told(columns_of(frame), replace(described, sensor=ON_TOOL))


@cache
def at_rest() -> Told:
    frame = static_poses(SpatialRig(), 20, seed=2).drop(columns="temperature", errors="ignore")
    return Told(columns_of(frame), Rig(sensor=ON_TOOL))


def columns_of(frame: pd.DataFrame) -> Columns:
    return {str(name): frame[name].to_numpy(dtype=float) for name in frame}


RECORDINGS: Mapping[str, Callable[[], Told]] = {
    "planar repeats": lambda: simulated(PlanarRig(), 4, 0.0),
    "planar run": lambda: simulated(PlanarRig(), 1, 0.15, 500),
    "six-axis repeats": lambda: simulated(SpatialRig(), 4, 0.0),
    "six-axis run": lambda: simulated(SpatialRig(), 1, 0.6, 500),
    "poses": at_rest,
}

# ----------------------------------------------------------------------------------------- ways that change nothing


def columns_shuffled(told: Told) -> Told:
    return replace(told, columns=dict(reversed(told.columns.items())))


def clock_of_1970(told: Told) -> Told:
    return told.of(("time",), told.stack(("time",)) + 1.7e9)


def other_zero(told: Told) -> Told:
    moved = {name: 0.4 * (-1) ** i * (0.1 if name[0] == "t" else 1.0) for i, name in enumerate(told.channels)}

    def parameters(values: Values) -> Values:
        return values | {f"bias_{name}": values[f"bias_{name}"] + by for name, by in moved.items()}

    return told.each(lambda name, v: v + moved.get(name, 0.0), parameters=parameters)


def other_sign(told: Told) -> Told:
    """The wrench of the tool on the sensor."""
    sensor = replace(told.rig.sensor, convention=Convention.ON_SENSOR)
    return told.each(
        lambda name, v: -v if name in told.channels else v,
        rig=replace(told.rig, sensor=sensor),
        parameters=lambda values: {k: -v if k.startswith("bias") else v for k, v in values.items()},
    )


def quaternions_negated(told: Told) -> Told:
    return told.of(QUATERNION, -told.stack(QUATERNION))


def base_elsewhere(told: Told) -> Told:
    return told.of(POSITION, told.stack(POSITION) + np.array([1.0, -2.0, 0.5]))


def base_turned(told: Told) -> Told:
    """Poses in the axes of a base that is turned any way; the rig says where gravity points in them."""
    turn = Rotation.from_rotvec([0.7, -1.1, 0.4])
    rig = replace(told.rig, gravity_direction=tuple(turn.apply([0.0, 0.0, -1.0])))
    told = told.of(QUATERNION, continuous((turn * Rotation.from_quat(told.stack(QUATERNION))).as_quat()), rig=rig)
    return told.of(POSITION, turn.apply(told.stack(POSITION))) if "px" in told.columns else told


def continuous(quaternions: Array) -> Array:
    flips = np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0, -1.0, 1.0)
    return np.asarray(quaternions * np.concatenate([[1.0], np.cumprod(flips)])[:, None])


def planar_base_turned(told: Told) -> Told:
    rig = replace(told.rig, gravity_direction=(-np.sin(0.6), -np.cos(0.6)))
    return told.of(("q1",), told.stack(("q1",)) + 0.6, rig=rig)


def planar_mirrored(told: Told) -> Told:
    """The arm in a mirror along its y: joints turn the other way, x' points the other way."""
    return told.each(
        lambda name, v: -v if name in ("fx", "tau") or name.startswith("q") else v,
        parameters=lambda values: {
            k: -v if k.startswith(("bias_fx", "bias_tau", *SIDEWAYS)) else v for k, v in values.items()
        },
    )


def with_sensor_axes(axes: Array) -> Way:
    """The sensor's axes e' = A e (3, 3); a mirror (det A = -1) mirrors the base's y too, and torques are pseudovectors.

    Second moments follow as a tensor, effects that act on the tip axis keep their parameters where A keeps z.
    """
    sign = round(float(np.linalg.det(axes)))
    mirror = np.diag([1.0, sign, 1.0])

    def parameters(values: Values) -> Values:
        def turned(names: tuple[str, ...], factor: float = 1.0) -> Values:
            return dict(zip(names, factor * axes @ [values[name] for name in names], strict=True))

        tensor, (rows, columns) = np.zeros((3, 3)), np.triu_indices(3)
        tensor[rows, columns] = tensor[columns, rows] = [values[name] for name in SECOND]
        moments = dict(zip(SECOND, (axes @ tensor @ axes.T)[rows, columns], strict=True))
        zeros = turned(tuple(f"bias_{n}" for n in FORCE)) | turned(tuple(f"bias_{n}" for n in TORQUE), sign)
        return values | turned(FIRST) | moments | zeros

    def way(told: Told) -> Told:
        matrices = mirror @ Rotation.from_quat(told.stack(QUATERNION)).as_matrix() @ axes.T
        told = told.of(QUATERNION, continuous(Rotation.from_matrix(matrices).as_quat()), parameters=parameters)
        told = told.of(POSITION, told.stack(POSITION) @ mirror) if "px" in told.columns else told
        return told.of(FORCE, told.stack(FORCE) @ axes.T).of(TORQUE, sign * told.stack(TORQUE) @ axes.T)

    return way


axes_permuted = with_sensor_axes(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
mirrored = with_sensor_axes(np.diag([1.0, -1.0, 1.0]))
quarter_turn = with_sensor_axes(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))


def in_units(length: float, mass: float, time: float) -> Way:
    """All in other units of length, mass and time, the rig too: physics does not know them."""
    sizes = {"m": length, "kg": mass, "s": time, "N": mass * length / time**2, "rad": 1.0, "1": 1.0, "": 1.0}
    units = {"time": "s", **dict.fromkeys(POSITION, "m"), **dict.fromkeys(FORCE, "N")}
    units |= dict.fromkeys((*TORQUE, "tau"), "N m")

    def size(unit: str) -> float:
        above, _, below = unit.partition("/")
        factors = [[sizes[name] ** (2 if square else 1) for name, square in re.findall(r"(\w+?)(²?)(?= |$|\))", part)]
                   for part in (above, below)]  # fmt: skip
        return float(np.prod(factors[0]) / np.prod(factors[1]))

    def way(told: Told) -> Told:
        unit_of = {
            p.name: p.unit for p in (*told.model.parameters, *(p for e in FEW for p in (told.model + e).parameters))
        }
        links = told.rig.link_lengths
        rig = replace(
            told.rig,
            gravity=told.rig.gravity * size("m") / size("s") ** 2,
            link_lengths=None if links is None else tuple(size("m") * link for link in links),
            tip_length=None if told.rig.tip_length is None else size("m") * told.rig.tip_length,
        )
        return told.each(
            lambda name, v: v * size(units.get(name, "1")),
            rig=rig,
            parameters=lambda values: {k: v * size(unit_of[k]) for k, v in values.items()},
        )

    return way


def rows_reordered(told: Told) -> Told:
    order = np.random.default_rng(2).permutation(len(told.columns["fx"]))
    return told.each(lambda _, v: v[order])


ANY = (columns_shuffled, other_zero, other_sign, in_units(1.5, 2.0, 1.3))
TIMED = (clock_of_1970,)
PLANAR = (planar_base_turned, planar_mirrored)
SPATIAL = (quaternions_negated, base_turned, axes_permuted, mirrored)
EXACT: Mapping[str, tuple[Way, ...]] = {
    "planar repeats": (*ANY, *TIMED, *PLANAR),
    "planar run": (*ANY, *TIMED, *PLANAR),
    "six-axis repeats": (*ANY, *TIMED, *SPATIAL, base_elsewhere),
    "six-axis run": (*ANY, *TIMED, *SPATIAL, base_elsewhere),
    "poses": (*ANY, *SPATIAL, rows_reordered),
}


def fitted(told: Told) -> Fit:
    return fit(told.model, told.recording)


def moved(before: Told, first: Fit, after: Told, second: Fit) -> Values:
    """By how many std each parameter that the recording shows differs from what becomes of the first."""
    expected = after.parameters(first.values)
    return {
        name: (estimate.value - expected[name]) / estimate.std
        for name, estimate in second.parameters.items()
        if np.isfinite(estimate.std) and estimate.std > 0 and name in expected
    }


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_fit_does_not_depend_on_how_a_recording_is_told(name: str) -> None:
    before = RECORDINGS[name]()
    first = fitted(before)
    for way in EXACT[name]:
        after = way(before)
        steps = moved(before, first, after, fitted(after))
        assert max(map(abs, steps.values())) < ROUNDING, (way, steps)


def columns_with_units(told: Told) -> dict[str, Array]:
    """As loggers name them: ms, degrees, pounds-force and inches."""
    pound, inch = 4.4482216152605, 0.0254
    names = {"time": ("time(ms)", 1e-3), "repeat": ("repeat", 1.0), "tau": ("tau(lbf-in)", pound * inch)}
    names |= {name: (f"{name}(lbf)", pound) for name in ("fx", "fy")}
    names |= {name: (f"{name}(deg)", np.pi / 180) for name in ("q1", "q2", "q3")}
    return {names[name][0]: values / names[name][1] for name, values in told.columns.items()}


def test_units_of_columns_do_not_matter(tmp_path: Path) -> None:
    before = RECORDINGS["planar repeats"]()
    pd.DataFrame(columns_with_units(before)).to_csv(tmp_path / "run.csv", index=False)
    again = fit(before.model, read(tmp_path / "run.csv", rig=before.rig))
    assert max(map(abs, moved(before, fitted(before), before, again).values())) < ROUNDING


# ----------------------------------------------------------------------------- ways that estimate the noise once more


def last_repeat_first(told: Told) -> Told:
    return started(told, len(told.columns["time"]) // told.repeats)


def started_later(told: Told) -> Told:
    """In the middle of a motion that goes on for ever: each repeat is cut elsewhere."""
    return started(told, 77)


def started(told: Told, rows: int) -> Told:
    return told.each(lambda name, v: v if name in ("time", "repeat") else np.roll(v, rows))


def repeats_reordered(told: Told) -> Told:
    order = np.random.default_rng(0).permutation(told.repeats)
    return told.each(lambda name, v: v if name in ("time", "repeat") else v.reshape(len(order), -1)[order].ravel())


def resampled(told: Told) -> Told:
    """At four fifths of the rate, without aliases: the motion is within the band that is left."""
    rows = len(told.columns["time"]) // told.repeats
    fewer = rows * 4 // 5
    columns = {name: resample(values, fewer * told.repeats) for name, values in told.columns.items()}
    columns["time"] = np.arange(fewer * told.repeats) * told.columns["time"][1] * rows / fewer
    columns["repeat"] = np.repeat(np.arange(told.repeats), fewer)
    return replace(told, columns=columns)


REMADE: tuple[Way, ...] = (last_repeat_first, started_later, repeats_reordered, resampled)


def share_of_std(*fits: Fit) -> float:
    """Of a parameter's std, by which estimates differ whose noise powers were estimated from different rows.

    Least squares with weights that are off by d (std of the logarithm of the power) in each line moves an estimate by d
    times its std, to first order and at most; with p channels whose covariance is estimated d² counts p times.
    """
    noises = [noise for one in fits for noise in one.noise]
    parts = [len(noise.floor) * float(noise.log_power_variance.mean()) for noise in noises]
    return float(np.sqrt(2 * np.mean(parts)))


@pytest.mark.parametrize("name", ["planar repeats", "six-axis repeats"])
def test_other_rows_of_the_same_noise_move_a_fit_by_no_more_than_they_must(name: str) -> None:
    """Measured for four repeats: 0.16 std rms in the plane where 0.36 are allowed, 0.25 in six axes of 0.57."""
    before = RECORDINGS[name]()
    first = fitted(before)
    for way in REMADE:
        after = way(before)
        second = fitted(after)
        steps, share = np.array(list(moved(before, first, after, second).values())), share_of_std(first, second)
        assert np.sqrt(np.mean(steps**2)) < share, way
        assert np.abs(steps).max() < 3 * share, way


def test_two_halves_are_the_whole() -> None:
    """Two recordings of four repeats each have a zero of their own, and the std that this costs."""
    whole = simulated(PlanarRig(), 8, 0.0)
    middle = len(whole.columns["time"]) // 2
    halves = [whole.each(lambda _, v, rows=rows: v[rows]) for rows in (slice(middle), slice(middle, None))]  # type: ignore[misc]
    first = fitted(whole)
    second = fit(whole.model, [replace(half.recording, name=str(i)) for i, half in enumerate(halves)])
    share = share_of_std(first, second)
    for name, estimate in second.parameters.items():
        if not name.startswith("bias"):
            one = first.parameters[name]
            allowed = 3 * np.hypot(share * estimate.std, np.sqrt(max(estimate.std**2 - one.std**2, 0.0)))
            assert abs(estimate.value - one.value) < allowed, name


# ------------------------------------------------------------------------------------------------------- diagnoses

WITH_DRAG: Mapping[str, Callable[[], Told]] = {
    "planar repeats": lambda: simulated(PlanarRig(), 4, 0.15),
    "six-axis repeats": lambda: simulated(SpatialRig(), 4, 0.6),
}


def diagnosed(told: Told) -> Diagnosis:
    """In six axes of few candidates, for the time that all take."""
    return diagnose(told.model, told.recording, effects=None if told.plane else FEW)


@pytest.mark.long(seconds=20)
@pytest.mark.parametrize("name", WITH_DRAG)
def test_a_diagnosis_does_not_depend_on_how_a_recording_is_told(name: str) -> None:
    """The drag acts on the tip's axis, so that the sensor is turned about that."""
    before = WITH_DRAG[name]()
    first = diagnosed(before)
    assert first.added == ("viscous_drag",)
    exact = [quarter_turn if way is axes_permuted else way for way in EXACT[name]]
    for way in (*exact, *REMADE):
        after = way(before)
        second = diagnosed(after)
        steps = moved(before, first.fit, after, second.fit)
        assert (second.verdict, second.added) == (first.verdict, first.added), way
        limit = 3 * share_of_std(first.fit, second.fit) if way in REMADE else ROUNDING
        assert max(map(abs, steps.values())) < limit, (way, steps)


# ------------------------------------------------------------------------------------------------ a measured run


@needs(AIS2202)
@pytest.mark.long(seconds=5)
def test_a_measured_run_does_not_depend_on_the_axes_it_is_told_in() -> None:
    """One joint moved, so that Ixx is -4 ± 6 kg m² and would make of the noise of the motion whatever is drawn of it.

    Rows were once weighted by that: half of them left out by lot, zeros and first moments moved by up to 4 std, which
    were up to ten times too small. What the draws say of the ends of the run is left, in second moments.
    """
    rig = Rig.read(AIS2202 / "rig.toml")
    columns = columns_of(pd.read_csv(AIS2202 / "baseline.csv"))
    before = Told({name: v for name, v in columns.items() if not name.startswith("imu")}, rig)
    first = fitted(before)
    assert abs(first.values["m"] - 0.934) < 2 * first.parameters["m"].std
    for way in (quaternions_negated, base_turned, axes_permuted, mirrored):
        after = way(before)
        steps = moved(before, first, after, fitted(after))
        assert max(abs(step) for name, step in steps.items() if name not in SECOND) < 0.1, (way, steps)
        assert max(abs(steps[name]) for name in SECOND) < 1, (way, steps)
