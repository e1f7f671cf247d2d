"""Access control of the page's server: host, origin, one-time tokens, cookie, password and security headers.

Host      must be an address at which the server listens; other names for this address are refused (DNS rebinding)
password  replaces the token if others on the network can reach the server; requested by a login page
Origin    of WebSockets and of all state-changing requests must be the page itself
token     part of an address; opens the page once and is exchanged for a cookie that is sent to this server only
headers   forbid external content, inline scripts, framing, caching and MIME sniffing
"""

import asyncio
import getpass
import hmac
import ipaddress
import os
import secrets
import sys
import threading
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import parse_qs

from feeddrive.files.atomic_io import read_whole
from feeddrive.language.errors import ParameterError

OPTION = "--password-file"
STANDARD_INPUT = "-"
_SHORTEST, _LONGEST = 12, 300  # characters; a browser sends up to three bytes for each byte of them
_MOST = 10_000  # bytes of the file
_OTHERS = 0o077  # permissions of group and others


def read_password(path: Path) -> str:
    """Read the password from the first line of a file, or for `-` from standard input, without echo in a terminal.

    Raises FileError for an unreadable file, ParameterError for a file that other users may read and for a password of
    the wrong length.
    """
    if str(path) != STANDARD_INPUT:
        content = read_whole(path, _MOST)
        permissions = os.stat(path).st_mode
        if os.name == "posix" and permissions & _OTHERS:
            raise ParameterError(
                f"{OPTION} {path}: other users of this machine may read or write it (mode {permissions & 0o777:o}): "
                f"chmod 600 {path}"
            )
        line = content.partition(b"\n")[0]
    elif sys.stdin.isatty():
        line = getpass.getpass("Password of the page: ").encode()
    else:
        line = sys.stdin.buffer.readline(_MOST)
    try:
        password = line.rstrip(b"\r\n").decode()
    except UnicodeDecodeError:
        raise ParameterError(f"{OPTION} {path}: its first line is no text in UTF-8: write the password anew") from None
    if not _SHORTEST <= len(password) <= _LONGEST:
        raise ParameterError(
            f"{OPTION} {path}: its first line has {len(password)} characters: a password has {_SHORTEST} to {_LONGEST}"
        )
    return password


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
<form method="post" action="/enter"><p>{reason}</p>
<label>Password <input type="password" name="password" autofocus autocomplete="current-password"></label>
<button>Open</button></form></html>
"""
# A redirect of the answer itself would not do: a browser that came from the redirect file (`command.py`) takes
# all of its chain for the request of a foreign site, and keeps a cookie that is SameSite=Strict back.
OPENED = """<!doctype html><html lang="en"><meta charset="utf-8"><title>feeddrive studio</title>
<meta http-equiv="refresh" content="0;url=/"><p><a href="/">feeddrive studio</a></p></html>
"""
_CLOSED = (
    "open the address that feeddrive studio printed: it carries a token that opens the page once, and Enter in the "
    "terminal of feeddrive studio prints another one"
)
_PAUSE = 1.0  # s after a wrong password, for all who try
_LONGEST_BODY = 1_000  # bytes of a password with its name


class Tokens:
    """The one-time tokens that open the page."""

    def __init__(self) -> None:
        self._open, self._lock = dict[str, Callable[[], None]](), threading.Lock()

    def issue(self, used: Callable[[], None] = lambda: None) -> str:
        """Return a new token; `used` is called when it has opened the page."""
        token = secrets.token_urlsafe(24)
        with self._lock:
            self._open[token] = used
        return token

    def redeem(self, token: str) -> bool:
        """Redeem a token; return False for one that was used or never issued."""
        with self._lock:
            # in constant time: the duration must not reveal how much of a guess is right
            equal = [other for other in self._open if hmac.compare_digest(other.encode(), token.encode())]
            # under the same lock: of many requests with one token only one is admitted
            called = [self._open.pop(other) for other in equal]
        for used in called:
            used()
        return bool(called)


@dataclass(frozen=True)
class Door:
    """The access control of the server.

    hosts     accepted Host headers, such as `127.0.0.1:8765`
    password  replaces the token in the address; empty if there is no password
    port      set if the server listens at all addresses of the machine: any IP address with this port is then
              accepted, but no host name except those in `hosts`
    tokens    one-time tokens that open the page without a password
    secret    value of the cookie
    """

    hosts: tuple[str, ...]
    password: str = ""
    port: int | None = None
    tokens: Tokens = field(default_factory=Tokens)
    secret: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    @property
    def cookie(self) -> str:
        """The name of the cookie, with the port, since browsers share cookies between all ports of a machine."""
        return f"feeddrive_studio_{self.hosts[0].rpartition(':')[2]}"

    def own(self, host: str) -> bool:
        """Return True if a Host header is an address of this server."""
        if host in self.hosts:
            return True
        name, _, port = host.rpartition(":")
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return self.port is not None and port == str(self.port)


class Protected:
    """An ASGI app behind the access control."""

    def __init__(self, app: App, door: Door) -> None:
        self._app, self._door = app, door
        self._trying = asyncio.Lock()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass permitted requests to the app, and refuse all others with a one-line reason."""
        # lifespan events come from the server itself
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        status, reason = self._refusal(scope, headers)
        # checked also with a valid cookie: the token is then used up, and leaves the address bar
        if status in (0, 403) and self._redeems(scope, headers):
            await self._enter(send)
            return
        if status == 403 and self._door.password and scope["type"] == "http" and self._from_here(scope, headers):
            await self._ask(scope, receive, send)
            return
        if status:
            await _refuse(scope, receive, send, status, reason)
            return

        async def guarded(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *_HEADERS]
            await send(message)

        await self._app(scope, receive, guarded)

    def _redeems(self, scope: Scope, headers: dict[str, str]) -> bool:
        """Return True if a request contains a valid token, which is then consumed.

        A browser that prefetches the page while its address is being typed does not consume the token.
        """
        ahead = "prefetch" in headers.get("sec-purpose", headers.get("purpose", ""))
        if scope["type"] != "http" or scope.get("method") != "GET" or self._door.password or ahead:
            return False
        token = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        return self._door.tokens.redeem(token)

    @property
    def _cookie(self) -> tuple[bytes, bytes]:
        # HttpOnly: no script can read it; SameSite=Strict: no foreign site makes the browser send it
        cookie = f"{self._door.cookie}={self._door.secret}; Path=/; HttpOnly; SameSite=Strict"
        return b"set-cookie", cookie.encode()

    async def _enter(self, send: Send) -> None:
        """Send the cookie in exchange for the token, with a page that removes the token from the address bar."""
        headers = [(b"content-type", b"text/html; charset=utf-8"), *_HEADERS, self._cookie]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": OPENED.encode()})

    async def _ask(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the password form, or check a submitted password; checks are sequential, with a delay on failure."""
        reason = "This page is protected."
        if scope.get("method") == "POST" and scope.get("path") == "/enter":
            attempt = parse_qs((await _body(receive)).decode("utf-8", "replace")).get("password", [""])[0]
            # one attempt at a time for all visitors, so that parallel connections do not shorten the delay
            async with self._trying:
                if hmac.compare_digest(attempt.encode(), self._door.password.encode()):
                    await _answer(send, 303, "", ((b"location", b"/"), self._cookie))
                    return
                await asyncio.sleep(_PAUSE)
            reason = "This is not the password."
        # only the login page may submit a form
        form = POLICY.replace("form-action 'none'", "form-action 'self'").encode()
        headers = [(b"content-type", b"text/html; charset=utf-8"), (_HEADERS[0][0], form), *_HEADERS[1:]]
        await send({"type": "http.response.start", "status": 401, "headers": headers})
        await send({"type": "http.response.body", "body": ENTER.format(reason=reason).encode()})

    def _from_here(self, scope: Scope, headers: dict[str, str]) -> bool:
        """Return True if a request only reads (GET or HEAD), or comes from a page of this server."""
        if scope.get("method") in ("GET", "HEAD"):
            return True
        return headers.get("origin", "").partition("://")[2] == headers.get("host", "")

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str]:
        """Return the HTTP status and reason of a refusal; status 0 if the request is permitted."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._door.own(host):
            return 421, "this server answers under its own address only: use the one that feeddrive studio printed"
        # browsers do not apply the same-origin policy to WebSockets, so the server must check their origin
        changes = scope["type"] == "websocket" or scope.get("method") not in ("GET", "HEAD")
        if changes and (origin is None or origin.partition("://")[2] != host):
            return 403, "the request comes from another page"
        return (0, "") if self._knows(headers) else (403, _CLOSED)

    def _knows(self, headers: dict[str, str]) -> bool:
        """Return True if a request carries the cookie that this run of the server issued."""
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(self._door.cookie)
        # browsers send the cookies of all servers on this host, some of which may be malformed
        except CookieError:
            kept = None
        return kept is not None and hmac.compare_digest(kept.value.encode(), self._door.secret.encode())


async def _body(receive: Receive) -> bytes:
    """Return the body of a request; empty if it exceeds the length limit of a password form."""
    body = b""
    while True:
        message = await receive()
        body += message.get("body", b"")
        if len(body) > _LONGEST_BODY or message["type"] != "http.request":
            return b""
        if not message.get("more_body"):
            return body


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        # ASGI: the connect event must be received before the connection is closed
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    await _answer(send, status, reason + "\n")


async def _answer(send: Send, status: int, reason: str, more: Iterable[tuple[bytes, bytes]] = ()) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS, *more]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": reason.encode()})
