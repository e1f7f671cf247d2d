"""The columns of a measured file as a reader returns them, the spellings of their units, and their roles in a log."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeAlias

import numpy as np

from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError, nearest
from feeddrive.language.quantity import Quantity

# roles of columns and their units in a log: along the axis, then at the motor's shaft
ROLES: Mapping[str, str] = {
    "time": "s",
    "setpoint_position": "m",
    "setpoint_velocity": "m/s",
    "position_motor": "m",
    "position_load": "m",
    "velocity_motor": "m/s",
    "velocity_load": "m/s",
    "acceleration_load": "m/s2",
    "force": "N",
    "command": "",
    "load_force": "N",
    "excitation": "",
    "setpoint_angle": "rad",
    "setpoint_speed": "rad/s",
    "angle_motor": "rad",
    "angle_load": "rad",
    "speed_motor": "rad/s",
    "speed_load": "rad/s",
    "torque": "N m",
    "current": "A",
}

# the option of the command line that names the column of a role; the other roles are named in a file for --channels
FLAGS: Mapping[str, str] = {
    "time": "--time",
    "setpoint_position": "--set-position",
    "setpoint_angle": "--set-angle",
    "position_load": "--position",
    "position_motor": "--position",
    "velocity_load": "--velocity",
    "angle_motor": "--angle",
    "angle_load": "--angle",
    "speed_motor": "--speed",
    "force": "--force",
    "torque": "--torque",
    "current": "--current",
    "command": "--command",
}

# roles in the unit of the drive: the command (A, V, percent), and a signal that an experiment injects
OWN_UNIT = frozenset({"command", "excitation"})


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a file: its name, and the conversion of its numbers to the unit of its role.

        value = number · factor, in `unit`

    A factor without a unit converts to the SI unit of the role.  Without a factor and a unit, the numbers are in the
    unit stated in the file, or in SI units if the file states none.

    Column(name="qm", unit="mm"), Column(name="iq", factor=35.15), Column(name="y", unit="mm", factor=-1.0)
    """

    name: str
    unit: str = ""
    factor: float | None = None

    @classmethod
    def of(cls, text: str) -> Self:
        """Parse the short form of a column: `name`, `name:unit`, `name*factor` or `name*factor:unit`.

        Raises ParameterError for a factor that is not a number.
        """
        name, star, tail = text.rpartition("*")
        if not star:
            name, colon, unit = text.rpartition(":")
            return cls(name=name, unit=unit_of(unit) or unit) if colon else cls(name=text)
        number, _, unit = tail.partition(":")
        try:
            return cls(name=name, unit=unit_of(unit) or unit, factor=float(number))
        except ValueError:
            raise ParameterError(
                f"'{text}': the factor after * must be a number, as in act*2e-8; a column whose name holds a * is "
                f"named in a file for --channels"
            ) from None

    def text(self) -> str:
        """Return the short form of the column; `of` can parse it unless the name contains * or a colon."""
        factor = "" if self.factor is None else f"*{float(self.factor)!r}"
        return f"{self.name}{factor}{f':{self.unit}' if self.unit else ''}"

    def checked(self, role: str) -> Self:
        """Return the column with its unit in the spelling of `language.units`.

        Raises ParameterError for an unknown role, and for a unit or factor that is invalid for the role.
        """
        if role not in ROLES:
            raise ParameterError(f"a log has no role '{role}'{nearest(role, ROLES)}")
        if self.factor is not None and not (np.isfinite(self.factor) and self.factor != 0.0):
            raise ParameterError(f"{role}: factor = {Quantity(self.factor):6} must be a finite number that is not 0")
        unit = unit_of(self.unit) or self.unit
        if role not in OWN_UNIT and unit:
            try:
                units.factor(unit, ROLES[role])
            except ParameterError as error:
                hint = "" if self.factor is None else f"; a factor from it to {ROLES[role]} is stated without a unit"
                raise ParameterError(f"{error}{hint}") from None
        return replace(self, unit=unit, factor=None if self.factor is None else float(self.factor))

    def scale(self, role: str) -> float | None:
        """Return the factor from the file's numbers to the role's unit; None if neither factor nor unit is stated."""
        if role in OWN_UNIT or not self.unit:
            return self.factor
        size = units.factor(self.unit, ROLES[role])
        return size if self.factor is None else self.factor * size


