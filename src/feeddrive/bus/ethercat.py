"""EtherCAT transport via pysoem, for one or several drives of a segment, and checks of the network interface."""

from __future__ import annotations

import contextlib
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from feeddrive.bus.cia402 import Layout
from feeddrive.bus.transport import Claim, RefusedError, holds_mapping, write_mapping
from feeddrive.language.errors import BusError, MissingExtraError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

_ATTEMPTS = 4  # repetitions for an object whose frame was lost, and for an incomplete mapping
_PATIENCE = 20_000  # us for a frame to come back at standstill, for a busy computer
_STEP = 50_000  # us for a change of state
_LISTENING = 0.05  # s in which another master must have sent a frame
_EVERYTHING = 0x0003  # ETH_P_ALL: sent frames are received, too
_OUTPUTS_CONTROL, _FEEDS_WATCHDOG = 0x0814, 0x40  # of sync manager 2: its control, and the bit of its watchdog
_TOWARDS_OP = 2.0  # s of process data until a slave must be in OP


class Segment:
    """The jointly driven stations of an interface: one frame per cycle carries the outputs of all stations.

    Each station calls open, map and operate; a step of the whole segment runs once the last station is ready for it.
    """

    def __init__(self, interface: str) -> None:
        self.interface = interface
        self.stations: list[EtherCAT] = []
        self.master: Any = None
        self.soem: Any = None
        self._claim = Claim()
        self._put: set[int] = set()  # stations whose outputs wait for the next frame
        self._back = False  # whether the last frame came back whole

    def open(self, where: str) -> None:
        """Open the master and switch the segment to PRE-OP, on the first call only."""
        if self.master is not None:
            return
        try:
            import pysoem
        except ImportError:
            raise MissingExtraError("pysoem", "bus", "EtherCAT") from None
        check_interface(self.interface)
        self._claim.take(where, self.interface)
        _check_alone(where, self.interface)
        self.soem = pysoem
        # other threads of the process run while the master waits for a frame
        pysoem.settings.always_release_gil = True
        pysoem.settings.timeouts.ret = _PATIENCE
        pysoem.settings.timeouts.safe = 2 * _PATIENCE
        self.master = pysoem.Master()
        try:
            self.master.open(self.interface)
        except ConnectionError:
            self.master = None
            raise BusError(not_permitted(self.interface)) from None
        self.find()

    def find(self) -> None:
        """Switch all stations from INIT to PRE-OP, which clears FMMUs and sync managers of an earlier mapping."""
        count = self.master.config_init()
        if count <= 0:
            raise BusError(
                f"EtherCAT {self.interface}: no station answers; check cable, supply, and that it is the interface to "
                "the drives"
            )
        for station in self.stations:
            if station.station > count:
                raise BusError(
                    f"EtherCAT {self.interface}: station {station.station} is not there, there are {count}; "
                    "correct `station` in the drive file"
                )
            station.slave = self.master.slaves[station.station - 1]

    def map(self) -> None:
        """Map the process data once all stations are assigned; see `EtherCAT.map`."""
        if not all(station.assigned for station in self.stations):
            return
        wrong = ""
        for attempt in range(_ATTEMPTS):
            if attempt:
                self.find()
                for station in self.stations:
                    station.assign()
            try:
                self.master.config_map()
            except self.soem.ConfigMapError as error:
                wrong = f"{self.stations[0].where}: the process data cannot be mapped: {error.error_list}"
                continue
            reports = [station.wrongly_mapped() for station in self.stations]
            wrong = next((fault for fault, _ in reports if fault), "")
            if not wrong:
                return
            # not on the first attempt: a lost answer may look like a fixed mapping
            if attempt and any(fixed for _, fixed in reports):
                break
        raise BusError(wrong)

    def operate(self) -> None:
        """Switch all stations to SAFE-OP and OP once they are ready.

        Process data are exchanged during the transition, since drives monitor their arrival.
        """
        if not all(station.ready for station in self.stations):
            return
        if self.master.state_check(self.soem.SAFEOP_STATE, 10 * _STEP) != self.soem.SAFEOP_STATE:
            raise BusError(self._behind("SAFE-OP", self.soem.SAFEOP_STATE))
        # a slave enters OP only with valid outputs, which it must have received in SAFE-OP
        self.exchange(0.1)
        self.master.state = self.soem.OP_STATE
        self.master.write_state()
        until = time.monotonic() + _TOWARDS_OP
        while time.monotonic() < until:
            self.exchange(0.1)
            if self.master.state_check(self.soem.OP_STATE, 2000) == self.soem.OP_STATE:
                return
        raise BusError(self._behind("OP", self.soem.OP_STATE))

    def _behind(self, name: str, wanted: int) -> str:
        """Return an error message that names the first station not in the wanted state, and its present state."""
        self.master.read_state()
        # the state may have been reached just after the timeout: then the first station is named
        late = [station for station in self.stations if station.slave.state != wanted] or self.stations
        return f"{late[0].where}: does not go to {name}: {late[0].state()}"

    def put(self, station: int) -> None:
        """Mark the outputs of a station as new."""
        self._put.add(station)

    def took(self, station: int, timeout: float) -> bool:
        """Send the frame of this cycle if the station has new outputs; return True if the frame came back complete."""
        if station in self._put:
            self.exchange(timeout)
        return self._back

    def exchange(self, timeout: float) -> None:
        """Exchange one frame with the outputs of all stations; a frame with an unexpected working counter counts as
        lost.
        """
        self._put.clear()
        self.master.send_processdata()
        self._back = self.master.receive_processdata(int(1e6 * timeout)) == self.master.expected_wkc

    def close(self, station: EtherCAT) -> None:
        """Remove a station, and return the segment to INIT after the last one; never raises."""
        self.stations = [other for other in self.stations if other is not station]
        if self.stations:
            return
        self._claim.free()
        if self.master is None:
            return
        # a failure on a dead bus must not replace the error that led here
        with contextlib.suppress(Exception):
            self.master.state = self.soem.INIT_STATE
            self.master.write_state()
        with contextlib.suppress(Exception):
            self.master.close()
        self.master = None


