"""Which way a tilted base leans, by gravity stated as a vector, without the derivation or a simulator."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import truewrench as tw
from estimation.recordings.reading import from_columns
from modeling.chain.model import WrenchModel
from modeling.rig import Convention, Rig
from modeling.space import Space

LOWER_Y, LOWER_MINUS_X = 0.05, 0.03


def test_gravity_leans_to_the_lower_sides() -> None:
    """Poses at rest of 1.3 kg on a base whose +y and -x sides are lower: F = -m R' g, about the centre of mass."""
    turns = Rotation.random(30, rng=np.random.default_rng(5))
    down = np.array([-np.sin(LOWER_MINUS_X), np.sin(LOWER_Y), 0.0])
    down[2] = -np.sqrt(1 - down @ down)
    force = turns.inv().apply(-1.3 * 9.80665 * down)
    force += np.random.default_rng(6).normal(0, 1e-3, force.shape)
    torque = np.cross([0.01, -0.02, 0.08], force)
    rows = np.hstack([force, torque, turns.as_quat()])
    names = ("fx", "fy", "fz", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
    recording = from_columns(dict(zip(names, rows.T, strict=True)), name="poses", rig=Rig.from_data({}))
    model = WrenchModel(space=Space.SPACE, convention=Convention.ON_TOOL) + tw.effects.gravity_tilt()
    found = tw.fit(model, recording).values
    # second order of the angles is left out: 0.05² / 2
    np.testing.assert_allclose(found["gravity_tilt.tilt_x"], LOWER_Y, atol=2e-3)
    np.testing.assert_allclose(found["gravity_tilt.tilt_y"], LOWER_MINUS_X, atol=2e-3)
