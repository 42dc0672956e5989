"""Fit of a model to recordings: whitened nonlinear least squares, with noise re-estimation and constraints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NoReturn, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from estimation.case import Case, prepared
from estimation.least_squares.estimates import (
    Estimate,
    Estimates,
    NamedEstimates,
    require_positive_mass,
    unknown_attribute,
)
from estimation.least_squares.problem import LinearisedRows, Problem, Solution
from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.model_response import ModelResponse, model_response, predicted_readings, with_loads
from estimation.noise.recording_noise import RecordingNoise, repeat_noise_floor, sample_step
from estimation.parameter_layout import ParameterLayout, parameter_layout, require_known_start
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, require_model
from modeling.errors import InputError, kind_of, quoted, suggestion
from modeling.noise import NoiseModel, NoiseSource
from modeling.parameter import Role
from modeling.rigid_body import Load, inertial_parameters
from modeling.significance import LEVELS
from modeling.space import Space
from modeling.table import Table

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import pandas as pd

    from estimation.confidence_intervals import Intervals
    from estimation.least_squares.constrained_minimum import ConstrainedMinimum
    from estimation.least_squares.constraints import Constraints, StatedConstraints
    from estimation.streaming.chunk_information import RecordingOrChunk
    from estimation.streaming.streamed_fit import StreamedFit

Array = NDArray[np.float64]
Loads: TypeAlias = Mapping[str, "Load | str | Iterable[Load | str]"]
"""What recordings carried, by their names: a load, or several (`Load.of`)."""

MAX_NOISE_ROUNDS = 4
"""Fits, each in the noise that the residual of the last one shows."""


@dataclass(frozen=True, eq=False)
class ToolEstimates(NamedEstimates):
    """The parameters of one of several tools, under the model's names, with the biases of a recording of it."""

    name: str
    model: WrenchModel
    parameters: Mapping[str, Estimate]
    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Fit(Solution, Estimates):
    """A model's parameters estimated from recordings in their noise.

    constrained the minimum within constraints, None without any
    ordinary    the least squares that theta comes from, with their own covariance, where the std is told in a colour
                of the noise that the weights do not have
    """

    constrained: ConstrainedMinimum | None = None
    ordinary: Solution | None = None

    @property
    def onset_resolution(self) -> float:  # type: ignore[override]
        """Sampling step, s, the largest of the recordings'."""
        return max(sample_step(recording) for recording in self.recordings)

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the parameters that a bound holds, of their effect or of the constraints."""
        if self.constrained is None:
            return super().held
        bounds = self.constrained.optimality.active_set
        return tuple(p.name for p, held in zip(self.unknowns, bounds.low | bounds.high, strict=True) if held)

    def refitted(self, model: WrenchModel, start: Mapping[str, float] | None = None, *, far: float = np.inf) -> Fit:
        """Another model fitted to the same recordings in the same noise, from these estimates or `start`; `far` as in
        `solved`."""
        return solved(self.problem.of_model(model), self.values if start is None else start, far=far)

    def in_noise(self, noise: Sequence[RecordingNoise], *, constraints: Constraints | None = None) -> Fit:
        """The same model fitted to the same recordings in other noise, from these estimates."""
        return solved(self.problem.in_noise(noise), self.values, constraints=constraints)

    def is_in_noise_of(self, other: Fit) -> bool:
        """Whether another fit is to the same recordings in the same noise, so that their chi-squares compare."""
        return self.problem.data is other.problem.data

    def identifies(self, effect: Effect) -> bool:
        """Whether an amplitude of one of its model's effects is identifiable."""
        parameters = effect.qualified(self.model.space)
        return any(np.isfinite(self.parameters[p.name].std) for p in parameters if not p.nuisance)

    def linearised(self) -> LinearisedRows:
        """Whitened residual and derivative at the estimate."""
        return self.problem.linearised(self.theta)

    def whitened_residual(self) -> Array:
        """Whitened residual at the estimate, (rows,) of all recordings, one after the other."""
        return self.problem.residual(self.theta)

    def remarks(self) -> list[str]:
        """Remarks on the estimate, and whether a body can have it."""
        from estimation.least_squares.physical_consistency import impossible_body  # SymPy

        names, held = [p.name for p in self.unknowns], set(self.held)
        free = [direction for direction in self.unidentifiable if held.isdisjoint(direction.names)]
        tools = ("", *self.layout.other_tools)
        bodies = (impossible_body(self.model, names, self.theta, self.covariance, free, tool) for tool in tools)
        return [*super().remarks(), *filter(None, bodies), *self._event_remarks()]

    def of_tool(self, name: str) -> ToolEstimates:
        """The estimates of the tool with an unknown load, by the model's names; InputError for another name."""
        number = next((i for i, recording in enumerate(self.recordings) if recording.tool == name), None)
        if number is None:
            remedy = suggestion(name, self.layout.other_tools)
            raise InputError(what=f"no recording carried {quoted(name)}", where="tool", remedy=remedy)
        index = self.layout.index[number]
        model = self.layout.models[number]
        parameters = {
            p.name: replace(self.parameters[self.unknowns[i].name], name=p.name)
            for p, i in zip(model.parameters, index, strict=True)
        }
        within = np.ix_(index, index)
        return ToolEstimates(
            name, model, parameters, self.theta[index], self.covariance[within], self.identifiable[index]
        )

    def _event_remarks(self) -> Iterator[str]:
        """What is said of the events of the recordings whose wrench is not constant."""
        pushed = sum(p.role is Role.ONSET for p in self.unknowns) > 1
        for recording, noise in zip(self.recordings, self.noise, strict=True):
            for shape in noise.shapes:
                when = f"from {shape.edges[0]:.3g} to {shape.edges[-1]:.3g} s of {recording.name}"
                if shape.judged and pushed:
                    yield f"the contact {when} is not constant: its wrench is the mean over that time"
                else:
                    yield f"what happened {when}, and does not repeat, is left out"

    def printed(self) -> list[Table | str]:
        """Table, remarks, and how far the residual is above the noise: stds of a model that does not fit mislead."""
        return [*super().printed(), self._chi_square_remark()]

    def _chi_square_remark(self) -> str:
        chi_square = self.reduced_chi_square
        if chi_square is None:
            return "noise estimated from the residual itself; summary() tests whether the model fits"
        return f"reduced chi-square {chi_square:.3g}, 1 where the model fits; summary() tests it"

    @property
    def reduced_chi_square(self) -> float | None:
        """Whitened chi-square over its degrees of freedom, over all recordings; 1 where the model fits.

        None where the noise is estimated from the residual itself. `tw.compare(fit, recording)` has it by recording.
        """
        if all(noise.source is NoiseSource.RESIDUAL for noise in self.noise):
            return None
        whitened, start, squares, excited = self.whitened_residual(), 0, 0.0, 0
        for noise in self.noise:
            if noise.source is not NoiseSource.RESIDUAL:
                rows = whitened[start : start + noise.whitener.periodic_rows]
                squares, excited = squares + float(rows @ rows), excited + len(rows)
            start += noise.whitener.rows
        return squares / max(excited - int(self.identifiable.sum()), 1)

    if not TYPE_CHECKING:  # a type checker refuses every unknown name

        def __getattr__(self, name: str) -> NoReturn:
            """AttributeError; for an attribute of other packages' fits it names the one here."""
            raise AttributeError(unknown_attribute(type(self).__name__, name), name=name, obj=self)

    @cached_property
    def information(self) -> SquareRootInformation:
        """Square-root information of theta from the whitened rows."""
        return self.linearised().information.shifted(-self.theta)

    def intervals(self, level: float = LEVELS.confidence) -> Intervals:
        """Confidence intervals of every parameter, with the effective degrees of freedom of the estimated noise."""
        from estimation.confidence_intervals import intervals  # loads scipy.special

        return intervals(self.ordinary or self, level=level)

    def noise_floor(self, number: int = 0) -> Array:
        """Std of one sample (p,) of the noise of one of the recordings; of repeats without what the fit explains."""
        recording, noise = self.recordings[number], self.noise[number]
        repeated = noise.source is NoiseSource.REPEATS
        return repeat_noise_floor(recording, self.residuals[number]) if repeated else noise.floor

    def response(self, number: int = 0) -> ModelResponse:
        """Prediction of one of the recordings."""
        model = self.layout.models[number]
        return model_response(model, self.recordings[number], self.theta[self.layout.index[number]])

    def predicted_readings(self, number: int = 0) -> Array:
        """Predicted readings of one of the recordings, (n, p) in the channels' units; without a derivative."""
        model = self.layout.models[number]
        return predicted_readings(model, self.recordings[number], self.theta[self.layout.index[number]])

    @property
    def params(self) -> pd.DataFrame:
        """Value, std, its degrees of freedom, 95 % interval and unit of every parameter, by name, as a data frame.

        Few degrees of freedom, where little is known of the noise, make the interval wider than 1.96 std.
        """
        frame, ends = super().params, self.intervals()
        frame.insert(2, "freedom", ends.freedom)
        frame.insert(3, "low", ends.low)
        frame.insert(4, "high", ends.high)
        return frame

    def predict(self, recording: Recording | None = None) -> pd.DataFrame:
        """Predicted readings of a recording, by time and channel, as a data frame.

        Parameters
        ----------
        recording : Recording, optional
            One of the fit's recordings, by default the first, with its own biases and events; or another, with the
            biases of the first recording and without recording-specific effects.

        Returns
        -------
        pandas.DataFrame
            Readings in N and N m, one row a sample: the index is the time in s, of static poses their number.
        """
        if recording is not None:
            require_recording(recording, "predict")
        number = 0 if recording is None else self.number_of(recording)
        if recording is None or number is not None:
            return reading_frame(self.recordings[number or 0], self.predicted_readings(number or 0))
        return predicted_frame(self.model, self.values, recording)

    def number_of(self, recording: Recording) -> int | None:
        """Number of a recording among those of the fit; None of another."""
        return next((i for i, other in enumerate(self.recordings) if other.is_reading_of(recording)), None)

    @cached_property
    def residuals(self) -> tuple[Array, ...]:
        """Measured minus predicted of each recording, (n, p) in the channels' units; 0 where a channel is left out."""
        residuals = [r.wrench - self.predicted_readings(number) for number, r in enumerate(self.recordings)]
        for residual, noise in zip(residuals, self.noise, strict=True):
            residual[:, noise.left_out] = 0.0
        return tuple(residuals)


