"""Virtual CiA 402 drives that feeddrive does not know, drawn by a seed, with the person who stands beside them.

`draw(seed)` gives an axis with two to four of `TRAITS`, its drive with a slow but stable control (P-PI), the drive file
as its user would write it, the limits that he states, and the truth.  `Firmware` is served by the buses of
`feeddrive.bus.virtual_bus`; mechanics and control are those of `unknown_mechanics`.  Nothing of feeddrive's simulation,
identification or tuning is used here: object numbers, power states and the two errors of a bus are all that is shared.

    unknown = draw(3)
    drive = read_drive(unknown.write(folder))
    client = DriveClient(unknown.transport(), drive.drive, paced=False)

What the traits are

    sign        the objects of torque count against those of position
    gear        lead or gear of the drive file is wrong by a factor, and the drive has no objects that tell it
    delay       setpoints act 1 ms later
    brake       a holding brake opens and closes with a delay; the drive waits for it, and holds the axis meanwhile
    saturation  the current limit is far below the force limit that the user states; no object tells it
    mode        a body on the load swings at 45 to 80 Hz
    backlash    play between motor and load
    stribeck    friction at rest and at low speed is above that at speed
    cogging     a force of the motor that repeats along the travel
    vertical    weight, and a holding brake
    lost        frames are lost, one or two in a row
    rotary      a rotary motor on a screw or, as often, with a table that turns: all m below are rad then, all N are
                N m, all kg are kg m²; all others have linear motors, but those with a gear, which is of a screw

A drive with a brake: on `enable operation` it powers up and holds the axis (in cst: applies the target torque), opens
the brake, and then says `operation enabled`.  Switched off at rest it holds the axis until the brake has closed; in
motion, and in a fault, its force ends at once and the brake closes with its delay.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

import unknown_mechanics as um
from feeddrive.bus import cia402
from feeddrive.bus.cia402 import PowerState
from feeddrive.bus.drive_file import interpolation_time
from feeddrive.bus.virtual_bus import VirtualCANopen, VirtualEtherCAT
from feeddrive.bus.virtual_drive import NO_OBJECT, NO_SUBINDEX, READ_ONLY, TOO_LARGE, WRONG_LENGTH, SdoAbortError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table

TRAITS = (
    "sign",
    "gear",
    "delay",
    "brake",
    "saturation",
    "mode",
    "backlash",
    "stribeck",
    "cogging",
    "vertical",
    "lost",
    "rotary",
)
CYCLES = (0.25e-3, 0.5e-3, 1e-3)  # s, of the bus
SAMPLE = 125e-6  # s, of the drive's own control
GRAVITY = 9.81  # m/s²
WAITS = 0.1  # s that a quick stop holds the axis at the end of its ramp
STANDS = 5e-3  # m/s below which a drive with a brake takes its axis to stand
SEEN, STOOD = 50e-6, 0.1  # m, s: a table that moves less in this time stands, for who looks at it
_WRITABLE = {
    "controlword", "connection_option", "quick_stop_option", "mode", "following_error_window", "target_torque",
    "max_torque", "target_position", "position_least", "position_most", "max_motor_speed", "quick_stop_deceleration",
    "velocity_offset", "torque_offset", "cycle_value", "cycle_exponent", "target_velocity",
}  # fmt: skip
_ANY = 0xFFFFFFFF  # of a window or a speed: no limit
_POWERED = (PowerState.ENABLED, PowerState.QUICK_STOP)


@dataclass(frozen=True)
class Truth:
    """What nobody tells the command. Lengths and forces are those of the table.

    metre, newton   of one increment of 0x6064, of a thousandth of the rated torque
    sign            of 0x6071, 0x6077 and 0x60B2 against 0x6064
    length_factor   true length over that of the drive file
    delay           from a setpoint to the force, without the current loop and the bus cycle, s
    current_limit   true largest force, N
    resonance       between motor and load, Hz;  mode: of the body on the load, Hz, 0: none
    """

    mass: float
    coulomb: float
    breakaway: float
    stribeck_velocity: float
    viscous: float
    gravity: float
    resonance: float
    mode: float
    gap: float
    cogging: float
    delay: float
    current_limit: float
    metre: float
    newton: float
    sign: int
    length_factor: float


@dataclass(frozen=True)
class Limits:
    """What the user states, in true m, m/s, N."""

    travel: float
    velocity: float
    force: float
    following_error: float
    quick_stop_deceleration: float


@dataclass(frozen=True)
class Build:
    """How a drive is made: its servo's parameters, its objects and what it does about brake and modes.

    turns          (counts per turn, lead, gear, rated torque in N m) of a motor that turns, None of a linear one
    own_objects    True if 0x608F, 0x6091 and 0x6092 are there
    absent         names of further objects that the drive lacks
    feedforward    share of the set velocity of its own interpolator, where it has no 0x60B1
    opens, closes  of the brake, s; None: there is no brake
    fixed_mode     True if a change of mode is taken only while the drive is off
    lost           share of the frames that are lost
    turning        True for a table that turns, whose lengths are rad; radius: m in a rad of it, 1 of a linear axis
    """

    parameters: Mapping[int, float]
    metre: float
    newton: float
    sign: int
    rated_milli: int
    turns: tuple[float, float, float, float] | None
    cycle_time: float
    position: float
    own_objects: bool = True
    absent: tuple[str, ...] = ()
    feedforward: float = 1.0
    opens: float | None = None
    closes: float = 0.0
    fixed_mode: bool = False
    lost: float = 0.0
    torque_noise: float = 0.0
    turning: bool = False
    radius: float = 1.0
    seed: int = 0


@dataclass
class Move:
    """True positions of a time in operation, m: start, end, farthest from the start, and where the table stood."""

    start: float
    end: float
    anchor: tuple[float, int]  # where it may stand, and for how many cycles
    farthest: float = 0.0
    stands: list[float] = field(default_factory=list)

    def goes_on(self, true: float, cycle_time: float, seen: float) -> None:
        """Add a cycle; a table that moves by less than `seen` stands."""
        place, cycles = self.anchor
        self.end, self.farthest = true, max(self.farthest, abs(true - self.start))
        self.anchor = (true, 0) if abs(true - place) > seen else (place, cycles + 1)
        if cycles == round(STOOD / cycle_time):
            self.stands.append(true)


class Frames:
    """The frames of the bus, some of which are lost; `NodeData` and the buses ask for them by these names."""

    is_unplugged = False

    def __init__(self, share: float, seed: int) -> None:
        self._share, self._rng = share, np.random.default_rng([seed, 7])
        self._left, self._rest = 0, 50  # of a burst; frames until the next may begin
        self.is_arriving = True  # what the master sends
        self.lost = 0

    @property
    def is_answering(self) -> bool:
        return self._left == 0

    def advance(self) -> None:
        """Decide on the next frame: bursts of one or two, and two frames that pass after each."""
        if self._share == 0.0:
            return
        self._left, self._rest = max(0, self._left - 1), max(0, self._rest - 1)
        if self._left == 0 and self._rest == 0 and self._rng.random() < self._share:
            self._left = int(self._rng.integers(1, 3))
            self._rest = self._left + 2
        self.lost += self._left > 0
        # half of them get lost on their way to the drive
        self.is_arriving = self._left == 0 or bool(self._rng.random() < 0.5)


class Firmware:
    """The firmware of an unknown drive, with the surface of `feeddrive.bus.virtual_drive.Firmware`.

    csp   its P-PI control follows the target position, on a straight line over a bus cycle; 0x60B1 is the set velocity
    csv   its PI velocity loop alone;   cst   the force alone
    0x60B2 is added in all of them, and 0x6072 and the current limit bound the sum.
    """

    def __init__(self, build: Build) -> None:
        self.build, self.cycle_time = build, build.cycle_time
        self.servo = um.Servo(
            {
                **build.parameters,
                um.SAMPLE_TIME: SAMPLE,
                um.SAMPLES: float(round(build.cycle_time / SAMPLE)),
            },
            build.position,
            1 + build.seed,
        )
        self.faults = Frames(build.lost, build.seed)
        self.state = PowerState.SWITCH_ON_DISABLED
        self.cycles = 0
        self.true, self.true_motor = array("d"), array("d")  # m, after each cycle
        self.start = build.position
        self.worst = {"travel": 0.0, "velocity": 0.0, "force": 0.0, "following_error": 0.0}
        self.when = dict.fromkeys(self.worst, "")  # in what time in operation, mode and state
        self.moves: list[Move] = []  # of each time in operation
        self._noise = np.random.default_rng([build.seed, 8])
        self._control_before = 0
        self._target: float | None = None  # m, where the line of csp ended
        self._held = build.position
        self._opening = self._closing = 0
        self._is_open = build.opens is None
        self._memory = -self.servo.p[um.GRAVITY]  # N that hold the axis, as set by who commissioned the drive
        self._ramp = (0.0, 0.0, 0.0)  # position, velocity and time at rest of a quick stop
        self.values = self._beginning()
        self._show()

    def _beginning(self) -> dict[str, int]:
        build = self.build
        cycle_value, cycle_exponent = interpolation_time(build.cycle_time)
        values = dict.fromkeys(cia402.OBJECTS, 0) | {
            "device_type": 0x00020192,
            "vendor": 0x00ABCDEF,
            "product": 17,
            "revision": 3,
            "serial": 4711 + build.seed,
            "connection_option": 1,
            "quick_stop_option": 2,
            "mode": cia402.CSP,
            "mode_display": cia402.CSP,
            "max_torque": 3000,
            "rated_torque": build.rated_milli,
            "following_error_window": _ANY,
            "max_motor_speed": _ANY,
            "position_least": -(1 << 31),
            "position_most": (1 << 31) - 1,
            "quick_stop_deceleration": round(3.0 / build.metre),
            "supported_modes": sum(1 << (mode - 1) for mode in cia402.MODES.values()),
            "cycle_value": cycle_value,
            "cycle_exponent": cycle_exponent,
        }
        if build.turns is not None:
            counts, _, gear, _ = build.turns
            values |= {"encoder_increments": round(counts), "encoder_turns": 1}
            values |= {"gear_motor_turns": round(1000 * gear), "gear_shaft_turns": 1000}
            values |= {"feed_constant": round(counts * gear), "feed_shaft_turns": 1}
        return values

    # ------------------------------------------------------------------------------------------------- objects

    def has(self, name: str) -> bool:
        """True if the drive has the object."""
        if name == "second_position":
            return self.servo.p[um.LOAD_ENCODER] > 0.0
        index = cia402.OBJECTS[name].index
        if index in (0x608F, 0x6091, 0x6092):
            return self.build.turns is not None and self.build.own_objects
        if index == 0x6080:
            return self.build.turns is not None
        return name in cia402.OBJECTS and name not in self.build.absent

    def read(self, index: int, subindex: int) -> bytes:
        """The content of an object."""
        if (index, subindex) == cia402.DEVICE_NAME:
            # the name by which a master believes that it may run without a clock
            return cia402.VIRTUAL.encode()
        entry = cia402.AT.get((index, subindex))
        same = [other for other in cia402.AT.values() if other.index == index and self.has(other.name)]
        if entry is None or not self.has(entry.name):
            if subindex == 0 and same:
                return bytes([max(other.subindex for other in same)])
            raise SdoAbortError(NO_SUBINDEX if same else NO_OBJECT)
        return entry.encode(self.values[entry.name])

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Change an object."""
        entry = cia402.AT.get((index, subindex))
        if entry is None or not self.has(entry.name):
            raise SdoAbortError(NO_OBJECT)
        if entry.name not in _WRITABLE:
            raise SdoAbortError(READ_ONLY)
        if len(content) != entry.bits // 8:
            raise SdoAbortError(WRONG_LENGTH)
        value = entry.decode(content)
        wrong_mode = entry.name == "mode" and value not in (0, *cia402.MODES.values())
        own_cycle = interpolation_time(self.cycle_time)
        wrong_time = entry.name == "cycle_value" and (value, self.values["cycle_exponent"]) != own_cycle
        if wrong_mode or wrong_time:
            raise SdoAbortError(TOO_LARGE)
        self.values[entry.name] = value

    def take(self, sent: Mapping[str, int]) -> None:
        """Accept the process data of a cycle."""
        if self.faults.is_arriving:
            self.values.update(sent)

    @property
    def told(self) -> Mapping[str, int]:
        """The values for the master."""
        return self.values

    def lost(self) -> None:
        """React to a lost connection."""
        if self.values["connection_option"] != 0 and self.state in _POWERED:
            self._fault(0x7500)
            self._show()

    def old_control(self) -> dict[str, Any]:
        """What must be as before after a refusal: gains and mode in the drive, and that it is off."""
        p = self.servo.p
        return {"gains": (p[um.KV], p[um.KP], p[um.RATE]), "mode": self.values["mode"], "off": self.state}

    # ------------------------------------------------------------------------------------------------- a cycle

    def cycle(self) -> None:
        """Run one bus cycle with the last process data."""
        values, servo, before = self.values, self.servo, self.state
        self._obey_controlword()
        is_new = self.state is not before
        if values["mode"] in cia402.MODES.values() and not (
            self.build.fixed_mode and before in _POWERED and self.state in _POWERED
        ):
            values["mode_display"] = values["mode"]
        if before in _POWERED and self.state not in _POWERED:
            self._power_down()
        if self.state is PowerState.QUICK_STOP and is_new:
            here = servo.reading if self._target is None else self._target
            self._ramp = (here, servo.s[um.SPEED], 0.0)
        servo.u[um.MOST] = values["max_torque"] * self.build.newton
        error = 0
        if self.state is PowerState.ENABLED:
            error = self._follow()
        elif self.state is PowerState.QUICK_STOP:
            self._brake_down()
        elif self._opening:
            self._wait_for_brake()
        elif self._closing and self._is_held:
            self._loop(um.POSITION)
            servo.cycle(begin=self._held, end=self._held, set_velocity=0.0, added=0.0, braked=0.0)
        else:
            self._loop(um.OFF)
            servo.cycle(braked=0.0 if self._is_open else 1.0)
        if self._closing:
            self._closing -= 1
            self._is_open = self._closing > 0
        self.cycles += 1
        turns = self.build.turns
        if self.state in _POWERED and turns is not None:
            _, lead, gear, _ = turns
            if 60.0 * abs(servo.s[um.SPEED]) * gear / lead > values["max_motor_speed"]:
                error = error or 0x8400
        if error:
            self._fault(error)
        self._keep()
        self._show()
        self.faults.advance()

    def _obey_controlword(self) -> None:
        control = self.values["controlword"]
        wanted = cia402.answer(self.state, control, self._control_before)
        self._control_before = control
        if wanted is PowerState.ENABLED and self.state is not wanted and self.build.opens is not None:
            if not self._opening:
                self._held, self._closing = self.servo.reading, 0
            self._opening += 1
            if self._opening * self.cycle_time < self.build.opens:
                return
            self._is_open = True
        if self._opening and wanted is not PowerState.ENABLED:
            self._closing, self._is_held = (0 if not self._is_open else self._cycles_to_close()), True
        self._opening = 0
        if wanted is PowerState.ENABLED and self.state is not wanted:
            true = self.servo.s[um.X2]
            self.moves.append(Move(true, true, (true, 0)))
        if self.state is PowerState.FAULT and wanted is not self.state:
            self.values["error_code"] = 0
        self.state = wanted

    def _cycles_to_close(self) -> int:
        return max(1, round(self.build.closes / self.cycle_time))

    def _power_down(self) -> None:
        """End the operation: with a brake the axis is held until it has closed, if it stands and nothing failed."""
        servo = self.servo
        if self.build.opens is None:
            return
        stands = abs(servo.s[um.SPEED]) < STANDS / self.build.radius
        self._is_held = stands and self.state is not PowerState.FAULT
        self._held, self._closing = servo.reading, self._cycles_to_close()
        if self._is_held and servo.u[um.LOOP] == um.POSITION:
            self._memory = servo.s[um.SUM]

    def _fault(self, code: int) -> None:
        powered = self.state in _POWERED
        self.state = PowerState.FAULT
        self.values["error_code"] = code
        if powered:
            self._power_down()

    def _loop(self, loop: float, added: float = 0.0) -> None:
        """Change what of the control runs, without a jump of the force but from `OFF`."""
        servo = self.servo
        before = servo.u[um.LOOP]
        if before == loop:
            return
        servo.u[um.LOOP] = loop
        servo.hold(servo.reading, added)
        if loop in (um.POSITION, um.VELOCITY):
            if before == um.OFF:
                servo.s[um.SUM] = self._memory if self.build.opens is not None else 0.0
            elif before == um.FORCE_ONLY:
                servo.s[um.SUM] = servo.s[um.COMMAND]
        self._target = None

    def _wait_for_brake(self) -> None:
        """The power stage is on while the brake opens."""
        values, build = self.values, self.build
        if values["mode_display"] == cia402.CST:
            force = build.sign * build.newton * (values["target_torque"] + values["torque_offset"])
            self._loop(um.FORCE_ONLY, force)
            self.servo.cycle(added=force, braked=1.0)
            return
        self._loop(um.POSITION)
        self.servo.cycle(begin=self._held, end=self._held, set_velocity=0.0, added=0.0, braked=1.0)

    def _follow(self) -> int:
        """Run a cycle in operation; return an error code, or 0."""
        values, build, servo = self.values, self.build, self.servo
        offset = build.sign * build.newton * values["torque_offset"]
        mode = values["mode_display"]
        if mode == cia402.CST:
            force = offset + build.sign * build.newton * values["target_torque"]
            self._loop(um.FORCE_ONLY, force)
            servo.cycle(added=force, braked=0.0)
            return 0
        if mode == cia402.CSV:
            self._loop(um.VELOCITY)
            speed = build.metre * (values["target_velocity"] + values["velocity_offset"])
            servo.cycle(begin=0.0, end=0.0, set_velocity=speed, added=offset, braked=0.0)
            return 0
        counts = values["target_position"]
        if not values["position_least"] <= counts <= values["position_most"]:
            return 0x8612
        fresh = servo.u[um.LOOP] != um.POSITION
        self._loop(um.POSITION)
        target = counts * build.metre
        begin = target if fresh or self._target is None else self._target
        speed = build.metre * values["velocity_offset"]
        if "velocity_offset" in build.absent:
            speed = build.feedforward * (target - begin) / self.cycle_time
        servo.cycle(begin=begin, end=target, set_velocity=speed, added=offset, braked=0.0)
        self._target = target
        error = counts - round(servo.reading / build.metre)
        values["following_error"] = _within("following_error", error)
        self.worst["following_error"] = max(self.worst["following_error"], abs(error) * build.metre)
        window = values["following_error_window"]
        return 0x8611 if window != _ANY and abs(error) > window else 0

    def _brake_down(self) -> None:
        """Run a cycle of a quick stop: a ramp of 0x6085, and a moment at rest."""
        self._loop(um.POSITION)
        position, velocity, rested = self._ramp
        step = max(1, self.values["quick_stop_deceleration"]) * self.build.metre * self.cycle_time
        after = math.copysign(max(0.0, abs(velocity) - step), velocity)
        end = position + 0.5 * (velocity + after) * self.cycle_time
        self.servo.cycle(begin=position, end=end, set_velocity=0.5 * (velocity + after), added=0.0, braked=0.0)
        rested += self.cycle_time if after == 0.0 else 0.0
        self._ramp = (end, after, rested)
        if rested >= WAITS and self.values["quick_stop_option"] < 5:
            self.state = PowerState.SWITCH_ON_DISABLED
            self._power_down()

    def _keep(self) -> None:
        """Record the truth."""
        s, worst = self.servo.s, self.worst
        self.true.append(s[um.X2])
        self.true_motor.append(s[um.X1])
        now = {
            "travel": max(s[um.HIGH] - self.start, self.start - s[um.LOW]),
            "velocity": s[um.FASTEST],
            "force": s[um.STRONGEST],
        }
        for name, value in now.items():
            if value > worst[name]:
                worst[name] = value
                self.when[name] = f"operation {len(self.moves)}, cycle {self.cycles}, {self.state.words}"
        if self.moves and self.state in _POWERED:
            self.moves[-1].goes_on(s[um.X2], self.cycle_time, SEEN / self.build.radius)

    def _show(self) -> None:
        build, s = self.build, self.servo.s
        torque = build.sign * s[um.FORCE] / build.newton
        if build.torque_noise:
            torque += build.torque_noise * self._noise.standard_normal()
        shown = {
            "position": self.servo.reading / build.metre,
            "second_position": s[um.READING_MOTOR] / build.metre,
            "velocity": s[um.SPEED] / build.metre,
            "torque": torque,
        }
        for name, value in shown.items():
            self.values[name] = _within(name, round(value))
        status = self.state.status | 1 << 9
        self.values["statusword"] = status | (1 << 12 if self.state is PowerState.ENABLED else 0)


