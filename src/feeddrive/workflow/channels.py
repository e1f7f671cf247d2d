"""`feeddrive channels`, and the mapping of log columns to roles for all commands.

The mapping is taken from the options or a TOML file; otherwise it is guessed and shown to the user.

The magnitudes of a log show whether its units are plausible for a feed drive. For example, a command rejects a travel
of 200 m or a mass of 0.1 kg: it shows the two likeliest interpretations of the units side by side, and writes nothing
until the user states the unit.
"""

from __future__ import annotations

from collections import abc
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.families import Filter
from feeddrive.files.columns import FLAGS, ROLES, Column, is_time, unit_at_the_end, unit_of
from feeddrive.files.commissioning import Commissioning, read_commissioning
from feeddrive.files.frf import names_frequency, read_controllers, read_frfs
from feeddrive.files.log import Log, LogLike
from feeddrive.files.mapping import (
    Guess,
    Mapping,
    MappingLike,
    Need,
    axes_in,
    guess_roles,
    log_preview,
    measures,
    nameless_in,
    role_doubts,
    write_roles,
)
from feeddrive.files.names import RELATIVE, read_name
from feeddrive.files.preview import Preview, preview_of
from feeddrive.files.read_log import LogRequest, OpenedFile, read_log, read_request, time_units
from feeddrive.files.role_checks import POSITIONS, RoleDoubt, doubts_of, option_for
from feeddrive.identification.plausibility import RANGES, out_of_range, outside, scaled, sizes, spoken, unlikely
from feeddrive.identification.regression import SHAFT, TABLE, Frame
from feeddrive.identification.shapes import SAME, share
from feeddrive.language import tree, units
from feeddrive.language.errors import FileError, LogError, ParameterError
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column as TableColumn
from feeddrive.language.table import Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.command import Outcome, argument, command, line, option
from feeddrive.workflow.force import DriveValues, scale_of

ALL = "all"  # in place of the name of an axis

_MOTIONS = (
    "position_load",
    "position_motor",
    "angle_motor",
    "angle_load",
    "velocity_load",
    "velocity_motor",
    "speed_motor",
    "speed_load",
    "setpoint_position",
    "setpoint_angle",
)
_FORCES = ("force", "torque")
# units in which each quantity may be logged; the first is SI
_UNITS = {
    "m": ("m", "mm", "um", "in"),
    "m/s": ("m/s", "mm/s", "m/min", "mm/min"),
    "rad": ("rad", "deg", "rev"),
    "rad/s": ("rad/s", "rpm", "deg/s"),
    "N": ("N", "kN", "mN"),
    "N m": ("N m", "mN m", "kN m"),
}
# HAL has no units: LINEAR_UNITS in the INI file sets mm or inch
_OF_HAL = ("mm", "in")
_HAL_FORMATS = ("halscope", "halsampler")
_HAL_PINS = ("joint.", "axis.", "pid.")


@dataclass(frozen=True)
class Doubt:
    """A doubt about the magnitudes of a log; the sentence `why` is empty if they are plausible for a feed drive.

    told      True if the user stated the units, so that the command continues; otherwise it must stop
    readings  the two likeliest interpretations side by side, if other units make the log plausible
    moves     True if a mass could be identified, so that the log is not pure noise
    cause     the doubt without file and options, for a page where units are chosen; empty if there are no choices
    choices   the likeliest interpretations, each as (column, unit) pairs
    """

    why: str = ""
    told: bool = True
    readings: Table | None = None
    moves: bool = False
    cause: str = ""
    choices: tuple[tuple[tuple[str, str], ...], ...] = ()

    def stop(self, progress: Progress) -> None:
        """Show the interpretations and raise LogError, unless the user stated the units."""
        if self.why and not self.told:
            if self.readings is not None:
                progress.remark(self.readings)
            raise LogError(self.why)


def units_first(doubts: Sequence[str]) -> Advice | None:
    """Return the judgment that the units must be clarified first, with the first doubt as reason, or None."""
    return Judgment.UNITS_IN_DOUBT.because(doubts[0]) if doubts else None


@dataclass(frozen=True)
class _Group:
    """The column of the motion or of the force: its role, the unit in which it was read, and the origin of the unit."""

    role: str
    column: str
    unit: str
    how: str  # told, stated or ""

    @property
    def si(self) -> str:
        return ROLES[self.role]

    def origin(self) -> str:
        """Return the origin of the unit, as the start of a sentence."""
        if self.how == "stated":
            return f"'{self.column}' is in {self.unit}, as the file says"
        return f"'{self.column}' states no unit"


def with_units(file: OpenedFile, mapping: abc.Mapping[str, Column], texts: Sequence[str]) -> dict[str, Column]:
    """Return the mapping, with the units given by `--unit` assigned to columns that state none.

    Raises ParameterError for a unit that fits none of these columns.
    """
    columns = dict(mapping)
    for text in texts:
        unit = unit_of(text)
        if unit is None:
            raise ParameterError(f"--unit {text}: is no unit; give one as mm, um, in, N, kN, 'N m' or deg")
        hit = False
        for role, column in mapping.items():
            if column.unit or column.factor is not None or stated(file, column.name, role) or role == "time":
                continue
            try:
                units.factor(unit, ROLES[role])
            except ParameterError:
                continue
            columns[role], hit = Column(name=column.name, unit=unit), True
        if not hit:
            raise ParameterError(
                f"{file}: --unit {text}: no column that states no unit is of that kind; a unit for one column is given "
                f"with its name, as --position 'x:{text}'"
            )
    return columns


def stated(file: OpenedFile, column: str, role: str) -> str:
    """Return the unit of a column from its header or the end of its name, or an empty string."""
    return file.columns.units.get(column, "") or unit_at_the_end(column, role)


