"""Who the page's server answers: its own page with the token, and nobody else."""

from __future__ import annotations

import asyncio
import http.client
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple
from urllib.parse import urlencode

import pytest
import uvicorn
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from feeddrive.studio import protection
from feeddrive.studio.bench import bench_of
from feeddrive.studio.protection import Door, Tokens
from feeddrive.studio.server import make_app

SECRET = "the-cookie-of-this-start"
HIDDEN = ("not of the page", "kept = true")


class Answer(NamedTuple):
    """Of a request: status, headers in small letters, text."""

    status: int
    headers: Mapping[str, str]
    text: str


class Server(NamedTuple):
    """A real server on a port of this machine."""

    port: int
    tokens: Tokens

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def cookie(self) -> str:
        return Door((self.host,)).cookie

    def get(self, path: str, method: str = "GET", body: str = "", **headers: str) -> Answer:
        """A request with the cookie of one who has opened the page, unless headers say otherwise."""
        given = {"Host": self.host, "Cookie": f"{self.cookie}={SECRET}"} | {k.title(): v for k, v in headers.items()}
        made = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            made.putrequest(method, path, skip_host=True)
            for name, value in given.items():
                made.putheader(name, value)
            if body:
                made.putheader("Content-Length", str(len(body)))
            made.endheaders(body.encode())
            found = made.getresponse()
            return Answer(found.status, {k.lower(): v for k, v in found.getheaders()}, found.read().decode())
        finally:
            made.close()

    def talk(self, path: str = "/talk", origin: str | None = "own", cookie: str = SECRET) -> ClientConnection:
        """A WebSocket as a page of some origin opens it."""
        own = f"http://{self.host}" if origin == "own" else origin
        return connect(
            f"ws://{self.host}{path}",
            origin=own,
            additional_headers={"Cookie": f"{self.cookie}={cookie}"},
            max_size=None,
            proxy=None,
        )


@contextmanager
def running(page: Path, password: str = "") -> Iterator[Server]:
    held: list[str] = []

    async def later(scope: object, receive: object, send: object) -> None:
        await app(scope, receive, send)  # type: ignore[arg-type]

    config = uvicorn.Config(later, host="127.0.0.1", port=0, log_level="error", lifespan="off", ws="websockets-sansio")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    until = time.monotonic() + 20.0
    while not server.started:
        assert time.monotonic() < until, "the server does not start"
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    held.append(f"127.0.0.1:{port}")
    app = make_app(
        bench_of("linear_motor"),
        Door(tuple(held), password, port if password else None, tokens := Tokens(), SECRET),
        page.parent / "kept",
        page,
    )
    yield Server(port, tokens)
    server.should_exit = True
    thread.join(20.0)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("page")
    (folder / "index.html").write_text("<!doctype html><title>page</title>", encoding="utf-8")
    (folder / "secret.toml").write_text(HIDDEN[1], encoding="utf-8")
    (folder.parent / "outside.html").write_text(HIDDEN[0], encoding="utf-8")
    with running(folder) as made:
        yield made


def test_a_token_opens_the_page_once_and_gives_way_to_a_cookie(server: Server) -> None:
    """It stood in the cookie too, and opened the page as often as it was sent."""
    used = list[str]()
    token = server.tokens.issue(lambda: used.append("used"))
    first = server.get(f"/?token={token}", cookie="")
    assert first.status == 200
    assert '<meta http-equiv="refresh" content="0;url=/">' in first.text  # the token leaves the address bar
    kept = first.headers["set-cookie"]
    assert kept.split("; ") == [f"{server.cookie}={SECRET}", "Path=/", "HttpOnly", "SameSite=Strict"]  # of this host
    assert token not in str(first)
    assert used == ["used"]
    again = server.get(f"/?token={token}", cookie="")
    assert again.status == 403
    assert "set-cookie" not in again.headers
    assert server.get(f"/?token={token}").text.startswith("<!doctype html><title>page")  # in the browser that is in
    found = server.get("/")
    assert found.status == 200
    assert found.text.startswith("<!doctype html><title>page")


def test_of_many_who_send_a_token_at_once_one_is_let_in(server: Server) -> None:
    token = server.tokens.issue()
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: server.get(f"/?token={token}", cookie="").status, range(16)))
    assert sorted(found) == [200] + 15 * [403]


@pytest.mark.parametrize(
    ("method", "headers"),
    [("HEAD", {}), ("POST", {}), ("GET", {"sec-purpose": "prefetch;prerender"}), ("GET", {"host": "evil.example"})],
)
def test_what_opens_no_page_does_not_use_a_token_up(server: Server, method: str, headers: dict[str, str]) -> None:
    """A browser that loads ahead while an address is typed, a check whether it answers, a name that points here."""
    token = server.tokens.issue()
    found = server.get(f"/?token={token}", method, cookie="", **headers)
    assert found.status in (403, 421)
    assert "set-cookie" not in found.headers
    assert server.get(f"/?token={token}", cookie="").status == 200


