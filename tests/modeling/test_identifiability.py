"""What a motion does not show of a tool, said in its parameters' names: motions of which that is known by hand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import compiled_prediction
from modeling.identifiability import (
    UNIDENTIFIABLE_SHARE,
    ScaledSVD,
    least_certain_direction,
    unidentifiable_directions,
)
from modeling.parameter import Parameter
from modeling.rig import Convention, Rig, SensorDescription

Array = NDArray[np.float64]

TIME: Array = np.arange(400, dtype=np.float64) * 0.01
TOOL = {"bias_fx": 1.0, "bias_fy": -2.0, "bias_tau": 0.3, "m": 0.9, "mlg": 0.06, "I": 0.01}
STILL = np.zeros(400)


def fitted(model: WrenchModel, motion: Mapping[str, Array], tool: Mapping[str, float]) -> Fit:
    """A fit to a rigid tool's readings for that motion, with white noise of a hundredth."""
    theta = np.array([tool.get(p.name, 0.0) for p in model.base.parameters])
    count, rigid = len(next(iter(motion.values()))), compiled_prediction(model.base)
    wrench = rigid.load.value(motion, theta, count) + rigid.bias.value(motion, theta, count)
    wrench = wrench + 0.01 * np.random.default_rng(0).standard_normal(wrench.shape)
    noise = dict.fromkeys(model.channels, 0.01)
    rig = Rig(sensor=SensorDescription(noise=noise, convention=Convention.ON_TOOL))
    return fit(model, from_columns({**motion, **dict(zip(model.channels, wrench.T, strict=True))}, rig=rig))


def planar_motion(phi: Array, ax: Array = STILL, ay: Array = STILL) -> dict[str, Array]:
    dphi = np.asarray(np.gradient(phi, TIME), dtype=np.float64)
    ddphi = np.asarray(np.gradient(dphi, TIME), dtype=np.float64)
    columns: dict[str, Array] = {"time": TIME, "phi": phi, "dphi": dphi, "ddphi": ddphi, "ax": ax, "ay": ay}
    return columns


def test_a_full_motion_leaves_nothing_to_say() -> None:
    swing = planar_motion(np.sin(3 * TIME) + 0.4 * np.sin(8 * TIME), 3 * np.cos(5 * TIME), 2 * np.sin(7 * TIME))
    found = fitted(planar(), swing, TOOL)
    assert found.unidentifiable == ()
    assert found.condition < 100
    assert "identifiable" not in str(found)
    assert len(str(found).splitlines()) == 1 + len(TOOL) + 1  # heading and chi-square


def test_poses_at_rest_do_not_show_inertia() -> None:
    poses = {"phi": np.linspace(-1.5, 1.5, 9)} | {name: np.zeros(9) for name in ("ax", "ay", "dphi", "ddphi")}
    found = fitted(planar(), poses, TOOL)
    assert [str(d) for d in found.unidentifiable] == ["I is not identifiable from this motion"]
    assert "I is not identifiable from this motion" in str(found)
    assert found.parameters["I"].std == np.inf
    assert found.parameters["m"].value == pytest.approx(0.9, abs=5 * found.parameters["m"].std)


def test_one_pose_ties_weight_to_the_zero() -> None:
    """At phi = 0.3, fx = bias_fx - m g sin phi, fy = bias_fy - m g cos phi, tau = bias_tau - mlg g sin phi.

    More mass is thus a shift of both zeros by g sin phi and g cos phi, and mlg one of the torque's; what is said by 1 N
    of bias_fx is 1 / (g sin phi) kg of mass and 1 / tan phi of bias_fy.
    """
    phi = 0.3
    found = fitted(planar(), planar_motion(np.full(400, phi)), TOOL)
    said = {d.names: dict(zip(d.names, d.amounts, strict=True)) for d in found.unidentifiable}
    assert set(said) == {("bias_fx", "bias_fy", "m"), ("bias_tau", "mlg"), ("I",)}
    g = planar().gravity
    expected = {"bias_fx": 1.0, "bias_fy": 1 / np.tan(phi), "m": 1 / (g * np.sin(phi))}
    assert said["bias_fx", "bias_fy", "m"] == pytest.approx(expected, rel=1e-9)
    assert said["bias_tau", "mlg"] == pytest.approx({"bias_tau": 1.0, "mlg": 1 / (g * np.sin(phi))}, rel=1e-9)
    sentence = next(str(d) for d in found.unidentifiable if "mlg" in d.names)
    assert sentence == (
        "bias_tau and mlg are collinear on this motion: "
        "raising bias_tau by 1 N m and raising mlg by 0.345 kg m leaves the prediction unchanged"
    )


