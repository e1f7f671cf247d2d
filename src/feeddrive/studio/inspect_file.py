"""The kind of an imported file: a machine, a part program, frequency responses or a log; and its errors.

It is read in a process of its own, so that a file on which a reader fails leaves the page as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.studio.jobs import fault

if TYPE_CHECKING:
    from feeddrive.files.formats import OpenedFile
    from feeddrive.files.guess import Guess

Preview: TypeAlias = tuple[np.ndarray, np.ndarray]  # time and values
MACHINE, PROGRAM, RESPONSES, LOG, UNKNOWN = "machine", "part program", "frequency responses", "log", "unknown"
_PROGRAMS = (".ngc", ".nc", ".tap", ".cnc", ".gcode", ".mpf", ".iso")
_COLUMNS = 40  # of a log that are previewed
_POINTS = 400  # of a preview


@dataclass(frozen=True, eq=False)
class Understood:
    """The content of a file, as far as it could be read.

    name, kind  of the file
    axes        of a machine
    tables      what is in it
    guess       roles of the columns of a log
    columns     of a log: time and values of a preview, by name
    units       of columns, as the file states them
    wrong       what is wrong with it, and what to do
    """

    name: str
    kind: str
    axes: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    guess: Guess | None = None
    columns: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict[str, tuple[np.ndarray, np.ndarray]]
    )
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    responses: tuple[str, ...] = ()
    wrong: str = ""


def understand(paths: Sequence[Path], progress: Progress) -> list[Understood]:
    """Inspect files. Raises for none of them: errors are reported with their file."""
    contents = list[Understood]()
    for i, path in enumerate(paths):
        progress.step(f"reading {path.name}", i, len(paths))
        try:
            contents.append(_understood(path, progress))
        except FeeddriveError as error:
            contents.append(Understood(path.name, UNKNOWN, wrong=str(error).replace(str(path), path.name)))
        except Exception as error:
            contents.append(Understood(path.name, UNKNOWN, wrong=fault(error)))
    return contents


def _understood(path: Path, progress: Progress) -> Understood:
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return _machine(path)
    if suffix in _PROGRAMS:
        return _program(path)
    from feeddrive.files.formats import OpenedFile
    from feeddrive.files.frf import names_frequency, read_frfs
    from feeddrive.workflow.command import load

    outcome = load("channels").run(load("channels").request(path), progress)
    tables = tuple(
        replace(table, title=table.title.replace(str(path), path.name))
        for table in outcome.tables
        if isinstance(table, Table)
    )
    file = OpenedFile(path)
    if names_frequency(file):
        return Understood(path.name, RESPONSES, tables=tables, responses=tuple(read_frfs(file)))
    return _log(path, file, outcome.result, tables)


def _machine(path: Path) -> Understood:
    from feeddrive.files.machine import read_machine
    from feeddrive.files.toml_file import read_toml

    if read_toml(path).root().optional("axis") is None:
        raise ParameterError(
            f"{path.name}: has no [axis.NAME], so that it is no machine file; a job or a study names other files, "
            "which the page does not read: give it to feeddrive run or sweep"
        )
    machine = read_machine(path)
    return Understood(path.name, MACHINE, axes=tuple(machine.loops), tables=(machine.table(),))


def _program(path: Path) -> Understood:
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = sum(1 for line in text.splitlines() if line.strip())
    if not lines:
        raise ParameterError(f"{path.name}: is empty: a part program has lines as G1 X10 F1000")
    return Understood(path.name, PROGRAM, tables=(Table("part program", ("lines", ""), [(str(lines), "")]),))


def _log(path: Path, file: OpenedFile, guess: Guess, tables: tuple[Table, ...]) -> Understood:
    from feeddrive.plot.style import envelope
    from feeddrive.workflow.channels import whole_log

    time = guess.mapping.get("time")
    log = whole_log(file, time, guess.mapping.sample_time)
    columns = dict[str, Preview]()
    for name, values in list(log.channels.items())[:_COLUMNS]:
        y = np.asarray(values, np.float64)
        if y.ndim == 1 and y.size > 1 and np.all(np.isfinite(y)):
            columns[name] = envelope(np.asarray(log.time, np.float64), y, _POINTS)
    if file.columns.left_out:
        rows = [[name, why] for name, why in file.columns.left_out.items()]
        tables = (*tables, Table("not read", ("column", "why"), rows, sentences=1))
    return Understood(path.name, LOG, tables=tables, guess=guess, columns=columns, units=dict(log.units))
