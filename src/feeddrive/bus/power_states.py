"""The power state machine of CiA 402: states, what the statusword says of them, and what the controlword does.

not ready -> switch on disabled -> ready to switch on -> switched on -> operation enabled
operation enabled -> quick stop active -> switch on disabled;   any -> fault reaction active -> fault
"""

from __future__ import annotations

from enum import Enum


class PowerState(Enum):
    """Mask and value of the statusword, and the name in words."""

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
        """As the standard calls it."""
        return self.value[2]

    @property
    def status(self) -> int:
        """Its bits of the statusword, with voltage present."""
        return self.value[1] | 0x10


def state_of(statusword: int) -> PowerState | None:
    """The state, or None for bits that mean none."""
    for state in PowerState:
        mask, value, _ = state.value
        if statusword & mask == value:
            return state
    return None


SHUTDOWN, SWITCH_ON, ENABLE_OPERATION = 0x06, 0x07, 0x0F
DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 0x00, 0x02, 0x80

# to operation enabled: what to send in which state
TOWARDS_ENABLED = {
    PowerState.SWITCH_ON_DISABLED: SHUTDOWN,
    PowerState.READY: SWITCH_ON,
    PowerState.SWITCHED_ON: ENABLE_OPERATION,
    PowerState.ENABLED: ENABLE_OPERATION,
}

# modes of operation
CSP, CSV, CST = 8, 9, 10
MODES = {"csp": CSP, "csv": CSV, "cst": CST}

# error codes that a virtual drive sets, and what they mean in words
ERRORS = {
    0x7305: "broken reading of the encoder",
    0x7500: "the bus stopped while the drive was enabled",
    0x8400: "velocity beyond its limit",
    0x8611: "following error too large",
    0x8612: "position beyond its limit",
    0xFF01: "command that is no number",
}


def _command(controlword: int) -> str:
    """The command in the low bits: bits 0 switch on, 1 enable voltage, 2 quick stop (0: do), 3 enable operation."""
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
    """The state that a drive goes to; a command that a state does not know changes nothing.

    `before` is the controlword of the last cycle: a fault is reset by the rising edge of bit 7 only.
    """
    if state is PowerState.FAULT:
        risen = controlword & FAULT_RESET and not before & FAULT_RESET
        return PowerState.SWITCH_ON_DISABLED if risen else state
    return _NEXT.get(state, {}).get(_command(controlword), state)
