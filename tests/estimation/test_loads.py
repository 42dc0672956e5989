"""Several loads, one sensor: known masses tell its scale, unknown ones are tools of their own; MuJoCo simulates."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2

import truewrench as tw
from estimation.case import Case
from estimation.fit import doubted_loads, recordings_of
from estimation.parameter_layout import parameter_layout
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.rig import Convention, Rig
from modeling.rigid_body import Load, known_moments
from modeling.space import Space
from tests.shared.recordings import base, recording_of
from tests.shared.rigs import SIMULATED
from tests.shared.weighed_sensor import (
    CHANNELS,
    LOADS,
    SIDE,
    TWO,
    loaded,
    of_matrix,
    recorded,
    weighed,
    wrenches,
    wrong_matrix,
)
from truewrench import simulated_rig as hidden
from truewrench.command_line import main
from truewrench.files.case_files import load_sentences
from truewrench.simulated_rig.rigs import PlanarRig

pytest.importorskip("mujoco")
Array = NDArray[np.float64]


# ------------------------------------------------------------------------------------------------- the load


def test_moments_are_sums_over_the_masses_and_their_slopes_finite_differences() -> None:
    rng = np.random.default_rng(0)
    masses, places = rng.uniform(0.1, 0.4, 5), rng.uniform(-0.1, 0.1, (5, 3))
    centre = masses @ places / masses.sum()
    squares = np.einsum("n,nij->ij", masses, [r @ r * np.eye(3) - np.outer(r, r) for r in places - centre])
    own = tuple(squares[np.triu_indices(3)])
    load = Load(mass=float(masses.sum()), at=tuple(centre), inertia=own)
    about = np.einsum("n,nij->ij", masses, [r @ r * np.eye(3) - np.outer(r, r) for r in places])
    expected = [masses.sum(), *(masses @ places), *about[np.triu_indices(3)]]
    np.testing.assert_allclose(load.moments(Space.SPACE), expected, rtol=1e-12)
    step = 1e-6
    for row, (mass, *at) in zip(load.slopes(Space.SPACE), step * np.eye(4), strict=True):
        ends = [
            replace(load, mass=load.mass + sign * mass, at=tuple(centre + sign * np.array(at))).moments(Space.SPACE)
            for sign in (1, -1)
        ]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), row, rtol=1e-7, atol=1e-9)


def test_moments_in_the_plane_are_along_the_tip() -> None:
    load = Load(mass=0.5, at=(0.2,), inertia=(0.003,))
    np.testing.assert_allclose(load.moments(Space.PLANE), [0.5, 0.1, 0.5 * 0.04 + 0.003])
    assert known_moments([Load(name="B")], Space.PLANE) is None


@pytest.mark.parametrize(
    ("text", "load"),
    [
        ("2.0@0,0,0.05", TWO),
        ("2.000+-0.001@0,0,0.05+-0.002", replace(TWO, mass_std=0.001, at_std=0.002)),
        ("2.0±1e-3@0,0,5e-2±0.002", replace(TWO, mass_std=0.001, at_std=0.002)),
        ("1.5", Load(mass=1.5)),
        ("gripper B", Load(name="gripper B")),
    ],
)
def test_a_load_is_read_as_it_is_written(text: str, load: Load) -> None:
    assert Load.of(text) == load
    assert Load.from_data(json.loads(json.dumps(load.to_data()))) == load


@pytest.mark.parametrize(
    "text",
    [
        "",
        "-2@0,0,0",
        "0",
        "2kg",
        "2@0;0;0",
        "2+-",
        "2@",
        "1e99@0,0,0",
        "2000@0,0,0.05",
        "2@0,0,50",
        "nan@0,0,0",
        "2@0,0,0,0+-x",
        "@0,0,0",
    ],
)
def test_what_is_no_load_is_one_line(text: str) -> None:
    with pytest.raises(InputError) as error:
        Load.of(text)
    assert "\n" not in str(error.value)


def test_coordinates_of_another_space_are_refused_where_the_recording_is_known() -> None:
    with pytest.raises(InputError, match="3 coordinates"):
        wrenches("empty", 1).carrying("2.0@0.05")


# ------------------------------------------------------------------------------------- the scale of a sensor


def test_three_loads_tell_the_whole_matrix_and_one_recording_does_not() -> None:
    fitted, truth = weighed(0)
    assert fitted.reduced_chi_square == pytest.approx(1.0, abs=0.1)  # std 0.04
    assert not fitted.unidentifiable
    z = [(fitted.values[name] - value) / fitted.parameters[name].std for name, value in truth.items()]
    assert np.sqrt(np.mean(np.square(z))) < 1.6  # 1 but for the scatter of 37, correlated: 5 std
    alone = tw.fit(of_matrix(), recorded(wrong_matrix(0)[0], 0)["empty"])
    assert np.isinf(alone.parameters["m"].std)
    assert np.isinf(alone.parameters["gain.fx"].std)
    wrong = tw.fit(base(Space.SPACE), recorded(wrong_matrix(0)[0], 0), loads=LOADS)
    assert wrong.reduced_chi_square is not None
    assert wrong.reduced_chi_square > 10


@pytest.mark.long(25)
def test_intervals_cover_gains_crosstalk_and_mass_of_twenty_sensors() -> None:
    """Of 95 % intervals; the 37 of a set are correlated: p < 1e-4 were 120 of them independent.

    Of the elements of matrix and correction too, whose whole distances are chi-square, but for the noise that is
    estimated.
    """
    covered, elements, distance = [], [], 0.0
    for seed in range(20):
        fitted, truth = weighed(seed)
        ends = fitted.params
        covered += [bool(ends.low[name] <= value <= ends.high[name]) for name, value in truth.items()]
        assert abs(fitted.values["gain.fx"] - truth["gain.fx"]) < 5 * fitted.parameters["gain.fx"].std
        sensor, matrix = tw.sensor_matrix(fitted), wrong_matrix(seed)[0]
        errors = {False: sensor.matrix - matrix, True: sensor.correction - np.linalg.inv(matrix)}
        elements += [np.abs(error) < 1.96 * sensor.std(correction=of) for of, error in errors.items()]
        covariance, error = sensor.covariance_of(correction=True)[:36, :36], errors[True].ravel()
        distance += float(error @ np.linalg.solve(covariance, error))
    assert binom.cdf(round(120 * float(np.mean(elements))), 120, 0.95) > 1e-4
    assert chi2.ppf(1e-4, 720) < distance < 1.1 * chi2.ppf(1 - 1e-4, 720)
    share = float(np.mean(covered))
    assert binom.cdf(round(120 * share), 120, 0.95) > 1e-4
    assert share < 0.995


def test_diagnose_names_the_gain_that_is_common_to_all_channels() -> None:
    """A gain of 5 % in every channel: without loads it is the tool's mass, with them no other effect."""
    several = recorded(1.05 * np.eye(6), 5)
    candidates = ["gain", "sensor_crosstalk", "sensor_rotation", "viscous_drag", "gain_nonlinearity", "gravity_tilt"]
    found = tw.diagnose(base(Space.SPACE), several, loads=LOADS, effects=candidates)
    assert found.added == ("gain",)
    for channel in CHANNELS:
        estimate = found.fit.parameters[f"gain.{channel}"]
        assert abs(estimate.value - 1.05) < 4 * estimate.std < 0.02
    alone = tw.diagnose(base(Space.SPACE), several["two"], effects=candidates[1:])
    assert alone.added == ()