def _within(name: str, value: int) -> int:
    least, most = cia402.OBJECTS[name].bounds()
    return max(least, min(most, value))


# ----------------------------------------------------------------------------------------------------- the person


class Person(Progress):
    """A person who confirms everything, and measures with a ruler how far the axis went.

    The ruler lies at the table while the axis moves, and is read where the table stands: at the end of the move or, if
    it went and came back, at the farthest stand; to 0.1 mm (at the rim of a table) or 0.5 %, whichever is more.
    `questions` counts both kinds.
    """

    def __init__(self, firmware: Callable[[], Firmware]) -> None:
        super().__init__()
        self._firmware = firmware
        self.asked: list[str] = []
        self.heard: list[str] = []

    @property
    def questions(self) -> int:
        return len(self.asked)

    def confirm(self, question: str) -> bool:
        self.asked.append(str(question))
        return True

    def measured(self, text: str, expected: float, unit: str) -> float | None:
        """The distance of the last move in the unit asked for, with the sign of the expected one."""
        build = self._firmware().build
        scales = {"rad": 1.0, "deg": 180.0 / math.pi} if build.turning else {"m": 1.0, "mm": 1e3, "um": 1e6}
        scale, true = scales[unit], self.last_move()
        step = max(1e-4 / build.radius, 5e-3 * true)
        answer = math.copysign(round(scale * step * round(true / step), 9), expected)
        self.asked.append(f"{text} [{expected:g} {unit} expected; answered {answer:g}]")
        return answer

    def last_move(self) -> float:
        """The distance of the last move at the table, m."""
        moves = self._firmware().moves
        if not moves:
            return 0.0
        last = moves[-1]
        places = [abs(place - last.start) for place in (last.end, *last.stands)]
        # a table that stands nowhere out there is seen at its turn
        return next((place for place in (places[0], max(places)) if place > 0.2 * last.farthest), last.farthest)

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.heard.append(str(what))

    def show_remark(self, message: str | Table) -> None:
        self.heard.append(str(message))


