"""LaTeX target: the rigid tool's regressor, or a fitted model stage by stage with its parameter values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import fields

from modeling import symbolic as sp
from modeling.chain.chain import Chain
from modeling.chain.regressor import regressor_functions
from modeling.codegen.code_target import CodeTarget
from modeling.codegen.expression_text import regressor_documentation, signal_documentation
from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor
from modeling.rigid_body import newton_euler
from modeling.space import Space, signals, vector

DOTS = {"": "{}", "d": r"\dot{{{}}}", "dd": r"\ddot{{{}}}"}
"""Formats of time derivatives."""

LETTERS = {
    "w": r"\omega",
    "omega": r"\omega",
    "al": r"\alpha",
    "alpha": r"\alpha",
    "p": "p",
    "v": "v",
    "vp": "v",
    "a": "a",
    "ap": "a",
    "q": "q",
    "m": "c",
    "I": "I",
    "r": "r",
    "lift": r"\ell",
}
"""Letters of vectors and tensors, indexed by axes: mx, my, mz are the first moment c."""

NAMED_SYMBOLS = {
    "phi": r"\varphi",
    "mlg": "m l_g",
    "mlx": "m l_x",
    "s": "s",
    "m": "m",
    "I": "I",
    "time": "t",
    "tau": r"\tau",
}

JOINT_PATTERN = re.compile(r"(d{0,2})q(\d+)\Z")
COMPONENT_PATTERN = re.compile(rf"({'|'.join(sorted(LETTERS, key=len, reverse=True))})_?([xyz]{{1,2}})\Z")
INTERMEDIATE = re.compile(r"(shared|power|step|t)_?(\d+)\Z")


SPECIAL = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "²": r"\textsuperscript{2}",
    "³": r"\textsuperscript{3}",
    "°": r"\textdegree{}",
}
"""Characters that a backslash alone does not escape."""


def latex_name(symbol: str) -> str:
    """A symbol in usual notation; an upright name where it has no letter."""
    if symbol in NAMED_SYMBOLS:
        return NAMED_SYMBOLS[symbol]
    if symbol in ("dphi", "ddphi"):
        return DOTS[symbol[:-3]].format(r"\varphi")
    if matched := JOINT_PATTERN.match(symbol):
        return f"{DOTS[matched[1]].format('q')}_{{{matched[2]}}}"
    if matched := COMPONENT_PATTERN.match(symbol):
        return f"{LETTERS[matched[1]]}_{{{matched[2]}}}"
    if matched := INTERMEDIATE.match(symbol):
        return f"t_{{{matched[2]}}}"
    if symbol.startswith("rho_"):
        return rf"\rho_{{{symbol.removeprefix('rho_')}}}"
    if symbol.startswith("bias_"):
        return f"b_{{{latex_upright(symbol.removeprefix('bias_'))}}}"
    effect, dot, parameter = symbol.partition(".")
    if dot:
        letter = parameter if len(parameter) == 1 and parameter.isalpha() else latex_upright(parameter)
        return f"{letter}_{{{latex_upright(effect)}}}"
    return latex_upright(symbol)


def latex_upright(text: str) -> str:
    """A name in upright letters; only ASCII letters, digits and underscores are kept."""
    plain = "".join(c for c in text if c.isascii() and (c.isalnum() or c == "_"))
    return r"\mathrm{" + plain.replace("_", r"\_") + "}"


def latex_escaped(text: str) -> str:
    """Text with TeX's special characters escaped."""
    return "".join(SPECIAL.get(c, f"\\{c}" if c in "#$%&_{}" else c) for c in text)


def latex_expression(expression: sp.Expr) -> str:
    """An expression as LaTeX."""
    names = {symbol: latex_name(symbol.name) for symbol in expression.free_symbols}
    return str(sp.latex(expression, symbol_names=names, mul_symbol=r" \, ", inv_trig_style="full"))


def latex_matrix(rows: Iterable[Iterable[str]]) -> str:
    """A matrix of LaTeX entries."""
    body = " \\\\\n".join(" & ".join(row) for row in rows)
    return "\\begin{bmatrix}\n" + body + "\n\\end{bmatrix}"


def latex_matrix_of(values: sp.Matrix) -> str:
    """A matrix of expressions."""
    return latex_matrix([latex_expression(values[i, j]) for j in range(values.cols)] for i in range(values.rows))


def latex_document(source: str, body: Iterable[str]) -> str:
    """A complete document for standard LaTeX; `source` names the project and its version."""
    return "\n".join(
        [
            f"% Written by {source}.",
            r"\documentclass[a4paper]{article}",
            r"\usepackage[T1]{fontenc}",
            r"\usepackage{amsmath,longtable}",
            r"\usepackage[landscape,margin=15mm]{geometry}",
            r"\setcounter{MaxMatrixCols}{20}",
            r"\allowdisplaybreaks",
            r"\begin{document}",
            *body,
            r"\end{document}",
            "",
        ]
    )


def latex_equations(pairs: Iterable[tuple[str, str]]) -> str:
    """Equations `left = right`, one a line, aligned."""
    return "\\begin{align}\n" + " \\\\\n".join(f"{left} &= {right}" for left, right in pairs) + "\n\\end{align}"


LatexEquations = list[tuple[str, str]]
WRENCH_SYMBOLS = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")


