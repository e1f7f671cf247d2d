"""The roles of a log's columns: guessed from names, units and samples, or stated in a mapping.

`guess_roles` guesses the role of each channel; the guess can be inspected as a table or as TOML.

    guess = guess_roles(read_log("run.csv"))
    print(guess)                                  # role, channel, unit, reason, and the option that corrects it
    print(guess.doubts)                           # where the samples contradict the names
    print(guess.toml("run.csv"))                  # [log] and [log.channels] for a job, or for `read_request`
    log = read_log("run.csv", guess.mapping)      # the same `Mapping` as in the TOML text

Names and units are interpreted by `names`.  The samples decide if names are missing (rows without headers) or ambiguous
(two positions), and they reveal wrong names (`role_checks`).  In a log of several axes, roles are assigned to the
channels of one axis.  A guess is used only on the user's request.

`Mapping` assigns roles to a log's columns, in the same form for the studio, a channels file, the command line and
Python:

mapping = Mapping({"position_load": Column(name="x", unit="mm"), "force": Column(name="f", factor=12.0)})
log = read_log("run.csv", mapping)
Mapping.read(mapping.text("run.csv")) == mapping
"""

from __future__ import annotations

from collections import abc
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from feeddrive.files.atomic_io import write_whole
from feeddrive.files.columns import OWN_UNIT, ROLES, Column, unit_at_the_end
from feeddrive.files.log import Log
from feeddrive.files.names import RELATIVE, NameReading, axes_of, read_name, unit_in_name
from feeddrive.files.preview import Preview, preview_of
from feeddrive.files.role_checks import RoleDoubt, doubts_of, option_for, roles_by_shape
from feeddrive.files.section import Section, file_name, named, read_section, text
from feeddrive.files.toml_file import parse_toml, quoted
from feeddrive.identification import shapes
from feeddrive.language import units
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column as TableColumn
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text

# roles of a quantity: as a set value, at the motor, at the load, and without a side
_ROLES: abc.Mapping[str, tuple[str, str, str, str]] = {
    "position": ("setpoint_position", "position_motor", "position_load", "position_load"),
    "velocity": ("setpoint_velocity", "velocity_motor", "velocity_load", "velocity_load"),
    "acceleration": ("", "", "acceleration_load", "acceleration_load"),
    "angle": ("setpoint_angle", "angle_motor", "angle_load", "angle_motor"),
    "speed": ("setpoint_speed", "speed_motor", "speed_load", "speed_motor"),
    "force": ("force", "force", "load_force", "force"),
    "torque": ("command", "torque", "torque", "torque"),
    "current": ("command", "current", "current", "current"),
    "command": ("command", "command", "command", "command"),
    "excitation": ("excitation", "excitation", "excitation", "excitation"),
}
# the other encoder, for a second channel of the same kind without a side
_OTHER = {
    "position_load": "position_motor",
    "velocity_load": "velocity_motor",
    "angle_motor": "angle_load",
    "speed_motor": "speed_load",
}


class Need(NamedTuple):
    """A channel whose role is clear, but whose unit requires a factor.

    what    meaning of the factor: `N m per percent: the rated value / 100`
    signal  the unit of the numbers: percent, permille, A, or the name of a count
    """

    column: str
    what: str
    signal: str