# ------------------------------------------------------------------------------------------------------- the draw


@dataclass
class Unknown:
    """One drawn drive: what is told about it, and what is not."""

    seed: int
    traits: tuple[str, ...]
    bus: str
    file: str  # text of the drive file, as the user wrote it
    limits: Limits
    truth: Truth
    build: Build
    firmware: Firmware = field(repr=False)
    drawn: SimpleNamespace = field(repr=False)

    def transport(self) -> VirtualEtherCAT | VirtualCANopen:
        """A transport of the drive's bus to the firmware, in virtual time."""
        return (VirtualEtherCAT if self.bus == "ethercat" else VirtualCANopen)(cast("Any", self.firmware))

    def person(self) -> Person:
        return Person(lambda: self.firmware)

    def write(self, folder: Path) -> Path:
        """Write the drive file."""
        path = folder / f"drive_{self.seed}.toml"
        path.write_text(self.file, encoding="utf-8")
        return path

    def excursions(self) -> dict[str, float]:
        """How many times each limit was reached, if it was exceeded: in true lengths and forces, in all cycles so far.

        The travel counts from where the axis stood at the very first, whatever motions followed.
        """
        shares = {
            "travel": self.firmware.worst["travel"] / self.limits.travel,
            "velocity": self.firmware.worst["velocity"] / self.limits.velocity,
            "force": self.firmware.worst["force"] / self.limits.force,
        }
        return {name: share for name, share in shares.items() if share > 1.0}


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _rounded(value: float, digits: int = 2) -> float:
    return float(f"{value:.{digits - 1}e}")


