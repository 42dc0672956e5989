"""A body that cannot be is named in a plain fit; what the motion cannot show is said."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation.fit import fit
from estimation.least_squares.physical_consistency import impossible_body
from estimation.recordings.motion_limits import motion_limits
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar, spatial
from modeling.identifiability import UnidentifiableDirection
from modeling.rig import Rig
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


def directions(*amounts: dict[str, float]) -> list[UnidentifiableDirection]:
    known = {p.name: p for p in (*spatial().parameters, *planar().parameters)}
    return [UnidentifiableDirection(tuple(known[n] for n in d), np.array(list(d.values()))) for d in amounts]


def test_an_unknown_inertia_is_not_judged() -> None:
    """Static poses: every mass and centre is that of a body, whatever stands for the inertia; no negative mass is."""
    covariance, inertia = np.diag(np.full(len(NAMES), 1e-10)), directions(*({n: 1.0} for n in NAMES if n[0] == "I"))
    poses = {"m": 1.2, "mx": 0.0144, "my": -0.024, "mz": 0.084}
    for changed, named in (({}, False), ({"Izz": -3.0}, False), ({"mz": 900.0}, False), ({"m": -0.5}, True)):
        theta = np.array([(poses | changed).get(name, 0.0) for name in NAMES])
        assert impossible_body(spatial(), NAMES, theta, covariance)
        assert bool(impossible_body(spatial(), NAMES, theta, covariance, inertia)) is named


TURNED_ABOUT_Z = ({"Ixx": 1.0}, {"Iyy": 1.0}, {"Ixy": 1.0})
SUM_KNOWN = ({"Ixx": 1.0, "Iyy": -1.0}, {"Ixy": 1.0}, {"Ixz": 1.0}, {"Iyz": 1.0})


@pytest.mark.parametrize(("free", "values", "name", "least"), [
    (TURNED_ABOUT_Z, {"mx": 0.12, "my": -0.06, "Ixz": 0.3, "Iyz": -0.2}, "Izz", (0.12**2 + 0.06**2) / 1.2),
    (SUM_KNOWN, {"mz": 0.12, "Izz": 0.02, "Iyy": 0.03}, "Ixx", 2 * 0.12**2 / 1.2 + 0.02 - 0.03),
])  # fmt: skip
def test_what_is_known_of_an_inertia_is_judged(
    free: tuple[dict[str, float], ...], values: dict[str, float], name: str, least: float
) -> None:
    """The least of one moment by hand: Izz m >= mx² + my², and (Ixx + Iyy - Izz) / 2 m >= mz².

    Ten per cent off is far off or within the noise, by the std of that moment alone: two of it are no evidence, five
    are (3.09), and the part of a unit that the eigenvalue bends over ten per cent is far less than the room between.
    """
    for share, std, said in (
        (1.1, 1e-4, ""), (0.9, 0.05, "the motion does not determine the inertia"), (0.9, 0.02, "no body has"),
    ):  # fmt: skip
        theta = np.array([({"m": 1.2} | values | {name: share * least}).get(n, 0.0) for n in NAMES])
        covariance = np.diag([(std * least) ** 2 if n == name else 1e-16 for n in NAMES])
        found = impossible_body(spatial(), NAMES, theta, covariance, directions(*free))
        assert found.startswith(said)
        assert bool(found) is bool(said)


def test_planar_body_of_unknown_inertia() -> None:
    names = [p.name for p in planar().parameters]
    theta = np.array([{"m": 1.0, "mlg": 0.3}.get(name, 0.0) for name in names])
    covariance = np.diag(np.full(len(names), 1e-6))
    assert impossible_body(planar(), names, theta, covariance)
    assert not impossible_body(planar(), names, theta, covariance, directions({"I": 1.0}))


def test_static_poses_of_a_perfect_tool_are_not_blamed() -> None:
    """24 poses at rest: nothing is missing, and the inertia is not identifiable, which is said."""
    rng = np.random.default_rng(3)
    turns = Rotation.random(24, rng=rng)
    lift = turns.inv().apply([0.0, 0.0, 9.806])  # minus gravity, in the sensor's axes
    force = 1.2 * lift + rng.normal(0, 0.05, lift.shape)
    torque = 1.2 * np.cross([0.012, -0.02, 0.07], lift) + rng.normal(0, 0.0025, lift.shape)
    rows = np.concatenate([turns.as_quat(), force, torque], axis=1).T
    columns = dict(zip(("qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz"), rows, strict=True))
    rig = Rig.from_data({"sensor": {"convention": "on_tool"}})
    found = fit(spatial(rig), from_columns(columns, name="poses", rig=rig))
    assert found["m"].value == pytest.approx(1.2, abs=5 * found["m"].std)
    assert not any("body" in remark for remark in found.remarks())
    assert "Ixx, Ixy, Ixz, Iyy, Iyz and Izz are not identifiable from this motion" in found.remarks()


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
