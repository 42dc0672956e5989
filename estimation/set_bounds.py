"""Intervals that hold for every parameter whatever the errors of the readings are, up to a stated largest one.

A std is what noise does on average. Where what is missing in the model cannot be averaged, only a bound on the error of
each reading says what is certain: the parameters for which no reading is off by more are a set, here a polytope, and
its extent along each parameter is a linear program (F. C. Schweppe, IEEE Trans. Automatic Control 13 (1968) 22-28;
M. Milanese and A. Vicino, Automatica 27 (1991) 997-1009). No distribution is assumed, and nothing is learned from many
readings but what the extreme ones say. An empty set proves that the bounds do not hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, cast

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, linprog

from estimation.fit import Fit
from estimation.noise.transient_windows import inside, samples_of
from modeling.chain.regressor import regressor_basis
from modeling.errors import InputError, kind_of, quoted, suggestion
from modeling.number_format import plain_number
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]
Index = NDArray[np.intp]

VIOLATION = 1e-7
"""Of the stated error, by which a reading may be off: above the solver's tolerance of 1e-9, and no error is stated to
seven digits."""
ROWS_AT_ONCE = 40
"""Readings that are taken in when a program's solution violates them: a few times the unknowns."""
OUTWARD = 1e-6
"""Of its width, by which an interval is widened: more than the tolerances of the program leave open."""


@dataclass(frozen=True, eq=False)
class SetBounds(Tabular):
    """The interval of each parameter that a largest error of the readings leaves.

    Parameters
    ----------
    fit : Fit
        Of a model that is linear in its parameters.
    error : mapping of str to float
        Largest error of a reading by channel, N and N m.
    low, high : array (k,)
        In the order of the fit's `theta`, in the parameters' units; infinite where the readings do not limit one, nan
        where no parameters are possible.
    factor : float
        The least number by which all errors have to be multiplied for any parameters to be possible: at most 1 where
        the set is not empty.
    tightest : tuple of str
        The channels whose readings ask for that factor.
    """

    fit: Fit
    error: Mapping[str, float]
    low: Array
    high: Array
    factor: float
    tightest: tuple[str, ...]

    @property
    def feasible(self) -> bool:
        """Whether any parameters are possible."""
        return self.factor <= 1 + VIOLATION

    @property
    def table(self) -> Table:
        """Each parameter with its estimate, std and the ends of its interval."""
        columns = (Column("parameter"), Column("estimate", format=".4g"), Column("std", format=".2g"))
        ends = (Column("at least", format=".4g"), Column("at most", format=".4g"), Column("unit"))
        rows = [
            (name, estimate.value if known else None, estimate.std if known else None, *map(_end, (low, high)), unit)
            for (name, estimate), known, low, high, unit in self._rows()
        ]
        return Table.of((*columns, *ends), rows)

    def _rows(self) -> Iterator[tuple[Any, ...]]:
        units = [p.unit for p in self.fit.unknowns]
        estimates = self.fit.parameters.items()
        return zip(estimates, self.fit.identifiable.tolist(), self.low.tolist(), self.high.tolist(), units, strict=True)

    def remarks(self) -> list[str]:
        """What the interval means, or that there is none."""
        stated = ", ".join(f"{name} {value:g}" for name, value in self.error.items())
        if not self.feasible:
            within = "" if self.fit.constrained is None else " within the fit's bounds"
            return [
                f"Infeasible: no parameters of this model{within} leave every reading within {stated}. They would"
                f" within {plain_number(self.factor, '.4g')} times as much, by {', '.join(self.tightest)}: something is"
                " missing in the model, or a reading is no measurement."
            ]
        least = plain_number(self.factor, ".3g")
        return [
            f"Holds for every error of a reading up to {stated}, whatever its distribution; the smallest that any"
            f" parameters explain is {least} times that."
        ]

    def to_data(self) -> dict[str, Any]:
        """As plain numbers; None where there is no end."""
        return {
            "error": dict(self.error),
            "feasible": self.feasible,
            "factor": self.factor,
            "tightest": list(self.tightest),
            "parameters": {
                name: {"low": low if isfinite(low) else None, "high": high if isfinite(high) else None}
                for (name, _), _, low, high, _ in self._rows()
            },
        }


def _end(value: float) -> float | None:
    return value if isfinite(value) else None


