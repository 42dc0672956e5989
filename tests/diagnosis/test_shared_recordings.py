"""The recordings that come with the project's data, diagnosed as a user would.

Without them these tests are skipped.
"""

from __future__ import annotations

import json
from functools import lru_cache

import pytest

from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.recordings.reading import read
from modeling.chain.model import planar
from modeling.rig import Rig
from tests.shared.places import DATA, needs

PLANAR = DATA / "planar"

pytestmark = needs(PLANAR)


@lru_cache
def diagnosed(case: str) -> Diagnosis:
    folder = PLANAR / case
    rig = Rig.read(folder / "rig.toml")
    return diagnose(planar(rig), read(folder / "train.csv", rig=rig), validate=read(folder / "validate.csv", rig=rig))


def allowed(case: str) -> list[set[str]]:
    """The sets of effects that may be named: truth.json lists, effect by effect, which ids count as it."""
    sets: list[set[str]] = [set()]
    for names in json.loads((PLANAR / case / "truth.json").read_text(encoding="utf-8"))["effects"]:
        sets = [chosen | {name} for chosen in sets for name in names]
    return sets


def test_nothing_is_named_where_nothing_is_hidden() -> None:
    result = diagnosed("nothing_hidden")
    assert result.added == ()
    assert result.verdict is RecordVerdict.NOTHING_MISSING


LONG = [pytest.param(case, marks=pytest.mark.long) for case in ("tether", "slow_sensor", "off_axis_and_leak")]


@pytest.mark.parametrize("case", ["drag", *LONG])
def test_hidden_effects_are_named_and_nothing_else(case: str) -> None:
    result = diagnosed(case)
    assert set(result.added) in allowed(case), str(result)
    assert len(result.added) == len(set(result.added))
    assert result.verdict is RecordVerdict.EXPLAINED


@pytest.mark.parametrize("case", ["drag", *LONG])
def test_little_is_left_on_another_motion(case: str) -> None:
    """The explainable power is below (a tenth of the noise floor)² and two standard errors of itself."""
    (comparison,) = diagnosed(case).steps[-1].validation
    assert comparison.explainable_rms is not None
    assert comparison.explainable_std is not None
    for channel, rms in comparison.explainable_rms.items():
        limit = (comparison.noise_floor[channel] / 10) ** 2 + 2 * comparison.explainable_std[channel]
        assert rms**2 <= limit, channel


@pytest.mark.long(seconds=35)
def test_what_no_catalogue_holds_is_left_unexplained_and_located() -> None:
    result = diagnosed("not_in_the_catalogue")
    assert result.added == ()
    assert result.verdict is RecordVerdict.UNEXPLAINED
    assert result.unexplained is not None
    assert result.unexplained.where
