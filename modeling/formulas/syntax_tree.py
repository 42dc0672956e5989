"""Walks over a formula's syntax tree, whose `col_offset` are columns (from 1) of the formula's text.

Its nodes are those of the standard library's `ast`, of five kinds: Constant (a float), Name, UnaryOp (a minus), BinOp
(a sum, a product or a power with a constant exponent) and Call (of a formula function).
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from fractions import Fraction

LARGEST_EXPONENT = 8
"""Bound on numerator and denominator of an exponent: no law of physics has more, and 9^9^9 would never end."""
SUM, PRODUCT = (ast.Add, ast.Sub), (ast.Mult, ast.Div)


def chain_links(node: ast.BinOp) -> list[ast.BinOp]:
    """The operations of a sum a + b - c, or a product a * b / c, the leftmost first; a power alone."""
    kind = next((kind for kind in (SUM, PRODUCT) if isinstance(node.op, kind)), ())
    links = [node]
    while isinstance(links[-1].left, ast.BinOp) and isinstance(links[-1].left.op, kind):
        links.append(links[-1].left)
    return links[::-1]


def signed_parts(node: ast.BinOp) -> list[tuple[int, ast.expr]]:
    """The terms of a sum, each with its sign, or the factors of a product, with -1 for divisors."""
    links = chain_links(node)
    return [(1, links[0].left), *((-1 if isinstance(n.op, ast.Sub | ast.Div) else 1, n.right) for n in links)]


def exponent(power: ast.BinOp) -> Fraction:
    """The constant exponent of a power."""
    assert isinstance(power.right, ast.Constant)
    assert isinstance(power.right.value, float)
    return Fraction(power.right.value).limit_denominator(LARGEST_EXPONENT)


def child_nodes(node: ast.expr) -> list[ast.expr]:
    """The terms, factors, arguments, or base and exponent of a node."""
    match node:
        case ast.BinOp(op=ast.Pow()):
            return [node.left, node.right]
        case ast.BinOp():
            return [child for _, child in signed_parts(node)]
        case ast.UnaryOp():
            return [node.operand]
        case ast.Call():
            return node.args
        case _:
            return []


def nodes_in(tree: ast.expr) -> Iterator[ast.expr]:
    """Every node of a tree, the root first; a sum or product of many parts is one."""
    pending = [tree]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(child_nodes(node))


def names_in(tree: ast.expr) -> frozenset[str]:
    """The names in a tree, without those of functions."""
    return frozenset(node.id for node in nodes_in(tree) if isinstance(node, ast.Name))
