"""Windows of a single run are judged by fits to the blocks outside: all at once as each by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.noise.disturbances.events_in_single_runs import BlockAverages
from estimation.noise.disturbances.transient_windows import inside
from estimation.parameter_layout import parameter_layout
from modeling.chain.model import planar

Array = NDArray[np.float64]

BLOCKS, CHANNELS = 60, 3
UNKNOWNS = parameter_layout(planar(), ())


def averages(seed: int) -> BlockAverages:
    """Readings with a step, at a random regressor."""
    random = np.random.default_rng(seed)
    regressor = random.standard_normal((BLOCKS, CHANNELS, UNKNOWNS.size))
    reading = regressor @ random.standard_normal(UNKNOWNS.size) + 0.1 * random.standard_normal((BLOCKS, CHANNELS))
    reading[20:30] += 5.0
    return BlockAverages(UNKNOWNS, reading, regressor, np.zeros(BLOCKS, dtype=np.intp), np.ones((1, CHANNELS)))


def one_by_one(blocks: BlockAverages, first: NDArray[np.intp], last: NDArray[np.intp]) -> Array:
    left_out = [inside([window], BLOCKS) for window in zip(first.tolist(), last.tolist(), strict=True)]
    return np.array([blocks.residual_without(window) / blocks.scale for window in left_out])


windows = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 20)), min_size=1, max_size=8)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), ends=windows)
def test_residuals_of_all_windows_are_those_of_a_fit_for_each(seed: int, ends: list[tuple[int, int]]) -> None:
    blocks = averages(seed)
    first = np.array([begin for begin, _ in ends])
    last = first + np.array([length for _, length in ends])
    found, expected = blocks.scaled_residuals_without(first, last), one_by_one(blocks, first, last)
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
    found = blocks.scaled_residuals_without(first, last)
    assert len(by_itself) == (2 if excited_inside else 0)
    outside = ~inside([(20, 30)], BLOCKS)
    expected = one_by_one(blocks, first, last)
    np.testing.assert_allclose(found[0, outside], expected[0, outside], rtol=0, atol=1e-8 * np.abs(expected[0]).max())
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-8 * np.abs(expected[1]).max())
