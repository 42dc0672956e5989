"""What an answer changes of the page: words, charts, a file to save, and what to ask next."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from truewrench.plots.chart import Chart

# Names of the page's fields for the options of the command line that messages speak of.


FIELD_NAMES = {
    "--map": '"Columns and units" under "How to read it"',
    "--preset": '"Layout" under "How to read it"',
    "--period": '"Period of the motion" under "How to read it"',
    "--no-period": '"one run" under "How to read it"',
    "--clock-offset": '"Clock offset" under "How to read it"',
    "--rig": '"Rig file"',
    "--validate": "'Held out for validation'",
    "--sensor-pose": '"Sensor in the flange"',
}
"""What an option of `truewrench import` or `diagnose` is called on the page."""

PLACES = {"tip_body": "force on the tool", "gain": "gain of a channel", "zero": "zero of a channel"}
"""What the page calls the tables of an effects file."""


def with_field_names(text: str) -> str:
    """A message with the page's fields for options of the command line.

    Examples
    --------
    >>> with_field_names("give it by --map")
    'give it by "Columns and units" under "How to read it"'
    """
    return re.sub(r"--[a-z][a-z-]*", lambda match: FIELD_NAMES.get(match[0], match[0]), text)


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
