"""Files of reports: Markdown, provenance, and the reports of fits and comparisons."""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from markupsafe import Markup

from modeling.table import Column, Table
from truewrench.command_line import main
from truewrench.reports.effect_row import EffectCard
from truewrench.reports.page_templates import markdown_table, markdown_text, page_templates
from truewrench.reports.report_files import InputFile, Provenance

TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1).map(str.strip).filter(bool)
MARKDOWN = MarkdownIt("commonmark").enable("table")
MARKUP = st.sampled_from(
    ["<script>alert(1)</script>", "a|b", "`x`", "*b*", "[l](javascript:x)", "# h", "\\", "&lt;", "$x$"]
)


class Seen(HTMLParser):
    """Tags and text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


# ------------------------------------------------------------------------------------------------- Markdown


@given(st.one_of(TEXT, MARKUP))
def test_markdown_shows_text_as_it_is(text: str) -> None:
    """An independent parser of Markdown gives the text back, in one paragraph without any markup."""
    plain = " ".join(text.split())
    page = Seen(MARKDOWN.render(f"x {markdown_text(text)} x"))
    assert page.tags == ["p"]
    assert " ".join(page.text.split()) == f"x {plain} x"


@given(st.lists(st.lists(st.one_of(TEXT, MARKUP), min_size=2, max_size=2), min_size=1, max_size=4))
def test_markdown_tables_have_every_cell(rows: list[list[str]]) -> None:
    page = Seen(MARKDOWN.render(markdown_table(Table.of(("one", "two"), rows))))
    assert page.tags.count("table") == 1
    assert page.tags.count("td") == 2 * len(rows)
    assert set(page.tags) <= {"table", "thead", "tbody", "tr", "th", "td"}


def test_a_table_of_numbers_is_aligned_to_the_right() -> None:
    text = markdown_table(Table.of((Column("a"), Column("b", "N", ".2f")), [("x", 1.0)]))
    assert text.splitlines() == ["| a | b (N) |", "| --- | ---: |", "| x | 1.00 |"]


# ----------------------------------------------------------------------------------------------- provenance


def test_hashes_are_those_of_the_files(tmp_path: Path) -> None:
    single, folder = tmp_path / "a.csv", tmp_path / "bag"
    folder.mkdir()
    for path in (single, folder / "b.db3", folder / "metadata.yaml"):
        path.write_bytes(path.name.encode() * 1000)
    found = Provenance.now("truewrench fit a.csv", [single, folder, tmp_path / "gone"])
    expected = [InputFile(str(p), sha256(p.read_bytes()).hexdigest()) for p in (single, *sorted(folder.iterdir()))]
    assert found.inputs == (*expected, InputFile(str(tmp_path / "gone"), ""))
    assert "SHA-256 of" in str(found.table)


def test_the_date_is_that_of_the_build_where_one_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert Provenance.now().date == "1970-01-01 00:00 UTC"


# ------------------------------------------------------------------------------ reports of fit and compare


RIG_TEXT = '[robot]\nname = "<i>arm</i>"\nlink_lengths = [1.0, 0.97, 0.4]\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig, and two motions of a tool with drag."""
    pytest.importorskip("mujoco")
    from truewrench.simulated_rig import PlanarRig, ViscousDrag, simulate, write_recording

    made, rig = tmp_path_factory.mktemp("reports"), PlanarRig()
    (made / "rig.toml").write_text(RIG_TEXT)
    for seed, name in ((1, "train.csv"), (2, "other <b>.csv")):
        path = rig.random_motion(seed=seed)
        frame = simulate(rig, path, hidden=(ViscousDrag(c=2.0),), repeats=4, samples_per_period=200, seed=seed)
        write_recording(frame, made / name)
    return made


@pytest.mark.long
def test_fit_and_compare_write_their_reports(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("truewrench.reports.report_html.MAX_MAP_VARIABLES", 2)  # all are in test_report.py
    train, other, rig = (str(folder / name) for name in ("train.csv", "other <b>.csv", "rig.toml"))
    models = [str(folder / "rigid.json"), str(folder / "drag.json")]
    fits = ["fit", train, "--rig", rig, "--out"]
    assert main([*fits, models[0]]) == 0
    report = ["--report", str(folder / "fit")]
    assert main([*fits, models[1], "--add", "viscous_drag", "--validate", other, *report]) == 0
    page, text = (_read(folder / "fit" / name) for name in ("report.html", "report.md"))
    assert "The model fits" in page.text
    assert "force for each unit of speed" in page.text
    assert sha256(Path(train).read_bytes()).hexdigest() in page.text
    assert "--add viscous_drag" in page.text  # of the command
    assert "other <b>.csv, held out" in page.text
    assert {"svg", "math"} <= set(page.tags)
    assert "<i>arm" not in (folder / "fit" / "report.html").read_text(encoding="utf-8")
    assert "<i>arm</i>" in page.text
    assert text.tags.count("table") == 4  # parameters, residual, effect, provenance
    capsys.readouterr()
    assert main(["compare", *models, "--on", other, "--report", str(folder / "compared"), "--json"]) == 0
    json.loads(capsys.readouterr().out)
    page, text = (_read(folder / "compared" / name) for name in ("report.html", "report.md"))
    assert "drag.json predicts better than rigid.json" in page.text
    assert "drag.json predicts better than rigid.json" in text.text
    assert {p.name for p in (folder / "compared").iterdir()} == {"report.html", "report.md"}


def _read(path: Path) -> Seen:
    text = path.read_text(encoding="utf-8")
    return Seen(text if path.suffix == ".html" else MARKDOWN.render(text))


def test_a_report_that_cannot_be_written_is_said_before_the_work(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = folder / "taken"
    taken.write_text("")
    for command in (["fit", "gone.csv"], ["diagnose", "gone.csv"], ["compare", "gone.json", "--on", "gone.csv"]):
        assert main([*command, "--report", str(taken)]) == 2
        assert "is not a folder" in capsys.readouterr().err


MATHML = {"math", "mrow", "mi", "mn", "mo", "mtext", "mspace", "msub", "msup"}


@settings(max_examples=30, deadline=None)  # the first one loads the templates
@given(st.one_of(TEXT, MARKUP), st.one_of(TEXT, MARKUP))
def test_text_of_an_effects_file_is_never_markup(title: str, stated: str) -> None:
    """A custom effect's words in its card: shown as they are, no element but MathML more than with plain words."""
    table = Table.of(("parameter", "what it is"), [(title, stated)])
    card = EffectCard("mine", title, stated, stated, Markup(), (), "", table)
    macros: Any = page_templates().get_template("macros.html").module
    page, plain = (Seen(str(macros.effect_card(c))) for c in (card, replace(card, title="x", stated="y")))
    assert [tag for tag in page.tags if tag not in MATHML] == [tag for tag in plain.tags if tag not in MATHML]
    assert page.text.count(title) >= 2
    assert stated in page.text
