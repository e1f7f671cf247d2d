"""The figures of a tuning as plain numbers, for summary.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from feeddrive.language.quantity import USUAL, Quantity
from feeddrive.tuning.closed_loop import Figures, reported
from feeddrive.tuning.recipes import JudgedRecipe
from feeddrive.tuning.tune import Tuned


def summary(tuned: Tuned, remarks: Sequence[str], rules: Sequence[JudgedRecipe]) -> dict[str, Any]:
    """Return all figures as plain numbers; a figure that does not occur is null.

    remarks, rules  of the tuning, and of the trade beside it
    """
    return {
        "rule": tuned.rule,
        "recommendation": tuned.recommendation(),
        "holds": tuned.holds,
        "tunables": dict(tuned.tunables),
        "today": {name: None if math.isnan(value) else value for name, value in tuned.started.items()},
        "figures": {
            name: {figures.point: _plain(figures) for figures in row}
            for name, row in (("today", tuned.before), ("new", tuned.after))
        },
        "held_back_by": [
            {"what": h.what, "point": h.point, "frequency_Hz": h.frequency, "gain_percent": h.gain} for h in tuned.held
        ],
        "against": "a force at the drive" if tuned.at_drive else "a force on the table",
        "remarks": [*remarks, *tuned.advice],
        "rules": {
            rule.name: {"reason": rule.reason, "figures": {figures.point: _plain(figures) for figures in rule.figures}}
            for rule in rules
        },
        "standard_deviations_kept": tuned.sure,
        "probability_that_all_limits_hold": tuned.confidence,
        "proof": {line.what: {"holds": line.holds, "said": line.text} for line in tuned.proof},
    }


def _usual(quantity: Quantity | None) -> float | None:
    """Return a value in the unit that it is usually read in, which these files have had from the first on."""
    return None if quantity is None else USUAL.of(quantity.unit)[1] * float(quantity.value)


def _plain(figures: Figures) -> dict[str, float | bool | None]:
    values = {
        figure.label or figure.title: _usual(figure.quantity(figure.read(figures))) if figures.stable else None
        for figure in reported()
    }
    return {
        "stable": figures.stable,
        **{k: None if v is None or not math.isfinite(v) else v for k, v in values.items()},
    }
