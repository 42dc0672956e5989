"""Intervals for a largest error: the truth is in every one, an independent program gives the same, and no set is said.

Readings are MuJoCo's without noise; what is added to them is bounded.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pandas as pd
import pytest

from estimation.fit import Fit, fit
from estimation.least_squares.bounds import Bounds
from estimation.recordings.reading import from_columns
from estimation.set_bounds import set_bounds
from modeling.effects import named
from modeling.errors import InputError
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.recordings import base, noiseless_columns
from truewrench.command_line import main
from truewrench.simulated_rig import CentreOfMassOffset, HiddenEffect, PlanarRig

pytest.importorskip("mujoco")

ERROR = {
    Space.PLANE: {"fx": 0.5, "fy": 0.5, "tau": 0.05},
    Space.SPACE: {"fx": 0.3, "fy": 0.3, "fz": 0.4, "tx": 0.02, "ty": 0.02, "tz": 0.02},
}
OFFSET = CentreOfMassOffset(mlx=0.02)
EDGE = 1e-4
"""Of an error, by which readings may be off besides: the simulator's integration."""


def columns(space: Space, seed: int, *hidden: HiddenEffect, repeats: int = 2) -> dict[str, np.ndarray]:
    """Readings with uniform errors up to `ERROR`, or at either end of it for an odd seed."""
    found = dict(noiseless_columns(space, hidden, repeats, 5))
    rng = np.random.default_rng(seed)
    for name, size in ERROR[space].items():
        share = rng.uniform(-1, 1, len(found[name]))
        found[name] = found[name] + size * (np.sign(share) if seed % 2 else share)
    del found["temperature"]
    return found


def fitted(space: Space, seed: int, *hidden: HiddenEffect) -> Fit:
    links = PlanarRig().link_lengths if space is Space.PLANE else None
    return fit(base(space), from_columns(columns(space, seed, *hidden), name="run", rig=Rig(link_lengths=links)))


@cache
def truth(space: Space) -> np.ndarray:
    """The tool's parameters by the simulator's own readings, without any error."""
    found = fitted(space, 0)
    clean = np.column_stack([noiseless_columns(space, (), 2, 5)[name] for name in ERROR[space]])
    error = np.array(list(ERROR[space].values()))
    rows = (found.response(0).derivative / error[:, None]).reshape(clean.size, -1)
    return np.asarray(np.linalg.lstsq(rows, (clean / error).ravel(), rcond=None)[0])


def stated(space: Space, factor: float = 1.0) -> dict[str, float]:
    return {name: size * factor * (1 + EDGE) for name, size in ERROR[space].items()}


@pytest.mark.parametrize(("space", "draws"), [(Space.PLANE, 5), (Space.SPACE, 1)])
def test_the_truth_is_inside(space: Space, draws: int) -> None:
    for seed in range(draws):
        _truth_is_inside(space, seed)


@pytest.mark.long
def test_the_truth_is_inside_in_200_of_200() -> None:
    for seed in range(200):
        _truth_is_inside(Space.PLANE, seed)


def _truth_is_inside(space: Space, seed: int) -> None:
    bounds = set_bounds(fitted(space, seed), stated(space))
    assert bounds.feasible
    assert (bounds.low <= truth(space)).all()
    assert (truth(space) <= bounds.high).all()
    assert (bounds.low < bounds.high).all()


def test_another_solver_with_every_row_gives_the_same_ends() -> None:
    """Clarabel on all 1500 readings at once, against the few that are taken in."""
    found = fitted(Space.PLANE, 2)
    bounds = set_bounds(found, stated(Space.PLANE))
    error = np.array(list(stated(Space.PLANE).values()))
    rows = (found.response(0).derivative / error[:, None]).reshape(-1, found.theta.size)
    residual = (found.residuals[0] / error).ravel()
    scale = 1 / np.abs(rows).max(axis=0)
    step = cp.Variable(found.theta.size)
    within = [residual - (rows * scale) @ step <= 1, (rows * scale) @ step - residual <= 1]
    for index in range(found.theta.size):
        for end, kind in ((bounds.low, cp.Minimize), (bounds.high, cp.Maximize)):
            value = cp.Problem(kind(step[index]), within).solve(solver=cp.CLARABEL)
            width = bounds.high[index] - bounds.low[index]
            assert end[index] == pytest.approx(found.theta[index] + scale[index] * value, abs=1e-3 * width)


def test_errors_that_cannot_hold_are_said_with_the_factor_that_can() -> None:
    """Half of the errors that are there cannot hold; the factor is the smallest that is feasible."""
    found = fitted(Space.PLANE, 1)
    bounds = set_bounds(found, stated(Space.PLANE, 0.5))
    assert not bounds.feasible
    assert 1.9 < bounds.factor <= 2.0 + 1e-6
    assert np.isnan(bounds.low).all()
    assert "Infeasible" in bounds.remarks()[0]
    assert set_bounds(found, stated(Space.PLANE, 0.5 * bounds.factor * 1.0001)).feasible
    assert not set_bounds(found, stated(Space.PLANE, 0.5 * bounds.factor * 0.9999)).feasible


