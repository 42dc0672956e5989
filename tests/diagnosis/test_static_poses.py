"""Diagnosis of poses at rest whose noise nothing tells but the residual: what is hidden is found, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.diagnosis import Diagnosis, diagnose_case
from diagnosis.study import study_case
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from modeling.chain.model import planar, spatial
from modeling.rig import Rig
from tests.shared.recordings import recording_of
from truewrench.simulated_rig import (
    CableSpring,
    GravityTilt,
    HiddenEffect,
    PlanarRig,
    Saturation,
    SensorGain,
    SensorHysteresis,
    SensorRotation,
    SpatialRig,
    static_poses,
)
from truewrench.text.tool_text import tool_text

SPACE, PLANE = SpatialRig(), PlanarRig()
PLANAR = Rig(link_lengths=PLANE.link_lengths, tip_length=0.2)


def case_of(rig: SpatialRig | PlanarRig, count: int, *hidden: HiddenEffect, seed: int = 3) -> Case:
    frame = static_poses(rig, count, hidden=hidden, seed=seed).drop(columns=["temperature"])
    plane = isinstance(rig, PlanarRig)
    return Case.of(planar(PLANAR) if plane else spatial(), [recording_of(frame, rig=PLANAR if plane else None)])


def diagnosed(rig: SpatialRig | PlanarRig, count: int, *hidden: HiddenEffect, seed: int = 3) -> Diagnosis:
    return diagnose_case(case_of(rig, count, *hidden, seed=seed))


@pytest.mark.parametrize("hidden", [SensorGain(), SensorRotation(), GravityTilt(), SensorHysteresis()])
def test_what_is_hidden_in_six_axes_is_found(hidden: HiddenEffect) -> None:
    diagnosis = diagnosed(SPACE, 30, hidden)
    assert diagnosis.added == (hidden.id,)
    assert diagnosis.verdict is RecordVerdict.EXPLAINED
    mass = diagnosis.fit.parameters["m"]
    assert abs(mass.value - SPACE.mass) < 5 * mass.std


@pytest.mark.parametrize("hidden", [Saturation(), CableSpring()])
def test_what_is_hidden_in_the_plane_is_found(hidden: HiddenEffect) -> None:
    assert diagnosed(PLANE, 30, hidden).added == (hidden.id,)


@pytest.mark.parametrize("rig", [SPACE, PLANE])
def test_nothing_is_found_where_nothing_is_hidden(rig: SpatialRig | PlanarRig) -> None:
    for seed in range(5):
        assert diagnosed(rig, 16 + 5 * seed, seed=seed).verdict is RecordVerdict.NOTHING_MISSING


def test_a_gain_of_the_first_channel_is_said_to_be_the_mass_s() -> None:
    """21 poses, of which fx reads 20 % too much: the others' gains are relative to it, and so is the mass."""
    recording = case_of(SPACE, 21).recordings[0]
    readings = np.array(recording.wrench)
    readings[:, 0] *= 1.2
    diagnosis = diagnose_case(Case.of(spatial(), [recording.with_readings(readings)]))
    assert diagnosis.added == ("sensor_gain",)
    for channel in ("fy", "fz"):
        gain = diagnosis.fit.parameters[f"sensor_gain.{channel}"]
        assert abs(gain.value - 1 / 1.2) < 5 * gain.std
    assert "as fx weighs it, to which the gains are relative" in tool_text(diagnosis.fit, misfitting=False)


def test_a_study_suspects_it_too() -> None:
    """In the noise of the residual alone its p-value was that of noise."""
    suspects = study_case(case_of(SPACE, 24, SensorGain())).suspects()
    assert "sensor_gain" in suspects.ids[:3]
    assert all(p < 1e-4 for p in suspects.table.to_frame()["p"][:3])
