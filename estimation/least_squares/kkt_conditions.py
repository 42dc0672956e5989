"""Karush-Kuhn-Tucker conditions at a point, with the multipliers that meet them best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constraints import FeasibleRegion, cvxpy, solve_conic
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum
from estimation.least_squares.prior import LogDetDivergence
from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.parameter_layout import ParameterLayout
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE, ScaledSVD

Array = NDArray[np.float64]


class LeastSquaresProblem(Protocol):
    """A least-squares problem that can be constrained; `Problem` is one."""

    @property
    def layout(self) -> ParameterLayout:
        """Its parameters."""

    def information(self, theta: Array, /) -> SquareRootInformation:
        """Square-root information of the whitened rows on a step from theta (k,)."""

    def minimise(self, start: Array, /) -> LeastSquaresMinimum:
        """The minimum within the parameters' own bounds alone."""


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """Chi-square and prior of theta + d, |R d - z|² + power to second order for a linearised prediction.

    theta  (k,)
    data   the rows of the recordings about theta
    whole  with those of the prior, where there is one and the tool is physically consistent
    """

    theta: Array
    data: SquareRootInformation
    whole: SquareRootInformation

    @classmethod
    def at(cls, problem: LeastSquaresProblem, theta: Array, prior: LogDetDivergence | None) -> Self:
        """The problem about theta."""
        data = problem.information(theta)
        if prior is None or not np.isfinite(prior.value(theta)):
            return cls(theta, data, data)
        return cls(theta, data, data + SquareRootInformation.of(*prior.rows(theta)))

    @property
    def cost(self) -> float:
        """The chi-square of the data at theta."""
        return self.data.cost

    @cached_property
    def scaled_svd(self) -> ScaledSVD:
        """Scaled SVD of the information of data and prior."""
        return ScaledSVD.of(self.whole.root, SINGULAR_VALUE_TOLERANCE)

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """(k,) which of the whitened parameters y are identifiable."""
        return self.scaled_svd.regular

    @cached_property
    def basis(self) -> Array:
        """B (k, k) of d = B y, with |R d - z|² = |y - reach|² + constant over the identifiable y."""
        scaled_svd = self.scaled_svd
        return np.asarray(
            scaled_svd.right.T / np.where(scaled_svd.regular, scaled_svd.singular, 1.0) / scaled_svd.scale[:, None]
        )

    @cached_property
    def reach(self) -> Array:
        """(k,) y of the quadratic model's unconstrained minimum, 0 along the null space."""
        return np.where(self.identifiable, self.scaled_svd.left.T @ self.whole.target, 0.0)

    @cached_property
    def spread(self) -> Array:
        """(k,) size of each parameter in y: its std, where it is identifiable."""
        return np.asarray(np.linalg.norm(self.basis, axis=1))


# Least squares within bounds and the cone of consistent tools: by CVXPY and Clarabel, within bounds alone by SciPy.


UNIDENTIFIABLE_DAMPING = 1e-6
"""Damping of the unidentifiable directions: too small to affect the identifiable ones."""
DISTANT_BOUND = 1e4
"""Distance in step lengths beyond which a bound is left out for conditioning; the next step has it."""
BVLS_TOLERANCE = 1e-14
"""Of `lsq_linear`, of problems of unit size: it then ends at the exact active set."""
BVLS_STEPS = 200
"""Most steps of `lsq_linear`; it takes about one for each active bound."""


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """Parameters (k,), multipliers of lower and upper bounds, (k,), in chi-square per unit, and of J, Z (n, n)."""

    theta: Array
    low: Array
    high: Array
    Z: Array


