"""What the reason of an effect says of its refits is what the search has done: every exact refit is watched.

A magnet is hidden, which no candidate describes: many effects are significant, and not all of them can be refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import pytest

from diagnosis import subset_search
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.screening.score_test import ScoreTest
from diagnosis.subset_search import MAX_REFITS, CandidateModel, SubsetSearch
from diagnosis.verdict.finding import Finding
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from estimation.multiplicity import bonferroni_threshold
from estimation.recordings.recording import Recording
from modeling import symbolic as sp
from modeling.chain.chain import Chain
from modeling.chain.effect import Effect
from modeling.chain.model import planar
from modeling.effects.loads import ViscousDrag
from modeling.errors import InputError
from modeling.significance import LEVELS
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench import simulated_rig
from truewrench.simulated_rig import HiddenEffect, Magnet, PlanarRig, SensorHysteresis, SensorLag, simulate

pytest.importorskip("mujoco")

FEW = ("gravity_tilt", "com_offset", "viscous_drag", "quadratic_drag", "coulomb_friction", "time_delay", "sensor_lag",
       "sensor_rotation", "sensor_gain", "sensor_crosstalk")  # fmt: skip
MORE = (*FEW, "joint_offset", "cable_spring", "sensor_hysteresis")
ALIKE = "although it is significant after the exact refit"
LAG = SensorLag(time_constant=0.02)
Refit = Callable[[CandidateModel, ScoreTest], CandidateModel]


@dataclass
class Watched:
    """A diagnosis, and the exact refits of its search."""

    refits: list[CandidateModel] = field(default_factory=list)
    selections: list[SubsetSearch] = field(default_factory=list)
    diagnosis: Diagnosis | None = None

    @property
    def found(self) -> Diagnosis:
        assert self.diagnosis is not None
        return self.diagnosis

    @property
    def findings(self) -> dict[str, Finding]:
        return {f.effect.id: f for f in self.found.findings}

    @property
    def chosen(self) -> frozenset[str]:
        return self.selections[-1].chosen.ids

    def reason(self, effect_id: str) -> str:
        return self.findings[effect_id].reason

    def sets_with(self, effect_id: str) -> list[frozenset[str]]:
        return sorted({c.ids for c in self.refits if effect_id in c.ids}, key=len)


def simulated(*hidden: HiddenEffect, seed: int, repeats: int = 4, samples: int = 150) -> Recording:
    rig = PlanarRig()
    frame = simulate(rig, rig.random_motion(seed=seed), hidden=hidden, repeats=repeats, samples_per_period=samples,
                     seed=seed)  # fmt: skip
    return recording_of(frame, without=() if repeats > 1 else ("repeat",), name="train", rig=RIG)


def watched(
    recording: Recording, effects: Sequence[str | Effect], changed: Callable[[Refit], Refit] | None = None
) -> Watched:
    """Diagnosed, each refit of the search noted down; those of extensions may be changed."""
    seen, in_same_noise = Watched(), subset_search.refit_effects
    exact = subset_search.refit_with_effect if changed is None else changed(subset_search.refit_with_effect)
    search = subset_search.search_subsets

    def refit_with_effect(candidate: CandidateModel, screening: ScoreTest) -> CandidateModel:
        seen.refits.append(exact(candidate, screening))
        return seen.refits[-1]

    def refit_effects(*given: Any, **named: Any) -> CandidateModel:
        seen.refits.append(in_same_noise(*given, **named))
        return seen.refits[-1]

    def search_subsets(*given: Any) -> SubsetSearch:
        seen.refits.clear()  # of a search in the noise before
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(subset_search, "refit_with_effect", refit_with_effect)
            patch.setattr(subset_search, "refit_effects", refit_effects)
            seen.selections.append(search(*given))
        return seen.selections[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("diagnosis.diagnosis.search_subsets", search_subsets)
        seen.diagnosis = diagnose(planar(RIG), recording, effects=effects)
    return seen


def without_convergence(exact: Refit) -> Refit:
    def refit(candidate: CandidateModel, screening: ScoreTest) -> CandidateModel:
        found = exact(candidate, screening)
        return replace(found, fit=replace(found.fit, converged=False))

    return refit


def without_solution(exact: Refit) -> Refit:
    """Of the delay."""

    def refit(candidate: CandidateModel, screening: ScoreTest) -> CandidateModel:
        if screening.effect.id == "time_delay":
            raise InputError(what="no solution", where="here", remedy="none")
        return exact(candidate, screening)

    return refit


@dataclass(frozen=True)
class FaintDrag(ViscousDrag):
    """A drag with the slope of the viscous one at c = 0, and so with its score, that stays below a millionth of it."""

    id = "faint_drag"
    title = "faint drag"

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the drag force to the tool."""
        return super().perturb(chain, {**p, "c": sp.tanh(1e6 * p["c"]) / 1e6})


