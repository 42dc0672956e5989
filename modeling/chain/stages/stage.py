"""Abstract stage of the measurement chain, between the true wrench and the reading."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

from modeling import symbolic as sp

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
