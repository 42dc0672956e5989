"""`truewrench compensate`: contact wrench of a recording, its readings less the load of a fitted tool."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.contact.contact_wrench import ContactWrench, compensate
from estimation.reading.log_reading import read_with_rig
from estimation.recordings.recording import Recording
from modeling.chain.sensor_axes import Axes, sensor_to_pose
from modeling.errors import InputError
from modeling.number_format import finite, probability_text
from modeling.space import Space
from truewrench.commands.results import print_result
from truewrench.files.model_file import ModelFile
from truewrench.files.output import atomic_write, progress_line, say

if TYPE_CHECKING:
    import pandas as pd

COUNTED = "what it lacks is in the contact wrench, or hides contacts"
"""What follows for the contact wrench from a model that does not fit."""
EXCESSIVE_NOISE_RATIO = 3.0
"""Noise relative to that of the fitted recording above which the text warns: no sensor varies that much by itself."""


def result_files(arguments: argparse.Namespace) -> list[Path]:
    """The files that are asked for."""
    return [path for path in (arguments.out, arguments.mcap) if path is not None]


def run(arguments: argparse.Namespace) -> None:
    """Compute the contact wrench, write and print it."""
    saved = ModelFile.read(arguments.model)
    for warning in filter(None, (saved.misfit_warning(COUNTED), saved.mending_warning)):
        say(f"warning: {warning}")
    if arguments.with_budget and saved.budget is None:
        remedy = "write it with `truewrench fit --budget FILE --out`"
        raise InputError(what="the model file has no budget", where=arguments.model, remedy=remedy)
    if arguments.with_budget and saved.alternatives and not arguments.without_alternatives:
        say(f"warning: {saved.doubt_warning}")
    if arguments.lerobot is not None:
        compensate_data_set(arguments, saved)
        return
    recording = read_with_rig(arguments.recording, rig=saved.rig, every_row=True)
    with progress_line() as progress:
        progress("compensate")
        contact = compensated(arguments, saved, recording)
    of_contact = saved.budget.of_contact(contact) if saved.budget is not None and arguments.with_budget else None
    print_result(
        arguments,
        lambda: contact_text(contact) + ("" if of_contact is None else f"\n\nBudget:\n{of_contact}"),
        lambda: contact_data(contact) | ({} if of_contact is None else {"budget": of_contact.to_data()}),
        lambda: written(arguments, contact),
    )


def compensated(arguments: argparse.Namespace, saved: ModelFile, recording: Recording) -> ContactWrench:
    """The contact wrench of a recording, as the options ask for; its std with the budget's, where that is asked for."""
    budget = saved.budget if arguments.with_budget else None
    return compensate(
        saved.calibration if budget is None else budget.calibration,
        recording,
        keep_zero=arguments.keep_zero,
        tip_length=arguments.tip_length,
        false_alarms=arguments.false_alarms,
        axes=arguments.axes,
        lag=arguments.lag,
        alternatives=not arguments.without_alternatives,
    )


def written(arguments: argparse.Namespace, contact: ContactWrench) -> list[Path]:
    """Write the files of one recording; return them. The bag comes first: its library may be missing."""
    if arguments.mcap is not None:
        from truewrench.files.wrench_bag import write_wrench_bag  # with the library of bags

        with atomic_write(arguments.mcap) as path:
            write_wrench_bag(contact, path)
    if arguments.out is not None:
        with atomic_write(arguments.out) as path:
            contact_table(contact).to_csv(path, index=False, float_format="%.9g")
    return result_files(arguments)


