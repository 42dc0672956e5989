"""Least squares on NIST's certified linear data (StRD), against exact rational arithmetic, and on columns without rank.

Digits are -log10 of the relative error, the smallest over the coefficients; of a standard deviation that is certified
as 0, relative to its estimate.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import isqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.least_squares.levenberg_marquardt import levenberg_marquardt, levenberg_marquardt_step
from estimation.least_squares.square_root_information import (
    EPS,
    SquareRootInformation,
    least_squares_solution,
    orthonormal_basis,
    qr_factors,
)
from modeling.identifiability import ScaledSVD
from tests.shared.places import NIST

Array = NDArray[np.float64]
Exact = list[list[Fraction]]

CERTIFIED = tomllib.loads((NIST / "certified.toml").read_text(encoding="utf-8"))
MOST_DIGITS = 15.0  # certified values have 15


@dataclass(frozen=True, eq=False)
class Reference:
    """A certified data set: columns and target exactly, and what is certified."""

    columns: Exact
    target: list[Fraction]
    estimate: Array
    std: Array

    def floats(self) -> tuple[Array, Array]:
        """Columns (n, k) and target (n,), each number rounded once."""
        return np.array(self.columns, dtype=np.float64), np.array(self.target, dtype=np.float64)


@cache
def reference(name: str) -> Reference:
    facts = CERTIFIED[name]
    with (NIST / f"{name}.csv").open(encoding="utf-8") as file:
        data = [[Fraction(cell) for cell in row] for row in list(csv.reader(file))[1:]]
    ones = [Fraction(1)] if facts["constant"] else []
    columns = [ones + [x**d for x in row[1:] for d in range(1, facts["degree"] + 1)] for row in data]
    estimate, std = (np.array([float(v) for v in facts[key]]) for key in ("estimate", "std"))
    return Reference(columns, [row[0] for row in data], estimate, std)


def exact_solution(columns: Exact, target: list[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
    """Least squares by the normal equations in rational arithmetic: coefficients, and their variances."""
    k, transposed = len(columns[0]), list(zip(*columns, strict=True))
    system = [
        [sum(a * b for a, b in zip(left, right, strict=True)) for right in (*transposed, target)]
        + [Fraction(int(i == j)) for j in range(k)]
        for i, left in enumerate(transposed)
    ]
    for i in range(k):  # Gauss-Jordan; a Gram matrix of independent columns needs no pivoting
        system[i] = [value / system[i][i] for value in system[i]]
        for j in range(k):
            if j != i:
                factor = system[j][i]
                system[j] = [a - factor * b for a, b in zip(system[j], system[i], strict=True)]
    theta = [row[k] for row in system]
    left = [y - sum(a * t for a, t in zip(row, theta, strict=True)) for row, y in zip(columns, target, strict=True)]
    variance = sum(r * r for r in left) / (len(target) - k)
    return theta, [variance * row[k + 1 + i] for i, row in enumerate(system)]


def exact_root(square: Fraction) -> float:
    """Square root to 30 digits."""
    scale = 10**60
    shift = 10 ** max(0, 60 - len(str(square.numerator)) + len(str(square.denominator)))
    return float(Fraction(isqrt(square.numerator * scale * shift**2 // square.denominator), isqrt(scale) * shift))


def digits(found: Array, truth: Array, size: Array | None = None) -> float:
    """Smallest number of right digits, at most `MOST_DIGITS`; relative to `size` where the truth is 0."""
    unit = np.where(truth == 0, np.abs(found if size is None else size), np.abs(truth))
    error = np.max(np.abs(found - truth) / unit)
    return float(min(MOST_DIGITS, -np.log10(error))) if error > 0 else MOST_DIGITS


@pytest.mark.parametrize("name", CERTIFIED)
def test_certified_values_are_those_of_the_data_typed_in(name: str) -> None:
    """To all 15 digits that are certified: half a unit of the last."""
    known = reference(name)
    theta, variance = exact_solution(known.columns, known.target)
    std = np.array([exact_root(v) for v in variance])
    np.testing.assert_allclose(np.array(theta, dtype=float), known.estimate, rtol=6e-15)
    np.testing.assert_allclose(std, known.std, rtol=6e-15)


# ---------------------------------------------------------------------------------- digits on the certified sets

Way = Callable[[Array, Array], tuple[Array, Array]]


def naive(columns: Array, target: Array) -> tuple[Array, Array]:
    """Textbook normal equations, neither scaled nor refined."""
    gram = columns.T @ columns
    theta = np.asarray(np.linalg.solve(gram, columns.T @ target))
    left = target - columns @ theta
    variance = left @ left / (len(target) - len(theta))
    return theta, np.asarray(np.sqrt(np.abs(np.diag(np.linalg.inv(gram))) * variance))


def fitted(columns: Array, target: Array) -> tuple[Array, Array]:
    """What `fit` runs: Levenberg-Marquardt on square-root information of rows with noise of unit variance.

    Where it says that an unknown is not identifiable it claims no digits.
    """
    lengths = np.linalg.norm(columns, axis=0)
    rough = np.linalg.lstsq(columns / lengths, target, rcond=None)[0]
    freedom = len(target) - len(rough)
    noise = float(np.linalg.norm(target - columns / lengths @ rough)) / np.sqrt(freedom)
    noise = max(noise, 1e-9 * float(np.abs(target).max()))  # two sets are fitted without a residual

    def information(theta: Array) -> SquareRootInformation:
        return SquareRootInformation.of(columns / noise, (target - columns @ theta) / noise)

    free = np.full(len(lengths), np.inf)
    found = levenberg_marquardt(information, np.zeros(len(lengths)), (-free, free))
    if not found.identifiable.all():
        raise np.linalg.LinAlgError("not identifiable")
    return found.theta, np.sqrt(np.diag(found.covariance) * found.cost / freedom)


WAYS: Mapping[str, Way] = {"normal equations": naive, "fit": fitted}


def reached(name: str, way: Way) -> tuple[float, float]:
    """Digits of the coefficients and of their std; none where the method gives up."""
    known = reference(name)
    try:
        theta, std = way(*known.floats())
    except np.linalg.LinAlgError:
        return 0.0, 0.0
    return digits(theta, known.estimate), digits(std, known.std, np.abs(known.estimate))


def reached_table() -> str:
    """Digits of coefficients / of std that every way reaches, for the closing note."""
    lines = [f"{'':10}" + "".join(f"{way:>20}" for way in WAYS)]
    for name in CERTIFIED:
        cells = ("{:.1f} / {:.1f}".format(*reached(name, way)) for way in WAYS.values())
        lines.append(f"{name:10}" + "".join(f"{cell:>20}" for cell in cells))
    return "\n".join(lines)


FIT_DIGITS = {
    "norris": (13, 13),
    "pontius": (13, 13),
    "noint1": (14, 14),
    "noint2": (14, 14),
    "longley": (11, 12),
    "wampler1": (10, 9),
    "wampler2": (13, 13),
    "wampler3": (10, 13),
    "wampler4": (7, 13),
}
"""Digits that a fit reaches, of coefficients and std, rounded down."""
OTHER_PROCESSOR = 0.5
"""Digits by which processors differ: they sum in other orders."""
NOT_IDENTIFIABLE = ("filip", "wampler5")
"""Columns dependent to 1e10, and a noise of a million times the smallest column: a fit has to say so."""


def test_every_certified_set_has_its_place() -> None:
    assert {*FIT_DIGITS, *NOT_IDENTIFIABLE} == set(CERTIFIED)


@pytest.mark.parametrize("name", FIT_DIGITS)
def test_certified_digits(name: str) -> None:
    found, stated = reached(name, fitted), FIT_DIGITS[name]
    assert found[0] >= stated[0] - OTHER_PROCESSOR
    assert found[1] >= stated[1] - OTHER_PROCESSOR


@pytest.mark.parametrize("name", NOT_IDENTIFIABLE)
def test_no_digits_are_claimed_where_there_are_none(name: str) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not identifiable"):
        fitted(*reference(name).floats())


@pytest.mark.parametrize("name", CERTIFIED)
def test_condition_chooses_the_method(name: str) -> None:
    """Filip's columns are dependent to 1e10, too much for any Gram matrix; those of the others are not."""
    columns, target = reference(name).floats()
    _, svd, _ = solved(columns, target)
    by_householder = np.array_equal(qr_factors(columns).inner, np.eye(columns.shape[1]))
    assert by_householder == (name == "filip")
    condition = float(np.linalg.cond(columns / np.linalg.norm(columns, axis=0)))
    # Rounding of the columns moves the smallest singular value by eps times the largest.
    assert svd.condition == pytest.approx(condition, rel=1e-13 + 1e-15 * condition)


