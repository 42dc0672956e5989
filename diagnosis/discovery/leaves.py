"""Leaves of the grammar: what the chain and the columns of a recording give, and the parameters that terms are not
linear in, with the ranges in which they are sought."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.discovery.quantities import Quantity
from diagnosis.screening.grid_search import recording_domain
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from modeling import symbolic as sp
from modeling.chain.prediction import VectorFunction
from modeling.formulas.parser import FORMULA_FUNCTIONS, NAME
from modeling.formulas.units import DIMENSIONLESS, Dimension, dimension
from modeling.formulas.vocabulary import is_reserved, signal_units, tip_units
from modeling.space import Space, signals, vector

Array = NDArray[np.float64]

DISTANCE = "d"
"""Parameter: distance (m) of the point from the sensor, along the tip."""
PLACE = ("x_0", "y_0", "z_0")
"""Parameters: a place in the world, m."""
EDGE, WIDTH = "s_0", "w_0"
"""Parameters: the coordinate (m) in the world from which something acts, and the length (m) in which it comes to its
full size."""
SPEED, RATE, TIME, LENGTH = "v_0", "u_0", "t_0", "l_0"
"""Parameters: a speed, m/s, and an angular rate, 1/s, from which on a force changes less; a time constant, s; a length,
m, in which something falls to 1/e."""
SHAPES = {
    **{DISTANCE: "m", **dict.fromkeys(PLACE, "m"), EDGE: "m", WIDTH: "m"},
    **{SPEED: "m/s", RATE: "1/s", TIME: "s", LENGTH: "m"},
}
"""Units of the parameters that terms are not linear in, by name."""
SCALES = (WIDTH, SPEED, RATE, TIME, LENGTH)
"""Those of them that divide, and are positive."""
NARROWEST = 1e-4
"""Of a width (m) or another scale, SI: a step in a tenth of a millimetre is one between any two samples."""
SCALAR_SIZE = 2
"""Complexity of a scalar that is one signal, as of the length of a vector: a joint's angle or a coordinate is one of
more than the vectors of the chain, and no law of a rigid tool knows it."""


@dataclass(frozen=True, eq=False)
class Leaf:
    """A quantity that the chain has: its expressions of the signals, and of the parameters `SHAPES`.

    constants  values and units of other symbols in it, by name
    printed    as it is printed, its name if empty
    size       number of leaves and operations in it, where it is more than one signal or vector
    """

    name: str
    expression: sp.Matrix
    dimension: Dimension
    constants: tuple[tuple[str, float, str], ...] = ()
    printed: str = ""
    size: int = 0

    @cached_property
    def quantity(self) -> Quantity:
        """As a tree of one leaf."""
        vector = len(self.expression) == 3
        size = self.size or (1 if vector else SCALAR_SIZE)
        return Quantity(self.name, (), self.printed or self.name, vector, self.dimension, size)

    @cached_property
    def signals(self) -> frozenset[str]:
        """Names of the recording's signals that it needs."""
        fixed = {name for name, _, _ in self.constants}
        return frozenset(s.name for s in self.expression.free_symbols) - {*SHAPES} - fixed

    @cached_property
    def shapes(self) -> frozenset[str]:
        """Which of the parameters `SHAPES` it depends on."""
        return frozenset(s.name for s in self.expression.free_symbols) & {*SHAPES}

    @cached_property
    def function(self) -> VectorFunction:
        """Its components as a function of the signals and of `SHAPES`."""
        numbers = {signals(name)[0]: value for name, value, _ in self.constants}
        return VectorFunction.of(self.expression.xreplace(numbers), tuple(sorted(self.signals)), signals(*SHAPES))


