"""Pseudo-inertia matrix, positive semidefinite exactly for physically consistent parameters (Wensing et al. 2018)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.chain import Chain
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.space import Space

Array = NDArray[np.float64]

CONSISTENCY_MARGIN = 1e-6
"""Least second moment about the centre of mass along any axis, over the sum of the second moments about the sensor
origin, of a tool that is held physically consistent: it is as thick as a thousandth of its radius of gyration, thinner
than any tool. Simulators refuse one that is flat, a line or a point, where rounding decides about the signs; this is
far above what files and changes of frame round, relative 1e-12 at the most."""


@dataclass(frozen=True, eq=False)
class PseudoInertia:
    """J(theta) = constant + sum_i theta_i slopes_i, n x n, in kg, kg m and kg m² about the sensor origin.

    expression  J in SymPy
    names       (k,) names of the parameters theta
    constant    (n, n)
    slopes      (k, n, n)
    mass        indices of the rows of J with the mass; the others have second moments
    condition   J >= 0 as text
    room        names of the conditions of a volume, each a further row and column of J (`within`)
    tools       how many there are, each with a block of J like the first, whose `mass` and `room` are stated
    """

    expression: sp.Matrix
    names: tuple[str, ...]
    constant: Array
    slopes: Array
    mass: tuple[int, ...]
    condition: str
    room: tuple[str, ...] = ()
    tools: int = 1

    @property
    def size(self) -> int:
        """The number of rows n."""
        return len(self.constant)

    def at(self, theta: Array) -> Array:
        """J (n, n) at the parameters theta (k,)."""
        return np.asarray(self.constant + np.tensordot(theta, self.slopes, axes=1))

    def over(self, names: Sequence[str]) -> PseudoInertia:
        """The same matrix as a function of more parameters, (k,) `names` in their order."""
        slopes = np.zeros((len(names), self.size, self.size))
        slopes[[names.index(name) for name in self.names]] = self.slopes
        return replace(self, names=tuple(names), slopes=slopes)

    def of_each_tool(self, names: Sequence[str]) -> PseudoInertia:
        """The matrix that is >= 0 where those of this tool and of others are, whose parameters are `m@name`."""
        count = len(names) + 1
        every = tuple(f"{parameter}@{tool}" if tool else parameter for tool in ("", *names) for parameter in self.names)
        blocks = np.eye(count)
        slopes = np.array([np.kron(np.diag(block), slope) for block in blocks for slope in self.slopes], dtype=float)
        constant = np.kron(blocks, self.constant).astype(float)
        return replace(self, names=every, constant=constant, slopes=slopes, tools=count)

    def with_margin(self) -> PseudoInertia:
        """The matrix that is >= 0 where J is by `CONSISTENCY_MARGIN`, in any units and for a tool of any size.

        J - margin tr(Sigma) [[1, 0], [0, 0]] is affine in theta as J is. Its Schur complement of the mass says that
        Sigma - c c'/m, the second moments about the centre of mass, has no eigenvalue below margin tr(Sigma).
        """
        block = self.size // self.tools
        others = np.array([i for i in range(block - len(self.room)) if i not in self.mass])

        def moved(matrices: Array) -> Array:
            matrices = matrices.copy()
            for places in (others + first for first in range(0, self.size, block)):
                traces = matrices[..., places, places].sum(axis=-1)
                matrices[..., places, places] -= CONSISTENCY_MARGIN * traces[..., None]
            return matrices

        condition = f"{self.condition} by a margin of {CONSISTENCY_MARGIN:g}"
        return replace(self, constant=moved(self.constant), slopes=moved(self.slopes), condition=condition)

    def within(self, volume: Volume) -> PseudoInertia:
        """The matrix that is >= 0 where J is, and the mass may be inside the volume: J and tr(J Q_i) on the diagonal.

        Masses at r where [r; 1]' Q [r; 1] >= 0 have tr(J Q) >= 0, a sum of such terms. Raises InputError in the plane,
        where the second moments along the axes are not told apart.
        """
        if self.size != len(volume.quadratics[0]):
            what = "the second moments of a planar tool along its axes are not identifiable"
            raise InputError(what=what, where="inside", remedy="leave the volume out, or use a six-axis sensor")
        forms = np.array(volume.quadratics)

        def extended(matrices: Array) -> Array:
            whole = np.zeros((*matrices.shape[:-2], self.size + len(forms), self.size + len(forms)))
            whole[..., : self.size, : self.size] = matrices
            for place, form in enumerate(forms, self.size):
                whole[..., place, place] = np.sum(matrices * form, axis=(-2, -1))
            return whole

        condition = f"mass inside {volume.text}, and {self.condition}"
        constant, slopes = extended(self.constant), extended(self.slopes)
        return replace(self, constant=constant, slopes=slopes, condition=condition, room=volume.names)


@dataclass(frozen=True, eq=False)
class Volume:
    """Where the mass of a tool may be, along the axes of its parameters from the sensor's origin, m.

    Parameters
    ----------
    quadratics : tuple of array (4, 4)
        Q with [r; 1]' Q [r; 1] >= 0 at every r inside, m².
    names : tuple of str
        What each of these conditions is called.
    text : str
        What it is.

    Examples
    --------
    >>> import truewrench as tw
    >>> box = tw.Volume.box((-0.05, -0.05, 0.0), (0.05, 0.05, 0.2))
    >>> len(box.quadratics)
    3
    """

    quadratics: tuple[Array, ...]
    names: tuple[str, ...]
    text: str

    @classmethod
    def box(cls, low: Sequence[float] | Array, high: Sequence[float] | Array, text: str = "") -> Volume:
        """The box between two corners (3,), m: (r_i - low_i) (high_i - r_i) >= 0 of each axis.

        Necessary for mass inside; the moments of some mass outside keep it, too. Raises InputError for an empty box,
        and one of more than `LARGEST_TOOL`.
        """
        ends = np.array([low, high], dtype=float)
        if ends.shape != (2, 3) or not np.isfinite(ends).all() or (ends[1] <= ends[0]).any():
            remedy = "give low,high of x, y and z in m, such as -0.05,0.05,-0.05,0.05,0,0.2"
            raise InputError(what="no box: each high end is to be above its low one", where="inside", remedy=remedy)
        if np.ptp(ends, axis=0).max() > LARGEST_TOOL:
            what = f"a tool of {np.ptp(ends, axis=0).max():g} m: millimetres?"
            raise InputError(what=what, where="inside", remedy="give metres, along the axes of the tool's parameters")
        forms = []
        for axis, (below, above) in enumerate(ends.T):
            form = np.zeros((4, 4))
            form[axis, axis], form[3, 3] = -1.0, -below * above
            form[axis, 3] = form[3, axis] = (below + above) / 2
            forms.append(form)
        ranges = ", ".join(f"{a} {b:g} to {c:g} m" for a, (b, c) in zip("xyz", ends.T, strict=True))
        return cls(tuple(forms), tuple(f"room along {axis} in the box" for axis in "xyz"), text or f"the box {ranges}")

    @classmethod
    def around(cls, points: Array, text: str) -> Volume:
        """The box and the smallest ellipsoid (Khachiyan's) around points (n, 3), m, such as the corners of a mesh."""
        from scipy.spatial import ConvexHull  # slow to import

        points = np.unique(np.asarray(points, dtype=float), axis=0)
        spread = np.linalg.matrix_rank(points - points.mean(axis=0)) if len(points) else 0
        if points.ndim != 2 or spread < 3 or not np.isfinite(points).all():
            raise InputError(what="its points span no volume", where=text, remedy="give a closed body, in metres")
        points = points[ConvexHull(points).vertices]
        box = cls.box(points.min(axis=0), points.max(axis=0), text)
        return cls((*box.quadratics, _smallest_ellipsoid(points)), (*box.names, "room in the ellipsoid"), text)


LARGEST_TOOL = 5.0
"""Metres across, from which millimetres were meant."""
ELLIPSOID_GAP = 1e-4
"""Relative violation at which Khachiyan's iteration stops; the ellipsoid is widened by it, and holds every point."""


def _smallest_ellipsoid(points: Array) -> Array:
    """Q (4, 4) of the ellipsoid of least volume around points (n, 3): [r; 1]' Q [r; 1] = s² (1 - (r - c)' A (r - c)).

    Khachiyan, "Rounding of polytopes in the real number model of computation" (Mathematics of Operations Research 21,
    1996): weights of the points, of which in each step the one that is farthest out gets more. s is its largest half
    axis, so that the form is in m² as those of a box are.
    """
    count, dimension = points.shape
    lifted = np.column_stack([points, np.ones(count)])
    weights = np.full(count, 1 / count)
    while True:
        inverse = np.linalg.inv(lifted.T @ (weights[:, None] * lifted))
        out = np.einsum("ni,ij,nj->n", lifted, inverse, lifted)
        farthest = int(out.argmax())
        excess = out[farthest] - dimension - 1
        if excess < ELLIPSOID_GAP * (dimension + 1):
            break
        step = excess / ((dimension + 1) * (out[farthest] - 1))
        weights *= 1 - step
        weights[farthest] += step
    # [r; 1]' inverse [r; 1] = 1 + (r - c)' S^-1 (r - c) with the weighted mean c and covariance S of the points
    form = out[farthest] * np.diag([0.0, 0.0, 0.0, 1.0]) - inverse
    largest = np.linalg.eigvalsh(np.linalg.inv(inverse[:3, :3])).max()
    return np.asarray(form * largest)


@lru_cache(maxsize=32)
def pseudo_inertia(model: WrenchModel) -> PseudoInertia:
    """The pseudo-inertia of the model's tool, effects that change the tool included.

    Raises InputError when it is not affine in the model's parameters, or depends on a signal.
    """
    rows, mass, condition = _planar(model.chain) if model.space is Space.PLANE else _spatial(model.chain)
    matrix = rows.applyfunc(sp.expand)
    active = [p for p in model.parameters if p.symbol in matrix.free_symbols]
    slopes = [matrix.diff(p.symbol) for p in active]
    constant = matrix.subs({p.symbol: 0 for p in active})
    if any(m.free_symbols for m in (constant, *slopes)):
        raise InputError(
            what="the tool's moments are not linear in the parameters: physical consistency is no conic constraint",
            where=" + ".join(["rigid tip", *(e.id for e in model.effects)]),
            remedy="leave out physical consistency, or the effect that changes the tool",
        )
    return PseudoInertia(
        expression=matrix,
        names=tuple(p.name for p in active),
        constant=np.array(constant.tolist(), dtype=float),
        slopes=np.array([s.tolist() for s in slopes], dtype=float).reshape(len(active), *matrix.shape),
        mass=mass,
        condition=condition,
    )


def _spatial(chain: Chain) -> tuple[sp.Matrix, tuple[int, ...], str]:
    """J = [[Sigma, c], [c', m]], 4 x 4.

    Masses dm >= 0 at r (from the sensor origin, sensor frame) give J = sum [r; 1][r; 1]' dm, a sum of squares, so that
    v' J v = sum (v . [r; 1])² dm >= 0 for every v. Its blocks are the mass m = sum dm, the first moment c = sum r dm
    and the second moments Sigma = sum r r' dm. The inertia I = sum (|r|² 1 - r r') dm has the trace 2 tr(Sigma), so
    that Sigma = tr(I)/2 1 - I. Conversely four masses realise every J >= 0 with m > 0: the condition is exact.
    Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent inertial parameter identification"
    (IEEE Robotics and Automation Letters 3, 2018).
    """
    body = chain.body
    second = sp.eye(3) * body.inertia.trace() / 2 - body.inertia
    rows = second.row_join(body.first_moment).col_join(body.first_moment.T.row_join(sp.Matrix([[body.mass]])))
    return rows, (3,), "4 x 4 pseudo-inertia >= 0"


def _planar(chain: Chain) -> tuple[sp.Matrix, tuple[int, ...], str]:
    """J = [[m 1, c], [c', I]], with c along (x', y'): 3 x 3, or 2 x 2 for a first moment along the tip.

    Of the second moments only the trace I = tr(Sigma), Sigma 2 x 2, is identifiable in the plane. Some Sigma with
    [[Sigma, c], [c', m]] >= 0 exists exactly when m >= 0 and m I >= |c|²: Sigma >= c c'/m has at least the trace
    |c|²/m, and c c'/m plus a multiple of the identity attains it. That is J >= 0, by the Schur complement of m 1 in J.
    An axis without first moment would add the redundant condition m >= 0, and is left out.
    """
    body, tip = chain.body, chain.space.tip_axis
    across = sp.Matrix([0, 0, 1]).cross(tip)
    moments = [sp.expand(body.first_moment.dot(axis)) for axis in (across, tip)]
    moments = [moment for moment in moments if moment != 0]
    inertia = body.inertia[2, 2]
    c = sp.Matrix(moments)
    rows = (body.mass * sp.eye(len(moments))).row_join(c).col_join(c.T.row_join(sp.Matrix([[inertia]])))
    squares = " + ".join(f"{_in_parentheses(moment)}²" for moment in reversed(moments))
    return rows, tuple(range(len(moments))), f"{_in_parentheses(body.mass)} {_in_parentheses(inertia)} >= {squares}"


def _in_parentheses(expression: sp.Expr) -> str:
    text = str(expression)
    return text if expression.is_Symbol else f"({text})"
