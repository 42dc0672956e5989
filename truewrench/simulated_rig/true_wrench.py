"""The true wrench: what the sensor exerts on the tool, by MuJoCo, with everything hidden between drive and sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truewrench.simulated_rig.drive import Drive
from truewrench.simulated_rig.flexible_tip import TipFlexibility
from truewrench.simulated_rig.hidden import HiddenEffect, SceneChange, ToolLoad
from truewrench.simulated_rig.joint_shifts import JointShift
from truewrench.simulated_rig.rigs import Rig
from truewrench.simulated_rig.scene import Array, Scene, States, Track, mujoco_rows


def true_wrench(rig: Rig, hidden: Sequence[HiddenEffect], drive: Drive) -> Array:
    """The true wrench (N, p) on a rig in the signs of its readings, under all the effects given."""
    scene = rig.scene
    for effect in hidden:
        if isinstance(effect, SceneChange):
            scene = effect.changed(scene)
    states = drive.states
    for shift in sorted((e for e in hidden if isinstance(e, JointShift)), key=lambda e: e.order):
        states = shift.moved(scene, drive, states)
    loads = [effect for effect in hidden if isinstance(effect, ToolLoad)]
    tip = next((effect for effect in hidden if isinstance(effect, TipFlexibility)), None)
    if tip is None:
        wrench = felt_wrench(scene, loads, drive.time, states)
    else:
        wrench = _swinging(tip, scene, loads, drive, states)
    return rig.sign * wrench[:, rig.rows]


def _swinging(tip: TipFlexibility, rigid: Scene, loads: Sequence[ToolLoad], drive: Drive, states: States) -> Array:
    """The wrench (N, 6) of a robot in these states on a tool that swings."""
    scene = tip.changed(rigid)

    def felt(whole: States) -> Array:
        return felt_wrench(scene, loads, drive.time, whole)

    return felt(tip.settled(scene, drive, states, felt))


def felt_wrench(scene: Scene, loads: Sequence[ToolLoad], time: Array, states: States) -> Array:
    """The wrench (N, 6) that the sensor exerts on the tool, in the sensor's true axes, under the given loads.

    The first run gives the state of each attacked point, the second one feels the loads. MuJoCo wants an
    external wrench at the body's centre of mass.
    """
    points = [load.d for load in loads]
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
