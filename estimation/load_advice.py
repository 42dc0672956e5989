"""Which known load to hang next, and with which of the recorded motions: D-optimal among the loads that one has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit, as_reported
from estimation.least_squares.levenberg_marquardt import NEGLIGIBLE_COLUMN_LENGTH
from estimation.least_squares.problem import Problem, RecordingInNoise, Solution
from estimation.model_response import predicted_readings
from estimation.parameter_layout import ParameterLayout, parameter_layout
from estimation.pose_advice import PRIOR_INFORMATION_SHARE, stacked_svd
from estimation.recordings.recording import Recording
from modeling.errors import InputError, kind_of, quoted
from modeling.identifiability import ScaledSVD
from modeling.number_format import NOT_IDENTIFIABLE
from modeling.rigid_body import LOAD_REMEDY, Load, inertial_parameters
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LoadedMotion:
    """A recorded motion once more, with a load in place of the known ones.

    load        what the sensor carries beside the tool; None for what it did
    number      of the recording whose motion it is
    open        combinations of parameters that stay unidentifiable with it, and would not with others that are offered
    gain        of the logarithm of the determinant of the information, over all that the offered ones tell
    overloaded  channel whose stated range the readings would exceed; empty where there is none
    """

    load: Load | None
    number: int
    open: int
    gain: float
    overloaded: str = ""


@dataclass(frozen=True, eq=False)
class LoadAdvice(Tabular):
    r"""Which known load to hang next, and with which of the recorded motions.

    `of` gives it for a fit and the loads that one has.

    Parameters
    ----------
    fit : Fit
        The fit; the loads tell what is in its model, such as `gain` and `sensor_crosstalk`.
    offered : tuple of LoadedMotion
        Each load with each recorded motion, and each of the motions once more as it was.
    chosen : tuple of int
        Indices in `offered` of what to record, one after the other, until these loads tell no further parameters; of
        the most informative one if they tell none that are open.
    never : tuple of str
        Parameters that are not identifiable with any of the loads.
    before, after : mapping of str to float
        Std of every unknown, in its unit, in the fit and expected with what is chosen, the errors of the loads
        included; infinite where not identifiable.

    Examples
    --------
    >>> import truewrench as tw
    >>> fit = tw.fit(tw.planar() + "gain", tw.read("train.csv", rig="rig.toml"))
    >>> advice = tw.LoadAdvice.of(fit, ["0.5+-0.001@0.05", "1.0+-0.001@0.05"])
    >>> [str(motion.load) for motion in advice.recommended]
    ['1±0.001 kg at (0.05) m']
    """

    fit: Fit
    offered: tuple[LoadedMotion, ...]
    chosen: tuple[int, ...]
    never: tuple[str, ...]
    before: Mapping[str, float]
    after: Mapping[str, float]

    @classmethod
    def of(cls, fit: Fit, loads: Load | str | Iterable[Load | str]) -> LoadAdvice:
        """Advice of loads, each a `Load` or MASS@X,Y,Z, at the noise and the zero of the recorded motions.

        A loaded motion is expected to be as noisy as it was, and has a zero of its own. With J its whitened
        sensitivity and C the change of the whitened readings by one std of each load's mass and coordinates, the
        estimates have the covariance (sum J'J)^-1 and, of the loads, A A' with A = (sum J'J)^-1 sum J'C, as `budget`
        has it. Motions are chosen one by one, those first that leave the fewest combinations open, each to maximise the
        determinant of the covariance's inverse.
        Raises InputError for no load, one of unknown mass, and where all exceed the range that the rig states.
        """
        given: object = fit
        if not isinstance(given, Fit):
            what = f"{kind_of(fit)} has no recorded motions to carry a load in"
            raise InputError(what=what, where="next load", remedy="give a fit of whole recordings")
        bodies = _offered_loads(loads, fit)
        recordings = [
            (load, number, _expected(fit, number, load))
            for load in (*bodies, None)
            for number in range(len(fit.recordings))
        ]
        information = _Information.of(fit, [recording for _, _, recording in recordings])
        blocks = [information.of_next(number, recording) for _, number, recording in recordings]
        excess = [_overloaded(recording) for _, _, recording in recordings]
        resolved = information.resolved_by([b for b, channel in zip(blocks, excess, strict=True) if not channel])
        now = resolved.amount([])
        offered = tuple(
            LoadedMotion(load, number, resolved.open([block]), resolved.amount([block]) - now, channel)
            for (load, number, _), block, channel in zip(recordings, blocks, excess, strict=True)
        )
        able = [i for i, motion in enumerate(offered) if motion.load is not None and not motion.overloaded]
        if not able:
            what = f"each of the loads exceeds the range of {offered[0].overloaded} that the rig states"
            raise InputError(what=what, where="next load", remedy="give lighter loads, or closer to the sensor")
        chosen: list[int] = []
        while not chosen or resolved.open([blocks[i] for i in chosen]) > resolved.open([blocks[i] for i in able]):
            taken = [blocks[i] for i in chosen]
            worth = {i: (-resolved.open([*taken, blocks[i]]), resolved.amount([*taken, blocks[i]])) for i in able}
            chosen.append(max(able, key=worth.__getitem__))
        after = information.expected([recordings[i] for i in chosen], [blocks[i] for i in chosen])
        told = information.svd([blocks[i] for i in able]).identifiable | information.known
        never = tuple(p.name for p, identifiable in zip(fit.unknowns, told, strict=True) if not identifiable)
        return cls(fit, offered, tuple(chosen), never, information.expected([], []), after)

    @property
    def recommended(self) -> tuple[LoadedMotion, ...]:
        """What to record, in that order."""
        return tuple(self.offered[i] for i in self.chosen)

    @property
    def missing(self) -> tuple[str, ...]:
        """Parameters that are not identifiable now and are with what is chosen."""
        return tuple(n for n, std in self.after.items() if np.isfinite(std) and not np.isfinite(self.before[n]))

    @property
    def open(self) -> int:
        """Combinations of parameters that are open in the fit and that the loads can tell."""
        return max(motion.open for motion in self.offered if motion.load is None)

    def sentences(self) -> list[str]:
        """The advice as sentences."""
        names = [recording.name for recording in self.fit.recordings]
        words = [f"{motion.load} in the motion of {names[motion.number]}" for motion in self.recommended]
        advice = [f"Hang next {words[0]}{''.join(f'; then {other}' for other in words[1:])}."]
        if self.missing:
            combinations = "1 combination" if self.open == 1 else f"{self.open} combinations"
            told = "It tells" if len(words) == 1 else "They tell"
            advice.append(f"{told} {combinations} of {len(self.missing)} parameters that are open.")
        elif self._again.gain >= self.recommended[0].gain:
            advice = ["None of these loads tells more than the same motion once more would."]
        if self.never:
            advice.append(f"Not identifiable with any of these loads: {', '.join(self.never)}.")
        if not any(effect.scales_mass for effect in self.fit.model.effects):
            advice.append(
                "The model takes the scale of the sensor as known: with gain (and sensor_crosstalk) added to it, loads"
                " tell the scale."
            )
        return advice

    @property
    def _again(self) -> LoadedMotion:
        """The most informative motion as it was."""
        return max((m for m in self.offered if m.load is None), key=lambda m: (-m.open, m.gain))

    @property
    def motion_table(self) -> Table:
        """Each load with its best motion, the combinations still open, and its efficiency.

        The efficiency is the root of the ratio of determinants to that of the first, as many times as informative per
        parameter.
        """
        first, rows = self.recommended[0], []
        size, names = len(self.after) - len(self.never), [recording.name for recording in self.fit.recordings]
        for load in dict.fromkeys(motion.load for motion in self.offered):
            motions = [m for m in self.offered if m.load == load]
            best = max(motions, key=lambda m: (not m.overloaded, -m.open, m.gain))
            share = np.exp((best.gain - first.gain) / size) if best.open == first.open else np.nan
            name = "the same again" if load is None else str(load)
            said = names[best.number] if not best.overloaded else f"exceeds the range of {best.overloaded}"
            rows.append((name, said, best.open, None if best.overloaded else float(share)))
        shares = Column("efficiency", format=".0%", unknown="")
        return Table.of(("load", "motion of", "combinations open", shares), rows)

    @property
    def table(self) -> Table:
        """Name, std now, std with what is chosen, and unit of what is identifiable then."""
        stds = (Column(n, format=".2g", unknown=NOT_IDENTIFIABLE) for n in ("std now", "std expected"))
        rows = [
            (p.name, self.before[p.name], self.after[p.name], p.unit)
            for p in self.fit.unknowns
            if np.isfinite(self.after[p.name]) and self.after[p.name] > 0
        ]
        return Table.of(("parameter", *stds, "unit"), rows)

    def printed(self) -> list[Table | str]:
        """Advice, loads, stds."""
        return [*self.sentences(), self.motion_table, self.table]

    def to_data(self) -> dict[str, Any]:
        """As plain data: std are None where not identifiable."""

        def finite(stds: Mapping[str, float]) -> dict[str, float | None]:
            return {name: std if np.isfinite(std) else None for name, std in stds.items()}

        def as_data(motion: LoadedMotion) -> dict[str, Any]:
            load = None if motion.load is None else motion.load.to_data()
            named = {"load": load, "motion_of": self.fit.recordings[motion.number].name}
            return named | {"open": motion.open, "gain": motion.gain, "overloaded": motion.overloaded or None}

        return {
            "record": [as_data(motion) for motion in self.recommended],
            "offered": [as_data(motion) for motion in self.offered],
            "never": [*self.never],
            "std": finite(self.before),
            "std_expected": finite(self.after),
        }


def _offered_loads(loads: Load | str | Iterable[Load | str], fit: Fit) -> tuple[Load, ...]:
    """The loads, each once; InputError for none, and for one that is no known load of the model's space."""
    given = (loads,) if isinstance(loads, Load | str) else tuple(loads)
    bodies = tuple(dict.fromkeys(map(Load.of, given)))
    if not bodies:
        raise InputError(what="there is no load to choose from", where="next load", remedy=LOAD_REMEDY)
    for load in bodies:
        if not load.known:
            what = f"the mass of {quoted(load.name)} is unknown, and tells no scale"
            raise InputError(what=what, where="next load", remedy="state its mass: MASS@X,Y,Z in kg and m")
        load.moments(fit.model.space)  # raises for coordinates of another space
    return bodies


def _expected(fit: Fit, number: int, load: Load | None) -> Recording:
    """A recording again with another known load, with the readings that the fit predicts and its residual."""
    recording = fit.recordings[number]
    carried = recording.loads if load is None else (*(body for body in recording.loads if not body.known), load)
    again = replace(recording.carrying(*carried), name=f"{recording.name} again")
    model, index = fit.layout.models[number], fit.layout.index[number]
    return again.with_readings(predicted_readings(model, again, fit.theta[index]) + fit.residuals[number])


def _overloaded(recording: Recording) -> str:
    """The channel whose readings exceed most the range that the rig states; empty where none does."""
    stated = (recording.rig.sensor.range if recording.rig is not None else None) or {}
    largest = dict(zip(recording.channels, np.abs(recording.wrench).max(axis=0), strict=True))
    excess = {channel: largest[channel] / limit for channel, limit in stated.items() if channel in largest}
    worst = max(excess, key=excess.__getitem__, default="")
    return worst if worst and excess[worst] > 1 else ""


@dataclass(frozen=True, eq=False)
class _Information:
    """Whitened rows of a fit in its unknowns (k) and in the std of the errors (c) of known loads.

    bodies    the loads whose mass or place is uncertain, recorded or offered
    recorded  rows (r, k + c) of the recordings
    known     unknowns (k,) that are fixed or held at a bound
    """

    fit: Fit
    solution: Solution
    bodies: tuple[Load, ...]
    known: NDArray[np.bool_]
    recorded: Array

    @classmethod
    def of(cls, fit: Fit, further: Sequence[Recording]) -> _Information:
        several = (*fit.recordings, *further)
        bodies = tuple(dict.fromkeys(b for r in several for b in r.loads if b.known and (b.mass_std or b.at_std)))
        known = np.array([e.std == 0 or e.name in fit.held for e in fit.parameters.values()])
        empty = cls(fit, fit.ordinary or fit, bodies, known, np.zeros((0, 0)))
        parts = [
            empty._rows(fit.layout, number, each, fit.theta) for number, each in enumerate(empty.solution.problem.data)
        ]
        return replace(empty, recorded=np.asarray(np.linalg.qr(np.concatenate(parts), mode="r")))

    def _rows(self, layout: ParameterLayout, number: int, data: RecordingInNoise, theta: Array) -> Array:
        """Of one recording of a layout, (n, k + c)."""
        alone = replace(layout, models=(layout.models[number],), index=(layout.index[number],))
        rows = Problem(alone, (data,)).linearised(theta).derivative
        space, first = layout.model.space, len(layout.model.biases)
        moments = rows[:, layout.index[number][first : first + len(inertial_parameters(space))]]
        errors = []
        for body in self.bodies:
            slopes = body.slopes(space)
            std = np.array([body.mass_std, *([body.at_std] * (len(slopes) - 1))])
            errors.append(moments @ (std[:, None] * slopes).T * (body in data.recording.loads))
        rows = np.hstack([rows, *errors])
        rows[:, : len(self.known)][:, self.known] = 0.0
        return rows

    def of_next(self, number: int, recording: Recording) -> Array:
        """Of a recording with the motion and the noise of one of the fit's, beside a zero of its own, (r, k + c)."""
        fit, size = self.fit, self.fit.layout.size
        layout = parameter_layout(fit.model, (*fit.recordings, recording))
        theta = np.array([*fit.theta, *fit.theta[fit.layout.index[number][: len(fit.model.biases)]]])
        data = RecordingInNoise(recording, self.solution.noise[number])
        rows = self._rows(layout, len(fit.recordings), data, theta)
        zeros = rows[:, size : layout.size]
        zeros = zeros[:, np.linalg.norm(zeros, axis=0) > 0]  # of a channel that is left out
        others = np.hstack([rows[:, :size], rows[:, layout.size :]])
        count = zeros.shape[1]
        return np.asarray(np.linalg.qr(np.hstack([zeros, others]), mode="r"))[count:, count:]

    def svd(self, blocks: Sequence[Array]) -> ScaledSVD:
        """Scaled SVD of the recordings with further blocks."""
        return stacked_svd([part[:, : len(self.known)] for part in (self.recorded, *blocks)])

    def resolved_by(self, blocks: Sequence[Array]) -> _Resolved:
        """The information over what all these blocks resolve together."""
        everything = self.svd(blocks)
        kept = everything.regular
        axes = everything.right[kept].T / everything.singular[kept] / everything.scale[:, None]
        return _Resolved(self, axes)

    def expected(
        self, chosen: Sequence[tuple[Load | None, int, Recording]], blocks: Sequence[Array]
    ) -> dict[str, float]:
        """Std of every unknown with these recorded too, as a fit and its loads' budget report it."""
        fit, size = self.fit, len(self.known)
        svd = self.svd(blocks)
        std = np.array([estimate.std for estimate in fit.parameters.values()])
        if chosen:
            recordings = [replace(r, name=f"{r.name} {i}") for i, (_, _, r) in enumerate(chosen)]
            noise = [fit.noise[number] for _, number, _ in chosen]
            problem = Problem.of(fit.model, (*fit.recordings, *recordings), (*fit.noise, *noise))
            zeros = [fit.theta[fit.layout.index[number][: len(fit.model.biases)]] for _, number, _ in chosen]
            theta = np.concatenate([fit.theta, *zeros])
            root = problem.information(theta).root.copy()
            root[:, :size][:, self.known] = 0.0
            whole = ScaledSVD.of(root, faint=NEGLIGIBLE_COLUMN_LENGTH)
            augmented = Fit(problem, theta, whole.covariance, whole.identifiable)
            reported = as_reported(augmented, stated=fit.constrained is not None)
            std = np.sqrt(np.diag(reported.covariance)[:size])
        parts = (self.recorded, *blocks)
        mixed = np.sum([part[:, :size].T @ part[:, size:] for part in parts], axis=0)
        shifts = svd.covariance @ mixed
        std = np.where(svd.identifiable, np.sqrt(std**2 + (shifts**2).sum(axis=1)), np.inf)
        std[self.known] = 0.0
        return dict(zip(fit.parameters, std.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class _Resolved:
    """Information over a space of changes of the unknowns, `axes` (k, r)."""

    information: _Information
    axes: Array

    def open(self, blocks: Sequence[Array]) -> int:
        """How many directions of the space the recordings and these blocks leave open."""
        return int(self.axes.shape[1] - self.information.svd(blocks).regular.sum())

    def amount(self, blocks: Sequence[Array]) -> float:
        """ln det of the inverse covariance, the errors of the loads included; `PRIOR_INFORMATION_SHARE` as of poses."""
        parts, size = (self.information.recorded, *blocks), len(self.axes)
        rows = [part[:, :size] @ self.axes for part in parts]
        noise = np.sum([row.T @ row for row in rows], axis=0) + PRIOR_INFORMATION_SHARE * np.eye(self.axes.shape[1])
        mixed = np.sum([row.T @ part[:, size:] for row, part in zip(rows, parts, strict=True)], axis=0)
        errors = np.eye(mixed.shape[1]) + mixed.T @ np.linalg.solve(noise, mixed)
        return float(np.linalg.slogdet(noise)[1] - np.linalg.slogdet(errors)[1])
