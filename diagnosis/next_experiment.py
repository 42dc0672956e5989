"""Discriminating trajectory (T-optimal) between a supported effect and its aliases."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from design.discrimination import DiscriminationDesign, WhitenedPrediction, discriminate, with_effect_replaced
from design.discrimination.discriminating_trajectory import ExchangeProgress
from design.information.sensitivities import Sampling
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import TrajectorySeries
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.finding import Finding
from diagnosis.verdict_rule import EffectVerdict
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.errors import InputError
from modeling.noise import ColouredNoise, NoiseModel, StationaryNoise
from modeling.rig import Rig

HARMONICS = (1, 2, 3, 4, 5, 6)
"""Harmonics of the trajectory when no series is given: low ones suffice to discriminate between kinds of force."""
WHERE = "next experiment"


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
