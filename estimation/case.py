"""Case: recordings of one rig and tool with what is decided of them before any fit, and the noise to begin with.

What a reading is read with is decided here and nowhere else: gravity's direction, the sign convention and the mounting,
whether each repeat moved in its own way, the events of single runs and the first estimate of the noise. A fit, a
diagnosis, a study, a robust fit and the commands all begin with `Case.of`; what meets one more recording later, as a
contact wrench or a prediction does, takes it as `prepared`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimation.gravity.gravity_direction import gravity_evidence, with_fitted_tilt
from estimation.gravity.gravity_estimate import GravityEstimate
from estimation.least_squares.square_root_information import SquareRootInformation, least_squares_solution
from estimation.model_response import model_response, predicted_readings, readings_follow_repeats
from estimation.noise.recording_noise import MotionNoise, RecordingNoise, sample_step
from estimation.parameter_layout import main_tool
from estimation.recordings.recording import Recording, require_channels
from estimation.recordings.sign_convention import SignDecision, with_convention
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel
from modeling.effects.geometry import GravityTilt
from modeling.effects.loads import BaseForce, CableSpring
from modeling.errors import InputError
from modeling.kinematics.placement import Direction
from modeling.rig import Convention, Rig
from modeling.rigid_body import Load
from modeling.space import Space

if TYPE_CHECKING:
    from estimation.readings.decision import ShownReading
    from estimation.readings.doubted_reading import DoubtedReading

Array = NDArray[np.float64]

WARMER = 5.0
"""K, between recordings, from which on the gain may depend on the temperature: by the 0.01 to 0.1 % for each kelvin
that sheets of sensors state, less changes no load by more than half a percent."""
BASE_FIT_ROUNDING = 1e-6
"""Relative size of singular values that the first fit of the rigid tool takes for zero: its columns differ much in
size, and a poorly excited parameter must not make the residual larger, from which the noise is estimated."""


@dataclass(frozen=True, eq=False)
class Case:
    """Recordings of one rig and tool, as a model reads them.

    model       as given, with its arm, gravity's direction, sign convention and mounting decided
    recordings  to fit, on the model's base
    held_out    of other motions, never fitted, on the model's base
    sign        decision on the sign convention from the data; None where it is stated
    gravity     direction of gravity in base axes where the data decided it; None where it is stated, or points down
    doubted     another direction than down that the data suggest, and that is not applied; None where they do not
    readings    other readings that are shown, adopted or proposed; none where the recordings fit as read
    tilt_fitted  whether the model has `gravity_tilt` for the direction of gravity alone, as it was not given with it
    """

    model: WrenchModel
    recordings: tuple[Recording, ...]
    held_out: tuple[Recording, ...] = ()
    sign: SignDecision | None = None
    gravity: GravityEstimate | None = None
    doubted: GravityEstimate | None = None
    readings: tuple[DoubtedReading, ...] = ()
    tilt_fitted: bool = False

    @classmethod
    def of(
        cls,
        model: WrenchModel,
        recordings: Sequence[Recording],
        held_out: Sequence[Recording] = (),
        *,
        read: Collection[str] = (),
        as_read: bool = False,
    ) -> Case:
        """The case of a model and its recordings.

        Where neither the model nor a recording's rig states gravity's direction, the evidence of all readings of the
        frames is weighed. A base that clearly does not stand upright is mounted as estimated: along the nearest axis
        where that is within 15 degrees; else as estimated, and the two angles of `gravity_tilt` are fitted beside the
        tool. Where a cable on the tool explains the readings as well, or a force that is constant in base axes better,
        gravity stays down. A sign convention AUTO is decided from the weight in the readings.

        Another reading may be shown than that (`estimation/readings/`). It is adopted where it changes nothing that was
        stated: gravity that points up, in six axes a sensor that is turned. A mistake in the log, as a sign of the
        torques, is a matter of what its author meant: it is proposed, and adopted if its id is among `read`. Dwells
        that were logged as a run are read as static poses, before all else. With `as_read` no reading is doubted.

        Raises InputError when there are no recordings, their channels are not the model's, or the data cannot decide
        the sign convention.
        """
        several = (*recordings, *held_out)
        check_channels(model, recordings)
        for recording in held_out:
            require_channels(recording, model)
            if recording.tool != (main := main_tool(recordings)):
                names = [f"'{tool}'" if tool else "no unknown load" for tool in (recording.tool, main)]
                what = f"it carries {names[0]}, and the tool that is fitted {names[1]}"
                raise InputError(what=what, where=recording.name, remedy="hold out a recording of that tool")
        # Of recordings in memory, which a streamed fit has not.
        from estimation.readings.static_dwells import as_static_poses
        from estimation.readings.stretch_reading import without_bad_stretches

        pieces, stretches = ([(r,) for r in several], ()) if as_read else without_bad_stretches(several, model)
        count = sum(map(len, pieces[: len(recordings)]))
        several, dwells = as_static_poses([r for each in pieces for r in each], model, runs=not as_read)
        case = cls._of(model, several, count, read, as_read=as_read)
        case = case if dwells is None else replace(case, readings=(dwells, *case.readings))
        case = replace(case, readings=(*stretches, *case.readings)) if stretches else case
        if all(recording.reading is None and recording.clock_offset is None for recording in several):
            return case
        from estimation.readings.of_log import readings_of_logs  # a streamed fit has none

        shown = {reading.id for reading in case.readings}
        of_logs = [r for r in readings_of_logs(several) if r.adopted or not (as_read or r.id in shown)]
        return replace(case, readings=(*of_logs, *case.readings))

    @classmethod
    def _of(
        cls, model: WrenchModel, several: Sequence[Recording], count: int, read: Collection[str], *, as_read: bool
    ) -> Case:
        """The case of recordings, of which the first `count` are to be fitted, without what their logs show."""
        if as_read:
            return cls._as_read(model, several, count)
        # Of recordings in memory, which a streamed fit has not.
        from estimation.readings.channel_reading import OF_CHANNELS, convention_by_axes, log_readings

        of_log, several = log_readings(several, read)
        if not any(doubted.id in OF_CHANNELS for doubted in of_log):
            case = cls._in_frames_shown(model, several, count, read)
        else:  # frames that a channel shows which is no reading are none
            undecided = model.convention is Convention.AUTO and model.space is Space.SPACE
            convention = convention_by_axes(several) if undecided else None
            stated = model if convention is None else replace(model, convention=convention)
            try:
                case = cls._as_read(stated, several, count)
            except InputError as error:
                doubts = "; ".join(f"{doubted.meaning}, as {doubted.shown_by}" for doubted in of_log)
                raise InputError(what=f"{doubts}; {error.what}", where=error.where, remedy=error.remedy) from None
        return replace(case, readings=(*of_log, *case.readings))

    @classmethod
    def _in_frames_shown(
        cls, model: WrenchModel, several: Sequence[Recording], count: int, read: Collection[str]
    ) -> Case:
        """The case of recordings whose rows and channels are read, of which the first `count` are to be fitted."""
        from estimation.readings.decision import shown_reading

        undecided: InputError | None = None
        try:
            case = cls._as_read(model, several, count)
        except InputError as error:
            if model.convention is not Convention.AUTO or model.space is Space.PLANE:
                raise
            undecided = error
            case = cls._upright(replace(model, convention=Convention.ON_TOOL), several, count)
        shown = shown_reading(
            _of_one_weight((*case.recordings, *case.held_out), case.model), case.model, model.convention
        )
        if undecided is not None and (shown is None or shown.p_value is None):
            raise undecided from None
        if case.gravity is not None:
            upright = cls._upright(replace(model, convention=case.model.convention), several, count)
            weighed = _of_one_weight((*upright.recordings, *upright.held_out), upright.model)
            of_upright = shown_reading(weighed, upright.model, model.convention)
            weighed = _of_one_weight(case.recordings, case.model)
            if of_upright is not None and of_upright.is_simpler_than(shown, weighed, case.model):
                case, shown = upright, of_upright
        return case if shown is None else case._with_reading(shown, model, several, read)

    def _with_reading(
        self, shown: ShownReading, given: WrenchModel, several: Sequence[Recording], read: Collection[str]
    ) -> Case:
        """The case with a reading that is shown, adopted where that contradicts no statement or is asked for."""
        if shown.is_net:  # the fit refuses it unless it is meant so
            adopted = replace(shown.doubted, adopted=True)
            return replace(self, readings=(adopted,)) if shown.doubted.id in read else self
        count, of_log = len(self.recordings), shown.is_mistake or given.space is Space.PLANE
        proposed = of_log or shown.contradicts or shown.p_value is None
        chosen = next((r for r in shown.readings if r.id in read), shown.doubted)
        if proposed and (chosen.id not in read or shown.p_value is None):
            return replace(self, readings=shown.readings)
        shown, adopted = shown.read_as(chosen.id), replace(chosen, adopted=True)
        if of_log and shown.motion.gravity is None:
            mended = [shown.mended(recording, [chosen.id]) for recording in several]
            convention = given.convention if given.convention is Convention.AUTO else shown.axes.convention
            return replace(Case._as_read(replace(given, convention=convention), mended, count), readings=(adopted,))
        model = self.model  # with the tilt that is fitted beside a direction of gravity
        if shown.motion.gravity is not None:
            model = _on_base(replace(given, gravity_direction=None), shown.motion.gravity)
            model = model.with_arm(next((r.arm for r in several if r.arm is not None), None))
            several = [r.moved(rig=replace(r.rig or Rig(), gravity_direction=None)) for r in several]
        model = replace(model, convention=shown.axes.convention)
        model = model if model.space is Space.PLANE else replace(model, mounting=shown.turn)
        mounted = [_recording_on_base(recording, model.gravity_direction) for recording in several]
        recordings = tuple(_with_decided_motion(recording, model) for recording in mounted)
        sign = None
        if given.convention is Convention.AUTO:
            sign = SignDecision(shown.axes.convention, shown.ranked.mass, shown.axes.turn)
        return replace(
            self, model=model, recordings=recordings[:count], held_out=recordings[count:], sign=sign, doubted=None,
            readings=(adopted,),
        )  # fmt: skip

    @classmethod
    def _upright(cls, model: WrenchModel, several: Sequence[Recording], count: int) -> Case:
        """Recordings whose frames are not decided, on a base that stands upright or as it is stated."""
        direction = _stated_direction(model, several)
        model = model if direction is None else _on_base(model, direction)
        model = model.with_arm(next((r.arm for r in several if r.arm is not None), None))
        read = tuple(_recording_on_base(recording, direction) for recording in several)
        return cls(model, read[:count], read[count:])

    @classmethod
    def _as_read(cls, model: WrenchModel, several: Sequence[Recording], count: int) -> Case:
        """Gravity's direction, sign and motion decided of recordings, of which the first `count` are to be fitted."""
        gravity, doubted, direction = None, None, _stated_direction(model, several)
        if direction is None:
            shown = gravity_evidence(
                _of_one_weight(several, model),
                gravity=model.gravity,
                convention=model.convention,
                mirror_y=model.mirror_y,
            )
            gravity, doubted = (None, shown) if shown is not None and shown.is_doubted else (shown, None)
        direction = direction if gravity is None else gravity.direction
        model = model if direction is None else _on_base(model, direction)
        tilted = any(effect.id == GravityTilt.id for effect in model.effects)
        tilt_fitted = gravity is not None and not gravity.along_axis and not tilted
        model = model + GravityTilt() if tilt_fitted else model
        mounted = tuple(_recording_on_base(recording, direction) for recording in several)
        model, sign = with_convention(model, _of_one_weight(mounted, model))
        read = tuple(_with_decided_motion(recording, model) for recording in mounted)
        return cls(model, read[:count], read[count:], sign, gravity, doubted, tilt_fitted=tilt_fitted)

    @property
    def misread(self) -> bool:
        """Whether another reading is shown and not adopted: what a fit gives then is no measurement of the tool."""
        present = {effect.id for effect in self.model.effects}
        return any(not (reading.adopted or reading.explained_by in present) for reading in self.readings)

    @property
    def weighed(self) -> bool:
        """Whether recordings of one tool differ by known loads, which tell the scale of the sensor from its mass."""
        carried: dict[str, set[tuple[Load, ...]]] = {}
        for recording in self.recordings:
            carried.setdefault(recording.tool, set()).add(tuple(load for load in recording.loads if load.known))
        return any(len(loads) > 1 for loads in carried.values())

    @property
    def warmed(self) -> bool:
        """Whether the recordings' mean temperatures differ by `WARMER`, which tells how the gain depends on them."""
        logged = [recording.columns.get("temperature") for recording in (*self.recordings, *self.held_out)]
        if any(series is None for series in logged):
            return False
        means = [float(np.mean(series)) for series in logged[: len(self.recordings)] if series is not None]
        return max(means, default=0.0) - min(means, default=0.0) > WARMER

    @property
    def is_of_tool(self) -> bool:
        """Whether what is weighed is a tool, of positive mass: not if more was subtracted or a reading is doubted."""
        return not any(r.id == "payload_compensated" or not r.adopted for r in self.readings)

    @cached_property
    def noise(self) -> tuple[RecordingNoise, ...]:
        """Noise of the recordings before any fit (`initial_noise`)."""
        return initial_noise(self.model, self.recordings)

    @cached_property
    def held_out_noise(self) -> tuple[RecordingNoise, ...]:
        """Noise of the held-out recordings before any fit."""
        return initial_noise(self.model, self.held_out) if self.held_out else ()

    def with_fitted_gravity(self, model: WrenchModel, values: Mapping[str, float]) -> Case:
        """The case after a fit of a model on its base, with the fitted parameters by name.

        The direction of gravity that the data decided is turned by the tilt fitted beside the tool; one that is doubted
        for a cable on the tool, or a force that is constant in base axes, is dropped where the fit has that.
        """
        if self.doubted is not None and any(effect.id in (CableSpring.id, BaseForce.id) for effect in model.effects):
            return replace(self, doubted=None)
        if self.gravity is None:
            return self
        return replace(self, gravity=with_fitted_tilt(self.gravity, model, values))


