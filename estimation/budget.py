"""Budget of uncertainty: stated contributions propagated with the noise by the model's own derivatives.

JCGM 100:2008 (GUM), law of propagation; checked by propagation of distributions, JCGM 101:2008.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from math import ceil, isfinite, sqrt
from operator import add
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.budget_table import (
    FORMS,
    BudgetLine,
    Check,
    Contribution,
    Statement,
    UncertaintyBudget,
    size_in,
    tolerance_of,
)
from estimation.contact.contact_wrench import CalibratedModel, ContactMean, ContactWrench
from estimation.fit import Fit
from estimation.least_squares.estimates import HELD, Estimate
from estimation.least_squares.problem import Problem, RecordingInNoise, Solution
from estimation.model_response import missing_inputs
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.effects import STATED, named
from modeling.errors import InputError, kind_of, quoted, suggestion
from modeling.number_format import NOT_IDENTIFIABLE
from modeling.parameter import Parameter, Role
from modeling.rigid_body import Load, inertial_parameters

Array = NDArray[np.float64]

FEWEST_TRIALS, MOST_TRIALS = 50, 100_000
"""Refits of a check: the ends of an interval of 95 % are between the second and third of fifty on either side."""
MOST_DRAWS = 2_000_000
"""Of a linear estimate: hundreds are beyond an end of even the widest interval."""
QUANTILE_ERROR = 2.0
"""Std of an end of a 95 % interval of a normal quantity, in its std, times the root of the number of draws (1.9)."""
RESAMPLES = 200
"""Of the trials, for the std of what they say of the ends: it is known to 5 % then."""


@dataclass(frozen=True, eq=False)
class Source:
    """One number that the model holds at one value while the truth has it with a std.

    parameter  of an effect that the model lacks, or of the model where a bound fixes it; `OF_LOAD` of a load
    std        in that parameter's unit
    shifts     (r, k) change of the estimates for each unit: one row, or one for each recording in which it is another,
               or for each coordinate of a load
    moved      of a load, which recordings carry it (n,), and its moments for each unit (r, k)
    """

    contribution: Contribution
    parameter: str
    std: float
    shifts: Array
    moved: tuple[NDArray[np.bool_], Array] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Budget(UncertaintyBudget):
    """A fit's parameters with noise and stated contributions.

    nominal    the fit's model with its parameters, as the noise alone has them
    estimates  every parameter, with the std of the noise; `freedom` (k,) of that std
    held       names of those that a bound holds
    effects    that the contributions are of, and the model lacks
    sources    the numbers that they are
    """

    nominal: CalibratedModel
    estimates: Mapping[str, Estimate]
    freedom: Array
    held: tuple[str, ...]
    effects: tuple[Effect, ...]
    sources: tuple[Source, ...]

    @classmethod
    def of(
        cls,
        nominal: CalibratedModel,
        estimates: Mapping[str, Estimate],
        freedom: Array,
        held: tuple[str, ...],
        effects: tuple[Effect, ...],
        sources: tuple[Source, ...],
        statement: Statement,
    ) -> Budget:
        """The budget of these estimates, with a line for each that is not fixed."""
        lines = []
        for number, estimate in enumerate(estimates.values()):
            parts = {"noise": estimate.std if isfinite(estimate.std) and estimate.name not in held else 0.0}
            for one in statement.contributions:
                mine = [s for s in sources if s.contribution.name == one.name]
                parts[one.name] = sqrt(sum(s.std**2 * float((s.shifts[:, number] ** 2).sum()) for s in mine))
            unknown = "" if isfinite(estimate.std) else NOT_IDENTIFIABLE
            if not any(parts.values()):
                if estimate.std == 0:
                    continue
                unknown = unknown or HELD
            freedoms = {"noise": float(freedom[number])} | {c.name: c.freedom for c in statement.contributions}
            line = BudgetLine(
                estimate.name, estimate.known, estimate.unit, parts, freedoms, statement.coverage, unknown
            )
            lines.append(line)
        return cls(
            kind="parameters",
            lines=tuple(lines),
            contributions=statement.contributions,
            coverage=statement.coverage,
            digits=statement.digits,
            nominal=nominal,
            estimates=estimates,
            freedom=freedom,
            held=held,
            effects=effects,
            sources=sources,
        )

    @property
    def of_model(self) -> Budget:
        """The same of the model's parameters alone, without the biases of further recordings."""
        size = len(self.nominal.theta)
        names = [*self.estimates][:size]
        return replace(
            self,
            lines=tuple(replace(line, check=None) for line in self.lines if line.quantity in names),
            trials=0,
            estimates={name: self.estimates[name] for name in names},
            freedom=self.freedom[:size],
            sources=tuple(replace(s, shifts=s.shifts[:, :size]) for s in self.sources),
        )

    @property
    def calibration(self) -> CalibratedModel:
        """For compensation: the model with the contributions' effects at their nominal values, as uncertain as stated.

        What the model holds at a nominal value is wrong by as much in the fit as in use, so that an estimate's error
        by it is correlated with it: a gravity that is wrong leaves the weight right.
        """
        model = reduce(add, self.effects, self.nominal.model)
        names = [p.name for p in model.parameters]
        size, known = len(self.nominal.theta), len(self.nominal.model.parameters)
        noise = np.zeros((len(names), len(names)))
        noise[:size, :size] = self.nominal.covariance
        parts = {"parameters": noise} | {one.name: np.zeros_like(noise) for one in self.contributions}
        for source in self.sources:
            errors = np.zeros((len(source.shifts), len(names)))
            errors[:, :size] = source.shifts[:, :size]
            if source.parameter in names[known:]:
                own = np.zeros((1, len(names)))
                own[0, names.index(source.parameter)] = -1.0
                errors = np.vstack([errors, own]) if source.contribution.each_recording else errors + own
            parts[source.contribution.name] += source.std**2 * errors.T @ errors
        return replace(
            self.nominal,
            model=model,
            theta=np.array([*self.nominal.theta, *(p.nominal for p in model.parameters[known:])]),
            covariance=np.sum([*parts.values()], axis=0),
            contributions=parts,
        )

    def of_contact(self, contact: ContactWrench) -> UncertaintyBudget:
        """Of a contact wrench that this budget's calibration compensated: of one row, and of each contact's mean.

        Of one row the std are root mean squares over the recording.
        """
        if not contact.contributions:
            remedy = "compensate with the budget: tw.compensate(budget, recording)"
            raise InputError(what="the contact was compensated without a budget", where="budget", remedy=remedy)
        least = min(
            (f for f, e in zip(self.freedom, self.estimates.values(), strict=True) if e.std > 0), default=np.inf
        )
        freedom = {"parameters": float(least)} | {one.name: one.freedom for one in self.contributions}
        whole = {name: np.sqrt(variance.mean(axis=0)) for name, variance in contact.contributions.items()}
        rows: list[tuple[str, Array | None, Mapping[str, Array]]] = [
            ("one row", None, {"noise": contact.noise_std, **whole})
        ]
        for count, mean in enumerate(contact.means, start=1):
            rows.append((f"contact {count}", mean.wrench, _parts_of_mean(contact, mean)))
        lines = [
            BudgetLine(
                f"{name}, {of}",
                None if value is None else float(value[i]),
                unit,
                {part: float(std[i]) for part, std in parts.items()},
                freedom,
                self.coverage,
            )
            for of, value, parts in rows
            for i, (name, unit) in enumerate(zip(contact.names, contact.space.units, strict=True))
        ]
        return UncertaintyBudget(
            kind="components", lines=tuple(lines), contributions=self.contributions, coverage=self.coverage
        )


