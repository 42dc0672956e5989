"""Table of suspects: sizes as they are, and effects that no score test tells apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.screening.score_test import ScoreTest
from diagnosis.screening.suspects import Suspects
from modeling.effects import named
from modeling.space import Space


def score_test(
    effect: str, statistic: float, amounts: dict[str, tuple[float, float]], p_value: float = 1e-9
) -> ScoreTest:
    return ScoreTest(named(effect), statistic, p_value, {}, amounts)


def test_a_size_without_unit_keeps_its_digits() -> None:
    """Gains are numbers of unit 1, and end in digits that are no unit."""
    gain = score_test("sensor_gain", 50.0, {"sensor_gain.fy": (-0.0541, 0.0011), "sensor_gain.tau": (0.11, 0.011)})
    (row,) = Suspects.of([gain], Space.PLANE, None).table.rows
    assert row[4] == "fy = -0.0541 ± 0.0011, tau = 0.110 ± 0.011"


def test_a_nominally_infinite_amplitude_has_no_std() -> None:
    """Stiffness and level are points of the search: not significant, they are above what is detectable."""
    known = {"tip_flexibility.stiffness": (2.43, 0.0014)}
    for p_value, text, size in ((1.0, "stiffness > 677 N·m/rad", np.nan), (1e-9, "stiffness = 2.4 N·m/rad", 2.43)):
        test = replace(
            score_test("tip_flexibility", 50.0, known, p_value),
            limits=lambda _level: ({"tip_flexibility.stiffness": 677.0}, {}),
        )
        found = Suspects.of([test], Space.PLANE, None)
        assert found.table.rows[0][4] == text
        frame = found.to_frame()
        np.testing.assert_array_equal(frame[["size", "std", "detectable"]].to_numpy()[0], [size, np.nan, 677.0])
        assert frame["unit"][0] == "N m/rad"


def test_what_is_detectable_is_said_with_its_place() -> None:
    drag = replace(
        score_test("viscous_drag", 50.0, {"viscous_drag.c": (0.1, 0.01)}),
        limits=lambda _level: ({"viscous_drag.c": 0.0025}, {"viscous_drag.d": 0.12}), start={"viscous_drag.d": 0.4},
    )  # fmt: skip
    assert Suspects.of([drag], Space.PLANE, None).table.rows[0][5] == "c 0.0025 N·s/m (at d 0.12 m)"


def test_a_frame_of_suspects_has_numbers_and_the_number_of_parameters() -> None:
    crosstalk = score_test("sensor_crosstalk", 60.0, {"sensor_crosstalk.fx_fy": (0.1, 0.01)})
    untested = ScoreTest(named("time_delay"), 0.0, 1.0, {}, {}, reason="the recording has no time")
    frame = Suspects.of([crosstalk, untested], Space.PLANE, None).to_frame().set_index("effect")
    assert frame["parameters"].to_dict() == {"sensor_crosstalk": 6, "time_delay": 1}
    assert frame["parameter"].to_dict() == {"sensor_crosstalk": "fx_fy", "time_delay": ""}
    assert frame["size"]["sensor_crosstalk"] == 0.1
    assert {frame[name].dtype.kind for name in ("p", "error removed", "size", "std", "detectable")} == {"f"}


def test_effects_of_equal_derivative_are_named_together() -> None:
    lag, delay = (score_test(name, 50.0, {}) for name in ("sensor_lag", "time_delay"))
    drag, friction = score_test("viscous_drag", 60.0, {}), score_test("coulomb_friction", 50.0, {}, p_value=1.0)
    found = Suspects.of([lag, friction, delay, drag], Space.PLANE, None)
    assert found.ids == ("viscous_drag", "sensor_lag", "time_delay")
    assert found.ties == [("sensor_lag", "time_delay")]
    assert found.remarks()[1].startswith("sensor_lag and time_delay have the same score")
