"""Generic terms of the residual's regression, in words."""

from __future__ import annotations

import re

PLANAR_WORDS = {
    "phi": "orientation",
    "dphi": "angular velocity",
    "ddphi": "angular acceleration",
    "tau": "predicted torque",
}
"""Signals of the plane that have no axis in their name."""
AXIS_WORDS = {
    "p": "position along the world's {}",
    "v": "velocity along the world's {}",
    "vp": "velocity along the world's {}",
    "a": "acceleration along the world's {}",
    "ap": "acceleration along the world's {}",
    "w": "angular velocity about the sensor's {}",
    "al": "angular acceleration about the sensor's {}",
    "down_": "gravity's direction along the sensor's {}",
    "f": "predicted force along the sensor's {}",
    "t": "predicted torque about the sensor's {}",
}
"""By the name without its axis."""
POWERS = {"²": " squared", "³": " cubed"}


def term_in_words(term: str) -> str:
    """The meaning of a generic term; itself where it is a recorded signal of the user's.

    Examples
    --------
    >>> term_in_words("px")
    "position along the world's x"
    """
    return _words(term) or term


def _words(term: str) -> str:
    operator, _, signal = term.rpartition(" ")
    power = POWERS.get(signal[-1:], "")
    meaning = _signal_words(signal.rstrip("".join(POWERS)))
    if not operator or not meaning:
        return meaning and meaning + power
    if operator == "sign":
        return f"direction of the {meaning}"
    if operator.startswith(("sin", "cos")):
        name, multiple = operator.split()
        return (
            f"{'sine' if name == 'sin' else 'cosine'} of {'' if multiple == '1' else f'{multiple} times '}the {meaning}"
        )
    return f"{_signal_words(operator)} times that along {signal[-1]}"


def _signal_words(signal: str) -> str:
    if signal in PLANAR_WORDS:
        return PLANAR_WORDS[signal]
    found = re.fullmatch(r"(.*)([xyz])", signal)
    return "" if found is None or found[1] not in AXIS_WORDS else AXIS_WORDS[found[1]].format(found[2])
