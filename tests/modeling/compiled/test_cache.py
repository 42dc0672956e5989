"""The store: what was derived is found again, by any process; whatever happens to the folder, the answer stays."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from modeling import effects
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.chain.prediction import Prediction
from modeling.chain.stages import Bias
from modeling.compiled import cache as store
from modeling.compiled.cache import cached, source_digest, trim
from modeling.compiled.tape_evaluation import TapeEvaluation
from modeling.compiled.vector_function import CompiledVector
from modeling.formulas.custom_effect import CustomEffect
from modeling.parameter import Parameter
from modeling.space import Space
from tests.modeling.effects.cases import CASES, Case
from tests.modeling.effects.parts import random_signals

Array = NDArray[np.float64]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty store."""
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path / "store"))
    return tmp_path / "store"


def entries(folder: Path) -> list[Path]:
    """The files in a store."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


class Derivation:
    """Counts how often it is asked."""

    calls = 0

    def __call__(self) -> Mapping[str, Any]:
        self.calls += 1
        return {"half": [0.5, 1e-300], "infinite": float("inf")}


def asked(derive: Derivation, what: str = "it") -> Mapping[str, Any]:
    """The derivation's result, from the store where it is there."""
    return cached({"what": what}, derive, lambda data: {"half": list(data["half"]), "infinite": data["infinite"]})


RESULT = Derivation()()


# ------------------------------------------------------------------------------------------- what is found


def readings(model: WrenchModel, case: Case) -> list[Any]:
    """All that a model's prediction says of itself, and its parts at random signals."""
    rng, samples = np.random.default_rng(8), 50
    prediction = Prediction(model)
    found: list[Any] = [
        model.inputs,
        prediction.has_transfer_function,
        prediction.transfer_parameters,
        prediction.instantaneous,
    ]
    bent = () if prediction.deflection is None else (prediction.deflection.load, prediction.deflection.equilibrium)
    load = () if bent else (prediction.load,)
    for part in (*load, prediction.bias, prediction.play, prediction.saturation, *bent):
        if part is None:
            found.append(None)
            continue
        signals = random_signals(case, part.inputs, samples, rng)
        theta = np.concatenate([case.theta, rng.uniform(0.01, 0.1, part.count - len(case.theta))])
        found += [part.inputs, part.active, part.rows, *part.tangent(signals, theta, samples)]
    if prediction.has_transfer_function:
        gain, slopes = prediction.transfer(np.linspace(0.0, 100.0, 7), case.theta)
        found += [gain, *slopes]
    return found