@dataclass(frozen=True)
class ProposedColumn:
    """The role proposed for one column of a log, as a row of a table.

    role, unit, factor  empty or None for a column without a role
    stated   unit stated in the file; empty if there is none
    why      reason for the role, or for the lack of one, in one line
    option   command-line option that assigns this role, to be edited if the guess is wrong
    asks     input without which the column cannot be used, `rated` or `factor`; empty if none is missing
    doubt    the contradiction between the samples and the role; empty if there is none
    """

    column: str
    role: str
    unit: str
    factor: float | None
    stated: str
    why: str
    option: str
    asks: str = ""
    doubt: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Guess(Result):
    """The guessed roles of a log's channels as a `mapping` for `read_log`, with reasons, and the unresolved channels.

    `needs` lists, by role, a channel whose role is clear but whose unit (percent of a rated torque, counts) requires a
    factor, and the meaning of this factor; `unused` lists channels without a role, with the reason; `lost` lists, by
    role, a column that would have the role if it contained numbers, and what it contains instead.

    axes    the axes of the log, as named in its columns; the guess is for `mapping.axis`
    doubts  contradictions between the samples and the roles
    stated  the unit of each column in the file
    preview peak figures by which the user can check the guess; None if there is no position
    """

    name: str
    mapping: Mapping
    needs: abc.Mapping[str, Need]
    unused: abc.Mapping[str, str]
    lost: abc.Mapping[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])
    axes: tuple[str, ...] = ()
    doubts: tuple[RoleDoubt, ...] = ()
    stated: abc.Mapping[str, str] = field(default_factory=dict[str, str])
    preview: Preview | None = None

    def proposed(self) -> tuple[ProposedColumn, ...]:
        """Return a row for each column: those with a role, those that need a factor, and the unused ones."""
        against: dict[str, str] = {}
        for doubt in self.doubts:
            against.setdefault(doubt.roles[0], doubt.why)
        rows = [
            ProposedColumn(
                column.name,
                role,
                column.unit,
                column.factor,
                self.stated.get(column.name, ""),
                self.mapping.reasons.get(role, ""),
                option_for(role, column),
                doubt=against.get(role, ""),
            )
            for role, column in self.mapping.items()
        ]
        for role, (name, what, signal) in self.needs.items():
            relative = signal in RELATIVE or signal == "A"
            give = "--rated" if signal in RELATIVE else option_for(role, Column(name=f"{name}*FACTOR"))
            why = f"needs a factor: {what}"
            asks = "rated" if relative else "factor"
            rows.append(ProposedColumn(name, role, "", None, self.stated.get(name, signal), why, give, asks))
        rows += [
            ProposedColumn(name, "", "", None, self.stated.get(name, ""), why, "") for name, why in self.unused.items()
        ]
        return tuple(rows)

    def table(self) -> Table:
        """Tabulate the role, channel, unit, reason and option of all columns, those without a role last."""
        rows = [
            [
                "-" if not row.role else f"{row.role} ?" if row.asks else row.role,
                row.column,
                "" if row.asks or not row.role else row.unit or ROLES[row.role] or "own",
                row.why,
                row.option,
            ]
            for row in self.proposed()
        ]
        of = f", axis {self.mapping.axis} of {', '.join(self.axes)}" if len(self.axes) > 1 else ""
        heads = ["role", "channel", "unit", TableColumn("why", sentences=True), "to correct, edit"]
        return Table(f"{self.name}: roles guessed by names, units and samples{of}", heads, rows)

    def toml(self, file: str | Path = "") -> str:
        """Return the sections [log] and [log.channels], with channels that need a factor in comments."""
        open_ = [
            f"# {entry(role, Column(name=need.column, factor=1.0))}  # {need.what}\n"
            for role, need in self.needs.items()
            if role not in self.mapping
        ]
        return "".join([self.mapping.text(str(file) or self.name), *open_])


def axes_in(names: abc.Collection[str], units_: abc.Mapping[str, str]) -> tuple[str, ...]:
    """Return the axes in the channel names, in the order of the columns; axes without a motion only if all lack one."""
    axes = axes_of(names)
    read = [read_name(name, units_.get(name, ""), axes[name]) for name in names]
    all_ = dict.fromkeys(reading.axis for reading in read if reading.role_like and reading.axis)
    moving = {reading.axis for reading in read if reading.quantity in _MOTION}
    # a group without a motion, such as that of a program, is not an axis
    return tuple(axis for axis in all_ if axis in moving) or tuple(all_)