def doubt(
    file: OpenedFile,
    log: Log,
    mapping: abc.Mapping[str, Column],
    told: Collection[str],
    flags: abc.Mapping[str, str] = FLAGS,
    steady: bool = False,
) -> Doubt:
    """Check the magnitudes of a log, in the units in which it was read, against those of feed drives.

    told    roles whose unit or factor was given by the user
    flags   the option of the command for each role
    steady  True for a log without acceleration ramps: its accelerations and mass are not checked
    """
    groups = [_group(file, mapping, told, roles) for roles in (_MOTIONS, _FORCES)]
    motion, force = groups
    if motion is None and force is None:
        return Doubt()
    frame = SHAFT if motion is not None and motion.si.startswith("rad") else TABLE
    torque = force if force is not None and force.role == "torque" and not force.how else None
    # a torque beside a table motion, or a force beside an angle, gives no mass without the lead: one of them is judged
    if force is not None and (force.role == "torque") != (frame is SHAFT):
        frame, force = (SHAFT, force) if motion is None else (frame, None)
    measured = _sizes(log, frame, motion, force)
    if steady:
        measured = {name: size for name, size in measured.items() if name in ("travel", "speed", "force", "torque")}
    is_hal = motion is not None and not motion.how and motion.si == "m" and _hal(file, motion.column)
    # with a table motion the torque's unit is questioned too, unless a command may be the force
    silent = torque is not None and (force is torque or "command" not in mapping)
    wrong = outside(frame, measured)
    if not wrong and not is_hal and not silent:
        return Doubt()
    readings = _readings(frame, measured, motion, force, is_hal)
    if silent and torque is not None and not wrong and not is_hal:
        cause = f"'{torque.column}' states no unit, and drives log a torque in N m or in percent of the rated one"
        return Doubt(
            _silent_torque(file, torque, log, measured),
            told=False,
            cause=Text(cause),
            choices=tuple(((torque.column, unit),) for unit in ("N m", "percent")),
        )
    why = out_of_range(wrong, measured)
    open_ = [group for group in groups if group is not None and group.how != "told" and group in (motion, force)]
    if not open_:
        return Doubt(Text(f"{file}: as its units were told, {why}"))
    who = " and ".join(group.origin() for group in open_)
    # even the best units leave a magnitude out of range: proposing them would be a guess
    if not readings or unlikely(frame, readings[0].sizes)[0] > 0.0:
        return Doubt(
            Text(
                f"{file}: {who}, and {why}; in no usual unit is this a feed drive: check which column is what, and "
                "give each with its unit, as --position 'x:mm' --force 'f:kN'"
            ),
            told=False,
        )
    best = readings[:2]
    asked = "HAL knows no units, and a machine is in mm or inch" if is_hal else Text(f"as read, {why}")
    return Doubt(
        Text(
            f"{file}: {who}: {asked}. Likeliest: {joined(' or ', (reading.sentence(frame) for reading in best))}. Say "
            "which "
            f'with {" or ".join(reading.options(flags) for reading in best)}, or unit = "..." in a file for '
            "--channels; nothing was written"
        ),
        told=False,
        readings=_table(str(file), frame, best),
        # entry 4 is the mass (or inertia), which `sizes` omits where it cannot be identified
        moves=RANGES[frame][4].quantity in measured,
        cause=Text(f"{who}: {asked}"),
        choices=tuple(tuple((group.column, unit) for group, unit in reading.choices) for reading in best),
    )


@dataclass(frozen=True)
class _Reading:
    """An interpretation of a log: units of motion and force, and its magnitudes in them."""

    choices: tuple[tuple[_Group, str], ...]
    sizes: dict[str, float]

    @property
    def changes(self) -> int:
        """The number of units that differ from those of the log as read."""
        return sum(group.unit != unit for group, unit in self.choices)

    @property
    def name(self) -> str:
        """The units in words: `x in mm, f in N`."""
        return ", ".join(f"{group.column} in {unit}" for group, unit in self.choices)

    def options(self, flags: abc.Mapping[str, str]) -> str:
        """Return the command line options for this interpretation."""
        open_ = [(group, unit) for group, unit in self.choices if group.how != "told"]
        kept = [(group, unit) for group, unit in open_ if group.unit != unit] or open_
        words = [
            f"--unit {unit if ' ' not in unit else repr(unit)}"
            if not group.how
            else f"{flags.get(group.role, '--' + group.role)} '{group.column}:{unit}'"
            for group, unit in kept
        ]
        return " ".join(words)

    def sentence(self, frame: Frame) -> str:
        """Return the units and magnitudes in words: `x in mm (travel 200 mm, ...)`."""
        sizes = [
            Text(f"{span.quantity} {spoken(self.sizes[span.quantity], span.unit)}")
            for span in RANGES[frame]
            if span.quantity in self.sizes and " over " not in span.quantity
        ]
        return Text(f"{self.name} ({joined(', ', sizes)})")


def _readings(
    frame: Frame, measured: abc.Mapping[str, float], motion: _Group | None, force: _Group | None, is_hal: bool
) -> list[_Reading]:
    """Return interpretations of the log in all combinations of units, sorted by plausibility, then by changed units."""
    there = [group for group in (motion, force) if group is not None]
    choices: list[list[tuple[_Group, str]]] = []
    for group in there:
        if group.how == "told" or group.si not in _UNITS:
            choices.append([(group, group.unit)])
        elif is_hal and group is motion:
            choices.append([(group, unit) for unit in _OF_HAL])
        else:
            choices.append([(group, unit) for unit in dict.fromkeys((group.unit, *_UNITS[group.si]))])
    readings: list[_Reading] = []
    for choice in product(*choices):
        factors = {
            group.role: units.factor(unit, group.si) / units.factor(group.unit, group.si) for group, unit in choice
        }
        by = [1.0 if group is None else factors[group.role] for group in (motion, force)]
        readings.append(_Reading(choice, scaled(frame, measured, by[0], by[1])))

    def order(reading: _Reading) -> tuple[float, int, float]:
        decades, unusual = unlikely(frame, reading.sizes)
        return decades, reading.changes, unusual

    return sorted(readings, key=order)


def _sizes(log: Log, frame: Frame, motion: _Group | None, force: _Group | None) -> dict[str, float]:
    acting = None if force is None else log[force.role]
    if motion is not None and motion.si.endswith("/s"):
        # entry 1 is the speed; without a position there is no travel or acceleration to check
        speed = {RANGES[frame][1].quantity: float(np.max(np.abs(log[motion.role])))}
        return {**speed, **sizes(frame, log.sample_time, None, acting)}
    return sizes(frame, log.sample_time, None if motion is None else log[motion.role], acting)


