"""The page's server: the built page, and one WebSocket for each page that is open."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from feeddrive.language.errors import MissingExtraError
from feeddrive.language.recent import Recent
from feeddrive.studio.bench import Bench
from feeddrive.studio.protection import App, Protected
from feeddrive.studio.session import Session
from feeddrive.studio.wire import message

PAGE = Path(__file__).parent / "page"  # built from the TypeScript in `page/` of the repository
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_SESSIONS = 64  # pages whose state is kept, the latest
_LARGEST = 64_000  # bytes of a request of the page


def make_app(bench: Bench, hosts: tuple[str, ...], token: str, page: Path = PAGE) -> App:
    """The ASGI app for one bench, behind its checks.

    hosts  addresses under which it is reached, as `127.0.0.1:8765`
    Raises MissingExtraError without the extra `studio`.
    """
    try:
        from starlette.applications import Starlette
        from starlette.responses import PlainTextResponse, Response
        from starlette.routing import Route, WebSocketRoute
        from starlette.websockets import WebSocket, WebSocketDisconnect
    except ImportError as error:
        raise MissingExtraError("starlette", "studio", "the studio") from error

    sessions: Recent[Session] = Recent(_SESSIONS)

    async def file(request: Any) -> Any:
        name = request.path_params.get("name") or "index.html"
        path = page / name  # a route's name has no slash, so that it stays in the folder
        if path.suffix not in _TYPES or not path.is_file():
            return PlainTextResponse("there is no such file\n", 404)
        return Response(path.read_bytes(), media_type=_TYPES[path.suffix])

    async def talk(socket: WebSocket) -> None:
        await socket.accept()
        session: Session | None = None
        try:
            while True:
                text = await socket.receive_text()
                asked = _asked(text)
                if asked is None:
                    await socket.send_bytes(message({"number": 0, "error": "the page sent what is no request"}))
                    continue
                if session is None:
                    session = sessions.get(str(asked.get("session")), lambda: Session(bench))
                    await socket.send_bytes(message({"number": 0, "knobs": session.knobs()}))
                await socket.send_bytes(await asyncio.to_thread(session.answer, asked))
        except WebSocketDisconnect:
            pass

    routes = [Route("/", file), Route("/{name}", file), WebSocketRoute("/talk", talk)]
    return Protected(Starlette(routes=routes), hosts, token)


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
        lifespan="off", server_header=False, date_header=False,
    )  # fmt: skip
    Server(config).run()