@pytest.mark.parametrize("name", ["longley", "wampler1", "wampler3"])
def test_plain_normal_equations_lose_what_a_fit_keeps(name: str) -> None:
    assert reached(name, fitted)[0] > reached(name, naive)[0] + 3


# --------------------------------------------------------------------------------------- columns without rank


def rows(seed: int, samples: int, condition: float, size: int = 5) -> tuple[Array, Array]:
    """Columns (samples, size) with singular values from 1 to 1 / condition, and a target with a residual of 1."""
    rng = np.random.default_rng(seed)
    left = np.linalg.qr(rng.standard_normal((samples, size)))[0]
    right = np.linalg.qr(rng.standard_normal((size, size)))[0]
    columns = left * np.geomspace(1, 1 / condition, size) @ right
    return np.asarray(columns), np.asarray(columns @ rng.standard_normal(size) + rng.standard_normal(samples))


def solved(columns: Array, target: Array) -> tuple[Array, ScaledSVD, SquareRootInformation]:
    """Of rows at once, a direction that is only rounding left out: solution, directions and information."""
    information, rounding = SquareRootInformation.of(columns, target), len(columns) * EPS
    return (
        least_squares_solution(information, rounding=rounding),
        ScaledSVD.of(information.root, rounding),
        information,
    )