def compensate_data_set(arguments: argparse.Namespace, saved: ModelFile) -> None:
    """Compute the contact wrenches of one episode, or of all of a data set, and write them as its features.

    An episode of many that cannot be compensated is named, and left without. Raises InputError where none can, and for
    files of a single recording where several are asked for.
    """
    from truewrench.files.lerobot_data_set import episodes_asked_for, read_episode, require_place, write_features

    require_place(arguments.lerobot, arguments.recording)
    episodes = episodes_asked_for(arguments.recording)
    if len(episodes) > 1 and result_files(arguments):
        remedy = f"give one episode, such as {episodes[0]}"
        raise InputError(what="--out and --mcap are of one recording", where=arguments.recording, remedy=remedy)
    contacts: dict[Path, ContactWrench] = {}
    with progress_line() as progress:
        for number, episode in enumerate(episodes, 1):
            progress(f"compensate {number} of {len(episodes)}")
            try:
                contacts[episode] = compensated(arguments, saved, read_episode(episode, saved.rig))
            except InputError as error:
                if len(episodes) == 1:
                    raise
                say(f"warning: left without a contact wrench: {error}")
    if not contacts:
        remedy = f"see what is said of one: `truewrench compensate {arguments.model} {episodes[0]}`"
        raise InputError(what="no episode can be compensated", where=arguments.recording, remedy=remedy)
    without: list[int] = []

    def all_written() -> list[Path]:
        without.append(write_features(contacts, arguments.lerobot))  # first: it refuses a data set that is damaged
        files = written(arguments, next(iter(contacts.values()))) if len(contacts) == 1 else []
        return [*files, arguments.lerobot]

    def text() -> str:
        parts = [f"{contact.recording.name}:\n{contact_text(contact)}" for contact in contacts.values()]
        if any(without):
            parts.append(f"Episodes of {arguments.lerobot} without a contact wrench, NaN there: {without[0]}.")
        return "\n\n".join(parts)

    def data() -> dict[str, Any]:
        return {"episodes": [contact_data(contact) for contact in contacts.values()]}

    print_result(arguments, text, data, all_written)


def contact_table(contact: ContactWrench) -> pd.DataFrame:
    """Columns of CONTACT.csv, one row per sample; a direction only where the magnitude is twice its std.

    Magnitude and direction are those of the force at the tip in the plane; in six axes the magnitude is |F|.
    """
    import pandas as pd

    recording = contact.recording
    taken = recording.motion.recorded.instants if recording.time is None else recording.time
    time = np.arange(recording.samples, dtype=float) if taken is None else taken
    columns = {"time": time} | dict(zip(contact.names, contact.wrench.T, strict=True))
    columns["magnitude"] = contact.magnitude
    if contact.space is Space.PLANE:
        force = contact.point_force
        columns["direction"] = np.where(force.clear, force.direction, np.nan)
        columns["magnitude_std"] = contact.magnitude_std
        columns["direction_std"] = np.where(force.clear, force.direction_std, np.nan)
    else:
        columns["magnitude_std"] = contact.magnitude_std
    return pd.DataFrame(columns)


def contact_data(contact: ContactWrench) -> dict[str, Any]:
    """Zero shift, noise and contacts as plain numbers, N, N m and s; None for what there is not."""
    channels, detection = contact.calibration.model.channels, contact.detection
    data: dict[str, Any] = {
        "recording": contact.recording.name,
        "samples": contact.recording.samples,
        **({"loads": [load.to_data() for load in contact.recording.loads]} if contact.recording.loads else {}),
        "components": list(contact.names),
        "axes": contact.axes.value,
        "sensor_to_pose": sensor_to_pose(contact.calibration.model, contact.calibration.theta).tolist(),
        "zero_shift": _by_name(channels, contact.zero_shift),
        "zero_shift_std": _by_name(channels, np.sqrt(np.diag(detection.zero_covariance))),
        "noise": _by_name(contact.names, contact.noise_std),
        "free": float(detection.free.mean()),
        "false_alarms": detection.false_alarms,
        "late": contact.group_delay,
        "lag": contact.lag,
        "inertial": list(contact.inertial),
        "unknown": dict(contact.unknown),
        "contacts": [
            {
                "start": contact.time_of(m.interval.first),
                "end": contact.time_of(m.interval.last),
                "wrench": _by_name(contact.names, m.wrench),
                "wrench_std": _by_name(contact.names, m.std),
                "force": m.force,
                "largest_force": m.largest_force,
                "tip_force": m.tip_force,
                "tip_force_p_value": m.tip_p_value,
                "p_value": m.interval.p_value,
            }
            for m in contact.means
        ],
    }
    if contact.between is not None:
        others = contact.calibration.alternatives
        data["alternatives"] = [{"name": other.name, "weight": other.weight} for other in others]
        data["between"] = _by_name(contact.names, contact.between_rms)
    return dict(finite(data))


