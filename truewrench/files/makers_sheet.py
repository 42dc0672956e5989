"""The maker's sheet of a sensor beside its calibration here, and the maker's calibration file with the correction."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Self
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import holm_adjusted, normal_cdf
from modeling.codegen.sensor_matrix import ASSUMED, SensorMatrix
from modeling.errors import InputError, file_text, quoted
from modeling.kinematics.placement import LARGEST_NUMBER
from modeling.kinematics.urdf import RestrictedTreeBuilder
from modeling.number_format import NOT_IDENTIFIABLE, P_VALUE, digits_of
from modeling.significance import LEVELS
from modeling.table import Cell, Column, Table, Tabular

Array = NDArray[np.float64]

REMEDY = (
    "give a CSV of channel, full_scale, accuracy (% of full scale) and, under the channels' names, the matrix; or a"
    " calibration file of ATI (.cal)"
)
PROLOG = re.compile(r"(?:\s|<\?.*?\?>|<!--.*?-->)*", re.DOTALL)
"""What stands before the root of such a file: a declaration, and comments that may have anything in them."""
LARGEST_SHEET = 1_000_000
"""Bytes; a calibration file has some thousand."""
FORCES = {"N": 1.0, "kN": 1e3, "lb": 4.4482216152605, "lbf": 4.4482216152605, "klb": 4448.2216152605}
"""Newtons of the units of force of such files; the pound-force is 0.45359237 kg times 9.80665 m/s²."""
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}
"""Metres of the units of length in their units of torque, such as N-mm and in-lb."""
LINES = {"fx": "Fx", "fy": "Fy", "fz": "Fz", "tx": "Tx", "ty": "Ty", "tz": "Tz"}
"""Names of the channels in such a file."""


@dataclass(frozen=True, eq=False)
class MakersSheet:
    """What a maker states of a sensor of p channels; N, N m.

    matrix      (p, p) from true wrench to reading: 1 unless stated
    full_scale  (p,) largest reading of each channel; NaN where not stated
    accuracy    (p,) largest error of a channel, in % of its full scale; NaN where not stated
    file        the calibration file in ATI's layout; None of another sheet
    """

    matrix: Array
    full_scale: Array
    accuracy: Array
    file: AtiCalibration | None = None

    @classmethod
    def read(cls, path: str | Path, channels: Sequence[str], ranges: Mapping[str, float] | None = None) -> Self:
        """The sheet in a file, with the `ranges` of a rig where it states no full scale; InputError, in one line."""
        text = file_text(path, kind="a sheet", syntax="CSV", most=LARGEST_SHEET)
        if text.lstrip().startswith("<"):
            file = AtiCalibration.of(text, str(path), channels)
            return cls(np.eye(len(channels)), file.full_scale, np.full(len(channels), np.nan), file)
        columns = _columns(text, channels, str(path))
        missing = [c for c in channels if c not in columns]
        if missing and len(missing) < len(channels):
            raise InputError(what=f"column {missing[0]} of the matrix is missing", where=str(path), remedy=REMEDY)
        none = np.full(len(channels), np.nan)
        stated = none if ranges is None else np.array([ranges.get(c, np.nan) for c in channels])
        full_scale, accuracy = columns.get("full_scale", none), columns.get("accuracy", none)
        if (full_scale <= 0).any() or (accuracy <= 0).any():
            what = "full_scale and accuracy are above zero"
            raise InputError(what=what, where=str(path), remedy="leave out what is not stated")
        if missing and np.isnan(full_scale).all() and np.isnan(accuracy).all():
            raise InputError(what="states nothing of the sensor", where=str(path), remedy=REMEDY)
        matrix = np.eye(len(channels)) if missing else np.stack([columns[c] for c in channels], axis=1)
        if not np.isfinite(matrix).all():
            raise InputError(what="an element of the matrix is missing", where=str(path), remedy=REMEDY)
        return cls(matrix, np.where(np.isnan(full_scale), stated, full_scale), accuracy)


def _columns(text: str, channels: Sequence[str], where: str) -> dict[str, Array]:
    """Numbers (p,) of a sheet by column, in the order of the channels; NaN where a cell is empty."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    head = lines[0] if lines else ""
    try:
        rows = list(csv.reader(lines, delimiter=";" if ";" in head else ","))
    except csv.Error as error:
        raise InputError(what=f"not a CSV file: {error}", where=where, remedy=REMEDY) from None
    names = [name.strip().lower() for name in rows[0]] if rows else []
    if "channel" not in names or any(len(row) != len(names) for row in rows):
        raise InputError(what="no table with a column channel", where=where, remedy=REMEDY)
    unknown = [n for n in names if n not in ("channel", "full_scale", "accuracy", *channels)]
    if unknown or len(set(names)) < len(names):
        what = f"column {quoted(unknown[0])} is not expected" if unknown else "a column is there twice"
        raise InputError(what=what, where=where, remedy=REMEDY)
    place = names.index("channel")
    by_channel = {row[place].strip().lower(): row for row in rows[1:]}
    if set(by_channel) != set(channels) or len(rows) - 1 != len(channels):
        what = f"one row of each channel is expected: {', '.join(channels)}"
        raise InputError(what=what, where=where, remedy="name the channels as the model does")
    cells = {name: [by_channel[c][names.index(name)] for c in channels] for name in names if name != "channel"}
    return {name: np.array([_number(cell, where) for cell in column]) for name, column in cells.items()}


