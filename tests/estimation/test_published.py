"""The published tables that are run again: what the rows compute, and that the reruns are what is said of them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from benchmarks import published, published_runs
from benchmarks.published import NOISES, TOOLS, Tool, consistent, errors, ordinary_least_squares, rigid_wrench
from benchmarks.published_runs import CHAPTER, HERE, REMAINDER, ChapterRig, chapter_table
from tests.shared.places import AIS2202, DATA, needs

pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")

import pinocchio

Array = NDArray[np.float64]
COLUMNS = ["fx'", "fy'", "tau"]
RNG = np.random.default_rng(5)


def only(table: pd.DataFrame, **levels: str) -> pd.DataFrame:
    """The rows of a table whose index begins with these words."""
    flat = table.reset_index()
    for name, begin in levels.items():
        flat = flat[flat[name].str.startswith(begin)]
    assert len(flat)
    return flat


def random_tool() -> Array:
    """Ten parameters of nine masses."""
    masses, places = RNG.uniform(0.02, 0.2, 9), RNG.uniform(-0.12, 0.16, (9, 3))
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, places, strict=True))
    return np.concatenate([[masses.sum()], masses @ places, np.asarray(inertia)[published.TRIANGLE]])


def test_newton_and_euler_agree_with_pinocchio() -> None:
    """Its body regressor, of random motions: rounding alone."""
    true = random_tool()
    specific, omega, alpha = RNG.normal(size=(3, 5, 3))
    ours = rigid_wrench(true, specific, omega, alpha)
    order = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]  # its inertia by columns: xx, xy, yy, xz, yz, zz
    for row, s, w, a in zip(ours, specific, omega, alpha, strict=True):
        # Its acceleration is the spatial one: the body's own, at rest in the velocity (0, omega).
        phi = pinocchio.bodyRegressor(pinocchio.Motion(np.zeros(3), w), pinocchio.Motion(s, a))
        np.testing.assert_allclose(row, phi @ true[order], atol=1e-12)


def test_consistency_is_that_of_some_masses() -> None:
    """Nine masses are; with the smallest moment taken away none are."""
    true = random_tool()
    assert consistent(true)
    flat = true.copy()
    flat[[4, 7, 9]] -= 0.9 * true[[4, 7, 9]].max()
    assert not consistent(flat)


def test_errors_are_relative_to_a_box() -> None:
    """A box of 1 kg: a mass 1 % off, a centre off by a tenth of it along x, moments off by a half of the box's own."""
    extent = np.array([0.2, 0.1, 0.4])
    box = (extent @ extent * np.eye(3) - np.diag(extent**2)) / 12
    true = np.concatenate([[1.0], np.zeros(3), box[published.TRIANGLE]])
    off = true.copy()
    off[0], off[1] = 1.01, 1.01 * 0.02
    off[[4, 7, 9]] *= 1.5
    np.testing.assert_allclose(errors(off, true, extent), [1.0, 10 / 3, 50 / 2])


@needs(DATA / "workshop_tools")
def test_the_archive_has_gravity_up_and_the_stated_noise() -> None:
    """Least squares in that reading finds the mass; what is added makes the std that is stated."""
    tool = Tool("Hammer")
    estimate = ordinary_least_squares(tool.frame, NOISES["low"], None)
    assert abs(estimate[0] / tool.parameters[0] - 1) < 0.002
    noisier, channels = tool.noisier(NOISES["high"], np.random.default_rng(1)), list(published.CHANNELS)
    added = (noisier[channels] - tool.frame[channels]).std()
    own, high = NOISES["low"], NOISES["high"]
    assert added["fx"] == pytest.approx(np.sqrt(high.force**2 - own.force**2), rel=0.1)  # 1000 samples: 4 std
    assert added["tz"] == pytest.approx(np.sqrt(high.torque**2 - own.torque**2), rel=0.1)


