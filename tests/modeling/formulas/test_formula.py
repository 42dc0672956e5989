"""Formulas: what they mean, what they refuse and where, and that no text is ever executed."""

from __future__ import annotations

import ast
import math
import random
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st

from modeling.compiled.symbolic_vector import casadi_expressions, numpy_function
from modeling.errors import InputError
from modeling.formulas.parser import (
    DEEPEST_TREE,
    FILE_NAME,
    FORMULA_FUNCTIONS,
    LARGEST_EXPONENT,
    LONGEST_FORMULA,
    MOST_NODES,
    FormulaSource,
    child_nodes,
    exponent,
    nodes_in,
    parse_formula,
    to_sympy,
)
from modeling.formulas.python_definition import formula_text
from modeling.formulas.units import dimension, require_unit, unit_of

NAMES = ("x", "y", "z", "k")
SYMBOLS = {name: sp.Symbol(name, real=True) for name in NAMES}
POINT = {"x": 0.7, "y": -1.3, "z": 2.9, "k": 0.31}


def read(text: str) -> ast.expr:
    return parse_formula(FormulaSource(text), NAMES)


def built(text: str) -> sp.Expr:
    return to_sympy(read(text), SYMBOLS, FormulaSource(text))


def value(found: sp.Expr, point: dict[str, float] | None = None) -> float:
    at = POINT if point is None else point
    return float(found.xreplace({SYMBOLS[name]: sp.Float(number) for name, number in at.items()}))


# ------------------------------------------------------------------------------------- what they mean

NUMBERS = st.one_of(st.integers(0, 30).map(str), st.floats(0.01, 50.0).map(repr), st.sampled_from(["1e-3", ".5", "2."]))
ATOMS = st.one_of(st.sampled_from(NAMES), NUMBERS)
SPACE = st.sampled_from(["", " "])


def grown(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    """Longer formulas, mostly without the brackets that would say how they are meant."""
    operator = st.sampled_from(["+", "-", "*", "/"])
    return st.one_of(
        st.tuples(inner, SPACE, operator, SPACE, inner).map("".join),
        st.tuples(inner, operator, st.just("-"), inner).map("".join),
        inner.map("({})".format),
        inner.map("-{}".format),
        st.tuples(ATOMS, st.sampled_from(["^2", "**3", "^-1", "^-2**1"])).map("".join),
        st.tuples(st.sampled_from(["sin", "cos", "tanh", "abs", "exp"]), inner).map("{0[0]}({0[1]})".format),
        st.tuples(st.sampled_from(["min", "max", "atan2"]), inner, inner).map("{0[0]}({0[1]}, {0[2]})".format),
    )


FORMULAS = st.recursive(ATOMS, grown, max_leaves=12)
PYTHONS: dict[str, Any] = {name: getattr(math, name) for name in ("sin", "cos", "tan", "tanh", "exp", "sqrt", "atan2")}
PYTHONS |= {"abs": abs, "min": min, "max": max, "__builtins__": {}} | POINT


def by_python(text: str) -> float | None:
    """What Python makes of the same text, None where it is not a moderate real number."""
    try:
        found = eval(text.replace("^", "**"), PYTHONS)  # noqa: S307 - the test's own text, as an oracle
    except (ArithmeticError, ValueError):
        return None
    return float(found) if isinstance(found, int | float) and abs(found) < 1e12 else None


@example("atan2(1, x+-x)")
@settings(max_examples=120, deadline=None)
@given(FORMULAS)
def test_a_formula_means_what_it_means_in_python(text: str) -> None:
    """Precedence, grouping and functions, against Python's own."""
    expected = by_python(text)
    if expected is not None:
        # Sums in another order: rounding of terms below 1e12, which may cancel.
        assert value(built(text)) == pytest.approx(expected, rel=1e-7, abs=1e-3 if "e" in repr(expected) else 1e-7)


@settings(max_examples=60, deadline=None)
@given(FORMULAS)
def test_what_is_printed_is_read_as_the_same(text: str) -> None:
    try:
        once = built(text)
    except InputError:
        return  # names cancelled to 1/0
    again = built(formula_text(once))
    assert formula_text(again) == formula_text(built(formula_text(again)))
    try:
        first = value(once)
    except TypeError:
        return  # no real number here
    if math.isfinite(first) and abs(first) < 1e12:
        assert value(again) == pytest.approx(first, rel=1e-9, abs=1e-9)  # rounding in another order of terms


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("-x^2", "-(x^2)"),
        ("2^-1", "0.5"),
        ("x^2^1", "x^(2^1)"),
        ("x/y/z", "x/(y*z)"),
        ("x-y-z", "x-(y+z)"),
        ("x/y*z", "(x/y)*z"),
        ("--x", "x"),
        ("x**(1/2)", "sqrt(x)"),
        ("x^(-2/3)", "1/x^(2/3)"),
        ("2*pi", "6.283185307179586"),
        (" x\t+\n y ", "y+x"),
    ],
)
def test_two_ways_to_write_the_same(text: str, meant: str) -> None:
    assert value(built(text)) == pytest.approx(value(built(meant)), rel=1e-14)


