"""The table: the same rows as text, HTML, Markdown and data frame, and the facade that names every result."""

from __future__ import annotations

from dataclasses import dataclass
from html.parser import HTMLParser

import numpy as np
import pytest

import truewrench
from diagnosis.comparison.model_comparison import compare
from estimation.bootstrap import bootstrap
from estimation.centre_of_mass import CentreOfMass
from estimation.fit import fit
from estimation.repeat_table import RepeatTable
from estimation.robust_fit import robust_fit
from modeling.chain.model import planar
from modeling.number_format import NOT_IDENTIFIABLE, P_VALUE, digits_of, estimate_text, interval_text, typeset_text
from modeling.space import Space
from modeling.table import Cell, Column, Table, Tabular
from tests.shared.recordings import recorded

COLUMNS = (
    "parameter",
    Column("value", "N", format=".3g"),
    Column("std", format=".2g", unknown=NOT_IDENTIFIABLE),
    Column("p", format=P_VALUE),
)
ROWS = [
    ("m <1>", -1234.5678, 1.25e-7, 0.0),
    ("I|o", None, np.inf, 0.5),
    ("limit", Cell(0.02, "< ", "within", "(3)"), 1, None),
]
TABLE = Table.of(COLUMNS, ROWS)


@dataclass(frozen=True)
class Result(Tabular):
    """A table with a remark."""

    @property
    def table(self) -> Table:
        return TABLE

    def remarks(self) -> list[str]:
        return ["a < b"]


