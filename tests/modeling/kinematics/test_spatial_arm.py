"""The spatial arm against Pinocchio, against the planar arm, and against itself moved a little in time."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pinocchio
import pytest
import sympy as sp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from modeling.kinematics.arm import Arm, PlanarArm, SpatialArm
from modeling.kinematics.placement import (
    COMPONENTS,
    JointKind,
    Placement,
    angular_motion,
    quaternion_conjugate,
    quaternion_product,
    rotated_vector,
)
from modeling.space import Space, signals
from tests.shared.places import URDF
from tests.shared.rigs import FRAMES, spatial_arm

Array = NDArray[np.float64]
States = tuple[Array, Array, Array]

STATES = 200
ROUNDING = 1e-10
"""Of sums of some hundred terms below 1e3 each, m/s² or rad/s²; 1e-13 is the largest seen."""


def states_of(arm: Arm, count: int = STATES, seed: int = 0) -> States:
    """Random coordinates, rates and accelerations (N, n)."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = (rng.uniform(-limit, limit, (count, arm.joints)) for limit in (np.pi, 2.0, 10.0))
    return q, dq, ddq


@pytest.fixture(scope="module", params=FRAMES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def arm(name: str) -> SpatialArm:
    return spatial_arm(name)


def vectors(pose: dict[str, Array], prefix: str) -> Array:
    return np.stack([pose[prefix + axis] for axis in "xyz"], axis=1)


def turn(pose: dict[str, Array]) -> Rotation:
    return Rotation.from_quat(np.stack([pose[name] for name in COMPONENTS], axis=1))


# --------------------------------------------------------------------------------------- Pinocchio


class Reference:
    """Pinocchio's reading of the same file; what is not on the way to the sensor stands still."""

    def __init__(self, name: str, arm: SpatialArm) -> None:
        self.model = pinocchio.buildModelFromUrdf(str(URDF / f"{name}.urdf"))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(FRAMES[name])
        self.places = [self.model.joints[self.model.getJointId(j.name)].idx_v for j in arm.chain]

    def at(self, q: Array, dq: Array, ddq: Array) -> None:
        spread = [np.zeros(self.model.nv) for _ in range(3)]
        for full, own in zip(spread, (q, dq, ddq), strict=True):
            full[self.places] = own
        # A joint without end has two coordinates there; integrating from zero sets them.
        posture = pinocchio.integrate(self.model, pinocchio.neutral(self.model), spread[0])
        pinocchio.forwardKinematics(self.model, self.data, posture, *spread[1:])
        pinocchio.updateFramePlacements(self.model, self.data)


@pytest.mark.parametrize("axes", [pinocchio.LOCAL, pinocchio.LOCAL_WORLD_ALIGNED])
def test_pose_velocity_and_acceleration_are_pinocchios(name: str, arm: SpatialArm, axes: int) -> None:
    reference, states = Reference(name, arm), states_of(arm)
    pose = arm.pose(*states)
    rotation = turn(pose)
    # omega and alpha are ours in the sensor frame, velocity and acceleration in the world: turned to `axes`.
    to_local = axes == pinocchio.LOCAL
    linear = [vectors(pose, prefix) for prefix in ("vp", "ap")]
    angular = [vectors(pose, prefix) for prefix in ("w", "al")]
    if to_local:
        linear = [rotation.apply(v, inverse=True) for v in linear]
    else:
        angular = [rotation.apply(v) for v in angular]
    for i, state in enumerate(zip(*states, strict=True)):
        reference.at(*state)
        model, data, frame = reference.model, reference.data, reference.frame
        placed = data.oMf[frame]
        velocity = pinocchio.getFrameVelocity(model, data, frame, axes)
        acceleration = pinocchio.getFrameClassicalAcceleration(model, data, frame, axes)
        np.testing.assert_allclose(rotation[i].as_matrix(), placed.rotation, atol=ROUNDING)
        np.testing.assert_allclose(vectors(pose, "p")[i], placed.translation, atol=ROUNDING)
        np.testing.assert_allclose(angular[0][i], velocity.angular, atol=ROUNDING)
        np.testing.assert_allclose(linear[0][i], velocity.linear, atol=ROUNDING)
        np.testing.assert_allclose(angular[1][i], acceleration.angular, atol=ROUNDING)
        np.testing.assert_allclose(linear[1][i], acceleration.linear, atol=ROUNDING)


def test_limits_are_pinocchios(name: str, arm: SpatialArm) -> None:
    reference = Reference(name, arm)
    for joint, place in zip(arm.chain, reference.places, strict=True):
        other = reference.model.joints[reference.model.getJointId(joint.name)]
        if joint.position is None:
            assert other.nq == 2  # without end
            assert joint.velocity is None
        else:
            low, high = (
                limit[other.idx_q] for limit in (reference.model.lowerPositionLimit, reference.model.upperPositionLimit)
            )
            assert joint.position == (low, high)
            fastest = reference.model.velocityLimit[place]
            assert joint.velocity == (-fastest, fastest)


# ------------------------------------------------------------------------------- other ways to it


def test_derivatives_are_those_in_time(arm: SpatialArm) -> None:
    q, dq, ddq = states_of(arm)
    h = 1e-5

    def at(t: float) -> dict[str, Array]:
        return arm.pose(q + dq * t + ddq * t**2 / 2, dq + ddq * t, ddq)

    now, ahead, behind = at(0.0), at(h), at(-h)

    def rate(prefix: str) -> Array:
        return (vectors(ahead, prefix) - vectors(behind, prefix)) / (2 * h)

    # A central difference errs by h²/6 of a third derivative: with w = 14 rad/s, b = 70 rad/s² (seven joints) and 3 m
    # at most 3 (w³ + 3 w b) = 2e4 m/s³ of a position, 3 (w⁴ + 6 w² b + 3 b²) = 4e5 of a velocity; by 1e-9 of rounding.
    np.testing.assert_allclose(rate("p"), vectors(now, "vp"), atol=1e-6)
    np.testing.assert_allclose(rate("vp"), vectors(now, "ap"), atol=1e-5)
    np.testing.assert_allclose(rate("w"), vectors(now, "al"), atol=1e-5)
    turned = (turn(behind).inv() * turn(ahead)).as_rotvec() / (2 * h)
    np.testing.assert_allclose(turned, vectors(now, "w"), atol=1e-6)


def test_turning_from_the_quaternion_is_the_derivation_of_the_models_rotation() -> None:
    """omega and alpha by conj(s) ds agree with what SymPy derives from R' dR of `Space.SPACE`."""
    arm = spatial_arm("elbow")
    h, (q, dq, ddq) = 1e-4, states_of(arm, 5)
    path = [arm.pose(q + dq * t + ddq * t**2 / 2, dq + ddq * t, ddq) for t in (-h, 0.0, h)]
    s = [np.stack([pose[name] for name in COMPONENTS]) for pose in path]
    ds, dds = (s[2] - s[0]) / (2 * h), (s[2] - 2 * s[1] + s[0]) / h**2
    symbols = [signals(*(f"{p}{i}" for i in range(4))) for p in ("s", "ds", "dds")]
    derived = angular_motion(symbols)
    flat = [symbol for four in symbols for symbol in four]
    for name in ("wx", "wy", "wz", "alx", "aly", "alz"):
        value = sp.lambdify(flat, derived[name])(*s[1], *ds, *dds)
        # h²/6 of a third derivative below 1e4 /s³, and rounding 1e-16 / h² of the second difference
        np.testing.assert_allclose(value, path[1][name], atol=1e-4)


def test_an_arm_in_a_plane_is_the_planar_arm() -> None:
    """x right, z up; the planar phi is the turn about y, the sensor's z axis runs along the tip."""
    arm = spatial_arm("planar")
    states = states_of(arm)
    pose, plane = arm.pose(*states), PlanarArm((1.0, 0.97, 0.4)).pose(*states)
    pairs = {"px": "px", "pz": "py", "vpx": "vx", "vpz": "vy", "apx": "ax", "apz": "ay", "wy": "dphi", "aly": "ddphi"}
    for ours, theirs in pairs.items():
        np.testing.assert_allclose(pose[ours], plane[theirs], atol=ROUNDING)
    for out in ("py", "vpy", "apy", "wx", "wz", "alx", "alz"):
        np.testing.assert_allclose(pose[out], 0.0, atol=ROUNDING)
    expected = Rotation.from_rotvec(np.outer(plane["phi"], [0, 1, 0]))
    np.testing.assert_allclose((turn(pose) * expected.inv()).magnitude(), 0.0, atol=1e-7)  # arccos near 1


def test_orientation_never_jumps(arm: SpatialArm) -> None:
    """Along a path of many turns the quaternion moves as slowly as the joints do: no change of sign."""
    t = np.linspace(0.0, 4 * np.pi, 4001)[:, None]
    q = 3 * np.sin(t + np.arange(arm.joints))
    pose = arm.pose(q, np.zeros_like(q), np.zeros_like(q))
    steps = np.linalg.norm(np.diff(np.stack([pose[name] for name in COMPONENTS]), axis=1), axis=0)
    assert steps.max() < 0.5 * 3 * (t[1] - t[0]).item() * arm.joints  # half the angle's step, of all joints together


# ------------------------------------------------------------------------------------ as an Arm


def test_function_takes_one_state_or_many_and_graph_takes_any_symbols(arm: SpatialArm) -> None:
    states = states_of(arm, 4)
    pose = arm.pose(*states)
    for i, state in enumerate(zip(*states, strict=True)):
        expected = [pose[name][i] for name in arm.names]
        found = np.array(arm.function(*state))[:, 0]
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)  # NumPy's sine and cosine are other ones
    offset = ca.MX.sym("offset", arm.joints)
    shifted = ca.Function("shifted", [offset], [arm.function(states[0][0] + offset, *(s[0] for s in states[1:]))])
    np.testing.assert_array_equal(np.array(shifted(0)), np.array(arm.function(*(s[0] for s in states))))


