"""Published tables, run again: `python -m benchmarks.published [tools|rig|contact|chapter ..]`, about half a minute.

Each row says who published a figure, or that it was rerun here. What was published is a constant with its source beside
it; everything else is computed from the recordings at TRUEWRENCH_DATA, by default ../shared/data beside the repository.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

import truewrench as tw
from benchmarks.contact_lag import forces_by_lag
from benchmarks.published_runs import HERE, chapter_table, framed, readable
from estimation.fit import Fit
from modeling.rig import STANDARD_GRAVITY

Array = NDArray[np.float64]

DATA = Path(os.environ.get("TRUEWRENCH_DATA") or Path(__file__).parents[2] / "shared" / "data")
CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
TRIANGLE = np.triu_indices(3)


# Tools of known inertia ---------------------------------------------------------------------------------------------

NADEAU = "Nadeau et al., 2023"
"""Nadeau, Giamou, Kelly, "The Sum of Its Parts: Visual Part Segmentation for Inertial Parameter Identification of
Manipulated Objects" (ICRA 2023, arXiv 2302.06685); ten of their twenty tools. Boxes, noises and errors below are taken
from the authors' repository, github.com/utiasSTARS/inertial-identification-with-part-segmentation at 48928088: meshes
and point clouds of `data`, `RunExperiments.py` and `Experiments/results.pkl` of `inertial-parameters-identification`.
"""


class Noise(NamedTuple):
    """Std of white noise of a sample: forces N, torques N m, and what they added to accelerations, m/s², rad/s²."""

    force: float
    torque: float
    acceleration: float
    angular: float


NOISES = {
    "low": Noise(0.05, 0.0025, 0.025, 0.25),
    "moderate": Noise(0.1, 0.005, 0.05, 0.5),
    "high": Noise(0.2, 0.01, 0.1, 1.0),
}
"""The first is that of the recordings as they stand."""
GRAVITY = 9.81
"""m/s², along +z: the wrench of these recordings is m (g + a), that of no rigid body under gravity along -z. The
authors' regressor has the same sign, so that it does not show there."""

Box = tuple[float, float, float, float, float, float]
BOXES: dict[str, tuple[Box, tuple[float, float, float]]] = {
    "Adjustable_Wrench": ((-77.4, 226.6, -39.8, 40.0, -10.1, 10.1), (313.3, 83.8, 31.6)),
    "Bent_Jaw_Pliers": ((-74.2, 8.7, -120.1, 33.0, -31.2, 7.4), (87.2, 155.9, 41.3)),
    "C_Clamp": ((-34.3, 68.1, -18.0, 33.4, -7.7, 150.1), (104.8, 47.9, 161.9)),
    "Electronic_Caliper": ((-29.0, 47.7, -187.2, 78.7, -5.7, 10.5), (75.7, 266.0, 24.6)),
    "File": ((-7.4, 7.9, -17.8, 152.1, -7.5, 7.7), (20.6, 173.2, 20.0)),
    "Hammer": ((-15.7, 15.7, -70.1, 241.6, -63.1, 61.1), (40.0, 318.7, 131.9)),
    "Measuring_Tape": ((-30.0, 23.1, -14.1, 10.2, -4.4, 56.7), (54.9, 25.4, 60.6)),
    "Pliers": ((-228.3, 19.0, -12.0, 10.5, -13.6, 46.4), (252.0, 31.5, 66.6)),
    "Rubber_Mallet": ((-26.1, 23.3, -57.3, 210.8, -49.6, 52.2), (56.1, 275.5, 109.6)),
    "Socket_Wrench": ((-17.6, 17.6, -35.6, 167.6, -9.9, 37.6), (38.3, 209.3, 53.4)),
}
"""mm, along the sensor's axes from its origin: the box of the mesh, 0.1 mm wider to every side, as (xmin, xmax, ymin,
ymax, zmin, zmax); and the extent of the point cloud that the published errors are relative to."""

