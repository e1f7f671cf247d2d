"""The component that plays motions in LinuxCNC, alone in a real halrun: each way in which a motion ends."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from feeddrive.export.linuxcnc import text
from feeddrive.export.linuxcnc_session import halrun, stream_pin
from hal_programs import needs_linuxcnc

T = 1e-3
PINS = {
    "run-number": "u",
    "listens": "b",
    "stop": "b",
    "cancel": "b",
    "reset": "b",
    "row": "u",
    "row-position": "f",
    "row-velocity": "f",
    "row-acceleration": "f",
    "row-excitation": "f",
    "row-new": "b",
    "row-log": "b",
    "row-last": "b",
    "position-fb": "f",
    "old-command": "f",
    "new-force": "f",
    "new-fault": "b",
    "new-running": "b",
    "drive-fault": "b",
}
SEEN = {
    "force": "f",
    "set-position": "f",
    "set-velocity": "f",
    "old-enable": "b",
    "new-enable": "b",
    "drive-enable": "b",
    "brake-open": "b",
    "off": "b",
    "logging": "b",
    "active": "u",
    "handover": "f",
    "control-force": "f",
    "fault-code": "s",
    "fault-value": "f",
    "ended": "u",
    "command": "f",
    "streaming": "b",
}
# in mm: a deceleration of 1 mm/s in each period
SETTINGS = {
    "force-per-unit": 2,
    "travel-limit": 10.02,
    "velocity-limit": 100,
    "force-limit": 50,
    "error-limit": 1,
    "deceleration": 1000,
    "position-least": -5.02,
    "force-time": 0.005,
    "rest-time": 0.01,
    "coast-time": 0.02,
    "handover-rows": 10,
    "brake-time": 0.004,
}
SPEED, BEGUN, ROWS = 50.0, 20, 40


class Motion:
    """Inputs of a motion at constant speed that the axis follows exactly, row by row; row 0 asks for it."""

    def __init__(self, rows: int = ROWS, speed: float = SPEED, tail: int = 120) -> None:
        count = 1 + rows + tail
        self.at = {name: np.zeros(count) for name in PINS}
        k = np.arange(count)
        self.at["row"][:] = k
        self.at["row-position"][:] = np.minimum(k, rows) * speed * T
        self.at["row-velocity"][1:] = speed
        self.at["row-log"][:] = 1.0
        self.at["row-last"][rows + 1 :] = 1.0
        self.at["position-fb"][:] = self.at["row-position"]
        self.at["old-command"][:] = 2.5
        self.at["new-force"][:] = 5.0
        self.at["new-running"][:] = 1.0
        self.at["run-number"][:] = 1.0
        # behind the motion, when the axis is off
        self.at["reset"][-1] = 1.0

    def __getitem__(self, name: str) -> np.ndarray:
        return self.at[name]

    def braked(self, row: int, speed: float = SPEED) -> None:
        """Let the axis follow the ramp that begins in a row."""
        x, v = float(self.at["position-fb"][row - 1]), speed
        for k in range(row, len(self.at["row"])):
            after = math.copysign(max(0.0, abs(v) - SETTINGS["deceleration"] * T), v)
            x += 0.5 * (v + after) * T
            v = after
            self.at["position-fb"][k] = x


def cases() -> dict[str, Motion]:
    """A motion for each way in which one ends."""
    made = {name: Motion() for name in ("whole", "listens", "stopped before", "handed over", "in fault", "not running")}
    made["whole"]["row-excitation"][5:30] = 3.0
    made["listens"]["listens"][:] = 1.0
    made["stopped before"]["stop"][0] = 1.0
    made["handed over"]["row-new"][10:30] = 1.0
    made["handed over"]["new-force"][:] = 30.0
    for name, pin, value in (("in fault", "new-fault", 1.0), ("not running", "new-running", 0.0)):
        made[name]["row-new"][10:] = 1.0
        made[name][pin][BEGUN:] = value
        made[name]["new-force"][BEGUN:] = 0.0
        made[name].braked(BEGUN + 1)
    for name, pin in (("stopped", "stop"), ("cancelled", "cancel")):
        made[name] = Motion()
        made[name][pin][BEGUN:] = 1.0
        made[name].braked(BEGUN)
        made[name][pin][-1] = 0.0
    made["dry"] = Motion()
    made["dry"]["row"][BEGUN:] = BEGUN - 1
    made["dry"].braked(BEGUN)
    made["jumping row"] = Motion()
    made["jumping row"]["row-position"][BEGUN:] += 5.0
    made["jumping row"]["row-velocity"][BEGUN:] = np.nan
    made["jumping row"].braked(BEGUN)
    # 3 periods and v²/2a before the end of the travel: 10.02 mm - 0.15 mm - 1.25 mm
    made["travel"] = Motion(220)
    made["travel"].braked(174)
    made["beyond"] = Motion(220)
    made["ends"] = Motion(220, -SPEED)
    made["ends"].braked(74, -SPEED)
    made["velocity"] = Motion()
    made["velocity"]["position-fb"][BEGUN:] += 0.12 * np.minimum(np.arange(len(made["velocity"]["row"]) - BEGUN), 8)
    made["force"] = Motion()
    made["force"]["old-command"][BEGUN:] = 30.0
    made["error"] = Motion(60)
    made["error"]["position-fb"][BEGUN:] = made["error"]["position-fb"][BEGUN]
    made["reading"] = Motion()
    made["reading"]["position-fb"][BEGUN] = np.nan
    made["command"] = Motion()
    made["command"]["old-command"][BEGUN] = np.nan
    made["drive"] = Motion()
    made["drive"]["drive-fault"][BEGUN] = 1.0
    made["runaway"] = Motion(speed=20.0)
    fled = made["runaway"]["position-fb"]
    fled[BEGUN:] = fled[BEGUN - 1] - 0.02 * np.arange(1, len(fled) - BEGUN + 1)
    made["runaway"]["old-command"][:] = -2.5
    return made


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, np.ndarray]]:
    """What the component answers in each motion, by pin; all motions of one session, one after the other."""
    folder = tmp_path_factory.mktemp("excite")
    (folder / "made").mkdir()
    component = folder / "made" / "feeddrive_excite.comp"
    component.write_text(text("feeddrive_excite.comp"), encoding="utf-8")
    motions = cases()
    for number, motion in enumerate(motions.values(), 1):
        motion["run-number"][:] = number
    rows = np.vstack([np.column_stack([motion[name] for name in PINS]) for motion in motions.values()])
    name = "feeddrive-excite"
    wiring = [
        "loadrt feeddrive_excite",
        f"addf {name}.set servo-thread",
        f"addf {name}.act servo-thread",
        *(f"setp {name}.{key} {value}" for key, value in SETTINGS.items()),
        *(f"net in-{i} {stream_pin(i)} => {name}.{pin}" for i, pin in enumerate(PINS)),
        *(f"net out-{i} {name}.{pin} => sampler.0.pin.{i}" for i, pin in enumerate(SEEN)),
    ]
    work = folder / "work"
    work.mkdir()
    got = halrun([component], work, 1_000_000, wiring, rows, "".join(PINS.values()), "".join(SEEN.values())).rows
    answers, at = {}, 0
    for key, motion in motions.items():
        count = len(motion["row"])
        answers[key] = {pin: got[at : at + count, i] for i, pin in enumerate(SEEN)} | motion.at
        at += count
    return answers


@needs_linuxcnc
def test_a_motion_is_played_as_it_is_streamed(seen: dict[str, dict[str, np.ndarray]]) -> None:
    """With the control of the axis, whose output is in units of 2 N, and an excitation; then the brake closes."""
    got = seen["whole"]
    moving, closing = slice(0, ROWS + 1), slice(ROWS + 1, ROWS + 5)
    assert np.all(got["fault-code"] == 0.0)
    assert np.array_equal(got["set-position"][moving], got["row-position"][moving])
    assert np.array_equal(got["force"][moving], 5.0 + got["row-excitation"][moving])
    assert np.array_equal(got["command"], got["force"] / 2.0)
    assert np.array_equal(got["logging"][moving], (np.arange(ROWS + 1) > 0).astype(float))
    assert np.all(got["old-enable"][moving] == 1.0)
    assert not np.any(got["new-enable"])
    # held by its control until the brake has closed
    assert np.all(got["drive-enable"][closing] == 1.0)
    assert np.all(got["force"][closing] == 5.0)
    assert not np.any(got["brake-open"][closing])
    after = slice(ROWS + 6, None)
    for pin in ("force", "drive-enable", "old-enable", "logging", "streaming"):
        assert not np.any(got[pin][after]), pin
    assert np.all(got["off"][after] == 1.0)
    assert got["ended"][-1] == 1.0


@needs_linuxcnc
def test_an_axis_that_is_listened_to_stays_off(seen: dict[str, dict[str, np.ndarray]]) -> None:
    got = seen["listens"]
    assert np.all(got["logging"][1 : ROWS + 1] == 1.0)
    for pin in ("force", "drive-enable", "old-enable", "brake-open", "fault-code"):
        assert not np.any(got[pin]), pin
    assert np.array_equal(got["set-position"], got["position-fb"]), "what comes on later begins where the axis is"


@needs_linuxcnc
def test_a_switch_hands_the_force_over(seen: dict[str, dict[str, np.ndarray]]) -> None:
    """From 5 N to 30 N and back: both on in the period of the switch, and the difference fades over ten."""
    got = seen["handed over"]
    n = np.arange(11)
    fading = 0.5 * (1.0 + np.cos(np.pi * n / 10.0))
    assert np.allclose(got["force"][10:21], 30.0 - 25.0 * fading, rtol=0.0, atol=1e-12)
    assert np.allclose(got["force"][30:41], 5.0 + 25.0 * fading, rtol=0.0, atol=1e-12)
    assert got["force"][10] == 5.0
    assert got["handover"][20] == 0.0
    n = np.arange(8, 33)
    assert np.array_equal(got["new-enable"][8:33], (n >= 10) & (n <= 30))
    assert np.array_equal(got["old-enable"][8:33], (n <= 10) | (n >= 30))
    assert np.array_equal(got["active"][8:33], (n >= 10) & (n < 30))


@needs_linuxcnc
@pytest.mark.parametrize("how", ["in fault", "not running"])
def test_the_old_control_takes_over_from_one_that_fails(seen: dict[str, dict[str, np.ndarray]], how: str) -> None:
    """The last force is held for a period, then the old control, enabled anew, brakes from that force on."""
    got = seen[how]
    assert got["fault-code"][BEGUN] == 9.0
    assert np.all(got["force"][15 : BEGUN + 2] == pytest.approx(5.0))
    assert got["old-enable"][BEGUN] == 0.0
    assert got["old-enable"][BEGUN + 1] == 1.0
    assert np.all(got["active"][BEGUN + 1 :] == 0.0)
    assert got["set-velocity"][BEGUN + 2] == pytest.approx(SPEED - 2.0)
    assert got["ended"][-1] - got["ended"][0] == 1.0


@needs_linuxcnc
@pytest.mark.parametrize(
    ("how", "row", "code"),
    [
        ("stopped", BEGUN, 1.0),
        ("cancelled", BEGUN, 1.0),
        ("dry", BEGUN, 2.0),
        ("travel", 173, 3.0),
        ("ends", 73, 12.0),
        ("jumping row", BEGUN, 13.0),
    ],
)
def test_the_axis_brakes_along_a_ramp(seen: dict[str, dict[str, np.ndarray]], how: str, row: int, code: float) -> None:
    """At 1 m/s² from 50 mm/s: 1.25 mm and 50 periods, 10 of rest and 4 of the brake, without the excitation."""
    got = seen[how]
    first = int(np.argmax(got["fault-code"] != 0.0))
    assert first == row
    assert got["fault-code"][first] == code
    way = abs(got["set-position"][-2] - got["set-position"][first - 1])
    # the fault of a limit is seen behind the controls, and the ramp begins in the next period
    assert way == pytest.approx(1.25 + 0.05 * (code in (3.0, 12.0)), abs=1e-9)
    held = np.flatnonzero(got["drive-enable"])
    assert held[-1] - first == pytest.approx(50 + 10 + 4, abs=4)
    assert np.all(got["force"][first : held[-1]] == 5.0), "its control goes on"
    assert got["ended"][-1] - got["ended"][0] == 1.0
    if how in ("travel", "ends"):
        assert np.max(np.abs(got["set-position"])) < {"travel": 10.02, "ends": 5.02}[how]


@needs_linuxcnc
@pytest.mark.parametrize(
    ("how", "row", "code"),
    [
        ("beyond", 201, 3.0),
        ("velocity", BEGUN + 4, 4.0),
        ("force", BEGUN + 5, 5.0),
        ("error", BEGUN + 21, 6.0),
        ("reading", BEGUN, 7.0),
        ("command", BEGUN, 8.0),
        ("drive", BEGUN, 10.0),
        ("runaway", BEGUN + 20, 11.0),
    ],
)
def test_the_force_is_off_at_once(seen: dict[str, dict[str, np.ndarray]], how: str, row: int, code: float) -> None:
    """In the period of the fault, which stays until it is reset."""
    got = seen[how]
    off = int(np.argmax(got["drive-enable"][1:] == 0.0)) + 1
    assert abs(off - row) <= 1
    assert got["fault-code"][-2] == (3.0 if how == "beyond" else code)
    for pin in ("force", "command", "drive-enable", "old-enable", "brake-open"):
        assert not np.any(got[pin][off:]), pin
    assert np.max(np.abs(got["force"][:off])) <= SETTINGS["force-limit"]
    assert got["ended"][-1] - got["ended"][0] == 1.0


@needs_linuxcnc
def test_no_motion_begins_under_a_stop(seen: dict[str, dict[str, np.ndarray]]) -> None:
    got = seen["stopped before"]
    assert got["fault-code"][0] == 1.0
    for pin in ("force", "drive-enable", "old-enable", "brake-open", "logging"):
        assert not np.any(got[pin]), pin


def test_the_component_is_a_file_of_the_package() -> None:
    """A shop reads it before its machine runs it."""
    path = Path(text.__code__.co_filename).parent / "templates" / "linuxcnc" / "feeddrive_excite.comp"
    assert "It is no safety function" in path.read_text(encoding="utf-8")
