"""Quaternion algebra; orientation, angular velocity and acceleration from unnormalised components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from modeling import symbolic as sp
from modeling.space import Space, signals

COMPONENTS = ("qx", "qy", "qz", "qw")


def quaternion_product(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    """Hamilton's product a ⊗ b of four components each, x y z w: numbers, SymPy or CasADi expressions."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + bw * ax + ay * bz - az * by,
        aw * by + bw * ay + az * bx - ax * bz,
        aw * bz + bw * az + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def quaternion_conjugate(a: Sequence[Any]) -> tuple[Any, ...]:
    """The conjugate: inverse rotation of a unit quaternion."""
    x, y, z, w = a
    return (-x, -y, -z, w)


def rotated_vector(a: Sequence[Any], v: Sequence[Any]) -> tuple[Any, ...]:
    """The vector v (3) rotated by the unit quaternion a: the vector part of a ⊗ (v, 0) ⊗ conj(a)."""
    return quaternion_product(quaternion_product(a, (*v, 0.0)), quaternion_conjugate(a))[:3]


def angular_motion(components: Sequence[Sequence[sp.Symbol]]) -> Mapping[str, sp.Expr]:
    """qx .. qw, wx .. wz (rad/s) and alx .. alz (rad/s²) in the sensor frame, from s, ds, dds of four components each.

    The orientation is R(s / |s|) with the rotation matrix of the model's space; omega is the vector of the
    skew-symmetric matrix R' dR, alpha its time derivative. Changes of |s| have no effect.
    """
    return _angular_motion(tuple(map(tuple, components)))


@lru_cache(maxsize=8)
def _angular_motion(components: tuple[tuple[sp.Symbol, ...], ...]) -> Mapping[str, sp.Expr]:
    s, ds, dds = map(sp.Matrix, components)
    unit = dict(zip(signals(*COMPONENTS), s / sp.sqrt(s.dot(s)), strict=True))
    rotation = Space.SPACE.motion.rotation.xreplace(unit)
    spin = rotation.T * _rate(rotation, (s, ds))
    # Cancelled, as short as 2 vec(conj(s) ds) / |s|²; otherwise the derivative is a thousand times longer.
    omega = sp.Matrix([sp.cancel(entry) for entry in (spin[2, 1], spin[0, 2], spin[1, 0])])
    alpha = _rate(omega, (s, ds), (ds, dds))
    found = {symbol.name: value for symbol, value in unit.items()}
    return found | {p + axis: vector[i] for p, vector in (("w", omega), ("al", alpha)) for i, axis in enumerate("xyz")}


def _rate(matrix: sp.Matrix, *pairs: tuple[sp.Matrix, sp.Matrix]) -> sp.Matrix:
    """Time derivative of the matrix, by the chain rule over pairs of (variables, their rates)."""
    terms = [matrix.diff(x) * dx for of, rates in pairs for x, dx in zip(of, rates, strict=True)]
    return sum(terms, sp.zeros(*matrix.shape))