PUBLISHED = {
    ("low", "OLS"): (10, 0.099, 1.500, 450.629, 68.177),
    ("low", "GEO"): (100, 0.044, 1.267, 57.713, 56.591),
    ("low", "HPS"): (100, 0.482, 0.600, 11.223, 8.781),
    ("moderate", "OLS"): (0, 0.096, 1.933, 853.650, 114.390),
    ("moderate", "GEO"): (100, 0.217, 1.300, 56.049, 55.420),
    ("moderate", "HPS"): (100, 0.450, 0.400, 10.560, 10.276),
    ("high", "OLS"): (0, 0.736, 3.833, 796.942, 257.772),
    ("high", "GEO"): (100, 0.217, 1.533, 53.172, 54.391),
    ("high", "HPS"): (100, 1.445, 1.200, 11.519, 10.011),
}
"""Of these ten tools, all in %: consistent inertia, means of the errors of mass, centre and inertia, and median of the
last. OLS: ten parameters, ordinary least squares. GEO: with a prior of the true mass and the shape in a geodesic
distance. HPS: masses of the parts that a camera shows. The centre's errors are cut to whole per cent, axis by axis,
before the mean."""


TOOLS = tuple(BOXES)
PRIOR_WEIGHT = 8.0
"""Of a homogeneous box as reference: like a measurement of each principal moment to sqrt(2 / 8) = 50 %, by which such a
box errs. With 2 and with 50 instead, the errors differ by a third at most."""


@dataclass(frozen=True)
class Tool:
    """A tool of `DATA / workshop_tools`: its recording as a table, and what it weighs.

    Attributes: `parameters` (10,) m, first moment (kg m) and inertia about the sensor's origin (kg m²; xx, xy, xz, yy,
    yz, zz) in sensor axes.
    """

    name: str

    @cached_property
    def frame(self) -> pd.DataFrame:
        """Time, position, orientation and wrench, a row a sample."""
        return pd.read_csv(DATA / "workshop_tools" / self.name / "run.csv")

    @cached_property
    def parameters(self) -> Array:
        """The ten numbers of `truth.json`."""
        true = json.loads((DATA / "workshop_tools" / self.name / "truth.json").read_text(encoding="utf-8"))
        inertia = np.array(true["inertia_about_sensor"])
        return np.concatenate([[true["m"]], true["m"] * np.array(true["com"]), inertia[TRIANGLE]])

    def noisier(self, noise: Noise, rng: np.random.Generator) -> pd.DataFrame:
        """The recording with white noise added to its own, so that both together have these std."""
        own, frame = NOISES["low"], self.frame.copy()
        added = np.sqrt(np.array([noise.force**2 - own.force**2, noise.torque**2 - own.torque**2]))
        frame[list(CHANNELS)] += rng.normal(0.0, np.repeat(added, 3), (len(frame), 6))
        return frame

    @property
    def box(self) -> Array:
        """Ends (2, 3) of the box that it is in, m."""
        return np.array(BOXES[self.name][0]).reshape(3, 2).T / 1000

    def homogeneous(self, mass: float) -> Array:
        """The ten parameters of the box, if it were full of this mass."""
        low, high = self.box
        centre = (low + high) / 2
        second = mass * (np.diag((high - low) ** 2) / 12 + np.outer(centre, centre))
        return np.concatenate([[mass], mass * centre, (np.trace(second) * np.eye(3) - second)[TRIANGLE]])

    def fits(self, frame: pd.DataFrame, noise: Noise) -> dict[str, Fit]:
        """Ours: without constraints, physically consistent, with the mass inside the box, near a homogeneous one."""
        stated = dict(zip(CHANNELS, np.repeat([noise.force, noise.torque], 3).tolist(), strict=True))
        rig = tw.Rig.from_data(
            {
                "robot": {"gravity": GRAVITY, "gravity_direction": [0.0, 0.0, 1.0]},
                "sensor": {"convention": "on_tool", "noise": stated},
            }
        )
        model, recording = tw.spatial(rig), tw.from_dataframe(frame, rig=rig, name=self.name)
        plain = tw.fit(model, recording)
        reference = self.homogeneous(plain.values["m"]).tolist()
        prior = tw.Prior(dict(zip(list(plain.values)[6:], reference, strict=True)), weight=PRIOR_WEIGHT)
        constraints = {
            "fit --physical": tw.Constraints(physical=True),
            "fit --inside BOX": tw.Constraints(inside=tw.Volume.box(*self.box)),
            "fit --prior BOX": tw.Constraints(prior=prior),
        }
        return {"fit": plain} | {way: tw.fit(model, recording, constraints=c) for way, c in constraints.items()}


