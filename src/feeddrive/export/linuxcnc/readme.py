"""The README of an export for LinuxCNC: what to do, in which order, and what can go wrong with a real machine."""

from __future__ import annotations

from collections.abc import Mapping

from feeddrive.export.linuxcnc import controller, names
from feeddrive.export.linuxcnc.limits import Limits
from feeddrive.export.linuxcnc.names import Item, hal
from feeddrive.export.linuxcnc.texts import filled
from feeddrive.loop.routine import Routine


def readme(routine: Routine, plant: Routine, joint: int, limit: Limits, title: str, made_by: str) -> str:
    """The text, as Markdown."""
    tuned = {names.parameter(v): v.value for v in routine.parameters}
    return filled(
        "README.md",
        title=title, made_by=made_by, P=routine.name, plant=plant.name, hal=hal(routine.name), joint=joint,
        period=names.period(routine), tolerance=controller.tolerance(routine),
        late=controller.LATE * names.period(routine), velocity=f"{1e3 * limit.velocity:.9g}",
        acceleration=f"{1e3 * limit.acceleration:.9g}", ferror=f"{1e3 * limit.following_error:.9g}",
        pins=_table(dict.fromkeys(controller.pins(routine))),
        own=_table(controller.settings(routine)), tuned=_table(tuned),
        rules="\n".join(f"| {code} | {names.plain(text)} |" for code, text in routine.sentences.items()),
        codes="\n".join(f"| {code} | {word} |" for code, word in controller.FAULTS.items()),
    )  # fmt: skip


def _table(items: Mapping[Item, float | None]) -> str:
    """Rows of pins or of parameters."""
    rows: list[str] = []
    for item, value in items.items():
        kind = f"{item.type} {item.direction}" if value is None else f"{value!r}"
        rows.append(f"| `{item.name}` | {kind} | {item.meaning.replace('|', chr(92) + '|')} |")
    return "\n".join(rows)
