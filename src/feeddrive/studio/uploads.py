"""Uploaded files: stored under safe names, limited in size and number, and recognized by content.

They are read in a separate process, so that a file that crashes a reader does not affect the page.
"""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeAlias

import numpy as np

from feeddrive.files.atomic_io import written_whole
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.studio.jobs import fault

if TYPE_CHECKING:
    from feeddrive.files.columns import Column
    from feeddrive.files.log import Log
    from feeddrive.files.mapping import Guess
    from feeddrive.files.read_log import OpenedFile
    from feeddrive.studio.log_check import Check


Preview: TypeAlias = tuple[np.ndarray, np.ndarray]  # time and values
MACHINE, PROGRAM, RESPONSES, LOG, UNKNOWN = "machine", "part program", "frequency responses", "log", "unknown"
_PROGRAMS = (".ngc", ".nc", ".tap", ".cnc", ".gcode", ".mpf", ".iso")
_COLUMNS = 40  # of a log that are previewed
_POINTS = 400  # of a preview
# numbers of a log that are kept in the server, 16 MB: peak figures need no more rows, and a page may have many logs
_HELD = 2_000_000
_ANY_STEP = 1e-3  # s, by which a log is read to see whether a sample time is all that it lacks


@dataclass(frozen=True, eq=False)
class Understood:
    """The readable content of a file.

    name, kind  name and kind of the file
    axes        axes of a machine
    tables      summary of the content, except of a log
    guess       column roles for one axis of a log: guessed first, then as assigned by the user
    guesses     the column roles for each axis of a log with several axes, by axis name
    names       columns of a log that may have a role, in the order of the file
    log         the columns of a log as in the file; for a long log only every n-th row
    clock       time column and unit with which `log` was read; None: the usual ones
    check       check of a log's column roles; None until it is needed
    no_clock    True for a log that can be read once its sample time is given
    columns     time and values of a log's preview, by column name
    units       units of the columns, as stated in the file
    responses   names of the frequency responses
    wrong       error with remedy; empty if the file could be read
    """

    name: str
    kind: str
    axes: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    guess: Guess | None = None
    guesses: Mapping[str, Guess] = field(default_factory=dict[str, "Guess"])
    names: tuple[str, ...] = ()
    log: Log | None = None
    clock: Column | None = None
    check: Check | None = None
    no_clock: bool = False
    columns: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict[str, tuple[np.ndarray, np.ndarray]]
    )
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    responses: tuple[str, ...] = ()
    wrong: str = ""

    def checked(self) -> Self:
        """Return the content of a log with the check of its column roles."""
        from feeddrive.studio.log_check import checked

        assert self.guess is not None
        return replace(self, check=checked(self.guess, self.log, self.clock, self.columns, self.units))


def understand(
    paths: Sequence[Path], progress: Progress, sample_times: Mapping[Path, float] | None = None
) -> list[Understood]:
    """Inspect files. An error is not raised, but stored in the result for its file.

    sample_times  sample times of logs without a clock, s
    """
    known = sample_times or {}
    contents = list[Understood]()
    for i, path in enumerate(paths):
        progress.step(f"reading {path.name}", i, len(paths))
        try:
            contents.append(_understood(path, progress, known.get(path)))
        except FeeddriveError as error:
            # users know the file by its name, not by its place on the server
            wrong = str(error).replace(str(path), path.name)
            contents.append(Understood(path.name, UNKNOWN, wrong=wrong, no_clock=_reads_with_a_clock(path)))
        except Exception as error:
            contents.append(Understood(path.name, UNKNOWN, wrong=fault(error)))
    return contents


def _reads_with_a_clock(path: Path) -> bool:
    """Return True if a log can be read once its sample time is known."""
    from feeddrive.files.read_log import read_log

    if path.suffix.lower() in (".toml", *_PROGRAMS):
        return False
    try:
        read_log(path, sample_time=_ANY_STEP)
    except (FeeddriveError, ValueError, OSError):
        return False
    return True


def _understood(path: Path, progress: Progress, sample_time: float | None) -> Understood:
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return _machine(path)
    if suffix in _PROGRAMS:
        return _program(path)
    from feeddrive.files.frf import names_frequency, read_frfs
    from feeddrive.files.read_log import OpenedFile
    from feeddrive.workflow.command import load

    outcome = load("channels").run(load("channels").request(path, sample_time=sample_time), progress)
    tables = tuple(
        replace(table, title=table.title.replace(str(path), path.name))
        for table in outcome.tables
        if isinstance(table, Table)
    )
    file = OpenedFile(path)
    if names_frequency(file):
        return Understood(path.name, RESPONSES, tables=tables, responses=tuple(read_frfs(file)))
    return _log(path, file, outcome.result)


def _machine(path: Path) -> Understood:
    from feeddrive.files.machine import read_machine
    from feeddrive.files.toml_file import read_toml

    # checked first: a job or study would be rejected for a key, and not for what it is
    if read_toml(path).root().optional("axis") is None:
        raise ParameterError(
            f"{path.name}: has no [axis.NAME], so that it is no machine file; a job or a study names other files, "
            "which the page does not read: give it to feeddrive run or sweep"
        )
    machine = read_machine(path)
    return Understood(path.name, MACHINE, axes=tuple(machine.loops), tables=(machine.table(),))


