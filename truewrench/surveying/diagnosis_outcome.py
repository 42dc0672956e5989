"""Outcome of one diagnosis as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from modeling.number_format import finite

if TYPE_CHECKING:
    from diagnosis.comparison.comparison import Comparison
    from diagnosis.diagnosis import Diagnosis
    from estimation.fit import Estimate

BIAS_PREFIX = "bias_"
"""Prefix of the bias parameters."""


@dataclass(frozen=True)
class StoredEstimate:
    """One parameter of an effect, or of the tool where `effect` is empty; None for a number that is not finite."""

    effect: str
    parameter: str
    value: float | None
    std: float | None
    unit: str

    @property
    def name(self) -> str:
        """`viscous_drag.c`, or `m` for the tool's."""
        return f"{self.effect}.{self.parameter}" if self.effect else self.parameter


@dataclass(frozen=True, kw_only=True)
class ChannelError:
    """Error of one channel with the rigid tool (before) and with the effects added (after), in `unit`.

    rms         of the residual over all raw samples
    systematic  the part that repeats with the motion or is slow, `explainable_rms` of result.json; None without repeats
    noise_floor std of one sample
    """

    channel: str
    unit: str
    noise_floor: float | None
    rms_before: float | None
    rms_after: float | None
    systematic_before: float | None
    systematic_after: float | None

    @property
    def before(self) -> float | None:
        """Systematic error with the rigid tool; the total RMS without repeats."""
        return self.rms_before if self.systematic_before is None else self.systematic_before

    @property
    def after(self) -> float | None:
        """The same with the effects added."""
        return self.rms_after if self.systematic_after is None else self.systematic_after


@dataclass(frozen=True, kw_only=True)
class DiagnosisOutcome:
    """Outcome of the diagnosis of one recording.

    verdict     of the record; None where there is an error
    sizes       of the effects added, each with its std
    parameters  of the tool with these effects, without biases; without std where it is not known
    tool_unknown  why the recording does not say what the tool weighs, empty where it does
    misfit      reduced chi-square with the effects added, `misfit_before` with the rigid tool; None where the noise
                was estimated from the residual
    seconds     duration of the diagnosis
    error       error message where there is no verdict; else empty
    final       whether a rerun would give the same outcome
    """

    verdict: str | None = None
    added: tuple[str, ...] = ()
    sizes: tuple[StoredEstimate, ...] = ()
    parameters: tuple[StoredEstimate, ...] = ()
    tool_unknown: str = ""
    misfit_before: float | None = None
    misfit: float | None = None
    channels: tuple[ChannelError, ...] = ()
    seconds: float | None = None
    error: str = ""
    final: bool = True

    @classmethod
    def of(cls, found: Diagnosis, *, seconds: float) -> DiagnosisOutcome:
        """The outcome of a diagnosis of one recording."""
        first, last = found.steps[0].training[0], found.steps[-1].training[0]
        findings = {f.effect.id: f for f in found.findings}
        tool = {n: e for n, e in found.fit.parameters.items() if "." not in n and not n.startswith(BIAS_PREFIX)}
        return cls(
            verdict=found.verdict.value,
            added=found.added,
            sizes=tuple(size for i in found.added for size in _stored_estimates(i, findings[i].parameters)),
            parameters=tuple(replace(e, std=None) if found.tool_unknown else e for e in _stored_estimates("", tool)),
            tool_unknown=found.tool_unknown,
            misfit_before=finite(first.misfit),
            misfit=finite(last.misfit),
            channels=tuple(_channels(first, last)),
            seconds=seconds,
        )

    @property
    def loudest(self) -> ChannelError | None:
        """Channel with the largest error-to-noise ratio with the rigid tool."""
        known = [c for c in self.channels if c.before is not None and c.noise_floor]
        return max(known, key=lambda c: (c.before or 0.0) / (c.noise_floor or 1.0), default=None)


def _stored_estimates(effect: str, estimates: Mapping[str, Estimate]) -> list[StoredEstimate]:
    return [StoredEstimate(effect, name, finite(e.value), finite(e.std), e.unit) for name, e in estimates.items()]


def _channels(first: Comparison, last: Comparison) -> list[ChannelError]:
    systematic = [c.explainable_rms or {} for c in (first, last)]
    return [
        ChannelError(
            channel=channel,
            unit=unit,
            noise_floor=finite(last.noise_floor[channel]),
            rms_before=finite(first.rms[channel]),
            rms_after=finite(last.rms[channel]),
            systematic_before=finite(systematic[0].get(channel)),
            systematic_after=finite(systematic[1].get(channel)),
        )
        for channel, unit in first.space.channel_units.items()
    ]