def test_nothing_is_found_where_nothing_is_hidden_and_drag_where_it_is() -> None:
    candidates = ["gain", "sensor_crosstalk", "viscous_drag", "sensor_lag", "gravity_tilt", "sensor_rotation"]
    assert tw.diagnose(base(Space.SPACE), recorded(np.eye(6), 6), loads=LOADS, effects=candidates).added == ()
    dragged = recorded(np.eye(6), 7, (hidden.ViscousDrag(),))
    found = tw.diagnose(base(Space.SPACE), dragged, loads=LOADS, effects=candidates)
    assert found.added == ("viscous_drag",)


def test_a_recording_with_a_load_is_that_of_the_heavier_tool() -> None:
    """Known mass, known scale: the tool less the load, whichever recordings there are."""
    recording = recorded(np.eye(6), 8)["two"]
    heavy, light = tw.fit(base(Space.SPACE), recording), tw.fit(base(Space.SPACE), recording.carrying(TWO))
    moved = heavy.theta - light.theta
    expected = np.zeros(16)
    expected[6:] = TWO.moments(Space.SPACE)
    np.testing.assert_allclose(moved, expected, atol=1e-9)
    np.testing.assert_allclose(heavy.covariance, light.covariance, rtol=1e-6, atol=1e-18)
    assert not recording.carrying(TWO).is_reading_of(recording)


