"""Serialisation of a diagnosis to result.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnosis.acceptance.recording_disturbance import RecordingDisturbance
from diagnosis.verdict.finding import Finding
from diagnosis.verdict.selection_step import SelectionStep
from diagnosis.verdict.unexplained_residual import UnexplainedResidual
from estimation.fit import Estimate


def step_data(step: SelectionStep) -> dict[str, Any]:
    """A selection step as plain data."""
    first = step.training[0]
    validation = step.validation[0] if step.validation else None
    return {
        "effect": step.effect,
        "misfit": first.misfit,
        "rms": dict(first.rms),
        "explainable_rms": _optional(first.explainable_rms),
        "validation_rms": None if validation is None else dict(validation.rms),
        "validation_explainable_rms": None if validation is None else _optional(validation.explainable_rms),
    }


def _optional(values: Mapping[str, float] | None) -> dict[str, float] | None:
    return None if values is None else dict(values)


def finding_data(finding: Finding) -> dict[str, Any]:
    """A finding as plain data."""
    return {
        "id": finding.effect.id,
        "verdict": finding.verdict.value,
        "p_value": finding.p_value,
        "error_removed": finding.error_removed,
        "detectable": dict(finding.detectable),
        "confusable_with": list(finding.confusable_with),
        "reason": finding.reason,
        "parameters": estimates_data(finding.parameters),
    }


def disturbance_data(own: RecordingDisturbance) -> dict[str, Any]:
    """A recording-specific disturbance as plain data."""
    return {
        "recording": own.recording.name,
        "id": own.effect.id,
        "swing": dict(own.swing),
        "parameters": estimates_data(own.parameters),
    }


def estimates_data(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """Parameter estimates by name as plain data."""
    return {name: {"value": e.value, "std": e.std, "unit": e.unit} for name, e in estimates.items()}


def unexplained_data(residual: UnexplainedResidual) -> dict[str, Any]:
    """The unexplained residual as plain data."""
    return {
        "where": residual.where,
        "explainable_rms": dict(residual.explainable_rms),
        "looks_like": list(residual.looks_like),
        "share": residual.share,
    }