class EtherCAT:
    """A drive at a position on the segment (1, 2, ...). See `Transport`; stations of a `segment` share its frames."""

    def __init__(self, interface: str, station: int, segment: Segment | None = None) -> None:
        self.interface, self.station = interface, station
        self.where = f"EtherCAT {interface}, station {station}"
        self.slave: Any = None
        self.assigned = self.ready = False
        self._sent = self._told = Layout(())
        self._segment = segment or Segment(interface)
        self._segment.stations.append(self)

    def open(self) -> None:
        """Switch the station to PRE-OP, with all stations of the segment."""
        self._segment.open(self.where)

    def read(self, index: int, subindex: int) -> bytes:
        """Read an object by SDO."""
        return bytes(self._sdo(self.slave.sdo_read, index, subindex))

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Write an object by SDO."""
        self._sdo(self.slave.sdo_write, index, subindex, content)

    def _sdo(self, ask: Callable[..., Any], index: int, subindex: int, *content: bytes) -> Any:
        """Run an SDO transfer, repeating it after a lost frame, since reading or writing a value twice is harmless."""
        soem, lost = self._segment.soem, "no answer"
        for _ in range(_ATTEMPTS):
            try:
                return ask(index, subindex, *content)
            except soem.SdoError as error:
                raise RefusedError(self.where, index, subindex, error.abort_code, bool(content)) from None
            except (soem.MailboxError, soem.PacketError, soem.WkcError) as error:
                lost = type(error).__name__
        raise BusError(f"{self.where}: object 0x{index:04X}:{subindex:02X} was not answered ({lost}); {self.state()}")

    def map(self, sent: Layout, told: Layout) -> None:
        """Write mapping and assignment, and configure sync managers and FMMUs from the mapping reported by the drive.

        SOEM reads each mapping entry from the drive and silently omits entries whose answer is late.  Therefore sizes
        are compared, the mapping is read back, and a faulty mapping is repeated, starting from INIT.  The drive is
        taken to have an unchangeable mapping only if two readings differ from the written mapping.
        """
        self._sent, self._told = sent, told
        self.assign()
        self.assigned = True
        self._segment.map()

    def assign(self) -> None:
        """Write mapping and assignment."""
        for first, assigned, layout in ((0x1600, 0x1C12, self._sent), (0x1A00, 0x1C13, self._told)):
            self.write(assigned, 0, b"\x00")
            write_mapping(self, first, layout)
            for k in range(len(layout.groups)):
                self.write(assigned, k + 1, (first + k).to_bytes(2, "little"))
            self.write(assigned, 0, bytes([len(layout.groups)]))

    def wrongly_mapped(self) -> tuple[str, bool]:
        """Return the mapping fault ("" if none), and True if the drive has a mapping other than the one written."""
        sent, told = self._sent, self._told
        sizes = len(self.slave.output), len(self.slave.input)
        held = holds_mapping(self, 0x1600, 0x1C12, sent) and holds_mapping(self, 0x1A00, 0x1C13, told)
        if held and sizes == (sent.size, told.size):
            return "", False
        wrong = (
            f"{self.where}: maps {sizes[0]} bytes out and {sizes[1]} bytes in, where {sent.size} and {told.size} were "
            "asked for; "
        )
        if not held:
            return f"{wrong}it reads back as another mapping than was written: it is fixed", True
        return (
            f"{wrong}the mapping reads back as it was written, so answers are lost: look at the cable, and at what "
            "else this computer does"
        ), False

    def watch(self, seconds: float) -> None:
        """Set the process data watchdog of the slave controller, in steps of 0.1 ms, and check that outputs trigger it.

        Uses registers 0x0400 and 0x0420 and bit 6 of the control byte of sync manager 2, according to ETG.1000.4.
        """
        try:
            self.slave.set_watchdog("processdata", 1e3 * seconds)
            got = 1e-3 * float(self.slave.get_watchdog("processdata"))
            # pysoem reads registers of a slave under this private name only
            control = int(self.slave._fprd(_OUTPUTS_CONTROL, 1)[0])
        except (self._segment.soem.WkcError, ValueError, TypeError, IndexError) as error:
            raise BusError(f"{self.where}: its watchdog cannot be set ({type(error).__name__}: {error})") from None
        if abs(got - seconds) > 1e-3 + 0.01 * seconds or not control & _FEEDS_WATCHDOG:
            why = (
                Text(f"reads back as {Quantity(got, 's'):6}")
                if control & _FEEDS_WATCHDOG
                else "is switched off for its outputs"
            )
            raise BusError(
                f"{self.where}: its watchdog was set to {Quantity(seconds, 's'):6} and {why}: without it the axis runs "
                "on when this computer stops; choose another `watchdog_ms` in the drive file, or 0 if you accept that"
            )

    def operate(self, content: bytes) -> None:
        """Switch the station to SAFE-OP and OP, with all stations of the segment."""
        self.slave.output = content
        self.ready = True
        self._segment.operate()

    def put(self, content: bytes) -> None:
        """Set the outputs of the next frame."""
        self.slave.output = content
        self._segment.put(self.station)

    def take(self, timeout: float) -> bytes | None:
        """Return the inputs from the frame of this cycle; None if the frame was lost."""
        return bytes(self.slave.input) if self._segment.took(self.station, timeout) else None

    def state(self) -> str:
        """Return the AL state and the AL status code as a string."""
        names = {1: "INIT", 2: "PRE-OP", 3: "BOOT", 4: "SAFE-OP", 8: "OP"}
        self._segment.master.read_state()
        state = self.slave.state
        if state == 0:
            return "it does not answer"
        text = names.get(state & 0x0F, str(state))
        if state & 0x10 or self.slave.al_status:
            message = self._segment.soem.al_status_code_to_string(self.slave.al_status)
            text += f", {message} (0x{self.slave.al_status:04X})"
        return f"it is in {text}"

    def close(self) -> None:
        """Return the segment to INIT, once its last station is closed."""
        self._segment.close(self)


# a broadcast read (BRD, 7) of the AL status, 0x0130; the index 0x5A marks the frame as that of this program
_STATES = struct.pack("<HBBHHHHHH", 0x1000 + 14, 7, 0x5A, 0, 0x0130, 2, 0, 0, 0)


def _check_alone(where: str, interface: str) -> None:
    """Raise BusError if another master is active, since a scan for drives would interrupt the drives that it controls.

    Another master is detected by a frame that this process did not send, or, if that master is slow or blocked, by a
    station in OP.  The states are read by a single frame that changes nothing.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        # another master on this computer is seen by the frames that it sends: only ETH_P_ALL receives these
        line = opened_socket(interface, _EVERYTHING)
    except BusError:
        # opening the master reports the missing right, with its remedy
        return
    with contextlib.closing(line):
        for _ in _frames(line, _LISTENING):
            raise BusError(
                f"{where}: another EtherCAT master sends on {interface}: end it first, since it would lose its "
                "drives; nothing was sent"
            )
        # from a locally administered address; 30 bytes pad the frame to 60, the least on Ethernet
        line.send(b"\xff" * 6 + b"\x02\x00\x00\x00\x00\x01" + b"\x88\xa4" + _STATES + bytes(30))
        for frame, outgoing in _frames(line, 1e-6 * _PATIENCE):
            datagram, states, answers = frame[16:18], frame[26], int.from_bytes(frame[28:30], "little")
            if outgoing or datagram != _STATES[2:4]:
                continue
            # in a broadcast read the slaves OR their states: bit 3 is set if any of them is in OP
            if answers and states & 0x08:
                raise BusError(
                    f"{where}: a station on {interface} is in OP, and not by this program: another EtherCAT "
                    "master drives it, or one ended without switching it off; end that master, or switch the drives "
                    "off and on; nothing was changed"
                )
            return


