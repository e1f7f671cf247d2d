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

from feeddrive.language.errors import CancelledError, FeeddriveError, ParameterError
from feeddrive.language.progress import Progress, follow_parent, one_thread
from feeddrive.language.text import Text

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from feeddrive.workflow.command import Outcome, Request

Work = Callable[[Progress], Any]
WAITING, RUNNING, DONE, FAILED, CANCELLED = "waiting", "running", "done", "failed", "canceled"
_OFTEN = 0.05  # s between two reports of a step
# counts, share of all of them, and s after which the rest of what is counted is extrapolated
_COUNTED, _SHARE, _WATCHED = 3, 0.1, 2.0
_DRAWN = 0.2  # s between two reports of what is best so far
_PATIENCE = 1.5  # s in which canceled work may end by itself
_ASKED = 0.01  # s between two looks whether the work was canceled
_STOP = "stop"  # what the server sends to cancel a job; all else that it sends is an answer
# of all pages together: more jobs than processors would only slow each other down
_PLACES = threading.BoundedSemaphore(os.cpu_count() or 1)
# one process begins at a time, since `one_thread` changes the environment of the server; and none while all are ended
_BEGIN = threading.Lock()
# jobs that have not ended, for `end_all`: daemons would end with the server, but may not start processes themselves
_GOING = set["Job"]()
# a child forked from a server with threads could inherit a lock that nobody releases
_CONTEXT = multiprocessing.get_context("spawn")


def end_all() -> None:
    """End the jobs of all pages, including queued ones, when the server stops; those that move an axis brake first."""
    going = tuple(_GOING)
    for job in going:
        job.end()
    for job in going:
        job.join(job.patience)


def perform(command: str, request: Request, progress: Progress) -> Outcome[Any]:
    """Run a workflow command by name."""
    from feeddrive.workflow.command import load

    return load(command).run(request, progress)


@dataclass(frozen=True)
class Question:
    """A question of a job, which waits for the answer.

    number    of this job, from 1
    text      the question
    expected  for a measured value: what is expected, in `unit`; None for a question to be answered with yes or no
    unit      SI unit of the answer
    """

    number: int
    text: str
    expected: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class JobState:
    """The progress of a job.

    room, what   name of the tab that started it, and description of the job
    state        waiting, running, done, failed or canceled
    step         current step; `done` of `of`, if steps are counted
    remarks      remarks so far
    error        reason for a failure
    question     the question for whose answer it waits
    left         s that the rest of what is counted takes if it goes on at the same rate; None if nobody can tell
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
    question: Question | None = None
    left: float | None = None

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
    patience         s in which a job that moves an axis may brake and put back what was in the drive before it is
                     terminated; 0 for a job that moves nothing
    """

    def __init__(
        self,
        room: str,
        what: str,
        work: Work,
        heard: Callable[[JobState], None],
        improved: Callable[[Found], None],
        ended: Callable[[Any], None],
        patience: float = 0.0,
    ) -> None:
        self.state = JobState(room, what)
        self.patience = patience
        self._work, self._heard, self._found, self._ended = work, heard, improved, ended
        # an event of this process alone: a child that is killed may leave a shared one locked
        self._stop = threading.Event()
        self._over = threading.Event()
        self._begun = time.monotonic()
        self._counted: tuple[int | None, int, float] = (None, 0, 0.0)  # a total, the first count and its time
        self._process: Any = None
        self._pipe: Connection | None = None
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def start(self) -> None:
        """Start the job as soon as a processor is free."""
        _GOING.add(self)
        self._thread.start()

    def cancel(self) -> None:
        """Signal the job to stop, and terminate its process if it has not stopped within 1.5 s, or its `patience`."""
        if not self._stop.is_set():
            self._stop.set()
            threading.Thread(target=self._end, daemon=True).start()

    def answer(self, number: int, value: float | bool | None) -> None:
        """Answer the question for which the job waits. Raises ParameterError for another one, and for a second answer.

        value  True or False; for a measured value a number, or None if there is none
        """
        with _BEGIN:
            asked = self.state.question
            if asked is None or asked.number != number or self._pipe is None:
                raise ParameterError("this question is no longer open: it was answered, or the work has ended")
            if (asked.expected is None) != isinstance(value, bool):
                wanted = "yes or no" if asked.expected is None else f"a number in {asked.unit}"
                raise ParameterError(f"the answer must be {wanted}")
            self.state = replace(self.state, question=None)
            with contextlib.suppress(OSError):
                self._pipe.send((number, value))
        self._heard(self.state)

    def kill(self) -> None:
        """Terminate the process immediately; a queued job is never started."""
        with _BEGIN:
            self._stop.set()
            if self._process is not None:
                self._process.kill()

    def end(self) -> None:
        """End the job when nobody listens any more: one that moves an axis by a cancel, any other one at once."""
        if self.patience:
            self.cancel()
        else:
            self.kill()

    def join(self, seconds: float | None = None) -> None:
        """Wait until the job has ended, but for at most `seconds`."""
        self._thread.join(seconds)

    def _end(self) -> None:
        # the process may have ended meanwhile
        with _BEGIN, contextlib.suppress(OSError):
            if self._pipe is not None:
                self._pipe.send(_STOP)
        # a search that stops by itself sends its best result, one that is killed sends none
        if not self._over.wait(self.patience or _PATIENCE):
            self.kill()

    def _say(self, **changes: Any) -> None:
        if changes.get("state") not in (None, RUNNING):
            changes["question"] = None
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
        process = _CONTEXT.Process(target=_child, args=(self._work, theirs, self.patience))
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

    def _left(self, done: int | None, of: int | None) -> float | None:
        """Return how long the rest of what is counted will take at the rate so far, s; None if too little is done."""
        known, first, since = self._counted
        now = time.monotonic()
        # steps that count towards the same total, such as those of the laws of a comparison, are one
        if done is None or not of or known != of or done < first:
            self._counted = (of, done or 0, now)
            return None
        if done - first < max(_COUNTED, _SHARE * of) or now - since < _WATCHED:
            return None
        return (of - done) * (now - since) / (done - first)

    def _take(self, kind: str, *payload: Any) -> bool:
        """Handle one report; return False after the last one."""
        if kind == "step":
            step, done, of = payload
            self._say(step=step, done=done, of=of, left=self._left(done, of))
        elif kind == "remark":
            self._say(remarks=(*self.state.remarks, payload[0]))
        elif kind == "found":
            self._found(payload[0])
        elif kind == "question":
            self._say(question=payload[0])
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
        return kind in ("step", "remark", "found", "question")


