"""The emitted regressors of the base models: against 22.8 typed in, against Pinocchio, and as files to live with."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.codegen.code_target import CodeTarget, code_target, target_names
from modeling.codegen.fitted_model import RigidToolRegressor
from modeling.compiled.straight_line_program import OperationCount, StraightLineProgram
from modeling.space import Space
from tests.shared.emitted import Library, balanced, module, pointer
from truewrench.command_line import main
from truewrench.emitted import BASES, GeneratedCode

Array = NDArray[np.float64]

SPACES = pytest.mark.parametrize("space", list(Space), ids=lambda s: str(s.name))
NAMES = {Space.PLANE: "planar", Space.SPACE: "spatial"}
LAST_BITS = 1e-12
"""Relative to the largest term of an element: a dozen roundings, and two libraries' sines."""
EDGES = np.array([0.0, -0.0, 5e-324, 1e-310, np.pi, -np.pi, 2 * np.pi, 100 * np.pi, np.pi / 2, 1e8, -1e8])


@cache
def code(space: Space, language: CodeTarget) -> GeneratedCode:
    return GeneratedCode.of_base(RigidToolRegressor(space), language, "truewrench test")


@cache
def library(space: Space) -> Library:
    return Library(code(space, code_target("c")).text)


def inputs(space: Space, count: int = 300) -> Array:
    """Random inputs of a robot's size, then every edge alone and in random company, (N, m)."""
    rng, width = np.random.default_rng(0), 5 if space is Space.PLANE else 9
    alone = np.concatenate([value * np.eye(width) for value in EDGES])
    return np.concatenate([rng.normal(0, 5, (count, width)), alone, rng.choice(EDGES, (count, width))])


def by_numpy(space: Space, u: Array) -> Array:
    emitted = module(code(space, code_target("numpy")).text)
    parts = u.T if space is Space.PLANE else (u[:, :3], u[:, 3:6], u[:, 6:])
    return np.asarray(emitted.regressor(*parts))


def by_c(space: Space, u: Array) -> Array:
    shape = (3, 6) if space is Space.PLANE else (6, 16)
    return np.stack([library(space).matrix("regressor", row, shape) for row in u])


# ----------------------------------------------------------------------------------------- the equations


@pytest.mark.parametrize("emitted", [by_numpy, by_c])
def test_planar_regressor_is_22_8(emitted) -> None:  # type: ignore[no-untyped-def]
    u = inputs(Space.PLANE)
    ax, ay, phi, dphi, ddphi = u.T
    m1 = ax * np.cos(phi) - (ay + 9.806) * np.sin(phi)
    m3 = -(ax * np.sin(phi) + (ay + 9.806) * np.cos(phi))
    one, zero = np.ones_like(phi), np.zeros_like(phi)
    expected = np.array(
        [
            [one, zero, zero, m1, ddphi, zero],
            [zero, one, zero, m3, dphi**2, zero],
            [zero, zero, one, zero, m1, ddphi],
        ]
    ).transpose(2, 0, 1)
    size = 10 + np.abs(ax) + np.abs(ay) + dphi**2 + np.abs(ddphi)
    assert (np.abs(emitted(Space.PLANE, u) - expected) <= LAST_BITS * size[:, None, None]).all()


@pytest.mark.parametrize("emitted", [by_numpy, by_c])
def test_spatial_regressor_is_pinocchios(emitted) -> None:  # type: ignore[no-untyped-def]
    """Its velocity is zero at the instant, so that its spatial acceleration is the classical one."""
    import pinocchio  # slow to import

    order = ["m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"]
    columns = [list(PARAMETERS).index(name) for name in order]
    u = inputs(Space.SPACE)[:300]
    found = emitted(Space.SPACE, u)
    for row, phi in zip(u, found, strict=True):
        still, rate = pinocchio.Motion(np.zeros(3), row[3:6]), pinocchio.Motion(row[:3], row[6:])
        np.testing.assert_allclose(phi[:, columns], pinocchio.bodyRegressor(still, rate), rtol=0, atol=1e-10)
    np.testing.assert_array_equal(found[:, :, :6], np.broadcast_to(np.eye(6), (len(u), 6, 6)))