def _frames(line: socket.socket, seconds: float) -> Iterator[tuple[bytes, bool]]:
    """Yield the EtherCAT frames received on a socket within `seconds`, each with True if this computer sent it."""
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0.0:
        line.settimeout(left)
        try:
            frame, sender = line.recvfrom(2048)
        except OSError:
            return
        if frame[12:14] == b"\x88\xa4" and len(frame) >= 30:
            yield frame, sender[2] == socket.PACKET_OUTGOING


_FLAGS = 0x8913  # SIOCGIFFLAGS


def check_interface(name: str) -> None:
    """Raise ParameterError for a missing interface, listing the existing ones, and BusError for one that is down."""
    there = sorted(interface for _, interface in socket.if_nameindex())
    if name not in there:
        raise ParameterError(
            f"interface '{name}' is not there; there are: {', '.join(there) or 'none'} (ip link shows them)"
        )
    if not _is_up(name):
        raise BusError(f"interface '{name}' is down: run  ip link set {name} up")


def _is_up(name: str) -> bool:
    """Return True if the interface is up, in the network namespace of this process."""
    if not sys.platform.startswith("linux"):
        return True
    import fcntl

    # not from /sys/class/net, which shows the network namespace in which /sys was mounted
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        answered = fcntl.ioctl(asking, _FLAGS, struct.pack("16s24x", name.encode()[:15]))
    return bool(struct.unpack_from("<H", answered, 16)[0] & 1)


def opened_socket(interface: str, ethertype: int) -> socket.socket:
    """Open a raw Ethernet socket. Raises ParameterError for a missing interface, BusError if it cannot be opened."""
    if not sys.platform.startswith("linux"):
        raise BusError("a virtual EtherCAT drive needs the packet sockets of Linux; use  --bus canopen")
    check_interface(interface)
    try:
        line = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ethertype))
        line.bind((interface, ethertype))
    except PermissionError:
        raise BusError(not_permitted(interface)) from None
    except OSError as error:
        raise BusError(f"interface '{interface}' cannot be opened: {error.strerror}") from None
    return line


def not_permitted(interface: str) -> str:
    """Return the error message, with remedies, for a missing permission to open raw sockets."""
    return (
        f"interface '{interface}': raw Ethernet needs CAP_NET_RAW: run as root, give it once by  "
        f"sudo setcap cap_net_raw+ep $(readlink -f {sys.executable}), or try it in a namespace of its own by  "
        "unshare -rn"
    )
