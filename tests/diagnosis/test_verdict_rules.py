"""Every verdict rule alone: a case where it decides, before which no other rule applies; and every rule has a case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest

from diagnosis.acceptance import ACCEPTANCE_RULES, AcceptanceEvidence, accept
from diagnosis.diagnosis import RECORD_RULES, RecordEvidence
from diagnosis.screening.score_test import ScoreTest
from diagnosis.subset_search import CandidateModel
from diagnosis.verdict.aliasing import Alias
from diagnosis.verdict.finding import EFFECT_RULES, EffectEvidence
from diagnosis.verdict.selection_step import EffectRefits, FinalRefit
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict, VerdictRule, judge
from estimation.fit import fit
from estimation.multiplicity import holm_adjusted
from modeling.chain.model import planar
from modeling.effects import named
from modeling.errors import InputError
from modeling.space import Space
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, simulate

DRAG = named("viscous_drag")
TESTED = ScoreTest(DRAG, 1.0, 0.3, {}, {"viscous_drag.c": (0.1, 0.1)}, lambda _level: ({"viscous_drag.c": 0.2}, {}))
NOTHING = EffectEvidence(screening=TESTED, space=Space.PLANE)


def screened(**changed: Any) -> EffectEvidence:
    return replace(NOTHING, screening=replace(TESTED, **changed))


def refitted(**changed: Any) -> EffectEvidence:
    """An effect that is significant beside the final model, with what was refitted; the search chose two others."""
    refits = EffectRefits(**{"chosen": "a + b", **changed})
    return replace(screened(p_value=1e-4), adjusted_p_value=0.0099, refits=refits)


TRIED: dict[str, Any] = {"smallest": "a + viscous_drag", "unsolved": "b + viscous_drag", "passed_over": True}
UNTRIED: dict[str, Any] = {"passed_over": True, "ended_adequate": True}
"""Reasons that others precede."""

EFFECT_CASES: dict[str, tuple[EffectEvidence, EffectVerdict, str]] = {
    "added with a reservation": (
        replace(NOTHING, added=True, kept="kept though it does not help"),
        EffectVerdict.SUPPORTED,
        "kept though it does not help",
    ),
    "added to the model": (replace(NOTHING, added=True), EffectVerdict.SUPPORTED, ""),
    "alias of an added effect": (
        replace(NOTHING, alias=("sensor_lag", Alias(DRAG, 4.0, 4.0))),
        EffectVerdict.CONFUSABLE,
        "indistinguishable from sensor_lag (separation 4, probability of confusion 16%)",
    ),
    "not accepted": (
        replace(NOTHING, rejection="it is too large"),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because it is too large",
    ),
    "not identifiable beside an effect in whose place it fits worse": (
        replace(screened(reason="collinear"), replacement=("time_delay", Alias(named("sensor_lag"), 300.0, 289.2))),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because in the place of time_delay it fits worse: the chi-square is higher by 289; beside it, it is"
        " collinear",
    ),
    "not identifiable": (
        screened(reason="the recording has no position"),
        EffectVerdict.NOT_EXCITED,
        "the recording has no position",
    ),
    "only beyond its physical range": (
        screened(effect=named("sensor_lag"), limits=lambda _level: ({"sensor_lag.time_constant": 10.1}, {})),
        EffectVerdict.NOT_EXCITED,
        "time_constant is not excited: detectable only beyond its physical range",
    ),
    "upper limit within tolerance": (
        replace(NOTHING, negligible=True),
        EffectVerdict.NEGLIGIBLE,
        "the upper 95 % limit of its contribution is below tolerance",
    ),
    "not significant after the exact refit": (
        refitted(final=FinalRefit.NOT_SIGNIFICANT, **TRIED),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because it is significant in the score test, but not after the exact refit",
    ),
    "exact refit not converged": (
        refitted(final=FinalRefit.UNCONVERGED, **TRIED),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because it is significant in the score test, but its exact refit has not converged",
    ),
    "left out of the chosen set as within tolerance": (
        refitted(**TRIED, left_out=True),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because it was below tolerance beside the effects with which the search chose it",
    ),
    "refitted in sets that do not explain the residual": (
        refitted(**TRIED, final_is_base=True),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because no set that it was refitted in explains the residual (the smallest: a + viscous_drag; not"
        " beside the final model)",
    ),
    "refitted in sets to which the search preferred another": (
        refitted(**TRIED),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because the search preferred a + b to every set that it was refitted in (the smallest: a +"
        " viscous_drag; not beside the final model)",
    ),
    "exact refit without a solution": (
        refitted(**UNTRIED, unsolved="a + viscous_drag"),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because a + viscous_drag has no solution at the initial values of its exact refit",
    ),
    "not refitted, as the search ended without convergence": (
        refitted(**UNTRIED, unconverged="a"),
        EffectVerdict.NOT_SUPPORTED,
        "not tried, because the search does not go on from a, whose refit has not converged: exclude effects of that"
        " set by --without; beside other sets, of which each has at most 3 refits, others had larger scores",
    ),
    "not refitted, as refits are limited": (
        refitted(ended_adequate=True, passed_over=True),
        EffectVerdict.NOT_SUPPORTED,
        "not tried, because the search refits at most 3 effects beside each set, and others had larger scores: give it"
        " fewer candidates by --only",
    ),
    "not refitted, as the search ended at an adequate model": (
        refitted(ended_adequate=True),
        EffectVerdict.NOT_SUPPORTED,
        "not tried, because the search had ended at a + b, which explains the residual: go on from there by --given",
    ),
    "not refitted, as it was not significant in the search": (
        refitted(),
        EffectVerdict.NOT_SUPPORTED,
        "not tried, because it was not significant beside any set that the search extended: it is beside the final"
        " model only; go on from that one by --given",
    ),
    "significant only in noise that is known": (
        screened(statistic=15.2),  # chi-square with one degree of freedom: p = 1e-4 at 15.14
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because there are too few repeats to know the low-frequency noise",
    ),
    "not significant": (
        screened(p_value=2e-3, statistic=15.0),
        EffectVerdict.NOT_SUPPORTED,
        "rejected, because it is not significant: what it would explain is within the noise",
    ),
}

FITS, MISFITS = RecordEvidence(lack_of_fit=0.01), RecordEvidence(lack_of_fit=0.0099)
HALVES = "it removes less than half of the systematic error, and the residual stays significant"
RECORD_CASES: dict[str, list[tuple[RecordEvidence, RecordVerdict, str]]] = {
    "the recordings seem to be read wrongly": [
        (replace(FITS, misread=True), RecordVerdict.UNEXPLAINED, ""),
        (replace(MISFITS, misread=True, effects=1, within_tolerance=True), RecordVerdict.UNEXPLAINED, ""),
    ],
    "adequate without effects": [(FITS, RecordVerdict.NOTHING_MISSING, "")],
    "no effect accepted": [
        (MISFITS, RecordVerdict.UNEXPLAINED, ""),
        (replace(FITS, held_out_lack_of_fit=9e-4), RecordVerdict.UNEXPLAINED, ""),
        (replace(FITS, unaccepted=True), RecordVerdict.UNEXPLAINED, ""),
        (replace(FITS, deviates_outside=True), RecordVerdict.UNEXPLAINED, ""),
        (replace(MISFITS, within_tolerance=True, power_share=0.1), RecordVerdict.UNEXPLAINED, ""),
        (replace(FITS, unrepeated=True), RecordVerdict.UNEXPLAINED, ""),
    ],
    "a single run of which little was removed": [
        (replace(FITS, effects=1, removed_share=0.49), RecordVerdict.PARTLY_EXPLAINED, ""),
    ],
    "no lack of fit": [
        (replace(FITS, effects=1, removed_share=0.5), RecordVerdict.EXPLAINED, ""),
        (replace(FITS, effects=1, held_out_lack_of_fit=1e-3), RecordVerdict.EXPLAINED, ""),
        (replace(FITS, effects=2, unaccepted=True), RecordVerdict.EXPLAINED, ""),
    ],
    "error within tolerance": [(replace(MISFITS, effects=1, within_tolerance=True), RecordVerdict.EXPLAINED, "")],
    "several events, of which some are left": [
        (
            replace(FITS, effects=2, transients=2, unrepeated=True, power_share=0.1),
            RecordVerdict.UNEXPLAINED,
            "other events are left beside it, so that nothing tells which of them it is",
        ),
    ],
    "systematic power at least halved": [
        (replace(MISFITS, effects=1, power_share=0.5), RecordVerdict.PARTLY_EXPLAINED, ""),
        (
            replace(FITS, effects=1, deviates_outside=True, within_tolerance=True, power_share=0.1),
            RecordVerdict.PARTLY_EXPLAINED,
            "",
        ),
    ],
    "more than half of the systematic power remains": [
        (replace(MISFITS, effects=1, power_share=0.51), RecordVerdict.UNEXPLAINED, HALVES)
    ],
}


def test_what_the_search_would_not_refit_is_not_significant() -> None:
    """p = 9e-4 is 0.0216 among 24 candidates (Holm), and the search refits below 1 %: no reason speaks of a refit."""
    adjusted = holm_adjusted([9e-4, *[0.5] * 23])[0]
    assert adjusted == pytest.approx(0.0216)
    alone = replace(refitted(), adjusted_p_value=adjusted)
    for evidence in (
        alone,
        replace(alone, refits=EffectRefits(unconverged="a")),
        replace(alone, adjusted_p_value=0.01),
    ):
        _, reason = judge(EFFECT_RULES, evidence)
        assert reason == "rejected, because it is not significant: what it would explain is within the noise"
    assert refitted().significant


def test_where_an_effect_was_refitted_is_said() -> None:
    """Beside the final model, or in other sets; and that the search ended early, if it did."""
    beside = refitted(**TRIED, final=FinalRefit.SIGNIFICANT, final_is_base=True, unconverged="a")
    _, reason = judge(EFFECT_RULES, beside)
    assert reason == (
        "rejected, because no set that it was refitted in explains the residual, although it is significant after the "
        "exact refit; the search ended at a, whose refit has not converged"
    )
    explained = replace(beside, refits=replace(beside.refits, explains=True))
    _, reason = judge(EFFECT_RULES, explained)
    assert reason.startswith(
        "rejected, because the search preferred a + b to every set that it was refitted in, although"
    )
    _, reason = judge(EFFECT_RULES, refitted(final_extended=True))
    assert reason.endswith("beside any set that the search extended: it is in the noise of the final model only")


def test_the_search_counts_where_the_noise_is_badly_known() -> None:
    """15.2 is p = 1e-4 in one test, and 1e-3 in the best of ten."""
    _, reason = judge(EFFECT_RULES, screened(statistic=15.2, searched=10.0))
    assert reason == "rejected, because it is not significant: what it would explain is within the noise"
    _, reason = judge(EFFECT_RULES, replace(screened(statistic=15.2), one_run=True))
    assert reason == "rejected, because one run does not tell the low-frequency noise well enough"


@dataclass(frozen=True)
class KnownSet:
    """The ids of a set of effects."""

    ids: frozenset[str] = frozenset({"viscous_drag", "sensor_lag"})


@dataclass(frozen=True)
class KnownEvidence:
    """What `AcceptanceEvidence` computes, stated: a set that is rejected by no rule and accepted by the last one."""

    candidate: KnownSet = KnownSet()
    held_out: Sequence[str] = ()
    unidentifiable: str | None = None
    at_bound: tuple[str, str] | None = None
    within_noise: str | None = None
    lasting: bool = True
    collinear_parameter: str | None = None
    foreign: tuple[str, str] | None = None
    hardly_removes: str | None = None
    not_improved: tuple[str, str] | None = None
    adequate: bool = False
    holds_across_halves: bool = True
    inconsistent: tuple[str, str] | None = None
    least_significant: str = "sensor_lag"


CHANGE = ("viscous_drag", "its prediction changes by 25 % on run 7")
ACCEPTANCE_CASES: dict[str, list[tuple[KnownEvidence, str | None, str]]] = {
    "no effect": [(KnownEvidence(candidate=KnownSet(frozenset())), None, "")],
    "no identifiable parameter": [
        (
            KnownEvidence(unidentifiable="viscous_drag", at_bound=("sensor_lag", "at its bound"), adequate=True),
            "viscous_drag",
            "none of its parameters is identifiable in these data",
        )
    ],
    "a parameter on a physical bound": [
        (
            KnownEvidence(at_bound=("viscous_drag", "its c is at its bound"), adequate=True),
            "viscous_drag",
            "its c is at its bound",
        )
    ],
    "an amount within the noise": [
        (
            KnownEvidence(within_noise="viscous_drag", collinear_parameter="m", adequate=True),
            "viscous_drag",
            "its amount is within 2 standard deviations of none",
        )
    ],
    "collinear with a tool parameter": [
        (KnownEvidence(collinear_parameter="m"), "sensor_lag", "it is collinear with the tool's m in these data")
    ],
    "a residual that is not the tool's": [
        (
            KnownEvidence(
                foreign=("viscous_drag", "what it explains is mostly on tz"), not_improved=("sensor_lag", "run 7")
            ),
            "viscous_drag",
            "what it explains is mostly on tz",
        )
    ],
    "hardly anything beside what remains": [
        (
            KnownEvidence(hardly_removes="viscous_drag", not_improved=("sensor_lag", "run 7")),
            "viscous_drag",
            "it removes less than 1% of what is beyond noise, too little beside what remains unexplained",
        )
    ],
    "no smaller error on held-out data": [
        (
            KnownEvidence(not_improved=("sensor_lag", "run 7"), adequate=True),
            "sensor_lag",
            "it does not lower the error on held-out run 7",
        )
    ],
    "no lack of fit": [
        (KnownEvidence(adequate=True, inconsistent=CHANGE, holds_across_halves=False), None, ""),
        (KnownEvidence(adequate=True, lasting=False, collinear_parameter="m"), None, ""),
    ],
    "not confirmed by the other half of the training data": [
        (KnownEvidence(holds_across_halves=False), "sensor_lag", "it does not explain the other half of the data")
    ],
    "inconsistent": [
        (
            KnownEvidence(inconsistent=CHANGE),
            "viscous_drag",
            "its prediction changes by 25 % on run 7",
        ),
    ],
    "consistent coefficients": [
        (KnownEvidence(), None, ""),
        (KnownEvidence(held_out=("run 7",), holds_across_halves=False), None, ""),
    ],
}


@pytest.mark.parametrize("rule", EFFECT_RULES, ids=lambda rule: rule.name)
def test_a_rule_on_an_effect_decides(rule: Any) -> None:
    evidence, verdict, sentence = EFFECT_CASES[rule.name]
    assert next(r for r in EFFECT_RULES if r.condition(evidence)) is rule
    assert judge(EFFECT_RULES, evidence) == (verdict, sentence)


@pytest.mark.parametrize("rule", RECORD_RULES, ids=lambda rule: rule.name)
def test_a_rule_on_the_recordings_decides(rule: Any) -> None:
    for evidence, verdict, sentence in RECORD_CASES[rule.name]:
        assert next(r for r in RECORD_RULES if r.condition(evidence)) is rule
        assert judge(RECORD_RULES, evidence) == (verdict, sentence)


@pytest.mark.parametrize("rule", ACCEPTANCE_RULES, ids=lambda rule: rule.name)
def test_an_acceptance_rule_decides(rule: Any) -> None:
    for known, rejected, sentence in ACCEPTANCE_CASES[rule.name]:
        evidence = cast(AcceptanceEvidence, known)
        assert next(r for r in ACCEPTANCE_RULES if r.condition(evidence)) is rule
        verdict, reason = judge(ACCEPTANCE_RULES, evidence)
        assert (verdict(evidence), reason) == (rejected, sentence)


def test_a_replacement_whose_fit_ended_early_is_worse_by_no_more_than_what_is_said() -> None:
    replacement = ("time_delay", Alias(named("sensor_lag"), 300.0, 289.2, converged=False))
    _, sentence = judge(EFFECT_RULES, replace(screened(reason="collinear"), replacement=replacement))
    assert "the chi-square is higher by up to 289;" in sentence


def test_a_rival_that_the_readings_do_not_tell_is_named_whatever_the_motions_promise() -> None:
    """2 ln 19 = 5.9: the likelihoods of the two are nearer than 19 to 1."""
    sensor_lag = named("sensor_lag")
    assert Alias(sensor_lag, 30.0, 5.8).confusable
    assert not Alias(sensor_lag, 30.0, 5.9).confusable
    assert Alias(sensor_lag, 10.7, 50.0).confusable
    _, sentence = judge(EFFECT_RULES, replace(NOTHING, alias=("time_delay", Alias(sensor_lag, 30.0, 4.8))))
    assert sentence == "indistinguishable from time_delay (the chi-square is higher by 4.8 only)"
    _, sentence = judge(EFFECT_RULES, replace(NOTHING, alias=("time_delay", Alias(sensor_lag, 30.0, -1.0))))
    assert sentence == "indistinguishable from time_delay (the chi-square is no higher)"


def test_only_amounts_beyond_the_range_of_all_amplitudes_are_not_excited() -> None:
    """Of several gains one may be within its range; where no amount is known, there is no such verdict."""
    gains = named("sensor_gain")
    names = [p.name for p in gains.qualified(Space.PLANE)]
    far = dict.fromkeys(names, 1e9)
    several = screened(effect=gains, limits=lambda _level: (far, {}))
    assert len(names) > 1
    assert several.beyond_range == names[0].split(".", 1)[1]
    assert screened(effect=gains, limits=lambda _level: ({**far, names[-1]: 1e-6}, {})).beyond_range is None
    assert screened(limits=lambda _level: ({}, {})).beyond_range is None


def test_the_first_rule_decides_and_a_list_without_one_is_an_error() -> None:
    rules = [VerdictRule[float, str](f"above {x}", lambda e, x=x: e > x, f"{x}") for x in (2, 1)]  # type: ignore[misc]
    assert [judge(rules, np.float64(e))[0] for e in (3, 1.5)] == ["2", "1"]
    with pytest.raises(InputError, match="none of 2 rules applies"):
        judge(rules, 0.5)


def test_every_rejection_has_a_reason() -> None:
    rejecting = [rule for rule in EFFECT_RULES if rule.verdict is EffectVerdict.NOT_SUPPORTED]
    assert rejecting
    assert all(rule.sentence for rule in rejecting)


def test_an_event_that_lasts_as_long_as_the_record_is_not_accepted() -> None:
    """Its wrench is a bias, so that none of its parameters is identifiable, however well the model fits."""
    frame = simulate(PlanarRig(), PlanarRig().random_motion(seed=1), repeats=4, samples_per_period=100, seed=2)
    base = fit(planar(RIG), recording_of(frame, rig=RIG))
    start = {**base.values, "contact_event.start": -10.0, "contact_event.end": 100.0}
    push = base.refitted(base.model + named("contact_event"), start)
    candidate = CandidateModel(push, 1)
    assert candidate.adequate
    assert not push.identifies(candidate.added[0])
    found = accept(candidate, CandidateModel(base, 1), [], [])
    assert found.candidate.ids == frozenset()
    assert found.reasons == {"contact_event": "none of its parameters is identifiable in these data"}