def symmetric(entries: Array) -> Array:
    """The inertia (3, 3) of its entries xx, xy, xz, yy, yz, zz."""
    inertia = np.zeros((3, 3))
    inertia[TRIANGLE] = inertia.T[TRIANGLE] = entries
    return inertia


def rigid_wrench(parameters: Array, specific: Array, omega: Array, alpha: Array) -> Array:
    """Newton and Euler: wrench (n, 6) on a tool of ten parameters, from its acceleration less gravity and turning."""
    mass, first, inertia = parameters[0], parameters[1:4], symmetric(parameters[4:])
    force = mass * specific + np.cross(alpha, first) + np.cross(omega, np.cross(omega, first))
    torque = np.cross(first, specific) + alpha @ inertia + np.cross(omega, omega @ inertia)
    return np.hstack([force, torque])


def ordinary_least_squares(frame: pd.DataFrame, noise: Noise, rng: np.random.Generator | None) -> Array:
    """Ten parameters as the authors estimate them: no zero of the sensor, rows in N and N m weighted alike.

    With a generator the accelerations get the noise that theirs had; they are those of splines through the poses.
    """
    time = frame["time"].to_numpy()
    turns = Rotation.from_quat(frame[["qx", "qy", "qz", "qw"]].to_numpy())
    spline = RotationSpline(time, turns)
    omega, alpha = spline(time, 1), spline(time, 2)  # SciPy's rates are along the turned axes
    acceleration = CubicSpline(time, frame[["px", "py", "pz"]].to_numpy())(time, 2)
    specific = turns.inv().apply(acceleration - [0.0, 0.0, GRAVITY])
    if rng is not None:
        specific = specific + rng.normal(0.0, noise.acceleration, specific.shape)
        alpha = alpha + rng.normal(0.0, noise.angular, alpha.shape)
    columns = [rigid_wrench(unit, specific, omega, alpha).ravel() for unit in np.eye(10)]
    wrench = frame[list(CHANNELS)].to_numpy().ravel()
    return np.asarray(np.linalg.lstsq(np.column_stack(columns), wrench, rcond=None)[0])


def consistent(parameters: Array) -> bool:
    """Whether some distribution of mass has these ten parameters: the pseudo-inertia is positive definite."""
    inertia = symmetric(parameters[4:])
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    pseudo = np.block([[second, parameters[1:4, None]], [parameters[None, 1:4], parameters[:1, None]]])
    return bool(np.linalg.eigvalsh(pseudo)[0] > 0)


def errors(parameters: Array, true: Array, extent: Array) -> Array:
    """(3,) %, as published: of the mass, of the centre relative to the extent (3,) m, mean over the axes, and of the
    inertia relative to a homogeneous box of that extent, mean over six entries."""
    centre = parameters[1:4] / parameters[0] - true[1:4] / true[0]
    scale = true[0] / 12 * (extent @ extent * np.eye(3) - np.outer(extent, extent))
    inertia = np.abs((parameters[4:] - true[4:]) / scale[TRIANGLE])
    return 100 * np.array([abs(parameters[0] / true[0] - 1), np.mean(np.abs(centre) / extent), inertia.mean()])


ERRORS = ("consistent", "mass", "centre", "inertia")


