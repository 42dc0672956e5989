"""Several sources: parts of one recording, or each a whole one; what is used of each."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from estimation.reading.log_import import ImportedRecording, import_recording
from estimation.recordings.reading_report import StepKind
from modeling.errors import InputError
from tests.shared.log_files import CHANNELS, original, plotjuggler, ros_messages, ros_types, two_clocks, write_messages

pytest.importorskip("mujoco")


def said(found: ImportedRecording, kind: StepKind) -> str:
    return "\n".join(map(str, found.report.of(kind)))


@pytest.mark.parametrize(("later", "how"), [(0.0, "only one of them would be used"), (100.0, "do not overlap in time")])
def test_two_whole_recordings_are_refused(later: float, how: str, tmp_path: Path) -> None:
    frame = original().iloc[:300]
    folders = [tmp_path / "monday", tmp_path / "tuesday"]
    for folder in folders:
        folder.mkdir()
    monday, tuesday = (
        plotjuggler(frame.assign(time=frame["time"] + shift), folder)[0]
        for folder, shift in zip(folders, (0.0, later), strict=True)
    )
    with pytest.raises(InputError, match="each hold a whole recording") as raised:
        import_recording([monday, tuesday])
    assert str(monday) in str(raised.value)
    assert str(tuesday) in str(raised.value)
    assert how in str(raised.value)


def test_an_unused_source_is_suspicious(tmp_path: Path) -> None:
    log = tmp_path / "temperature.csv"
    log.write_text("time,temperature\n0,20\n1,21\n2,22\n", encoding="utf-8")
    sources = two_clocks(original(), tmp_path)
    assert "nothing of this source is used" not in said(import_recording(sources), StepKind.SUSPICIOUS)
    assert f"{log}: nothing of this source is used" in said(import_recording([*sources, log]), StepKind.SUSPICIOUS)


def test_unused_sheets_of_a_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.xlsx"
    with pd.ExcelWriter(path) as writer:
        original().iloc[:300].to_excel(writer, sheet_name="run", index=False)
        pd.DataFrame({"time": [0.0, 1.0], "load": [3.0, 4.0]}).to_excel(writer, sheet_name="scales", index=False)
    found = import_recording([path])
    assert f"{path}: not used: scales" in said(found, StepKind.TAKEN)
    assert "not used: run" not in said(found, StepKind.TAKEN)


def bag_of(frame: pd.DataFrame, folder: Path, left_out: str) -> Path:
    """A ROS 2 bag without a topic, and one of another type beside the others."""
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Bag

    store = ros_types()[0]
    text = store.types["std_msgs/msg/String"]
    path = folder / "bag"
    with Bag(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kept = [message for message in ros_messages(store.types, frame) if left_out not in message[0]]
        write_messages(writer, store, [*kept, ("/status", "std_msgs/msg/String", kept[0][2], text(data="on"))])
    return path


def test_a_bag_without_a_wrench_names_its_topics(tmp_path: Path) -> None:
    path = bag_of(original().iloc[:50], tmp_path, "/ft/wrench")
    with pytest.raises(InputError, match="no topic of geometry_msgs/WrenchStamped; its topics are /arm/pose, /status"):
        import_recording([path])


def test_a_bag_without_a_motion_says_what_to_record(tmp_path: Path) -> None:
    """No map of columns would help."""
    path = bag_of(original().iloc[:50], tmp_path, "/arm/pose")
    with pytest.raises(InputError, match=r"its topics are /ft/wrench, /status .*record the pose of tool0") as raised:
        import_recording([path])
    assert "map" not in str(raised.value)


def test_a_log_without_a_motion_says_what_to_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    original()[["time", *CHANNELS]].to_csv(path, index=False)
    with pytest.raises(InputError, match="nothing that tells how the sensor was turned or moved; log its pose"):
        import_recording([path])


def test_a_folder_of_bags_is_answered_with_their_names(tmp_path: Path) -> None:
    path = bag_of(original().iloc[:50], tmp_path, "nothing")
    with pytest.raises(InputError, match=f"a folder without a ROS 2 bag; give the folder of a bag: {path}"):
        import_recording([tmp_path])


def test_a_truncated_bag_is_told_how_to_be_repaired(tmp_path: Path) -> None:
    (file,) = bag_of(original().iloc[:50], tmp_path, "nothing").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"[^.]; repair it \(`mcap recover`") as raised:
        import_recording([file])
    assert ".;" not in str(raised.value)
