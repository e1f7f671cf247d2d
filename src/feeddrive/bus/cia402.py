"""CiA 402: the drive objects used by the client and the virtual drive, and the power state machine.

Names and indices are those of IEC 61800-7-201; positions are in increments, velocities in increments per second,
torques in thousandths of the rated torque.

not ready -> switch on disabled -> ready to switch on -> switched on -> operation enabled
operation enabled -> quick stop active -> switch on disabled;   any -> fault reaction active -> fault
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple

_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}
_BITS = {"u8": 8, "i8": 8, "u16": 16, "i16": 16, "u32": 32, "i32": 32}


class Object(NamedTuple):
    """An entry of the object dictionary."""

    name: str
    index: int  # type: ignore[assignment]  # hides tuple.index, which is not used
    subindex: int
    type: str
    meaning: str

    @property
    def bits(self) -> int:
        """The size in bits."""
        return _BITS[self.type]

    @property
    def code(self) -> str:
        """The format character of the `struct` module."""
        return _CODES[self.type]

    @property
    def mapped(self) -> int:
        """The 32-bit entry of this object in a PDO mapping: index, subindex, size in bits."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def place(self) -> str:
        """The address as manuals write it, such as `0x607D:01`."""
        return f"0x{self.index:04X}:{self.subindex:02X}"

    def encode(self, value: int) -> bytes:
        """Encode a value in little-endian order, used by both buses. Raises struct.error for a value out of range."""
        return struct.pack("<" + self.code, value)

    def decode(self, content: bytes) -> int:
        """Decode the leading bytes of the content; any bytes beyond the size of the type are ignored."""
        return int(struct.unpack("<" + self.code, content[: self.bits // 8])[0])

    def bounds(self) -> tuple[int, int]:
        """Return the smallest and the largest value of the type."""
        if self.type[0] == "u":
            return 0, (1 << self.bits) - 1
        return -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1


OBJECTS: Mapping[str, Object] = {
    entry.name: entry
    for entry in (
        Object("device_type", 0x1000, 0, "u32", "profile 402, servo drive"),
        Object("vendor", 0x1018, 1, "u32", "maker"),
        Object("product", 0x1018, 2, "u32", "product code"),
        Object("revision", 0x1018, 3, "u32", "revision"),
        Object("serial", 0x1018, 4, "u32", "serial number"),
        Object(
            "connection_option",
            0x6007,
            0,
            "i16",
            "what a lost connection does: 0 nothing, 1 fault, 2 off, 3 quick stop",
        ),
        Object("error_code", 0x603F, 0, "u16", "of the last fault"),
        Object("controlword", 0x6040, 0, "u16", "commanded mode of operation"),
        Object("statusword", 0x6041, 0, "u16", "state of the drive"),
        Object("quick_stop_option", 0x605A, 0, "i16", "what a quick stop does"),
        Object("disable_operation_option", 0x605C, 0, "i16", "what disable operation does: 0 force off, 1 slows down"),
        Object("fault_reaction_option", 0x605E, 0, "i16", "what a fault does: 0 force off, 2 braked as a quick stop"),
        Object("mode", 0x6060, 0, "i8", "mode of operation that is wanted"),
        Object("mode_display", 0x6061, 0, "i8", "mode of operation that runs"),
        Object("position", 0x6064, 0, "i32", "actual position, increments"),
        Object("following_error_window", 0x6065, 0, "u32", "largest following error, increments"),
        Object("following_error_timeout", 0x6066, 0, "u16", "for how long it may be larger before it is a fault, ms"),
        Object("velocity", 0x606C, 0, "i32", "actual velocity, increments/s"),
        Object("target_torque", 0x6071, 0, "i16", "for cyclic synchronous torque, 0.1 % of rated"),
        Object("max_torque", 0x6072, 0, "u16", "largest torque, 0.1 % of rated"),
        Object("rated_torque", 0x6076, 0, "u32", "mN m, or mN of a linear motor"),
        Object("torque", 0x6077, 0, "i16", "actual torque, 0.1 % of rated"),
        Object("target_position", 0x607A, 0, "i32", "for cyclic synchronous position, increments"),
        Object("position_least", 0x607D, 1, "i32", "lower software limit, increments"),
        Object("position_most", 0x607D, 2, "i32", "upper software limit, increments"),
        Object("max_motor_speed", 0x6080, 0, "u32", "largest speed of the motor, turns a minute"),
        Object("quick_stop_deceleration", 0x6085, 0, "u32", "increments/s²"),
        Object("encoder_increments", 0x608F, 1, "u32", "position encoder resolution: increments"),
        Object("encoder_turns", 0x608F, 2, "u32", "position encoder resolution: in so many turns of the motor"),
        Object("gear_motor_turns", 0x6091, 1, "u32", "gear ratio: turns of the motor"),
        Object("gear_shaft_turns", 0x6091, 2, "u32", "gear ratio: in so many turns of the shaft"),
        Object("feed_constant", 0x6092, 1, "u32", "feed constant: increments of 0x6064"),
        Object("feed_shaft_turns", 0x6092, 2, "u32", "feed constant: in so many turns of the shaft"),
        Object("velocity_offset", 0x60B1, 0, "i32", "added to the velocity command, increments/s"),
        Object("torque_offset", 0x60B2, 0, "i16", "added to the torque command, 0.1 % of rated"),
        Object("cycle_value", 0x60C2, 1, "u8", "bus cycle: value"),
        Object("cycle_exponent", 0x60C2, 2, "i8", "bus cycle: power of ten of its unit in s"),
        Object("second_position", 0x60E4, 1, "i32", "additional position: the other encoder, increments"),
        Object("following_error", 0x60F4, 0, "i32", "target - actual position, increments"),
        Object("digital_inputs", 0x60FD, 0, "u32", "inputs of the drive, a bit each: 16 and above are the maker's"),
        Object("target_velocity", 0x60FF, 0, "i32", "for cyclic synchronous velocity, increments/s"),
        Object("supported_modes", 0x6502, 0, "u32", "bit n - 1: mode n"),
    )
}
AT: Mapping[tuple[int, int], Object] = {(entry.index, entry.subindex): entry for entry in OBJECTS.values()}
# a text of any length, unlike the numbers above
DEVICE_NAME = (0x1008, 0)
VIRTUAL = "feeddrive virtual drive"  # the values of a virtual drive

# process data of every cycle, in PDOs of at most 8 bytes: the limit of CAN, kept on EtherCAT to have one mapping
SENT = (
    ("controlword", "mode", "target_position"),
    ("target_velocity", "velocity_offset"),
    ("target_torque", "torque_offset"),
)
TOLD = (
    ("statusword", "mode_display", "position"),
    ("velocity", "following_error"),
    ("torque", "error_code", "second_position"),
)
INPUTS = ("digital_inputs",)  # told as well, only by a drive with a stop input: many have three PDOs at most
NEEDED = ("controlword", "mode", "statusword", "mode_display", "position", "torque")  # a drive without them is refused


class Layout:
    """The process data layout of one direction: groups of objects, one group per PDO."""

    def __init__(self, groups: Sequence[Sequence[str]]) -> None:
        self.groups = tuple(tuple(group) for group in groups if group)
        self.names = tuple(name for group in self.groups for name in group)
        self._struct = struct.Struct("<" + "".join(OBJECTS[name].code for name in self.names))

    @property
    def size(self) -> int:
        """The number of bytes of all groups."""
        return self._struct.size

    def part(self, group: int) -> slice:
        """Return the slice of a group's bytes within the bytes of all groups."""
        sizes = [sum(OBJECTS[name].bits for name in names) // 8 for names in self.groups]
        return slice(sum(sizes[:group]), sum(sizes[: group + 1]))

    def keeping(self, there: Sequence[str]) -> Layout:
        """Return the layout restricted to the objects in `there`."""
        return Layout([[name for name in group if name in there] for group in self.groups])

    def pack(self, values: Mapping[str, int]) -> bytes:
        """Encode all groups. Raises struct.error for a value out of range."""
        return self._struct.pack(*[values[name] for name in self.names])

    def unpack(self, content: bytes) -> dict[str, int]:
        """Decode all groups; return the values by name."""
        return dict(zip(self.names, self._struct.unpack_from(content), strict=True))


class PowerState(Enum):
    """A power state of the drive: mask and value in the statusword, and the name."""

    NOT_READY = (0x4F, 0x00, "not ready to switch on")
    SWITCH_ON_DISABLED = (0x4F, 0x40, "switch on disabled")
    READY = (0x6F, 0x21, "ready to switch on")
    SWITCHED_ON = (0x6F, 0x23, "switched on")
    ENABLED = (0x6F, 0x27, "operation enabled")
    QUICK_STOP = (0x6F, 0x07, "quick stop active")
    FAULT_REACTION = (0x4F, 0x0F, "fault reaction active")
    FAULT = (0x4F, 0x08, "fault")

    @property
    def words(self) -> str:
        """The name used in the standard."""
        return self.value[2]

    @property
    def status(self) -> int:
        """The statusword bits of the state, with the voltage-enabled bit set."""
        return self.value[1] | 0x10


def state_of(statusword: int) -> PowerState | None:
    """Return the power state of a statusword, or None if its bits match no state."""
    for state in PowerState:
        mask, value, _ = state.value
        if statusword & mask == value:
            return state
    return None


# commands in the low byte of the controlword
SHUTDOWN, SWITCH_ON, ENABLE_OPERATION = 0x06, 0x07, 0x0F
DISABLE_OPERATION = SWITCH_ON  # the same bits, from operation enabled: in order, with the brake closed first
DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 0x00, 0x02, 0x80

# the command that leads from each state towards operation enabled
TOWARDS_ENABLED = {
    PowerState.SWITCH_ON_DISABLED: SHUTDOWN,
    PowerState.READY: SWITCH_ON,
    PowerState.SWITCHED_ON: ENABLE_OPERATION,
    PowerState.ENABLED: ENABLE_OPERATION,
}

# modes of operation
CSP, CSV, CST = 8, 9, 10  # values of the mode of operation, 0x6060
MODES = {"csp": CSP, "csv": CSV, "cst": CST}

# error codes set by a virtual drive; CiA 402 leaves 0xFF00 and above to the manufacturer
ERRORS = {
    0x2310: "overcurrent",
    0x7305: "broken reading of the encoder",
    0x7500: "the bus stopped while the drive was enabled",
    0x8400: "velocity beyond its limit",
    0x8611: "following error too large",
    0x8612: "position beyond its limit",
    0xFF01: "command that is NaN",
}


def _command(controlword: int) -> str:
    """Return the command in the low bits of a controlword.

    Bits: 0 switch on, 1 enable voltage, 2 quick stop (active low), 3 enable operation.
    """
    # in this order: the command table leaves the other bits open (X) where one of these is 0
    if not controlword & 0x02:
        return "disable voltage"
    if not controlword & 0x04:
        return "quick stop"
    if not controlword & 0x01:
        return "shutdown"
    return "enable operation" if controlword & 0x08 else "switch on"


_NEXT: dict[PowerState, dict[str, PowerState]] = {
    PowerState.SWITCH_ON_DISABLED: {"shutdown": PowerState.READY},
    PowerState.READY: {
        "switch on": PowerState.SWITCHED_ON,
        "disable voltage": PowerState.SWITCH_ON_DISABLED,
        "quick stop": PowerState.SWITCH_ON_DISABLED,
    },
    PowerState.SWITCHED_ON: {
        "enable operation": PowerState.ENABLED,
        "shutdown": PowerState.READY,
        "disable voltage": PowerState.SWITCH_ON_DISABLED,
        "quick stop": PowerState.SWITCH_ON_DISABLED,
    },
    PowerState.ENABLED: {
        "switch on": PowerState.SWITCHED_ON,
        "shutdown": PowerState.READY,
        "disable voltage": PowerState.SWITCH_ON_DISABLED,
        "quick stop": PowerState.QUICK_STOP,
    },
    PowerState.QUICK_STOP: {"disable voltage": PowerState.SWITCH_ON_DISABLED},
}


def answer(state: PowerState, controlword: int, before: int) -> PowerState:
    """Return the next power state; a command without a transition from the present state has no effect.

    `before` is the controlword of the last cycle: a fault is reset only by a rising edge of bit 7.
    """
    if state is PowerState.FAULT:
        risen = controlword & FAULT_RESET and not before & FAULT_RESET
        return PowerState.SWITCH_ON_DISABLED if risen else state
    return _NEXT.get(state, {}).get(_command(controlword), state)
