"""Only this machine's browser, at the address with the token, is answered; whoever else asks is refused."""

from __future__ import annotations

import gzip
import logging
import re
import socket
from pathlib import Path
from tempfile import gettempdir
from time import monotonic, sleep
from urllib.parse import urlsplit

import pytest

from modeling.errors import InputError
from tests.shared.results import RESULTS
from tests.truewrench.workbench.requests import answer, answered
from truewrench.workbench.server import MOST_PAGES


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


@pytest.mark.parametrize("path", ["static/js/%00", "static/%00.js", "%00"])
def test_a_null_character_is_a_bad_request(address: str, path: str) -> None:
    status, text = answer(address, path)
    assert (status, text.count("\n")) == (400, 1)


@pytest.mark.parametrize("path", ["", "static/js/bokeh.min.js", "static/none.js", "/wrong-token/", "static/js/%00"])
def test_every_answer_refuses_frames_and_referrers(address: str, path: str) -> None:
    response, _ = answered(address, path)
    assert response.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert response.headers["Referrer-Policy"] == "no-referrer"


def test_only_notebooks_of_this_machine_show_a_study_in_a_frame() -> None:
    """Guarded as any page; when it is closed, nobody answers."""
    study = RESULTS["study"]()
    for height in (0, -5, "tall"):
        with pytest.raises(InputError, match="is no number of pixels"):
            study.show(height)
    shown = study.show(500)
    response, text = answered(shown.address)
    frames = response.headers["Content-Security-Policy"].split()
    assert (response.status, frames[0]) == (200, "frame-ancestors")
    assert {urlsplit(allowed).hostname for allowed in frames[1:]} == {"localhost", "127.0.0.1", None}
    assert frames[-1] == "vscode-webview:"
    assert '<details id="chooser" hidden>' in text
    assert answer(shown.address, "/")[0] == 403
    assert f'<iframe src="{shown.address}"' in shown._repr_html_()
    assert "height: 500px" in shown._repr_html_()
    assert shown.address in repr(shown)
    shown.close()
    assert "<iframe" not in shown._repr_html_()
    assert shown.address not in repr(shown)
    with pytest.raises(ConnectionRefusedError):
        answer(shown.address)


def test_no_log_holds_the_token(address: str, caplog: pytest.LogCaptureFixture) -> None:
    """The log of requests itself is listened to: Dask, where it was imported, keeps its lines from other logs."""
    log = logging.getLogger("tornado.access")
    log.addHandler(caplog.handler)
    try:
        with caplog.at_level("DEBUG", logger=log.name):
            assert answer(address, "static/none.js")[0] == 404
            assert answer(address, "upload", "POST")[0] == 403
            assert answer(address, "static/none.js")[0] == 404  # what came before is logged by then
    finally:
        log.removeHandler(caplog.handler)
    lines = [record.getMessage() for record in caplog.records if record.name.startswith("tornado")]
    assert any("/TOKEN/static/none.js" in line for line in lines)
    assert not [line for line in lines if urlsplit(address).path.strip("/") in line]


def test_a_refused_upload_leaves_no_file(address: str) -> None:
    """An archive that is none is refused after it came, and one that never comes whole goes with its connection."""
    page = re.search(r'data-page="([^"]+)"', answer(address)[1])
    assert page is not None
    name, broken = f"{page[1]}.csv.gz", gzip.compress(bytes(2000))[:-8]
    headers = {"X_Page": page[1], "X_Name": name, "Content_Length": str(len(broken))}
    status, text = answer(address, "upload", "POST", broken.decode("latin-1"), **headers)
    assert (status, "broken" in text) == (413, True)
    parts = urlsplit(address)
    with socket.create_connection((str(parts.hostname), int(parts.port or 0))) as line:
        head = f"POST {parts.path}upload HTTP/1.1\r\nHost: {parts.netloc}\r\nX-Page: {page[1]}\r\nX-Name: {name}\r\n"
        line.sendall(f"{head}Content-Length: 1000\r\n\r\nhalf".encode())
        assert _comes_to(True, name)
    assert _comes_to(False, name)


def _comes_to(expected: bool, name: str) -> bool:
    """Whether, within ten seconds, a file of that name is in a page's folder, or none is."""
    until = monotonic() + 10
    while any(Path(gettempdir()).glob(f"truewrench-*/*/{name}")) is not expected and monotonic() < until:
        sleep(0.01)
    return any(Path(gettempdir()).glob(f"truewrench-*/*/{name}")) is expected


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
