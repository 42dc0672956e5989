"""Orientation forms: quaternions of either order, rotation vectors, Euler angles, matrices, gravity; to x, y, z, w."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self

import numpy as np

from estimation.reading.gravity_vector import level_quaternions
from estimation.reading.log_reader import Array
from modeling.errors import InputError, quoted

FORMS = "xyzw, wxyz, rotation_vector, euler XYZ (capitals: about moving axes), matrix_rows, matrix_columns"
FORMS += ", gravity (down at rest), accelerometer (up at rest)"
UPWARD = {"gravity": -1.0, "accelerometer": 1.0}
"""Sign by which a vector in the sensor's axes points up at rest."""
UNIT_TOLERANCE, WORST_UNIT = 0.02, 0.1
"""Deviations of a norm from 1: of the median from which it is another form, and of one row that is damaged."""
LARGEST = 1e6
"""A number beyond which no row is a pose."""
NO_TRANSLATION = 1e-9
"""Of the entries of a homogeneous matrix that are zero by definition."""


@dataclass(frozen=True)
class OrientationForm:
    """A form of orientation by the name that a map gives it; `angles` are the axes of Euler angles."""

    name: str
    angles: str = ""

    @classmethod
    def parsed(cls, text: str, where: str) -> Self:
        """The form of a map's text; InputError when it is none of FORMS."""
        plain = re.sub(r"[\s_-]+", " ", text.strip())
        if match := re.fullmatch(r"(?i:euler)\s+([xyz]{3}|[XYZ]{3})", plain):
            return cls("euler", match[1])
        name = plain.lower().replace("quaternion ", "").replace(" ", "_")
        name = {"matrix_row_major": "matrix_rows", "matrix_column_major": "matrix_columns"}.get(name, name)
        if name not in ("xyzw", "wxyz", "rotation_vector", "matrix_rows", "matrix_columns", *UPWARD):
            raise InputError(what=f"orientation = {quoted(text)} is no form", where=where, remedy=f"use one of {FORMS}")
        return cls(name)

    @property
    def columns(self) -> tuple[int, ...]:
        """How many columns it may have."""
        if self.name in ("xyzw", "wxyz"):
            return (4,)
        return (3,) if self.name in ("rotation_vector", "euler", *UPWARD) else (9, 12, 16)

    @property
    def has_angles(self) -> bool:
        """Whether its columns are angles, with a unit."""
        return self.name in ("rotation_vector", "euler")

    def __str__(self) -> str:
        texts = {
            "xyzw": "quaternion x y z w", "wxyz": "quaternion w x y z", "rotation_vector": "rotation vector",
            "matrix_rows": "matrix, row by row", "matrix_columns": "matrix, column by column",
            "gravity": "gravity in the sensor's axes, turn about it unknown",
            "accelerometer": "accelerometer in the sensor's axes, turn about the vertical unknown",
        }  # fmt: skip
        return texts.get(self.name, f"Euler angles {self.angles}")

    def quaternions(self, values: Array, where: str) -> Array:
        """Unit quaternions (n, 4), x y z w, of the columns (n, k) in rad; rows with NaN give NaN.

        Raises InputError when the columns are no orientation in this form.
        """
        from scipy.spatial.transform import Rotation  # slow to import

        quaternions = np.full((len(values), 4), np.nan)
        complete = (np.abs(values) < LARGEST).all(axis=1)
        rows = values[complete]
        if self.name in ("xyzw", "wxyz"):
            turned = _unit(rows, where)
            quaternions[complete] = turned if self.name == "xyzw" else np.roll(turned, -1, axis=1)
        elif self.name in UPWARD:
            quaternions[complete] = level_quaternions(UPWARD[self.name] * rows)
        elif self.name == "rotation_vector":
            quaternions[complete] = Rotation.from_rotvec(rows).as_quat()
        elif self.name == "euler":
            quaternions[complete] = Rotation.from_euler(self.angles, rows).as_quat()
        else:
            matrices = _orthonormal(matrix_blocks(rows, self), where)
            sound = np.isfinite(matrices).all(axis=(1, 2))
            quaternions[np.flatnonzero(complete)[sound]] = Rotation.from_matrix(matrices[sound]).as_quat()
        return quaternions


def matrix_blocks(values: Array, form: OrientationForm) -> Array:
    """The rotations (n, 3, 3) of matrices (n, 9, 12 or 16) written row by row or column by column."""
    size = values.shape[1]
    if form.name == "matrix_rows":
        return values.reshape(len(values), -1, 3 if size == 9 else 4)[:, :3, :3]
    rows = 3 if size in (9, 12) else 4
    return values.reshape(len(values), -1, rows).transpose(0, 2, 1)[:, :3, :3]


def matrix_positions(values: Array, form: OrientationForm) -> Array | None:
    """The translations (n, 3) of homogeneous matrices; None of rotations alone."""
    if values.shape[1] == 9:
        return None
    places = (
        (3, 7, 11)
        if form.name == "matrix_rows"
        else tuple(range(values.shape[1] - (4 if values.shape[1] == 16 else 3), values.shape[1]))[:3]
    )
    return values[:, list(places)]


def matrix_form(values: Array) -> OrientationForm:
    """Row by row or column by column, by where the constant last row 0 0 0 1 of a 4 x 4 matrix stands.

    Of a 3 x 3 matrix both orders give a rotation, and column by column is taken as the robots' usual one.
    """
    if values.shape[1] == 16:
        last_row = np.nanmax(np.abs(values[:, 12:15]), initial=0.0)
        last_column = np.nanmax(np.abs(values[:, [3, 7, 11]]), initial=0.0)
        return OrientationForm("matrix_rows" if last_row < NO_TRANSLATION < last_column else "matrix_columns")
    return OrientationForm("matrix_columns")


def _unit(rows: Array, where: str) -> Array:
    """The quaternions normalised; rows that are none become NaN, as damaged cells do, unless most are none."""
    norm = np.linalg.norm(rows, axis=1, keepdims=True)
    off = np.abs(norm - 1)
    if len(rows) and np.median(off) > UNIT_TOLERANCE:
        what = f"the quaternion's norm is {np.median(norm):.3g} instead of 1"
        raise InputError(what=what, where=where, remedy="name the columns of the orientation in a map, and their form")
    return np.asarray(rows / np.where(off < WORST_UNIT, norm, np.nan))


def _orthonormal(matrices: Array, where: str) -> Array:
    """The matrices as they are; those that are no rotation become NaN, unless most are none."""
    off = np.abs(np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)).max(axis=(1, 2))
    if len(matrices) and np.median(off) > UNIT_TOLERANCE:
        remedy = 'name its columns in a map, and orientation = "matrix_rows" or "matrix_columns"'
        raise InputError(what="the matrix of the orientation is no rotation", where=where, remedy=remedy)
    return np.where((off < WORST_UNIT)[:, None, None], matrices, np.nan)
