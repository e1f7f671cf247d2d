"""`feeddrive studio` as a person starts it, spoken to as its page does, and watched: files, processes, memory."""

from __future__ import annotations

import http.client
import json
import os
import re
import select
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

# the shell has the engine without windows, which saves a third of the time
CHROMIUM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "chromium-browser"))), None)
FEEDDRIVE = [sys.executable, "-c", "from feeddrive.cli import main; main()"]
PROC = Path("/proc") if sys.platform == "linux" else Path()
needs_proc = pytest.mark.skipif(
    sys.platform != "linux", reason="NOT TESTED: processes and their memory are looked up in /proc"
)

# In every process that begins: what it opens, lists, makes, removes, begins and imports, and its most memory.
WATCH = """
import atexit, os, sys
_handle = os.open(os.environ["WATCHED"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
_kinds = {"os.listdir": 1, "os.scandir": 1, "os.mkdir": 1, "os.remove": 1, "os.rmdir": 1, "os.rename": 2, "os.link": 2,
          "os.symlink": 2, "os.truncate": 1, "os.chmod": 1}
def _kept(*words):
    os.write(_handle, (repr(words) + "\\n").encode("utf-8", "backslashreplace"))
def _hook(event, given):
    if event == "open":
        path, mode, flags = given
        written = any(each in (mode or "") for each in "wax+") or (flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if not isinstance(path, int):
            _kept("write" if written else "read", os.path.abspath(os.fsdecode(path)))
    elif event in _kinds:
        for path in given[: _kinds[event]]:
            if isinstance(path, (str, bytes, os.PathLike)):
                listed, place = event in ("os.listdir", "os.scandir"), os.fsdecode(path)
                if event in ("os.remove", "os.rmdir") and given[1] >= 0:  # in an open folder, as rmtree does it
                    if sys.platform != "linux":
                        continue
                    place = os.path.join(os.readlink("/proc/self/fd/%d" % given[1]), place)
                _kept("read" if listed else "write", os.path.abspath(place))
    elif event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn"):
        _kept("begin", str(given[0]))
    elif event == "import":
        _kept("import", str(given[0]))
    elif event == "socket.connect":
        _kept("connect", str(given[1]))
sys.addaudithook(_hook)
def _peak():
    try:
        import resource
    except ImportError:
        return
    _kept("peak", str(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))
atexit.register(_peak)
"""


def cookie_of(address: str) -> str:
    """The cookie, `name=value`, into which the token of an address is changed."""
    at = urlsplit(address)
    made = http.client.HTTPConnection(at.hostname or "", at.port, timeout=60)
    try:
        made.request("GET", f"/?{at.query}")
        found = made.getresponse()
        assert found.status == 200, found.read()
        return (found.headers["Set-Cookie"] or "").partition(";")[0]
    finally:
        made.close()