def by_triangle(columns: Array, target: Array) -> SquareRootInformation:
    """Information from NumPy's Householder triangle of the rows."""
    triangle = np.asarray(np.linalg.qr(np.column_stack([columns, target]), mode="r"))
    return SquareRootInformation.of_triangle(triangle, len(target))


def solution(information: SquareRootInformation) -> tuple[Array, Array]:
    """The solution of information of full rank, and its covariance."""
    return least_squares_solution(information, rounding=1e-12), ScaledSVD.of(information.root, 1e-12).covariance


def test_what_is_not_seen_is_left_out_and_said() -> None:
    """Columns 1 and 3 are one column, column 2 is zero: a null space of two, and the rest as without them."""
    columns, target = rows(0, 60, 10.0)
    columns[:, 3], columns[:, 2] = 2 * columns[:, 1], 0.0
    theta, svd, information = solved(columns, target)
    assert svd.null_space.shape == (5, 2)
    np.testing.assert_allclose(columns / svd.scale @ svd.null_space, 0, atol=1e-14)  # rounding
    assert svd.identifiable.tolist() == [True, False, False, False, True]
    alone, alone_svd, alone_information = solved(columns[:, [0, 1, 4]], target)
    np.testing.assert_allclose(theta[[0, 4]], alone[[0, 2]], rtol=1e-12)
    assert theta[1] + 2 * theta[3] == pytest.approx(alone[1], rel=1e-12)
    assert theta[2] == 0
    seen = np.ix_([0, 4], [0, 4])
    np.testing.assert_allclose(svd.covariance[seen], alone_svd.covariance[np.ix_([0, 2], [0, 2])], rtol=1e-12)
    assert information.shifted(theta).cost == pytest.approx(alone_information.shifted(alone).cost, rel=1e-12)
    singular = np.linalg.svd(columns / svd.scale, compute_uv=False)
    assert svd.condition == pytest.approx(singular[0] / singular[2])


