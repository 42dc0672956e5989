"""Noise of poses at rest from what no smooth function of the pose explains, where the model's own residual is more."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import chi2_sf, f_sf, student_sf
from estimation.noise.recording_noise import RecordingNoise, without_constant_channels
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import POSITION, in_sensor_frame
from modeling.noise import NoiseModel, NoiseSource
from modeling.significance import LEVELS

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FEWEST_LEFT = 6
"""Degrees of freedom that generic columns leave to the noise: with fewer its std is known to no better than 30 %, and
an F test needs a residual of ten times the noise."""
DEPENDENT = 1e-6
"""Length that a column of unit length keeps beside others, below which it is one of them."""
TAILS = 4.0
"""Degrees of freedom of Student's t that the noise of poses is granted, so that of normal noise nothing is named. With
tails that heavy one reading in a hundred is beyond 3.3 of its std, and belongs to the others all the same."""
POSES_FOR_ONE = 6
"""Poses for each that is named, at the least: where more of them deviate, it is the model that does not fit."""
FARTHEST_ORDINARY = 5.0
"""Times the noise that a channel of a pose may be off: leaving out what is no farther changes no estimate by much."""
SMALLEST_P_VALUE = 1e-300
"""So that its logarithm is finite."""
EXPLAINED_ROW = 1e-6
"""Share of a row that columns leave free, below which they pass through it whatever it is."""
ROUNDING = 1e-9
"""Std of a channel over its residual, below which it is rounding: a channel that never changes has no noise."""


@dataclass(frozen=True, eq=False)
class PoseRegression:
    """Readings (n, p) of poses regressed on columns (n, k) of them: a constant, and gravity's direction."""

    columns: Array
    readings: Array

    def of(self, rows: Rows) -> PoseRegression:
        """Of these poses alone."""
        return PoseRegression(self.columns[rows], self.readings[rows])

    def expected_by(self, rows: Rows) -> Array:
        """Readings (n, p) that these poses let expect."""
        return np.asarray(self.columns @ self._slopes_by(rows))

    def weight_by(self, rows: Rows, forces: Sequence[bool]) -> float:
        """Weight (N) by these poses: each force is that times a unit vector's product with gravity's direction."""
        slopes = self._slopes_by(rows)[1:, forces]
        return float(np.sqrt((slopes**2).sum() / max(1, len(slopes))))

    def _slopes_by(self, rows: Rows) -> Array:
        return np.asarray(np.linalg.lstsq(self.columns[rows], self.readings[rows], rcond=None)[0])

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis (n, r) of the columns."""
        return _basis(self.columns)

    @cached_property
    def residual(self) -> Array:
        """Readings (n, p) beside the columns."""
        return np.asarray(self.readings - self.basis @ (self.basis.T @ self.readings))

    @property
    def freedom(self) -> int:
        """Degrees of freedom that are left without one row."""
        return len(self.readings) - int(self.basis.shape[1]) - 1

    @property
    def std(self) -> Array:
        """Std (p,) of the noise."""
        squares = (self.residual**2).sum(axis=0) / (self.freedom + 1)
        return np.asarray(np.sqrt(np.maximum(squares, np.finfo(float).eps * (self.readings**2).mean(axis=0))))

    @cached_property
    def deviation(self) -> Array:
        """Of each row (n, p) from what the others let expect, over its std by them."""
        share = 1 - (self.basis**2).sum(axis=1)
        own = self.residual**2 / np.where(share > EXPLAINED_ROW, share, np.inf)[:, None]
        others = np.maximum((self.residual**2).sum(axis=0) - own, self.std**2 * np.finfo(float).eps) / self.freedom
        return np.asarray(np.sqrt(own / others))

    @cached_property
    def p_values(self) -> Array:
        """Of each row (n,): of its channels together (Fisher), and of the one that deviates most."""
        size = self.deviation
        each = 2 * np.maximum(student_sf(size, self.freedom), student_sf(size * np.sqrt(TAILS / (TAILS - 2)), TAILS))
        together = -2 * np.log(np.maximum(each, SMALLEST_P_VALUE)).sum(axis=1)
        alone = each.shape[1] * each.min(axis=1)
        return np.asarray(np.minimum(1.0, 2 * np.minimum(chi2_sf(together, 2 * each.shape[1]), alone)))

    @cached_property
    def outlying(self) -> tuple[Rows, float]:
        """Rows that do not belong to the others, in order, and the p-value of the most likely: none, and 1.

        One row after the other is left out, the least likely first, up to one of `POSES_FOR_ONE`. Those up to the last
        significant one do not belong, as two that are alike hide each other (Rosner, Technometrics 25, 1983).
        """
        rest, kept, named, p_value = self, np.arange(len(self.readings)), 0, 1.0
        left_out: list[int] = []
        while self.readings.shape[1] and len(left_out) < len(self.readings) // POSES_FOR_ONE:
            if rest.freedom < FEWEST_LEFT:
                break
            worst = int(np.argmin(rest.p_values))
            left_out.append(int(kept[worst]))
            family_wise, size = len(kept) * float(rest.p_values[worst]), float(rest.deviation[worst].max())
            kept = np.delete(kept, worst)
            rest = self.of(kept)
            if family_wise < LEVELS.misread and size > FARTHEST_ORDINARY:
                named, p_value = len(left_out), min(p_value, family_wise)
        return np.sort(np.array(left_out[:named], dtype=np.intp)), p_value


@dataclass(frozen=True, eq=False)
class PoseNoise:
    """What generic columns of the pose leave of a residual.

    std      (p,) of each channel, in its unit
    freedom  degrees of freedom of each std
    p_value  that the residual depends on the pose no more than noise does, family-wise over channels and columns
    """

    std: Array
    freedom: int
    p_value: float

    @classmethod
    def of(cls, recording: Recording, residual: Array) -> PoseNoise | None:
        """The noise of poses at rest from the residual (n, p) of a model; None of too few poses to tell.

        The residual is regressed on gravity's direction, which every rigid tool is linear in, and on further groups of
        columns: the most significant is added, by an F test of each channel, as long as one is. The noise is that which
        the larger model leaves, so that what a model lacks does not hide in it. Then gravity's direction is tested
        itself. Of that the model has fitted a part, at least the zero: two degrees of freedom may be taken for one,
        which makes its p-value too large rather than too small. It holds where the model was fitted in the noise that
        there is; the other p-values hold for every residual of a rigid tool. Poses that do not belong to the others
        have no part in it, and are a residual that is no noise either.
        """
        read, affine = residual[:, np.ptp(recording.wrench, axis=0) > 0], affine_columns(recording)
        outlying, of_rows = PoseRegression(affine, read).outlying
        kept = np.setdiff1d(np.arange(len(read)), outlying)
        read, basis = read[kept], _basis(affine[kept])
        n, p = read.shape
        if basis.shape[1] > n - FEWEST_LEFT or not p:
            return None
        groups = [group[kept] for group in _groups(recording)]
        wider, zero, of_direction, smallest = _wider(basis, groups), _basis(np.ones((n, 1))), basis, 1.0
        tests = p * (1 + len(wider))
        while wider:
            p_values = [min(_p_values(read, basis, trial, trial)) for trial in wider]
            best = int(np.argmin(p_values))
            smallest = min(smallest, p_values[best])
            if tests * p_values[best] >= LEVELS.effect:
                break
            basis = wider[best]
            wider = _wider(basis, groups)
        smallest = min(smallest, *_p_values(read, zero, of_direction, basis))
        left, freedom = residual[kept] - basis @ (basis.T @ residual[kept]), n - int(basis.shape[1])
        std = np.sqrt((left**2).sum(axis=0) / freedom)
        return cls(np.maximum(std, ROUNDING * std.max()), freedom, min(1.0, tests * smallest, of_rows))

    @property
    def is_below_residual(self) -> bool:
        """Whether the residual depends on the pose, so that not all of it is noise."""
        return self.p_value < LEVELS.effect


def noise_beside_pose(recording: Recording, residual: Array, noise: RecordingNoise) -> RecordingNoise:
    """The noise of poses at rest, which was taken from a residual (n, p), where that depends on the pose; else itself.

    It is white then, of the std that no function of the pose explains.
    """
    if noise.source is not NoiseSource.RESIDUAL or not recording.at_rest:
        return noise
    beside = PoseNoise.of(recording, residual)
    if beside is None or not beside.is_below_residual:
        return noise
    whitener = AutoregressiveWhitener(recording.samples, NoiseModel.white(beside.std))
    white = replace(noise, floor=beside.std, whitener=whitener, beside_pose=True)
    variance = np.full(whitener.rows, 2 / beside.freedom)
    return without_constant_channels(replace(white, log_power_variance=variance), recording)


def affine_columns(recording: Recording) -> Array:
    """A constant, and gravity's direction in the sensor: columns (n, k) that span what any rigid tool reads at rest.

    Whatever gains, signs, axes and units its readings have.
    """
    signals = recording.signals
    if recording.dimension == 2:
        turned = np.column_stack([np.sin(signals["phi"]), np.cos(signals["phi"])])
    else:
        turned = in_sensor_frame(signals, (0.0, 0.0, -1.0))
    return np.column_stack([np.ones(recording.samples), turned])


def _groups(recording: Recording) -> Iterator[Array]:
    """Further columns (n, k) of the pose: what bends with the load, what drifts, what turns with the base, a tether."""
    signals, turned = recording.signals, affine_columns(recording)[:, 1:]
    across = range(turned.shape[1])
    yield np.stack([turned[:, i] * turned[:, j] for i in across for j in across if i <= j], axis=1)
    yield turned**3
    order = np.linspace(-1.0, 1.0, recording.samples)
    yield np.stack([order, order**2], axis=1)
    if recording.dimension == 3:
        yield np.concatenate([in_sensor_frame(signals, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))], axis=1)
    position = [signals[name] for name in POSITION if name in signals]
    if position:
        yield np.stack(position, axis=1)


def _wider(basis: Array, groups: Iterable[Array]) -> list[Array]:
    """The basis (n, r) with each group that is not in it and leaves enough to the noise."""
    wider = (_basis(np.column_stack([basis, group])) for group in groups)
    return [trial for trial in wider if basis.shape[1] < trial.shape[1] <= len(basis) - FEWEST_LEFT]


def _basis(columns: Array) -> Array:
    """Orthonormal basis (n, r) of columns (n, k), without what is rounding."""
    size = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(left[:, values > DEPENDENT])


def _p_values(residual: Array, basis: Array, larger: Array, largest: Array) -> list[float]:
    """Of each channel that a larger basis explains no more of a residual (n, p) than the noise beside the largest."""
    before, after, left = (((residual - q @ (q.T @ residual)) ** 2).sum(axis=0) for q in (basis, larger, largest))
    more, freedom = larger.shape[1] - basis.shape[1], len(residual) - largest.shape[1]
    left = np.where(left > ROUNDING**2 * (residual**2).sum(axis=0), left, np.inf)
    return [float(p) for p in f_sf((before - after) / more / (left / freedom), more, freedom)]
