"""A budget of uncertainty as it is stated, and as a table: contributions, coverage factor, interval, what to better.

JCGM 100:2008, "Guide to the expression of uncertainty in measurement" (GUM).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite, pi, sqrt
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from estimation.multiplicity import normal_isf, student_isf
from modeling.errors import InputError, file_text, kind_of, quoted, toml_data
from modeling.number_format import NOT_IDENTIFIABLE, SHARE, digits_of
from modeling.rig_schema import StrictTable, validated
from modeling.significance import LEVELS
from modeling.table import Cell, Column, Table, Tabular, Value

FORMS: Mapping[str, Mapping[str, float]] = {
    "1": {"%": 0.01},
    "rad": {"mrad": 1e-3, "deg": pi / 180},
    "m": {"mm": 1e-3},
    "s": {"ms": 1e-3},
    "kg": {"g": 1e-3},
    "kg m": {"g m": 1e-3},
}
"""Other units that a contribution may be stated in, by the unit of the parameter, with their size in it."""
MOST_CONTRIBUTIONS = 50
"""Of a file: more are a typing error, and no table shows them."""
NEGLIGIBLE = 1e-6
"""Of a combined std: below it a contribution is shown as zero, rounding errors among them."""
TYPE_A = {
    "noise": "an average over {:.3g} times as many readings would halve the std",
    "parameters": "{:.3g} times as many readings in the fit would halve the std",
    "zero": "{:.3g} times as many rows without contact would halve the std",
}
"""Contributions from the scatter of readings, whose std falls with the square root of their number."""


def size_in(unit: str, stated: str) -> float | None:
    """The size of the stated unit in a parameter's unit; None where it is none of its forms."""
    return {unit: 1.0, unit.replace("²", "^2"): 1.0, **FORMS.get(unit, {})}.get(stated)


Text = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
Size = Annotated[float, Field(ge=1e-12, le=1e12)]
"""Of a std in any unit: its square is a number yet."""


class _Contribution(StrictTable):
    name: Text
    quantity: Text
    unit: Text
    std: Size | None = None
    half_width: Size | None = None
    freedom: Annotated[float, Field(ge=1)] | None = None
    each_recording: bool = False


class _Statement(StrictTable):
    coverage: Annotated[float, Field(ge=0.5, le=0.9999)] = LEVELS.confidence
    digits: Literal[1, 2] = 1
    contribution: Annotated[list[_Contribution], Field(min_length=1, max_length=MOST_CONTRIBUTIONS)]


@dataclass(frozen=True)
class Contribution:
    """What the model holds at one value while the truth has it with a std, as it is stated (type B).

    quantity        an effect's id, one of its parameters, or a parameter of the fit that a bound fixes
    std             in `unit`; of a `uniform` quantity its half width over the root of 3
    freedom         degrees of freedom of that std, infinite where none are stated
    each_recording  whether it is another one in each recording, and in use
    """

    name: str
    quantity: str
    std: float
    unit: str
    uniform: bool = False
    freedom: float = inf
    each_recording: bool = False


@dataclass(frozen=True)
class Statement:
    """Contributions, the coverage of the intervals, and the digits of a std to which a check by Monte Carlo holds."""

    contributions: tuple[Contribution, ...]
    coverage: float = LEVELS.confidence
    digits: int = 1
    where: str = "budget"

    @classmethod
    def read(cls, given: str | Path | Mapping[str, object]) -> Self:
        """The statement in a TOML file, or in a dictionary of its layout; InputError, in one line, for another."""
        data: object = given
        if isinstance(data, Mapping):
            return cls.of(data, "budget")
        if not isinstance(data, str | Path):
            remedy = 'give the path of a budget file, such as "budget.toml", or its tables'
            raise InputError(what=f"{kind_of(given)} is no budget", where="budget", remedy=remedy)
        return cls.of(toml_data(file_text(data, kind="a budget file"), str(data)), str(data))

    @classmethod
    def of(cls, data: object, where: str) -> Self:
        """The statement in plain data."""
        table = validated(_Statement, data, where)
        names: list[str] = []
        for entry in table.contribution:
            place = f"{where}: {entry.name}"
            if entry.name in names or entry.name in TYPE_A:
                what = "the name is used twice" if entry.name in names else "the name is that of a scatter of readings"
                raise InputError(what=what, where=place, remedy="give each contribution a name of its own")
            if (entry.std is None) == (entry.half_width is None):
                remedy = "std of a normal quantity, or half_width of one that is uniform between two limits"
                raise InputError(what="one of std and half_width is needed", where=place, remedy=f"give {remedy}")
            names.append(entry.name)
        return cls(tuple(map(_stated, table.contribution)), table.coverage, table.digits, where)