class Cells(HTMLParser):
    """Texts of `<th>` and `<td>`, in order; checks that tags close."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        if tag in ("th", "td"):
            self.texts.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and {"th", "td"} & set(self.open):
            self.texts[-1] += data


def test_text_has_aligned_columns_and_names_what_is_unknown() -> None:
    lines = str(TABLE).splitlines()
    assert len(lines) == 1 + len(ROWS)
    starts = [line.index(entry) for line, entry in zip(lines, ("value [N]", "-1.23e+03", "-", "< 0.02"), strict=True)]
    assert len(set(starts)) == 1
    assert lines[2].split("  ")[-1] == "0.5"
    assert NOT_IDENTIFIABLE in lines[2]
    assert lines[1].endswith("1e-300")  # underflow is not zero
    assert not any(line != line.rstrip() for line in lines)


def test_html_says_the_same_typeset_and_escaped() -> None:
    texts = Cells(TABLE.to_html()).texts
    assert texts[:8] == ["parameter", "value (N)", "std", "p", "m <1>", "−1235", "1.2·10⁻⁷", "< 10⁻³⁰⁰"]
    assert texts[8:] == ["I|o", "–", NOT_IDENTIFIABLE, "0.50", "limit", "< 0.0200(3)", "1.0", "–"]
    assert 'class="number within"' in TABLE.to_html()
    assert TABLE.to_html().count("text-align: left") == 1 + len(ROWS)  # of the one column of text, heading and all
    assert "style" not in TABLE.__html__()  # a page has a style sheet


def test_a_cell_may_have_a_format_of_its_own() -> None:
    table = Table.of(("name", Column("value", format=".6g")), [("a", Cell(1.23456789, format=".2g")), ("b", 1.234567)])
    assert [line.split()[1] for line in str(table).splitlines()[1:]] == ["1.2", "1.23457"]
    assert ">1.2<" in table.to_html()
    assert table.to_frame()["value"][0] == 1.23456789


def test_an_empty_column_is_left_out() -> None:
    table = Table.of(("name", "because", Column("p", format=P_VALUE)), [("a", "", 1e-9), ("b", "", None)])
    assert "because" not in f"{table}{table.to_html()}{table.to_markdown()}"
    assert "because" in table.to_frame()
    assert "because" in str(Table.of(("name", "because"), []))


def test_sentences_are_typeset_as_tables_are() -> None:
    assert typeset_text("7e-05 N m, p 1e-131.") == "7·10⁻⁵ N·m, p 10⁻¹³¹."
    assert typeset_text("c = -0.2 N s²/m², 2026-11-24") == "c = −0.2 N·s²/m², 2026-11-24"
    assert typeset_text("run1e-5.csv, de-12, N may be") == "run1e-5.csv, de-12, N may be"
    assert "a &lt; b" in Result()._repr_html_()
    assert str(Result()).splitlines()[-1] == "a < b"


def test_markdown_has_a_cell_for_each_entry() -> None:
    lines = TABLE.to_markdown().splitlines()
    assert [line.replace("\\|", "").count("|") for line in lines] == [5] * (2 + len(ROWS))


def test_frame_has_numbers() -> None:
    frame = Result().to_frame()
    assert list(frame.columns) == ["parameter", "value [N]", "std", "p"]
    np.testing.assert_array_equal(frame["value [N]"].to_numpy(dtype=float), [-1234.5678, np.nan, 0.02])
    np.testing.assert_array_equal(frame["std"].to_numpy(dtype=float), [1.25e-7, np.inf, 1.0])


def test_columns_of_numbers_are_numeric_whatever_is_missing() -> None:
    columns = (Column("step", format="d"), Column("p", format="p"), Column("p", format=".2g"), "note")
    table = Table.of(columns, [(0, "", Cell(0.5, "< "), ""), (1, None, Cell(None, "fixed"), "x")])
    frame = table.to_frame()
    assert list(frame.columns) == ["step", "p", "p", "note"]
    assert [dtype.kind for dtype in frame.dtypes[:3]] == ["i", "f", "f"]
    np.testing.assert_array_equal(frame.iloc[:, 1:3].to_numpy(), [[np.nan, 0.5], [np.nan, np.nan]])
    assert Table.of(columns[:3], []).to_frame().shape == (0, 3)
    assert "fixed" in str(table)


def test_wide_text_is_wrapped_between_rules() -> None:
    lines = str(Table.of((Column("claim", width=10), "by"), [("one two three four", "x")])).splitlines()
    assert lines == ["claim       by", "----------  --", "one two     x", "  three", "  four", "----------  --"]


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (-0.12345, 0.0012, "kg", "-0.1235 ± 0.0012 kg"),
        (2.0, 0.0, "1", "2, fixed"),
        (2.0, np.inf, "N", "not identifiable from these recordings"),
    ],
)
def test_estimates_as_text(value: float, std: float, unit: str, text: str) -> None:
    assert estimate_text(value, std, unit) == text


def test_an_interval_has_the_digits_of_its_std() -> None:
    assert (digits_of(9.0765, 0.028), digits_of(0.0, 0.1), digits_of(1.0, np.inf), digits_of(1.0, 0.0)) == (
        ".4g", ".2g", ".6g", ".6g",
    )  # fmt: skip
    assert interval_text(1.196722, 1.201581, 0.0011) == "1.1967 to 1.2016"
    assert interval_text(-0.0936, 0.0, 0.021) == "-0.094 to 0"
    assert interval_text(1234.56, 1534.56, 76.0) == "1235 to 1535"
    assert interval_text(-4e-9, 6.2345e-7, 1.6e-7) == "-4e-09 to 6.2e-07"


def test_every_result_of_a_fit_shows_itself_alike() -> None:
    recording = recorded(Space.PLANE, seed=2)
    fitted = fit(planar(), recording)
    results = (fitted, fitted.intervals(), compare(fitted), RepeatTable.of(fitted), bootstrap(fitted, draws=200))
    for found in (*results, robust_fit(planar(), recording), CentreOfMass.of(fitted)):
        text, frame = str(found), found.to_frame()
        headings = [column.heading for column in found.table.columns]
        assert all(heading in text for heading in headings)
        assert list(frame.columns) == headings
        assert len(set(headings)) == len(headings)
        assert set(headings) <= {t.replace("(", "[").replace(")", "]") for t in Cells(found._repr_html_()).texts}
        assert len(found.table.to_markdown().splitlines()) == 2 + len(frame)
    assert fitted.to_frame()["value"].tolist() == fitted.theta.tolist()


def test_every_public_name_is_there() -> None:
    """The stub names them for type checkers; the module imports each, and lists them for completion."""
    names = [name for name in dir(truewrench) if not name.startswith("_")]
    assert {"fit", "diagnose", "effects", "planar", "survey"} <= set(names)
    assert set(truewrench.__all__) <= set(names)  # type: ignore[attr-defined]
    assert all(getattr(truewrench, name) is not None for name in names)
    with pytest.raises(AttributeError, match="nothing"):
        truewrench.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_a_column_that_nothing_is_known_of_is_left_out() -> None:
    table = Table.of(("a", "b", "c", "d"), [("x", None, None, ""), ("y", "", 1.0, Cell(None, "fixed"))])
    assert [c.name for c in table.filled.columns] == ["a", "c", "d"]
    assert [c.name for c in Table.of(("a", "b"), []).filled.columns] == ["a", "b"]
