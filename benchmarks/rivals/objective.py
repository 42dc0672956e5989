"""Objective: ln det(Phi'Phi) and a penalty for broken limits, of the reference problem as fast as NumPy gives them.

What makes it fast is what a user who knows NumPy would do: positions, velocities and accelerations of all samples come
from one product with a basis made beforehand; several candidates go through together; of the regressor's entries each
is evaluated once, with subexpressions shared; and Phi'Phi is gathered from their products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt
import sympy as sp

from benchmarks.rivals.reference import ARM, LIMITS, SAMPLES
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.chain.model import planar
from modeling.chain.regressor import regressor
from modeling.compiled.symbolic_vector import numpy_function
from modeling.kinematics.arm import joint_symbols
from modeling.rig import Limits

Array = npt.NDArray[np.float64]

WEIGHT = 1e3
"""Of the penalty: of 10, 100 and 1000, and of five forms of penalty, the one with which the rivals come furthest."""
QUANTITIES = ("position", "velocity", "acceleration")
ENTRIES = len(planar().parameters)


@dataclass(frozen=True, eq=False)
class Score:
    """Of B candidates (B,): ln det(Phi'Phi) in SI units, the largest use of a limit at the samples, and the penalty."""

    logdet: Array
    use: Array
    penalty: Array

    @property
    def cost(self) -> Array:
        """What the rivals minimise."""
        return self.penalty - self.logdet


@cache
def derived() -> tuple[object, npt.NDArray[np.intp]]:
    """A function of the 9 states that returns the d regressor entries that vary, and where each entry of Phi is found.

    Places (p, k) count the varying entries, then 1 at d and 0 at d + 1: all that the planar regressor is made of.
    """
    pose = {sp.Symbol(name, real=True): expression for name, expression in ARM.kinematics.items()}
    phi = regressor(planar()).subs(pose)
    varying = list(dict.fromkeys(entry for entry in phi if entry.free_symbols))
    places = {entry: place for place, entry in enumerate([*varying, sp.S.One, sp.S.Zero])}
    states = [symbol for prefix in ("q", "dq", "ddq") for symbol in joint_symbols(ARM.joints, prefix)]
    index = np.array([places[entry] for entry in phi], dtype=np.intp).reshape(phi.shape)
    return numpy_function(states, varying), index


@cache
def gathered() -> npt.NDArray[np.intp]:
    """(p, k k): the places of Phi_ci and Phi_cj in the flat products of all entries with one another."""
    _, index = derived()
    width = index.max() + 1
    return np.asarray((index[:, :, None] * width + index[:, None, :]).reshape(len(index), -1))


def information(states: Array) -> Array:
    """Phi'Phi (B, k, k) of motions whose states q, dq, ddq are (9, N, B)."""
    function, index = derived()
    entries = np.zeros((index.max() + 1, *states.shape[1:]))
    entries[-2] = 1.0
    entries[:-2] = function(*states)  # type: ignore[operator]
    rows = entries.transpose(2, 0, 1)
    products = (rows @ rows.transpose(0, 2, 1)).reshape(len(rows), -1)
    return np.asarray(products[:, gathered()].sum(axis=1).reshape(-1, ENTRIES, ENTRIES))


@dataclass(frozen=True, eq=False)
class Objective:
    """The reference problem in the coefficients of a series, each scaled so that 1 alone reaches a limit.

    They are taken about the middle of the limits. Without that scaling every rival ends lower: an acceleration asks for
    coefficients that fall with h².
    """

    series: TrajectorySeries
    limits: Limits = LIMITS

    @cached_property
    def middle(self) -> Array:
        """(3, n): of each state's limits."""
        return np.stack([getattr(self.limits, name).mean(axis=1) for name in QUANTITIES])

    @cached_property
    def half(self) -> Array:
        """(3, n): half the width of each state's limits."""
        return np.stack([np.diff(getattr(self.limits, name), axis=1)[:, 0] / 2 for name in QUANTITIES])

    @cached_property
    def unit(self) -> Array:
        """(k,): the coefficients that alone reach a limit."""
        return np.asarray(1 / np.abs(self._uses).max(axis=0))

    @cached_property
    def _uses(self) -> Array:
        """(3 n N, k): what each coefficient adds to each state at each sample, in shares of its limit."""
        time = self.series.instants(SAMPLES)
        bases = [self.series.basis(time, order) / half[:, None] for order, half in enumerate(self.half)]
        return np.concatenate([basis.transpose(1, 0, 2).reshape(-1, self.series.size) for basis in bases])

    @cached_property
    def basis(self) -> Array:
        """(3 n N, k) in the scaled coefficients."""
        return np.ascontiguousarray(self._uses * self.unit)

    def score(self, x: Array) -> Score:
        """Of scaled coefficients (B, k); the penalty is the squared excess over a limit, summed over the samples."""
        uses = self.basis @ x.T
        states = uses.reshape(self.half.size, SAMPLES, -1) * self.half.reshape(-1, 1, 1) + self.middle.reshape(-1, 1, 1)
        uses = np.concatenate([uses, self.other_uses(states)])
        use = np.maximum(uses.max(axis=0), -uses.min(axis=0))
        penalty = np.zeros(len(x))
        if (broken := use > 1).any():
            excess = np.maximum(np.abs(uses[:, broken]) - 1, 0)
            penalty[broken] = WEIGHT * np.einsum("sb,sb->b", excess, excess)
        return Score(logdet=np.linalg.slogdet(self.information(states))[1], use=use, penalty=penalty)

    def information(self, states: Array) -> Array:
        """Phi'Phi (B, k, k) of states (3 n, N, B)."""
        return information(states)

    def other_uses(self, states: Array) -> Array:
        """(R, B): of states (3 n, N, B) from -1 to 1 within limits that are not of joints."""
        return np.zeros((0, states.shape[2]))

    def motion(self, x: Array) -> Trajectory:
        """Of scaled coefficients (k,)."""
        return Trajectory(self.series, self.series.rest(self.middle[0]) + x * self.unit)

    def start(self, seed: int | list[int]) -> Array:
        """Random scaled coefficients (k,) of a motion that uses four fifths of its limits."""
        draw = np.random.default_rng(seed).standard_normal(self.series.size)
        return np.asarray(0.8 * draw / self.score(draw[None]).use)
