"""Words of a verdict: what they say where a held-out recording alone fails."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from truewrench.text.diagnosis_text import verdict_headline


def judged(name: str, lack_of_fit: float) -> Any:
    return SimpleNamespace(recording=SimpleNamespace(name=name), lack_of_fit=lack_of_fit)


def of(**parts: Any) -> Any:
    return SimpleNamespace(
        verdict=RecordVerdict.UNEXPLAINED, fit=SimpleNamespace(converged=True), rows_left_out=(), readings=(), **parts
    )


def test_effects_that_could_not_be_tested_are_named() -> None:
    step = SimpleNamespace(training=[judged("train.csv", 1e-9)], validation=[])
    effect = SimpleNamespace(id="joint_offset")
    finding = SimpleNamespace(effect=effect, verdict=EffectVerdict.NOT_EXCITED, reason="train.csv has no q1")
    diagnosis = of(findings=(finding,), steps=(step,))
    said = "Significant residual, and no candidate effect could be tested (joint_offset: train.csv has no q1)"
    assert verdict_headline(diagnosis) == said
    diagnosis.fit.converged = False
    assert verdict_headline(diagnosis) == f"{said}; not converged: the estimates are not final"


@pytest.mark.parametrize(
    ("fitted", "held_out", "sentence"),
    [
        (1e-9, 1e-9, "Significant residual, and no candidate effect explains it"),
        (1e-9, 0.5, "Significant residual, and no candidate effect explains it"),
        (
            0.5,
            1e-9,
            "Significant residual on other.csv, held out, while train.csv shows none,"
            " and no candidate effect explains it",
        ),
    ],
)
def test_the_recording_that_fails_is_named_when_it_is_held_out(fitted: float, held_out: float, sentence: str) -> None:
    step = SimpleNamespace(training=[judged("train.csv", fitted)], validation=[judged("other.csv", held_out)])
    assert verdict_headline(of(findings=(), steps=(step,))) == sentence
