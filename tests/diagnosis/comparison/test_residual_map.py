"""Residual maps: statistics of cells against a plain loop over cells and repeats."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from diagnosis.comparison.residual_map import CellStatistics


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), repeats=st.integers(1, 5), cells=st.integers(1, 8))
def test_statistics_of_cells_are_those_of_a_plain_loop(seed: int, repeats: int, cells: int) -> None:
    """Also of cells that one repeat alone visits, of empty ones, and of repeats that differ in their samples there."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    residual, series = rng.standard_normal((2, n))
    cell, repeat = rng.integers(cells, size=n), rng.integers(repeats, size=n)
    expected = []
    for number in range(cells):
        visits = [residual[(cell == number) & (repeat == r)] for r in range(repeats)]
        means = [visit.mean() for visit in visits if len(visit)]
        if len(means) >= 2:
            error = np.std(means, ddof=1) / np.sqrt(len(means))
            centre, samples = series[cell == number].mean(), (cell == number).sum()
            expected.append((centre, np.mean(means), error, len(means), samples))
    found = CellStatistics.of(residual, series, cell.astype(np.intp), repeat.astype(np.intp))
    rows = np.array([found.centre, found.mean, found.error, found.repeats, found.samples]).T
    np.testing.assert_allclose(rows, np.reshape(expected, (-1, 5)), rtol=1e-9, atol=1e-12)


def test_a_cell_visited_once_is_left_out() -> None:
    found = CellStatistics.of(
        np.array([1.0, 3.0, 7.0]), np.array([0.0, 0.2, 2.0]), np.array([0, 0, 2]), np.array([0, 1, 1])
    )
    np.testing.assert_allclose([*found.mean, *found.error, *found.centre], [2.0, 1.0, 0.1])
    assert (list(found.repeats), list(found.samples)) == ([2], [2])
