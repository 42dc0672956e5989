"""One of every kind of public result, of a rig with a drag and a leak between channels."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

import truewrench as tw
from diagnosis.comparison.model_comparison import BandError
from estimation.fit import Fit
from tests.shared.recordings import drag_and_leak
from tests.shared.rigs import RIG
from truewrench.files.makers_sheet import MakersSheet, SheetComparison

WHITE = tw.NoiseModel.white([0.15, 0.25, 0.012])


@cache
def fitted() -> Fit:
    return tw.fit(tw.planar(RIG) + tw.effects.viscous_drag(), drag_and_leak(1))


@cache
def diagnosed() -> Any:
    return tw.diagnose(
        tw.planar(RIG), drag_and_leak(1), effects=[tw.effects.viscous_drag(), tw.effects.sensor_crosstalk()]
    )


@cache
def studied() -> Any:
    return tw.study(fitted().model, drag_and_leak(1), validate=drag_and_leak(501))


@cache
def loaded() -> Any:
    return tw.load(fitted().to_dict())


PLACE = {"name": "gravity at the place", "quantity": "gravity", "half_width": 0.02, "unit": "m/s²"}


@cache
def budgeted() -> Any:
    return tw.budget(fitted(), {"contribution": [PLACE]}, monte_carlo=50)


@cache
def of_sensor() -> Any:
    return tw.sensor_matrix(tw.fit(tw.planar(RIG) + "viscous_drag" + "sensor_crosstalk", drag_and_leak(1)))


RESULTS: dict[str, Callable[[], Any]] = {
    "fit": fitted,
    "intervals": cache(lambda: fitted().intervals()),
    "comparison": cache(lambda: tw.compare(fitted(), drag_and_leak(501))),
    "model comparison": cache(lambda: tw.compare([fitted(), fitted()], drag_and_leak(501))),
    "diagnosis": diagnosed,
    "finding": lambda: diagnosed().findings[0],
    "average": lambda: diagnosed().averaged,
    "step": lambda: diagnosed().steps[-1],
    "contact": cache(lambda: tw.compensate(fitted(), drag_and_leak(501))),
    "robust": cache(lambda: tw.robust_fit(tw.planar(RIG), drag_and_leak(1))),
    "recording": lambda: drag_and_leak(1),
    "model": lambda: fitted().model,
    "rig": lambda: RIG,
    "table": lambda: fitted().table,
    "chunk": lambda: next(iter(tw.chunks(drag_and_leak(1), 500))),
    "study": studied,
    "suspects": cache(lambda: studied().suspects()),
    "stairs": cache(lambda: studied().stairs()),
    "study step": lambda: studied().steps[0],
    "location": cache(lambda: studied().where()),
    "loaded model": loaded,
    "streamed": cache(lambda: tw.fit(tw.planar(RIG), tw.chunks(drag_and_leak(1), 500), noise=WHITE)),
    "bands": cache(lambda: BandError.of(tw.compare(fitted()))),
    "repeats": cache(lambda: tw.RepeatTable.of(fitted(), 0)),
    "set bounds": cache(
        lambda: tw.set_bounds(tw.fit(tw.planar(RIG), drag_and_leak(1)), {"fx": 9.0, "fy": 9.0, "tau": 9.0})
    ),
    "bootstrap": cache(lambda: tw.bootstrap(fitted())),
    "sensor matrix": of_sensor,
    "beside a sheet": lambda: SheetComparison(
        of_sensor(), MakersSheet(np.eye(3), np.array([130.0, 130.0, 10.0]), np.ones(3))
    ),
    "budget": budgeted,
    "budget of a contact": cache(
        lambda: budgeted().of_contact(tw.compensate(budgeted().calibration, drag_and_leak(501)))
    ),
}
