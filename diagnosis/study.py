"""Study: the loop by hand, from where a model fails to the effects that explain it, every step kept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diagnosis.comparison.compared_step import (
    ComparedFit,
    RecordingErrors,
    error_table,
    recording_errors,
    systematic_error,
)
from diagnosis.comparison.comparison import Comparison, comparisons_of, noise_from_residual
from diagnosis.comparison.model_comparison import ModelComparison, compare_models
from diagnosis.comparison.residual_map import ResidualMap, residual_maps
from diagnosis.diagnosis import Diagnosis, diagnose_case
from diagnosis.discovery.discovery import Discovery, discover
from diagnosis.discovery.grammar import COMPLEXITY
from diagnosis.held_out import HeldOut
from diagnosis.progress import Progress, count_progress, silent
from diagnosis.screening.null_model import ScreeningCache
from diagnosis.screening.score_test import model_initial_values, screen
from diagnosis.screening.suspects import Suspects
from diagnosis.subset_search import CandidateModel, refit_in_own_noise, refit_with_effect
from diagnosis.verdict.aliasing import channel_tolerance
from diagnosis.verdict.unexplained_residual import UnexplainedResidual, describe_residual, unknown_tool_reason
from estimation.case import Case
from estimation.fit import (
    Fit,
    Loads,
    as_reported,
    fit_case,
    in_noise_beside_pose,
    loaded,
    recordings_of,
    require_recording,
)
from estimation.reading.log_reading import read
from estimation.recordings.recording import Recording, require_different_readings
from modeling.chain.effect import Effect, effects_of
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.effects import catalogue, named
from modeling.errors import InputError, quoted, suggestion
from modeling.number_format import P_VALUE
from modeling.rig import Rig
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, presenter

if TYPE_CHECKING:
    from estimation.readings.doubted_reading import DoubtedReading

START = "rigid tool"
MOST_MAPS = 6
"""Residual maps listed, those that explain most first."""


@dataclass(frozen=True, eq=False)
class StudyStep(ComparedFit):
    """One model of a study.

    change      what led to it: `+ viscous_drag`, `- viscous_drag`
    training    its comparisons with the fitted recordings, `validation` with the held-out ones
    """

    change: str
    fit: Fit
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]

    @property
    def label(self) -> str:
        """The model: the rigid tool and the ids of its effects."""
        return " + ".join([START, *(effect.id for effect in self.fit.model.effects)])

    def __repr__(self) -> str:
        verdict = f"does not fit {', '.join(self.misfitting)}" if self.misfitting else "no lack of fit"
        return f"{super().__repr__()}; {verdict}"


@dataclass(frozen=True, eq=False)
class Location(Tabular):
    """Where a model fails on a recording: its residual against the variables that explain most of it."""

    comparison: Comparison
    residual: UnexplainedResidual
    maps: tuple[ResidualMap, ...]

    @property
    def table(self) -> Table:
        """Channel, variable, share of the channel's residual power explained, significant cells."""
        rows = [
            (m.channel, m.variable, m.explained, int(m.practically_significant.sum())) for m in self.maps[:MOST_MAPS]
        ]
        columns = (
            "channel",
            "against",
            Column("share explained", format=".2f"),
            Column("significant cells", format="d"),
        )
        return Table.of(columns, rows)

    def remarks(self) -> list[str]:
        """The largest of them in words, and whether there is anything to explain."""
        explained = self.comparison.lack_of_fit >= LEVELS.effect
        return [*self.comparison.remarks(), *([] if explained else [self.residual.text])]

    def printed(self) -> list[Table | str]:
        """The errors by channel, then the maps."""
        return [f"{self.comparison.recording.name}:", self.comparison.printed()[0], *super().printed()]


@dataclass(frozen=True, eq=False)
class Stairs(Tabular):
    """Error of each channel of each recording after every step of a study, with noise floor and tolerance."""

    steps: tuple[StudyStep, ...]
    tolerance: Mapping[str, float]

    @property
    def table(self) -> Table:
        """The systematic error, marked `<` where it is an upper limit; without repeats the RMS, marked `~`."""
        return error_table(self.steps, [step.label for step in self.steps], self.tolerance)


