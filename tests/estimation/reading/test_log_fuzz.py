"""Damaged and hostile files: one clear line or a reading, never another exception, in bounded memory."""

from __future__ import annotations

import gc
import gzip
import io
import pickle
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from estimation.reading.log_reading import imported
from modeling.errors import InputError
from tests.shared.log_files import FORMATS, original

pytest.importorskip("mujoco")

LARGE = 2 << 30
Make = Callable[[Path], Path]


def file_of(content: bytes, name: str = "log.csv") -> Make:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


def names(columns: int) -> bytes:
    """A line of column names."""
    return ",".join(f"c{i}" for i in range(columns)).encode() + b"\n"


def ones(columns: int) -> bytes:
    """A line of ones."""
    return b"1," * (columns - 1) + b"1\n"


def noise(name: str, head: bytes = b"") -> Make:
    return file_of(head + np.random.default_rng(len(name)).bytes(20_000), name)


def sparse(name: str, head: bytes = b"") -> Make:
    """A file of 2 GB that takes no room on the disk: zeros behind a head."""

    def make(folder: Path) -> Path:
        path = folder / name
        with path.open("wb") as stream:
            stream.write(head)
            stream.truncate(LARGE)
        return path

    return make


def damaged(format_name: str, share: float, *, spoilt: bool = False) -> Make:
    """A format's file cut at a share of its length, or with a block of noise there."""

    def make(folder: Path) -> Path:
        source = FORMATS[format_name](original().iloc[:200], folder)[0]
        path = next(p for p in sorted(source.iterdir()) if p.suffix != ".yaml") if source.is_dir() else source
        content = path.read_bytes()
        place = int(len(content) * share)
        bad = content[:place]
        if spoilt:
            bad += np.random.default_rng(place).bytes(200) + content[place + 200 :]
        path.write_bytes(bad)
        return path

    return make


@cache
def zeros() -> bytes:
    """64 MB of zeros as 64 kB of gzip."""
    return gzip.compress(b"time,fx\n" + bytes(64 << 20))


def bomb(folder: Path) -> Path:
    return file_of(zeros(), "bomb.csv.gz")(folder)


