"""Options: those that several commands share."""

from __future__ import annotations

import argparse
from pathlib import Path

Subcommands = argparse._SubParsersAction  # argparse has no public name for what add_subparsers returns


def add_recordings(command: argparse.ArgumentParser) -> None:
    """Add the options that say what was recorded, on which rig."""
    command.add_argument("recordings", nargs="+", metavar="REC", help="recording (CSV or Parquet), one rig and tool")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML); joint angles need one")


def add_own_effects(command: argparse.ArgumentParser) -> None:
    """Add the option that names a file with effects of the user's own."""
    command.add_argument("--effects", type=Path, metavar="FILE", help="effects of your own, formulas in TOML")


MOST_WORKERS = 1000


def add_workers(command: argparse.ArgumentParser) -> None:
    """Add the option that says how many processes share the work."""
    text = "processes that share the work (default: one for each core, under Linux); the result is the same whatever N"
    command.add_argument("--workers", type=worker_count, metavar="N", help=text)


def worker_count(text: str) -> int:
    """A whole number above zero; argparse makes one line of what is wrong."""
    if not text.isdecimal() or not 1 <= int(text) <= MOST_WORKERS:
        raise argparse.ArgumentTypeError(f"a number of at least one, at most {MOST_WORKERS}, is needed, not {text!r}")
    return int(text)


def add_repeatable(command: argparse.ArgumentParser, option: str, *, metavar: str, text: str) -> None:
    """Add an option that may be given several times."""
    help_text = f"{text}; may be given several times"
    command.add_argument(option, action="append", default=[], metavar=metavar, help=help_text)
