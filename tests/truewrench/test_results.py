"""Public results: short on a terminal, shown in a notebook, with frames, predictions and words for wrong names."""

from __future__ import annotations

import ast
import copy
import inspect
import json
import re
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from inspect import isabstract
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student

import truewrench as tw
from diagnosis.study import Stairs, StudyStep
from estimation.least_squares.estimates import FAMILIAR_NAMES
from estimation.recordings.recording import Recording
from modeling.number_format import NO_VALUE
from modeling.table import Tabular
from tests.shared.recordings import DRAG, drag_and_leak
from tests.shared.results import RESULTS, fitted, loaded
from tests.shared.rigs import RIG
from truewrench.reports.parameter_changes import ParameterChanges

pytest.importorskip("mujoco")

DRAG_ID = "viscous_drag"


def saved(folder: Path) -> Any:
    return tw.load(tw.save(fitted(), folder / "model.json"))


MOST_LINES, MOST_CHARACTERS = 40, 12_000


@pytest.mark.parametrize("name", RESULTS)
def test_typed_at_a_prompt_it_is_short(name: str) -> None:
    shown = repr(RESULTS[name]())
    assert len(shown.splitlines()) < MOST_LINES
    assert len(shown) < MOST_CHARACTERS
    assert "array(" not in shown


INPUTS = {"model", "rig", "chunk"}
DRAWN = {
    "fit", "intervals", "comparison", "model comparison", "diagnosis", "step", "contact", "robust", "recording",
    "study", "suspects", "stairs", "study step", "location", "loaded model", "streamed",
}  # fmt: skip
"""Results that a notebook shows with a figure."""
PRESENTED = [name for name in RESULTS if name not in INPUTS]


@pytest.mark.parametrize("name", PRESENTED)
def test_results_have_a_table_a_frame_and_words(name: str) -> None:
    result = RESULTS[name]()
    shown = ElementTree.fromstring(f"<div>{result._repr_html_()}</div>")
    assert any("".join(cell.itertext()).strip() for cell in shown.iter())
    pictures = [ElementTree.fromstring(unquote(i.get("src", "").partition(",")[2])) for i in shown.iter("img")]
    assert [picture.tag.rpartition("}")[2] for picture in pictures] == ["svg"] * (name in DRAWN)
    assert isinstance(result.to_frame(), pd.DataFrame)
    assert len(result.summary()) > 10


@pytest.mark.parametrize("name", ["model", "rig"])
def test_a_model_and_a_rig_show_themselves_as_tables(name: str) -> None:
    thing = RESULTS[name]()
    shown = "".join(ElementTree.fromstring(f"<div>{thing._repr_html_()}</div>").itertext())
    stated = {"model": ("viscous_drag.c", "N·s/m"), "rig": ("robot.link_lengths", "[1, 0.97, 0.4]", "m/s²")}[name]
    assert all(text in shown for text in stated)
    assert type(thing).__name__ in repr(thing).splitlines()[0]


@pytest.mark.parametrize("name", PRESENTED)
def test_results_are_plain_data(name: str) -> None:
    data = RESULTS[name]().to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data


def test_every_kind_of_result_is_here() -> None:
    """Of those with a table, but for what a study of its own makes: designs, surveys, poses, custom inputs."""
    elsewhere = {
        "LimitUse", "ExcitingTrajectory", "DiscriminationDesign", "WeakDuality", "DualityBound",  # tests of designs
        "IntervalDesign",
        "Survey", "ReadingReport", "CentreOfMass", "PoseAdvice", "LoadAdvice", "ContactPoint", "ContactFilter",
        "ErrorsInVariables", "ConstrainedMinimum", "Equations", "Errata", "Calibration", "Discovery",
    }  # fmt: skip
    assert all(hasattr(tw, name) for name in tw.__all__)  # type: ignore[attr-defined]  # each imports its module
    known = {type(RESULTS[name]()).__name__ for name in PRESENTED}
    every = {
        kind.__name__ for kind in _below(Tabular) if not kind.__module__.startswith("tests") and not isabstract(kind)
    }
    # A base class, a recording inside another one, a fit kept on another recording.
    assert every - elsewhere - known <= {"ComparedFit", "OwnMotion", "ValidationFit"}


