"""Fits of millions of samples, against the regressor as NumPy code and `numpy.linalg.lstsq`.

from a file     a process each, from its start to its end: `tw.fit` of `tw.read_chunks` with a `NoiseModel`, and the
                script of a user, `pandas.read_parquet` of the columns needed, the module that `truewrench emit planar
                --to numpy` wrote, `lstsq`. The first round derives the model, the others find that in the cache. Memory
                is the peak of the resident set, interpreter and libraries included
                also `truewrench fit` without an option, which is told no noise and finds it in the file, so that the
                channels weigh a little otherwise
in memory       a fit of one `Chunk` of arrays, and the same two steps on the same arrays; deriving and emitting is
                outside the clock for both. Memory is what NumPy allocates beyond the arrays; the copy that LAPACK works
                on is not seen
sin and cos     one pass of both over the angles of the motion, one in the plane and three in six axes: what nobody can
                do without

It is fair because both weigh the channels alike (a plain division of the regressor in place) and are checked in the
same run to give the same parameters, to a billionth of a std; the file has row groups as pandas writes them.

`python -m benchmarks.fits_of_millions --samples 5e6 --six-axis 1e6`
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.long_fit import NOISE, log
from benchmarks.measure import Cost, cost, peak_bytes, process
from benchmarks.row import Row, table
from estimation.fit import fit
from estimation.streaming.chunk import Chunk
from estimation.streaming.chunk_information import linear_regressor_map
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.codegen.code_target import code_target
from modeling.codegen.fitted_model import RigidToolRegressor
from modeling.noise import NoiseModel
from modeling.rig import STANDARD_GRAVITY, Convention
from modeling.space import Space

Array = npt.NDArray[np.float64]
Way = Callable[[], Array]

SAMPLES, SIX_AXIS, ROUNDS = 5_000_000, 1_000_000, 3
SAME = 1e-9
"""Of a std, between any two ways."""
GROUP = 2**20
"""Rows of a row group, as pandas writes them."""
SPATIAL_NOISE = NoiseModel.white([0.5, 0.5, 0.5, 0.05, 0.05, 0.05])
FOLDER = Path(__file__).parents[1]

MEASURED = """
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(json.dumps({"theta": [float(v) for v in theta], "peak": int(status["VmHWM"].split()[0])}))
"""
OURS = """
import json, sys
import truewrench as tw
found = tw.fit(tw.planar(), tw.read_chunks(sys.argv[1]), noise=tw.NoiseModel.white(json.loads(sys.argv[2])))
theta = found.theta
"""
PLAIN = """
import io, json, sys
from contextlib import redirect_stdout
from truewrench.command_line import main
with redirect_stdout(io.StringIO()) as said:
    main(["fit", sys.argv[1], "--json", "--quiet"])
theta = [estimate["value"] for estimate in json.loads(said.getvalue())["parameters"].values()]
"""
INSTEAD = """
import json, sys
import numpy as np
import pandas as pd
from planar_regressor import regressor
frame = pd.read_parquet(sys.argv[1], columns=["ax", "ay", "phi", "dphi", "ddphi", "fx", "fy", "tau"])
std = np.array(json.loads(sys.argv[2]))
Phi = regressor(*(frame[name].to_numpy() for name in ("ax", "ay", "phi", "dphi", "ddphi")))
Phi /= std[:, None]
wrench = frame[["fx", "fy", "tau"]].to_numpy() / std
theta = np.linalg.lstsq(Phi.reshape(-1, 6), wrench.ravel(), rcond=None)[0]
"""


def written(path: Path, samples: int) -> None:
    """A log of that many rows in Parquet, generated piece by piece."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = ("phi", "dphi", "ddphi", "ax", "ay", "fx", "fy", "tau")
    schema = pa.schema([(name, pa.float64()) for name in ("time", *columns)])
    held: list[pa.Table] = []
    first = 0
    with pq.ParquetWriter(path, schema) as writer:
        for chunk in log(samples):
            series = {**chunk.signals, **dict(zip(("fx", "fy", "tau"), chunk.wrench.T, strict=True))}
            time = 1e-3 * np.arange(first, first + len(chunk.wrench))
            held.append(pa.table({"time": time, **{name: series[name] for name in columns}}, schema=schema))
            first += len(time)
            while sum(map(len, held)) >= GROUP:
                whole = pa.concat_tables(held)
                writer.write_table(whole.slice(0, GROUP), row_group_size=GROUP)
                held = [whole.slice(GROUP)]
        if held:
            writer.write_table(pa.concat_tables(held), row_group_size=GROUP)


