"""What noise of the motion does to plain least squares, and what is left of it with errors in variables.

`python -m benchmarks.noisy_motion [DRAWS]`, 100 draws unless given. MuJoCo simulates the readings of a rig; the
motion is logged with noise (std in the table's heading), and both noises are drawn anew each time. Errors are in units
of the std that the corrected fit states: means within ±0.1 (a standard error, of 100) are no bias, and a coverage of
95 ± 2 % is right.

plain       `fit`, which takes the logged motion for true
weighted    least squares with the weights of the corrected fit: what is left of the bias when only those change
corrected   `errors_in_variables_fit`

The last table compares it with orthogonal distance regression where something else is wrong too: the readings' noise
is stated wrongly, or the model misses a drag. There the mean is counted from what least squares finds from the true
motion with the same weights, so that only the noise of the motion speaks.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.orthogonal_regression import orthogonal
from estimation.errors_in_variables import errors_in_variables_fit
from estimation.fit import Fit, fit
from estimation.input_noise import InputNoise
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Convention, Rig, SensorDescription
from modeling.table import Table
from truewrench.simulated_rig import (
    HiddenEffect,
    NoiseModel,
    PlanarRig,
    SpatialRig,
    ViscousDrag,
    simulate,
    static_poses,
)

Array = npt.NDArray[np.float64]
Columns = dict[str, Array]

DRAWS = 100
SAMPLES = 250
"""Of one period of 5 s."""
ARM, TOOL = PlanarRig(), SpatialRig()
INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")


class Silence(NoiseModel):
    """No noise of the readings: it is added here, draw by draw."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Zeros."""
        return np.zeros((samples, channels))


