"""Contact wrench of the environment on the tool, sample by sample, with its covariance (22.13 corrected).

Equation numbers: chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators"
(Bassi et al.).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from estimation.autoregression import fit_autoregression
from estimation.case import prepared
from estimation.contact.contact_detection import (
    ContactDetection,
    ContactInterval,
    MeanDifferences,
    VarianceOfMeans,
    detect_contacts,
)
from estimation.fit import Fit, require_recording
from estimation.least_squares.estimates import EstimatedModel, fixed_parameters
from estimation.model_response import ModelResponse, model_response, predicted_readings
from estimation.multiplicity import chi2_sf
from estimation.recordings.recording import Recording
from estimation.streaming.streamed_fit import StreamedFit
from modeling.chain.model import WrenchModel
from modeling.chain.sensor_axes import (
    Axes,
    axes_named,
    contact_gain_at,
    contact_turn,
    group_delay,
    is_turned,
    pose_to_base,
    sensor_to_pose,
    turn_words,
)
from modeling.errors import InputError, kind_of
from modeling.noise import NoiseSource, block_means
from modeling.number_format import P_VALUE, plain_number
from modeling.rigid_body import contact_components
from modeling.significance import LEVELS
from modeling.space import FORCE_UNIT, Space
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointForce:
    """A force (n, 2) in N along x' and y', with covariance (n, 2, 2), that acts at one point of the tip.

    misfit    (n,) chi-square, one degree of freedom, of the torque's residual; nan without a tip length
    """

    force: Array
    covariance: Array
    misfit: Array

    @classmethod
    def of(cls, wrench: Array, covariance: Array, weight: Array, distance: float | None) -> PointForce:
        """The force that fits contact wrenches (n, 3) = (fcx, fcy, tauc) best.

        22.14 in the tip frame, with the signs of a contact on the tool: a force K (sin b, cos b) at `distance` d (m)
        from the sensor along the tip is (fcx, fcy, tauc) = (K sin b, K cos b, K d sin b). That is linear in
        s = (K sin b, K cos b), wrench = H s with H = [[1, 0], [0, 1], [d, 0]], so that least squares weighted with the
        inverse W of the channels' noise covariance `weight` (3, 3) has the closed form s = (H' W H)^-1 H' W wrench.
        With W = 1 it is s = ((fcx + tauc d) / (1 + d²), fcy): PHYSICS.md, errata 3, 4 and 7. `covariance` (n, 3, 3) is
        that of the wrenches, whatever it comes from. Without a distance the torque is not used: s = (fcx, fcy).
        """
        if distance is None:
            return cls(wrench[:, :2], covariance[:, :2, :2], np.full(len(wrench), np.nan))
        arm = np.array([[1.0, 0.0], [0.0, 1.0], [distance, 0.0]])
        inverse = np.linalg.inv(weight)
        gain = np.linalg.solve(arm.T @ inverse @ arm, arm.T @ inverse)
        residual = wrench - wrench @ gain.T @ arm.T
        return cls(wrench @ gain.T, gain @ covariance @ gain.T, np.einsum("ni,ij,nj->n", residual, inverse, residual))

    def turned(self, turn: Array) -> PointForce:
        """The force along other axes than the tip's, by rotations (2, 2) or (n, 2, 2) of its components."""
        force = (turn @ self.force[:, :, None])[:, :, 0]
        return PointForce(force, turn @ self.covariance @ np.swapaxes(turn, -1, -2), self.misfit)

    @cached_property
    def magnitude(self) -> Array:
        """Size of the force, N (n,)."""
        return np.asarray(np.hypot(self.force[:, 0], self.force[:, 1]))

    @cached_property
    def direction(self) -> Array:
        """Angle of the force from y', clockwise, rad (n,), in (-pi, pi]."""
        return np.arctan2(self.force[:, 0], self.force[:, 1])

    @cached_property
    def magnitude_std(self) -> Array:
        """Standard deviation along the force, N (n,)."""
        return std_along(self.covariance, self._unit)

    @cached_property
    def direction_std(self) -> Array:
        """Standard deviation across the force over its size, rad (n,); valid for forces large against it."""
        across = np.stack([self._unit[:, 1], -self._unit[:, 0]], axis=1)
        return np.asarray(std_along(self.covariance, across) / np.maximum(self.magnitude, 1e-300))

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Whether the size is at least twice its standard deviation: only then is its direction defined."""
        return np.asarray(self.magnitude >= 2 * self.magnitude_std)

    @cached_property
    def _unit(self) -> Array:
        size = np.maximum(self.magnitude, 1e-300)[:, None]
        return np.where(self.magnitude[:, None] > 0, self.force / size, np.array([0.0, 1.0]))


def std_along(covariance: Array, direction: Array) -> Array:
    """Standard deviations (n,) along directions (n, d) of vectors with covariances (n, d, d)."""
    return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", direction, covariance, direction)))


@dataclass(frozen=True, eq=False)
class ContactMean:
    """Mean contact wrench over a detected interval, its forces, and its force at the tip.

    wrench         (p,) mean of the components, N and N m; `covariance` (p, p): noise of that mean, parameters, zero and
                   the model's systematic residual
    force          N, size of the mean force; `largest_force` that of one sample, with its noise
    tip_force      N, size of the point force at the tip that fits `wrench` best; nan without a tip length
    tip_p_value    of the chi-square test that a force at the tip explains `wrench`; nan without a tip length
    """

    interval: ContactInterval
    wrench: Array
    covariance: Array
    force: float
    largest_force: float
    tip_force: float
    tip_p_value: float

    @property
    def std(self) -> Array:
        """Std (p,) of the mean of each component."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, eq=False)
