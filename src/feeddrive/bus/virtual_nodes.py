"""The virtual drive as a slave on an Ethernet interface (EtherCAT), and as a node on a CAN bus (CANopen).

The slave controller implements registers, EEPROM, FMMUs, sync managers, AL states and frame processing, according to
ETG.1000.4 and the register descriptions of the chip manufacturers.  The registers report that distributed clocks,
redundancy, sync manager events and EEPROM writing are not supported.

The mailbox supports CANopen over EtherCAT with SDO upload and download.  Segmented transfer, complete access and SDO
information are refused with an abort code; masters work without them.

On a CAN bus the canopen package serves SDO and NMT; process data are exchanged on every SYNC.
"""

import contextlib
import socket
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

from feeddrive.bus.canopen import opened_network, packages
from feeddrive.bus.cia402 import VIRTUAL, Layout
from feeddrive.bus.ethercat import opened_socket
from feeddrive.bus.virtual_drive import INVALID, NO_SUBINDEX, PRODUCT, REVISION, VENDOR, Firmware, PdoMap, SdoAbortError

WATCHDOG_EXPIRED = 0x001B  # AL status code: sync manager watchdog
_PAUSE = 0.05  # s between looks at `stopped`


def serve_ethercat(
    firmwares: Firmware | Sequence[Firmware],
    interface: str,
    *,
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    watchdog: float | None = None,
    lose: Callable[[int], bool] = lambda _cycle: False,
) -> None:
    """Serve drives on an interface until `stopped` returns True; several drives form a segment, in order.

    watchdog  real time without process data, s, after which an enabled drive enters the fault state; None: the time
              that the master writes to the registers.  The plant advances only with the frames.
    lose      function of the cycle number that returns True to drop the first drive's answer, for client tests

    Raises ParameterError for a missing interface, BusError without access rights.
    """
    drives = [firmwares] if isinstance(firmwares, Firmware) else list(firmwares)
    stations = [SlaveController(firmware) for firmware in drives]
    line = opened_socket(interface, ETHERTYPE)
    with contextlib.closing(line):
        ready()
        last = time.monotonic()
        while not stopped():
            limits = [station.watchdog if watchdog is None else watchdog for station in stations]
            # half of a watchdog's time, so that its end is not noticed late
            line.settimeout(min([_PAUSE, *(0.5 * limit for limit in limits if limit)]))
            with contextlib.suppress(socket.timeout):
                frame: bytes | None = line.recv(2048)
                if any(drive.faults.is_unplugged for drive in drives):
                    frame = None
                for station in stations:
                    frame = None if frame is None else station.passed(frame)
                if frame is not None and not lose(drives[0].cycles) and drives[0].faults.is_answering:
                    line.send(frame)
                # after the answer, so that the simulation does not delay it; a list, since any() would stop early
                moved = [station.advance() for station in stations]
                if any(moved):
                    last = time.monotonic()
            for station, limit in zip(stations, limits, strict=True):
                if limit and time.monotonic() - last > limit and station.state == OP:
                    station.fall(WATCHDOG_EXPIRED)


ETHERTYPE = 0x88A4
# AL states and status codes by ETG.1000.6, registers of the slave controller by ETG.1000.4
INIT, PREOP, SAFEOP, OP = 1, 2, 4, 8
_ALLOWED = {INIT: (PREOP,), PREOP: (INIT, SAFEOP), SAFEOP: (INIT, PREOP, OP), OP: (INIT, PREOP, SAFEOP)}
# AL status codes
_INVALID_CHANGE, _UNKNOWN_STATE, _NO_MAILBOX, _WRONG_OUTPUTS, _WRONG_INPUTS = 0x0011, 0x0012, 0x0016, 0x001D, 0x001E
_STATION, _AL_CONTROL, _AL_STATUS, _AL_CODE = 0x0010, 0x0120, 0x0130, 0x0134
_EEPROM_CONTROL, _EEPROM_ADDRESS, _EEPROM_DATA = 0x0502, 0x0504, 0x0508
_DIVIDER, _WATCHDOG_TIME = 0x0400, 0x0420
_FMMU, _SYNC = 0x0600, 0x0800
_READ_ONLY = frozenset((*range(0x0010), *range(0x0110, 0x0112), *range(0x0130, 0x0136), *range(0x0140, 0x0142))) | {
    _SYNC + 8 * k + 5 for k in range(4)
}  # the status of each sync manager
_FULL = 0x08  # status of a sync manager: mailbox full
_REPEAT = 0x02  # a mailbox asked for again: toggled in `activate` of its sync manager, and by the slave behind it

