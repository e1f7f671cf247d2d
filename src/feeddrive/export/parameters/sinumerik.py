"""Parameters of SINUMERIK with SINAMICS drives: axis machine data and drive parameters."""

from __future__ import annotations

from collections.abc import Iterator

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.export.parameters.maker import Filtered, Line, Maker, Row, filter_line
from feeddrive.export.parameters.quantities import LostPart

_GAIN = "SINUMERIK 808D ADVANCED Parameter Manual, 08/2015, p. 234"
_SETS = "SINUMERIK 840D sl/828D Basic Functions, 09/2011, G2, p. 378 (the name; the unit is that in common use)"
_ENDS = "SINUMERIK 840D sl/828D Basic Functions, 01/2015, Z1, p. 1591 (the name; the unit is that in common use)"
_PITCH = "SINUMERIK 840D sl/828D Basic Functions, 01/2015, G2, p. 349"
_FORM = (
    "form of the filter: SINAMICS S120 Function Manual FH1, 07/2007, p. 81; "
    "its parameter numbers were NOT CHECKED against the list manual"
)

ROWS = (
    Row("MD31030 $MA_LEADSCREW_PITCH", "lead", "mm/rev", "mm", "lead of the screw; must be there already", _PITCH),
    Row("MD32200 $MA_POSCTRL_GAIN[0]", "Kv", "1000/min = (m/min)/mm", "m_per_min_per_mm", "servo gain Kv", _GAIN),
    Row("MD32610 $MA_VELO_FFW_WEIGHT[0]", "velocity_feedforward", "1 = 100 %", "", "share of the set velocity", _SETS),
    Row("MD32650 $MA_AX_INERTIA", "mass", "kg m2", "kg m2", "inertia at the motor for torque precontrol",
        linear=("MD32652 $MA_AX_MASS", "kg", "kg")),
    Row("MD36200 $MA_AX_VELO_LIMIT[0]", "table_velocity_limit", "mm/min", "mm_per_min", "speed that trips", _SETS),
    Row("MD36100 $MA_POS_LIMIT_MINUS", "travel_least", "mm", "mm", "software limit", _ENDS),
    Row("MD36110 $MA_POS_LIMIT_PLUS", "travel_most", "mm", "mm", "software limit", _ENDS),
    Row("p1460[0]", "Kp", "Nms/rad", "N m s/rad", "P gain of the speed controller",
        linear=("p1460[0]", "Ns/m", "N s/m")),
    Row("p1462[0]", "Tn", "ms", "ms", "integral time of the speed controller"),
    Row("p1520[0]", "force_limit", "Nm", "N m", "upper torque limit", linear=("p1520[0]", "N", "N")),
    Row("p1521[0]", "force_limit", "Nm", "N m", "lower torque limit", linear=("p1521[0]", "N", "N"), scale=-1.0),
)  # fmt: skip

FILTERS = 4  # current setpoint filters of a drive
PT2, GENERAL = 1, 2  # types of p1657
_FIRST, _STEP = 1657, 5  # p1657 .. p1661 are the first filter, p1662 .. p1666 the second


def filters(block: Filter, place: int) -> Filtered:
    """A current setpoint filter: PT2 or general second order, as natural frequencies and dampings."""
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
    yield Line(
        f"p1656[0].{place}", "1", "bit", f"switches current setpoint filter {place + 1} on", path, "on", _FORM
    )  # fmt: skip
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
    rows=ROWS,
    held=("inertia", "force_limit", "velocity_limit", "travel"),
    filters=filters,
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
    },
    notes=(
        "Parameter set 0; repeat for the sets of other gear stages.  MD32620 $MA_FFW_MODE chooses the precontrol.",
        "If the design has no integral time, see the list manual how the speed controller is run without one.",
    ),
    always=(
        LostPart(
            "sample_time", "", "position control runs in the control's cycle, the speed loop in the drive's",
            "the margins hold for these delays only: check them with the control's frequency response",
        ),
        LostPart(
            "control.filters", "", "current setpoint filters stand behind the sum of feedback and precontrol",
            "the feedforward passes the filters and is delayed by them",
        ),
    ),
)  # fmt: skip
