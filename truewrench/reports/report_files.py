"""Files of a report: one folder with HTML, for reading, and Markdown, for an issue or a lab book."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from truewrench.files.output import atomic_write, make_folder
from truewrench.reports.page_templates import html_page, markdown_page

REPORT_FILES = ("report.html", "report.md")


@dataclass(frozen=True)
class ReportTexts:
    """A report as a self-contained HTML page, and as Markdown without pictures."""

    html: str
    markdown: str

    @classmethod
    def of(cls, template: str, values: Mapping[str, Any]) -> Self:
        """The values in the templates of this name."""
        return cls(html_page(f"{template}.html", values), markdown_page(f"{template}.md", values))


def write_report_files(texts: ReportTexts, folder: str | Path) -> list[Path]:
    """Write both files into a folder, or none; return their paths.

    Raises InputError when they cannot be written.
    """
    paths = [make_folder(Path(folder)) / name for name in REPORT_FILES]
    with ExitStack() as files:
        for path, text in zip(paths, (texts.html, texts.markdown), strict=True):
            files.enter_context(atomic_write(path)).write_text(text, encoding="utf-8")
    return paths
