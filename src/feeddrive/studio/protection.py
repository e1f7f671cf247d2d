"""Who may talk to the page's server: this machine's own browser, from its own page, with the token of this start.

Host      only the addresses under which the server listens: a name that a foreign page points here is refused
(DNS rebinding)
password  in place of the token, where others on the network may reach the server: asked for by a page of its own
Origin    of a WebSocket and of everything that changes something: only the page itself
token     in the address that is printed at the start; a cookie that only this server gets back then stands for it
headers   a policy that loads nothing from elsewhere and runs no inline script; not to be framed, cached or sniffed
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any, TypeAlias
from urllib.parse import parse_qs

Scope: TypeAlias = MutableMapping[str, Any]
Receive: TypeAlias = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send: TypeAlias = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App: TypeAlias = Callable[[Scope, Receive, Send], Awaitable[None]]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
ENTER = """<!doctype html><html lang="en"><meta charset="utf-8"><title>feeddrive studio</title>
<form method="post" action="/enter"><p>{said}</p>
<label>Password <input type="password" name="password" autofocus autocomplete="current-password"></label>
<button>Open</button></form></html>
"""
_PAUSE = 1.0  # s after a wrong password, for all who try
_LONGEST = 1_000  # bytes of a password with its name


@dataclass(frozen=True)
class Door:
    """Who is let in.

    hosts     what the Host header may be: `127.0.0.1:8765`
    token     that the first address carries, and then the cookie
    password  in place of the token in the address; empty: none
    port      if the server listens at all addresses of the machine: every address of that port is its own, but no name
    """

    hosts: tuple[str, ...]
    token: str
    password: str = ""
    port: int | None = None

    @property
    def cookie(self) -> str:
        """Name of the cookie: browsers keep one set for all ports of a machine, on which another studio may be open."""
        return f"feeddrive_studio_{self.hosts[0].rpartition(':')[2]}"

    def own(self, host: str) -> bool:
        """Whether a Host header is an address of this server."""
        if host in self.hosts:
            return True
        name, _, port = host.rpartition(":")
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return self.port is not None and port == str(self.port)


class Protected:
    """An ASGI app behind the checks above."""

    def __init__(self, app: App, door: Door) -> None:
        self._app, self._door = app, door
        self._trying = asyncio.Lock()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is allowed; refuse the rest in a line."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        status, said = self._refusal(scope, headers)
        if status == 403 and self._door.password and scope["type"] == "http" and self._from_here(scope, headers):
            await self._ask(scope, receive, send)
            return
        if status:
            await _refuse(scope, receive, send, status, said)
            return
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if given and scope["type"] == "http":  # the token leaves the address bar, and the browser's history
            await self._open(send)
            return

        async def guarded(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *_HEADERS]
            await send(message)

        await self._app(scope, receive, guarded)

    async def _open(self, send: Send) -> None:
        cookie = f"{self._door.cookie}={self._door.token}; Path=/; HttpOnly; SameSite=Strict"
        await _answer(send, 303, "", ((b"location", b"/"), (b"set-cookie", cookie.encode())))

    async def _ask(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Ask for the password, or try the one that was given: one at a time, and slowly after a wrong one."""
        said = "This page is protected."
        if scope.get("method") == "POST" and scope.get("path") == "/enter":
            given = parse_qs((await _body(receive)).decode("utf-8", "replace")).get("password", [""])[0]
            async with self._trying:
                if hmac.compare_digest(given.encode(), self._door.password.encode()):
                    await self._open(send)
                    return
                await asyncio.sleep(_PAUSE)
            said = "This is not the password."
        form = POLICY.replace("form-action 'none'", "form-action 'self'").encode()
        headers = [(b"content-type", b"text/html; charset=utf-8"), (_HEADERS[0][0], form), *_HEADERS[1:]]
        await send({"type": "http.response.start", "status": 401, "headers": headers})
        await send({"type": "http.response.body", "body": ENTER.format(said=said).encode()})

    def _from_here(self, scope: Scope, headers: dict[str, str]) -> bool:
        """Whether a request comes from a page of this server, or opens one."""
        if scope.get("method") in ("GET", "HEAD"):
            return True
        return headers.get("origin", "").partition("://")[2] == headers.get("host", "")

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str]:
        """Status and reason, or 0."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._door.own(host):
            return 421, "this server answers under its own address only: use the one that feeddrive studio printed"
        changes = scope["type"] == "websocket" or scope.get("method") not in ("GET", "HEAD")
        if changes and (origin is None or origin.partition("://")[2] != host):
            return 403, "the request comes from another page"
        if not self._knows(scope, headers):
            return 403, "open the address that feeddrive studio printed: it carries the token of this start"
        return 0, ""

    def _knows(self, scope: Scope, headers: dict[str, str]) -> bool:
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(self._door.cookie)
        except CookieError:
            kept = None
        found = [] if kept is None else [kept.value]
        if scope["type"] == "http" and scope.get("method") == "GET" and not self._door.password:
            found += parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        return any(hmac.compare_digest(each.encode(), self._door.token.encode()) for each in found)


async def _body(receive: Receive) -> bytes:
    """The body of a request; empty if it is longer than a password may be."""
    found = b""
    while True:
        message = await receive()
        found += message.get("body", b"")
        if len(found) > _LONGEST or message["type"] != "http.request":
            return b""
        if not message.get("more_body"):
            return found


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, said: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": said})
        return
    await _answer(send, status, said + "\n")


async def _answer(send: Send, status: int, said: str, more: Iterable[tuple[bytes, bytes]] = ()) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS, *more]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": said.encode()})