def zip_of_blanks(name: str, member: str, megabytes: int) -> Make:
    """A format that is a zip file itself, with a member of blanks that hardly takes room."""

    @cache
    def content() -> bytes:
        packed = io.BytesIO()
        archive = zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        with archive, archive.open(member, "w", force_zip64=True) as stream:
            for _ in range(megabytes // 4):
                stream.write(b" " * (4 << 20))
        return packed.getvalue()

    return lambda folder: file_of(content(), name)(folder)


def two_in_a_zip(folder: Path) -> Path:
    with zipfile.ZipFile(folder / "logs.zip", "w") as archive:
        archive.writestr("a.csv", "1,2\n")
        archive.writestr("b.csv", "1,2\n")
    return folder / "logs.zip"


def object_array(folder: Path) -> Path:
    np.save(folder / "objects.npy", np.array([{"a": 1}] * 30, dtype=object), allow_pickle=True)
    return folder / "objects.npy"


def lying_npy(folder: Path) -> Path:
    """A header that promises 8 TB."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }"
    content = b"\x93NUMPY\x01\x00" + np.uint16(118).tobytes() + header.ljust(117) + b"\n"
    return file_of(content + bytes(1000), "lies.npy")(folder)


def csv_lines(frame_rows: int = 60) -> list[str]:
    text = original().iloc[:frame_rows].rename(columns={"time": "stamp"}).to_csv(index=False)
    return text.strip().split("\n")


def edited(edit: Callable[[list[str]], list[str]]) -> Make:
    return lambda folder: file_of("\n".join(edit(csv_lines())).encode())(folder)


REFUSED: dict[str, Make] = {
    "nothing": file_of(b""),
    "blanks": file_of(b" \n\n \t\n"),
    "header alone": edited(lambda lines: lines[:1]),
    "three rows": edited(lambda lines: lines[:4]),
    "prose": file_of(b"Dear colleague,\nplease find the log attached.\nYours\n" * 20),
    "web page": file_of(b"<!DOCTYPE html><html><body><p>404</p></body></html>\n" * 30),
    "json": file_of(b'{"time": [0, 1], "fx": [1, 2]}'),
    "a million columns": lambda folder: file_of(names(10**6) + ones(10**6))(folder),
    "a million unnamed columns": lambda folder: file_of(ones(10**6) * 3)(folder),
    "30 000 columns": lambda folder: file_of(ones(30_000) * 3)(folder),
    "one long line": lambda folder: file_of(b"1" * (6 << 20))(folder),
    "noise.csv": noise("noise.csv"),
    "noise.bag": noise("noise.bag"),
    "noise.mcap": noise("noise.mcap", b"\x89MCAP0\r\n"),
    "noise.db3": noise("noise.db3", b"SQLite format 3\0"),
    "noise rosbag": noise("a.bag", b"#ROSBAG V2.0\n"),
    "noise.mat": noise("noise.mat", b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x01IM"),
    "noise.h5": noise("noise.h5", b"\x89HDF\r\n\x1a\n"),
    "noise.npy": noise("noise.npy", b"\x93NUMPY\x01\x00"),
    "noise.npz": noise("noise.npz", b"PK\x03\x04"),
    "noise.xlsx": noise("noise.xlsx", b"PK\x03\x04"),
    "noise.parquet": noise("noise.parquet", b"PAR1"),
    "noise.gz": noise("noise.csv.gz", b"\x1f\x8b\x08"),
    "noise.xz": noise("noise.csv.xz", b"\xfd7zXZ\x00"),
    "noise.bz2": noise("noise.csv.bz2", b"BZh9"),
    "sparse.csv": sparse("sparse.csv"),
    "sparse behind a header": sparse("sparse.csv", b"time,fx,fy,fz\n0,1,2,3\n1,2,3,4\n"),
    "sparse.bag": sparse("sparse.bag", b"#ROSBAG V2.0\n"),
    "sparse.mcap": sparse("sparse.mcap", b"\x89MCAP0\r\n"),
    "sparse.npy": sparse("sparse.npy", b"\x93NUMPY\x01\x00"),
    "sparse.h5": sparse("sparse.h5", b"\x89HDF\r\n\x1a\n"),
    "sparse.mat": sparse("sparse.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"),
    "gzip bomb": bomb,
    "bomb.xlsx": zip_of_blanks("bomb.xlsx", "xl/worksheets/sheet1.xml", 260),
    "zip of two": two_in_a_zip,
    "pickle": file_of(pickle.dumps({"time": [1, 2]}), "log.pkl"),
    "pickle in an array": object_array,
    "lying npy": lying_npy,
    "empty folder": lambda folder: folder,
    "no file": lambda folder: folder / "missing.bag",
    "cut xlsx": damaged("excel", 0.5),
    "cut parquet": damaged("parquet", 0.5),
    "cut npz": damaged("numpy", 0.5),
    "cut h5": damaged("franka hdf5", 0.3),
    "cut mat": damaged("matlab", 0.5),
    "cut gz": damaged("gzip", 0.6),
    "cut sqlite3": damaged("ros 2 bag sqlite3", 0.6),
}

SURVIVED: dict[str, Make] = {
    "ragged rows": edited(lambda lines: [line + ",1,2,3" if i % 10 == 9 else line for i, line in enumerate(lines)]),
    "short rows": edited(lambda lines: [line.rsplit(",", 3)[0] if i == 30 else line for i, line in enumerate(lines)]),
    "text among numbers": edited(
        lambda lines: [line.replace("0.", "error", 1) if i == 20 else line for i, line in enumerate(lines)]
    ),
    "last row cut": edited(lambda lines: [*lines[:-1], lines[-1][:40]]),
    "quotes left open": edited(lambda lines: [*lines[:50], '"' + lines[50], *lines[51:]]),
    "cut bag": damaged("ros 1 bag", 0.7),
    "cut mcap": damaged("ros 2 bag mcap", 0.7),
    "spoilt bag": damaged("ros 1 bag", 0.4, spoilt=True),
    "spoilt mcap": damaged("ros 2 bag mcap", 0.4, spoilt=True),
    "spoilt sqlite3": damaged("ros 2 bag sqlite3", 0.4, spoilt=True),
    "spoilt csv": damaged("ur_rtde", 0.5, spoilt=True),
    "spoilt mat": damaged("matlab", 0.5, spoilt=True),
    "spoilt h5": damaged("franka hdf5", 0.5, spoilt=True),
    "spoilt xlsx": damaged("excel", 0.5, spoilt=True),
    "spoilt parquet": damaged("parquet", 0.5, spoilt=True),
}
"""Read, or refused in one line: both are right."""


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """A file left open is found by the collector among what is young: in the test that opened it."""
    yield
    gc.collect(1)


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        imported(path)
    return str(caught.value)


@pytest.mark.parametrize("case", REFUSED)
def test_one_clear_line(case: str, tmp_path: Path) -> None:
    text = refusal(REFUSED[case](tmp_path))
    assert "\n" not in text
    assert len(text) < 700
    assert ";" in text  # a remedy


@pytest.mark.parametrize("case", SURVIVED)
def test_one_clear_line_or_a_reading(case: str, tmp_path: Path) -> None:
    path = SURVIVED[case](tmp_path)
    with suppress(InputError):
        assert imported(path).report.samples > 10


def test_an_archive_that_says_its_size_is_not_unpacked(tmp_path: Path) -> None:
    assert "decompresses to 0.254 GiB" in refusal(REFUSED["bomb.xlsx"](tmp_path))


def test_too_little_memory_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind the readers too: ten million rows of 14 columns do not fit into 2 GiB."""

    def exhausted(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("estimation.reading.log_import.column_mapping", exhausted)
    assert "larger than the memory that is free" in refusal(edited(lambda lines: lines)(tmp_path))


def test_a_damaged_bag_is_called_damaged(tmp_path: Path) -> None:
    for case in ("noise rosbag", "noise.mcap", "sparse.bag", "cut sqlite3"):
        folder = tmp_path / case
        folder.mkdir()
        assert "AssertionError" not in refusal(REFUSED[case](folder))


def test_a_pickle_is_named_and_not_opened(tmp_path: Path) -> None:
    assert "pickle" in refusal(REFUSED["pickle"](tmp_path))
    with pytest.raises(InputError, match="pickle, which can run programs and is never opened"):
        imported(object_array(tmp_path))


MEMORY = """
import resource, sys
resource.setrlimit(resource.RLIMIT_DATA, ({limit}, {limit}))
from truewrench.command_line import main
print([main(["import", path]) for path in sys.argv[1:]])
"""
LARGE_CASES = ("sparse.csv", "sparse behind a header", "sparse.bag", "sparse.mcap", "gzip bomb", "lying npy")


def test_memory_stays_bounded(tmp_path: Path) -> None:
    """In half a gigabyte, of which the imports take a good part; one process reads all, so that none keeps it."""
    paths = []
    for case in LARGE_CASES:
        folder = tmp_path / case
        folder.mkdir()
        paths.append(str(REFUSED[case](folder)))
    code = MEMORY.format(limit=512 << 20)
    done = subprocess.run([sys.executable, "-c", code, *paths], capture_output=True, text=True)
    assert done.stdout == f"{[2] * len(paths)}\n", done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == len(paths)
    for line, path in zip(lines, paths, strict=True):
        assert line.startswith("error: ")
        assert Path(path).name in line
