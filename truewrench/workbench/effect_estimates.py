"""Estimates of a model's effects in words: sizes, what is fixed, and whether an effect can be dropped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.study import Study
from estimation.fit import Fit
from estimation.multiplicity import chi2_sf
from modeling.chain.effect import Effect
from modeling.number_format import format_unit, format_with_std
from modeling.significance import LEVELS


def effect_sizes(effect: Effect, fit: Fit) -> str:
    """The parameters of an effect of a fit; those that are fixed at 0 are named as such."""
    estimates = {n.partition(".")[2]: e for n, e in fit.parameters.items() if n.startswith(f"{effect.id}.")}
    fixed = [name for name, e in estimates.items() if e.std == 0 and e.value == 0]
    free = [
        f"{name} = {format_with_std(e.value, e.shown_std)} {format_unit(e.unit)}".rstrip()
        for name, e in estimates.items()
        if name not in fixed
    ]
    return ", ".join([*free, *([f"{', '.join(fixed)} fixed at 0 (not significant)"] if fixed else [])])


def weakness(effect: Effect, study: Study) -> str:
    """What to do about an effect none of whose parameters is significant; empty where one is.

    Effects that are collinear in the recordings each look insignificant, as the others take their place; of those that
    are significant together one can be dropped, not all.
    """
    weak = [e for e in study.model.effects if _is_weak(e, study.fit)]
    if effect not in weak:
        return ""
    together = [e for e in weak if e == effect or _significant([effect, e], study.fit)]
    if len(together) == 1 and _significant(weak, study.fit):
        rest = [e for e in weak if e != effect]
        together = weak if rest and not _significant(rest, study.fit) else together
    if len(together) == 1:
        return "not significant at 1 % in these recordings, drop it"
    names = " and ".join(e.id for e in together)
    least = _cheapest(together, study)
    which = "this one" if least == effect else least.id
    number = "both" if len(together) == 2 else "all"
    return f"{names} share one effect here: drop one, not {number}; dropping {which} costs least"


def _is_weak(effect: Effect, fit: Fit) -> bool:
    estimates = [e for n, e in fit.parameters.items() if n.startswith(f"{effect.id}.")]
    return bool(estimates) and not any(abs(e.value) > LEVELS.nonzero * e.std > 0 for e in estimates)


def _significant(effects: Sequence[Effect], fit: Fit) -> bool:
    """Whether the amplitudes of these effects, together, differ from 0."""
    places = _places(effects, fit)
    return bool(chi2_sf(_wald(places, fit), max(len(places), 1)) < LEVELS.effect)


def _places(effects: Sequence[Effect], fit: Fit) -> list[int]:
    """Of the identifiable amplitudes among a fit's unknowns."""
    names = {p.name for e in effects for p in e.qualified(fit.model.space) if not p.nuisance and not p.fixed}
    return [i for i, p in enumerate(fit.unknowns) if p.name in names and fit.identifiable[i]]


def _wald(places: Sequence[int], fit: Fit) -> float:
    """Wald statistic of these unknowns: the chi-square that is lost, to first order, where all of them are 0."""
    if not places:
        return 0.0
    std = np.sqrt(fit.covariance[places, places])
    values, correlation = fit.theta[places] / std, fit.covariance[np.ix_(places, places)] / np.outer(std, std)
    return float(values @ np.linalg.pinv(correlation, hermitian=True) @ values)


def _cheapest(effects: Sequence[Effect], study: Study) -> Effect:
    """The effect whose removal costs least: by the steps without each, else by its Wald statistic."""
    misfits = {
        frozenset(e.id for e in s.fit.model.effects): sum(c.misfit or 0 for c in s.training) for s in study.steps
    }
    without = [misfits.get(frozenset(study.effects) - {e.id}) for e in effects]
    costs = [_wald(_places([e], study.fit), study.fit) for e in effects]
    exact = [cost for cost in without if cost is not None]
    return effects[int(np.argmin(exact if len(exact) == len(effects) else costs))]