def require_recording(given: object, where: str) -> None:
    """InputError, in a sentence, for what is no recording."""
    if not isinstance(given, Recording):
        what = f"a recording is needed, not {kind_of(given)}"
        raise InputError(what=what, where=where, remedy="read it: tw.read(path), tw.from_dataframe(frame)")


def recordings_of(
    given: Recording | Iterable[Recording] | Mapping[str, Recording] | None, where: str, loads: Loads | None = None
) -> tuple[Recording, ...]:
    """The recordings of an argument: one, several, some by the names that they are to have, or none.

    `loads` is what some carried, by the recordings' names. InputError, in a sentence, for anything else.
    """
    other: object = given  # whatever the caller's types say
    if isinstance(given, Recording | None):
        return loaded(() if given is None else (given,), loads or {})
    if isinstance(other, str) or hasattr(other, "columns") or not isinstance(given, Iterable):
        require_recording(other, where)
    several = tuple(given.values() if isinstance(given, Mapping) else given)
    for one in several:
        require_recording(one, where)
    if isinstance(given, Mapping):
        several = tuple(replace(one, name=str(name)) for one, name in zip(several, given, strict=True))
    return loaded(several, loads or {})


def loaded(recordings: Sequence[Recording], loads: Loads) -> tuple[Recording, ...]:
    """Recordings that carried loads, by the recordings' names; InputError for a name of none, or of several."""
    names = [recording.name for recording in recordings]
    if not isinstance(loads, Mapping):
        raise InputError(what=f"{kind_of(loads)} is no loads", where="loads", remedy='give {"two": "2.0@0,0,0.05"}')
    for name in loads:
        if names.count(name) != 1:
            what = f"a load is stated of {quoted(name)}, and {names.count(name) or 'no'} recordings are called so"
            remedy = 'give the recordings by names: {"empty": .., "two": ..}'
            raise InputError(what=what, where="loads", remedy=remedy if name in names else suggestion(str(name), names))
    return tuple(r.carrying(*_listed(loads[r.name])) if r.name in loads else r for r in recordings)


