"""Bias and drift of the readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from modeling import symbolic as sp
from modeling.chain.stages.stage import Stage, StageFormula, SymbolicMap

if TYPE_CHECKING:
    from modeling.dynamics.motion_record import MotionRecord, ResponsePart
    from modeling.dynamics.sample_program import SampleProgramBuilder, Symbols


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
