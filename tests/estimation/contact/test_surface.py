"""Contact points: known ones found again, on the right side, with an uncertainty that holds, or none with the reason.

Random tests are seeded; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from benchmarks.coverage import RIGS, Setting, silent_recording
from estimation.contact.contact_point import Capsule, Plane, Sphere, Surface, contact_point
from estimation.contact.contact_wrench import CalibratedModel, compensate
from modeling.errors import InputError
from modeling.space import Space
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

SPHERE = Sphere(centre=np.array([0.01, -0.02, 0.18]), radius=0.03)
CAPSULE = Capsule(start=np.array([0.0, 0.01, 0.02]), end=np.array([0.03, 0.0, 0.2]), radius=0.025)
PLANE = Plane(point=np.array([0.0, 0.0, 0.15]), normal=np.array([0.1, -0.2, 2.0]))
SURFACES = pytest.mark.parametrize("surface", [SPHERE, CAPSULE, PLANE], ids=lambda s: type(s).__name__)
QUIET = np.diag([0.05, 0.06, 0.08, 0.002, 0.003, 0.004]) ** 2


def touched(surface: Surface, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points of a surface and its outward normals there, by construction and not by `outward`."""
    unit = directions(count, rng)
    if isinstance(surface, Sphere):
        return np.asarray(surface.centre + surface.radius * unit), unit
    if isinstance(surface, Capsule):
        way = (surface.end - surface.start) / np.linalg.norm(surface.end - surface.start)
        # Half of them beside the segment; the ends' half spheres face away from it.
        side = directions_of(unit - (unit @ way)[:, None] * way)
        beside = np.arange(count) % 2 == 0
        place = np.where(beside, rng.uniform(0.02, 0.98, count), unit @ way > 0)
        normal = np.where(beside[:, None], side, unit)
        middle = surface.start + place[:, None] * (surface.end - surface.start)
        return np.asarray(middle + surface.radius * normal), normal
    assert isinstance(surface, Plane)
    normal = surface.normal / np.linalg.norm(surface.normal)
    return surface.point + np.cross(normal, 0.1 * unit), np.tile(normal, (count, 1))


def directions(count: int, rng: np.random.Generator) -> Array:
    return directions_of(rng.standard_normal((count, 3)))


def directions_of(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def pushes(normal: Array, rng: np.random.Generator, steepest: float = 0.2) -> Array:
    """Forces of 5 to 50 N of the environment on the tool that press it: against the outward normal."""
    unit = directions(len(normal), rng)
    unit = np.where(np.sum(unit * normal, axis=1, keepdims=True) < 0, unit, -unit)
    unit -= steepest * normal
    return directions_of(unit) * rng.uniform(5.0, 50.0, (len(normal), 1))


def wrench_at(points: Array, forces: Array) -> Array:
    """Force and torque about the sensor origin, component by component."""
    (x, y, z), (a, b, c) = points.T, forces.T
    return np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a], axis=1)


@SURFACES
def test_known_points_are_found_again(surface: Surface) -> None:
    rng = np.random.default_rng(1)
    points, normals = touched(surface, 400, rng)
    np.testing.assert_allclose(surface.outward(points), normals, atol=1e-9)  # rounding
    found = contact_point(wrench_at(points, pushes(normals, rng)), QUIET, surface)
    assert found.found.all()
    assert not found.missed.any()
    assert not found.pulled.any()
    np.testing.assert_allclose(found.point, points, atol=1e-9)  # rounding, over the sine of the angle to the surface
    np.testing.assert_allclose(found.torsion, 0.0, atol=1e-12)
    assert (found.clearance <= 0).all()


@SURFACES
def test_a_force_that_pulls_has_no_point_where_it_leaves(surface: Surface) -> None:
    """The negative wrench is on the same line. A closed surface is then entered from the other side; a face is not."""
    rng = np.random.default_rng(2)
    points, normals = touched(surface, 200, rng)
    force = pushes(normals, rng)
    found = contact_point(-wrench_at(points, force), QUIET, surface)
    if isinstance(surface, Plane):
        assert found.pulled.all()
        assert not found.found.any()
        return
    assert found.found.all()
    through = points - found.point
    length = np.linalg.norm(through, axis=1)
    assert (length > 1e-3).all()
    np.testing.assert_allclose(np.sum(through * force, axis=1), -length * np.linalg.norm(force, axis=1), rtol=1e-9)


def test_the_first_crossing_counts() -> None:
    """Straight down through a ball about the origin: on top, whatever the sign of the readings' convention."""
    ball = Sphere(centre=np.zeros(3), radius=0.1)
    found = contact_point(np.array([[0.0, 0, -5, 0, 0, 0], [0.0, 0, 5, 0, 0, 0]]), QUIET, ball)
    np.testing.assert_allclose(found.point, [[0, 0, 0.1], [0, 0, -0.1]], atol=1e-15)


