"""The measured recordings of a KUKA LBR Med 14 with an ATI Gamma and an unknown tool (Skrede, Zenodo 11096791).

Without them these tests are skipped.
What is known of them is a mass of 0.934 ± 0.003 kg and a centre of mass at (0.3, 0.1, 43.9) mm from the poses.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.contact.contact_wrench import ContactWrench, compensate
from estimation.fit import fit
from estimation.recordings.reading import read
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import decide_convention
from modeling.chain.model import spatial
from modeling.effects import named
from modeling.errors import InputError
from modeling.rig import Convention, Rig
from tests.shared.places import AIS2202, needs
from truewrench.text.tool_text import BIASED, tool_text

pytestmark = needs(AIS2202)

KNOWN_MASS = 0.934


@lru_cache
def recording(name: str) -> Recording:
    return read(AIS2202 / f"{name}.csv", rig=Rig.read(AIS2202 / "rig.toml"))


LIKE_A_HAND = ("contact_event", "payload_change", "cable_spring", "thermal_drift", "sensor_rotation", "viscous_drag")
"""What a hand on the tool may be taken for: the second diagnosis of it need not try the rest again."""


@lru_cache
def diagnosed(*names: str) -> Diagnosis:
    candidates = None if len(names) == 1 else [named(effect) for effect in LIKE_A_HAND]
    return diagnose(spatial(Rig.read(AIS2202 / "rig.toml")), [recording(name) for name in names], effects=candidates)


def test_the_poses_weigh_the_tool_and_decide_the_sign() -> None:
    fitted = fit(spatial(), read(AIS2202 / "calibration_poses.csv"))
    assert fitted.model.convention is Convention.ON_SENSOR
    values = fitted.values
    assert values["m"] == pytest.approx(KNOWN_MASS, abs=0.003)
    centre = np.array([values["mx"], values["my"], values["mz"]]) / values["m"]
    assert np.allclose(centre, [0.3e-3, 0.1e-3, 43.9e-3], atol=0.2e-3)  # the last digit that is known, twice


@pytest.mark.parametrize("name", ["baseline", "vibrations", "contact"])
def test_the_runs_cannot_decide_the_sign(name: str) -> None:
    with pytest.raises(InputError, match="does not span three directions"):
        decide_convention([recording(name)], 9.806)


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(("contact",), marks=pytest.mark.long(seconds=75)),
        pytest.param(("contact", "calibration_poses"), marks=pytest.mark.long),
    ],
    ids=len,
)
def test_the_hand_is_found_and_not_taken_for_a_heavier_tool(names: tuple[str, ...]) -> None:
    """Fitted blindly the contact run weighs 1.20 kg; the hand is on the tool from about 0.6 s to 4.2 s.

    The force of a hand changes while it holds, so that 2.5 N of it remain, and this is said; alone, the run's mass is
    biased by what remains.
    """
    found = diagnosed(*names)
    assert found.added == ("contact_event",)
    assert found.verdict is RecordVerdict.PARTLY_EXPLAINED
    assert any(slow.above_noise for slow in found.slow_residuals)  # as which part of it is near a limit
    assert BIASED in tool_text(found.fit, misfitting=bool(found.misfitting))
    parameters = found.fit.parameters
    assert parameters["contact_event.start"].value == pytest.approx(0.6, abs=0.4)
    assert parameters["contact_event.end"].value == pytest.approx(4.2, abs=0.4)
    assert parameters["m"].value == pytest.approx(KNOWN_MASS, abs=0.06 if len(names) == 1 else 0.005)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) for n in ("calibration_poses", "baseline", "vibrations")]
)
def test_what_the_others_hold_has_no_name_in_the_catalogue(name: str) -> None:
    """A force that depends on the pose, interference and hammer taps: nothing to add, and it is said where they are."""
    found = diagnosed(name)
    assert found.added == ()
    assert found.verdict is RecordVerdict.UNEXPLAINED
    assert found.unexplained is not None
    assert found.unexplained.where


# -------------------------------------------------------------------- the contact, with parameters from the poses


@lru_cache
def compensated(name: str) -> ContactWrench:
    return compensate(fit(spatial(), recording("calibration_poses")), recording(name))


def test_the_hand_is_found_and_the_rest_is_free() -> None:
    """One interval, and outside it hardly more than what the sensor does by itself: forces as loud as in the untouched
    run, torques (the hand comes slowly, from 0.6 s on) at most 1.8 times."""
    contact = compensated("contact")
    (interval,) = contact.intervals
    assert contact.time_of(interval.first) == pytest.approx(0.7, abs=0.2)  # the hand comes slowly
    assert contact.time_of(interval.last) == pytest.approx(4.2, abs=0.1)
    assert contact.magnitude[interval.first : interval.last].max() > 20
    free = contact.wrench[contact.detection.free]
    alone = compensated("baseline").wrench
    assert (free.std(axis=0) < np.repeat([1.2, 1.8], 3) * alone.std(axis=0)).all()


def test_the_untouched_run_is_quiet_and_its_zero_has_moved() -> None:
    """Of fz by 0.4 N against the poses: a zero shift, and no contact of 0.4 N."""
    contact = compensated("baseline")
    assert not contact.intervals
    assert contact.zero_shift[2] == pytest.approx(0.4, abs=0.1)
    assert np.abs(contact.wrench.mean(axis=0)).max() < 1e-9


def test_the_taps_are_found() -> None:
    """Four blows of a hammer, each shorter than a fifth of a second; the tool swings a little after them."""
    contact = compensated("vibrations")
    assert 3 <= len(contact.intervals) <= 6
    assert all(contact.time_of(i.last) - contact.time_of(i.first) < 0.2 for i in contact.intervals)
