"""LaTeX model: the chain of a fitted model as formulas, stage by stage, with its numbers."""

from __future__ import annotations

from collections.abc import Iterator

from modeling import symbolic as sp
from modeling.chain import Chain
from modeling.emit.about_fitted import about_model
from modeling.emit.fitted import FittedModel
from modeling.emit.formula import document, equations, escaped, formula, matrix, matrix_of, name
from modeling.space import Space, signals, vector
from modeling.tip import newton_euler

Pairs = list[tuple[str, str]]
WRENCH = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")


def latex_model(fitted: FittedModel, source: str) -> str:
    """The text of a document; `source` names the project and its version."""
    text = [escaped(paragraph) + "\n" for paragraph in about_model(fitted)]
    for title, pairs in stages(fitted):
        text += [rf"\subsection*{{{escaped(title)}}}", equations(pairs)]
    return document(source, [*text, r"\subsection*{Parameters}", table(fitted)])


def stages(fitted: FittedModel) -> Iterator[tuple[str, Pairs]]:
    """What there is of the stages, in order: a title, and equations (left, right)."""
    chain, model = fitted.model.chain, fitted.model
    if model.definitions:
        yield "Kinematics", [(name(symbol.name), formula(expression)) for symbol, expression in model.definitions]
    yield "Motion of the tool: acceleration less gravity, in the sensor's axes", lifted(chain)
    yield "Wrench of the sensor on the tool (Newton and Euler)", moving(chain)
    if chain.force != sp.zeros(3, 1) or chain.torque != sp.zeros(3, 1):
        pairs = zip(WRENCH, (*chain.force, *chain.torque), strict=True)
        found = [(rf"{{{part}}}^{{\mathrm{{e}}}}", formula(e)) for part, e in pairs if e != 0]
        yield "What acts on the tool besides", found
    if chain.bend is not None:
        yield "Equilibrium of the flexible tip", [("0", formula(e)) for e in chain.equilibrium()]
    yield "Reading before memory and zero", read(chain)
    yield from after(chain)
    if fitted.linear:
        values = sp.Matrix(model.load + model.zero).jacobian([p.symbol for p in fitted.parameters])
        yield "Regressor: y = Phi theta", [(r"\Phi", matrix_of(values))]


def lifted(chain: Chain) -> Pairs:
    """Components of R' (a - g), those that are not zero."""
    motion = chain.motion
    lift = motion.rotation.T * (motion.acceleration - chain.gravity)
    return [(name(f"lift_{axis}"), formula(sp.expand(e))) for axis, e in zip("xyz", lift, strict=True) if e != 0]


def moving(chain: Chain) -> Pairs:
    """The measured components of the tool's wrench, in the components of lift, omega and alpha."""
    motion = chain.motion
    third = 0 if chain.space is Space.PLANE else signals("lift_z")[0]
    lift = vector(*signals("lift_x", "lift_y"), third)
    wrench = sp.Matrix.vstack(*newton_euler(chain.body, lift, motion.omega, motion.alpha))
    return [(WRENCH[row], formula(wrench[row])) for row in chain.space.rows]


def read(chain: Chain) -> Pairs:
    """The channels: gain, signs and mounting times the wrench, then their nonlinearity."""
    environment = zip((*chain.force, *chain.torque), WRENCH, strict=True)
    parts = [p if e == 0 else rf"{p} - {{{p}}}^{{\mathrm{{e}}}}" for e, p in environment]
    rows = chain.space.rows
    turn = sp.diag(chain.mounting, chain.mounting).extract(rows, rows)
    whole = chain.gain * sp.diag(*chain.sign) * turn
    curved = any(e != 0 for e in (*chain.quadratic, *chain.cubic))
    pairs = [(r"\rho" if curved else "r", matrix_of(whole) + matrix([parts[row]] for row in rows))]
    for i, (a, b) in enumerate(zip(chain.quadratic, chain.cubic, strict=True) if curved else (), start=1):
        (rho,) = signals(f"rho_{i}")
        pairs.append((f"r_{i}", formula(rho + a * rho**2 + b * rho**3)))
    return pairs


def after(chain: Chain) -> Iterator[tuple[str, Pairs]]:
    """Play, memory, zero and clipping, as far as they are there."""
    load = "r"
    if chain.play is not None:
        widths = [("w", matrix_of(chain.play))]
        rule = (r"p(t)", r"\max\left(r(t) - w, \min\left(r(t) + w, p(t^-)\right)\right)")
        yield "Play between load and reading", [rule, *widths]
        load = "p"
    if chain.memory != 1:
        yield "Memory", [("H(s)", formula(chain.memory))]
        load = f"H(s) \\, {load}"
    yield "Zero", [(r"y_0", matrix_of(chain.zero))]
    if chain.level is None:
        yield "Reading", [("y", f"{load} + y_0")]
    else:
        clipped = rf"\max\left(-\hat{{y}}, \min\left(\hat{{y}}, {load} + y_0\right)\right)"
        yield "Reading", [("y", clipped), (r"\hat{y}", matrix_of(chain.level))]


def table(fitted: FittedModel) -> str:
    """The numbers of the fit, with their names in formulas and in files."""
    rows = [
        rf"${name(p.name)}$ & \texttt{{{escaped(p.name)}}} & {fitted.values[p.name]!r} & {escaped(p.unit)} \\"
        for p in fitted.model.parameters
    ]
    return "\n".join([r"\begin{longtable}{llll}", *rows, r"\end{longtable}"])
