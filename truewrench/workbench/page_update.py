"""What an answer changes of the page: words, charts, a file to save, and what to ask next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from truewrench.plots.charts.chart import Chart


@dataclass(frozen=True)
class Download:
    """A file that the browser saves."""

    name: str
    kind: str
    content: bytes


@dataclass(frozen=True)
class PageUpdate:
    """Changes of a page.

    words   HTML by place; each replaces what is there
    charts  by place
    taps    places where a click on a figure asks for something: its request, without the place clicked
    follow  what is asked next, and gives way to whatever the user asks for
    """

    words: Mapping[str, str] = field(default_factory=dict)
    charts: Mapping[str, Chart] = field(default_factory=dict)
    taps: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    download: Download | None = None
    follow: Mapping[str, Any] | None = None
