"""The monitor of a drive in virtual time: healthy drives of a generator of the test's own, and the same ones dead.

Drives, motions and the times at which a live drive must have moved are made here and in `simulated_drives`; the monitor
gets what a master would send and receive, and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pytest

from feeddrive.bus import watch
from feeddrive.bus.cia402 import MODES as NUMBERS
from feeddrive.bus.cia402 import PowerState
from feeddrive.bus.drive_file import BusDrive, BusLimits, DriveScaling
from feeddrive.bus.monitor import Cycle, Monitor
from feeddrive.bus.watch import Answer, Fault, Target
from simulated_drives import Run, drawn, due_by_force

MODES = ("csp", "csv", "cst")
LOST_FRAMES = 3
ALLOWED = LOST_FRAMES + 2  # cycles after a live drive must have moved


def described(mode: str, T: float, count: float, following_error: float, **more: Any) -> BusDrive:
    """A drive file that leaves all other limits out of the way."""
    limits = {"travel": 1e6, "velocity": 1e6, "force": 1e9, "largest_mass": 100.0, "breakaway_force": 50.0}
    limits |= {key: more.pop(key) for key in list(more) if key in BusLimits.__dataclass_fields__}
    return BusDrive(
        bus="canopen",
        cycle_time=T,
        mode=mode,
        lost_frames=LOST_FRAMES,
        scaling=DriveScaling(increment=count, rated_force=1.0),
        limits=BusLimits(following_error=following_error, **limits),
        **more,
    )


def watched(
    drive: BusDrive, targets: Sequence[Target], answers: Sequence[Answer | None], late: Container[int] = ()
) -> Fault | None:
    """The first fault of a run whose first answer is that of a drive at rest; `late` cycles began late."""
    made = Monitor(drive)
    assert answers[0] is not None
    state = made.begin(answers[0])
    for k, (target, answer) in enumerate(zip(targets, answers, strict=True)):
        word, mode = PowerState.ENABLED.status, NUMBERS[drive.mode]
        state, fault = made.step(state, Cycle(target, answer, word, mode, elapsed=4.0 if k in late else 1.0))
        if fault is not None:
            return fault
    return None


def acting(run: Run, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The targets that the answers of each cycle belong to: position, velocity, force."""
    lag = run.lag[i]
    columns = run.target[:, i], run.target_velocity[:, i], run.target_force[:, i]
    return tuple(np.concatenate([np.zeros(lag), each[: len(each) - lag]]) for each in columns)  # type: ignore[return-value]


def tightest(run: Run, i: int) -> float:
    """The least limits.following_error that docs/how_to/drive_bus.md allows for this healthy motion, m."""
    c = run.count[i]
    position, velocity, _ = acting(run, i)
    told = np.nan_to_num(np.abs(run.following_error[:, i]))
    behind = position - run.position[:, i]
    least = max(40.0 * c, 80.0 * run.drawn["noise"][i] * c, 20e-6)
    if run.mode == "csv":
        behind = np.cumsum(velocity) * run.cycle_time[i] - run.position[:, i]
        behind -= 0.5 * (behind.max() + behind.min())
        return max(8.0 / 3.0 * (np.abs(behind).max() + c), least)
    largest = max(np.abs(behind).max(), told.max())
    return max(4.0 / 3.0 * (largest + 2.0 * c), 4.0 * np.abs(np.diff(position)).max(), least) * (1.0 + 1e-9)


def of_run(run: Run, i: int) -> BusDrive:
    return described(
        run.mode,
        float(run.cycle_time[i]),
        float(run.count[i]),
        tightest(run, i),
        lag=int(run.lag[i]),
        largest_mass=float(run.mass[i]),
        breakaway_force=float(run.breakaway[i]),
    )


def targets_of(run: Run, i: int) -> list[Target]:
    columns = run.target[:, i].tolist(), run.target_velocity[:, i].tolist(), run.target_force[:, i].tolist()
    return [Target(*row) for row in zip(*columns, strict=True)]


def answers_of(run: Run, i: int) -> list[Answer]:
    columns = (run.position, run.velocity, run.force, run.following_error)
    rows = zip(*(each[:, i].tolist() for each in columns), strict=True)
    return [Answer(*(None if math.isnan(value) else value for value in row)) for row in rows]  # type: ignore[arg-type]


