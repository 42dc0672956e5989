"""Whitened prediction and sensitivities of any model along one trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from design.information.joint_state import signals_along
from design.information.sampling import CLOCK_SIGNALS, Sampling
from design.information.sensitivity_term import ModelTransferFunction
from design.trajectories.trajectory import Trajectory
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.kinematics.arm import Arm
from modeling.noise.stationary_noise import StationaryNoise

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class WhitenedPrediction:
    """The signals (N,) of one trajectory by name, their sampling, and the noise of the readings."""

    signals: Mapping[str, Array]
    sampling: Sampling
    noise: StationaryNoise

    @classmethod
    def along(cls, motion: Trajectory, arm: Arm, *, samples: int, noise: StationaryNoise) -> WhitenedPrediction:
        """One run of a trajectory (one period of a periodic one)."""
        series = motion.series
        signals = signals_along(arm, *motion.evaluate(series.instants(samples)))
        sampling = Sampling(duration=series.duration, samples=samples, periodic=series.periodic)
        return cls(signals=signals, sampling=sampling, noise=noise)

    @cached_property
    def known(self) -> dict[str, Array]:
        """The signals and those of the clock."""
        return {**dict(zip(CLOCK_SIGNALS, self.sampling.clock, strict=True)), **self.signals}

    def tangent(self, model: WrenchModel, theta: Array) -> tuple[Array, Array]:
        """The whitened reading (R,) at theta (k,), and its sensitivities (R, k): R rows of unit variance.

        reading = H(s) load + zero, d reading = H d load + dH load + d zero; the same as the columns of an `Experiment`
        at theta, from functions that are compiled once for all theta. Raises InputError for a signal that is missing.
        """
        prediction, count = compiled_prediction(model), self.sampling.samples
        value, slopes = prediction.load.tangent(self.known, theta, count)
        if prediction.has_transfer_function:
            value, slopes = self._filtered(model, theta, value, slopes)
        zero, zero_slopes = prediction.bias.tangent(self.known, theta, count)
        stacked = np.concatenate([(value + zero)[:, :, None], slopes + zero_slopes], axis=2)
        rows = self.noise.whitened(stacked, self.sampling.step).reshape(-1, 1 + len(theta))
        return rows[:, 0], rows[:, 1:]

    def reading(self, model: WrenchModel, theta: Array) -> Array:
        """The whitened reading (R,) at theta (k,)."""
        return self.tangent(model, theta)[0]

    def _filtered(self, model: WrenchModel, theta: Array, value: Array, slopes: Array) -> tuple[Array, Array]:
        """The load and its sensitivities through H(s), with the sensitivities to the parameters of H added."""
        transfer = ModelTransferFunction(model=model, theta=tuple(theta))
        stacked = self.sampling.through(transfer, np.concatenate([value[:, :, None], slopes], axis=2))
        filtered, slopes = stacked[:, :, 0], stacked[:, :, 1:]
        for number, index in enumerate(compiled_prediction(model).transfer_parameters):
            derivative = ModelTransferFunction(model=model, theta=tuple(theta), slope=number)
            slopes[:, :, index] += self.sampling.through(derivative, value)
        return filtered, slopes
