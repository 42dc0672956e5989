"""Commands on a page: what is shown is what ran, with what it printed."""

from __future__ import annotations

import shlex
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path


def terminal(*commands: str, exit_code: int = 0, lines: int | None = None) -> None:
    """Run `truewrench` commands in the current folder and print them as on a terminal, with the first `lines` of each.

    Raises RuntimeError when a command ends with another exit code.
    """
    from truewrench.command_line import main

    for command in commands:
        program, *arguments = shlex.split(command)
        if program != "truewrench":
            raise RuntimeError(f"a page runs truewrench alone, not {program}")
        print(f"$ {command}")
        found, printed = _ran(main, arguments)
        shown = printed.rstrip().splitlines()
        print("\n".join([*shown[:lines], *(["..."] if lines and len(shown) > lines else [])]), end="\n\n")
        if found != exit_code:
            raise RuntimeError(f"{command}: exit code {found}, expected {exit_code}\n{printed}")


def _ran(main: object, arguments: list[str]) -> tuple[int, str]:
    """Exit code, and what was printed on either stream."""
    from contextlib import redirect_stdout

    text = StringIO()
    with redirect_stdout(text), redirect_stderr(text):
        try:
            code = main(arguments)  # type: ignore[operator]
        except SystemExit as end:
            code = end.code
    return int(code or 0), text.getvalue()


def show(path: str | Path, lines: int | None = None) -> None:
    """Print a text file, or its first lines."""
    text = Path(path).read_text(encoding="utf-8").rstrip().splitlines()
    print("\n".join([*text[:lines], *(["..."] if lines and len(text) > lines else [])]))
