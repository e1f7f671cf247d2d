"""A law is judged by what it commands at the log's own readings: true ones pass at any count, wrong gains do not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.identification import MotionLog, identify_motion
from feeddrive.identification.motion import control_law
from feeddrive.identification.motion.control_law import (
    Gain,
    LawCheck,
    _added,
    _by_counts,
    _readings,
    _Rows,
    check_law,
)
from feeddrive.identification.motion.identify import _as_blocks
from feeddrive.identification.motion.identify_law import identify_control
from feeddrive.identification.motion.law_rows import LawRows, Signals
from sliding_mass import Cascade, Drive, Pid, run, strokes, unknown
from slow_share import all_but

B = fd.blocks
SCALE = 1e3 * 750.0  # machine units in a meter, times N for one of the pid's output


def law_of(law: Cascade | Pid, wrong: str = "", factor: float = 1.0) -> fd.blocks.CascadePPI | fd.blocks.LinuxcncPid:
    """The law as feeddrive has it, with one number wrong by a factor, or without its integral."""
    if isinstance(law, Cascade):
        Kv, Kp, Tn = (getattr(law, name) * (factor if name == wrong else 1.0) for name in ("Kv", "Kp", "Tn"))
        return B.CascadePPI(
            Kv=Kv,
            Kp=Kp,
            Tn=Tn if Tn and wrong != "integral" else None,
            velocity_feedforward=law.feedforward,
            velocity_samples=law.n,
        )
    gains = {"Pgain": law.P, "Igain": law.I, "Dgain": law.D, "FF1": law.F1, "FF2": law.F2}
    if wrong == "integral":
        gains["Igain"] = 0.0
    gains = {name: value / SCALE * (factor if name == wrong else 1.0) for name, value in gains.items()}
    return B.LinuxcncPid(position=B.StockPid(**gains), units=1000, force_per_output=750)


def loop_of(law: fd.blocks.CascadePPI | fd.blocks.LinuxcncPid, drive: Drive, T: float) -> fd.Loop:
    """A machine file's loop: its mass and friction are guesses."""
    return fd.Loop(
        control=fd.Control(law=law),
        axis=fd.Axis(
            plant=B.Rigid(mass=1.3 * drive.mass),
            friction_load=B.Coulomb(coulomb=0.4 * drive.coulomb),
            actuator=B.Actuator(dead_time=drive.dead_time),
            encoder_load=B.Encoder(resolution=drive.count),
        ),
        sample_time=T,
    )


@cache
def shop(mass: float, count: float) -> tuple[MotionLog, Pid, Drive]:
    """The axis of docs/tutorials/shop_linuxcnc.md, its gains in SI, with another mass and count."""
    c = 1e3 * 753.98
    law = Pid(20.0 * c, 20.0 * c, 0.5 * c, 0.004 * c, 0.002 * c)
    drive = Drive(mass, 420.0, 3000.0, dead_time=0.0008, count=count)
    reference = strokes(1e-3, (0.15,), 1.5, seconds=0.6)
    position, force = run(drive, law, reference, 1e-3)
    log = MotionLog(name="shop", position=position[0], force=force[0], set_position=reference, sample_time=1e-3)
    return log, law, drive


SHOPS = [(mass, count) for count in (1.25e-6, 2e-5) for mass in (2300.0, 1500.0, 1000.0, 500.0)]


