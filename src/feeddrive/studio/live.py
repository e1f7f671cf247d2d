"""The live sources of the tab Scope, and the thread that follows one of them for a page."""

import os
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from feeddrive.analysis.oscilloscope import LiveSource, Oscilloscope, Rows
from feeddrive.analysis.replay import path_of
from feeddrive.files.growing import Pipe
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.loop.simulate import simulate
from feeddrive.studio.jobs import fault
from feeddrive.workflow.follow import PIPE, opened

_OFTEN = 0.025  # s between two looks at the source
# s without an open page after which a source is released: it must outlive a reload of the page
_DESERTED = 10.0
_MANY = 50  # files of the folder that are offered, the newest
_TABLES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc", "")
# weak references: a follower that has ended may go with its page
_GOING = weakref.WeakSet["Following"]()  # of all pages
EXAMPLE = "example"
"""The name of the bundled source."""
OF_EXAMPLE = "ball screw, simulated"
_CHANNELS = {"set position": "m", "actual position": "m", "following error": "m", "drive force": "N"}
_RATE = 1000.0  # rows a second that the example gives
_FILE, _DRIVE, _OF_PIPE = "table that grows", "drive, sampled and not moved", "pipe"


@dataclass(frozen=True)
class Offered:
    """A source that may be followed: its path, its kind in words, and the folder that must contain it."""

    path: Path
    kind: str
    inside: Path | None = None


class Followable:
    """The sources that may be followed: those named on the command line, and tables directly in the folder.

    A page can select a source only by one of these names, so that it has no access to other files or buses.

    named   tables and drive files, or - for the pipe
    folder  folder of the pages; None: only the named sources
    """

    def __init__(self, named: tuple[Path, ...] = (), folder: Path | None = None, pipe: Pipe | None = None) -> None:
        self._named, self._folder, self.pipe = named, folder, pipe

    @property
    def hint(self) -> str:
        """A sentence on how to add another source."""
        where = "" if self._folder is None else f", or write a table into {self._folder}"
        return f"Others: name files or drives to follow when feeddrive studio is started{where}."

    def offered(self) -> dict[str, Offered]:
        """Return all sources by name."""
        sources = dict[str, Offered]()
        for path in self._named:
            kind = _OF_PIPE if str(path) == PIPE else _DRIVE if path.suffix.lower() == ".toml" else _FILE
            sources[str(path)] = Offered(path, kind)
        if self._folder is not None and self._folder.is_dir():
            with os.scandir(self._folder) as listed:
                # a symbolic link could lead to a file outside of the folder
                there = [(entry.stat(follow_symlinks=False).st_mtime, entry.path) for entry in listed if _table(entry)]
            for _, path in sorted(there, reverse=True)[:_MANY]:
                # a table named on the command line keeps its own entry, which is not confined to the folder
                sources.setdefault(path, Offered(Path(path), _FILE, self._folder))
        return sources

    def open(self, name: str, sample_time: float | None, time_unit: str | None) -> LiveSource:
        """Open a source by name. Raises ParameterError for an unknown source, and the errors of `opened`."""
        if name == EXAMPLE:
            return Playback()
        source = self.offered().get(name)
        if source is None:
            raise ParameterError(f"{name!r:.80} may not be followed. {self.hint}")
        pipe = self.pipe if source.kind == _OF_PIPE else None
        return opened(source.path, pipe, sample_time=sample_time, time_unit=time_unit, inside=source.inside)


class Playback:
    """The bundled source: strokes of the axis of the tour, simulated and played in real time, over and over.

    ahead  s that have passed when it begins
    """

    name = EXAMPLE
    clock = "s"
    over = False
    channels: Mapping[str, str] = _CHANNELS

    def __init__(self, ahead: float = 0.0) -> None:
        self._begun, self._given = time.monotonic() - ahead, 0

    def take(self) -> Rows:
        """Return the rows of the time that has passed since the last call."""
        rows = _strokes()
        to = int(_RATE * (time.monotonic() - self._begun))
        # a server that slept for a while has nothing new to show but the last stroke
        numbers = np.arange(max(self._given, to - len(rows)), to)
        self._given = max(self._given, to)
        return Rows(numbers / _RATE, rows[numbers % len(rows)])

    def state(self) -> str:
        """Return what is played."""
        return f"plays the bundled example: {OF_EXAMPLE}"

    def close(self) -> None:
        """Nothing is held."""


@cache
def _strokes() -> np.ndarray:
    """Return the signals of the tour's axis, by row, in the units of `_CHANNELS`."""
    from feeddrive.workflow.tour import SEED, axis, strokes

    loop = axis()
    T = float(loop.sample_time)
    run = simulate(loop, path_of(loop.control, strokes(T), T), seed=SEED, name=EXAMPLE)
    step = round(1.0 / (_RATE * T))
    # to a picometer and a millinewton: further digits are rounding
    signals = {"set_position": 12, "position_load": 12, "following_error": 12, "force": 3}
    return np.column_stack([np.round(run[name][::step], digits) for name, digits in signals.items()])


def _table(entry: os.DirEntry[str]) -> bool:
    suffix = Path(entry.name).suffix.lower()
    return entry.is_file(follow_symlinks=False) and not entry.name.startswith(".") and suffix in _TABLES


def stop_all() -> None:
    """Release all sources of all pages, so that a drive is left in a defined state when the server stops."""
    for following in tuple(_GOING):
        following.stop()


class Following:
    """A thread that follows a source until it is stopped or no page is open.

    watched()  returns True while a page is open
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
        """True while the source is being followed."""
        return self._thread.is_alive() and not self._stop.is_set()

    def stop(self) -> None:
        """Stop the thread, and wait for its end."""
        self._stop.set()
        self._thread.join(5.0)

    def units(self) -> Mapping[str, str]:
        """Return the units of the channels, as stated by the source."""
        return self.scope.channels

    def state(self) -> str:
        """Return a status sentence: receiving rows, waiting, or skipped rows."""
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
        except Exception as error:
            # a fault of feeddrive: the page shows that nothing is followed any longer
            self.failed = fault(error)
        finally:
            self.source.close()
