"""A page takes whatever a browser sends: what is no request is ignored, paths are those of its own files alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from bokeh.document import Document

from truewrench.workbench.page import MOST_WAITING, Page, Start
from truewrench.workbench.study_process import Cancelled, Done, Ended, Refused


class RecordedProcess:
    """Takes the place of a study's process, and keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.cancelled = 0

    def ask(self, request: dict[str, Any]) -> None:
        self.asked.append(request)

    def cancel(self) -> None:
        self.cancelled += 1

    def end(self) -> None:
        """Nothing has started."""


@pytest.fixture
def process() -> RecordedProcess:
    return RecordedProcess()


@pytest.fixture
def page(process: RecordedProcess) -> Iterator[Page]:
    found = Page(Document(), Start())
    found._process = process  # type: ignore[assignment]
    yield found
    found.end()


def sent(page: Page, *texts: object) -> None:
    page._requests.data = {"request": list(texts)}


def said(page: Page) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(page._answers.data["answer"][0])
    return found


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", "null", 7, None, "[" * 40_000, '{"do": "view", "x": "' + "x" * 60_000 + '"}'], ids=str
)
def test_what_is_no_request_is_ignored(page: Page, process: RecordedProcess, text: object) -> None:
    sent(page, text)
    assert process.asked == []


@pytest.mark.parametrize("name", ["recordings", "validate", "rig", "map"])
def test_no_path_of_the_browser_reaches_the_process(page: Page, process: RecordedProcess, name: str) -> None:
    for path in ("/etc/passwd", ["/etc/passwd"], ["../0"]):
        sent(page, json.dumps({"do": "open", name: path}))
        assert process.asked == []
        assert said(page)["busy"] is False


def test_a_puzzle_is_written_where_the_page_says(page: Page, process: RecordedProcess) -> None:
    sent(page, json.dumps({"do": "puzzle", "effect": "viscous_drag", "folder": "/etc"}))
    assert process.asked[0]["folder"].startswith(str(page.uploads._folder))


def test_requests_wait_for_each_other_and_are_bounded(page: Page, process: RecordedProcess) -> None:
    for _ in range(10 * MOST_WAITING):
        sent(page, json.dumps({"do": "undo"}))
    assert len(process.asked) == 1
    assert len(page._waiting) == MOST_WAITING
    page._take(Refused("nothing to undo", "study", "go on"))
    assert len(process.asked) == 2


def test_cancel_drops_what_waits_and_signals_once(page: Page, process: RecordedProcess) -> None:
    for request in ("diagnose", "undo", "cancel", "cancel"):
        sent(page, json.dumps({"do": request}))
    assert process.cancelled == 1
    page._take(Cancelled())
    assert [request["do"] for request in process.asked] == ["diagnose"]
    assert said(page)["busy"] is False


def test_what_follows_by_itself_gives_way(page: Page, process: RecordedProcess) -> None:
    from truewrench.workbench.page_update import PageUpdate

    sent(page, json.dumps({"do": "undo"}))
    page._take(Done(PageUpdate({"steps": ""}, follow={"do": "suspects"})))
    assert process.asked[-1] == {"do": "suspects"}
    sent(page, json.dumps({"do": "view", "view": "map"}))
    assert process.cancelled == 1
    page._take(Cancelled())
    assert process.asked[-1]["do"] == "view"
    page._take(Done(PageUpdate({"view": ""})))
    assert process.asked[-1] == {"do": "suspects"}


def test_a_process_that_is_gone_is_said(page: Page) -> None:
    sent(page, json.dumps({"do": "undo"}))
    page._take(Ended())
    assert page._process is None
    assert said(page)["busy"] is False


def test_messages_are_escaped_and_name_files_without_their_folder(page: Page) -> None:
    name, path = page.uploads.place("train.csv")
    page._refuse(Refused("<script>", str(path), "<b>"))
    notice = said(page)["notice"]
    assert notice.startswith(f"<b>{name}</b>")
    assert "<script>" not in notice
    assert str(page.uploads._folder) not in notice
