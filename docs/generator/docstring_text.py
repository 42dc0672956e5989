"""Docstrings as reStructuredText: bars are absolute values, and aligned names with their meaning become a list."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

BEFORE_SECTIONS = 400
"""Priority: before numpydoc sections are read, at 500."""
_FIELD = re.compile(r"^(\w+(?:, \w+)*) {2,}(\S.*)$")
_SECTION = re.compile(r"^-{3,}$")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with autodoc."""
    app.connect("autodoc-process-docstring", _process, priority=BEFORE_SECTIONS)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _process(_app: Any, _kind: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = restructured(lines)


def restructured(lines: list[str]) -> list[str]:
    """The lines with lists and escaped bars; examples stay as they are."""
    found: list[str] = []
    example = False
    for number, line in enumerate(lines):
        example = line.lstrip().startswith(">>>") or (example and bool(line.strip()))
        if example:
            found.append(line)
            continue
        field = None if _in_section(lines, number) else _FIELD.match(line)
        text = f"- ``{field[1]}``: {field[2]}" if field else _within_list(found, line)
        if field and found and found[-1] and not _is_item(found[-1]):
            found.append("")
        found.append(text.replace("|", r"\|"))
        follows = lines[number + 1] if number + 1 < len(lines) else ""
        if _is_item(text) and follows and not follows.startswith(" ") and not _FIELD.match(follows):
            found.append("")
    return found


def _in_section(lines: list[str], number: int) -> bool:
    """Whether a numpydoc section has begun above."""
    return any(_SECTION.match(line) for line in lines[: number + 1])


def _is_item(line: str) -> bool:
    return line.startswith(("- ``", "  "))


def _within_list(found: list[str], line: str) -> str:
    """A continuation of a list's item keeps its indentation, two columns."""
    return f"  {line.strip()}" if found and _is_item(found[-1]) and line.startswith(" ") else line
