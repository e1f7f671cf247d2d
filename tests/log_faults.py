"""Faults of logs, and what must become of each: refused or named with its cause, or harmless for the mass.

The logs are drawn from a simulator that shares no code with feeddrive (`foreign_axis`). The columns state their units;
their roles are guessed, as of any file.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import foreign_axis as foreign
from column_logs import written
from feeddrive.identification.regression import NORMAL
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import load

T = 1e-3
TIME, SET, POSITION, FORCE = "t [s]", "x_set [m]", "x [m]", "F [N]"

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Drawn:
    """The columns of a drawn log, and of the same axis pushed, of another axis, and of an axis that moves one way.

    mass, error  of the log without a fault, as identified, kg
    seed         draws the places of faults
    one_way_mass the true mass of the axis that moves one way, kg
    """

    law: str
    columns: Columns
    pushed: Columns
    other: Columns
    one_way: Columns
    mass: float
    error: float
    seed: int
    one_way_mass: float


class Answer(NamedTuple):
    """What became of a log with a fault.

    how   refused with the cause; named in a judgment or remark; harmless for the mass, within the joint error of both
          logs; other: refused or advised against with another cause; unseen
    said  the error, or verdict and remarks
    off   relative change of a mass that was recommended
    """

    how: str
    said: str
    off: float = 0.0


class Fault(NamedTuple):
    """A fault of a log.

    put     the columns with the fault
    cause   what an error, a judgment or a remark says of it
    may     True if the fault may leave the mass as it is, so that nothing need be said
    alone   True if the log is that of the axis that moves one way
    blind   why one log cannot show the fault; empty if it can
    """

    put: Callable[[Drawn], Columns]
    cause: str
    may: bool = False
    alone: bool = False
    blind: str = ""

    def holds(self, answer: Answer) -> bool:
        """True if the answer is what must become of the fault."""
        allowed = {"harmless": self.may, "unseen": bool(self.blind)}
        return answer.how in ("refused", "named") or allowed.get(answer.how, False)


def _changed(**factors: float) -> Callable[[Drawn], Columns]:
    names = {"set_": SET, "position": POSITION, "force": FORCE}
    scales = {names[name]: factor for name, factor in factors.items()}
    return lambda log: {name: scales.get(name, 1.0) * values for name, values in log.columns.items()}


def _exchanged(first: str, second: str) -> Callable[[Drawn], Columns]:
    return lambda log: {**log.columns, first: log.columns[second], second: log.columns[first]}


def _headed(old: tuple[str, ...], unit: str) -> Callable[[Drawn], Columns]:
    """The same numbers under a head with another unit."""

    def put(log: Drawn) -> Columns:
        return {re.sub(r"\[.*\]", f"[{unit}]", n) if n in old else n: v for n, v in log.columns.items()}

    return put


def _at_rest(log: Drawn) -> Columns:
    random = np.random.default_rng(log.seed)
    rows = log.columns[TIME].size
    count = 1e-7 * np.round(random.normal(0.0, 0.4, rows))
    return {TIME: log.columns[TIME], SET: np.zeros(rows), POSITION: count, FORCE: random.normal(0.0, 1.0, rows)}


def _of_noise(log: Drawn) -> Columns:
    random = np.random.default_rng(log.seed)
    noise = {
        name: np.std(log.columns[name]) * random.standard_normal(log.columns[TIME].size)
        for name in (SET, POSITION, FORCE)
    }
    return {TIME: log.columns[TIME], **noise}


def _clipped(name: str, share: float) -> Callable[[Drawn], Columns]:
    def put(log: Drawn) -> Columns:
        values = log.columns[name]
        middle, half = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return {**log.columns, name: np.clip(values, middle - half, middle + half)}

    return put


def _lost(log: Drawn) -> np.ndarray:
    """A mask that loses 12 pieces of 1 to 6 rows while the axis moves."""
    random = np.random.default_rng(log.seed)
    speed = np.abs(np.gradient(log.columns[POSITION]))
    moving = np.flatnonzero(speed > 0.3 * speed.max())
    keep = np.ones(speed.size, bool)
    for start in random.choice(moving[:-10], 12, replace=False):
        keep[start : start + random.integers(1, 7)] = False
    return keep


def _dropped(stamped: bool) -> Callable[[Drawn], Columns]:
    def put(log: Drawn) -> Columns:
        keep = _lost(log)
        columns = {name: values[keep] for name, values in log.columns.items()}
        return columns if stamped else {**columns, TIME: log.columns[TIME][: np.count_nonzero(keep)]}

    return put


def _twice(log: Drawn) -> Columns:
    count = log.columns[TIME].size
    rows = np.sort(np.r_[np.arange(count), np.random.default_rng(log.seed).integers(0, count, 5)])
    return {name: values[rows] for name, values in log.columns.items()}


def _missing(log: Drawn) -> Columns:
    values = log.columns[POSITION].copy()
    values[np.random.default_rng(log.seed).integers(0, values.size, 3)] = np.nan
    return {**log.columns, POSITION: values}


def _jittered(log: Drawn) -> Columns:
    stamps = log.columns[TIME] + T * np.random.default_rng(log.seed).uniform(-0.15, 0.15, log.columns[TIME].size)
    return {**log.columns, TIME: stamps}


def _late(samples: int) -> Callable[[Drawn], Columns]:
    return lambda log: {
        **log.columns,
        FORCE: np.r_[np.full(samples, log.columns[FORCE][0]), log.columns[FORCE][:-samples]],
    }


UNITS = r"feed drives have|Check the units|moves .* times as far"
FAULTS: dict[str, Fault] = {
    "positions in mm, head m": Fault(_changed(set_=1e3, position=1e3), UNITS),
    "positions in m, head mm": Fault(_headed((SET, POSITION), "mm"), UNITS),
    "one position in mm, head m": Fault(_changed(position=1e3), UNITS),
    "force in kN, head N": Fault(_changed(force=1e-3), UNITS),
    "force in N, head kN": Fault(_headed((FORCE,), "kN"), UNITS, blind="there are machines of 200 t and 500 kN"),
    "set and actual exchanged": Fault(_exchanged(SET, POSITION), r"exchanged|swapped|set position"),
    "position and force exchanged": Fault(_exchanged(POSITION, FORCE), r"exchanged|swapped"),
    "force reversed": Fault(_changed(force=-1.0), r"sign"),
    "at rest": Fault(_at_rest, r"rows are left|in all rows|nothing moved"),
    "noise": Fault(_of_noise, r"rows are left|different axes|noise|no force|leaves"),
    "force clipped by the recorder": Fault(_clipped(FORCE, 0.6), r"saturated|clipped|largest"),
    "position clipped by the recorder": Fault(
        _clipped(POSITION, 0.7), r"clipped|jump|explains only|changed along|leaves"
    ),
    "rows lost, with their stamps": Fault(_dropped(True), r"a gap lies before"),
    "rows lost, stamps made anew": Fault(_dropped(False), r"jump|rows were lost|not on one clock|leaves", may=True),
    "stamps twice": Fault(_twice, r"time stands still"),
    "values missing": Fault(_missing, r"is nan at"),
    "stamps with 15 % jitter": Fault(_jittered, r"clock is not uniform|a gap lies"),
    "force 5 samples late": Fault(_late(5), r"synchronised|on one clock|later than stated|dead time", may=True),
    "force of another axis": Fault(
        lambda log: {**log.columns, FORCE: log.other[FORCE]}, r"of another axis|no force|leaves|synchronised"
    ),
    "one way only": Fault(lambda log: log.one_way, r"one direction|both directions", may=True, alone=True),
    "pushed by an unknown force": Fault(
        lambda log: log.pushed, r"does not hold|was added|leaves|changed along", may=True
    ),
}


def drawn(seed: int, count: int, laws: tuple[str, ...] = foreign.LAWS, folder: Path | None = None) -> Iterator[Drawn]:
    """Logs of calm loops that are identified and recommended without a fault; `count` axes of each law are drawn."""
    path = (folder or Path(tempfile.gettempdir())) / "clean.csv"
    for law in laws:
        rng = np.random.default_rng([seed, foreign.LAWS.index(law)])
        how: dict[str, Any] = {"law": law, "two": False, "rotary": False, "T": T, "seconds": 4.0}
        logs = foreign.draw(rng, count=count, move="dwells", **how)
        yield from _of(logs, foreign.draw(rng, count=count, move="one way", **how), law, rng, path)


def columns_of(log: dict[str, np.ndarray]) -> Columns:
    return {TIME: log["time"] - log["time"][0], SET: log["setpoint"], POSITION: log["position"], FORCE: log["force"]}


def _pushed(logs: foreign.Logs, rng: np.random.Generator) -> list[Columns]:
    """The same axes, pushed six times for 50 ms by a force that nobody logs, as large as that of the acceleration."""
    shape = logs.columns["setpoint"].shape
    size = 2.0 * np.broadcast_to(np.asarray(logs.axes.mass_all, float), shape[:1])
    push = np.stack([foreign.pulses(shape[1], T, rng, 6, force, 0.05) for force in size])
    again = foreign.simulate(logs.axes, logs.law, logs.columns["setpoint"], T, rng, count=shape[0], disturbance=push)
    return [columns_of(again.log(i, first=300)) for i in range(shape[0])]


def _of(logs: foreign.Logs, one_way: foreign.Logs, law: str, rng: np.random.Generator, path: Path) -> Iterator[Drawn]:
    """The logs that are identified and recommended without a fault."""
    pushed = _pushed(logs, rng)
    there = [columns_of(logs.log(i, first=300)) for i in range(len(logs))]
    # the gains of a loop that rang were lowered after the first run, and the law that is kept has the first ones
    calm = logs.stable & one_way.stable & (np.asarray(logs.truth.get("lowered", 0)) == 0)
    for i in map(int, np.flatnonzero(np.broadcast_to(calm, len(logs)))):
        done = _identify(there[i], path)
        if isinstance(done, FeeddriveError) or done[1] is not Judgment.USE_VALUES:
            continue
        other = there[i - 1] if len(there) > 1 else pushed[i]
        backward = columns_of(one_way.log(i, first=300))
        its_mass = float(np.ravel(np.broadcast_to(one_way.truth["mass"], len(one_way)))[i])
        yield Drawn(law, there[i], pushed[i], other, backward, *done[0], seed=i, one_way_mass=its_mass)


def plain(path: Path) -> Drawn:
    """A log that takes no time to draw: a P loop around a P loop, two strokes; the other axis has another mass."""
    moves = foreign.smooth_moves(T, (0.1, 0.0, 0.08), 0.3, 3.0, 120.0, 0.1, 0.3)
    masses = np.array([80.0, 35.0])
    axes = foreign.Axes(
        mass=masses,
        viscous=2.0 * masses,
        coulomb_positive=0.3 * masses,
        coulomb_negative=0.3 * masses,
        resolution=1e-7,
    )
    law, rng = foreign.Cascade(Kv=25.0, Kp=120.0 * masses), np.random.default_rng(5)
    other = foreign.smooth_moves(T, (0.05, 0.0, 0.12), 0.2, 2.0, 60.0, 0.2, 0.3)
    rows = min(moves.size, other.size)
    runs = [
        foreign.simulate(axes, law, np.stack([xs[:rows], other[:rows]]), T, rng, count=2)
        for xs in (moves, np.abs(np.cumsum(np.abs(np.diff(moves, prepend=0.0)))))
    ]
    return next(_of(runs[0], runs[1], "P-P", rng, path))


def _identify(columns: Columns, path: Path) -> FeeddriveError | tuple[tuple[float, float], Judgment, str]:
    """Mass and error, judgment, and all that was said; or the error."""
    command = load("identify")
    try:
        outcome = command.run(command.build_request(logs=[written(path, columns)]), Progress())
    except FeeddriveError as error:
        return error
    mass = outcome.result.rigid["mass"]
    if outcome.result.loop is not None:
        mass = outcome.result.loop.axis.plant.rigid_mass(), outcome.result.rigid["mass"].error
    else:
        mass = mass.value, mass.error
    return (float(mass[0]), float(mass[1])), outcome.judgment, " ".join(map(str, (outcome.verdict, *outcome.remarks)))


def answer(fault: Fault, log: Drawn, path: Path) -> Answer:
    """What becomes of a log with a fault."""
    done = _identify(fault.put(log), path)
    if isinstance(done, FeeddriveError):
        return Answer("refused" if re.search(fault.cause, str(done)) else "other", str(done))
    (mass, error), judgment, said = done
    told = re.search(fault.cause, said) is not None
    if judgment.bad:
        return Answer("named" if told else "other", said)
    # the log without the fault has an error of its own
    before, its_error = (log.one_way_mass, 0.0) if fault.alone else (log.mass, log.error)
    same = abs(mass - before) <= NORMAL * np.hypot(error, its_error)
    if same:
        return Answer("harmless", said, mass / before - 1.0)
    changed = f"mass {mass:.4g} +- {error:.2g} for {before:.4g}: {said}"
    return Answer("named" if told else "unseen", changed, mass / before - 1.0)