@pytest.mark.parametrize(
    ("mass", "count"), all_but([(1500.0, 1.25e-6)], SHOPS, "the same with other masses and counts")
)
def test_counts_through_a_velocity_gain_speak_against_no_law(mass: float, count: float) -> None:
    """They left 14, 24 and 37 % of the force in closed loop, "so it is not the law that ran": it was.

    At 20 um each count commands the whole force, and the inverse dynamics leave a quarter of it: "the axis bends".
    """
    log, law, drive = shop(mass, count)
    found = identify_motion(log, loop_of(law_of(law), drive, 1e-3))
    if (mass, count) == (1000.0, 2e-5):
        # one of the eight is refused (docs/how_to/identification.md): its fit leaves 20 % beyond what counts make
        assert found.rigid.left > 0.15
        return
    assert found.recommendation.startswith("Use these values"), found.recommendation
    assert found.law is not None
    assert found.law.left < 1e-6  # rounding, and limits that are reached by rounding
    if (mass, count) == (500.0, 2e-5):
        # 518 +- 33 kg in closed loop: the inverse dynamics are eight times as sure
        assert found.refinement is None
        assert abs(found.rigid["mass"].value - mass) < 3.0 * found.rigid["mass"].error
        return
    assert found.refinement is not None
    # a reading errs by a count to both sides, and so does the run that it is compared with
    assert found.refinement.replay.rms("position_load") < 2.0 * count
    assert abs(found.refinement["mass"].value - mass) < 4.0 * found.refinement["mass"].error


@pytest.mark.parametrize(
    ("mass", "count"), all_but([(500.0, 1.25e-6), (1500.0, 2e-5)], SHOPS, "the same with other masses and counts")
)
def test_counts_through_a_velocity_gain_make_no_second_clock(mass: float, count: float) -> None:
    """Without a law: "not on one clock" was said of two of these logs, and "not synchronised" of two.

    Up to 1.7 % of the mass is what counts make of it: with 20 um the force is that of counts for the most part.
    """
    log, *_ = shop(mass, count)
    found = identify_motion(log)
    assert found.rigid["mass"].value == pytest.approx(mass, rel=0.02)


def test_coarse_counts_and_an_integral_that_is_left_out_are_no_second_clock() -> None:
    log, law, drive = shop(1500.0, 2e-5)
    found = identify_motion(log, loop_of(law_of(law, "integral", 0.0), drive, 1e-3))
    assert "it is not the law that ran" in found.recommendation


def coarse(seed: int) -> tuple[MotionLog, Pid, Drive]:
    """The axis of the shop page with counts of 20 um, a drawn mass and an unknown force of 21 N."""
    c, random = 1e3 * 753.98, np.random.default_rng([24, seed])
    law = Pid(20.0 * c, 20.0 * c, 0.5 * c, 0.004 * c, 0.002 * c)
    start = np.array([2e-5 * random.uniform(-0.5, 0.5)])
    drive = Drive(random.uniform(1000.0, 2600.0), 420.0, 3000.0, dead_time=0.0008, count=2e-5, start=start)
    reference = strokes(1e-3, (0.15,), 1.5, seconds=0.6)
    load = unknown(21.0, 0.02, 1e-3, 1, reference.size, seed)
    position, force = run(drive, law, reference, 1e-3, load=load)
    log = MotionLog(name="coarse", position=position[0], force=force[0], set_position=reference, sample_time=1e-3)
    return log, law, drive


def used(seed: int) -> bool:
    """True if the true law of a log with coarse counts is used; its mass must be right, and wrong laws be refused."""
    from feeddrive.identification.motion.control_law import check_law

    log, law, drive = coarse(seed)
    found = identify_motion(log, loop_of(law_of(law), drive, 1e-3))
    mass = found.rigid["mass"] if found.refinement is None else found.refinement["mass"]
    assert mass.value == pytest.approx(drive.mass, rel=0.02)
    for wrong, factor in wrongs(law):
        assert check_law(loop_of(law_of(law, wrong, factor), drive, 1e-3).control, log).wrong, (wrong, factor)
    return found.recommendation.startswith("Use these values")


def test_coarse_counts_and_the_true_law_are_used() -> None:
    """Counts through the velocity gain make most of the force: all such logs said "Do not tune"."""
    assert used(0)


