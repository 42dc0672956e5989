"""Rigid bodies: the tool's wrench by Newton-Euler, linear in its moments, and what is carried beside the tool."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, Any, Self

from modeling import symbolic as sp
from modeling.errors import InputError, quoted
from modeling.parameter import Parameter
from modeling.space import Space, vector

if TYPE_CHECKING:  # what describes a model loads no numerical library
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


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


# ------------------------------------------------------------------------------- what is carried beside the tool

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
WRITTEN = re.compile(
    rf"(?P<mass>{NUMBER})(?:(?:±|\+-)(?P<mass_std>{NUMBER}))?"
    rf"(?:@(?P<at>{NUMBER}(?:,{NUMBER})*)(?:(?:±|\+-)(?P<at_std>{NUMBER}))?)?"
)
"""MASS@X,Y,Z with the std of either behind it, as in 2.000+-0.001@0,0,0.05+-0.001; kg, m."""
LARGEST_MASS, LARGEST_DISTANCE = 1000.0, 5.0
"""kg, and m from the sensor: what a robot carries is less, so that grams or millimetres were meant."""
LOAD_REMEDY = "write MASS@X,Y,Z in kg and m, as 2.000+-0.001@0,0,0.05+-0.001, or the name of a body of unknown mass"


@dataclass(frozen=True, kw_only=True)
class Load:
    """A body that the sensor carries in a recording, beside the tool or, where its mass is unknown, as another tool.

    Parameters
    ----------
    name : str, optional
        Of the body. Recordings with the same known one share its error; the tool with an unknown one has inertial
        parameters of its own, `m@name`.
    mass : float, optional
        kg; by default None, an unknown body.
    at : tuple of float, optional
        Centre of mass, m, from the sensor's origin along the axes of the tool's parameters, those of the logged pose;
        in the plane one number, along the tip. By default the origin.
    inertia : tuple of float, optional
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz about its centre along the same axes, kg m²; one number in the plane. By default
        that of a point.
    mass_std, at_std : float, optional
        Std of the mass, kg, and of each coordinate of the centre, m; by default 0.

    Examples
    --------
    >>> import truewrench as tw
    >>> tw.Load.of("2.000+-0.001@0,0,0.05").mass
    2.0
    """

    name: str = ""
    mass: float | None = None
    at: tuple[float, ...] = ()
    inertia: tuple[float, ...] = ()
    mass_std: float = 0.0
    at_std: float = 0.0

    def __post_init__(self) -> None:
        if self.mass is None:
            if not self.name:
                raise InputError(what="a load has neither a mass nor a name", where="load", remedy=LOAD_REMEDY)
            return
        numbers = (self.mass, *self.at, *self.inertia, self.mass_std, self.at_std)
        far = any(abs(x) > LARGEST_DISTANCE for x in (*self.at, self.at_std))
        if not all(map(isfinite, numbers)) or far or self.mass > LARGEST_MASS:
            what = f"no robot carries {self}{': millimetres?' if far else ': grams?'}"
            raise InputError(what=what, where="load", remedy=LOAD_REMEDY)
        if self.mass <= 0 or self.mass_std < 0 or self.at_std < 0:
            raise InputError(what=f"{self}: the mass is positive, no std negative", where="load", remedy=LOAD_REMEDY)

    @classmethod
    def of(cls, given: Load | str) -> Load:
        """What is written as MASS@X,Y,Z, or the name of an unknown body; InputError for anything else."""
        if isinstance(given, Load):
            return given
        if not isinstance(given, str) or not given.strip():
            raise InputError(what=f"{quoted(given)} is no load", where="load", remedy=LOAD_REMEDY)
        text = given.strip()
        if (match := WRITTEN.fullmatch(text.replace(" ", ""))) is None:
            if not re.fullmatch(r"(?!(?i:nan|inf|infinity)$)[^\W\d][\w .-]*", text):  # a name
                raise InputError(what=f"{quoted(given)} is no load", where="load", remedy=LOAD_REMEDY)
            return cls(name=text)
        at = tuple(map(float, match["at"].split(","))) if match["at"] else ()
        mass, mass_std, at_std = (float(match[name] or 0) for name in ("mass", "mass_std", "at_std"))
        return cls(mass=mass, at=at, mass_std=mass_std, at_std=at_std)

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_data`, InputError as of a load; other keys are left out."""
        stated: dict[str, Any] = {f.name: data[f.name] for f in fields(cls) if data.get(f.name) is not None}
        numbers = {name: tuple(value) for name, value in stated.items() if isinstance(value, list)}
        return cls(**(stated | numbers))

    def to_data(self) -> dict[str, Any]:
        """As plain data."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items() if v not in (None, (), "")}

    def __str__(self) -> str:
        if self.mass is None:
            return self.name
        spread = f"±{self.mass_std:g}" if self.mass_std else ""
        place = f" at ({', '.join(f'{x:g}' for x in self.at)}){f'±{self.at_std:g}' if self.at_std else ''} m"
        return f"{self.name + ', ' if self.name else ''}{self.mass:g}{spread} kg{place if self.at else ''}"

    @property
    def known(self) -> bool:
        """Whether its mass is known."""
        return self.mass is not None

    def moments(self, space: Space) -> Array:
        """Its `inertial_parameters` (k,), about the sensor's origin."""
        moments: Array = _moments_of_body(space)[0](*self._numbers(space)).ravel().astype(float)
        return moments

    def slopes(self, space: Space) -> Array:
        """Derivative (1 + d, k) of its moments in the mass, kg, and in each coordinate of its centre, m."""
        slopes: Array = _moments_of_body(space)[1](*self._numbers(space)).astype(float)
        return slopes

    def _numbers(self, space: Space) -> tuple[float, ...]:
        """Mass, coordinates of the centre and moments about it; InputError for another number of them."""
        assert self.mass is not None
        coordinates = 1 if space is Space.PLANE else 3
        moments = len(inertia_parameters(space))
        if len(self.at) not in (0, coordinates) or len(self.inertia) not in (0, moments):
            what = f"load {self}: {coordinates} coordinates and {moments} moments are of a load here"
            along = "the distance along the tip" if space is Space.PLANE else "x, y, z from the sensor's origin"
            raise InputError(what=what, where="load", remedy=f"give {along}, m")
        return (self.mass, *(self.at or (0.0,) * coordinates), *(self.inertia or (0.0,) * moments))


