"""Volume of a tool from the command line: a box in numbers, or the corners of a mesh (STL, OBJ)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modeling.chain.pseudo_inertia import Volume
from modeling.errors import InputError

Array = NDArray[np.float64]

STL_HEAD, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL before its triangles, and of each: normal and three corners as floats, two bytes besides."""
LARGEST_MESH = 1 << 28
"""Bytes: millions of triangles, more than any tool's mesh has."""
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def read_volume(given: str) -> Volume:
    """The box XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX (m), or what is around a mesh; InputError for neither."""
    cells = given.split(",")
    if len(cells) == 6 and all(re.fullmatch(NUMBER, cell.strip()) for cell in cells):
        numbers = [float(cell) for cell in cells]
        return Volume.box(numbers[::2], numbers[1::2])
    path = Path(given)
    if path.suffix.lower() not in (".stl", ".obj"):
        remedy = "give XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX in m, or a mesh (.stl, .obj)"
        raise InputError(what="neither a box of six numbers nor a mesh", where=f"--inside {given}", remedy=remedy)
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_MESH + 1)
    except OSError as error:
        raise InputError(what=error.strerror or "cannot be read", where=given, remedy="give a mesh") from None
    if len(content) > LARGEST_MESH:
        raise InputError(what="larger than 256 MiB", where=given, remedy="give a coarser mesh, or a box")
    points = _corners(content, obj=path.suffix.lower() == ".obj")
    if not len(points):
        raise InputError(what="no corners of a mesh", where=given, remedy="give a mesh as STL or OBJ, or a box")
    return Volume.around(points, f"the mesh {path.name}")


def _corners(content: bytes, *, obj: bool) -> Array:
    """Corners (n, 3) of a mesh; none where it holds none."""
    if not obj and len(content) >= STL_HEAD:
        count = int(np.frombuffer(content, "<u4", 1, STL_HEAD - 4)[0])
        if len(content) == STL_HEAD + STL_TRIANGLE * count:
            kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
            return np.asarray(np.frombuffer(content, kind, count, STL_HEAD)["corners"], dtype=float).reshape(-1, 3)
    word = "v" if obj else "vertex"
    lines = re.findall(rf"^\s*{word}\s+({NUMBER})\s+({NUMBER})\s+({NUMBER})", content.decode("latin-1"), re.MULTILINE)
    return np.array(lines, dtype=float).reshape(-1, 3)