@pytest.mark.slow(reason="40 logs are identified and judged with twelve laws each")
@pytest.mark.timeout(1200)
@pytest.mark.xfail(strict=True, reason="of one of the 40 (seed 23) the mass is 3 % off, where 2 % are asked")
def test_coarse_counts_and_the_true_law_are_used_nearly_always() -> None:
    """39 of 40: of one the inverse dynamics leave 24 % beyond what sixteen runs with such counts leave."""
    assert sum(map(used, range(40))) >= 39


@pytest.mark.parametrize(
    ("wrong", "factor"),
    [("Pgain", 0.8), ("Igain", 0.8), ("Dgain", 1.2), ("FF1", 0.8), ("FF2", 1.2), ("integral", 0.0)],
)
def test_a_gain_that_is_a_fifth_wrong_or_an_integral_that_is_left_out_is_refused(wrong: str, factor: float) -> None:
    """At 2.3 t some of these were accepted; at less they were refused, as right ones were.  The gain is named."""
    log, law, drive = shop(2300.0, 1.25e-6)
    found = identify_motion(log, loop_of(law_of(law, wrong, factor), drive, 1e-3))
    assert found.recommendation.startswith(
        "Do not tune on these values: what the law commands at the log's own readings"
    )
    assert found.law is not None
    if wrong != "integral":
        gain = next(each for each in found.law.gains if each.name.endswith(wrong))
        # the log lacks nothing of the law: it begins at rest, where all states are 0
        assert gain.needed == pytest.approx(gain.stated / factor, rel=1e-6)
        assert f"meets its force best with axis.x.control.law.position.{wrong} = " in found.unusable
    # the inverse dynamics, which need no law, are as good as with the right one
    assert found.refinement is None
    assert found.rigid["mass"].value == pytest.approx(2300.0, rel=5e-3)


def drawn(seed: int, logs: int) -> Iterator[tuple[MotionLog, Cascade | Pid, Drive, float]]:
    """Logs of drawn drives: 50 to 2,000 kg, counts of 0.1 to 20 um, four sample times, four laws, an unknown force.

    Kp = m w with w up to the most that the delay bears (0.25 over it), as far as 60 to 250 1/s; the unknown force is a
    twentieth of Coulomb friction with a memory of 20 ms.
    """
    random = np.random.default_rng(seed)
    T = float(random.choice([2.5e-4, 5e-4, 1e-3, 2e-3]))
    late = float(random.uniform(0.0, 1.5)) * T
    mass, count = (np.exp(random.uniform(np.log(a), np.log(b), logs)) for a, b in ((50.0, 2000.0), (1e-7, 2e-5)))
    w = np.minimum(0.25 / (late + 1.5 * T) * random.uniform(0.35, 1.0, logs), random.uniform(60.0, 250.0, logs))
    coulomb, viscous = mass * 9.81 * random.uniform(0.005, 0.03, logs), mass * random.uniform(0.3, 3.0, logs)
    Kp, Kv, Tn = mass * w, w * random.uniform(0.1, 0.25, logs), 1.0 / (w * random.uniform(0.1, 0.25, logs))
    feedforward, n = float(random.choice([0.0, 0.8, 1.0])), int(random.integers(1, 4))
    laws: list[Cascade | Pid] = [
        Cascade(Kv, Kp, 0.0, feedforward, n),
        Cascade(Kv, Kp, Tn, feedforward, n),
        Pid(Kp * (Kv + 1.0 / Tn), Kp * Kv / Tn, Kp),
        Pid(
            Kp * (Kv + 1.0 / Tn), Kp * Kv / Tn, Kp, *(each * random.uniform(0.5, 1.0, logs) for each in (viscous, mass))
        ),
    ]
    law = laws[seed % 4]
    speed = float(random.uniform(0.08, 0.3))
    reference = strokes(
        T,
        (speed, speed / 3.0, speed / 1.6),
        float(random.uniform(0.8, 3.0)),
        seconds=0.35,
        dwell=float(random.uniform(0.1, 0.5)),
    )
    drive = Drive(mass, coulomb, viscous, dead_time=late, count=count, start=count * random.uniform(-0.5, 0.5, logs))
    load = unknown(0.05 * coulomb, 0.02, T, logs, reference.size, seed)
    positions, forces = run(drive, law, reference, T, logs=logs, load=load)
    for i in range(logs):
        log = MotionLog(name="drawn", position=positions[i], force=forces[i], set_position=reference, sample_time=T)
        yield log, _lane(law, i), _lane(drive, i), T


