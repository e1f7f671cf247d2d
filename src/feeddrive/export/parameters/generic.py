"""A CSV for other makers: every value in SI, at the table and at the shaft, and in common units."""

from __future__ import annotations

import csv
import io

from feeddrive.export.parameters.quantities import QUANTITIES, Cascade, DriveTrain, at_shaft
from feeddrive.language import tree, units
from feeddrive.language.block import Block, declarations

HEAD = ("name", "value", "unit", "meaning", "SI value", "SI unit")
_MEANINGS = {
    "Kv": "position gain: velocity per following error",
    "Kp": "velocity gain: force or torque per velocity",
    "Kp/Tn": "integral gain of the velocity loop",
    "Tn": "integral time of the velocity loop",
    "velocity_feedforward": "share of the set velocity that is fed forward",
    "mass": "mass or inertia that is fed forward",
    "viscous": "viscous friction that is fed forward",
    "force_limit": "largest force or torque",
    "following_error_limit": "following error that trips",
    "velocity_limit": "speed that trips",
    "travel_least": "lower end of the travel",
    "travel_most": "upper end of the travel",
    "weight": "force or torque that carries a hanging axis",
    "lead": "table motion in one turn of the screw",
    "gear": "turns of the motor in one turn of the screw",
}
_COMMON = {
    "Kv": (("(m/min)/mm", "m_per_min_per_mm"),),
    "Tn": (("ms", "ms"),),
    "following_error_limit": (("mm", "mm"),),
    "travel_least": (("mm", "mm"),),
    "travel_most": (("mm", "mm"),),
    "lead": (("mm", "mm"),),
}
_AT_SHAFT = {"velocity_limit": ("rpm",)}


def csv_text(cascade: Cascade, train: DriveTrain | None, head: list[str]) -> str:
    """The file: comment lines with `#`, then a head and a row for each number."""
    out = io.StringIO()
    for line in head:
        out.write(f"# {line}".rstrip() + "\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEAD)
    linear = DriveTrain(None)
    shaft = train if train is not None and train.rotary else None
    for quantity, meaning in _MEANINGS.items():
        kind = QUANTITIES[quantity]
        place = shaft if shaft is not None and quantity in ("lead", "gear") else linear
        value = at_shaft(cascade, place, quantity, kind.table)
        if value is None:
            continue
        si = (repr(float(value)), kind.table)
        writer.writerow([quantity, f"{value:.9g}", kind.table, meaning, *si])
        for unit, measure in _COMMON.get(quantity, ()):
            writer.writerow([quantity, f"{value / units.factor(measure, kind.table):.9g}", unit, meaning, *si])
        if shaft is None or not kind.power:
            continue
        for unit in (kind.shaft, *_AT_SHAFT.get(quantity, ())):
            turned = at_shaft(cascade, shaft, quantity, unit)
            writer.writerow([f"{quantity} at the motor", f"{turned:.9g}", unit, meaning, *si])
    for i, block in enumerate(cascade.loop.control.filters):
        for name, value in tree.leaves(block):
            unit, meaning = _declared(block, name)
            label = f"filters.{i} {block.kind}.{name}"
            writer.writerow([label, f"{value:.9g}", unit, meaning, repr(float(value)), unit])
    return out.getvalue()


def _declared(block: Block, name: str) -> tuple[str, str]:
    declared = declarations(type(block))[name]
    return declared.unit, declared.meaning
