"""Tree: what a formula says, node by node, each with the column that it stands at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from modeling.formula.functions import Function


@dataclass(frozen=True)
class Number:
    """A finite number; parts of a formula without names are one."""

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

    function: Function
    arguments: tuple[Node, ...]
    column: int


Node = Number | Name | Sum | Product | Power | Call


def children(node: Node) -> tuple[Node, ...]:
    """What a node is made of."""
    match node:
        case Sum(terms=pairs) | Product(factors=pairs):
            return tuple(child for _, child in pairs)
        case Power(base=base):
            return (base,)
        case Call(arguments=arguments):
            return arguments
        case _:
            return ()


def nodes(tree: Node) -> Iterator[Node]:
    """Every node of a tree, the root first."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        waiting.extend(children(node))


def names(tree: Node) -> frozenset[str]:
    """The names in a tree."""
    return frozenset(node.name for node in nodes(tree) if isinstance(node, Name))