def from_file(folder: Path, samples: int) -> list[Row]:
    """Whole processes on one file."""
    path = folder / "log.parquet"
    written(path, samples)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(FOLDER), str(folder)])}
    environment["TRUEWRENCH_CACHE"] = str(folder / "cache")
    std = json.dumps(NOISE.floor.tolist())
    scripts = {"ours": OURS, "plain": PLAIN, "instead": INSTEAD}
    costs: dict[str, list[Cost]] = {name: [] for name in scripts}
    peaks: dict[str, list[float]] = {name: [] for name in scripts}
    thetas = {}
    for _ in range(ROUNDS):
        for name, script in scripts.items():
            found = process([sys.executable, "-c", script + MEASURED, str(path), std], environment)
            said = json.loads(found.printed)
            costs[name].append(found.cost)
            peaks[name].append(said["peak"])
            thetas[name] = np.array(said["theta"])
    size = fit(planar(), log(min(samples, 100_000)), noise=NOISE).covariance * min(samples, 100_000) / samples
    _require_same(thetas["ours"], thetas["instead"], np.sqrt(np.diag(size)))
    task, rows = f"planar fit of {samples:.0e} rows, Parquet", []
    for name, called in (("ours", "tw.fit(read_chunks)"), ("plain", "truewrench fit")):
        pair = {"ours": costs[name], "instead": costs["instead"]}
        memory = tuple(b / a for a, b in zip(peaks[name], peaks["instead"], strict=True))
        rows += _rows(task, called, "script with lstsq", pair)
        rows += [Row(task=task, ours=called, instead=rows[-1].instead, quantity="peak memory", ratios=memory)]
    print(f"{task}: {_told(costs)}; MB {', '.join(f'{_median(peak) / 1e3:.0f}' for peak in peaks.values())}")
    return rows


@dataclass(frozen=True, eq=False)
class Task:
    """A model, arrays that it is fitted to, and the emitted regressor called with what it takes."""

    name: str
    model: WrenchModel
    noise: NoiseModel
    chunk: Chunk
    angles: Array
    phi: Callable[[Mapping[str, Array]], Array]

    def ours(self) -> Array:
        """The fit."""
        return fit(self.model, self.chunk, noise=self.noise).theta

    def instead(self) -> Array:
        """Regressor, weights, `lstsq`."""
        rows, std = self.phi(self.chunk.signals), self.noise.floor
        rows /= std[:, None]
        readings = (self.chunk.wrench / std).ravel()
        return np.asarray(np.linalg.lstsq(rows.reshape(len(readings), -1), readings, rcond=None)[0])

    def sine_and_cosine(self) -> None:
        """One pass over the angles."""
        np.sin(self.angles)
        np.cos(self.angles)

    def rows(self) -> list[Row]:
        """Ratios of time and memory, and of the time that sine and cosine take."""
        linear_regressor_map(self.model)  # derived outside the clock
        found = fit(self.model, self.chunk, noise=self.noise)
        _require_same(found.theta, self.instead(), np.sqrt(np.diag(found.covariance)))
        costs: dict[str, list[Cost]] = {"ours": [], "instead": [], "floor": []}
        for _ in range(ROUNDS):
            for name, way in (("ours", self.ours), ("instead", self.instead), ("floor", self.sine_and_cosine)):
                costs[name].append(cost(way))
        ours, other = peak_bytes(self.ours), peak_bytes(self.instead)
        task = f"{self.name} fit of {len(self.chunk.wrench):.0e} samples in memory"
        print(f"{task}: {_told(costs)}; MB {ours / 1e6:.1f}, {other / 1e6:.0f}")
        memory = Row(task=task, ours="tw.fit", instead="regressor, lstsq", quantity="memory", ratios=(other / ours,))
        floor = _rows(task, "tw.fit", "sin and cos", {"ours": costs["ours"], "instead": costs["floor"]})
        return [*_rows(task, "tw.fit", "regressor, lstsq", costs), memory, *floor]


