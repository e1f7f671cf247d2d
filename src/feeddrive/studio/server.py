"""The page's server: the built page, files that are brought and taken, and one WebSocket for each page that is open."""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from feeddrive.language.errors import FileError, MissingExtraError
from feeddrive.language.recent import Recent
from feeddrive.studio.bench import Bench
from feeddrive.studio.protection import App, Door, Protected
from feeddrive.studio.session import Session
from feeddrive.studio.uploads import keep, safe_name
from feeddrive.studio.wire import message

PAGE = Path(__file__).parent / "page"  # built from the TypeScript in `page/` of the repository
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}
_SESSIONS = 64  # pages whose state is kept, the latest
_LARGEST = 64_000  # bytes of a request of the page
_KEY = 64  # characters of the name of a session


def make_app(
    bench: Bench | None, door: Door, folder: Path, page: Path = PAGE,
    brought: tuple[Path, ...] = (),
) -> App:  # fmt: skip
    """The ASGI app for pages that begin with one bench, or with none, behind its checks.

    door     who is let in
    folder   in which each page gets a directory of its own
    brought  files with which every page begins, as if they had been brought
    Raises MissingExtraError without the extra `studio`.
    """
    try:
        from starlette.applications import Starlette
        from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
        from starlette.routing import Route, WebSocketRoute
        from starlette.websockets import WebSocket, WebSocketDisconnect
    except ImportError as error:
        raise MissingExtraError("starlette", "studio", "the studio") from error

    sessions: Recent[Session] = Recent(_SESSIONS)

    def new_session() -> Session:
        folder.mkdir(parents=True, exist_ok=True)
        own = Path(tempfile.mkdtemp(prefix=time.strftime("%Y-%m-%d_%H%M%S_"), dir=folder))
        return Session(own, bench, brought)

    def session_of(name: str) -> Session:
        return sessions.get(name[:_KEY], new_session)

    async def file(request: Any) -> Any:
        name = request.path_params.get("name") or "index.html"
        path = page / name  # a route's name has no slash, so that it stays in the folder
        if path.suffix not in _TYPES or not path.is_file():
            return PlainTextResponse("there is no such file\n", 404)
        return Response(path.read_bytes(), media_type=_TYPES[path.suffix])

    async def upload(request: Any) -> Any:
        given, size = request.query_params, request.headers.get("content-length", "")
        into = session_of(given.get("session", "")).desk.folder / "brought"
        try:
            kept = await keep(given.get("name", ""), request.stream(), into, int(size) if size.isdecimal() else None)
        except FileError as error:
            return JSONResponse({"error": str(error)}, 413 if "larger" in str(error) else 400)
        return JSONResponse({"name": kept.name})

    async def result(request: Any) -> Any:
        try:
            name = safe_name(request.path_params["name"])
        except FileError as error:
            return PlainTextResponse(f"{error}\n", 404)
        path = session_of(request.query_params.get("session", "")).desk.folder / name
        if not path.is_file() or path.is_symlink():
            return PlainTextResponse("there is no such file\n", 404)
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    async def talk(socket: WebSocket) -> None:
        await socket.accept()
        loop, waiting = asyncio.get_running_loop(), asyncio.Queue[bytes]()

        async def send() -> None:
            while True:
                await socket.send_bytes(await waiting.get())

        sender = asyncio.create_task(send())
        leave: Callable[[], None] | None = None
        session: Session | None = None
        try:
            while True:
                asked = _asked(await socket.receive_text())
                if asked is None:
                    waiting.put_nowait(message({"number": 0, "error": "the page sent what is no request"}))
                    continue
                if session is None or leave is None:
                    session = await asyncio.to_thread(session_of, str(asked.get("session")))
                    leave = session.listen(lambda said: _put(loop, waiting, said))
                waiting.put_nowait(await asyncio.to_thread(session.answer, asked))
        except WebSocketDisconnect:
            pass
        finally:
            sender.cancel()
            if leave is not None:
                leave()

    routes = [
        Route("/", file), Route("/upload", upload, methods=["POST"]), Route("/file/{name}", result),
        Route("/{name}", file), WebSocketRoute("/talk", talk),
    ]  # fmt: skip
    return Protected(Starlette(routes=routes), door)


def _put(loop: asyncio.AbstractEventLoop, waiting: asyncio.Queue[bytes], said: bytes) -> None:
    """From another thread; nothing if the server has ended."""
    if not loop.is_closed():
        loop.call_soon_threadsafe(waiting.put_nowait, said)


def _asked(text: str) -> dict[str, Any] | None:
    """The request in a text; None for what is none."""
    if len(text) > _LARGEST:
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def serve(app: App, host: str, port: int, ready: Callable[[], None]) -> None:
    """Serve until Ctrl-C. Raises MissingExtraError without the extra `studio`."""
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
        app, host=host, port=port, log_level="error", access_log=False, ws="websockets-sansio", ws_max_size=_LARGEST,
        lifespan="off", server_header=False, date_header=False, timeout_graceful_shutdown=1,
    )  # fmt: skip
    Server(config).run()
