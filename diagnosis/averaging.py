"""Average over the models that a diagnosis could not tell apart: estimates with the doubt between them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.validation import validation_fit
from diagnosis.held_out import RecordingDisturbance
from diagnosis.verdict.aliasing import Alias
from diagnosis.verdict.finding import Finding
from diagnosis.verdict.selection_step import SelectionStep
from estimation.centre_of_mass import SIGNIFICANT, CentreOfMass
from estimation.contact.contact_wrench import Alternative, CalibratedModel
from estimation.fit import Fit, as_reported
from estimation.fit_column_space import fit_column_space
from estimation.multiplicity import student_isf, student_sf
from modeling.errors import InputError, quoted, suggestion
from modeling.number_format import (
    NOT_IDENTIFIABLE,
    as_sentence,
    digits_of,
    estimate_text,
    finite,
    interval_text,
    probability_text,
)
from modeling.significance import LEVELS
from modeling.table import Cell, Column, Table, Tabular, Value

Array = NDArray[np.float64]

LEAST_WEIGHT = 1e-3
"""Weight below which a model is left out: were all of it beyond one end of a 95 % interval, that end would move by 1 %
of the interval's half width (a tail of 2.5 % against one of 2.4 %), less than the two digits of a std show."""
PER_PARAMETER = 1.0
"""Added to the chi-square for each free parameter: by as much is it lower because that was fitted, so that the sum is
the mean deviance over what the readings leave open. Two, as Akaike has it, or more would count simplicity as evidence,
which the larger of two models that the readings do not tell apart then lacks (docs/decisions/averaging.md)."""
ROUNDING = 1e-9
"""Of a chi-square that two models differ by, which are one."""
MOST_LOG_ODDS = 25.0
"""Of two models, either way: a weight of 1e-11, as good as none, which the weights of the others, rounded as numbers,
still leave to the model chosen, as in a model file."""
MOST_ROUNDS = 5
"""Refits, each from where the last one ended: six axes with thirty elements of crosstalk take a hundred steps."""
MOST_MEMBERS = 12
"""Models that are refitted, those with the smallest chi-square first: a time limit, where two or more effects each have
several others in their place."""
CENTRE = "centre_of_mass."
"""Before the name of an axis."""
HALVINGS = 60
"""Of a bracket of a quantile: to the last digit."""


@dataclass(frozen=True, eq=False)
class Member:
    """One of the models, fitted to the recordings of the diagnosis in their noise.

    name      ids of its effects that others have another in the place of
    deviance  mean of the chi-square of all recordings, held-out ones too, over what they leave open of its parameters;
              not a number where there is nothing to compare it with
    log_odds  natural logarithm of its weight over that of the model chosen
    """

    name: str
    fit: Fit
    deviance: float = np.nan
    log_odds: float = 0.0
    weight: float = 1.0

    def to_data(self) -> dict[str, Any]:
        """Effects, weight and mean deviance as plain data."""
        effects = [effect.id for effect in self.fit.model.effects]
        return {"name": self.name, "weight": self.weight, "deviance": finite(self.deviance), "effects": effects}