def faults_of_healthy(run: Run) -> Iterator[tuple[int, Fault]]:
    for i in range(run.count.size):
        fault = watched(of_run(run, i), targets_of(run, i), answers_of(run, i))
        if fault is not None:
            yield i, fault


@lru_cache
def few(mode: str) -> Run:
    """The share of the proofs that every run of the tests has."""
    return drawn(20, 30, mode, cycles=400)


@pytest.mark.parametrize("mode", MODES)
def test_healthy_drives_are_not_stopped(mode: str) -> None:
    """A few of each mode; the limits are as tight as the documentation allows."""
    assert list(faults_of_healthy(few(mode))) == []


@pytest.mark.slow(reason="a quarter of a thousand drives of each mode, 1,500 cycles of eight substeps: 16 s")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", range(4))
@pytest.mark.parametrize("mode", MODES)
def test_a_thousand_healthy_drives_are_not_stopped(mode: str, part: int) -> None:
    """Stiction, counts of 20 um, weight, dead time, noise and held values occur among them."""
    run = drawn(100 + part, 250, mode)
    assert [(i, fault.message) for i, fault in faults_of_healthy(run)] == []
    moved, pushed = np.diff(run.target, axis=0), run.target_force[1:]
    asked = np.abs({"csp": moved, "csv": run.target_velocity[1:], "cst": pushed}[mode]) > 0.0
    seen = {
        "stuck": np.mean(run.stuck[1:].astype(bool) & asked, axis=0) > 0.05,
        "coarse": run.count == 20e-6,
        "weight": run.drawn["weight"] != 0.0,
        "late": run.drawn["unknown"] > 0,
        "noise": run.drawn["noise"] > 0.0,
        "held": run.drawn["refresh"] > 1,
    }
    assert min(np.sum(each) for each in seen.values()) >= 20, {name: int(np.sum(each)) for name, each in seen.items()}


def dead(run: Run, i: int, at: int, how: str) -> list[Answer]:
    """The answers of a drive that dies in a cycle.

    stale    all values stand still, and 0x60F4 says 0
    mute     so does the velocity
    encoder  the position stands still, the velocity and the force live
    """
    answers = answers_of(run, i)
    last = answers[at]
    for k in range(at, len(answers)):
        live = answers[k] if how == "encoder" else last
        velocity = None if live.velocity is None else 0.0 if how == "mute" else live.velocity
        answers[k] = live._replace(position=last.position, velocity=velocity, following_error=0.0)
    return answers


def due(run: Run, i: int, at: int, most: float) -> int | None:
    """The cycle in which every live drive must have shown two counts more than a reading that stands still.

    Worst over all cycles in which the reading may have been shown first: those since it was 4 counts away.
    """
    T, c, x = run.cycle_time[i], run.count[i], run.position[:, i]
    away = np.flatnonzero(np.abs(x[: at + 1] - x[at]) >= 3.99 * c)
    first = int(away[-1]) + 1 if away.size else 0
    position, velocity, force = acting(run, i)
    if run.mode == "cst":
        return due_by_force(force, run.mass[i], run.breakaway[i], 3.0 * c, T, at)
    if run.mode == "csv":
        asked = np.cumsum(velocity) * T
        low, high = asked[first : at + 1].min(), asked[first : at + 1].max()
        sure = np.maximum(asked - high, low - asked) > max(0.75 * most, 3.0 * c)
    else:
        lead = position - x[at]
        before = np.maximum(0.0, np.where(lead > 0.0, lead[first : at + 1].max(), -lead[first : at + 1].min()))
        sure = np.abs(lead) >= before + 0.75 * (most - before) + 4.0 * c
    sure[: at + 1] = False
    return int(np.argmax(sure)) if np.any(sure) else None


