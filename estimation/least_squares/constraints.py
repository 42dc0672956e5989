"""Constraints of a fit: bounds, physical consistency of the tool, and a prior."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from itertools import product
from math import inf, isfinite
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.bounds import Bounds, Interval, require_known_names
from estimation.least_squares.prior import LogDetDivergence, Prior
from estimation.parameter_layout import ParameterLayout
from modeling.chain.pseudo_inertia import PseudoInertia, Volume, pseudo_inertia
from modeling.errors import InputError, kind_of
from modeling.parameter import Parameter

Array = NDArray[np.float64]

SOLVER_TOLERANCE = 1e-10
"""Gap and infeasibility at which Clarabel stops, of a program of unit size; Newton steps refine the result."""


def cvxpy() -> Any:
    """CVXPY, imported only when a program is built: the import takes a second. Its type hints are incomplete."""
    return import_module("cvxpy")


def solve_conic(program: Any) -> bool:
    """Solve a CVXPY problem; False when no solution was found."""
    cp = cvxpy()
    tight = {f"tol_{name}": SOLVER_TOLERANCE for name in ("gap_abs", "gap_rel", "feas")}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # inaccurate solutions: the status tells, and optimality is checked
            program.solve(solver=cp.CLARABEL, **tight)
    except cp.error.SolverError:
        return False
    return program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)


# Feasible region of the parameters: bounds and a pseudo-inertia that is positive by a margin.


@dataclass(frozen=True)
class BoundSide:
    """One-sided bound: parameter `index` is at least (`lower`) or at most `value`; `of_effect` where that sets it."""

    index: int
    lower: bool
    value: float
    text: str
    of_effect: bool = False


@dataclass(frozen=True, eq=False)
class FeasibleRegion:
    """Parameters (k,) with low <= theta <= high and J(theta) >= 0 by `CONSISTENCY_MARGIN`, and a prior inside.

    stated   stated intervals by index; the parameters' own bounds hold as well
    inertia  J over all parameters, with the conditions of a volume where the mass is to be inside one; None where
             physical consistency is not required, or implied by a prior
    prior    keeps J positive definite by itself
    where    source of the intervals, for an InputError
    """

    parameters: tuple[Parameter, ...]
    stated: dict[int, tuple[float, float]]
    inertia: PseudoInertia | None = None
    prior: LogDetDivergence | None = None
    where: str = "bounds"

    @cached_property
    def sides(self) -> tuple[BoundSide, ...]:
        """Every finite bound, stated or from an effect."""
        return tuple(self._sides())

    def _sides(self) -> Iterator[BoundSide]:
        for index, parameter in enumerate(self.parameters):
            for of_effect, ends in ((True, parameter.bounds), (False, self.stated.get(index, (-inf, inf)))):
                for lower, value in zip((True, False), ends, strict=True):
                    if isfinite(value):
                        text = f"{parameter.name} {'>=' if lower else '<='} {value:g} {_unit(parameter)}".rstrip()
                        text += " (its effect's range)" if of_effect else ""
                        yield BoundSide(index, lower, value, text, of_effect)

    @cached_property
    def low(self) -> Array:
        """(k,) lower bounds."""
        return self._ends(lower=True)

    @cached_property
    def high(self) -> Array:
        """(k,) upper bounds."""
        return self._ends(lower=False)

    def _ends(self, *, lower: bool) -> Array:
        ends = np.full(len(self.parameters), -inf if lower else inf)
        for side in self.sides:
            if side.lower is lower:
                ends[side.index] = (max if lower else min)(ends[side.index], side.value)
        return ends

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """(k,) parameters with equal bounds."""
        return np.asarray(self.low == self.high)

    def text(self, index: int, *, lower: bool) -> str:
        """The tightest bound of parameter `index` on one side, as text."""
        end = (self.low if lower else self.high)[index]
        if self.fixed[index]:
            return f"{self.parameters[index].name} = {end:g} {_unit(self.parameters[index])}".rstrip()
        sides = [s for s in self.sides if s.index == index and s.lower is lower and s.value == end]
        return min(sides, key=lambda s: s.of_effect).text

    @cached_property
    def cone(self) -> PseudoInertia | None:
        """J less its margin, which is to be positive semidefinite; None without physical consistency."""
        return None if self.inertia is None else self.inertia.with_margin()

    def matrix(self, theta: Array) -> Array:
        """J (n, n) less its margin at theta, 0 x 0 without physical consistency."""
        return np.zeros((0, 0)) if self.cone is None else self.cone.at(theta)

    @property
    def slopes(self) -> Array:
        """Derivative of `matrix` in each parameter, (k, n, n)."""
        return np.zeros((len(self.parameters), 0, 0)) if self.cone is None else self.cone.slopes

    def contains(self, theta: Array) -> bool:
        """Whether theta is within the bounds, inclusive, and J positive definite by more than its margin."""
        within = bool(np.all((theta >= self.low) & (theta <= self.high)))
        return within and bool(np.all(np.linalg.eigvalsh(self.matrix(theta)) > 0))

    def added(self, theta: Array) -> float:
        """Contribution of the prior to the chi-square at theta."""
        return 0.0 if self.prior is None else self.prior.value(theta)


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit


# Irreducible infeasible subset of constraints, by deletion filter.


MIN_EIGENVALUE = 1e-7
"""Smallest eigenvalue, of a matrix of unit size, that counts as positive: ten times the solver's tolerance."""


