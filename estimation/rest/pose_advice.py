"""PoseAdvice: what poses at rest have not shown of a tool, and which further ones would."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit, Problem
from estimation.linear.estimate import table
from estimation.linear.least_squares import Sight
from estimation.rest.rest_poses import RestPoses
from modeling.errors import InputError
from modeling.prediction import compiled

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Share of the largest singular value at which a direction is only rounding."""
NOTHING = 1e-9
"""Information on what is not shown at all, as a share of what all poses together would tell: so little that a pose
which shows something new always comes before one that only sharpens."""


@dataclass(frozen=True, eq=False)
class PoseAdvice:
    """What further poses at rest would do for a fit.

    fit       the fit, of recordings of which one at least is of poses at rest
    never     parameters that no pose at rest shows, whatever its orientation, without those of motion
    missing   parameters that the poses taken do not show, and further ones do
    chosen    indices in `poses` of the fewest that show all these; the one that helps most when nothing is missing
    after     std of every unknown with the chosen poses taken as well, each once; infinite where still not shown
    """

    fit: Fit
    poses: RestPoses
    never: tuple[str, ...]
    missing: tuple[str, ...]
    chosen: tuple[int, ...]
    after: Mapping[str, float]

    @classmethod
    def of(cls, fitted: Fit) -> PoseAdvice:
        """Advice for the rig and in the session of the fit's first recording of poses, whose zero and noise they share.

        With A the whitened derivative of the readings taken and r_i (p, k) that of a pose, what could ever be shown is
        the row space of A and all r_i together. In it poses are chosen one by one, each to make det(A'A + sum r'r)
        largest (sequential D-optimality: Fedorov, Theory of Optimal Experiments, 1972), until the rank is reached;
        the first poses start from `NOTHING` instead of zero.
        Raises InputError when no recording is of poses at rest.
        """
        number = _at_rest(fitted)
        poses = RestPoses.of(fitted.recordings[number])
        taken = Problem(fitted.layout, fitted.recordings, fitted.noise).evaluate(fitted.theta)[1]
        root, rows = np.asarray(np.linalg.qr(taken, mode="r")), whitened(fitted, number, poses)
        ever = _sight([root, *rows])
        chosen = _chosen(root, rows, ever)
        there, now = _sight([root, *rows[list(chosen)]]), _sight([root])
        names = [p.name for p in fitted.layout.parameters]
        std = np.where(there.shown, np.sqrt(np.diag(there.covariance)), np.inf)
        return cls(
            fitted,
            poses,
            tuple(n for n, shown in zip(names, ever.shown, strict=True) if not shown),
            tuple(n for n, e, s in zip(names, ever.shown, now.shown, strict=True) if e and not s),
            chosen,
            dict(zip(names, std.tolist(), strict=True)),
        )

    @property
    def complete(self) -> bool:
        """Whether the poses taken show all that poses can show."""
        return not self.missing

    @cached_property
    def before(self) -> Mapping[str, float]:
        """Std of every unknown as it is; infinite where not shown."""
        return {name: estimate.std for name, estimate in self.fit.parameters.items()}

    def sentences(self) -> list[str]:
        """The advice, for people."""
        found = [f"No pose at rest shows {_listed(self.never)}: that takes motion."] if self.never else []
        count = len(self.chosen)
        if self.complete:
            found.append("The poses taken show everything that poses at rest can show.")
            return [*found, "The one more pose that would help most:"]
        needed = "One more pose is" if count == 1 else f"{count} more poses are"
        return [*found, f"{needed} needed for {_listed(self.missing)}, for example:"]

    def pose_rows(self) -> list[tuple[str, ...]]:
        """The chosen poses in words, and the quaternion x y z w where the motion is one."""
        columns = self.poses.columns
        quaternions = "qw" in columns
        rows: list[tuple[str, ...]] = []
        for i in self.chosen:
            numbers = " ".join(f"{values[i] + 0.0:.4f}" for values in columns.values())
            rows.append((self.poses.words[i], numbers) if quaternions else (self.poses.words[i],))
        return rows

    def rows(self) -> list[tuple[str, ...]]:
        """Name, std now, std with the chosen poses, and unit of what poses can show, as text."""
        units = {p.name: p.unit for p in self.fit.layout.parameters if p.name not in self.never}
        return [(name, _std(self.before[name]), _std(self.after[name]), unit) for name, unit in units.items()]

    def __str__(self) -> str:
        header = ("sensor", "qx qy qz qw") if "qw" in self.poses.columns else ("pose",)
        stds = table(("parameter", "std now", "std then", "unit"), self.rows())
        return "\n".join([*self.sentences(), table(header, self.pose_rows()), stds])


def whitened(fitted: Fit, number: int, poses: RestPoses) -> Array:
    """Derivative (n, p, k) of the readings at poses in all unknowns of a fit, over the noise floor of a recording."""
    fitted.layout.models[number].require_direct("pose advice")
    index, model = fitted.layout.index[number], compiled(fitted.layout.models[number])
    parts = (e.tangent(poses.signals, fitted.theta[index], len(poses))[1] for e in (model.load, model.zero))
    rows = np.zeros((len(poses), len(fitted.recordings[number].channels), fitted.layout.size))
    rows[:, :, index] = sum(parts) / fitted.noise[number].floor[:, None]
    return rows


def _chosen(root: Array, rows: Array, ever: Sight) -> tuple[int, ...]:
    """Poses one by one until the rank of all is reached; one when it is already."""
    seen = ever.seen
    axes = ever.right[seen].T / ever.singular[seen] / ever.scale[:, None]
    information = (root @ axes).T @ (root @ axes) + NOTHING * np.eye(int(seen.sum()))
    steps, chosen = rows @ axes, list[int]()
    while not chosen or _sight([root, *rows[chosen]]).seen.sum() < seen.sum():
        spread = steps @ np.linalg.solve(information, np.swapaxes(steps, 1, 2))
        best = int(np.argmax(np.linalg.slogdet(np.eye(rows.shape[1]) + spread)[1]))
        chosen.append(best)
        information = information + steps[best].T @ steps[best]
    return tuple(chosen)


def _sight(parts: Sequence[Array]) -> Sight:
    """What rows (., k) stacked show."""
    stacked = np.concatenate(parts)
    missing = max(0, stacked.shape[1] - len(stacked))
    return Sight.of(np.asarray(np.linalg.qr(np.pad(stacked, ((0, missing), (0, 0))), mode="r")), ROUNDING)


def _at_rest(fitted: Fit) -> int:
    """The number of the first recording of poses."""
    for number, recording in enumerate(fitted.recordings):
        if recording.at_rest:
            return number
    raise InputError(
        what="no recording is of poses at rest",
        where=", ".join(r.name for r in fitted.recordings),
        remedy="give a recording without a time column, one row a pose",
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


def _std(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "not shown"
