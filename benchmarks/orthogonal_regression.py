"""Orthogonal distance regression of a planar tool, to compare with: the other classical estimator for noisy inputs.

The true signals u_t are unknowns as well: minimise sum (y - f(u, θ))' S^-1 (y - f) + (u - u_obs)' Σ^-1 (u - u_obs).
About the present u = u_obs + d, each sample's d is eliminated: with V = S + f_u Σ f_u' and r = y - f + f_u d, θ takes a
step of least squares on r weighted with V^-1, and d = Σ f_u' V^-1 (r - f_θ step) (Britt and Luecke, Technometrics 15,
1973).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.errors_in_variables import ErrorPropagation
from estimation.input_noise import InputNoise
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction

Array = npt.NDArray[np.float64]

MOST_STEPS = 60
AT_REST = 1e-4
"""Step, in std, below which it has come to rest."""


def orthogonal(model: WrenchModel, recording: Recording, inputs: InputNoise, floor: Array, start: Array) -> Array:
    """Parameters (k,) of a single run whose readings have white noise of std `floor` (p,)."""
    slopes, parts, n = (
        ErrorPropagation.of(model, recording, inputs).emitted,
        compiled_prediction(model),
        recording.samples,
    )
    theta, shift = start, np.zeros((n, len(inputs.names)))
    for _ in range(MOST_STEPS):
        known = dict(recording.signals)
        known |= {name: known[name] + shift[:, i] for i, name in enumerate(inputs.names)}
        both = [part.tangent(known, theta, n) for part in (parts.load, parts.bias)]
        value, tangent = both[0][0] + both[1][0], both[0][1] + both[1][1]
        slope = slopes.value(known, theta, n).reshape(n, len(floor), -1)
        weight = np.linalg.inv(np.diag(floor**2) + slope @ inputs.covariance @ slope.swapaxes(1, 2))
        rest = recording.wrench - value + np.einsum("npi,ni->np", slope, shift)
        information = np.einsum("npk,npq,nqj->kj", tangent, weight, tangent)
        step = np.linalg.solve(information, np.einsum("npk,npq,nq->k", tangent, weight, rest))
        theta = theta + step
        left = np.einsum("npq,nq->np", weight, rest - tangent @ step)
        shift = np.einsum("npi,np->ni", slope, left) @ inputs.covariance
        if np.abs(step * np.sqrt(np.diag(information))).max() < AT_REST:
            break
    return theta
