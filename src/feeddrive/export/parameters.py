"""The target `parameters`: files that state a design in the parameter names and units of drive manufacturers."""

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from feeddrive.analysis.stability import stability
from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.export.design import Design
from feeddrive.export.drive_quantities import (
    QUANTITIES,
    SAFETY,
    Cascade,
    DriveTrain,
    LostPart,
    at_shaft,
    drive_train,
    kv_lines,
    lost,
    numbers,
    read_cascade,
)
from feeddrive.export.linuxcnc_pid import COEFFICIENTS, GAINS, left_out, period, stock_law, stock_loop
from feeddrive.export.pitch_tables import pitch_compensations, pitch_file, remark
from feeddrive.export.targets import readme, write_bundle
from feeddrive.language import tree, units
from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Table
from feeddrive.loop.loop import Loop

# The rows of a manufacturer's file: names and units of ODrive, and the CSV file for all others.

NOT_CHECKED = "NOT CHECKED against a manual: name and unit are those in common use"


class Row(NamedTuple):
    """A parameter of a manufacturer's controller or drive.

    unit      unit in the manufacturer's notation; `measure` is the same unit in the notation of `language.units`
    source    manual and page that document the parameter; empty if no manual was available
    linear    name, unit and measure for a linear motor, if they differ; an empty name if there is no such parameter
    turning   the same for a rotary axis
    scale     additional factor on the value, such as -1 for a lower limit
    decimals  number of decimals that the controller stores; `most` is the largest magnitude that it accepts
    """

    name: str
    quantity: str
    unit: str
    measure: str
    meaning: str
    source: str = ""
    linear: tuple[str, str, str] | None = None
    turning: tuple[str, str, str] | None = None
    scale: float = 1.0
    decimals: int | None = None
    most: float | None = None

    def of(self, train: DriveTrain) -> tuple[str, str, str]:
        """Return the name, unit and measure on a drive train."""
        usual = (self.name, self.unit, self.measure)
        if train.turns:
            return self.turning or usual
        return usual if train.rotary else self.linear or usual


class Line(NamedTuple):
    """A number in a manufacturer's file, with its path in the machine file and its value in SI units."""

    name: str
    text: str
    unit: str
    meaning: str
    path: str
    si: str
    source: str


class Filtered(NamedTuple):
    """The lines of a filter, or the reason why the manufacturer has no such filter."""

    lines: tuple[Line, ...] = ()
    why: str = ""


@dataclass(frozen=True)
class Maker:
    """A manufacturer's controller or drive: its parameters (`rows`), its filters, and the format of its files.

    notes    header lines of its file, such as which loop the gains belong to, or how to switch off the integrator
    rotary   True if it supports rotary motors only
    held     kinds of controller elements (`drive_quantities.Item`) that it represents completely; `outside` gives, for
             each other kind, the reason and the consequence
    filters  function that returns the lines for a filter, called with the filter and its index among the filters
    always   elements that it cannot represent, whatever the design
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
    """Return the lines of a manufacturer's file, and the values that its parameters cannot represent."""
    lines: list[Line] = []
    lost: list[LostPart] = []
    for row in maker.rows:
        name, unit, measure = row.of(train)
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
    """Return why a parameter cannot represent a value, and the consequence; None if it can."""
    if row.most is not None and abs(value) > row.most:
        return f"{row.name} takes at most {row.most:g}", "the loop cannot be set up there: the gain stays lower"
    if value != 0.0 and abs(float(text) - value) > 0.01 * abs(value):
        return f"{row.name} keeps {row.decimals} decimals", f"the value would be {text}, more than 1 % off"
    return None


def parameters_table(maker: Maker, loop: Loop) -> Table:
    """Return a table of a design in a manufacturer's parameters, one row each, and of what they cannot represent.

    Raises StructureError for a law other than `cascade_ppi`, ParameterError if the lead of a screw is not known.
    """
    cascade, train = read_cascade(loop), drive_train(loop)
    lines, _ = lines_of(maker, cascade, train)
    rows = [[line.name, line.text, line.unit, line.meaning] for line in lines if line.name]
    return Table(maker.title, ["parameter", "value", "unit", "what"], rows)


def number(value: float, decimals: int | None = None) -> str:
    """Return a number as text with six significant digits, or with the number of decimals that a controller stores."""
    return f"{value:.6g}" if decimals is None else f"{value:.{decimals}f}"


