"""What comes closest to an effect: said beside one that was added, and of one that was given and is the wrong one."""

from __future__ import annotations

from functools import cache

import pytest

from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.subset_search import CandidateModel
from diagnosis.verdict_rule import RecordVerdict
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.effects import named
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, TimeDelay, simulate
from truewrench.text.diagnosis_text import diagnosis_text

pytest.importorskip("mujoco")

CANDIDATES = ("time_delay", "sensor_lag", "viscous_drag")


@cache
def late(delay: float) -> Recording:
    """Readings that are late: a lag of the same time looks the same at low frequencies."""
    rig = PlanarRig()
    frame = simulate(
        rig, rig.random_motion(seed=3), hidden=(TimeDelay(delay=delay),), repeats=4, samples_per_period=250, seed=3
    )
    return recording_of(frame, name="late", rig=RIG)


@cache
def diagnosed(delay: float, *given: str) -> Diagnosis:
    model = planar(RIG) + [named(i) for i in given]
    return diagnose(model, late(delay), effects=[named(i) for i in CANDIDATES])


def test_a_wrong_effect_that_was_given_is_not_left_alone() -> None:
    """A lag leaves no significant residual of so small a delay, and yet the delay fits better."""
    found = diagnosed(0.009, "sensor_lag")
    assert found.verdict is RecordVerdict.NOTHING_MISSING
    (other,) = found.given_alternatives
    assert (other.given, other.effect.id) == ("sensor_lag", "time_delay")
    assert other.gain > 0
    assert "in the place of sensor_lag, which the model began with" in diagnosis_text(found)
    assert found.to_data()["given_alternatives"] == [{"given": "sensor_lag", "id": "time_delay", "gain": other.gain}]


@pytest.mark.parametrize("delay", [0.004, 0.012, 0.02])
def test_the_excess_is_that_of_an_exact_refit(delay: float) -> None:
    """By how much the chi-square of the readings is higher with the closest other effect."""
    found = diagnosed(delay)
    (finding,) = [f for f in found.findings if f.effect.id in found.added]
    closest = finding.closest
    assert closest is not None
    assert {finding.effect.id, closest.effect.id} == {"time_delay", "sensor_lag"}
    last = found.fit
    model = last.model.without(finding.effect.id) + closest.effect
    start = {**last.values, **dict.fromkeys((p.name for p in closest.effect.qualified(model.space)), delay)}
    other = last.refitted(model, start)
    exact = CandidateModel(other, 1).cost - CandidateModel(last, 1).cost
    # Both at the same values but for what the noise moves them: a few units of chi-square for the parameters shared.
    assert closest.excess == pytest.approx(exact, rel=0.05, abs=1.0)


def test_what_is_barely_separated_is_said() -> None:
    small, large = diagnosis_text(diagnosed(0.004)), diagnosis_text(diagnosed(0.02))
    assert "barely separate" in small or "Indistinguishable" in small
    assert "No other candidate effect is confusable with it" in large