@pytest.mark.parametrize("query", ["", "?token=", "?token=guessed", "?token={token}x", f"?token={SECRET}"])
def test_without_a_token_there_is_nothing(server: Server, query: str) -> None:
    token = server.tokens.issue()
    for cookie in ("", f"{server.cookie}=guessed", f"{server.cookie}={token}", f"other={SECRET}"):
        found = server.get(f"/{query.format(token=token)}", cookie=cookie)
        assert found.status == 403
        assert "carries a token" in found.text
        assert "set-cookie" not in found.headers


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "127.0.0.1", "127.0.0.1:1", ""])
def test_a_name_that_points_here_is_refused(server: Server, host: str) -> None:
    """DNS rebinding: the browser takes the server for its own site, and the Host header tells."""
    assert server.get("/", host=host).status == 421


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "http://localhost:1", "http://{host}.evil.example"]
)
def test_another_page_cannot_talk_to_the_server(server: Server, origin: str | None) -> None:
    named = None if origin is None else origin.format(host=server.host)
    with pytest.raises((InvalidStatus, ConnectionClosed)):
        server.talk(origin=named).recv(timeout=20)
    assert server.get("/", "POST", **({} if named is None else {"origin": named})).status == 403


def test_the_socket_needs_the_cookie_and_no_token_in_its_address_helps(server: Server) -> None:
    for path in ("/talk", f"/talk?token={server.tokens.issue()}"):
        with pytest.raises((InvalidStatus, ConnectionClosed)):
            server.talk(path, cookie="guessed").recv(timeout=20)


@pytest.mark.parametrize(
    "name",
    [
        "../outside.html",
        "%2e%2e/outside.html",
        "..%2foutside.html",
        "%2e%2e%2foutside.html",
        "secret.toml",
        "/etc/passwd",
    ],
)
def test_no_file_but_those_of_the_page_is_read(server: Server, name: str) -> None:
    found = server.get(f"/{name}")
    assert found.status == 404
    assert not any(each in found.text for each in HIDDEN)


def test_every_answer_forbids_foreign_code_frames_and_copies(server: Server) -> None:
    for path, host in (("/", server.host), ("/none.html", server.host), ("/", "evil.example")):
        headers = server.get(path, host=host).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-frame-options"] == "DENY"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "null", "{" * 10_000, '{"do": 7}', '{"do": "__class__"}', b"\xff\x00", b'{"do": 7}']
)
def test_what_is_no_request_is_answered_and_the_page_goes_on(server: Server, text: str | bytes) -> None:
    with server.talk() as socket:
        socket.send(text)
        socket.send('{"number": 5, "do": "tune.show"}')
        heard = b""
        while b'"number":5' not in heard:
            heard += socket.recv(timeout=20)  # type: ignore[operator]
        assert b'"error":' in heard


def test_a_request_that_is_too_long_ends_the_conversation(server: Server) -> None:
    with server.talk() as socket:
        socket.send("x" * 20_000_000)
        with pytest.raises(ConnectionClosed):
            socket.recv(timeout=20)


PASSWORD = "a word & twelve=more"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that is open to the network."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "index.html").write_text("<!doctype html><title>page</title>", encoding="utf-8")
    with running(folder, PASSWORD) as made:
        yield made


def enter(server: Server, password: str, **headers: str) -> Answer:
    kept = {"cookie": "", "origin": f"http://{server.host}"} | headers
    return server.get("/enter", "POST", urlencode({"password": password}), **kept)


def test_a_page_on_the_network_asks_for_the_password_and_the_token_does_not_help(guarded: Server) -> None:
    for path in ("/", f"/?token={guarded.tokens.issue()}", "/page.js"):
        found = guarded.get(path, cookie="")
        assert (found.status, "Password" in found.text) == (401, True)
        assert "form-action 'self'" in found.headers["content-security-policy"]
        assert "set-cookie" not in found.headers
    opened = enter(guarded, PASSWORD)
    assert opened.status == 303
    assert opened.headers["set-cookie"].startswith(f"{guarded.cookie}={SECRET};")
    assert guarded.get("/").status == 200


@pytest.mark.parametrize("word", [PASSWORD + " ", "x" * 5_000])
def test_a_wrong_password_waits_a_second_and_opens_nothing(
    guarded: Server, monkeypatch: pytest.MonkeyPatch, word: str
) -> None:
    """The second in which no other one is tried is asked for; nobody waits here."""
    asked, sleep = list[float](), asyncio.sleep

    async def wait(seconds: float) -> None:
        asked.append(seconds)
        await sleep(0)

    monkeypatch.setattr(protection, "asyncio", SimpleNamespace(sleep=wait, Lock=asyncio.Lock))
    found = enter(guarded, word)
    assert asked == [1.0]
    assert found.status == 401
    assert "set-cookie" not in found.headers


def test_a_foreign_page_cannot_try_passwords(guarded: Server) -> None:
    assert enter(guarded, PASSWORD, origin="http://evil.example").status == 403


def test_where_all_addresses_are_served_names_are_still_refused(guarded: Server) -> None:
    assert guarded.get("/", host=f"192.0.2.7:{guarded.port}").status == 200
    for host in (f"evil.example:{guarded.port}", "192.0.2.7:1", "192.0.2.7"):
        assert guarded.get("/", host=host).status == 421
