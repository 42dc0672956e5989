"""Graph: the columns of an experiment as CasADi expressions of the joint states, for an optimiser."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from design.information.noise import SensorNoise, WhiteNoise
from design.information.sampling import CLOCK, Sampling
from design.information.state import signal_names, signals_of_state
from design.information.term import Term
from modeling.kinematics import Arm

Shape = tuple[int, int]


@lru_cache(maxsize=64)
def of_state(arm: Arm, term: Term) -> Any:
    """CasADi function (SX) from a state (3n,) and the clock's signals (2,) to the term's matrix (p, c)."""
    import casadi as ca

    state, clock = ca.SX.sym("x", 3 * arm.joints), ca.SX.sym("clock", len(CLOCK))
    given = ca.vertcat(signals_of_state(arm)(state), clock)
    places = [(*signal_names(arm), *CLOCK).index(name) for name in term.inputs]
    return ca.Function("term", [state, clock], [term.function(given[places])])


@lru_cache(maxsize=64)
def total_of_state(arm: Arm, terms: tuple[Term, ...], shape: Shape) -> Any:
    """CasADi function (SX) from a state (3n,) and the clock's signals (2,) to the columns (p, k), filters left out."""
    import casadi as ca

    state, clock = ca.SX.sym("x", 3 * arm.joints), ca.SX.sym("clock", len(CLOCK))
    total = ca.SX.zeros(*shape)
    for term in terms:
        total[:, list(term.columns)] += of_state(arm, term)(state, clock)
    return ca.Function("columns", [state, clock], [ca.cse(total)])


def columns_graph(arm: Arm, terms: Sequence[Term], shape: Shape, states: Any, sampling: Sampling) -> Any:
    """The unweighted columns along the states (3n, N), as one (k, N) for each channel.

    Terms with one transfer function are one map over the samples; each filter is a constant matrix (N, N) on what
    comes out of it, so that derivatives of every order follow.
    """
    import casadi as ca

    channels, size = shape
    rows: list[Any] = [ca.MX.zeros(size, sampling.samples) for _ in range(channels)]
    for response, group in _by_response(terms).items():
        function = total_of_state(arm, tuple(group), shape)
        flat = function.map(sampling.samples)(states, sampling.clock)
        reached = sorted({column for term in group for column in term.columns})
        filtered = None if response is None else ca.DM(sampling.matrix(response)).T
        for channel in range(channels):
            series = ca.reshape(flat[channel, :], size, sampling.samples)[reached, :]
            rows[channel][reached, :] += series if filtered is None else series @ filtered
    return rows


def weighted(rows: list[Any], noise: SensorNoise | None, sampling: Sampling) -> list[Any]:
    """The columns (k, N) of each channel over the noise: constant weights, or filters where it is coloured."""
    import casadi as ca

    if noise is None:
        return rows
    channels = range(len(rows))
    if isinstance(noise, WhiteNoise):
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


def _by_response(terms: Sequence[Term]) -> dict[Any, list[Term]]:
    groups: dict[Any, list[Term]] = {}
    for term in terms:
        groups.setdefault(term.response, []).append(term)
    return groups
