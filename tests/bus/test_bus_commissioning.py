"""What is asked of a drive before it is switched on, against drives that lack or refuse something."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bus_bench import LIMITS, drive
from feeddrive.bus.cia402 import AT, DEVICE_NAME, OBJECTS, Layout
from feeddrive.bus.client import DriveClient, check_scaling, identify, write_cycle_time, write_limits
from feeddrive.bus.drive_file import DriveScaling
from feeddrive.bus.transport import RefusedError
from feeddrive.language.errors import BusError

SCREW = DriveScaling(counts_per_turn=1e6, lead=0.01, gear=2.0, rated_torque=1.0)


class Paper:
    """A drive that is nothing but its objects; it refuses what it does not have, and what it is told to."""

    where = "paper, station 1"

    def __init__(self, refuses: tuple[str, ...] = (), **values: int) -> None:
        self.values = {"device_type": 0x20192, **values}
        self.refuses = refuses

    def open(self) -> None:
        pass

    def read(self, index: int, subindex: int) -> bytes:
        if (index, subindex) == DEVICE_NAME:
            return b"Paper\x00"
        name = AT[index, subindex].name
        if name not in self.values:
            raise RefusedError(self.where, index, subindex, 0x06020000, False)
        return OBJECTS[name].encode(self.values[name])

    def write(self, index: int, subindex: int, content: bytes) -> None:
        name = AT[index, subindex].name
        if name not in self.values or name in self.refuses:
            raise RefusedError(self.where, index, subindex, 0x06090030, True)
        self.values[name] = OBJECTS[name].decode(content)

    def map(self, sent: Layout, told: Layout) -> None:
        raise AssertionError("a drive that is refused is not mapped")

    def operate(self, content: bytes) -> None:
        raise AssertionError("a drive that is refused is not operated")

    def put(self, content: bytes) -> None:
        pass

    def take(self, timeout: float) -> bytes | None:
        raise AssertionError("a drive that is refused is not driven")

    def state(self) -> str:
        return "it is paper"

    def close(self) -> None:
        pass


def test_a_device_of_another_profile_is_no_drive() -> None:
    with pytest.raises(BusError, match="is not a CiA 402 drive but a device of profile 401"):
        identify(Paper(device_type=401), drive("ethercat"))


def test_a_drive_says_who_it_is_as_far_as_it_does() -> None:
    assert identify(Paper(vendor=2), drive("ethercat")) == {"vendor": 2, "name": "Paper"}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"rated_torque": 1500}, "scaling.rated_torque = 1 .* the drive says 1.5 in object 0x6076:00"),
        ({"gear_motor_turns": 3, "gear_shaft_turns": 1}, "scaling.gear = 2 .* drive says 3 in object 0x6091:01"),
        ({"gear_motor_turns": 24, "gear_shaft_turns": 10}, "drive says 2.4 in object 0x6091:01"),
        ({"encoder_increments": 1 << 20, "encoder_turns": 1}, "says 1048576 in object 0x608F:01"),
        # positions in micrometres of the table: 10 000 in a turn of the shaft, whatever the encoder counts
        ({"feed_constant": 10_000, "encoder_increments": 10**6}, "says 5000 in object 0x6092:01"),
    ],
)
def test_units_that_differ_are_refused_with_both_numbers(values: dict[str, int], words: str) -> None:
    with pytest.raises(BusError, match=words):
        check_scaling(Paper(**values), SCREW)


@pytest.mark.parametrize(
    "values",
    [
        {"feed_constant": 2 * 10**6, "feed_shaft_turns": 1},
        {"feed_constant": 6 * 10**6, "feed_shaft_turns": 3},
        {"encoder_increments": 10**6},
        {"encoder_increments": 4 * 10**6, "encoder_turns": 4},
    ],
)
def test_units_that_agree_are_taken_and_what_is_not_said_is_remarked(values: dict[str, int]) -> None:
    remarks = check_scaling(Paper(rated_torque=1000, **values), SCREW)
    assert remarks == ["The drive has no object 0x6091:01: scaling.gear could not be checked."]


def test_a_linear_motor_is_compared_by_its_rated_force() -> None:
    linear = DriveScaling(increment=1e-7, rated_force=500.0)
    assert check_scaling(Paper(rated_torque=500_000), linear) == []
    with pytest.raises(BusError, match=r"scaling\.rated_force = 500 .* the drive says 400 in object 0x6076:00"):
        check_scaling(Paper(rated_torque=400_000), linear)


def test_limits_go_into_the_drive_and_what_it_does_not_take_is_remarked() -> None:
    bounded = LIMITS.__class__(
        travel=0.2, velocity=0.5, force=100.0, following_error=2e-3, quick_stop_deceleration=5.0, position_most=0.3
    )
    made = drive("ethercat", limits=bounded)
    paper = Paper(
        ("quick_stop_option", "disable_operation_option"),
        max_torque=0,
        following_error_window=0,
        following_error_timeout=100,
        quick_stop_deceleration=0,
        quick_stop_option=0,
        fault_reaction_option=0,
        disable_operation_option=1,
        max_motor_speed=0,
        position_most=0,
    )
    remarks = write_limits(paper, made)
    assert paper.values["max_torque"] == int(100.0 / made.scaling.newton)  # rounded towards the safe side
    # 5 % beyond the bound of the monitor, which comes first
    assert paper.values["following_error_window"] == 210_000
    # in a fault the axis brakes, but the monitor comes first, whose 6 cycles of 1 ms a runaway leaves it
    assert (paper.values["following_error_timeout"], paper.values["fault_reaction_option"]) == (6, 2)
    assert paper.values["quick_stop_deceleration"] == 500_000_000
    assert paper.values["position_most"] == 30_000_000
    # 0.5 m/s, and the 6 ms at 5 m/s² until the reaction of the monitor acts, on a screw of 10 mm
    assert paper.values["max_motor_speed"] == 3180
    # what it does not take, but holds, is no remark
    assert remarks == [
        "The drive does not take 0x605A:00 (quick stop option), which holds 0 in place of 2: "
        "set this limit with its maker's tool."
    ]
    paper.values["max_torque"] = 777
    write_limits(paper, made, own_force=True)
    assert paper.values["max_torque"] == 777


def test_the_cycle_time_is_written_where_it_can_be() -> None:
    paper = Paper(cycle_value=1, cycle_exponent=-3)
    write_cycle_time(paper, drive("ethercat", cycle_time=250e-6))
    assert (paper.values["cycle_value"], paper.values["cycle_exponent"]) == (250, -6)
    write_cycle_time(Paper(), drive("ethercat"))  # a drive without the object is asked for nothing
    with pytest.raises(BusError, match="cycle_time = 1000 us does not suit the drive"):
        write_cycle_time(Paper(("cycle_value",), cycle_value=1, cycle_exponent=-3), drive("ethercat"))


NEEDED = {
    "controlword": 0,
    "statusword": 0,
    "mode": 0,
    "mode_display": 0,
    "position": 0,
    "torque": 0,
    "rated_torque": 1000,
    "target_position": 0,
}


@pytest.mark.parametrize("missing", ["statusword", "torque", "target_position"])
def test_a_drive_without_what_is_needed_is_refused_by_object(missing: str) -> None:
    paper = Paper(**{name: value for name, value in NEEDED.items() if name != missing})
    with pytest.raises(BusError, match=f"has no object {OBJECTS[missing].place} \\({missing}\\)"):
        DriveClient(paper, drive("ethercat")).open()


def test_a_stop_input_needs_the_digital_inputs_of_the_drive() -> None:
    """Which are not mapped without one: many drives have three PDOs at most."""
    for stop_input, wanted in ((None, "is driven"), (16, r"has no object 0x60FD:00 \(digital_inputs\)")):
        client = DriveClient(Paper(**NEEDED), drive("ethercat", stop_input=stop_input))
        with pytest.raises((BusError, AssertionError), match=wanted if stop_input else "not mapped"):
            client.open()
        assert ("digital_inputs" in client._back.names) == (stop_input is not None)


def test_what_no_object_can_hold_is_refused() -> None:
    client = DriveClient(Paper(), drive("ethercat"))
    tried: list[Callable[[], float]] = [
        lambda: client.command(position=30.0),  # 3e9 increments
        lambda: client.command(position=0.0, velocity=30.0),
        lambda: client.command(position=0.0, force=1e6),
    ]
    for each in tried:
        with pytest.raises(BusError, match=r"does not fit into 0x60.*look at \[scaling\] of the drive file"):
            each()


class Stubborn(Paper):
    """A drive that takes every object, and holds its own value of one of them."""

    def __init__(self, name: str, held: int) -> None:
        super().__init__(**dict.fromkeys(OBJECTS, 0))
        self.name, self.held = name, held

    def write(self, index: int, subindex: int, content: bytes) -> None:
        super().write(index, subindex, content)
        self.values[self.name] = self.held


@pytest.mark.parametrize(
    ("name", "held", "words"),
    [
        ("max_torque", 500, "holds 500 in 0x6072:00"),
        ("following_error_window", 1000, "holds 1000 in 0x6065:00"),
        ("max_motor_speed", 3100, "holds 3100 in 0x6080:00 (max motor speed), where 3180 was written"),
        ("quick_stop_deceleration", 600_000_000, "holds 600000000 in 0x6085:00"),
        ("quick_stop_option", 6, "holds 6 in 0x605A:00"),
        ("following_error_timeout", 100, "holds 100 in 0x6066:00 (following error timeout), where 6 was written"),
        ("disable_operation_option", 0, "holds 0 in 0x605C:00 (disable operation option), where 1 was written"),
        ("fault_reaction_option", 0, "holds 0 in 0x605E:00 (fault reaction option), where 2 was written"),
        ("max_torque", 5000, "a looser limit"),
        ("following_error_window", 0xFFFFFFFF, "0x6065:00 (following error window) was set to 210000 and reads back"),
        ("max_motor_speed", 3181, "0x6080:00 (max motor speed) was set to 3180 and reads back as 3181"),
        ("quick_stop_deceleration", 0, "a looser limit"),
    ],
)
def test_a_limit_that_reads_back_looser_is_refused_and_a_tighter_one_told(name: str, held: int, words: str) -> None:
    """0.53 m/s are 3,180 turns a minute of a screw of 10 mm."""
    if "holds" in words:
        assert any(words in remark for remark in write_limits(Stubborn(name, held), drive("ethercat")))
        return
    with pytest.raises(BusError) as refused:
        write_limits(Stubborn(name, held), drive("ethercat"))
    assert words in str(refused.value)
