"""`truewrench compare`: several models on the same recordings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from truewrench.options import Subcommands, add_report, print_result, provenance_of


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Compare fitted models on the same recordings: where each fails, by channel and frequency band, which"
        " difference is significant, and what changed in the parameters. The biases are re-estimated on each recording."
    )
    command = commands.add_parser("compare", help="several models on the same recordings", description=text)
    command.add_argument("models", nargs="+", metavar="MODEL.json", help="model files of `fit --out`, `diagnose --out`")
    text = "recordings (CSV or Parquet) of the same rig and tool, best of a motion that no model was fitted to"
    command.add_argument("--on", nargs="+", required=True, metavar="REC", help=text)
    add_report(command)
    command.add_argument("--json", action="store_true", help="print the comparison as JSON alone")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Compare, write the report, print tables."""
    from diagnosis.comparison.model_comparison import compare_models
    from truewrench.files.data_set import file_labels, read_recordings, require_different
    from truewrench.files.model_file import ModelFile
    from truewrench.files.output import progress_line

    paths = [Path(path) for path in arguments.models]
    require_different(paths, "the model is given twice")
    models = {label: ModelFile.read(path) for label, path in zip(file_labels(paths), paths, strict=True)}
    rig = next((model.rig for model in models.values() if model.rig is not None), None)
    recordings = read_recordings(arguments.on, rig=rig)
    with progress_line() as progress:
        progress("compare")
        found = compare_models(models, recordings)
    written = []
    if arguments.report is not None:
        from truewrench.reports.fit_report import comparison_report
        from truewrench.reports.report_files import write_report_files

        provenance = provenance_of(arguments, *paths, *arguments.on)
        texts = comparison_report(found, provenance)
        written = write_report_files(texts, arguments.report)
    print_result(arguments, lambda: found, found.to_data, written)
