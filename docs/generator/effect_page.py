"""Page of one effect: sketch, equations, parameters, pictures of a simulated example, what resembles it."""

from __future__ import annotations

import re
from inspect import cleandoc
from itertools import groupby
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

import truewrench as tw
from docs.generator.effect_example import CAPTIONS, EffectExample
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.number_format import format_number, format_unit
from modeling.parameter import Parameter
from modeling.rig import Rig
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.effect_description import effect_sketch
from truewrench.effect_description.effect_equations import effect_equations
from truewrench.reports.page_templates import markdown_table, markdown_text

SENSORS = {Space.PLANE: "planar", Space.SPACE: "six axes"}
CHANNELS = {name for space in Space for name in space.channels}
MOST_NAMES = 3
"""Names of alike parameters in a row, and the last."""
TEMPLATES = Path(__file__).with_name("templates")


def write_effect_page(effect: Effect, folder: Path) -> Path:
    """Write the page and its pictures to the folder; returns the page."""
    with TemporaryDirectory() as recordings:
        example = EffectExample(effect, Path(recordings))
        page = folder / f"{effect.id}.md"
        page.write_text(_page(effect, example, folder), encoding="utf-8")
    return page


def _page(effect: Effect, example: EffectExample, folder: Path) -> str:
    hidden = example.hidden_words
    pictures = []
    for kind, figure in example.figures().items():
        figure.savefig(folder / f"{effect.id}_{kind}.svg", format="svg", metadata={"Date": None})
        pictures.append((kind, CAPTIONS[kind]))
    sizes = example.sizes
    return _template().render(
        **described(effect, example.study.steps[0].fit.model),
        hidden=hidden,
        pictures=pictures,
        suspects=linked(example.suspects),
        verdict=example.verdict,
        aliases=" and ".join(_link(i) for i in example.aliases),
        sizes=markdown_table(sizes) if sizes.rows else "",
    )


def described(effect: Effect, model: WrenchModel) -> dict[str, object]:
    """What the page says without an example."""
    equations = effect_equations(effect, model)
    return {
        "effect": effect,
        "title": sentence(effect.title).rstrip("."),
        "sensors": " and ".join(SENSORS[space] for space in effect.spaces),
        "sketch": effect_sketch(effect),
        "equations": [] if equations is None else equations.mathml,
        "symbols": "" if equations is None else markdown_text(equations.symbols),
        "docstring": docstring_markdown(cleandoc(type(effect).__doc__ or "")),
        "parameters": [(sentence(SENSORS[s])[:-1], parameter_table(effect, s)) for s in effect.spaces],
        "confused": sentence(effect.confused_with),
        "advice": sentence(effect.advice),
    }


def docstring_markdown(text: str) -> str:
    """A docstring as Markdown: its paragraphs, and what it marks as code; other special characters as they are."""
    paragraphs = re.split(r"\n\s*\n", text)
    return "\n\n".join(_code_kept(paragraph) for paragraph in paragraphs)


def _code_kept(text: str) -> str:
    pieces = text.split("`")
    return "`".join(markdown_text(piece) if i % 2 == 0 else piece for i, piece in enumerate(pieces))


def parameter_table(effect: Effect, space: Space) -> str:
    """Meaning, unit and range of the parameters as Markdown, alike ones in one row; for an arm of three joints."""
    arm = Rig(link_lengths=(1.0, 1.0, 1.0)).arm
    fixed = {p.name: p.nominal for p in effect.restricted(space).parameters(space) if p.fixed}
    rows = []
    for (_, unit, bounds), group in groupby(effect.fitting(arm).parameters(space), _kind):
        first, *others = group
        names = [first.name, *(p.name for p in others)]
        meaning = first.meaning + (", and so on" if others else "")
        note = f"; fixed at {fixed[names[0]]:g} unless another value is significant" if names[0] in fixed else ""
        rows.append((_listed(names), meaning + note, format_unit(unit) or "1", _range(bounds)))
    return markdown_table(Table.of((Column("parameter"), Column("what it is"), Column("unit"), Column("range")), rows))


def _kind(p: Parameter) -> tuple[str, str, tuple[float, float]]:
    """What alike parameters share: the meaning but for number or channel, unit, bounds."""
    words = [w for w in p.meaning.split() if w not in CHANNELS and not w.isdigit()]
    return " ".join(words), p.unit, p.bounds


def _listed(names: list[str]) -> str:
    """The names, of many the first ones and the last."""
    return ", ".join([*names[:MOST_NAMES], "..", names[-1]] if len(names) > MOST_NAMES + 1 else names)


def _range(bounds: tuple[float, float]) -> str:
    low, high = bounds
    if (low, high) == (-inf, inf):
        return "any"
    if high == inf:
        return f"from {format_number(low)}"
    return f"{format_number(low)} to {format_number(high)}"


def linked(suspects: Table) -> str:
    """The table as Markdown with the ids as links to their pages."""
    table = markdown_table(suspects)
    for row in suspects.rows:
        table = table.replace(f"| {markdown_text(row[0])} |", f"| {_link(str(row[0]))} |", 1)
    return str(table)


def _link(effect_id: str) -> str:
    return f"[`{effect_id}`](#effect-{effect_id})"


def sentence(words: str) -> str:
    """The words with a capital and a full stop, and effects that they name as links."""
    known = {e.id for e in tw.effects.catalogue()}
    text = words[:1].upper() + words[1:] if words.partition(" ")[0].strip(",;:") not in known else words
    linked_words = (_linked_word(word, known) for word in text.split(" "))
    return " ".join(linked_words).rstrip(".") + "."


def _linked_word(word: str, known: set[str]) -> str:
    bare = word.strip(",;:()")
    return word.replace(bare, _link(bare)) if bare in known else word


def _template() -> Template:
    environment = Environment(loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, trim_blocks=True)
    return environment.get_template("effect.md")
