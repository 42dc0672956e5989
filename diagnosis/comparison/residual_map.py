"""Residual maps: mean residual in cells of one variable, with confidence intervals and false discovery rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison, gravity_direction
from estimation.multiplicity import false_discovery_rates, student_isf, student_sf
from estimation.recordings.recording import Recording
from modeling.errors import InputError, quoted, suggestion
from modeling.significance import LEVELS

Array = NDArray[np.float64]

CELLS = 16
"""Of the range of a variable: enough to show a place, few enough to be visited in several repeats."""
OUTERMOST = 0.01
"""Of the samples at either end of a variable's range, which are in the first or the last cell: they are too few."""
AUXILIARY = 0.9
"""Factor on what an auxiliary column explains: one that repeats the motion, such as a logged velocity, explains as much
as the motion to a few hundredths, more or less by chance, and is no name for it."""
MIN_RANGE = 1e-3
"""Range, in its own unit, below which a variable counts as constant."""
MAX_BLOCKS = 8
"""Blocks of a single run that take the place of repeats."""


@dataclass(frozen=True, eq=False)
class ResidualMap:
    """Mean residual of one channel in cells of one variable.

    centre, mean, low, high  (cells,) with a 95 % confidence interval over repeats (over blocks of a single run)
    significant              cells of non-zero mean at a false discovery rate of 10 %, within this map
    tolerance                mean below which a cell is negligible
    explained                share of the channel's residual power that the cells' means explain
    """

    channel: str
    channel_unit: str
    variable: str
    variable_unit: str
    centre: Array
    mean: Array
    low: Array
    high: Array
    significant: NDArray[np.bool_]
    tolerance: float
    explained: float

    @property
    def practically_significant(self) -> NDArray[np.bool_]:
        """Cells whose mean residual is significant and above tolerance."""
        return self.significant & (np.abs(self.mean) > self.tolerance)


def map_variables(recording: Recording, load: Array) -> Mapping[str, tuple[Array, str]]:
    """Variables (n,) and their units by name: direction, position, speed, acceleration, load, time, auxiliaries."""
    signals = recording.motion.model_signals
    variables: dict[str, tuple[Array, str]] = {}
    if recording.dimension == 2:
        variables["phi"] = (signals["phi"], "rad")
        variables["turning speed"] = (signals["dphi"], "rad/s")
        variables["turning acceleration"] = (signals["ddphi"], "rad/s²")
        velocity = [signals[n] for n in ("vx", "vy") if n in signals]
        direction = {"x": "vx", "y": "vy"}
    else:
        down = gravity_direction(signals)
        variables |= {f"gravity along {a}": (np.asarray(d), "g") for a, d in zip("xyz", down, strict=True)}
        variables["turning speed"] = (_length([signals[f"w{a}"] for a in "xyz"]), "rad/s")
        variables["turning acceleration"] = (_length([signals[f"al{a}"] for a in "xyz"]), "rad/s²")
        velocity = [signals[n] for n in ("vpx", "vpy", "vpz") if n in signals]
        direction = {a: f"vp{a}" for a in "xyz"}
    for axis in "xyz":
        if f"p{axis}" in signals:
            variables[f"position {axis}"] = (signals[f"p{axis}"], "m")
    variables |= {f"velocity {a}": (signals[name], "m/s") for a, name in direction.items() if name in signals}
    if velocity:
        variables["speed"] = (_length(velocity), "m/s")
    for channel, series in zip(recording.channels, load.T, strict=True):
        variables[f"load {channel}"] = (np.asarray(series, dtype=np.float64), "N" if channel.startswith("f") else "N m")
    if recording.time is not None:
        span = np.arange(recording.samples, dtype=np.float64) * (recording.dt or 1.0)
        variables["time"] = (span, "s")
    else:
        variables["order"] = (signals["order"], "1")
    variables |= {
        name: (signals[name], "°C" if name == "temperature" else "as recorded") for name in recording.auxiliary
    }
    return {name: pair for name, pair in variables.items() if np.ptp(pair[0]) > MIN_RANGE}


def _length(components: Sequence[Array]) -> Array:
    return np.asarray(np.sqrt(np.sum(np.square(components), axis=0)))


