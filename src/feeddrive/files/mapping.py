"""The mapping of roles to a log's columns: one value for the page, a channels file, the command line and Python.

mapping = Mapping({"position_load": Column(name="x", unit="mm"), "force": Column(name="f", factor=12.0)})
log = read_log("run.csv", mapping)
Mapping.read(mapping.text("run.csv")) == mapping
"""

from __future__ import annotations

from collections import abc
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, TypeAlias

from feeddrive.files.columns import ROLES, Column
from feeddrive.files.from_toml import read_section
from feeddrive.files.section import Section, file_name, named, text
from feeddrive.files.toml_file import parse_toml
from feeddrive.files.toml_values import quoted
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

_LONGEST = 1e9  # s, of a sample time


@dataclass(frozen=True)
class Mapping(abc.Mapping[str, Column]):
    """The columns of a log by role, as `read_log` takes them.

    columns      by role
    optional     the same for columns that may be missing
    reasons      why a column has its role, by role
    axis         of a log with several, as its columns name it; empty for a log of one axis
    sample_time  of a log without a column of time, or whose stamps are rounded, s

    Raises ParameterError for a role, unit, factor or sample time that cannot be.
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
        """Return the sections [log], [log.channels] and [log.optional] of TOML, as a job has them.

        file  the log itself, for a file that is read without naming one
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
        """Read the text of a mapping.

        name  of its file in errors

        Raises FileError or ParameterError with file, line, key and what to do.
        """
        return read_section(LogSection, parse_toml(text, name).root().section("log"), besides=("file",)).mapping


MappingLike: TypeAlias = Path | Mapping
"""A file with [log.channels], or a mapping."""


def entry(role: str, column: Column, reason: str = "") -> str:
    """Return the line of [log.channels] for a column."""
    words = [f"column = {quoted(column.name)}"]
    if column.unit:
        words.append(f"unit = {quoted(column.unit)}")
    if column.factor is not None:
        words.append(f"factor = {float(column.factor)!r}")
    if reason:
        words.append(f"reason = {quoted(reason)}")
    return f"{role} = {{ {', '.join(words)} }}"


class ColumnSection(Section):
    """A column of a log, and how its numbers become those of its role."""

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
        """Return the column as one of a role. Raises ParameterError for a unit or factor that cannot be its own."""
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
        """The columns by role. Raises ParameterError for a unit or a factor that its role cannot have."""
        columns, optional = (
            {role: column.of(role) for role, column in sections.items()} for sections in (self.channels, self.optional)
        )
        reasons = {role: column.reason for role, column in (*self.channels.items(), *self.optional.items())}
        return Mapping(columns, optional, reasons, self.axis, self.sample_time)


class ChannelsSection(Section, kind="channels"):
    """The roles of a log's columns: a file that `feeddrive channels` writes, or a job with a log."""

    is_open: ClassVar[bool] = True

    log: LogSection = part("the log and its columns")
