"""`truewrench compare`: several models on the same recordings."""

from __future__ import annotations

import argparse
from pathlib import Path

from diagnosis.comparison.model_comparison import compare_models
from truewrench.commands.results import print_result, provenance_of
from truewrench.files.case_files import file_labels, read_recordings, require_different
from truewrench.files.model_file import ModelFile
from truewrench.files.output import progress_line
from truewrench.reports.fit_report import comparison_report


def run(arguments: argparse.Namespace) -> None:
    """Compare, write the report, print tables."""
    paths = [Path(path) for path in arguments.models]
    require_different(paths, "the model is given twice")
    models = {label: ModelFile.read(path) for label, path in zip(file_labels(paths), paths, strict=True)}
    rig = next((model.rig for model in models.values() if model.rig is not None), None)
    recordings = read_recordings(arguments.on, rig=rig)
    with progress_line() as progress:
        progress("compare")
        comparison = compare_models(models, recordings)

    def written() -> list[Path]:
        if arguments.report is None:
            return []
        provenance = provenance_of(arguments, *paths, *arguments.on)
        return comparison_report(comparison, provenance).write(arguments.report)

    print_result(arguments, lambda: comparison, comparison.to_data, written)
