"""When information is earned: shares that add up, by their definition, and in no unit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from design.information.sample_information import SampleInformation
from modeling.errors import InputError

NAMES = ("a", "b", "c", "d")


def columns(seed: int = 0) -> NDArray[np.float64]:
    """(50, 3, 4), the parameters in units nine orders apart."""
    return np.random.default_rng(seed).standard_normal((50, 3, 4)) * [1.0, 1e-3, 1e6, 30.0]


def test_shares_are_their_definition() -> None:
    s = columns()
    inverse = np.linalg.inv(np.einsum("tpk,tpl->kl", s, s))
    found = SampleInformation.of(s, NAMES)
    # elimination does not mind the parameters' units (a diagonal scaling): rounding of well-conditioned numbers
    np.testing.assert_allclose(found.total, np.einsum("kl,tpl,tpk->t", inverse, s, s), rtol=1e-10)
    gain = np.einsum("tpk,kl->tpl", s, inverse)
    np.testing.assert_allclose(found.by_parameter, (gain**2).sum(axis=1) / np.diag(inverse), rtol=1e-10)


def test_shares_add_up() -> None:
    found = SampleInformation.of(columns(1), NAMES)
    assert found.total.sum() == pytest.approx(4, abs=1e-12)  # rounding
    np.testing.assert_allclose(found.by_parameter.sum(axis=0), 1.0, atol=1e-12)
    assert (found.by_parameter >= 0).all()


def test_accumulated_information_is_that_of_the_first_samples() -> None:
    """Of four parameters, in three channels, nothing is known before the second sample; no unit matters."""
    s = columns(4)
    logdet, condition = SampleInformation.of(s, NAMES).accumulated
    assert (logdet[0], condition[0]) == (-np.inf, np.inf)
    for end in (2, 10, 50):
        rows = s[:end].reshape(-1, 4)
        assert logdet[end - 1] == pytest.approx(
            np.linalg.slogdet(rows.T @ rows)[1], abs=1e-6
        )  # rounding, squared units
        scaled = rows / np.linalg.norm(s, axis=(0, 1))
        assert condition[end - 1] == pytest.approx(np.linalg.cond(scaled), rel=1e-9)


def test_variance_of_an_estimate_is_the_sum_of_its_samples() -> None:
    """Noise in one sample alone gives each estimate that sample's share of its variance: 4000 draws, 5 std (2e-6)."""
    s, rng, at = columns(2), np.random.default_rng(3), 7
    noise = np.zeros((50 * 3, 4000))
    noise[3 * at : 3 * at + 3] = rng.standard_normal((3, 4000))
    estimates = np.linalg.lstsq(s.reshape(-1, 4) / [1.0, 1e-3, 1e6, 30.0], noise, rcond=None)[0]
    scaled = s / [1.0, 1e-3, 1e6, 30.0]
    variance = np.diag(np.linalg.inv(np.einsum("tpk,tpl->kl", scaled, scaled)))
    expected = SampleInformation.of(s, NAMES).by_parameter[at] * variance
    np.testing.assert_allclose(estimates.var(axis=1), expected, rtol=5 * np.sqrt(2 / 4000))


def test_parameters_that_cannot_be_told_apart_have_no_shares() -> None:
    s = columns()
    s[:, :, 3] = 2 * s[:, :, 0]
    for unseen in (s, np.zeros((10, 3, 4))):
        with pytest.raises(InputError, match="not all parameters are identifiable"):
            SampleInformation.of(unseen, NAMES)