def _lane(many: Any, i: int) -> Any:
    return replace(many, **{k: float(v[i]) for k, v in vars(many).items() if isinstance(v, np.ndarray)})


def wrongs(law: Cascade | Pid) -> list[tuple[str, float]]:
    """What may be wrong with a law: each of its gains by a fifth, its integral."""
    names = ["Kv", "Kp", "Tn"] if isinstance(law, Cascade) else ["Pgain", "Igain", "Dgain", "FF1", "FF2"]
    there = [law.Kv, law.Kp, law.Tn] if isinstance(law, Cascade) else [law.P, law.I, law.D, law.F1, law.F2]
    found = [(name, factor) for name, value in zip(names, there, strict=True) if value for factor in (0.8, 1.2)]
    return [*found, *([("integral", 0.0)] if (law.Tn if isinstance(law, Cascade) else law.I) else [])]


def judged(seeds: range, logs: int) -> Counter[tuple[bool, bool]]:
    """(right, accepted) -> count, of every law of every log; right ones go through the whole of identify."""
    from feeddrive.identification.motion.control_law import check_law

    found: Counter[tuple[bool, bool]] = Counter()
    for seed in seeds:
        for log, law, drive, T in drawn(seed, logs):
            found[True, identify_motion(log, loop_of(law_of(law), drive, T)).unusable == ""] += 1
            for wrong, factor in wrongs(law):
                control = loop_of(law_of(law, wrong, factor), drive, T).control
                found[False, check_law(control, log).wrong == ""] += 1
    return found


@pytest.mark.slow(
    reason="240 logs are drawn, and each is identified with its law and judged with four to eleven wrong ones"
)
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("first", [0, 10, 20, 30])
def test_drawn_laws_are_told_from_wrong_ones(first: int) -> None:
    """Of 60 logs at most one right law is refused, and none of some 435 wrong ones is accepted.

    Measured over all 240: 0 refused of the right ones, 0 accepted of 1,740 wrong ones.  If one in 20 right ones were
    refused, 60 would pass with at most one refused by a chance of 19 %, four times so by 0.1 %.
    """
    found = judged(range(first, first + 10), 6)
    assert found[True, True] + found[True, False] == 60
    assert found[True, False] <= 1, found
    assert found[False, True] == 0, found


# ---------------------------------------------------------------- what decides: a case on either side of each bound


@pytest.mark.parametrize(("error", "unseen"), [(0.025, False), (0.045, True)])
def test_a_gain_is_seen_if_three_errors_are_less_than_a_tenth_of_it(error: float, unseen: bool) -> None:
    assert Gain("Kp", 1.0, 1.0, error).unseen is unseen


@pytest.mark.parametrize(("left", "wrong"), [(0.035, False), (0.07, True)])
def test_a_law_that_ran_leaves_at_most_5_percent(left: float, wrong: bool) -> None:
    assert bool(LawCheck("log", left, left, 0.0, (), 0).wrong) is wrong