class ContactSeries:
    """Contact wrenches of a recording, and what the means of its intervals need.

    wrench      (n, p); `systematic` (n, p, p) covariance from parameters and zero; `noise` of one sample, (p, p) or in
                base axes (n, p, p)
    inverse     from reading to contact wrench, of the same shape; `remainder` (p,) systematic residual of the readings
    forces      number of components that are forces, which come first
    tip_length  m, of a planar contact; None for none
    """

    wrench: Array
    systematic: Array
    noise: Array
    inverse: Array
    remainder: Array
    detection: ContactDetection
    forces: int
    tip_length: float | None

    def mean(self, interval: ContactInterval) -> ContactMean:
        """The mean over one interval."""
        inside = slice(interval.first, interval.last)
        wrench, systematic = self.wrench[inside].mean(axis=0), self.systematic[inside].mean(axis=0)
        blocks = self.detection.blocks(interval.last - interval.first)
        inverse = self.inverse if self.inverse.ndim == 2 else self.inverse[inside]
        noise = inverse @ self.detection.noise.covariance(blocks) @ np.swapaxes(inverse, -1, -2)
        covariance = systematic + (noise if noise.ndim == 2 else noise.mean(axis=0))
        size = np.linalg.norm(self.wrench[inside, : self.forces], axis=1)
        tip_force, p_value = self._tip_force(wrench, covariance, systematic, blocks)
        return ContactMean(
            interval=interval,
            wrench=wrench,
            covariance=covariance,
            force=float(np.linalg.norm(wrench[: self.forces])),
            largest_force=float(size.max()),
            tip_force=tip_force,
            tip_p_value=p_value,
        )

    def _tip_force(self, wrench: Array, covariance: Array, systematic: Array, blocks: int) -> tuple[float, float]:
        """Size of the force at the tip that fits a mean wrench, and the p-value of what the fit leaves.

        A force at d along the tip is (fcx, fcy, tauc) = H s with H = [[1, 0], [0, 1], [d, 0]] (22.14 corrected). v =
        (-d, 0, 1) is orthogonal to H, so that the chi-square of the residual of the weighted fit, with one degree of
        freedom, is (v' wrench)² over the variance of v' wrench. That variance is estimated from the series v' wrench of
        the samples without contact: correlation between the channels, colour of the noise and few samples included.
        """
        if self.tip_length is None:
            return np.nan, np.nan
        fitted = PointForce.of(wrench[None], covariance[None], self.noise, self.tip_length)
        contrast = np.array([-self.tip_length, 0.0, 1.0])
        variance = float(contrast @ systematic @ contrast) + self._noise_of_mean(contrast, blocks)
        return float(fitted.magnitude[0]), float(chi2_sf(float(contrast @ wrench) ** 2 / variance, 1.0))

    def _noise_of_mean(self, contrast: Array, blocks: int) -> float:
        """Variance of the mean of `contrast @ wrench` over so many blocks, by noise and systematic residual."""
        detection = self.detection
        means = block_means(self.wrench @ contrast[:, None], detection.block)
        quiet = block_means(detection.free[:, None].astype(float), detection.block)[:, 0] > 1 - 1e-9
        if quiet.sum() < 2:
            return float(contrast @ self.noise @ contrast)
        constant = np.atleast_1d((contrast @ self.inverse) ** 2 @ self.remainder**2)
        fitted = fit_autoregression(means - means[quiet].mean(axis=0), quiet)
        noise = VarianceOfMeans.of_autoregression(fitted, len(means), constant).at_least(
            MeanDifferences.of(means, quiet).variance_of_means(constant)
        )
        return float(noise.covariance(min(blocks, len(means)))[0, 0])


SEGMENTS_PER_RUN = 50
"""Segments of a single run whose means estimate the slow part of its residual; each averages the sensor's noise."""