def test_names_may_be_words_that_python_keeps_for_itself() -> None:
    words = {word: sp.Symbol(word, real=True) for word in ("lambda", "if", "None", "x_", "match")}
    source = FormulaSource("lambda^2 + if*None - x_/match")
    lam, condition, none, x, match = words.values()
    assert to_sympy(parse_formula(source, words), words, source) == lam**2 + condition * none - x / match


def test_the_smooth_step_and_sign_are_what_is_documented() -> None:
    assert value(built("sign(x, k)")) == pytest.approx(math.tanh(POINT["x"] / POINT["k"]))
    assert value(built("step(x, k)")) == pytest.approx((1 + math.tanh(POINT["x"] / POINT["k"])) / 2)


@pytest.mark.parametrize("name", FORMULA_FUNCTIONS)
def test_every_function_is_the_same_in_numbers_numpy_and_casadi(name: str) -> None:
    """Constants are evaluated by `number`, the rest by the expression: one meaning, in every back end."""
    function = FORMULA_FUNCTIONS[name]
    arguments = [0.8, 0.3, 1.7][: max(function.least, min(function.most, 3))]
    symbols = [SYMBOLS[n] for n in NAMES[: len(arguments)]]
    found = function.expression(*symbols)
    expected = function.number(*arguments)
    (by_numpy,) = numpy_function(symbols, [found])(*arguments)
    assert by_numpy == pytest.approx(expected, rel=1e-14)
    inputs = ca.SX.sym("u", len(arguments))
    (graph,) = casadi_expressions({s: inputs[i] for i, s in enumerate(symbols)}, [found])
    assert float(ca.Function("f", [inputs], [graph])(arguments)) == pytest.approx(expected, rel=1e-14)
    text = f"{name}({', '.join(map(repr, arguments))})"
    assert value(built(text)) == pytest.approx(expected, rel=1e-14)


# ----------------------------------------------------------------------- what they refuse, and where

