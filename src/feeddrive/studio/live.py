"""What the room Scope may follow, and the thread that follows it for one page."""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from feeddrive.analysis.oscilloscope import LiveSource, Oscilloscope
from feeddrive.files.growing import Pipe
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.studio.jobs import fault
from feeddrive.workflow.follow import PIPE, opened

_OFTEN = 0.025  # s between two looks at the source
_DESERTED = 10.0  # s without an open page after which a source is let go
_MANY = 50  # files of the folder that are offered, the newest
_TABLES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc", "")
_GOING = weakref.WeakSet["Following"]()  # of all pages
_FILE, _DRIVE, _OF_PIPE = "table that grows", "drive, sampled and not moved", "pipe"


@dataclass(frozen=True)
class Offered:
    """Something that may be followed: its kind in words, and the folder that it must not leave."""

    path: Path
    kind: str
    inside: Path | None = None


class Followable:
    """What may be followed: what was named on the command line, and tables that stand directly in the folder.

    A page names one of them by its text and nothing else, so that it reaches no other file and no other bus.

    named   tables and drive files, or - for the pipe
    folder  of the pages; None: nothing but what was named
    """

    def __init__(self, named: tuple[Path, ...] = (), folder: Path | None = None, pipe: Pipe | None = None) -> None:
        self._named, self._folder, self.pipe = named, folder, pipe

    @property
    def hint(self) -> str:
        """How something else comes among them, as a sentence."""
        where = "" if self._folder is None else f", or write a table into {self._folder}"
        return f"Others: name them with --follow when feeddrive studio is started{where}."

    def offered(self) -> dict[str, Offered]:
        """All of it, by its text."""
        found = dict[str, Offered]()
        for path in self._named:
            kind = _OF_PIPE if str(path) == PIPE else _DRIVE if path.suffix.lower() == ".toml" else _FILE
            found[str(path)] = Offered(path, kind)
        if self._folder is not None and self._folder.is_dir():
            with os.scandir(self._folder) as listed:
                there = [(each.stat(follow_symlinks=False).st_mtime, each.path) for each in listed if _table(each)]
            for _, path in sorted(there, reverse=True)[:_MANY]:
                found.setdefault(path, Offered(Path(path), _FILE, self._folder))
        return found

    def open(self, name: str, sample_time: float | None, time_unit: str | None) -> LiveSource:
        """Begin to follow one of them. Raises ParameterError for any other one, and the errors of `opened`."""
        found = self.offered().get(name)
        if found is None:
            raise ParameterError(f"{name!r:.80} may not be followed. {self.hint}")
        pipe = self.pipe if found.kind == _OF_PIPE else None
        return opened(found.path, pipe, sample_time=sample_time, time_unit=time_unit, inside=found.inside)


def _table(entry: os.DirEntry[str]) -> bool:
    suffix = Path(entry.name).suffix.lower()
    return entry.is_file(follow_symlinks=False) and not entry.name.startswith(".") and suffix in _TABLES


def stop_all() -> None:
    """Let all sources of all pages go, as at the end of the server: a drive is left in order."""
    for each in tuple(_GOING):
        each.stop()


class Following:
    """A source that is followed by a thread, until it is stopped or no page is open any longer.

    watched()  whether a page is open
    """

    def __init__(self, source: LiveSource, scope: Oscilloscope, watched: Callable[[], bool]) -> None:
        self.source, self.scope = source, scope
        self.lock = threading.Lock()  # of the oscilloscope
        self.failed = ""  # why it ended
        self.rate = 0.0  # rows a second
        self._watched, self._stop = watched, threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()
        _GOING.add(self)

    @property
    def going(self) -> bool:
        """Whether it still follows."""
        return self._thread.is_alive() and not self._stop.is_set()

    def stop(self) -> None:
        """End it, and wait for that."""
        self._stop.set()
        self._thread.join(5.0)

    def units(self) -> Mapping[str, str]:
        """Of the channels, as the source states them."""
        return self.scope.channels

    def state(self) -> str:
        """How it stands, as a sentence."""
        if self.failed:
            return self.failed
        return self.source.state() if self.going else "stopped"

    def _follow(self) -> None:
        seen, counted, since = time.monotonic(), 0, time.monotonic()
        try:
            while not self._stop.wait(_OFTEN):
                now = time.monotonic()
                seen = now if self._watched() else seen
                if now - seen > _DESERTED:
                    self.failed = "stopped, since no page was open"
                    return
                with self.lock:
                    counted += self.scope.feed(self.source)
                if now - since > 1.0:
                    self.rate, counted, since = counted / (now - since), 0, now
        except FeeddriveError as error:
            self.failed = str(error)
        except Exception as error:  # a fault of feeddrive: the page says that nothing is followed any longer
            self.failed = fault(error)
        finally:
            self.source.close()
