"""Foreign pages in the browser of somebody who has the studio open, and a file that is too large for it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from studio_server import CHROMIUM

# a page that tries all that a page may try; it says what came of each
_FOREIGN = """<!doctype html><title>foreign</title><body><pre id="said"></pre><script>
const at = "HOST", said = document.getElementById("said");
const tell = (what) => { said.textContent += what + "\\n"; };
const socket = new WebSocket(`ws://${at}/talk`);
socket.onopen = () => { socket.send('{"number": 1, "do": "export.show", "session": "a"}'); tell("socket open"); };
socket.onmessage = () => tell("socket heard");
socket.onclose = () => tell("socket closed");
fetch(`http://${at}/upload?session=a&name=a.csv`, { method: "POST", body: "x", credentials: "include" })
  .then((found) => tell(`upload ${found.status}`), () => tell("upload refused"));
fetch(`http://${at}/`, { credentials: "include" })
  .then((found) => found.text()).then((text) => tell(`read ${text}`), () => tell("read refused"));
const script = document.createElement("script");
script.src = `http://${at}/page.js`;
script.onload = () => tell("script ran");
script.onerror = () => tell("script refused");
const frame = document.createElement("iframe");
frame.src = `http://${at}/`;
frame.onload = () => { try { tell(`frame ${frame.contentDocument.title}`); } catch { tell("frame closed"); } };
document.body.append(script, frame);
</script>"""


@pytest.fixture
def foreign(studio: Any) -> Iterator[str]:
    """The address of a page on another port of this machine: of the same site, so that cookies go with its requests."""
    text = _FOREIGN.replace("HOST", urlsplit(studio.address).netloc).encode()

    class Answers(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Answers)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    host, port = server.server_address[:2]
    yield f"http://{host!s}:{port}/"
    server.shutdown()
    server.server_close()


def test_a_foreign_page_in_the_same_browser_gets_nothing(studio: Any, foreign: str, tmp_path: Path) -> None:
    opened = studio.open()
    opened.page.wait_for_selector("#verdict:not(:empty)")
    before = set(studio.folder.rglob("*"))
    page = opened.context.new_page()
    page.goto(foreign)
    page.wait_for_function("() => document.getElementById('said').textContent.trim().split('\\n').length >= 5")
    said = set(page.inner_text("#said").split())
    assert said == {"socket", "upload", "read", "script", "frame", "closed", "refused"}
    assert set(studio.folder.rglob("*")) == before


def test_a_name_that_points_here_gets_nothing_even_with_the_token(served: Callable[..., Any]) -> None:
    """DNS rebinding: for the browser the server belongs to evil.example, and so would its answers."""
    studio = served("xy_table", "--axis", "x")
    at = urlsplit(studio.token)
    browser = studio.browser.browser_type.launch(
        executable_path=CHROMIUM,
        args=["--no-sandbox", "--host-resolver-rules=MAP evil.example 127.0.0.1"],
    )
    try:
        page = browser.new_page()
        answer = page.goto(f"http://evil.example:{at.port}/?{at.query}")
        assert answer.status == 421
        assert "this server answers under its own address only" in page.inner_text("body")
        assert page.context.cookies() == []
        page.goto(studio.token)  # which it did not use up
        page.wait_for_selector("#verdict:not(:empty)")
    finally:
        browser.close()


def test_without_the_token_the_page_says_what_to_open(studio: Any) -> None:
    context = studio.browser.new_context()
    page = context.new_page()
    answer = page.goto(f"http://{urlsplit(studio.address).netloc}/")
    assert answer.status == 403
    assert "open the address that feeddrive studio printed" in page.inner_text("body")
    context.close()


def test_a_file_of_a_gigabyte_is_refused_before_it_is_sent(studio: Any, tmp_path: Path) -> None:
    big = tmp_path / "big.csv"
    with big.open("wb") as file:
        file.truncate(1_000_000_000)
    page = (opened := studio.open()).page
    opened.go("import")
    sizes = list[int]()
    page.on("request", lambda each: sizes.append(int(each.headers.get("content-length", "0"))))
    page.set_input_files("#files", str(big))
    page.wait_for_selector("text=big.csv is larger than 256 MB: take a shorter piece of the log", timeout=10_000)
    assert sizes
    assert max(sizes) < 1_000


def test_two_studios_in_one_browser_keep_apart(studio: Any, tmp_path: Path) -> None:
    """Cookies know no ports: the second one must not lock the first one out."""
    other = type(studio)(studio.browser, tmp_path / "other", "ball_screw")
    try:
        opened = studio.open()
        page = opened.context.new_page()
        page.goto(other.token)
        page.wait_for_selector("#verdict:not(:empty)")
        opened.page.reload()
        opened.page.wait_for_selector("#verdict:not(:empty)")
        assert "x-y table" in opened.page.inner_text("#title")
        assert opened.said == []
    finally:
        other.close()
