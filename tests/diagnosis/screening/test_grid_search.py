"""Searches by inner products: what they say of a point is what the point's own columns say, to rounding."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from diagnosis.diagnosis import diagnose
from diagnosis.screening.grid_search import affected_rows, grid_points, projected_columns, search_domain
from diagnosis.screening.null_model import NullModel, ScreeningCache
from diagnosis.screening.projection import ProjectedColumns
from diagnosis.screening.score_test import absent_effects, run_searches, screen
from diagnosis.screening.whitened_sensitivity import score_columns
from diagnosis.subset_search import MAX_EFFECTS
from estimation.fit import Fit, fit
from estimation.least_squares.problem import LinearisedRows
from estimation.least_squares.square_root_information import orthonormal_basis
from modeling.chain.effect import Effect, NuisanceValues
from modeling.chain.model import planar
from modeling.effects import catalogue, named
from modeling.effects.loads import ViscousDrag
from modeling.effects.sensor import SensorLag
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench import simulated_rig
from truewrench.simulated_rig import PlanarRig, simulate

pytest.importorskip("mujoco")

ROUNDING = 1e-7
"""Relative: differences of long steps lose digits, and so do columns that the model nearly explains."""


@cache
def fitted(*, repeats: int = 4, seed: int = 3) -> Fit:
    """The rigid tip, where something drags and pushes."""
    hidden = (simulated_rig.ViscousDrag(), simulated_rig.ContactEvent())
    motion = PlanarRig().random_motion(seed=seed)
    frame = simulate(PlanarRig(), motion, hidden=hidden, repeats=max(repeats, 2), samples_per_period=200, seed=seed)
    return fit(planar(RIG), recording_of(frame, without=() if repeats > 1 else ("repeat",), rig=RIG))


def alone(null_model: NullModel, model_effect: Effect, values: NuisanceValues) -> ProjectedColumns:
    """One point by its own columns."""
    model = null_model.fit.model + model_effect
    points = grid_points(model, model.effects[-1], [values])
    choice = affected_rows(null_model.fit, model)
    columns = score_columns(null_model.fit, model, points, choice)
    return ProjectedColumns.of_point(null_model, columns, choice, points[0].lowest())


def some(grid: tuple[NuisanceValues, ...]) -> list[int]:
    """A dozen places of a grid, both ends among them."""
    return sorted({0, len(grid) - 1, *np.random.default_rng(0).integers(0, len(grid), 10).tolist()})


@pytest.mark.parametrize("repeats", [4, 1])
@pytest.mark.parametrize("effect", catalogue(planar().space), ids=lambda e: e.id)
def test_a_point_of_a_grid_scores_as_it_does_alone(effect: Effect, repeats: int) -> None:
    null_model = NullModel(fitted(repeats=repeats))
    model = null_model.fit.model + effect
    effect = model.effects[-1]
    grid = effect.nuisance_grid(search_domain(null_model, 0, effect))
    if repeats == 1 and effect.id == "line_interference":
        assert grid == ()  # no tone is sought in a single run
        return
    assert grid
    together = projected_columns(null_model, model, effect, grid, ScreeningCache())
    for place in some(grid):
        one = alone(null_model, effect, grid[place])
        size = max(1.0, one.scores[0])
        assert together.ranks[place] == one.ranks[0]
        assert together.scores[place] == pytest.approx(one.scores[0], abs=ROUNDING * size)
        np.testing.assert_allclose(together.amounts[place], one.amounts[0], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(together.std[place], one.std[0], rtol=1e-5)


def test_every_searched_effect_of_the_catalogue_is_covered() -> None:
    null_model = NullModel(fitted())
    grids = {e.id: len(e.nuisance_grid(search_domain(null_model, 0, e))) for e in catalogue(planar().space)}
    assert {i for i, count in grids.items() if count > 8} >= {"cable_spring", "contact_event", "payload_change"}


def test_windows_are_differences_of_steps_also_when_they_overlap_an_edge() -> None:
    """Windows shorter than an edge stand alone; all others come from as many steps as they have different ends."""
    effect = named("contact_event")
    windows: list[NuisanceValues] = [
        {"start": s, "end": e} for s, e in ((0.1, 0.9), (0.5, 0.505), (0.9, 1.4), (0.1, 0.11))
    ]
    combination = effect.combination(windows)
    assert len(combination.blocks) == 5  # ends 0.1, 0.9, 1.4, 0.11 and one window alone
    null_model = NullModel(fitted())
    together = projected_columns(null_model, fitted().model + effect, effect, windows)
    for place, window in enumerate(windows):
        one = alone(null_model, effect, window)
        np.testing.assert_allclose(together.columns(place), one.columns(0), atol=1e-9 * np.abs(one.columns(0)).max())
        assert together.scores[place] == pytest.approx(one.scores[0], rel=1e-8)


def test_score_is_the_drop_of_chi_square() -> None:
    """By least squares on whole rows, which shares nothing with the inner products."""
    null_model = NullModel(fitted())
    residual, derivative = fitted().problem.evaluate(fitted().theta)
    model = fitted().model + ViscousDrag()
    (point,) = grid_points(model, model.effects[-1], [{"d": 0.1}])
    choice = affected_rows(null_model.fit, model)
    columns = null_model.spread(score_columns(null_model.fit, model, [point], choice)[:, 0], choice)
    before, after = (orthonormal_basis(m) for m in (derivative, np.column_stack([derivative, columns])))
    drop = np.sum((after.T @ residual) ** 2) - np.sum((before.T @ residual) ** 2)
    assert alone(null_model, ViscousDrag(), {"d": 0.1}).scores[0] == pytest.approx(drop, rel=1e-6)


def test_what_a_cache_keeps_changes_nothing() -> None:
    """Screening beside one effect after another, in one cache or each in its own."""
    effects = catalogue(planar().space)
    shared = ScreeningCache()
    first = fitted()
    second = fit(planar(RIG) + ViscousDrag(), first.recordings[0], noise=first.noise)
    third = fit(planar(RIG) + SensorLag(), first.recordings[0], noise=first.noise)
    for known in (first, second, third, first):
        together, by_itself = screen(known, effects, cache=shared), screen(known, effects)
        assert [s.effect.id for s in together] == [s.effect.id for s in by_itself]
        for a, b in zip(together, by_itself, strict=True):
            assert a.statistic == pytest.approx(b.statistic, rel=1e-9)
            assert a.p_value == pytest.approx(b.p_value, rel=1e-6)


def test_fits_screened_together_are_each_linearised_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four sets side by side, as many as a search has: nothing of one is lost while another is screened."""
    effects = [named(i) for i in ("viscous_drag", "sensor_lag", "gravity_tilt", "time_delay", "sensor_gain")]
    first = fitted()
    fits = [fit(planar(RIG) + effect, first.recordings[0], noise=first.noise) for effect in effects[:MAX_EFFECTS]]
    seen: list[Fit] = []
    plain = Fit.linearised

    def counted(known: Fit) -> LinearisedRows:
        seen.append(known)
        return plain(known)

    monkeypatch.setattr(Fit, "linearised", counted)
    shared = ScreeningCache()
    run_searches([key for known in fits for key in absent_effects(known, effects)], shared)
    for known in fits:
        screen(known, effects, cache=shared)
    assert [seen.count(known) for known in fits] == [1] * len(fits)