def _number(cell: str, where: str) -> float:
    """A number of a sheet; NaN of an empty cell."""
    try:
        if not cell.strip() or abs(float(cell)) < LARGEST_NUMBER:
            return float(cell) if cell.strip() else np.nan
    except ValueError:
        pass
    raise InputError(what=f"{quoted(cell)} is no number", where=where, remedy="use a point for decimals")


@dataclass(frozen=True, eq=False)
class SheetComparison(Tabular):
    """A sensor's matrix beside that of its maker: element by element, with what the maker says of its accuracy.

    An error of an element is in % of the full scale of its reading, with the load at its own full scale.
    """

    sensor: SensorMatrix
    sheet: MakersSheet

    @property
    def difference(self) -> Array:
        """(p, p): this sensor's matrix less the maker's."""
        return np.asarray(self.sensor.matrix - self.sheet.matrix)

    @property
    def share(self) -> Array:
        """% (p, p) of full scale for each unit of an element; NaN where it is not known."""
        return np.asarray(100 * self.sheet.full_scale / self.sheet.full_scale[:, None])

    @property
    def p_values(self) -> Array:
        """(p, p) of the differences, two-sided, Holm over the elements that were estimated; NaN of others."""
        return self._adjusted(np.zeros_like(self.difference), 2.0)

    def _adjusted(self, allowed: Array, sides: float) -> Array:
        """p-values (p, p) of differences beyond `allowed`, Holm over the elements that were estimated."""
        std = self.sensor.std(correction=False)
        tested = np.isfinite(std) & (std > 0) & np.isfinite(allowed)
        beyond = (np.abs(self.difference) - allowed)[tested] / std[tested]
        p_values = np.full(std.shape, np.nan)
        p_values[tested] = holm_adjusted((sides * normal_cdf(-beyond)).tolist())
        return p_values

    @property
    def outside(self) -> tuple[str, ...]:
        """Elements, as fx_fy, whose difference is beyond the accuracy that the maker states of their reading."""
        beyond = self._adjusted(self._allowed, 1.0) < LEVELS.effect
        return tuple(f"{self.sensor.channels[i]}_{self.sensor.channels[j]}" for i, j in np.argwhere(beyond))

    @property
    def _allowed(self) -> Array:
        """Difference (p, p) of each element by which its reading is off by its accuracy at full scale."""
        return np.asarray(self.sheet.accuracy[:, None] / self.share)

    @property
    def table(self) -> Table:
        """Both matrices, the difference with its std and p-value, in % of full scale, and whether it is specified."""
        std, p_values, outside = self.sensor.std(correction=False), self.p_values, self.outside
        within = np.abs(self.difference) + LEVELS.upper_limit * std <= self._allowed
        rows = []
        for i, j in product(range(len(self.sensor.channels)), repeat=2):
            if (i, j) in self._as_stated:
                continue
            name, limit = f"{self.sensor.channels[i]}_{self.sensor.channels[j]}", self.sheet.accuracy[i]
            told = "beyond" if name in outside else "within" if within[i, j] else "not told from"
            told = f"{told} {limit:g} %" if np.isfinite(self._allowed[i, j]) else ""
            known, difference = bool(np.isfinite(std[i, j])), float(self.difference[i, j])
            rows.append((
                name, float(self.sheet.matrix[i, j]),
                float(self.sensor.matrix[i, j]) if known else Cell(None, NOT_IDENTIFIABLE),
                Cell(difference, format=digits_of(difference, std[i, j])) if known else None,
                (float(std[i, j]) or Cell(None, ASSUMED)) if known else None, self.sensor.unit(i, j),
                _finite(p_values[i, j]), _finite(difference * self.share[i, j]) if known else None,
                told if known and std[i, j] else "",
            ))  # fmt: skip
        formats = {"maker": ".5g", "here": ".5g", "difference": ".3g", "std": ".2g"}
        numbers = [Column(name, format=spec) for name, spec in formats.items()]
        more = (Column("p", format=P_VALUE), Column("% of full scale", format=".2g"), Column("specified"))
        return Table.of(("reading_load", *numbers, "unit", *more), rows)

    @property
    def _as_stated(self) -> list[tuple[int, int]]:
        """Elements that were not estimated, and are as the maker states them."""
        held = (self.sensor.std(correction=False) == 0) & (self.difference == 0)
        return [(int(i), int(j)) for i, j in np.argwhere(held)]

    def remarks(self) -> list[str]:
        """What the columns are, and which elements left the specification."""
        said = [
            f"p is of no difference, Holm over the elements; specified is against the accuracy stated, at"
            f" {LEVELS.effect:g} over all of them, for one load at full scale"
        ]
        if self._as_stated:
            said.append(f"not shown, as they are not estimated and taken as stated: {len(self._as_stated)} elements")
        if not np.isfinite(self._allowed).any():
            said.append("the sheet states no accuracy with a full scale, so that nothing is held against it")
        elif self.outside:
            said.append(f"beyond the sheet's accuracy: {', '.join(self.outside)}")
        else:
            said.append("no element is shown to be beyond the sheet's accuracy")
        return [*said, *self.sensor.remarks()[1:]]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


