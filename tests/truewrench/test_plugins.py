"""Plugins of a package that is installed beside: found, listed with its version, and no harm where they are broken."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from math import cos, sin
from pathlib import Path

import pytest

from tests.shared.places import ROOT

PACKAGE = ROOT / "tests" / "shared" / "example_package"
METADATA = "Metadata-Version: 2.1\nName: example-plugins\nVersion: 1.2\n"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example package as an installer leaves it."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copy(PACKAGE / "example_plugins.py", folder)
    metadata = folder / "example_plugins-1.2.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(METADATA, encoding="utf-8")
    shutil.copy(PACKAGE / "entry_points.txt", metadata)
    return folder


def ran(site: Path, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command beside the package."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(site)))}
    done = subprocess.run(
        [sys.executable, "-m", "truewrench", *arguments], cwd=site, env=environment, capture_output=True, text=True
    )
    return done.returncode, done.stdout, done.stderr


def test_an_effect_is_listed_with_its_package_and_found_by_its_id(installed: Path) -> None:
    code, out, err = ran(installed, "effects")
    assert code == 0
    assert "thrust of a propeller" in out
    assert "By other packages: thrust of example-plugins 1.2; no_class of example-plugins 1.2, not used: " in out
    unused = [line for line in err.splitlines() if line]
    assert [line.split(",")[0] for line in unused] == [
        "warning: no_class of example-plugins 1.2", "warning: not_there of example-plugins 1.2",
    ]  # fmt: skip
    code, out, _ = ran(installed, "effects", "thrust")
    assert code == 0
    assert "F = -c v(r)" in out


def test_a_log_is_read_though_another_reader_fails_on_it(installed: Path) -> None:
    turns = [(0.01 * i, sin(0.01 * i), cos(0.01 * i)) for i in range(400)]
    rows = "".join(f"{time} {sine} {time * sine} 1 0 0 0 {sine} 0 0 {cosine}\n" for time, sine, cosine in turns)
    (installed / "run.log").write_text(f"EXAMPLE time fx fy fz tx ty tz qx qy qz qw\n{rows}", encoding="utf-8")
    code, out, err = ran(installed, "import", "run.log")
    assert (code, "fx" in out, "example" in out) == (0, True, True), err


def test_a_target_writes_a_model(installed: Path) -> None:
    assert ran(installed, "emit", "planar", "--to", "count")[:2] == (0, "the regressor of PLANE\n")
    code, _, err = ran(installed, "emit", "planar", "--to", "cobol")
    assert (code, err.count("\n"), "'cobol' is no language or format" in err) == (2, 1, True)
