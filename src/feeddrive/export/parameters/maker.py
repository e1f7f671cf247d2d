"""The rows of a maker's file: names and units; ODrive's, and the CSV for all others."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from feeddrive.blocks.families import Filter
from feeddrive.export.parameters.quantities import QUANTITIES, Cascade, DriveTrain, LostPart, at_shaft
from feeddrive.language import tree, units
from feeddrive.language.block import Block
from feeddrive.language.declaration import declarations

NOT_CHECKED = "NOT CHECKED against a manual: name and unit are those in common use"


class Row(NamedTuple):
    """A parameter of a maker.

    unit      as the maker writes it, and `measure` the same for `language.units`
    source    manual and page; empty if no manual was available
    linear    name, unit and measure for a linear motor, where they differ
    scale     on top of the unit: -1 for a lower limit
    decimals  that the control keeps, and `most` the largest value that it takes
    """

    name: str
    quantity: str
    unit: str
    measure: str
    meaning: str
    source: str = ""
    linear: tuple[str, str, str] | None = None
    scale: float = 1.0
    decimals: int | None = None
    most: float | None = None


class Line(NamedTuple):
    """A number as a file has it, with its path in the machine file and its value in SI."""

    name: str
    text: str
    unit: str
    meaning: str
    path: str
    si: str
    source: str


class Filtered(NamedTuple):
    """The lines of a filter, or why the maker has none like it."""

    lines: tuple[Line, ...] = ()
    why: str = ""


@dataclass(frozen=True)
class Maker:
    """A control or drive: its rows, its filters, and how its files are written.

    notes    lines at the head of its file: which loop is meant, how the integral is switched off, and the like
    rotary   whether it supports rotary motors only
    held     kinds of items (`quantities.Item`) that it represents completely; `outside`: why not others
    filters  (filter, place among the filters, drive train) -> its lines
    """

    key: str
    title: str
    comment: str
    rows: Sequence[Row]
    held: Sequence[str]
    outside: Mapping[str, tuple[str, str]]
    filters: Callable[[Filter, int], Filtered]
    notes: Sequence[str] = ()
    rotary: bool = False
    always: Sequence[LostPart] = field(default_factory=tuple[LostPart, ...])


def lines_of(maker: Maker, cascade: Cascade, train: DriveTrain) -> tuple[list[Line], list[LostPart]]:
    """The numbers that a maker's file holds, and those that it cannot take."""
    lines: list[Line] = []
    lost: list[LostPart] = []
    for row in maker.rows:
        name, unit, measure = (row.name, row.unit, row.measure) if train.rotary or not row.linear else row.linear
        value = at_shaft(cascade, train, row.quantity, measure) if name else None
        if value is None:
            continue
        text = number(row.scale * value, row.decimals)
        path, si = QUANTITIES[row.quantity].path, in_si(cascade, train, row.quantity)
        problem = _problem(row, row.scale * value, text)
        if problem:
            lost.append(LostPart(path, f"{row.scale * value:.6g} {unit} in {name}", *problem))
        else:
            lines.append(Line(name, text, unit, row.meaning, path, si, row.source or NOT_CHECKED))
    for i, block in enumerate(cascade.loop.control.filters):
        lines += maker.filters(block, i).lines
    return lines, lost


def _problem(row: Row, value: float, text: str) -> tuple[str, str] | None:
    """Why a value cannot be entered, and what happens; None if it can."""
    if row.most is not None and abs(value) > row.most:
        return f"{row.name} takes at most {row.most:g}", "the loop cannot be set up there: the gain stays lower"
    if value != 0.0 and abs(float(text) - value) > 0.01 * abs(value):
        return f"{row.name} keeps {row.decimals} decimals", f"the value would be {text}, more than 1 % off"
    return None


def number(value: float, decimals: int | None = None) -> str:
    """Six significant digits, or the decimals that a control keeps."""
    return f"{value:.6g}" if decimals is None else f"{value:.{decimals}f}"