# -------------------------------------------------------------------------------------------- unknown loads


def test_tools_with_unknown_loads_are_their_own_and_share_the_sensor() -> None:
    """Each is the rig's with that load; sensor parameters are one."""
    several = recorded(np.eye(6), 9)
    fitted = tw.fit(base(Space.SPACE) + "sensor_lag", several, loads={"two": "B", "side": "C"})
    assert fitted.layout.other_tools == ("B", "C")
    for tool, load in (("B", TWO), ("C", SIDE)):
        rig, estimates = loaded(load), fitted.of_tool(tool)
        truth = dict(zip(("m", "mx", "my", "mz"), (rig.mass, *rig.first_moment), strict=True))
        for name, value in truth.items():
            assert abs(estimates[name].value - value) < 5 * estimates[name].std
            assert fitted.parameters[f"{name}@{tool}"].value == estimates[name].value
    assert sum(name.startswith("sensor_lag") for name in fitted.parameters) == 1
    with pytest.raises(InputError, match="no recording carried"):
        fitted.of_tool("D")


def test_recordings_of_one_unknown_tool_share_it_and_that_without_is_the_models() -> None:
    empty, two = (recorded(np.eye(6), 10)[name] for name in ("empty", "two"))
    several = [two.carrying("B"), empty, replace(two, name="again").carrying("B")]
    layout = parameter_layout(base(Space.SPACE), several)
    assert layout.other_tools == ("B",)
    assert len(layout.parameters) == 16 + 10 + 12
    mass = [p.name for p in layout.parameters].index("m@B")
    assert [mass in index for index in layout.index] == [True, False, True]
    alone = parameter_layout(base(Space.SPACE), [two.carrying("B")])
    assert [p.name for p in alone.parameters][6] == "m"


