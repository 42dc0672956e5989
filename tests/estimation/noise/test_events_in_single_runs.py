"""Windows of a single run are judged by fits to the blocks outside: all at once as each by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.noise.events_in_single_runs import BlockAverages
from estimation.noise.transient_windows import inside
from estimation.parameter_layout import parameter_layout
from modeling.chain.model import planar

Array = NDArray[np.float64]

BLOCKS, CHANNELS = 60, 3
"""Blocks of each of two runs."""
UNKNOWNS = parameter_layout(planar(), ())
OWNER = np.repeat([0, 1], BLOCKS)


def averages(seed: int) -> BlockAverages:
    """Readings of two runs with a step, at a random regressor."""
    random = np.random.default_rng(seed)
    regressor = random.standard_normal((2 * BLOCKS, CHANNELS, UNKNOWNS.size))
    reading = regressor @ random.standard_normal(UNKNOWNS.size) + 0.1 * random.standard_normal((2 * BLOCKS, CHANNELS))
    reading[20:30] += 5.0
    return BlockAverages(reading, regressor, OWNER)


def one_by_one(blocks: BlockAverages, number: int, first: NDArray[np.intp], last: NDArray[np.intp]) -> Array:
    begin, own = number * BLOCKS, number == OWNER
    left_out = [inside([(begin + a, begin + b)], len(OWNER)) for a, b in zip(first, last, strict=True)]
    return np.array([(blocks.residual_without(window) / blocks.scale)[own] for window in left_out])


windows = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 20)), min_size=1, max_size=8)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), number=st.sampled_from([0, 1]), ends=windows)
def test_residuals_of_all_windows_are_those_of_a_fit_for_each(
    seed: int, number: int, ends: list[tuple[int, int]]
) -> None:
    blocks = averages(seed)
    first = np.array([begin for begin, _ in ends])
    last = first + np.array([length for _, length in ends])
    found, expected = blocks.scaled_residuals_without(number, first, last), one_by_one(blocks, number, first, last)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("excited_inside", [False, True])
def test_parameters_that_the_blocks_do_not_determine(excited_inside: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two collinear columns leave a fit's residual; a column of zeros outside a window is determined in it alone."""
    blocks = averages(0)
    blocks.regressor[:, :, 1] = 2 * blocks.regressor[:, :, 0]
    if excited_inside:
        blocks.regressor[:20, :, 2] = 0.0
        blocks.regressor[30:, :, 2] = 0.0
    first, last = np.array([20, 0]), np.array([30, 0])
    by_itself: list[Array] = []
    original = BlockAverages.residual_without

    def counted(own: BlockAverages, left_out: NDArray[np.bool_]) -> Array:
        by_itself.append(original(own, left_out))
        return by_itself[-1]

    monkeypatch.setattr(BlockAverages, "residual_without", counted)
    found = blocks.scaled_residuals_without(0, first, last)
    assert len(by_itself) == (2 if excited_inside else 0)
    outside = ~inside([(20, 30)], BLOCKS)
    expected = one_by_one(blocks, 0, first, last)
    np.testing.assert_allclose(found[0, outside], expected[0, outside], rtol=0, atol=1e-8 * np.abs(expected[0]).max())
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-8 * np.abs(expected[1]).max())


def test_nothing_to_fit_leaves_the_readings() -> None:
    blocks = averages(0)
    blocks.regressor[:] = 0.0
    found = blocks.scaled_residuals_without(1, np.array([3]), np.array([9]))
    np.testing.assert_allclose(found[0], (blocks.reading / blocks.scale)[OWNER == 1])