def _group(
    file: OpenedFile, mapping: abc.Mapping[str, Column], told: Collection[str], roles: Sequence[str]
) -> _Group | None:
    role = next((candidate for candidate in roles if candidate in mapping), None)
    if role is None:
        return None
    column = mapping[role]
    if role in told:
        return _Group(role, column.name, column.unit or ROLES[role], "told")
    unit_text = stated(file, column.name, role)
    unit = column.unit or unit_of(unit_text) or ROLES[role]
    return _Group(role, column.name, unit if measures(unit, role) else ROLES[role], "stated" if unit_text else "")


def _hal(file: OpenedFile, column: str) -> bool:
    return file.columns.format in _HAL_FORMATS or column.startswith(_HAL_PINS)


def _silent_torque(file: OpenedFile, force: _Group, log: Log, measured: abc.Mapping[str, float]) -> str:
    most = float(np.max(np.abs(log["torque"])))
    inertia = measured.get("inertia")
    as_it_is = f"up to {Quantity(most, 'N m'):3}"
    rated = ""
    if inertia is not None:
        as_it_is += f", inertia {Quantity(inertia, 'kg m2'):3}"
        rated = f", inertia {Quantity(inertia / 100.0, 'kg m2'):3} for each N m of rated torque"
    return Text(
        f"{file}: '{force.column}' states no unit, and drives log a torque in N m or in percent of the rated one. "
        f"Likeliest: {force.column} in N m ({as_it_is}), or in percent (up to {Quantity(0.01 * most, 'share'):3} of "
        f"the rated torque{rated}). Say which with --unit 'N m', or --torque '{force.column}*FACTOR' with the rated "
        "torque in N m / 100 as FACTOR (feeddrive force computes it); nothing was written"
    )


def _table(name: str, frame: Frame, readings: Sequence[_Reading]) -> Table:
    rows = [
        [
            span.quantity,
            span.bounds(),
            *(
                Text(f"{spoken(r.sizes[span.quantity], span.unit)}{' !' if span.apart(r.sizes[span.quantity]) else ''}")
                for r in readings
            ),
        ]
        for span in RANGES[frame]
        if span.quantity in readings[0].sizes
    ]
    heads = ["", "feed drives", *(reading.name for reading in readings)]
    return Table(f"{name}: the two likeliest readings", heads, rows, sentences=2)


_OUTPUTS = (
    ("m", "mm", "um", "nm"),
    ("m/s", "mm/s"),
    ("m/s2", "mm/s2"),
)  # units of a response's numerator, by order of derivative


def check_response(
    where: str, frf: FRF, told: bool, progress: Progress, cure: Callable[[str], str] | None = None
) -> str:
    """Raise LogError for a response with an implausible mass; if the user gave its unit, return a sentence instead.

    The mass is the median over the lines of |F / (ω² x)|; responses that are not motion over force are not checked.

    cure  function that returns the command-line option that states a unit of the response, such as um/N
    """
    mass, unit = RANGES[TABLE][4], frf.unit or "m/N"
    try:
        known = units.response(unit_of(unit) or unit)
    except ParameterError:
        known = None
    of_order = [f"({names[0]})/N" if n else f"{names[0]}/N" for n, names in enumerate(_OUTPUTS)]
    if known is None or known[0] not in of_order:
        return ""
    order, size = of_order.index(known[0]), 1.0 / known[1]
    # a line filled with 0 would give an infinite mass
    there = np.abs(frf.response) > 0.0
    if not np.any(there):
        return ""
    w, response = 2.0 * np.pi * frf.frequency[there], np.abs(frf.response[there])
    # a free mass: |x/F| = 1/(m ω²), |v/F| = 1/(m ω), |a/F| = 1/m
    masses = [w ** (n - 2) / response for n in range(len(_OUTPUTS))]
    read_mass = float(np.median(masses[order])) / size
    if not mass.apart(read_mass):
        return ""
    why = Text(f"read in {unit} its mass is {spoken(read_mass, 'kg')}, where feed drives have {mass.bounds()}")
    if told:
        return Text(f"{where}: {why}, as its unit was told")
    # only the right order of derivative gives the same mass on all lines; the logarithm makes its scatter
    # independent of the unit
    read: list[tuple[str, float, float]] = []  # unit, mass, scatter
    for n in [order] if frf.unit else range(len(_OUTPUTS)):
        scatter = float(np.std(np.log(masses[n])))
        for name in _OUTPUTS[n]:
            in_it = float(np.median(masses[n])) / units.factor(name, _OUTPUTS[n][0])
            read.append((f"({name})/N" if n else f"{name}/N", in_it, scatter))
    read = sorted(read, key=lambda reading: (mass.apart(reading[1]), reading[2], mass.unusual(reading[1])))[:2]
    rows = [["mass", mass.bounds(), *(Text(f"{spoken(mass_read, 'kg')}") for _, mass_read, _ in read)]]
    heads = ["", "feed drives", *(reading[0] for reading in read)]
    progress.remark(Table(f"{where}: the two likeliest readings", heads, rows, sentences=2))
    unit_source = f"is in {unit} by what the file says" if frf.unit else "states no unit"
    cure = cure or (lambda unit: f"{'--unit' if not frf.unit else 'a file that says'} '{unit}'")
    cures = " or ".join(cure(reading[0]) for reading in read)
    likely = joined(" or ", (f"{unit_read} ({spoken(mass_read, 'kg')})" for unit_read, mass_read, _ in read))
    raise LogError(
        f"{where}: the response to {frf.output} {unit_source}: {why}. Likeliest: {likely}. Say which with {cures}; "
        f"nothing was written"
    )


@dataclass(frozen=True)
class Mapped:
    """A log with the column of each role, doubts about the log, and the named columns that are not used.

    doubt           doubt about the magnitudes of the log
    contradictions  contradictions between the samples and the roles of the columns
    guessed         roles that were not named by the user: a certain contradiction of one of them stops a command
    named           roles named by the user: by an option, in a roles file, or on the page
    preview         peak figures of the motion; None if there is no position
    second          contradictions of clock and scales by a second source: a logged velocity or current
    axis            the axis of the columns if the log has several axes; otherwise empty
    """

    log: Log
    columns: dict[str, Column]
    doubt: Doubt
    unused: tuple[str, ...] = ()
    contradictions: tuple[RoleDoubt, ...] = ()
    guessed: frozenset[str] = frozenset()
    named: frozenset[str] = frozenset()
    preview: Preview | None = None
    second: tuple[str, ...] = ()
    axis: str = ""

    def stop(self, progress: Progress) -> None:
        """Raise LogError for implausible magnitudes, and for guessed roles that the samples certainly contradict."""
        self.doubt.stop(progress)
        for doubt in self.contradictions:
            if doubt.certain and self.guessed & {*doubt.roles}:
                raise LogError(
                    f"{self.log.name}: {doubt.why}. If it is right as it is, name both columns; nothing was written"
                )


