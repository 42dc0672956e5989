"""Expressions in the syntax shared by C and Python, by SymPy's code printer."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache, reduce
from math import isfinite
from textwrap import wrap
from typing import Any, NamedTuple

from modeling import symbolic as sp
from modeling.chain.model import ALIGNED_MOUNTING
from modeling.chain.sensor_axes import is_turned, sensor_to_pose, turn_words
from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor, has_memory
from modeling.compiled.straight_line_program import StraightLineProgram
from modeling.errors import InputError
from modeling.kinematics.placement import base_angle, base_placement
from modeling.parameter import Parameter
from modeling.rig import Convention
from modeling.space import Space

FUNCTION_NAMES = {"Abs": "fabs", "Max": "fmax", "Min": "fmin", "Heaviside": "step"}
"""SymPy's functions whose name in generated code is another one: C's, where C has it."""
FUNCTIONS = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "sign"),
    *FUNCTION_NAMES,
)
"""SymPy's functions that generated code has."""


@cache
def _printer_class() -> type[Any]:
    """SymPy's code printer, adapted where its text would cost more operations or lose digits; loaded when needed."""
    from sympy.printing.codeprinter import CodePrinter
    from sympy.printing.precedence import PRECEDENCE

    class ExpressionPrinter(CodePrinter):  # type: ignore[misc]
        """Numbers as the shortest text that reads back the same, integer powers as products, pairwise fmax and fmin.

        names      of the symbols
        functions  formats by name, for functions that are not called as in C
        """

        def __init__(self, names: Mapping[sp.Symbol, str], functions: Mapping[str, str]) -> None:
            super().__init__({"order": "none"})
            self.names, self.functions = names, functions

        def _print(self, expr: sp.Basic, **options: Any) -> str:
            return _number_text(float(expr)) if expr.is_number else super()._print(expr, **options)

        def _print_Symbol(self, expr: sp.Symbol) -> str:  # noqa: N802
            return self.names[expr]

        def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:  # noqa: N802
            base, exponent = expr.args
            if exponent.is_Rational and exponent.is_negative:
                return f"1.0/{self.parenthesize(1 / expr, PRECEDENCE['Pow'])}"
            if exponent.is_Integer:
                return "(" + "*".join([self.parenthesize(base, PRECEDENCE["Pow"])] * int(exponent)) + ")"
            return self._call("sqrt", base) if exponent == sp.S.Half else self._call("pow", base, exponent)

        def _print_Function(self, expr: sp.Expr) -> str:  # noqa: N802
            name = type(expr).__name__
            if name == "DiracDelta":
                return "0.0"  # the derivative of a step: zero everywhere but at the step
            if name not in FUNCTIONS:
                what = f"the function {name} has no counterpart in generated code"
                raise InputError(what=what, where="emit", remedy="leave the effect out")
            return self._call(FUNCTION_NAMES.get(name, name), *expr.args[: 1 if name == "Heaviside" else None])

        _print_Max = _print_Min = _print_sign = _print_Function  # noqa: N815

        def _call(self, name: str, *arguments: sp.Expr) -> str:
            texts = [self._print(argument) for argument in arguments]
            if name in ("fmax", "fmin"):
                return reduce(self.functions.get(name, name + "({}, {})").format, texts)
            pattern = self.functions.get(name)
            return f"{name}({', '.join(texts)})" if pattern is None else pattern.format(*texts)

    return ExpressionPrinter


def _number_text(value: float) -> str:
    """The shortest decimal text that reads back as the same number; InputError when it is not finite."""
    if not isfinite(value):
        raise InputError(what="a constant that is not finite", where="emit", remedy="leave the effect out")
    return repr(value)


class Assignment(NamedTuple):
    """A variable and the text of its value."""

    name: str
    text: str


def assignments_of(
    program: StraightLineProgram, names: Mapping[sp.Symbol, str], functions: Mapping[str, str]
) -> tuple[list[Assignment], list[str]]:
    """The assignments of a program, to t0, t1, .. in order, and the texts of its results."""
    steps = {symbol: f"t{number}" for number, (symbol, _) in enumerate(program.steps)}
    printed = _printer_class()({**names, **steps}, functions)._print
    lines = [Assignment(steps[symbol], printed(expression)) for symbol, expression in program.steps]
    return lines, [printed(result) for result in program.results]


def identifiers(names: Iterable[str], prefix: str) -> list[str]:
    """A distinct identifier, valid in every target, for each name: the prefix, then letters, digits, underscores."""
    distinct: list[str] = []
    for name in names:
        plain = prefix + "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
        while plain in distinct:
            plain += "_"
        distinct.append(plain)
    return distinct