@pytest.mark.parametrize("case", CASES, ids=str)
def test_what_is_found_is_what_is_derived(case: Case, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(store.CACHE_VARIABLE, "off")
    derived = readings(case.model, case)  # its symbolic parts serve other tests too
    assert not folder.exists()
    monkeypatch.setenv(store.CACHE_VARIABLE, str(folder))
    written = readings(replace(case.model), case)
    assert entries(folder)
    monkeypatch.setattr(WrenchModel, "chain", property(lambda model: pytest.fail("derived again")))
    found = readings(replace(case.model), case)
    for one, two, three in zip(derived, written, found, strict=True):
        np.testing.assert_array_equal(one, two)
        np.testing.assert_array_equal(one, three)


EARLY = [case for case in CASES if case.effect.stage.number <= Stage.NONLINEARITY.number]
LATE = [case for case in CASES if case.effect.stage.number > Stage.NONLINEARITY.number]


MAGNET = {
    "id": "magnet",
    "title": "a field that goes with the position, on the readings",
    "advice": "none",
    "parameters": {"b": {"unit": "N/m"}},
    "zero": {"fx": "b*px"},
}


@pytest.mark.parametrize("case", EARLY, ids=lambda case: f"{case.effect.id}-{case.space.name}")
@pytest.mark.parametrize("formula", [False, True], ids=["catalogue", "formula of the motion"])
def test_parts_from_models_with_fewer_effects_are_those_derived_in_full(case: Case, formula: bool) -> None:
    """Beside two effects after the load, one of which is added first: outline, values and derivatives.

    Effects of the joints change the motion that a user's formula reads.
    """
    first, *_, last = [other.effect for other in LATE if other.space is case.space]
    last = CustomEffect.from_data(MAGNET) if formula else last
    model, rng = case.plain + first + case.effect + last, np.random.default_rng(5)
    assert model != model.of_load
    assert (model == model.of_sensor) == (formula and case.effect.needs_joints)
    columns = model.columns
    assert set(model.outline.parts) == set(columns)
    prediction = Prediction(model)
    for name, vector in columns.items():
        part = model.outline.parts[name]
        assert (part.inputs, part.names, part.active) == (vector.inputs, vector.names, vector.active)
        if name != "load" or "equilibrium" not in columns:  # of a deflected load is not compiled by itself
            compiled = prediction.vector(name).compiled
            theta = rng.uniform(0.1, 0.5, len(part.names))
            inputs = list(rng.uniform(0.1, 0.5, (len(part.inputs), 4)))
            expected, found = (TapeEvaluation(c.tape) for c in (CompiledVector.of(vector), compiled))
            if not inputs:
                inputs = [np.zeros(1)]
            np.testing.assert_allclose(found.values(inputs, theta), expected.values(inputs, theta), rtol=1e-9)


def test_models_that_differ_are_kept_apart(folder: Path) -> None:
    drag, other = effects.viscous_drag(), effects.quadratic_drag()
    models = [planar(), planar() + drag, planar() + other, planar() + drag + other, replace(planar(), gravity=9.81)]
    names = []
    for model in models:
        before = set(entries(folder))
        assert model.outline.parts
        names.append(set(entries(folder)) - before)
    assert [len(new) for new in names] == [1] * len(models)


def test_an_arm_matters_where_something_acts_on_joints_only(folder: Path) -> None:
    case = next(case for case in CASES if case.effect.id == "viscous_drag" and case.space is Space.PLANE)
    assert (planar() + case.effect).outline == (case.plain + case.effect).outline
    assert len(entries(folder)) == 1


@dataclass(frozen=True)
class Elsewhere(Effect):
    """An effect whose source nobody follows."""

    id = "elsewhere"
    title = "of another package"
    stage = Stage.BIAS
    equation = "zero = level"
    advice = "look there"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return (Parameter(name="level", unit="N"),)

    def perturb(self, chain: Chain, p: Mapping[str, Any]) -> Chain:
        return chain.with_stage(Bias(chain.bias.applyfunc(lambda entry: entry + p["level"])))


def test_effects_of_other_packages_are_not_kept(folder: Path) -> None:
    model = planar() + Elsewhere()
    assert Prediction(model).bias.active == (0, 1, 2, 6)
    assert not entries(folder)


def test_nothing_is_derived_twice_by_two_commands(folder: Path) -> None:
    code = (
        "import sys\nimport numpy as np\nfrom modeling.chain.model import planar\nfrom modeling.rig import Rig\n"
        "from modeling import effects\nfrom modeling.chain.prediction import compiled_prediction\n"
        "rig = Rig(link_lengths=(1.0, 0.97, 0.4))\nq = np.linspace(0, 1, 30).reshape(10, 3)\n"
        "signals = rig.arm.pose(q, q, q)\nmodel = planar(rig) + [effects.viscous_drag(), effects.sensor_lag()]\n"
        "prediction = compiled_prediction(model)\ntheta = np.ones(len(model.parameters))\n"
        "value, slopes = prediction.load.tangent(signals, theta, 10)\n"
        "gain = prediction.transfer(np.arange(3.0), theta)[0]\n"
        "print(value.sum(), slopes.sum(), abs(gain).sum(), model.inputs)\n"
        "print('sympy' in sys.modules)"
    )
    runs = [subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True) for _ in range(2)]
    (first, loaded), (second, then) = (run.stdout.splitlines() for run in runs)
    assert (first, loaded, then) == (second, "True", "False")


# --------------------------------------------------------------------------------------- what may go wrong


def test_an_entry_is_derived_once(folder: Path) -> None:
    derive = Derivation()
    assert [asked(derive) for _ in range(3)] == [RESULT] * 3
    assert (derive.calls, len(entries(folder))) == (1, 1)
    asked(derive, "something else")
    assert (derive.calls, len(entries(folder))) == (2, 2)


@pytest.mark.parametrize("damage", ["empty", "short", "garbage", "number", "other"])
def test_a_damaged_entry_is_derived_again_and_mended(damage: str, folder: Path) -> None:
    asked(Derivation())
    (path,) = entries(folder)
    whole = path.read_bytes()
    path.write_bytes(
        {
            "empty": b"",
            "short": whole[:-3],
            "garbage": bytes(range(256)),
            "number": b"17",
            "other": b'{"whole": 1}',
        }[damage]
    )
    derive = Derivation()
    assert asked(derive) == RESULT
    assert (derive.calls, path.read_bytes()) == (1, whole)


@pytest.mark.parametrize("value", ["", "off", "OFF", " ", "~nobody_of_this_name/store"])
def test_a_store_can_be_done_without(value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(store.CACHE_VARIABLE, value)
    derive = Derivation()
    assert [asked(derive), asked(derive)] == [RESULT] * 2
    assert derive.calls == 2
    assert not entries(tmp_path)


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path / "file" / "store"))
    derive = Derivation()
    assert [asked(derive), asked(derive)] == [RESULT] * 2
    assert derive.calls == 2


