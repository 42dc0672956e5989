"""Diagnosis: fit, screen, select, validate; verdict on the recordings and on every effect of the catalogue."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.acceptance import accept
from diagnosis.calibration import Calibration
from diagnosis.comparison.compared_step import noise_floors
from diagnosis.comparison.comparison import Comparison, noise_from_residual
from diagnosis.comparison.slow_residual import SlowResidual, lacks_acceleration, slow_residuals
from diagnosis.comparison.validation import zero_shift
from diagnosis.held_out import HeldOut, RecordingDisturbance, disturbances_of, with_disturbances
from diagnosis.progress import Progress, silent
from diagnosis.screening.null_model import ScreeningCache
from diagnosis.screening.score_test import model_initial_values, screen, significant_effects
from diagnosis.subset_search import CandidateModel, SubsetSearch, search_subsets
from diagnosis.verdict.aliasing import (
    GivenAlternative,
    channel_tolerance,
    contribution_upper_limit,
    given_alternatives,
    within_tolerance,
)
from diagnosis.verdict.finding import EFFECT_RULES, EffectRule, Finding, judge_effects
from diagnosis.verdict.selection_step import (
    SelectionStep,
    explainable_power_by_step,
    removed_share_by_steps,
    selection_steps,
)
from diagnosis.verdict.unexplained_residual import UnexplainedResidual, describe_residual, unknown_tool_reason
from diagnosis.verdict_rule import RecordVerdict, VerdictRule, judge
from estimation.case import Case
from estimation.contact.rows_left_out import RowsLeftOut, rows_left_out
from estimation.fit import (
    MAX_NOISE_ROUNDS,
    Fit,
    Loads,
    in_noise_beside_pose,
    loaded,
    recordings_of,
    require_positive_fitted_mass,
    unchecked_fit,
)
from estimation.gravity.gravity_estimate import GravityEstimate
from estimation.least_squares.estimates import estimates_data
from estimation.multiplicity import bonferroni_p_value
from estimation.recordings.recording import Recording, require_different_readings
from modeling.chain.effect import Effect, effects_of
from modeling.chain.model import WrenchModel, require_model
from modeling.effects import catalogue
from modeling.effects.geometry import GravityTilt
from modeling.noise import NoiseSource
from modeling.number_format import P_VALUE, SHARE, finite
from modeling.parameter import Role
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular

if TYPE_CHECKING:
    from diagnosis.averaging import ModelAverage
    from estimation.readings.doubted_reading import DoubtedReading


# Verdict rules on the recordings as a whole.


@dataclass(frozen=True, kw_only=True)
class RecordEvidence:
    """Evidence on the recordings, with the final model.

    lack_of_fit           p-value in training, corrected for the number of recordings
    held_out_lack_of_fit  smallest p-value over the held-out recordings, 1 without any
    effects               number of effects added
    transients            number of those that begin at a time of their own
    unaccepted            whether, in noise that is estimated from the residual, some effect was significant in the
                          search: the lack-of-fit test has little power there
    slow                  whether a slow part of a single run's residual exceeds the noise: drift or slow physics
    removed_share         what the effects removed of a single run's residual, over that and what remains of it in the
                          band of the motion beyond 1/f noise; 1 where the noise is known
    within_tolerance      whether the systematic error is within tolerance in every channel of every recording, of a
                          held-out one without what errors of the estimates kept explain
    power_share           systematic power of the final model's residual over that of the rigid tool's
    unrepeated            whether more than noise differs between the repeats: events that no effect explains, or twice
                          the noise that was estimated, by which no p-value holds
    deviates_outside      whether the readings differ from the model outside the whole repeats that were cut from a log
    misread               whether another reading of the recordings is shown and not adopted
    unrecorded_acceleration  whether a residual looks like mass times an acceleration that was not recorded, which no
                          test shows where the noise is estimated from that residual
    """

    lack_of_fit: float
    held_out_lack_of_fit: float = 1.0
    effects: int = 0
    transients: int = 0
    unaccepted: bool = False
    slow: bool = False
    removed_share: float = 1.0
    within_tolerance: bool = False
    power_share: float = 1.0
    deviates_outside: bool = False
    unrecorded_acceleration: bool = False
    misread: bool = False
    unrepeated: bool = False

    @property
    def adequate(self) -> bool:
        """Whether no lack of fit is significant, neither in training nor on held-out data, and nothing else remains."""
        if self.slow or self.unrecorded_acceleration or self.deviates_outside or self.unrepeated:
            return False
        return self.lack_of_fit >= LEVELS.effect and self.held_out_lack_of_fit >= LEVELS.held_out


RecordRule = VerdictRule[RecordEvidence, RecordVerdict]
V = RecordVerdict
RECORD_RULES: tuple[RecordRule, ...] = (
    VerdictRule("the recordings seem to be read wrongly", lambda e: e.misread, V.UNEXPLAINED),
    VerdictRule(
        "adequate without effects", lambda e: not e.effects and e.adequate and not e.unaccepted, V.NOTHING_MISSING
    ),
    VerdictRule("no effect accepted", lambda e: not e.effects, V.UNEXPLAINED),
    VerdictRule(
        "a single run of which little was removed", lambda e: e.adequate and e.removed_share < 0.5, V.PARTLY_EXPLAINED
    ),
    VerdictRule("no lack of fit", lambda e: e.adequate, V.EXPLAINED),
    VerdictRule(
        "error within tolerance",
        lambda e: e.within_tolerance and not (e.deviates_outside or e.unrepeated),
        V.EXPLAINED,
    ),
    VerdictRule(
        "several events, of which some are left",
        lambda e: e.unrepeated and e.transients > 1,
        V.UNEXPLAINED,
        "other events are left beside it, so that nothing tells which of them it is",
    ),
    VerdictRule("systematic power at least halved", lambda e: e.power_share <= 0.5, V.PARTLY_EXPLAINED),
    VerdictRule(
        "more than half of the systematic power remains",
        lambda e: True,
        V.UNEXPLAINED,
        "it removes less than half of the systematic error, and the residual stays significant",
    ),
)
"""In order; a model without effects ends at the second rule."""


# Parts of result.json that are no results of their own.


def disturbance_data(disturbance: RecordingDisturbance) -> dict[str, Any]:
    """A recording-specific disturbance as plain data."""
    return {
        "recording": disturbance.recording.name,
        "id": disturbance.effect.id,
        "swing": dict(disturbance.swing),
        "parameters": estimates_data(disturbance.parameters),
    }


def unexplained_data(residual: UnexplainedResidual) -> dict[str, Any]:
    """The unexplained residual as plain data."""
    return {
        "where": residual.where,
        "explainable_rms": dict(residual.explainable_rms),
        "looks_like": list(residual.looks_like),
        "share": residual.share,
    }


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Diagnosis(Tabular):
    """Result of a diagnosis of the recordings of one rig and tool.

    steps         selection steps, from the model given to the last effect added
    findings      one for every candidate effect, the added ones first
    zero_shift    change of each channel's bias on the first held-out recording, None without one
    disturbances  recording-specific disturbances of the held-out recordings: drift, contact
    unexplained   the unexplained residual and where it is significant, None when the recordings are explained
    calibration   of one of the training recordings, None unless it was given (`calibrated`)
    gravity       gravity's direction in base axes where the data decided it, None where it is stated or points down
    tilt_fitted   whether the model has `gravity_tilt` for that direction alone, and was not given with it
    given_alternatives  other effects that fit as well, or better, in the place of a given one
    rows_left_out  rows outside the whole repeats that were cut from logs, which the verdict is about only as a whole
    readings      other readings of the recordings that are shown: adopted, or proposed and then no effect is looked for
    """

    model: WrenchModel
    verdict: RecordVerdict
    steps: tuple[SelectionStep, ...]
    findings: tuple[Finding, ...]
    zero_shift: Mapping[str, float] | None
    disturbances: tuple[RecordingDisturbance, ...]
    tolerance: Mapping[str, float]
    unexplained: UnexplainedResidual | None
    calibration: Calibration | None = None
    gravity: GravityEstimate | None = None
    given_alternatives: tuple[GivenAlternative, ...] = ()
    rows_left_out: tuple[RowsLeftOut, ...] = ()
    readings: tuple[DoubtedReading, ...] = ()
    tilt_fitted: bool = False

    @property
    def fit(self) -> Fit:
        """The final fit, with every added effect."""
        return self.steps[-1].fit

    @property
    def given(self) -> tuple[str, ...]:
        """Ids of the effects of the model given, which were not judged."""
        fitted = GravityTilt.id if self.tilt_fitted else None
        return tuple(e.id for e in self.steps[0].fit.model.effects if e.id != fitted)

    @property
    def added(self) -> tuple[str, ...]:
        """Ids of the effects added, in order of selection."""
        return tuple(s.effect for s in self.steps if s.effect is not None)

    @cached_property
    def lack_of_fit(self) -> float:
        """Bonferroni-corrected p-value of the final model's lack of fit over the training recordings."""
        return lack_of_fit(self.steps[-1].training)

    @property
    def stated_lack_of_fit(self) -> float | None:
        """The p-value of the final model's lack of fit; None where p-values do not hold."""
        return None if self.calibration is not None and not self.calibration.holds else self.lack_of_fit

    def calibrated(self, calibration: Calibration) -> Diagnosis:
        """The same diagnosis with a calibration of one of its training recordings.

        p-values are withheld where false alarms are shown to be more than twice as frequent as stated. Raises
        InputError for a calibration of another recording.
        """
        calibration.require_of(self.fit.recordings)
        findings = self.findings if calibration.holds else tuple(replace(f, p_value=None) for f in self.findings)
        return replace(self, calibration=calibration, findings=findings)

    @property
    def calibration_sentences(self) -> list[str]:
        """What a verdict page quotes of the calibration, and whether it was made with other candidate effects."""
        if self.calibration is None:
            return []
        remark = self.calibration.other_candidates(finding.effect.id for finding in self.findings)
        return [*self.calibration.sentences, *([remark] if remark else [])]

    @property
    def misfitting(self) -> tuple[str, ...]:
        """The recordings that the final model does not explain; all fitted ones, if the verdict names none."""
        if self.verdict in (RecordVerdict.NOTHING_MISSING, RecordVerdict.EXPLAINED):
            return ()
        return self.steps[-1].misfitting or tuple(r.name for r in self.fit.recordings)

    @cached_property
    def tool_unknown(self) -> str:
        """Why the readings do not say what the tool weighs, empty where they do."""
        return unknown_tool_reason(self.steps[-1].training, self.fit.model)

    @cached_property
    def averaged(self) -> ModelAverage:
        """The estimates with the doubt between the effects added and those that are confusable with them."""
        from diagnosis.averaging import ModelAverage  # refits of their own, where there are such effects

        known = not self.tool_unknown
        return ModelAverage.of(self.steps[-1], self.findings, self.disturbances, tool_known=known)

    @cached_property
    def slow_residuals(self) -> tuple[SlowResidual, ...]:
        """The significant slow parts of the residuals of single runs, with the final model."""
        return slow_residuals(self.steps[-1].training)

    @cached_property
    def removed_share(self) -> float:
        """Share that the effects removed of the residuals of single runs, beyond noise; 1 where the noise is known."""
        return removed_share_by_steps(self.steps)

    @property
    def table(self) -> Table:
        """Effect, verdict, p-value, share of the systematic error removed where it is significant, and reason."""
        numbers = (Column("p", format=P_VALUE), Column("error removed", format=SHARE))
        rows = [(f.effect.id, f.verdict.value, f.p_value, f.significant_share, f.reason) for f in self.findings]
        return Table.of(("effect", "verdict", *numbers, "reason"), rows)

    def remarks(self) -> list[str]:
        """Doubt between effects, alternatives to given ones, gravity, disturbances, where a residual is significant."""
        alternatives = [alternative.sentence for alternative in self.given_alternatives]
        gravity = [] if self.gravity is None else [self.gravity.sentence]
        unexplained = [f"residual: {self.unexplained.where}"] if self.unexplained else []
        readings = [doubted.sentence for doubted in self.readings]
        doubts = self.averaged.sentences
        return [*readings, *doubts, *alternatives, *gravity, *map(str, self.disturbances), *unexplained]

    def printed(self) -> list[Table | str]:
        """Verdict, comparison with the first recording, candidate effects."""
        head = f"verdict: {self.verdict.value}" + (f" ({', '.join(self.added)})" if self.added else "")
        head += f", given {', '.join(self.given)}" if self.given else ""
        return [head, *self.steps[-1].training[0].printed(), *super().printed()]

    def to_data(self) -> dict[str, Any]:
        """The `result.json` of this diagnosis: numbers are finite or None."""
        from estimation.centre_of_mass import centre_of_mass_data  # of results that are written
        from modeling.chain.sensor_axes import axes_data

        first = self.steps[0].training[0]
        data = {
            "channels": list(first.recording.channels),
            "convention": self.model.convention.value,
            "verdict": self.verdict.value,
            "noise_floor": noise_floors([s.training[0] for s in self.steps]),
            "noise_source": first.noise.source.value,
            "given": list(self.given),
            "given_alternatives": [a.to_data() for a in self.given_alternatives],
            "added": list(self.added),
            "lack_of_fit_p": self.stated_lack_of_fit,
            "converged": self.fit.converged,
            "removed_share": self.removed_share,
            "slow_residual": [s.to_data() for s in self.slow_residuals],
            "steps": [s.to_data() for s in self.steps],
            "effects": [f.to_data() for f in self.findings],
            "parameters": estimates_data(self.fit.parameters),
            "axes": axes_data(self.fit.model, self.fit.theta),
            "centre_of_mass": centre_of_mass_data(self.fit, unknown=self.tool_unknown),
            "tool_unknown": self.tool_unknown or None,
            "zero_shift": None if self.zero_shift is None else dict(self.zero_shift),
            "validation_own": [disturbance_data(d) for d in self.disturbances] if self.steps[0].validation else None,
            "unexplained": None if self.unexplained is None else unexplained_data(self.unexplained),
            "calibration": None if self.calibration is None else self.calibration.to_data(),
        }
        data["readings"] = [doubted.to_data() for doubted in self.readings]
        data |= {} if self.gravity is None else {"gravity": self.gravity.to_data()}
        average = self.averaged
        of_several = len(average.members) > 1 or average.left_out or average.unfitted
        data |= {"averaged": average.to_data()} if of_several else {}
        data |= {"rows": [rows.to_data() for rows in self.rows_left_out]} if self.rows_left_out else {}
        plain: dict[str, Any] = finite(data)
        return plain


