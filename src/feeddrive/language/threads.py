"""Stages of a computation in threads, for stages that release Python's lock; items and errors keep their order."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from contextvars import copy_context
from functools import lru_cache
from time import monotonic
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Executor

Item = TypeVar("Item")
Result = TypeVar("Result")

_LOOK = 0.2  # s: on some systems a thread that waits without a limit does not see Ctrl-C
_GROUP = 2e-3  # s: items that are made so quickly are handed over together, as each change of threads costs some 50 µs


class _ClosedError(Exception):
    """Nobody takes more items, or makes more."""


class _Channel(Generic[Item]):
    """Groups of items from one thread to another one; at most `most` groups wait.  Channels may share `changed`."""

    def __init__(self, most: int, changed: threading.Condition) -> None:
        self._most, self.changed = most, changed
        self._groups: deque[list[Item]] = deque()
        self._closed = self.ended = False
        self._error: BaseException | None = None

    @property
    def has_room(self) -> bool:
        """True if `put` does not wait."""
        return len(self._groups) < self._most or self._closed

    @property
    def is_ready(self) -> bool:
        """True if `take` does not wait."""
        return bool(self._groups) or self.ended or self._closed

    def put(self, group: list[Item]) -> None:
        """Hand over some items at once."""
        with self.changed:
            while not self.has_room:
                self.changed.wait(_LOOK)
            if self._closed:
                raise _ClosedError
            self._groups.append(group)
            self.changed.notify_all()

    def put_all(self, items: Iterable[Item]) -> None:
        """Put the items and the error that ends them; a generator is closed."""
        made, group, begun = iter(items), list[Item](), monotonic()
        try:
            for item in made:
                group.append(item)
                if monotonic() - begun >= _GROUP:
                    self.put(group)
                    group, begun = [], monotonic()
        except BaseException as error:  # every error is raised where the items are taken
            self._error = error
        finally:
            # in this thread: a generator cannot be closed while another thread runs it
            if isinstance(made, Generator):
                made.close()
            with suppress(_ClosedError):
                self.put(group)
            self.end()

    def end(self) -> None:
        """No more items come."""
        with self.changed:
            self.ended = True
            self.changed.notify_all()

    def take(self) -> Generator[Item]:
        """Yield the items; then raise the error that ended them."""
        while True:
            with self.changed:
                while not self.is_ready:
                    self.changed.wait(_LOOK)
                if self._closed:
                    raise _ClosedError
                if not self._groups:
                    break
                group = self._groups.popleft()
                self.changed.notify_all()
            yield from group
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Let both threads end with their next item."""
        with self.changed:
            self._closed = True
            self.changed.notify_all()


@lru_cache(maxsize=1)
def cores() -> int:
    """Return the number of processors available to this process."""
    # a container or an affinity mask may leave fewer cores than the computer has
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _started(work: Callable[..., None], *args: object) -> threading.Thread:
    """Start a thread with the context variables of this one."""
    thread = threading.Thread(target=copy_context().run, args=(work, *args), daemon=True)
    thread.start()
    return thread


def ahead(items: Iterable[Item], most: int) -> Generator[Item]:
    """Yield items that another thread makes, up to `most` of them ahead.

    Items and errors come in the same order as without the thread.  When the generator is closed, the thread is awaited,
    and a generator of items is closed in it.
    """
    channel = _Channel[Item](most, threading.Condition())
    thread = _started(channel.put_all, items)
    try:
        yield from channel.take()
    finally:
        channel.close()
        thread.join()


def through(items: Iterable[Item], stage: Callable[[Iterator[Item]], Iterable[Result]], most: int) -> Generator[Result]:
    """Yield the results of a stage that runs in another thread; the items are made in this one, up to `most` ahead.

    Results and errors come in the same order as those of `stage(items)`: an error of the items after the results of
    all items before it.  When the generator is closed, the thread is awaited.
    """
    changed = threading.Condition()
    given, results = _Channel[Item](most, changed), _Channel[Result](most, changed)
    thread = _started(lambda: results.put_all(stage(given.take())))
    source, taken = iter(items), results.take()
    error: BaseException | None = None
    try:
        while True:
            with changed:
                while not (results.is_ready or (given.has_room and not given.ended)):
                    changed.wait(_LOOK)
                makes = given.has_room and not given.ended and not results.ended
            if makes:
                try:
                    given.put([next(source)])
                except StopIteration:
                    given.end()
                # raised below, behind the results of what came before
                except Exception as raised:
                    error = raised
                    given.end()
                continue
            try:
                yield next(taken)
            except StopIteration:
                break
        if error is not None:
            raise error
    finally:
        given.close()
        results.close()
        thread.join()


def in_order(workers: Executor | None, work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Yield the result of each item in their order; all but the first are given to the workers, if there are any.

    Context variables have the values of the call.
    """
    if workers is None or len(items) < 2:
        yield from map(work, items)
        return
    # a context can be entered once at a time
    others = [workers.submit(copy_context().run, work, item) for item in items[1:]]
    yield work(items[0])
    for other in others:
        yield other.result()
