"""`feeddrive cogging`: harmonics of the position in logs of slow runs, or in maps of holding current."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from feeddrive.cli.drive_logs import Drive, chosen, columns_said, drive_of, logs_said, read_logs, stem
from feeddrive.cli.roles import column
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.columns import ROLES, is_time
from feeddrive.files.messages import nearest, sentence
from feeddrive.files.read_log import read_arrays
from feeddrive.identification.cogging.cogging_passes import cogging_passes
from feeddrive.identification.cogging.cogging_run import CoggingRun
from feeddrive.identification.cogging.identify_cogging import identify_cogging
from feeddrive.language import units
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.table import Table
from feeddrive.workflow.cogging_page import (
    AtTable,
    kept_away,
    machine_text,
    recommendation,
    write_cogging,
)

_POSITIONS = ("position_motor", "position_load", "angle_motor")
_FORCES = ("force", "torque", "current", "command")
_NAME_IT = "--position or --angle (or give --map, if each row is a place)"
_ANY_CLOCK = 1e-3  # s, of a file without one
_MOST = 1000  # orders that may be asked for


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the command line says; `backward` are maps of the other direction."""

    named: Mapping[str, str | None] = field(default_factory=dict[str, str | None])
    channels: Path | None = None
    period: str | None = None
    map: bool = False
    backward: Sequence[Path] = ()
    orders: str | None = None
    machine: str | None = None
    axis: str | None = None
    force_constant: float | None = None
    lead: float | None = None
    gear: float | None = None
    sample_time: float | None = None
    out: Path | None = None


@dataclass(frozen=True)
class _Seen:
    """Runs, the role of their force and its unit, the period in SI (m or rad), and which column is what."""

    runs: Sequence[CoggingRun]
    role: str
    unit: str
    period: float
    turning: bool
    columns: str


