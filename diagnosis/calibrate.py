"""Calibrate: diagnose surrogates of a recording, in which nothing is missing or one effect is hidden."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing import current_process, get_context
from signal import SIG_IGN, SIGINT, signal
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.calibration import Calibration, EffectPower, Rate
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.progress import CountCallback, Progress, count_progress, counted, silent
from diagnosis.screening.score_test import ScoreTest, screen
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from estimation.fit import Fit, require_recording, unchecked_fit
from estimation.model_response import predicted_readings
from estimation.multiplicity import bonferroni_level
from estimation.recordings.recording import Recording, readings_digest
from modeling.chain.effect import Effect, effects_of
from modeling.chain.model import WrenchModel, require_model
from modeling.effects import catalogue
from modeling.errors import InputError
from modeling.parameter import Parameter

# Surrogate noise: readings noise with the spectra and coherence of a residual, by resampling its Fourier lines.
#
# Local bootstrap of the periodogram (Paparoditis and Politis, 1999): each Fourier line of a surrogate is that of a
# neighbour, all channels together, with one uniformly distributed phase. Neighbours are lines on which the residual is
# noise: all of a single run, the non-excited ones of a recording with repeats. Whatever is not in a spectrum (bursts,
# contact, the shape of a distribution) is lost: a surrogate is stationary and nearly normal.


Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

NEAREST = 8
"""Neighbours of a line, at the most; wider means more different surrogates, of a smoother spectrum."""
SPREAD = 4
"""A line's neighbours lie within this part of its frequency, so that a steep spectrum stays steep."""