class Study(Tabular):
    """Recordings, a model, and what was learnt: an effect is added or dropped, and every step is kept.

    Parameters
    ----------
    fitted : Fit
        The first model, fitted.
    held_out : sequence of HeldOut
        Recordings of other motions with their noise.
    candidates : sequence of Effect
        The suspects.
    progress : callable, optional
        Called with one line of text at each stage; by default silent.
    readings : tuple of DoubtedReading, optional
        Other readings of the recordings that are shown; by default none.
    tilt_fitted : bool, optional
        Whether the model has `gravity_tilt` for the direction of gravity alone; by default not.

    Notes
    -----
    `study` makes one. The steps are immutable; the study itself goes forward and back among them.

    Examples
    --------
    >>> import truewrench as tw
    >>> study = tw.study("rig.toml", "train.csv")
    >>> _ = study.add("viscous_drag")
    >>> study.effects
    ('viscous_drag',)
    >>> _ = study.undo()
    >>> study.effects
    ()
    """

    def __init__(
        self,
        fitted: Fit,
        held_out: Sequence[HeldOut],
        candidates: Sequence[Effect],
        progress: Progress = silent,
        readings: tuple[DoubtedReading, ...] = (),
        tilt_fitted: bool = False,
    ) -> None:
        self._held_out, self._progress, self.readings = tuple(held_out), progress, readings
        self._tilt_fitted = tilt_fitted
        self._candidates = {effect.id: effect for effect in candidates}
        self._cache = ScreeningCache()
        first = self._step(START, fitted)
        self.steps: tuple[StudyStep, ...] = (replace(first, change=first.label),)
        self._undone: tuple[StudyStep, ...] = ()

    # ------------------------------------------------------------------------------------- where one is

    @property
    def fit(self) -> Fit:
        """The current fit."""
        return self.steps[-1].fit

    @property
    def undone(self) -> int:
        """How many steps can be done again."""
        return len(self._undone)

    @property
    def tool_unknown(self) -> str:
        """Why the readings do not say what the tool weighs, empty where they do."""
        return unknown_tool_reason(self.steps[-1].training, self.fit.model)

    @property
    def misfitting(self) -> tuple[str, ...]:
        """The recordings that the current model does not fit, held-out ones among them."""
        return tuple(self.steps[-1].misfitting)

    @property
    def model(self) -> WrenchModel:
        """The current model."""
        return self.fit.model

    @property
    def case(self) -> Case:
        """The recordings, fitted and held out, with the current model."""
        held_out = tuple(h.recording for h in self._held_out)
        return Case(self.model, self.fit.recordings, held_out, readings=self.readings, tilt_fitted=self._tilt_fitted)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the current model's effects."""
        return tuple(effect.id for effect in self.model.effects)

    @cached_property
    def tolerance(self) -> Mapping[str, float]:
        """Error that the user does not care about, by channel: from the rig, else a tenth of the noise floor."""
        return channel_tolerance(self.steps[0].fit)[0]

    # -------------------------------------------------------------------------------------- what to see

    def where(self, recording: int | str = 0) -> Location:
        """Where the current model fails, on a recording by name or number: the fitted ones, then the held-out ones."""
        step = self.steps[-1]
        comparisons = (*step.training, *step.validation)
        number = _number(recording, [c.recording.name for c in comparisons], "recording")
        comparison = comparisons[number]
        maps = residual_maps(comparison, self.tolerance)
        fitted = number < len(step.training)
        return Location(comparison, describe_residual(comparison, self.tolerance, fitted=fitted), tuple(maps))

    def suspects(self) -> Suspects:
        """Score tests of all effects that the current model lacks, what would remove most error first."""
        announce = count_progress(self._progress, "score tests")
        fit = in_noise_beside_pose(self.fit)
        tests = screen(fit, list(self._candidates.values()), cache=self._cache, announce=announce)
        explained = noise_from_residual(self.fit) or self._candidate.adequate
        excess = None if explained else self._candidate.excess
        return Suspects.of(tests, self.model.space, excess)

    def stairs(self) -> Stairs:
        """Error of each channel of each recording after every step."""
        return Stairs(self.steps, self.tolerance)

    def compare(self, *steps: int | str) -> ModelComparison:
        """Compare steps, by number, model or what they changed: on the held-out recordings, else the fitted.

        By default the first and the last; InputError for one step alone.
        """
        changes, labels = [step.change for step in self.steps], [step.label for step in self.steps]
        names_of_each = [labels if step in labels else changes for step in steps]
        chosen = [_number(s, names, "step") for s, names in zip(steps, names_of_each, strict=True)] or [
            0,
            len(labels) - 1,
        ]
        several = {f"{i}: {labels[i]}": self.steps[i].fit for i in dict.fromkeys(chosen)}
        if len(several) == 1:
            remedy = "add an effect first" if len(labels) == 1 else f"give different ones of 0 to {len(labels) - 1}"
            raise InputError(what="one step has nothing to be compared with", where="compare", remedy=remedy)
        return compare_models(several, [h.recording for h in self._held_out] or list(self.fit.recordings))

    # --------------------------------------------------------------------------------------- what to do

    def add(self, effect: str | Effect) -> StudyStep:
        """Add an effect, by its id or itself, and refit exactly from its score test's first guess.

        Raises InputError for an unknown id, an effect that the model has already, and one that the recordings do not
        excite, with the reason.
        """
        new = self._effect(effect)
        return self._append(f"+ {new.id}", self.tried(new))

    def tried(self, effect: str | Effect) -> Fit:
        """The fit with one effect more, by its id or itself, without a step; InputError as `add`."""
        new = self._effect(effect)
        _ = self.model + new
        self._progress(f"add {new.id}")
        (test,) = screen(in_noise_beside_pose(self.fit), [new], candidates=len(self._candidates), cache=self._cache)
        if not test.excited:
            remedy = "see study.suspects() for what these recordings excite"
            raise InputError(
                what=f"it is not identifiable from these recordings: {test.reason}", where=new.id, remedy=remedy
            )
        return refit_with_effect(self._candidate, test).fit

    def drop(self, effect: str | Effect) -> StudyStep:
        """Drop an effect and refit; InputError when the model lacks it."""
        effect_id, before = effect if isinstance(effect, str) else effect.id, self.fit
        after = refit_in_own_noise(before, before.model.without(effect_id), before.values)
        return self._append(f"- {effect_id}", after)

    def undo(self) -> StudyStep:
        """Go back one step; InputError at the first."""
        if len(self.steps) == 1:
            raise InputError(what="nothing to undo", where="study", remedy="this is the first step")
        self.steps, self._undone = self.steps[:-1], (*self._undone, self.steps[-1])
        return self.steps[-1]

    def redo(self) -> StudyStep:
        """Go forward again by the step last undone; InputError where there is none, as after another change."""
        if not self.undone:
            raise InputError(what="nothing to redo", where="study", remedy="undo a step first")
        self.steps, self._undone = (*self.steps, self._undone[-1]), self._undone[:-1]
        return self.steps[-1]

    def discover(self, complexity: int = COMPLEXITY) -> Discovery:
        """Look for an equation of what the current model leaves, tested on the recordings held out.

        InputError without one of another motion.
        """
        others = [held_out.recording for held_out in self._held_out]
        return discover(self.fit, self.fit.recordings, validate=others, complexity=complexity, progress=self._progress)

    def diagnose(self, *, workers: int = 1) -> Diagnosis:
        """Let the diagnosis go on from the current model; the effects that it adds become steps.

        What the model has is given and stays. `workers` is without effect, as in `diagnose`.
        """
        diagnosis = diagnose_case(self.case, effects=tuple(self._candidates.values()), progress=self._progress)
        for step in diagnosis.steps[1:]:
            self.steps = (*self.steps, StudyStep(f"+ {step.effect}", step.fit, step.training, step.validation))
            self._undone = ()
        return diagnosis

    # ------------------------------------------------------------------------------------- how it prints

    @property
    def table(self) -> Table:
        """The steps: model, worst error over noise floor in training and validation, reduced chi-square."""
        names = ("error / noise floor", "held out") if self._held_out else ("error / noise floor",)
        rows = []
        errors = recording_errors(self.steps)
        fitted, held_out = ([e for e in errors if e.fitted is kind] for kind in (True, False))
        for number, step in enumerate(self.steps):
            ratios = [_worst_ratio(of, number) for of in (fitted, held_out) if of]
            rows.append((number, step.label, *ratios, step.training[0].misfit, step.training[0].lack_of_fit_cell))
        measures = (Column("reduced chi-square", format=".3g"), Column("lack-of-fit p", format=P_VALUE))
        return Table.of(
            (Column("step", format="d"), "model", *(Column(n, format=".3g") for n in names), *measures), rows
        )

    def remarks(self) -> list[str]:
        """What the current model is, and which recordings it does not fit."""
        failing = self.steps[-1].misfitting
        readings = [doubted.sentence for doubted in self.readings]
        fits = [f"does not fit {', '.join(failing)}"] if failing else []
        return [
            *readings,
            *fits,
            f"model: {' + '.join([START, *self.effects])}; worst channel, systematic error with repeats, else rms",
        ]

    def show(self, height: int = 800) -> Any:
        """The workbench of this study in a frame of a notebook, `height` CSS pixels high; of this very study.

        What is added or dropped in the page is a step here, and the page has what was added here from its next step
        on. It is served on this machine alone: the browser has to be on the machine of the kernel. Elsewhere than in a
        notebook, `address` of what is returned is what a browser opens, for as long as Python runs.

        Raises InputError where the packages of the workbench are not installed, and for a height that is none.
        """
        return presenter().show(self, height)

    # ------------------------------------------------------------------------------------------- inside

    @property
    def _candidate(self) -> CandidateModel:
        return CandidateModel(self.fit, len(self._candidates), self._cache)

    def _effect(self, effect: str | Effect) -> Effect:
        if not isinstance(effect, str):
            return effect
        return self._candidates[effect] if effect in self._candidates else named(effect)

    def _append(self, change: str, fitted: Fit) -> StudyStep:
        self.steps, self._undone = (*self.steps, self._step(change, fitted)), ()
        return self.steps[-1]

    def _step(self, change: str, fit: Fit) -> StudyStep:
        fitted = as_reported(fit)
        training = comparisons_of(fitted)
        validation = tuple(h.comparison(fitted) for h in self._held_out)
        return StudyStep(change, fitted, training, validation)


