"""Transient events in a single run: one interval with a wrench, or a mass, that the rigid tip cannot explain.

Student's t, Bonferroni-corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.model_response import model_response
from estimation.multiplicity import student_isf
from estimation.noise.transient_windows import Window, Windows, cumulative_sums, inside
from estimation.parameter_layout import parameter_layout
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.identifiability import ScaledSVD
from modeling.significance import LEVELS

Array = NDArray[np.float64]

BLOCKS_PER_RUN = 120
"""Blocks that a run is averaged into; an event lasts at least two of them."""
SMALLEST_SINGULAR_VALUE = 1e-6
"""Of the weighted regressor, over its largest, from which a direction of the tip's parameters is determined."""
LEAST_SHARE_OUTSIDE = 1e-8
"""Of a direction's information that the blocks outside a window must have for it to be a difference of sums."""
COARSE_STEP = 6
"""Blocks between the ends of the windows that are tried first."""


@dataclass(frozen=True, eq=False)
class BlockAverages:
    """Readings and regressor of recordings averaged over blocks, slow enough for a tool's load or an event.

    reading (b, p), regressor (b, p, k) in the unknowns, owner (b,) the recording of each block
    """

    reading: Array
    regressor: Array
    owner: NDArray[np.intp]

    @cached_property
    def scale(self) -> Array:
        """Std of each block and channel (b, p): the median size of the recording's successive differences."""
        scale = np.ones_like(self.reading)
        for number in np.unique(self.owner):
            in_run = self.owner == number
            steps = np.abs(np.diff(self.reading[in_run], axis=0))
            scale[in_run] = np.maximum(np.median(steps, axis=0), 1e-9 + 1e-6 * np.abs(self.reading[in_run]).max(axis=0))
        return scale

    def residual_without(self, left_out: NDArray[np.bool_]) -> Array:
        """Residual (b, p) of all blocks after a weighted fit to those not left out."""
        return np.asarray(self.reading - self.regressor @ self.estimate_without(left_out))

    def estimate_without(self, left_out: NDArray[np.bool_]) -> Array:
        """The unknowns (k,) by a weighted fit to the blocks not left out."""
        used = ~left_out
        rows = (self.regressor / self.scale[:, :, None])[used].reshape(-1, self.regressor.shape[2])
        target = (self.reading / self.scale)[used].ravel()
        length = np.linalg.norm(rows, axis=0)
        length[length == 0] = 1.0
        return np.asarray(np.linalg.lstsq(rows / length, target, rcond=SMALLEST_SINGULAR_VALUE)[0] / length)

    def scaled_residuals_without(self, number: int, first: NDArray[np.intp], last: NDArray[np.intp]) -> Array:
        """Residuals (w, b', p) over `scale` of one recording's b' blocks, of w fits to the blocks of all recordings.

        Each fit leaves out that recording's blocks from `first` to before `last` (w,). With orthonormal columns U of
        the weighted regressor, of which U_w are the rows left out, the coordinates z of a fit to the others solve
        (1 - U_w' U_w) z = U' y - U_w' y_w: sums over blocks, for all windows at once. Where the other blocks hardly
        determine the tip, each window has a fit of its own.
        """
        in_run = np.flatnonzero(self.owner == number)
        target = self.reading / self.scale
        basis = self._orthonormal_columns.reshape(*target.shape, -1)
        regressors, measured = basis[in_run], target[in_run]
        squares = cumulative_sums(np.einsum("bpi,bpj->bij", regressors, regressors))
        products = cumulative_sums(np.einsum("bpi,bp->bi", regressors, measured))
        information = np.eye(basis.shape[2]) - (squares[last] - squares[first])
        right = np.einsum("bpi,bp->i", basis, target) - (products[last] - products[first])
        try:
            diagonals = np.linalg.cholesky(information).diagonal(axis1=1, axis2=2)
            determined = diagonals.min(initial=1.0) ** 2 > LEAST_SHARE_OUTSIDE
        except np.linalg.LinAlgError:
            determined = False
        if determined:
            coordinates = np.linalg.solve(information, right[:, :, None])[:, :, 0]
            return np.asarray(measured - np.einsum("bpi,wi->wbp", regressors, coordinates, optimize=True))
        windows = zip((in_run[0] + first).tolist(), (in_run[0] + last).tolist(), strict=True)
        fits = [self.residual_without(inside([window], len(self.owner)))[in_run] for window in windows]
        return np.array(fits) / self.scale[in_run]

    @cached_property
    def _orthonormal_columns(self) -> Array:
        """Of the weighted regressor, (b p, r), r its rank."""
        rows = (self.regressor / self.scale[:, :, None]).reshape(-1, self.regressor.shape[2])
        length = np.linalg.norm(rows, axis=0)
        left, values, _ = np.linalg.svd(rows / np.where(length > 0, length, 1.0), full_matrices=False)
        return np.asarray(left[:, values > SMALLEST_SINGULAR_VALUE * values[0]])

    def constant_wrench(self, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
        """A constant wrench (p,) in a window, estimated together with the tip, and the inflation of its std (p,).

        The inflation is 1 where the tip is not collinear with such a wrench, and grows without limit as it becomes so.
        """
        wrench, _, inflation = self._beside_tip(inside[:, None, None] * np.eye(self.reading.shape[1]))
        return wrench, inflation

    def weight_change(self, inside: NDArray[np.bool_], mass: int) -> tuple[float, float]:
        """How far another mass in a window moves the readings, estimated together with the tip, and its inflation.

        In `scale`, the root mean square over the window's blocks. `mass` is the place of the tip's among the unknowns.
        """
        change, length, inflation = self._beside_tip(inside[:, None, None] * self.regressor[:, :, [mass]])
        return float(np.abs(change[0]) * length[0] / np.sqrt(inside.sum())), float(inflation[0])

    def _beside_tip(self, columns: Array) -> tuple[Array, Array, Array]:
        """Amounts (j,) of columns (b, p, j) estimated together with the tip, lengths in `scale`, and inflations."""
        count = columns.shape[2]
        rows = np.concatenate([self.regressor, columns], axis=2) / self.scale[:, :, None]
        orthonormal, root = np.linalg.qr(rows.reshape(self.reading.size, -1))
        scaled_svd = ScaledSVD.of(root)
        amounts = scaled_svd.inverse @ (orthonormal.T @ (self.reading / self.scale).ravel())
        inflation = scaled_svd.scale * np.sqrt(np.diag(scaled_svd.covariance))
        return amounts[-count:], np.linalg.norm(root[:, -count:], axis=0), inflation[-count:]


def find_events_in_single_runs(
    model: WrenchModel, recordings: Sequence[Recording]
) -> tuple[tuple[tuple[float, float], ...], ...]:
    """At most one interval (s) per single run that a constant wrench, or another mass, explains, and the tip cannot.

    The window is the one without which the tip fits the other blocks best. It is an event when a constant wrench in
    it, or a change of the mass, estimated together with the tip, is significant: Student's t with the larger of the std
    of the residual outside, with as many degrees of freedom as there are independent blocks there (by their lag-one
    correlation), and of its raw samples about their block; Bonferroni-corrected for channels, mass and windows. Repeats
    detect far smaller events. A logged temperature may shift each channel.
    """
    single = [r.repeats == 1 and not r.at_rest and r.samples >= 10 * BLOCKS_PER_RUN for r in recordings]
    if not any(single):
        return ((),) * len(recordings)
    runs, mass = _runs(model.base, recordings), [p.name for p in model.base.parameters].index("m")
    averages = _block_averages(runs)
    events: list[tuple[tuple[float, float], ...]] = []
    for number, recording in enumerate(recordings):
        window = _event_window(averages, number, runs[number], mass) if single[number] else None
        if window is None:
            events.append(())
            continue
        rows, dt = np.concatenate(runs[number].blocks[window[0] : window[1]]), recording.dt or 0.0
        events.append(((float(rows[0]) * dt, float(rows[-1] + 1) * dt),))
    return tuple(events)


@dataclass(frozen=True, eq=False)
class _Run:
    """Readings (n, p) of a recording, regressor (n, p, k) in the unknowns of all, and the samples of each block."""

    reading: Array
    regressor: Array
    blocks: Sequence[NDArray[np.intp]]


def _runs(model: WrenchModel, recordings: Sequence[Recording]) -> list[_Run]:
    """Each recording, its unknowns the model's and the shift of each channel with its temperature."""
    unknowns, runs = parameter_layout(model, recordings), []
    warm = ["temperature" in recording.auxiliary for recording in recordings]
    size = unknowns.size + sum(w * len(r.channels) for r, w in zip(recordings, warm, strict=True))
    place = unknowns.size
    for number, recording in enumerate(recordings):
        channels = np.arange(len(recording.channels))
        response = model_response(unknowns.models[number], recording, np.zeros(len(unknowns.models[number].parameters)))
        regressor = np.zeros((recording.samples, len(channels), size))
        regressor[:, :, unknowns.index[number]] = response.derivative
        if warm[number]:
            temperature = recording.signals["temperature"]
            regressor[:, channels, place + channels] = (temperature - temperature.mean())[:, None]
            place += len(channels)
        count = recording.samples if recording.at_rest else min(BLOCKS_PER_RUN, recording.samples)
        runs.append(_Run(recording.wrench, regressor, np.array_split(np.arange(recording.samples), count)))
    return runs


def _block_averages(runs: Sequence[_Run]) -> BlockAverages:
    readings = [run.reading[rows].mean(axis=0) for run in runs for rows in run.blocks]
    regressors = [run.regressor[rows].mean(axis=0) for run in runs for rows in run.blocks]
    owner = np.repeat(np.arange(len(runs)), [len(run.blocks) for run in runs])
    return BlockAverages(np.array(readings), np.array(regressors), owner)


def _event_window(averages: BlockAverages, number: int, run: _Run, mass: int) -> Window | None:
    in_run = np.flatnonzero(averages.owner == number)
    coarse = Windows.of_lengths(np.arange(COARSE_STEP, BLOCKS_PER_RUN + 1, COARSE_STEP), BLOCKS_PER_RUN, COARSE_STEP)
    best = coarse.best(_log_likelihoods(averages, number, coarse))
    near = Windows.near(best, BLOCKS_PER_RUN, step=1, reach=COARSE_STEP - 1, shortest=2)
    first, last = near.best(_log_likelihoods(averages, number, near))
    event = inside([(in_run[0] + first, in_run[0] + last)], len(averages.owner))
    outside = averages.residual_without(event)[in_run][~event[in_run]]
    raw = run.reading - run.regressor @ averages.estimate_without(event)
    kept = [rows for rows, left_out in zip(run.blocks, event[in_run], strict=True) if not left_out]
    raw_spread = np.median([raw[rows].std(axis=0) for rows in kept], axis=0)
    tried = len(coarse) + (2 * COARSE_STEP - 1) ** 2
    of_blocks, of_samples = _limits(outside, tried)
    wrench, inflation = averages.constant_wrench(event)
    change, of_change = averages.weight_change(event, mass)
    spread = of_blocks * np.sqrt((outside**2).mean(axis=0))
    pushed = np.any(np.abs(wrench) > inflation * np.maximum(spread, of_samples * raw_spread))
    loaded = change > of_change * np.max(np.maximum(spread, raw_spread) / averages.scale[in_run[0]])
    return (first, last) if pushed or loaded else None


def _log_likelihoods(averages: BlockAverages, number: int, windows: Windows) -> Array:
    """Log likelihood (w,) of the fit to the blocks outside each window, each block inside with a wrench of its own.

    Inside the window its likelihood counts as that of the whole run's residual.
    """
    judged = Windows(np.append(windows.first, 0), np.append(windows.last, 0))  # the last one leaves no block out
    inside_count = judged.last - judged.first
    fitted = np.flatnonzero(BLOCKS_PER_RUN - inside_count >= BLOCKS_PER_RUN // 5)
    first, last, inside_count = judged.first[fitted], judged.last[fitted], inside_count[fitted]
    power = averages.scaled_residuals_without(number, first, last) ** 2
    block = np.arange(BLOCKS_PER_RUN)
    outside = (block < first[:, None]) | (block >= last[:, None])
    outside_count = BLOCKS_PER_RUN - inside_count
    mean = np.einsum("wbp,wb->wp", power, outside) / outside_count[:, None]
    surprise = np.log(mean + 1e-12).sum(axis=1)
    log_likelihoods = np.full(len(judged), -np.inf)
    log_likelihoods[fitted] = -outside_count * surprise - inside_count * surprise[-1]
    return log_likelihoods[:-1]


def _limits(outside: Array, windows: int) -> tuple[Array, float]:
    """Student's t that a wrench in a window reaches by chance: of the residual outside (b, p), and of raw samples.

    The latter have as many degrees of freedom as blocks, whatever else is slow in the run.
    """
    power = np.maximum((outside**2).mean(axis=0), 1e-300)
    correlation = np.clip((outside[1:] * outside[:-1]).mean(axis=0) / power, 0.0, 0.99)
    freedom = np.maximum(2.0, len(outside) * (1 - correlation) / (1 + correlation))
    level = LEVELS.transient / 2 / ((len(power) + 1) * windows)
    return student_isf(level, freedom), float(student_isf(level, np.array([float(len(outside))]))[0])
