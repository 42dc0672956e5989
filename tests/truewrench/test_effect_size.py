"""The size of an effect in a recording: a drag's at the largest speed, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.fit import fit
from modeling.chain.model import planar
from modeling.effects import named
from tests.shared.recordings import drag_and_leak
from tests.shared.rigs import RIG
from truewrench.effect_description.effect_size import largest_change, size_sentence

pytest.importorskip("mujoco")


def test_drag_at_the_largest_speed_of_its_point() -> None:
    """c |v|, v of the point at d along the tip, by hand from the recorded motion."""
    recording = drag_and_leak(1)
    fitted = fit(planar(RIG) + named("viscous_drag"), recording)
    signals, values = recording.motion.model_signals, fitted.values
    turn, d = signals["phi"], values["viscous_drag.d"]
    velocity = [signals["vx"] + d * np.cos(turn) * signals["dphi"], signals["vy"] - d * np.sin(turn) * signals["dphi"]]
    expected = values["viscous_drag.c"] * np.hypot(*velocity).max()
    found = largest_change(fitted, "viscous_drag")
    assert found is not None
    assert found[0] == pytest.approx(expected, rel=1e-6)
    assert f"{expected:.2f}"[:3] in size_sentence(fitted, "viscous_drag")


def test_a_recording_specific_effect_has_none() -> None:
    fitted = fit(planar(RIG) + named("bias_drift"), drag_and_leak(1))
    assert largest_change(fitted, "bias_drift") is None
    assert size_sentence(fitted, "bias_drift") == ""