BIASES = tuple(f"bias_{c}" for c in ("fx", "fy", "fz", "tx", "ty", "tz"))
PARAMETERS = (*BIASES, "m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")


def test_spatial_regressor_is_the_models_in_any_orientation() -> None:
    """The model takes the quaternion and the kinematic acceleration, the emitted regressor R'(a - g)."""
    rng = np.random.default_rng(1)
    turn, u = Rotation.random(200, rng=rng), inputs(Space.SPACE)[:200]
    world = turn.apply(u[:, :3]) - [0, 0, 9.806]
    names = ["qx", "qy", "qz", "qw", "apx", "apy", "apz", "wx", "wy", "wz", "alx", "aly", "alz"]
    series = dict(zip(names, (*turn.as_quat().T, *world.T, *u[:, 3:].T), strict=True))
    expected = compiled_prediction(WrenchModel(space=Space.SPACE)).load.tangent(series, np.ones(16), 200)[1]
    expected[:, :, :6] = np.eye(6)
    np.testing.assert_allclose(by_numpy(Space.SPACE, u), expected, atol=1e-10)  # rounding of terms up to 500


@SPACES
def test_c_numpy_and_casadi_agree(space: Space) -> None:
    u = inputs(space)
    size = 10 + np.max(np.abs(u), axis=1) + np.max(np.abs(u), axis=1) ** 2
    read_back = ca.Function.deserialize(code(space, code_target("casadi")).text)
    widths = [1] * 5 if space is Space.PLANE else [3] * 3
    arguments = np.split(u.T, np.cumsum(widths)[:-1])
    graph = read_back.map(len(u))(*arguments).full()
    graph = graph.reshape(graph.shape[0], len(u), -1).transpose(1, 0, 2)
    for other in (by_c(space, u), graph):
        assert (np.abs(by_numpy(space, u) - other) <= LAST_BITS * size[:, None, None]).all()


# ------------------------------------------------------------------------------------------ the NumPy module


def test_planar_module_takes_numbers_arrays_and_nothing() -> None:
    emitted = module(code(Space.PLANE, code_target("numpy")).text)
    assert emitted.PARAMETERS == ("bias_fx", "bias_fy", "bias_tau", "m", "mlg", "I")
    assert emitted.CHANNELS == ("fx", "fy", "tau")
    assert emitted.regressor(0, 0, 1, 2, 3).shape == (1, 3, 6)
    assert emitted.regressor(*[[0.5]] * 5).shape == (1, 3, 6)
    assert emitted.regressor(*[np.zeros(0)] * 5).shape == (0, 3, 6)
    mixed = emitted.regressor(0.0, [1, 2, 3], 0.2, np.array(4), np.array([5]))
    for i, ay in enumerate((1, 2, 3)):
        np.testing.assert_array_equal(mixed[i], emitted.regressor(0, ay, 0.2, 4, 5)[0])
    with pytest.raises(ValueError, match="broadcast"):
        emitted.regressor([1, 2], [1, 2, 3], 0, 0, 0)
    theta = np.arange(6.0)
    np.testing.assert_allclose(emitted.prediction(theta, 0, [1, 2], 0.2, 4, 5), mixed[:2] @ theta)


def test_spatial_module_takes_vectors_and_arrays_of_them() -> None:
    emitted = module(code(Space.SPACE, code_target("numpy")).text)
    assert emitted.PARAMETERS == PARAMETERS
    u = inputs(Space.SPACE)[:4]
    whole = emitted.regressor(u[:, :3], u[:, 3:6], u[:, 6:])
    assert emitted.regressor(*u[0].reshape(3, 3)).shape == (1, 6, 16)
    np.testing.assert_array_equal(emitted.regressor(*u[0].reshape(3, 3))[0], whole[0])
    np.testing.assert_array_equal(emitted.regressor(u[:, :3], u[0, 3:6], u[0, 6:])[0], whole[0])
    assert emitted.regressor(*[np.zeros((0, 3))] * 3).shape == (0, 6, 16)
    with pytest.raises(ValueError, match="three components"):
        emitted.regressor(np.zeros((3, 2)), np.zeros(3), np.zeros(3))


