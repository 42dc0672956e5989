"""The calibration of a sensor: its matrix recovers known ones, its std hold, and its files read back as it is."""

from __future__ import annotations

import csv
import io
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from ruamel.yaml import YAML

import truewrench as tw
from modeling.chain.model import WrenchModel
from modeling.codegen.sensor_matrix import SensorMatrix, csv_table, ros_parameters
from modeling.errors import InputError
from modeling.rig import Convention
from modeling.space import Space
from tests.shared.rigs import SIMULATED
from tests.shared.weighed_sensor import LOADS, of_matrix, weighed, wrenches, wrong_matrix

pytest.importorskip("mujoco")

Array = NDArray[np.float64]

WHOLE = ("gain", "sensor_crosstalk")
"""Effects of which the matrix has an element each."""


def bare(
    space: Space, *effects: str, convention: Convention = Convention.ON_TOOL, mirror_y: bool = False
) -> WrenchModel:
    model = WrenchModel(space=space, convention=convention, mirror_y=mirror_y and space is Space.PLANE)
    for effect in effects:
        model = model + effect
    return model


def drawn(model: WrenchModel, seed: int, spread: float = 1e-3) -> tuple[Array, Array]:
    """Parameters (k,) near the nominal ones, and a covariance (k, k) of correlated errors."""
    rng = np.random.default_rng(seed)
    theta = np.array([p.nominal for p in model.parameters]) + 0.03 * rng.normal(size=len(model.parameters))
    root = spread * rng.normal(size=(len(theta), len(theta))) / np.sqrt(len(theta))
    return theta, np.asarray(root @ root.T)


def by_hand(model: WrenchModel, theta: Array) -> Array:
    """(1 + crosstalk) times gains (p, p), from the parameters by name."""
    values, channels = dict(zip((p.name for p in model.parameters), theta, strict=True)), model.channels
    gains = np.diag([values.get(f"gain.{c}", values.get(f"sensor_gain.{c}", 1.0)) for c in channels])
    leaks = [[values.get(f"sensor_crosstalk.{r}_{c}", 0.0) for c in channels] for r in channels]
    return np.asarray(values.get("common_gain.gain", 1.0) * (np.eye(len(channels)) + np.array(leaks)) @ gains)


@pytest.mark.parametrize("effects", [WHOLE, ("sensor_crosstalk", "sensor_gain"), ("common_gain",), ("sensor_gain",)])
@pytest.mark.parametrize("space", list(Space))
def test_the_matrix_is_that_of_the_chain_in_the_signs_of_the_readings(space: Space, effects: tuple[str, ...]) -> None:
    """Whatever the convention and a mirrored axis: they are no gains. The correction gives the load back."""
    rng = np.random.default_rng(3)
    loads = rng.normal(size=(5, len(space.channels)))
    for convention, mirror_y in product((Convention.ON_TOOL, Convention.ON_SENSOR), (False, True)):
        model = bare(space, *effects, convention=convention, mirror_y=mirror_y)
        theta, covariance = drawn(model, 1)
        sensor = SensorMatrix.of(model, theta, covariance)
        np.testing.assert_allclose(sensor.matrix, by_hand(model, theta), rtol=1e-14)
        np.testing.assert_allclose(sensor.corrected(loads @ sensor.matrix.T + sensor.zero), loads, atol=1e-12)
        assert sensor.scale_determined == (effects[-1] == "common_gain" or effects[0] == "gain")


@pytest.mark.parametrize("space", list(Space))
def test_covariance_is_that_of_the_elements_derivatives(space: Space) -> None:
    """Held against central differences of inverse and matrix, and against draws of the parameters."""
    model = bare(space, *WHOLE)
    theta, covariance = drawn(model, 2)
    sensor, size = SensorMatrix.of(model, theta, covariance), len(model.channels)

    def elements(values: Array, correction: bool) -> Array:
        matrix = by_hand(model, values)
        return np.concatenate([(np.linalg.inv(matrix) if correction else matrix).ravel(), values[:size]])

    draws = np.random.default_rng(5).multivariate_normal(theta, covariance, size=4000)
    for correction in (False, True):
        step = 1e-6 * np.eye(len(theta))
        slopes = [(elements(theta + s, correction) - elements(theta - s, correction)) / 2e-6 for s in step]
        stated = sensor.covariance_of(correction=correction)
        np.testing.assert_allclose(stated, np.array(slopes).T @ covariance @ np.array(slopes), rtol=1e-5, atol=1e-12)
        spread = np.std([elements(values, correction) for values in draws], axis=0)
        np.testing.assert_allclose(spread, np.sqrt(np.diag(stated)), rtol=0.06)  # 5 std of a std of 4000 draws