def in_si(cascade: Cascade, train: DriveTrain, quantity: str) -> str:
    """Return a quantity in SI units at the table, as text with all digits."""
    own = {"lead": train.lead, "gear": train.gear}
    value = own[quantity] if quantity in own else cascade.values[quantity]
    unit = QUANTITIES[quantity].table
    return f"{value!r} {units.turning(unit) if train.turns else unit}".rstrip()


def filter_line(
    name: str, value: float, unit: str, meaning: str, path: str, source: str, decimals: int | None = None
) -> Line:
    """Return the line for one value of a filter."""
    return Line(
        name, number(value, decimals), unit, meaning, path, f"{float(value)!r} {unit}".rstrip(), source or NOT_CHECKED
    )


_ODRIVE_SOURCE = (
    "odriverobotics/ODrive, Firmware/MotorControl/controller.hpp (firmware 0.5), the units beside the fields"
)
_NO_FILTER = "there is no filter between velocity controller and torque"
_CONFIG = "odrv0.axis0.controller.config"

ODRIVE_ROWS = (
    Row(f"{_CONFIG}.pos_gain", "Kv", "(turn/s)/turn", "1/s", "position gain", _ODRIVE_SOURCE),
    Row(f"{_CONFIG}.vel_gain", "Kp", "Nm/(turn/s)", "N m s/rev", "velocity gain", _ODRIVE_SOURCE),
    Row(f"{_CONFIG}.vel_integrator_gain", "Kp/Tn", "Nm/(turn/s * s)", "N m/rev", "Kp/Tn", _ODRIVE_SOURCE),
    Row(f"{_CONFIG}.vel_limit", "velocity_limit", "turn/s", "rev/s", "speed limit of the velocity command"),
    Row(
        "odrv0.axis0.motor.config.torque_lim",
        "force_limit",
        "Nm",
        "N m",
        "torque limit; firmware 0.6: odrv0.axis0.config.torque_soft_max",
    ),
    Row(
        f"{_CONFIG}.inertia",
        "mass",
        "Nm/(turn/s^2)",
        "kg m2",
        "inertia, used by the input modes that make an acceleration themselves",
        # N m per turn/s²: a turn is 2π rad
        scale=2.0 * math.pi,
    ),
)


ODRIVE = Maker(
    key="odrive",
    title="ODrive, as commands of odrivetool",
    comment="#",
    rows=ODRIVE_ROWS,
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
            "control.law.velocity_feedforward",
            "",
            "the sender must supply the set velocity: input_vel",
            "without it the following error is v/Kv",
        ),
        LostPart(
            "sample_time",
            "",
            "its loop runs at 8 kHz, the encoder is observed with encoder.config.bandwidth",
            "that bandwidth is a delay in the velocity loop that this design does not include",
        ),
    ),
)


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
    """Return the text of the CSV file: comment lines with `#`, then a header and one row per number."""
    out = io.StringIO()
    for line in head:
        out.write(f"# {line}".rstrip() + "\n")
    # csv writes CRLF by default; all other files of an export have LF
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEAD)
    turns = cascade.loop.axis.rotary
    linear = DriveTrain(None, turns=turns)
    shaft = train if train is not None and train.rotary and not turns else None
    for quantity, meaning in _MEANINGS.items():
        kind = QUANTITIES[quantity]
        place = shaft if shaft is not None and quantity in ("lead", "gear") else linear
        table = units.turning(kind.table) if turns else kind.table
        value = at_shaft(cascade, place, quantity, table)
        if value is None:
            continue
        si = (repr(float(value)), table)
        writer.writerow([quantity, f"{value:.9g}", table, meaning, *si])
        for unit, measure in () if turns and table != kind.table else _COMMON.get(quantity, ()):
            writer.writerow([quantity, f"{value / units.factor(measure, table):.9g}", unit, meaning, *si])
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


# Parameters of SINUMERIK with SINAMICS drives: axis machine data and drive parameters.

_GAIN = "SINUMERIK 808D ADVANCED Parameter Manual, 08/2015, p. 234"
_SETS = "SINUMERIK 840D sl/828D Basic Functions, 09/2011, G2, p. 378 (the name; the unit is that in common use)"
_ENDS = "SINUMERIK 840D sl/828D Basic Functions, 01/2015, Z1, p. 1591 (the name; the unit is that in common use)"
_PITCH = "SINUMERIK 840D sl/828D Basic Functions, 01/2015, G2, p. 349"
_FORM = (
    "form of the filter: SINAMICS S120 Function Manual FH1, 07/2007, p. 81; "
    "its parameter numbers were NOT CHECKED against the list manual"
)