def test_tip_is_along_the_sensors_z(arm: SpatialArm) -> None:
    q, dq, ddq = states_of(arm, 20)
    pose = arm.pose(q, dq, ddq)
    expected = vectors(pose, "p") + turn(pose).apply([0.0, 0.0, 0.23])
    np.testing.assert_allclose(np.array(arm.tip(0.23)(q.T)).T, expected, atol=ROUNDING)


def test_tip_of_the_planar_arm_is_the_chapters() -> None:
    """22.2: P = Ps + l_t (sin phi, cos phi)."""
    arm = PlanarArm((1.0, 0.97, 0.4))
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (20, 3))
    pose = arm.pose(q, 0 * q, 0 * q)
    expected = [pose["px"] + 0.2 * np.sin(pose["phi"]), pose["py"] + 0.2 * np.cos(pose["phi"])]
    np.testing.assert_allclose(np.array(arm.tip(0.2)(q.T)), expected, atol=ROUNDING)


def test_planar_function_is_its_pose() -> None:
    arm = PlanarArm((0.3, 0.5))
    states = tuple(np.random.default_rng(i).normal(size=(7, 2)) for i in range(3))
    pose = arm.pose(*states)
    np.testing.assert_allclose(np.array(arm.function(*(s.T for s in states))), [pose[n] for n in arm.names], atol=1e-12)


