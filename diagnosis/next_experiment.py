"""The next motion: one that separates a supported effect from its aliases, or narrows the widest interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.criteria import Beside, EOptimal
from design.discrimination import DiscriminationDesign, WhitenedPrediction, discriminate, with_effect_replaced
from design.discrimination.discriminating_trajectory import ExchangeProgress
from design.exciting_trajectory import DesignInterrupted, ExcitingTrajectory
from design.information import Experiment, noise_equivalent_sizes
from design.information.sensitivities import Sampling
from design.limits import LimitUse, arm_and_limits
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from design.trajectory_design import DesignProgress, design
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.finding import Finding
from diagnosis.verdict_rule import EffectVerdict
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.noise import ColouredNoise, NoiseModel, StationaryNoise
from modeling.number_format import finite
from modeling.rig import Rig
from modeling.table import Column, Table, Tabular, Value

Array = NDArray[np.float64]

HARMONICS = (1, 2, 3, 4, 5, 6)
"""Harmonics of the trajectory when no series is given: low ones suffice to discriminate between kinds of force."""
WHERE = "next experiment"

# A motion that separates a supported effect from its aliases.


def next_experiment(
    diagnosis: Diagnosis,
    rig: Rig | None = None,
    *,
    rivals: Sequence[Effect] | None = None,
    series: TrajectorySeries | None = None,
    samples: int | None = None,
    noise: StationaryNoise | None = None,
    runs: int | None = None,
    starts: int = 4,
    seed: int = 0,
    executor: Executor | None = None,
    progress: ExchangeProgress | None = None,
) -> DiscriminationDesign:
    """Trajectory that best discriminates the first supported effect of a diagnosis from its `confusable_with`.

    The true model is the fitted one, without effects that no trajectory can be designed for; the reference
    noncentrality (lambda) is that of the first recording's motion. Series (free, of the same period), samples, noise
    and runs are those of that recording unless given; `rig` is its rig unless given, and `rivals` are the alternative
    effects instead of `confusable_with`.
    Raises InputError when no supported effect has an alias, or the rig lacks arm or limits.
    """
    finding, others = _aliased_finding(diagnosis, rivals)
    recording = diagnosis.fit.recordings[0]
    described = rig or recording.rig
    if described is None or described.arm is None or recording.dt is None:
        what = "a trajectory is designed for an arm in motion, and the recording is not of one"
        raise InputError(what=what, where=WHERE, remedy="give the rig, with robot.link_lengths or robot.urdf")
    model, assumed_noise = diagnosis.fit.model.designable, noise or sensor_noise_of(diagnosis)
    duration = recording.samples_per_repeat * recording.dt
    return discriminate(
        described,
        model,
        diagnosis.fit.values,
        [with_effect_replaced(model, finding.effect.id, other) for other in others],
        series=series or FreeSeries(joints=described.arm.joints, harmonics=HARMONICS, period=duration),
        samples=samples or recording.samples_per_repeat,
        noise=assumed_noise,
        reference=recorded_experiment(recording, assumed_noise),
        runs=runs or recording.repeats,
        starts=starts,
        seed=seed,
        executor=executor,
        progress=progress,
    )


def recorded_experiment(recording: Recording, noise: StationaryNoise) -> WhitenedPrediction:
    """One repeat of a recording's motion as an experiment, from the measured signals."""
    once, step = recording.samples_per_repeat, recording.dt or 1.0
    periodic = recording.repeats > 1
    sampling = Sampling(duration=step * (once if periodic else once - 1), samples=once, periodic=periodic)
    signals = {name: values[:once] for name, values in recording.motion.model_signals.items()}
    return WhitenedPrediction(signals=signals, sampling=sampling, noise=noise)


def sensor_noise_of(diagnosis: Diagnosis) -> StationaryNoise:
    """Noise of the first recording: coloured where repeats gave its spectrum, else white with the noise floor's std."""
    recording, noise = diagnosis.fit.recordings[0], diagnosis.fit.noise[0]
    if not noise.spectra or recording.dt is None:
        return NoiseModel.white(noise.floor)
    frequency = np.fft.rfftfreq(recording.samples_per_repeat, recording.dt).astype(float)
    at = np.concatenate([frequency[1:2], frequency[1:]])  # the spectrum at zero is unknown: that of the lowest line
    return ColouredNoise.of_spectra(frequency, np.stack([spectrum(at) for spectrum in noise.spectra], axis=1))