SINUMERIK_ROWS = (
    Row("MD31030 $MA_LEADSCREW_PITCH", "lead", "mm/rev", "mm", "lead of the screw; must be there already", _PITCH),
    Row(
        "MD32200 $MA_POSCTRL_GAIN[0]",
        "Kv",
        "1000/min = (m/min)/mm",
        "m_per_min_per_mm",
        "servo gain Kv",
        _GAIN,
        turning=("MD32200 $MA_POSCTRL_GAIN[0]", "1000/min", "m_per_min_per_mm"),
    ),
    Row("MD32610 $MA_VELO_FFW_WEIGHT[0]", "velocity_feedforward", "1 = 100 %", "", "share of the set velocity", _SETS),
    Row(
        "MD32650 $MA_AX_INERTIA",
        "mass",
        "kg m2",
        "kg m2",
        "inertia at the motor for torque precontrol",
        linear=("MD32652 $MA_AX_MASS", "kg", "kg"),
    ),
    Row(
        "MD36200 $MA_AX_VELO_LIMIT[0]",
        "table_velocity_limit",
        "mm/min",
        "mm_per_min",
        "speed that trips",
        _SETS,
        turning=("MD36200 $MA_AX_VELO_LIMIT[0]", "rev/min", "rpm"),
    ),
    Row(
        "MD36100 $MA_POS_LIMIT_MINUS",
        "travel_least",
        "mm",
        "mm",
        "software limit",
        _ENDS,
        turning=("MD36100 $MA_POS_LIMIT_MINUS", "deg", "deg"),
    ),
    Row(
        "MD36110 $MA_POS_LIMIT_PLUS",
        "travel_most",
        "mm",
        "mm",
        "software limit",
        _ENDS,
        turning=("MD36110 $MA_POS_LIMIT_PLUS", "deg", "deg"),
    ),
    Row(
        "p1460[0]", "Kp", "Nms/rad", "N m s/rad", "P gain of the speed controller", linear=("p1460[0]", "Ns/m", "N s/m")
    ),
    Row("p1462[0]", "Tn", "ms", "ms", "integral time of the speed controller"),
    Row("p1520[0]", "force_limit", "Nm", "N m", "upper torque limit", linear=("p1520[0]", "N", "N")),
    Row("p1521[0]", "force_limit", "Nm", "N m", "lower torque limit", linear=("p1521[0]", "N", "N"), scale=-1.0),
)

FILTERS = 4  # current setpoint filters of a drive
PT2, GENERAL = 1, 2  # types of p1657
_FIRST, _STEP = 1657, 5  # p1657 .. p1661 are the first filter, p1662 .. p1666 the second


def sinumerik_filters(block: Filter, place: int) -> Filtered:
    """Return the lines of a current setpoint filter, PT2 or general second order: frequencies and damping ratios."""
    if place >= FILTERS:
        return Filtered(why=f"a drive has {FILTERS} current setpoint filters")
    path = f"control.filters.{place}"
    if isinstance(block, LowPass2):
        return Filtered(tuple(_filter(place, PT2, path, (block.frequency, block.damping), ("frequency", "damping"))))
    if isinstance(block, Notch):
        numbers = (block.frequency, block.damping_pole, block.frequency, block.damping_zero)
        keys = ("frequency", "damping_pole", "frequency", "damping_zero")
        return Filtered(tuple(_filter(place, GENERAL, path, numbers, keys)))
    if isinstance(block, SecondOrder):
        keys = ("frequency_pole", "damping_pole", "frequency_zero", "damping_zero")
        return Filtered(tuple(_filter(place, GENERAL, path, tuple(getattr(block, key) for key in keys), keys)))
    return Filtered(why="current setpoint filters are PT2 or general second order")


def _filter(place: int, kind: int, path: str, numbers: tuple[float, ...], keys: tuple[str, ...]) -> Iterator[Line]:
    base = _FIRST + _STEP * place
    what = "PT2 low pass" if kind == PT2 else "general second order"
    yield Line(f"p1656[0].{place}", "1", "bit", f"switches current setpoint filter {place + 1} on", path, "on", _FORM)
    yield Line(f"p{base}[0]", str(kind), "type", what, path, what, _FORM)
    meanings = (
        ("Hz", "natural frequency of the denominator"),
        ("", "damping of the denominator"),
        ("Hz", "natural frequency of the numerator"),
        ("", "damping of the numerator"),
    )
    for i, (value, key) in enumerate(zip(numbers, keys, strict=True)):
        unit, meaning = meanings[i]
        yield filter_line(f"p{base + 1 + i}[0]", value, unit, meaning, f"{path}.{key}", _FORM)


