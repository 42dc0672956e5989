"""A line of a chart thinned to what a screen can show: the smallest and the largest sample of each column of pixels."""

from __future__ import annotations

import numpy as np

from estimation.recordings.reports.decimation import extremes, min_max_decimated
from truewrench.plots.charts.chart import Array, Line


def decimated(line: Line, columns: int, *, log: bool) -> tuple[Array, Array]:
    """x and y of the line with at most two points in each of so many columns; of a logarithmic axis equal in log x."""
    if len(line.x) <= 2 * columns:
        return line.x, line.y
    if not log:
        return min_max_decimated(line.x, line.y, columns)
    place = np.floor(columns * np.log(line.x / line.x[0]) / np.log(line.x[-1] / line.x[0]))
    return extremes(line.x, line.y, np.append(np.unique(place, return_index=True)[1], len(place)))
