"""The page in a real browser: the loop by hand, files dropped, tabs, cancel, and hostile requests that it survives."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np
import pytest

import truewrench as tw
from tests.truewrench.workbench.browser import WAIT, browser, idle, ready, workbench
from tests.truewrench.workbench.requests import answer
from truewrench.files import demonstration
from truewrench.simulated_rig import PlanarRig, simulate, write_recording

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytest.importorskip("mujoco")

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with short recordings of a rig that hides a drag."""
    folder = tmp_path_factory.mktemp("drag")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(demonstration, "SAMPLES", 200)
        demonstration.record(demonstration.hidden_effect_by_id("viscous_drag"), folder)
    return folder


@pytest.fixture(scope="module")
def opened() -> Iterator[Browser]:
    with browser() as found:
        yield found


def given(folder: Path) -> tuple[str | Path, ...]:
    return folder / "train.csv", "--validate", folder / "validate.csv", "--rig", folder / "rig.toml"


def text(page: Page, place: str) -> str:
    return page.inner_text(f"#{place}")


def press(page: Page, label: str) -> None:
    """Press a button by its label, and wait for the answer."""
    page.click(f'button[aria-label="{label}"], button:text-is("{label}")')
    page.wait_for_timeout(50)
    idle(page)


def in_sight(page: Page, place: str) -> bool:
    """Whether a place is within the window, below its top line."""
    box = page.locator(f"#{place}").bounding_box()
    return box is not None and box["y"] >= 0 and box["y"] + box["height"] <= 900


def suspects(page: Page) -> list[str]:
    """Significant suspects, when they are known."""
    page.wait_for_selector("#suspects details")
    idle(page)
    return page.locator("#suspects > ol > li > .line strong").all_inner_texts()


@pytest.mark.long(seconds=70)
def test_the_loop_by_hand(opened: Browser, recordings: Path) -> None:
    with workbench(*given(recordings)) as address:
        page = ready(opened, address)
        assert suspects(page)[0] == "viscous_drag"
        assert "does not fit" in text(page, "steps")
        assert page.locator("#plots canvas").count() >= 6
        _an_effect_is_added_and_dropped(page)
        _a_cell_is_seen_in_time(page)
        _a_custom_effect_is_written(page)
        _two_suspects_are_separated(page)
        _what_takes_long_is_cancelled(page)
        _the_diagnosis_goes_on(page)
        _two_tabs_do_not_disturb_each_other(opened, address, page)


def _an_effect_is_added_and_dropped(page: Page) -> None:
    page.focus('button[aria-label="add viscous_drag"]')
    page.keyboard.press("Enter")
    page.wait_for_selector('button[aria-label="drop viscous_drag"]')
    assert "The model fits" in text(page, "steps")
    assert text(page, "last-step").startswith("added viscous_drag: error / noise floor")
    assert in_sight(page, "last-step")
    assert "Tool: m" in text(page, "steps")
    assert page.evaluate("document.activeElement.ariaLabel") == "drop viscous_drag"
    assert suspects(page) == []
    page.click("nav [data-view=stairs]")
    page.wait_for_selector("#view [data-shown=stairs]", state="attached")
    press(page, "drop viscous_drag")
    assert "does not fit" in text(page, "steps")
    press(page, "Undo")
    press(page, "Redo")
    assert page.locator(".steps tbody tr td:nth-child(2)").all_inner_texts()[:3] == [
        "rigid tool", "rigid tool + viscous_drag", "rigid tool",
    ]  # fmt: skip
    press(page, "Undo")
    page.click("nav [data-view=time]")
    page.wait_for_selector("#view select[name=second]")
    press(page, "Side by side")
    assert "predicts better" in text(page, "table")
    press(page, "Undo")
    assert page.locator(".steps tbody tr").count() == 1


