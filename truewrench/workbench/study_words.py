"""Words of a study as HTML: steps, suspects, the reading report, comparisons; whatever a user names is escaped."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import isinf
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from diagnosis.comparison.comparison import Comparison, noise_from_residual
from diagnosis.comparison.residual_map import ResidualMap
from diagnosis.screening.score_test import ScoreTest
from diagnosis.screening.suspects import MOST_AMOUNTS, Suspects
from diagnosis.study import Study
from diagnosis.verdict_rule import EffectVerdict
from estimation.case import Case
from estimation.recordings.reading_report import StepKind
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.errors import InputError, quoted, suggestion
from modeling.formulas.parser import FORMULA_FUNCTIONS
from modeling.formulas.units import dimension
from modeling.formulas.vocabulary import FORMULA_STAGES, signal_units, target_units, tip_units
from modeling.number_format import format_number, format_p_value, format_percentage, format_unit, format_with_std
from modeling.space import Space
from modeling.table import Table
from truewrench.effect_description import SKETCH_STYLE, effect_sketch
from truewrench.files.case_files import frame_sentences
from truewrench.reports.discovery_report import EquationSection
from truewrench.reports.effect_row import effect_row
from truewrench.reports.page_templates import typeset
from truewrench.text.diagnosis_text import (
    RECORD_VERDICT_LABELS,
    TOTAL_RMS_NOTE,
    disturbance_sentences,
    evidence_notes,
    given_sentences,
    verdict_headline,
    weaker_verdict_warning,
)
from truewrench.text.fit_summary import agreement_text
from truewrench.text.tool_text import axes_sentence, tool_text
from truewrench.workbench.effect_estimates import effect_sizes, weakness
from truewrench.workbench.page_update import PLACES, with_field_names
from truewrench.workbench.reading import ORIENTATIONS, QUANTITIES, UNIT_KINDS, Columns, units_of
from truewrench.workbench.separation import rig_template, undesignable

if TYPE_CHECKING:
    from diagnosis.comparison.model_comparison import ModelComparison
    from diagnosis.diagnosis import Diagnosis
    from diagnosis.discovery.discovery import Discovery
    from estimation.contact.contact_wrench import ContactWrench
    from truewrench.workbench.separation import Separation
    from truewrench.workbench.view import View


# One suspect in words: its score beside the first one's, the error it removes, its size.


MOST_LIKELY_ABSENT = 0.5
"""P-value above which a first guess says nothing: the effect's absence explains its score."""
ALMOST_ALL = 0.9995
"""Share of the error above which it is not told from all of it: noise is part of what an effect fits."""


@dataclass(frozen=True)
class SuspectRow:
    """A suspect with its numbers as text.

    score  percent of the largest score of all
    """

    described: dict[str, Any]
    p_value: str
    removed: str
    score: float
    size: str
    detectable: str
    reason: str

    @classmethod
    def of(cls, test: ScoreTest, described: dict[str, Any], suspects: Suspects) -> SuspectRow:
        """The row of a score test."""
        significant = test.effect.id in suspects.ids
        p_value = suspects.p_values.get(test.effect.id, 1.0)
        largest = max((t.statistic for t in suspects.tests), default=0.0)
        return cls(
            described=described,
            p_value=format_p_value(p_value),
            removed=_share(suspects.share(test)) if significant else "",
            score=round(100 * test.statistic / max(largest, 1e-300), 1) if suspects.ids else 0.0,
            size=_first_guess(test, suspects, significant=significant) if p_value < MOST_LIKELY_ABSENT else "",
            detectable=suspects.detectable_text(test),
            reason=test.reason,
        )


def _share(share: float | None) -> str:
    if share is None:
        return ""
    return "> 99.9 %" if share > ALMOST_ALL else format_percentage(share)


def _first_guess(test: ScoreTest, suspects: Suspects, *, significant: bool) -> str:
    """The most significant amplitudes. One that is nominally infinite has no std, and no size but a significant one."""
    parameters = {p.name: p for p in test.effect.qualified(suspects.space)}
    texts = []
    for name, (value, std) in sorted(test.amounts.items(), key=lambda a: -abs(a[1][0]) / max(a[1][1], 1e-300)):
        infinite = isinf(parameters[name].nominal)
        if not infinite or significant:
            number = format_number(value, 2) if infinite else format_with_std(value, std)
            texts.append(f"{_own(name)} = {number} {format_unit(parameters[name].unit)}".rstrip())
    return ", ".join(texts[:MOST_AMOUNTS]) + ", .." * (len(texts) > MOST_AMOUNTS)


def _own(name: str) -> str:
    """The name of a parameter without its effect."""
    return name.split(".", 1)[1]


# Hints for formulas of a custom effect: names that a recording has, the unit that a parameter should have.


