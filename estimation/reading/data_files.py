"""Readers of data files that hold named arrays or sheets: MATLAB, HDF5, NumPy, Excel, Parquet, LeRobot data sets."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.reading.delimited_text import TEXT_LENGTH
from estimation.reading.log_reader import (
    Array,
    LogReader,
    LogTable,
    SourceFile,
    episode_of,
    require_columns,
    require_size,
    unique_names,
)
from estimation.recordings.column_table import PARQUET_MAGIC, arrow, parquet_file
from modeling.errors import InputError

MOST_COLUMNS_OF_ARRAY, MATRIX_RATIO = 64, 4
"""A two-dimensional array with more columns, and fewer rows to each, is an image or a matrix."""
FEWEST_SAMPLES = 3
"""Elements from which an array may be a series; fewer are parameters."""


def columns_of_array(name: str, array: NDArray[Any]) -> dict[str, Array]:
    """The columns (n,) of one array: along its longest dimension; `name[i]` for those of a matrix, row by row.

    A structured array gives one column a field. Nothing of text, objects, scalars and images.
    """
    if array.dtype.names:
        fields = [columns_of_array(f"{name}.{field}" if name else field, array[field]) for field in array.dtype.names]
        return {key: column for field in fields for key, column in field.items()}
    if array.dtype.kind not in "fiub" or array.ndim == 0:
        return {}
    array = array if array.ndim < 3 else array.squeeze()
    if array.ndim == 0 or array.size == 0:
        return {}
    samples = int(np.argmax(array.shape))
    rows = np.moveaxis(array, samples, 0).reshape(array.shape[samples], -1)
    if rows.shape[1] > MOST_COLUMNS_OF_ARRAY and rows.shape[1] > rows.shape[0] // MATRIX_RATIO:
        return {}
    if array.ndim == 1 or rows.shape[1] == 1:
        return {name or "column_1": rows[:, 0].astype(np.float64)}
    return {f"{name}[{i}]" if name else f"column_{i + 1}": rows[:, i].astype(np.float64) for i in range(rows.shape[1])}


def tables_of_arrays(arrays: Mapping[str, NDArray[Any]], *, name: str, kind: str, where: str) -> list[LogTable]:
    """One table for each length that occurs, the arrays' columns in it."""
    require_size(sum(array.size for array in arrays.values()), where)
    by_rows: dict[int, dict[str, Array]] = {}
    for key, array in arrays.items():
        for column, values in columns_of_array(key, array).items():
            by_rows.setdefault(len(values), {})[column] = values
    samples = {rows: columns for rows, columns in by_rows.items() if rows >= FEWEST_SAMPLES}
    tables = []
    for rows, columns in samples.items():
        require_columns(len(columns), where)
        title = name if len(samples) == 1 else f"{name}:{rows}"
        named = dict(zip(unique_names(list(columns)), columns.values(), strict=True))
        tables.append(LogTable(name=title, kind=kind, columns=named))
    return tables


NUMPY_MAGIC = b"\x93NUMPY"
NUMPY_HEADER = 1000
"""Bytes that hold the header of an array of one type."""
LARGEST_ARCHIVE = 1 << 30
"""Bytes of all arrays of an .npz together."""


class NumpyArrays(LogReader):
    """One array, or a zip file of several; arrays of objects are pickles, and never opened."""

    title = "NumPy .npy or .npz"

    def recognises(self, source: SourceFile) -> bool:
        """By NumPy's magic string, or a zip file that is named .npz."""
        return source.head.startswith(NUMPY_MAGIC) or (source.suffix == ".npz" and source.head.startswith(b"PK"))

    def tables(self, source: SourceFile) -> list[LogTable]:
        """The arrays; a single one has columns without names."""
        with source.on_disk() as path:
            if source.compression is None and not source.head.startswith(NUMPY_MAGIC):
                source.require_members(LARGEST_ARCHIVE)
            arrays = self._arrays(path, single=source.head.startswith(NUMPY_MAGIC))
            return tables_of_arrays(arrays, name=source.name, kind="NumPy array", where=str(source.path))

    @staticmethod
    def _arrays(path: Path, *, single: bool) -> dict[str, NDArray[Any]]:
        if single:
            with path.open("rb") as stream:
                if b"|O'" in stream.read(NUMPY_HEADER):
                    what = "an array of Python objects is a pickle, which can run programs and is never opened"
                    raise InputError(what=what, where=str(path), remedy="save the numbers as arrays of numbers")
            return {
                "": np.load(path, allow_pickle=False, mmap_mode="r")
            }  # a header that lies about its size fails here
        # NumPy leaves a file that it opened itself open when it is no archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}


