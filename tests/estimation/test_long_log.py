"""A log on disk, read and fitted in chunks, against the same columns in memory."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow.csv import write_csv
from pyarrow.parquet import write_table
from scipy.spatial.transform import Rotation

from estimation.fit import fit
from estimation.recordings.column_table import table_file
from estimation.streaming.chunk import Chunk
from estimation.streaming.chunk_information import linear_regressor_map
from estimation.streaming.long_log import read_chunks
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.noises import noise_model
from tests.shared.recordings import base

EXACT = 1e-10
"""Of a std: what chunks may differ from the whole."""
LENGTHS = (1.0, 0.97, 0.4)


def written(folder: Path, suffix: str, space: Space) -> tuple[Path, Chunk]:
    """A log of 1000 rows with its derivatives, and the same as one chunk; joint angles in the plane."""
    rng, n = np.random.default_rng(2), 1000
    tool = base(space)
    if space is Space.PLANE:
        frame = {f"{d}q{j}": rng.standard_normal(n) for d in ("", "d", "dd") for j in (1, 2, 3)}
        series = [np.stack([frame[f"{d}q{j}"] for j in (1, 2, 3)], axis=1) for d in ("", "d", "dd")]
        signals = PlanarArm(LENGTHS).pose(*series)
    else:
        frame = {f"{prefix}{a}": rng.standard_normal(n) for prefix in ("w", "al", "ap") for a in "xyz"}
        frame |= dict(zip(("qx", "qy", "qz", "qw"), Rotation.random(n, rng=rng).as_quat().T, strict=True))
        signals = frame
    emitted = linear_regressor_map(tool)
    assert emitted is not None
    rows = emitted(signals, n)
    truth = 1 + rng.random(len(rows) - 1)
    wrench = (np.tensordot(truth, rows[:-1], 1) + rows[-1]).T + rng.standard_normal((n, len(tool.channels)))
    table = pd.DataFrame({"time": 0.01 * np.arange(n), **frame, **dict(zip(tool.channels, wrench.T, strict=True))})
    path = folder / f"long{suffix}"
    table.to_csv(path, index=False) if suffix == ".csv" else table.to_parquet(path, index=False)
    return path, Chunk(run="long", signals=signals, wrench=wrench)


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_log_is_fitted_from_disk(tmp_path: Path, suffix: str, space: Space) -> None:
    """As many passes as are asked for; text holds every digit of a double."""
    path, whole = written(tmp_path, suffix, space)
    model, rig = noise_model(space, 3), Rig(link_lengths=LENGTHS)
    found = [fit(base(space), read_chunks(path, rig=rig, size=size, overlap=3), noise=model) for size in (64, 1000)]
    expected = fit(base(space), whole, noise=model)
    std = np.sqrt(np.diag(expected.covariance))
    for one in found:
        np.testing.assert_allclose(one.theta / std, expected.theta / std, rtol=0, atol=EXACT)
        assert one.information.rows == expected.information.rows


ROWS = 1000
BROKEN: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str | None]] = {
    "no acceleration": (lambda frame: frame.drop(columns="ddq2"), "ddq2 is missing"),
    "no time": (lambda frame: frame.drop(columns="time"), "column time is missing"),
    "two runs": (lambda frame: pd.concat([frame, frame]), "time does not increase at row {after}"),
    "time stands still": (lambda frame: frame.assign(time=frame.time.where(frame.index != 701)), None),
    "text": (lambda frame: frame.assign(fx=["1"] * 700 + ["x"] * 300), "column fx is not"),
    "a row left out": (lambda frame: frame.mask(frame.index.to_series() == 700), "at row {gap}"),
    "not finite": (
        lambda frame: frame.assign(fy=frame.fy.where(frame.index != 700, np.inf)),
        "column fy is inf at row {gap}",
    ),
    "no rows": (lambda frame: frame[:0], "there are no samples"),
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("name", BROKEN)
def test_one_line_for_a_log_that_is_none(tmp_path: Path, name: str, suffix: str) -> None:
    """With the row in the file, a CSV's header counted, whichever chunk it is in."""
    path, _ = written(tmp_path, ".parquet", Space.PLANE)
    frame, model, rig = pd.read_parquet(path), noise_model(Space.PLANE, 0), Rig(link_lengths=LENGTHS)
    spoil, message = BROKEN[name]
    wrong = spoil(frame)
    if message is None:
        wrong, message = wrong.assign(time=wrong.time.ffill()), "time does not increase at row {gap_after}"
    header = 1 if suffix == ".csv" else 0
    rows = {"after": ROWS + 1 + header, "gap": 701 + header, "gap_after": 702 + header}
    path = tmp_path / f"wrong{suffix}"
    wrong.to_csv(path, index=False) if suffix == ".csv" else wrong.to_parquet(path, index=False)
    for size in (100, 5000):
        with pytest.raises(InputError, match=message.format(**rows)) as raised:
            fit(base(Space.PLANE), read_chunks(path, rig=rig, size=size), noise=model)
        assert "\n" not in str(raised.value)


CSV = {
    "too long": ("1,2,3\n1,2,3,4\n", "row 3 has 4 values"),
    "too short": ("1,2,3\n1,2\n", "row 3 has 2 values"),
    "empty cell": ("1,2,3\n2,,3\n", "column fx is empty at row 3"),
    "no number": ("1,2,3\n2,3,1_0\n", "column phi is not a number at row 3: '1_0'"),
}