def mapped(
    path: Path | OpenedFile,
    named: abc.Mapping[str, str | None],
    channels: MappingLike | None,
    wanted: Collection[str],
    sample_time: float | None,
    progress: Progress,
    unit: Sequence[str] = (),
    *,
    steady: bool = False,
    axis: str | None = None,
    names_machine: bool = False,
    values: DriveValues | None = None,
    beside: Collection[str] = (),
) -> Mapped:
    """Read a log and assign its columns to the roles in `wanted`; roles without a suitable column are left out.

    named     the column of each role as typed on the command line; it takes precedence over everything else
    channels  a TOML file with [log.channels], or a `Mapping`; None: roles that are not named are guessed, and the guess
              is shown
    unit      units for columns without a stated or given unit
    steady    True for a log without acceleration ramps, whose accelerations do not indicate its units
    axis      the axis to be read from a log with several axes; for other logs it only selects the machine's axis
    names_machine  True if `axis` may be the name of an axis that only exists in the machine file
    values    rated value and constants of the drive, for columns in percent, A or V
    beside    roles that are read only as a second source for clock and scales
    """
    path = path if isinstance(path, OpenedFile) else OpenedFile(path)
    values = values or DriveValues()
    typed = [_converted(path, role, Column.of(text), values) for role, text in named.items() if text is not None]
    told = {role: column for role, column, _ in typed}
    reasons = {role: why for role, _, why in typed}
    axes = axes_in(path.columns.values, path.columns.units)
    if axis is not None and (len(axes) < 2 or (names_machine and axis.lower() not in axes)):
        axis = None
    optional: abc.Mapping[str, Column] = {}
    open_: dict[str, str] = {}
    skipped = 0
    if channels is None:
        guess = proposed(path, axis, told.get("time"), sample_time, values, likely_time=False, named=(told, reasons))
        guessed = {role: guess.mapping[role] for role in guess.mapping if role not in told}
        mapping = {role: column for role, column in {**guessed, **told}.items() if role in wanted}
        if any(role in wanted for role in guessed if role != "time") or any(role not in told for role in guess.needs):
            show(guess, path, progress)
        if not set(mapping) - {"time"}:
            raise _nothing_known(path, guess)
        open_ = {role: why for role, why in _open(guess, wanted).items() if role not in mapping}
        of_axis = guess.mapping.axis
    else:
        request = requested(channels, path.path)
        # a reason that feeddrive wrote, and nobody replaced, is still a guess
        chosen = {role for role in request.mapping if request.mapping.reasons.get(role, CHOSEN) == CHOSEN}
        told = {**{role: request.mapping[role] for role in request.mapping if role in chosen}, **told}
        guessed = _remaining(path, told, request.mapping)
        mapping = {role: column for role, column in {**guessed, **told}.items() if role in wanted}
        optional, sample_time = request.mapping.optional, sample_time or request.mapping.sample_time
        skipped, of_axis = request.skip_samples, request.mapping.axis
        if not all(any(role in mapping for role in roles) for roles in (_MOTIONS, _ACTING)):
            guess = proposed(
                path, of_axis if of_axis in axes else None, mapping.get("time"), sample_time, values, likely_time=False
            )
            open_ = {role: why for role, why in _open(guess, wanted).items() if role not in mapping}
    # in one order, whichever way the roles came: the first position and the first force of it are compared
    mapping = {role: mapping[role] for role in ROLES if role in mapping}
    whole = with_units(path, mapping, unit)
    used = {column.name for column in whole.values()}
    likely = {**guessed, **told}
    more = {role: column for role, column in likely.items() if role in beside and column.name not in used}
    try:
        log = read_log(path, whole, optional={**optional, **more}, sample_time=sample_time).from_row(skipped)
    except LogError:
        # a second source that cannot be read is no reason to refuse the log
        more = {}
        log = read_log(path, whole, optional=optional, sample_time=sample_time).from_row(skipped)
    # kept with the log, so that the error for a missing role can state why its likely column was rejected
    log = replace(log, left_out={**open_, **log.left_out}) if open_ else log
    stated_units = {role for role, column in whole.items() if column != mapping[role]}
    stated_units |= {role for role, column in told.items() if column.unit or column.factor is not None}
    stated_units |= {role for role, column in guessed.items() if _unit_was_given(path, column)}
    unused = tuple(f"{role} ('{column.name}')" for role, column in told.items() if role not in (*wanted, "time"))
    roles = {role: log[role] for role in whole if role in log.channels}
    used = {column.name for column in (*guessed.values(), *told.values())}
    nameless = nameless_in(path.columns.values, path.columns.units, of_axis)
    others = {name: path.columns.values[name][skipped:] for name in nameless if name not in used}
    # a column with gaps or of another length is no signal of the axis
    others = {
        name: column for name, column in others.items() if column.size == log.time.size and np.all(np.isfinite(column))
    }
    found = doubts_of(roles, whole, log.sample_time, others, steady=steady)
    for doubt_ in found:
        progress.remark(Text(f"- {doubt_.why}"))
    stated_clock = path.columns.metadata.get("sample_time")
    if sample_time is not None and isinstance(stated_clock, float) and sample_time != stated_clock:
        progress.remark(
            Text(
                f"- the file states a sample time of {Quantity(stated_clock, 's')}; {Quantity(sample_time, 's')} is "
                "taken, as told: a mass goes with its square"
            )
        )
    second = scale_doubts(log, {**whole, **more}, values) if more else []
    for why in second:
        progress.remark(Text(f"- {why}"))
    return Mapped(
        log,
        whole,
        doubt(path, log, whole, stated_units, steady=steady),
        unused,
        found,
        frozenset(whole) - {*told},
        frozenset(told),
        preview_of(str(path), roles, whole, log.sample_time, path.columns.units),
        tuple(second),
        of_axis if len(axes) > 1 else "",
    )


