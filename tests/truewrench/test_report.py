"""Reports of small diagnoses: whole, self-contained, escaped, and saying what was found; and their plots' numbers."""

from __future__ import annotations

import gzip
import json
import re
from base64 import b64decode
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import cast
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest

from diagnosis.comparison.model_comparison import compare
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict.finding import Finding
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from estimation.fit import fit
from estimation.least_squares.estimates import Estimate
from estimation.recordings.reading_report import min_max_decimated
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import planar
from modeling.effects import catalogue, com_offset, sensor_crosstalk, thermal_drift, time_delay, viscous_drag
from modeling.number_format import format_number, format_p_value, format_percentage, format_unit, format_with_std
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.recordings import recording_of
from truewrench.plots.interactive_figure import script_hash
from truewrench.plots.residual_plots import residual_spectrum
from truewrench.plots.time_series_plot import (
    LabelledComparison,
    nonperiodic_residual,
    running_mean,
    std_of_interval_means,
)
from truewrench.reports.effect_row import effect_row
from truewrench.reports.report_files import Provenance
from truewrench.reports.report_html import report_page, write_report
from truewrench.simulated_rig import (
    BiasDrift,
    CentreOfMassOffset,
    HiddenEffect,
    MagnusForce,
    PlanarRig,
    ThermalDrift,
    ViscousDrag,
    simulate,
)
from truewrench.simulated_rig import static_poses as simulated_poses

pytest.importorskip("mujoco")

SIMULATED = PlanarRig()
RIG = Rig(name="arm & <b>tool</b>", link_lengths=SIMULATED.link_lengths, gravity=9.806)
ANY = cast("Diagnosis", None)
MADE = Provenance.now()
HOSTILE = "<script>alert('run')</script>"
VOID = {"meta", "img", "link", "br", "hr", "input"}


def recorded(*hidden: HiddenEffect, name: str = "run.csv", motion: int = 1, repeats: int = 4) -> Recording:
    path = SIMULATED.random_motion(seed=motion)
    frame = simulate(SIMULATED, path, hidden=hidden, repeats=repeats, samples_per_period=200, seed=motion)
    return recording_of(frame, name=name, rig=RIG)


def drag() -> Diagnosis:
    hidden = ViscousDrag(c=2.0)
    other = recorded(hidden, BiasDrift(), name="other.csv", motion=2)
    return found(recorded(hidden, name=HOSTILE), viscous_drag(), com_offset(), validate=(other,))


def poses() -> Diagnosis:
    frame = simulated_poses(SIMULATED, 16, hidden=(CentreOfMassOffset(mlx=0.02),))
    recording = recording_of(frame, name="poses.csv", rig=RIG)
    return found(recording, com_offset())


def unexplained() -> Diagnosis:
    return found(recorded(MagnusForce()), time_delay())


def single_run() -> Diagnosis:
    return found(recorded(ViscousDrag(c=2.0), repeats=1), viscous_drag())


def warming() -> Diagnosis:
    return found(recorded(ThermalDrift()), thermal_drift())


def several() -> Diagnosis:
    hidden = ViscousDrag(c=2.0)
    recordings = [recorded(hidden, name="first.csv"), recorded(hidden, name="second.csv", motion=2)]
    return diagnose(planar(RIG), recordings, effects=(viscous_drag(),))


def found(recording: Recording, *effects: Effect, validate: tuple[Recording, ...] = ()) -> Diagnosis:
    return diagnose(planar(RIG), recording, effects=effects, validate=validate)


CASES = {f.__name__: f for f in (drag, poses, unexplained, single_run, warming, several)}
LONG = ("drag", "unexplained", "warming", "several", "poses")