def _stated(entry: _Contribution) -> Contribution:
    std = entry.std if entry.std is not None else (entry.half_width or 0.0) / sqrt(3)
    freedom = inf if entry.freedom is None else entry.freedom
    uniform = entry.half_width is not None
    return Contribution(entry.name, entry.quantity, std, entry.unit, uniform, freedom, entry.each_recording)


@dataclass(frozen=True)
class Check:
    """Ends of an interval by propagation of distributions (JCGM 101:2008).

    error      std of these ends by the finite number of trials
    tolerance  half of the last stated digit of the std: how far the linear ends may be off
    """

    ends: tuple[float, float]
    error: float
    tolerance: float

    def agrees(self, interval: tuple[float, float]) -> bool | None:
        """Whether both ends of a linear interval are within the tolerance; None where the trials are too few to say."""
        distance = max(abs(mine - other) for mine, other in zip(self.ends, interval, strict=True))
        return None if abs(distance - self.tolerance) < 2 * self.error else distance <= self.tolerance


@dataclass(frozen=True)
class BudgetLine:
    """One quantity of a budget: its value, and the std that each contribution gives it, in its unit.

    parts    std by contribution, first those from the scatter of readings
    freedom  degrees of freedom by contribution; infinite where there is none
    unknown  why it has no interval, empty where it has one
    check    of the interval by Monte Carlo, where one was made
    """

    quantity: str
    value: float | None
    unit: str
    parts: Mapping[str, float]
    freedom: Mapping[str, float]
    coverage: float
    unknown: str = ""
    check: Check | None = None

    @cached_property
    def std(self) -> float:
        """Combined std."""
        return sqrt(sum(part**2 for part in self.parts.values()))

    @cached_property
    def effective_freedom(self) -> float:
        """Degrees of freedom of the combined std, by Welch and Satterthwaite (GUM G.4)."""
        scatter = sum((part / self.std) ** 4 / self.freedom.get(name, inf) for name, part in self.parts.items())
        return 1 / scatter if scatter > 0 else inf

    @cached_property
    def factor(self) -> float:
        """Coverage factor: the quantile of Student's t."""
        tail, freedom = (1 - self.coverage) / 2, self.effective_freedom
        return float(student_isf(tail, freedom) if isfinite(freedom) else normal_isf(tail))

    @property
    def interval(self) -> tuple[float, float] | None:
        """Its ends; None where the value is not known."""
        if self.unknown or self.value is None:
            return None
        return self.value - self.factor * self.std, self.value + self.factor * self.std

    @property
    def agrees(self) -> bool | None:
        """Whether its interval is that by Monte Carlo; None where this was not checked, or is not decided."""
        return None if self.check is None or self.interval is None else self.check.agrees(self.interval)

    @property
    def largest(self) -> str:
        """The contribution with the largest std."""
        return max(self.parts, key=lambda name: self.parts[name])

    @property
    def share(self) -> float:
        """Share of that in the variance."""
        return (self.parts[self.largest] / self.std) ** 2

    @property
    def halving_ratio(self) -> float | None:
        """What the std of the largest must fall to, over what it is, for half the combined std; None where none does.

        c² of u² is the largest: c_new² = u²/4 - (u² - c²).
        """
        remaining = 0.25 / self.share - (1 / self.share - 1)
        return sqrt(remaining) if remaining > 0 else None

    def remedy(self, stated: Mapping[str, Contribution]) -> str:
        """What would halve the std, in words; `stated` are the contributions by name."""
        name, ratio = self.largest, self.halving_ratio
        if ratio is None:
            rest = [other for other in self.parts if other != name]
            second = max(rest, key=lambda other: self.parts[other])
            return f"not {name} alone: without it {sqrt(1 - self.share):.0%} of the std stay; {second} comes next"
        if name in TYPE_A:
            return TYPE_A[name].format(ratio**-2)
        one = stated[name]
        return (
            f"{name} known to a std of {one.std * ratio:.2g} {one.unit} in place of {one.std:.2g} would halve the std"
        )

    def to_data(self, stated: Mapping[str, Contribution]) -> dict[str, Any]:
        """Plain data; numbers None where there is no interval."""
        data: dict[str, Any] = {"value": self.value, "unit": self.unit}
        if self.unknown:
            return data | {"std": None, "unknown": self.unknown}
        ratio, one, check = self.halving_ratio, stated.get(self.largest), self.check
        if check is not None:
            data["monte_carlo"] = vars(check) | {"ends": list(check.ends), "agrees": self.agrees}
        return data | {
            "contributions": dict(self.parts),
            "std": self.std,
            "freedom": self.effective_freedom if isfinite(self.effective_freedom) else None,
            "factor": self.factor,
            "interval": None if self.interval is None else list(self.interval),
            "largest": self.largest,
            "share": self.share,
            "halved_at_std": None if ratio is None or one is None else one.std * ratio,
            "halved_by": self.remedy(stated),
        }


