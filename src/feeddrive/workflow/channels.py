"""`feeddrive channels`, and the mapping of log columns to roles that all commands use.

The mapping comes from the options or a TOML file; otherwise it is guessed and shown.
"""

from __future__ import annotations

from collections import abc
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.columns import Column, is_time, unit_at_the_end
from feeddrive.files.frf import names_frequency, read_controllers, read_frfs
from feeddrive.files.log import Log, LogLike
from feeddrive.files.mapping import Guess, Mapping, MappingLike, guess_roles, write_roles
from feeddrive.files.read_log import LogRequest, OpenedFile, read_log, read_request, time_units
from feeddrive.files.readers.ast_xml import is_ast
from feeddrive.language.errors import FileError, LogError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column as TableColumn
from feeddrive.language.table import Table
from feeddrive.language.text import Text, joined
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.readings import Doubt, with_units
from feeddrive.workflow.readings import doubt as doubt_of
from feeddrive.workflow.request import Request, argument, option


@dataclass(frozen=True)
class Mapped:
    """A log with its roles: the column of each role, a doubt about its magnitudes, and the unused columns."""

    log: Log
    columns: dict[str, Column]
    doubt: Doubt
    unused: tuple[str, ...] = ()


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
) -> Mapped:
    """Read the log with its roles in `wanted`.

    named     role -> text from the command line; takes precedence over everything else
    channels  a TOML file with [log.channels], or a `Mapping`; without it, roles that are not named are guessed, and the
              guess is shown
    unit      units of columns that state none and were given none
    steady    True for a log without acceleration ramps, whose accelerations do not indicate its units
    """
    path = path if isinstance(path, OpenedFile) else OpenedFile(path)
    told = {role: Column.of(text) for role, text in named.items() if text is not None}
    optional: abc.Mapping[str, Column] = {}
    open_: dict[str, str] = {}
    skipped = 0
    if channels is not None:
        request = requested(channels, path.path)
        told = {**request.mapping, **told}
        optional, sample_time = request.mapping.optional, sample_time or request.mapping.sample_time
        skipped = request.skip_samples
        mapping = {role: column for role, column in told.items() if role in wanted}
    else:
        mapping, open_ = _guessed_roles(path, told, wanted, sample_time, progress)
    whole = with_units(path, mapping, unit)
    log = read_log(path, whole, optional=optional, sample_time=sample_time).from_row(skipped)
    log = replace(log, left_out={**open_, **log.left_out}) if open_ else log
    sure = {role for role, column in whole.items() if column != mapping[role]}
    sure |= {role for role, column in told.items() if column.unit or column.factor is not None}
    unused = tuple(f"{role} ('{column.name}')" for role, column in told.items() if role not in (*wanted, "time"))
    return Mapped(log, whole, doubt_of(path, log, whole, sure, steady=steady), unused)


def _guessed_roles(
    path: OpenedFile,
    told: abc.Mapping[str, Column],
    wanted: Collection[str],
    sample_time: float | None,
    progress: Progress,
) -> tuple[dict[str, Column], dict[str, str]]:
    """Return the named roles, completed by guesses, which are shown; and why likely columns were rejected."""
    guess = guess_roles(whole_log(path, told.get("time"), sample_time))
    guessed = {role: column for role, column in guess.mapping.items() if role in wanted and role not in told}
    # a column named for one role cannot have another
    taken = {column.name for column in told.values()}
    guessed = {role: column for role, column in guessed.items() if column.name not in taken}
    if guessed or any(role not in told for role in guess.needs):
        show(guess, path, progress)
    mapping = {role: column for role, column in {**guessed, **told}.items() if role in wanted}
    if not set(mapping) - {"time"}:
        names = ", ".join([*guess.unused, *(column.name for column in guess.mapping.values())][:20])
        raise LogError(
            f"{path}: no column is known by its name or unit; there are: {names}. Name them, as "
            f"with --set-position 'r:mm' --position 'x:mm' --force 'f:N', or give them with --channels"
        )
    return mapping, {role: why for role, why in _open(guess, wanted).items() if role not in mapping}


def _open(guess: Guess, wanted: Collection[str]) -> dict[str, str]:
    """Return, by role, why a likely column is not used: a factor is missing, or its cells are not numbers."""
    reasons = {role: f"'{name}' needs a factor, {what}" for role, (name, what) in guess.needs.items()}
    for role, column in guess.mapping.items():
        if role == "current" and role not in wanted:
            reasons[role] = f"'{column.name}' is a current in {column.unit or 'A'} and needs a factor to N"
    for role, (name, why) in guess.lost.items():
        cells = " (cells that are empty, or have a decimal comma in quotes, are no numbers)" if why == "text" else ""
        reasons[role] = f"'{name}' is {why}{cells}"
    return reasons


