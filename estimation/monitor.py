"""Monitor of a fitted model on line: bias and tool by recursive least squares, and evidence that something changed.

The filters are square-root information (R z) of the parameters' deviations from the fit (Bierman, Factorization Methods
for Discrete Sequential Estimation, 1977). Readings are compared in blocks. Filter 0 says that nothing changed: the
biases walk as stated, what the fit knows of the other parameters returns slowly. Filter j says that the parameters of
group j (bias, mass, centre of mass, an effect of the model) may have changed lately: it forgets them faster. Where
filter 0 has the density of the readings, the ratio e_j of the two densities of a block has the expectation 1, whatever
was seen before. The evidence of a group, M_j = max(M_j, 1) min(e_j, c), is then an e-detector: the expectation of its
mean M over the groups is, at any stopping time, at most that of the number of blocks, so that M reaches A after A
blocks in expectation at the earliest (Shin, Ramdas and Rinaldo, E-detectors: a nonparametric framework for sequential
change detection, New England Journal of Statistics in Data Science 2, 2024).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.autoregression import fit_autoregression
from estimation.case import prepared
from estimation.contact.contact_wrench import CalibratedModel, compensate
from estimation.fit import Fit, require_recording
from estimation.least_squares.estimates import Estimate
from estimation.multiplicity import chi2_isf, normal_isf
from estimation.recordings.recording import Recording
from estimation.streaming.streamed_fit import StreamedFit
from modeling.chain.model import WrenchModel
from modeling.chain.pseudo_inertia import pseudo_inertia
from modeling.chain.sensor_axes import contact_gain_at, group_delay
from modeling.codegen.casadi_target import CasadiSample, state_size
from modeling.codegen.fitted_model import FittedModel, MonitorProgram
from modeling.compiled.symbolic_vector import casadi_results
from modeling.errors import InputError, kind_of, quoted
from modeling.noise import NoiseModel
from modeling.rigid_body import inertial_parameters
from modeling.significance import LEVELS
from modeling.space import signals

Array = NDArray[np.float64]

TOOL = ("mass", "centre of mass")
"""Groups of the rigid tool: with its mass, and without."""
SECONDS_PER_DAY = 86400.0
HOUR = 3600.0
BLOCKS_PER_CONTACT = 10
"""Blocks in the longest contact: as evidence may grow by `CAP` in one, a change is stated no earlier than so many."""
CAP = 1.0
"""Largest growth of the log evidence in a block. The longest contact adds as much as the log of 22 000 on top of a
level of e.g. 86 400 blocks, so that a contact doubles the evidence that a weak change needs, and no more."""
MEMORY = 300
"""Blocks after which what was learned of the tool gives way to what the fit knew, where nothing changed: several
minutes, so that the model's own systematic error, which differs from motion to motion, is followed and not a change."""
SHORT_MEMORY = 30
"""Blocks after which a group that may have changed is forgotten. k parameters cost k / (2 * 30) of log evidence a
block: a change is found that adds more, which is a fifth of the std of a block's mean a parameter."""
UNKNOWN = 1e3
"""Prior std, in units, of a bias and of what changed: no bound, and small enough for the arithmetic."""
REFUTED = 1e-4
"""Evidence of a block below which a group's filter starts anew: what it had learned, such as a contact, is over. Of a
true one it is so with at most this probability."""
GATE = 1e-4
"""Level of the chi-square test by which a block is left out of filter 0: a contact must not be learned as a bias, and
one block in ten thousand that is left out for nothing costs nothing."""
ODDS = 20.0
"""Likelihood ratio up to which times, or groups, are said to be possible beside the likeliest: that of 5 %."""
LEAST_SHARE = 0.8
"""Share of a departure that a group has to explain to be named, and to be given an amount: what is left of it has then
less than half of its size."""
LEAST_FALL = 1.0
"""Fall of a group's log likelihood that says that a change is later: filter 0 is remembered as it was then, before it
may have learned some of the change."""
FIRST_BLOCKS = 2
"""Blocks in which a filter learns its zero; they say nothing of the noise."""
FEWEST_BLOCKS = 4
"""Blocks after the first that say how large the noise is at their scale: four of three channels are 12 numbers."""
MOST_BLOCKS = 300
"""Blocks of the recording of ordinary work that are looked at for it, as many as the memory is long."""
WALKS = tuple(2.0**power for power in range(9))
"""Walks of the zero that are tried, in multiples of the stated drift: noise of 1/f kind is slower than an
autoregression, and is followed as drift."""
RATE_TOLERANCE = 1e-3
"""Relative difference of sampling intervals that are the same: clocks of robots differ by less."""
SMALLEST_CORRELATION = 1e-9
"""Added to the correlation matrix of the fit, so that it has a factor where parameters are collinear."""


