"""The size of an effect in a recording: by how much it changes the predicted readings at most."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.model_response import predicted_readings
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.chain.model import WrenchModel
from modeling.number_format import format_number


def largest_change(fit: Fit, effect_id: str) -> tuple[float, float] | None:
    """Largest force (N) and torque (N m) by which an effect changes the prediction of a recording of the fit.

    It is the difference of the model and the model without the effect, at the same values of all other parameters: of
    a load on the tool, that load. None for a recording-specific effect.
    """
    model = fit.model.without_recording_specific
    if effect_id not in (e.id for e in model.effects):
        return None
    changes = [change_of_readings(model, effect_id, fit.values, recording) for recording in fit.recordings]
    forces = 2 if fit.recordings[0].dimension == 2 else 3
    force, torque = (
        max(float(np.linalg.norm(change[:, channels], axis=1).max()) for change in changes)
        for channels in (slice(0, forces), slice(forces, None))
    )
    return force, torque


def change_of_readings(
    model: WrenchModel, effect_id: str, values: Mapping[str, float], recording: Recording
) -> NDArray[np.float64]:
    """The prediction (n, p) of a model less that without the effect, at the same values by parameter: N, N m."""
    readings = []
    for one in (model, model.without(effect_id)):
        theta = np.array([values[p.name] for p in one.parameters])
        readings.append(predicted_readings(one, recording, theta))
    return np.asarray(readings[0] - readings[1])


def size_sentence(fit: Fit, effect_id: str) -> str:
    """The largest change as a sentence; empty for a recording-specific effect."""
    largest = largest_change(fit, effect_id)
    if largest is None:
        return ""
    size = " and ".join(f"{format_number(v)} {unit}" for v, unit in zip(largest, ("N", "N m"), strict=True))
    stage = next(e.stage for e in fit.model.effects if e.id == effect_id)
    if stage is Stage.TIP_BODY:
        sentence = f"Where it is largest in the fitted recordings, it loads the sensor with {size}"
    else:
        sentence = f"In the fitted recordings it changes the readings by at most {size}"
    return f"{sentence} (norms over the components)."
