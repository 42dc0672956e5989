"""What a designed motion gains, in estimates from simulated recordings: `python -m benchmarks.design_variance`.

The rig is simulated in MuJoCo and shares no equation with the models. Along each motion a tool's wrench is recorded
many times, 200 samples in 5 s with white noise of one std in all channels; every recording is fitted
(`estimation.fit`), and the scatter of the estimates is held against the covariance that the criterion promises, M^-1
with M of `design.information`. Compared are the designed motion, x_opt of 22.17 scaled until it fits the limits, and
random motions that touch them.

With n recordings the scatter S of k estimates about their mean is Wishart, (n-1) S ~ W(n-1, M^-1), if the promise is
true. So of each variance (n-1) S_ii / (M^-1)_ii is chi-square of n-1, (n-1) tr(M S) is chi-square of (n-1) k, and
ln det(M S) is a sum of logarithms of chi-squares of n-1 .. n-k (Bartlett), taken as normal with its mean and variance.
A ratio of two scatters over that of the promises is F of (n-1, n-1). All intervals are of 95 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import polygamma, psi
from scipy.stats import chi2, f, norm

from benchmarks.rivals.reference import ARM, FREE, LIMITS, RIG, SAMPLES
from benchmarks.rivals.unoptimised import chapter_optimum
from design.information.experiment import Experiment
from design.information.noise import WhiteNoise
from design.motion.series import Motion
from design.random_feasible import random_feasible
from estimation.fit import fit
from estimation.reading import from_columns
from estimation.recording import Recording
from estimation.robust.rereading import reread
from estimation.stream.noise_model import NoiseModel
from modeling.model import planar
from truewrench import simulated_rig as simulated

Array = npt.NDArray[np.float64]
Interval = tuple[float, float]

STD = 0.1
"""Of every channel, N and N m: with one std for all, M is the Phi'Phi / std² of 22.11."""
DRAWS, RANDOM, LEVEL = 200, 5, 0.95
TAIL = (1 - LEVEL) / 2
MODEL = planar()
NAMES = tuple(parameter.name for parameter in MODEL.parameters)
ARM_IN_MUJOCO = simulated.PlanarRig(link_lengths=ARM.link_lengths, noise=(STD, STD, STD))


class Silence(simulated.NoiseModel):
    """No noise."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Zeros."""
        return np.zeros((samples, channels))


def silent(motion: Motion) -> Recording:
    """The recording of one period without noise; the angles are read by resolvers."""
    frame = simulated.simulate(ARM_IN_MUJOCO, motion, repeats=1, samples_per_period=SAMPLES, noise=Silence())
    left_out = {"temperature", "repeat"}
    return from_columns({str(n): frame[n].to_numpy(dtype=float) for n in frame if n not in left_out}, rig=RIG)


def estimates(motion: Motion, draws: int, seed: int) -> Array:
    """(draws, k): the parameters estimated from recordings that differ by their noise."""
    recording, known = silent(motion), NoiseModel.white([STD] * 3)
    rng = np.random.default_rng(seed)
    noises = STD * rng.standard_normal((draws, *recording.wrench.shape))
    return np.array([fit(MODEL, reread(recording, recording.wrench + noise), noise=known).theta for noise in noises])


def promised(motion: Motion) -> Array:
    """M (k, k) of the motion that was asked for."""
    noise = WhiteNoise.of_std([STD] * len(MODEL.channels))
    return Experiment.of(MODEL, ARM, noise=noise).information(motion, SAMPLES)


