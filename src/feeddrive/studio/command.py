"""`feeddrive studio`: serve the page of an axis and open it in a browser, until Ctrl-C.

Any user of the computer can read command lines (`ps`), including a token in an address that is passed to a browser.
Therefore the browser opens a redirect page, which contains the token and which only this user can read.
"""

from __future__ import annotations

import json
import os
import secrets
import select
import shutil
import socket
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

from feeddrive.bus.drive_file import read_drive
from feeddrive.evaluation.scheduler import is_loopback
from feeddrive.export.linuxcnc_file import read_linuxcnc_file
from feeddrive.files.atomic_io import refusal
from feeddrive.files.growing import Pipe
from feeddrive.files.toml_file import read_toml
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio.bench import Bench, bench_of
from feeddrive.studio.desk import Desk
from feeddrive.studio.jobs import end_all
from feeddrive.studio.live import Followable, stop_all
from feeddrive.studio.protection import OPTION, STANDARD_INPUT, Door, read_password
from feeddrive.studio.rooms.tune import Tune
from feeddrive.studio.server import PAGE, make_app, serve
from feeddrive.studio.stored import write_all
from feeddrive.workflow.command import Outcome, Request, argument, command, option
from feeddrive.workflow.follow import PIPE, check_followed
from feeddrive.workflow.tune_sources import machine_of

_REDIRECT = """<!doctype html><html lang="en"><meta charset="utf-8"><title>feeddrive studio</title>
<meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="0;url={address}">
<p><a href="{address}">feeddrive studio</a></p></html>
"""
_OFTEN = 0.5  # s
_DOOR = ".door.json"  # in the folder of the pages
_SAME_DOOR = 43_200.0  # s for which a cookie is used by servers that begin
_SECRET = 32  # characters of a cookie


def write_redirect(address: str, places: Iterable[str | Path | None]) -> list[Path]:
    """Create a redirect page to an address, in a folder that no other user can read; return a list with its path.

    places  candidate parent folders; the first suitable one is used; None: the system's temporary folder

    The list is empty if no candidate supports private permissions, as on some network drives.
    """
    for place in places:
        try:
            folder = Path(tempfile.mkdtemp(prefix="open_", dir=place))
        except OSError:
            continue
        path = folder / "feeddrive_studio.html"
        # private from the first moment, and never a file that somebody else has put there
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            if _private(folder) and _private(path):
                file.write(_REDIRECT.format(address=escape(address)))
                return [path]
        remove_redirect(path)
    return []


def remove_redirect(path: Path) -> None:
    """Remove the redirect page with its folder."""
    shutil.rmtree(path.parent, ignore_errors=True)


def _private(path: Path) -> bool:
    """Return True if only this user can read a path; always True on Windows, where user folders are private."""
    return os.name != "posix" or path.stat().st_mode & 0o077 == 0


def at_enter(act: Callable[[], None], ended: threading.Event) -> bool:
    """Start a thread that calls `act` whenever Enter is pressed in the terminal; return False if there is no terminal.

    The thread ends when `ended` is set.  While the process is in the background, it does not read from the terminal,
    since the system would stop it.
    """
    if os.name != "posix" or not sys.stdin or not sys.stdin.isatty():
        return False
    handle = sys.stdin.fileno()

    def listen() -> None:
        while not ended.is_set():
            # with a timeout, so that the thread ends with the server
            there, _, _ = select.select([handle], [], [], _OFTEN)
            if not there:
                continue
            if os.tcgetpgrp(handle) != os.getpgrp():
                ended.wait(_OFTEN)
            # nothing to read means that the terminal was closed
            elif not os.read(handle, 1024):
                return
            else:
                act()

    threading.Thread(target=listen, daemon=True).start()
    return True


HOST = "127.0.0.1"  # reachable from this machine only
_EVERY = ("0.0.0.0", "::")  # all addresses of the machine


def _prepare(bench: Bench, folder: Path) -> None:
    """Compute the initial pictures, so that imports and compilation are complete before the first request."""
    desk = Desk(folder)
    desk.put(bench)
    Tune(desk).show()