def nameless_in(names: abc.Collection[str], units_: abc.Mapping[str, str], axis: str = "") -> tuple[str, ...]:
    """Return the channels whose names and units suggest no role, except those that name an axis other than `axis`."""
    axes = axes_of(names)
    read = {name: read_name(name, units_.get(name, ""), axes[name]) for name in names}
    return tuple(
        name
        for name, reading in read.items()
        if reading.axis in ("", axis) and not (reading.exact or _role(reading) or reading.why)
    )


def axis_called(name: str, asked: str, axes: abc.Collection[str]) -> str:
    """Return the axis that the user named, ignoring case; `x` also matches `x1` if no other axis starts with x.

    Raises ParameterError for an axis that no channel names.
    """
    wanted = asked.lower()
    if wanted in axes:
        return wanted
    beginning = [axis for axis in axes if axis.rstrip("0123456789") == wanted]
    if len(beginning) == 1:
        return beginning[0]
    if not axes:
        raise ParameterError(f"{name}: no channel names an axis, so that the log is of one: leave --axis {asked} out")
    raise ParameterError(
        f"{name}: no channel names the axis '{asked}'; there are: {', '.join(axes)}{nearest(wanted, axes)}"
    )


def guess_roles(log: Log, axis: str | None = None) -> Guess:
    """Guess the roles of the channels of a log that was read without a mapping.

    axis  the axis of a log with several axes: `x`, or the number of a joint; default: the first one

    Raises ParameterError for an axis that no channel names.
    """
    named_axes = axes_of(log.channels)
    read = {name: read_name(name, log.units.get(name, ""), named_axes[name]) for name in log.channels}
    axes = axes_in(log.channels, log.units)
    wanted = axis_called(log.name, axis, axes) if axis is not None else axes[0] if axes else ""
    taking = _Taking(log, wanted, {}, {}, {}, {})
    twins: list[tuple[str, NameReading, str]] = []
    # exact names first, then clear ones, and last possible ones
    for name, reading in sorted(read.items(), key=lambda item: _order(item[0], item[1])):
        role = reading.exact or _role(reading)
        if reading.axis not in ("", wanted):
            taking.unused[name] = f"of axis {reading.axis}, not {wanted}"
        elif not role:
            taking.unused[name] = reading.why or NAMELESS
        elif role in taking.mapping or role in taking.needs:
            twins.append((name, reading, role))
        else:
            taking.take(name, reading, role)
    # once the force is known, which helps to tell them apart
    for name, reading, role in twins:
        taking.again(name, reading, role)
    taking.by_shape([name for name, why in taking.unused.items() if why == NAMELESS])
    lost: dict[str, tuple[str, str]] = {}
    for name, why in log.left_out.items():
        reading = read_name(name, unit_in_name(name))
        role = reading.exact or _role(reading)
        if (
            role
            and role != "time"
            and role not in (*taking.mapping, *taking.needs, *lost)
            and reading.axis in ("", wanted or reading.axis)
        ):
            lost[role], taking.unused[name] = (name, why), f"like {role}, but {why}"
    # A sample time given by the user is not in the file, and is needed to read it again.
    step = log.sample_time if log.provenance.get("clock") == "given" else None
    columns = {role: taking.mapping[role] for role in ROLES if role in taking.mapping}
    mapping = Mapping(columns, {}, taking.reasons, wanted, step)
    own = [name for name in taking.unused if named_axes.get(name, "") in ("", wanted)]
    doubts = role_doubts(log, mapping, [name for name in own if name in log.channels and not read[name].why])
    stated = {name: unit for name, unit in log.units.items() if unit}
    preview = log_preview(log, mapping, taking.needs)
    return Guess(log.name, mapping, taking.needs, taking.unused, lost, axes, doubts, stated, preview)


