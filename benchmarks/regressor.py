"""The regressor Phi of a whole recording, (N, p, k): emitted and mapped, against evaluating it sample by sample.

Compared are ways to the same array from the same signals, and every way is first checked to give it:

numpy emission      `modeling.compiled.symbolic_vector.numpy_function`: subexpressions shared, all samples at once
casadi map          `modeling.chain.prediction.Emitted`: a CasADi graph mapped over samples, as fits and searches use it
lambdify, loop      `sympy.lambdify` of the same matrix as its documentation has it (no cse), called for each sample
lambdify, arrays    the same without cse, called once with arrays, for users who vectorise by hand
pinocchio, loop     `pinocchio.bodyRegressor`, compiled C++, called for each sample; six axes, and only when installed

It is fair because deriving and compiling is outside the clock for all; the loops get plain floats (faster than NumPy's
scalars) and write into an array allocated beforehand; and Pinocchio is handed the acceleration minus gravity in the
sensor frame ready made, which the others compute from the orientation, and leaves the constant columns of the biases
alone. Memory is what Python and NumPy allocate; CasADi's and Pinocchio's own, for one sample, is not seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec

import numpy as np
import numpy.typing as npt
import sympy as sp
from scipy.spatial.transform import Rotation

from benchmarks.measure import peak_bytes, rounds
from benchmarks.row import Row, table
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import VectorFunction
from modeling.chain.regressor import regressor
from modeling.compiled.symbolic_vector import numpy_function
from modeling.rig import Convention

Array = npt.NDArray[np.float64]
Evaluation = Callable[[], Array]

SAMPLES = 5000
"""A recording of 50 s at 100 Hz."""
ROUNDS = 9
PINOCCHIO_ORDER = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Of the columns of `bodyRegressor`: the inertia by columns of its upper triangle."""
ROUNDING = 1e-11
"""Between any two ways, of the largest entry."""


@dataclass(frozen=True, eq=False)
class Task:
    """The regressor of a model for random signals (N,) by name."""

    name: str
    model: WrenchModel
    signals: dict[str, Array]

    @cached_property
    def phi(self) -> sp.Matrix:
        """The regressor, symbolic (p, k)."""
        return regressor(self.model)

    @cached_property
    def inputs(self) -> tuple[sp.Symbol, ...]:
        """The signals that it needs."""
        return tuple(sorted(self.phi.free_symbols, key=str))

    @cached_property
    def columns(self) -> list[Array]:
        """Their values, (N,) each."""
        return [self.signals[symbol.name] for symbol in self.inputs]

    def empty(self) -> Array:
        """Room for the result, (N, p, k)."""
        return np.empty((SAMPLES, *self.phi.shape))

    def ours(self) -> dict[str, Evaluation]:
        """truewrench's ways."""
        return {"numpy emission": self._numpy_emission(), "casadi map": self._casadi_map()}

    def instead(self) -> dict[str, Evaluation]:
        """What a user would use instead."""
        found = {"lambdify, loop": self._lambdify_loop(), "lambdify, arrays": self._lambdify_arrays()}
        if "qw" in self.signals and find_spec("pinocchio"):
            found["pinocchio, loop"] = self._pinocchio_loop()
        return found

    def _numpy_emission(self) -> Evaluation:
        return self._filled(numpy_function(self.inputs, list(self.phi)))

    def _lambdify_arrays(self) -> Evaluation:
        return self._filled(sp.lambdify(self.inputs, list(self.phi), modules="numpy"))

    def _filled(self, function: Callable[..., list[Array | float]]) -> Evaluation:
        """A function of arrays that returns the entries one by one, some of them constants."""

        def run() -> Array:
            phi = self.empty()
            flat = phi.reshape(SAMPLES, -1)
            for place, entry in enumerate(function(*self.columns)):
                flat[:, place] = entry
            return phi

        return run

    def _casadi_map(self) -> Evaluation:
        emitted = VectorFunction.of(sp.Matrix(list(self.phi)), tuple(s.name for s in self.inputs), ())
        return lambda: emitted.value(self.signals, np.zeros(0), SAMPLES).reshape(SAMPLES, *self.phi.shape)

    def _lambdify_loop(self) -> Evaluation:
        function = sp.lambdify(self.inputs, self.phi, modules="numpy")
        rows = np.stack(self.columns, axis=1).tolist()

        def run() -> Array:
            phi = self.empty()
            for i, row in enumerate(rows):
                phi[i] = function(*row)
            return phi

        return run

    def _pinocchio_loop(self) -> Evaluation:
        """At no velocity of the origin, where spatial and classical acceleration are one."""
        from pinocchio import Motion, bodyRegressor

        biases = len(self.model.biases)
        names = [p.name for p in self.model.parameters]
        columns = [names.index(name) for name in PINOCCHIO_ORDER]
        turning, lifts = spatial_motion(self.signals, self.model.gravity)
        zero = np.zeros(3)

        def run() -> Array:
            phi = self.empty()
            phi[:, :, :biases] = np.eye(biases)
            for i in range(SAMPLES):
                phi[i][:, columns] = bodyRegressor(Motion(zero, turning[i, :3]), Motion(lifts[i], turning[i, 3:]))
            return phi

        return run


