"""Only this machine's browser, at the address with the token, is answered; whoever else asks is refused."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from http.client import HTTPConnection
from threading import Event, Thread
from urllib.parse import urlsplit

import pytest

from truewrench.workbench.page import Start
from truewrench.workbench.server import MOST_PAGES, WorkbenchServer


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


def answer(address: str, path: str = "", method: str = "GET", **headers: str) -> tuple[int, str]:
    """Status and text of a request to a path below the address, its headers with `_` for `-`."""
    parts = urlsplit(address)
    connection = HTTPConnection(str(parts.hostname), parts.port, timeout=30)
    connection.putrequest(method, parts.path + path if not path.startswith("/") else path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    response = connection.getresponse()
    found = response.status, response.read().decode(errors="replace")
    connection.close()
    return found


def test_the_address_listens_on_this_machine_alone_and_holds_a_token(address: str) -> None:
    assert address.startswith("http://127.0.0.1:")
    assert len(urlsplit(address).path.strip("/")) >= 32
    status, text = answer(address)
    assert status == 200
    assert "truewrench workbench" in text


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1.evil.example:80"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1"},
        {"Sec_Fetch_Site": "cross-site"},
    ],
    ids=str,
)
@pytest.mark.parametrize("path", ["", "ws", "upload", "static/js/bokeh.min.js"])
def test_a_foreign_host_or_origin_is_refused(address: str, path: str, headers: dict[str, str]) -> None:
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade"} if path == "ws" else {}
    status, text = answer(address, path, **upgrade, **headers)
    assert status == 403
    assert text.count("\n") == 1


@pytest.mark.parametrize(
    "path", ["/", "/wrong-token/", "/ws", "/static/js/bokeh.min.js", "/autoload.js", "//", "/%2e%2e/"]
)
def test_without_the_token_nothing_is_there(address: str, path: str) -> None:
    assert answer(address, path)[0] == 403


@pytest.mark.parametrize(
    "path",
    [
        "static/../../../../../../etc/passwd",
        "static/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "static/js/..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
        "static//etc/passwd",
        "upload/../../etc/passwd",
        "..;/etc/passwd",
    ],
)
def test_no_path_leads_to_a_file_of_the_machine(address: str, path: str) -> None:
    status, text = answer(address, path)
    assert status in (400, 403, 404)
    assert "root:" not in text


def test_a_link_of_another_page_may_open_the_address(address: str) -> None:
    assert answer(address, Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate")[0] == 200
    assert answer(address, "upload", "POST", Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate")[0] == 403


def test_an_upload_without_a_page_is_refused(address: str) -> None:
    assert answer(address, "upload", "POST", X_Page="none", Content_Length="10")[0] == 403


def test_a_hundred_tabs_are_bounded_and_harmless(address: str) -> None:
    statuses = [answer(address)[0] for _ in range(100)]
    assert statuses.count(200) <= MOST_PAGES
    assert set(statuses) <= {200, 503}
    assert "close one" in answer(address)[1]
    assert answer(address, "static/js/bokeh.min.js")[0] == 200