def test_every_tool_is_physically_consistent_where_that_is_asked_for() -> None:
    """A body of a point's mass pulls its own tool alone out of consistency: weak noise-free inertia, then held."""
    several = recorded(np.eye(6), 11)
    bent = several["side"]
    free = tw.fit(base(Space.SPACE), {"empty": several["empty"], "side": bent}, loads={"side": "C"})
    held = tw.fit(
        base(Space.SPACE), {"empty": several["empty"], "side": bent}, loads={"side": "C"},
        constraints=tw.Constraints(physical=True),
    )  # fmt: skip
    np.testing.assert_allclose(held.theta, free.theta, atol=1e-6)  # both are bodies
    thin = bent.with_readings(bent.wrench.copy())
    pushed = thin.with_readings(thin.wrench + np.array([0, 0, 0, 1, 0, 0]) * 0.2 * thin.signals["alx"][:, None] * -1)
    for bounds in (None, tw.Constraints(physical=True)):
        fitted = tw.fit(
            base(Space.SPACE), {"empty": several["empty"], "side": pushed}, loads={"side": "C"}, constraints=bounds
        )
        tool = fitted.of_tool("C")
        xx, xy, xz, yy, yz, zz = (tool[name].value for name in ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        moment = np.array([tool[name].value for name in ("mx", "my", "mz")])
        pseudo = np.block([[np.trace(inertia) / 2 * np.eye(3) - inertia, moment[:, None]], [moment, tool["m"].value]])
        assert (np.linalg.eigvalsh(pseudo)[0] > 0) == (bounds is not None)
        assert any("with C" in remark for remark in fitted.remarks()) == (bounds is None)


def test_held_out_recordings_are_of_the_tool_that_is_fitted() -> None:
    several = recorded(np.eye(6), 12)
    with pytest.raises(InputError, match="hold out a recording of that tool"):
        tw.diagnose(base(Space.SPACE), several["empty"], validate={"two": several["two"]}, loads={"two": "B"})
    found = tw.diagnose(
        base(Space.SPACE), {"empty": several["empty"]}, validate={"two": several["two"]}, loads={"two": TWO},
        effects=["viscous_drag", "payload_change"],
    )  # fmt: skip
    assert found.added == ()
    assert found.verdict.value == "nothing_missing"


# ------------------------------------------------------------------------------------- what a load's error does


@pytest.mark.parametrize(("part", "size"), [("mass", 0.004), ("place", 0.0005)])
def test_a_load_that_is_wrong_moves_the_estimates_as_the_budget_says(part: str, size: float) -> None:
    """The load in the simulator is heavier, or off by so much along x; shared by two recordings."""
    wrong = replace(TWO, mass_std=size if part == "mass" else 0.0, at_std=size if part == "place" else 0.0)
    true = replace(TWO, mass=2.0 + size) if part == "mass" else replace(TWO, at=(size, 0.0, 0.05))
    model = base(Space.SPACE) + "gain"
    several = recorded(np.eye(6), 13)
    stated = tw.fit(model, several, loads={"two": wrong, "side": SIDE})
    moved = tw.fit(model, several, loads={"two": true, "side": SIDE})
    budget = tw.budget(stated)
    (source,) = budget.sources
    shift = size * source.shifts[0]  # of the mass, or of the first coordinate
    change = stated.theta - moved.theta
    size_of_all = np.abs(change).max()
    np.testing.assert_allclose(shift, change, rtol=0.03, atol=0.003 * size_of_all)
    assert budget["m"].parts[f"{part} of 2 kg"] == pytest.approx(size * np.linalg.norm(source.shifts[:, 6]))


@pytest.mark.long(12)
def test_linear_and_drawn_intervals_of_loads_agree() -> None:
    several = recorded(np.eye(6), 14)
    loads = {"two": replace(TWO, mass_std=0.003, at_std=0.001), "side": SIDE}
    budget = tw.budget(tw.fit(base(Space.SPACE) + "gain", several, loads=loads), monte_carlo=200)
    checked = [line.agrees for line in budget.lines if "@" not in line.quantity and "bias" not in line.quantity]
    assert len(checked) == 16
    assert False not in checked
    with pytest.raises(InputError, match="has a std"):
        tw.budget(tw.fit(base(Space.SPACE), several, loads=LOADS))


# ------------------------------------------------------------------------------------------ files and commands


def written(folder: Path, several: dict[str, Recording]) -> list[str]:
    for name, recording in several.items():
        recording.to_frame().to_csv(folder / f"{name}.csv", index=False)
    return [str(folder / f"{name}.csv") for name in several]


RIG = """
[sensor]
convention = "on_tool"
[[load]]
recording = "two.csv"
mass = 2.0
at = [0, 0, 0.05]
mass_std = 0.001
[[load]]
recording = ["side.csv", "other/side.csv"]
name = "side"
mass = 1.0
at = [0.06, -0.03, 0.02]
"""


def test_the_rig_and_the_command_line_state_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, recorded(1.05 * np.eye(6), 15))
    (tmp_path / "rig.toml").write_text(RIG)
    rig, plain = str(tmp_path / "rig.toml"), str(tmp_path / "plain.toml")
    Path(plain).write_text(RIG.partition("[[load]]")[0])
    options = ["--load", "two.csv=2.0+-0.001@0,0,0.05", "--load", f"{files[2]}=1.0@0.06,-0.03,0.02"]
    results = []
    for stated in (["--rig", rig], ["--rig", plain, *options]):
        assert main(["fit", *files, "--add", "gain", *stated, "--json"]) == 0
        results.append(json.loads(capsys.readouterr().out))
    assert results[0]["parameters"] == results[1]["parameters"]
    assert results[0]["parameters"]["gain.fz"]["value"] == pytest.approx(1.05, abs=0.01)
    assert results[0]["budget"]["parameters"]["m"]["contributions"]["mass of 2 kg"] > 0
    assert results[1]["loads"]["two.csv"] == [{"mass": 2.0, "at": [0, 0, 0.05], "mass_std": 0.001, "at_std": 0.0}]
    read = Rig.read(rig)
    assert Rig.from_data(read.to_data()).loads == read.loads
    assert read.loads_of("other/side.csv") == (read.loads_of("side.csv")[0],) * 2
    assert tw.read(files[1], rig=read).loads == (replace(TWO, mass_std=0.001),)