def diagnose(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording] | Mapping[str, Recording],
    *,
    validate: Recording | Iterable[Recording] | Mapping[str, Recording] | None = None,
    loads: Loads | None = None,
    effects: Sequence[Effect | str] | None = None,
    effect_rules: Sequence[EffectRule] = EFFECT_RULES,
    progress: Progress = silent,
    workers: int = 1,
) -> Diagnosis:
    """Identify the physical effects that a rigid-tool model lacks, from its recordings.

    Parameters
    ----------
    model : WrenchModel
        The rigid tool, `planar(rig)` or `spatial(rig)`. Effects that it has are given: they stay, and are not judged.
    recordings : Recording, iterable of Recording, or mapping of str to Recording
        Recordings of one rig and sensor, which the models are fitted to, perhaps by name.
    validate : Recording, iterable of Recording, or mapping of str to Recording, optional
        Held-out recordings of other motions of the same rig and tool, never fitted; by default none.
    loads : mapping of str to Load or str, or to several, optional
        What the sensor carried beside the tool in a recording, by its name, as for `fit`; by default nothing.
    effects : sequence of Effect or str, optional
        The candidate effects, or their ids; by default the whole catalogue.
    effect_rules : sequence of EffectRule, optional
        Verdict rules on an effect, in order: the first that applies decides.
    progress : callable, optional
        Called with one line of text at each stage; by default silent.
    workers : int, optional
        Without effect: a diagnosis runs in one process. Accepted for programs that state it.

    Returns
    -------
    Diagnosis
        Verdict on the recordings, effects added, the final fit, and a finding for every candidate effect.

    Raises
    ------
    InputError
        When a signal of the model is not recorded, the sign convention cannot be decided, the estimated mass is
        negative, or a recording is given twice.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> candidates = [tw.effects.named("viscous_drag"), tw.effects.named("sensor_lag")]
    >>> found = tw.diagnose(tw.planar(rig), tw.read("train.csv", rig=rig), effects=candidates)
    >>> found.verdict.value, found.added
    ('explained', ('viscous_drag',))
    >>> [(f.effect.id, f.verdict.value) for f in found.findings]
    [('viscous_drag', 'supported'), ('sensor_lag', 'negligible')]
    """
    require_model(model, "diagnose")
    training, others = recordings_of(recordings, "diagnose"), recordings_of(validate, "validate")
    both = loaded((*training, *others), loads or {})
    training, others = both[: len(training)], both[len(training) :]
    require_different_readings((*training, *others), "diagnose")
    candidates = None if effects is None else effects_of(effects)
    case = Case.of(model, training, others)
    return diagnose_case(case, effects=candidates, effect_rules=effect_rules, progress=progress)


