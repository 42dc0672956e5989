"""Files of a report: one folder with HTML, for reading, and Markdown, for an issue or a lab book."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from modeling.table import Table
from truewrench.files.output import REPORT_FILES, atomic_write, make_folder
from truewrench.reports.page_templates import html_page, markdown_page

# Provenance of a report: date, version, command and hashes of the files that it was made from.


@dataclass(frozen=True)
class InputFile:
    """A file that was read: its path as given, and the SHA-256 of its content, empty where that is not known."""

    path: str
    sha256: str

    @classmethod
    def of(cls, path: str | Path) -> InputFile:
        """The hash of a file as it is now; none of what is no file, such as a pipe, or cannot be read again."""
        source = Path(path)
        try:
            if not source.is_file():
                return cls(str(path), "")
            with source.open("rb") as content:
                return cls(str(path), file_digest(content, "sha256").hexdigest())
        except OSError:
            return cls(str(path), "")


@dataclass(frozen=True)
class Provenance:
    """When, by what and of what a report was made; `command` is empty in Python."""

    date: str
    version: str
    command: str = ""
    inputs: tuple[InputFile, ...] = ()

    @classmethod
    def now(cls, command: str = "", inputs: Iterable[str | Path] = ()) -> Provenance:
        """The present; the date is SOURCE_DATE_EPOCH's where that is set, so that a report can be made again."""
        epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
        when = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdecimal() else datetime.now(UTC)
        input_files = tuple(input_files for path in inputs for input_files in _files(Path(path)))
        return cls(when.strftime("%Y-%m-%d %H:%M UTC"), version("truewrench"), command, input_files)

    @property
    def table(self) -> Table:
        """What and when, then a row for each input file."""
        rows = [("made", self.date), ("by", f"truewrench {self.version}")]
        rows += [("command", self.command)] if self.command else []
        return Table.of(("", ""), [*rows, *((f"SHA-256 of {i.path}", i.sha256 or "not known") for i in self.inputs)])


def _files(path: Path) -> list[InputFile]:
    """The file itself; of a folder, which is a recording too, all files in it."""
    if path.is_dir():
        return [InputFile.of(inside) for inside in sorted(path.rglob("*")) if inside.is_file()]
    return [InputFile.of(path)]


@dataclass(frozen=True)
class ReportTexts:
    """A report as a self-contained HTML page, and as Markdown without pictures."""

    html: str
    markdown: str

    @classmethod
    def of(cls, template: str, values: Mapping[str, Any]) -> Self:
        """The values in the templates of this name."""
        return cls(html_page(f"{template}.html", values), markdown_page(f"{template}.md", values))

    def write(self, folder: str | Path) -> list[Path]:
        """Write both files into a folder, or none; return their paths.

        Raises InputError when they cannot be written.
        """
        paths = [make_folder(Path(folder)) / name for name in REPORT_FILES]
        with ExitStack() as files:
            for path, text in zip(paths, (self.html, self.markdown), strict=True):
                files.enter_context(atomic_write(path)).write_text(text, encoding="utf-8")
        return paths
