"""`truewrench workbench`: the loop by hand, in a web page on this machine."""

from __future__ import annotations

import argparse
from typing import Any

from truewrench.options import Subcommands, add_repeatable


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Open a page of this machine's browser: read a recording, see where the model fails, add and drop effects, "
        "diagnose, and take away report, model and code. Only this machine can reach it."
    )
    command = commands.add_parser("workbench", help="the loop by hand, in a web page", description=text)
    command.add_argument("recordings", nargs="*", metavar="REC", help="recording or log to begin with")
    add_repeatable(command, "--validate", metavar="REC2", text="recording of another motion, never fitted")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML), required for joint angles")
    command.add_argument("--port", type=port, default=0, metavar="N", help="port (default: any that is free)")
    command.add_argument("--no-browser", action="store_true", help="print the address, and open nothing")
    command.set_defaults(run=run)


def port(text: str) -> int:
    """A port from 0 to 65535; argparse reports a ValueError in one line."""
    value = int(text)
    if not 0 <= value <= 65535:
        raise ValueError(text)
    return value


def run(arguments: argparse.Namespace) -> None:
    """Serve the page until interrupted."""
    import signal
    import webbrowser

    from truewrench.workbench.page import Start
    from truewrench.workbench.server import WorkbenchServer, readable

    given = (*arguments.recordings, *arguments.validate, *filter(None, (arguments.rig,)))
    readable(given)
    start = Start(tuple(arguments.recordings), tuple(arguments.validate), arguments.rig)
    server = WorkbenchServer(start, arguments.port)
    print(f"Workbench: {server.address}\nInterrupt (Ctrl-C) ends it.", flush=True)
    if not arguments.no_browser:
        webbrowser.open(server.address)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the files of the pages go then, too
    try:
        server.run()
    except KeyboardInterrupt:
        print("\nEnded.")
