"""Clearances of an arm's capsules, against Pinocchio's kinematics, brute force and differences."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from design.clearance import ArmPlaces, Clearances, clearances, nearest_on_segments
from design.limits import LimitUse, use_at_rest
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries
from design.trajectory_design import design
from modeling.errors import InputError
from modeling.kinematics.arm import SpatialArm
from modeling.rig import Rig
from tests.shared.places import URDF

Array = NDArray[np.float64]
CAPSULES = [
    {"link": "fore", "start": [0.0, 0.0, 0.0], "end": [0.11, 0.55, 0.0], "radius": 0.08},
    {"link": "hand", "start": [0.0, 0.0, 0.0], "radius": 0.07},
    {"link": "tool0", "start": [0, 0, 0], "end": [0, 0, 0.12], "radius": 0.04},
    {"name": "mast", "start": [0.1, -0.9, 0.0], "end": [0.1, -0.9, 1.5], "radius": 0.1},
    {"link": "shoulder", "start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 0.2], "radius": 0.12},
]
FLOOR = {"normal": [0, 0, 2], "offset": -0.1, "clearance": 0.05}
LIMITS = {
    "position": [[-2.0, 2.0], [-1.6, 1.2], [-1.5, 2.0], [-2.5, 1.5], [-2.0, 2.0], [-2.5, 2.5]],
    "velocity": [1.5, 1.5, 1.5, 2.0, 2.0, 2.0],
    "acceleration": [4.0, 4.0, 4.0, 8.0, 8.0, 8.0],
}
SERIES = FreeSeries(joints=6, harmonics=(1, 2, 3), period=6.0)


def rig(**others: Any) -> Rig:
    robot = {"urdf": str(URDF / "elbow.urdf"), "sensor_frame": "tool0", "tip_length": 0.15}
    data = {"robot": robot, "limits": LIMITS, "capsule": CAPSULES, "half_space": [FLOOR]}
    return Rig.from_data(data | {"workspace": {"clearance": 0.02}} | others)


@cache
def asked() -> Clearances:
    of = rig()
    assert of.limits is not None
    found = clearances(of.workspace, of.arm, of.limits.position)
    assert found is not None
    return found


def by_pinocchio(positions: Array, ceiling: float = 9.0) -> dict[str, Array]:
    """The clearances (N,) by name: ends of segments by its frames, distances of segments by a fine grid on both."""
    model = pinocchio.buildModelFromUrdf(str(URDF / "elbow.urdf"))
    data, share = model.createData(), np.linspace(0.0, 1.0, 81)
    clear: dict[str, list[float]] = {}
    for q in positions:
        pinocchio.framesForwardKinematics(model, data, np.append(q, [0.0, 0.0]))
        points, radii = {}, {}
        for capsule in CAPSULES:
            ends = np.array([capsule["start"], capsule.get("end", capsule["start"])], dtype=float)
            name = str(capsule.get("name", capsule.get("link")))
            if "link" in capsule:
                frame = data.oMf[model.getFrameId(capsule["link"])]
                ends = ends @ frame.rotation.T + frame.translation
            points[name], radii[name] = ends[0] + share[:, None] * (ends[1] - ends[0]), float(str(capsule["radius"]))
        for name, along in points.items():
            for other, beside in points.items():
                distance = np.linalg.norm(along[:, None] - beside, axis=-1).min() - radii[name] - radii[other] - 0.02
                clear.setdefault(f"{name} to {other}", []).append(distance)
            height = along[:, 2].min() - 0.1 - 0.05 - radii[name]
            clear.setdefault(f"{name} to half-space 1", []).append(height)
            clear.setdefault(f"{name} to half-space 2", []).append(ceiling - along[:, 2].max() - radii[name])
    return {name: np.array(values) for name, values in clear.items()}


def some_positions(count: int) -> Array:
    low, high = np.array(LIMITS["position"], dtype=float).T
    return np.random.default_rng(0).uniform(low, high, (count, 6))


def test_clearances_are_pinocchios_and_have_their_slopes() -> None:
    q = some_positions(40)
    of, reference = asked(), by_pinocchio(q)
    values = of.values(q)
    for name in set(of.names):
        least = values[:, [i for i, one in enumerate(of.names) if one == name]].min(axis=1)
        # The grid's points are up to 1/160 of 0.56 m and 1.5 m from the nearest: 0.3 mm where they are 0.2 m apart.
        np.testing.assert_allclose(least, reference[name], atol=5e-4)
    assert "shoulder to half-space 1" in of.names
    assert not any(name in of.names for name in ("mast to half-space 1", "tool0 to hand", "hand to tool0"))
    along, h = np.random.default_rng(1).standard_normal(6), 1e-6
    slope = (of.values(q + h * along) - of.values(q - h * along)) / (2 * h)
    np.testing.assert_allclose(of.slopes(q) @ along, slope, atol=1e-6)


def test_nearest_points_of_segments() -> None:
    """Against the best of 200 x 200 points, parallel segments and points among them."""
    rng = np.random.default_rng(0)
    a, along, b, beside = rng.standard_normal((4, 60, 3))
    beside[:10], along[10:20], beside[20:25] = 2 * along[:10], 0.0, 0.0
    s, t = nearest_on_segments(a, along, b, beside)
    distance = np.linalg.norm(a + s[:, None] * along - b - t[:, None] * beside, axis=1)
    share = np.linspace(0.0, 1.0, 200)[:, None, None]
    best = np.linalg.norm((a + share * along)[:, None] - (b + share * beside)[None], axis=-1).min(axis=(0, 1))
    assert (distance <= best + 1e-12).all()
    assert (distance > best - 0.05).all()


def test_the_smallest_clearance_is_a_bound_between_the_samples_and_near() -> None:
    of, limits = asked(), rig().limits
    assert limits is not None
    for seed in range(3):
        motion = random_feasible_trajectory(SERIES, limits, seed=seed)
        dense = of.values(motion.derivative(np.linspace(0.0, 6.0, 6001), 0)).min(axis=0)
        low = of.lowest(motion)
        assert (low <= dense + 1e-9).all()
        near = dense > 0
        assert (low[near] > dense[near] - 1e-3).all()


def test_a_random_motion_keeps_clear() -> None:
    of = rig()
    assert of.limits is not None
    motion = random_feasible_trajectory(SERIES, of.limits, workspace=of.workspace, arm=of.arm, tip_length=0.15, seed=1)
    reference = by_pinocchio(motion.derivative(np.linspace(0.0, 6.0, 81), 0))
    assert min(reference[name].min() for name in asked().names) > -1e-9
    use = LimitUse.of(motion, of.limits, of.workspace, of.arm, 0.15)
    assert use.worst.use <= 1
    assert "clearance" in use.to_data()


def test_a_clearance_that_no_posture_has_is_named() -> None:
    of = rig(half_space=[FLOOR | {"offset": -9.0}])
    with pytest.raises(InputError, match=r"low limit of the clearance of \w+ to half-space 1"):
        design(of, series=SERIES, samples=40, starts=1, bounded=False)


def test_what_is_stored_is_what_was_read() -> None:
    data = rig().to_data()
    assert data["capsule"][0]["joint"] == 3  # pan, lift and elbow move it
    again = Rig.from_data(data)
    assert again.workspace == rig().workspace
    assert again.to_data() == data
    assert again.workspace is not None
    assert again.workspace.half_spaces[0].normal == (0.0, 0.0, 1.0)
    assert "[[capsule]]" in str(again)


BALL = {"link": "fore", "start": [0, 0, 0], "radius": 0.1}


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"capsule": [BALL | {"link": "leg"}]}, "has no link 'leg'"),
        ({"capsule": [BALL | {"joint": 2}]}, "got both"),
        ({"capsule": [BALL | {"radius": 0.0}]}, "radius"),
        ({"capsule": [BALL | {"start": [0, 0]}]}, "start"),
        ({"capsule": [BALL | {"start": [0, 0, 1e300]}]}, "start"),
        ({"capsule": [{"joint": 7, "start": [0, 0, 0], "radius": 0.1}]}, "the arm has 6 joints"),
        ({"half_space": [FLOOR | {"normal": [0, 0, 0]}]}, "normal"),
        ({"capsule": []}, "no \\[\\[capsule\\]\\] moves"),
        ({"robot": {"link_lengths": [1.0]}, "limits": {k: [1] for k in LIMITS}}, "read from a URDF"),
    ],
)
def test_a_wrong_capsule_is_one_line(others: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        rig(**others)


SOLIDS = {
    "upper": '<box size="0.5 0.12 0.1"/>',
    "fore": '<cylinder radius="0.06" length="0.4"/>',
    "wrist": '<box size="0.1 0.11 0.3"/>',
    "hand": '<sphere radius="0.08"/>',
    "finger": '<box size="0.02 0.02 0.05"/>',
}


def with_solids(folder: Path, solids: dict[str, str]) -> Path:
    text = re.sub(
        r'<link name="upper">.*?</link>', '<link name="upper"/>', (URDF / "elbow.urdf").read_text(), flags=re.S
    )
    for link, solid in solids.items():
        own = f'<collision><origin xyz="0.1 0.02 -0.03" rpy="0.3 -0.2 0.5"/><geometry>{solid}</geometry></collision>'
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{own}</link>')
    path = folder / "elbow.urdf"
    path.write_text(text)
    return path


def test_capsules_of_the_urdf_hold_its_collision_geometry(tmp_path: Path) -> None:
    """Points of every solid, placed by Pinocchio, are in its capsule, and the farthest reach its surface."""
    path = with_solids(tmp_path, SOLIDS)
    robot, workspace = {"urdf": str(path), "sensor_frame": "tool0"}, {"capsules": "urdf"}
    of = Rig.from_data({"robot": robot, "limits": LIMITS, "workspace": workspace})
    assert of.workspace is not None
    assert isinstance(of.arm, SpatialArm)
    capsules = {capsule.name: capsule for capsule in of.workspace.capsules}
    assert set(capsules) == set(SOLIDS)
    model = pinocchio.buildModelFromUrdf(str(path))
    solids = pinocchio.buildGeomFromUrdf(model, str(path), pinocchio.GeometryType.COLLISION)
    data, placed, rng = model.createData(), solids.createData(), np.random.default_rng(0)
    q = some_positions(1)
    pinocchio.updateGeometryPlacements(model, data, solids, placed, np.append(q[0], [0.0, 0.0]))
    places = ArmPlaces.of(of.arm, q)
    for number, solid in enumerate(solids.geometryObjects):
        shape, capsule = solid.geometry, capsules[solid.name.rpartition("_")[0]]
        corners = rng.choice([-1.0, 1.0], (400, 3)) * rng.uniform(0, 1, (400, 3)) ** rng.choice([0, 1], (400, 3))
        if hasattr(shape, "halfSide"):
            own = corners * shape.halfSide
        elif hasattr(shape, "halfLength"):
            round_ = corners[:, :2] / np.maximum(np.linalg.norm(corners[:, :2], axis=1), 1.0)[:, None]
            own = np.c_[shape.radius * round_, shape.halfLength * corners[:, 2]]
        else:
            own = shape.radius * corners / np.linalg.norm(corners, axis=1)[:, None]
        points = own @ placed.oMg[number].rotation.T + placed.oMg[number].translation
        joint, ends = np.array([capsule.joint] * 2), np.array([capsule.start, capsule.end])
        start, end = places.points(joint, ends)[0]
        still = np.zeros((400, 3))
        _, share = nearest_on_segments(points, still, start + still, end - start + still)
        distance = np.linalg.norm(points - start - share[:, None] * (end - start), axis=1)
        assert capsule.radius * (1 - 1e-9) <= distance.max() <= capsule.radius * (1 + 1e-9)
    again = Rig.from_data(of.to_data())
    assert again.workspace == of.workspace


@pytest.mark.parametrize(
    ("solids", "others", "said"),
    [
        (
            {"fore": '<mesh filename="package://nowhere/fore.stl"/>'},
            {},
            "link 'fore': its collision geometry is a mesh",
        ),
        ({"fore": '<box size="0.1 0 0.1"/>'}, {}, "no size"),
        ({"fore": '<sphere radius="big"/>'}, {}, "sphere radius is 'big'"),
        ({}, {}, "no link of the URDF has collision geometry"),
        ({"fore": SOLIDS["fore"]}, {"robot": {"link_lengths": [1.0]}}, "is of arms that are read from one"),
    ],
)
def test_geometry_without_a_capsule_is_one_line(
    tmp_path: Path, solids: dict[str, str], others: dict[str, Any], said: str
) -> None:
    robot = {"urdf": str(with_solids(tmp_path, solids)), "sensor_frame": "tool0"}
    with pytest.raises(InputError, match=said) as caught:
        Rig.from_data({"robot": robot, "workspace": {"capsules": "urdf"}} | others)
    assert "\n" not in str(caught.value)


def test_a_stated_capsule_takes_the_place_of_its_links_geometry(tmp_path: Path) -> None:
    path = with_solids(tmp_path, SOLIDS | {"fore": '<mesh filename="fore.stl"/>'})
    robot, by_hand = {"urdf": str(path), "sensor_frame": "tool0"}, CAPSULES[0]
    of = Rig.from_data({"robot": robot, "workspace": {"capsules": "urdf"}, "capsule": [by_hand]})
    assert of.workspace is not None
    assert [c.radius for c in of.workspace.capsules if c.name == "fore"] == [0.08]
    assert len(of.workspace.capsules) == len(SOLIDS)


def test_a_link_beside_the_sensor_can_be_named_where_its_geometry_is_a_mesh(tmp_path: Path) -> None:
    """A finger's: it moves with the link that carries it, as the geometry that it stands for would."""
    robot = {"urdf": str(with_solids(tmp_path, {"finger": '<sphere radius="0.02"/>'})), "sensor_frame": "tool0"}
    fitted = Rig.from_data({"robot": robot, "workspace": {"capsules": "urdf"}}).workspace
    robot["urdf"] = str(with_solids(tmp_path, {"finger": '<mesh filename="finger.stl"/>'}))
    ball = {"link": "finger", "start": [0.1, 0.02, -0.03], "radius": 0.02}
    stated = Rig.from_data({"robot": robot, "workspace": {"capsules": "urdf"}, "capsule": [ball]}).workspace
    assert fitted is not None
    assert stated is not None
    assert stated.capsules[0].joint == fitted.capsules[0].joint > 0
    np.testing.assert_allclose(stated.capsules[0].start, fitted.capsules[0].start, atol=1e-12)