def _below(kind: type[Any]) -> set[type[Any]]:
    return {kind, *(found for sub in kind.__subclasses__() for found in _below(sub))}


def test_what_comes_back_from_plain_data() -> None:
    """A fit's are those of its model file; a recording's columns are a recording again."""
    known = loaded()
    assert known.to_dict() == fitted().to_dict()
    own = drag_and_leak(1)
    again = tw.from_dataframe(pd.DataFrame(own.to_dict()["columns"]), rig=RIG)
    np.testing.assert_allclose(again.wrench, own.wrench)
    assert (again.repeats, again.samples) == (own.repeats, own.samples)


def test_a_file_gives_the_model_back(tmp_path: Path) -> None:
    known = saved(tmp_path)
    assert len(repr(known).splitlines()) < MOST_LINES
    pd.testing.assert_frame_equal(known.params, fitted().params[["value", "std", "unit"]])
    pd.testing.assert_frame_equal(known.correlation, fitted().correlation)
    pd.testing.assert_frame_equal(known.predict(drag_and_leak(501)), fitted().predict(drag_and_leak(501)))
    assert known["m"].value == fitted()["m"].value
    contact = tw.compensate(known, drag_and_leak(501)).wrench
    np.testing.assert_allclose(contact, tw.compensate(fitted(), drag_and_leak(501)).wrench, rtol=1e-9, atol=1e-12)
    with pytest.raises(tw.InputError, match="did you mean"):
        _ = known["viscous_drag.cc"]
    assert tw.compare({"saved": known}, drag_and_leak(501)).models[0].estimated is known
    assert tw.compare([known, fitted()], drag_and_leak(501)).models[0].estimated is known


def test_parameters_by_name() -> None:
    fit = fitted()
    assert abs(fit[f"{DRAG_ID}.c"].value - DRAG.c) < 5 * fit[f"{DRAG_ID}.c"].std
    frame = fit.params
    assert list(frame.columns) == ["value", "std", "freedom", "low", "high", "unit"]
    np.testing.assert_array_equal(frame["freedom"], fit.intervals().freedom)
    half = (frame["high"] - frame["low"]) / 2
    np.testing.assert_allclose(half / fit.intervals().std, student.ppf(0.975, frame["freedom"]))
    assert "degrees of freedom" in fit.summary()
    assert ((frame["low"] < frame["value"]) & (frame["value"] < frame["high"])).all()
    correlation = fit.correlation
    np.testing.assert_allclose(np.diag(correlation), 1.0)
    assert (np.abs(correlation.to_numpy()) <= 1 + 1e-12).all()
    with pytest.raises(tw.InputError, match="no parameter is called 'mass'"):
        _ = fit["mass"]


@pytest.mark.parametrize("name", ["fit", "loaded model", "streamed"])
def test_a_fit_is_iterated_as_a_mapping_of_its_parameters(name: str) -> None:
    fit = RESULTS[name]()
    assert list(fit) == list(fit.values) == list(fit.params.index)
    assert len(fit) == len(fit.params)
    assert [fit[p].name for p in fit] == list(fit)
    assert "m" in fit
    assert "mass" not in fit
    assert 3 not in fit


def test_a_short_name_suggests_the_parameter_of_the_effect() -> None:
    with pytest.raises(tw.InputError, match=rf"did you mean {DRAG_ID}\.d\?"):
        _ = fitted()["d"]


def test_printed_names_are_attributes() -> None:
    fit, comparison = fitted(), tw.compare(fitted())
    assert comparison.reduced_chi_square == comparison.misfit
    assert comparison.systematic_rms == comparison.explainable_rms
    assert f"reduced chi-square {fit.reduced_chi_square:.3g}" in str(fit)
    streamed = RESULTS["streamed"]()
    assert streamed.reduced_chi_square == streamed.misfit