def _listed(given: Load | str | Iterable[Load | str]) -> tuple[Load | str, ...]:
    return tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)


def predicted_frame(model: WrenchModel, values: Mapping[str, float], recording: Recording) -> pd.DataFrame:
    """Readings that a model with these parameter values predicts, without its recording-specific effects."""
    shared = model.without_recording_specific
    theta = np.array([values[p.name] for p in shared.parameters])
    return reading_frame(recording, predicted_readings(shared, prepared(recording, shared), theta))


def reading_frame(recording: Recording, readings: Array) -> pd.DataFrame:
    """Readings (n, p) of a recording as a data frame by time (s), or by number of the pose, and channel."""
    import pandas as pd

    name, time = ("pose", np.arange(recording.samples)) if recording.time is None else ("time", recording.time)
    return pd.DataFrame(readings, index=pd.Index(time, name=name), columns=list(recording.channels))


def initial_values(unknowns: ParameterLayout, start: Mapping[str, float]) -> Array:
    """Initial values: those given by name, else the parameter's `start`, else its nominal value.

    Raises InputError for a parameter that has none of them: the level of a clipped channel.
    """
    values = np.array([start.get(p.name, p.nominal if p.start is None else p.start) for p in unknowns.parameters])
    if not np.isfinite(values).all():
        name = unknowns.parameters[int(np.argmin(np.isfinite(values)))].name
        remedy = f"give start={{'{name}': ...}}, or let `diagnose` find it"
        raise InputError(what=f"{name} has no initial value", where="fit", remedy=remedy)
    return values