class StudioRequest(Request):
    """The axis to open, and the address at which the page is served."""

    source: str | None = argument(
        "A machine file (TOML), the name of a bundled machine, a log, frequency responses or a part program; none: the "
        "page asks",
        default=None,
    )
    axis: str | None = option("axis of a machine file; the only one if left out", default=None)
    tour: bool = option("begin with a guided tour: from a simulated log to an exported control", default=False)
    follow: tuple[Path, ...] = option(
        "source that the room Scope may follow: a table that grows, - for rows from a pipe, or a drive file of a "
        "drive, which "
        "is sampled and not moved; may be repeated. Tables in --folder and a log that is opened may be followed anyway",
        default=(),
    )
    commission: tuple[Path, ...] = option(
        "drive file, or file of an axis of LinuxCNC, whose axis the room Commission may move once its questions are "
        "answered there; may be repeated; only for a page on this machine",
        default=(),
    )
    folder: Path = option(
        "directory in which each page keeps uploaded files and its results; nothing else is written",
        default=Path("results/studio"),
    )
    host: str = option(
        "address at which the page listens: another one than 127.0.0.1 is open to the network, and needs "
        "--password-file",
        default=HOST,
    )
    password_file: Path | None = option(
        "file whose first line is the password that opens the page to others on the network, 12 characters at least; "
        "- reads it from standard input",
        default=None,
    )
    port: int = option("port of the page on this machine; 0: any free one", default=0, least=0, most=65535)
    no_browser: bool = option("open no browser: print the address alone", default=False)

    def check(self) -> None:
        """Raise ParameterError if the page is open to the network without a password or with a drive that it may move,
        or if two initial sources are named.
        """
        if self.tour and self.source is not None:
            raise ParameterError(f"--tour brings a log of its own: leave {self.source} out, and bring it afterwards")
        if self.password_file is None and not is_loopback(self.host):
            raise ParameterError(
                f"--host {self.host}: others on the network could open the page: give a {OPTION} too, or leave "
                "--host out and come through a tunnel (ssh -L)"
            )
        if self.commission and not is_loopback(self.host):
            raise ParameterError(
                f"--commission with --host {self.host}: whoever moves an axis must stand at its stop, so its drive is "
                "commissioned from this machine alone: leave --host out"
            )
        if str(self.password_file) == STANDARD_INPUT and PIPE in map(str, self.follow):
            raise ParameterError(f"{OPTION} - and --follow - both read standard input: write the password into a file")


@command(StudioRequest)
def studio(request: StudioRequest, progress: Progress) -> Outcome[Bench | None]:
    """Serve a page on which an axis is imported, inspected, tuned, proven and exported, until Ctrl-C.

    Raises MissingExtraError if the extra `studio` is not installed, and ParameterError if the port is in use or the
    page was not built.
    """
    bench, brought = None, tuple[Path, ...]()
    if request.source is not None:
        machine = machine_of(request.source)
        path = Path(request.source)
        if machine is not None and (request.axis is not None or len(machine.loops) == 1):
            bench = bench_of(request.source, request.axis)
        elif path.exists():
            brought = (path.resolve(),)
        elif machine is not None:
            raise ParameterError(f"{request.source} has several axes: give one with --axis: {', '.join(machine.loops)}")
        else:
            raise FileError(f"{request.source}: no such file")
    check_followed(request.follow)
    for path in request.commission:
        reader = read_linuxcnc_file if "hal" in read_toml(path).content else read_drive
        reader(path)
    password = "" if request.password_file is None else read_password(request.password_file)
    if not (PAGE / "index.html").is_file():
        raise ParameterError(
            "this installation holds no built page: in a clone of the repository run  make studio  once, which needs "
            "node and npm"
        )
    if bench is not None:
        _prepare(bench, request.folder)
    closed = not password and is_loopback(request.host)
    with writable(request.folder):
        at, secret = same_door(request) if closed else (listening(request.host, request.port), "")
        with at:
            serve_at(at, request, password, bench, brought, progress, secret)
    return Outcome(bench)


@dataclass(frozen=True)
class LastDoor:
    """Where the last server of a folder listened, and the cookie of its pages.

    since  time at which the cookie was made, s since 1970
    """

    port: int
    secret: str
    since: float


def same_door(request: StudioRequest) -> tuple[socket.socket, str]:
    """Return a listening socket and the value of the cookie: those of the last server in this folder where possible.

    Pages that are still open when a server has ended then come back by themselves once it is started again. The value
    of the cookie is kept in a file that only this user can read, and is used for 12 hours.
    """
    path = request.folder / _DOOR
    last = last_door(path)
    if last is not None and request.port in (0, last.port):
        try:
            return listening(request.host, last.port), last.secret
        except ParameterError:
            if request.port:
                raise
            # another server of this folder is running: its pages keep their door
            return listening(request.host, 0), ""
    at = listening(request.host, request.port)
    fresh = LastDoor(at.getsockname()[1], secrets.token_urlsafe(24), time.time())
    with suppress(OSError):
        path.unlink(missing_ok=True)
        # private from the first moment, and never a file that somebody else has put there
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            if _private(path):
                json.dump(asdict(fresh), file)
    return at, fresh.secret