def late_or_missed(run: Run, how: str, seed: int) -> tuple[list[str], int]:
    """What is wrong with the stops of drives that die at random; and how many of them had to be stopped."""
    rng = np.random.default_rng(seed)
    cycles, found, many = run.target.shape[0], list[str](), 0
    for i in range(run.count.size):
        at = int(rng.integers(cycles // 10, cycles * 7 // 10))
        drive, answers = of_run(run, i), dead(run, i, at, how)
        fault = watched(drive, targets_of(run, i), answers)
        stop = cycles if fault is None else fault.cycle
        most = float(drive.limits.following_error)
        lead = np.abs(acting(run, i)[0] - run.position[at, i])
        velocity = answers[at].velocity
        limit = due(run, i, at, most)
        if how == "stale" and velocity:  # a live drive shows two counts by its own velocity, if it tells it
            own = math.ceil(2.0 * run.count[i] / (abs(velocity) * run.cycle_time[i]))
            if own * run.cycle_time[i] < 0.1:
                own += max(0, 2 * int(run.drawn["refresh"][i]) - ALLOWED)  # values that are the same by chance
                limit = min(at + own, cycles if limit is None else limit)
        if run.mode == "csp" and np.any(lead[at : stop + 1] > most):
            found.append(f"{how} {i}: {lead[at : stop + 1].max():.3g} m from the last reading, {most:.3g} m allowed")
        if limit is None or limit + ALLOWED >= cycles:
            continue
        many += 1
        if stop > limit + ALLOWED:
            found.append(f"{run.mode} {how} {i}: dead in cycle {at}, must have moved by {limit}, stopped in {stop}")
    return found, many


DEATHS = ("stale", "mute", "encoder")


@pytest.mark.parametrize("how", DEATHS)
@pytest.mark.parametrize("mode", MODES)
def test_dead_drives_are_stopped_in_time(mode: str, how: str) -> None:
    """Within `lost_frames` + 2 cycles after a live one must have shown two counts, and before the limit."""
    wrong, many = late_or_missed(few(mode), how, 1)
    assert wrong == []
    assert many >= 3


@pytest.mark.slow(reason="a thousand drives of each mode die in three ways: 30 to 40 s")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("how", DEATHS)
@pytest.mark.parametrize("mode", MODES)
def test_a_thousand_dead_drives_are_stopped_in_time(mode: str, how: str) -> None:
    found = [late_or_missed(drawn(200 + part, 250, mode), how, part) for part in range(4)]
    assert [wrong for each, _ in found for wrong in each] == []
    assert sum(many for _, many in found) >= 200


@pytest.mark.parametrize("mode", MODES)
def test_lost_frames_and_late_cycles_neither_stop_a_live_drive_nor_hide_a_dead_one(mode: str) -> None:
    """One frame or two in a row are lost every 20 cycles, and every 50th cycle begins late."""
    run, rng, many = few(mode), np.random.default_rng(3), 0
    for i in range(run.count.size):
        drive, targets, cycles = of_run(run, i), targets_of(run, i), run.target.shape[0]
        first = rng.choice(np.arange(1, cycles - 2), cycles // 20)
        lost = {int(k) + j for k in first for j in range(rng.integers(1, 3))}
        lost = {k for k in lost if not {k - 1, k - 2} <= lost}  # LOST_FRAMES in a row would end the motion
        late = set(rng.choice(cycles, cycles // 50).tolist())
        live = [None if k in lost else answer for k, answer in enumerate(answers_of(run, i))]
        assert watched(drive, targets, live, late) is None
        at = int(rng.integers(cycles // 10, cycles // 2))
        gone = [None if k in lost and k > at else answer for k, answer in enumerate(dead(run, i, at, "mute"))]
        must = due(run, i, at, float(drive.limits.following_error))
        if mode != "cst" and must is not None and must + 2 * ALLOWED < cycles:  # in cst a push begins anew after a loss
            fault, many = watched(drive, targets, gone, late), many + 1
            assert fault is not None
            assert fault.cycle <= must + ALLOWED
    assert many >= 3 or mode == "cst"


@pytest.mark.parametrize(
    ("key", "unit", "value", "answer"),
    [
        ("travel", "m", 0.011, Answer(0.021, 0.0, 0.0)),
        ("velocity", "m/s", 0.3, Answer(0.01, -0.3, 0.0)),
        ("velocity", "m/s", 0.5, Answer(0.0115, None, 0.0)),  # in three cycles of a millisecond, two of them lost
        ("force", "N", 90.0, Answer(0.01, 0.0, -90.0)),
        ("following_error", "m", 0.0013, Answer(0.0087, 0.0, 0.0)),
        ("following_error", "m", 0.0013, Answer(0.0087, 0.0, 0.0, 0.0)),  # the drive says that it has none
        ("following_error", "m", 0.0012, Answer(0.01, 0.0, 0.0, -0.0012)),
        ("position", "m", 0.019, Answer(0.019, 0.0, 0.0)),
        ("position", "m", 0.001, Answer(0.001, 0.0, 0.0)),
    ],
)
def test_a_limit_is_named_with_value_bound_unit_and_cycle(key: str, unit: str, value: float, answer: Answer) -> None:
    """At rest at 10 mm; the fault is in cycle 4, after two lost frames."""
    bounds = {"travel": 0.01, "velocity": 0.25, "force": 80.0, "following_error": 1e-3}
    if key == "position":
        bounds |= {"travel": 1.0, "following_error": 1.0, "position_least": 2e-3, "position_most": 18e-3}
    elif key == "travel":
        bounds["following_error"] = 1.0
    else:
        bounds["travel"] = 1.0  # beyond the way that it takes to brake
    if key != "velocity":
        bounds["velocity"] = 1e6  # or the positions would be a jump
    drive = described("csp", 1e-3, 1e-6, bounds.pop("following_error"), **bounds)
    rest = Answer(0.01, 0.0 if answer.velocity is not None else None, 0.0)
    fault = watched(drive, [Target(0.01, 0.0, 0.0)] * 5, [rest, rest, None, None, answer])
    assert fault is not None
    assert (fault.kind, fault.unit, fault.cycle) == (key, unit, 4)
    assert fault.value == pytest.approx(value, rel=1e-9)
    words = ("cycle 4", f"{fault.value:.4g} {unit}", f"= {fault.bound:.4g} {unit}", f"limits.{key}")
    assert all(each in fault.message for each in words), fault.message


# The edges: what is only just alive, and what is dead, around each number that the watch chose.

T, C, E = 1e-3, 1e-6, 1e-3  # s, m, m


def runs(
    drive: BusDrive,
    position: Callable[[int], float],
    *,
    at: Callable[[int], float] = lambda _: 0.0,
    velocity: Callable[[int], float] = lambda _: 0.0,
    force: Callable[[int], float] = lambda _: 0.0,
    told: Callable[[int], float | None] = lambda _: None,
    cycles: int = 400,
    late: Container[int] = (),
) -> int | None:
    """The cycle in which a run is stopped, of targets and what is true of the axis; readings come a cycle later."""
    targets = [Target(at(k), velocity(k), force(k)) for k in range(cycles)]
    answers = [Answer(0.0, told(0), 0.0)]
    answers += [Answer(C * round(position(k) / C), told(k), 0.0) for k in range(cycles - 1)]
    fault = watched(drive, targets, answers, late)
    return None if fault is None else fault.cycle


def stuck_position() -> Iterator[str]:
    """A set position at 5 um a cycle: the live drive breaks away just before 3/4 of the limit, then stays behind it."""
    drive = described("csp", T, C, E)

    def ramp(k: int) -> float:
        return 5e-6 * k

    if runs(drive, lambda k: max(0.0, ramp(k) - (0.75 * E - 6 * C)), at=ramp) is not None:
        yield "csp: stopped a live drive"
    stop = runs(drive, lambda _: 0.0, at=ramp)
    if stop is None or stop > 1 + 0.75 * E / 5e-6 + ALLOWED or ramp(stop - 1) >= E:
        yield f"csp: stopped a dead drive in cycle {stop}"
    stop = runs(drive, lambda _: 0.0, at=lambda k: 0.37e-3 * k)  # 0.74 mm, and the next target at 1.11 mm
    if stop is None or 0.37e-3 * (stop - 1) >= E:
        yield f"csp: stopped a dead drive in cycle {stop} of a fast motion"


def lagging() -> Iterator[str]:
    """A live drive lags by 0.85 of its limit at 2 um a cycle, with readings that are held; a dead one was ahead."""
    drive = described("csp", T, C, E)
    if runs(drive, lambda k: 2e-6 * (k - k % 5), at=lambda k: 2e-6 * k + min(8e-6 * k, 0.85 * E)) is not None:
        yield "lag: stopped a live drive"
    answering = described("csp", T, C, E, lag=8)  # 1.6 mm behind the newest target, and on the one it answers
    if runs(answering, lambda k: 0.2e-3 * max(0, k - 7), at=lambda k: 0.2e-3 * k) is not None:
        yield "answers after eight cycles: stopped a live drive"

    def passing(k: int) -> float:  # back by 0.6 mm, and then past the axis, which moves last at the turn
        return -5e-6 * k if k <= 120 else 5e-6 * (k - 240)

    stop = runs(drive, lambda k: 3 * C * (k >= 120), at=passing)
    if stop is None or stop > 1 + 240 + (0.75 * E + 3 * C) / 5e-6 + ALLOWED:
        yield f"ahead: stopped a dead drive in cycle {stop}"


def slipping() -> Iterator[str]:
    """A live drive near its limit moves by two or three counts at a time; one that is dead shakes by one."""
    drive = described("csp", T, C, 40 * C)

    def slipped(k: int) -> float:
        return 3 * C * max(0, math.ceil((0.25 * C * k - 27 * C) / (3 * C)))

    if runs(drive, slipped, at=lambda k: 0.25 * C * k) is not None:
        yield "slip: stopped a live drive"
    stop = runs(drive, lambda k: C * (k % 2), at=lambda k: 0.25 * C * k)
    if stop is None or stop > 1 + (0.75 * 40.0 + 1.0) / 0.25 + ALLOWED:
        yield f"slip: stopped a dead drive with noise of a count in cycle {stop}"


def stuck_velocity() -> Iterator[str]:
    """A set velocity of 5 mm/s: the live drive needs just under 3/4 of the limit to build up its force."""
    drive = described("csv", T, C, E)
    way = 0.75 * E - 12 * C
    if runs(drive, lambda k: max(0.0, 5e-6 * k - way), velocity=lambda _: 5e-3) is not None:
        yield "csv: stopped a live drive"
    stop = runs(drive, lambda _: 0.0, velocity=lambda _: 5e-3)
    if stop is None or stop > 1 + 0.75 * E / 5e-6 + ALLOWED:
        yield f"csv: stopped a dead drive in cycle {stop}"


def pushed() -> Iterator[str]:
    """100 kg against 50 N, pushed with 60 N from cycle 3 on.

    The live axis begins with the worst speed, rounding and noise; the force acts 10 ms late, and readings are held for
    five cycles.
    """
    drive, a, late = described("cst", T, C, E), (60.0 - 50.0) / 100.0, 10
    worst = 0.99 * math.sqrt(2.0 * a * 2.0 * C)  # 2 C back, and then 2 C ahead: a count is shown, half lost twice
    for speed, begin, noise, held in product(
        (0.0, -0.9 * worst, -worst), (-0.49 * C, 0.0, 0.49 * C), (0.49 * C, -0.49 * C), range(LOST_FRAMES + 2)
    ):

        def live(k: int, v: float = speed, x0: float = begin, noise: float = noise, held: int = held) -> float:
            t = max(0, k - (k + held) % (LOST_FRAMES + 2) - 3 - late) * T
            x = x0 + v * t + 0.5 * a * t * t
            return x + math.copysign(noise, noise * (x0 - x)) * (t > 0)

        stop = runs(drive, live, force=lambda k: 60.0 * (k >= 3), cycles=60)
        if stop is not None:
            yield f"cst: stopped a live drive in cycle {stop}, {speed:.3g} m/s, {begin:.3g} m, held {held}"
            break
    stop = runs(drive, lambda _: 0.0, force=lambda k: 60.0 * (k >= 3))
    must = 3 + (1.0 + math.sqrt(2.0)) * math.sqrt(6.0 * C / a) / T + late  # as in the docstring
    if stop is None or not must <= stop <= must + ALLOWED + 1:
        yield f"cst: stopped a dead drive in cycle {stop}, and it must have moved by {must:.1f}"


def repeated() -> Iterator[str]:
    """A live drive tells new values every `lost_frames` + 2 cycles; a dead one says 20 mm/s and stands."""
    drive = described("csv", T, C, E)

    def slow(k: int) -> float:
        return 20e-6 * max(0, k - 1 - (k - 1) % (LOST_FRAMES + 2))

    if runs(drive, slow, velocity=lambda _: 0.02, told=lambda k: 0.02 * (k > 0)) is not None:
        yield "repeated values: stopped a live drive"
    # noise of three counts, new every third cycle, and once the same by chance
    shaken = [3 * C * ((7 * n) % 5 - 2) / 2 for n in range(200)]
    shaken[60] = shaken[59]
    if runs(drive, lambda k: shaken[k // 3], told=lambda k: 10.0 * shaken[k // 3] if k else 0.0) is not None:
        yield "repeated noise: stopped a live drive"
    stop = runs(drive, lambda k: 20e-6 * min(k, 100), velocity=lambda _: 0.02, told=lambda _: 0.02)
    if stop is None or stop > 101 + 1 + ALLOWED:
        yield f"repeated values: stopped a dead drive in cycle {stop}"


def coarse() -> Iterator[str]:
    """A live drive at a third of a count a cycle shows the same values for three cycles, and one count after them."""
    drive = described("csv", 2e-4, C, E)
    rate = C / 9.0
    if runs(drive, lambda k: rate * k, velocity=lambda _: rate / 2e-4, told=lambda _: rate / 2e-4) is not None:
        yield "coarse counts: stopped a live drive"
    stop = runs(drive, lambda k: rate * min(k, 100), velocity=lambda _: rate / 2e-4, told=lambda _: rate / 2e-4)
    if stop is None or stop > 101 + 2 * C / rate + ALLOWED:
        yield f"coarse counts: stopped a dead drive in cycle {stop}"


def compared() -> Iterator[str]:
    """A live velocity is 5 ms late through a reversal, or a tenth too large; a dead one is 0, or alone."""
    drive = described("csv", T, C, E)

    def there(k: int) -> float:  # 0.2 m/s, and back from cycle 200
        return 2e-4 * min(k, 400 - k)

    def way(k: int) -> float:
        return 0.2 if k <= 200 else -0.2

    if runs(drive, there, velocity=way, told=lambda k: way(max(0, k - 5))) is not None:
        yield "late velocity: stopped a live drive"

    def filtered(k: int) -> float:  # at a stop in cycle 200
        return (0.2 + 1e-6 * k) * (5 <= k <= 205)

    if runs(drive, lambda k: 2e-4 * min(k, 200), velocity=lambda k: 0.2 * (k <= 200), told=filtered) is not None:
        yield "late velocity at a stop: stopped a live drive"
    if runs(drive, lambda k: 2e-4 * k, velocity=lambda _: 0.2, told=lambda _: 0.22, cycles=600) is not None:
        yield "wrong factor: stopped a live drive"

    def paused(k: int) -> float:  # three cycles pass before each fifth
        return 2e-4 * (k + 3 * (k // 5))

    for late, lives in (range(1, 400, 5), True), ((), False):
        stop = runs(drive, paused, velocity=lambda _: 0.2, told=lambda _: 0.2, late=late)
        if (stop is None) != lives:
            yield f"{len(late)} late cycles: stopped in {stop}"
    stop = runs(drive, there, velocity=way, told=lambda _: 0.0)
    if stop is None or not stop <= 1 + (0.01 * 0.2 + 0.75 * E) / 2e-4 * 1.1 + ALLOWED:  # 1.1: it forgets meanwhile
        yield f"velocity of 0: stopped a dead drive in cycle {stop}"
    if runs(drive, lambda k: 12e-6 * k, velocity=lambda _: 0.012, told=lambda _: 0.0) is None:
        yield "velocity of 0 at 12 mm/s: did not stop a dead drive"
    stop = runs(drive, lambda _: 0.0, told=lambda k: 0.2 + 1e-6 * k)
    if stop is None or not stop <= 1 + (0.01 * 0.2 + 0.75 * E) / 2e-4 * 1.1 + ALLOWED:
        yield f"position dead: stopped in cycle {stop}"


def wrong_at_the_edges() -> Iterator[str]:
    for trial in (slipping, lagging, repeated, stuck_position, stuck_velocity, coarse, compared, pushed):
        yield from trial()


def test_the_edges_of_every_bound_hold() -> None:
    assert list(wrong_at_the_edges()) == []


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", ["SHOWN", "SURE", "USED", "SPARE", "RESPONSE", "MEMORY"])
def test_half_or_twice_a_bound_is_found(name: str, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each number is as small as a live drive allows, and as large as a dead one does."""
    monkeypatch.setattr(watch, name, type(getattr(watch, name))(factor * getattr(watch, name)))
    assert next(wrong_at_the_edges(), "") != ""