def _by_name(names: tuple[str, ...], values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def contact_text(contact: ContactWrench) -> str:
    """Detected contacts, zero shift and noise, as text with a table."""
    detection, space = contact.detection, contact.space
    count = len(contact.intervals)
    head = (
        f"No contact detected beyond noise and known model error (false-alarm probability {detection.false_alarms:g})."
    )
    if count:
        head = f"{count} contact{'s' * (count > 1)} (false-alarm probability {detection.false_alarms:g}):\n{contact}"
    shifts = zip(contact.calibration.model.channels, contact.zero_shift, space.units, strict=True)
    std = np.sqrt(np.diag(detection.zero_covariance))
    shift = ", ".join(f"{c} {v:.3g} ± {s:.2g} {u}" for (c, v, u), s in zip(shifts, std, strict=True))
    size = zip(contact.names, contact.noise_std, space.units, strict=True)
    name, dwells, tool = contact.recording.name, contact.recording.dwells, contact.recording.tool
    lines = [
        head,
        *([] if dwells is None else [f"{name} is read as {dwells.counted}: a row and its time are a pose."]),
        *([contact.recording.carried] if contact.recording.loads else []),
        *([f"What {tool} weighs is in the contact wrench, unless the model is of the tool with it."] if tool else []),
        f"Zero shift relative to the fitted recording, in sensor axes: {shift}."
        if std.any()
        else "Zero: that of the fitted recording.",
        f"Noise of one sample, in {contact.axes.words(space)}: "
        + ", ".join(f"{n} {v:.2g} {u}" for n, v, u in size)
        + ".",
    ]
    if contact.unsmoothed is not None:
        single = ", ".join(f"{n} {v:.2g}" for n, v in zip(contact.names, contact.unsmoothed.noise_std, strict=True))
        lines.append(
            f"Smoothed: a row takes readings until {contact.lag * 1e3:.3g} ms later; one by itself has the noise"
            f" {single}."
            + " So near the beginning and end of a contact it is between both, which no std covers."
            * bool(count)
        )
    if contact.between is not None:
        others = ", ".join(
            f"{other.name} {probability_text(other.weight)}" for other in contact.calibration.alternatives
        )
        between = zip(contact.names, contact.between_rms, space.units, strict=True)
        lines.append(
            f"Mean over models that the diagnosis could not tell apart (probability of the others: {others}); they"
            f" differ by a std of {', '.join(f'{n} {v:.2g} {u}' for n, v, u in between)}, which every std has in it."
            " --without-alternatives takes the one chosen."
        )
    if contact.inertial:
        lines.append(f"Accelerations of the inertial unit enter {', '.join(contact.inertial)}.")
    if std.any():
        lines.append(
            "A contact during most of the recording would be absorbed by the zero; --keep-zero uses the model's."
        )
    if contact.is_turned and contact.axes is Axes.SENSOR:
        lines.append("--axes pose gives the wrench in the axes of the logged pose, such as a flange's.")
    ratio = contact.noise_ratio
    if ratio.max() > EXCESSIVE_NOISE_RATIO:
        lines.append(
            f"{contact.names[int(ratio.argmax())]} is {ratio.max():.0f} times as noisy as in the fitted recording:"
            " physics is missing from the model, or it was fitted to averages; smaller contacts are not detectable."
        )
    if contact.group_delay:
        lines.append(f"The sensor delays a contact by {contact.group_delay * 1e3:.3g} ms; this is not compensated.")
    if contact.unknown:
        lines.append(f"Not identifiable in the fit, kept at the value of the model: {', '.join(contact.unknown)}.")
    return "\n\n".join([lines[0], "\n".join(lines[1:])])