@dataclass(frozen=True, eq=False)
class CalibratedModel:
    """A model, its parameters with covariance, and its noise and systematic residual where it was fitted.

    theta       (k,) in the model's order; biases are those of the first recording
    covariance  (k, k); an unidentifiable parameter has an infinite variance and zero covariances, a fixed one zeros
    floor       (p,) std of one sample, in the channels' units
    remainder   (p,) RMS of the systematic residual: the part that noise does not explain
    contributions   what the covariance is the sum of, by name, where it is that of a budget
    alternatives    models that a diagnosis could not tell apart from this one
    """

    model: WrenchModel
    theta: Array
    covariance: Array
    floor: Array
    remainder: Array
    contributions: Mapping[str, Array] = field(default_factory=dict)
    alternatives: tuple[Alternative, ...] = ()

    @classmethod
    def of(cls, fitted: Fit | StreamedFit) -> Self:
        """From a fit, with the biases of its first recording and the largest systematic residual over recordings.

        Of a streamed fit it is the noise std times sqrt(reduced chi-square - 1).
        """
        size = len(fitted.model.parameters)
        covariance = fitted.covariance[:size, :size].copy()
        unidentifiable = ~fitted.identifiable[:size]
        covariance[unidentifiable], covariance[:, unidentifiable] = 0.0, 0.0
        covariance[unidentifiable, unidentifiable] = np.where(
            fixed_parameters(fitted.unknowns[:size])[unidentifiable], 0.0, np.inf
        )
        if isinstance(fitted, StreamedFit):
            floor = fitted.noise.floor
            systematic = floor * np.sqrt(max(fitted.misfit - 1, 0.0))
        else:
            floor = fitted.noise_floor()
            systematic = np.max([systematic_residual_rms(fitted, i) for i in range(len(fitted.recordings))], axis=0)
        return cls(fitted.model, fitted.theta[:size], covariance, floor, systematic)

    @property
    def without_recording_specific(self) -> CalibratedModel:
        """The same without recording-specific effects."""
        model = self.model.without_recording_specific
        place = {p.name: i for i, p in enumerate(self.model.parameters)}
        index = np.array([place[p.name] for p in model.parameters], dtype=np.intp)
        within = np.ix_(index, index)
        contributions = {name: covariance[within] for name, covariance in self.contributions.items()}
        return replace(
            self, model=model, theta=self.theta[index], covariance=self.covariance[within], contributions=contributions
        )

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which parameters (k,) were identifiable, or fixed."""
        return np.isfinite(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class Alternative:
    """A model that a diagnosis could not tell apart from the one that it chose.

    name    ids of its effects in the place of the chosen model's
    weight  its probability; that of the chosen model is what these leave of one
    """

    name: str
    weight: float
    calibration: CalibratedModel


def systematic_residual_rms(fitted: Fit, number: int) -> Array:
    """RMS (p,) of a fit's systematic residual in one of its recordings.

    The mean over R repeats has the variance s² + n²/R for systematic part s and noise of variance n² (PHYSICS.md,
    erratum 6). Of a single run it is the RMS of the means of its segments, of static poses that of the residual
    itself: there model error and noise are not distinguishable, and this bound is conservative.
    """
    recording, noise, residual = fitted.recordings[number], fitted.noise[number], fitted.residuals[number]
    if noise.source is NoiseSource.REPEATS:
        mean = residual.reshape(recording.repeats, -1, residual.shape[1]).mean(axis=0)
        return np.asarray(
            np.sqrt(np.maximum(mean.var(axis=0) - fitted.noise_floor(number) ** 2 / recording.repeats, 0.0))
        )
    if recording.at_rest:
        return np.asarray(residual.std(axis=0))
    segments = np.array_split(residual - residual.mean(axis=0), min(SEGMENTS_PER_RUN, len(residual)))
    means = np.stack([segment.mean(axis=0) for segment in segments])
    return np.asarray(np.sqrt((means**2).mean(axis=0)))


@dataclass(frozen=True, eq=False)
class ContactWrench(Tabular):
    """Contact wrench during a recording, with covariance and detected contact intervals.

    wrench      (n, p) of the environment on the tool, whatever the readings' signs: fcx, fcy, tauc in the plane, fcx ..
                tcz in six axes; N and N m, about the sensor origin, along `axes`
    noise       covariance of one sample's noise, (p, p), or (n, p, p) in base axes and at a lag
    systematic_covariance   (n, p, p), from parameters and zero
    zero_shift  (p,) zero of the readings less that of the calibration, in the channels' units
    group_delay s, group delay of the sensor's dynamics at low frequency
    tip_length  m, distance of a planar contact from the sensor along the tip; None where none is known
    unknown     per unidentifiable parameter of the calibration, the largest change of the contact wrench per unit of it
    axes        of the wrench: the sensor's in six axes, in the plane the tip's x' and y' (clockwise about the sensor),
                unless others were asked for
    turn        rotation from those axes to `axes`, (p, p), or (n, p, p) to base axes; None where these are they
    along_tip   in the plane, where it is along other axes: along the tip's, for the force at the tip
    lag         s: each row takes readings until so much later (`estimation/contact/smoothed_contact.py`); 0 for none
    inertial    components that an inertial unit's accelerations enter, where it has a lag
    unsmoothed  without the lag, where it has one
    contributions   variance (n, p) by name, of what a budget has besides the noise: parameters, zero, what was stated
    between     (n, p) std between the models that a diagnosis could not tell apart, which the covariance has in it; the
                wrench is their mean, the zero and what is detected are that of the mean. None of one model
    """

    recording: Recording
    calibration: CalibratedModel
    detection: ContactDetection
    wrench: Array
    noise: Array
    systematic_covariance: Array
    zero_shift: Array
    group_delay: float
    unknown: Mapping[str, float]
    tip_length: float | None = None
    axes: Axes = Axes.SENSOR
    turn: Array | None = None
    along_tip: ContactWrench | None = None
    lag: float = 0.0
    inertial: tuple[str, ...] = ()
    unsmoothed: ContactWrench | None = None
    contributions: Mapping[str, Array] = field(default_factory=dict)
    between: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The components' names."""
        return contact_components(self.space)

    @property
    def space(self) -> Space:
        """Plane or space."""
        return self.calibration.model.space

    @cached_property
    def covariance(self) -> Array:
        """Covariance (n, p, p) of each sample: noise, parameters and zero."""
        return self.noise + self.systematic_covariance

    @property
    def inverse_gain(self) -> Array:
        """From reading to contact wrench, (p, p), or (n, p, p) in base axes."""
        calibration, temperature = self.calibration, _mean_temperature(self.recording)
        inverse = np.linalg.inv(contact_gain_at(calibration.model, calibration.theta, temperature)[0])
        return np.asarray(inverse if self.turn is None else self.turn @ inverse)

    @property
    def is_turned(self) -> bool:
        """Whether the sensor is turned against the logged pose, by more than a budget's nominal angle of zero."""
        model, theta = self.calibration.model, self.calibration.theta
        return is_turned(model) and not np.array_equal(sensor_to_pose(model, theta), np.eye(3))

    @property
    def noise_std(self) -> Array:
        """Std (p,) of one sample's noise, in base axes and at a lag its root mean square over the recording."""
        variance = np.diagonal(self.noise, axis1=-2, axis2=-1)
        return np.asarray(np.sqrt(variance if variance.ndim == 1 else variance.mean(axis=0)))

    @property
    def between_rms(self) -> Array:
        """Root mean square (p,) over the recording of the std between models that a diagnosis could not tell apart."""
        between = np.zeros_like(self.wrench) if self.between is None else self.between
        return np.asarray(np.sqrt((between**2).mean(axis=0)))

    @property
    def floor(self) -> Array:
        """Std (p,) of one sample by the sensor's noise in the recordings of the fit."""
        variance = self.inverse_gain**2 @ self.calibration.floor**2
        return np.asarray(np.sqrt(variance if variance.ndim == 1 else variance.mean(axis=0)))

    @property
    def noise_ratio(self) -> Array:
        """Std (p,) of the contact-free part of this recording over that of the sensor's noise in the fit."""
        if self.unsmoothed is not None:
            return self.unsmoothed.noise_ratio
        return np.asarray(self.noise_std / np.maximum(self.floor, 1e-300))

    def systematic_contact_error(self, true: Array) -> Array:
        """RMS (p,) of the systematic part of the error against the true contact wrench (n, p).

        The error's mean over R repeats has the mean square s² + n²/R, s systematic, n random: PHYSICS.md, erratum 6.
        Negative estimates of s² count as zero. A single run's error counts as systematic altogether.
        """
        error = (self.wrench - true).reshape(self.recording.repeats, -1, len(self.names))
        mean, repeats = error.mean(axis=0), len(error)
        noise = ((error - mean) ** 2).mean(axis=(0, 1)) / max(1, repeats - 1)
        return np.asarray(np.sqrt(np.maximum((mean**2).mean(axis=0) - noise, 0.0)))

    @property
    def systematic_contact_error_limit(self) -> Array:
        """Detection limit (p,) of `systematic_contact_error`: root of two standard errors of its square under noise.

        The standard error is n² sqrt(2 / (N R (R - 1))) for N samples in each of R repeats; for a single run the limit
        is the noise std.
        """
        recording = self.recording
        pairs = recording.samples * (recording.repeats - 1)
        return np.asarray(self.floor * (np.sqrt(2 * np.sqrt(2 / pairs)) if pairs else 1.0))

    @cached_property
    def point_force(self) -> PointForce:
        """In the plane: the force at the end of the tip that fits force and torque best (22.14 corrected).

        It assumes a contact there, without a torque of its own. Without a tip length it is (fcx, fcy).
        """
        if self.turn is None:
            weight = self.noise if self.noise.ndim == 2 else self.noise.mean(axis=0)
            return PointForce.of(self.wrench, self.covariance, weight, self.tip_length)
        assert self.along_tip is not None
        return self.along_tip.point_force.turned(self.turn[..., :2, :2])

    @property
    def predicted(self) -> Array:
        """Readings (n, p) that the model predicts, with the zero of this recording, in the readings' sign and axes."""
        members, weights = _members(self.calibration)
        each = [predicted_readings(one.model, self.recording, one.theta) for one in members]
        return _mean(weights, each) + self.zero_shift

    @property
    def std(self) -> Array:
        """Standard deviation (n, p) of each component: noise, parameters and zero."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    @property
    def magnitude(self) -> Array:
        """Force at the tip, N (n,): of `point_force` in the plane, where it is not |(fcx, fcy)|; |F| in six axes."""
        if self.space is Space.PLANE:
            return self.point_force.magnitude
        return np.asarray(np.linalg.norm(self.wrench[:, :3], axis=1))

    @property
    def magnitude_std(self) -> Array:
        """Standard deviation of the magnitude, N (n,), along the force."""
        if self.space is Space.PLANE:
            return self.point_force.magnitude_std
        force = self.wrench[:, :3]
        unit = force / np.maximum(np.linalg.norm(force, axis=1), 1e-300)[:, None]
        return std_along(self.covariance[:, :3, :3], unit)

    @property
    def intervals(self) -> tuple[ContactInterval, ...]:
        """Detected contact intervals."""
        return self.detection.intervals

    def time_of(self, sample: int) -> float:
        """Time (s) of a sample; its index for static poses."""
        time = self.recording.time
        return float(sample) if time is None else float(time[min(sample, len(time) - 1)])

    @cached_property
    def means(self) -> tuple[ContactMean, ...]:
        """Mean contact wrench over each detected interval, with covariance, forces and the force at the tip.

        Of the wrench without a lag, which would mix what is before and after an interval into it.
        """
        if self.unsmoothed is not None:
            return self.unsmoothed.means
        planar = self.space is Space.PLANE
        series = ContactSeries(
            wrench=self.wrench,
            systematic=self.systematic_covariance,
            noise=self.noise,
            inverse=self.inverse_gain,
            remainder=self.calibration.remainder,
            detection=self.detection,
            forces=self.space.value,
            tip_length=self.tip_length if planar and self.along_tip is None else None,
        )
        means = tuple(series.mean(interval) for interval in self.intervals)
        if self.along_tip is None:
            return means
        along_tip = zip(means, self.along_tip.means, strict=True)
        return tuple(replace(m, tip_force=t.tip_force, tip_p_value=t.tip_p_value) for m, t in along_tip)

    @property
    def unexplained_by_tip_force(self) -> tuple[ContactMean, ...]:
        """Contacts whose mean wrench a force at the tip does not explain, at `LEVELS.tip_force`."""
        level = LEVELS.tip_force / max(1, len(self.means))
        return tuple(mean for mean in self.means if mean.tip_p_value < level)

    @property
    def table(self) -> Table:
        """Each interval: from, to, mean of each component, size of the mean force and of the largest, force at the tip.

        The force at the tip is in planar recordings with a tip length only.
        """
        unit = "" if self.recording.at_rest else "s"
        ends = (Column(name, unit, ".3f") for name in ("from", "to"))
        units = (*self.space.units, FORCE_UNIT, FORCE_UNIT)
        sizes = (Column(n, u, ".3g") for n, u in zip((*self.names, "|F|", "largest |F|"), units, strict=True))
        tip = (Column("force at the tip", FORCE_UNIT, ".3g"),) if self._has_tip else ()
        rows = [
            (
                self.time_of(m.interval.first),
                self.time_of(m.interval.last),
                *m.wrench.tolist(),
                m.force,
                m.largest_force,
                *((m.tip_force,) if tip else ()),
                m.interval.p_value,
            )
            for m in self.means
        ]
        return Table.of((*ends, *sizes, *tip, Column("p", format=P_VALUE)), rows)

    @property
    def _has_tip(self) -> bool:
        return self.space is Space.PLANE and self.tip_length is not None

    def remarks(self) -> list[str]:
        """What the columns are, what the force at the tip assumes, and the contacts that contradict it."""
        remarks = [
            f"Mean wrench of the environment on the tool: {self.axes_words}, about the sensor's origin; |F| is the size"
            " of that mean force, largest |F| that of one sample, with its noise."
        ]
        if not self._has_tip:
            return remarks
        remarks.append(
            f"Force at the tip: size of the point force that fits force and torque best, if the contact is at"
            f" {self.tip_length:g} m along the tip and exerts no torque of its own."
        )
        return [*remarks, *self._contradictions()]

    @property
    def axes_words(self) -> str:
        """What the components are along, and that the sensor is turned against the logged pose, where it is."""
        turned = self.is_turned and self.axes is not Axes.BASE
        by = turn_words(sensor_to_pose(self.calibration.model, self.calibration.theta)) if turned else ""
        against = f" (the sensor is turned by {by} against the logged pose)" if turned else ""
        if self.space is Space.SPACE:
            how = " as the pose was logged" if self.axes is Axes.BASE else ""
            return f"forces fcx .. fcz and torques tcx .. tcz in {self.axes.words(self.space)}{how}{against}"
        if self.axes is Axes.POSE:
            return f"fcx along x', fcy along y' (along the tip), tauc clockwise{against}"
        return f"fcx and fcy in {self.axes.words(self.space)}, tauc clockwise{against}"

    def _contradictions(self) -> list[str]:
        """One sentence about the contacts that a force at the tip does not explain, if there are any."""
        means = self.unexplained_by_tip_force
        if not means:
            return []
        unit = "" if self.recording.at_rest else " s"
        start = ", ".join(f"{self.time_of(m.interval.first):.3f}" for m in means) + unit
        p_value = plain_number(max(m.tip_p_value for m in means), P_VALUE)
        p_value = f"p {p_value}" if p_value.startswith("<") else f"p = {p_value}"
        return [
            f"A force at the tip does not explain the contact{'s' * (len(means) > 1)} from {start} on ({p_value}):"
            " the contact is elsewhere or exerts a torque; read fcx, fcy and tauc, not the force at the tip."
        ]

    def printed(self) -> list[Table | str]:
        """The intervals with what their columns are, or that there is none."""
        return super().printed() if self.intervals else ["no contact found"]


class HasCalibration(Protocol):
    """What has a calibrated model: a budget, a model file."""

    @property
    def calibration(self) -> CalibratedModel: ...


def _calibration(fitted: EstimatedModel | CalibratedModel | HasCalibration) -> CalibratedModel:
    if isinstance(fitted, CalibratedModel):
        return fitted
    if isinstance(fitted, Fit | StreamedFit):
        return CalibratedModel.of(fitted)
    saved: CalibratedModel = fitted.calibration  # type: ignore[union-attr]  # a model file's: `_require_order`
    return saved


def _require_order(fitted: object, recording: object) -> None:
    """InputError, in a sentence, for arguments that are swapped, or of other kinds."""
    remedy = "give the fit first: tw.compensate(fit, recording)"
    if isinstance(fitted, Recording) and not isinstance(recording, Recording):
        raise InputError(what="the fit and the recording are swapped", where="compensate", remedy=remedy)
    if not isinstance(fitted, Fit | StreamedFit | CalibratedModel) and not hasattr(fitted, "calibration"):
        raise InputError(what=f"{kind_of(fitted)} is no fitted model", where="compensate", remedy=remedy)
    require_recording(recording, "compensate")


def compensate(
    fitted: EstimatedModel | CalibratedModel | HasCalibration,
    recording: Recording,
    *,
    keep_zero: bool = False,
    tip_length: float | None = None,
    false_alarms: float = LEVELS.contact,
    axes: Axes | str | None = None,
    lag: float | None = None,
    alternatives: bool = True,
) -> ContactWrench:
    """The contact wrench of a recording: its readings less the fitted tool's load.

    Parameters
    ----------
    fitted : Fit, StreamedFit, CalibratedModel, ModelFile, Budget or ModelAverage
        The fitted model of the tool, or what `load` gives; recording-specific effects are dropped. With a budget its
        contributions are in the covariance, as wrong as they were in the fit. Of models that a diagnosis could not
        tell apart (`diagnosis.averaged`, or its model file) the wrench is the mean, and the covariance has what they
        differ by in it.
    recording : Recording
        Recording with contact, with the model's channels.
    keep_zero : bool, optional
        Take the calibration's zero; by default that of this recording is estimated where the tool is free.
    tip_length : float, optional
        Distance of a planar contact from the sensor origin along the tip, m; by default the rig's.
    false_alarms : float, optional
        Largest probability of any detected contact interval in a recording without contact, by default 0.01.
    axes : {"sensor", "pose", "base"}, optional
        Axes of the wrench: the sensor's, those of the logged pose (a flange's, where its pose was logged), or the
        base's as the pose was logged. By default the sensor's, also where it is turned against the pose; in the plane
        x' and y' of the tip, which are those of the pose.
    lag : float, optional
        Smooth at this lag, s: each sample's wrench takes readings until so much later, with the weights that leave
        the least of the recording's own noise and pass a contact undistorted after the lag; by default each reading by
        itself. Accelerations of an inertial unit (`imu_ax`, `imu_ay`, `imu_az`) enter where they make the noise lower.
        Zero, contacts and their means stay those of the readings. No std covers the blur of a contact that begins or
        ends within the lag; at the ends of a run the lag is shorter, and the noise larger.
    alternatives : bool, optional
        Whether models that a diagnosis could not tell apart from the fitted one count, by default True.

    Returns
    -------
    ContactWrench
        Wrench (n, p), N and N m, of the environment on the tool, about the sensor origin, whatever the readings' signs,
        with covariance (n, p, p) and the detected contact intervals.

    Raises
    ------
    InputError
        When the channels differ, a signal that the model needs is missing, the arguments are swapped, there are no
        such axes, or the lag does not go with the recording's length and its time without contact.

    Notes
    -----
    A reading is G (tool - contact) + zero, so that contact = G^-1 (predicted - measured), predicted with the zero of
    this recording (22.13 in chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
    Manipulators", Bassi et al.). The zero is the mean residual where the tool is free (`detect_contacts`), or the
    calibration's with `keep_zero`; the parameters' covariance propagates about that zero, since an error in the weight
    moves the zero too. The sensor's dynamics are not inverted, which would amplify the noise (`group_delay`). A gain
    that follows the temperature is that of the recording's mean.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), tw.read("train.csv", rig=rig))
    >>> contact = tw.compensate(fit, tw.read("contact.csv", rig=rig))
    >>> contact.names, contact.wrench.shape
    (('fcx', 'fcy', 'tauc'), (2000, 3))
    >>> [(round(contact.time_of(i.first), 1), round(contact.time_of(i.last), 1)) for i in contact.intervals]
    [(1.5, 2.5), (6.5, 7.5), (11.5, 12.5), (16.5, 17.5)]
    """
    _require_order(fitted, recording)
    calibration = _calibration(fitted)
    calibration = calibration if alternatives else replace(calibration, alternatives=())
    own_axes = Axes.of_contact(calibration.model.space)
    wanted = own_axes if axes is None else axes_named(axes)
    members, weights = _members(calibration)
    loads = [_FreeTool.of(members[0], recording)]
    for member, other in zip(members[1:], calibration.alternatives, strict=True):
        try:
            loads.append(_FreeTool.of(member, recording))
        except InputError as error:
            what = f"{other.name}, which the diagnosis could not rule out, cannot be compensated: {error.what}"
            remedy = f"{error.remedy}; or leave it out by --without-alternatives (alternatives=False)"
            raise InputError(what=what, where=error.where, remedy=remedy) from None
    doubt = _rms_between(weights, [load.residual for load in loads], centred=not keep_zero)
    detection = detect_contacts(
        _mean(weights, [load.residual for load in loads]),
        loads[0].recording.dt,
        floor=calibration.floor,
        remainder=np.hypot(calibration.remainder, doubt),
        zero=np.zeros(len(calibration.model.biases)) if keep_zero else None,
        false_alarms=false_alarms,
    )
    if len(members) > 1:  # what they differ by is in the covariance by itself, sample by sample
        noise = replace(detection.noise, constant=calibration.remainder**2)
        of_zero = detection.zero_covariance - (0.0 if keep_zero else np.diag(doubt**2))
        detection = replace(detection, noise=noise, zero_covariance=of_zero)
    each = [load.contact(detection, keep_zero=keep_zero, tip_length=tip_length, axes=wanted, lag=lag) for load in loads]
    return each[0] if len(each) == 1 else _averaged(each, weights, calibration)


@dataclass(frozen=True, eq=False)
class _FreeTool:
    """A recording beside what a model's tool reads without contact: measured minus predicted `residual` (n, p)."""

    calibration: CalibratedModel
    recording: Recording
    response: ModelResponse
    residual: Array

    @classmethod
    def of(cls, calibration: CalibratedModel, recording: Recording) -> _FreeTool:
        """Of a model without recording-specific effects."""
        from estimation.readings.static_dwells import sampled  # compiles the rigid tool, as what follows does

        recording = prepared(sampled(recording, calibration.model), calibration.model)
        response = model_response(calibration.model, recording, calibration.theta)
        return cls(calibration, recording, response, recording.wrench - response.value)

    def contact(
        self, detection: ContactDetection, *, keep_zero: bool, tip_length: float | None, axes: Axes, lag: float | None
    ) -> ContactWrench:
        """The contact wrench by this model, its own zero where the tool is free."""
        calibration = self.calibration
        if not keep_zero:
            detection = replace(detection, zero=self.residual[detection.free].mean(axis=0))
        gain, slopes = contact_gain_at(calibration.model, calibration.theta, _mean_temperature(self.recording))
        inverse = np.linalg.inv(gain)
        wrench = (self.residual - detection.zero) @ inverse.T
        tangent = self.response.derivative
        if not keep_zero:
            tangent = tangent - tangent[detection.free].mean(axis=0)
        # From reading = value(theta) + gain(theta) contact: d contact = -gain^-1 (d value + d gain contact).
        tangent = -np.einsum("ij,njk->nik", inverse, tangent + np.einsum("ijk,nj->nik", slopes, wrench))
        own_axes = Axes.of_contact(calibration.model.space)
        contact = ContactWrench(
            recording=self.recording,
            calibration=calibration,
            detection=detection,
            wrench=wrench,
            noise=inverse @ detection.covariance @ inverse.T,
            systematic_covariance=_systematic(calibration, tangent) + inverse @ detection.zero_covariance @ inverse.T,
            zero_shift=detection.zero,
            group_delay=group_delay(calibration.model, calibration.theta),
            unknown=_unidentified_parameters(calibration, tangent),
            tip_length=_tip_length(self.recording, tip_length),
            axes=own_axes,
            contributions=_contributions(calibration, tangent, inverse @ detection.zero_covariance @ inverse.T),
        )
        if lag is not None:
            contact = _smoothed(contact, lag)
        return contact if axes is own_axes else _along(contact, axes, tangent)


def _members(calibration: CalibratedModel) -> tuple[list[CalibratedModel], list[float]]:
    """A model and its alternatives, without recording-specific effects, and their weights."""
    others = calibration.alternatives
    alone = replace(calibration, alternatives=())
    members = [one.without_recording_specific for one in (alone, *(other.calibration for other in others))]
    return members, [1 - sum(other.weight for other in others), *(other.weight for other in others)]


def _mean(weights: Sequence[float], each: Sequence[Array]) -> Array:
    """Weighted mean of arrays of one shape."""
    return np.asarray(sum(weight * one for weight, one in zip(weights, each, strict=True)))


def _rms_between(weights: Sequence[float], each: Sequence[Array], *, centred: bool) -> Array:
    """Root mean square (p,) over a recording of the std between residuals (n, p), about their own means if centred."""
    apart = [one - each[0] for one in each]
    apart = [one - one.mean(axis=0) for one in apart] if centred else apart
    mean = _mean(weights, apart)
    return np.asarray(np.sqrt(_mean(weights, [(one - mean) ** 2 for one in apart]).mean(axis=0)))


def _averaged(each: Sequence[ContactWrench], weights: Sequence[float], calibration: CalibratedModel) -> ContactWrench:
    """The mean of contact wrenches by several models, the covariance with what they differ by."""
    first = each[0]
    wrench = _mean(weights, [one.wrench for one in each])
    apart = [one.wrench - wrench for one in each]
    along_tip = [one.along_tip for one in each if one.along_tip is not None] or None
    unsmoothed = [one.unsmoothed for one in each if one.unsmoothed is not None] or None
    between = _mean(weights, [own[:, :, None] * own[:, None, :] for own in apart])
    return replace(
        first,
        calibration=calibration,
        wrench=wrench,
        noise=_mean(weights, [one.noise for one in each]),
        systematic_covariance=_mean(weights, [one.systematic_covariance for one in each]) + between,
        zero_shift=_mean(weights, [one.zero_shift for one in each]),
        unknown={name: amount for one in each for name, amount in one.unknown.items()},
        between=np.sqrt(np.diagonal(between, axis1=1, axis2=2)),
        along_tip=along_tip and _averaged(along_tip, weights, calibration),
        unsmoothed=unsmoothed and _averaged(unsmoothed, weights, calibration),
    )


def _mean_temperature(recording: Recording) -> float | None:
    """°C; None where it is not logged."""
    logged = recording.columns.get("temperature")
    return None if logged is None else float(logged.mean())


def _smoothed(contact: ContactWrench, lag: float) -> ContactWrench:
    """The same at a lag, s."""
    from estimation.contact.smoothed_contact import inertial_accelerations, smoothed_series  # loads scipy.signal

    recording = contact.recording
    load = recording.wrench - contact.wrench @ np.linalg.inv(contact.inverse_gain).T
    series = smoothed_series(
        contact.wrench,
        inertial_accelerations(recording.signals, load),
        contact.detection.free,
        dt=recording.dt,
        runs=1 if recording.continuous else recording.repeats,
        lag=lag,
        name=recording.name,
    )
    inertial = tuple(contact.names[i] for i in series.with_unit)
    return replace(
        contact, wrench=series.wrench, noise=series.noise, lag=series.lag, inertial=inertial, unsmoothed=contact
    )


def _systematic(calibration: CalibratedModel, tangent: Array) -> Array:
    """Covariance (n, p, p) by the parameters, of derivatives (n, p, k) in them; those not identifiable left out."""
    is_known = calibration.known
    tangent, covariance = tangent[:, :, is_known], calibration.covariance[np.ix_(is_known, is_known)]
    return np.asarray(np.einsum("nik,kl,njl->nij", tangent, covariance, tangent, optimize=True))


def _contributions(calibration: CalibratedModel, tangent: Array, zero: Array) -> dict[str, Array]:
    """Variances (n, p) of a budget's contributions, and of the zero with covariance (p, p) or (n, p, p); else none."""
    parts = {name: replace(calibration, covariance=part) for name, part in calibration.contributions.items()}
    covariances = {name: _systematic(part, tangent) for name, part in parts.items()}
    if parts:
        covariances["zero"] = np.broadcast_to(zero, (len(tangent), *zero.shape[-2:]))
    return {name: np.diagonal(covariance, axis1=1, axis2=2) for name, covariance in covariances.items()}


def _along(contact: ContactWrench, axes: Axes, tangent: Array) -> ContactWrench:
    """The contact along other axes, its covariances turned along; `tangent` (n, p, k) is its derivative.

    The turn of the sensor may be estimated: contact' = A(theta) contact has the derivative A d contact + dA contact.
    """
    unsmoothed = None if contact.unsmoothed is None else _along(contact.unsmoothed, axes, tangent)
    model, theta, recording = contact.calibration.model, contact.calibration.theta, contact.recording
    turn, slopes = contact_turn(model, theta, axes)
    tangent = turn @ tangent + np.einsum("ijk,nj->nik", slopes, contact.wrench)
    if axes is Axes.BASE:
        direction = None if recording.rig is None else recording.rig.gravity_direction
        to_base = pose_to_base(model.space, recording.signals, direction)
        turn, tangent = to_base @ turn, to_base @ tangent
    inverse = turn @ contact.inverse_gain
    transposed, back = np.swapaxes(inverse, -1, -2), np.swapaxes(turn, -1, -2)
    of_zero = inverse @ contact.detection.zero_covariance @ transposed
    return replace(
        contact,
        wrench=(turn @ contact.wrench[:, :, None])[:, :, 0],
        noise=turn @ contact.noise @ back,
        systematic_covariance=_systematic(contact.calibration, tangent) + of_zero,
        unknown=_unidentified_parameters(contact.calibration, tangent),
        axes=axes,
        turn=turn,
        along_tip=contact if contact.space is Space.PLANE else None,
        unsmoothed=unsmoothed,
        contributions=_contributions(contact.calibration, tangent, of_zero),
    )


def _unidentified_parameters(calibration: CalibratedModel, tangent: Array) -> dict[str, float]:
    """Unidentifiable parameters of the calibration with their largest effect per unit, where not zero.

    `tangent` (n, p, k) is the derivative of the contact wrench.
    """
    is_known = calibration.known
    change = np.abs(tangent[:, :, ~is_known]).max(axis=(0, 1), initial=0.0)
    names = [p.name for p, known in zip(calibration.model.parameters, is_known, strict=True) if not known]
    return {name: float(amount) for name, amount in zip(names, change, strict=True) if amount > 0}


def _tip_length(recording: Recording, stated: float | None) -> float | None:
    return stated if stated is not None or recording.rig is None else recording.rig.tip_length
