"""Drawing of a sketch: lines, arrows, dimensions and labels as SVG that takes the colour of the text around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from math import atan2, ceil, cos, floor, hypot, radians, sin

WIDTH, HEIGHT = 240, 150
"""Size of every sketch, in its own units."""
ARROW = 7.0
"""Length of an arrow's head."""
CHARACTER, BOLD_CHARACTER = 6.8, 7.4
"""Width of a character in the widest of the common fonts."""

Point = tuple[float, float]


class Drawing:
    """Elements of one sketch; kinds of strokes are classes that a page styles: `ink`, `faint`, `accent`."""

    def __init__(self) -> None:
        self.elements: list[str] = []
        self.reach = [0.0, float(WIDTH)]

    def path(self, points: Sequence[Point], kind: str = "ink", *, closed: bool = False) -> None:
        """A line through points."""
        steps = " L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        self.elements.append(f'<path class="{kind}" d="M{steps}{" Z" if closed else ""}"/>')

    def line(self, x1: float, y1: float, x2: float, y2: float, kind: str = "ink") -> None:
        """A straight line."""
        self.path([(x1, y1), (x2, y2)], kind)

    def curve(self, y: Callable[[float], float], start: float, end: float, kind: str = "accent") -> None:
        """The graph of a function, in the sketch's units."""
        xs = [start + (end - start) * i / 60 for i in range(61)]
        self.path([(x, y(x)) for x in xs], kind)

    def arc(self, x: float, y: float, radius: float, start: float, end: float, kind: str = "accent") -> None:
        """A part of a circle from one angle to another, degrees clockwise from the x axis."""
        angles = [radians(start + (end - start) * i / 24) for i in range(25)]
        self.path([(x + radius * cos(a), y + radius * sin(a)) for a in angles], kind)

    def circle(self, x: float, y: float, radius: float, kind: str = "ink") -> None:
        """A circle; of the kinds `dot` and `accent dot` filled."""
        self.elements.append(f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>')

    def box(self, x: float, y: float, width: float, height: float, kind: str = "ink") -> None:
        """A rectangle, by its top left corner."""
        self.path([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], kind, closed=True)

    def arrow(self, x1: float, y1: float, x2: float, y2: float, kind: str = "accent") -> None:
        """An arrow to the second point."""
        self.line(x1, y1, x2, y2, kind)
        angle, size = atan2(y2 - y1, x2 - x1), min(ARROW, hypot(x2 - x1, y2 - y1) / 2)
        ends = [(x2 - size * cos(angle + turn), y2 - size * sin(angle + turn)) for turn in (0.4, -0.4)]
        self.path([ends[0], (x2, y2), ends[1]], kind)

    def dimension(self, x1: float, y1: float, x2: float, y2: float, label: str, at: Point, anchor: str = "") -> None:
        """A length between two points, with its label at a place."""
        middle = ((x1 + x2) / 2, (y1 + y2) / 2)
        self.arrow(*middle, x1, y1)
        self.arrow(*middle, x2, y2)
        self.parameter(*at, label, anchor)

    def text(self, x: float, y: float, words: str, anchor: str = "", kind: str = "") -> None:
        """Words that begin there; they end there (anchor `end`) or have their middle there (`middle`)."""
        place = f' text-anchor="{anchor}"' if anchor else ""
        look = f' class="{kind}"' if kind else ""
        self._make_room(x, len(words) * (BOLD_CHARACTER if kind == "parameter" else CHARACTER), anchor)
        self.elements.append(f'<text x="{x:.1f}" y="{y:.1f}"{place}{look}>{escape(words)}</text>')

    def _make_room(self, x: float, width: float, anchor: str) -> None:
        """Widen the sketch to a text that would be cut off."""
        start = x - width * {"end": 1.0, "middle": 0.5}.get(anchor, 0.0)
        self.reach = [min(self.reach[0], start), max(self.reach[1], start + width)]

    def parameter(self, x: float, y: float, name: str, anchor: str = "") -> None:
        """The name of a parameter of the effect."""
        self.text(x, y, name, anchor, "parameter")

    # ------------------------------------------------------------------------- what several sketches begin with

    def tool(self, *, turn: float = 0.0, kind: str = "ink") -> None:
        """A sensor with a tool hanging from it, turned about the sensor by degrees."""
        self.box(102, 12, 36, 16)
        self.text(96, 24, "sensor", "end")
        a = radians(turn)
        across, along = (cos(a), sin(a)), (-sin(a), cos(a))
        corners = [(-5, 0), (-5, 88), (0, 98), (5, 88), (5, 0)]
        points = [(120 + u * across[0] + v * along[0], 28 + u * across[1] + v * along[1]) for u, v in corners]
        self.path(points, kind)

    def axes(self, across: str, up: str, *, centred: bool = False) -> None:
        """The axes of a graph; `centred` ones cross in its middle."""
        x, y = (118, 76) if centred else (34, 126)
        self.arrow(24, y, 226, y, "faint")
        self.arrow(x, 140, x, 10, "faint")
        self.text(228, y + 13, across, "end")
        self.text(x + 6, 16, up)

    def arm(self, *, elbow: Point = (112, 52), hand: Point = (190, 74), kind: str = "ink") -> None:
        """A base and two links, to a hand that carries the sensor."""
        self.path([(34, 118), elbow, hand], kind)
        for x, y in ((34, 118), elbow):
            self.circle(x, y, 5, "joint")

    def base(self) -> None:
        """The ground under the arm's first joint."""
        self.line(14, 126, 56, 126)
        for x in range(16, 54, 8):
            self.line(x, 134, x + 6, 126, "faint")

    def svg(self, title: str) -> str:
        """The whole sketch as an SVG element of an HTML page, named for those who do not see it."""
        left, right = floor(self.reach[0]), ceil(self.reach[1])
        view = f"{left} 0 {right - left} {HEIGHT}"
        named = f'<svg class="sketch" role="img" aria-label="{escape(title)}" viewBox="{view}">'
        return f"{named}{''.join(self.elements)}</svg>"
