"""How the server begins and ends: what is in its way is said, and nothing that it began is left behind."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio import server
from feeddrive.studio.server import PAGE, Outbox, Session, Sessions
from studio_server import FEEDDRIVE, Served, alive, descendants, needs_proc

pytestmark = pytest.mark.skipif(
    not (PAGE / "index.html").is_file(), reason="NOT TESTED: the page is not built: make page"
)


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    made = list[Served]()

    def begin(*words: str) -> Served:
        made.append(Served(tmp_path / f"folder_{len(made)}", *words))
        return made[-1]

    yield begin
    for each in made:
        if each.process.poll() is None:
            each.close()
        assert each.process.stdout is not None
        each.process.stdout.close()


STARTS = 20  # of each law: ten minutes and more, so that what ends within a minute was ended


def gone(processes: list[int]) -> bool:
    """Return whether all of them end, long before their work would."""
    until = time.monotonic() + 60.0
    while any(alive(each) for each in processes):
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True


@needs_proc
def test_a_killed_server_takes_its_work_with_it(serve: Callable[..., Served]) -> None:
    served = serve("ball_screw")
    with served.page("a") as page:
        assert "error" not in page.ask("compare.start", starts=STARTS)
        page.runs()
        working = descendants(served.process.pid)
        assert working
        served.process.kill()
        served.process.wait(60.0)
    assert gone(working)


@needs_proc
def test_ctrl_c_ends_all_also_work_that_waits_for_a_processor(serve: Callable[..., Served]) -> None:
    served = serve("ball_screw")
    pages = [served.page(f"page {i}") for i in range((os.cpu_count() or 1) + 1)]
    opened = [each.__enter__() for each in pages]
    for each in opened:
        assert "error" not in each.ask("compare.start", starts=STARTS)
    for each in opened[:-1]:
        each.runs()
    working = descendants(served.process.pid)
    assert opened[-1].job is not None
    assert opened[-1].job["state"] == "waiting"
    served.process.send_signal(signal.SIGINT)
    said, _ = served.process.communicate(timeout=60.0)
    assert gone(working)
    assert not list(served.folder.glob("temporary_*"))
    assert served.process.returncode == 0
    assert said == ""


def refused(*words: str, **environment: str) -> tuple[int, str]:
    done = subprocess.run(
        [*FEEDDRIVE, "studio", "--no-browser", *words],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=60.0,
        env={**os.environ, **environment},
        check=False,
    )
    return done.returncode, done.stderr


def test_a_port_in_use_is_refused_and_one_that_was_left_is_free(serve: Callable[..., Served], tmp_path: Path) -> None:
    first = serve()
    code, said = refused("--port", str(first.port), "--folder", str(tmp_path / "other"))
    assert code == 2
    assert f"--port {first.port}: cannot be used" in said
    assert "choose another one, or port 0 for a free one" in said
    with first.page("a") as page:  # a connection whose end the system remembers for a minute
        page.ask("import.show")
        first.close()
    assert serve("--port", str(first.port)).port == first.port


def test_a_folder_that_cannot_be_written_is_refused_before_the_page_opens(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    code, said = refused("--folder", str(tmp_path / "taken" / "studio"))
    assert code == 2
    assert f"--folder {tmp_path / 'taken' / 'studio'}: cannot be written" in said
    assert "a part of its path is a file" in said
    assert "Traceback" not in said


def test_an_address_of_another_machine_is_refused(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("a long password", encoding="utf-8")
    (tmp_path / "password").chmod(0o600)
    words = ("--password-file", str(tmp_path / "password"), "--folder", str(tmp_path / "a"))
    code, said = refused("--host", "192.0.2.7", *words)
    assert code == 2
    assert "--host 192.0.2.7 --port 0: cannot be used" in said


@pytest.mark.skipif(sys.platform == "win32", reason="BROWSER is for other systems")
@pytest.mark.parametrize(
    ("browser", "said"), [("no-such-browser-anywhere", "No browser was found on this machine: open"), ("sleep 30", "")]
)
def test_without_a_browser_or_with_one_that_stays_the_page_is_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, browser: str, said: str
) -> None:
    monkeypatch.setenv("BROWSER", browser)
    words = [*FEEDDRIVE, "studio", "--folder", str(tmp_path / "folder")]
    begin = subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, encoding="utf-8", env={**os.environ, "PATH": "/bin"}
    )
    assert begin.stdout is not None
    try:
        address = begin.stdout.readline()
        assert urlsplit(address).hostname == "127.0.0.1"
        port = urlsplit(address).port
        with socket.create_connection(("127.0.0.1", port), timeout=5.0) as asked:
            asked.sendall(b"GET / HTTP/1.1\r\nHost: nobody\r\n\r\n")
            assert asked.recv(100).startswith(b"HTTP/1.1 421")
        if said:
            assert begin.stdout.readline().startswith(said)
    finally:
        begin.send_signal(signal.SIGINT)
        begin.wait(60.0)
        begin.stdout.close()


def test_what_a_page_does_not_read_is_replaced_by_what_came_later() -> None:
    """A tab that sleeps during a search must not fill the memory of the server with pictures."""

    async def read(box: Outbox) -> list[bytes]:
        return [await box.take() for _ in range(4)]

    box = Outbox()
    box.put(b"answer 1")
    for i in range(10_000):
        box.put(b"picture %d" % i, "optimize")
        box.put(b"state %d" % i, "job")
    box.put(b"answer 2")
    assert asyncio.run(read(box)) == [b"answer 1", b"picture 9999", b"state 9999", b"answer 2"]


def test_of_too_many_pages_the_one_left_longest_ago_is_ended_and_none_that_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_SESSIONS", 3)
    sessions = Sessions(lambda: Session(tmp_path))
    opened, left, latest = (sessions.named(name) for name in ("opened", "left", "latest"))
    leave = [opened.listen(ignored)]
    left.desk.start("optimize", "the work", waiting, lambda _: None)
    job = left.desk.job
    assert job is not None
    more = sessions.named("more")  # one too many
    job.join(20.0)
    assert not job.state.going
    assert [sessions.named(name) for name in ("opened", "latest", "more")] == [opened, latest, more]
    leave += [each.listen(ignored) for each in (latest, more)]
    with pytest.raises(ParameterError, match="3 pages are open: close one of them, and load this one again"):
        sessions.named("left")
    leave[1]()
    assert sessions.named("left") not in (opened, left, latest, more)
    assert sessions.named("opened") is opened


def ignored(_: str, __: bytes) -> None:
    """What a page hears."""


def waiting(progress: Progress) -> None:
    while True:
        progress.step("waiting")
        time.sleep(0.01)
