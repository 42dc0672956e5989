"""A survey's page: whole, self-contained, escaped, its data those of the rows; and the changes that it names."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from dataclasses import replace
from datetime import datetime, timedelta
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from truewrench.surveying.survey_html import (
    ChangeKind,
    QuantitySeries,
    page_data,
    quantity_series,
    rows_in_time_order,
    series_to_draw,
    significant_change,
    significant_changes,
    survey_page,
    table_line,
)
from truewrench.surveying.survey_task import (
    ChannelError,
    DiagnosisOutcome,
    RecordingTime,
    StoredEstimate,
    SurveyRow,
    TimeSource,
    parquet_table,
    time_in,
)

HOSTILE = "</script><script>alert(1)</script>\"'><img src=x onerror=alert(2)>\u2028&amp;.csv"
START = datetime(2026, 1, 5, 8)
STD = 0.01


def row(number: int, *, c: float, mass: float = 1.6, verdict: str = "explained", file: str | None = None) -> SurveyRow:
    """A recording of one day, with a drag of c."""
    name = f"run_{START + timedelta(days=number):%Y%m%d-%H%M%S}.csv" if file is None else file
    channel = ChannelError(
        channel="fx",
        unit="N",
        noise_floor=0.1,
        rms_before=0.4,
        rms_after=0.11,
        systematic_before=0.3,
        systematic_after=0.004,
    )
    outcome = DiagnosisOutcome(
        verdict=verdict,
        added=("viscous_drag",),
        sizes=(StoredEstimate("viscous_drag", "c", c, STD, "N s/m"),),
        parameters=(StoredEstimate("", "m", mass, 0.002, "kg"),),
        misfit_before=20.0,
        misfit=1.0,
        channels=(channel,),
        seconds=7.0,
    )
    return SurveyRow(name, RecordingTime(START + timedelta(days=number), TimeSource.FILE_NAME), outcome)


def survey_rows(count: int = 20) -> list[SurveyRow]:
    """A drag that grows, a payload that changes after the tenth, a broken recording, one that is not there."""
    rng = np.random.default_rng(0)
    grown = 0.5 + 0.01 * np.arange(count) + STD * rng.standard_normal(count)
    mass = np.where(np.arange(count) < 10, 1.6, 1.84) + 0.002 * rng.standard_normal(count)
    rows = [row(n, c=float(grown[n]), mass=float(mass[n])) for n in range(count)]
    broken = RecordingTime(START, TimeSource.MODIFICATION)
    return [
        *rows,
        SurveyRow(HOSTILE, broken, DiagnosisOutcome(error=f"column {HOSTILE} is nan; remove it")),
        SurveyRow("missing.csv", None, DiagnosisOutcome(error="No such file", final=False)),
    ]


class Page(HTMLParser):
    """Tags, references, the text of cells, and what scripts hold."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.references: list[str] = []
        self.handlers: list[str] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.cells: list[str] = []
        self.policy = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "action")]
        self.handlers += [k for k, _ in attrs if k.startswith("on")]
        if tag == "script":
            self.scripts.append((dict(attrs), ""))
        if tag == "td":
            self.cells.append("")
        if dict(attrs).get("http-equiv") == "Content-Security-Policy":
            self.policy = dict(attrs)["content"] or ""

    def handle_data(self, data: str) -> None:
        if self.tags[-1:] == ["script"] and self.scripts:
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)
        elif self.cells:
            self.cells[-1] += data

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self.tags.append("/script")


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(survey_page(survey_rows()))


def test_data_of_the_page_are_those_of_the_rows(page: Page) -> None:
    (held,) = [json.loads(text) for attributes, text in page.scripts if attributes.get("type") == "application/json"]
    rows = survey_rows()
    assert held == page_data(rows)
    assert held["rows"] == [r.to_data() for r in rows]
    assert held["keys"]["file"][20] == HOSTILE
    assert held["keys"]["recorded"][21] is None


def test_hostile_file_name_stays_text(page: Page) -> None:
    assert page.tags.count("script") == 2  # the data and the sorting
    assert page.handlers == []
    assert HOSTILE in [cell.strip("\n") for cell in page.cells]
    assert page.tags.count("img") == 1  # the picture