def last_door(path: Path) -> LastDoor | None:
    """Read where the last server listened; None if nobody can tell, others could read it, or it is too long ago."""
    try:
        if path.is_symlink() or not _private(path):
            return None
        kept: Any = json.loads(path.read_text(encoding="utf-8"))
        last = LastDoor(int(kept["port"]), str(kept["secret"]), float(kept["since"]))
        valid = len(last.secret) >= _SECRET and 0.0 <= time.time() - last.since <= _SAME_DOOR
        return last if valid else None
    except (OSError, ValueError, TypeError, KeyError):
        return None


@contextmanager
def writable(folder: Path) -> Generator[None]:
    """Create the folder, and direct temporary files into it during the block.

    Raises FileError with a remedy if the folder cannot be written to.
    """
    before = os.environ.get("TMPDIR")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        place = tempfile.mkdtemp(prefix="temporary_", dir=folder.resolve())
    except OSError as error:
        raise FileError(f"--folder {refusal(folder, 'written', error)}") from None
    # inherited by the processes that read and compute, so that they write nothing elsewhere
    os.environ["TMPDIR"] = place
    try:
        yield
    finally:
        os.environ.pop("TMPDIR")
        if before is not None:
            os.environ["TMPDIR"] = before
        shutil.rmtree(place, ignore_errors=True)


def listening(host: str, port: int) -> socket.socket:
    """Return a listening socket at an address of this machine.

    Raises ParameterError if the port is in use or the address belongs to another machine.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        server = socket.socket(family)
        # makes a port usable that a server left a moment ago; on Windows it would share the port with another server
        if os.name == "posix":
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind(address)
            server.listen()
        except OSError:
            server.close()
            raise
    except OSError as error:
        raise ParameterError(
            f"--host {host} --port {port}: cannot be used ({error.strerror}): choose another one, or port 0 for a "
            "free one"
        ) from None
    return server


def serve_at(
    at: socket.socket,
    request: StudioRequest,
    password: str,
    bench: Bench | None,
    brought: tuple[Path, ...],
    progress: Progress,
    secret: str = "",
) -> None:
    """Serve the page at a socket until Ctrl-C, which also ends the jobs of all pages.

    secret  value of the cookie; empty: a new one
    """
    port = at.getsockname()[1]
    named = f"[{request.host}]" if ":" in request.host else request.host
    every = port if request.host in _EVERY else None
    hosts = tuple(f"{host_name}:{port}" for host_name in (named, "localhost", socket.gethostname()))
    # the name of the machine in the network is accepted only if others may connect
    door = Door(hosts if password else hosts[:2], password, every)
    if secret:
        door = replace(door, secret=secret)
    address, ended = f"http://{named if every is None else socket.gethostname()}:{port}/", threading.Event()

    def fresh(used: Callable[[], None] = lambda: None) -> str:
        """Return an address that opens the page; without a password it is valid only once."""
        return address if password else f"{address}?token={door.tokens.issue(used)}"

    redirects = list[Path]()  # what opens the browser, until it has done so
    pipe = Pipe(sys.stdin.buffer) if PIPE in map(str, request.follow) else None
    live = Followable((*request.follow, *brought), request.folder, pipe)

    def ready() -> None:
        if not is_loopback(request.host):
            progress.remark(
                f"Everyone on the network who knows the password can open this page and use this machine's processor "
                f"through it, and what is sent is not encrypted: only for a network that you trust. Files stay in "
                f"{request.folder}."
            )
        progress.remark(fresh())
        if not password and pipe is None and at_enter(lambda: progress.remark(fresh()), ended):
            progress.remark("It opens the page once; the browser that it opened stays in. Enter prints another one.")
        if not request.no_browser:
            # in a thread, since a text browser in the terminal returns only when it is left
            threading.Thread(target=browse, daemon=True).start()

    def forget() -> None:
        while redirects:
            remove_redirect(redirects.pop())

    def browse() -> None:
        if not password:
            # the folder of the page first; it may be on a file system without permissions
            places = (os.environ.get("TMPDIR"), os.environ.get("XDG_RUNTIME_DIR"), None)
            redirects.extend(write_redirect(fresh(forget), places))
        if not password and not redirects:
            progress.remark("No folder here is closed to other users: open this address in a browser.")
        elif not webbrowser.open(redirects[0].as_uri() if redirects else address):
            forget()
            progress.remark("No browser was found on this machine: open this address in one.")

    app = make_app(
        bench, door, request.folder, brought=brought, live=live, drives=request.commission, tour=request.tour
    )
    try:
        # Ctrl-C is the usual end
        with suppress(KeyboardInterrupt):
            serve(app, at, ready)
    finally:
        ended.set()
        forget()
        write_all()
        end_all()
        stop_all()