SINUMERIK = Maker(
    key="sinumerik",
    title="SINUMERIK machine data and SINAMICS drive parameters",
    comment=";",
    rows=SINUMERIK_ROWS,
    held=("inertia", "force_limit", "velocity_limit", "travel"),
    filters=sinumerik_filters,
    outside={
        "filters": ("the drive's current setpoint filters have another form", ""),
        "back_calculation": ("the drive holds its integral at the torque limit in its own way", ""),
        "following_error_limit": (
            "MD36400 $MA_CONTOUR_TOL watches the error against a model of the axis, not the following error",
            "set it by hand, from the error at the highest speed",
        ),
        "viscous_feedforward": ("torque precontrol takes an inertia only", ""),
        "half_sample": (
            "the control times its precontrol by MD32800 and MD32810 (equivalent times)",
            "measure them at the axis: too small ones overshoot, and axes that interpolate need equal ones",
        ),
        "friction_feedforward": (
            "the control has another friction compensation, which learns at the machine",
            "run its friction or quadrant-error compensation after commissioning",
        ),
        "broken_readings": ("encoder faults are watched by the drive", "the reaction is the drive's: check it"),
        "alignment": ("the control watches two encoders by MD36510", "set its tolerance by hand"),
        "safe_force": ("the weight is carried by an electronic counterbalance of the drive, or by the brake", ""),
        "velocity_lag": (
            "the drive smooths its actual speed by a parameter whose number was not checked",
            "set the smoothing time of the actual speed to this by hand",
        ),
        "position_every": (
            "the position loop runs in the position clock of the control",
            "that clock must be this many samples of the drive, and with DSC it is another loop: margins are those of "
            "this clock",
        ),
    },
    notes=(
        "Parameter set 0; repeat for the sets of other gear stages.  MD32620 $MA_FFW_MODE chooses the precontrol.",
        "If the design has no integral time, see the list manual how the speed controller is run without one.",
    ),
    always=(
        LostPart(
            "sample_time",
            "",
            "position control runs in the control's cycle, the speed loop in the drive's",
            "the margins hold for these delays only: check them with the control's frequency response",
        ),
        LostPart(
            "control.filters",
            "",
            "current setpoint filters stand behind the sum of feedback and precontrol",
            "the feedforward passes the filters and is delayed by them",
        ),
    ),
)

# Parameters of TwinCAT NC axes with AX5000 or AX8000 drives.
#
# Kv has two units here: (mm/s)/mm in the NC, where the NC closes the position loop, and 1000/min in the
# AX5000, where the drive does.

_NC = "Beckhoff Infosys, TF50x0 TC3 NC PTP, Position Control Loop (the name; the unit is NOT CHECKED)"
_ADS = "Beckhoff Infosys, TC3 ADS, controller parameters (index group 0x6000 + ID)"
_AX5 = "Beckhoff Infosys, AX5000 IDN description, {}"
_AX8 = "Beckhoff Infosys, AX8xxx object description, {}"

TWINCAT_ROWS = (
    Row(
        "NC: Position control: Proportional Factor Kv",
        "Kv",
        "(mm/s)/mm",
        "mm_per_s_per_mm",
        "position gain, if the drive follows a velocity (CSV)",
        _NC,
        turning=("NC: Position control: Proportional Factor Kv", "(deg/s)/deg", "mm_per_s_per_mm"),
    ),
    Row(
        "NC: weight of the velocity pre-control (0x0B)",
        "velocity_feedforward",
        "1 = 100 %",
        "",
        "share of the set velocity",
        _ADS,
    ),
    Row(
        "NC: Maximum Position Lag Value (0x12)",
        "following_error_limit",
        "mm",
        "mm",
        "following error that stops the axis",
        _ADS,
        turning=("NC: Maximum Position Lag Value (0x12)", "deg", "deg"),
    ),
    Row(
        "S-0-0104",
        "Kv",
        "1000/min",
        "m_per_min_per_mm",
        "AX5000: position gain, if the drive follows a position",
        _AX5.format("S-0-0104"),
        decimals=2,
        most=100.0,
    ),
    Row(
        "S-0-0296",
        "velocity_feedforward",
        "%",
        "percent",
        "AX5000: velocity feedforward, with S-0-0104",
        _AX5.format("S-0-0296"),
        decimals=2,
        most=120.0,
    ),
    Row(
        "S-0-0100",
        "Kp",
        "Nm/(rad/s)",
        "N m s/rad",
        "AX5000: gain of the velocity loop; P-0-0010 bit 15 must be set",
        _AX5.format("S-0-0100"),
        linear=("S-0-0100", "N/(m/s)", "N s/m"),
        decimals=3,
    ),
    Row(
        "S-0-0101",
        "Tn",
        "ms",
        "ms",
        "AX5000: integral time of the velocity loop; 0 is without",
        _AX5.format("S-0-0101"),
        decimals=1,
        most=6000.0,
    ),
    Row(
        "0x3140:01",
        "Kp",
        "Nm/(rad/s)",
        "N m s/rad",
        "AX8000: gain of the velocity loop; 0x3005:09 must be 0x9000",
        _AX8.format("3140:01"),
        linear=("", "", ""),
    ),
    Row("0x3140:02", "Tn", "s", "s", "AX8000: integral time of the velocity loop", _AX8.format("3140:02"), most=5.0),
    Row(
        "0x3062:01",
        "velocity_feedforward",
        "1 = 100 %",
        "",
        "AX8000: velocity feedforward, if the drive follows a position",
        _AX8.format("3062:01"),
        most=1.2,
    ),
)