def role_doubts(log: Log, mapping: abc.Mapping[str, Column], others: abc.Collection[str] = ()) -> tuple[RoleDoubt, ...]:
    """Return the contradictions between the samples of a log, read without a mapping, and the roles of its columns.

    others  channels without a role, one of which may be the intended force
    """
    used = {column.name for column in mapping.values()}
    rest = {name: log[name] for name in others if name not in used}
    return doubts_of(_by_role(log, mapping), mapping, log.sample_time, rest)


def log_preview(
    log: Log, mapping: abc.Mapping[str, Column], needs: abc.Mapping[str, Need] | None = None
) -> Preview | None:
    """Return the peak figures of a log that was read without a mapping; None if no column is a position.

    needs  channels whose unit still requires a factor; a force in percent is shown in percent
    """
    needs = {role: need for role, need in (needs or {}).items() if role not in mapping and need.column in log.channels}
    columns = {**mapping, **{role: Column(name=need.column) for role, need in needs.items()}}
    channels = {**_by_role(log, mapping), **{role: log[need.column] for role, need in needs.items()}}
    # a position in counts has no travel in mm
    channels = {role: values for role, values in channels.items() if role not in needs or role in _ACTING}
    signals = {**log.units, **{need.column: need.signal for need in needs.values()}}
    return preview_of(log.name, channels, columns, log.sample_time, signals)


def _by_role(log: Log, mapping: abc.Mapping[str, Column]) -> dict[str, np.ndarray]:
    """Return the channels of a log, read without a mapping, by role and in the unit of each role."""
    channels: dict[str, np.ndarray] = {}
    for role, column in mapping.items():
        values = log.channels.get(column.name)
        if values is None or role == "time":
            continue
        scale = column.scale(role)
        if scale is None and role not in OWN_UNIT:
            unit = log.units.get(column.name, "") or unit_at_the_end(column.name, role)
            scale = units.factor(unit, ROLES[role]) if unit and measures(unit, role) else 1.0
        channels[role] = values if scale in (None, 1.0) else scale * values
    return channels


def _order(name: str, reading: NameReading) -> tuple[bool, ...]:
    """Return a sort key by which the clearest names come first."""
    # of two currents or forces the measured one; both of them have the same role if neither is a set value
    feedback = reading.quantity in ("current", "torque") and "feedback" not in name.lower()
    return (
        name not in ROLES,
        not reading.exact,
        reading.is_assumed,
        reading.is_weak,
        not reading.side,
        feedback,
    )


