"""Operations beside the elementary functions: what they do with ties, NaN and tables, for numbers and for lanes."""

from __future__ import annotations

import math
import re
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
