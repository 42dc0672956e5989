"""Report of any result, in Python: what `--report` writes on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from diagnosis.comparison.model_comparison import ModelComparison
from diagnosis.diagnosis import Diagnosis
from diagnosis.discovery.discovery import Discovery
from diagnosis.study import Study
from estimation.fit import Fit
from modeling.errors import InputError, kind_of
from truewrench.reports.discovery_report import discovery_report
from truewrench.reports.fit_report import comparison_report, fit_report, study_report
from truewrench.reports.report_files import Provenance
from truewrench.reports.report_html import diagnosis_report
from truewrench.text.fit_summary import FitSummary

if TYPE_CHECKING:
    from truewrench.reports.report_files import ReportTexts


def report(result: Fit | Study | Diagnosis | ModelComparison | Discovery, folder: str | Path) -> list[Path]:
    """Write the report of a result: a page without network, zoomable, and the same as Markdown.

    Parameters
    ----------
    result : Fit, Study, Diagnosis, ModelComparison or Discovery
        What `fit`, `study`, `diagnose`, `compare` or `discover` gave; of a study, its steps, and its
        current model with the held-out recordings.
    folder : str or Path
        Where `report.html` and `report.md` go; it is made if there is none.

    Returns
    -------
    list of Path
        Both files.

    Raises
    ------
    InputError
        For what has no report, and when the files cannot be written: then neither is.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig), tw.read("train.csv", rig=rig))
    >>> [path.name for path in tw.report(fit, "fit_report")]
    ['report.html', 'report.md']
    """
    return _texts(result).write(folder)


def _texts(result: object) -> ReportTexts:
    provenance = Provenance.now()
    match result:
        case Diagnosis():
            return diagnosis_report(result, provenance)
        case ModelComparison():
            return comparison_report(result, provenance)
        case Discovery():
            return discovery_report(result, provenance)
        case Study():
            return study_report(result, provenance)
        case Fit():
            return fit_report(FitSummary(result, result.intervals()), provenance)
    remedy = "give what fit, study, diagnose, discover, or compare of several models gave"
    raise InputError(what=f"{kind_of(result)} has no report", where="report", remedy=remedy)
