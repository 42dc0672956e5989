"""Noise of a recording from its repeats, the rig's stated std, or the residual of a fit, in that order."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimation.autoregression import fit_autoregression
from estimation.noise.events_in_repeats import find_events_in_repeats
from estimation.noise.power_spectrum import (
    CURVATURE_PRIORS,
    LEAST_REMAINING,
    PowerSpectrum,
    leakage_free,
    line_powers,
    log_power_variances,
    power_levels,
    smooth_power_spectra,
    without_leakage,
)
from estimation.noise.recording_noise import (
    MotionNoise,
    RecordingNoise,
    repeat_noise_floor,
    sample_step,
    stated_noise_floor,
    without_constant_channels,
)
from estimation.noise.tones import (
    disturbance_basis,
    find_tones,
    shape_columns,
    sinusoids,
    without_shapes,
    without_sinusoids,
)
from estimation.noise.transient_windows import EventShape, inside, samples_of
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, PoseWhitener
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import NO_REPEATS, largest_deviation
from modeling.errors import InputError
from modeling.noise import NoiseModel, NoiseSource, block_means, inverse_cholesky_factor

if TYPE_CHECKING:
    from estimation.recordings.dwells import Dwells

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

COHERENCE_BANDS = 8
"""Frequency bands in each of which the channels' coherence is taken constant, at the most."""


def noise_from_repeats(recording: Recording, residual: Array, shapes: tuple[EventShape, ...] = ()) -> RecordingNoise:
    """Noise from what differs between the repeats of a residual (n, p), less recording-specific disturbances.

    The floor is of the residual as it is: a model that explains a disturbance has it in neither. Of `shapes` only noise
    of repeats without pauses knows.
    """
    if recording.continuous:
        return _from_non_excited_lines(recording, residual, shapes)
    return _from_separate_runs(recording, residual)


