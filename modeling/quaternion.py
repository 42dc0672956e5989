"""Quaternion: orientation and how it turns, from four components that need not be normalised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from modeling import symbolic as sp
from modeling.space import Space, signals

COMPONENTS = ("qx", "qy", "qz", "qw")


def product(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    """Hamilton's product a ⊗ b of four components each, x y z w: numbers, SymPy or CasADi expressions."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + bw * ax + ay * bz - az * by,
        aw * by + bw * ay + az * bx - ax * bz,
        aw * bz + bw * az + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(a: Sequence[Any]) -> tuple[Any, ...]:
    """The reverse turn of a unit quaternion."""
    x, y, z, w = a
    return (-x, -y, -z, w)


def rotated(a: Sequence[Any], v: Sequence[Any]) -> tuple[Any, ...]:
    """The vector v (3) turned by the unit quaternion a: the vector part of a ⊗ (v, 0) ⊗ conj(a)."""
    return product(product(a, (*v, 0.0)), conjugate(a))[:3]


def turning(components: Sequence[Sequence[sp.Symbol]]) -> Mapping[str, sp.Expr]:
    """qx .. qw, wx .. wz (rad/s) and alx .. alz (rad/s²) in the sensor frame, from s, ds, dds of four components each.

    The orientation is R(s / |s|) with the rotation matrix of the model's space; omega is what stands in the
    skew-symmetric R' dR, alpha its derivative in time. Whatever |s| does, it does not turn anything.
    """
    return _turning(tuple(map(tuple, components)))


@lru_cache(maxsize=8)
def _turning(components: tuple[tuple[sp.Symbol, ...], ...]) -> Mapping[str, sp.Expr]:
    s, ds, dds = map(sp.Matrix, components)
    unit = dict(zip(signals(*COMPONENTS), s / sp.sqrt(s.dot(s)), strict=True))
    rotation = Space.SPACE.motion.rotation.xreplace(unit)
    spin = rotation.T * _rate(rotation, (s, ds))
    # Cancelled, they are as short as 2 vec(conj(s) ds) / |s|²; left alone, their derivative is a thousand times longer.
    omega = sp.Matrix([sp.cancel(entry) for entry in (spin[2, 1], spin[0, 2], spin[1, 0])])
    alpha = _rate(omega, (s, ds), (ds, dds))
    found = {symbol.name: value for symbol, value in unit.items()}
    return found | {p + axis: vector[i] for p, vector in (("w", omega), ("al", alpha)) for i, axis in enumerate("xyz")}


def _rate(matrix: sp.Matrix, *pairs: tuple[sp.Matrix, sp.Matrix]) -> sp.Matrix:
    """The matrix's derivative in time, by the chain rule over pairs of (variables, their rates)."""
    terms = [matrix.diff(x) * dx for of, rates in pairs for x, dx in zip(of, rates, strict=True)]
    return sum(terms, sp.zeros(*matrix.shape))
