"""Acceptance: an effect stays only if its amount is told from none, and if it helps on held-out data that can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2, norm

from diagnosis.acceptance import AcceptanceEvidence, accept, amount_p_value
from diagnosis.diagnosis import diagnose
from diagnosis.held_out import HeldOut
from diagnosis.subset_search import CandidateModel
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from estimation.fit import Fit, fit
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.effects import named
from modeling.significance import LEVELS
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import GravityTilt, HiddenEffect, PlanarRig, SensorGain, ViscousDrag, simulate
from truewrench.simulated_rig.hidden_effect import ToolLoad
from truewrench.simulated_rig.mujoco_scene import Array, Track

pytest.importorskip("mujoco")

DRAG = ViscousDrag(c=0.15, d=0.12)
WRONG = SensorGain(errors=(("fy", 0.02),))


@cache
def run(seed: int, *hidden: HiddenEffect, name: str = "train", samples: int = 100) -> Recording:
    rig = PlanarRig()
    motion = rig.random_motion(seed=seed)
    frame = simulate(rig, motion, hidden=hidden, repeats=4, samples_per_period=samples, seed=seed)
    return recording_of(frame, name=name, rig=RIG)


def fitted(recording: Recording, *ids: str) -> Fit:
    drag = {"viscous_drag.c": 0.1, "viscous_drag.d": 0.1} if "viscous_drag" in ids else {}
    return fit(planar(RIG) + [named(i) for i in ids], recording, start=drag)


def held_out(fit_of: Fit, *recordings: Recording) -> list[HeldOut]:
    case = Case.of(fit_of.model.base, fit_of.recordings, recordings)
    return [HeldOut(r, n) for r, n in zip(case.held_out, case.held_out_noise, strict=True)]


def moved(estimate: Fit, name: str, std: float) -> Fit:
    """The fit with a parameter at so many of its std."""
    place = list(estimate.parameters).index(name)
    theta = estimate.theta.copy()
    theta[place] = std * estimate.parameters[name].std
    return replace(estimate, theta=theta)


@pytest.mark.parametrize(("std", "stays"), [(1.98, False), (2.02, True), (-1.98, False), (-2.02, True), (0.0, False)])
def test_an_amount_within_two_std_of_none_is_not_accepted(std: float, stays: bool) -> None:
    """However the search found it; at the edge: of readings to which as much of a tilt is added."""
    first = fitted(run(1), "gravity_tilt")
    there = moved(first, "gravity_tilt.angle", std)
    tilt = there.predicted_readings(0) - first.predicted_readings(0)
    readings = run(1).with_readings(run(1).wrench + tilt)
    tilted = fitted(readings, "gravity_tilt")
    assert tilted["gravity_tilt.angle"].value / tilted["gravity_tilt.angle"].std == pytest.approx(std, abs=0.01)
    accepted = accept(CandidateModel(tilted, 1), CandidateModel(fitted(readings), 1), [], [])
    assert bool(accepted.candidate.ids) is stays
    reason = "its amount is within 2 standard deviations of none"
    assert accepted.reasons == ({} if stays else {"gravity_tilt": reason})


def test_the_level_is_that_of_two_std_and_of_all_amplitudes_together() -> None:
    """One amplitude at k std has the two-sided p of a normal; of several that are correlated none need be beyond 2."""
    assert pytest.approx(2 * norm.sf(2.0), abs=5e-5) == LEVELS.amount
    tilted = moved(fitted(run(1), "gravity_tilt"), "gravity_tilt.angle", 1.7)
    assert amount_p_value(tilted.model.effects[0], tilted) == pytest.approx(2 * norm.sf(1.7))
    leaks = fitted(run(1), "sensor_crosstalk")
    parameters = leaks.model.effects[0].qualified(leaks.model.space)
    names = [p.name for p in parameters if np.isfinite(leaks[p.name].std) and not p.fixed]
    place = [list(leaks.parameters).index(n) for n in names]
    values = leaks.theta[place]
    expected = chi2.sf(values @ np.linalg.solve(leaks.covariance[np.ix_(place, place)], values), len(names))
    assert len(names) > 1
    assert amount_p_value(leaks.model.effects[0], leaks) == pytest.approx(expected)


def accepted_with(trained: Fit, others: Sequence[Recording]) -> tuple[frozenset[str], dict[str, str]]:
    base = CandidateModel(fitted(trained.recordings[0]), 1)
    accepted = accept(CandidateModel(trained, 1), base, held_out(trained, *others), [])
    return accepted.candidate.ids, accepted.reasons


def test_each_effect_has_to_lower_the_error_held_out_not_their_set_alone() -> None:
    """A gain that only the fitted recording has, beside a drag that both have: the set lowers the error 20 times."""
    trained = fitted(run(1, DRAG, WRONG), "viscous_drag", "sensor_gain")
    ids, reasons = accepted_with(trained, [run(2, DRAG, name="other")])
    assert ids == {"viscous_drag"}
    assert reasons == {"sensor_gain": "it does not lower the error on held-out other"}
    ids, reasons = accepted_with(trained, [run(2, DRAG, WRONG, name="other")])
    assert ids == {"viscous_drag", "sensor_gain"}
    assert not reasons


def test_what_a_held_out_motion_cannot_show_is_kept_and_said() -> None:
    """A tilt beside noise a hundred times as large; with the noise as it is the same recording rejects it."""
    trained = fitted(run(1, GravityTilt(tilt_y=0.01)), "gravity_tilt")
    other = run(2, name="other")
    (judge,) = held_out(trained, other)
    candidate, base = CandidateModel(trained, 1), CandidateModel(fitted(trained.recordings[0]), 1)
    assert AcceptanceEvidence(candidate, base, [judge]).not_improved == ("gravity_tilt", "other")
    rng = np.random.default_rng(3)
    loud = other.with_readings(other.wrench + 30 * np.array(PlanarRig().noise) * rng.normal(size=other.wrench.shape))
    (deaf,) = held_out(trained, loud)
    evidence = AcceptanceEvidence(candidate, base, [deaf])
    assert evidence.not_improved is None
    sentence = "kept though it does not lower the error on held-out other: the motion there does not show it"
    assert evidence.reservations == {"gravity_tilt": sentence}


@dataclass(frozen=True, kw_only=True)
class ArctanFriction(ToolLoad):
    """A friction torque whose step is an arctangent, with Stribeck's peak: neither is the catalogue's."""

    id = "arctan_friction"
    needs_motion = True
    level: float
    width: float
    peak: float
    d: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """No force; the torque against the rotation."""
        speed = np.linalg.norm(track.spin, axis=1, keepdims=True)
        size = 2 / np.pi * np.arctan(speed / self.width) * (1 + self.peak * np.exp(-((speed / 0.1) ** 2)))
        against = np.divide(track.spin, speed, out=np.zeros_like(track.spin), where=speed > 0)
        return np.zeros_like(track.spin), -self.level * size * against


@pytest.mark.long
@pytest.mark.parametrize(("width", "peak"), [(0.005, 0.0), (0.02, 0.0), (0.02, 0.3)])
def test_a_friction_of_another_law_is_named_alone(width: float, peak: float) -> None:
    """What its law leaves, up to 1 % of it, is said to remain, and looked for in no other effect."""
    recording = run(3, ArctanFriction(level=0.15, width=width, peak=peak), samples=250)
    diagnosis = diagnose(planar(RIG), recording)
    assert diagnosis.added == ("coulomb_friction",)
    assert diagnosis.verdict in (RecordVerdict.PARTLY_EXPLAINED, RecordVerdict.EXPLAINED)