def test_two_effects_are_found_whatever_number_of_workers_is_stated() -> None:
    recording = fitted().recordings[0]
    candidates = [named(i) for i in ("viscous_drag", "quadratic_drag", "contact_event", "sensor_lag", "gravity_tilt")]
    found = diagnose(planar(RIG), recording, effects=candidates, workers=3)
    assert set(found.added) == {"viscous_drag", "contact_event"}


@pytest.mark.parametrize("given", ["saturation", "tip_flexibility"])
def test_effects_without_a_finite_nominal_value_are_given(given: str) -> None:
    """Their nominal model predicts nothing, nor is it asked to: a warning is an error here."""
    recording, other = fitted().recordings[0], fitted(seed=6).recordings[0]
    diagnose(planar(RIG) + named(given), recording, validate=other, effects=[named("sensor_lag")])


def test_one_thread_of_linear_algebra_is_used_and_given_back() -> None:
    """However many a user has: tall and thin matrices keep threads waiting for one another."""
    from threadpoolctl import threadpool_info, threadpool_limits

    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    seen: list[set[int]] = []
    with threadpool_limits(2):
        before = threads()
        diagnose(planar(RIG), fitted().recordings[0], effects=[named("gravity_tilt")], progress=_noting(threads, seen))
        assert threads() == before
    assert seen
    assert set().union(*seen) == {1}


def _noting(look: Callable[[], set[int]], seen: list[set[int]]) -> Callable[[str], None]:
    return lambda _message: seen.append(look())
