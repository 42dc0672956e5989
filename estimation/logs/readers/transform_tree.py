"""Transform tree: the pose of a frame in the root of a bag's tf, from fixed and moving transforms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.logs.clocks.resampling import interpolated_position, interpolated_quaternion
from estimation.logs.log_table import Array


@dataclass(frozen=True)
class Transform:
    """Pose of `child` in `parent` at a stamp (s): x, y, z (m), then the quaternion x, y, z, w; `fixed` for ever."""

    parent: str
    child: str
    stamp: float
    values: tuple[float, ...]
    fixed: bool


class TransformTree:
    """Transforms by child frame, each with its series of poses."""

    def __init__(self, transforms: Sequence[Transform]) -> None:
        self.series: dict[str, list[Transform]] = {}
        for transform in transforms:
            self.series.setdefault(transform.child, []).append(transform)

    def chain(self, frame: str) -> list[str]:
        """Child frames from a frame up to the root; none when tf does not know the frame."""
        found: list[str] = []
        while frame in self.series and frame not in found:
            found.append(frame)
            frame = self.series[frame][0].parent
        return found

    def pose_columns(self, frame: str) -> dict[str, Array]:
        """Pose of the frame in the root at the stamps of the fastest moving transform; none of a frame that rests."""
        from scipy.spatial.transform import Rotation  # slow to import

        chain = self.chain(frame)
        moving = [link for link in chain if not self.series[link][0].fixed and len(self.series[link]) > 2]
        if not moving:
            return {}
        stamps = self._stamps(max(moving, key=lambda link: len(self.series[link])))
        low, high = max(self._stamps(m)[0] for m in moving), min(self._stamps(m)[-1] for m in moving)
        stamps = stamps[(stamps >= low) & (stamps <= high)]
        if len(stamps) < 3:
            return {}
        place, turn = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
        for link in chain:
            offset, rotation = self._at(link, stamps)
            place, turn = Rotation.from_quat(rotation).apply(place) + offset, Rotation.from_quat(rotation) * turn
        names = [f"pose.position.{a}" for a in "xyz"] + [f"pose.orientation.{a}" for a in "xyzw"]
        return {"stamp": stamps, **dict(zip(names, np.hstack([place, turn.as_quat()]).T, strict=True))}

    def _stamps(self, link: str) -> Array:
        return np.unique([transform.stamp for transform in self.series[link]])

    def _at(self, link: str, stamps: Array) -> tuple[Array, Array]:
        series = self.series[link]
        values = np.array([transform.values for transform in series])
        if series[0].fixed or len(series) < 3:
            return np.tile(values[-1, :3], (len(stamps), 1)), np.tile(values[-1, 3:], (len(stamps), 1))
        own, first = np.unique([transform.stamp for transform in series], return_index=True)
        values = values[first]
        if len(own) == len(stamps) and np.array_equal(own, stamps):
            return values[:, :3], values[:, 3:]
        return interpolated_position(own, values[:, :3], stamps), interpolated_quaternion(own, values[:, 3:], stamps)
