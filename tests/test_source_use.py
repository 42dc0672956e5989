"""Several sources: parts of one recording, or each a whole one; what is used of each."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from estimation.logs.log_import import ImportedRecording, import_recording
from estimation.recordings.reports.reading_report import StepKind
from modeling.errors import InputError
from tests.log_files import original, plotjuggler, two_clocks

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