def spatial_motion(signals: dict[str, Array], gravity: float) -> tuple[Array, Array]:
    """omega and alpha (N, 6), and the acceleration minus gravity (N, 3), all in the sensor frame."""
    turn = Rotation.from_quat(np.stack([signals[f"q{a}"] for a in "xyzw"], axis=1))
    up = np.array([0.0, 0.0, gravity])
    acceleration = np.stack([signals[f"ap{a}"] for a in "xyz"], axis=1) + up
    turning = np.stack([signals[f"{kind}{a}"] for kind in ("w", "al") for a in "xyz"], axis=1)
    return turning, np.asarray(turn.apply(acceleration, inverse=True))


def tasks() -> list[Task]:
    """The plane and six axes, at random signals of a robot's size."""
    rng = np.random.default_rng(0)
    plane = {name: rng.normal(0.0, 2.0, SAMPLES) for name in ("phi", "dphi", "ddphi", "ax", "ay")}
    names = [f"{kind}{a}" for kind in ("w", "al", "ap") for a in "xyz"]
    quaternions = Rotation.random(SAMPLES, rng=rng).as_quat()
    space = {name: rng.normal(0.0, 2.0, SAMPLES) for name in names}
    space |= {f"q{a}": quaternions[:, i].copy() for i, a in enumerate("xyzw")}
    six_axes = replace(spatial(), convention=Convention.ON_TOOL)
    return [Task("planar regressor", planar(), plane), Task("six-axis regressor", six_axes, space)]


def compared(task: Task) -> list[Row]:
    """Ratios of time, and of peak memory, of every other way to each of ours."""
    ours, instead = task.ours(), task.instead()
    require_equal(ours | instead)
    time = rounds(ours | instead, ROUNDS)
    memory = {name: peak_bytes(call) for name, call in (ours | instead).items()}
    rows = []
    for own in ours:
        for other in instead:
            ratios = tuple(b / a for a, b in zip(time[own], time[other], strict=True))
            shares = (memory[other] / memory[own],)
            for quantity, values in (("time", ratios), ("peak memory", shares)):
                rows.append(Row(task=task.name, ours=own, instead=other, quantity=quantity, ratios=values))
    return rows


def require_equal(ways: dict[str, Evaluation]) -> None:
    """Raise AssertionError when two ways do not give one array."""
    results = {name: way() for name, way in ways.items()}
    expected = next(iter(results.values()))
    for name, result in results.items():
        tolerance = ROUNDING * np.abs(expected).max()
        np.testing.assert_allclose(result, expected, rtol=0, atol=tolerance, err_msg=name)


def run() -> list[Row]:
    """All rows of this benchmark."""
    return [row for task in tasks() for row in compared(task)]


if __name__ == "__main__":
    print(table(run()))