class Change(NamedTuple):
    """That the tool or the model changed.

    start, end  s, the time of the change lies between: the times with odds of up to 20 against the likeliest
    stated      s, when it was stated
    group       what changed most likely: "bias", "mass" (of the rigid tool, with its moments), "centre of mass", or the
                id of an effect of the model; empty where none of them explains 80 % of the departure
    others      groups with odds of up to 20 against it, or against the nearest of those that do not explain it
    by          by how much the parameters of the group differ from the fit since then, a bias from its value before
    limit       s, the longest contact: one that lasts longer is not told from a change, and may be this
    """

    start: float
    end: float
    stated: float
    group: str
    others: tuple[str, ...]
    by: Mapping[str, Estimate]
    limit: float

    def __str__(self) -> str:
        """One line."""
        when = f"changed between {self.start:.6g} and {self.end:.6g} s"
        contact = f"or a contact of more than {self.limit:g} s"
        if not self.group:
            return f"{when}: like nothing in the model alone; {' or '.join(self.others)} comes nearest; {contact}"
        amounts = ", ".join(f"{e.name} {e.value:+.3g} ± {e.std:.2g} {e.unit}" for e in self.by.values())
        beside = f" (or {', '.join(self.others)})" if self.others else ""
        return f"{when}: looks like {self.group}{beside}, {amounts}; {contact}"


