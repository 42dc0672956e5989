"""The cross-validated gain of generic terms: part of a comparison where the noise is taken from the residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.comparison.comparison import comparison_of
from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar


def fitted(repeats: int = 1) -> Fit:
    """The rigid tool of a swinging arm, its readings noise."""
    rng = np.random.default_rng(3)
    time = 0.01 * np.arange(600 * repeats, dtype=np.float64)
    phase = 2 * np.pi * time / 6
    columns = {"phi": np.sin(3 * phase), "ax": np.sin(5 * phase), "ay": np.cos(4 * phase), "time": time}
    columns |= {c: rng.standard_normal(len(time)) for c in ("fx", "fy", "tau")}
    if repeats > 1:
        columns["repeat"] = np.repeat(np.arange(repeats), 600)
    return fit(planar(), from_columns(columns))


def test_the_gain_is_that_of_the_residual_compared() -> None:
    """What is wrong by 0.1 of noise is predicted from other blocks: the gain rises, and the p-value falls."""
    found = fitted()
    right = comparison_of(found, 0).cross_validated_gain
    wrong = comparison_of(replace(found, theta=found.theta + 0.1), 0).cross_validated_gain
    assert right is not None
    assert wrong is not None
    assert wrong.gain > right.gain + 1
    assert wrong.p_value < right.p_value


def test_a_recording_with_repeats_has_no_gain() -> None:
    """Its lack of fit is tested against the noise between the repeats."""
    assert comparison_of(fitted(repeats=3), 0).cross_validated_gain is None