# share by which the constant of a motor may differ from its data sheet: tolerance and warm magnets make some 10 %
CONSTANT_OFF = 0.15


def scale_doubts(log: Log, columns: abc.Mapping[str, Column], values: DriveValues) -> list[str]:
    """Return contradictions in clock or scales that a velocity logged with a position, or a current, shows."""
    channels = {role: log[role] for role in columns if role in log.channels}
    found = [doubt.why for doubt in doubts_of(channels, columns, log.sample_time, {}) if doubt.kind == "clock"]
    role = "torque" if values.torque_constant is not None else "force"
    if found or role not in channels or "current" not in channels:
        return found
    if values.torque_constant is None and values.motor_constant is None:
        return found
    # of one motor the force and its current have one factor, which is the constant
    scale = scale_of("A", columns["current"].name, values)
    f, i = (channels[name] - np.mean(channels[name]) for name in (role, "current"))
    explained, k = share(f, i)
    measured = abs(float(k[0]))
    times = measured / scale.factor
    if explained > SAME and abs(times - 1.0) > CONSTANT_OFF:
        stated_as = "--torque-constant" if role == "torque" else "--motor-constant"
        found.append(
            Text(
                f"'{columns[role].name}' is {number(measured)} {scale.unit} for each A of "
                f"'{columns['current'].name}', where {stated_as} says {number(scale.factor)}: one of the two columns, "
                f"or its unit, is {number(times)} times off, and mass and friction with it if it is the {role}"
            )
        )
    return found


_NAMED = "named on the command line"
CHOSEN = "chosen"  # the reason of a role that a person chose on the page


def _converted(path: OpenedFile, role: str, column: Column, values: DriveValues) -> tuple[str, Column, str]:
    """Return role and column as typed, or as force or torque if the drive's values convert it, and the reason.

    Raises ParameterError, which names the option, for a column in percent of an unknown rated value.
    """
    if role not in ("force", "torque", "current", "command"):
        return role, column, _NAMED
    unit = path.columns.units.get(column.name, "") if column.factor is None else ""
    found = converted(role, column, unit, values)
    if found is not None:
        return found[0], found[1], Text(f"{_NAMED}; {found[2]}")
    if column.unit in RELATIVE and role != "command":
        what = asked_for(Need(column.name, "", column.unit), role)
        raise ParameterError(f"{path}: {what}")
    return role, column, _NAMED


def _remaining(
    path: OpenedFile, told: abc.Mapping[str, Column], guessed: abc.Mapping[str, Column]
) -> dict[str, Column]:
    """Return the guessed roles that remain in addition to those named by the user."""
    # a column named for one role cannot have another
    taken = {column.name for column in told.values()}
    kept = {role: column for role, column in guessed.items() if role not in told and column.name not in taken}
    if not any(role in told for role in POSITIONS):
        return kept
    # a person who named the position needs no other one, whose unit may be unknown
    return {
        role: column
        for role, column in kept.items()
        if role not in POSITIONS or column.unit or column.factor is not None or stated(path, column.name, role)
    }


def _unit_was_given(path: OpenedFile, column: Column) -> bool:
    """Return True if the user gave unit or factor of a guessed column: the file states another unit, or none."""
    own = read_name(column.name, path.columns.units.get(column.name, "")).unit
    return column.factor is not None or column.unit not in ("", unit_of(own) or own)


def _nothing_known(path: OpenedFile, guess: Guess) -> LogError:
    """Return the error for a log without a column whose role can be guessed."""
    names = ", ".join([*guess.unused, *(column.name for column in guess.mapping.values())][:20])
    return LogError(
        f"{path}: no column is known by its name, its unit or its samples; there are: {names}. Name them, as "
        f"with --set-position 'r:mm' --position 'x:mm' --force 'f:N', or give them with --channels"
    )


def _open(guess: Guess, wanted: Collection[str]) -> dict[str, str]:
    """Return, for each role, the reason why a likely column is not used: a missing factor, or cells that are not
    numbers.
    """
    reasons = {
        role: asked_for(need, role) if need.signal in RELATIVE else f"'{need.column}' needs a factor, {need.what}"
        for role, need in guess.needs.items()
    }
    for role, column in guess.mapping.items():
        if role == "current" and role not in wanted:
            reasons[role] = (
                f"'{column.name}' is a current in {column.unit or 'A'} and needs a factor to N: --torque-constant "
                "(N m/A) of the motor, or --motor-constant (N/A)"
            )
    for role, (name, why) in guess.lost.items():
        cells = " (cells that are empty, or have a decimal comma in quotes, are no numbers)" if why == "text" else ""
        reasons[role] = f"'{name}' is {why}{cells}"
    return reasons


_ACTING = ("force", "torque", "current", "command")


def no_column(path: Path | OpenedFile, log: Log, roles: Collection[str], what: str, options: str) -> LogError:
    """Return the error for a log that has no column for these roles.

    The message lists likely columns that were rejected, with the reasons, or else the roles that the log has.

    what     the missing quantity, such as `the force`
    options  the options that name a column for it
    """
    likely = {role: log.left_out[role] for role in roles if role in log.left_out}
    if likely:
        how = ""
        if any("needs a factor" in why for why in likely.values()):
            acts = any(role in _ACTING for role in likely)
            option_ = options.split()[0].rstrip(",")
            how = f"; give it with a factor{' to N' if acts else ''}, as {option_} 'column*FACTOR'"
            how += " (feeddrive force finds it)" if acts else ""
        return LogError(f"{path}: no column can be taken for {what}: {'; '.join(likely.values())}{how}")
    names = ", ".join(log.channels)
    there = f"; with a role there are: {names}" if names else ""
    return LogError(f"{path}: has no column with a usual name for {what}: name it with {options}{there}")


def requested(channels: MappingLike, path: Path) -> LogRequest:
    """Return the request to read a log with this mapping. Raise FileError if the TOML file is missing."""
    if isinstance(channels, Mapping):
        return LogRequest(path, channels)
    if not channels.exists():
        how = f"feeddrive channels {path} --out {channels} writes one to correct"
        raise FileError(f"{channels}: no such file; {how}")
    return read_request(channels, path)


