"""Syntax tree of a formula, each node with its column in the text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from modeling.formulas.functions import FormulaFunction


@dataclass(frozen=True)
class Number:
    """A finite number; constant parts of a formula are folded to one."""

    value: float
    column: int


@dataclass(frozen=True)
class Name:
    """A named quantity."""

    name: str
    column: int


@dataclass(frozen=True)
class Sum:
    """The sum of terms, each with its sign (+1, -1)."""

    terms: tuple[tuple[int, Node], ...]
    column: int


@dataclass(frozen=True)
class Product:
    """The product of factors, each multiplied (+1) or divided by (-1)."""

    factors: tuple[tuple[int, Node], ...]
    column: int


@dataclass(frozen=True)
class Power:
    """A base to a constant power."""

    base: Node
    exponent: Fraction
    column: int


@dataclass(frozen=True)
class Call:
    """A function of arguments."""

    function: FormulaFunction
    arguments: tuple[Node, ...]
    column: int


Node = Number | Name | Sum | Product | Power | Call


def child_nodes(node: Node) -> tuple[Node, ...]:
    """The children of a node."""
    match node:
        case Sum(terms=pairs) | Product(factors=pairs):
            return tuple(child for _, child in pairs)
        case Power(base=base):
            return (base,)
        case Call(arguments=arguments):
            return arguments
        case _:
            return ()


def nodes_in(tree: Node) -> Iterator[Node]:
    """Every node of a tree, the root first."""
    pending = [tree]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(child_nodes(node))


def names_in(tree: Node) -> frozenset[str]:
    """The names in a tree."""
    return frozenset(node.name for node in nodes_in(tree) if isinstance(node, Name))
