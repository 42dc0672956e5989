"""Page of the commands: what each prints for `--help`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from truewrench.command_line import parser

WIDTH = "100"
"""Columns of the help texts."""
HEAD = """(commands)=
# Commands

`truewrench COMMAND --help` prints what stands here. Exit code 0 means that the work was done, whatever was found; bad
input or usage is one line with what is wrong, where and the remedy, and exit code 2.

`--progress` writes progress as lines, for a log; `--quiet` prints errors and warnings alone; `--json` prints the result
alone, for scripts; `eval "$(register-python-argcomplete truewrench)"` completes commands, options and effects in the
shell. `TRUEWRENCH_CACHE=FOLDER` moves the cache of derivations, `TRUEWRENCH_CACHE=off` disables it.
"""


def write_command_page(folder: Path) -> None:
    """Write `commands.md` to the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "commands.md").write_text(command_page(), encoding="utf-8")


def command_page() -> str:
    """Every command under a heading of its own."""
    os.environ["COLUMNS"] = WIDTH
    (commands,) = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    sections = [
        f"## {name}\n\n```text\n{command.format_help().rstrip()}\n```" for name, command in commands.choices.items()
    ]
    return "\n".join([HEAD, *(f"{section}\n" for section in sections)])
