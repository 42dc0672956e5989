"""The triangle of a tall matrix in blocks against Householder on the whole of it, and against exact sums."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import (
    SAMPLED_ROWS_PER_COLUMN,
    SAMPLES_PER_BLOCK,
    TallMatrix,
    tall_matrix_r_factor,
)

Array = NDArray[np.float64]


@dataclass(eq=False)
class Held(TallMatrix):
    """A matrix (n, w) that is there, and what was asked of it."""

    matrix: Array
    asked: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.samples, self.width = self.matrix.shape

    def rows(self, start: int, end: int, out: Array) -> None:
        self.asked.append((start, end))
        out[:] = self.matrix[start:end].T

    def at(self, index: NDArray[np.intp]) -> Array:
        return self.matrix[index].T


def noise(samples: int, width: int = 5) -> Array:
    return np.random.default_rng(samples).standard_normal((samples, width))


def conditioned(condition: float, samples: int = 20_000) -> Array:
    """Columns of unit length with that condition, and a reading that they explain but for a millionth."""
    columns = noise(samples, 4)
    columns[:, 3] = columns[:, 2] + columns[:, 3] / condition
    reading = columns @ [5.0, -3.0, 2.0, 4.0] + 1e-6 * noise(samples, 1)[:, 0]
    return np.column_stack([columns, reading])


def at_rest(samples: int = 30_000) -> Array:
    """A motion that comes only once, after a long rest: 40 samples of which few are looked at beforehand."""
    matrix = np.ones((samples, 4)) * [1.0, 3.0, 0.0, 2.0]
    matrix[-40:] += noise(40, 4)
    return matrix


CASES = {
    "well conditioned": noise(20_000),
    "condition 10, and a reading": conditioned(10),
    "condition 1e3": conditioned(1e3),
    "condition 1e6": conditioned(1e6),
    "very different lengths": noise(20_000) * [1e-12, 1.0, 1e9, 1e-3, 1e3],
    "a column of zeros": noise(20_000) * [1.0, 1.0, 0.0, 1.0, 1.0],
    "the same column twice": noise(20_000)[:, [0, 1, 0, 2, 3]],
    "a constant, and readings of it": np.column_stack([np.ones(20_000), 15 + 1e-9 * noise(20_000, 2)]),
    "at rest but once": at_rest(),
    "as many as are looked at": noise(5 * SAMPLED_ROWS_PER_COLUMN),
    "one block and one": noise(SAMPLES_PER_BLOCK + 1),
    "fewer samples than columns": noise(3),
}


@pytest.mark.parametrize("name", CASES)
def test_root_is_that_of_the_whole(name: str) -> None:
    """R of B scaled to columns of unit length has B's singular values to some eps of the largest, as Householder's
    has: the bound of a stable factorisation, for which no product B'B may have been trusted beyond its digits."""
    matrix = CASES[name]
    found = tall_matrix_r_factor(Held(matrix))
    assert found.shape == (matrix.shape[1],) * 2
    np.testing.assert_array_equal(np.tril(found, -1), 0.0)
    lengths = np.linalg.norm(matrix, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    count = min(matrix.shape)
    singular = np.linalg.svd(found / scale, compute_uv=False)
    np.testing.assert_allclose(singular[:count], np.linalg.svd(matrix / scale, compute_uv=False), atol=3e-14)
    # What is left of the last column when the others have explained what they can.
    left = np.linalg.lstsq(matrix[:, :-1] / scale[:-1], matrix[:, -1], rcond=1e-13)[1]
    if left.size and name != "at rest but once":
        assert abs(found[-1, -1]) == pytest.approx(np.sqrt(left[0]), rel=1e-6, abs=1e-13 * scale[-1])


def test_every_sample_is_taken_once() -> None:
    """Nothing is gone through twice where the samples looked at beforehand were like the rest."""
    held = Held(CASES["condition 1e6"])
    tall_matrix_r_factor(held)
    assert [start for start, _ in held.asked] == list(range(0, 20_000, SAMPLES_PER_BLOCK))
    assert [end for _, end in held.asked] == [*range(SAMPLES_PER_BLOCK, 20_000, SAMPLES_PER_BLOCK), 20_000]


def test_what_is_not_finite_is_not_hidden() -> None:
    for place in (0, 7_777, 19_999):
        matrix = noise(20_000)
        matrix[place, 2] = np.nan
        assert not np.isfinite(tall_matrix_r_factor(Held(matrix))).all()
    assert not np.isfinite(tall_matrix_r_factor(Held(np.full((10, 2), np.inf)))).all()
