"""Report of a discovery: the equation typeset, its constants, the residual before and after, and the runners-up."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from diagnosis.comparison.compared_step import error_table
from diagnosis.comparison.model_comparison import compare
from diagnosis.discovery.discovery import Discovery, FoundEquation
from diagnosis.discovery.grammar import Term
from diagnosis.discovery.quantities import POWER, SIGN, Quantity
from diagnosis.discovery.search import ScoredTerm
from diagnosis.study import StudyStep
from diagnosis.verdict.aliasing import channel_tolerance
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from modeling.number_format import SHARE, FormattedQuantity, format_number, format_p_value, format_percentage
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.plots.parameters_plot import error_reduction_image
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR
from truewrench.plots.time_series_plot import LabelledComparison
from truewrench.reports.effect_row import effect_cards, quantities
from truewrench.reports.report_files import Provenance, ReportTexts
from truewrench.reports.report_html import RecordingSection, full_section, sharing_numbers, short_section

# A term in signs, and what they stand for.


SYMBOLS = {
    "v": "v velocity of the point where it acts (m/s)",
    "a": "a acceleration of the point (m/s²)",
    "w": "w angular rate of the tool (rad/s)",
    "al": "al angular acceleration of the tool (rad/s²)",
    "r": "r position of the point in the world (m)",
    "up": "up the unit vector against gravity",
    "e": "e the unit vector along the tip",
    "n": "n the vector from the point to a place (m), whose coordinates are among the parameters",
    "h": "h a constant vector in the tool's axes",
    "k": "k a constant vector in the world's axes",
    **{axis: f"{axis} coordinate of the point in the world (m)" for axis in "xyz"},
    **{f"{name}_sat": f"{name}_sat = {name} / ({scale} + |{name}|)" for name, scale in (("v", "v_0"), ("w", "u_0"))},
    **{
        f"{name}_drop": f"{name}_drop = {name} / (1 + (|{name}| / {scale})²)"
        for name, scale in (("v", "v_0"), ("w", "u_0"))
    },
    "fading": "fading = exp(−time / t_0)",
}
"""Leaves of the grammar in words; others are columns of the recording, and named as there."""
BEYOND = {
    "over": "how far the point is above s_0 in {} (m), else 0",
    "under": "how far the point is below s_0 in {} (m), else 0",
    "onto": "the same from s_0 upwards in {}, over w_0, 1 at the most",
    "into": "the same from s_0 downwards in {}, over w_0, 1 at the most",
    "falling": "what falls to 1/e in l_0 along {}, 1 in its middle",
    "rising": "what rises by e in l_0 along {}, 1 in its middle",
}


def typeset_formula(term: Term, space: Space) -> str:
    """Its formula with signs for products: a coordinate may be called x."""
    return replace(term, quantity=replace(term.quantity, formula=_in_signs(term.quantity))).printed(space)


def _in_signs(quantity: Quantity, within: str = "") -> str:
    parts = [_in_signs(operand, quantity.operation) for operand in quantity.operands]
    match quantity.operation:
        case "cross":
            text = " × ".join(parts)
        case "dot":
            text = "·".join(parts)
        case "times":
            text = " ".join(parts)
        case "norm":
            return f"|{parts[0]}|"
        case operation if operation == SIGN:
            return f"sign({parts[0]})"
        case operation if operation == POWER:
            return f"{parts[0]}^{quantity.exponent}"
        case _:
            return quantity.formula
    grouped = within in ("cross", "dot", POWER) or (within == "times" and quantity.operation != "times")
    return f"({text})" if grouped else text


def symbols_sentence(term: Term, columns: Collection[str] = ()) -> str:
    """What the letters of its formula stand for; `columns` are those that are in the recording beside the motion."""
    said = []
    for name in sorted(term.quantity.leaves):
        kind, _, axis = name.partition("_")
        if name in SYMBOLS:
            said.append(SYMBOLS[name])
        elif kind in BEYOND:
            said.append(f"{name} {BEYOND[kind].format(axis)}")
        elif re.fullmatch(r"d?(q\d+|phi)", recorded := name.removesuffix("_dev")):
            said.append(f"{recorded} as recorded ({'rad/s' if recorded.startswith('d') else 'rad'})")
        elif recorded in columns:
            said.append(f"{recorded} as recorded")
    said += ["d distance of the point from the sensor along the tip (m)"] if term.at_point else []
    return f"Symbols: {'; '.join(said)}." if said else ""


@dataclass(frozen=True)
class RunnerUp:
    """A term that cannot be told from the best one: its formula, odds of the best against it, and what differs."""

    formula: str
    odds: str
    apart: str

    @classmethod
    def of(cls, other: ScoredTerm, odds: float, best: ScoredTerm, space: Space) -> RunnerUp:
        """Beside the best term."""
        return cls(typeset_formula(other.term, space), f"1 : {format_number(odds, 2)}", told_apart(best, other))


def told_apart(best: ScoredTerm, other: ScoredTerm) -> str:
    """What a term has that the best one has not, how much of the fitted motion's residual it explains, its length."""
    leaves = [scored.term.quantity.leaves for scored in (other, best)]
    instead = [", ".join(sorted(names)) for names in (leaves[0] - leaves[1], leaves[1] - leaves[0])]
    if all(instead):
        differ = f"{instead[0]} instead of {instead[1]}"
    elif any(instead):
        differ = f"also {instead[0]}" if instead[0] else f"without {instead[1]}"
    else:
        differ = "the same quantities in another form"
    if best.term.at_point != other.term.at_point:
        differ += ", at the sensor's origin" if best.term.at_point else ", at a point along the tip"
    share = format_percentage(other.score / best.score) if other.score < best.score else "all"
    ours, theirs = best.term.complexity, other.term.complexity
    length = f", with complexity {theirs} for {ours}" if theirs != ours else ""
    return f"{differ}; it explains {share} of what the best one does{length}"


