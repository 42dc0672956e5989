"""`truewrench emit`: a model as code, or its tool as robot descriptions and controllers take it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from modeling.codegen.code_target import target_names
from modeling.codegen.payload_format import FORMATS
from truewrench.options import Subcommands, finite, positive


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Generate code (numpy, casadi, c, latex): the regressor of a base model, or prediction and contact wrench of a"
        " fitted model, sample by sample; the operation counts are printed. Or write the identified tool as robots take"
        " it: an <inertial> of URDF, SDF or MJCF, set_payload of Universal Robots, setLoad of Franka, parameters of a"
        " ROS 2 node."
    )
    command = commands.add_parser("emit", help="write a model as code, or its tool for a robot", description=text)
    what = "model file of `fit --out` or `diagnose --out`, or a base model: planar, spatial"
    command.add_argument("model", metavar="MODEL.json|planar|spatial", help=what)
    command.add_argument("--to", required=True, choices=(*target_names(), *FORMATS), help="language or format")
    text = "sampling rate of the code; needed for a model with lag, delay, hysteresis or a flexible tip"
    command.add_argument("--rate", type=positive, metavar="HZ", help=text)
    text = "pose of the sensor frame in the robot's frame, e.g. the flange: m, and rad about fixed axes, as in URDF"
    pose = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")
    command.add_argument("--sensor-pose", type=finite, nargs=6, metavar=pose, help=text)
    command.add_argument("--out", type=Path, metavar="FILE", help="file to write (default: standard output)")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write the text, print frame, convention and operation counts (on standard error if the text is on the other)."""
    from truewrench.emitted import emitted
    from truewrench.files.output import atomic_write, say

    found = emitted(arguments.model, arguments.to, rate=arguments.rate, sensor_pose=arguments.sensor_pose)
    text = found.text if found.text.endswith("\n") else found.text + "\n"
    if found.warning:
        say(f"warning: {found.warning}")
    said = "\n\n".join(str(part) for part in (found.operations, found.frames) if part)
    if arguments.out is None:
        sys.stdout.write(text)
        if said:
            say(said)
        return
    with atomic_write(arguments.out) as path:
        path.write_text(text, encoding="utf-8", newline="\n")
    print("\n\n".join(filter(None, [said, f"Written: {arguments.out}"])))