@dataclass(frozen=True, eq=False)
class Case:
    """A rig, what of its motion is logged, and how noisily.

    std      of one sample of the logged signals, SI
    repeats  of one period, averaged before the fit; for poses, how many times each is taken
    measured whether the noise of the motion is measured from the repeats, or stated
    stated   what the rig says of the noise of the readings, over what it is
    """

    title: str
    model: WrenchModel
    clean: Callable[[], Columns]
    std: Mapping[str, float]
    repeats: int = 1
    measured: bool = False
    stated: float = 1.0

    @property
    def rig(self) -> PlanarRig | SpatialRig:
        """The simulated rig."""
        return ARM if self.model.channels == ARM.channels else TOOL

    @property
    def truth(self) -> dict[str, float]:
        """Bias and body of the rig by the model's names."""
        biases = {f"bias_{c}": value for c, value in zip(self.rig.channels, self.rig.bias, strict=True)}
        if isinstance(self.rig, PlanarRig):
            return biases | {"m": self.rig.mass, "mlg": self.rig.mlg, "I": self.rig.inertia}
        first = dict(zip(("mx", "my", "mz"), self.rig.first_moment, strict=True))
        return biases | {"m": self.rig.mass} | first | dict(zip(INERTIA, self.rig.inertia, strict=True))

    def recording(self, seed: int) -> Recording:
        """One draw of both noises."""
        rng, clean = np.random.default_rng([seed, 77]), self.clean()
        columns = {name: np.tile(values, self.repeats) for name, values in clean.items()}
        rows = len(columns["fx"])
        for name, std in self.std.items():
            if name in columns:
                columns[name] = columns[name] + std * rng.standard_normal(rows)
        if "turn_x" in self.std:
            columns |= turned(columns, np.array(list(self.std.values())) * rng.standard_normal((rows, 3)))
        for channel, std in zip(self.rig.channels, self.rig.noise, strict=True):
            columns[channel] = columns[channel] + std * rng.standard_normal(rows)
        if self.repeats > 1:
            columns["repeat"] = np.repeat(np.arange(self.repeats, dtype=float), rows // self.repeats)
        if "time" in columns:
            columns["time"] = np.arange(rows) * clean["time"][1]
        return from_columns(columns, rig=self.described)

    def noiseless(self) -> Recording:
        """One period with neither noise."""
        return from_columns(self.clean(), rig=self.described)

    @property
    def described(self) -> Rig:
        """The rig as its file says it is."""
        noise = {c: self.stated * std for c, std in zip(self.rig.channels, self.rig.noise, strict=True)}
        lengths = self.rig.link_lengths if isinstance(self.rig, PlanarRig) else None
        return Rig(link_lengths=lengths, sensor=SensorDescription(noise=noise))

    @property
    def input_noise(self) -> InputNoise | None:
        """What the estimator is told of the noise of the motion."""
        return None if self.measured else InputNoise.stated(self.std)


def turned(columns: Columns, by: Array) -> Columns:
    """The orientation turned by rotation vectors (n, 3), rad, in the sensor frame."""
    names = ("qx", "qy", "qz", "qw")
    true = Rotation.from_quat(np.stack([columns[name] for name in names], axis=1))
    return dict(zip(names, (true * Rotation.from_rotvec(by)).as_quat().T, strict=True))


@cache
def planar_run(hidden: tuple[HiddenEffect, ...] = ()) -> Columns:
    """One period of the arm: readings by MuJoCo, the sensor's motion by the kinematics of 22.2."""
    motion = ARM.random_motion(seed=5)
    frame = simulate(ARM, motion, hidden=hidden, repeats=1, samples_per_period=SAMPLES, noise=Silence())
    columns = {name: frame[name].to_numpy(dtype=float) for name in ("time", *ARM.channels)}
    pose = PlanarArm(ARM.link_lengths).pose(*motion.evaluate(columns["time"]))
    return columns | {name: pose[name] for name in ("phi", "dphi", "ddphi", "ax", "ay")}


@cache
def planar_poses() -> Columns:
    """24 poses of the arm at rest, as joint angles."""
    frame = static_poses(ARM, 24, noise=Silence(), seed=3)
    return {name: frame[name].to_numpy(dtype=float) for name in ("q1", "q2", "q3", *ARM.channels)}


@cache
def spatial_poses() -> Columns:
    """24 poses of the tool at rest, as quaternions."""
    frame = static_poses(TOOL, 24, noise=Silence(), seed=3)
    return {name: frame[name].to_numpy(dtype=float) for name in ("qx", "qy", "qz", "qw", *TOOL.channels)}


LOGGED = {"ax": 1.0, "ay": 1.0, "dphi": 0.2, "ddphi": 2.0}
TOLD = spatial(Rig(sensor=SensorDescription(convention=Convention.ON_TOOL)))
CASES = (
    Case("one run of 250 samples", planar(), planar_run, LOGGED),
    Case("4 repeats, averaged", planar(), planar_run, LOGGED, repeats=4, measured=True),
    Case("16 repeats, averaged", planar(), planar_run, LOGGED, repeats=16, measured=True),
    Case("24 poses of the arm", planar(), planar_poses, dict.fromkeys(("q1", "q2", "q3"), 0.06)),
    Case("24 poses in six axes", TOLD, spatial_poses, dict.fromkeys(("turn_x", "turn_y", "turn_z"), 0.05)),
)


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of one way to fit over the draws: in units of the corrected fit's std, and in units of its own; (d, k)."""

    names: tuple[str, ...]
    common: Array
    own: Array

    @classmethod
    def of(cls, fits: list[Fit], unit: list[Fit], truth: Mapping[str, float]) -> Errors:
        """Of the unknowns in `truth`."""
        error = np.array([[f.values[name] - value for name, value in truth.items()] for f in fits])
        common, own = (np.array([[f.parameters[n].std for n in truth] for f in chosen]) for chosen in (unit, fits))
        return cls(tuple(truth), error / common, error / own)

    def mean(self, i: int) -> str:
        """Mean and its standard error."""
        column = self.common[:, i]
        return f"{column.mean():+.2f} ± {column.std(ddof=1) / np.sqrt(len(column)):.2f}"

    def coverage(self, i: int) -> str:
        """Share of the draws whose 95 % interval holds the truth."""
        return f"{100 * np.mean(np.abs(self.own[:, i]) < 1.96):.0f} %"


def study(case: Case, draws: int) -> dict[str, Errors]:
    """Errors of every way to fit."""
    recordings = [case.recording(seed) for seed in range(draws)]
    plain = [fit(case.model, r) for r in recordings]
    found = [errors_in_variables_fit(case.model, r, input_noise=case.input_noise) for r in recordings]
    corrected, weighted = [f.corrected for f in found], [f.plain for f in found]
    truth = {name: value for name, value in case.truth.items() if np.isfinite(corrected[0].parameters[name].std)}
    ways = {"plain": plain, "weighted": weighted, "corrected": corrected}
    return {way: Errors.of(fits, corrected, truth) for way, fits in ways.items()}


def report(case: Case, draws: int) -> str:
    """The table of a case."""
    found = study(case, draws)
    header = ("parameter", *(f"{way}: error" for way in found), *(f"{way}: 95 %" for way in found))
    ways = list(found.values())
    names = ways[0].names
    rows = [(n, *(e.mean(i) for e in ways), *(e.coverage(i) for e in ways)) for i, n in enumerate(names)]
    heading = f"{case.title}; noise of the motion: {InputNoise.stated(case.std)}"
    return f"{heading}\n{Table.of(header, rows)}"


WRONG: Mapping[str, tuple[float, tuple[HiddenEffect, ...]]] = {
    "nothing": (1.0, ()),
    "noise stated as half": (0.5, ()),
    "noise stated as double": (2.0, ()),
    "a drag of 0.5 N s/m missed": (1.0, (ViscousDrag(c=0.5),)),
}


def against_orthogonal(draws: int) -> str:
    """Mean errors of m, mlg and I, in std, of the corrected fit and of orthogonal regression."""
    header = ("what else is wrong", *(f"{n}: {way}" for n in ("m", "mlg", "I") for way in ("corrected", "orthogonal")))
    rows = [(title, *_against(factor, hidden, draws)) for title, (factor, hidden) in WRONG.items()]
    return f"corrected against orthogonal regression, {draws} draws of one run\n{Table.of(header, rows)}"


def _against(factor: float, hidden: tuple[HiddenEffect, ...], draws: int) -> list[str]:
    clean = planar_run(hidden)
    case = Case("", planar(), lambda: clean, LOGGED, stated=factor)
    floor, inputs = factor * np.array(ARM.noise), InputNoise.stated(LOGGED)
    several = [case.recording(seed) for seed in range(draws)]
    found = [errors_in_variables_fit(planar(), r, input_noise=inputs) for r in several]
    target = fit(planar(), case.noiseless(), noise=found[0].plain.noise).theta
    others = [orthogonal(planar(), r, inputs, floor, f.corrected.theta) for r, f in zip(several, found, strict=True)]
    std = np.mean([np.sqrt(np.diag(f.corrected.covariance)) for f in found], axis=0)
    means = (np.mean([f.corrected.theta for f in found], axis=0), np.mean(others, axis=0))
    return [f"{(mean - target)[i] / std[i]:+.2f}" for i in (3, 4, 5) for mean in means]


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS
    for chosen in CASES:
        print(report(chosen, count), end="\n\n")
    print(against_orthogonal(count))
