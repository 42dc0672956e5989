"""Data sets: recordings read by several processes are those read by one, and so are errors."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest

from estimation.logs.log_reading import read_with_rig
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from truewrench.files import data_set
from truewrench.files.data_set import DataSet
from truewrench.simulated_rig import SpatialRig, simulate, write_recording


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder, rig = tmp_path_factory.mktemp("recordings"), SpatialRig()
    paths = [folder / f"{name}.csv" for name in ("one", "two", "three")]
    for seed, path in enumerate(paths):
        motion = rig.random_motion(seed=seed)
        write_recording(simulate(rig, motion, repeats=3, samples_per_period=200, seed=seed), path)
    return [str(path) for path in paths]


def test_processes_read_what_one_reads(files: list[str]) -> None:
    calls: list[int] = []
    one = DataSet.read(files[:2], validation=files[2:])
    three = DataSet.read(files[:2], validation=files[2:], workers=3, meanwhile=lambda: calls.append(1))
    assert calls == [1]  # in this process; a copy's list would be its own
    assert three.sign is not None
    assert one.sign is not None
    assert three.sign.convention is one.sign.convention
    for here, there in zip(one.training + one.validation, three.training + three.validation, strict=True):
        assert here.name == there.name
        np.testing.assert_array_equal(here.wrench, there.wrench)
        for name, signal in here.signals.items():
            np.testing.assert_array_equal(signal, there.signals[name])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are forked on Linux alone")
def test_a_single_file_is_read_while_this_process_does_something_else(
    files: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    readers = tmp_path / "readers"

    def read(*given: Any, **how: Any) -> Recording:
        with readers.open("a", encoding="utf-8") as file:
            file.write(f"{os.getpid()}\n")
        return read_with_rig(*given, **how)

    monkeypatch.setattr(data_set, "read_with_rig", read)

    def wait_for_reader() -> None:
        for _ in range(3000):
            if readers.exists():
                return
            sleep(0.01)

    (found,) = data_set.read_recordings(files[:1], rig=None, workers=2, meanwhile=wait_for_reader)
    (reader,) = readers.read_text().split()
    assert int(reader) != os.getpid()
    (expected,) = DataSet.read(files[:1]).training
    np.testing.assert_array_equal(found.wrench, expected.wrench)
    assert "signals" in vars(found)  # not to be derived again
    monkeypatch.setattr(data_set, "DIFFERENTIATED_SAMPLES", 10)
    (long,) = data_set.read_recordings(files[:1], rig=None, workers=2)
    assert "signals" not in vars(long)


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_error_is_that_of_the_first_broken_file(files: list[str], tmp_path: Path, workers: int) -> None:
    broken = [tmp_path / name for name in ("first.csv", "second.csv")]
    for path in broken:
        path.write_text("time,fx\n0,1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"first\.csv"):
        DataSet.read([files[0], *map(str, broken)], workers=workers)


def test_recordings_of_processes_are_fitted_alike(files: list[str]) -> None:
    from estimation.fit import fit

    one, two = (DataSet.read(files[:2], workers=workers) for workers in (1, 2))
    values = [fit(case.model, case.training).values for case in (one, replace(two, model=one.model))]
    assert values[0] == values[1]
