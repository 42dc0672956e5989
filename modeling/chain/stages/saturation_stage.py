"""Saturation of the readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from modeling import symbolic as sp
from modeling.chain.stages.stage import Stage, StageFormula, SymbolicMap

if TYPE_CHECKING:
    from modeling.dynamics.motion_record import MotionRecord, ResponsePart


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
        value = np.where(outside, sign * limit, whole.value)
        derivative = np.where(outside[:, :, None], clipped, whole.derivative)
        return [replace(whole, value=value, derivative=derivative)]

    def formula(self, reading: str) -> StageFormula:
        """max(-y^, min(y^, reading))."""
        clipped = rf"\max\left(-\hat{{y}}, \min\left(\hat{{y}}, {reading}\right)\right)"
        return StageFormula("Saturation", clipped, ((r"\hat{y}", self.level),))

    def notes(self) -> list[str]:
        """A clipped reading bounds the contact only."""
        return ["Readings saturate: while one is at its saturation level, the contact is only a bound."]