def require_interior(region: FeasibleRegion) -> None:
    """Raise InputError, naming an irreducible infeasible subset, unless the region has an interior."""
    crossed = _crossed_bounds(region.sides)
    if crossed:
        raise _infeasibility_error(list(crossed), None, region.where)
    inertia = region.cone if region.prior is None else region.prior.inertia
    if inertia is None:
        return
    sides = [s for s in region.sides if inertia.slopes[s.index].any()]
    if sides and not has_interior(inertia, sides):
        raise _infeasibility_error(irreducible_infeasible_subset(inertia, sides), inertia, region.where)


def _crossed_bounds(sides: Sequence[BoundSide]) -> tuple[BoundSide, BoundSide] | None:
    """A lower bound above an upper bound of the same parameter."""
    for first, second in product(sides, sides):
        same = first.index == second.index and first.lower and not second.lower
        if same and first.value > second.value:
            return first, second
    return None


def irreducible_infeasible_subset(inertia: PseudoInertia, sides: Sequence[BoundSide]) -> list[BoundSide]:
    """Bounds infeasible with J > 0, none of them redundant, by a deletion filter.

    Each bound is left out in turn, permanently if the others are still infeasible: the remaining set is irreducible.
    Chinneck and Dravnieks, "Locating minimal infeasible constraint sets in linear programs" (ORSA Journal on Computing
    3, 1991).
    """
    subset = list(sides)
    for side in sides:
        others = [s for s in subset if s is not side]
        if not has_interior(inertia, others):
            subset = others
    return subset


def has_interior(inertia: PseudoInertia, sides: Sequence[BoundSide]) -> bool:
    """Whether J(theta) can be positive definite within the given bounds.

    Maximises t <= 1 with T J T >= t 1; T, diagonal, scales J to unit size and does not change its definiteness.
    """
    cp = cvxpy()
    involved = [i for i, slope in enumerate(inertia.slopes) if slope.any()]
    scale = _bounded_inertia_scale(inertia, sides)
    flat = (inertia.slopes[involved] / np.outer(scale, scale)).reshape(len(involved), -1).T
    theta, margin = cp.Variable(len(involved)), cp.Variable()
    moved = cp.reshape(flat @ theta, (inertia.size, inertia.size), order="C")
    matrix = inertia.constant / np.outer(scale, scale) + moved
    conditions = [matrix >> margin * np.eye(inertia.size), margin <= 1]
    for side in sides:
        value = theta[involved.index(side.index)]
        conditions.append(value >= side.value if side.lower else value <= side.value)
    return solve_conic(cp.Problem(cp.Maximize(margin), conditions)) and float(margin.value) > MIN_EIGENVALUE


