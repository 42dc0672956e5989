"""Gravity's direction in a model and its recordings: as the rig states it, or decided where the base does not stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.gravity.gravity_estimate import GravityEstimate
from estimation.gravity.gravity_evidence import gravity_evidence
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.effects.gravity_load import GravityTilt
from modeling.kinematics.base_mounting import Direction, in_base_axes, unit_direction
from modeling.rig.rig import Rig


@dataclass(frozen=True, eq=False)
class MountedCase:
    """A model and its recordings on one base; `found` is its direction of gravity where the data decided it, and
    `doubted` one that they suggest, and that is not applied."""

    model: WrenchModel
    recordings: tuple[Recording, ...]
    found: GravityEstimate | None = None
    doubted: GravityEstimate | None = None


def with_gravity_direction(model: WrenchModel, recordings: Sequence[Recording]) -> MountedCase:
    """The model and recordings with gravity along the direction that the rig states, or else that the data show.

    Where neither the model nor a recording's rig states it, the evidence of all readings of the frames is weighed. A
    base that clearly does not stand upright is mounted as estimated: along the nearest axis where that is within 15
    degrees; else as estimated, and the two angles of `gravity_tilt` are fitted beside the tool. Where a cable on the
    tool explains the readings as well, gravity stays down.
    """
    several, stated = tuple(recordings), stated_direction(model, recordings)
    if stated is not None:
        return MountedCase(_mounted(model, stated), mounted_recordings(several, stated))
    found = gravity_evidence(several, gravity=model.gravity, convention=model.convention, mirror_y=model.mirror_y)
    if found is None or found.cable is not None:
        return MountedCase(model, several, doubted=found)
    mounted = _mounted(model, found.direction)
    if not found.along_axis and all(effect.id != GravityTilt.id for effect in mounted.effects):
        mounted = mounted + GravityTilt()
    return MountedCase(mounted, mounted_recordings(several, found.direction), found)


def with_fitted_tilt(found: GravityEstimate, model: WrenchModel, estimates: Mapping[str, float]) -> GravityEstimate:
    """The estimate turned by the `gravity_tilt` that a fit of the model, on that base, found beside the tool.

    The first estimate knows nothing of the other effects of the model; `estimates` are its parameters by name.
    """
    tilt = next((effect for effect in model.effects if effect.id == GravityTilt.id), None)
    if tilt is None:
        return found
    parameters = tilt.qualified(model.space)
    own = {p.name.removeprefix(f"{tilt.id}."): estimates[p.name] for p in parameters}
    turned = tilt.perturb(replace(model, effects=()).chain, own).gravity
    components = [float(part) for part in turned][: model.space.value]
    direction = in_base_axes(unit_direction(components), found.direction)
    return replace(found, direction=direction, mounted=found.direction)


def stated_direction(model: WrenchModel, recordings: Sequence[Recording]) -> Direction | None:
    """The direction that the model has, else the first that a recording's rig states."""
    if model.gravity_direction is not None:
        return model.gravity_direction
    rigs = (recording.rig for recording in recordings)
    return next((rig.gravity_direction for rig in rigs if rig is not None and rig.gravity_direction is not None), None)


def mounted_recordings(recordings: Sequence[Recording], direction: Direction | None) -> tuple[Recording, ...]:
    """The recordings on a base with this direction of gravity, those excepted whose rig states one."""
    return tuple(mounted_recording(recording, direction) for recording in recordings)


def mounted_recording(recording: Recording, direction: Direction | None) -> Recording:
    """The recording on a base with this direction of gravity, unless its rig states one."""
    rig = recording.rig or Rig()
    if direction is None or rig.gravity_direction is not None or len(direction) != recording.dimension:
        return recording
    mounted = replace(recording, rig=replace(rig, gravity_direction=direction))
    vars(mounted).update(derivatives=recording.derivatives)  # of the columns, whatever the base stands on
    return mounted


def _mounted(model: WrenchModel, direction: Direction) -> WrenchModel:
    """The model with this direction, its arm on the turned base."""
    if model.gravity_direction is not None or len(direction) != model.space.value:
        return model
    arm = None if model.arm is None else model.arm.mounted(direction)
    return replace(model, gravity_direction=direction, arm=None).with_arm(arm)