@dataclass(frozen=True, eq=False)
class ConeProgram:
    """Minimise |R d - z|² + prior + damping |y|² over the region, d = B y, B of the quadratic model.

    In y the chi-square has unit curvature. The program is in u = y / length, the objective divided by length², each
    bound by its parameter's std and the length, and J scaled to unit size: in any units and at any distance of the
    region, the solver gets numbers about 1.
    """

    local: QuadraticModel
    region: FeasibleRegion
    damping: float

    @cached_property
    def length(self) -> float:
        """Scale of the step in std: 1 plus the distances to the unconstrained minimum and to the region."""
        local, region = self.local, self.region
        beyond = np.maximum(region.low - local.theta, local.theta - region.high) / local.spread
        values, vectors = np.linalg.eigh(region.matrix(local.theta) / np.outer(*[inertia_scale(local, region)] * 2))
        inner = vectors / inertia_scale(local, region)[:, None]
        sizes = np.linalg.norm(np.einsum("na,knm,ma->ak", inner, region.slopes, inner) @ local.basis, axis=1)
        below = -values / np.where(sizes > 0, sizes, 1.0)
        return 1 + float(np.linalg.norm(local.reach)) + float(max(beyond.max(initial=0.0), below.max(initial=0.0)))

    @property
    def _whole(self) -> float:
        """Divisor of the objective."""
        return self.length**2 + (0.0 if self.region.prior is None else self.region.prior.weight)

    @property
    def _held(self) -> Array:
        """(k,) root of the damping of each whitened parameter."""
        return np.sqrt(self.damping + np.where(self.local.identifiable, 0.0, UNIDENTIFIABLE_DAMPING))

    def _objective(self, u: Any) -> Any:
        cp, local = cvxpy(), self.local
        squares = cp.sum_squares((local.data.root @ local.basis) @ u - local.data.target / self.length)
        objective = self.length**2 / self._whole * (squares + cp.sum_squares(cp.multiply(self._held, u)))
        prior = self.region.prior
        if prior is None:
            return objective
        X = self._moved(u, prior.inertia.at(local.theta), prior.inertia.slopes, prior.whitening)
        return objective + prior.weight / self._whole * (cp.trace(X) - cp.log_det(X))

    def _moved(self, u: Any, matrix: Array, slopes: Array, outer: Array) -> Any:
        """outer J(theta + B y) outer', symmetric, as a CVXPY expression."""
        n = len(matrix)
        turned = (outer @ slopes @ outer.T).reshape(len(slopes), -1).T @ self.local.basis * self.length
        return outer @ matrix @ outer.T + cvxpy().reshape(turned @ u, (n, n), order="C")

    def solve(self) -> ConeSolution | None:
        """The solution, None when the solver fails."""
        bounds_alone = self.region.inertia is None and self.region.prior is None
        return self._by_bvls() if bounds_alone else self._by_clarabel()

    def _by_bvls(self) -> ConeSolution | None:
        """Within bounds alone, by bounded-variable least squares (Stark and Parker 1995) on the parameters in std."""
        from scipy.optimize import lsq_linear  # slow to import and rarely needed

        local, region, free = self.local, self.region, ~self.region.fixed
        held = self._held[:, None] * np.linalg.inv(local.basis)
        rows = np.concatenate([local.data.root, held]) * local.spread
        low, high = ((end - local.theta) / local.spread for end in (region.low, region.high))
        x = np.where(free, 0.0, low)
        target = np.concatenate([local.data.target, np.zeros(len(held))]) - rows @ x
        solution = lsq_linear(
            rows[:, free], target, (low[free], high[free]), method="bvls", tol=BVLS_TOLERANCE, max_iter=BVLS_STEPS
        )
        if not solution.success:
            return None
        x[free] = solution.x
        theta = np.where(x <= low, region.low, np.where(x >= high, region.high, local.theta + local.spread * x))
        idle = np.zeros(len(theta))  # the active bounds are met exactly, and need no multiplier to be recognised
        return ConeSolution(theta, idle, idle, np.zeros((0, 0)))

    def _by_clarabel(self) -> ConeSolution | None:
        cp, local, region = cvxpy(), self.local, self.region
        u, unit = cp.Variable(len(local.theta)), local.spread * self.length
        slacks = np.array([local.theta - region.low, region.high - local.theta]) / unit
        side, index = np.nonzero(slacks < DISTANT_BOUND)
        inwards = np.where(side == 0, 1.0, -1.0) * self.length / unit[index]
        conditions: dict[str, Any] = {}
        if side.size:
            conditions["within"] = slacks[side, index] + (inwards[:, None] * local.basis[index]) @ u >= 0
        scale = inertia_scale(local, region, self.length)
        if scale.size:
            conditions["cone"] = self._moved(u, region.matrix(local.theta), region.slopes, np.diag(1 / scale)) >> 0
        if not solve_conic(cp.Problem(cp.Minimize(self._objective(u)), [*conditions.values()])):
            return None
        theta = np.clip(local.theta + local.basis @ u.value * self.length, region.low, region.high)
        multipliers = np.zeros_like(slacks)
        if side.size:
            multipliers[side, index] = self._whole * conditions["within"].dual_value / unit[index]
        Z = self._whole * conditions["cone"].dual_value / np.outer(scale, scale) if scale.size else np.zeros((0, 0))
        return ConeSolution(theta, multipliers[0], multipliers[1], Z)