ROW_SHARE = 0.5
"""Of a row's filled cells that are numbers: sheets have titles and dates beside them."""
HEADER_ROWS = 30
"""Rows from the top among which the header is looked for."""
LARGEST_BOOK = 256 << 20
"""Bytes of a workbook's XML: its cells as Python objects take several times as much memory."""


class Excel(LogReader):
    """Excel workbook, one table a sheet; formulas by the values that were saved with them."""

    title = "Excel .xlsx"

    def recognises(self, source: SourceFile) -> bool:
        """A zip file that is named .xlsx or .xlsm."""
        return source.suffix in (".xlsx", ".xlsm") and source.head.startswith(b"PK")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """The sheets that hold numbers."""
        import openpyxl  # slow to import

        source.require_members(LARGEST_BOOK)
        with source.path.open("rb") as stream:
            book = openpyxl.load_workbook(stream, read_only=True, data_only=True)
            sheets = [(sheet.title, _rows(sheet, str(source.path))) for sheet in book.worksheets]
        tables = [_table(f"{source.name}:{title}", rows) for title, rows in sheets if rows]
        return [table for table in tables if table is not None]


def _rows(sheet: Any, where: str) -> list[tuple[Any, ...]]:
    require_columns(sheet.max_column or 0, where)
    rows, cells = [], 0
    for row in sheet.iter_rows(values_only=True):
        cells += len(row)
        require_size(cells, where)
        rows.append(row)
    return rows


def _number(cell: Any) -> float:
    if isinstance(cell, str):
        try:
            return float(cell.strip().replace(",", "."))
        except ValueError:
            return np.nan
    if hasattr(cell, "timestamp"):
        return float(cell.timestamp())
    return float(cell) if isinstance(cell, int | float) else np.nan


def _is_data(row: Sequence[Any]) -> bool:
    filled = [cell for cell in row if cell is not None and cell != ""]
    return bool(filled) and sum(np.isfinite(_number(cell)) for cell in filled) >= ROW_SHARE * len(filled)


def _table(name: str, rows: Sequence[Sequence[Any]]) -> LogTable | None:
    first = next((i for i, row in enumerate(islice(rows, HEADER_ROWS)) if _is_data(row)), None)
    if first is None:
        return None
    width = max(len(row) for row in rows)
    header = next((row for row in reversed(rows[:first]) if any(isinstance(cell, str) for cell in row)), ())
    names = unique_names([str(cell or "") for cell in header] + [""] * (width - len(header)))
    columns: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for place, title in enumerate(names):
        cells = [row[place] if place < len(row) else None for row in rows[first:]]
        numbers = np.array([_number(cell) for cell in cells])
        if np.isfinite(numbers).any():
            columns[title] = numbers
        elif words := [str(cell) for cell in cells if cell is not None]:
            texts[title] = tuple(dict.fromkeys(words))[:3]
    return LogTable(name=name, kind="Excel sheet", columns=columns, texts=texts)


HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
MATLAB_OFFSET = 512
"""Bytes of MATLAB's own header in front of HDF5."""
MOST_CELLS = 100
"""Elements of a MATLAB cell that are looked into."""
NO_SAMPLES = ("char", "cell", "struct", "function_handle")


class Hdf5(LogReader):
    """HDF5; datasets by their paths, MATLAB's cells by what they refer to. External links are not followed."""

    title = "HDF5, MATLAB 7.3"
    rank = -1

    def recognises(self, source: SourceFile) -> bool:
        """By HDF5's signature, at the start or behind MATLAB's header."""
        return HDF5_MAGIC in (source.head[:8], source.head[MATLAB_OFFSET : MATLAB_OFFSET + 8])

    def tables(self, source: SourceFile) -> list[LogTable]:
        """Every numeric dataset; those of one length in one table."""
        import h5py  # slow to import

        arrays: dict[str, NDArray[Any]] = {}
        with source.on_disk() as path, h5py.File(path, "r") as file:

            def collect(name: str, item: Any) -> None:
                if not isinstance(item, h5py.Dataset) or name.startswith("#refs#"):
                    return
                if h5py.check_ref_dtype(item.dtype) is not None:
                    for place, reference in enumerate(np.ravel(item[()])[:MOST_CELLS], 1):
                        target = file[reference]
                        if isinstance(target, h5py.Dataset):
                            self._add(f"{name}{{{place}}}", target, arrays, str(source.path))
                else:
                    self._add(name, item, arrays, str(source.path))

            file.visititems(collect)
        kind = "MATLAB 7.3" if source.head.startswith(b"MATLAB") else "HDF5"
        return tables_of_arrays(arrays, name=source.name, kind=kind, where=str(source.path))

    @staticmethod
    def _add(name: str, dataset: Any, arrays: dict[str, NDArray[Any]], where: str) -> None:
        kind = dataset.attrs.get("MATLAB_class", b"")
        text = kind.decode() if isinstance(kind, bytes) else str(kind)
        if text in NO_SAMPLES or dataset.shape is None or "MATLAB_empty" in dataset.attrs:
            return
        if dataset.dtype.kind not in "fiubV" or dataset.ndim == 0 or dataset.external:
            return
        require_size(dataset.size, where)
        arrays[name.strip("/").replace("/", ".")] = dataset[()]


