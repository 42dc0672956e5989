"""Packaging: one version, licences of dependencies listed, a wheel of the sdist that runs in an empty environment."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

import truewrench as tw
from docs.generator.dependency_table import FILE, dependency_file, dependency_table
from modeling.errors import EXTRAS
from tests.shared.places import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BUILD = "import sys; from setuptools import build_meta; getattr(build_meta, sys.argv[1])(sys.argv[2])"
COMPATIBLE = ("MIT", "BSD", "Apache", "PSF", "Python Software Foundation", "LGPL", "any-OSI")
"""Licences, or parts of their names, under which a program of another licence may import a package."""


def test_the_version_has_one_place() -> None:
    """The metadata of the installation say it, and the newest heading of the changes is of it."""
    headings = [
        line for line in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines() if line.startswith("## ")
    ]
    assert headings[0] == f"## {PROJECT['version']}"
    assert tw.__version__ == PROJECT["version"]
    assert PROJECT["version"] not in (ROOT / "CITATION.cff").read_text(encoding="utf-8").replace(
        "cff-version: 1.2.0", ""
    )


def test_dependencies_are_listed_with_their_licences() -> None:
    assert FILE.read_text(encoding="utf-8") == dependency_file(), "run python -m docs.generator.dependency_table"
    for name, licence, _ in dependency_table().rows:
        assert any(known in str(licence) for known in COMPATIBLE), f"{name}: {licence}"


def test_every_requirement_is_pinned() -> None:
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {canonicalize_name(line.partition("==")[0]) for line in lines}
    extras = [text for texts in PROJECT["optional-dependencies"].values() for text in texts]
    needed = {canonicalize_name(Requirement(text).name) for text in [*PROJECT["dependencies"], *extras]}
    assert needed - {"truewrench"} <= pinned
    assert all("==" in line for line in lines)


def test_every_extra_brings_what_it_is_named_for() -> None:
    """Each package that may be missing is required by the extra that its message names, and by no installation."""
    from packaging.requirements import Requirement

    extras = PROJECT["optional-dependencies"]
    for package, extra in EXTRAS.items():
        assert package in {Requirement(text).name for text in extras[extra]}
        assert package not in {Requirement(text).name for text in PROJECT["dependencies"]}
        assert extra in Requirement(extras["all"][0]).extras


WITHOUT = """
import sys
sys.modules |= dict.fromkeys({packages})
from truewrench.command_line import main
sys.exit(main({arguments}))
"""


@pytest.mark.parametrize(
    ("arguments", "package", "extra"),
    [
        (["import", "bag.mcap"], "rosbags", "logs"),
        (["import", "log.xlsx"], "openpyxl", "logs"),
        (["import", "log.h5"], "h5py", "logs"),
        (["fit", "log.parquet"], "pyarrow", "logs"),
        (["import", "log.parquet"], "pyarrow", "logs"),
        (["import", "recording.csv", "--out", "out.parquet"], "pyarrow", "logs"),
        (["survey", "log.csv", "--rig", "rig.toml"], "dask", "survey"),
        (["workbench", "--no-browser"], "bokeh", "workbench"),
    ],
)
def test_a_missing_package_is_one_line_that_says_what_to_install(
    arguments: list[str], package: str, extra: str, tmp_path: Path
) -> None:
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "log.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "log.parquet").write_bytes(b"PAR1")
    write_recording(tmp_path / "recording.csv")
    with zipfile.ZipFile(tmp_path / "log.xlsx", "w") as archive:
        archive.writestr("a", "b")
    (tmp_path / "log.csv").write_text("time,fx,fy,tau,phi\n0,0,0,0,0\n", encoding="utf-8")
    (tmp_path / "rig.toml").write_text("[robot]\n", encoding="utf-8")
    program = WITHOUT.format(packages=[*EXTRAS], arguments=arguments)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=100
    )
    line = f'error: {package}: the package is not installed; pip install "truewrench[{extra}]"\n'
    assert (ran.returncode, ran.stderr) == (2, line)
    assert not (tmp_path / "out.parquet").exists()


def write_recording(path: Path) -> None:
    """Poses at rest of a tool of 1 kg, its noise 0.01 N and 0.002 N m."""
    phi = np.linspace(0, 3, 50)
    wrench = -np.column_stack([9.806 * np.sin(phi), 9.806 * np.cos(phi), 0.7 * np.sin(phi)])
    wrench += np.random.default_rng(1).standard_normal(wrench.shape) * (0.01, 0.01, 0.002)
    np.savetxt(path, np.column_stack([phi, wrench]), delimiter=",", header="phi,fx,fy,tau", comments="")


def test_without_any_extra_a_recording_is_fitted(tmp_path: Path) -> None:
    """Its report has static pictures, no script, and says how figures to zoom are had."""
    write_recording(tmp_path / "log.csv")
    program = WITHOUT.format(packages=[*EXTRAS], arguments=["fit", "log.csv", "--report", "report"])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert "kg" in ran.stdout
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert 'pip install "truewrench[workbench]"' in page
    assert page.count("<img ") >= 1
    assert "<script" not in page
    assert "<button" not in page


# -------------------------------------------------------------------------------------------------- the browser

MISSING = "Chromium, which the tests of the page drive, is missing: apt-get install chromium (Debian, as root), or name"
USERS = {"root": 0, "anybody": 1000}


def made(target: str, folder: Path, user: str = "root", *, apt: bool = True, **variables: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the Makefile alone in a folder, on a machine with nothing but a shell.

    Nothing can be made but the browser: all else has prerequisites that are not there.
    """
    programs = folder / "bin"
    programs.mkdir(exist_ok=True)
    stubs = {"id": f"echo {USERS[user]}"}
    if apt:  # what it installs is a program of that name
        stubs["apt-get"] = f'echo "$@" >> {folder}/asked; case "$*" in *install*) : > {programs}/chromium;; esac'
        stubs["apt-get"] += f"; /bin/chmod +x {programs}/chromium 2>/dev/null; :"
    for name, text in stubs.items():
        (programs / name).write_text(f"#!/bin/sh\n{text}\n")
        (programs / name).chmod(0o755)
    environment = {"PATH": str(programs), **variables}
    make = shutil.which("make")
    assert make is not None
    done = subprocess.run(
        [make, "-f", ROOT / "Makefile", target], cwd=folder, env=environment, capture_output=True, text=True
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.skipif(shutil.which("make") is None or os.name != "posix", reason="by make and a POSIX shell")
@pytest.mark.parametrize("target", ["test", "long", "pictures"])
def test_the_browser_is_installed_once_before_the_tests(target: str, tmp_path: Path) -> None:
    for _ in range(2):
        code, _, said = made(target, tmp_path)
        assert (code, "No rule to make target 'pyproject.toml'" in said) == (2, True)  # what comes next
    asked = (tmp_path / "asked").read_text().splitlines()
    assert [line.split()[1] for line in asked] == ["update", "install"]


@pytest.mark.skipif(shutil.which("make") is None or os.name != "posix", reason="by make and a POSIX shell")
@pytest.mark.parametrize("target", ["test", "long", "pictures"])
@pytest.mark.parametrize("case", ["no root", "no apt-get", "a program that is not there"])
def test_a_browser_that_is_missing_is_said_before_anything_runs(case: str, target: str, tmp_path: Path) -> None:
    named = {"CHROMIUM": "/nonexistent"} if case == "a program that is not there" else {}
    user = "anybody" if case == "no root" else "root"
    code, out, said = made(target, tmp_path, user, apt=case != "no apt-get", **named)
    assert (code, out) == (2, "")
    assert said.splitlines()[0].startswith(MISSING)
    assert len(said.splitlines()) == 2  # make says which target failed
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]


