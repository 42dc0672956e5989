"""The notebooks: each runs from the top as it stands, and what it claims in words is so."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from diagnosis.verdict import RecordVerdict

pytest.importorskip("mujoco")

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))


def missing_effect(names: dict[str, Any]) -> None:
    """The tether is named and was what bent the inertia; the magnet stays unexplained where it hangs."""
    assert names["found"].verdict is RecordVerdict.EXPLAINED
    assert names["found"].added == ("cable_spring",)
    true = names["arm"].inertia
    bent, mended = (names[fit].parameters["I"] for fit in ("rigid", "tethered"))
    assert abs(bent.value - true) > 10 * bent.std
    for name, hidden in {**names["hidden"], "I": true}.items():
        found = mended if name == "I" else names["tethered"].parameters[f"cable_spring.{name}"]
        assert abs(found.value - hidden) < 4 * found.std  # six numbers, one in 3000 beyond 4 of any
    assert names["unknown"].verdict is RecordVerdict.UNEXPLAINED
    assert names["unknown"].added == ()
    assert any(f.p_value is not None and f.p_value < 1e-20 for f in names["unknown"].findings)
    assert names["unknown"].remainder.where.startswith("tau falls near position y")


def contact_force(names: dict[str, Any]) -> None:
    """The rigid tool is off by newtons and sees no push, the tethered one is right; the printed direction is wrong."""
    rigid, found, true = names["rigid"], names["found"], names["true"]
    assert (rigid.repeating_error(true) > 5 * rigid.floor).all()
    assert (found.repeating_error(true) < found.floor / 10 + 2 * found.repeating_limit).all()
    assert not rigid.intervals
    assert len(found.intervals) == 4
    assert abs(found.zero_shift[0] - 0.8) < 0.05
    assert abs(names["size"].mean() - 5) < 0.05
    assert abs(names["direction"].mean() - 36.87) < 0.5
    assert abs(names["printed"] - 36.87) > 2


def designed_motion(names: dict[str, Any]) -> None:
    """Each step gains, none beyond the bound; estimates scatter as promised; the designed motion tells drags apart."""
    values = list(names["logdet"].values())
    assert values == sorted(values)
    assert values[1] - values[0] > 4
    assert values[-1] < names["plan"].bound.logdet
    for name, promised in names["promised"].items():
        assert 0.75 < names["scatter"][name] / promised < 1.3  # 100 draws: std of 7 %, one in 2000 beyond
    assert names["before"]["viscous"] - names["before"]["quadratic"] < 21.6
    found = names["after"]["viscous"] - names["after"]["quadratic"]
    assert found > 1000
    expected = names["told"].pairs[0].directions[0].after
    # The plan knows the drag's size from the slow recording, to some 3 %: lambda goes with its square.
    assert abs(found / expected - 1) < 0.3


CLAIMS = {
    "contact_force": contact_force,
    "designed_motion": designed_motion,
    "from_recording_to_missing_effect": missing_effect,
}


def test_every_notebook_has_its_claims() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(CLAIMS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, warnings as errors (pytest's setting here as everywhere)."""
    monkeypatch.chdir(tmp_path)
    CLAIMS[path.stem](runpy.run_path(str(path)))