def test_an_arm_is_a_value(arm: SpatialArm) -> None:
    again = SpatialArm(arm.chain, arm.sensor)
    assert again == arm
    assert hash(again) == hash(arm)
    for own in (arm, PlanarArm((0.3, 0.5))):
        own.pose(*states_of(own, 2))  # what it compiles does not hinder it
        copied = pickle.loads(pickle.dumps(own))  # noqa: S301 - its own bytes
        assert copied == own
        np.testing.assert_array_equal(
            copied.function(*([0.1] * own.joints for _ in range(3))), own.function(0.1, 0.1, 0.1)
        )


def test_some_joint_slides() -> None:
    kinds = [j.kind for j in spatial_arm("slide").chain]
    assert kinds == [JointKind.PRISMATIC, JointKind.REVOLUTE, JointKind.PRISMATIC, JointKind.REVOLUTE]


# -------------------------------------------------------------------------------- quaternions


def test_quaternion_algebra_is_scipys() -> None:
    rng = np.random.default_rng(0)
    first, second = Rotation.random(2, rng=rng)
    a, b, v = first.as_quat().tolist(), second.as_quat().tolist(), rng.normal(size=3).tolist()
    np.testing.assert_allclose(np.abs(np.dot(quaternion_product(a, b), (first * second).as_quat())), 1.0, atol=1e-15)
    np.testing.assert_allclose(np.array(rotated_vector(a, v)), first.apply(v), atol=1e-15)
    np.testing.assert_allclose(np.array(quaternion_product(a, quaternion_conjugate(a))), [0, 0, 0, 1], atol=1e-15)
    unit = dict(zip(signals(*COMPONENTS), a, strict=True))
    matrix = np.array(Space.SPACE.motion.rotation.subs(unit), dtype=float)
    np.testing.assert_allclose(np.array(rotated_vector(a, v)), matrix @ v, atol=1e-15)


def test_placements_follow_each_other() -> None:
    rng = np.random.default_rng(1)
    turns, shifts = Rotation.random(2, rng=rng), rng.normal(size=(2, 3))
    first, second = (
        Placement(position=(x, y, z), quaternion=(i, j, k, w))
        for (x, y, z), (i, j, k, w) in zip(shifts.tolist(), turns.as_quat().tolist(), strict=True)
    )
    both, point = first.then(second), rng.normal(size=3)
    there = turns[0].apply(turns[1].apply(point) + shifts[1]) + shifts[0]
    np.testing.assert_allclose(
        np.add(rotated_vector(both.quaternion, point.tolist()), both.position), there, atol=1e-14
    )