def perform(logs: Sequence[Path], asked: Asked) -> None:
    """Read, fit, show, write."""
    console = open_console()
    drive = drive_of(asked.machine, asked.axis, asked.force_constant, asked.lead, asked.gear)
    orders = _orders(asked.orders)
    if asked.backward and not asked.map:
        raise ParameterError("--backward is for maps (--map): in a log the direction is seen in the position")
    seen = _maps(logs, asked, drive) if asked.map else _passes(logs, asked, drive, orders, console)
    fit = identify_cogging(seen.runs, orders, unit=seen.unit)
    table = _at_table(seen, drive)
    why = kept_away(fit, table)
    text = None if why or table is None else machine_text(fit, table, drive.machine, drive.axis)
    found = fit.table()
    # the chance of each is in the report: a terminal of 80 columns holds the rest whole
    console.print(drawn(Table(found.title, found.heads[:-1], [row[:-1] for row in found.rows])))
    for remark in fit.remarks:
        console.print(f"- {sentence(remark)}", markup=False)
    ways = [sum(run.direction == sign for run in seen.runs) for sign in (1, -1)]
    facts = {
        "Logs": logs_said([*logs, *asked.backward]),
        "Runs": f"{ways[0]} forward, {ways[1]} backward, {sum(run.turns.size for run in seen.runs)} rows",
        "Period": f"{math.degrees(seen.period):.6g} deg" if seen.turning else f"{1e3 * seen.period:.6g} mm",
        "Columns": seen.columns,
        "Force at the table": "not known"
        if table is None
        else f"{table.force_per_unit:.6g} N per {seen.unit or 'unit'}",
        "Machine": asked.machine or "none given",
    }
    report = write_cogging(fit, seen.runs, text, asked.out or Path("results") / f"cogging_{stem(logs)}", facts)
    console.print(recommendation(fit), markup=False)
    if text is None:
        console.print(f"- No machine file was written: {why}.", markup=False)
    else:
        console.print(f"Machine: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def _passes(paths: Sequence[Path], asked: Asked, drive: Drive, orders: Sequence[int] | None, console: Console) -> _Seen:
    """Ways in one direction of logs that run over the travel; a clock is not needed."""
    wanted = ("time", *_POSITIONS, *_FORCES)
    read, mapping = read_logs(paths, asked.named, asked.channels, wanted, _clock(paths[0], asked), console)
    found: list[CoggingRun] = []
    role = moving = ""
    period, units_there = 0.0, ""
    for path, log in zip(paths, read, strict=True):
        moving = chosen(path, log, asked.named, _POSITIONS, "position", _NAME_IT)
        role = chosen(path, log, asked.named, _FORCES, "force", "--force, --torque, --current or --command")
        period = _period(asked.period, ROLES[moving], drive)
        units_there = log.units.get(role, "")
        try:
            found += cogging_passes(log[moving] / period, log[role], highest=max(orders or (128,)))
        except NotIdentifiableError as error:
            unit = ROLES[moving]
            raise NotIdentifiableError(f"{path}: with a period of {period:.4g} {unit} {error}") from None
    return _Seen(found, role, units_there, period, moving == "angle_motor", columns_said(mapping))


def _clock(path: Path, asked: Asked) -> float | None:
    """Of a file without any: cogging is a matter of places, so any will do."""
    if asked.sample_time is not None or asked.named.get("time") is not None or asked.channels is not None:
        return asked.sample_time
    return None if any(is_time(name) for name in read_arrays(path)) else _ANY_CLOCK


def _maps(paths: Sequence[Path], asked: Asked, drive: Drive) -> _Seen:
    """Rows that are places of one turn; of those with a force other than 0."""
    role = next((each for each in _FORCES if asked.named.get(each) is not None), "current")
    told = asked.named.get(role)
    found: list[CoggingRun] = []
    name, unit = "", "" if role == "command" else ROLES[role]
    for path, direction in (*((each, 1) for each in paths), *((each, -1) for each in asked.backward)):
        arrays = read_arrays(path)
        if told is None and len(arrays) != 1:
            raise ParameterError(f"{path}: name the column of the map with --current or --torque{nearest('', arrays)}")
        asked_column = column(next(iter(arrays)) if told is None else told, role)
        name, values = asked_column.name, arrays.get(asked_column.name)
        if values is None:
            raise LogError(f"{path}: there is no column '{asked_column.name}' ({role}){nearest(name, arrays)}")
        factor = asked_column.factor
        if factor is None:
            factor = units.factor(asked_column.unit, unit) if asked_column.unit and unit else 1.0
        unit = unit or asked_column.unit
        visited = np.flatnonzero(values)
        if visited.size < 2:
            raise NotIdentifiableError(f"{path}: '{name}' is 0 at all places but {visited.size}: nothing was visited")
        found.append(CoggingRun(visited / values.size, factor * values[visited], direction))
    along = asked.period is not None and not _is_angle(asked.period)
    period = _period(asked.period, "m" if along else "rad", drive)
    return _Seen(found, role, unit, period, not along, f"{role}: {name}")


def _is_angle(text: str) -> bool:
    unit = text.partition(":")[2]
    return unit in ("rad", "deg", "rev")


def _period(text: str | None, unit: str, drive: Drive) -> float:
    """The period in the SI unit of the position. Raises ParameterError."""
    if text is None:
        if unit == "rad":
            return 2.0 * math.pi
        if drive.lever is not None:
            return 2.0 * math.pi * drive.lever
        raise ParameterError(
            "--period is missing: the position is along the table; give the pole pair, as --period 24:mm, or the "
            "screw's lead with --lead"
        )
    number, _, given = text.partition(":")
    try:
        value = float(number)
    except ValueError:
        raise ParameterError(f"--period {text}: must be NUMBER or NUMBER:UNIT, as 24:mm or 90:deg") from None
    value *= units.factor(given, unit) if given else 1.0
    if not 0.0 < value < math.inf:
        raise ParameterError(f"--period = {value:g} {unit} must be > 0")
    return value


def _orders(text: str | None) -> tuple[int, ...] | None:
    """`1..60` or `7,14,28`. Raises ParameterError."""
    if text is None:
        return None
    low, dots, high = text.partition("..")
    try:
        found = tuple(range(int(low), int(high) + 1)) if dots else tuple(int(each) for each in text.split(","))
    except ValueError:
        found = ()
    if not found or min(found) < 1 or max(found) > _MOST or len(set(found)) != len(found):
        raise ParameterError(f"--orders {text}: must be whole numbers from 1 to {_MOST}, as 1..60 or 7,14,28")
    return found


def _at_table(seen: _Seen, drive: Drive) -> AtTable | None:
    """Period in m and N per unit of the force at the table, if both are known."""
    r = drive.lever
    constants = {"force": 1.0, "torque": None if r is None else 1.0 / r}
    constant = constants.get(seen.role, drive.force_constant)
    period = seen.period if not seen.turning else None if r is None else seen.period * r
    return None if constant is None or period is None else AtTable(period, constant)
