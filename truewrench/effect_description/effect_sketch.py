"""Sketch of an effect, by its id, for reports, a manual or a page of the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from math import atan2, ceil, cos, exp, floor, hypot, pi, radians, sin

from modeling.chain.effect import Effect

# Drawing of a sketch: lines, arrows, dimensions and labels as SVG that takes the colour of the text around it.


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


# Sketches of effects of the arm: its joints and links.


def joint_offset(d: Drawing) -> None:
    """A joint stands at another angle than is recorded."""
    d.base()
    d.arm(hand=(196, 60), kind="ghost")
    d.arm(hand=(186, 100))
    d.text(232, 48, "recorded", "end")
    d.text(192, 114, "true")
    d.arc(112, 52, 52, 6, 34)
    d.parameter(172, 82, "offset_j")


def joint_elasticity(d: Drawing) -> None:
    """A joint gives way under the tool's weight."""
    d.base()
    d.arm(hand=(196, 56), kind="ghost")
    d.arm(hand=(190, 84))
    d.arrow(190, 86, 190, 124, "ink")
    d.text(196, 122, "weight")
    d.arc(112, 52, 14, -150, 150)
    d.parameter(100, 32, "compliance_j", "middle")


def joint_backlash(d: Drawing) -> None:
    """A joint rests at either end of a gap."""
    d.base()
    d.arm(hand=(196, 44), kind="ghost")
    d.arm(hand=(184, 98))
    d.arc(112, 52, 62, -6, 32)
    d.parameter(182, 68, "width_j")
    d.text(232, 120, "rests where the weight pulls it", "end")


def link_length_error(d: Drawing) -> None:
    """A link is longer than described."""
    d.base()
    d.arm(hand=(166, 64))
    d.line(166, 64, 206, 73, "accent")
    d.circle(206, 73, 3, "accent dot")
    d.dimension(162, 82, 202, 91, "error_j", (182, 108), "middle")
    d.text(130, 44, "as described")


ARM_SKETCHES = (joint_offset, joint_elasticity, joint_backlash, link_length_error)


# Sketches of effects at the tool: forces on it, its mass, its attachment.


def com_offset(d: Drawing) -> None:
    """The centre of mass beside the tip axis."""
    d.tool()
    d.line(120, 28, 120, 144, "faint")
    d.circle(152, 84, 5, "accent dot")
    d.text(162, 88, "centre of mass")
    d.dimension(120, 102, 152, 102, "mlx / m", (160, 112))


def gravity_tilt(d: Drawing) -> None:
    """Gravity as it is, and as it is assumed, perpendicular to the base."""
    turn = radians(14)
    d.path([(46 + 130 * u * cos(turn), 90 + 130 * u * sin(turn)) for u in (0, 1)])
    d.text(44, 84, "base", "end")
    d.arrow(120, 26, 120, 104)
    d.text(126, 100, "g")
    d.line(120, 26, 120 - 80 * sin(turn), 26 + 80 * cos(turn), "ghost")
    d.text(120, 144, "dashed: perpendicular to the base", "middle")
    d.arc(120, 26, 46, 90, 104)
    d.parameter(128, 62, "angle; tilt_x, tilt_y")


def viscous_drag(d: Drawing) -> None:
    """A force against the velocity, at a point of the tool."""
    _drag(d, "F = −c v")


def quadratic_drag(d: Drawing) -> None:
    """A force against the velocity, growing with its square, at a point of the tool."""
    _drag(d, "F = −c |v| v")


def _drag(d: Drawing, force: str) -> None:
    d.tool()
    d.circle(120, 108, 3, "accent dot")
    d.arrow(134, 108, 200, 108, "ink")
    d.text(204, 112, "v")
    d.arrow(120, 108, 52, 108)
    d.parameter(84, 126, force, "middle")
    d.line(126, 28, 166, 28, "faint")
    d.dimension(158, 28, 158, 106, "d", (164, 72))


def coulomb_friction(d: Drawing) -> None:
    """A torque of constant size against the rotation."""
    d.axes("angular velocity", "torque", centred=True)
    d.path([(32, 40), (116, 40), (120, 112), (210, 112)], "accent")
    d.dimension(62, 40, 62, 76, "level", (68, 62))


