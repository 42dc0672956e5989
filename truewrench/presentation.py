"""How results of all packages are presented: `fit.summary()` and the like ask here."""

from __future__ import annotations

from typing import Any

from diagnosis.diagnosis import Diagnosis
from estimation.fit import Fit


def plot(
    result: Any,
    kind: str | None = None,
    *,
    channel: str | None = None,
    backend: str = "matplotlib",
    ax: Any = None,
) -> Any:
    """The result as a figure of matplotlib or plotly."""
    from truewrench.plots.result_figure import result_figure  # loads matplotlib

    return result_figure(result, kind=kind, channel=channel, backend=backend, ax=ax)


def summary(result: Any) -> str:
    """The result as text: of a fit whether the model fits, of a diagnosis the verdict with its evidence."""
    if isinstance(result, Diagnosis):
        from truewrench.text.diagnosis_text import diagnosis_text

        return diagnosis_text(result)
    if isinstance(result, Fit):
        from truewrench.text.fit_summary import FitSummary

        return FitSummary(result, result.intervals()).text(None)
    return str(result)


def data(result: Any) -> dict[str, Any]:
    """The result as plain data: that of its file where it has one, else its table and remarks."""
    from truewrench.plain_data import plain_data

    return plain_data(result)


def dataset(result: Any) -> Any:
    """The result as labelled arrays of xarray."""
    from truewrench.labelled_arrays import labelled_arrays

    return labelled_arrays(result)