def tolerance_of(std: float, digits: int) -> float:
    """Half of the last of so many digits of a std: to what ends of an interval are compared (JCGM 101:2008, 7.9.2)."""
    exponent = int(f"{std:.{digits - 1}e}".partition("e")[2])
    return 0.5 * 10.0 ** (exponent - digits + 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class UncertaintyBudget(Tabular):
    """Lines of a budget, with the contributions that were stated.

    kind    what the lines are of: `parameters`, or `components` of a contact wrench
    trials  refits of a check by Monte Carlo, 0 without one, to `digits` of each std
    """

    kind: str
    lines: tuple[BudgetLine, ...]
    contributions: tuple[Contribution, ...]
    coverage: float
    trials: int = 0
    digits: int = 1

    @property
    def stated(self) -> Mapping[str, Contribution]:
        """The contributions by name."""
        return {contribution.name: contribution for contribution in self.contributions}

    def __getitem__(self, quantity: str) -> BudgetLine:
        """The line of a quantity; InputError for none."""
        for line in self.lines:
            if line.quantity == quantity:
                return line
        names = ", ".join(line.quantity for line in self.lines)
        raise InputError(what=f"there is no {quoted(quantity)} in it", where="budget", remedy=f"use one of {names}")

    @property
    def _scatters(self) -> list[str]:
        """Contributions from the scatter of readings that any line has."""
        return [name for name in TYPE_A if any(name in line.parts for line in self.lines)]

    @property
    def table(self) -> Table:
        """Value, std of each contribution under its number, combined std, coverage factor, and ends of the interval."""
        names = [*self._scatters, *self.stated]
        heads = [*self._scatters, *map(str, range(1, len(self.stated) + 1))]
        ends = (f"{100 * self.coverage:g} % from", "to")
        columns = [
            Column(self.kind.removesuffix("s")),
            Column("value", format=".6g"),
            *(Column(head, format=".2g", unknown="") for head in heads),
            Column("std", format=".2g", unknown=NOT_IDENTIFIABLE),
            Column("k", format=".3g", unknown=""),
            *(Column(end, format=".6g", unknown="") for end in ends),
            Column("unit"),
        ]
        return Table.of(columns, [self._row(line, names) for line in self.lines])

    def _row(self, line: BudgetLine, names: list[str]) -> tuple[Value, ...]:
        known = not line.unknown
        ends = line.interval or (None, None)
        shown = [Cell(end, format=digits_of(end, line.std)) if end is not None else None for end in (line.value, *ends)]
        std: Value = line.std if known else Cell(None, line.unknown)
        sizes = (line.parts.get(name) if known else None for name in names)
        parts = [0.0 if size is not None and size < NEGLIGIBLE * line.std else size for size in sizes]
        return (line.quantity, shown[0], *parts, std, line.factor if known else None, *shown[1:], line.unit)

    @property
    def contribution_table(self) -> Table:
        """Number, name, quantity, std, distribution and degrees of freedom of what was stated."""
        rows = [
            (
                str(number),
                one.name,
                one.quantity,
                one.std,
                one.unit,
                ("uniform" if one.uniform else "normal") + ", another in each recording" * one.each_recording,
                one.freedom,
            )
            for number, one in enumerate(self.contributions, start=1)
        ]
        freedom = Column("freedom", format=".3g", unknown="many")
        std = Column("std", format=".2g")
        return Table.of(("", "contribution", "quantity", std, "unit", "distribution", freedom), rows)

    @property
    def halving_table(self) -> Table:
        """The largest contribution to each line, its share of the variance, and what would halve the std."""
        rows = [
            (line.quantity, line.largest, line.share, line.remedy(self.stated))
            for line in self.lines
            if not line.unknown
        ]
        share = Column("of the variance", format=SHARE)
        return Table.of((self.kind.removesuffix("s"), "largest contribution", share, "to halve the std"), rows)

    @property
    def check_table(self) -> Table:
        """Both intervals of every line that was checked, how far they may be apart, and whether they agree."""
        heads = ("linear from", "to", "Monte Carlo from", "to", "tolerance")
        columns = (Column(self.kind.removesuffix("s")), *(Column(h, format=".6g") for h in heads), Column("agrees"))
        words = {True: "yes", False: "no", None: "undecided"}
        rows = [
            (line.quantity, *line.interval, *line.check.ends, line.check.tolerance, words[line.agrees])
            for line in self.lines
            if line.check is not None and line.interval is not None
        ]
        return Table.of(columns, rows)

    def remarks(self) -> list[str]:
        """What a check by Monte Carlo says, where there was one."""
        if not self.trials:
            return []
        checked = [line for line in self.lines if line.check is not None]
        of = f"{self.trials} refits, to {'one digit' if self.digits == 1 else 'two digits'} of the std"
        apart, undecided = (
            ", ".join(line.quantity for line in checked if line.agrees is verdict) for verdict in (False, None)
        )
        if not apart and not undecided:
            return [f"Monte Carlo and law of propagation agree for every parameter ({of})."]
        said = [f"The law of propagation gives another interval than Monte Carlo for {apart}: take the latter ({of})."]
        also = [f"Whether they agree is not decided for {undecided}: take more trials ({of})."]
        return [*(said if apart else []), *(also if undecided else [])]

    def printed(self) -> list[Table | str]:
        """The contributions, the budget, what would halve each std, and the check where there was one."""
        check: list[Table | str] = ["", self.check_table, *self.remarks()] if self.trials else []
        return [self.contribution_table, "", self.table, "", self.halving_table, *check]

    def to_data(self) -> dict[str, Any]:
        """Contributions, and every line by its quantity, as plain data."""
        data: dict[str, Any] = {
            "coverage": self.coverage,
            "contributions": [
                vars(one) | {"freedom": one.freedom if isfinite(one.freedom) else None} for one in self.contributions
            ],
            self.kind: {line.quantity: line.to_data(self.stated) for line in self.lines},
        }
        return data | ({"trials": self.trials, "digits": self.digits} if self.trials else {})