def comment_text(text: str) -> str:
    """Text in one ASCII line that cannot end a comment or a string of any target, nor form a trigraph."""
    line = " ".join(text.split()).replace("\\", "/").replace('"', "'")
    plain = "".join(c if c.isascii() and c.isprintable() else ASCII_REPLACEMENTS.get(c, "?") for c in line)
    return re.sub(r"\?(?=\?)|\*(?=/)|/(?=\*)", r"\g<0> ", plain)


ASCII_REPLACEMENTS = {"²": "2", "³": "3", "°": "deg ", "·": " ", "⁴": "4", "–": "-", "×": "x", "±": "+-"}
"""Replacements, in comments, of characters outside ASCII."""


# Frames, signs, units and dynamics, as comments of generated code: paragraphs of plain text.


COMMENT_WIDTH = 100
"""Characters in a line of comment."""

PLANAR_FRAMES = (
    "World: x right, y up, gravity (0, -9.806) m/s2. phi (rad) is the angle of the tip, clockwise from +y; (ax, ay)"
    " the acceleration of the sensor origin in the world (m/s2), gravity excluded; dphi, ddphi in rad/s, rad/s2.",
    "Signs of equation 22.8 of 'Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators'"
    " (Bassi et al., chapter 22): the wrench that the sensor exerts on the tool, in the axes x' = (cos phi, -sin phi)"
    " and -y', y' = (sin phi, cos phi) along the tip, torque clockwise about the sensor origin.",
)
SPATIAL_FRAMES = (
    "All vectors in the sensor frame: a is the acceleration of the sensor origin minus gravity (m/s2), omega the"
    " angular velocity (rad/s), alpha the angular acceleration (rad/s2).",
    "Convention on_tool: the wrench that the sensor exerts on the tool, F = m a + .., torque about the sensor origin.",
)


def regressor_documentation(base: RigidToolRegressor) -> list[str]:
    """Frames, signs, units and the order of inputs, rows and columns of a regressor, one paragraph each."""
    title = "planar" if base.space is Space.PLANE else "six-axis"
    return [
        f"Regressor of the {title} rigid tool on a wrist force/torque sensor: reading = regressor * parameters.",
        *(PLANAR_FRAMES if base.space is Space.PLANE else SPATIAL_FRAMES),
        f"Inputs in order: {', '.join(base.inputs)}.",
        f"Rows: {with_units(zip(base.space.channels, base.space.units, strict=True))}.",
        f"Columns: {with_units((p.name, p.unit) for p in base.parameters)}; inertia about the sensor origin.",
    ]


def with_units(pairs: Iterable[tuple[str, str]]) -> str:
    """Names with their units in parentheses."""
    return ", ".join(f"{name} ({unit})" for name, unit in pairs)


def parameter_comment(parameter: Parameter) -> str:
    """A parameter's name and unit."""
    return comment_text(f"{parameter.name}, {parameter.unit}" if parameter.unit != "1" else parameter.name)


def paragraphs(texts: Iterable[str], width: int = COMMENT_WIDTH) -> list[str]:
    """Paragraphs as wrapped lines with an empty one between them, safe within a comment."""
    lines: list[str] = []
    for text in texts:
        lines += ["", *wrap(comment_text(text), width, break_long_words=False, break_on_hyphens=False)]
    return lines[1:]


PLANAR_SIGNALS = (
    "Motion: world x right, y up; phi (rad) the angle of the tip, clockwise from +y, dphi, ddphi its rates; (px, py),"
    " (vx, vy), (ax, ay) position, velocity and acceleration of the sensor origin in the world (m, m/s, m/s2), gravity"
    " excluded. Wrench: axes x' = (cos phi, -sin phi), -y' against y' = (sin phi, cos phi) along the tip, torque"
    " clockwise about the sensor origin."
)
SPATIAL_SIGNALS = (
    "Motion: world z up; (qx, qy, qz, qw) the unit quaternion of the sensor in the world, v_world = R(q) v_sensor;"
    " (wx, wy, wz), (alx, aly, alz) angular velocity and acceleration in the sensor frame (rad/s, rad/s2);"
    " (px, py, pz), (vpx, vpy, vpz), (apx, apy, apz) position, velocity and acceleration of the sensor origin"
    " in the world (m, m/s, m/s2), gravity excluded. Wrench: forces and torques about the sensor origin in its frame."
)
JOINT_SIGNALS = (
    "q1 .., dq1 .., ddq1 .. are joint coordinates and their derivatives (rad, rad/s, rad/s2; m if prismatic)."
)


def model_documentation(fitted: FittedModel) -> list[str]:
    """The model, its signals, signs and dynamics."""
    without = "There is no derivative in the parameters: the tool deflects, or the derivative would be too long."
    return (
        signal_documentation(fitted)
        + dynamics_documentation(fitted)
        + ([without] if fitted.sensitivity is None else [])
    )


