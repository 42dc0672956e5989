"""The tool in one line: what is known of it, and what is not where the readings are another's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.robot_motions import sines
from benchmarks.single_run import RIG, SingleRun, recorded
from benchmarks.unlisted_physics import GuidingHand
from diagnosis.comparison.comparison import comparison_of
from diagnosis.comparison.slow_residual import SlowResidual, foreign_forces
from diagnosis.comparison.steadiness import ResidualSpectrum
from diagnosis.verdict.unexplained_residual import unknown_tool_reason
from estimation.confidence_intervals import intervals
from estimation.fit import Fit, fit
from estimation.recordings.recording import Recording
from modeling.chain.model import spatial
from modeling.number_format import estimate_text
from modeling.rig import Convention
from truewrench.simulated_rig import HiddenEffect, simulate
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import left_out_channels, tool_text

pytest.importorskip("mujoco")


@cache
def run(seed: int, *hidden: HiddenEffect) -> Recording:
    return SingleRun(noise="white", motion="sines", seed=seed, hidden=hidden).recording()


def fitted(recordings: Sequence[Recording]) -> Fit:
    return fit(replace(spatial(), convention=Convention.ON_TOOL), recordings)


@pytest.mark.parametrize("seed", [41, 42])
def test_a_hand_most_of_the_time_leaves_the_tool_unknown(seed: int) -> None:
    """12 N at random on a tool of the same weight: a mass estimated of it has an error of as much as it is."""
    found = fitted([run(seed, GuidingHand())])
    text = FitSummary(found, intervals(found)).text(None)
    assert "The tool is not known, as most of what f" in text
    assert "Tool: m " not in text


def test_a_recording_without_the_hand_says_what_the_tool_is() -> None:
    found = fitted([run(41, GuidingHand()), replace(run(43), name="free")])
    held, free = (comparison_of(found, number) for number in range(2))
    assert foreign_forces([held])
    assert foreign_forces([held, free]) == ()
    assert "Tool: m " in FitSummary(found, intervals(found)).text(None)


def test_a_vibration_above_the_motion_does_not_hide_the_tool() -> None:
    """20 N at a tenth of the sample rate beside 12 N of weight that turns in seconds."""
    frame = SingleRun(noise="white", motion="sines", seed=46).frame()
    shaken = 30 * np.sin(0.2 * np.pi * np.arange(len(frame)))
    found = fitted([recorded(frame.assign(fx=frame["fx"] + shaken, fy=frame["fy"] + shaken))])
    assert unknown_tool_reason([comparison_of(found, 0)], found.model) == ""
    mass = found.parameters["m"]
    assert abs(mass.value - RIG.mass) < 4 * mass.std


def test_two_recordings_that_hide_the_tool_in_two_ways_leave_it_unknown() -> None:
    unrecorded = SingleRun(noise="white", motion="sines", seed=47).frame().drop(columns=["px", "py", "pz"])
    found = fitted([run(41, GuidingHand()), replace(recorded(unrecorded), name="unrecorded")])
    reasons = [unknown_tool_reason([comparison_of(found, number)], found.model) for number in range(2)]
    assert len(set(reasons)) == 2
    assert all(reasons)
    assert unknown_tool_reason([comparison_of(found, number) for number in range(2)], found.model) == "; ".join(
        sorted(reasons, reverse=True)
    )


def test_a_hand_that_is_the_smaller_part_of_the_force_does_not_hide_the_tool() -> None:
    """3 N at random beside 12 N of weight."""
    found = fitted([run(41, GuidingHand(force=3.0))])
    unknown = unknown_tool_reason([comparison_of(found, 0)], found.model)
    assert tool_text(found, misfitting=True, unknown=unknown).startswith("Tool: m ")


def test_the_tool_of_a_free_run_is_known() -> None:
    found = fitted([run(44)])
    assert not unknown_tool_reason([comparison_of(found, 0)], found.model)
    text = tool_text(found, misfitting=False)
    assert text.startswith("Tool: m ")
    mass = found.parameters["m"]
    assert abs(mass.value - RIG.mass) < 4 * mass.std
    assert "converged" not in FitSummary(found, intervals(found)).text(None)


def test_estimates_and_intervals_have_the_digits_of_their_std() -> None:
    found = fitted([run(44)])
    mass, ends = found.parameters["m"], intervals(found)
    for table in (found.table, ends.table):
        shown = {row[0]: row[1] for row in (line.split() for line in str(table).splitlines()[1:])}
        assert shown["m"] == f"{float(estimate_text(mass.value, mass.std, '1').split()[0]):g}"
    assert found.table.to_frame()["value"][6] == mass.value


def test_a_channel_that_never_changes_is_left_out() -> None:
    """Without noise two constant torques would weigh as much as all else together; the others tell what they can."""
    readings = np.array(run(44).wrench)
    readings[:, 3:5] = 0.4, -0.7
    right, found = fitted([run(44)]), fitted([run(44).with_readings(readings)])
    assert left_out_channels(found) == ("tx", "ty")
    tool, text = tool_text(found, misfitting=False), FitSummary(found, intervals(found)).text(None)
    assert tool.endswith("(tx never changes; ty never changes).")
    assert "bias_tx    not known, as tx never changes" in text
    for name in ("m", "mx", "my", "mz"):
        std = found.parameters[name].std
        assert std > 0.9 * right.parameters[name].std
        assert abs(found.values[name] - right.values[name]) < 4 * std
    assert np.abs(found.residuals[0][:, 3:5]).max() == 0


def test_a_fit_that_has_not_converged_is_not_presented_as_one() -> None:
    """First of all, beside the tool, and among the remarks."""
    found = replace(fitted([run(44)]), converged=False)
    summary = FitSummary(found, intervals(found))
    text = summary.text(None)
    assert text.startswith("Not converged: the estimates are not final.")
    (tool,) = (line for line in text.splitlines() if line.startswith("Tool: "))
    assert "(not converged: the estimates are not final" in tool
    assert "not converged: the estimates are not final" in found.remarks()


def test_a_torque_that_is_not_the_tools_does_not_hide_its_weight() -> None:
    frame = SingleRun(noise="white", motion="sines", seed=45).frame()
    found = fitted([recorded(frame.assign(tx=frame["tx"] + 5 * np.sin(3 * frame["time"])))])
    assert SlowResidual.of_foreign(
        "run",
        ResidualSpectrum.of(found.residuals[0], found.recordings[0].wrench - found.residuals[0]),
        found.recordings[0].wrench.var(axis=0),
        found.model.space.channel_units,
    ).above_noise == ("tx",)
    assert foreign_forces([comparison_of(found, 0)]) == ()


@pytest.mark.parametrize("samples", [200, 25_000])
def test_the_length_of_a_record_does_not_hide_the_hand(samples: int) -> None:
    """With many samples the p-value of a residual in the motion's band is 0 too; 200 samples are not tested."""
    frame = simulate(RIG, sines(41), hidden=(GuidingHand(),), repeats=1, samples_per_period=samples, seed=41)
    comparison = comparison_of(fitted([recorded(frame)]), 0)
    assert bool(foreign_forces([comparison])) == (samples > 200)
