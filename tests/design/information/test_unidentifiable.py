"""What no motion of an arm shows: closed forms, known confusions, and the sizes at which parameters show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from design.criteria import AOptimal, EOptimal
from design.information import Experiment, noise_equivalent_sizes, unidentifiable_combinations
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import planar
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm
from modeling.noise import NoiseModel
from tests.shared.information_cases import EFFECTS, LIMITS, PERIOD, STD, TOOL, gram, joint_states, values
from tests.shared.rigs import ARM


def test_one_joint_without_gravity_leaves_one_combination_open() -> None:
    """Then a = l (ddphi, dphi²) along the tip: only l m + mlg and l mlg + I are seen, so (1, -l, l²) is not."""
    length = 0.7
    weightless = replace(planar(), gravity=0.0)
    (found,) = unidentifiable_combinations(Experiment.of(weightless, PlanarArm((length,))))
    assert [p.name for p in found.parameters] == ["m", "mlg", "I"]
    np.testing.assert_allclose(found.amounts, [1, -length, length**2], rtol=1e-9)
    assert str(found) == (
        "m, mlg and I are collinear on any trajectory of this arm: "
        "raising m by 1 kg, lowering mlg by 0.7 kg m and raising I by 0.49 kg m² leaves the prediction unchanged"
    )


def test_a_small_turn_of_the_sensor_is_crosstalk() -> None:
    model = planar() + effects.sensor_rotation() + effects.sensor_crosstalk()
    (found,) = unidentifiable_combinations(Experiment.of(model, ARM, TOOL), LIMITS)
    assert [p.name for p in found.parameters] == [
        "sensor_rotation.angle", "sensor_crosstalk.fx_fy", "sensor_crosstalk.fy_fx"
    ]  # fmt: skip
    np.testing.assert_allclose(np.abs(found.amounts), 1, rtol=1e-8)


def test_an_effect_of_no_amount_hides_its_nuisance() -> None:
    model = planar() + effects.viscous_drag()
    (found,) = unidentifiable_combinations(Experiment.of(model, ARM, TOOL))
    assert str(found) == "viscous_drag.d is not identifiable from any trajectory of this arm"
    with pytest.raises(InputError, match=r"viscous_drag\.d changes no reading"):
        noise_equivalent_sizes(Experiment.of(model, ARM, TOOL))


EDGED = ("contact_event", "payload_change")
"""Their edges of 10 ms lie between the samples, where no motion shows their times."""


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e.id not in EDGED], ids=lambda e: str(e.id))
def test_random_motions_show_every_single_effect(effect: Effect) -> None:
    assert unidentifiable_combinations(Experiment.of(planar() + effect, ARM, values(effect)), LIMITS) == ()


def test_magnitudes_make_a_and_e_independent_of_units() -> None:
    """The tool in grams: the columns grow by 1e-3, the magnitudes by 1e3, and the criteria stay."""
    experiment = Experiment.of(planar(), ARM, noise=NoiseModel.white(STD))
    rows = experiment.columns(*joint_states(), PERIOD)
    scale = noise_equivalent_sizes(experiment, LIMITS)
    assert scale[0] == pytest.approx(0.8 * np.sqrt(3))  # a bias of one channel in three
    units = np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
    for family in (AOptimal, EOptimal):
        assert family(scale / units).value(gram(rows * units)) == pytest.approx(
            family(scale).value(gram(rows)), rel=1e-9
        )
