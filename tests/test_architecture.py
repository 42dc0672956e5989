"""What ARCHITECTURE.md says, and the decisions: the files are there, and what can be added can be from outside."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from design.criteria import Criterion
from design.trajectories.fourier import FreeSeries
from design.trajectory_design import design
from diagnosis.diagnosis import diagnose
from diagnosis.verdict.finding import EFFECT_RULES, EffectRule
from diagnosis.verdict_rule import EffectVerdict, VerdictRule
from modeling.chain.model import planar
from modeling.effects import named
from modeling.effects.loads import ViscousDrag
from modeling.rig import Limits, Rig
from tests.shared.places import ROOT
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench import simulated_rig
from truewrench.simulated_rig import PlanarRig, simulate

MAP = ROOT / "ARCHITECTURE.md"
DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))


@pytest.mark.parametrize("page", [MAP, *DECISIONS], ids=lambda page: page.stem)
def test_every_file_that_a_page_names_is_there(page: Path) -> None:
    """Names without a folder belong to the folder named before them."""
    folder, missing, text = ROOT, [], page.read_text()
    for name in re.findall(r"`([\w/*]+(?:\.py|/))`", text):
        place = (ROOT / name) if "/" in name else folder / name
        if "*" in name:
            assert list(ROOT.glob(name)), name
            continue
        folder = place if name.endswith("/") else place.parent
        if not place.exists():
            missing.append(name)
    assert missing == []
    assert page.stem == "index" or len(re.findall(r"`[\w/]+\.py`", text)) > (30 if page == MAP else 1)


@dataclass(frozen=True)
class HoseDrag(ViscousDrag):
    """A drag under a name of its own."""

    id = "hose_drag"
    title = "drag of a hose"


def test_an_effect_from_outside_is_found() -> None:
    """The data are MuJoCo's; the new class replaces the catalogue's, among others that are not there."""
    pytest.importorskip("mujoco")
    hidden = (simulated_rig.ViscousDrag(),)
    frame = simulate(
        PlanarRig(), PlanarRig().random_motion(seed=5), hidden=hidden, repeats=4, samples_per_period=200, seed=5
    )
    recording = recording_of(frame, rig=RIG)
    found = diagnose(planar(RIG), recording, effects=[HoseDrag(), named("sensor_lag"), named("gravity_tilt")])
    assert found.added == ("hose_drag",)


def test_a_verdict_rule_from_outside_is_asked_in_order() -> None:
    """The same evidence on the same noise: a rule before the others decides, and after them none of it is left."""
    frame = simulate(PlanarRig(), PlanarRig().random_motion(seed=5), repeats=4, samples_per_period=200, seed=5)
    recording = recording_of(frame, rig=RIG)
    unloaded: EffectRule = VerdictRule(
        "no drag in the laboratory's vacuum",
        lambda evidence: evidence.screening.effect.id == "viscous_drag",
        EffectVerdict.NOT_EXCITED,
        "p = {e.screening.p_value:.1g}, and there is no air",
    )
    effects = [named("viscous_drag"), named("sensor_lag")]
    first, last, usual = (
        {f.effect.id: f for f in diagnose(planar(RIG), recording, effects=effects, effect_rules=rules).findings}
        for rules in ((unloaded, *EFFECT_RULES), (*EFFECT_RULES, unloaded), EFFECT_RULES)
    )
    assert first["viscous_drag"].verdict is EffectVerdict.NOT_EXCITED
    assert first["viscous_drag"].reason.endswith("there is no air")
    assert first["sensor_lag"].verdict is usual["sensor_lag"].verdict
    assert {i: (f.verdict, f.reason) for i, f in last.items()} == {i: (f.verdict, f.reason) for i, f in usual.items()}
    assert usual["viscous_drag"].verdict is not EffectVerdict.NOT_EXCITED


@dataclass(frozen=True)
class TraceOptimal(Criterion):
    """ln tr M, the information's mean eigenvalue: larger where the motion is larger, whatever it leaves unknown."""

    name = "ln tr M"

    def expression(self, information: Any) -> Any:
        """ln tr M."""
        return ca.log(ca.trace(information))

    def degree(self, size: int) -> float:
        """1: ln tr cM = ln tr M + ln c."""
        return 1.0 + 0 * size


def test_a_criterion_from_outside_is_designed_for() -> None:
    """Its own optimum is better by it than the D-optimal motion, and worse by ln det."""
    ends = np.array([[-1.0, 1.0]] * 3)
    limits = Limits(position=ends, velocity=2 * ends, acceleration=6 * ends)
    rig = Rig(name="three joints", link_lengths=(1.0, 0.97, 0.4), tip_length=0.2, limits=limits)
    options: dict[str, Any] = {
        "series": FreeSeries(joints=3, harmonics=(1, 2), period=5.0),
        "starts": 4,
        "samples": 60,
        "bounded": False,
    }
    mine, usual = design(rig, criterion=TraceOptimal(), **options), design(rig, **options)
    by = [np.log(np.trace(plan.experiment.information(plan.motion, plan.samples))) for plan in (mine, usual)]
    assert by[0] > by[1]
    assert usual.logdet > mine.logdet
