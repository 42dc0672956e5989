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
_LONG_NUMBER = re.compile(r"(\.\d)\d+")


_HEAD = re.compile(r"^.*?(?=<svg)|<metadata>.*?</metadata>", re.DOTALL)
_SPACES = re.compile(r"\s+")
SAFE = " !$&()*+,-./:;=?@[]^_`{|}~'"
"""Characters that a data URI in a quoted attribute may have as they are; the rest is escaped, the text stays short."""


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
        text = _PATH.sub(lambda match: _LONG_NUMBER.sub(r"\1", match[0]), _FONT.sub(SYSTEM_FONTS, stream.getvalue()))
        width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
        source = f"data:image/svg+xml,{quote(_SPACES.sub(' ', _HEAD.sub('', text)), safe=SAFE)}"
        return cls(source, width, height)


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
