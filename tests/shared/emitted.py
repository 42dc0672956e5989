"""Emitted code, brought to life: compiled with every warning an error, imported, or read back."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType, SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.sensor_axes import contact_gain_at
from modeling.codegen.casadi_target import CasadiSample, RecursiveFunction, state_size
from modeling.codegen.fitted_model import FittedModel, sample_inputs, sample_program
from modeling.dynamics.sample_program import SampleProgram
from modeling.space import signals

Array = NDArray[np.float64]

WARNINGS = ("all", "extra", "error", "conversion", "sign-conversion", "shadow", "missing-prototypes")
FLAGS = ["-std=c99", "-pedantic", *(f"-W{name}" for name in WARNINGS)]
LONG = 50_000
"""Characters of code of which the compiler makes nothing better: that takes it seconds."""
LARGEST_STATE = 1 << 20
"""Bytes; ctypes does not know the structure, and this is more than any of the tests needs."""


def module(text: str) -> SimpleNamespace:
    """The names of a module's text."""
    names: dict[str, Any] = {}
    exec(compile(text, "emitted", "exec"), names)  # noqa: S102 - the project's own output is what is tested
    return SimpleNamespace(**names)


@dataclass(frozen=True, eq=False)
class Library:
    """A C file, compiled and loaded."""

    text: str

    @cached_property
    def built(self) -> tuple[ctypes.CDLL, str]:
        """What a compilation without a warning makes, loaded, and the symbols that it takes from elsewhere."""
        with TemporaryDirectory(prefix="emitted") as folder:
            source, target = (Path(folder) / name for name in ("code.c", "code.so"))
            source.write_text(self.text, encoding="ascii")  # nothing else is in every compiler's character set
            speed = "-O1" if len(self.text) < LONG else "-O0"
            command = ["cc", *FLAGS, speed, "-shared", "-fPIC", str(source), "-o", str(target), "-lm"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            command = ["nm", "--dynamic", "--undefined-only", str(target)]
            symbols = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            return ctypes.CDLL(str(target)), symbols

    @property
    def functions(self) -> ctypes.CDLL:
        """The functions."""
        return self.built[0]

    @property
    def undefined(self) -> set[str]:
        """What it takes from elsewhere, without what the C runtime puts into every library."""
        names = {line.split()[-1].split("@")[0] for line in self.built[1].splitlines()}
        return {name for name in names if not name.startswith(("_ITM", "__gmon", "__cxa"))}

    def matrix(self, name: str, u: Array, shape: tuple[int, int]) -> Array:
        """A function of u that fills a matrix."""
        phi = np.full(shape, np.nan)
        getattr(self.functions, f"truewrench_{name}")(pointer(np.ascontiguousarray(u)), pointer(phi))
        return phi

    @property
    def parameters(self) -> Any:
        """The array of parameters, to be changed."""
        count = self.text.split("TRUEWRENCH_PARAMETERS = ")[1].split("\n")[0]
        return (ctypes.c_double * int(count)).in_dll(self.functions, "truewrench_parameters")


@dataclass(frozen=True, eq=False)
class CFilter:
    """The state of a compiled model."""

    library: Library
    channels: int

    @cached_property
    def state(self) -> Any:
        """Room for the state, full of something else before it is initialised."""
        room = ctypes.create_string_buffer(b"\x55" * LARGEST_STATE, LARGEST_STATE)
        self.library.functions.truewrench_init(room)
        return room

    def restart(self) -> None:
        """Forget all samples."""
        self.library.functions.truewrench_init(self.state)

    def predict(self, u: Array) -> Array:
        """The reading (p,)."""
        result = np.full(self.channels, np.nan)
        self.library.functions.truewrench_predict(self.state, pointer(np.ascontiguousarray(u)), pointer(result))
        return result

    def compensate(self, u: Array, reading: Array) -> Array:
        """The contact (p,); in place, which is allowed."""
        result = np.array(reading, dtype=float)
        place = pointer(result)
        self.library.functions.truewrench_compensate(self.state, pointer(np.ascontiguousarray(u)), place, place)
        return result


@dataclass(eq=False)
class CasadiFilter:
    """A deserialised model with its state."""

    function: Any
    fitted: FittedModel
    state: Any = 0

    def compensate(self, u: Array, reading: Array) -> Array:
        """The contact (p,)."""
        signals: Mapping[str, float] = dict(zip(self.fitted.inputs, map(float, u), strict=True))
        found = self.function(**signals, reading=reading, state=self.state)
        self.state = found["next_state"]
        return np.asarray(found["contact"].full()[:, 0], dtype=np.float64)


@dataclass(eq=False)
class SampleRunner:
    """A program of one sample, evaluated by CasADi from its inputs and readings; `values` are its parameters."""

    program: SampleProgram
    inputs: Sequence[sp.Symbol]
    values: Mapping[sp.Symbol, float]

    def __post_init__(self) -> None:
        self.restart()

    @cached_property
    def function(self) -> Any:
        """From inputs, reading and state to prediction, aligned reading and next state."""
        u, reading = ca.SX.sym("u", len(self.inputs)), ca.SX.sym("reading", len(self.program.result))
        state = ca.SX.sym("state", state_size(self.program))
        known = dict(zip(self.inputs, ca.vertsplit(u) if self.inputs else [], strict=True))
        known |= {symbol: ca.SX(float(value)) for symbol, value in self.values.items()}
        found = CasadiSample.of(self.program, known, reading, state)
        graphs = [ca.densify(graph) for graph in (found.prediction, found.measured, found.next_state)]
        return ca.Function("sample", [u, reading, state], graphs)

    def restart(self) -> None:
        """Forget all samples."""
        self.step = RecursiveFunction(self.function)

    def __call__(self, u: ArrayLike, reading: ArrayLike | None = None) -> tuple[Array, Array]:
        """The result (p,), and the reading (p,) of the same sample."""
        given = np.zeros(len(self.program.result)) if reading is None else np.array(reading, dtype=float)
        result, measured = self.step(np.array(u, dtype=float), given)
        return result, measured


class DiscreteTimeModel:
    """Prediction and compensation of a model sample by sample; readings of `wait` samples ago."""

    def __init__(self, model: WrenchModel, theta: ArrayLike, *, dt: float | None = None) -> None:
        self.model, self.theta, self.inputs = model, np.array(theta, dtype=float), sample_inputs(model)
        values = dict(zip((p.symbol for p in model.parameters), self.theta, strict=True))
        self.runner = SampleRunner(sample_program(model, self.theta, dt), signals(*self.inputs), values)
        self.wait = self.runner.program.latency
        self.gain = contact_gain_at(model, self.theta)[0]

    def predict(self, u: ArrayLike) -> Array:
        """The reading (p,) without contact."""
        return self.runner(u)[0]

    def compensate(self, u: ArrayLike, reading: ArrayLike) -> Array:
        """The contact (p,)."""
        predicted, measured = self.runner(u, reading)
        return np.asarray(np.linalg.solve(self.gain, measured - predicted))


def sampled(
    program: SampleProgram,
    inputs: Sequence[sp.Symbol],
    rows: Array,
    values: Mapping[sp.Symbol, float] = MappingProxyType({}),
) -> Array:
    """The results (n, p) of a program at rows (n, m) of its inputs, sample by sample."""
    runner = SampleRunner(program, inputs, values)
    return np.stack([runner(row)[0] for row in rows])


def pointer(values: Array) -> Any:
    """Where an array lies."""
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def balanced(text: str) -> bool:
    """Whether the braces and environments of a LaTeX text close in the order in which they opened."""
    import re

    opened: list[str] = []
    for found in re.finditer(r"\\begin\{(\w+)\}|\\end\{(\w+)\}|\\left\b|\\right\b|\\[{}]|([{}])", text):
        begin, end, brace = found.groups()
        token = found.group()
        if begin or token == r"\left" or brace == "{":
            opened.append(begin or token)
        elif (end or token == r"\right" or brace == "}") and (
            not opened or opened.pop() != (end or {r"\right": r"\left", "}": "{"}[token])
        ):
            return False
    return not opened
