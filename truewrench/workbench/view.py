"""What is looked at of a study: which figure, recording, channels and steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnosis.comparison.compared_step import systematic_error
from diagnosis.comparison.comparison import Comparison
from diagnosis.study import Study, StudyStep
from modeling.errors import InputError

VIEWS = ("time", "map", "stairs", "spectrum")
MOST_CHANNELS = 3
"""Channels shown at first, the worst."""


@dataclass(frozen=True)
class View:
    """What is looked at.

    recording  its number, the fitted ones first
    channels   by number, those of the maps the first of them
    steps      two steps side by side; none for the current one
    cell       variable, centre and unit of a cell of a residual map whose samples are marked
    every_map  whether the maps of all variables are shown, not only those that explain most
    """

    name: str = "time"
    recording: int = 0
    channels: tuple[int, ...] = ()
    steps: tuple[int, ...] = ()
    cell: tuple[str, float, str] | None = None
    every_map: bool = False

    @classmethod
    def first(cls, study: Study) -> View:
        """The channels of the first recording with the largest errors."""
        return cls(channels=worst_channels(study.steps[-1].training[0])[:MOST_CHANNELS])

    def of_step(self, study: Study) -> View:
        """The same of the current model; two models side by side remain where there are still both."""
        kept = tuple(i for i in self.steps if i < len(study.steps))
        return replace(self, steps=kept if len(kept) == 2 else (), cell=None)

    def asked(self, request: Mapping[str, Any], study: Study) -> View:
        """Another view; InputError for what there is not."""
        name = str(request.get("view", self.name))
        recording = int(request.get("recording", self.recording))
        channel = request.get("channel")
        step = study.steps[-1]
        several = (*step.training, *step.validation)
        if name not in VIEWS or not 0 <= recording < len(several):
            raise InputError(what="there is no such view", where="workbench", remedy="reload the page")
        channels = self.channels if channel is None else self._with(int(channel), study, alone=name == "map")
        steps = () if request.get("alone") else self.steps
        kept = recording == self.recording and not request.get("unmark")
        every_map = request["every"] == "1" if "every" in request else self.every_map
        return replace(
            self, name=name, recording=recording, channels=channels, steps=steps, cell=self.cell if kept else None,
            every_map=every_map,
        )  # fmt: skip

    def _with(self, channel: int, study: Study, *, alone: bool) -> tuple[int, ...]:
        """The channels with one more, or less; of maps that one first."""
        if not 0 <= channel < len(study.model.channels):
            raise InputError(what="there is no such channel", where="workbench", remedy="reload the page")
        if alone:
            return (channel, *(c for c in self.channels if c != channel))
        rest = tuple(c for c in self.channels if c != channel)
        return (rest or self.channels) if channel in self.channels else tuple(sorted((*self.channels, channel)))

    def comparing(self, first: int, second: int) -> View:
        """Two steps side by side, over time."""
        return replace(self, name="time", steps=(first, second), cell=None)


def comparisons_of(step: StudyStep) -> tuple[Comparison, ...]:
    """Those of the fitted recordings, then of the held-out ones."""
    return (*step.training, *step.validation)


def worst_channels(comparison: Comparison) -> tuple[int, ...]:
    """The channels by number, the largest error over noise floor first."""
    errors = systematic_error(comparison)
    ratio = [errors[c] / max(comparison.noise_floor[c], 1e-300) for c in comparison.recording.channels]
    return tuple(int(i) for i in np.argsort(ratio)[::-1])
