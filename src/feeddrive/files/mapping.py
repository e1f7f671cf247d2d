"""The roles of a log's columns: guessed from names and units, or stated in a mapping.

`guess_roles` guesses the role of each channel from its name and unit; the guess can be inspected as a table or as TOML.

    guess = guess_roles(read_log("run.csv"))
    print(guess)                                  # role, channel, unit, reason
    print(guess.toml("run.csv"))                  # [log] and [log.channels] for a job, or for `read_request`
    log = read_log("run.csv", guess.mapping)      # the same `Mapping` as in the TOML text

A name may state the quantity, whether the value is set or measured, whether it belongs to the motor or the load, and
the axis.  It is split into words at punctuation, digits and capitals: `joint.0.motor-pos-cmd` is joint, 0, motor, pos,
cmd.  A known unit determines the quantity; otherwise the words do.  A guess is used only on the user's request.

`Mapping` assigns roles to a log's columns, in the same form for the studio, a channels file, the command line and
Python:

mapping = Mapping({"position_load": Column(name="x", unit="mm"), "force": Column(name="f", factor=12.0)})
log = read_log("run.csv", mapping)
Mapping.read(mapping.text("run.csv")) == mapping
"""

from __future__ import annotations

import re
from collections import abc
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, TypeAlias

from feeddrive.files.atomic_io import write_whole
from feeddrive.files.columns import COUNTS, OWN_UNIT, ROLES, Column, unit_at_the_end, unit_of
from feeddrive.files.log import Log
from feeddrive.files.section import Section, file_name, named, read_section, text
from feeddrive.files.toml_file import parse_toml, quoted
from feeddrive.language import units
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table

_SET = {
    "cmd",
    "command",
    "commanded",
    "set",
    "setpoint",
    "ref",
    "reference",
    "demand",
    "target",
    "soll",
    "sollwert",
    "desired",
    "des",
    "setpos",
    "setvelo",
    "refx",
    "refy",
}
_MOTOR = {"motor", "mot", "mtr", "rotor", "enc1", "encoder1", "rotary", "mx"}
_LOAD = {"load", "table", "linear", "scale", "slide", "arm", "enc2", "encoder2", "tool", "last", "tisch"}
_OUTER = {"load", "cutting", "process", "external", "outer", "disturbance", "kistler", "dynamometer"}
_ERROR = {
    "error",
    "err",
    "ferror",
    "diff",
    "difference",
    "deviation",
    "posdiff",
    "lag",
    "schleppabstand",
    "schleppfehler",
    "regelabweichung",
    "abweichung",
    "fehler",
}
_MEASURED = {"fb", "feedback", "act", "actual", "ist", "measured", "meas"}
_WORDS = {
    "excitation": {"excitation", "exc", "dither", "prbs", "chirp", "multisine", "injection", "perturbation"},
    "torque": {"torque", "trq", "moment", "drehmoment", "tau"},
    "current": {"current", "curr", "cur", "strom", "iq", "isq"},
    "force": {"force", "kraft"},
    "acceleration": {"acceleration", "acc", "accel", "beschleunigung"},
    "speed": {"omega", "rpm", "drehzahl"},
    "velocity": {"velocity", "vel", "velo", "speed", "geschwindigkeit"},
    "angle": {"theta", "phi", "angle", "winkel"},
    "position": {"position", "pos", "lage", "weg", "stroke", "displacement", "setpos", "actpos"},
    "command": {"command", "output", "vir", "voltage", "control", "ctrl", "dac", "u"},
}
# complete names with a known role
_EXACT = {
    "qg": "setpoint_position",
    "reference": "setpoint_position",
    "xr": "setpoint_position",
    "qm": "position_load",
    "vir": "command",
    "set_position": "setpoint_position",
    "reading_load": "position_load",
    "reading_motor": "position_motor",
}
_QUANTITY_OF_UNIT = {
    "m": "position",
    "m/s": "velocity",
    "m/s2": "acceleration",
    "N": "force",
    "N m": "torque",
    "A": "current",
    "V": "command",
    "rad": "angle",
    "rad/s": "speed",
}
# German compounds with set or actual before or behind: Sollposition, Lageistwert
_BEHIND = re.compile(r"(soll|ist)wert")
_BEFORE = re.compile(
    r"(?<![a-zäöü])(soll|ist)(?=position|lage|weg|winkel|geschwindigkeit|drehzahl|beschleunigung|kraft|drehmoment|moment|strom)",
    re.IGNORECASE,
)
_AXIS = re.compile(r"(?:joint|axis|achse|ax|j)[ ._-]*([0-9]{1,2}|[xyzabc])(?![a-z])", re.IGNORECASE)
_SHORT = re.compile(r"(u|v|i|iq|f|pos|vel)_?([xyz])")