def in_si(cascade: Cascade, train: DriveTrain, quantity: str) -> str:
    """A quantity in SI at the table, to the last digit."""
    own = {"lead": train.lead, "gear": train.gear}
    value = own[quantity] if quantity in own else cascade.values[quantity]
    return f"{value!r} {QUANTITIES[quantity].table}".rstrip()


def filter_line(
    name: str, value: float, unit: str, meaning: str, path: str, source: str, decimals: int | None = None
) -> Line:
    """A number of a filter."""
    return Line(
        name, number(value, decimals), unit, meaning, path, f"{float(value)!r} {unit}".rstrip(), source or NOT_CHECKED
    )


_SOURCE = "odriverobotics/ODrive, Firmware/MotorControl/controller.hpp (firmware 0.5), the units beside the fields"
_NO_FILTER = "there is no filter between velocity controller and torque"
_CONFIG = "odrv0.axis0.controller.config"

ROWS = (
    Row(f"{_CONFIG}.pos_gain", "Kv", "(turn/s)/turn", "1/s", "position gain", _SOURCE),
    Row(f"{_CONFIG}.vel_gain", "Kp", "Nm/(turn/s)", "N m s/rev", "velocity gain", _SOURCE),
    Row(f"{_CONFIG}.vel_integrator_gain", "Kp/Tn", "Nm/(turn/s * s)", "N m/rev", "Kp/Tn", _SOURCE),
    Row(f"{_CONFIG}.vel_limit", "velocity_limit", "turn/s", "rev/s", "speed limit of the velocity command"),
    Row("odrv0.axis0.motor.config.torque_lim", "force_limit", "Nm", "N m",
        "torque limit; firmware 0.6: odrv0.axis0.config.torque_soft_max"),
    Row(f"{_CONFIG}.inertia", "mass", "Nm/(turn/s^2)", "kg m2",
        "inertia, used by the input modes that make an acceleration themselves", scale=2.0 * math.pi),
)  # fmt: skip


ODRIVE = Maker(
    key="odrive",
    title="ODrive, as commands of odrivetool",
    comment="#",
    rows=ROWS,
    held=("force_limit",),
    filters=lambda *_: Filtered(why=_NO_FILTER),
    rotary=True,
    outside={
        "filters": (_NO_FILTER, ""),
        "back_calculation": ("the integral leaks away while a limit acts", ""),
        "inertia": (
            "with input_mode PASSTHROUGH the sender must supply the torque for an acceleration: input_torque",
            "send mass · acceleration, as a torque, with every setpoint",
        ),
        "viscous_feedforward": ("the sender must supply it: input_torque", "send it with every setpoint"),
        "half_sample": ("the sender sets the timing", "shift the setpoints by half a period of the sender"),
        "friction_feedforward": ("the sender must supply it: input_torque", "send it with every setpoint"),
        "velocity_limit": ("vel_limit bounds the command; vel_limit_tolerance times it trips", "check that factor"),
        "following_error_limit": ("it watches the velocity only", ""),
        "travel": ("it has no software end positions in this mode", "watch them in the sender of the setpoints"),
        "broken_readings": ("encoder faults disarm it", ""),
    },
    notes=(
        "turn: of the motor's shaft.  vel_integrator_gain is Kp/Tn, not 1/Tn; set it to 0 where there is no Tn.",
        "The sender supplies the velocity feedforward: the share times the set velocity, as input_vel.",
    ),
    always=(
        LostPart(
            "control.law.velocity_feedforward", "", "the sender must supply the set velocity: input_vel",
            "without it the following error is v/Kv",
        ),
        LostPart(
            "sample_time", "", "its loop runs at 8 kHz, the encoder is observed with encoder.config.bandwidth",
            "that bandwidth is a delay in the velocity loop that this design does not include",
        ),
    ),
)  # fmt: skip


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
