"""Reading of what the page was given: recordings as they stand, or what robots write, as `truewrench import` does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from random import choice
from typing import Any

from markupsafe import Markup

from estimation.case import Case
from estimation.reading.log_reading import read
from estimation.recordings.recording import Recording
from modeling.errors import InputError, quoted
from modeling.rig import Rig
from truewrench.files.case_files import rigid_tool_case
from truewrench.files.demonstration import CONTACT, TRAINING, VALIDATION, hidden_effect_by_id, record

# Puzzle: recordings of a simulated rig with a hidden effect, for who wants to learn the loop.


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

        answer = "You found it." if added == (self.hidden,) else f"Your model: {', '.join(added) or 'the rigid tool'}."
        return Markup("<p>It hides <strong>{}</strong>: {}. {}</p>").format(
            self.hidden, named(self.hidden).title, answer
        )


@dataclass(frozen=True, kw_only=True)
class ReadingForm:
    """How the page's user wants files to be read: the options of `truewrench import`.

    period        of the fitted recordings' motion, s
    clock_offset  stamp of the wrench minus that of the motion, s
    together      whether the files to fit are one recording, such as wrench and motion apart
    read          id of the reading to apply, of those that are proposed; None for none, empty to take all as it is
    """

    preset: str | None = None
    map: str | None = None
    period: float | None = None
    clock_offset: float | None = None
    one_run: bool = False
    together: bool = False
    read: str | None = None

    @classmethod
    def of(cls, request: Mapping[str, Any]) -> ReadingForm:
        """The fields of a form; InputError for what is no number."""
        return cls(
            preset=str(request.get("preset") or "") or None,
            map=request.get("map") or None,
            period=_number(request, "period"),
            clock_offset=_number(request, "clock_offset"),
            one_run=bool(request.get("one_run")),
            together=bool(request.get("together")),
        )

    def recording(self, paths: Sequence[str], rig: Rig | None, *, fitted: bool) -> Recording:
        """The recording in one or several files."""
        recording = read(
            *paths, rig=rig, preset=self.preset, map=self.map, period=self.period if fitted else None,
            one_run=self.one_run, clock_offset=self.clock_offset,
        )  # fmt: skip
        return replace(recording, name=" + ".join(Path(path).name for path in paths))


def case_of(training: Sequence[str], validation: Sequence[str], rig: str | None, form: ReadingForm) -> Case:
    """The recordings in these files, with the model that they begin with; InputError for what cannot be read."""
    if not training:
        raise InputError(what="no file is chosen", where="recording", remedy="choose one to fit")
    description = None if rig is None else Rig.read(rig)
    groups = [tuple(training)] if form.together else [(path,) for path in training]
    fitted = [form.recording(paths, description, fitted=True) for paths in groups]
    held_out = [form.recording([path], description, fitted=False) for path in validation]
    named = _apart([*fitted, *held_out])
    read, as_read = [form.read] if form.read else [], form.read == ""
    return rigid_tool_case(named[: len(fitted)], named[len(fitted) :], description, read=read, as_read=as_read)


def _apart(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with a number behind a name that an earlier one has."""
    names = [recording.name for recording in recordings]
    counts = [names[:i].count(name) for i, name in enumerate(names)]
    return [replace(r, name=f"{r.name} ({c + 1})") if c else r for r, c in zip(recordings, counts, strict=True)]


def _number(request: Mapping[str, Any], name: str) -> float | None:
    text = str(request.get(name) or "").strip().replace(",", ".")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value) or (name == "period" and value <= 0):
        remedy = "write seconds, such as 5.0, or leave it empty"
        raise InputError(what=f"{quoted(text)} is no number of seconds", where=name.replace("_", " "), remedy=remedy)
    return value