CASES: dict[str, Callable[[], Watched]] = {
    "few": lambda: watched(simulated(Magnet(), seed=3, repeats=6), FEW),
    "more": lambda: watched(simulated(Magnet(), seed=0), MORE),
    "unconverged": lambda: watched(simulated(Magnet(), seed=3, repeats=6), FEW, without_convergence),
    "faint": lambda: watched(simulated(simulated_rig.ViscousDrag(c=0.15, d=0.12), seed=1), [FaintDrag()]),
    "run": lambda: watched(simulated(LAG, Magnet(strength=0.1), seed=12, repeats=1, samples=600), FEW),
    "run beside hysteresis": lambda: watched(
        simulated(LAG, SensorHysteresis(force=0.25, torque=0.01), seed=10, repeats=1, samples=600), FEW
    ),
    "partly explained": lambda: watched(simulated(Magnet(), LAG, seed=14), FEW),
}


@cache
def case(name: str) -> Watched:
    return CASES[name]()


def judged_by_refits(seen: Watched) -> list[Finding]:
    """The significant effects of which no earlier rule speaks: no alias, nor rejected from the chosen set."""
    return [
        f
        for f in seen.found.findings
        if f.verdict is EffectVerdict.NOT_SUPPORTED and f.effect.id not in seen.chosen
        and f.p_value is not None and f.p_value < LEVELS.effect
    ]  # fmt: skip


LONG = ("partly explained", "run beside hysteresis", "more")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] if n in LONG else []) for n in CASES])
def test_a_reason_speaks_of_refits_that_were_made(name: str) -> None:
    seen, judged = case(name), judged_by_refits(case(name))
    assert judged
    beside = frozenset(seen.found.added)
    for finding in judged:
        effect_id, sets = finding.effect.id, seen.sets_with(finding.effect.id)
        assert finding.reason.startswith("not tried") is (not sets), (effect_id, finding.reason, sets)
        refitted_beside = beside | {effect_id} in sets
        assert ("after the exact refit" in finding.reason) is refitted_beside, (effect_id, finding.reason, sets)
        if "the smallest: " in finding.reason:
            told = finding.reason.split("the smallest: ")[1].split(";")[0]
            assert len(told.split(" + ")) == len(sets[0])
            assert frozenset(told.split(" + ")) in sets
    for other in seen.found.findings:
        if other.p_value is not None and other.p_value >= LEVELS.effect:
            assert "refit" not in other.reason
            assert not other.reason.startswith("not tried")


def test_a_refit_that_is_significant_is_not_said_to_be_insignificant() -> None:
    """The rotation was refitted, and its chi-square fell by as much as its score: the residual stays all the same."""
    seen = case("few")
    assert (seen.found.verdict, seen.found.added) == (RecordVerdict.UNEXPLAINED, ())
    assert (
        seen.reason("sensor_rotation")
        == f"rejected, because no set that it was refitted in explains the residual, {ALIKE}"
    )
    alone = next(c for c in seen.refits if c.ids == {"sensor_rotation"})
    assert alone.fit.converged
    assert seen.selections[-1].base.cost - alone.cost > 10 * bonferroni_threshold(1, len(FEW))
    assert not any(c.adequate for c in seen.refits if "sensor_rotation" in c.ids)


