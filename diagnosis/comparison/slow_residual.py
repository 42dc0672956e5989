"""Slow residual of a single run: drift of the zero, slow noise or physics, which without repeats look alike.

Four parts can be told from the noise: that of the slowest lines, where the zero wanders; that of the motion's band,
where the physics is that the model lacks; what comes and goes, as noise does not; and, where the tool makes the smaller
part of a channel's readings, the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.steadiness import ResidualSpectrum, level_spacing, steadiness_p_values, unsteady_variance
from estimation.model_response import model_response
from estimation.multiplicity import chi_square_p_value, normal_cdf
from estimation.recordings.motion_limits import AT_REST, acceleration_is_recorded, world_axes
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.noise import NoiseSource
from modeling.number_format import format_number
from modeling.significance import LEVELS
from modeling.space import Space

# Residual while the tool moves against the residual while it rests: noise does not know which.


Array = NDArray[np.float64]

SLOW_SHARE = 0.02
"""Of the largest speed in each column group, below which a sample is at rest."""
SHORTEST = 16
"""Samples of a window: fewer have no slow part."""
SHORT_STRETCHES = 0.2
"""Of the stretches at rest, that are shorter than a window and not used."""
FEWEST_WINDOWS = 6
"""Windows at rest and in motion from which they are compared."""


def rest_p_values(recording: Recording, residual: Array) -> Array:
    """P-values (p,) of "a residual (n, p) changes as much while the tool rests as while it moves".

    Windows as long as most stretches at rest, one in each, and as many in motion as there is room for. Their slowest
    cosine is compared by ranks (Mann and Whitney, Ann. Math. Stat. 18, 1947), which holds for noise of any colour, as
    long as that is the same throughout. One where there are too few windows.
    """
    resting = at_rest(recording)
    stretches = _stretches(resting)
    lengths = [stop - start for start, stop in stretches if stop - start >= SHORTEST]
    if len(lengths) < FEWEST_WINDOWS:
        return np.ones(residual.shape[1])
    length = int(np.quantile(lengths, SHORT_STRETCHES))
    rest = [start + (stop - start - length) // 2 for start, stop in stretches if stop - start >= length]
    motion = [s for start, stop in _stretches(~resting) for s in range(start, stop - length + 1, length)]
    if min(len(rest), len(motion)) < FEWEST_WINDOWS:
        return np.ones(residual.shape[1])
    still, moving = (_slow_power(residual, starts, length) for starts in (rest, motion))
    return np.array([_rank_p_value(a, b) for a, b in zip(moving.T, still.T, strict=True)])


def at_rest(recording: Recording) -> NDArray[np.bool_]:
    """Whether (n,) the recorded motion rests."""
    recording.signals  # noqa: B018  derives the motion
    still = np.ones(recording.samples, dtype=bool)
    for derived in recording.motion.recorded.derivatives.values():
        if np.std(derived.value, axis=0).max() < AT_REST:
            continue
        speed = np.linalg.norm(derived.first, axis=1)
        still &= speed <= SLOW_SHARE * max(float(speed.max()), 1e-300)
    return still


def _stretches(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Starts and stops of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _slow_power(residual: Array, starts: list[int], length: int) -> Array:
    """Power (windows, p) of the half cosine over each window."""
    windows = np.stack([residual[start : start + length] for start in starts])
    return np.asarray(dct(windows, axis=1, norm="ortho")[:, 1] ** 2)


def _rank_p_value(larger: Array, smaller: Array) -> float:
    """One-sided p-value of "the first sample (a,) is not larger than the second (b,)", by ranks."""
    a, b = len(larger), len(smaller)
    wins = float((larger[:, None] > smaller).sum() + 0.5 * (larger[:, None] == smaller).sum())
    return float(normal_cdf((a * b / 2 + 0.5 - wins) / np.sqrt(a * b * (a + b + 1) / 12)))


# Whether a residual looks like mass times an acceleration of the sensor's origin that was not recorded.


INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")

MOST = 0.5
"""Share of a residual's power: an unrecorded acceleration explains more of the torque, and errors of the recorded
orientation or of the sensor explain less of the force."""


def lacks_acceleration(comparison: Comparison, model: WrenchModel) -> bool:
    """Whether the residual of a recording looks like an acceleration that was not recorded."""
    return inertial_share(comparison, model) > MOST and orientation_share(comparison) < MOST


def inertial_share(comparison: Comparison, model: WrenchModel) -> float:
    """Share of the torque residual's power that goes with the acceleration of the sensor's origin left out.

    About the centre of mass c that acceleration exerts no torque: whatever it is, torque t and force f measured at
    the sensor are t = c x f + I al + w x I w + b with the inertia I about c and a constant b (Newton and Euler), a
    linear least-squares problem in c, I and b. Zero where the acceleration was recorded, and in the plane.
    """
    recording = comparison.recording
    if comparison.space is not Space.SPACE or acceleration_is_recorded(recording):
        return 0.0
    base = model.base
    response = model_response(base, recording, np.zeros(len(base.parameters)))
    inertia = [i for i, parameter in enumerate(base.parameters) if parameter.name in INERTIA]
    force, torque = recording.wrench[:, :3], recording.wrench[:, 3:]
    through_centre = np.stack([np.cross(axis, force) for axis in np.eye(3)], axis=2)
    constant = np.broadcast_to(np.eye(3), through_centre.shape)
    columns = np.concatenate([through_centre, response.derivative[:, 3:, inertia], constant], axis=2)
    regressor = columns.reshape(-1, columns.shape[2])
    residual = comparison.residual[:, 3:] - comparison.residual[:, 3:].mean(axis=0)
    return 1 - _power_left(regressor, torque) / max(float(np.sum(residual**2)), np.finfo(float).tiny)


def orientation_share(comparison: Comparison) -> float:
    """Share of the force residual's power above its noise that goes with the recorded orientation, in six axes.

    Where the sensor is turned in its flange, its axes leak into each other or have other gains, the force's error is
    A w with the weight's direction w in the sensor and a constant matrix A; where gravity's direction is wrong, it is
    constant in the world; where the readings are late, it goes with dw/dt. Their torques are those of a force through
    the centre of mass as well. An acceleration of the origin goes with none of these. Noise is what differs from
    sample to sample, at most half of the power: more is an acceleration that changes from sample to sample.
    """
    residual = comparison.residual[:, :3] - comparison.residual[:, :3].mean(axis=0)
    axes = world_axes(comparison.recording)
    down = -axes[:, :, 2]
    linear = np.einsum("ij,nk->nijk", np.eye(3), down).reshape(-1, 3, 9)
    constant = np.broadcast_to(np.eye(3), axes.shape)
    columns = np.concatenate([linear, axes[:, :, :2], np.gradient(down, axis=0)[:, :, None], constant], axis=2)
    power = float(np.sum(residual**2))
    noise = len(residual) / 2 * float(np.mean(np.diff(residual, axis=0) ** 2, axis=0).sum())
    explained = power - _power_left(columns.reshape(-1, columns.shape[2]), residual)
    return float(explained / max(power - min(noise, power / 2), explained, np.finfo(float).tiny))


def _power_left(regressor: Array, series: Array) -> float:
    """What a linear least-squares fit with a regressor (3 n, k) leaves of the power of a series (n, 3)."""
    left = series.ravel() - regressor @ np.linalg.lstsq(regressor, series.ravel(), rcond=None)[0]
    return float(left @ left)


# Of what single runs' residuals hold beyond noise, what a larger model removes and what remains.


def removed_share(before: Sequence[Comparison], after: Sequence[Comparison]) -> float:
    """Of the power that the residuals had, beyond noise, the share that a larger model removed.

    `before` and `after` are comparisons of the smaller and of the larger model with the same recordings. One where
    nothing remains, as where no noise is taken from the residual of a run.
    """
    removed, remains = removed_power(before, after), remaining_power(after)
    return removed / max(removed + remains, 1e-300) if remains else 1.0


def removed_power(before: Sequence[Comparison], after: Sequence[Comparison]) -> float:
    """Fall of the residuals' mean squares, over the variance of the noise, summed over channels and single runs."""
    total = 0.0
    for number, spectrum in _spectra(after):
        squares = [(c.residual**2).mean(axis=0) for c in (before[number], after[number])]
        total += _over_noise(np.maximum(squares[0] - squares[1], 0.0), spectrum)
    return total


