"""Beside a hand on the tool: an effect that is there is kept; one that fits only the residual of the hand is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from diagnosis.acceptance import effect_of_foreign_residual
from diagnosis.screening.score_test import screen
from diagnosis.subset_search import CandidateModel, refit_with_effect
from estimation.fit import fit
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import planar
from modeling.effects import viscous_drag
from modeling.formulas.custom_effect import CustomEffect
from tests.shared.recordings import single_run
from truewrench.simulated_rig import HiddenEffect, ViscousDrag

pytest.importorskip("mujoco")


RISING = CustomEffect.from_data(
    {"id": "rising", "title": "a torque that rises", "parameters": {"k": "N m"}, "zero": {"tau": "k*progress"}},
    where="test",
)


def with_effect(recording: Recording, effect: Effect) -> CandidateModel:
    base = CandidateModel(fit(planar(recording.rig), recording), candidates=1)
    return refit_with_effect(base, screen(base.fit, [effect])[0])


def held(seed: int, *hidden: HiddenEffect) -> Recording:
    """A single run; a hand turns the tool, slowly and at random, with several times the torque of its weight."""
    recording, rng = single_run(seed, *hidden), np.random.default_rng(seed)
    numerator, denominator = butter(2, 0.01)
    torque = lfilter(numerator, denominator, rng.normal(size=recording.samples + 500))[500:]
    wrench = recording.wrench.copy()
    wrench[:, 2] += 5.0 * torque / torque.std()
    return replace(recording, wrench=wrench)


@pytest.mark.parametrize("seed", range(3100, 3104))
def test_effect_that_shows_elsewhere_too_is_kept(seed: int) -> None:
    recording = held(seed, ViscousDrag(c=0.3, d=0.12))
    assert effect_of_foreign_residual(with_effect(recording, viscous_drag())) is None


@pytest.mark.parametrize("seed", range(3100, 3104))
def test_effect_that_fits_the_hand_is_rejected(seed: int) -> None:
    """The torque rises during the run, by less than the hand: only the foreign channel tells."""
    recording = held(seed)
    recording.wrench[:, 2] += np.linspace(-1, 1, recording.samples)
    rejected = effect_of_foreign_residual(with_effect(recording, RISING))
    assert rejected is not None
    assert rejected[0] == "rising"
    assert "on tau of run.csv, where a residual larger than the tool's own wrench remains" in rejected[1]


def test_effect_that_explains_most_of_a_channel_is_kept() -> None:
    """A torque that rises by more than what is left of the hand."""
    recording = held(3100)
    recording.wrench[:, 2] += 25 * np.linspace(-1, 1, recording.samples)
    assert effect_of_foreign_residual(with_effect(recording, RISING)) is None


def test_without_a_foreign_residual_nothing_is_rejected() -> None:
    """Neither what is there nor what was only fitted: other rules decide on that."""
    for hidden in ((), (ViscousDrag(c=0.3, d=0.12),)):
        assert effect_of_foreign_residual(with_effect(single_run(3100, *hidden), viscous_drag())) is None
