"""Calibration of a sensor: the matrix from true wrench to reading, its inverse, their covariance, and files of them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.stages import Gain, Stage
from modeling.effects.sensor import gain_unit
from modeling.errors import InputError
from modeling.number_format import NOT_IDENTIFIABLE, digits_of
from modeling.table import Cell, Column, Table, Tabular

Array = NDArray[np.float64]

WHERE = "calibration"
ROUNDING = 1e-9
"""Share of the matrix that its elements' derivatives leave of it where they span it: least squares of 36 numbers."""
REMEDY = "fit with --add gain sensor_crosstalk, and recordings of known loads by --load"
ASSUMED = "assumed"
"""Printed for the std of an element that the model holds."""


@dataclass(frozen=True, eq=False)
class SensorMatrix(Tabular):
    """reading = matrix · wrench + zero, in the axes and the sign convention of the readings; N, N m.

    channels   p names, with the unit of each in `units`
    matrix     (p, p) from true wrench to reading
    zero       (p,) reading without load: that of the first recording of the fit
    slopes     (k, p, p) derivative of the matrix in every parameter of the model
    known      (k,) whether a parameter was identifiable, or fixed
    covariance of the parameters (k, k), of which the first p are the zeros; that of an unknown one is left out
    left_out   ids of the effects of the readings that no matrix expresses
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    matrix: Array
    zero: Array
    slopes: Array
    known: NDArray[np.bool_]
    covariance: Array
    left_out: tuple[str, ...] = ()

    @classmethod
    def of(cls, model: WrenchModel, theta: Array, covariance: Array) -> SensorMatrix:
        """Of a model at its parameters theta (k,) with covariance (k, k), an unknown one of infinite variance.

        Raises InputError for a model without a gain, for gains that depend on a signal, or whose scale the recordings
        do not tell, and for a matrix without inverse.
        """
        symbolic, symbols = model.chain[Gain].matrix, [p.symbol for p in model.parameters]
        size = len(model.channels)
        if not (used := symbolic.free_symbols):
            what = "the model has no gain and no crosstalk: readings are taken as they are"
            raise InputError(what=what, where=WHERE, remedy=REMEDY)
        if signals := sorted(symbol.name for symbol in used.difference(symbols)):
            what = f"the gain depends on {', '.join(signals)}: it has no one matrix"
            raise InputError(what=what, where=WHERE, remedy="emit the model as code")
        values = dict(zip(symbols, map(float, theta), strict=True))

        def numbers(expression: object) -> Array:
            return np.array(symbolic.__class__(expression).xreplace(values).tolist(), dtype=np.float64)

        slopes = [numbers(symbolic.diff(s)) if s in used else np.zeros((size, size)) for s in symbols]
        known = np.isfinite(np.diag(covariance))
        sensor = cls(
            channels=model.channels,
            units=model.space.units,
            matrix=numbers(symbolic),
            zero=np.asarray(theta[:size], dtype=np.float64),
            slopes=np.array(slopes),
            known=known,
            covariance=np.where(np.outer(known, known), covariance, 0.0),
            left_out=tuple(e.id for e in model.effects if e.stage.number > Stage.GAIN.number),
        )
        std = sensor.std(correction=False)
        estimated = np.isfinite(std) & (std > 0)
        if not (np.diag(estimated) if sensor.scale_determined else estimated).any():
            what = "the scale of the sensor is not determined: here it is one number with the mass of the tool"
            remedy = "fit recordings that differ by a known load (--load), or sensor_gain, relative to one channel"
            raise InputError(what=what, where=WHERE, remedy=remedy)
        if np.linalg.matrix_rank(sensor.matrix) < size:
            raise InputError(what="the matrix has no inverse", where=WHERE, remedy="see what the model lacks: diagnose")
        return sensor

    @cached_property
    def scale_determined(self) -> bool:
        """Whether the model has the scale of the whole matrix free; else what it holds is taken as it is."""
        free = ~self.known | (np.diag(self.covariance) > 0)
        columns, whole = self.slopes[free].reshape(int(free.sum()), -1).T, self.matrix.ravel()
        left = whole - columns @ np.linalg.lstsq(columns, whole, rcond=None)[0]
        return bool(np.linalg.norm(left) < ROUNDING * np.linalg.norm(whole))

    @cached_property
    def correction(self) -> Array:
        """C (p, p), the inverse: wrench = C (reading - zero)."""
        return np.asarray(np.linalg.inv(self.matrix))

    @cached_property
    def unknown(self) -> NDArray[np.bool_]:
        """Elements (p, p) of the matrix that are not identifiable; those of the correction are the same to first order.

        The others of the correction are those at the values that these have.
        """
        return np.asarray((self.slopes[~self.known] != 0).any(axis=0))

    def covariance_of(self, *, correction: bool) -> Array:
        """Covariance (p² + p, p² + p) of the elements, row by row, of the correction or the matrix, and of the zeros.

        To first order, dC = -C dM C. An element that is not identifiable has an infinite variance, and no covariances.
        """
        size = len(self.channels)
        slopes = -self.correction @ self.slopes @ self.correction if correction else self.slopes
        rows = np.hstack([slopes.reshape(len(slopes), -1), np.eye(len(slopes), size)])
        covariance = rows.T @ self.covariance @ rows
        unknown = np.concatenate([self.unknown.ravel(), ~self.known[:size]])
        covariance[unknown], covariance[:, unknown] = 0.0, 0.0
        covariance[unknown, unknown] = np.inf
        return np.asarray(covariance)

    def std(self, *, correction: bool) -> Array:
        """Std (p, p) of the elements; infinite where not identifiable, zero where the model holds it."""
        size = len(self.channels)
        variance = np.diag(self.covariance_of(correction=correction))[: size**2]
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(size, size))

    @property
    def zero_std(self) -> Array:
        """Std (p,) of the zeros, N and N m."""
        size = len(self.channels)
        return np.asarray(np.sqrt(np.where(self.known, np.diag(self.covariance), np.inf)[:size]))

    def corrected(self, readings: Array) -> Array:
        """True wrenches (n, p), N and N m, in the readings' axes and signs, of readings (n, p)."""
        return np.asarray((readings - self.zero) @ self.correction.T)

    def unit(self, row: int, column: int) -> str:
        """Of an element of either matrix."""
        return gain_unit(self.units[row], self.units[column])

    @property
    def table(self) -> Table:
        """Every element of the matrix and of its inverse with its std, then the zeros."""
        std, std_of_inverse = self.std(correction=False), self.std(correction=True)
        rows: list[tuple[str | float | Cell | None, ...]] = [
            (f"{self.channels[i]}_{self.channels[j]}", *_cells(self.matrix[i, j], std[i, j]),
             *_cells(self.correction[i, j], std_of_inverse[i, j]), self.unit(i, j))
            for i, j in product(range(len(self.channels)), repeat=2)
        ]  # fmt: skip
        zeros = zip(self.channels, self.zero, self.zero_std, self.units, strict=True)
        rows += [(f"zero of {channel}", *_cells(zero, error), None, None, unit) for channel, zero, error, unit in zeros]
        numbers = ("matrix", "std", "correction", "std of it")
        columns = (Column(name, format=".2g" if "std" in name else ".6g") for name in numbers)
        return Table.of(("reading_load", *columns, "unit"), rows)

    def remarks(self) -> list[str]:
        """What the matrix is of, and what is not in it."""
        said = ["reading = matrix · wrench + zero and wrench = correction · (reading - zero), in the readings' axes and"
                " signs; N, N m"]  # fmt: skip
        if not self.scale_determined:
            held = [c for c, std in zip(self.channels, np.diag(self.std(correction=False)), strict=True) if std == 0]
            said.append(
                f"the scale is not determined: {', '.join(held) or 'what is not estimated'} read as they did, and the"
                " others against them; known loads (--load) and gain tell it"
            )
        if self.unknown.any():
            names = [f"{self.channels[i]}_{self.channels[j]}" for i, j in np.argwhere(self.unknown)]
            said.append(f"{NOT_IDENTIFIABLE}, and taken as they stand: {', '.join(names)}")
        if self.left_out:
            said.append(f"effects of the readings that a matrix does not express: {', '.join(self.left_out)}")
        return said