def _aliased_finding(diagnosis: Diagnosis, rivals: Sequence[Effect] | None) -> tuple[Finding, list[Effect]]:
    """The first supported effect with aliases, and its aliases."""
    supported = [f for f in diagnosis.findings if f.verdict is EffectVerdict.SUPPORTED and f.effect.designable]
    if rivals is not None and supported:
        return supported[0], list(rivals)
    effects = {finding.effect.id: finding.effect for finding in diagnosis.findings}
    for finding in supported:
        others = [effects[i] for i in finding.confusable_with]
        if others := [effect for effect in others if effect.designable]:
            return finding, others
    what = "no supported effect to design a trajectory for" if not supported else "no supported effect has an alias"
    raise InputError(
        what=what, where=WHERE, remedy="name the effects to be discriminated: `truewrench design --tell A B`"
    )


# A motion that narrows the widest interval.


ZERO_SCALE = 1000.0
"""Standard deviations of one sample: an error of a zero that matters as much as one of another parameter's size. Each
recording has zeros of its own, which are known to a few std at worst, so that they never are what is widest."""
INTERVAL_COLUMNS = (
    Column("parameter"),
    Column("value", format=".4g"),
    Column("unit"),
    *(Column(name, format=".2g") for name in ("std", "expected std", "std / size", "expected std / size")),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class KnownEstimates:
    """What is known of a model's parameters before the next motion.

    model       as fitted, the effects that no motion can be designed for among the others
    values      of its parameters, by name
    covariance  (k, k) in their order; an infinite variance of what is not identifiable, none of what is fixed
    noise       of one reading
    """

    model: WrenchModel
    values: Mapping[str, float]
    covariance: Array
    noise: NoiseModel

    @cached_property
    def designable(self) -> WrenchModel:
        """The model of which the next motion is designed."""
        return self.model.designable

    @cached_property
    def std(self) -> dict[str, float]:
        """Std by name: infinite of what is not identifiable, zero of what is fixed."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @cached_property
    def estimated(self) -> tuple[str, ...]:
        """Names of the parameters of the design that are estimated, the zeros among them."""
        return tuple(p.name for p in self.designable.parameters if self.std[p.name] > 0)

    @cached_property
    def zeros(self) -> dict[str, float]:
        """Std of one reading by the name of the channel's zero, which every recording has of its own."""
        std = np.sqrt(np.diag(self.noise.covariance))
        return dict(zip((p.name for p in self.designable.biases), std.tolist(), strict=True))

    @cached_property
    def gathered(self) -> Array:
        """The information of the recordings so far on the estimated parameters (k, k): none on the next one's zeros.

        It is the inverse of their covariance with all others free; of a parameter that is not identifiable it is none,
        which is too little rather than too much.
        """
        names = list(self.values)
        carried = [n for n in self.estimated if n not in self.zeros and np.isfinite(self.std[n])]
        std = np.array([self.std[n] for n in carried])
        index = [names.index(n) for n in carried]
        correlation = self.covariance[np.ix_(index, index)] / np.outer(std, std)
        information = np.linalg.pinv(correlation, hermitian=True) / np.outer(std, std)
        whole = np.zeros((len(self.estimated),) * 2)
        place = [self.estimated.index(n) for n in carried]
        whole[np.ix_(place, place)] = information
        return whole

    def sizes(self, rig: Rig) -> dict[str, float]:
        """The size of each estimated parameter but the zeros, in its unit, with which its std is compared.

        The largest value among those of one unit that the tool, or one effect, has: an element of the inertia that is
        zero is as well known as the others. Of what is insignificant its std; of what is neither estimated nor
        identifiable that which contributes as much as the noise.
        """
        units = {p.name: p.unit for p in self.designable.parameters}
        sizes: dict[str, float] = {}
        for name in (n for n in self.estimated if n not in self.zeros):
            alike = [n for n in units if units[n] == units[name] and _owner(n) == _owner(name) and n not in self.zeros]
            sizes[name] = max(abs(self.values[n]) for n in alike)
            if np.isfinite(self.std[name]):
                sizes[name] = max(sizes[name], self.std[name])
        if not all(sizes.values()):
            arm, limits = arm_and_limits(rig)
            values = {p.name: self.values[p.name] for p in self.designable.parameters}
            experiment = Experiment.of(self.designable, arm, values, noise=self.noise)
            noise = dict(zip(units, noise_equivalent_sizes(experiment, limits).tolist(), strict=True))
            sizes = {name: size or noise[name] for name, size in sizes.items()}
        return sizes


def _owner(name: str) -> str:
    """The effect of a parameter; empty of the tool's own."""
    return name.rpartition(".")[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class IntervalDesign(Tabular):
    """A motion that narrows the widest interval of a model, beside what its recordings have told already.

    plan   the motion, E-optimal of the sum of both information matrices in units of the sizes
    known  what is known before
    sizes  of the estimated parameters, but the zeros, in their units
    runs   of the motion
    """

    plan: ExcitingTrajectory
    known: KnownEstimates
    sizes: Mapping[str, float]
    runs: int

    @property
    def motion(self) -> Trajectory:
        """The trajectory, within its limits at every instant."""
        return self.plan.motion

    @property
    def limit_use(self) -> LimitUse:
        """Use of each limit, between the samples too."""
        return self.plan.limit_use

    @cached_property
    def expected(self) -> dict[str, float]:
        """Std of each parameter in a fit to all recordings, the next one among them, by the information."""
        names = [p.name for p in self.plan.experiment.parameters]
        index = [names.index(n) for n in self.known.estimated]
        new = self.plan.experiment.information(self.motion, self.plan.samples)[np.ix_(index, index)]
        total = self.runs * new + self.known.gathered
        scale = np.sqrt(np.diag(total))
        covariance = np.linalg.pinv(total / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
        std = dict(zip(self.known.estimated, np.sqrt(np.diag(covariance)).tolist(), strict=True))
        return {name: std[name] for name in self.sizes}

    @property
    def widest(self) -> str:
        """The parameter whose interval is widest before, in units of its size."""
        return max(self.sizes, key=lambda name: self.known.std[name] / self.sizes[name])

    @property
    def widest_after(self) -> str:
        """The parameter whose interval is widest after."""
        return max(self.sizes, key=lambda name: self.expected[name] / self.sizes[name])

    def to_data(self) -> dict[str, Any]:
        """The figures of the motion, and of each parameter the std before and after."""
        before = {name: finite(self.known.std[name]) for name in self.sizes}
        return self.plan.to_data() | {
            "runs": self.runs,
            "widest": self.widest,
            "std_before": before,
            "expected_std": self.expected,
            "sizes": dict(self.sizes),
        }

    @property
    def table(self) -> Table:
        """Value, std before and after, and both in units of the size, of each parameter; the widest first."""
        units = {p.name: p.unit for p in self.known.designable.parameters}
        rows: list[tuple[Value, ...]] = []
        for name in sorted(self.sizes, key=lambda name: -self.known.std[name] / self.sizes[name]):
            before, after, size = finite(self.known.std[name]), self.expected[name], self.sizes[name]
            share = None if before is None else before / size
            rows.append((name, self.known.values[name], units[name], before, after, share, after / size))
        return Table.of(INTERVAL_COLUMNS, rows)

    def remarks(self) -> list[str]:
        """The motion, what is widest after it, and the use of the limits."""
        last, shown = self.widest_after, self.plan
        return [
            f"{shown.motion.series}, {shown.samples} samples in {shown.motion.period:g} s, {self.runs}"
            f" run{'s' * (self.runs > 1)}; expected of a fit to all recordings together, each with a zero of its own",
            f"widest then: {last}, std / size {self.expected[last] / self.sizes[last]:.2g}",
            self.limit_use.sentence(),
        ]


def narrowing_motion(
    known: KnownEstimates,
    rig: Rig,
    *,
    series: TrajectorySeries,
    samples: int,
    runs: int = 1,
    starts: int | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: DesignProgress | None = None,
) -> IntervalDesign:
    """The motion after which the widest interval is as narrow as it can be, in units of the parameters' sizes.

    E-optimal of the information gathered and that of the runs together. Raises InputError where a parameter is not
    identifiable along any motion, or for a rig without arm or limits; DesignInterrupted with the best so far.
    """
    sizes = known.sizes(rig)
    scale = [sizes.get(name) or ZERO_SCALE * known.zeros[name] for name in known.estimated]
    names = [p.name for p in known.designable.parameters]
    kept = tuple(names.index(name) for name in known.estimated)

    def result(plan: ExcitingTrajectory) -> IntervalDesign:
        return IntervalDesign(plan=plan, known=known, sizes=sizes, runs=runs)

    try:
        return result(
            design(
                rig,
                model=known.designable,
                values=known.values,
                criterion=Beside(EOptimal(np.array(scale)), kept, known.gathered, runs),
                series=series,
                samples=samples,
                noise=known.noise,
                starts=starts,
                seed=seed,
                bounded=False,
                executor=executor,
                progress=progress,
            )
        )
    except DesignInterrupted as interruption:
        best = interruption.best
        raise DesignInterrupted(None if best is None else result(best)) from None
