"""How a person comes to the page: what other users of the machine see of it, and what opens the page how often."""

from __future__ import annotations

import json
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from feeddrive.studio import command as opening
from feeddrive.studio.command import remove_redirect, write_redirect
from feeddrive.studio.server import PAGE
from studio_server import FEEDDRIVE, needs_proc

needs_modes = pytest.mark.skipif(os.name != "posix", reason="NOT TESTED: modes of files are those of POSIX")
needs_terminal = pytest.mark.skipif(sys.platform == "win32", reason="NOT TESTED: Windows has no pseudo-terminals")

# What stands in for a browser: it notes its words and those of every process that can be seen, and goes where it is
# led, twice.  Then it waits, as a browser does, until the test has looked.
BROWSER = """
import http.client, json, os, pathlib, re, stat, sys, time, urllib.parse, urllib.request
words = sys.argv[1:]
path = pathlib.Path(urllib.request.url2pathname(urllib.parse.urlsplit(words[-1]).path))
text = path.read_text()
address = re.search(r'url=(http://[^"]+)"', text)[1]
at = urllib.parse.urlsplit(address)
token = urllib.parse.parse_qs(at.query)["token"][0]
def status():
    made = http.client.HTTPConnection(at.hostname, at.port)
    made.request("GET", f"/?{at.query}")
    found = made.getresponse()
    return found.status, found.headers["Set-Cookie"]
seen = []
for each in pathlib.Path("/proc").glob("[0-9]*/cmdline"):
    try:
        seen.append(each.read_bytes().decode("utf-8", "replace"))
    except OSError:
        pass
mode = lambda at: stat.S_IMODE(at.stat().st_mode)
kept = {"words": words, "token": token, "address": address, "seen": seen, "path": str(path),
        "modes": [mode(path), mode(path.parent)], "answers": [status(), status()]}
note = pathlib.Path(os.environ["NOTE"])
note.with_suffix(".new").write_text(json.dumps(kept))
note.with_suffix(".new").rename(note)
while not pathlib.Path(os.environ["NOTE"] + ".read").exists():
    time.sleep(0.05)
"""