@overload
def fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording] | Mapping[str, Recording],
    *,
    loads: Loads | None = None,
    noise: Sequence[RecordingNoise] | None = None,
    start: Mapping[str, float] | None = None,
    constraints: StatedConstraints | None = None,
) -> Fit: ...


@overload
def fit(
    model: WrenchModel,
    recordings: RecordingOrChunk | Iterable[RecordingOrChunk],
    *,
    noise: NoiseModel,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
) -> StreamedFit: ...


def fit(
    model: WrenchModel,
    recordings: RecordingOrChunk | Iterable[RecordingOrChunk] | Mapping[str, Recording],
    *,
    loads: Loads | None = None,
    noise: Sequence[RecordingNoise] | NoiseModel | None = None,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    constraints: StatedConstraints | None = None,
) -> Fit | StreamedFit:
    """Estimate a model's parameters from one recording or several of the same rig and sensor.

    Every parameter is shared but the biases, which are recording-specific (`bias_fx@name`), and the moments of another
    tool (`m@name`). A sign convention AUTO is decided from the recordings.

    Parameters
    ----------
    model : WrenchModel
        The model, with its effects.
    recordings : Recording, iterable of Recording or of Chunk, or mapping of str to Recording
        Recordings with the model's channels and signals, perhaps by name; with a `NoiseModel` also chunks.
    loads : mapping of str to Load or str, or to several, optional
        What the sensor carried beside the tool in a recording, by its name: a `Load`, "MASS@X,Y,Z", or the name of a
        body of unknown mass, with which the tool is another one. By default nothing.
    noise : sequence of RecordingNoise, or NoiseModel, optional
        Noise of each recording; by default it is estimated from the recordings. With a `NoiseModel`, recordings or
        chunks are processed one by one and not kept in memory: see `estimation.streaming.streamed_fit`.
    start : mapping of str to float, optional
        Initial values of parameters by name, in their units; by default the parameters' own.
    executor : Executor, optional
        `concurrent.futures.Executor` or compatible that processes the parts under a `NoiseModel`; by default none.
    constraints : Constraints, Bounds, or mapping of str to (float, float) or float, optional
        Bounds, physical consistency of the tool and a prior; or bounds alone, also as plain intervals by parameter
        name, a number of which fixes the parameter. By default none, and none under a `NoiseModel`.

    Returns
    -------
    Fit or StreamedFit
        Parameters by name with std and unit, `theta` (k,) and its covariance (k, k); a `StreamedFit` with a
        `NoiseModel`.

    Raises
    ------
    InputError
        When a recording lacks a signal that the model needs, the convention cannot be decided, the mass is
        significantly negative under the stated convention, a parameter has no initial value, `start` names none, the
        constraints are infeasible, or chunks or an executor come without a `NoiseModel`.

    Notes
    -----
    Whitened nonlinear least squares by Levenberg-Marquardt. What a transient effect explains of repeats is taken out of
    their noise, and the fit repeated. Where the noise comes from the residual, fit and noise
    re-estimation are iterated; the parameters of a single run are then those of ordinary least squares, each channel
    weighted by the noise of its upper frequencies, with the std that the residual's spectrum gives: what the model
    lacks is in that spectrum, too, and would bias an estimate that is whitened by it. Where the rig states the noise of
    a single run, that and the noise of the motion weigh the readings, and the std come from the same spectrum, in which
    no line has less power than was stated.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> recording = tw.read("train.csv", rig=rig)
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), recording)
    >>> print(f"m = {fit.values['m']:.2f} kg, c = {fit.values['viscous_drag.c']:.2f} N s/m")
    m = 0.90 kg, c = 0.15 N s/m
    >>> white = tw.NoiseModel.white([0.15, 0.25, 0.012])
    >>> type(tw.fit(tw.planar(rig), tw.chunks(recording, 1000), noise=white)).__name__
    'StreamedFit'
    """
    require_model(model, "fit")
    stated = None if constraints is None else _constraints(constraints)
    if isinstance(noise, NoiseModel):
        from estimation.streaming.streamed_fit import fit_streamed  # for long logs alone

        if loads:
            remedy = "leave the noise to be estimated, or give that of each recording"
            raise InputError(what="loads are of whole recordings", where="fit", remedy=remedy)
        several = tuple(recordings.values()) if isinstance(recordings, Mapping) else recordings
        return fit_streamed(model, several, noise, start=start, executor=executor, constraints=stated)
    case = Case.of(model, _whole_recordings(recordings, executor, loads))
    return fit_case(case, noise=noise, start=start, constraints=stated)