def _a_cell_is_seen_in_time(page: Page) -> None:
    page.click("nav [data-view=map]")
    page.wait_for_selector("#view [data-shown=map]", state="attached")
    idle(page)
    page.click("#view summary")
    page.click("#view .cells button >> nth=0")
    page.wait_for_selector("text=Marked: samples where")
    page.wait_for_selector("#legend >> text=samples of the cell")
    assert page.locator('#view [aria-label=channels] [aria-pressed="true"]').count() == 3
    page.click("nav [data-view=map]")
    page.wait_for_selector("#legend >> text=marked in time")
    page.click("nav [data-view=time]")
    page.wait_for_selector("#legend >> text=samples of the cell")
    press(page, "Unmark")
    assert "Marked" not in text(page, "view")
    assert page.locator('#view [aria-label=channels] [aria-pressed="true"]').count() == 3


def _a_custom_effect_is_written(page: Page) -> None:
    page.click("text=Write a custom effect")
    page.fill("#custom textarea[name=formulas]", "force_x = -c*tip_vx*tip_vx")
    page.wait_for_selector("#custom-result .wrong")
    assert "c should be in N·s²/m²" in text(page, "custom-result")
    page.fill("#custom textarea[name=formulas]", 'force_x = __import__("os").system("id")')
    page.wait_for_selector("#custom-result >> text=not allowed")
    page.fill("#custom textarea[name=formulas]", "force_x = -c*tip_vx\nforce_y = -c*tip_vy")
    page.fill("#custom input[name=at]", "0.12")
    page.wait_for_selector("#custom-result .right")
    press(page, "Add to the model")
    assert page.locator('button[aria-label="drop my_drag"]').count() == 1
    press(page, "Undo")


def _two_suspects_are_separated(page: Page) -> None:
    suspects(page)
    page.click("text=Separate two effects")
    page.select_option("#suspects select[name=first]", "viscous_drag")
    page.select_option("#suspects select[name=second]", "quadratic_drag")
    press(page, "Design")
    assert "separated" in text(page, "table")
    assert "Assumed: viscous_drag of the size" in text(page, "table")
    with page.expect_download() as saved:
        page.click("text=Download the trajectory")
    press(page, "Time")
    press(page, "Trajectory")
    assert "separated" in text(page, "table")
    assert Path(saved.value.path()).read_text(encoding="utf-8").startswith("time,q1,q2,q3")


def _what_takes_long_is_cancelled(page: Page) -> None:
    """A diagnosis takes a second and more, the click some hundredths."""
    page.click("text=Diagnose from here")
    page.wait_for_selector("#progress.busy")
    page.click("#cancel")
    page.wait_for_selector("#notice >> text=Cancelled")
    idle(page)
    page.click("#dismiss")
    assert page.is_hidden("#notice")
    assert page.locator(".steps tbody tr").count() == 1


def _the_diagnosis_goes_on(page: Page) -> None:
    press(page, "Diagnose from here")
    page.wait_for_selector(".verdict")
    assert "Explained" in text(page, "verdict")
    assert in_sight(page, "verdict .headline")
    assert "viscous_drag" in text(page, "verdict")
    idle(page)
    for button, start in (("Report (HTML)", "<!doctype html>"), ("Model (JSON)", "{"), ("Code or payload", '"""')):
        with page.expect_download() as saved:
            press(page, button)
        assert Path(saved.value.path()).read_text(encoding="utf-8").lstrip().lower().startswith(start)


def _two_tabs_do_not_disturb_each_other(opened: Browser, address: str, first: Page) -> None:
    before = text(first, "steps")
    second = ready(opened, address)
    second.wait_for_selector(".steps tbody tr")
    assert second.locator(".steps tbody tr").count() == 1
    second.wait_for_selector('button[aria-label="add sensor_lag"]')
    second.click('button[aria-label="add sensor_lag"]')
    second.wait_for_selector('button[aria-label="drop sensor_lag"]')
    assert second.locator(".steps tbody tr").count() == 2
    assert text(first, "steps") == before
    second.close()