def test_the_smallest_set_of_an_effect_that_was_not_refitted_alone_is_named() -> None:
    seen = case("few")
    smallest = "sensor_crosstalk + time_delay"
    assert seen.reason("time_delay") == (
        "rejected, because no set that it was refitted in explains the residual "
        f"(the smallest: {smallest}; not beside the final model)"
    )
    assert seen.sets_with("time_delay")[0] == {"sensor_crosstalk", "time_delay"}
    assert not any(c.adequate for c in seen.refits if "time_delay" in c.ids)


def test_what_others_left_no_refit_for_is_told() -> None:
    """Beside the rigid tool three others have larger scores, and so it goes on."""
    seen = case("more")
    assert seen.reason("time_delay") == (
        "not tried, because the search refits at most 3 effects beside each set, and others had larger scores: give it "
        "fewer candidates by --only"
    )
    alone = [c.ids for c in seen.refits if len(c.ids) == 1 and c.ids <= {*MORE}]
    assert len(set(alone)) >= MAX_REFITS
    fewer = watched(simulated(Magnet(), seed=0), ("gravity_tilt", "time_delay"))  # the advice
    assert {"time_delay"} in fewer.sets_with("time_delay")
    assert fewer.findings["time_delay"].reason.startswith("rejected") or "time_delay" in fewer.found.added


def test_a_search_that_ended_without_convergence_is_told_after_the_fallback() -> None:
    """The final model is the rigid tool, whose fit converges."""
    seen = case("unconverged")
    assert (seen.found.added, seen.found.fit.converged) == ((), True)
    assert {len(c.ids) for c in seen.refits} <= {0, 1}
    for untried in ("sensor_gain", "time_delay"):
        assert seen.reason(untried) == (
            "not tried, because the search does not go on from sensor_crosstalk, whose refit has not converged: "
            "exclude effects of that set by --without; beside other sets, of which each has at most 3 refits, others "
            "had larger scores"
        )
    assert seen.reason("sensor_rotation").endswith(
        f"{ALIKE}; the search ended at sensor_crosstalk, whose refit has not converged"
    )


def test_only_a_refit_that_was_made_and_is_not_significant_is_said_to_be_so() -> None:
    seen = case("faint")
    assert seen.reason("faint_drag") == (
        "rejected, because it is significant in the score test, but not after the exact refit"
    )
    alone = next(c for c in seen.refits if c.ids == {"faint_drag"})
    assert seen.selections[-1].base.cost - alone.cost < bonferroni_threshold(2, 1)


def test_what_has_not_converged_is_not_said_to_be_insignificant() -> None:
    recording = simulated(simulated_rig.ViscousDrag(c=0.15, d=0.12), seed=1)
    seen = watched(recording, [FaintDrag()], without_convergence)
    assert seen.reason("faint_drag") == (
        "rejected, because it is significant in the score test, but its exact refit has not converged"
    )


def test_a_refit_without_a_solution_is_told() -> None:
    seen = watched(simulated(LAG, seed=1), ["time_delay"], without_solution)
    assert seen.refits == []
    assert seen.reason("time_delay") == (
        "rejected, because time_delay has no solution at the initial values of its exact refit"
    )


def test_the_set_that_was_preferred_is_named() -> None:
    """In a single run, where each set has a noise of its own: the refit is judged in that of the larger set."""
    seen = case("run")
    assert seen.chosen == {"sensor_lag"}
    assert seen.reason("time_delay") == (
        f"rejected, because the search preferred sensor_lag to every set that it was refitted in, {ALIKE}"
    )
    delay = next(c for c in seen.refits if c.ids == {"time_delay"})
    assert subset_search.refit_effects(delay, ()).cost - delay.cost > bonferroni_threshold(1, len(FEW))
