"""`feeddrive channels`, and for all commands the mapping of the columns of a log to roles.

The mapping comes from the options, from a TOML file, or else is guessed and shown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.columns import OWN_UNIT, ROLES, Column
from feeddrive.files.formats import OpenedFile
from feeddrive.files.frf import names_frequency, read_controllers, read_frfs
from feeddrive.files.guess import Guess, guess_roles, write_roles
from feeddrive.files.job import LogRequest, read_request
from feeddrive.files.log import Log, LogLike
from feeddrive.files.read_log import read_log
from feeddrive.files.readers.ast_xml import is_ast
from feeddrive.language import units
from feeddrive.language.errors import FileError, LogError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import Request, argument, option


def column(text: str, role: str = "") -> Column:
    """`name`, `name:unit`, `name*factor` (to SI) or, for a known role, `name*factor:unit` of the command line.

    Raises ParameterError for a factor that is none.
    """
    name, star, number = text.rpartition("*")
    if star:
        number, _, unit = number.partition(":")
        try:
            factor = float(number)
        except ValueError:
            raise ParameterError(f"'{text}': the factor after * must be a number, as in act*2e-8") from None
        if role in OWN_UNIT:
            return Column(name=name, unit=unit, factor=factor)
        return Column(name=name, factor=factor * (units.factor(unit, ROLES.get(role, unit)) if unit else 1.0))
    name, _, unit = text.partition(":")
    return Column(name=name, unit=unit)


def mapped(
    path: Path | OpenedFile,
    named: Mapping[str, str | None],
    channels: Path | None,
    wanted: Collection[str],
    sample_time: float | None,
    progress: Progress,
) -> tuple[Log, dict[str, Column]]:
    """The log with its roles in `wanted`, and which column has which.

    named     role -> text of the command line; what is named goes before all else
    channels  a TOML file with [log.channels]; without it roles that are not named are guessed, and the guess is shown
    """
    path = path if isinstance(path, OpenedFile) else OpenedFile(path)
    told = {role: column(text, role) for role, text in named.items() if text is not None}
    if channels is not None:
        request = requested(channels, path.path)
        mapping = {role: each for role, each in {**request.channels, **told}.items() if role in wanted}
        log = read_log(path, mapping, optional=request.optional, sample_time=sample_time or request.sample_time)
        return log, mapping
    guess = guess_roles(read_log(path, sample_time=clock(path, named.get("time"), sample_time)))
    guessed = {role: each for role, each in guess.mapping.items() if role in wanted and role not in told}
    # a column that was named for one role does not stand for another
    taken = {each.name for each in told.values()}
    guessed = {role: each for role, each in guessed.items() if each.name not in taken}
    if guessed or any(role not in told for role in guess.needs):
        show(guess, path, progress)
    mapping = {role: each for role, each in {**guessed, **told}.items() if role in wanted}
    if not set(mapping) - {"time"}:
        names = ", ".join([*guess.unused, *(each.name for each in guess.mapping.values())][:20])
        raise LogError(
            f"{path}: no column is known by its name or unit; there are: {names}. Name them, as "
            f"with --position 'x:mm' --force 'f:N', or give them with --channels"
        )
    return read_log(path, mapping, sample_time=sample_time), mapping


def requested(channels: Path, path: Path) -> LogRequest:
    """The log with the roles of a TOML file. Raises FileError for a file that is not there, with how to make one."""
    if not channels.exists():
        how = f"feeddrive channels {path} --out {channels} writes one to correct"
        raise FileError(f"{channels}: no such file; {how}")
    return read_request(channels, path)


def clock(path: Path | OpenedFile, time: str | None, sample_time: float | None) -> float | None:
    """The sample time of a log whose column of time has another name than the usual ones."""
    return (
        sample_time
        if time is None
        else read_log(path, {"time": column(time, "time")}, sample_time=sample_time).sample_time
    )


def show(guess: Guess, path: Path | OpenedFile, progress: Progress) -> None:
    """The guess, and how to correct it."""
    progress.remark(guess.table())
    progress.remark(
        f"- These roles are guessed. To correct them: feeddrive channels {path} --out channels.toml, edit that file, "
        f"then --channels channels.toml."
    )


class ChannelsRequest(Request):
    """Which log is looked at."""

    log: LogLike = argument("A log of any known format")
    axis: str | None = option("of a log with several, as x or 0", default=None)
    sample_time: float | None = option("of a log without a clock", unit="s", default=None)
    out: Path | None = option("File for the mapping (TOML)", short="-o", default=None)


@command(ChannelsRequest)
def channels(request: ChannelsRequest, progress: Progress) -> Outcome[Any]:
    """Guess which column of a log is what; the section of the outcome is a TOML to correct and give with --channels.

    Of a file of frequency responses it lists these, and the controllers that the XML of a tuning tool holds.
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
    guess = guess_roles(read_log(file, sample_time=request.sample_time), request.axis)
    if out is None:
        return Outcome(guess, [guess.table()], section=guess.toml(path))
    write_roles(out, guess, path.resolve() if out.parent.resolve() != path.parent.resolve() else path.name)
    return Outcome(guess, [guess.table()], files={"Written": f"{out}; correct it and give it with --channels {out}"})


def _responses(file: OpenedFile) -> Outcome[Any]:
    """The frequency responses of a file, and what else a tuning tool wrote there."""
    found = read_frfs(file)
    rows = [
        (
            name,
            frf.output,
            frf.input,
            frf.unit or "not stated",
            str(frf.frequency.size),
            f"{frf.frequency[0]:.4g} to {frf.frequency[-1]:.4g}",
            "no" if frf.coherence is None else f"{float(np.median(frf.coherence)):.3f}",
        )
        for name, frf in found.items()
    ]
    heads = ("response", "output", "input", "unit", "lines", "Hz", "coherence, median")
    tables = [Table(f"frequency responses in {file}: {len(found)}", heads, rows)]
    if is_ast(file.unpacked):
        for title, values in read_controllers(file).items():
            shown = [(key, value if isinstance(value, str) else f"{value:.9g}") for key, value in values.items()]
            tables.append(Table(title or "all else that the file says", ("member", "value as in the file"), shown))
    how = "" if len(found) == 1 else " --motor NAME --load NAME, the names of the responses of the encoders"
    return Outcome(found, tables, verdict=f"Masses and modes: feeddrive identify {file}{how}")
