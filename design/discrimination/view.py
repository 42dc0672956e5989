"""View: what a model reads along one motion, over the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from design.information.noise import SensorNoise
from design.information.sampling import CLOCK, Sampling
from design.information.state import signals_along
from design.information.term import ModelTransfer
from design.motion.series import Motion
from modeling.kinematics import Arm
from modeling.model import WrenchModel
from modeling.prediction import compiled

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """The signals of one motion (N,) by name, when they are sampled, and the noise of the readings."""

    signals: Mapping[str, Array]
    sampling: Sampling
    noise: SensorNoise

    @classmethod
    def along(cls, motion: Motion, arm: Arm, *, samples: int, noise: SensorNoise) -> View:
        """One run of a motion (one period of a periodic one)."""
        series = motion.series
        signals = signals_along(arm, *motion.evaluate(series.instants(samples)))
        sampling = Sampling(duration=series.duration, samples=samples, periodic=series.periodic)
        return cls(signals=signals, sampling=sampling, noise=noise)

    @cached_property
    def known(self) -> dict[str, Array]:
        """The signals and those of the clock."""
        return {**dict(zip(CLOCK, self.sampling.clock, strict=True)), **self.signals}

    def tangent(self, model: WrenchModel, theta: Array) -> tuple[Array, Array]:
        """The whitened reading (R,) at theta (k,), and its derivative (R, k): R rows of unit variance.

        reading = H(s) load + zero, d reading = H d load + dH load + d zero; the same as the columns of an `Experiment`
        at theta, from functions that are compiled once for all theta. Raises InputError for a signal that is missing.
        """
        prediction, count = compiled(model), self.sampling.samples
        value, slopes = prediction.load.tangent(self.known, theta, count)
        if prediction.remembers:
            value, slopes = self._remembered(model, theta, value, slopes)
        zero, zero_slopes = prediction.zero.tangent(self.known, theta, count)
        both = np.concatenate([(value + zero)[:, :, None], slopes + zero_slopes], axis=2)
        rows = self.noise.whitened(both, self.sampling.step).reshape(-1, 1 + len(theta))
        return rows[:, 0], rows[:, 1:]

    def reading(self, model: WrenchModel, theta: Array) -> Array:
        """The whitened reading (R,) at theta (k,)."""
        return self.tangent(model, theta)[0]

    def _remembered(self, model: WrenchModel, theta: Array, value: Array, slopes: Array) -> tuple[Array, Array]:
        transfer = ModelTransfer(model=model, theta=tuple(theta))
        both = self.sampling.through(transfer, np.concatenate([value[:, :, None], slopes], axis=2))
        filtered, slopes = both[:, :, 0], both[:, :, 1:]
        for number, index in enumerate(compiled(model).memory_parameters):
            bend = ModelTransfer(model=model, theta=tuple(theta), slope=number)
            slopes[:, :, index] += self.sampling.through(bend, value)
        return filtered, slopes
