"""Comparison of a fit with a recording: residual, reduced chi-square, systematic error, lack-of-fit test."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import isclose

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.validation import StandardisedResidual, ValidationFit
from estimation.fit import Fit
from estimation.fit_column_space import fit_column_space, rows_of_recordings, run_spectrum
from estimation.multiplicity import bonferroni_p_value, chi2_sf, chi_square_p_value, normal_isf
from estimation.noise.events_in_repeats import find_events_in_repeats, find_stretches_in_repeats
from estimation.noise.power_spectrum import line_powers, power_levels
from estimation.noise.recording_noise import RecordingNoise, sample_step
from estimation.noise.tones import without_shapes
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import in_sensor_frame
from modeling.noise import NoiseSource
from modeling.number_format import P_VALUE, p_value_text
from modeling.space import Space
from modeling.table import Cell, Column, Table, Tabular, Value

# Generic regressors of the recorded inputs, and the cross-validated lack-of-fit test that uses them.


Array = NDArray[np.float64]

FOLDS = 13
"""Blocks: 2^(1 - 13) is the smallest p-value of sign flips, below the level of held-out recordings; 10 do not do."""
RESTS = 1e-9
"""Std of a signal, in its own unit, that is rounding of one that is constant."""
NEVER_TURNS = 1e-6
"""Std of a velocity whose sign is that of errors of a derivative."""
REVERSAL = 0.05
"""Width, over the std of a velocity, within which its sign changes: as far as its own noise reaches."""
EQUAL_GAINS = 1e-12
"""Relative rounding of gains: those of sign patterns that are as good count as such."""
LEAST_FREEDOM = 0.5
"""Degrees of freedom that a band keeps beside the fit, below which it tests nothing."""
NEGLIGIBLE_SHARE = 0.1
"""Of the noise floor: an error that nobody looks for where a rig states no tolerance."""
OUTLYING = 6.0
"""Robust std from the other repeats: of normal noise one sample in five hundred million is farther."""
RAISED = 2.0
"""Noise floor over robust std from which outliers make the noise: 1 of normal noise of any colour, 1.4 of Laplace's,
1.5 of Student's with three degrees of freedom."""

UNREPEATED = 2.0
"""Mean square of what differs between repeats, over that of the noise, from which it is not that noise: as much again
is neither noise nor does it repeat."""
EVENTS_LEFT = 0.5
"""Share of the time of a recording's events in which one repeat still deviates from the others, from which they are not
explained: of an event with another edge than its effect has, little is left."""

UNEQUAL = 10.0
"""Noise floor over the largest of the other axes': those of one sensor differ by two or three, by its shape."""


def generic_terms(recording: Recording, load: Array) -> dict[str, Array]:
    """Regressors (n,) by name, of direction, position, velocities, accelerations and the predicted load (n, p).

    Directions enter as sine and cosine, the load to second and third order, all else to second order; velocities also
    by their (smoothed) sign. Constant and unrecorded terms are left out.
    """
    signals = recording.motion.model_signals
    terms: dict[str, Array] = {}
    if recording.dimension == 2:
        phi = signals["phi"]
        for k in (1, 2, 3):
            terms |= {f"sin {k} phi": np.sin(k * phi), f"cos {k} phi": np.cos(k * phi)}
        plain: tuple[str, ...] = ("px", "py", "dphi", "ddphi", "vx", "vy", "ax", "ay")
    else:
        down = gravity_direction(signals)
        for i, a in enumerate("xyz"):
            terms |= {
                f"down_{a}²" if i == j else f"down_{a} down_{b}": down[i] * down[j]
                for j, b in enumerate("xyz")
                if j >= i
            }
            terms[f"down_{a}"] = down[i]
        plain = tuple(p + a for p in ("p", "w", "al", "vp", "ap") for a in "xyz")
    for name in plain:
        if name in signals and signals[name].std() > RESTS:
            terms |= {name: signals[name], f"{name}²": signals[name] ** 2}
    for name in ("dphi", "vx", "vy", "wx", "wy", "wz"):
        if name in signals and signals[name].std() > NEVER_TURNS:
            terms[f"sign {name}"] = np.tanh(signals[name] / (REVERSAL * signals[name].std()))
    for channel, series in zip(recording.channels, load.T, strict=True):
        terms |= {f"{channel}²": series**2, f"{channel}³": series**3}
    return {name: series for name, series in terms.items() if np.ptp(series) > 0}


