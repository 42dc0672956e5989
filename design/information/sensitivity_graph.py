"""Sensitivities as CasADi expressions of the joint states."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from design.information.joint_state import signal_names, signals_of_state
from design.information.sampling import CLOCK_SIGNALS, Sampling
from design.information.sensitivity_term import SensitivityTerm
from modeling.kinematics.arm import Arm
from modeling.noise.autoregressive_noise import NoiseModel
from modeling.noise.stationary_noise import StationaryNoise

SensitivityShape = tuple[int, int]


@lru_cache(maxsize=64)
def sensitivity_function(arm: Arm, terms: tuple[SensitivityTerm, ...], shape: SensitivityShape) -> Any:
    """CasADi function (SX) from a state (3n,) and the clock's signals (2,) to the columns (p, k), before filters."""
    import casadi as ca

    state, clock = ca.SX.sym("x", 3 * arm.joints), ca.SX.sym("clock", len(CLOCK_SIGNALS))
    given, names = ca.vertcat(signals_of_state(arm)(state), clock), (*signal_names(arm), *CLOCK_SIGNALS)
    total = ca.SX.zeros(*shape)
    for term in terms:
        total[:, list(term.columns)] += term.function(given[[names.index(name) for name in term.inputs]])
    return ca.Function("columns", [state, clock], [ca.cse(total)])


def sensitivity_graph(
    arm: Arm, terms: Sequence[SensitivityTerm], shape: SensitivityShape, states: Any, sampling: Sampling
) -> Any:
    """The unweighted columns along the states (3n, N), as one (k, N) for each channel.

    Terms with a common transfer function are one map over the samples; each filter is a constant matrix (N, N) on its
    result, so that derivatives of every order follow.
    """
    import casadi as ca

    channels, size = shape
    rows: list[Any] = [ca.MX.zeros(size, sampling.samples) for _ in range(channels)]
    for response, group in _by_response(terms).items():
        function = sensitivity_function(arm, tuple(group), shape)
        flat = function.map(sampling.samples)(states, sampling.clock)
        used = sorted({column for term in group for column in term.columns})
        filtered = None if response is None else ca.DM(sampling.matrix(response)).T
        for channel in range(channels):
            series = ca.reshape(flat[channel, :], size, sampling.samples)[used, :]
            rows[channel][used, :] += series if filtered is None else series @ filtered
    return rows


def whitened_graph(rows: list[Any], noise: StationaryNoise | None, sampling: Sampling) -> list[Any]:
    """The whitened columns (k, N) of each channel: by constant weights, or by filters where the noise is coloured."""
    import casadi as ca

    if noise is None:
        return rows
    channels = range(len(rows))
    if isinstance(noise, NoiseModel) and noise.is_white:
        return [sum(float(noise.root[c, d]) * rows[d] for d in channels if noise.root[c, d]) for c in channels]
    result: list[Any] = [ca.MX.zeros(*rows[0].shape) for _ in channels]
    for d in channels:
        impulses = np.zeros((sampling.samples, len(rows), sampling.samples))
        impulses[:, d] = np.eye(sampling.samples)
        filters = noise.whitened(impulses, sampling.step)
        for c in channels:
            if filters[:, c].any():
                result[c] += rows[d] @ ca.DM(filters[:, c]).T
    return result


def _by_response(terms: Sequence[SensitivityTerm]) -> dict[Any, list[SensitivityTerm]]:
    groups: dict[Any, list[SensitivityTerm]] = {}
    for term in terms:
        groups.setdefault(term.response, []).append(term)
    return groups
