"""Every generic term that a residual may resemble has words."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.comparison.comparison import generic_terms, term_in_words
from tests.shared.recordings import recording_of
from tests.shared.rigs import described
from truewrench.simulated_rig import PlanarRig, SpatialRig, simulate
from truewrench.simulated_rig.rigs import SimulatedRig

pytest.importorskip("mujoco")


@pytest.mark.parametrize("rig", [PlanarRig(), SpatialRig()], ids=["plane", "space"])
def test_every_term_has_words(rig: SimulatedRig) -> None:
    frame = simulate(rig, rig.random_motion(seed=1), repeats=1, samples_per_period=120)
    recording = recording_of(frame, rig=described(rig))
    terms = generic_terms(recording, np.asarray(recording.wrench))
    assert len(terms) > 15
    for term in terms:
        assert term_in_words(term) != term
    assert len(set(map(term_in_words, terms))) == len(terms)


WORDS = {
    "px": "position along the world's x",
    "tx²": "predicted torque about the sensor's x squared",
    "vpy": "velocity along the world's y",
    "sin 2 phi": "sine of 2 times the orientation",
    "sign dphi": "direction of the angular velocity",
    "down_x down_z": "gravity's direction along the sensor's x times that along z",
    "humidity": "humidity",
}


@pytest.mark.parametrize("term", WORDS)
def test_words(term: str) -> None:
    assert term_in_words(term) == WORDS[term]
