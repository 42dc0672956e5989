"""Table 22.1 of the chapter, run again on a simulated rig: `python -m benchmarks.published chapter`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import truewrench as tw
from modeling.rig import STANDARD_GRAVITY
from truewrench.simulated_rig import HiddenEffect, JointBacklash, JointElasticity

Array = NDArray[np.float64]
Rows = Mapping[tuple[str, ...], Sequence[float | str]]

HERE = "rerun here"
CHAPTER = "Bassi et al."
"""Bassi, Benzi, Capisani, Cuppone, Ferrara, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (chapter 22). Table 22.1 has variances of the residuals of fx', fy' (N²) and tau (N² m²): of ten of the 30
runs, each fitted by itself, of their average S, and of another motion V, predicted with the parameters of S."""
PRINTED_RUNS = np.array(
    [
        (0.819, 2.207, 0.002), (0.469, 3.435, 0.029), (0.672, 2.170, 0.008), (0.740, 3.645, 0.033),
        (0.575, 2.610, 0.003), (0.697, 2.516, 0.002), (0.778, 2.784, 0.006), (0.658, 2.320, 0.007),
        (0.644, 2.202, 0.024), (0.653, 2.649, 0.003),
    ]
)  # fmt: skip
PRINTED_S, PRINTED_V = np.array([0.037, 0.110, 0.000]), np.array([0.464, 1.597, 0.001])
PRINTED_MEAN, PRINTED_MEAN_V = np.array([0.849e-13, 0.195e-13, 0.108e-13]), np.array([0.005, 0.287, -0.001])
"""Of the ten runs the largest mean of a residual, N and N m; that of V."""
RUNS, SHOWN = 30, 10
SAMPLES = round(2 / np.mean((PRINTED_RUNS[:, :2].std(axis=0, ddof=1) / PRINTED_RUNS[:, :2].mean(axis=0)) ** 2))
"""Independent samples in a run, 67. The chapter does not say how many there are: a variance of n of them scatters by
sqrt(2 / n) of itself, and the variances of the forces do so over the ten runs."""
THETA = (15.0119, 0.2465, -1.3342, 0.2630, 0.0127, 0.018)
"""22.18, as the truth of the simulation: biases (N, N, N m), m (kg), m l_g (kg m), I (kg m²)."""


class Neglected(NamedTuple):
    """What the chapter says that it neglects, the same in each joint, by its size; its unit, a size to begin with."""

    of: Callable[[float], HiddenEffect]
    unit: str
    small: float


EFFECTS = {
    "elastic joints": Neglected(lambda size: JointElasticity(compliance=(size, size, size)), "rad/(N m)", 0.001),
    "play in the joints": Neglected(lambda size: JointBacklash(width=(size, size, size)), "rad", 0.01),
}
"""As large as leaves the remainder of the table in fx'."""


def chapter_regressor(signals: dict[str, Array]) -> Array:
    """(n, 3, 6): 22.8 with 22.9, as they are printed."""
    phi, ax, ay, ddphi = (signals[name] for name in ("phi", "ax", "ay", "ddphi"))
    along = ay + STANDARD_GRAVITY
    m1, m3 = ax * np.cos(phi) - along * np.sin(phi), -(ax * np.sin(phi) + along * np.cos(phi))
    regressor = np.zeros((len(phi), 3, 6))
    regressor[:, range(3), range(3)] = 1.0
    regressor[:, 0, 3:5] = regressor[:, 2, 4:6] = np.column_stack([m1, ddphi])
    regressor[:, 1, 3:5] = np.column_stack([m3, signals["dphi"] ** 2])
    return regressor


