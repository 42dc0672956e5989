"""Table of suspects: sizes as they are, and effects that no score test tells apart."""

from __future__ import annotations

from diagnosis.screening.score_test import ScoreTest
from diagnosis.screening.suspects import Suspects
from modeling.effects import named
from modeling.space import Space


def score_test(
    effect: str, statistic: float, amounts: dict[str, tuple[float, float]], p_value: float = 1e-9
) -> ScoreTest:
    return ScoreTest(named(effect), statistic, p_value, {}, amounts, {})


def test_a_size_without_unit_keeps_its_digits() -> None:
    """Gains are numbers of unit 1, and end in digits that are no unit."""
    gain = score_test("sensor_gain", 50.0, {"sensor_gain.fy": (-0.0541, 0.0011), "sensor_gain.tau": (0.11, 0.011)})
    (row,) = Suspects.of([gain], Space.PLANE, None).table.rows
    assert row[3] == "fy = -0.0541 ± 0.0011, tau = 0.110 ± 0.011"


def test_effects_of_equal_derivative_are_named_together() -> None:
    lag, delay = (score_test(name, 50.0, {}) for name in ("sensor_lag", "time_delay"))
    drag, friction = score_test("viscous_drag", 60.0, {}), score_test("coulomb_friction", 50.0, {}, p_value=1.0)
    found = Suspects.of([lag, friction, delay, drag], Space.PLANE, None)
    assert found.ids == ("viscous_drag", "sensor_lag", "time_delay")
    assert found.ties == [("sensor_lag", "time_delay")]
    assert found.remarks()[1].startswith("sensor_lag and time_delay have the same score")
