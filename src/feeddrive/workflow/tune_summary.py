"""All figures of a tuning as plain numbers, for summary.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from feeddrive.language.quantity import USUAL, Quantity
from feeddrive.tuning.closed_loop import Figures, reported
from feeddrive.tuning.recipes import JudgedRecipe
from feeddrive.tuning.tune import Tuned


def summary(found: Tuned, said: Sequence[str], rules: Sequence[JudgedRecipe]) -> dict[str, Any]:
    """All figures as plain numbers; what does not occur is null.

    said, rules  remarks and rules of the trade beside the tuning
    """
    return {
        "rule": found.rule,
        "recommendation": found.recommendation(),
        "holds": found.holds,
        "tunables": dict(found.tunables),
        "today": {name: None if math.isnan(value) else value for name, value in found.started.items()},
        "figures": {
            name: {each.point: _plain(each) for each in row}
            for name, row in (("today", found.before), ("new", found.after))
        },
        "held_back_by": [
            {"what": h.what, "point": h.point, "frequency_Hz": h.frequency, "gain_percent": h.gain} for h in found.held
        ],
        "against": "a force at the drive" if found.at_drive else "a force on the table",
        "remarks": [*said, *found.advice],
        "rules": {
            rule.name: {"reason": rule.reason, "figures": {each.point: _plain(each) for each in rule.figures}}
            for rule in rules
        },
        "standard_deviations_kept": found.sure,
        "probability_that_all_limits_hold": found.confidence,
        "proof": {line.what: {"holds": line.holds, "said": line.said} for line in found.proof},
    }


def _usual(quantity: Quantity | None) -> float | None:
    """Return a value in the unit that it is usually read in, which these files have had from the first on."""
    return None if quantity is None else USUAL.of(quantity.unit)[1] * float(quantity.value)


def _plain(each: Figures) -> dict[str, float | bool | None]:
    values = {
        figure.label or figure.title: _usual(figure.quantity(figure.read(each))) if each.stable else None
        for figure in reported()
    }
    return {"stable": each.stable, **{k: None if v is None or not math.isfinite(v) else v for k, v in values.items()}}