def _number(asked: int | str, names: Sequence[str], kind: str) -> int:
    """The number of what was asked for by number or name, the last of that name; InputError for none."""
    if isinstance(asked, str) and asked in names:
        return len(names) - 1 - names[::-1].index(asked)
    if not isinstance(asked, str) and 0 <= asked < len(names):
        return asked
    remedy = suggestion(asked, names) if isinstance(asked, str) else f"use 0 to {len(names) - 1}"
    named_as = quoted(asked) if isinstance(asked, str) else asked
    raise InputError(what=f"there is no {kind} {named_as}", where=kind, remedy=remedy)


def _worst_ratio(errors: Sequence[RecordingErrors], step: int) -> float:
    """The largest error over noise floor of any channel: the systematic error, the RMS without repeats."""
    return max(v / e.floor(k) for e in errors for k, v in systematic_error(e.comparisons[step]).items())


Recorded = Recording | str | Path
"""A recording, or the path of one that `read` takes."""


def study(
    model: WrenchModel | Rig | str | Path | None,
    recordings: Recorded | Iterable[Recorded] | Mapping[str, Recorded],
    *,
    validate: Recorded | Iterable[Recorded] | Mapping[str, Recorded] | None = None,
    loads: Loads | None = None,
    effects: Sequence[Effect | str] | None = None,
    progress: Progress = silent,
) -> Study:
    """Begin a study: a model fitted to recordings, to which effects are added and dropped by hand or by diagnosis.

    Parameters
    ----------
    model : WrenchModel, Rig, str, Path or None
        A model, with or without effects; or a rig (or the path of its file, or None without one), whose rigid tool is
        the model.
    recordings : Recording, str, Path, iterable of these, or mapping of str to these
        Recordings of one rig and sensor, or their paths, which the models are fitted to, perhaps by name.
    validate : Recording, str, Path, iterable of these, or mapping of str to these, optional
        Held-out recordings of other motions, on which the biases alone are estimated.
    loads : mapping of str to Load or str, or to several, optional
        What the sensor carried beside the tool in a recording, by its name, as for `fit`; by default nothing.
    effects : sequence of Effect or str, optional
        The suspects, or their ids; by default the whole catalogue.
    progress : callable, optional
        Called with one line of text at each stage; by default silent.

    Returns
    -------
    Study
        With `where()`, `suspects()`, `add(id)`, `drop(id)`, `undo()`, `redo()`, `diagnose()`, `stairs()`, `compare()`,
        and `show()`, the page of the workbench in a notebook.

    Raises
    ------
    InputError
        When a recording or rig cannot be read, a signal of the model is not recorded, or the sign convention cannot be
        decided.

    Examples
    --------
    >>> import truewrench as tw
    >>> study = tw.study("rig.toml", "train.csv", validate="validate.csv")
    >>> "viscous_drag" in study.suspects().ids
    True
    >>> _ = study.add("viscous_drag")
    >>> [step.change for step in study.steps]
    ['rigid tool', '+ viscous_drag']
    >>> study.diagnose().verdict.value
    'nothing_missing'
    """
    _require_order(model, recordings)
    rig = Rig.read(model) if isinstance(model, str | Path) else model
    stated_rig = rig if isinstance(rig, Rig) else None
    several, others = _recordings(recordings, stated_rig), _recordings(validate, stated_rig)
    both = loaded((*several, *others), loads or {})
    several, others = both[: len(several)], both[len(several) :]
    require_different_readings((*several, *others), "study")
    candidates = None if effects is None else effects_of(effects)
    return study_case(Case.of(_model(rig, several), several, others), effects=candidates, progress=progress)