# The page.


@dataclass(frozen=True)
class EquationSection:
    """An equation on a page; `sizes` are its constants, `evidence` how much it explains where."""

    id: str
    formula: str
    symbols: str
    sizes: tuple[FormattedQuantity, ...]
    evidence: str
    runners_up: tuple[RunnerUp, ...]

    @classmethod
    def of(cls, equation: FoundEquation, held_out: Sequence[Recording]) -> EquationSection:
        """Of what was found, and tested on the recordings held out."""
        best, space = equation.found.best.scored, equation.effect.spaces[0]
        return cls(
            id=equation.effect.id,
            formula=typeset_formula(best.term, space),
            symbols=symbols_sentence(best.term, equation.effect.to_data().get("inputs", ())),
            sizes=tuple(quantities((name, *estimate) for name, estimate in equation.parameters.items())),
            evidence=evidence_sentence(equation, held_out),
            runners_up=tuple(RunnerUp.of(other, odds, best, space) for other, odds in equation.found.alternatives),
        )


def evidence_sentence(equation: FoundEquation, held_out: Sequence[Recording]) -> str:
    """What it explains, here and there, and how surely."""
    names = ", ".join(recording.name for recording in held_out)
    p_value = format_p_value(equation.found.p_value)
    return (
        f"It explains {format_percentage(equation.share)} of what was above the noise"
        f" (p {p_value if p_value.startswith('<') else f'= {p_value}'}, corrected for all terms tested), and"
        f" {format_percentage(equation.held_out)} of it on {names}, where its constants were not fitted."
    )


def discovery_report(discovery: Discovery, provenance: Provenance) -> ReportTexts:
    """The report as HTML and as Markdown; names given by users are escaped."""
    return ReportTexts.of("discovery", _values(discovery, provenance))


def _values(discovery: Discovery, provenance: Provenance) -> dict[str, Any]:
    rig = discovery.first.recordings[0].rig
    equations = [EquationSection.of(each, discovery.held_out) for each in discovery.equations]
    tolerance, _ = channel_tolerance(discovery.first)
    fits = [discovery.first, discovery.last][: 1 + discovery.found]
    steps, names = [_step(fit, discovery) for fit in fits], ["without it", "with it"][: len(fits)]
    kind, symbol = ("explained", "✓") if discovery.found else ("unexplained", "?")
    misfit = []
    if discovery.found and (misfitting := steps[-1].misfitting):
        kind, symbol = "partly_explained", "◐"
        misfit = [f"With what was found the model still does not fit {', '.join(misfitting)}."]
    nothing = f"No equation up to complexity {discovery.complexity}"
    return {
        "title": "; ".join(each.formula for each in discovery.equations) or nothing,
        "rig": "" if rig is None else rig.name,
        "provenance": provenance,
        "found": discovery.found,
        "kind": kind,
        "symbol": symbol,
        "nothing": nothing,
        "sentences": [*discovery.remarks(), *misfit],
        "equations": equations,
        "cards": {card.id: card for card in effect_cards(discovery.last)},
        "model": " + ".join(["rigid tool", *(effect.id for effect in discovery.first.model.effects)]),
        "depends_on": depends_table(discovery.depends_on),
        "error_image": error_reduction_image(steps, names, tolerance),
        "error_table": error_table(steps, names, tolerance),
        "recordings": _sections(steps, names, tolerance),
        "effects_toml": discovery.effects_toml,
    }


def depends_table(shares: Mapping[str, float]) -> Table:
    """Share of the residual's power that each signal predicts on blocks left out."""
    return Table.of(("signal", Column("share of the residual's power", format=SHARE)), list(shares.items()))


def _step(fit: Fit, discovery: Discovery) -> StudyStep:
    training = tuple(compare(fit, recording) for recording in fit.recordings)
    return StudyStep("", fit, training, tuple(compare(fit, recording) for recording in discovery.held_out))


def _sections(
    steps: Sequence[StudyStep], names: Sequence[str], tolerance: Mapping[str, float]
) -> list[RecordingSection]:
    colours = (MISFIT_COLOUR, ADEQUATE_COLOUR)
    trained, held_out = (
        [
            [LabelledComparison(n, colour, each) for n, colour, each in zip(names, colours, of_steps, strict=False)]
            for of_steps in zip(*compared, strict=True)
        ]
        for compared in ([step.training for step in steps], [step.validation for step in steps])
    )
    full = [full_section(sides, tolerance) for sides in trained]
    return sharing_numbers([*full, *(short_section(sides, fitted=False) for sides in held_out)])
