"""Units: what their texts mean, what is refused, and that dimensions are printed as they are read."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modeling.effects import catalogue
from modeling.errors import InputError
from modeling.formulas.units import DIMENSIONLESS, Dimension, dimension
from modeling.space import Space


def powers(**units: int) -> Dimension:
    return Dimension.of({unit: Fraction(power) for unit, power in units.items()})


MEANINGS = {
    "1": DIMENSIONLESS,
    "rad": DIMENSIONLESS,
    "N": powers(kg=1, m=1, s=-2),
    "N m": powers(kg=1, m=2, s=-2),
    "N s²/m²": powers(kg=1, m=-1),
    "N*s^2/m^2": powers(kg=1, m=-1),
    "N·s²·m⁻²": powers(kg=1, m=-1),
    "rad/(N m)": powers(kg=-1, m=-2, s=2),
    "1/N²": powers(kg=-2, m=-2, s=4),
    "N m/K": powers(kg=1, m=2, s=-2, K=-1),
    "J/(kg °C)": powers(m=2, s=-2, K=-1),
    "Hz": powers(s=-1),
    "N/m/s": powers(kg=1, s=-3),
    "T A m": powers(kg=1, m=1, s=-2),
    "V": powers(kg=1, m=2, s=-3, A=-1),
}


@pytest.mark.parametrize("text", MEANINGS)
def test_a_unit_has_its_dimension(text: str) -> None:
    assert dimension(text) == MEANINGS[text]


def test_products_quotients_and_powers_of_dimensions() -> None:
    force, length = dimension("N"), dimension("m")
    assert force * length == dimension("N m") == dimension("J")
    assert force / length**2 == dimension("Pa")
    assert (length**2) ** Fraction(1, 2) == length
    assert length / length == DIMENSIONLESS


@pytest.mark.parametrize(
    ("text", "column", "hint"),
    [
        ("", 1, "expected a unit"),
        ("mm", 1, "use m"),
        ("N/deg", 3, "use rad"),
        ("Newton", 1, "use SI units"),
        ("N m/s s", 7, "it is ambiguous whether 's' divides"),
        ("N//m", 3, "'/' is not expected"),
        ("rad/(N m", 9, "is incomplete"),
        ("N)", 2, "'.' is not expected"),
        ("m^13", 1, "power 13"),
        ("m^0", 1, "power 0"),
        ("N; m", 2, "';' is not allowed in a unit"),
        ("\x1b[31m", 1, r"\\x1b"),
        ("m" * 61, 1, "expected a unit"),
    ],
)
def test_what_is_no_unit_is_refused_at_its_column(text: str, column: int, hint: str) -> None:
    with pytest.raises(InputError, match=hint) as caught:
        dimension(text)
    assert f"(column {column} of" in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_unit_of_which_only_the_name_is_known_is_a_dimension_of_its_own() -> None:
    volts = dimension("N/Volt", own_units=("Volt",))
    assert volts != dimension("N")
    assert volts * dimension("Volt", own_units=("Volt",)) == dimension("N")
    with pytest.raises(InputError, match="did you mean Volt"):
        dimension("N/Vollt", own_units=("Volt",))
    assert dimension("m", own_units=("m",)) == dimension("m")  # nobody redefines the metre


FACTORS = st.lists(st.tuples(st.sampled_from(["kg", "m", "s", "K", "A"]), st.integers(-4, 4)), max_size=3)


@given(FACTORS)
def test_a_dimension_is_read_as_it_is_printed(factors: list[tuple[str, int]]) -> None:
    total = DIMENSIONLESS
    for unit, power in factors:
        total *= powers(**{unit: power})
    assert dimension(str(total)) == total


@given(FACTORS, st.sampled_from([2, 3]))
def test_a_root_of_a_dimension_is_read_as_it_is_printed(factors: list[tuple[str, int]], root: int) -> None:
    total = DIMENSIONLESS
    for unit, power in factors:
        total *= powers(**{unit: power}) ** Fraction(1, root)
    assert dimension(str(total)) == total


@given(st.text(max_size=12))
def test_any_text_is_a_unit_or_refused(text: str) -> None:
    with suppress(InputError):
        assert isinstance(dimension(text), Dimension)


@pytest.mark.parametrize("space", Space)
def test_every_parameter_of_the_catalogue_has_a_dimension(space: Space) -> None:
    for effect in catalogue(space):
        for parameter in effect.parameters(space):
            assert isinstance(dimension(parameter.unit), Dimension)
