"""The page's server: the built page, its files, and one session over a WebSocket for each open page.

A message to the browser has a header in JSON and the numbers of all curves:

4 bytes   length of the header, little-endian, a multiple of 4 (padded with blanks)
header    JSON; a curve states the index of its first x value and the number of points; its y values, or the low and
          high values of a band, follow the x values
numbers   float32, little-endian; non-finite values are NaN and interrupt a line
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import socket
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.atomic_io import refusal
from feeddrive.language.errors import FeeddriveError, MissingExtraError, ParameterError
from feeddrive.language.quantity import number
from feeddrive.language.text import plain
from feeddrive.plot.chart import Band, Chart, Curve, Level, Mark, Panel
from feeddrive.plot.style import POINTS, envelope
from feeddrive.studio.bench import Bench
from feeddrive.studio.desk import Asked, Desk, Room, Said
from feeddrive.studio.jobs import DONE, Found, Job, JobState, Work, fault
from feeddrive.studio.live import Followable
from feeddrive.studio.protection import App, Door, Protected
from feeddrive.studio.rooms import ROOMS
from feeddrive.studio.rooms.optimize import WORDS
from feeddrive.studio.rooms.tour import Tour
from feeddrive.studio.uploads import keep, place_of, safe_name

Window = tuple[float, float]


def message(
    words: Mapping[str, Any],
    charts: Mapping[str, Chart] | None = None,
    windows: Mapping[str, Window] | None = None,
    rows: Mapping[str, np.ndarray] | None = None,
) -> bytes:
    """Encode one message: JSON data, and charts and tables of numbers by name.

    windows  visible x range by x label; the points of the curves are distributed over this range
    rows     tables of shape (m, n): the header has the place of the first number, m and n
    """
    numbers, windows = list[np.ndarray](), windows or {}
    shown = {name: _chart(chart, numbers, windows.get(chart.label)) for name, chart in (charts or {}).items()}
    tables = {name: [_append(tuple(table), numbers), *table.shape] for name, table in (rows or {}).items()}
    header_words = {**words, "charts": shown, "rows": tables}
    content = json.dumps(header_words, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    # "replace", since a lone surrogate has no encoding
    header = plain(content).encode("utf-8", "replace")
    # a Float32Array of the browser must begin at a multiple of 4 bytes
    header += b" " * (-len(header) % 4)
    body = np.concatenate(numbers).astype("<f4").tobytes() if numbers else b""
    return struct.pack("<I", len(header)) + header + body


def _chart(chart: Chart, numbers: list[np.ndarray], window: Window | None) -> dict[str, Any]:
    return {
        "label": chart.label,
        "scale": chart.scale,
        "low": chart.low,
        "high": chart.high,
        "square": chart.square,
        "bare": chart.bare,
        "factor": chart.factor,
        "panels": [_panel(panel, numbers, chart, window) for panel in chart.panels],
    }


def _panel(panel: Panel, numbers: list[np.ndarray], chart: Chart, window: Window | None) -> dict[str, Any]:
    return {
        "label": panel.label,
        "scale": panel.scale,
        "low": panel.low,
        "high": panel.high,
        "share": panel.share,
        "curves": [_curve(curve, numbers, chart, panel, window) for curve in panel.curves],
        "marks": [_mark(mark) for mark in panel.marks],
        "levels": [_level(level) for level in panel.levels],
        "discs": [vars(disc) for disc in panel.discs],
        "notes": [vars(note) for note in panel.notes],
        "bands": [_band(band, numbers) for band in panel.bands],
        "said": panel.caption,
        "heat": panel.heat and vars(panel.heat),
    }


def _mark(mark: Mark) -> dict[str, Any]:
    """Encode a mark; its caption has the key `said`, like those of panels and curves."""
    return {
        **{name: getattr(mark, name) for name in ("x", "y", "number", "hollow", "name", "key")},
        "said": mark.caption,
    }


def _level(level: Level) -> dict[str, Any]:
    return {name: getattr(level, name) for name in ("value", "text", "upright", "dashed", "faint", "number")}


def _curve(
    curve: Curve, numbers: list[np.ndarray], chart: Chart, panel: Panel, window: Window | None
) -> dict[str, Any]:
    x, y = np.asarray(curve.x, np.float64), np.asarray(curve.y, np.float64)
    each_point = [row for row in (curve.heat, curve.reach) if row is not None]
    # an envelope would separate points from their heat or reach
    if x.size > POINTS and not each_point:
        x, y = _thinned(x, y, chart, panel, window)
    at = _append((x, y, *each_point), numbers)
    return {
        "name": curve.name,
        "number": curve.number,
        "look": curve.look,
        "said": curve.caption,
        "at": at,
        "n": x.size,
        "heat": curve.heat is not None,
        "reach": curve.reach is not None,
    }


def _append(rows: Sequence[np.ndarray], numbers: list[np.ndarray]) -> int:
    """Append rows of numbers; return the index of the first appended number."""
    at = sum(block.size for block in numbers)
    for row in rows:
        # beyond single precision a value becomes infinite, and then a gap in the curve
        with np.errstate(over="ignore"):
            small = row.astype(np.float32)
        numbers.append(np.where(np.isfinite(small), small, np.float32(np.nan)))
    return at


def _band(band: Band, numbers: list[np.ndarray]) -> dict[str, Any]:
    """Encode a band; if it has more points than a plot can resolve, each interval is reduced to its envelope."""
    x, low, high = (np.asarray(row, np.float64) for row in (band.x, band.low, band.high))
    if x.size > POINTS and np.all(np.isfinite(x)):
        begins = np.linspace(0, x.size, POINTS, endpoint=False).astype(int)
        low, high = np.minimum.reduceat(low, begins), np.maximum.reduceat(high, begins)
        x = np.append(x[begins[:-1]], x[-1])
    at = _append((x, low, high), numbers)
    return {"name": band.name, "number": band.number, "at": at, "n": x.size}


def _thinned(
    x: np.ndarray, y: np.ndarray, chart: Chart, panel: Panel, window: Window | None
) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a curve to the resolution of a picture: its envelope over x or, in a plane, points one pixel apart.

    Non-finite values interrupt a curve; its pieces share the points in proportion to their lengths.
    """
    there = np.isfinite(x) & np.isfinite(y)
    if not np.all(there):
        ends = np.flatnonzero(np.diff(there)) + 1
        pieces = [(u, v) for u, v in zip(np.split(x, ends), np.split(y, ends), strict=True)]
        thinned = list[tuple[np.ndarray, np.ndarray]]()
        for u, v in pieces:
            if np.isfinite(u[0]) and np.isfinite(v[0]):
                thinned.append(
                    envelope(u, v, max(2, POINTS * u.size // x.size)) if np.all(np.diff(u) > 0.0) else (u, v)
                )
            else:
                # one point is enough to interrupt the curve
                thinned.append((np.array([np.nan]), np.array([np.nan])))
        return np.concatenate([u for u, _ in thinned]), np.concatenate([v for _, v in thinned])
    if np.all(np.diff(x) > 0.0):
        # one more point on either side, so that the curve reaches the edges of the window
        if window is not None:
            first, last = np.searchsorted(x, window)
            x, y = x[max(0, first - 1) : last + 1], y[max(0, first - 1) : last + 1]
        return envelope(x, y, POINTS)
    limits = chart.low, chart.high, panel.low, panel.high
    if chart.square and all(limit is not None for limit in limits):
        return _in_plane(x, y, *(float(limit) for limit in limits if limit is not None))
    return x, y


def _in_plane(
    x: np.ndarray, y: np.ndarray, left: float, right: float, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a curve that are a pixel apart within the picture, and increasingly sparse outside it."""
    wide, tall = right - left, high - low
    off = np.maximum(1.0, np.maximum(np.abs(2.0 * (x - left) / wide - 1.0), np.abs(2.0 * (y - low) / tall - 1.0)))
    steps = np.hypot(np.diff(x) / wide, np.diff(y) / tall) * POINTS / np.maximum(off[1:], off[:-1]) ** 2
    place = np.floor(np.concatenate([[0.0], np.cumsum(steps)]))
    kept = np.concatenate([[True], np.diff(place) > 0.0])
    # the point before each kept one, too, so that a jump is not drawn as a slope
    kept |= np.concatenate([kept[1:], [True]])
    return x[kept], y[kept]


# labels of fields on the page, by the options that errors of the commands name
FIELDS = {
    "--sample-time": "Sampling rate",
    "--baseline": "Today's machine",
    "--unit": "Unit",
    "--delay": "Dead time",
    "--machine": "Known machine",
    "--lead": "Screw pitch",
    "--load": "Response of the table",
    "--motor": "Response of the motor's encoder",
    "--force-constant": "One unit of the command =",
    "--rated": "Rated value",
    "--at-full": "gives",
    "--torque-constant": "constant",
    "--motor-constant": "constant",
    "--force": "Drive force",
    "--command": "Command to the drive",
    **{f"--{name.replace('_', '-')}": label for name, (label, _) in WORDS.items()},
}
Push = Callable[[str, bytes], None]
# zoomed ranges of x: labels come from the page, and without an end they would fill the memory
_WINDOWS = 50


class Session:
    """The session of one page, with its tabs and state.

    folder          directory of the page, for all files that it reads and writes
    bench, brought  initial bench and files
    live            sources that may be followed
    drives          drive files whose drives may be moved
    tour            True to start with the guided tour
    """

    def __init__(
        self,
        folder: Path,
        bench: Bench | None = None,
        brought: tuple[Path, ...] = (),
        live: Followable | None = None,
        drives: tuple[Path, ...] = (),
        *,
        tour: bool = False,
    ) -> None:
        self.desk = Desk(folder, brought, live, drives)
        self.desk.changed, self.desk.tell, self.desk.begun = self._another, self.push, self._start
        self.rooms: dict[str, Room] = {room.name: room(self.desk) for room in ROOMS}
        self._tour = Tour(self.desk)
        self.rooms[Tour.name] = self._tour
        self._pushes = list[Push]()
        self._windows: dict[tuple[str, str], Window] = {}  # by room and label of x
        self.desk.watched = lambda: self.heard
        # re-entrant: an action may push the state of another room
        self._lock = threading.RLock()
        if bench is not None:
            self.desk.put(bench)
        if tour:
            self.answer({"do": "import.tour"})

    def answer(self, asked: Mapping[str, Any], page: object = None) -> bytes:
        """Return the message that responds to a request from the page: the response of its tab, or the error.

        page  the connection through which it came
        """
        sent = asked.get("number")
        number = sent if isinstance(sent, int) else 0
        name, _, act = str(asked.get("do")).partition(".")
        try:
            # without the lock, which a long action may hold: a cancellation must not wait
            if name == "job":
                self._job(act)
                return self._message(number, "", Said())
            if name == "view":
                name, act = self._view(act, Asked(asked)), "show"
            if name not in self.rooms:
                raise ParameterError(f"the page asks for '{name:.60}', which is none of {', '.join(self.rooms)}")
            with self._lock:
                shown = self.rooms[name].do(act, Asked(asked, page))
                self._tour.heard(f"{name}.{act}")
                return self._message(number, name, shown)
        except FeeddriveError as error:
            error_text = str(error)
        except Exception as error:
            # the page stays usable and shows what to report
            error_text = fault(error)
        return self._message(number, name if name in self.rooms else "", Said({"error": error_text}))

    def listen(self, push: Push, page: object = None) -> Callable[[], None]:
        """Subscribe to unsolicited messages, each labeled with its kind; return a function that unsubscribes."""
        # a page that has just been loaded shows the full range
        self._windows.clear()
        self._pushes.append(push)

        def leave() -> None:
            self._pushes.remove(push)
            for left in self.desk.left:
                left(page)

        return leave

    @property
    def heard(self) -> bool:
        """True if a page is connected."""
        return bool(self._pushes)

    def push(self, name: str) -> None:
        """Send the current state of a tab to the page without a request."""
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
        """Zoom those pictures of a tab that have the requested x label; return the name of the tab.

        The request contains the range of x; without it the full range is shown.
        """
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
        self,
        room: str,
        what: str,
        work: Work,
        then: Callable[[Any], None],
        improved: Callable[[Found], None],
        patience: float,
    ) -> Job:
        def heard(state: JobState) -> None:
            self._send("job", self._message(0, "", Said(), state))
            if not state.going:
                self.push(room)
                self._freed()

        def met(report: Found) -> None:
            with self._lock:
                improved(report)
            self.push(room)

        def ended(result: Any) -> None:
            with self._lock:
                # `then` may start the next job, for which the desk must be free
                job.state = replace(job.state, state=DONE)
                then(result)

        job = Job(room, what, work, heard, met, ended, patience)
        job.start()
        return job

    def _freed(self) -> None:
        """Let all tabs start work that was waiting for the end of a job."""
        with self._lock:
            going_on = not self.desk.closed
            changed = [name for name, room in self.rooms.items() if going_on and self.desk.is_free and room.freed()]
        for name in changed:
            self.push(name)

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
            words["job"] = {**asdict(state), "step": self._plain(state.step), "error": self._plain(state.error)}
        if "error" in words:
            words["error"] = self._plain(str(words["error"]))
        if "remarks" in words:
            words["remarks"] = [self._plain(str(item)) for item in words["remarks"]]
        windows = {label: item for (of, label), item in self._windows.items() if of == room}
        return message(words, answer.charts, windows, answer.rows)

    def _plain(self, text: str) -> str:
        """Replace paths in a message by the names of uploaded files, and options by the names of the page's fields."""
        folder = self.desk.folder
        between = re.escape(os.sep)
        text = re.sub(rf"{re.escape(str(folder))}{between}(brought{between}(\d+{between})?)?", "", text)
        text = text.replace("name it with --", "choose which column it is, as --")
        # a command to be entered in a terminal keeps its options
        if "feeddrive " in text:
            return text
        return re.sub(r"--([a-z-]+)", lambda match: f"'{FIELDS.get(match[0]) or match[1].replace('-', ' ')}'", text)

    def _send(self, of: str, content: bytes) -> None:
        # a copy, since another thread may unsubscribe meanwhile
        for push in tuple(self._pushes):
            push(of, content)


PAGE = Path(__file__).parent / "page"  # built from the TypeScript in `page/` of the repository
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}
_SESSIONS = 64  # pages whose state is kept, the latest
_LARGEST = 64_000  # bytes of a request of the page
_KEY = 64  # characters of the name of a session
_WHOLE = re.compile(r"[0-9]{1,18}")


def make_app(
    bench: Bench | None,
    door: Door,
    folder: Path,
    page: Path = PAGE,
    brought: tuple[Path, ...] = (),
    live: Followable | None = None,
    drives: tuple[Path, ...] = (),
    *,
    tour: bool = False,
) -> App:
    """Return the ASGI app, with access control, for pages that start with one bench or with none.

    door     access control
    folder   parent of the directories of the pages
    brought  initial files of every page, as if they had been uploaded
    tour     True if every page starts with the guided tour
    live     sources that every page may follow while they are recorded
    drives   drive files whose drives every page may move, one at a time

    Raises MissingExtraError if the extra `studio` is not installed.
    """
    try:
        from starlette.applications import Starlette
        from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
        from starlette.routing import Route, WebSocketRoute
        from starlette.websockets import WebSocket
    except ImportError as error:
        raise MissingExtraError("starlette", "studio", "the studio") from error

    def new_session() -> Session:
        folder.mkdir(parents=True, exist_ok=True)
        own = Path(tempfile.mkdtemp(prefix=time.strftime("%Y-%m-%d_%H%M%S_"), dir=folder))
        return Session(own, bench, brought, live, drives, tour=tour)

    sessions = Sessions(new_session)

    async def file(request: Any) -> Any:
        name = request.path_params.get("name") or "index.html"
        # the name in a route has no slash, so the path stays in the folder
        path = page / name
        if path.suffix not in _TYPES or not path.is_file():
            return PlainTextResponse("there is no such file\n", 404)
        return Response(path.read_bytes(), media_type=_TYPES[path.suffix])

    async def upload(request: Any) -> Any:
        query, size = request.query_params, request.headers.get("content-length", "")
        try:
            desk = sessions.named(query.get("session", "")).desk
            into = desk.folder / "brought"
            name = query.get("name", "")
            # the page asks before it sends: a file that is too large need not be transferred
            if query.get("ask"):
                kept = place_of(name, into, int(query["ask"]) if _WHOLE.fullmatch(query["ask"]) else None)
            else:
                kept = await keep(name, request.stream(), into, int(size) if _WHOLE.fullmatch(size) else None)
                desk.files[kept.name] = kept
        except FeeddriveError as error:
            return JSONResponse({"error": str(error)}, 413 if "larger" in str(error) else 400)
        return JSONResponse({"name": kept.name})

    async def result(request: Any) -> Any:
        try:
            name = safe_name(request.path_params["name"])
            path = sessions.named(request.query_params.get("session", "")).desk.folder / name
        except FeeddriveError as error:
            return PlainTextResponse(f"{error!s}\n", 404)
        if not path.is_file() or path.is_symlink():
            return PlainTextResponse("there is no such file\n", 404)
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    async def talk(opened: WebSocket) -> None:
        await opened.accept()
        loop, waiting = asyncio.get_running_loop(), Outbox()

        async def send() -> None:
            while True:
                await opened.send_bytes(await waiting.take())

        sender = asyncio.create_task(send())
        leave: Callable[[], None] | None = None
        session: Session | None = None
        try:
            while True:
                asked = _asked(await opened.receive())
                if asked is None:
                    waiting.put(message({"number": 0, "error": "the page sent what is no request"}))
                    continue
                if session is None or leave is None:
                    try:
                        session = await asyncio.to_thread(sessions.named, str(asked.get("session")))
                    except FeeddriveError as error:
                        waiting.put(message({"number": asked.get("number"), "error": str(error)}))
                        continue
                    leave = session.listen(lambda of, content: _put(loop, waiting, of, content), waiting)
                # in a thread, so that the other pages are answered meanwhile
                waiting.put(await asyncio.to_thread(session.answer, asked, waiting))
        except _LeftError:
            pass
        finally:
            sender.cancel()
            if leave is not None:
                leave()

    routes = [
        Route("/", file),
        Route("/upload", upload, methods=["POST"]),
        Route("/file/{name}", result),
        Route("/{name}", file),
        WebSocketRoute("/talk", talk),
    ]
    return Protected(Starlette(routes=routes), door)


class Sessions:
    """The sessions of all pages. If there are too many, the least recently used one without an open page is ended."""

    def __init__(self, make: Callable[[], Session]) -> None:
        self._make, self._lock = make, threading.Lock()
        self._held = dict[str, Session]()  # the latest last

    def named(self, name: str) -> Session:
        """Return the session of a page; an unknown page gets a new one.

        Raises ParameterError if too many pages are open, and FileError if the folder cannot be written.
        """
        with self._lock:
            # taken out and put back at the end: the dict is in order of last use
            session = self._held.pop(name[:_KEY], None)
            if session is None:
                if len(self._held) >= _SESSIONS:
                    left = next((key for key, idle in self._held.items() if not idle.heard), None)
                    if left is None:
                        raise ParameterError(f"{_SESSIONS} pages are open: close one of them, and load this one again")
                    self._held.pop(left).close()
                try:
                    session = self._make()
                except OSError as error:
                    raise refusal(error.filename or "the folder of the page", "written", error) from None
            self._held[name[:_KEY]] = session
            return session


class Outbox:
    """The queue of messages for a page: every response, and the latest unsolicited message of each kind."""

    def __init__(self) -> None:
        self._held, self._count = dict[int | str, bytes](), 0
        self._there = asyncio.Event()

    def put(self, content: bytes, of: str = "") -> None:
        """Queue a message, which replaces a waiting one with the same nonempty `of`."""
        self._count += 1
        self._held.pop(of, None)
        self._held[of or self._count] = content
        self._there.set()

    async def take(self) -> bytes:
        """Wait for a message, and return the oldest one."""
        while not self._held:
            self._there.clear()
            await self._there.wait()
        return self._held.pop(next(iter(self._held)))


def _put(loop: asyncio.AbstractEventLoop, waiting: Outbox, of: str, content: bytes) -> None:
    """Queue a message from another thread; do nothing if the server has ended."""
    with contextlib.suppress(RuntimeError):
        # an event of asyncio may be set in its own loop only
        loop.call_soon_threadsafe(waiting.put, content, of)


def _asked(received: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the request in a WebSocket message; None if it is invalid. Raise _LeftError if the page was closed."""
    if received["type"] == "websocket.disconnect":
        raise _LeftError
    text = received.get("text") or ""
    if len(text) > _LARGEST:
        return None
    try:
        request = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return request if isinstance(request, dict) else None


class _LeftError(Exception):
    """Raised when the page was closed."""


def serve(app: App, listening: socket.socket, ready: Callable[[], None]) -> None:
    """Serve at a bound socket until Ctrl-C. Raises MissingExtraError if the extra `studio` is not installed."""
    try:
        import uvicorn
    except ImportError as error:
        raise MissingExtraError("uvicorn", "studio", "the studio") from error

    # uvicorn has no other hook that is called once the socket accepts connections
    class Server(uvicorn.Server):
        async def startup(self, sockets: Any = None) -> None:
            await super().startup(sockets)
            if self.started:
                ready()

    config = uvicorn.Config(
        app,
        log_level="error",
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=_LARGEST,
        # numbers hardly shrink, and compression took 10 ms of the 40
        ws_per_message_deflate=False,
        lifespan="off",
        server_header=False,
        date_header=False,
        # open WebSockets would delay the end after Ctrl-C without a limit
        timeout_graceful_shutdown=1,
    )
    Server(config).run(sockets=[listening])
