"""`truewrench emit`: a model as code, or its tool as robot descriptions and controllers take it."""

from __future__ import annotations

import argparse
import sys

from truewrench.emitted import emitted
from truewrench.files.output import atomic_write, say


def run(arguments: argparse.Namespace) -> None:
    """Write the text, print frame, convention and operation counts (on standard error if the text is on the other)."""
    result = emitted(arguments.model, arguments.to, rate=arguments.rate, sensor_pose=arguments.sensor_pose)
    text = result.text if result.text.endswith("\n") else result.text + "\n"
    if result.warning:
        say(f"warning: {result.warning}")
    said = "\n\n".join(str(paragraph) for paragraph in (result.operations, result.frames) if paragraph)
    if arguments.out is None:
        sys.stdout.write(text)
        if said:
            say(said)
        return
    with atomic_write(arguments.out) as path:
        path.write_text(text, encoding="utf-8", newline="\n")
    print("\n\n".join(filter(None, [said, f"Written: {arguments.out}"])))