def _from_non_excited_lines(recording: Recording, residual: Array, shapes: tuple[EventShape, ...]) -> RecordingNoise:
    """Noise from the non-excited lines, less recording-specific disturbances: drift, warm-up, events and tones.

    Projecting orthonormal columns Q out of noise of spectrum S leaves S (1 - h) at a line, h = sum |Q's line|² / n;
    the ordinates are divided by that, and lines with h above one half are not used. The strongest tone stays on the
    non-excited lines, where an effect may explain it; from the excited lines it is projected out, and all other tones
    from every row.
    """
    remaining = without_shapes(residual, recording, shapes)
    tones = find_tones(recording, remaining)
    n, repeats = len(residual), recording.repeats
    toneless = without_sinusoids(remaining, recording, tones)
    events = find_events_in_repeats(recording, toneless) if repeats > 2 else ()
    disturbances = disturbance_basis(recording, events, tones, shapes)
    smooth = disturbances if not events and not shapes else disturbance_basis(recording, (), tones)
    removed, removed_by_smooth = (_share_of_lines(basis) for basis in (disturbances, smooth))
    lines = np.fft.rfft(residual - disturbances @ (disturbances.T @ residual), axis=0)
    index = np.arange(len(lines))
    usable = (index % repeats != 0) & (1 - removed > LEAST_REMAINING) & (2 * index != n)
    non_excited, lines = index[usable], lines[usable]
    frequency, lowest = non_excited / (n * sample_step(recording)), 1 / (n * sample_step(recording))

    def smoothed(lines: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
        power = np.abs(lines) ** 2 / n
        return smooth_power_spectra(frequency, power, start=lowest, nyquist=nyquist, curvatures=_curvatures(nyquist))

    spectra, lines = leakage_free(
        lines / np.sqrt(1 - (removed - removed_by_smooth)[usable])[:, None],
        non_excited,
        n,
        recording.samples_per_repeat,
        sample_step(recording),
        smoothed,
        start=lines / np.sqrt(1 - removed[usable])[:, None],
        disturbances=np.fft.rfft(smooth, axis=0)[usable],
    )
    tone_free = ~np.any([s.tones for s in spectra], axis=0)
    tonal = np.zeros(len(index), dtype=bool)
    tonal[non_excited[~tone_free]] = True
    excited = index[(index % repeats == 0) & ~(np.roll(tonal, 1) & np.roll(tonal, -1))]
    others = index[(index % repeats != 0) & ~tonal]
    order = np.concatenate([excited, others])
    ordered = np.maximum(order, 1) / (n * sample_step(recording))
    levels = line_powers(spectra, n, recording.samples_per_repeat, sample_step(recording))
    weighted = levels[non_excited[tone_free]]
    white, shares = lines[tone_free] / np.sqrt(n * weighted), power_levels(spectra, frequency[tone_free]) / weighted
    root = _coherence_roots(non_excited[tone_free], white, shares, order) / np.sqrt(levels[order])[:, None, :]
    freedom = sum(s.freedom for s in spectra) / len(spectra) / len(non_excited)
    plain = FourierLineWhitener(n, repeats, excited, others, root * np.sqrt(1 - min(freedom, 0.5)))
    floor = repeat_noise_floor(recording, residual)
    return _recording_noise(recording, floor, plain, spectra, ordered, events, tones, shapes)


def _curvatures(nyquist: float) -> tuple[float, ...]:
    """Priors of a spectrum's curvature: of a filter where leakage shows one, or a curve would follow drifts."""
    return CURVATURE_PRIORS[1:] if nyquist < inf else CURVATURE_PRIORS[:2]


def _share_of_lines(basis: Array) -> Array:
    """Share (n // 2 + 1,) of the power of white noise at each line that is in an orthonormal basis (n, k)."""
    return np.asarray((np.abs(np.fft.rfft(basis, axis=0)) ** 2).sum(axis=1) / len(basis))


def _recording_noise(
    recording: Recording,
    floor: Array,
    plain: FourierLineWhitener,
    spectra: tuple[PowerSpectrum, ...],
    frequency: Array,
    events: tuple[tuple[float, float], ...] = (),
    tones: tuple[float, ...] = (),
    shapes: tuple[EventShape, ...] = (),
) -> RecordingNoise:
    """The noise with leakage, tones and shapes projected out; each line has two rows per channel, real parts first."""
    waves = [_in_each_channel(sinusoids(recording, [tone]), len(spectra)) for tone in tones]
    judged = waves[0].shape[2] if waves else 0
    waves += [_in_each_channel(shape_columns(recording, shapes), len(spectra))] if shapes else []
    projected = np.concatenate(waves, axis=2) if waves else None
    whitener = without_leakage(plain, spectra, sample_step(recording), projected, judged=judged)
    variance = log_power_variances(spectra, frequency)
    return RecordingNoise(
        floor=floor,
        whitener=whitener,
        source=NoiseSource.REPEATS,
        log_power_variance=np.concatenate([variance, variance], axis=1).ravel(),
        spectra=spectra,
        events=events,
        frequency=frequency,
        tones=tones,
        shapes=shapes,
    )


def _in_each_channel(waves: Array, channels: int) -> Array:
    """Series (n, k) as readings (n, p, k p) of one channel each."""
    return np.concatenate([np.multiply.outer(waves, row).swapaxes(1, 2) for row in np.eye(channels)], axis=2)


def _from_separate_runs(recording: Recording, residual: Array) -> RecordingNoise:
    """Runs that were started one by one: Fourier lines of one run, the noise from the differences between runs."""
    repeats, period = recording.repeats, recording.samples_per_repeat
    lines = np.fft.rfft(residual.reshape(repeats, period, -1), axis=1)
    differences = lines - lines.mean(0)
    excited = np.arange(lines.shape[1])
    inner = excited[1:-1]
    frequency = np.maximum(excited, 0.5) / (period * sample_step(recording))

    def smoothed(differences: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
        power, lowest = (np.abs(differences) ** 2).sum(0) / ((repeats - 1) * period), float(frequency[0])
        return smooth_power_spectra(
            frequency[inner], power, shape=repeats - 1.0, start=lowest, nyquist=nyquist, curvatures=_curvatures(nyquist)
        )

    spectra, differences[:, inner] = leakage_free(
        differences[:, inner], inner, period, period, sample_step(recording), smoothed
    )
    tone_free = np.ones(len(excited), dtype=bool)
    tone_free[inner] = ~np.any([s.tones for s in spectra], axis=0)
    levels = line_powers(spectra, period, period, sample_step(recording))
    white = differences / np.sqrt(period * levels) * np.sqrt(repeats / (repeats - 1))
    used = tone_free & (excited > 0)
    index = np.tile(excited[used], repeats)
    shares = np.tile((power_levels(spectra, np.maximum(frequency, frequency[1])) / levels)[used], (repeats, 1))
    root = _coherence_roots(index, white[:, used].reshape(len(index), -1), shares, excited[tone_free])
    root = root / np.sqrt(levels[tone_free])[:, None, :]
    plain = FourierLineWhitener(
        period * repeats, repeats, excited[tone_free] * repeats, np.zeros(0, dtype=np.intp), root
    )
    return _recording_noise(recording, repeat_noise_floor(recording, residual), plain, spectra, frequency[tone_free])


def _coherence_roots(
    index: NDArray[np.intp], white: NDArray[np.complex128], shares: Array, at: NDArray[np.intp]
) -> NDArray[np.complex128]:
    """Inverse roots (lines, p, p) of the channels' coherence at the lines `at`.

    The coherence is averaged over bands of equally many lines and taken constant in each. Lines whose noise is a
    smaller share (m, p) of the power by which they are weighted than others count for less: what leakage is left in
    them is the same few values in every channel. An inverse of an average of n products is too large by n / (n - p),
    with n of as many equal shares; the root carries the correction.
    """
    p = white.shape[1]
    order = np.argsort(index, kind="stable")
    bands = max(1, min(COHERENCE_BANDS, len(index) // 200))
    edges = [index[band[0]] for band in np.array_split(order, bands)]
    roots = []
    for band in np.array_split(order, bands):
        rows = white[band]
        matrix = rows.T @ rows.conj() / len(rows)
        scale = np.sqrt(np.real(np.diag(matrix)))
        matrix = matrix / np.outer(scale, scale)
        power = shares[band].mean(axis=1)
        number = power.sum() ** 2 / (power**2).sum()
        roots.append(inverse_cholesky_factor(matrix) * np.sqrt(max(1 - p / number, LEAST_REMAINING)))
    return np.stack(roots)[np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bands - 1)]


NEGLIGIBLE_POWER = 0.01
"""Of the motion's noise over the stated one where its spectrum is largest: less changes no estimate."""
MAX_BLOCKS = 1000
"""Blocks that a run is averaged into: enough for the bandwidth of a tool's motion, few enough for many refits."""


def estimate_noise(
    recording: Recording,
    residual: Array,
    fitted: int = 0,
    events: tuple[tuple[float, float], ...] = (),
    motion: MotionNoise | None = None,
    shapes: tuple[EventShape, ...] = (),
) -> RecordingNoise:
    """Noise of a recording from the residual (n, p) of any model of its periodic part.

    With repeats the residual's periodic part does not matter: the spectrum comes from the non-excited lines (or from
    differences of separate runs). Without, of poses that are the means of dwells it comes from the rows within these;
    else it is the std that the rig states per channel if it does, else an autoregression fitted to the residual, which
    then cannot test the size of that residual; `fitted` is the number of parameters behind it, `events` are intervals
    (s) of a run with noise of their own. To a stated std the noise of the `motion` of a run is added, with its colour;
    a residual has it in itself, and only where the motion is less certain than usual its rows weigh less. Of repeats
    events of any shape are left out, but for the wrench that a contact explains (`shapes`). A channel
    that never changes in a single run, or in poses at rest, has weight zero.
    """
    if recording.repeats > 1:
        _require_one_motion(recording)
        _require_nonzero_noise(recording)
        return noise_from_repeats(recording, residual, shapes)
    if recording.dwells is not None:
        return _noise_of_dwells(recording.dwells)
    stated = stated_noise_floor(recording)
    if stated is not None:
        return without_constant_channels(_noise_of_rig(stated, residual, events, motion), recording)
    return without_constant_channels(_noise_from_residual(recording, residual, fitted, events, motion), recording)


def _noise_of_dwells(dwells: Dwells) -> RecordingNoise:
    """The noise of the dwells' means, as the rows within them show it."""
    roots = np.stack([inverse_cholesky_factor(covariance) for covariance in dwells.covariance])
    whitener = PoseWhitener(roots)
    floor = np.sqrt((dwells.std**2).mean(axis=0))
    return RecordingNoise(floor, whitener, NoiseSource.DWELLS, np.tile(dwells.log_power_variance, len(dwells)))


def _noise_of_rig(
    stated: Array, residual: Array, events: tuple[tuple[float, float], ...], motion: MotionNoise | None
) -> RecordingNoise:
    """The stated std (p,) as white noise, and the noise of the motion with its colour.

    That is the autoregression of both: of draws of the motion's errors, each with white noise of the stated std.
    """
    if motion is None:
        whitener = AutoregressiveWhitener(len(residual), NoiseModel.white(stated))
        return RecordingNoise(stated, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events)
    drawn = np.concatenate(list(motion.errors))
    floor = np.sqrt(stated**2 + np.median(motion.variance, axis=0))
    noise = NoiseModel.white(stated)
    if np.max(drawn.var(axis=0) * motion.correlation_length / stated**2) > NEGLIGIBLE_POWER:
        white = np.random.default_rng(0).standard_normal(drawn.shape) * stated
        usual = np.tile(motion.is_usual, len(motion.errors))
        noise = replace(fit_autoregression(drawn + white, usual), source=NoiseSource.RIG)
    whitener = AutoregressiveWhitener(len(residual), noise, weights=motion.weights(floor, 1))
    return RecordingNoise(floor, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events, motion=motion)


def _require_one_motion(recording: Recording) -> None:
    """Raise InputError where a repeat is none: of another motion, out of phase, with a pause, or cut wrongly."""
    deviation = None if recording.dt is None else largest_deviation(recording.columns, recording.repeats)
    if deviation is None or recording.dt is None or not deviation.gross:
        return
    what = f"the motion of repeat {deviation.repeat}, counted from 0, {deviation.sentence(recording.dt)}"
    raise InputError(what=what, where=recording.name, remedy=NO_REPEATS)


def _require_nonzero_noise(recording: Recording) -> None:
    """Raise InputError for channels that are identical in every repeat."""
    largest = np.abs(recording.wrench).max(axis=0)
    floor = repeat_noise_floor(recording)
    noiseless = [
        c for c, f, size in zip(recording.channels, floor, largest, strict=True) if f <= 1e-9 * size or size == 0
    ]
    if noiseless:
        raise InputError(
            what=f"{', '.join(noiseless)} is identical in every repeat, so that no noise can be estimated",
            where=recording.name,
            remedy="record the raw sensor, or leave `repeat` out and state the noise under [sensor] in the rig",
        )


def _noise_from_residual(
    recording: Recording,
    residual: Array,
    fitted: int,
    events: tuple[tuple[float, float], ...],
    motion: MotionNoise | None,
) -> RecordingNoise:
    """Static poses: the std of each channel's residual. A run: an autoregression per channel, joint innovations.

    Such an estimate cannot test the size of that same residual.
    The residual of static poses is model error more than noise; taking its correlation between the channels for
    noise would let one channel's error bias what another has measured, so that correlations are left out. Within
    events (s) a run has a noise of its own: the residual's variance there about its mean, and its correlation time.
    """
    block = 1 if recording.at_rest else max(1, len(residual) // MAX_BLOCKS)
    floor = residual_floor(recording, residual, fitted, events)
    residual = block_means(residual, block)
    n, p = residual.shape
    ranges = [samples_of(event, sample_step(recording) * block, n) for event in events]
    if recording.at_rest:
        noise = NoiseModel.white(floor)
    else:
        noise = replace(fit_autoregression(residual, ~inside(ranges, n)), block=block)
    in_events = np.concatenate(
        [residual[start:end] - residual[start:end].mean(axis=0) for start, end in ranges] or [residual]
    )
    event_noise = NoiseModel.white(_white_equivalent_std(in_events, floor))
    weights = None if motion is None else motion.weights(floor, block)
    whitener = AutoregressiveWhitener(recording.samples, noise, tuple(ranges), event_noise, weights)
    parameters = noise.coefficients.size + p * (p + 1) / 2
    log_power_variance = np.full(whitener.rows, 2 * parameters / (n * p))
    return RecordingNoise(floor, whitener, NoiseSource.RESIDUAL, log_power_variance, events=events, motion=motion)


def residual_floor(
    recording: Recording, residual: Array, fitted: int, events: tuple[tuple[float, float], ...]
) -> Array:
    """Std of one sample (p,) of the residual of a model of so many parameters, outside events."""
    ranges = [samples_of(event, sample_step(recording), len(residual)) for event in events]
    event_free = ~inside(ranges, len(residual))
    floor = np.sqrt((residual[event_free] ** 2).sum(axis=0) / max(1.0, event_free.sum() - fitted / residual.shape[1]))
    return np.asarray(np.maximum(floor, 1e-12 * max(floor.max(), 1e-300)))


def with_floor_of(noise: RecordingNoise, recording: Recording, residual: Array) -> RecordingNoise:
    """The noise, where it is that of a residual, with the std of one sample of this one."""
    if noise.source is not NoiseSource.RESIDUAL or noise.beside_pose:
        return noise
    return replace(noise, floor=residual_floor(recording, residual, 0, noise.events))


def _white_equivalent_std(in_events: Array, floor: Array) -> Array:
    """Std of a sample of white noise whose mean varies as much as that of this first-order correlated noise."""
    spread = np.maximum(in_events.std(axis=0), floor)
    correlation = (in_events[1:] * in_events[:-1]).mean(axis=0) / np.maximum(in_events.var(axis=0), 1e-300)
    correlation = np.clip(correlation, 0.0, 1 - 4 / len(in_events))
    return np.asarray(spread * np.sqrt((1 + correlation) / (1 - correlation)))