def diagnose_case(
    case: Case,
    *,
    effects: Sequence[Effect] | None = None,
    effect_rules: Sequence[EffectRule] = EFFECT_RULES,
    progress: Progress = silent,
) -> Diagnosis:
    """`diagnose` of a case, on one thread of linear algebra: its matrices are tall and thin, and threads only slow."""
    from threadpoolctl import threadpool_limits  # the libraries of linear algebra have to be loaded before

    with threadpool_limits(1):
        proposed = [doubted for doubted in case.readings if not doubted.adopted]
        if case.misread and all(doubted.explained_by for doubted in proposed):
            progress("effects that may explain what is doubted of the log")
            diagnosis = _diagnosed(replace(case, readings=()), effects, effect_rules, progress)
            if all(_explains(diagnosis, doubted) for doubted in proposed):
                return _with_explained(diagnosis, case.readings)
        return _diagnosed(case, effects, effect_rules, progress)


def _explains(diagnosis: Diagnosis, doubted: DoubtedReading) -> bool:
    """Whether an effect that was added says the same as a reading, or explains the rows that did not belong."""
    from estimation.readings.row_reading import pose_outlier  # of few recordings

    if not doubted.has_rivals:
        return doubted.explained_by in diagnosis.added
    left = [r.with_readings(own) for r, own in zip(diagnosis.fit.recordings, diagnosis.fit.residuals, strict=True)]
    return diagnosis.verdict is RecordVerdict.EXPLAINED and pose_outlier(left) is None


