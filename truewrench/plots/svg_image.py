"""Figure as an inline SVG data URI."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from urllib.parse import quote

from matplotlib import rc_context
from matplotlib.figure import Figure

SYSTEM_FONTS = "-apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, 'Liberation Sans', sans-serif"
_FONT = re.compile(r"'DejaVu Sans'[^;\"]*sans-serif")
_PATH = re.compile(r'(?<=<path d=")[^"]*')
_DECIMALS = re.compile(r"(?<=\.\d)\d+")


_HEAD = re.compile(r"^.*?(?=<svg)|<metadata>.*?</metadata>", re.DOTALL)
_SPACES = re.compile(r"\s+")
_NOT_ASCII = re.compile(r"[^\x00-\x7f]+")
ESCAPED = '%"#<>\\'
"""Characters that a data URI in a quoted attribute may not have as they are, beside those that are not ASCII."""


@dataclass(frozen=True)
class Drawing:
    """SVG data URI and its size in CSS pixels."""

    source: str
    width: int
    height: int

    @classmethod
    def of(cls, figure: Figure) -> Drawing:
        """The figure as a data URI.

        Text stays text, in the system font, and path coordinates keep one decimal of a point, which halves the
        file. The hash salt makes the output deterministic.
        """
        stream = io.StringIO()
        for axes in figure.axes:
            axes.patch.set_alpha(0.0)  # the page's paper, light or dark, shows through
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": "truewrench"}):
            figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        text = _PATH.sub(lambda match: _DECIMALS.sub("", match[0]), _FONT.sub(SYSTEM_FONTS, stream.getvalue()))
        width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
        return cls(f"data:image/svg+xml,{_escaped(_SPACES.sub(' ', _HEAD.sub('', text)))}", width, height)


def _escaped(text: str) -> str:
    """The text within a data URI; `quote` of all of it looks at each character."""
    for character in ESCAPED:
        text = text.replace(character, quote(character))
    return _NOT_ASCII.sub(lambda match: quote(match[0]), text)


@dataclass(eq=False)
class SvgImage:
    """A figure of a page, with alternative text and caption; drawn when it is asked for."""

    figure: Callable[[], Figure]
    alt: str
    caption: str = ""

    @cached_property
    def drawing(self) -> Drawing:
        """The figure as a data URI."""
        return Drawing.of(self.figure())

    @property
    def source(self) -> str:
        """SVG data URI."""
        return self.drawing.source

    @property
    def width(self) -> int:
        """CSS pixels."""
        return self.drawing.width

    @property
    def height(self) -> int:
        """CSS pixels."""
        return self.drawing.height