def test_fewer_rows_than_unknowns() -> None:
    columns, target = rows(1, 5, 10.0)
    theta, svd, information = solved(columns[:3], target[:3])
    assert svd.null_space.shape == (5, 2)
    assert information.rows == 3
    np.testing.assert_allclose(columns[:3] @ theta, target[:3], atol=1e-13)


def test_scaling_of_the_columns_does_not_matter() -> None:
    """Units are a person's choice: N or kN, kg or g."""
    columns, target = rows(2, 200, 1e4)
    units = np.array([1e-9, 1.0, 1e9, 3.0, 7e-5])
    (plain, plain_svd, _), (scaled, scaled_svd, _) = solved(columns, target), solved(columns * units, target)
    assert scaled_svd.condition == pytest.approx(plain_svd.condition, rel=1e-10)
    np.testing.assert_allclose(scaled * units, plain, rtol=1e-10)


# ------------------------------------------------------------------------------- square-root information adds


@given(
    seed=st.integers(0, 2**32 - 1),
    condition=st.floats(1, 1e6),
    cuts=st.lists(st.integers(0, 300), min_size=1, max_size=6, unique=True),
    householder=st.booleans(),
)
@settings(deadline=None)  # a busy machine is no failure
def test_information_of_parts_is_that_of_the_whole(
    seed: int, condition: float, cuts: list[int], householder: bool
) -> None:
    """Any cuts, in any order and grouping; in units of the std, rounding times |target| (20), kappa for short parts."""
    columns, target = rows(seed, 300, condition)
    parts = np.split(np.arange(300), sorted(cuts))
    order = np.random.default_rng(seed).permutation(len(parts))
    of = by_triangle if householder else SquareRootInformation.of
    found = [of(columns[parts[i]], target[parts[i]]) for i in order]
    middle = len(found) // 2
    left, right = SquareRootInformation.empty(5), SquareRootInformation.empty(5)
    for one in found[:middle]:
        left = left + one
    for one in found[middle:]:
        right = one + right
    whole, sum_ = SquareRootInformation.of(columns, target), left + right
    (theta, covariance), (sum_theta, sum_covariance) = solution(whole), solution(sum_)
    std = np.sqrt(np.diag(covariance))
    assert sum_.rows == 300
    np.testing.assert_allclose(sum_theta / std, theta / std, atol=1e-10)
    np.testing.assert_allclose(np.diag(sum_covariance), std**2, rtol=1e-8)  # kappa eps, and room
    assert sum_.shifted(sum_theta).cost == pytest.approx(whole.shifted(theta).cost, rel=1e-10)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4))