_READS = {1, 3, 4, 6, 7, 9, 13, 14}
_WRITES = {2, 3, 5, 6, 8, 9}


class SlaveController:
    """A slave controller that answers EtherCAT frames and passes their process data to the firmware."""

    def __init__(self, firmware: Firmware) -> None:
        self.firmware = firmware
        self.objects = PdoMap(firmware, lambda: self.state == PREOP)
        self._memory = bytearray(0x2000)
        self._eeprom = eeprom(VENDOR, PRODUCT, REVISION, 1, VIRTUAL)
        # type, revision, build; 4 FMMUs, 4 sync managers, 4 kB, one MII port; no distributed clocks
        struct.pack_into("<BBHBBBBH", self._memory, 0x0000, 0x11, 0, 1, 4, 4, 4, 0x03, 0x0000)
        struct.pack_into("<H", self._memory, 0x0110, 0x5611)  # link on port 0, the others closed
        struct.pack_into("<H", self._memory, 0x0140, 0x0005)
        # a unit of the watchdog is divider + 2 periods of 25 MHz: 100 us, the default of the chips
        struct.pack_into("<H", self._memory, _DIVIDER, 2498)
        self._outputs, self._inputs = self.objects.assigned(0x1600), self.objects.assigned(0x1A00)
        self._due = False
        self._enter(INIT)

    @property
    def state(self) -> int:
        """The AL state, without the error bit."""
        return self._memory[_AL_STATUS] & 0x0F

    @property
    def watchdog(self) -> float:
        """The watchdog time in the registers, s, after which a slave without outputs leaves OP; 0 if it is off."""
        (divider,) = struct.unpack_from("<H", self._memory, _DIVIDER)
        (time_,) = struct.unpack_from("<H", self._memory, _WATCHDOG_TIME)
        return 40e-9 * (divider + 2) * time_ if self._memory[_SYNC + 8 * 2 + 4] & 0x40 else 0.0

    def _enter(self, state: int, code: int = 0) -> None:
        struct.pack_into("<H", self._memory, _AL_STATUS, state | (0x10 if code else 0))
        struct.pack_into("<H", self._memory, _AL_CODE, code)

    def fall(self, code: int) -> None:
        """Leave OPERATIONAL for SAFE-OPERATIONAL, with an AL status code."""
        self._enter(SAFEOP, code)
        self.firmware.lost()

    def passed(self, frame: bytes) -> bytes | None:
        """Process a frame and return it, or None if it is not EtherCAT; call `advance` afterwards."""
        if len(frame) < 28 or frame[12:14] != b"\x88\xa4":
            return None
        returned = bytearray(frame)
        # every slave sets the bit of a locally administered address in that of the sender
        returned[6] |= 0x02
        for at, size in _datagrams(returned):
            self._datagram(returned, at, size)
        return bytes(returned)

    def advance(self) -> bool:
        """Advance by one bus cycle and return True if the frame just sent carried process data."""
        if not self._due:
            return False
        self._due = False
        self._cycle()
        return True

    def _cycle(self) -> None:
        start = OUTPUTS[0]
        if self.state == OP:
            self.firmware.take(self._outputs.unpack(bytes(self._memory[start : start + self._outputs.size])))
        self.firmware.cycle()
        self._refresh()

    def _refresh(self) -> None:
        self._memory[INPUTS[0] : INPUTS[0] + self._inputs.size] = self._inputs.pack(self.firmware.told)

    def _datagram(self, frame: bytearray, at: int, size: int) -> None:
        command = frame[at]
        start, end = at + 10, at + 10 + size
        counted = 0
        if command in (10, 11, 12):
            counted = self._logical(frame, command, at, start, size)
        else:
            station, register = struct.unpack_from("<HH", frame, at + 2)
            mine = self._addressed(command, station)
            # auto-increment and broadcast addresses grow by one in each slave
            if command in (1, 2, 3, 7, 8, 9, 13):
                struct.pack_into("<H", frame, at + 2, station + 1 & 0xFFFF)
            written = bytes(frame[start:end])
            if command in _READS and (mine or command in (7, 9)):
                content = self._read(register, size)
                frame[start:end] = (
                    bytes(a | b for a, b in zip(content, written, strict=True)) if command == 7 else content
                )
                # ETG.1000.4: the working counter grows by 1, but by 2 for the write of a command that also reads
                counted += 1
            if mine and command in _WRITES:
                self._write(register, written)
                counted += 2 if command in (3, 6, 9) else 1
        (count,) = struct.unpack_from("<H", frame, end)
        struct.pack_into("<H", frame, end, count + counted & 0xFFFF)

    def _addressed(self, command: int, station: int) -> bool:
        if command in (7, 8, 9):
            return True
        if command in (4, 5, 6, 14):
            return station == struct.unpack_from("<H", self._memory, _STATION)[0]
        return station == 0

    def _logical(self, frame: bytearray, command: int, at: int, start: int, size: int) -> int:
        """Serve an LRD, LWR or LRW command through the FMMUs; return the increment of the working counter.

        The increment is 1 for a read, plus 1 for a write, or plus 2 for a write in an LRW.
        """
        (logical,) = struct.unpack_from("<I", frame, at + 2)
        if self.state not in (SAFEOP, OP):
            return 0
        counted, read, written = 0, [], False
        for k in range(4):
            begin, length, _, _, physical, _, kind, active = struct.unpack_from(
                "<IHBBHBBB", self._memory, _FMMU + 16 * k
            )
            low, high = max(begin, logical), min(begin + length, logical + size)
            there, here = start + low - logical, physical + low - begin
            if not active & 1 or low >= high or here + high - low > len(self._memory):
                continue
            if kind & 1 and command != 11:
                read.append((there, bytes(self._memory[here : here + high - low])))
                counted |= 1
            if kind & 2 and command != 10 and self.state == OP:
                self._memory[here : here + high - low] = frame[there : there + high - low]
                counted |= 2 if command == 12 else 1
            if kind & 2 and command != 10:
                written = True
        for there, content in read:
            frame[there : there + len(content)] = content
        listened = bool(read) and not self._outputs.size  # by a master that commands nothing
        self._due = self._due or written or listened
        return counted

    def _read(self, register: int, size: int) -> bytes:
        content = bytes(self._memory[register : register + size]).ljust(size, b"\x00")
        if register <= sum(MAILBOX_IN) - 1 < register + size and self._memory[_SYNC + 13] & _FULL:
            # only reading its last byte empties a mailbox
            self._memory[_SYNC + 13] &= ~_FULL
        return content

    def _write(self, register: int, content: bytes) -> None:
        repeat = self._memory[_SYNC + 14] & _REPEAT
        for k, value in enumerate(content):
            if register + k < len(self._memory) and register + k not in _READ_ONLY:
                self._memory[register + k] = value
        touched = range(register, register + len(content))
        if _AL_CONTROL in touched:
            self._control(self._memory[_AL_CONTROL])
        if _EEPROM_CONTROL + 1 in touched:
            self._serve_eeprom()
        # a sync manager that is configured again starts with an empty mailbox
        if _SYNC + 8 in touched:
            self._memory[_SYNC + 13] &= ~_FULL
        elif self._memory[_SYNC + 14] & _REPEAT != repeat:
            # the frame that fetched the mailbox was lost, and the master asks for its content again
            self._memory[_SYNC + 13] |= _FULL
        self._memory[_SYNC + 15] = self._memory[_SYNC + 14] & _REPEAT
        if sum(MAILBOX_OUT) - 1 in touched and self.state >= PREOP:
            self._serve_mailbox()

    def _serve_eeprom(self) -> None:
        command = struct.unpack_from("<H", self._memory, _EEPROM_CONTROL)[0] & 0x0700
        if command == 0x0100:
            # the EEPROM is addressed in words of 16 bits
            at = 2 * struct.unpack_from("<I", self._memory, _EEPROM_ADDRESS)[0]
            self._memory[_EEPROM_DATA : _EEPROM_DATA + 8] = self._eeprom[at : at + 8].ljust(8, b"\xff")
        # not busy, no error; 8 bytes at once
        struct.pack_into("<H", self._memory, _EEPROM_CONTROL, 0x0040)

    def _serve_mailbox(self) -> None:
        start, size = MAILBOX_OUT
        answered = answer(bytes(self._memory[start : start + size]), self.objects)
        if answered is None:
            return
        start, size = MAILBOX_IN
        self._memory[start : start + size] = answered.ljust(size, b"\x00")
        self._memory[_SYNC + 13] |= _FULL

    def _control(self, wanted: int) -> None:
        """Handle an AL control request; bit 4 acknowledges an error."""
        status, state = self._memory[_AL_STATUS], wanted & 0x0F
        if status & 0x10 and not wanted & 0x10:
            return
        if state == self.state:
            self._enter(state)
        elif state not in _ALLOWED:
            self._enter(self.state, _UNKNOWN_STATE)
        elif state not in _ALLOWED[self.state]:
            self._enter(self.state, _INVALID_CHANGE)
        else:
            code = self._obstacle(state)
            left = self.state == OP
            self._enter(self.state if code else state, code)
            if left and not code:
                self.firmware.lost()

    def _obstacle(self, state: int) -> int:
        """Return the AL status code for the reason why a state cannot be entered; 0 if it can be entered."""
        if state == PREOP and self.state == INIT:
            return 0 if all(self._sync(k) == place for k, place in ((0, MAILBOX_OUT), (1, MAILBOX_IN))) else _NO_MAILBOX
        if state == SAFEOP and self.state == PREOP:
            self._outputs, self._inputs = self.objects.assigned(0x1600), self.objects.assigned(0x1A00)
            if self._sync(2) != (OUTPUTS[0], self._outputs.size):
                return _WRONG_OUTPUTS
            if self._sync(3) != (INPUTS[0], self._inputs.size):
                return _WRONG_INPUTS
            self._refresh()
        return 0

    def _sync(self, k: int) -> tuple[int, int]:
        """Return start address and length of a sync manager."""
        start, length = struct.unpack_from("<HH", self._memory, _SYNC + 8 * k)
        return start, length