def _parts_of_mean(contact: ContactWrench, mean: ContactMean) -> Mapping[str, Array]:
    """Std (p,) of a contact's mean wrench by contribution; the noise is what is left of the whole."""
    inside = slice(mean.interval.first, mean.interval.last)
    variances = {name: variance[inside].mean(axis=0) for name, variance in contact.contributions.items()}
    rest = np.maximum(mean.std**2 - np.sum([*variances.values()], axis=0), 0.0)
    return {"noise": np.sqrt(rest)} | {name: np.sqrt(variance) for name, variance in variances.items()}


def budget(
    fit: Fit,
    contributions: str | Path | Mapping[str, object] | Statement | None = None,
    *,
    effects: Iterable[Effect] = (),
    monte_carlo: int = 0,
    seed: int = 0,
) -> Budget:
    """The uncertainty of a fit's parameters by its noise and by what its model takes as known.

    Parameters
    ----------
    fit : Fit
        A fit by least squares.
    contributions : str, Path, mapping or Statement, optional
        A budget file (TOML), a dictionary of its layout, or what was read of one; see the manual on file formats. By
        default the masses and places alone of the loads that the recordings carried.
    effects : iterable of Effect, optional
        Custom effects that contributions name, beside those of the catalogue.
    monte_carlo : int, optional
        Refits of readings with contributions and noise drawn at random, to check the linear intervals; by default none.
    seed : int, optional
        Of the draws, by default 0.

    Returns
    -------
    Budget
        A line for every parameter: the std that each contribution gives it, coverage factor and interval, in the
        parameter's unit, the largest contribution and what would halve the std. `tw.compensate(budget, recording)`
        propagates it to a contact wrench, and `budget.of_contact(contact)` is that one's budget.

    Raises
    ------
    InputError
        In one line, for a contribution that cannot be: no such effect or unit, estimated by the fit, of one recording
        alone, without a value at which it does nothing.

    Notes
    -----
    A contribution is a parameter x of an effect that the model lacks, of nominal value x0 and std s. With the whitened
    derivatives J of the model and c of the reading in x, the estimates move by A = (J'J)^-1 J'c per unit of x - x0.
    Their covariance is that of the noise plus the sum of s² A A' (GUM 5.1.2). The coverage factor is the quantile of
    Student's t with the effective degrees of freedom (GUM G.4).

    The check draws every contribution from its distribution and the noise from the fit's own, makes readings with the
    effects in them, and fits the model again. What the refits differ by from the linear estimate of the same draws
    moves the ends of an interval in which all distributions are propagated linearly, in a great many draws.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.viscous_drag(), tw.read("train.csv", rig=rig))
    >>> place = {"name": "gravity at the place", "quantity": "gravity", "half_width": 0.03, "unit": "m/s²"}
    >>> line = tw.budget(fit, {"contribution": [place]})["m"]
    >>> print(f"{line.largest}: {line.share:.0%} of the variance")
    gravity at the place: 78% of the variance
    """
    given: object = fit
    if not isinstance(given, Fit):
        remedy = "give a fit of whole recordings: tw.budget(tw.fit(model, recording), ..)"
        raise InputError(what=f"{kind_of(fit)} has no derivatives to propagate by", where="budget", remedy=remedy)
    statement = stated_budget(contributions, monte_carlo)
    chosen = [(one, *_quantity(fit, one, statement.where, tuple(effects))) for one in statement.contributions]
    statement, loads = _with_loads(statement, fit)
    added: dict[str, Effect] = {effect.id: effect for _, effect, _ in chosen if effect is not None}
    extended = _Extended.of(fit, tuple(added.values()))
    sources = tuple(
        Source(one, p.name, one.std * (size_in(p.unit, one.unit) or 1.0), extended.shifts(p.name, one.each_recording))
        for one, _, parameters in chosen
        for p in parameters
    )
    sources += tuple(extended.of_load(one, load, moments) for one, load, moments in loads)
    result = Budget.of(
        CalibratedModel.of(fit),
        fit.parameters,
        fit.intervals().freedom,
        fit.held,
        tuple(added.values()),
        sources,
        statement,
    )
    return _checked(extended, result, monte_carlo, seed) if monte_carlo else result