def _bounded_inertia_scale(inertia: PseudoInertia, sides: Sequence[BoundSide]) -> Array:
    """Square roots (n,) of the size that the bounds give J's diagonal; 1 where they do not limit it."""
    size = np.zeros(len(inertia.slopes))
    for side in sides:
        size[side.index] = max(size[side.index], abs(side.value))
    diagonal = size @ np.abs(np.diagonal(inertia.slopes, axis1=1, axis2=2)) + np.abs(np.diag(inertia.constant))
    return np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def _infeasibility_error(sides: Sequence[BoundSide], inertia: PseudoInertia | None, where: str) -> InputError:
    *first, last = [side.text for side in sides]
    named = f"{', '.join(first)} and {last} are infeasible together" if first else f"{last} is infeasible"
    against = "" if inertia is None else f" with physical consistency, {inertia.condition}"
    return InputError(what=f"{named}{against}", where=where, remedy="widen or remove one of them")


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """Bounds of parameters, physical consistency of the tool, and a reference tool as prior; each is optional.

    The fit raises InputError when a name is unknown, the tool's moments are not linear in the parameters, or the
    constraints are infeasible together (it names an irreducible subset).

    Parameters
    ----------
    bounds : Bounds, or mapping of str to (float, float) or float, optional
        Lower and upper bounds of parameters, a number of which fixes one; by default none.
    physical : bool, optional
        Whether the pseudo-inertia must be positive definite, by `CONSISTENCY_MARGIN` of the tool's own size: some mass
        distribution that is neither flat nor a line has these moments. By default not.
    prior : Prior, optional
        Reference tool; implies physical consistency where its weight is not 0. By default none.
    inside : Volume, optional
        Where the mass of a six-axis tool is; implies physical consistency. By default anywhere.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> model = tw.planar(rig) + tw.effects.named("viscous_drag")
    >>> stated = tw.Constraints(bounds={"m": 0.89}, physical=True)
    >>> fit = tw.fit(model, tw.read("train.csv", rig=rig), constraints=stated)
    >>> round(fit.values["m"], 6), fit.values["I"] > 0
    (0.89, True)
    """

    bounds: Bounds | Mapping[str, Interval] | None = None
    physical: bool = False
    prior: Prior | None = None
    inside: Volume | None = None

    def __post_init__(self) -> None:
        _ = self._bounds

    @classmethod
    def of(cls, given: StatedConstraints) -> Constraints:
        """The constraints of an argument that has bounds alone, too; InputError, in a sentence, for anything else."""
        other: object = given  # whatever the caller's types say
        if isinstance(other, Constraints):
            return other
        if isinstance(other, Bounds | Mapping):
            return cls(bounds=other)
        what = f"{kind_of(other)} is no set of constraints"
        remedy = 'give bounds by parameter, {"m": (0.1, 3.0)}, or tw.Constraints(bounds=.., physical=.., prior=..)'
        raise InputError(what=what, where="constraints", remedy=remedy)

    @property
    def _bounds(self) -> Bounds:
        given = {} if self.bounds is None else self.bounds
        return given if isinstance(given, Bounds) else Bounds(given)

    def region(self, unknowns: ParameterLayout) -> FeasibleRegion:
        """Feasible region of a fit's parameters; a prior is of the tool that the model's own parameters are of.

        Raises InputError when a name is unknown, the tool's moments are not linear in the parameters, or the
        constraints are infeasible together (it names an irreducible subset).
        """
        names = [p.name for p in unknowns.parameters]
        bounds = self._bounds
        require_known_names(bounds.ends, names, bounds.where)
        held = self.physical or self.inside is not None
        inertia = pseudo_inertia(unknowns.models[0]) if held or self.prior is not None else None
        divergence = None if self.prior is None or inertia is None else self.prior.divergence(inertia, names)
        weighted = divergence is not None and divergence.weight > 0
        if weighted and self.inside is not None:
            what = "a volume and a prior of the tool cannot be combined"
            raise InputError(what=what, where="inside", remedy="leave one of them out")
        if inertia is not None and self.inside is not None:
            inertia = inertia.within(self.inside)
        if inertia is not None and unknowns.other_tools:
            inertia = inertia.of_each_tool(unknowns.other_tools)
        region = FeasibleRegion(
            parameters=unknowns.parameters,
            stated={names.index(name): interval for name, interval in bounds.ends.items()},
            inertia=inertia.over(names) if inertia is not None and held and not weighted else None,
            prior=divergence if weighted else None,
            where=bounds.where,
        )
        require_interior(region)
        return region


StatedConstraints: TypeAlias = Constraints | Bounds | Mapping[str, Interval]
"""What a fit takes: constraints, or bounds alone."""
