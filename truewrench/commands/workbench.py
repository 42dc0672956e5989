"""`truewrench workbench`: the loop by hand, in a web page on this machine."""

from __future__ import annotations

import argparse
import signal
import webbrowser

from truewrench.workbench.page import Start
from truewrench.workbench.server import WorkbenchServer, readable


def run(arguments: argparse.Namespace) -> None:
    """Serve the page until interrupted."""
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
