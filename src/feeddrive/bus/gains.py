"""Gains of a drive that closes all loops by itself: objects of its dictionary, written and read back.

    [gains.Kv]
    object = "0x60FB:1"        # index and subindex, as in the manual of the drive
    type = "i32"
    factor = 0.01              # of one count, in `unit`
    unit = "1/s"

    value = count · factor unit

The names are those of the cascade (`CascadePPI`); Ki = Kp / Tn is for drives that have it in place of Tn.  Gains of a
rotary motor, in N m s/rad (Kp) and N m/rad (Ki), are referred to the table: (2π gear / lead)² as large.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from typing import Protocol

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.bus.transport import RefusedError, Transport
from feeddrive.files.section import Section, text
from feeddrive.language import units
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import BusError, ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.control import Control

GAINS: Mapping[str, tuple[str, str]] = {
    "Kv": ("1/s", ""),
    "Kp": ("N s/m", "N m s/rad"),
    "Tn": ("s", ""),
    "Ki": ("N/m", "N m/rad"),
}
"""The gains by name: their unit, and that of a rotary motor."""
_CODES = {"i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I", "f32": "f"}
_PLACE = re.compile(r"0x([0-9A-Fa-f]{4}):(?:0x)?([0-9A-Fa-f]{1,2})")


class GainSection(Section):
    """An object of the drive that holds a gain."""

    object: str = text("index and subindex (hexadecimal), as the manual of the drive writes them", example='"0x60FB:1"')
    type: str = choice("type of the object; f32: REAL32", options=tuple(_CODES), default="i32")
    factor: Number = parameter("", "value of one count, in `unit`", above=0, default=1)
    unit: str = text("unit of the value, such as 1/s, ms, N m s/rad", default="")

    def check(self) -> None:
        """Raise ParameterError for an address that is none."""
        if not _PLACE.fullmatch(self.object):
            raise self.error(f"object = '{self.object}' must be an index and a subindex, as in \"0x60FB:1\"", "object")

    @property
    def place(self) -> tuple[int, int]:
        """The index and the subindex."""
        found = _PLACE.fullmatch(self.object)
        assert found is not None
        return int(found[1], 16), int(found[2], 16)

    @property
    def is_whole(self) -> bool:
        """True if the object holds whole numbers."""
        return self.type != "f32"

    def read(self, transport: Transport) -> float:
        """Return the counts in the drive. Raises RefusedError."""
        code = _CODES[self.type]
        return struct.unpack(f"<{code}", transport.read(*self.place)[: struct.calcsize(code)])[0]

    def write(self, transport: Transport, counts: float) -> None:
        """Write counts to the drive. Raises RefusedError, and struct.error for a number beyond the type."""
        value = round(counts) if self.is_whole else counts
        transport.write(*self.place, struct.pack(f"<{_CODES[self.type]}", value))


class _Scaling(Protocol):
    """What is needed of the scaling of a drive: is its motor a rotary one, and the travel in one turn of it, m."""

    @property
    def turns(self) -> bool: ...

    @property
    def travel_per_turn(self) -> float: ...


def check_gain(name: str, gain: GainSection, rotary: bool) -> None:
    """Raise ParameterError if the unit of a gain is of another kind than the gain."""
    _unit(name, gain, rotary)


def _unit(name: str, gain: GainSection, rotary: bool) -> tuple[float, bool]:
    """Return the factor from the unit of a gain to SI, and True if it is a unit of the motor."""
    unit = gain.unit or GAINS[name][0]
    for declared, of_motor in zip(GAINS[name], (False, True), strict=True):
        wanted = units.turning(declared) if rotary else declared
        try:
            if declared:
                # of an axis that turns both are the same unit, and it is the motor that a drive knows
                return units.factor(unit, wanted), of_motor or (rotary and bool(GAINS[name][1]))
        except ParameterError:
            continue
    allowed = " or ".join(filter(None, GAINS[name]))
    raise gain.error(f"gains.{name}: unit = '{gain.unit}' must be one like {allowed}", "unit")


def step_of(name: str, gain: GainSection, scaling: _Scaling, *, rotary: bool) -> float:
    """Return the value of one count in SI at the table."""
    factor, of_motor = _unit(name, gain, rotary)
    reduction = (2.0 * math.pi / scaling.travel_per_turn) ** 2 if of_motor and scaling.turns else 1.0
    return float(gain.factor) * factor * reduction


def gains_of(control: Control) -> dict[str, float]:
    """Return the gains of a cascade in SI. Raises StructureError for a control that is more than its gains."""
    law = control.law
    if not isinstance(law, CascadePPI):
        raise StructureError(
            f"control.law: {law.kind} is no cascade, and the gains of the drive file are those of one: tune a "
            "cascade_ppi, or leave [gains] out and let the control run in the master"
        )
    held = [name for name in ("prefilter", "filters", "compensation", "feedforward") if getattr(control, name)]
    if held:
        raise StructureError(
            f"control.{held[0]} is beside the gains that the drive gets: leave it out of the machine file, or leave "
            "[gains] out of the drive file and let the control run in the master"
        )
    gains = {"Kv": float(law.Kv), "Kp": float(law.Kp)}
    if law.Tn is not None:
        gains |= {"Tn": float(law.Tn), "Ki": float(law.Kp) / float(law.Tn)}
    return gains


def write_gains(
    transport: Transport, gains: Mapping[str, GainSection], wanted: Mapping[str, float], scaling: _Scaling, rotary: bool
) -> list[str]:
    """Write gains (SI) and read them back; return a sentence for each.

    Raises BusError, after the old values were written again, for a value that is refused or reads back by more than
    half a step from the one that is wanted.
    """
    missing = [name for name in gains if name not in wanted]
    if missing:
        raise BusError(
            f"{transport.where}: gains.{missing[0]} is in the drive file, and the control has none: without an "
            "integral part it cannot be written"
        )
    before: dict[str, float] = {}
    told: list[str] = []
    try:
        for name, gain in gains.items():
            step = step_of(name, gain, scaling, rotary=rotary)
            counts = wanted[name] / step
            before[name] = gain.read(transport)
            gain.write(transport, counts)
            got = gain.read(transport)
            # of the 24 bits of a REAL32 the last one is rounded
            half = 0.5 + 1e-9 * abs(counts) if gain.is_whole else 2.0**-24 * abs(counts)
            unit = units.turning(GAINS[name][0]) if rotary else GAINS[name][0]
            value = Quantity(wanted[name], unit)
            if abs(got - counts) > half:
                raise BusError(
                    Text(
                        f"{transport.where}: {name} = {value:6 SI} was written to {gain.object} as {counts:.9g} and "
                        f"reads back as {got:.9g}: the drive does not take it"
                    )
                )
            told.append(Text(f"{gain.object}: {name} = {Quantity(got * step, unit):6 SI} ({before[name]:.9g} before)"))
    except (BusError, RefusedError, struct.error) as error:
        for name, counts in before.items():
            gains[name].write(transport, counts)
        if isinstance(error, struct.error):
            raise BusError(
                f"{transport.where}: a gain does not fit into its object ({error}): look at [gains] of the drive file"
            ) from None
        raise
    return told