def surrogate_noise(recording: Recording, residual: Array, rng: np.random.Generator) -> Array:
    """Noise (n, p) like that in a residual (n, p) of a recording, in the channels' units."""
    if recording.repeats > 1 and not recording.continuous:
        return _of_separate_runs(recording, residual, rng)
    index = np.arange(len(residual) // 2 + 1)
    donors = index[1:] if recording.repeats == 1 else index[index % recording.repeats != 0]
    lines = np.fft.rfft(residual, axis=0)
    return _series(_resampled(lines, donors, rng), len(residual))


def _of_separate_runs(recording: Recording, residual: Array, rng: np.random.Generator) -> Array:
    """Each run from the differences between the runs, whose mean holds what repeats with the motion."""
    repeats, period = recording.repeats, recording.samples_per_repeat
    runs = residual.reshape(repeats, period, -1)
    differences = (runs - runs.mean(axis=0)) * np.sqrt(repeats / (repeats - 1))
    lines = np.fft.rfft(differences, axis=1)
    donors = np.arange(lines.shape[1])
    drawn = [_resampled(lines[run], donors, rng, constant=True) for run in rng.integers(repeats, size=repeats)]
    return np.concatenate([_series(each, period) for each in drawn])


def _resampled(lines: Lines, donors: NDArray[np.intp], rng: np.random.Generator, *, constant: bool = False) -> Lines:
    """Every line from one of the donors near it; the mean of the channels is zero unless it is noise, too."""
    index = np.arange(len(lines))
    first = np.searchsorted(donors, index)
    reach = np.clip(index // (2 * SPREAD), 0, NEAREST // 2)
    low, high = np.maximum(first - reach, 0), np.minimum(first + reach, len(donors) - 1)
    place = np.minimum(rng.integers(np.minimum(low, high), high + 1), len(donors) - 1)
    phase = np.exp(2j * np.pi * rng.random(len(lines)))
    resampled: Lines = lines[donors[place]] * phase[:, None]
    if not constant:
        resampled[0] = 0.0
    return resampled


def _series(lines: Lines, samples: int) -> Array:
    """The real series (n, p) of these lines; the first and the last, which are real, keep their power."""
    ends = [0, -1] if samples % 2 == 0 else [0]
    lines[ends] = np.abs(lines[ends]) * np.sign(lines[ends].real + 1e-300)
    return np.asarray(np.fft.irfft(lines, samples, axis=0))


Result = TypeVar("Result")

DRAWS = 100
"""Surrogates by default: a rate of 1 % is then known within -1 and +4.4 %."""
POWER_DRAWS = 20
"""Surrogates by default in which each effect is hidden."""
REFUSED = "refused"


def calibrate(
    model: WrenchModel,
    recording: Recording,
    *,
    effects: Sequence[Effect | str] | None = None,
    draws: int = DRAWS,
    power_draws: int = POWER_DRAWS,
    seed: int = 0,
    progress: Progress = silent,
    workers: int = 1,
) -> Calibration:
    """False-alarm rate and power of the diagnosis of a recording, by diagnosing surrogates of it.

    The recording is diagnosed; a surrogate is the prediction of the model found, with noise resampled from what that
    model leaves of the readings, so that it has this recording's motion, rate and noise, and no missing effect.

    Parameters
    ----------
    model : WrenchModel
        The rigid tool, `planar(rig)` or `spatial(rig)`, or a model with effects.
    recording : Recording
        The recording, of one run or with repeats.
    effects : sequence of Effect or str, optional
        The candidate effects, or their ids; by default the whole catalogue.
    draws : int, optional
        Surrogates without a missing effect that are diagnosed, by default 100.
    power_draws : int, optional
        Surrogates for each effect, hidden at its detectable amount, by default 20; 0 for none.
    seed : int, optional
        Seed of the surrogates, by default 0.
    progress : callable, optional
        Called with one line of text as the work goes on; by default silent.
    workers : int, optional
        Number of processes that diagnose surrogates, under Linux; by default 1. The result does not depend on it.

    Returns
    -------
    Calibration
        Rates with exact 95 % intervals, and whether the stated false-alarm rate holds.

    Raises
    ------
    InputError
        When the recording cannot be diagnosed, or no surrogate is asked for.

    Notes
    -----
    Local bootstrap of the periodogram (Paparoditis and Politis, 1999), exact binomial intervals (Clopper and Pearson,
    1934). Surrogates are stationary: what bursts or contact in the noise would do, they do not show.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> drag = [tw.effects.named("viscous_drag")]
    >>> found = tw.calibrate(tw.planar(rig), tw.read("train.csv", rig=rig), effects=drag, draws=4, power_draws=0)
    >>> found.alarms.count, found.alarms.total, found.holds
    (0, 4, True)
    """
    if draws < 1 or power_draws < 0:
        what = f"{draws} surrogates, and {power_draws} of each effect, are no calibration"
        raise InputError(what=what, where="calibrate", remedy="ask for at least one, and for no negative number")
    require_model(model, "calibrate")
    require_recording(recording, "calibrate")
    candidates = None if effects is None else effects_of(effects)
    diagnosis = diagnose(model, recording, effects=candidates, progress=progress)
    source = _Source.of(diagnosis, candidates or catalogue(model.space), seed)
    return _calibrated(diagnosis, source, draws, power_draws, progress, workers)


@dataclass(frozen=True, eq=False)
class _Source:
    """What surrogates are made of: a fit of one recording, the candidates that it lacks, the residual."""

    fit: Fit
    candidates: tuple[Effect, ...]
    residual: Array
    seed: int

    @classmethod
    def of(cls, diagnosis: Diagnosis, candidates: Iterable[Effect], seed: int) -> _Source:
        fit = diagnosis.fit
        present = {e.id for e in fit.model.effects}
        (residual,) = fit.residuals
        used = int(fit.identifiable.sum()) / residual.size
        return cls(
            fit, tuple(e for e in candidates if e.id not in present), residual / np.sqrt(1 - min(used, 0.5)), seed
        )

    @property
    def recording(self) -> Recording:
        return self.fit.recordings[0]

    def surrogate(self, prediction: Array, number: tuple[int, ...]) -> Recording:
        """The recording with predicted readings (n, p) and noise of its own; `number` is that of the surrogate."""
        rng = np.random.default_rng([self.seed, *number])
        return self.recording.with_readings(prediction + surrogate_noise(self.recording, self.residual, rng))


def _calibrated(
    diagnosis: Diagnosis, source: _Source, draws: int, power_draws: int, progress: Progress, workers: int
) -> Calibration:
    """`calibrate`, once the recording is diagnosed."""
    announce = count_progress(progress, "diagnose surrogates")
    verdicts = results_of(partial(_diagnosed, source), range(draws), workers, announce)
    diagnosed = [(verdict, added) for verdict, added in verdicts if verdict != REFUSED]
    doubted = {RecordVerdict.UNEXPLAINED.value, RecordVerdict.PARTLY_EXPLAINED.value}
    return Calibration(
        recording=source.recording.name,
        digest=readings_digest(source.recording),
        model=tuple(e.id for e in source.fit.model.effects),
        verdict=diagnosis.verdict,
        alarms=Rate(sum(bool(added) for _, added in diagnosed), len(diagnosed)),
        misfits=Rate(sum(verdict in doubted for verdict, _ in diagnosed), len(diagnosed)),
        refused=draws - len(diagnosed),
        named=Counter(effect for _, added in diagnosed for effect in added),
        power=_power(source, power_draws, progress, workers) if power_draws else (),
        candidates=tuple(f.effect.id for f in diagnosis.findings),
    )


def _diagnosed(source: _Source, number: int) -> tuple[str, tuple[str, ...]]:
    """Verdict on a surrogate without a missing effect, and the effects named."""
    fit = source.fit
    try:
        diagnosis = diagnose(
            fit.model, source.surrogate(fit.predicted_readings(), (0, number)), effects=source.candidates or None
        )
    except InputError:
        return REFUSED, ()
    return diagnosis.verdict.value, diagnosis.added


def _power(source: _Source, draws: int, progress: Progress, workers: int) -> tuple[EffectPower, ...]:
    """The power for every effect that is identifiable and that changes the readings at its detectable amount."""
    detectable = [
        _HiddenEffect.of(source.fit, test) for test in screen(source.fit, source.candidates) if test.detectable
    ]
    hidden = sorted((h for h in detectable if h.changes_readings), key=lambda h: h.test.effect.id)

    def detected_of(place: int) -> int:
        return sum(_detected(source, hidden[place], (place + 1, number)) for number in range(draws))

    detected = results_of(detected_of, range(len(hidden)), workers, count_progress(progress, "power for each effect"))
    return tuple(h.power(Rate(count, draws)) for h, count in zip(hidden, detected, strict=True))


@dataclass(frozen=True, eq=False)
class _HiddenEffect:
    """An effect of which only the first amplitude is not nominal, but detectable.

    prediction  readings (n, p) of the fitted model with it, `without` of the fitted model
    """

    test: ScoreTest
    parameter: Parameter
    prediction: Array
    without: Array

    @classmethod
    def of(cls, fit: Fit, test: ScoreTest) -> _HiddenEffect:
        parameters = {p.name: p for p in test.effect.qualified(fit.model.space)}
        name, amount = next(iter(test.detectable.items()))
        nominal = {name: p.nominal for name, p in parameters.items()}
        values = nominal | test.detectable_at
        # the amount is the value itself where the effect vanishes at infinity
        values[name] = nominal[name] + amount if np.isfinite(nominal[name]) else amount
        model, recording = fit.model + test.effect, fit.recordings[0]
        theta = np.array([(values | dict(fit.values))[p.name] for p in model.parameters])
        return cls(test, parameters[name], predicted_readings(model, recording, theta), fit.predicted_readings())

    @property
    def changes_readings(self) -> bool:
        """False for a range that no reading reaches."""
        return not np.allclose(self.prediction, self.without, rtol=1e-9, atol=0)

    def power(self, detected: Rate) -> EffectPower:
        name = self.parameter.name
        return EffectPower(
            self.test.effect.id, name.split(".", 1)[1], self.test.detectable[name], self.parameter.unit, detected
        )


def _detected(source: _Source, hidden: _HiddenEffect, number: tuple[int, int]) -> bool:
    """Whether the effect is significant in a surrogate that it is hidden in."""
    fit, candidates = source.fit, len(source.candidates)
    again = unchecked_fit(Case(fit.model, (source.surrogate(hidden.prediction, number),)), start=fit.values)
    (tested,) = screen(again, [hidden.test.effect], candidates=candidates)
    return tested.excited and tested.p_value < bonferroni_level(candidates)


# ---------------------------------------------------------------------------------------------- processes

_inherited: Callable[[int], Any] | None = None
"""In a process of the pool: what it does of each number. It is inherited, as an effect need not be picklable."""


def results_of(
    work: Callable[[int], Result], numbers: Sequence[int], workers: int, announce: CountCallback
) -> list[Result]:
    """The result of each number, by so many processes; only forked ones, and none within a worker of another pool."""
    count = min(workers, len(numbers))
    if count < 2 or not sys.platform.startswith("linux") or current_process().daemon:
        return [work(number) for number in counted(numbers, announce)]
    with ProcessPoolExecutor(count, get_context("fork"), _inherit, (work,)) as pool:
        running = [pool.submit(_inherited_result, number) for number in numbers]
        try:
            return [result.result() for result in counted(running, announce)]
        except BrokenProcessPool:
            remedy = "calibrate with fewer workers, or on a machine with more memory"
            raise InputError(what="a worker was killed", where="calibrate", remedy=remedy) from None
        finally:
            pool.shutdown(cancel_futures=True)


def _inherit(work: Callable[[int], Any]) -> None:
    """Begin a process of the pool; interrupts are the original's."""
    global _inherited
    signal(SIGINT, SIG_IGN)
    _inherited = work


def _inherited_result(number: int) -> Any:
    assert _inherited is not None
    return _inherited(number)
