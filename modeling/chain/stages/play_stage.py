"""Play (hysteresis) between load and reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from modeling import symbolic as sp
from modeling.chain.stages.stage import ChainStage, Stage, StageFormula

if TYPE_CHECKING:
    from modeling.dynamics.motion_record import MotionRecord, ResponsePart
    from modeling.dynamics.sample_program import SampleProgramBuilder, Symbols


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
        """y = P(x; w), dy = dP/dx dx + dP/dw dw."""
        from modeling.dynamics.play import PlayedRecord

        load = record.sum(parts)
        play = PlayedRecord.of(load.value, record)
        return [replace(load, value=play.reading, derivative=play.total_derivative(load.derivative))]

    def formula(self, reading: str) -> StageFormula:
        """p(t) = max(r - w, min(r + w, p(t-)))."""
        rule = rf"\max\left({reading} - w, \min\left({reading} + w, p(t^-)\right)\right)"
        return StageFormula("Play operator between load and reading", "p", (("p(t)", rule), ("w", self.width)))