def stated_budget(
    contributions: str | Path | Mapping[str, object] | Statement | None, monte_carlo: int = 0
) -> Statement:
    """What a budget states, checked before any work together with the number of refits; InputError, in one line."""
    if monte_carlo and not (isinstance(monte_carlo, int) and FEWEST_TRIALS <= monte_carlo <= MOST_TRIALS):
        remedy = f"give {FEWEST_TRIALS} to {MOST_TRIALS}"
        raise InputError(what=f"{quoted(monte_carlo)} is no number of refits", where="Monte Carlo", remedy=remedy)
    if contributions is None:
        return Statement(())
    return contributions if isinstance(contributions, Statement) else Statement.read(contributions)


OF_LOAD = "load"
"""In place of a parameter's name: the mass or the place of a known load."""


def uncertain_loads(fit: Fit) -> dict[Load, str]:
    """The loads of a fit's recordings whose mass or place is uncertain, each once, with a name of its own."""
    names: dict[Load, str] = {}
    for recording in fit.recordings:
        for load in recording.loads:
            if load.known and (load.mass_std or load.at_std) and load not in names:
                name = load.name or f"{load.mass:g} kg"
                names[load] = name if name not in names.values() else f"{name} of {recording.name}"
    return names


def _with_loads(statement: Statement, fit: Fit) -> tuple[Statement, list[tuple[Contribution, Load, slice]]]:
    """A statement with mass and place of each uncertain load, and which of its derivatives each is of."""
    added = []
    for load, name in uncertain_loads(fit).items():
        for word, std, unit, rows in (
            ("mass", load.mass_std, "kg", slice(0, 1)),
            ("place", load.at_std, "m", slice(1, None)),
        ):
            if std:
                added.append((Contribution(f"{word} of {name}"[:60], OF_LOAD, std, unit), load, rows))
    if not (statement.contributions or added):
        remedy = "state contributions, or the std of the loads: 2.000+-0.001@0,0,0.05+-0.001"
        raise InputError(what="nothing that the model takes as known has a std", where=statement.where, remedy=remedy)
    taken = {one.name for one in statement.contributions}
    if clash := next((one.name for one, _, _ in added if one.name in taken), None):
        what = "the name is that of a load's contribution"
        raise InputError(what=what, where=f"{statement.where}: {clash}", remedy="give it another name")
    return replace(statement, contributions=(*statement.contributions, *(one for one, _, _ in added))), added


