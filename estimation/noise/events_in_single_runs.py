"""Transient events in a single run: one interval with a constant wrench that the rigid tip cannot explain.

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
from estimation.parameter_layout import ParameterLayout, parameter_layout
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

    reading (b, p), regressor (b, p, k) in the unknowns of the layout, owner (b,) the recording of each block
    raw_spread (recordings, p): median over blocks of the raw samples' std about their block
    """

    unknowns: ParameterLayout
    reading: Array
    regressor: Array
    owner: NDArray[np.intp]
    raw_spread: Array

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
        used = ~left_out
        rows = (self.regressor / self.scale[:, :, None])[used].reshape(-1, self.unknowns.size)
        target = (self.reading / self.scale)[used].ravel()
        length = np.linalg.norm(rows, axis=0)
        length[length == 0] = 1.0
        solution = np.linalg.lstsq(rows / length, target, rcond=SMALLEST_SINGULAR_VALUE)[0] / length
        return np.asarray(self.reading - self.regressor @ solution)

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
        rows = (self.regressor / self.scale[:, :, None]).reshape(-1, self.unknowns.size)
        length = np.linalg.norm(rows, axis=0)
        left, values, _ = np.linalg.svd(rows / np.where(length > 0, length, 1.0), full_matrices=False)
        return np.asarray(left[:, values > SMALLEST_SINGULAR_VALUE * values[0]])

    def constant_wrench(self, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
        """A constant wrench (p,) in a window, estimated together with the tip, and the inflation of its std (p,).

        The inflation is 1 where the tip is not collinear with such a wrench, and grows without limit as it becomes so.
        """
        p = self.reading.shape[1]
        constant = inside[:, None, None] * np.eye(p)
        rows = (np.concatenate([self.regressor, constant], axis=2) / self.scale[:, :, None]).reshape(
            len(inside) * p, -1
        )
        orthonormal, root = np.linalg.qr(rows)
        scaled_svd = ScaledSVD.of(root)
        wrench = scaled_svd.inverse @ (orthonormal.T @ (self.reading / self.scale).ravel())
        inflation = scaled_svd.scale * np.sqrt(np.diag(scaled_svd.covariance))
        return wrench[-p:], inflation[-p:]


def find_events_in_single_runs(
    model: WrenchModel, recordings: Sequence[Recording]
) -> tuple[tuple[tuple[float, float], ...], ...]:
    """At most one interval (s) per single run in which a constant wrench explains what the rigid tip cannot.

    The window is the one without which the tip fits the other blocks best. It is an event when a constant wrench in
    it, estimated together with the tip, is significant: Student's t with the larger of the std of the residual outside
    and of the raw samples about their block, with as many degrees of freedom as there are independent blocks outside
    (by their lag-one correlation), Bonferroni-corrected for channels and windows. Repeats detect far smaller events.
    """
    single = [r.repeats == 1 and not r.at_rest and r.samples >= 10 * BLOCKS_PER_RUN for r in recordings]
    if not any(single):
        return ((),) * len(recordings)
    averages = _block_averages(model.base, recordings)
    events: list[tuple[tuple[float, float], ...]] = []
    for number, recording in enumerate(recordings):
        window = _event_window(averages, number) if single[number] else None
        step = recording.samples / BLOCKS_PER_RUN * (recording.dt or 0.0)
        events.append(() if window is None else ((window[0] * step, window[1] * step),))
    return tuple(events)


def _block_averages(model: WrenchModel, recordings: Sequence[Recording]) -> BlockAverages:
    unknowns = parameter_layout(model, recordings)
    readings, regressors, owners, spreads = [], [], [], []
    for number, recording in enumerate(recordings):
        response = model_response(unknowns.models[number], recording, np.zeros(len(unknowns.models[number].parameters)))
        whole = np.zeros((recording.samples, len(recording.channels), unknowns.size))
        whole[:, :, unknowns.index[number]] = response.derivative
        count = recording.samples if recording.at_rest else min(BLOCKS_PER_RUN, recording.samples)
        parts = np.array_split(np.arange(recording.samples), count)
        readings += [recording.wrench[rows].mean(axis=0) for rows in parts]
        regressors += [whole[rows].mean(axis=0) for rows in parts]
        owners += [number] * count
        spreads.append(np.median([recording.wrench[rows].std(axis=0) for rows in parts], axis=0))
    owner = np.array(owners, dtype=np.intp)
    return BlockAverages(unknowns, np.array(readings), np.array(regressors), owner, np.array(spreads))


def _event_window(averages: BlockAverages, number: int) -> Window | None:
    in_run = np.flatnonzero(averages.owner == number)
    coarse = Windows.of_lengths(np.arange(COARSE_STEP, BLOCKS_PER_RUN + 1, COARSE_STEP), BLOCKS_PER_RUN, COARSE_STEP)
    best = coarse.best(_log_likelihoods(averages, number, coarse))
    near = Windows.near(best, BLOCKS_PER_RUN, step=1, reach=COARSE_STEP - 1, shortest=2)
    first, last = near.best(_log_likelihoods(averages, number, near))
    event = inside([(in_run[0] + first, in_run[0] + last)], len(averages.owner))
    outside = averages.residual_without(event)[in_run][~event[in_run]]
    wrench, inflation = averages.constant_wrench(event)
    tried = len(coarse) + (2 * COARSE_STEP - 1) ** 2
    raw_spread = averages.raw_spread[number]
    return (first, last) if _is_significant(wrench, inflation, outside, raw_spread, tried) else None


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


def _is_significant(wrench: Array, inflation: Array, outside: Array, raw_spread: Array, windows: int) -> bool:
    """Whether a constant wrench exceeds Student's t limit for the residual outside the window and for the raw noise."""
    spread = np.sqrt((outside**2).mean(axis=0))
    correlation = np.clip((outside[1:] * outside[:-1]).mean(axis=0) / np.maximum(spread**2, 1e-300), 0.0, 0.99)
    freedom = np.maximum(2.0, len(outside) * (1 - correlation) / (1 + correlation))
    limit = student_isf(LEVELS.transient / 2 / (len(wrench) * windows), freedom)
    return bool(np.any(np.abs(wrench) > limit * inflation * np.maximum(spread, raw_spread)))