SPANNED_SHARE = 0.5
"""Share of the widest spread of gravity that frames are decided by: half as wide tells axes as well, a heavy load that
was hardly turned does not."""


def _of_one_weight(recordings: Sequence[Recording], model: WrenchModel) -> tuple[Recording, ...]:
    """Those that carried the same: what their weight shows of frames is of one body.

    Of those whose weight turns as far as any, the known loads are heaviest.
    """
    by_loads: dict[tuple[Load, ...], list[Recording]] = {}
    for recording in recordings:
        by_loads.setdefault(recording.loads, []).append(recording)
    if len(by_loads) < 2:
        return tuple(recordings)
    base = replace(model.base, convention=Convention.ON_TOOL, mounting=ALIGNED_MOUNTING)
    spread = {loads: max(_spread_of_weight(r, base) for r in several) for loads, several in by_loads.items()}
    wide = [loads for loads in by_loads if spread[loads] >= SPANNED_SHARE * max(spread.values())]
    return tuple(by_loads[max(wide, key=lambda loads: sum(load.mass or 0.0 for load in loads))])


def _spread_of_weight(recording: Recording, base: WrenchModel) -> float:
    """N per kg, the smallest of the root mean squares along axes of the force of a mass about its mean."""
    derivative = model_response(base, recording, np.zeros(len(base.parameters))).derivative
    force = derivative[:, : recording.dimension, len(base.biases)]
    return float(np.linalg.svd(force - force.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(force)))


