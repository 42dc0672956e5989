"""Exceptions with one-line messages: location, fault, remedy."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

LONGEST_QUOTATION = 40
"""Characters of user input repeated in a message, so that it stays one line."""


def quoted(text: object) -> str:
    """The text in quotes, truncated, with non-printable and control characters escaped."""
    shown = cut(text)
    return f"'{shown}'" if shown.isprintable() else ascii(shown)


def cut(text: object) -> str:
    """The text, such as the name of a column, truncated for a message."""
    full = str(text)
    return full[:LONGEST_QUOTATION] + "..." * (len(full) > LONGEST_QUOTATION)


def kind_of(given: object) -> str:
    """The class of what was given, with its article: `a str`, `an int`; None as it is."""
    if given is None:
        return "None"
    name = type(given).__name__
    return f"{'an' if name[0] in 'aeioAEIO' else 'a'} {name}"


def suggestion(name: str, choices: Collection[str], shown: Callable[[str], str] = str, most: int = 12) -> str:
    """Remedy for an unknown name: the choices closest to it, or that contain it, else `most` of them, as `shown`.

    Closest is a choice that qualifies the name: `com_offset.mlx` for `mlx`.
    """
    from difflib import get_close_matches

    qualified = [choice for choice in choices if choice.endswith(f".{name}")] if name else []
    close = qualified[:most] or get_close_matches(name, choices, n=2)
    close = close or ([c for c in choices if name.lower() in c.lower()][:most] if len(name) > 2 else [])
    if close:
        return f"did you mean {' or '.join(map(shown, close))}?"
    return f"use one of {', '.join(map(shown, [*choices][:most]))}{', ..' * (len(choices) > most)}"


class TruewrenchError(Exception):
    """Base class of all errors that this project raises deliberately.

    Examples
    --------
    >>> import truewrench as tw
    >>> issubclass(tw.InputError, tw.TruewrenchError)
    True
    """


class InputError(TruewrenchError):
    """Invalid user input: what is wrong with it, where it is, and the remedy.

    Examples
    --------
    >>> import truewrench as tw
    >>> try:
    ...     tw.Rig.read("missing.toml")
    ... except tw.InputError as error:
    ...     print(error.where)
    missing.toml
    """

    def __init__(self, *, what: str, where: str, remedy: str) -> None:
        self.what, self.where, self.remedy = (" ".join(text.split()) for text in (what, where, remedy))
        super().__init__(f"{self.where}: {self.what}; {self.remedy}")

    def __reduce__(self) -> tuple[object, ...]:
        # The default pickling fails with keyword-only arguments, and pool workers send exceptions back.
        return partial(InputError, what=self.what, where=self.where, remedy=self.remedy), ()


# Text of users' files, and TOML in it; what cannot be read is one clear line.


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


EXTRAS = {
    "h5py": "logs", "openpyxl": "logs", "pyarrow": "logs", "rosbags": "logs", "bokeh": "workbench",
    "tornado": "workbench", "dask": "survey", "distributed": "survey", "mujoco": "simulation", "xarray": "xarray",
}  # fmt: skip
"""Packages that an installation need not have, by the extra of the project that brings each."""


def missing_package(error: ModuleNotFoundError) -> InputError | None:
    """What to install where a package of an extra is not there; None where another module is missing."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    remedy = f'pip install "truewrench[{EXTRAS[package]}]"'
    return InputError(what="the package is not installed", where=package, remedy=remedy)
