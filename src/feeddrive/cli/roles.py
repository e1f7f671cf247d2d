"""Which column of a log is what: as the options say, as a short TOML says, else guessed and shown."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from rich.console import Console

from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.columns import OWN_UNIT, ROLES, Column
from feeddrive.files.guess import Guess, guess_roles, write_roles
from feeddrive.files.job import LogRequest, read_request
from feeddrive.files.log import Log
from feeddrive.files.read_log import read_log
from feeddrive.language import units
from feeddrive.language.errors import FileError, LogError, ParameterError


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
    path: Path,
    named: Mapping[str, str | None],
    channels: Path | None,
    wanted: Collection[str],
    sample_time: float | None,
    console: Console,
) -> tuple[Log, dict[str, Column]]:
    """The log with its roles in `wanted`, and which column has which.

    named     role -> text of the command line; what is named goes before all else
    channels  a TOML file with [log.channels]; without it roles that are not named are guessed, and the guess is shown
    """
    told = {role: column(text, role) for role, text in named.items() if text is not None}
    if channels is not None:
        request = requested(channels, path)
        mapping = {role: each for role, each in {**request.channels, **told}.items() if role in wanted}
        log = read_log(path, mapping, optional=request.optional, sample_time=sample_time or request.sample_time)
        return log, mapping
    guess = guess_roles(read_log(path, sample_time=clock(path, named.get("time"), sample_time)))
    guessed = {role: each for role, each in guess.mapping.items() if role in wanted and role not in told}
    # a column that was named for one role does not stand for another
    taken = {each.name for each in told.values()}
    guessed = {role: each for role, each in guessed.items() if each.name not in taken}
    if guessed or any(role not in told for role in guess.needs):
        show(guess, path, console)
    mapping = {role: each for role, each in {**guessed, **told}.items() if role in wanted}
    if not set(mapping) - {"time"}:
        names = ", ".join([*guess.unused, *(each.name for each in guess.mapping.values())][:20])
        raise LogError(
            f"{path}: no column says by its name or unit what is wanted here; there are: {names}. Name them, as "
            f"with --position 'x:mm' --force 'f:N', or give them with --channels"
        )
    return read_log(path, mapping, sample_time=sample_time), mapping


def requested(channels: Path, path: Path) -> LogRequest:
    """The log with the roles of a TOML file. Raises FileError for a file that is not there, with how to make one."""
    if not channels.exists():
        how = f"feeddrive channels {path} --out {channels} writes one to correct"
        raise FileError(f"{channels}: no such file; {how}")
    return read_request(channels, path)


def clock(path: Path, time: str | None, sample_time: float | None) -> float | None:
    """The sample time of a log whose column of time has another name than the usual ones."""
    return (
        sample_time
        if time is None
        else read_log(path, {"time": column(time, "time")}, sample_time=sample_time).sample_time
    )


def show(guess: Guess, path: Path, console: Console) -> None:
    """The guess, and how to correct it."""
    console.print(drawn(guess.table(), 3))
    console.print(
        f"- These roles are guessed. To correct them: feeddrive channels {path} --out channels.toml, edit that file, "
        f"then --channels channels.toml.",
        markup=False,
        soft_wrap=True,
    )


def perform(path: Path, axis: str | None, sample_time: float | None, out: Path | None) -> None:
    """`feeddrive channels`: guess, show, and write what is to be corrected by hand."""
    console = open_console()
    guess = guess_roles(read_log(path, sample_time=sample_time), axis)
    console.print(drawn(guess.table(), 3))
    if out is None:
        console.print("")
        console.print(guess.toml(path), markup=False, soft_wrap=True)
        return
    write_roles(out, guess, path.resolve() if out.parent.resolve() != path.parent.resolve() else path.name)
    console.print(f"Written: {out}; correct it and give it with --channels {out}", markup=False, soft_wrap=True)