@lru_cache(maxsize=2)
def chain_leaves(space: Space) -> Mapping[str, Leaf]:
    """What the motion of the sensor gives, by name: vectors in tool axes, and the world's axes.

    v, a     velocity and acceleration of the point, m/s, m/s²
    r        its position from the origin of the world, m; x, y, z its coordinates there
    n        from it to a place in the world, m
    rho      to it from the vertical axis through the origin, m
    over_x, under_x   how far (m) its coordinate is above an edge, or below it, else 0; and so in y and z
    onto_x, into_x    the same in a width, 1 at the most
    falling_x, rising_x   exponentials of its coordinate over l_0 (`exponential_leaves`); and so in y and z
    v_sat, v_drop     v over v_0 + |v|, and v over 1 + (|v| / v_0)²; w_sat, w_drop likewise
    fading   exp(-time / t_0)
    w, al    angular rate and acceleration, rad/s, rad/s²
    up       unit vector opposite to gravity
    e        unit vector along the tip
    turn     rotation matrix from world to tool axes, by rows
    """
    motion, (d, *fixed, edge, width, speed, rate, constant_time, _, time) = space.motion, signals(*SHAPES, "time")
    arm, to_tool, w, al = d * space.tip_axis, motion.rotation.T, motion.omega, motion.alpha
    place = motion.position + motion.rotation * arm
    there = vector(*(x if i < len(space.axes) else sp.S.Zero for i, x in enumerate(fixed)))
    named = {
        "v": (to_tool * motion.velocity + w.cross(arm), "m/s"),
        "a": (to_tool * motion.acceleration + al.cross(arm) + w.cross(w.cross(arm)), "m/s²"),
        "r": (to_tool * motion.position + arm, "m"),
        "w": (w, "1/s"),
        "al": (al, "1/s²"),
        "up": (to_tool * space.up, "1"),
        "e": (space.tip_axis, "1"),
        "turn": (to_tool.reshape(9, 1), "1"),
        "n": (to_tool * (there - place), "m"),
        "rho": (to_tool * (place - place.dot(space.up) * space.up), "m"),
        **{axis: (sp.Matrix([place[i]]), "m") for i, axis in enumerate(space.axes)},
    }
    for name, scale in (("v", speed), ("w", rate)):
        moving, unit = named[name]
        size = sp.sqrt(moving.dot(moving))
        named |= {
            f"{name}_sat": (moving / (scale + size), "1"),
            f"{name}_drop": (moving / (1 + (size / scale) ** 2), unit),
        }
    named |= {"fading": (sp.Matrix([sp.exp(-time / constant_time)]), "1")}
    for coordinate, axis in zip(place, space.axes, strict=False):
        for side, beyond, within in ((1, "over", "onto"), (-1, "under", "into")):
            depth = sp.Max(0, side * (coordinate - edge))
            named |= {f"{beyond}_{axis}": (sp.Matrix([depth]), "m")}
            named |= {f"{within}_{axis}": (sp.Matrix([sp.Min(1, depth / width)]), "1")}
    sizes = {"fading": 3, "v_sat": 4, "w_sat": 4, "v_drop": 5, "w_drop": 5}
    return {name: Leaf(name, e, dimension(unit), size=sizes.get(name, 0)) for name, (e, unit) in named.items()}


def signal_leaf(name: str, unit: str) -> Leaf:
    """A signal of the recording as a scalar."""
    return Leaf(name, sp.Matrix([signals(name)[0]]), dimension(unit, own_units=(unit,)))


def deviation_leaf(name: str, unit: str, values: Array) -> Leaf:
    """A signal of the recording less a round value in the middle of its range: its powers are not all one."""
    middle = _round_middle(values)
    symbol, reference = signals(name, f"{name}_ref")
    dimensions, constants = dimension(unit, own_units=(unit,)), ((reference.name, middle, unit),)
    shown = f"({name} {'+' if middle < 0 else '-'} {abs(middle):.6g})" if middle else name
    return Leaf(f"{name}_dev", sp.Matrix([symbol - reference]), dimensions, constants, shown)


def exponential_leaves(coordinate: Leaf, values: Array) -> Mapping[str, Leaf]:
    """What falls, and what rises, by e in a length, with a coordinate of the point, and is 1 in its middle."""
    (place,), (length, reference) = coordinate.expression, signals(LENGTH, f"{coordinate.name}_ref")
    constants = ((reference.name, _round_middle(values), "m"),)
    return {
        f"{name}_{coordinate.name}": Leaf(
            f"{name}_{coordinate.name}",
            sp.Matrix([sp.exp(side * (place - reference) / length)]),
            DIMENSIONLESS,
            constants,
            size=3,
        )
        for name, side in (("falling", -1), ("rising", 1))
    }


def _round_middle(values: Array) -> float:
    """A round number in the middle of a range."""
    low, high = float(values.min()), float(values.max())
    step = 10.0 ** np.floor(np.log10((high - low) / 2))
    return float(np.round((low + high) / 2 / step) * step)


# ------------------------------------------------------------------------------------- of a recording

TEMPERATURE = "temperature"
AUXILIARY_UNITS = {TEMPERATURE: "K"}
"""Units of columns that formulas may use, by name; any other is taken as it is, in a unit of its own."""
BEYOND = 0.5
"""How far a place may be outside the box of the motion, in its size."""