def fit_case(
    case: Case,
    *,
    noise: Sequence[RecordingNoise] | None = None,
    start: Mapping[str, float] | None = None,
    constraints: Constraints | None = None,
) -> Fit:
    """`fit` of a case."""
    if noise is not None and len(noise) != len(case.recordings):
        what = f"{len(noise)} noises of {len(case.recordings)} recordings"
        raise InputError(what=what, where="noise", remedy="give one for each recording, in their order")
    layout = parameter_layout(case.model, case.recordings)
    require_known_start(start or (), case.model, layout.parameters)
    if constraints is not None:
        constraints.region(layout)  # raises before any work when they are invalid or infeasible
    fitted = unchecked_fit(case, noise=noise, start=start, constraints=constraints)
    for _ in range(MAX_NOISE_ROUNDS - 1 if noise is None and case.model.effects else 0):
        from estimation.transients import noise_without_transients, values_in  # of effects alone

        without_transients = noise_without_transients(fitted)
        if without_transients is None:
            break
        start = values_in(without_transients, fitted)
        fitted = unchecked_fit(case, noise=without_transients, start=start, constraints=constraints)
    given = noise is not None or constraints is not None
    fitted = as_reported(fitted, stated=given)
    if case.is_of_tool:
        require_positive_fitted_mass(fitted)
    return fitted


