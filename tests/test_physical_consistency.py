"""A body that cannot be is named in a plain fit; what the motion cannot show is said."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.least_squares.physical_consistency import impossible_body
from estimation.recordings.motion_limits import motion_limits
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar, spatial
from modeling.rig.rig import Rig
from truewrench.simulated_rig import SpatialRig, WhiteNoise, simulate

NAMES = [p.name for p in spatial().parameters]
BODY = {"m": 1.2, "mz": 0.1, "Ixx": 0.02, "Iyy": 0.02, "Izz": 0.004}


def sentence(**changed: float) -> str:
    theta = np.array([(BODY | changed).get(name, 0.0) for name in NAMES])
    return impossible_body(spatial(), NAMES, theta, np.diag(np.full(len(NAMES), 1e-10)))


def test_a_possible_body_needs_no_remark() -> None:
    assert not sentence()


@pytest.mark.parametrize("changed", [{"Izz": -0.001}, {"Ixx": 0.05}, {"m": -0.5}, {"mz": 0.3}])
def test_an_impossible_one_is_named(changed: dict[str, float]) -> None:
    """A negative moment, the triangle inequality, a negative mass, a first moment too large for the second."""
    assert "no body has these inertial parameters" in sentence(**changed)


def test_what_is_within_its_std_is_not_determined() -> None:
    """An eigenvalue of -0.5 is five std of 0.1, and one of 0.5; 3.09 are significant."""
    theta = np.array([{"m": -0.5}.get(name, 0.0) for name in NAMES])
    for std, said in ((0.1, "no body has"), (0.5, "the motion does not determine the inertia")):
        covariance = np.diag([std**2 if name == "m" else 1e-12 for name in NAMES])
        assert impossible_body(spatial(), NAMES, theta, covariance).startswith(said)


def test_std_of_the_eigenvalue() -> None:
    """Of a mass far below zero alone its own: by first order."""
    theta = np.array([{"m": -5.0}.get(name, 0.0) for name in NAMES])
    covariance = np.diag([0.04 if name == "m" else 1e-12 for name in NAMES])
    assert "−5.0 ± 0.20" in impossible_body(spatial(), NAMES, theta, covariance)


def test_an_unknown_inertia_is_not_judged() -> None:
    covariance = np.diag([np.inf if name == "Ixx" else 1e-6 for name in NAMES])
    assert not impossible_body(spatial(), NAMES, np.full(len(NAMES), -1.0), covariance)


def test_planar_body() -> None:
    names = [p.name for p in planar().parameters]
    theta = np.array([{"m": 1.0, "mlg": 0.3, "I": 0.01}.get(name, 0.0) for name in names])
    assert impossible_body(planar(), names, theta, np.diag(np.full(len(names), 1e-6)))


@pytest.mark.parametrize(("turned", "said"), [(0.0, True), (1.0, False)])
def test_constant_orientation_is_said(turned: float, said: bool) -> None:
    rig = SpatialRig()
    frame = simulate(rig, rig.random_motion(seed=1, period=4.0), repeats=1, samples_per_period=400,
                     noise=WhiteNoise(), seed=1)  # fmt: skip
    columns = {str(c): frame[c].to_numpy() for c in frame if c != "repeat"}
    if not turned:
        columns |= {name: np.full(400, float(name == "qw")) for name in ("qx", "qy", "qz", "qw")}
    limits = motion_limits(from_columns(columns, name="run", rig=Rig.from_data({})))
    assert any("orientation hardly changes" in limit for limit in limits) is said