def _datagrams(frame: bytearray) -> Iterator[tuple[int, int]]:
    """Yield the start and the data length of each datagram."""
    at, more = 16, True
    while more and at + 12 <= len(frame):
        (word,) = struct.unpack_from("<H", frame, at + 6)
        size, more = word & 0x07FF, bool(word & 0x8000)
        if at + 12 + size > len(frame):
            return
        yield at, size
        at += 12 + size


# mailbox type of CoE, its services, and the command specifiers of an SDO
_COE, _REQUEST, _RESPONSE = 3, 2, 3
_UPLOAD, _DOWNLOAD = 2, 1
_UNKNOWN_COMMAND = 0x05040001  # abort code: unknown command specifier
_SYNC_TYPES = 0x1C00  # what each sync manager is for: mailbox out, mailbox in, outputs, inputs


def answer(message: bytes, objects: PdoMap) -> bytes | None:
    """Return the answer to a mailbox message; None for a message that is not a CoE request."""
    length, _, _, kind = struct.unpack_from("<HHBB", message)
    body = message[6 : 6 + length]
    if kind & 0x0F != _COE or len(body) < 10:
        return None
    service = struct.unpack_from("<H", body)[0] >> 12
    command, index, subindex = struct.unpack_from("<BHB", body, 2)
    try:
        if service != _REQUEST or command & 0x10:  # 0x10: complete access
            raise SdoAbortError(_UNKNOWN_COMMAND)
        answered = _sdo(objects, command, index, subindex, body[6:])
    except SdoAbortError as refused:
        # an abort is a request in the other direction
        return _framed(struct.pack("<HBHBI", _REQUEST << 12, 0x80, index, subindex, refused.code), kind)
    return _framed(struct.pack("<H", _RESPONSE << 12) + answered, kind)


