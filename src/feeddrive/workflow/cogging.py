"""`feeddrive cogging`: position harmonics of the force in logs of slow runs, or in maps of holding current.

The output is the fit, its report, and the machine file with the harmonics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from feeddrive import plot
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.files.columns import ROLES, Column, is_time
from feeddrive.files.drive import Drive
from feeddrive.files.machine import MachineFile
from feeddrive.files.origins import with_origins
from feeddrive.files.read_log import OpenedFile, read_arrays
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import TomlEdit
from feeddrive.identification.cogging import CoggingFit, CoggingOrder, CoggingRun, cogging_passes, identify_cogging
from feeddrive.language import units
from feeddrive.language.block import Number
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError, nearest, sentence
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.language.units import rounded
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.workflow import drive_logs
from feeddrive.workflow.channels import units_first
from feeddrive.workflow.command import Outcome, argument, called, command, line, option
from feeddrive.workflow.drive_logs import DriveLogsRequest

_POSITIONS = ("position_motor", "position_load", "angle_motor")
_FORCES = ("force", "torque", "current", "command")
_NAME_IT = "--position or --angle (or give --map, if each row is a place)"
# cogging depends on position alone: any clock serves a file without one
_ANY_CLOCK = 1e-3  # s
_MOST = 1000  # largest order
_NAMED = 6  # orders named in a sentence
_STRONG = 0.05  # amplitude relative to the strongest order from which an order is named


class CoggingRequest(DriveLogsRequest):
    """Logs of slow runs, or maps of holding current, and the spatial period of the force."""

    logs: tuple[Path, ...] = argument("Logs of slow runs over the travel, one way or to and fro")
    period: str | None = option(
        "period after which the force repeats, as 24:mm or 90:deg; a turn of the motor if left out", default=None
    )
    position: str | None = option("column along the table: name:unit or name*factor:unit", default=None)
    angle: str | None = option("column of the motor's angle, as theta:deg", default=None)
    map: bool = option(
        "maps instead of logs: each row is a position, all rows one turn, 0 is a position not measured",
        default=False,
    )
    backward: tuple[Path, ...] = option("a map measured in the other direction; may be repeated", default=())
    orders: str | None = option("orders in a period, as 1..60 or 7,14,28; up to 128 if left out", default=None)

    def check(self) -> None:
        """Raise ParameterError for incompatible options."""
        if self.backward and not self.map:
            raise ParameterError("--backward is for maps (--map): in a log the direction is seen in the position")

    def usual_out(self) -> Path:
        return Path("results") / f"cogging_{drive_logs.logs_stem(self.logs)}"

    def named(self) -> dict[str, str | None]:
        """Return the column options by role; None for an omitted option."""
        return {"position_load": self.position, "angle_motor": self.angle, **self.forces()}


@dataclass(frozen=True)
class _Seen:
    """The measured runs, role and unit of their force, the period in SI (m or rad), and the columns by role."""

    runs: Sequence[CoggingRun]
    role: str
    unit: str
    period: float
    turning: bool
    columns: str
    doubts: Sequence[str] = ()


@command(CoggingRequest)
def cogging(request: CoggingRequest, progress: Progress) -> Outcome[CoggingFit]:
    """Identify the cogging of a motor from slow runs: orders with standard errors, and the direction-dependent part.

    Raises LogError for an unusable log, NotIdentifiableError for a log that does not cover a period.
    """
    drive, orders = drive_logs.drive_of(request), _orders(request.orders)
    seen = _maps(request, drive) if request.map else _passes(request, drive, orders, progress)
    progress.step("fitting")
    fit = identify_cogging(seen.runs, orders, unit=seen.unit)
    table = _at_table(seen, drive)
    why = kept_away(fit, table)
    text = None if why or table is None else machine_text(fit, table, drive.machine, drive.axis)
    # without a machine file the text is a section to be pasted
    if text is not None and drive.machine is not None:
        text = with_origins(text, (*request.logs, *request.backward, drive.machine))
    judged_by = units_first(seen.doubts) or advice(fit)
    judgment, verdict = judged_by
    files: dict[str, Path] = {}
    ways = [sum(run.direction == sign for run in seen.runs) for sign in (1, -1)]
    known = {
        "Logs": drive_logs.log_names([*request.logs, *request.backward]),
        "Runs": f"{ways[0]} forward, {ways[1]} backward, {sum(run.turns.size for run in seen.runs)} rows",
        "Period": Text(
            f"{Quantity(seen.period, 'rad'):6 deg}" if seen.turning else f"{Quantity(seen.period, 'm'):6 mm}"
        ),
        "Columns": seen.columns,
        "Force at the table": "not known"
        if table is None
        else Text(f"{Quantity(table.force_per_unit, 'N'):6} per {seen.unit or 'unit'}"),
        "Machine": called(request.machine),
    }
    page = partial(cogging_report, fit, seen.runs, known, judged_by)
    if request.out is not None:
        progress.step("report")
        files = drive_logs.written(drive_logs.write_report(page(), text, request.out), text)
    full = fit.table()
    # the p-values are only in the report, so that the table fits a terminal of 80 columns
    shown = Table(full.title, full.columns[:-1], [row[:-1] for row in full.rows])
    notes = [f"No machine file was written: {why}."] if text is None else []
    remarks = [sentence(text) for text in (*seen.doubts, *fit.remarks)]
    then = line("tune", files["Machine"], axis=request.axis) if "Machine" in files and not judgment.bad else ""
    return Outcome(fit, [shown], remarks, verdict, notes, files=files, judgment=judgment, page=page, then=then)


def _passes(request: CoggingRequest, drive: Drive, orders: Sequence[int] | None, progress: Progress) -> _Seen:
    """Split logs of runs over the travel into passes in one direction each; no clock is needed."""
    named, wanted = request.named(), ("time", *_POSITIONS, *_FORCES)
    files = [OpenedFile(source) for source in request.logs]
    step, paths = _clock(files[0], request), [file.path for file in files]
    read, mapping, doubts = drive_logs.read_logs(files, named, request, wanted, step, progress)
    passes: list[CoggingRun] = []
    # both are the same for all logs, which are read with the roles of the first one
    role = moving = ""
    period, units_there = 0.0, ""
    for path, log in zip(paths, read, strict=True):
        moving = drive_logs.chosen(path, log, named, _POSITIONS, "position", _NAME_IT)
        role = drive_logs.chosen(path, log, named, _FORCES, "force", "--force, --torque, --current or --command")
        period = _period(request.period, ROLES[moving], drive)
        units_there = log.units.get(role, "")
        try:
            # positions in periods, so that the fit does not depend on metres or radians
            passes += cogging_passes(log[moving] / period, log[role], highest=max(orders or (128,)), name=path.name)
        except NotIdentifiableError as error:
            size = Quantity(period, ROLES[moving])
            raise NotIdentifiableError(f"{path}: with a period of {size:SI} {error}") from None
    return _Seen(passes, role, units_there, period, moving == "angle_motor", drive_logs.column_texts(mapping), doubts)


def _clock(path: OpenedFile, request: CoggingRequest) -> float | None:
    """Return the sample time in s for reading a log: the requested one, or an arbitrary one for a file without a clock.

    The result is None if the file contains a time.
    """
    if request.sample_time is not None or request.time is not None or request.channels is not None:
        return request.sample_time
    return None if any(is_time(name) for name in read_arrays(path)) else _ANY_CLOCK


def _maps(request: CoggingRequest, drive: Drive) -> _Seen:
    """Return the measured positions and forces of cogging maps over one revolution; a force of 0 counts as not
    measured.
    """
    named = request.named()
    role = next((candidate for candidate in _FORCES if named.get(candidate) is not None), "current")
    text = named.get(role)
    runs: list[CoggingRun] = []
    name, unit = "", "" if role == "command" else ROLES[role]
    for source, direction in (*((log, 1) for log in request.logs), *((log, -1) for log in request.backward)):
        file = OpenedFile(source)
        path, arrays = file.path, read_arrays(file)
        if text is None and len(arrays) != 1:
            raise ParameterError(f"{path}: name the column of the map with --current or --torque{nearest('', arrays)}")
        column = Column(name=next(iter(arrays))) if text is None else Column.of(text).checked(role)
        name, values = column.name, arrays.get(column.name)
        if values is None:
            raise LogError(f"{path}: there is no column '{name}' ({role}){nearest(name, arrays)}")
        factor = column.scale(role)
        unit = unit or column.unit
        visited = np.flatnonzero(values)
        if visited.size < 2:
            raise NotIdentifiableError(f"{path}: '{name}' is 0 at all places but {visited.size}: nothing was measured")
        runs.append(CoggingRun(visited / values.size, (1.0 if factor is None else factor) * values[visited], direction))
    along = request.period is not None and not _is_angle(request.period)
    period = _period(request.period, "m" if along else "rad", drive)
    return _Seen(runs, role, unit, period, not along, f"{role}: {name}")


def _is_angle(text: str) -> bool:
    unit = text.partition(":")[2]
    return unit in ("rad", "deg", "rev")


def _period(text: str | None, unit: str, drive: Drive) -> float:
    """Return the period in `unit`, parsed or derived from the drive.

    Raises ParameterError if it is missing or invalid.
    """
    if text is None:
        if unit == "rad":
            return 2.0 * math.pi
        if drive.lever is not None:
            return 2.0 * math.pi * drive.lever
        raise ParameterError(
            "--period is missing: the position is along the table; give the pole pair, as --period 24:mm, or the "
            "screw's lead with --lead"
        )
    number, _, entered = text.partition(":")
    try:
        value = float(number)
    except ValueError:
        raise ParameterError(f"--period {text}: must be NUMBER or NUMBER:UNIT, as 24:mm or 90:deg") from None
    value *= units.factor(entered, unit) if entered else 1.0
    if not 0.0 < value < math.inf:
        raise ParameterError(f"--period = {Quantity(value, unit):6 SI} must be > 0")
    return value


def _orders(text: str | None) -> tuple[int, ...] | None:
    """Parse orders such as `1..60` or `7,14,28`; None if none are given. Raise ParameterError for an invalid string."""
    if text is None:
        return None
    low, dots, high = text.partition("..")
    try:
        orders = tuple(range(int(low), int(high) + 1)) if dots else tuple(int(part) for part in text.split(","))
    except ValueError:
        orders = ()
    if not orders or min(orders) < 1 or max(orders) > _MOST or len(set(orders)) != len(orders):
        raise ParameterError(f"--orders {text}: must be whole numbers from 1 to {_MOST}, as 1..60 or 7,14,28")
    return orders


def _at_table(seen: _Seen, drive: Drive) -> AtTable | None:
    """Return the period and the force factor at the table; None unless both are known."""
    r = drive.lever
    # F = torque / r, x = r θ with r = lead / (2π gear)
    constants = {"force": 1.0, "torque": None if r is None else 1.0 / r}
    constant = constants[seen.role] if seen.role in constants else drive.force_per_unit(seen.unit)
    period = seen.period if not seen.turning else None if r is None else seen.period * r
    return None if constant is None or period is None else AtTable(period, constant)


@dataclass(frozen=True)
class AtTable:
    """The table displacement per period, m, and the force at the table per unit of the measured force, N."""

    period: float
    force_per_unit: float


def cogging_report(
    fit: CoggingFit,
    runs: Sequence[CoggingRun] = (),
    known: Mapping[str, str] | None = None,
    verdict: Advice | None = None,
) -> Report:
    """Return the report of a cogging fit; `known` holds facts about the logs."""
    first, *others = _pictures(fit, runs)
    judgment, told = verdict or advice(fit)
    return Report(
        "Cogging by position",
        "feeddrive cogging",
        Verdict((told,), good=not judgment.bad),
        (
            Section("result", "Result", (fit.table(), Remarks(map(sentence, fit.remarks)))),
            further(others),
            facts("The logs", known or {}),
        ),
        first,
    )


def kept_away(fit: CoggingFit, at_table: AtTable | None) -> str:
    """Return the reason for not writing the harmonics to a machine file, or an empty string if they may be written."""
    if fit.coulomb is None:
        return "one direction cannot tell cogging from friction that varies along the travel"
    if not _cogging(fit):
        return "no order stands out as cogging"
    if at_table is None:
        return "force and period at the table are not known; give --force-constant, or --lead and --gear"
    return ""


def advice(fit: CoggingFit) -> Advice:
    """Return the judgment and one sentence: the orders to compensate, or the measurement to do next, and the reason."""
    if not fit.significant:
        return Judgment.NO_COGGING.because("no order of the position is significant")
    strong = [order for order in fit.significant if order.amplitude >= _STRONG * fit.orders[0].amplitude]
    if fit.coulomb is None:
        return Judgment.COGGING_IS_OPEN.because(
            f"{_listed(strong)} stand out, and one direction cannot tell cogging from friction that varies along the "
            "travel"
        )
    taken = _cogging(fit)
    if not taken:
        return Judgment.NO_COGGING.because(
            f"what stands out, {_listed(strong)}, changes its sign with the direction, so it is friction that varies "
            "along the travel, or an error of the current's zero"
        )
    # sines of different orders are orthogonal over a period, so their mean squares a²/2 add up
    even = sum(order.even.value**2 for order in fit.significant if order.even is not None)
    odd = sum(order.odd.value**2 for order in fit.significant if order.odd is not None)
    turned = [order for order in strong if order not in taken]
    rest = (
        f"; do not compensate what changes its sign with it ({_rms(odd, fit.unit)}, {_listed(turned)}) by position "
        "alone, for that would double it one way"
        if turned
        else ""
    )
    size = f"{_rms(even, fit.unit)} that is the same in both directions"
    return Advice(Judgment.TAKE_COGGING, Text(f"Take {_listed(taken)} as cogging, {size}{rest}."))


def _rms(squares: float, unit: str) -> Text:
    """Return, as text, the RMS of harmonics from the sum of their squared amplitudes."""
    return Text(f"{Quantity(np.sqrt(0.5 * squares), unit):3 SI} RMS")


def machine_text(fit: CoggingFit, at_table: AtTable, machine: MachineFile | None, axis: str) -> str:
    """Return the text of the machine file with the cogging added (comments are kept).

    Without a machine file, only the section to be pasted is returned.
    """
    block = _rounded(fit.block(at_table.period, force_per_unit=at_table.force_per_unit))
    section = _section(block, axis)
    if machine is None:
        head = "# cogging of an axis, from slow runs; add plant, control, limits and encoders\n\n"
        edit, index = TomlEdit(head + section, "cogging.toml"), 0
    else:
        edit = TomlEdit(machine.file.text, machine.file.name)
        forces = machine.loop(axis).axis.forces
        index = next((i for i, force in enumerate(forces) if isinstance(force, Cogging)), len(forces))
        if index < len(forces):
            # the number of harmonics may differ, so the old section cannot be edited key by key
            edit.replace(("axis", axis, "forces", index), section)
        else:
            edit.add(section)
    # `force` of the block is the amplitude of its strongest harmonic; the shares scale the others
    strongest = max((order.even for order in fit.significant if order.even is not None), key=lambda order: order.value)
    error = at_table.force_per_unit * strongest.error
    edit.comment(("axis", axis, "forces", index, "force"), Text(f"standard error {Quantity(error, 'N'):2}"))
    return edit.text


def _rounded(block: Cogging) -> Cogging:
    """Round the values to six digits, far finer than the standard errors."""
    harmonics = tuple(
        replace(harmonic, share=_short(harmonic.share), phase=_short(harmonic.phase)) for harmonic in block.harmonics
    )
    return replace(block, force=_short(block.force), harmonics=harmonics)


def _short(value: Number) -> float:
    return rounded(float(value), 6)


def _section(block: Cogging, axis: str) -> str:
    return to_toml(block, f"axis.{axis}.forces", listed=True)


def _cogging(fit: CoggingFit) -> list[CoggingOrder]:
    """Return the strong orders whose sign does not depend on the direction of motion, strongest first."""
    # cogging is a force of position alone; what changes its sign with the direction is friction
    common = [
        order
        for order in fit.significant
        if order.even is not None and order.odd is not None and order.even.value > order.odd.value
    ]
    common.sort(key=lambda order: -(order.even.value if order.even is not None else 0.0))
    return [order for order in common if order.amplitude >= _STRONG * fit.orders[0].amplitude]


def _listed(orders: Sequence[CoggingOrder]) -> str:
    names = ", ".join(str(order.order) for order in orders[:_NAMED])
    more = f" and {len(orders) - _NAMED} more" if len(orders) > _NAMED else ""
    return f"order{'s' if len(orders) > 1 else ''} {names}{more}"


def _pictures(fit: CoggingFit, runs: Sequence[CoggingRun]) -> Iterator[Picture]:
    yield Picture(
        "turn",
        "Force over one period",
        "Points: what was measured, by direction; half of the distance of their means is Coulomb friction. "
        "Line: what does not change with the direction, which is cogging."
        if fit.coulomb is not None
        else "Points: the force measured in one direction. Line: the significant orders, friction among them.",
        "Measured force over one period by direction, and the fitted cogging.",
        lambda: plot.cogging_over_turn_chart(fit, runs),
    )
    if fit.significant:
        yield Picture(
            "orders",
            "Amplitude by order",
            "Orders that chance does not explain, with twice their standard error. What changes its sign with the "
            "direction is no cogging but friction that varies along the travel.",
            "Amplitudes of the significant orders with their errors.",
            fit.chart,
        )
