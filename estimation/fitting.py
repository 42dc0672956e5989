"""Fitting: the estimate of a model as users call it, by the least code that the question needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING

from estimation.stream.noise_model import NoiseModel
from estimation.stream.streaming import StreamedFit, fit_parts

if TYPE_CHECKING:
    from estimation.constrained import Constraints
    from estimation.fit import Fit
    from estimation.noise import Noise
    from estimation.stream.statistics import Part
    from modeling.model import WrenchModel


def fit(
    model: WrenchModel,
    recordings: Part | Iterable[Part],
    *,
    noise: Sequence[Noise] | NoiseModel | None = None,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    constraints: Constraints | None = None,
) -> Fit | StreamedFit:
    """`estimation.fit.fit`: estimate a model's parameters from recordings, or, with a `NoiseModel`, from any parts.

    Recordings of unknown noise need spectra, splines and tests, which take longer to import than a million rows of a
    stream take to be fitted: they are imported only when they are asked for.
    """
    if isinstance(noise, NoiseModel):
        return fit_parts(model, recordings, noise, start=start, executor=executor, constraints=constraints)
    from estimation.fit import fit as fit_whole

    return fit_whole(model, recordings, noise=noise, start=start, executor=executor, constraints=constraints)  # type: ignore[call-overload, misc, no-any-return]