def _cells(value: float, std: float) -> tuple[Cell | None, Cell]:
    """A number to the digits of its std, and this."""
    if not np.isfinite(std):
        return None, Cell(None, NOT_IDENTIFIABLE)
    return Cell(float(value), format=digits_of(value, std)), Cell(float(std)) if std else Cell(None, ASSUMED)


# ---------------------------------------------------------------------------------------------------- files


def ros_parameters(sensor: SensorMatrix, source: str) -> str:
    """Parameters of a ROS 2 node in YAML: arrays are flat, matrices row by row; `source` names project and version."""
    units = [sensor.unit(i, j) for i, j in product(range(len(sensor.channels)), repeat=2)]
    lines = [f"# calibration of a force/torque sensor by {source}", *(f"# {remark}" for remark in sensor.remarks())]
    lines += ["/**:", "  ros__parameters:", "    calibration:"]
    lines.append(f"      scale_determined: {str(sensor.scale_determined).lower()}")
    named = {"channels": sensor.channels, "zero_units": sensor.units, "units": units}
    lines += [f"      {name}: {json.dumps(texts)}" for name, texts in named.items()]
    lines.append("      # std to first order: infinite where not identifiable, 0 where the model holds the element")
    arrays = {"zero": sensor.zero, "zero_std": sensor.zero_std}
    for name, of_correction in (("correction", True), ("matrix", False)):
        arrays[name] = sensor.correction if of_correction else sensor.matrix
        arrays[f"{name}_std"] = sensor.std(correction=of_correction)
        arrays[f"{name}_covariance"] = sensor.covariance_of(correction=of_correction)
    lines += [f"      {name}: [{', '.join(map(_yaml_number, array.ravel()))}]" for name, array in arrays.items()]
    return "\n".join(lines) + "\n"