class Monitor:
    """Watch a fitted model on line, sample by sample: bias, mass and centre of mass, and whether it still holds.

    Parameters
    ----------
    fitted : Fit, StreamedFit, CalibratedModel or ModelFile
        The fitted model; recording-specific effects are dropped.
    recording : Recording, optional
        Ordinary work with this tool, of which the noise is taken; by default the first recording of a fit. A model file
        needs one.
    longest_contact : float, optional
        Longest contact in s, by default 10; a tenth of it is a block.
    drift : mapping, optional
        Std by which the zero of a channel walks in an hour, in its unit, by name; by default the noise of a sample.
    alarms_per_day : float, optional
        False alarms in a day of samples, in expectation at most, by default 1.

    Raises
    ------
    InputError
        For a tool that deflects, which has no derivative, a recording that is too short, of poses at rest or without
        a signal of the model, and settings that are not positive.

    Notes
    -----
    The noise is the autoregression of the recording's residual, with the model's systematic error in it. Where the
    means of its blocks vary more than that predicts, its variance and the walk of the zero are raised to what they
    show.

    A contact is a departure of any size that is over after `longest_contact` s; a change is one that lasts, and so a
    contact that lasts longer is stated as one, with the group that it resembles. The log
    evidence grows by 1 a block at most, by 10 in the longest contact, and a change is stated at log(blocks in a day /
    `alarms_per_day`) + 10: so no contact states one by itself, and the readings after it take away what it had added,
    if the tool is free for as long. A change is stated `longest_contact` s after it at the earliest, after a little
    more than twice that where it is clear.

    A step of the bias that is small against the noise of a block is followed as drift. Derivatives of a model with
    memory are those of its load, later by the sensor's delay. A monitor that starts in a contact takes it for the bias.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> train = tw.read("train.csv", rig=rig)
    >>> monitor = tw.Monitor(tw.fit(tw.planar(rig) + tw.effects.viscous_drag(), train), longest_contact=2.0)
    >>> row = {name: series[0] for name, series in train.signals.items()}
    >>> monitor.update(row, train.wrench[0]).shape
    (3,)
    >>> str(monitor.watch(train))
    'still valid'
    """

    def __init__(
        self,
        fitted: Fit | StreamedFit | CalibratedModel | Any,
        recording: Recording | None = None,
        *,
        longest_contact: float = 10.0,
        drift: Mapping[str, float] | None = None,
        alarms_per_day: float = 1.0,
    ) -> None:
        """A monitor that has seen no sample."""
        if recording is None and isinstance(fitted, Fit):
            recording = fitted.recordings[0]
        if isinstance(fitted, Fit | StreamedFit):
            fitted = CalibratedModel.of(fitted)
        calibration = getattr(fitted, "calibration", fitted)
        if not isinstance(calibration, CalibratedModel):
            raise _error(f"{kind_of(fitted)} is no fitted model", "give the fit first: tw.Monitor(fit)")
        if recording is None:
            raise _error("the noise of its readings is not known", "give a recording of ordinary work with this tool")
        require_recording(recording, "monitor")
        if recording.loads:
            raise _error(f"{recording.name} carries {recording.loads[0]}", "give a recording of the tool alone")
        if recording.dt is None:
            raise _error("the recording is of poses at rest", "give one of ordinary work, with times")
        for name, value in (("longest_contact", longest_contact), ("alarms_per_day", alarms_per_day)):
            if not (isinstance(cast("object", value), int | float | np.number) and 0 < value < np.inf):
                raise _error(f"{name} = {quoted(value)}", "give a positive number")
        if not (calibration.floor > 0).all():
            raise _error("the fit is of readings without noise", "fit readings of a sensor")
        self.calibration = calibration.without_recording_specific
        self.dt = recording.dt
        program = _program(self.calibration, self.dt, longest_contact, drift, alarms_per_day)
        self.program = _in_noise(program, self.calibration, recording)
        self.restart()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The signals of a sample, in order, SI."""
        return self.program.fitted.inputs

    def restart(self) -> None:
        """Forget all samples: the next is the first, with a zero of its own. A changed tool needs a new fit."""
        self._model, self._filters = _RunningModel(self.program.fitted), _Filters(self.program)
        self._rows = _Rows(self.program)
        self.samples = 0
        self._change: Change | None = None

    # ---------------------------------------------------------------------------------------- samples

    def update(self, motion: Mapping[str, float] | ArrayLike, reading: ArrayLike) -> Array:
        """Take one sample, and give the contact wrench (p,), N and N m, with the bias as it is followed.

        `motion` are the signals by name, or in the order of `inputs`; `reading` (p,) is in the channels' units. A
        sample with a number that is not finite is a gap: the contact is NaN. Raises InputError for other shapes.
        """
        u, y = self._given(motion), np.array(reading, dtype=float)
        channels = self.calibration.model.channels
        if u.shape != (len(self.inputs),) or y.shape != (len(channels),):
            remedy = f"give {', '.join(self.inputs)}, and {', '.join(channels)}"
            raise _error(f"a sample of {u.size} signals and {y.size} readings", remedy)
        self.samples += 1
        if not (np.isfinite(u).all() and np.isfinite(y).all()):
            self._model.restart()
            self._rows.gap()
            return np.full(len(y), np.nan)
        residual, slopes = self._model.run(u[:, None], y[:, None])
        contact = self._model.inverse @ (residual[0] - self._filters.bias[0])
        self._take(residual, slopes)
        return np.asarray(contact)

    def _given(self, motion: Mapping[str, float] | ArrayLike) -> Array:
        if not isinstance(motion, Mapping):
            return np.array(motion, dtype=float)
        missing = [name for name in self.inputs if name not in motion]
        if missing:
            raise _error(f"a sample without {', '.join(missing)}", f"give {', '.join(self.inputs)}")
        return np.array([motion[name] for name in self.inputs], dtype=float)

    def watch(self, recording: Recording) -> Monitor:
        """Take all samples of a recording, as if they followed those so far; the monitor itself.

        Raises InputError for another sampling interval, other channels, or a signal that is missing.
        """
        u, y = _series(self.program.fitted, self.calibration.model, recording, self.dt)
        for first in range(0, y.shape[1], self.program.block):
            rows = slice(first, first + self.program.block)
            self.samples += y[:, rows].shape[1]
            self._take(*self._model.run(u[:, rows], y[:, rows]))
        return self

    def _take(self, residual: Array, slopes: Array) -> None:
        """Residuals (n, p) and derivatives (n, p, k), whitened into blocks, and those taken that are full."""
        self._rows.add(residual, slopes)
        for block in self._rows.blocks():
            self._filters.absorb(block, self.samples - self._rows.waiting)
            if self._change is None and self._filters.level >= self.program.threshold:
                self._change = self._stated()

    # ----------------------------------------------------------------------------------------- results

    @property
    def time(self) -> float:
        """Seconds since the start: samples times the sampling interval."""
        return self.samples * self.dt

    @property
    def bias(self) -> Mapping[str, Estimate]:
        """The zero of each channel now, with std; held while something departs."""
        return self._estimates(0, range(len(self.program.walk)))

    @property
    def drift(self) -> Mapping[str, Estimate]:
        """By how much the zero of each channel moved since the monitor's second block, with the std of both."""
        (now, std), (start, before) = self._filters.bias, self._filters.first
        values = zip(self.calibration.model.biases, now - start, np.hypot(std, before), strict=True)
        return {p.name: Estimate(p.name, float(change), float(s), p.unit) for p, change, s in values}

    @property
    def tool(self) -> Mapping[str, Estimate]:
        """The rigid tool as the last blocks have it (mass, first moment, inertia), with std."""
        group = self.program.groups.index(TOOL[0])
        return self._estimates(group + 1, self.program.members[group])

    def _estimates(self, number: int, places: Sequence[int]) -> dict[str, Estimate]:
        fitted, (value, std) = self.program.fitted, self._filters.estimate(number)
        chosen = [(fitted.parameters[i], value[i], std[i]) for i in places]
        return {p.name: Estimate(p.name, fitted.values[p.name] + float(v), float(s), p.unit) for p, v, s in chosen}

    @property
    def evidence(self) -> Mapping[str, float]:
        """Log evidence of a change of each group, as it counts: by no more than 1 a block, not below 0."""
        return dict(zip(self.program.groups, np.maximum(self._filters.evidence, 0.0).tolist(), strict=True))

    @property
    def change(self) -> Change | None:
        """What changed; None as long as the model is still valid."""
        return self._change

    def __str__(self) -> str:
        """One line: still valid, or what changed and when; or that there was no whole block of readings yet."""
        if not self._filters.blocks:
            return "no whole block of readings yet"
        return "still valid" if self._change is None else str(self._change)

    def _stated(self) -> Change:
        program, filters, odds = self.program, self._filters, self._filters.odds
        best = int(np.argmax(odds))
        changes, covariance, share, (start, end) = filters.changed(best)
        explains = share >= LEAST_SHARE and (program.groups[best] not in TOOL or self._is_a_body(changes, covariance))
        near = [name for name, value in zip(program.groups, odds, strict=True) if value > odds[best] - program.doubt]
        spread = np.sqrt(np.diag(covariance))
        chosen = [(program.fitted.parameters[i], float(changes[i]), float(spread[i])) for i in program.members[best]]
        return Change(
            start=start * self.dt,
            end=end * self.dt,
            stated=filters.samples * self.dt,
            group=program.groups[best] if explains else "",
            others=tuple(name for name in near if name != program.groups[best] or not explains),
            by={p.name: Estimate(p.name, change, std, p.unit) for p, change, std in chosen if explains},
            limit=program.contact_blocks * program.block * self.dt,
        )

    def _is_a_body(self, changes: Array, covariance: Array) -> bool:
        """Whether the tool may be one, with these changes (k,): the pseudo-inertia has no eigenvalue below 0."""
        inertia, fitted = pseudo_inertia(self.calibration.model.base), self.program.fitted
        places = [[p.name for p in fitted.parameters].index(name) for name in inertia.names]
        theta = np.array([fitted.values[name] for name in inertia.names]) + changes[places]
        smallest, vectors = np.linalg.eigh(inertia.at(theta))
        gradient = inertia.slopes @ vectors[:, 0] @ vectors[:, 0]
        std = np.sqrt(gradient @ covariance[np.ix_(places, places)] @ gradient)
        return bool(smallest[0] > -normal_isf(LEVELS.constraint) * std)


