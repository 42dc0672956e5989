"""Calibration: how often a diagnosis of one recording names an effect that is not there, and one that is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from diagnosis.verdict_rule import RecordVerdict
from estimation.multiplicity import binomial_interval, binomial_sf
from estimation.recordings.recording import Recording, readings_digest
from modeling.errors import InputError
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular

# Rate: a number of events among so many surrogates, with its exact interval and test.


@dataclass(frozen=True)
class Rate:
    """A number of events among so many surrogates."""

    count: int
    total: int

    @property
    def share(self) -> float:
        """The estimated probability."""
        return self.count / max(self.total, 1)

    @property
    def interval(self) -> tuple[float, float]:
        """Its exact 95 % confidence interval (Clopper and Pearson, 1934)."""
        return binomial_interval(self.count, self.total, LEVELS.confidence)

    def exceeds(self, probability: float) -> bool:
        """Whether so many events are too many for that probability (one-sided, `LEVELS.miscalibrated`)."""
        return binomial_sf(self.count, self.total, probability) < LEVELS.miscalibrated

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.count} of {self.total} (95 % interval {100 * low:.2g} to {100 * high:.2g} %)"

    def to_data(self) -> dict[str, Any]:
        """Count, total, share and interval."""
        return {"count": self.count, "total": self.total, "rate": self.share, "interval": list(self.interval)}


@dataclass(frozen=True)
class EffectPower:
    """How often an effect is detected that is hidden at the amount of which 80 % are to be detected."""

    effect: str
    parameter: str
    amount: float
    unit: str
    detected: Rate

    def to_data(self) -> dict[str, Any]:
        """As in the JSON of `truewrench calibrate`."""
        return {"parameter": self.parameter, "amount": self.amount, "unit": self.unit, **self.detected.to_data()}


@dataclass(frozen=True, eq=False)
class Calibration(Tabular):
    """False-alarm rate and power of the diagnosis of one recording, by surrogates of it.

    recording   its name, `digest` the SHA-256 of its readings
    model       ids of the effects in the model that the surrogates are made of
    verdict     of the recording itself, with that model
    alarms      surrogates in which an effect was named though none is missing
    misfits     surrogates called unexplained or partly explained
    refused     surrogates on which the diagnosis ended in an error
    named       how often each effect was named among the alarms
    power       of each effect that is identifiable
    candidates  ids of the candidate effects; None where an old file does not say
    """

    recording: str
    digest: str
    model: tuple[str, ...]
    verdict: RecordVerdict
    alarms: Rate
    misfits: Rate
    refused: int
    named: Mapping[str, int]
    power: tuple[EffectPower, ...]
    candidates: tuple[str, ...] | None = None

    @property
    def holds(self) -> bool:
        """Whether false alarms are not shown to be more than twice as many as stated."""
        return not self.alarms.exceeds(2 * LEVELS.effect)

    @property
    def table(self) -> Table:
        """Each effect hidden at its detectable amount: how often it was detected."""
        rows = [
            (p.effect, p.parameter, p.amount, p.unit, f"{p.detected.count} of {p.detected.total}", *p.detected.interval)
            for p in self.power
        ]
        columns = ("effect", "hidden", Column("amount", format=".3g"), "unit", "detected")
        return Table.of((*columns, Column("from", format=".0%"), Column("to", format=".0%")), rows)

    def printed(self) -> list[Table | str]:
        """The false-alarm rate, then the power."""
        effects = f", with {', '.join(self.model)}" if self.model else ""
        head = f"{self.recording}: {self.alarms.total} surrogates of the fitted model{effects}, noise like its residual"
        return [head, *self.sentences, *([self.table] if self.power else [])]

    @property
    def sentences(self) -> list[str]:
        """What a verdict page quotes."""
        named = ", ".join(f"{effect} {count}" for effect, count in sorted(self.named.items()))
        lines = [
            f"false alarms: {self.alarms}{f': {named}' if named else ''}; stated {LEVELS.effect:.0%}",
            f"false lack of fit: {self.misfits}; stated {LEVELS.effect:.0%}",
        ]
        if self.refused:
            lines.append(f"{self.refused} surrogates could not be diagnosed")
        if not self.holds:
            lines.append("false alarms are more than twice as many as stated: p-values of this recording do not hold")
        if self.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED):
            lines.append(f"the recording itself is {self.verdict.value}: its residual is no noise alone")
        return lines

    def other_candidates(self, candidates: Iterable[str]) -> str:
        """A sentence where a diagnosis had other candidate effects than the calibration; empty where it had the same.

        Fewer candidates give fewer false alarms, and a higher power.
        """
        ours, theirs = set(self.candidates or ()), set(candidates)
        if self.candidates is None or ours == theirs:
            return ""
        return f"it was made with {len(ours)} candidate effects, and this diagnosis has {len(theirs)}: its rates differ"

    def require_of(self, recordings: Iterable[Recording]) -> None:
        """Raise InputError unless it is a calibration of one of these recordings, by its readings."""
        if self.digest not in map(readings_digest, recordings):
            what = f"the calibration was made of other readings, those of {self.recording}"
            raise InputError(what=what, where="calibration", remedy="run `truewrench calibrate` on this recording")

    def to_data(self) -> dict[str, Any]:
        """The JSON of `truewrench calibrate`."""
        return {
            "recording": self.recording,
            "sha256": self.digest,
            "model": list(self.model),
            "verdict": self.verdict.value,
            "nominal": LEVELS.effect,
            "false_alarms": self.alarms.to_data(),
            "false_lack_of_fit": self.misfits.to_data(),
            "refused": self.refused,
            "named": dict(self.named),
            "holds": self.holds,
            "power": {p.effect: p.to_data() for p in self.power},
            **({} if self.candidates is None else {"candidates": list(self.candidates)}),
        }