def study_case(case: Case, *, effects: Sequence[Effect] | None = None, progress: Progress = silent) -> Study:
    """`study` of a case."""
    fitted = fit_case(case, start=model_initial_values(case) if case.model.effects else None)
    held_out = [HeldOut(r, n) for r, n in zip(case.held_out, case.held_out_noise, strict=True)]
    listed = catalogue(weighed=case.weighed, warmed=case.warmed) if effects is None else effects
    candidates = [effect for effect in listed if fitted.model.space in effect.spaces]
    return Study(fitted, held_out, candidates, progress, case.readings, case.tilt_fitted)


def _require_order(model: object, recordings: object) -> None:
    """InputError for a recording where the rig belongs, or a rig or model where the recordings belong."""
    paths = [Path(p).suffix.lower() == ".toml" for p in (model, recordings) if isinstance(p, str | Path)]
    if isinstance(model, Recording) or isinstance(recordings, Rig | WrenchModel) or paths == [False, True]:
        remedy = "swap them, the rig or model first: tw.study(rig, recordings)"
        raise InputError(what="the rig and the recordings are swapped", where="study", remedy=remedy)


def _recordings(
    given: Recorded | Iterable[Recorded] | Mapping[str, Recorded] | None, rig: Rig | None
) -> tuple[Recording, ...]:
    if given is None:
        return ()
    if not isinstance(given, Recorded | Iterable) or hasattr(given, "columns"):
        require_recording(given, "study")

    def read_one(recorded: Recorded) -> Recording:
        return read(recorded, rig=rig) if isinstance(recorded, str | Path) else recorded

    if isinstance(given, Mapping):
        return recordings_of({name: read_one(recorded) for name, recorded in given.items()}, "study")
    return recordings_of(tuple(map(read_one, (given,) if isinstance(given, Recorded) else given)), "study")


def _model(rig: WrenchModel | Rig | None, recordings: Sequence[Recording]) -> WrenchModel:
    if isinstance(rig, WrenchModel):
        return rig
    if not recordings:
        raise InputError(what="no recording was given", where="recordings", remedy="give at least one")
    described = rig if rig is not None else recordings[0].rig
    return (planar if recordings[0].dimension == 2 else spatial)(described)