@pytest.mark.parametrize("name", FAMILIAR_NAMES)
def test_a_habit_of_other_packages_is_told_the_name_here(name: str) -> None:
    """The attribute that the message names exists."""
    with pytest.raises(AttributeError, match=r"a Fit has no attribute .*; see ") as caught:
        getattr(fitted(), name)
    named = re.match(r"\w+", str(caught.value).split("; see ")[1])
    assert named is not None
    assert hasattr(fitted(), named[0])


def test_an_unknown_attribute_stays_one() -> None:
    assert not hasattr(fitted(), "nonsense")
    assert copy.copy(fitted()).values == fitted().values
    assert copy.deepcopy(fitted()).values == fitted().values


def test_a_parameter_at_a_bound_has_no_std_of_a_measurement() -> None:
    free = fitted()["m"]
    for bound, word in ((free.value + free.std, "fixed"), ((free.value + free.std, 9.0), "held at its bound")):
        found = tw.fit(fitted().model, drag_and_leak(1), constraints={"m": bound})
        (row,) = (line for line in str(found).splitlines() if line.startswith("m "))
        assert row.split() == ["m", *row.split()[1:2], *word.split(), "kg"]
        assert f"kg, {word}" in found.summary()
        assert found.held == ("m",)
        frame = found.to_frame().set_index("parameter")
        assert np.isnan(frame["std"]["m"])
        rows = {row[0]: row for row in ParameterChanges(None, found).table.rows}
        assert f"({word})" in str(rows["m"][2])
        assert rows["m"][3] == NO_VALUE


def readings(recording: Recording) -> pd.DataFrame:
    return pd.DataFrame(recording.wrench, columns=list(recording.channels))


def test_predictions_leave_the_residual() -> None:
    """Of its own recording the fit's residual; of another what a comparison leaves, but for the zero of the sensor."""
    fit, own, other = fitted(), drag_and_leak(1), drag_and_leak(501)
    found = fit.predict()
    assert list(found.columns) == list(own.channels)
    np.testing.assert_allclose(own.wrench - found.to_numpy(), fit.residuals[0])
    left = readings(other).to_numpy() - fit.predict(other).to_numpy()
    compared = tw.compare(fit, other).residual
    np.testing.assert_allclose(np.ptp(left - compared, axis=0), 0, atol=1e-9)


def test_recordings_of_frames_and_arrays_are_those_of_files() -> None:
    known = drag_and_leak(1)
    frame = readings(known).join(pd.DataFrame(dict(known.columns)))
    frame["repeat"] = np.repeat(np.arange(known.repeats), known.samples_per_repeat)
    frame["time"] = np.arange(known.samples) * (known.dt or 1.0)
    of_frame = tw.from_dataframe(frame.set_index("time"), rig=RIG)
    arrays: dict[str, Any] = {name: frame[name].to_numpy() for name in ("time", "repeat", "temperature")}
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