@dataclass(frozen=True, eq=False)
class AveragedEstimate:
    """One quantity that every member estimates, in `unit`: a mixture of their Student's t distributions.

    weights, values, stds, freedoms   (members,), of the model chosen first; the std is zero where a model fixes it, and
        infinite where it is not identifiable
    low, high   (members,) ends of each member's own interval at `level`
    is_bias     whether it is a zero of the sensor, which is nobody's question
    """

    name: str
    unit: str
    weights: Array
    values: Array
    stds: Array
    freedoms: Array
    low: Array
    high: Array
    level: float = LEVELS.confidence
    is_bias: bool = False

    @property
    def known(self) -> bool:
        """Whether it is identifiable in every member."""
        return bool(np.isfinite(self.stds).all())

    @property
    def value(self) -> float:
        """Mean over the members."""
        return float(self.weights @ self.values)

    @property
    def within(self) -> float:
        """Std within the members: root of the mean of their variances."""
        return float(np.sqrt(self.weights @ self.stds**2))

    @property
    def between(self) -> float:
        """Std between the members' estimates."""
        return float(np.sqrt(self.weights @ (self.values - self.value) ** 2))

    @property
    def std(self) -> float:
        """Std of the mixture, by the law of total variance."""
        return float(np.sqrt(self.weights @ (self.stds**2 + (self.values - self.value) ** 2)))

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Quantiles of the mixture that leave equal tails; of one member its own interval."""
        tail = (1 - self.level) / 2
        return self._quantile(tail, self.low), self._quantile(1 - tail, self.high)

    @property
    def outside(self) -> float:
        """Probability, given the mixture, that the quantity is outside the interval of the model chosen.

        By a member that does not identify it, it may be anywhere.
        """
        low, high = float(self.low[0]), float(self.high[0])
        inside = np.where(np.isfinite(self.stds), self._below(high) - self._below(low, or_at=False), 0.0)
        return float(1 - self.weights @ inside)

    @property
    def doubtful(self) -> bool:
        """Whether the interval of the model chosen is wrong more than twice as often as it says.

        It is the standard that p-values are held to, which a calibration withholds where false alarms are more than
        twice as frequent as stated.
        """
        return bool(np.isfinite(self.stds[0])) and self.outside > 2 * (1 - self.level)

    @property
    def is_of_tool_line(self) -> bool:
        """Whether it is the mass or a coordinate of the centre of mass, which one compares with scales and drawing."""
        return self.name == "m" or self.name.startswith(CENTRE)

    @property
    def in_words(self) -> str:
        """Value with std, and the interval, of what is known."""
        interval = interval_text(*self.interval, self.std)
        return (
            f"{estimate_text(self.value, self.std, self.unit)}, {100 * self.level:g} % interval {interval} {self.unit}"
        )

    def _below(self, end: float, *, or_at: bool = True) -> Array:
        """Probability (members,) that it is below an end, `or_at` it where a member fixes it there."""
        distance = end - self.values
        fixed = (distance >= 0) if or_at else (distance > 0)
        scaled = distance / np.where(self.stds > 0, self.stds, 1.0)
        return np.where(self.stds > 0, student_sf(-scaled, self.freedoms), fixed)

    def _quantile(self, probability: float, ends: Array) -> float:
        """By halving between the members' own quantiles, their `ends` (members,), or a value that a member fixes."""
        low, high = float(ends.min()), float(ends.max())
        for fixed in self.values[self.stds == 0]:
            if self.weights @ self._below(fixed, or_at=False) < probability <= self.weights @ self._below(fixed):
                return float(fixed)
        for _ in range(HALVINGS if low < high else 0):
            middle = (low + high) / 2
            low, high = (low, middle) if self.weights @ self._below(middle) >= probability else (middle, high)
        return high

    def row(self) -> list[Value]:
        """Name, mean, stds within, between and of both, ends, unit, and the members' estimates."""
        if not self.known:
            return [self.name, None, None, None, None, None, None, self.unit, *([None] * len(self.values))]
        mean, low, high = (Cell(v, format=digits_of(v, self.std)) for v in (self.value, *self.interval))
        each = (Cell(float(v), format=digits_of(float(v), self.std)) for v in self.values)
        return [self.name, mean, self.within, self.between, self.std, low, high, self.unit, *each]

    def to_data(self) -> dict[str, Any]:
        """As plain data, the members' estimates in their order."""
        low, high = self.interval if self.known else (None, None)
        numbers = {
            "value": self.value, "std": self.std, "within": self.within, "between": self.between,
            "low": low, "high": high, "outside": self.outside if self.known else None,
        }  # fmt: skip
        data: dict[str, Any] = finite(
            {key: number if self.known else None for key, number in numbers.items()}
            | {"unit": self.unit, "doubtful": self.doubtful}
            | {"values": self.values.tolist(), "stds": self.stds.tolist()}
        )
        return data


