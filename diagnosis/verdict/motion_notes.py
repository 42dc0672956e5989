"""What the recorded motion leaves unknown in a diagnosis, and whether the residual is that."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.unrecorded_acceleration import inertial_share, lacks_acceleration
from estimation.recordings.motion_limits import motion_limits
from modeling.chain.model import WrenchModel


def motion_notes(comparisons: Sequence[Comparison], model: WrenchModel) -> list[str]:
    """One line for each thing that the motion of a fitted recording leaves unknown."""
    lines = []
    for comparison in comparisons:
        limits = motion_limits(comparison.recording)
        lines += [f"{comparison.recording.name}: {limit}." for limit in limits]
        if lacks_acceleration(comparison, model):
            share = inertial_share(comparison, model)
            lines.append(
                f"{comparison.recording.name}: the residual looks like mass times an acceleration that was not "
                f"recorded: its torque is that of a force through one point ({share:.0%} of its power), the centre of "
                "mass; log the position. A contact at one point, a load that changes and an error of the recorded "
                "orientation can have such a torque, too."
            )
    return lines