def _with_explained(diagnosis: Diagnosis, readings: Sequence[DoubtedReading]) -> Diagnosis:
    """The diagnosis with the readings that its effects explain: adopted where one says the same, else its rival."""
    rivals = [doubted for doubted in readings if doubted.has_rivals]
    without = "; ".join(f"without it {doubted.meaning}, and {doubted.statement}" for doubted in rivals)
    findings = (replace(f, reason=without if f.effect.id in diagnosis.added else f.reason) for f in diagnosis.findings)
    said = (r if r.adopted else replace(r, adopted=True, mends=False) for r in readings if r not in rivals)
    return replace(diagnosis, readings=tuple(said), findings=tuple(findings) if rivals else diagnosis.findings)


@dataclass(frozen=True, eq=False)
class _Outcome:
    """A model of a search, and what the verdict on the recordings is judged by.

    candidate  the model; `held_out` the held-out recordings with their own disturbances given that model
    misread    whether another reading of the recordings is proposed
    """

    selection: SubsetSearch
    candidate: CandidateModel
    held_out: tuple[HeldOut, ...]
    misread: bool = False

    @cached_property
    def steps(self) -> tuple[SelectionStep, ...]:
        """From the model given to this one."""
        return selection_steps(self.selection, self.candidate, self.held_out)

    @property
    def fit(self) -> Fit:
        """The fit of the last step, as it is reported."""
        return self.steps[-1].fit

    @cached_property
    def tolerance(self) -> Mapping[str, float]:
        """Error that the user does not care about, by channel."""
        return channel_tolerance(self.fit)[0]

    @cached_property
    def power(self) -> Array:
        """Systematic power after each step."""
        return explainable_power_by_step(self.steps, self.candidate)

    @cached_property
    def rows_left_out(self) -> tuple[RowsLeftOut, ...]:
        """Rows outside the whole repeats that were cut from logs."""
        return rows_left_out(self.fit)

    @property
    def evidence(self) -> RecordEvidence:
        """The evidence on the recordings."""
        last = self.steps[-1]
        within = (
            compared.beyond_parameters is not None and within_tolerance(compared.beyond_parameters, self.tolerance)
            for compared in (*last.training, *last.validation)
        )
        return RecordEvidence(
            lack_of_fit=lack_of_fit(last.training),
            held_out_lack_of_fit=min((c.lack_of_fit for c in last.validation), default=1.0),
            effects=len(self.candidate.ids),
            transients=sum(e.has_role(Role.ONSET, last.fit.model.space) for e in self.candidate.added),
            unaccepted=noise_from_residual(self.candidate.fit) and len(self.selection.tried) > 1,
            slow=any(s.above_noise for s in slow_residuals(last.training)),
            removed_share=removed_share_by_steps(self.steps),
            within_tolerance=all(within),
            power_share=float(self.power[-1] / max(self.power[0], 1e-300)),
            deviates_outside=any(left_out.deviations for left_out in self.rows_left_out),
            misread=self.misread,
            unrepeated=any(compared.differs_between_repeats for compared in last.training),
            unrecorded_acceleration=any(lacks_acceleration(c, self.candidate.fit.model) for c in last.training),
        )

    @property
    def zero_shift(self) -> Mapping[str, float] | None:
        """Change of each channel's bias on the first held-out recording, None without one."""
        final = self.candidate.fit
        return zero_shift(final, self.held_out[0].validation_fit(final)) if self.held_out else None

    @property
    def disturbances(self) -> tuple[RecordingDisturbance, ...]:
        """Recording-specific disturbances of the held-out recordings."""
        return tuple(d for held_out in self.held_out for d in disturbances_of(held_out, self.candidate.fit))


