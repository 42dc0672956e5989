"""Public `fit`: whole recordings or streamed parts, with lazy imports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING

from estimation.streaming.streamed_fit import StreamedFit, fit_streamed
from modeling.noise.autoregressive_noise import NoiseModel

if TYPE_CHECKING:
    from estimation.fit import Fit
    from estimation.least_squares.constrained import Constraints
    from estimation.noise.recording_noise import RecordingNoise
    from estimation.streaming.chunk_information import RecordingOrChunk
    from modeling.chain.model import WrenchModel


def fit(
    model: WrenchModel,
    recordings: RecordingOrChunk | Iterable[RecordingOrChunk],
    *,
    noise: Sequence[RecordingNoise] | NoiseModel | None = None,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    constraints: Constraints | None = None,
) -> Fit | StreamedFit:
    """`estimation.fit.fit`: estimate a model's parameters from recordings, or with a `NoiseModel` from streamed parts.

    Unknown noise needs spectra, splines and tests, which take longer to import than a streamed fit of a million rows:
    they are imported only when needed.
    """
    if isinstance(noise, NoiseModel):
        return fit_streamed(model, recordings, noise, start=start, executor=executor, constraints=constraints)
    from estimation.fit import fit as fit_whole

    return fit_whole(model, recordings, noise=noise, start=start, executor=executor, constraints=constraints)  # type: ignore[call-overload, misc, no-any-return]