def gravity_direction(signals: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """Unit vector along the world's -z in the sensor frame: three components (n,)."""
    x, y, z = in_sensor_frame(signals, (0.0, 0.0, -1.0)).T
    return x, y, z


def standardised_columns(terms: dict[str, Array]) -> Array:
    """Regressor matrix (n, terms), columns of zero mean and unit variance."""
    matrix = np.stack(list(terms.values()), axis=1)
    matrix = matrix - matrix.mean(axis=0)
    return np.asarray(matrix / matrix.std(axis=0))


def smallest_gain_p_value(whitener: AutoregressiveWhitener) -> float:
    """The smallest p-value that the sign flips of `cross_validated_gain` can give: one pattern of all."""
    return 2.0 ** (1 - min(FOLDS, whitener.rows // len(whitener.noise.covariance)))


@dataclass(frozen=True)
class CrossValidatedGain:
    """Cross-validated prediction of the residual by generic terms.

    gain     drop of the whitened chi-square on held-out blocks; zero mean under noise, so that it may be negative
    p_value  by a sign-flip permutation test over the blocks, in rows without the colour that whitening leaves
    """

    gain: float
    p_value: float


def cross_validated_gain(fit: Fit, number: int, residual: Array) -> CrossValidatedGain:
    """Cross-validated gain of generic terms on the residual (n, p) of a single run: each block by all others.

    The whitened residual of each channel is regressed (ridge) on a constant and the whitened terms; the gain of a
    held-out block is its residual times its prediction. The sum of the gains is a quadratic form in the blocks'
    residuals without its diagonal; under noise the blocks' signs are exchangeable, and all 2^(blocks - 1) sign
    patterns give the null distribution. They are not where 1/f noise goes on from block to block, which an
    autoregression does not whiten: for the p-value the rows are flattened by their own spectrum. Less powerful than
    repeats: the autoregression absorbs part of the residual.
    """
    recording, whitener = fit.recordings[number], fit.noise[number].whitener
    assert isinstance(whitener, AutoregressiveWhitener), "the test is for a single run"
    load = recording.wrench - residual
    p = len(recording.channels)
    terms = generic_terms(recording, load)
    constant = np.ones((recording.samples, 1))
    columns = np.column_stack([constant, standardised_columns(terms)]) if terms else constant
    whitened = whitener.series(residual).reshape(-1, p)
    blocks = np.array_split(np.arange(len(whitened)), min(FOLDS, len(whitened)))
    spectrum = run_spectrum(fit, number)
    pairs = np.zeros((len(blocks), len(blocks)))
    flat_pairs = pairs.copy()
    for channel in range(p):
        white, rows = whitener.of_channel(channel).series(columns[:, None]), whitened[:, channel]
        pairs += _gain_of_pairs(white, rows, blocks)
        if spectrum is not None:
            flat_pairs += _gain_of_pairs(spectrum.flattened(white, channel), spectrum.flattened(rows, channel), blocks)
    flat_pairs = pairs if spectrum is None else flat_pairs
    signs = np.array(list(product((1.0, -1.0), repeat=len(blocks) - 1)))
    signs = np.column_stack([np.ones(len(signs)), signs])
    gains = np.einsum("sb,bc,sc->s", signs, flat_pairs, signs)
    return CrossValidatedGain(float(pairs.sum()), float(np.mean(gains >= gains[0] * (1 - EQUAL_GAINS))))


def _gain_of_pairs(white: Array, residual: Array, blocks: list[NDArray[np.intp]]) -> Array:
    """Matrix (blocks, blocks): element (b, c) is the contribution of block c to the gain of held-out block b."""
    gram = white.T @ white
    ridge = np.eye(len(gram)) * max(1e-3 * np.trace(gram) / len(gram), 1.0)
    moments = np.stack([white[block].T @ residual[block] for block in blocks], axis=1)
    pairs = np.stack(
        [
            moments[:, b] @ np.linalg.solve(gram - white[block].T @ white[block] + ridge, moments)
            for b, block in enumerate(blocks)
        ]
    )
    np.fill_diagonal(pairs, 0.0)
    return pairs


def pose_p_value(fit: Fit, number: int, residual: Array) -> float:
    """P-value that the residual (n, p) of poses at rest depends on the pose no more than noise does."""
    from estimation.noise.pose_noise import PoseNoise

    noise = PoseNoise.of(fit.recordings[number], residual)
    return 1.0 if noise is None else noise.p_value


def event_mean_p_value(fit: Fit, number: int, residual: Array) -> float:
    """P-value that the residual (n, p) within a run's events has zero mean, 1 without events.

    Each event's whitened rows, whitened with the residual's variance about its mean there, are summed per channel.
    """
    whitener = fit.noise[number].whitener
    if not isinstance(whitener, AutoregressiveWhitener) or not whitener.events:
        return 1.0
    rows = whitener.series(residual).reshape(-1, len(whitener.noise.covariance))
    order = whitener.noise.order
    sums = [
        rows[max(0, s - order) : e - 2 * order].sum(axis=0) / np.sqrt(max(1, e - s - order)) for s, e in whitener.events
    ]
    statistic = float(np.sum(np.square(sums)))
    return float(chi2_sf(statistic, len(sums) * rows.shape[1]))


# Generic terms of the residual's regression, in words.


PLANAR_WORDS = {
    "phi": "orientation",
    "dphi": "angular velocity",
    "ddphi": "angular acceleration",
    "tau": "predicted torque",
}
"""Signals of the plane that have no axis in their name."""
AXIS_WORDS = {
    "p": "position along the world's {}",
    "v": "velocity along the world's {}",
    "vp": "velocity along the world's {}",
    "a": "acceleration along the world's {}",
    "ap": "acceleration along the world's {}",
    "w": "angular velocity about the sensor's {}",
    "al": "angular acceleration about the sensor's {}",
    "down_": "gravity's direction along the sensor's {}",
    "f": "predicted force along the sensor's {}",
    "t": "predicted torque about the sensor's {}",
}
"""By the name without its axis."""
POWERS = {"²": " squared", "³": " cubed"}


def term_in_words(term: str) -> str:
    """The meaning of a generic term; itself where it is a recorded signal of the user's.

    Examples
    --------
    >>> term_in_words("px")
    "position along the world's x"
    """
    return _words(term) or term


def _words(term: str) -> str:
    operator, _, signal = term.rpartition(" ")
    power = POWERS.get(signal[-1:], "")
    meaning = _signal_words(signal.rstrip("".join(POWERS)))
    if not operator or not meaning:
        return meaning and meaning + power
    if operator == "sign":
        return f"direction of the {meaning}"
    if operator.startswith(("sin", "cos")):
        name, multiple = operator.split()
        return (
            f"{'sine' if name == 'sin' else 'cosine'} of {'' if multiple == '1' else f'{multiple} times '}the {meaning}"
        )
    return f"{_signal_words(operator)} times that along {signal[-1]}"


def _signal_words(signal: str) -> str:
    if signal in PLANAR_WORDS:
        return PLANAR_WORDS[signal]
    axis = re.fullmatch(r"(.*)([xyz])", signal)
    return "" if axis is None or axis[1] not in AXIS_WORDS else AXIS_WORDS[axis[1]].format(axis[2])


MEASURES = (Column("reduced chi-square", format=".3g"), Column("lack-of-fit p", format=P_VALUE))
"""Columns of a table of errors after those of the channels."""


def size_columns(space: Space) -> tuple[Column, ...]:
    """Columns of a table for a size of each channel, in its unit."""
    return tuple(Column(channel, unit, format=".3g") for channel, unit in space.channel_units.items())


@dataclass(frozen=True, eq=False)
class Comparison(Tabular):
    """One recording against its prediction.

    noise_floor      noise std of one sample, per channel
    rms              RMS of the residual over all samples, per channel
    explainable_rms  systematic error: root of the residual power that repeats or is slower than the repeats; None
                     without repeats
    explainable_std  standard error of the systematic power (explainable_rms²), from the noise alone
    beyond_parameters  of a held-out recording the systematic error that errors of the estimates kept do not explain;
                     of a fitted one explainable_rms
    misfit           reduced chi-square of the whitened residual, of a held-out recording with the uncertainty of the
                     estimates kept; None where the noise is estimated from the residual
    lack_of_fit      p-value of "the residual is consistent with the noise"
    smallest_lack_of_fit  that its test can give: permutations are countable; 0 of the other tests
    cross_validated_gain  of generic terms on the residual; None unless the noise is estimated from it
    unrepeated_power  mean square of the whitened residual at the lines that do not repeat; 1 without such lines
    """

    recording: Recording
    residual: Array
    noise: RecordingNoise
    noise_floor: Mapping[str, float]
    rms: Mapping[str, float]
    explainable_rms: Mapping[str, float] | None
    explainable_std: Mapping[str, float] | None
    beyond_parameters: Mapping[str, float] | None
    misfit: float | None
    lack_of_fit: float
    smallest_lack_of_fit: float = 0.0
    cross_validated_gain: CrossValidatedGain | None = None
    unrepeated_power: float = 1.0

    @cached_property
    def events_left(self) -> tuple[tuple[float, float], ...]:
        """Intervals (s) in which one repeat deviates from the others, if the events of the noise are not explained.

        Without such events, those in which it deviates by far more than elsewhere, to and fro.
        """
        if self.noise.source is not NoiseSource.REPEATS:
            return ()
        judged = [shape for shape in self.noise.shapes if shape.judged]
        residual = without_shapes(self.residual, self.recording, judged)
        shapeless = without_shapes(self.residual, self.recording, self.noise.shapes)
        stretches = find_stretches_in_repeats(self.recording, shapeless)
        of_two = self.recording.repeats == 2
        left = find_events_in_repeats(self.recording, residual) if self.noise.events or of_two else ()
        time = np.arange(self.recording.samples) * sample_step(self.recording)
        events, still = (
            np.any([(time >= begin) & (time < end) for begin, end in each] or [time < 0], axis=0)
            for each in (self.noise.events, left)
        )
        return left if of_two or (events & still).sum() >= EVENTS_LEFT * max(events.sum(), 1) else stretches

    @property
    def differs_between_repeats(self) -> bool:
        """Whether what does not repeat is more than noise: events that no effect explains, or more than twice it."""
        return self.unrepeated_power > UNREPEATED or bool(self.events_left)

    @property
    def lack_of_fit_cell(self) -> Cell:
        """The p-value of the lack of fit for a table, marked where it is the smallest that its test can give."""
        smallest = self.smallest_lack_of_fit > 0 and isclose(self.lack_of_fit, self.smallest_lack_of_fit)
        return Cell(self.lack_of_fit, "≤ " if smallest else "")

    @property
    def lack_of_fit_text(self) -> str:
        """The p-value of the lack of fit in words."""
        if self.lack_of_fit_cell.mark:
            return f"{p_value_text(self.lack_of_fit, '≤')}, the smallest that this test can give"
        return p_value_text(self.lack_of_fit)

    @property
    def outlier_notes(self) -> list[str]:
        """One line for each channel whose noise floor, measured from repeats, is that of a few outliers.

        Of poses at rest whose noise is that of their residual, for each whose floor is far above the other axes'.
        """
        if self.noise.source is NoiseSource.RESIDUAL and self.recording.at_rest:
            return _unequal_notes(self)
        return [] if self.noise.source is not NoiseSource.REPEATS else _outlier_notes(self)

    @property
    def reduced_chi_square(self) -> float | None:
        """The same as `misfit`, the name that it has in result.json."""
        return self.misfit

    @property
    def systematic_rms(self) -> Mapping[str, float] | None:
        """The same as `explainable_rms`, the name that it has in result.json."""
        return self.explainable_rms

    @property
    def space(self) -> Space:
        """Planar or six axes."""
        return Space(self.recording.dimension)

    @cached_property
    def explainable_limit(self) -> Mapping[str, float] | None:
        """Upper limit of the systematic error per channel: its power plus two standard errors, as an RMS."""
        if self.explainable_rms is None or self.explainable_std is None:
            return None
        return {c: float(np.sqrt(rms**2 + 2 * self.explainable_std[c])) for c, rms in self.explainable_rms.items()}

    def systematic_cell(self, channel: str) -> Cell:
        """Systematic error of a channel for a table: its upper limit, marked so, where it is estimated as zero.

        The total RMS without repeats.
        """
        if self.explainable_rms is None:
            return Cell(self.rms[channel])
        size, limit = self.explainable_rms[channel], self.explainable_limit
        return Cell(size) if size > 0 or limit is None else Cell(limit[channel], "< ")

    @property
    def errors(self) -> tuple[Value, ...]:
        """Systematic error of each channel, reduced chi-square and lack of fit, under `size_columns` and `MEASURES`."""
        cells = (self.systematic_cell(channel) for channel in self.recording.channels)
        return (*cells, self.misfit, self.lack_of_fit_cell)

    @property
    def table(self) -> Table:
        """Channel, unit, noise floor, RMS and systematic RMS, or its upper limit."""
        repeated = self.explainable_rms is not None
        rows = [
            (c, unit, self.noise_floor[c], self.rms[c], self.systematic_cell(c) if repeated else None)
            for c, unit in self.space.channel_units.items()
        ]
        numbers = (Column(name, format=".4g") for name in ("noise floor", "rms", "systematic rms"))
        return Table.of(("channel", "unit", *numbers), rows)

    def printed(self) -> list[Table | str]:
        """The table, then the remarks."""
        return [self.table, *self.remarks()]

    def remarks(self) -> list[str]:
        """Reduced chi-square and lack of fit; where the noise is taken from the residual, that it is."""
        if self.noise.source is NoiseSource.RESIDUAL:
            taken = "noise floor taken from the residual itself, so without reduced chi-square"
            return [f"{taken}; lack of fit {self.lack_of_fit_text}"]
        misfit = "-" if self.misfit is None else f"{self.misfit:.4g}"
        return [f"reduced chi-square {misfit}, lack of fit {self.lack_of_fit_text}"]


def _outlier_notes(comparison: Comparison) -> list[str]:
    recording = comparison.recording
    blocks = comparison.residual.reshape(recording.repeats, recording.samples_per_repeat, -1)
    deviation = np.abs(blocks - np.median(blocks, axis=0))
    random = np.abs(blocks - blocks.mean(axis=0)) * np.sqrt(recording.repeats / (recording.repeats - 1))
    robust = np.median(random, axis=(0, 1)) / normal_isf(0.25)
    notes = []
    for number, (channel, unit) in enumerate(comparison.space.channel_units.items()):
        floor, scale = comparison.noise_floor[channel], float(robust[number])
        count = int((deviation[:, :, number] > OUTLYING * scale).sum())
        if count and scale > 0 and floor > RAISED * scale:
            notes.append(
                f"{recording.name}: {count} of {recording.samples} samples of {channel} are outliers, more than"
                f" {OUTLYING:g} robust std from the other repeats, and raise its noise floor from {scale:.2g} to"
                f" {floor:.2g} {unit}: `truewrench fit --robust` or `tw.robust_fit` limits their influence."
            )
    return notes


def _unequal_notes(comparison: Comparison) -> list[str]:
    left_out = {comparison.recording.channels[number] for number in comparison.noise.left_out}
    notes = []
    for channel, unit in comparison.space.channel_units.items():
        others = [
            comparison.noise_floor[other]
            for other, its_unit in comparison.space.channel_units.items()
            if its_unit == unit and other != channel and other not in left_out
        ]
        floor, least = comparison.noise_floor[channel], max(others, default=0.0)
        if least > 0 and floor > UNEQUAL * least and channel not in left_out:
            notes.append(
                f"{comparison.recording.name}: the noise of {channel}, {floor:.2g} {unit}, is {floor / least:.2g} times"
                " that of the other axes. It is that of the residual: a poor channel, or something that acts in it"
                " alone and that no function of the pose shows; the sensor's stated noise, in the rig, tells which."
            )
    return notes


def comparison_of(fit: Fit, number: int) -> Comparison:
    """Comparison of a fit with its recording of that number."""
    recording, noise, residual = fit.recordings[number], fit.noise[number], fit.residuals[number]
    channels, floor = recording.channels, fit.noise_floor(number)
    power = (residual**2).mean(axis=0)
    tested = standardised_residual(fit, number)
    explainable, beyond = (
        explainable_power(recording, r, noise) if noise.source is NoiseSource.REPEATS else None
        for r in (residual, tested.readings)
    )
    gain = cross_validated_gain(fit, number, tested.readings) if noise.source is NoiseSource.RESIDUAL else None
    misfit, p_value = lack_of_fit_test(fit, number, tested, gain)
    return Comparison(
        recording=recording,
        residual=residual,
        noise=replace(noise, floor=floor),
        noise_floor=_by_channel(channels, floor),
        rms=_by_channel(channels, np.sqrt(power)),
        explainable_rms=None if explainable is None else _by_channel(channels, np.sqrt(explainable[0])),
        explainable_std=None if explainable is None else _by_channel(channels, explainable[1]),
        beyond_parameters=None if beyond is None else _by_channel(channels, np.sqrt(beyond[0])),
        misfit=misfit,
        lack_of_fit=p_value,
        smallest_lack_of_fit=smallest_lack_of_fit(noise),
        cross_validated_gain=gain,
        unrepeated_power=_unrepeated_power(recording, noise, tested),
    )


def comparisons_of(fit: Fit) -> tuple[Comparison, ...]:
    """Comparison of a fit with each of its recordings."""
    return tuple(comparison_of(fit, number) for number in range(len(fit.recordings)))


def _by_channel(channels: tuple[str, ...], values: Array) -> dict[str, float]:
    return {c: float(v) for c, v in zip(channels, values, strict=True)}


def explainable_power(recording: Recording, residual: Array, noise: RecordingNoise) -> tuple[Array, Array]:
    """Systematic power of the residual per channel, and its standard error, both (p,).

    For repeats e_r of the residual, each less its own mean, the power that repeats is the mean of e_r e_s over all
    pairs of different repeats, to which independent noise contributes nothing on average. The variance of the
    repeats' means in excess of that expected from the noise spectrum is added. With noise of spectrum S the standard
    error is sqrt(2 mean(S²) / (N R (R - 1))).
    """
    repeats, once = recording.repeats, recording.samples_per_repeat
    blocks = residual.reshape(repeats, once, -1)
    means = blocks.mean(axis=1)
    inner = blocks - means[:, None]
    pairs = repeats * (repeats - 1)
    repeating = ((inner.sum(axis=0) ** 2).sum(axis=0) - (inner**2).sum(axis=(0, 1))) / (once * pairs)
    frequency = np.asarray(np.fft.rfftfreq(recording.samples, sample_step(recording))[1:], dtype=np.float64)
    levels = power_levels(noise.spectra, frequency)
    spread = np.sqrt(2 * (levels**2).mean(axis=0) / (once * pairs))
    slow = means.var(axis=0, ddof=1) - _variance_of_means(levels, recording)
    return np.maximum(repeating, 0.0) + np.maximum(slow, 0.0), spread


def _variance_of_means(levels: Array, recording: Recording) -> Array:
    """Expected variance over repeats of a repeat's mean, from the noise spectrum (lines, p)."""
    n, repeats, once = recording.samples, recording.repeats, recording.samples_per_repeat
    box = np.zeros(n)
    box[:once] = 1 / once
    gain = np.abs(np.fft.rfft(box)[1:]) ** 2
    return np.asarray(2 * (gain[:, None] * levels).sum(axis=0) / n * repeats / (repeats - 1))


def lack_of_fit_test(
    fit: Fit, number: int, tested: StandardisedResidual, gain: CrossValidatedGain | None
) -> tuple[float | None, float]:
    """Reduced chi-square of one recording of a fit, and the p-value of its lack of fit.

    With a noise estimate independent of the residual, the whitened rows are tested in frequency bands (each against F,
    as the spectrum is itself estimated), and the smallest p-value is Bonferroni-corrected; of a stated std the power of
    a record differs by chance, the more the redder its noise is. Where the noise is estimated from the residual, the
    test is the `gain` of a cross-validated prediction of the residual by generic terms of the inputs, and of poses at
    rest, which are few, the F test of `PoseNoise`.
    """
    if gain is not None:
        own = pose_p_value if fit.recordings[number].at_rest else event_mean_p_value
        return None, bonferroni_p_value([gain.p_value, own(fit, number, tested.readings)])
    noise = fit.noise[number]
    rows, leverage = tested.rows, tested.leverage
    excited = noise.whitener.periodic_rows
    expected = ((1 - leverage) * expected_squares(fit.recordings[number], noise))[:excited].sum()
    total = (rows[:excited] ** 2).sum() / max(1.0, expected)
    p_values, coloured = [], _record_power_variance(fit, number)
    for band in frequency_bands(noise):
        degrees_of_freedom = band.sum() - leverage[band].sum()
        if degrees_of_freedom > LEAST_FREEDOM:
            power = float((rows[band] ** 2).sum())
            shares = (rows * band)[:, None] ** 2 / max(power, 1e-300)
            variance = float(noise.log_power_variance_of(shares)[0]) + coloured
            p_values.append(float(chi_square_p_value(power, degrees_of_freedom, variance)))
    return float(total), bonferroni_p_value(p_values)


def expected_squares(recording: Recording, noise: RecordingNoise) -> Array:
    """Mean square (rows,) of each whitened row of noise: 1, but less where leakage is part of a line's weight."""
    whitener = noise.whitener
    if not isinstance(whitener, FourierLineWhitener) or noise.spectra[0].nyquist == np.inf:
        return np.ones(whitener.rows)
    once = recording.samples_per_repeat
    samples = recording.samples if len(whitener.non_excited_lines) else once
    lines = np.concatenate([whitener.excited_lines, whitener.non_excited_lines]) * samples // recording.samples
    weights = line_powers(noise.spectra, samples, once, sample_step(recording))[lines]
    shares = power_levels(noise.spectra, noise.frequency) / weights
    return np.concatenate([shares, shares], axis=1).ravel()


def _unrepeated_power(recording: Recording, noise: RecordingNoise, tested: StandardisedResidual) -> float:
    """Mean square of the whitened rows of the lines that do not repeat, over that of noise; 1 where there are none."""
    if not isinstance(noise.whitener, FourierLineWhitener):
        return 1.0
    others = slice(noise.whitener.periodic_rows, None)
    freedom = float(((1 - tested.leverage) * expected_squares(recording, noise))[others].sum())
    return float((tested.rows[others] ** 2).sum()) / freedom if freedom > LEAST_FREEDOM else 1.0


def _record_power_variance(fit: Fit, number: int) -> float:
    """Variance of the logarithm of a run's whole power under a stated std, beyond that of white noise."""
    spectrum = run_spectrum(fit, number)
    if spectrum is None:
        return 0.0
    shares = spectrum.level.sum(axis=0) / spectrum.level.sum()
    return float(shares**2 @ spectrum.log_power_variance)


def noise_from_residual(fit: Fit) -> bool:
    """Whether any recording's noise is estimated from the residual."""
    return any(n.source is NoiseSource.RESIDUAL for n in fit.noise)


def smallest_lack_of_fit(noise: RecordingNoise) -> float:
    """The smallest p-value of `lack_of_fit_test` that sign flips can give, corrected as it is; 0 of other tests."""
    whitener = noise.whitener
    if noise.source is not NoiseSource.RESIDUAL or not isinstance(whitener, AutoregressiveWhitener):
        return 0.0
    return bonferroni_p_value([smallest_gain_p_value(whitener), 1.0])


def standardised_residual(fit: Fit, number: int) -> StandardisedResidual:
    """The residual of one recording against all that is uncertain of it: every test of lack of fit is of this."""
    if isinstance(fit, ValidationFit):
        return fit.standardised_residual()
    column_space, rows = fit_column_space(fit), rows_of_recordings(fit)[number]
    return StandardisedResidual(column_space.residual[rows], column_space.leverage[rows], fit.residuals[number])


def frequency_bands(noise: RecordingNoise) -> list[NDArray[np.bool_]]:
    """Masks of the rows tested together: excited lines by octaves, and non-excited lines below the fundamental.

    A single band where rows are not Fourier lines.
    """
    whitener = noise.whitener
    everything = np.arange(whitener.rows)
    if not isinstance(whitener, FourierLineWhitener):
        return [everything >= 0]
    per_line = whitener.rows // (len(whitener.excited_lines) + len(whitener.non_excited_lines))
    harmonic = whitener.excited_lines // whitener.repeats
    octave = np.maximum(0, np.ceil(np.log2(np.maximum(harmonic, 1) / 8))).astype(int)
    slow = np.where(whitener.non_excited_lines < whitener.repeats, -1, -2)
    label = np.repeat(np.concatenate([octave, slow]), per_line)
    return [label == o for o in np.unique(label) if o != -2]
