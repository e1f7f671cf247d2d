"""The virtual EtherCAT slave frame by frame, without an interface and without a right to one."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_bench import SCALING, T, bench_loop
from feeddrive.bus import virtual_nodes
from feeddrive.bus.cia402 import OBJECTS
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware, PdoMap
from feeddrive.bus.virtual_nodes import (
    INIT,
    INPUTS,
    MAILBOX_IN,
    MAILBOX_OUT,
    OP,
    OUTPUTS,
    PREOP,
    SAFEOP,
    SlaveController,
    eeprom,
    serve_ethercat,
)

APRD, APWR, FPRD, FPWR, BRD, BWR, LRD, LWR, LRW = 1, 2, 4, 5, 7, 8, 10, 11, 12
STATION = 0x1001
LOGICAL = 0x0100_0000


AXIS = DrivenAxis(bench_loop())


@pytest.fixture
def slave() -> SlaveController:
    return powered_up()


def powered_up() -> SlaveController:
    made = SlaveController(Firmware(AXIS, SCALING, T))
    ask(made, APWR, 0, 0x0010, struct.pack("<H", STATION))
    return made


def ask(slave: SlaveController, command: int, station: int, register: int, content: bytes) -> tuple[bytes, int]:
    """One datagram in a frame of its own: its content and its working counter as they come back."""
    address = struct.pack("<I", register) if command >= LRD else struct.pack("<HH", station, register)
    datagram = bytes([command, 7]) + address + struct.pack("<HH", len(content), 0) + content + b"\0\0"
    frame = b"\xff" * 6 + b"\x10" * 6 + b"\x88\xa4" + struct.pack("<H", len(datagram) | 0x1000) + datagram
    back = slave.passed(frame)
    assert back is not None
    assert len(back) == len(frame)
    assert back[6] == 0x12  # the slave marked the address of the sender
    slave.advance()
    return back[26 : 26 + len(content)], struct.unpack_from("<H", back, 26 + len(content))[0]


def to(slave: SlaveController, state: int) -> tuple[int, int]:
    """Ask for an AL state: what it is then, with bit 4 for an error, and the AL status code."""
    ask(slave, FPWR, STATION, 0x0120, struct.pack("<H", state))
    content, _ = ask(slave, FPRD, STATION, 0x0130, bytes(6))
    return content[0], struct.unpack_from("<H", content, 4)[0]


def mailboxes(slave: SlaveController) -> None:
    for k, (start, length) in enumerate((MAILBOX_OUT, MAILBOX_IN)):
        ask(slave, FPWR, STATION, 0x0800 + 8 * k, struct.pack("<HHBBBB", start, length, 0x26 - 4 * k, 0, 1, 0))


def managers(slave: SlaveController, out: int, into: int) -> None:
    for k, (start, length) in ((2, (OUTPUTS[0], out)), (3, (INPUTS[0], into))):
        ask(slave, FPWR, STATION, 0x0800 + 8 * k, struct.pack("<HHBBBB", start, length, 0x64, 0, 1, 0))
    for k, (start, length, kind) in enumerate(((OUTPUTS[0], out, 2), (INPUTS[0], into, 1))):
        logical = LOGICAL + (out if k else 0)
        fmmu = struct.pack("<IHBBHBBB", logical, length, 0, 7, start, 0, kind, 1)
        ask(slave, FPWR, STATION, 0x0600 + 16 * k, fmmu.ljust(16, b"\0"))


def sizes(slave: SlaveController) -> tuple[int, int]:
    return slave.objects.assigned(0x1600).size, slave.objects.assigned(0x1A00).size


def in_op(slave: SlaveController) -> tuple[int, int]:
    mailboxes(slave)
    out, into = sizes(slave)
    managers(slave, out, into)
    for state in (PREOP, SAFEOP, OP):
        assert to(slave, state) == (state, 0)
    return out, into


def sdo(slave: SlaveController, content: bytes) -> bytes:
    """A CoE request and the CoE answer, without their heads."""
    message = struct.pack("<HHBB", 2 + len(content), 0, 0, 0x13) + struct.pack("<H", 2 << 12) + content
    ask(slave, FPWR, STATION, MAILBOX_OUT[0], message.ljust(MAILBOX_OUT[1], b"\0"))
    full, _ = ask(slave, FPRD, STATION, 0x080D, b"\0")
    assert full[0] & 0x08, "no answer in the mailbox"
    answered, _ = ask(slave, FPRD, STATION, MAILBOX_IN[0], bytes(MAILBOX_IN[1]))
    after, _ = ask(slave, FPRD, STATION, 0x080D, b"\0")
    assert not after[0] & 0x08, "the mailbox stays full after it was read"
    (length,) = struct.unpack_from("<H", answered)
    return answered[8 : 6 + length]


def test_a_broadcast_counts_the_slaves_and_an_address_finds_one(slave: SlaveController) -> None:
    assert ask(slave, BRD, 0, 0x0000, bytes(2)) == (b"\x11\x00", 1)
    assert ask(slave, FPRD, STATION, 0x0010, bytes(2)) == (struct.pack("<H", STATION), 1)
    assert ask(slave, FPRD, STATION + 1, 0x0010, bytes(2))[1] == 0
    assert ask(slave, APRD, 1, 0x0010, bytes(2))[1] == 0  # the second in the line
    assert ask(slave, BWR, 0, 0x0000, b"\x55\x55")[1] == 1
    assert ask(slave, BRD, 0, 0x0000, bytes(1))[0] == b"\x11"  # what it is cannot be written


def test_a_mailbox_whose_frame_was_lost_is_fetched_again(slave: SlaveController) -> None:
    """Repeat request of ETG.1000.4: the master toggles a bit, the slave puts its answer back and toggles its own."""
    in_op(slave)
    first = sdo(slave, struct.pack("<BHB", 0x40, 0x6041, 0).ljust(8, b"\0"))
    ask(slave, FPWR, STATION, 0x080E, b"\x03")
    status, _ = ask(slave, FPRD, STATION, 0x080D, bytes(3))
    assert status[0] & 0x08, "the mailbox is full again"
    assert status[2] & 0x02 == 0x02, "the slave acknowledges by the same bit"
    again, _ = ask(slave, FPRD, STATION, MAILBOX_IN[0], bytes(MAILBOX_IN[1]))
    assert again[8 : 8 + len(first)] == first
    assert not ask(slave, FPRD, STATION, 0x080D, b"\0")[0][0] & 0x08
    mailboxes(slave)  # set up anew: no answer of before is left
    assert not ask(slave, FPRD, STATION, 0x080D, b"\0")[0][0] & 0x08


def test_states_are_entered_one_by_one_and_a_jump_is_refused(slave: SlaveController) -> None:
    assert to(slave, OP) == (INIT | 0x10, 0x0011)  # invalid requested state change
    assert to(slave, PREOP) == (INIT | 0x10, 0x0011)  # the error is to be acknowledged first
    assert to(slave, INIT | 0x10) == (INIT, 0)
    assert to(slave, PREOP) == (INIT | 0x10, 0x0016)  # no mailboxes yet
    assert to(slave, INIT | 0x10) == (INIT, 0)
    mailboxes(slave)
    assert to(slave, PREOP) == (PREOP, 0)
    assert to(slave, 0x05) == (PREOP | 0x10, 0x0012)  # no such state
    assert to(slave, PREOP | 0x10) == (PREOP, 0)
    out, into = sizes(slave)
    managers(slave, out + 1, into)
    assert to(slave, SAFEOP) == (PREOP | 0x10, 0x001D)
    assert to(slave, PREOP | 0x10) == (PREOP, 0)
    managers(slave, out, into - 1)
    assert to(slave, SAFEOP) == (PREOP | 0x10, 0x001E)
    assert to(slave, PREOP | 0x10) == (PREOP, 0)
    managers(slave, out, into)
    assert to(slave, SAFEOP) == (SAFEOP, 0)
    assert to(slave, OP) == (OP, 0)
    assert to(slave, INIT) == (INIT, 0)


def test_process_data_count_by_what_was_read_and_written(slave: SlaveController) -> None:
    """LRW 1 + 2, LWR 1, LRD 1; outputs count in OP only; each write is one bus cycle."""
    out, into = in_op(slave)
    before = slave.firmware.cycles
    assert ask(slave, LRW, 0, LOGICAL, bytes(out + into))[1] == 3
    assert ask(slave, LWR, 0, LOGICAL, bytes(out))[1] == 1
    assert slave.firmware.cycles == before + 2
    assert ask(slave, LRD, 0, LOGICAL + out, bytes(into))[1] == 1
    assert ask(slave, LRW, 0, LOGICAL + 10_000, bytes(out))[1] == 0
    assert slave.firmware.cycles == before + 2
    assert to(slave, SAFEOP) == (SAFEOP, 0)
    assert ask(slave, LRW, 0, LOGICAL, bytes(out + into))[1] == 1


def test_a_command_acts_and_is_seen_in_the_next_frame(slave: SlaveController) -> None:
    out, into = in_op(slave)
    layout = slave.objects.assigned(0x1600)
    told = slave.objects.assigned(0x1A00)
    values = dict.fromkeys(layout.names, 0) | {"controlword": 0x06, "mode": 8}
    first, _ = ask(slave, LRW, 0, LOGICAL, layout.pack(values) + bytes(into))
    second, _ = ask(slave, LRW, 0, LOGICAL, layout.pack(values) + bytes(into))
    assert told.unpack(first[out:])["statusword"] & 0x6F == 0x40
    assert told.unpack(second[out:])["statusword"] & 0x6F == 0x21


def test_sdo_up_and_down_and_its_refusals(slave: SlaveController) -> None:
    mailboxes(slave)
    to(slave, PREOP)
    assert sdo(slave, struct.pack("<BHBI", 0x40, 0x1000, 0, 0)) == struct.pack("<BHBI", 0x43, 0x1000, 0, 0x20192)
    name = sdo(slave, struct.pack("<BHBI", 0x40, 0x1008, 0, 0))
    assert name[8:] == b"feeddrive virtual drive"
    assert struct.unpack_from("<I", name, 4)[0] == len(name[8:])
    write = struct.pack("<BHBI", 0x2B, 0x6072, 0, 500)
    assert sdo(slave, write)[0] == 0x60
    assert slave.firmware.values["max_torque"] == 500
    for request, code in (
        (struct.pack("<BHBI", 0x40, 0x5000, 0, 0), 0x06020000),
        (struct.pack("<BHBI", 0x2B, 0x6041, 0, 1), 0x06010002),
        (struct.pack("<BHBI", 0x23, 0x6072, 0, 1), 0x06070010),
        (struct.pack("<BHBI", 0x50, 0x1018, 0, 0), 0x05040001),  # complete access
        (struct.pack("<BHBI", 0x60, 0x1018, 0, 0), 0x05040001),  # a segment
        (struct.pack("<BHBI", 0x23, 0x1600, 1, OBJECTS["controlword"].mapped), 0x08000022),  # count not 0
    ):
        answered = sdo(slave, request)
        assert answered[0] == 0x80, request.hex()
        assert struct.unpack_from("<I", answered, 4)[0] == code


def test_a_mapping_can_be_changed_before_safe_op(slave: SlaveController) -> None:
    """Controlword and target torque only: four bytes, and an object that is not there cannot be mapped."""
    mailboxes(slave)
    to(slave, PREOP)
    for subindex, value, size in (
        (0, 0, 1),
        (1, OBJECTS["controlword"].mapped, 4),
        (2, OBJECTS["target_torque"].mapped, 4),
        (0, 2, 1),
    ):
        command = 0x2F if size == 1 else 0x23
        assert sdo(slave, struct.pack("<BHBI", command, 0x1600, subindex, value))[0] == 0x60
    for subindex, value, size in ((0, 0, 1), (1, 0x1600, 2), (0, 1, 1)):
        command = 0x2F if size == 1 else 0x2B
        assert sdo(slave, struct.pack("<BHBI", command, 0x1C12, subindex, value))[0] == 0x60
    assert slave.objects.assigned(0x1600).names == ("controlword", "target_torque")
    assert sizes(slave)[0] == 4
    sdo(slave, struct.pack("<BHBI", 0x2F, 0x1601, 0, 0))
    assert sdo(slave, struct.pack("<BHBI", 0x23, 0x1601, 1, 0x50000020))[0] == 0x80


def test_the_eeprom_is_read_word_by_word(slave: SlaveController) -> None:
    def words(at: int) -> bytes:
        ask(slave, FPWR, STATION, 0x0502, struct.pack("<HI", 0x0100, at))
        status, _ = ask(slave, FPRD, STATION, 0x0502, bytes(2))
        assert not status[1] & 0x80  # not busy
        return ask(slave, FPRD, STATION, 0x0508, bytes(8))[0]

    assert struct.unpack_from("<II", words(0x08)) == (0, 0x66656564)
    image = eeprom(0, 0x66656564, 1, 1, "feeddrive virtual drive")
    assert b"".join(words(at) for at in range(0, len(image) // 2, 4)) == image
    assert words(0x10000) == b"\xff" * 8


def test_the_eeprom_states_what_the_mailbox_can() -> None:
    """CANopen over EtherCAT alone (bit 2); SDO (0), assignment (2) and mapping (3), but no SDO information (1)."""
    image = eeprom(0, 1, 1, 1, "x")
    assert struct.unpack_from("<H", image, 0x38)[0] == 1 << 2
    at = 128
    while struct.unpack_from("<H", image, at)[0] != 30:  # general
        at += 4 + 2 * struct.unpack_from("<H", image, at + 2)[0]
    assert image[at + 4 + 5] == 1 << 0 | 1 << 2 | 1 << 3


def test_the_sync_managers_are_for_mailboxes_outputs_and_inputs(slave: SlaveController) -> None:
    """0x1C00 by ETG.1000.6: 1 mailbox out, 2 mailbox in, 3 outputs, 4 inputs."""
    mailboxes(slave)
    to(slave, PREOP)
    answers = [sdo(slave, struct.pack("<BHBI", 0x40, 0x1C00, k, 0)) for k in range(1, 5)]
    assert [answered[4] for answered in answers] == [1, 2, 3, 4]
    assert all(answered[0] == 0x4F for answered in answers)


def test_a_message_without_a_node_number_is_switched_off() -> None:
    """Bit 31 of a COB-ID, by CiA 301."""
    lists = PdoMap(Firmware(AXIS, SCALING, T), lambda: True)
    (message,) = struct.unpack("<I", lists.read(0x1400, 1))
    assert message == 1 << 31 | 0x200


KINDS = (b"\x88\xa4", b"\x08\x00")


class Wire:
    """A packet socket that gives each frame to those whose protocol it has, as the kernel does."""

    def __init__(self, protocol: int, frames: list[bytes]) -> None:
        self.protocol, self.frames, self.sent = protocol, frames, list[bytes]()

    def settimeout(self, seconds: float) -> None:
        pass

    def recv(self, size: int) -> bytes:
        while self.frames:
            frame = self.frames.pop()
            if int.from_bytes(frame[12:14], "big") == self.protocol:
                return frame
        raise TimeoutError

    def send(self, frame: bytes) -> None:
        self.sent.append(frame)

    def close(self) -> None:
        pass


def test_frames_of_ethercat_are_served_and_others_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """0x88A4 is EtherCAT, by IEEE; 0x0800 is IP."""
    frames = [bytes(12) + kind + struct.pack("<HBBHHHH", 0x100E, BRD, 0, 0, 0x130, 2, 0) + bytes(34) for kind in KINDS]
    lines = list[Wire]()

    def opened(_: str, protocol: int) -> Wire:
        lines.append(Wire(protocol, frames))
        return lines[-1]

    monkeypatch.setattr(virtual_nodes, "opened_socket", opened)
    serve_ethercat(Firmware(AXIS, SCALING, T), "x", ready=lambda: None, stopped=lambda: not frames)
    (answered,) = lines[0].sent
    assert answered[12:14] == KINDS[0]
    assert answered[28] == 1  # the slave counted


def test_a_slave_without_outputs_leaves_op_by_its_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    """AL status code 0x001B, by ETG.1000.6: sync manager watchdog."""
    made = powered_up()
    in_op(made)
    monkeypatch.setattr(virtual_nodes, "SlaveController", lambda _: made)
    monkeypatch.setattr(virtual_nodes, "opened_socket", lambda *_: Wire(0, []))
    serve_ethercat(made.firmware, "x", ready=lambda: None, stopped=lambda: made.state != OP, watchdog=1e-3)
    content, _ = ask(made, FPRD, STATION, 0x0130, bytes(6))
    assert (content[0], content[4]) == (SAFEOP | 0x10, 0x1B)


DATAGRAMS = st.lists(
    st.tuples(
        st.integers(0, 15),
        st.sampled_from([0, STATION, 0xFFFF]),
        st.sampled_from([0x0010, 0x0120, 0x0502, 0x0600, 0x0610, 0x0800, 0x0810, 0x1000, 0x1080, 0x1FFC, 0xFFFF]),
        st.binary(max_size=150),
    ),
    max_size=6,
)


@given(DATAGRAMS, st.sampled_from([INIT, PREOP, OP]), st.binary(max_size=12))
def test_no_frame_upsets_it(datagrams: list[tuple[int, int, int, bytes]], state: int, rest: bytes) -> None:
    """Whatever comes: a frame of the same length or none, and no error."""
    made = powered_up()
    if state == OP:
        in_op(made)
    elif state == PREOP:
        mailboxes(made)
        to(made, PREOP)
    frame = b"\xff" * 12 + b"\x88\xa4\0\0"
    for i, (command, station, register, content) in enumerate(datagrams):
        size = len(content) | (0x8000 if i < len(datagrams) - 1 else 0)
        frame += struct.pack("<BBHHHH", command, i, station, register, size, 0) + content + b"\0\0"
    for each in (frame + rest, rest):
        back = made.passed(each)
        assert back is None or len(back) == len(each)
        made.advance()
