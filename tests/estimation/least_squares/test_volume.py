"""Mass inside a volume: conditions that every tool there keeps, the optimum by another solver, and the command."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import truewrench as tw
from estimation.least_squares.constraints import Constraints, cvxpy
from estimation.least_squares.prior import Prior
from modeling.chain.model import planar, spatial
from modeling.chain.pseudo_inertia import CONSISTENCY_MARGIN, Volume
from modeling.errors import InputError
from tests.estimation.least_squares.test_constrained import POINTS, problem
from truewrench.command_line import main
from truewrench.commands.fit import read_volume
from truewrench.simulated_rig import SpatialRig, static_poses, write_recording

Array = NDArray[np.float64]

LOW, HIGH = np.array([-0.03, -0.05, 0.01]), np.array([0.04, 0.05, 0.21])
CORNERS = np.array([[x, y, z] for x in (LOW[0], HIGH[0]) for y in (LOW[1], HIGH[1]) for z in (LOW[2], HIGH[2])])
TRIANGLES = CORNERS[[[0, 1, 2], [1, 3, 2], [4, 6, 5], [5, 6, 7], [0, 4, 1], [1, 4, 5], [2, 3, 6], [3, 7, 6]]]


def moments(masses: Array, places: Array) -> Array:
    """J (4, 4) of point masses."""
    lifted = np.column_stack([places, np.ones(len(places))])
    return np.asarray(lifted.T @ (masses[:, None] * lifted))


@pytest.mark.parametrize("volume", [Volume.box(LOW, HIGH), Volume.around(CORNERS, "corners")], ids=["box", "mesh"])
def test_every_tool_inside_keeps_the_conditions(volume: Volume) -> None:
    """And a point outside the box breaks one of them."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        count = int(rng.integers(1, 6))
        places = rng.uniform(LOW, HIGH, (count, 3)) if rng.random() < 0.5 else CORNERS[rng.integers(0, 8, count)]
        held = [np.sum(moments(rng.uniform(0.1, 1, count), places) * form) for form in volume.quadratics]
        assert min(held) > -1e-12
    outside = [*(HIGH + np.diag([0.01, 0.01, 0.01])), *(LOW - np.diag([0.01, 0.01, 0.01]))]
    for place in outside:
        assert min(np.sum(moments(np.ones(1), place[None]) * form) for form in volume.quadratics) < 0


def test_the_ellipsoid_is_the_smallest() -> None:
    """Of a box it is the one through its corners, of half axes sqrt(3) times the box's: known in closed form."""
    form = Volume.around(CORNERS, "corners").quadratics[-1]
    middle, half = (LOW + HIGH) / 2, np.sqrt(3) * (HIGH - LOW) / 2
    for direction in np.eye(3):
        for side in (-1, 1):
            edge = np.append(middle + side * half * direction, 1.0)
            assert abs(edge @ form @ edge) < 1e-3 * half.max() ** 2  # the gap of 1e-4 is of dimension and 1
    assert np.append(middle, 1) @ form @ np.append(middle, 1) == pytest.approx(half.max() ** 2, rel=1e-3)


def test_the_optimum_is_that_of_another_formulation() -> None:
    """Second moments, first moment and mass as matrix variables of CVXPY, without our parameters' derivative of J."""
    cp, active = cvxpy(), 0
    for seed in range(4):
        posed = problem(spatial(), seed, points=POINTS["spatial"])
        volume = Volume.box((-0.05, -0.05, -0.05), (0.05, 0.05, 0.05))
        found = posed.solved(Constraints(inside=volume))
        J, bias = cp.Variable((4, 4), symmetric=True), cp.Variable(6)
        inertia = cp.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
        values = {"m": J[3, 3], "mx": J[0, 3], "my": J[1, 3], "mz": J[2, 3]}
        values |= {f"I{a}{b}": inertia[i, j] for i, a in enumerate("xyz") for j, b in enumerate("xyz") if j >= i}
        theta = cp.hstack([values.get(n, bias[min(i, 5)]) for i, n in enumerate(posed.names)])
        flat = np.diag([1.0, 1.0, 1.0, 0.0])
        room = [0.05**2 * J[3, 3] - J[i, i] >= 0 for i in range(3)]
        cone = [J - CONSISTENCY_MARGIN * cp.trace(J[:3, :3]) * flat >> 0]
        program = cp.Problem(cp.Minimize(cp.sum_squares(posed.A @ theta - posed.b)), [*room, *cone])
        program.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
        assert found.cost == pytest.approx(program.value, rel=1e-6)
        assert found.converged
        active += len(found.active)
        mass = found.theta[posed.names.index("m")]
        first = found.theta[[posed.names.index(f"m{a}") for a in "xyz"]]
        assert (np.abs(first / mass) <= 0.05 + 1e-9).all()
    assert active