def _sdo(objects: PdoMap, command: int, index: int, subindex: int, content: bytes) -> bytes:
    place = struct.pack("<HB", index, subindex)
    if command >> 5 == _UPLOAD:
        value = _sync_type(subindex) if index == _SYNC_TYPES else objects.read(index, subindex)
        if len(value) <= 4:
            return bytes([0x43 | (4 - len(value)) << 2]) + place + value.ljust(4, b"\x00")
        return b"\x41" + place + struct.pack("<I", len(value)) + value
    if command >> 5 != _DOWNLOAD:
        raise SdoAbortError(_UNKNOWN_COMMAND)
    if command & 0x02:  # expedited
        value = content[: 4 - (command >> 2 & 3) if command & 0x01 else 4]
    else:
        size = struct.unpack_from("<I", content)[0]
        value = content[4 : 4 + size]
        if len(value) != size:
            raise SdoAbortError(_UNKNOWN_COMMAND)
    objects.write(index, subindex, value)
    return b"\x60" + place + bytes(4)


def _sync_type(subindex: int) -> bytes:
    if subindex > 4:
        raise SdoAbortError(NO_SUBINDEX)
    return bytes([subindex or 4])


def _framed(content: bytes, kind: int) -> bytes:
    return struct.pack("<HHBB", len(content), 0, 0, kind) + content