@pytest.mark.parametrize("name", CSV)
def test_the_cell_of_a_csv_is_named(tmp_path: Path, name: str) -> None:
    body, message = CSV[name]
    path = tmp_path / "log.csv"
    path.write_text("time, fx,phi\n" + body)
    with pytest.raises(InputError, match=message):
        list(table_file(path).stretches(1, ["time", "fx", "phi"]))


def test_files_that_are_none(tmp_path: Path) -> None:
    model, path = noise_model(Space.PLANE, 0), tmp_path / "log.csv"
    for content, message in (
        (b"", "is empty"),
        (b"\xff\xfe", "not UTF-8"),
        (b"phi\0", "binary"),
        (b"PAR1junk", "cannot be read"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            fit(base(Space.PLANE), read_chunks(path), noise=model)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        fit(base(Space.PLANE), read_chunks(tmp_path / "none.csv"), noise=model)
    with pytest.raises(InputError, match="not below the overlap"):
        read_chunks(path, size=3, overlap=4)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_only_what_the_model_takes_is_read(tmp_path: Path, suffix: str) -> None:
    """A column of text is no harm where nobody asks for it, and is an error where somebody does; whole numbers,
    single precision and row groups of any length are columns like others."""
    rng, n = np.random.default_rng(3), 500
    frame = pd.DataFrame(
        {name: rng.standard_normal(n) for name in ("phi", "dphi", "ddphi", "ax", "ay", "fx", "fy", "tau")}
    )
    frame = frame.assign(time=np.arange(n), ay=(rng.integers(-8, 8, n) / 8).astype(np.float32))
    model, path = noise_model(Space.PLANE, 2), tmp_path / f"log{suffix}"
    text = frame.assign(note="fine")
    text.to_csv(path, index=False) if suffix == ".csv" else text.to_parquet(path, row_group_size=77)
    log = read_chunks(path, size=100, overlap=2)
    found, expected = fit(base(Space.PLANE), log, noise=model), fit(base(Space.PLANE), whole(frame), noise=model)
    std = np.sqrt(np.diag(expected.covariance))
    np.testing.assert_allclose(found.theta / std, expected.theta / std, rtol=0, atol=EXACT)
    assert [len(c.wrench) - c.history for c in log.with_signals(["phi"])] == [100] * 5
    assert set(next(iter(log.with_signals(["phi"]))).signals) == {"time", "phi", "dphi", "ddphi", "ax", "ay"}
    with pytest.raises(InputError, match="column note is not"):
        list(log)


def whole(frame: pd.DataFrame) -> Chunk:
    columns = {str(name): frame[name].to_numpy(dtype=float) for name in frame.columns}
    wrench = np.stack([columns.pop(channel) for channel in ("fx", "fy", "tau")], axis=1)
    return Chunk(run="log", signals=columns, wrench=wrench)


FITTED = """
import sys
import truewrench as tw
from benchmarks.measure import peak_resident
found = tw.fit(tw.planar(), tw.read_chunks(sys.argv[1], size=16384), noise=tw.NoiseModel.white([1.0, 1.0, 1.0]))
assert found.information.rows == 3 * int(sys.argv[2]), found.information.rows
heavy = {"casadi", "cvxpy", "matplotlib", "scipy.stats", "scipy.signal", "scipy.optimize", "sympy"} & set(sys.modules)
print(peak_resident(), sorted(heavy | ({"pandas"} & set(sys.modules) if sys.argv[1].endswith("parquet") else set())))
"""


@pytest.mark.long
@pytest.mark.parametrize(("suffix", "samples"), [(".parquet", 250_000), (".csv", 160_000)])
def test_memory_does_not_grow_with_the_log(tmp_path: Path, suffix: str, samples: int) -> None:
    """Peak resident memory of a process that fits four times as many rows, in one row group: a quarter of what the
    longer log has more in its columns is what allocators may differ by: of a CSV they settle some 4 MB higher after
    300,000 rows, whatever their number. A stream of Parquet needs no pandas, and of a
    model that was derived before, by the process before these, no SymPy."""
    peaks, environment = [], os.environ | {"TRUEWRENCH_CACHE": str(tmp_path / "cache")}
    for count in (100, samples, 4 * samples):
        path = tmp_path / f"log{count}{suffix}"
        rng = np.random.default_rng(0)
        names = ("phi", "dphi", "ddphi", "ax", "ay", "fx", "fy", "tau")
        frame = pd.DataFrame({name: rng.standard_normal(count) for name in names}).assign(time=np.arange(count))
        table = pa.Table.from_pandas(frame, preserve_index=False)
        write_csv(table, path) if suffix == ".csv" else write_table(table, path, row_group_size=count)
        del frame, table
        command = [sys.executable, "-c", FITTED, str(path), str(count)]
        found = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        peak, heavy = found.stdout.split(maxsplit=1)
        assert heavy.strip() == ("['casadi', 'sympy']" if count == 100 else "['casadi']")
        peaks.append(float(peak))
    assert peaks[2] - peaks[1] < 0.25 * 3 * samples * 9 * 8 / 2**20