def whole_log(path: Path | OpenedFile, time: Column | None, sample_time: float | None, name: str | None = None) -> Log:
    """Read all columns of a log under their original names; a named time column is converted by its unit."""
    if time is None:
        return read_log(path, sample_time=sample_time, name=name)
    # a mapping would drop all other columns, and an optional column may be missing: the first call raises if it is
    read_log(path, {"time": time}, sample_time=sample_time)
    return read_log(path, optional={"time": time}, sample_time=sample_time, name=name)


def show(guess: Guess, path: Path | OpenedFile, progress: Progress) -> None:
    """Show the guess and how to correct it."""
    progress.remark(guess.table())
    if len(guess.axes) > 1:
        progress.remark(f"- {told_of(guess)[0]}.")
    progress.remark(
        f"- These roles are guessed. To correct them: feeddrive channels {path} --out channels.toml, edit that file, "
        f"then --channels channels.toml."
    )


class ChannelsRequest(DriveValues):
    """The log whose column roles are guessed, the values of its drive, and the output file for the mapping."""

    log: LogLike = argument("A log of any known format")
    axis: str | None = option(f"axis of a log with several, as x, 0 or {ALL} for each of them", default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("sample time of a log without a clock", unit="s", default=None)
    out: Path | None = option(
        f"File for the mapping (TOML); of --axis {ALL} a file for each axis", short="-o", default=None
    )


@command(ChannelsRequest)
def channels(request: ChannelsRequest, progress: Progress) -> Outcome[Any]:
    """Guess the role of each column of a log. The outcome contains a TOML section to be edited and used for --channels.

    It also contains the peak figures of the motion, and contradictions between samples and column names. For a file of
    frequency responses, the responses are listed and, for the XML file of a commissioning tool, its controllers.
    """
    file = OpenedFile(request.log)
    out, path = request.out, file.path
    progress.step(f"reading {path}")
    if names_frequency(file):
        if out is not None:
            raise ParameterError(
                f"{path}: holds frequency responses, which need no --out: name them to identify with --motor "
                f"NAME and --load NAME"
            )
        return _responses(file)
    values = request.drive_values()
    time = None if request.time is None else Column.of(request.time)
    if request.axis == ALL:
        return _each_axis(file, time, request, values)
    guess = proposed(file, request.axis, time, request.sample_time, values)
    shown, remarks = _shown(guess), told_of(guess)
    if out is None:
        verdict = "A role that is wrong is corrected by the option of its row; --out roles.toml writes all of them"
        axis = guess.mapping.axis if len(guess.axes) > 1 else None
        then = line("identify", path, axis=axis)
        return Outcome(guess, shown, remarks, verdict, section=guess.toml(path), then=then)
    _write_beside(out, guess, path)
    files = {"Written": f"{out}; correct it and give it with --channels {out}"}
    return Outcome(guess, shown, remarks, files=files, then=line("identify", path, "--channels", out))


def _each_axis(
    file: OpenedFile, time: Column | None, request: ChannelsRequest, values: DriveValues
) -> Outcome[dict[str, Guess]]:
    """Guess the column roles of each axis of a log; write a file for each axis if requested."""
    first = proposed(file, None, time, request.sample_time, values)
    guesses = {axis: proposed(file, axis, time, request.sample_time, values) for axis in first.axes} or {"": first}
    shown: list[Table | str] = []
    remarks: list[str] = []
    files: dict[str, str | Path] = {}
    for axis, guess in guesses.items():
        shown += _shown(guess)
        remarks += [Text(f"{axis}: {remark}" if axis else remark) for remark in told_of(guess)]
        if request.out is not None:
            place = request.out.with_name(f"{request.out.stem}_{axis}{request.out.suffix}") if axis else request.out
            _write_beside(place, guess, file.path)
            files[f"Axis {axis}"] = place
    return Outcome(guesses, shown, remarks, files=files, then=line("identify", file.path, axis=ALL))


def _write_beside(out: Path, guess: Guess, path: Path) -> None:
    # a mapping beside its log names it without a folder, so that both can be moved together
    write_roles(out, guess, path.resolve() if out.parent.resolve() != path.parent.resolve() else path.name)


def _shown(guess: Guess) -> list[Table | str]:
    """Return the tables of a guess: roles, and peak figures if there is a motion."""
    return [guess.table(), *([] if guess.preview is None else [guess.preview.table()])]


def told_of(guess: Guess) -> list[str]:
    """Return remarks on a guess for the user: other axes, contradictions, doubtful units, and missing values."""
    remarks: list[str] = []
    if len(guess.axes) > 1:
        others = ", ".join(axis for axis in guess.axes if axis != guess.mapping.axis)
        remarks.append(
            f"the log holds {len(guess.axes)} axes; these are the columns of {guess.mapping.axis}. The others: --axis "
            f"{others.replace(', ', ', --axis ')}, or --axis {ALL} for each of them"
        )
    remarks += [doubt.why for doubt in guess.doubts]
    remarks += [asked_for(need, role) for role, need in guess.needs.items()]
    if guess.preview is not None:
        wrong = outside(guess.preview.frame, guess.preview.sizes)
        if wrong:
            remarks.append(
                Text(
                    f"{out_of_range(wrong, guess.preview.sizes)}: is the unit right? Give it with --unit mm for all "
                    f"columns that state none, or for one as {option_for(*_moving(guess))}"
                )
            )
        remarks.append(guess.preview.sentence())
    return remarks


def _moving(guess: Guess) -> tuple[str, Column]:
    """Return the role of the motion, and its column with an example unit for an option."""
    role = next(role for role in _MOTIONS if role in guess.mapping)
    column = guess.mapping[role]
    return role, replace(column, unit="mm" if ROLES[role].startswith("m") else "deg", factor=None)


def asked_for(need: Need, role: str) -> str:
    """Return a sentence that asks for the rated value or factor that converts a column to a force, torque or length."""
    name, what, signal = need
    if signal in RELATIVE:
        of = {"torque": "torque", "force": "force", "current": "current"}.get(role, "value")
        shown = "percent" if signal == "percent" else "per mille"
        example = {"force": "350:N", "current": "5.6:A --torque-constant 0.5"}.get(role, "3.2:Nm, or 350:N of a force")
        return (
            f"'{name}' is in {shown} of a rated {of}: give what 100 % is, as --rated {example} (of the motor's data "
            "sheet or the drive's parameter)"
        )
    return f"'{name}' needs a factor, {what}: {option_for(role, Column(name=name, factor=1.0))} with it in place of 1.0"


def proposed(
    file: Path | OpenedFile,
    axis: str | None = None,
    time: Column | None = None,
    sample_time: float | None = None,
    values: DriveValues | None = None,
    *,
    likely_time: bool = True,
    named: tuple[abc.Mapping[str, Column], abc.Mapping[str, str]] | None = None,
) -> Guess:
    """Return the guessed roles of a log's columns, as shown by page, command line and Python before a fit.

    axis    the axis to be read from a log with several axes; None: the first one
    values  rated value and constants of the drive, which convert columns in percent, A or V to forces or torques
    likely_time  True to read time stamps that are implausible for a servo loop in their likeliest unit, which the table
                 states; False to refuse them
    named   columns that the user named, by role, and the reasons to show: they replace what was guessed for their role,
            and are not guessed for another

    Raises LogError and ParameterError as `read_log` and `guess_roles` do.
    """
    file = file if isinstance(file, OpenedFile) else OpenedFile(file)
    why = _NAMED
    try:
        log = whole_log(file, time, sample_time)
    except LogError:
        likely = _likely_time(file) if likely_time and time is None and sample_time is None else None
        if likely is None:
            raise
        time, why = likely
        log = whole_log(file, time, None)
    guess = guess_roles(log, axis)
    name = next((name for name in file.columns.values if is_time(name)), None)
    if time is None and name is not None:
        own = unit_of(stated(file, name, "time")) or ""
        time, why = Column(name=name, unit=own if measures(own, "time") else ""), _why_clock(file, name, log)
    if time is not None:
        mapping = guess.mapping
        columns, reasons = {"time": time, **mapping}, {**mapping.reasons, "time": why}
        guess = replace(guess, mapping=replace(mapping, columns=columns, reasons=reasons))
    if named:
        guess = _with_named(guess, file, log, *named)
    return guess if values is None or not values.any_given else with_values(guess, log, values)


def _with_named(
    guess: Guess, file: OpenedFile, log: Log, named: abc.Mapping[str, Column], named_why: abc.Mapping[str, str]
) -> Guess:
    """Return the guess with the columns that the user named in place of the guessed ones."""
    columns = {**_remaining(file, named, guess.mapping), **named}
    every = {**guess.mapping.reasons, **named_why}
    reasons = {role: every[role] for role in columns if role in every}
    taken = {column.name for column in named.values()}
    mapping = replace(
        guess.mapping, columns={role: columns[role] for role in ROLES if role in columns}, reasons=reasons
    )
    needs = {role: need for role, need in guess.needs.items() if role not in named and need.column not in taken}
    unused = {name: why for name, why in guess.unused.items() if name not in taken}
    doubts, preview = role_doubts(log, mapping), log_preview(log, mapping, needs)
    return replace(guess, mapping=mapping, needs=needs, unused=unused, doubts=doubts, preview=preview)


# the signal that a role without a unit is in, by its name
_SIGNALS = {"current": "A"}


def with_values(guess: Guess, log: Log, values: DriveValues) -> Guess:
    """Return the guess with signals converted to force or torque by the values of the drive.

    Raises ParameterError, which names the option, if another value is missing.
    """
    columns, reasons, needs = dict(guess.mapping.columns), dict(guess.mapping.reasons), dict(guess.needs)
    forces = [columns[role] for role in ("force", "torque") if role in columns]
    in_drive_unit = any(role in columns or role in needs for role in ("current", "command"))
    # of a column of force without a unit, values of the drive say that it is in the drive's own one
    open_unit = not in_drive_unit and not any(_has_unit(column, guess.stated) for column in forces)
    if not forces or open_unit:
        for role in ("force", "torque", "current", "command"):
            column = Column(name=needs[role].column, unit=needs[role].signal) if role in needs else columns.get(role)
            found = None if column is None else converted(role, column, guess.stated.get(column.name, ""), values)
            if column is None or found is None:
                continue
            columns.pop(role, None)
            reasons.pop(role, None)
            needs.pop(role, None)
            its, changed, why = found
            columns[its], reasons[its] = changed, why
            break
    mapping = replace(guess.mapping, columns={r: columns[r] for r in ROLES if r in columns}, reasons=reasons)
    doubts = role_doubts(log, mapping)
    return replace(guess, mapping=mapping, needs=needs, doubts=doubts, preview=log_preview(log, mapping, needs))


def _has_unit(column: Column, stated_units: abc.Mapping[str, str]) -> bool:
    return bool(column.unit or column.factor is not None or stated_units.get(column.name, ""))


def _implied_unit(role: str, column: Column, values: DriveValues) -> str:
    """Return the unit that the values of the drive imply for a force or torque without one: A, %, or none."""
    if role not in ("force", "torque") or column.factor is not None:
        return ""
    if values.torque_constant or values.motor_constant:
        return "A"
    return "percent" if values.rated is not None else ""


def converted(role: str, column: Column, stated_unit: str, values: DriveValues) -> tuple[str, Column, str] | None:
    """Return role, column and reason of a signal converted to force or torque; None if the values do not convert it.

    A force or torque without a unit is in A if a motor constant is given, and in % if a rated value is: for a column in
    N nobody would give one.

    stated_unit  the unit of the column in the file

    Raises ParameterError, which names the option, if another value is missing.
    """
    unit = column.unit or stated_unit or _SIGNALS.get(role, "") or _implied_unit(role, column, values)
    own = 1.0 if column.factor is None else column.factor
    if unit in RELATIVE and values.rated is not None:
        signal, size = unit, 1.0
    elif measures(unit, "current") and (values.torque_constant or values.motor_constant):
        signal, size = "A", units.factor(unit, "A")
    elif (
        role == "command"
        and values.at_full is not None
        and (not unit or units.measure(unit)[1] == units.measure("V")[1])
    ):
        signal, size = ("V", units.factor(unit, "V")) if unit else ("pid.output", 1.0)
    else:
        return None
    scaled_by = scale_of(signal, column.name, values)
    steps = joined(", ", (what for what, _, _ in scaled_by.steps))
    factor = units.decimal(size * own * scaled_by.factor)
    return scaled_by.role, Column(name=column.name, factor=factor), Text(f"{signal} as {scaled_by.unit}: {steps}")


def _responses(file: OpenedFile) -> Outcome[Any]:
    """Tabulate the frequency responses of a file and, for a commissioning file, the data of the axis and the
    controllers.
    """
    commissioning = read_commissioning(file)
    responses = read_frfs(file) if commissioning is None else commissioning.responses
    rows = [
        [
            name,
            frf.output if frf.output != name else "not stated",
            frf.input,
            _unit_shown(frf),
            int(frf.frequency.size),
            frf.frequency[0],
            frf.frequency[-1],
            "no" if frf.coherence is None else float(np.median(frf.coherence)),
        ]
        for name, frf in responses.items()
    ]
    columns: list[str | TableColumn] = [
        "response",
        "output",
        "input",
        "unit",
        "lines",
        TableColumn("from", "Hz"),
        TableColumn("to", "Hz"),
        TableColumn("coherence, median", form=".3f"),
    ]
    if commissioning is not None and any(commissioning.stamps.values()):
        columns.append("measured")
        rows = [[*row, commissioning.stamps.get(str(row[0]), "")] for row in rows]
    tables = [Table(f"frequency responses in {file}: {len(responses)}", columns, rows)]
    if commissioning is None:
        how = "" if len(responses) == 1 else " --motor NAME --load NAME, the names of the responses of the encoders"
        return Outcome(responses, tables, verdict=f"Masses and modes: feeddrive identify {file}{how}")
    tables += [table for table in (_drive_table(commissioning), _controllers_table(commissioning)) if table.rows]
    details: list[Table | str] = []
    for title, values in read_controllers(file).items():
        listed = ("member", TableColumn("value as in the file", form="9"))
        details.append(Table(title or "all else that the file says", listed, list(values.items())))
    verdict = f"feeddrive identify {file}, then feeddrive tune {file}"
    if not commissioning.plants:
        verdict = "The file has no response of the motor's speed to its torque: measure the speed plant"
    return Outcome(responses, tables, verdict=verdict, details=details)


def _unit_shown(frf: FRF) -> str:
    """Return the unit of a response for display; a torque over its setpoint is a ratio and has the unit 1."""
    if frf.unit:
        return frf.unit
    return "1" if (frf.input, frf.output) == ("torque_setpoint", "torque") else "not stated"


def _drive_table(file: Commissioning) -> Table:
    """Return a table of the axis, clocks, band and margins in a commissioning file."""
    gain, phase = file.margins
    kind = {True: "turns", False: "linear", None: None}[file.rotary]
    motor = "a linear motor" if file.linear_motor else "a rotary motor"
    ratio = "rad/rad" if file.rotary else "m/m" if file.linear_motor else "m/rad"
    inertia = "kg" if file.linear_motor else "kg m2"
    known: list[tuple[str, Quantity | str | None]] = [
        ("axis", file.axis or None),
        ("kind", None if kind is None else f"{kind}, {motor}"),
        ("motion of the axis over that of the motor", _quantity(file.per_motor, "", "5", f" {ratio}")),
        ("sample time of the speed loop", _quantity(file.clock, "s", "6")),
        ("sample time of the position loop", _quantity(file.position_clock, "s", "6")),
        ("plant usable from", _quantity(file.usable_from, "Hz", "4")),
        ("gain margin that the tool asks for", _quantity(gain, "dB", "4")),
        ("phase margin that the tool asks for", _quantity(phase, "deg", "4")),
        ("total inertia by the tool", _quantity(file.inertia, inertia, "4")),
        ("inertia of the motor", _quantity(file.motor_inertia, inertia, "4")),
        ("first zero by the tool", _quantity(file.antiresonance, "Hz", "4")),
        ("position gain", None if file.Kv is None else Text(f"{Quantity(file.Kv):5} 1000/min")),
    ]
    return Table("the axis", ["what", "value"], [[what, value] for what, value in known if value is not None])


def _quantity(value: float | None, unit: str, form: str, after: str = "") -> Text | None:
    return None if value is None else Text(f"{Quantity(value, unit, form=form)}{after}")


def _controllers_table(file: Commissioning) -> Table:
    """Return a table of the speed controllers in a commissioning file; the last one is active."""
    gain = "N s/m" if file.linear_motor else "N m s/rad"
    rows = [
        [
            "today" if controller is file.today else f"before {i + 1}",
            Quantity(controller.Kp, gain, form="5"),
            None if controller.Tn is None else Quantity(controller.Tn, "s", form="5"),
            "; ".join(map(_filter_text, controller.filters)) or "-",
            controller.stamp,
        ]
        for i, controller in enumerate(file.controllers)
    ]
    heads = ["speed controller", TableColumn("Kp", gain), TableColumn("Tn", "s"), "filters that are on", "stored"]
    return Table("speed controllers", heads, rows)


def _filter_text(block: Filter) -> str:
    """Return a short description of a filter: `low_pass2 1999 Hz, 0.7`."""
    return Text(
        f"{block.kind} "
        + ", ".join(f"{Quantity(value, tree.declaration(block, name).unit):4}" for name, value in tree.leaves(block))
    )


def _why_clock(file: OpenedFile, name: str, log: Log) -> str:
    """Return the reason why a column with a usual name is the time, and the assumed unit."""
    if "time" in log.provenance:
        return Text(f"a usual name; {log.provenance['time']}")
    step = Quantity(log.sample_time, "s")
    return (
        "a usual name" if stated(file, name, "time") else Text(f"a usual name; no unit is stated, s is taken: {step}")
    )


def _likely_time(file: OpenedFile) -> tuple[Column, str] | None:
    """Return the time column in its likeliest unit, and the reason; None if its unit is stated or none is plausible."""
    name = next((name for name in file.columns.values if is_time(name)), None)
    if name is None or name in file.columns.units or unit_at_the_end(name, "time"):
        return None
    steps = np.diff(file.columns.values[name])
    step = float(np.median(steps)) if steps.size else 0.0
    units_ = time_units(step) if np.isfinite(step) and step > 0.0 else []
    # s is the default, in which the log was already rejected: its error stands
    if not units_ or units_[0][0] == "s":
        return None
    other = joined("", (f", in {unit} {Quantity(size, 's')}" for unit, size in units_[1:]))
    unit, size = units_[0]
    why = Text(f"no unit is stated; in {unit} the step is {Quantity(size, 's')}{other}: correct it if wrong")
    return Column(name=name, unit=unit), why