@contextmanager
def started(folder: Path, *words: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """`feeddrive studio` without a terminal."""
    if not (PAGE / "index.html").is_file():
        pytest.skip("NOT TESTED: the page is not built: make page")
    with subprocess.Popen(
        [*FEEDDRIVE, "studio", "--folder", str(folder), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env={**os.environ, **environment},
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def until(there: Callable[[], bool]) -> None:
    """Wait until something is so."""
    end = time.monotonic() + 60.0
    while not there():
        assert time.monotonic() < end
        time.sleep(0.02)


@needs_proc
def test_no_process_has_the_token_among_its_words(tmp_path: Path) -> None:
    """The address with the token was a word of the browser, which `ps` shows to all, and it worked twice."""
    program, note = tmp_path / "browser.py", tmp_path / "note.json"
    program.write_text(BROWSER, encoding="utf-8")
    command = f"{sys.executable} {program} %s"
    with started(tmp_path / "studio", BROWSER=command, NOTE=str(note)) as process:
        assert process.stdout is not None
        printed = re.search(r"\?token=(\S+)", process.stdout.readline())
        assert printed is not None
        until(note.exists)
        found = json.loads(note.read_text(encoding="utf-8"))
        until(lambda: not Path(found["path"]).parent.exists())  # it has done its work
        Path(f"{note}.read").touch()
    assert len(found["words"]) == 1
    assert found["words"][0].startswith("file:///")
    assert any(str(program) in each for each in found["seen"])  # the browser itself was seen
    for token in (found["token"], printed[1]):
        assert not any(token in each for each in found["seen"])
    assert found["modes"] == [0o600, 0o700]
    (first, cookie), (second, none) = found["answers"]
    assert (first, second, none) == (200, 403, None)
    assert found["token"] not in cookie
    assert printed[1] != found["token"]


@pytest.mark.slow(reason="a server of its own; the file that was used is looked for in the quick test")
def test_what_was_not_used_is_removed_at_the_end(tmp_path: Path) -> None:
    program = tmp_path / "browser.py"
    program.write_text("import sys; open(sys.argv[0] + '.told', 'w').write(sys.argv[1])", encoding="utf-8")
    told = Path(f"{program}.told")
    with started(tmp_path / "studio", BROWSER=f"{sys.executable} {program} %s"):
        until(lambda: told.exists() and bool(told.read_text(encoding="utf-8")))
        assert list((tmp_path / "studio").rglob("*.html"))
    assert not list((tmp_path / "studio").rglob("*.html"))


@needs_terminal
@pytest.mark.slow(reason="a server of its own with a terminal")
def test_enter_prints_another_address(tmp_path: Path) -> None:
    import pty

    from studio_server import cookie_of

    ours, terminal = pty.openpty()
    words = [*FEEDDRIVE, "studio", "--no-browser", "--folder", str(tmp_path / "studio")]
    # a session of its own, whose terminal this is: the process is in the foreground, as one of a shell
    leads = "import fcntl, os, sys, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    code = f"{leads}os.execv(sys.argv[1], sys.argv[1:])"
    with subprocess.Popen([sys.executable, "-c", code, *words], stdin=terminal, stdout=terminal) as process:
        os.close(terminal)
        try:
            heard = b""

            def addresses(count: int) -> list[str]:
                nonlocal heard
                found = list[str]()
                while len(found) < count:
                    assert select.select([ours], [], [], 60.0)[0], heard
                    heard += os.read(ours, 65536)
                    found = re.findall(r"(http://[\d.:]+/\?token=[\w-]+)\r\n", heard.decode())
                return found

            (first,) = addresses(1)
            while b"Enter prints another one" not in heard:
                heard += os.read(ours, 65536)
            os.write(ours, b"\n")
            _, second = addresses(2)
            assert second != first
            assert cookie_of(second) == cookie_of(first)  # in any order, each of them once
        finally:
            process.terminate()
            process.wait(20.0)
            os.close(ours)


@needs_modes
def test_a_place_that_is_open_to_others_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive without modes shows every file as open to all."""
    for name in ("drive", "home"):
        (tmp_path / name).mkdir()
    private = opening._private
    monkeypatch.setattr(opening, "_private", lambda path: "drive" not in path.parts and private(path))
    missing, drive, home = (tmp_path / each for each in ("missing", "drive", "home"))
    assert write_redirect("http://localhost:1/?token=a&b", [missing, drive]) == []
    assert list(drive.iterdir()) == []
    (path,) = write_redirect('http://localhost:1/?token=a&"b', [missing, drive, home])
    assert path.is_relative_to(home)
    assert "url=http://localhost:1/?token=a&amp;&quot;b" in path.read_text(encoding="utf-8")
    remove_redirect(path)
    assert list(home.iterdir()) == []


def test_the_file_leads_a_real_browser_in(served: Callable[..., Any], tmp_path: Path) -> None:
    """From a file a browser is a stranger to the server: the cookie is SameSite=Strict, and must come all the same."""
    studio = served("ball_screw")
    (path,) = write_redirect(studio.token, [tmp_path])
    context = studio.browser.new_context()
    page = context.new_page()
    page.goto(path.as_uri())
    page.wait_for_selector("#verdict:not(:empty)")  # over its WebSocket
    assert page.url == f"{studio.address}#tune"
    (cookie,) = context.cookies()
    assert (cookie["httpOnly"], cookie["sameSite"], cookie["domain"]) == (True, "Strict", "127.0.0.1")
    assert (cookie["path"], cookie["expires"]) == ("/", -1)  # of this host, and forgotten with the browser
    assert cookie["value"] not in studio.token
    page.reload()
    page.wait_for_selector("#verdict:not(:empty)")
    second = context.new_page()  # another tab
    second.goto(studio.address)
    second.wait_for_selector("#verdict:not(:empty)")
    page.go_back()
    assert "token" not in page.url  # nor in the history
    other = studio.browser.new_context().new_page()
    for address in (path.as_uri(), studio.token):
        other.goto(address)
        other.wait_for_selector("text=Enter in the terminal of feeddrive studio prints another one")
    assert other.context.cookies() == []
