"""Dual variables (D, c), and the dual function F that must not exceed k in any viable state."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import product
from math import prod
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from design.information import Experiment
from design.limits import require_zero_inside
from modeling import symbolic as sp
from modeling.compiled.symbolic_vector import casadi_expressions
from modeling.compiled.tape import Tape
from modeling.compiled.tape_evaluation import TapeEvaluation
from modeling.errors import InputError
from modeling.rig import Limits

Array = NDArray[np.float64]

# States from which an arm can keep its limits for ever (viability kernel).


@dataclass(frozen=True, eq=False)
class ViableStates:
    """States (q, dq, ddq), (3n,), of trajectories that have kept their limits before and can keep them ever after.

    Joint by joint, with the limits q_low <= q <= q_high and -b <= ddq <= a, both a and b positive. At the time t let
    v = dq > 0. Afterwards dq(t + s) >= v - b s, so that the joint moves v²/(2b) at least until it stops; before,
    dq(t - s) >= v - a s, so that it has moved v²/(2a) at least since it was last at rest. Both ends are within the
    limits: q + v²/(2b) <= q_high and q - v²/(2a) >= q_low. With v < 0 braking is by a and speeding up was by b:
    q - v²/(2a) >= q_low and q + v²/(2b) <= q_high. These are the same two conditions, so for either sign of dq

        q_low + dq²/(2a)  <=  q  <=  q_high - dq²/(2b).

    A periodic trajectory with continuous dq and ddq within its limits almost everywhere meets them at every instant,
    since dq has mean zero and so vanishes before and after. The two ends meet at the largest speed, `speeds`.

    Raises InputError unless velocity and acceleration of each joint may have both signs.
    """

    limits: Limits

    def __post_init__(self) -> None:
        require_zero_inside(self.limits)

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return self.limits.joints

    @cached_property
    def braking(self) -> tuple[Array, Array]:
        """1/(2a) and 1/(2b), each (n,): braking distance at the low and the high end of q over dq²."""
        low, high = self.limits.acceleration.T
        return 1 / (2 * high), -1 / (2 * low)

    @cached_property
    def speeds(self) -> Array:
        """(n, 2): the velocity limits, or the speed at which the two ends of q meet where that is less."""
        stop = np.sqrt(np.ptp(self.limits.position, axis=1) / sum(self.braking))
        low, high = self.limits.velocity.T
        return np.stack([np.maximum(low, -stop), np.minimum(high, stop)], axis=1)

    @cached_property
    def vertices(self) -> Array:
        """(2^n, n): the extreme accelerations."""
        return np.array(list(product(*self.limits.acceleration)))

    def ends(self, dq: Any) -> tuple[Any, Any]:
        """Low and high end of viable q at velocities dq: arrays (N, n), or CasADi columns (n,)."""
        below, above = self.braking
        low, high = self.limits.position.T
        return low + below * dq**2, high - above * dq**2

    def phase(self, point: Any) -> tuple[Any, Any]:
        """q and dq of a point of the cube [-1, 1]^2n, which is mapped onto all viable (q, dq).

        The second half of the point scales dq between `speeds`, the first q between `ends`; arrays (N, 2n), or a
        CasADi column (2n,).
        """
        n = self.joints
        position, rate = (point[:, :n], point[:, n:]) if isinstance(point, np.ndarray) else (point[:n], point[n:])
        middle, half = self.speeds.mean(axis=1), np.ptp(self.speeds, axis=1) / 2
        dq = middle + half * rate
        low, high = self.ends(dq)
        return low + (high - low) * (position + 1) / 2, dq

    def excess(self, q: Array, dq: Array, ddq: Array) -> Array:
        """(N,): largest violation by states, in shares of the limits' half widths; negative inside."""
        low, high = self.ends(dq)
        position = np.maximum(low - q, q - high) / (np.ptp(self.limits.position, axis=1) / 2)
        others = [_violation(dq, self.limits.velocity), _violation(ddq, self.limits.acceleration)]
        return np.asarray(np.max([position, *others], axis=(0, 2)), dtype=float)


def _violation(values: Array, pairs: Array) -> Array:
    """Excess (N, n) of values over [low, high] (n, 2), in half widths; negative inside."""
    low, high = pairs.T
    return np.asarray(np.maximum(low - values, values - high) / ((high - low) / 2))


# Sign symmetries of the information and of the viable states.


RANDOM_STATES = 64
"""Random states at which a symmetry is tested: enough for every entry of the information to be nonzero."""
SYMMETRY_TOLERANCE = 1e-9
"""Relative tolerance of the equality of two information matrices: rounding."""


