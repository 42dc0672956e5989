"""Linear dynamics of the sensor: a transfer function of all channels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from modeling import symbolic as sp
from modeling.chain.stages.stage import ChainStage, Stage, StageFormula

if TYPE_CHECKING:
    from modeling.dynamics.motion_record import MotionRecord, ResponsePart
    from modeling.dynamics.sample_program import SampleProgramBuilder, Symbols


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
        from modeling.dynamics.transfer_function_response import through_transfer_function

        reading, tangent = (through_transfer_function(record, series) for series in (load.value, load.derivative))
        own = record.transfer_parameters if tangent.shape[2] and load.value.any() else ()
        for number, index in enumerate(own):
            place = index if load.columns is None else load.columns.index(index)
            tangent[:, :, place] += through_transfer_function(record, load.value, number)
        return replace(load, value=reading, derivative=tangent)

    def formula(self, reading: str) -> StageFormula:
        """H(s) reading."""
        return StageFormula("Transfer function", f"H(s) \\, {reading}", (("H(s)", self.transfer_function),))

    def notes(self) -> list[str]:
        """A contact is filtered too."""
        return ["The transfer function filters a contact as it does the load."]
