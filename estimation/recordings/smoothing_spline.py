"""Smoothing spline: a motion as a random process in coloured measurement noise, both chosen by their likelihood.

With B-spline coefficients c on uniform knots, samples y_i = B(t_i) c + e_i and D the differences of order d,

    D c ~ N(0, s²/lambda),    e_i = rho e_(i-1) + white noise of variance s² (stationary),

which is the posterior mean of a d-fold integrated Wiener process as the knots become dense (Wahba, "Improper priors,
spline smoothing and the problem of guarding against model errors in regression", 1978; in this basis Eilers and Marx,
"Flexible smoothing with B-splines and penalties", 1996). The polynomials below degree d are free, so that there is no
end condition. Order, lambda and rho maximise the restricted likelihood, in which c is integrated out (Patterson and
Thompson, 1971), the polynomials with a flat prior per s, so that orders compare alike in any unit: a
band-limited motion takes a high order, one with jerks a low one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, solve_banded
from scipy.linalg.blas import dsbmv
from scipy.linalg.lapack import dpbtrf, dpbtrs, dtbtrs

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BSpline:
    """sum_j c_j B_j(x) with B-splines of one degree.

    `scipy.interpolate` has it too, but its import takes a sixth of a `diagnose` in the plane (28 November 2026).

    knots         (m + degree + 1,), ascending; the spline reaches from the first to the last, which may repeat
    coefficients  (m, k), of k series
    """

    knots: Array
    coefficients: Array
    degree: int

    def derivative(self) -> BSpline:
        """The spline of one degree less that is its slope: c'_j = d (c_j+1 - c_j) / (t_j+d+1 - t_j+1)."""
        widths = self.knots[self.degree + 1 : -1] - self.knots[1 : -self.degree - 1]
        slopes = self.degree * np.diff(self.coefficients, axis=0) / widths[:, None]
        return BSpline(self.knots[1:-1], slopes, self.degree - 1)

    def __call__(self, place: Array) -> Array:
        """Values (n, k) at places (n,)."""
        return weighted_sum(*basis_values(place, self.knots, self.degree), self.coefficients)


@dataclass(frozen=True, eq=False)
class BasisRows:
    """B-splines at some places, for a spline on their knots and its derivatives.

    first   (n,) index of the first nonzero one
    values  (degree + 1 - d, n) each, of the d-th derivative's degree, d = 0, 1, ..
    """

    first: NDArray[np.intp]
    values: tuple[Array, ...]

    @classmethod
    def of(cls, place: Array, knots: Array, degree: int, derivatives: int) -> BasisRows:
        """At places (n,), for so many derivatives."""
        first, values = _basis_of_degrees(place, knots, degree, degree - derivatives)
        return cls(first, tuple(values[::-1]))

    def derivatives(self, spline: BSpline) -> list[Array]:
        """Values (n, k) of a spline and of its derivatives."""
        values = [weighted_sum(self.first, self.values[0], spline.coefficients)]
        for basis in self.values[1:]:
            spline = spline.derivative()
            values.append(weighted_sum(self.first, basis, spline.coefficients))
        return values


def basis_matrix(place: Array, knots: Array, degree: int) -> Array:
    """Values (n, m) of the m B-splines on these knots at places (n,)."""
    first, basis = basis_values(place, knots, degree)
    matrix = np.zeros((len(place), len(knots) - degree - 1))
    matrix[np.arange(len(place))[:, None], first[:, None] + np.arange(degree + 1)] = basis.T
    return matrix


def basis_values(place: Array, knots: Array, degree: int) -> tuple[NDArray[np.intp], Array]:
    """The nonzero B-splines at each place: the first one's index (n,), and their values (degree + 1, n)."""
    first, values = _basis_of_degrees(place, knots, degree, degree)
    return first, values[0]