def _error(what: str, remedy: str) -> InputError:
    return InputError(what=what, where="monitor", remedy=remedy)


# --------------------------------------------------------------------------------------- of samples


class _RunningModel:
    """Residuals and derivatives of a fitted model, sample by sample; `inverse` (p, p) from residual to contact."""

    def __init__(self, fitted: FittedModel) -> None:
        model, program = fitted.model, fitted.program
        u, y = ca.SX.sym("u", len(fitted.inputs)), ca.SX.sym("reading", fitted.size)
        state = ca.SX.sym("state", state_size(program))
        values = dict(zip(signals(*fitted.inputs), ca.vertsplit(u), strict=True))
        values |= {p.symbol: ca.SX(fitted.values[p.name]) for p in fitted.parameters}
        sample, derivative = CasadiSample.of(program, values, y, state), fitted.sensitivity
        assert derivative is not None
        slopes = ca.vertcat(*casadi_results(derivative.shared, values))
        results = [sample.next_state, sample.measured - sample.prediction, slopes]
        self._function = ca.Function("sample", [state, u, y], [ca.densify(result) for result in results])
        self._shape = fitted.size, len(fitted.parameters)
        self._runs: dict[int, Any] = {1: self._function}
        self.inverse = np.linalg.inv(contact_gain_at(model, fitted.theta)[0])
        self.restart()

    def restart(self) -> None:
        """The next sample is the first."""
        self._state = np.zeros(self._function.size1_in(0))

    def run(self, u: Array, readings: Array) -> tuple[Array, Array]:
        """Residuals (n, p) and derivatives (n, p, k) of signals (m, n) and readings (p, n), the next samples."""
        count = readings.shape[1]
        if count not in self._runs:
            self._runs[count] = self._function.mapaccum(count)
        states, residual, slopes = (np.asarray(x) for x in self._runs[count](self._state, u, readings))
        self._state = states[:, -1]
        return residual.T.copy(), slopes.T.reshape(count, *self._shape)


class _Rows:
    """Whitened rows (n, p, k + 1) of derivatives and residuals, from samples as they come."""

    def __init__(self, program: MonitorProgram) -> None:
        self._program, self._raw, self._white = program, list[tuple[Array, Array]](), list[Array]()
        self._history = program.noise.order + program.lag
        self._new, self.waiting = -self._history, 0

    def add(self, residual: Array, slopes: Array) -> None:
        """Residuals (n, p) and derivatives (n, p, k) of the next samples."""
        self._raw.append((residual, slopes))
        self._new += len(residual)
        self.waiting += max(0, min(self._new, len(residual)))
        if self.waiting >= self._program.block:
            self._whiten()

    def gap(self) -> None:
        """The next sample does not follow the last."""
        self._whiten()
        self._raw, self._new = [], -self._history

    def _whiten(self) -> None:
        if self._new <= 0:
            return
        noise, lag = self._program.noise, self._program.lag
        residual, slopes = (np.concatenate(parts) for parts in zip(*self._raw, strict=True))
        series = [(slopes[: len(slopes) - lag] * self._program.units).transpose(2, 1, 0), residual[lag:].T[None]]
        self._white.append(noise.whitened_chunk(np.concatenate(series), noise.order).transpose(2, 1, 0))
        self._raw = [(residual[-self._history or len(residual) :], slopes[-self._history or len(slopes) :])]
        self._new = 0

    def blocks(self) -> Iterator[Array]:
        """The blocks that are full, as the R factors (k, k + 1) of their rows; they are taken away."""
        count = self._program.block
        while self.waiting >= count:
            self._whiten()
            rows = np.concatenate(self._white)
            self._white, self.waiting = [rows[count:]], self.waiting - count
            yield _square(rows[:count].reshape(-1, rows.shape[2]))


