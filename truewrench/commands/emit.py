"""`truewrench emit`: a model as code, its tool as robots take it, or the sensor's calibration as drivers take it."""

from __future__ import annotations

import argparse
import sys

from estimation.monitor import Monitor
from estimation.reading.log_reading import read_with_rig
from truewrench.emitted import emitted, require_monitored
from truewrench.files.model_file import ModelFile
from truewrench.files.output import atomic_write, say


def run(arguments: argparse.Namespace) -> None:
    """Write the text, print what is said of it, with its numbers (on standard error if the text is on the other)."""
    monitor = None
    if arguments.monitor is not None:
        require_monitored(arguments.model, arguments.to)
        saved = ModelFile.read(arguments.model)
        monitor = Monitor(saved, read_with_rig(arguments.monitor, rig=saved.rig, every_row=True))
    result = emitted(
        arguments.model,
        arguments.to,
        rate=arguments.rate,
        sensor_pose=arguments.sensor_pose,
        monitor=monitor,
        sheet=arguments.sheet,
    )
    text = result.text if result.text.endswith("\n") else result.text + "\n"
    if result.warning:
        say(f"warning: {result.warning}")
    said = "\n\n".join(str(paragraph) for paragraph in (result.operations, result.beside, result.frames) if paragraph)
    if arguments.out is None:
        sys.stdout.write(text)
        if said:
            say(said)
        return
    with atomic_write(arguments.out) as path:
        path.write_text(text, encoding="utf-8", newline="\n")
    print("\n\n".join(filter(None, [said, f"Written: {arguments.out}"])))