@dataclass(frozen=True)
class _Taking:
    """The state of the role assignment, which proceeds from clear names to vague ones."""

    log: Log
    axis: str
    mapping: dict[str, Column]
    reasons: dict[str, str]
    needs: dict[str, Need]
    unused: dict[str, str]

    def take(self, name: str, reading: NameReading, role: str) -> None:
        """Assign a role to a channel, or record the factor that its unit requires."""
        if role in OWN_UNIT:
            self.mapping[role] = Column(name=name, unit=reading.unit if _known(reading.unit) else "")
        elif not reading.unit:
            self.mapping[role] = Column(name=name)
        elif measures(reading.unit, role):
            self.mapping[role] = Column(name=name, unit=reading.unit)
        else:
            parts = {"percent": "100", "permille": "1000"}.get(reading.unit)
            rated = "" if parts is None else f": the rated value / {parts}"
            self.needs[role] = Need(name, f"{ROLES[role]} per {reading.unit}{rated}", reading.unit)
            return
        stated = reading.unit or role in OWN_UNIT or unit_at_the_end(name, role)
        self.reasons[role] = reading.why + ("" if stated else f"; no unit is stated, {ROLES[role]} is taken")

    def again(self, name: str, reading: NameReading, role: str) -> None:
        """Assign a channel as setpoint or second encoder if its role is already taken, or record why it is unused."""
        other = _OTHER.get(role, "")
        taken = self.mapping[role].name if role in self.mapping else self.needs[role].column
        # Only a second channel without a side can be the other encoder; a third one cannot be assigned.
        first, second, T = self.log[taken], self.log[name], self.log.sample_time
        long = self.log.time.size >= shapes.LEAST_ROWS and np.ptp(first) > 0.0 and np.ptp(second) > 0.0
        # Beside channels of an axis, one without an axis is of the same one only if its samples say so.
        foreign = bool(self.axis) and not reading.axis and not long
        if reading.side or not other or other in self.mapping or other in self.needs or foreign:
            self.unused[name] = f"like {role}, which is '{taken}'"
            return
        like = shapes.likeness(first, second, T)
        if long and like.explained < shapes.SAME:
            share = Quantity(like.explained, "share", form="2")
            self.unused[name] = Text(
                f"like {role}, which is '{taken}', but it moves otherwise (alike to {share}): of another axis, or "
                "another quantity"
            )
            return
        setpoint = _SETPOINT_OF.get(role, "")
        force = next((self._signal(its) for its in _ACTING if its in self.mapping or its in self.needs), None)
        first_is_goal = shapes.order(first, second, force, T) if long and abs(like.gain - 1.0) < _SCALED else 0.0
        if setpoint and setpoint not in self.mapping and abs(first_is_goal) == 1.0:
            goal, actual = (taken, name) if first_is_goal > 0.0 else (name, taken)
            self._as_setpoint(name, reading, role, setpoint, goal, actual)
            return
        motor, load = (other, role) if role.endswith("_load") else (role, other)
        # the first in the file is assumed to be the motor's, unless the samples contradict this
        if role in self.mapping:
            self.mapping[motor] = self.mapping.pop(role)
            del self.reasons[role]
            self.reasons[motor] = "the first of two such channels"
        else:
            self.needs[motor] = self.needs.pop(role)
        self.take(name, reading, load)
        if load in self.mapping:
            self.reasons[load] = "the second of two such channels"
        if long and motor in self.mapping and load in self.mapping:
            first = shapes.ahead(self.log[self.mapping[motor].name], self.log[self.mapping[load].name], T)
            if abs(first) > shapes.SURE:
                if first < 0.0:
                    self.mapping[motor], self.mapping[load] = self.mapping[load], self.mapping[motor]
                self.reasons[motor] = "of two such channels the one that runs ahead while the axis accelerates"
                self.reasons[load] = "of two such channels the one that trails while the axis accelerates"

    def _as_setpoint(self, name: str, reading: NameReading, role: str, setpoint: str, goal: str, actual: str) -> None:
        """Assign setpoint and actual position to two channels, one of which follows the other."""
        column = self.mapping.pop(role, None)
        need = self.needs.pop(role, None)
        self.reasons.pop(role, None)
        for channel, its in ((goal, setpoint), (actual, role)):
            if channel == name:
                self.take(name, reading, its)
            elif column is not None:
                self.mapping[its] = column
            elif need is not None:
                self.needs[its] = need
            if its in self.mapping:
                what = f"leads '{actual}'" if channel == goal else f"follows '{goal}'"
                self.reasons[its] = f"of two such channels the one that {what}, by its samples"

    def _signal(self, role: str) -> np.ndarray:
        return self.log[self.mapping[role].name if role in self.mapping else self.needs[role].column]

    def by_shape(self, nameless: abc.Collection[str]) -> None:
        """Assign missing roles to channels with uninformative names, from their samples."""
        places = [role for role in _PLACES if role in self.mapping or role in self.needs]
        acting = [role for role in _ACTING if role in self.mapping or role in self.needs]
        if not nameless or (places and acting):
            return
        named = {
            role: self.mapping[role].name if role in self.mapping else self.needs[role].column
            for role in (*places, *acting, "setpoint_position")
            if role in self.mapping or role in self.needs
        }
        known = {role: (name, self.log[name]) for role, name in named.items()}
        found = roles_by_shape({name: self.log[name] for name in nameless}, self.log.sample_time, known)
        for role, (name, why) in found.roles.items():
            if role in self.mapping or role in self.needs:
                continue
            unit = self.log.units.get(name, "")
            # a stated unit that no quantity has would refuse the role; as the drive's own unit it is kept
            self.mapping[role] = Column(name=name, unit=unit if _known(unit) and role in OWN_UNIT else "")
            assumed = "" if role in OWN_UNIT else f"; no unit is stated, {ROLES[role]} is taken"
            self.reasons[role] = Text(f"{why}{assumed}")
            del self.unused[name]
        self.unused.update({name: why for name, why in found.unused.items() if name in self.unused})


