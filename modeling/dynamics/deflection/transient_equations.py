"""Linear equations of the states of second-order modes over a record, as one banded system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modeling.dynamics.deflection.transient_response import TransientResponse

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TransientEquations:
    """K_i q_i + C_i q_i' + M_i q_i'' = right_i at each sample i, for the response q of d modes to an input y.

    As q'' = (y - lag q' - q) / inertia, the input is y_i = E_i x_i + W_i^-1 right_i with the state x = (q, q') and
    W = M / inertia. Unknown are state and spline slope s of each sample; each step's state, the spline's equations and
    the start couple neighbours alone.

    response   the modes' response to a cubic-spline input
    by_state   E (n, d, 2 d)
    by_right   W^-1 (n, d, d)
    """

    response: TransientResponse
    by_state: Array
    by_right: Array

    @classmethod
    def of(cls, response: TransientResponse, stiffness: Array, damping: Array, mass: Array) -> TransientEquations:
        """With K, C and M (n, d, d) of n >= 4 samples. Raises LinAlgError where an M is singular."""
        weight = mass / response.inertias
        by_right = np.asarray(np.linalg.inv(weight), dtype=np.float64)
        own = np.concatenate([weight - stiffness, response.lag * weight - damping], axis=2)
        return cls(response, by_right @ own, by_right)

    @staticmethod
    def stored_numbers(count: int, modes: int) -> int:
        """Floats of the banded matrix of so many samples and modes."""
        return count * 3 * modes * _Blocks.rows(3 * modes)

    def inputs(self, rights: Array) -> Array:
        """The inputs y (k, d, n) for right sides (k, d, n). Raises LinAlgError where there is none."""
        from scipy.linalg.lapack import dgbsv

        known = np.asarray(np.einsum("nij,kjn->kni", self.by_right, rights))
        matrix, bands = self._matrix()
        sides = self._known_part(known).reshape(len(rights), -1)
        _, _, solved, failed = dgbsv(bands, bands, matrix, sides.T, overwrite_ab=True, overwrite_b=True)
        if failed:
            raise np.linalg.LinAlgError("singular equations of a transient")
        states = solved.T.reshape(len(rights), len(self.by_state), -1)[:, :, : self.by_state.shape[2]]
        return np.asarray(np.moveaxis(np.einsum("nij,knj->kni", self.by_state, states) + known, 2, 1))

    def _known_part(self, known: Array) -> Array:
        """Right sides (k, n, 3 d) of states and slopes, from the known part (k, n, d) of the inputs."""
        d = known.shape[2]
        before, after = self.response.gains[:, :d], self.response.gains[:, d : 2 * d]
        sides = np.empty((*known.shape[:2], 3 * d))
        sides[:, 0, :d], sides[:, 0, d : 2 * d] = known[:, 0], 0.0
        sides[:, 1:, : 2 * d] = known[:, :-1] @ before.T + known[:, 1:] @ after.T
        sides[:, 1:-1, 2 * d :] = 3 * (known[:, 2:] - known[:, :-2])
        sides[:, 0, 2 * d :] = 12 * (known[:, 1] - known[:, 0])
        sides[:, -1, 2 * d :] = 12 * (known[:, -1] - known[:, -2])
        return sides

    def _matrix(self) -> tuple[Array, int]:
        """Matrix in the band storage of `dgbsv`, and its number of bands on each side."""
        d = self.by_state.shape[1]
        blocks = _Blocks.empty(len(self.by_state), 3 * d)
        self._add_steps(blocks)
        self._add_slopes(blocks)
        return blocks.bands.reshape(-1, blocks.bands.shape[2]).T, blocks.width

    def _add_steps(self, blocks: _Blocks) -> None:
        """x_0 = (y_0, 0), and x_i = step x_{i-1} + gains (y_{i-1}, y_i, s_{i-1}, s_i)."""
        d, by_state = self.by_state.shape[1], self.by_state
        before, after, slope_before, slope_after = np.split(self.response.gains, 4, axis=1)
        start = np.eye(2 * d)
        start[:d] -= by_state[0]
        blocks.add(slice(0, 1), 0, (0, 0), start)
        blocks.add(slice(1, None), 0, (0, 0), np.eye(2 * d) - after @ by_state[1:])
        blocks.add(slice(1, None), 0, (0, 2 * d), -slope_after)
        blocks.add(slice(0, -1), 1, (0, 0), -self.response.step - before @ by_state[:-1])
        blocks.add(slice(0, -1), 1, (0, 2 * d), -slope_before)

    def _add_slopes(self, blocks: _Blocks) -> None:
        """Equations of the spline's slopes (`SplineSlopes`); at the ends six times the first less the second.

        That is 5 s_0 + 8 s_1 - s_2 = 12 (y_1 - y_0), and its mirror image.
        """
        last, by_state = len(self.by_state) - 1, self.by_state
        for offset, of_slope, of_input in ((-1, 1, -3), (0, 4, 0), (1, 1, 3)):
            inside = slice(1 - offset, last - offset)
            self._add_slope_terms(blocks, inside, offset, of_slope, of_input * by_state[inside])
        for end, side in ((0, 1), (last, -1)):
            for steps, of_slope, of_input in ((0, 5, 12), (1, 8, -12), (2, -1, 0)):
                place = slice(end + side * steps, end + side * steps + 1)
                self._add_slope_terms(blocks, place, -side * steps, of_slope, side * of_input * by_state[place])

    def _add_slope_terms(self, blocks: _Blocks, samples: slice, offset: int, of_slope: int, of_state: Array) -> None:
        """Terms of the slopes and states at `samples`, in the slope equations so many samples later."""
        d = self.by_state.shape[1]
        if of_state.any():
            blocks.add(samples, offset, (2 * d, 0), of_state)
        for mode in range(2 * d, 3 * d):
            blocks.add(samples, offset, (mode, mode), np.array([[of_slope]]))


@dataclass(frozen=True, eq=False)
class _Blocks:
    """A square matrix of (size, size) blocks, one row and column of them for each sample, in band storage.

    bands  (n, size, 3 width + 1): for each column its entries from `width` above to `width` below the diagonal, after
           `width` entries that the factorisation fills
    """

    bands: Array
    size: int
    width: int

    @classmethod
    def empty(cls, count: int, size: int) -> _Blocks:
        return cls(np.zeros((count, size, cls.rows(size))), size, 2 * size)

    @staticmethod
    def rows(size: int) -> int:
        """Rows of the band storage for blocks of this size, which are coupled with the next but one."""
        return 3 * 2 * size + 1

    def add(self, samples: slice, offset: int, corner: tuple[int, int], part: Array) -> None:
        """Add a part ((m,) rows, columns) of the blocks in the columns of `samples`, so many rows of blocks below.

        `corner` is its first row and column in the block; other entries of its rows' range are left.
        """
        row, column = corner
        for number in range(part.shape[-1]):
            first = 2 * self.width + offset * self.size + row - column - number
            self.bands[samples, column + number, first : first + part.shape[-2]] += part[..., number]