NAME = re.compile(r"(?<![\w.])[A-Za-z][A-Za-z0-9_]*(?![\w.(])")
"""A name in a formula, other than a function's."""
PLAIN = re.compile(r"(?!.*__)[\w\s+\-*/^().,]*", re.DOTALL)
"""A formula of names, numbers and signs; what else there is the parser refuses."""


def known_signals(study: Study) -> dict[str, str]:
    """Unit of each signal that formulas on these recordings may use, as the help lists them."""
    present = study.fit.recordings[0].motion.model_signals
    return {name: unit for name, unit in signal_units(study.model.space).items() if name in present}


def require_known_names(formulas: Mapping[str, str], names_of_form: Collection[str], study: Study) -> None:
    """InputError for a name that is neither the form's own nor in the help for this kind of recording."""
    helped = (*names_of_form, *known_signals(study), *tip_units(study.model.space), *study.fit.recordings[0].auxiliary)
    accepted = {*helped, *FORMULA_FUNCTIONS, "pi"}
    for target, formula in formulas.items():
        for name in NAME.findall(formula) if PLAIN.fullmatch(formula) else ():
            if name not in accepted:
                what = f"{quoted(name)} is not a known name for these recordings"
                raise InputError(what=what, where=target, remedy=suggestion(name, helped))


def unit_hint(error: InputError, parameters: Mapping[str, str], accepted: Callable[[dict[str, str]], bool]) -> str:
    """The unit that one parameter should have instead, if that alone mends a unit error; else empty.

    `accepted` says whether the form is right with other units of its parameters. A parameter that enters linearly
    should have its unit times the expected over the found one.
    """
    match = re.search(r"its unit is (.+), expected (.+)$", error.what)
    if match is None:
        return ""
    try:
        present, expected = (dimension(unit) for unit in match.groups())
        units = {name: str(dimension(unit) * expected / present) for name, unit in parameters.items()}
    except InputError:
        return ""
    mended = [name for name, unit in units.items() if accepted({**parameters, name: unit})]
    return f"{mended[0]} should be in {format_unit(units[mended[0]])}" if len(mended) == 1 else ""


# Line of the last step, which stays in sight: what was changed, and what became of the error.


ERRORS = ("error / noise floor", "held out")
"""Columns of a study's table that the line repeats."""


@dataclass(frozen=True)
class StepLine:
    """The last step of a study.

    done    what was done: `added sensor_lag`
    before  its errors before, as text by column of the study's table; empty for the first model
    after   those of the current model
    """

    done: str = ""
    before: tuple[tuple[str, str], ...] = ()
    after: tuple[tuple[str, str], ...] = ()

    def then(self, done: str, study: Study) -> StepLine:
        """The line after another step."""
        return StepLine(done, self.after, errors_of(study))

    def words(self) -> str:
        """As HTML, such as `added sensor_lag: error / noise floor 5.28 → 0.551, held out 4.78 → 0.829`."""
        errors_before = dict(self.before) if self.before != self.after else {}
        errors = Markup(", ").join(
            Markup("{} {}<b>{}</b>").format(name, f"{errors_before[name]} → " if name in errors_before else "", now)
            for name, now in self.after
        )
        return Markup("{}: {}").format(self.done, errors)


def errors_of(study: Study) -> tuple[tuple[str, str], ...]:
    """The largest error over noise floor of the current model, fitted and held out, as the table of steps has it."""
    table = study.table
    last = zip(table.columns, table.rows[-1], strict=True)
    return tuple((c.heading, c.text(value)) for c, value in last if c.heading in ERRORS)


COLLINEAR = "collinear"
"""How the reason begins why an effect is not tested whose place others of the model take in these recordings."""
MOST_CELLS = 12
"""Significant cells listed below the maps, the largest."""