# ------------------------------------------------------------------- what a contribution is of


def _quantity(
    fit: Fit, one: Contribution, where: str, custom: Sequence[Effect]
) -> tuple[Effect | None, tuple[Parameter, ...]]:
    """The effect of a contribution, and its parameters in the stated unit; InputError where it cannot be one."""
    place = f"{where}: {one.name}"
    of_fit = {p.name: p for p in fit.unknowns}
    if one.quantity in of_fit:
        parameter = of_fit[one.quantity]
        if fit.constrained is None or not fit.constrained.region.fixed[[*of_fit].index(one.quantity)]:
            what = f"the fit estimates {one.quantity}, whose std is that of the noise"
            raise InputError(what=what, where=place, remedy="leave it out, or fix it by bounds")
        return None, _in_unit([parameter], one, place)
    effect_id, dot, wanted = one.quantity.partition(".")
    effect = _effect(effect_id, fit.model, custom, place)
    model = _with(fit.model, effect, place)
    effect = model.effects[-1]
    for recording in fit.recordings:
        if missing := missing_inputs(model, recording):
            what = f"{effect_id} needs {missing[0]}, which {recording.name} lacks"
            raise InputError(what=what, where=place, remedy="record it, or leave the contribution out")
    free = [p for p in effect.qualified(fit.model.space) if not p.fixed]
    nuisance = [p for p in free if p.nuisance or not isfinite(p.nominal)]
    if nuisance:
        what = f"{effect_id} has no derivative where it vanishes, as {nuisance[0].name} is open there"
        raise InputError(what=what, where=place, remedy="add it to the model (--add), which estimates it")
    chosen = [p for p in free if not dot or wanted == p.name.partition(".")[2]]
    if not chosen:
        remedy = suggestion(one.quantity, [p.name for p in free])
        raise InputError(what=f"{effect_id} has no parameter '{wanted[:40]}'", where=place, remedy=remedy)
    chosen = list(_in_unit(chosen, one, place))
    for p in chosen:
        if p.nominal in p.bounds:
            what = f"{p.name} is on one side of {p.nominal:g} alone, so that its error has a mean"
            raise InputError(what=what, where=place, remedy="add the effect to the model (--add), which estimates it")
    return effect, tuple(chosen)


