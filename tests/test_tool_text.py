"""The tool in one line: what is known of it, and what is not where the readings are another's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from benchmarks.single_run import RIG, SingleRun
from benchmarks.unlisted_physics import GuidingHand
from diagnosis.comparison.comparison import comparison_of
from diagnosis.comparison.slow_residual import Part, SlowResidual, foreign_forces
from estimation.confidence_intervals import intervals
from estimation.fit import Fit, fit
from estimation.recordings.recording import Recording
from modeling.chain.model import spatial
from modeling.rig.rig import Convention
from truewrench.simulated_rig import HiddenEffect
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import tool_text

pytest.importorskip("mujoco")


def run(seed: int, *hidden: HiddenEffect) -> Recording:
    return SingleRun(noise="white", motion="sines", seed=seed, hidden=hidden).recording()


def fitted(recordings: Sequence[Recording]) -> Fit:
    return fit(replace(spatial(), convention=Convention.ON_TOOL), recordings)


@pytest.mark.parametrize("seed", [41, 42])
def test_a_hand_most_of_the_time_leaves_the_tool_unknown(seed: int) -> None:
    """12 N at random on a tool of the same weight: a mass estimated of it has an error of as much as it is."""
    found = fitted([run(seed, GuidingHand())])
    text = FitSummary(found, intervals(found)).text(None)
    assert "Tool: not known, as most of what f" in text
    assert "Tool: m " not in text


def test_a_recording_without_the_hand_says_what_the_tool_is() -> None:
    found = fitted([run(41, GuidingHand()), replace(run(43), name="free")])
    held, free = (comparison_of(found, number) for number in range(2))
    assert foreign_forces([held])
    assert foreign_forces([held, free]) == ()
    assert "Tool: m " in FitSummary(found, intervals(found)).text(None)


def test_a_hand_that_is_the_smaller_part_of_the_force_does_not_hide_the_tool() -> None:
    """3 N at random beside 12 N of weight."""
    found = fitted([run(41, GuidingHand(force=3.0))])
    assert "Tool: m " in FitSummary(found, intervals(found)).text(None)


def test_the_tool_of_a_free_run_is_known() -> None:
    found = fitted([run(44)])
    text = tool_text(found, misfitting=False, foreign=foreign_forces([comparison_of(found, 0)]))
    assert text.startswith("Tool: m ")
    mass = found.parameters["m"]
    assert abs(mass.value - RIG.mass) < 4 * mass.std


def test_a_torque_that_is_not_the_tools_does_not_hide_its_weight() -> None:
    channels = {"fx": "N", "tx": "N m"}
    slow = SlowResidual(
        "run",
        rms=dict.fromkeys(channels, 5.0),
        floor=dict.fromkeys(channels, 0.1),
        units=channels,
        p_value=dict.fromkeys(channels, 0.0),
        part={"fx": Part.MOTION_BAND, "tx": Part.FOREIGN},
    )
    assert slow.foreign_forces == ()
    assert replace(slow, part=dict.fromkeys(channels, Part.FOREIGN)).foreign_forces == ("fx",)