def test_what_a_recording_carried_is_said_and_an_idle_load_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = written(tmp_path, recorded(np.eye(6), 16))
    (tmp_path / "rig.toml").write_text(RIG)
    assert main(["fit", *files[:2], "--rig", str(tmp_path / "rig.toml")]) == 0
    said = capsys.readouterr().out
    assert "two.csv carries 2±0.001 kg at (0, 0, 0.05) m beside the tool." in said
    assert "loads of side.csv, other/side.csv, of which no recording is given" in said


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (["--load", "tow.csv=2@0,0,0.05"], "did you mean"),
        (["--load", "two.csv=2kg"], "is no load"),
        (["--load", "2@0,0,0.05"], "names no recording"),
        (["--load", "two.csv=2@0.05"], "3 coordinates"),
        (["--load", "two.csv=2@0,0,0.05", "--stream"], "--load"),
    ],
)
def test_a_wrong_load_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], stated: Sequence[str], said: str
) -> None:
    files = written(tmp_path, {name: wrenches(name, n) for n, name in enumerate(("empty", "two"), 1)})
    files = files[1:] if "--stream" in stated else files
    assert exit_code(["fit", *files, *stated]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("error:") == 1


def exit_code(arguments: Sequence[str]) -> int | str | None:
    """Of the command, whose parser exits by itself."""
    try:
        return main(arguments)
    except SystemExit as error:
        return error.code


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('recording = "two.csv"', "expected a mass, or the name"),
        ("mass = 2.0\nat = [0, 0, 0.05]", "recording: missing"),
        ('recording = "two.csv"\nmass = -2.0', "mass"),
        ('recording = ""\nmass = 2.0', "recording is empty"),
        ('recording = "two.csv"\nmass = 2.0\nplace = [0, 0, 0]', "no such key"),
        ('recording = "two.csv"\nmass = 2.0\ninertia = [1, 0, 0, 0, 0, 0]', "about its centre"),
    ],
)
def test_a_wrong_load_of_the_rig_is_one_line(tmp_path: Path, table: str, said: str) -> None:
    (tmp_path / "rig.toml").write_text(f"[[load]]\n{table}\n")
    with pytest.raises(InputError, match=said) as error:
        Rig.read(tmp_path / "rig.toml")
    assert "\n" not in str(error.value)


