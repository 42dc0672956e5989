"""Recordings that the diagnosis is measured on: simulated pairs and single runs, written as the CSV files of a user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from truewrench.simulated_rig import (
    CableSpring,
    ContactEvent,
    HiddenEffect,
    PayloadChange,
    PlanarRig,
    SensorCrosstalk,
    SensorLag,
    SimulatedRig,
    SpatialRig,
    TimeDelay,
    ViscousDrag,
    simulate,
    write_recording,
)

PLANAR_RIG = "[robot]\nlink_lengths = [1.0, 0.97, 0.4]\ntip_length = 0.2\n"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One recording to be diagnosed, or a pair.

    hidden     effects in the recordings; those `passing` in the training alone
    repeats    of the training, then of the validation; 0 for none
    rows       samples of one repeat
    single     no `repeat` column: one run
    """

    group: str
    name: str
    rig: SimulatedRig
    hidden: Sequence[HiddenEffect] = ()
    passing: Sequence[HiddenEffect] = ()
    repeats: tuple[int, int] = (8, 3)
    rows: int = 1000
    single: bool = False
    seed: int = 11

    def written(self, folder: Path) -> tuple[Path, Path | None, Path | None]:
        """Train, validation and rig files in the folder; simulated unless they are there."""
        place = folder / self.group / self.name
        train, validate, rig = (place / n for n in ("train.csv", "validate.csv", "rig.toml"))
        place.mkdir(parents=True, exist_ok=True)
        if isinstance(self.rig, PlanarRig):
            rig.write_text(PLANAR_RIG, encoding="utf-8")
        for path, count, number in ((train, self.repeats[0], 0), (validate, self.repeats[1], 1)):
            if count and not path.exists():
                frame = simulate(
                    self.rig,
                    self.rig.random_motion(seed=self.seed + 500 * number),
                    hidden=(*self.hidden, *(() if number else self.passing)),
                    repeats=count,
                    samples_per_period=self.rows,
                    seed=1000 + self.seed + number,
                )
                write_recording(frame.drop(columns="repeat") if self.single else frame, path)
        return train, validate if self.repeats[1] else None, rig if rig.exists() else None


def _pairs(
    group: str,
    rig: SimulatedRig,
    hidden: dict[str, tuple[Sequence[HiddenEffect], Sequence[HiddenEffect]]],
    repeats: tuple[int, int],
    rows: int,
    single: bool = False,
) -> list[Case]:
    return [
        Case(
            group=group, name=name, rig=rig, hidden=lasting, passing=passing, repeats=repeats, rows=rows, single=single
        )
        for name, (lasting, passing) in hidden.items()
    ]


SPATIAL = _pairs(
    "spatial",
    SpatialRig(),
    {
        "nothing": ((), ()),
        "drag": ((ViscousDrag(),), ()),
        "lag": ((SensorLag(),), ()),
        "tether": ((CableSpring(),), ()),
        "push": ((), (ContactEvent(),)),
        "two": ((ViscousDrag(), SensorLag()), ()),
    },
    (8, 3),
    1000,
)
LONG = _pairs(
    "long",
    PlanarRig(),
    {
        "push": ((), (ContactEvent(),)),
        "load": ((), (PayloadChange(),)),
        "three": ((ViscousDrag(), TimeDelay(), SensorCrosstalk()), ()),
    },
    (10, 3),
    1500,
)
SINGLE = _pairs(
    "single",
    SpatialRig(),
    {
        "nothing": ((), ()),
        "drag": ((ViscousDrag(),), ()),
        "lag": ((SensorLag(),), ()),
        "crosstalk": ((SensorCrosstalk(),), ()),
    },
    (1, 0),
    6000,
    single=True,
)
GROUPS = {"spatial": SPATIAL, "long": LONG, "single": SINGLE}