_AX5_FILTERS = ("P-0-0513", "P-0-0515", "P-0-0516", "P-0-0517")
_AX8_FILTERS = ("0x3163", "0x3183", "0x31A3", "0x31C3")
# a low pass of these drives has complex poles only
_LARGEST_DAMPING = 0.99999999
LOW_PASS_1, LOW_PASS_2 = 1, 3  # filter types, the same numbers in both drives


def twincat_filters(block: Filter, place: int) -> Filtered:
    """Return the lines of a low-pass filter for AX5000 and AX8000; a notch is rejected, since it is not documented."""
    if place >= len(_AX5_FILTERS):
        return Filtered(why=f"a drive has {len(_AX5_FILTERS)} current command filters")
    if not isinstance(block, LowPass | LowPass2):
        return Filtered(why="the manual does not say how the four numbers of notch and phase filter act")
    second = isinstance(block, LowPass2)
    if isinstance(block, LowPass2) and block.damping > _LARGEST_DAMPING:
        return Filtered(why=f"the damping of a low pass is at most {_LARGEST_DAMPING:g}")
    kind, what = (LOW_PASS_2, "low pass of second order") if second else (LOW_PASS_1, "low pass of first order")
    path, lines = f"control.filters.{place}", list[Line]()
    for drive, base, source, join in (
        ("AX5000", _AX5_FILTERS[place], _AX5.format(_AX5_FILTERS[place]), ", {}"),
        ("AX8000", _AX8_FILTERS[place], _AX8.format("3163"), ":0{}"),
    ):
        fields = ("Filter type", "Low pass frequency", "Low pass damping") if drive == "AX5000" else ("5", "1", "2")
        named = [base + join.format(field) for field in fields]
        lines.append(Line(named[0], str(kind), "type", f"{drive}: {what}", path, what, source))
        lines.append(filter_line(named[1], block.frequency, "Hz", f"{drive}: its corner", f"{path}.frequency", source))
        if isinstance(block, LowPass2):
            lines.append(filter_line(named[2], block.damping, "", f"{drive}: its damping", f"{path}.damping", source))
    return Filtered(tuple(lines))


TWINCAT = Maker(
    key="twincat",
    title="TwinCAT NC axis and AX5000 or AX8000 drive",
    comment="//",
    rows=TWINCAT_ROWS,
    held=("following_error_limit",),
    filters=twincat_filters,
    outside={
        "filters": ("the drive's current command filters have another form", ""),
        "back_calculation": ("the drive holds its integral at the torque limit in its own way", ""),
        "inertia": (
            "acceleration feedforward of the drives is a share of an inertia that they know (AX8000: 0x3062:03 and "
            "0x3140:07)",
            "enter the load's inertia and 100 % by hand, or following errors in acceleration stay",
        ),
        "viscous_feedforward": ("the drives feed an acceleration and a velocity setpoint, no viscous force", ""),
        "half_sample": ("the drive's own timing", "tracking differs by its delay"),
        "friction_feedforward": ("AX8000 has its own (0x3144), AX5000 none", ""),
        "force_limit": (
            "S-0-0092 is a share of P-0-0092, the drive's own base",
            "enter it by hand: the design was proven with this limit",
        ),
        "velocity_limit": ("the base of the drive's speed limits is its own", "set it by hand"),
        "travel": ("software end positions are set in the NC axis", "set them by hand"),
        "broken_readings": ("encoder faults are watched by the drive", "the reaction is the drive's: check it"),
        "safe_force": ("AX8000 has a weight counterbalance (0x3140:05)", "set it by hand, or use the brake"),
    },
    notes=(
        "Either the NC closes the position loop, with Kv in (mm/s)/mm = 1/s, or the drive does: AX5000 in 1000/min.",
        "Enter one of the two: the same number in both is 16.667 times off in one of them.",
        "S-0-0100 without P-0-0010 bit 15 is in A/(rad/s): another number, not this one.",
    ),
    always=(
        LostPart(
            "sample_time",
            "",
            "the NC task and the drive have their own cycles",
            "the margins hold for these delays only: with Kv in the NC the bus delay is in the position loop",
        ),
        LostPart(
            "AX8000: position gain",
            "",
            "its object was not found in the manual",
            "set Kv of an AX8000 that follows a position in its Drive Manager, by the units shown there",
        ),
    ),
)