def test_chunks_do_not_say_what_was_carried() -> None:
    recording = recorded(np.eye(6), 17)["two"].carrying(TWO)
    with pytest.raises(InputError, match="which chunks do not say"):
        list(tw.chunks(recording, 100))
    with pytest.raises(InputError, match="give a recording of the tool alone"):
        tw.Monitor(tw.fit(base(Space.SPACE), recording))
    with pytest.raises(InputError, match="which chunks do not say"):
        tw.read_chunks("logs/two.csv", rig=Rig(loads=(("two.csv", TWO),)))
    noise = tw.NoiseModel.white(SIMULATED[Space.SPACE].noise)
    with pytest.raises(InputError, match="loads are of whole recordings"):
        tw.fit(base(Space.SPACE), {"two": recording}, loads={"two": TWO}, noise=noise)  # type: ignore[call-overload]


def test_a_load_on_the_tip_in_the_plane() -> None:
    rig = SIMULATED[Space.PLANE]
    assert isinstance(rig, PlanarRig)
    heavy = replace(rig, mass=rig.mass + 0.5, mlg=rig.mlg + 0.5 * 0.1, inertia=rig.inertia + 0.5 * 0.01)
    several = {
        name: recording_of(
            hidden.simulate(one, one.random_motion(seed=n), hidden=[], repeats=3, samples_per_period=200, seed=n),
            without=("temperature",),
            rig=Rig.from_data({"robot": {"link_lengths": list(rig.link_lengths)}}),
        )
        for n, (name, one) in enumerate((("empty", rig), ("half", heavy)), 1)
    }
    fitted = tw.fit(tw.planar() + "common_gain", several, loads={"half": "0.5@0.1"})
    for name, value in (("common_gain.gain", 1.0), ("m", rig.mass), ("mlg", rig.mlg)):
        assert abs(fitted.values[name] - value) < 5 * fitted.parameters[name].std


# ----------------------------------------------------------------------------------- loads that are not as stated


def both(matrix: Array) -> dict[str, Recording]:
    return {name: recording for name, recording in recorded(matrix, 20).items() if name != "side"}


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"empty": TWO}, "By the readings empty carries -2 kg more than two, by the loads stated 2 kg"),
        ({"two": replace(TWO, mass=0.9)}, "two carries 2 kg more than empty, by the loads stated 0.9 kg"),
        (
            {"two": replace(TWO, at=(0.0, 0.0, 0.12))},
            r"is at \(0, 0, 0.05\) m, by the loads stated at \(0, 0, 0.12\) m",
        ),
    ],
)
def test_a_load_that_the_readings_contradict_is_named(stated: dict[str, Load], said: str) -> None:
    """Mass and place as simulated, within half of the last digit that is printed or 30 std."""
    several = both(np.eye(6))
    case = Case.of(base(Space.SPACE), recordings_of(several, "fit", stated))
    (sentence,) = doubted_loads(case.model, case.recordings)
    assert re.search(said, sentence)
    assert sentence in load_sentences(case.recordings, case.model)


@pytest.mark.parametrize("effect", [None, hidden.SensorHysteresis(), hidden.SensorLag(), hidden.SensorCrosstalk()])
def test_no_load_is_doubted_that_is_as_stated(effect: hidden.HiddenEffect | None) -> None:
    """Not by effects that a rigid tool lacks, nor by gains that are 5 % too large."""
    effects = () if effect is None else (effect,)
    several = recorded(1.05 * np.eye(6), 19, effects)
    case = Case.of(base(Space.SPACE), recordings_of(several, "fit", LOADS))
    assert doubted_loads(case.model, case.recordings) == []


