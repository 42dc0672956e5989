"""Rigid-body wrench by Newton-Euler, linear in mass, first moment and inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from modeling import symbolic as sp
from modeling.parameter import Parameter
from modeling.space import Space, vector


def contact_components(space: Space) -> tuple[str, ...]:
    """Names of a contact wrench's components: fcx along x', fcy along y', tauc clockwise; sensor frame in six axes."""
    return ("fcx", "fcy", "tauc") if space is Space.PLANE else ("fcx", "fcy", "fcz", "tcx", "tcy", "tcz")


def contact_force_torque(space: Space, wrench: Sequence[sp.Expr]) -> tuple[sp.Matrix, sp.Matrix]:
    """Force and torque about the sensor origin, in the sensor axes, of a contact wrench in its `contact_components`.

    In the plane the sensor axes are e1 = x', e2 = -y', e3 clockwise.
    """
    if space is Space.PLANE:
        x, y, clockwise = wrench
        return vector(x, -y, 0), vector(0, 0, clockwise)
    return vector(*wrench[:3]), vector(*wrench[3:])


@dataclass(frozen=True)
class RigidBody:
    """Mass (kg), first moment (kg m) and inertia about the sensor origin (kg m²), in the sensor frame."""

    mass: sp.Expr
    first_moment: sp.Matrix
    inertia: sp.Matrix


def inertial_parameters(space: Space) -> tuple[Parameter, ...]:
    """The inertial parameters: m, mlg, I of 22.6 (Bassi et al.) in the plane, ten in six axes."""
    first_moments = ("mlg",) if space is Space.PLANE else ("mx", "my", "mz")
    moments = (Parameter(name=name, unit="kg m") for name in first_moments)
    return (Parameter(name="m", unit="kg"), *moments, *inertia_parameters(space))


def inertia_parameters(space: Space) -> tuple[Parameter, ...]:
    """The moments of inertia about the sensor origin among them: I in the plane, Ixx .. Izz in six axes."""
    names = ("I",) if space is Space.PLANE else ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    return tuple(Parameter(name=name, unit="kg m²") for name in names)


def rigid_body(space: Space) -> RigidBody:
    """The tool in terms of `inertial_parameters`; in the plane its centre of mass is on the tip axis."""
    symbols = [p.symbol for p in inertial_parameters(space)]
    if space is Space.PLANE:
        mass, moment, inertia = symbols
        return RigidBody(mass, moment * space.tip_axis, sp.diag(0, 0, inertia))
    mass, mx, my, mz, xx, xy, xz, yy, yz, zz = symbols
    return RigidBody(mass, vector(mx, my, mz), sp.Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def newton_euler(body: RigidBody, lift: sp.Matrix, omega: sp.Matrix, alpha: sp.Matrix) -> tuple[sp.Matrix, sp.Matrix]:
    """Force and torque (about the sensor origin) of the sensor on the tool, in the sensor frame.

    `lift` is the specific force, the origin's acceleration minus gravity. A mass element dm at r needs the force
    f dm, f = lift + alpha x r + omega x (omega x r), and the torque r x f dm. The integral over the body replaces the
    powers of r by moments: 1 by the mass, r_i by the first moment, r_i r_j by the second moments
    Sigma = tr(I)/2 - I.
    """
    general = _general_newton_euler()
    given = (body.mass, *body.first_moment, *body.inertia, *lift, *omega, *alpha)
    values = dict(zip(general.symbols, given, strict=True))
    return general.force.xreplace(values), general.torque.xreplace(values)


@dataclass(frozen=True)
class _NewtonEuler:
    """Force and torque (3, 1) of any body: mass, first moment, inertia by rows, lift, omega and alpha are `symbols`."""

    symbols: tuple[sp.Symbol, ...]
    force: sp.Matrix
    torque: sp.Matrix


@lru_cache(maxsize=1)
def _general_newton_euler() -> _NewtonEuler:
    """Derived once: effects change what is put in, neither the equations nor the integral."""
    mass, *others = symbols = sp.symbols("m s_1:4 J_1:10 f_1:4 w_1:4 a_1:4", real=True)
    first, inertia, lift, rate, turn = (others[i:j] for i, j in ((0, 3), (3, 12), (12, 15), (15, 18), (18, 21)))
    body = RigidBody(mass, sp.Matrix(first), sp.Matrix(3, 3, inertia))
    r, omega = sp.Matrix(sp.symbols("r_1 r_2 r_3")), sp.Matrix(rate)
    element = sp.Matrix(lift) + sp.Matrix(turn).cross(r) + omega.cross(omega.cross(r))
    force = element.applyfunc(lambda e: _sum_over_body(e, r, body))
    torque = r.cross(element).applyfunc(lambda e: _sum_over_body(e, r, body))
    return _NewtonEuler(symbols, force, torque)


def _sum_over_body(density: sp.Expr, r: sp.Matrix, body: RigidBody) -> sp.Expr:
    second = sp.eye(3) * body.inertia.trace() / 2 - body.inertia
    total = sp.S.Zero
    for powers, coefficient in sp.Poly(sp.expand(density), *r).terms():
        indices = [i for i, power in enumerate(powers) for _ in range(power)]
        moment = (
            body.mass
            if not indices
            else body.first_moment[indices[0]]
            if len(indices) == 1
            else second[indices[0], indices[1]]
        )
        total += coefficient * moment
    return total