def set_bounds(fitted: Fit, error: Mapping[str, float]) -> SetBounds:
    """The interval of every parameter for which no reading of the fit's recordings is off by more than `error`.

    Parameters
    ----------
    fitted : Fit
        A fit of a model that is linear in its parameters and has no memory; its recordings are used, the ranges of its
        effects' parameters and the bounds of its constraints, but no physical consistency and no prior. Readings that
        the fit leaves out are left out here.
    error : mapping of str to float
        For each channel the largest error of a reading: noise and whatever the model lacks, N and N m.

    Returns
    -------
    SetBounds
        Ends of each interval, (k,), and whether any parameters are possible.

    Raises
    ------
    InputError
        For a model that is not linear, a channel without an error, one that is unknown, and one that is not positive.

    Notes
    -----
    Each end is a linear program with a row for every reading. It is solved for a few of them, and those that its
    solution violates are taken in until there are none: its solution is then that of all.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig), tw.read("train.csv", rig=rig))  # a drag is missing in the model
    >>> tw.set_bounds(fit, {"fx": 0.6, "fy": 0.9, "tau": 0.05}).feasible
    False
    >>> bounds = tw.set_bounds(fit, {"fx": 2.0, "fy": 3.0, "tau": 0.2})
    >>> row = [p.name for p in fit.unknowns].index("m")
    >>> bounds.feasible, bool(bounds.low[row] < 0.9 < bounds.high[row])
    (True, True)
    """
    given: object = fitted
    if not isinstance(given, Fit):
        remedy = "give a fit of whole recordings first: tw.set_bounds(tw.fit(model, recording), ..)"
        raise InputError(what=f"{kind_of(given)} has no readings to bound", where="set bounds", remedy=remedy)
    limits = _error_by_channel(fitted, error)
    if regressor_basis(fitted.model) is None:
        names = [effect.id for effect in fitted.model.effects if regressor_basis(fitted.model.base + effect) is None]
        what = f"the model is not linear in its parameters, by {', '.join(names) or 'its effects together'}"
        raise InputError(what=what, where="set bounds", remedy="leave it out, and state larger errors")
    polytope = _Polytope.of(fitted, limits)
    factor, rows = polytope.least_factor()
    if not isfinite(factor):  # it always has a solution
        remedy = "state errors that differ less in size between the channels"
        raise InputError(
            what="the linear program has no solution in finite precision", where="set bounds", remedy=remedy
        )
    tightest = tuple(dict.fromkeys(fitted.model.channels[i] for i in polytope.channel[rows].tolist()))
    if factor > 1 + VIOLATION:
        none = np.full(fitted.layout.size, np.nan)
        return SetBounds(fitted, limits, none, none, factor, tightest)
    low, high = polytope.extent()
    return SetBounds(fitted, limits, low, high, factor, tightest)


def _error_by_channel(fitted: Fit, error: Mapping[str, float]) -> dict[str, float]:
    channels, given = fitted.model.channels, cast("object", error)
    if not isinstance(given, Mapping):
        remedy = f"give that of {', '.join(channels)} by name"
        raise InputError(what=f"{kind_of(given)} is no largest error by channel", where="error bound", remedy=remedy)
    for name in error:
        if name not in channels:
            what = f"no channel is called {quoted(name)}"
            raise InputError(what=what, where="error bound", remedy=suggestion(str(name), channels, most=len(channels)))
    missing = [name for name in channels if name not in error]
    if missing:
        what = f"no largest error of {', '.join(missing)}"
        raise InputError(what=what, where="error bound", remedy="state that of every channel, N and N m")
    for name, value in error.items():
        if not (isinstance(cast("object", value), int | float | np.number) and 0 < value < inf):
            what = f"{quoted(value)} is no largest error of {name}"
            raise InputError(what=what, where="error bound", remedy="state a number above zero")
    return {name: float(error[name]) for name in channels}