# process memory of the slave: address and length
MAILBOX_OUT, MAILBOX_IN = (0x1000, 128), (0x1080, 128)
OUTPUTS, INPUTS = (0x1100, 64), (0x1200, 64)
# category types of the EEPROM by ETG.2010
_GENERAL, _FMMU_CATEGORY, _SYNC_CATEGORY, _STRINGS, _END = 30, 40, 41, 10, 0xFFFF
_COE_PROTOCOL = 0x04  # mailbox protocol
# bit 1, SDO information, stays 0: the mailbox refuses it
_COE_DETAILS = 0x0D  # SDO, PDO assignment and PDO mapping may be written


def eeprom(vendor: int, product: int, revision: int, serial: int, name: str) -> bytes:
    """Return the EEPROM image, a multiple of 8 bytes, according to ETG.1000.6 and ETG.2010."""
    head = bytearray(128)
    struct.pack_into("<IIII", head, 0x10, vendor, product, revision, serial)
    struct.pack_into("<HHHHH", head, 0x30, *MAILBOX_OUT, *MAILBOX_IN, _COE_PROTOCOL)
    struct.pack_into("<HH", head, 0x7C, 0x07, 1)  # size 8 kbit, version
    text = name.encode()
    strings = bytes([1, len(text)]) + text
    general = bytearray(32)
    general[3] = 1  # name: first string
    general[5] = _COE_DETAILS
    sync = b"".join(
        struct.pack("<HHBBBB", start, length, control, 0, 1, kind)
        for (start, length), control, kind in (
            (MAILBOX_OUT, 0x26, 1),
            (MAILBOX_IN, 0x22, 2),
            ((OUTPUTS[0], 0), 0x64, 3),
            ((INPUTS[0], 0), 0x20, 4),
        )
    )
    categories = (
        (_STRINGS, strings),
        (_GENERAL, bytes(general)),
        (_FMMU_CATEGORY, b"\x01\x02"),
        (_SYNC_CATEGORY, sync),
    )
    body = b"".join(_category(kind, content) for kind, content in categories)
    image = bytes(head) + body + struct.pack("<HH", _END, 0)
    return image + b"\xff" * (-len(image) % 8)


