"""What each column of a log is: one value for the page, a channels file, the command line and Python.

mapping = Mapping({"position_load": Column(name="x", unit="mm"), "force": Column(name="f", factor=12.0)})
log = read_log("run.csv", mapping)
Mapping.read(mapping.text("run.csv")) == mapping
"""

from __future__ import annotations

from collections import abc
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from feeddrive.files.columns import ROLES, Column
from feeddrive.files.toml_file import Section, parse_toml
from feeddrive.files.toml_values import optional_text, quoted
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

_LONGEST = 1e9  # s, of a sample time


@dataclass(frozen=True)
class Mapping(abc.Mapping[str, Column]):
    """What each column of a log is.  It is a mapping of roles to columns, which `read_log` takes.

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
        return mapping_of(parse_toml(text, name).root().section("log"))


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


def mapping_of(section: Section) -> Mapping:
    """Return the mapping of a section [log]; its keys that are about the file of the log are left to others.

    Raises ParameterError with file, line, key and what to do.
    """
    reasons: dict[str, str] = {}
    columns, optional = (_columns(section, name, reasons) for name in ("channels", "optional"))
    return Mapping(columns, optional, reasons, optional_text(section, "axis") or "", _sample_time(section))


def keys_of(section: Section) -> tuple[str, ...]:
    """Return the keys of a section [log] that `mapping_of` reads."""
    return ("channels", "optional", "axis", "sample_time", *filter(_is_sample_time, section.values))


def _is_sample_time(key: str) -> bool:
    return key == "sample_time" or key.startswith("sample_time_")


def _sample_time(section: Section) -> float | None:
    """The sample time in s, or in the unit that the key names."""
    key = next(filter(_is_sample_time, section.values), None)
    if key is None:
        return None
    value = section.values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < _LONGEST:
        raise section.error(f"{section.dotted(key)} must be a time > 0", key)
    try:
        return units.scaled(value, 1.0 if key == "sample_time" else units.factor(key.removeprefix("sample_time_"), "s"))
    except ParameterError as error:
        raise section.error(f"{section.dotted(key)}: {error}", key) from None


def _columns(section: Section, name: str, reasons: dict[str, str]) -> dict[str, Column]:
    """Columns by role; why they have them is put into `reasons`."""
    channels = section.optional(name)
    if channels is None:
        return {}
    channels.refuse_unknown(ROLES)
    return {role: _column(channels, role, value, reasons) for role, value in channels.values.items()}


def _column(channels: Section, role: str, value: Any, reasons: dict[str, str]) -> Column:
    """A column's name, or { column = "x", unit = "mm", factor = -1, reason = "..." }."""
    if isinstance(value, str):
        return Column(name=value)
    wanted = 'must be the name of a column, or { column = "name", unit = "mm" }, or { column = "name", factor = 0.001 }'
    if not isinstance(value, dict) or not isinstance(value.get("column"), str):
        raise channels.error(f"{channels.dotted(role)} {wanted}", role)
    channels.section(role).refuse_unknown(("column", "unit", "factor", "reason"))
    unit, factor, reason = value.get("unit", ""), value.get("factor"), value.get("reason", "")
    number = factor is None or (isinstance(factor, (int, float)) and not isinstance(factor, bool))
    if not isinstance(unit, str) or not isinstance(reason, str) or not number:
        raise channels.error(f"{channels.dotted(role)} {wanted}", role)
    if reason:
        reasons[role] = reason
    try:
        return Column(name=value["column"], unit=unit, factor=None if factor is None else float(factor)).checked(role)
    except (ParameterError, OverflowError) as error:
        raise channels.error(f"{channels.dotted(role)}: {error}", role) from None