def test_what_is_missing_makes_the_set_empty() -> None:
    """A centre of mass off the tip axis that the rigid tool lacks; with it in the model the set has the true one."""
    found = fitted(Space.PLANE, 0, OFFSET)
    assert not set_bounds(found, stated(Space.PLANE)).feasible
    shifted = found.refitted(found.model + named("com_offset"))
    bounds = set_bounds(shifted, stated(Space.PLANE))
    assert bounds.feasible
    index = [p.name for p in shifted.unknowns].index("com_offset.mlx")
    assert bounds.low[index] <= OFFSET.mlx <= bounds.high[index]


def test_a_parameter_that_the_readings_do_not_limit_has_no_ends() -> None:
    """At one temperature the zero and its drift are one number: each can be anything, and all else is limited."""
    links = PlanarRig().link_lengths
    given = columns(Space.PLANE, 0) | {"temperature": np.full(len(columns(Space.PLANE, 0)["time"]), 30.0)}
    found = fit(
        base(Space.PLANE) + named("thermal_drift"), from_columns(given, name="run", rig=Rig(link_lengths=links))
    )
    bounds = set_bounds(found, stated(Space.PLANE))
    names = [p.name for p in found.unknowns]
    open_ended = [n for n, low, high in zip(names, bounds.low, bounds.high, strict=True) if low == -high == -np.inf]
    assert open_ended == [n for n in names if n.startswith(("bias", "thermal"))]
    assert np.isfinite(bounds.low[names.index("m")])
    assert bounds.to_data()["parameters"]["bias_fx"] == {"low": None, "high": None}
    assert str(bounds)


def test_a_model_that_is_not_linear_is_refused_by_the_effect_that_is_not() -> None:
    found = fitted(Space.PLANE, 0)
    tilted = found.refitted(found.model + named("com_offset") + named("gravity_tilt"))
    with pytest.raises(InputError, match="not linear in its parameters, by gravity_tilt;"):
        set_bounds(tilted, stated(Space.PLANE))


def test_bounds_of_the_fit_hold() -> None:
    """A mass between 0.9 and 0.95 kg is one here; one that is fixed far off leaves no parameters."""
    recordings = fitted(Space.PLANE, 1).recordings
    for ends, feasible in (((0.9, 0.95), True), ((0.5, 0.5), False)):
        held = fit(base(Space.PLANE), recordings, constraints=Bounds({"m": ends}))
        bounds, row = set_bounds(held, stated(Space.PLANE)), [p.name for p in held.unknowns].index("m")
        assert bounds.feasible == feasible
        if feasible:
            assert 0.9 - 1e-6 <= bounds.low[row] < bounds.high[row] <= 0.95 + 1e-6
        else:
            assert "within the fit's bounds" in bounds.remarks()[0]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ({"fx": 0.5, "fy": 0.5}, "no largest error of tau"),
        ({"fx": 0.5, "fy": 0.5, "tz": 0.1, "tau": 1.0}, "no channel is called 'tz'"),
        ({"fx": 0.5, "fy": -0.5, "tau": 1.0}, "'-0.5' is no largest error of fy"),
        ({"fx": 0.5, "fy": np.inf, "tau": 1.0}, "'inf' is no largest error of fy"),
        ({"fx": 0.5, "fy": "0.5", "tau": 1.0}, "'0.5' is no largest error of fy"),
        ({1: 0.5}, "no channel is called '1'"),
        (0.5, "a float is no largest error by channel"),
    ],
)
def test_errors_that_are_none(error: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        set_bounds(fitted(Space.PLANE, 0), error)


def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run.csv"
    pd.DataFrame(columns(Space.PLANE, 2)).to_csv(run, index=False)
    (tmp_path / "rig.toml").write_text(f"[robot]\nlink_lengths = {list(PlanarRig().link_lengths)}\n")
    command = ["fit", str(run), "--rig", str(tmp_path / "rig.toml")]
    given = [f"--error-bound={name}={size}" for name, size in stated(Space.PLANE).items()]
    assert main([*command, *given, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)["set_bounds"]
    assert data["feasible"]
    assert data["parameters"]["m"]["low"] < 0.9 < data["parameters"]["m"]["high"]
    assert main([*command, *given]) == 0
    assert "Holds for every error of a reading up to fx 0.50005" in capsys.readouterr().out
    for wrong, word in ((["--error-bound=fx"], "fx"), (given[:2], "tau"), (["--error-bound=m=1", *given], "m")):
        assert main([*command, *wrong]) == 2
        assert word in capsys.readouterr().err