@dataclass(frozen=True, eq=False)
class ModelAverage(Tabular):
    """Estimates with the doubt between the models that a diagnosis could not tell apart: `diagnosis.averaged`.

    Parameters
    ----------
    members : tuple of Member
        The models with their weights, the one chosen first.
    left_out : tuple of str
        Members that have no weight to speak of, as sentences.
    unfitted : tuple of str
        Members that could not be fitted to the readings, so that nothing is known of their weight, as sentences.
    tool_known : bool
        Whether the recordings say what the tool weighs.

    Notes
    -----
    Averaged are the parameters that every member has under the same name, and so of the same meaning, and the
    coordinates of the centre of mass in m, 0 where a member has it on the tip's axis. One of an effect that some
    members lack is not: it has a value only if that effect is there, which is in the `fit` of each member.

    With D the mean of a member's chi-square over what the readings leave open of its parameters, the least chi-square
    plus the number of free ones, and d by how much it is lower than that of the model chosen, their odds are
    exp(d |d| / (2 |d| + s)). That is the likelihood ratio exp(d / 2) where |d| is large against s, the squared distance
    |P - P'|² of the projections onto what each can fit: by fitting noise, d has a variance of 2 s.

    An interval leaves equal tails of the mixture of the members' Student's t distributions (model-averaged tail area:
    D. Turek and D. Fletcher, Comput. Stat. Data Anal. 56 (2012) 2809-2815). That of a single member is its own.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> candidates = [tw.effects.viscous_drag(), tw.effects.sensor_lag()]
    >>> average = tw.diagnose(tw.planar(rig), tw.read("train.csv", rig=rig), effects=candidates).averaged
    >>> [(member.name, member.weight) for member in average.members]
    [('the model chosen', 1.0)]
    """

    members: tuple[Member, ...]
    left_out: tuple[str, ...] = ()
    unfitted: tuple[str, ...] = ()
    tool_known: bool = True

    @classmethod
    def of(
        cls,
        step: SelectionStep,
        findings: Sequence[Finding],
        disturbances: Sequence[RecordingDisturbance] = (),
        *,
        tool_known: bool = True,
    ) -> ModelAverage:
        """Of the last step of a diagnosis, and of each set with effects confusable with its own in their place.

        The `disturbances` are those of its held-out recordings. The centre of mass is averaged where the tool is known.
        """
        exchanges, unfitted = _exchanges(step, findings), list[str]()
        if not exchanges:
            return cls((Member("the model chosen", step.fit),), tool_known=tool_known)
        replaced = list(dict.fromkeys(added for exchange in exchanges for added in exchange))
        deviance = _mean_deviance(step.tested, step.fit, step.validation, disturbances)
        members, basis = [Member(" + ".join(replaced), step.fit, deviance)], _basis(step.tested)
        for exchange in exchanges:
            name = " + ".join(exchange[i].effect.id if i in exchange else i for i in replaced)
            try:
                tested = _refitted(step.tested, exchange)
                fit = as_reported(tested)
                deviance = _mean_deviance(tested, fit, step.validation, disturbances)
            except InputError as error:
                unfitted.append(f"not told apart, but left out: {name} ({error.what})")
                continue
            if tested.converged and fit.converged:
                odds = _log_odds(members[0].deviance - deviance, basis, _basis(tested))
                members.append(Member(name, fit, deviance, odds))
            else:
                unfitted.append(f"not told apart, but left out: {name}, whose refit has not converged")
        weighed = _weighed(members)
        light = [m for m in weighed[1:] if m.weight < LEAST_WEIGHT]
        left_out = tuple(f"{m.name} is left out: its weight is {probability_text(m.weight)}" for m in light)
        return cls(_weighed([m for m in weighed if m not in light]), left_out, tuple(unfitted), tool_known)

    @cached_property
    def estimates(self) -> tuple[AveragedEstimate, ...]:
        """What is averaged: the parameters of every member, then the coordinates of the centre of mass."""
        return (*_parameters(self.members), *(_centre_of_mass(self.members) if self.tool_known else ()))

    def __getitem__(self, name: str) -> AveragedEstimate:
        """The estimate of that name; InputError, with what was meant, for none."""
        estimates = {estimate.name: estimate for estimate in self.estimates}
        if name not in estimates:
            remedy = suggestion(str(name), estimates)
            raise InputError(
                what=f"no parameter of every member is called {quoted(name)}", where="average", remedy=remedy
            )
        return estimates[name]

    @property
    def calibration(self) -> CalibratedModel:
        """For compensation: the model chosen, with the others as alternatives."""
        chosen, *others = self.members
        alternatives = (Alternative(one.name, one.weight, CalibratedModel.of(one.fit)) for one in others)
        return replace(CalibratedModel.of(chosen.fit), alternatives=tuple(alternatives))

    @property
    def doubtful(self) -> tuple[AveragedEstimate, ...]:
        """The parameters, but for zeros of the sensor, of which the model chosen alone would claim to know too much."""
        return tuple(e for e in self.estimates if e.doubtful and not e.is_bias)

    @property
    def sentences(self) -> list[str]:
        """How probable each member is, mass and centre of mass with each and averaged, and what else is not known."""
        unknown = [as_sentence(f"{sentence}; nothing here has the doubt of it") for sentence in self.unfitted]
        if len(self.members) == 1 or not self.doubtful:
            return unknown
        chances = ", ".join(f"{member.name} {probability_text(member.weight)}" for member in self.members)
        lines = [f"Which of the indistinguishable effects is there (probability: {chances}) decides what these are:"]
        others = [e.name for e in self.doubtful if not e.is_of_tool_line]
        for e in (e for e in self.doubtful if e.is_of_tool_line):
            each = zip(self.members, e.values.tolist(), e.stds.tolist(), strict=True)
            ifs = ", ".join(f"{estimate_text(value, std, e.unit)} if {member.name}" for member, value, std in each)
            axis = e.name.removeprefix(CENTRE)
            name = e.name if axis == e.name else f"the centre of mass along {axis}"
            lines.append(f"{name} is {ifs}{f'; averaged {e.in_words}' if e.known else ''}.")
        also = "also " if len(lines) > 1 else ""
        named = [f"{also}{', '.join(others)}: see averaged in result.json, diagnosis.averaged."] if others else []
        return [*lines, *named, *unknown]

    @property
    def table(self) -> Table:
        """Of each parameter mean, std within and between the members, both, interval, and the members' estimates."""
        names, level = ("std within", "std between", "std"), self.estimates[0].level
        stds = [Column(name, format=".2g") for name in names]
        columns = [Column("parameter"), Column("value", unknown=NOT_IDENTIFIABLE), *stds]
        columns += [Column(f"{100 * level:g} % from"), Column("to"), Column("unit")]
        columns += [Column(f"{member.name} ({probability_text(member.weight)})") for member in self.members]
        return Table.of(columns, [estimate.row() for estimate in self.estimates])

    def remarks(self) -> list[str]:
        """What the weights are, which members are left out, and which parameters are doubtful."""
        if len(self.members) == 1:
            return ["All weight is on the model chosen: these are its fit's.", *self.left_out, *self.unfitted]
        names = " and ".join(member.name for member in self.members)
        chance = (
            f"In brackets: how probable each of {names} is, if one of them is there, and each was as likely before."
        )
        doubtful = ", ".join(estimate.name for estimate in self.doubtful)
        doubt = f"The model chosen alone would be wrong more than twice as often as it says in {doubtful}."
        return [chance, *self.left_out, *self.unfitted, *([doubt] if doubtful else [])]

    def to_data(self) -> dict[str, Any]:
        """Members and estimates as plain data."""
        return {
            "members": [member.to_data() for member in self.members],
            "level": self.estimates[0].level,
            "parameters": {estimate.name: estimate.to_data() for estimate in self.estimates},
            "left_out": [*self.left_out, *self.unfitted],
        }