MAKERS = {maker.key: maker for maker in (SINUMERIK, TWINCAT, ODRIVE)}
OTHERS = ("linuxcnc", "csv")

Entry = TypeVar("Entry", Line, LostPart)


class Part(NamedTuple):
    """A section of the README on one file: its lines and the missing parts of the design, or why the file is absent."""

    title: str
    file: str = ""
    warning: Sequence[str] = ()
    lines: Sequence[Line] = ()
    missing: Sequence[LostPart] = ()
    absent: str = ""

    @property
    def unread(self) -> list[str]:
        """The parameters whose unit is assumed from common use and was not checked against a manual."""
        marks = ("NOT CHECKED", "in common use")
        return [line.name for line in self.lines if line.name and any(mark in line.source for mark in marks)]


def write_parameters(
    design: Design,
    out: Path,
    *,
    makers: Sequence[str] = (),
    lead: float | None = None,
    gear: float | None = None,
) -> Path:
    """Write the files atomically and return the path of the README.

    makers      any of sinumerik, twincat, odrive, linuxcnc, csv; default: all that support the axis
    lead, gear  lead of the screw (m) and gear (motor turns per screw turn), if the machine file does not contain them

    Raises StructureError for a law other than `cascade_ppi`; ParameterError for an unknown manufacturer, for a
    manufacturer whose units refer to the motor's shaft if the motor is unknown, and for a linear motor or a rotary
    axis that the manufacturer does not support; FileError as `new_directory` does.
    """
    wanted = list(makers) or [*MAKERS, *OTHERS]
    for wanted_maker in wanted:
        if wanted_maker not in (*MAKERS, *OTHERS):
            raise ParameterError(f"maker '{wanted_maker}' is not known; there are {', '.join((*MAKERS, *OTHERS))}")
    cascade = read_cascade(design.loop)
    at_motor = [wanted_maker for wanted_maker in wanted if wanted_maker in MAKERS]
    train = drive_train(design.loop, lead, gear) if at_motor or lead is not None or gear is not None else None
    files: dict[str, str] = {}
    parts: list[Part] = []
    for wanted_maker in wanted:
        if wanted_maker in MAKERS:
            assert train is not None
            maker = MAKERS[wanted_maker]
            if maker.rotary and not train.rotary:
                reason = (
                    f"{wanted_maker} counts in turns of a motor, and axis.actuator.motor is direct: a linear motor, or "
                    f"a screw whose lead is not stated; give lead, or leave {wanted_maker} out"
                )
                reason = tree.in_paths(cascade.loop, reason)
                if makers:
                    raise ParameterError(reason)
                parts.append(Part(maker.title, absent=reason))
                continue
            lines, missing = lines_of(maker, cascade, train)
            lines, missing = _in_paths(cascade.loop, lines), _in_paths(cascade.loop, [*missing, *_lost(maker, cascade)])
            # a loop may be stable only with the filters that this file has no room for
            kept = tuple(b for i, b in enumerate(cascade.loop.control.filters) if not maker.filters(b, i).why)
            bare = replace(cascade.loop, control=replace(cascade.loop.control, filters=kept))
            warning = _warning(bare, cascade.loop)
            head = [maker.title, *warning, *_head(design, cascade, train), *maker.notes]
            files[f"{wanted_maker}.txt"] = _text(head, lines, maker.comment, maker.key)
            parts.append(Part(maker.title, f"{wanted_maker}.txt", warning, lines, missing))
        elif wanted_maker == "linuxcnc" and cascade.loop.axis.rotary:
            reason = "linuxcnc is written in mm, and the axis turns; leave linuxcnc out"
            if makers:
                raise ParameterError(reason)
            parts.append(Part(_PIDS, absent=reason))
        elif wanted_maker == "linuxcnc":
            lines, missing = halcmd_lines(cascade)
            missing = _without_tables(wanted_maker, cascade, missing)
            # only the lines: `left_out` has already given the missing parts their paths
            lines = _in_paths(cascade.loop, lines)
            warning = _warning(stock_loop(cascade, stock_law(cascade, units=STOCK_UNITS)), cascade.loop)
            head = [_PIDS, *warning, *_head(design, cascade, None)]
            files["linuxcnc.txt"] = _text(head, lines, "#", wanted_maker)
            parts.append(Part(_PIDS, "linuxcnc.txt", warning, lines, missing))
        else:
            files["parameters.csv"] = csv_text(cascade, train, _head(design, cascade, train))
    tables = [table for maker in wanted if (table := pitch_file(maker, cascade.loop)) is not None]
    files |= {table.name: table.text for table in tables if table.name}
    files["README.md"] = readme(
        "parameters.md.j2",
        design,
        head=_head(design, cascade, train),
        parts=parts,
        pitch=[(table, remark(table, turns=cascade.loop.axis.rotary)) for table in tables],
        not_checked=NOT_CHECKED.split(":")[0],
    )
    return write_bundle(design, "parameters", out, files, makers=wanted, lead=lead, gear=gear)


