"""Reading of what the page was given: recordings as they stand, or what robots write, as `truewrench import` does."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import hypot, inf, isfinite
from pathlib import Path
from random import choice
from typing import Any

from markupsafe import Markup

from diagnosis.comparison.comparison import comparison_of
from estimation.case import Case
from estimation.fit import fit_case
from estimation.reading.column_map import UNITS, ColumnMap
from estimation.reading.log_reader import SourceFile, tables_of
from estimation.reading.log_reading import read
from estimation.recordings.recording import Recording
from modeling.errors import InputError, quoted
from modeling.number_format import format_number
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
    map: str | ColumnMap | None = None
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


# Columns of a log that is not recognised: what each quantity is, chosen on the page, becomes a map.


ORIENTATION_COLUMNS = tuple(f"o{i}" for i in range(1, 5))
QUANTITIES: Mapping[str, tuple[str, ...]] = {
    "Forces": ("fx", "fy", "fz"),
    "Torques; in the plane tau alone": ("tx", "ty", "tz", "tau"),
    "Orientation, in the order of its form; of three angles the first three, in the plane one": ORIENTATION_COLUMNS,
    "Or joint angles, with a rig file": tuple(f"q{i}" for i in range(1, 8)),
    "Position, if there is one": ("px", "py", "pz"),
    "Time": ("time",),
}
"""What is asked for, by heading."""
ORIENTATIONS = ("xyzw", "wxyz", "rotation_vector", *(f"euler {a}" for a in ("ZYX", "XYZ", "ZYZ", "xyz", "zyx", "zyz")))
"""Forms of an orientation in three or four columns; capitals are about moving axes."""
UNIT_KINDS = ("force", "torque", "angle", "position", "time")
SHOWN_DIGITS = 4
MOST_CHOICES = 400
"""Columns that are offered for each quantity: more than a robot writes, and half a megabyte of page."""


@dataclass(frozen=True)
class Columns:
    """The columns of files that are not recognised: names with their first value, and what was wrong."""

    first: Mapping[str, float]
    wrong: str

    @classmethod
    def of(cls, paths: Sequence[str], wrong: InputError) -> Columns | None:
        """Of the files' tables; None where there is no table in them."""
        first: dict[str, float] = {}
        with suppress(InputError):
            for path in paths:
                for table in tables_of(SourceFile(Path(path))):
                    first |= {name: float(values[0]) for name, values in table.columns.items() if len(values)}
        return cls(first, f"{wrong.where}: {wrong.what}") if first else None

    @property
    def choices(self) -> list[tuple[str, str]]:
        """Names, and what the page shows of each."""
        shown = [*self.first.items()][:MOST_CHOICES]
        return [(name, f"{name} ({format_number(value, SHOWN_DIGITS)})") for name, value in shown]


def map_data(request: Mapping[str, Any]) -> dict[str, Any]:
    """What the page's form says, with the structure of a map; InputError where a column has two uses."""
    names = [name for quantities in QUANTITIES.values() for name in quantities]
    chosen = {name: str(request[name]) for name in names if request.get(name)}
    for name, column in chosen.items():
        twice = next((other for other in chosen if other != name and chosen[other] == column), None)
        if twice is not None:
            remedy = "choose another column for one of them"
            raise InputError(what=f"{quoted(column)} is both {name} and {twice}", where="columns", remedy=remedy)
    turned = [chosen.pop(name) for name in ORIENTATION_COLUMNS if name in chosen]
    data: dict[str, Any] = dict(chosen)
    if len(turned) == 1:
        data["phi"] = turned[0]
    elif turned:
        data |= {"orientation_columns": turned, "orientation": str(request.get("orientation") or ORIENTATIONS[0])}
    units = {kind: str(request[f"unit_{kind}"]) for kind in UNIT_KINDS if request.get(f"unit_{kind}")}
    return data | ({"units": units} if units else {})


def map_text(data: Mapping[str, Any]) -> str:
    """The map as TOML, for the next time."""
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in data.items() if key != "units"]
    units = [f"{kind} = {json.dumps(unit, ensure_ascii=False)}" for kind, unit in data.get("units", {}).items()]
    return "\n".join([*lines, *(["", "[units]", *units] if units else [])]) + "\n"


def first_estimates(
    paths: Sequence[str], rig: str | None, form: ReadingForm, data: Mapping[str, Any]
) -> list[tuple[str, str]]:
    """What a rigid tool says of the log, read by this map, for each form of as many columns of orientation.

    (form, mass and RMS of the force that is left, or why it cannot be read so); what leaves least, to a digit, comes
    first, and of that a base that stands upright: one on its side and other angles may be the same to a weight.
    """
    count = len(data.get("orientation_columns", ()))
    forms = [f for f in ORIENTATIONS if (4 if f in ("xyzw", "wxyz") else 3) == count]
    estimates: list[tuple[float, bool, str, str]] = []
    for name in forms or [""]:
        stated = ColumnMap.of({**data, "orientation": name} if name else data, "columns")
        try:
            case = case_of(paths, (), rig, replace(form, map=stated, read=""))
            fitted = fit_case(case)
        except InputError as error:
            estimates.append((inf, False, name, error.what))
            continue
        mass, rms = fitted.parameters["m"], comparison_of(fitted, 0).rms
        left = hypot(*(value for channel, value in rms.items() if channel.startswith("f")))
        words = f"m = {format_number(mass.value, SHOWN_DIGITS)} ± {format_number(mass.std, 2)} kg"
        turned = "" if case.gravity is None else f", with {case.gravity.stated}"
        words = f"{words}; {format_number(left, 3)} N of force are left{turned}"
        estimates.append((float(f"{left:.0e}"), case.gravity is not None, name, words))
    return [(name or "as chosen", words) for *_, name, words in sorted(estimates)]


def units_of(kind: str) -> tuple[str, ...]:
    """The units of a kind, the SI unit first."""
    return tuple(UNITS[kind])