@dataclass(frozen=True)
class NameReading:
    """The meaning of a channel name. `exact` is the role if the name itself is the name of a role."""

    quantity: str = ""
    is_set: bool = False
    side: str = ""
    axis: str = ""
    unit: str = ""
    exact: str = ""
    why: str = ""

    @property
    def is_weak(self) -> bool:
        """True for a command whose name marks it as a set value; others, such as `output`, are preferred to it."""
        return self.quantity == "command" and self.is_set

    @property
    def role_like(self) -> bool:
        """True if the name suggests a role for its channel."""
        return bool(self.quantity or self.exact)


def words_of(name: str) -> list[str]:
    """Split a name into words, in lower case."""
    cut = _BEFORE.sub(r"\1 ", _BEHIND.sub(r" \1", re.sub(r"([a-zäöü])([A-Z])", r"\1 \2", name)))
    return [word.lower() for word in re.findall(r"[A-Za-zÄÖÜäöü]+[0-9]?|[0-9]+", cut)]


def read_name(name: str, unit: str) -> NameReading:
    """Interpret the name and the unit of a channel."""
    words = words_of(name)
    unit, bare = (unit, words) if unit else _unit_at_the_end(name, words)
    axis = _axis(name, bare)
    if name in ROLES:
        return NameReading(exact=name, unit=unit, why="its name is a role")
    if name.lower() in _EXACT:
        return NameReading(exact=_EXACT[name.lower()], axis=axis, unit=unit, why="a usual name")
    # An error has the unit of a position, and would otherwise take its role.
    if _ERROR & set(bare) or bare[-1:] == ["f", "error"]:
        return NameReading(axis=axis, unit=unit, why="a difference, which follows from others")
    is_set = bool(_SET & set(bare))
    side = "motor" if _MOTOR & set(bare) else "load" if _LOAD & set(bare) else ""
    by_words = _by_words(name, bare)
    by_unit = _by_unit(unit)
    # A unit is the stronger statement; words are often abbreviated or generic.
    quantity = by_unit or by_words
    # A signal in V may stand for a scaled current or torque, which its name then states.
    if by_unit == "command" and by_words in ("current", "torque", "excitation"):
        quantity = by_words
    if (
        quantity in ("", "command")
        and axis
        and by_words != "command"
        and (is_set or _MEASURED & set(bare) or bare == [axis])
    ):
        # x, x_cmd and y_fb are positions of their axes.
        quantity = "position"
    if bare[:1] == ["pid"] and "output" not in bare and {"command", "feedback"} & set(bare):
        # LinuxCNC's pid.x.command and pid.x.feedback are the positions that the loop compares.
        quantity = "position"
    if by_words == "excitation":
        quantity, is_set = "excitation", False
    if quantity == "force":
        side = "load" if _OUTER & set(bare) else "motor"
    if unit == "percent" and by_words not in ("torque", "current"):
        quantity = "command" if by_words in ("command", "force") or is_set else ""
    if not quantity:
        return NameReading(axis=axis, unit=unit)
    why = f"{'set ' if is_set else ''}{quantity}{' of the ' + side if side and quantity != 'force' else ''}"
    return NameReading(quantity, is_set, side, axis, unit, "", f"{why}, by its {'unit' if by_unit else 'name'}")