class SignChange(Enum):
    """Signs of (q, dq, ddq): time reversal, or mirroring of the arm."""

    REVERSAL = (1, -1, 1)
    MIRROR = (-1, -1, -1)

    @property
    def parity(self) -> int:
        """The sign change of an h whose d/dt h is invariant."""
        return -1 if self is SignChange.REVERSAL else 1


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A sign change of the states, and the signs (k,) of the parameters under which the information is equivariant.

    With Phi'Phi(g x) = S Phi'Phi(x) S for the change g and S = diag(signs), a measure and its image have the same
    ln det, and their mean no smaller one: an optimal measure is invariant. So is the dual, D = S D S, and only h with
    invariant d/dt h are useful. A bound from such D and h is valid with or without the symmetry.
    """

    change: SignChange
    signs: Array


def symmetries(gram: Callable[[Array], Array], viable: ViableStates, seed: int) -> tuple[Symmetry, ...]:
    """The symmetries, found numerically at random states; `gram` gives Phi'Phi (N, k, k) of states (N, 3n)."""
    rng = np.random.default_rng(seed)
    q, dq = viable.phase(rng.uniform(-1, 1, (RANDOM_STATES, 2 * viable.joints)))
    states = np.hstack([q, dq, viable.vertices[rng.integers(len(viable.vertices), size=RANDOM_STATES)]])
    before = gram(states)
    sign_symmetries = []
    for change in SignChange:
        after = gram(states * np.repeat(change.value, viable.joints))
        signs = _signs(before, after)
        if signs is not None and _symmetric(viable, change):
            sign_symmetries.append(Symmetry(change, signs))
    return tuple(sign_symmetries)


