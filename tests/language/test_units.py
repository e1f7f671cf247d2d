"""Units at the border: sizes that can be checked by hand, round trips, and refusal of other dimensions."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.files.columns import unit_of
from feeddrive.language.errors import ParameterError
from feeddrive.language.units import factor, measure, response

EXACT = [
    ("N_per_um", "N/m", 1e6),
    ("mm", "m", 1e-3),
    ("um", "m", 1e-6),
    ("ms", "s", 1e-3),
    ("us", "s", 1e-6),
    ("kN", "N", 1e3),
    ("m_per_min", "m/s", 1 / 60),
    ("mm_per_min", "m/s", 1e-3 / 60),
    ("m_per_min_per_mm", "1/s", 1000 / 60),  # Kv: 1 (m/min)/mm = 16.67 1/s
    ("mm_per_s_per_mm", "1/s", 1.0),
    ("1_per_min", "1/s", 1 / 60),
    ("kg_m2", "kg m2", 1.0),
    ("g", "kg", 1e-3),
    ("percent", "", 0.01),
    ("kHz", "Hz", 1e3),
    ("Hz", "rad/s", 2 * math.pi),
    ("rpm", "rad/s", 2 * math.pi / 60),
    ("deg", "rad", math.pi / 180),
    ("mm_per_rev", "m/rad", 1e-3 / (2 * math.pi)),
    ("V", "W/A", 1.0),
    ("J", "N m", 1.0),
    ("", "", 1.0),
    ("N/(m/s)", "N s/m", 1.0),
    ("1/(s/m)", "m/s", 1.0),
    ("(m/s)/(N/(kg/g))", "m/(N s)", 1e3),  # parentheses in parentheses
    ("rad/(s N m)", "rad/(N m s)", 1.0),
    ("U/min", "rpm", 1.0),
]


def test_sizes():
    sizes = {(unit, declared): factor(unit, declared) for unit, declared, _ in EXACT}
    assert sizes == {(unit, declared): pytest.approx(value, rel=4e-16) for unit, declared, value in EXACT}


def spellings() -> list[tuple[str, str, float]]:
    """The rows of the table in docs/reference/files.md: as written, in SI, and how many times that."""
    rows: list[tuple[str, str, float]] = []
    page = Path(__file__).parents[2] / "docs" / "reference" / "files.md"
    for line in page.read_text(encoding="utf-8").splitlines():
        found = re.fullmatch(r"\| (`[^|]+`) \| `([^`]+)` \| ([0-9.e-]+) \|", line)
        if found:
            rows += [(each, found[2], float(found[3])) for each in re.findall(r"`([^`]+)`", found[1])]
    return rows


def test_the_table_of_spellings_is_long():
    assert len(spellings()) > 45


def test_the_spellings_in_the_docs_are_read():
    for written, si, times in spellings():
        unit = unit_of(written)
        assert unit is not None, written
        assert factor(unit, si) == pytest.approx(times, rel=4e-16), written
        if si.count("/") and si[-1] in "NA)" and "N s" not in si:
            name, size = response(unit) or ("", 0.0)
            assert (name, size) == (si, pytest.approx(times, rel=4e-16)), written


def test_hertz_and_radians_per_second_stay_two_things():
    assert response("Hz/A") == ("(rad/s)/A", pytest.approx(2 * math.pi, rel=4e-16))
    assert response("1/(s A)") is None
    assert unit_of("U/min") == "rpm"


units = st.sampled_from(["m", "mm", "um", "s", "ms", "N", "kN", "kg", "rad", "deg", "rev", "A", "V", "Hz"])


@given(st.lists(units, min_size=1, max_size=3), st.lists(units, max_size=2))
def test_a_unit_there_and_back_is_one(above: list[str], below: list[str]):
    text = " ".join(above) + ("/" + " ".join(below) if below else "")
    _, dimension = measure(text)
    base = {0: "m", 1: "kg", 2: "s", 3: "A", 4: "rad"}
    up = [f"{base[i]}{e}" for i, e in enumerate(dimension) if e > 0]
    down = [f"{base[i]}{-e}" for i, e in enumerate(dimension) if e < 0]
    si = (" ".join(up) or "1") + ("/" + " ".join(down) if down else "")
    if max(abs(e) for e in dimension) <= 9:  # one digit is what a unit may have as exponent
        assert factor(text, si) * factor(si, text) == pytest.approx(1.0, rel=1e-15)


def test_a_slash_and_per_mean_the_same():
    assert measure("N s/m") == measure("N_s_per_m")


@pytest.mark.parametrize(
    ("given_unit", "declared"),
    [("Hz", "1/s"), ("rpm", "Hz s"), ("N", "N/m"), ("mm", "s"), ("N m", "N m/rad"), ("percent", "m"), ("A", "V")],
)
def test_another_dimension_is_refused(given_unit: str, declared: str):
    with pytest.raises(ParameterError, match="does not measure the same thing"):
        factor(given_unit, declared)


@pytest.mark.parametrize(
    "unit",
    [
        "furlong",
        "xm",
        "m^2",
        "2m",
        "m**2",
        "_",
        "m-1",
        "μm",
        "per",
        "kkg",
        "(m",
        "m)",
        "()",
        "m//s",
        "m/",
        "((((((((((m))))))))))",
    ],
)
def test_what_is_no_unit_is_refused(unit: str):
    with pytest.raises(ParameterError, match="unit"):
        factor(unit, "m")


@given(st.text(max_size=20))
def test_any_text_is_a_unit_or_a_parameter_error(text: str):
    try:
        size, _ = measure(text)
    except ParameterError:
        return
    assert size > 0.0


@pytest.mark.parametrize(("depth", "is_read"), [(6, True), (12, False)])
def test_a_unit_has_at_most_eight_nested_parentheses(depth: int, is_read: bool):
    unit = f"{'(' * depth}m{')' * depth}"
    if is_read:
        assert factor(unit, "m") == 1.0
    else:
        with pytest.raises(ParameterError, match="nested parentheses"):
            factor(unit, "m")