def check_channels(model: WrenchModel, recordings: Sequence[Recording]) -> None:
    """InputError when there are no recordings, or their channels are not the model's."""
    if not recordings:
        raise InputError(what="no recording was given", where="recordings", remedy="give at least one")
    for recording in recordings:
        require_channels(recording, model)


def prepared(recording: Recording, model: WrenchModel) -> Recording:
    """One more recording as a model whose frames are decided reads it: on its base, with its motion decided.

    Raises InputError when its channels are not the model's.
    """
    require_channels(recording, model)
    return _with_decided_motion(_recording_on_base(recording, model.gravity_direction), model)


def _with_decided_motion(recording: Recording, model: WrenchModel) -> Recording:
    """The recording with the motion of each repeat only where its readings show that it was not the mean motion."""
    if recording.moved_as_measured is not None or recording.own_motion is None:
        return recording
    return replace(recording, moved_as_measured=readings_follow_repeats(model.base, recording))


# ------------------------------------------------------------------------------------------- gravity's direction


def _stated_direction(model: WrenchModel, recordings: Sequence[Recording]) -> Direction | None:
    """The direction that the model has, else the first that a recording's rig states."""
    if model.gravity_direction is not None:
        return model.gravity_direction
    rigs = (recording.rig for recording in recordings)
    return next((rig.gravity_direction for rig in rigs if rig is not None and rig.gravity_direction is not None), None)


