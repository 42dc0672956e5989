"""Data sets: an error is that of the first file that cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest

from modeling.errors import InputError
from truewrench.files.case_files import read_case
from truewrench.simulated_rig import SpatialRig, simulate, write_recording


def test_error_is_that_of_the_first_broken_file(tmp_path: Path) -> None:
    rig, whole = SpatialRig(), tmp_path / "whole.csv"
    write_recording(simulate(rig, rig.random_motion(seed=0), repeats=3, samples_per_period=200, seed=0), whole)
    broken = [tmp_path / name for name in ("first.csv", "second.csv")]
    for path in broken:
        path.write_text("time,fx\n0,1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"first\.csv"):
        read_case([str(path) for path in (whole, *broken)])