@dataclass(eq=False)
class _Polytope:
    """Steps d = scale z of theta with |residual - rows z| <= 1 and low <= z <= high.

    rows      (m, k) derivative of each reading over its largest error, by unit steps of z
    residual  (m,) at the estimate; `channel` (m,) of each row
    taken     rows that the programs have had to respect so far
    """

    rows: Array
    residual: Array
    channel: Index
    theta: Array
    scale: Array
    low: Array
    high: Array
    taken: Index

    @classmethod
    def of(cls, fitted: Fit, error: Mapping[str, float]) -> _Polytope:
        """Of a fit, with the readings that it counts."""
        size = np.array(list(error.values()))
        parts = [_readings(fitted, number, size) for number in range(len(fitted.recordings))]
        rows, residual, channel = (np.concatenate(each) for each in zip(*parts, strict=True))
        scale = 1 / np.maximum(np.abs(rows).max(axis=0), np.finfo(float).tiny)
        scale = np.where(rows.any(axis=0), scale, 1.0)
        rows = rows * scale
        region = None if fitted.constrained is None else fitted.constrained.region
        ends = (
            np.array([p.bounds for p in fitted.unknowns]).T if region is None else np.array([region.low, region.high])
        )
        low, high = ((end - fitted.theta) / scale for end in ends)
        # The rows that determine z best limit it in every direction that any limit.
        _, _, pivots = scipy.linalg.qr(rows.T, mode="economic", pivoting=True)
        first = np.union1d(pivots[: 2 * rows.shape[1]], np.argsort(-np.abs(residual))[:ROWS_AT_ONCE])
        return cls(rows, residual, channel, fitted.theta, scale, low, high, first)

    def least_factor(self) -> tuple[float, Index]:
        """The least bound on |residual - rows z|, and the rows that are at it."""
        cost = np.append(np.zeros(self.rows.shape[1]), 1.0)
        z, factor = np.zeros(len(cost) - 1), inf
        for solution in self._solved(cost, 0.0):
            if solution is None:
                break
            z, factor = solution[:-1], float(solution[-1])
        off = np.abs(self.residual - self.rows @ z)
        return factor, np.flatnonzero(off >= off.max() * (1 - 1e-6))

    def extent(self) -> tuple[Array, Array]:
        """Ends (k,) of theta."""
        ends = np.array([[self._end(i, sign) for i in range(len(self.theta))] for sign in (1.0, -1.0)])
        width = np.where(np.isfinite(ends).all(axis=0), ends[1] - ends[0], 0.0)
        return ends[0] - OUTWARD * width, ends[1] + OUTWARD * width

    def _end(self, index: int, sign: float) -> float:
        """The least of a parameter (sign 1), or its largest (-1)."""
        cost = np.zeros(self.rows.shape[1] + 1)
        cost[index] = sign
        end = -sign * inf
        for solution in self._solved(cost, 1.0):
            end = -sign * inf if solution is None else float(self.theta[index] + self.scale[index] * solution[index])
        return end

    def _solved(self, cost: Array, factor: float) -> Iterator[Array | None]:
        """Solutions (k + 1,), z and the factor, of more and more rows; None where they do not limit the cost.

        The factor is 1 where it has no cost.
        """
        free = factor == 0.0
        bounds = [*zip(self.low, self.high, strict=True), (0.0, inf) if free else (1.0, 1.0)]
        while True:
            rows, residual = self.rows[self.taken], self.residual[self.taken]
            one = np.ones((len(rows), 1))
            found: OptimizeResult = linprog(
                cost,
                A_ub=np.block([[-rows, -one], [rows, -one]]),
                b_ub=np.concatenate([-residual, residual]),
                bounds=bounds,
                method="highs",
            )
            if found.x is None:
                yield None
                return
            yield np.asarray(found.x)
            off = np.abs(self.residual - self.rows @ found.x[:-1]) - found.x[-1]
            off[self.taken] = -inf
            worst = np.argsort(-off)[:ROWS_AT_ONCE]
            worst = worst[off[worst] > VIOLATION / 2]
            if not len(worst):
                return
            self.taken = np.union1d(self.taken, worst)


def _readings(fitted: Fit, number: int, error: Array) -> tuple[Array, Array, Index]:
    """Rows (m, k), residual (m,) and channel (m,) of one recording, over the channels' largest errors (p,)."""
    recording, noise = fitted.recordings[number], fitted.noise[number]
    counted = np.ones(recording.wrench.shape, dtype=bool)
    counted[:, noise.left_out] = False
    if recording.dt is not None:
        events = [(shape.edges[0] - shape.margin, shape.edges[-1] + shape.margin) for shape in noise.shapes]
        counted[inside([samples_of(e, recording.dt, recording.samples) for e in events], recording.samples)] = False
    rows = np.zeros((*recording.wrench.shape, fitted.layout.size))
    rows[:, :, fitted.layout.index[number]] = fitted.response(number).derivative
    channel = np.broadcast_to(np.arange(recording.wrench.shape[1]), counted.shape)
    scaled = rows / error[:, None], fitted.residuals[number] / error
    return scaled[0][counted], scaled[1][counted], channel[counted]