def tool_errors(tools: Sequence[str] = TOOLS, noises: Sequence[str] = tuple(NOISES), seed: int = 0) -> pd.DataFrame:
    """A row for each noise, tool and way of ours: consistent (100 or 0) and the `errors`, %; in `held`, how many of the
    ten 95 % intervals of `fit` hold the truth."""
    rows: list[dict[str, float | str]] = []
    for level in noises:
        noise, rng = NOISES[level], np.random.default_rng(seed)
        for tool in map(Tool, tools):
            frame, true = tool.noisier(noise, rng), tool.parameters
            fits = tool.fits(frame, noise)
            estimates = {
                "OLS, accelerations as noisy as theirs": ordinary_least_squares(frame, noise, rng),
                "OLS, accelerations of the poses": ordinary_least_squares(frame, noise, None),
                **{way: fit.theta[6:] for way, fit in fits.items()},
                "the box of the prior alone": tool.homogeneous(fits["fit"].values["m"]),
            }
            ends = fits["fit"].params.iloc[6:]
            held = int(((ends["low"] <= true) & (true <= ends["high"])).sum())
            for way, estimate in estimates.items():
                outcome = [100.0 * consistent(estimate), *errors(estimate, true, np.array(BOXES[tool.name][1]) / 1000)]
                named = dict(zip(ERRORS, outcome, strict=True))
                rows.append({"noise": level, "tool": tool.name, "way": way, **named, "held": held})
    return pd.DataFrame(rows)


def tools_table(each: pd.DataFrame | None = None) -> pd.DataFrame:
    """A row for each noise and way, ours of `tool_errors`: means over the tools, then the inertia's median."""
    each = tool_errors() if each is None else each
    rows: dict[tuple[str, ...], list[float | str]] = {}
    for level in each["noise"].unique():
        for way in ("OLS", "GEO", "HPS"):
            rows[level, NADEAU, way] = [*PUBLISHED[level, way], ""]
        for way in each["way"].unique():
            of_way = each[(each["noise"] == level) & (each["way"] == way)]
            held = f"{of_way['held'].sum()} of {10 * len(of_way)}" if way == "fit" else ""
            rows[level, HERE, way] = [*of_way[list(ERRORS)].mean(), float(of_way["inertia"].median()), held]
    return framed(rows, ("noise", "by", "way"), (*ERRORS, "inertia, median", "intervals that hold"))


# A measured tool ------------------------------------------------------------------------------------------------------

SKREDE = "Skrede, 2024"
"""Skrede, "A Linear Discrete Kalman Filter to Estimate the Contact Wrench of an Unknown Robot End Effector" (RCAR 2024,
10.1109/RCAR61438.2024.10671273): mass and centre of the tool on a KUKA LBR Med 14, of 24 poses at rest, in the sensor's
axes."""
SKREDE_ESTIMATE = (0.932, 0.0, 0.0, 44.0)
"""kg, mm."""
SKREDE_GRAVITY = 9.82085
"""m/s², the length of (gx, gy, gz) in the recording of the poses (Zenodo 11096791, `0-calibration_fts-accel.csv`)."""
FILTER = "filter of Skrede, by JalmaGit, 2025"
"""An exercise of a course on the same recordings, github.com/JalmaGit/AIS2202-estimation-template at 271c906:
`results/data/baseline_{low,high}_cont_wrench.csv`, with the noise of the forces taken as small and as large."""
FILTERED = (
    ("smoothing little", 0.007, (1.32, 0.60, 0.37)),
    ("smoothing much", 0.066, (0.22, 0.13, 0.20)),
)
"""RMS of fx, fy, fz in these files from 0.3 s on, N. The lag, s, is not stated: it is that of the largest correlation
of fz in `contact_{low,high}_cont_wrench.csv` with ours of each reading by itself, as measured on 2026-11-29."""


FILTER_LAGS = tuple(lag for _, lag, _ in FILTERED)


