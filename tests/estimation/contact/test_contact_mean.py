"""Means of contacts in noise: their std, and the test whether a force at the tip explains them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.contact.contact_detection import detect_contacts
from estimation.contact.contact_wrench import ContactMean, ContactSeries
from modeling.significance import LEVELS
from truewrench.simulated_rig import NOISE_MODELS

Array = NDArray[np.float64]

ARM = 0.2
"""Distance of the tip from the sensor, m."""
SIGNS = np.diag([-1.0, 1.0, -1.0])
"""From reading to contact wrench, planar `on_tool`."""
STD = np.array([0.8, 1.6, 0.08])
"""Noise of one sample, N, N, N m, as in the README's rig."""
SAMPLES, FIRST, LAST = 1000, 400, 550
TIP_PUSH = np.array([3.0, -2.0, 3.0 * ARM])


def contacts_in(kind: str, seed: int, wrench: Array, *, correlated: bool = False) -> list[ContactMean]:
    """The means of what is detected of a half sine of contact, 10 ms a sample, that averages to `wrench`."""
    noise = NOISE_MODELS[kind].draw(np.random.default_rng([seed, 7]), SAMPLES, 3) * STD
    if correlated:
        noise[:, 2] += ARM * noise[:, 0]
    shape = np.zeros(SAMPLES)
    shape[FIRST:LAST] = np.sin(np.linspace(0, np.pi, LAST - FIRST)) * np.pi / 2
    residual = noise + shape[:, None] * wrench @ SIGNS
    found = detect_contacts(residual, 0.01, floor=STD, remainder=np.zeros(3))
    series = ContactSeries(
        wrench=(residual - found.zero) @ SIGNS,
        systematic=np.broadcast_to(SIGNS @ found.zero_covariance @ SIGNS, (SAMPLES, 3, 3)),
        noise=SIGNS @ found.covariance @ SIGNS,
        inverse=SIGNS,
        remainder=np.zeros(3),
        detection=found,
        forces=2,
        tip_length=ARM,
    )
    return [series.mean(interval) for interval in found.intervals]


@pytest.mark.long
@pytest.mark.parametrize("kind", NOISE_MODELS)
def test_a_force_at_the_tip_is_explained(kind: str) -> None:
    """At the level of 1 %, 3 alarms in 25 records happen in 2 of 1000 series of 25. Channels are correlated in half."""
    records = [contacts_in(kind, seed, 20 * TIP_PUSH, correlated=seed % 2 == 1) for seed in range(25)]
    assert sum(bool(means) for means in records) > 20
    assert sum(any(m.tip_p_value < LEVELS.tip_force / len(means) for m in means) for means in records) < 3


@pytest.mark.parametrize("kind", ["white", "student_t"])
def test_a_torque_that_contradicts_is_detected(kind: str) -> None:
    """Of eight standard errors of v' wrench, also where few differences give the noise: a couple on top of a
    push at the tip; and a push at half of its length."""
    error = np.hypot(STD[2], ARM * STD[0]) / np.sqrt(LAST - FIRST)
    couple = 4 * TIP_PUSH + [0.0, 0.0, 8 * error]
    closer = 4 * TIP_PUSH * [1.0, 1.0, 0.5]
    for seed in range(8):
        for wrench in (couple, closer):
            (mean,) = contacts_in(kind, seed, wrench)
            assert mean.tip_p_value < LEVELS.tip_force


def test_forces_are_those_of_the_mean() -> None:
    """|F| is not enlarged by the noise, the largest sample's is; the force at the tip is that of the push."""
    (mean,) = contacts_in("white", 1, 4 * TIP_PUSH)
    true = 4 * float(np.hypot(*TIP_PUSH[:2]))
    assert mean.force == pytest.approx(float(np.hypot(*mean.wrench[:2])), rel=1e-12)
    assert mean.force == pytest.approx(true, rel=0.15)  # the interval ends where the half sine is above the noise
    assert mean.tip_force == pytest.approx(mean.force, rel=0.03)
    assert mean.largest_force > mean.force


def test_std_is_that_of_the_error() -> None:
    """A rectangle, known to a sample: errors over their std in 20 records, mean square within six errors of one."""
    scores = []
    for seed in range(20):
        (mean,) = contacts_in("white", seed, 4 * TIP_PUSH)
        shape = np.sin(np.linspace(0, np.pi, LAST - FIRST)) * np.pi / 2
        inside = shape[mean.interval.first - FIRST : mean.interval.last - FIRST]
        scores.append((mean.wrench - inside.mean() * 4 * TIP_PUSH) / mean.std)
    square = float((np.array(scores) ** 2).mean())
    assert 0.2 < square < 1 + 6 * np.sqrt(2 / 60)