def _in_unit(parameters: Sequence[Parameter], one: Contribution, place: str) -> tuple[Parameter, ...]:
    """Those of the parameters that can be stated in the contribution's unit; InputError for none."""
    chosen = tuple(p for p in parameters if size_in(p.unit, one.unit) is not None)
    if not chosen:
        units = dict.fromkeys(p.unit for p in parameters)
        forms = [form for unit in units for form in (unit, *FORMS.get(unit, {}))]
        raise InputError(
            what=f"the unit of {one.quantity} is not '{one.unit}'", where=place, remedy=f"use {' or '.join(forms)}"
        )
    return chosen


def _effect(effect_id: str, model: WrenchModel, custom: Sequence[Effect], place: str) -> Effect:
    """The effect of that id, of a budget's own, a user's or the catalogue; InputError where it can be none here."""
    if effect_id in {effect.id for effect in model.effects}:
        what = f"the model has {effect_id}, and estimates it"
        raise InputError(what=what, where=place, remedy="leave it out: its std is that of the noise")
    try:
        effect = named_or_stated(effect_id, custom)
    except InputError as error:
        own = ", ".join(kind.id for kind in STATED)
        remedy = (
            f"{error.remedy.rstrip('?')}, or one of {own}?"
            if "did you" in error.remedy
            else f"{error.remedy}; or {own}"
        )
        raise InputError(what=error.what, where=place, remedy=remedy) from None
    if effect.per_recording:
        remedy = "state zero_drift for a drift of the zero" if effect_id == "bias_drift" else "leave it out"
        raise InputError(what=f"{effect_id} is of one recording alone", where=place, remedy=remedy)
    return effect


def named_or_stated(effect_id: str, custom: Sequence[Effect] = ()) -> Effect:
    """The effect of that id among those that only a budget states, the users' and the catalogue."""
    return next((e for e in (*(kind() for kind in STATED), *custom) if e.id == effect_id), None) or named(effect_id)


def _with(model: WrenchModel, effect: Effect, place: str) -> WrenchModel:
    """The model with the effect, as small as it is tested: without points off the tip axis."""
    try:
        return model + effect.restricted(model.space)
    except InputError as error:
        raise InputError(what=error.what, where=place, remedy=error.remedy) from None


# ------------------------------------------------------------------------- derivatives, and draws