# ---------------------------------------------------------------------------- members, and their weights


Exchange = Mapping[str, Alias]
"""Aliases by the id of the added effect in whose place they are."""


def _exchanges(step: SelectionStep, findings: Sequence[Finding]) -> list[Exchange]:
    """The sets of effects beside the one chosen, those first whose chi-square is lowest."""
    choices: list[list[tuple[tuple[str, Alias], ...]]] = []
    for finding in findings:
        confusable = [((finding.effect.id, alias),) for alias in finding.aliases if alias.confusable]
        choices += [[(), *confusable]] if confusable else []
    exchanges: list[Exchange] = [dict(pair for pairs in choice for pair in pairs) for choice in product(*choices)]
    size = len(step.fit.model.effects)
    distinct = [e for e in exchanges if e and len(_ids(step.fit, e)) == size]
    return sorted(distinct, key=lambda exchange: sum(a.excess for a in exchange.values()))[: MOST_MEMBERS - 1]


def _ids(fit: Fit, exchange: Exchange) -> set[str]:
    """Ids of a model's effects after the exchange; fewer than it has, where one would be there twice."""
    return {exchange[e.id].effect.id if e.id in exchange else e.id for e in fit.model.effects}


def _refitted(chosen: Fit, exchange: Exchange) -> Fit:
    """The model chosen with other effects in the place of some of its own, in the same noise, from where these imitate
    them best."""
    model, values = chosen.model, chosen.values
    for added, alias in exchange.items():
        model = model.without(added) + (alias.as_fitted or alias.effect)
        values |= alias.values
    fitted = chosen.refitted(model, values)
    for _ in range(MOST_ROUNDS - 1):
        if fitted.converged:
            break
        fitted = fitted.refitted(model)
    return fitted