def draw_traits(rng: np.random.Generator) -> tuple[str, ...]:
    """Two to four traits; a vertical axis has its brake anyhow."""
    many = int(rng.integers(2, 5))
    traits: list[str] = []
    for trait in rng.permutation(TRAITS).tolist():
        if {trait, *traits} >= {"vertical", "brake"}:
            continue
        traits.append(trait)
        if len(traits) == many:
            break
    return tuple(trait for trait in TRAITS if trait in traits)


def draw(seed: int, traits: tuple[str, ...] | None = None) -> Unknown:
    """Draw a drive; `traits` in place of those of the seed."""
    rng = np.random.default_rng([seed, 402])
    own = draw_traits(rng)
    traits = own if traits is None else traits
    screw = "rotary" in traits or "gear" in traits
    turning = "rotary" in traits and bool(rng.random() < 0.5)
    # drawn as a linear axis at the rim of the table, and turned into angles and torques at the end
    radius = float(rng.uniform(0.1, 0.3)) if turning else 1.0
    vertical, braked = "vertical" in traits, bool({"vertical", "brake"} & set(traits))
    # ---- what moves
    mass = _log(rng, 15.0, 300.0)
    motor = mass * float(rng.uniform(0.3, 0.65) if screw else rng.uniform(0.5, 0.8))
    load = mass - motor
    tail = float(rng.uniform(0.15, 0.5)) * load if "mode" in traits else 0.0
    load -= tail
    frequency = _log(rng, 90.0, 350.0) if screw else _log(rng, 200.0, 700.0)
    stiffness = (2.0 * math.pi * frequency) ** 2 * motor * load / (motor + load)
    damping = 2.0 * float(rng.uniform(0.01, 0.05)) * math.sqrt(stiffness * motor * load / (motor + load))
    mode = float(rng.uniform(45.0, 80.0))
    swinging = tail * (mass - tail) / mass
    tail_stiffness = (2.0 * math.pi * mode) ** 2 * swinging
    tail_damping = 2.0 * float(rng.uniform(0.01, 0.04)) * math.sqrt(tail_stiffness * swinging)
    capability = float(rng.uniform(4.0, 12.0))  # m/s² that the motor's force can give
    dynamic = mass * capability
    velocity = _rounded(_log(rng, 0.05, 0.4), 1)
    coulomb = float(rng.uniform(0.02, 0.08)) * dynamic
    on_load = float(rng.uniform(0.3, 0.7))
    viscous = float(rng.uniform(0.02, 0.08)) * dynamic / velocity
    ratio = float(rng.uniform(1.25, 1.8)) if "stribeck" in traits else 1.0
    stribeck_velocity = _log(rng, 1e-3, 8e-3)
    gravity = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)) * mass * GRAVITY if vertical else 0.0
    gap = float(rng.uniform(3e-6, 25e-6)) if "backlash" in traits else 0.0
    # ---- motor and encoders
    strongest = dynamic + coulomb * ratio + abs(gravity)
    lead = float(rng.choice([5e-3, 10e-3, 16e-3, 20e-3, 25e-3]))
    gear = float(rng.choice([1.0, 1.0, 1.0, 1.5, 2.0]))
    if turning:
        lead, gear = 2.0 * math.pi * radius, float(rng.choice([36.0, 90.0, 180.0]))
    counts = float(rng.choice([40_000, 2**17, 2**20]))
    increment = float(rng.choice([5e-9, 10e-9, 50e-9, 100e-9, 500e-9]))
    rated = strongest / float(rng.uniform(1.5, 2.8))
    if screw:
        metre = lead / (gear * counts)
        torque = _rounded(rated * lead / (2.0 * math.pi * gear), 3)
        newton, rated_milli = 1e-3 * torque * gear * 2.0 * math.pi / lead, round(1e3 * torque)
    else:
        metre, torque = increment, 0.0
        rated = _rounded(rated, 3)
        newton, rated_milli = 1e-3 * rated, round(1e3 * rated)
    two = screw and bool(rng.random() < 0.5)
    count_load = float(rng.choice([10e-9, 50e-9, 100e-9, 500e-9])) if two else 1e-9
    cogging = float(rng.uniform(0.02, 0.06)) * dynamic if "cogging" in traits else 0.0
    period = lead / gear / float(rng.choice([1.0, 3.0, 4.0])) if screw else float(rng.uniform(12e-3, 40e-3))
    # ---- drive
    cycle_time = float(rng.choice(CYCLES))
    bus = "canopen" if cycle_time == 1e-3 and rng.random() < 0.4 else "ethercat"
    base = int(rng.integers(0, 3))
    delay = base + (round(1e-3 / SAMPLE) if "delay" in traits else 0)
    bandwidth = 2.0 * math.pi * float(rng.uniform(6.0, 14.0))  # 1/s, of the velocity loop
    current_loop = _log(rng, 400.0, 1500.0)
    substeps = 5
    parameters = {
        um.SUBSTEPS: float(substeps),
        um.MASS_MOTOR: motor,
        um.MASS_LOAD: load,
        um.MASS_TAIL: tail,
        um.STIFFNESS: stiffness,
        um.DAMPING: damping,
        um.TAIL_STIFFNESS: tail_stiffness,
        um.TAIL_DAMPING: tail_damping,
        um.GAP: gap,
        um.VISCOUS_MOTOR: (1.0 - on_load) * viscous,
        um.VISCOUS_LOAD: on_load * viscous,
        um.COULOMB_MOTOR: (1.0 - on_load) * coulomb,
        um.COULOMB_LOAD: on_load * coulomb,
        um.BREAKAWAY: ratio,
        um.STRIBECK_VELOCITY: stribeck_velocity,
        um.GRAVITY: gravity,
        um.COGGING: cogging,
        um.COGGING_SECOND: float(rng.uniform(0.1, 0.4)),
        um.COGGING_PERIOD: period,
        um.COGGING_PHASE: float(rng.uniform(0.0, 2.0 * math.pi)),
        um.BRAKE: 2.0 * abs(gravity) + 0.5 * dynamic if braked else 0.0,
        um.FORCE_SHARE: 1.0 - math.exp(-2.0 * math.pi * current_loop * SAMPLE / substeps),
        um.DELAY: float(delay),
        um.COUNT_MOTOR: metre,
        um.COUNT_LOAD: count_load,
        um.NOISE: float(rng.uniform(0.0, 0.8)),
        um.LOAD_ENCODER: float(two),
        um.SPEED_SHARE: SAMPLE / (SAMPLE + float(rng.uniform(0.1e-3, 0.6e-3))),
    }
    # ---- what the user states
    stated = strongest / float(rng.uniform(0.3, 0.6)) if "saturation" in traits else strongest
    parameters[um.CURRENT_LIMIT] = strongest if "saturation" in traits else stated * float(rng.uniform(1.05, 1.6))
    braking = min(5.0, 0.4 * capability)
    travel = max(_log(rng, 0.03, 0.25), velocity * velocity / braking + 0.02)
    # ---- angles and torques
    parameters = {index: value * radius ** um.POWERS.get(index, 0) for index, value in parameters.items()}
    mass, metre, newton, lead = mass * radius**2, metre / radius, newton * radius, lead / radius
    coulomb, gravity, cogging, viscous = coulomb * radius, gravity * radius, cogging * radius, viscous * radius**2
    gap, stribeck_velocity = gap / radius, stribeck_velocity / radius
    velocity, braking = (_rounded(value / radius, 2) for value in (velocity, braking))
    per_length = 180.0 / math.pi if turning else 1e3  # degrees or mm, in which a person states lengths
    travel = _rounded(per_length * travel / radius, 2) / per_length
    stated, current_limit = _rounded(stated * radius, 2), parameters[um.CURRENT_LIMIT]
    sign = -1 if "sign" in traits else 1
    factor = _factor(rng) if "gear" in traits else 1.0
    wrong_lead = bool(rng.random() < 0.5)
    absent = ("velocity_offset",) if rng.random() < 0.3 else ()
    build = Build(
        parameters=parameters,
        metre=metre,
        newton=newton,
        sign=sign,
        rated_milli=rated_milli,
        turns=(counts, lead, gear, torque) if screw else None,
        cycle_time=cycle_time,
        position=metre * float(rng.integers(-1_000_000, 1_000_000)),
        own_objects="gear" not in traits,
        absent=absent + (("following_error",) if rng.random() < 0.2 else ()),
        feedforward=float(rng.uniform(0.9, 1.0)),
        opens=float(rng.uniform(0.03, 0.12)) if braked else None,
        closes=float(rng.uniform(0.02, 0.06)),
        fixed_mode=bool(rng.random() < 0.25),
        lost=float(rng.uniform(0.002, 0.02)) if "lost" in traits else 0.0,
        torque_noise=float(rng.uniform(0.0, 1.5)),
        turning=turning,
        radius=radius,
        seed=seed,
    )
    build = replace(build, position=settled(build))
    # the sluggish control of the drive, slower where it is not quiet enough
    for _ in range(6):
        gains = {um.KP: bandwidth * mass, um.RATE: bandwidth / 6.0, um.KV: bandwidth / 4.0}
        build = replace(build, parameters={**parameters, **gains})
        peak, swing = rehearse(build, velocity, braking, travel)
        if swing < 0.05 * peak + 30.0 * metre:
            break
        bandwidth *= 0.7
    else:
        raise AssertionError(f"seed {seed}: no stable control of its own: {peak} m, swings by {swing} m at rest")
    following = _rounded(per_length * max(2e-4 / radius, 2.2 * peak), 1) / per_length
    limits = Limits(travel, velocity, stated, following, braking)
    if screw:
        file_lead, file_gear = (lead * factor, gear) if wrong_lead else (lead, gear / factor)
        written = f"lead_deg = {math.degrees(file_lead):.10g}" if turning else f"lead_mm = {1e3 * file_lead:.10g}"
        scaling = (
            f"counts_per_turn = {counts:.0f}\n{written}\ngear = {file_gear:.10g}\nrated_torque = {torque!r}   # N m"
        )
    else:
        scaling = f"increment = {metre!r}   # m\nrated_force = {1e-3 * rated_milli!r}   # N"
    truth = Truth(
        mass=mass,
        coulomb=coulomb,
        breakaway=coulomb * ratio,
        stribeck_velocity=stribeck_velocity,
        viscous=viscous,
        gravity=gravity,
        resonance=frequency,
        mode=mode if tail else 0.0,
        gap=gap,
        cogging=cogging,
        delay=delay * SAMPLE,
        current_limit=current_limit,
        metre=metre,
        newton=newton,
        sign=sign,
        length_factor=1.0 / factor,
    )
    drawn = SimpleNamespace(two_encoders=two, screw=screw, bandwidth=bandwidth, rehearsed=(peak, swing))
    text = _file(bus, cycle_time, scaling, limits, turning)
    return Unknown(seed, traits, bus, text, limits, truth, build, Firmware(build), drawn)