class Parquet(LogReader):
    """Parquet; null is a missing cell, a list one column an element, and what is not numeric is text."""

    title = "Parquet"

    def recognises(self, source: SourceFile) -> bool:
        """By its magic string."""
        return source.head.startswith(PARQUET_MAGIC)

    def tables(self, source: SourceFile) -> list[LogTable]:
        """One table."""
        with source.on_disk() as path, parquet_file(path) as file:
            require_columns(file.metadata.num_columns, str(source.path))
            require_size(file.metadata.num_columns * file.metadata.num_rows, str(source.path))
            table = file.read()
        columns, texts = _arrow_columns(dict(zip(unique_names(table.column_names), table.columns, strict=True)))
        return [LogTable(name=source.name, kind="Parquet", columns=columns, texts=texts)]


def _arrow_columns(arrays: Mapping[str, Any]) -> tuple[dict[str, Array], dict[str, tuple[str, ...]]]:
    """Columns (n,) of Arrow's arrays by name, `name[i]` of lists of one length, and the first of other values."""
    pa = arrow()
    columns: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for name, array in arrays.items():
        kind = array.type
        lists = any(holds(kind) for holds in (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list))
        if pa.types.is_timestamp(kind):
            columns[name] = array.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy().astype(np.float64) * 1e-9
        elif pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
            columns[name] = np.asarray(array.cast(pa.float64()).to_numpy(), dtype=np.float64)
        elif lists and (elements := _elements(array.combine_chunks())) is not None:
            columns |= {f"{name}[{i}]": column for i, column in enumerate(elements.T)}
        else:
            texts[name] = tuple(str(value)[:TEXT_LENGTH] for value in array.slice(0, 3).to_pylist())
    return columns, texts


def _elements(lists: Any) -> Array | None:
    """The numbers (n, k) of an Arrow array of lists, NaN where a list is null; None of text and unequal lengths."""
    filled = lists.drop_null()
    numbers, lengths = filled.flatten().to_numpy(zero_copy_only=False), np.unique(filled.value_lengths())
    if numbers.dtype.kind not in "fiu" or len(lengths) != 1 or not 0 < lengths[0] <= MOST_COLUMNS_OF_ARRAY:
        return None
    rows = np.full((len(lists), int(lengths[0])), np.nan)
    rows[np.asarray(lists.is_valid())] = numbers.reshape(len(filled), -1)
    return rows


BOOKKEEPING = re.compile(r"(?:frame_|episode_|task_)?index|next\..*")
"""Columns of a LeRobot data set that nobody measured."""
CONTACT, CONTACT_STD = "observation.contact_wrench", "observation.contact_wrench_std"
PREDICTION = "observation.wrench_prediction"
"""Features that `compensate --lerobot` writes, which nobody measured either."""
LARGEST_INFO = 1 << 24
"""Bytes of a data set's description."""


class LeRobot(LogReader):
    """A LeRobot data set, version 2 or 3: an episode is a recording, its vectors are lists with or without names.

    An episode is given as DATASET/episode_000003, whichever file holds it, a data set of one by its folder.
    """

    title = "LeRobot data set"
    rank = -2
    without_file = True

    def recognises(self, source: SourceFile) -> bool:
        """A folder with meta/info.json, or an episode of one."""
        return episode_of(source.path) is not None

    def tables(self, source: SourceFile) -> list[LogTable]:
        """One table, each column also called as the data set's description calls it."""
        folder, number = episode_of(source.path) or (source.path, None)
        features = _features(folder)
        held = episodes_of(folder, number)
        if number is None and len(held) == 1:
            number = next(iter(held))
        if number not in held:
            shown = ", ".join(str(folder / f"episode_{episode:06d}") for episode in sorted(held)[:MOST_EPISODES])
            what = f"{len(held)} episodes, each a recording" if number is None else f"there is no episode {number}"
            more = f", .. ({len(held)} in all)" if len(held) > MOST_EPISODES else ""
            raise source.error(what, f"give one: {shown}{more}" if held else "give a data set with episodes")
        columns, texts = _arrow_columns(_rows_of_episode(held[number], number))
        called = {
            f"{feature}[{i}]": f"{feature}.{element.removesuffix('.pos')}"
            for feature, names in features.items()
            if f"{feature}[{len(names) - 1}]" in columns and f"{feature}[{len(names)}]" not in columns
            for i, element in enumerate(names)
        }
        name = f"{folder.name}/episode_{number:06d}"
        return [LogTable(name=name, kind="LeRobot episode", columns=columns, texts=texts, called=called)]