def _basis_of_degrees(place: Array, knots: Array, degree: int, lowest: int) -> tuple[NDArray[np.intp], list[Array]]:
    """Index (n,) of the first nonzero B-spline, and values (d + 1, n) of the nonzero ones of degrees d from `lowest`.

    By the recurrence of Cox and de Boor from degree to degree (Piegl and Tiller, The NURBS Book, A2.2). The index is
    that of a lower degree too, on knots less one at each end for each degree, which are those of the derivatives.
    """
    piece = np.clip(np.searchsorted(knots, place, side="right") - 1, degree, len(knots) - degree - 2)
    steps = np.arange(degree)[:, None]
    after, before = knots[piece + 1 + steps] - place, place - knots[piece - steps]
    values = [np.ones((1, len(place)))]
    for order in range(degree):
        left, right = after[: order + 1], before[order::-1]
        share = values[-1] / (left + right)
        basis = np.zeros((order + 2, len(place)))
        basis[:-1] = left * share
        basis[1:] += right * share
        values.append(basis)
    return piece - degree, values[lowest:]


def weighted_sum(first: NDArray[np.intp], basis: Array, coefficients: Array) -> Array:
    """B c (n, k) of coefficients (m, k), B as `basis_values` gives it."""
    total, summand = np.zeros((2, len(first), coefficients.shape[1]))
    for j, values in enumerate(basis):
        np.take(coefficients, first + j, axis=0, out=summand, mode="clip")  # with another mode NumPy copies
        summand *= values[:, None]
        total += summand
    return total


def transposed_sum(first: NDArray[np.intp], basis: Array, values: Array, count: int) -> Array:
    """B' v (count, k)."""
    products = np.zeros((count, values.shape[1]))
    for j, weights in enumerate(basis):
        for column, series in enumerate(values.T):
            products[:, column] += np.bincount(first + j, weights * series, minlength=count)
    return products


DEGREE = 7
"""Of the splines: the acceleration of interpolated samples errs little up to near half their rate."""
ORDERS = (4, 5, 6, 7, 8)
"""From a continuous jerk on, which drives and controllers leave."""
CORRELATIONS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Of neighbouring samples' noise."""
FIRST_ORDER = 4
GRID_STEP = 6.0
LOG_PENALTIES = np.arange(-36.0, 61.0, GRID_STEP)
"""Grid of ln lambda, and its limits."""
INTERPOLATION = -20.0
"""ln lambda below which the samples hold nothing but motion, and the cutoff is above half their rate."""
SCORE_ERROR, MAX_PASSES = 0.01, 6
"""Of the score, by rounding in a solution's last change: it is refined again above it; that often at most."""
LARGEST_ROUNDING = 0.1
"""Of lambda P, over a sample's part of G: refinement converges by this factor."""
BETTER_SCORE = 20.0
"""Of -2 ln likelihood: more than the knots' own share of it differs between two bases."""
FIRST_STEP, LAST_STEP = 2.0, 0.5
"""Of ln lambda: half a step more changes no estimate by a tenth of its std."""
ROUNDING_UNIT = float(np.finfo(float).eps)
ROUNDING = 64 * ROUNDING_UNIT
"""Of the largest sample: std of the sums over the splines, below which nothing is motion."""
KNOTS_PER_SAMPLE = 2
"""At most: the motion between samples is open then, and its uncertainty not understated."""
TIMES_AT_ONCE = 16
"""Whose std is computed together: so many series of memory, and few calls."""
FEWEST_PIECES = 512
"""Knot intervals at the start, where the samples allow them; they are doubled until they are enough."""
PIECES_PER_FREEDOM = 3.0
"""Knot intervals per effective parameter from which more knots change nothing."""


