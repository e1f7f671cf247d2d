"""Play profiles on a drive, write a log of each, and say why if one ended early."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from feeddrive.bus.client import DriveClient, transport_of
from feeddrive.bus.drive_file import DriveFile, read_drive
from feeddrive.bus.pace import Lateness
from feeddrive.bus.play import Played, listened, play
from feeddrive.bus.profile import Profile, read_profile
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.log import write_log
from feeddrive.language.errors import AbortedError, BusError, FeeddriveError
from feeddrive.workflow.excitation_page import WARNING


def perform(
    paths: Sequence[Path], drive_path: Path, share: float, ramp: float, reset_fault: bool, unpaced: bool, yes: bool,
    out: Path,
) -> None:  # fmt: skip
    """All profiles are read and checked before the bus is touched; logs are written also of one that was aborted."""
    console = open_console()
    file = read_drive(drive_path)
    profiles = [read_profile(path, file.drive, share=share, ramp=ramp) for path in paths]
    done: list[Played] = []
    trouble: FeeddriveError | None = None
    if not (yes or unpaced):  # before the bus is opened: a drive in operation does not wait for an answer
        console.print(f"- {WARNING}", markup=False)
        typer.confirm("Is the travel clear, and the stop at hand?", abort=True)
    for profile in profiles:
        try:
            done.append(_play(console, file, profile, unpaced, reset_fault and not done, first=not done))
        except FeeddriveError as error:
            trouble = error
        if trouble is not None or done[-1].aborted:
            break
    written = _write(out, done)
    for played, path in zip(done, written, strict=True):
        _report(console, played, path)
    if trouble is not None:
        raise trouble
    if done and done[-1].aborted:
        raise AbortedError(f"{file.name}: {done[-1].aborted}")


def _play(
    console: Console, file: DriveFile, profile: Profile, unpaced: bool, reset_fault: bool, *, first: bool
) -> Played:
    """The drive is opened for each profile, so that none waits for the log of another."""
    played: Played | None = None
    try:
        with _named(file), _client(file, unpaced) as client:
            if first:
                _greet(console, client)
            if reset_fault:
                client.reset_fault()
            with Progress(TextColumn("{task.description}"), BarColumn(), console=console, transient=True) as bar:
                task = bar.add_task(Path(profile.name).name)

                def show(rows: int, count: int) -> None:
                    bar.update(task, completed=rows, total=count)

                played = play(client, profile, name=Path(profile.name).stem, progress=show)
    except BusError as error:
        if played is None:
            raise
        return replace(played, aborted=str(error))  # it would not be left; what it did is kept all the same
    return played


def perform_listening(drive_path: Path, seconds: float, unpaced: bool, out: Path) -> None:
    """A log of the drive as it stands, or as somebody moves it by hand."""
    console = open_console()
    file = read_drive(drive_path)
    with _named(file), _client(file, unpaced) as client:
        _greet(console, client)
        heard = listened(client, seconds)
    _report(console, heard, _write(out, [heard])[0])


def _client(file: DriveFile, unpaced: bool) -> DriveClient:
    return DriveClient(transport_of(file.drive, file.interface, file.bitrate), file.drive, paced=not unpaced)


@contextlib.contextmanager
def _named(file: DriveFile) -> Generator[None]:
    """An error of the bus begins with the drive file."""
    try:
        yield
    except BusError as error:
        raise BusError(f"{file.name}: {error}") from None


def _greet(console: Console, client: DriveClient) -> None:
    """Which drive it is, and in what state."""
    known = client.identity
    text = ", ".join(f"{key} {known[key]:#x}" for key in ("vendor", "product", "revision") if key in known)
    state = client.state
    console.print(
        f"{client.transport.where}: {known.get('name') or 'a drive without a name'} ({text}), "
        f"{'unknown state' if state is None else state.words}",
        markup=False,
    )
    for remark in client.remarks:
        console.print(f"- {remark}", markup=False)


def _write(out: Path, done: Sequence[Played]) -> list[Path]:
    if not done:
        return []
    names: list[str] = []
    with new_directory(out) as folder:
        for k, played in enumerate(done, start=1):
            name = f"{'aborted' if played.aborted else 'measured'}_{k}.parquet"
            write_log(folder / name, played.log)
            names.append(name)
    return [out / name for name in names]


def _report(console: Console, played: Played, path: Path) -> None:
    console.print(drawn(played.log.table()))
    for remark in played.remarks:
        console.print(f"- {remark}", markup=False)
    if played.lateness is not None:
        console.print(f"- {_late(played.lateness)}", markup=False)
    console.print(f"Log: {path}", markup=False, soft_wrap=True)


def _late(late: Lateness) -> str:
    return (
        f"Cycles began late by {1e6 * late.median:.3g} us in the median, {1e6 * late.often:.3g} us in 99 %, "
        f"{1e6 * late.most:.3g} us at most (this computer, not the drive)."
    )