def _triangle(rows: Array) -> Array:
    """The R factor (m, m) of rows (n, m), whatever n."""
    short = rows.shape[1] - len(rows)
    return np.asarray(np.linalg.qr(np.pad(rows, ((0, short), (0, 0))) if short > 0 else rows, mode="r"))


def _step(block: Array, deviation: Array, size: int) -> float:
    """Chi-square of a step of the `size` biases in the R factor of a block, given the deviations (k,)."""
    basis = np.linalg.qr(block[:, :size])[0]
    return float(np.sum((basis.T @ (block[:, -1] - block[:, :-1] @ deviation)) ** 2))


def _square(rows: Array) -> Array:
    """The R factor of rows (n, k + 1) without its last row, the residual: (k, k + 1)."""
    return _triangle(rows)[:-1]


# ----------------------------------------------------------------------------------------- of blocks


class _Filters:
    """The filters, (J + 1, k, k + 1), and what the blocks so far say of each group.

    evidence  (J,) logarithms that count, capped; `odds` those that are not
    began     (J,) the sample since which the log likelihood of a group has not fallen by more than `least_fall`; `fall`
              (J,) is how much, and `reference` filter 0 as it was then
    clear     (J,) the last blocks in which the evidence was above half of the threshold; `recent` has them
    bias      deviation of the zero of the channels from the fit, with std (p,); `first` is that after the first blocks
    """

    def __init__(self, program: MonitorProgram) -> None:
        size, count = len(program.units), len(program.groups)
        self.program, self.blocks, self.samples = program, 0, 0
        self.states = np.concatenate([program.priors, np.zeros((count + 1, size, 1))], axis=2)
        self.evidence, self.odds = np.zeros(count), np.zeros(count)
        self.began = np.zeros(count, dtype=np.intp)
        self.statistic, self.log, self.recent = 0.0, 0.0, deque[tuple[int, Array]](maxlen=MEMORY)
        self.clear = np.zeros(count, dtype=np.intp)
        self.bias = self.first = np.zeros(len(program.walk)), UNKNOWN * program.units[: len(program.walk)]
        self.fall, self.reference = np.zeros(count), [self.states[0]] * count

    @property
    def level(self) -> float:
        """Log of the mean evidence over the groups."""
        return float(np.logaddexp.reduce(self.evidence) - np.log(len(self.evidence)))

    def changed(self, group: int) -> tuple[Array, Array, float, tuple[int, int]]:
        """Deviations (k,) from the fit by the clear blocks of a group, their covariance, the share explained, and when.

        Filter 0 is taken as it was before the excursion, and a bias deviates from its value then; the covariance has
        that of the fit, or of this value, in it. The share is of the chi-square of a step of the bias, above its
        expectation, summed over these blocks; all of it where no more than as much as noise is left. The change is
        between two samples: at the beginnings of blocks with odds of up to 20 against the likeliest, or a block off.
        """
        program, size, reference = self.program, len(self.program.walk), self.reference[group]
        began = min(int(self.began[group]), self.samples - 1)
        ends, blocks = zip(*((end, block) for end, block in self.recent if end > began), strict=True)
        clear = blocks[-max(1, int(self.clear[group])) :]
        biases = 0 if program.members[group][0] == 0 else size  # those that filter 0 learned may have given way
        rows = [self._unknowing(group, reference, biases), *(self._ordered(group, block) for block in clear)]
        value, covariance = self._solved(group + 1, _square(np.vstack(rows)))
        before, spread = self._solved(0, reference)
        left, departed = (sum(_step(block, x, size) - size for block in clear) for x in (value, before))
        share = 1.0 if left <= len(clear) * size else 1.0 - left / max(departed, left)
        squares = [[float(np.sum((b[:, -1] - b[:, :-1] @ x) ** 2)) for b in blocks] for x in (value, before)]
        since = (
            np.cumsum((np.array(squares[1]) - squares[0])[::-1])[::-1] / 2
        )  # log likelihood of a change from each on
        possible = [ends[i] for i in np.flatnonzero(since >= since.max() - program.doubt)]
        inverse = np.linalg.inv(program.priors[0])
        of_fit = inverse @ inverse.T
        of_fit[:size], of_fit[:, :size], of_fit[:size, :size] = 0.0, 0.0, spread[:size, :size]
        value[:size] -= before[:size]
        changes, covariance = value * program.units, (covariance + of_fit) * np.outer(program.units, program.units)
        return changes, covariance, share, (max(0, possible[0] - 2 * program.block), possible[-1])

    def _solved(self, number: int, state: Array) -> tuple[Array, Array]:
        """Deviations (k,) by a state of a filter, and their covariance (k, k), in units."""
        order = self.program.orders[number]
        inverse = np.linalg.inv(state[:, :-1])[np.argsort(order)]
        return inverse @ state[:, -1], inverse @ inverse.T

    def estimate(self, number: int) -> tuple[Array, Array]:
        """Deviations (k,) of the parameters from the fit, by one filter, and their std, in their units."""
        value, covariance = self._solved(number, self.states[number])
        return value * self.program.units, np.sqrt(np.diag(covariance)) * self.program.units

    def absorb(self, block: Array, samples: int) -> None:
        """Take the R factor (k, k + 1) of a block that ended at that sample."""
        program, size = self.program, len(self.program.walk)
        before = [self._aged(number) for number in range(len(self.states))]
        logs, after = np.zeros(len(before)), []
        for number, state in enumerate(before):
            merged = _triangle(np.vstack([state, block if number == 0 else self._ordered(number - 1, block)]))
            ratios = np.diag(state) / np.diag(merged)[:-1]
            logs[number] = np.log(np.abs(ratios)).sum() - 0.5 * merged[-1, -1] ** 2
            after.append(merged[:-1])
            if number == 0:  # the same with a bias that stepped by any amount
                free = _triangle(np.vstack([state[size:], block]))
                self.statistic = float(merged[-1, -1] ** 2 - free[-1, -1] ** 2)
        self.log, departs = float(logs[0]), self.statistic > program.gate
        for group in np.flatnonzero(departs & (self.odds < program.doubt)).tolist():
            after[group + 1] = _square(np.vstack([self._unknowing(group, before[0]), self._ordered(group, block)]))
        held = departs or self.evidence.max(initial=0.0) > program.cap * program.contact_blocks
        self.states = np.stack([before[0] if held else after[0], *after[1:]])
        self.recent.append((samples, block))
        self.blocks, self.samples = self.blocks + 1, samples
        value, std = self.estimate(0)
        self.bias = value[:size], std[:size]
        if self.blocks <= FIRST_BLOCKS:
            self.first = self.bias
        for group, gain in enumerate((logs[1:] - logs[0]).tolist()):
            self._count(group, gain)
            self.clear[group] = self.clear[group] + 1 if self.evidence[group] > 0.5 * program.threshold else 0

    def _count(self, group: int, gain: float) -> None:
        """Count the log likelihood ratio of a block for a group."""
        program = self.program
        if gain < program.refuted:
            self.states[group + 1] = _square(self._ordered(group, self.states[0]))
            self.evidence[group] = self.odds[group] = 0.0
            self._begin(group)
            return
        self.evidence[group] = max(self.evidence[group], 0.0) + min(gain, program.cap)
        self.odds[group] = max(self.odds[group], 0.0) + gain
        self.fall[group] -= gain
        if self.fall[group] > program.least_fall:
            self._begin(group)

    def _begin(self, group: int) -> None:
        """Nothing of a group's excursion is before this block's end."""
        self.began[group], self.fall[group], self.reference[group] = self.samples, 0.0, self.states[0].copy()

    def _ordered(self, group: int, rows: Array) -> Array:
        """Rows (n, k + 1) with the parameters in the order of a group's filter."""
        return np.asarray(rows[:, [*self.program.orders[group + 1], -1]])

    def _unknowing(self, group: int, state: Array, biases: int = 0) -> Array:
        """A state of filter 0 in the order of a group's filter; the group, and so many biases, may be anything."""
        ordered = _square(self._ordered(group, state))
        ordered[: len(self.program.members[group]) + biases] /= UNKNOWN
        return ordered

    def _aged(self, number: int) -> Array:
        """A filter before the next block: its rows forget, the fit's return, and the biases have walked."""
        program, order = self.program, self.program.orders[number]
        size, width = len(program.walk), len(order) + 1
        places = program.places[number]
        state = self.states[number] * program.factors[number][:, None]
        rows = np.zeros((size + 2 * len(order), size + width))
        rows[:size, :size] = np.diag(1 / program.walk)
        rows[size : size + len(order), :size], rows[size : size + len(order), size:] = -state[:, places], state
        rows[size + len(order) :, size:-1] = program.pull * program.priors[number]
        return _triangle(rows)[size:-1, size:]