# ------------------------------------------------------------------------------------------- built and installed


def built(hook: str, source: Path, target: Path) -> Path:
    """What a hook of the build backend makes of a source tree, with the pinned setuptools."""
    target.mkdir()
    subprocess.run([sys.executable, "-c", BUILD, hook, str(target)], cwd=source, check=True, capture_output=True)
    (made,) = target.iterdir()
    return made


def tracked_copy(folder: Path) -> Path:
    """What a clone has: nothing that a build in the repository left behind."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((ROOT / name).read_bytes())
    return folder


def environment_with(wheel: Path, folder: Path) -> Path:
    """A new environment that has the wheel alone; the pinned packages are found behind it, the repository is not.

    A path in a `.pth` file is searched, but the `.pth` files of that folder, an editable installation's, are not read.
    """
    import setuptools  # slow to import

    venv.create(folder, with_pip=False)
    site = next(folder.glob("lib/python*/site-packages"))
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(python), "install"]
    subprocess.run([*pip, "--quiet", "--no-deps", "--no-index", str(wheel)], check=True, capture_output=True)
    (site / "pinned.pth").write_text(str(Path(setuptools.__file__).parents[1]), encoding="utf-8")
    return folder / "bin"


@pytest.mark.long(seconds=30)
def test_the_wheel_of_the_sdist_runs_the_demo(tmp_path: Path) -> None:
    """The sdist alone makes the same wheel as the repository; installed, it is what runs, and finds what was hidden."""
    pytest.importorskip("mujoco")
    clone = tracked_copy(tmp_path / "clone")
    sdist = built("build_sdist", clone, tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    wheels = [built("build_wheel", source, tmp_path / f"wheel_of_{source.name}") for source in (clone, unpacked)]
    contents = [{i.filename: i.CRC for i in zipfile.ZipFile(w).infolist()} for w in wheels]
    assert contents[0] == contents[1]
    assert not any(name.split("/")[0] in {"tests", "docs", "benchmarks", "notebooks"} for name in contents[0])
    programs = environment_with(wheels[1], tmp_path / "environment")
    outside = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    where = subprocess.run(
        [programs / "python", "-c", "import truewrench, modeling; print(truewrench.__file__, modeling.__file__)"],
        cwd=tmp_path, env=outside, check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert all(Path(path).is_relative_to(tmp_path / "environment") for path in where.stdout.split())
    demo = [str(programs / "truewrench"), "demo", "--effect", "viscous_drag", "--out", "report"]
    ran = subprocess.run(demo, cwd=tmp_path, env=outside, check=True, capture_output=True, text=True)
    assert "Identified: viscous_drag. Correct." in ran.stdout
    assert (tmp_path / "report" / "report.html").stat().st_size > 10_000