class Page(HTMLParser):
    """Checks that tags close in order, and collects references, text and the text of <h1>."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.scripts: list[tuple[str, str]] = []
        self.policy = ""
        self.words: list[str] = []
        self.headline = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.references += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "action", "data", "poster")]
        known = {k: v or "" for k, v in attrs}
        if tag == "script":
            assert set(known) <= {"type", "id"}
            self.scripts.append((known.get("type", ""), ""))
        if known.get("http-equiv") == "Content-Security-Policy":
            self.policy = known["content"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)
            return
        self.words.append(data)
        if self.open and self.open[-1] == "h1":
            self.headline += data

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.mark.parametrize("case", [pytest.param(c, marks=pytest.mark.long if c in LONG else []) for c in CASES])
def test_page(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # One test for each diagnosis, as diagnosis and page cost more than all that is looked at.
    if case not in ("drag", "unexplained"):  # these show the maps of all variables, of two models and of one
        monkeypatch.setattr("truewrench.reports.report_html.MAX_MAP_VARIABLES", 2)
    diagnosis = CASES[case]()
    html = report_page(diagnosis, MADE)
    parsed = Page(html)
    is_whole_and_fetches_nothing(html, parsed)
    shows_units_and_no_broken_numbers(parsed)
    SAYS[case](diagnosis, html, parsed)


def is_whole_and_fetches_nothing(html: str, parsed: Page) -> None:
    assert parsed.open == []
    written = re.sub(r'src="data:[^"]*"', "", html)  # of the pictures every link is looked at below
    assert re.search(r"https?:|url\(|@import|<script[^>]*src|<link|<iframe", written) is None
    runs_only_its_own_script(parsed)
    pictures = [r for r in parsed.references if not r.startswith("#")]
    assert len(pictures) >= 5
    for source in pictures:
        kind, data = source.split(",", 1)
        assert kind == "data:image/svg+xml"
        drawn = ElementTree.fromstring(unquote(data))
        links = [v for e in drawn.iter() for k, v in e.attrib.items() if k.endswith("href")]
        assert all(v.startswith("#") for v in links)
    anchors = {r.removeprefix("#") for r in parsed.references if r.startswith("#")}
    assert anchors <= set(re.findall(r'id="([^"]+)"', html))
    assert len(html) < 5e6


def runs_only_its_own_script(parsed: Page) -> None:
    """One script runs, known to the page's policy by its hash; the others are data: figures, and BokehJS packed."""
    (script,) = (text for kind, text in parsed.scripts if not kind)
    assert f"'{script_hash(script)}'" in parsed.policy
    assert "default-src 'none'" in parsed.policy
    assert "unsafe-eval" not in parsed.policy
    (packed,) = (text for kind, text in parsed.scripts if kind == "text/plain")
    assert "Bokeh" in gzip.decompress(b64decode(packed)).decode()[:1000]
    figures = [json.loads(text) for kind, text in parsed.scripts if kind == "application/json"]
    assert len(figures) >= 3
    for figure in figures:
        document = json.dumps(figure["item"]["doc"])
        assert "CustomJS" not in document  # the policy lets none run
        assert f'"id": "{figure["item"]["root_id"]}"' in document
        assert 'class="legend"' in figure["legend"]


def shows_units_and_no_broken_numbers(parsed: Page) -> None:
    assert "fx (N)" in parsed.text
    assert "tau (N·m)" in parsed.text
    assert re.search(r"\b(nan|inf|None)\b", parsed.text) is None


def names_effect_size_and_advice(diagnosis: Diagnosis, html: str, parsed: Page) -> None:
    assert diagnosis.verdict is RecordVerdict.EXPLAINED
    assert viscous_drag.title in parsed.headline
    estimate = diagnosis.fit.parameters["viscous_drag.c"]
    assert format_with_std(estimate.value, estimate.std) in parsed.text
    assert "N·s/m" in parsed.text
    assert viscous_drag.advice in parsed.text
    assert "4 repeats" in parsed.text
    assert "F = m (a − g)" in parsed.text
    assert "other.csv, held out" in parsed.text
    # In the verdict, and beside the recording's pictures.
    assert parsed.text.count("other.csv has a recording-specific drift: fx by") == 2
    describes_the_effect(html, parsed)
    folded = html.split("effects, not added" if "effects, not added" in html else "others, not added")[1]
    folded = folded.split("</table>")[0]
    assert com_offset.title in folded
    assert "Rejected, because" in folded
    assert viscous_drag.title not in folded
    # What users called their things is text, never markup.
    assert HOSTILE in parsed.text
    assert RIG.name in parsed.text
    assert "<b>tool" not in html


def describes_the_effect(html: str, parsed: Page) -> None:
    """Sketch, equations and the meaning of the parameters, and both models' estimates."""
    assert '<a href="#added">The effects added</a>' in html
    card = html.split('<article class="card">')[1].split("</article>")[0]
    assert '<svg class="sketch"' in card
    equations = [ElementTree.fromstring(e) for e in re.findall(r"<math.*?</math>", card, re.DOTALL)]
    assert len(equations) == 3  # of the planar channels
    assert "force for each unit of speed" in parsed.text
    assert "No other candidate effect is confusable" in parsed.text
    assert "95 % interval" in parsed.text
    assert "change / std" in parsed.text


def says_where_it_lives(diagnosis: Diagnosis, _html: str, parsed: Page) -> None:
    left = diagnosis.unexplained
    assert left is not None
    assert "no candidate effect explains it" in parsed.headline
    assert left.where in parsed.text
    assert left.resembles in parsed.text


def calls_the_verdict_weaker(_diagnosis: Diagnosis, _html: str, parsed: Page) -> None:
    assert "Without repeats this verdict is weaker" in parsed.text


def shows_what_does_not_repeat(_diagnosis: Diagnosis, _html: str, parsed: Page) -> None:
    assert thermal_drift.title in parsed.headline
    assert "non-periodic residual over the record" in parsed.text


def has_a_section_for_each(_diagnosis: Diagnosis, html: str, _parsed: Page) -> None:
    assert re.findall(r'<section id="recording-(\d)">\s*<h2>(\w+)', html) == [("1", "first"), ("2", "second")]


