"""The statistics of `benchmarks.calibration`: ranks of a posterior that is exact are uniform, of one too narrow not.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.calibration import Cell, Histogram, adjusted, rank_chart, reliability_chart, tables, with_margins
from benchmarks.calibration_draws import DRAWS, HIDDEN, Draw, Fitted, Rank, Said, posterior_ranks
from diagnosis.verdict_rule import RecordVerdict
from estimation.model_response import predicted_readings
from modeling.space import Space
from truewrench.plots.chart import Points
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR

RECORDINGS, SAMPLES = 400, 6


@cache
def toy(confidence: float) -> Cell:
    """Fits of a toy: two correlated means of few normal samples each of unknown std, whose posterior (flat in the means
    and the logarithm of a common std) is Student's t; std too small by `confidence`. Its p-values are uniform too, and
    as much too small."""
    rng, freedom = np.random.default_rng(2), np.full(2, 2.0 * (SAMPLES - 1))
    mixing, fits = np.array([[1.0, 0.0], [0.8, 0.6]]), []
    for _ in range(RECORDINGS):
        noise = rng.standard_normal((SAMPLES, 2))
        variance = ((noise - noise.mean(axis=0)) ** 2).sum() / freedom[0] / SAMPLES
        error, covariance = -mixing @ noise.mean(axis=0), mixing @ mixing.T * variance / confidence**2
        std = np.sqrt(np.diag(covariance))
        ranks, together = posterior_ranks(error, std, freedom, covariance, rng)
        distance = abs(error[1]) / (2.228 * std[1])  # of 10 degrees of freedom
        own = (Rank("tool", "m", int(ranks[1]), distance), Rank("together", "", together))
        fits.append(Fitted(own, rng.random() ** confidence))
    told = {n: Said(RecordVerdict.NOTHING_MISSING, ("drag",) * (n < 10 * (confidence > 1))) for n in range(100)}
    return Cell("white" if confidence == 1 else "AR 0.95", 4, fits, told)


def test_an_exact_posterior_has_uniform_ranks() -> None:
    """Of both histograms: outside the band once in 50, p below 1e-3 once in 500; 95 % of 400 intervals are 380 ± 4.4,
    more than 4 std off once in 1e4."""
    cell = toy(1.0)
    for kind in ("tool", "together"):
        histogram = cell.histogram(kind)
        low, high = histogram.band
        assert sum(histogram.counts) == RECORDINGS
        assert low <= min(histogram.counts) <= max(histogram.counts) <= high
        assert histogram.p_value > 1e-3
    assert abs(cell.inside("tool").count - 380) < 18
    assert cell.narrow("tool") == pytest.approx(1.0, abs=0.4)


def test_a_posterior_that_is_too_narrow_leaves_the_band() -> None:
    """A std 1.8 times too small: 95 % intervals hold 76 ± 2.1 %, the outer bins have 92 ± 8.4 of 400, the band ends at
    61: less once in 5000."""
    cell = toy(1.8)
    tool, together = cell.histogram("tool"), cell.histogram("together")
    assert min(tool.counts[0], tool.counts[-1]) > tool.band[1]
    assert together.counts[-1] > together.band[1]
    assert max(tool.p_value, together.p_value) < 1e-6
    assert cell.inside("tool").interval[1] < 0.9
    assert cell.narrow("tool") == pytest.approx(1.8, abs=0.7)


def test_a_posterior_that_is_too_wide_leaves_it_too() -> None:
    """A std twice too large leaves the outer bins nearly empty."""
    histogram = toy(0.5).histogram("tool")
    assert max(histogram.counts[0], histogram.counts[-1]) < histogram.band[0]


def test_the_band_holds_as_many_histograms_as_it_says() -> None:
    """1 % or less of histograms of uniform ranks leave it: of 2000 more than 38 once in 1e4."""
    ranks = np.random.default_rng(0).integers(DRAWS + 1, size=(2000, 50))
    histograms = [Histogram.of(row) for row in ranks.tolist()]
    low, high = histograms[0].band
    assert sum(min(h.counts) < low or max(h.counts) > high for h in histograms) < 38


def test_tables_and_pictures_tell_them_apart() -> None:
    """What is too narrow is red, and its false alarms and p-values are counted; what is exact is blue."""
    cells = [toy(1.0), toy(1.8)]
    p_values = adjusted(cells)
    assert p_values[cells[0].name, "tool"] > 0.01 > p_values[cells[1].name, "tool"]
    (exact,), (narrow,) = rank_chart(cells, "tool").rows
    assert exact is not None
    assert narrow is not None
    assert (exact.title_colour, narrow.title_colour) == (ADEQUATE_COLOUR, MISFIT_COLOUR)
    assert "n 400" in narrow.title
    panels = {panel.title.split(";")[0]: panel for panel in reliability_chart(cells).panels}
    for name in ("95 % of tool", "false effect"):
        marks = [mark for mark in panels[name].marks if isinstance(mark, Points)]
        assert [(mark.colour, mark.x.tolist()) for mark in marks] == [(ADEQUATE_COLOUR, [0]), (MISFIT_COLOUR, [1])]
    assert cells[1].stated["false effect"].count == len(cells[1].failures) == 10
    assert "10/200" in str(tables(with_margins(cells))[1]).splitlines()[-1]


@pytest.mark.parametrize("effect", HIDDEN)
def test_the_truth_is_what_was_simulated(effect: str) -> None:
    """The model at the true parameters leaves the noise alone: its rms over 900 readings or more is 1 ± 0.024."""
    draws = (Draw.of("white", 2, number) for number in range(1000))
    draw = next(d for d in draws if d.effect == effect and d.space is Space.PLANE)
    recording, model = draw.recording(draw.hidden), draw.model(effect)
    theta = np.array([draw.truth[p.name] for p in model.parameters])
    left = (recording.wrench - predicted_readings(model, recording, theta)) / np.array(draw.rig.noise)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(1.0, abs=0.1)
