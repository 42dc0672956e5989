"""Static poses that a rig can take, and which to record next for what is not yet identifiable: sequential D-optimal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.fit import Fit
from estimation.model_response import with_loads
from estimation.recordings.motion import QUATERNION, MotionForm, numbered_names
from estimation.recordings.recording import Recording
from modeling.chain.prediction import compiled_prediction
from modeling.chain.sensor_axes import is_turned
from modeling.errors import InputError
from modeling.identifiability import ScaledSVD
from modeling.kinematics.arm import Arm, PlanarArm
from modeling.kinematics.placement import base_angle, base_placement
from modeling.number_format import NOT_IDENTIFIABLE
from modeling.rig import Rig, Workspace
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]

PRIOR_INFORMATION_SHARE = 1e-9
"""Prior information on unidentifiable directions, as a share of that of all poses together: so little that a pose
which makes a direction identifiable always precedes one that only reduces variances."""
ANGLE_STEP = 5
"""Degrees between planar poses: a criterion in sin and cos of the angle is within cos 2.5° of its optimum."""
DISPLAY_UNITS = {"rad": (180 / np.pi, "°"), "m": (1000.0, " mm")}
"""Display unit of a joint: factor from SI, and symbol."""
POSTURE_SAMPLES = 512
"""Postures of an arm, evenly over the box of its limits (Sobol, a power of two): tip angles 1° apart."""


@dataclass(frozen=True, eq=False)
class PoseAdvice(Tabular):
    r"""Identifiability from static poses, and the further poses that complete it.

    `of` gives it for a fit; InputError when none of its recordings is of static poses.

    Parameters
    ----------
    fit : Fit
        The fit, with at least one recording of static poses.
    poses : CandidatePoses
        Poses of the rig to choose from.
    never : tuple of str
        Parameters not identifiable from the recordings and any static poses.
    missing : tuple of str
        Parameters not identifiable from the recordings, but with further static poses.
    chosen : tuple of int
        Indices in `poses` of the poses chosen until all these are identifiable; the most informative one if none is
        missing.
    after : mapping of str to float
        Std of every unknown with the chosen poses added, each once, in its unit; infinite where not identifiable.

    Examples
    --------
    >>> import truewrench as tw
    >>> rows = [f"0.5,{-4.3 + 0.1 * (i % 2)},{-7.9 + 0.1 * (i % 3)},{-0.5 - 0.01 * (i % 2)}" for i in range(8)]
    >>> with open("poses.csv", "w") as file:  # one pose, eight readings
    ...     print("phi,fx,fy,tau", *rows, sep="\n", file=file)
    >>> advice = tw.PoseAdvice.of(tw.fit(tw.planar(), tw.read("poses.csv")))
    >>> advice.never, advice.missing, len(advice.chosen)
    (('I',), ('bias_fx', 'bias_fy', 'bias_tau', 'm', 'mlg'), 1)
    """

    fit: Fit
    poses: CandidatePoses
    never: tuple[str, ...]
    missing: tuple[str, ...]
    chosen: tuple[int, ...]
    after: Mapping[str, float]

    @classmethod
    def of(cls, fitted: Fit) -> PoseAdvice:
        """Advice for the rig of the fit's first recording of static poses, with the zero and noise of that recording.

        With A the whitened sensitivity of the recordings and r_i (p, k) that of a pose, all that is identifiable is
        the row space of A and all r_i together. In it poses are chosen one by one, each to maximise det(A'A + sum r'r)
        (sequential D-optimality: Fedorov, Theory of Optimal Experiments, 1972), until the rank is reached;
        `PRIOR_INFORMATION_SHARE` regularises the first steps.
        Raises InputError when no recording is of static poses.
        """
        number = _first_static_recording(fitted)
        poses = CandidatePoses.of(fitted.recordings[number])
        recorded = fitted.problem.evaluate(fitted.theta)[1]
        root, rows = np.asarray(np.linalg.qr(recorded, mode="r")), whitened_pose_sensitivity(fitted, number, poses)
        all_poses = stacked_svd([root, *rows])
        chosen = _sequential_d_optimal(root, rows, all_poses)
        after, now = stacked_svd([root, *rows[list(chosen)]]), stacked_svd([root])
        names = [p.name for p in fitted.layout.parameters]
        std = np.where(after.identifiable, np.sqrt(np.diag(after.covariance)), np.inf)
        return cls(
            fitted,
            poses,
            tuple(n for n, identifiable in zip(names, all_poses.identifiable, strict=True) if not identifiable),
            tuple(
                n
                for n, later, before in zip(names, all_poses.identifiable, now.identifiable, strict=True)
                if later and not before
            ),
            chosen,
            dict(zip(names, std.tolist(), strict=True)),
        )

    @property
    def complete(self) -> bool:
        """Whether all that static poses can identify is identifiable already."""
        return not self.missing

    @cached_property
    def before(self) -> Mapping[str, float]:
        """Std of every unknown in the fit; infinite where not identifiable."""
        return {name: estimate.std for name, estimate in self.fit.parameters.items()}

    def sentences(self) -> list[str]:
        """The advice as sentences."""
        never = ", ".join(name for name in self.never if not name.startswith("bias_"))  # of a channel that is left out
        scaled = any(effect.scales_mass for effect in self.fit.model.effects)
        how = "only from motion or with known loads" if scaled else "only from motion"
        advice = [f"Not identifiable from static poses, {how}: {never}."] if never else []
        count = len(self.chosen)
        if self.complete:
            advice.append("All that static poses can identify is identifiable from the recorded poses.")
            return [*advice, "The most informative further pose:"]
        needed = "One more pose is" if count == 1 else f"{count} more poses are"
        return [*advice, f"{needed} needed for {', '.join(self.missing)}, for example:"]

    @property
    def pose_table(self) -> Table:
        """Descriptions of the chosen poses, with the quaternion x y z w where the motion is recorded as one."""
        columns = self.poses.columns
        if "qw" not in columns:
            return Table.of(["pose"], [(self.poses.words[i],) for i in self.chosen])
        numbers = (" ".join(f"{values[i] + 0.0:.4f}" for values in columns.values()) for i in self.chosen)
        frame = "axes of the logged pose" if is_turned(self.fit.model) else "sensor"
        return Table.of([frame, "qx qy qz qw"], zip((self.poses.words[i] for i in self.chosen), numbers, strict=True))

    @property
    def table(self) -> Table:
        """Name, std now, std with the chosen poses, and unit of what static poses can identify."""
        identifiable = [p for p in self.fit.layout.parameters if p.name not in self.never]
        stds = (Column(n, format=".2g", unknown=NOT_IDENTIFIABLE) for n in ("std now", "std with these poses"))
        rows = [(p.name, self.before[p.name], self.after[p.name], p.unit) for p in identifiable]
        return Table.of(("parameter", *stds, "unit"), rows)

    def printed(self) -> list[Table | str]:
        """Advice, poses, stds."""
        return [*self.sentences(), self.pose_table, self.table]


def whitened_pose_sensitivity(fitted: Fit, number: int, poses: CandidatePoses) -> Array:
    """Derivative (n, p, k) of the readings at poses in all unknowns of a fit, over the noise std of a recording.

    The sensor carries what it did in that recording.
    """
    fitted.layout.models[number].require_direct("pose advice")
    index, model = fitted.layout.index[number], compiled_prediction(fitted.layout.models[number])
    theta = with_loads(fitted.layout.models[number], fitted.recordings[number].loads, fitted.theta[index])
    parts = (e.tangent(poses.signals, theta, len(poses))[1] for e in (model.load, model.bias))
    rows = np.zeros((len(poses), len(fitted.recordings[number].channels), fitted.layout.size))
    rows[:, :, index] = sum(parts) / fitted.noise[number].floor[:, None]
    rows[:, fitted.noise[number].left_out] = 0.0
    return rows


def _sequential_d_optimal(root: Array, rows: Array, all_poses: ScaledSVD) -> tuple[int, ...]:
    """Poses one by one until the rank with all poses is reached; one pose when it is reached already."""
    resolved = all_poses.regular
    axes = all_poses.right[resolved].T / all_poses.singular[resolved] / all_poses.scale[:, None]
    information = (root @ axes).T @ (root @ axes) + PRIOR_INFORMATION_SHARE * np.eye(int(resolved.sum()))
    sensitivities, chosen = rows @ axes, list[int]()
    while not chosen or stacked_svd([root, *rows[chosen]]).regular.sum() < resolved.sum():
        variance = sensitivities @ np.linalg.solve(information, np.swapaxes(sensitivities, 1, 2))
        best = int(np.argmax(np.linalg.slogdet(np.eye(rows.shape[1]) + variance)[1]))
        chosen.append(best)
        information = information + sensitivities[best].T @ sensitivities[best]
    return tuple(chosen)


def stacked_svd(parts: Sequence[Array]) -> ScaledSVD:
    """Scaled SVD of stacked rows (., k)."""
    stacked = np.concatenate(parts)
    missing = max(0, stacked.shape[1] - len(stacked))
    return ScaledSVD.of(np.asarray(np.linalg.qr(np.pad(stacked, ((0, missing), (0, 0))), mode="r")))


def _first_static_recording(fitted: Fit) -> int:
    """Index of the first recording of static poses."""
    for number, recording in enumerate(fitted.recordings):
        if recording.at_rest:
            return number
    raise InputError(
        what="no recording is of static poses",
        where=", ".join(r.name for r in fitted.recordings),
        remedy="give a recording without a time column, one row per pose",
    )


# ---------------------------------------------------------------------------- poses that a rig can take


@dataclass(frozen=True, eq=False)
class CandidatePoses:
    """n static poses.

    columns   the commanded motion as recording columns: phi (rad), q1.. (rad) or qx, qy, qz, qw, each (n,)
    signals   all input signals of a model there, each (n,)
    words     description of each pose
    """

    columns: Mapping[str, Array]
    signals: Mapping[str, Array]
    words: tuple[str, ...]

    @classmethod
    def of(cls, recording: Recording) -> CandidatePoses:
        """Poses for the rig of a recording, in the form of its motion: tip angles every 5°, joint angles within the
        limits in whole degrees, or the 26 orientations with each sensor axis level or tilted, the tilted ones equally.

        Other signals (a position, a temperature) stay at their last value.
        Raises InputError when the tip is inside the workspace at none of the poses.
        """
        candidates = {MotionForm.PLANAR_POSE: _tip_angles, MotionForm.JOINTS: _postures, MotionForm.POSE: _orientations}
        columns, kinematic, words = candidates[recording.form](recording)
        count = len(words)
        others = {name: np.full(count, values[-1]) for name, values in recording.motion.model_signals.items()}
        return cls(columns, others | kinematic, words)

    def __len__(self) -> int:
        return len(self.words)


PosesAndDescriptions = tuple[dict[str, Array], dict[str, Array], tuple[str, ...]]


def _tip_angles(recording: Recording) -> PosesAndDescriptions:
    degrees = np.arange(-180 + ANGLE_STEP, 180 + ANGLE_STEP, ANGLE_STEP)
    signals, rig = {"phi": np.deg2rad(degrees)}, recording.rig or Rig()
    base = 0.0 if rig.gravity_direction is None else base_angle(rig.gravity_direction)
    return {"phi": signals["phi"] - base}, signals, tuple(f"phi = {angle}°" for angle in degrees)


def _postures(recording: Recording) -> PosesAndDescriptions:
    rig, arm = recording.rig or Rig(), recording.arm or PlanarArm(())
    limits = np.tile([-np.pi, np.pi], (arm.joints, 1))
    if rig.position_limits is not None:
        limits = np.where(np.isfinite(rig.position_limits), rig.position_limits, limits)
    factors = np.array([DISPLAY_UNITS[unit][0] for unit in arm.units])
    low, high = np.ceil(factors * limits[:, 0]), np.floor(factors * limits[:, 1])
    from scipy.stats import qmc  # a third of the time of a `fit`, which rarely advises postures

    cube = qmc.Sobol(arm.joints, scramble=False).random(POSTURE_SAMPLES)
    q = np.unique(np.round(low + cube * (high - low)), axis=0) / factors
    pose = arm.pose(q, np.zeros_like(q), np.zeros_like(q))
    inside = _inside(rig, arm, q)
    if not inside.any():
        raise InputError(
            what="the tip is outside the workspace at all candidate postures within the joint limits",
            where=rig.name or recording.name,
            remedy="correct [workspace] or [limits] in the rig",
        )
    names = numbered_names("q", arm.joints)
    columns = dict(zip(names, q[inside].T, strict=True))
    signs = [DISPLAY_UNITS[unit][1] for unit in arm.units]
    words = tuple(
        ", ".join(f"{n} = {count:.0f}{sign}" for n, count, sign in zip(names, row, signs, strict=True))
        for row in q[inside] * factors
    )
    return columns, columns | {name: values[inside] for name, values in pose.items()}, words


def _inside(rig: Rig, arm: Arm, q: Array) -> NDArray[np.bool_]:
    """Whether the tip is inside the workspace."""
    inside, tip = np.ones(len(q), dtype=bool), np.array(arm.tip(rig.tip_length or 0.0)(q.T))
    workspace = Workspace() if rig.workspace is None else rig.workspace
    for axis, place in zip(arm.space.axes, tip, strict=True):
        span = getattr(workspace, axis)
        inside &= True if span is None else (place >= span[0]) & (place <= span[1])
    return inside


def _orientations(recording: Recording) -> PosesAndDescriptions:
    """The vertical in the sensor frame along the 26 directions to a cube's faces, edges and corners."""
    upward = np.array([d for d in product((1, 0, -1), repeat=3) if any(d)], dtype=float)
    quaternions = np.stack([_rotation_to_vertical(d).as_quat() for d in upward])
    signals, rig = dict(zip(QUATERNION, quaternions.T, strict=True)), recording.rig or Rig()
    if rig.gravity_direction is None:
        return signals, signals, tuple(axes_in_words(d) for d in upward)
    base = Rotation.from_quat(base_placement(rig.gravity_direction).quaternion)
    commanded = (base.inv() * Rotation.from_quat(quaternions)).as_quat()
    return dict(zip(QUATERNION, commanded.T, strict=True)), signals, tuple(axes_in_words(d) for d in upward)


def _rotation_to_vertical(direction: Array) -> Rotation:
    """The rotation of least angle that takes a direction in the sensor frame to the world's z."""
    x, y, z = direction / np.linalg.norm(direction)
    axis, sine = np.array([y, -x, 0.0]), np.hypot(x, y)
    axis = axis / sine if sine else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(axis * np.arctan2(sine, z))


def axes_in_words(upward: Array) -> str:
    """Where the sensor's axes point when `upward` (3,), entries 1, 0 and -1, is up: `x 45° up, y 45° down, z level`."""
    tilt = round(float(np.rad2deg(np.arcsin(1 / np.linalg.norm(upward)))))
    angle = "" if tilt == 90 else f"{tilt}° "
    names = {way: [axis for axis, d in zip("xyz", upward, strict=True) if d == way] for way in (1, -1, 0)}
    ways = {1: f"{angle}up", -1: f"{angle}down", 0: "level"}
    return ", ".join(f"{' and '.join(axes)} {ways[way]}" for way, axes in names.items() if axes)
