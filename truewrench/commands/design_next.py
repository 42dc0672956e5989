"""`truewrench design --next result.json`: what a diagnosis leaves open, which the next motion is designed to settle."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from design.discrimination import DesignSetting, DiscriminationDesign, with_effect_replaced
from design.discrimination.discriminating_trajectory import RARE
from diagnosis.next_experiment import IntervalDesign, KnownEstimates
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.effects import CATALOGUE, named
from modeling.errors import InputError, file_text
from truewrench.commands.design_request import DesignRequest
from truewrench.files.effects_file import read_effects
from truewrench.files.model_file import ModelFile

AGREEMENT = 1e-6
"""Relative difference up to which a value in result.json is that in model.json: both have all digits."""
UNEXPLAINED = "unexplained"
INTERVALS = "it is designed to narrow the widest interval, beside what the recordings have told already"


@dataclass(frozen=True, eq=False, kw_only=True)
class NextQuestion:
    """What the next motion is designed for.

    known    model, estimates and noise
    rivals   the model with an effect replaced by one that it is not told from; none: the intervals are the question
    reasons  sentences: the verdict, and what is not told apart
    """

    known: KnownEstimates
    rivals: tuple[WrenchModel, ...]
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, request: DesignRequest, path: Path) -> NextQuestion:
        """Of result.json and the model file of the same diagnosis.

        Raises InputError for another file, for a verdict that says that the model is not the right one, and for a model
        file of another diagnosis.
        """
        result, saved = _result(path), request.saved
        assert saved is not None  # `DesignRequest.of` reads the one beside the result
        _require_explained(result, str(path))
        _require_same(result, saved, str(path))
        known = KnownEstimates(
            model=saved.model,
            values={name: estimate.value for name, estimate in saved.parameters.items()},
            covariance=saved.covariance,
            noise=request.noise,
        )
        rivals, words = _rivals(request, known.designable, result["effects"])
        reasons = [f"verdict: {result['verdict']}", *words]
        if result["verdict"] == "partly_explained":
            reasons.append("what is still missing from the model is in none of its intervals")
        return cls(known=known, rivals=rivals, reasons=tuple(reasons))

    def separation(self, plan: DiscriminationDesign) -> str:
        """How likely the effects are still confused after the motion."""
        errors = [pair.error_probability(pair.after) for pair in plan.pairs]
        likely = max((error for error in errors if error is not None), default=None)
        times = f"{plan.runs} run{'s' * (plan.runs > 1)} of it alone"
        if likely is None:
            return f"the motion shows the difference with lambda {min(p.after for p in plan.pairs):.3g} in {times}"
        return f"expected probability of taking one for the other: {max(likely, RARE):.2g} at most after {times}"

    def narrowing(self, plan: IntervalDesign) -> str:
        """What is widest, and how wide it is expected to be after the motion."""
        name, size = plan.widest, plan.sizes[plan.widest]
        before, after = self.known.std[name], plan.expected[name]
        unit = next(p.unit for p in self.known.designable.parameters if p.name == name)
        if not np.isfinite(before):
            return f"{INTERVALS}: {name} is not identifiable so far; expected then ± {after:.2g} {unit}"
        share = f"{before / size:.2g} of its size"
        return (
            f"{INTERVALS}: {name} ± {before:.2g} {unit}, {share}; expected then ± {after:.2g}, {after / size:.2g} of it"
        )


def _result(path: Path) -> dict[str, Any]:
    """The data of result.json, as far as it is read here."""
    text, remedy = file_text(path, kind="result.json", syntax="JSON"), "give result.json of `truewrench diagnose --out`"
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(what=f"not a JSON file: {error}", where=str(path), remedy=remedy) from None
    effects = data.get("effects") if isinstance(data, dict) else None
    proper = (
        isinstance(effects, list)
        and all(isinstance(e, dict) and isinstance(e.get("id"), str) for e in effects)
        and all(isinstance(e.get("confusable_with", []), list) for e in effects)
        and all(isinstance(other, str) for e in effects for other in e.get("confusable_with", []))
        and isinstance(data.get("verdict"), str)
        and isinstance(data.get("parameters"), dict)
        and isinstance(data.get("readings", []), list)
    )
    if not proper:
        raise InputError(what="it is no result of a diagnosis", where=str(path), remedy=remedy)
    return dict(data)


def _require_explained(result: Mapping[str, Any], where: str) -> None:
    if result["verdict"] != UNEXPLAINED:
        return
    proposed = [r for r in result.get("readings", []) if isinstance(r, dict) and r.get("adopted") is False]
    if proposed:
        what = f"the recording is misread ({proposed[0].get('id')}), and a motion would be designed for a wrong model"
        remedy = "first diagnose as its first sentence says: `truewrench diagnose --read ID`, or --as-read"
        raise InputError(what=what, where=where, remedy=remedy)
    what = "the verdict is unexplained, and a motion would be designed for a wrong model"
    remedy = "first find what is missing: `truewrench diagnose` with --effects FILE, or `truewrench discover`"
    raise InputError(what=what, where=where, remedy=remedy)


def _require_same(result: Mapping[str, Any], saved: ModelFile, where: str) -> None:
    """InputError unless the model has the parameters of the result, with their values."""
    stated = result["parameters"]
    values = {name: e.get("value") for name, e in stated.items() if isinstance(e, dict)}
    same = set(values) == set(saved.parameters) and all(
        isinstance(value, int | float) and np.isclose(value, saved.parameters[name].value, rtol=AGREEMENT, atol=1e-12)
        for name, value in values.items()
    )
    if not same:
        what = "the model file is of another fit: its parameters differ"
        raise InputError(what=what, where=where, remedy="give --model MODEL.json of the same diagnosis")


def _rivals(
    request: DesignRequest, model: WrenchModel, effects: Sequence[Mapping[str, Any]]
) -> tuple[tuple[WrenchModel, ...], list[str]]:
    """The model with each supported effect replaced by each that it is not told from, and what is said of them."""
    asked = request.options
    custom = () if asked.effects is None else read_effects(asked.effects)
    given = {effect.id: effect for effect in (*custom, *model.effects)}
    setting = DesignSetting.of(request.rig, series=request.series, samples=asked.samples, noise=request.noise)
    rivals, told, words = [], [], []
    present = {effect.id for effect in model.effects}
    for finding in effects:
        effect_id, others = finding["id"], finding.get("confusable_with") or []
        if finding.get("verdict") != "supported" or effect_id not in present:
            continue
        for other in (other for other in others if other not in present):
            rival = with_effect_replaced(model, effect_id, _effect(str(other), given))
            try:
                setting.require([rival.with_arm(setting.arm)])
            except InputError as error:
                words.append(f"{effect_id} is not told from {other}, for which no motion can be designed: {error.what}")
                continue
            rivals.append(rival)
            told.append(f"{effect_id} from {other}")
    if told:
        words.insert(
            0, f"not told apart in these recordings: {', '.join(told)}; the motion is designed to separate them"
        )
    return tuple(rivals), words


def _effect(effect_id: str, given: Mapping[str, Effect]) -> Effect:
    """An effect of the file of effects, the model or the catalogue."""
    if effect_id in given:
        return given[effect_id]
    try:
        return named(effect_id)
    except InputError:
        what = f"'{effect_id}' is none of the {len(CATALOGUE)} effects of the catalogue"
        remedy = "add --effects FILE, as in the diagnosis"
        raise InputError(what=what, where="--next", remedy=remedy) from None
