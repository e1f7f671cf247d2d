"""Triggers: instants against a plain state machine and against closed forms, in any pieces."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.analysis.oscilloscope import FALLING, RISING, Crossings, Trigger
from feeddrive.language.errors import ParameterError

# few different values, so that samples at the level and at the edge of the hysteresis are common; NaN is a gap
VALUES = st.lists(st.one_of(st.integers(-3, 3).map(float), st.just(math.nan)), max_size=40)


def one_by_one(values: list[float], trigger: Trigger) -> list[float]:
    """The definition, a sample at a time: sample k stands at k s."""
    sign = 1.0 if trigger.edge == RISING else -1.0
    level, armed, found = sign * trigger.level, False, list[float]()
    before = math.nan
    for k, value in enumerate(values):
        now = sign * value
        if math.isnan(now):
            armed = False
        elif now >= level:
            if armed:
                found.append(k - 1 + (level - before) / (now - before))
            armed = False
        elif now <= level - trigger.hysteresis:
            armed = True
        before = now
    return found


@given(VALUES, st.sampled_from([RISING, FALLING]), st.integers(-2, 2), st.sampled_from([0.0, 0.5, 1.0, 2.0]), st.data())
def test_instants_are_those_of_the_definition_however_the_signal_is_cut(
    values: list[float], edge: str, level: int, hysteresis: float, data: st.DataObject
) -> None:
    trigger = Trigger("x", float(level), edge, hysteresis)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(values)), max_size=4)))
    pieces = np.split(np.arange(len(values)), cuts)
    crossings, rows = Crossings(trigger), np.array(values, dtype=np.float64)
    found = [t for piece in pieces for t in crossings.take(piece.astype(np.float64), rows[piece]).tolist()]
    assert found == pytest.approx(one_by_one(values, trigger))


def test_a_sine_passes_its_level_when_it_does() -> None:
    """Of a sin(w t) at asin(level/a)/w + n T; a straight line between samples errs by a quarter of w² h² a / 2."""
    a, w, h, level = 2.0, 2.0 * math.pi, 1e-3, 0.7
    time = np.arange(5000) * h
    for edge, first in ((RISING, math.asin(level / a) / w), (FALLING, 0.5 - math.asin(level / a) / w)):
        found = Crossings(Trigger("x", level, edge)).take(time, a * np.sin(w * time))
        slope = w * math.sqrt(a * a - level * level)
        np.testing.assert_allclose(found, first + np.arange(5), atol=w * w * h * h * a / 8.0 / slope)


def test_noise_at_the_level_counts_once_with_hysteresis() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(20_000) * 1e-4
    y = np.sin(2.0 * np.pi * 2.0 * time) + rng.uniform(-0.05, 0.05, time.size)
    assert Crossings(Trigger("x", 0.1)).take(time, y).size > 4
    assert Crossings(Trigger("x", 0.1, hysteresis=0.11)).take(time, y).size == 4  # 2 Hz for 2 s


@pytest.mark.parametrize(
    ("given_", "reason"),
    [
        ({"level": math.nan}, "level = nan"),
        ({"edge": "up"}, "must be rising or falling"),
        ({"hysteresis": -1.0}, "hysteresis = -1 of the trigger must be >= 0"),
        ({"hold": math.inf}, "hold = inf s of the trigger"),
    ],
)
def test_what_is_no_trigger_is_refused(given_: dict[str, float], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        Trigger("x", **given_)  # type: ignore[arg-type]