def test_a_load_in_grams_is_said_in_place_of_another_sign_convention() -> None:
    several = both(np.eye(6))
    with pytest.raises(InputError, match=r"two carries 2 kg more than empty, by the loads stated 200 kg"):
        tw.fit(base(Space.SPACE), several, loads={"two": "200@0,0,0.05"})


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        ({"two": ["1@0,0,0.05", "1@0,0,0.05"]}, "stated twice"),
        ({"two": 2.0}, "'2.0' is no load"),
        ({"two": None}, "'None' is no load"),
        ({"two": "nan"}, "'nan' is no load"),
        ({1: "2@0,0,0.05"}, "of '1', and no recordings are called so"),
        ([("two", "2@0,0,0.05")], "a list is no loads"),
    ],
)
def test_what_states_no_load_is_one_line_in_python(loads: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        tw.fit(base(Space.SPACE), {"two": wrenches("two", 2)}, loads=loads)


def test_a_load_of_a_name_that_two_recordings_have_is_refused() -> None:
    several = [replace(wrenches(name, n), name="log") for n, name in ((1, "empty"), (2, "two"))]
    with pytest.raises(InputError, match="2 recordings are called so"):
        tw.fit(base(Space.SPACE), several, loads={"log": TWO})


def test_a_contact_wrench_says_what_its_recording_carried(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Known loads are subtracted, as the rig in the model file states them; what an unknown one weighs is left."""
    files = written(tmp_path, recorded(np.eye(6), 17))
    model = str(tmp_path / "model.json")
    stated = ["--load", "two.csv=2.0@0,0,0.05", "--load", "side.csv=B"]
    assert main(["fit", *files, *stated, "--out", model, "--quiet"]) == 0
    capsys.readouterr()
    for file, said in (
        (files[1], "two.csv carries 2 kg at (0, 0, 0.05) m"),
        (files[2], "What B weighs is in the contact"),
    ):
        assert main(["compensate", model, file]) == 0
        assert said in capsys.readouterr().out


def test_monte_carlo_needs_the_std_of_a_load(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, recorded(np.eye(6), 18))[:2]
    (tmp_path / "rig.toml").write_text(RIG)
    rigged = ["--rig", str(tmp_path / "rig.toml"), "--json", "--monte-carlo", "100"]
    assert main(["fit", *files, *rigged]) == 0
    assert "monte_carlo" in capsys.readouterr().out
    assert main(["fit", *files, "--load", "two.csv=2.0@0,0,0.05", "--monte-carlo", "100"]) == 2
    assert "there is no budget to check" in capsys.readouterr().err


def test_frames_are_told_by_a_weight_that_turned() -> None:
    """Not by the heaviest load where that was hardly turned. Two estimates within 5 std."""
    rig = loaded(TWO)
    still = replace(rig, position_limit=(0.05, 0.03), velocity_limit=(0.2, 0.06), acceleration_limit=(1.0, 0.2))
    frame = hidden.simulate(still, still.random_motion(seed=2), repeats=3, samples_per_period=150, seed=2)
    several = {"empty": recorded(np.eye(6), 21)["empty"], "two": recording_of(frame, without=("temperature",))}
    fitted = tw.fit(tw.spatial() + "common_gain", several, loads={"two": TWO})
    assert fitted.model.convention is Convention.ON_TOOL
    for name, truth in (("m", SIMULATED[Space.SPACE].mass), ("common_gain.gain", 1.0)):
        assert abs(fitted.values[name] - truth) < 5 * fitted.parameters[name].std


def test_a_calibration_has_the_errors_of_the_loads_in_its_std_in_python_too(tmp_path: Path) -> None:
    """As the budget says, by which the torques' gains are told by the place alone."""
    stated = replace(TWO, mass_std=0.001, at_std=0.001)
    fitted = tw.fit(base(Space.SPACE) + "gain", both(np.eye(6)), loads={"two": stated})
    size = len(fitted.theta)
    covariance = tw.budget(fitted).calibration.covariance[:size, :size]
    names = list(fitted.parameters)
    std = [np.sqrt(covariance[i, i]) for i in (names.index(f"gain.{channel}") for channel in CHANNELS)]
    for one in (fitted, tw.study(base(Space.SPACE) + "gain", both(np.eye(6)), loads={"two": stated})):
        np.testing.assert_allclose(np.diag(tw.sensor_matrix(one).std(correction=False)), std, rtol=1e-6)
    assert std[3] > 5 * fitted.parameters["gain.tx"].std
    read = tw.load(tw.save(fitted, tmp_path / "model.json"))
    np.testing.assert_allclose(np.diag(tw.sensor_matrix(read).std(correction=False)), std, rtol=1e-6)