def _diagnosed(
    case: Case, effects: Sequence[Effect] | None, effect_rules: Sequence[EffectRule], progress: Progress
) -> Diagnosis:
    """Fit, search, accept on held-out data, judge the recordings, judge the effects."""
    cache, model = ScreeningCache(), case.model
    given = {effect.id for effect in model.effects}
    told = catalogue(model.space, weighed=case.weighed, warmed=case.warmed)
    candidates = [e for e in (told if effects is None else effects) if e.id not in given and model.space in e.spaces]
    candidates = [] if case.misread else candidates  # what would be found explains the mistake
    progress("fit the rigid tool" + "".join(f", {effect.id}" for effect in model.effects))
    base = in_noise_beside_pose(unchecked_fit(case, start=model_initial_values(case) if model.effects else {}))
    held_out = [HeldOut(r, n) for r, n in zip(case.held_out, case.held_out_noise, strict=True)]
    selection = _selected(base, candidates, progress, cache)
    progress("check the selected effects on held-out data")
    chosen = _without_negligible(selection.chosen, *channel_tolerance(base))
    acceptance = accept(chosen, selection.base, held_out, candidates)
    reasons = dict(acceptance.reasons)
    outcome = _Outcome(selection, acceptance.candidate, acceptance.held_out, case.misread)
    verdict, reason = judge(RECORD_RULES, outcome.evidence)
    if verdict is RecordVerdict.UNEXPLAINED and outcome.candidate.ids:
        reasons |= dict.fromkeys(sorted(outcome.candidate.ids), reason)
        disturbed = tuple(with_disturbances(h, selection.base.fit, candidates, cache) for h in held_out)
        outcome = _Outcome(selection, selection.base, disturbed)
    if case.is_of_tool:
        require_positive_fitted_mass(outcome.fit)
    progress("verdict, upper limit and aliases of every effect")
    final, steps = outcome.candidate, outcome.steps
    alternatives = given_alternatives(final, candidates)
    findings = judge_effects(
        selection, final, steps, outcome.power, reasons, candidates, outcome.tolerance, effect_rules
    )
    unexplained = None
    if verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED):
        unexplained = _unexplained(steps[-1], outcome.tolerance, outcome.rows_left_out)
        if case.misread:
            sentences = [doubted.sentence for doubted in case.readings if not doubted.adopted]
            unexplained = replace(unexplained, where=" ".join(sentences))
    zero_shift_of_held_out, disturbances = outcome.zero_shift, outcome.disturbances
    final.cache.forget()
    return Diagnosis(
        final.fit.model, verdict, steps, findings, zero_shift_of_held_out, disturbances, outcome.tolerance, unexplained,
        gravity=case.with_fitted_gravity(final.fit.model, outcome.fit.values).gravity,
        given_alternatives=alternatives, rows_left_out=outcome.rows_left_out,
        readings=case.readings, tilt_fitted=case.tilt_fitted,
    )  # fmt: skip