def planar_task(samples: int, emitted: ModuleType) -> Task:
    """The log of `benchmarks.long_fit`, as a whole."""
    parts = list(log(samples))
    signals = {name: np.concatenate([part.signals[name] for part in parts]) for name in parts[0].signals}
    chunk = Chunk(run="log", signals=signals, wrench=np.concatenate([part.wrench for part in parts]))
    names = ("ax", "ay", "phi", "dphi", "ddphi")
    return Task("planar", planar(), NOISE, chunk, signals["phi"], lambda s: emitted.regressor(*(s[n] for n in names)))


def spatial_task(samples: int, emitted: ModuleType) -> Task:
    """Three angles, rates and accelerations that are sums of sines, and readings of a tool of 1.6 kg."""
    rng = np.random.default_rng(0)
    time = 1e-3 * np.arange(samples)

    def sines(size: float) -> Array:
        frequencies, phases = np.array([0.23, 0.7, 1.9]), rng.uniform(0, 2 * np.pi, 3)
        return np.asarray(size * np.sin(2 * np.pi * np.outer(time, frequencies) + phases).sum(axis=1))

    angles = np.stack([sines(0.5) for _ in range(3)])
    signals = dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_euler("xyz", angles.T).as_quat().T.copy(), strict=True))
    sizes = {"w": 2.0, "al": 8.0, "ap": 4.0}
    signals |= {prefix + axis: sines(size) for prefix, size in sizes.items() for axis in "xyz"}
    theta = np.array([3, -2, 5, 0.1, 0.2, -0.1, 1.6, 0.01, -0.02, 0.12, 0.02, 1e-3, -2e-3, 0.02, 5e-4, 8e-3])

    def phi(given: Mapping[str, Array]) -> Array:
        turn = Rotation.from_quat(np.stack([given[name] for name in ("qx", "qy", "qz", "qw")], axis=1))
        acceleration, omega, alpha = (np.stack([given[p + a] for a in "xyz"], axis=1) for p in ("ap", "w", "al"))
        acceleration[:, 2] += STANDARD_GRAVITY
        return np.asarray(emitted.regressor(turn.apply(acceleration, inverse=True), omega, alpha))

    wrench = phi(signals) @ theta + rng.standard_normal((samples, 6)) * SPATIAL_NOISE.floor
    chunk = Chunk(run="log", signals=signals, wrench=wrench)
    model = replace(spatial(), convention=Convention.ON_TOOL)
    return Task("six-axis", model, SPATIAL_NOISE, chunk, angles, phi)


def emitted(space: Space, folder: Path) -> ModuleType:
    """The module that `truewrench emit` writes, written and loaded."""
    name = "planar_regressor" if space is Space.PLANE else "spatial_regressor"
    path = folder / f"{name}.py"
    path.write_text(code_target("numpy").regressor(RigidToolRegressor(space), "truewrench"), encoding="utf-8")
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _require_same(one: Array, other: Array, std: Array) -> None:
    np.testing.assert_allclose(one / std, other / std, rtol=0, atol=SAME)


def _rows(task: str, ours: str, instead: str, costs: Mapping[str, list[Cost]]) -> list[Row]:
    pairs = list(zip(costs["ours"], costs["instead"], strict=True))
    ratios = {"CPU": tuple(b.cpu / a.cpu for a, b in pairs), "wall": tuple(b.wall / a.wall for a, b in pairs)}
    return [Row(task=task, ours=ours, instead=instead, quantity=q, ratios=r) for q, r in ratios.items()]


def _told(costs: Mapping[str, list[Cost]]) -> str:
    """Seconds of CPU and on the clock of each way, medians."""
    return ", ".join(
        f"{name} {_median([c.cpu for c in found]):.2f} s CPU {_median([c.wall for c in found]):.2f} s wall"
        for name, found in costs.items()
    )


def _median(values: list[float]) -> float:
    return float(np.median(values))


def run(samples: int = SAMPLES, six_axis: int = SIX_AXIS) -> list[Row]:
    """All rows of this benchmark."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        plane, space = emitted(Space.PLANE, folder), emitted(Space.SPACE, folder)
        rows = from_file(folder, samples)
        rows += planar_task(samples, plane).rows()
        return rows + spatial_task(six_axis, space).rows()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Fit millions of samples, from a file and in memory, and compare.")
    parser.add_argument("--samples", type=float, default=SAMPLES, help="planar ones")
    parser.add_argument("--six-axis", type=float, default=SIX_AXIS, help="six-axis ones")
    arguments = parser.parse_args()
    print(table(run(int(arguments.samples), int(arguments.six_axis))))
