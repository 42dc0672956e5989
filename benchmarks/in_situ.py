"""Calibration in place with added masses: 60 named parameters beside all monomials of degree 4; own simulations.

`python -m benchmarks.in_situ`: a minute on a core. A six-axis sensor on a robot, of the kind that humanoids have in
their limbs (F. J. Andrade Chavez, S. Traversaro and D. Pucci, Sensors 19 (2019) 5521: matrix, zero and temperature
refitted in place with added masses; H. A. O. Mohamed et al., IEEE-RAS Humanoids 2023, arXiv:2312.09846: polynomials,
with which the error of the forces fell from 4.58 N, affine, to 2.28 N). Neither their data nor their code is here.

The readings are s + a s² + b s³ of s = matrix · wrench, with a zero that rises with the temperature; gains are wrong by
up to 5 %, crosstalk is up to 2 %, the nonlinearity 3 % and 4 % of 200 N. A second sensor has what no named effect is:
products of two channels (2 % of 200 N), and gains that rise by 0.1 % a kelvin. Recorded are the tool and three added
masses, each in two motions and while the sensor warms up by 10 K; then one of the masses again, another one, one
heavier than any, and one 8 K warmer, in other motions.

raw         readings less their mean error with the empty tool
affine      wrench = C reading + zero, least squares
with T      the same, and a column of the temperature
degree 4    all 330 monomials of six channels and the temperature up to degree 4, for each channel; the ridge is chosen
            by leaving out one load after the other
named       gain, crosstalk, quadratic and cubic gain, zero and its rise with the temperature: 60 parameters

Those in between are told the true wrench of every training sample, as from a robot's model without error; the last is
told the added masses alone, and estimates the tool, with its ten parameters, beside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
import numpy.typing as npt

import truewrench as tw
from estimation.fit import Fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.rigid_body import Load
from modeling.table import Column, Table
from tests.shared.rigs import carrying
from truewrench.simulated_rig import SpatialRig, simulate

Array = npt.NDArray[np.float64]
Correction = Callable[[Array, Array], Array]
"""Wrenches (n, 6) of readings (n, 6) and temperatures (n,)."""

RIG = SpatialRig()
CHANNELS = RIG.channels
SIZE = np.array([200.0] * 3 + [20.0] * 3)
"""N and N m, the largest loads."""
NOISE = np.array([0.25] * 3 + [0.01] * 3)
"""Std of a sample, N and N m."""
TRAINING = {
    "empty": None,
    "four": Load(mass=4.0, at=(0.0, 0.0, 0.05)),
    "eight": Load(mass=8.0, at=(0.05, -0.03, 0.08)),
    "twelve": Load(mass=12.0, at=(-0.04, 0.05, 0.04)),
}
RUNS = 2
"""Of each, in motions of their own."""
HELD_OUT = {
    "8 kg again": (TRAINING["eight"], 0.0),
    "10 kg": (Load(mass=10.0, at=(0.03, 0.04, 0.06)), 0.0),
    "15 kg": (Load(mass=15.0, at=(0.02, -0.02, 0.05)), 0.0),
    "8 K warmer": (Load(mass=10.0, at=(0.03, 0.04, 0.06)), 8.0),
}
"""Load, and by how much it is warmer, K."""
COLD, WARM = 22.0, 32.0
"""°C, from which every recording warms up, and towards which."""
EFFECTS = ("gain", "sensor_crosstalk", "gain_nonlinearity", "thermal_drift")
REPEATS, SAMPLES = 4, 200
"""Of each recording, and samples of each."""
STEPS = 6
"""Of Newton, to 1e-12."""
DEGREE = 4
RIDGES = 10.0 ** np.arange(-9, 2)
"""Shares of the number of samples, of monomials of unit size."""


@dataclass(frozen=True, eq=False)
class TrueSensor:
    """What the simulated sensor reads; `unnamed` is the size of what no named effect is."""

    matrix: Array
    unnamed: float

    @classmethod
    def random(cls, seed: int, unnamed: float) -> TrueSensor:
        """Gains within 5 %, crosstalk within 2 %."""
        rng = np.random.default_rng(seed)
        crosstalk = rng.uniform(-0.02, 0.02, (6, 6)) * SIZE[:, None] / SIZE
        np.fill_diagonal(crosstalk, 0.0)
        return cls((np.eye(6) + crosstalk) @ np.diag(1 + rng.uniform(-0.05, 0.05, 6)), unnamed)

    def reads(self, wrench: Array, temperature: Array, rng: np.random.Generator) -> Array:
        """Readings (n, 6) with noise of true wrenches (n, 6) at temperatures (n,)."""
        strain = wrench @ self.matrix.T / SIZE
        warm = (temperature - 20.0)[:, None]
        signs = np.array([1, -1, 1, 1, -1, -1])
        reading = strain + 0.03 * signs * strain**2 - 0.04 * np.roll(signs, 1) * strain**3
        reading += self.unnamed * (0.02 * strain * np.roll(strain, 1, axis=1) + 0.001 * warm * strain)
        reading += np.array([0.01, -0.02, 0.03, 0.02, 0.01, -0.01]) + 0.002 * signs * warm
        return np.asarray(reading * SIZE + rng.normal(size=wrench.shape) * NOISE)


@dataclass(frozen=True, eq=False)
class Recorded:
    """True wrenches (n, 6), readings (n, 6) and temperatures (n,), and the recording that has them."""

    wrench: Array
    reading: Array
    temperature: Array
    recording: Recording


def recorded(name: str, sensor: TrueSensor, load: Load | None, motion: int, warmer: float = 0.0) -> Recorded:
    """One recording: four periods of a random motion."""
    rig = RIG if load is None or load.mass is None else carrying(RIG, load.mass, load.at)
    rig = replace(rig, noise=(1e-9,) * len(CHANNELS))
    frame = simulate(rig, rig.random_motion(seed=motion), repeats=REPEATS, samples_per_period=SAMPLES)
    columns = {str(column): frame[column].to_numpy() for column in frame}
    wrench = frame[list(CHANNELS)].to_numpy() - np.array(RIG.bias)
    temperature = warmer + WARM + (COLD - WARM) * np.exp(-columns["time"] / 8.0)
    reading = sensor.reads(wrench, temperature, np.random.default_rng([motion, 1]))
    columns |= dict(zip(CHANNELS, reading.T, strict=True)) | {"temperature": temperature}
    return Recorded(wrench, reading, temperature, from_columns(columns, name=name))


def monomials(reading: Array, temperature: Array, degree: int) -> Array:
    """All products (n, m) of the channels and the temperature up to a degree, of variables of unit size."""
    variables = np.column_stack([reading / SIZE, (temperature - 28.0) / 5.0])
    terms = [np.ones(len(variables))]
    for order in range(1, degree + 1):
        terms += [variables[:, c].prod(axis=1) for c in map(list, combinations_with_replacement(range(7), order))]
    return np.stack(terms, axis=1)


def polynomial(several: Sequence[Recorded], degree: int, *, with_temperature: bool = True) -> Correction:
    """Least squares of the true wrenches on the monomials; above degree 1 with a ridge, by loads left out."""

    def rows(reading: Array, temperature: Array) -> Array:
        return monomials(reading, temperature if with_temperature else np.full_like(temperature, 28.0), degree)

    columns = [rows(one.reading, one.temperature) for one in several]

    def coefficients(among: Sequence[int], ridge: float) -> Array:
        whole = np.vstack([columns[i] for i in among])
        targets = np.vstack([several[i].wrench for i in among])
        penalty = np.sqrt(ridge * len(whole)) * np.eye(whole.shape[1])
        stacked = np.vstack([whole, penalty]), np.vstack([targets, np.zeros((len(penalty), 6))])
        return np.asarray(np.linalg.lstsq(*stacked, rcond=None)[0])

    def error(ridge: float) -> float:
        """Of the recordings of each load by a polynomial of the others."""
        left = [
            (columns[i] @ coefficients([j for j in everyone if j // RUNS != i // RUNS], ridge) - several[i].wrench)
            for i in everyone
        ]
        return float(np.mean(np.square(np.vstack(left) / SIZE)))

    everyone = range(len(several))
    ridge = 0.0 if degree == 1 else min(RIDGES, key=error)
    weights = coefficients(everyone, ridge)
    return lambda reading, temperature: rows(reading, temperature) @ weights


def raw(several: Sequence[Recorded]) -> Correction:
    """Readings less their mean error with the empty tool."""
    zero = (several[0].reading - several[0].wrench).mean(axis=0)
    return lambda reading, temperature: reading - zero


def named(several: Sequence[Recorded], loads: Mapping[str, Load]) -> tuple[Correction, Fit]:
    """The inverse of the fitted chain: zero, the nonlinearity of each channel, the matrix."""
    model = tw.spatial()
    for effect in EFFECTS:
        model = model + effect
    fitted = tw.fit(model, {one.recording.name: one.recording for one in several}, loads=loads)
    sensor, values = tw.sensor_matrix(fitted), fitted.values
    quadratic, cubic = (np.array([values[f"gain_nonlinearity.{c}_{power}"] for c in CHANNELS]) for power in (2, 3))
    rise = np.array([values[f"thermal_drift.{c}"] for c in CHANNELS])

    def corrected(reading: Array, temperature: Array) -> Array:
        target = reading - sensor.zero - (temperature[:, None] - 20.0) * rise
        strain = target.copy()
        for _ in range(STEPS):
            error = strain + quadratic * strain**2 + cubic * strain**3 - target
            strain = strain - error / (1 + 2 * quadratic * strain + 3 * cubic * strain**2)
        return np.asarray(strain @ sensor.correction.T)

    return corrected, fitted


def errors(correction: Correction, held_out: Recorded) -> tuple[float, float]:
    """Root mean square of the errors of the forces, N, and of the torques, N m."""
    error = correction(held_out.reading, held_out.temperature) - held_out.wrench
    return float(np.sqrt(np.mean(error[:, :3] ** 2))), float(np.sqrt(np.mean(error[:, 3:] ** 2)))


def compared(unnamed: float, seed: int = 1) -> Table:
    """The corrections on one sensor, with the errors of each on the held-out recordings."""
    sensor = TrueSensor.random(seed, unnamed)
    both = [(f"{name} {run}", load) for name, load in TRAINING.items() for run in range(1, 1 + RUNS)]
    several = [recorded(name, sensor, load, number) for number, (name, load) in enumerate(both, 1)]
    others = {n: recorded(n, sensor, load, 21 + i, k) for i, (n, (load, k)) in enumerate(HELD_OUT.items())}
    ours, fitted = named(several, {name: load for name, load in both if load is not None})
    of_sensor = len(fitted.model.parameters) - 10
    corrections = {
        ("raw", 6): raw(several),
        ("affine", 7 * 6): polynomial(several, 1, with_temperature=False),
        ("with T", 8 * 6): polynomial(several, 1),
        (f"degree {DEGREE}", 6 * monomials(np.ones((1, 6)), np.ones(1), DEGREE).shape[1]): polynomial(several, DEGREE),
        ("named", of_sensor): ours,
    }
    rows = [
        (name, count, *(e for one in others.values() for e in errors(correction, one)))
        for (name, count), correction in corrections.items()
    ]
    units = (Column(f"{name}, {unit}", format=".3g") for name in others for unit in ("N", "N m"))
    return Table.of(("correction", Column("numbers", format="d"), *units), rows)


def main() -> None:
    """Print both tables."""
    for title, unnamed in (("The sensor has what the names say", 0.0), ("And products of channels, warm gains", 1.0)):
        print(f"{title}: RMS error on held-out recordings; the noise is {NOISE[0]:g} N and {NOISE[-1]:g} N m.")
        print(f"{compared(unnamed)}\n")


if __name__ == "__main__":
    main()