@settings(deadline=None)  # a busy machine is no failure
def test_elimination_is_the_least_over_what_is_eliminated(seed: int, count: int) -> None:
    """Two routes: without its first unknowns at the triangle, and all at once."""
    columns, target = rows(seed, 40, 100.0)
    whole = SquareRootInformation.of(columns, target)
    part = whole.eliminated(count)
    (theta, covariance), (part_theta, part_covariance) = solution(whole), solution(part)
    np.testing.assert_allclose(part_theta, theta[count:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part_covariance, covariance[count:, count:], rtol=1e-9, atol=1e-9)
    assert part.shifted(part_theta).cost == pytest.approx(whole.shifted(theta).cost, rel=1e-9)
    assert part.rows == 40 - count


@given(seed=st.integers(0, 2**32 - 1), strength=st.floats(1e-3, 1e3))
@settings(deadline=None)  # a busy machine is no failure
def test_moved_held_only_and_spread(seed: int, strength: float) -> None:
    """|A (x + s) - b|², Levenberg's damping and fewer unknowns, each against the rows themselves."""
    columns, target = rows(seed, 30, 10.0)
    found, step = SquareRootInformation.of(columns, target), np.arange(5.0)
    moved = found.shifted(step)
    assert moved.cost == pytest.approx(float(((target - columns @ step) ** 2).sum()), rel=1e-11)
    lengths = np.linalg.norm(columns, axis=0)
    damped = np.linalg.lstsq(
        np.vstack([columns, strength * np.diag(lengths)]), np.concatenate([target, np.zeros(5)]), rcond=None
    )[0]
    np.testing.assert_allclose(solution(found.damped(strength))[0], damped, rtol=1e-8, atol=1e-10)
    index = np.array([4, 1, 2])
    fewer = SquareRootInformation.of(columns[:, index], target)
    for other in (found.restricted(index), fewer.spread(np.array([2, 0, 1]), 3).restricted(np.array([2, 0, 1]))):
        np.testing.assert_allclose(np.abs(other.root), np.abs(fewer.root), rtol=1e-9, atol=1e-12)
        assert other.cost == pytest.approx(fewer.cost, rel=1e-11)
        assert other.power == pytest.approx(fewer.power, rel=1e-9)


@pytest.mark.parametrize("start", [0.0, 2.0, 4.0])
def test_a_minimum_costs_what_it_says(start: float) -> None:
    """A row that hardly shows its unknown: little to be gained by the linear model, and a long way to go."""

    def information(theta: Array) -> SquareRootInformation:
        found = 5e-4 - 1e-5 * np.expm1(theta)
        return SquareRootInformation.of(1e-5 * np.exp(theta)[:, None] * np.ones((2, 1)), np.tile(found, 2))

    found = levenberg_marquardt(information, np.array([start]), (np.array([-100.0]), np.array([100.0])))
    assert found.cost == pytest.approx(information(found.theta).cost, rel=1e-6, abs=1e-18)
    assert found.cost <= information(np.array([start])).cost


if __name__ == "__main__":
    print(reached_table())


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 12), columns=st.integers(1, 9), rank=st.integers(1, 9))
def test_basis_has_the_rows_of_its_columns_however_few(seed: int, rows: int, columns: int, rank: int) -> None:
    """Fewer rows than columns, too: of a log of a fifth of a second its motion has more terms than samples."""
    rng = np.random.default_rng(seed)
    derivative = rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, columns))
    basis = orthonormal_basis(derivative)
    assert basis.shape == (rows, min(rows, columns, rank))
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-9)
    np.testing.assert_allclose(basis @ (basis.T @ derivative), derivative, atol=1e-7 * np.abs(derivative).max())


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(-3.0, 0.0))
def test_a_step_within_bounds_is_the_minimum_there(seed: int, count: int, weakest: float) -> None:
    """The conditions of optimality: no slope at parameters between their bounds, none that points inside at the others.

    Columns are correlated, their lengths differ by up to a thousand, and starts may lie at a bound.
    """
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((3 * count + 2, count)) @ rng.standard_normal((count, count))
    rows = rows / np.linalg.norm(rows, axis=0) * 10.0 ** rng.uniform(weakest, 0.0, count)
    here = SquareRootInformation.of(rows, 10.0 * rng.standard_normal(len(rows)))
    low, high = -rng.exponential(size=count), rng.exponential(size=count)
    low[rng.random(count) < 0.3], high[rng.random(count) < 0.3] = -np.inf, np.inf
    start = np.clip(np.zeros(count), low, high)
    at_bound = (rng.random(count) < 0.2) & np.isfinite(low)
    start[at_bound] = low[at_bound]
    step = levenberg_marquardt_step(here, start, (low, high), 0.0)
    slope = here.root.T @ (here.root @ step - here.target) / np.linalg.norm(here.root, axis=0)
    reached = start + step
    rounding = 1e-8 * np.linalg.norm(here.target)
    assert np.all(reached >= low - 1e-9)
    assert np.all(reached <= high + 1e-9)
    at_low, at_high = reached <= low + 1e-9, reached >= high - 1e-9
    assert np.all(np.abs(slope[~at_low & ~at_high]) < rounding)
    assert np.all(slope[at_low & ~at_high] > -rounding)
    assert np.all(slope[at_high & ~at_low] < rounding)