_ACTING = ("force", "torque", "current", "command")


def no_column(path: Path | OpenedFile, log: Log, roles: Collection[str], what: str, options: str) -> LogError:
    """Return the error for a log without a column of these roles: why likely columns were rejected, or its roles.

    what     the quantity, as `the force`
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
    """Return the log with its mapping. Raise FileError, with the command that writes a mapping, for a missing file."""
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
    read_log(path, {"time": time}, sample_time=sample_time)  # raises if the column is missing
    return read_log(path, optional={"time": time}, sample_time=sample_time, name=name)


def show(guess: Guess, path: Path | OpenedFile, progress: Progress) -> None:
    """Show the guess and how to correct it."""
    progress.remark(guess.table())
    progress.remark(
        f"- These roles are guessed. To correct them: feeddrive channels {path} --out channels.toml, edit that file, "
        f"then --channels channels.toml."
    )


class ChannelsRequest(Request):
    """The log whose columns are guessed, and the output file for the mapping."""

    log: LogLike = argument("A log of any known format")
    axis: str | None = option("axis of a log with several, as x or 0", default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("sample time of a log without a clock", unit="s", default=None)
    out: Path | None = option("File for the mapping (TOML)", short="-o", default=None)


@command(ChannelsRequest)
def channels(request: ChannelsRequest, progress: Progress) -> Outcome[Any]:
    """Guess the role of each column of a log; the section of the outcome is a TOML text to correct for --channels.

    For a file of frequency responses, list the responses, and the controllers in the XML of a tuning tool.
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
    guess = _guessed(request, file)
    if out is None:
        return Outcome(guess, [guess.table()], section=guess.toml(path))
    write_roles(out, guess, path.resolve() if out.parent.resolve() != path.parent.resolve() else path.name)
    return Outcome(guess, [guess.table()], files={"Written": f"{out}; correct it and give it with --channels {out}"})


def _responses(file: OpenedFile) -> Outcome[Any]:
    """Tabulate the frequency responses of a file, and the other values that a tuning tool stored in it."""
    responses = read_frfs(file)
    rows = [
        (
            name,
            frf.output,
            frf.input,
            frf.unit or "not stated",
            int(frf.frequency.size),
            frf.frequency[0],
            frf.frequency[-1],
            "no" if frf.coherence is None else float(np.median(frf.coherence)),
        )
        for name, frf in responses.items()
    ]
    columns = (
        "response",
        "output",
        "input",
        "unit",
        "lines",
        TableColumn("from", "Hz"),
        TableColumn("to", "Hz"),
        TableColumn("coherence, median", form=".3f"),
    )
    tables = [Table(f"frequency responses in {file}: {len(responses)}", columns, rows)]
    if is_ast(file.unpacked):
        for title, values in read_controllers(file).items():
            columns = ("member", TableColumn("value as in the file", form="9"))
            tables.append(Table(title or "all else that the file says", columns, list(values.items())))
    how = "" if len(responses) == 1 else " --motor NAME --load NAME, the names of the responses of the encoders"
    return Outcome(responses, tables, verdict=f"Masses and modes: feeddrive identify {file}{how}")


def _guessed(request: ChannelsRequest, file: OpenedFile) -> Guess:
    """Guess the mapping.

    A time column that is implausible for a servo loop is read in its likeliest unit: the table shows it for correction.
    """
    time = None if request.time is None else Column.of(request.time)
    why = "named on the command line"
    try:
        log = whole_log(file, time, request.sample_time)
    except LogError:
        likely = None if time is not None or request.sample_time is not None else _likely_time(file)
        if likely is None:
            raise
        time, why = likely
        log = whole_log(file, time, None)
    guess = guess_roles(log, request.axis)
    if time is None:
        return guess
    mapping = guess.mapping
    columns, reasons = {"time": time, **mapping}, {**mapping.reasons, "time": why}
    return replace(guess, mapping=replace(mapping, columns=columns, reasons=reasons))


def _likely_time(file: OpenedFile) -> tuple[Column, str] | None:
    """Return the time column with its likeliest unit and the reason; None if it states a unit or none is plausible."""
    name = next((name for name in file.columns.values if is_time(name)), None)
    if name is None or name in file.columns.units or unit_at_the_end(name, "time"):
        return None
    steps = np.diff(file.columns.values[name])
    step = float(np.median(steps)) if steps.size else 0.0
    units_ = time_units(step) if np.isfinite(step) and step > 0.0 else []
    if not units_ or units_[0][0] == "s":
        return None
    other = joined("", (f", in {unit} {Quantity(size, 's')}" for unit, size in units_[1:]))
    unit, size = units_[0]
    why = Text(f"no unit is stated; in {unit} the step is {Quantity(size, 's')}{other}: correct it if wrong")
    return Column(name=name, unit=unit), why
