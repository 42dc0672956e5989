"""Unexplained residual: the map where it is most significant, and a sparse regression on generic terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison, generic_terms, standardised_columns, term_in_words
from diagnosis.comparison.residual_map import ResidualMap, residual_maps
from diagnosis.comparison.slow_residual import foreign_forces, inertial_share, lacks_acceleration
from diagnosis.comparison.steadiness import ResidualSpectrum
from estimation.recordings.motion_limits import motion_limits
from modeling.chain.model import WrenchModel

# What the recorded motion leaves unknown in a diagnosis, and whether the residual is that.


def motion_notes(comparisons: Sequence[Comparison], model: WrenchModel) -> list[str]:
    """One line for each thing that the motion of a fitted recording leaves unknown."""
    lines = []
    for comparison in comparisons:
        limits = motion_limits(comparison.recording)
        lines += [f"{comparison.recording.name}: {limit}." for limit in limits]
        if lacks_acceleration(comparison, model):
            share = inertial_share(comparison, model)
            lines.append(
                f"{comparison.recording.name}: the residual looks like mass times an acceleration that was not "
                f"recorded: its torque is that of a force through one point ({share:.0%} of its power), the centre of "
                "mass; log the position. A contact at one point, a load that changes and an error of the recorded "
                "orientation can have such a torque, too."
            )
    return lines


# Why readings do not say what the tool weighs.


FOREIGN = "is not the tool's: contact, another load or a disturbance"
UNRECORDED = (
    "what the model lacks looks like an acceleration that was not recorded (log the position), a contact, a load that"
    " changes or an error of the recorded orientation"
)


def unknown_tool_reason(comparisons: Sequence[Comparison], model: WrenchModel) -> str:
    """Why the readings do not say what the tool weighs, empty where those of one recording do."""
    others = [c for c in comparisons if not lacks_acceleration(c, model)]
    foreign = foreign_forces(others)
    if others and not foreign:
        return ""
    reasons = [UNRECORDED] if len(others) < len(comparisons) else []
    reasons += [f"most of what {', '.join(foreign)} read {FOREIGN}"] if foreign else []
    return "; ".join(reasons)


def unknown_tool_sentences(reason: str) -> tuple[str, ...]:
    """That the tool is not known, for a reason of `unknown_tool_reason`, and what its numbers are; none without one."""
    consequence = (
        "These numbers fit the readings best and are not the tool's; their standard deviations and intervals do not"
        " hold."
    )
    return (f"The tool is not known, as {reason}.", consequence) if reason else ()


Array = NDArray[np.float64]

LITTLE = 0.1
"""Share of the power below which the terms that explain it best are no likeness."""
MAX_TERMS = 3
"""Generic terms of the sparse regression."""


@dataclass(frozen=True)
class UnexplainedResidual:
    """Systematic residual of a recording that no effect explains.

    where            a sentence: channel, variable of its residual map and location of the largest mean
    channel          the one that the terms are of
    looks_like       generic terms of its sparse regression; none where none were sought
    share            share of its power that these terms explain together
    explainable_rms  systematic error per channel
    """

    where: str
    channel: str
    looks_like: tuple[str, ...]
    share: float
    explainable_rms: Mapping[str, float | None]

    @property
    def resembles(self) -> str:
        """The generic terms in words and what they explain; that they explain little where they do.

        Empty of a residual outside the repeats, whose terms are not sought.
        """
        if not self.looks_like:
            return ""
        terms, share = ", ".join(map(term_in_words, self.looks_like)), f"{self.share:.0%}".replace("%", " %")
        if not self.is_alike:
            return f"no generic term of the motion: the best three explain {share} of its power in {self.channel}"
        return f"{terms}: these explain {share} of its power in {self.channel}"

    @property
    def text(self) -> str:
        """Where the residual is, and what it resembles where that was sought; without a full stop."""
        return f"{self.where}; resembles {self.resembles}" if self.resembles else self.where

    @property
    def is_alike(self) -> bool:
        """Whether the terms explain more than a little."""
        return self.share >= LITTLE


def describe_residual(
    comparison: Comparison, tolerance: Mapping[str, float], *, fitted: bool = True, channel: str | None = None
) -> UnexplainedResidual:
    """Describe the unexplained residual of a recording: its largest residual map and a sparse regression.

    They are of a `channel`, the worst by default. A held-out recording (not `fitted`) is named.
    """
    size = comparison.explainable_rms or {}
    maps = residual_maps(comparison, tolerance)
    worst = channel or worst_channel(comparison)
    best = next((m for m in maps if worst is None or m.channel == worst), None)
    channel = best.channel if best is not None else worst or comparison.recording.channels[0]
    where = f"{channel}, with too few samples for a residual map" if best is None else _sentence(best)
    where = where if fitted else f"on {comparison.recording.name}, {where}"
    number = comparison.recording.channels.index(channel)
    terms, share = sparse_description(comparison, number)
    return UnexplainedResidual(where, channel, terms, share, {c: size.get(c) for c in comparison.recording.channels})


def _sentence(best: ResidualMap) -> str:
    peak = int(np.argmax(np.abs(best.mean)))
    rises = "rises" if best.mean[peak] > 0 else "falls"
    place = f"{best.variable} = {best.centre[peak]:.3g} {best.variable_unit}"
    return f"{best.channel} {rises} near {place} (by {abs(best.mean[peak]):.2g} {best.channel_unit})"


def worst_channel(comparison: Comparison) -> str | None:
    """The channel with the largest ratio of systematic error to noise floor; of a run, of residual to upper noise.

    None of static poses without repeats.
    """
    size, floor = comparison.explainable_rms, comparison.noise_floor
    if size is None:
        if comparison.recording.at_rest:
            return None
        spectrum = ResidualSpectrum.of(comparison.residual, comparison.recording.wrench - comparison.residual)
        channels = comparison.recording.channels
        size, floor = (
            dict(zip(channels, np.sqrt(variance).tolist(), strict=True))
            for variance in (spectrum.variance, spectrum.upper_noise)
        )
    return max(size, key=lambda c: size[c] / max(floor[c], 1e-300))


def sparse_description(comparison: Comparison, channel: int) -> tuple[tuple[str, ...], float]:
    """Forward selection of up to three generic terms, and the share of the mean residual over repeats they explain."""
    recording = comparison.recording
    once = recording.samples_per_repeat
    load = recording.wrench - comparison.residual
    terms = {k: v[:once] for k, v in generic_terms(recording, load).items() if np.ptp(v[:once]) > 0}
    columns, names = standardised_columns(terms), list(terms)
    target = comparison.residual[:, channel].reshape(recording.repeats, once).mean(axis=0)
    target = target - target.mean()
    picked: list[int] = []
    residual = target
    for _ in range(MAX_TERMS):
        gain = np.abs(columns.T @ residual)
        gain[picked] = 0
        picked.append(int(gain.argmax()))
        solution = np.linalg.lstsq(columns[:, picked], target, rcond=None)[0]
        residual = target - columns[:, picked] @ solution
    share = 1 - float(residual @ residual) / max(float(target @ target), 1e-300)
    return tuple(names[i] for i in picked), share
