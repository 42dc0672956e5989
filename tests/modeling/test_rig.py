"""The rig file: what it gives, and one line for each way in which it can be wrong."""

import os
import pickle
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from modeling.errors import InputError, TruewrenchError
from modeling.rig import Convention, Rig

FULL = """
[robot]
name = "arm"
link_lengths = [1.0, 0.97, 0.4]
tip_length = 0.2
gravity = 9.81
[limits]
position = [1.05, [-1.0, 1.22], 1.40]
velocity = [2.0, 2.2, 3.5]
acceleration = [10, 10, 15]
[workspace]
x = [-1.5, 2.0]
[sensor]
noise = { fx = 0.8, fy = 1.6, tau = 0.08 }
convention = "on_tool"
mirror_y = true
"""


def rig_file(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def test_file_is_read_as_it_stands(tmp_path: Path) -> None:
    rig = Rig.read(rig_file(tmp_path, FULL))
    assert (rig.name, rig.link_lengths, rig.tip_length, rig.gravity) == ("arm", (1.0, 0.97, 0.4), 0.2, 9.81)
    assert rig.limits is not None
    assert rig.limits.position.tolist() == [[-1.05, 1.05], [-1.0, 1.22], [-1.4, 1.4]]
    assert rig.limits.jerk is None
    assert rig.workspace is not None
    assert (rig.workspace.x, rig.workspace.y) == ((-1.5, 2.0), None)
    assert rig.sensor.convention is Convention.ON_TOOL
    assert rig.sensor.noise == {"fx": 0.8, "fy": 1.6, "tau": 0.08}
    assert rig.sensor.mirror_y


def test_rig_may_say_nothing(tmp_path: Path) -> None:
    for rig in (Rig(), Rig.read(rig_file(tmp_path, ""))):
        assert rig.to_data() == Rig().to_data()
        assert rig.gravity == 9.806
        assert rig.sensor.convention is None


def test_data_round_trip(tmp_path: Path) -> None:
    data = Rig.read(rig_file(tmp_path, FULL)).to_data()
    again = Rig.from_data(data)
    assert again.to_data() == data
    assert again.limits is not None
    np.testing.assert_array_equal(again.limits.position[1], [-1.0, 1.22])


WRONG = {
    "robot.length": ("[robot]\nlength = 3", "no such key"),
    "robotics": ("[robotics]\nx = 1", "no such key"),
    "robot.link_lengths[1]": ("[robot]\nlink_lengths = [1.0, -0.97]", "-0.97"),
    "robot.link_lengths[0]": ("[robot]\nlink_lengths = [inf]", "inf"),
    "robot.link_lengths": ("[robot]\nlink_lengths = 1.0", "1.0"),
    "robot.gravity": ('[robot]\ngravity = "9.8"', "'9.8'"),
    "robot.tip_length": ("[robot]\ntip_length = true", "True"),
    "robot": ('[robot]\nlink_lengths = [1.0]\nurdf = "arm.urdf"', "got both"),
    "limits.jerk[0]": ("[limits]\nposition=[1]\nvelocity=[1]\nacceleration=[1]\njerk=[nan]", "nan"),
    "limits.velocity": ("[limits]\nposition = [1]", "missing"),
    "limits.position[0]": ("[limits]\nposition=[[2, 1]]\nvelocity=[1]\nacceleration=[1]", "[2, 1]"),
    "limits": ("[limits]\nposition=[1, 1]\nvelocity=[1]\nacceleration=[1]", "'velocity': 1"),
    "each joint of robot.link_lengths": (
        "[robot]\nlink_lengths=[1.0, 2.0]\n[limits]\nposition=[1]\nvelocity=[1]\nacceleration=[1]",
        "2 link_lengths and 1 limits",
    ),
    "workspace.x": ("[workspace]\nx = [1.0, -1.0]", "low below high"),
    "workspace.y": ("[workspace]\ny = 2.0", "2.0"),
    "sensor.convention": ('[sensor]\nconvention = "mine"', "'mine'"),
    "sensor.noise.fx": ("[sensor]\nnoise = { fx = 0 }", "0"),
    "sensor.noise.fq": ("[sensor]\nnoise = { fq = 1 }", "'fq'"),
    "sensor": ("[sensor]\nnoise = { tau = 1, tz = 1 }", "tau"),
    "line 1": ("robot name", "not a TOML file"),
}


def test_a_rig_that_was_read_before_is_the_same_and_needs_no_pydantic(tmp_path: Path) -> None:
    path = rig_file(tmp_path, FULL)
    code = (
        "import sys\nfrom modeling.rig import Rig\n"
        f"rig = Rig.read({str(path)!r})\nprint('pydantic' in sys.modules)\nprint(rig.to_data())"
    )
    environment = os.environ | {"TRUEWRENCH_CACHE": str(tmp_path / "store")}
    command = [sys.executable, "-c", code]
    runs = [subprocess.run(command, text=True, capture_output=True, check=True, env=environment) for _ in range(2)]
    (first, checked), (second, again) = (run.stdout.splitlines() for run in runs)
    assert (first, second) == ("True", "False")
    assert checked == again == str(Rig.from_data(tomllib.loads(FULL)).to_data())


IMPLAUSIBLE = {
    "link_lengths": "[robot]\nlink_lengths = [1.0, {}]",
    "tip_length": "[robot]\ntip_length = {}",
    "gravity": "[robot]\ngravity = {}",
    "gravity_direction": "[robot]\ngravity_direction = [{}, 0.0, 0.0]",
    "noise": "[sensor]\nnoise = {{ fx = {} }}",
    "range": "[sensor]\nrange = {{ fx = {} }}",
    "tolerance": "[sensor]\ntolerance = {{ fx = {} }}",
}


@pytest.mark.parametrize("number", ["1e300", "1e-200"])
@pytest.mark.parametrize("key", IMPLAUSIBLE)
def test_a_number_that_no_rig_has_is_one_line(key: str, number: str, tmp_path: Path) -> None:
    """Its square overflows, or is 0: no number of a model could be computed with it."""
    with pytest.raises(InputError) as caught:
        Rig.read(rig_file(tmp_path, IMPLAUSIBLE[key].format(number)))
    assert key in caught.value.what
    assert str(float(number)) in caught.value.what


def test_gravity_is_in_metres() -> None:
    """The greatest of a planet, Jupiter's, is read; the Earth's in millimetres is not."""
    assert Rig.from_data({"robot": {"gravity": 24.79}}).gravity == 24.79
    with pytest.raises(InputError, match=r"robot.gravity: expected m/s².*got '9806.0'"):
        Rig.from_data({"robot": {"gravity": 9806.0}})


@pytest.mark.parametrize("key", WRONG)
def test_wrong_rig_is_one_line(tmp_path: Path, key: str) -> None:
    text, came = WRONG[key]
    path = rig_file(tmp_path, text)
    with pytest.raises(InputError) as caught:
        Rig.read(path)
    message = str(caught.value)
    assert "\n" not in message
    for part in (str(path), key, came):
        assert part in message


def test_missing_rig_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        Rig.read(tmp_path / "nowhere.toml")


def test_input_error_travels_between_processes() -> None:
    error = InputError(what="two\nlines", where="here", remedy="mend")
    assert str(error) == "here: two lines; mend"
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 - the error's own bytes
    assert isinstance(again, TruewrenchError)
    assert str(again) == str(error)
