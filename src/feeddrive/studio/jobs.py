"""Long-running jobs of the page, in separate processes that can be canceled and may crash without harm."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feeddrive.language.errors import CancelledError, FeeddriveError
from feeddrive.language.progress import Progress, follow_parent, one_thread
from feeddrive.language.text import Text

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from feeddrive.workflow.command import Outcome, Request

Work = Callable[[Progress], Any]
WAITING, RUNNING, DONE, FAILED, CANCELLED = "waiting", "running", "done", "failed", "canceled"
_OFTEN = 0.05  # s between two reports of a step
_DRAWN = 0.2  # s between two reports of what is best so far
_PATIENCE = 1.5  # s in which canceled work may end by itself
_ASKED = 0.01  # s between two looks whether the work was canceled
# of all pages together: more jobs than processors would only slow each other down
_PLACES = threading.BoundedSemaphore(os.cpu_count() or 1)
# one process begins at a time, since `one_thread` changes the environment of the server; and none while all are ended
_BEGIN = threading.Lock()
# jobs that have not ended, for `end_all`: daemons would end with the server, but may not start processes themselves
_GOING = set["Job"]()
# a child forked from a server with threads could inherit a lock that nobody releases
_CONTEXT = multiprocessing.get_context("spawn")


def end_all() -> None:
    """End the jobs of all pages, including queued ones, when the server stops."""
    for job in tuple(_GOING):
        job.kill()


def perform(command: str, request: Request, progress: Progress) -> Outcome[Any]:
    """Run a workflow command by name."""
    from feeddrive.workflow.command import load

    return load(command).run(request, progress)


@dataclass(frozen=True)
class JobState:
    """The progress of a job.

    room, what   name of the tab that started it, and description of the job
    state        waiting, running, done, failed or canceled
    step         current step; `done` of `of`, if steps are counted
    remarks      remarks so far
    error        reason for a failure
    """

    room: str
    what: str
    state: str = WAITING
    step: str = ""
    done: int | None = None
    of: int | None = None
    remarks: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0

    @property
    def going(self) -> bool:
        """True until the job has ended."""
        return self.state in (WAITING, RUNNING)


@dataclass(frozen=True)
class Found:
    """The best result of a search so far, and its cost."""

    cost: float
    best: Any


class Job:
    """A job in its own process.

    heard(state)     called after each report of the job, from a thread of this process
    improved(value)  called for each `Found`
    ended(result)    called once, if the job completes
    """

    def __init__(
        self,
        room: str,
        what: str,
        work: Work,
        heard: Callable[[JobState], None],
        improved: Callable[[Found], None],
        ended: Callable[[Any], None],
    ) -> None:
        self.state = JobState(room, what)
        self._work, self._heard, self._found, self._ended = work, heard, improved, ended
        # an event of this process alone: a child that is killed may leave a shared one locked
        self._stop = threading.Event()
        self._over = threading.Event()
        self._begun = time.monotonic()
        self._process: Any = None
        self._pipe: Connection | None = None
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def start(self) -> None:
        """Start the job as soon as a processor is free."""
        _GOING.add(self)
        self._thread.start()

    def cancel(self) -> None:
        """Signal the job to stop, and terminate its process if it has not stopped within 1.5 s."""
        if not self._stop.is_set():
            self._stop.set()
            threading.Thread(target=self._end, daemon=True).start()

    def kill(self) -> None:
        """Terminate the process immediately; a queued job is never started."""
        with _BEGIN:
            self._stop.set()
            if self._process is not None:
                self._process.kill()

    def join(self, seconds: float | None = None) -> None:
        """Wait until the job has ended, but for at most `seconds`."""
        self._thread.join(seconds)

    def _end(self) -> None:
        # the process may have ended meanwhile
        with _BEGIN, contextlib.suppress(OSError):
            if self._pipe is not None:
                self._pipe.send("stop")
        # a search that stops by itself sends its best result, one that is killed sends none
        if not self._over.wait(_PATIENCE):
            self.kill()

    def _say(self, **changes: Any) -> None:
        self.state = replace(self.state, seconds=time.monotonic() - self._begun, **changes)
        self._heard(self.state)

    def _follow(self) -> None:
        try:
            # with a timeout, so that a job in the queue can be canceled
            while not _PLACES.acquire(timeout=0.1):
                if self._stop.is_set():
                    self._say(state=CANCELLED)
                    return
            try:
                self._run()
            finally:
                _PLACES.release()
        finally:
            _GOING.discard(self)
            self._over.set()

    def _run(self) -> None:
        ours, theirs = _CONTEXT.Pipe()
        process = _CONTEXT.Process(target=_child, args=(self._work, theirs))
        try:
            with _BEGIN, one_thread():
                if not self._stop.is_set():
                    process.start()
                    self._process, self._pipe = process, ours
        except OSError as error:
            reason = error.strerror or str(error)
            self._say(state=FAILED, error=f"{self.state.what} cannot begin: {reason}; close other programs")
            return
        finally:
            # with a copy of the far end open here, `recv` would wait forever for a child that has crashed
            theirs.close()
        if self._process is None:
            self._say(state=CANCELLED)
            return
        self._say(state=RUNNING)
        try:
            while self._take(*ours.recv()):
                pass
        except (EOFError, OSError):
            if self._stop.is_set():
                self._say(state=CANCELLED)
            else:
                message = f"{self.state.what} ended without a word: it was killed, or memory ran out; begin it again"
                self._say(state=FAILED, error=message)
        except Exception as error:
            # a fault in a room that handled a report: the job must not go on without a listener
            self.kill()
            self._say(state=FAILED, error=fault(error))
        finally:
            # under the lock, since `_end` may be about to send through the pipe
            with _BEGIN:
                self._pipe = None
                ours.close()
            process.join()

    def _take(self, kind: str, *payload: Any) -> bool:
        """Handle one report; return False after the last one."""
        if kind == "step":
            step, done, of = payload
            self._say(step=step, done=done, of=of)
        elif kind == "remark":
            self._say(remarks=(*self.state.remarks, payload[0]))
        elif kind == "found":
            self._found(payload[0])
        elif kind == "done":
            try:
                self._ended(payload[0])
            except FeeddriveError as error:
                self._say(state=FAILED, error=str(error))
            except Exception as error:
                self._say(state=FAILED, error=fault(error))
            else:
                self._say(state=DONE)
        elif kind == "canceled":
            self._say(state=CANCELLED)
        else:
            self._say(state=FAILED, error=payload[0])
        return kind in ("step", "remark", "found")


class _Reporting(Progress):
    """The progress of a job within its process: it sends reports to the server, and limits the rate of steps."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__()
        self._pipe, self._last, self._told, self._looked = pipe, ("", ""), 0.0, 0.0
        self._drawn = 0.0
        self._held: Found | None = None

    @property
    def cancelled(self) -> bool:
        now = time.monotonic()
        # inner loops ask all the time, and each look at the pipe is a system call
        if now - self._looked > _ASKED and not self._cancelled.is_set():
            self._looked = now
            # an error means that the server has ended, and `follow_parent` ends this process
            with contextlib.suppress(OSError):
                if self._pipe.poll():
                    self._cancelled.set()
        return self._cancelled.is_set()

    def flush(self) -> None:
        """Send the pending best result, if any."""
        if self._held is not None:
            self._pipe.send(("found", self._held))
            self._held = None

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.flush()
        now = time.monotonic()
        # the last step of a count is always sent, so that the bar ends full
        if (what, part) == self._last and now - self._told < _OFTEN and done != of:
            return
        self._last, self._told = (what, part), now
        self._pipe.send(("step", str(Text(f"{part}: {what}" if part else what)), done, of))

    def show_remark(self, message: Any) -> None:
        self._pipe.send(("remark", str(message)))

    def show_better(self, cost: float, best: object) -> None:
        self._held = Found(cost, best)
        now = time.monotonic()
        if now - self._drawn > _DRAWN:
            self._drawn = now
            self.flush()


def fault(error: Exception) -> str:
    """Return a sentence that describes an unexpected exception and where it occurred."""
    last = traceback.extract_tb(error.__traceback__)[-1:]
    place = "".join(f" in {Path(frame.filename).name}, line {frame.lineno}" for frame in last)
    return str(Text(f"a fault in feeddrive, please report it: {type(error).__name__}{place}: {error}"))


def _child(work: Work, pipe: Connection) -> None:
    follow_parent()
    # the server was killed: nobody reads the result
    with contextlib.suppress(BrokenPipeError):
        progress = _Reporting(pipe)
        try:
            try:
                result = work(progress)
            finally:
                # the best result of a search is kept also if it is canceled
                progress.flush()
        except CancelledError:
            pipe.send(("canceled",))
        except FeeddriveError as error:
            pipe.send(("failed", str(error)))
        except MemoryError:
            pipe.send(("failed", "memory ran out: close other programs, or take a smaller piece of the file"))
        except Exception as error:
            # a fault of feeddrive: the page stays usable and shows what to report, the console has the traceback
            pipe.send(("failed", fault(error)))
            raise
        else:
            pipe.send(("done", result))