def remaining_power(comparisons: Sequence[Comparison]) -> float:
    """In the band of the motion, beyond noise that rises as 1/f, in the same unit."""
    return sum(_over_noise(s.beyond_flicker_noise, s) for _, s in _spectra(comparisons))


def _over_noise(power: Array, spectrum: ResidualSpectrum) -> float:
    """Power (p,) over the variance of the noise, summed over the channels that have any: one that never changes has
    none, and no fit weighs it."""
    noisy = spectrum.noise_variance > 0
    return float((power[noisy] / spectrum.noise_variance[noisy]).sum())


def _spectra(comparisons: Sequence[Comparison]) -> Iterator[tuple[int, ResidualSpectrum]]:
    """Index and residual spectrum of each single run whose noise is taken from its residual."""
    for number, c in enumerate(comparisons):
        if c.noise.source is NoiseSource.RESIDUAL and not c.recording.at_rest:
            yield number, ResidualSpectrum.of(c.residual, c.recording.wrench - c.residual)


SLOW_MODES = 4
"""Cosines of half a period to two periods a record: what a quarter of the record, or less, has about one value of."""
REFERENCE_MODES = slice(9, 80)
"""Cosines, counted from 0, whose level is that of the noise: ten times as fast as the slow ones."""
STEEPEST_NOISE = -1.0
"""Exponent of the frequency in a power spectral density of noise: 1/f."""
LOG_CHI_SQUARE_MEAN, LOG_CHI_SQUARE_VARIANCE = -1.2704, 4.9348
"""Of the logarithm of a chi-square variable of one degree of freedom: digamma(1/2) + log 2, trigamma(1/2)."""
FOREIGN_SHARE = 0.5
"""Of the variance of a channel's readings, from which the residual is the most of it."""
FOREIGN_NOISE = 10.0
"""RMS of such a residual over the noise of a sample: 5 of an autoregression of 0.95, 100 of a hand on the tool."""


