"""The status strip of the Tune page: the figures that decide, each beside its limit and the figure of today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.of_loops import (
    COMPLIANCE_PEAK,
    CROSSOVER,
    DELAY_MARGIN,
    GAIN_MARGIN,
    PHASE_MARGIN,
    ROPE_SNAP,
    SENSITIVITY_PEAK,
    STIFFNESS_LEAST,
)
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.text import Text, resolve
from feeddrive.language.units import rounded
from feeddrive.tuning.by_hand import Look
from feeddrive.tuning.criteria import Limits

NEAR = 0.95  # a limit of which more than this share is used up is said to be near
KEPT, CLOSE, BROKEN, FREE = "kept", "close", "broken", "free"
"""States of a figure: its limit is kept, kept with less than 5 % left, or broken; or it has no limit."""


class Gauge(NamedTuple):
    """A figure of the strip, and the figure whose limit applies to it: that of the stiffness is one of compliance."""

    title: str
    figure: Figure
    limited: Figure | None = None


GAUGES = (
    Gauge("Ms", SENSITIVITY_PEAK, SENSITIVITY_PEAK),
    Gauge("Phase margin", PHASE_MARGIN, PHASE_MARGIN),
    Gauge("Gain margin", GAIN_MARGIN, GAIN_MARGIN),
    Gauge("Delay margin", DELAY_MARGIN, DELAY_MARGIN),
    Gauge("Crossover", CROSSOVER),
    Gauge("Least stiffness", STIFFNESS_LEAST, COMPLIANCE_PEAK),
    Gauge("Rope-snap error", ROPE_SNAP),
)


LIMITED: Mapping[str, Gauge] = {gauge.figure.key: gauge for gauge in GAUGES if gauge.limited is not None}
"""The figures of the strip that can have a limit, by their keys."""


def with_limit(goal: Mapping[str, Any], gauge: Gauge, bound: float | None) -> dict[str, Any]:
    """Return the settings of a goal with another limit of a figure of the strip, in the unit of the figure.

    bound  None: as without a setting, which is no limit, or the usual one of Ms
    """
    assert gauge.limited is not None
    assert gauge.limited.limit is not None
    option = gauge.limited.limit.option
    settings = {key: value for key, value in goal.items() if key != option}
    if bound is None:
        return settings
    if gauge.limited is COMPLIANCE_PEAK:
        if not bound > 0.0:
            raise ParameterError(f"{gauge.title} must be > 0, not {Quantity(bound, gauge.figure.unit):4}")
        bound = 1.0 / bound
    return {**settings, option: rounded(bound, 7)}


def strip(now: Look, today: Look, limits: Limits, units: Units) -> list[dict[str, Any]]:
    """Return the figures of the strip in the displayed units, each at its worst operating point.

    value, unit, today  numbers as text; a dash for a figure that does not exist, as in an unstable loop
    limit               the limit in words, empty if there is none; `used` is the share of it that is used up
    frequency           Hz, where the limit is closest; None if the figure has no such frequency
    option, bound       the field of the goal that holds the limit, and its value in the unit of the strip
    """
    return [_shown(gauge, now, today, limits, units) for gauge in GAUGES]


def _shown(gauge: Gauge, now: Look, today: Look, limits: Limits, units: Units) -> dict[str, Any]:
    figure, limited = gauge.figure, gauge.limited
    limit = None if limited is None else limits.limit(limited)
    value = _worst(figure, now)
    unit, factor = units.of(figure.unit)
    words = {
        "key": figure.key,
        "title": gauge.title,
        "meaning": figure.description,
        "unit": unit,
        "value": _number(value, factor),
        "today": _number(_worst(figure, today), factor),
        "higher": figure.higher,
        "option": "" if limited is None or limited.limit is None else limited.limit.option,
        "limit": "",
        "bound": "",
        "state": FREE,
        "used": 0.0,
        "frequency": None,
    }
    if limit is not None:
        bound = 1.0 / limit.bound if gauge.limited is COMPLIANCE_PEAK else limit.bound
        words |= {"bound": _number(bound, factor), "limit": f"{'≥' if figure.higher else '≤'} {_number(bound, factor)}"}
        words |= _state(limit, now)
    return words


def _state(limit: Limit, now: Look) -> dict[str, Any]:
    """Return the state of a limited figure, the share of the limit that is used up, and the frequency that decides."""
    found = next((each for each in now.judged if each.judged.figure == limit.figure), None) if now.stable else None
    if found is None:
        return {"state": BROKEN, "used": 1.0}
    state = (CLOSE if found.used > NEAR else KEPT) if found.keeps else BROKEN
    return {"state": state, "used": min(found.used, 1.0), "frequency": found.frequency}


def _worst(figure: Figure, look: Look) -> float | None:
    """Return a figure at the operating point where it is worst; None if no point has it, or the loop is unstable."""
    values = [figure.read(loop) for loop in look.figures] if look.stable else []
    known = [value for value in values if value is not None]
    return (min if figure.higher else max)(known, key=abs, default=None)


def _number(value: float | None, factor: float) -> str:
    return "–" if value is None else resolve(f"{Quantity(factor * value, '', form='3')}", Units())


def verdict_line(look: Look, limits: Limits, units: Units) -> tuple[str, str]:
    """Return the verdict in a few words, and the limit that decides, in a sentence.

    The words are `All limits kept`, `Not yet: two limits are broken`, `No limits`, or `Not stable`. Of several
    operating points it is `Look.leading` that decides.
    """
    if not look.stable:
        return "Not stable", "The loop oscillates without end: lower the gains, or undo."
    broken = [each for each in look.judged if not each.keeps]
    if not look.judged:
        return "No limits", "Set one by a click on a figure above."
    closest = look.judged[0]
    judged = closest.judged
    at = "" if closest.frequency is None else f" at {Quantity(closest.frequency, 'Hz', form='3')}"
    value = "does not exist" if judged.value is None else f"is {Quantity(judged.value, judged.figure.unit, form='3')}"
    title = judged.figure.title[:1].upper() + judged.figure.title[1:]
    sentence = Text(f"{title} {value}{at}, {limits.bound_text(judged.limit)}.")
    if not broken:
        return "All limits kept", sentence.shown(units)
    counted = f"{_COUNTS.get(len(broken), len(broken))} limits are" if len(broken) > 1 else "one limit is"
    return f"Not yet: {counted} broken", sentence.shown(units)


_COUNTS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}
