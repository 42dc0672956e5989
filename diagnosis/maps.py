"""Maps of the residual: each channel against what might cause it, cell by cell, with an interval over repeats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import Comparison
from diagnosis.generic import gravity_direction
from estimation.distributions import student_isf, student_sf
from estimation.recording import Recording
from estimation.response import signals_of

Array = NDArray[np.float64]

CELLS = 16
DISCOVERY_RATE = 0.10
SMALLEST_RANGE = 1e-3
"""A variable that moves less, in its own unit, is taken as constant."""
BLOCKS = 8
"""Stretches of a single run that stand in for its repeats."""


@dataclass(frozen=True, eq=False)
class ResidualMap:
    """Mean residual of one channel in cells of one variable.

    centre, mean, low, high  (cells,) with a 95 % interval over repeats (over stretches of a single run)
    significant              cells whose mean is not zero at a false discovery rate of 10 %, within this map
    tolerance                below it a cell is of no interest
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
    def striking(self) -> NDArray[np.bool_]:
        """Cells that are significant and above tolerance."""
        return self.significant & (np.abs(self.mean) > self.tolerance)


def map_variables(recording: Recording, load: Array) -> Mapping[str, tuple[Array, str]]:
    """Named variables (n,) and their units: direction, position, speed, acceleration, load, time, auxiliaries."""
    signals = signals_of(recording)
    found: dict[str, tuple[Array, str]] = {}
    if recording.dimension == 2:
        found["phi"] = (signals["phi"], "rad")
        found["turning speed"] = (signals["dphi"], "rad/s")
        found["turning acceleration"] = (signals["ddphi"], "rad/s²")
        velocity = [signals[n] for n in ("vx", "vy") if n in signals]
        direction = {"x": "vx", "y": "vy"}
    else:
        down = gravity_direction(signals)
        found |= {f"gravity along {a}": (np.asarray(d), "g") for a, d in zip("xyz", down, strict=True)}
        found["turning speed"] = (_length([signals[f"w{a}"] for a in "xyz"]), "rad/s")
        found["turning acceleration"] = (_length([signals[f"al{a}"] for a in "xyz"]), "rad/s²")
        velocity = [signals[n] for n in ("vpx", "vpy", "vpz") if n in signals]
        direction = {a: f"vp{a}" for a in "xyz"}
    for axis in "xyz":
        if f"p{axis}" in signals:
            found[f"position {axis}"] = (signals[f"p{axis}"], "m")
    found |= {f"velocity {a}": (signals[name], "m/s") for a, name in direction.items() if name in signals}
    if velocity:
        found["speed"] = (_length(velocity), "m/s")
    for channel, series in zip(recording.channels, load.T, strict=True):
        found[f"load {channel}"] = (np.asarray(series, dtype=np.float64), "N" if channel.startswith("f") else "N m")
    if recording.time is not None:
        span = np.arange(recording.samples, dtype=np.float64) * (recording.dt or 1.0)
        found["time"] = (span, "s")
    else:
        found["order"] = (signals["order"], "1")
    found |= {name: (signals[name], "°C" if name == "temperature" else "as recorded") for name in recording.auxiliary}
    return {name: pair for name, pair in found.items() if np.ptp(pair[0]) > SMALLEST_RANGE}


def _length(components: Sequence[Array]) -> Array:
    return np.asarray(np.sqrt(np.sum(np.square(components), axis=0)))


def residual_maps(comparison: Comparison, tolerance: Mapping[str, float]) -> list[ResidualMap]:
    """Every channel against every variable, the most explained share of the residual's power first.

    Variables whose cells have no repeats to compare give no map.
    """
    recording, residual = comparison.recording, comparison.residual
    load = recording.wrench - residual
    groups = _groups(recording)
    maps = []
    for variable, (series, unit) in map_variables(recording, load).items():
        cells = _cells(series)
        for number, (channel, channel_unit) in enumerate(zip(recording.channels, comparison.space.units, strict=True)):
            names = (channel, channel_unit, variable, unit)
            rows = _cell_rows(residual[:, number], series, cells, groups)
            if rows:
                maps.append(_mapped(rows, names, tolerance[channel], float((residual[:, number] ** 2).sum())))
    return sorted(maps, key=lambda m: -m.explained)


def _groups(recording: Recording) -> NDArray[np.intp]:
    """The repeat, or stretch of a single run, that each sample belongs to."""
    count = recording.repeats if recording.repeats > 1 else min(BLOCKS, max(2, recording.samples // 3))
    return (np.arange(recording.samples) * count // recording.samples).astype(np.intp)


def _cells(series: Array) -> NDArray[np.intp]:
    """The cell of each sample: equal widths between the 1 % and 99 % quantiles."""
    low, high = np.quantile(series, [0.01, 0.99])
    count = int(min(CELLS, max(2, len(series) // 3)))
    return np.asarray(np.clip((series - low) / max(high - low, 1e-300) * count, 0, count - 1), dtype=np.intp)


Row = tuple[float, float, float, int, int]


def _cell_rows(residual: Array, series: Array, cells: NDArray[np.intp], groups: NDArray[np.intp]) -> list[Row]:
    """Per cell seen in at least two repeats: its centre, mean, standard error, number of repeats and of samples."""
    rows = []
    for cell in np.unique(cells):
        inside = cells == cell
        means = np.array([residual[inside & (groups == g)].mean() for g in np.unique(groups[inside])])
        if len(means) >= 2:
            error = float(means.std(ddof=1) / np.sqrt(len(means)))
            rows.append((float(series[inside].mean()), float(means.mean()), error, len(means), int(inside.sum())))
    return rows


def adjusted(p_values: Array) -> Array:
    """P-values (n,) adjusted for their false discovery rate (Benjamini and Hochberg, J. R. Stat. Soc. B 57, 1995).

    As `scipy.stats.false_discovery_control` gives them, which takes longer to load than all maps to draw.
    """
    order = np.argsort(p_values)[::-1]
    scaled = p_values[order] * len(order) / np.arange(len(order), 0, -1)
    rates = np.empty_like(p_values)
    rates[order] = np.minimum(np.minimum.accumulate(scaled), 1.0)
    return rates


def _mapped(rows: list[Row], names: tuple[str, str, str, str], tolerance: float, power: float) -> ResidualMap:
    centre, mean, error, count, weight = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    freedom = count - 1
    half = student_isf(0.025, freedom) * error
    statistic = np.abs(mean) / np.maximum(error, 1e-300)
    rates = adjusted(np.clip(2 * student_sf(statistic, freedom), 0, 1))
    noise = np.minimum(error**2, mean**2)
    explained = float((weight * (mean**2 - noise)).sum() / max(power, 1e-300))
    channel, channel_unit, variable, unit = names
    return ResidualMap(
        channel=channel,
        channel_unit=channel_unit,
        variable=variable,
        variable_unit=unit,
        centre=centre,
        mean=mean,
        low=mean - half,
        high=mean + half,
        significant=rates < DISCOVERY_RATE,
        tolerance=tolerance,
        explained=explained,
    )