class Part(Enum):
    """Part of a residual that is no noise, and what it may be."""

    SLOWEST = (
        "drift of the zero or slow physics; repeats of the motion, or the same pose at rest before and after, tell"
        " which"
    )
    MOTION_BAND = (
        "too steep a spectrum for noise, so physics that the model lacks, or slow disturbances; repeats of the motion"
        " tell which"
    )
    MOTION_ALONE = (
        "it changes while the tool moves and not while it rests, so physics that the model lacks, or the robot's own"
        " vibration"
    )
    UNSTEADY = (
        "its size comes and goes, which that of noise does not, so impacts, a loose part, vibration or other physics"
        " that the model lacks, or interference; when it is large tells which"
    )
    FOREIGN = (
        "most of these readings is not the tool's in the motion recorded: contact, another load, a disturbance or an"
        " error of the motion; record a motion without contact"
    )

    @property
    def noun(self) -> str:
        """What remains."""
        return {
            Part.SLOWEST: "a slow change",
            Part.UNSTEADY: "a residual that is not steady",
            Part.FOREIGN: "a residual larger than the tool's own wrench",
        }.get(self, "a residual in the band of the motion")


@dataclass(frozen=True)
class SlowResidual:
    """The slow part of a single run's residual, per channel.

    rms        of the slow part, in the channel's unit
    floor      std of the noise of one sample, without it
    p_value    of "its power is that of noise whose spectrum goes on to low frequencies as above them", Bonferroni
               over the channels, and over the parts where both were tested
    part       which part of the channel's residual it is
    """

    recording: str
    rms: Mapping[str, float]
    floor: Mapping[str, float]
    units: Mapping[str, str]
    p_value: Mapping[str, float]
    part: Mapping[str, Part]

    @classmethod
    def of(cls, comparison: Comparison) -> SlowResidual | None:
        """The slow part; None with repeats, which show it by themselves, of static poses, and of a short record."""
        recording, residual = comparison.recording, comparison.residual
        if not _is_tested(comparison):
            return None
        name, units = recording.name, comparison.space.channel_units
        spectrum = ResidualSpectrum.of(residual, recording.wrench - residual)
        band = cls.of_motion_band(name, spectrum, units).or_else(
            cls.of_rest(name, spectrum, recording, residual, units)
        )
        band = band.or_else(cls.of_unsteady(name, residual, units, level_spacing(recording.wrench)))
        slow = cls.of_residual(name, residual, units).or_else(band)
        return slow.or_else(cls.of_foreign(name, spectrum, recording.wrench.var(axis=0), units), tests=1)

    @classmethod
    def of_rest(
        cls, name: str, spectrum: ResidualSpectrum, recording: Recording, residual: Array, units: Mapping[str, str]
    ) -> SlowResidual:
        """The part in the motion's band, tested by how much more a residual (n, p) changes in motion than at rest."""
        size, noise = np.sqrt(spectrum.band_excess), np.sqrt(spectrum.noise_variance)
        return cls._of(name, units, Part.MOTION_ALONE, size, noise, rest_p_values(recording, residual))

    @classmethod
    def of_unsteady(
        cls, recording: str, residual: Array, units: Mapping[str, str], spacing: Array | float = 0.0
    ) -> SlowResidual:
        """The part that comes and goes of a residual (n, p), where it exceeds the steady noise and the rounding.

        A smaller one says little: the motion's derivatives err most where a move begins and ends, and readings that
        are rounded to levels of some `spacing` (p,), coarser than their noise, err by half of it at the most.
        """
        unsteady, steady = unsteady_variance(residual)
        larger, p_values = unsteady > np.maximum(steady, (np.asarray(spacing) / 2) ** 2), np.ones(len(units))
        p_values[larger] = steadiness_p_values(residual[:, larger])
        return cls._of(recording, units, Part.UNSTEADY, np.sqrt(unsteady), np.sqrt(steady), p_values)

    @classmethod
    def of_foreign(
        cls, recording: str, spectrum: ResidualSpectrum, readings: Array, units: Mapping[str, str]
    ) -> SlowResidual:
        """The whole residual where it is most of the readings' variance (p,), and far above the noise of a sample."""
        size, noise = spectrum.variance, spectrum.upper_noise
        foreign = (size > FOREIGN_SHARE * readings) & (size > FOREIGN_NOISE**2 * noise)
        return cls._of(recording, units, Part.FOREIGN, np.sqrt(size), np.sqrt(noise), np.where(foreign, 0.0, 1.0))

    @classmethod
    def _of(
        cls, recording: str, units: Mapping[str, str], part: Part, rms: Array, floor: Array, p_values: Array
    ) -> SlowResidual:
        corrected = np.minimum(1.0, len(units) * p_values)
        by_channel = (dict(zip(units, v.tolist(), strict=True)) for v in (rms, floor, corrected))
        sizes, floors, adjusted = by_channel
        return cls(recording, sizes, floors, units, adjusted, dict.fromkeys(units, part))

    def or_else(self, other: SlowResidual, tests: int = 2) -> SlowResidual:
        """In each channel one of two parts, of which so many were tested.

        One that is significant and above the noise; the larger one where both are, the more certain one where none is.
        """
        told = {c: min(self, other, key=lambda either: either._rank(c, tests)) for c in self.p_value}
        return SlowResidual(
            self.recording,
            {c: either.rms[c] for c, either in told.items()},
            {c: either.floor[c] for c, either in told.items()},
            self.units,
            {c: min(1.0, tests * either.p_value[c]) for c, either in told.items()},
            {c: either.part[c] for c, either in told.items()},
        )

    @classmethod
    def of_motion_band(cls, recording: str, spectrum: ResidualSpectrum, units: Mapping[str, str]) -> SlowResidual:
        """The part in the motion's band of a residual, whose channels have these units by name."""
        size, noise = np.sqrt(spectrum.band_excess), np.sqrt(spectrum.noise_variance)
        return cls._of(recording, units, Part.MOTION_BAND, size, noise, spectrum.steepness_p_values)

    @classmethod
    def of_residual(cls, recording: str, residual: Array, units: Mapping[str, str]) -> SlowResidual:
        """The part of the slowest lines of a residual (n, p), whose channels have these units by name."""
        modes = dct(residual, axis=0, norm="ortho")[1:]
        slow = (modes[:SLOW_MODES] ** 2).sum(axis=0) / len(residual)
        rest = np.maximum((residual - residual.mean(axis=0)).var(axis=0) - slow, 0.0)
        p_values = np.array([_p_value(column) for column in (modes[: REFERENCE_MODES.stop] ** 2).T])
        return cls._of(recording, units, Part.SLOWEST, np.sqrt(slow), np.sqrt(rest), p_values)

    @property
    def significant(self) -> tuple[str, ...]:
        """Channels whose slow part is more than the noise's own spectrum lets expect."""
        return tuple(c for c, p in self.p_value.items() if p < LEVELS.effect)

    @property
    def above_noise(self) -> tuple[str, ...]:
        """Of these the channels in which it exceeds the noise floor: a misfit, whatever its cause."""
        return tuple(c for c in self.units if self._is_misfit(c))

    @property
    def loudest(self) -> str:
        """Of the channels above the noise the one with the largest part over its noise."""
        return max(self.above_noise, key=lambda c: self.rms[c] / max(self.floor[c], 1e-300))

    @property
    def wanders(self) -> bool:
        """Whether all that exceeds the noise is in the slowest lines: no place of the motion has it."""
        return all(self.part[c] is Part.SLOWEST for c in self.above_noise)

    def _is_misfit(self, channel: str, tests: int = 1) -> bool:
        """Whether a channel's part is significant, one of so many tested, and exceeds the noise floor."""
        return tests * self.p_value[channel] < LEVELS.effect and self.rms[channel] > self.floor[channel]

    def _rank(self, channel: str, tests: int) -> tuple[bool, float]:
        """Of two parts the one to be told has the lower rank."""
        misfit = self._is_misfit(channel, tests)
        return not misfit, -self.rms[channel] if misfit else self.p_value[channel]

    def to_data(self) -> dict[str, Any]:
        """Plain data."""
        sizes = {"rms": dict(self.rms), "noise_floor": dict(self.floor)}
        return {
            "recording": self.recording,
            "channels": list(self.significant),
            **sizes,
            "part": {c: self.part[c].name.lower() for c in self.significant},
            "misfit": bool(self.above_noise),
        }

    @property
    def sentence(self) -> str:
        """What remains, and what would decide its cause; empty when nothing significant does."""
        channels = self.above_noise or self.significant
        if not channels:
            return ""
        worst = max((self.part[c] for c in channels), key=list(Part).index)
        channels = tuple(c for c in channels if self.part[c] is worst)
        sizes = [f"{c} {format_number(self.rms[c], 2)} {self.units[c]} rms" for c in channels]
        floors = [f"{format_number(self.floor[c], 2)}" for c in channels]
        where = f"{self.recording}: {', '.join(sizes)} (noise beside it {', '.join(floors)})"
        return f"{worst.noun} remains on {where}: {worst.value}"


