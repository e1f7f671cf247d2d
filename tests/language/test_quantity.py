"""Quantities keep their numbers until they are read: in texts, tables and charts, in the units of the reader."""

from __future__ import annotations

import json
import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import USUAL, Quantity, Units, number, quantities, span, unit_name
from feeddrive.language.table import UNIT, Column, Table
from feeddrive.language.text import Text, capitalized, joined

KEEPS_QUANTITIES = True  # in the f-strings of this module, as in those of feeddrive
TURNS = Units(rotary=True)
numbers = st.floats(-1e300, 1e300)
units = st.sampled_from(["m", "N", "N/m", "m/N", "m/s", "s", "Hz", "kg", "N s/m", "share", ""])


@given(numbers, st.integers(1, 12))
def test_a_number_is_read_to_its_digits(value: float, digits: int) -> None:
    """Half a unit of the last digit, beside the rounding of a double."""
    bound = 0.5 * 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits) if value else 0.0
    assert abs(float(number(value, digits)) - value) <= bound * (1.0 + 1e-9) + 1e-300


def test_numbers_are_written_without_an_exponent_where_it_is_readable() -> None:
    said = {12345.6: "12346", 1234.5678: "1235", 0.00012345678: "0.0001235", 5.0: "5", 1e8: "1e+08", 1e-6: "1e-06"}
    assert {value: number(value) for value in said} == said


@given(numbers, units, st.none() | st.floats(0.0, 1e300), st.sampled_from(["", "3", ".2f", "6 SI"]), st.booleans())
def test_nothing_of_a_quantity_is_lost_in_a_text(
    value: float, unit: str, error: float | None, form: str, stays: bool
) -> None:
    quantity = Quantity(value, unit, error, form, stays)
    text = Text(f"so {quantity}, {Text(f'and {quantity}')}")
    again = pickle.loads(pickle.dumps(joined("; ", [text, "x"]) + "!"))
    assert quantities(capitalized(again)) == (quantity, quantity)
    assert str(again) == f"so {USUAL.text(quantity)}, and {USUAL.text(quantity)}; x!"


def test_a_reader_chooses_the_units() -> None:
    text = Text(
        f"{Quantity(5.88e-6, 'm')} RMS at {Quantity(3e7, 'N/m')}, {Quantity(100.0, 'Hz')}, {Quantity(2e3, 'N')}"
    )
    assert text == "5.88 um RMS at 30 N/um, 100 Hz, 2000 N"
    assert text.shown(TURNS) == "5.88 urad RMS at 30 N m/urad, 100 Hz, 2000 N m"
    assert text.shown(Units(typographic=True)) == "5.88 µm RMS at 30 N/µm, 100 Hz, 2000 N"
    assert text.shown(Units(length="mm", force="kN", frequency="rad/s")).startswith(
        "0.00588 mm RMS at 30 kN/mm, 628.3 "
    )
    assert text.shown(Units(length="inch")).startswith("0.0002315 in RMS at 762000 N/in")


def test_both_ends_of_a_range_are_in_the_units_of_the_reader() -> None:
    text = Text(f"from {span(5.0, 500.0, 'Hz')}, {span(0.001234567, 0.2, 'share', '3', between='..')}")
    assert text == "from 5 to 500 Hz, 0.123 .. 20 %"
    assert text.shown(Units(frequency="rad/s")) == "from 31.42 to 3142 rad/s, 0.123 .. 20 %"


def test_a_length_that_is_not_of_the_axis_stays_one() -> None:
    assert Text(f"{Quantity(5e-3, 'm', form='mm', stays=True)}, {unit_name('m')}").shown(TURNS) == "5 mm, urad"


def test_digits_follow_from_the_error() -> None:
    """Two digits of the error, and the number to the same place."""
    assert str(Quantity(94.2173, "kg", 0.3142)) == "94.22 +- 0.31 kg"
    assert str(Quantity(94.2173, "kg", 31.42)) == "94 +- 31 kg"
    assert Units(typographic=True).text(Quantity(1e-6, "m", 2e-8)) == "1.000 ± 0.020 µm"
    assert str(Quantity(160.18, "1/s", 1.234e-14)) == "160.18 +- 1.2e-14 1/s"  # data without noise


def test_what_a_person_wrote_is_never_changed() -> None:
    """A row of a user's that is named as a quantity, and texts that look like marks."""
    table = Table("5 kg", [Column("name"), Column("RMS", "m")], [["5 kg", 1e-6], ["a pitch of 5 mm", None]])
    assert table.grid(TURNS) == ("5 kg", ["name", "RMS urad"], [["5 kg", "1"], ["a pitch of 5 mm", "-"]], None)
    assert Text("\ue000nonsense\ue002") == "\\ue000nonsense\\ue002"
    assert Text("\ue0001\ue001m").shown(TURNS) == "\ue0001\ue001m"


def test_a_table_has_numbers_for_programs_and_units_for_people() -> None:
    columns = [Column("what"), Column("today"), Column("new", form="3"), Column("unit")]
    rows = [["mass", Quantity(90.0, "kg"), Quantity(94.2173, "kg", 0.3), UNIT], ["Ms", Quantity(1.9), None, UNIT]]
    table = Table("Values", columns, rows)
    assert table.grid().rows == [["mass", "90", "94.2", "kg"], ["Ms", "1.9", "-", ""]]
    assert table.grid(TURNS).rows[0] == ["mass", "90", "94.2", "kg m2"]
    record = json.loads(json.dumps(table.record(), allow_nan=False))
    assert record["rows"][0] == [
        "mass",
        {"value": 90.0, "unit": "kg"},
        {"value": 94.2173, "unit": "kg", "error": 0.3},
        "kg",
    ]


def test_a_message_of_an_error_keeps_its_quantities() -> None:
    inner = ParameterError(f"mass = {Quantity(5.0, 'kg')} must be > 6")
    outer = ParameterError(f"machine.toml: {inner}")
    assert str(outer) == "machine.toml: mass = 5 kg must be > 6"
    assert Text(f"{pickle.loads(pickle.dumps(outer))}").shown(TURNS) == "machine.toml: mass = 5 kg m2 must be > 6"


def test_a_unit_that_is_none_is_refused() -> None:
    with pytest.raises(ParameterError, match="length must be one of nm, um, mm, inch, not 'furlong'"):
        Units(length="furlong")