@dataclass(frozen=True, kw_only=True)
class Smoothness:
    """Order d, ln lambda and correlation rho of neighbouring samples' noise, as the module's docstring has them."""

    order: int
    log_penalty: float
    correlation: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothingSpline:
    """The smoothing spline of series and its uncertainty.

    spline       over places in knot intervals
    scale        knot intervals per s
    start        s, of the first knot
    smoothness   order, penalty, correlation of the noise
    variance     s² of the white part of the noise, per sample
    freedom      effective number of parameters
    score        -2 ln of the restricted likelihood
    samples      number of samples of a series
    factor       banded Cholesky factor of the coefficients' inverse covariance times s²
    """

    spline: BSpline
    scale: float
    start: float
    smoothness: Smoothness
    variance: float
    freedom: float
    score: float
    samples: int
    factor: Array

    @classmethod
    def of(cls, times: Array, series: Array) -> SmoothingSpline:
        """Of series (n, k) at increasing times (n,), s; they share smoothness and noise, as components of a vector do.

        The result is that of the vector in any other frame, then.
        """
        most = KNOTS_PER_SAMPLE * (len(times) - 1)
        pieces = min(max(FEWEST_PIECES, len(times) // 16), most)
        problem = _Problem.of(times, series, pieces)
        while True:
            first = problem.from_grid(Smoothness(order=FIRST_ORDER, log_penalty=0.0))
            finer = None if pieces == most else _Problem.of(times, series, min(2 * pieces, most))
            if finer is None or not problem.is_too_coarse(first, finer):
                likeliest = problem.likeliest(first)
                if finer is None or not problem.is_too_coarse(likeliest, finer):
                    return problem.spline(likeliest)
            pieces, problem = min(2 * pieces, most), finer

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return self.start + (len(self.spline.coefficients) - DEGREE) / self.scale

    @property
    def cutoff(self) -> float:
        """Hz where prior and data weigh the same, lambda w^2d = samples per knot; at most half the sampling rate."""
        per_knot = math.log(self.samples / len(self.spline.coefficients))
        rate = math.exp((per_knot - self.smoothness.log_penalty) / (2 * self.smoothness.order))
        return min(rate * self.scale / (2 * math.pi), self.half_rate)

    @property
    def half_rate(self) -> float:
        """Half the mean rate of the samples, Hz."""
        return (self.samples - 1) * self.scale / (2 * (len(self.spline.coefficients) - DEGREE))

    @property
    def noise_std(self) -> float:
        """Std of one sample of the measurement noise, in the series' unit."""
        return math.sqrt(self.variance / (1 - self.smoothness.correlation**2))

    def derivative(self, times: Array, order: int) -> Array:
        """The derivative of an order (n, k) at times (n,), s, per s^order."""
        spline = self.spline
        for _ in range(order):
            spline = spline.derivative()
        return spline((times - self.start) * self.scale) * self.scale**order

    def rows(self, times: Array, derivatives: int) -> BasisRows:
        """B-splines at times (n,), s, for so many derivatives of this spline and of others `drawn` from it."""
        return BasisRows.of((times - self.start) * self.scale, self.spline.knots, DEGREE, derivatives)

    def derivatives(self, rows: BasisRows) -> list[Array]:
        """Values (n, k) and derivatives, per s^order, where `rows` are."""
        return [values * self.scale**order for order, values in enumerate(rows.derivatives(self.spline))]

    def with_samples_every(self, step: float) -> Self:
        """The same spline of samples `step` s apart that are taken to be one second apart here."""
        return replace(self, scale=self.scale / step, start=self.start * step)

    def innovations(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """What a spline at random is `drawn` with: of the coefficients (m, k), and of the jerks (m - d, k)."""
        count, width = self.spline.coefficients.shape
        return rng.standard_normal((count, width)), rng.standard_normal((count - self.smoothness.order, width))

    def drawn(self, *innovations: tuple[Array, Array]) -> Self:
        """Splines at random from what the samples leave open, one for each of the `innovations`, side by side.

        The covariance of its coefficients is s² (G + lambda P)^-1, where the motion is as rough as everywhere. A move
        from rest to rest has jerks at its ends, which the smoothing flattens: to the prior's part of the error,
        lambda (G + lambda P)^-1 D' w with w of variance s²/lambda, is added what w is rougher there than on average.
        """
        white, jerks = (np.concatenate(each, axis=1) for each in zip(*innovations, strict=True))
        bands, count = len(self.factor), len(white)
        upper = np.zeros_like(self.factor)  # the factor's transpose, as `solve_banded` takes it
        for offset, diagonal in enumerate(self.factor):
            upper[bands - 1 - offset, offset:] = diagonal[: count - offset]
        error = solve_banded((0, bands - 1), upper, white)
        penalty = math.exp(self.smoothness.log_penalty)
        jerks *= math.sqrt(penalty) * self._excess_roughness[:, None]
        error += cho_solve_banded((self.factor, True), _transposed_differences(jerks, self.smoothness.order))
        coefficients = np.tile(self.spline.coefficients, len(innovations)) + math.sqrt(self.variance) * error
        return replace(self, spline=replace(self.spline, coefficients=coefficients))

    @cached_property
    def _excess_roughness(self) -> Array:
        """Std (m - d,) of what the differences are rougher than everywhere, over that of the prior.

        The squares of the differences of the posterior mean, over one effective parameter, against their average.
        """
        coefficients, order = self.spline.coefficients, self.smoothness.order
        power = (np.diff(coefficients, order, axis=0) ** 2).mean(axis=1)
        width = math.ceil(len(coefficients) / self.freedom)
        local = np.convolve(power, np.full(width, 1 / width), mode="same")
        return np.asarray(np.sqrt(np.maximum(local / max(power.mean(), np.finfo(float).tiny) - 1, 0.0)))

    def std(self, times: Array, order: int) -> Array:
        """Std (n,) of the error of a component's derivative at times (n,), s, per s^order.

        A derivative w'c of the coefficients c has the variance s² |L^-1 w|² with their Cholesky factor L. Solved for
        few times at once, as each takes as much memory as a series; by the band of the inverse, which would take less
        time for many, half the digits of the higher derivatives are lost where the motion is smooth.
        """
        rows = self.rows(times, order)
        weights = rows.values[order]
        for _ in range(order):  # of the slope's coefficients, c_j+1 - c_j as the knots are one apart
            weights = np.pad(weights, ((1, 0), (0, 0))) - np.pad(weights, ((0, 1), (0, 0)))
        variance = np.empty(len(times))
        for begin in range(0, len(times), TIMES_AT_ONCE):
            at = slice(begin, begin + TIMES_AT_ONCE)
            first = rows.first[at]
            right = np.zeros((self.factor.shape[1], len(first)), order="F")
            right[first + np.arange(DEGREE + 1)[:, None], np.arange(len(first))] = weights[:, at]
            variance[at] = np.sum(dtbtrs(self.factor, right, uplo="L", overwrite_b=1)[0] ** 2, axis=0)
        return np.asarray(np.sqrt(self.variance * variance) * self.scale**order)


@dataclass(frozen=True, eq=False)
class _Solution:
    """Of one smoothness: sum of squares, coefficients (m, k) and banded Cholesky factor.

    bent   the differences' share of the sum of squares
    step   coefficients less the problem's first ones, (m, k)
    moved  G times it
    """

    squares: float
    bent: float
    smoothness: Smoothness
    coefficients: Array
    factor: Array
    step: Array
    moved: Array


@dataclass(frozen=True, eq=False)
class _Problem:
    """Normal equations of one basis for every smoothness; symmetric banded matrices in lower storage.

    series  less their `offset`s (k,), the means, which are as free as all polynomials and would only cost digits
    """

    times: Array
    series: Array
    offset: Array
    place: Array
    knots: Array
    first: NDArray[np.intp]
    basis: Array
    products: tuple[Array, Array, Array]

    @classmethod
    def of(cls, times: Array, series: Array, pieces: int) -> _Problem:
        place = (times - times[0]) * (pieces / (times[-1] - times[0]))
        knots = np.arange(-DEGREE, pieces + DEGREE + 1, dtype=float)
        first, basis = basis_values(place, knots, DEGREE)
        offset = series.mean(axis=0)
        return cls(times, series - offset, offset, place, knots, first, basis, _products(first, basis, pieces + DEGREE))

    @property
    def count(self) -> int:
        """Number of coefficients of one series."""
        return len(self.knots) - DEGREE - 1

    def is_too_coarse(self, best: Smoothness, finer: _Problem) -> bool:
        """Whether the smoothness found needs more knots, or more knots find a motion where these found noise."""
        if self.freedom(best) * PIECES_PER_FREEDOM >= self.count:
            return True
        same = best.log_penalty + (2 * best.order - 1) * math.log(finer.count / self.count)
        rougher = [smoothness for smoothness in _grid(best) if smoothness.log_penalty <= same + GRID_STEP]
        return min(map(finer.score, rougher)) < self.score(best) - BETTER_SCORE

    def likeliest(self, first: Smoothness) -> Smoothness:
        """The smoothness of largest restricted likelihood, from a first one: order, then correlation, then order."""
        ordered = self._climbed(first, self._next_orders)
        coloured = self._climbed(ordered, self._next_correlations)
        return self._climbed(coloured, self._next_orders) if coloured.correlation else coloured

    def from_grid(self, candidate: Smoothness) -> Smoothness:
        """The best penalty of an order and a correlation: from the best of a grid, since there may be two minima.

        One is that of noise, the other that of interpolation, where the samples hold nothing but motion.
        """
        return self._with_best_penalty(min(_grid(candidate), key=self.score))

    def _climbed(self, best: Smoothness, neighbours: Callable[[Smoothness], list[Smoothness]]) -> Smoothness:
        """Goes to the best neighbour as long as that is better."""
        while candidates := neighbours(best):
            better = min(map(self._with_best_penalty, candidates), key=self.score)
            if self.score(better) >= self.score(best):
                break
            best = better
        return best

    def _next_orders(self, at: Smoothness) -> list[Smoothness]:
        """Neighbouring orders with the same cutoff w: lambda w^2d = n / m."""
        density = math.log(len(self.times) / self.count)
        orders = [d for d in (at.order - 1, at.order + 1) if d in ORDERS]
        if at.log_penalty <= INTERPOLATION:
            return [self.from_grid(replace(at, order=d)) for d in orders]
        return [replace(at, order=d, log_penalty=density + d / at.order * (at.log_penalty - density)) for d in orders]

    def _next_correlations(self, at: Smoothness) -> list[Smoothness]:
        if np.diff(self.first).max() > KNOTS_PER_SAMPLE:
            return []  # samples too far apart for the bands, and with them for a correlation
        place = CORRELATIONS.index(at.correlation) + 1
        return [replace(at, correlation=rho) for rho in CORRELATIONS[place : place + 1]]

    def _with_best_penalty(self, candidate: Smoothness) -> Smoothness:
        """The minimum of the score over the penalty that is downhill from a candidate, where its slope is zero."""
        tried = [candidate]
        below, above = (-math.inf, 0.0), (math.inf, 0.0)
        lowest, highest = LOG_PENALTIES[0], LOG_PENALTIES[-1]
        step = FIRST_STEP
        while True:
            at, slope = tried[-1].log_penalty, self._slope(tried[-1])
            if slope < 0:
                below = (at, slope)
            else:
                above = (at, slope)
            width = above[0] - below[0]
            if math.isinf(width):
                following = at + math.copysign(step, -slope)
                step *= 2
            else:
                share = below[1] / (below[1] - above[1]) if math.isfinite(above[1]) else 0.5
                following = below[0] + width * min(max(share, 0.1), 0.9)
            following = min(max(following, lowest), highest)
            if following != at:
                tried.append(replace(candidate, log_penalty=float(following)))
            if abs(following - at) < LAST_STEP:
                return min(tried, key=self.score)

    def _slope(self, smoothness: Smoothness) -> float:
        """d score / d ln lambda: only the sum of squares and the determinant depend on it; infinite without a score."""
        if math.isinf(self.score(smoothness)):
            return math.inf
        order, width = smoothness.order, self.series.shape[1]
        fit = self.series.size * self._bent[smoothness]
        return float(fit - width * (self.freedom(smoothness) - order))

    @cached_property
    def _bent(self) -> dict[Smoothness, float]:
        """The differences' share of the sum of squares, of each smoothness that has a score; 0 below rounding."""
        return {}

    def score(self, smoothness: Smoothness) -> float:
        """-2 ln of the restricted likelihood, computed once, from the best solution until then."""
        if smoothness not in self._scores:
            try:
                solution = self.solution(smoothness, self._best[-1] if self._best else None)
            except np.linalg.LinAlgError:
                self._scores[smoothness] = math.inf
                return math.inf
            score = self._scores[smoothness] = self._score(solution)
            resolved = solution.squares > self.series.size * self._rounding
            self._bent[smoothness] = solution.bent if resolved else 0.0
            if not self._best or score <= self._scores[self._best[-1].smoothness]:
                self._best[:] = [solution]
        return self._scores[smoothness]

    @cached_property
    def _best(self) -> list[_Solution]:
        """The solution with the best score so far, if there is one."""
        return []

    @cached_property
    def _scores(self) -> dict[Smoothness, float]:
        return {}

    def solution(self, smoothness: Smoothness, near: _Solution | None = None) -> _Solution:
        """The solution, by iterative refinement of another one, `near` or the start.

        Counted from a first solution c0 that follows the samples closely, c = c0 + x, so that residuals are small: with
        v = B' R (y - B c0), (G + lambda P) x = v - lambda P c0. No step but the first solution is over all samples. The
        sum of squares is least at the solution, so that an error of x, by rounding in its last change, enters squared:
        by the largest eigenvalues of the matrix, or by its smallest ones, about lambda.
        """
        penalty, rho, order = math.exp(smoothness.log_penalty), smoothness.correlation, smoothness.order
        largest = penalty * 4**order
        if ROUNDING_UNIT * largest > LARGEST_ROUNDING:
            raise np.linalg.LinAlgError("the penalty's rounding hides the samples")
        origin, products, _ = self._near_interpolation(rho)
        gram, factor = self._gram(rho), self._factor(smoothness)
        self._log_determinants[smoothness] = _log_determinant(factor)
        step = np.zeros_like(origin) if near is None else near.step
        moved = near.moved if near is not None and near.smoothness.correlation == rho else _banded_product(gram, step)
        solution = None
        for _ in range(MAX_PASSES):
            bent = _transposed_differences(np.diff(origin + step, order, axis=0), order)  # P c, well rounded
            change = _solved(factor, products - moved - penalty * bent)
            step = step + change
            moved = _banded_product(gram, step)
            squares, share = self._squares(smoothness, step, moved)
            if solution is not None and squares >= solution.squares:
                break
            solution = _Solution(squares, share, smoothness, origin + step, factor, step, moved)
            error = (ROUNDING_UNIT * float(np.linalg.norm(change))) ** 2 * (largest**2 + 1 / penalty)
            if self.series.size * error <= SCORE_ERROR * squares:
                break
        assert solution is not None
        return solution

    def _squares(self, smoothness: Smoothness, step: Array, moved: Array) -> tuple[float, float]:
        """The sum of squares, and the differences' share of it; the residual's part is that of c0 - 2 x'v + x'Gx.

        Raises LinAlgError where it is not finite.
        """
        origin, products, squares = self._near_interpolation(smoothness.correlation)
        differences = np.diff(origin + step, smoothness.order, axis=0)
        bent = math.exp(smoothness.log_penalty) * float(np.sum(differences**2))
        total = max(squares + float(np.sum(step * (moved - 2 * products))), 0.0) + bent
        if not math.isfinite(total):
            raise np.linalg.LinAlgError("the solution diverges")
        return total, bent / max(total, float(np.finfo(float).tiny))

    def _variance(self, solution: _Solution) -> float:
        """Of the white part of the noise."""
        return max(solution.squares / self.series.size, self._rounding)

    def _score(self, solution: _Solution) -> float:
        width, smoothness = self.series.shape[1], solution.smoothness
        rho, order = smoothness.correlation, smoothness.order
        volume = self._log_determinant(smoothness) - (self.count - order) * smoothness.log_penalty
        volume -= _log_determinant_of_differences(self.count, order) + self._log_polynomial_information(rho, order)
        fit = self.series.size * math.log(self._variance(solution))
        return float(fit + width * (volume - math.log(1 - rho**2)))

    @cached_property
    def _rounding(self) -> float:
        """Variance below which nothing is motion."""
        return (ROUNDING * float(np.abs(self.series + self.offset).max())) ** 2 + float(np.finfo(float).tiny)

    def _near_interpolation(self, rho: float) -> tuple[Array, Array, float]:
        """Coefficients c0 (m, k) with the least penalty; B' R r (m, k) and r' R r of their residual r."""
        if rho not in self._starts:
            coefficients, residual = self._closest
            weighted = _decorrelated(residual, rho)
            products = transposed_sum(self.first, self.basis, weighted, self.count)
            self._starts[rho] = (coefficients, products, float(np.sum(residual * weighted)))
        return self._starts[rho]

    @cached_property
    def _starts(self) -> dict[float, tuple[Array, Array, float]]:
        return {}

    @cached_property
    def _closest(self) -> tuple[Array, Array]:
        """The solution with the least penalty that rounding leaves positive definite, and its residual."""
        least, factor = self._least_penalty
        coefficients, residual = np.zeros((self.count, self.series.shape[1])), self.series
        for _ in range(2):  # the second is iterative refinement
            right = transposed_sum(self.first, self.basis, residual, self.count)
            right -= math.exp(least.log_penalty) * _banded_product(self._penalty(least.order), coefficients)
            coefficients = coefficients + _solved(factor, right)
            residual = self.series - weighted_sum(self.first, self.basis, coefficients)
        return coefficients, residual

    @property
    def _least_penalty(self) -> tuple[Smoothness, Array]:
        """The least penalty of the grid with its Cholesky factor."""
        for candidate in _grid(Smoothness(order=FIRST_ORDER, log_penalty=0.0)):
            try:
                return candidate, self._factor(candidate)
            except np.linalg.LinAlgError:
                continue
        raise np.linalg.LinAlgError

    def _factor(self, smoothness: Smoothness) -> Array:
        """Banded Cholesky factor of G + lambda P, lower storage."""
        matrix = self._gram(smoothness.correlation).copy(order="F")
        matrix[: smoothness.order + 1] += math.exp(smoothness.log_penalty) * self._penalty(smoothness.order)
        factor, failure = dpbtrf(matrix, lower=1, overwrite_ab=1)
        if failure:
            raise np.linalg.LinAlgError("rounding ends the penalties")
        return np.asarray(factor)

    def spline(self, smoothness: Smoothness) -> SmoothingSpline:
        solution = self.solution(smoothness, self.solution(smoothness, self._best[-1] if self._best else None))
        return SmoothingSpline(
            spline=BSpline(self.knots, solution.coefficients + self.offset, DEGREE),
            scale=float(self.place[-1] / (self.times[-1] - self.times[0])),
            start=float(self.times[0]),
            smoothness=smoothness, variance=self._variance(solution), freedom=self.freedom(smoothness),
            score=self._score(solution), samples=len(self.times), factor=solution.factor,
        )  # fmt: skip

    def freedom(self, smoothness: Smoothness) -> float:
        """tr((G + lambda P)^-1 G) = m - d ln|G + lambda P| / d ln lambda, by a difference on the side that exists.

        Rounding ends the penalties with a Cholesky factor: below, where the samples are interpolated, and above, where
        only the polynomials are left.
        """
        here = self._log_determinant(smoothness)
        for step in (0.1, -0.1):
            try:
                beside = self._log_determinant(replace(smoothness, log_penalty=smoothness.log_penalty + step))
            except np.linalg.LinAlgError:
                continue
            return max(self.count - (beside - here) / step, float(smoothness.order))
        return float(smoothness.order)

    def _log_determinant(self, smoothness: Smoothness) -> float:
        if smoothness not in self._log_determinants:
            self._log_determinants[smoothness] = _log_determinant(self._factor(smoothness))
        return self._log_determinants[smoothness]

    @cached_property
    def _log_determinants(self) -> dict[Smoothness, float]:
        return {}

    def _gram(self, rho: float) -> Array:
        """B' R B with R the inverse covariance of the noise over its white part's: tridiagonal."""
        if rho not in self._grams:
            squares, neighbours, ends = self.products
            self._grams[rho] = np.asfortranarray((1 + rho**2) * squares - rho * neighbours - rho**2 * ends)
        return self._grams[rho]

    @cached_property
    def _grams(self) -> dict[float, Array]:
        return {}

    def _penalty(self, order: int) -> Array:
        """D'D (order + 1, m)."""
        if order not in self._penalties:
            weights = np.array([(-1.0) ** k * math.comb(order, k) for k in range(order + 1)])
            penalty = np.zeros((order + 1, self.count))
            for i in range(order + 1):
                for j in range(i, order + 1):
                    penalty[j - i, i : i + self.count - order] += weights[i] * weights[j]
            self._penalties[order] = np.asfortranarray(penalty)
        return self._penalties[order]

    @cached_property
    def _penalties(self) -> dict[int, Array]:
        return {}

    def _log_polynomial_information(self, rho: float, order: int) -> float:
        """ln|N' G N| of the polynomials below degree `order`, N orthonormal: what the samples say of them."""
        if rho not in self._informations:
            polynomials = self._polynomials
            self._informations[rho] = polynomials.T @ _banded_product(self._gram(rho), polynomials)
        return float(np.linalg.slogdet(self._informations[rho][:order, :order])[1])

    @cached_property
    def _informations(self) -> dict[float, Array]:
        return {}

    @cached_property
    def _polynomials(self) -> Array:
        vander = np.polynomial.legendre.legvander(np.linspace(-1, 1, self.count), max(ORDERS) - 1)
        return np.linalg.qr(vander)[0]


def _grid(candidate: Smoothness) -> list[Smoothness]:
    return [replace(candidate, log_penalty=float(x)) for x in LOG_PENALTIES]


def _products(first: NDArray[np.intp], basis: Array, count: int) -> tuple[Array, Array, Array]:
    """sum_i b_i b_i', sum_i (b_i b_(i+1)' + b_(i+1) b_i') and b_1 b_1' + b_n b_n', banded (b, m) each."""
    squares, neighbours, ends = (np.zeros((DEGREE + KNOTS_PER_SAMPLE + 1, count)) for _ in range(3))
    for j, upper in enumerate(basis):
        for i in range(j + 1):
            squares[j - i] += np.bincount(first + i, basis[i] * upper, minlength=count)
            for row in (0, -1):
                ends[j - i, first[row] + i] += basis[i, row] * upper[row]
        for i, lower in enumerate(basis):
            left, right = first[:-1] + i, first[1:] + j
            diagonal, column = np.abs(left - right), np.minimum(left, right)
            product = lower[:-1] * upper[1:] * np.where(diagonal == 0, 2.0, 1.0)
            kept = diagonal <= DEGREE + KNOTS_PER_SAMPLE  # more only where samples are too far apart for a correlation
            flat = np.bincount((diagonal * count + column)[kept], product[kept], minlength=neighbours.size)
            neighbours += flat.reshape(neighbours.shape)
    return squares, neighbours, ends


def _decorrelated(series: Array, rho: float) -> Array:
    """R times a series (n, k)."""
    if rho == 0:
        return series
    weighted = (1 + rho**2) * series
    weighted[[0, -1]] -= rho**2 * series[[0, -1]]
    weighted[1:] -= rho * series[:-1]
    weighted[:-1] -= rho * series[1:]
    return weighted


def _transposed_differences(vectors: Array, order: int) -> Array:
    """D' times vectors (m - d, k)."""
    padded = np.pad(vectors, ((order, order), (0, 0)))
    return (-1.0) ** order * np.diff(padded, order, axis=0)


def _log_determinant(factor: Array) -> float:
    """Of the matrix with this Cholesky factor, lower storage."""
    return 2 * float(np.log(factor[0]).sum())


def _solved(factor: Array, right: Array) -> Array:
    """Solution (m, k) of a symmetric banded system from its Cholesky factor, lower storage."""
    return np.asarray(dpbtrs(factor, right, lower=1)[0])


def _banded_product(matrix: Array, vectors: Array) -> Array:
    """A symmetric banded matrix in lower storage times vectors (m, k)."""
    storage = np.asfortranarray(matrix)
    return np.stack([dsbmv(len(matrix) - 1, 1.0, storage, vector, lower=1) for vector in vectors.T], axis=1)


@lru_cache
def _log_determinant_of_differences(count: int, order: int) -> float:
    """ln|D D'| of the differences of an order of m coefficients.

    D and the polynomials with integer values span orthogonal complements of the integer lattice, so that |D D'| is the
    Gram determinant of C(i, k), k < order: the product of the discrete Chebyshev polynomials' norms over (k!)².
    """
    total = 0.0
    for k in range(order):
        total += 2 * math.lgamma(k + 1) - math.lgamma(2 * k + 1) - math.lgamma(2 * k + 2)
        total += sum(math.log(count + j) for j in range(-k, k + 1))
    return total