REFUSED = {
    "sin(x": (4, "'(' was never closed"),
    "": (1, "invalid syntax at the end"),
    "x +": (4, "invalid syntax at the end"),
    "2x": (2, "invalid syntax at 'x'"),
    "x y": (3, "invalid syntax at 'y'"),
    "x, y": (1, "a tuple is not allowed"),
    "x)": (2, "unmatched ')'"),
    "()": (1, "a tuple is not allowed"),
    "xx + 1": (1, "did you mean x?"),
    "2*sinn(x)": (3, "did you mean sin(x)"),
    "sin": (1, "call it as sin(x)"),
    "x(2)": (2, "put an operator before the bracket"),
    "sin(x, y)": (1, "sin is called with 2 arguments; call it as sin(x)"),
    "sign(x)": (1, "call it as sign(x, width)"),
    "max(x)": (1, "max is called with 1 argument"),
    "log(x)": (1, "'log' is not a known function"),
    "x < y": (3, "a formula has no comparisons"),
    "x²": (2, "write ^2 for a power"),
    "x·y": (2, "write * for a product"),
    "x − y": (3, "write - for a difference"),
    "1e999": (1, "not a finite number"),
    "1/0": (1, "division by zero"),
    "1/(2-2)": (1, "division by zero"),
    "sqrt(-1)": (1, "not a finite number"),
    "exp(1e9)": (1, "not a finite number"),
    "(-8)^(1/3)": (1, "not a finite number"),
    "x^y": (3, "not a constant"),
    "x^9": (3, "the exponent 9 is out of range"),
    "x^0.123": (3, "out of range"),
    "9**9**9": (7, "the exponent 9 is out of range"),
    "2^x": (3, "and exp(x) for other powers"),
    "1/(x - x)": (1, "no finite real number"),
    "z*sqrt(x - x - 1)": (3, "no finite real number"),
    "x*1e200*(y*1e200)": (1, "no finite real number"),
    "y + sign(x, 2 - 2)": (5, "no finite real number"),
    "x*y(z)": (4, "put an operator before the bracket"),
    "sign(2, tanh(0/z))": (1, "no finite real number"),
    "sin(x y)": (5, "forgot a comma"),
    "3(x)": (1, "a call is not allowed"),
    "sin(*x)": (5, "a starred is not allowed"),
    "x² + y": (2, "write ^2"),
    "y^2 + z^2 + xx": (13, "did you mean x?"),
    "-" * 200 + "x": (122, "nested more than"),
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_no_formula_is_refused_at_its_column(text: str) -> None:
    column, what = REFUSED[text]
    with pytest.raises(InputError) as caught:
        built(text)
    assert f"formula, column {column}: " in str(caught.value)
    assert what in str(caught.value)


HOSTILE = (
    "x.__class__", "x.__class__.__mro__[1].__subclasses__()", "__import__('os').system('true')", "__builtins__",
    "().__class__", "eval('x')", "exec(x)", "open('a')", "getattr(x, y)", "lambda: x", "lambda x: x", "[x for x in y]",
    "{x: y}", "x if y else z", "x and y", "not x", "x or y", "x == y", "x != y", "x := 3", "x = 3", "x; y", "x\n;y",
    "'x'", '"x"', "f'{x}'", "b'x'", "`x`", "$x", "x @ y", "x // y", "x % y", "x & y", "x | y", "~x", "x << 9",
    "x # y", "x\\y", "...", "1_000", "0x10", "1j", "2j*x", "1e9999", "nan", "inf", "oo", "zoo", "I", "E",
    "Symbol('x')", "S(1)", "Function('f')(x)", "factorial(9)", "sin.func", "x\0", "\0", "\x1b[31mx", "ｘ", "х",
    "x\u200b", "x\u202e", "١", "x²", "sin\u00adx", "import os", "print(x)", "True", "None", "yield x", "await x", "*x",
    "**x", "x,", "sin(*x)", "sin(x=1)", "sin(**x)", "@x", "x?", "x!", "global x", "del x", "_", "_x", "x__", "__x__",
)  # fmt: skip
"""Python, SymPy and shell by other means; look-alikes of letters and digits; what hides in text. Each is refused."""


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_text_is_refused_in_one_printable_line(text: str) -> None:
    with guarded(), pytest.raises(InputError) as caught:
        built(text)
    assert "column" in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "text",
    [
        "(" * 10**5 + "x" + ")" * 10**5,
        "(" * 400 + "x" + ")" * 400,
        "-" * 900 + "x",
        "sin(" * 200 + "x" + ")" * 200,
        "x" + "^1" * 400,
        "2" + "^2" * 400,
        "9" * 900 + "^8",
        "x" + "+x" * 400,
        "x+" * 10**6,
        "(" * 10**6,
        "9" * 10**7,
        "max(" + "x," * 300 + "x)",
        "1e" + "9" * 900,
        "9**8**8**8**8",
    ],
    ids=lambda text: f"{text[:6]}-{len(text)}",
)
def test_too_much_of_anything_is_refused_before_it_costs_anything(text: str) -> None:
    """In function calls, not seconds: one per character at most, of what is read at all."""
    with counted() as calls, pytest.raises(InputError):
        read(text)
    assert calls[0] < 60 * LONGEST_FORMULA


# ------------------------------------------------------------------------------------ never executed


class Executed(BaseException):
    """Something ran, opened or compiled; no handler of ordinary errors hides it."""


