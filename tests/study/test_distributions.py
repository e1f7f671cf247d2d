"""Distributions as quantile functions, against those of scipy.stats."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from feeddrive.language.errors import ParameterError
from feeddrive.study.distributions import Discrete, Distribution, LogNormal, LogUniform, Normal, Triangular, Uniform

U = np.array([1e-9, 1e-3, 0.1, 0.5, 0.73, 0.999, 1.0 - 1e-9])
PAIRS = {
    "uniform": (Uniform(2.0, 5.0), stats.uniform(2.0, 3.0)),
    "loguniform": (LogUniform(0.1, 10.0), stats.loguniform(0.1, 10.0)),
    "normal": (Normal(3.0, 0.5), stats.norm(3.0, 0.5)),
    "normal, truncated": (Normal(3.0, 0.5, 2.5, 4.5), stats.truncnorm(-1.0, 3.0, 3.0, 0.5)),
    "normal, one tail": (Normal(0.0, 1.0, 4.0, 5.0), stats.truncnorm(4.0, 5.0)),
    "lognormal": (LogNormal(2.0, math.e), stats.lognorm(1.0, scale=2.0)),
    "triangular": (Triangular(1.0, 2.0, 5.0), stats.triang(0.25, 1.0, 4.0)),
    "triangular, mode at its end": (Triangular(1.0, 5.0, 5.0), stats.triang(1.0, 1.0, 4.0)),
}


@pytest.mark.parametrize("name", PAIRS)
def test_quantiles_are_those_of_scipy(name: str) -> None:
    own, theirs = PAIRS[name]
    # both lose digits where 1 - u is small
    assert own.at(U) == pytest.approx(theirs.ppf(U), rel=1e-7)


def test_a_truncated_lognormal_keeps_the_share_of_the_whole() -> None:
    own, whole = LogNormal(2.0, 1.5, 1.0, 4.0), stats.lognorm(math.log(1.5), scale=2.0)
    inside = whole.cdf(4.0) - whole.cdf(1.0)
    assert own.at(U) == pytest.approx(whole.ppf(whole.cdf(1.0) + U * inside), rel=1e-9)


def test_values_come_in_proportion_to_their_weights() -> None:
    u = (np.arange(1000) + 0.5) / 1000
    found = Discrete(("a", "b", "c"), (1.0, 0.0, 3.0)).at(u)
    assert [int(np.sum(found == each)) for each in "abc"] == [250, 0, 750]
    assert Discrete((1.0, 2.0)).at(u).dtype == np.float64


BAD = {
    "uniform the wrong way": (lambda: Uniform(2.0, 1.0), "least = 2 of a uniform distribution must be < most = 1"),
    "uniform without end": (lambda: Uniform(0.0, math.inf), "needs least and most, or a tolerance"),
    "loguniform from 0": (lambda: LogUniform(0.0, 1.0), "least = 0 of a loguniform distribution must be"),
    "no deviation": (lambda: Normal(1.0, 0.0), "deviation = 0 of a normal distribution must be a finite number > 0"),
    "out of reach": (lambda: Normal(0.0, 1.0, 9.0, 10.0), "more than 6 deviations from its middle"),
    "ratio 1": (lambda: LogNormal(1.0, 1.0), "ratio = 1 of a lognormal distribution must be > 1"),
    "mode outside": (lambda: Triangular(1.0, 0.5, 2.0), "must be in 1..2"),
    "no values": (lambda: Discrete(()), "at least one entry"),
    "too few weights": (lambda: Discrete((1.0, 2.0), (1.0,)), "1 weights for 2 values"),
    "a weight below 0": (lambda: Discrete((1.0, 2.0), (1.0, -1.0)), "weights must be finite numbers >= 0"),
}


@pytest.mark.parametrize("name", BAD)
def test_impossible_distributions_are_refused(name: str) -> None:
    make, said = BAD[name]
    with pytest.raises(ParameterError) as found:
        make()
    assert said in str(found.value)


@pytest.mark.parametrize("name", PAIRS)
def test_ranges_hold_all_values(name: str) -> None:
    own: Distribution = PAIRS[name][0]
    low, high = own.range()
    assert np.all((own.at(U) >= low) & (own.at(U) <= high))
