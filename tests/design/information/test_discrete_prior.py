"""Priors: their moments, what they average, and what they need."""

from __future__ import annotations

import numpy as np
import pytest

from design.criteria import BayesianCriterion, DOptimal
from design.information import DiscretePrior, Experiment
from modeling import effects
from modeling.chain.model import planar
from modeling.errors import InputError
from tests.shared.information_cases import (
    PERIOD,
    SAMPLES,
    TOOL,
    assert_alike,
    gram,
    joint_states,
    motion,
    values,
    vector,
)
from tests.shared.rigs import ARM


def test_a_prior_puts_the_sets_side_by_side() -> None:
    model = planar() + effects.sensor_lag()
    sets = [TOOL | {"sensor_lag.time_constant": lag} for lag in (0.0, 0.02, 0.1)]
    whole = Experiment.prior(model, ARM, sets).information(motion(), SAMPLES)
    apart = [Experiment.of(model, ARM, theta).information(motion(), SAMPLES) for theta in sets]
    for place, single in enumerate(apart):
        block = slice(7 * place, 7 * place + 7)
        assert_alike(whole[block, block], single, 1e-13)
    weights = (0.25, 0.5, 0.25)
    expected = np.dot(weights, [DOptimal().value(single) for single in apart])
    assert BayesianCriterion(DOptimal(), weights).value(whole) == pytest.approx(expected, rel=1e-12)


def test_a_prior_around_an_estimate_has_its_moments() -> None:
    model = planar() + effects.sensor_lag()
    theta, which = vector(model, values(*model.effects)), [3, 4, 5, 6]  # m, mlg, I and the lag; biases do not matter
    rng = np.random.default_rng(6)
    root = rng.standard_normal((7, 7)) * np.array([1, 1, 0.1, 0.05, 0.01, 0.003, 0.002])[:, None]
    covariance = root @ root.T
    prior = DiscretePrior.around(model, theta, covariance)
    sets = np.array(prior.sets)
    np.testing.assert_allclose(prior.weights @ sets, theta, atol=1e-12)
    spread = (sets - theta).T @ (np.array(prior.weights)[:, None] * (sets - theta))
    np.testing.assert_allclose(spread[np.ix_(which, which)], covariance[np.ix_(which, which)], atol=1e-15)
    assert not spread[:3].any()
    linear = DiscretePrior.around(planar(), theta[:6], np.full((6, 6), np.inf))
    assert len(linear.sets) == 1
    assert linear.weights == (1.0,)


def test_a_prior_averages_as_monte_carlo_does() -> None:
    model = planar() + effects.sensor_lag()
    theta = vector(model, values(*model.effects))
    covariance = np.diag(np.array([0, 0, 0, 0.1, 0.02, 0.01, 0.004]) ** 2)
    prior = DiscretePrior.around(model, theta, covariance)
    states = joint_states(samples=100)
    criterion = BayesianCriterion(DOptimal(), prior.weights)
    found = criterion.value(gram(Experiment.prior(model, ARM, prior.sets).columns(*states, PERIOD)))
    draws = np.random.default_rng(7).multivariate_normal(theta, covariance, 60)
    drawn = [DOptimal().value(gram(Experiment.of(model, ARM, d).columns(*states, PERIOD))) for d in draws]
    assert found == pytest.approx(np.mean(drawn), abs=5 * np.std(drawn) / np.sqrt(60))  # five standard errors


def test_a_prior_needs_a_covariance() -> None:
    model = planar() + effects.sensor_lag()
    for covariance in (np.full((7, 7), np.inf), -np.eye(7), np.ones((7, 7)) - 2 * np.eye(7) + 2 * np.eye(7, k=1)):
        with pytest.raises(InputError, match="prior covariance"):
            DiscretePrior.around(model, TOOL, covariance)