def _factor(rng: np.random.Generator) -> float:
    """Of the file's lead over the true one: a slip of the pen, or any."""
    if rng.random() < 0.6:
        return float(rng.choice([0.2, 0.25, 0.4, 0.5, 2.0, 2.5, 4.0, 5.0]))
    near = _log(rng, 0.2, 5.0)
    return near if abs(math.log(near)) > 0.05 else 1.25


def _file(bus: str, cycle_time: float, scaling: str, limits: Limits, turning: bool) -> str:
    per_length, unit, force = (180.0 / math.pi, "deg", "N m") if turning else (1e3, "mm", "N")
    return (
        f'# as the user wrote it\nbus = "{bus}"\ninterface = "eth1"\nstation = 1\n'
        f'cycle_time_us = {1e6 * cycle_time:g}\nmode = "csp"\n{"rotary = true" if turning else ""}\n\n'
        f"[scaling]\n{scaling}\n\n[limits]\ntravel_{unit} = {per_length * limits.travel:.10g}\n"
        f"velocity = {limits.velocity!r}   # {'rad/s' if turning else 'm/s'}\nforce = {limits.force!r}   # {force}\n"
        f"following_error_{unit} = {per_length * limits.following_error:.10g}\n"
        f"quick_stop_deceleration = {limits.quick_stop_deceleration!r}\n"
    )


