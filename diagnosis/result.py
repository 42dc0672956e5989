"""Result: the parts of a diagnosis as plain data, as `result.json` has them."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

from diagnosis.finding import Finding
from diagnosis.own_effect import OwnEffect
from diagnosis.remainder import Remainder
from diagnosis.step import Step
from estimation.fit import Estimate


def step_data(step: Step) -> dict[str, Any]:
    """A step of the staircase."""
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
    """What is said of an effect."""
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


def own_data(own: OwnEffect) -> dict[str, Any]:
    """What a held-out recording has by itself."""
    return {
        "recording": own.recording.name,
        "id": own.effect.id,
        "swing": dict(own.swing),
        "parameters": estimates_data(own.parameters),
    }


def estimates_data(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """Parameters by name."""
    return {name: {"value": e.value, "std": e.std, "unit": e.unit} for name, e in estimates.items()}


def remainder_data(left: Remainder) -> dict[str, Any]:
    """What nobody explains."""
    return {
        "where": left.where,
        "explainable_rms": dict(left.explainable_rms),
        "looks_like": list(left.looks_like),
        "share": left.share,
    }


def finite(value: Any) -> Any:
    """The same data with None for every number that is not finite."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [finite(v) for v in value]
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    return value
