"""Stages of the measurement chain, from the true wrench to the reading: static maps, dynamics, play, bias."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

from modeling import symbolic as sp
from modeling.space import Space, signals

if TYPE_CHECKING:
    from modeling.dynamics.motion_record import MotionRecord, ResponsePart
    from modeling.dynamics.sample_program import SampleProgramBuilder, Symbols


class Stage(Enum):
    """Place in the measurement chain on which an effect acts, in the order of the chain."""

    JOINTS = "joints"
    KINEMATICS = "kinematics"
    DEFLECTION = "tip flexibility"
    TIP_BODY = "tip body"
    MOUNTING = "mounting"
    GAIN = "gain"
    NONLINEARITY = "nonlinearity"
    PLAY = "play"
    LINEAR_DYNAMICS = "linear dynamics"
    BIAS = "bias"
    SATURATION = "saturation"

    @property
    def adds(self) -> bool:
        """Whether its effects change only load, transfer function and bias: no deflection, play or saturation."""
        return self not in (Stage.DEFLECTION, Stage.PLAY, Stage.SATURATION)

    @property
    def number(self) -> int:
        """Position in the order of the chain."""
        return list(Stage).index(self)


@dataclass(frozen=True)
class StageFormula:
    """A stage in LaTeX: its title, its output in terms of its input, and what the symbols stand for.

    equations   pairs (left, right), the right side as LaTeX text or as expressions
    """

    title: str
    output: str
    equations: tuple[tuple[str, str | sp.Expr | sp.Matrix], ...] = ()


class ChainStage(ABC):
    """A stage of the chain, from p channels to p channels; subclasses are frozen dataclasses of SymPy expressions.

    place     where it stands in the chain; after the nonlinearity unless it is a `SymbolicMap`
    memory    whether its output depends on earlier samples
    linear    whether `response` acts on each summand of its input by itself, whose derivative may have only the
              columns of some parameters (`ResponsePart.columns`)

    Prediction, screening, design, filters and generated code call only what is declared here.
    """

    place: ClassVar[Stage]
    memory: ClassVar[bool] = True
    linear: ClassVar[bool] = False

    def vectors(self) -> Mapping[str, sp.Matrix]:
        """Vectors (p, 1) of signals and parameters by name, which are compiled with the model for `response`."""
        return {}

    @abstractmethod
    def step(self, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
        """Add one sample of the stage to a program: its output (p,) for the input (p,).

        The state of a stage is initially the steady state under its first input.
        """

    @classmethod
    @abstractmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        """Its output along a whole record, with parameter derivatives, for the summands of its input.

        What it depends on comes from `MotionRecord.vectors`, under the names of `vectors`.
        """

    @abstractmethod
    def formula(self, reading: str) -> StageFormula:
        """The stage in LaTeX, for an input in LaTeX."""

    def notes(self) -> list[str]:
        """What a reader of generated code has to know, one paragraph each."""
        return []


class SymbolicMap(ChainStage):
    """A stage without memory: an expression of its input, of signals and of parameters."""

    memory = False

    @abstractmethod
    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """The output, (p, 1), for an input, (p, 1); of the mounting, for the true wrench (6, 1)."""

    def step(self, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
        """The map, with its signals delayed as its input is."""
        return sample.assigned(self.place.value.replace(" ", "_"), list(self.map(sp.Matrix(reading))))

    @classmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        """Not needed before the first stage with memory: the maps there are one expression, the load."""
        raise NotImplementedError(f"{cls.__name__} stands behind a stage with memory and needs a response of its own")


@dataclass(frozen=True)
class Bias(SymbolicMap):
    """reading + bias, `value` (p, 1): zero point and drift, in signals and parameters."""

    value: sp.Matrix

    place = Stage.BIAS
    linear = True

    def vectors(self) -> Mapping[str, sp.Matrix]:
        """`bias`."""
        return {"bias": self.value}

    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """reading + bias."""
        return reading + self.value

    def step(self, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
        """Added to the reading of the same sample."""
        bias = sample.aligned("biases", sample.assigned("bias", list(self.value)))
        return sample.assigned("biased", [r + b for r, b in zip(reading, bias, strict=True)])

    @classmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        """Further summands."""
        return [*parts, *record.evaluated("bias")]

    def formula(self, reading: str) -> StageFormula:
        """reading + y_0."""
        return StageFormula("Bias", f"{reading} + y_0", (("y_0", self.value),))


@dataclass(frozen=True)
class Clipping(SymbolicMap):
    """Readings limited to ± `level` (p, 1)."""

    level: sp.Matrix

    place = Stage.SATURATION

    def vectors(self) -> Mapping[str, sp.Matrix]:
        """`saturation`, the levels."""
        return {"saturation": self.level}

    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """min(max(reading, -level), level)."""
        return sp.Matrix([sp.Min(sp.Max(r, -w), w) for r, w in zip(reading, self.level, strict=True)])

    @classmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        """The sum, clipped; where it is, its only derivative is that of the level."""
        import numpy as np

        whole = record.sum(parts)
        limit, slope = record.constant("saturation")
        outside, sign = np.abs(whole.value) > limit, np.sign(whole.value)
        clipped = sign[:, :, None] * slope if whole.derivative.shape[2] else whole.derivative
        value = np.where(outside, np.copysign(limit, whole.value), whole.value)  # a level is infinite that is none
        derivative = np.where(outside[:, :, None], clipped, whole.derivative)
        return [replace(whole, value=value, derivative=derivative)]

    def formula(self, reading: str) -> StageFormula:
        """max(-y^, min(y^, reading))."""
        clipped = rf"\max\left(-\hat{{y}}, \min\left(\hat{{y}}, {reading}\right)\right)"
        return StageFormula("Saturation", clipped, ((r"\hat{y}", self.level),))

    def notes(self) -> list[str]:
        """A clipped reading bounds the contact only."""
        return ["Readings saturate: while one is at its saturation level, the contact is only a bound."]


@dataclass(frozen=True)
class Mounting(SymbolicMap):
    """reading = rows of (R force, R torque), for the true wrench of the sensor on the tool in sensor axes.

    rotation   R, 3 x 3, from true sensor axes to the axes of the readings
    rows       of the wrench (force, torque) that are measured
    """

    rotation: sp.Matrix
    rows: tuple[int, ...]

    place = Stage.MOUNTING

    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """(p, 1) from the wrench (6, 1)."""
        wrench = sp.Matrix.vstack(self.rotation * reading[:3, :], self.rotation * reading[3:, :])
        return sp.Matrix([wrench[row] for row in self.rows])

    def formula(self, reading: str) -> StageFormula:
        """M wrench, of the measured components."""
        rows = list(self.rows)
        rotation = sp.diag(self.rotation, self.rotation).extract(rows, rows)
        return StageFormula("Mounting", f"M {reading}", (("M", rotation),))


@dataclass(frozen=True)
class Gain(SymbolicMap):
    """reading = matrix · sign · reading, p x p; symbols in the matrix with channels' names are sign · reading.

    sign   +1 or -1 per channel: the convention of the readings (and a mirrored axis)
    """

    matrix: sp.Matrix
    sign: tuple[int, ...]

    place = Stage.GAIN

    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """matrix · sign · reading."""
        sign = sp.diag(*self.sign)
        channels = next(space.channels for space in Space if len(space.channels) == len(self.sign))
        loads = dict(zip(signals(*channels), sign * reading, strict=True))
        return self.matrix.xreplace(loads) * sign * reading

    def formula(self, reading: str) -> StageFormula:
        """G reading."""
        return StageFormula("Gain", f"G {reading}", (("G", self.matrix * sp.diag(*self.sign)),))


@dataclass(frozen=True)
class PolynomialGain(SymbolicMap):
    """reading = r + quadratic r² + cubic r³ of each channel, (p, 1) each."""

    quadratic: sp.Matrix
    cubic: sp.Matrix

    place = Stage.NONLINEARITY

    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """The polynomial of each channel."""
        terms = zip(reading, self.quadratic, self.cubic, strict=True)
        return sp.Matrix([r + a * r**2 + b * r**3 if a != 0 or b != 0 else r for r, a, b in terms])

    def formula(self, reading: str) -> StageFormula:
        """r_i = rho_i + a rho_i² + b rho_i³."""
        rho = signals(*(f"rho_{i}" for i in range(1, 1 + self.quadratic.rows)))
        pairs = ((f"r_{i}", r) for i, r in enumerate(self.map(sp.Matrix(rho)), start=1))
        return StageFormula("Nonlinearity of the gain", "r", ((r"\rho", reading), *pairs))


@dataclass(frozen=True)
class LinearDynamics(ChainStage):
    """Every channel filtered by H(s)."""

    transfer_function: sp.Expr

    place = Stage.LINEAR_DYNAMICS
    linear = True

    def step(self, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
        """Recursive filter, by `modeling.dynamics.discrete_transfer_function`."""
        from modeling.dynamics.discrete_transfer_function import DiscreteTransferFunction, filtered
        from modeling.dynamics.transfer_function import SymbolicTransferFunction

        numbers = SymbolicTransferFunction.of(self.transfer_function).at(sample.values)
        return filtered(DiscreteTransferFunction.of(numbers, sample.dt), sample, reading)

    @classmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        """y = H x, dy = H dx + dH x."""
        return [cls._filtered(part, record) for part in parts]

    @staticmethod
    def _filtered(load: ResponsePart, record: MotionRecord) -> ResponsePart:
        from modeling.dynamics.transfer_function import through_transfer_function

        reading, tangent = (through_transfer_function(record, series) for series in (load.value, load.derivative))
        varied = record.transfer_parameters if tangent.shape[2] and load.value.any() else ()
        for number, index in enumerate(varied):
            place = index if load.columns is None else load.columns.index(index)
            tangent[:, :, place] += through_transfer_function(record, load.value, number)
        return replace(load, value=reading, derivative=tangent)

    def formula(self, reading: str) -> StageFormula:
        """H(s) reading."""
        return StageFormula("Transfer function", f"H(s) \\, {reading}", (("H(s)", self.transfer_function),))

    def notes(self) -> list[str]:
        """A contact is filtered too."""
        return ["The transfer function filters a contact as it does the load."]


@dataclass(frozen=True)
class Play(ChainStage):
    """Play operator of half-widths `width` (p, 1): the output is constant while the input is within them.

    Sample by sample the input turns at samples, along a record between them (`modeling.dynamics.play`).
    """

    width: sp.Matrix

    place = Stage.PLAY

    def vectors(self) -> Mapping[str, sp.Matrix]:
        """`play`, the half-widths."""
        return {"play": self.width}

    def step(self, sample: SampleProgramBuilder, reading: Symbols) -> Symbols:
        """min(max(last output, input - width), input + width); initially the input."""
        width = sample.assigned("width", list(self.width))
        last = sample.state("play", reading)
        output = sample.assigned(
            "played",
            [sp.Min(sp.Max(y, r - w), r + w) for y, r, w in zip(last, reading, width, strict=True)],
            about="play operator: the output is constant while it is within the half-width of the load",
        )
        sample.keep(last, output)
        return output

    @classmethod
    def response(cls, parts: list[ResponsePart], record: MotionRecord) -> list[ResponsePart]:
        """y = P(x; w), dy = dP/dx dx + dP/dw dw; and what is left of the state before a record in steady state."""
        from modeling.dynamics.motion_record import ResponsePart
        from modeling.dynamics.play import PlayedRecord

        load = record.sum(parts)
        play = PlayedRecord.of(load.value, record)
        derivative = play.total_derivative(load.derivative)
        steady = replace(load, value=play.reading, derivative=derivative)
        if play.begun is None:
            return [steady]
        value, begun = play.begun.reading - play.reading, play.begun.total_derivative(load.derivative)
        return [steady, ResponsePart.at_start(value, begun - derivative, record.samples(periodic=False))]

    def formula(self, reading: str) -> StageFormula:
        """p(t) = max(r - w, min(r + w, p(t-)))."""
        rule = rf"\max\left({reading} - w, \min\left({reading} + w, p(t^-)\right)\right)"
        return StageFormula("Play operator between load and reading", "p", (("p(t)", rule), ("w", self.width)))
