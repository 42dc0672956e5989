"""Suspects ranked by the share of the error that each would remove."""

from __future__ import annotations

from diagnosis.screening.suspects import Suspects
from modeling.number_format import format_p_value
from truewrench.plots.charts.chart import Bars, Chart, Panel
from truewrench.plots.style import FAINT, MISFIT_COLOUR

ROW = 18
"""Height of a row, CSS pixels."""


def suspects_chart(suspects: Suspects) -> Chart:
    """A bar for each effect: the share of the excess chi-square that it would remove, its p-value beside it.

    Significant effects are coloured. Where the noise comes from the residual there is no excess: bars show the score.
    """
    tests = [test for test in suspects.tests if test.excited]
    whole = suspects.excess is not None
    shares = [suspects.share(test) for test in tests]
    bars = Bars(
        names=tuple(test.effect.id for test in tests),
        sizes=tuple(t.statistic if s is None else 100 * s for t, s in zip(tests, shares, strict=True)),
        colours=tuple(MISFIT_COLOUR if t.effect.id in suspects.ids else FAINT for t in tests),
        notes=tuple(f"p {format_p_value(suspects.p_values[t.effect.id])}" for t in tests),
    )
    panel = Panel(
        marks=(bars,),
        title="suspects, one at a time; coloured: significant",
        x_label="error that it would remove (%)" if whole else "drop of the whitened chi-square",
        x_limits=(0, 100) if whole else None,
    )
    return Chart(rows=((panel,),), row_height=ROW * max(len(tests), 1), left=170, right=90, width=760)
