"""Parts of result.json that are no results of their own."""

from __future__ import annotations

from typing import Any

from diagnosis.acceptance.recording_disturbance import RecordingDisturbance
from diagnosis.verdict.unexplained_residual import UnexplainedResidual
from estimation.least_squares.estimates import estimates_data


def disturbance_data(own: RecordingDisturbance) -> dict[str, Any]:
    """A recording-specific disturbance as plain data."""
    return {
        "recording": own.recording.name,
        "id": own.effect.id,
        "swing": dict(own.swing),
        "parameters": estimates_data(own.parameters),
    }


def unexplained_data(residual: UnexplainedResidual) -> dict[str, Any]:
    """The unexplained residual as plain data."""
    return {
        "where": residual.where,
        "explainable_rms": dict(residual.explainable_rms),
        "looks_like": list(residual.looks_like),
        "share": residual.share,
    }