def test_a_capsule_of_no_length_is_a_ball_and_a_long_one_a_cylinder() -> None:
    rng = np.random.default_rng(3)
    origin, unit = 0.1 * rng.standard_normal((300, 3)), directions(300, rng)
    ball = Sphere(centre=np.zeros(3), radius=0.1)
    short = Capsule(start=np.zeros(3), end=np.array([0.0, 0.0, 1e-12]), radius=0.1)
    np.testing.assert_allclose(short.clearance(origin, unit), ball.clearance(origin, unit), atol=1e-11)  # the length
    ours, theirs = (np.sort(s.crossings(origin, unit), axis=1)[:, :2] for s in (short, ball))
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    np.testing.assert_allclose(ours, theirs, atol=1e-8)  # the length over the sine of the angle to the surface
    cylinder = Capsule(start=np.array([0.0, 0, -100]), end=np.array([0.0, 0, 100]), radius=0.1)
    places = np.sort(cylinder.crossings(origin, unit), axis=1)[:, :2]
    distance = np.hypot(*(origin[:, None] + places[..., None] * unit[:, None])[..., :2].transpose(2, 0, 1))
    seen = np.isfinite(distance)
    assert seen.sum() > 100
    np.testing.assert_allclose(distance[seen], 0.1, rtol=1e-9)  # rounding


@pytest.mark.parametrize("surface", [SPHERE, CAPSULE], ids=["Sphere", "Capsule"])
def test_clearance_is_the_least_distance_along_the_line(surface: Sphere | Capsule) -> None:
    rng = np.random.default_rng(4)
    ends = (surface.centre, surface.centre) if isinstance(surface, Sphere) else (surface.start, surface.end)
    origin, unit = (ends[0] + ends[1]) / 2 + 0.05 * rng.standard_normal((60, 3)), directions(60, rng)

    def height(s: float, i: int) -> float:
        point, way = origin[i] + s * unit[i], ends[1] - ends[0]
        along = np.clip((point - ends[0]) @ way / max(way @ way, 1e-300), 0, 1)
        return float(np.linalg.norm(point - ends[0] - along * way) - surface.radius)

    least = [minimize_scalar(height, bounds=(-2.0, 2.0), args=(i,), options={"xatol": 1e-9}).fun for i in range(60)]
    np.testing.assert_allclose(surface.clearance(origin, unit), least, atol=1e-8)  # the search's
    crossed = np.isfinite(surface.crossings(origin, unit)).any(axis=1)
    np.testing.assert_array_equal(crossed, np.array(least) <= 0)
    assert 5 < crossed.sum() < 55


def test_a_line_that_passes_says_by_how_much() -> None:
    ball = Sphere(centre=np.array([0.0, 0, 0.2]), radius=0.03)
    wrench = wrench_at(np.array([[0.05, 0.0, 0.0]]), np.array([[0.0, 0.0, -10.0]]))
    found = contact_point(wrench, QUIET, ball)
    assert found.missed.all()
    assert np.isnan(found.point).all()
    assert np.isnan(found.covariance).all()
    assert found.clearance[0] == pytest.approx(0.02, abs=1e-15)


def test_a_weak_force_has_no_point() -> None:
    """Twice the std of 0.08 N along z."""
    wrench = wrench_at(np.zeros((3, 3)), np.array([[0.0, 0.0, -0.159], [0.0, 0.0, -0.161], [0.0, 0.0, 0.0]]))
    found = contact_point(wrench, QUIET, Sphere(centre=np.zeros(3), radius=0.1))
    np.testing.assert_array_equal(found.clear, [False, True, False])
    np.testing.assert_array_equal(found.found, [False, True, False])
    assert np.isnan(found.torsion[[0, 2]]).all()
    assert not contact_point(np.full((1, 6), np.nan), QUIET, SPHERE).clear.any()


# --------------------------------------------------------------------------------------------- uncertainty


def spread(rng: np.random.Generator, covariance: Array, count: int) -> Array:
    return rng.standard_normal((count, 6)) @ np.linalg.cholesky(covariance).T


def correlated() -> Array:
    root = np.random.default_rng(5).standard_normal((6, 6)) * np.sqrt(np.diag(QUIET))[:, None] / 2
    return np.asarray(root @ root.T)


@SURFACES
def test_covariance_of_the_point_is_by_finite_differences(surface: Surface) -> None:
    """Central, with steps of 1e-5 of the wrench's size: to 1e-8 of the slope, as far as it does not bend faster."""
    rng = np.random.default_rng(6)
    points, normals = touched(surface, 40, rng)
    wrench, covariance = wrench_at(points, pushes(normals, rng, steepest=0.5)), correlated()
    wrench[:, 3:] += 0.02 * wrench[:, :3]  # a pitch: the axis still meets the surface there
    found = contact_point(wrench, covariance, surface)
    sizes = 1e-5 * np.array([10.0] * 3 + [1.0] * 3)
    ahead, behind = (
        np.stack([contact_point(wrench + sign * step, covariance, surface).point for step in np.diag(sizes)], axis=2)
        for sign in (1, -1)
    )
    slopes = (ahead - behind) / (2 * sizes)
    np.testing.assert_allclose(found.covariance, slopes @ covariance @ slopes.transpose(0, 2, 1), rtol=1e-5, atol=1e-12)
    across = np.einsum("nij,nj->ni", found.covariance, surface.outward(found.point))
    np.testing.assert_allclose(across, 0.0, atol=1e-15)  # to first order the point stays on the surface