def test_page_fetches_nothing_and_runs_its_own_script_alone(page: Page) -> None:
    assert all(reference.startswith("data:image/svg+xml,") for reference in page.references)
    ((attributes, script),) = [s for s in page.scripts if "type" not in s[0]]
    assert attributes == {}
    own = b64encode(sha256(script.encode()).digest()).decode()
    assert "default-src 'none'" in page.policy
    assert re.findall(r"script-src ([^;]*)", page.policy) == [f"'sha256-{own}'"]


def test_every_column_that_sorts_has_its_keys() -> None:
    rows = survey_rows()
    html = survey_page(rows)
    columns = re.findall(r'<th data-column="(\w+)"', html)
    keys = page_data(rows)["keys"]
    assert sorted(columns) == sorted(keys)
    assert {len(values) for values in keys.values()} == {len(rows)}
    assert re.findall(r'<tr data-row="(\d+)"', html) == [str(n) for n in range(len(rows))]


def test_page_says_what_changed_and_where_times_are_from(page: Page) -> None:
    html = survey_page(survey_rows())
    assert "viscous_drag.c increases from" in html
    assert "m steps up from 1.60 to 1.84 kg between 2026-01-14 08:00 and 2026-01-15 08:00" in html
    assert "20 from the file name" in html
    assert "1 from the modification time of the file" in html
    assert "1 unknown, no file" in html


def test_page_of_one_recording_and_of_none() -> None:
    for rows in ([], [row(0, c=0.5)]):
        assert Page(survey_page(rows)).tags.count("img") == 0
        assert parquet_table(rows).num_rows == len(rows)


def test_line_of_a_row() -> None:
    line = table_line(row(0, c=0.512))
    assert [(q.name, q.value, q.unit) for q in line.sizes] == [("viscous_drag.c", "0.512 ± 0.010", "N·s/m")]
    assert (line.misfit, line.fall, line.label) == ("20.0 → 1.00", "fx: 0.300 → 0.00400 N", "Explained")


def test_effect_of_many_sizes_shows_those_that_stand_out() -> None:
    sizes = tuple(StoredEstimate("sensor_crosstalk", f"c{n}", 0.01 * n, 0.01, "1") for n in range(9))
    one = row(0, c=0.5)
    line = table_line(replace(one, outcome=replace(one.outcome, added=("sensor_crosstalk", "x"), sizes=sizes)))
    assert [q.name for q in line.sizes] == ["x", *(f"sensor_crosstalk.c{n}" for n in (8, 7, 6, 5, 4))]
    assert [q.name for q in line.more_sizes] == [f"sensor_crosstalk.c{n}" for n in (3, 2, 1, 0)]


# ------------------------------------------------------------------------------------------- changes


def series(value: NDArray[np.float64], std: float = STD) -> QuantitySeries:
    count = len(value)
    return QuantitySeries(
        name="viscous_drag.c",
        unit="N s/m",
        effect="viscous_drag",
        moments=tuple(START + timedelta(days=n) for n in range(count)),
        value=value,
        std=np.full(count, std),
        trusted=np.ones(count, dtype=bool),
    )


def noise(seed: int, count: int = 20) -> NDArray[np.float64]:
    return STD * np.random.default_rng(seed).standard_normal(count)


def test_trend_and_step_are_told_apart() -> None:
    days = np.arange(20.0)
    trend = significant_change(series(0.5 + 0.01 * days + noise(1)))
    step = significant_change(series(np.where(days < 12, 0.5, 0.6) + noise(2)))
    assert trend is not None
    assert step is not None
    assert (trend.kind, step.kind) == (ChangeKind.TREND, ChangeKind.STEP)
    # Ends of a line through 20 values are off by STD sqrt(4/20), means of 8 by STD sqrt(1/8): four of these.
    assert [trend.before, trend.after] == pytest.approx([0.5, 0.69], abs=4 * STD * np.sqrt(4 / 20))
    assert [step.before, step.after] == pytest.approx([0.5, 0.6], abs=4 * STD * np.sqrt(1 / 8))
    assert (step.start, step.end) == (START + timedelta(days=11), START + timedelta(days=12))