def cable_spring(d: Drawing) -> None:
    """A cable between a point of the tool and an anchor in the world, slack below its length."""
    d.tool()
    d.circle(120, 100, 3, "accent dot")
    spring = [(120, 100), (146, 94)]
    spring += [(150 + 8 * i, 94 - 2 * i + (6 if i % 2 else -6)) for i in range(5)]
    d.path([*spring, (190, 84), (214, 78)], "accent")
    d.line(214, 62, 214, 96)
    d.parameter(232, 52, "anchor_x, _y, _z", "end")
    d.parameter(150, 118, "k, length")
    d.line(80, 28, 114, 28, "faint")
    d.dimension(86, 28, 86, 100, "d", (80, 70), "end")


def tip_flexibility(d: Drawing) -> None:
    """The tool turns against a spring and a damper at the sensor."""
    d.tool(kind="ghost")
    d.tool(turn=-20)
    d.arc(120, 28, 62, 70, 90)
    d.text(130, 106, "θ")
    d.arc(120, 34, 16, -50, 110)
    d.parameter(146, 30, "stiffness,")
    d.parameter(146, 44, "damping")


def payload_change(d: Drawing) -> None:
    """A mass that is carried from a time on."""
    d.tool()
    d.box(106, 100, 28, 26, "accent")
    d.parameter(142, 118, "mass")
    d.parameter(142, 134, "from time on")
    d.line(80, 28, 114, 28, "faint")
    d.dimension(86, 28, 86, 112, "d", (80, 76), "end")


def contact_event(d: Drawing) -> None:
    """A wrench that acts during an interval."""
    d.axes("time", "force, torque")
    d.path([(34, 126), (92, 126), (94, 60), (166, 60), (168, 126), (214, 126)], "accent")
    d.parameter(92, 142, "start", "middle")
    d.parameter(168, 142, "end", "middle")
    d.dimension(128, 62, 128, 124, "fcx, ...", (134, 98))


TOOL_SKETCHES = (
    com_offset,
    gravity_tilt,
    viscous_drag,
    quadratic_drag,
    coulomb_friction,
    cable_spring,
    tip_flexibility,
    payload_change,
    contact_event,
)


# Sketches of effects of the sensor: its axes, characteristic, dynamics and bias.


def sensor_rotation(d: Drawing) -> None:
    """The sensor's axes are turned against those that are assumed."""
    for turn, kind in ((0.0, "ghost"), (-22.0, "accent")):
        for quarter in (0.0, -90.0):
            a = radians(turn + quarter)
            d.arrow(96, 112, 96 + 88 * cos(a), 112 + 88 * sin(a), kind)
    d.arc(96, 112, 60, 0, -22)
    d.parameter(164, 104, "angle; roll,")
    d.parameter(164, 130, "pitch, yaw")
    d.text(20, 142, "dashed: axes as assumed")


def sensor_gain(d: Drawing) -> None:
    """The reading is a multiple of the load."""
    d.axes("load", "reading", centred=True)
    d.line(58, 136, 178, 16, "ghost")
    d.line(32, 118, 204, 34, "accent")
    d.text(182, 22, "gain 1")
    d.parameter(150, 112, "slope fy, tau, ...")


def sensor_crosstalk(d: Drawing) -> None:
    """A load in one channel shows in the reading of another."""
    for y, name in ((42, "fx"), (104, "fy")):
        d.text(36, y + 4, f"load {name}", "middle")
        d.arrow(66, y, 170, y, "ink")
        d.text(176, y + 4, f"reading {name}")
    d.arrow(66, 46, 168, 98)
    d.parameter(132, 70, "fy_fx")
    d.text(120, 140, "names: reading, then load", "middle")


