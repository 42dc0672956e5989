"""`truewrench import`: what robots write to a recording, with a report of what was read and mended."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from estimation.case import Case
from estimation.fit import fit_case
from estimation.reading.log_reader import Array
from estimation.reading.log_reading import imported
from estimation.recordings.column_table import arrow
from estimation.recordings.reading_report import ReadingReport
from modeling.errors import InputError, quoted
from modeling.rig import Rig
from truewrench.commands.results import print_result
from truewrench.files.case_files import imported_frames
from truewrench.files.output import atomic_write, progress_line
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import tool_text

PICTURES = (".png", ".svg", ".pdf")
"""Suffixes of the pictures that --plot draws."""
PICTURE_DPI = 144
"""Of a PNG: one and a half times the resolution of a common screen."""
ROWS_AT_ONCE = 100_000
"""Rows of CSV that are formatted at once: some tens of megabytes of text."""
ROWS_OF_GROUP = 500_000
"""Rows of a Parquet row group, which is read at once."""
WRITTEN = (".csv", ".parquet", ".pq")
"""Suffixes of the recordings that --out writes."""
LONGEST_CHECKED = 2_000_000
"""Samples up to which the recording is also made, as `diagnose` will make it; more would be in memory twice."""
LONGEST_FITTED = 50_000
"""Samples up to which a rigid tool is fitted for first estimates, in some tenths of a second; of more the weight alone
tells a mass."""


def _require_known_suffix(out: Path) -> None:
    """A recording is CSV or Parquet, by its suffix; a device has none. Raises InputError."""
    if out.suffix.lower() not in WRITTEN and not (out.exists() and not out.is_file()):
        what = f"recordings are not written as {quoted(out.suffix)}" if out.suffix else "its suffix names no format"
        raise InputError(what=what, where=str(out), remedy=f"give --out a name with one of {', '.join(WRITTEN)}")
    if out.suffix.lower() in WRITTEN[1:]:
        arrow()  # which may not be installed


def _require_picture(path: Path) -> None:
    """Raises InputError for a name that is no picture's."""
    if path.suffix.lower() not in PICTURES:
        what = "no format of a picture that is drawn"
        raise InputError(what=what, where=str(path), remedy=f"give --plot a name that ends in {', '.join(PICTURES)}")


def write_picture(report: ReadingReport, path: Path) -> None:
    """Draw the reading as PNG, SVG or PDF, by the name's ending."""
    from matplotlib import rc_context

    from truewrench.plots.reading_plot import plot_reading

    figure = plot_reading(report)
    with atomic_write(path) as temporary, rc_context({"svg.fonttype": "none"}):
        figure.savefig(temporary, format=path.suffix.lower()[1:], dpi=PICTURE_DPI, facecolor="white")


def run(arguments: argparse.Namespace) -> None:
    """Import, write the recording, print the reading report."""
    if arguments.out is not None:
        _require_known_suffix(arguments.out)
    if arguments.plot is not None:
        _require_picture(arguments.plot)
    rig = None if arguments.rig is None else Rig.read(arguments.rig)
    frames: dict[str, Any] = {"frames": [], "readings": []}
    estimates: tuple[str, dict[str, Any]] = ("", {})
    with progress_line() as progress:
        progress("read" if arguments.out is not None else "read for a report alone, as there is no --out REC")
        log = imported(
            *arguments.sources,
            rig=rig,
            preset=arguments.preset,
            map=arguments.map,
            period=arguments.period,
            strict=arguments.strict,
            one_run=arguments.no_period,
            clock_offset=arguments.clock_offset,
        )
        if (rig is not None or "q1" not in log.columns) and log.report.samples < LONGEST_CHECKED:
            short = log.report.samples <= LONGEST_FITTED
            frames, case = imported_frames(log.recording(rig), detailed=not short)  # what is undecided is said now
            if short and case is not None and not case.misread:
                progress("first estimates")
                estimates = first_estimates(case)

    def written() -> list[Path]:
        with progress_line() as progress:
            if arguments.out is not None:
                progress("write")
                with atomic_write(arguments.out) as path:
                    write_table(log.columns, path, parquet=arguments.out.suffix.lower() in (".parquet", ".pq"))
            if arguments.plot is not None:
                progress("draw")
                write_picture(log.report, arguments.plot)
        return [path for path in (arguments.out, arguments.plot) if path is not None]

    print_result(
        arguments,
        lambda: "\n\n".join(filter(None, [str(log.report), *frames["frames"], estimates[0]])),
        lambda: log.report.to_data() | frames | {"first_estimates": estimates[1] or None},
        written,
    )
    if arguments.json:
        return
    if arguments.out is None and arguments.plot is None:
        print("\nNothing is written without --out REC.")
    if arguments.out is not None:
        print(f"Next: {next_command(arguments.out, arguments.rig, joints='q1' in log.columns)}")


def first_estimates(case: Case) -> tuple[str, dict[str, Any]]:
    """Mass and centre of mass of a rigid tool with std, as text and as data; neither where it cannot be fitted."""
    try:
        fitted = fit_case(case)
        summary = FitSummary(fitted, fitted.intervals())
        unknown, misfitting = summary.unknown_tool, bool(summary.misfitting)
    except InputError:
        return "", {}
    text = tool_text(fitted, misfitting=misfitting, unknown=unknown)
    parameters = {
        name: {"value": estimate.value, "std": estimate.std if isfinite(estimate.std) else None, "unit": estimate.unit}
        for name, estimate in fitted.parameters.items()
    }
    data = {"fits": not misfitting, "tool_unknown": unknown or None, "parameters": parameters}
    return (f"First estimates, of a rigid tool. {text}" if text else ""), data


def next_command(recording: Path, rig: str | None, *, joints: bool) -> str:
    """The command that diagnoses the recording; joint angles need a rig file."""
    stated = ["--rig", rig or "RIG.toml"] if rig is not None or joints else []
    return shlex.join(["truewrench", "diagnose", str(recording), *stated])


def write_table(columns: Mapping[str, Array], path: Path, *, parquet: bool) -> None:
    """Write columns (n,) as Parquet, or as CSV with all digits; rows in blocks, so that no second copy is in memory."""
    samples = len(next(iter(columns.values())))
    if parquet:
        arrow().parquet.write_table(arrow().table(dict(columns)), path, row_group_size=ROWS_OF_GROUP)
        return
    with path.open("w", encoding="utf-8", newline="") as stream:
        for start in range(0, samples, ROWS_AT_ONCE):
            block = pd.DataFrame({name: column[start : start + ROWS_AT_ONCE] for name, column in columns.items()})
            if "repeat" in block:
                block["repeat"] = block["repeat"].astype(int)
            block.to_csv(stream, index=False, header=start == 0)