@pytest.mark.parametrize("excess", [1.0, 5.0])
def test_scatter_is_no_change(excess: float) -> None:
    # At 1 % each, more than 8 of 300 have a chance below 0.4 % even if the test were exact; excess: stds too short.
    found = sum(significant_change(series(0.5 + excess * noise(seed))) is not None for seed in range(300))
    assert found <= 8


def test_a_recording_given_twice_is_measured_once() -> None:
    """As by two patterns that name it both, or as a later copy that took another time."""
    once = [row(n, c=0.5 + 0.01 * n) for n in range(6)]
    copies = [replace(row(30 - n, c=0.5 + 0.01 * n), file=f"copy_{n}.csv") for n in (0, 2, 3)]
    copies = [replace(r, outcome=replace(r.outcome, seconds=9.0)) for r in copies]
    for first, second in zip(quantity_series(once), quantity_series([*once, *once, *copies]), strict=True):
        assert first.moments == second.moments
        np.testing.assert_array_equal(first.value, second.value)


def test_change_takes_trusted_recordings_with_a_std() -> None:
    rows = [row(n, c=0.5 + 0.02 * n, verdict="unexplained") for n in range(20)]
    assert significant_changes(rows) == []
    assert len(quantity_series(rows)) == 2
    assert significant_change(series(np.arange(20.0), std=np.inf)) is None


def test_changes_and_the_payload_are_drawn_before_what_stays() -> None:
    sizes = tuple(StoredEstimate("cable_spring", name, 1.0, STD, "1") for name in ("k", "length"))
    rows = [row(n, c=0.5 + 1e-6 * n) for n in range(6)]
    rows = [replace(r, outcome=replace(r.outcome, sizes=(*sizes, *r.outcome.sizes))) for r in rows]
    drawn = [s.name for s in series_to_draw(quantity_series(rows), ["cable_spring.length"])]
    assert drawn == ["cable_spring.length", "m", "cable_spring.k", "viscous_drag.c"]


def test_times_of_one_source_are_compared() -> None:
    late = RecordingTime(START + timedelta(days=400), TimeSource.MODIFICATION)
    rows = [row(1, c=0.5), row(0, c=0.5), SurveyRow("copied.csv", late, DiagnosisOutcome(verdict="explained"))]
    assert rows_in_time_order(rows) == [rows[1], rows[0]]


# --------------------------------------------------------------------------------------------- times


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("run_2026-03-01T10-20-30.csv", datetime(2026, 3, 1, 10, 20, 30)),
        ("2026-03-01 10:20:30.250 tool.csv", datetime(2026, 3, 1, 10, 20, 30, 250000)),
        ("cell3_20260301_102030.parquet", datetime(2026, 3, 1, 10, 20, 30)),
        ("20260301T1020.csv", datetime(2026, 3, 1, 10, 20)),
        ("log-2026.03.01.csv", datetime(2026, 3, 1)),
        ("v12_99999999_2026-03-01.csv", datetime(2026, 3, 1)),
        ("run_20260301_0061.csv", datetime(2026, 3, 1)),
        ("20260301_2500.csv", datetime(2026, 3, 1)),
        ("20260301_1020-3000.csv", datetime(2026, 3, 1, 10, 20)),
        ("serial_20261399.csv", None),
        ("1202603011.csv", None),
        ("run7.csv", None),
    ],
)
def test_time_in_a_name(name: str, moment: datetime | None) -> None:
    assert time_in(name) == moment


def test_time_with_a_zone_is_the_same_moment() -> None:
    first, second = time_in("2026-03-01T10-20-30Z.csv"), time_in("2026-03-01T12-20-30+0200.csv")
    assert first is not None
    assert first == second


def test_time_of_a_file_without_one_in_its_name(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    assert RecordingTime.of(path) is None
    path.write_text("")
    found: Any = RecordingTime.of(path)
    assert found.source is TimeSource.MODIFICATION
    assert found.moment.timestamp() == pytest.approx(path.stat().st_mtime, abs=1e-5)  # datetime holds microseconds