def recorded_leaves(fitted: Fit, held_out: Sequence[Recording]) -> tuple[dict[str, Leaf], list[str], dict[str, str]]:
    """Leaves of the grammar that all recordings have; which of them are angles; units of other columns."""
    space = fitted.model.space
    several = [*fitted.recordings, *held_out]
    signals = set.intersection(*(set(r.motion.model_signals) for r in several))
    leaves = {name: leaf for name, leaf in chain_leaves(space).items() if leaf.signals <= signals}
    angles = sorted(name for name in signals if re.fullmatch(r"q\d+", name))
    angles += ["phi"] if space is Space.PLANE and "phi" in signals else []
    leaves |= {name: signal_leaf(name, "rad") for name in angles}
    leaves |= {f"d{name}": signal_leaf(f"d{name}", "1/s") for name in angles if f"d{name}" in signals}
    first = fitted.recordings[0].motion.model_signals
    for axis in space.axes:
        if axis in leaves and np.ptp(first[f"p{axis}"]) > 0:
            leaves |= exponential_leaves(leaves[axis], first[f"p{axis}"])
    leaves |= {f"{name}_dev": deviation_leaf(name, "rad", first[name]) for name in angles if np.ptp(first[name]) > 0}
    leaves |= {name: signal_leaf(name, unit) for name, unit in space.channel_units.items()}
    inputs: dict[str, str] = {}
    for name in sorted(set.intersection(*(set(r.auxiliary) for r in several))):
        values = first[name]
        if np.ptp(values) > 0 and re.fullmatch(NAME, name) and not _is_taken(name, leaves):
            inputs[name] = AUXILIARY_UNITS.get(name) or re.sub("[^A-Za-z]", "", name)
            leaves[name] = signal_leaf(name, inputs[name])
            leaves[f"{name}_dev"] = deviation_leaf(name, inputs[name], values)
    return leaves, angles, inputs


def _is_taken(name: str, leaves: Mapping[str, Leaf]) -> bool:
    """Whether a formula of a term cannot name a column so: a name of the grammar, of a signal or of a function."""
    signals = [signal for space in Space for signal in (*signal_units(space), *tip_units(space))]
    steps = [f"{leaf}_{part}" for leaf in leaves for part in (1, 2, 3, "here", "ref", "dev")]
    taken = {*leaves, *steps, *SHAPES, *FORMULA_FUNCTIONS, *signals, "pi", "at"}
    return name in taken or is_reserved(name) or re.fullmatch("[chk](_.*)?|tiny_.*", name) is not None


STEEPEST = 0.1
"""Least length of an exponential, in the size of the tool and its motion."""
FROM_USUAL = (0.2, 3.0)
"""Range of a speed from which on a force levels, in the root mean square of the speed: beyond it the force is one with
a constant size, or with one proportional to the speed."""
SHORTEST_FADING = 0.03
"""Least time constant, in the duration of a recording: faster ones are over after a tenth of it."""


def shape_ranges(fitted: Fit, leaves: Mapping[str, Leaf]) -> dict[str, tuple[float, float]]:
    """Ranges (SI) in which the parameters that terms are not linear in are sought, by name; that of an edge by axis."""
    domain = recording_domain(fitted, 0)
    ranges = {DISTANCE: (0.0, domain.reach)}
    recorded, samples = fitted.recordings[0].motion.model_signals, fitted.recordings[0].samples_per_repeat
    for name, moving in ((SPEED, "v"), (RATE, "w")):
        if moving in leaves:
            values = leaves[moving].function.value(recorded, np.zeros(len(SHAPES)), samples)
            usual = max(float(np.sqrt((values**2).sum(axis=1).mean())), NARROWEST)
            ranges[name] = (FROM_USUAL[0] * usual, FROM_USUAL[1] * usual)
    if "fading" in leaves:
        lasts = float(np.ptp(recorded["time"]))
        ranges[TIME] = (SHORTEST_FADING * lasts, lasts)
    sizes = [high - low + 2 * domain.reach for low, high in zip(domain.low, domain.high, strict=True)]
    ranges |= {LENGTH: (STEEPEST * max(sizes), max(sizes))} if sizes else {}
    for axis, place, low, high in zip("xyz", PLACE, domain.low, domain.high, strict=False):
        low, high = low - domain.reach, high + domain.reach
        ranges |= {
            axis: (low, high),
            WIDTH: (0.0, domain.reach),
            place: (low - BEYOND * (high - low), high + BEYOND * (high - low)),
        }
    return ranges
