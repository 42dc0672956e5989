"""The picture of a reading: what it shows is true, it stands for every kind of log, and nothing is cut off."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from matplotlib.axis import Tick
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.spatial.transform import Rotation

import truewrench as tw
from estimation.reading.log_import import ImportedRecording
from estimation.reading.log_reading import imported
from estimation.reading.recording_check import note_suspicious_channels
from estimation.reading.repeat_cutting import cut_into_repeats
from estimation.reading.sample_mending import STAMP
from estimation.reading.step_log import StepLog
from estimation.recordings.reading_report import MOST_SPANS, IntervalHistogram, ReadingReport, merged, spans
from modeling.rig import Rig
from tests.shared.log_files import QUATERNION, original, two_clocks
from truewrench.command_line import main
from truewrench.simulated_rig import PlanarRig, simulate

pytest.importorskip("mujoco")

STEP, PERIOD = 0.004, 5.0


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def spoiled() -> pd.DataFrame:
    """Three samples lost, one doubled, two swapped, a channel that clips, a gap before the last 200 of 2500 rows."""
    frame = original().rename(columns={"time": "stamp"})
    frame["fz"] = np.minimum(frame["fz"], np.quantile(frame["fz"], 0.95))
    order = np.insert(np.delete(np.arange(2500), [*range(2100, 2300), 500, 501, 1200]), 900, 901)
    order[[1500, 1501]] = order[[1501, 1500]]
    return frame.iloc[order]


@cache
def reading(case: str) -> ImportedRecording:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        if case == "two clocks":
            return imported(*two_clocks(original(), Path(folder)))
        if case == "spoiled":
            spoiled().to_csv(path, index=False)
            return imported(path)
        if case == "poses":
            original().iloc[::100].drop(columns=["time"]).to_csv(path, index=False)
            return imported(path)
        arm = PlanarRig()
        simulate(arm, arm.random_motion(seed=1, period=PERIOD), repeats=3, samples_per_period=200, seed=1).drop(
            columns="repeat"
        ).to_csv(path, index=False)
        rig = Rig.from_data({"robot": {"link_lengths": list(arm.link_lengths)}})
        return imported(path, rig=rig, period=PERIOD)


CASES = ("two clocks", "spoiled", "poses", "planar")


def at(report: ReadingReport, words: str) -> np.ndarray:
    (step,) = (step for step in report.steps if words in step.what)
    return np.array(step.at)


# ------------------------------------------------------------------------------------------ what it shows


def test_steps_are_where_they_happened() -> None:
    """Within half a sample of the truth, on the clock of the recording, which begins with the log."""
    report = reading("spoiled").report
    truth = {
        "missing samples": [[500, 501], [1200, 1200]],
        "doubled rows": [[901, 901]],
        "order of time": [[1502, 1502]],
        "gap of up to": [[2300, 2499]],
    }
    for what, rows in truth.items():
        np.testing.assert_allclose(at(report, what), STEP * np.array(rows), atol=1.6 * STEP)
    clipped = original()["fz"].to_numpy()[:2100]
    inside = np.zeros(2100, dtype=bool)
    for start, end in at(report, "fz stays at its extreme value"):
        inside[round(start / STEP) : round(end / STEP) + 1] = True
    limit = np.quantile(original()["fz"], 0.95)
    assert (inside == (clipped >= limit)).mean() > 0.99
    assert report.to_data()["steps"][0].keys() == {"kind", "what", "where", "count", "total"}


def test_a_stop_and_what_is_outside_the_repeats_are_marked() -> None:
    """A channel that is stuck for 0.5 s, and a motion that ran two and a half times, both from 10 s on."""
    stamps, log = np.asarray(10 + 0.01 * np.arange(500), dtype=np.float64), StepLog()
    noise = np.random.default_rng(0).normal(0, 0.01, 500)
    force = np.sin(stamps) + noise
    force[200:250] = force[200]
    note_suspicious_channels({"fx": force}, stamps, "log", log)
    (stop,) = log.steps
    assert stop.channels == ("fx",)
    np.testing.assert_allclose(stop.at, [[12.0, 12.49]])
    columns = {"fx": noise, "phi": np.sin(np.pi * stamps) + np.cos(3 * np.pi * stamps), STAMP: stamps}
    cut = cut_into_repeats(columns, 0.01, 2.0, "log", log)
    assert cut.period is not None
    assert cut.period.repeats == 2
    outside = np.array(next(step.at for step in log.steps if "outside the whole repeats" in step.what))
    kept = cut.columns[STAMP]
    assert not any(((kept >= start) & (kept <= end)).any() for start, end in outside)
    assert np.ptp(outside, axis=1).sum() == pytest.approx(1.0, abs=0.03)


def test_two_clocks_share_one_time_in_the_picture() -> None:
    """The offset's curves: where chi-square is least, and where the motion explains most of the wrench."""
    offset = reading("two clocks").report.offset
    assert offset is not None
    assert offset.curves is not None
    curves = offset.curves
    assert abs(curves.near[np.argmin(curves.chi_square)] - offset.offset) < 1.5 * offset.std
    assert curves.chi_square[[0, -1]].min() > 1.96**2
    assert abs(curves.offsets[np.argmax(curves.share)] - 0.037) <= 0.02  # the scan's step
    before, after = (np.std(curves.measured - explained) for explained in (curves.as_stamped, curves.aligned))
    assert after < 0.5 * before