@dataclass(frozen=True)
class ChapterRig:
    """The chapter's rig, simulated without noise: its lengths are assumed, its motion is 22.17, read in degrees.

    Attributes: `readings` (2, n, 3) of the motion and of another one, `regressors` (2, n, 3, 6).
    """

    readings: Array
    regressors: Array

    @classmethod
    def of(cls, *hidden: HiddenEffect) -> ChapterRig:
        """With effects that the chapter's model lacks."""
        bias, (mass, mlg, inertia) = THETA[:3], THETA[3:]
        arm = tw.simulated_rig.PlanarRig(mass=mass, mlg=mlg, inertia=inertia, bias=bias, noise=(0.0, 0.0, 0.0))
        rig = tw.Rig.from_data({"robot": {"link_lengths": list(arm.link_lengths)}})
        readings, regressors = [], []
        for motion in (tw.PaperSeries(period=5.0).chapter_optimum, arm.random_motion(seed=1)):
            frame = tw.simulate(arm, motion, hidden=hidden, repeats=2, samples_per_period=SAMPLES)
            recording = tw.from_dataframe(frame, rig=rig)
            readings.append(recording.wrench[:SAMPLES])
            regressors.append(chapter_regressor({k: v[:SAMPLES] for k, v in recording.signals.items()}))
        return cls(np.array(readings), np.array(regressors))

    def table(self, noise: Array, rng: np.random.Generator) -> dict[str, Array]:
        """The rows of a Table 22.1 with white noise of this std (3,) in every run, by ordinary least squares."""

        def residual(wrench: Array, theta: Array | None = None, motion: int = 0) -> tuple[Array, Array]:
            phi = self.regressors[motion]
            if theta is None:
                theta = np.linalg.lstsq(phi.reshape(-1, 6), wrench.ravel(), rcond=None)[0]
            return wrench - phi @ theta, theta

        runs = self.readings[0] + rng.normal(0.0, noise, (RUNS, SAMPLES, 3))
        singles = np.array([residual(run)[0] for run in runs[:SHOWN]])
        averaged, theta = residual(runs.mean(axis=0))
        other, _ = residual(self.readings[1] + rng.normal(0.0, noise, (SAMPLES, 3)), theta, motion=1)
        largest = np.abs(singles.mean(axis=1)).max(axis=0)
        return rows_of_table(singles.var(axis=1), averaged.var(axis=0), other.var(axis=0), largest, other.mean(axis=0))


def rows_of_table(runs: Array, averaged: Array, validation: Array, mean: Array, mean_v: Array) -> dict[str, Array]:
    """What is compared: variances of single runs (k, 3), of their average and of V, and means of the residuals."""
    return {
        "variance of single runs, mean of ten": runs.mean(axis=0),
        "variance of single runs, std over ten": runs.std(axis=0, ddof=1),
        "variance of the average, S": averaged,
        REMAINDER: (RUNS * averaged - runs.mean(axis=0)) / (RUNS - 1),
        "variance of another motion, V": validation,
        "mean of a single run, largest of ten": mean,
        "mean of another motion, V": mean_v,
    }


REMAINDER = "what averaging leaves, squared"


def chapter_table(effects: Sequence[str] = tuple(EFFECTS), draws: int = 200, seed: int = 0) -> pd.DataFrame:
    """Table 22.1, N² and N² m², means in N and N m: printed; and of simulated rigs the mean of `draws` ± std of one."""
    printed = rows_of_table(PRINTED_RUNS, PRINTED_S, PRINTED_V, PRINTED_MEAN, PRINTED_MEAN_V)
    # Of the torque as in V: ordinary least squares of one run puts some of the forces' noise into its residual.
    noise = np.sqrt(np.r_[(PRINTED_RUNS.mean(axis=0) - PRINTED_S)[:2] * RUNS / (RUNS - 1), PRINTED_V[2]])
    rng = np.random.default_rng(seed)
    rigs = {"rigid tool": ChapterRig.of()}
    for name in effects:
        neglected, size = EFFECTS[name], EFFECTS[name].small
        for _ in range(2):  # nearly linear in the size
            left = ChapterRig.of(neglected.of(size)).table(np.zeros(3), rng)[REMAINDER][0]
            size *= float(np.sqrt(printed[REMAINDER][0] / left))
        rigs[f"{name}, {size:.2g} {neglected.unit}"] = ChapterRig.of(neglected.of(size))
    simulated = {name: [rig.table(noise, rng) for _ in range(draws)] for name, rig in rigs.items()}
    rows: dict[tuple[str, ...], list[float]] = {}
    for row, values in printed.items():
        rows[row, CHAPTER, "measured"] = [n for value in values.tolist() for n in (value, np.nan)]
        for name, tables in simulated.items():
            of_row = np.array([table[row] for table in tables])
            rows[row, HERE, name] = np.column_stack([of_row.mean(0), of_row.std(0)]).ravel().tolist()
    columns = [column for name in ("fx'", "fy'", "tau") for column in (name, f"± {name}")]
    return framed(rows, ("row", "by", "way"), columns)


def framed(rows: Rows, names: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """A table of rows by the entries of its index, which have these names."""
    index = pd.MultiIndex.from_tuples(list(rows), names=[*names])
    return pd.DataFrame(list(rows.values()), index=index, columns=list(columns))


def readable(table: pd.DataFrame) -> pd.DataFrame:
    """The table as texts of three digits, a column `± name` joined to that of the name."""

    def text(value: object, half: object = None) -> str:
        if not isinstance(value, float):
            return str(value)
        return f"{value:.3g}" if not isinstance(half, float) or np.isnan(half) else f"{value:.3g} ± {half:.2g}"

    shown = {
        name: list(map(text, table[name], table.get(f"± {name}", [None] * len(table))))
        for name in table.columns
        if not name.startswith("± ")
    }
    return pd.DataFrame(shown, index=table.index)