def least_squares_of_poses(poses: pd.DataFrame, gravity: float) -> tuple[float, float, float, float]:
    """Mass, kg, of the forces alone, then the centre (3), mm, of the torques with that weight."""
    weight = Rotation.from_quat(poses[["qx", "qy", "qz", "qw"]].to_numpy()).inv().apply([0.0, 0.0, -gravity])
    forces, torques = poses[list(CHANNELS[:3])].to_numpy(), poses[list(CHANNELS[3:])].to_numpy()
    zero = np.tile(np.eye(3), (len(poses), 1))
    mass = np.linalg.lstsq(np.column_stack([weight.ravel(), zero]), forces.ravel(), rcond=None)[0][0]
    arms = np.stack([np.cross(unit, mass * weight) for unit in np.eye(3)], axis=-1).reshape(-1, 3)
    x, y, z = 1e3 * np.linalg.lstsq(np.hstack([arms, zero]), torques.ravel(), rcond=None)[0][:3]
    return float(mass), float(x), float(y), float(z)


def rig_table() -> pd.DataFrame:
    """Mass, kg, and centre, mm, each with half of our 95 % interval."""
    folder = DATA / "ais2202"
    poses = pd.read_csv(folder / "calibration_poses.csv")
    columns = [n for name in ("mass, kg", "x, mm", "y, mm", "z, mm") for n in (name, f"± {name}")]
    rows: dict[tuple[str, ...], list[float]] = {}

    def add(by: str, way: str, values: Sequence[float], halves: Sequence[float] = (np.nan,) * 4) -> None:
        rows[by, way] = [v for pair in zip(values, halves, strict=True) for v in pair]

    add(SKREDE, "24 poses", SKREDE_ESTIMATE)
    for gravity in (SKREDE_GRAVITY, STANDARD_GRAVITY):
        stated = tw.Rig.read(folder / "rig.toml").to_data()
        stated["robot"]["gravity"] = gravity
        rig = tw.Rig.from_data(stated)
        fitted = tw.fit(tw.spatial(rig), tw.read(folder / "calibration_poses.csv", rig=rig))
        mass, centre = fitted["m"], tw.CentreOfMass.of(fitted)
        factor = float(np.ptp(fitted.params.loc["m", ["low", "high"]])) / 2 / mass.std  # Student's t
        add(HERE, f"two ordinary least squares, g = {gravity:g} m/s²", least_squares_of_poses(poses, gravity))
        halves = factor * np.array([mass.std, *1e3 * centre.std])
        add(HERE, f"fit, g = {gravity:g} m/s²", [mass.value, *1e3 * centre.value], halves.tolist())
    return framed(rows, ("by", "way"), columns)


def contact_table(lags: Sequence[float] = FILTER_LAGS) -> pd.DataFrame:
    """RMS of the forces of a run without contact, N, against the lag, s."""
    folder = DATA / "ais2202"
    rig = tw.Rig.read(folder / "rig.toml")
    fitted = tw.fit(tw.spatial(rig), tw.read(folder / "calibration_poses.csv", rig=rig))
    run = tw.read(folder / "baseline.csv", rig=rig)
    rows: dict[tuple[str, ...], list[float]] = {(FILTER, way): [lag, *rms] for way, lag, rms in FILTERED}
    for way, lag, rms, _ in forces_by_lag(fitted, run, lags):
        rows[HERE, f"{way}, {1e3 * lag:.0f} ms"] = [lag, *rms]
    return framed(rows, ("by", "way"), ["lag, s", "fx, N", "fy, N", "fz, N"])


TABLES: dict[str, Callable[[], pd.DataFrame]] = {
    "tools": tools_table,
    "rig": rig_table,
    "contact": contact_table,
    "chapter": chapter_table,
}


def main(argv: Sequence[str] | None = None) -> None:
    """Print the tables that are asked for, by default all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", choices=list(TABLES), metavar="TABLE", help=", ".join(TABLES))
    asked = parser.parse_args(argv).tables or list(TABLES)
    if set(asked) != {"chapter"} and not all((DATA / name).is_dir() for name in ("workshop_tools", "ais2202")):
        raise SystemExit(f"no folders workshop_tools and ais2202 at {DATA}: set TRUEWRENCH_DATA to where they are")
    for name in asked:
        print(readable(TABLES[name]()).to_string(), end="\n\n")


if __name__ == "__main__":
    main()
