"""The history of a control: what each step of the undo list changed, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.text import Text
from feeddrive.studio.desk import Desk, Held
from feeddrive.tuning.filters import DEPTH, difference, filter_text, notch_shapes

SHOWN = 12  # steps back, and as many that were undone


class History:
    """The steps of one page in words; those of steps that are done are kept, since a drag asks for all of them."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._known: dict[tuple[Held, Held, Units], str] = {}

    def steps(self, units: Units) -> list[dict[str, Any]]:
        """Return the last steps, those that were undone first, then the present one and those before it.

        text   what the step changed
        steps  how many steps to undo to get there; negative: to redo
        """
        desk, here = self.desk, self.desk.held()
        later, earlier = [here, *reversed(desk.redo[-SHOWN:])], [*desk.undo[-SHOWN:], here]
        pairs = [(later[k], later[k + 1], -(k + 1)) for k in reversed(range(len(later) - 1))]
        pairs += [(earlier[-k - 2], earlier[-k - 1], k) for k in range(len(earlier) - 1)]
        words = {(before, after, units): self._known.get((before, after, units)) for before, after, _ in pairs}
        told = {key: step_words(*key) if text is None else text for key, text in words.items()}
        self._known = {key: text for key, text in told.items() if here not in key}
        rows = [{"text": told[before, after, units], "steps": count} for before, after, count in pairs]
        return [*rows, {"text": "Beginning", "steps": len(desk.undo)}] if len(desk.undo) <= SHOWN else rows


def step_words(before: Held, after: Held, units: Units) -> str:
    """Return what a step changed: `Kp 72000 → 76000 N s/m`, `notch 456 Hz added`."""
    if before.bench.by_hand is after.bench.by_hand:
        changed = [name for name, value in after.values.items() if before.values.get(name) != value]
        if changed:
            return _changed(changed, before, after, units)
    new, gone = _apart(before.off, after.off), _apart(after.off, before.off)
    if new and gone and before.bench.by_hand is after.bench.by_hand:
        return f"{filter_text(gone[0], units)} → {filter_text(new[0], units)}, off"
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
    if all(name.rpartition(".")[2].startswith("damping") for name in names) and (shape := _shape(before, after, units)):
        return shape
    if len(names) > 1:
        return ", ".join(short[:3]) + (" ..." if len(short) > 3 else "")
    (name,) = names
    unit = tree.declaration(after.control, name).unit
    old, new = before.values[name], after.values[name]
    # the unit once, at the end
    text = Text(f"{short[0]} {Quantity(old, unit, bare=True)} → {Quantity(new, unit)}")
    return text.shown(units)


def _shape(before: Held, after: Held, units: Units) -> str:
    """Return the depth or width of a notch that changed: `notch depth 20 → 26 dB`; empty if both or none did."""
    old, new = notch_shapes(before.control), notch_shapes(after.control)
    # dragged dampings have 4 digits
    changed = [name for name, value in new.items() if abs(value - old.get(name, value)) > 2e-3 * abs(value)]
    if len(changed) != 1:
        return ""
    (name,) = changed
    part = name.rpartition(".")[2]
    unit = "dB" if part == DEPTH else "Hz"
    return Text(f"notch {part} {Quantity(old[name], unit, bare=True)} → {Quantity(new[name], unit)}").shown(units)
