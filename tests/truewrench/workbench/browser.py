"""A running workbench and a browser, for tests of the page."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

MISSING = "Chromium is missing: `make browser`, or name its program in the variable CHROMIUM"
WAIT = 90_000
"""Milliseconds in which an answer must come, on a machine that does other things too."""


def chromium() -> str:
    """The browser's program; the test fails without one."""
    named = os.environ.get("CHROMIUM")
    found = shutil.which(named) if named else shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.fail(MISSING, pytrace=False)
    return found


@contextmanager
def browser() -> Iterator[Browser]:
    """Chromium, without a window; whoever runs tests as root has no sandbox."""
    from playwright.sync_api import sync_playwright  # slow to import

    program = chromium()
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        try:
            yield opened
        finally:
            opened.close()


@contextmanager
def workbench(*arguments: str | Path) -> Iterator[str]:
    """Address of a workbench that runs in a process of its own, as a user starts it."""
    code = "import sys; from truewrench.command_line import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "workbench", "--no-browser", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[1]
        finally:
            process.terminate()
            assert process.wait(30) == 0


def idle(page: Page) -> None:
    """Wait until nothing is under way."""
    page.wait_for_selector("body[data-busy=false]", timeout=WAIT)


def ready(opened: Browser, address: str) -> Page:
    """A page that is connected; errors of its script fail the test."""
    page = opened.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(WAIT)
    page.on("pageerror", lambda error: pytest.fail(f"the page's script failed: {error}"))
    page.goto(address)
    page.wait_for_selector("body[data-ready=true]")
    return page