# ------------------------------------------------------------------------------------------ of a fit


def _groups(fitted: FittedModel, model: WrenchModel) -> list[tuple[str, list[int]]]:
    """Groups of parameters that may change together, with their places."""
    names = [p.name for p in fitted.parameters]
    tool = [p.name for p in inertial_parameters(model.space)] + [n for n in names if n.startswith("com_offset.")]
    groups = {
        "bias": [p.name for p in model.biases],
        TOOL[0]: tool,
        TOOL[1]: [name for name in tool if name != "m"],
        **{
            e.id: [p.name for p in e.qualified(model.space) if not p.nuisance]
            for e in model.effects
            if e.id != "com_offset"
        },
    }
    return [(group, [names.index(n) for n in of if n in names]) for group, of in groups.items() if set(of) & set(names)]


def _program(
    calibration: CalibratedModel, dt: float, longest_contact: float, drift: Mapping[str, float] | None, alarms: float
) -> MonitorProgram:
    """The program of a monitor in white noise of the calibration's std."""
    model, size = calibration.model, len(calibration.floor)
    fitted = FittedModel.of(model, calibration.theta, dt)
    if fitted.sensitivity is None:
        what = "the tool deflects, or is too long a formula, and has no derivative"
        raise _error(what, "fit a model without tip_flexibility")
    block = max(1, round(longest_contact / BLOCKS_PER_CONTACT / dt))
    seconds = block * dt
    units, prior = _prior(fitted, calibration)
    groups = [(name, places) for name, places in _groups(fitted, model) if units[places].any()]
    orders, priors = [np.arange(len(units))], [prior]
    factors = [np.full(len(units), 1 - 1 / MEMORY)]
    for _, places in groups:
        orders.append(np.array([*places, *(i for i in range(len(units)) if i not in places)]))
        wide = np.zeros(len(units))
        wide[places] = UNKNOWN**2
        priors.append(prior + np.diag(wide))
        factors.append(np.where(np.arange(len(units)) < len(places), 1 - 1 / SHORT_MEMORY, 1 - 1 / MEMORY))
    walks = _drift(calibration, drift) * np.sqrt(seconds / HOUR) / units[:size]
    return MonitorProgram(
        fitted=fitted,
        units=units,
        noise=NoiseModel.white(calibration.floor),
        lag=fitted.program.latency + max(0, round(group_delay(model, calibration.theta) / dt)),
        block=block,
        groups=tuple(name for name, _ in groups),
        members=tuple(tuple(places) for _, places in groups),
        orders=np.stack(orders),
        priors=np.stack([_information(p[np.ix_(order, order)]) for p, order in zip(priors, orders, strict=True)]),
        factors=np.sqrt(factors),
        pull=float(np.sqrt(1 / MEMORY)),
        walk=walks,
        gate=float(chi2_isf(GATE, float(size))),
        unknown=UNKNOWN,
        cap=CAP,
        refuted=float(np.log(REFUTED)),
        doubt=float(np.log(ODDS)),
        least_fall=LEAST_FALL,
        threshold=float(np.log(max(1.0, SECONDS_PER_DAY / seconds / alarms))) + CAP * BLOCKS_PER_CONTACT,
        contact_blocks=BLOCKS_PER_CONTACT,
        first_blocks=FIRST_BLOCKS,
    )


