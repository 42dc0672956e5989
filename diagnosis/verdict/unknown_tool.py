"""Why readings do not say what the tool weighs."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.slow_residual import foreign_forces
from diagnosis.verdict.motion_notes import lacks_acceleration
from modeling.chain.model import WrenchModel

FOREIGN = "is not the tool's: contact, another load or a disturbance"
UNRECORDED = "what the model lacks is an acceleration that was not recorded, or a contact: log the position"


def unknown_tool_reason(comparisons: Sequence[Comparison], model: WrenchModel) -> str:
    """Why the readings do not say what the tool weighs, empty where they do."""
    if comparisons and all(lacks_acceleration([comparison], model) for comparison in comparisons):
        return UNRECORDED
    foreign = foreign_forces(comparisons)
    return f"most of what {', '.join(foreign)} read {FOREIGN}" if foreign else ""