def _mean_deviance(
    tested: Fit, fit: Fit, validation: Sequence[Comparison], disturbances: Sequence[RecordingDisturbance]
) -> float:
    """Of a model by its minimum in the noise of the search, and as it is reported.

    A held-out recording adds what the chi-square of both together is higher by: to first order the least of its own and
    that of the change of the estimates.
    """
    free = sum(not p.fixed for p in tested.unknowns) - len(tested.unidentifiable)
    deviance = tested.problem.chi_square(tested.theta) + PER_PARAMETER * free
    for compared in validation:
        own = [d for d in disturbances if d.recording.is_reading_of(compared.recording)]
        start = {f"{d.effect.id}.{name}": e.value for d in own for name, e in d.parameters.items()}
        carried = validation_fit(fit, compared.recording, compared.noise, [d.effect for d in own], start)
        rows = carried.standardised_residual().rows
        deviance += float(rows @ rows)
    return deviance


def _basis(fit: Fit) -> Array:
    """Orthonormal basis (rows, k) of what a model can fit of the whitened readings, to first order."""
    space = fit_column_space(fit)
    return space.basis_in(slice(0, len(space.residual)))


def _log_odds(gain: float, chosen: Array, other: Array) -> float:
    """Of a model to the one chosen, whose mean deviance is lower by `gain` or higher, by the bases (rows, k) of both.

    The gain has the variance 4 l + 2 s about l where the other model is the true one, about -l where the one chosen is:
    l is the separation of the two, s the squared distance of the projections, by which noise is fitted. The logarithm
    of the odds is gain l / (2 l + s) then, with the size of the gain itself as estimate of l.
    """
    apart = chosen.shape[1] + other.shape[1] - 2 * float(((chosen.T @ other) ** 2).sum())
    log_odds = gain * abs(gain) / (2 * abs(gain) + max(apart, ROUNDING))
    return float(np.clip(log_odds, -MOST_LOG_ODDS, MOST_LOG_ODDS))


def _weighed(members: Sequence[Member]) -> tuple[Member, ...]:
    """The members with weights that sum to one."""
    log_odds = np.array([member.log_odds for member in members])
    weights = np.exp(log_odds - log_odds.max())
    return tuple(replace(m, weight=float(w)) for m, w in zip(members, weights / weights.sum(), strict=True))


# ---------------------------------------------------------------------------------------- what is averaged


def _parameters(members: Sequence[Member]) -> Iterator[AveragedEstimate]:
    """The parameters of all members, in the order of the first."""
    weights = np.array([member.weight for member in members])
    fits = [member.fit for member in members]
    ends = [fit.intervals() for fit in fits]
    biases = {p.name for p in fits[0].model.biases}
    for name, estimate in fits[0].parameters.items():
        if all(name in fit for fit in fits):
            each = zip(fits, ends, ([*fit].index(name) for fit in fits), strict=True)
            numbers = [(f.theta[i], f[name].std, e.freedom[i], e.low[i], e.high[i]) for f, e, i in each]
            values, stds, freedoms, low, high = np.array(numbers).T
            is_bias = name.partition("@")[0] in biases
            yield AveragedEstimate(
                name, estimate.unit, weights, values, stds, freedoms, low, high, ends[0].level, is_bias
            )


def _centre_of_mass(members: Sequence[Member]) -> Iterator[AveragedEstimate]:
    """Its coordinates, where every member has a significant mass, with the degrees of freedom of that."""
    fits = [member.fit for member in members]
    if not all(fit["m"].std < abs(fit["m"].value) / SIGNIFICANT for fit in fits):
        return
    weights, centres = np.array([member.weight for member in members]), [CentreOfMass.of(fit) for fit in fits]
    freedoms = np.array([fit.intervals().freedom[[*fit].index("m")] for fit in fits])
    for axis in dict.fromkeys(axis for centre in centres for axis in centre.axes):
        own = [dict(zip(c.axes, zip(c.value, c.std, strict=True), strict=True)).get(axis, (0.0, 0.0)) for c in centres]
        values, stds = np.array(own).T
        half = student_isf(0.5 - LEVELS.confidence / 2, freedoms) * stds
        yield AveragedEstimate(f"{CENTRE}{axis}", "m", weights, values, stds, freedoms, values - half, values + half)
