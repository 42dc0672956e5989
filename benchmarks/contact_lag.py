"""Noise of the contact wrench against the lag: `python -m benchmarks.contact_lag MODEL.json RUN.csv [LAG ..]`.

Of a run without contact: RMS of the forces as `compensate --lag` leaves them, with the inertial unit's accelerations
and without, beside a moving average and an exponential average (the stationary Kalman filter of a contact that walks
randomly) whose group delay is the lag. A step is through, from a tenth to nine tenths, in 1.6 lags of a moving average,
2.2 of an exponential one; the last column is of ours.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import truewrench as tw
from estimation.contact.contact_wrench import CalibratedModel, ContactWrench, compensate
from estimation.contact.smoothed_contact import INERTIAL
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from truewrench.files.model_file import ModelFile

Array = NDArray[np.float64]
LAGS = (0.003, 0.005, 0.01, 0.02, 0.05)


STEP = 50.0
"""N: a contact that is added to the readings, far above every noise."""


def averages(wrench: Array, half: int) -> dict[str, Array]:
    """Wrenches (n, 3) by a moving average over 2 half + 1 samples and an exponential one, half samples late."""
    count = 2 * half + 1
    share = 1 / (1 + half)  # group delay (1 - share) / share at low frequency
    return {
        "moving average": lfilter(np.full(count, 1 / count), [1.0], wrench, axis=0)[count:],
        "exponential": lfilter([share], [1.0, share - 1.0], wrench, axis=0)[8 * count :],
    }


def rise(contact: ContactWrench, pushed: ContactWrench, first: int) -> float:
    """Lags from a tenth to nine tenths of a step at sample `first`, the slowest of the forces."""
    response = (pushed.wrench - contact.wrench)[first - 1000 : first + 100, :3] / STEP
    size = np.abs(response)
    above = [int((size > level).argmax(axis=0)[axis]) for level in (0.9, 0.1) for axis in range(3)]
    return max(above[i] - above[3 + i] for i in range(3)) * float(contact.recording.dt or 0.0) / contact.lag


def with_step(recording: Recording, first: int) -> Recording:
    """Half a second of a force along each axis, from a sample on."""
    wrench, last = recording.wrench.copy(), first + round(0.5 / float(recording.dt or 1.0))
    wrench[first:last, :3] += STEP
    return recording.with_readings(wrench)


def forces_by_lag(
    fitted: Fit | CalibratedModel, recording: Recording, lags: Sequence[float]
) -> Iterator[tuple[str, float, Array, float | None]]:
    """Ways of smoothing a run without contact: name, lag in s, RMS of the forces (3,) N and the rise, where known."""
    bare = recording.moved(columns={n: c for n, c in recording.columns.items() if n not in INERTIAL})
    plain, first = compensate(fitted, recording), recording.samples // 2
    yield "each reading", 0.0, plain.wrench[:, :3].std(axis=0), None
    for lag in lags:
        contact, alone = (compensate(fitted, each, lag=lag) for each in (recording, bare))
        pushed = compensate(fitted, with_step(recording, first), lag=lag)
        ways = {"ours, with the unit": contact.wrench, "ours": alone.wrench}
        ways |= averages(plain.wrench, round(contact.lag / float(recording.dt or 1.0)))
        rises = {"ours, with the unit": rise(contact, pushed, first), "moving average": 1.6, "exponential": 2.2}
        for way, wrench in ways.items():
            yield way, contact.lag, wrench[:, :3].std(axis=0), rises.get(way)


def main(argv: Sequence[str] | None = None) -> None:
    """Print a row for each lag and way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", help="model file")
    parser.add_argument("run", help="recording without contact, in six axes")
    parser.add_argument("lags", nargs="*", type=float, help="s")
    asked = parser.parse_args(argv)
    fitted = ModelFile.read(asked.model)
    recording = tw.read(asked.run, rig=fitted.rig)
    row = "{:>7} {:<22} {:>7} {:>7} {:>7} {:>6}".format
    print(row("lag, ms", "way", "fcx, N", "fcy, N", "fcz, N", "rise"))
    for way, lag, rms, rising in forces_by_lag(fitted.calibration, recording, asked.lags or LAGS):
        print(row(f"{lag * 1e3:.1f}", way, *(f"{v:.3f}" for v in rms), "" if rising is None else f"{rising:.1f}"))


if __name__ == "__main__":
    main()
