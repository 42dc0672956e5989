"""Wrench of the sensor on the tool (MuJoCo inverse dynamics)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truewrench.simulated_rig.commanded_motion import CommandedMotion
from truewrench.simulated_rig.flexible_tip import TipFlexibility
from truewrench.simulated_rig.hidden_effect import HiddenEffect, SceneChange, ToolLoad
from truewrench.simulated_rig.joint_deflections import JointDeflection
from truewrench.simulated_rig.mujoco_scene import Array, Scene, States, Track, mujoco_rows
from truewrench.simulated_rig.rigs import SimulatedRig


def true_wrench(rig: SimulatedRig, hidden: Sequence[HiddenEffect], drive: CommandedMotion) -> Array:
    """True wrench (N, p) of a rig in the sign convention of its readings, with the given hidden effects."""
    scene = rig.scene
    for effect in hidden:
        if isinstance(effect, SceneChange):
            scene = effect.changed(scene)
    states = drive.states
    for deflection in sorted((e for e in hidden if isinstance(e, JointDeflection)), key=lambda e: e.order):
        states = deflection.moved(scene, drive, states)
    loads = [effect for effect in hidden if isinstance(effect, ToolLoad)]
    tip = next((effect for effect in hidden if isinstance(effect, TipFlexibility)), None)
    if tip is None:
        wrench = rigid_tool_wrench(scene, loads, drive.time, states)
    else:
        wrench = _flexible_tip_wrench(tip, scene, loads, drive, states)
    return rig.sign * wrench[:, rig.rows]


def _flexible_tip_wrench(
    tip: TipFlexibility, rigid: Scene, loads: Sequence[ToolLoad], drive: CommandedMotion, states: States
) -> Array:
    """Wrench (N, 6) on a tool with a flexible tip for these states of the robot."""
    scene = tip.changed(rigid)

    def sensor_wrench(whole: States) -> Array:
        return rigid_tool_wrench(scene, loads, drive.time, whole)

    return sensor_wrench(tip.settled(scene, drive, states, sensor_wrench))


def rigid_tool_wrench(scene: Scene, loads: Sequence[ToolLoad], time: Array, states: States) -> Array:
    """The wrench (N, 6) that the sensor exerts on the tool, in the sensor's true axes, under the given loads.

    The first run gives the states of the points of application, the second the wrench with the loads. MuJoCo
    applies an external wrench at the body's centre of mass.
    """
    points = [load.point(scene) for load in loads]
    actual = (states[0] + scene.joint_offsets, states[1], states[2])
    rows = mujoco_rows(scene, points, actual, None)
    if not loads:
        return rows[:, :6]
    pushes = np.zeros((len(time), 6))
    for place, load in enumerate(loads):
        track = Track.of(rows, time, place)
        force, torque = load.push(track)
        pushes[:, :3] += force
        pushes[:, 3:] += torque + np.cross(track.point - track.centre, force)
    return mujoco_rows(scene, points, actual, pushes)[:, :6]
