"""The judgment of the loop by hand, in words and as marks: each limit with the place that decides it, and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.figures.of_loops import COMPLIANCE_PEAK, GAIN_MARGIN, SENSITIVITY_PEAK
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.text import joined, resolve
from feeddrive.plot.chart import ALERT, Chart, Level, Mark, Note
from feeddrive.tuning.by_hand import Look, Verdict
from feeddrive.tuning.criteria import Limits


def verdict_words(look: Look, limits: Limits, units: Units) -> list[dict[str, Any]]:
    """Return each limit in a sentence, the most exhausted first, and if it is kept."""
    several, sentences = len(look.figures) > 1, list[dict[str, Any]]()
    for verdict in look.judged:
        where = f" ({verdict.point})" if several else ""
        at = "" if verdict.frequency is None else f" at {units.value_text(verdict.frequency, 'Hz')}"
        text = f"{verdict.judged.text}{at}{where}, limit: {limits.text(verdict.judged.limit)}"
        sentences.append({"text": resolve(text, units), "keeps": verdict.keeps})
    return sentences


def figure_words(look: Look, units: Units) -> str:
    """Return crossover, margins and the least stiffness of the leading operating point, with their frequencies."""
    leading, parts = look.leading, list[str]()
    margins = leading.margins
    if margins.crossover is not None:
        least = min(margins.gain_crossovers, key=lambda crossing: abs(crossing.phase_margin_deg))
        where = "" if least is margins.gain_crossovers[0] else f" at {Quantity(least.frequency, 'Hz')}"
        phase = Quantity(least.phase_margin_deg, "deg", form="3")
        parts.append(f"crossover {Quantity(margins.crossover, 'Hz')}, phase margin {phase}{where}")
    if margins.gain_increase_dB is not None:
        parts.append(f"the gain may rise by {units.gain_text(margins.gain_increase_dB)}")
    if look.stable:
        stiff = leading.stiffness
        against = " against a force at the drive" if leading.at_drive else ""
        least, where = Quantity(stiff.minimum, "N/m"), Quantity(stiff.minimum_frequency, "Hz")
        parts.append(f"least stiffness{against} {least} at {where}")
    return joined("; ", parts).shown(units)


def with_verdicts(drawn: Mapping[str, Chart], look: Look, limits: Limits, units: Units) -> dict[str, Chart]:
    """Add the limits of Ms and stiffness as lines to the pictures, and mark exceeded limits."""
    charts, lines = dict(drawn), dict[str, Level]()
    if (peak := limits.limit(SENSITIVITY_PEAK)) is not None:
        lines["sensitivity"] = Level(_gain(units, peak.bound), peak.text.shown(units), dashed=True)
    if (largest := limits.bound(COMPLIANCE_PEAK)) is not None:
        text = f"stiffness >= {units.value_text(1.0 / largest, 'N/m')}"
        least = units.of("N/m")[1] / largest
        lines["stiffness"] = Level(least, resolve(text, units), dashed=True)
    for name, line in lines.items():
        if name in charts:
            first, *rest = charts[name].panels
            charts[name] = replace(charts[name], panels=(replace(first, levels=(*first.levels, line)), *rest))
    for verdict in look.judged if look.stable else ():
        place = _place(verdict, units)
        if not verdict.keeps and place is not None and place[0] in charts and verdict.point == look.leading.point:
            name, x, y = place
            note = Note(x, y, verdict.judged.text.shown(units), ALERT)
            mark = Mark(x, y, ALERT)
            first, *rest = charts[name].panels
            first = replace(first, notes=(*first.notes, note), marks=(*first.marks, mark))
            charts[name] = replace(charts[name], panels=(first, *rest))
    return charts


def _gain(units: Units, ratio: float) -> float:
    return float(units.from_decibel(20.0 * float(np.log10(ratio))))


def _place(verdict: Verdict, units: Units) -> tuple[str, float, float] | None:
    """Return the picture that shows a figure, and the position in its first panel."""
    value = verdict.judged.value
    if value is None or verdict.frequency is None:
        return None
    x = units.of("Hz")[1] * verdict.frequency
    figure = verdict.judged.figure
    if figure == SENSITIVITY_PEAK:
        return "sensitivity", x, _gain(units, value)
    if figure == COMPLIANCE_PEAK:
        return "stiffness", x, units.of("N/m")[1] / value
    return "open_loop", x, float(units.from_decibel(-value if figure == GAIN_MARGIN else 0.0))
