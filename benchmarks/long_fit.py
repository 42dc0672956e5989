"""A fit of a long log, chunk by chunk in constant memory, against all of it at once.

in chunks           `estimation.fit.fit` with a `NoiseModel`: regressor, whitening and one triangle per chunk
lstsq at once       `numpy.linalg.lstsq` of all whitened rows, from the same emitted regressor and the same noise

It is fair because both start from the same arrays of signals and readings and are checked to give the same parameters;
deriving and compiling is outside the clock. Memory is what Python and NumPy allocate beyond those arrays; the copy that
LAPACK works on is not seen. Then a log is generated in chunks and fitted in a process of its own, and ten times as
much of it in another: peak memory is the whole process's resident set, interpreter and libraries included.

`python -m benchmarks.long_fit --samples 1e8` fits that many and prints seconds, peak memory and the errors in std.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from time import perf_counter

import numpy as np
import numpy.typing as npt

from benchmarks.measure import peak_bytes, peak_resident, rounds
from benchmarks.row import Row, table
from estimation.fit import fit
from estimation.streaming.chunk import Chunk
from estimation.streaming.chunk_information import linear_regressor_map
from modeling.chain.model import planar
from modeling.noise import NoiseModel

Array = npt.NDArray[np.float64]

SAMPLES = 1_000_000
"""What still fits into memory at once several times: 17 minutes at 1 kHz."""
CHUNK = 100_000
STEP = 1e-3
ROUNDS = 3
SAME = 1e-8
"""Of a std: lstsq itself rounds to less."""
TRUTH = np.array([15.0119, 0.2465, -1.3342, 0.2630, 0.0127, 0.018])
"""22.18: bias_fx, bias_fy, bias_tau (N, N, N m), m (kg), mlg (kg m), I (kg m²)."""
NOISE = NoiseModel.white([0.8, 1.6, 0.08])


def log(samples: int) -> Iterator[Chunk]:
    """Chunks of one run with the readings of a tool like the chapter's, under white noise."""
    rng = np.random.default_rng(0)
    frequencies, phases = np.array([[0.7], [1.9], [4.3]]), rng.uniform(0, 2 * np.pi, (3, 3, 1))
    for start in range(0, samples, CHUNK):
        time = STEP * np.arange(start, min(start + CHUNK, samples))
        angle = 2 * np.pi * frequencies * time
        sine, cosine = np.sin(angle + phases[0]), np.cos(angle + phases[0])
        rate = 2 * np.pi * frequencies
        signals = {"phi": (0.4 * sine).sum(0), "dphi": (0.4 * rate * cosine).sum(0)}
        signals |= {"ddphi": (-0.4 * rate**2 * sine).sum(0)}
        signals |= {name: (3 * np.sin(angle + p)).sum(0) for name, p in zip(("ax", "ay"), phases[1:], strict=True)}
        yield Chunk(run="log", signals=signals, wrench=readings(signals, rng))


def readings(signals: dict[str, Array], rng: np.random.Generator) -> Array:
    """The prediction at the true parameters, and noise, (n, p)."""
    rows = regressor(signals, len(signals["phi"]))
    predicted = np.tensordot(TRUTH, rows[:-1], 1) + rows[-1]
    return np.asarray(predicted.T + rng.standard_normal((predicted.shape[1], 3)) * NOISE.floor)


def regressor(signals: dict[str, Array], samples: int) -> Array:
    """Emitted regressor and offset (k + 1, p, n)."""
    emitted = linear_regressor_map(planar())
    assert emitted is not None
    return emitted(signals, samples)


def at_once(signals: dict[str, Array], wrench: Array) -> Array:
    """All whitened rows, then `lstsq`."""
    rows = regressor(signals, len(wrench))
    rows[-1] = wrench.T - rows[-1]
    white = NOISE.whitened_chunk(rows)
    return np.asarray(np.linalg.lstsq(white[:-1].reshape(len(TRUTH), -1).T, white[-1].ravel(), rcond=None)[0])


def compared() -> list[Row]:
    """Ratios of time and of memory where everything at once still fits."""
    parts = list(log(SAMPLES))
    signals = {name: np.concatenate([part.signals[name] for part in parts]) for name in parts[0].signals}
    wrench = np.concatenate([part.wrench for part in parts])
    ways = {
        "in chunks": lambda: fit(planar(), iter(parts), noise=NOISE),
        "lstsq at once": lambda: at_once(signals, wrench),
    }
    found = fit(planar(), parts, noise=NOISE)
    std = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(at_once(signals, wrench) / std, found.theta / std, rtol=0, atol=SAME)
    time = rounds(ways, ROUNDS)
    ours, other = (peak_bytes(way) for way in ways.values())
    ratios = tuple(b / a for a, b in zip(*time.values(), strict=True))
    task = f"fit of {SAMPLES:.0e} samples"
    return [
        Row(task=task, ours="in chunks", instead="lstsq at once", quantity=quantity, ratios=values)
        for quantity, values in (("time", ratios), ("peak memory", (other / ours,)))
    ]


def grown() -> list[Row]:
    """Memory and time of a process that fits ten times the samples, over those of one that fits them once."""
    once, ten = in_a_process(SAMPLES), in_a_process(10 * SAMPLES)
    return [
        Row(
            task="log generated and fitted in chunks",
            ours=f"{SAMPLES:.0e} samples",
            instead=f"{10 * SAMPLES:.0e} samples",
            quantity=quantity,
            ratios=(b / a,),
        )
        for quantity, a, b in zip(("time", "peak memory"), once, ten, strict=True)
    ]


def in_a_process(samples: int) -> tuple[float, float]:
    """Seconds of the fit, and peak resident MiB, of a process of its own."""
    command = [sys.executable, "-m", "benchmarks.long_fit", "--samples", str(samples)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    numbers = dict(line.split(": ") for line in printed.splitlines() if ": " in line)
    return float(numbers["seconds"]), float(numbers["peak memory, MiB"])


def fit_and_print(samples: int) -> None:
    """Fit a generated log of that many samples and print what it took."""
    linear_regressor_map(planar())  # derived outside the clock
    begin = perf_counter()
    found = fit(planar(), log(samples), noise=NOISE)
    seconds = perf_counter() - begin
    scores = (found.theta - TRUTH) / np.sqrt(np.diag(found.covariance))
    print(found)
    print(f"samples: {samples}\nseconds: {seconds:.1f}\npeak memory, MiB: {peak_resident():.0f}")
    print("errors in std: " + ", ".join(f"{score:.2f}" for score in scores))


def run() -> list[Row]:
    """All rows of this benchmark."""
    return compared() + grown()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Fit a generated log in chunks; without --samples, compare.")
    parser.add_argument("--samples", type=float, help="how many to generate and fit")
    arguments = parser.parse_args()
    if arguments.samples:
        fit_and_print(int(arguments.samples))
    else:
        print(table(run()))
