"""Static calibration of the sensor: axes, gains and nonlinearity, as symbolic maps from the true wrench to the load."""

from __future__ import annotations

from dataclasses import dataclass

from modeling import symbolic as sp
from modeling.chain.stages.stage import Stage, StageFormula, SymbolicMap
from modeling.space import signals


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
    """reading = matrix · sign · reading, p x p.

    sign   +1 or -1 per channel: the convention of the readings (and a mirrored axis)
    """

    matrix: sp.Matrix
    sign: tuple[int, ...]

    place = Stage.GAIN

    def map(self, reading: sp.Matrix) -> sp.Matrix:
        """matrix · sign · reading."""
        return self.matrix * sp.diag(*self.sign) * reading

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