@cache
def templates() -> Environment:
    """Templates of the page's parts; values are escaped, a missing one is an error."""
    environment = Environment(
        loader=PackageLoader("truewrench.workbench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"p_value": format_p_value, "percentage": format_percentage, "number": format_number}
    environment.filters["formula"] = typeset
    return environment


def part(template: str, **values: Any) -> str:
    """A part of the page."""
    return templates().get_template(template).render(**values)


def style_words() -> str:
    """The style of the sketches."""
    return SKETCH_STYLE


# ------------------------------------------------------------------------------------------ the recording


def reading_words(case: Case) -> str:
    """What was opened: size, rate, what was done to read it, what looks suspicious."""
    several = [(r, "fitted") for r in case.recordings] + [(r, "held out") for r in case.held_out]
    return part(
        "reading.html",
        recordings=[_recording_values(r, use) for r, use in several],
        sentences=frame_sentences(case),
        readings=case.readings,
    )


def columns_words(columns: Columns) -> str:
    """The form in which the columns of a log that is not recognised are chosen."""
    units = {kind: units_of(kind) for kind in UNIT_KINDS}
    return part("reading.html", columns=columns, quantities=QUANTITIES, orientations=ORIENTATIONS, units=units)


def estimates_words(estimates: Sequence[tuple[str, str]]) -> str:
    """What a rigid tool says of a log for each form of its orientation."""
    return Markup("<ul>{}</ul>").format(
        Markup("").join(Markup("<li><strong>{}</strong> {}</li>").format(name, words) for name, words in estimates)
    )


def _recording_values(recording: Recording, use: str) -> dict[str, Any]:
    report = recording.reading
    rate = "static poses" if recording.dt is None else f"{1 / recording.dt:.4g} Hz"
    repeats = f"{recording.repeats} repeats" if recording.repeats > 1 else "one run"
    suspicious = [] if report is None else [str(step) for step in report.of(StepKind.SUSPICIOUS)]
    return {
        "name": recording.name,
        "use": use,
        "size": f"{recording.samples} samples, {rate}, {repeats}",
        "channels": ", ".join(recording.channels),
        "suspicious": suspicious,
        "report": "" if report is None else str(report),
    }


# ------------------------------------------------------------------------------------------- the model


def steps_words(study: Study, *, puzzle: bool) -> str:
    """The steps with the error of the worst channel, and what can be dropped."""
    table, unknown = study.table, study.tool_unknown
    return part(
        "steps.html",
        headings=[c.heading for c in table.columns],
        rows=[[c.text(v) for c, v in zip(table.columns, row, strict=True)] for row in table.rows],
        effects=[_effect_values(effect, study) for effect in study.model.effects],
        failing=study.steps[-1].misfitting,
        agreement=agreement_text(study.steps[-1].misfitting, from_residual=noise_from_residual(study.fit)),
        undone=study.undone,
        tool=tool_text(study.fit, misfitting=bool(study.misfitting), unknown=unknown),
        axes=axes_sentence(study.fit, misfitting=bool(study.misfitting)),
        parameters=Markup(study.fit.table),
        puzzle=puzzle,
    )


def _effect_values(effect: Effect, study: Study) -> dict[str, Any]:
    return _described(effect, study) | {"sizes": effect_sizes(effect, study.fit), "weakness": weakness(effect, study)}


def _described(effect: Effect, study: Study) -> dict[str, Any]:
    """What an effect is: sketch, equation, parameters, what it is confused with, what to check."""
    names = [(p.name, p.meaning, format_unit(p.unit))
             for p in effect.parameters(study.model.space)]  # fmt: skip
    return {
        "id": effect.id,
        "title": effect.title,
        "equation": effect.equation,
        "advice": effect.advice,
        "confused_with": effect.confused_with,
        "sketch": Markup(effect_sketch(effect)),  # the sketch is ours
        "parameters": names,
    }


# ----------------------------------------------------------------------------------------- the suspects


def suspects_words(study: Study, suspects: Suspects | None, diagnosis: Diagnosis | None) -> str:
    """The suspects ranked; none yet while they are tested. A diagnosis says which two are to be separated first."""
    if suspects is None:
        return part("suspects.html", significant=None, others=[], untested=[], ties=[], names=[])
    rows = {t.effect.id: SuspectRow.of(t, _described(t.effect, study), suspects) for t in suspects.tests}
    tested = [t.effect.id for t in suspects.tests if t.excited]
    return part(
        "suspects.html",
        significant=[rows[i] for i in tested if i in suspects.ids],
        others=[rows[i] for i in tested if i not in suspects.ids],
        untested=[row for i, row in rows.items() if i not in tested],
        ties=[" and ".join(tie) for tie in suspects.ties],
        names=[*study.effects, *tested],
        collinear=[t.effect.id for t in suspects.tests if t.reason.startswith(COLLINEAR)],
        rig_file=rig_template(study.model.space),
        pair=_pair_to_separate(study, tested, diagnosis),
        undesignable=undesignable(study),
    )


def _pair_to_separate(study: Study, tested: Sequence[str], diagnosis: Diagnosis | None) -> tuple[str, ...]:
    """The last effect of the model with what comes closest to it, else the two suspects that rank first."""
    findings = () if diagnosis is None else diagnosis.findings
    close = [(f.effect.id, f.closest.effect.id) for f in findings if f.closest is not None]
    close += [] if diagnosis is None else [(a.given, a.effect.id) for a in diagnosis.given_alternatives]
    return close[-1] if close else (*study.effects[-1:], *tested)[:2]


def verdict_words(diagnosis: Diagnosis, *, looked: bool = False) -> str:
    """The verdict of a diagnosis, each effect with size and what it is confusable with.

    Where something is left of recordings that are read as they should be, an equation of it can be looked for, unless
    that was done (`looked`).
    """
    rows = [effect_row(f, diagnosis.model.space, diagnosis.findings) for f in diagnosis.findings]
    leading = (EffectVerdict.SUPPORTED, EffectVerdict.CONFUSABLE)
    return part(
        "verdict.html",
        kind=diagnosis.verdict.value,
        label=RECORD_VERDICT_LABELS[diagnosis.verdict],
        headline=verdict_headline(diagnosis),
        rows=[row for row in rows if row.finding.verdict in leading],
        notes=[with_field_names(n) for n in (*disturbance_sentences(diagnosis), *evidence_notes(diagnosis))],
        alternatives=[*diagnosis.averaged.sentences, *given_sentences(diagnosis)],
        warning=weaker_verdict_warning(diagnosis),
        left=diagnosis.unexplained is not None
        and all(doubted.adopted for doubted in diagnosis.readings)
        and not looked,
        held_out=bool(diagnosis.steps[0].validation),
    )


def discovery_words(discovery: Discovery) -> str:
    """The equation that was found, with what cannot be told from it; or that there is none."""
    equations = [EquationSection.of(each, discovery.held_out) for each in discovery.equations]
    return part("discovery.html", equations=equations, remarks=discovery.remarks(), ids=[e.id for e in equations])


# -------------------------------------------------------------------------------------------- the views


def view_words(view: View, study: Study, maps: Sequence[ResidualMap]) -> str:
    """What is looked at, and what else there is to look at."""
    step = study.steps[-1]
    several: Sequence[tuple[Comparison, str]] = [(c, "fitted") for c in step.training]
    several = [*several, *((c, "held out") for c in step.validation)]
    return part(
        "view.html",
        view=view,
        recordings=[f"{c.recording.name} ({use})" for c, use in several],
        channels=study.model.channels,
        steps=[f"{i}: {s.label}" for i, s in enumerate(study.steps)],
        unit="" if view.cell is None else format_unit(view.cell[2]),
        repeats=any(r.repeats > 1 for r in study.fit.recordings),
        fitting=not step.misfitting,
        cells=_significant_cells(maps),
        fits=several[view.recording][0].remarks(),
        total_rms_note=TOTAL_RMS_NOTE,
    )


def _significant_cells(maps: Sequence[ResidualMap]) -> list[dict[str, Any]]:
    cells = [
        {"panel": number, "x": float(m.centre[i]), "variable": m.variable, "unit": format_unit(m.variable_unit),
         "at": format_number(float(m.centre[i])), "mean": format_number(float(m.mean[i])),
         "mean_unit": format_unit(m.channel_unit), "size": abs(float(m.mean[i])) / max(m.tolerance, 1e-300)}
        for number, m in enumerate(maps) for i in range(len(m.centre)) if m.practically_significant[i]
    ]  # fmt: skip
    return sorted(cells, key=lambda cell: -float(cell["size"]))[:MOST_CELLS]  # type: ignore[arg-type]


def vocabulary_words(study: Study) -> str:
    """What formulas of a custom effect may use and add to, for this sensor."""
    space, recording = study.model.space, study.fit.recordings[0]
    return part(
        "vocabulary.html",
        signals=_with_units(known_signals(study)),
        tip=_with_units(tip_units(space)),
        inputs=sorted(recording.auxiliary),
        targets=[(PLACES[key], _with_units(target_units(stage, space))) for key, stage in FORMULA_STAGES.items()],
        own_axes="fcx, fcy, tauc" if space is Space.PLANE else "fcx .. tcz",
        functions=sorted(FORMULA_FUNCTIONS),
    )


def _with_units(units: Mapping[str, str]) -> list[tuple[str, str]]:
    return [(name, format_unit(unit)) for name, unit in units.items()]


def title_words(title: str) -> str:
    """A heading in the place of what is looked at."""
    return Markup("<h2>{}</h2>").format(title)


def table_words(parts: Sequence[Table | str]) -> str:
    """Tables and sentences of a result, in their order."""
    return part("tables.html", parts=[Markup(p) if isinstance(p, Table) else p for p in parts])


def trajectory_words(separation: Separation) -> str:
    """Heading of a designed trajectory, in the place of what is looked at."""
    return Markup('<h2 data-shown="trajectory">Trajectory that separates {} and {}</h2>').format(
        separation.first, separation.second
    )


def comparison_words(comparison: ModelComparison) -> str:
    """Two models side by side, in numbers."""
    names = ", ".join(r.name for r in comparison.recordings)
    return table_words([f"The two models in numbers, on {names}:", *comparison.printed()])


def contact_words(contact: ContactWrench) -> str:
    """The contacts found."""
    return table_words(contact.printed())


def separation_words(separation: Separation) -> str:
    """How well a trajectory separates two suspects."""
    return table_words(separation.design.printed()) + part(
        "separation.html",
        separation=separation,
        runs=separation.design.runs,
        available=separation.design.motion is not None,
    )