def unit_in_name(name: str) -> str:
    """Return the unit suffix of a name, as in `pos_act_mm`, `force_N`; a single letter must match the quantity.

    `u_in` is an input, not inches.
    """
    unit = _unit_at_the_end(name, [])[0]
    if unit:
        return unit
    last = name.rpartition("_")[2]
    return last if last in {"force": "N", "position": "m", "current": "A"}.get(read_name(name, "").quantity, ()) else ""


def _unit_at_the_end(name: str, words: list[str]) -> tuple[str, list[str]]:
    """Split off the unit suffix of a name, as in `x_cmd_mm`, except single letters and `in`; return unit and words."""
    for start in [k + 1 for k, letter in enumerate(name) if letter in "_ "]:
        end = name[start:].replace(" ", "_")
        # A name cannot contain a slash: rad_s means rad/s.
        unit = unit_of(re.sub(r"^(u?m?m|rad|deg)_(s2?)$", r"\1/\2", end))
        if unit and len(end) > 1 and end != "in":
            return unit, words_of(name[:start])
    return "", words


def _axis(name: str, words: list[str]) -> str:
    """Return the axis in a name: `joint.0` -> 0, `x_cmd` -> x, `ux` -> x."""
    match = _AXIS.search(name)
    if match:
        return match[1].lower()
    single = [word for word in words if word in ("x", "y", "z")]
    if single:
        return single[0]
    short = _SHORT.fullmatch(name.lower())
    return short[2] if short else ""


def _by_words(name: str, words: list[str]) -> str:
    """Return the quantity named by the words of a name; `command` only if no other quantity matches."""
    for quantity, known in _WORDS.items():
        if known & set(words):
            return quantity
    short = _SHORT.fullmatch(name.lower())
    if short:
        return {"u": "command", "v": "velocity", "i": "current", "iq": "current", "f": "force"}.get(short[1], "")
    return ""


def _by_unit(unit: str) -> str:
    """Return the quantity that a unit measures."""
    if unit.lower() in COUNTS:
        return "position"
    for known, quantity in _QUANTITY_OF_UNIT.items():
        try:
            units.factor(unit, known)
        except ParameterError:
            continue
        return quantity if unit else ""
    return ""


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


@dataclass(frozen=True, eq=False, repr=False)
class Guess(Result):
    """The guessed roles of a log's channels as a `mapping` for `read_log`, with reasons, and the unresolved channels.

    `needs` lists, by role, a channel whose role is clear but whose unit (percent of a rated torque, counts) requires a
    factor, and the meaning of this factor; `unused` lists channels without a role, with the reason; `lost` lists, by
    role, a column that would have the role if it contained numbers, and what it contains instead.
    """

    name: str
    mapping: Mapping
    needs: abc.Mapping[str, tuple[str, str]]
    unused: abc.Mapping[str, str]
    lost: abc.Mapping[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])

    def table(self) -> Table:
        """Tabulate role, channel, unit and reason, followed by channels that need a factor and unused channels."""
        rows = [
            [role, column.name, column.unit or ROLES[role] or "own", self.mapping.reasons.get(role, "")]
            for role, column in self.mapping.items()
        ]
        rows += [[f"{role} ?", column, "", f"needs a factor: {what}"] for role, (column, what) in self.needs.items()]
        rows += [["-", column, "", why] for column, why in self.unused.items()]
        return Table(
            f"{self.name}: roles guessed by names and units", ["role", "channel", "unit", "why"], rows, sentences=3
        )

    def toml(self, file: str | Path = "") -> str:
        """Return the sections [log] and [log.channels], with channels that need a factor in comments."""
        open_ = [
            f"# {entry(role, Column(name=column, factor=1.0))}  # {what}\n"
            for role, (column, what) in self.needs.items()
            if role not in self.mapping
        ]
        return "".join([self.mapping.text(str(file) or self.name), *open_])


