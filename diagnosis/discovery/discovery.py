"""Discover: an equation for what no effect explains, tested on another motion, or none."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.comparison.model_comparison import ModelComparison, compare, compare_models
from diagnosis.discovery.grammar import COMPLEXITY, terms
from diagnosis.discovery.leaves import Leaf, recorded_leaves, shape_ranges
from diagnosis.discovery.search import (
    FoundTerm,
    ScoredTerm,
    TermSearch,
    best_candidates,
    best_term,
    in_noise_beside_columns,
)
from diagnosis.progress import Progress, count_progress, silent
from estimation.fit import Fit, fit, recordings_of, reestimated_noise
from estimation.model_response import predicted_readings
from estimation.recordings.recording import Recording, require_different_readings
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.formulas.custom_effect import CustomEffect
from modeling.number_format import P_VALUE, p_value_text
from modeling.significance import LEVELS
from modeling.space import Space
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]

LITTLE_EXCITED = 20.0
"""Drop of chi-square on the motions held out, with refitted amplitudes, below which they tell nothing of a term: there
a true one is found in half of the cases."""
LEAST_EXPLAINED = 0.8
"""Share of the excess on the motions held out that the terms together have to explain where what they leave is beyond
noise: forms that only resemble the true one left a quarter and more, and predicted a third motion worse."""
MOST_TERMS = 3
"""Terms that are looked for, each given the earlier ones."""


@dataclass(frozen=True, eq=False)
class FoundEquation:
    """A term that was found, as a custom effect.

    parameters    (value, std, unit) by name, of the fit of all terms
    share         of the excess of chi-square on the fitted motion that it explains, given the earlier terms
    held_out      the same on the motions held out, its parameters carried over
    rivals        the alternatives as custom effects, in their order
    """

    effect: CustomEffect
    found: FoundTerm
    parameters: Mapping[str, tuple[float, float, str]]
    share: float
    held_out: float
    rivals: tuple[CustomEffect, ...] = ()

    @property
    def formula(self) -> str:
        """Its equation."""
        return self.found.best.scored.term.printed(self.effect.spaces[0])

    @property
    def kind(self) -> str:
        """The stage that it is added to."""
        term = self.found.best.scored.term
        return term.kind if term.by_channel else "tip_body"

    def to_data(self) -> dict[str, Any]:
        """As plain data: the format of `discover --json`."""
        return {
            "id": self.effect.id,
            "formula": self.formula,
            "kind": self.kind,
            "complexity": self.found.best.scored.term.complexity,
            "p_value": self.found.p_value,
            "share": self.share,
            "parameters": {
                name: {"value": value, "std": std if np.isfinite(std) else None, "unit": unit}
                for name, (value, std, unit) in self.parameters.items()
            },
            "held_out": {"share": self.held_out, "carried": True},
            "alternatives": [
                {"id": rival.id, "formula": other.term.printed(self.effect.spaces[0]), "odds": odds}
                for (other, odds), rival in zip(self.found.alternatives, self.rivals, strict=True)
            ],
        }


@dataclass(frozen=True, eq=False)
class Discovery(Tabular):
    """The terms that were found in recordings, in order; none where no term holds on the other motion.

    first, last  the fit before, and with all terms
    tested       number of terms of the grammar
    complexity   up to which all of them were tested
    depends_on   where no term was found, share of the residual's power on held-out blocks that each signal predicts
    rejected     the last term that was significant on the fitted motion and does not hold on the others; None without
    left         p-value of "what is left on the motions held out is noise", with all terms, or those not proposed
    """

    first: Fit
    last: Fit
    held_out: tuple[Recording, ...]
    equations: tuple[FoundEquation, ...]
    tested: int
    complexity: int
    depends_on: Mapping[str, float]
    rejected: FoundTerm | None = None
    left: float | None = None

    @property
    def found(self) -> bool:
        """Whether there is a term."""
        return bool(self.equations)

    @property
    def effects_toml(self) -> str:
        """The terms as an effects file; empty without any."""
        return "\n".join(effect_toml(equation.effect) for equation in self.equations)

    @property
    def alternatives_toml(self) -> str:
        """What cannot be told from the terms as an effects file; empty without any."""
        return "\n".join(effect_toml(rival) for equation in self.equations for rival in equation.rivals)

    def compared(self) -> ModelComparison:
        """Both models on the recordings held out."""
        return compare_models({"before": self.first, "after": self.last}, list(self.held_out))

    @property
    def table(self) -> Table:
        """A row for each parameter of each term."""
        columns = (
            "equation",
            "parameter",
            Column("value", format=".4g"),
            Column("std", format=".2g"),
            "unit",
            Column("p", format=P_VALUE),
            Column("share", format=".1%"),
            Column("held out", format=".1%"),
        )
        rows = [
            (e.formula, name, value, std, unit, e.found.p_value, e.share, e.held_out)
            for e in self.equations
            for name, (value, std, unit) in e.parameters.items()
        ]
        return Table.of(columns, rows)

    def remarks(self) -> list[str]:
        """What else fits, what was tested, and what it is."""
        held_out = ", ".join(recording.name for recording in self.held_out)
        tested = f"{self.tested} terms of complexity up to {self.complexity} were tested"
        if not self.found:
            depends = ", ".join(f"{name} {share:.0%}".replace("%", " %") for name, share in self.depends_on.items())
            on = f" What is left depends on {depends} (of its power, on blocks left out)." if depends else ""
            none = f"none holds on {held_out}" if self.rejected else "none is significant"
            return [f"No equation up to complexity {self.complexity}: {tested}, {none}.{self._of_rejected}{on}"]
        lines = [f"{tested}; the parameters hold on {held_out}, without being fitted there."]
        if self.left is not None and self.left < LEVELS.held_out:
            more = f"more is left than noise ({p_value_text(self.left)})"
            lines.append(f"On {held_out} {more}: the form may stand in for one that is not among the terms.")
        for equation in self.equations:
            others = [
                f"{o.term.printed(self.first.model.space)} (1 : {odds:.2g})" for o, odds in equation.found.alternatives
            ]
            if others:
                lines.append(f"Not told apart from {equation.formula}: {'; '.join(others)}.")
                motion = (
                    f"`truewrench design RIG --model MODEL.json --tell {equation.effect.id} {equation.rivals[0].id}`"
                )
                lines.append(f"A motion that would: {motion}, with the effects file of the alternatives as --effects.")
        if len(self.equations) > 1:
            lines.append("Each term is given the earlier ones.")
        return lines

    @property
    def _of_rejected(self) -> str:
        """What the best term on the fitted motion is like on the others."""
        if self.rejected is None:
            return ""
        best = self.rejected.best
        if best.refitted < LITTLE_EXCITED:
            why = "they hardly excite it: record a motion that does"
        elif self.left is not None:
            why = f"much of what they show is left ({p_value_text(self.left)}): the true form is not among the terms"
        else:
            why = f"there its constants explain {max(0.0, best.carried / best.refitted):.0%} of what others would"
        formula = best.scored.term.printed(self.first.model.space)
        return f" {formula} is the likeliest on the fitted motion, and not on the others: {why}."

    def printed(self) -> list[Table | str]:
        """The table where there is anything, and the remarks."""
        return [*([self.table] if self.found else []), *self.remarks()]

    def to_data(self) -> dict[str, Any]:
        """As plain data: the format of `discover --json`."""
        return {
            "found": self.found,
            "complexity": self.complexity,
            "tested": self.tested,
            "terms": [equation.to_data() for equation in self.equations],
            "depends_on": dict(self.depends_on),
            "left_p": self.left,
            "effects_toml": self.effects_toml,
            "alternatives_toml": self.alternatives_toml,
        }


def discover(
    model: WrenchModel | Fit,
    recordings: Recording | Iterable[Recording],
    *,
    validate: Recording | Iterable[Recording],
    complexity: int = COMPLEXITY,
    progress: Progress = silent,
) -> Discovery:
    """Look for an equation of what a model leaves unexplained, and test it on another motion.

    All terms of a grammar of the chain's quantities up to a complexity are scored beside the model, corrected for their
    number; the best are refined, and carried over to the other motion, where a term has to hold with its constants as
    they are. Up to three terms are found, each given the earlier ones.

    Parameters
    ----------
    model : WrenchModel or Fit
        The model, with the effects that are known.
    recordings : Recording or iterable of Recording
        Recordings to fit.
    validate : Recording or iterable of Recording
        Recordings of other motions, on which no term is fitted.
    complexity : int, optional
        Most leaves and operations of a term, by default 6.
    progress : callable, optional
        Called with one line of text at each stage; by default silent.

    Returns
    -------
    Discovery
        Terms with parameters, p-values, and what cannot be told from them; custom effects of an effects file.

    Raises
    ------
    InputError
        When there is no recording to validate, or one cannot be fitted.

    Notes
    -----
    Whitened scores (C. R. Rao 1948) against the largest one of all terms in noise; odds by the Bayesian information
    criterion, with a description length for each leaf and operation.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> training, other = (tw.read(f"{name}.csv", rig=rig) for name in ("train", "validate"))
    >>> diagnosis = tw.diagnose(tw.planar(rig), training, validate=other)
    >>> tw.discover(diagnosis.fit, training, validate=other, complexity=2).found
    False
    """
    training, held_out = recordings_of(recordings, "discover"), recordings_of(validate, "discover")
    if not held_out:
        raise InputError(
            what="no other motion was given", where="validate", remedy="record one: a term is tested on it"
        )
    require_different_readings([*training, *held_out], "discover")
    if not 2 <= complexity <= MOST_COMPLEX:
        what = f"the complexity is {complexity}"
        raise InputError(what=what, where="complexity", remedy=f"use 2 to {MOST_COMPLEX}")
    progress("fit")
    space = (model.model if isinstance(model, Fit) else model).space
    first = fitted = in_noise_beside_columns(model if isinstance(model, Fit) else fit(model, training))
    leaves, angles, inputs = recorded_leaves(fitted, held_out)
    grammar = terms(leaves, angles, list(inputs), fitted.model.channels, complexity)
    tested, equations = len(grammar), list[FoundEquation]()
    rejected: FoundTerm | None = None
    while (number := len(equations) + 1) <= MOST_TERMS:
        search = TermSearch(fitted, leaves, shape_ranges(fitted, leaves))
        rests = [fit(first.model, without_terms(recording, first, fitted)) for recording in held_out]
        others = [TermSearch(in_noise_beside_columns(rest), leaves, {}) for rest in rests]
        candidates = best_candidates(search, grammar, count_progress(progress, f"term {number}: score tests"))
        if candidates is not None and candidates.is_suggestive and noise_from_residual(fitted):
            beside, _ = _refitted(fitted, candidates.terms[0], "beside", leaves, inputs)
            search = TermSearch(fitted.in_noise(beside.noise), leaves, shape_ranges(fitted, leaves))
            announce = count_progress(progress, f"term {number}: score tests in the noise beside the best")
            candidates = best_candidates(search, grammar, announce)
        if candidates is None or candidates.p_value >= LEVELS.effect:
            break
        found = best_term(search, others, candidates)
        if not found.best.holds or found.p_value >= LEVELS.effect:
            rejected = found
            break
        progress(f"term {number}: refit with {found.best.scored.term.printed(fitted.model.space)}")
        taken = [effect.id for effect in fitted.model.effects]
        effect_id = next(name for name in map("found_{}".format, count(1)) if name not in taken)
        after, effect = _refitted(search.fit, found.best.scored, effect_id, leaves, inputs)
        if found.best.scored.term in [e.found.best.scored.term for e in equations]:
            rejected = found
            break
        # Amplitude and shape are one number here: another term says it plainly.
        if not _is_determined(after, effect) and tested - len(grammar) < MOST_SET_ASIDE:
            undetermined = replace(found.best.scored.term, kept=None)
            grammar = [term for term in grammar if replace(term, kept=None) != undetermined]
            continue
        excess = max(search.null_model.cost - len(search.null_model.residual), found.best.scored.score)
        beyond = sum(other.null_model.cost - len(other.null_model.residual) for other in others)
        equations.append(
            FoundEquation(
                effect,
                found,
                {},
                min(1.0, found.best.scored.score / excess),
                min(1.0, max(0.0, found.best.carried) / max(beyond, found.best.carried, 1e-300)),
                tuple(
                    _effect(space, other, f"{effect_id}_or_{place}", leaves, inputs)
                    for place, (other, _) in enumerate(found.alternatives, start=2)
                ),
            )
        )
        fitted = after
    left = None
    if equations:
        compared = compare_models({"after": fitted}, held_out).models[0].predictions
        left = min(1.0, len(compared) * min(prediction.comparison.lack_of_fit for prediction in compared))
        explained = 1 - float(np.prod([1 - equation.held_out for equation in equations]))
        if left < LEVELS.held_out and explained < LEAST_EXPLAINED:
            equations, fitted, rejected = [], first, equations[0].found
    misfits = not equations and compare(first).lack_of_fit < LEVELS.held_out
    depends = depends_on(first) if misfits else {}
    done = tuple(_with_parameters(equation, fitted) for equation in equations)
    return Discovery(first, fitted, tuple(held_out), done, tested, complexity, depends, rejected, left)


MOST_COMPLEX = 8
"""Largest complexity: some 15 000 terms, minutes in six axes."""


def without_terms(recording: Recording, first: Fit, fitted: Fit) -> Recording:
    """A recording of another motion less what the terms found predict for it, their parameters as fitted."""
    if fitted is first:
        return recording
    values = fitted.values
    readings = [
        predicted_readings(model, recording, np.array([values[p.name] for p in model.parameters]))
        for model in (fitted.model, first.model)
    ]
    return recording.with_readings(recording.wrench - readings[0] + readings[1])


def _refitted(
    fitted: Fit, scored: ScoredTerm, effect_id: str, leaves: Mapping[str, Leaf], inputs: Mapping[str, str]
) -> tuple[Fit, CustomEffect]:
    """The fit with a term as an effect, begun at its estimates."""
    space = fitted.model.space
    effect = _effect(space, scored, effect_id, leaves, inputs)
    values = dict(zip(scored.term.amplitudes(space), scored.amounts.tolist(), strict=True)) | dict(scored.shapes)
    own = {f"{effect_id}.{p.name}": values[p.name] for p in effect.parameters(space)}
    after = fitted.refitted(fitted.model + effect, fitted.values | own)
    return in_noise_beside_columns(after.in_noise(reestimated_noise(after))), effect


MOST_SET_ASIDE = 5
"""Terms that give way to plainer ones: each costs a search of all others; the next is told with its std as it is."""
DETERMINED = 2.0
"""Std from zero of an amplitude whose term was found significant: less is said by no equation."""


def _is_determined(fitted: Fit, effect: CustomEffect) -> bool:
    """Whether an amplitude of a term is known, given the shape that was fitted with it."""
    amplitudes = [fitted.parameters[p.name] for p in effect.qualified(fitted.model.space) if not p.nuisance]
    return any(abs(p.value) >= DETERMINED * p.std for p in amplitudes if np.isfinite(p.std) and p.std > 0)


def _effect(
    space: Space, scored: ScoredTerm, effect_id: str, leaves: Mapping[str, Leaf], inputs: Mapping[str, str]
) -> CustomEffect:
    """A term as an effect, searched at its estimates."""
    shapes = {name: [value] for name, value in scored.shapes.items()}
    return scored.term.effect(space, effect_id, leaves, inputs, shapes)


def _with_parameters(equation: FoundEquation, fitted: Fit) -> FoundEquation:
    prefix = f"{equation.effect.id}."
    parameters = {
        name.removeprefix(prefix): (float(p.value), float(p.std), p.unit)
        for name, p in fitted.parameters.items()
        if name.startswith(prefix)
    }
    return replace(equation, parameters=parameters)


# ------------------------------------------------------------------------- where no term was found

BLOCKS = 10
"""Successive blocks of a recording, of which every other one is predicted from the rest."""
KNOTS = 6
"""Of the piecewise linear function of a signal that is fitted."""
WORTH_SAYING = 0.02
"""Share of the power that a signal has to predict."""


def depends_on(fitted: Fit) -> dict[str, float]:
    """Share of the residual's power, weighted by the noise, that a function of each signal predicts on other blocks."""
    recording, floor = fitted.recordings[0], fitted.noise_floor(0)
    residual = recording.averaged(fitted.residuals[0]) / floor
    residual = residual - residual.mean(axis=0)
    samples = len(residual)
    even = (np.arange(samples) * BLOCKS // samples) % 2 == 0
    total, shares = float((residual**2).sum()), {}
    excess = total - samples * residual.shape[1] / recording.repeats
    if excess <= WORTH_SAYING * total:
        return {}
    for name, values in recording.motion.model_signals.items():
        signal = values[:samples]
        if name in ("order", "progress") or np.ptp(signal) == 0:
            continue
        knots = np.quantile(signal, np.linspace(0, 1, KNOTS))
        basis = np.column_stack([np.interp(signal, knots, row) for row in np.eye(KNOTS)])
        left = 0.0
        for fitted_rows in (even, ~even):
            weights = np.linalg.lstsq(basis[fitted_rows], residual[fitted_rows], rcond=None)[0]
            left += float(((residual[~fitted_rows] - basis[~fitted_rows] @ weights) ** 2).sum())
        share = (total - left) / excess
        if share > WORTH_SAYING:
            shares[name] = round(min(share, 1.0), 3)
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


# ------------------------------------------------------------------------------------ as a TOML file


def effect_toml(effect: CustomEffect) -> str:
    """An effect as a table [[effect]] of an effects file."""
    lines = ["[[effect]]"]
    for key, value in effect.to_data().items():
        lines.append(f"{key} = {_toml(value)}")
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    """A value of a definition: text, number, list or table; no bound is inf."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_toml(each)}" for name, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if value is None:
        return "inf"
    return json.dumps(value, ensure_ascii=False)
