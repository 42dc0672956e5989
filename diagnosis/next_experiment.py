"""The next experiment: the motion that tells what a diagnosis found from what it could not be told apart from."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from design.discrimination import Distinction, View, in_place_of, tell_apart
from design.discrimination.search import Progress
from design.information import ColouredNoise, SensorNoise, WhiteNoise
from design.information.sampling import Sampling
from design.motion.fourier import FreeSeries
from design.motion.series import Series
from diagnosis.diagnosis import Diagnosis
from diagnosis.finding import Finding
from diagnosis.verdict import EffectVerdict
from estimation.recording import Recording
from estimation.response import signals_of
from modeling.effect import Effect
from modeling.errors import InputError
from modeling.rig import Rig

HARMONICS = (1, 2, 3, 4, 5, 6)
"""Of the motion when no series is given: large and slow ones suffice where forces are to differ in kind."""
WHERE = "next experiment"


def next_experiment(
    found: Diagnosis,
    rig: Rig | None = None,
    *,
    rivals: Sequence[Effect] | None = None,
    series: Series | None = None,
    samples: int | None = None,
    noise: SensorNoise | None = None,
    runs: int | None = None,
    starts: int = 4,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Distinction:
    """The motion that separates the first supported effect of a diagnosis from those in its `confusable_with`.

    The truth is the fitted model, what no motion can be designed for left out; lambda before is along the first
    recording's own motion. Series (free, of the same period), samples, noise and runs are those of that recording
    unless given; `rig` is its rig unless given, and `rivals` are other effects to be told apart from.
    Raises InputError when nothing was found that is confusable, or the rig lacks arm or limits.
    """
    finding, others = _confused(found, rivals)
    recording = found.fit.recordings[0]
    own = rig or recording.rig
    if own is None or own.arm is None or recording.dt is None:
        what = "the motion of an arm is designed, and the recording is not of one that moves"
        raise InputError(what=what, where=WHERE, remedy="give the rig, with robot.link_lengths or robot.urdf")
    model, seen = found.fit.model.designable, noise or noise_of(found)
    duration = recording.samples_per_repeat * recording.dt
    return tell_apart(
        own,
        model,
        found.fit.values,
        [in_place_of(model, finding.effect.id, other) for other in others],
        series=series or FreeSeries(joints=own.arm.joints, harmonics=HARMONICS, period=duration),
        samples=samples or recording.samples_per_repeat,
        noise=seen,
        reference=view_of(recording, seen),
        runs=runs or recording.repeats,
        starts=starts,
        seed=seed,
        executor=executor,
        progress=progress,
    )


def view_of(recording: Recording, noise: SensorNoise) -> View:
    """One run of a recording's motion, as it was measured."""
    once, step = recording.samples_per_repeat, recording.dt or 1.0
    periodic = recording.repeats > 1
    sampling = Sampling(duration=step * (once if periodic else once - 1), samples=once, periodic=periodic)
    signals = {name: values[:once] for name, values in signals_of(recording).items()}
    return View(signals=signals, sampling=sampling, noise=noise)


def noise_of(found: Diagnosis) -> SensorNoise:
    """The noise of the first recording: with its spectrum where repeats show it, else white, of its floor."""
    recording, noise = found.fit.recordings[0], found.fit.noise[0]
    if not noise.spectra or recording.dt is None:
        return WhiteNoise.of_std(noise.floor)
    frequency = np.fft.rfftfreq(recording.samples_per_repeat, recording.dt).astype(float)
    seen = np.concatenate([frequency[1:2], frequency[1:]])  # no spectrum is known at zero: as at the lowest line
    return ColouredNoise.of_spectra(frequency, np.stack([spectrum(seen) for spectrum in noise.spectra], axis=1))


def _confused(found: Diagnosis, rivals: Sequence[Effect] | None) -> tuple[Finding, list[Effect]]:
    """The first supported effect with rivals, and those."""
    supported = [f for f in found.findings if f.verdict is EffectVerdict.SUPPORTED and f.effect.designable]
    if rivals is not None and supported:
        return supported[0], list(rivals)
    known = {finding.effect.id: finding.effect for finding in found.findings}
    for finding in supported:
        others = [known[i] for i in finding.confusable_with]
        if others := [effect for effect in others if effect.designable]:
            return finding, others
    what = "no effect was found that a motion can be designed for" if not supported else "nothing is confusable"
    raise InputError(what=what, where=WHERE, remedy="name the effects to be told apart: `truewrench design --tell A B`")