NAMELESS = "not like any known name"
_SCALED = 0.5  # by which the motions of setpoint and position may differ: encoders in other units differ by more
_PLACES = ("position_load", "position_motor", "angle_load", "angle_motor")
_ACTING = ("force", "torque", "current", "command")
_MOTION = ("position", "angle", "velocity", "speed")
_SETPOINT_OF = {
    "position_load": "setpoint_position",
    "angle_motor": "setpoint_angle",
    "velocity_load": "setpoint_velocity",
    "speed_motor": "setpoint_speed",
}


def _role(reading: NameReading) -> str:
    """Return the role of a channel from its quantity, its kind (set or measured) and its side (motor or load)."""
    if reading.quantity not in _ROLES:
        return ""
    place = 0 if reading.is_set else {"motor": 1, "load": 2}.get(reading.side, 3)
    return _ROLES[reading.quantity][place]


def _known(unit: str) -> bool:
    try:
        units.measure(unit)
    except ParameterError:
        return False
    return bool(unit)


def measures(unit: str, role: str) -> bool:
    """Return True if a unit measures the quantity of a role."""
    try:
        units.factor(unit, ROLES[role])
    except ParameterError:
        return False
    return True


def write_roles(path: str | Path, guess: Guess, file: str | Path = "") -> None:
    """Write the guess as TOML for manual correction. Raises FileError if it cannot be written."""
    write_whole(path, guess.toml(file))


_LONGEST = 1e9  # s, of a sample time


@dataclass(frozen=True)
class Mapping(abc.Mapping[str, Column]):
    """The columns of a log by role, as accepted by `read_log`.

    columns      required columns by role
    optional     columns by role that may be missing
    reasons      the reason for each assignment, by role
    axis         axis name used in the columns of a log with several axes; empty for a log of one axis
    sample_time  sample time of a log without a time column or with rounded stamps, s

    Raises ParameterError for an invalid role, unit, factor or sample time.
    """

    columns: abc.Mapping[str, Column]
    optional: abc.Mapping[str, Column] = field(default_factory=dict[str, Column])
    reasons: abc.Mapping[str, str] = field(default_factory=dict[str, str])
    axis: str = ""
    sample_time: float | None = None

    def __post_init__(self) -> None:
        for name in ("columns", "optional"):
            checked = {role: column.checked(role) for role, column in getattr(self, name).items()}
            object.__setattr__(self, name, checked)
        reasons = {role: why for role, why in self.reasons.items() if why}
        for role in reasons.keys() - {*self.columns, *self.optional}:
            raise ParameterError(f"a reason is given for {role}, which no column has")
        object.__setattr__(self, "reasons", reasons)
        if self.sample_time is not None:
            if not 0.0 < self.sample_time < _LONGEST:
                raise ParameterError(
                    f"sample_time = {Quantity(self.sample_time, 's'):6 SI} must be > 0 s and < "
                    f"{Quantity(_LONGEST, 's'):6 SI}"
                )
            object.__setattr__(self, "sample_time", float(self.sample_time))

    def __getitem__(self, role: str) -> Column:
        return self.columns[role]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def text(self, file: str | Path = "") -> str:
        """Return the TOML sections [log], [log.channels] and [log.optional], as in a job.

        file  name of the log; if it is included, it need not be given when the text is read
        """
        lines = ["[log]"]
        if str(file):
            lines.append(f"file = {quoted(str(file))}")
        if self.axis:
            lines.append(f"axis = {quoted(self.axis)}")
        if self.sample_time is not None:
            lines.append(f"sample_time = {self.sample_time!r}")
        for name, columns in (("channels", self.columns), ("optional", self.optional)):
            if columns or name == "channels":
                lines += ["", f"[log.{name}]"]
                lines += [entry(role, column, self.reasons.get(role, "")) for role, column in columns.items()]
        return "\n".join(lines) + "\n"

    @staticmethod
    def read(text: str, name: str = "mapping") -> Mapping:
        """Parse the text of a mapping.

        name  file name for error messages

        Raises FileError or ParameterError with file, line, key and remedy.
        """
        return read_section(LogSection, parse_toml(text, name).root().section("log"), besides=("file",)).mapping


