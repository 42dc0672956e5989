"""What a sketch of an effect consists of, as plain data: `truewrench` draws it for reports, workbench and manual.

A sketch is 240 wide and 150 high, x to the right, y downwards from its top left corner; angles are degrees, clockwise
from the x axis. The kind of a stroke is how it looks: `ink` of what is there anyway, `accent` of what the effect adds,
`ghost` (dashed) of how it would be without, `faint` of auxiliary lines, `joint` and `dot` of circles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

Point: TypeAlias = tuple[float, float]


class Line(NamedTuple):
    """A line through points."""

    points: tuple[Point, ...]
    kind: str = "ink"
    closed: bool = False


class Arc(NamedTuple):
    """A part of a circle about (x, y), from one angle to another."""

    x: float
    y: float
    radius: float
    start: float
    end: float
    kind: str = "accent"


class Circle(NamedTuple):
    """A circle; of the kinds `dot` and `accent dot` filled."""

    x: float
    y: float
    radius: float
    kind: str = "ink"


class Box(NamedTuple):
    """A rectangle, by its top left corner."""

    x: float
    y: float
    width: float
    height: float
    kind: str = "ink"


class Arrow(NamedTuple):
    """An arrow from a point to another."""

    start: Point
    end: Point
    kind: str = "accent"


class Text(NamedTuple):
    """Words that begin there; they end there (anchor `end`) or have their middle there (`middle`)."""

    x: float
    y: float
    words: str
    anchor: str = ""


class Name(NamedTuple):
    """The name of a parameter of the effect, placed as a text is."""

    x: float
    y: float
    words: str
    anchor: str = ""


class Length(NamedTuple):
    """A length between two points, dimensioned, with the name of its parameter."""

    start: Point
    end: Point
    name: Name


class Tool(NamedTuple):
    """The sensor, and the tool that hangs from it at (120, 28), 98 long, turned about the sensor by an angle."""

    turn: float = 0.0
    kind: str = "ink"


class Axes(NamedTuple):
    """The axes of a graph, from (34, 126) to (226, 10), with what is along them; `centred` ones cross at (118, 76)."""

    across: str
    up: str
    centred: bool = False


class Links(NamedTuple):
    """A base at (34, 118) and two links, to a hand that carries the sensor."""

    elbow: Point = (112, 52)
    hand: Point = (190, 74)
    kind: str = "ink"


class Ground(NamedTuple):
    """The ground under the base of the links."""


Mark: TypeAlias = Line | Arc | Circle | Box | Arrow | Text | Name | Length | Tool | Axes | Links | Ground
Sketch: TypeAlias = tuple[Mark, ...]


def graph(y: Callable[[float], float], start: float, end: float) -> tuple[Point, ...]:
    """Points of the graph of y(x), both in the sketch's units."""
    steps = 60  # 3 units apart across a whole sketch: a curve to the eye
    return tuple((x, y(x)) for x in (start + (end - start) * i / steps for i in range(steps + 1)))
