"""Joint state: position, velocity and acceleration of the joints, and all signals that follow from them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling.kinematics.arm import Arm

Array = NDArray[np.float64]
STATE_PREFIXES = ("q", "dq", "ddq")


def signal_names(arm: Arm) -> tuple[str, ...]:
    """Names of the signals that follow from a state of the arm: q1.., dq1.., ddq1.. and the sensor's kinematics."""
    return (*(f"{order}{j}" for order in STATE_PREFIXES for j in range(1, arm.joints + 1)), *arm.names)


def signals_along(arm: Arm, q: Array, dq: Array, ddq: Array) -> dict[str, Array]:
    """Every signal (N,) along joint states (N, n)."""
    return dict(zip(signal_names(arm), np.hstack([q, dq, ddq]).T, strict=False)) | arm.pose(q, dq, ddq)


@lru_cache(maxsize=16)
def signals_of_state(arm: Arm) -> Any:
    """CasADi function (SX) from a state (q, dq, ddq), (3n,), to the signals in the order of `signal_names`."""
    import casadi as ca

    state = ca.SX.sym("x", len(STATE_PREFIXES) * arm.joints)
    motion = arm.function(*ca.vertsplit(state, arm.joints))
    return ca.Function("signals", [state], [ca.densify(ca.vertcat(state, motion))])