def signal_documentation(fitted: FittedModel) -> list[str]:
    """The model, its signals and signs."""
    model = fitted.model
    title = "planar" if model.space is Space.PLANE else "six-axis"
    effects = ", ".join(f"{e.id} ({e.title})" for e in model.effects) or "none"
    notes = [
        f"Fitted model of the tool on a {title} wrist force/torque sensor. Effects beyond the rigid tool: {effects}.",
        PLANAR_SIGNALS if model.space is Space.PLANE else SPATIAL_SIGNALS,
        *_base_documentation(fitted),
        *_turn_documentation(fitted),
        *([JOINT_SIGNALS] if "q1" in fitted.inputs else []),
        f"Signals u in order: {', '.join(fitted.inputs)}. No other signals are needed.",
        f"Readings: {with_units(zip(model.channels, model.space.units, strict=True))}. {_signs(fitted)}",
        _contact(fitted),
    ]
    if fitted.dropped:
        notes.append(f"Not included, since specific to the recording of the fit: {', '.join(fitted.dropped)}.")
    return notes


def _base_documentation(fitted: FittedModel) -> list[str]:
    """How motion in base axes becomes that of the signals, where the base does not stand upright."""
    direction = fitted.model.gravity_direction
    if direction is None:
        return []
    along = f"Gravity points along ({', '.join(f'{c:.9g}' for c in direction)}) of the base. The world is the base"
    if len(direction) == 2:
        return [f"{along} turned clockwise by {base_angle(direction):.9g} rad: add it to phi, and turn vectors by it."]
    quaternion = ", ".join(f"{c:.9g}" for c in base_placement(direction).quaternion)
    return [f"{along} turned by the quaternion ({quaternion}), x y z w: v_world = R v_base. Turn the motion by it."]


def _turn_documentation(fitted: FittedModel) -> list[str]:
    """Which vectors are along which axes, where the sensor is turned against the pose of the motion."""
    if not is_turned(fitted.model):
        return []
    words = turn_words(sensor_to_pose(fitted.model, fitted.theta))
    return [
        f"The sensor is turned by {words} against the axes of the logged pose: those of the orientation, of omega and"
        " alpha, and of first moment and inertia. Readings, biases and contact are in sensor axes."
    ]


def _signs(fitted: FittedModel) -> str:
    model = fitted.model
    on_tool = model.convention is not Convention.ON_SENSOR
    sign = (
        "on_tool: the wrench of the sensor on the tool"
        if on_tool
        else "on_sensor: the wrench of the tool on the sensor"
    )
    fixed = [f"gravity {model.gravity} m/s2", f"convention {sign}"]
    if model.mirror_y:
        fixed.append("fy with opposite sign (mirror_y)")
    if model.mounting != ALIGNED_MOUNTING:
        rows = "; ".join(" ".join(map(str, row)) for row in model.mounting)
        fixed.append(f"axes of the readings rotated by the matrix [{rows}]")
    return f"Fixed in the code: {', '.join(fixed)}."


def _contact(fitted: FittedModel) -> str:
    where = (
        "along x' and y' and clockwise about the sensor, whatever the readings' signs"
        if fitted.model.space is Space.PLANE
        else "in sensor axes, about the sensor origin, whatever the readings' signs"
    )
    return (
        f"Contact: the wrench of the environment on the tool, {', '.join(fitted.components)}, {where}:"
        " inverse contact gain * (reading - prediction). The bias of the readings is that of the fit."
    )


def dynamics_documentation(fitted: FittedModel) -> list[str]:
    """The model's dynamics; nothing for a model without memory."""
    notes = []
    if fitted.dt is not None and has_memory(fitted.model):
        notes.append(
            f"The model has memory. The code is for {1 / fitted.dt:.9g} samples per second without gaps; its initial"
            " state is the steady state under the first sample."
        )
    if fitted.model.chain.deflection is not None:
        notes.append(
            "The tool is mounted on a rotational spring and damper. Its deflection is solved at every sample by a fixed"
            " number of steps of Newton's method; its forcing is linear between samples (first-order hold). It starts"
            " from the static equilibrium of the first sample."
        )
    for where, fixed in (("model", True), ("discretisation", False)):
        parameters = [p for p in fitted.fixed_parameters if p.fixed is fixed]
        if parameters:
            values = ", ".join(f"{p.name} = {fitted.values[p.name]!r} {p.unit}" for p in parameters)
            notes.append(f"Fixed in the {where}: {values}.")
    if fitted.program.latency:
        notes.append(
            f"Readings lead the motion, or lag it by less than one sample: outputs belong to the sample of"
            f" {fitted.program.latency} samples ago."
        )
    return notes + [note for stage in fitted.model.chain.dynamics for note in stage.notes()]


def derivative_documentation(fitted: FittedModel, layout: str) -> str:
    """The derivative and its memory layout."""
    if fitted.linear:
        return f"Regressor {layout}: reading = regressor * parameters, in their order."
    return f"Derivative {layout}, of load + bias of one sample in the parameters, in their order."