def test_gravity_is_that_of_the_orientation() -> None:
    curves = reading("spoiled").report.curves
    assert curves is not None
    assert curves.gravity is not None
    rows = original()[QUATERNION].to_numpy()[: reading("spoiled").report.samples]
    truth = Rotation.from_quat(rows).inv().apply([0, 0, -1.0])
    every = -(-len(rows) // len(curves.gravity))
    np.testing.assert_allclose(curves.gravity, truth[::every], atol=0.01)  # of rows that were lost or swapped


def test_repeats_are_cut_where_the_recording_cuts_them() -> None:
    found = reading("planar")
    assert found.report.curves is not None
    starts = np.flatnonzero(np.diff(found.columns["repeat"])) + 1
    np.testing.assert_allclose(found.report.curves.cuts, found.columns["time"][starts], atol=1e-9)
    assert len(starts) == 2


def test_intervals_count_every_pair() -> None:
    histogram = IntervalHistogram.of(np.array([0, 1, 2, 2, 3, 2.5, 4, 20.0, np.nan, 21]))
    assert histogram is not None
    assert (histogram.not_increasing, histogram.longer, histogram.counts.sum()) == (2, 1, 5)
    assert IntervalHistogram.of(np.zeros(5)) is None


def test_spans_are_few_and_hold_all() -> None:
    stamps = np.arange(100_000.0)
    mask = np.random.default_rng(0).random(len(stamps)) < 0.3
    found = spans(stamps, mask)
    assert len(found) <= MOST_SPANS + 1
    starts, ends = np.array(found).T
    place = np.searchsorted(starts, stamps[mask], side="right") - 1
    assert (stamps[mask] <= ends[place]).all()
    assert spans(stamps, np.array([3, 4, 9])) == ((3.0, 4.0), (9.0, 9.0))
    assert merged([]) == ()


def test_its_size_does_not_grow_with_the_log() -> None:
    report = reading("two clocks").report
    assert report.curves is not None
    assert max(len(values) for _, values in report.curves.channels.values()) <= 720
    assert report.curves.gravity is not None
    assert len(report.curves.gravity) <= 600


# ------------------------------------------------------------------------------------------- the picture


@pytest.mark.parametrize("case", CASES)
def test_it_is_labelled_and_nothing_is_cut_off(case: str) -> None:
    found = reading(case)
    figure = tw.plot_reading(found.report)
    figure.draw_without_rendering()
    drawn, page = figure.get_tightbbox(), figure.get_size_inches()
    assert drawn.x0 >= 0
    assert drawn.y0 >= 0
    assert (np.array([drawn.x1, drawn.y1]) <= page).all()
    boxes = {text: text.get_window_extent() for text in _texts(figure)}
    overlaps = [(a.get_text(), b.get_text()) for a, b in combinations(boxes, 2) if boxes[a].overlaps(boxes[b])]
    assert not overlaps
    for axes in figure.axes[1:]:
        assert axes.get_ylabel()
        last_of_column = axes.xaxis.get_tick_params()["labelbottom"]
        assert axes.get_xlabel() or not last_of_column
    said = words(figure)
    assert found.report.size in said
    for channel, unit in {"planar": {"tau": "N·m", "q1": "rad"}}.get(case, {"fx": "N", "tz": "N·m"}).items():
        assert f"{channel} ({unit})" in said
    assert ("95 % interval" in said) == (case == "two clocks")
    assert ("cut into 3 repeats" in said) == (case == "planar")
    assert ("nothing was mended" in said) == (case in ("poses", "planar"))


def _texts(figure: Figure) -> list[Text]:
    """Every text but the ticks' labels."""
    ticks = {text for tick in figure.findobj(Tick) for text in (tick.label1, tick.label2)}
    return [text for text in figure.findobj(Text) if text.get_text().strip() and text not in ticks]


def test_a_recording_is_drawn_by_what_it_was_read_from(tmp_path: Path) -> None:
    path, log = tmp_path / "run.csv", original().iloc[::5].reset_index(drop=True)
    log.to_csv(path, index=False)
    known = tw.read(path)
    assert known.reading is None
    figure = tw.plot_reading(known)
    assert f"{known.name}: {known.samples} samples" in words(figure)
    labels = {label.split()[0] for axes in figure.axes if (label := axes.get_ylabel())}
    assert {*known.channels, *known.columns} - {"temperature"} <= labels
    assert "nothing was mended" in words(figure)
    log.loc[110:, "fx"] = log["fx"][110]
    log.to_csv(path, index=False)
    assert "from row 111 on: stuck?" in words(tw.plot_reading(tw.read(path)))
    with pytest.raises(tw.InputError, match="a str is no recording"):
        tw.plot_reading(str(path))  # type: ignore[arg-type]
    assert "log.csv: 2100 samples" in words(tw.plot_reading(reading("spoiled").recording()))


@pytest.mark.parametrize(
    ("suffix", "start"),
    [
        (".png", b"\x89PNG"),
        pytest.param(".svg", b"<?xml", marks=pytest.mark.long),
        pytest.param(".pdf", b"%PDF", marks=pytest.mark.long),
    ],
)
def test_the_command_draws_it(suffix: str, start: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, picture = tmp_path / "log.csv", tmp_path / f"reading{suffix}"
    original().iloc[::5].to_csv(source, index=False, sep=";")
    assert main(["import", str(source), "--plot", str(picture)]) == 0
    assert capsys.readouterr().out.endswith(f"Written: {picture}\n")
    assert picture.read_bytes().startswith(start)


def test_a_picture_of_another_format_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "log.csv"
    original().iloc[::5].to_csv(source, index=False)
    for name, message in (("a.bmp", "ends in .png, .svg, .pdf"), ("log.csv", "would replace")):
        assert main(["import", str(source), "--plot", str(tmp_path / name), "--out", str(tmp_path / "out.csv")]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
