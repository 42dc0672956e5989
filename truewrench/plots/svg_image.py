"""Figure as an inline SVG data URI."""

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
class SvgImage:
    """SVG data URI with alternative text, size in CSS pixels and caption."""

    source: str
    alt: str
    width: int
    height: int
    caption: str = ""


def svg_image(figure: Figure, alt: str, caption: str = "") -> SvgImage:
    """The figure as a data URI.

    Text stays text, in the system font, and path coordinates keep two decimals of a point, which halves the
    file. The hash salt makes the output deterministic.
    """
    stream = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "truewrench"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = _PATH.sub(lambda found: _LONG_NUMBER.sub(r"\1", found[0]), _FONT.sub(SYSTEM_FONTS, stream.getvalue()))
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    source = f"data:image/svg+xml;base64,{b64encode(text.encode()).decode()}"
    return SvgImage(source, alt, width, height, caption)