def _in_paths(loop: Loop, rows: Sequence[Entry]) -> list[Entry]:
    """Return lines or lost parts with their full paths in the machine file."""
    return [row._replace(path=tree.in_paths(loop, row.path)) for row in rows]


def _head(design: Design, cascade: Cascade, train: DriveTrain | None) -> list[str]:
    """Return the header lines of a file: title, safety notes, Kv in four units, and the drive train."""
    turns = cascade.loop.axis.rotary
    lines = [f"{design.title}.", design.made_by, "", *SAFETY, "", *kv_lines(cascade.law.Kv, turns=turns)]
    if train is not None and train.lead is not None:
        lines.append(
            f"At the motor's shaft: lead {1e3 * train.lead:.6g} mm, gear {train.gear:.6g}, from {train.source}; "
            f"1 m of the table is {train.radians_per_metre:.6g} rad there"
        )
    elif train is not None and train.turns:
        lines.append(
            f"An axis that turns, {train.source}.  Behind a gear, speeds and positions of the axis are those of the "
            "motor divided by its ratio."
        )
    elif train is not None:
        lines.append(f"Numbers are those of a linear motor: {train.source}.  For a screw give its lead.")
    return [*lines, ""]


def _text(head: Sequence[str], lines: Sequence[Line], comment: str, key: str) -> str:
    """Return the text of a manufacturer's file: one number per line, with meaning and source in comments above."""
    out = [f"{comment} {line}".rstrip() for line in head]
    before = "setp " if key == "linuxcnc" else ""
    join = " " if key == "linuxcnc" else " = "
    for line in lines:
        unit = f" [{line.unit}]" if line.unit else ""
        out += ["", f"{comment} {line.meaning}{unit}"]
        if line.path:
            out.append(f"{comment} from {line.path} = {line.si}" if line.si else f"{comment} from {line.path}")
        if line.source:
            out.append(f"{comment} {line.source}")
        if line.name:
            out.append(f"{before}{line.name}{join}{line.text}")
    return "\n".join(out) + "\n"


def _lost(maker: Maker, cascade: Cascade) -> list[LostPart]:
    """Return the parts of the design that a manufacturer cannot represent.

    Filters are checked individually, all other parts by kind.
    """
    parts = _without_tables(maker.key, cascade, lost(cascade, (*maker.held, "filters"), maker.outside))
    for i, block in enumerate(cascade.loop.control.filters):
        why = maker.filters(block, i).why
        if why:
            parts += [
                part._replace(why=why)
                for part in lost(cascade, maker.held, maker.outside)
                if part.path == f"control.filters.{i}"
            ]
    return [*parts, *maker.always]


def _without_tables(maker: str, cascade: Cascade, parts: Iterable[LostPart]) -> list[LostPart]:
    """Return the missing parts without the pitch compensation, if the maker has a file for its table."""
    table = pitch_file(maker, cascade.loop)
    written = pitch_compensations(cascade.loop) if table is not None and table.name else []
    paths = {tree.in_paths(cascade.loop, f"control.compensation.{i}") for i in written}
    paths |= {f"control.compensation.{i}" for i in written}
    return [part for part in parts if part.path not in paths]


def _warning(bare: Loop, whole: Loop) -> list[str]:
    """Return a warning if the loop is stable as designed, but unstable with only the parts that a file represents."""
    if bare is whole or not stability(whole).stable:
        return []
    verdict = stability(bare)
    if verdict.stable:
        return []
    return [
        f"UNSTABLE WITH THESE NUMBERS ALONE: {verdict.sentence()!s}.  Filters of the design are missing: see README.md."
    ]


