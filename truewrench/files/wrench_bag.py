"""Contact wrench as an MCAP file of ROS 2 messages, which PlotJuggler, Foxglove and ROS 2 read."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from estimation.contact.contact_wrench import ContactWrench
from modeling.errors import InputError
from modeling.space import Space
from truewrench.effect_description.effect_size import change_of_readings

Array = NDArray[np.float64]

WRENCH = "geometry_msgs/msg/WrenchStamped"
BAG_VERSION: Final = 9
"""Of rosbag2's format: that of ROS 2 Jazzy and later; the messages themselves are the same in all."""
LAST_STAMP = 2**31
"""s: seconds of a stamp are 32 bits."""


def write_wrench_bag(contact: ContactWrench, path: Path) -> None:
    """Write the series of `wrench_topics` as one message a sample and topic, stamped with the recording's time.

    In the plane (fx, fy, tau) are force.x, force.y and torque.z of the message. Raises InputError for stamps that are
    no time of ROS.
    """
    recording = contact.recording
    time = np.arange(recording.samples, dtype=float) if recording.time is None else recording.time
    if time[0] < 0 or time[-1] >= LAST_STAMP:
        what = f"time from {time[0]:g} to {time[-1]:g} s is no stamp of ROS 2"
        raise InputError(what=what, where=recording.name, remedy="give seconds from 0, or since 1970")
    stamps = np.rint(time * 1e9).astype(np.int64)
    rig, store = recording.rig, get_typestore(Stores.ROS2_HUMBLE)
    frame = (rig.sensor_frame if rig is not None else None) or "sensor"
    places = [0, 1, 5] if contact.space is Space.PLANE else [*range(6)]
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with Writer(bag, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic, series in wrench_topics(contact).items():
                connection = writer.add_connection(topic, WRENCH, typestore=store)
                full = np.zeros((len(series), 6))
                full[:, places] = series
                for stamp, row in zip(stamps.tolist(), full.tolist(), strict=True):
                    message = _stamped(store.types, frame, stamp, row)
                    writer.write(connection, stamp, store.serialize_cdr(message, WRENCH))
        shutil.move(bag / "bag.mcap", path)


def _stamped(types: Mapping[str, type], frame: str, stamp: int, row: list[float]) -> object:
    vector = types["geometry_msgs/msg/Vector3"]
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    wrench = types["geometry_msgs/msg/Wrench"](force=vector(*row[:3]), torque=vector(*row[3:]))
    return types[WRENCH](header=types["std_msgs/msg/Header"](stamp=time, frame_id=frame), wrench=wrench)


def wrench_topics(contact: ContactWrench) -> dict[str, Array]:
    """Series (n, p) by topic, N and N m: readings, their prediction, contact with its std, and each effect's part.

    `measured`, `predicted` and the effects are readings, in their own sign and axes; the prediction has the zero of
    this recording. `contact` is the wrench of the environment on the tool along the axes that were asked for. What an
    effect contributes is the prediction less that without it, at the same values of all other parameters; those that
    only a budget has, at a nominal value, contribute nothing and have no topic.
    """
    fitted, recording = contact.calibration.without_recording_specific, contact.recording
    values = {p.name: float(value) for p, value in zip(fitted.model.parameters, fitted.theta, strict=True)}
    return {
        "/truewrench/measured": recording.wrench,
        "/truewrench/predicted": contact.predicted,
        "/truewrench/contact": contact.wrench,
        "/truewrench/contact_std": contact.std,
    } | {
        f"/truewrench/effects/{effect.id}": change_of_readings(fitted.model, effect.id, values, recording)
        for effect in fitted.model.effects
        if any(values[p.name] != p.nominal for p in effect.qualified(fitted.model.space)) or not contact.contributions
    }