def as_reported(fitted: Fit, *, stated: bool = False) -> Fit:
    """The fit as it is reported: `with_ordinary_estimate`, or what was `stated` with the std of its colour; and the std
    of onset times."""
    reported = with_coloured_std(fitted) if stated else with_ordinary_estimate(fitted)
    if not any(p.role is Role.ONSET and not p.fixed for p in reported.unknowns):
        return reported
    from estimation.transients import onset_stds  # of events alone

    covariance, identifiable = reported.covariance.copy(), reported.identifiable.copy()
    for place, std in onset_stds(reported).items():
        covariance[place, :], covariance[:, place], identifiable[place] = 0.0, 0.0, True
        covariance[place, place] = std**2
    return replace(reported, covariance=covariance, identifiable=identifiable)


def with_ordinary_estimate(fitted: Fit) -> Fit:
    """The fit with parameters by ordinary least squares where its noise comes from the residual of a run.

    Their std are those in the noise's own spectrum (`with_coloured_std` where a rig states the noise). The noise stays
    as it was, for tests, but for the std of one sample, which is that of the new residual: an estimate in
    near-integrated noise leaves a larger one.
    """
    from estimation.confidence_intervals import covariance_in_noise, ordinary_estimate  # loads scipy.special
    from estimation.noise.noise_estimation import with_floor_of  # spectra: slow to import

    ordinary = ordinary_estimate(fitted, fitted.residuals)
    if ordinary is None:
        return with_coloured_std(fitted)
    estimated = replace(
        fitted,
        theta=ordinary.theta,
        covariance=covariance_in_noise(ordinary),
        identifiable=ordinary.identifiable,
        converged=ordinary.converged,
        ordinary=ordinary,
    )
    parts = zip(fitted.noise, fitted.recordings, estimated.residuals, strict=True)
    noise = tuple(with_floor_of(recording_noise, recording, r) for recording_noise, recording, r in parts)
    return replace(estimated, problem=fitted.problem.in_noise(noise))


def with_coloured_std(fitted: Fit) -> Fit:
    """The fit with the std of its intervals where the weights alone do not tell them: in the spectrum of the residual
    where a rig states the std of a run, but not its colour, and of repeats with the error of the weights."""
    from estimation.confidence_intervals import covariance_in_noise, may_be_coloured  # loads scipy.special

    parts = zip(fitted.recordings, fitted.noise, strict=True)
    if not any(
        n.source is NoiseSource.REPEATS or (n.source is NoiseSource.RIG and may_be_coloured(r, n)) for r, n in parts
    ):
        return fitted
    plain = fitted.ordinary or fitted  # one that is reported already stays as it is
    return replace(fitted, covariance=covariance_in_noise(plain), ordinary=plain)