def gain_nonlinearity(d: Drawing) -> None:
    """The reading bends away from a straight line."""
    d.axes("load", "reading", centred=True)
    d.line(48, 132, 188, 20, "ghost")

    def bent(x: float) -> float:
        u = (x - 118) / 70
        return 76 - 56 * (u - 0.14 * u**2 - 0.3 * u**3)

    d.curve(bent, 44, 198)
    d.parameter(140, 112, "+ fx_2 · load²")
    d.parameter(140, 126, "+ fx_3 · load³")


def sensor_hysteresis(d: Drawing) -> None:
    """The reading follows the load only after a play."""
    d.axes("load", "reading", centred=True)
    d.path([(54, 122), (92, 122), (190, 30), (152, 30)], "accent", closed=True)
    d.dimension(74, 104, 112, 104, "2 h", (128, 108))
    d.text(232, 138, "h: fx, fy, tau, ...", "end", "parameter")


def sensor_lag(d: Drawing) -> None:
    """After a step of the load the reading follows exponentially."""
    d.axes("time", "reading")
    d.path([(34, 120), (70, 120), (70, 34), (216, 34)], "ghost")
    d.curve(lambda x: 34 + 86 * exp(-(x - 70) / 40), 70, 216)
    d.dimension(70, 66, 110, 66, "time_constant", (116, 76))
    d.text(150, 28, "load")


def time_delay(d: Drawing) -> None:
    """The reading is the load of a moment ago."""
    d.axes("time", "reading")

    def load(x: float) -> float:
        return 74 - 34 * sin(2 * pi * (x - 34) / 120)

    d.curve(load, 34, 210, "ghost")
    d.curve(lambda x: load(x - 18), 52, 214)
    d.dimension(64, 34, 82, 34, "delay", (88, 32))
    d.text(40, 34, "load")


def saturation(d: Drawing) -> None:
    """The reading stops at a level."""
    d.axes("load", "reading", centred=True)
    d.line(178, 26, 200, 8, "ghost")
    d.path([(26, 124), (60, 124), (176, 28), (220, 28)], "accent")
    d.dimension(206, 30, 206, 74, "level", (200, 58), "end")
    d.text(40, 142, "levels fx, fy, tau, ...", "", "parameter")


def bias_drift(d: Drawing) -> None:
    """The bias wanders over the record."""
    d.axes("progress of the record", "bias")
    d.line(34, 92, 214, 92, "ghost")
    d.curve(lambda x: 92 - 34 * sin((x - 34) / 62) - 0.07 * (x - 34), 34, 214)
    d.parameter(92, 40, "fx_1 P₁ + fx_2 P₂ + ...")


def thermal_drift(d: Drawing) -> None:
    """The bias changes with the temperature."""
    d.axes("temperature", "bias")
    d.line(40, 116, 206, 32, "accent")
    d.line(98, 126, 98, 88, "faint")
    d.text(98, 140, "20 °C", "middle")
    d.parameter(150, 88, "slope fx, fy, ...")


def line_interference(d: Drawing) -> None:
    """A sinusoid of a frequency that the motion has not."""
    d.axes("time", "reading")
    d.curve(lambda x: 80 - 26 * sin(2 * pi * (x - 34) / 44), 34, 214)
    d.dimension(45, 44, 89, 44, "1 / frequency", (96, 48))
    d.dimension(133, 54, 133, 80, "fx_sin, fx_cos", (44, 142))


SENSOR_SKETCHES = (
    sensor_rotation,
    sensor_gain,
    sensor_crosstalk,
    gain_nonlinearity,
    sensor_hysteresis,
    sensor_lag,
    time_delay,
    saturation,
    bias_drift,
    thermal_drift,
    line_interference,
)


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


SKETCHES: dict[str, Callable[[Drawing], None]] = {
    draw.__name__: draw for draw in (*TOOL_SKETCHES, *ARM_SKETCHES, *SENSOR_SKETCHES)
}
"""What draws the effect of each id."""


def effect_sketch(effect: Effect) -> str:
    """The sketch as an SVG element with the names of the effect's parameters; empty for an effect that a user wrote."""
    if effect.id not in SKETCHES:
        return ""
    drawing = Drawing()
    SKETCHES[effect.id](drawing)
    return drawing.svg(f"Sketch: {effect.title}")