def residual_maps(comparison: Comparison, tolerance: Mapping[str, float]) -> list[ResidualMap]:
    """Residual maps of every channel over every variable, by share of residual power explained, the largest first.

    A column of the log that is no part of the motion comes before a variable of the motion only where it explains more
    by a tenth (`AUXILIARY`).

    Variables with no cell visited in two repeats give no map.
    """
    recording, residual = comparison.recording, comparison.residual
    load = recording.wrench - residual
    repeat_of = _repeat_of_samples(recording)
    maps = []
    for variable, (series, unit) in map_variables(recording, load).items():
        cells = _cells(series)
        for number, (channel, channel_unit) in enumerate(zip(recording.channels, comparison.space.units, strict=True)):
            names = (channel, channel_unit, variable, unit)
            statistics = CellStatistics.of(residual[:, number], series, cells, repeat_of)
            if len(statistics.mean):
                maps.append(
                    _residual_map(statistics, names, tolerance[channel], float((residual[:, number] ** 2).sum()))
                )
    return sorted(maps, key=lambda m: -m.explained * (AUXILIARY if m.variable in recording.auxiliary else 1.0))


def samples_of_cell(comparison: Comparison, variable: str, centre: float) -> NDArray[np.bool_]:
    """Which samples (n,) are in the cell of a residual map with this centre (or the one nearest to it).

    Raises InputError for a variable that the recording has not.
    """
    recording = comparison.recording
    variables = map_variables(recording, recording.wrench - comparison.residual)
    if variable not in variables:
        remedy = suggestion(variable, variables)
        raise InputError(what=f"no variable is {quoted(variable)}", where=recording.name, remedy=remedy)
    series = variables[variable][0]
    cells = _cells(series)
    numbers = np.unique(cells)
    centres = np.array([series[cells == number].mean() for number in numbers])
    return np.asarray(cells == numbers[np.abs(centres - centre).argmin()])


def _repeat_of_samples(recording: Recording) -> NDArray[np.intp]:
    """The repeat, or block of a single run, of each sample."""
    count = recording.repeats if recording.repeats > 1 else min(MAX_BLOCKS, max(2, recording.samples // 3))
    return (np.arange(recording.samples) * count // recording.samples).astype(np.intp)


def _cells(series: Array) -> NDArray[np.intp]:
    """Cell of each sample: equal widths between two quantiles."""
    low, high = np.quantile(series, [OUTERMOST, 1 - OUTERMOST])
    count = int(min(CELLS, max(2, len(series) // 3)))
    return np.asarray(np.clip((series - low) / max(high - low, 1e-300) * count, 0, count - 1), dtype=np.intp)


@dataclass(frozen=True, eq=False)
class CellStatistics:
    """Statistics (c,) of a residual in the cells that are visited in at least two repeats.

    centre   mean of the variable in the cell
    mean     of the means over the repeats, with its standard `error`
    repeats  that visit the cell, and all their `samples`
    """

    centre: Array
    mean: Array
    error: Array
    repeats: Array
    samples: Array

    @classmethod
    def of(cls, residual: Array, series: Array, cells: NDArray[np.intp], repeat_of: NDArray[np.intp]) -> CellStatistics:
        """Of a residual and a variable (n,), whose samples are in these cells and repeats (n,)."""
        shape = (int(cells.max()) + 1, int(repeat_of.max()) + 1)
        place, size = cells * shape[1] + repeat_of, shape[0] * shape[1]
        samples = np.bincount(place, minlength=size).reshape(shape)
        visited = samples > 0
        repeats = visited.sum(axis=1)
        means = np.bincount(place, residual, size).reshape(shape) / np.maximum(samples, 1)
        mean = means.sum(axis=1) / np.maximum(repeats, 1)
        squares = (np.where(visited, means - mean[:, None], 0.0) ** 2).sum(axis=1)
        error = np.sqrt(squares / np.maximum((repeats - 1) * repeats, 1))
        total = samples.sum(axis=1)
        centre = np.bincount(cells, series) / np.maximum(total, 1)
        kept = repeats >= 2
        return cls(centre[kept], mean[kept], error[kept], repeats[kept], total[kept])


def _residual_map(
    cells: CellStatistics, names: tuple[str, str, str, str], tolerance: float, power: float
) -> ResidualMap:
    mean, error, degrees_of_freedom = cells.mean, cells.error, cells.repeats - 1
    half_width = student_isf(0.5 - LEVELS.confidence / 2, degrees_of_freedom) * error
    statistic = np.abs(mean) / np.maximum(error, 1e-300)
    rates = false_discovery_rates(np.clip(2 * student_sf(statistic, degrees_of_freedom), 0, 1))
    noise = np.minimum(error**2, mean**2)
    explained = float((cells.samples * (mean**2 - noise)).sum() / max(power, 1e-300))
    channel, channel_unit, variable, unit = names
    return ResidualMap(
        channel=channel,
        channel_unit=channel_unit,
        variable=variable,
        variable_unit=unit,
        centre=cells.centre,
        mean=mean,
        low=mean - half_width,
        high=mean + half_width,
        significant=rates < LEVELS.residual_cells,
        tolerance=tolerance,
        explained=explained,
    )