def _whole_recordings(
    given: RecordingOrChunk | Iterable[RecordingOrChunk] | Mapping[str, Recording],
    executor: Executor | None,
    loads: Loads | None,
) -> tuple[Recording, ...]:
    """The argument as whole recordings; InputError for chunks or an executor, which need a noise model."""
    from estimation.streaming.chunk import Chunk  # otherwise of streamed fits alone

    remedy = "give noise=NoiseModel.white(std), or noise=fitted.noise[0].autoregression of a fit to one recording"
    if executor is not None:
        what = "an executor needs the noise beforehand, as it processes each part independently"
        raise InputError(what=what, where="executor", remedy=remedy)

    def refusing_chunks(parts: Iterable[object]) -> Iterator[object]:
        """The parts one by one: the first chunk is refused before a log that is longer than memory is read on."""
        for part in parts:
            if isinstance(part, Chunk):
                raise InputError(what="noise cannot be estimated from chunks", where=part.run, remedy=remedy)
            yield part

    whole: object = given
    if not isinstance(whole, Recording | Mapping | str | None) and not hasattr(whole, "columns"):
        whole = refusing_chunks(whole if isinstance(whole, Iterable) else (whole,))
    return recordings_of(whole, "fit", loads)  # type: ignore[arg-type]  # what is left is checked there


def unchecked_fit(
    case: Case,
    *,
    noise: Sequence[RecordingNoise] | None = None,
    start: Mapping[str, float] | None = None,
    constraints: Constraints | None = None,
) -> Fit:
    """`fit_case` without the check of the mass, and with the std of the noise that whitened the rows.

    `noise` is kept; the default, the case's own, is re-estimated where it comes from the residual.
    """
    problem = Problem.of(case.model, case.recordings, case.noise if noise is None else noise)
    fitted = solved(problem, start, constraints=constraints)
    rounds = 1 if noise is not None else MAX_NOISE_ROUNDS
    for _ in range(rounds - 1):
        if all(n.source is not NoiseSource.RESIDUAL for n in fitted.noise):
            break
        fitted = fitted.in_noise(reestimated_noise(fitted), constraints=constraints)
    return fitted


def in_noise_beside_pose(fitted: Fit) -> Fit:
    """The fit in the noise that no function of the pose explains, where its residual of poses at rest depends on it.

    Effects are searched in it: taken for noise, what a model lacks hides itself. The residual of each channel depends
    on the weights of all, so that it has to depend on the pose in that noise, too.
    """
    from estimation.noise.pose_noise import noise_beside_pose

    def beside(fit: Fit) -> tuple[RecordingNoise, ...]:
        return tuple(map(noise_beside_pose, fit.recordings, fit.residuals, fitted.noise))

    noise = beside(fitted)
    if all(new is old for new, old in zip(noise, fitted.noise, strict=True)):
        return fitted
    again = beside(fitted.in_noise(noise))
    confirmed = tuple(old if now is old else new for old, new, now in zip(fitted.noise, noise, again, strict=True))
    return fitted.in_noise(confirmed)


def solved(
    problem: Problem,
    start: Mapping[str, float] | None = None,
    *,
    constraints: Constraints | None = None,
    far: float = np.inf,
) -> Fit:
    """The minimum of a problem from initial values by name, within constraints where there are any.

    Without constraints, a chi-square that stays far above `far` ends it before it has converged
    (`levenberg_marquardt`).
    """
    theta = initial_values(problem.layout, start or {})
    if constraints is None:
        minimum = problem.minimise(theta, far)
        return Fit(problem, minimum.theta, minimum.covariance, minimum.identifiable, minimum.converged)
    held = _constrained(problem, theta, constraints)
    return Fit(problem, held.theta, held.covariance, held.identifiable, held.converged, held)


def _constraints(given: StatedConstraints) -> Constraints:
    from estimation.least_squares.constraints import Constraints

    return Constraints.of(given)


def _constrained(problem: Problem, theta: Array, constraints: Constraints) -> ConstrainedMinimum:
    from estimation.least_squares.constrained_minimum import minimise_constrained

    return minimise_constrained(problem, theta, constraints)


def require_positive_fitted_mass(fitted: Fit) -> None:
    """Refuse a fit with a significantly negative mass.

    Raises InputError: the readings have the sign convention opposite to the stated one, or loads are not as stated.
    """
    names = ", ".join(r.name for r in fitted.recordings)
    for tool in ("", *fitted.layout.other_tools):
        mass = fitted.parameters[f"m@{tool}" if tool else "m"]
        if mass.value < 0 and (doubts := doubted_loads(fitted.model, fitted.recordings)):
            what = f"{doubts[0].partition(':')[0]}, and the mass comes out as {mass.value:.3g} ± {mass.std:.2g} kg"
            raise InputError(
                what=what, where=names, remedy="state each load of the recording that carried it, kg and m"
            )
        require_positive_mass(mass, fitted.model.convention, names)