def inertia_scale(local: QuadraticModel, region: FeasibleRegion, length: float = 1.0) -> Array:
    """Square roots (n,) of the size of J's diagonal: its value, or its change by `length` std of the parameters."""
    diagonal = np.abs(np.diag(region.matrix(local.theta)))
    shifts = length * np.linalg.norm(np.diagonal(region.slopes, axis1=1, axis2=2).T @ local.basis, axis=1)
    return np.asarray(np.sqrt(np.maximum(np.maximum(diagonal, shifts), 1e-300)))


# Active set at a point: bounds and zero eigenvalues of the pseudo-inertia, their normals and curvature.


BoolArray = NDArray[np.bool_]

ACTIVE_DISTANCE = 1e-6
"""Distance, in std, below which a solution of the cone program counts as on a constraint."""


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """The constraints held as equalities at the point of a quadratic model.

    low, high  (k,) active bounds; a fixed parameter is held at its lower one
    rank       number of eigenvalues of J held at zero
    solution   of the cone program that found this active set, if one did

    J is scaled to unit size, T J T with T diagonal. With the vectors v_a = T V_a of its `rank` smallest eigenvalues,
    J has that many zeros exactly when V'(TJT)V - V'(TJT)U (U'TJT U)^-1 U'(TJT)V = 0, U the other eigenvectors (Schur
    complement). At the point itself U'TJT V = 0, so that the first order of this is v_a' J v_b, and the second
    -v_a' dJ J^+ dJ v_b with J^+ = T U D^-1 U' T.
    """

    region: FeasibleRegion
    local: QuadraticModel
    low: BoolArray
    high: BoolArray
    rank: int = 0
    solution: ConeSolution | None = None

    @classmethod
    def touched(cls, region: FeasibleRegion, local: QuadraticModel) -> Self:
        """The bounds at which the point lies exactly."""
        return cls(region, local, local.theta <= region.low, (local.theta >= region.high) & ~region.fixed)

    @classmethod
    def of_solution(cls, region: FeasibleRegion, local: QuadraticModel, solution: ConeSolution) -> Self:
        """Active set of a cone program's solution: where, in std, the multiplier exceeds the slack."""
        spread, theta = local.spread, solution.theta
        low = _is_active((theta - region.low) / spread, solution.low * spread) | region.fixed
        high = _is_active((region.high - theta) / spread, solution.high * spread) & ~region.fixed
        full = cls(region, replace(local, theta=theta), low, high, len(solution.Z), solution)
        sizes = np.linalg.norm(full.forms @ local.basis, axis=1)
        sizes[sizes == 0] = 1.0
        dual = np.einsum("na,nm,ma->a", full.dual_vectors, solution.Z, full.dual_vectors)
        return replace(full, rank=int(_is_active(full.eigenvalues / sizes, dual * sizes).sum()))

    def at(self, local: QuadraticModel) -> ActiveSet:
        """The same constraints about another point."""
        return replace(self, local=local)

    @cached_property
    def scale(self) -> Array:
        """(n,) the diagonal of T^-1."""
        return inertia_scale(self.local, self.region)

    @cached_property
    def _eigen(self) -> tuple[Array, Array]:
        matrix = self.region.matrix(self.local.theta) / np.outer(self.scale, self.scale)
        values, vectors = np.linalg.eigh(matrix)
        return values, vectors

    @property
    def eigenvalues(self) -> Array:
        """(n,) of T J T, ascending."""
        return self._eigen[0]

    @property
    def null(self) -> Array:
        """(n, rank) vectors v whose v' J v is held at zero."""
        return self._eigen[1][:, : self.rank] / self.scale[:, None]

    @property
    def dual_vectors(self) -> Array:
        """(n, rank) T^-1 V: a multiplier Z of J has V_a' (T^-1 Z T^-1) V_b in the coordinates of T J T."""
        return self._eigen[1][:, : self.rank] * self.scale[:, None]

    @property
    def guess(self) -> Array:
        """(c,) multipliers of the normals from the cone program."""
        if self.solution is None:
            return np.zeros(len(self.normals))
        ends = [(self.solution.low if lower else self.solution.high)[i] for i, lower in self.ends]
        return np.concatenate([ends, svec(self.dual_vectors.T @ self.solution.Z @ self.dual_vectors)])

    @property
    def forms(self) -> Array:
        """(rank, k) derivative of each v_a' J v_a."""
        return np.asarray(np.einsum("na,knm,ma->ak", self.null, self.region.slopes, self.null))

    @property
    def ends(self) -> list[tuple[int, bool]]:
        """(index, lower) of each active bound, in the order of the normals."""
        return [(int(i), True) for i in np.flatnonzero(self.low)] + [(int(i), False) for i in np.flatnonzero(self.high)]

    @property
    def sign_free(self) -> BoolArray:
        """(c,) normals whose multiplier may have either sign: those of fixed parameters."""
        return np.array([self.region.fixed[i] for i, _ in self.ends] + [False] * svec_size(self.rank), dtype=bool)

    @cached_property
    def normals(self) -> Array:
        """(c, k) derivative of each constraint's value, positive inwards: the bounds, then svec(v' J v)."""
        k = len(self.low)
        ends = np.array([np.eye(k)[i] * (1 if lower else -1) for i, lower in self.ends]).reshape(-1, k)
        moments = self.null.T @ self.region.slopes @ self.null
        return np.concatenate([ends, np.array([svec(m) for m in moments]).reshape(k, -1).T])

    @cached_property
    def values(self) -> Array:
        """(c,) values of the constraints at the point, positive inside."""
        theta, region = self.local.theta, self.region
        ends = [theta[i] - region.low[i] if lower else region.high[i] - theta[i] for i, lower in self.ends]
        return np.concatenate([ends, svec(self.null.T @ region.matrix(theta) @ self.null)])

    def curvature(self, multiplier: Array) -> Array:
        """(n rank, k) rows F: |F d|² is the curvature term of the Lagrangian at a multiplier (rank, rank) of v' J v.

        Along the boundary of the cone v' J v grows by v' dJ J^+ dJ v, which adds tr(multiplier v' dJ J^+ dJ v).
        """
        values, vectors = np.linalg.eigh(multiplier)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        others = self._eigen[1][:, self.rank :] / np.sqrt(np.maximum(self.eigenvalues[self.rank :], 1e-300))
        rows = (others / self.scale[:, None]).T @ self.region.slopes @ self.null @ root
        return np.asarray(rows.reshape(len(self.low), -1).T)