_watched = [False]
_FORBIDDEN = (
    "exec",
    "compile",
    "import",
    "open",
    "os.system",
    "os.exec",
    "subprocess.Popen",
    "socket.",
    "ctypes.",
)


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    syntax_only = event == "compile" and arguments[1] == FILE_NAME  # to a tree; code of it would still be an `exec`
    if _watched[0] and event.startswith(_FORBIDDEN) and not syntax_only:
        raise Executed(event, arguments)


sys.addaudithook(_hook)  # for good, as Python has it: idle unless `guarded`


@contextmanager
def guarded() -> Iterator[None]:
    """Whatever executes, compiles, imports or opens anything in here fails, however it came to it."""
    _watched[0] = True
    try:
        yield
    finally:
        _watched[0] = False


@contextmanager
def counted() -> Iterator[list[int]]:
    """The number of function calls made in here."""
    calls = [0]

    def count(frame: object, event: str, argument: object) -> None:
        calls[0] += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        yield calls
    finally:
        sys.setprofile(None)


def test_the_guard_sees_execution() -> None:
    with guarded(), pytest.raises(Executed):
        compile("1", "text", "eval")
    with guarded(), pytest.raises(Executed), open("/dev/null"):
        pass
    with guarded(), pytest.raises(Executed):
        exec(compile("1", FILE_NAME, "eval"))  # noqa: S102 - the guard's own text, which it must stop


PIECES = (
    *NAMES,
    *FORMULA_FUNCTIONS,
    "pi",
    "0",
    "1",
    "2",
    "0.5",
    "1e3",
    "8",
    "1e-300",
    "1e300",
    *"+-*/^(),",
    "**",
    "(",
    ")",
    " ",
)
STRANGE = (
    "__import__",
    ".",
    "__class__",
    "'",
    '"',
    "[",
    "]",
    "lambda",
    ":",
    "=",
    "eval",
    "\0",
    "é",
    "²",
    "#",
    ";",
    "_",
    "\n",
)


def _grown(rng: random.Random, depth: int) -> str:
    """A formula of the grammar."""
    if depth == 0 or rng.random() < 0.15:
        return rng.choice([*NAMES, "2", "0.5", "1e-3", "0", "7", "pi"])

    def part() -> str:
        return _grown(rng, depth - 1)

    kind = rng.randrange(6)
    if kind < 3:
        return f"{part()}{rng.choice('+-*/')}{part()}"
    if kind == 3:
        return f"({part()})^{rng.choice(['2', '-1', '(1/2)', '3', '-3/2', '8'])}"
    name = rng.choice(list(FORMULA_FUNCTIONS))
    count = {1: 1, 2: 2}.get(FORMULA_FUNCTIONS[name].most, rng.choice([2, 3]))
    return f"{name}({','.join(part() for _ in range(count))})"


def _mutated(rng: random.Random, text: str) -> str:
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(len(text) + 1)
        text = text[:place] + rng.choice([*PIECES, *STRANGE, ""]) + text[place + rng.randrange(3) :]
    return text


MAKERS: tuple[Callable[[random.Random], str], ...] = (
    lambda rng: _grown(rng, rng.randrange(1, 5)),
    lambda rng: _mutated(rng, _grown(rng, rng.randrange(1, 5))),
    lambda rng: "".join(rng.choice([*PIECES, *PIECES, *STRANGE]) for _ in range(rng.randrange(1, 40))),
    lambda rng: "".join(chr(rng.choice([rng.randrange(128), rng.randrange(0x2100)])) for _ in range(rng.randrange(30))),
    lambda rng: rng.choice(HOSTILE) + rng.choice(["", "+", "*(", " "]) + _grown(rng, 2),
)


def attempted(text: str) -> tuple[ast.expr | None, sp.Expr | None]:
    """The tree and the expression of a text, as far as it has them, with nothing executed on the way."""
    tree = None
    try:
        with guarded(), suppress(InputError):
            tree = read(text)
            return tree, to_sympy(tree, SYMBOLS, FormulaSource(text))
    except Executed as ran:
        event, (module, *_) = ran.args
        if event != "import" or not module.startswith("sympy."):
            raise
        import_module(module)  # a part of SymPy that it loads when it is first needed: load it, and watch again
        return attempted(text)
    return tree, None


