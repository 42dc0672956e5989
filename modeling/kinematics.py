"""Kinematics: what an arm says of the motion of its sensor, whatever its joints are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.emission import casadi_expressions
from modeling.space import Space
from modeling.steps import Steps

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Calculus:
    """What expressions are made with: SymPy, CasADi or numbers. `let` gives an expression a name, where that helps."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    let: Callable[[Any], Any] = lambda expression: expression


@dataclass(frozen=True)
class Frames:
    """Where the joints of an arm and its sensor are, in the world.

    origins, axes   per joint a point on it (m) and the unit vector about which it turns, or along which it slides
    pose            of the sensor: phi, px, py in the plane, qx, qy, qz, qw, px, py, pz in space
    """

    origins: tuple[Sequence[Any], ...]
    axes: tuple[Sequence[Any], ...]
    pose: tuple[Any, ...]


class Arm(ABC):
    """Joints between the world and the sensor. `names` are the signals of the sensor's motion in `space`, in order."""

    space: ClassVar[Space]
    names: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def joints(self) -> int:
        """The number of joints n."""

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each joint's coordinate: rad, or m where it slides."""
        return ("rad",) * self.joints

    @abstractmethod
    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: Calculus) -> Frames:
        """Where everything is at the coordinates q (n), each link longer than described by `errors` (n), m."""

    @abstractmethod
    def derived(self, pose: Sequence[sp.Expr], steps: Steps) -> dict[str, sp.Expr]:
        """The signals by name, in the order of `names`, from a pose and its rates in time."""

    @abstractmethod
    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The signals by name as CasADi expressions of symbols q (n,) and of any dq, ddq (n,)."""

    @abstractmethod
    def pose(self, q: Array, dq: Array, ddq: Array) -> dict[str, Array]:
        """The signals by name, each (N,), of joint motions (N, n): rad, rad/s, rad/s², m where a joint slides."""

    def __getstate__(self) -> dict[str, Any]:
        # What was compiled stays behind: it does not travel between processes, and is soon made again.
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    @cached_property
    def function(self) -> Any:
        """CasADi function of q, dq, ddq (n,) each: the signals (len(names),), in the order of `names`."""
        import casadi as ca

        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        return ca.Function("arm", [q, dq, ddq], [ca.cse(ca.vertcat(*self.graph(q, dq, ddq).values()))])

    def tip(self, length: float) -> Any:
        """CasADi function of q (n,): the point `length` (m) along the tip from the sensor origin, in the world.

        (x, y) in the plane, along y'; (x, y, z) in space, along the sensor's z axis. m.
        """
        import casadi as ca

        q, still = ca.SX.sym("q", self.joints), ca.SX.zeros(self.joints)
        known = {sp.Symbol(name, real=True): value for name, value in self.graph(q, still, still).items()}
        motion = self.space.motion
        point = motion.position + motion.rotation * (sp.Float(length) * self.space.tip_axis)
        return ca.Function("tip", [q], [ca.vertcat(*casadi_expressions(known, list(point)[: self.space.value]))])
