"""Form of a custom effect: lines of text to the table of an effects file, checked by the parser of formulas."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite
from typing import Any

from markupsafe import Markup

from diagnosis.study import Study
from modeling.errors import InputError, quoted, suggestion
from modeling.formulas.custom_effect import CustomEffect, require_finite
from modeling.formulas.vocabulary import FORMULA_STAGES, target_units
from modeling.number_format import format_unit
from truewrench.workbench.page_update import PLACES
from truewrench.workbench.study_words import require_known_names, unit_hint

EXAMPLES = {"parameters": "c: N·s/m", "inputs": "temperature: K", "constants": "x0: 0.1 m",
            "formulas": "force_x = -c * tip_vx"}  # fmt: skip
"""A line of each field."""
POINT = "distance_along_the_tip"
"""Constant for a point that is given as a number, in m."""
LONGEST = 4000
"""Characters of a field."""


def effect_of_form(form: Mapping[str, Any], study: Study | None) -> CustomEffect:
    """The custom effect that a form describes, checked on the recordings of a study.

    Raises InputError, in one line, for whatever is wrong with it.
    """
    stage = str(form.get("stage", "tip_body"))
    if stage not in FORMULA_STAGES:
        raise InputError(what="there is no such place", where="acts on", remedy=f"use {', '.join(FORMULA_STAGES)}")
    formulas, constants = _pairs(form, "formulas", "="), _pairs(form, "constants", ":")
    parameters, inputs = _pairs(form, "parameters", ":"), _pairs(form, "inputs", ":")
    _require(bool(_text(form, "id")), "the effect has no name", "name", "write one, such as my_drag")
    _require(bool(parameters), "there is no parameter to estimate", "parameters", "write one a line, as in c: N·s/m")
    if study is not None:
        _require_known(formulas, stage, inputs, study)
        require_known_names(formulas, (*parameters, *inputs, *constants), study)
    if (point := _text(form, "at")) and stage == "tip_body":
        formulas["at"] = point
        if _is_number(point):
            formulas["at"], constants[POINT] = POINT, f"{point} m"
    table: dict[str, Any] = {
        "id": _text(form, "id"),
        "title": _text(form, "title") or _text(form, "id"),
        "parameters": parameters,
        stage: formulas,
    }
    table |= {name: pairs for name, pairs in (("inputs", inputs), ("constants", constants)) if pairs}
    effect = CustomEffect.from_data(table, where=table["id"] or "effect")
    if study is not None:
        _require_usable(effect, study)
    return effect


def _require(holds: bool, what: str, where: str, remedy: str) -> None:
    if not holds:
        raise InputError(what=what, where=where, remedy=remedy)


def _require_known(formulas: Mapping[str, str], stage: str, inputs: Mapping[str, str], study: Study) -> None:
    """InputError for a target that this sensor has not, and for a column of the recording that is not declared."""
    targets = target_units(FORMULA_STAGES[stage], study.model.space)
    for name, formula in formulas.items():
        what = f"{quoted(name)} is not what a {PLACES[stage]} adds to"
        _require(name in targets or name == "at", what, "formulas", suggestion(name, targets))
        used = set(re.findall(r"[A-Za-z_]\w*", formula))
        missing = sorted(used.intersection(study.fit.recordings[0].auxiliary) - set(inputs))
        if missing:
            what = f"{quoted(missing[0])} is a column of the recording that is not declared"
            remedy = f"list it under Columns of the recording, with its unit, as in {missing[0]}: 1"
            raise InputError(what=what, where="formulas", remedy=remedy)


def _require_usable(effect: CustomEffect, study: Study) -> None:
    space = study.model.space
    if space not in effect.spaces:
        remedy = "use the signals and channels of these recordings"
        what = f"it is not for a sensor of the channels {', '.join(space.channels)}"
        raise InputError(what=what, where=effect.id, remedy=remedy)
    for recording in study.fit.recordings:
        where = f"{effect.id}, on {recording.name}"
        require_finite(effect.definition, space, recording.motion.model_signals, recording.samples, where)


def _is_number(text: str) -> bool:
    try:
        return isfinite(float(text))
    except ValueError:
        return False


def _text(form: Mapping[str, Any], name: str) -> str:
    text = str(form.get(name, "")).strip()
    if len(text) > LONGEST:
        raise InputError(what=f"longer than {LONGEST} characters", where=name, remedy="write less")
    return text


def _pairs(form: Mapping[str, Any], name: str, between: str) -> dict[str, str]:
    """Lines `name = formula` or `name: unit`."""
    pairs: dict[str, str] = {}
    for line in filter(None, (line.strip() for line in _text(form, name).splitlines())):
        left, sign, right = (text.strip() for text in line.partition(between))
        if not sign or not left or not right:
            remedy = f"write one to a line, as in {EXAMPLES[name]}"
            raise InputError(what=f"{quoted(line)} cannot be read", where=name, remedy=remedy)
        right = right.replace("·", " ") if between == ":" else right
        if left in pairs:
            raise InputError(what=f"{quoted(left)} is given twice", where=name, remedy="give each once")
        pairs[left] = right
    return pairs


def checked_words(form: Mapping[str, Any], study: Study | None) -> str:
    """What is wrong with the form, or that nothing is, with the unit of each formula; as HTML."""
    try:
        effect = effect_of_form(form, study)
    except InputError as error:
        remedy = unit_hint(error, _parameters(form), lambda units: _is_right(form, units, study)) or error.remedy
        texts = (_in_fields(t) for t in (error.where, error.what, remedy))
        return Markup('<p class="wrong" role="status">{}: {}; {}</p>').format(*texts)
    units = {name: unit for space in effect.spaces for name, unit in target_units(effect.stage, space).items()}
    names = Markup(", ").join(f"{n} in {format_unit(units[n])}" for n, _ in effect.definition.formulas if n in units)
    return Markup('<p class="right" role="status">Grammar and units are right: {}.</p>').format(names)


def _parameters(form: Mapping[str, Any]) -> dict[str, str]:
    """Units by name; none where the field cannot be read."""
    try:
        return _pairs(form, "parameters", ":")
    except InputError:
        return {}


def _is_right(form: Mapping[str, Any], units: Mapping[str, str], study: Study | None) -> bool:
    """Whether the form would be right with these units of the parameters."""
    lines = "\n".join(f"{name}: {unit}" for name, unit in units.items())
    try:
        effect_of_form({**form, "parameters": lines}, study)
    except InputError:
        return False
    return True


def _in_fields(text: str) -> str:
    """A message about an effects file in words of the form: fields for tables, lines for TOML."""
    text = re.sub(r'constants = \{ (\w+) = "([^"]*)" \}', r"under Constants, \1: \2", text)
    return re.sub(r"\b(tip_body|gain|zero)\.", "", text)