@dataclass(frozen=True, eq=False)
class _Extended:
    """A fit whose model has the effects of the contributions at their nominal values.

    solution    what the estimates are the minimum of; `names` of its unknowns
    derivative  (rows, k) of the whitened prediction in these
    columns     (rows,) by name, in the further parameters
    """

    fit: Fit
    solution: Solution
    problem: Problem
    theta: Array
    derivative: Array
    columns: Mapping[str, Array]

    @classmethod
    def of(cls, fit: Fit, effects: tuple[Effect, ...]) -> _Extended:
        solution: Solution = fit.ordinary or fit
        problem = solution.problem.of_model(reduce(add, effects, fit.model))
        names = [p.name for p in problem.layout.parameters]
        values = {p.name: float(v) for p, v in zip(fit.unknowns, fit.theta, strict=True)}
        theta = np.array([values.get(p.name, p.nominal) for p in problem.layout.parameters])
        whole = problem.linearised(theta).whole
        own = [names.index(p.name) for p in fit.unknowns]
        columns = {name: whole[:, i] for i, name in enumerate(names) if i not in own}
        return cls(fit, solution, problem, theta, whole[:, own], columns)

    @property
    def parts(self) -> list[slice]:
        """The rows of each recording."""
        ends = np.cumsum([0, *(noise.whitener.rows for noise in self.solution.noise)])
        return [slice(first, last) for first, last in pairwise(ends.tolist())]

    def shifts(self, parameter: str, each_recording: bool) -> Array:
        """Change of the estimates for each unit of a parameter, (1, k), or (recordings, k) where it is another in each.

        One that a bound fixes is itself wrong by minus that unit.
        """
        names = [p.name for p in self.fit.unknowns]
        fixed = parameter in names
        column = self.derivative[:, names.index(parameter)] if fixed else self.columns[parameter]
        rows = self.parts if each_recording and not fixed else [slice(None)]
        shifts = np.array([self.solution.covariance @ (self.derivative[part].T @ column[part]) for part in rows])
        shifts[:, ~self.fit.identifiable] = 0.0
        if fixed:
            shifts[:, names.index(parameter)] = -1.0
        return shifts

    def of_load(self, one: Contribution, load: Load, rows: slice) -> Source:
        """The source of a load's mass, or of its place: other moments of the tool in the recordings that carry it."""
        moments = load.slopes(self.fit.model.space)[rows]
        carrying = np.array([load in recording.loads for recording in self.fit.recordings])
        column = np.zeros((len(self.derivative), len(moments)))
        for number, part in enumerate(self.parts):
            if carrying[number]:
                column[part] = self.derivative[part][:, self.moments_of(number)] @ moments.T
        shifts = (self.solution.covariance @ (self.derivative.T @ column)).T
        shifts[:, ~self.fit.identifiable] = 0.0
        return Source(one, OF_LOAD, one.std, shifts, (carrying, moments))

    def moments_of(self, number: int) -> NDArray[np.intp]:
        """Places among the fit's unknowns of the moments of the tool in a recording."""
        model, index = self.fit.model, self.fit.layout.index[number]
        first = len(model.biases)
        return index[first : first + len(inertial_parameters(model.space))]


@dataclass(frozen=True, eq=False)
class _DrawnReadings(RecordingInNoise):
    """A recording with other whitened readings (rows,)."""

    drawn: Array

    @property
    def whitened_readings(self) -> Array:
        """Those drawn."""
        return self.drawn


def _checked(extended: _Extended, linear: Budget, trials: int, seed: int) -> Budget:
    """The budget, its intervals checked by `trials` refits of drawn readings."""
    fit, solution = extended.fit, extended.solution
    region = None if fit.constrained is None else fit.constrained.region
    if region is not None and (region.inertia is not None or region.prior is not None):
        what = "a check by Monte Carlo is of least squares within bounds alone"
        raise InputError(what=what, where="Monte Carlo", remedy="leave it out, or --physical, --inside and --prior")
    if onset := next((p.name for p in fit.unknowns if p.role is Role.ONSET and not p.fixed), None):
        what = f"{onset} is the time of an event, which no refit finds anew"
        raise InputError(what=what, where="Monte Carlo", remedy="leave it out; the budget holds without it")
    rng = np.random.default_rng(seed)
    problem = solution.problem
    if region is not None:
        ends = zip(problem.layout.parameters, region.low, region.high, strict=True)
        bounded = tuple(replace(p, bounds=(float(low), float(high))) for p, low, high in ends)
        problem = replace(problem, layout=replace(problem.layout, parameters=bounded))
    root = _root(np.where(np.outer(fit.identifiable, fit.identifiable), fit.covariance, 0.0))
    names = [p.name for p in extended.problem.layout.parameters]
    measured = np.concatenate(extended.problem.measured)
    refits, lines = np.empty((trials, len(fit.theta))), np.empty((trials, len(fit.theta)))
    for trial in range(trials):
        noise = root @ rng.standard_normal(root.shape[1])
        drawn = [_drawn(source, rng, len(source.shifts)) for source in linear.sources]
        lines[trial] = noise + sum(x @ s.shifts for x, s in zip(drawn, linear.sources, strict=True))
        # Rows of unit variance, but for the estimates' share, which has the covariance that is reported.
        rows = rng.standard_normal(len(measured))
        rows += extended.derivative @ (noise - solution.covariance @ (extended.derivative.T @ rows))
        several = any(len(x) > 1 or s.moved is not None for x, s in zip(drawn, linear.sources, strict=True))
        for number, part in enumerate(extended.parts if several else [slice(None)]):
            theta = extended.theta.copy()
            for x, source in zip(drawn, linear.sources, strict=True):
                if source.moved is None:
                    theta[names.index(source.parameter)] += x[number if len(x) > 1 else 0]
                elif source.moved[0][number]:
                    moments = [names.index(fit.unknowns[i].name) for i in extended.moments_of(number)]
                    theta[moments] += x @ source.moved[1]
            rows[part] += (measured - extended.problem.residual(theta))[part]
        data = tuple(
            _DrawnReadings(each.recording, each.noise, rows[part])
            for each, part in zip(solution.problem.data, extended.parts, strict=True)
        )
        refits[trial] = replace(problem, data=data).minimise(fit.theta).theta - fit.theta
    places = {name: number for number, name in enumerate(linear.estimates)}
    for place in (places[s.parameter] for s in linear.sources if s.parameter in places):
        refits[:, place] = lines[:, place]  # a fixed parameter stays where it is, while the truth is elsewhere
    checked = tuple(
        line if line.interval is None else replace(line, check=_check(linear, line, places, refits, lines, rng))
        for line in linear.lines
    )
    return replace(linear, lines=checked, trials=trials)