def _on_base(model: WrenchModel, direction: Direction) -> WrenchModel:
    """The model with this direction of gravity unless it has one, its arm on the turned base."""
    if model.gravity_direction is not None or len(direction) != model.space.value:
        return model
    arm = None if model.arm is None else model.arm.mounted(direction)
    return replace(model, gravity_direction=direction, arm=None).with_arm(arm)


def _recording_on_base(recording: Recording, direction: Direction | None) -> Recording:
    """The recording on a base with this direction of gravity, unless its rig states one."""
    rig = recording.rig or Rig()
    if direction is None or rig.gravity_direction is not None or len(direction) != recording.dimension:
        return recording
    return recording.moved(rig=replace(rig, gravity_direction=direction))


# ---------------------------------------------------------------------------------------------- first noise


def initial_noise(model: WrenchModel, recordings: Sequence[Recording]) -> tuple[RecordingNoise, ...]:
    """Noise before any fit: from the repeats, the rig, or the residual of an ordinary least-squares fit of the base.

    Transient events detected in a single run are excluded from that fit, and have a noise of their own. Repeats of one
    motion need no fit, as what a model predicts of them is their mean.
    """
    from estimation.noise.events_in_single_runs import find_events_in_single_runs  # in a streamed fit there are none

    events = find_events_in_single_runs(model, recordings)
    return tuple(_initial_noise(model.base, r, intervals) for r, intervals in zip(recordings, events, strict=True))


