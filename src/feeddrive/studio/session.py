"""One page that is open: its rooms over one desk, one request at a time."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.quantity import number
from feeddrive.studio.bench import Bench
from feeddrive.studio.desk import Desk
from feeddrive.studio.jobs import DONE, Found, Job, JobState, Work, fault
from feeddrive.studio.live import Followable
from feeddrive.studio.room import Asked, Room, Said
from feeddrive.studio.rooms import ROOMS
from feeddrive.studio.rooms.tour import Tour
from feeddrive.studio.wire import Window, message

# labels of fields on the page, by the options that errors of the commands name
FIELDS = {
    "--sample-time": "Sample time",
    "--baseline": "Today's machine",
    "--unit": "Unit",
    "--delay": "Dead time",
    "--machine": "Machine file to start from",
    "--lead": "Lead of the screw",
    "--load": "Response of the table",
    "--motor": "Response of the motor's encoder",
    "--force-constant": "N per unit of the command",
}
Push = Callable[[str, bytes], None]
_WINDOWS = 50  # parts of x that are looked at: labels come from the page


class Session:
    """The state of one page.

    folder  its own directory: what it reads and writes stands there
    bench, brought  to begin with
    live    what may be followed
    tour    begin with the guided tour
    """

    def __init__(
        self,
        folder: Path,
        bench: Bench | None = None,
        brought: tuple[Path, ...] = (),
        live: Followable | None = None,
        *,
        tour: bool = False,
    ) -> None:
        self.desk = Desk(folder, brought, live)
        self.desk.changed, self.desk.tell, self.desk.begun = self._another, self.push, self._start
        self.rooms: dict[str, Room] = {each.name: each(self.desk) for each in ROOMS}
        self._tour = Tour(self.desk)
        self.rooms[Tour.name] = self._tour
        self._pushes = list[Push]()
        self._windows: dict[tuple[str, str], Window] = {}  # by room and label of x
        self.desk.watched = lambda: self.heard
        self._lock = threading.RLock()
        if bench is not None:
            self.desk.put(bench)
        if tour:
            self.answer({"do": "bring.tour"})

    def answer(self, asked: Mapping[str, Any]) -> bytes:
        """The message that a request of the page gets: what its room says, or what is wrong with the request."""
        given = asked.get("number")
        number = given if isinstance(given, int) else 0
        name, _, act = str(asked.get("do")).partition(".")
        try:
            if name == "job":
                self._job(act)
                return self._message(number, "", Said())
            if name == "view":
                name, act = self._view(act, Asked(asked)), "show"
            if name not in self.rooms:
                raise ParameterError(f"the page asks for '{name:.60}', which is none of {', '.join(self.rooms)}")
            with self._lock:
                said = self.rooms[name].do(act, Asked(asked))
                self._tour.heard(f"{name}.{act}")
                return self._message(number, name, said)
        except FeeddriveError as error:
            said = str(error)
        except Exception as error:  # the page goes on, and says what to report
            said = fault(error)
        return self._message(number, name if name in self.rooms else "", Said({"error": said}))

    def listen(self, push: Push) -> Callable[[], None]:
        """Get what is said without a request, each with what it replaces: the room, or the job. What is given back ends
        it.
        """
        self._windows.clear()  # a page that has just been loaded looks at all
        self._pushes.append(push)
        return lambda: self._pushes.remove(push)

    @property
    def heard(self) -> bool:
        """Whether a page listens."""
        return bool(self._pushes)

    def push(self, name: str) -> None:
        """Show a room again, unasked."""
        with self._lock:
            try:
                made = self._message(0, name, self.rooms[name].show())
            except FeeddriveError as error:
                made = self._message(0, name, Said({"error": str(error)}))
            except Exception as error:
                made = self._message(0, name, Said({"error": fault(error)}))
            self._send(name, made)

    def close(self) -> None:
        """End what runs in it."""
        self.desk.close()

    def _job(self, act: str) -> None:
        if act != "cancel":
            raise ParameterError(f"a job can be canceled, and not '{act:.60}'")
        self.desk.cancel()

    def _view(self, act: str, asked: Asked) -> str:
        """Look at a part of x in all pictures of a room over it, or at all of it; the room."""
        if act != "window":
            raise ParameterError(f"a view has a window, and not '{act:.60}'")
        room = asked.choice("shows", self.rooms)
        label, low, high = asked.text("label"), asked.number_or_none("low"), asked.number_or_none("high")
        self._windows.pop((room, label), None)
        if low is not None and high is not None:
            if not low < high:
                raise ParameterError(
                    f"a window reaches from low to high, not from {number(low, 6)} to {number(high, 6)}"
                )
            if len(self._windows) >= _WINDOWS:
                self._windows.clear()
            self._windows[room, label] = low, high
        return room

    def _another(self) -> None:
        self._windows.clear()  # the page shows all of another source
        for each in self.rooms.values():
            each.begin()

    def _start(
        self, room: str, what: str, work: Work, then: Callable[[Any], None], found: Callable[[Found], None]
    ) -> Job:
        def heard(state: JobState) -> None:
            self._send("job", self._message(0, "", Said(), state))
            if not state.going:
                self.push(room)

        def met(report: Found) -> None:
            with self._lock:
                found(report)
            self.push(room)

        def ended(result: Any) -> None:
            with self._lock:
                job.state = replace(job.state, state=DONE)  # the desk is free for what follows
                then(result)

        job = Job(room, what, work, heard, met, ended)
        job.start()
        return job

    def _message(self, number: int, room: str, said: Said, job: JobState | None = None) -> bytes:
        bench = self.desk.bench
        words: dict[str, Any] = {
            "number": number,
            "room": room,
            "epoch": self.desk.epoch,
            "title": "" if bench is None else bench.title,
            "tour": self._tour.words,
            **said.words,
        }
        state = job or self.desk.job_state()
        if state is not None:
            words["job"] = {**asdict(state), "error": self._plain(state.error)}
        if "error" in words:
            words["error"] = self._plain(str(words["error"]))
        if "remarks" in words:
            words["remarks"] = [self._plain(str(each)) for each in words["remarks"]]
        windows = {label: each for (of, label), each in self._windows.items() if of == room}
        return message(words, said.charts, windows)

    def _plain(self, said: str) -> str:
        """Files by the names under which they were brought, options by the fields of the page that stand for them."""
        folder = self.desk.folder
        between = re.escape(os.sep)
        said = re.sub(rf"{re.escape(str(folder))}{between}(brought{between}(\d+{between})?)?", "", said)
        if "feeddrive " in said:  # a command to enter elsewhere
            return said
        return re.sub(r"--([a-z-]+)", lambda found: f"'{FIELDS.get(found[0]) or found[1].replace('-', ' ')}'", said)

    def _send(self, of: str, said: bytes) -> None:
        for each in tuple(self._pushes):
            each(of, said)