@SURFACES
def test_the_points_ellipse_holds_the_truth(surface: Surface) -> None:
    """95 % in the tangent plane, where the force is 60 of its std or more: the share of 4000 within 4.5 sigma, 1e-5."""
    rng = np.random.default_rng(7)
    points, normals = touched(surface, 4000, rng)
    covariance = correlated()
    wrench = wrench_at(points, pushes(normals, rng, steepest=1.0)) + spread(rng, covariance, 4000)
    found = contact_point(wrench, covariance, surface)
    assert found.found.mean() > 0.99  # a few on an edge of a ball are missed
    error = (found.point - points)[found.found]
    square = np.einsum("ni,nij,nj->n", error, np.linalg.pinv(found.covariance[found.found], rcond=1e-6), error)
    inside = np.mean(square < chi2.ppf(0.95, 2))
    assert inside == pytest.approx(0.95, abs=4.5 * np.sqrt(0.95 * 0.05 / 4000))


def test_torsion_of_a_point_contact_is_within_its_std() -> None:
    """chi² of one degree of freedom: mean 1 ± 4.5 sqrt(2/4000), 1e-5."""
    rng = np.random.default_rng(8)
    points, normals = touched(SPHERE, 4000, rng)
    covariance = correlated()
    force = pushes(normals, rng, steepest=1.0)
    noise = spread(rng, covariance, 4000)
    found = contact_point(wrench_at(points, force) + noise, covariance, SPHERE)
    assert np.nanmean(found.misfit) == pytest.approx(1.0, abs=4.5 * np.sqrt(2 / 4000))
    twisted = wrench_at(points, force)
    twisted[:, 3:] += 0.3 * force / np.linalg.norm(force, axis=1, keepdims=True)
    np.testing.assert_allclose(contact_point(twisted, covariance, SPHERE).torsion, 0.3, rtol=1e-9)  # rounding


def test_a_finger_on_the_simulated_rig_is_found_where_it_pushes() -> None:
    """MuJoCo, six axes, a moving tool: 9 N on a round tip for 2 s, through `compensate` with its own covariance.

    The share of the 95 % ellipses that hold the point, of 380 samples, within 4.5 sigma, 1e-5; and their mean point.
    """
    tip = Capsule(start=np.zeros(3), end=np.array([0.0, 0.0, 0.15]), radius=0.03)
    point, force = np.array([0.03, 0.0, 0.11]), np.array([-7.0, 4.0, -4.0])
    torque = wrench_at(point[None], force[None])[0, 3:]
    push = simulated.ContactEvent(start=1.5, end=3.5, force=tuple(force.tolist()), torque=tuple(torque.tolist()))
    setting = Setting(space=Space.SPACE, repeats=1, samples=1000, hidden=(push,))
    silent, rig = silent_recording(setting), RIGS[Space.SPACE]
    noise = np.array(rig.noise) * np.random.default_rng(9).standard_normal(silent.wrench.shape)
    theta = np.array([setting.truth[p.name] for p in setting.model.parameters])
    known = CalibratedModel(setting.model, theta, np.zeros((len(theta),) * 2), np.array(rig.noise), np.zeros(6))
    contact = compensate(known, silent.with_readings(silent.wrench + noise), keep_zero=True)
    pushing = slice(310, 690)
    found = contact_point(contact.wrench[pushing], contact.covariance[pushing], tip)
    assert found.found.all()
    error = found.point - point
    square = np.einsum("ni,nij,nj->n", error, np.linalg.pinv(found.covariance, rcond=1e-6), error)
    assert np.mean(square < chi2.ppf(0.95, 2)) == pytest.approx(0.95, abs=4.5 * np.sqrt(0.95 * 0.05 / 380))
    assert (np.abs(error.mean(axis=0)) < 4.5 * found.std.mean(axis=0) / np.sqrt(380) + 1e-5).all()  # 1e-5: it is curved
    assert not contact_point(contact.wrench[:250], contact.covariance[:250], tip).clear.mean() > 0.5


def test_it_prints_itself() -> None:
    found = contact_point(wrench_at(np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.0, -9.0]])), QUIET, PLANE)
    assert str(found).splitlines()[1].split() == ["point", "found", "1"]


# -------------------------------------------------------------------------------------------------- misuse


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Sphere(centre=np.zeros(3), radius=0.0), "radius 0"),
        (lambda: Sphere(centre=np.zeros(2), radius=1.0), "centre"),
        (lambda: Plane(point=np.zeros(3), normal=np.zeros(3)), "normal"),
        (lambda: Plane(point=np.array([0, np.nan, 0]), normal=np.ones(3)), "point"),
        (lambda: Capsule(start=np.ones(3), end=np.ones(3), radius=1.0), "length 0"),
        (lambda: contact_point(np.zeros((4, 3)), np.eye(6), PLANE), "six axes"),
    ],
)
def test_what_is_no_surface_is_refused(make, what: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=what):
        make()