def test_a_read_only_folder_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """As another user, where there is one to become: nothing is forbidden to root."""
    code = (
        "import os, sys\nfrom modeling.compiled.cache import cached\n"
        "def ask(what, derive): return cached({'what': what}, derive, dict)\n"
        "ask('it', lambda: sys.exit('derived again'))\nif os.geteuid() == 0:\n    os.setuid(65534)\n"
        "print(ask('it', lambda: sys.exit('derived again')), ask('new', lambda: {'new': 1}))"
    )
    with TemporaryDirectory() as name:  # pytest's own folders are not for other users to enter
        folder = Path(name)
        monkeypatch.setenv(store.CACHE_VARIABLE, name)
        asked(Derivation())
        before = entries(folder)
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=False)
        for path in (folder, *folder.iterdir()):
            path.chmod(0o755)
        assert (done.returncode, done.stdout) == (0, f"{dict(RESULT)} {{'new': 1}}\n"), done.stderr
        assert entries(folder) == before


@pytest.mark.parametrize("function", ["replace", "fdopen"])
def test_a_full_disk_leaves_nothing_behind(function: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, function, full)
    derive = Derivation()
    assert [asked(derive), asked(derive)] == [RESULT] * 2
    assert derive.calls == 2
    assert not entries(folder)


def test_nobody_needs_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(store.CACHE_VARIABLE, raising=False)
    monkeypatch.setattr(store, "_platform_folder", lambda: None)
    derive = Derivation()
    assert (asked(derive), asked(derive), derive.calls) == (RESULT, RESULT, 2)


def test_other_versions_have_other_entries(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    derive = Derivation()
    asked(derive)
    monkeypatch.setattr(store, "_origins", lambda: ("sympy 9.9", "casadi 9.9", "source"))
    asked(derive)
    assert (derive.calls, len(entries(folder))) == (2, 2)
    monkeypatch.setattr(store, "CACHE_FORMAT", 0)
    asked(derive)
    assert (derive.calls, len(entries(folder))) == (3, 3)


@pytest.mark.parametrize("upgraded", [False, True])
def test_a_process_older_than_its_source_leaves_no_entry(upgraded: bool, folder: Path, tmp_path: Path) -> None:
    """A notebook that is open during an upgrade: what it derives is not what the new source derives."""
    copied = tmp_path / "library" / "modeling"
    shutil.copytree(store.PACKAGE, copied, ignore=shutil.ignore_patterns("__pycache__"))
    code = (
        "import sys\nfrom modeling.compiled.cache import cached\n"
        f"with open({str(copied / 'number_format.py')!r}, 'a') as module: module.write({'# new' * upgraded!r})\n"
        "print(cached({'what': 'it'}, lambda: {'it': 1}, dict))"
    )
    environment = {**os.environ, "PYTHONPATH": str(copied.parent)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, cwd=tmp_path, text=True, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (0, "{'it': 1}\n"), done.stderr
    assert len(entries(folder)) == 1 - upgraded


def test_a_module_that_cannot_be_read_is_no_error(tmp_path: Path) -> None:
    """The lock of an editor is a link to nothing."""
    (tmp_path / "one.py").write_text("a = 1\n")
    whole = source_digest(tmp_path)
    (tmp_path / ".#one.py").symlink_to("somebody@somewhere.1234")
    assert source_digest(tmp_path) == whole


def test_an_edited_source_is_another(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "one.py").write_text("a = 1\n")
    (tmp_path / "inner" / "two.py").write_text("b = 2\n")
    digests = [source_digest(tmp_path)]
    (tmp_path / "inner" / "two.py").write_text("b = 3\n")
    digests.append(source_digest(tmp_path))
    (tmp_path / "inner" / "two.py").rename(tmp_path / "two.py")
    digests.append(source_digest(tmp_path))
    assert len(set(digests)) == 3


@pytest.mark.long
def test_many_processes_at_once_on_an_empty_store(folder: Path) -> None:
    code = (
        "from modeling import effects\nfrom modeling.chain.model import planar\n"
        "from modeling.chain.prediction import compiled_prediction\n"
        "models = [planar() + e() for e in (effects.viscous_drag, effects.cable_spring, effects.sensor_gain)]\n"
        "print([compiled_prediction(model).load.compiled.to_data() for model in models])"
    )
    command = [sys.executable, "-c", code]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(4)]
    found = [process.communicate() for process in running]
    assert [process.returncode for process in running] == [0] * 4
    assert len({out for out, _ in found}) == 1
    assert {err for _, err in found} == {""}
    assert len(entries(folder)) == 6
    assert {path.suffix for path in entries(folder)} == {".json"}
    again = subprocess.run(command, capture_output=True, text=True, check=True)
    assert again.stdout == found[0][0]


def test_a_store_that_has_grown_too_large_loses_what_was_not_used(folder: Path) -> None:
    paths: list[Path] = []
    for age in range(20):
        cached({"number": age}, lambda: {"data": "x" * 930}, dict)
        (path,) = set(entries(folder)).difference(paths)
        os.utime(path, (1e9 + age, 1e9 + age))
        paths.append(path)
    cached({"number": 0}, lambda: pytest.fail("derived again"), dict)  # and with that it is the latest used
    trim(folder, largest=10_000)
    assert set(entries(folder)) == {paths[0], *paths[-7:]}
    assert sum(path.stat().st_size for path in entries(folder)) <= 0.8 * 10_000
