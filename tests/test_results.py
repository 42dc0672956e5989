"""Public results: short on a terminal, shown in a notebook, with frames, predictions and words for wrong names."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import truewrench as tw
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from tests.test_given_effects import DRAG, simulated
from tests.test_hidden_effects import RIG

pytest.importorskip("mujoco")

DRAG_ID = "viscous_drag"


@cache
def fitted() -> Fit:
    return tw.fit(tw.planar(RIG) + tw.effects.viscous_drag(), simulated(1))


def diagnosed() -> Any:
    return tw.diagnose(tw.planar(RIG), simulated(1), effects=[tw.effects.viscous_drag(), tw.effects.sensor_crosstalk()])


def saved(folder: Path) -> Any:
    return tw.load(tw.save(fitted(), folder / "model.json"))


RESULTS: dict[str, Callable[[], Any]] = {
    "fit": fitted,
    "intervals": lambda: fitted().intervals(),
    "comparison": lambda: tw.compare(fitted(), simulated(501)),
    "model comparison": lambda: tw.compare([fitted(), fitted()], simulated(501)),
    "diagnosis": diagnosed,
    "finding": lambda: diagnosed().findings[0],
    "step": lambda: diagnosed().steps[-1],
    "contact": lambda: tw.compensate(fitted(), simulated(501)),
    "robust": lambda: tw.robust_fit(tw.planar(RIG), simulated(1)),
    "recording": lambda: simulated(1),
    "model": lambda: fitted().model,
    "rig": lambda: RIG,
    "table": lambda: fitted().table,
    "chunk": lambda: next(iter(tw.chunks(simulated(1), 500))),
    "study": lambda: tw.study(fitted().model, simulated(1), validate=simulated(501)),
    "suspects": lambda: tw.study(fitted().model, simulated(1)).suspects(),
}
MOST_LINES, MOST_CHARACTERS = 40, 12_000


@pytest.mark.parametrize("name", RESULTS)
def test_typed_at_a_prompt_it_is_short(name: str) -> None:
    shown = repr(RESULTS[name]())
    assert len(shown.splitlines()) < MOST_LINES
    assert len(shown) < MOST_CHARACTERS
    assert "array(" not in shown


TABULAR = [name for name in RESULTS if name not in {"finding", "step", "recording", "model", "rig", "chunk", "table"}]


@pytest.mark.parametrize("name", TABULAR)
def test_results_have_a_table_a_frame_and_words(name: str) -> None:
    result = RESULTS[name]()
    assert "<table>" in result._repr_html_() or not result.table.rows
    assert isinstance(result.to_frame(), pd.DataFrame)
    assert len(result.summary()) > 10


def test_a_file_gives_the_model_back(tmp_path: Path) -> None:
    known = saved(tmp_path)
    assert len(repr(known).splitlines()) < MOST_LINES
    assert known["m"].value == fitted()["m"].value
    contact = tw.compensate(known, simulated(501)).wrench
    np.testing.assert_allclose(contact, tw.compensate(fitted(), simulated(501)).wrench, rtol=1e-9, atol=1e-12)
    with pytest.raises(tw.InputError, match="did you mean"):
        _ = known["viscous_drag.cc"]
    assert tw.compare({"saved": known}, simulated(501)).models[0].estimated is known


def test_parameters_by_name() -> None:
    fit = fitted()
    assert abs(fit[f"{DRAG_ID}.c"].value - DRAG.c) < 5 * fit[f"{DRAG_ID}.c"].std
    frame = fit.params
    assert list(frame.columns) == ["value", "std", "low", "high", "unit"]
    assert ((frame["low"] < frame["value"]) & (frame["value"] < frame["high"])).all()
    correlation = fit.correlation
    np.testing.assert_allclose(np.diag(correlation), 1.0)
    assert (np.abs(correlation.to_numpy()) <= 1 + 1e-12).all()
    with pytest.raises(tw.InputError, match="no parameter is called 'mass'"):
        _ = fit["mass"]


def readings(recording: Recording) -> pd.DataFrame:
    return pd.DataFrame(recording.wrench, columns=list(recording.channels))


def test_predictions_leave_the_residual() -> None:
    """Of its own recording the fit's residual; of another what a comparison leaves, but for the zero of the sensor."""
    fit, own, other = fitted(), simulated(1), simulated(501)
    found = fit.predict()
    assert list(found.columns) == list(own.channels)
    np.testing.assert_allclose(own.wrench - found.to_numpy(), fit.residuals[0])
    left = readings(other).to_numpy() - fit.predict(other).to_numpy()
    compared = tw.compare(fit, other).residual
    np.testing.assert_allclose(np.ptp(left - compared, axis=0), 0, atol=1e-9)