@pytest.mark.parametrize(
    ("first", "again", "Kp"),
    [
        ((0.3, 0.01, 2e4), (0.01, 0.01, 2e4), 2e4),  # other gains of the block make the force
        ((0.01, 0.01, 1e4), (0.01, 0.01, 1e4), 1e4),  # its own gains do
        ((0.3, 0.12, 2e4), (0.3, 0.12, 2e4), None),  # none do
        ((0.3, 0.01, 2e4), (0.3, 0.01, 3e4), None),  # the next look asks for others again
    ],
)
def test_a_law_that_was_found_is_used_with_the_gains_with_which_its_block_makes_the_force(
    monkeypatch: pytest.MonkeyPatch,
    first: tuple[float, float, float],
    again: tuple[float, float, float],
    Kp: float | None,
) -> None:
    """A log of the search's own law is never refused: where no block makes its force, the law is not used."""
    looks = iter((first, again))

    def looked(control: fd.Control, log: object, *, place: str) -> LawCheck:
        left, remains, needed = next(looks)
        gains = (Gain(f"{place}.law.Kp", control.law.Kp, needed, 1.0),)  # type: ignore[union-attr]
        return LawCheck("log", left, remains, 0.0, gains, 0)

    monkeypatch.setattr(control_law, "check_law", looked)
    blocks = fd.Control(law=B.CascadePPI(Kv=20.0, Kp=1e4))
    found: Any = SimpleNamespace(readings=[SimpleNamespace(name="P-P cascade")])
    remarks: list[str] = []
    used, check = _as_blocks(SimpleNamespace(), found, blocks, remarks)  # type: ignore[arg-type]
    assert (None if used is None else used.law.Kp) == Kp  # type: ignore[union-attr]
    assert check is None or not check.wrong
    assert bool(remarks) is (Kp != 1e4)


def test_a_sentence_names_three_gains() -> None:
    gains = tuple(Gain(f"gain_{i}", 1.0, 2.0, 0.01) for i in range(8))
    assert LawCheck("log", 0.01, 0.01, 0.0, gains, 0).wrong.count("gain_") == 3


def added(away: float, excited: float = 1.0) -> float:
    """The share of rows in which forces were added to a law that leaves nothing, of the size 1.

    They are spread from 1 to 3, so that no band of 0.1 holds as many rows as that of the law.  `excited` is the share
    of the square of its gain's column in the other rows.
    """
    rows = 1000
    other = np.arange(rows) >= away * rows
    column = np.where(np.arange(rows) % 2 == 0, 1.0, -1.0)
    column = np.where(other, np.sqrt(excited / (1.0 - away)), np.sqrt((1.0 - excited) / away)) * column
    integral = np.cos(np.arange(float(rows)))
    return _added(np.vstack([column, integral]), np.where(other, 0.0, np.linspace(1.0, 3.0, rows)), 1.0, 0.0)


@pytest.mark.parametrize(("away", "found"), [(0.45, 0.45), (0.7, 0.0)])
def test_an_added_force_acts_in_three_fifths_of_the_rows_at_most(away: float, found: float) -> None:
    assert added(away, 0.5) == pytest.approx(found)


@pytest.mark.parametrize(("excited", "found"), [(0.07, 0.0), (0.14, 0.4)])
def test_the_other_rows_hold_a_tenth_of_each_column(excited: float, found: float) -> None:
    assert added(0.4, excited) == pytest.approx(found)


def smooth(rows: int, seed: int) -> np.ndarray:
    """A motion of a millimeter, without counts."""
    return 1e-3 * np.cumsum(np.random.default_rng(seed).standard_normal(rows)) / np.sqrt(rows)


def commanded_log(strange: int) -> MotionLog:
    """What a cascade commands for two random motions, with one wrong force."""
    x, wanted, step = smooth(400, 1), smooth(400, 2), 1e-3
    velocity = np.gradient(x)
    velocity[1:] = np.diff(x) / step
    force = 500.0 * (30.0 * (wanted - x) - velocity)
    force[strange] *= 0.9
    return MotionLog(name="log", position=x, force=force, set_position=wanted, sample_time=step)


def test_a_law_is_identified_without_its_first_samples() -> None:
    """Filters and models of a law may hold an unknown past for 0.2 s."""
    found = identify_control(commanded_log(150))
    assert found.residual < 1e-9
    signals = Signals.of(commanded_log(150))
    assert LawRows.of(signals, np.ones(400, bool)).places[0] == 200
    assert set(found.tried) == {(n, d) for n in range(1, 9) for d in range(4)}