MappingLike: TypeAlias = Path | Mapping
"""A file with a section [log.channels], or a `Mapping`."""


def entry(role: str, column: Column, reason: str = "") -> str:
    """Return the line of a column in the section [log.channels]."""
    words = [f"column = {quoted(column.name)}"]
    if column.unit:
        words.append(f"unit = {quoted(column.unit)}")
    if column.factor is not None:
        words.append(f"factor = {float(column.factor)!r}")
    if reason:
        words.append(f"reason = {quoted(reason)}")
    return f"{role} = {{ {', '.join(words)} }}"


class ColumnSection(Section):
    """A column of a log, and the conversion of its numbers to the unit of its role."""

    shorthand: ClassVar[str] = "column"
    wanted: ClassVar[str] = (
        'the name of a column, or { column = "name", unit = "mm" }, or { column = "name", factor = 0.001 }'
    )

    column: str = text("name of the column")
    unit: str = text("unit of the numbers; none: as the file states it, or SI", default="")
    factor: Number | None = parameter(
        "", "number · factor is in the unit, or without one in the SI unit of the role", default=None
    )
    reason: str = text("why the column has the role", default="")

    def of(self, role: str) -> Column:
        """Return the column for a role. Raises ParameterError for an invalid unit or factor."""
        try:
            return Column(name=self.column, unit=self.unit, factor=self.factor).checked(role)
        except ParameterError as error:
            raise self.error(f"{self.dotted()}: {error}") from None


class LogSection(Section):
    """A measured log, and the roles of its columns."""

    file: str | None = file_name("name of the log, beside this file", default=None, example='"run.csv"')
    skip_samples: int = choice("samples at the start that do not count", least=0, most=2**53 - 1, default=0)
    sample_time: Number | None = parameter(
        "s",
        "sample time of a log without a column of time, or whose stamps are rounded",
        above=0,
        below=_LONGEST,
        default=None,
    )
    axis: str = text("axis of the columns, as they name it, in a log of several axes", default="")
    channels: abc.Mapping[str, ColumnSection] = named("columns by role", names=tuple(ROLES))
    optional: abc.Mapping[str, ColumnSection] = named("the same for columns that may be missing", names=tuple(ROLES))

    @property
    def mapping(self) -> Mapping:
        """The columns by role. Raises ParameterError for a unit or factor that is invalid for its role."""
        columns, optional = (
            {role: column.of(role) for role, column in sections.items()} for sections in (self.channels, self.optional)
        )
        reasons = {role: column.reason for role, column in (*self.channels.items(), *self.optional.items())}
        return Mapping(columns, optional, reasons, self.axis, self.sample_time)


class ChannelsSection(Section, kind="channels"):
    """The roles of a log's columns, in a file written by `feeddrive channels` or in a job with a log."""

    is_open: ClassVar[bool] = True

    log: LogSection = part("the log and its columns")