PROBE = """
import sys
from pathlib import Path
import numpy
before = set(sys.modules)
names = {}
exec(compile(Path(sys.argv[1]).read_text(), "emitted", "exec"), names)
assert names["regressor"](*[[0.1, 0.2, 0.3]] * int(sys.argv[2])).size
strange = {m.partition(".")[0] for m in set(sys.modules) - before} - set(sys.stdlib_module_names) - {"numpy"}
sys.exit(str(strange) if strange else 0)
"""


@SPACES
def test_module_needs_numpy_alone(space: Space, tmp_path: Path) -> None:
    path = tmp_path / "code.py"
    path.write_text(code(space, code_target("numpy")).text)
    command = [sys.executable, "-W", "error", "-c", PROBE, str(path), "5" if space is Space.PLANE else "3"]
    done = subprocess.run(command, cwd=tmp_path, env={"PATH": ""}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# --------------------------------------------------------------------------------------------- the C file


@SPACES
def test_c_file_allocates_nothing_and_takes_no_more_than_sine_and_cosine(space: Space) -> None:
    assert not re.search(r"malloc|calloc|realloc|free|alloca|static|\[[a-z]", body_of(library(space).text))
    assert library(space).undefined <= ({"sin", "cos", "sincos"} if space is Space.PLANE else set())
    assert ("math.h" in library(space).text) == (space is Space.PLANE)


def body_of(text: str) -> str:
    """C without its comments."""
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def test_input_and_output_may_overlap() -> None:
    u = inputs(Space.PLANE)[0]
    buffer = np.zeros(18)
    buffer[:5] = u
    function = library(Space.PLANE).functions.truewrench_regressor
    function(pointer(buffer), pointer(buffer))
    np.testing.assert_array_equal(buffer.reshape(3, 6), by_c(Space.PLANE, u[None])[0])


# -------------------------------------------------------------------------------------- what it takes, and says


@SPACES
def test_operations_are_those_in_the_text(space: Space) -> None:
    """Python's own parser counts the operators and the calls of NumPy's functions in the emitted module."""
    tree = ast.parse(code(space, code_target("numpy")).text)
    function = next(n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "regressor")
    start = next(i for i, n in enumerate(function.body) if ast.unparse(n).startswith("Phi = np.zeros"))
    nodes = [n for statement in function.body[start + 1 :] for n in ast.walk(statement)]
    kinds = [type(n.op) for n in nodes if isinstance(n, ast.BinOp)]
    calls = sum(isinstance(n, ast.Call) for n in nodes)
    counted = OperationCount(
        sums=kinds.count(ast.Add) + kinds.count(ast.Sub),
        products=kinds.count(ast.Mult),
        quotients=kinds.count(ast.Div),
        calls=calls,
    )
    ((_, shared, unshared),) = code(space, code_target("numpy")).costs
    assert counted == shared
    assert shared.total < unshared.total


X, Y, Z = sp.symbols("x y z", real=True)


@pytest.mark.parametrize(
    "expression",
    [
        (X + Y) ** 2 + 1 / (X + Y) ** 3,
        X**17 - X**8 / 3,
        (X - Y) ** sp.Rational(-3, 2) + sp.sqrt(X - Y + 9),
        sp.sin(X + Y) * sp.Max(X, Y, Z) ** 5 / sp.exp(-X),
        -X - Y - Z,
        -(X * Y) / (-Z * 7),
        sp.atan2(Y, X) - sp.Abs(X - 3) + sp.tanh(Y) ** 2 * sp.sign(Z - 5),
        sp.Heaviside(X - Y) * sp.Min(X, 2) + 2**X + sp.Rational(1, 3) * sp.pi,
    ],
    ids=str,
)
def test_programs_are_the_expression_and_powers_are_products(expression: sp.Expr) -> None:
    """Evaluated step by step by SymPy, against the expression at once."""
    program = StraightLineProgram.of([expression, expression + X]).shared
    values = {X: sp.Float(5.25, 30), Y: sp.Float(2.5, 30), Z: sp.Float(-1.75, 30)}
    expected = [expression.evalf(25, subs=values), (expression + X).evalf(25, subs=values)]
    for symbol, step in program.steps:
        values[symbol] = step.evalf(30, subs=values)
    for result, value in zip(program.results, expected, strict=True):
        assert abs(result.evalf(30, subs=values) - value) < 1e-20 * max(1, abs(value))
    powers = {p for e in (*(e for _, e in program.steps), *program.results) for p in e.atoms(sp.Pow)}
    assert all(p.base.is_Atom and abs(p.exp) <= 3 for p in powers if p.exp.is_Integer and abs(p.exp) > 1)
    assert program.operations.total <= StraightLineProgram.of([expression, expression + X]).operations_unshared.total


@SPACES
def test_formulas_are_balanced_and_show_the_matrix(space: Space) -> None:
    text = code(space, code_target("latex")).text
    assert balanced(text)
    if space is Space.PLANE:
        assert "1 & 0 & 0 & M_1 & M_2 & 0 \\\\\n0 & 1 & 0 & M_3 & M_4 & 0 \\\\\n0 & 0 & 1 & 0 & M_1 & M_2" in text
        for line in (r"M_2 &= \ddot{\varphi} \\", r"M_4 &= \dot{\varphi}^{2} \\"):
            assert line in text
    else:
        assert r"\Phi_2 &= \begin{bmatrix}" in text


@pytest.mark.parametrize("broken", ["{", "}", r"\begin{a}{", r"\begin{a}\end{b}", r"\left(", r"{\right)}"])
def test_the_balance_is_no_formality(broken: str) -> None:
    assert not balanced(broken)


HASHED = """
from modeling.codegen.fitted_model import RigidToolRegressor
from modeling.codegen.code_target import CodeTarget, code_target, target_names
from truewrench.emitted import GeneratedCode
from modeling.codegen.fitted_model import FittedModel
from modeling.chain.model import planar
from modeling.space import Space
from modeling import effects
model = planar() + effects.viscous_drag() + effects.sensor_crosstalk()
fitted = FittedModel.of(model, [0.5] * len(model.parameters))
texts = [GeneratedCode.of_base(RigidToolRegressor(space), code_target("c"), "x").text for space in Space]
texts += [GeneratedCode.of_fitted(fitted, code_target(name), "x").text for name in target_names()]
"""


def test_the_same_model_gives_the_same_text_in_every_process() -> None:
    """Python hashes strings anew in each process, and SymPy's order of terms must not follow."""
    here: dict[str, list[str]] = {}
    exec(HASHED, here)  # noqa: S102 - the text above
    command = [sys.executable, "-c", HASHED + "print(repr(texts))"]
    env = os.environ | {"PYTHONHASHSEED": "12345"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    assert ast.literal_eval(done.stdout) == here["texts"]


# ----------------------------------------------------------------------------------------------- the command


def test_the_options_are_the_languages() -> None:
    assert target_names() == ("numpy", "casadi", "c", "latex")
    assert all(code_target(name).name == name for name in target_names())
    assert set(NAMES.values()) == set(BASES)


@pytest.mark.parametrize("base", ["planar", "spatial"])
@pytest.mark.parametrize("language", target_names())
def test_command_writes_the_same_everywhere_and_counts_beside_it(
    base: str, language: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["emit", base, "--to", language]) == 0
    printed = capsys.readouterr()
    path = tmp_path / "new" / "code"
    assert main(["emit", base, "--to", language, "--out", str(path)]) == 0
    written = capsys.readouterr()
    assert path.read_text() == printed.out
    assert (written.err, f"Written: {path}" in written.out) == ("", True)
    table = printed.err.splitlines()
    assert table[0].split() == ["operations", "per", "sample", "all", "+", "-", "*", "/", "functions"]
    shared, unshared = (int(re.search(r"\d+", line)[0]) for line in table[1:3])  # type: ignore[index]
    assert shared < unshared


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["planar"], "--to"),
        (["planar", "--to", "fortran"], "fortran"),
        (["ghost.json", "--to", "c"], "ghost.json"),
        (["planar", "--to", "c", "--rate", "-1"], "rate"),
        (["planar", "--to", "c", "--out", "/proc/none/x.c"], "/proc/none/x.c"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emit", *arguments]) == 2
    error = capsys.readouterr().err
    assert what in error
    assert error.count("\n") == 1