Named: TypeAlias = Column | str | tuple[str, float] | tuple[str, str]


MOST_BYTES = 2_000_000_000  # of a log file; a reader may allow less
MOST_NUMBERS = 400_000_000  # of all columns that are read: 3.2 GB in memory

# limit of the size of an unpacked file: a decompression bomb of 1 MB must not fill the memory
FREE_BYTES = 100_000_000
MOST_TIMES = 100

_TIME = re.compile(r"(t|time|zeit|timestamp|time[_ ]?stamp)(_(s|ms|us|ns|min))?", re.IGNORECASE)

# units in the spelling of makers, where it differs from that of `language.units`
_SPELLINGS = {
    "%": "percent",
    "‰": "permille",
    "0.1 %": "permille",
    "0.1%": "permille",
    "°": "deg",
    "Nm": "N m",
    "mNm": "mN m",
    "sec": "s",
    "msec": "ms",
    "usec": "us",
    "U/min": "rpm",
    "r/min": "rpm",
    "1/min": "rpm",
    "min-1": "rpm",
    "grad": "deg",
    "Grad": "deg",
    "Newton": "N",
    "Nmm": "N mm",
    "kNm": "kN m",
    "uNm": "uN m",
    "-": "",
}
# spellings for encoder counts: not a unit, since a length or an angle needs a factor
COUNTS = frozenset({"inc", "incs", "count", "counts", "cnt", "qc", "pulse", "pulses", "ticks", "steps"})


