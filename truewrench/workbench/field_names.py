"""Names of the page's fields for the options of the command line that messages speak of."""

from __future__ import annotations

import re

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
    return re.sub(r"--[a-z][a-z-]*", lambda found: FIELD_NAMES.get(found[0], found[0]), text)
