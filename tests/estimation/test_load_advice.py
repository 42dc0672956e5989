"""Which load to hang next: what is expected of it is what a fit with its recording reports; MuJoCo simulates."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import truewrench as tw
from estimation.fit import Fit
from estimation.load_advice import LoadAdvice
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.rig import Convention, Rig, SensorDescription
from modeling.rigid_body import Load
from modeling.space import Space
from tests.shared.recordings import base, recording_of
from tests.shared.rigs import SIMULATED, carrying
from truewrench import simulated_rig as hidden
from truewrench.command_line import main
from truewrench.simulated_rig.rigs import SpatialRig

pytest.importorskip("mujoco")
Array = NDArray[np.float64]
RIG = SIMULATED[Space.SPACE]
TWO = Load(mass=2.0, at=(0.0, 0.0, 0.05), mass_std=0.002, at_std=0.001)
SIDE, VAGUE = Load(mass=1.0, at=(0.06, -0.03, 0.02)), Load(mass=1.5, at=(0.06, 0.03, 0.0), mass_std=0.3)
OFFERED = (TWO, SIDE, VAGUE)
STATED = Rig(sensor=SensorDescription(convention=Convention.ON_TOOL, range={"fz": 60.0}))


@cache
def recorded(load: Load | None, motion: int, seed: int) -> Recording:
    """Of a sensor whose readings are 3 % too large."""
    assert isinstance(RIG, SpatialRig)
    quiet = replace(RIG, noise=tuple(0.1 * std for std in RIG.noise))
    rig = quiet if load is None or load.mass is None else carrying(quiet, load.mass, load.at)
    gain = hidden.SensorGain(errors=tuple((channel, 0.03) for channel in RIG.channels))
    frame = hidden.simulate(
        rig, rig.random_motion(seed=motion), hidden=[gain], repeats=2, samples_per_period=120, seed=seed
    )
    return recording_of(frame, without=("temperature",), rig=STATED)


def fitted(loads: Mapping[str, Load], *effects: str, fixed: Mapping[str, float] | None = None) -> Fit:
    """The empty tool, and the same motion with each of the loads, in the noise that the first fit has estimated."""
    several = {"empty": recorded(None, 1, 1)}
    several |= {name: recorded(load, 1, 2 + place) for place, (name, load) in enumerate(loads.items())}
    model = base(Space.SPACE)
    for effect in effects:
        model = model + effect
    noise = tw.fit(model, several["empty"]).noise
    bounds = None if fixed is None else tw.Constraints(bounds=fixed)
    return tw.fit(model, several, loads=loads, noise=noise * len(several), constraints=bounds)


def std_with_loads(fit: Fit) -> dict[str, float]:
    """Std of noise and of the loads' errors."""
    uncertain = any(load.mass_std or load.at_std for recording in fit.recordings for load in recording.loads)
    lines = {line.quantity: line for line in tw.budget(fit).lines} if uncertain else {}
    return {
        name: float(np.sqrt(sum(v**2 for v in lines[name].parts.values()))) if name in lines else estimate.std
        for name, estimate in fit.parameters.items()
    }


@pytest.mark.parametrize(
    ("before", "effects", "loads", "error"),
    [
        # The scale is open, and the fit's own is 3 % from the truth; of the matrix so is a second combination.
        ({}, ("gain",), OFFERED, 0.06),
        ({}, ("gain", "sensor_crosstalk"), (SIDE, TWO), 0.08),
        # Nothing is open.
        ({"first": SIDE}, ("gain",), OFFERED, 0.03),
        ({"first": SIDE}, ("gain", "sensor_crosstalk"), (TWO,), 0.03),
    ],
)
def test_expected_std_are_those_of_the_fit_with_that_recording(
    before: Mapping[str, Load], effects: Sequence[str], loads: Sequence[Load], error: float
) -> None:
    now = fitted(before, *effects)
    for load in loads:
        advice = LoadAdvice.of(now, load)
        real = std_with_loads(fitted({**before, "next": load}, *effects))
        for name, std in advice.after.items():
            assert std == pytest.approx(real[name], rel=error), name
        assert bool(advice.missing) == (not before)


def test_a_parameter_that_is_fixed_stays_known() -> None:
    weight = {"m": RIG.mass}
    advice = LoadAdvice.of(fitted({}, "gain", fixed=weight), SIDE)
    real = fitted({"next": SIDE}, "gain", fixed=weight)
    for name, std in advice.after.items():
        assert std == pytest.approx(real.parameters[name].std, rel=0.06), name
    assert advice.before["m"] == advice.after["m"] == 0.0
    assert not advice.missing


@pytest.mark.parametrize("before", [{}, {"first": SIDE}], ids=["empty", "one load"])
def test_the_chosen_load_is_the_best_of_all_refits(before: Mapping[str, Load]) -> None:
    """By the determinant of the covariance of the parameters that it tells, of fits to recordings of each load."""
    fit = fitted(before, "gain")
    advice = LoadAdvice.of(fit, OFFERED)
    size, worth = fit.layout.size, {}
    for load in OFFERED:
        refitted = fitted({**before, "next": load}, "gain")
        covariance = (refitted.ordinary or refitted).covariance[:size, :size].copy()  # of the weights themselves
        for source in tw.budget(refitted).sources if load.mass_std else ():
            covariance += source.std**2 * source.shifts[:, :size].T @ source.shifts[:, :size]
        worth[load] = -np.linalg.slogdet(covariance)[1]
    (chosen,) = advice.recommended
    assert chosen.load == max(worth, key=lambda load: worth[load])
    first = {motion.load: motion.gain for motion in advice.offered if motion.number == 0}
    for load in (TWO, VAGUE):
        assert first[load] - first[SIDE] == pytest.approx(worth[load] - worth[SIDE], abs=0.5)