def _is_active(slack: Array, multiplier: Array) -> BoolArray:
    return np.asarray((slack < ACTIVE_DISTANCE) | (slack < multiplier))


def svec_size(rank: int) -> int:
    """Entries of the `svec` of a symmetric matrix (rank, rank)."""
    return rank * (rank + 1) // 2


def svec(matrix: Array) -> Array:
    """The upper triangle (r (r + 1) / 2,) of a symmetric matrix, scaled to preserve inner products."""
    rows, columns = np.triu_indices(len(matrix))
    return np.asarray(matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


def smat(vector: Array, size: int) -> Array:
    """The symmetric matrix (size, size) of an `svec`."""
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = vector / np.where(rows == columns, 1.0, np.sqrt(2.0))
    return matrix + np.triu(matrix, 1).T


KKT_TOLERANCE = 2e-3
"""Slope of the chi-square, per std, below which a point is a minimum: a step from there gains less than 1e-6."""

FEASIBILITY_TOLERANCE = 1e-9
"""Largest admissible infeasibility: eigenvalues of J have a rounding of a few 1e-16 of its largest."""

ROUNDING_SHARE = 1e-9
"""Relative rounding of a gradient."""


@dataclass(frozen=True, eq=False)
class KKTConditions:
    """Lagrange multipliers of the active set at a point, and the residual of the KKT conditions.

    The gradient of chi-square and prior has to be the sum of the normals of the active constraints, each times a
    nonnegative multiplier (Z of J positive semidefinite), and the point feasible; inactive constraints have no
    multiplier, so that complementarity holds by construction.
    """

    active_set: ActiveSet

    @cached_property
    def gradient(self) -> Array:
        """(k,) of chi-square and prior in the parameters."""
        rows, targets = sum_of_squares(self.active_set)
        return np.asarray(-2 * rows.T @ targets)

    @cached_property
    def _whitened(self) -> tuple[Array, Array, Array]:
        """Per std: the gradient (k,), the active set's normals scaled to unit norm (k, c), and their norms (c,)."""
        active_set = self.active_set
        normals = active_set.normals @ active_set.local.basis
        lengths = np.linalg.norm(normals, axis=1)
        sizes = np.where(lengths > 0, lengths, 1.0)
        return active_set.local.basis.T @ self.gradient, (normals / sizes[:, None]).T, sizes

    @cached_property
    def unit_multipliers(self) -> Array:
        """Multipliers (c,) of the active set's unit normals, chi-square per std, that fit the gradient best.

        With dependent normals (a mass at 0 by its bound and by the pseudo-inertia) multipliers are not unique. The
        simplest sufficient set is used: the bounds alone, the pseudo-inertia alone, it with the bounds independent of
        it, all.
        """
        slope, columns, sizes = self._whitened
        is_bound = np.arange(len(sizes)) < len(self.active_set.ends)
        independent = is_bound & ~_in_span(columns, columns[:, ~is_bound])
        subsets = (is_bound, ~is_bound, ~is_bound | independent, np.ones_like(is_bound))
        candidates = [self._on_subset(used) for used in subsets]
        residuals = [float(np.linalg.norm(slope - columns @ c)) + self._most_negative(c) for c in candidates]
        sufficient = 2 * min(residuals) + self._rounding
        return next(c for c, residual in zip(candidates, residuals, strict=True) if residual <= sufficient)

    def _on_subset(self, used: BoolArray) -> Array:
        """Multipliers of a subset of the normals, with the signs that they must have.

        A simple zero of the pseudo-inertia has a scalar multiplier: bounded least squares. A multiple zero has a
        positive semidefinite matrix, which the gradient may not determine: the one nearest to the cone program's that
        balances the gradient.
        """
        slope, columns, sizes = self._whitened
        multipliers = np.zeros(len(used))
        if self.active_set.rank > 1 and used[len(self.active_set.ends) :].any():
            multipliers[used] = (self.active_set.guess * sizes)[used]
            multipliers[used] += np.linalg.lstsq(columns[:, used], slope - columns @ multipliers)[0]
        elif used.any():
            from scipy.optimize import lsq_linear  # slow to import and rarely needed

            low = np.where(self.active_set.sign_free[used], -np.inf, 0.0)
            bounds = (low, np.inf)
            multipliers[used] = lsq_linear(columns[:, used], slope, bounds, method="bvls", tol=BVLS_TOLERANCE).x
        return multipliers

    def _most_negative(self, unit_multipliers: Array) -> float:
        """Size of the most negative of the multipliers (c,) of the inequalities, chi-square per std.

        Scaling rows and columns of a matrix alike preserves its inertia (signs of the eigenvalues).
        """
        ends, rank, sizes = len(self.active_set.ends), self.active_set.rank, self._whitened[2]
        signed = unit_multipliers[:ends][~self.active_set.sign_free[:ends]]
        size = np.sqrt(np.diag(smat(sizes[ends:], rank)))
        inner = np.linalg.eigvalsh(smat((unit_multipliers / sizes)[ends:], rank) * np.outer(size, size))
        return -float(min(signed.min(initial=0.0), inner.min(initial=0.0)))

    @property
    def _rounding(self) -> float:
        return ROUNDING_SHARE * (1 + float(np.linalg.norm(self._whitened[0])))

    @property
    def multipliers(self) -> Array:
        """(c,) multipliers in the order of the active set's normals, chi-square per unit."""
        return self.unit_multipliers / self._whitened[2]

    @property
    def inner(self) -> Array:
        """(rank, rank) multiplier of v' J v."""
        return smat(self.multipliers[len(self.active_set.ends) :], self.active_set.rank)

    @property
    def Z(self) -> Array:
        """(n, n) multiplier of J."""
        return np.asarray(self.active_set.null @ self.inner @ self.active_set.null.T)

    def bound_multipliers(self, *, lower: bool) -> Array:
        """(k,) multipliers of the lower or of the upper bounds."""
        multipliers = np.zeros(len(self.active_set.low))
        for (index, is_lower), value in zip(self.active_set.ends, self.multipliers, strict=False):
            multipliers[index] += max(value if is_lower is lower else -value, 0.0)
        return multipliers

    @property
    def slope(self) -> float:
        """Norm of the gradient of the Lagrangian, chi-square per std."""
        gradient = self.gradient - self.active_set.normals.T @ self.multipliers
        return float(np.linalg.norm(self.active_set.local.basis.T @ gradient))

    @property
    def wrong_sign(self) -> float:
        """Dual infeasibility: size of the most negative multiplier of an inequality, chi-square per std."""
        return self._most_negative(self.unit_multipliers)

    @property
    def outside(self) -> float:
        """Primal infeasibility: of a bound in std, of J relative to its size."""
        active_set, region, theta = self.active_set, self.active_set.region, self.active_set.local.theta
        beyond = np.maximum(region.low - theta, theta - region.high) / active_set.local.spread
        return max(float(beyond.max(initial=0.0)), -float(active_set.eigenvalues.min(initial=0.0)))

    @property
    def gap(self) -> float:
        """Complementarity gap: multipliers times values of the active constraints, in chi-square."""
        return float(np.abs(self.multipliers) @ np.abs(self.active_set.values))

    @property
    def residual(self) -> float:
        """Residual of stationarity and complementarity, which Newton steps reduce, chi-square per std."""
        return self.slope + float(np.sqrt(self.gap))

    @property
    def exact(self) -> bool:
        """Whether the residual is only rounding."""
        return self.residual < self._rounding

    @property
    def met(self) -> bool:
        """Whether the point is the minimum within rounding and the tolerance of a refit."""
        return max(self.residual, self.wrong_sign) < KKT_TOLERANCE and self.outside < FEASIBILITY_TOLERANCE


def sum_of_squares(active_set: ActiveSet, curved: Array | None = None) -> tuple[Array, Array]:
    """F (m, k), e (m,): chi-square and prior are |F d - e|² about the point, to second order.

    With a multiplier `curved` of v' J v, the curvature of the cone's boundary is added.
    """
    rows, targets = active_set.local.whole.root, active_set.local.whole.target
    if curved is None or not active_set.rank:
        return rows, targets
    curvature = active_set.curvature(curved)
    return np.concatenate([rows, curvature]), np.concatenate([targets, np.zeros(len(curvature))])


def _in_span(columns: Array, span: Array) -> BoolArray:
    """Which unit columns lie in the span of other columns."""
    left, singular, _ = np.linalg.svd(span, full_matrices=False)
    basis = left[:, singular > SINGULAR_VALUE_TOLERANCE]
    return np.asarray(np.linalg.norm(columns - basis @ (basis.T @ columns), axis=0) < np.sqrt(SINGULAR_VALUE_TOLERANCE))
