"""Names of the models of a diagnosis, from the one that the search began with to the last effect added, by ids."""

from __future__ import annotations

from diagnosis.diagnosis import Diagnosis

RIGID_TOOL = "rigid tool"


def base_name(diagnosis: Diagnosis) -> str:
    """Label of the model that the search began with: the rigid tool, with the effects given."""
    return " + ".join([RIGID_TOOL, *diagnosis.given])


def step_names(diagnosis: Diagnosis) -> list[str]:
    """Label of each selection step."""
    return [base_name(diagnosis) if s.effect is None else f"+ {s.effect}" for s in diagnosis.steps]