class _Reporting(Progress):
    """The progress of a job within its process: it sends reports to the server, and limits the rate of steps."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__()
        self._pipe, self._last, self._told, self._looked = pipe, ("", ""), 0.0, 0.0
        self._drawn = 0.0
        self._held: Found | None = None
        self._questions = 0

    @property
    def cancelled(self) -> bool:
        now = time.monotonic()
        # inner loops ask all the time, and each look at the pipe is a system call
        if now - self._looked > _ASKED and not self._cancelled.is_set():
            self._looked = now
            # answers come only while a question is open, where `_asked` reads them
            self._read(0.0)
        return self._cancelled.is_set()

    def _read(self, seconds: float) -> Any:
        """Wait for at most `seconds` for a message of the server, and return it; None if there is none."""
        # an error means that the server has ended
        try:
            said = self._pipe.recv() if self._pipe.poll(seconds) else None
        except (OSError, EOFError):
            said = _STOP
        if said == _STOP:
            self._cancelled.set()
            return None
        return said

    def _asked(self, text: str, expected: float | None = None, unit: str = "") -> Any:
        """Ask the page, and wait for the answer to this question. Raises CancelledError after a cancel."""
        self._questions += 1
        self._pipe.send(("question", Question(self._questions, str(Text(text)), expected, unit)))
        while True:
            answer = self._read(_DRAWN)
            self.check()
            if answer is not None and answer[0] == self._questions:
                return answer[1]

    def confirm(self, question: str) -> bool:
        return bool(self._asked(question))

    def measured(self, question: str, expected: float, unit: str) -> float | None:
        value = self._asked(question, expected, unit)
        return None if value is None else float(value)

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


def _child(work: Work, pipe: Connection, patience: float) -> None:
    progress, over = _Reporting(pipe), threading.Event()

    def orphaned() -> None:
        # work that moves an axis brakes and puts back what was in the drive; all other work has nothing to lose
        if patience:
            progress.cancel()
            over.wait(patience)

    follow_parent(orphaned)
    # the server was killed: nobody reads the result
    with contextlib.suppress(BrokenPipeError):
        try:
            try:
                result = work(progress)
            finally:
                over.set()
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
