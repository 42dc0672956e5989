"""A planar arm, motions and noise for tests of what an experiment says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from design.trajectories.fourier import random_periodic_trajectory
from design.trajectories.trajectory import Trajectory
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.noise import ColouredNoise
from modeling.rig import Limits, Rig, SensorDescription
from modeling.space import Space
from tests.modeling.effects.cases import amounts_of
from tests.shared.rigs import ARM

Array = NDArray[np.float64]
RIG = Rig(link_lengths=ARM.link_lengths, sensor=SensorDescription(noise={"fx": 0.8, "fy": 1.6, "tau": 0.08}))
LIMITS = Limits(
    position=np.array([[-1.0, 1.1], [-1.2, 1.2], [-1.4, 1.4]]),
    velocity=np.array([[-2.0, 2.0], [-2.2, 2.2], [-3.5, 3.5]]),
    acceleration=np.array([[-10.0, 10.0], [-10.0, 10.0], [-15.0, 15.0]]),
)
PERIOD, SAMPLES = 5.0, 200
TOOL = {"bias_fx": 0.5, "bias_tau": -0.1, "m": 1.6, "mlg": 0.2, "I": 0.05}
STD = np.array([0.8, 1.6, 0.08])
EFFECTS = tuple(
    e for e in effects.catalogue(Space.PLANE) if e.stage.adds and "temperature" not in (planar(RIG) + e).inputs
)
"""Effects that are designed for, or could be if they were not specific to a recording."""


def values(*several: Effect) -> dict[str, float]:
    amounts = {e: amounts_of(e, e.parameters(Space.PLANE)) for e in several}
    return TOOL | {f"{e.id}.{name}": value for e in several for name, value in amounts[e].items()}


def vector(model: WrenchModel, given: Mapping[str, float]) -> Array:
    return np.array([given.get(p.name, p.nominal) for p in model.parameters])


def motion(seed: int = 0) -> Trajectory:
    position, velocity, acceleration = (1.0, 1.2, 1.4), (2.0, 2.2, 3.5), (10.0, 10.0, 15.0)
    return random_periodic_trajectory(
        joints=3, position=position, velocity=velocity, acceleration=acceleration, period=PERIOD, seed=seed
    )


def joint_states(moving: Trajectory | None = None, samples: int = SAMPLES) -> tuple[Array, Array, Array]:
    moving = moving or motion()
    return moving.evaluate(moving.series.instants(samples))


def gram(columns: Array) -> Array:
    return np.asarray(np.einsum("npi,npj->ij", columns, columns))


def assert_alike(one: Array, other: Array, tolerance: float) -> None:
    """Informations alike, whatever the units: relative to what each parameter and pair of them has at most."""
    size = np.sqrt(np.maximum(np.diag(one), np.diag(other)))
    size[size == 0] = 1.0
    np.testing.assert_allclose(one / np.outer(size, size), other / np.outer(size, size), rtol=0, atol=tolerance)


SPECTRUM = ColouredNoise(
    np.array([0.0, 2.0, 8.0]),
    np.array(
        [
            [[4.0, 1.0, 0.2], [1.0, 3.0, 0.0], [0.2, 0.0, 0.1]],
            [[2.0, 0.5j, 0.0], [-0.5j, 2.0, 0.1], [0.0, 0.1, 0.05]],
            [[1.0, 0.3 + 0.2j, 0.0], [0.3 - 0.2j, 1.0, 0.05j], [0.0, -0.05j, 0.02]],
        ]
    ),
)
