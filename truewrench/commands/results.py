"""What every command does with its result: whether it can be written, printing, provenance, warnings of the reading."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.recordings.reading_report import StepKind
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from truewrench.files.output import say

if TYPE_CHECKING:
    from truewrench.reports.report_files import Provenance


def provenance_of(arguments: argparse.Namespace, *files: str | Path | None) -> Provenance:
    """What a report says about itself: the command as typed, and the files that it read."""
    from truewrench.reports.report_files import Provenance

    return Provenance.now(getattr(arguments, "typed", ""), [file for file in files if file is not None])


def print_result(
    arguments: argparse.Namespace,
    text: Callable[[], object],
    data: Callable[[], Mapping[str, Any]],
    write: Callable[[], Sequence[Path]] = tuple,
) -> None:
    """Write the files of a result, then print it: with --json its data alone, else its text and the files written.

    Where the files cannot be written, as on a full disk, the result is printed all the same, and the error raised then:
    what took minutes to compute is not lost.
    """
    written: Sequence[Path] = ()
    failure: Exception | None = None
    try:
        written = write()
    except (InputError, OSError) as error:
        failure = error
    if arguments.json:
        print(json.dumps(data(), indent=2, allow_nan=False))
    else:
        print(text())
        if written:
            print("\nWritten: " + ", ".join(map(str, written)))
    if failure is not None:
        sys.stdout.flush()
        raise failure


@contextmanager
def suspicions_named(recordings: Sequence[Recording]) -> Iterator[None]:
    """Name what was suspicious when these recordings were read: a line each on stderr, in an InputError the first."""
    said = [
        f"{recording.name}: {str(step).removeprefix(f'{step.where}: ')}"
        for recording in recordings
        for step in (() if recording.reading is None else recording.reading.of(StepKind.SUSPICIOUS))
    ]
    try:
        yield
    except InputError as error:
        what = "; ".join([error.what, *(line for line in said[:1] if error.what not in line)])
        raise InputError(what=what, where=error.where, remedy=error.remedy) from None
    for line in said:
        say(f"warning: {line}")