def test_a_homogeneous_box_is_that_of_many_points() -> None:
    """A grid of n points a side has n² - 1 to n² of the box's own moments."""
    tool, count = Tool("Hammer"), 60
    axes = [low + (np.arange(count) + 0.5) / count * (high - low) for low, high in tool.box.T]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    inertia = np.mean(np.sum(points**2, axis=1)) * np.eye(3) - points.T @ points / len(points)
    expected = np.concatenate([[1.0], points.mean(axis=0), inertia[published.TRIANGLE]])
    np.testing.assert_allclose(tool.homogeneous(1.0), expected, rtol=1 / count**2, atol=1e-12)


@needs(DATA / "workshop_tools")
@pytest.mark.parametrize("name", TOOLS)
def test_every_tool_is_inside_its_box(name: str) -> None:
    """Second moments about the ends of the box, of each axis: sum (r - low) (high - r) dm is not negative."""
    (low, high), true = Tool(name).box, Tool(name).parameters
    inertia = published.symmetric(true[4:])
    second = np.diag(np.trace(inertia) / 2 * np.eye(3) - inertia)
    assert (low * true[0] <= true[1:4]).all()
    assert (true[1:4] <= high * true[0]).all()
    assert (-second + (low + high) * true[1:4] - low * high * true[0] >= 0).all()


@needs(DATA / "workshop_tools")
def test_a_row_of_the_tools() -> None:
    """One tool: ours consistent where it is asked for, and published rows as they stand."""
    table = published.tools_table(published.tool_errors(("Pliers",), ("high",)))
    assert only(table, by=HERE, way="fit --")["consistent"].tolist() == [100, 100, 100]
    theirs = only(table, by=published.NADEAU, way="HPS").iloc[0, 3:8]
    assert tuple(theirs) == published.PUBLISHED["high", "HPS"]


@needs(AIS2202)
def test_the_measured_tool_reproduces() -> None:
    """Their mass with their gravity to its digits; ours holds it within its interval, with either gravity."""
    table = published.rig_table()
    mass, _, _, z = published.SKREDE_ESTIMATE
    least = only(table, by=HERE, way="two ordinary least squares, g = 9.82085").iloc[0]
    assert (round(least["mass, kg"], 3), round(least["z, mm"])) == (mass, z)
    ours = only(table, by=HERE, way="fit")
    assert ((ours["mass, kg"] - mass).abs() < ours["± mass, kg"]).all()
    assert ((ours["z, mm"] - z).abs() < ours["± z, mm"]).all()


def test_the_regressor_is_that_of_the_rig() -> None:
    """22.8 explains a simulated rigid tool to the resolver's step, and a table without noise has no variance."""
    rig = ChapterRig.of()
    residual = rig.readings - rig.regressors @ np.array(published_runs.THETA)
    assert np.abs(residual).max() < 1e-3
    table = rig.table(np.zeros(3), np.random.default_rng(0))
    assert np.abs(table["variance of the average, S"]).max() < 1e-8


def test_table_of_the_chapter() -> None:
    """A rigid tool in white noise carries the table but the remainder in fx', and elastic joints that too."""
    table = chapter_table(("elastic joints",), draws=100)

    def deviation(row: str, way: str) -> Array:
        """Of the printed figures, in std of a simulated table."""
        printed = only(table, row=row, by=CHAPTER)[COLUMNS].to_numpy()[0]
        simulated = only(table, row=row, by=HERE, way=way)
        std = simulated[[f"± {name}" for name in COLUMNS]].to_numpy()[0]
        return np.asarray((printed - simulated[COLUMNS].to_numpy()[0]) / std)

    assert abs(deviation(REMAINDER, "rigid tool")[0]) > 3
    assert abs(deviation(REMAINDER, "rigid tool")[1]) < 3
    assert abs(deviation(REMAINDER, "elastic joints")).max() < 3
    for row in ("variance of single runs, mean of ten", "variance of single runs, std over ten"):
        assert abs(deviation(row, "rigid tool")).max() < 3
