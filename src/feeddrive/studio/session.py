"""One open page: its rooms over one desk, one request at a time."""

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
        self.rooms: dict[str, Room] = {room.name: room(self.desk) for room in ROOMS}
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
        """Return the message that answers a request of the page: the answer of its room, or the error."""
        sent = asked.get("number")
        number = sent if isinstance(sent, int) else 0
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
                shown = self.rooms[name].do(act, Asked(asked))
                self._tour.heard(f"{name}.{act}")
                return self._message(number, name, shown)
        except FeeddriveError as error:
            error_text = str(error)
        except Exception as error:  # the page goes on, and says what to report
            error_text = fault(error)
        return self._message(number, name if name in self.rooms else "", Said({"error": error_text}))

    def listen(self, push: Push) -> Callable[[], None]:
        """Subscribe to unsolicited messages, each with the kind that it replaces. The returned
        function unsubscribes.
        """
        self._windows.clear()  # a page that has just been loaded looks at all
        self._pushes.append(push)
        return lambda: self._pushes.remove(push)

    @property
    def heard(self) -> bool:
        """True if a page listens."""
        return bool(self._pushes)

    def push(self, name: str) -> None:
        """Show a room again without a request."""
        with self._lock:
            try:
                content = self._message(0, name, self.rooms[name].show())
            except FeeddriveError as error:
                content = self._message(0, name, Said({"error": str(error)}))
            except Exception as error:
                content = self._message(0, name, Said({"error": fault(error)}))
            self._send(name, content)

    def close(self) -> None:
        """Stop all running work of the session."""
        self.desk.close()

    def _job(self, act: str) -> None:
        if act != "cancel":
            raise ParameterError(f"a job can be canceled, and not '{act:.60}'")
        self.desk.cancel()

    def _view(self, act: str, asked: Asked) -> str:
        """Zoom all pictures of a room to a part of x, or to all of it; return the room."""
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
        for room in self.rooms.values():
            room.begin()

    def _start(
        self, room: str, what: str, work: Work, then: Callable[[Any], None], improved: Callable[[Found], None]
    ) -> Job:
        def heard(state: JobState) -> None:
            self._send("job", self._message(0, "", Said(), state))
            if not state.going:
                self.push(room)

        def met(report: Found) -> None:
            with self._lock:
                improved(report)
            self.push(room)

        def ended(result: Any) -> None:
            with self._lock:
                job.state = replace(job.state, state=DONE)  # the desk is free for what follows
                then(result)

        job = Job(room, what, work, heard, met, ended)
        job.start()
        return job

    def _message(self, number: int, room: str, answer: Said, job: JobState | None = None) -> bytes:
        bench = self.desk.bench
        words: dict[str, Any] = {
            "number": number,
            "room": room,
            "epoch": self.desk.epoch,
            "title": "" if bench is None else bench.title,
            "tour": self._tour.words,
            **answer.words,
        }
        state = job or self.desk.job_state()
        if state is not None:
            words["job"] = {**asdict(state), "error": self._plain(state.error)}
        if "error" in words:
            words["error"] = self._plain(str(words["error"]))
        if "remarks" in words:
            words["remarks"] = [self._plain(str(item)) for item in words["remarks"]]
        windows = {label: item for (of, label), item in self._windows.items() if of == room}
        return message(words, answer.charts, windows)

    def _plain(self, text: str) -> str:
        """Replace paths by the names of uploaded files, and options by the names of the page's fields."""
        folder = self.desk.folder
        between = re.escape(os.sep)
        text = re.sub(rf"{re.escape(str(folder))}{between}(brought{between}(\d+{between})?)?", "", text)
        if "feeddrive " in text:  # a command to enter elsewhere
            return text
        return re.sub(r"--([a-z-]+)", lambda match: f"'{FIELDS.get(match[0]) or match[1].replace('-', ' ')}'", text)

    def _send(self, of: str, content: bytes) -> None:
        for push in tuple(self._pushes):
            push(of, content)
