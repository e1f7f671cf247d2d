"""Parameters of TwinCAT NC axes with AX5000 or AX8000 drives.

Kv has two units here: (mm/s)/mm in the NC, where the NC closes the position loop, and 1000/min in the
AX5000, where the drive does.
"""

from __future__ import annotations

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.export.parameters.maker import Filtered, Line, Maker, Row, filter_line
from feeddrive.export.parameters.quantities import LostPart

_NC = "Beckhoff Infosys, TF50x0 TC3 NC PTP, Position Control Loop (the name; the unit is NOT CHECKED)"
_ADS = "Beckhoff Infosys, TC3 ADS, controller parameters (index group 0x6000 + ID)"
_AX5 = "Beckhoff Infosys, AX5000 IDN description, {}"
_AX8 = "Beckhoff Infosys, AX8xxx object description, {}"

ROWS = (
    Row("NC: Position control: Proportional Factor Kv", "Kv", "(mm/s)/mm", "mm_per_s_per_mm",
        "position gain, if the drive follows a velocity (CSV)", _NC),
    Row("NC: weight of the velocity pre-control (0x0B)", "velocity_feedforward", "1 = 100 %", "",
        "share of the set velocity", _ADS),
    Row("NC: Maximum Position Lag Value (0x12)", "following_error_limit", "mm", "mm",
        "following error that stops the axis", _ADS),
    Row("S-0-0104", "Kv", "1000/min", "m_per_min_per_mm",
        "AX5000: position gain, if the drive follows a position", _AX5.format("S-0-0104"), decimals=2, most=100.0),
    Row("S-0-0296", "velocity_feedforward", "%", "percent", "AX5000: velocity feedforward, with S-0-0104",
        _AX5.format("S-0-0296"), decimals=2, most=120.0),
    Row("S-0-0100", "Kp", "Nm/(rad/s)", "N m s/rad", "AX5000: gain of the velocity loop; P-0-0010 bit 15 must be set",
        _AX5.format("S-0-0100"), linear=("S-0-0100", "N/(m/s)", "N s/m"), decimals=3),
    Row("S-0-0101", "Tn", "ms", "ms", "AX5000: integral time of the velocity loop; 0 is without",
        _AX5.format("S-0-0101"), decimals=1, most=6000.0),
    Row("0x3140:01", "Kp", "Nm/(rad/s)", "N m s/rad", "AX8000: gain of the velocity loop; 0x3005:09 must be 0x9000",
        _AX8.format("3140:01"), linear=("", "", "")),
    Row("0x3140:02", "Tn", "s", "s", "AX8000: integral time of the velocity loop", _AX8.format("3140:02"), most=5.0),
    Row("0x3062:01", "velocity_feedforward", "1 = 100 %", "",
        "AX8000: velocity feedforward, if the drive follows a position", _AX8.format("3062:01"), most=1.2),
)  # fmt: skip

_AX5_FILTERS = ("P-0-0513", "P-0-0515", "P-0-0516", "P-0-0517")
_AX8_FILTERS = ("0x3163", "0x3183", "0x31A3", "0x31C3")
_LARGEST_DAMPING = 0.99999999
LOW_PASS_1, LOW_PASS_2 = 1, 3  # filter types, the same numbers in both drives


def filters(block: Filter, place: int) -> Filtered:
    """Low passes of both drives; how their notch uses its four numbers is not documented, so it is drawn by hand."""
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
        named = [base + join.format(each) for each in fields]
        lines.append(Line(named[0], str(kind), "type", f"{drive}: {what}", path, what, source))
        lines.append(filter_line(named[1], block.frequency, "Hz", f"{drive}: its corner", f"{path}.frequency", source))
        if isinstance(block, LowPass2):
            lines.append(filter_line(named[2], block.damping, "", f"{drive}: its damping", f"{path}.damping", source))
    return Filtered(tuple(lines))


TWINCAT = Maker(
    key="twincat",
    title="TwinCAT NC axis and AX5000 or AX8000 drive",
    comment="//",
    rows=ROWS,
    held=("following_error_limit",),
    filters=filters,
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
            "sample_time", "", "the NC task and the drive have their own cycles",
            "the margins hold for these delays only: with Kv in the NC the bus delay is in the position loop",
        ),
        LostPart(
            "AX8000: position gain", "", "its object was not found in the manual",
            "set Kv of an AX8000 that follows a position in its Drive Manager, by the units shown there",
        ),
    ),
)  # fmt: skip