@lru_cache(maxsize=2)
def _moments_of_body(space: Space) -> tuple[Any, Any]:
    """The inertial parameters of a body of mass m at r with moments about its centre, and their derivative in m and r.

    A point's inertia about the origin is m (r·r - r r'); the moments about the centre add to it.
    """
    size = 1 if space is Space.PLANE else 3
    mass, *place = sp.symbols(f"m r_1:{size + 1}", real=True)
    own = sp.symbols(f"J_1:{len(inertia_parameters(space)) + 1}", real=True)
    r = place[0] * space.tip_axis if space is Space.PLANE else sp.Matrix(place)
    about_origin = mass * (r.dot(r) * sp.eye(3) - r * r.T)
    places = [(2, 2)] if space is Space.PLANE else [(i, j) for i in range(3) for j in range(i, 3)]
    inertia = [about_origin[i, j] + moment for (i, j), moment in zip(places, own, strict=True)]
    vector_of = sp.Matrix([mass, *(mass * x for x in place), *inertia])
    arguments = (mass, *place, *own)
    slopes = vector_of.jacobian([mass, *place]).T
    return sp.lambdify(arguments, vector_of), sp.lambdify(arguments, slopes)


def known_moments(loads: Iterable[Load], space: Space) -> Array | None:
    """Sum (k,) of the inertial parameters of the known loads; None without any."""
    known = [load.moments(space) for load in loads if load.known]
    return sum(known[1:], start=known[0]) if known else None
