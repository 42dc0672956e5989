"""Why readings do not say what the tool weighs."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.slow_residual import foreign_forces
from diagnosis.comparison.unrecorded_acceleration import lacks_acceleration
from modeling.chain.model import WrenchModel

FOREIGN = "is not the tool's: contact, another load or a disturbance"
UNRECORDED = (
    "what the model lacks looks like an acceleration that was not recorded (log the position), a contact, a load that"
    " changes or an error of the recorded orientation"
)


def unknown_tool_reason(comparisons: Sequence[Comparison], model: WrenchModel) -> str:
    """Why the readings do not say what the tool weighs, empty where those of one recording do."""
    others = [c for c in comparisons if not lacks_acceleration(c, model)]
    foreign = foreign_forces(others)
    if others and not foreign:
        return ""
    reasons = [UNRECORDED] if len(others) < len(comparisons) else []
    reasons += [f"most of what {', '.join(foreign)} read {FOREIGN}"] if foreign else []
    return "; ".join(reasons)
