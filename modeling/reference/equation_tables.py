"""Tables of the equations and errata of chapter 22 (Bassi et al.), as text and HTML."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from textwrap import wrap

from modeling.reference.equation import Equation, EquationVerdict
from modeling.reference.erratum import Erratum


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of the chapter, each with its verdict."""

    members: tuple[Equation, ...]

    heads = ("equation", "printed", "derived", "verdict")
    widths = (18, 41, 41, 14)

    def __iter__(self) -> Iterator[Equation]:
        return iter(self.members)

    def __getitem__(self, name: str) -> Equation:
        """The equation of that number, or of that number and left-hand side."""
        return next(e for e in self.members if name in (e.number, f"{e.number} {e.states}"))

    def of(self, verdict: EquationVerdict) -> tuple[Equation, ...]:
        """Those with that verdict."""
        return tuple(e for e in self.members if e.verdict is verdict)

    def __str__(self) -> str:
        counts = ", ".join(f"{len(self.of(v))} {v.value}" for v in EquationVerdict)
        return "\n".join([_text(self.heads, [e.row for e in self.members], self.widths), counts])

    def _repr_html_(self) -> str:
        return _html(self.heads, [e.row for e in self.members])


@dataclass(frozen=True, eq=False)
class Errata:
    """The errata, each with its proofs."""

    members: tuple[Erratum, ...]

    heads = ("erratum", "claim", "proved by")
    widths = (7, 88, 20)

    @property
    def proven(self) -> bool:
        """Whether all errata are proven."""
        return all(e.proven for e in self.members)

    def __iter__(self) -> Iterator[Erratum]:
        return iter(self.members)

    def __getitem__(self, number: int) -> Erratum:
        """The erratum of that number in PHYSICS.md."""
        return next(e for e in self.members if e.number == number)

    def __str__(self) -> str:
        return _text(self.heads, [e.row for e in self.members], self.widths)

    def _repr_html_(self) -> str:
        return _html(self.heads, [e.row for e in self.members])


def _text(heads: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[int]) -> str:
    """A text table with cells wrapped at the widths and a rule between rows."""
    rule = "  ".join("-" * width for width in widths)
    lines = ["  ".join(h.ljust(w) for h, w in zip(heads, widths, strict=True)).rstrip(), rule]
    for row in rows:
        cells = [_wrapped(cell, width) for cell, width in zip(row, widths, strict=True)]
        for parts in zip_longest(*cells, fillvalue=""):
            lines.append("  ".join(p.ljust(w) for p, w in zip(parts, widths, strict=True)).rstrip())
        lines.append(rule)
    return "\n".join(lines)


def _wrapped(cell: str, width: int) -> list[str]:
    return [part for line in cell.splitlines() for part in wrap(line, width, subsequent_indent="  ")]


def _html(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th style='text-align:left'>{escape(h)}</th>" for h in heads)
    body = "".join(
        "<tr>"
        + "".join(f"<td style='text-align:left'>{escape(c).replace(chr(10), '<br>')}</td>" for c in row)
        + "</tr>"
        for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"