def test_files_and_hostile_requests(opened: Browser, recordings: Path, tmp_path: Path) -> None:
    with workbench() as address:
        page = ready(opened, address)
        _a_bad_file_says_what_is_wrong(page, tmp_path, recordings)
        _what_is_packed_too_well_is_refused(page, tmp_path)
        _other_hosts_paths_and_sizes_are_refused(address, page)
        _no_path_of_the_machine_is_read(page)
        _a_hundred_tabs_are_bounded(address)
        page.set_input_files("#chooser input[name=recordings]", recordings / "train.csv")
        page.set_input_files("#chooser input[name=rig]", recordings / "rig.toml")
        page.wait_for_selector('#files select[aria-label="use of rig.toml"]')
        _a_file_is_for_what_is_chosen(page, recordings)
        press(page, "Open")
        assert "1600 samples" in text(page, "reading")
        assert "validate.csv held out" in text(page, "reading")
        assert suspects(page)[0] == "viscous_drag"
        _the_contact_is_found(page, recordings)
        _a_study_is_not_replaced_unasked(page)


@pytest.mark.long
def test_what_has_no_name_is_looked_for_and_added(opened: Browser, tmp_path: Path) -> None:
    rig = PlanarRig()
    (tmp_path / "rig.toml").write_text(demonstration.rig_text(rig), encoding="utf-8")
    for seed, name in enumerate(("train.csv", "validate.csv"), 1):
        frame = simulate(rig, rig.random_motion(seed=seed), repeats=4, samples_per_period=200, seed=seed)
        frame["fx"] += 0.5 * np.sin(11 * frame["q3"])
        write_recording(frame.drop(columns="temperature"), tmp_path / name)
    with workbench(*given(tmp_path)) as address:
        page = ready(opened, address)
        suspects(page)
        press(page, "Diagnose from here")
        page.wait_for_selector(".verdict")
        press(page, "Look for an equation")
        page.wait_for_selector("#discovery math")
        assert in_sight(page, "discovery .headline")
        assert "on validate.csv, where its constants were not fitted" in text(page, "discovery")
        assert page.locator("button:text-is('Look for an equation')").count() == 0
        with page.expect_download() as saved:
            press(page, "Effects file (TOML)")
        assert Path(saved.value.path()).read_text(encoding="utf-8").startswith("[[effect]]")
        press(page, "Add found_1 to the model")
        page.wait_for_selector('button[aria-label="drop found_1"]')
        assert "The model fits" in text(page, "steps")
        assert not text(page, "verdict")


@pytest.mark.long(seconds=12)
def test_a_notebook_and_its_page_have_one_study(opened: Browser, recordings: Path) -> None:
    """What is added in the frame is a step of the study, and what the study undoes is undone in the frame."""
    study = tw.study(recordings / "rig.toml", recordings / "train.csv", validate=recordings / "validate.csv")
    shown = study.show()
    with notebook(shown._repr_html_()) as address:
        page = opened.new_page(viewport={"width": 1000, "height": 850})
        page.set_default_timeout(WAIT)
        page.on("console", lambda line: pytest.fail(line.text) if line.type == "error" else None)
        page.goto(address)
        frame = page.frame_locator("iframe")
        frame.locator('button[data-do="add"][data-effect="viscous_drag"]').first.click()
        frame.locator('button[data-do="drop"][data-effect="viscous_drag"]').wait_for()
        assert study.effects == ("viscous_drag",)
        frame.locator("body[data-busy=false]").wait_for()
        study.undo()
        frame.locator('button[data-do="redo"]:not([disabled])').click()
        frame.locator('button[data-do="drop"][data-effect="viscous_drag"]').wait_for()
        assert study.effects == ("viscous_drag",)
        assert frame.locator("#chooser").is_hidden()
        page.close()
    shown.close()