def symmetrised_measure(states: Array, weights: Array, sign_symmetries: tuple[Symmetry, ...]) -> tuple[Array, Array]:
    """The measure on states (N, 3n) with weights (N,), half of it replaced by its image under each symmetry."""
    for symmetry in sign_symmetries:
        signs = np.repeat(symmetry.change.value, states.shape[1] // 3)
        states, weights = np.vstack([states, states * signs]), np.concatenate([weights, weights]) / 2
    return states, weights


def _symmetric(viable: ViableStates, change: SignChange) -> bool:
    """Whether the limits of the quantities that change sign are symmetric."""
    pairs = (viable.limits.position, viable.limits.velocity, viable.limits.acceleration)
    return all(s > 0 or np.allclose(p[:, 0], -p[:, 1]) for s, p in zip(change.value, pairs, strict=True))


def _signs(before: Array, after: Array) -> Array | None:
    """The signs s with after_ij = s_i s_j before_ij, the first parameter's and any free one +1; None without."""
    k = before.shape[1]
    product = np.einsum("nij,nij->ij", before, after)
    tolerance = SYMMETRY_TOLERANCE * np.einsum("nij,nij->ij", before, before)
    signs, determined = np.ones(k), {0}
    while len(determined) < k:
        linked = [
            (i, j) for i in determined for j in range(k) if j not in determined and abs(product[i, j]) > tolerance[i, j]
        ]
        i, j = linked[0] if linked else (0, next(j for j in range(k) if j not in determined))
        signs[j] = signs[i] * np.sign(product[i, j]) if linked else 1.0
        determined.add(j)
    error = np.abs(after - np.multiply.outer(signs, signs) * before).max()
    return signs if error <= SYMMETRY_TOLERANCE * np.abs(before).max() else None


# Linear conditions of periodicity: functions h(q, dq) whose time derivative has mean zero.


@dataclass(frozen=True, kw_only=True)
class PolynomialDegrees:
    """Largest total degree of the polynomials h: of one joint's q and dq, of two joints', of more joints'.

    0 leaves such h out. Time grows with the square of the number of conditions; none of them loosens the bound.
    """

    each: int = 8
    pair: int = 6
    more: int = 4

    def of(self, joints: int) -> int:
        """The largest degree of an h of this number of joints."""
        return (self.each, self.pair, self.more)[min(joints, 3) - 1]


@dataclass(frozen=True, eq=False, kw_only=True)
class PeriodicityConditions:
    """h = prod_j T_a(q_j) T_b(dq_j) with Chebyshev polynomials T of q and dq scaled to [-1, 1] by their limits.

    Along a trajectory d/dt h(q, dq) = sum_j (dh/dq_j dq_j + dh/ddq_j ddq_j), written L h; over a period it integrates
    to h(end) - h(start) = 0. `changes` are the symmetries of the problem: h for which L h changes sign under one of
    them have mean zero under every symmetric measure already, and are left out.
    """

    viable: ViableStates
    degrees: PolynomialDegrees
    changes: tuple[SignChange, ...] = ()

    @cached_property
    def exponents(self) -> tuple[tuple[int, ...], ...]:
        """The degrees of each h in (q_1 .. q_n, dq_1 .. dq_n)."""
        n, highest = self.viable.joints, max(self.degrees.each, self.degrees.pair, self.degrees.more)
        return tuple(e for e in _powers(2 * n, highest) if self._useful(np.array(e)))

    def _useful(self, powers: Any) -> bool:
        n = self.viable.joints
        q, dq = powers[:n], powers[n:]
        moving = np.count_nonzero(q + dq)
        if not 0 < powers.sum() <= self.degrees.of(int(moving) or 1):
            return False
        signs = {change: change.value[0] ** q.sum() * change.value[1] ** dq.sum() for change in self.changes}
        return all(sign == change.parity for change, sign in signs.items())

    def __len__(self) -> int:
        return len(self.exponents)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Such as "T2(q1) T1(dq3)"."""
        n = self.viable.joints
        symbols = [f"{order}{j}" for order in ("q", "dq") for j in range(1, n + 1)]
        return tuple(" ".join(f"T{d}({s})" for d, s in zip(e, symbols, strict=True) if d) for e in self.exponents)

    def graph(self, q: Any, dq: Any) -> Any:
        """All h as a CasADi column (K,) of q and dq, CasADi columns (n,)."""
        factors = [*_chebyshev(q, self.viable.limits.position, self._highest)]
        factors += _chebyshev(dq, self.viable.limits.velocity, self._highest)
        terms = [prod([f[d] for f, d in zip(factors, e, strict=True) if d], start=ca.SX(1)) for e in self.exponents]
        return ca.vertcat(ca.SX(0, 1), *terms)

    @property
    def _highest(self) -> int:
        return max((max(e) for e in self.exponents), default=0)


def _powers(variables: int, total: int) -> Iterator[tuple[int, ...]]:
    """All exponents of a number of variables up to a total degree."""
    if variables == 0:
        yield ()
        return
    for first in range(total + 1):
        yield from ((first, *rest) for rest in _powers(variables - 1, total - first))


def _chebyshev(values: Any, pairs: Any, degree: int) -> list[list[Any]]:
    """T_0 .. T_degree of each of the values (n,), scaled from [low, high] to [-1, 1]."""
    z = sp.Symbol("z", real=True)
    polynomials = [sp.horner(sp.chebyshevt_poly(d, z)) for d in range(degree + 1)]
    scaled = [(2 * values[j] - low - high) / (high - low) for j, (low, high) in enumerate(pairs)]
    return [casadi_expressions({z: value}, polynomials) for value in scaled]


@dataclass(frozen=True, eq=False)
class DualVariables:
    """The dual variables: D (k, k) positive definite, and c (K,) of the periodicity conditions."""

    D: Array
    c: Array

    @property
    def root(self) -> Array:
        """R (k, k) with D = R R'."""
        return np.asarray(np.linalg.cholesky(self.D))

    @property
    def stacked(self) -> Array:
        """The elements of R, column by column, then c."""
        return np.concatenate([self.root.ravel(order="F"), self.c])

    @property
    def value(self) -> float:
        """-ln det D."""
        return -float(np.linalg.slogdet(self.D)[1])

    def scaled(self, factor: float) -> DualVariables:
        """The dual variables whose F is `factor` times as large."""
        return DualVariables(self.D * factor, self.c * factor)


@dataclass(frozen=True, eq=False)
class DualFunction:
    """F(x) = tr(D Phi(x)'Phi(x)) + sum_i c_i (L h_i)(x) of states x = (q, dq, ddq), as compiled functions.

    Phi, the columns of the experiment, has to be affine in ddq. Then F is convex in ddq, since D is positive definite
    and L h is affine in it, and its largest value over a box of ddq is at one of the 2^n vertices.

    Raises InputError when the columns are not affine in ddq, or do not follow from the state alone.
    """

    experiment: Experiment
    conditions: PeriodicityConditions

    def __post_init__(self) -> None:
        state = ca.SX.sym("x", 3 * self.joints)
        if any(ca.which_depends(self._sample(state), state[2 * self.joints :], 2, False)):
            raise InputError(
                what="the columns of an effect are not affine in the accelerations",
                where="bound",
                remedy="take the bound of the model without that effect",
            )

    def __getstate__(self) -> dict[str, Any]:
        # CasADi's functions can be pickled for the workers of a pool, its symbols cannot.
        return {name: value for name, value in vars(self).items() if name != "_symbols"}

    @property
    def viable(self) -> ViableStates:
        """The viable states."""
        return self.conditions.viable

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return self.viable.joints

    @property
    def size(self) -> int:
        """The number of parameters k."""
        return self.experiment.size

    # ------------------------------------------------------------------------------------- numerically

    def moments(self, states: Array) -> tuple[Array, Array]:
        """Phi'Phi (N, k, k) and L h (N, K) in states (N, 3n)."""
        moments = self._moments.values(list(states.T))
        gram, rates = moments[: self.size**2], moments[self.size**2 :]
        return gram.T.reshape(-1, self.size, self.size), rates.T

    def values(self, points: Array, dual: DualVariables) -> Array:
        """F (N, 2^n) at points (N, 2n) of the cube and every vertex of ddq."""
        return self._vertex_evaluation.values(list(points.T), dual.stacked).T

    def value_and_gradient(self, points: Array, ddq: Array, dual: DualVariables) -> tuple[Array, Array]:
        """F (N,) and its derivative (N, 2n) by the points (N, 2n) of the cube, ddq (N, n) given."""
        value, *gradient = self._gradient_evaluation.values([*points.T, *ddq.T], dual.stacked)
        return value, np.stack(gradient, axis=1)

    def states(self, points: Array, ddq: Array) -> Array:
        """The states (N, 3n) of points of the cube with ddq (N, n)."""
        return np.hstack([*self.viable.phase(points), ddq])

    # ---------------------------------------------------------------------------------- compiled functions

    @cached_property
    def _vertex_evaluation(self) -> TapeEvaluation:
        """F at all vertices (2^n,) of ddq, in a point and (R, c)."""
        point, _, root, c = self._symbols
        parts = self._parts(*self.viable.phase(point), c)
        values = [_value(parts, vertex, root) for vertex in self.viable.vertices]
        return TapeEvaluation(Tape.of(point, ca.veccat(root, c), ca.vertcat(*values)))

    @cached_property
    def gradient(self) -> Any:
        """CasADi function of (point, ddq, R, c): F, and its gradient by the point (2n,)."""
        point, ddq, root, c = self._symbols
        value = _value(self._parts(*self.viable.phase(point), c), ddq, root)
        return _function([point, ddq, root, c], [value, ca.gradient(value, point)])

    @cached_property
    def _gradient_evaluation(self) -> TapeEvaluation:
        """F and its gradient, in (point, ddq) and (R, c)."""
        point, ddq, root, c = self._symbols
        return TapeEvaluation(
            Tape.of(ca.vertcat(point, ddq), ca.veccat(root, c), ca.vertcat(*self.gradient(point, ddq, root, c)))
        )

    @cached_property
    def _symbols(self) -> tuple[Any, Any, Any, Any]:
        n, k = self.joints, self.size
        sizes = {"u": (2 * n, 1), "a": (n, 1), "R": (k, k), "c": (len(self.conditions), 1)}
        point, ddq, root, c = (ca.SX.sym(name, *shape) for name, shape in sizes.items())
        return point, ddq, root, c

    @cached_property
    def _sample(self) -> Any:
        return self.experiment.sample()

    def _columns(self, q: Any, dq: Any, ddq: Any) -> Any:
        return ca.reshape(self._sample(ca.vertcat(q, dq, ddq)), -1, self.size)

    @cached_property
    def _parts(self) -> Any:
        """CasADi function of (q, dq, c): Phi at ddq = 0, its derivative by ddq, and of H = c'h: H_q dq and H_dq."""
        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        c = ca.SX.sym("c", len(self.conditions))
        columns, H = self._columns(q, dq, ddq), ca.dot(c, self.conditions.graph(q, dq))
        constant = ca.substitute(columns, ddq, ca.SX.zeros(self.joints))
        return _function(
            [q, dq, c], [constant, ca.jacobian(columns, ddq), ca.dot(ca.gradient(H, q), dq), ca.gradient(H, dq)]
        )

    @cached_property
    def _moments(self) -> TapeEvaluation:
        """Phi'Phi column by column, then L h, in a state."""
        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        columns = self._columns(q, dq, ddq)
        rates = ca.jtimes(self.conditions.graph(q, dq), ca.vertcat(q, dq), ca.vertcat(dq, ddq))
        results = ca.vertcat(ca.vec(columns.T @ columns), rates)
        return TapeEvaluation(Tape.of(ca.vertcat(q, dq, ddq), ca.SX(0, 1), results))


def _value(parts: Any, ddq: Any, root: Any) -> Any:
    """F from the parts of it that do not depend on ddq: |(Phi_0 + sum_j Phi_j ddq_j) R|² + H_q dq + H_dq ddq."""
    constant, slope, velocity_term, acceleration_slope = parts
    columns = constant + ca.reshape(slope @ ddq, *constant.shape)
    return ca.sumsqr(columns @ root) + velocity_term + ca.dot(acceleration_slope, ddq)


def _function(arguments: list[Any], results: list[Any]) -> Any:
    return ca.Function("dual", arguments, [ca.cse(ca.densify(r)) for r in results])
