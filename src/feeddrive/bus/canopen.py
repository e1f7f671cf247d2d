"""CANopen transport via the canopen package: process data on every SYNC, on a CAN bus such as `socketcan:can0`."""

import contextlib
import logging
import time
from threading import Condition, Event
from typing import Any

from feeddrive.bus.cia402 import Layout
from feeddrive.bus.transport import Claim, RefusedError, write_mapping
from feeddrive.language.errors import BusError, MissingExtraError, ParameterError

# CiA 301: COB-ID of SYNC, the bit that disables a PDO, and transmission type 1, with every SYNC.
_SYNC, _INVALID, _EVERY_SYNC = 0x80, 1 << 31, 1
_CONSUMER, _BEAT, _OPERATING = 0x1016, 0x700, b"\x05"  # heartbeat: consumer time, COB-ID, state byte
# longer than the cycle of a usual master; each start of a motion waits for it
_LISTENING = 0.05  # s in which another master must have sent a SYNC
# short: the node is asked while a motion ends, for the message or to restore its heartbeat
_LOOKING = 0.3  # s for an answer of a node that is silent already


class CANopen:
    """A CANopen node on a bus supported by python-can. See `Transport`."""

    def __init__(self, interface: str, station: int, bitrate: int | None = None) -> None:
        self.interface, self.station, self._bitrate = interface, station, bitrate
        self.where = f"CANopen {interface}, node {station}"
        self._network: Any = None
        self._node: Any = None
        self._sent = self._told = Layout(())
        self._content = b""
        self._arrived: dict[int, bytes] = {}
        self._news = Condition()
        self._claim = Claim()
        # the heartbeat needs a node number on the bus: any but that of the drive
        self._master = 127 if station != 127 else 126
        self._beat: float | None = None  # s from one heartbeat to the next
        self._beaten = 0.0
        self._listened: bytes | None = None  # heartbeat that the drive monitored before
        self._late = False  # whether answers to the last SYNC may still come

    def open(self) -> None:
        """Find the node and switch it to PRE-OPERATIONAL."""
        self._canopen = packages()
        self._claim.take(self.where, self.interface)
        self._network = opened_network(self.interface, self._bitrate)
        self._check_alone()
        self._node = self._network.add_node(self.station, self._canopen.ObjectDictionary())
        self._node.sdo.RESPONSE_TIMEOUT = 1.0
        self._node.nmt.state = "PRE-OPERATIONAL"
        try:
            self.read(0x1000, 0)
        except BusError:
            raise BusError(
                f"{self.where}: does not answer; check cable, termination, bit rate and `station` in the drive file"
            ) from None

    def _check_alone(self) -> None:
        """Raise BusError if another master sends SYNC: drives would answer both masters, and the NMT commands of this
        one would stop the drives of the other.
        """
        heard = Event()
        self._network.subscribe(_SYNC, lambda *_: heard.set())
        if heard.wait(_LISTENING):
            raise BusError(
                f"{self.where}: another master sends SYNC on this bus: end it first, since it would lose its drives; "
                "nothing was sent"
            )
        self._network.unsubscribe(_SYNC)

    def read(self, index: int, subindex: int) -> bytes:
        """Read an object by SDO."""
        try:
            return bytes(self._node.sdo.upload(index, subindex))
        except self._canopen.SdoAbortedError as error:
            raise RefusedError(self.where, index, subindex, error.code, False) from None
        except self._canopen.SdoCommunicationError:
            raise self._silent(index, subindex) from None

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Write an object by SDO."""
        try:
            self._node.sdo.download(index, subindex, content)
        except self._canopen.SdoAbortedError as error:
            raise RefusedError(self.where, index, subindex, error.code, True) from None
        except self._canopen.SdoCommunicationError:
            raise self._silent(index, subindex) from None

    def _silent(self, index: int, subindex: int) -> BusError:
        return BusError(f"{self.where}: object 0x{index:04X}:{subindex:02X} was not answered")

    def map(self, sent: Layout, told: Layout) -> None:
        """Disable each PDO, map it, and enable it again for transmission on every SYNC."""
        self._sent, self._told = sent, told
        # COB-IDs of the predefined connection set (CiA 301)
        self._of_sent = [0x200 + 0x100 * k + self.station for k in range(len(sent.groups))]
        self._of_told = [0x180 + 0x100 * k + self.station for k in range(len(told.groups))]
        for talks, maps, layout, messages in (
            (0x1400, 0x1600, sent, self._of_sent),
            (0x1800, 0x1A00, told, self._of_told),
        ):
            # CiA 301: a PDO can be mapped only while it is switched off
            for k, message in enumerate(messages):
                self.write(talks + k, 1, (message | _INVALID).to_bytes(4, "little"))
                self.write(talks + k, 2, bytes([_EVERY_SYNC]))
            write_mapping(self, maps, layout)
            for k, message in enumerate(messages):
                self.write(talks + k, 1, message.to_bytes(4, "little"))
        for message in self._of_told:
            self._network.subscribe(message, self._arrive)

    def _arrive(self, message: int, content: bytearray, stamp: float) -> None:
        with self._news:
            self._arrived[message] = bytes(content)
            if len(self._arrived) == len(self._of_told):
                self._news.notify()

    def watch(self, seconds: float) -> None:
        """Make the drive monitor the heartbeat of this master (0x1016:01), which is sent along with the cycles."""
        wanted = (self._master << 16 | max(1, round(1e3 * seconds))).to_bytes(4, "little")
        try:
            before = self.read(_CONSUMER, 1)
            self.write(_CONSUMER, 1, wanted)
        except RefusedError as error:
            raise BusError(
                f"{self.where}: has no watchdog over CANopen (object 0x1016:01, code 0x{error.code:08X}): without it "
                "the axis runs on when this computer stops; write `watchdog_ms = 0` into the drive file if you "
                "accept that"
            ) from None
        self._listened = before
        if (got := self.read(_CONSUMER, 1)) != wanted:
            raise BusError(
                f"{self.where}: its watchdog (object 0x1016:01) was set to {wanted[::-1].hex()} and reads back as "
                f"{got[::-1].hex()}: choose another `watchdog_ms` in the drive file"
            )
        # five heartbeats in the time of the watchdog: losing one does not stop the drive
        self._beat = 0.2 * seconds

    def operate(self, content: bytes) -> None:
        """Switch the node to OPERATIONAL; raise BusError if no process data follow."""
        self._node.nmt.state = "OPERATIONAL"
        self.put(content)
        # an NMT command is not acknowledged: only process data show that the node obeyed
        for _ in range(20):
            if self.take(0.1) is not None:
                return
        raise BusError(f"{self.where}: sends no process data in OPERATIONAL")

    def put(self, content: bytes) -> None:
        """Set the outputs of the next SYNC."""
        self._content = content

    def take(self, timeout: float) -> bytes | None:
        """Send all PDOs and SYNC, and return all answers; None if an answer is missing."""
        with self._news:
            # late answers to the last SYNC must not pass for answers to this one
            if self._late:
                self._news.wait_for(lambda: len(self._arrived) == len(self._of_told), timeout)
            self._arrived.clear()
        try:
            self._send(self._content)
        except OSError:
            # the interface is gone, or the controller is bus-off: no answer will arrive
            return None
        with self._news:
            whole = self._news.wait_for(lambda: len(self._arrived) == len(self._of_told), timeout)
            self._late = not whole
            if not whole:
                return None
            return b"".join(self._arrived[message] for message in self._of_told)

    def _send(self, content: bytes) -> None:
        """Send all PDOs and SYNC, after a heartbeat if one is due, so that the heartbeat stops with the cycles."""
        now = time.monotonic()
        if self._beat is not None and now - self._beaten >= self._beat:
            self._network.send_message(_BEAT + self._master, _OPERATING)
            self._beaten = now
        for k, message in enumerate(self._of_sent):
            self._network.send_message(message, content[self._sent.part(k)])
        self._network.send_message(_SYNC, b"")

    def state(self) -> str:
        """Return a clause for an error message that states whether the node still answers."""
        self._node.sdo.RESPONSE_TIMEOUT = _LOOKING
        try:
            self.read(0x1000, 0)
        except BusError:
            return "it does not answer"
        return "it answers, but sends no process data: it may have left OPERATIONAL"

    def close(self) -> None:
        """Switch the node to PRE-OPERATIONAL and restore the heartbeat that it monitored before."""
        self._claim.free()
        if self._network is None:
            return
        # a failure on a dead bus must not replace the error that led here
        with contextlib.suppress(Exception):
            node = self._node
            if node is not None:
                node.nmt.state = "PRE-OPERATIONAL"
            if node is not None and self._listened is not None:
                node.sdo.RESPONSE_TIMEOUT = _LOOKING
                self.write(_CONSUMER, 1, self._listened)
        with contextlib.suppress(Exception):
            self._network.disconnect()
        self._network = None


def packages() -> Any:
    """Return the canopen package. Raises MissingExtraError if it is missing."""
    try:
        import canopen
    except ImportError as missing:
        raise MissingExtraError(missing.name or "canopen", "bus", "CANopen") from None
    # errors are raised as BusError: without a handler logging would print them a second time
    logging.getLogger("canopen").addHandler(logging.NullHandler())
    return canopen


def opened_network(interface: str, bitrate: int | None) -> Any:
    """Open a canopen network on a bus. Raises ParameterError for an unknown bus, BusError if it cannot be opened."""
    canopen = packages()
    import can

    kind, _, channel = interface.partition(":")
    if kind not in can.VALID_INTERFACES or not channel:
        raise ParameterError(
            f"interface '{interface}' must name what python-can calls interface and channel, as socketcan:can0; "
            f"it knows {', '.join(sorted(can.VALID_INTERFACES))}"
        )
    rate: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}
    try:
        line = can.Bus(channel=channel, interface=kind, **rate)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise BusError(
            f"interface '{interface}' cannot be opened: {error}; is it there and up "
            "(ip link set can0 up type can bitrate 1000000)?"
        ) from None
    network = canopen.Network(line)
    # s; disconnecting waits for the receive thread, which looks for its end once in this time
    network.NOTIFIER_CYCLE = 0.1
    network.connect()
    return network
