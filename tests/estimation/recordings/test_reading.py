"""Files: CSV and Parquet alike, and one line with file, row and column for each way to be wrong."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from estimation.recordings.reading import from_columns, read
from modeling.errors import InputError
from modeling.rig import Rig

ARM = Rig.from_data(
    {
        "robot": {"link_lengths": [1.0, 0.5]},
        "limits": {"position": [1.0, 1.0], "velocity": [2.0, 2.0], "acceleration": [9.0, 9.0]},
    }
)
Frame = pd.DataFrame
Spoil = Callable[[Frame], Frame]


def planar(samples: int = 100) -> Frame:
    t = np.arange(samples) * 0.01
    rng = np.random.default_rng(0)
    wrench = {channel: rng.standard_normal(samples) for channel in ("fx", "fy", "tau")}
    motion = {"q1": 0.3 * np.sin(2 * np.pi * t), "q2": 0.1 * np.cos(2 * np.pi * t)}
    return Frame({"time": t, "repeat": np.arange(samples) // (samples // 2)} | motion | wrench)


def spatial() -> Frame:
    frame = planar().drop(columns=["q1", "q2", "tau", "repeat"])
    return frame.assign(fz=0.0, tx=0.0, ty=0.0, tz=0.0, qx=0.0, qy=0.0, qz=0.0, qw=1.0)


def put(name: str, row: int, value: object) -> Spoil:
    """Spoil one cell, given by its row in the file."""

    def spoil(frame: Frame) -> Frame:
        column = frame[name].tolist()
        column[row - 2] = value
        return frame.assign(**{name: np.array(column, dtype=object)})

    return spoil


def lose(rows: range) -> Spoil:
    return lambda frame: frame.drop(index=list(rows)).drop(columns="repeat")


def drop(*names: str) -> Spoil:
    return lambda frame: frame.drop(columns=list(names))


@pytest.mark.parametrize("frame", [planar(), spatial()])
def test_csv_and_parquet_are_alike(tmp_path: Path, frame: Frame) -> None:
    frame = frame.assign(temperature=21.5)[[*frame.columns[::-1], "temperature"]]
    frame.to_csv(tmp_path / "run.csv", index=False)
    frame.to_parquet(tmp_path / "run.parquet")
    text, binary = (read(tmp_path / f"run.{kind}", rig=ARM) for kind in ("csv", "parquet"))
    np.testing.assert_allclose(text.wrench, binary.wrench, rtol=1e-15)
    assert text.channels == binary.channels
    assert list(text.signals) == list(binary.signals)
    for name, series in text.signals.items():
        np.testing.assert_allclose(series, binary.signals[name], rtol=1e-9, atol=1e-9)
    assert "temperature" in text.auxiliary


def test_columns_stay_the_callers() -> None:
    columns = {name: planar()[name].to_numpy(copy=True) for name in planar().columns}
    recording = from_columns(columns, rig=ARM)
    columns["fx"][0] = 1e6
    assert recording.wrench[0, 0] != 1e6
    assert not recording.wrench.flags.writeable


WRONG: dict[str, tuple[Callable[[], Frame], Spoil, list[str]]] = {
    "no wrench": (planar, drop("fx", "fy", "tau"), ["wrench", "fx, fy, tau"]),
    "half a wrench": (planar, drop("tau"), ["missing tau"]),
    "half of six": (spatial, drop("tz", "fz"), ["missing fz, tz"]),
    "mixed wrench": (spatial, lambda f: f.assign(tau=0.0), ["mixed", "tau", "fz"]),
    "no motion": (planar, drop("q1", "q2"), ["q1..qn", "phi"]),
    "joint missing": (planar, drop("q2"), ["missing q2"]),
    "joint too many": (planar, lambda f: f.assign(q3=0.0), ["q3", "2 link_lengths"]),
    "half a quaternion": (spatial, drop("qw"), ["missing qw"]),
    "half an acceleration": (planar, lambda f: f.drop(columns=["q1", "q2"]).assign(phi=0.0, ax=0.0), ["ay"]),
    "text": (planar, put("fy", 17, "abc"), ["fy", "row 17", "abc"]),
    "code": (planar, put("fy", 17, "__import__('os')"), ["fy", "row 17", "not a number"]),
    "nan": (planar, put("tau", 31, "nan"), ["tau", "row 31", "nan"]),
    "huge": (planar, put("fx", 9, 1e300), ["fx", "row 9", "1e+300", "below 1e+20"]),
    "huge time": (planar, put("time", 100, 1e300), ["time", "row 100", "1e+300"]),
    "huge auxiliary": (planar, lambda f: f.assign(temperature=-1e300), ["temperature", "row 2", "-1e+300"]),
    "infinite": (planar, put("q1", 9, "-inf"), ["q1", "row 9", "-inf"]),
    "empty cell": (planar, put("q2", 12, ""), ["q2", "row 12"]),
    "auxiliary text": (planar, lambda f: f.assign(note="x"), ["note", "row 2"]),
    "time stands": (planar, put("time", 40, 0.37), ["time", "row 40"]),
    "time goes back": (planar, put("time", 30, 0.05), ["time", "row 30"]),
    "a gap in time": (planar, lose(range(20, 25)), ["row 22", "5 samples"]),
    "unequal repeats": (planar, lambda f: f.iloc[:-7], ["repeat 1", "row 52", "43", "50"]),
    "scattered repeats": (planar, lambda f: f.assign(repeat=f.index // 25 % 2), ["repeat 0", "row 52"]),
    "broken repeat": (planar, put("repeat", 5, 0.5), ["repeat", "row 5"]),
    "few samples": (planar, lambda f: f.drop(columns="repeat").iloc[:5], ["5", "at least 20"]),
    "few poses": (planar, lambda f: f.drop(columns=["repeat", "time"]).iloc[:2], ["2", "at least 3"]),
    "few in a repeat": (planar, lambda f: f.assign(repeat=np.arange(100) // 10), ["10", "each repeat"]),
    "no rows": (planar, lambda f: f.iloc[:0], ["no samples"]),
    "degrees": (planar, lambda f: f.assign(q1=f.q1 * 57.3), ["q1", "row 4", "degrees?"]),
    "no unit quaternion": (spatial, put("qx", 8, 0.4), ["qx", "row 8", "norm"]),
}  # fmt: skip


def message(path: Path, rig: Rig | None = ARM) -> str:
    with pytest.raises(InputError) as caught:
        read(path, rig=rig)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def test_stamps_in_nanoseconds_may_be_beside_the_time(tmp_path: Path) -> None:
    """Those since 1970 are the largest numbers that a log has, in CSV and in Parquet."""
    frame = planar().assign(stamp=1_760_000_000_000_000_000 + np.arange(100) * 10_000_000)
    for path in (tmp_path / "run.csv", tmp_path / "run.parquet"):
        frame.to_csv(path, index=False) if path.suffix == ".csv" else frame.to_parquet(path)
        assert read(path, rig=ARM).columns["stamp"][-1] == frame["stamp"].iloc[-1]


@pytest.mark.parametrize("case", ["huge", "huge time", "huge auxiliary"])
def test_huge_numbers_of_parquet_are_one_line(tmp_path: Path, case: str) -> None:
    frame, spoil, parts = WRONG[case]
    spoil(frame()).to_parquet(tmp_path / "run.parquet")
    text = message(tmp_path / "run.parquet")
    assert parts[0] in text
    assert parts[2] in text


@pytest.mark.parametrize("case", WRONG)
def test_wrong_table_is_one_line(tmp_path: Path, case: str) -> None:
    frame, spoil, parts = WRONG[case]
    spoil(frame()).to_csv(tmp_path / "run.csv", index=False)
    text = message(tmp_path / "run.csv")
    for part in parts:
        assert part in text


@pytest.mark.parametrize(("rig", "part"), [(None, "no rig"), (Rig(), "no link_lengths")])
def test_joint_angles_need_kinematics(tmp_path: Path, rig: Rig | None, part: str) -> None:
    planar().to_csv(tmp_path / "run.csv", index=False)
    assert part in message(tmp_path / "run.csv", rig)
    planar().assign(phi=0.1).to_csv(tmp_path / "pose.csv", index=False)
    assert read(tmp_path / "pose.csv", rig=rig).auxiliary == ("q1", "q2")


HEADER = "phi,fx,fy,tau\n"
ROWS = "0,1,2,3\n0.1,1,2,3\n0.2,1,2,3\n0.3,1,2,3\n"
RAW: dict[str, tuple[bytes, list[str]]] = {
    "empty": (b"", ["empty"]),
    "blank": (b"\n\n", ["empty"]),
    "binary": (b"\x93NUMPY\x01\x00v\x00{'descr'", ["binary"]),
    "pickle": (b"\x80\x04\x95\x10\xff.", ["UTF-8"]),
    "spoiled parquet": (b"PAR1\x00\x01\x02PAR1", ["Parquet"]),
    "short row": ((HEADER + ROWS + "1,2,3\n" + ROWS).encode(), ["row 6", "3 values", "4 columns"]),
    "long row": ((HEADER + ROWS + "1,2,3,4,5\n").encode(), ["row 6", "5 values"]),
    "all rows long": ((HEADER + ROWS.replace("\n", ",9\n")).encode(), ["row 2", "5 values"]),
    "blank row": ((HEADER + ROWS + "\n" + ROWS).encode(), ["row 6"]),
    "twice": ((HEADER.replace("fy", "fx") + ROWS).encode(), ["fx", "duplicated"]),
    "nameless": ((HEADER.replace("fy", "") + ROWS).encode(), ["column 3"]),
    "no header": (ROWS.encode(), ["row 1", "header"]),
    "semicolons": ((HEADER + ROWS).replace(",", ";").encode(), ["commas"]),
    "open quote": ((HEADER + ROWS + '"1,2,3,4\n').encode(), ["row"]),
    "short row, old line ends": (
        (HEADER + ROWS + "1,2,3\n" + ROWS).replace("\n", "\r").encode(),
        ["row 6", "3 values"],
    ),
    "spaces": ((HEADER + ROWS).replace(",", " ").encode(), ["commas", "truewrench import"]),
    "names of a log": (
        (HEADER.replace("phi,fx,fy,tau", "t,Fx,Fy,state") + ROWS).encode(),
        ["(t, Fx, Fy, ..)", "import"],
    ),
    "long name": (
        (HEADER.replace("phi", "phi,state" + "x" * 600) + "0,a,1,2,3\n").encode(),
        [f"column state{'x' * 35}... is not a number at row 2"],
    ),
    "endless name": ((HEADER.replace("tau", "t" * 131073) + ROWS).encode(), ["row 1 cannot be read"]),
    "open quote in the header": (('"' + HEADER + ROWS * 5000).encode(), ["row 1 cannot be read"]),
}


@pytest.mark.parametrize("case", RAW)
def test_wrong_file_is_one_line(tmp_path: Path, case: str) -> None:
    content, parts = RAW[case]
    (tmp_path / "run.csv").write_bytes(content)
    text = message(tmp_path / "run.csv")
    for part in parts:
        assert part in text


def test_file_that_is_not_there(tmp_path: Path) -> None:
    assert "No such file" in message(tmp_path / "nowhere.csv")
    assert "irectory" in message(tmp_path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there is no /dev/zero here")
def test_a_device_without_end_is_not_read() -> None:
    assert "a device, no recording" in message(Path("/dev/zero"))


@pytest.mark.parametrize(
    ("column", "parts"),
    [(["x"] * 100, ["extra", "not numeric"]), ([1.0] * 41 + [None] + [1.0] * 58, ["extra", "row 42"])],
)
def test_wrong_parquet_is_one_line(tmp_path: Path, column: list[object], parts: list[str]) -> None:
    planar().assign(extra=np.array(column, dtype=object)).to_parquet(tmp_path / "run.parquet")
    text = message(tmp_path / "run.parquet")
    for part in parts:
        assert part in text


def test_harmless_habits_of_programs(tmp_path: Path) -> None:
    text = "\ufeff" + HEADER.replace(",", ", ") + ROWS + "\n\n"
    (tmp_path / "run.csv").write_bytes(text.replace("\n", "\r\n").encode())
    assert read(tmp_path / "run.csv").samples == 4


def test_line_ends_of_every_system_are_alike(tmp_path: Path) -> None:
    wrenches = []
    for end in ("\n", "\r\n", "\r"):
        (tmp_path / "run.csv").write_bytes((HEADER + ROWS).replace("\n", end).encode())
        wrenches.append(read(tmp_path / "run.csv").wrench)
    np.testing.assert_array_equal(wrenches[1:], [wrenches[0]] * 2)
    assert wrenches[0].shape == (4, 3)


def test_digits_become_the_nearest_number(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    numbers = rng.uniform(-10, 10, (50, 4)) * 10.0 ** rng.integers(-30, 19, (50, 4))
    cells = [[np.format_float_scientific(x, precision=int(d)) for x, d in zip(row, (3, 9, 17, 25), strict=True)]
             for row in numbers]  # fmt: skip
    (tmp_path / "run.csv").write_text(HEADER + "".join(",".join(row) + "\n" for row in cells))
    run = read(tmp_path / "run.csv")
    found = np.column_stack([run.columns["phi"], run.wrench])
    np.testing.assert_array_equal(found, [[float(cell) for cell in row] for row in cells])


def test_quoted_numbers_are_read_like_plain_ones(tmp_path: Path) -> None:
    for name, content in (("plain", ROWS), ("quoted", ROWS.replace("0.1", '"0.1"'))):
        (tmp_path / f"{name}.csv").write_text(HEADER + content)
    plain, quoted = (read(tmp_path / f"{name}.csv") for name in ("plain", "quoted"))
    np.testing.assert_array_equal(plain.columns["phi"], quoted.columns["phi"])
    np.testing.assert_array_equal(plain.wrench, quoted.wrench)


@pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
def test_a_file_of_plain_numbers_is_read_without_pandas(tmp_path: Path, name: str) -> None:
    if name.endswith("csv"):
        planar().to_csv(tmp_path / name, index=False)
    else:
        planar().to_parquet(tmp_path / name)
    code = (
        "import sys\nfrom estimation.recordings.reading import read\nfrom modeling.rig import Rig\n"
        "rig = Rig.from_data({'robot': {'link_lengths': [1.0, 0.5]}})\n"
        f"print(read({str(tmp_path / name)!r}, rig=rig).samples, 'pandas' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert done.stdout == "100 False\n"
