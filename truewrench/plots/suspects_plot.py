"""Suspects ranked by the share of the error that each would remove."""

from __future__ import annotations

from matplotlib.figure import Figure

from diagnosis.screening.suspects import Suspects
from modeling.number_format import format_p_value
from truewrench.plots.style import FAINT, INK, MISFIT_COLOUR, MUTED, SMALL, PanelGrid, panel_title

ROW = 18
"""Height of a row, CSS pixels."""


def suspects_figure(suspects: Suspects) -> Figure:
    """A bar for each effect: the share of the excess chi-square that it would remove, its p-value beside it.

    Significant effects are coloured. Where the noise comes from the residual there is no excess: bars show the score.
    """
    rows = [(t, suspects.share(t)) for t in suspects.tests if t.excited]
    sheet = PanelGrid(rows=1, columns=1, panel_height=ROW * max(len(rows), 1), left=150, right=90, top=26, width=760)
    figure, panels = sheet.panels()
    axes, whole = panels[0, 0], suspects.excess is not None
    sizes = [100 * share if share is not None else test.statistic for test, share in rows]
    significant = [test.effect.id in suspects.ids for test, _ in rows]
    axes.barh(range(len(rows)), sizes, color=[MISFIT_COLOUR if s else FAINT for s in significant], height=0.66)
    axes.set_yticks(range(len(rows)), [test.effect.id.replace("_", " ") for test, _ in rows])
    axes.invert_yaxis()
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel("error that it would remove (%)" if whole else "drop of the whitened chi-square")
    axes.set_xlim(0, 100 if whole else None)
    for place, (test, _) in enumerate(rows):
        text = f"p {format_p_value(suspects.p_values[test.effect.id])}"
        axes.annotate(
            text, (1.0, place), (4, 0), axes.get_yaxis_transform(), "offset points",
            va="center", fontsize=SMALL, color=INK if significant[place] else MUTED,
        )  # fmt: skip
    panel_title(axes, "suspects, one at a time")
    return figure