def _yaml_number(value: float) -> str:
    """The shortest decimal that reads back as the same number, with a point even before an exponent (YAML 1.1)."""
    text = repr(float(value))
    return text.replace("inf", ".inf") if "inf" in text or "." in text else text.replace("e", ".0e")


def csv_table(sensor: SensorMatrix, source: str) -> str:
    """One row an element: of `correction` and `matrix` row by row, then of `zero`; numbers of NumPy.

    `cov_1 ..` are the covariances with the elements of the same matrix and then with the zeros; of a zero those with
    the correction. `source` is not in it, as a CSV has no comments.
    """
    channels, size = sensor.channels, len(sensor.channels)
    elements = list(product(range(size), repeat=2))
    lines = [["quantity", "row", "column", "unit", "value", "std", *(f"cov_{i + 1}" for i in range(size**2 + size))]]

    def row(labels: Iterable[str], value: float, covariances: Array, place: int) -> list[str]:
        return [*labels, *(repr(float(v)) for v in (value, np.sqrt(covariances[place]), *covariances))]

    for name, matrix, of_correction in (("correction", sensor.correction, True), ("matrix", sensor.matrix, False)):
        covariance = sensor.covariance_of(correction=of_correction)
        for place, (i, j) in enumerate(elements):
            labels = (name, channels[i], channels[j], sensor.unit(i, j))
            lines.append(row(labels, matrix[i, j], covariance[place], place))
    covariance = sensor.covariance_of(correction=True)
    for i, channel in enumerate(channels):
        place = size**2 + i
        lines.append(row(("zero", channel, "", sensor.units[i]), sensor.zero[i], covariance[place], place))
    return "\n".join(",".join(line) for line in lines) + "\n"
