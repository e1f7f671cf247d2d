"""Tables of pitch error and backlash of a control, as the files that LinuxCNC, SINUMERIK and TwinCAT document.

An entry of `PitchCompensation` is what is added to the set position: nominal minus reached position.  LinuxCNC adds its
trims as well, for each direction.  SINUMERIK and TwinCAT add their value to the position that the encoder reads, so
that it has the other sign: reached minus nominal; they have one table for both directions, the mean, and a backlash.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop

# LinuxCNC's documentation of COMP_FILE: "the limit inside LinuxCNC is for 256 triplets per joint"
MOST_TRIPLETS = 256


class PitchFile(NamedTuple):
    """A file with a table, what must be set beside it as (name, value, meaning), and what it leaves of the error, m."""

    name: str
    text: str
    settings: tuple[tuple[str, str, str], ...]
    source: str
    remains: float = 0.0
    absent: str = ""


class Pitch(NamedTuple):
    """The tables of a control in the unit of a controller, mm or degrees: positions and entries by direction."""

    axis: str
    unit: str
    place: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    factor: float

    @property
    def mean(self) -> np.ndarray:
        """The mean of both directions."""
        return 0.5 * (self.forward + self.backward)

    @property
    def backlash(self) -> float:
        """The mean difference between the directions."""
        return float(np.mean(self.forward - self.backward))

    @property
    def remains(self) -> float:
        """The largest error in SI that one table for both directions and one backlash leave."""
        return float(np.max(np.abs(self.forward - self.backward - self.backlash))) / 2.0 / self.factor


def pitch_compensations(loop: Loop) -> list[int]:
    """Return the indices of the pitch compensations among the compensations of a control."""
    return [i for i, block in enumerate(loop.control.compensation) if isinstance(block, PitchCompensation)]


def pitch_file(maker: str, loop: Loop) -> PitchFile | None:
    """Return the table of a control as a file of a maker; None if there is no table, or no file of this maker.

    LinuxCNC's files are in mm: there is none for an axis that turns.  `absent` of the result gives the reason why a
    table cannot be written.
    """
    found = pitch_compensations(loop)
    if not found or maker not in _WRITERS or (maker == "linuxcnc" and loop.axis.rotary):
        return None
    writer = _WRITERS[maker]
    if len(found) > 1:
        where = ", ".join(f"control.compensation.{i}" for i in found)
        return PitchFile("", "", (), "", absent=f"{where} are several tables, and the controller has one: add them up")
    block = loop.control.compensation[found[0]]
    assert isinstance(block, PitchCompensation)
    factor, unit = (180.0 / math.pi, "deg") if loop.axis.rotary else (1e3, "mm")
    forward, backward = (factor * np.asarray(row, dtype=float) for row in (block.forward, block.backward))
    place = factor * (float(block.table_start) + float(block.spacing) * np.arange(forward.size))
    return writer(Pitch(loop.name, unit, place, forward, backward, factor))


def _number(value: float) -> str:
    """Return a decimal without an exponent, to a nanometer or a millionth of a degree."""
    text = f"{value:.6f}".rstrip("0")
    return f"{text}0" if text.endswith(".") else text


def _linuxcnc(pitch: Pitch) -> PitchFile:
    """Return a compensation file of type 1: nominal position, trim of the positive and of the negative direction.

    It has no comments, since LinuxCNC stops reading at the first line that is no triplet.
    """
    name = f"linuxcnc_pitch_{pitch.axis}.txt"
    if pitch.place.size > MOST_TRIPLETS:
        reason = f"{pitch.place.size} positions, and LinuxCNC reads {MOST_TRIPLETS}: give the table a larger spacing"
        return PitchFile("", "", (), _LINUXCNC, absent=reason)
    rows = zip(pitch.place, pitch.forward, pitch.backward, strict=True)
    text = "".join(f"{' '.join(map(_number, row))}\n" for row in rows)
    settings = (
        ("COMP_FILE", name, "in [JOINT_n] of the .ini"),
        ("COMP_FILE_TYPE", "1", "trims of both directions; BACKLASH is then not used"),
    )
    return PitchFile(name, text, settings, _LINUXCNC)


def _sinumerik(pitch: Pitch) -> PitchFile:
    """Return a table of the leadscrew error compensation: the mean of both directions, and the backlash beside it."""
    axis, most = f"{pitch.axis.upper()}1", pitch.place.size
    values = [f"$AA_ENC_COMP[0,{i},{axis}]={_number(-value)}" for i, value in enumerate(pitch.mean)]
    text = "\n".join(
        [
            "%_N_AX_EEC_INI",
            "CHANDATA(1)",
            f"; machine axis {axis}, encoder 0: put in yours. Positions count from the machine zero",
            f"; values in {pitch.unit}: reached minus nominal position, the mean of both directions",
            "; the value at the reference point must be 0: if it is not, take it off all values",
            *values,
            f"$AA_ENC_COMP_STEP[0,{axis}]={_number(float(pitch.place[1] - pitch.place[0]) if most > 1 else 1.0)}",
            f"$AA_ENC_COMP_MIN[0,{axis}]={_number(float(pitch.place[0]))}",
            f"$AA_ENC_COMP_MAX[0,{axis}]={_number(float(pitch.place[-1]))}",
            f"$AA_ENC_COMP_IS_MODULO[0,{axis}]=0",
            "M17",
            "",
        ]
    )
    settings = (
        ("MD38000 $MA_MM_ENC_COMP_MAX_POINTS[0]", str(most), "at least; before the table is loaded"),
        ("MD32700 $MA_ENC_COMP_ENABLE[0]", "1", "after the table is loaded; it acts once the axis is referenced"),
        ("MD32450 $MA_BACKLASH[0]", _number(pitch.backlash), f"{pitch.unit}; positive if the encoder leads the table"),
    )
    return PitchFile(f"sinumerik_pitch_{pitch.axis}.ini", text, settings, _SINUMERIK, pitch.remains)


def _twincat(pitch: Pitch) -> PitchFile:
    """Return a table for MC_TableBasedPositionCompensation as global variables of a PLC."""
    name, count = f"{pitch.axis}_pitch", pitch.place.size
    rows = [
        f"        (Position := {_number(float(place))}, Compensation := {_number(-float(value))})"
        for place, value in zip(pitch.place, pitch.mean, strict=True)
    ]
    text = "\n".join(
        [
            f"(* MC_TableBasedPositionCompensation of axis {pitch.axis}, in {pitch.unit}: added to the position read.",
            "   Reached minus nominal position, the mean of both directions. The sign is NOT CHECKED: compare one",
            "   position with and without the table before you use it. *)",
            "VAR_GLOBAL",
            f"    {name} : ARRAY[0..{count - 1}] OF ST_PositionCompensationTableElement := [",
            ",\n".join(rows),
            "    ];",
            f"    {name}_parameter : ST_PositionCompensationTableParameter := (",
            f"        MinPosition := {_number(float(pitch.place[0]))},",
            f"        MaxPosition := {_number(float(pitch.place[-1]))},",
            f"        NoOfTableElements := {count},",
            "        Direction := E_WorkDirection.WorkDirectionBoth,",
            "        Modulo := FALSE);",
            "END_VAR",
            "",
        ]
    )
    settings = (
        ("Position Correction", "TRUE", "a parameter of the axis"),
        (
            "Backlash of MC_BacklashCompensation",
            _number(pitch.backlash),
            f"{pitch.unit}; it writes the same position correction: add both by MC_PositionCorrectionLimiter; its sign "
            "is NOT CHECKED",
        ),
    )
    return PitchFile(f"twincat_pitch_{pitch.axis}.st", text, settings, _TWINCAT, pitch.remains)


_LINUXCNC = "LinuxCNC documentation, INI Configuration, [JOINT_n] COMP_FILE and COMP_FILE_TYPE; tried in LinuxCNC 2.9"
_SINUMERIK = (
    "SINUMERIK 840D sl/828D Extended Functions, 03/2013, 6FC5397-1BP40-3BA1, K3, p. 233 and 242 (form, backlash); "
    "SINUMERIK 808D Function Manual, 01/2017, p. 106 (sign: a positive value moves the axis in the negative direction)"
)
_TWINCAT = (
    "Beckhoff Infosys, TC3 PLC Lib Tc2_MC2: MC_TableBasedPositionCompensation, ST_PositionCompensationTableElement and "
    "-Parameter (form); the sign is that of MC_PositionCorrectionLimiter, added to the actual position: NOT CHECKED"
)
_WRITERS: Mapping[str, Callable[[Pitch], PitchFile]] = {
    "linuxcnc": _linuxcnc,
    "sinumerik": _sinumerik,
    "twincat": _twincat,
}


def remark(file: PitchFile, *, turns: bool) -> str:
    """Return the sentence on what a file leaves of the error, for the README."""
    if file.remains == 0.0:
        return "Both directions are represented entry by entry."
    left = Quantity(file.remains, "rad" if turns else "m")
    return str(
        Text(f"One table and one backlash for the whole travel leave up to {left:2} of what the directions differ by.")
    )
