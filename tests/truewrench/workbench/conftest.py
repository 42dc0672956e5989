"""A workbench in this process, for tests that ask for its address."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from threading import Event, Thread

import pytest

from truewrench.workbench.page import Start
from truewrench.workbench.server import WorkbenchServer


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A server in a thread of this process; no page is opened by a browser, so no process of a study starts."""
    begun, found = Event(), list[WorkbenchServer]()

    def serve() -> None:
        asyncio.set_event_loop(loop := asyncio.new_event_loop())
        server = WorkbenchServer(Start())
        found.append(server)
        begun.set()
        server.run(prepared=True)
        loop.close()

    thread = Thread(target=serve)
    thread.start()
    assert begun.wait(30)
    yield found[0].address
    found[0].stop()
    thread.join(30)
    assert not thread.is_alive()
