"""Image: a figure as an SVG that stands inside the page, so that the page needs no other file."""

from __future__ import annotations

import io
import re
from base64 import b64encode
from dataclasses import dataclass

from matplotlib import rc_context
from matplotlib.figure import Figure

SYSTEM_FONTS = "-apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, 'Liberation Sans', sans-serif"
_FONT = re.compile(r"'DejaVu Sans'[^;\"]*sans-serif")
_PATH = re.compile(r'(?<=<path d=")[^"]*')
_LONG_NUMBER = re.compile(r"(\.\d\d)\d+")


@dataclass(frozen=True)
class Image:
    """A picture with its text for those who cannot see it, its size in CSS pixels, and a caption."""

    source: str
    alt: str
    width: int
    height: int
    caption: str = ""


def image_of(figure: Figure, alt: str, caption: str = "") -> Image:
    """The figure as a data URI.

    Text stays text, in the reader's own system font, and the coordinates of paths keep two decimals of a
    point: both halve the file. The hash salt makes the same figure the same bytes.
    """
    stream = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "truewrench"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = _PATH.sub(lambda found: _LONG_NUMBER.sub(r"\1", found[0]), _FONT.sub(SYSTEM_FONTS, stream.getvalue()))
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    source = f"data:image/svg+xml;base64,{b64encode(text.encode()).decode()}"
    return Image(source, alt, width, height, caption)