@contextmanager
def notebook(frame: str) -> Iterator[str]:
    """Address of a page of another server of this machine, with a frame in it."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(f'<link rel="icon" href="data:,">{frame}'.encode())

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_port}/"
        server.shutdown()


def _open(page: Page, file: Path, rig: Path | None = None) -> str:
    """Choose a file, open it, and return what the page says."""
    page.set_input_files("#chooser input[name=recordings]", file)
    page.wait_for_selector(f'#files select[aria-label="use of {file.name}"]')
    page.wait_for_function("!document.querySelector('#files').textContent.includes('sending ...')")
    if rig is not None:
        page.set_input_files("#chooser input[name=rig]", rig)
        page.wait_for_selector(f'#files select[aria-label="use of {rig.name}"]')
    press(page, "Open")
    return text(page, "notice")


def _a_bad_file_says_what_is_wrong(page: Page, folder: Path, recordings: Path) -> None:
    bad = folder / "notes.csv"
    bad.write_text("what,is\nthis,file\n", encoding="utf-8")
    said = _open(page, bad)
    assert said.startswith("notes.csv: ")
    table = (recordings / "train.csv").read_text(encoding="utf-8").splitlines()
    nothing = folder / "nothing.csv"
    nothing.write_text("\n".join([table[0], *(["nan" + ",nan" * table[0].count(",")] * 300)]), encoding="utf-8")
    said = _open(page, nothing, recordings / "rig.toml")
    assert said.startswith("nothing.csv: ")
    assert "internal error" not in said


def _what_is_packed_too_well_is_refused(page: Page, folder: Path) -> None:
    bomb = folder / "bomb.csv.gz"
    bomb.write_bytes(gzip.compress(bytes(60_000_000)))
    page.set_input_files("#chooser input[name=recordings]", bomb)
    page.wait_for_selector("#files >> text=unpacks to")


def _other_hosts_paths_and_sizes_are_refused(address: str, page: Page) -> None:
    key = page.get_attribute("body", "data-page") or ""
    assert answer(address, "upload", "POST", X_Page=key, X_Name="big.csv", Content_Length="2000000000")[0] in (400, 413)
    assert answer(address, "upload", "POST", X_Page=key, Content_Length="1", Origin="http://evil.example")[0] == 403
    assert answer(address, Host="evil.example")[0] == 403
    assert answer(address, "static/../../../../etc/passwd")[0] in (403, 404)


def _no_path_of_the_machine_is_read(page: Page) -> None:
    """A request by hand, as a script in the page could write it."""
    request = '{"do": "open", "recordings": ["/etc/passwd"], "rig": "/etc/passwd"}'
    script = "(text) => Bokeh.documents[0].get_model_by_name('requests').data = {request: [text]}"
    page.evaluate(script, request)
    page.wait_for_selector("#notice >> text=the file is not here")


def _a_hundred_tabs_are_bounded(address: str) -> None:
    statuses = {answer(address)[0] for _ in range(100)}
    assert statuses == {200, 503}


def _a_file_is_for_what_is_chosen(page: Page, recordings: Path) -> None:
    """A file that is dropped is to be fitted, until its use is chosen."""
    page.set_input_files("#chooser input[name=validate]", recordings / "validate.csv")
    use = 'select[aria-label="use of validate.csv"]'
    page.wait_for_selector(f"#files {use}")
    assert page.input_value(use) == "validate"
    page.select_option(use, "recordings")
    page.select_option(use, "validate")
    assert page.is_visible("text=then press Open")


def _the_contact_is_found(page: Page, recordings: Path) -> None:
    press(page, "add viscous_drag")
    page.click("text=Contact in another recording")
    page.set_input_files("#contact input[type=file]", recordings / "contact.csv")
    page.wait_for_selector("#contact >> text=contact.csv (contact)")
    press(page, "Show the contact")
    assert page.locator("#table tbody tr").count() == 4  # one push in each repeat


def _a_study_is_not_replaced_unasked(page: Page) -> None:
    page.evaluate("document.querySelector('#chooser').open = true")
    page.once("dialog", lambda dialog: dialog.dismiss())
    page.click("#open")
    page.wait_for_selector("#notice >> text=Not opened; the study is as before")
    assert page.locator('button[aria-label="drop viscous_drag"]').count() == 1
