"""What a designed motion gains, in estimates from simulated recordings: `python -m benchmarks.design_variance`.

The rig is simulated in MuJoCo and shares no equation with the models. Along each motion a tool's wrench is recorded
many times, 200 samples in 5 s with white noise of one std in all channels; every recording is fitted
(`estimation.fit`), and the scatter of the estimates is held against the covariance that the criterion promises, M^-1
with M of `design.information`. Compared are the designed motion, x_opt of 22.17 scaled until it fits the limits, and
random motions that touch them.

`benchmarks.scatter` says where the scatter lies if the promise is true. A ratio of two variances over that of the
promises is F of (n-1, n-1) for n recordings. All intervals are of 95 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import f

from benchmarks.rivals.reference import ARM, FREE, LIMITS, RIG, SAMPLES
from benchmarks.rivals.unoptimised import chapter_optimum
from benchmarks.scatter import TAIL, Scatter, span
from design.information.experiment import Experiment
from design.random_feasible import random_feasible_trajectory
from design.trajectories.trajectory import Trajectory
from estimation.fit import fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.noise import NoiseModel
from truewrench import simulated_rig as simulated

Array = npt.NDArray[np.float64]

STD = 0.1
"""Of every channel, N and N m: with one std for all, M is the Phi'Phi / std² of 22.11."""
DRAWS, RANDOM = 200, 5
MODEL = planar()
NAMES = tuple(parameter.name for parameter in MODEL.parameters)
ARM_IN_MUJOCO = simulated.PlanarRig(link_lengths=ARM.link_lengths, noise=(STD, STD, STD))


class Silence(simulated.NoiseModel):
    """No noise."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Zeros."""
        return np.zeros((samples, channels))


def silent(motion: Trajectory) -> Recording:
    """The recording of one period without noise; the angles are read by resolvers."""
    frame = simulated.simulate(ARM_IN_MUJOCO, motion, repeats=1, samples_per_period=SAMPLES, noise=Silence())
    left_out = {"temperature", "repeat"}
    return from_columns({str(n): frame[n].to_numpy(dtype=float) for n in frame if n not in left_out}, rig=RIG)


def estimates(motion: Trajectory, draws: int, seed: int) -> Array:
    """(draws, k): the parameters estimated from recordings that differ by their noise."""
    recording, known = silent(motion), NoiseModel.white([STD] * 3)
    rng = np.random.default_rng(seed)
    noises = STD * rng.standard_normal((draws, *recording.wrench.shape))
    return np.array(
        [fit(MODEL, recording.with_readings(recording.wrench + noise), noise=known).theta for noise in noises]
    )


def promised(motion: Trajectory) -> Array:
    """M (k, k) of the motion that was asked for."""
    noise = NoiseModel.white([STD] * len(MODEL.channels))
    return Experiment.of(MODEL, ARM, noise=noise).information(motion, SAMPLES)


def gain_rows(designed: Scatter, others: Sequence[Scatter]) -> list[tuple[str, ...]]:
    """For each parameter and the determinant: how many times the others' variance is the designed motion's."""
    low, high = (float(f.ppf(tail, designed.freedom, designed.freedom)) for tail in (TAIL, 1 - TAIL))
    rows = []
    for i, name in enumerate(NAMES):
        cells = [name, f"{np.sqrt(designed.measured[i, i]):.2g}"]
        for other in others:
            measured = other.measured[i, i] / designed.measured[i, i]
            expected = other.promise[i, i] / designed.promise[i, i]
            cells.append(f"{expected:.3g}, {measured:.3g} ({span((expected * low, expected * high))})")
        rows.append(tuple(cells))
    return rows


def compared(motions: Mapping[str, Trajectory], *, draws: int, seed: int) -> list[Scatter]:
    """The scatter along each motion, with noise of its own."""
    return [
        Scatter(name, estimates(motion, draws, seed + number), promised(motion))
        for number, (name, motion) in enumerate(motions.items())
    ]


def shown(rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def report(scatters: Sequence[Scatter]) -> str:
    """Agreement of each motion, then the gain of the first over the others."""
    first, *others = scatters
    heads = ("ln det", "motion", "ln det(M S)", "tr(M S)/k", "variances, measured over promised")
    gains = ("parameter", f"std, {first.name}", *(f"variance, {other.name}" for other in others))
    note = (
        f"variances over those of the {first.name} motion: promised, measured, and where that lies if the promise holds"
    )
    unweighted = [np.linalg.slogdet(scatter.information * STD**2)[1] for scatter in scatters]
    agreement = [heads, *((f"{value:.2f}", *s.row()) for value, s in zip(unweighted, scatters, strict=True))]
    return "\n\n".join([shown(agreement), shown([gains, *gain_rows(first, others)]), note])


def main() -> None:
    """Design, simulate, estimate, print."""
    from benchmarks.our_design import traced

    parser = argparse.ArgumentParser(description="scatter of estimates along designed and other motions")
    parser.add_argument("--draws", type=int, default=DRAWS, help="recordings of each motion (default: %(default)s)")
    parser.add_argument("--random", type=int, default=RANDOM, help="random motions (default: %(default)s)")
    options = parser.parse_args()
    designed = traced(0, starts=1).motion
    assert designed is not None
    motions = {"designed": designed, "x_opt of 22.17": chapter_optimum()}
    motions |= {f"random {i + 1}": random_feasible_trajectory(FREE, LIMITS, seed=i) for i in range(options.random)}
    print(report(compared(motions, draws=options.draws, seed=0)))


if __name__ == "__main__":
    main()