def _selected(base: Fit, candidates: Sequence[Effect], progress: Progress, cache: ScreeningCache) -> SubsetSearch:
    """The subset search, in the noise beside the events of repeats.

    First transient effects alone explain the events that were detected: detection, refit and noise alternate until the
    noise stays the same. The search of all effects is repeated where what it attributes to transients had still been
    attributed to noise.
    """
    from estimation.transients import noise_beside_unexplained_events, noise_without_transients  # of effects alone

    transients = [effect for effect in candidates if effect.has_role(Role.ONSET, base.model.space)]
    detected = any(noise.source is NoiseSource.REPEATS and noise.events for noise in base.noise)
    for _ in range(MAX_NOISE_ROUNDS if detected and transients else 0):
        progress("events, and the noise beside them")
        chosen = search_subsets(base, transients, silent, cache).chosen
        noise = noise_without_transients(chosen.fit) if chosen.ids else noise_beside_unexplained_events(base)
        if noise is None:
            break
        cache.forget()
        base, cache = base.in_noise(noise), cache.in_other_noise()
    of_run = transients and noise_from_residual(base) and any(noise.events for noise in base.noise)
    if of_run and not significant_effects(screen(base, transients, cache=cache)):
        # the noise of a run's event is what the tip lacks there, in which an effect that explains it may not show
        progress("events, and the noise beside them")
        outside = base.in_noise([noise.without_events for noise in base.noise])
        chosen = search_subsets(outside, transients, silent, cache.in_other_noise()).chosen
        base = base.in_noise(chosen.fit.noise) if chosen.ids else base
    selection = search_subsets(base, candidates, progress, cache)
    noise = noise_without_transients(selection.chosen.fit)
    if noise is None:
        return selection
    cache.forget()
    progress("re-estimate the noise, and repeat the search")
    return search_subsets(base.in_noise(noise), candidates, progress, cache.in_other_noise())