def _category(kind: int, content: bytes) -> bytes:
    padded = content + b"\x00" * (len(content) % 2)
    return struct.pack("<HH", kind, len(padded) // 2) + padded


# CiA 301: COB-ID of SYNC, producer and consumer time of the heartbeat, COB-ID of the heartbeat of node 0
_SYNC_ID, _HEARTBEAT, _CONSUMER, _BEAT = 0x80, 0x1017, 0x1016, 0x700


@lru_cache
def _layout(*names: str) -> Layout:
    return Layout([names])


class NodeData:
    """The process data of a CANopen node: what arrived since the last SYNC, and what it sends with the next one."""

    def __init__(self, firmware: Firmware, objects: PdoMap) -> None:
        self.firmware, self.objects = firmware, objects
        self._arrived: dict[int, bytes] = {}

    def arrive(self, message: int, content: bytes) -> None:
        """Keep a message until the next SYNC."""
        self._arrived[message] = content

    def answers(self) -> list[tuple[int, bytes]]:
        """Return the messages that a SYNC asks for, with the values of the last cycle."""
        if not self.firmware.faults.is_answering:
            return []
        told, listed = self.firmware.told, list[tuple[int, bytes]]()
        for k in range(4):
            message = self.objects.messages[0x1800 + k]
            if not message & INVALID:
                listed.append((message & 0x7FF, _layout(*self.objects.names(0x1A00 + k)).pack(told)))
        return listed

    def advance(self, *, is_operational: bool) -> None:
        """Accept what arrived, and advance by one bus cycle."""
        for k in range(4):
            message = self.objects.messages[0x1400 + k]
            content = self._arrived.pop(message & 0x7FF, None)
            if is_operational and not message & INVALID and content is not None:
                self.firmware.take(_layout(*self.objects.names(0x1600 + k)).unpack(content))
        self.firmware.cycle()


def serve_canopen(
    firmware: Firmware,
    interface: str,
    station: int,
    *,
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    bitrate: int | None = None,
    lose: Callable[[int], bool] = lambda _cycle: False,
) -> None:
    """Serve node `station` on a python-can bus until `stopped` returns True; `lose` drops the answer of a cycle.

    On each SYNC the values of the last cycle are sent, then the plant advances by one bus cycle.  Raises BusError for a
    bus that cannot be opened, MissingExtraError without the packages.
    """
    canopen = packages()
    watch = _MasterWatch()
    objects = PdoMap(firmware, lambda: node.nmt.state == "PRE-OPERATIONAL", station)

    # a local class, since its base is in an optional package
    class Node(canopen.LocalNode):
        """A CANopen node with the object dictionary of the firmware; the package stores only the heartbeat time."""

        def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
            if index == _HEARTBEAT:
                return super().get_data(index, subindex, check_readable)
            if (index, subindex) == (_CONSUMER, 1):
                return struct.pack("<I", watch.entry)
            try:
                return objects.read(index, subindex)
            except SdoAbortError as refused:
                raise canopen.SdoAbortedError(refused.code) from None

        def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
            if index == _HEARTBEAT:
                super().set_data(index, subindex, data, check_writable)
                return
            if (index, subindex) == (_CONSUMER, 1):
                watch.set(int.from_bytes(data, "little"))
                return
            try:
                objects.write(index, subindex, bytes(data))
            except SdoAbortError as refused:
                raise canopen.SdoAbortedError(refused.code) from None

    network = opened_network(interface, bitrate)
    try:
        dictionary = canopen.ObjectDictionary()
        heartbeat = canopen.objectdictionary.ODVariable("producer heartbeat time", _HEARTBEAT)
        heartbeat.data_type, heartbeat.default = canopen.objectdictionary.UNSIGNED16, 0
        dictionary.add_object(heartbeat)
        node = Node(station, dictionary)
        network.add_node(node)
        # of every node, since 0x1016 may name any of them later
        for master in range(1, 128):
            if master != station:
                network.subscribe(_BEAT + master, watch.beat)
        data = NodeData(firmware, objects)

        def operational() -> bool:
            return node.nmt.state == "OPERATIONAL"

        def arrive(identifier: int, content: bytearray, _stamp: float) -> None:
            data.arrive(identifier, bytes(content))

        for k in range(4):
            network.subscribe(0x200 + 0x100 * k + station, arrive)

        def sync(*_: Any) -> None:
            losing = lose(firmware.cycles)
            for message, content in data.answers() if operational() and not losing else ():
                network.send_message(message, content)
            data.advance(is_operational=operational())

        network.subscribe(_SYNC_ID, sync)
        node.nmt.state = "PRE-OPERATIONAL"
        ready()
        while not stopped():
            time.sleep(_PAUSE)
            if operational() and watch.is_silent():
                # the default reaction of 0x1029 to a lost heartbeat
                node.nmt.state = "PRE-OPERATIONAL"
            if not operational():
                firmware.lost()
    finally:
        network.disconnect()


class _MasterWatch:
    """The heartbeat consumer of the drive (0x1016:01), which is active once the first heartbeat has been received."""

    def __init__(self) -> None:
        self.set(0)

    def set(self, entry: int) -> None:
        """Set the entry: node in bits 16 to 22, ms in the low 16 bits; 0 ms disables it."""
        self.entry = entry
        self._last: float | None = None

    def beat(self, identifier: int, _content: bytearray, _stamp: float) -> None:
        """Handle a heartbeat of any node."""
        if identifier - _BEAT == self.entry >> 16 & 0x7F:
            self._last = time.monotonic()

    def is_silent(self) -> bool:
        """Return True if the heartbeat has timed out."""
        last, limit = self._last, 1e-3 * (self.entry & 0xFFFF)
        return last is not None and limit > 0.0 and time.monotonic() - last > limit
