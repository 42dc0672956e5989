"""Puzzle: recordings of a simulated rig with a hidden effect, for who wants to learn the loop."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from random import choice

from markupsafe import Markup

from modeling.errors import InputError
from truewrench.files.demonstration import CONTACT, TRAINING, VALIDATION, hidden_effect_by_id, record

EFFECTS = (
    "viscous_drag", "quadratic_drag", "cable_spring", "sensor_lag", "com_offset", "sensor_crosstalk",
    "link_length_error", "coulomb_friction",
)  # fmt: skip
"""What a puzzle hides: effects that its recordings excite."""
SURPRISE = "surprise"


def hidden_effect_of(asked: str) -> str:
    """The id of what to hide, any of them for `surprise`; InputError for another."""
    if asked not in (SURPRISE, *EFFECTS):
        raise InputError(what="no puzzle hides this", where="puzzle", remedy=f"use one of {', '.join(EFFECTS)}")
    return choice(EFFECTS) if asked == SURPRISE else asked


@dataclass(frozen=True)
class Puzzle:
    """Files of a simulated rig, and the id of what it hides."""

    folder: Path
    hidden: str

    @classmethod
    def simulated(cls, hidden: str, folder: str) -> Puzzle:
        """Simulate a rig with an effect; InputError where the simulator is not installed."""
        record(hidden_effect_by_id(hidden), Path(folder))
        return cls(Path(folder), hidden)

    @property
    def rig(self) -> str:
        """The rig's file."""
        return str(self.folder / "rig.toml")

    @property
    def training(self) -> str:
        """The recording to fit."""
        return str(self.folder / TRAINING.name)

    @property
    def validation(self) -> str:
        """A recording of another motion."""
        return str(self.folder / VALIDATION.name)

    @property
    def contact(self) -> str:
        """A recording in which a known force acts on the tool."""
        return str(self.folder / CONTACT.name)

    def solution(self, added: tuple[str, ...]) -> str:
        """What it hides, and whether it was found, as HTML."""
        from modeling.effects import named  # slow to import; the server wants the names alone

        found = "You found it." if added == (self.hidden,) else f"Your model: {', '.join(added) or 'the rigid tool'}."
        return Markup("<p>It hides <strong>{}</strong>: {}. {}</p>").format(
            self.hidden, named(self.hidden).title, found
        )