def guess_roles(log: Log, axis: str | None = None) -> Guess:
    """Guess the roles of the channels of a log that was read without a mapping.

    axis  the axis of a log with several axes: `x`, or the number of a joint; default: the first one

    Raises ParameterError for an axis that no channel names.
    """
    read = {name: read_name(name, log.units.get(name, "")) for name in log.channels}
    axes = list(dict.fromkeys(reading.axis for reading in read.values() if reading.role_like and reading.axis))
    if axis is not None and axis not in axes:
        raise ParameterError(f"{log.name}: no channel names the axis '{axis}'; there are: {', '.join(axes) or 'none'}")
    wanted = axis if axis is not None else axes[0] if axes else ""
    mapping: dict[str, Column] = {}
    reasons: dict[str, str] = {}
    needs: dict[str, tuple[str, str]] = {}
    unused: dict[str, str] = {}
    # exact names first, then clear ones, and last possible ones
    for name, reading in sorted(
        read.items(), key=lambda item: (item[0] not in ROLES, not item[1].exact, item[1].is_weak, not item[1].side)
    ):
        role = reading.exact or _role(reading)
        if not role:
            unused[name] = reading.why or "not like any known name"
        elif reading.axis not in ("", wanted):
            unused[name] = f"of axis {reading.axis}, not {wanted}"
        elif role in mapping or role in needs:
            other = _OTHER.get(role, "")
            # Only a second channel without a side can be the other encoder; a third one cannot be assigned.
            if reading.side or not other or other in mapping or other in needs:
                taken = mapping[role].name if role in mapping else needs[role][0]
                unused[name] = f"like {role}, which is '{taken}'"
            else:
                _second(name, reading, role, other, mapping, reasons, needs)
        else:
            _take(name, reading, role, mapping, reasons, needs)
    lost: dict[str, tuple[str, str]] = {}
    for name, why in log.left_out.items():
        reading = read_name(name, unit_in_name(name))
        role = reading.exact or _role(reading)
        if (
            role
            and role != "time"
            and role not in (*mapping, *needs, *lost)
            and reading.axis in ("", wanted or reading.axis)
        ):
            lost[role], unused[name] = (name, why), f"like {role}, but {why}"
    order = [role for role in ROLES if role in mapping]
    # A sample time given by the user is not in the file, and is needed to read it again.
    step = log.sample_time if log.provenance.get("clock") == "given" else None
    columns = {role: mapping[role] for role in order}
    return Guess(log.name, Mapping(columns, {}, reasons, wanted, step), needs, unused, lost)


def _role(reading: NameReading) -> str:
    """Return the role of a channel, from its quantity and from whether it is set or measured at motor or load."""
    if reading.quantity not in _ROLES:
        return ""
    place = 0 if reading.is_set else {"motor": 1, "load": 2}.get(reading.side, 3)
    return _ROLES[reading.quantity][place]


def _take(
    name: str,
    reading: NameReading,
    role: str,
    mapping: dict[str, Column],
    reasons: dict[str, str],
    needs: dict[str, tuple[str, str]],
) -> None:
    """Assign a role to a channel, or record the factor that its unit requires."""
    if role in OWN_UNIT:
        mapping[role] = Column(name=name, unit=reading.unit if _known(reading.unit) else "")
    elif not reading.unit:
        mapping[role] = Column(name=name)
    elif measures(reading.unit, role):
        mapping[role] = Column(name=name, unit=reading.unit)
    else:
        rated = ": the rated value / 100" if reading.unit == "percent" else ""
        needs[role] = (name, f"{ROLES[role]} per {reading.unit}{rated}")
        return
    assumed = (
        ""
        if reading.unit or role in OWN_UNIT or unit_at_the_end(name, role)
        else f"; no unit is stated, {ROLES[role]} is taken"
    )
    reasons[role] = reading.why + assumed


def _second(
    name: str,
    reading: NameReading,
    role: str,
    other: str,
    mapping: dict[str, Column],
    reasons: dict[str, str],
    needs: dict[str, tuple[str, str]],
) -> None:
    """Assign roles to two channels of the same kind: the first in the file to the motor, the second to the load."""
    motor, load = (other, role) if role.endswith("_load") else (role, other)
    if role in mapping:
        mapping[motor] = mapping.pop(role)
        del reasons[role]
        reasons[motor] = "the first of two such channels"
    else:
        needs[motor] = needs.pop(role)
    _take(name, reading, load, mapping, reasons, needs)
    if load in mapping:
        reasons[load] = "the second of two such channels"


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