def _program(path: Path) -> Understood:
    # any encoding will do: only the lines are counted here
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = sum(1 for line in text.splitlines() if line.strip())
    if not lines:
        raise ParameterError(f"{path.name}: is empty: a part program has lines as G1 X10 F1000")
    return Understood(path.name, PROGRAM, tables=(Table("part program", ("lines", ""), [(str(lines), "")]),))


def _log(path: Path, file: OpenedFile, guess: Guess) -> Understood:
    from feeddrive.plot.style import envelope
    from feeddrive.workflow.channels import proposed, whole_log

    clock, step = guess.mapping.get("time"), guess.mapping.sample_time
    log = whole_log(file, clock, step)
    columns = dict[str, Preview]()
    for name, values in list(log.channels.items())[:_COLUMNS]:
        y = np.asarray(values, np.float64)
        if y.ndim == 1 and y.size > 1 and np.all(np.isfinite(y)):
            columns[name] = envelope(np.asarray(log.time, np.float64), y, _POINTS)
    axes = guess.axes if len(guess.axes) > 1 else ()
    guesses = {axis: guess if axis == guess.mapping.axis else proposed(file, axis, None, step) for axis in axes}
    content = Understood(
        path.name,
        LOG,
        guess=guess,
        guesses=guesses,
        names=_names(file, (guess, *guesses.values()), columns),
        log=_thinned(log),
        clock=clock,
        columns=columns,
        units=dict(log.units),
    )
    return content.checked()


def _thinned(log: Log) -> Log:
    """Return the log, reduced to every n-th row so that it contains at most `_HELD` numbers."""
    step = -(-log.time.size * (len(log.channels) + 1) // _HELD)
    if step == 1:
        return log
    channels = {name: values[::step].copy() for name, values in log.channels.items()}
    return replace(log, time=log.time[::step].copy(), channels=channels, sample_time=step * log.sample_time)


def _names(file: OpenedFile, guesses: Collection[Guess], columns: Collection[str]) -> tuple[str, ...]:
    """Return the columns that are previewed, have a role or need a factor, in the order of the file."""
    shown = {*columns}
    for guess in guesses:
        shown |= {column.name for column in guess.mapping.values()} | {need.column for need in guess.needs.values()}
    return tuple(name for name in dict.fromkeys([*file.columns.values, *columns]) if name in shown)


LARGEST = 256_000_000  # bytes of one file
MANY = 64  # files of one session
# bytes of a name: file systems allow 255, part of which the name of a temporary file needs
_LONGEST = 200
# the first character excludes hidden files and names that a command would take for an option
_NAME = re.compile(r"[^\W_][\w .()+,=@~-]{0,119}")
# names that Windows reserves for devices, with any extension
_DEVICES = re.compile(r"(con|prn|aux|nul|(com|lpt)[\d¹²³]) *(\..*)?", re.IGNORECASE)


def safe_name(name: str) -> str:
    """Return the name if it is a safe file name on every operating system. Raises FileError otherwise."""
    if len(name.encode("utf-8", "surrogatepass")) > _LONGEST:
        raise FileError(f"{name!r:.80} is too long a name for a file here: {_LONGEST} bytes at most, rename it")
    if not _NAME.fullmatch(name) or ".." in name or name.endswith((".", " ")) or _DEVICES.fullmatch(name):
        raise FileError(
            f"{name!r:.80} is no name for a file here: rename it with letters, digits, blanks and . - _ ( ) + , = @ ~"
        )
    return name


def stem_of(name: str) -> str:
    """Return a name without its extension and without trailing blanks and dots, which Windows strips."""
    return Path(name).stem.rstrip(" .")


def place_of(name: str, folder: Path, promised: int | None = None) -> Path:
    """Return the path for an uploaded file: run.csv, then 2/run.csv, ..., so that earlier files are not replaced.

    promised  size announced by the browser, bytes, if any

    Raises FileError for an unsafe name, an existing link, more than `LARGEST` bytes, and more than `MANY` files.
    """
    path = folder / safe_name(name)
    if promised is not None and promised > LARGEST:
        raise _too_large(path)
    if path.is_symlink():
        raise FileError(f"{path.name} is a link to another file: remove it from {folder}, or rename the file")
    if sum(1 for entry in folder.rglob("*") if not entry.is_dir()) >= MANY:
        raise FileError(f"{MANY} files were brought already: open a new page for more")
    return free_place(folder, name)


def free_place(folder: Path, name: str) -> Path:
    """Return an unused path in a folder for a file of this name."""
    places = chain([folder], (folder / str(i) for i in count(2)))
    return next(place / name for place in places if not (place / name).exists())


async def keep(name: str, pieces: AsyncIterator[bytes], folder: Path, promised: int | None = None) -> Path:
    """Write an uploaded file to the folder in chunks, completely or not at all. Raises the errors of `place_of`."""
    path = place_of(name, folder, promised)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as temporary, temporary.open("wb") as file:
        size = 0
        async for piece in pieces:
            size += len(piece)
            # counted while it arrives: the announced size may be missing or wrong
            if size > LARGEST:
                raise _too_large(path)
            file.write(piece)
    return path


def _too_large(path: Path) -> FileError:
    return FileError(
        f"{path.name} is larger than {LARGEST // 1_000_000} MB: take a shorter piece of the log, or use feeddrive on "
        "the command line, which reads it where it is"
    )
