"""Axes reading: signs, order and units of the columns of a wrench, and the axes along which they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from estimation.reading.column_map import FORCE, TORQUE
from modeling.chain.model import QUARTER_TURNS
from modeling.rig import PLANAR_CHANNELS, Convention

Array = NDArray[np.float64]

TORQUE_UNITS = {unit: 1 / TORQUE[unit] for unit in ("N mm", "N cm", "kgf m", "kgf cm", "lbf in", "lbf ft")}
"""Logged torques for each N m, beside forces in N. Those that are alike, as kgf cm and lbf in, are named together."""
FORCE_UNITS = {unit: 1 / FORCE[unit] for unit in ("kgf", "lbf")}
"""Logged forces for each N, beside torques in N m."""
SIGN_OF = {Convention.ON_TOOL: 1.0, Convention.ON_SENSOR: -1.0}


@dataclass(frozen=True, eq=False)
class AxesReading:
    """What the logged wrench (p,) is of the sensor's: `mistaken` times the wrench of a sensor that is mounted turned.

    mistake  id of what would be mistaken, empty for none; `detail` the axis that is mirrored, the order, or the unit
    mistaken (p, p) from the readings as they should be to those that were logged
    turn     (d, d) quarter turns of the mounting, from the axes of the motion to those of the readings
    """

    mistake: str
    detail: str
    mistaken: Array
    convention: Convention
    turn: Array

    @property
    def is_turned(self) -> bool:
        """Whether the sensor is not aligned with the axes of the motion."""
        return not np.array_equal(self.turn, np.eye(len(self.turn)))

    def is_other_unit(self, other: AxesReading) -> bool:
        """Whether another reading differs in the unit of the torques or of the forces alone."""
        units = self.mistake.endswith("_unit") and other.mistake.endswith("_unit")
        return units and self.convention is other.convention and np.array_equal(self.turn, other.turn)

    @property
    def factors(self) -> tuple[float, float]:
        """By which the forces and the torques are multiplied."""
        return float(np.abs(self.mistaken[0]).max()), float(np.abs(self.mistaken[-1]).max())

    @cached_property
    def matrix(self) -> Array:
        """From the wrench that the tool predicts, on it and not turned, to the logged one, (p, p)."""
        size, torques = len(self.mistaken), len(self.mistaken) - len(self.turn)
        turned = np.eye(size)
        turned[: len(self.turn), : len(self.turn)] = self.turn
        if torques == 3:
            turned[3:, 3:] = self.turn
        return np.asarray(SIGN_OF[self.convention] * self.mistaken @ turned)


@lru_cache
def axes_readings(channels: tuple[str, ...]) -> tuple[AxesReading, ...]:
    """Every reading of the axes: signs and quarter turns as a mounting has them, each alone and with one mistake."""
    turns = [np.array(turn, dtype=np.float64) for turn in QUARTER_TURNS]
    if channels == PLANAR_CHANNELS:
        turns = [turn[:2, :2] for turn in turns if turn[2, 2] == 1]
    return tuple(
        AxesReading(mistake, detail, mistaken, convention, turn)
        for convention, turn, (mistake, detail, mistaken) in product(SIGN_OF, turns, _mistakes(channels))
    )


def _mistakes(channels: tuple[str, ...]) -> Iterator[tuple[str, str, Array]]:
    """Id, detail and matrix (p, p) of each mistake, none first."""
    size, forces = len(channels), 2 if channels == PLANAR_CHANNELS else 3
    is_torque = np.arange(size) >= forces
    yield "", "", np.eye(size)
    yield "torque_sign", "", np.diag(np.where(is_torque, -1.0, 1.0))
    for number, channel in enumerate(channels):
        if is_torque[number] and size - forces == 1:
            continue  # the sign of the only torque
        mistake = "torque_axis_mirrored" if is_torque[number] else "force_axis_mirrored"
        yield mistake, channel[-1], np.diag(np.where(np.arange(size) == number, -1.0, 1.0))
    for unit, factor in TORQUE_UNITS.items():
        yield "torque_unit", unit, np.diag(np.where(is_torque, factor, 1.0))
    for unit, factor in FORCE_UNITS.items():
        yield "force_unit", unit, np.diag(np.where(is_torque, 1.0, factor))
    for first, last in ((0, forces), (forces, size)):
        for order in permutations(range(first, last)):
            if order != tuple(range(first, last)):
                places = [*range(first), *order, *range(last, size)]
                yield "axes_permuted", ", ".join(channels[place] for place in order), np.eye(size)[places]