MOST_EPISODES = 3
"""That a message names."""


def _features(folder: Path) -> dict[str, list[str]]:
    """Names of the elements of each vector, as a data set's description has them: a list, or one below a heading."""
    path = folder / "meta" / "info.json"
    with path.open("rb") as stream:
        described = json.loads(stream.read(LARGEST_INFO))
    names = {}
    for feature, description in described["features"].items():
        listed = description.get("names")
        listed = next(iter(listed.values()), None) if isinstance(listed, dict) else listed
        if isinstance(listed, list) and listed and all(isinstance(name, str) for name in listed):
            names[feature] = listed
    return names


def episodes_of(folder: Path, number: int | None = None) -> dict[int, Path]:
    """Files of a data set by the numbers of their episodes; of that file alone that is called as an episode is.

    Raises InputError where a file does not number its episodes, or two hold rows of one.
    """
    own = sorted(folder.glob(f"data/**/episode_{number:06d}.parquet")) if number is not None else []
    held: dict[int, Path] = {}
    for path in own or sorted(folder.glob("data/**/*.parquet")):
        try:
            with parquet_file(path) as file:
                table = file.read(["episode_index"])
        except (OSError, arrow().ArrowException) as error:
            what = f"cannot be read as Parquet: {' '.join(str(error).split()).rstrip('.')}"
            raise InputError(what=what, where=str(path), remedy="give a data set that is whole") from None
        numbers = np.unique(table.column(0).to_numpy() if table.num_columns else np.zeros(1))
        if numbers.dtype.kind not in "iu":
            what, remedy = "episode_index is not a whole number in each row", "give a data set that is whole"
            raise InputError(what=what, where=str(path), remedy=remedy)
        for episode in numbers.tolist():
            if episode in held:
                what, remedy = f"episode {episode} is in {held[episode].name} too", "put an episode's rows in one file"
                raise InputError(what=what, where=str(path), remedy=remedy)
            held[episode] = path
    return held


def _rows_of_episode(path: Path, number: int) -> dict[str, Any]:
    """Arrow's arrays of one episode of a file, without pictures and what nobody measured."""
    with parquet_file(path) as file:
        wanted = [field.name for field in file.schema_arrow if not BOOKKEEPING.fullmatch(field.name)]
        wanted = [name for name in wanted if not name.startswith("observation.images")]
        wanted = [name for name in wanted if name not in (CONTACT, CONTACT_STD, PREDICTION)]
        require_size(file.metadata.num_columns * file.metadata.num_rows, str(path))
        table = file.read([*wanted, "episode_index"])
    of_episode = table.filter(arrow().array(table.column("episode_index").to_numpy() == number))
    return {name: of_episode.column(name) for name in wanted}


DEEPEST = 6
"""Levels of structs and cells that are looked into."""


class Matlab(LogReader):
    """MATLAB .mat of version 5 to 7; version 7.3 is HDF5."""

    title = "MATLAB .mat"

    def recognises(self, source: SourceFile) -> bool:
        """By its header; version 7.3 states it too."""
        return source.head.startswith(b"MATLAB 5.0 MAT-file")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """Every numeric array; those of one length in one table, but the elements of a cell each in its own."""
        from scipy.io import loadmat  # slow to import

        with source.on_disk() as path:
            variables = loadmat(path, struct_as_record=False, squeeze_me=True)
        arrays: dict[str, NDArray[Any]] = {}
        for name, value in variables.items():
            if not name.startswith("__"):
                collect_arrays(name, value, arrays)
        return tables_of_arrays(arrays, name=source.name, kind="MATLAB", where=str(source.path))


def collect_arrays(name: str, value: Any, arrays: dict[str, NDArray[Any]], depth: int = 0) -> None:
    """Add the numeric arrays in a value of `loadmat` by their paths: `struct.field`, `cell{1}`."""
    if depth > DEEPEST:
        return
    fields = getattr(value, "_fieldnames", None)
    if fields is not None:
        for field in fields:
            collect_arrays(f"{name}.{field}", getattr(value, field), arrays, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for place, element in enumerate(value.ravel()[:MOST_CELLS], 1):
            collect_arrays(f"{name}{{{place}}}", element, arrays, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        arrays[name] = value
