"""Where the clocks' offset was estimated, effects are tested beside an error of it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from diagnosis.screening.score_test import screen, significant_effects
from estimation.case import Case
from estimation.fit import unchecked_fit
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar
from modeling.effects import catalogue
from modeling.space import Space
from tests.shared.recordings import Silence
from tests.shared.rigs import RIG
from truewrench.simulated_rig import HiddenEffect, PlanarRig, QuadraticDrag, TimeDelay, simulate

pytest.importorskip("mujoco")

LATE, DRAG = TimeDelay(delay=0.001), QuadraticDrag(c=0.05, d=0.12)
SHAPES = ("quadratic_drag", "viscous_drag", "translational_friction", "coulomb_friction", "sensor_lag", "time_delay")


@cache
def significant(offset: bool, *hidden: HiddenEffect) -> frozenset[str]:
    """Significant effects of a run of half a minute in a fifth of the noise; whether its offset was estimated."""
    rig = PlanarRig()
    motion = rig.random_motion(seed=1, period=30.0)
    frame = simulate(rig, motion, hidden=hidden, repeats=1, samples_per_period=1500, noise=Silence())
    columns = {str(name): frame[name].to_numpy(dtype=float) for name in frame if name not in ("repeat", "temperature")}
    rng = np.random.default_rng(1)
    for channel, size in zip(Space.PLANE.channels, rig.noise, strict=True):
        columns[channel] = columns[channel] + 0.2 * size * rng.normal(size=len(columns["time"]))
    columns |= {"clock_offset": np.zeros(len(columns["time"]))} if offset else {}
    fit = unchecked_fit(Case.of(planar(RIG), (from_columns(columns, name="run", rig=RIG),), ()))
    effects = [e for e in catalogue(Space.PLANE) if e.id in SHAPES]
    return frozenset(test.effect.id for test in significant_effects(screen(fit, effects)))


def test_an_error_of_the_offset_is_not_taken_for_a_drag_or_a_friction() -> None:
    """A millisecond late: several look like it, which the offset takes in."""
    assert {"time_delay", "translational_friction"} <= significant(False, LATE)
    assert not significant(True, LATE)


def test_a_drag_is_found_beside_an_error_of_the_offset() -> None:
    """It is more than a delay explains."""
    assert "quadratic_drag" in significant(True, LATE, DRAG)