@dataclass(frozen=True, eq=False)
class Scatter:
    """Estimates theta (n, k) along a motion, and the information M (k, k) that was promised."""

    name: str
    theta: Array
    information: Array

    @classmethod
    def of(cls, name: str, motion: Motion, *, draws: int, seed: int) -> Scatter:
        """From simulated recordings."""
        return cls(name, estimates(motion, draws, seed), promised(motion))

    @property
    def freedom(self) -> int:
        """n - 1."""
        return len(self.theta) - 1

    @cached_property
    def measured(self) -> Array:
        """S (k, k)."""
        return np.asarray(np.cov(self.theta.T), dtype=float)

    @cached_property
    def promise(self) -> Array:
        """M^-1 (k, k)."""
        return np.asarray(np.linalg.inv(self.information), dtype=float)

    @property
    def variance(self) -> Array:
        """Measured over promised variance of each parameter, (k,)."""
        return np.asarray(np.diag(self.measured) / np.diag(self.promise))

    @property
    def variance_interval(self) -> Interval:
        """Where each of them lies if the promise is true."""
        return _chi_square(self.freedom)

    @property
    def trace(self) -> float:
        """tr(M S) / k: the mean over all directions of measured over promised variance."""
        return float(np.trace(self.information @ self.measured)) / len(self.information)

    @property
    def trace_interval(self) -> Interval:
        """Where it lies if the promise is true."""
        return _chi_square(self.freedom * len(self.information))

    @property
    def logdet(self) -> float:
        """ln det(M S): how much larger the ellipsoid is than promised, twice the logarithm of its volume."""
        return float(np.linalg.slogdet(self.information)[1] + np.linalg.slogdet(self.measured)[1])

    @property
    def logdet_interval(self) -> Interval:
        """Where it lies if the promise is true: sum_i ln chi²(n - i) - k ln(n - 1)."""
        half = (self.freedom - np.arange(len(self.information))) / 2
        mean = float((psi(half) + np.log(2 / self.freedom)).sum())
        reach = float(norm.ppf(1 - TAIL) * np.sqrt(polygamma(1, half).sum()))
        return mean - reach, mean + reach

    def row(self) -> tuple[str, ...]:
        """ln det M in units of std², ln det(M S), tr(M S)/k, and the extreme variances, with their intervals."""
        unweighted = float(np.linalg.slogdet(self.information * STD**2)[1])
        extremes = f"{self.variance.min():.2f} .. {self.variance.max():.2f} ({_span(self.variance_interval)})"
        logdet = f"{self.logdet:+.2f} ({_span(self.logdet_interval)})"
        return (self.name, f"{unweighted:.2f}", logdet, f"{self.trace:.3f} ({_span(self.trace_interval)})", extremes)


def gain_rows(designed: Scatter, others: Sequence[Scatter]) -> list[tuple[str, ...]]:
    """For each parameter and the determinant: how many times the others' variance is the designed motion's."""
    low, high = (float(f.ppf(tail, designed.freedom, designed.freedom)) for tail in (TAIL, 1 - TAIL))
    rows = []
    for i, name in enumerate(NAMES):
        cells = [name, f"{np.sqrt(designed.measured[i, i]):.2g}"]
        for other in others:
            measured = other.measured[i, i] / designed.measured[i, i]
            expected = other.promise[i, i] / designed.promise[i, i]
            cells.append(f"{expected:.3g}, {measured:.3g} ({_span((expected * low, expected * high))})")
        rows.append(tuple(cells))
    return rows


def compared(motions: Mapping[str, Motion], *, draws: int, seed: int) -> list[Scatter]:
    """The scatter along each motion, with noise of its own."""
    return [Scatter.of(name, m, draws=draws, seed=seed + i) for i, (name, m) in enumerate(motions.items())]


def shown(rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def _chi_square(freedom: int, tail: float = TAIL) -> Interval:
    """Where a chi-square over its freedom lies."""
    return float(chi2.ppf(tail, freedom)) / freedom, float(chi2.ppf(1 - tail, freedom)) / freedom


def _span(interval: Interval) -> str:
    return " .. ".join(f"{end:.3g}" for end in interval)


def report(scatters: Sequence[Scatter]) -> str:
    """Agreement of each motion, then the gain of the first over the others."""
    first, *others = scatters
    heads = ("motion", "ln det", "ln det(M S)", "tr(M S)/k", "variances, measured over promised")
    gains = ("parameter", f"std, {first.name}", *(f"variance, {other.name}" for other in others))
    note = (
        f"variances over those of the {first.name} motion: promised, measured, and where that lies if the promise holds"
    )
    agreement = [heads, *(scatter.row() for scatter in scatters)]
    return "\n\n".join([shown(agreement), shown([gains, *gain_rows(first, others)]), note])


def main() -> None:
    """Design, simulate, estimate, print."""
    from benchmarks.our_design import traced

    parser = argparse.ArgumentParser(description="scatter of estimates along designed and other motions")
    parser.add_argument("--draws", type=int, default=DRAWS, help="recordings of each motion (default: %(default)s)")
    parser.add_argument("--random", type=int, default=RANDOM, help="random motions (default: %(default)s)")
    options = parser.parse_args()
    designed = traced(0).motion
    assert designed is not None
    motions = {"designed": designed, "x_opt of 22.17": chapter_optimum()}
    motions |= {f"random {i + 1}": random_feasible(FREE, LIMITS, seed=i) for i in range(options.random)}
    print(report(compared(motions, draws=options.draws, seed=0)))


if __name__ == "__main__":
    main()
