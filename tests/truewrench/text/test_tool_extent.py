"""A torque in other units is said by the size that it gives the tool; tools that are as large as tools are not."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import truewrench as tw
from tests.shared.places import AIS2202, DATA, needs
from truewrench.simulated_rig import HIDDEN_EFFECTS, HiddenEffect, PlanarRig, SpatialRig, simulate
from truewrench.text.tool_text import tool_extent_text

pytest.importorskip("mujoco")

ARMS = {"planar": PlanarRig(), "six axes": SpatialRig()}
UNITS = "the torque may be in other units"


def rig_of(space: str) -> tw.Rig:
    robot = {"link_lengths": [1.0, 0.97, 0.4]} if space == "planar" else {}
    return tw.Rig.from_data({"robot": robot, "sensor": {"convention": "on_tool"}})


def extent_of(frame: pd.DataFrame, space: str) -> str:
    rig = rig_of(space)
    model = tw.planar(rig) if space == "planar" else tw.spatial(rig)
    return tool_extent_text(tw.fit(model, tw.from_dataframe(frame, rig=rig)))


@cache
def recorded(space: str, *hidden: HiddenEffect) -> pd.DataFrame:
    arm = ARMS[space]
    return simulate(arm, arm.random_motion(seed=1), hidden=hidden, repeats=2, samples_per_period=200, seed=1)


@pytest.mark.parametrize("space", ARMS)
def test_a_torque_in_newton_millimetres_is_said(space: str) -> None:
    frame = recorded(space).copy()
    torques = [c for c in map(str, frame) if c in ("tau", "tx", "ty", "tz")]
    assert extent_of(frame, space) == ""
    frame[torques] *= 1000
    said = extent_of(frame, space)
    assert UNITS in said
    assert "radius of gyration" in said


@pytest.mark.parametrize("name", [name for name, effect in HIDDEN_EFFECTS.items() if not effect.spatial_only])
def test_a_tool_with_a_hidden_effect_is_not_called_too_large(name: str) -> None:
    assert extent_of(recorded("planar", HIDDEN_EFFECTS[name]), "planar") == ""


@needs(DATA)
@pytest.mark.parametrize("path", sorted(DATA.glob("planar/*/*.csv")), ids=lambda p: f"{p.parent.name}-{p.name}")
def test_recordings_have_tools_of_the_size_of_tools(path: Path) -> None:
    """Planar ones of the puzzles, with a hidden effect each."""
    recording = tw.read(path, rig=path.parent / "rig.toml")
    assert recording.rig is not None
    assert tool_extent_text(tw.fit(tw.planar(recording.rig), recording)) == ""


@needs(DATA)
@pytest.mark.parametrize("name", ["calibration_poses", "baseline", "vibrations", "contact"])
def test_measured_recordings_have_tools_of_the_size_of_tools(name: str) -> None:
    """Among them motions that hardly excite the inertia."""
    rig = tw.Rig.read(AIS2202 / "rig.toml")
    recording = tw.read(AIS2202 / f"{name}.csv", rig=rig)
    assert np.isfinite(recording.wrench).all()
    assert tool_extent_text(tw.fit(tw.spatial(rig), recording)) == ""
