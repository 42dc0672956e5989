"""What the browser sends stays in its folder, is bounded, and is gone with the page."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import pytest

from modeling.errors import InputError
from truewrench.workbench.uploads import MOST_BYTES, MOST_FILES, MOST_UNPACKED, UploadFolder, require_moderate_archive


@pytest.fixture
def folder() -> Iterator[UploadFolder]:
    found = UploadFolder()
    yield found
    found.remove()


def written(folder: UploadFolder, name: str, content: bytes = b"x") -> str:
    path = folder.place(name)[1]
    path.write_bytes(content)
    return folder.keep(path)


@pytest.mark.parametrize("name", ["../../etc/passwd", "..\\..\\x.csv", "/etc/passwd", "..", "", ".", "a\0b", "<b>.csv"])
def test_every_name_is_a_file_in_the_folder(folder: UploadFolder, name: str) -> None:
    shown, path = folder.place(name)
    root = Path(folder._folder).resolve()
    assert path.resolve().is_relative_to(root)
    assert path.name == shown
    assert not set(shown) & set("/\\<>\0")


def test_the_folder_goes_with_the_page(folder: UploadFolder) -> None:
    path = Path(folder.path(written(folder, "train.csv")))
    assert path.read_bytes() == b"x"
    folder.remove()
    assert not path.exists()


def test_only_numbers_of_its_own_files_have_a_path(folder: UploadFolder) -> None:
    written(folder, "train.csv")
    for number in ("/etc/passwd", "1", "", "../0"):
        with pytest.raises(InputError, match="not here"):
            folder.path(number)


def test_size_and_number_are_bounded(folder: UploadFolder) -> None:
    with pytest.raises(InputError, match="larger than"):
        folder.require_room(MOST_BYTES + 1)
    for number in range(MOST_FILES):
        folder.require_room(1)
        written(folder, f"{number}.csv")
    with pytest.raises(InputError, match="already"):
        folder.require_room(1)


def test_what_is_not_kept_counts_while_it_is_there(folder: UploadFolder) -> None:
    path = folder.place("coming.csv")[1]
    path.write_bytes(bytes(1000))
    assert folder.bytes == 1000
    folder.discard(path)
    assert (folder.bytes, path.exists()) == (0, False)


@pytest.mark.parametrize("packing", ["zip", "gzip"])
def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path, packing: str) -> None:
    """60 MB of zeros in 60 kB: by its ratio, whatever the archive says of itself."""
    bomb = tmp_path / f"bomb.{packing}"
    zeros = bytes(60_000_000)
    if packing == "zip":
        with ZipFile(bomb, "w", ZIP_DEFLATED) as archive:
            archive.writestr("train.csv", zeros)
    else:
        bomb.write_bytes(gzip.compress(zeros))
    with pytest.raises(InputError, match="unpacks to"):
        require_moderate_archive(bomb)


def test_a_table_that_is_packed_is_taken(tmp_path: Path) -> None:
    table = tmp_path / "train.csv.gz"
    table.write_bytes(gzip.compress(b"time,fx,fy,tau\n" + b"0.01,1.25,-3.5,0.125\n" * 20_000))
    require_moderate_archive(table)
    broken = tmp_path / "broken.gz"
    broken.write_bytes(b"\x1f\x8b" + bytes(30))
    with pytest.raises(InputError, match="broken"):
        require_moderate_archive(broken)
    assert MOST_UNPACKED > MOST_BYTES
