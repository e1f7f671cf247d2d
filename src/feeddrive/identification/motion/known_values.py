"""Comparison of a log with known values: a weighed mass, a programmed feed, and the gains of the controller."""

from __future__ import annotations

import numpy as np

from feeddrive.identification.motion.identify import Identified
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.second_source import CLOCK, LEAST_FACTOR, MASS, Ratio, causes_of, said
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined

_WINDOW = 5e-3  # s: half of the time over which a speed is differenced, so that counts hardly affect it
_LEVEL = 0.01  # share of the top speed within which a speed is constant: a feed is reached, and held, to that
_HELD = 0.05  # s at the top speed that are needed: shorter, the peak of a move that never reached its feed
_QUANTILE = 0.98  # of the moving rows: the top speed is that of a log with one tenth of its time at it, or more


def against_known(
    found: Identified, mass: float | None = None, feed: float | None = None, sample_time: float | None = None
) -> tuple[list[Text], list[Text]]:
    """Return contradictions between known values and the clock or scales of a log, and remarks on confirmed values.

    mass         weighed mass, kg; for a rotary axis the inertia, kg m2
    feed         programmed speed of the motion, m/s or rad/s
    sample_time  sample time in the machine file, s

    The gains of a stated law are a second source, too: a wrong clock changes the gains required by the log in a known
    pattern.
    """
    log = found.log
    ratios: dict[str, tuple[Ratio | None, Text]] = {}
    remarks: list[Text] = []
    if mass is not None:
        value = found.mass
        ratio = Ratio.of(MASS, value.unit, value.value, mass, value.error / abs(value.value))
        stated = Quantity(mass, value.unit)
        ratios["mass"] = ratio, Text(f"the mass comes out as {value.quantity}, where {stated} is stated")
    if feed is not None:
        reached = top_speed(log)
        unit = log.frame.velocity
        if reached is None:
            remarks.append(
                Text(
                    f"{log.name}: no constant speed is held for {Quantity(_HELD, 's')}, so that the feed of "
                    f"{Quantity(feed, unit)} cannot be compared"
                )
            )
        else:
            text = Text(f"the top speed is {Quantity(reached, unit)}, where a feed of {Quantity(feed, unit)} is stated")
            ratios["feed"] = Ratio.of("top speed", unit, reached, feed), text
    against = _by_values(log, ratios)
    if not against and ratios:
        remarks.append(
            Text(f"clock and scales agree with what is known: {joined('; ', (text for _, text in ratios.values()))}")
        )
    return [*against, *_by_clock(log, sample_time), *_by_gains(found)], remarks


def _by_clock(log: MotionLog, sample_time: float | None) -> list[Text]:
    """Return a contradiction between the sample times of machine file and log, which may omit rows."""
    if sample_time is None:
        return []
    times = log.sample_time / sample_time
    whole = max(1.0, round(times)) if times >= 1.0 - LEAST_FACTOR else 1.0 / max(1.0, round(1.0 / times))
    if abs(times / whole - 1.0) <= LEAST_FACTOR:
        return []
    return [
        Text(
            f"{log.name}: the machine file has a sample time of {Quantity(sample_time, 's')}, and the rows of the log "
            f"are {Quantity(log.sample_time, 's')} apart: the clock of one of them is wrong (--time, --sample-time)"
        )
    ]


def _by_values(log: MotionLog, ratios: dict[str, tuple[Ratio | None, Text]]) -> list[Text]:
    """Return the causes that explain all known values together or, if there are none, each value separately."""
    whole = list(ratios.values())
    groups = [whole] if causes_of(ratio for ratio, _ in whole) else [[one] for one in whole]
    texts: list[Text] = []
    for group in groups:
        causes = causes_of(ratio for ratio, _ in group)
        if causes:
            told = joined(", and ", (text for _, text in group))
            texts.append(Text(f"{log.name}: {told}: {said(causes, log.name, log.sample_time)}"))
    return texts


def top_speed(log: MotionLog) -> float | None:
    """Return the largest speed that is kept constant for some time, m/s or rad/s; None if there is none.

    The speed is computed from the set position if there is one, since it does not overshoot.
    """
    position = log.position if log.set_position is None else log.set_position
    half = max(1, round(_WINDOW / log.sample_time))
    speed = np.abs(position[2 * half :] - position[: -2 * half]) / (2.0 * half * log.sample_time)
    if not np.any(speed):
        return None
    top = float(np.quantile(speed[speed > _LEVEL * np.max(speed)], _QUANTILE))
    held = np.abs(speed - top) < _LEVEL * top
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    # of one stretch: many short peaks of the same height are no feed that was reached
    if np.max(edges[1::2] - edges[::2]) * log.sample_time < _HELD:
        return None
    return float(np.median(speed[held]))


def _by_gains(found: Identified) -> list[Text]:
    """Return the evidence of a stated law's gains against the clock: at least two gains must follow its pattern."""
    check, loop = found.law, found.loop
    if check is None or loop is None or found.control is not None:
        return []
    control = loop.control
    ratios = []
    for gain in check.gains:
        name = gain.name.partition("control.")[2]
        # gains without a unit are in those of their maker, and tell no pattern
        unit = tree.declaration(control, name).unit if name else ""
        if unit:
            ratios.append(Ratio.of(name, unit, gain.needed, gain.stated, gain.error / abs(gain.stated)))
    causes = causes_of(ratios)
    if not causes or causes[0].kind != CLOCK or len(causes[0].shown) < 2:
        return []
    names = joined(" and ", causes[0].shown)
    text = said(causes[:1], found.log.name, found.log.sample_time)
    return [
        Text(f"{found.log.name}: the law that is stated made the force of the log with other {names}, as if {text}")
    ]
