"""Log fit: a model fitted to one long log, with the noise that the rig states."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from estimation.stream.long_log import read_chunks
from estimation.stream.noise_model import NoiseModel
from estimation.stream.streaming import StreamedFit, fit_parts
from modeling.errors import InputError
from modeling.model import WrenchModel, planar, spatial
from modeling.rig import PLANAR_CHANNELS, Rig


def log_fit(path: Path, rig: Rig | None, changed: Callable[[WrenchModel], WrenchModel]) -> StreamedFit:
    """The fit of the rigid tool, changed as asked for, to the log at that path, read piece by piece.

    Raises InputError where the rig does not state the noise of every channel, and as `read_chunks` and `fit_parts`.
    """
    log = read_chunks(path, rig=rig)
    channels = log.channels
    model = changed((planar if channels == PLANAR_CHANNELS else spatial)(rig))
    stated = {} if rig is None or rig.sensor.noise is None else rig.sensor.noise
    silent = [channel for channel in channels if channel not in stated]
    if silent:
        what = f"the noise of {', '.join(silent)} is not stated, and a log that passes by is weighed with it"
        remedy = f"state noise = {{ {', '.join(f'{c} = ..' for c in channels)} }} under [sensor] in the rig"
        raise InputError(what=what, where="rig", remedy=remedy)
    return fit_parts(model, log, NoiseModel.white([stated[channel] for channel in channels]))