def test_rows_of_the_check_are_10_ms_long_after_50_ms() -> None:
    rows = _Rows(commanded_log(30), None)
    assert rows.cut(np.zeros(400)).size == 400 - 50
    assert rows.reduced(np.zeros(400)).size == 35


def test_four_sets_of_readings_are_drawn_within_their_counts() -> None:
    x = 1e-6 * np.round(1e6 * smooth(400, 1))
    log = replace(commanded_log(30), position=x)
    drawn = list(_readings(log))
    assert len(drawn) == 4
    assert max(float(np.max(np.abs(reading - x))) for reading in drawn) <= 0.5e-6


@pytest.mark.parametrize(("share", "held"), [(0.007, False), (0.014, True)])
def test_a_log_with_a_hundredth_of_what_counts_could_make_holds_them(
    monkeypatch: pytest.MonkeyPatch, share: float, held: bool
) -> None:
    """Readings that alternate by their counts, and a force that does so by a share of their effect."""
    waves = np.where(np.arange(400) % 2 == 0, 1.0, -1.0)
    log: Any = SimpleNamespace(force=share * waves)
    rows: Any = SimpleNamespace(
        log=log,
        reduced=lambda values, *_: values,
        cut=lambda values, *_: values,
        answers=lambda *call: call[1],
        columns=lambda *_: np.cos(np.arange(400.0))[None],
    )
    monkeypatch.setattr("feeddrive.identification.motion.control_law._readings", lambda _: [waves])
    law = fd.Control(law=B.CascadePPI(Kv=1.0, Kp=1.0))
    fit: Any = SimpleNamespace(control=law, plain=np.zeros(400), delay=0, errors=np.zeros(1))
    counts, _ = _by_counts(rows, fit, ("law.Kp",))
    assert counts == pytest.approx(share if held else 0.0)


def check_of(monkeypatch: pytest.MonkeyPatch, force: np.ndarray, column: np.ndarray, weak: np.ndarray) -> LawCheck:
    """The check of a law that commands Kp times a column and Kv times another one."""

    def commanded(control: fd.Control, *_: Any) -> np.ndarray:
        law: Any = control.law
        return float(law.Kp) * column + float(law.Kv) * weak

    monkeypatch.setattr("feeddrive.identification.motion.control_law.commanded", commanded)
    x = smooth(column.size, 3)
    log = MotionLog(name="log", position=x, force=force, set_position=smooth(column.size, 4), sample_time=0.01)
    return check_law(fd.Control(law=B.CascadePPI(Kv=1.0, Kp=1.0)), log)


@pytest.mark.parametrize(("share", "gains"), [(0.7e-3, 1), (1.5e-3, 2)])
def test_a_parameter_acts_if_it_makes_a_thousandth_of_the_force(
    monkeypatch: pytest.MonkeyPatch, share: float, gains: int
) -> None:
    column, weak = np.random.default_rng(1).standard_normal((2, 1000))
    assert len(check_of(monkeypatch, column, column, share * weak / np.std(weak)).gains) == gains


@pytest.mark.parametrize(("excited", "found"), [(0.16, False), (0.36, True)])
def test_a_force_was_added_if_other_gains_leave_half_of_it(
    monkeypatch: pytest.MonkeyPatch, excited: float, found: bool
) -> None:
    """A force like the law's own in 0.4 of the rows, whose column holds 1 - e of the square there: √e of it is left."""
    rows, random = 4000, np.random.default_rng(1)
    away = np.arange(rows) < 0.4 * rows
    column = random.standard_normal(rows) * np.where(away, np.sqrt((1.0 - excited) / 0.4), np.sqrt(excited / 0.6))
    check = check_of(monkeypatch, np.where(away, 2.0, 1.0) * column, column, 0.0 * column)
    assert bool(check.added > 0.0) is found