class LatexTarget(CodeTarget):
    """A document for standard LaTeX."""

    name = "latex"
    suffix = ".tex"
    sampled = False

    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        """A document: frames, parameters and equations."""
        text = [latex_escaped(paragraph) + "\n" for paragraph in regressor_documentation(base)]
        theta = [latex_name(p.name) for p in base.parameters]
        parameters = latex_equations([(r"\theta", latex_matrix([theta]) + r"^\top")])
        body = planar_equations(base) if base.space is Space.PLANE else spatial_equations(base)
        return latex_document(source, [*text, parameters, body])

    def model(self, fitted: FittedModel, source: str) -> str:
        """A document: every stage, and the parameters."""
        text = [latex_escaped(paragraph) + "\n" for paragraph in signal_documentation(fitted)]
        for title, pairs in stage_equations(fitted):
            text += [rf"\subsection*{{{latex_escaped(title)}}}", latex_equations(pairs)]
        return latex_document(source, [*text, r"\subsection*{Parameters}", parameter_table(fitted)])


def stage_equations(fitted: FittedModel) -> Iterator[tuple[str, LatexEquations]]:
    """The stages that the model has, in order: a title, and equations (left, right)."""
    chain, model = fitted.model.chain, fitted.model
    if model.definitions:
        yield (
            "Kinematics",
            [(latex_name(symbol.name), latex_expression(expression)) for symbol, expression in model.definitions],
        )
    yield "Motion of the tool: acceleration minus gravity, in the axes of the logged pose", lift_equations(chain)
    yield "Wrench of the sensor on the tool (Newton and Euler)", newton_euler_equations(chain)
    if chain.force != sp.zeros(3, 1) or chain.torque != sp.zeros(3, 1):
        pairs = zip(WRENCH_SYMBOLS, (*chain.force, *chain.torque), strict=True)
        equations = [(rf"{{{symbol}}}^{{\mathrm{{e}}}}", latex_expression(e)) for symbol, e in pairs if e != 0]
        yield "Environment's forces and torques on the tool", equations
    if chain.deflection is not None:
        yield "Equation of motion of the deflection", [("0", latex_expression(e)) for e in chain.equilibrium()]
    yield from sensor_equations(chain)
    if fitted.linear:
        values = sp.Matrix(model.load + model.bias).jacobian([p.symbol for p in fitted.parameters])
        yield "Regressor: y = Phi theta", [(r"\Phi", latex_matrix_of(values))]


def lift_equations(chain: Chain) -> LatexEquations:
    """The nonzero components of R' (a - g)."""
    motion = chain.motion
    lift = motion.rotation.T * (motion.acceleration - chain.gravity)
    return [
        (latex_name(f"lift_{axis}"), latex_expression(sp.expand(e)))
        for axis, e in zip("xyz", lift, strict=True)
        if e != 0
    ]


def newton_euler_equations(chain: Chain) -> LatexEquations:
    """The measured components of the tool's wrench, in the components of lift, omega and alpha."""
    motion = chain.motion
    third = 0 if chain.space is Space.PLANE else signals("lift_z")[0]
    lift = vector(*signals("lift_x", "lift_y"), third)
    wrench = sp.Matrix.vstack(*newton_euler(chain.body, lift, motion.omega, motion.alpha))
    return [(WRENCH_SYMBOLS[row], latex_expression(wrench[row])) for row in chain.space.rows]


def sensor_equations(chain: Chain) -> Iterator[tuple[str, LatexEquations]]:
    """The stages from the true wrench to the reading, in order."""
    environment = zip((*chain.force, *chain.torque), WRENCH_SYMBOLS, strict=True)
    parts = [p if e == 0 else rf"{p} - {{{p}}}^{{\mathrm{{e}}}}" for e, p in environment]
    reading = latex_matrix([parts[row]] for row in chain.space.rows)
    for stage in chain.stages:
        formula = stage.formula(reading)
        reading = formula.output
        yield formula.title, [(left, _right(right)) for left, right in formula.equations]
    yield "Reading", [("y", reading)]


def _right(value: str | sp.Expr | sp.Matrix) -> str:
    if isinstance(value, str):
        return value
    return latex_matrix_of(value) if isinstance(value, sp.MatrixBase) else latex_expression(value)


def parameter_table(fitted: FittedModel) -> str:
    """The estimated parameters: symbol, name in files, value and unit."""
    rows = [
        rf"${latex_name(p.name)}$ & \texttt{{{latex_escaped(p.name)}}} & {fitted.values[p.name]!r} & "
        rf"{latex_escaped(p.unit)} \\"
        for p in fitted.model.parameters
    ]
    return "\n".join([r"\begin{longtable}{llll}", *rows, r"\end{longtable}"])


def planar_equations(base: RigidToolRegressor) -> str:
    """The functions M1 .. M4 (22.9), and the regressor composed of them (22.8); title in rigid_tool_regressor."""
    functions = regressor_functions(base.model)
    named = {getattr(functions, field.name): f"M_{field.name[1:]}" for field in fields(functions)}
    pairs = [(symbol, latex_expression(expression)) for expression, symbol in named.items()]
    rows = [
        [named.get(entry, latex_expression(entry)) for entry in base.matrix.row(i)] for i in range(base.matrix.rows)
    ]
    return latex_equations([*pairs, (r"\Phi", latex_matrix(rows))])


def spatial_equations(base: RigidToolRegressor) -> str:
    """The regressor in blocks of columns: biases, mass and first moment, inertia."""
    biases, moments = len(base.model.biases), 4
    blocks = {
        "E": base.matrix[:, :biases],
        r"\Phi_1": base.matrix[:, biases : biases + moments],
        r"\Phi_2": base.matrix[:, biases + moments :],
    }
    whole = latex_matrix([list(blocks)])
    return latex_equations([(r"\Phi", whole), *((left, latex_matrix_of(block)) for left, block in blocks.items())])
