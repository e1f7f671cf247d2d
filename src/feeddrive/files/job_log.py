"""The section [log] of a job: the log to read, and the roles of its columns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from feeddrive.files.columns import Column, unit_at_the_end
from feeddrive.files.formats import OpenedFile
from feeddrive.files.log import Log
from feeddrive.files.mapping import Mapping, keys_of, mapping_of
from feeddrive.files.read_log import read_log
from feeddrive.files.toml_file import Section, read_toml
from feeddrive.files.toml_values import optional_text
from feeddrive.language.errors import LogError


@dataclass(frozen=True)
class LogRequest:
    """The log to read, what its columns are, and how many samples at its start do not count."""

    path: Path
    mapping: Mapping
    skip_samples: int = 0

    def read(self) -> Log:
        """The log, with those optional channels that it has.

        Raises FileError or LogError as `read_log`, and for an injected force without a unit.
        """
        file = OpenedFile(self.path)
        log = read_log(file, self.mapping)
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
        return self.mapping.get(role) or self.mapping.optional.get(role)


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
    section.refuse_unknown(("file", "skip_samples", *keys_of(section)))
    name = optional_text(section, "file")
    if given is None and name is None:
        raise section.error('log.file is missing: file = "run.csv", or give the log on the command line')
    path = Path(given) if given is not None else place.parent / str(name)
    return LogRequest(path, mapping_of(section), whole(section, "skip_samples", 0))


def whole(section: Section, name: str, default: int) -> int:
    """A whole number >= 0 under a key."""
    value = section.values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise section.error(f"{section.dotted(name)} must be a whole number, 0 <= {name} < 2^53", name)
    return value