WRONG: dict[str, Callable[[], object]] = {
    "a recording is needed, not a DataFrame": lambda: fitted().predict(pd.DataFrame()),  # type: ignore[arg-type]
    "predict: a recording is needed, not a str": lambda: loaded().predict("other.csv"),
    "several fits are one argument; .* as a list": lambda: tw.compare(fitted(), fitted(), drag_and_leak(1)),  # type: ignore
    "several fits are one argument": lambda: tw.compare(fitted(), fitted()),  # type: ignore[call-overload]
    "compare: a Recording is no fit": lambda: tw.compare(drag_and_leak(1), drag_and_leak(1)),  # type: ignore[call-overload]
    "compare: a recording is needed, not a str": lambda: tw.compare(fitted(), "other.csv"),  # type: ignore
    "save: a Recording is no fitted model": lambda: tw.save(drag_and_leak(1), "model.json"),  # type: ignore[arg-type]
    "save: a Recording is no path": lambda: tw.save(fitted(), drag_and_leak(1)),  # type: ignore[arg-type]
    "load: a Fit is no model file": lambda: tw.load(fitted()),  # type: ignore[arg-type]
    "fit: a Recording is no model": lambda: tw.fit(drag_and_leak(1), fitted().model),  # type: ignore[call-overload]
    "fit: a recording is needed, not a str": lambda: tw.fit(fitted().model, ["run.csv"]),  # type: ignore
    "a Table has no dimensions": lambda: fitted().table.to_xarray(),
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_argument_is_a_sentence(message: str) -> None:
    with pytest.raises(tw.InputError, match=message):
        WRONG[message]()


def test_everything_public_is_completed() -> None:
    shown = {name for name in dir(tw) if not name.startswith("_")}
    assert shown == set(tw.__all__)  # type: ignore[attr-defined]
    assert all(hasattr(tw, name) for name in shown)


def test_type_checkers_read_the_same_public_names() -> None:
    imports = [node for node in ast.walk(ast.parse(inspect.getsource(tw))) if isinstance(node, ast.ImportFrom)]
    read = {alias.asname: getattr(import_module(f"{node.module}"), alias.name) for node in imports
            for alias in node.names if alias.asname}  # fmt: skip
    assert read == {name: getattr(tw, name) for name in tw.__all__}  # type: ignore[attr-defined]


def test_arrays_have_names_and_units() -> None:
    """Measured less predicted is the residual, and the parts of a repeat stand where they were."""
    pytest.importorskip("xarray")
    found, own = fitted().to_xarray(), drag_and_leak(1)
    assert dict(found.sizes) == {
        "repeat": own.repeats, "time": own.samples_per_repeat, "channel": 3, "parameter": 8, "other": 8
    }  # fmt: skip
    np.testing.assert_allclose(found.measured - found.predicted, found.residual, atol=1e-12)
    last = found.residual.sel(repeat=own.repeats - 1, channel="fy").to_numpy()
    np.testing.assert_allclose(last, fitted().residuals[0][-own.samples_per_repeat :, 1])
    assert found.time.attrs["units"] == "s"
    assert found.channel_unit.sel(channel="tau").item() == "N m"
    assert found.value.sel(parameter="m").item() == fitted()["m"].value
    for name in ("recording", "comparison", "contact", "diagnosis", "location", "loaded model", "streamed"):
        assert RESULTS[name]().to_xarray().sizes


def test_the_kind_of_a_figure_is_its_first_argument() -> None:
    first, named = fitted().plot("residual", backend="bokeh"), fitted().plot(kind="residual", backend="bokeh")
    assert first.chart.panels[0].y_label == named.chart.panels[0].y_label
    assert first.chart.rows[1][0].y_label.startswith("residual of")


def test_a_systematic_error_below_the_noise_is_its_upper_limit_everywhere() -> None:
    """An estimate of zero is printed as the limit of `explainable_limit`, in every table alike."""
    known = tw.compare(fitted())
    assert known.explainable_rms is not None
    zero = replace(known, explainable_rms=dict.fromkeys(known.explainable_rms, 0.0))
    limit = zero.explainable_limit
    assert limit is not None
    step = StudyStep("", fitted(), (zero,), ())
    texts = (str(zero), str(step.table), str(Stairs((step,), limit).table))
    for text in texts:
        assert all(re.search(rf"< {size:.3g}"[:7], text) for size in limit.values()), text
    assert [*zero.to_frame()["systematic rms"]] == [*limit.values()]


def test_a_wrong_figure_is_a_sentence() -> None:
    with pytest.raises(tw.InputError, match="did you mean spectrum"):
        fitted().plot(kind="spectrumm")
    with pytest.raises(tw.InputError, match="no channel is 'fz'"):
        fitted().plot(channel="fz")
