"""Every effect in every space that it exists in, with an amount of it and a recording that it shows in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from design.trajectories.fourier import random_periodic_trajectory
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.effects import catalogue
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import Joint, JointKind, Placement
from modeling.parameter import Parameter
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space

Array = NDArray[np.float64]


def _joint(name: str, kind: JointKind, position: tuple[float, float, float], axis: tuple[float, float, float]) -> Joint:
    return Joint(name=name, kind=kind, placement=Placement(position=position), axis=axis)


WRIST = SpatialArm(
    chain=(
        _joint("slide", JointKind.PRISMATIC, (0.0, 0.0, 0.5), (0.6, 0.0, 0.8)),
        _joint("lift", JointKind.REVOLUTE, (0.1, 0.2, 0.0), (0.0, 1.0, 0.0)),
        _joint("roll", JointKind.REVOLUTE, (0.6, 0.2, 0.1), (1.0, 0.0, 0.0)),
    ),
    sensor=Placement(position=(0.05, 0.0, 0.1)),
)
"""As few joints as turn the sensor in all directions, and one that slides: checks cost by their number."""

RIGS: Mapping[Space, Rig] = {
    Space.PLANE: Rig(link_lengths=(1.0, 0.97, 0.4)),
    Space.SPACE: Rig(spatial_arm=WRIST, sensor=SensorDescription(convention=Convention.ON_TOOL)),
}
TOOLS: Mapping[Space, Mapping[str, float]] = {
    Space.PLANE: {"bias_fx": 1.5, "bias_fy": -0.8, "bias_tau": 0.12, "m": 0.9, "mlg": 0.063, "I": 0.0129},
    Space.SPACE: dict(zip(("bias_fx", "bias_fy", "bias_fz"), (1.5, -0.8, 0.7), strict=True))
    | dict(zip(("bias_tx", "bias_ty", "bias_tz"), (0.12, -0.2, 0.05), strict=True))
    | {"m": 1.2, "mx": 0.010, "my": -0.018, "mz": 0.085}
    | {"Ixx": 0.0125, "Ixy": 0.0004, "Ixz": -0.0009, "Iyy": 0.0117, "Iyz": 0.0011, "Izz": 0.0042},
}

PERIOD, SAMPLES, REPEATS = 2.5, 250, 2
"""Steps of 10 ms, as long as an event takes to begin: one sample lies in each edge."""


def amounts_of(effect: Effect, parameters: Sequence[Parameter]) -> dict[str, float]:
    """The effect's `amounts` of its parameters, by short names; each next one of those by unit is a tenth more."""
    sizes = {}
    for number, parameter in enumerate(parameters):
        name = parameter.name.rpartition(".")[2]
        by_name, by_unit = effect.amounts.get(name), effect.amounts.get(parameter.unit)
        amount = by_unit * (1 + number / 10) if by_name is None and by_unit is not None else by_name
        assert amount is not None, f"say in `amounts` of {effect.id} how much of {name} ({parameter.unit}) shows"
        sizes[name] = amount
    return sizes


@dataclass(frozen=True)
class Case:
    """An effect in a space: alone in a model of the rigid tool."""

    space: Space
    effect: Effect

    def __str__(self) -> str:
        return f"{self.effect.id}-{self.space.name}"

    @cached_property
    def plain(self) -> WrenchModel:
        """The rigid tool."""
        return planar(RIGS[self.space]) if self.space is Space.PLANE else spatial(RIGS[self.space])

    @cached_property
    def model(self) -> WrenchModel:
        """The tool with the effect."""
        return self.plain + self.effect

    @property
    def own(self) -> tuple[Parameter, ...]:
        """The effect's parameters, for the joints of the rig, by their full names."""
        return self.model.parameters[self.model.base_size :]

    @cached_property
    def theta(self) -> Array:
        """Every parameter of the model, with the effect in its amount."""
        return np.array([TOOLS[self.space][p.name] for p in self.plain.parameters] + list(self.amounts().values()))

    @cached_property
    def nominal(self) -> Array:
        """The same without any of the effect; its nuisance parameters are where they were."""
        own = [amount if p.nuisance else p.nominal for p, amount in zip(self.own, self.amounts().values(), strict=True)]
        return np.array([*self.theta[: self.model.base_size], *own])

    def amounts(self) -> dict[str, float]:
        """How much of each parameter of the effect there is."""
        return amounts_of(self.effect, self.own)

    @property
    def recording(self) -> Recording:
        """A motion of the rig, with readings that nobody looks at."""
        return moving(self.space)


CASES = tuple(Case(space, effect) for space in Space for effect in catalogue(space))


@cache
def moving(space: Space) -> Recording:
    """A periodic motion of all joints, run twice without pause, and a temperature that rises meanwhile."""
    rig = RIGS[space]
    assert rig.arm is not None
    motion = random_periodic_trajectory(
        joints=rig.arm.joints, position=0.8, velocity=2.5, acceleration=12.0, harmonics=3, period=PERIOD, seed=5
    )
    time = np.arange(SAMPLES * REPEATS) * (PERIOD / SAMPLES)
    q = motion.evaluate(time)[0]
    columns = {"time": time, "repeat": np.repeat(np.arange(REPEATS), SAMPLES).astype(float)}
    columns |= {f"q{j}": angle for j, angle in enumerate(q.T, start=1)}
    columns |= {channel: np.zeros(len(time)) for channel in space.channels}
    return from_columns(columns | {"temperature": 24 - 3 * np.exp(-time / 3)}, rig=rig)


def read_as(recording: Recording, wrench: Array) -> Recording:
    """The recording with other readings (n, p)."""
    return replace(recording, wrench=wrench)
