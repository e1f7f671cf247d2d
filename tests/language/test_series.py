"""Taylor series, changes and intervals against derivatives, fifty digits and exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest

from feeddrive.language import ops
from feeddrive.language.series import Change, Interval, Taylor

RNG = np.random.default_rng(7)


def composed(x: Any, y: Any) -> Any:
    """An expression with every operation: sums, differences, products, constants on both sides, sine and cosine."""
    return 2.0 - ops.sin(x) * (3.0 * y + 1.0) + (y - 0.5) * ops.cos(x * y) * x - (-y)


def precise(x: Any, y: Any) -> Any:
    return 2 - mpmath.sin(x) * (3 * y + 1) + (y - mpmath.mpf(0.5)) * mpmath.cos(x * y) * x + y


def test_a_taylor_series_has_the_derivatives_of_the_function() -> None:
    def of_time(t: Any) -> Any:
        return precise(mpmath.mpf(0.7) + 2 * t - t**2, mpmath.mpf(-0.3) + t / 2 + t**3)

    with mpmath.workdps(50):
        exact = [float(term) for term in mpmath.taylor(of_time, 0, 4)]
    series = composed(Taylor(0.7, 2.0, -1.0, 0.0, 0.0), Taylor(-0.3, 0.5, 0.0, 1.0, 0.0))
    assert series.order == 4
    # some thirty operations, each with a relative error of 1.1e-16 in terms of up to 10
    assert np.array(series.terms) == pytest.approx(exact, abs=1e-14)


def test_a_product_has_the_order_of_the_shorter_factor() -> None:
    assert (Taylor(1.0, 2.0, 3.0) * Taylor(1.0, 1.0)).terms == (1.0, 3.0)
    assert (5.0 - Taylor(1.0, 2.0)).terms == (4.0, -2.0)


def test_series_of_arrays_are_those_of_their_entries() -> None:
    rows = RNG.uniform(-2.0, 2.0, (4, 3, 5))
    whole = composed(Taylor(*rows[0]), Taylor(*rows[1]))
    for k in range(5):
        one = composed(Taylor(*rows[0][:, k]), Taylor(*rows[1][:, k]))
        assert [term[k] for term in whole.terms] == list(one.terms)


@pytest.mark.parametrize("size", [1e-1, 1e-6, 1e-12, 1e-15])
def test_a_small_change_keeps_its_digits(size: float) -> None:
    for x, y, u, v in RNG.uniform(-2.0, 2.0, (40, 4)).tolist():
        moved = composed(Change(x, size * u), Change(y, size * v))
        with mpmath.workdps(50):
            a, b = mpmath.mpf(x), mpmath.mpf(y)
            exact = precise(a + mpmath.mpf(size * u), b + mpmath.mpf(size * v)) - precise(a, b)
            # relative to the step: terms of it may cancel, but no term has the size of the function
            assert abs(float(exact) - moved.change) < 1e-14 * size
        assert moved.start == composed(x, y)


def test_an_interval_holds_the_exact_results_of_its_ends() -> None:
    for a, b in RNG.uniform(-1.0, 1.0, (300, 2)) * 10.0 ** RNG.integers(-8, 8, (300, 2)):
        x, y, exact = Interval(a, a), Interval(b, b), (Fraction(a), Fraction(b))
        for result, wanted in (
            (x + y, exact[0] + exact[1]),
            (x - y, exact[0] - exact[1]),
            (x * y, exact[0] * exact[1]),
            (x * b, exact[0] * exact[1]),
            (a - y, exact[0] - exact[1]),
            (x * x, exact[0] * exact[0]),
        ):
            assert Fraction(result.low) <= wanted <= Fraction(result.high)
            # and is not much wider than that: 4 roundings of the result, or the smallest normal number
            assert result.high - result.low <= 2.0**-50 * max(abs(result.low), abs(result.high)) + 1e-307


def test_an_interval_holds_the_function_of_every_number_in_it() -> None:
    low = RNG.uniform(-20.0, 20.0, (2, 400))
    wide = RNG.uniform(0.0, 1.0, (2, 400)) * 10.0 ** RNG.uniform(-9, 1, 400)
    enclosed = composed(Interval(low[0], low[0] + wide[0]), Interval(low[1], low[1] + wide[1]))
    for share in RNG.uniform(0.0, 1.0, (60, 2, 1)):
        value = composed(low[0] + share[0] * wide[0], low[1] + share[1] * wide[1])
        assert np.all((enclosed.low <= value) & (value <= enclosed.high))
    # narrow ones stay narrow: the slope of (y - 1/2) cos(x y) x is below 20 (20)² here, and counts in two variables
    assert np.max((enclosed.high - enclosed.low)[wide.max(axis=0) < 1e-6]) < 1.6e-2


@pytest.mark.parametrize("turns", [-3, 0, 5])
def test_sine_and_cosine_reach_one_where_their_peaks_lie(turns: int) -> None:
    for peak, wave in ((0.25, 0), (0.0, 1)):
        place = 2.0 * math.pi * (turns + peak)
        assert Interval(place - 0.1, place + 0.1).sine_cosine[wave].high == 1.0
        assert Interval(place + math.pi - 0.1, place + math.pi + 0.1).sine_cosine[wave].low == -1.0
        beside = Interval(place + 0.1, place + 0.2).sine_cosine[wave]
        # narrower than the peak by the slope there: nothing is given away
        assert beside.high == pytest.approx(math.cos(0.1), abs=1e-12)
        assert beside.low == pytest.approx(math.cos(0.2), abs=1e-12)


def test_a_square_is_not_negative_and_a_product_of_equals_may_be() -> None:
    x = Interval(-1.0, 2.0)
    assert (x * x).low == 0.0
    assert (x * Interval(-1.0, 2.0)).low < -1.9


def test_the_series_of_intervals_encloses_all_series() -> None:
    terms = RNG.uniform(-1.0, 1.0, (2, 4))
    enclosed = composed(*(Taylor(*(Interval.around(term, 1e-3) for term in row)) for row in terms))
    for _ in range(200):
        moved = terms + 1e-3 * RNG.uniform(-1.0, 1.0, terms.shape)
        one = composed(Taylor(*moved[0]), Taylor(*moved[1]))
        assert all(i.low <= term <= i.high for i, term in zip(enclosed.terms, one.terms, strict=True))
