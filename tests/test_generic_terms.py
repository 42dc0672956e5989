"""The cross-validated gain of generic terms: computed once for a fit, and anew for another one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.comparison import generic_terms
from diagnosis.comparison.generic_terms import cross_validated_gain
from estimation.fit import fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import planar

Array = NDArray[np.float64]


def single_run() -> Recording:
    """A swinging arm, its readings noise."""
    rng = np.random.default_rng(3)
    time = 0.01 * np.arange(600, dtype=np.float64)
    columns = {"phi": np.sin(3 * time), "dphi": 3 * np.cos(3 * time), "ddphi": -9 * np.sin(3 * time)}
    columns |= {"ax": np.sin(5 * time), "ay": np.cos(4 * time), "time": time}
    return from_columns(columns | {c: rng.standard_normal(600) for c in ("fx", "fy", "tau")})


def test_the_gain_of_a_fit_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Recording] = []
    terms = generic_terms.generic_terms

    def counted(recording: Recording, load: Array) -> Mapping[str, Array]:
        asked.append(recording)
        return terms(recording, load)

    monkeypatch.setattr(generic_terms, "generic_terms", counted)
    found = fit(planar(), single_run())
    first = cross_validated_gain(found, 0)
    assert cross_validated_gain(found, 0) is first
    assert len(asked) == 1
    other = replace(found, theta=found.theta + 0.1)
    assert cross_validated_gain(other, 0).gain > first.gain + 1  # what is wrong by 0.1 is predicted
    assert len(asked) == 2
