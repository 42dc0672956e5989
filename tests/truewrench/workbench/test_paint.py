"""The page paints and is connected, in a real browser; what it does there is in `test_page.py`."""

from __future__ import annotations

from tests.truewrench.workbench.browser import browser, ready


def test_the_page_paints_and_says_what_is_wrong(address: str) -> None:
    with browser() as opened:
        page = ready(opened, address)
        assert page.is_visible("text=Open a recording")
        page.click('button:text-is("Open")')
        assert "no file is chosen" in page.inner_text("#notice")
        assert page.evaluate(
            "performance.getEntriesByType('resource').every((e) => e.name.startsWith(location.origin))"
        )
