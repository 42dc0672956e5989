"""Doubted reading: another reading of recordings that the data show, with its evidence and how it is stated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

ANY_EFFECT = "any"
"""In place of an effect's id."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DoubtedReading:
    """A reading of recordings that is shown, other than the one that they were read by.

    id             what is read otherwise, as FORMATS names it in JSON
    value          direction, rotation, convention, axis, unit or number; None of what has none
    meaning        what it means, as a clause
    statement      the line of a rig or map, or the option, that states it
    before, after  root mean square of the rigid tool's residual over the noise from sample to sample, as read and in
                   this reading; None of what the log alone shows, or cannot be read otherwise
    p_value        that the recording as read is as near to the truth, family-wise over all readings; None of what no
                   test decides
    mass           kg, of the tool in this reading
    beside         what was fitted with the tool, in both readings, as a clause; empty where nothing was but a drag
    adopted        whether the recordings are read so
    mends          whether it changes what was logged, not only how it is understood
    applies_to     "rig" or "map", where it is stated
    of_log         whether the reader of the log decided it, which is so whatever a case is told of readings
    shown_by       the evidence as a clause, by default residuals, p-value and mass
    explained_by   id of an effect that says the same: where a model has it, the recordings are read so; `ANY_EFFECT`
                   where any may be a rival; empty where none is
    """

    id: str
    meaning: str
    statement: str
    value: Any = None
    before: float | None = None
    after: float | None = None
    p_value: float | None = None
    mass: float | None = None
    beside: str = ""
    adopted: bool = False
    mends: bool = True
    applies_to: str = "rig"
    of_log: bool = False
    shown_by: str = ""
    explained_by: str = ""

    @property
    def has_rivals(self) -> bool:
        """Whether any effect may explain it as well."""
        return self.explained_by == ANY_EFFECT

    @property
    def evidence(self) -> str:
        """Why it is doubted, as a clause."""
        if self.shown_by or self.before is None or self.after is None:
            return self.shown_by
        mass = "" if self.mass is None else f", with a mass of {self.mass:.4g} kg"
        p_value = "" if self.p_value is None else f" (p = {self.p_value:.1g})"
        return (
            f"the residual of the rigid tool{self.beside} is {self.after:.2g} times the noise from sample to sample"
            f" then, and {self.before:.2g} times as read{p_value}{mass}"
        )

    @property
    def sentence(self) -> str:
        """What is doubted, the evidence, and how it is stated."""
        if self.of_log and self.adopted:
            return f"Read so that {self.meaning}: {self.shown_by}. Remedy: {self.statement}."
        if self.adopted and self.mends:
            return (
                f"Read so that {self.meaning}: {self.evidence}. `compensate` and `compare` take a log as it stands:"
                " mend it for them."
            )
        if self.adopted:
            return (
                f"Read so that {self.meaning}: {self.evidence}. To state it: {self.statement}; --as-read prevents it."
            )
        rival = " An effect may explain it as well: `diagnose` looks for one first." if self.has_rivals else ""
        return (
            f"The recording seems to be read wrongly: {self.meaning}; {self.evidence}."
            f" If it is so, apply it with {self.statement}; if not, --as-read takes the recording as it is.{rival}"
        )

    @property
    def is_mending(self) -> bool:
        """Whether the recordings are changed by it before they are fitted, as no other log of the same kind is."""
        return self.adopted and self.mends and not self.of_log

    def to_data(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "id": self.id,
            "adopted": self.adopted,
            "value": self.value,
            "statement": self.statement,
            "p_value": self.p_value,
            "misfit": [None if size is None else size**2 for size in (self.before, self.after)],
            "applies_to": self.applies_to,
            "sentence": self.sentence,
        }