# ------------------------------------------------------------------------- calibration files in ATI's layout


@dataclass(frozen=True, eq=False)
class AtiCalibration:
    """A calibration file of ATI: rows UserAxis (6, n) from n gauges to the wrench, which drivers of others read.

    Its rows Axis are the maker's own form of the same matrix.

    root    the document; `prolog` is the text before it
    units   (6,) N, N m of the file's unit of each row
    """

    prolog: str
    root: ElementTree.Element
    units: Array
    where: str

    @classmethod
    def of(cls, text: str, where: str, channels: Sequence[str]) -> Self:
        """Of the text of a file; InputError, in one line, where it is none, or has no rows for others to read."""
        if tuple(channels) != tuple(LINES):
            raise InputError(what="such a file is of six axes", where=where, remedy="give a CSV of these channels")
        try:
            parser = ElementTree.XMLParser(target=RestrictedTreeBuilder(insert_comments=True), encoding="utf-8")
            root: ElementTree.Element = ElementTree.fromstring(text.encode(), parser=parser)
        except (ElementTree.ParseError, ValueError) as error:
            raise InputError(what=f"not an XML file: {error}", where=where, remedy=REMEDY) from None
        calibrations = root.findall("Calibration")
        if root.tag != "FTSensor" or len(calibrations) != 1:
            what = f"expected an FTSensor with one Calibration, and it has {len(calibrations)}"
            raise InputError(what=what, where=where, remedy=REMEDY)
        force, torque = (calibrations[0].get(f"{name}Units", "") for name in ("Force", "Torque"))
        units = np.array([_newtons(force, where)] * 3 + [_newton_metres(torque, where)] * 3)
        calibration = cls(PROLOG.findall(text)[0], root, units, where)
        if not root.findall(".//UserAxis"):
            what = "it has no UserAxis rows, and what its Axis rows mean is the maker's own"
            raise InputError(what=what, where=where, remedy="ask the maker for a file of version 1.1 or later")
        _ = calibration._rows("UserAxis"), calibration.full_scale
        return calibration

    def _lines(self, tag: str) -> list[ElementTree.Element]:
        """The elements of the six rows; InputError where they are not there once each."""
        lines = self.root.findall(f".//{tag}")
        by_name = {line.get("Name"): line for line in lines}
        if set(by_name) != set(LINES.values()) or len(lines) != len(LINES):
            remedy = "give the file as the maker wrote it"
            raise InputError(what=f"expected one {tag} of each of the six axes", where=self.where, remedy=remedy)
        return [by_name[name] for name in LINES.values()]

    def _rows(self, tag: str) -> Array:
        """(6, n) values of the rows, in the file's units."""
        rows = [[_number(v, self.where) for v in line.get("values", "").split()] for line in self._lines(tag)]
        if len({len(row) for row in rows}) != 1 or len(rows[0]) < len(rows):
            what = f"the rows {tag} have not the same six or more numbers"
            raise InputError(what=what, where=self.where, remedy="give the file as the maker wrote it")
        return np.array(rows)

    @property
    def full_scale(self) -> Array:
        """(6,) N, N m, by the attribute max; NaN where that is missing."""
        stated = np.array([_number(line.get("max", ""), self.where) for line in self._lines("UserAxis")])
        return np.where(stated > 0, stated, np.nan) * self.units

    def corrected(self, correction: Array, remark: str) -> str:
        """The text of the file with its matrix multiplied by a correction (6, 6), of readings in N and N m.

        The rows Axis, where the file has them, are changed so that UserAxis follows from them by the same linear map.
        Raises InputError where it does not.
        """
        in_units = correction * self.units / self.units[:, None]
        user = self._rows("UserAxis")
        changed: dict[str, Array] = {"UserAxis": in_units @ user}
        if self.root.findall(".//Axis"):
            makers = self._rows("Axis")
            if makers.shape != user.shape or min(map(np.linalg.matrix_rank, (makers, user))) < len(makers):
                what = "the rows UserAxis do not follow from the rows Axis"
                raise InputError(what=what, where=self.where, remedy="give the file as the maker wrote it")
            to_user = user @ np.linalg.pinv(makers)
            changed["Axis"] = np.asarray(np.linalg.solve(to_user, in_units @ to_user @ makers), dtype=np.float64)
        root = ElementTree.fromstring(ElementTree.tostring(self.root))  # what was read stays as it is
        for tag, rows in changed.items():
            lines = {line.get("Name"): line for line in root.findall(f".//{tag}")}
            for name, row in zip(LINES.values(), rows, strict=True):
                lines[name].set("values", " ".join(f"{value:.9g}" for value in row))
        root.insert(0, ElementTree.Comment(f" {remark.replace('--', '- ')} "))
        return f"{self.prolog}{ElementTree.tostring(root, encoding='unicode').strip()}\n"


def _newtons(unit: str, where: str) -> float:
    if unit not in FORCES:
        raise InputError(what=f"unit of force {quoted(unit)}", where=where, remedy=f"use {', '.join(FORCES)}")
    return FORCES[unit]


def _newton_metres(unit: str, where: str) -> float:
    """N m of a unit such as N-mm or in-lb."""
    parts = unit.split("-")
    for force, length in (parts, parts[::-1]) if len(parts) == 2 else ():
        if force in FORCES and length in LENGTHS:
            return FORCES[force] * LENGTHS[length]
    raise InputError(what=f"unit of torque {quoted(unit)}", where=where, remedy="use one such as N-m, N-mm, in-lb")