def test_what_cannot_be_a_volume_is_one_line(tmp_path: Path) -> None:
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n", encoding="utf-8")
    (tmp_path / "empty.stl").write_bytes(b"")
    for given, said in {
        "0,1,0,1": "neither a box of six numbers nor a mesh",
        "0.1,0,0,1,0,1": "each high end is to be above its low one",
        "-50,50,-50,50,0,200": "millimetres?",
        str(flat): "span no volume",
        str(tmp_path / "empty.stl"): "no corners of a mesh",
        str(tmp_path / "none.stl"): "No such file",
    }.items():
        with pytest.raises(InputError) as refused:
            read_volume(given)
        assert said in str(refused.value)
        assert "\n" not in str(refused.value)
    box = Volume.box(LOW, HIGH)
    posed = problem(planar(), 0, points=2)
    with pytest.raises(InputError, match="use a six-axis sensor"):
        posed.solved(Constraints(inside=box))
    six_axes = problem(spatial(), 0, points=6)
    prior = Prior(
        {"m": 1.0, "mx": 0, "my": 0, "mz": 0, "Ixx": 1, "Iyy": 1, "Izz": 1, "Ixy": 0, "Ixz": 0, "Iyz": 0}, 1.0
    )
    with pytest.raises(InputError, match="cannot be combined"):
        six_axes.solved(Constraints(inside=box, prior=prior))


@pytest.mark.parametrize("kind", ["binary.stl", "text.stl", "mesh.obj"])
def test_meshes_are_read_by_their_corners(kind: str, tmp_path: Path) -> None:
    path = tmp_path / kind
    if kind == "binary.stl":
        body = b"".join(struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in TRIANGLES)
        path.write_bytes(b"a tool".ljust(80, b"\0") + struct.pack("<I", len(TRIANGLES)) + body)
    elif kind == "text.stl":
        facets = "".join(
            "facet normal 0 0 1\n outer loop\n" + "".join(f"  vertex {x:e} {y:e} {z:e}\n" for x, y, z in triangle)
            + " endloop\nendfacet\n" for triangle in TRIANGLES
        )  # fmt: skip
        path.write_text(f"solid tool\n{facets}endsolid\n", encoding="utf-8")
    else:
        path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1 2 3\n", encoding="utf-8")
    np.testing.assert_allclose(
        np.array(read_volume(str(path)).quadratics[:3]), np.array(Volume.box(LOW, HIGH).quadratics), atol=1e-8
    )


def test_the_command_holds_the_tool_inside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A box that the truth is not in is an active constraint, told with its cost."""
    write_recording(static_poses(SpatialRig(), 24, seed=3), tmp_path / "poses.csv")
    out = tmp_path / "model.json"
    centre = np.array(SpatialRig().first_moment) / SpatialRig().mass
    box = ",".join(f"{end:.4f}" for middle in centre for end in (middle - 0.2, middle + 0.2))
    assert main(["fit", str(tmp_path / "poses.csv"), f"--inside={box}", "--out", str(out)]) == 0
    assert tw.load(out)["m"].value == pytest.approx(SpatialRig().mass, rel=0.01)
    capsys.readouterr()
    assert main(["fit", str(tmp_path / "poses.csv"), "--inside=-0.1,0.1,-0.1,0.1,-0.3,-0.2"]) == 0
    said = capsys.readouterr().out
    assert "mass inside the box x -0.1 to 0.1 m, y -0.1 to 0.1 m, z -0.3 to -0.2 m" in said
    assert "no mass inside has these moments: the volume is wrong" in said