def smooth(rows: int) -> np.ndarray:
    """From 0 to 1 within so many rows, with a jerk that is bounded."""
    s = np.arange(1, rows + 1) / rows
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def settled(build: Build) -> float:
    """Where the axis stands with its drive off: cogging may have pulled it from where it was put, m."""
    firmware = Firmware(replace(build, lost=0.0))
    still = 0
    while still < round(0.2 / build.cycle_time) and firmware.cycles * build.cycle_time < 60.0:
        firmware.cycle()
        still = still + 1 if firmware.servo.s[um.FASTEST] < 1e-9 else 0
    return build.metre * round(firmware.servo.s[um.X1] / build.metre)


def switch_on(firmware: Firmware, mode: int = cia402.CSP) -> None:
    """Switch a firmware on without a bus, at its present position."""
    values = firmware.values
    values["mode"] = mode
    for command in (cia402.SHUTDOWN, cia402.SWITCH_ON):
        values["controlword"] = command
        firmware.cycle()
    values["controlword"] = cia402.ENABLE_OPERATION
    for _ in range(round(1.0 / firmware.cycle_time)):
        values["target_position"] = values["position"]
        firmware.cycle()
        if firmware.state is PowerState.ENABLED:
            return
    raise AssertionError("does not switch on")


def rehearse(build: Build, velocity: float, braking: float, travel: float) -> tuple[float, float]:
    """What its user knows of his axis: the largest following error of a quick move there and back, and
    by how much the axis swings at rest, m.
    """
    firmware = Firmware(build)
    switch_on(firmware)
    T, values = build.cycle_time, firmware.values
    distance = min(0.5 * travel, 4.0 * velocity * velocity / braking)
    # the largest speed of the move is 15/8 of the mean one, its acceleration 5.77 d/t²
    time = max(1.875 * distance / (0.8 * velocity), math.sqrt(5.77 * distance / (0.6 * braking)))
    way = smooth(max(1, round(time / T)))
    hold, rest = np.full(round(0.1 / T), 1.0), np.zeros(round(0.6 / T))
    path = distance * np.concatenate([0.0 * hold, way, hold, way[::-1], rest])
    speed = np.gradient(path, T)
    begin = values["position"]
    errors, here = np.empty(path.size), np.empty(path.size)
    for k in range(path.size):
        values["target_position"] = begin + round(path[k] / build.metre)
        values["velocity_offset"] = round(speed[k] / build.metre)
        firmware.cycle()
        here[k] = build.metre * values["position"]
        errors[k] = build.metre * values["target_position"] - here[k]
    # an integral that has not unstuck the axis yet makes it creep in one direction, an unstable loop in both
    block = round(5e-3 / T)
    steps = np.diff(here[-60 * block :].reshape(60, block).mean(1))
    swing = min(float(np.sum(steps[steps > 0.0])), -float(np.sum(steps[steps < 0.0])))
    return float(np.max(np.abs(errors))), swing
