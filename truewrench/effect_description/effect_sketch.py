"""Drawing of an effect's sketch, for reports, the workbench and the manual."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from math import atan2, ceil, cos, floor, hypot, radians, sin

from modeling.chain.effect import Effect
from modeling.sketch import (
    Arc,
    Arrow,
    Axes,
    Box,
    Circle,
    Ground,
    Length,
    Line,
    Links,
    Mark,
    Name,
    Point,
    Text,
    Tool,
)

WIDTH, HEIGHT = 240, 150
"""Size of every sketch, in its own units."""
ARROW = 7.0
"""Length of an arrow's head."""
ARC_STEPS = 24
"""Pieces of an arc: of a whole circle each is 15 degrees, of the arcs that there are less than 8."""
CHARACTER, BOLD_CHARACTER = 6.8, 7.4
"""Width of a character in the widest of the common fonts."""


class Drawing:
    """Elements of one sketch, as SVG in the colour of the text around it; kinds are classes that a page styles."""

    def __init__(self) -> None:
        self.elements: list[str] = []
        self.reach = [0.0, float(WIDTH)]

    def add(self, mark: Mark) -> None:
        """Draw one element."""
        match mark:
            case Line(points, kind, closed):
                self._line(points, kind, closed=closed)
            case Arc(x, y, radius, start, end, kind):
                angles = [radians(start + (end - start) * i / ARC_STEPS) for i in range(ARC_STEPS + 1)]
                self._line([(x + radius * cos(a), y + radius * sin(a)) for a in angles], kind)
            case Circle(x, y, radius, kind):
                self.elements.append(f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>')
            case Box(x, y, width, height, kind):
                self._line([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], kind, closed=True)
            case Arrow(start, end, kind):
                self._arrow(start, end, kind)
            case Text(x, y, words, anchor):
                self._text(x, y, words, anchor)
            case Name(x, y, words, anchor):
                self._text(x, y, words, anchor, "parameter")
            case Length((x1, y1), (x2, y2), name):
                middle = ((x1 + x2) / 2, (y1 + y2) / 2)
                self._arrow(middle, (x1, y1), "accent")
                self._arrow(middle, (x2, y2), "accent")
                self.add(name)
            case _:
                self._add_scenery(mark)

    def _add_scenery(self, mark: Mark) -> None:
        """What several sketches begin with."""
        match mark:
            case Tool(turn, kind):
                self.add(Box(102, 12, 36, 16))
                self._text(96, 24, "sensor", "end")
                across, along = (cos(radians(turn)), sin(radians(turn))), (-sin(radians(turn)), cos(radians(turn)))
                corners = [(-5, 0), (-5, 88), (0, 98), (5, 88), (5, 0)]
                self._line(
                    [(120 + u * across[0] + v * along[0], 28 + u * across[1] + v * along[1]) for u, v in corners], kind
                )
            case Axes(across_words, up_words, centred):
                crossing: Point = (118, 76) if centred else (34, 126)
                x, y = crossing
                self._arrow((24, y), (226, y), "faint")
                self._arrow((x, 140), (x, 10), "faint")
                self._text(228, y + 13, across_words, "end")
                self._text(x + 6, 16, up_words)
            case Links(elbow, hand, kind):
                self._line([(34, 118), elbow, hand], kind)
                for x, y in ((34, 118), elbow):
                    self.add(Circle(x, y, 5, "joint"))
            case Ground():
                self._line([(14, 126), (56, 126)], "ink")
                for left in range(16, 54, 8):
                    self._line([(left, 134), (left + 6, 126)], "faint")

    def _line(self, points: Sequence[Point], kind: str, *, closed: bool = False) -> None:
        steps = " L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        self.elements.append(f'<path class="{kind}" d="M{steps}{" Z" if closed else ""}"/>')

    def _arrow(self, start: Point, end: Point, kind: str) -> None:
        self._line([start, end], kind)
        (x1, y1), (x2, y2) = start, end
        angle, size = atan2(y2 - y1, x2 - x1), min(ARROW, hypot(x2 - x1, y2 - y1) / 2)
        ends = [(x2 - size * cos(angle + turn), y2 - size * sin(angle + turn)) for turn in (0.4, -0.4)]
        self._line([ends[0], end, ends[1]], kind)

    def _text(self, x: float, y: float, words: str, anchor: str = "", kind: str = "") -> None:
        """Words, for which the sketch is widened where they would be cut off."""
        width = len(words) * (BOLD_CHARACTER if kind == "parameter" else CHARACTER)
        left = x - width * {"end": 1.0, "middle": 0.5}.get(anchor, 0.0)
        self.reach = [min(self.reach[0], left), max(self.reach[1], left + width)]
        place = f' text-anchor="{anchor}"' if anchor else ""
        look = f' class="{kind}"' if kind else ""
        self.elements.append(f'<text x="{x:.1f}" y="{y:.1f}"{place}{look}>{escape(words)}</text>')

    def svg(self, title: str) -> str:
        """The whole sketch as an SVG element of an HTML page, named for those who do not see it."""
        left, right = floor(self.reach[0]), ceil(self.reach[1])
        view = f"{left} 0 {right - left} {HEIGHT}"
        named = f'<svg class="sketch" role="img" aria-label="{escape(title)}" viewBox="{view}">'
        return f"{named}{''.join(self.elements)}</svg>"


def effect_sketch(effect: Effect) -> str:
    """The sketch as an SVG element with the names of the effect's parameters; empty for an effect without one."""
    if not effect.sketch:
        return ""
    drawing = Drawing()
    for mark in effect.sketch:
        drawing.add(mark)
    return drawing.svg(f"Sketch: {effect.title}")


# Style sheet of sketches, for the page that shows them: the ink is the colour of the text, the effect stands out.


SKETCH_STYLE = """
.sketch { width: 100%; max-width: 240px; height: auto; display: block; color: inherit; }
.sketch path, .sketch circle { fill: none; stroke: currentColor; stroke-width: 1.4; stroke-linejoin: round;
  stroke-linecap: round; }
.sketch .faint { stroke-width: 0.9; opacity: 0.5; }
.sketch .ghost { stroke-dasharray: 4 3; opacity: 0.6; }
.sketch .accent { stroke: var(--effect, #D55E00); stroke-width: 1.8; }
.sketch .joint { fill: var(--paper, #fff); }
.sketch .dot { fill: currentColor; }
.sketch .accent.dot { fill: var(--effect, #D55E00); }
.sketch text { font: 11px sans-serif; fill: currentColor; opacity: 0.85; }
.sketch .parameter { fill: var(--effect, #D55E00); font-style: italic; font-weight: 600; opacity: 1; }
"""
