"""The section [log] of a job: the log to read, and the roles of its columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from feeddrive.files.columns import ROLES, Column
from feeddrive.files.formats import OpenedFile
from feeddrive.files.log import Log
from feeddrive.files.read_log import read_log, unit_at_the_end
from feeddrive.files.toml_file import Section, read_toml
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError


@dataclass(frozen=True)
class LogRequest:
    """The log to read, and the roles of its columns."""

    path: Path
    channels: Mapping[str, Column]
    optional: Mapping[str, Column]
    skip_samples: int
    sample_time: float | None = None

    def read(self) -> Log:
        """The log, with those optional channels that it has.

        Raises FileError or LogError as `read_log`, and for an injected force without a unit.
        """
        file = OpenedFile(self.path)
        log = read_log(file, self.channels, optional=self.optional, sample_time=self.sample_time)
        named = self.named("load_force")
        told = named is None or named.unit or named.factor is not None or file.columns.units.get(named.name)
        if named is None or told or "load_force" not in log.channels or unit_at_the_end(named.name, "load_force"):
            return log
        raise LogError(
            f"{self.path}: '{named.name}' (load_force) states no unit, and injected signals are logged in N, in V or "
            f"in percent: state it, as load_force = {{ column = '{named.name}', unit = 'N' }}, or give factor = the N "
            f"at the table for each unit of it; a signal that is added to the drive's command, in the command's unit, "
            f"is excitation = '{named.name}'"
        )

    def named(self, role: str) -> Column | None:
        """The column that has a role."""
        return self.channels.get(role) or self.optional.get(role)


def read_request(path: str | Path, log: str | Path | None = None) -> LogRequest:
    """The section [log] of a TOML file, that of a job or one that `Guess.toml` wrote: the roles of a log's columns.

    `log` replaces the log's file.  Raises FileError or ParameterError with file, line, key and what to do.
    """
    root = read_toml(path).root()
    request = log_request(root, Path(path), log)
    if request is None:
        raise root.error("section [log] is missing; print(guess_roles(read_log(file)).toml()) shows one")
    return request


def log_request(root: Section, place: Path, given: str | Path | None) -> LogRequest | None:
    """The section [log] of a file, if it has one; `given` replaces the log's file."""
    section = root.optional("log")
    if section is None:
        if given is not None:
            raise root.error("a log was given, but the job has no section [log] that assigns its columns")
        return None
    step = [key for key in section.values if key == "sample_time" or key.startswith("sample_time_")]
    section.refuse_unknown(("file", "channels", "optional", "skip_samples", "sample_time", *step))
    name = optional_text(section, "file")
    if given is None and name is None:
        raise section.error('log.file is missing: file = "run.csv", or give the log on the command line')
    path = Path(given) if given is not None else place.parent / str(name)
    return LogRequest(
        path,
        _channels(section, "channels"),
        _channels(section, "optional"),
        whole(section, "skip_samples", 0),
        _step(section, step[0]) if step else None,
    )


def _step(section: Section, key: str) -> float:
    """The sample time of a log without a column of time, in s or in the unit that the key names."""
    value = section.values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1e9:
        raise section.error(f"{section.dotted(key)} must be a time > 0", key)
    try:
        return units.scaled(value, 1.0 if key == "sample_time" else units.factor(key.removeprefix("sample_time_"), "s"))
    except ParameterError as error:
        raise section.error(f"{section.dotted(key)}: {error}", key) from None


def _channels(section: Section, name: str) -> dict[str, Column]:
    channels = section.optional(name)
    if channels is None:
        return {}
    channels.refuse_unknown(ROLES)
    return {role: _column(channels, role, value) for role, value in channels.values.items()}


def _column(channels: Section, role: str, value: Any) -> Column:
    """A column's name, or { column = "x", unit = "mm" }, or { column = "x", factor = 1e-3 }."""
    if isinstance(value, str):
        return Column(name=value)
    wanted = 'must be the name of a column, or { column = "name", unit = "mm" }, or { column = "name", factor = 0.001 }'
    if not isinstance(value, dict) or not isinstance(value.get("column"), str):
        raise channels.error(f"{channels.dotted(role)} {wanted}", role)
    channels.section(role).refuse_unknown(("column", "unit", "factor"))
    unit, factor = value.get("unit", ""), value.get("factor")
    number = factor is None or (isinstance(factor, (int, float)) and not isinstance(factor, bool))
    if not isinstance(unit, str) or not number:
        raise channels.error(f"{channels.dotted(role)} {wanted}", role)
    try:
        return Column(name=value["column"], unit=unit, factor=None if factor is None else float(factor)).checked(role)
    except (ParameterError, OverflowError) as error:
        raise channels.error(f"{channels.dotted(role)}: {error}", role) from None


def optional_text(section: Section, name: str) -> str | None:
    """A text under a key, if it is there."""
    value = section.values.get(name)
    if value is not None and not isinstance(value, str):
        raise section.error(f'{section.dotted(name)} must be a text in quotes ("...")', name)
    return value


def whole(section: Section, name: str, default: int) -> int:
    """A whole number >= 0 under a key."""
    value = section.values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise section.error(f"{section.dotted(name)} must be a whole number, 0 <= {name} < 2^53", name)
    return value