def test_a_load_of_no_information_leaves_all_as_it_is() -> None:
    """One pose, whose own zero takes whatever hangs there; beside it a recording that tells something."""
    rows = np.arange(6)
    pose = {name: np.full(6, value) for name, value in zip(("qx", "qy", "qz", "qw"), (0.0, 0.6, 0.0, 0.8), strict=True)}
    wrench = {c: 0.1 * np.cos(rows * (i + 1.0)) + i for i, c in enumerate(RIG.channels)}
    fit = tw.fit(base(Space.SPACE) + "gain", from_columns(wrench | pose, rig=STATED))
    advice = LoadAdvice.of(fit, [TWO, SIDE])
    assert not advice.missing
    assert advice.before == pytest.approx(advice.after)
    assert all(abs(motion.gain) < 1e-6 and motion.open == 0 for motion in advice.offered)
    assert "None of these loads tells more" in str(advice)


def test_poses_at_rest_are_repeated_with_a_load() -> None:
    """Inertia shows in none; a fit of the same number of poses with the load identifies what is said to be missing."""
    assert isinstance(RIG, SpatialRig)
    several = [
        replace(recording_of(hidden.static_poses(rig, 12, seed=seed), without=("temperature",)), name=str(seed))
        for seed, rig in enumerate((RIG, carrying(RIG, 1.0, SIDE.at)))
    ]
    fit = tw.fit(base(Space.SPACE) + "gain", several[0])
    advice = LoadAdvice.of(fit, [SIDE, TWO])
    assert advice.never == ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    assert advice.missing == ("m", "mx", "my", "mz", *(f"gain.{channel}" for channel in RIG.channels))
    real = tw.fit(fit.model, several, loads={"1": SIDE})
    assert [name for name in fit.parameters if np.isinf(real.parameters[name].std)] == [*advice.never]
    assert "only from motion or with known loads: m, " in tw.PoseAdvice.of(fit).sentences()[0]


def test_without_a_gain_in_the_model_a_load_tells_no_more_than_the_motion_again() -> None:
    advice = LoadAdvice.of(fitted({}), [TWO, SIDE])
    again, side = (next(m for m in advice.offered if m.load == load) for load in (None, SIDE))
    assert side.gain == pytest.approx(again.gain, abs=1e-9)
    assert "None of these loads tells more" in str(advice)
    assert "takes the scale of the sensor as known" in str(advice)


def test_the_mass_that_is_not_well_known_tells_less() -> None:
    fit = fitted({}, "gain")
    exact, vague = (LoadAdvice.of(fit, replace(SIDE, mass_std=std)).after["m"] for std in (0.0, 0.1))
    assert vague == pytest.approx(np.hypot(exact, 0.1 * RIG.mass / 1.0), rel=0.1)  # the scale is off by 10 %
    assert LoadAdvice.of(fit, [replace(SIDE, mass_std=0.1), SIDE]).recommended[0].load == SIDE


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        ([], "no load to choose from"),
        (["B"], "unknown"),
        (["2@0.05"], "3 coordinates"),
        (["40@0,0,0.05"], "exceeds the range of fz"),
    ],
)
def test_what_cannot_be_hung_is_one_line(loads: Sequence[str], said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        LoadAdvice.of(fitted({}, "gain"), loads)
    assert "\n" not in str(error.value)


def test_a_load_beyond_the_range_is_left_out() -> None:
    advice = LoadAdvice.of(fitted({}, "gain"), ["40@0,0,0.05", SIDE])
    assert [motion.load for motion in advice.recommended] == [SIDE]
    assert "exceeds the range of fz" in str(advice)


def test_the_scale_and_the_mass_are_said_to_be_one_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded(None, 1, 1).to_frame().to_csv(tmp_path / "empty.csv", index=False)
    command = ["fit", str(tmp_path / "empty.csv"), "--add", "gain", "--add", "sensor_crosstalk"]
    assert main([*command, "--next-load", "1.0@0.06,-0.03,0.02", "--next-load", "2.0+-0.002@0,0,0.05"]) == 0
    said = capsys.readouterr().out
    assert "the scale of the sensor and the mass of its tool are one number in these recordings" in said
    assert re.search(r"2 combinations of \d\d parameters are not identifiable from this motion: m to Izz \(10 of", said)
    assert "Hang next 1 kg at (0.06, -0.03, 0.02) m in the motion of empty.csv." in said
    assert max(len(line) for line in said.splitlines()) < 400
    assert main([*command, "--next-load", "1.0@0.06,-0.03,0.02", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert all(
        "this motion: raising" in direction and "Iyy" in direction for direction in data["unseen"]
    )  # data keep all
    assert data["next_load"]["record"][0]["load"]["mass"] == 1.0
    assert data["next_load"]["std"]["m"] is None
    assert data["next_load"]["std_expected"]["m"] > 0
