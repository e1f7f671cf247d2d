"""The pids of LinuxCNC: bit for bit those of a running HAL, and a P-PI cascade where no limit acts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.controller.stock_pid import StockPid
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.export.linuxcnc_session import halrun
from feeddrive.language.block import declarations
from fresh_draws import Seeded
from hal_programs import needs_linuxcnc

PERIOD = 50_000  # ns
T = PERIOD * 1e-9

# each gain of a size at which it matters beside the others, for commands of size 1
SIZES = {
    "Pgain": 2.0,
    "Igain": 2e3,
    "Dgain": 1e-3,
    "FF0": 1.0,
    "FF1": 1e-3,
    "FF2": 1e-7,
    "FF3": 1e-11,
    "bias": 1.0,
    "deadband": 0.2,
    "maxerror": 1.0,
    "maxerrorI": 1e-4,
    "maxerrorD": 1e4,
    "maxcmdD": 1e4,
    "maxcmdDD": 1e8,
    "maxcmdDDD": 1e12,
    "maxoutput": 3.0,
}
TRAPS: dict[str, dict[str, Any]] = {
    "the defaults": {},
    "the error against the command of now": {"error_previous_target": False, "Igain": 100.0},
    "a dead band behind a limit": {"deadband": 0.3, "maxerror": 0.8},
    "a limit of the integral": {"Igain": 2e3, "maxerrorI": 1e-4},
    "a limit of the output": {"Igain": 9e3, "maxoutput": 1.5},
    "limits of the derivatives": {
        "Dgain": 1e-3,
        "FF1": 1e-3,
        "FF2": 1e-7,
        "FF3": 1e-11,
        "maxerrorD": 1e4,
        "maxcmdD": 1e4,
        "maxcmdDD": 1e8,
        "maxcmdDDD": 1e12,
    },
    "negative feedforward": {"FF1": -1e-3, "FF2": -1e-7},
}


def random_pid(rng: np.random.Generator) -> StockPid:
    """Any gains and limits: some of them 0, feedforward of either sign."""
    given: dict[str, Any] = {}
    for name, size in SIZES.items():
        if rng.random() < 0.6:
            sign = -1.0 if name.startswith("FF") and rng.random() < 0.2 else 1.0
            given[name] = float(sign * size * rng.lognormal())
    return StockPid(**given, error_previous_target=bool(rng.random() < 0.5))


def settings(pid: StockPid, name: str, *, wired: str = "") -> list[str]:
    """The lines that set the pins of a pid; what is wired cannot be set."""
    numbers = [f"setp {name}.{each} {getattr(pid, each)!r}" for each in SIZES if each != wired]
    return [*numbers, f"setp {name}.error-previous-target {int(pid.error_previous_target)}"]


def bits(values: Any) -> np.ndarray:
    """The bits of doubles; every NaN is the same."""
    numbers = np.asarray(values, dtype=np.float64)
    return np.where(np.isnan(numbers), np.nan, numbers).view(np.int64)


def against_hal(folder: Path, pids: Sequence[StockPid], rows: np.ndarray, wired: Sequence[str]) -> None:
    """Pids on rows of command, feedback, enable, index-enable and what else is wired, here and in a HAL."""
    pins = ("command", "feedback", "enable", "index-enable", *wired)
    names = [f"p{i}" for i in range(len(pids))]
    found = halrun(
        [],
        folder,
        PERIOD,
        [
            f"loadrt pid names={','.join(names)}",
            *(f"addf {name}.do-pid-calcs servo-thread" for name in names),
            *(f"net in-{i} streamer.0.pin.{i} => {name}.{pin}" for i, pin in enumerate(pins) for name in names),
            *(f"net out-{i} {name}.output => sampler.0.pin.{i}" for i, name in enumerate(names)),
            *(line for pid, name in zip(pids, names, strict=True) for line in settings(pid, name)),
        ],
        rows,
        "".join("b" if "enable" in pin else "f" for pin in pins),
        "f" * len(pids),
    ).rows
    for i, pid in enumerate(pids):
        state, outputs = pid.start(0.0, 0.0), []
        for row in rows:
            given = dict(zip((pin.replace("-", "_") for pin in pins), map(np.float64, row), strict=True))
            with np.errstate(invalid="ignore"):
                state, output = pid.step(state, given.pop("command"), given.pop("feedback"), T, **given)
            outputs.append(output)
        assert np.array_equal(bits(found[:, i]), bits(outputs)), pid


def random_rows(rng: np.random.Generator, count: int, wired: tuple[str, ...]) -> np.ndarray:
    columns = [rng.normal(size=count), rng.normal(size=count), rng.random(count) < 0.9, rng.random(count) < 0.3]
    return np.column_stack([*columns, *(1e4 * rng.normal(size=count) for _ in wired)])


@needs_linuxcnc
class TestAgainstARunningHal:
    """Every output is equal to the last bit."""

    def test_each_trap(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(7)
        against_hal(tmp_path, [StockPid(**trap) for trap in TRAPS.values()], random_rows(rng, 500, ()), ())

    @pytest.mark.parametrize(
        "wired",
        [
            pytest.param(wired, marks=pytest.mark.slow(reason="a session of HAL for each; a quick one has both pins"))
            for wired in ((), ("command-deriv",), ("feedback-deriv",))
        ]
        + [("command-deriv", "feedback-deriv")],
    )
    def test_random_gains_limits_and_pins(self, wired: tuple[str, ...], tmp_path: Path, seeded: Seeded) -> None:
        rng = np.random.default_rng(seeded(len(str(wired))))
        pids = [random_pid(rng) for _ in range(16)]  # as many as LinuxCNC can load
        against_hal(tmp_path, pids, random_rows(rng, 1000, wired), wired)

    def test_nan_and_infinity_pass_as_they_do_there(self, tmp_path: Path) -> None:
        rows = random_rows(np.random.default_rng(3), 300, ())
        rows[50, 1], rows[120, 0], rows[200, 1] = np.nan, np.inf, -np.inf
        pid = StockPid(Igain=50.0, Dgain=1e-3, maxerror=0.5, maxoutput=1.0, maxerrorD=1e3)
        against_hal(tmp_path, [pid], rows, ())

    def test_a_gain_that_is_set_while_it_runs_steps_the_output_at_once(self, tmp_path: Path) -> None:
        """The integral is one of errors: at rest Igain from 400 to 900 multiplies what it holds by 9/4, there and here.

        Hence `LinuxcncPid.retune` returns the state as it is, and the battery does not ask for a force that goes on.
        """
        before, after = StockPid(Igain=400.0), StockPid(Igain=900.0)
        moving, count = 100, 200
        command = np.where(np.arange(count) < moving, np.sin(0.1 * np.arange(count)) + 0.5, 0.0)
        gain = np.where(np.arange(count) < 150, before.Igain, after.Igain)
        rows = np.column_stack([command, np.zeros(count), np.ones(count), np.zeros(count), gain])
        pins = ("command", "feedback", "enable", "index-enable", "Igain")
        wiring = [
            "loadrt pid names=p0",
            "addf p0.do-pid-calcs servo-thread",
            *(f"net in-{i} streamer.0.pin.{i} => p0.{pin}" for i, pin in enumerate(pins)),
            "net out-0 p0.output => sampler.0.pin.0",
            *settings(before, "p0", wired="Igain"),
        ]
        found = halrun([], tmp_path, PERIOD, wiring, rows, "ffbbf", "f").rows[:, 0]
        state, outputs = before.start(0.0, 0.0), []
        for k, row in enumerate(rows):
            state, output = (before if k < 150 else after).step(state, *map(np.float64, row[:2]), T)
            outputs.append(output)
        assert np.array_equal(bits(found), bits(outputs))
        assert found[149] == found[148] > 0.5
        assert found[150] == pytest.approx(900.0 / 400.0 * found[149], rel=1e-12)

    @pytest.mark.parametrize("two", [True, False], ids=["two pids", "one pid"])
    @pytest.mark.parametrize("joint", [True, False], ids=["derivatives from pins", "differences"])
    def test_the_law_is_what_its_wiring_computes(self, two: bool, joint: bool, tmp_path: Path) -> None:
        rng = np.random.default_rng(11)
        count = 800
        law = LinuxcncPid(
            position=StockPid(Pgain=80.0, Igain=3.0 * (not two), FF1=0.9, FF2=1e-5, error_previous_target=False),
            velocity=StockPid(Pgain=0.7, Igain=90.0, maxoutput=40.0, error_previous_target=False) if two else None,
            force_per_output=3.5,
            acceleration_gain=1e-3,
            velocity_gain=0.02,
            command_derivative="joint" if joint else "difference",
            feedback_derivative="motor" if joint else "difference",
        )
        x = 1e-3 * np.cumsum(rng.normal(size=(count, 3)), axis=0)  # set, load, motor, m
        v, a = 0.1 * rng.normal(size=count), 5.0 * rng.normal(size=count)
        x[0] = 0.0  # where every component of a fresh HAL stands
        v[0] = a[0] = 0.0
        pins = [
            "position.command",
            "position.feedback",
            "speed.in",
            "forward.in1" + (" position.command-deriv" if joint else ""),
            "forward.in0",
            "position.enable" + (" velocity.enable" if two else ""),
        ]
        last = "velocity" if two else "position"
        speed = [pin for pin, there in (("velocity.feedback", two), ("position.feedback-deriv", joint)) if there]
        functions = ["speed", "forward", "position.do-pid-calcs", *["velocity.do-pid-calcs"] * two]
        found = halrun(
            [],
            tmp_path,
            PERIOD,
            [
                "loadrt ddt names=speed",
                "loadrt sum2 names=forward",
                "loadrt pid names=position,velocity",
                *(f"addf {function} servo-thread" for function in functions),
                *(f"net in-{i} streamer.0.pin.{i} => {pin}" for i, pin in enumerate(pins)),
                f"net bias forward.out => {last}.bias",
                *[f"net speed speed.out => {' '.join(speed)}"] * bool(speed),
                *["net wanted position.output => velocity.command"] * two,
                f"net out {last}.output => sampler.0.pin.0",
                *settings(law.position, "position", wired="" if two else "bias"),
                *(settings(law.velocity, "velocity", wired="bias") if law.velocity else []),
                "setp forward.gain0 1e-3",
                "setp forward.gain1 0.02",
            ],
            np.column_stack([1000.0 * x, 1000.0 * v, 1000.0 * a, np.ones(count)]),
            "fffffb",
            "f",
        ).rows
        state = law.start(law.prepare(T), Setpoint(0.0), Reading(0.0, 0.0))
        forces = []
        for (set_, load, motor), speed_, acceleration in zip(x, v, a, strict=True):
            setpoint = Setpoint(set_, speed_, acceleration)
            state, force = law.step(None, state, setpoint, Reading(motor, load), T)
            forces.append(force)
        assert np.array_equal(bits(3.5 * found[:, 0]), bits(forces))
        if two:
            assert np.any(np.abs(found[:, 0]) == 40.0)  # the limit was met


def test_a_pid_has_the_names_of_the_component() -> None:
    assert set(declarations(StockPid)) == {*SIZES, "error_previous_target"}


@pytest.mark.parametrize("Tn", [5e-3, None])
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_two_pids_are_the_cascade_where_no_limit_acts(Tn: float | None, share: float) -> None:
    """Equal gains, two encoders, an axis that wanders: forces differ by rounding only."""
    Kv, Kp, c = 60.0, 4e4, 1000.0 * 250.0
    cascade = CascadePPI(Kv=Kv, Kp=Kp, Tn=Tn, velocity_feedforward=share)
    pids = LinuxcncPid(
        position=StockPid(Pgain=Kv, FF1=share, error_previous_target=False),
        velocity=StockPid(Pgain=Kp / c, Igain=0.0 if Tn is None else Kp / (c * Tn), error_previous_target=False),
        force_per_output=250.0,
    )
    rng = np.random.default_rng(2)
    positions = 1e-5 * np.cumsum(rng.normal(size=(300, 2)), axis=0)
    t = T * np.arange(300)
    w = 2 * np.pi * 20.0
    there = Setpoint(
        0.01 * np.sin(w * t),
        0.01 * w * np.cos(w * t),
        -0.01 * w**2 * np.sin(w * t),
        -0.01 * w**3 * np.cos(w * t),
        0.01 * w**4 * np.sin(w * t),
    )
    rest = Setpoint(0.0, 0.01 * w, 0.0, -0.01 * w**3, 0.0)
    states = [law.start(law.prepare(T), rest, Reading(0.0, 0.0)) for law in (cascade, pids)]
    found = []
    for k, (motor, load) in enumerate(positions):
        setpoint, reading = Setpoint(*(each[k] for each in there)), Reading(motor, load)
        states[0], expected = cascade.step(None, states[0], setpoint, reading, T)
        states[1], force = pids.step(None, states[1], setpoint, reading, T)
        found.append(force - expected)
    # the sets are differenced here, and expanded to the snap there: 5th derivative T⁴/120, times Kp, is below 1e-6 N
    assert np.max(np.abs(found[1:])) < 1e-3  # N, of forces around 1 kN