def _row(row: int) -> str:
    return f"row {row + 1}"


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a file by name, float64 of shape (n,), possibly of different lengths.

    `unread` lists the columns that were not requested; `left_out` gives the reason for each other omitted column;
    `place` is a function that returns the location of a row in the file, such as `row 3` or `line 12`.
    """

    format: str
    values: Mapping[str, np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    constants: Mapping[str, float] = field(default_factory=dict[str, float])
    unread: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])
    place: Callable[[int], str] = _row


# Arguments: file name, bytes, and the names of the requested columns (None: all); time columns are always read.
Reader: TypeAlias = Callable[[str, bytes, frozenset[str] | None], Columns]


def is_time(name: str) -> bool:
    """Return True for a common name of a time column: `t`, `time`, `time_ms`, `timestamp`."""
    return _TIME.fullmatch(name.strip()) is not None


def free_name(name: str, taken: dict[str, int]) -> str:
    """Return a unique name for a column: force, force_again, force_again3, ...; `taken` counts the names in use."""
    free = name
    while free in taken:
        taken[name] += 1
        free = f"{name}_again{taken[name] if taken[name] > 2 else ''}"
    taken[free] = 1
    return free


def is_wanted(name: str, wanted: frozenset[str] | None) -> bool:
    """Return True for a requested column or a time column; None requests all columns."""
    return wanted is None or name in wanted or is_time(name)


def unit_of(text: str) -> str | None:
    """Convert a unit (`µm`, `mm/s²`, `%`, `[ms]`) to the spelling of `language.units`; None if it is unknown."""
    plain = text.strip().strip("[]").strip()
    # Both the micro sign (U+00B5) and the Greek letter (U+03BC) are in use.
    plain = plain.replace("µ", "u").replace("μ", "u").replace("²", "2").replace("³", "3").replace("^", "")
    plain = plain.replace("·", " ").replace("*", " ")
    if plain.startswith("(") and plain.endswith(")") and "(" not in plain[1:]:
        plain = plain[1:-1].strip()
    # In a longer unit, too, such as rad/(s Nm) or °/s.
    for maker, ours in (("Nm", "N m"), ("°", "deg")):
        plain = re.sub(rf"(?<![A-Za-z°]){maker}(?![A-Za-z°])", ours, plain) if plain not in _SPELLINGS else plain
    plain = _SPELLINGS.get(plain, plain)
    try:
        units.measure(plain)
    except ParameterError:
        return None
    return plain


def factor_of(path: str, role: str, column: Column, unit: str) -> float:
    """Return the conversion factor from the unit of a column to that of its role.

    The unit is that of `column`; if it has none, that of the file; otherwise the suffix of the column's name, where
    `_in` means input and not inch.
    """
    stated = column.scale(role)
    if stated is not None or role in OWN_UNIT:
        if role not in OWN_UNIT:
            check_sign(path, column, unit or unit_at_the_end(column.name, role), ROLES[role])
        return 1.0 if stated is None else stated
    if unit:
        try:
            return units.factor(unit, ROLES[role])
        except ParameterError:
            raise LogError(
                f"{path}: column '{column.name}' is in '{unit}', which is not a unit of {role} ({ROLES[role]}); "
                f"give the factor from one to the other, as in  {role} = {{ column = '{column.name}', factor = 1.0 }}"
            ) from None
    ending = unit_at_the_end(column.name, role)
    return units.factor(ending, ROLES[role]) if ending else 1.0


def check_sign(path: str, column: Column, unit: str, si: str) -> None:
    """Raise LogError for a factor of ±1 without a unit if the file states a unit of the same dimension other than `si`.

    Such a factor is meant to set the sign of a column (in mm, for example), not to declare that its numbers are in m.
    """
    if column.unit or column.factor not in (1.0, -1.0) or not unit:
        return
    try:
        same = units.factor(unit, si) == 1.0
    except ParameterError:
        return
    if not same:
        raise LogError(
            f"{path}: column '{column.name}' is in {unit}, as the file says, and a factor of "
            f"{Quantity(column.factor):6} without a unit would take its numbers for {si}: state the unit too, as "
            f"{replace(column, unit=unit).text()}"
        )


def unit_at_the_end(name: str, role: str) -> str:
    """Return the unit suffix of a column name, as in `x_cmd_mm`, if it is valid for the role, otherwise an empty
    string.
    """
    for start in [k + 1 for k, letter in enumerate(name) if letter == "_"]:
        try:
            units.factor(name[start:], ROLES[role])
        except ParameterError:
            continue
        # In a signal name `_in` means input far more often than inch.
        return "" if name[start:] == "in" else name[start:]
    return ""


def check_size(name: str, columns: int, rows: int) -> None:
    """Raise LogError if a table of this size contains more numbers than a reader accepts."""
    if columns * rows > MOST_NUMBERS:
        raise LogError(
            f"{name}: holds {columns} columns of {rows:,} rows, more than the {MOST_NUMBERS:,} numbers that are read; "
            "map only the columns that are needed, or cut the log"
        )


def most_unpacked(packed: int) -> int:
    """Return the allowed decompressed size in bytes: 100 MB plus 100 times the compressed size, but at most 2 GB."""
    return min(FREE_BYTES + MOST_TIMES * packed, MOST_BYTES)


def check_unpacked(name: str, numbers: int, packed: int) -> None:
    """Raise LogError if a file of `packed` bytes claims to contain implausibly many numbers for its size."""
    if 8 * numbers > most_unpacked(packed):
        raise LogError(
            f"{name}: has {packed:,} bytes and states {numbers:,} numbers, more than {MOST_TIMES} times its size and "
            f"more than {Quantity(FREE_BYTES / 1e6, 'MB')}; it is damaged or a zip bomb: map only the columns that are "
            "needed"
        )


def arrow_numbers(column: Any) -> np.ndarray:
    """Return the numbers of a column of a pyarrow table, with NaN for empty cells.

    pyarrow's `to_numpy` is not used, because it imports pandas if pandas is installed, and this import takes longer
    than reading a log of 4,000 rows.
    """
    # DLPack has neither missing values nor bits, in which Arrow stores booleans.
    if column.null_count or not column.num_chunks or str(column.type) == "bool":
        return column.to_numpy()
    return np.concatenate([np.from_dlpack(piece) for piece in column.chunks])


def arrow_column(numbers: np.ndarray) -> Any:
    """Return a pyarrow array of float64 that shares the memory of `numbers`, shape (n,), if these are contiguous.

    pyarrow's `array` is not used, for the same reason as in `arrow_numbers`.
    """
    import pyarrow as arrow

    values = np.ascontiguousarray(numbers, dtype=np.float64)
    return arrow.Array.from_buffers(arrow.float64(), len(values), [None, arrow.py_buffer(values)])