def test_what_the_recordings_do_not_tell_is_said() -> None:
    model = bare(Space.SPACE, *WHOLE)
    theta, covariance = drawn(model, 4)
    names = [p.name for p in model.parameters]

    def without(*unknown: str) -> Array:
        hidden, places = covariance.copy(), [names.index(name) for name in unknown]
        hidden[places], hidden[:, places] = 0.0, 0.0
        hidden[places, places] = np.inf
        return hidden

    sensor = SensorMatrix.of(model, theta, without("sensor_crosstalk.fx_tz", "bias_fy"))
    for correction in (False, True):
        std = sensor.std(correction=correction)
        assert np.argwhere(np.isinf(std)).tolist() == [[0, 5]]
    assert np.isinf(sensor.zero_std).tolist() == [False, True, False, False, False, False]
    assert "not identifiable, and taken as they stand: fx_tz" in str(sensor)
    with pytest.raises(InputError, match=r"scale of the sensor is not determined.*known load"):
        SensorMatrix.of(model, theta, without(*(f"gain.{c}" for c in model.channels)))
    one = SensorMatrix.of(model, theta, without("gain.tz"))  # the others are told all the same
    assert one.scale_determined
    assert "as they stand: fx_tz, fy_tz, fz_tz, tx_tz, ty_tz, tz_tz" in str(one)
    fixed = covariance.copy()
    place = names.index("gain.fz")
    fixed[place], fixed[:, place] = 0.0, 0.0  # by a bound
    held = SensorMatrix.of(model, theta, fixed)
    assert not held.scale_determined
    relative = bare(Space.SPACE, "sensor_gain", "gain_nonlinearity")
    sensor = SensorMatrix.of(relative, *drawn(relative, 1))
    assert "the scale is not determined: fx read as they did" in str(sensor)
    assert "does not express: gain_nonlinearity" in str(sensor)
    with pytest.raises(InputError, match=r"no gain and no crosstalk.*--add gain sensor_crosstalk"):
        SensorMatrix.of(bare(Space.SPACE), *drawn(bare(Space.SPACE), 1))
    dead = np.where([name.startswith("gain.t") for name in names], 0.0, theta)
    with pytest.raises(InputError, match="no inverse"):
        SensorMatrix.of(model, np.where([name.startswith("sensor_") for name in names], 0.0, dead), covariance)


def test_a_gain_that_depends_on_a_signal_has_no_one_matrix() -> None:
    warm = tw.own_effect(
        id="warm_gain",
        title="gain by temperature",
        parameters={"k": "1/K"},
        inputs={"temperature": "K"},
        gain={"fx_fx": "k * temperature"},
    )
    model = bare(Space.SPACE) + warm
    with pytest.raises(InputError, match="depends on temperature"):
        SensorMatrix.of(model, *drawn(model, 1))


@pytest.mark.parametrize("space", list(Space))
def test_files_read_back_as_they_are(space: Space) -> None:
    """By readers of YAML and CSV that know nothing of it; every array of ROS parameters is of doubles alone."""
    model = bare(space, *WHOLE)
    theta, covariance = drawn(model, 6)
    covariance[0], covariance[:, 0] = 0.0, 0.0
    covariance[0, 0] = np.inf
    sensor, size = SensorMatrix.of(model, theta, covariance), len(model.channels)
    read = YAML(typ="safe").load(ros_parameters(sensor, "a test"))["/**"]["ros__parameters"]["calibration"]
    assert read["channels"] == list(model.channels)
    assert len(read["units"]) == size**2
    rows = list(csv.reader(io.StringIO(csv_table(sensor, "a test"))))[1:]
    for name, correction in (("correction", True), ("matrix", False)):
        matrix, whole = getattr(sensor, name), sensor.covariance_of(correction=correction)
        for key, array in (
            (name, matrix),
            (f"{name}_std", sensor.std(correction=correction)),
            (f"{name}_covariance", whole),
        ):
            assert all(type(number) is float for number in read[key])
            np.testing.assert_array_equal(read[key], array.ravel())
        lines = [row for row in rows if row[0] in (name, "zero")]
        if name == "matrix":
            lines = lines[: size**2]
        numbers = np.array([row[4:] for row in lines], dtype=float)
        values = np.concatenate([matrix.ravel(), sensor.zero])[: len(lines)]
        np.testing.assert_array_equal(numbers[:, 0], values)
        np.testing.assert_array_equal(numbers[:, 2:], whole[: len(lines)])
        np.testing.assert_array_equal(numbers[:, 1], np.sqrt(np.diag(whole))[: len(lines)])
        assert [row[3] for row in lines[: size**2]] == read["units"]
        assert [(row[1], row[2]) for row in lines[: size**2]] == list(product(model.channels, repeat=2))
    assert read["zero_std"][0] == np.inf
    np.testing.assert_array_equal(read["zero"], sensor.zero)


@pytest.mark.long(4)
def test_corrected_readings_of_another_recording_are_those_of_a_perfect_sensor() -> None:
    """A rigid tool fits them, of its true mass, where as read none does."""
    fitted, _ = weighed(1)
    sensor = tw.sensor_matrix(fitted)
    clean, noise = wrenches("two", 8), np.random.default_rng(7).normal(0.0, SIMULATED[Space.SPACE].noise, (450, 6))
    raw = clean.with_readings(clean.wrench @ wrong_matrix(1)[0].T + noise).carrying(LOADS["two"])
    as_read, corrected = (tw.fit(of_matrix().base, r) for r in (raw, raw.with_readings(sensor.corrected(raw.wrench))))
    assert as_read.reduced_chi_square is not None
    assert corrected.reduced_chi_square is not None
    assert as_read.reduced_chi_square > 5
    assert corrected.reduced_chi_square < 1.3
    std = 3.2 * max(sensor.std(correction=False)[i, i] for i in range(3))
    assert abs(corrected["m"].value - 1.2) < 5 * std < 0.05 * 1.2