SAYS = {
    "drag": names_effect_size_and_advice,
    "poses": calls_the_verdict_weaker,
    "unexplained": says_where_it_lives,
    "single_run": calls_the_verdict_weaker,
    "warming": shows_what_does_not_repeat,
    "several": has_a_section_for_each,
}


def test_many_parameters_unfold_the_surest_first() -> None:
    names = [p.name for p in sensor_crosstalk().parameters(Space.SPACE)]
    estimates = {n: Estimate(n, float(i), 1.0, "1") for i, n in enumerate(names)}
    row = effect_row(
        Finding(sensor_crosstalk(), EffectVerdict.NOT_SUPPORTED, 0.5, None, {}, (), "", estimates), Space.SPACE
    )
    assert len(row.sizes) < len(row.more_sizes)
    assert [q.name for q in (*row.sizes, *row.more_sizes)] == names[::-1]


def test_written_file_is_renamed_into_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truewrench.reports.report_html.report_page", lambda *_: "<p>é</p>")
    target = tmp_path / "new" / "report.html"
    assert write_report(ANY, target) == target
    assert target.read_text(encoding="utf-8") == "<p>é</p>"
    assert list(target.parent.iterdir()) == [target]


def test_failed_report_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> str:
        raise RuntimeError

    target = tmp_path / "report.html"
    target.write_text("old")
    monkeypatch.setattr("truewrench.reports.report_html.report_page", broken)
    with pytest.raises(RuntimeError):
        write_report(ANY, target)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


# ------------------------------------------------------------------------------------------------- numbers of plots


def test_every_effect_has_text_for_the_table() -> None:
    for effect in catalogue(Space.SPACE):
        assert effect.title
        assert effect.advice
        assert effect.equation


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (-12.0, 3.4, "−12.0 ± 3.4"),
        (1500.0, 230.0, "1500 ± 230"),
        (0.00012345, 0.0000012, "(1.234 ± 0.012)·10⁻⁴"),
        (2.0, np.inf, "not identifiable"),
        (np.nan, 1.0, "–"),
    ],
)
def test_value_and_std_end_at_the_same_digit(value: float, std: float, expected: str) -> None:
    assert format_with_std(value, std) == expected


def test_numbers_as_text() -> None:
    assert [format_number(v) for v in (0.0, 0.012345, 123.4, 1.2e-7, None, np.nan)] == [
        "0",
        "0.0123",
        "123",
        "1.20·10⁻⁷",
        "–",
        "–",
    ]
    assert [format_p_value(p) for p in (0.0, 1e-90, 0.0123, 0.47, 1.0, None)] == [
        "< 10⁻³⁰⁰",
        "10⁻⁹⁰",
        "0.012",
        "0.47",
        "1",
        "–",
    ]
    assert [format_percentage(s) for s in (0.0, 1e-6, 0.5, 0.9999, 1.0, None)] == [
        "0 %",
        "< 0.1 %",
        "50.0 %",
        "> 99.9 %",
        "100 %",
        "–",
    ]
    assert [format_unit(u) for u in ("N m", "1", "as recorded")] == ["N·m", "", "as recorded"]


def test_envelope_keeps_every_extreme() -> None:
    y = np.random.default_rng(0).standard_normal(10_000)
    y[[17, 9_001]] = 40.0, -40.0
    x, kept = min_max_decimated(np.arange(10_000.0), y, bins=100)
    assert len(kept) <= 200
    assert (kept.max(), kept.min()) == (40.0, -40.0)
    assert (np.diff(x) > 0).all()


def test_running_mean_of_a_line_is_the_line_inside() -> None:
    y = np.arange(50.0)
    np.testing.assert_allclose(running_mean(y, 5)[2:-2], y[2:-2], atol=1e-12)  # rounding of sums of 50


@cache
def still() -> LabelledComparison:
    """Nothing hidden, the rigid tool."""
    return LabelledComparison("tool", "#000000", compare(fit(planar(RIG), recorded())))


def test_spectrum_shows_a_tone_at_its_amplitude() -> None:
    side = still()
    third = np.sin(2 * np.pi * 3 / 200 * np.arange(side.recording.samples))  # third harmonic of the 5 s period
    residual = np.outer(third, [0.5, 1.0, 2.0])
    lines = residual_spectrum(replace(side, comparison=replace(side.comparison, residual=residual)))
    line = int(np.argmax(lines.amplitude[:, 0]))
    assert lines.motion[line]
    np.testing.assert_allclose(lines.frequency[line], 0.6)
    np.testing.assert_allclose(lines.amplitude[line], [0.5, 1.0, 2.0])


def test_passing_part_of_noise_has_the_spread_that_is_drawn() -> None:
    ratio = nonperiodic_residual(still())[1].std(axis=0) / std_of_interval_means(still())
    # 32 stretches, of which the mean over 4 repeats takes 8: one std is known to 1 / sqrt(2 * 24) = 14 %; three of it.
    np.testing.assert_allclose(ratio, 1.0, atol=0.43)