def test_recordings_of_frames_and_arrays_are_those_of_files() -> None:
    known = simulated(1)
    frame = readings(known).join(pd.DataFrame(dict(known.columns)))
    frame["repeat"] = np.repeat(np.arange(known.repeats), known.samples_per_repeat)
    frame["time"] = np.arange(known.samples) * (known.dt or 1.0)
    of_frame = tw.from_dataframe(frame.set_index("time"), rig=RIG)
    arrays = {name: frame[name].to_numpy() for name in ("time", "repeat", "temperature")}
    of_arrays = tw.from_arrays(known.wrench, q=frame[["q1", "q2", "q3"]].to_numpy(), rig=RIG, name="arrays", **arrays)
    for found in (of_frame, of_arrays):
        assert (found.repeats, found.samples) == (known.repeats, known.samples)
        np.testing.assert_allclose(found.signals["ddphi"], known.signals["ddphi"], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("wrench", "arrays", "message"),
    [
        (np.zeros((50, 4)), {}, "give \\(n, 3\\) for a planar sensor"),
        (np.zeros(50), {}, "wrench has the shape \\(50,\\)"),
        (
            np.zeros((50, 6)),
            {"orientation": np.zeros((50, 3))},
            "orientation has the shape .*give \\(n, 4\\)",
        ),
        (np.zeros((50, 6)), {"speed": np.zeros((50, 3))}, "speed has the shape"),
    ],
)
def test_arrays_of_other_shapes_are_a_sentence(wrench: Any, arrays: dict[str, Any], message: str) -> None:
    with pytest.raises(tw.InputError, match=message):
        tw.from_arrays(wrench, time=np.arange(50) / 100, **arrays)


FIGURES: dict[str, list[str | None]] = {
    "fit": [None, "map", "spectrum"],
    "comparison": ["residual"],
    "model comparison": ["residual", "map"],
    "diagnosis": [None, "residual", "map"],
    "study": ["stairs", "spectrum"],
    "contact": [None],
    "suspects": [None],
}


@pytest.mark.parametrize("name", FIGURES)
def test_results_are_drawn(name: str) -> None:
    """With units on every axis that has a quantity, for a notebook without pyplot."""
    result = RESULTS[name]()
    for kind in FIGURES[name]:
        figure = result.plot(kind=kind)
        assert figure.axes
        texts = [t for axes in figure.axes for t in (axes.get_ylabel(), axes.get_title(loc="left"), axes.get_xlabel())]
        assert any("N" in text or "%" in text for text in texts)
    assert "<svg" in figure._repr_svg_()


def test_a_wrong_argument_is_a_sentence() -> None:
    with pytest.raises(tw.InputError, match="a recording is needed, not a DataFrame"):
        fitted().predict(pd.DataFrame())  # type: ignore[arg-type]


def test_a_wrong_figure_is_a_sentence() -> None:
    with pytest.raises(tw.InputError, match="did you mean spectrum"):
        fitted().plot(kind="spectrumm")
    with pytest.raises(tw.InputError, match="no channel is 'fz'"):
        fitted().plot(channel="fz")
    with pytest.raises(tw.InputError, match="Intervals has no figure"):
        fitted().intervals().plot()