UNLIKE_LOAD = 0.2
"""Share of a load's mass, or distance, by which readings are unlike what is stated: sensors err by some per cent."""
UNLIKE_WHOLE, UNLIKE_PLACE = 0.05, 0.01
"""Share of all that hangs on the sensor, and m of its centre, by which they are at least: effects that a rigid tool
lacks, as lag or hysteresis, are in proportion to it."""
UNLIKE_STD = 5.0
"""Std by which they are at least, as many recordings are compared."""


def doubted_loads(model: WrenchModel, recordings: Sequence[Recording]) -> list[str]:
    """A sentence for each recording that by itself does not weigh what it is stated to carry, or has it elsewhere.

    Compared is the rigid tool with its load to that with the least load, each fitted to its recording alone.
    """
    names = [p.name for p in inertial_parameters(model.space)][: 2 if model.space is Space.PLANE else 4]
    lightest: dict[str, tuple[Recording, Fit]] = {}
    sentences = []
    for recording in sorted(recordings, key=lambda r: sum(load.mass or 0.0 for load in r.loads)):
        if all(other.loads == recording.loads for other in recordings if other.tool == recording.tool):
            continue
        alone = unchecked_fit(Case(model.base, (recording.moved(loads=()),)))
        other, least = lightest.setdefault(recording.tool, (recording, alone))
        if other.loads == recording.loads:
            continue
        stated = with_loads(model, recording.loads, np.zeros(len(model.parameters)))
        stated = (stated - with_loads(model, other.loads, np.zeros_like(stated)))[len(model.biases) :][: len(names)]
        more = np.array([alone.parameters[name].value - least.parameters[name].value for name in names])
        std = np.array([np.hypot(alone.parameters[name].std, least.parameters[name].std) for name in names])
        off, whole = np.abs(more - stated), max(alone.parameters[names[0]].value, 0.0)
        if off[0] > max(UNLIKE_LOAD * abs(stated[0]), UNLIKE_WHOLE * whole, UNLIKE_STD * std[0]):
            sentences.append(
                f"By the readings {recording.name} carries {more[0]:.3g} kg more than {other.name}, by the loads stated"
                f" {stated[0]:.3g} kg: see whether they are of these recordings, in kg."
            )
        elif stated[0] > 0 and more[0] > 0:
            read, at = more[1:] / more[0], stated[1:] / stated[0]
            apart, distance = (float(np.linalg.norm(place)) * more[0] for place in (read - at, at))
            spread = UNLIKE_STD * float(np.linalg.norm(std[1:]))
            if apart > max(UNLIKE_LOAD * distance, UNLIKE_PLACE * whole, spread):
                places = [", ".join(f"{x:.3g}" for x in np.round(place, 3) + 0.0) for place in (read, at)]
                sentences.append(
                    f"By the readings what {recording.name} carries more than {other.name} is at ({places[0]}) m, by"
                    f" the loads stated at ({places[1]}) m: see whether that is from the sensor's origin, along the"
                    " axes of the tool's parameters."
                )
    return sentences


def reestimated_noise(estimated: Fit) -> tuple[RecordingNoise, ...]:
    """The noise of a fit's recordings, re-estimated where it comes from the residual."""
    from estimation.noise.noise_estimation import estimate_noise

    fitted = int(estimated.identifiable.sum())
    return tuple(
        estimate_noise(r, e, fitted, n.events, n.motion) if n.source is NoiseSource.RESIDUAL else n
        for r, e, n in zip(estimated.recordings, estimated.residuals, estimated.noise, strict=True)
    )