def test_what_is_fixed_to_a_mounted_base_is_mounted_with_it(tmp_path: Path) -> None:
    """Upside down on a ceiling: geometry and capsules of the base hang below it, an obstacle is where it is stated."""
    path = with_solids(tmp_path, {"base": '<sphere radius="0.08"/>'})
    robot = {"urdf": str(path), "sensor_frame": "tool0", "gravity_direction": [0, 0, 1]}
    stated = [{"start": [0, 0, 0.5], "radius": 0.1}]
    turned = {"robot": robot, "workspace": {"capsules": "urdf"}}
    fitted = Rig.from_data(turned | {"capsule": stated}).workspace
    named = Rig.from_data({"robot": robot, "capsule": [BALL | {"link": "base", "start": [0.0, 0.0, 0.3]}]}).workspace
    assert fitted is not None
    assert named is not None
    heights = [capsule.start[2] for capsule in (*fitted.capsules, *named.capsules)]
    np.testing.assert_allclose(heights, [0.5, 0.03, -0.3], atol=1e-12)


def test_far_along_a_track_a_clearance_is_within_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "track.urdf"
    slide = '<joint name="s" type="prismatic"><parent link="base"/><child link="car"/><axis xyz="1 0 0"/></joint>'
    path.write_text(f'<robot name="track"><link name="base"/><link name="car"/>{slide}</robot>')
    bounds = {"position": [[0.0, 30.0]], "velocity": [1.0], "acceleration": [1.0]}
    capsules = [{"joint": 1, "start": [0, 0, 0], "radius": 0.1}, {"start": [0, 0, 0], "radius": 0.1}]
    robot = {"urdf": str(path), "sensor_frame": "car"}
    of = Rig.from_data({"robot": robot, "limits": bounds, "capsule": capsules})
    assert of.limits is not None
    use = use_at_rest(np.array([[0.19], [0.21], [29.5]]), of.limits, of.workspace, of.arm, None)
    assert (use > 1).tolist() == [True, False, False]


@pytest.mark.long(8)
def test_a_design_keeps_clear_between_the_samples() -> None:
    ceiling = {"normal": [0, 0, -1], "offset": 0.8}
    found = design(rig(half_space=[FLOOR, ceiling]), series=SERIES, samples=60, starts=1, bounded=False)
    reference = by_pinocchio(found.motion.derivative(np.linspace(0.0, 6.0, 401), 0), ceiling=0.8)
    kept = [*asked().names, *(f"{name} to half-space 2" for name in ("fore", "hand", "tool0"))]
    assert -1e-9 < min(reference[name].min() for name in kept) < 0.02, "clearances decide"
    assert found.limit_use.worst.use <= 1