def _drift(calibration: CalibratedModel, drift: Mapping[str, float] | None) -> Array:
    """Std (p,) by which the zero of each channel walks in an hour, in its unit."""
    stated, channels = {} if drift is None else drift, calibration.model.channels
    if not isinstance(cast("object", stated), Mapping):
        raise _error(f"{kind_of(stated)} is no drift by channel", f"give positive numbers for {', '.join(channels)}")
    wrong = [
        n
        for n, v in stated.items()
        if n not in channels or not (isinstance(cast("object", v), int | float | np.number) and 0 < v < np.inf)
    ]
    if wrong:
        raise _error(f"no drift of {quoted(wrong[0])}", f"give positive numbers for {', '.join(channels)}")
    return np.array([stated.get(name, std) for name, std in zip(channels, calibration.floor, strict=True)], dtype=float)


def _prior(fitted: FittedModel, calibration: CalibratedModel) -> tuple[Array, Array]:
    """Units (k,) of the parameters, and their covariance (k, k) before the first sample, in units.

    The unit is the std of the fit, of a bias the noise of a sample, of what the fit does not know its value, at least
    1; of what is fixed, or a sample does not show, 0. The zero is that of another session.
    """
    place = {p.name: i for i, p in enumerate(calibration.model.parameters)}
    index = [place[p.name] for p in fitted.parameters]
    covariance, theta = calibration.covariance[np.ix_(index, index)], calibration.theta[index]
    variance, size = np.diag(covariance), len(calibration.floor)
    units = np.where(np.isfinite(variance), np.sqrt(np.maximum(variance, 0.0)), np.maximum(np.abs(theta), 1.0))
    units[:size] = calibration.floor
    assert fitted.sensitivity is not None
    units[[not any(fitted.sensitivity.results[i :: len(units)]) for i in range(len(units))]] = 0.0
    known = np.isfinite(variance) & (units > 0)
    known[:size] = False
    prior = np.eye(len(units))
    scaled = covariance[np.ix_(known, known)] / np.outer(units[known], units[known])
    prior[np.ix_(known, known)] = scaled + SMALLEST_CORRELATION * np.eye(int(known.sum()))
    prior[np.arange(size), np.arange(size)] = UNKNOWN**2
    return units, prior