def slow_residuals(comparisons: Sequence[Comparison]) -> tuple[SlowResidual, ...]:
    """The significant slow residuals of the recordings."""
    each = (SlowResidual.of(comparison) for comparison in comparisons)
    return tuple(slow for slow in each if slow is not None and slow.significant)


def foreign_forces(comparisons: Sequence[Comparison]) -> tuple[str, ...]:
    """Force channels that are mostly not the tool's, where most of the changing force of each recording is not.

    None otherwise: the force of all channels together counts, as which of them the weight acts on is a matter of axes,
    and a recording whose force is mostly the tool's, or that is not tested as it repeats or rests, says what it weighs.
    What is faster than the motion and what follows it, as a vibration is, does not hide the tool.
    """
    each = [_foreign_forces(comparison) for comparison in comparisons]
    return tuple(dict.fromkeys(channel for foreign in each for channel in foreign)) if all(each) else ()


def _foreign_forces(comparison: Comparison) -> list[str]:
    recording, residual, units = comparison.recording, comparison.residual, comparison.space.channel_units
    forces = [units[c] == "N" for c in recording.channels]
    if not _is_tested(comparison):
        return []
    spectrum = ResidualSpectrum.of(residual, recording.wrench - residual)
    read = ResidualSpectrum(dct(recording.wrench, axis=0, norm="ortho") ** 2, spectrum.band)
    if spectrum.band_power[forces].sum() < FOREIGN_SHARE * read.band_power[forces].sum():
        return []
    foreign = SlowResidual.of_foreign(recording.name, spectrum, recording.wrench.var(axis=0), units)
    return [c for c in foreign.above_noise if units[c] == "N"]


def _is_tested(comparison: Comparison) -> bool:
    """Not with repeats, which show what is slow by themselves, nor static poses, nor a short record."""
    short = len(comparison.residual) < 4 * REFERENCE_MODES.stop
    return comparison.noise.source is not NoiseSource.REPEATS and not comparison.recording.at_rest and not short


def _p_value(power: Array) -> float:
    """P-value of the slow modes' power (modes,), given the level of the modes above.

    Their expectation goes on from that level as 1/f: sensors have white and 1/f noise, and what rises faster towards
    low frequencies wanders. In white noise, and below the corner of an autoregression, the test is conservative.
    """
    number = np.log(np.arange(1, len(power) + 1))
    slow, above = number[:SLOW_MODES], number[REFERENCE_MODES]
    logs = np.log(np.maximum(power[REFERENCE_MODES], 1e-300)) - LOG_CHI_SQUARE_MEAN
    expected = np.exp(logs.mean() + STEEPEST_NOISE * (slow - above.mean()))
    score = float((power[:SLOW_MODES] / expected).sum())
    return float(chi_square_p_value(score, SLOW_MODES, LOG_CHI_SQUARE_VARIANCE / len(above)))
