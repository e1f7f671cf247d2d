"""The first access to the page: the browser opens a file that holds the token, or Enter prints an address.

The words of a command are read by every user of the machine (`ps`), and so would be a token in the address that a
browser is started with.  A file of this user alone holds it instead, and leads the browser on.
"""

from __future__ import annotations

import os
import select
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable
from html import escape
from pathlib import Path

_REDIRECT = """<!doctype html><html lang="en"><meta charset="utf-8"><title>feeddrive studio</title>
<meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="0;url={address}">
<p><a href="{address}">feeddrive studio</a></p></html>
"""
_OFTEN = 0.5  # s


def write_redirect(address: str, places: Iterable[str | Path | None]) -> list[Path]:
    """Write a page that leads to an address into a folder that no other user can read; return its path.

    places  in which the folder is made, the first that will do; None: that of the system for temporary files

    No path is returned where no place keeps what is private, as some network drives do not.
    """
    for place in places:
        try:
            folder = Path(tempfile.mkdtemp(prefix="open_", dir=place))
        except OSError:
            continue
        path = folder / "feeddrive_studio.html"
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            if _private(folder) and _private(path):
                file.write(_REDIRECT.format(address=escape(address)))
                return [path]
        remove_redirect(path)
    return []


def remove_redirect(path: Path) -> None:
    """Remove the page with its folder."""
    shutil.rmtree(path.parent, ignore_errors=True)


def _private(path: Path) -> bool:
    """True if only this user can read a path; Windows keeps a user's folders by other means than modes."""
    return os.name != "posix" or path.stat().st_mode & 0o077 == 0


def at_enter(act: Callable[[], None], ended: threading.Event) -> bool:
    """Call `act` at each Enter in the terminal until the job has ended; False without a terminal.

    A process in the background must not read from its terminal: the system would stop it.
    """
    if os.name != "posix" or not sys.stdin or not sys.stdin.isatty():
        return False
    handle = sys.stdin.fileno()

    def listen() -> None:
        while not ended.is_set():
            there, _, _ = select.select([handle], [], [], _OFTEN)
            if not there:
                continue
            if os.tcgetpgrp(handle) != os.getpgrp():
                ended.wait(_OFTEN)
            elif not os.read(handle, 1024):
                return
            else:
                act()

    threading.Thread(target=listen, daemon=True).start()
    return True