def _check(
    linear: Budget,
    line: BudgetLine,
    places: Mapping[str, int],
    refits: Array,
    lines: Array,
    rng: np.random.Generator,
) -> Check:
    """Ends of linear propagation in many draws, moved by what the refits differ by at these ends.

    The interval is as wide as it has to be to cover the truth so often, though the std of the noise is itself
    estimated: JCGM 101 would take Student's t for the noise (6.4.9), whose std is infinite at two degrees of freedom.
    """
    coverage, number = linear.coverage, places[line.quantity]
    refits, lines = refits[:, number], lines[:, number]
    draws = min(ceil(1e4 / (1 - coverage) * (1 if linear.digits == 1 else 4)), MOST_DRAWS)  # JCGM 101:2008, 7.2.1
    normal, total, variance = line.parts["noise"] ** 2, np.zeros(draws), np.zeros(draws)
    for source in linear.sources:
        if source.contribution.uniform:
            for shift in source.shifts[:, number]:
                total += shift * _drawn(source, rng, draws)
        else:
            normal += source.std**2 * float((source.shifts[:, number] ** 2).sum())
    total += sqrt(normal) * rng.standard_normal(draws)
    for name, part in line.parts.items():
        freedom = line.freedom[name]
        variance += part**2 * (rng.chisquare(freedom, draws) / freedom if isfinite(freedom) else 1.0)
    half = line.std * float(np.quantile(np.abs(total) / np.sqrt(variance), coverage))  # they are symmetric
    tails, again = ((1 - coverage) / 2, (1 + coverage) / 2), rng.integers(len(refits), size=(RESAMPLES, len(refits)))
    low, high = (np.quantile(refits, tails) - np.quantile(lines, tails)).tolist()
    scatter = (np.quantile(refits[again], tails, axis=1) - np.quantile(lines[again], tails, axis=1)).std(axis=1).max()
    assert line.value is not None
    return Check(
        ends=(line.value - half + low, line.value + half + high),
        error=float(np.hypot(scatter, QUANTILE_ERROR * line.std / sqrt(draws))),
        tolerance=tolerance_of(line.std, linear.digits),
    )


def _root(covariance: Array) -> Array:
    """A square root of a covariance (k, k) that may be singular."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _drawn(source: Source, rng: np.random.Generator, count: int) -> Array:
    """So many draws of a source, about its nominal value, in its unit: uniform or normal."""
    uniform = source.contribution.uniform
    return source.std * (rng.uniform(-sqrt(3), sqrt(3), count) if uniform else rng.standard_normal(count))
