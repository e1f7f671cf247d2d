"""The page's server: the built page, uploads and downloads, and one WebSocket for each open page."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from feeddrive.files.atomic_io import refusal
from feeddrive.language.errors import FeeddriveError, MissingExtraError, ParameterError
from feeddrive.studio.bench import Bench
from feeddrive.studio.live import Followable
from feeddrive.studio.protection import App, Door, Protected
from feeddrive.studio.session import Session
from feeddrive.studio.uploads import keep, place_of, safe_name
from feeddrive.studio.wire import message

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
    *,
    tour: bool = False,
) -> App:
    """Return the ASGI app for pages that start with one bench, or with none, behind its access control.

    door     who is let in
    folder   in which each page gets a directory of its own
    brought  files with which every page begins, as if they had been brought
    tour     every page begins with the guided tour
    live     what every page may follow while it is recorded
    Raises MissingExtraError without the extra `studio`.
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
        return Session(own, bench, brought, live, tour=tour)

    sessions = Sessions(new_session)

    async def file(request: Any) -> Any:
        name = request.path_params.get("name") or "index.html"
        path = page / name  # a route's name has no slash, so that it stays in the folder
        if path.suffix not in _TYPES or not path.is_file():
            return PlainTextResponse("there is no such file\n", 404)
        return Response(path.read_bytes(), media_type=_TYPES[path.suffix])

    async def upload(request: Any) -> Any:
        query, size = request.query_params, request.headers.get("content-length", "")
        try:
            desk = sessions.named(query.get("session", "")).desk
            into = desk.folder / "brought"
            name = query.get("name", "")
            if query.get("ask"):  # whether it may be sent: nothing of it has come
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
                    leave = session.listen(lambda of, content: _put(loop, waiting, of, content))
                waiting.put(await asyncio.to_thread(session.answer, asked))
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
    """The sessions of open pages: when there are too many, the least recently used is ended."""

    def __init__(self, make: Callable[[], Session]) -> None:
        self._make, self._lock = make, threading.Lock()
        self._held = dict[str, Session]()  # the latest last

    def named(self, name: str) -> Session:
        """Return the session of a page, a new one for an unknown page.

        Raises ParameterError where all that are kept are open, FileError where the folder cannot be written.
        """
        with self._lock:
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
    """Messages waiting for a page: every answer, and the latest of each kind of unsolicited message."""

    def __init__(self) -> None:
        self._held, self._count = dict[int | str, bytes](), 0
        self._there = asyncio.Event()

    def put(self, content: bytes, of: str = "") -> None:
        """Queue a message; it replaces a waiting one with the same `of`."""
        self._count += 1
        self._held.pop(of, None)
        self._held[of or self._count] = content
        self._there.set()

    async def take(self) -> bytes:
        """Return the message that has waited the longest."""
        while not self._held:
            self._there.clear()
            await self._there.wait()
        return self._held.pop(next(iter(self._held)))


def _put(loop: asyncio.AbstractEventLoop, waiting: Outbox, of: str, content: bytes) -> None:
    """Queue a message from another thread; ignored if the server has ended."""
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(waiting.put, content, of)


def _asked(received: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the request in a WebSocket message; None if it holds none."""
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
    """The page was closed."""


def serve(app: App, listening: socket.socket, ready: Callable[[], None]) -> None:
    """Serve at a bound socket until Ctrl-C. Raises MissingExtraError without the extra `studio`."""
    try:
        import uvicorn
    except ImportError as error:
        raise MissingExtraError("uvicorn", "studio", "the studio") from error

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
        ws_per_message_deflate=False,  # numbers hardly shrink, and it took 10 ms of the 40
        lifespan="off",
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=1,
    )
    Server(config).run(sockets=[listening])
