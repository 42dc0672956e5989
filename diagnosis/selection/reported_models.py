"""Candidate models as `fit` reports them, made by all workers at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.parallel.cached_values import CachedValue, compute_by_all
from diagnosis.selection.subset_search import CandidateModel
from estimation.fit import Fit, shared_objects


def report_by_all(
    models: Sequence[CandidateModel],
    others: Callable[[], Sequence[CachedValue]] = tuple,
    shared: Sequence[object] = (),
) -> None:
    """Make the reported fits and comparisons of models of one search, shared out among its workers.

    `others` gives further values to be computed with the comparisons, which may need the reported fits; `shared` are
    objects that they refer to.
    """
    workers = models[0].cache.workers
    if any(noise_from_residual(m.fit) for m in models):  # a refit each; else hardly any work
        fits = [CachedValue(f"reported fit {number}", m, "reported_fit") for number, m in enumerate(models)]
        compute_by_all(workers, fits, shared=_objects([m.fit for m in models]))
    compared = [
        CachedValue(f"comparison {number}", m, "comparisons" if m.reported_fit is m.fit else "reported")
        for number, m in enumerate(models)
    ]
    values = [*others(), *compared]
    compute_by_all(workers, values, shared=[*shared, *_objects([m.reported_fit for m in models])])


def _objects(fits: Sequence[Fit]) -> list[object]:
    return [part for fit in fits for part in shared_objects(fit)]
