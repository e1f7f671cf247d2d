"""Operations beside the elementary functions: what they do with ties, NaN and tables, for numbers and for lanes."""

from __future__ import annotations

import math
import re
from decimal import Context, Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.language import ops

numbers = st.floats(-1e6, 1e6)
NAN = np.float64(math.nan)


def test_nan_in_a_signal_passes_clip_minimum_and_maximum():
    assert math.isnan(ops.clip(NAN, -1.0, 1.0))
    assert math.isnan(ops.minimum(NAN, 1.0))
    assert math.isnan(ops.maximum(NAN, 1.0))


def test_what_is_not_selected_cannot_leak():
    assert ops.where(np.bool_(True), np.float64(2.0), NAN) == 2.0
    assert np.array_equal(ops.where(np.array([True, False]), np.float64(2.0), np.array([math.nan, 3.0])), [2.0, 3.0])


@given(numbers, numbers, numbers)
def test_clip_is_inside_and_leaves_alone_what_is_inside(x: float, a: float, b: float):
    low, high = min(a, b), max(a, b)
    got = ops.clip(np.float64(x), low, high)
    assert low <= got <= high
    assert got == x or not low <= x <= high


@given(numbers)
def test_sign_times_size_is_the_number(x: float):
    assert ops.sign(np.float64(x)) * ops.absolute(np.float64(x)) == x


@given(st.floats(-2.0, 6.0))
def test_interpolation_is_that_of_numpy_and_held_to_the_ends(place: float):
    row = np.array([3.0, -1.0, 4.0, 1.5])
    expected = np.interp(place, np.arange(4.0), row)
    # one rounding of the share, one product, one sum of numbers up to 5
    assert abs(ops.interpolate(row, np.float64(place)) - expected) <= 4 * math.ulp(5.0)


def test_a_table_is_read_at_its_ends_for_places_beyond_them_and_at_its_start_for_nan():
    row = np.array([3.0, -1.0, 4.0])
    assert [float(ops.gather(row, np.float64(i))) for i in (-7.0, 0.0, 2.0, 9.0, math.nan)] == [3.0, 3.0, 4.0, 4.0, 3.0]
    assert np.array_equal(ops.gather(row, np.array([2.0, 0.0])), [4.0, 3.0])


@pytest.mark.parametrize(("name", "expected"), [("both", False), ("either", True)])
def test_truth_values_combine(name: str, expected: bool):
    assert bool(getattr(ops, name)(np.bool_(True), np.bool_(False))) is expected
    assert np.array_equal(getattr(ops, name)(np.array([True]), np.array([False])), [expected])


def test_every_public_operation_has_a_sentence():
    for name in ops.__all__:
        if callable(getattr(ops, name)):
            assert getattr(ops, name).__doc__, name


def test_contributing_lists_every_operation() -> None:
    text = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"`(\w+)", "".join(re.findall(r"^  \|(.*)\|$", text, re.MULTILINE))))
    assert set(ops.__all__) == listed & set(ops.__all__)


def plastic(power: int) -> int:
    """2⁶⁴ / g^power, g > 1 of g⁴ = g + 1, to the nearest odd number below: the strides of a sequence without gaps."""
    with localcontext() as context:
        context.prec = 60
        g = Decimal("1.22")
        for _ in range(8):
            g -= (g**4 - g - 1) / (4 * g**3 - 1)
        return int(2**64 / g**power) | 1


def test_uniform_numbers_are_those_of_splitmix_in_integers() -> None:
    """Its own code in integers: the finalizer of SplitMix64 (Steele, Lea & Flood 2014, variant 13 of Stafford).

    The strides are 2⁶⁴ over the golden ratio, as there, and over powers of the root of g⁴ = g + 1 (Roberts 2018).
    """
    golden = int(2**64 * (Decimal(5).sqrt(Context(prec=60)) - 1) / 2) | 1
    for numbers in ((0, 0, 0), (1, 2, 3), (2**53 - 1, 7, 2**40), (12345, 10**9, 1)):
        bits = 0
        for number, stride in zip(numbers, (golden, plastic(1), plastic(3)), strict=True):
            bits = (bits + number + 1) * stride % 2**64
            bits = (bits ^ bits >> 30) * 0xBF58476D1CE4E5B9 % 2**64
            bits = (bits ^ bits >> 27) * 0x94D049BB133111EB % 2**64
            bits ^= bits >> 31
        assert ops.uniform(*map(float, numbers)) == ((bits >> 12) + 0.5) / 2**52