def test_a_steady_rise_of_temperature_cannot_be_told_from_drift() -> None:
    """The drift's first polynomial is progress itself, from -1 to 1, and the temperature rises by 6 K: 1 / K of one is
    -3 of the other, in each channel."""
    model = planar() + effects.thermal_drift() + effects.bias_drift()
    swing = planar_motion(np.sin(3 * TIME) + 0.4 * np.sin(8 * TIME), 3 * np.cos(5 * TIME), 2 * np.sin(7 * TIME))
    found = fitted(model, swing | {"temperature": 20 + 6 * TIME / TIME[-1]}, TOOL)
    tied = [d for d in found.unidentifiable if any(n.startswith("thermal_drift") for n in d.names)]
    assert len(tied) == 3
    for direction, channel in zip(tied, model.channels, strict=True):
        said = dict(zip(direction.names, direction.amounts, strict=True))
        thermal = said.pop(f"thermal_drift.{channel}")
        linear = next(v for n, v in said.items() if n.startswith("bias_drift"))
        assert linear / thermal == pytest.approx(-3.0, rel=1e-6)
    assert "are collinear on this motion: " in str(found)


def test_turning_about_one_axis_in_six() -> None:
    """About the upright z axis the sensor sees weight on fz alone: m goes with bias_fz, mx and my with the torques'
    zeros; mz and all inertia but what turns about z are not seen."""
    rate, turn = 2 * np.cos(2 * TIME), np.sin(2 * TIME)
    zero = np.zeros_like(TIME)
    motion = {"time": TIME, "qx": zero, "qy": zero, "qz": np.sin(turn / 2), "qw": np.cos(turn / 2)}
    motion |= {"wx": zero, "wy": zero, "wz": rate, "alx": zero, "aly": zero, "alz": -4 * np.sin(2 * TIME)}
    motion |= {f"ap{a}": zero for a in "xyz"} | {f"p{a}": zero for a in "xyz"} | {f"vp{a}": zero for a in "xyz"}
    tool = {"m": 1.0, "mx": 0.05, "my": -0.02, "mz": 0.1, "Izz": 0.01}
    found = fitted(spatial(Rig(sensor=SensorDescription(convention=Convention.ON_TOOL))), motion, tool)
    assert {d.names for d in found.unidentifiable} == {("bias_fz", "m"), ("mz",), ("Ixx",), ("Ixy",), ("Iyy",)}
    weight = next(d for d in found.unidentifiable if "m" in d.names)
    assert weight.amounts[1] == pytest.approx(-1 / 9.80665, rel=2e-3)  # F = m (a - g) + bias; g of the rig


def test_the_weakest_direction_is_one_standard_deviation() -> None:
    """Along it the whitened rows change by 1, were all its parts named: theta' Fisher theta = 1."""
    swing = planar_motion(0.05 * np.sin(3 * TIME), 3 * np.cos(5 * TIME), 2 * np.sin(7 * TIME))
    found = fitted(planar(), swing, TOOL)
    weakest = found.weakest
    assert weakest is not None
    scaled_svd = found.scaled_svd
    whole = scaled_svd.right[-1] / scaled_svd.singular[-1] / scaled_svd.scale
    assert np.linalg.norm(found.information.root @ whole) == pytest.approx(1.0)
    named = dict(zip(weakest.names, weakest.amounts, strict=True))
    for parameter, amount in zip(found.unknowns, whole * np.sign(whole @ whole), strict=True):
        if parameter.name in named:
            assert abs(named[parameter.name]) == pytest.approx(abs(amount))
    # No direction of unit columns is less certain.
    assert found.ordinary is not None  # the std that is told is that in the colour of the residual
    covariance = found.ordinary.covariance * np.outer(scaled_svd.scale, scaled_svd.scale)
    assert np.linalg.eigvalsh(covariance)[-1] == pytest.approx(1 / scaled_svd.singular[-1] ** 2, rel=1e-6)


@given(seed=st.integers(0, 2**32 - 1), hidden=st.integers(1, 4), ties=st.integers(0, 2))
@settings(deadline=None)  # a busy machine is no failure
def test_every_sentence_is_true_and_all_is_said(seed: int, hidden: int, ties: int) -> None:
    """Columns of which some vanish and some are sums of two others: each direction changes nothing but for parts left
    unsaid, together they span all that is not seen, and none names more than what is tied."""
    rng = np.random.default_rng(seed)
    size = 12
    columns = rng.standard_normal((50, size)) * 10.0 ** rng.integers(-4, 5, size)
    places = rng.permutation(size)
    columns[:, places[:hidden]] = 0.0
    for tie in range(ties):
        a, b, c = places[hidden + 3 * tie : hidden + 3 * tie + 3] if hidden + 3 * tie + 3 <= size else places[-3:]
        columns[:, a] = 2 * columns[:, b] - columns[:, c]
    parameters = [Parameter(name=f"p{i}", unit="N") for i in range(size)]
    scaled_svd = ScaledSVD.of(np.asarray(np.linalg.qr(columns, mode="r")))
    found = unidentifiable_directions(scaled_svd, parameters)
    assert len(found) == size - np.linalg.matrix_rank(columns / scaled_svd.scale, tol=1e-9)
    for direction in found:
        index = [parameters.index(p) for p in direction.parameters]
        change = columns[:, index] @ direction.amounts
        assert np.linalg.norm(change) <= 2 * UNIDENTIFIABLE_SHARE * np.linalg.norm(
            columns[:, index] * direction.amounts
        )
        assert direction.amounts[0] == 1
        assert len(index) <= 3
    alone = {d.names for d in found if len(d.names) == 1}
    assert alone >= {(f"p{i}",) for i in places[:hidden]}
    assert least_certain_direction(scaled_svd, parameters) is not None