def _without_negligible(candidate: CandidateModel, tolerance: Mapping[str, float], stated: bool) -> CandidateModel:
    """The candidate without the effects whose upper limit is within the stated tolerance."""
    if not stated:
        return candidate
    for effect in candidate.added:
        without = candidate.without(effect.id)
        (screening,) = screen(without.fit, [effect], candidates=candidate.candidates, cache=candidate.cache)
        if screening.excited and within_tolerance(
            contribution_upper_limit(without.fit, screening, candidate.cache), tolerance
        ):
            return _without_negligible(without, tolerance, stated)
    return candidate


def lack_of_fit(compared: Sequence[Comparison]) -> float:
    """P-value of lack of fit in any of the recordings, Bonferroni-corrected for their number."""
    return bonferroni_p_value([c.lack_of_fit for c in compared])


def _unexplained(
    step: SelectionStep, tolerance: Mapping[str, float], rows: Sequence[RowsLeftOut]
) -> UnexplainedResidual:
    """Unexplained residual of the recording that fits worst: a training one, unless only held-out ones lack fit, or
    only the readings outside the repeats differ from the model."""
    fitted = min(step.training, key=lambda c: c.lack_of_fit)
    held_out = min(step.validation, key=lambda c: c.lack_of_fit, default=fitted)
    if fitted.lack_of_fit >= LEVELS.effect and held_out.lack_of_fit < LEVELS.held_out:
        return describe_residual(held_out, tolerance, fitted=False)
    disturbed = next((c for c in step.training if c.events_left), None)
    if disturbed is not None:
        spans = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in disturbed.events_left)
        name, which = disturbed.recording.name, "which no effect explains"
        where = f"one repeat of {name} deviates from the others from {spans}, {which}"
        if disturbed.recording.repeats == 2:
            where = f"the two repeats of {name} differ from {spans}, or at that place of the other one, {which}"
        return replace(describe_residual(disturbed, tolerance), where=where)
    pushed = next((c for c in step.training if c.noise.source is NoiseSource.RESIDUAL and c.noise.events), None)
    if pushed is not None and not any(e.has_role(Role.ONSET, step.fit.model.space) for e in step.fit.model.effects):
        spans = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in pushed.noise.events)
        where = f"{pushed.recording.name} differs from what the tool reads from {spans}, which no effect explains"
        return replace(describe_residual(pushed, tolerance), where=where)
    slow = next((s for s in slow_residuals(step.training) if s.above_noise), None)
    outside = next((left_out for left_out in rows if left_out.deviations), None)
    if outside is not None and slow is None and fitted.lack_of_fit >= LEVELS.effect:
        return UnexplainedResidual(
            where=f"outside the whole repeats of {outside.name}, {outside.deviation}",
            channel=fitted.recording.channels[0], looks_like=(), share=0.0,
            explainable_rms=dict.fromkeys(fitted.recording.channels),
        )  # fmt: skip
    if slow is None or (fitted.lack_of_fit < LEVELS.effect and not slow.wanders):
        return describe_residual(fitted, tolerance)
    shown = next(c for c in step.training if c.recording.name == slow.recording)
    return replace(describe_residual(shown, tolerance, channel=slow.loudest), where=slow.sentence)