def _initial_noise(base: WrenchModel, recording: Recording, events: tuple[tuple[float, float], ...]) -> RecordingNoise:
    from estimation.noise.noise_estimation import estimate_noise  # nor is noise estimated

    if recording.repeats > 1 and recording.own_motion is None:
        return estimate_noise(recording, recording.wrench - recording.averaged(recording.wrench))
    predicted = partial(predicted_readings, base, theta=_base_model_fit(base, recording, events))
    motion = MotionNoise.of(recording, predicted)
    return estimate_noise(recording, recording.wrench - predicted(recording), events=events, motion=motion)


def _base_model_fit(base: WrenchModel, recording: Recording, events: tuple[tuple[float, float], ...]) -> Array:
    """Parameters (k,) of a least-squares fit of the rigid tip outside `events`, channels scaled by their std."""
    time = np.arange(recording.samples) * sample_step(recording)
    kept = ~np.any([(time >= start) & (time <= end) for start, end in events] or [time < 0], axis=0)
    size = len(base.parameters)
    response = model_response(base, recording, np.zeros(size))
    spread = recording.wrench.std(axis=0)
    spread[spread == 0] = 1.0
    rows = (response.derivative / spread[:, None])[kept].reshape(-1, size)
    target = ((recording.wrench - response.value) / spread)[kept].ravel()
    return np.asarray(least_squares_solution(SquareRootInformation.of(rows, target), rounding=BASE_FIT_ROUNDING))
