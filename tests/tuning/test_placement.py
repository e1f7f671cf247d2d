"""Placed poles on a real axis: gains and poles, and how far they may go."""

from __future__ import annotations

import dataclasses
import re

import pytest

import feeddrive as fd
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.papers.gordon2013.testbed import cascade, placed


def with_law(**changes: float) -> fd.Loop:
    loop = placed()
    law = fd.vary(loop.control.law, changes)
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, law=law))


def test_poles_as_placed_are_those_asked_for() -> None:
    found = fd.tuning.placement(placed())
    assert found.poles[0] == pytest.approx(-314.159, rel=1e-5)
    assert found.stability.stable
    assert "K1" in str(found)


def test_unstable_gains_are_refused_with_the_nearest_stable_value() -> None:
    with pytest.raises(UnstableError, match="must be < 1") as refused:
        fd.tuning.placement(with_law(bandwidth=150.0))
    near = float(re.findall(r"bandwidth = ([0-9.]+) Hz instead of 150", str(refused.value))[0])
    # four digits are shown: a little below it is stable, a little above it is not
    assert fd.stability(with_law(bandwidth=0.999 * near)).stable
    assert not fd.stability(with_law(bandwidth=1.001 * near)).stable


def test_another_law_has_no_placed_poles() -> None:
    with pytest.raises(ParameterError, match="cascade_ppi"):
        fd.tuning.placement(cascade())