_PIDS = "LinuxCNC's pid, as lines of halcmd"
STOCK_UNITS = 1000.0  # machine units per meter: mm
_PID_MANUAL = "LinuxCNC manual page pid(9); tested bit for bit against the component of LinuxCNC 2.9"
_BIQUAD = "LinuxCNC manual page biquad(9); tested as the pids; it stands between two sum2, see the target linuxcnc-pid"
_PID_MEANINGS = {
    "position.Pgain": ("1/s, that is (mm/s)/mm", "position gain", "control.law.Kv"),
    "position.FF1": ("(mm/s)/(mm/s)", "share of the set velocity", "control.law.velocity_feedforward"),
    "velocity.Pgain": ("output/(mm/s)", "velocity gain", "control.law.Kp"),
    "velocity.Igain": ("output/mm", "velocity gain over integral time", "control.law.Kp / control.law.Tn"),
    "velocity.FF0": ("output/(mm/s)", "compensation of the viscous friction by the law", "control.law.viscous"),
    "velocity.maxoutput": ("output", "limit of the output", "control.force_limit"),
}


def halcmd_lines(cascade: Cascade) -> tuple[list[Line], list[LostPart]]:
    """Return the halcmd lines of two pids and their bias, and the lost parts; zeros, the defaults, are omitted."""
    law = stock_law(cascade, units=STOCK_UNITS)
    assert law.velocity is not None
    lines = list(_gains(cascade, "position", law.position)) + list(_gains(cascade, "velocity", law.velocity))
    for name, value, unit, quantity in (
        ("forward.gain0", law.acceleration_gain, "output/(mm/s^2)", "mass"),
        ("forward.gain1", law.velocity_gain, "output/(mm/s)", "viscous"),
    ):
        if value:
            meaning = f"gain of sum2 at velocity.bias: {quantity} that is fed forward"
            si = f"{cascade.values[quantity] or 0.0!r} {'kg' if quantity == 'mass' else 'N s/m'}"
            lines.append(Line(name, f"{value:.9g}", unit, meaning, f"control.feedforward, {quantity}", si, _PID_MANUAL))
    if law.velocity.bias:
        si = f"{cascade.values['weight']!r} N"
        meaning = "offset of the same sum2: the weight of a hanging axis"
        value = f"{law.velocity.bias:.9g}"
        lines.append(Line("forward.offset", value, "output", meaning, "control.guard.safe_force", si, _PID_MANUAL))
    for i, (block, design) in enumerate(zip(law.filters, cascade.loop.control.filters, strict=True)):
        for name in COEFFICIENTS:
            meaning = f"biquad {i}, type 0, at a period of {1e3 * period(cascade.loop):.6g} ms: {numbers(design)}"
            value = getattr(block, name)
            lines.append(Line(f"filter{i}.{name}", f"{value:.17g}", "", meaning, f"control.filters.{i}", "", _BIQUAD))
    output = f"The output is in {_unit(cascade)}; 1 of it is {float(law.force_per_output):.6g} N at the table."
    lines.insert(0, Line("", "", "", output, "", "", ""))
    return lines, list(left_out(cascade))


def _gains(cascade: Cascade, name: str, pid: object) -> Iterator[Line]:
    for gain in GAINS:
        value, key = getattr(pid, gain), f"{name}.{gain}"
        if value and key in _PID_MEANINGS:
            unit, meaning, path = _PID_MEANINGS[key]
            yield Line(key, f"{value:.9g}", unit, meaning, path, _si(cascade, path), _PID_MANUAL)
    yield Line(f"{name}.error-previous-target", "0", "bit", "error against the present command", "", "", _PID_MANUAL)


def _si(cascade: Cascade, path: str) -> str:
    """Return the value from the machine file, in SI units."""
    values = {
        "control.law.Kv": ("Kv", "1/s"),
        "control.law.velocity_feedforward": ("velocity_feedforward", ""),
        "control.law.Kp": ("Kp", "N s/m"),
        "control.law.Kp / control.law.Tn": ("Kp/Tn", "N/m"),
        "control.force_limit": ("force_limit", "N"),
    }
    if path == "control.law.viscous":
        return f"{cascade.law.viscous!r} N s/m"
    quantity, unit = values[path]
    return f"{cascade.values[quantity]!r} {unit}".rstrip()


def _unit(cascade: Cascade) -> str:
    motor = cascade.loop.axis.actuator.motor
    return "N" if motor is None else motor.unit