def test_ten_thousand_fuzzed_texts_are_read_or_refused_and_never_executed() -> None:
    """And what is read stays within the limits that SymPy is given."""
    rng, read_count = random.Random(5), 0
    for number in range(10_000):
        text = MAKERS[number % len(MAKERS)](rng)
        tree, found = attempted(text)
        if tree is None or found is None:
            continue
        read_count += 1
        assert len(list(nodes_in(tree))) <= MOST_NODES
        assert _depth(tree) <= DEEPEST_TREE + 1
        assert {type(node) for node in nodes_in(tree)} <= NODE_TYPES
        powers = [n for n in nodes_in(tree) if isinstance(n, ast.BinOp) and isinstance(n.op, ast.Pow)]
        assert all(abs(exponent(power)) <= LARGEST_EXPONENT for power in powers)
        functions = [n.func for n in nodes_in(tree) if isinstance(n, ast.Call)]
        assert all(isinstance(name, ast.Name) and name.id in FORMULA_FUNCTIONS for name in functions)
        assert found.free_symbols <= set(SYMBOLS.values())
    assert read_count > 1500  # or the fuzzer would only ever test refusals


NODE_TYPES = {ast.Constant, ast.Name, ast.UnaryOp, ast.BinOp, ast.Call}
"""All that a formula has."""


def _depth(node: ast.expr) -> int:
    return 1 + max(map(_depth, child_nodes(node)), default=0)


@settings(max_examples=120, deadline=None)
@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    with guarded(), suppress(InputError):
        read(text)


# -------------------------------------------------------------------------------------------- units

UNITS = {name: dimension(unit) for name, unit in {"x": "m", "y": "m", "z": "s", "k": "N/m"}.items()}


@pytest.mark.parametrize(
    "text",
    [
        "k*x",
        "k*(x - 0)",
        "k*max(0, x - y)",
        "k*sqrt(x^2 + y^2)",
        "k*x*sin(x/y)",
        "k*y*exp(-(x/y)^2)",
        "k*x*sign(x, y)",
        "k*atan2(y, x)*x",
        "k*(x^3)^(1/3)",
        "0",
    ],
)
def test_units_that_agree(text: str) -> None:
    require_unit(read(text), UNITS, dimension("N"), FormulaSource(text))


@pytest.mark.parametrize(
    ("text", "column", "what"),
    [
        ("k", 1, "its unit is N/m, expected N"),
        ("k*x + k", 7, "incompatible units N/m and N"),
        ("k*(x + 0.1)", 8, "incompatible units 1 (dimensionless) and m"),
        ("k*x*sin(x)", 9, "sin needs a dimensionless argument, got m"),
        ("k*x*exp(z)", 9, "exp needs a dimensionless argument, got s"),
        ("k*min(x, z)", 10, "incompatible units s and m"),
        ("k*x*sign(x, 0.1)", 13, "incompatible units 1 (dimensionless) and m"),
        ("k*x*atan2(x, z)", 14, "incompatible units s and m"),
        ("k*sqrt(x)", 1, "its unit is "),
        ("1", 1, "its unit is 1 (dimensionless), expected N"),
    ],
)
def test_units_that_do_not_agree_are_refused_at_their_column(text: str, column: int, what: str) -> None:
    with pytest.raises(InputError) as caught:
        require_unit(read(text), UNITS, dimension("N"), FormulaSource(text))
    assert f"column {column}: {what}" in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(FORMULAS)
def test_a_formula_of_consistent_units_does_not_depend_on_the_system_of_units(text: str) -> None:
    """Where the check finds a unit, the value in other units is the value times that unit's factor."""
    try:
        unit = unit_of(read(text), UNITS, FormulaSource(text))
        ours = value(built(text))
    except (InputError, TypeError):
        return
    factors = {"m": 1.3, "s": 0.7, "kg": 1.9}

    def scale(name: str) -> float:
        return float(np.prod([factors[u] ** float(p) for u, p in UNITS[name].powers]))

    theirs = value(built(text), {name: number * scale(name) for name, number in POINT.items()})
    factor = 1.0 if unit is None else math.prod(factors[u] ** float(p) for u, p in unit.powers)
    if np.isfinite([ours, theirs]).all() and max(abs(ours), abs(theirs)) < 1e9:
        assert theirs == pytest.approx(ours * factor, rel=1e-9, abs=1e-9)  # rounding
