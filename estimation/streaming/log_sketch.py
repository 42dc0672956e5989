"""Sketch of a log that is longer than memory: every so many rows of it, from which its frames and its fit are judged.

A stream of chunks gives parameters and nothing else. Which sign the readings have, which way gravity points, whether
axes and units are read as meant, and whether the model fits, is asked of the sketch, an ordinary recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.confidence_intervals import SMALLEST_SIZE, upper_noise
from estimation.least_squares.problem import Solution
from estimation.reading.recording_check import checked
from estimation.recordings.column_table import ColumnTable, table_file
from estimation.recordings.differentiation import Derivatives, TrueSamples
from estimation.recordings.motion import MotionColumns
from estimation.recordings.reading import recording_from_table
from estimation.recordings.recording import Recording
from estimation.streaming.chunk_information import linear_regressor_map
from estimation.streaming.long_log import LoggedMotion, LongLog
from estimation.streaming.streamed_fit import MOST_BLOCKS, StreamedFit, fit_streamed
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.noise import NoiseModel

Array = NDArray[np.float64]

SKETCHED_ROWS = 20_000
"""Rows of a sketch: the fit of so many takes a second, and seven per mille of the std of noise are seen in them."""
SMALLEST_CHUNK = 4096
"""Rows: a few seconds of a fast log, so that what scatters from chunk to chunk is not one swing of a slow residual."""


@dataclass(frozen=True, eq=False)
class ColumnsAsRecorded(MotionColumns):
    """Columns with their derivatives among them, which a sketch is too coarse to derive: nothing is smoothed."""

    def _differentiated(self, series: Array, names: Sequence[str], antiperiodic: bool) -> Derivatives:
        zero = np.zeros_like(series)
        return Derivatives(value=series, first=zero, second=zero, score=np.zeros(series.shape[1]))

    def true_samples(self, names: Sequence[str]) -> TrueSamples | None:
        """None: every row is taken as it was recorded."""
        return None


def sketch(log: LongLog, inputs: Sequence[str] = ()) -> Recording:
    """A recording of evenly spaced rows of a log with the columns that it needs, and those of further `inputs`.

    Their distance is a prime number of rows, or else a motion that repeats would show the same few poses. Raises
    InputError as iteration over the log does, and for whatever cannot be a recording.
    """
    file = table_file(log.path)
    motion = LoggedMotion.of(file.names, str(log.path), log.rig)
    columns = [name for name in file.names if name in motion.needed or name in inputs]
    step = _prime_from(file.rows() // SKETCHED_ROWS)
    held, row = [], 0
    for table in file.stretches(log.size, columns):
        held.append({name: column[-row % step :: step].copy() for name, column in table.columns.items()})
        row += len(table)
    if not row:
        raise InputError(what="there are no samples", where=str(log.path), remedy="give a recording with rows")
    kept = {name: np.concatenate([part[name] for part in held]) for name in columns}
    stamps = kept["time"]
    kept["time"] = np.linspace(stamps[0], stamps[-1], len(stamps))  # of a log with gaps, too: nothing is differentiated
    table = ColumnTable(columns=kept, where=str(log.path), first_row=1)
    name = log.path.name if step == 1 else f"{log.path.name} (1 row of {step})"
    recording = recording_from_table(table, name=name, rig=log.rig)
    recorded = recording.motion.recorded
    recorded = ColumnsAsRecorded(recorded.columns, recorded.time, recorded.repeats, recorded.continuous)
    return checked(replace(recording, motion=replace(recording.motion, recorded=recorded)))


def _prime_from(number: int) -> int:
    """The first prime number from there on; 1 for less than 2."""
    candidate = max(number, 1)
    while candidate > 1 and any(candidate % divisor == 0 for divisor in range(2, int(candidate**0.5) + 1)):
        candidate += 1
    return candidate


def stated_noise(log: LongLog, model: WrenchModel) -> NoiseModel | None:
    """White noise of the std that the log's rig states of every channel; None where it does not."""
    stated = {} if log.rig is None else log.rig.sensor.noise or {}
    return NoiseModel.of_rig(log.rig, model.channels) if stated.keys() >= set(model.channels) else None


def noise_of_residual(log: LongLog, sketched: Solution) -> NoiseModel:
    """White noise as strong as the upper half of the residual's spectrum, as weighs a single run, from one pass.

    A sketch has no such frequencies: what is slow in the log is folded over all of its spectrum. Of a model that is not
    linear in its parameters it is the noise of the sketch all the same.
    """
    emitted = linear_regressor_map(sketched.model)
    if emitted is None:
        return NoiseModel.white(sketched.noise[0].floor)
    power, rows = np.zeros(len(sketched.model.channels)), 0
    for chunk in log.with_signals(emitted.inputs):
        samples = len(chunk.wrench)
        regressor = emitted(chunk.signals, samples)
        residual = chunk.wrench - (np.tensordot(sketched.theta, regressor[:-1], 1) + regressor[-1]).T
        power, rows = power + samples * upper_noise(residual) ** 2, rows + samples
    return NoiseModel.white(np.maximum(np.sqrt(power / rows), SMALLEST_SIZE))


def fit_log(log: LongLog, sketched: Solution, least: Array) -> StreamedFit:
    """The model of a sketch's solution on all rows of its log, chunk by chunk, by the estimator of `fit`.

    Channels are weighted by the std that the rig states, else by the noise of the residual. No std is below `least`
    (k,), nor below what the chunks' own scatter shows (`in_scatter_of_blocks`): what the model lacks may push every
    chunk alike. InputError as `fit_streamed`.
    """
    (recording,), model = sketched.recordings, sketched.model
    chunks = replace(log, rig=recording.rig, size=min(max(log.rows // MOST_BLOCKS, SMALLEST_CHUNK), log.size))
    noise = stated_noise(log, model) or noise_of_residual(chunks, sketched)
    start = dict(zip((p.name for p in sketched.unknowns), sketched.theta, strict=True))
    return fit_streamed(model, chunks, noise, start=start).in_scatter_of_blocks(least)
