"""The history of a control: what each step of the undo list changed, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.text import Text
from feeddrive.studio.desk import Desk, Held
from feeddrive.tuning.filters import difference, filter_text

SHOWN = 12  # steps back, and as many that were undone


def steps(desk: Desk, units: Units) -> list[dict[str, Any]]:
    """Return the last steps, those that were undone first, then the present one and those before it.

    text   what the step changed
    steps  how many steps to undo to get there; negative: to redo
    """
    here, undone, done = desk.held(), desk.redo[-SHOWN:], desk.undo[-SHOWN:]
    later = [here, *reversed(undone)]
    rows = [
        {"text": step_words(later[k], later[k + 1], units), "steps": -(k + 1)} for k in reversed(range(len(later) - 1))
    ]
    earlier = [*done, here]
    rows += [
        {"text": step_words(earlier[k], earlier[k + 1], units), "steps": len(earlier) - 2 - k}
        for k in reversed(range(len(earlier) - 1))
    ]
    begun = {"text": "Beginning", "steps": len(done)} if len(desk.undo) <= SHOWN else None
    return rows if begun is None else [*rows, begun]


def step_words(before: Held, after: Held, units: Units) -> str:
    """Return what a step changed: `Kp 72000 → 76000 N s/m`, `notch 456 Hz added`."""
    if before.bench.by_hand is after.bench.by_hand:
        changed = [name for name, value in after.values.items() if before.values.get(name) != value]
        if changed:
            return _changed(changed, before, after, units)
    new, gone = _apart(before.off, after.off), _apart(after.off, before.off)
    if new:
        return f"{filter_text(new[0], units)} off"
    changes = difference(before.control, after.control)
    if changes is None:
        one, other = (held.control.law.kind.replace("_", " ") for held in (before, after))
        return f"{one} → {other}" if one != other else "another control"
    if changes.added:
        word = "on" if gone else "added"
        return f"{filter_text(changes.added[0], units)} {word}"
    if changes.removed:
        return f"{filter_text(before.control.filters[changes.removed[0]], units)} removed"
    if gone:
        return f"{filter_text(gone[0], units)} removed"
    return _changed(list(changes.values), before, after, units) if changes.values else "same numbers"


def _apart(few: Sequence[Any], many: Sequence[Any]) -> list[Any]:
    """Return the filters of `many` that `few` does not have."""
    left, apart = list(few), list[Any]()
    for block in many:
        if block in left:
            left.remove(block)
        else:
            apart.append(block)
    return apart


def _changed(names: list[str], before: Held, after: Held, units: Units) -> str:
    short = [name.rpartition(".")[2].replace("_", " ") for name in names]
    if len(names) > 1:
        return ", ".join(short[:3]) + (" ..." if len(short) > 3 else "")
    (name,) = names
    unit = tree.declaration(after.control, name).unit
    old, new = before.values[name], after.values[name]
    # the unit once, at the end
    text = Text(f"{short[0]} {Quantity(old, unit, bare=True)} → {Quantity(new, unit)}")
    return text.shown(units)
