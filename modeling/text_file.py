"""Text of users' files, and TOML in it; what cannot be read is one clear line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from modeling.errors import InputError

LARGEST_FILE = 50_000_000
"""Bytes of a file at most, unless its reader says less."""


def file_text(path: str | Path, *, kind: str, syntax: str = "TOML", most: int = LARGEST_FILE) -> str:
    """The text of a UTF-8 file, without a byte order mark; `kind` is what the file should be, as in "a rig file".

    Raises InputError when it cannot be read, is not UTF-8 or has more than `most` bytes.
    """
    try:
        with Path(path).open("rb") as file:
            content = file.read(most + 1)
        text = content.decode("utf-8-sig")
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise InputError(what=reason, where=str(path), remedy=f"give the path of {kind}") from None
    except ValueError as error:  # not UTF-8, or a path that cannot be
        raise _invalid(syntax, error, str(path)) from None
    if len(content) > most:
        raise InputError(what=f"has more than {most} bytes", where=str(path), remedy="divide it into several files")
    return text


def toml_data(text: str, where: str) -> dict[str, Any]:
    """The data of a text in TOML; InputError, naming the line, where it is not."""
    import tomllib

    try:
        return tomllib.loads(text)
    except RecursionError:
        raise _invalid("TOML", "tables are nested too deep", where) from None
    except ValueError as error:
        raise _invalid("TOML", error, where) from None


def _invalid(syntax: str, error: object, where: str) -> InputError:
    return InputError(what=f"not a {syntax} file: {error}", where=where, remedy=f"correct the {syntax} there")
