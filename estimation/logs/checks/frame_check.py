"""Frame check: what the weight in a recording shows of its orientation, and when the force is none of a weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.logs.checks.ambiguity import require_decided_order
from estimation.logs.checks.contact_evidence import LEAST_SHARE, OUTLYING, Deviations, deviations
from estimation.logs.columns.column_map import ColumnMap
from estimation.logs.columns.column_recognition import ColumnGroup, ColumnMapping
from estimation.logs.columns.orientation_form import OrientationForm
from estimation.logs.frame_evidence import W_FIRST, FrameEvidence, frame_evidence, quaternion_orders, sampled_rows
from estimation.logs.log_table import Array
from estimation.logs.step_log import StepLog
from estimation.recordings.reports.reading_curves import spans
from estimation.recordings.sensor_frame import in_sensor_frame
from modeling.kinematics.base_mounting import Direction, motion_in_world
from modeling.kinematics.quaternion import COMPONENTS

FORCES = ("fx", "fy", "fz")
XYZW = OrientationForm("xyzw")
ROLLED = (("qx", "qy"), ("qy", "qz"), ("qz", "qw"), ("qw", "qx"))
"""Columns of a quaternion x y z w, and those that hold them where it was w x y z and read as x y z w."""
FLATTEST = 0.05
"""Std of the directions of gravity in the sensor, in any direction, below which it hardly turns: 3 degrees."""


@dataclass(frozen=True)
class FrameCheck:
    """The check of one reading's columns; what it finds goes into the log.

    `direction` is gravity's in base axes, where the rig states it.
    """

    mapping: ColumnMapping
    stated: ColumnMap
    log: StepLog
    direction: Direction | None = None

    def checked(self, columns: dict[str, Array], stamps: Array | None, *, is_moved: bool) -> dict[str, Array]:
        """The columns (n,) at stamps (n,), s, None of static poses, in the reading that the weight shows.

        A clearly better reading of the orientation is named; it is taken where no name stated the order, and no clock
        was moved (`is_moved`) by the orientation as it was read. Raises InputError for an order that nothing decides.
        """
        group = self.mapping.orientation
        if group is None:
            return columns
        found = frame_evidence(columns, self.direction)
        if found is not None and found.is_better:
            if not self._is_better_taken(found, group, is_moved=is_moved):
                return columns
            columns = columns | {new: columns[old] for new, old in ROLLED}
        elif self._is_unstated(group):
            self._require_order(columns, group)
        in_world = columns if self.direction is None else motion_in_world(columns, self.direction)
        deviating = None if stamps is None else self._deviations(in_world, stamps)
        self._note_missing_weight(in_world, found, deviating)
        return columns

    def _note_missing_weight(
        self, columns: dict[str, Array], found: FrameEvidence | None, deviating: Deviations | None
    ) -> None:
        """Say that the readings show no weight, unless those without contact do."""
        if _spread_of_gravity(columns) < FLATTEST:
            what = "the sensor hardly turns: these readings cannot tell a tool's weight from the zero"
            self.log.suspicious(what, self.mapping.wrench.table.name)
        elif found is not None and found.shows_no_weight and (deviating is None or deviating.mass is None):
            self.log.suspicious(found.weight_sentence, self.mapping.wrench.table.name)

    def _is_better_taken(self, found: FrameEvidence, group: ColumnGroup, *, is_moved: bool) -> bool:
        """Name the better reading; whether it is taken."""
        if found.best.meaning != W_FIRST or not self._is_unstated(group) or is_moved:
            self.log.suspicious(f"{found.sentence}; {found.best.advice}", group.table.name)
            return False
        self.log.mended(f"no name states the quaternion's order, and {found.sentence}; taken so", group.table.name)
        return True

    def _is_unstated(self, group: ColumnGroup) -> bool:
        """Whether neither a map nor a name says in which order the parts of the quaternion are."""
        numbered = all(name[-1:].isdigit() or name.endswith("]") for name in group.columns)
        return self.stated.form is None and numbered and (group.form or XYZW) == XYZW and len(group.columns) in (4, 7)

    def _require_order(self, columns: dict[str, Array], group: ColumnGroup) -> None:
        """Ask for an order that the weight does not decide; after a position x y z w is usual, and is assumed."""
        if len(group.columns) == 4:
            require_decided_order(columns, group, self.direction)
            return
        as_read, w_first = quaternion_orders(columns, self.direction)
        if not as_read.fit.is_shown_against(w_first.fit):
            what = "nothing states the order of the quaternion, x y z w is assumed, and the weight does not confirm it:"
            self.log.suspicious(f'{what} state orientation = "xyzw" or "wxyz" in a map', group.table.name)

    def _deviations(self, columns: dict[str, Array], stamps: Array) -> Deviations | None:
        """The times at which the force is none of a weight, which are named if they are more than a few."""
        found = deviations(columns)
        if found is None or found.share < LEAST_SHARE:
            return None
        what = f"the force deviates from a weight by more than {OUTLYING} times its usual {found.usual:.2g} N:"
        what += " contact, or another effect that is strongest then"
        what += f"; the rest shows a tool of about {found.mass:.2g} kg" if found.mass is not None else ""
        at = spans(stamps[sampled_rows(columns)], found.outlying)
        count = round(found.share * len(stamps))
        self.log.suspicious(what, self.mapping.wrench.table.name, count, len(stamps), at, FORCES)
        return found


def _spread_of_gravity(columns: Mapping[str, Array]) -> float:
    """The largest std of the directions of gravity in the sensor."""
    every = sampled_rows(columns)
    down = in_sensor_frame({name: columns[name][every] for name in COMPONENTS}, (0.0, 0.0, 1.0))
    return float(np.linalg.svd(down - down.mean(axis=0), compute_uv=False)[0] / np.sqrt(len(down)))