def _information(covariance: Array) -> Array:
    """R (k, k), upper triangular, with R'R the inverse of a covariance."""
    return np.asarray(np.linalg.qr(np.linalg.inv(np.linalg.cholesky(covariance)), mode="r"))


def _series(fitted: FittedModel, model: WrenchModel, recording: Recording, dt: float) -> tuple[Array, Array]:
    """Signals (m, n) and readings (p, n) of a recording."""
    require_recording(recording, "monitor")
    recording = prepared(recording, model)
    if recording.dt is None or abs(recording.dt / dt - 1) > RATE_TOLERANCE:
        what = "poses at rest" if recording.dt is None else f"{1 / recording.dt:.6g} samples a second"
        raise _error(f"{recording.name} has {what}", f"give one of {1 / dt:.6g} samples a second")
    missing = [name for name in fitted.inputs if name not in recording.signals]
    if missing:
        raise _error(f"{recording.name} has no {', '.join(missing)}", "give a recording with all signals of the model")
    return np.stack([recording.signals[name] for name in fitted.inputs]), recording.wrench.T


def _in_noise(program: MonitorProgram, calibration: CalibratedModel, recording: Recording) -> MonitorProgram:
    """A program in the noise of ordinary work: the residual's autoregression, and what its blocks show beyond it.

    Between blocks the zero walks by at least the stated drift, by as much more as is likeliest, and by so much that the
    evidence of a change in this ordinary work is what it has with a probability of at most 5 % where nothing changed.
    """
    u, y = _series(program.fitted, calibration.model, recording, recording.dt or 1.0)
    settled, running, block = program.fitted.program.settling, _RunningModel(program.fitted), program.block
    parts = [running.run(u[:, i : i + block], y[:, i : i + block]) for i in range(0, y.shape[1], block)]
    residual, slopes = (np.concatenate(series) for series in zip(*parts, strict=True))
    free = compensate(calibration, recording).detection.free
    residual, slopes, free = residual[settled:], slopes[settled:], free[settled:]
    noise = fit_autoregression(residual - residual[free].mean(axis=0), free)
    rows, edges = _Rows(replace(program, noise=noise)), np.flatnonzero(np.diff(free, prepend=False, append=False))
    for first, last in edges.reshape(-1, 2).tolist():
        rows.add(residual[first:last], slopes[first:last])
        rows.gap()
    blocks = list(rows.blocks())[:MOST_BLOCKS]
    if len(blocks) < FIRST_BLOCKS + FEWEST_BLOCKS:
        seconds = block * (recording.dt or 1.0)
        needed = (FIRST_BLOCKS + FEWEST_BLOCKS + 1) * seconds
        remedy = f"give at least {needed:.3g} s without contact, or, in Python, a shorter longest_contact"
        raise _error(f"{recording.name} is too short for the noise of blocks of {seconds:.3g} s", remedy)
    walks = [program.walk * factor for factor in WALKS]
    scales, likelihoods = zip(*(_of_blocks(replace(program, walk=walk), blocks) for walk in walks), strict=True)
    for choice in range(int(np.argmax(likelihoods)), len(walks)):  # the first to take it as ordinary
        filters, highest = _Filters(replace(program, walk=walks[choice])), 0.0
        for full in blocks:
            filters.absorb(full / np.sqrt(scales[choice]), 0)
            highest = max(highest, filters.level)
        if highest < np.log(ODDS * len(blocks)):
            break
    return replace(program, noise=replace(noise, covariance=noise.covariance * scales[choice]), walk=walks[choice])


def _of_blocks(program: MonitorProgram, blocks: Sequence[Array]) -> tuple[float, float]:
    """Scale of the variance in blocks without contact, and their log likelihood with it, by filter 0."""
    alone = {name: getattr(program, name)[:1] for name in ("orders", "priors", "factors")}
    program = replace(program, groups=(), members=(), gate=np.inf, **alone)

    def run(scale: float) -> Array:
        filters, found = _Filters(program), []
        for block in blocks:
            filters.absorb(block / np.sqrt(scale), 0)
            found.append((filters.statistic, filters.log))
        return np.array(found[FIRST_BLOCKS:]).T

    scale = max(1.0, float(np.median(run(1.0)[0]) / chi2_isf(0.5, float(len(program.walk)))))
    logs = run(scale)[1]
    return scale, float(logs.sum() - 0.5 * len(logs) * np.count_nonzero(program.units) * np.log(scale))