class Served:
    """A running server; everything that it does is under `folder`."""

    def __init__(self, folder: Path, *words: str, watched: bool = False, cwd: Path | None = None) -> None:
        self.folder, self.watch = folder, folder.parent / "watched.txt"
        given = dict(os.environ)
        if watched:
            hook = folder.parent / "hook"
            hook.mkdir(parents=True)
            (hook / "sitecustomize.py").write_text(WATCH, encoding="utf-8")
            paths = [str(hook), *filter(None, [given.get("PYTHONPATH")])]
            given |= {"PYTHONPATH": os.pathsep.join(paths), "WATCHED": str(self.watch), "PYTHONDONTWRITEBYTECODE": "1"}
        self.process = subprocess.Popen(
            [*FEEDDRIVE, "studio", *words, "--no-browser", "--folder", str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            env=given,
            cwd=cwd,
        )
        assert self.process.stdout is not None
        self.first = self.process.stdout.readline()
        found = re.search(r"http://([\d.:]+)/\?token=(\S+)", self.first)
        assert found, f"no address was printed: {self.first}"
        self.address, self.host = found[0], found[1]
        self.port = urlsplit(self.address).port or 0
        self.cookie = cookie_of(self.address)

    @property
    def headers(self) -> dict[str, str]:
        """Of its own page."""
        return {"Host": self.host, "Cookie": self.cookie, "Origin": f"http://{self.host}"}

    def upload(
        self, session: str, name: str, body: bytes | Iterable[bytes], size: int | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Bring a file: at once, or in pieces whose size was said or not. Status and answer."""
        made = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            where = f"/upload?{urlencode({'session': session, 'name': name})}"
            made.putrequest("POST", where, skip_host=True)
            for key, value in self.headers.items():
                made.putheader(key, value)
            pieces = [body] if isinstance(body, bytes) else body
            size = len(body) if isinstance(body, bytes) else size
            made.putheader(*(("Transfer-Encoding", "chunked") if size is None else ("Content-Length", str(size))))
            made.endheaders()
            for each in pieces:
                made.send(each if size is not None else b"%x\r\n%s\r\n" % (len(each), each))
                if select.select([made.sock], [], [], 0.0)[0]:  # it has answered already
                    break
            else:
                if size is None:
                    made.send(b"0\r\n\r\n")
            found = made.getresponse()
            return found.status, json.loads(found.read())
        finally:
            made.close()

    def get(self, path: str) -> tuple[int, bytes]:
        """Status and content."""
        made = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            made.request("GET", path, headers=self.headers)
            found = made.getresponse()
            return found.status, found.read()
        finally:
            made.close()

    def result(self, session: str, name: str) -> tuple[int, bytes]:
        """A file of a session."""
        return self.get(f"/file/{quote(name)}?session={quote(session)}")

    @contextmanager
    def page(self, session: str) -> Iterator[Talking]:
        """The conversation of a page."""
        told = {key: value for key, value in self.headers.items() if key == "Cookie"}
        with connect(
            f"ws://{self.host}/talk", origin=self.headers["Origin"], additional_headers=told, max_size=None, proxy=None
        ) as socket:
            yield Talking(socket, session)

    def kept(self) -> list[tuple[str, ...]]:
        """What all of its processes have done so far."""
        import ast

        text = self.watch.read_text(encoding="utf-8")
        return [ast.literal_eval(each) for each in text.splitlines()]

    def memory(self) -> float:
        """MB of the server itself."""
        return memory_of(self.process.pid)

    def close(self) -> str:
        """End it as a service manager does; what it printed meanwhile."""
        self.process.terminate()
        said, _ = self.process.communicate(timeout=20.0)
        return str(said)


class Talking:
    """A page at its end of the WebSocket."""

    def __init__(self, socket: ClientConnection, session: str) -> None:
        self.socket, self.session, self.number = socket, session, 0
        self.job: Mapping[str, Any] | None = None

    def ask(self, do: str, **more: Any) -> dict[str, Any]:
        """One request, and what it is answered."""
        self.number += 1
        self.socket.send(json.dumps({"number": self.number, "do": do, "session": self.session, **more}))
        while True:
            said = self.hear()
            if said["number"] == self.number:
                return said

    def hear(self, seconds: float = 60.0) -> dict[str, Any]:
        """The next message: its words, with the numbers of its curves."""
        content = self.socket.recv(timeout=seconds)
        assert isinstance(content, bytes)
        (length,) = struct.unpack_from("<I", content)
        said: dict[str, Any] = json.loads(content[4 : 4 + length])
        self.job = said.get("job", self.job)
        return {**said, "numbers": np.frombuffer(content[4 + length :], "<f4")}

    def ended(self, seconds: float = 120.0) -> Mapping[str, Any]:
        """The job, once it has ended."""
        until = time.monotonic() + seconds
        while self.job is None or self.job["state"] in ("waiting", "running"):
            assert time.monotonic() < until, f"the job goes on: {self.job}"
            self.hear(seconds)
        return self.job

    def runs(self) -> None:
        """Wait until the job has a process that reports."""
        while self.job is None or self.job["state"] != "running" or not self.job["step"]:
            self.hear()


def memory_of(process: int) -> float:
    """MB that a process has in memory."""
    text = (PROC / str(process) / "status").read_text(encoding="ascii")
    found = re.search(r"VmRSS:\s+(\d+) kB", text)
    return 1e-3 * int(found[1]) if found else 0.0


def descendants(process: int) -> list[int]:
    """Processes that compute for a process, those that they began too; not the one that keeps track of memory."""
    parents, working = dict[int, int](), set[int]()
    for each in PROC.glob("[0-9]*"):
        try:
            fields = (each / "stat").read_text(encoding="ascii").rpartition(")")[2].split()
            words = (each / "cmdline").read_bytes()
        except OSError:
            continue
        if fields[0] != "Z":
            parents[int(each.name)] = int(fields[1])
            if b"resource_tracker" not in words:
                working.add(int(each.name))
    found, more = set[int](), {process}
    while more:
        more = {each for each, parent in parents.items() if parent in more} - found
        found |= more
    return sorted(found & working)


def alive(process: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        text = (PROC / str(process) / "stat").read_text(encoding="ascii")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] != "Z"
