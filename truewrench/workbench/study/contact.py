"""Contact in another recording, by the current model of a study."""

from __future__ import annotations

from dataclasses import replace

from diagnosis.study import Study
from estimation.contact.contact_wrench import ContactWrench, compensate
from estimation.logs.log_reading import read_with_rig
from truewrench.plots.charts.chart import Chart
from truewrench.plots.result_figure import result_chart


def contact_of(study: Study, file: str) -> tuple[ContactWrench, Chart]:
    """The contact wrench in a recording of the same rig and tool, with its chart.

    Raises InputError for what cannot be read, or is of another sensor.
    """
    rig = study.fit.recordings[0].rig
    found = compensate(study.fit, read_with_rig(file, rig=rig, every_row=True))
    return found, replace(result_chart(found, kind="contact"), row_height=150)
