"""Pictures of the workbench in the manual, taken of the page as it is: `make pictures`."""

from __future__ import annotations

import tempfile
from pathlib import Path

from playwright.sync_api import Page

from docs.generator.example_recordings import write_rig, write_run
from tests.truewrench.workbench.browser import browser, idle, ready, workbench
from truewrench.simulated_rig import ViscousDrag

PICTURES = Path(__file__).parents[1] / "static"


def main() -> None:
    """Drive the page through the loop on a rig that hides a drag, as the guide tells it."""
    with tempfile.TemporaryDirectory() as folder:
        train, validate, rig = (f"{folder}/{name}" for name in ("train.csv", "validate.csv", "rig.toml"))
        write_rig(rig)
        write_run(train, ViscousDrag(c=0.15, d=0.12), seed=1)
        write_run(validate, ViscousDrag(c=0.15, d=0.12), seed=2, repeats=4)
        with workbench(train, "--validate", validate, "--rig", rig) as address, browser() as opened:
            page = ready(opened, address)
            page.set_viewport_size({"width": 1280, "height": 800})
            _suspects(page)
            _map(page)
            _steps(page)
            _verdict(page)


def _suspects(page: Page) -> None:
    page.wait_for_selector("#suspects details")
    _take(page, "suspects")


def _map(page: Page) -> None:
    _view(page, "map")
    _take(page, "map")


def _steps(page: Page) -> None:
    page.click('button[aria-label="add viscous_drag"]')
    page.wait_for_selector('button[aria-label="drop viscous_drag"]')
    _view(page, "stairs")
    _take(page, "steps")


def _verdict(page: Page) -> None:
    page.click("text=Undo")
    page.wait_for_selector('button[aria-label="add viscous_drag"]')
    idle(page)
    page.click("text=Diagnose from here")
    page.wait_for_selector(".verdict")
    page.emulate_media(color_scheme="dark")
    _view(page, "time")
    _take(page, "verdict_dark")


def _view(page: Page, name: str) -> None:
    idle(page)
    page.click(f"nav [data-view={name}]")
    page.wait_for_selector(f"#view [data-shown={name}]", state="attached")


def _take(page: Page, name: str) -> None:
    """A picture of the window, once nothing moves any more."""
    idle(page)
    page.wait_for_timeout(1500)
    page.evaluate("scrollTo(0, 0)")
    page.screenshot(path=PICTURES / f"workbench_{name}.png")


if __name__ == "__main__":
    main()
