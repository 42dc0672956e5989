"""The workbench inside a notebook: the page of a study, served by a thread of the kernel, which has the study too."""

from __future__ import annotations

import asyncio
from html import escape
from queue import SimpleQueue
from threading import Thread
from weakref import finalize

from diagnosis.study import Study
from modeling.errors import InputError
from truewrench.workbench.page import Start
from truewrench.workbench.server import WorkbenchServer

ENDS_WITHIN = 5.0
"""Seconds that are waited for the pages of a server to end; an interpreter that ends does not wait for more."""


class ShownStudy:
    """A study in the page of the workbench: a notebook shows it in a frame.

    Parameters
    ----------
    study : Study
        What the page shows, and changes.
    height : int
        Of the frame, CSS pixels.

    Notes
    -----
    `address` is what a browser on this machine opens. The page is there until `close`, or until nothing refers to this
    any more; a notebook keeps what a cell returned.
    """

    def __init__(self, study: Study, height: int) -> None:
        if not (isinstance(height, int) and height > 0):
            raise InputError(what=f"{height!r} is no number of pixels", where="height", remedy="give such as 800")
        self.height = height
        begun: SimpleQueue[WorkbenchServer | BaseException] = SimpleQueue()
        thread = Thread(target=_serve, args=(Start(study=study), begun), daemon=True)
        thread.start()
        server = begun.get()
        if isinstance(server, BaseException):
            raise server
        self.address = server.address
        self.close = finalize(self, _end, server, thread)

    def __repr__(self) -> str:
        return f"Workbench: {self.address}" if self.close.alive else "Workbench: closed"

    def _repr_html_(self) -> str:
        if not self.close.alive:
            return "<p>The page is closed: show() opens another.</p>"
        style = f"width: 100%; height: {self.height}px; border: 1px solid #d3d9e1"
        return f'<iframe src="{escape(self.address)}" title="truewrench workbench" style="{style}"></iframe>'


def _serve(start: Start, begun: SimpleQueue[WorkbenchServer | BaseException]) -> None:
    """Serve until stopped, by an event loop of this thread: the kernel has its own."""
    asyncio.set_event_loop(loop := asyncio.new_event_loop())
    try:
        server = WorkbenchServer(start)
    except BaseException as error:  # whoever waits for the server raises it
        begun.put(error)
    else:
        begun.put(server)
        server.run(prepared=True)
    loop.close()


def _end(server: WorkbenchServer, thread: Thread) -> None:
    server.stop()
    thread.join(ENDS_WITHIN)
